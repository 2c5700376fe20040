"""The traced integrator: shadowed pictures, sampled until they are good enough.

Makes: ``Picture`` from a ``DeviceScene`` and its light tree. A pixel's samples depend on the pixel,
their index, the seed and the frame alone; how many it gets is decided by blocks of pixels that lie
in one tile. So the picture is the same whatever the tiles, threads or their order.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers, copied, vec4
from usdskin.progress import Progress
from usdskin.render.cameras import Camera
from usdskin.render.checkpoint import Checkpoint, keeping
from usdskin.render.film import sample_offsets
from usdskin.render.integrate import (
    GPU_TILE_PIXELS,
    TILE_PIXELS,
    WHOLE,
    DeviceScene,
    Picture,
    Share,
    device_camera,
)
from usdskin.render.light_guide import LightParts, light_parts, turned_parts
from usdskin.render.light_maps import LightField, luminances
from usdskin.render.light_tree import build_light_tree
from usdskin.render.lights import Lights
from usdskin.render.projection import project
from usdskin.render.surface_rows import SpectralFrame
from usdskin.render.surfaces import band_groups
from usdskin.warp_kernels import (
    light_tree,
    local_lights,
    raster,
    sampling,
    structs,
    trace,
    trace_guide,
    trace_structs,
)

BLOCK = 4
"""Side of the blocks of pixels that are sampled alike [px]."""

FIRST_SAMPLES = 16
"""Samples every pixel gets before any of them is judged."""

SPLIT_CAMERAS = 4
"""Least camera samples of a pass that takes several directions of light for each."""

TYPICAL_NOISE = 0.1
"""Standard deviation of one sample, relative to its pixel, from which on a pixel is held to the
target error; quieter ones are held to less, by the root of their noise over this."""

EDGES = 0.25
"""Share of the squared distance of two halves of a pass that is counted as error where it comes
from edges: the halves lie between one another, so that together they err less."""

LARGEST_SPLIT = 4
"""Most directions of light for one camera sample: a surface point costs a fourth of a direction."""

LEARNING = 4
"""Of these, samples from which blocks of pixels learn what they see."""

LEARNING_WEIGHT = 0.25
"""Weight of what they change; the rest of the first samples makes up for it."""

PARTS = ("diffuse", "specular", "emission", "indirect")
"""What the light of a pixel is split into, in the kernels' order."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sampling:
    """How a picture is sampled."""

    samples: int
    """Most samples per pixel."""

    target_error: float
    """Standard error of a pixel's Y, relative to it, at which its sampling stops; 0 for never."""

    floor: float
    """Y below which errors count as if the pixel were this bright."""

    pixel_filter: str
    key: int
    """Of the seed and the frame."""

    share: Share = WHOLE
    """Which of the samples to take."""


@dataclass(frozen=True, slots=True)
class _Pass:
    """Some samples of every pixel that takes part."""

    first: int
    """Index of the first direction of light in every pixel's sequence."""

    first_camera: int
    """Index of the first camera sample."""

    offsets: Any
    """Positions of the camera samples [px], on the device."""

    split: int
    """Directions of light that each of them takes."""

    weight: float = 1.0
    """Weight of what they change."""

    @property
    def count(self) -> int:
        """Directions of light that a pixel takes."""
        return len(self.offsets) * self.split


@dataclass(frozen=True, slots=True, eq=False)
class TracedLights:
    """What rays are sent to."""

    tree: light_tree.LightTree
    """Domes and distant lights."""

    local: local_lights.LocalLights
    """Lights that have a place."""

    first_local: int
    """Number of the first of them in the light links."""

    parts: LightParts
    """What blocks of pixels learn of the tree's light."""

    upright: NDArray[np.float32] | None
    """Cones of the tree's nodes in the frame of the only dome, shape [node_count, 4]; None where
    there are other lights, or domes, which need not turn with it."""


def trace_lights(
    lights: Lights, field: LightField, frame: SpectralFrame, device: str
) -> TracedLights:
    """Prepare the lights of a scene for tracing.

    Args:
        lights: The lights.
        field: Their channels, local lights included.
        frame: Weighs the channels by how bright they look.
        device: Where to.
    """
    if field.local is None:
        raise ValueError("the light field was built without its local lights")
    first = len(lights.domes) + len(lights.distants)
    is_alone = first == len(lights.domes) == 1
    built = lights
    if is_alone:
        built = replace(lights, domes=(replace(lights.domes[0], to_world=np.eye(3)),))
    tree = build_light_tree(built, luminances(field, frame), device)
    upright = tree.node_cone.numpy() if is_alone else None
    parts = light_parts(built, tree, field.device_lights.group_count, device)
    found = TracedLights(tree, field.local.device_lights, first, parts, upright)
    return turn_traced_lights(found, lights, device) or found


def turn_traced_lights(found: TracedLights, lights: Lights, device: str) -> TracedLights | None:
    """Return lights whose only dome has been turned.

    Args:
        found: Prepared lights.
        lights: The lights as they are turned now.
        device: Where to.

    Returns:
        The lights, sharing arrays with ``found``; None where the tree has to be built anew.
    """
    if found.upright is None:
        return None
    to_world = lights.domes[0].to_world
    tree = copied(found.tree, light_tree.LightTree)
    cones = found.upright.copy()
    cones[:, :3] = found.upright[:, :3] @ to_world.T
    tree.node_cone = vec4(cones, device)
    turns = to_world.astype(np.float32)[None]
    tree.dome_to_world = wp.array(turns, dtype=wp.mat33f, device=device)
    return replace(found, tree=tree, parts=turned_parts(found.parts, to_world, device))


def sampling_key(seed: int, frame: float | None) -> int:
    """Return the key of a picture's random numbers, 32 bits that differ for every frame."""
    label = f"{seed}" if frame is None else f"{seed}/{frame:.6f}"
    return int.from_bytes(hashlib.sha256(label.encode()).digest()[:4], "little")


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
    passes = _passes(settings, device, sharp=camera.lens_radius <= 0.0, learns=learns)
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
        tile = _Tile(scene, rays, lights, sobol, settings, begin, end, bands, parts, device)
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
                    projection, each.offsets, first // rows, width, first, (end - begin) // width
                )
            tile.add(each, active, face)
            taken = each.first + each.count - passes[0].first
            if taken >= FIRST_SAMPLES:
                active = _unfinished(tile, active, width, settings, taken)
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


def _passes(settings: Sampling, device: str, *, sharp: bool, learns: bool) -> list[_Pass]:
    """Return the passes: the first samples, and then as many as there are before.

    Later passes of a ``sharp`` picture take several directions of light for each camera sample:
    what is noisy is the light. Every pass has its own camera samples. Where blocks of pixels
    ``learn``, the first samples are two passes: that to learn from weighs little, and the other
    makes up for it. The two halves of a pass are evenly spread over the pixel.
    """
    samples, begin = settings.share.size(settings.samples), settings.share.first(settings.samples)
    first = min(samples, FIRST_SAMPLES)
    moved = 16 * settings.share.index  # more than there are passes
    offsets = sample_offsets(first, settings.pixel_filter, _shift(moved))
    found = [(0, 0, offsets, 1, 1.0)]
    if learns and first == FIRST_SAMPLES:
        rest = first - LEARNING
        late = (first - LEARNING_WEIGHT * LEARNING) / rest
        early = np.arange(first) % (first // LEARNING) == 0
        found = [
            (0, 0, offsets[early], 1, LEARNING_WEIGHT),
            (LEARNING, LEARNING, offsets[~early], 1, late),
        ]
    taken = cameras_taken = first
    while taken < samples:
        more = min(taken, samples - taken)
        split = min(LARGEST_SPLIT, max(1, more // SPLIT_CAMERAS)) if sharp else 1
        cameras = max(1, more // split)
        shift = _shift(moved + len(found))
        offsets = sample_offsets(cameras, settings.pixel_filter, shift)
        found.append((taken, cameras_taken, offsets, split, 1.0))
        taken += cameras * split
        cameras_taken += cameras
    return [
        _Pass(
            begin + at_sample,
            begin + at_camera,
            wp.array(np.concatenate([at[0::2], at[1::2]]), dtype=wp.vec2f, device=device),
            split,
            weight,
        )
        for at_sample, at_camera, at, split, weight in found
        if len(at)
    ]


def _shift(number: int) -> tuple[float, float]:
    return 0.754877666 * number % 1.0, 0.569840290 * number % 1.0


class _Tile:
    """One tile under construction."""

    def __init__(
        self,
        scene: DeviceScene,
        rays: structs.CameraRays,
        lights: TracedLights,
        sobol: Any,
        settings: Sampling,
        begin: int,
        end: int,
        bands: int,
        parts: bool,
        device: str,
    ) -> None:
        count = end - begin
        self._scene, self._rays, self._device = scene, rays, device
        self.first_pixel = begin
        self.count = count
        film = structs.Film()
        film.first_pixel = begin
        film.channel = wp.zeros((count, scene.max_rows), dtype=wp.vec4f, device=device)
        film.xyza = wp.zeros(count, dtype=wp.vec4f, device=device)
        film.spectrum = wp.zeros((count, bands), dtype=wp.vec4f, device=device)
        self.film = film
        self._trace = trace_structs.Trace()
        self._trace.tree = lights.tree
        self._trace.local = lights.local
        self._trace.first_local = lights.first_local
        self._trace.sobol = sobol
        self._trace.key = settings.key
        shape = (count, len(PARTS)) if parts else (0, 0)
        self._trace.part = wp.zeros(shape, dtype=wp.vec3f, device=device)
        self._trace.tally = wp.zeros(count, dtype=wp.vec4f, device=device)
        self._lights = lights
        self.block = np.zeros(0, np.int64)
        self._trace.luminance = wp.zeros(count, dtype=wp.vec4f, device=device)
        self.variance = np.zeros(count)
        self._taken = np.zeros(count)
        self.doubt = np.zeros(count)
        self._spread = np.zeros((count, 2))

    def guide(self, parts: LightParts, width: int) -> None:
        """Have blocks of pixels learn what they see; ``block`` is each pixel's."""
        side, device, count = int(trace_guide.SIDE), self._device, self.count
        across = -(-width // side)
        row, column = np.divmod(np.arange(count), width)
        self.block = row // side * across + column // side
        blocks, held = int(self.block[-1]) // across * across + across, len(parts.node)
        groups = self._scene.lights.group_count
        guide = trace_guide.Guide()
        guide.tops, guide.part_node, guide.leaf_part = parts.tops, parts.node, parts.leaf_part
        guide.moment, guide.width, guide.across = parts.moment, width, across
        facing = np.tile(np.float32([0.0, 0.0, 0.0, -1.0]), (count, 1))
        guide.facing = wp.array(facing, dtype=wp.vec4f, device=device)
        guide.glossy = wp.zeros(count, dtype=wp.int32, device=device)
        guide.seen = wp.zeros((blocks, held, 3), dtype=wp.int32, device=device)
        guide.sums = wp.zeros((blocks, parts.tops, 3), dtype=wp.float32, device=device)
        guide.cone = wp.full(blocks, wp.vec4f(0.0, 0.0, 0.0, -1.0), dtype=wp.vec4f, device=device)
        guide.kernel = wp.zeros(blocks, dtype=wp.vec2f, device=device)
        guide.cumulative = wp.zeros((blocks, held), dtype=wp.float32, device=device)
        guide.known = wp.zeros((blocks, held), dtype=wp.float32, device=device)
        guide.given = wp.ones(blocks, dtype=wp.float32, device=device)
        guide.change = wp.zeros((blocks, 4 * groups), dtype=wp.vec4f, device=device)
        guide.changes = wp.zeros(blocks, dtype=wp.int32, device=device)
        self._trace.guide = guide

    @property
    def mean(self) -> NDArray[np.float64]:
        """Y of every pixel so far."""
        tally = self._trace.tally.numpy()
        return np.asarray(tally[:, 0] / np.maximum(tally[:, 3], 1.0), np.float64)

    def add(self, each: _Pass, active: NDArray[np.int32], face: Any) -> None:
        """Take a pass of samples of some pixels, and judge the variance of their means.

        A pass's two halves are as far apart as its noise makes them. ``variance`` is that of the
        light; ``doubt`` holds what the places of the camera samples make of edges, too.
        """
        film, device = self.film, self._device
        film.sample = each.offsets
        film.face = wp.empty((0, 0), dtype=wp.int32, device=device) if face is None else face
        self._trace.first_sample, self._trace.split = each.first, each.split
        self._trace.first_camera, self._trace.weight = each.first_camera, each.weight
        self._trace.pixel = wp.array(active, dtype=wp.int32, device=device)
        trace.trace_pass(
            self._scene.geometry, self._rays, self._scene.lights, self._scene.materials,
            self._trace, film,
        )  # fmt: skip
        sums = self._trace.luminance.numpy()[active].astype(np.float64)
        cameras, split = len(each.offsets), each.split
        first = (cameras + 1) // 2
        shares = [first * split, (cameras - first) * split]
        noisy = [cameras * (split // 2), cameras * (split - split // 2)] if split > 1 else shares
        self._taken[active] += each.weight * each.count
        for k, counts in enumerate((noisy, shares)):
            first_mean, second_mean = (sums[:, 2 * k + j] / max(counts[j], 1) for j in range(2))
            self._spread[active, k] += (
                each.weight**2 * counts[0] * counts[1] * (first_mean - second_mean) ** 2
            )
        spread = self._spread[active] / self._taken[active, None] ** 2
        self.variance[active] = spread[:, 0]
        self.doubt[active] = np.maximum(spread[:, 0], EDGES * spread[:, 1])

    def learn(self, active: NDArray[np.int32]) -> None:
        """Have the blocks of some pixels know what they have counted so far."""
        if len(self.block):
            blocks = wp.array(np.unique(self.block[active]), dtype=wp.int32, device=self._device)
            trace.learn(self._lights.tree, blocks, self._trace.guide)

    def finished(self) -> dict[str, NDArray[Any]]:
        """Return the tile's means and variances, and its tally."""
        tally = self._trace.tally.numpy()
        taken = np.maximum(tally[:, 3:], 1.0)
        found = {
            "xyza": self.film.xyza.numpy() / taken,
            "spectrum": self.film.spectrum.numpy() / taken[:, :, None],
            "tally": tally,
            "variance": self.variance,
        }
        if self._trace.part.shape[0]:
            found["part"] = self._trace.part.numpy() / taken[:, :, None]
        return found


def _unfinished(
    tile: _Tile, active: NDArray[np.int32], width: int, settings: Sampling, taken: int
) -> NDArray[np.int32]:
    """Return the pixels of the blocks whose error is still above the target.

    The error of a picture falls most where samples go in proportion to noise, not to its square as
    they would if all blocks were held to one error. So quieter blocks, whose samples are few, are
    held to less than the target.
    """
    if settings.target_error <= 0.0:
        return active
    owner = _blocks(active, width)
    sizes = np.bincount(owner)
    variance = np.bincount(owner, tile.doubt[active]) / sizes
    level = np.maximum(np.bincount(owner, tile.mean[active]) / sizes, settings.floor)
    allowed = settings.target_error**2 * np.sqrt(taken) / TYPICAL_NOISE
    allowed = min(allowed, settings.target_error)
    keep = variance > (allowed * level) ** 2
    return np.asarray(active[keep[owner]])


def _blocks(active: NDArray[np.int32], width: int) -> NDArray[np.int64]:
    """Return the block of every pixel, counted from 0."""
    row, column = active // width, active % width
    block = row // BLOCK * (-(-width // BLOCK)) + column // BLOCK
    return np.asarray(np.unique(block, return_inverse=True)[1])


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
