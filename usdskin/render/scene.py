"""A stage at one moment as arrays: triangles in world space, materials and lights.

Reads: any stage. Makes: ``Scene``, which knows no USD, and from it ``DeviceScene``.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.device import Workers
from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.detail import add_detail, detail_primvars, frames_of
from usdskin.render.frame_cache import FrameCache, Shapes
from usdskin.render.gloss import LADDER, add_reflections, show_domes
from usdskin.render.gprims import ROWS, is_gprim, read_gprim, unsupported_note
from usdskin.render.instance_meshes import instance_meshes
from usdskin.render.instancers import InstancerReader, Placed
from usdskin.render.integrate import DeviceScene, Faces
from usdskin.render.light_links import LinkTables, link_lights, read_links
from usdskin.render.light_maps import (
    LightField,
    banded,
    build_brute_field,
    build_light_field,
    far_groups,
)
from usdskin.render.lights import Lights, check_lit, read_lights
from usdskin.render.local_light_arrays import build_local_field
from usdskin.render.local_lights import facing_irradiance
from usdskin.render.materials import (
    PrimvarInput,
    SkinMaterial,
    SurfaceMaterial,
    binding_notes,
    bound_material,
    display_material,
    read_materials,
    required_primvars,
)
from usdskin.render.meshes import MeshArrays, read_mesh
from usdskin.render.settings import RenderSettings
from usdskin.render.skinning import PoseReader
from usdskin.render.surface_rows import SpectralFrame, dims, gloss_alphas, wraps_of
from usdskin.render.surfaces import build_surfaces
from usdskin.render.udim import missing_tile_notes
from usdskin.warp_kernels import structs

# isort: split
# After ours, which register the schemas.
from pxr import Tf, Usd, UsdGeom

_WITH_OWN_VISIBILITY = ("proxy", "render")
"""Purposes that ``UsdGeomVisibilityAPI`` may hide; guides it hides unless told otherwise, but who
asks for guides wants them."""


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A stage at one moment, in metres, in the stage's own axes."""

    meshes: tuple[MeshArrays, ...]
    materials: tuple[SkinMaterial | SurfaceMaterial, ...]
    """Distinct materials; the last one shows displayColor and is what nothing else is bound to."""

    material_index: dict[str | None, int]
    """Index into ``materials`` by path."""

    lights: Lights
    links: LinkTables
    """Which lights reach which meshes."""

    frame: SpectralFrame

    @property
    def triangle_count(self) -> int:
        """Number of triangles of all meshes."""
        return sum(len(mesh.triangles) for mesh in self.meshes)


def read_scene(
    stage: Usd.Stage,
    time: Usd.TimeCode,
    settings: RenderSettings,
    notes: list[Note],
    cache: FrameCache | None = None,
    *,
    unlit: bool = False,
) -> Scene:
    """Read what a picture shows.

    Args:
        stage: The stage.
        time: When.
        settings: Purposes, mask, subdivision level, wavelengths.
        notes: What cannot be shown is appended.
        cache: What the frame before left; its notes are not repeated.
        unlit: Leave the lights out.

    Raises:
        LayerError: Something cannot be used, or nothing gives light.
    """
    kept = FrameCache() if cache is None else cache
    lights = Lights((), ())
    if not unlit:
        lights = kept.lights(stage, time, notes) or read_lights(
            stage,
            time,
            settings.wavelength_nm,
            settings.observer,
            settings.illuminant,
            settings.bad_pixels,
            notes,
            places=settings.integrator == "traced",
        )
        check_lit(stage, lights, notes)
    shapes = kept.shapes or _read_shapes(stage, time, settings, kept, notes)
    frame = SpectralFrame(
        settings.wavelength_nm, settings.observer, lights.absolute, settings.color_space
    )
    links = kept.links(lights, shapes.meshes)
    if links is None:
        # An instance is linked as its instancer is.
        linked = [mesh.path.partition("[")[0] for mesh in shapes.meshes]
        links = read_links(stage, lights.paths, linked, time)
    return Scene(shapes.meshes, shapes.materials, shapes.material_index, lights, links, frame)


def _read_shapes(
    stage: Usd.Stage,
    time: Usd.TimeCode,
    settings: RenderSettings,
    kept: FrameCache,
    notes: list[Note],
) -> Shapes:
    """Read the meshes and what they are made of."""
    cache = UsdGeom.XformCache(time)
    prims, placed = _visible_shapes(stage, time, settings, cache, notes)
    bindings: dict[str, str | None] = {}

    def material_of(prim: Usd.Prim) -> str | None:
        path = str(prim.GetPath())
        if path not in bindings:
            bindings[path] = bound_material(prim, settings.material_purposes)
            notes.extend(binding_notes(prim))
        return bindings[path]

    paths = _bound_paths([*prims, *(item.prim for item in placed)], material_of)
    materials, index = kept.materials(paths) or _read_materials(stage, paths, time, settings, notes)
    names = required_primvars(materials) | {"st"} | detail_primvars(materials)
    shown = {path: materials[k] for path, k in index.items()}
    scale = UsdGeom.GetStageMetersPerUnit(stage)
    poses = PoseReader(time, cache, notes)

    def read(prim: Usd.Prim, matrix: NDArray[np.float64], rows: int = ROWS) -> MeshArrays | None:
        given = (settings.subdivision_level, names, material_of, notes, poses.of(prim))
        if prim.IsA(UsdGeom.Mesh):
            mesh = read_mesh(prim, time, matrix, *given)
        else:
            mesh = read_gprim(prim, time, matrix, *given, rows)
        if mesh is None or not len(mesh.triangles):
            return None
        return add_detail(mesh, shown, matrix, notes)

    found = (read(prim, _to_world(prim, cache, scale)) for prim in prims)
    meshes = [mesh for mesh in found if mesh is not None]
    meshes += instance_meshes(
        placed,
        lambda item, rows: read(item.prim, _in_meters(item.links[-1].to_root, scale), rows),
        lambda instancer: _to_world(instancer, cache, scale),
        scale,
        names,
        time,
        notes,
    )
    notes.extend(missing_tile_notes(meshes, materials, index))
    return Shapes(tuple(meshes), materials, index)


def _read_materials(
    stage: Usd.Stage,
    paths: list[str],
    time: Usd.TimeCode,
    settings: RenderSettings,
    notes: list[Note],
) -> tuple[tuple[SkinMaterial | SurfaceMaterial, ...], dict[str | None, int]]:
    known = read_materials(stage, paths, time, notes, settings.color_space)
    materials = (*known.values(), display_material())
    index: dict[str | None, int] = {path: k for k, path in enumerate(known)}
    index[None] = len(materials) - 1
    return materials, index


def _visible_shapes(
    stage: Usd.Stage,
    time: Usd.TimeCode,
    settings: RenderSettings,
    cache: UsdGeom.XformCache,
    notes: list[Note],
) -> tuple[list[Usd.Prim], list[Placed]]:
    """Return what to draw: visible, of a wanted purpose, inside the mask.

    Returns:
        The gprims, and what point instancers place.
    """
    purposes = frozenset(settings.purposes) | {"default"}
    instancers = InstancerReader(time, purposes, notes, cache)
    prims: list[Usd.Prim] = []
    placed: list[Placed] = []
    walk = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in walk:
        is_instancer = prim.IsA(UsdGeom.PointInstancer)
        if is_instancer:  # what is below it are its prototypes
            walk.PruneChildren()
        if not prim.IsA(UsdGeom.Imageable) or not _in_mask(str(prim.GetPath()), settings.mask):
            continue
        imageable = UsdGeom.Imageable(prim)
        if imageable.ComputeVisibility(time) == UsdGeom.Tokens.invisible:
            continue
        if is_instancer:
            placed += instancers.read(prim)
            continue
        purpose = imageable.ComputePurpose()
        if purpose not in purposes or (
            purpose in _WITH_OWN_VISIBILITY
            and imageable.ComputeEffectiveVisibility(purpose, time) == UsdGeom.Tokens.invisible
        ):
            continue
        note = unsupported_note(prim)
        if note is not None:
            notes.append(note)
        elif is_gprim(prim):
            prims.append(prim)
    return prims, placed


def _to_world(prim: Usd.Prim, cache: UsdGeom.XformCache, scale: float) -> NDArray[np.float64]:
    """Return a prim's local-to-world matrix in metres, column vectors, shape [4, 4]."""
    try:
        matrix = np.array(cache.GetLocalToWorldTransform(prim)).T
    except Tf.ErrorException as error:
        reason = str(error).rsplit(" : ", 1)[-1].strip().strip("'").rstrip(".")
        raise LayerError(
            f"{describe(prim)}: its transform cannot be used: {reason}; correct its xformOps."
        ) from None
    return _in_meters(matrix, scale)


def _in_meters(matrix: NDArray[np.float64], scale: float) -> NDArray[np.float64]:
    result = matrix.copy()
    result[:3] *= scale
    return result


def _in_mask(path: str, mask: tuple[str, ...] | None) -> bool:
    if mask is None:
        return True
    return any(path == root or path.startswith(root.rstrip("/") + "/") for root in mask)


def _bound_paths(prims: list[Usd.Prim], material_of: object) -> list[str]:
    """Return the paths of the materials that meshes and their subsets are bound to, once each."""
    found: dict[str, None] = {}
    for prim in prims:
        subsets = UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim))
        for bound in (prim, *(subset.GetPrim() for subset in subsets)):
            path = material_of(bound)  # type: ignore[operator]
            if path is not None:
                found[path] = None
    return list(found)


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


def scene_white(scene: Scene) -> NDArray[np.float64]:
    """Return the XYZ of a perfect diffuser, averaged over all its orientations, shape [3].

    Turning the light does not change it. Lights that have a place are taken as they look from the
    middle of the geometry.
    """
    white = mean_white(scene.lights, scene.frame)
    if not (scene.lights.locals and scene.meshes):
        return white
    low = np.min([mesh.points.min(axis=0) for mesh in scene.meshes], axis=0)
    high = np.max([mesh.points.max(axis=0) for mesh in scene.meshes], axis=0)
    received = [facing_irradiance(light, 0.5 * (low + high)) for light in scene.lights.locals]
    weights = xyz_weights(scene.frame.wavelength_nm, scene.frame.observer, scene.frame.absolute)
    return np.asarray(white + np.sum(received, axis=0) @ weights / (4.0 * np.pi))


def mean_white(lights: Lights, frame: SpectralFrame) -> NDArray[np.float64]:
    """Return the XYZ of a perfect diffuser in the light from far away, shape [3].

    Averaged over all its orientations it receives a quarter of the total flux over the sphere, and
    reflects 1/pi of that.
    """
    weights = xyz_weights(frame.wavelength_nm, frame.observer, frame.absolute)
    total = np.zeros(3)
    for dome in lights.domes:
        polar = np.pi * np.arange(dome.coefficients.shape[0] + 1) / dome.coefficients.shape[0]
        area = 2.0 * np.pi * (np.cos(polar[:-1]) - np.cos(polar[1:]))
        total += area @ dome.coefficients.mean(axis=1, dtype=np.float64) @ dome.basis @ weights
    for distant in lights.distants:
        total += distant.irradiance @ weights
    return np.asarray(total / (4.0 * np.pi))
