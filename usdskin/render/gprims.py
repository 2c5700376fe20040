"""Read the implicit shapes of UsdGeom as triangles with the shapes' own normals.

Reads: ``Sphere``, ``Cube``, ``Cylinder``, ``Cylinder_1``, ``Cone``, ``Capsule``, ``Capsule_1`` and
``Plane``. Says which other geometry is not shown.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.mesh_cage import check_transform, to_meters
from usdskin.render.mesh_limit import unit
from usdskin.render.mesh_primvars import ElementCounts, read_primvar
from usdskin.render.mesh_subsets import BoundMaterial
from usdskin.render.mesh_topology import FloatArray
from usdskin.render.mesh_values import read_size, read_token
from usdskin.render.meshes import MeshArrays
from usdskin.render.revolve import Shape, revolve
from usdskin.render.skinning import Pose

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdVol

ROWS = 96
"""Segments from pole to pole of a sphere."""

_Reader = Callable[[Usd.Prim, Usd.TimeCode, int], Shape | None]
"""Reads a shape of a type at a time, with so many segments from pole to pole."""

_AXES = {"X": (2, 0, 1), "Y": (1, 2, 0), "Z": (0, 1, 2)}
"""Which coordinate of a shape about +Z becomes x, y and z, by axis."""

_UNSUPPORTED = {
    UsdGeom.Curves: "curves are not shown",
    UsdGeom.Points: "points are not shown",
    UsdGeom.NurbsPatch: "NURBS patches are not shown; convert them to a mesh",
    UsdGeom.TetMesh: "tetrahedral meshes are not shown; convert their surface to a mesh",
    UsdVol.Volume: "volumes are not shown",
    UsdGeom.Gprim: "geometry of this type is not shown; convert it to a mesh",
}
"""Why geometry is not shown, by schema, the most special first."""


def is_gprim(prim: Usd.Prim) -> bool:
    """Return whether a prim is a mesh or a shape that this package shows."""
    return bool(prim.IsA(UsdGeom.Mesh)) or _reader(prim) is not None


def unsupported_note(prim: Usd.Prim) -> Note | None:
    """Return the note for geometry that is not shown; None for anything else."""
    if is_gprim(prim):
        return None
    for schema, reason in _UNSUPPORTED.items():
        if prim.IsA(schema):
            kind = str(prim.GetTypeName())
            return Note("geometry-not-supported", str(prim.GetPath()), f"{kind}: {reason}")
    return None


def read_gprim(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    to_world: FloatArray,
    level: int,
    primvar_names: Iterable[str],
    materials: BoundMaterial,
    notes: list[Note],
    pose: Pose | None = None,
    rows: int = ROWS,
) -> MeshArrays | None:
    """Read a shape, as :func:`usdskin.render.meshes.read_mesh` reads a mesh.

    Primvars must be constant. ``st``, where none is authored, runs once around the axis and once
    from bottom to top; over each side of a cube; over a disc's or plane's bounding square.

    Args:
        prim: A shape.
        time: When.
        to_world: Local to world [m], column vectors, shape [4, 4].
        level: Not used: shapes are always fine.
        primvar_names: Primvars wanted, without ``primvars:``.
        materials: Gives the material path bound to a prim.
        notes: What is not shown as authored is appended.
        pose: What a skeleton makes of it.
        rows: Segments from pole to pole of a sphere; twice as many go around an axis.

    Returns:
        The triangles, or None when the shape has no size or is of another type.

    Raises:
        MeshError: A size, the axis or the transform cannot be used.
    """
    del level
    reader = _reader(prim)
    if reader is None:
        return None
    where = describe(prim)
    if pose is not None and pose.transform is not None:
        to_world = to_world @ pose.transform
    mirrored = check_transform(to_world, where)
    shape = reader(prim, time, rows)
    if shape is None or not len(shape.triangles):
        notes.append(Note("gprim-empty", str(prim.GetPath()), "the shape has no size"))
        return None
    order = [0, 2, 1] if mirrored else [0, 1, 2]
    count = len(shape.triangles)
    normals = unit(shape.normals.reshape(-1, 3) @ np.linalg.inv(to_world[:3, :3]))
    primvars = {}
    for name in sorted(set(primvar_names)):
        value = _constant(prim, name, time, notes)
        if value is not None:
            primvars[name] = np.tile(value.astype(np.float32), (count, 3, 1))
        elif name == "st":
            primvars[name] = shape.st[:, order].astype(np.float32)
    return MeshArrays(
        path=str(prim.GetPath()),
        points=to_meters(shape.points, to_world, where).astype(np.float32),
        triangles=shape.triangles[:, order].astype(np.int32),
        normals=normals.reshape(count, 3, 3)[:, order].astype(np.float32),
        material_slot=np.zeros(count, dtype=np.int32),
        material_paths=(materials(prim),),
        primvars=primvars,
        double_sided=bool(UsdGeom.Gprim(prim).GetDoubleSidedAttr().Get()),
        closed=shape.closed,
    )


def _constant(
    prim: Usd.Prim, name: str, time: Usd.TimeCode, notes: list[Note]
) -> FloatArray | None:
    """Return the value of a constant primvar; note one that is not constant."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return None
    if primvar.GetInterpolation() != UsdGeom.Tokens.constant:
        notes.append(
            Note(
                "primvar-not-constant",
                str(prim.GetPath()),
                f"primvars:{name} is {primvar.GetInterpolation()}, but how a {prim.GetTypeName()} "
                "is divided is not defined; it is ignored",
            )
        )
        return None
    values = read_primvar(prim, name, time, ElementCounts(0, 0, 0), notes)
    return None if values is None else values.of_elements()[0]


def _reader(prim: Usd.Prim) -> _Reader | None:
    """Return what reads a shape of the prim's type."""
    readers: dict[str, _Reader] = {
        "Sphere": _read_sphere,
        "Cube": _read_cube,
        "Cylinder": _read_cylinder,
        "Cylinder_1": _read_cylinder,
        "Cone": _read_cone,
        "Capsule": _read_capsule,
        "Capsule_1": _read_capsule,
        "Plane": _read_plane,
    }
    return readers.get(str(prim.GetPrimTypeInfo().GetSchemaTypeName()))


def _size(prim: Usd.Prim, name: str, time: Usd.TimeCode) -> float:
    return read_size(prim.GetAttribute(name), time)


def _radii(prim: Usd.Prim, time: Usd.TimeCode) -> tuple[float, float]:
    """Return the radii at the bottom and at the top."""
    if prim.HasAttribute("radius"):
        radius = _size(prim, "radius", time)
        return radius, radius
    return _size(prim, "radiusBottom", time), _size(prim, "radiusTop", time)


def _turned(prim: Usd.Prim, shape: Shape) -> Shape:
    """Return a shape about +Z turned to the prim's axis.

    Raises:
        MeshError: The axis is not one of X, Y and Z.
    """
    order = list(_AXES[read_token(prim.GetAttribute("axis"), Usd.TimeCode.Default())])
    return Shape(
        shape.points[:, order], shape.triangles, shape.normals[..., order], shape.st, shape.closed
    )


def _read_sphere(prim: Usd.Prim, time: Usd.TimeCode, rows: int) -> Shape:
    radius = _size(prim, "radius", time)
    latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1)
    return revolve(*_arc(latitude, radius, 0.0), 2 * rows)


def _read_cylinder(prim: Usd.Prim, time: Usd.TimeCode, rows: int) -> Shape:
    half = 0.5 * _size(prim, "height", time)
    bottom, top = _radii(prim, time)
    return _turned(prim, revolve(*_capped(bottom, top, half), 2 * rows))


def _read_cone(prim: Usd.Prim, time: Usd.TimeCode, rows: int) -> Shape:
    half = 0.5 * _size(prim, "height", time)
    return _turned(prim, revolve(*_capped(_size(prim, "radius", time), 0.0, half), 2 * rows))


def _read_capsule(prim: Usd.Prim, time: Usd.TimeCode, rows: int) -> Shape:
    """Read the hull of two balls: what lies between them touches both without a kink."""
    half = 0.5 * _size(prim, "height", time)
    bottom, top = _radii(prim, time)
    if abs(bottom - top) >= 2.0 * half:
        radius, middle = (bottom, -half) if bottom >= top else (top, half)
        latitude = np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1)
        return _turned(prim, revolve(*_arc(latitude, radius, middle), 2 * rows))
    tangent = float(np.arcsin((bottom - top) / (2.0 * half)))
    low = np.linspace(-0.5 * np.pi, tangent, rows // 2 + 1)
    high = np.linspace(tangent, 0.5 * np.pi, rows // 2 + 1)
    rings = [_arc(low, bottom, -half), _arc(high, top, half)]
    profile = np.concatenate([rings[0][0], rings[1][0]])
    side = np.array([[[np.cos(tangent), np.sin(tangent)]] * 2])
    normals = np.concatenate([rings[0][1], side, rings[1][1]])
    return _turned(prim, revolve(profile, normals, 2 * rows))


def _arc(latitude: FloatArray, radius: float, middle: float) -> tuple[FloatArray, FloatArray]:
    """Return profile and strip normals of a ball between latitudes [rad]."""
    direction = np.stack([np.cos(latitude), np.sin(latitude)], axis=1)
    direction[np.abs(direction) < 1e-15] = 0.0
    return radius * direction + (0.0, middle), np.stack([direction[:-1], direction[1:]], axis=1)


def _capped(bottom: float, top: float, half: float) -> tuple[FloatArray, FloatArray]:
    """Return profile and strip normals of a frustum with flat ends."""
    profile = np.array([[0.0, -half], [bottom, -half], [top, half], [0.0, half]])
    side = np.array([2.0 * half, bottom - top])
    side = side / max(float(np.linalg.norm(side)), np.finfo(float).tiny)
    directions = np.array([[0.0, -1.0], side, [0.0, 1.0]])
    return profile, np.stack([directions, directions], axis=1)


def _read_cube(prim: Usd.Prim, time: Usd.TimeCode, rows: int) -> Shape | None:
    half = 0.5 * _size(prim, "size", time)
    if half == 0.0:
        return None
    grid = np.array([-1.0, 1.0])
    points = half * np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    triangles, normals, st = [], [], []
    square = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
    for axis in range(3):
        for side in (0, 1):
            # Seen from outside, the two other axes run counter-clockwise on the positive side.
            first, second = (axis + 1) % 3, (axis + 2) % 3
            corner = np.zeros((4, 3), dtype=np.intp)
            corner[:, axis] = side
            corner[:, first if side else second] = square[:, 0]
            corner[:, second if side else first] = square[:, 1]
            names = corner @ (4, 2, 1)
            triangles.append(names[[[0, 1, 2], [0, 2, 3]]])
            direction = np.zeros(3)
            direction[axis] = 2.0 * side - 1.0
            normals.append(np.broadcast_to(direction, (2, 3, 3)))
            st.append(square[[[0, 1, 2], [0, 2, 3]]].astype(np.float64))
    return Shape(
        points, np.concatenate(triangles), np.concatenate(normals), np.concatenate(st), True
    )


def _read_plane(prim: Usd.Prim, time: Usd.TimeCode, rows: int) -> Shape | None:
    """Read a plane that faces its positive axis; s runs along its width, t along its length."""
    width, length = _size(prim, "width", time), _size(prim, "length", time)
    if width == 0.0 or length == 0.0:
        return None
    square = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
    upright = str(prim.GetAttribute("axis").Get()) == "Z"
    # About X and Y the length comes before the width (UsdGeomPlane's table of axes).
    size = (width, length) if upright else (length, width)
    points = np.zeros((4, 3))
    points[:, :2] = (square - 0.5) * size
    triangles = np.array([[0, 1, 2], [0, 2, 3]])
    normals = np.broadcast_to(np.array([0.0, 0.0, 1.0]), (2, 3, 3))
    st = (square if upright else square[:, ::-1])[triangles]
    return _turned(prim, Shape(points, triangles, normals, st, False))
