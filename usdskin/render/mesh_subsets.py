"""Which material each face of a mesh has.

Reads: ``UsdGeomSubset`` of the ``materialBind`` family, and material bindings.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from usdskin.errors import MeshError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.mesh_topology import IndexArray
from usdskin.render.mesh_values import read_indices

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdShade

BoundMaterial = Callable[[Usd.Prim], str | None]
"""Returns the path of the material that a mesh or a subset is bound to."""


def read_material_slots(
    prim: Usd.Prim,
    time: Usd.TimeCode,
    face_count: int,
    materials: BoundMaterial,
    notes: list[Note],
) -> tuple[IndexArray, list[str | None]]:
    """Return the material slot of every authored face, and the material of each slot.

    Faces in no subset have the mesh's own material, slot 0. Where subsets overlap, the first one
    counts, unless their family's type promises that none do.

    Args:
        prim: A ``UsdGeomMesh``.
        time: When.
        face_count: Faces as authored.
        materials: Gives the material path bound to a prim.
        notes: Overlaps and subsets that are not used are noted.

    Raises:
        MeshError: A subset names a face that does not exist, or overlaps another one of a family
            of type ``nonOverlapping`` or ``partition``.
    """
    paths: list[str | None] = [materials(prim)]
    slot = np.zeros(face_count, dtype=np.intp)
    owner = np.full(face_count, -1, dtype=np.intp)
    imageable = UsdGeom.Imageable(prim)
    subsets = UsdGeom.Subset.GetAllGeomSubsets(imageable)
    kind = UsdGeom.Subset.GetFamilyType(imageable, UsdShade.Tokens.materialBind)
    for number, subset in enumerate(subsets):
        if not _binds_faces(subset, notes):
            continue
        faces = read_indices(subset.GetIndicesAttr(), time, face_count, "face")
        taken = faces[owner[faces] >= 0]
        if len(taken):
            first = subsets[owner[taken[0]]].GetPrim().GetName()
            if kind in (UsdGeom.Tokens.nonOverlapping, UsdGeom.Tokens.partition):
                raise MeshError(
                    f"{describe(subset.GetPrim())}: face {taken[0]} is in {first} too, but their "
                    f"family materialBind is of type {kind}; remove it from one of them"
                )
            notes.append(
                Note(
                    "subset-overlap",
                    str(subset.GetPath()),
                    f"{len(taken)} of its faces are in another subset too, such as face "
                    f"{taken[0]} in {first}; the first subset counts",
                )
            )
        free = faces[owner[faces] < 0]
        owner[free] = number
        path = materials(subset.GetPrim())
        if path not in paths:
            paths.append(path)
        slot[free] = paths.index(path)
    left = int((owner < 0).sum())
    if left and kind == UsdGeom.Tokens.partition:
        what = f"{left} faces are in no subset of a family of type partition; they show the mesh's"
        notes.append(Note("subset-partition", str(prim.GetPath()), f"{what} own material"))
    return slot, paths


def _binds_faces(subset: UsdGeom.Subset, notes: list[Note]) -> bool:
    """Return whether a subset gives faces a material; note one that seems meant to and does not."""
    path = str(subset.GetPath())
    family = subset.GetFamilyNameAttr().Get()
    element = subset.GetElementTypeAttr().Get()
    if family != UsdShade.Tokens.materialBind:
        if UsdShade.MaterialBindingAPI(subset.GetPrim()).GetDirectBindingRel().HasAuthoredTargets():
            notes.append(
                Note(
                    "subset-family",
                    path,
                    f"it binds a material but is of the family '{family or ''}', so the binding "
                    "is ignored; author familyName materialBind",
                )
            )
        return False
    if element != UsdGeom.Tokens.face:
        notes.append(
            Note(
                "subset-element-type",
                path,
                f"its elementType is {element}; only faces have materials, so it is ignored",
            )
        )
        return False
    return True
