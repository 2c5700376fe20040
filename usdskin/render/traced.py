"""The traced integrator: shadowed pictures, sampled until they are good enough.

Makes: ``Picture`` from a ``DeviceScene`` and its light tree. A pixel's samples depend on the pixel,
their index, the seed and the frame alone; how many it gets is decided by blocks of pixels that lie
in one tile. So the picture is the same whatever the tiles, threads or their order.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers
from usdskin.progress import Progress
from usdskin.render.cameras import Camera
from usdskin.render.checkpoint import Checkpoint, keeping
from usdskin.render.integrate import (
    GPU_TILE_PIXELS,
    TILE_PIXELS,
    DeviceScene,
    Picture,
    device_camera,
)
from usdskin.render.projection import project
from usdskin.render.surfaces import band_groups
from usdskin.render.traced_lights import TracedLights
from usdskin.render.traced_passes import FIRST_SAMPLES, Sampling, list_passes
from usdskin.render.traced_tile import PARTS, Tile, unfinished
from usdskin.warp_kernels import raster, sampling, trace, trace_guide


def integrate_traced(
    scene: DeviceScene,
    lights: TracedLights,
    camera: Camera,
    resolution: tuple[int, int],
    settings: Sampling,
    workers: Workers,
    progress: Progress,
    *,
    spectral: bool,
    show_dome: bool,
    parts: bool,
    checkpoint: Checkpoint | None = None,
) -> Picture:
    """Render a shadowed picture.

    Args:
        scene: The scene on the workers' device.
        lights: What its rays go to.
        camera: Where from.
        resolution: Width and height [px].
        settings: How to sample.
        workers: Where to compute.
        progress: Advances by pixels.
        spectral: Whether to return spectra.
        show_dome: Whether the domes are seen behind the surfaces.
        parts: Whether to return the light's parts, the variance and the like (``Picture.extra``).
        checkpoint: Keeps what is finished; None keeps nothing.
    """
    width, height = resolution
    device = workers.device
    on_host = device == "cpu"
    rays = device_camera(camera, resolution)
    bands = band_groups(scene.band_count if spectral else 0)
    count = width * height
    result: dict[str, NDArray[Any]] = {
        "xyza": np.zeros((count, 4), np.float32),
        "spectrum": np.zeros((count, bands, 4), np.float32),
        "tally": np.zeros((count, 4), np.float32),
        "variance": np.zeros(count, np.float32),
        "part": np.zeros((count if parts else 0, len(PARTS), 3), np.float32),
    }
    rows = _tile_rows(width, height, TILE_PIXELS if on_host else GPU_TILE_PIXELS)
    learns = lights.parts.tops > 1 and not scene.lights.links.active
    passes = list_passes(settings, device, sharp=camera.lens_radius <= 0.0, learns=learns)
    sobol = wp.array(sampling.direction_numbers(), dtype=wp.uint32, device=device)
    projection = None
    if on_host and camera.lens_radius <= 0.0:
        compilation.load(raster, device)
        reach = max(float(np.abs(each.offsets.numpy()).max()) for each in passes)
        projection = project(
            scene.faces.points, scene.faces.triangles, camera, resolution, rows, reach, device
        )
    compilation.load(trace, device)

    def work(begin: int, end: int) -> None:
        if tiles.restored(begin, end):
            return
        tile = Tile(scene, rays, lights, sobol, settings, begin, end, bands, parts, device)
        tile.film.show_dome = int(show_dome)
        active = np.arange(end - begin, dtype=np.int32)
        if passes[0].weight != 1.0:
            tile.guide(lights.parts, width)
            active = active[np.argsort(tile.block, kind="stable")]
        for each in passes:
            face = None
            if projection is not None:
                first = begin // width
                face = raster.rasterize_band(
                    projection, each.offsets, first // rows, width, first, (end - begin) // width,
                    active,
                )  # fmt: skip
            tile.add(each, active, face)
            taken = each.first + each.count - passes[0].first
            if taken >= FIRST_SAMPLES:
                active = unfinished(tile, active, width, settings, taken)
                if not len(active):
                    break
            tile.learn(active)
        for name, values in tile.finished().items():
            result[name][begin:end] = values
        tiles.finished(begin, end)

    progress.start(count, "render")
    with keeping(checkpoint, result) as tiles:
        workers.run(count, rows * width, work, progress.advance)
    progress.done()
    xyza = result["xyza"].reshape(height, width, 4)
    spectrum = None
    if spectral:
        spectrum = result["spectrum"].reshape(height, width, -1)[:, :, : scene.band_count]
    if not parts:
        return Picture(xyza, spectrum)
    tally = result["tally"].reshape(height, width, 4)
    unshadowed = tally[:, :, 1] / np.maximum(tally[:, :, 3], 1.0)
    return Picture(xyza, spectrum, _extra(result, xyza, (height, width)), unshadowed)


def _tile_rows(width: int, height: int, pixels: int) -> int:
    """Return the rows of a tile: whole blocks."""
    side = int(trace_guide.SIDE)
    rows = max(side, pixels // width // side * side)
    return min(rows, -(-height // side) * side)


def _extra(
    result: dict[str, NDArray[Any]],
    xyza: NDArray[Any],
    shape: tuple[int, int],
) -> dict[str, NDArray[np.float32]]:
    """Return the parts and measures of a picture by their names."""
    parts = result["part"].reshape(*shape, len(PARTS), 3)
    tally = result["tally"]
    whole = np.where(tally[:, 1] > 0.0, tally[:, 1], 1.0)
    visibility = np.where(tally[:, 1] > 0.0, 1.0 + tally[:, 2] / whole, 0.0)
    extra = {name: parts[:, :, k] for k, name in enumerate(PARTS)}
    extra["direct"] = xyza[:, :, :3] - extra["indirect"]
    extra["variance"] = result["variance"].reshape(shape)
    extra["sampleCount"] = tally[:, 3].reshape(shape)
    extra["visibility"] = np.clip(visibility, 0.0, 1.0).reshape(shape)
    return {name: np.asarray(values, np.float32) for name, values in extra.items()}
