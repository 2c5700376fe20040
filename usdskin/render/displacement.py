"""Move the vertices of a mesh along its normals, as its materials' displacement says.

Displacement acts on the triangles that are shown, after subdivision. Whatever lies in one place
moves as one: a vertex goes along the mean normal by the mean displacement of its corners, weighted
by their angles, so that no crack opens at seams of the texture, of the normals or of the materials.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from usdskin.errors import MeshError
from usdskin.render.inputs import PrimvarInput, TextureInput
from usdskin.render.materials import Displacement, SkinMaterial, SurfaceMaterial
from usdskin.render.mesh_limit import unit
from usdskin.render.mesh_tangents import corner_angles, names_of, sums_by_name
from usdskin.render.mesh_topology import FloatArray
from usdskin.render.meshes import MeshArrays
from usdskin.render.polygons import cross
from usdskin.render.textures import Texture, read_texture, sample_texture

_CHANNELS = "rgba"


def displaced(
    mesh: MeshArrays, materials: Mapping[str | None, SurfaceMaterial | SkinMaterial]
) -> MeshArrays:
    """Return a mesh with its displacement applied, and the normals of the new surface.

    A normal turns by as much as the mean normal of the triangles around it does; what was a
    crease, or faceted, stays so.

    Args:
        mesh: The triangles [m].
        materials: Materials by path.

    Raises:
        ImageError: A displacement map is missing or broken.
        LayerError: A setting of one cannot be used.
        MeshError: Points would lie beyond what numbers hold.
    """
    wanted = {
        slot: amount
        for slot, path in enumerate(mesh.material_paths)
        if (amount := materials[path].displacement) is not None
    }
    if not wanted:
        return mesh
    height = np.zeros(mesh.triangles.shape)
    for slot, displacement in wanted.items():
        shown = mesh.material_slot == slot
        if shown.any():
            height[shown] = displacement.unit * _amount(mesh, displacement, shown)
    if not height.any():
        return mesh
    points = mesh.points.astype(np.float64)
    corner = points[mesh.triangles]
    normal = mesh.normals.astype(np.float64)
    angle = np.maximum(corner_angles(corner), 1e-9)
    place = names_of(corner)
    way = unit(sums_by_name(place, angle[..., None] * normal))
    share = sums_by_name(place, angle[..., None])
    moved_by = sums_by_name(place, (angle * height)[..., None]) / share
    points[mesh.triangles] += (moved_by * way)[place]
    with np.errstate(over="ignore"):
        moved = points.astype(np.float32)
    if not np.isfinite(moved).all():
        raise MeshError(
            f"<{mesh.path}>: its material's displacement moves points by up to "
            f"{np.abs(height).max():g} m, further than numbers reach; lower it"
        )
    after = moved.astype(np.float64)[mesh.triangles]
    shared = names_of(corner, normal)
    before_normal = unit(sums_by_name(shared, angle[..., None] * _face_normals(corner)))
    angle_after = corner_angles(after)
    after_normal = unit(sums_by_name(shared, angle_after[..., None] * _face_normals(after)))
    turned = normal + (after_normal - before_normal)[shared]
    turned = unit(turned.reshape(-1, 3)).reshape(turned.shape)
    lost = ~turned.any(axis=-1)
    turned[lost] = normal[lost]
    return dataclasses.replace(mesh, points=moved, normals=turned.astype(np.float32))


def _amount(mesh: MeshArrays, displacement: Displacement, shown: FloatArray) -> FloatArray:
    """Return the displacement at the corners of some triangles [its unit], shape [n, 3]."""
    value = displacement.amount
    count = int(shown.sum())
    if isinstance(value, TextureInput):
        st = mesh.primvars.get(value.primvar)
        plain = np.zeros((count, 3, 2))
        if st is not None and st.shape[2] >= 2:
            plain = st[shown][..., :2].astype(np.float64)
        at = plain @ value.st_matrix[:, :2].T + value.st_matrix[:, 2]
        texture = read_texture(
            value.file,
            value.source_color_space,
            value.scale,
            value.bias,
            value.wrap_s,
            value.wrap_t,
        )
        level = _level(texture, at)
        channel = _CHANNELS.index(value.channel)
        texels: FloatArray = sample_texture(texture, at, level)[..., channel]
        return texels
    if isinstance(value, PrimvarInput):
        found = mesh.primvars.get(value.name)
        if found is None:
            return np.full((count, 3), float(value.fallback[0]))
        held: FloatArray = found[shown][..., 0].astype(np.float64)
        return held
    return np.full((count, 3), float(value))  # type: ignore[arg-type]


def _level(texture: Texture, st: FloatArray) -> int:
    """Return the level of a texture whose texels are no finer than the vertices lie apart."""
    height, width = texture.levels[0].shape[:2]
    ab, ac = st[:, 1] - st[:, 0], st[:, 2] - st[:, 0]
    area = np.abs(ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]) * width * height
    spacing = float(np.sqrt(np.median(area))) if len(area) else 0.0
    return int(np.clip(np.floor(np.log2(max(spacing, 1.0))), 0, len(texture.levels) - 1))


def _face_normals(corner: FloatArray) -> FloatArray:
    """Return the unit normals of triangles, once per corner, shape [triangle_count, 3, 3]."""
    face = unit(cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]))
    return np.broadcast_to(face[:, None], corner.shape)
