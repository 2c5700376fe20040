"""Cut, join and complete meshes; polygons, texture coordinates and groups stay what they are."""

from __future__ import annotations

import dataclasses
import difflib
from collections.abc import Callable, Iterable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import MeshError, UsageError
from usdskin.meshfiles.meshfile import MeshFile


def faces_where(
    mesh: MeshFile, predicate: Callable[[NDArray[np.float64]], NDArray[np.bool_]]
) -> NDArray[np.bool_]:
    """Return which faces have every corner where ``predicate`` holds.

    Args:
        mesh: Mesh to look at.
        predicate: Gets the points [the file's unit], shape [point_count, 3], and returns a flag for
            each, such as ``lambda points: points[:, 1] > 13.5``.

    Returns:
        One flag per face, shape [face_count].
    """
    held = np.asarray(predicate(mesh.points), dtype=bool)
    if held.shape != (len(mesh.points),):
        raise ValueError(f"the predicate gave the shape {held.shape}, not one flag per point")
    return np.logical_and.reduceat(held[mesh.face_indices], mesh.face_starts)


def keep_faces(mesh: MeshFile, kept: NDArray[np.bool_]) -> MeshFile:
    """Return a mesh of some of the faces, without the points no face uses any more.

    Args:
        mesh: Mesh to cut.
        kept: One flag per face, shape [face_count].

    Raises:
        MeshError: No face is kept.
    """
    kept = np.asarray(kept, dtype=bool)
    if kept.shape != (mesh.face_count,):
        raise ValueError(f"{kept.shape} flags for {mesh.face_count} faces")
    if not kept.any():
        raise MeshError(f"{mesh.source}: no face is left after cropping; keep more of it")
    corners = np.repeat(kept, mesh.face_counts)
    used, face_indices = _compact(len(mesh.points), mesh.face_indices[corners])
    changes: dict[str, object] = {
        "points": mesh.points[used],
        "face_counts": mesh.face_counts[kept],
        "face_indices": face_indices,
        "colors": None if mesh.colors is None else mesh.colors[used],
    }
    if mesh.st is not None and mesh.st_indices is not None:
        used, changes["st_indices"] = _compact(len(mesh.st), mesh.st_indices[corners])
        changes["st"] = mesh.st[used]
    if mesh.normals is not None and mesh.normal_indices is not None:
        used, changes["normal_indices"] = _compact(len(mesh.normals), mesh.normal_indices[corners])
        changes["normals"] = mesh.normals[used]
    renumbered = np.cumsum(kept) - 1
    for name in ("groups", "objects", "materials"):
        subsets = {
            subset: renumbered[faces[kept[faces]]].astype(np.int32)
            for subset, faces in getattr(mesh, name).items()
        }
        changes[name] = {subset: faces for subset, faces in subsets.items() if len(faces)}
    return dataclasses.replace(mesh, **changes)  # type: ignore[arg-type]


def keep_groups(mesh: MeshFile, names: Iterable[str]) -> MeshFile:
    """Return the faces that are in one of the named groups, objects or materials.

    Raises:
        UsageError: No group, object or material has the name.
    """
    kept = np.zeros(mesh.face_count, dtype=bool)
    known = {**mesh.materials, **mesh.objects, **mesh.groups}
    for name in names:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=3, cutoff=0.4) or sorted(known)[:6]
            told = f"; it has {', '.join(near)}" if near else "; it has no groups at all"
            raise UsageError(f"{mesh.source}: has no group named {name!r}{told}")
        for subsets in (mesh.groups, mesh.objects, mesh.materials):
            if name in subsets:
                kept[subsets[name]] = True
    return keep_faces(mesh, kept)


def weld_points(mesh: MeshFile) -> MeshFile:
    """Return the mesh with one point for each position.

    Formats with one index for everything split points along the seams of texture and normals, where
    subdivision would then tear the surface open. The corners keep their own st and normals.
    """
    first, which = unique_rows(mesh.points)
    if len(first) == len(mesh.points):
        return mesh
    return dataclasses.replace(
        mesh,
        points=mesh.points[first],
        face_indices=which[mesh.face_indices].astype(np.int32),
        colors=None if mesh.colors is None else mesh.colors[first],
    )


def drop_degenerate_faces(mesh: MeshFile) -> MeshFile:
    """Return the mesh without repeated faces and faces that name a point twice.

    A face is repeated when an earlier one has the same points, in any order.
    """
    kept = np.ones(mesh.face_count, dtype=bool)
    starts = mesh.face_starts
    for count in np.unique(mesh.face_counts):
        faces = np.flatnonzero(mesh.face_counts == count)
        corners = np.sort(mesh.face_indices[starts[faces, None] + np.arange(count)], axis=1)
        kept[faces[(np.diff(corners, axis=1) == 0).any(axis=1)]] = False
        first, _ = unique_rows(corners)
        repeated = np.ones(len(faces), dtype=bool)
        repeated[first] = False
        kept[faces[repeated]] = False
    return mesh if kept.all() else keep_faces(mesh, kept)


def triangulated(mesh: MeshFile) -> tuple[MeshFile, NDArray[np.int32]]:
    """Return the mesh with every polygon cut into a fan of triangles.

    Returns:
        The mesh of triangles, and the polygon each triangle comes from, shape [triangle_count].
    """
    parents = np.repeat(np.arange(mesh.face_count, dtype=np.int32), mesh.face_counts - 2)
    starts = mesh.face_starts[parents]
    # The k-th triangle of a polygon has its corners 0, k + 1 and k + 2.
    fans = np.repeat(np.cumsum(mesh.face_counts - 2) - (mesh.face_counts - 2), mesh.face_counts - 2)
    step = np.arange(len(parents)) - fans
    corners = np.stack([starts, starts + step + 1, starts + step + 2], axis=1).ravel()
    st, normals = mesh.st_indices, mesh.normal_indices
    triangles = dataclasses.replace(
        mesh,
        face_counts=np.full(len(parents), 3, dtype=np.int32),
        face_indices=mesh.face_indices[corners],
        st_indices=None if st is None else st[corners],
        normal_indices=None if normals is None else normals[corners],
        groups=_faces_from(mesh.groups, parents),
        objects=_faces_from(mesh.objects, parents),
        materials=_faces_from(mesh.materials, parents),
    )
    return triangles, parents


def _faces_from(
    subsets: dict[str, NDArray[np.int32]], parents: NDArray[np.int32]
) -> dict[str, NDArray[np.int32]]:
    return {
        name: np.flatnonzero(np.isin(parents, faces)).astype(np.int32)
        for name, faces in subsets.items()
    }


def angle_weighted_normals(mesh: MeshFile) -> NDArray[np.float64]:
    """Return the unit normal of each point: the mean of its corners', weighted by their angles.

    Unlike a mean over faces it does not depend on how the polygons are cut up (Thuermer and
    Wuethrich, "Computing vertex normals from polygonal facets", J. Graphics Tools 3(1), 1998).

    Returns:
        Unit normals [1], shape [point_count, 3]; (0, 0, 1) where a point has no area around it.
    """
    starts = np.repeat(mesh.face_starts, mesh.face_counts)
    counts = np.repeat(mesh.face_counts, mesh.face_counts)
    place = np.arange(len(mesh.face_indices)) - starts
    here = mesh.points[mesh.face_indices]
    following = mesh.points[mesh.face_indices[starts + (place + 1) % counts]] - here
    previous = mesh.points[mesh.face_indices[starts + (place - 1) % counts]] - here
    across: NDArray[np.float64] = np.cross(following, previous)
    angle = np.arctan2(np.linalg.norm(across, axis=1), np.einsum("ij,ij->i", following, previous))
    # A corner of a concave polygon bends the other way: the face's own normal gives the side.
    areas: NDArray[Any] = np.add.reduceat(across, mesh.face_starts, axis=0)
    face = np.repeat(areas, mesh.face_counts, axis=0)
    concave = np.einsum("ij,ij->i", across, face) < 0.0
    weighted = _unit(face) * np.where(concave, 2.0 * np.pi - angle, angle)[:, None]
    total: NDArray[Any] = np.stack(
        [np.bincount(mesh.face_indices, weighted[:, i], len(mesh.points)) for i in range(3)], axis=1
    )
    normals = _unit(total)
    normals[~normals.any(axis=1)] = (0.0, 0.0, 1.0)
    return normals


def flip_faces(mesh: MeshFile, flipped: NDArray[np.bool_]) -> MeshFile:
    """Return the mesh with the corners of some faces in reverse order, first corner first.

    Args:
        mesh: Mesh to turn.
        flipped: One flag per face, shape [face_count].
    """
    counts = np.repeat(mesh.face_counts, mesh.face_counts)
    starts = np.repeat(mesh.face_starts, mesh.face_counts)
    place = np.arange(len(mesh.face_indices)) - starts
    turned = np.repeat(flipped, mesh.face_counts)
    order = starts + np.where(turned, -place % counts, place)
    st, normals = mesh.st_indices, mesh.normal_indices
    return dataclasses.replace(
        mesh,
        face_indices=mesh.face_indices[order],
        st_indices=None if st is None else st[order],
        normal_indices=None if normals is None else normals[order],
    )


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    unit: NDArray[np.float64] = np.divide(
        vectors, length, out=np.zeros_like(vectors), where=length > 0.0
    )
    return unit


def _compact(count: int, indices: NDArray[np.int32]) -> tuple[NDArray[np.int64], NDArray[np.int32]]:
    """Return the values still used, in their old order, and the indices into those."""
    used = np.zeros(count, dtype=bool)
    used[indices] = True
    renumbered = (np.cumsum(used) - 1).astype(np.int32)
    return np.flatnonzero(used), renumbered[indices]


def unique_rows(
    rows: NDArray[np.float64] | NDArray[np.int32],
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the first row of each kind in order of appearance, and each row's kind."""
    # + 0.0 makes -0.0 and 0.0 one position.
    keys = np.ascontiguousarray(rows.astype(np.float64) + 0.0)
    packed = keys.view(np.dtype((np.void, keys.dtype.itemsize * keys.shape[1]))).ravel()
    _, first, inverse = np.unique(packed, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    return first[order], rank[inverse.ravel()]
