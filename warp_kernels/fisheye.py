"""Fisheye views: their projection, from tables, and lookups between their pixels.

The projection arrives tabulated from the host's float64 (``usdskin.fisheye``), so no
kernel knows the projections by name. With phi the angle from the optical axis, r(phi) is the image
height.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

CLIPPED = wp.constant(1)
MOVED = wp.constant(4)


@wp.struct
class Lens:
    """A fisheye lens."""

    center: wp.vec2f
    """Where the axis meets the picture [px]."""

    width: wp.int32
    height: wp.int32
    """Size of the picture [px]."""

    max_radius: wp.float32
    """Radius of the circle that holds picture [px]."""

    min_cosine: wp.float32
    """cos(phi / 2) at the largest angle."""

    by_cosine: wp.array[wp.vec3f]
    """r / (2 sin(phi / 2)) [px], 1 / V and blending weight at equal steps of cos(phi / 2) from 1
    to ``min_cosine``, shape [node_count]."""

    by_radius: wp.array[wp.vec4f]
    """sin(phi) / r [px^-1], cos(phi), solid angle [sr px^-2] and 1 / V at equal steps of r from 0
    to ``max_radius``, shape [node_count]."""


@wp.struct
class View:
    """One merged photograph and how it stands."""

    value: wp.array2d[wp.vec3f]
    """Image values I, before division by V, shape [height, width]."""

    variance: wp.array2d[wp.vec3f]
    """Their variance, shape [height, width]."""

    status: wp.array2d[wp.uint8]
    """Bits CLIPPED and MOVED, shape [height, width]."""

    block: wp.int32
    """Side of a block of pixels [px]."""

    flagged: wp.array2d[wp.uint8]
    """Not 0 for a block that has flagged pixels or lies beside one that has, shape [block_rows,
    block_columns]."""

    noise: wp.float32
    """Variance over value, relative to the other views."""

    camera_from_map: wp.mat33f
    """Rotation from the panorama to the camera."""

    reach: wp.float32
    """Cosine of the angle from the axis beyond which no texel that is seen has a corner."""


@wp.struct
class Sample:
    """A view, looked up between its pixels."""

    value: wp.vec3f
    """Image value over V."""

    variance: wp.vec3f
    """The mean of its pixels."""

    clipped: wp.float32
    moved: wp.float32
    """Shares of the value that come from pixels with these bits."""

    weight: wp.float32
    """1, or 0 where no pixel beside the position holds picture."""


# --- Projection --------------------------------------------------------------------------------


@wp.func
def half_cosine(ray: wp.vec3f) -> wp.float32:
    """Return cos(phi / 2) of a unit ray, accurate at both ends."""
    if ray[2] <= 0.0:
        return wp.sqrt(0.5 * (1.0 - ray[2]))
    across = ray[0] * ray[0] + ray[1] * ray[1]
    return wp.sqrt(0.5 * across / (1.0 + ray[2]))


@wp.func
def cosine_node(lens: Lens, cosine: wp.float32) -> wp.vec3f:
    """Return ``Lens.by_cosine`` at cos(phi / 2); beyond the rim only image height goes on."""
    last = lens.by_cosine.shape[0] - 1
    at = wp.max((1.0 - cosine) / (1.0 - lens.min_cosine), 0.0) * wp.float32(last)
    k = wp.min(wp.int32(at), last - 1)
    node = lens.by_cosine[k] + (at - wp.float32(k)) * (lens.by_cosine[k + 1] - lens.by_cosine[k])
    if at > wp.float32(last):
        rim = lens.by_cosine[last]
        node = wp.vec3f(node[0], rim[1], rim[2])
    return node


@wp.func
def radius_node(lens: Lens, radius: wp.float32) -> wp.vec4f:
    """Return ``Lens.by_radius`` at an image height [px]."""
    last = lens.by_radius.shape[0] - 1
    at = wp.min(radius / lens.max_radius, 1.0) * wp.float32(last)
    k = wp.min(wp.int32(at), last - 1)
    return lens.by_radius[k] + (at - wp.float32(k)) * (lens.by_radius[k + 1] - lens.by_radius[k])


@wp.func
def project(lens: Lens, ray: wp.vec3f) -> wp.vec4f:
    """Return (u, v) [px], 1 / V and the blending weight of a unit ray in the camera.

    Its image height per sin(phi) is r / (2 sin(phi / 2)), which changes gently with cos(phi / 2)
    for every projection, over the latter.
    """
    cosine = half_cosine(ray)
    node = cosine_node(lens, cosine)
    scale = node[0] / wp.max(cosine, 1.0e-6)
    u = lens.center[0] + scale * ray[0]
    v = lens.center[1] - scale * ray[1]
    return wp.vec4f(u, v, node[1], node[2])


@wp.func
def unproject(lens: Lens, position: wp.vec2f) -> wp.vec3f:
    """Return the unit ray of a position [px] within the circle."""
    offset = position - lens.center
    node = radius_node(lens, wp.length(offset))
    return wp.vec3f(node[0] * offset[0], -node[0] * offset[1], -node[1])


# --- Lookups -----------------------------------------------------------------------------------


@wp.func
def is_inner(lens: Lens, u: wp.float32, v: wp.float32) -> bool:
    """Return whether all four pixels around a position [px] hold picture."""
    x = u - lens.center[0]
    y = v - lens.center[1]
    radius = wp.max(lens.max_radius - 1.5, 0.0)
    is_within = u > 1.0 and u < wp.float32(lens.width - 1)
    is_within = is_within and v > 1.0 and v < wp.float32(lens.height - 1)
    return is_within and x * x + y * y < radius * radius


@wp.func
def lookup_inner(view: View, u: wp.float32, v: wp.float32) -> wp.vec3f:
    """Interpolate image values bilinearly where ``is_inner`` holds."""
    x = u - 0.5
    y = v - 0.5
    j = wp.int32(x)
    i = wp.int32(y)
    fx = x - wp.float32(j)
    fy = y - wp.float32(i)
    top = view.value[i, j] + fx * (view.value[i, j + 1] - view.value[i, j])
    bottom = view.value[i + 1, j] + fx * (view.value[i + 1, j + 1] - view.value[i + 1, j])
    return top + fy * (bottom - top)


@wp.func
def _add_pixel(
    lens: Lens, view: View, i: wp.int32, j: wp.int32, weight: wp.float32, sample: Sample
) -> Sample:
    row = wp.clamp(i, 0, lens.height - 1)
    column = wp.clamp(j, 0, lens.width - 1)
    x = wp.float32(column) + 0.5 - lens.center[0]
    y = wp.float32(row) + 0.5 - lens.center[1]
    radius = wp.sqrt(x * x + y * y)
    if weight > 0.0 and radius <= lens.max_radius:
        bits = wp.int32(view.status[row, column])
        scale = radius_node(lens, radius)[3]
        sample.value += (weight * scale) * view.value[row, column]
        sample.variance += (weight * scale * scale) * view.variance[row, column]
        sample.weight += weight
        if (bits & CLIPPED) != 0:
            sample.clipped += weight
        if (bits & MOVED) != 0:
            sample.moved += weight
    return sample


@wp.func
def lookup_view(lens: Lens, view: View, u: wp.float32, v: wp.float32) -> Sample:
    """Interpolate bilinearly between those of the four pixels around that hold picture.

    V is divided out before that: at the rim all pixels may lie on one side of the position.
    """
    sample = Sample()
    x = u - lens.center[0]
    y = v - lens.center[1]
    is_within = u >= 0.0 and u < wp.float32(lens.width)
    is_within = is_within and v >= 0.0 and v < wp.float32(lens.height)
    if not is_within or x * x + y * y > lens.max_radius * lens.max_radius:
        return sample
    j = wp.int32(wp.floor(u - 0.5))
    i = wp.int32(wp.floor(v - 0.5))
    fx = u - 0.5 - wp.float32(j)
    fy = v - 0.5 - wp.float32(i)
    sample = _add_pixel(lens, view, i, j, (1.0 - fy) * (1.0 - fx), sample)
    sample = _add_pixel(lens, view, i, j + 1, (1.0 - fy) * fx, sample)
    sample = _add_pixel(lens, view, i + 1, j, fy * (1.0 - fx), sample)
    sample = _add_pixel(lens, view, i + 1, j + 1, fy * fx, sample)
    if sample.weight > 0.0:
        part = 1.0 / sample.weight
        sample.value = part * sample.value
        sample.variance = part * sample.variance
        sample.clipped = part * sample.clipped
        sample.moved = part * sample.moved
        sample.weight = 1.0
    return sample


@wp.func
def is_flagged(view: View, u: wp.float32, v: wp.float32) -> bool:
    """Return whether flagged pixels may lie within a block's side of a position [px]."""
    row = wp.clamp(wp.int32(v) / view.block, 0, view.flagged.shape[0] - 1)
    column = wp.clamp(wp.int32(u) / view.block, 0, view.flagged.shape[1] - 1)
    return view.flagged[row, column] != wp.uint8(0)
