"""Read authored normals of polygon meshes.

Reads: ``normals`` and ``primvars:normals`` of a ``UsdGeomMesh``.
"""

from __future__ import annotations

import numpy as np

from usdskin.notes import Note
from usdskin.render.mesh_primvars import ElementCounts, PrimvarValues, checked
from usdskin.render.mesh_topology import BoolArray, CornerRows, FloatArray
from usdskin.render.mesh_values import read_numbers
from usdskin.render.skinning import Pose

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom


def read_normals(
    mesh: UsdGeom.Mesh,
    time: Usd.TimeCode,
    counts: ElementCounts,
    pose: Pose,
    notes: list[Note],
) -> PrimvarValues | None:
    """Return the authored normals in local space; ``primvars:normals`` counts before ``normals``.

    Those of a posed mesh are turned with it; where they cannot be, the faces' own stand in.

    Raises:
        MeshError: Their count, an index or a value cannot be used.
    """
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        attribute, interpolation = primvar.GetAttr(), primvar.GetInterpolation()
        indices = np.array(primvar.GetIndices(time), dtype=np.intp) if primvar.IsIndexed() else None
    else:
        attribute, interpolation = mesh.GetNormalsAttr(), mesh.GetNormalsInterpolation()
        indices = None
    if not attribute.HasValue() or attribute.Get(time) is None:
        return None
    if pose.drops_normals:
        what = f"normals of {interpolation} interpolation cannot be posed; the faces' own stand in"
        notes.append(Note("normals-ignored", str(mesh.GetPath()), what))
        return None
    values = read_numbers(attribute, time, 3)
    authored = checked(attribute, interpolation, values, indices, counts)
    if pose.normals is None:
        return authored
    return PrimvarValues(authored.interpolation, pose.normals, None)


def replace_normals(
    own: CornerRows,
    corner: FloatArray,
    wanted: BoolArray,
    mesh: UsdGeom.Mesh,
    notes: list[Note],
) -> CornerRows:
    """Return authored normals, the faces' own where an authored one has no length.

    Args:
        own: Normals of the faces.
        corner: Authored normals of the corners, of length 1 or 0, shape [corner_count, 3].
        wanted: Corners that are shown, shape [corner_count].
        mesh: Where they come from.
        notes: Normals without length are noted.
    """
    missing = ~np.any(corner, axis=1)
    if (missing & wanted).any():
        notes.append(
            Note(
                "normals-zero",
                str(mesh.GetPath()),
                f"{int((missing & wanted).sum())} authored normals have no length; the normal of "
                "the face stands in",
            )
        )
    corner = np.where(missing[:, None], own.rows[own.index], corner)
    return CornerRows(corner, np.arange(len(corner)))


def note_unused_normals(mesh: UsdGeom.Mesh, notes: list[Note]) -> None:
    """Note normals that are authored on a subdivision mesh."""
    primvar = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("normals")
    if (primvar and primvar.HasValue()) or mesh.GetNormalsAttr().HasAuthoredValue():
        notes.append(
            Note(
                "normals-ignored",
                str(mesh.GetPath()),
                "normals are authored on a subdivision mesh, whose surface has its own; author "
                "subdivisionScheme none to show a polygon mesh with these",
            )
        )
