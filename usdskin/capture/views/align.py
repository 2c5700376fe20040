"""Turn views so that they agree where they overlap.

Every two views that overlap are compared on their own; the relative rotations found are then
reconciled, each with the weight of what it rests on. A view that nothing constrains stays as
stated, and so does the mean of those that constrain each other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.views.align_features import Level, build_levels
from usdskin.capture.views.align_pair import PairFit, fit_pair
from usdskin.capture.views.align_view import AlignView, reduce_view
from usdskin.capture.views.rotation_vectors import rotation_by, vector_of
from usdskin.notes import Note

__all__ = ["AlignView", "AlignedPair", "Alignment", "align_views", "reduce_view"]

FloatArray = NDArray[np.float64]

Fits = dict[tuple[int, int], PairFit]
"""By the indices of the two views."""

_ROUNDS = 20

_OUTLIER_DEG = 2.0
"""Residual at which a pair counts half [deg]: parallax and lens errors stay below it and are
shared between the pairs."""

_DISAGREEMENT_DEG = 0.2
"""Residual that somebody should look into [deg]."""

_FAR_OFF_DEG = 3.0
"""Change of a view that somebody should look at [deg]."""

_SMALL_DEG = 2.0
"""Change of a view beyond which it weighs less in what the mean is kept of [deg]."""


@dataclass(frozen=True, slots=True, eq=False)
class AlignedPair:
    """How two views fit."""

    first: str
    """Name of a view."""

    second: str
    """Name of the other."""

    state: str
    """``constrained``, ``apart`` (they hardly overlap), ``featureless`` (about some axis), or
    ``contradicting`` (both have features, but not the same)."""

    overlap: float
    """Share of the sphere that both see, as stated [1]."""

    correlation_before: float
    """Of their details, as stated [1]."""

    correlation: float
    """Of their details, when turned [1]."""

    residual_before_deg: float | None
    """Angle between the relative rotation measured and that stated [deg]; None: not measured."""

    residual_after_deg: float | None
    """Angle between the relative rotation measured and that of the result [deg]."""

    gain: float
    """Median ratio of the second view's values to the first's."""


@dataclass(frozen=True, slots=True, eq=False)
class Alignment:
    """What the overlaps tell of the rotations."""

    rotations: FloatArray
    """Refined, from the cameras to the panorama, shape [view_count, 3, 3]."""

    change_deg: FloatArray
    """Angle between refined and stated [deg], shape [view_count]."""

    constrained: NDArray[np.bool_]
    """Whether some overlap tells the view's rotation, shape [view_count]."""

    residual_before_deg: float | None
    """Root mean square over the pairs measured [deg]; None: there is none."""

    residual_after_deg: float | None
    """The same with the refined rotations [deg]."""

    pairs: tuple[AlignedPair, ...]
    """Every two views, in the order of the views."""


def align_views(
    views: Sequence[AlignView], notes: list[Note] | None = None, search_deg: float = 15.0
) -> Alignment:
    """Refine the rotations of views.

    Args:
        views: The views, reduced; at most about 1 Mpx each.
        notes: Takes which stated rotations the overlaps contradict.
        search_deg: How far from the stated ones rotations are looked for [deg].

    Returns:
        The refined rotations. Where all changes are small their mean is zero: no rotation of the
        whole brings them closer to the stated ones.
    """
    pyramids = build_levels(views)
    fits = {
        (i, j): fit_pair(views[i], views[j], pyramids[i], pyramids[j], search_deg)
        for i, j in combinations(range(len(views)), 2)
    }
    stated = np.array([view.rotation for view in views], np.float64).reshape(-1, 3, 3)
    rotations = _reconciled(stated, fits)
    pairs = tuple(
        AlignedPair(
            first=views[i].name,
            second=views[j].name,
            state=fit.state,
            overlap=fit.overlap,
            correlation_before=fit.correlation_before,
            correlation=fit.correlation,
            residual_before_deg=_residual_deg(stated, stated, (i, j), fit),
            residual_after_deg=_residual_deg(rotations, stated, (i, j), fit),
            gain=fit.gain,
        )
        for (i, j), fit in fits.items()
    )
    change_deg = np.array(
        [_degrees(new @ old.T) for new, old in zip(rotations, stated, strict=True)]
    )
    alignment = Alignment(
        rotations=rotations,
        change_deg=change_deg,
        constrained=np.isin(np.arange(len(views)), list(_measured(fits))),
        residual_before_deg=_root_mean_square([pair.residual_before_deg for pair in pairs]),
        residual_after_deg=_root_mean_square([pair.residual_after_deg for pair in pairs]),
        pairs=pairs,
    )
    if notes is not None:
        notes += _notes(views, pyramids, fits, alignment)
    return alignment


def _measured(fits: Fits) -> Fits:
    return {pair: fit for pair, fit in fits.items() if fit.state == "constrained"}


def _residual_deg(
    rotations: FloatArray, stated: FloatArray, pair: tuple[int, int], fit: PairFit
) -> float | None:
    if fit.state != "constrained":
        return None
    return float(np.degrees(np.linalg.norm(_gap(rotations, stated, pair, fit))))


def _degrees(rotation: FloatArray) -> float:
    return float(np.degrees(np.linalg.norm(vector_of(rotation))))


def _gap(
    rotations: FloatArray, stated: FloatArray, pair: tuple[int, int], fit: PairFit
) -> FloatArray:
    """Return the rotation from the second view to where the first one wants it [rad]."""
    first, second = pair
    wanted = rotations[first] @ stated[first].T @ fit.rotation
    return vector_of(wanted @ rotations[second].T)


def _root_mean_square(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return float(np.sqrt(np.mean(np.square(known)))) if known else None


def _reconciled(stated: FloatArray, fits: Fits) -> FloatArray:
    """Return the rotations that fit the pairs best, by reweighted least squares (Cauchy)."""
    rotations = stated.copy()
    count, measured = len(stated), _measured(fits)
    for _ in range(_ROUNDS):
        normal, right = np.zeros((count, 3, count, 3)), np.zeros((count, 3))
        for (i, j), fit in measured.items():
            gap = _gap(rotations, stated, (i, j), fit)
            frame = rotations[i] @ stated[i].T
            weight = 1.0 / (1.0 + (np.linalg.norm(gap) / np.radians(_OUTLIER_DEG)) ** 2)
            information = weight * frame @ fit.information @ frame.T
            for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
                normal[a, :, b] += sign * information
            right[i] -= information @ gap
            right[j] += information @ gap
        # The shortest of the steps that fit equally: none where nothing is known.
        inverse = np.linalg.pinv(normal.reshape(3 * count, 3 * count), rcond=1e-9, hermitian=True)
        steps = (inverse @ right.ravel()).reshape(count, 3)
        rotations = np.array(
            [rotation_by(step) @ old for step, old in zip(steps, rotations, strict=True)]
        ).reshape(-1, 3, 3)
        if not (np.abs(steps) > 1e-12).any():
            break
    for group in _groups(count, measured):
        rotations[group] = _nearest(rotations[group], stated[group])
    return rotations


def _groups(count: int, fits: Fits) -> list[list[int]]:
    """Return the views that hang together."""
    groups = [{index} for index in range(count)]
    for pair in fits:
        joined = [group for group in groups if group & set(pair)]
        groups = [group for group in groups if not group & set(pair)] + [set().union(*joined)]
    return [sorted(group) for group in groups if len(group) > 1]


def _nearest(rotations: FloatArray, stated: FloatArray) -> FloatArray:
    """Turn all by one rotation, so that they differ least from the stated ones.

    Least squares as long as all differ little; one view stated wrongly does not turn the others.
    """
    bound = np.radians(_SMALL_DEG)
    for _ in range(_ROUNDS):
        differences = np.array(
            [vector_of(old @ new.T) for new, old in zip(rotations, stated, strict=True)]
        )
        weights = (bound / np.maximum(np.linalg.norm(differences, axis=1), bound)) ** 2
        rotations = rotation_by(weights @ differences / weights.sum()) @ rotations
    return rotations


def _notes(
    views: Sequence[AlignView], pyramids: Sequence[list[Level]], fits: Fits, alignment: Alignment
) -> list[Note]:
    """Return a note on every stated rotation that the overlaps contradict."""
    notes = [
        Note(
            "rotation-far-off",
            view.name,
            f"the overlaps show it {change:.1f} deg from its stated rotation; correct that in the "
            "shoot layer",
        )
        for view, change in zip(views, alignment.change_deg, strict=True)
        if change > _FAR_OFF_DEG
    ]
    worst = max(alignment.pairs, key=lambda pair: pair.residual_after_deg or 0.0, default=None)
    if worst is not None and (worst.residual_after_deg or 0.0) > _DISAGREEMENT_DEG:
        notes.append(
            Note(
                "rotations-disagree",
                worst.second,
                f"no rotations fit all overlaps: with {worst.first} {worst.residual_after_deg:.2f} "
                "deg are left; the lens moved between the views instead of turning about its "
                "entrance pupil, or its calibration is off",
            )
        )
    return notes + _contradictions(views, pyramids, fits)


def _contradictions(
    views: Sequence[AlignView], pyramids: Sequence[list[Level]], fits: Fits
) -> list[Note]:
    """Return a note on every view that contradicts others and agrees with none."""
    agreeing = {index for pair in _measured(fits) for index in pair}
    against = [pair for pair, fit in fits.items() if fit.state == "contradicting"]
    lost = sorted({index for pair in against for index in pair} - agreeing)
    exchanged = _exchanged(views, pyramids, lost) if len(lost) > 1 else []
    hint = ""
    if exchanged:
        listed = " or ".join(f"{views[i].name} and {views[j].name}" for i, j in exchanged)
        hint = f" (all agree when the rotations of {listed} are exchanged)"
    notes = []
    for index in lost:
        others = ", ".join(views[i + j - index].name for i, j in against if index in (i, j))
        notes.append(
            Note(
                "rotation-contradicted",
                views[index].name,
                f"shows other things than {others} where they should overlap; correct its rotation "
                f"in the shoot layer{hint}",
            )
        )
    return notes


def _exchanged(
    views: Sequence[AlignView], pyramids: Sequence[list[Level]], lost: list[int]
) -> list[tuple[int, int]]:
    """Return which two views' rotations can be exchanged so that no pair contradicts another."""
    found = []
    for i, j in combinations(lost, 2):
        tried = list(views)
        tried[i] = replace(views[i], rotation=views[j].rotation)
        tried[j] = replace(views[j], rotation=views[i].rotation)
        if _agree(tried, pyramids):
            found.append((i, j))
    return found


def _agree(views: Sequence[AlignView], pyramids: Sequence[list[Level]]) -> bool:
    is_constrained = False
    for i, j in combinations(range(len(views)), 2):
        fit = fit_pair(views[i], views[j], pyramids[i], pyramids[j], search_deg=0.0)
        if fit.state == "contradicting":
            return False
        is_constrained |= fit.state == "constrained"
    return is_constrained
