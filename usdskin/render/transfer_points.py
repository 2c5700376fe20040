"""The places of a mesh that a transfer is measured at, and the corners that look it up.

A place is a point of the mesh with one of its materials: what is behind the surface depends on
whether it is skin. Where shading normals differ around a point it is shaded once per normal.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.render.meshes import MeshArrays

_NORMAL_STEPS = 1000
"""Normals closer than one part in so many are one."""


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """The places of one mesh."""

    point: NDArray[np.int64]
    """Point of the mesh, shape [count]."""

    slot: NDArray[np.int64]
    """Index into the mesh's material paths, shape [count]."""

    normal: NDArray[np.float32]
    """Mean unit normal, shape [count, 3]."""

    spread: NDArray[np.float32]
    """Sine of the angle by which shading normals differ from it, shape [count]."""

    corner_place: NDArray[np.int64]
    """Place of each corner of the triangles, shape [3 triangle_count]."""


@dataclass(frozen=True, slots=True, eq=False)
class ShadedVertices:
    """Places with one normal each."""

    place: NDArray[np.int64]
    """Shape [count]."""

    normal: NDArray[np.float32]
    """Unit normals, shape [count, 3]."""

    corner_vertex: NDArray[np.int64]
    """Vertex of each corner of the triangles, shape [3 triangle_count]."""


def places_of(mesh: MeshArrays) -> Places:
    """Return the places of a mesh, in the order of their points."""
    corner_slot = np.repeat(mesh.material_slot.astype(np.int64), 3)
    key = mesh.triangles.astype(np.int64).ravel() * len(mesh.material_paths) + corner_slot
    found, corner_place = np.unique(key, return_inverse=True)
    corner_place = corner_place.reshape(-1)
    corner_normal = mesh.normals.reshape(-1, 3).astype(np.float64)
    total = np.stack(
        [np.bincount(corner_place, corner_normal[:, axis], len(found)) for axis in range(3)],
        axis=-1,
    )
    length = np.linalg.norm(total, axis=-1)
    first = np.zeros(len(found), np.int64)
    first[corner_place[::-1]] = np.arange(len(corner_place))[::-1]
    total = np.where((length > 1e-6)[:, None], total, corner_normal[first])
    mean = total / np.maximum(np.linalg.norm(total, axis=-1), 1e-12)[:, None]
    cosine = np.einsum("ij,ij->i", mean[corner_place], corner_normal)
    least = np.ones(len(found))
    np.minimum.at(least, corner_place, cosine)
    spread = np.where(least > 0.0, np.sqrt(np.maximum(1.0 - least**2, 0.0)), 1.0)
    return Places(
        found // len(mesh.material_paths),
        found % len(mesh.material_paths),
        mean.astype(np.float32),
        spread.astype(np.float32),
        corner_place,
    )


def facet_spread(mesh: MeshArrays, places: Places) -> NDArray[np.float32]:
    """Return the sine of the angle by which a place's triangles tilt from its normal, [count].

    1 where one faces away. Light from further behind than that comes out of the body.
    """
    corner = mesh.points[mesh.triangles].astype(np.float64)
    across = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    across /= np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-30)
    normal = places.normal[places.corner_place]
    cosine = np.einsum("ij,ij->i", normal, np.repeat(across, 3, axis=0))
    least = np.ones(len(places.point))
    np.minimum.at(least, places.corner_place, cosine)
    found = np.where(least > 0.0, np.sqrt(np.maximum(1.0 - least**2, 0.0)), 1.0)
    return found.astype(np.float32)


def shaded_vertices(mesh: MeshArrays, places: Places) -> ShadedVertices:
    """Return what the corners of a mesh look up."""
    normal = mesh.normals.reshape(-1, 3)
    steps = np.rint((normal + 1.0) * _NORMAL_STEPS).astype(np.int64)
    key = places.corner_place
    for axis in range(3):
        key = key * (2 * _NORMAL_STEPS + 2) + steps[:, axis]
    _, first, corner_vertex = np.unique(key, return_index=True, return_inverse=True)
    return ShadedVertices(places.corner_place[first], normal[first], corner_vertex.reshape(-1))
