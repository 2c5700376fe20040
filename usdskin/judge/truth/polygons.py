"""Lambert's formula: what a polygon of even radiance gives a surface, exactly.

The projected solid angle of a polygon seen from a point x on a surface with normal n is
``(1/2) sum_k angle(v_k, v_k+1) n . unit(v_k x v_k+1)`` over its vertices v_k, relative to x and cut
at the horizon (Lambert 1760; Baum, Rushmeier and Winget, "Improving radiosity solutions through
the use of analytically determined form-factors", SIGGRAPH 1989). Divided by pi it is the form
factor; times the radiance it is the irradiance.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_TINY = 1e-300


def projected_solid_angle(vertices: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the projected solid angles of convex polygons [sr], not negative, shape [...].

    Args:
        vertices: Corners relative to the point, in either order, shape [..., corner_count, 3].
        normal: Unit normal of the surface at the point, shape [..., 3].
    """
    total = np.zeros(vertices.shape[:-2])
    leaves, enters = np.zeros((*total.shape, 3)), np.zeros((*total.shape, 3))
    count = vertices.shape[-2]
    heights = np.einsum("...kc,...c->...k", vertices, normal)
    for k in range(count):
        a, b = vertices[..., k, :], vertices[..., (k + 1) % count, :]
        high_a, high_b = heights[..., k], heights[..., (k + 1) % count]
        falls, rises = (high_a > 0.0) & (high_b <= 0.0), (high_a <= 0.0) & (high_b > 0.0)
        crosses = falls | rises
        share = np.where(crosses, high_a / np.where(crosses, high_a - high_b, 1.0), 0.0)
        at = a + share[..., None] * (b - a)
        leaves[falls], enters[rises] = at[falls], at[rises]
        begin = np.where(rises[..., None], at, a)
        end = np.where(falls[..., None], at, b)
        part = _edge(begin, end, normal)
        total += np.where((high_a > 0.0) | (high_b > 0.0), part, 0.0)
    total += _edge(leaves, enters, normal)
    return np.asarray(0.5 * np.abs(total))


def _edge(a: FloatArray, b: FloatArray, normal: FloatArray) -> FloatArray:
    cross = np.cross(a, b)
    sine = np.sqrt((cross**2).sum(axis=-1))
    angle = np.arctan2(sine, (a * b).sum(axis=-1))
    return np.asarray(angle / np.maximum(sine, _TINY) * np.einsum("...c,...c->...", cross, normal))


def clip_above(polygons: FloatArray) -> FloatArray:
    """Return the parts of convex quads with z > 0, shape [count, 5, 3].

    Corners that are left over repeat the last one; a quad that is below is all zeros.

    Args:
        polygons: Corners, shape [count, 4, 3].
    """
    result = np.concatenate([polygons, polygons[:, -1:]], axis=1)
    above = polygons[:, :, 2] > 0.0
    result[~above.any(axis=1)] = 0.0
    for index in np.flatnonzero(above.any(axis=1) & ~above.all(axis=1)):
        corners = []
        for k in range(4):
            a, b = polygons[index, k], polygons[index, (k + 1) % 4]
            if a[2] > 0.0:
                corners.append(a)
            if (a[2] > 0.0) != (b[2] > 0.0):
                cut = a + (b - a) * (a[2] / (a[2] - b[2]))
                cut[2] = 0.0
                corners.append(cut)
        result[index] = [*corners, *[corners[-1]] * (5 - len(corners))]
    return np.asarray(result)


def projected_in_plane(points: FloatArray, clipped: FloatArray) -> FloatArray:
    """Return the projected solid angles [sr] of polygons above a plane, from points on it.

    Those that run counter-clockwise as seen from above have a negative sign: a surface's front,
    whose corners run counter-clockwise from where it is seen, gives a positive one.

    Args:
        points: x and y in the plane z = 0, shape [point_count, 2].
        clipped: As ``clip_above`` gives them, shape [polygon_count, 5, 3].

    Returns:
        Shape [point_count, polygon_count].
    """
    total = np.zeros((len(points), len(clipped)))
    px, py = points[:, :1], points[:, 1:]
    for k in range(5):
        _add_edges(total, px, py, clipped[:, k], clipped[:, (k + 1) % 5])
    return np.asarray(0.5 * total)


def _add_edges(
    total: FloatArray, px: FloatArray, py: FloatArray, begin: FloatArray, end: FloatArray
) -> None:
    """Subtract the part of one edge of every polygon."""
    live = np.flatnonzero((begin != end).any(axis=1))
    if not live.size:
        return
    a, b = begin[live], end[live]
    ax, ay, bx, by = a[:, 0] - px, a[:, 1] - py, b[:, 0] - px, b[:, 1] - py
    az, bz = a[:, 2], b[:, 2]
    up = ax * by - ay * bx
    square = up * up
    cross = ay * bz - az * by
    square += cross * cross
    cross = az * bx - ax * bz
    square += cross * cross
    sine = np.sqrt(square)
    ax *= bx
    ay *= by
    ax += ay
    ax += az * bz
    angle = np.arctan2(sine, ax)
    angle *= up
    angle /= np.maximum(sine, _TINY)
    if live.size == total.shape[1]:
        total -= angle
    else:
        total[:, live] -= angle
