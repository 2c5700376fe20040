"""Surface detail: shading normals tilted by normal maps and by the slope of height maps.

``Geometry.corner_frame`` holds what turns a texture's axes into directions: for a normal map the
tangent and the sign of the bitangent (MikkTSpace's conventions), for a height map the surface
gradients of s and t [1/m].
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.structs import INPUT_BUMP, INPUT_NORMAL, Geometry, Materials
from usdskin.warp_kernels.surface import Point, read_input

wp.set_module_options({"enable_backward": False})

LEAST_RISE = wp.constant(0.01)
"""Cosine that reflected views keep from the surface's plane."""


@wp.func
def _frame(geometry: Geometry, point: Point, row: wp.int32) -> wp.vec4f:
    """Return a row of the corner frames at a point."""
    b = point.barycentric
    value = b[0] * geometry.corner_frame[row, point.corner]
    value += b[1] * geometry.corner_frame[row, point.corner + 1]
    value += b[2] * geometry.corner_frame[row, point.corner + 2]
    return value


@wp.func
def mapped_normal(frame: wp.vec4f, mapped: wp.vec4f, normal: wp.vec3f) -> wp.vec3f:
    """Return a tangent-space normal in the space of the frame.

    The tangent is made orthogonal to the shading normal N, the bitangent is sign x (N x T), as
    MikkTSpace's documentation has it.

    Args:
        frame: Tangent, and the sign of the bitangent.
        mapped: Normal in x (tangent), y (bitangent) and z; need not be of length 1.
        normal: Unit shading normal on the outside of the surface.
    """
    if mapped[0] == 0.0 and mapped[1] == 0.0:
        return normal
    tangent = wp.vec3f(frame[0], frame[1], frame[2])
    tangent = tangent - wp.dot(tangent, normal) * normal
    length = wp.length(tangent)
    if length < 1.0e-6:  # no texture coordinates here
        return normal
    tangent = tangent / length
    side = wp.where(frame[3] < 0.0, -1.0, 1.0)
    bitangent = side * wp.cross(normal, tangent)
    tilted = mapped[0] * tangent + mapped[1] * bitangent + mapped[2] * normal
    length = wp.length(tilted)
    if length < 1.0e-6:
        return normal
    return tilted / length


@wp.func
def shortening_variance(mapped: wp.vec4f) -> wp.float32:
    """Return the variance of slopes that shortens a mean of unit normals to a length.

    Toksvig 2004: (1 - length) / length along each of two axes.
    """
    length = wp.sqrt(mapped[0] * mapped[0] + mapped[1] * mapped[1] + mapped[2] * mapped[2])
    if length > 0.999999:
        return 0.0
    length = wp.max(length, 0.05)
    return 2.0 * (1.0 - length) / length


@wp.func
def facing_normal(normal: wp.vec3f, smooth: wp.vec3f, view: wp.vec3f) -> wp.vec3f:
    """Return a tilted normal turned back until the view reflected by it leaves the surface.

    In the plane of both normals, let n be at the angle a from the smooth normal z. The reflected
    view r = 2 (n.v) n - v has r.z = A cos(2 a - phi), where A and phi are the polar coordinates
    of the view's projection. It is at least c for 2 a <= phi + acos(c / A), to which a is cut off;
    c is below v.z, so that the smooth normal itself is never turned.

    Args:
        normal: Unit tilted normal.
        smooth: Unit normal before the tilt, on the viewer's side.
        view: Unit direction towards the viewer.
    """
    upright = wp.dot(normal, smooth)
    across = normal - upright * smooth
    sine = wp.length(across)
    if sine < 1.0e-6:
        return smooth
    across = across / sine
    x = wp.dot(view, across)
    z = wp.dot(view, smooth)
    least = wp.min(z - 0.1 * wp.abs(z), LEAST_RISE)
    size = wp.max(wp.sqrt(x * x + z * z), 1.0e-6)
    most = 0.5 * (wp.atan2(x, z) + wp.acos(wp.clamp(least / size, -1.0, 1.0)))
    angle = wp.atan2(sine, upright)
    if angle <= most:
        return normal
    most = wp.max(most, 0.0)
    return wp.cos(most) * smooth + wp.sin(most) * across


@wp.func
def relieved(geometry: Geometry, materials: Materials, point: Point) -> Point:
    """Return a point with the normal of its material's maps, and the relief they hold below it.

    Worth calling where bit 6 of ``Materials.flags`` is set. Maps speak of the outside of the
    surface, so that a hill is a pit from behind.
    """
    mapping = materials.constant[point.material, INPUT_NORMAL]
    bumping = materials.constant[point.material, INPUT_BUMP]
    normal = point.side * point.normal
    variance = float(0.0)
    if mapping[3] > 0.0:
        mapped = read_input(geometry, materials, point, INPUT_NORMAL)
        frame = _frame(geometry, point, wp.int32(mapping[3]) - 1)
        normal = mapped_normal(frame, mapped, normal)
        slot = materials.slot[point.material, INPUT_NORMAL]
        if slot >= 0:
            if materials.slot_texture[slot] >= 0:
                variance = shortening_variance(mapped)
    if bumping[3] > 0.0:
        # Slopes along s and t, and their squares.
        mean = read_input(geometry, materials, point, INPUT_BUMP)
        row = wp.int32(bumping[3]) - 1
        frame_s = _frame(geometry, point, row)
        frame_t = _frame(geometry, point, row + 1)
        along_s = bumping[0] * wp.vec3f(frame_s[0], frame_s[1], frame_s[2])
        along_t = bumping[0] * wp.vec3f(frame_t[0], frame_t[1], frame_t[2])
        gradient = mean[0] * along_s + mean[1] * along_t
        normal = wp.normalize(normal - gradient + wp.dot(gradient, normal) * normal)
        variance += wp.max(mean[2] - mean[0] * mean[0], 0.0) * wp.dot(along_s, along_s)
        variance += wp.max(mean[3] - mean[1] * mean[1], 0.0) * wp.dot(along_t, along_t)
    found = point
    found.normal = facing_normal(point.side * normal, point.normal, point.view)
    found.relief_variance = variance
    return found
