"""Render a stage: one picture per product and frame.

Reads:  any stage.
Writes: the files its products name (``usdskin.render.outputs``); nothing of the stage.

What not every picture needs is imported where it is needed: Warp parses each kernel it is given.
"""

from __future__ import annotations

import math
import time as clock
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers, open_workers
from usdskin.errors import FramesError, ImageError, UsdSkinError
from usdskin.frames import frame_path
from usdskin.images import read_headers
from usdskin.notes import Note
from usdskin.progress import Progress
from usdskin.render.aovs import MATTES, TRACED_SOURCES
from usdskin.render.cameras import Camera, read_camera
from usdskin.render.changes import EVERYTHING, find_changes
from usdskin.render.checkpoint import KEEP_EVERY_S, Checkpoint, fingerprint, partial_path
from usdskin.render.frame_cache import FrameCache
from usdskin.render.frame_writer import FrameWriter
from usdskin.render.integrate import (
    WHOLE,
    Picture,
    Share,
    integrate,
    picture_kernels,
)
from usdskin.render.job import Frame, RenderJob, RenderReport
from usdskin.render.loading import Loaded, Loader
from usdskin.render.motion import (
    Exposure,
    SharedProgress,
    find_exposure,
    mean_picture,
    topology_notes,
    unkept_note,
)
from usdskin.render.opening import opened
from usdskin.render.outputs import Shot, matte_names, output_notes, previewing, write_picture
from usdskin.render.overrides import RenderOverrides
from usdskin.render.products import Product, prepare_folders
from usdskin.render.settings import resolve_settings
from usdskin.render.traced_passes import Sampling, sampling_key

# isort: split
# After ours, which register the schemas.
from pxr import Usd

ERROR_FLOOR = 0.2
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
    skipped = 0
    with opened(stage_path, overrides, report.notes) as stage:
        job = resolve_settings(stage, overrides, output, report.notes)
        files = [file for product in job.products for file in product.files]
        prepare_folders(files, stage_path)
        cache = FrameCache(find_changes(stage) if len(job.frames) > 1 else EVERYTHING)
        workers = open_workers(job.settings.device, job.settings.threads)
        loader = Loader(stage, job.settings, workers, report, cache)
        _lap(report.seconds, "open", begun)

        def failed(number: float | None, reason: str) -> None:
            report.failures[f"{number:g}"] = reason

        try:
            with FrameWriter(None if len(job.frames) == 1 else failed) as writer:
                for frame in job.frames:
                    try:
                        skipped += not _render_frame(
                            stage, job, frame, loader, workers, progress, report, writer
                        )
                    except UsdSkinError as error:
                        loader.forget()
                        writer.settle()  # the frame before comes first
                        if len(job.frames) == 1:
                            raise
                        failed(frame.number, str(error))
        finally:
            compilation.abandon()
    if report.failures and len(report.failures) == len(job.frames):
        number, reason = next(iter(report.failures.items()))
        raise FramesError(f"every frame failed; the first, {number}: {reason}")
    if skipped:
        report.notes.append(_skipped_note(skipped, job))
    _drop_repeated(report.notes)
    return report


def _skipped_note(count: int, job: RenderJob) -> Note:
    there = f"{count} frame was" if count == 1 else f"{count} frames were"
    message = f"{there} there already and stay (--skip-existing)."
    return Note("frames-skipped", str(job.products[0].files[0]), message)


def _drop_repeated(notes: list[Note]) -> None:
    """Keep one of each note: every frame and product finds the same."""
    notes[:] = dict.fromkeys(notes)


def _render_frame(
    stage: Usd.Stage,
    job: RenderJob,
    frame: Frame,
    loader: Loader,
    workers: Workers,
    progress: Progress,
    report: RenderReport,
    writer: FrameWriter,
) -> bool:
    """Render what is still to be written of a frame; return whether there was anything."""
    wanted = [(product, _files(product, frame, job)) for product in job.products]
    wanted = [(product, files) for product, files in wanted if files]
    if not wanted:
        return False
    sources = {aov.source for product, _ in wanted for aov in product.aovs}
    compilation.begin(
        picture_kernels(workers.device, sources, job.settings.integrator == "traced"),
        workers.device,
        progress,
    )
    exposures = [
        find_exposure(stage, product, frame, job.settings, report.notes) for product, _ in wanted
    ]
    for (product, files), exposure in zip(wanted, exposures, strict=True):
        moved = exposure is not None and exposure.scene_moves
        time = exposure.middle if exposure and moved else frame.time
        loaded = loader.load(time, frame.time)
        _render_product(
            stage, job, frame, product, files, loaded, loader, exposure, workers, progress, report,
            writer,
        )  # fmt: skip
    return True


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
    there = all(_is_picture(path) for path in files.values())
    return {} if there and not unfinished else files


def _is_picture(path: Path) -> bool:
    """Return whether a file is there and opens: a copy that broke off may leave an empty one."""
    try:
        return bool(read_headers(path))
    except ImageError:
        return False


def _render_product(
    stage: Usd.Stage,
    job: RenderJob,
    frame: Frame,
    product: Product,
    files: dict[str, Path],
    loaded: Loaded,
    loader: Loader,
    exposure: Exposure | None,
    workers: Workers,
    progress: Progress,
    report: RenderReport,
    writer: FrameWriter,
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
    white = loaded.white
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
        seen: Loaded,
        camera: Camera,
        progress: Progress,
        share: Share = WHOLE,
        checkpoint: Checkpoint | None = None,
    ) -> Picture:
        spectral, show_dome = product.spectral is not None, settings.dome == "show"
        if seen.traced is None:
            faces = loader.first_faces(seen, camera, product, share)
            loader.light_shadows(seen, faces)
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
                faces=faces,
            )
        from usdskin.render.traced import integrate_traced

        return integrate_traced(
            seen.device_scene,
            seen.traced,
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

    before = _loading(seconds)
    if exposure is None:
        picture = shoot(loaded, camera, progress, checkpoint=checkpoint)
    else:
        if overrides.resume or overrides.snapshot_s:
            report.notes.append(unkept_note(checkpoint.path))
        whole = SharedProgress(progress, len(exposure.cameras))

        def moments() -> Iterator[Picture]:
            for share, time, seen_from in exposure.shares():
                seen = loaded
                if exposure.scene_moves:
                    seen = loader.load(time, frame.time, keep=False)
                    report.notes.extend(topology_notes(scene.meshes, seen.scene.meshes))
                yield shoot(seen, seen_from, whole, share)

        picture = mean_picture(moments(), len(exposure.cameras))
    report.notes.extend(output_notes(picture, files, product))
    data: dict[str, NDArray[Any]] = {}
    if sources - set(TRACED_SOURCES) - set(MATTES):
        if "irradiance" in sources:
            loader.light_shadows(loaded)
        from usdskin.render.pixel_data import collect_data

        data |= collect_data(
            device_scene, camera, product.resolution, workers, irradiance="irradiance" in sources
        )
    if sources & set(MATTES):
        from usdskin.render.cryptomatte import collect_mattes

        data |= collect_mattes(
            device_scene,
            camera,
            product.resolution,
            settings.samples_per_pixel,
            settings.pixel_filter,
            matte_names(shot),
            workers,
        )
    begun += _loading(seconds) - before  # counted as such
    _lap(seconds, "render", begun)
    faces = replace(device_scene, keep=())  # what is drawn next need not share the memory

    def write() -> None:
        begun = clock.perf_counter()
        report.paths.extend(
            write_picture(
                product, files, picture, data, faces, camera, settings, shot, report.notes
            )
        )
        checkpoint.remove()
        _lap(seconds, "write", begun)

    arrays = (picture.xyza, picture.spectrum, *picture.extra.values(), *data.values())
    writer.put(frame.number, sum(each.nbytes for each in arrays if each is not None), write)


def _loading(seconds: dict[str, float]) -> float:
    """Return the time that the loader took, of all frames so far [s]."""
    return sum(seconds.get(part, 0.0) for part in ("read", "bake", "shadows", "compile"))


def _lap(seconds: dict[str, float], part: str, begun: float) -> float:
    now = clock.perf_counter()
    seconds[part] = seconds.get(part, 0.0) + now - begun
    return now
