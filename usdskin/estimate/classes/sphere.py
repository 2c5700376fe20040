"""Sums and smoothing over latlong maps that know the seam, the poles and the size of texels."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_ROWS_PER_BLOCK = 64


def row_blocks(height: int) -> Iterator[slice]:
    """Yield rows of a map a block at a time."""
    for begin in range(0, height, _ROWS_PER_BLOCK):
        yield slice(begin, min(begin + _ROWS_PER_BLOCK, height))


def add_cells(total: FloatArray, values: NDArray[Any], rows: slice, height: int) -> None:
    """Add rows of a map to the cells of a coarser one that their texels' middles lie in.

    Args:
        total: Sums so far, shape [cell_rows, cell_columns, channels], changed in place.
        values: Rows of the map, shape [row_count, width, channels].
        rows: Which rows they are.
        height: Rows of the whole map.
    """
    cell_rows, cell_columns, _ = total.shape
    width = values.shape[1]
    edges = _first_texels(cell_columns, width)
    across = np.add.reduceat(values, edges, axis=1, dtype=np.float64)
    where = (2 * np.arange(rows.start, rows.stop) + 1) * cell_rows // (2 * height)
    np.add.at(total, where, across)


def _first_texels(cell_count: int, width: int) -> NDArray[np.intp]:
    """Return the first texel of each cell; there are as many texels as cells or more."""
    where = (2 * np.arange(width) + 1) * cell_count // (2 * width)
    return np.searchsorted(where, np.arange(cell_count))


def smooth(values: FloatArray, radius: float) -> FloatArray:
    """Return sums over a map weighted by exp((cos angle - 1) / radius^2), von Mises-Fisher's law.

    It is the Gaussian of the sphere: rotations of the map and this commute. Around each row it is
    a convolution, done by Fourier transforms.

    Args:
        values: Amounts in each texel, not densities, shape [height, width, channels].
        radius: Standard deviation of a narrow kernel [rad].

    Returns:
        Sums, shape [height, width, channels].
    """
    height, width, _ = values.shape
    polar = (np.arange(height) + 0.5) * (np.pi / height)
    turn = np.arange(width) * (2.0 * np.pi / width)
    level, swing = np.outer(np.cos(polar), np.cos(polar)), np.outer(np.sin(polar), np.sin(polar))
    spectrum = np.fft.rfft(values, axis=1)
    result = np.empty_like(spectrum)
    for row in range(height):
        angle = level[row, :, None] + swing[row, :, None] * np.cos(turn) - 1.0
        kernel = np.fft.rfft(np.exp(angle / radius**2), axis=1)
        result[row] = np.einsum("jm,jmc->mc", kernel, spectrum)
    return np.fft.irfft(result, n=width, axis=1)


def spread(cells: FloatArray, rows: slice, height: int, width: int) -> NDArray[np.float32]:
    """Return rows of a finer map, interpolated linearly and across the seam.

    Args:
        cells: Coarse map, shape [cell_rows, cell_columns, channels].
        rows: Which rows of the finer map.
        height: Rows of the finer map.
        width: Columns of the finer map.

    Returns:
        Values, shape [row_count, width, channels].
    """
    cell_rows, cell_columns, _ = cells.shape
    coarse = cells.astype(np.float32)
    at = (np.arange(rows.start, rows.stop) + 0.5) * (cell_rows / height) - 0.5
    above = np.clip(np.floor(at), 0, max(cell_rows - 2, 0)).astype(np.intp)
    below = np.minimum(above + 1, cell_rows - 1)
    part = np.clip(at - above, 0.0, 1.0).astype(np.float32)[:, None, None]
    lines = (1.0 - part) * coarse[above] + part * coarse[below]
    at = (np.arange(width) + 0.5) * (cell_columns / width) - 0.5
    left = np.floor(at).astype(np.intp)
    part = (at - left).astype(np.float32)[:, None]
    nearest = (1.0 - part) * lines[:, left % cell_columns]
    nearest += part * lines[:, (left + 1) % cell_columns]
    return np.asarray(nearest)
