"""What the capture room's surfaces look like: reflectances painted by formula, no files."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Paint = Callable[[FloatArray, FloatArray], FloatArray]
"""From two coordinates on a face [m] to reflectance of R, G, B [1], shape [count, 3]."""

FELT_RED, FELT_BLUE, FELT_OCHRE = (0.42, 0.10, 0.09), (0.10, 0.17, 0.34), (0.55, 0.36, 0.12)
SPINES = np.array(
    [
        (0.50, 0.14, 0.11), (0.13, 0.24, 0.42), (0.62, 0.55, 0.40), (0.18, 0.32, 0.20),
        (0.66, 0.45, 0.16), (0.08, 0.08, 0.09), (0.72, 0.70, 0.66), (0.36, 0.20, 0.32),
    ]
)  # fmt: skip


def noise(*cells: FloatArray) -> FloatArray:
    """Return a number of 0..1 for every cell of a grid, the same on every machine."""
    mixed = np.zeros(np.shape(cells[0]), dtype=np.uint64)
    for cell in cells:
        mixed = (mixed ^ (np.floor(cell).astype(np.int64).astype(np.uint64))) * np.uint64(
            0x9E3779B97F4A7C15
        )
        mixed ^= mixed >> np.uint64(29)
    return (mixed >> np.uint64(40)).astype(np.float64) / float(1 << 24)


def _tinted(level: FloatArray, color: tuple[float, float, float]) -> FloatArray:
    return np.asarray(level)[:, None] * np.array(color)


def plain(color: tuple[float, float, float]) -> Paint:
    """Return a paint of one colour."""
    return lambda s, t: _tinted(np.ones_like(s), color)


def plaster(color: tuple[float, float, float]) -> Paint:
    """Return a wall: patches a few centimetres wide that differ by some per cent."""
    return lambda s, t: _tinted(
        0.97 + 0.03 * noise(s / 0.23, t / 0.19) + 0.03 * noise(s / 0.9, t / 0.7), color
    )


def planks(s: FloatArray, t: FloatArray) -> FloatArray:
    """Return a floor of oak planks with dark joints."""
    across = t / 0.14 + 0.4
    row = np.floor(across)
    along = s / 1.3 + 0.61 * row
    tone = 0.75 + 0.5 * noise(row, along)
    joint = (np.mod(across, 1.0) < 0.05) | (np.mod(along, 1.0) < 0.008)
    return _tinted(np.where(joint, 0.25, tone), (0.36, 0.23, 0.13))


def rug(s: FloatArray, t: FloatArray) -> FloatArray:
    """Return a rug of lozenges."""
    first, second = np.mod(s + t, 0.4) < 0.2, np.mod(s - t, 0.4) < 0.2
    colors = np.array([FELT_RED, (0.22, 0.17, 0.13), (0.13, 0.15, 0.19), (0.38, 0.34, 0.28)])
    return np.asarray(colors[first * 2 + second])


def tiles(s: FloatArray, t: FloatArray) -> FloatArray:
    """Return a ceiling of square tiles with thin joints."""
    across, along = s / 0.6 + 0.35, t / 0.6 + 0.55
    joint = (np.mod(across, 1.0) < 0.035) | (np.mod(along, 1.0) < 0.035)
    return _tinted(np.where(joint, 0.45, 0.94 + 0.06 * noise(across, along)), (0.80, 0.80, 0.79))


def shelf(s: FloatArray, t: FloatArray) -> FloatArray:
    """Return book spines between boards; the gap above the books is nearly black."""
    board = np.mod(t, 0.36)
    level = np.floor(t / 0.36)
    book = s / 0.045 + 7.0 * noise(level, level)
    kind = noise(book, level)
    top = 0.22 + 0.10 * noise(book + 0.5, level + 3.0)
    color = SPINES[(kind * len(SPINES)).astype(int)]
    band = (np.abs(board - 0.18) < 0.012)[:, None]
    color = np.where(band, 0.5 * color + 0.35, color)
    color = np.where((board > top)[:, None], 0.015, color)
    return np.where((board < 0.03)[:, None], np.array((0.30, 0.20, 0.12)), color)


def poster(s: FloatArray, t: FloatArray) -> FloatArray:
    """Return a poster of coloured squares on white, no two rows alike."""
    column, row = s / 0.16, t / 0.16
    kind = (noise(column, row) * len(SPINES)).astype(int)
    edge = (np.mod(column, 1.0) < 0.12) | (np.mod(row, 1.0) < 0.12)
    return np.where(edge[:, None], 0.78, SPINES[kind])


def door(s: FloatArray, t: FloatArray) -> FloatArray:
    """Return a door of four panels."""
    across, up = np.mod(s, 0.45), np.mod(t, 1.0)
    panel = (across > 0.07) & (across < 0.38) & (up > 0.1) & (up < 0.9)
    return _tinted(np.where(panel, 0.85, 1.0), (0.30, 0.36, 0.33))


def foliage(s: FloatArray, t: FloatArray) -> FloatArray:
    """Return leaves, with gaps of shade between them."""
    leaf = noise(s / 0.035 + 0.5 * np.floor(t / 0.03), t / 0.03)
    return _tinted(np.where(leaf < 0.3, 0.25, 0.6 + 0.6 * leaf), (0.09, 0.21, 0.06))


def cushions(color: tuple[float, float, float]) -> Paint:
    """Return cloth with seams."""
    return lambda s, t: _tinted(
        np.where((np.mod(s, 0.6) < 0.02) | (np.mod(t, 0.4) < 0.02), 0.4, 1.0)
        * (0.9 + 0.1 * noise(s / 0.05, t / 0.05)),
        color,
    )
