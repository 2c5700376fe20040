"""A stage at one moment as arrays: triangles in world space, materials and lights.

Reads: any stage. Makes: ``Scene``, which knows no USD.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.coordinates import missing_coordinates_notes
from usdskin.render.detail import add_detail, detail_primvars
from usdskin.render.frame_cache import FrameCache, Shapes
from usdskin.render.gprims import ROWS, is_gprim, read_gprim, unsupported_note
from usdskin.render.instance_meshes import instance_meshes
from usdskin.render.instancers import InstancerReader, Placed
from usdskin.render.job import RenderSettings
from usdskin.render.light_links import LinkTables, read_links
from usdskin.render.lights import Lights, check_lit, read_lights
from usdskin.render.local_lights import facing_irradiance
from usdskin.render.materials import (
    SkinMaterial,
    SurfaceMaterial,
    binding_notes,
    bound_material,
    display_material,
    read_materials,
    required_primvars,
)
from usdskin.render.meshes import MeshArrays, read_mesh
from usdskin.render.skinning import PoseReader
from usdskin.render.surface_rows import SpectralFrame
from usdskin.render.udim import missing_tile_notes

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
    base: Usd.TimeCode | None = None,
    unlit: bool = False,
) -> Scene:
    """Read what a picture shows.

    Args:
        stage: The stage.
        time: When.
        settings: Purposes, mask, subdivision level, wavelengths.
        notes: What cannot be shown is appended.
        cache: What the frame before left; its notes are not repeated.
        base: The frame that ``time`` belongs to while the shutter is open, which says what point
            instancers place; ``time`` itself where None.
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
    shapes = kept.shapes or _read_shapes(stage, time, base or time, settings, kept, notes)
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
    base: Usd.TimeCode,
    settings: RenderSettings,
    kept: FrameCache,
    notes: list[Note],
) -> Shapes:
    """Read the meshes and what they are made of."""
    cache = UsdGeom.XformCache(time)
    purposes = frozenset(settings.purposes) | {"default"}
    instancers = InstancerReader(time, base, purposes, notes, cache)
    prims, placed = _visible_shapes(stage, time, settings, instancers, notes)
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
        base,
        notes,
    )
    notes.extend(missing_tile_notes(meshes, materials, index))
    notes.extend(missing_coordinates_notes(meshes, materials, index))
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
    instancers: InstancerReader,
    notes: list[Note],
) -> tuple[list[Usd.Prim], list[Placed]]:
    """Return what to draw: visible, of a wanted purpose, inside the mask.

    Returns:
        The gprims, and what point instancers place.
    """
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
        if purpose not in instancers.purposes or (
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
