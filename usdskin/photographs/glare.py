"""Veiling glare: light that lens and camera spread evenly over the picture.

The model is that of ``fisheye:glare``: a picture I becomes (1 - g) I + g mean(I), where the mean
goes over the circle that holds picture. The mean stays, so the inverse needs nothing but g.
ISO 18844 measures g as the veiling glare index: what a black spot shows in an even bright field.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usdskin.fisheye import max_radius
from usdskin.prims import FisheyeLens

_ROWS = 256


def subtract_glare(
    values: NDArray[np.float32], variance: NDArray[np.float32], lens: FisheyeLens
) -> NDArray[np.float64]:
    """Take the veil out of image values, in place.

    Args:
        values: I before division by the vignetting [1/s], shape [height, width, 3].
        variance: Its variance [s^-2], shape [height, width, 3].
        lens: Lens of the pictures, in their size; ``lens.glare`` is g.

    Returns:
        The veil that was in every pixel, g mean(I) [1/s], shape [3].
    """
    if lens.glare == 0.0:
        return np.zeros(3)
    veil = lens.glare * circle_mean(values, lens)
    factor = np.float32(1.0 / (1.0 - lens.glare))
    for begin in range(0, len(values), _ROWS):
        rows = slice(begin, begin + _ROWS)
        values[rows] -= veil.astype(np.float32)
        values[rows] *= factor
        variance[rows] *= factor * factor
    return veil


def circle_mean(values: NDArray[np.float32], lens: FisheyeLens) -> NDArray[np.float64]:
    """Return the mean over the pixels whose middle lies within the largest angle, shape [3]."""
    height, width = values.shape[:2]
    x = np.arange(width) + 0.5 - lens.center_px[0]
    y = np.arange(height) + 0.5 - lens.center_px[1]
    half = np.sqrt(np.maximum(max_radius(lens) ** 2 - y**2, 0.0))
    first = np.searchsorted(x, -half, side="left")
    last = np.searchsorted(x, half, side="right")
    last = np.where(np.abs(y) <= max_radius(lens), last, first)
    total = np.zeros(3)
    for row in range(height):
        total += values[row, first[row] : last[row]].sum(axis=0, dtype=np.float64)
    return np.asarray(total / max(int((last - first).sum()), 1))
