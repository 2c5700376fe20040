"""Cryptomatte: mattes of every object and material, with their names, in a few float channels.

Specification: J. Friedman, A. C. Jones et al., "Cryptomatte Specification", version 1.2, Psyop.
A pixel holds the surfaces that cover it in descending order, as pairs of an id, which is a name's
hash as a float, and a coverage; two pairs to a part's R, G, B and A.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers
from usdskin.image_output import Part
from usdskin.render.aovs import MATTES
from usdskin.render.cameras import Camera
from usdskin.render.film import sample_offsets
from usdskin.render.integrate import GPU_TILE_PIXELS, TILE_PIXELS, DeviceScene, device_camera
from usdskin.render.projection import project
from usdskin.warp_kernels import matte, raster

RANKS = 6
"""Surfaces kept of a pixel: three parts of two."""

_WORD = 0xFFFFFFFF


def murmur_hash(name: str) -> int:
    """Return MurmurHash3_x86_32 of a name's UTF-8 bytes, seed 0 (A. Appleby, SMHasher)."""
    data = name.encode()
    state = 0
    for begin in range(0, len(data), 4):
        chunk = data[begin : begin + 4]
        block = _rotate(int.from_bytes(chunk, "little") * 0xCC9E2D51 & _WORD, 15)
        state ^= block * 0x1B873593 & _WORD
        if len(chunk) == 4:
            state = (_rotate(state, 13) * 5 + 0xE6546B64) & _WORD
    state ^= len(data)
    state = (state ^ state >> 16) * 0x85EBCA6B & _WORD
    state = (state ^ state >> 13) * 0xC2B2AE35 & _WORD
    return state ^ state >> 16


def _rotate(value: int, bits: int) -> int:
    return (value << bits | value >> 32 - bits) & _WORD


def matte_id(name: str) -> int:
    """Return the bits of a name's id: its hash, kept from being no normal float."""
    found = murmur_hash(name)
    exponent = found >> 23 & 255
    return found ^ 1 << 23 if exponent in (0, 255) else found


def metadata(layer: str, names: Sequence[str]) -> dict[str, str]:
    """Return the header attributes of one Cryptomatte.

    Args:
        layer: Name of the matte; its parts are called so, with two digits after it.
        names: What it may show.
    """
    prefix = f"cryptomatte/{matte_id(layer):08x}"[:-1]
    manifest = {name: f"{matte_id(name):08x}" for name in names}
    return {
        f"{prefix}/name": layer,
        f"{prefix}/hash": "MurmurHash3_32",
        f"{prefix}/conversion": "uint32_to_float32",
        f"{prefix}/manifest": json.dumps(manifest, separators=(",", ":")),
    }


def matte_parts(
    layer: str, ranked: NDArray[np.float32], names: Sequence[str], attributes: dict[str, Any]
) -> list[Part]:
    """Return the parts of one Cryptomatte, always 32-bit floats.

    Args:
        layer: Its name.
        ranked: Ids and coverages, shape [height, width, ``RANKS``, 2].
        names: What it may show.
        attributes: Further header attributes.
    """
    header = {**attributes, **metadata(layer, names)}
    pairs = ranked.reshape(*ranked.shape[:2], -1, 4)
    return [
        Part(
            f"{layer}{k:02d}",
            {f"{layer}{k:02d}.{'RGBA'[c]}": pairs[:, :, k, c] for c in range(4)},
            header,
        )
        for k in range(pairs.shape[2])
    ]


def collect_mattes(
    scene: DeviceScene,
    camera: Camera,
    resolution: tuple[int, int],
    samples: int,
    pixel_filter: str,
    names: Mapping[str, Sequence[str]],
    workers: Workers,
) -> dict[str, NDArray[np.float32]]:
    """Return what covers every pixel, at the samples of the beauty.

    What is not opaque covers as much as it shows; coverages of a pixel add up to its alpha with
    the dome hidden.

    Args:
        scene: The scene on the workers' device.
        camera: Where from.
        resolution: Width and height [px].
        samples: Samples per pixel.
        pixel_filter: Name of the pixel filter.
        names: Of every prim and material, by matte (``MATTES``).
        workers: Where to compute.

    Returns:
        By matte: ids and coverages in descending order, shape [h, w, ``RANKS``, 2].
    """
    width, height = resolution
    count, device = width * height, workers.device
    on_host = device == "cpu"
    compilation.load(matte, device)
    rays = device_camera(camera, resolution)
    offsets = wp.array(sample_offsets(samples, pixel_filter), dtype=wp.vec2f, device=device)
    rows = min(max(1, (TILE_PIXELS if on_host else GPU_TILE_PIXELS) // width), height)
    projection = None
    if on_host and camera.lens_radius <= 0.0:
        compilation.load(raster, device)
        reach = float(np.abs(offsets.numpy()).max())
        projection = project(
            scene.faces.points, scene.faces.triangles, camera, resolution, rows, reach, device
        )
    ids = {
        name: np.array([matte_id(text) for text in names[name]], np.uint32).view(np.float32)
        for name in MATTES
    }
    found = {name: np.zeros((count, RANKS, 2), np.float32) for name in MATTES}

    def work(begin: int, end: int) -> None:
        tile = matte.MatteTile()
        tile.sample, tile.first_pixel = offsets, begin
        if projection is None:
            tile.face = wp.empty((0, 0), dtype=wp.int32, device=device)
        else:
            first = begin // width
            tile.face = raster.rasterize_band(
                projection, offsets, first // rows, width, first, (end - begin) // width
            )
        shape = (end - begin, int(matte.SLOTS))
        tile.prim = wp.full(shape, -1, dtype=wp.int32, device=device)
        tile.material = wp.full(shape, -1, dtype=wp.int32, device=device)
        tile.coverage = wp.zeros(shape, dtype=wp.float32, device=device)
        matte.render_mattes(scene.geometry, rays, scene.materials, tile)
        coverage = tile.coverage.numpy()
        for name, label in zip(MATTES, (tile.prim, tile.material), strict=True):
            found[name][begin:end] = _ranked(label.numpy(), coverage, ids[name])

    workers.run(count, rows * width, work)
    return {name: values.reshape(height, width, RANKS, 2) for name, values in found.items()}


def _ranked(
    label: NDArray[np.int32], coverage: NDArray[np.float32], ids: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Join slots of one label and sort them by coverage, shape [pixels, ``RANKS``, 2]."""
    ranked = np.zeros((len(label), RANKS, 2), np.float32)
    used = int((label >= 0).sum(axis=1).max(initial=0))
    label, joined = label[:, :used], coverage[:, :used].copy()
    for k in range(used - 1, 0, -1):
        for earlier in range(k):
            same = label[:, k] == label[:, earlier]
            joined[same, earlier] += joined[same, k]
            joined[same, k] = 0.0
    order = np.argsort(-joined, axis=1, kind="stable")[:, :RANKS]
    share = np.take_along_axis(joined, order, axis=1)
    which = np.take_along_axis(label, order, axis=1)
    there = (share > 0.0) & (which >= 0)
    kept = order.shape[1]
    ranked[:, :kept, 0] = np.where(there, ids[np.maximum(which, 0)], 0.0)
    ranked[:, :kept, 1] = np.where(there, share, 0.0)
    return ranked
