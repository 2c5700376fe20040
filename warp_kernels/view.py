"""Camera rays, and the surfaces they meet one behind the other."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.sampling import disk_from_square, hash_pair
from usdskin.warp_kernels.structs import CameraRays, Geometry
from usdskin.warp_kernels.surface import Point

wp.set_module_options({"enable_backward": False})


MAX_LAYERS = wp.constant(64)
"""Surfaces that are looked through, one behind the other."""

UNKNOWN = wp.constant(-2)
"""Of a triangle: nobody has looked yet."""


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
def picture_ray(
    camera: CameraRays, index: wp.int32, offset: wp.vec2f, lens: wp.vec2f, sharpness: wp.float32
) -> Ray:
    """Return the ray of one sample of a pixel.

    ``offset`` is where in the pixel, from its middle [px]; ``sharpness`` the width of what the
    sample sees, as a share of the pixel's.
    """
    ray = camera_ray(
        camera,
        wp.float32(index % camera.width) + 0.5 + offset[0],
        wp.float32(index / camera.width) + 0.5 + offset[1],
        lens,
    )
    ray.spread = ray.spread * sharpness
    ray.width = ray.width * sharpness
    return ray


@wp.struct
class Meeting:
    """Where a ray meets a surface."""

    face: wp.int32
    """The triangle; -1 where it meets none."""

    u: wp.float32
    v: wp.float32
    """Barycentric coordinates."""

    distance: wp.float32
    """From the ray's origin [m]."""


@wp.func
def meet(geometry: Geometry, ray: Ray, start: wp.float32, known: wp.int32) -> Meeting:
    """Return the first surface beyond ``start`` [m].

    ``known`` is its triangle where that was found before, -1 where there is none.
    """
    found = Meeting()
    found.face = known
    if known >= 0:
        at = first_hit(geometry, ray, known)
        found.u = at[0]
        found.v = at[1]
        found.distance = start + at[2]
    elif known == UNKNOWN:
        found.face = -1
        hit = wp.mesh_query_ray(
            geometry.mesh, ray.origin + start * ray.direction, ray.direction, ray.length - start
        )
        if hit.result:
            found.face = hit.face
            found.u = hit.u
            found.v = hit.v
            found.distance = start + hit.t
    return found


@wp.func
def beyond(distance: wp.float32) -> wp.float32:
    """Return where to go on behind a surface [m]."""
    return distance * 1.000001 + 1.0e-6


@wp.func
def surface_point(geometry: Geometry, ray: Ray, met: Meeting) -> Point:
    """Return what a ray sees of the surface it meets."""
    point = Point()
    face = met.face
    u = met.u
    v = met.v
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
    point.footprint = (ray.width + ray.spread * met.distance) / wp.sqrt(grazing)
    return point
