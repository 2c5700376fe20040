"""Data parts of a picture: what the middle of every pixel sees."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.detail import relieved
from usdskin.warp_kernels.diffuse import diffuse_light
from usdskin.warp_kernels.lookup import frame_coordinates
from usdskin.warp_kernels.structs import (
    INPUT_BASE,
    CameraRays,
    Geometry,
    Lights,
    Materials,
)
from usdskin.warp_kernels.surface import Point, read_input
from usdskin.warp_kernels.view import (
    MAX_LAYERS,
    UNKNOWN,
    beyond,
    meet,
    picture_ray,
    surface_point,
)
from usdskin.warp_kernels.visibility import surface_opacity

wp.set_module_options({"enable_backward": False})


@wp.struct
class DataTile:
    """Pixel-centre data of one tile: what the first opaque surface is, not how it looks."""

    first_pixel: wp.int32
    normal: wp.array[wp.vec3f]
    """Unit shading normal, world space, 0 where nothing is hit, shape [tile_pixels]."""
    position: wp.array[wp.vec4f]
    """World position [m] and depth along the view axis [m], infinite where nothing is hit."""
    base: wp.array[wp.vec4f]
    """The base input: RGB albedo or basis weights, shape [tile_pixels]."""
    st: wp.array[wp.vec2f]
    """Primvar st, shape [tile_pixels]."""
    face: wp.array[wp.int32]
    """Triangle, -1 where nothing is hit, shape [tile_pixels]."""
    irradiance: wp.array[wp.vec3f]
    """XYZ of the irradiance at the shading normal, shape [tile_pixels], or [0]: not wanted."""
    st_primvar: wp.int32
    """Row of st in ``Geometry.corner_value``, -1 where the stage has none."""


@wp.func
def _irradiance(lights: Lights, materials: Materials, point: Point) -> wp.vec3f:
    """Return the XYZ of J1; the dome's rows are the light channels' own spectra."""
    first = materials.row[materials.kind.shape[0] - 1]
    coordinates = wp.vec2f(0.0, 0.0)
    total = wp.vec3f(0.0, 0.0, 0.0)
    for g in range(lights.group_count):
        coordinates = frame_coordinates(lights, g, point.normal, coordinates)
        light = diffuse_light(lights, 0, 1, g, point.normal, coordinates).lambert
        total += wp.vec3f(
            wp.dot(materials.xyz_x[first + g], light),
            wp.dot(materials.xyz_y[first + g], light),
            wp.dot(materials.xyz_z[first + g], light),
        )
    return total


@wp.kernel(enable_backward=False)
def _data_kernel(
    # In:
    geometry: Geometry,
    camera: CameraRays,
    lights: Lights,
    materials: Materials,
    # Out:
    tile: DataTile,
):
    """Find what the pixel's middle sees; unfiltered, so that ids and positions stay true.

    Launch dimension: [tile_pixels].
    """
    pixel = wp.tid()
    index = tile.first_pixel + pixel
    ray = picture_ray(camera, index, wp.vec2f(0.0, 0.0), wp.vec2f(0.5, 0.5), 1.0)
    start = float(0.0)
    tile.face[pixel] = -1
    tile.position[pixel] = wp.vec4f(0.0, 0.0, 0.0, wp.inf)
    for _layer in range(MAX_LAYERS):
        met = meet(geometry, ray, start, UNKNOWN)
        if met.face < 0:
            break
        point = surface_point(geometry, ray, met)
        if (materials.flags[point.material] & 64) != 0:
            point = relieved(geometry, materials, point)
        if surface_opacity(geometry, materials, point) > 0.5:
            tile.face[pixel] = met.face
            tile.normal[pixel] = point.normal
            p = point.position
            depth = -wp.dot(p - camera.origin, camera.back)
            tile.position[pixel] = wp.vec4f(p[0], p[1], p[2], depth)
            tile.base[pixel] = read_input(geometry, materials, point, INPUT_BASE)
            if tile.st_primvar >= 0:
                b = point.barycentric
                st = b[0] * geometry.corner_value[tile.st_primvar, point.corner]
                st += b[1] * geometry.corner_value[tile.st_primvar, point.corner + 1]
                st += b[2] * geometry.corner_value[tile.st_primvar, point.corner + 2]
                tile.st[pixel] = wp.vec2f(st[0], st[1])
            if tile.irradiance.shape[0] > 0:
                tile.irradiance[pixel] = _irradiance(lights, materials, point)
            break
        start = beyond(met.distance)


def render_data(
    geometry: Geometry, camera: CameraRays, lights: Lights, materials: Materials, tile: DataTile
) -> None:
    """Fill one tile of pixel-centre data."""
    wp.launch(
        _data_kernel,
        dim=tile.face.shape[0],
        inputs=[geometry, camera, lights, materials],
        outputs=[tile],
        device=tile.face.device,
    )
