"""Light gathered at corners, carried to a finer grid by cubics.

Straight lines between corners cut off the middle of what is brightest in the middle: on the walls
of a room a third of a percent. Cubics that do not overshoot (Fritsch and Butland, 1984) run from
line to line of what touches a surface, and no further: light jumps there.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.truth.cells import Grids, edge_lines
from usdskin.judge.truth.geometry import Blockers

FloatArray = NDArray[np.float64]

_FINER = 3
"""Parts that the way from one corner to the next is cut in."""


def finer(
    blockers: Blockers, corners: Grids, gathered: dict[str, FloatArray]
) -> tuple[Grids, dict[str, FloatArray]]:
    """Return a finer grid on each surface, and the light at its corners.

    Args:
        blockers: The surfaces.
        corners: Where light was gathered, on both sides of whatever touches a surface.
        gathered: For each class the light there, zero where a corner is covered, shape
            [corner_count, band_count].
    """
    cuts, parts = [], []
    everything = np.concatenate(list(gathered.values()), axis=1)
    for index, (u, v) in enumerate(corners.cuts):
        pieces = [
            [part for part in np.split(nodes, np.searchsorted(nodes, lines)) if part.size]
            for nodes, lines in zip((u, v), edge_lines(blockers, index), strict=True)
        ]
        fine = [[_cut(part) for part in axis] for axis in pieces]
        cuts.append((np.concatenate(fine[0]), np.concatenate(fine[1])))
        rows = slice(int(corners.first[index]), int(corners.first[index + 1]))
        grid = everything[rows].reshape(u.size, v.size, -1)
        parts.append(_carried(grid, pieces, fine).reshape(-1, grid.shape[-1]))
    split = np.split(np.concatenate(parts), len(gathered), axis=1)
    return Grids(tuple(cuts)), dict(zip(gathered, split, strict=True))


def _cut(nodes: FloatArray) -> FloatArray:
    share = np.arange(_FINER) / _FINER
    between = nodes[:-1, None] + share * np.diff(nodes)[:, None]
    return np.append(between.ravel(), nodes[-1])


def _carried(
    grid: FloatArray, pieces: list[list[FloatArray]], fine: list[list[FloatArray]]
) -> FloatArray:
    """Return a surface's light at the finer corners, shape [rows, columns, bands]."""
    ends = [np.cumsum([0, *(part.size for part in axis)]) for axis in pieces]
    result = []
    for i, (top, bottom) in enumerate(pairwise(ends[0])):
        row = []
        for j, (left, right) in enumerate(pairwise(ends[1])):
            block = grid[top:bottom, left:right]
            known = (block > 0.0).any(axis=-1)
            u, v = pieces[0][i], pieces[1][j]
            if known.all():
                light = _curve(u, fine[0][i], block)
                light = _curve(v, fine[1][j], light.swapaxes(0, 1)).swapaxes(0, 1)
            else:
                across, along = _line(u, fine[0][i]), _line(v, fine[1][j])
                light = np.einsum("ai,bj,ijk->abk", across, along, block, optimize=True)
                share = across @ known @ along.T
                light /= np.where(share > 1e-6, share, 1.0)[..., None]
            row.append(light)
        result.append(np.concatenate(row, axis=1))
    return np.concatenate(result)


def _curve(nodes: FloatArray, at: FloatArray, light: FloatArray) -> FloatArray:
    """Return what lies between values along the first axis, shape [places, other, bands].

    What keeps the cubics from overshooting is found for the sum over bands and holds for each: so
    spectra are weighted means of those at the corners, and classes of light add up.
    """
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    if nodes.size < 3:
        return np.asarray(np.einsum("ai,ijk->ajk", _line(nodes, at), light))
    total = light.sum(axis=-1)
    straight = _slopes(nodes, total)
    kept = np.asarray(PchipInterpolator(nodes, total, axis=0).derivative()(nodes))
    safe = np.abs(straight) > 1e-12 * np.abs(total).max()
    share = np.where(safe, np.clip(kept / np.where(safe, straight, 1.0), 0.0, 2.0), 0.0)
    slopes = share[..., None] * _slopes(nodes, light)
    return np.asarray(CubicHermiteSpline(nodes, light, slopes, axis=0)(at))


def _slopes(nodes: FloatArray, values: FloatArray) -> FloatArray:
    """Return the slopes of parabolas through neighbours along the first axis."""
    return np.asarray(np.gradient(values, nodes, axis=0, edge_order=2))


def _line(nodes: FloatArray, at: FloatArray) -> FloatArray:
    """Return how much each corner counts at some places, straight lines, [places, corners]."""
    return np.stack([np.interp(at, nodes, row) for row in np.eye(nodes.size)], axis=1)
