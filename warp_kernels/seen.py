"""How much of a reflection other surfaces hide, from shadows that were measured before.

The directions a vertex sees (``usdskin.warp_kernels.transfer``) are looked up around the mirrored
view, as wide as the lobe is.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import latlong_coordinates
from usdskin.warp_kernels.sampling import tangent_of
from usdskin.warp_kernels.skin import Point, Reflection, has_transfer
from usdskin.warp_kernels.structs import Geometry

wp.set_module_options({"enable_backward": False})


@wp.func
def _direction_towards(geometry: Geometry, toward: wp.vec3f) -> wp.int32:
    """Return the place of the direction nearest to one given."""
    rings = geometry.seen_ring.shape[0] - 1
    at = latlong_coordinates(geometry.seen_axes * toward)
    ring = wp.clamp(wp.int32(at[0] * wp.float32(rings)), 0, rings - 1)
    first = geometry.seen_ring[ring]
    length = geometry.seen_ring[ring + 1] - first
    along = wp.clamp(wp.int32(at[1] * wp.float32(length)), 0, length - 1)
    return geometry.seen_order[first + along]


@wp.func
def _seen(geometry: Geometry, point: Point, toward: wp.vec3f) -> wp.float32:
    """Return the share of a triangle's vertices that see a direction, near ones weighing more."""
    d = _direction_towards(geometry, toward)
    share = float(0.0)
    for k in range(3):
        row = geometry.seen_row[geometry.transfer_vertex[point.corner + k]]
        bits = geometry.seen_hidden[row, d / 32] >> wp.uint32(d % 32)
        if (bits & wp.uint32(1)) == wp.uint32(0):
            share += point.barycentric[k]
    return share


@wp.func
def _lobe_share(geometry: Geometry, point: Point, alpha: wp.float32) -> wp.float32:
    mirror = 2.0 * wp.dot(point.normal, point.view) * point.normal - point.view
    first = tangent_of(mirror)
    second = wp.cross(mirror, first)
    share = _seen(geometry, point, mirror)
    weight = float(1.0)
    for k in range(4):
        across = first
        if k >= 2:
            across = second
        side = wp.float32(k % 2) * 2.0 - 1.0
        toward = wp.normalize(mirror + (side * alpha) * across)
        if wp.dot(toward, point.normal) > 0.0:
            share += _seen(geometry, point, toward)
            weight += 1.0
    return share / weight


@wp.func
def hide_reflections(geometry: Geometry, point: Point, r: Reflection) -> Reflection:
    """Return a reflection whose lobes are weighed by what is seen around the mirrored view."""
    hidden = r
    if not has_transfer(geometry, point):
        return hidden
    if r.shine > 0.0:
        alpha = (1.0 - r.second) * r.alpha + r.second * r.second_alpha
        hidden.shine = r.shine * _lobe_share(geometry, point, alpha)
    if r.coat > 0.0:
        hidden.coat = r.coat * _lobe_share(geometry, point, r.coat_alpha)
    return hidden
