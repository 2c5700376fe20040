"""Which surfaces each pixel shows, and how much of each: coverage at the beauty's own samples."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.structs import CameraRays, Geometry, Materials
from usdskin.warp_kernels.view import (
    MAX_LAYERS,
    UNKNOWN,
    beyond,
    lens_sample,
    meet,
    picture_ray,
    surface_point,
)
from usdskin.warp_kernels.visibility import surface_opacity

wp.set_module_options({"enable_backward": False})

SLOTS = wp.constant(16)
"""Surfaces told apart in one pixel; of more, those that cover least are forgotten."""


@wp.struct
class MatteTile:
    """One tile of coverage."""

    sample: wp.array[wp.vec2f]
    """Sample offsets from the pixel's middle [px], shape [samples]."""

    first_pixel: wp.int32

    face: wp.array2d[wp.int32]
    """First triangle of every sample, as ``Film.face``."""

    prim: wp.array2d[wp.int32]
    """Result: prim of each slot, -1 where it is empty, shape [tile_pixels, SLOTS]."""

    material: wp.array2d[wp.int32]
    """Result: material of each slot, shape [tile_pixels, SLOTS]."""

    coverage: wp.array2d[wp.float32]
    """Result: share of the pixel that the slot's surface covers, shape [tile_pixels, SLOTS]."""


@wp.func
def _deposit(tile: MatteTile, pixel: wp.int32, prim: wp.int32, material: wp.int32, w: wp.float32):
    """Add coverage to a surface's slot, an empty one, or that of the surface that covers least."""
    least = int(0)
    for k in range(wp.static(int(SLOTS))):
        found = tile.prim[pixel, k]
        if found < 0 or (found == prim and tile.material[pixel, k] == material):
            tile.prim[pixel, k] = prim
            tile.material[pixel, k] = material
            tile.coverage[pixel, k] += w
            return
        if tile.coverage[pixel, k] < tile.coverage[pixel, least]:
            least = k
    if w > tile.coverage[pixel, least]:
        tile.prim[pixel, least] = prim
        tile.material[pixel, least] = material
        tile.coverage[pixel, least] = w


@wp.kernel(enable_backward=False)
def _matte_kernel(
    # In:
    geometry: Geometry,
    camera: CameraRays,
    materials: Materials,
    # Out:
    tile: MatteTile,
):
    """Follow every sample of a pixel front to back, as the picture kernel does.

    Launch dimension: [tile_pixels].
    """
    pixel = wp.tid()
    index = tile.first_pixel + pixel
    samples = tile.sample.shape[0]
    share = 1.0 / wp.float32(samples)
    rasterized = tile.face.shape[0] > 0
    sharpness = 1.0 / wp.sqrt(wp.float32(samples))
    for s in range(samples):
        ray = picture_ray(camera, index, tile.sample[s], lens_sample(index, s), sharpness)
        clear = float(1.0)
        start = float(0.0)
        for layer in range(MAX_LAYERS):
            known = int(UNKNOWN)
            if layer == 0 and rasterized:
                known = tile.face[pixel, s]
            met = meet(geometry, ray, start, known)
            if met.face < 0:
                break
            point = surface_point(geometry, ray, met)
            opacity = surface_opacity(geometry, materials, point)
            if opacity > 0.0:
                _deposit(tile, pixel, point.prim, point.material, share * clear * opacity)
            clear = clear * (1.0 - opacity)
            start = beyond(met.distance)
            if clear < 1.0e-4 or start >= ray.length:
                break


def render_mattes(
    geometry: Geometry, camera: CameraRays, materials: Materials, tile: MatteTile
) -> None:
    """Fill one tile of coverage; its slots are empty before."""
    wp.launch(
        _matte_kernel,
        dim=tile.coverage.shape[0],
        inputs=[geometry, camera, materials],
        outputs=[tile],
        device=tile.coverage.device,
    )
