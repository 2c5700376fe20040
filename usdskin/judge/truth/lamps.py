"""Lamps of a set as seen from points: outlines, solid angles, places to test for shadows.

A lamp is a black body in every sense but that it shines: it stops light and reflects none.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.truth.polygons import projected_solid_angle
from usdskin.render.local_lights import LocalLight

FloatArray = NDArray[np.float64]

_ROUND = 48
"""Corners that stand for a circle; its polygon has the circle's area."""
_WIDE = 0.5
"""Half the longer side of a rectangle from which it is wide [m]."""
_ARC = 12
"""Edges that stand for each end of a cylinder."""


def is_wide(lamp: LocalLight) -> bool:
    """Return whether a lamp is so large that its shadows are soft, and its light changes slowly."""
    return lamp.kind == "rect" and max(lamp.half) >= _WIDE


def area(lamp: LocalLight) -> float:
    """Return the area that shines [m^2]."""
    a, b = lamp.half
    return {
        "rect": 4.0 * a * b,
        "disk": math.pi * a * a,
        "sphere": 4.0 * math.pi * a * a,
        "cylinder": 4.0 * math.pi * a * b,
    }[lamp.kind]


def irradiance_factor(lamp: LocalLight, points: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the irradiance of an unobstructed lamp per radiance [sr], shape [count].

    Args:
        lamp: The lamp.
        points: Where [m], shape [count, 3].
        normals: Unit normals there, shape [count, 3].
    """
    if lamp.kind == "sphere":
        return _sphere_factor(lamp, points, normals)
    corners = outline(lamp, points)
    factor = projected_solid_angle(corners - points[:, None], normals)
    if lamp.kind in ("rect", "disk"):
        in_front = (points - lamp.center) @ lamp.axes[2] < 0.0
        return np.asarray(np.where(in_front, factor, 0.0))
    return factor


def _sphere_factor(lamp: LocalLight, points: FloatArray, normals: FloatArray) -> FloatArray:
    """Pi sin^2 cos above the horizon; a polygon where the horizon cuts the sphere."""
    away = lamp.center - points
    distance = np.linalg.norm(away, axis=1)
    sine = np.minimum(lamp.half[0] / distance, 1.0)
    cosine = np.einsum("ic,ic->i", away, normals) / distance
    factor = np.pi * sine**2 * np.maximum(cosine, 0.0)
    cut = np.abs(cosine) < sine
    if cut.any():
        corners = outline(lamp, points[cut]) - points[cut][:, None]
        factor[cut] = projected_solid_angle(corners, normals[cut])
    return np.asarray(factor)


def outline(lamp: LocalLight, points: FloatArray) -> FloatArray:
    """Return the corners of what points see of a lamp [m], shape [count, corner_count, 3]."""
    a, b = lamp.half
    x, y = lamp.axes[0], lamp.axes[1]
    if lamp.kind == "rect":
        signs = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)], np.float64)
        corners = lamp.center + signs @ np.stack([a * x, b * y])
        return np.broadcast_to(corners, (len(points), 4, 3))
    if lamp.kind == "disk":
        corners = lamp.center + a * _circle() @ np.stack([x, y])
        return np.broadcast_to(corners, (len(points), _ROUND, 3))
    if lamp.kind == "sphere":
        return _sphere_outline(lamp, points)
    return _cylinder_outline(lamp, points)


def _circle() -> FloatArray:
    """Return the corners of a regular polygon with the unit circle's area, shape [n, 2]."""
    angle = 2.0 * np.pi * np.arange(_ROUND) / _ROUND
    radius = math.sqrt(2.0 * np.pi / (_ROUND * math.sin(2.0 * np.pi / _ROUND)))
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _sphere_outline(lamp: LocalLight, points: FloatArray) -> FloatArray:
    away = lamp.center - points
    distance = np.linalg.norm(away, axis=1, keepdims=True)
    towards = away / distance
    sine = np.minimum(lamp.half[0] / distance, 1.0 - 1e-12)
    helper = np.where(np.abs(towards[:, :1]) > 0.7, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    across = np.cross(towards, helper)
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    other = np.cross(towards, across)
    tangent = (sine / np.sqrt(1.0 - sine**2))[:, :, None]
    circle = _circle()
    rim = circle[:, :1] * across[:, None] + circle[:, 1:] * other[:, None]
    return np.asarray(points[:, None] + towards[:, None] + tangent * rim)


def _cylinder_outline(lamp: LocalLight, points: FloatArray) -> FloatArray:
    """The side that is seen, between the two tangents; the ends are open and black inside."""
    half, radius = lamp.half
    local = (points - lamp.center) @ lamp.axes.T
    away = np.hypot(local[:, 1], local[:, 2])
    middle = np.arctan2(local[:, 2], local[:, 1])
    spread = np.arccos(np.minimum(radius / np.maximum(away, 1e-12), 1.0))
    turn = middle[:, None] + np.linspace(-1.0, 1.0, _ARC + 1) * spread[:, None]
    ring = np.stack([np.cos(turn), np.sin(turn)], axis=-1) * radius
    # The polygon has the arc's area, as that of ``_circle`` has.
    step = 2.0 * spread[:, None, None] / _ARC
    ring[:, 1:-1] /= np.sqrt(np.sinc(step / np.pi))
    ends = np.full((*turn.shape, 1), half)
    near = np.concatenate([ends, ring], axis=-1)
    far = np.concatenate([-ends, ring], axis=-1)[:, ::-1]
    return np.asarray(np.concatenate([near, far], axis=1) @ lamp.axes + lamp.center)


def solid_angle(lamp: LocalLight, point: FloatArray) -> float:
    """Return the solid angle in which a point sees a lamp shine [sr], unobstructed."""
    if lamp.kind == "sphere":
        distance = float(np.linalg.norm(lamp.center - point))
        return 2.0 * math.pi * (1.0 - math.sqrt(1.0 - (lamp.half[0] / distance) ** 2))
    if lamp.kind in ("rect", "disk") and float((point - lamp.center) @ lamp.axes[2]) >= 0.0:
        return 0.0
    corners = outline(lamp, point[None])[0] - point
    # Fan of triangles (Van Oosterom and Strackee, "The solid angle of a plane triangle", 1983).
    u = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    a, b, c = u[:1], u[1:-1], u[2:]
    triple = np.einsum("ij,ij->i", np.broadcast_to(a, b.shape), np.cross(b, c))
    below = 1.0 + (a * b).sum(1) + (b * c).sum(1) + (a * c).sum(1)
    return float(abs(2.0 * np.arctan2(triple, below).sum()))


def targets(lamp: LocalLight, fineness: int = 1) -> tuple[FloatArray, FloatArray | None]:
    """Return points of a lamp that shadows are tested with, and the normals there.

    Args:
        lamp: The lamp.
        fineness: More points: this many times as many in each direction.

    Returns:
        Points [m], shape [count, 3]; unit normals, shape [count, 3], or None where what a point
        gives does not depend on them.
    """
    a, b = lamp.half
    x, y, z = lamp.axes
    if lamp.kind == "rect":
        long = max(a, b)
        counts = [max(2, round(8 * fineness * size / long)) for size in (a, b)]
        grid = [(np.arange(count) + 0.5) * 2.0 / count - 1.0 for count in counts]
        s, t = (part.ravel() for part in np.meshgrid(*grid, indexing="ij"))
        return lamp.center + np.outer(a * s, x) + np.outer(b * t, y), np.broadcast_to(
            -z, (s.size, 3)
        )
    count = 24 * fineness
    if lamp.kind == "cylinder":
        s = (np.arange(count) + 0.5) * 2.0 / count - 1.0
        return lamp.center + np.outer(a * s, x), None
    turn = 2.0 * np.pi * 0.3819660112501051 * np.arange(count)
    if lamp.kind == "disk":
        radius = a * np.sqrt((np.arange(count) + 0.5) / count)
        spot = np.outer(radius * np.cos(turn), x) + np.outer(radius * np.sin(turn), y)
        return lamp.center + spot, np.broadcast_to(-z, (count, 3))
    height = 1.0 - (2.0 * np.arange(count) + 1.0) / count
    ring = np.sqrt(1.0 - height**2)
    ball = np.stack([ring * np.cos(turn), ring * np.sin(turn), height], axis=1)
    return lamp.center + 0.8 * a * ball, None


def target_weights(
    lamp: LocalLight,
    points: FloatArray,
    normal: FloatArray,
    places: FloatArray,
    facing: FloatArray | None,
) -> FloatArray:
    """Return how much each target gives each point, up to a factor, shape [points, targets].

    Args:
        lamp: The lamp.
        points: Where [m], shape [point_count, 3].
        normal: Unit normal there, shape [3].
        places: The targets [m], shape [target_count, 3].
        facing: Their normals, shape [target_count, 3], or None.
    """
    away = places[None] - points[:, None]
    square = np.maximum((away**2).sum(axis=-1), 1e-12)
    weight = np.maximum(away @ normal, 0.0) / square**1.5
    if facing is not None:
        weight *= np.maximum(-np.einsum("pts,ts->pt", away, facing), 0.0) / np.sqrt(square)
    elif lamp.kind == "cylinder":
        along = (away @ lamp.axes[0]) ** 2 / square
        weight *= np.sqrt(np.maximum(1.0 - along, 0.0))
    return np.asarray(weight)


def first_hits(
    lamp: LocalLight, origin: FloatArray, directions: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return how far rays go to a lamp (infinite where they miss), and whether they see it shine.

    Args:
        lamp: The lamp.
        origin: Where rays begin [m], shape [3].
        directions: Unit vectors, shape [count, 3].
    """
    a, b = lamp.half
    start, way = lamp.axes @ (origin - lamp.center), directions @ lamp.axes.T
    with np.errstate(divide="ignore", invalid="ignore"):
        if lamp.kind in ("rect", "disk"):
            distance = -start[2] / way[:, 2]
            x, y = (start[k] + distance * way[:, k] for k in (0, 1))
            inside = (
                (abs(x) <= a) & (abs(y) <= b) if lamp.kind == "rect" else x * x + y * y <= a * a
            )
            hit = inside & (distance > 0.0)
            return np.where(hit, distance, np.inf), hit & (way[:, 2] > 0.0)
        if lamp.kind == "sphere":
            middle = -way @ start
            root = middle**2 - (start @ start - a * a)
            distance = middle - np.sqrt(np.maximum(root, 0.0))
            hit = (root >= 0.0) & (distance > 0.0)
            return np.where(hit, distance, np.inf), hit
        square = (way[:, 1:] ** 2).sum(axis=1)
        middle = -(way[:, 1:] @ start[1:]) / square
        root = middle**2 - (start[1:] @ start[1:] - b * b) / square
        ways = [middle + sign * np.sqrt(np.maximum(root, 0.0)) for sign in (-1.0, 1.0)]
        hits = [(root >= 0.0) & (t > 0.0) & (abs(start[0] + t * way[:, 0]) <= a) for t in ways]
    # Outside first; else the black inside through an open end.
    distance = np.where(hits[0], ways[0], np.where(hits[1], ways[1], np.inf))
    return distance, hits[0]


def stops(
    lamp: LocalLight, begin: FloatArray, ways: FloatArray, most: FloatArray | float
) -> NDArray[np.bool_]:
    """Return whether a lamp stands in the way, shape [count].

    Args:
        lamp: The lamp.
        begin: Where rays begin, outside it [m], shape [count, 3] or, for all, [1, 3].
        ways: Their directions, of any length, shape [count, 3].
        most: How far they go, in lengths of ``ways``, shape [count] or one for all.
    """
    a, b = lamp.half
    start, way = (begin - lamp.center) @ lamp.axes.T, ways @ lamp.axes.T
    start, most = np.broadcast_to(start, way.shape), np.broadcast_to(most, len(way))
    first = 0 if lamp.kind == "sphere" else 1
    if lamp.kind == "disk":
        with np.errstate(divide="ignore", invalid="ignore"):
            far = -start[:, 2] / way[:, 2]
            spot = start[:, :2] + far[:, None] * way[:, :2]
            return np.asarray((far > 0.0) & (far < most) & ((spot**2).sum(axis=1) <= a * a))
    square = np.einsum("ij,ij->i", way[:, first:], way[:, first:])
    ahead = np.einsum("ij,ij->i", start[:, first:], way[:, first:])
    apart = np.einsum("ij,ij->i", start[:, first:], start[:, first:]) - b * b
    result = np.asarray(ahead * ahead > square * apart)
    rows = np.flatnonzero(result)
    square = np.maximum(square[rows], 1e-300)
    root = np.sqrt(ahead[rows] ** 2 - square * apart[rows])
    hit = np.zeros(rows.size, bool)
    for sign in (-1.0, 1.0):
        far = (sign * root - ahead[rows]) / square
        meets = (far > 0.0) & (far < most[rows])
        if lamp.kind == "cylinder":
            meets &= np.abs(start[rows, 0] + far * way[rows, 0]) <= a
        hit |= meets
    result[rows] = hit
    return result


def shading(
    lamp: LocalLight, points: FloatArray, normal: FloatArray, others: tuple[LocalLight, ...]
) -> list[tuple[LocalLight, NDArray[np.int64]]]:
    """Return which other lamps may take a lamp's light from which points.

    Args:
        lamp: The lamp that shines.
        points: Where, on a surface [m], shape [count, 3].
        normal: Its normal, shape [3].
        others: What may stand in the way; rectangles are left out.
    """
    spots = np.concatenate([targets(lamp)[0], lamp.center[None]])
    result = []
    for other in others:
        if other is lamp or other.kind == "rect":
            continue
        # A tube stops what passes near its axis, whatever the place along it.
        first, reach = (1, other.half[1]) if other.kind == "cylinder" else (0, other.half[0])
        if ((other.center - points[0]) @ normal) < -max(other.half):
            continue
        goal = ((spots - other.center) @ other.axes.T)[:, first:]
        wide = float(np.linalg.norm(goal - goal[-1], axis=1).max())
        if float(np.linalg.norm(goal[-1])) + wide < reach:
            continue  # tubes in one line: one hides the other from points in that line alone
        start = ((points - other.center) @ other.axes.T)[:, first:]
        way = goal[-1] - start
        square = np.maximum(np.einsum("ij,ij->i", way, way), 1e-300)
        share = np.clip(-np.einsum("ij,ij->i", start, way) / square, 0.0, 1.0)
        nearest = start + share[:, None] * way
        rows = np.flatnonzero(np.einsum("ij,ij->i", nearest, nearest) < (reach + wide) ** 2)
        if rows.size:
            result.append((other, rows))
    return result
