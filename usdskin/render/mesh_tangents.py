"""Frames of texture coordinates on a surface: tangents, and the gradients of s and t.

Tangents are those of MikkTSpace (Mikkelsen, "Simulation of Wrinkled Surfaces Revisited", 2008),
which normal maps are baked for: a vertex is what has one position, normal and texture coordinate;
around it the triangles of either handedness have a tangent of their own, the mean of theirs by the
angle of the corner, in the plane of the normal. The order of triangles and vertices does not count.
Unlike the reference code, quads are cut first, and fans that meet in one such vertex without an
edge between them share a tangent.

Pure NumPy: no USD here.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.render.mesh_limit import unit
from usdskin.render.mesh_topology import FloatArray, IndexArray
from usdskin.render.polygons import cross

_FLAT = 1e-12
"""Area in texture coordinates, as a share of its squared extent, below which a triangle has no
tangent."""


@dataclass(frozen=True, slots=True, eq=False)
class Corners:
    """The corners of triangles, three by three."""

    points: FloatArray
    """Positions [m], shape [triangle_count, 3, 3]."""

    normals: FloatArray
    """Unit shading normals, shape [triangle_count, 3, 3]."""

    st: FloatArray
    """Texture coordinates, shape [triangle_count, 3, 2]."""


def tangent_frames(corners: Corners) -> NDArray[np.float32]:
    """Return the tangent of each corner, and the sign of its bitangent sign x (N x T).

    Args:
        corners: The triangles.

    Returns:
        Unit tangents and signs, 0 where the texture coordinates span no area around the corner,
        shape [triangle_count, 3, 4].
    """
    along_s, _, area = _triangle_gradients(corners)
    sign = np.where(area < 0.0, -1.0, 1.0)
    vertex = names_of(corners.normals, corners.points, corners.st, sign[:, None, None])
    (tangent,) = _averaged((along_s,), area != 0.0, corners, vertex)
    frames = np.empty((*tangent.shape[:2], 4), np.float32)
    frames[..., :3] = unit(tangent.reshape(-1, 3)).reshape(tangent.shape)
    frames[..., 3] = sign[:, None]
    return frames


def gradient_frames(corners: Corners) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the surface gradients of s and of t at each corner [1/m].

    They turn a slope per unit of s and t into one per metre. Vertices and weights are those of the
    tangents.

    Args:
        corners: The triangles.

    Returns:
        Gradients of s and of t, 0 where the coordinates span no area, shape [triangle_count, 3, 4]
        each; the last column is 0.
    """
    _, gradients, area = _triangle_gradients(corners)
    sign = np.where(area < 0.0, -1.0, 1.0)
    vertex = names_of(corners.normals, corners.points, corners.st, sign[:, None, None])
    averaged = _averaged(gradients, area != 0.0, corners, vertex, lengths=True)
    found = np.zeros((2, *corners.st.shape[:2], 4), np.float32)
    for frames, gradient in zip(found, averaged, strict=True):
        frames[..., :3] = gradient
    return found[0], found[1]


def _triangle_gradients(
    corners: Corners,
) -> tuple[FloatArray, tuple[FloatArray, FloatArray], FloatArray]:
    """Return dP/ds, the gradients of s and t, and the signed area in st of each triangle."""
    first, second = (corners.points[:, k] - corners.points[:, 0] for k in (1, 2))
    ab, ac = (corners.st[:, k] - corners.st[:, 0] for k in (1, 2))
    area = ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]
    extent = np.maximum(np.einsum("ij,ij->i", ab, ab), np.einsum("ij,ij->i", ac, ac))
    area = np.where(np.abs(area) > _FLAT * extent, area, 0.0)
    safe = np.where(area == 0.0, 1.0, area)[:, None]
    along_s = (ac[:, 1:] * first - ab[:, 1:] * second) / safe
    normal = cross(first, second)
    square = np.maximum(np.einsum("ij,ij->i", normal, normal), np.finfo(float).tiny)[:, None]
    # Barycentric coordinates of the second and third corner rise along these.
    rise = cross(second, normal) / square, cross(normal, first) / square
    gradients = [ab[:, k : k + 1] * rise[0] + ac[:, k : k + 1] * rise[1] for k in (0, 1)]
    return along_s, (gradients[0], gradients[1]), area


def _averaged(
    of_triangle: Sequence[FloatArray],
    valid: NDArray[np.bool_],
    corners: Corners,
    vertex: IndexArray,
    *,
    lengths: bool = False,
) -> list[FloatArray]:
    """Return the means around each vertex, by angle, of vectors laid into the normals' planes.

    Args:
        of_triangle: Fields of vectors, shape [triangle_count, 3] each.
        valid: Triangles that count, shape [triangle_count].
        corners: The triangles.
        vertex: Vertex of each corner, shape [triangle_count, 3].
        lengths: Whether lengths count, or directions only.

    Returns:
        Vectors of the corners, shape [triangle_count, 3, 3] each.
    """
    weight = corner_angles(corners.points, corners.normals) * valid[:, None]
    averaged = []
    for vectors in of_triangle:
        flat = laid_flat(vectors[:, None], corners.normals)
        if not lengths:
            flat = unit(flat.reshape(-1, 3)).reshape(flat.shape)
        total = sums_by_name(vertex, weight[..., None] * flat)
        if lengths:
            share = sums_by_name(vertex, weight[..., None])
            total /= np.maximum(share, np.finfo(float).tiny)
        averaged.append(total[vertex])
    return averaged


def sums_by_name(name: IndexArray, values: FloatArray) -> FloatArray:
    """Return the sums of corner values by name, shape [name_count, k].

    Args:
        name: Names as ``names_of`` gives them, shape [triangle_count, 3].
        values: Shape [triangle_count, 3, k].
    """
    count = int(name.max(initial=-1)) + 1
    columns = [
        np.bincount(name.ravel(), values[..., k].ravel(), minlength=count)
        for k in range(values.shape[-1])
    ]
    return np.stack(columns, axis=1)


def laid_flat(vectors: FloatArray, normals: FloatArray) -> FloatArray:
    """Return vectors without their part along unit normals, shapes [..., 3]."""
    along = vectors[..., 0] * normals[..., 0]
    along = along + vectors[..., 1] * normals[..., 1] + vectors[..., 2] * normals[..., 2]
    flat: FloatArray = vectors - along[..., None] * normals
    return flat


def corner_angles(points: FloatArray, normals: FloatArray | None = None) -> FloatArray:
    """Return the angles of triangles at their corners, seen along normals where given [rad].

    Args:
        points: Positions of the corners, shape [triangle_count, 3, 3].
        normals: Unit normals of the corners, shape [triangle_count, 3, 3].

    Returns:
        Angles, shape [triangle_count, 3].
    """
    ahead = points[:, [1, 2, 0]] - points
    behind = -ahead[:, [2, 0, 1]]
    if normals is not None:
        ahead, behind = laid_flat(ahead, normals), laid_flat(behind, normals)
    opening = np.linalg.norm(cross(ahead, behind), axis=-1)
    angles: FloatArray = np.arctan2(opening, np.einsum("...i,...i->...", ahead, behind))
    return angles


def names_of(*columns: FloatArray) -> IndexArray:
    """Return one number for all corners that have the same values, shape [triangle_count, 3].

    Values are told apart as float32, by a 64-bit hash of all of them.

    Args:
        columns: Values, shapes [triangle_count, 3 or 1, k].
    """
    shape = max((column.shape[:2] for column in columns), key=lambda shape: shape[1])
    name = np.zeros(shape, np.uint64)
    for column in columns:
        # Adding 0 turns -0 into 0, which is the same place.
        bits = np.ascontiguousarray(column, np.float32) + np.float32(0.0)
        for k in range(bits.shape[2]):
            mixed = np.broadcast_to(bits[..., k], shape).copy().view(np.uint32).astype(np.uint64)
            name = _mixed(name ^ _mixed(mixed + np.uint64(k + 1)))
    _, index = np.unique(name.ravel(), return_inverse=True)
    return index.reshape(shape)


def _mixed(word: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Return words whose bits depend on all of theirs (Steele et al. 2014, SplitMix64)."""
    word = word + np.uint64(0x9E3779B97F4A7C15)
    word = (word ^ (word >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    word = (word ^ (word >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    mixed: NDArray[np.uint64] = word ^ (word >> np.uint64(31))
    return mixed
