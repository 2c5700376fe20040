"""What stands in the way: visibility between points of planar surfaces, and where rays end.

A ray from a point to a target meets a parallelogram's plane where the two heights above it say, so
everything that is needed of either end is a few dot products: n_p + n_t of them for n_p n_t rays.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_NEAR = 1e-7
"""Height above a plane that is still in it [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Blockers:
    """Parallelograms that stop light on both sides."""

    corner: FloatArray
    """First corner [m], shape [count, 3]."""

    along: FloatArray
    """First edge [m], shape [count, 3]."""

    across: FloatArray
    """Second edge [m], shape [count, 3]."""

    @property
    def normal(self) -> FloatArray:
        """Unit normals, shape [count, 3]."""
        cross = np.cross(self.along, self.across)
        return np.asarray(cross / np.linalg.norm(cross, axis=1, keepdims=True))

    @property
    def corners(self) -> FloatArray:
        """All corners, counter-clockwise from the front [m], shape [count, 4, 3]."""
        a, b, c = self.corner, self.along, self.across
        return np.stack([a, a + b, a + b + c, a + c], axis=1)

    def planes(self) -> FloatArray:
        """Return what gives height [m] and the two coordinates (0 to 1) of points.

        Returns:
            Shape [count, 3, 4]: rows to multiply with (x, y, z, 1).
        """
        normal = self.normal
        result = np.empty((len(normal), 3, 4))
        for index in range(len(normal)):
            frame = np.stack([self.along[index], self.across[index], normal[index]], axis=1)
            u, v, w = np.linalg.inv(frame)
            for row, axis in enumerate((w, u, v)):
                result[index, row] = [*axis, -axis @ self.corner[index]]
        return result


def coordinates(planes: FloatArray, points: FloatArray) -> FloatArray:
    """Return heights and coordinates of points over planes, shape [count, 3, point_count]."""
    return np.asarray(planes[..., :3] @ points.T + planes[..., 3:])


def candidates(blockers: Blockers, ends: FloatArray, others: FloatArray) -> NDArray[np.int64]:
    """Return which blockers can stand between two convex sets of points.

    Args:
        blockers: All of them.
        ends: Corners of one set [m], shape [count, 3].
        others: Corners of the other one [m], shape [other_count, 3].
    """
    hull = np.concatenate([ends, others])
    normal = blockers.normal
    heights = normal @ hull.T - np.einsum("ij,ij->i", normal, blockers.corner)[:, None]
    # Both sets in one half space: the plane is not crossed.
    keep = (heights > _NEAR).any(axis=1) & (heights < -_NEAR).any(axis=1)
    low, high = hull.min(axis=0), hull.max(axis=0)
    corners = blockers.corners
    keep &= (corners.max(axis=1) >= low - _NEAR).all(axis=1)
    keep &= (corners.min(axis=1) <= high + _NEAR).all(axis=1)
    for flat in (ends, others):
        keep &= _is_before(flat, hull, corners)
    return np.flatnonzero(keep)


def _is_before(flat: FloatArray, hull: FloatArray, corners: FloatArray) -> BoolArray:
    """Return which blockers reach to the side of a flat set where the other points are."""
    everything = np.ones(len(corners), bool)
    if len(flat) < 3:
        return everything
    normal = np.cross(flat[1] - flat[0], flat[2] - flat[0])
    length = float(np.linalg.norm(normal))
    if length <= 1e-12:
        return everything
    normal /= length
    if np.abs((flat - flat[0]) @ normal).max() > _NEAR:
        return everything
    side = (hull - flat[0]) @ normal
    heights = (corners - flat[0]) @ normal
    if side.max() > _NEAR and side.min() < -_NEAR:
        return everything
    sign = 1.0 if side.max() > _NEAR else -1.0
    return np.asarray((sign * heights).max(axis=1) > _NEAR)


def is_open(planes: FloatArray, points: FloatArray, targets: FloatArray) -> BoolArray:
    """Return between which points and targets nothing stands, shape [points, targets].

    Args:
        planes: Of the blockers that can stand there, shape [count, 3, 4].
        points: One end [m], shape [point_count, 3].
        targets: The other end [m], shape [target_count, 3].
    """
    free = np.ones((len(points), len(targets)), bool)
    here, there = coordinates(planes, points), coordinates(planes, targets)
    for (h, u, v), (ht, ut, vt) in zip(here, there, strict=True):
        rows = np.flatnonzero(np.abs(h) > _NEAR)
        columns = np.flatnonzero(np.abs(ht) > _NEAR)
        if rows.size < len(points) or columns.size < len(targets):
            if rows.size and columns.size:
                part = _is_free(h[rows], u[rows], v[rows], ht[columns], ut[columns], vt[columns])
                free[np.ix_(rows, columns)] &= part
            continue
        free &= _is_free(h, u, v, ht, ut, vt)
    return free


def _is_free(
    h: FloatArray, u: FloatArray, v: FloatArray, ht: FloatArray, ut: FloatArray, vt: FloatArray
) -> BoolArray:
    """Return which rays miss one blocker; 0 <= u, v <= 1 is tested without a division."""
    if ((h > 0.0).all() and (ht > 0.0).all()) or ((h < 0.0).all() and (ht < 0.0).all()):
        return np.ones((h.size, ht.size), bool)
    down = h[:, None] - ht[None]
    # u at the crossing is (u_t h - u h_t) / (h - h_t).
    hits = (h[:, None] > 0.0) != (ht[None] > 0.0)
    share = h[:, None] / np.where(hits, down, 1.0)
    for a, b in ((u, ut), (v, vt)):
        at = a[:, None] + share * (b[None] - a[:, None])
        hits &= at >= 0.0
        hits &= at <= 1.0
    return np.asarray(~hits)


def is_open_towards(planes: FloatArray, points: FloatArray, directions: FloatArray) -> BoolArray:
    """Return from which points the way to infinity is free, shape [points, directions]."""
    free = np.ones((len(points), len(directions)), bool)
    here = coordinates(planes, points)
    ways = planes[..., :3] @ directions.T
    for (h, u, v), (hd, ud, vd) in zip(here, ways, strict=True):
        above, below = (h > _NEAR), (h < -_NEAR)
        hits = above[:, None] & (hd < 0.0)[None] | below[:, None] & (hd > 0.0)[None]
        if not hits.any():
            continue
        share = -h[:, None] / np.where(hits, hd[None], 1.0)
        for a, b in ((u, ud), (v, vd)):
            at = a[:, None] + share * b[None]
            hits &= at >= 0.0
            hits &= at <= 1.0
        free &= ~hits
    return free


def first_surfaces(
    planes: FloatArray, origin: FloatArray, directions: FloatArray
) -> tuple[NDArray[np.int64], FloatArray]:
    """Return what rays from one point meet first.

    Of two sides of one sheet it is the one that faces the ray.

    Args:
        planes: Of all surfaces, shape [count, 3, 4].
        origin: Where they begin [m], shape [3].
        directions: Unit vectors, shape [ray_count, 3].

    Returns:
        Index of the surface, or -1, and distance [m], infinite for those, shape [ray_count] each.
    """
    index = np.full(len(directions), -1)
    distance = np.full(len(directions), np.inf)
    here = coordinates(planes, origin[None])[..., 0]
    for begin in range(0, len(directions), 16384):
        part = slice(begin, begin + 16384)
        ways = planes[..., :3] @ directions[part].T
        nearest, which = distance[part], index[part]
        for k in range(len(planes)):
            with np.errstate(divide="ignore", invalid="ignore"):
                far = -here[k, 0] / ways[k, 0]
                hit = (far > 1e-9) & np.isfinite(far)
                for row in (1, 2):
                    at = here[k, row] + far * ways[k, row]
                    hit &= (at >= 0.0) & (at <= 1.0)
                hit &= np.where(ways[k, 0] < 0.0, far, far * (1.0 + 1e-12) + 1e-9) < nearest
            which[hit] = k
            nearest[hit] = far[hit]
    return index, distance
