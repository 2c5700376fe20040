"""Readings as a lab may get them wrong: recognised before, or by, the fit."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.estimate.skin.covariance import Noise
from usdskin.estimate.skin.model import Coefficients, Freedom
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.solve import solve
from usdskin.notes import Note

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

LEAST_REACH_DEG = 92.0
"""Largest angle below which the Fisher matrix of l and Ss together is singular."""

LARGEST_VALUE = 3.0
"""Of a reading in steady light over E/pi; diffuse skin stays below 1, percents do not."""

_LEAST_READINGS = 4
_LEAST_SPREAD = 0.05
_SATURATED_COUNT = 3
_SATURATED_SPREAD = 0.03
_EXCHANGED_RATIO = 9.0
_EXCHANGED_ERROR = 0.03
_MOST_TO_JUDGE = 4000
_BAD_FIT = 0.05  # of the peak; light that diffuses far leaves up to .15 (docs/skin.md)
_NO_FIT = 0.2
_BEYOND_NOISE = 3.0


def usable(readings: Readings, notes: list[Note]) -> Mask:
    """Return which readings can be fitted: neither masked, nor saturated, nor seen from behind.

    Args:
        readings: All of them.
        notes: Takes what was left out.

    Returns:
        Mask, shape [q].

    Raises:
        LayerError: The mask leaves none, they are all at one angle, or none is lit.
    """
    where, count = readings.where, len(readings.values)
    assert readings.mask is not None
    keep = readings.mask.copy()
    if not keep.any():
        raise LayerError(
            f"{where}: the mask leaves none of its {count} readings; unmask those to be used"
        )
    behind = keep & (readings.view_cosine <= 0.0)
    if behind.any():
        _refuse_or_drop_behind(readings, keep, behind, notes)
        keep &= ~behind
    saturated = keep & _saturated(readings, keep)
    if saturated.any():
        top = readings.values[saturated].max()
        notes.append(
            Note(
                "readings-saturated",
                where,
                f"{np.count_nonzero(saturated)} of {count} readings share the largest value "
                f"({top:.4g}) at different angles and are left out as saturated; expose shorter",
            )
        )
        keep &= ~saturated
    _refuse_few(readings, keep)
    return keep


def _refuse_or_drop_behind(readings: Readings, keep: Mask, behind: Mask, notes: list[Note]) -> None:
    where = readings.where
    number, total = int(np.count_nonzero(behind)), int(np.count_nonzero(keep))
    first = int(np.flatnonzero(behind)[0])
    angle = float(np.degrees(np.arccos(readings.view_cosine[first])))
    if number > 0.2 * total or readings.theta_deg[keep].max() <= 90.0:
        raise LayerError(
            f"{where}: reading [{first}]: the camera is {angle:.4g} degrees from the normal and "
            "cannot see the skin; are light and view exchanged, or the normals turned over?"
        )
    notes.append(
        Note(
            "readings-from-behind",
            where,
            f"{number} of {total} readings have the camera behind the surface (reading [{first}]: "
            f"{angle:.4g} degrees) and are left out; correct their view or normal",
        )
    )


def _saturated(readings: Readings, keep: Mask) -> Mask:
    """Return the readings with a channel at a common top value that angles do not explain."""
    result = np.zeros(len(keep), bool)
    cosine = readings.cosine
    for values in readings.values.T:
        top = float(values[keep].max())
        same = keep & (values >= top - 1e-6 * abs(top))
        wide = float(np.ptp(cosine[same])) if same.any() else 0.0
        if top > 0.0 and np.count_nonzero(same) >= _SATURATED_COUNT and wide > _SATURATED_SPREAD:
            result |= same
    return result


def _refuse_few(readings: Readings, keep: Mask) -> None:
    where, cosine = readings.where, readings.cosine[keep]
    number = int(np.count_nonzero(keep))
    if number < _LEAST_READINGS:
        raise LayerError(
            f"{where}: {number} readings can be used; {_LEAST_READINGS} at least are needed, and "
            "24 over 0 to 110 degrees are a good number: add readings"
        )
    angles = readings.theta_deg[keep]
    if np.ptp(cosine) < _LEAST_SPREAD:
        raise LayerError(
            f"{where}: all {number} usable readings have the light at {angles.min():.4g} to "
            f"{angles.max():.4g} degrees from the normal; how brightness falls with the angle "
            "cannot be seen there: add readings up to 110 degrees"
        )
    if cosine.max() <= 0.0:
        raise LayerError(
            f"{where}: no usable reading is lit from the front (the least angle is "
            f"{angles.min():.4g} degrees); turn the light directions or normals over, or add "
            "readings below 90 degrees"
        )


def refuse_percent(readings: Readings) -> None:
    """Refuse readings of a size that a share of the light cannot have.

    Args:
        readings: All of them are used.

    Raises:
        LayerError: The median of what is lit from the front is above 3.
    """
    lit = readings.cosine > 0.5
    lit = lit if lit.any() else readings.cosine > 0.0
    typical = np.median(readings.values[lit], axis=0)
    worst = int(np.argmax(typical))
    if typical[worst] > LARGEST_VALUE:
        kind = "percent" if typical[worst] <= 120.0 else "values that are not over E/pi"
        raise LayerError(
            f"{readings.where}: channel {readings.names[worst]} reads {typical[worst]:.4g} where "
            f"a perfect diffuser reads 1, so these seem to be {kind}; divide them by the reading "
            "of a white facing the light"
        )
    if typical[worst] <= 0.0:
        raise LayerError(
            f"{readings.where}: the readings are not above zero where the light is in front "
            f"(channel {readings.names[worst]}: {typical[worst]:.4g}); are the angles right, and "
            "the black level?"
        )


def refuse_short(readings: Readings, freedom: Freedom) -> None:
    """Refuse to tell l and Ss apart from readings before the shadow line.

    Below 90 degrees a channel shows ``cos (A + B/(1+l)) + B l/(1+l)``: two numbers, from which
    three cannot be had.

    Args:
        readings: All of them are used.
        freedom: What is to be found.

    Raises:
        LayerError: l and Ss are both free, and no angle is above 92 degrees.
    """
    reach = float(readings.theta_deg.max())
    if freedom.wrap and freedom.scattering is None and reach < LEAST_REACH_DEG:
        raise LayerError(
            f"{readings.where}: the light's angles end at {reach:.4g} degrees from the normal, and "
            f"below {LEAST_REACH_DEG:g} wrap and scattering cannot be told apart (many pairs fit "
            "equally); add readings up to 110 degrees, or state one of the two"
        )


def refuse_thickness(readings: Readings, freedom: Freedom) -> None:
    """Refuse to find delta without thicknesses that differ, and thicknesses without delta.

    Args:
        readings: All of them are used.
        freedom: What is to be found.

    Raises:
        LayerError: delta is free, but the thicknesses are not known, or all the same; or it is
            not, and what they take away would count as lack of reflectance.
    """
    thickness = readings.thickness
    if freedom.delta and (thickness is None or np.ptp(thickness) < 1e-9):
        known = "not known" if thickness is None else f"all {thickness[0]:g} m"
        rest = "leave opacity out" if thickness is None or thickness[0] == 0.0 else "without one"
        raise LayerError(
            f"{readings.where}: opacity cannot be found, because the thicknesses are {known} and "
            f"one thickness only scales the reflectance; measure through several, or {rest}"
        )
    if thickness is not None and thickness.any() and not freedom.delta:
        number = int(np.count_nonzero(thickness))
        raise LayerError(
            f"{readings.where}: {number} of {len(thickness)} readings are through up to "
            f"{thickness.max():g} m of the body, which takes light by its opacity; fit that too "
            "(--opacity fit), or mask them"
        )


def refuse_misfit(readings: Readings, rms: float, noise: float, notes: list[Note]) -> None:
    """Refuse readings that eq. (1) does not describe; note those that it describes badly.

    Args:
        readings: What was fitted.
        rms: Root mean square of what the fit leaves, as a share of the peak [1].
        noise: The same over the standard deviations stated or assumed [1].
        notes: Takes the note.

    Raises:
        LayerError: More than a fifth of the peak is left, and noise does not explain it.
    """
    if rms < _BAD_FIT or noise < _BEYOND_NOISE:
        return
    what = f"the fit leaves {rms:.1%} of the peak, {noise:.3g} times the noise"
    if rms > _NO_FIT:
        raise LayerError(
            f"{readings.where}: {what}, so equation (1) does not describe these readings; check "
            "their angles, their white, and that all are of one place under one lamp"
        )
    text = f"{what}: a poor fit, whose numbers stand for these readings only roughly; see --plot"
    notes.append(Note("poor-fit", readings.where, text))


def refuse_exchanged(readings: Readings, fixed: Coefficients, noise: Noise) -> None:
    """Refuse readings that eq. (1) explains far better with light and view exchanged.

    Args:
        readings: All of them are used.
        fixed: l where it is known.
        noise: Standard deviations, where readings have none.

    Raises:
        LayerError: The error of the exchanged fit is less than a third.
    """
    if readings.view is None:
        return
    step = max(1, len(readings.values) // _MOST_TO_JUDGE)
    some = readings.part(np.arange(0, len(readings.values), step))
    assert some.view is not None
    turned = replace(some, light=some.view, view=some.light)
    weights = 1.0 / noise.sigma(some.values) ** 2
    given, exchanged = (solve(each, Freedom(), fixed, weights).cost for each in (some, turned))
    size = float((weights * some.values**2).sum())
    if given > _EXCHANGED_RATIO * exchanged and given > _EXCHANGED_ERROR**2 * size:
        raise LayerError(
            f"{readings.where}: light and view seem to be exchanged: the readings follow the angle "
            f"of the view (error {np.sqrt(exchanged / size):.2g}) and not that of the light "
            f"(error {np.sqrt(given / size):.2g}); exchange the two"
        )
