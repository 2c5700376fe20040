"""Shadows that were measured before, at the points of a picture.

Of diffuse light they change what ``usdskin.warp_kernels.transfer_gather`` summed at the vertices.
Of reflections they hide a part: the directions a vertex sees are looked up around the mirrored
view, as wide as the lobe is.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import latlong_coordinates
from usdskin.warp_kernels.reflection import Reflection, base_weight
from usdskin.warp_kernels.sampling import tangent_of
from usdskin.warp_kernels.structs import Film, Geometry, Lights, Materials
from usdskin.warp_kernels.surface import Point

wp.set_module_options({"enable_backward": False})


@wp.func
def has_transfer(geometry: Geometry, point: Point) -> bool:
    """Return whether shadows were measured on the side of the surface that is seen."""
    if geometry.transfer_vertex.shape[0] == 0:
        return False
    corner = point.corner
    if geometry.transfer_vertex[corner] < 0:
        return False
    return wp.dot(geometry.corner_normal[corner], point.normal) > 0.0


@wp.func
def deposit_transfer(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, pixel: wp.int32,
    point: Point, r: Reflection,
):  # fmt: skip
    """Deposit what measured shadows change of the diffuse rows (``transfer.gather_light``)."""
    m = point.material
    corner = point.corner
    first = geometry.transfer_vertex[corner]
    second = geometry.transfer_vertex[corner + 1]
    third = geometry.transfer_vertex[corner + 2]
    at = r.diffuse * point.barycentric
    groups = lights.group_count
    bases = materials.weight_count[m]
    passes = int(1)
    if materials.kind[m] == 1:
        passes = 2 + 2 * materials.passage_rank[m]
    for column in range(passes * groups):
        value = at[0] * geometry.transfer[first, column]
        value += at[1] * geometry.transfer[second, column]
        value += at[2] * geometry.transfer[third, column]
        if wp.dot(value, value) > 0.0:
            for j in range(bases):
                row = (column / groups * bases + j) * groups + column % groups
                film.channel[pixel, row] += base_weight(r.low, r.high, j) * value


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
