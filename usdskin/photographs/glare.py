"""Veiling glare: light that lens and camera spread evenly over the picture.

The model is that of ``fisheye:glare``: a picture I becomes (1 - g) I + g mean(I), where the mean
goes over the circle that holds picture. The mean stays, so the inverse needs nothing but g.
ISO 18844 measures g as the veiling glare index: what a black spot shows in an even bright field.
Beyond the image circle there is nothing else to be seen, in any picture.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usdskin.fisheye import max_radius
from usdskin.notes import Note
from usdskin.prims import FisheyeLens

_ROWS = 256

_BEYOND = 1.08
"""Least distance from the axis at which no picture is drawn, over the radius that holds picture:
lenses draw a little more than they state."""

_LEAST_PIXELS = 64
"""Of a corner, for it to count."""

_SIGNIFICANT = 4.0
"""Standard errors from which on a veil is one."""

_LARGEST = 0.05
"""Most that is taken for glare."""

_UNEVEN = 2.0
"""Most that corners differ by where what they hold is glare."""


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


def find_glare(
    values: NDArray[np.float32],
    variance: NDArray[np.float32],
    lens: FisheyeLens,
    where: str,
    notes: list[Note],
) -> float:
    """Return g as the corners of a picture show it, beyond the image circle.

    Args:
        values: I before division by the vignetting [1/s], shape [height, width, 3].
        variance: Its variance [s^-2], shape [height, width, 3].
        lens: Lens of the pictures, in their size.
        where: Of which view this is.
        notes: Told where the corners hold something else.

    Returns:
        g [1], of the darkest corner; 0 where there are no corners, or nothing is in them.
    """
    shares = corner_shares(values, variance, lens)
    least, most = (0.0, 0.0) if not len(shares) else (float(shares.min()), float(shares.max()))
    if least <= 0.0:
        return 0.0
    if most <= min(_LARGEST, _UNEVEN * least):
        return least
    notes.append(
        Note(
            "glare-unclear",
            where,
            f"beyond the image circle the corners hold {100.0 * least:.1f} to {100.0 * most:.1f} % "
            "of the picture's mean, which is no even veil, so none is subtracted; state "
            "fisheye:glare, or check fisheye:maxAngle and the black level",
        )
    )
    return 0.0


def corner_shares(
    values: NDArray[np.float32], variance: NDArray[np.float32], lens: FisheyeLens
) -> NDArray[np.float64]:
    """Return what corners hold beyond the image circle, over the mean within it.

    Args:
        values: I [1/s], shape [height, width, 3].
        variance: Its variance [s^-2], shape [height, width, 3].
        lens: Lens of the pictures, in their size.

    Returns:
        Of each corner that is large enough, 0 where it is noise, shape [count].
    """
    height, width = values.shape[:2]
    x = np.arange(width) + 0.5 - lens.center_px[0]
    y = np.arange(height) + 0.5 - lens.center_px[1]
    least = (_BEYOND * max_radius(lens)) ** 2
    count, total, noise = np.zeros(4), np.zeros(4), np.zeros(4)
    for row in range(height):
        beyond = np.flatnonzero(x * x + y[row] * y[row] > least)
        corner = 2 * int(y[row] > 0.0) + (x[beyond] > 0.0)
        count += np.bincount(corner, minlength=4)
        total += np.bincount(corner, values[row, beyond].sum(axis=1, dtype=np.float64), 4)
        noise += np.bincount(corner, variance[row, beyond].sum(axis=1, dtype=np.float64), 4)
    mean = float(circle_mean(values, lens).sum())
    kept = count >= (_LEAST_PIXELS if mean > 0.0 else np.inf)
    is_veiled = total[kept] > _SIGNIFICANT * np.sqrt(noise[kept])
    return np.asarray(np.where(is_veiled, total[kept] / count[kept] / max(mean, 1e-300), 0.0))


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
