"""Whether captures with single classes of lamps bear the names of their own lamps.

Where two lamps light one surface its color cancels in the ratio of what they give there (von
Kries), so the ratio has the chromaticity of one lamp over that of the other, whatever the place.
"""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.estimate.classes.lamps import Lamps, chromaticity
from usdskin.latlong import texel_solid_angles
from usdskin.prims import CapturedPanorama

FloatArray = NDArray[np.float64]

_REFUSED = -0.5
"""Measured difference of two lamps along what it should be, which is 1; interchanged it is -1."""


def check_names(
    given: Mapping[str, FloatArray], alone: Mapping[str, CapturedPanorama], lamps: Lamps
) -> None:
    """Refuse captures whose names are interchanged.

    Args:
        given: What each class gives around every direction, camera values on one scale, shape
            [rows, 2 rows, 3] each.
        alone: The captures; one class at most has none.
        lamps: The lamps of the calibration.

    Raises:
        LayerError: The light of one class over that of another has the color of the other over
            the one.
    """
    where = dict(zip(lamps.names, lamps.chromaticities, strict=True))
    for one, other in combinations(given, 2):
        expected = where[one] - where[other]
        found = _difference(given[one], given[other])
        if found @ expected > _REFUSED * (expected @ expected):
            continue
        names = [name for name in (one, other) if name in alone]
        who = ", ".join(f"{name} ({alone[name].where})" for name in names)
        if len(names) == 2:
            text = f"have the color of each other's lamps: {one} over {other}"
            cure = "interchange the two names"
        else:
            left = other if names[0] == one else one
            text = f"has the color of {left}, what it leaves that of {names[0]}: {one} over {other}"
            cure = f"call it {left}"
        is_ratio, to_be = np.exp(found), np.exp(expected)
        raise LayerError(
            f"--class-capture {who}: {text} is {is_ratio[0]:.2f} in R/G and {is_ratio[1]:.2f} in "
            f"B/G, and the calibration says {to_be[0]:.2f} and {to_be[1]:.2f}; {cure}"
        )


def _difference(one: FloatArray, other: FloatArray) -> FloatArray:
    """Return the difference of two classes in chromaticity where both shine, shape [2]."""
    sizes = texel_solid_angles(*one.shape[:2])[:, None]
    weights = sizes * np.minimum(one.min(axis=2), other.min(axis=2))
    lit = weights > 0.0
    if not lit.any():
        return np.zeros(2)
    apart = chromaticity(one[lit]) - chromaticity(other[lit])
    return np.asarray(np.average(apart, axis=0, weights=weights[lit]))
