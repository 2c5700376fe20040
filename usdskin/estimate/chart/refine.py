"""Move roughly known corners of a chart to where the gaps between its patches are."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import LayerError
from usdskin.estimate.chart.layouts import Layout
from usdskin.estimate.chart.plane import UNIT_CORNERS, ChartPlane, chart_plane
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

_SAMPLES = 24  # per pitch of the patches
_REACH = 0.45  # of the pitch: how far a gap is looked for
_MIDDLE = 0.5  # of a patch, over which the profile across a gap is averaged
_ROUNDS = 4
_TRIM_SIGMAS = 3.0


def refine_corners(
    values: NDArray[np.float32],
    layout: Layout,
    corners: ArrayLike,
    lens: FisheyeLens | None,
    where: str,
) -> FloatArray:
    """Return the corners for which the gaps between the patches lie where the layout has them.

    Args:
        values: Linear picture, shape [height, width, 3].
        layout: Which chart it is.
        corners: Corners, off by less than half the pitch of the patches [px], shape [4, 2].
        lens: Lens of the picture, in its size; None: the picture is taken for a flat one.
        where: Layer and prim path, for errors.

    Raises:
        LayerError: The corners are no view of a rectangle, or no gaps are seen there.
    """
    found = np.asarray(corners, np.float64)
    for _ in range(_ROUNDS):
        plane = chart_plane(found, lens, where)
        places, across, shifts, weights = _measure_gaps(values, layout, plane)
        if np.count_nonzero(weights) < 16:
            raise LayerError(f"{where}: no gaps between patches are seen inside the corners")
        found = plane.to_picture(_moved(places, across, shifts, weights))
        if not np.isfinite(found).all():
            raise LayerError(f"{where}: the gaps between patches lie on no plane")
    return found


def _measure_gaps(
    values: NDArray[np.float32], layout: Layout, plane: ChartPlane
) -> tuple[FloatArray, NDArray[np.int64], FloatArray, FloatArray]:
    """Return where gaps should be, the axis they are crossed along, how far off they are, and how
    sure that is.

    Returns:
        Chart coordinates, shape [gap_count, 2]; 0 for x and 1 for y, shape [gap_count]; shifts in
        chart coordinates, shape [gap_count]; weights, shape [gap_count].
    """
    pitch = 2.0 * layout.half_size * (1.0 + layout.gap)
    column, row = layout.positions.T
    steps = np.linspace(-_REACH, _REACH, 2 * int(_REACH * _SAMPLES) + 1)
    beside = np.linspace(-0.5, 0.5, 7) * _MIDDLE
    places, axes, shifts, weights = [], [], [], []
    for axis, last in ((0, column == layout.columns - 1), (1, row == layout.rows - 1)):
        middle = layout.centers[~last].copy()
        middle[:, axis] += 0.5 * pitch[axis]
        points = np.repeat(middle[:, None, None], len(steps), axis=1)
        points = np.repeat(points, len(beside), axis=2)
        points[..., axis] += pitch[axis] * steps[:, None]
        points[..., 1 - axis] += pitch[1 - axis] * beside
        profile = interpolated(values, plane.to_picture(points)).mean(axis=2)
        profile = np.sqrt(np.maximum(profile, 0.0))
        change = np.square(np.diff(profile, axis=1)).sum(axis=2)
        at = 0.5 * (steps[1:] + steps[:-1])
        total = change.sum(axis=1)
        with np.errstate(invalid="ignore"):
            shift = (change * at).sum(axis=1) / total
            # Edges spread over the whole window are texture, no gap.
            spread = np.sqrt((change * np.square(at - shift[:, None])).sum(axis=1) / total)
            shift -= _expected_shift(profile) * layout.gap / (1.0 + layout.gap)
        good = np.isfinite(shift) & (spread < 0.5 * _REACH)
        places.append(middle)
        axes.append(np.full(len(middle), axis))
        shifts.append(np.where(good, shift, 0.0) * pitch[axis])
        weights.append(np.where(good, np.sqrt(np.where(good, total, 0.0)), 0.0))
    return (
        np.concatenate(places),
        np.concatenate(axes),
        np.concatenate(shifts),
        np.concatenate(weights),
    )


def _expected_shift(profile: FloatArray) -> FloatArray:
    """Return where the changes across a gap have their middle, -0.5 .. 0.5 from edge to edge.

    The edge of a bright patch weighs more than that of a patch nearly as dark as the gap.

    Args:
        profile: Along a line across the gap, shape [gap_count, step_count, 3].
    """
    darkest = profile.min(axis=1)
    before, after = (np.square(profile[:, k] - darkest).sum(axis=1) for k in (0, -1))
    return np.asarray(0.5 * (after - before) / (after + before))


def _moved(
    places: FloatArray, axis: NDArray[np.int64], shifts: FloatArray, weights: FloatArray
) -> FloatArray:
    """Return the unit corners moved by the small homography that explains the shifts.

    To first order a homography moves (x, y) by (a0 + a1 x + a2 y + x (c1 x + c2 y),
    b0 + b1 x + b2 y + y (c1 x + c2 y)); one in which shifts agree is fitted robustly.
    """
    design = np.where(axis[:, None] == 0, _design(places, 0), _design(places, 1))
    weight: FloatArray = weights.copy()
    solution: FloatArray = np.zeros(8)
    for _ in range(_ROUNDS):
        solved = np.linalg.lstsq(design * weight[:, None], shifts * weight, rcond=None)[0]
        solution = np.asarray(solved, np.float64)
        off = np.asarray(np.abs(shifts - design @ solution))
        sigma = max(1.4826 * float(np.median(off[weights > 0.0])), 1e-6)
        weight = np.where(off <= _TRIM_SIGMAS * sigma, weights, 0.0)
    move = np.stack([_design(UNIT_CORNERS, k) @ solution for k in (0, 1)], axis=-1)
    return np.asarray(UNIT_CORNERS + move)


def _design(places: FloatArray, axis: int) -> FloatArray:
    """Return the coefficients of a0 a1 a2 b0 b1 b2 c1 c2 in one coordinate, shape [count, 8]."""
    x, y = places.T
    design = np.zeros((len(places), 8))
    design[:, 3 * axis : 3 * axis + 3] = np.stack([np.ones_like(x), x, y], axis=-1)
    design[:, 6:] = places[:, axis, None] * places
    return design


def interpolated(values: NDArray[np.float32], positions: FloatArray) -> FloatArray:
    """Return the picture at positions [px], bilinearly, of the nearest pixel beyond its edges."""
    height, width = values.shape[:2]
    finite = np.where(np.isfinite(positions), positions, 0.0) - 0.5
    x = np.clip(finite[..., 0], 0.0, width - 1.001)
    y = np.clip(finite[..., 1], 0.0, height - 1.001)
    i, j = y.astype(int), x.astype(int)
    down, right = (y - i)[..., None], (x - j)[..., None]
    top = values[i, j] * (1.0 - right) + values[i, j + 1] * right
    bottom = values[i + 1, j] * (1.0 - right) + values[i + 1, j + 1] * right
    return np.asarray(top * (1.0 - down) + bottom * down, np.float64)
