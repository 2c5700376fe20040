"""Surfaces cut into cells: where radiosity is constant, and the corners it is gathered at.

Cuts run along the edges of what touches a surface, so that no cell is half below a cabinet.
"""

from __future__ import annotations

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


def cut_cells(blockers: Blockers, count: int, camera: FloatArray, least: int = 2) -> Cells:
    """Return about as many cells as asked for, all about as large near the camera.

    Args:
        blockers: The surfaces.
        count: How many, at most.
        camera: From where the set is seen [m], shape [3].
        least: Cells along the edge of a surface, at least.
    """
    lines = [_touching(blockers, index) for index in range(len(blockers.corner))]
    low, high = 1e-4, 1e4
    for _ in range(40):
        size = float(np.sqrt(low * high))
        if _cells(blockers, lines, size, camera, least).count > count:
            low = size
        else:
            high = size
    return _cells(blockers, lines, high, camera, least)


def _cells(
    blockers: Blockers,
    lines: list[tuple[FloatArray, FloatArray]],
    size: float,
    camera: FloatArray,
    least: int,
) -> Cells:
    cuts = []
    for index, (u_lines, v_lines) in enumerate(lines):
        u_edge, v_edge = blockers.along[index], blockers.across[index]
        corner = blockers.corner[index]
        u = _cut(u_lines, corner, u_edge, v_edge, size, camera, least)
        v = _cut(v_lines, corner, v_edge, u_edge, size, camera, least)
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
    camera: FloatArray,
    least: int,
) -> FloatArray:
    """Return where one edge is cut: halves, until strips are no wider than wanted."""
    length = float(np.linalg.norm(edge))
    samples = corner + np.linspace(0.0, 1.0, 5)[:, None] * other
    result = [lines[0]]
    span = float(lines[-1] - lines[0])
    stack = [(float(a), float(b)) for a, b in zip(lines[-2::-1], lines[:0:-1], strict=True)]
    while stack:
        a, b = stack.pop()
        inside = np.clip(_nearest(camera - samples, edge), a, b)
        nearest = np.linalg.norm(samples + inside[:, None] * edge - camera, axis=1).min()
        wanted = max(size, _FAR * float(nearest))
        if (b - a) * length > wanted or (b - a) > span / least + 1e-9:
            middle = 0.5 * (a + b)
            stack += [(middle, b), (a, middle)]
        else:
            result.append(b)
    return np.array(result)


def _nearest(away: FloatArray, edge: FloatArray) -> FloatArray:
    return np.asarray(away @ edge / (edge @ edge))
