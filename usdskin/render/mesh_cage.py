"""Read the control mesh of a ``UsdGeomMesh``, checked, in world space.

Reads: ``UsdGeomMesh`` topology, points, orientation and subdivision tags. What comes out is wound
counter-clockwise as seen from outside, whatever ``orientation`` and a mirroring transform said.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdskin.errors import MeshError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.mesh_net import Net, control_net, find_edges, sharpen
from usdskin.render.mesh_topology import BoolArray, FloatArray, IndexArray
from usdskin.render.mesh_values import (
    read_indices,
    read_numbers,
    read_points,
    read_token,
    read_whole_numbers,
    vector_text,
)
from usdskin.render.polygons import reversed_corners, unrepeated_corners

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom

_SINGULAR = 1e-9
"""Ratio of the smallest to the largest stretch below which a transform counts as singular."""


@dataclass(frozen=True, slots=True, eq=False)
class Cage:
    """A control mesh in world space."""

    where: str
    """Layer and prim path, for errors."""

    scheme: str
    """``subdivisionScheme``."""

    points: FloatArray
    """Positions [m], shape [vertex_count, 3]."""

    face_counts: IndexArray
    """Corners per face, at least 3, shape [face_count]."""

    corner_vertex: IndexArray
    """Vertex of each corner, shape [corner_count]."""

    source_corner: IndexArray
    """Face-vertex, as authored, that each corner is, shape [corner_count]."""

    source_face: IndexArray
    """Face, as authored, that each face is, shape [face_count]."""

    authored_faces: int
    """Number of faces as authored."""

    authored_corners: int
    """Number of face-vertices as authored."""

    is_hole: BoolArray
    """Faces that are part of the mesh but not shown, shape [face_count]."""


def read_cage(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    to_world: FloatArray,
    notes: list[Note],
    posed: FloatArray | None = None,
) -> Cage | None:
    """Read topology and points.

    Args:
        prim: A ``UsdGeomMesh``.
        time: When.
        to_world: Local to world [m], column vectors, shape [4, 4].
        notes: Dropped faces are noted.
        posed: Local points that take the place of the authored ones, shape [n, 3].

    Returns:
        The control mesh, or None when it has no faces.

    Raises:
        MeshError: Counts, indices, points, a token or the transform cannot be used.
    """
    mesh = UsdGeom.Mesh(prim)
    where = describe(prim)
    mirrored = check_transform(to_world, where)
    local = read_points(mesh.GetPointsAttr(), time) if posed is None else posed
    counts, vertices = _read_faces(mesh, time, len(local), where)
    scheme = read_token(mesh.GetSubdivisionSchemeAttr(), time)
    left_handed = read_token(mesh.GetOrientationAttr(), time) == "leftHanded"
    hole = np.zeros(len(counts), dtype=np.bool_)
    hole[read_indices(mesh.GetHoleIndicesAttr(), time, len(counts), "face")] = True
    source = np.arange(len(vertices), dtype=np.intp)
    if left_handed != mirrored:
        source = reversed_corners(counts)
    face_counts, source, faces = _drop_degenerate(counts, vertices, source)
    path = str(prim.GetPath())
    if len(faces) < len(counts):
        lost = int(np.setdiff1d(np.arange(len(counts)), faces)[0])
        notes.append(
            Note(
                "degenerate-faces",
                path,
                f"{len(counts) - len(faces)} faces of fewer than 3 different vertices are left "
                f"out, the first of them face {lost}",
            )
        )
    if not len(faces):
        notes.append(Note("mesh-empty", path, "the mesh has no faces and is not shown"))
        return None
    return Cage(
        where=where,
        scheme=scheme,
        points=to_meters(local, to_world, where),
        face_counts=face_counts,
        corner_vertex=vertices[source],
        source_corner=source,
        source_face=faces,
        authored_faces=len(counts),
        authored_corners=len(vertices),
        is_hole=hole[faces],
    )


def check_transform(to_world: FloatArray, where: str) -> bool:
    """Return whether a transform mirrors.

    Raises:
        MeshError: The transform is not finite or flattens what it is applied to.
    """
    linear = to_world[:3, :3]
    if not np.isfinite(to_world).all():
        raise MeshError(f"{where}: its transform is not finite; check its xformOps")
    stretch = np.linalg.svd(linear, compute_uv=False)
    if not stretch[-1] > _SINGULAR * stretch[0]:
        raise MeshError(
            f"{where}: its transform is singular (it scales by {stretch[-1]:.3g} along one axis "
            f"and by {stretch[0]:.3g} along another); give it a scale that is not 0"
        )
    return bool(np.linalg.det(linear / stretch[0]) < 0.0)


def to_meters(local: FloatArray, to_world: FloatArray, where: str) -> FloatArray:
    """Return points in world space [m], shape [n, 3].

    Raises:
        MeshError: A point is too far away for single precision.
    """
    points: FloatArray = local @ to_world[:3, :3].T + to_world[:3, 3]
    limit = float(np.finfo(np.float32).max) / 1e6
    if len(points) and not np.abs(points).max() < limit:
        far = int(np.argmax(np.abs(points).max(axis=1)))
        raise MeshError(
            f"{where}: point {far} lies at {vector_text(points[far])} m, too far for single "
            "precision; check its transform and metersPerUnit"
        )
    return points


def build_net(mesh: UsdGeom.Mesh, cage: Cage, time: Usd.TimeCode, notes: list[Note]) -> Net:
    """Return the net of a subdivision mesh, with its creases and corners.

    Raises:
        MeshError: A subdivision tag cannot be used.
    """
    if cage.scheme == "loop" and (cage.face_counts != 3).any():
        face = int(np.argmax(cage.face_counts != 3))
        raise MeshError(
            f"{cage.where}: subdivisionScheme loop needs triangles, but face "
            f"{cage.source_face[face]} has {cage.face_counts[face]} corners; use catmullClark or "
            "triangulate the mesh"
        )
    net = control_net(
        cage.face_counts,
        cage.corner_vertex,
        len(cage.points),
        cage.scheme,  # type: ignore[arg-type]
        read_token(mesh.GetInterpolateBoundaryAttr(), time),  # type: ignore[arg-type]
        read_token(mesh.GetTriangleSubdivisionRuleAttr(), time) == "smooth",
    )
    count = len(cage.points)
    corners = read_indices(mesh.GetCornerIndicesAttr(), time, count, "point")
    corner_sharpness = _read_sharpness(mesh.GetCornerSharpnessesAttr(), time, (len(corners),))
    first, second, edge_sharpness = _read_creases(mesh, time, count)
    edges = find_edges(net.topology, first, second)
    missing = edges < 0
    if missing.any():
        at = int(np.argmax(missing))
        notes.append(
            Note(
                "crease-edge-missing",
                str(mesh.GetPath()),
                f"{int(missing.sum())} crease edges are not edges of the mesh and are ignored, the "
                f"first of them between points {first[at]} and {second[at]}",
            )
        )
    found = ~missing
    return sharpen(net, edges[found], edge_sharpness[found], corners, corner_sharpness)


def _read_faces(
    mesh: UsdGeom.Mesh, time: Usd.TimeCode, point_count: int, where: str
) -> tuple[IndexArray, IndexArray]:
    """Return the corners per face and the vertex of each corner, in agreement."""
    counts = read_whole_numbers(mesh.GetFaceVertexCountsAttr(), time)
    vertices = read_indices(mesh.GetFaceVertexIndicesAttr(), time, point_count, "point")
    if (counts < 0).any():
        face = int(np.argmax(counts < 0))
        raise MeshError(
            f"{where}: faceVertexCounts[{face}] is {counts[face]}; a face cannot have a negative "
            "number of corners"
        )
    if int(counts.sum()) != len(vertices):
        raise MeshError(
            f"{where}: faceVertexCounts add up to {int(counts.sum())} corners, but "
            f"faceVertexIndices has {len(vertices)}; export the mesh again"
        )
    return counts, vertices


def _drop_degenerate(
    counts: IndexArray, vertices: IndexArray, source: IndexArray
) -> tuple[IndexArray, IndexArray, IndexArray]:
    """Leave out corners that repeat the next one's vertex, and faces of fewer than 3 corners.

    Returns:
        Corners per kept face, authored corner of each kept corner, authored face of each face.
    """
    keep = np.ones(len(source), dtype=np.bool_)
    filled = np.flatnonzero(counts > 0)
    if len(filled):
        keep = unrepeated_corners(counts[filled], vertices[source])
    faces = np.arange(len(counts), dtype=np.intp)
    if keep.all() and (counts >= 3).all():
        return counts, source, faces
    face_of_corner = np.repeat(faces, counts)
    left = np.bincount(face_of_corner[keep], minlength=len(counts))
    solid = left >= 3
    keep &= solid[face_of_corner]
    return left[solid], source[keep], faces[solid]


def _read_creases(
    mesh: UsdGeom.Mesh, time: Usd.TimeCode, point_count: int
) -> tuple[IndexArray, IndexArray, FloatArray]:
    """Return both ends and the sharpness of every crease edge."""
    attribute = mesh.GetCreaseLengthsAttr()
    lengths = read_whole_numbers(attribute, time)
    indices = read_indices(mesh.GetCreaseIndicesAttr(), time, point_count, "point")
    if (lengths < 2).any() or int(lengths.sum()) != len(indices):
        raise MeshError(
            f"{describe(attribute)}: creaseLengths must each be at least 2 and add up to the "
            f"{len(indices)} creaseIndices; they add up to {int(lengths.sum())}"
        )
    edge_count = len(indices) - len(lengths)
    sharpness = _read_sharpness(
        mesh.GetCreaseSharpnessesAttr(), time, (len(lengths), edge_count)
    )  # fmt: skip
    if len(sharpness) == len(lengths) != edge_count:
        sharpness = np.repeat(sharpness, lengths - 1)
    is_end = np.zeros(len(indices), dtype=np.bool_)
    is_end[np.cumsum(lengths) - 1] = True
    starts = np.flatnonzero(~is_end)
    return indices[starts], indices[starts + 1], sharpness


def _read_sharpness(
    attribute: Usd.Attribute, time: Usd.TimeCode, counts: Sequence[int]
) -> FloatArray:
    """Return sharpnesses, at least 0, as many as one of the counts."""
    sharpness = read_numbers(attribute, time, 1).reshape(-1)
    if len(sharpness) not in counts:
        wanted = " or ".join(str(count) for count in dict.fromkeys(counts))
        raise MeshError(
            f"{describe(attribute)}: {attribute.GetName()} has {len(sharpness)} values; it needs "
            f"{wanted}"
        )
    if np.isnan(sharpness).any():
        raise MeshError(
            f"{describe(attribute)}: {attribute.GetName()}[{int(np.argmax(np.isnan(sharpness)))}] "
            "is not a number"
        )
    return np.maximum(sharpness, 0.0)
