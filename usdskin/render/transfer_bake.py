"""Measure shadows once, for any light and camera: ``usdskin bake``.

Reads:  a stage at one moment; its lights have no say.
Writes: ``transfer.usda``, which says ``SkinTransferAPI`` over every gprim, and ``transfer.npz``
        beside it (``usdskin.render.transfer_file``).
"""

from __future__ import annotations

import time as clock
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers, open_workers, vec3
from usdskin.errors import LayerError, UsageError
from usdskin.layers import check_output, record_provenance, used_files, write_layer
from usdskin.notes import Note
from usdskin.prims.transfers import SkinTransfer, write_transfer
from usdskin.progress import Progress
from usdskin.render.job import RenderSettings
from usdskin.render.materials import SkinMaterial
from usdskin.render.meshes import MeshArrays
from usdskin.render.opening import opened
from usdskin.render.overrides import RenderOverrides
from usdskin.render.passage import body_reach
from usdskin.render.scene import Scene, read_scene
from usdskin.render.settings import read_settings
from usdskin.render.transfer_file import MeshTransfer, kept, write_transfers
from usdskin.render.transfer_identity import geometry_hashes, reaches, scene_hash
from usdskin.render.transfer_levels import Level, beside, levels_of, rim_of, words_near
from usdskin.render.transfer_points import Places, facet_spread, places_of
from usdskin.render.transfer_sphere import WORD, TransferSphere, ring_count, transfer_sphere
from usdskin.render.uploading import is_solid, upload_bodies
from usdskin.warp_kernels import structs, transfer, transfer_structs

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom

DEFAULT_DIRECTIONS = 1024
DIRECTIONS_RANGE = (64, 32768)

STEP = "bakeTransfer"
"""Name of the step in a layer's record of its origin."""

_CHUNK = 256
"""Places of one launch on the CPU."""

_COARSE_SHARE = 0.05
"""Longest edge, as a share of the scene's size, above which shadows on a mesh are blurred."""


@dataclass(frozen=True, slots=True, eq=False)
class BakeReport:
    """What a bake did."""

    paths: list[Path]
    """Files written."""

    notes: list[Note]
    """What was left out."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Time each part took [s]."""

    prims: int = 0
    places: int = 0
    """Prims, and vertices of theirs, that were measured."""

    rays: int = 0
    size: int = 0
    """Bytes of the measurements."""

    def lines(self) -> Iterable[str]:
        """Return it for people."""
        rate = self.rays / max(self.seconds.get("measure", 0.0), 1e-9)
        yield (
            f"{self.prims} prims, {self.places} vertices, {self.rays / 1e6:.1f} million rays at "
            f"{rate / 1e6:.2f} million a second, {self.size / 2**20:.1f} MiB"
        )

    def as_dict(self) -> dict[str, object]:
        """Return it for programs."""
        return {"prims": self.prims, "places": self.places, "rays": self.rays, "bytes": self.size}


def bake_transfer(
    stage_path: Path,
    output: Path,
    overrides: RenderOverrides,
    progress: Progress,
    *,
    directions: int | None = None,
    receivers: tuple[str, ...] | None = None,
) -> BakeReport:
    """Measure what every vertex of a stage sees of a fixed set of directions.

    Args:
        stage_path: Layer to open; it is read, never changed.
        output: Layer to write; the measurements are written beside it.
        overrides: Frame, level, purposes, variants and the like.
        progress: Advances by rays.
        directions: How many, about.
        receivers: Paths of the prims to measure on, with all below them; None for everything.

    Raises:
        UsdSkinError: The stage or an option cannot be used.
    """
    begun = clock.perf_counter()
    count = DEFAULT_DIRECTIONS if directions is None else directions
    if not DIRECTIONS_RANGE[0] <= count <= DIRECTIONS_RANGE[1]:
        low, high = DIRECTIONS_RANGE
        raise UsageError(f"--directions {count}: must be from {low} to {high}.")
    data = output.with_suffix(".npz")
    check_output(output, [stage_path], [data], step="bake")
    sphere = transfer_sphere(ring_count(count))
    notes: list[Note] = []
    with opened(stage_path, overrides, notes) as stage:
        _check_replaced(stage, output)
        settings = read_settings(stage, overrides)
        time = _time(stage, overrides)
        scene = read_scene(stage, time, settings, notes, unlit=True)
        meshes = _baked_meshes(stage, scene, receivers, notes)
        workers = open_workers(settings.device, settings.threads)
        read = clock.perf_counter()
        places = [places_of(mesh) for mesh in meshes]
        transfers, rays = _measure(scene, meshes, places, sphere, workers, progress)
        measured = clock.perf_counter()
        hashes = geometry_hashes(scene)
        write_transfers(data, transfers, hashes)
        records = [
            SkinTransfer(
                file=data,
                index=k,
                row_count=len(places[k].point),
                rings=sphere.rings,
                subdivision_level=settings.subdivision_level,
                geometry_hash=hashes[mesh.path],
                scene_hash=scene_hash(hashes),
                reach=reaches(mesh, scene, settings),
            )
            for k, mesh in enumerate(meshes)
        ]
        _write(stage, output, meshes, records, settings, time, sphere)
    rows = sum(len(part.point) for part in places)
    seconds = {
        "read": read - begun,
        "measure": measured - read,
        "write": clock.perf_counter() - measured,
    }
    return BakeReport(
        [output, data], list(dict.fromkeys(notes)), seconds,
        len(meshes), rows, rays, data.stat().st_size,
    )  # fmt: skip


def _check_replaced(stage: Usd.Stage, output: Path) -> None:
    """Refuse to replace a layer of the stage, unless it is an earlier bake."""
    for layer in stage.GetUsedLayers():
        if layer.realPath and Path(layer.realPath) == output.resolve():
            if STEP not in layer.customLayerData.get("usdskin", {}):
                raise UsageError(
                    f"{output}: is a layer of the stage and no earlier bake; write to another name"
                )


def _time(stage: Usd.Stage, overrides: RenderOverrides) -> Usd.TimeCode:
    if overrides.frames is not None:
        return Usd.TimeCode(float(overrides.frames[0]))
    if stage.HasAuthoredMetadata("startTimeCode"):
        return Usd.TimeCode(stage.GetStartTimeCode())
    return Usd.TimeCode.EarliestTime()


def _baked_meshes(
    stage: Usd.Stage, scene: Scene, receivers: tuple[str, ...] | None, notes: list[Note]
) -> list[MeshArrays]:
    """Return the meshes that are wanted and that a layer can say something about."""
    for path in receivers or ():
        valid = path.startswith("/") and Sdf.Path.IsValidPathString(path)
        if not (valid and stage.GetPrimAtPath(path)):
            raise UsageError(f"--receivers {path}: the stage has no such prim; give its path.")
    found = []
    everything = [mesh.points for mesh in scene.meshes]
    size = float(np.ptp(np.concatenate(everything), axis=0).max()) if everything else 0.0
    for mesh in scene.meshes:
        if receivers is not None and not any(
            Sdf.Path(mesh.path).HasPrefix(path) for path in receivers
        ):
            continue
        if stage.GetPrimAtPath(mesh.path).IsInstanceProxy():
            what = "is part of an instance, which no layer can override; it stays unshadowed"
            notes.append(Note("transfer-instance", mesh.path, what))
            continue
        corner = mesh.points[mesh.triangles]
        longest = float(np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=-1).max())
        if longest > _COARSE_SHARE * size:
            what = (
                f"has edges of {longest:.3g} m, over which its shadows are blurred; subdivide it, "
                "or render with --integrator traced"
            )
            notes.append(Note("transfer-coarse", mesh.path, what))
        found.append(mesh)
    if not found:
        name = stage.GetRootLayer().GetDisplayName()
        raise LayerError(
            f"{name}: has no geometry to bake; check purposes, visibility and receivers"
        )
    return found


def _measure(
    scene: Scene,
    meshes: list[MeshArrays],
    places: list[Places],
    sphere: TransferSphere,
    workers: Workers,
    progress: Progress,
) -> tuple[list[MeshTransfer], int]:
    """Return what the places of every mesh see, and how many rays were followed."""
    device = workers.device
    geometry, materials, keep = upload_bodies(scene, workers)
    compilation.load(transfer, device)
    index = {id(mesh): k for k, mesh in enumerate(scene.meshes)}
    progress.start(sum(len(part.point) for part in places) * sphere.count, "measure")
    device_directions = _device_directions(sphere, device)
    solid = is_solid(geometry, materials)
    found, rays = [], 0
    for mesh, part in zip(meshes, places, strict=True):
        slots = np.array([scene.material_index[path] for path in mesh.material_paths], np.int32)
        where = transfer_structs.Places()
        where.position = vec3(mesh.points[part.point], device)
        where.normal = vec3(part.normal, device)
        where.material = wp.array(slots[part.slot], dtype=wp.int32, device=device)
        where.prim = wp.full(len(part.point), index[id(mesh)], dtype=wp.int32, device=device)
        where.horizon = wp.array(
            _horizons(scene, mesh, part, slots[part.slot], solid), dtype=wp.float32, device=device
        )
        where.solid = int(solid)
        rim = rim_of(mesh.points, mesh.triangles)[part.point]
        levels = levels_of(mesh.points[part.point], part.normal, rim)
        measured = _Measuring(geometry, materials, where, device_directions, sphere, workers)
        for level in levels:
            rays += measured.add(level)
            progress.advance(len(level.place) * sphere.count)
        found.append(measured.finish())
    progress.done()
    del keep
    return found, rays


def _horizons(
    scene: Scene, mesh: MeshArrays, places: Places, material: NDArray[np.int32], solid: bool
) -> NDArray[np.float32]:
    """Return the cosine with a place's normal below which no light arrives, shape [count].

    Skin is lit from behind too, as far as its wrap reaches, which may change; not where its body
    lets nothing through.
    """
    shading = -places.spread - np.float32(1e-3)
    lowest = np.full(len(shading), -2.0, np.float32)
    is_skin = np.array([isinstance(each, SkinMaterial) for each in scene.materials])[material]
    lowest[~is_skin] = shading[~is_skin]
    reach = np.array([
        body_reach(each, scene.frame.wavelength_nm) if isinstance(each, SkinMaterial) else 0.0
        for each in scene.materials
    ])[material]  # fmt: skip
    size = np.abs(mesh.points[places.point]).max(axis=1)
    thinnest = float(transfer.THINNEST) * 4e-6 * np.maximum(size, 1e-3)
    blocks = is_skin & (reach > 0.0) & (reach < thinnest) & solid
    lowest[blocks] = np.minimum(shading, -facet_spread(mesh, places) - np.float32(1e-3))[blocks]
    return lowest


@dataclass(frozen=True, slots=True, eq=False)
class _Measuring:
    """One mesh under way."""

    geometry: structs.Geometry
    materials: structs.Materials
    places: transfer_structs.Places
    directions: tuple[wp.array, wp.array, wp.array]
    """The directions, those beside each, and the words that hold those beside a word's."""

    sphere: TransferSphere
    workers: Workers
    weakened: wp.array = field(init=False)
    partial: wp.array = field(init=False)

    def __post_init__(self) -> None:
        shape = (self.places.position.shape[0], len(self.sphere.direction) // WORD)
        for name in ("weakened", "partial"):
            bits = wp.zeros(shape, dtype=wp.uint32, device=self.workers.device)
            object.__setattr__(self, name, bits)

    def add(self, level: Level) -> int:
        """Measure the places of a level; return how many rays that took."""
        device = self.workers.device
        place = wp.array(level.place, dtype=wp.int32, device=device)
        around = wp.array(level.around, dtype=wp.int32, device=device)
        rays = wp.zeros(len(level.place), dtype=wp.int32, device=device)

        def work(begin: int, end: int) -> None:
            transfer.measure(
                self.geometry, self.materials, self.places, *self.directions, place, around,
                self.weakened, self.partial, rays, begin, end,
            )  # fmt: skip

        self._run(len(level.place), work)
        return int(rays.numpy().sum())

    def finish(self) -> MeshTransfer:
        """Return what was measured."""
        device = self.workers.device
        partial = self.partial.numpy()
        first = np.zeros(len(partial) + 1, np.int64)
        counted = np.unpackbits(partial.view(np.uint8), axis=1).sum(axis=1)
        np.cumsum(counted, out=first[1:])
        count = int(first[-1])
        entry = wp.array(first[:-1].astype(np.int32), dtype=wp.int32, device=device)
        kinds = (wp.int32, wp.float32, wp.float32)
        found = tuple(wp.zeros(max(count, 1), dtype=kind, device=device) for kind in kinds)

        def work(begin: int, end: int) -> None:
            transfer.measure_entries(
                self.geometry, self.materials, self.places, self.directions[0], self.partial,
                entry, (found[0], found[1], found[2]), begin, end,
            )  # fmt: skip

        if count:
            self._run(len(partial), work)
        direction, clear, length = (each.numpy()[:count] for each in found)
        return kept(self.weakened.numpy(), first, direction, clear, length)

    def _run(self, count: int, work: Callable[[int, int], None]) -> None:
        self.workers.run(count, _CHUNK if self.workers.device == "cpu" else count, work)


def _device_directions(sphere: TransferSphere, device: str) -> tuple[wp.array, wp.array, wp.array]:
    used = sphere.direction[: sphere.count]
    others = beside(used)
    near = words_near(others, WORD)
    return (
        vec3(used, device),
        wp.array(others, dtype=wp.int32, device=device),
        wp.array(near, dtype=wp.int32, device=device),
    )


def _write(
    source: Usd.Stage,
    output: Path,
    meshes: list[MeshArrays],
    records: list[SkinTransfer],
    settings: RenderSettings,
    time: Usd.TimeCode,
    sphere: TransferSphere,
) -> None:
    """Write the layer: one ``over`` per mesh, with the source's units and default prim."""
    root = source.GetRootLayer()
    layer = Sdf.Layer.CreateAnonymous(".usda")
    layer.subLayerPaths = [root.identifier]
    stage = Usd.Stage.Open(layer, source.GetSessionLayer())
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(source))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(source))
    default = source.GetDefaultPrim()
    first = Sdf.Path(meshes[0].path).GetPrefixes()[0].name
    layer.defaultPrim = default.GetName() if default else first
    for mesh, record in zip(meshes, records, strict=True):
        write_transfer(stage.GetPrimAtPath(mesh.path), record, output.parent)
    inputs = [file for file in used_files(source) if file != output.resolve()]
    record_provenance(
        stage,
        STEP,
        sorted(inputs),
        {
            "directions": sphere.count,
            "frame": "" if time.IsEarliestTime() else float(time.GetValue()),
            "subdivisionLevel": settings.subdivision_level,
        },
        output.parent,
    )
    layer.subLayerPaths = []
    write_layer(layer, output)
