"""Holes of a panorama: where they are, and values for them that continue what surrounds them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.latlong import latlong_coordinates, latlong_directions, texel_solid_angles
from usdskin.meters import texel_vectors
from usdskin.regions import label_regions, region_texels

FloatArray = NDArray[np.float64]

PixelArray = NDArray[np.floating[Any]]

_SWEEPS = 12
"""Relaxations per level; coarser levels have already settled all but the finest detail."""

_MARGIN = 1.1
"""Extent of the plane over that of the hole."""

_LEAST_DIVISOR = 0.02
"""Keeps a hole around almost everything within a plane that ends 11 degrees from its far pole."""

_GRID_SIZES = (16, 512)


@dataclass(frozen=True, slots=True, eq=False)
class Hole:
    """A connected region that no view sees."""

    direction: FloatArray
    """Unit vector to its middle, in the panorama's frame, shape [3]."""

    solid_angle_sr: float
    """Its solid angle [sr]."""

    @property
    def diameter_deg(self) -> float:
        """Diameter of the round spot of the same solid angle [deg]."""
        return float(np.degrees(2.0 * np.arccos(1.0 - self.solid_angle_sr / (2.0 * np.pi))))


def find_holes(is_hole: NDArray[np.bool_]) -> tuple[Hole, ...]:
    """Return the holes of a panorama, largest first.

    Args:
        is_hole: Texels that no view sees, shape [height, width].
    """
    if not is_hole.any():
        return ()
    height, width = is_hole.shape
    row_factors, column_factors = texel_vectors(height, width)
    solid_angles = texel_solid_angles(height, width)
    holes = []
    for rows, columns in region_texels(label_regions(is_hole)):
        moment = (row_factors[rows] * column_factors[columns]).sum(axis=0)
        length = float(np.linalg.norm(moment))
        size = float(solid_angles[rows].sum())
        # A ring around the sphere has no middle; any direction does.
        direction = moment / length if length > 1e-9 * size else np.array([0.0, 1.0, 0.0])
        holes.append(Hole(direction, min(size, 4.0 * np.pi)))
    return tuple(sorted(holes, key=lambda hole: -hole.solid_angle_sr))


def fill_holes(values: PixelArray, is_hole: NDArray[np.bool_]) -> None:
    """Fill holes in place with the harmonic continuation of their rims over the sphere.

    That is the smoothest one, and never brighter or darker than the rim: no lamp is invented.
    Laplace's equation keeps its form under conformal maps, so each hole is solved in a
    stereographic plane around it, which has neither seam nor pole.

    Args:
        values: Panorama, shape [height, width, channels].
        is_hole: Texels to fill, not all of them, shape [height, width].
    """
    if is_hole.all():
        raise ValueError("a panorama of holes alone")
    for rows, columns in region_texels(label_regions(is_hole)):
        values[rows, columns] = _continuation(values, is_hole, rows, columns)


def _continuation(
    values: PixelArray,
    is_hole: NDArray[np.bool_],
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
) -> FloatArray:
    """Return values for the texels of one hole, shape [count, channels]."""
    height, width = is_hole.shape
    directions = latlong_directions((columns + 0.5) / width, (rows + 0.5) * (np.pi / height))
    frame = _plane(directions)
    along = directions @ frame
    plane = along[:, :2] / np.maximum(1.0 + along[:, 2:], _LEAST_DIVISOR)
    # A texel is half its side wide in the plane's middle.
    texel = 0.5 * np.pi / height
    extent = float(np.abs(plane).max()) * _MARGIN + 4.0 * texel
    size = int(np.clip(2.0 ** np.ceil(np.log2(2.0 * extent / texel)), *_GRID_SIZES))
    middles = (np.arange(size) + 0.5) * (2.0 * extent / size) - extent
    x, y = np.meshgrid(middles, middles)
    square = x * x + y * y
    rays = np.stack([2.0 * x, 2.0 * y, 1.0 - square], axis=-1) @ frame.T
    u, v = latlong_coordinates(rays)
    row = np.minimum((v * height).astype(np.intp), height - 1)
    column = np.minimum((u * width).astype(np.intp), width - 1)
    grid = values[row, column].astype(np.float64)
    is_unknown = is_hole[row, column]
    if is_unknown.all():
        grid[:] = values[~is_hole].mean(axis=0)
    _solve(grid, is_unknown)
    return _interpolate(grid, (plane + extent) * (size / (2.0 * extent)))


def _plane(directions: FloatArray) -> FloatArray:
    """Return the axes of a plane in which directions stay near the middle, its normal last.

    Args:
        directions: Unit vectors, shape [count, 3].
    """
    candidates = np.concatenate([directions.mean(axis=0, keepdims=True), np.eye(3), -np.eye(3)])
    length = np.linalg.norm(candidates, axis=1, keepdims=True)
    candidates = (candidates / np.maximum(length, 1e-9))[length[:, 0] > 1e-9]
    nearest = np.argmax((directions @ candidates.T).min(axis=0))
    normal = candidates[nearest]
    aside = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    aside /= np.linalg.norm(aside)
    return np.stack([aside, np.cross(normal, aside), normal], axis=1)


def _solve(grid: FloatArray, is_unknown: NDArray[np.bool_]) -> None:
    """Solve Laplace's equation on a square grid in place, from coarse to fine.

    Args:
        grid: Values, shape [size, size, channels]; size is a power of two.
        is_unknown: Cells to solve for, shape [size, size].
    """
    size = len(grid)
    if not is_unknown.any() or size == 1:
        return
    shape = (size // 2, 2, size // 2, 2)
    count = (~is_unknown).reshape(shape).sum(axis=(1, 3))
    known = np.where(is_unknown[..., None], 0.0, grid)
    coarse = known.reshape(*shape, -1).sum(axis=(1, 3))
    coarse /= np.maximum(count, 1)[..., None]
    _solve(coarse, count == 0)
    grid[is_unknown] = coarse.repeat(2, axis=0).repeat(2, axis=1)[is_unknown]
    parity = np.add.outer(np.arange(size), np.arange(size)) % 2
    halves = [is_unknown & (parity == which) for which in (0, 1)]
    for _ in range(_SWEEPS):
        for half in halves:
            # Nothing flows across the edge of the grid.
            padded = np.pad(grid, ((1, 1), (1, 1), (0, 0)), mode="edge")
            around = padded[:-2, 1:-1] + padded[2:, 1:-1] + padded[1:-1, :-2] + padded[1:-1, 2:]
            grid[half] = 0.25 * around[half]


def _interpolate(grid: FloatArray, at: FloatArray) -> FloatArray:
    """Return the grid bilinearly at positions in cells from its corner, shape [count, channels]."""
    at = np.clip(at - 0.5, 0.0, len(grid) - 1.0)
    first = np.minimum(at.astype(np.intp), len(grid) - 2)
    x, y = (at - first).T[..., None]
    i, j = first[:, 1], first[:, 0]
    top = (1.0 - x) * grid[i, j] + x * grid[i, j + 1]
    bottom = (1.0 - x) * grid[i + 1, j] + x * grid[i + 1, j + 1]
    return np.asarray((1.0 - y) * top + y * bottom)
