"""What a measurement of shadows belongs to: it holds for this geometry and skin, and no other."""

from __future__ import annotations

import hashlib

import numpy as np
from numpy.typing import NDArray

from usdskin.render.inputs import PrimvarInput, TextureInput
from usdskin.render.job import RenderSettings
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.render.meshes import MeshArrays
from usdskin.render.passage import body_reach
from usdskin.render.scene import Scene


def geometry_hashes(scene: Scene) -> dict[str, str]:
    """Return a hash of what every mesh of a scene keeps light from, by prim path.

    Points, triangles, and what its materials let pass; where several meshes share a path, all.
    """
    found: dict[str, str] = {}
    for mesh in scene.meshes:
        seen = hashlib.blake2b(digest_size=12)
        for array in (mesh.points, mesh.triangles, mesh.material_slot):
            seen.update(repr(array.shape).encode())
            seen.update(np.ascontiguousarray(array).data)
        for path in mesh.material_paths:
            _add_opacity(seen, scene.materials[scene.material_index[path]], mesh)
        digest = seen.hexdigest()
        found[mesh.path] = f"{found[mesh.path]} {digest}" if mesh.path in found else digest
    return found


def scene_hash(hashes: dict[str, str]) -> str:
    """Return one hash of all geometry, whatever the prims are called."""
    text = "\n".join(sorted(hashes.values()))
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def reaches(mesh: MeshArrays, scene: Scene, settings: RenderSettings) -> NDArray[np.float64]:
    """Return how far light is followed through each material of a mesh [m]."""
    found = (scene.materials[scene.material_index[path]] for path in mesh.material_paths)
    return np.array([body_reach(material, settings.wavelength_nm) for material in found])


def _add_opacity(
    seen: hashlib.blake2b, material: SkinMaterial | SurfaceMaterial, mesh: MeshArrays
) -> None:
    if isinstance(material, SkinMaterial):
        seen.update(b"skin")
        return
    opacity, primvar = material.opacity, None
    text = f"surface {material.opacity_threshold!r} "
    if isinstance(opacity, TextureInput):
        text += f"{opacity.file} {opacity.channel} {opacity.scale} {opacity.bias} "
        text += f"{opacity.fallback} {opacity.st_matrix.tolist()}"
        primvar = opacity.primvar
    elif isinstance(opacity, PrimvarInput):
        text += f"{opacity.name} {opacity.fallback}"
        primvar = opacity.name
    else:
        text += repr(opacity)
    seen.update(text.encode())
    if primvar is not None and primvar in mesh.primvars:
        seen.update(np.ascontiguousarray(mesh.primvars[primvar]).data)
