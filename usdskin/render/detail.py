"""Detail of surfaces below their triangles: which frames a material's maps need on a mesh.

Reads: materials and the triangles of a mesh. Makes: the mesh displaced, with the frames that
``usdskin.warp_kernels.detail`` turns texture axes into directions by.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError, MeshError
from usdskin.images import read_headers
from usdskin.notes import Note
from usdskin.render.displacement import displaced
from usdskin.render.inputs import TextureInput
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.render.mesh_limit import unit
from usdskin.render.mesh_tangents import Corners, gradient_frames, tangent_frames
from usdskin.render.mesh_topology import FloatArray
from usdskin.render.meshes import Frame, MeshArrays

TANGENT_PRIMVARS = ("tangents", "bitangents")
"""Primvars that take the place of computed tangents."""

_IDENTITY = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))


def normal_frame(material: SurfaceMaterial | SkinMaterial) -> Frame | None:
    """Return the frame of a material's normal map, or None where it has none."""
    value = material.normal
    if value is None:
        return None
    if isinstance(value, TextureInput):
        return Frame("tangent", value.primvar, _matrix(value))
    return Frame("tangent", "st", _IDENTITY)


def bump_frame(material: SurfaceMaterial | SkinMaterial) -> Frame | None:
    """Return the frame of a material's height map, or None where it has none."""
    value = material.bump if isinstance(material, SkinMaterial) else None
    return None if value is None else Frame("gradient", value.primvar, _matrix(value))


def frames_of(materials: Iterable[SurfaceMaterial | SkinMaterial]) -> dict[Frame, int]:
    """Return the first row of each frame that materials need; gradients take two rows."""
    rows: dict[Frame, int] = {}
    count = 0
    for material in materials:
        for frame in (normal_frame(material), bump_frame(material)):
            if frame is not None and frame not in rows:
                rows[frame] = count
                count += frame.row_count
    return rows


def detail_primvars(materials: Iterable[SurfaceMaterial | SkinMaterial]) -> frozenset[str]:
    """Return the primvars that frames are made from, beside texture coordinates."""
    mapped = any(material.normal is not None for material in materials)
    return frozenset(TANGENT_PRIMVARS if mapped else ())


def check_normal_map(value: TextureInput) -> None:
    """Refuse a picture of whole numbers that is shown as normals without being unpacked.

    The specification of UsdPreviewSurface asks for scale (2, 2, 2, 1) and bias (-1, -1, -1, 0);
    other values may turn an axis, but without a negative bias no axis can point both ways.

    Raises:
        LayerError: It is one.
    """
    if min(value.bias[:2]) < 0.0:
        return
    kind = read_headers(value.file)[0].channel_types[0]
    if kind.startswith("uint"):
        raise LayerError(
            f"{value.file}: is a normal map of {kind}, whose values run from 0 to 1; author "
            "inputs:scale = (2, 2, 2, 1) and inputs:bias = (-1, -1, -1, 0) on its UsdUVTexture"
        )


def add_detail(
    mesh: MeshArrays,
    materials: Mapping[str | None, SurfaceMaterial | SkinMaterial],
    to_world: FloatArray,
    notes: list[Note],
) -> MeshArrays:
    """Return a mesh with the displacement of its materials, and the frames of their maps.

    Args:
        mesh: The triangles.
        materials: Materials by path.
        to_world: Local to world of authored tangents, shape [4, 4].
        notes: Takes a note where maps have no texture coordinates to lie along.

    Raises:
        ImageError: A displacement map is missing or broken.
        LayerError: A setting of one cannot be used.
    """
    mesh = displaced(mesh, materials)
    used = [materials[path] for path in mesh.material_paths]
    frames: dict[Frame, NDArray[np.float32]] = {}
    for frame in frames_of(used):
        frames[frame] = _corner_frames(mesh, frame, to_world, notes)
    return dataclasses.replace(mesh, frames=frames) if frames else mesh


def _corner_frames(
    mesh: MeshArrays, frame: Frame, to_world: FloatArray, notes: list[Note]
) -> NDArray[np.float32]:
    """Return the rows of a frame, shape [row_count, triangle_count, 3, 4]."""
    st = mesh.primvars.get(frame.primvar)
    if st is not None and st.shape[2] < 2:
        st = None
    corners = None
    if st is not None:
        matrix = np.asarray(frame.matrix)
        corners = Corners(
            mesh.points.astype(np.float64)[mesh.triangles],
            mesh.normals.astype(np.float64),
            st[..., :2].astype(np.float64) @ matrix[:, :2].T + matrix[:, 2],
        )
    if frame.kind == "tangent":
        authored = frame.matrix == _IDENTITY and "tangents" in mesh.primvars
        if authored or corners is not None:
            found = None if corners is None else tangent_frames(corners)
            return (_authored(mesh, found, to_world) if authored else found)[None]  # type: ignore[index]
    elif corners is not None:
        return np.stack(gradient_frames(corners))
    what = f"has no primvars:{frame.primvar}, along which its normal or height map lies; not shown"
    note = Note("detail-without-st", mesh.path, what)
    if note not in notes:
        notes.append(note)
    return np.zeros((frame.row_count, *mesh.triangles.shape, 4), np.float32)


def _authored(
    mesh: MeshArrays, computed: NDArray[np.float32] | None, to_world: FloatArray
) -> NDArray[np.float32]:
    """Return authored tangents with the sign of the bitangent, shape [triangle_count, 3, 4].

    The sign is that of authored bitangents, else the tangents' own fourth value, else that of the
    texture coordinates.

    Raises:
        MeshError: Tangents are not rows of three or four numbers.
    """
    local = mesh.primvars["tangents"].astype(np.float64)
    if local.shape[2] not in (3, 4):
        raise MeshError(
            f"<{mesh.path}>: primvars:tangents has rows of {local.shape[2]} numbers; author "
            "three, or four with the sign of the bitangent"
        )
    linear = to_world[:3, :3]
    frames = np.zeros((*local.shape[:2], 4), np.float32)
    tangent = local[..., :3] @ linear.T
    frames[..., :3] = unit(tangent.reshape(-1, 3)).reshape(tangent.shape)
    bitangents = mesh.primvars.get("bitangents")
    if bitangents is not None and bitangents.shape[2] == 3:
        upward = bitangents.astype(np.float64) @ linear.T
        across = np.cross(mesh.normals.astype(np.float64), tangent)
        frames[..., 3] = np.where(np.einsum("...i,...i->...", across, upward) < 0.0, -1.0, 1.0)
    elif local.shape[2] == 4:
        mirrored = np.linalg.det(linear) < 0.0
        frames[..., 3] = np.where((local[..., 3] < 0.0) != mirrored, -1.0, 1.0)
    else:
        frames[..., 3] = 1.0 if computed is None else computed[..., 3]
    return frames


def _matrix(value: TextureInput) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(float(item) for item in row) for row in value.st_matrix)
