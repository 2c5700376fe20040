"""Baked shadows in a picture: measurements of a stage, under the light of a frame.

Reads: ``Transfers``, copied to a device once (``upload_transfers``), and ``Lights``. Makes:
``LitTransfers``: what each vertex's diffuse light lacks, once per light and where a picture shows
it, and the map integrator adds it to what its maps give. A camera costs nothing.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers, vec3, vec4
from usdskin.latlong import latlong_directions, texel_directions, texel_solid_angles
from usdskin.render.environment import group_count, refined
from usdskin.render.integrate import DeviceScene
from usdskin.render.light_maps import LightField
from usdskin.render.lights import DomeLight, Lights
from usdskin.render.transfer import Transfers
from usdskin.render.transfer_sphere import BYTE, WORD, TransferSphere
from usdskin.render.uploading import is_solid
from usdskin.warp_kernels import transfer_gather, transfer_structs

_PROJECTED_ROWS = 128
"""Rows of the picture that a dome is averaged to before it is spread over the directions."""

_CHUNK = 1024
"""Vertices of one launch."""


@dataclass(frozen=True, slots=True, eq=False)
class DeviceTransfers:
    """The same on a device."""

    sphere: TransferSphere
    directions: transfer_structs.Directions
    measured: transfer_structs.Measured
    vertices: transfer_structs.Vertices
    corner_vertex: wp.array
    """Vertex of every corner, -1 where there is none, shape [3 triangle_count]."""

    material: NDArray[np.int32]
    """Material of each vertex, shape [vertex_count]."""

    hidden: wp.array
    """A bit per direction that no reflection comes from, shape [place_count, word_count]."""

    averaged: dict[str, AveragedDome] = field(default_factory=dict)
    """Of the domes of the last light, by path."""


@dataclass(frozen=True, slots=True, eq=False)
class AveragedDome:
    """A dome's light without its strong lamps in blocks of texels, whichever way it is turned."""

    coefficients: NDArray[np.float32]
    blocks: NDArray[np.int64]
    """What it was made of."""

    light: NDArray[np.float64]
    """Flux of each block [coefficient sr], shape [block_count, channel_count]."""

    toward: NDArray[np.float64]
    """Direction of each in the frame of the dome, shape [block_count, 3]."""


def upload_transfers(transfers: Transfers, device: str) -> DeviceTransfers:
    """Copy the baked shadows of a scene to a device."""
    measured, vertices = _device_measured(transfers, device)
    return DeviceTransfers(
        transfers.sphere,
        _device_directions(transfers.sphere, device),
        measured,
        vertices,
        wp.array(transfers.corner_vertex, dtype=wp.int32, device=device),
        transfers.material,
        wp.array(transfers.measured.hidden(), dtype=wp.uint32, device=device),
    )


@dataclass(frozen=True, slots=True, eq=False)
class LitTransfers:
    """The baked shadows of a scene under its lights, of the vertices that were asked for so far."""

    gather: Callable[[wp.array, int, int], None]
    """Lights a range of some vertices."""

    corner_vertex: NDArray[np.int64]
    """Vertex of every corner, -1 where there is none, shape [3 triangle_count]."""

    is_lit: NDArray[np.bool_]
    """Shape [vertex_count]."""

    is_opaque: bool
    """Whether no triangle lets others be seen through it."""

    workers: Workers

    def light(self, triangles: NDArray[np.bool_] | None = None) -> None:
        """Light the vertices that a picture interpolates between; those that are lit stay.

        Args:
            triangles: Which ones are the first that some sample meets, shape [triangle_count]; None
                where nobody knows, for all vertices.
        """
        wanted = ~self.is_lit
        if triangles is not None and self.is_opaque:
            seen = np.zeros(len(wanted) + 1, np.bool_)  # the last for corners without a vertex
            seen[self.corner_vertex.reshape(-1, 3)[triangles]] = True
            wanted &= seen[:-1]
        count, device = int(np.count_nonzero(wanted)), self.workers.device
        if count:
            vertices = wp.array(np.flatnonzero(wanted), dtype=wp.int32, device=device)
            self.workers.run(
                count,
                _CHUNK if device == "cpu" else count,
                lambda begin, end: self.gather(vertices, begin, end),
            )
            self.is_lit[wanted] = True


def lit_transfers(
    transfers: DeviceTransfers,
    lights: Lights,
    light: LightField,
    scene: DeviceScene,
    workers: Workers,
) -> LitTransfers:
    """Put a scene's baked shadows under its lights, for the map integrator to add.

    Args:
        transfers: The shadows.
        lights: Domes and distant lights.
        light: The same, as they were baked.
        scene: The scene on the device, baked with ``measured``; its geometry gets the shadows.
        workers: Where to compute.

    Returns:
        The shadows, of no vertex yet.
    """
    device = workers.device
    compilation.load(transfer_gather, device)
    groups = int(light.device_lights.group_count)
    flux = np.zeros((groups, len(transfers.sphere.direction), 4), np.float32)
    sets = []
    first = 0
    for dome, blocks in zip(lights.domes, light.reflected_blocks, strict=True):
        count = group_count(dome.coefficients.shape[2])
        known = transfers.averaged.get(dome.path)
        if known is None or known.coefficients is not dome.coefficients:
            known = None
        elif not np.array_equal(known.blocks, blocks):
            known = None
        known = transfers.averaged[dome.path] = known or averaged(dome, blocks)
        flux[first : first + count] = spread(known, dome, transfers.sphere)
        sets.append((first, count, len(blocks)))
        first += count
    end = light.device_lights.lamp_end.numpy()
    for _ in range(0, len(lights.distants), 4):  # wide discs are several lamps
        sets.append((first, 1, int(end[first] - (end[first - 1] if first else 0))))
        first += 1
    ranks = scene.materials.passage_rank.numpy()[transfers.material]
    columns = groups * (2 + 2 * int(ranks.max(initial=0)))
    count = len(transfers.material)
    change = wp.zeros((count, columns), dtype=wp.vec4f, device=device)
    lamps = _lamp_sets(sets, device)
    lamps.solid = int(is_solid(scene.geometry, scene.materials))
    device_flux, moment = vec4(flux, device), vec4(_moments(flux, transfers.sphere), device)

    def gather(vertices: wp.array, begin: int, end: int) -> None:
        transfer_gather.gather_light(
            light.device_lights, scene.materials, transfers.directions, transfers.measured,
            transfers.vertices, device_flux, moment, vertices, change, begin, end,
        )  # fmt: skip
        transfer_gather.gather_lamps(
            scene.geometry, light.device_lights, scene.materials, transfers.measured,
            transfers.vertices, lamps, vertices, change, begin, end,
        )  # fmt: skip

    scene.geometry.transfer_vertex = transfers.corner_vertex
    scene.geometry.transfer = change
    ring = np.insert(np.cumsum(transfers.sphere.counts), 0, 0).astype(np.int32)
    order = transfers.sphere.order.astype(np.int32)
    scene.geometry.seen_row = transfers.vertices.row
    scene.geometry.seen_hidden = transfers.hidden
    scene.geometry.seen_ring = wp.array(ring, dtype=wp.int32, device=device)
    scene.geometry.seen_order = wp.array(order, dtype=wp.int32, device=device)
    scene.geometry.seen_axes = wp.mat33f(*transfers.sphere.axes.astype(np.float32).ravel().tolist())
    corner_vertex, is_lit = transfers.corner_vertex.numpy(), np.zeros(count, np.bool_)
    return LitTransfers(gather, corner_vertex, is_lit, bool(lamps.solid), workers)


def project_dome(
    dome: DomeLight, blocks: NDArray[np.int64], sphere: TransferSphere
) -> NDArray[np.float32]:
    """Return a dome's light without its strong lamps, spread over the directions.

    Args:
        dome: The dome.
        blocks: (row, column, height, width) of the refined texels of the lamps left out, shape
            [count, 4].
        sphere: The directions, in world space.

    Returns:
        Flux [coefficient sr], shape [group_count, direction_count, 4].
    """
    return spread(averaged(dome, blocks), dome, sphere)


def averaged(dome: DomeLight, blocks: NDArray[np.int64]) -> AveragedDome:
    """Return a dome's light in blocks of texels, the lamps of ``blocks`` left out."""
    image = refined(dome.coefficients)
    height, width, channels = image.shape
    if len(blocks):
        image = image.copy()
        for row, column, rows, columns in blocks:
            image[row : row + rows, column : column + columns] = 0.0
    area = texel_solid_angles(height, width)
    step = max(1, height // _PROJECTED_ROWS)
    starts = np.arange(0, height, step), np.arange(0, width, step)
    light = image.astype(np.float32) * area[:, None, None].astype(np.float32)
    light = np.add.reduceat(np.add.reduceat(light, starts[0], axis=0), starts[1], axis=1)
    return AveragedDome(
        dome.coefficients,
        blocks,
        light.reshape(-1, channels).astype(np.float64),
        _block_directions(height, width, step).reshape(-1, 3),
    )


def spread(light: AveragedDome, dome: DomeLight, sphere: TransferSphere) -> NDArray[np.float32]:
    """Return the light of a dome, turned as it is, over the directions (``project_dome``)."""
    index, share = sphere.shares(light.toward @ dome.to_world.T)
    channels = light.light.shape[1]
    groups = group_count(channels)
    flux = np.zeros((len(sphere.direction), groups * 4))
    for k in range(channels):
        weight = (share * light.light[:, k : k + 1]).ravel()
        flux[:, k] = np.bincount(index.ravel(), weight, len(flux))
    return np.ascontiguousarray(flux.reshape(-1, groups, 4).transpose(1, 0, 2).astype(np.float32))


def _moments(flux: NDArray[np.float32], sphere: TransferSphere) -> NDArray[np.float64]:
    """Return the light of every eight directions, and its first moment, [groups, 4 bytes, 4]."""
    weights = np.insert(sphere.direction.astype(np.float64), 0, 1.0, axis=1)
    products = np.einsum("gdc,dm->gdmc", flux.astype(np.float64), weights)
    totals = products.reshape(len(flux), -1, BYTE, 4, 4).sum(axis=2)
    return np.asarray(totals.reshape(len(flux), -1, 4))


def _block_directions(height: int, width: int, step: int) -> NDArray[np.float64]:
    """Return the directions of the middles of blocks of texels, shape [rows, columns, 3]."""
    if height % step == 0 and width % step == 0:
        return texel_directions(height // step, width // step)
    rows, columns = (
        0.5 * (np.arange(0, size, step) + np.minimum(np.arange(0, size, step) + step, size))
        for size in (height, width)
    )
    turns, polar = np.meshgrid(columns / width, np.pi * rows / height)
    return np.asarray(latlong_directions(turns, polar))


def _device_directions(sphere: TransferSphere, device: str) -> transfer_structs.Directions:
    used = np.arange(len(sphere.direction)) < sphere.count
    bits = used.reshape(-1, WORD).astype(np.uint64) << np.arange(WORD, dtype=np.uint64)
    full = bits.sum(axis=1).astype(np.uint32)

    def cones(size: int) -> tuple[wp.array, wp.array]:
        inside = used.reshape(-1, size)
        groups = sphere.direction.reshape(-1, size, 3)
        center = groups.sum(axis=1) / np.maximum(inside.sum(axis=1), 1)[:, None]
        distance = np.linalg.norm(groups - center[:, None], axis=-1) * inside
        reach = (1.0001 * distance.max(axis=1) + 1e-6).astype(np.float32)
        return vec3(center, device), wp.array(reach, dtype=wp.float32, device=device)

    target = transfer_structs.Directions()
    target.direction = vec3(sphere.direction, device)
    target.word_center, target.word_reach = cones(WORD)
    target.byte_center, target.byte_reach = cones(BYTE)
    target.word_full = wp.array(full, dtype=wp.uint32, device=device)
    return target


def _device_measured(
    transfers: Transfers, device: str
) -> tuple[transfer_structs.Measured, transfer_structs.Vertices]:
    kept = transfers.measured
    measured = transfer_structs.Measured()
    measured.position = vec3(transfers.position, device)
    measured.prim = wp.array(transfers.prim, dtype=wp.int32, device=device)
    measured.weakened = wp.array(kept.weakened, dtype=wp.uint32, device=device)
    measured.first = wp.array(kept.first.astype(np.int32), dtype=wp.int32, device=device)
    direction = kept.direction.astype(np.int32)
    measured.entry_direction = wp.array(direction, dtype=wp.int32, device=device)
    clear = kept.clear.astype(np.float32) / np.float32(255.0)
    measured.entry_clear = wp.array(clear, dtype=wp.float32, device=device)
    length = kept.length.astype(np.float32) / np.float32(1e3)
    measured.entry_length = wp.array(length, dtype=wp.float32, device=device)
    vertices = transfer_structs.Vertices()
    vertices.normal = vec3(transfers.normal, device)
    vertices.material = wp.array(transfers.material, dtype=wp.int32, device=device)
    vertices.row = wp.array(transfers.place.astype(np.int32), dtype=wp.int32, device=device)
    return measured, vertices


def _lamp_sets(sets: list[tuple[int, int, int]], device: str) -> transfer_structs.LampSets:
    table = np.array(sets, np.int32).reshape(-1, 3)
    target = transfer_structs.LampSets()
    target.first_group = wp.array(table[:, 0], dtype=wp.int32, device=device)
    target.group_count = wp.array(table[:, 1], dtype=wp.int32, device=device)
    target.lamp_count = wp.array(table[:, 2], dtype=wp.int32, device=device)
    return target
