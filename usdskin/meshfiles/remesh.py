"""Decimation and repair, through open3d."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.meshfiles.edit import (
    drop_degenerate_faces,
    flip_faces,
    keep_faces,
    triangulated,
    unique_rows,
    weld_points,
)
from usdskin.meshfiles.meshfile import MeshFile
from usdskin.meshfiles.through_open3d import from_open3d, load_open3d, quiet, to_open3d
from usdskin.notes import Note


def decimate(mesh: MeshFile, face_count: int, notes: list[Note]) -> MeshFile:
    """Return a mesh of at most ``face_count`` triangles, by quadric error (Garland, 1997).

    Groups, objects and materials go to the triangles nearest to their faces. Texture coordinates
    and normals do not survive, and a note says so.

    Raises:
        UsdSkinError: open3d cannot be loaded.
    """
    triangles, _ = triangulated(mesh)
    if triangles.face_count <= face_count:
        return mesh
    open3d = load_open3d()
    with quiet(open3d):
        found = to_open3d(open3d, weld_points(triangles))
        found = found.simplify_quadric_decimation(int(face_count))
        found.remove_unreferenced_vertices()
        result = from_open3d(mesh.source, found, with_normals=False)
        nearest = _nearest_faces(open3d, triangles, result)
    lost = [name for name in ("st", "normals", "colors") if getattr(mesh, name) is not None]
    if lost:
        what = f"{', '.join(lost)} do not survive decimation"
        notes.append(Note("decimation-drops-attributes", str(mesh.source), what))
    subsets = {
        name: {
            subset: np.flatnonzero(np.isin(nearest, faces)).astype(np.int32)
            for subset, faces in getattr(triangles, name).items()
        }
        for name in ("groups", "objects", "materials")
    }
    return dataclasses.replace(
        result,
        definitions=mesh.definitions,
        meters_per_unit=mesh.meters_per_unit,
        up_axis=mesh.up_axis,
        groups=subsets["groups"],
        objects=subsets["objects"],
        materials=subsets["materials"],
    )


def _nearest_faces(open3d: Any, source: MeshFile, target: MeshFile) -> NDArray[np.int64]:
    scene = open3d.t.geometry.RaycastingScene()
    points = open3d.core.Tensor(source.points.astype(np.float32))
    faces = open3d.core.Tensor(source.face_indices.reshape(-1, 3).astype(np.uint32))
    scene.add_triangles(points, faces)
    centers = target.points[target.face_indices.reshape(-1, 3)].mean(axis=1).astype(np.float32)
    found = scene.compute_closest_points(open3d.core.Tensor(centers))
    return np.asarray(found["primitive_ids"].numpy(), dtype=np.int64)


def repair(mesh: MeshFile, notes: list[Note]) -> MeshFile:
    """Return the mesh with joined points, without faces that spoil it, and turned one way.

    Points at one position are joined; faces that name a point twice or repeat another, and the
    smallest faces on edges with more than two, are dropped; neighbours are turned alike where the
    surface has two sides, and a closed mesh outwards. Polygons, st, normals and groups stay.

    Raises:
        UsdSkinError: open3d cannot be loaded.
    """
    open3d = load_open3d()
    welded = weld_points(mesh)
    sound = drop_degenerate_faces(welded)
    with quiet(open3d):
        manifold = _drop_non_manifold(open3d, sound)
        turned, flipped = _turn_alike(open3d, manifold)
    done = {
        "points joined": len(mesh.points) - len(welded.points),
        "degenerate or repeated faces dropped": welded.face_count - sound.face_count,
        "faces on non-manifold edges dropped": sound.face_count - manifold.face_count,
        "faces turned": flipped,
    }
    what = ", ".join(f"{count} {name}" for name, count in done.items() if count)
    notes.append(Note("mesh-repaired", str(mesh.source), what or "nothing to repair"))
    return turned


def _drop_non_manifold(open3d: Any, mesh: MeshFile) -> MeshFile:
    triangles, parents = triangulated(mesh)
    found = to_open3d(open3d, triangles)
    if not len(found.get_non_manifold_edges(allow_boundary_edges=True)):
        return mesh
    found.remove_non_manifold_edges()
    before = np.sort(triangles.face_indices.reshape(-1, 3), axis=1)
    after = np.sort(np.asarray(found.triangles, dtype=np.int32), axis=1)
    _, which = unique_rows(np.concatenate([after, before]))
    lost = ~np.isin(which[len(after) :], which[: len(after)])
    kept = np.ones(mesh.face_count, dtype=bool)
    kept[parents[lost]] = False
    return keep_faces(mesh, kept)


def _turn_alike(open3d: Any, mesh: MeshFile) -> tuple[MeshFile, int]:
    triangles, parents = triangulated(mesh)
    found = to_open3d(open3d, triangles)
    parts = np.asarray(found.cluster_connected_triangles()[0], dtype=np.int64)
    if not found.orient_triangles():
        return mesh, 0
    before = triangles.face_indices.reshape(-1, 3)
    after = np.asarray(found.triangles, dtype=np.int32)
    # A turned triangle is an odd permutation of its corners.
    alike = [(after == np.roll(before, shift, axis=1)).all(axis=1) for shift in range(3)]
    turned = ~np.logical_or.reduce(alike)
    wrong_way = _inside_out(mesh.points[after], after, parts, turned)
    flipped = np.zeros(mesh.face_count, dtype=bool)
    flipped[parents[turned ^ wrong_way[parts]]] = True
    return flip_faces(mesh, flipped), int(flipped.sum())


def _inside_out(
    corners: NDArray[np.float64],
    triangles: NDArray[np.int32],
    parts: NDArray[np.int64],
    turned: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Return which connected parts, each turned one way, are to be turned the other way.

    A closed part has its outside where its signed volume is positive; an open one keeps the side
    that most of its triangles had.

    Args:
        corners: Positions of the triangles, shape [triangle_count, 3, 3].
        triangles: Their points, shape [triangle_count, 3].
        parts: Part of each triangle, shape [triangle_count].
        turned: Which triangles were turned, shape [triangle_count].
    """
    volume = np.bincount(
        parts, np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2]))
    )
    edges = np.sort(np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2), axis=2)
    first, which = unique_rows(edges.reshape(-1, 2))
    lonely = np.bincount(which, minlength=len(first)) == 1
    is_open = np.bincount(np.repeat(parts, 3), lonely[which]) > 0.0
    mostly_turned = np.bincount(parts, turned) > 0.5 * np.bincount(parts)
    return np.where(is_open, mostly_turned, volume < 0.0)
