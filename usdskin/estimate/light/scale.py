"""The factor by which a reading corrects the scale of the recovered light."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.estimate.light.totals import Readings, Totals
from usdskin.latlong import latlong_from_world
from usdskin.notes import Note
from usdskin.prims import CapturedPanorama

FloatArray = NDArray[np.float64]

_DIFFERENCE = 0.1
"""Relative difference from which a note is made [1]."""

_CLIPPED_SHARE = 0.005
"""Share of clipped light up to which an illuminance reading counts [1]."""

_COVERAGE = 0.98
"""Share of the sphere that has to be seen for that [1]."""


@dataclass(frozen=True, slots=True)
class LightScale:
    """What turns the recovered spectra into those of the place."""

    factor: float = 1.0
    """K, reading over recovered [1]."""

    source: str = "calibration"
    """``luminance``, ``illuminance``, ``both`` or ``calibration``."""

    reading: float = 0.0
    """The reading [cd m^-2 or lx], that of luminance where both count; 0: none."""

    recovered: float = 0.0
    """What the calibration alone gives there."""


def readings_of(capture: CapturedPanorama) -> Readings:
    """Return where the meters of a capture were held, in the panorama's frame.

    Raises:
        LayerError: A reading has no direction.
    """
    turn = latlong_from_world(capture.up_axis)
    found: list[FloatArray | None] = []
    for name, value, direction in (
        ("luminance", capture.luminance, capture.luminance_direction),
        ("illuminance", capture.illuminance_lx, capture.illuminance_direction),
    ):
        if value > 0.0 and direction is None:
            raise LayerError(
                f"{capture.where}: capture:{name} has a reading but capture:{name}:direction has "
                "no value; author where the meter looked, in the prim's own frame"
            )
        found.append(turn @ direction if value > 0.0 and direction is not None else None)
    return Readings(*found)


def find_scale(
    capture: CapturedPanorama,
    totals: Totals,
    luminance: FloatArray,
    is_absolute: bool,
    notes: list[Note],
) -> LightScale:
    """Return the factor that makes the recovered light give what a meter read.

    ``K = L_v / (683 ybar . e)`` with e the spectrum recovered at the spot, or ``K = E_v / (683
    ybar . E)`` with E the recovered spectral irradiance. Where there are both readings it is their
    geometric mean: one spot has the recovery's error of one colour, an illuminance that of the
    mixture. Light that was clipped or not seen is missing in the illuminance; then, and where the
    two disagree, the luminance alone counts.

    Args:
        capture: The readings.
        totals: What the light map gives where they were taken.
        luminance: Absolute luminance of the coefficients, as recovered [cd m^-2], shape [rank].
        is_absolute: Whether the calibration is absolute by itself.
        notes: Takes contradictions.

    Raises:
        LayerError: The recovered light is black where the meter was held.
    """
    given = []
    if totals.spot is not None:
        given.append(("luminance", capture.luminance, float(totals.spot @ luminance)))
    if totals.facing is not None:
        given.append(("illuminance", capture.illuminance_lx, float(totals.facing @ luminance)))
    if not given:
        return LightScale()
    source, reading, recovered = given[0]
    if not recovered > 0.0:
        raise LayerError(
            f"{capture.where}: capture:{source} was read where the recovered light is black; check "
            f"capture:{source}:direction"
        )
    scale = LightScale(reading / recovered, source, reading, recovered)
    if len(given) > 1 and _is_whole(capture) and given[1][2] > 0.0:
        other_factor = given[1][1] / given[1][2]
        if abs(other_factor / scale.factor - 1.0) <= _DIFFERENCE:
            factor = float(np.sqrt(scale.factor * other_factor))
            scale = LightScale(factor, "both", reading, recovered)
    if is_absolute and abs(scale.factor - 1.0) > _DIFFERENCE:
        notes.append(
            Note(
                "scale-differs",
                capture.where,
                f"the {source} reading is {reading / recovered:.3g} times what the calibration "
                "alone gives; the reading is used, but check exposures, ISO and filters of both",
            )
        )
    for other, read, shown in given[1:]:
        ratio = read / (shown * scale.factor) if shown > 0.0 else np.inf
        if abs(ratio - 1.0) > _DIFFERENCE:
            notes.append(
                Note(
                    f"{other}-differs",
                    capture.where,
                    f"the {other} reading is {ratio:.3g} times what the light gives when it "
                    f"is scaled by the {source}; clipped lamps may hold what is missing",
                )
            )
    return scale


def _is_whole(capture: CapturedPanorama) -> bool:
    """Return whether the panorama is known to hold all the light of the place."""
    clipped, coverage = capture.clipped_share, capture.coverage
    if clipped is None or coverage is None:
        return False
    return clipped <= _CLIPPED_SHARE and coverage >= _COVERAGE
