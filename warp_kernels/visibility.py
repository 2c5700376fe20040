"""What stands between a point and a light: other bodies block, the own body weakens.

DESIGN section 2, "Visibility is E'": towards L the total length s inside the body that is shaded
attenuates both diffuse terms by exp(-s delta); every other body blocks by its opacity.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import LightLinks, shades
from usdskin.warp_kernels.skin import Point, read_input
from usdskin.warp_kernels.structs import INPUT_OPACITY, INPUT_THICKNESS, Geometry, Materials

wp.set_module_options({"enable_backward": False})

MAX_CROSSINGS = wp.constant(64)

LEAST_CLEAR = wp.constant(1.0e-4)
"""Light weakened below this share of itself is blocked."""


@wp.struct
class Crossing:
    """What became of the light of one direction."""

    clear: wp.float32
    """Share that other bodies let pass [1]."""

    length: wp.float32
    """Way inside the own body [m]."""


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


@wp.func
def _opacity_at(
    geometry: Geometry, materials: Materials, face: wp.int32, u: wp.float32, v: wp.float32
) -> wp.float32:
    material = geometry.material[face]
    if materials.slot[material, INPUT_OPACITY] < 0:
        if materials.constant[material, INPUT_OPACITY][0] >= 1.0:
            return 1.0
    return surface_opacity(geometry, materials, _point_at(geometry, face, u, v))


@wp.func
def _thickness_at(
    geometry: Geometry, materials: Materials, face: wp.int32, u: wp.float32, v: wp.float32
) -> wp.float32:
    """Return how thick a sheet is [m]."""
    point = _point_at(geometry, face, u, v)
    return wp.max(read_input(geometry, materials, point, INPUT_THICKNESS)[0], 0.0)


@wp.func
def _point_at(geometry: Geometry, face: wp.int32, u: wp.float32, v: wp.float32) -> Point:
    point = Point()
    point.material = geometry.material[face]
    point.corner = 3 * face
    point.barycentric = wp.vec3f(u, v, 1.0 - u - v)
    point.triangle_area = 1.0
    return point


@wp.func
def lift(point: Point) -> wp.vec4f:
    """Return a point just off its surface, on the viewer's side, and by how much [m].

    The gap follows the size of the triangle's coordinates, whose rounding it has to exceed.
    """
    gap = 4.0e-6 * wp.max(point.size, 1.0e-3)
    p = point.position + gap * point.geometric
    return wp.vec4f(p[0], p[1], p[2], gap)


@wp.func
def cross_bodies(
    geometry: Geometry,
    materials: Materials,
    start_at: wp.vec4f,
    direction: wp.vec3f,
    distance: wp.float32,
    own: wp.int32,
    limit: wp.float32,
    links: LightLinks,
    light: wp.int32,
) -> Crossing:
    """Follow light backwards from a point to its source.

    The first crossing of the own body enters it, the next one leaves, and so on: the origin lies
    outside (``lift``). Light that enters and never leaves, as in a mesh that is not closed, is
    blocked. Where such a mesh says how thick it is, it is a sheet: every crossing adds its
    thickness, the first too, as the origin lies on the viewer's side.

    Args:
        geometry: The scene.
        materials: Whose opacities block.
        start_at: A lifted point and its gap [m] (``lift``).
        direction: Unit vector towards the light.
        distance: How far the light is [m].
        own: Prim whose skin weakens instead of blocking, -1 where there is none.
        limit: Length inside the own body beyond which nothing is left [m]; 0 where the body is
            perfectly clear.
        links: Whose shadows lights see.
        light: Number of the light, -1 for anything that is not a light.
    """
    result = Crossing()
    result.clear = 1.0
    origin = wp.vec3f(start_at[0], start_at[1], start_at[2])
    gap = start_at[3]
    start = float(0.0)
    entered = float(-1.0)
    last = int(-1)
    last_t = float(-1.0)
    last_sign = float(0.0)
    for _k in range(MAX_CROSSINGS):
        reach = distance - start
        if entered >= 0.0:
            reach = wp.min(reach, limit - result.length)
        hit = wp.mesh_query_ray(geometry.mesh, origin + start * direction, direction, reach)
        if not hit.result:
            if entered >= 0.0:
                result.clear = 0.0
            return result
        t = start + hit.t
        # A triangle is crossed once, and an edge that two of them share is one crossing.
        repeated = hit.face == last or (t - last_t < gap and hit.sign == last_sign)
        if repeated:
            start = t + 0.25 * gap
        else:
            last = hit.face
            last_t = t
            last_sign = hit.sign
            start = t
            inside = geometry.prim[hit.face] == own
            if inside:
                inside = materials.kind[geometry.material[hit.face]] == 1
            if inside:
                if limit > 0.0:
                    if geometry.sheet[own] != 0:
                        result.length += _thickness_at(geometry, materials, hit.face, hit.u, hit.v)
                    elif entered < 0.0:
                        entered = t
                    else:
                        result.length += t - entered
                        entered = -1.0
                    if result.length >= limit:
                        result.clear = 0.0
                        return result
            elif light < 0 or shades(links, geometry.prim[hit.face], light):
                opacity = _opacity_at(geometry, materials, hit.face, hit.u, hit.v)
                result.clear = result.clear * (1.0 - opacity)
                if result.clear < LEAST_CLEAR:
                    result.clear = 0.0
                    return result
    result.clear = 0.0
    return result
