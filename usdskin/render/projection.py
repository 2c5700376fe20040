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
    corner_depth = depth[triangles]
    kept = np.flatnonzero((corner_depth > camera.clip_near).all(axis=1))
    if len(kept) < len(triangles):
        some = (corner_depth > camera.clip_near).any(axis=1)
        if int(some.sum()) > len(kept):
            return None
    rows = screen[triangles[kept], 1]
    columns = screen[triangles[kept], 0]
    low, high = rows.min(axis=1) - reach, rows.max(axis=1) + reach
    seen = (high >= 0) & (low < height)
    seen &= (columns.max(axis=1) + reach >= 0) & (columns.min(axis=1) - reach < width)
    kept, low, high = kept[seen], low[seen], high[seen]
    bands = -(-height // band_rows)
    first = np.clip(low // band_rows, 0, bands - 1).astype(np.int64)
    last = np.clip(high // band_rows, 0, bands - 1).astype(np.int64)
    touched = last - first + 1
    owner = np.repeat(np.arange(len(kept)), touched)
    band = first[owner] + np.arange(len(owner)) - np.repeat(np.cumsum(touched) - touched, touched)
    order = np.argsort(band, kind="stable")
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
