"""Pictures: camera rays into the scene, surfaces into channels, channels into spectra."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.detail import relieved
from usdskin.warp_kernels.lookup import lookup_dome
from usdskin.warp_kernels.sampling import disk_from_square, hash_pair
from usdskin.warp_kernels.seen import deposit_transfer, has_transfer, hide_reflections
from usdskin.warp_kernels.skin import (
    Point,
    reflect_preview_surface,
    reflect_skin,
    shade_emission,
    shade_gloss,
    shade_preview_surface,
    shade_skin,
)
from usdskin.warp_kernels.structs import (
    INPUT_OPACITY,
    CameraRays,
    Film,
    Geometry,
    Lights,
    Materials,
)
from usdskin.warp_kernels.visibility import surface_opacity

wp.set_module_options({"enable_backward": False})

MAX_LAYERS = wp.constant(64)


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
def camera_ray(camera: CameraRays, x: wp.float32, y: wp.float32, lens: wp.vec2f) -> Ray:
    """Return the ray through a picture position [px]; x to the right, y down.

    ``lens`` is where in the aperture it passes, uniform over the unit square; only a thin lens
    (``camera.lens_radius``) looks at it.
    """
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
        origin = camera.origin
        if camera.lens_radius > 0.0:  # all rays of a position meet in the plane of focus
            disk = disk_from_square(lens)
            at = camera.lens_radius * disk[0] * camera.right
            at += camera.lens_radius * disk[1] * camera.up
            origin = origin + at
            toward = toward - at / camera.focus_distance
            stretch = wp.length(toward)
        ray.direction = toward / stretch
        ray.origin = origin + (camera.near * stretch) * ray.direction
        ray.length = (camera.far - camera.near) * stretch
        ray.spread = pixel / stretch
        ray.width = pixel * camera.near
    return ray


@wp.func
def lens_sample(pixel: wp.int32, s: wp.int32) -> wp.vec2f:
    """Return where a sample passes the lens: a lattice, moved about by a hash of the pixel."""
    moved = hash_pair(wp.uint32(pixel), wp.uint32(1))
    x = wp.float32(moved >> wp.uint32(16)) / 65536.0 + wp.float32(s) * 0.7548776662466927
    y = wp.float32(moved & wp.uint32(0xFFFF)) / 65536.0 + wp.float32(s) * 0.5698402909980532
    return wp.vec2f(x - wp.floor(x), y - wp.floor(y))


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
    point.view = -ray.direction
    a = wp.mesh_get_point(geometry.mesh, corner)
    b = wp.mesh_get_point(geometry.mesh, corner + 1)
    c = wp.mesh_get_point(geometry.mesh, corner + 2)
    # From the corners, for a position along a long ray would lie beside the triangle.
    point.position = u * a + v * b + (1.0 - u - v) * c
    largest = wp.max(wp.max(wp.abs(a), wp.abs(b)), wp.abs(c))
    point.size = wp.max(largest)
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
    point.side = wp.where(wp.dot(cross, ray.direction) > 0.0, -1.0, 1.0)
    normal = point.side * normal
    point.normal = normal
    point.geometric = point.side * wp.normalize(cross)
    point.prim = geometry.prim[face]
    grazing = wp.max(wp.dot(normal, point.view), 0.05)
    point.footprint = (ray.width + ray.spread * t) / wp.sqrt(grazing)
    return point


@wp.func
def first_hit(geometry: Geometry, ray: Ray, face: wp.int32) -> wp.vec3f:
    """Return (u, v, t) of a ray on the plane of the triangle it is known to hit."""
    a = wp.mesh_get_point(geometry.mesh, 3 * face)
    b = wp.mesh_get_point(geometry.mesh, 3 * face + 1)
    c = wp.mesh_get_point(geometry.mesh, 3 * face + 2)
    ca = a - c
    cb = b - c
    across = wp.cross(ray.direction, cb)
    scale = wp.dot(ca, across)
    if scale == 0.0:
        return wp.vec3f(1.0, 0.0, wp.length(a - ray.origin))
    to_origin = ray.origin - c
    upward = wp.cross(to_origin, ca)
    u = wp.clamp(wp.dot(to_origin, across) / scale, 0.0, 1.0)
    v = wp.clamp(wp.dot(ray.direction, upward) / scale, 0.0, 1.0 - u)
    return wp.vec3f(u, v, wp.max(wp.dot(cb, upward) / scale, 0.0))


@wp.func
def finish_rows(
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
def deposit_dome(
    lights: Lights, film: Film, pixel: wp.int32, direction: wp.vec3f, weight: wp.float32
):
    """Deposit what the domes show towards a direction."""
    for g in range(lights.group_count):
        film.channel[pixel, g] += weight * lookup_dome(lights, g, direction)


@wp.func
def shines_when_clear(materials: Materials, material: wp.int32) -> bool:
    """Return whether a surface reflects at opacity 0: transparent, and not cut out."""
    flags = materials.flags[material]
    return (flags & 6) == 4 and materials.constant[material, INPUT_OPACITY][1] <= 0.0


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
    rasterized = film.face.shape[0] > 0
    sharpness = 1.0 / wp.sqrt(wp.float32(wp.max(samples, film.sample_count)))
    for s in range(samples):
        offset = film.sample[s]
        ray = camera_ray(
            camera,
            wp.float32(column) + 0.5 + offset[0],
            wp.float32(row) + 0.5 + offset[1],
            lens_sample(index, film.first_sample + s),
        )
        ray.spread = ray.spread * sharpness
        ray.width = ray.width * sharpness
        clear = float(1.0)
        start = float(0.0)
        seen_through = int(1)
        for layer in range(MAX_LAYERS):
            face = int(-1)
            at = wp.vec3f(0.0, 0.0, 0.0)
            if layer == 0 and rasterized:
                face = film.face[pixel, s]
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
                if film.show_dome != 0:
                    if current != dome:
                        finish_rows(materials, film, pixel, current, share)
                        current = dome
                    deposit_dome(lights, film, pixel, ray.direction, clear)
                    alpha += clear
                seen_through = 0
                break
            distance = start + at[2]
            point = surface_point(geometry, ray, face, at[0], at[1], distance)
            if (materials.flags[point.material] & 64) != 0:
                point = relieved(geometry, materials, point)
            opacity = surface_opacity(geometry, materials, point)
            if point.material != current:
                finish_rows(materials, film, pixel, current, share)
                current = point.material
            if materials.kind[current] == 1:
                r = reflect_skin(geometry, lights, materials, point, clear)
                behind = float(1.0)
                if has_transfer(geometry, point):
                    behind = 0.0
                    deposit_transfer(geometry, lights, materials, film, pixel, point, r)
                shade_skin(geometry, lights, materials, film, pixel, point, r, behind)
                seen = hide_reflections(geometry, point, r)
                shade_gloss(lights, materials, film, pixel, point, seen)
            elif opacity > 0.0 or shines_when_clear(materials, current):
                r = reflect_preview_surface(geometry, lights, materials, point, clear, opacity)
                shade_preview_surface(lights, materials, film, pixel, point, r)
                if has_transfer(geometry, point):
                    deposit_transfer(geometry, lights, materials, film, pixel, point, r)
                seen = hide_reflections(geometry, point, r)
                shade_gloss(lights, materials, film, pixel, point, seen)
                shade_emission(geometry, lights, materials, film, pixel, point, r)
            alpha += clear * opacity
            clear = clear * (1.0 - opacity)
            start = distance * 1.000001 + 1.0e-6
            if clear < 1.0e-4 or start >= ray.length:
                seen_through = 0
                break
        if seen_through != 0 and film.show_dome != 0:  # more layers than are counted
            if current != dome:
                finish_rows(materials, film, pixel, current, share)
                current = dome
            deposit_dome(lights, film, pixel, ray.direction, clear)
            alpha += clear
    finish_rows(materials, film, pixel, current, share)
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
