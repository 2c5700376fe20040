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
"""Side of the blocks of pixels whose light is judged together [px]."""

TYPICAL_NOISE = 0.1
"""Standard deviation of one sample, relative to its pixel, from which on a pixel is held to the
target error; quieter ones are held to less, by the root of their noise over this."""

EDGES = 0.6
"""Squared error of a mean across an edge, of camera samples that lie in a lattice, times count^1.5,
over the variance of the samples: 0.53 to 0.71 for straight edges and 8 to 128 samples."""

SURE = 64
"""Samples from which on a pixel's neighbours do not say that it may have an edge, too."""

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
        self.edges = np.zeros(count)
        self._spread = np.zeros(count)
        self._torn = np.zeros(count)

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
        light, ``edges`` that of what the places of the camera samples find.
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
        first, second, plain, squares = self._trace.luminance.numpy()[active].astype(float).T
        cameras, split = len(each.offsets), each.split
        half = cameras * (split // 2) if split > 1 else (cameras + 1) // 2
        rest = each.count - half
        self._taken[active] += each.weight * each.count
        apart = first / half - second / max(rest, 1)
        self._spread[active] += each.weight**2 * half * rest * apart**2
        between = np.maximum(squares - plain**2 / cameras, 0.0) / max(cameras - 1, 1)
        self._torn[active] += EDGES * each.weight**2 * np.sqrt(cameras) * between
        self.variance[active] = self._spread[active] / self._taken[active] ** 2
        self.edges[active] = self._torn[active] / self._taken[active] ** 2

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
    """Return the pixels whose error is still above the target.

    Light is judged by blocks: the noise of few samples says little of a pixel. Edges are judged by
    pixels, and at first by their neighbours in the block, since few samples may have missed them.

    The error of a picture falls most where samples go in proportion to noise, not to its square as
    they would if all blocks were held to one error. So quieter blocks, whose samples are few, are
    held to less than the target.
    """
    if settings.target_error <= 0.0:
        return active
    block, count = _blocks(tile.count, width)
    mean = tile.mean
    shown = np.maximum(np.bincount(block, mean != 0.0, count), 1.0)
    level = np.maximum(np.bincount(block, mean, count) / shown, settings.floor)
    allowed = settings.target_error**2 * np.sqrt(taken) / TYPICAL_NOISE
    allowed = (min(allowed, settings.target_error) * level) ** 2
    noisy = np.bincount(block, tile.variance, count) / shown > allowed
    edge = tile.edges > allowed[block]
    if taken < SURE:
        edge = _beside(edge, width)
    keep = (noisy[block] & (mean != 0.0)) | edge
    return np.asarray(active[keep[active]])


def _blocks(pixel_count: int, width: int) -> tuple[NDArray[np.int64], int]:
    """Return the block of every pixel of a tile, and how many there are."""
    row, column = np.divmod(np.arange(pixel_count), width)
    across = -(-width // BLOCK)
    block = row // BLOCK * across + column // BLOCK
    return block, int(block[-1]) + 1


def _beside(chosen: NDArray[np.bool_], width: int) -> NDArray[np.bool_]:
    """Return the chosen pixels of a tile and their neighbours in the same block."""
    found = chosen.reshape(-1, width)
    for axis in (0, 1):
        before = np.roll(found, 1, axis)
        after = np.roll(found, -1, axis)
        place = np.arange(found.shape[axis])
        place = place[:, None] if axis == 0 else place[None]
        before &= place % BLOCK > 0
        after &= (place % BLOCK < BLOCK - 1) & (place < found.shape[axis] - 1)
        found = found | before | after
    return np.asarray(found.ravel())
