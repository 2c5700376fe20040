"""One tile of a traced picture under construction."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.render.integrate import DeviceScene
from usdskin.render.light_guide import LightParts
from usdskin.render.traced_lights import TracedLights
from usdskin.render.traced_passes import Pass, Sampling
from usdskin.warp_kernels import structs, trace, trace_guide, trace_structs

BLOCK = 4
"""Side of the blocks of pixels that are sampled alike [px]."""

TYPICAL_NOISE = 0.1
"""Standard deviation of one sample, relative to its pixel, from which on a pixel is held to the
target error; quieter ones are held to less, by the root of their noise over this."""

EDGES = 0.25
"""Share of the squared distance of two halves of a pass that is counted as error where it comes
from edges: the halves lie between one another, so that together they err less."""

PARTS = ("diffuse", "specular", "emission", "indirect")
"""What the light of a pixel is split into, in the kernels' order."""


class Tile:
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
        facing = np.tile(np.array([0.0, 0.0, 0.0, -1.0], np.float32), (count, 1))
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

    def add(self, each: Pass, active: NDArray[np.int32], face: Any) -> None:
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


def unfinished(
    tile: Tile, active: NDArray[np.int32], width: int, settings: Sampling, taken: int
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
