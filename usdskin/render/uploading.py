"""A scene on the device: its geometry, its materials, and its light baked for them.

Reads: ``Scene``. Makes: ``DeviceScene`` and ``LightField``.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import LayerError
from usdskin.render.detail import frames_of
from usdskin.render.frame_cache import FrameCache
from usdskin.render.gloss import LADDER, add_reflections, show_domes
from usdskin.render.integrate import DeviceScene, Faces
from usdskin.render.light_links import link_lights
from usdskin.render.light_maps import (
    LightField,
    banded,
    build_brute_field,
    build_light_field,
    far_groups,
)
from usdskin.render.local_light_arrays import build_local_field
from usdskin.render.materials import (
    PrimvarInput,
    SkinMaterial,
    required_primvars,
)
from usdskin.render.meshes import MeshArrays
from usdskin.render.passage import dims
from usdskin.render.scene import Scene
from usdskin.render.surface_rows import gloss_alphas, wraps_of
from usdskin.render.surfaces import build_surfaces
from usdskin.warp_kernels import structs


def upload(
    scene: Scene,
    workers: Workers,
    *,
    show_dome: bool,
    brute: bool = False,
    traced: bool = False,
    bounces: int = 0,
    measured: bool = False,
    cache: FrameCache | None = None,
) -> tuple[DeviceScene, LightField]:
    """Bake the lights, build the material tables and copy the geometry to the device.

    Args:
        scene: The scene.
        workers: Where to.
        show_dome: Whether the camera sees the domes.
        brute: Shade every band from every texel, without factorisation and maps, as the oracle.
        bounces: How often reflected light falls on other surfaces, where light is traced.
        traced: Whether rays look for reflections, and measure the way through bodies.
        measured: Whether that way was measured before (``usdskin.render.transfer``).
        cache: What the frame before left, and takes what this one does.
    """
    kept = FrameCache() if cache is None else cache
    device = workers.device
    rows = {name: k for k, name in enumerate(sorted(_primvar_names(scene)))}
    thickness = _thickness_range(scene)
    if traced or measured:
        thickness = {material.path: np.inf for material in scene.materials}
    with ThreadPoolExecutor(1) as pool:  # beside the lights, which take as long
        uploading = pool.submit(
            lambda: kept.geometry(scene) or _upload_geometry(scene, rows, device)
        )
        light = kept.light(scene, device, brute)
        if light is None:
            light = _bake(scene, workers, show_dome, brute, traced, measured)
        link_lights(light.device_lights, scene.lights, scene.links if traced else None, device)
        uploaded = uploading.result()
    geometry, mesh, faces = uploaded
    surfaces = kept.surfaces(scene, light, rows, thickness)
    if surfaces is None:
        surfaces = build_surfaces(
            scene.materials,
            light.basis,
            scene.frame,
            wraps_of(scene.materials),
            rows,
            thickness,
            device,
            bounces if traced else 0,
        )
    kept.keep(scene, uploaded, light, surfaces, rows, thickness)
    st = rows["st"] if any("st" in mesh.primvars for mesh in scene.meshes) else -1
    return (
        DeviceScene(
            geometry,
            light.device_lights,
            surfaces.device_materials,
            surfaces.max_rows,
            len(scene.frame.wavelength_nm),
            st,
            faces,
            surfaces.albedo,
            (mesh,),
        ),
        light,
    )


def upload_bodies(
    scene: Scene, workers: Workers
) -> tuple[structs.Geometry, structs.Materials, wp.Mesh]:
    """Copy what light has to pass to the device; the mesh is to be kept as long as the rest."""
    rows = {name: k for k, name in enumerate(sorted(_primvar_names(scene)))}
    geometry, mesh, _ = _upload_geometry(scene, rows, workers.device)
    surfaces = build_surfaces(
        scene.materials,
        np.zeros((1, 4, len(scene.frame.wavelength_nm))),
        scene.frame,
        wraps_of(scene.materials),
        rows,
        {material.path: np.inf for material in scene.materials},
        workers.device,
    )
    return geometry, surfaces.device_materials, mesh


def is_solid(geometry: structs.Geometry, materials: structs.Materials) -> bool:
    """Return whether no surface lets light pass."""
    used = np.unique(geometry.material.numpy())
    mapped = materials.slot.numpy()[used, structs.INPUT_OPACITY] >= 0
    opacity = materials.constant.numpy()[used, structs.INPUT_OPACITY][:, 0]
    return bool(not mapped.any() and (opacity >= 1.0).all())


def _bake(
    scene: Scene, workers: Workers, show_dome: bool, brute: bool, traced: bool, measured: bool
) -> LightField:
    """Return the light at every normal, its reflections, and the domes the camera sees."""
    wraps, bands = wraps_of(scene.materials), len(scene.frame.wavelength_nm)
    lights = scene.lights
    if brute:
        light = build_brute_field(lights, wraps, workers, bands)
        lights = banded(lights)
    else:
        skins = [m for m in scene.materials if isinstance(m, SkinMaterial)]
        split = any(
            m.thickness_primvar or ((traced or measured) and dims(m.parameters)) for m in skins
        )
        local = None
        if traced:
            local = build_local_field(lights.locals, bands, workers.device, far_groups(lights))
        light = build_light_field(lights, wraps, workers, bands, split, local)
    alphas = () if traced else gloss_alphas(scene.materials, LADDER)
    add_reflections(light.device_lights, lights, light.reflected_blocks, alphas, workers)
    show_domes(light.device_lights, lights, show_dome, workers.device)
    return light


def _primvar_names(scene: Scene) -> frozenset[str]:
    return required_primvars(scene.materials) | {"st"}


def _thickness_range(scene: Scene) -> dict[str, float]:
    """Return the largest thickness [m] that meshes give each material."""
    largest: dict[str, float] = {}
    for material in scene.materials:
        if not isinstance(material, SkinMaterial) or material.thickness_primvar is None:
            continue
        for mesh in scene.meshes:
            values = mesh.primvars.get(material.thickness_primvar)
            if values is not None and material.path in mesh.material_paths:
                usable = np.isfinite(values) & (values >= 0.0)
                if not usable.all():
                    raise LayerError(
                        f"<{mesh.path}>: primvars:{material.thickness_primvar} holds "
                        f"{values[~usable][0]:g}; a thickness is 0 or more metres, so correct it."
                    )
                found = max(float(values.max()), largest.get(material.path, 0.0))
                largest[material.path] = max(found, material.parameters.thickness)
    return largest


def _upload_geometry(
    scene: Scene, rows: dict[str, int], device: str
) -> tuple[structs.Geometry, wp.Mesh, Faces]:
    count = scene.triangle_count
    points, triangles, normals = [], [], []
    material = np.zeros(max(count, 1), np.int32)
    prim = np.zeros(max(count, 1), np.int32)
    values = np.zeros((len(rows), max(3 * count, 3), 4), np.float32)
    frames = frames_of(scene.materials)
    frame_count = sum(frame.row_count for frame in frames)
    frame_value = np.zeros((frame_count, max(3 * count, 3) if frames else 0, 4), np.float32)
    first_point = begin = 0
    for k, mesh in enumerate(scene.meshes):
        end = begin + len(mesh.triangles)
        points.append(mesh.points)
        triangles.append(mesh.triangles + first_point)
        normals.append(mesh.normals.reshape(-1, 3))
        slots = np.array([scene.material_index[path] for path in mesh.material_paths], np.int32)
        material[begin:end] = slots[mesh.material_slot]
        prim[begin:end] = k
        for name, row in rows.items():
            values[row, 3 * begin : 3 * end] = _corner_values(
                scene, mesh, name, material[begin:end]
            )
        for frame, frame_rows in mesh.frames.items():
            for k_row, frame_row in enumerate(frame_rows, frames[frame]):
                frame_value[k_row, 3 * begin : 3 * end] = frame_row.reshape(-1, 4)
        first_point += len(mesh.points)
        begin = end
    if not count:  # nothing to hit, but the kernels need a mesh
        points, triangles = [np.zeros((3, 3), np.float32)], [np.array([[0, 1, 2]], np.int32)]
        normals = [np.tile(np.array([0, 1, 0], np.float32), (3, 1))]
    joined_points = np.concatenate(points)
    joined_triangles = np.concatenate(triangles).astype(np.int32)
    mesh = wp.Mesh(
        points=wp.array(joined_points, dtype=wp.vec3f, device=device),
        indices=wp.array(joined_triangles.ravel(), dtype=wp.int32, device=device),
    )
    geometry = structs.Geometry()
    geometry.mesh = mesh.id
    geometry.corner_normal = wp.array(np.concatenate(normals), dtype=wp.vec3f, device=device)
    geometry.corner_value = wp.array(values, dtype=wp.vec4f, device=device)
    geometry.corner_frame = wp.array(frame_value, dtype=wp.vec4f, device=device)
    geometry.material = wp.array(material, dtype=wp.int32, device=device)
    geometry.prim = wp.array(prim, dtype=wp.int32, device=device)
    sheets = [_is_sheet(mesh, scene) for mesh in scene.meshes] or [False]
    geometry.sheet = wp.array(np.array(sheets, np.int32), dtype=wp.int32, device=device)
    return geometry, mesh, Faces(joined_points, joined_triangles, prim, material)


def _is_sheet(mesh: MeshArrays, scene: Scene) -> bool:
    """Return whether a mesh encloses nothing and all its skins say how thick they are."""
    if mesh.closed:
        return False
    bound = (scene.materials[scene.material_index[path]] for path in mesh.material_paths)
    skins = [material for material in bound if isinstance(material, SkinMaterial)]
    return all(
        skin.thickness_primvar in mesh.primvars or skin.parameters.thickness > 0.0
        for skin in skins
        if skin.thickness_primvar is not None
    )


def _corner_values(
    scene: Scene, mesh: MeshArrays, name: str, material: NDArray[np.int32]
) -> NDArray[np.float32]:
    """Return a primvar per corner, or what each corner's material falls back to."""
    result = np.zeros((len(material), 3, 4), np.float32)
    found = mesh.primvars.get(name)
    if found is not None:
        result[:, :, : found.shape[2]] = found[:, :, :4]
        if found.shape[2] == 1:
            result[:, :, 1:] = found
        return result.reshape(-1, 4)
    for m in np.unique(material):
        for value in scene.materials[m].inputs():
            if isinstance(value, PrimvarInput) and value.name == name:
                fallback = np.atleast_1d(np.asarray(value.fallback, np.float32))
                result[material == m, :, : len(fallback)] = fallback
                if len(fallback) == 1:
                    result[material == m] = fallback[0]
    return result.reshape(-1, 4)
