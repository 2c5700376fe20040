"""Surfaces cut into cells: where radiosity is constant, and the corners it is gathered at.

Cuts run along the edges of what touches a surface or nearly does: no cell is half below a cabinet.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.truth.geometry import Blockers

FloatArray = NDArray[np.float64]

_GAP = 0.2
"""Height above a surface up to which edges that run along it cut it [m]: what is below a sofa is
dark, and no cell is half of it."""

_BESIDE = 0.15
"""Furthest from such an edge that it cuts beside it [m]."""

_CLOSE = 0.01
"""Nor is it so near to another cut [m]."""

_LEAST = 0.04
"""Size below which no cell is halved for being near a lamp [m]."""

_FAR = 0.12
"""Size of a cell over its distance from the camera, where that is larger than the size wanted."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """Parts of all surfaces, one surface after another."""

    spans: tuple[FloatArray, ...]
    """For each surface where its cells begin and end, shape [cells, 4]: u0 u1 v0 v1."""

    first: NDArray[np.int64]
    """Index of each surface's first cell, and the count of all, shape [surface_count + 1]."""

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.first[-1])

    @property
    def surface(self) -> NDArray[np.int64]:
        """Index of each cell's surface, shape [count]."""
        return np.repeat(np.arange(len(self.spans)), np.diff(self.first))


@dataclass(frozen=True, slots=True, eq=False)
class Grids:
    """A grid on each surface."""

    cuts: tuple[tuple[FloatArray, FloatArray], ...]
    """For each surface where it is cut along its two edges, from 0 to 1."""

    @property
    def cell_count(self) -> int:
        """Cells of all."""
        return sum((u.size - 1) * (v.size - 1) for u, v in self.cuts)

    @property
    def first(self) -> NDArray[np.int64]:
        """Index of each surface's first corner, and the count of all."""
        return np.concatenate([[0], np.cumsum([u.size * v.size for u, v in self.cuts])])


def cells_of(
    blockers: Blockers, grids: Grids, distance: Callable[[int, FloatArray], FloatArray]
) -> Cells:
    """Return the cells of grids, halved until none is larger than its distance from a lamp.

    Light near a lamp changes over that distance, and so does what the lamp hides.

    Args:
        blockers: The surfaces.
        grids: How they are cut.
        distance: Returns how far from lamps some points of a surface are [m].
    """
    spans = []
    for index, (u, v) in enumerate(grids.cuts):
        corner, along, across = (
            blockers.corner[index],
            blockers.along[index],
            blockers.across[index],
        )
        i, j = (part.ravel() for part in np.meshgrid(
            np.arange(u.size - 1), np.arange(v.size - 1), indexing="ij"))  # fmt: skip
        todo = np.stack([u[i], u[i + 1], v[j], v[j + 1]], axis=1)
        size = np.array([np.linalg.norm(along), np.linalg.norm(across)])
        done = []
        while len(todo):
            middle = 0.5 * (todo[:, [0, 2]] + todo[:, [1, 3]])
            extent = (todo[:, [1, 3]] - todo[:, [0, 2]]) * size
            near = distance(index, corner + middle @ np.stack([along, across]))
            wide = extent.max(axis=1) > np.maximum(near, _LEAST)
            done.append(todo[~wide])
            todo, middle, extent = todo[wide], middle[wide], extent[wide]
            is_long = extent[:, 0] >= extent[:, 1]
            first, second = todo.copy(), todo.copy()
            first[is_long, 1] = second[is_long, 0] = middle[is_long, 0]
            first[~is_long, 3] = second[~is_long, 2] = middle[~is_long, 1]
            todo = np.concatenate([first, second])
        spans.append(np.concatenate(done))
    return Cells(tuple(spans), np.concatenate([[0], np.cumsum([len(part) for part in spans])]))


@dataclass(frozen=True, slots=True, eq=False)
class Cutting:
    """How surfaces are cut."""

    camera: FloatArray
    """From where the set is seen [m], shape [3]."""

    is_fine: NDArray[np.bool_]
    """Surfaces that are cut as wanted, others only in two, shape [surface_count]."""

    edge: float = 1.0
    """Size at the edges of surfaces, over the size elsewhere."""

    beside: tuple[float, ...] = ()
    """Where else to cut beside an edge of something before a surface, over its height there."""


def cut_grids(blockers: Blockers, count: int, cutting: Cutting) -> Grids:
    """Return grids of about as many cells as asked for, all about as large near the camera.

    Args:
        blockers: The surfaces.
        count: How many, at most.
        cutting: How they are cut.
    """
    lines = [_touching(blockers, index, cutting.beside) for index in range(len(blockers.corner))]
    low, high = 1e-4, 1e4
    for _ in range(24):
        size = float(np.sqrt(low * high))
        if _grids(blockers, lines, size, cutting).cell_count > count:
            low = size
        else:
            high = size
    return _grids(blockers, lines, high, cutting)


def _grids(
    blockers: Blockers,
    lines: list[tuple[FloatArray, FloatArray]],
    size: float,
    cutting: Cutting,
) -> Grids:
    cuts = []
    for index, (u_lines, v_lines) in enumerate(lines):
        u_edge, v_edge = blockers.along[index], blockers.across[index]
        corner = blockers.corner[index]
        wanted = size if cutting.is_fine[index] else np.inf
        u = _cut(u_lines, corner, u_edge, v_edge, wanted, cutting)
        v = _cut(v_lines, corner, v_edge, u_edge, wanted, cutting)
        cuts.append((u, v))
    return Grids(tuple(cuts))


def _touching(
    blockers: Blockers, index: int, beside: tuple[float, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return where edges of other surfaces touch a surface, as u and v, and places beside them."""
    edge = np.stack([blockers.along[index], blockers.across[index], blockers.normal[index]], axis=1)
    local = (blockers.corners - blockers.corner[index]) @ np.linalg.inv(edge).T
    height = local[..., 2]
    touches = (height > -1e-4) & (height < _GAP)
    within = (local[..., :2] > -1e-6).all(axis=-1) & (local[..., :2] < 1.0 + 1e-6).all(axis=-1)
    # An edge touches, not a mere corner.
    touches &= within
    level = np.zeros_like(touches)
    for step in (-1, 1):
        level |= np.roll(touches, step, axis=1) & (
            abs(np.roll(height, step, axis=1) - height) < 1e-4
        )
    touches &= level
    touches[index] = False
    found = local[touches]
    size = np.linalg.norm([blockers.along[index], blockers.across[index]], axis=1)
    result = []
    for k in (0, 1):
        lines = np.unique(np.round(np.clip([0.0, 1.0, *found[:, k]], 0.0, 1.0), 9))
        high = found[:, 2] > 1e-3
        for share in beside:
            away = np.minimum(share * found[high, 2], _BESIDE) / size[k]
            for at in np.unique(np.concatenate([found[high, k] - away, found[high, k] + away])):
                if np.abs(lines - at).min() * size[k] > _CLOSE and 0.0 < at < 1.0:
                    lines = np.sort(np.append(lines, at))
        result.append(lines)
    return result[0], result[1]


def edge_lines(blockers: Blockers, index: int) -> tuple[FloatArray, FloatArray]:
    """Return where edges of other surfaces touch a surface, as u and v from 0 to 1."""
    return _touching(blockers, index, ())


def _cut(
    lines: FloatArray,
    corner: FloatArray,
    edge: FloatArray,
    other: FloatArray,
    size: float,
    cutting: Cutting,
) -> FloatArray:
    """Return where one edge is cut: halves, until strips are no wider than wanted."""
    length = float(np.linalg.norm(edge))
    samples = corner + np.linspace(0.0, 1.0, 5)[:, None] * other
    result = [lines[0]]
    ends = zip(lines[-2::-1].tolist(), lines[:0:-1].tolist(), strict=True)
    stack = [(a, b, a, b) for a, b in ends]
    while stack:
        a, b, low, high = stack.pop()
        wanted = size
        if cutting.edge < 1.0:
            inner = length * max(min(a - low, high - b), 0.0)
            wanted *= min(1.0, cutting.edge + 0.5 * inner / size)
        if math.isfinite(size):
            inside = np.clip(_nearest(cutting.camera - samples, edge), a, b)
            away = samples + inside[:, None] * edge - cutting.camera
            wanted = max(wanted, _FAR * float(np.linalg.norm(away, axis=1).min()))
        is_whole = a == lines[0] and b == lines[-1]
        if (b - a) * length > wanted or is_whole:
            middle = 0.5 * (a + b)
            stack += [(middle, b, low, high), (a, middle, low, high)]
        else:
            result.append(b)
    return np.array(result)


def _nearest(away: FloatArray, edge: FloatArray) -> FloatArray:
    return np.asarray(away @ edge / (edge @ edge))
