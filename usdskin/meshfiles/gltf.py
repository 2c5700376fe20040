"""glTF and GLB through open3d: all meshes of a scene in one, with their materials."""

from __future__ import annotations

import dataclasses
import json
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.meshfiles.meshfile import FileMaterial, MeshFile
from usdskin.meshfiles.through_open3d import damaged, from_open3d


def read_gltf(open3d: Any, path: Path) -> MeshFile:
    """Read a glTF or GLB file: the scene's meshes in place, in metres, Y up.

    Raises:
        MeshError: The file is damaged or holds no triangles.
    """
    document = _gltf_document(path)
    try:
        model = open3d.io.read_triangle_model(str(path))
    except (MemoryError, RuntimeError) as error:
        raise damaged(path, str(error)) from None
    if not model.meshes:
        raise damaged(path, "it holds no meshes that open3d can read")
    parts = [from_open3d(path, part.mesh, with_normals=True, linear=True) for part in model.meshes]
    names = [str(part.mesh_name) or f"mesh_{i}" for i, part in enumerate(model.meshes)]
    described = document.get("materials", [])
    materials = []
    definitions = {}
    for part in model.meshes:
        index = int(part.material_idx)
        entry = described[index] if index < len(described) else {}
        name = str(entry.get("name") or f"material_{index}")
        materials.append(name)
        definitions[name] = _gltf_material(path, document, entry, model.materials[index])
    mesh = _joined(path, parts, names, materials)
    pictures = {item.diffuse_texture for item in definitions.values()} - {None}
    return dataclasses.replace(
        mesh,
        definitions=definitions,
        companions=tuple(sorted(picture for picture in pictures if picture is not None)),
        meters_per_unit=1.0,
        up_axis="Y",
    )


def _gltf_document(path: Path) -> dict[str, Any]:
    """Return the JSON of a glTF file; a .glb holds it in its first chunk (glTF 2.0, 4.4)."""
    raw = path.read_bytes()
    if raw[:4] == b"glTF" and len(raw) >= 20:
        (length,) = struct.unpack("<I", raw[12:16])
        raw = raw[20 : 20 + length]
    try:
        document = json.loads(raw)
    except ValueError:
        raise damaged(path, "its JSON is broken or cut short") from None
    if not isinstance(document, dict):
        raise damaged(path, "its JSON is no glTF")
    return document


def _gltf_material(
    path: Path, document: dict[str, Any], entry: dict[str, Any], record: Any
) -> FileMaterial:
    color = [float(value) for value in record.base_color]
    tint = (color[0], color[1], color[2])
    file = None
    pixels = None
    if record.albedo_img is not None:
        file = _gltf_texture(path, document, entry)
        if file is None:
            pixels = np.ascontiguousarray(np.asarray(record.albedo_img), dtype=np.uint8)
            pixels = np.atleast_3d(pixels)
            pixels = np.repeat(pixels, 3, axis=2) if pixels.shape[2] == 1 else pixels
    textured = file is not None or pixels is not None
    return FileMaterial(
        diffuse_color=None if textured else tint,
        diffuse_texture=file,
        diffuse_pixels=pixels,
        diffuse_scale=tint if textured else (1.0, 1.0, 1.0),
        opacity=min(max(color[3], 0.0), 1.0) if entry.get("alphaMode") == "BLEND" else 1.0,
        roughness=min(max(float(record.base_roughness), 0.0), 1.0),
        metallic=min(max(float(record.base_metallic), 0.0), 1.0),
    )


def _gltf_texture(path: Path, document: dict[str, Any], entry: dict[str, Any]) -> Path | None:
    """Return the file of a base color texture, or None where it is inside the glTF file."""
    try:
        texture = entry["pbrMetallicRoughness"]["baseColorTexture"]["index"]
        uri = document["images"][document["textures"][texture]["source"]]["uri"]
    except (KeyError, IndexError, TypeError):
        return None
    if not isinstance(uri, str) or uri.startswith("data:"):
        return None
    file = path.parent / uri
    return file if file.is_file() else None


def _joined(path: Path, parts: list[MeshFile], names: list[str], materials: list[str]) -> MeshFile:
    objects: dict[str, list[NDArray[np.int32]]] = {}
    by_material: dict[str, list[NDArray[np.int32]]] = {}
    face = 0
    for part, name, material in zip(parts, names, materials, strict=True):
        faces = np.arange(face, face + part.face_count, dtype=np.int32)
        objects.setdefault(name, []).append(faces)
        by_material.setdefault(material, []).append(faces)
        face += part.face_count
    arrays: dict[str, Any] = {
        **_stacked(parts, "points", "face_indices"),
        **_stacked(parts, "st", "st_indices"),
        **_stacked(parts, "normals", "normal_indices"),
    }
    if all(part.colors is not None for part in parts):
        arrays["colors"] = np.concatenate(
            [part.colors for part in parts if part.colors is not None]
        )
    return MeshFile(
        source=path,
        face_counts=np.concatenate([part.face_counts for part in parts]),
        objects={name: np.concatenate(faces) for name, faces in objects.items()},
        materials={name: np.concatenate(faces) for name, faces in by_material.items()},
        **arrays,
    )


def _stacked(parts: list[MeshFile], values: str, indices: str) -> dict[str, Any]:
    """Return values and indices of all parts in a row; parts without any get one value of zeros."""
    if all(getattr(part, values) is None for part in parts) or (
        values == "normals" and any(part.normals is None for part in parts)
    ):
        return {}
    width = 2 if values == "st" else 3
    stacked, numbered, offset = [], [], 0
    for part in parts:
        own = getattr(part, values)
        own_indices = getattr(part, indices)
        if own is None:
            own = np.zeros((1, width))
            own_indices = np.zeros(len(part.face_indices), dtype=np.int32)
        stacked.append(own)
        numbered.append(own_indices + offset)
        offset += len(own)
    return {values: np.concatenate(stacked), indices: np.concatenate(numbered)}
