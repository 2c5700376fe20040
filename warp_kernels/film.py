"""Pictures: camera rays into the scene, surfaces into channels, channels into spectra."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import latlong_coordinates, lookup_dome
from usdskin.warp_kernels.skin import (
    Point,
    diffuse_light,
    read_input,
    shade_preview_surface,
    shade_skin,
)
from usdskin.warp_kernels.structs import (
    INPUT_BASE,
    INPUT_OPACITY,
    CameraRays,
    Film,
    Geometry,
    Lights,
    Materials,
)

wp.set_module_options({"enable_backward": False})

MAX_LAYERS = wp.constant(16)


@wp.struct
class Ray:
    """One camera ray."""

    origin: wp.vec3f
    direction: wp.vec3f
    length: wp.float32
    """From the near to the far clipping plane along the ray [m]."""
    spread: wp.float32
    """Width of a pixel per metre of distance."""
    width: wp.float32
    """Width of a pixel at the camera [m]."""


@wp.func
def camera_ray(camera: CameraRays, x: wp.float32, y: wp.float32) -> Ray:
    """Return the ray through a picture position [px]; x to the right, y down."""
    ray = Ray()
    u = x / wp.float32(camera.width)
    v = y / wp.float32(camera.height)
    across = camera.window[0] + (camera.window[1] - camera.window[0]) * u
    upward = camera.window[3] + (camera.window[2] - camera.window[3]) * v
    pixel = wp.abs(camera.window[1] - camera.window[0]) / wp.float32(camera.width)
    if camera.orthographic != 0:
        ray.direction = -camera.back
        ray.origin = camera.origin + across * camera.right + upward * camera.up
        ray.origin = ray.origin - camera.near * camera.back
        ray.length = camera.far - camera.near
        ray.spread = 0.0
        ray.width = pixel
    else:
        toward = across * camera.right + upward * camera.up - camera.back
        stretch = wp.length(toward)
        ray.direction = toward / stretch
        ray.origin = camera.origin + (camera.near * stretch) * ray.direction
        ray.length = (camera.far - camera.near) * stretch
        ray.spread = pixel / stretch
        ray.width = pixel * camera.near
    return ray


@wp.func
def surface_point(
    geometry: Geometry, ray: Ray, face: wp.int32, u: wp.float32, v: wp.float32, t: wp.float32
) -> Point:
    """Return what a ray sees of a triangle at barycentric u, v."""
    point = Point()
    corner = 3 * face
    point.corner = corner
    point.material = geometry.material[face]
    point.barycentric = wp.vec3f(u, v, 1.0 - u - v)
    point.position = ray.origin + t * ray.direction
    point.view = -ray.direction
    a = wp.mesh_get_point(geometry.mesh, corner)
    b = wp.mesh_get_point(geometry.mesh, corner + 1)
    c = wp.mesh_get_point(geometry.mesh, corner + 2)
    cross = wp.cross(b - a, c - a)
    point.triangle_area = 0.5 * wp.length(cross)
    normal = (
        u * geometry.corner_normal[corner]
        + v * geometry.corner_normal[corner + 1]
        + (1.0 - u - v) * geometry.corner_normal[corner + 2]
    )
    length = wp.length(normal)
    if length > 1.0e-8:
        normal = normal / length
    else:
        normal = wp.normalize(cross)
    if wp.dot(cross, ray.direction) > 0.0:
        normal = -normal
    point.normal = normal
    grazing = wp.max(wp.dot(normal, point.view), 0.05)
    point.footprint = (ray.width + ray.spread * t) / wp.sqrt(grazing)
    return point


@wp.func
def _finish_rows(
    materials: Materials, film: Film, pixel: wp.int32, material: wp.int32, share: wp.float32
):
    """Turn the scratch of one material into XYZ and spectrum, and clear it."""
    if material < 0:
        return
    first = materials.row[material]
    count = materials.row_count[material]
    xyza = film.xyza[pixel]
    x = float(0.0)
    y = float(0.0)
    z = float(0.0)
    for q in range(count):
        value = film.channel[pixel, q]
        x += wp.dot(materials.xyz_x[first + q], value)
        y += wp.dot(materials.xyz_y[first + q], value)
        z += wp.dot(materials.xyz_z[first + q], value)
    film.xyza[pixel] = xyza + share * wp.vec4f(x, y, z, 0.0)
    groups = film.spectrum.shape[1]
    for q in range(count):
        value = share * film.channel[pixel, q]
        at = 4 * (first + q)
        for g in range(groups):
            part = value[0] * materials.band[at, g] + value[1] * materials.band[at + 1, g]
            part += value[2] * materials.band[at + 2, g] + value[3] * materials.band[at + 3, g]
            film.spectrum[pixel, g] += part
        film.channel[pixel, q] = wp.vec4f(0.0, 0.0, 0.0, 0.0)


@wp.func
def surface_opacity(geometry: Geometry, materials: Materials, point: Point) -> wp.float32:
    """Return opacity, cut at the material's threshold where it has one."""
    opacity = wp.clamp(read_input(geometry, materials, point, INPUT_OPACITY)[0], 0.0, 1.0)
    threshold = materials.constant[point.material, INPUT_OPACITY][1]
    if threshold > 0.0:
        if opacity >= threshold:
            return 1.0
        return 0.0
    return opacity


@wp.kernel(enable_backward=False)
def _picture_kernel(
    # In:
    geometry: Geometry,
    camera: CameraRays,
    lights: Lights,
    materials: Materials,
    # Out:
    film: Film,
):
    """Render one pixel: every sample's surfaces, front to back, then one spectrum per material.

    Launch dimension: [tile_pixels].
    """
    pixel = wp.tid()
    index = film.first_pixel + pixel
    column = index % camera.width
    row = index / camera.width
    samples = film.sample.shape[0]
    share = 1.0 / wp.float32(samples)
    dome = materials.kind.shape[0] - 1
    current = int(-1)
    alpha = float(0.0)
    sharpness = 1.0 / wp.sqrt(wp.float32(samples))
    for s in range(samples):
        offset = film.sample[s]
        ray = camera_ray(
            camera,
            wp.float32(column) + 0.5 + offset[0],
            wp.float32(row) + 0.5 + offset[1],
        )
        ray.spread = ray.spread * sharpness
        ray.width = ray.width * sharpness
        clear = float(1.0)
        start = float(0.0)
        for _layer in range(MAX_LAYERS):
            hit = wp.mesh_query_ray(
                geometry.mesh, ray.origin + start * ray.direction, ray.direction, ray.length - start
            )
            if not hit.result:
                if film.show_dome != 0:
                    if current != dome:
                        _finish_rows(materials, film, pixel, current, share)
                        current = dome
                    for g in range(lights.group_count):
                        seen = lookup_dome(lights, g, ray.direction)
                        film.channel[pixel, g] += clear * seen
                    alpha += clear
                break
            point = surface_point(geometry, ray, hit.face, hit.u, hit.v, start + hit.t)
            opacity = surface_opacity(geometry, materials, point)
            if point.material != current:
                _finish_rows(materials, film, pixel, current, share)
                current = point.material
            if materials.kind[current] == 1:
                shade_skin(geometry, lights, materials, film, pixel, point, clear)
            elif opacity > 0.0:
                shade_preview_surface(
                    geometry, lights, materials, film, pixel, point, clear, opacity
                )
            alpha += clear * opacity
            clear = clear * (1.0 - opacity)
            start = (start + hit.t) * 1.000001 + 1.0e-6
            if clear < 1.0e-4 or start >= ray.length:
                break
    _finish_rows(materials, film, pixel, current, share)
    total = film.xyza[pixel]
    film.xyza[pixel] = wp.vec4f(total[0], total[1], total[2], share * alpha)


def render_tile(
    geometry: Geometry, camera: CameraRays, lights: Lights, materials: Materials, film: Film
) -> None:
    """Render the pixels of one tile into ``film.xyza`` and ``film.spectrum``."""
    wp.launch(
        _picture_kernel,
        dim=film.xyza.shape[0],
        inputs=[geometry, camera, lights, materials],
        outputs=[film],
        device=film.xyza.device,
    )


@wp.kernel(enable_backward=False)
def _shade_normals_kernel(
    # In:
    normal: wp.array[wp.vec3f],
    lights: Lights,
    materials: Materials,
    # Out:
    film: Film,
):
    """Shade the first material, skin without textures and lustre, at one normal per pixel.

    Launch dimension: [tile_pixels].
    """
    pixel = wp.tid()
    geometry = Geometry()
    point = Point()
    point.normal = normal[film.first_pixel + pixel]
    point.view = point.normal
    shade_skin(geometry, lights, materials, film, pixel, point, 1.0)
    _finish_rows(materials, film, pixel, 0, 1.0)


def shade_normals(
    normal: wp.array[wp.vec3f], lights: Lights, materials: Materials, film: Film
) -> None:
    """Shade the first material at the normals of one tile."""
    wp.launch(
        _shade_normals_kernel,
        dim=film.xyza.shape[0],
        inputs=[normal, lights, materials],
        outputs=[film],
        device=normal.device,
    )


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
    coordinates = latlong_coordinates(point.normal)
    total = wp.vec3f(0.0, 0.0, 0.0)
    for g in range(lights.group_count):
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
    column = index % camera.width
    row = index / camera.width
    ray = camera_ray(camera, wp.float32(column) + 0.5, wp.float32(row) + 0.5)
    start = float(0.0)
    tile.face[pixel] = -1
    tile.position[pixel] = wp.vec4f(0.0, 0.0, 0.0, wp.inf)
    for _layer in range(MAX_LAYERS):
        hit = wp.mesh_query_ray(
            geometry.mesh, ray.origin + start * ray.direction, ray.direction, ray.length - start
        )
        if not hit.result:
            break
        point = surface_point(geometry, ray, hit.face, hit.u, hit.v, start + hit.t)
        if surface_opacity(geometry, materials, point) > 0.5:
            tile.face[pixel] = hit.face
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
        start = (start + hit.t) * 1.000001 + 1.0e-6


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


def load(device: str) -> None:
    """Load this module's kernels, compiled if the cache has none."""
    wp.load_module(__name__, device)
