"""Do the camera values of a chart belong to its spectra, and which patches can be used?"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import LayerError
from usdskin.estimate.chart.fit import fit_spectra, patch_errors
from usdskin.estimate.chart.layouts import Layout
from usdskin.estimate.chart.orders import laid_out_otherwise, listed_otherwise
from usdskin.notes import Note

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

LARGEST_ERROR = 0.15
"""Median residual of a chart whose camera values can belong to its spectra. Over 17 measured
cameras, 5 lights, Classic 24 and Digital SG it is 0.015 at most with 1 % noise and 0.042 with 3 %,
and 0.43 at least in a wrong order; four photographs with the lamp's nominal spectrum and published
reflectances came to 0.06 to 0.09."""

USUAL_ERROR = 0.05
"""Above this something is amiss, though the patches are in order."""

_LEAST_PATCHES = 3
_LEAST_TO_JUDGE = 8  # with fewer the prediction of one from the others says little
_CLIPPED_SHARE = 0.005
_DARK_SIGMAS = 5.0
_OUTLIER_ERROR = 0.2
_OUTLIER_RATIO = 8.0
_OUTLIER_SHARE = 0.2  # of the patches; if more are out of line there is no line
_SUSPECTS = 6
_LEAST_SPREAD = 0.01
"""Third over first singular value of the patches' chromaticities: 0.019 at least for Classic 24
with 19 measured cameras and 5 lights, below 0.008 for its greys at 1 % noise."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchCheck:
    """Which patches can be used, and how well they follow their spectra."""

    keep: Mask
    """Whether each patch can be used, shape [patch_count]."""

    errors: FloatArray
    """Relative error with which each patch is predicted from the others [1], NaN where it was not,
    shape [patch_count]."""

    typical_error: float
    """Its median; NaN for charts of too few patches."""


def check_patches(
    where: str,
    names: Sequence[str],
    camera_values: ArrayLike,
    signals: ArrayLike,
    *,
    layout: Layout | None = None,
    stddev: ArrayLike | None = None,
    clipped: ArrayLike | None = None,
    notes: list[Note] | None = None,
) -> PatchCheck:
    """Leave out the patches that cannot be used, and refuse a chart that is not in order.

    Saturated, black and outlying patches are left out and named. Camera values in another order
    than the spectra, and two patches in each other's place, are recognised by what mends them.

    Args:
        where: Layer and prim path, for errors and notes.
        names: Names of the patches, shape [patch_count].
        camera_values: rho, shape [patch_count, 3].
        signals: Radiance of the patches in any unit, or reflectance times the lamp, shape
            [patch_count, band_count].
        layout: Chart whose patches the names mean, all of them or some; None: not known.
        stddev: Standard error of the camera values; None: not known. Shape [patch_count, 3].
        clipped: Share of each patch's pixels that are saturated [1], shape [patch_count].
        notes: Takes which patches were left out, and why.

    Raises:
        LayerError: Camera values and spectra do not belong together, fewer than 3 patches can be
            used, or they are all of one or two colors.
    """
    notes = [] if notes is None else notes
    values, spectra = np.asarray(camera_values, np.float64), np.asarray(signals, np.float64)
    if values.shape != (len(names), 3) or len(spectra) != len(names):
        raise ValueError(f"{len(names)} names, camera values {values.shape}, {spectra.shape}")
    keep = _usable(where, names, values, spectra, stddev, clipped, notes)
    _refuse_few(where, names, keep)
    errors = np.full(len(names), np.nan)
    typical = np.nan
    if np.count_nonzero(keep) >= _LEAST_TO_JUDGE:
        _refuse_wrong_order(where, names, values, spectra, keep, layout)
        keep = _without_outliers(where, names, values, spectra, keep, notes)
        errors = _errors(values, spectra, keep)
        typical = float(np.nanmedian(errors))
        _note_unusual(where, typical, notes)
    _refuse_few(where, names, keep)
    _refuse_collinear(where, values[keep])
    return PatchCheck(keep, errors, typical)


def _usable(
    where: str,
    names: Sequence[str],
    values: FloatArray,
    spectra: FloatArray,
    stddev: ArrayLike | None,
    clipped: ArrayLike | None,
    notes: list[Note],
) -> Mask:
    """Return which patches are neither saturated nor black."""
    saturated = np.zeros(len(names), bool)
    if clipped is not None:
        saturated = np.asarray(clipped) > _CLIPPED_SHARE
    noise = np.zeros_like(values) if stddev is None else np.asarray(stddev, np.float64)
    black = ~saturated & (values <= _DARK_SIGMAS * noise).all(axis=1)
    unlit = ~saturated & ~black & (spectra.mean(axis=1) <= 0.0)
    reasons = (
        (saturated, "patch-saturated", "saturated in the shortest exposure", "add a shorter one"),
        (black, "patch-black", "no brighter than the noise", "add a longer exposure"),
        (unlit, "patch-without-signal", "without a signal", "measure them again"),
    )
    for found, code, what, remedy in reasons:
        if found.any():
            notes.append(Note(code, where, f"left out, {what}: {_listed(names, found)}; {remedy}"))
    return np.asarray(~(saturated | black | unlit))


def _refuse_few(where: str, names: Sequence[str], keep: Mask) -> None:
    count = int(np.count_nonzero(keep))
    if count < _LEAST_PATCHES:
        left = f", {_listed(names, keep)}" if count else ""
        raise LayerError(
            f"{where}: {count} of its {len(names)} patches can be used{left}; a camera of three "
            "channels needs 3 patches at least, and 24 are a good number: photograph the chart "
            "with more exposures"
        )


def _refuse_wrong_order(
    where: str,
    names: Sequence[str],
    values: FloatArray,
    spectra: FloatArray,
    keep: Mask,
    layout: Layout | None,
) -> None:
    """Refuse camera values that follow the spectra in another order, and say in which."""
    error = fit_spectra(spectra[keep]).error(values[keep])
    if error <= USUAL_ERROR:
        return
    tried = [(values, spectra, keep, list(listed_otherwise(len(values))))]
    if layout is not None and (scattered := _scattered(layout, names, values, spectra, keep)):
        # Named first: turned by 180 degrees is listed from the last to the first, too.
        tried.insert(0, (*scattered, list(laid_out_otherwise(layout))))
    best, said = 0.5 * error, ""
    for some_values, some_spectra, usable, orders in tried:
        for what, order in orders:
            both = usable & usable[order]
            if np.count_nonzero(both) < _LEAST_TO_JUDGE:
                continue
            other = fit_spectra(some_spectra[both]).error(some_values[order][both])
            if other < min(best, LARGEST_ERROR):
                best, said = other, what
    if said:
        raise LayerError(
            f"{where}: the patches' camera values look {said}: they follow the spectra to "
            f"{best:.1%} then, but to {error:.1%} as they are; correct chart:corners (top left, "
            "top right, bottom right, bottom left), or the order of the file"
        )


def _scattered(
    layout: Layout, names: Sequence[str], values: FloatArray, spectra: FloatArray, keep: Mask
) -> tuple[FloatArray, FloatArray, Mask] | None:
    """Return values, spectra and mask of all patches of a layout; None: other names, or twice."""
    found = [layout.index(name) for name in names]
    index = [k for k in found if k is not None]
    if len(index) < len(names) or len(set(index)) < len(names):
        return None
    count = len(layout.names)
    all_values, all_spectra = np.ones((count, 3)), np.ones((count, spectra.shape[1]))
    all_keep = np.zeros(count, bool)
    all_values[index], all_spectra[index], all_keep[index] = values, spectra, keep
    return all_values, all_spectra, all_keep


def _without_outliers(
    where: str,
    names: Sequence[str],
    values: FloatArray,
    spectra: FloatArray,
    keep: Mask,
    notes: list[Note],
) -> Mask:
    """Leave out, one after another, the patches that lie far from what the others say."""
    kept = keep.copy()
    left_out: dict[int, float] = {}
    most = max(int(_OUTLIER_SHARE * np.count_nonzero(keep)), 1)
    while True:
        errors = _errors(values, spectra, kept)
        typical = float(np.nanmedian(errors))
        if np.nanmax(errors) <= max(_OUTLIER_ERROR, _OUTLIER_RATIO * typical):
            break
        if len(left_out) == most or np.count_nonzero(kept) <= _LEAST_TO_JUDGE:
            typical = np.inf
            break
        worst = _worst(values, spectra, kept, errors)
        left_out[worst] = float(errors[worst])
        kept[worst] = False
    if typical > LARGEST_ERROR:
        off = float(np.nanmedian(_errors(values, spectra, keep)))
        raise LayerError(
            f"{where}: the patches' camera values do not follow their spectra: half of them are "
            f"off by {off:.1%} and more, where 1 to 3 % is usual; check the corners, the names and "
            "their order, and that the pictures are linear"
        )
    _refuse_swapped(where, names, values, spectra, kept, left_out)
    for k, error in left_out.items():
        text = f"left out patch {names[k]}: its camera value is {error:.0%} from what the other "
        text += "patches predict of its spectrum; look for dust or a glint, or measure it again"
        notes.append(Note("patch-outlier", where, text))
    return kept


def _note_unusual(where: str, typical: float, notes: list[Note]) -> None:
    if typical > USUAL_ERROR:
        what = f"half of the patches are off by {typical:.1%} and more from what the others predict"
        remedy = (
            "are the pictures linear, evenly lit and free of glare, and the spectra this chart's?"
        )
        text = f"{what} of their spectra, where 1 to 3 % is usual; {remedy}"
        notes.append(Note("patches-doubtful", where, text))


def _worst(values: FloatArray, spectra: FloatArray, kept: Mask, errors: FloatArray) -> int:
    """Return the patch without which the others fit best; it need not stick out the most itself."""
    suspects = np.argsort(np.nan_to_num(errors, nan=-1.0))[::-1][:_SUSPECTS]
    rest = []
    for suspect in suspects:
        without = kept.copy()
        without[suspect] = False
        rest.append(np.nanmean(np.minimum(_errors(values, spectra, without), 1.0)))
    return int(suspects[int(np.argmin(rest))])


def _errors(values: FloatArray, spectra: FloatArray, kept: Mask) -> FloatArray:
    """Return the error of each patch that is kept, NaN of the others, shape [patch_count]."""
    errors = np.full(len(values), np.nan)
    errors[kept] = patch_errors(fit_spectra(spectra[kept]).residuals(values[kept]))
    return errors


def _refuse_swapped(
    where: str,
    names: Sequence[str],
    values: FloatArray,
    spectra: FloatArray,
    kept: Mask,
    left_out: dict[int, float],
) -> None:
    """Refuse two outliers that fit in each other's place."""
    for i, j in combinations(sorted(left_out), 2):
        with_both = kept.copy()
        with_both[[i, j]] = True
        swapped = values.copy()
        swapped[[i, j]] = values[[j, i]]
        found = _errors(swapped, spectra, with_both)
        if max(found[i], found[j]) <= max(0.25 * min(left_out[i], left_out[j]), USUAL_ERROR):
            raise LayerError(
                f"{where}: the patches {names[i]} and {names[j]} look swapped: exchanged, they "
                f"follow their spectra to {max(found[i], found[j]):.1%}, but are off by "
                f"{max(left_out[i], left_out[j]):.0%} as they are; correct the names or the order"
            )


def _refuse_collinear(where: str, values: FloatArray) -> None:
    """Refuse patches whose colors span less than three dimensions."""
    rows = values / np.linalg.norm(values, axis=1, keepdims=True)
    level = np.sqrt(np.square(rows).mean(axis=0))
    spread = np.linalg.svd(rows / np.where(level > 0.0, level, 1.0), compute_uv=False)
    if spread[2] <= _LEAST_SPREAD * spread[0]:
        raise LayerError(
            f"{where}: the {len(values)} patches that can be used are nearly of one or two colors "
            f"(singular values {', '.join(f'{value:.2g}' for value in spread / spread[0])}); add "
            "patches of other hues"
        )


def _listed(names: Sequence[str], mask: Mask) -> str:
    found = [name for name, listed in zip(names, mask, strict=True) if listed]
    return ", ".join(found[:8]) + (f" and {len(found) - 8} more" if len(found) > 8 else "")
