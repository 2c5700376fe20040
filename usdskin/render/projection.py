"""Triangles projected onto the picture, sorted into the bands of rows they may touch."""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.render.cameras import Camera
from usdskin.warp_kernels import raster


def project(
    points: NDArray[np.float32],
    triangles: NDArray[np.int32],
    camera: Camera,
    resolution: tuple[int, int],
    band_rows: int,
    reach: float,
    device: str,
) -> raster.Projection | None:
    """Project a scene for rasterisation.

    Args:
        points: Vertices, world space [m], shape [vertex_count, 3].
        triangles: Vertex indices, shape [triangle_count, 3].
        camera: The camera.
        resolution: Width and height [px].
        band_rows: Rows of a band.
        reach: How far samples lie from their pixel's middle at most [px].
        device: Warp device.

    Returns:
        The projection; None where a triangle crosses the near plane in view, which rays clip.
    """
    width, height = resolution
    screen, depth = _screen(points, camera, resolution)
    nearest, farthest = _extremes(depth, triangles)
    kept = np.flatnonzero(nearest > camera.clip_near)
    if len(kept) < np.count_nonzero(farthest > camera.clip_near):
        return None
    low, high = _extremes(screen[:, 1], triangles[kept])
    left, right = _extremes(screen[:, 0], triangles[kept])
    low, high = low - reach, high + reach
    seen = (high >= 0) & (low < height) & (right + reach >= 0) & (left - reach < width)
    kept, low, high = kept[seen], low[seen], high[seen]
    bands = -(-height // band_rows)
    first = np.clip(low // band_rows, 0, bands - 1).astype(np.int64)
    last = np.clip(high // band_rows, 0, bands - 1).astype(np.int64)
    touched = last - first + 1
    owner = np.repeat(np.arange(len(kept)), touched)
    band = first[owner] + np.arange(len(owner)) - np.repeat(np.cumsum(touched) - touched, touched)
    order = np.argsort(band.astype(np.min_scalar_type(bands)), kind="stable")  # by radix
    projection = raster.Projection()
    far = min(camera.clip_far, 1.0e18)
    projection.least = -far if camera.orthographic else 1.0 / far
    projection.reach = reach
    projection.screen = wp.array(screen.astype(np.float32), dtype=wp.vec3f, device=device)
    projection.triangle = wp.array(triangles, dtype=wp.int32, device=device)
    listed = kept[owner[order]].astype(np.int32)
    projection.listed = wp.array(listed, dtype=wp.int32, device=device)
    starts = np.searchsorted(band[order], np.arange(bands + 1)).astype(np.int32)
    projection.first = wp.array(starts, dtype=wp.int32, device=device)
    return projection


def _extremes(
    values: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the largest value at the corners of each triangle."""
    first, second, third = (values[triangles[:, k]] for k in range(3))
    return (
        np.minimum(np.minimum(first, second), third),
        np.maximum(np.maximum(first, second), third),
    )


def _screen(
    points: NDArray[np.float32], camera: Camera, resolution: tuple[int, int]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return (x, y, nearness) [px] and the depth along the view axis [m] of points."""
    width, height = resolution
    local = (points.astype(np.float64) - camera.to_world[:3, 3]) @ camera.to_world[:3, :3]
    depth = -local[:, 2]
    if camera.orthographic:
        plane, nearness = local[:, :2], -depth
    else:
        inverse = 1.0 / np.where(np.abs(depth) > 1e-12, depth, 1e-12)
        plane, nearness = local[:, :2] * inverse[:, None], inverse
    left, right, bottom, top = camera.window
    x = (plane[:, 0] - left) / (right - left) * width
    y = (top - plane[:, 1]) / (top - bottom) * height
    return np.stack([x, y, nearness], axis=-1), depth
