"""Which surfaces each pixel shows, and how much of each: coverage at the beauty's own samples."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.film import (
    MAX_LAYERS,
    camera_ray,
    first_hit,
    lens_sample,
    surface_point,
)
from usdskin.warp_kernels.structs import CameraRays, Geometry, Materials
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
    column = index % camera.width
    row = index / camera.width
    samples = tile.sample.shape[0]
    share = 1.0 / wp.float32(samples)
    rasterized = tile.face.shape[0] > 0
    sharpness = 1.0 / wp.sqrt(wp.float32(samples))
    for s in range(samples):
        offset = tile.sample[s]
        ray = camera_ray(
            camera,
            wp.float32(column) + 0.5 + offset[0],
            wp.float32(row) + 0.5 + offset[1],
            lens_sample(index, s),
        )
        ray.spread = ray.spread * sharpness
        ray.width = ray.width * sharpness
        clear = float(1.0)
        start = float(0.0)
        for layer in range(MAX_LAYERS):
            face = int(-1)
            at = wp.vec3f(0.0, 0.0, 0.0)
            if layer == 0 and rasterized:
                face = tile.face[pixel, s]
                if face >= 0:
                    at = first_hit(geometry, ray, face)
            else:
                hit = wp.mesh_query_ray(
                    geometry.mesh,
                    ray.origin + start * ray.direction,
                    ray.direction,
                    ray.length - start,
                )
                if hit.result:
                    face = hit.face
                    at = wp.vec3f(hit.u, hit.v, hit.t)
            if face < 0:
                break
            distance = start + at[2]
            point = surface_point(geometry, ray, face, at[0], at[1], distance)
            opacity = surface_opacity(geometry, materials, point)
            if opacity > 0.0:
                _deposit(tile, pixel, geometry.prim[face], point.material, share * clear * opacity)
            clear = clear * (1.0 - opacity)
            start = distance * 1.000001 + 1.0e-6
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
