"""A stage at one moment as arrays: triangles in world space, materials and lights.

Reads: any stage. Makes: ``Scene``, which knows no USD, and from it ``DeviceScene``.
"""

from __future__ import annotations

from collections.abc import Iterable
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
from usdskin.render.gloss import LADDER, add_reflections, show_domes
from usdskin.render.gprims import is_gprim, read_gprim, unsupported_note
from usdskin.render.integrate import DeviceScene, Faces
from usdskin.render.light_maps import (
    LightField,
    banded,
    build_brute_field,
    build_light_field,
)
from usdskin.render.lights import Lights, read_lights
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
from usdskin.render.surface_rows import SpectralFrame, dims, gloss_alphas, wraps_of
from usdskin.render.surfaces import build_surfaces
from usdskin.warp_kernels import structs

# isort: split
# After ours, which register the schemas.
from pxr import Tf, Usd, UsdGeom


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A stage at one moment, in metres, in the stage's own axes."""

    meshes: tuple[MeshArrays, ...]
    materials: tuple[SkinMaterial | SurfaceMaterial, ...]
    """Distinct materials; the last one shows displayColor and is what nothing else is bound to."""

    material_index: dict[str | None, int]
    """Index into ``materials`` by path."""

    lights: Lights
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
    *,
    unlit: bool = False,
) -> Scene:
    """Read what a picture shows.

    Args:
        stage: The stage.
        time: When.
        settings: Purposes, mask, subdivision level, wavelengths.
        notes: What cannot be shown is appended.
        unlit: Leave the lights out.

    Raises:
        LayerError: Something cannot be used, or nothing gives light.
    """
    lights = Lights((), ())
    if not unlit:
        lights = read_lights(
            stage,
            time,
            settings.wavelength_nm,
            settings.observer,
            settings.illuminant,
            settings.bad_pixels,
            notes,
        )
    if not unlit and not lights.domes and not lights.distants:
        raise LayerError(
            f"{stage.GetRootLayer().identifier}: no light shines; add a DomeLight or a "
            "DistantLight, or make one visible."
        )
    prims = list(_visible_gprims(stage, time, settings, notes))
    bindings: dict[str, str | None] = {}

    def material_of(prim: Usd.Prim) -> str | None:
        path = str(prim.GetPath())
        if path not in bindings:
            bindings[path] = bound_material(prim, settings.material_purposes)
            notes.extend(binding_notes(prim))
        return bindings[path]

    paths = _bound_paths(prims, material_of)
    known = read_materials(stage, paths, time, notes, settings.color_space)
    materials = (*known.values(), display_material())
    index: dict[str | None, int] = {path: k for k, path in enumerate(known)}
    index[None] = len(materials) - 1
    names = required_primvars(materials) | {"st"}
    cache = UsdGeom.XformCache(time)
    scale = UsdGeom.GetStageMetersPerUnit(stage)
    meshes = []
    for prim in prims:
        to_world = _to_world(prim, cache, scale)
        reader = read_mesh if prim.IsA(UsdGeom.Mesh) else read_gprim
        mesh = reader(prim, time, to_world, settings.subdivision_level, names, material_of, notes)
        if mesh is not None and len(mesh.triangles):
            meshes.append(mesh)
    frame = SpectralFrame(
        settings.wavelength_nm, settings.observer, lights.absolute, settings.color_space
    )
    return Scene(tuple(meshes), materials, index, lights, frame)


def _visible_gprims(
    stage: Usd.Stage, time: Usd.TimeCode, settings: RenderSettings, notes: list[Note]
) -> Iterable[Usd.Prim]:
    """Yield the gprims to draw: visible, of a wanted purpose, inside the mask."""
    purposes = {purpose for purpose in settings.purposes} | {"default"}
    walk = iter(Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()))
    for prim in walk:
        if prim.IsA(UsdGeom.PointInstancer):  # what is below it are its prototypes
            walk.PruneChildren()
        if not prim.IsA(UsdGeom.Imageable) or not _in_mask(str(prim.GetPath()), settings.mask):
            continue
        imageable = UsdGeom.Imageable(prim)
        if imageable.ComputeVisibility(time) == UsdGeom.Tokens.invisible:
            continue
        if imageable.ComputePurpose() not in purposes:
            continue
        note = unsupported_note(prim)
        if note is not None:
            notes.append(note)
        elif is_gprim(prim):
            yield prim


def _to_world(prim: Usd.Prim, cache: UsdGeom.XformCache, scale: float) -> NDArray[np.float64]:
    """Return a prim's local-to-world matrix in metres, column vectors, shape [4, 4]."""
    try:
        matrix = np.array(cache.GetLocalToWorldTransform(prim)).T
    except Tf.ErrorException as error:
        reason = str(error).rsplit(" : ", 1)[-1].strip().strip("'").rstrip(".")
        raise LayerError(
            f"{describe(prim)}: its transform cannot be used: {reason}; correct its xformOps."
        ) from None
    matrix[:3] *= scale
    return matrix


def _in_mask(path: str, mask: tuple[str, ...] | None) -> bool:
    if mask is None:
        return True
    return any(path == root or path.startswith(root.rstrip("/") + "/") for root in mask)


def _bound_paths(prims: list[Usd.Prim], material_of: object) -> list[str]:
    """Return the paths of the materials that meshes and their subsets are bound to, once each."""
    found: dict[str, None] = {}
    for prim in prims:
        subsets = [child for child in prim.GetChildren() if child.IsA(UsdGeom.Subset)]
        for bound in (prim, *subsets):
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
    measured: bool = False,
) -> tuple[DeviceScene, LightField]:
    """Bake the lights, build the material tables and copy the geometry to the device.

    Args:
        scene: The scene.
        workers: Where to.
        show_dome: Whether the camera sees the domes.
        brute: Shade every band from every texel, without factorisation and maps, as the oracle.
        traced: Whether rays look for reflections, and measure the way through bodies.
        measured: Whether that way was measured before (``usdskin.render.transfer``).
    """
    device = workers.device
    rows = {name: k for k, name in enumerate(sorted(_primvar_names(scene)))}
    thickness = _thickness_range(scene)
    if traced or measured:
        thickness = {material.path: np.inf for material in scene.materials}
    with ThreadPoolExecutor(1) as pool:  # beside the lights, which take as long
        uploading = pool.submit(_upload_geometry, scene, rows, device)
        light = _bake(scene, workers, show_dome, brute, traced, measured)
        geometry, mesh, faces = uploading.result()
    surfaces = build_surfaces(
        scene.materials,
        light.basis,
        scene.frame,
        wraps_of(scene.materials),
        rows,
        thickness,
        device,
    )
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
        light = build_light_field(lights, wraps, workers, bands, split)
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
    geometry.material = wp.array(material, dtype=wp.int32, device=device)
    geometry.prim = wp.array(prim, dtype=wp.int32, device=device)
    return geometry, mesh, Faces(joined_points, joined_triangles, prim, material)


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


def mean_white(lights: Lights, frame: SpectralFrame) -> NDArray[np.float64]:
    """Return the XYZ of a perfect diffuser, averaged over all its orientations, shape [3].

    It receives a quarter of the total flux over the sphere and reflects 1/pi of that.
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
