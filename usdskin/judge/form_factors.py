"""Form factors by rays: what points of a surface see of the cells of all others.

Rays leave a point by a Fibonacci lattice mapped to the cosine, so that each carries as much: a
form factor is a share of rays. What stands in the way is found on the way, gaps included, and the
shares add up to what does not leave the set.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.truth.cells import Cells
from usdskin.judge.truth.geometry import Blockers, coordinates
from usdskin.judge.truth.lamps import stops
from usdskin.render.local_lights import LocalLight

FloatArray = NDArray[np.float64]

_CHUNK = 1 << 15


def cell_table(cells: Cells, surface: int) -> tuple[FloatArray, FloatArray, NDArray[np.int64]]:
    """Return where a surface's cells begin along u and v, and which cell is where.

    Returns:
        u, shape [m + 1]; v, shape [n + 1]; indices of cells, shape [m, n].
    """
    spans = cells.spans[surface]
    u, v = np.unique(spans[:, :2]), np.unique(spans[:, 2:])
    table = np.empty((u.size - 1, v.size - 1), np.int64)
    for number, (u0, u1, v0, v1) in enumerate(spans):
        i, j = np.searchsorted(u, (u0, u1)), np.searchsorted(v, (v0, v1))
        table[i[0] : i[1], j[0] : j[1]] = cells.first[surface] + number
    return u, v, table


def lattice(count: int, turn: int) -> FloatArray:
    """Return a Fibonacci lattice in the unit square, shape [count, 2]."""
    index = np.arange(count)
    return np.stack([(index + 0.5) / count, (index * turn / count) % 1.0], axis=1)


def cosine_directions(square: FloatArray, normal: FloatArray) -> FloatArray:
    """Return directions above a surface, in proportion to the cosine, shape [..., 3]."""
    helper = np.array([0.0, 1.0, 0.0] if abs(normal[0]) > 0.7 else [1.0, 0.0, 0.0])
    x = np.cross(normal, helper)
    x /= np.linalg.norm(x)
    radius, angle = np.sqrt(square[..., 0]), 2.0 * np.pi * square[..., 1]
    local = np.stack(
        [radius * np.cos(angle), radius * np.sin(angle), np.sqrt(1.0 - square[..., 0])], axis=-1
    )
    return np.asarray(local @ np.stack([x, np.cross(normal, x), normal]))


def shares(
    blockers: Blockers,
    cells: Cells,
    index: int,
    points: FloatArray,
    directions: FloatArray,
    lamps: Sequence[LocalLight] = (),
) -> FloatArray:
    """Return the share of each point's rays that ends in the front of each cell.

    Args:
        blockers: What stops light; the surfaces with cells come first.
        cells: Of the surfaces.
        index: The surface that the rays leave.
        points: On it [m], where each ray begins, shape [point_count, ray_count, 3] or, for rays
            from one place, [point_count, 1, 3].
        directions: Unit vectors, shape [point_count, ray_count, 3].
        lamps: What stops light too; rectangles are among the blockers.

    Returns:
        Shape [point_count, cell_count].
    """
    count, rays = directions.shape[:2]
    result = np.zeros((count, cells.count))
    planes, normal = blockers.planes(), blockers.normal
    before = (blockers.corners - blockers.corner[index]) @ normal[index]
    which = np.flatnonzero(before.max(axis=1) > 1e-7)
    which = which[which != index]
    above = [
        lamp
        for lamp in lamps
        if lamp.kind != "rect"
        and (lamp.center - blockers.corner[index]) @ normal[index] > -max(lamp.half)
    ]
    tables = {k: cell_table(cells, int(k)) for k in which if k < len(cells.spans)}
    for part in _parts(count, rays):
        ways = directions[part].reshape(-1, 3)
        begin = points[part].reshape(-1, 3)
        held = rays if points.shape[1] == 1 else 1
        found, u, v, far = first_blockers(planes[which], begin, held, ways)
        for lamp in above:
            found[stops(lamp, np.repeat(begin, held, axis=0), ways, far)] = -1
        owner = np.repeat(np.arange(part.stop - part.start), rays)
        target = np.full(len(ways), -1)
        for k in np.unique(found[found >= 0]):
            surface = which[k]
            if surface not in tables:
                continue
            hit = np.flatnonzero(found == k)
            hit = hit[ways[hit] @ normal[surface] < 0.0]
            u_cuts, v_cuts, table = tables[surface]
            i = np.clip(np.searchsorted(u_cuts, u[hit], "right") - 1, 0, table.shape[0] - 1)
            j = np.clip(np.searchsorted(v_cuts, v[hit], "right") - 1, 0, table.shape[1] - 1)
            target[hit] = table[i, j]
        ends = target >= 0
        flat = owner[ends] * cells.count + target[ends]
        total = np.bincount(flat, minlength=(part.stop - part.start) * cells.count)
        result[part] = total.reshape(-1, cells.count) / rays
    return result


def _parts(count: int, rays: int) -> Iterator[slice]:
    step = max(1, _CHUNK // rays)
    for begin in range(0, count, step):
        yield slice(begin, min(begin + step, count))


def first_blockers(
    planes: FloatArray, points: FloatArray, held: int, ways: FloatArray
) -> tuple[NDArray[np.int64], FloatArray, FloatArray, FloatArray]:
    """Return the blocker that each ray meets first, or -1, u and v there, and how far it is.

    Args:
        planes: Of the blockers, shape [count, 3, 4].
        points: Where rays begin [m], shape [point_count, 3].
        held: How many rays begin at each.
        ways: Unit vectors, shape [point_count * held, 3].
    """
    here, there = coordinates(planes, points), planes[..., :3] @ ways.T
    nearest = np.full(len(ways), np.inf)
    found = np.full(len(ways), -1)
    at_u, at_v = np.zeros(len(ways)), np.zeros(len(ways))
    for k in range(len(planes)):
        h, u0, v0 = (np.repeat(row, held) if held > 1 else row for row in here[k])
        down, du, dv = there[k]
        with np.errstate(divide="ignore", invalid="ignore"):
            far = -h / down
            # Of two sides of one sheet the one that faces the ray counts.
            hit = (far > 1e-9) & (np.where(down < 0.0, far, far * (1.0 + 1e-12) + 1e-9) < nearest)
        rows = np.flatnonzero(hit)
        distance = far[rows]
        u = u0[rows] + distance * du[rows]
        v = v0[rows] + distance * dv[rows]
        inside = (u >= 0.0) & (u <= 1.0) & (v >= 0.0) & (v <= 1.0)
        rows = rows[inside]
        nearest[rows], found[rows] = distance[inside], k
        at_u[rows], at_v[rows] = u[inside], v[inside]
    return found, at_u, at_v, nearest
