"""Rectangles, disks, spheres and tubes seen from a point: sampling, densities, intersection.

Everything is in the frame of the shape: ``gap`` is its centre relative to the point. Samples are
spread by the solid angle they cover, or close to it, with maps that keep the strata of their two
numbers together. Differences of nearly equal numbers are expanded, so that the float32 weights hold
for shapes far away and for shapes that are almost touched.
"""

from __future__ import annotations

import warp as wp

PI = wp.constant(3.14159265358979)
_AREA_HEIGHT = wp.constant(1.5)  # radii above its plane from where a disk is sampled by area


# --- Spans -------------------------------------------------------------------------------------


@wp.func
def sine_span(d: wp.float32, y0: wp.float32, y1: wp.float32):
    """Return sin(a1) - sin(a0) with tan(a) = y / d: what a segment at distance d covers.

    sin a1 - sin a0 = (cos a0 + cos a1) tan((a1 - a0) / 2), which loses no digits.
    """
    r0 = wp.sqrt(d * d + y0 * y0)
    r1 = wp.sqrt(d * d + y1 * y1)
    turned = d * (y1 - y0)
    along = d * d + y0 * y1
    tangent = float(0.0)
    if along >= 0.0:
        tangent = turned / (r0 * r1 + along)
    else:
        tangent = (r0 * r1 - along) / wp.max(turned, 1.0e-37)
    return (d / r0 + d / r1) * tangent


@wp.func
def _sine_point(d: wp.float32, y0: wp.float32, y1: wp.float32, span: wp.float32, v: wp.float32):
    """Return the y whose sine lies at the part v of a span."""
    sign = float(1.0)
    low = y0
    part = v
    if y0 + y1 < 0.0:
        sign = -1.0
        low = -y1
        part = 1.0 - v
    r = wp.sqrt(d * d + low * low)
    missing = float(0.0)  # 1 - sin
    if low > 0.0:
        missing = d * d / (r * (r + low))
    else:
        missing = (r - low) / r
    missing = wp.max(missing - part * span, 1.0e-12)
    y = d * (1.0 - missing) / wp.sqrt(missing * (2.0 - missing))
    return wp.clamp(sign * y, y0, y1)


@wp.func
def _angle_span(d: wp.float32, x0: wp.float32, x1: wp.float32):
    """Return the angle that a segment at distance d covers [rad]."""
    return wp.atan2(d * (x1 - x0), d * d + x0 * x1)


@wp.func
def _angle_point(d: wp.float32, x0: wp.float32, x1: wp.float32, angle: wp.float32):
    """Return the x that lies an angle after x0, seen from distance d."""
    c = wp.cos(angle)
    s = wp.sin(angle)
    below = d * c - x0 * s
    x = x1
    if below > 0.0:
        x = d * (x0 * c + d * s) / below
    return wp.clamp(x, x0, x1)


@wp.func
def _outside(x0: wp.float32, x1: wp.float32):
    """Return how far an interval is from 0."""
    return wp.max(wp.max(x0, -x1), 0.0)


@wp.func
def concentric_disk(u: wp.vec2f):
    """Return the point of the unit disk for a point of the unit square; areas are kept.

    Shirley and Chiu 1997, A low distortion map between disk and square.
    """
    x = 2.0 * u[0] - 1.0
    y = 2.0 * u[1] - 1.0
    if x == 0.0 and y == 0.0:
        return wp.vec2f(0.0, 0.0)
    if wp.abs(x) > wp.abs(y):
        angle = 0.25 * PI * (y / x)
        return wp.vec2f(x * wp.cos(angle), x * wp.sin(angle))
    angle = 0.25 * PI * (x / y)
    return wp.vec2f(y * wp.sin(angle), y * wp.cos(angle))


@wp.func
def _foot_point(height: wp.float32, r0: wp.float32, r1: wp.float32, v: wp.float32):
    """Return the radius at the part v of the cosines between two radii on a plane."""
    s0 = wp.sqrt(height * height + r0 * r0)
    s1 = wp.sqrt(height * height + r1 * r1)
    # height / s falls linearly; 1 / s = 1 / s0 - v drop.
    drop = (r1 - r0) * (r1 + r0) / (s0 * s1 * (s0 + s1))
    s = 1.0 / (1.0 / s0 - v * drop)
    squared = r0 * r0 + (s - s0) * (s + s0)
    return wp.clamp(wp.sqrt(wp.max(squared, 0.0)), r0, r1)


@wp.func
def _any_tangent(direction: wp.vec3f):
    """Return a unit vector at a right angle to a unit vector."""
    if wp.abs(direction[0]) > 0.8:
        return wp.normalize(wp.vec3f(-direction[2], 0.0, direction[0]))
    return wp.normalize(wp.vec3f(0.0, direction[2], -direction[1]))


@wp.func
def _direction_2d(gap: wp.vec3f, offset: wp.float32):
    if offset > 0.0:
        return wp.vec2f(gap[0] / offset, gap[1] / offset)
    return wp.vec2f(1.0, 0.0)


# --- Densities, as weights 1 / pdf [sr] ----------------------------------------------------------


@wp.func
def _disk_weight(radius: wp.float32, height: wp.float32, offset: wp.float32, at: wp.vec2f):
    """Return the weight of a point on a disk.

    Args:
        radius: Of the disk [m].
        height: Of the position above its plane [m].
        offset: Distance of the position's foot on that plane from the centre [m].
        at: Point on the disk from the foot; x points to the centre [m].
    """
    if height >= _AREA_HEIGHT * radius:
        squared = height * height + wp.dot(at, at)
        return PI * radius * radius * height / (squared * wp.sqrt(squared))
    r = wp.max(wp.length(at), 1.0e-30)
    middle = offset * at[0] / r
    side = offset * at[1] / r
    half = wp.sqrt(wp.max(radius * radius - side * side, 0.0))
    r1 = middle + half
    s1 = wp.sqrt(height * height + r1 * r1)
    if offset >= radius:
        r0 = wp.max(offset * offset - radius * radius, 0.0) / wp.max(r1, 1.0e-30)
        s0 = wp.sqrt(height * height + r0 * r0)
        return 2.0 * PI * radius * radius * height / (s0 * s1 * (s0 + s1))
    # The rim's point beyond is at x = r1 at / r, seen from the foot.
    toward = (r1 * at[0] / r - offset) / radius
    return 2.0 * PI * radius * (radius + offset * toward) / (s1 * (s1 + height))


@wp.func
def _sphere_weight(radius: wp.float32, away: wp.float32):
    """Return the solid angle of a sphere whose centre is ``away``, outside of it."""
    squared = wp.min(radius / away, 1.0)
    squared = squared * squared
    return 2.0 * PI * squared / (1.0 + wp.sqrt(1.0 - squared))


@wp.func
def _tube_distance(radius: wp.float32, away: wp.float32, angle: wp.float32):
    """Return how far, across the axis, a tube's surface is in a direction off its middle."""
    s = away * wp.sin(angle)
    inner = wp.sqrt(wp.max(radius * radius - s * s, 0.0))
    return (away - radius) * (away + radius) / (away * wp.cos(angle) + inner)


# --- Samples: (point relative to the position, weight), weight 0 where the shape is not seen ------


@wp.func
def sample_rect(gap: wp.vec3f, half: wp.vec2f, u: wp.vec2f):
    """Return a point on a rectangle that shines along -z, and its weight.

    The first coordinate is uniform in its angle, the second in its sine: their product is the solid
    angle of the row the point is in. The first one is that which is farther to the side. (Urena and
    others 2013 also make the rows equal, at the price of float32 far away.)
    """
    if gap[2] <= 0.0:
        return wp.vec4f(gap[0], gap[1], gap[2], 0.0)
    x0 = gap[0] - half[0]
    x1 = gap[0] + half[0]
    y0 = gap[1] - half[1]
    y1 = gap[1] + half[1]
    if _outside(x0, x1) >= _outside(y0, y1):
        span = _angle_span(gap[2], x0, x1)
        x = _angle_point(gap[2], x0, x1, u[0] * span)
        d = wp.sqrt(gap[2] * gap[2] + x * x)
        sines = sine_span(d, y0, y1)
        return wp.vec4f(x, _sine_point(d, y0, y1, sines, u[1]), gap[2], span * sines)
    span = _angle_span(gap[2], y0, y1)
    y = _angle_point(gap[2], y0, y1, u[1] * span)
    d = wp.sqrt(gap[2] * gap[2] + y * y)
    sines = sine_span(d, x0, x1)
    return wp.vec4f(_sine_point(d, x0, x1, sines, u[0]), y, gap[2], span * sines)


@wp.func
def sample_disk(gap: wp.vec3f, radius: wp.float32, u: wp.vec2f):
    """Return a point on a disk that shines along -z, and its weight."""
    if gap[2] <= 0.0:
        return wp.vec4f(gap[0], gap[1], gap[2], 0.0)
    offset = wp.sqrt(gap[0] * gap[0] + gap[1] * gap[1])
    toward = _direction_2d(gap, offset)
    disk = concentric_disk(u)
    at = wp.vec2f(offset + radius * disk[0], radius * disk[1])
    if gap[2] < _AREA_HEIGHT * radius:
        if offset >= radius:
            # Lines through the foot, spread as the chords of a disk; on each the cosine.
            chord = wp.sqrt(wp.max(1.0 - disk[1] * disk[1], 0.0))
            v = wp.clamp(0.5 + 0.5 * disk[0] / wp.max(chord, 1.0e-30), 0.0, 1.0)
            sine = radius * disk[1] / offset
            cosine = wp.sqrt(wp.max(1.0 - sine * sine, 0.0))
            r1 = wp.max(offset * cosine + radius * chord, 1.0e-30)
            r0 = (offset - radius) * (offset + radius) / r1
            at = _foot_point(gap[2], r0, r1, v) * wp.vec2f(cosine, sine)
        else:
            # Lines from the foot to the rim.
            r = wp.length(disk)
            rim = wp.vec2f(1.0, 0.0)
            if r > 0.0:
                rim = disk / r
            far = wp.vec2f(offset + radius * rim[0], radius * rim[1])
            r1 = wp.max(wp.length(far), 1.0e-30)
            at = _foot_point(gap[2], 0.0, r1, wp.min(r * r, 1.0)) / r1 * far
    weight = _disk_weight(radius, gap[2], offset, at)
    x = toward[0] * at[0] - toward[1] * at[1]
    y = toward[1] * at[0] + toward[0] * at[1]
    return wp.vec4f(x, y, gap[2], weight)


@wp.func
def sample_sphere(gap: wp.vec3f, radius: wp.float32, u: wp.vec2f):
    """Return a point on a sphere, and its weight."""
    away = wp.length(gap)
    if away <= radius:
        return wp.vec4f(gap[0], gap[1], gap[2], 0.0)
    weight = _sphere_weight(radius, away)
    disk = concentric_disk(u)
    missing = wp.dot(disk, disk) * weight / (2.0 * PI)  # 1 - cos
    sine = wp.sqrt(wp.max(missing * (2.0 - missing), 0.0))
    middle = gap / away
    first = _any_tangent(middle)
    second = wp.cross(middle, first)
    r = wp.max(wp.length(disk), 1.0e-30)
    around = (disk[0] / r) * first + (disk[1] / r) * second
    inner = wp.sqrt(wp.max(radius * radius - away * away * sine * sine, 0.0))
    distance = (away - radius) * (away + radius) / (away * (1.0 - missing) + inner)
    point = distance * ((1.0 - missing) * middle + sine * around)
    return wp.vec4f(point[0], point[1], point[2], weight)


@wp.func
def sample_tube(gap: wp.vec3f, half: wp.vec2f, u: wp.vec2f):
    """Return a point on a tube along x, without its ends, and its weight."""
    radius = half[1]
    away = wp.sqrt(gap[1] * gap[1] + gap[2] * gap[2])
    if away <= radius:
        return wp.vec4f(gap[0], gap[1], gap[2], 0.0)
    widest = wp.asin(radius / away)
    angle = (2.0 * u[1] - 1.0) * widest
    d = _tube_distance(radius, away, angle)
    sines = sine_span(d, gap[0] - half[0], gap[0] + half[0])
    x = _sine_point(d, gap[0] - half[0], gap[0] + half[0], sines, u[0])
    c = d * wp.cos(angle) / away
    s = d * wp.sin(angle) / away
    return wp.vec4f(x, c * gap[1] - s * gap[2], s * gap[1] + c * gap[2], 2.0 * widest * sines)


@wp.func
def sample_line(gap: wp.vec3f, half_length: wp.float32, u: wp.float32):
    """Return a point on a line along x, and its weight per width of the line [1/m]."""
    d = wp.sqrt(gap[1] * gap[1] + gap[2] * gap[2])
    if d <= 0.0:
        return wp.vec4f(gap[0], gap[1], gap[2], 0.0)
    sines = sine_span(d, gap[0] - half_length, gap[0] + half_length)
    x = _sine_point(d, gap[0] - half_length, gap[0] + half_length, sines, u)
    return wp.vec4f(x, gap[1], gap[2], sines / d)


# --- Rays: distance, -1 where the shape is missed or seen from behind ----------------------------


@wp.func
def meet_flat(gap: wp.vec3f, half: wp.vec2f, ray: wp.vec3f, round: wp.int32):
    """Return how far along a ray a rectangle, or a disk, that shines along -z is."""
    if gap[2] <= 0.0 or ray[2] <= 0.0:
        return float(-1.0)
    t = gap[2] / ray[2]
    x = t * ray[0] - gap[0]
    y = t * ray[1] - gap[1]
    if round != 0:
        if x * x + y * y > half[0] * half[0]:
            return float(-1.0)
    elif wp.abs(x) > half[0] or wp.abs(y) > half[1]:
        return float(-1.0)
    return t


@wp.func
def meet_sphere(gap: wp.vec3f, radius: wp.float32, ray: wp.vec3f):
    """Return how far along a ray a sphere is."""
    middle = wp.dot(gap, ray)
    away = wp.length(gap)
    beside = gap - middle * ray
    inner = radius * radius - wp.dot(beside, beside)
    if away <= radius or middle <= 0.0 or inner < 0.0:
        return float(-1.0)
    return (away - radius) * (away + radius) / (middle + wp.sqrt(inner))


@wp.func
def meet_tube(gap: wp.vec3f, half: wp.vec2f, ray: wp.vec3f):
    """Return how far along a ray a tube along x is."""
    radius = half[1]
    across = wp.sqrt(ray[1] * ray[1] + ray[2] * ray[2])
    away = wp.sqrt(gap[1] * gap[1] + gap[2] * gap[2])
    if away <= radius or across <= 0.0:
        return float(-1.0)
    middle = (gap[1] * ray[1] + gap[2] * ray[2]) / across
    beside = (gap[1] * ray[2] - gap[2] * ray[1]) / across
    inner = radius * radius - beside * beside
    if middle <= 0.0 or inner < 0.0:
        return float(-1.0)
    t = (away - radius) * (away + radius) / (middle + wp.sqrt(inner)) / across
    if wp.abs(t * ray[0] - gap[0]) > half[0]:
        return float(-1.0)
    return t


# --- Weights of points met along a ray -----------------------------------------------------------


@wp.func
def rect_weight(gap: wp.vec3f, half: wp.vec2f, point: wp.vec3f):
    """Return the weight with which ``sample_rect`` draws a point relative to the position."""
    x0 = gap[0] - half[0]
    x1 = gap[0] + half[0]
    y0 = gap[1] - half[1]
    y1 = gap[1] + half[1]
    if _outside(x0, x1) >= _outside(y0, y1):
        d = wp.sqrt(gap[2] * gap[2] + point[0] * point[0])
        return _angle_span(gap[2], x0, x1) * sine_span(d, y0, y1)
    d = wp.sqrt(gap[2] * gap[2] + point[1] * point[1])
    return _angle_span(gap[2], y0, y1) * sine_span(d, x0, x1)


@wp.func
def disk_weight(gap: wp.vec3f, radius: wp.float32, point: wp.vec3f):
    """Return the weight with which ``sample_disk`` draws a point relative to the position."""
    offset = wp.sqrt(gap[0] * gap[0] + gap[1] * gap[1])
    toward = _direction_2d(gap, offset)
    x = toward[0] * point[0] + toward[1] * point[1]
    y = toward[0] * point[1] - toward[1] * point[0]
    return _disk_weight(radius, gap[2], offset, wp.vec2f(x, y))


@wp.func
def sphere_weight(gap: wp.vec3f, radius: wp.float32):
    """Return the weight of every point of ``sample_sphere``."""
    return _sphere_weight(radius, wp.length(gap))


@wp.func
def tube_weight(gap: wp.vec3f, half: wp.vec2f, point: wp.vec3f):
    """Return the weight with which ``sample_tube`` draws a point relative to the position."""
    away = wp.sqrt(gap[1] * gap[1] + gap[2] * gap[2])
    d = wp.sqrt(point[1] * point[1] + point[2] * point[2])
    return 2.0 * wp.asin(half[1] / away) * sine_span(d, gap[0] - half[0], gap[0] + half[0])
