"""Lights with a place, seen from any position: directions to them, and what they send.

Reads: ``LocalLights``. The geometry is in ``light_shapes``.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_pictures import Guides, guided_weight, sample_guided
from usdskin.warp_kernels.light_shapes import (
    PI,
    disk_weight,
    meet_flat,
    meet_sphere,
    meet_tube,
    sample_disk,
    sample_line,
    sample_sphere,
    sample_tube,
    sphere_weight,
    tube_weight,
)

KIND_RECT = wp.constant(0)
KIND_DISK = wp.constant(1)
KIND_SPHERE = wp.constant(2)
KIND_CYLINDER = wp.constant(3)
KIND_POINT = wp.constant(4)
KIND_LINE = wp.constant(5)

SHAPE_CONE = wp.constant(1)
SHAPE_FOCUS = wp.constant(2)
SHAPE_PROFILE = wp.constant(4)


@wp.struct
class LocalLights:
    """Lights that have a place, in world space [m].

    A light is one coefficient channel, or three where its color varies over it or with direction.
    A channel's spectrum is radiance; of a point it is radiant intensity, of a line radiance times
    its width.
    """

    count: wp.int32

    kind: wp.array[wp.int32]
    """0 rectangle, 1 disk, 2 sphere, 3 cylinder, 4 point, 5 line, shape [count]."""

    center: wp.array[wp.vec3f]

    axis_x: wp.array[wp.vec3f]
    axis_y: wp.array[wp.vec3f]
    axis_z: wp.array[wp.vec3f]
    """Unit axes at right angles, of either handedness, shape [count]. A rectangle and a disk shine
    along -z, a cylinder and a line lie along x; shaping turns about -z."""

    half: wp.array[wp.vec2f]
    """Half width and half height of a rectangle; half length and radius of a cylinder or line; else
    the radius twice [m], shape [count]."""

    channel: wp.array[wp.vec3i]
    """(group, first lane, 1 or 3 channels), shape [count]."""

    shaping: wp.array[wp.int32]
    """Bit 0 cone, 1 focus, 2 profile, shape [count]."""

    cone: wp.array[wp.vec2f]
    """Angles off the axis where the cone begins to fade, and where it ends [rad], shape [count]."""

    focus: wp.array[wp.vec4f]
    """Tint (the first of them where there is one channel), and the exponent, shape [count]."""

    profile: wp.array[wp.vec3i]
    """(first value, rows, columns) of its intensity over the angles, shape [count]."""

    profile_step: wp.array[wp.vec3f]
    """Angles between rows and columns [rad], and angleScale, shape [count]."""

    profile_value: wp.array[wp.float32]
    """Rows from theta 0 (along -z), columns from phi 0 (+x) towards +y, both ends included."""

    texture: wp.array[wp.vec3i]
    """(first texel, width, height) of a rectangle's picture, width 0 without one, shape [count]."""

    texel: wp.array[wp.vec3f]
    """Rows from the top (+y), columns from +x; constant over each texel."""

    guides: Guides
    """Where the pictures are bright."""


@wp.struct
class LightSample:
    """One direction to a light.

    Irradiance is the mean over samples of ``radiance * weight * cos``.
    """

    direction: wp.vec3f
    """Unit vector from the position to the light."""

    distance: wp.float32
    """[m]."""

    weight: wp.float32
    """1 / probability density per solid angle [sr]; 0 where the light cannot be seen. Of a point or
    a line, which have no solid angle, what their channel is to be multiplied by."""

    pdf: wp.float32
    """Density per solid angle [1/sr]; 0 for points and lines."""

    delta: wp.int32
    """1 for points and lines: no direction drawn otherwise ever meets them."""

    radiance: wp.vec4f
    """Emission in the four channels of the light's group: shaping and picture."""


@wp.struct
class LightHit:
    """Where a ray meets a light."""

    distance: wp.float32
    """[m]; -1 where it does not."""

    radiance: wp.vec4f
    """Emission in the four channels of the light's group."""


# --- Emission ----------------------------------------------------------------------------------


@wp.func
def smooth_step(x: wp.float32, low: wp.float32, high: wp.float32):
    """Return 3 t^2 - 2 t^3 of x between low and high, a step at high where they are equal."""
    if x <= low:
        return float(0.0)
    if x >= high:
        return float(1.0)
    t = (x - low) / (high - low)
    return t * t * (3.0 - 2.0 * t)


@wp.func
def _profile_value(lights: LocalLights, k: wp.int32, emission: wp.vec3f):
    """Return the intensity profile in a direction of the light's frame, linear in both angles."""
    place = lights.profile[k]
    step = lights.profile_step[k]
    theta = wp.atan2(wp.sqrt(emission[0] * emission[0] + emission[1] * emission[1]), -emission[2])
    if step[2] > 0.0:
        theta = theta / step[2]
    elif step[2] < 0.0:
        theta = (theta - PI) / -step[2] + PI
    if theta < 0.0 or theta > PI * 1.000001:
        return float(0.0)
    phi = wp.atan2(emission[1], emission[0])
    if phi < 0.0:
        phi += 2.0 * PI
    y = wp.clamp(theta / step[0], 0.0, float(place[1] - 1))
    x = wp.clamp(phi / step[1], 0.0, float(place[2] - 1))
    row = wp.min(int(y), wp.max(place[1] - 2, 0))
    column = wp.min(int(x), wp.max(place[2] - 2, 0))
    below = wp.min(row + 1, place[1] - 1)
    right = wp.min(column + 1, place[2] - 1)
    fy = y - float(row)
    fx = x - float(column)
    top = place[0] + row * place[2]
    bottom = place[0] + below * place[2]
    return wp.lerp(
        wp.lerp(lights.profile_value[top + column], lights.profile_value[top + right], fx),
        wp.lerp(lights.profile_value[bottom + column], lights.profile_value[bottom + right], fx),
        fy,
    )


@wp.func
def _emission(lights: LocalLights, k: wp.int32, at: wp.vec2f, emission: wp.vec3f):
    """Return what leaves a light in a direction, in its group's channels.

    Args:
        lights: The lights.
        k: Index of the light.
        at: Place on a rectangle, as parts of its width and height from (-x, -y).
        emission: Unit direction in the light's frame.
    """
    value = wp.vec3f(1.0, 1.0, 1.0)
    size = lights.texture[k]
    if size[1] > 0:
        column = wp.clamp(int((1.0 - at[0]) * float(size[1])), 0, size[1] - 1)
        row = wp.clamp(int((1.0 - at[1]) * float(size[2])), 0, size[2] - 1)
        value = lights.texel[size[0] + row * size[1] + column]
    flags = lights.shaping[k]
    if flags != 0:
        if flags & SHAPE_FOCUS:
            focus = lights.focus[k]
            tint = wp.vec3f(focus[0], focus[1], focus[2])
            factor = wp.pow(wp.min(wp.abs(emission[2]), 1.0), focus[3])
            value = wp.cw_mul(value, tint + factor * (wp.vec3f(1.0, 1.0, 1.0) - tint))
        if flags & SHAPE_CONE:
            off = wp.atan2(
                wp.sqrt(emission[0] * emission[0] + emission[1] * emission[1]), -emission[2]
            )
            cone = lights.cone[k]
            fade = float(0.0)
            if off > cone[1]:
                fade = float(1.0)
            elif cone[0] < cone[1]:
                fade = smooth_step(off, cone[0], cone[1])
            value *= 1.0 - fade
        if flags & SHAPE_PROFILE:
            value *= _profile_value(lights, k, emission)
    channel = lights.channel[k]
    result = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    if channel[2] == 3:
        if channel[1] == 0:
            result = wp.vec4f(value[0], value[1], value[2], 0.0)
        else:
            result = wp.vec4f(0.0, value[0], value[1], value[2])
    else:
        result[channel[1]] = value[0]
    return result


# --- The interface -------------------------------------------------------------------------------


@wp.func
def _to_light(lights: LocalLights, k: wp.int32, v: wp.vec3f):
    return wp.vec3f(
        wp.dot(v, lights.axis_x[k]), wp.dot(v, lights.axis_y[k]), wp.dot(v, lights.axis_z[k])
    )


@wp.func
def _part(gap: wp.vec3f, half: wp.vec2f, point: wp.vec3f):
    """Return where on a rectangle a point relative to the position is."""
    return wp.vec2f(
        0.5 + 0.5 * (point[0] - gap[0]) / half[0], 0.5 + 0.5 * (point[1] - gap[1]) / half[1]
    )


@wp.func
def sample_local_light(lights: LocalLights, k: wp.int32, position: wp.vec3f, u: wp.vec2f):
    """Return a direction to a light.

    Args:
        lights: The lights.
        k: Index of the light.
        position: Point that is lit [m].
        u: Two numbers in [0, 1).
    """
    sample = LightSample()
    kind = lights.kind[k]
    half = lights.half[k]
    gap = _to_light(lights, k, lights.center[k] - position)
    drawn = wp.vec4f(gap[0], gap[1], gap[2], 0.0)
    if kind == KIND_RECT:
        drawn = sample_guided(lights.guides, k, gap, half, u)
    elif kind == KIND_DISK:
        drawn = sample_disk(gap, half[0], u)
    elif kind == KIND_SPHERE:
        drawn = sample_sphere(gap, half[0], u)
    elif kind == KIND_CYLINDER:
        drawn = sample_tube(gap, half, u)
    elif kind == KIND_POINT:
        sample.delta = 1
        drawn[3] = 1.0 / wp.max(wp.dot(gap, gap), 1.0e-30)
    else:
        sample.delta = 1
        drawn = sample_line(gap, half[0], u[0])
    point = wp.vec3f(drawn[0], drawn[1], drawn[2])
    sample.distance = wp.length(point)
    if drawn[3] > 0.0 and sample.distance > 0.0:
        local = point / sample.distance
        sample.direction = wp.normalize(
            local[0] * lights.axis_x[k] + local[1] * lights.axis_y[k] + local[2] * lights.axis_z[k]
        )
        sample.radiance = _emission(lights, k, _part(gap, half, point), -local)
        sample.weight = drawn[3]
        if sample.delta == 0:
            sample.pdf = 1.0 / drawn[3]
    return sample


@wp.func
def _meet(lights: LocalLights, k: wp.int32, gap: wp.vec3f, ray: wp.vec3f):
    """Return how far along a ray in the light's frame a light is, -1 where it is not seen."""
    kind = lights.kind[k]
    half = lights.half[k]
    t = float(-1.0)
    if kind == KIND_RECT:
        t = meet_flat(gap, half, ray, 0)
    elif kind == KIND_DISK:
        t = meet_flat(gap, half, ray, 1)
    elif kind == KIND_SPHERE:
        t = meet_sphere(gap, half[0], ray)
    elif kind == KIND_CYLINDER:
        t = meet_tube(gap, half, ray)
    return t


@wp.func
def intersect_local_light(lights: LocalLights, k: wp.int32, origin: wp.vec3f, direction: wp.vec3f):
    """Return where a ray meets a light that shines towards its origin.

    Args:
        lights: The lights.
        k: Index of the light.
        origin: Start of the ray [m].
        direction: Unit vector.
    """
    hit = LightHit()
    gap = _to_light(lights, k, lights.center[k] - origin)
    ray = _to_light(lights, k, direction)
    hit.distance = _meet(lights, k, gap, ray)
    if hit.distance >= 0.0:
        part = _part(gap, lights.half[k], hit.distance * ray)
        hit.radiance = _emission(lights, k, part, -ray)
    return hit


@wp.func
def local_light_pdf(lights: LocalLights, k: wp.int32, position: wp.vec3f, direction: wp.vec3f):
    """Return the density [1/sr] with which ``sample_local_light`` draws a direction; 0 where never.

    Args:
        lights: The lights.
        k: Index of the light.
        position: Point that is lit [m].
        direction: Unit vector.
    """
    gap = _to_light(lights, k, lights.center[k] - position)
    ray = _to_light(lights, k, direction)
    t = _meet(lights, k, gap, ray)
    if t < 0.0:
        return float(0.0)
    kind = lights.kind[k]
    half = lights.half[k]
    weight = float(0.0)
    if kind == KIND_RECT:
        weight = guided_weight(lights.guides, k, gap, half, t * ray)
    elif kind == KIND_DISK:
        weight = disk_weight(gap, half[0], t * ray)
    elif kind == KIND_SPHERE:
        weight = sphere_weight(gap, half[0])
    else:
        weight = tube_weight(gap, half, t * ray)
    if weight <= 0.0:
        return float(0.0)
    return 1.0 / weight
