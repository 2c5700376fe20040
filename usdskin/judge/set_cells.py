"""Surfaces cut into cells: where radiosity is constant, and the corners it is gathered at.

Cuts run along the edges of what touches a surface, so that no cell is half below a cabinet.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.set_geometry import Blockers

FloatArray = NDArray[np.float64]

_TOUCH = 1e-4
"""Height above a surface at which something touches it [m]."""

_FAR = 0.12
"""Size of a cell over its distance from the camera, where that is larger than the size wanted."""


@dataclass(frozen=True, slots=True, eq=False)
class Cells:
    """The cells of all surfaces, one surface after another, rows of u, columns of v."""

    cuts: tuple[tuple[FloatArray, FloatArray], ...]
    """For each surface where it is cut along its two edges, from 0 to 1."""

    first: NDArray[np.int64]
    """Index of each surface's first cell, and the count of all, shape [surface_count + 1]."""

    @property
    def count(self) -> int:
        """How many there are."""
        return int(self.first[-1])

    @property
    def surface(self) -> NDArray[np.int64]:
        """Index of each cell's surface, shape [count]."""
        return np.repeat(np.arange(len(self.cuts)), np.diff(self.first))

    def spans(self, surface: int) -> FloatArray:
        """Return u and v where a surface's cells begin and end, shape [cells, 4]: u0 u1 v0 v1."""
        u, v = self.cuts[surface]
        i, j = (part.ravel() for part in np.meshgrid(
            np.arange(u.size - 1), np.arange(v.size - 1), indexing="ij"))  # fmt: skip
        return np.stack([u[i], u[i + 1], v[j], v[j + 1]], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class Cutting:
    """How surfaces are cut."""

    camera: FloatArray
    """From where the set is seen [m], shape [3]."""

    is_fine: NDArray[np.bool_]
    """Surfaces that are cut as wanted, others only in two, shape [surface_count]."""

    edge: float = 1.0
    """Size at the edges of surfaces, over the size elsewhere."""


def cut_cells(blockers: Blockers, count: int, cutting: Cutting) -> Cells:
    """Return about as many cells as asked for, all about as large near the camera.

    Args:
        blockers: The surfaces.
        count: How many, at most.
        cutting: How they are cut.
    """
    lines = [_touching(blockers, index) for index in range(len(blockers.corner))]
    low, high = 1e-4, 1e4
    for _ in range(24):
        size = float(np.sqrt(low * high))
        if _cells(blockers, lines, size, cutting).count > count:
            low = size
        else:
            high = size
    return _cells(blockers, lines, high, cutting)


def _cells(
    blockers: Blockers,
    lines: list[tuple[FloatArray, FloatArray]],
    size: float,
    cutting: Cutting,
) -> Cells:
    cuts = []
    for index, (u_lines, v_lines) in enumerate(lines):
        u_edge, v_edge = blockers.along[index], blockers.across[index]
        corner = blockers.corner[index]
        wanted = size if cutting.is_fine[index] else np.inf
        u = _cut(u_lines, corner, u_edge, v_edge, wanted, cutting)
        v = _cut(v_lines, corner, v_edge, u_edge, wanted, cutting)
        cuts.append((u, v))
    counts = [(u.size - 1) * (v.size - 1) for u, v in cuts]
    return Cells(tuple(cuts), np.concatenate([[0], np.cumsum(counts)]))


def _touching(blockers: Blockers, index: int) -> tuple[FloatArray, FloatArray]:
    """Return where edges of other surfaces touch a surface, as u and v."""
    edge = np.stack([blockers.along[index], blockers.across[index], blockers.normal[index]], axis=1)
    local = (blockers.corners - blockers.corner[index]) @ np.linalg.inv(edge).T
    touches = np.abs(local[..., 2]) < _TOUCH
    within = (local[..., :2] > -1e-6).all(axis=-1) & (local[..., :2] < 1.0 + 1e-6).all(axis=-1)
    # An edge touches, not a mere corner.
    touches &= within
    touches &= np.roll(touches, 1, axis=1) | np.roll(touches, -1, axis=1)
    touches[index] = False
    found = local[touches][:, :2]
    return tuple(
        np.unique(np.concatenate([[0.0, 1.0], np.round(np.clip(found[:, k], 0.0, 1.0), 9)]))
        for k in (0, 1)
    )  # type: ignore[return-value]


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
