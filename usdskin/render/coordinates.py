"""Whether meshes have the coordinates that their textures are read by."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np

from usdskin.notes import Note
from usdskin.render.inputs import TextureInput
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.render.meshes import MeshArrays


def missing_coordinates_notes(
    meshes: Iterable[MeshArrays],
    materials: Sequence[SkinMaterial | SurfaceMaterial],
    index: Mapping[str | None, int],
) -> list[Note]:
    """Return a note for every mesh without the coordinates that a texture of its is read by.

    Args:
        meshes: The meshes.
        materials: The materials.
        index: Index into ``materials`` by path.
    """
    notes = []
    for mesh in meshes:
        for slot in np.unique(mesh.material_slot):
            material = materials[index[mesh.material_paths[slot]]]
            for value in material.inputs():
                if isinstance(value, TextureInput) and value.primvar not in mesh.primvars:
                    what = (
                        f"has no primvars:{value.primvar}, by which <{material.path}> reads "
                        f"{Path(value.file).name}, so one texel is shown all over; rename the "
                        "coordinates of the mesh, or the reader's varname"
                    )
                    prim = mesh.path.partition("[")[0]  # instances are many
                    notes.append(Note("texture-coordinates-missing", prim, what))
    return list(dict.fromkeys(notes))
