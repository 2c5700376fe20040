"""Which cells of a grid of patches are the chart: its place and turn are told by its colors.

What looks like a chart is often a part of it, or it and what lies beside it: the grid is right, but
off by whole cells or turned by quarters.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.chart.fit import SpectraFit
from usdskin.estimate.chart.layouts import Layout
from usdskin.estimate.chart.plane import UNIT_CORNERS, ChartPlane
from usdskin.estimate.chart.refine import interpolated

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.int64]

_REACH = 7  # cells beyond the grid, to each side
_SPREAD = 0.25  # of a patch's side: from its middle to the points that are read around it
_BATCH = 1024

_QUARTER = np.array([[0, -1], [1, 0]])
_TURNS = [np.linalg.matrix_power(_QUARTER, k) for k in range(4)]
_MIRROR = np.array([[-1, 0], [0, 1]])


def find_in_lattice(
    values: NDArray[np.float32], layout: Layout, plane: ChartPlane, fit: SpectraFit
) -> tuple[FloatArray, float] | None:
    """Return the corners of the chart in a grid that goes on beyond those it was found by.

    Args:
        values: Linear picture, shape [height, width, 3].
        layout: Which chart it is.
        plane: Some of its patches, or of what is beside it, as if they were all.
        fit: Predicts its camera values.

    Returns:
        Corners [px], shape [4, 2], and the least error of any other place; None: the chart is not
        there, or it is mirrored.
    """
    cells = _read_cells(values, layout, plane)
    errors, places = [], []
    for is_mirrored, turn in ((m, t) for m in (False, True) for t in _TURNS):
        matrix = turn @ _MIRROR if is_mirrored else turn
        for offsets, batch in _placements(cells, layout, matrix):
            errors.append(fit.quick_errors(batch))
            places += [(is_mirrored, matrix, offset) for offset in offsets]
    if not places:
        return None
    found = np.concatenate(errors)
    best = int(found.argmin())
    is_mirrored, matrix, offset = places[best]
    if is_mirrored:
        return None
    corners = plane.to_picture(_corners(layout, matrix, offset))
    if not np.isfinite(corners).all():
        return None
    return corners, float(np.delete(found, best).min()) if len(found) > 1 else np.inf


def _read_cells(values: NDArray[np.float32], layout: Layout, plane: ChartPlane) -> FloatArray:
    """Return the values at the middles of cells, NaN outside the picture.

    Returns:
        Shape [rows + 2 reach, columns + 2 reach, 3].
    """
    i = np.arange(-_REACH, layout.columns + _REACH, dtype=np.float64)
    j = np.arange(-_REACH, layout.rows + _REACH, dtype=np.float64)
    middle = np.stack(np.meshgrid(i, j), axis=-1)
    steps = np.array([-1.0, 0.0, 1.0]) * _SPREAD / (1.0 + layout.gap)
    around = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    at = plane.to_picture(_unit(layout, middle[:, :, None] + around))
    height, width = values.shape[:2]
    with np.errstate(invalid="ignore"):
        inside = np.all((at >= 0.0) & (at <= [width, height]), axis=(-1, -2))
    return np.where(
        np.asarray(inside)[..., None], np.median(interpolated(values, at), axis=2), np.nan
    )


def _placements(
    cells: FloatArray, layout: Layout, matrix: IndexArray
) -> Iterator[tuple[IndexArray, FloatArray]]:
    """Yield where the first patch may be and what the patches show then, a batch at a time.

    Yields:
        Cells of the first patch, x and y from that of the grid, shape [count, 2], and camera
        values, shape [count, patch_count, 3].
    """
    place = layout.positions @ matrix.T
    low, high = place.min(axis=0), place.max(axis=0)
    size = np.array([cells.shape[1], cells.shape[0]])
    x, y = (np.arange(-low[k], size[k] - high[k]) for k in (0, 1))
    offsets = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    for begin in range(0, len(offsets), _BATCH):
        some = offsets[begin : begin + _BATCH]
        at = some[:, None] + place
        batch = cells[at[..., 1], at[..., 0]]
        whole = np.isfinite(batch).all(axis=(1, 2)) & (batch > 0.0).any(axis=(1, 2))
        if whole.any():
            yield some[whole] - _REACH, batch[whole]


def _corners(layout: Layout, matrix: IndexArray, offset: IndexArray) -> FloatArray:
    """Return the corners of a chart in the grid, in coordinates of the grid, shape [4, 2]."""
    last = np.array([layout.columns, layout.rows]) - 1
    half = 0.5 / (1.0 + layout.gap)
    cell = UNIT_CORNERS * (last + 2.0 * half) - half
    return _unit(layout, offset + cell @ matrix.T)


def _unit(layout: Layout, cell: FloatArray) -> FloatArray:
    """Return the coordinates of cells, counted from the middle of the first, shape [..., 2]."""
    return np.asarray(layout.centers[0] + cell * 2.0 * layout.half_size * (1.0 + layout.gap))
