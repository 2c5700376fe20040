"""Shapes as triangles, and solids of revolution among them.

Pure NumPy: no USD here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from usdskin.render.mesh_topology import FloatArray, IndexArray

COLUMNS = 192
"""Segments around an axis: the chord stays within 1.4e-4 of the radius."""

_ENDS = np.array([[0, 0, 1], [0, 1, 1]])
"""End of the strip (low, high) of each corner of the two triangles of a quad."""

_STEPS = np.array([[0, 1, 1], [0, 1, 0]])
"""Column, counted from the quad's own, of each corner of the two triangles."""


@dataclass(frozen=True, slots=True, eq=False)
class Shape:
    """Triangles of a shape in its own space."""

    points: FloatArray
    """Positions, shape [point_count, 3]."""

    triangles: IndexArray
    """Points, counter-clockwise seen from outside, shape [triangle_count, 3]."""

    normals: FloatArray
    """Unit normals at the corners, shape [triangle_count, 3, 3]."""

    st: FloatArray
    """Texture coordinates at the corners, shape [triangle_count, 3, 2]."""

    closed: bool
    """Whether it encloses a volume."""


def revolve(profile: FloatArray, strip_normals: FloatArray, columns: int = COLUMNS) -> Shape:
    """Turn a profile about +Z.

    ``st`` goes once around and, by the length of the profile, from bottom to top; on a flat end it
    maps the disc into the unit square.

    Args:
        profile: Radius and z from the bottom pole, radius 0, to the top one, shape [n, 2].
        strip_normals: Outward unit normals (radial, z) at the low and the high end of the strips
            between successive profile points, shape [n - 1, 2, 2].
        columns: Segments around the axis.
    """
    column = np.arange(columns)
    name = np.arange(len(profile))[:, None] * columns + np.arange(columns + 1) % columns
    is_pole = profile[:, 0] <= 0.0
    name[is_pole] = name[is_pole, :1]
    has_length = np.any(np.diff(profile, axis=0) != 0.0, axis=1)
    triangles, normals, st = [], [], []
    for kind in (0, 1):
        # The first triangle has two low corners, the second two high ones: at a pole they meet.
        collapsed = is_pole[kind : len(profile) - 1 + kind]
        strip = np.flatnonzero(has_length & ~collapsed)
        ring = strip[:, None, None] + _ENDS[kind]
        place = column[:, None] + _STEPS[kind]
        triangles.append(name[ring, place].reshape(-1, 3))
        around = np.where(is_pole[ring], column[:, None] + 0.5, place) / columns
        outward = strip_normals[strip[:, None], _ENDS[kind]][:, None]
        turn = 2.0 * np.pi * around
        across, up = np.broadcast_arrays(outward[..., 0], outward[..., 1], turn)[:2]
        normal = np.stack([across * np.cos(turn), across * np.sin(turn), up], axis=-1)
        normals.append(normal.reshape(-1, 3, 3))
        st.append(_texture(profile, ring, around, strip_normals[strip]).reshape(-1, 3, 2))
    angle = 2.0 * np.pi * column / columns
    points = np.empty((len(profile), columns, 3))
    points[..., 0] = profile[:, :1] * np.cos(angle)
    points[..., 1] = profile[:, :1] * np.sin(angle)
    points[..., 2] = profile[:, 1:]
    joined = np.concatenate(triangles)
    used = np.unique(joined)
    number = np.zeros(points.size // 3, dtype=np.intp)
    number[used] = np.arange(len(used))
    return Shape(
        points.reshape(-1, 3)[used],
        number[joined],
        np.concatenate(normals),
        np.concatenate(st),
        True,
    )


def _texture(
    profile: FloatArray, ring: IndexArray, around: FloatArray, strip_normals: FloatArray
) -> FloatArray:
    """Return texture coordinates of the corners of strips, shape [strips, columns, 3, 2]."""
    tiny = np.finfo(float).tiny
    reach = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(profile, axis=0), axis=1)))
    height = np.broadcast_to((reach / max(reach[-1], tiny))[ring], around.shape)
    share = 0.5 * (profile[:, 0] / max(float(profile[:, 0].max()), tiny))[ring]
    turn = 2.0 * np.pi * around
    disc = np.stack([0.5 + share * np.cos(turn), 0.5 + share * np.sin(turn)], axis=-1)
    is_flat = ~np.any(strip_normals[:, :, 0], axis=1)
    wrapped = np.stack([around, height], axis=-1)
    return np.where(is_flat[:, None, None, None], disc, wrapped)
