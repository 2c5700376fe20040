"""Measure shadows once, for any light and camera: ``usdskin bake``.

Reads:  a stage at one moment; its lights have no say.
Writes: ``transfer.usda``, which says ``SkinTransferAPI`` over every gprim, and ``transfer.npz``
        beside it (``usdskin.render.transfer_file``).
"""

from __future__ import annotations

import hashlib
import time as clock
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import warp as wp

from usdskin import compilation
from usdskin.device import Workers, open_workers, vec3
from usdskin.errors import LayerError, UsageError
from usdskin.layers import check_output, record_provenance, used_files, write_layer
from usdskin.notes import Note
from usdskin.prims.transfers import SkinTransfer, write_transfer
from usdskin.progress import Progress
from usdskin.render.materials import SkinMaterial
from usdskin.render.meshes import MeshArrays
from usdskin.render.opening import opened
from usdskin.render.overrides import RenderOverrides
from usdskin.render.scene import Scene, read_scene
from usdskin.render.settings import RenderSettings, read_settings
from usdskin.render.surface_rows import body_reach
from usdskin.render.transfer_file import MeshTransfer, joined, pack, write_transfers
from usdskin.render.transfer_points import Places, geometry_hashes, places_of
from usdskin.render.transfer_sphere import TransferSphere, ring_count, transfer_sphere
from usdskin.render.uploading import upload_bodies
from usdskin.warp_kernels import transfer

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom

DEFAULT_DIRECTIONS = 1024
DIRECTIONS_RANGE = (64, 32768)

STEP = "bakeTransfer"
"""Name of the step in a layer's record of its origin."""

_CHUNK = 1 << 21
"""Rays of one launch."""

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
        transfers = _measure(scene, meshes, places, sphere, workers, progress)
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
        len(meshes), rows, rows * sphere.count, data.stat().st_size,
    )  # fmt: skip


def scene_hash(hashes: dict[str, str]) -> str:
    """Return one hash of all geometry, whatever the prims are called."""
    text = "\n".join(sorted(hashes.values()))
    return hashlib.blake2b(text.encode(), digest_size=12).hexdigest()


def reaches(
    mesh: MeshArrays, scene: Scene, settings: RenderSettings
) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    """Return how far light is followed through each material of a mesh [m]."""
    found = (scene.materials[scene.material_index[path]] for path in mesh.material_paths)
    return np.array([body_reach(material, settings.wavelength_nm) for material in found])


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
) -> list[MeshTransfer]:
    """Return what the places of every mesh see."""
    device = workers.device
    geometry, materials, keep = upload_bodies(scene, workers)
    compilation.load(transfer, device)
    index = {id(mesh): k for k, mesh in enumerate(scene.meshes)}
    progress.start(sum(len(part.point) for part in places) * sphere.count, "measure")
    direction = vec3(sphere.direction[: sphere.count], device)
    found = []
    for mesh, part in zip(meshes, places, strict=True):
        slots = np.array([scene.material_index[path] for path in mesh.material_paths], np.int32)
        position = vec3(mesh.points[part.point], device)
        normal = vec3(part.normal, device)
        material = wp.array(slots[part.slot], dtype=wp.int32, device=device)
        prim = wp.full(len(part.point), index[id(mesh)], dtype=wp.int32, device=device)
        # Skin is lit from behind too, as far as its wrap reaches, which may change.
        is_skin = np.array(
            [isinstance(scene.materials[slot], SkinMaterial) for slot in slots], np.bool_
        )[part.slot]
        lowest = np.where(is_skin, -2.0, -part.spread - 1e-3).astype(np.float32)
        horizon = wp.array(lowest, dtype=wp.float32, device=device)
        packed: dict[int, MeshTransfer] = {}

        def work(
            begin: int,
            end: int,
            position: wp.array = position,
            normal: wp.array = normal,
            material: wp.array = material,
            prim: wp.array = prim,
            horizon: wp.array = horizon,
            packed: dict[int, MeshTransfer] = packed,
        ) -> None:
            shape = (end - begin, sphere.count)
            clear = wp.empty(shape, dtype=wp.float32, device=device)
            length = wp.empty(shape, dtype=wp.float32, device=device)
            transfer.measure(
                geometry, materials, position, normal, material, prim, horizon, direction, begin,
                clear, length,
            )  # fmt: skip
            extra = ((0, 0), (0, len(sphere.direction) - sphere.count))
            packed[begin] = pack(
                np.pad(clear.numpy(), extra, constant_values=1.0), np.pad(length.numpy(), extra)
            )

        chunk = max(1, _CHUNK // sphere.count)
        workers.run(
            len(part.point), chunk, work, lambda rows: progress.advance(rows * sphere.count)
        )
        found.append(joined([packed[begin] for begin in sorted(packed)]))
    progress.done()
    del keep
    return found


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
