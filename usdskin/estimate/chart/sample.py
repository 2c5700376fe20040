"""Camera values of the patches of a chart in a picture.

A patch is taken in its middle, away from its edges and from what the lens smears over them. A plane
is fitted to its pixels, robustly, over the chart's own coordinates: its value at the middle of the
patch is what an instrument aimed there sees, however the light falls off over the patch, and
pixels that lie far from it (dust, a scratch, a glint) do not count.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import ImageError
from usdskin.estimate.chart.layouts import Layout
from usdskin.estimate.chart.plane import ChartPlane, chart_plane
from usdskin.photographs.merge import CLIPPED, MOVED
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

INNER_SHARE = 0.55
"""Side of what is taken of a patch, as a share of the patch's."""

_LEAST_PIXELS = 16
_BLOCKS = 3  # per direction: what varies within a patch is told from the means of 3 x 3 blocks
_ROUNDS = 4
_OUTLIER_SIGMAS = 4.0
_MAD_TO_SIGMA = 1.4826  # of a normal distribution
_AIM = 0.05  # of a patch's side: how far from its middle an instrument is set down
_EDGE_POINTS = 9


@dataclass(frozen=True, slots=True, eq=False)
class PatchSamples:
    """What a picture shows of the patches of a chart, in the order of its layout."""

    names: tuple[str, ...]
    """Shape [patch_count]."""

    values: FloatArray
    """Camera values at the middles of the patches, in the picture's unit, shape
    [patch_count, 3]."""

    stddev: FloatArray
    """Their standard error, from noise and from how uneven the patches are, shape
    [patch_count, 3]."""

    clipped: FloatArray
    """Share of the pixels that are saturated in every exposure [1], shape [patch_count]."""

    moved: FloatArray
    """Share of the pixels whose exposures contradict one another [1], shape [patch_count]."""

    evenness: FloatArray
    """Spread of the means of 3 x 3 blocks of a patch over its value, 0 where it is even [1], shape
    [patch_count]."""

    rejected: FloatArray
    """Share of the pixels that lie far from the others [1], shape [patch_count]."""


def sample_patches(
    values: NDArray[np.float32],
    variance: NDArray[np.float32] | None,
    status: NDArray[np.uint8] | None,
    layout: Layout,
    corners: ArrayLike,
    lens: FisheyeLens | None = None,
    *,
    where: str = "chart",
) -> PatchSamples:
    """Return the camera values of the patches of a chart.

    Args:
        values: Linear picture, shape [height, width, 3].
        variance: Variance of its values; None: unknown. Shape [height, width, 3].
        status: Bits ``CLIPPED`` and ``MOVED`` of ``usdskin.photographs.merge``; None: nothing is
            saturated. Shape [height, width].
        layout: Which chart it is.
        corners: Outer corners of the patches, see ``layouts`` [px], shape [4, 2].
        lens: Lens of the picture, in its size; None: the picture is taken for a flat one.
        where: Layer and prim path, for errors.

    Raises:
        LayerError: The corners are no view of a rectangle; see ``chart_plane``.
        ImageError: A patch lies outside the picture or is too small in it.
    """
    plane = chart_plane(corners, lens, where)
    half = layout.half_size * INNER_SHARE
    patches = []
    for name, center in zip(layout.names, layout.centers, strict=True):
        rows, columns, points = _inside(values.shape, plane, center, half, f"{where}: patch {name}")
        patches.append(
            _measure(
                values[rows, columns].astype(np.float64),
                None if variance is None else variance[rows, columns],
                np.zeros(len(rows), np.uint8) if status is None else status[rows, columns],
                (points - center) / half,
            )
        )
    columns_of = {key: np.array([patch[key] for patch in patches]) for key in patches[0]}
    return PatchSamples(layout.names, **columns_of)


def _inside(
    shape: tuple[int, ...], plane: ChartPlane, center: FloatArray, half: FloatArray, where: str
) -> tuple[NDArray[np.int64], NDArray[np.int64], FloatArray]:
    """Return the rows, columns and chart coordinates of the pixels whose middles are in a patch."""
    edge = plane.to_picture(center + half * _outline())
    height, width = shape[:2]
    if not np.isfinite(edge).all() or (edge < 0.0).any() or (edge > [width, height]).any():
        raise ImageError(
            f"{where}: lies outside the picture of {width} x {height} pixels; correct the corners"
        )
    first, last = np.floor(edge.min(axis=0)).astype(int), np.ceil(edge.max(axis=0)).astype(int)
    x, y = np.meshgrid(np.arange(first[0], last[0]), np.arange(first[1], last[1]))
    points = plane.to_chart(np.stack([x, y], axis=-1) + 0.5)
    inside = (np.abs(points - center) <= half).all(axis=-1)
    count = int(np.count_nonzero(inside))
    if count < _LEAST_PIXELS:
        raise ImageError(
            f"{where}: its middle covers {count} pixels; photograph the chart from nearer, so that "
            f"it covers {_LEAST_PIXELS} at least"
        )
    return y[inside], x[inside], points[inside]


def _outline() -> FloatArray:
    """Return points around the square from -1 to 1, shape [..., 2]."""
    along = np.linspace(-1.0, 1.0, _EDGE_POINTS)
    ones = np.ones_like(along)
    sides = [(along, -ones), (ones, along), (along, ones), (-ones, along)]
    return np.concatenate([np.stack(side, axis=-1) for side in sides])


def _measure(
    values: FloatArray,
    variance: NDArray[np.float32] | None,
    status: NDArray[np.uint8],
    places: FloatArray,
) -> dict[str, Any]:
    """Return the fields of ``PatchSamples`` of one patch.

    Args:
        values: Its pixels, shape [pixel_count, 3].
        variance: Their variance, shape [pixel_count, 3].
        status: Their status, shape [pixel_count].
        places: Where they are in the patch, -1 .. 1 from side to side, shape [pixel_count, 2].
    """
    design = np.concatenate([np.ones((len(places), 1)), places], axis=1)
    floor = np.full(3, 1e-7 * np.abs(values).max())
    if variance is not None:
        floor = np.maximum(floor, np.sqrt(np.median(variance, axis=0)))
    keep = np.ones(len(values), bool)
    plane = np.zeros((3, 3))
    plane[0] = np.median(values, axis=0)
    for _ in range(_ROUNDS):
        residual = values - design @ plane
        sigma = _MAD_TO_SIGMA * np.median(np.abs(residual), axis=0)
        keep = (np.abs(residual) <= _OUTLIER_SIGMAS * np.maximum(sigma, floor)).all(axis=1)
        plane = np.linalg.lstsq(design[keep], values[keep], rcond=None)[0]
    residual = (values - design @ plane)[keep]
    spread, count = _block_spread(residual, places[keep])
    error = np.square(spread) / count
    if variance is not None:
        error = np.maximum(error, variance[keep].mean(axis=0, dtype=np.float64) / keep.sum())
    slope = np.square(plane[1:]).sum(axis=0) * (2.0 * _AIM / INNER_SHARE) ** 2
    level = max(float(np.abs(plane[0]).sum()), float(np.finfo(np.float64).tiny))
    uneven = _block_spread((values - plane[0])[keep].sum(axis=1, keepdims=True), places[keep])[0]
    return {
        "values": plane[0],
        "stddev": np.sqrt(error + slope),
        "clipped": float(np.mean((status & CLIPPED) != 0)),
        "moved": float(np.mean((status & MOVED) != 0)),
        "evenness": float(uneven[0] / level),
        "rejected": 1.0 - float(keep.mean()),
    }


def _block_spread(values: FloatArray, places: FloatArray) -> tuple[FloatArray, int]:
    """Return the standard deviation of the means of blocks, and how many blocks there are.

    Neighbouring pixels share their noise where a photograph was demosaiced or made smaller, so the
    scatter of pixels would promise too small an error; that of blocks does not.
    """
    column, row = np.clip(((places + 1.0) * 0.5 * _BLOCKS).astype(int), 0, _BLOCKS - 1).T
    block = row * _BLOCKS + column
    count = np.bincount(block, minlength=_BLOCKS**2)
    filled = count > 0
    sums = [np.bincount(block, channel, _BLOCKS**2)[filled] for channel in values.T]
    means = np.stack(sums, axis=-1) / count[filled, None]
    used = int(filled.sum())
    # Three degrees of freedom went into the plane.
    freedom = max(used - 3, 1)
    return np.sqrt(np.square(means - means.mean(axis=0)).sum(axis=0) / freedom), used
