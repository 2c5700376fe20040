"""Render a stage: one picture per product and frame.

Reads:  any stage.
Writes: the files its products name (``usdskin.render.outputs``); nothing of the stage.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from usdskin import compilation
from usdskin.device import Workers, open_workers
from usdskin.errors import FramesError, UsageError, UsdSkinError
from usdskin.frames import frame_path
from usdskin.notes import Note
from usdskin.progress import Progress
from usdskin.render.aovs import MATTES, TRACED_SOURCES
from usdskin.render.cameras import Camera, read_camera
from usdskin.render.checkpoint import KEEP_EVERY_S, Checkpoint, fingerprint, partial_path
from usdskin.render.cryptomatte import collect_mattes
from usdskin.render.integrate import (
    WHOLE,
    DeviceScene,
    Picture,
    Share,
    collect_data,
    integrate,
    picture_kernels,
)
from usdskin.render.light_maps import LightField
from usdskin.render.motion import (
    Exposure,
    SharedProgress,
    find_exposure,
    mean_picture,
    topology_notes,
    unkept_note,
)
from usdskin.render.opening import opened
from usdskin.render.outputs import Shot, matte_names, previewing, write_picture
from usdskin.render.overrides import RenderOverrides, apply_overrides
from usdskin.render.products import Product, prepare_folders
from usdskin.render.scene import Scene, read_scene, scene_white, upload
from usdskin.render.settings import (
    Frame,
    RenderJob,
    RenderReport,
    RenderSettings,
    resolve_settings,
)
from usdskin.render.traced import Sampling, integrate_traced, sampling_key, trace_lights
from usdskin.render.transfer import Transfers, read_transfers
from usdskin.render.transfer_light import shade_transfers, upload_transfers

# isort: split
# After ours, which register the schemas.
from pxr import Usd

ERROR_FLOOR = 0.3
"""Luminance, of a white diffuser's in the mean light, below which errors weigh no more."""


def render_stage(
    stage_path: Path, output: Path | None, overrides: RenderOverrides, progress: Progress
) -> RenderReport:
    """Render the products of a stage, or one picture to ``output``.

    Args:
        stage_path: Layer to open; it is read, never changed.
        output: Picture to write instead of the stage's products; may hold ``####``.
        overrides: What flags say.
        progress: Told about the work.

    Raises:
        UsdSkinError: The stage, an option or a file cannot be used, and no frame was rendered.
    """
    begun = clock.perf_counter()
    report = RenderReport([], [])
    with opened(stage_path, report.notes) as stage:
        apply_overrides(stage, overrides)
        job = resolve_settings(stage, overrides, output, report.notes)
        prepare_folders(file for product in job.products for file in product.files)
        workers = open_workers(job.settings.device, job.settings.threads)
        _lap(report.seconds, "open", begun)
        try:
            for frame in job.frames:
                try:
                    _render_frame(stage, job, frame, workers, progress, report)
                except UsdSkinError as error:
                    if len(job.frames) == 1:
                        raise
                    report.failures[f"{frame.number:g}"] = str(error)
        finally:
            compilation.abandon()
    if report.failures and len(report.failures) == len(job.frames):
        number, reason = next(iter(report.failures.items()))
        raise FramesError(f"every frame failed; the first, {number}: {reason}")
    _drop_repeated(report.notes)
    return report


def _drop_repeated(notes: list[Note]) -> None:
    """Keep one of each note: every frame and product finds the same."""
    notes[:] = dict.fromkeys(notes)


def _render_frame(
    stage: Usd.Stage,
    job: RenderJob,
    frame: Frame,
    workers: Workers,
    progress: Progress,
    report: RenderReport,
) -> None:
    wanted = [(product, _files(product, frame, job)) for product in job.products]
    wanted = [(product, files) for product, files in wanted if files]
    if not wanted:
        return
    sources = {aov.source for product, _ in wanted for aov in product.aovs}
    compilation.begin(
        picture_kernels(workers.device, sources, job.settings.integrator == "traced"),
        workers.device,
        progress,
    )
    exposures = [
        find_exposure(stage, product, frame, job.settings, report.notes) for product, _ in wanted
    ]
    loader = _Loader(stage, job.settings, workers, report)
    for (product, files), exposure in zip(wanted, exposures, strict=True):
        moved = exposure is not None and exposure.scene_moves
        loaded = loader.load(exposure.middle if exposure and moved else frame.time)
        _render_product(
            stage, job, frame, product, files, loaded, loader, exposure, workers, progress, report
        )


def _transfers(stage: Usd.Stage, scene: Scene, settings: RenderSettings) -> Transfers | None:
    """Return the shadows that were baked for a scene, for the integrator that looks them up."""
    if settings.integrator == "traced":
        return None
    transfers = read_transfers(stage, scene, settings)
    if settings.spectral_method == "brute" and transfers is not None:
        raise UsageError(
            "--spectral brute takes no baked shadows; leave the transfer layer out, or render "
            "with --integrator traced."
        )
    return transfers


@dataclass(frozen=True, slots=True, eq=False)
class _Loaded:
    """A scene at one time, on the host and on the device."""

    scene: Scene
    device_scene: DeviceScene
    light: LightField


class _Loader:
    """Reads scenes, and keeps the last one whose time is asked for again."""

    def __init__(
        self, stage: Usd.Stage, settings: RenderSettings, workers: Workers, report: RenderReport
    ) -> None:
        self._stage, self._settings = stage, settings
        self._workers, self._report = workers, report
        self._last: tuple[Usd.TimeCode, _Loaded] | None = None

    def load(self, time: Usd.TimeCode, *, keep: bool = True) -> _Loaded:
        """Return the scene at a time; ``keep`` it for the products to come."""
        if self._last is not None and self._last[0] == time:
            return self._last[1]
        settings, report = self._settings, self._report
        begun = clock.perf_counter()
        scene = read_scene(self._stage, time, settings, report.notes)
        begun = _lap(report.seconds, "read", begun)
        transfers = _transfers(self._stage, scene, settings)
        # Straight alpha needs the dome hidden, and every EXR has alpha.
        device_scene, light = upload(
            scene,
            self._workers,
            show_dome=settings.dome == "show",
            brute=settings.spectral_method == "brute",
            traced=settings.integrator == "traced",
            bounces=settings.bounces,
            measured=transfers is not None,
        )
        begun = _lap(report.seconds, "bake", begun)
        if transfers is not None:
            shadows = upload_transfers(transfers, self._workers.device)
            shade_transfers(shadows, scene.lights, light, device_scene, self._workers)
            begun = _lap(report.seconds, "shadows", begun)
        compilation.finish()
        _lap(report.seconds, "compile", begun)
        loaded = _Loaded(scene, device_scene, light)
        if keep:
            self._last = time, loaded
        return loaded


def _files(product: Product, frame: Frame, job: RenderJob) -> dict[str, Path]:
    """Return the files of a product that are still to be written, by kind."""
    templates = {"exr": product.exr, "spectral": product.spectral, "png": product.png}
    files = {
        kind: frame_path(template, frame.number)
        for kind, template in templates.items()
        if template is not None
    }
    if not files or not job.settings.skip_existing:
        return files
    unfinished = job.overrides.resume and partial_path(next(iter(files.values()))).exists()
    there = all(path.exists() for path in files.values())
    return {} if there and not unfinished else files


def _render_product(
    stage: Usd.Stage,
    job: RenderJob,
    frame: Frame,
    product: Product,
    files: dict[str, Path],
    loaded: _Loaded,
    loader: _Loader,
    exposure: Exposure | None,
    workers: Workers,
    progress: Progress,
    report: RenderReport,
) -> None:
    settings, seconds = job.settings, report.seconds
    scene, device_scene = loaded.scene, loaded.device_scene
    begun = clock.perf_counter()
    camera = read_camera(
        stage,
        product.camera,
        frame.time if exposure is None else exposure.middle,
        product.resolution,
        product.pixel_aspect_ratio,
        product.conform_policy,
        report.notes,
        product.depth_of_field,
    )
    white = scene_white(scene)
    shot = Shot(
        Path(stage.GetRootLayer().identifier).name,
        frame.number,
        job.digest(product),
        tuple(mesh.path for mesh in scene.meshes),
        tuple(material.path or "displayColor" for material in scene.materials),
        scene.lights.absolute,
        white,
    )
    overrides = job.overrides
    checkpoint = Checkpoint(
        next(iter(files.values())),
        lambda: fingerprint(shot.digest, workers.device, settings.dome, scene, camera),
        report.notes,
        overrides.resume,
        overrides.snapshot_s or KEEP_EVERY_S,
        previewing(product, camera, settings, shot) if overrides.snapshot_s else None,
    )
    sources = {aov.source for aov in product.aovs}

    def shoot(
        seen: _Loaded,
        camera: Camera,
        progress: Progress,
        share: Share = WHOLE,
        checkpoint: Checkpoint | None = None,
    ) -> Picture:
        spectral, show_dome = product.spectral is not None, settings.dome == "show"
        if settings.integrator != "traced":
            return integrate(
                seen.device_scene,
                camera,
                product.resolution,
                settings.samples_per_pixel,
                settings.pixel_filter,
                workers,
                progress,
                spectral=spectral,
                show_dome=show_dome,
                checkpoint=checkpoint,
                share=share,
            )
        return integrate_traced(
            seen.device_scene,
            trace_lights(seen.scene.lights, seen.light, seen.scene.frame, workers.device),
            camera,
            product.resolution,
            Sampling(
                samples=settings.samples_per_pixel,
                # A mean's error falls with the root of the count of what it is the mean of.
                target_error=settings.target_error * math.sqrt(share.count),
                floor=ERROR_FLOOR * float(white[1]),
                pixel_filter=settings.pixel_filter,
                key=sampling_key(settings.seed, frame.number),
                share=share,
            ),
            workers,
            progress,
            spectral=spectral,
            show_dome=show_dome,
            parts=bool(sources & set(TRACED_SOURCES)),
            checkpoint=checkpoint,
        )

    if exposure is None:
        picture = shoot(loaded, camera, progress, checkpoint=checkpoint)
    else:
        if overrides.resume or overrides.snapshot_s:
            report.notes.append(unkept_note(checkpoint.path))
        whole = SharedProgress(progress, len(exposure.cameras))
        before = sum(seconds.values())

        def moments() -> Iterator[Picture]:
            for share, time, seen_from in exposure.shares():
                seen = loaded
                if exposure.scene_moves:
                    seen = loader.load(time, keep=False)
                    report.notes.extend(topology_notes(scene.meshes, seen.scene.meshes))
                yield shoot(seen, seen_from, whole, share)

        picture = mean_picture(moments(), len(exposure.cameras))
        begun += sum(seconds.values()) - before  # reading scenes is counted as such
    data = (
        collect_data(
            device_scene, camera, product.resolution, workers, irradiance="irradiance" in sources
        )
        if sources - set(TRACED_SOURCES) - set(MATTES)
        else {}
    )
    if sources & set(MATTES):
        data |= collect_mattes(
            device_scene,
            camera,
            product.resolution,
            settings.samples_per_pixel,
            settings.pixel_filter,
            matte_names(shot),
            workers,
        )
    begun = _lap(seconds, "render", begun)
    report.paths.extend(
        write_picture(product, files, picture, data, device_scene, camera, settings, shot)
    )
    checkpoint.remove()
    _lap(seconds, "write", begun)


def _lap(seconds: dict[str, float], part: str, begun: float) -> float:
    now = clock.perf_counter()
    seconds[part] = seconds.get(part, 0.0) + now - begun
    return now
