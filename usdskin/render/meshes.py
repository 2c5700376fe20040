"""Read ``UsdGeomMesh`` prims into triangles in world space, ready for the device.

Reads: topology, points, normals, primvars, subsets and subdivision tags of a mesh. The reading of
each is in the ``mesh_*`` modules beside this one; here they come together.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import DeviceError
from usdskin.notes import Note
from usdskin.render.memory import available_bytes
from usdskin.render.mesh_cage import Cage, build_net, read_cage
from usdskin.render.mesh_channels import face_varying_channel
from usdskin.render.mesh_limit import cage_normals, unit
from usdskin.render.mesh_net import Net, boundary_faces
from usdskin.render.mesh_normals import note_unused_normals, read_normals, replace_normals
from usdskin.render.mesh_primvars import ElementCounts, PrimvarValues, read_primvar
from usdskin.render.mesh_subsets import BoundMaterial, read_material_slots
from usdskin.render.mesh_topology import BoolArray, CornerRows, FloatArray, IndexArray
from usdskin.render.mesh_values import read_token
from usdskin.render.polygons import AREA_TOLERANCE, area_vectors, is_closed, triangulate
from usdskin.render.skinning import Pose
from usdskin.render.subdivide import subdivide

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom

_BYTES_PER_TRIANGLE = 450
"""Memory that reading a subdivided mesh takes at its peak, per triangle [B]: 418 measured, with one
face-varying primvar."""


@dataclass(frozen=True, slots=True)
class Frame:
    """What turns a texture's axes into directions on a surface."""

    kind: str
    """``tangent``: one row, tangent and sign; ``gradient``: two, the gradients of s and t [1/m]."""

    primvar: str
    """Primvar with the texture coordinates."""

    matrix: tuple[tuple[float, ...], ...]
    """Map from the primvar to the picture's coordinates [1], shape [2, 3]."""

    @property
    def row_count(self) -> int:
        """Number of rows."""
        return 1 if self.kind == "tangent" else 2


@dataclass(frozen=True, slots=True, eq=False)
class MeshArrays:
    """Triangles of one prim in world space."""

    path: str
    """Prim path."""

    points: NDArray[np.float32]
    """Positions [m], shape [point_count, 3]."""

    triangles: NDArray[np.int32]
    """Points of each triangle, counter-clockwise seen from outside, shape [triangle_count, 3]."""

    normals: NDArray[np.float32]
    """Unit shading normals at the corners, shape [triangle_count, 3, 3]."""

    material_slot: NDArray[np.int32]
    """Index into ``material_paths`` of each triangle, shape [triangle_count]."""

    material_paths: tuple[str | None, ...]
    """Materials bound to the prim and its subsets; None where none is bound."""

    primvars: dict[str, NDArray[np.float32]]
    """Values at the corners by primvar name, shapes [triangle_count, 3, k]."""

    double_sided: bool
    """Whether both sides are shown."""

    closed: bool
    """Whether the surface encloses a volume: every edge joins exactly two faces, wound alike."""

    frames: dict[Frame, NDArray[np.float32]] = field(default_factory=dict)
    """Rows of the frames that the materials' maps lie along, shapes [row_count, triangle_count, 3,
    4]."""


@dataclass(frozen=True, slots=True, eq=False)
class _Surface:
    """Faces to be cut into triangles, with what lives on their corners."""

    points: FloatArray
    """Positions [m], shape [n, 3]."""

    face_counts: IndexArray
    """Corners per face, shape [face_count]."""

    corner_vertex: IndexArray
    """Point of each corner, shape [corner_count]."""

    control_face: IndexArray
    """Face of the cage that each face comes from, shape [face_count]."""

    normals: CornerRows
    """Unit normals of the corners."""

    primvars: dict[str, CornerRows]
    """Values of the corners."""


def read_mesh(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    to_world: FloatArray,
    level: int,
    primvar_names: Iterable[str],
    materials: BoundMaterial,
    notes: list[Note],
    pose: Pose | None = None,
) -> MeshArrays | None:
    """Read a mesh.

    Args:
        prim: A ``UsdGeomMesh``.
        time: When.
        to_world: Local to world [m], column vectors, shape [4, 4].
        level: Times a subdivision surface is subdivided; at 0 its control mesh is shown, with
            smooth normals.
        primvar_names: Primvars wanted, without ``primvars:``.
        materials: Gives the material path bound to a prim.
        notes: What is not shown as authored is appended.
        pose: What a skeleton makes of it.

    Returns:
        The triangles, or None when there are none.

    Raises:
        MeshError: The mesh cannot be used: counts that disagree, indices out of range, numbers
            that are not finite, a singular transform.
        DeviceError: So many triangles do not fit in memory.
    """
    pose = pose or Pose()
    if pose.transform is not None:
        to_world = to_world @ pose.transform
    cage = read_cage(prim, time, to_world, notes, pose.points)
    if cage is None:
        return None
    mesh = UsdGeom.Mesh(prim)
    counts = ElementCounts(len(cage.points), cage.authored_faces, cage.authored_corners)
    primvars = {}
    for name in sorted(set(primvar_names)):
        values = read_primvar(prim, name, time, counts, notes)
        if values is not None:
            primvars[name] = values
    shown = ~cage.is_hole
    if cage.scheme == "none":
        surface, solid = _polygon_surface(mesh, cage, time, to_world, primvars, counts, notes, pose)
        shown &= solid
    else:
        net = build_net(mesh, cage, time, notes)
        if read_token(mesh.GetInterpolateBoundaryAttr(), time) == "none":
            shown &= ~boundary_faces(net)
        note_unused_normals(mesh, notes)
        surface = _subdivided_surface(mesh, cage, net, time, level, primvars)
    slots, paths = read_material_slots(prim, time, cage.authored_faces, materials, notes)
    return _cut(mesh, cage, surface, shown, slots[cage.source_face], paths)


def _polygon_surface(
    mesh: UsdGeom.Mesh,
    cage: Cage,
    time: Usd.TimeCode,
    to_world: FloatArray,
    primvars: dict[str, PrimvarValues],
    counts: ElementCounts,
    notes: list[Note],
    pose: Pose,
) -> tuple[_Surface, BoolArray]:
    """Return a polygon mesh with authored normals, or faceted, and which faces have an area."""
    area, extent = area_vectors(cage.face_counts, cage.points[cage.corner_vertex])
    square = np.einsum("ij,ij->i", area, area)
    solid: BoolArray = square > (AREA_TOLERANCE * extent) ** 2
    flat = int((~solid & ~cage.is_hole).sum())
    if flat:
        first = cage.source_face[int(np.argmax(~solid & ~cage.is_hole))]
        notes.append(
            Note(
                "degenerate-faces",
                str(mesh.GetPath()),
                f"{flat} faces without an area are left out, the first of them face {first}",
            )
        )
    face_of_corner = np.repeat(np.arange(len(cage.face_counts)), cage.face_counts)
    normals = CornerRows(unit(area), face_of_corner)
    authored = read_normals(mesh, time, counts, pose, notes)
    if authored is not None:
        local = _at_corners(authored, cage)
        corner = local.rows[local.index] @ np.linalg.inv(to_world[:3, :3])
        normals = replace_normals(normals, unit(corner), solid[face_of_corner], mesh, notes)
    values = {name: _at_corners(value, cage) for name, value in primvars.items()}
    everything = np.arange(len(cage.face_counts))
    surface = _Surface(
        cage.points, cage.face_counts, cage.corner_vertex, everything, normals, values
    )
    return surface, solid


def _at_corners(values: PrimvarValues, cage: Cage) -> CornerRows:
    """Return the values at the corners of the cage."""
    match values.interpolation:
        case "constant":
            element = np.zeros(len(cage.corner_vertex), dtype=np.intp)
        case "uniform":
            element = np.repeat(cage.source_face, cage.face_counts)
        case "faceVarying":
            element = cage.source_corner
        case _:
            element = cage.corner_vertex
    return CornerRows(values.values, element if values.indices is None else values.indices[element])


def _subdivided_surface(
    mesh: UsdGeom.Mesh,
    cage: Cage,
    net: Net,
    time: Usd.TimeCode,
    level: int,
    primvars: dict[str, PrimvarValues],
) -> _Surface:
    """Return a subdivision surface at a level, or its control mesh at level 0."""
    if level < 1:
        normals = cage_normals(net, cage.points)
        values = {name: _at_corners(value, cage) for name, value in primvars.items()}
        everything = np.arange(len(cage.face_counts))
        return _Surface(
            cage.points, cage.face_counts, cage.corner_vertex, everything, normals, values
        )
    _check_memory(cage, level)
    rule = read_token(mesh.GetFaceVaryingLinearInterpolationAttr(), time)
    groups: dict[str, list[str]] = {"vertex": [], "varying": [], "faceVarying": []}
    for name, value in primvars.items():
        groups.setdefault(value.interpolation, []).append(name)
    rows = {name: value.of_elements() for name, value in primvars.items()}
    channels = []
    for name in groups["faceVarying"]:
        corner_rows, index = _distinct(primvars[name])
        channels.append(
            face_varying_channel(net, corner_rows, index[cage.source_corner], rule)  # type: ignore[arg-type]
        )
    refined = subdivide(
        net,
        level,
        np.concatenate([cage.points, *(rows[name] for name in groups["vertex"])], axis=1),
        np.concatenate(
            [np.empty((len(cage.points), 0)), *(rows[name] for name in groups["varying"])], axis=1
        ),
        channels,
    )
    corner_vertex = refined.topology.corner_vertex
    values = dict(zip(groups["faceVarying"], refined.face_varying, strict=True))
    for name, part in _columns(groups["vertex"], rows, refined.vertex[:, 3:]):
        values[name] = CornerRows(part, corner_vertex)
    for name, part in _columns(groups["varying"], rows, refined.varying):
        values[name] = CornerRows(part, corner_vertex)
    for name in groups.get("uniform", []):
        face = cage.source_face[refined.control_face]
        values[name] = CornerRows(rows[name], face[refined.topology.corner_face])
    for name in groups.get("constant", []):
        values[name] = CornerRows(rows[name], np.zeros(len(corner_vertex), dtype=np.intp))
    return _Surface(
        refined.vertex[:, :3],
        refined.topology.face_sizes,
        corner_vertex,
        refined.control_face,
        refined.normals,
        values,
    )


def _distinct(primvar: PrimvarValues) -> tuple[FloatArray, IndexArray]:
    """Return distinct values and the value of each corner; equal values without indices weld."""
    if primvar.indices is not None:
        return primvar.values, primvar.indices
    order = np.lexsort(primvar.values.T)
    rows = primvar.values[order]
    is_new = np.ones(len(rows), dtype=np.bool_)
    is_new[1:] = np.any(rows[1:] != rows[:-1], axis=1)
    index = np.empty(len(rows), dtype=np.intp)
    index[order] = np.cumsum(is_new) - 1
    return rows[is_new], index


def _columns(
    names: list[str], rows: dict[str, FloatArray], data: FloatArray
) -> Iterable[tuple[str, FloatArray]]:
    """Yield the columns of each primvar in data that were put side by side."""
    start = 0
    for name in names:
        end = start + rows[name].shape[1]
        yield name, data[:, start:end]
        start = end


def _check_memory(cage: Cage, level: int) -> None:
    """Refuse a level whose triangles do not fit in memory.

    Raises:
        DeviceError: They do not.
    """
    if cage.scheme == "loop":
        triangles = len(cage.face_counts) * 4**level
    else:
        triangles = 2 * len(cage.corner_vertex) * 4 ** (level - 1)
    needed, there = triangles * _BYTES_PER_TRIANGLE, available_bytes()
    if triangles > np.iinfo(np.int32).max // 3 or (there is not None and needed > there):
        raise DeviceError(
            f"{cage.where}: subdivided {level} times it has {triangles} triangles, which need "
            f"about {needed / 2**30:.0f} GiB; lower the subdivision level"
        )


def _cut(
    mesh: UsdGeom.Mesh,
    cage: Cage,
    surface: _Surface,
    shown: BoolArray,
    slots: IndexArray,
    paths: list[str | None],
) -> MeshArrays | None:
    """Cut the shown faces of a surface into triangles and gather what their corners hold."""
    corner_vertex = surface.corner_vertex
    corner, face = triangulate(
        surface.face_counts, surface.points, corner_vertex, shown[surface.control_face]
    )
    if not len(corner):
        return None
    face = surface.control_face[face]
    used, slot = np.zeros(1, dtype=np.intp), np.zeros(len(face), dtype=np.intp)
    if len(paths) > 1:
        used, slot = np.unique(slots[face], return_inverse=True)
    return MeshArrays(
        path=str(mesh.GetPath()),
        points=surface.points.astype(np.float32),
        triangles=corner_vertex[corner].astype(np.int32),
        normals=surface.normals.at(corner),
        material_slot=slot.reshape(-1).astype(np.int32),
        material_paths=tuple(paths[k] for k in used),
        primvars={name: values.at(corner) for name, values in surface.primvars.items()},
        double_sided=bool(mesh.GetDoubleSidedAttr().Get()),
        closed=not cage.is_hole.any()
        and is_closed(cage.face_counts, cage.corner_vertex, cage.points),
    )
