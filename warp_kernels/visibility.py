"""What stands between a point and a light: other bodies block, the own body weakens.

DESIGN section 2, "Visibility is E'": towards L the total length s inside the body that is shaded
attenuates both diffuse terms by exp(-s delta); every other body blocks by its opacity.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import LightLinks, shades
from usdskin.warp_kernels.structs import INPUT_OPACITY, INPUT_THICKNESS, Geometry, Materials
from usdskin.warp_kernels.surface import Point, read_input

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


@wp.struct
class Origin:
    """Where shadow rays begin: on a surface, seen from one side of it."""

    position: wp.vec3f
    """[m]."""

    normal: wp.vec3f
    """Unit normal of the triangle, on the viewer's side."""

    gap: wp.float32
    """How far off the surface rays begin [m]: it follows the size of the triangle's coordinates,
    whose rounding it has to exceed."""

    opaque: wp.int32
    """1 where nothing passes the surface itself."""


@wp.func
def gap_of(size: wp.float32) -> wp.float32:
    """Return the gap [m] beside a triangle with a largest coordinate of ``size`` [m]."""
    return 4.0e-6 * wp.max(size, 1.0e-3)


@wp.func
def origin_on(materials: Materials, point: Point) -> Origin:
    """Return where the shadow rays of a point begin."""
    origin = Origin()
    origin.position = point.position
    origin.normal = point.geometric
    origin.gap = gap_of(point.size)
    if materials.slot[point.material, INPUT_OPACITY] < 0:
        if materials.constant[point.material, INPUT_OPACITY][0] >= 1.0:
            origin.opaque = 1
    return origin


@wp.func
def _size_of(geometry: Geometry, face: wp.int32) -> wp.float32:
    """Return the largest coordinate of a triangle's corners [m]."""
    a = wp.abs(wp.mesh_get_point(geometry.mesh, 3 * face))
    b = wp.abs(wp.mesh_get_point(geometry.mesh, 3 * face + 1))
    c = wp.abs(wp.mesh_get_point(geometry.mesh, 3 * face + 2))
    return wp.max(wp.max(wp.max(a, b), c))


@wp.func
def cross_bodies(
    geometry: Geometry,
    materials: Materials,
    origin: Origin,
    direction: wp.vec3f,
    distance: wp.float32,
    own: wp.int32,
    limit: wp.float32,
    links: LightLinks,
    light: wp.int32,
) -> Crossing:
    """Follow light backwards from a point to its source.

    Crossings of the own body enter and leave it in turn; light from behind the surface begins
    inside. Light that enters and never leaves, as in a mesh that is not closed, is blocked. Where
    such a mesh says how thick it is, it is a sheet, and every crossing adds its thickness.

    Args:
        geometry: The scene.
        materials: Whose opacities block.
        origin: Where the ray begins (``origin_on``).
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
    cosine = wp.dot(direction, origin.normal)
    behind = cosine < 0.0
    if behind and own < 0 and origin.opaque != 0 and links.active == 0:
        result.clear = 0.0
        return result
    inside = int(0)
    entered = float(0.0)
    side = float(1.0)
    if behind and own >= 0:
        if geometry.sheet[own] == 0:
            side = -1.0
            if limit > 0.0:
                inside = 1
                entered = -origin.gap / wp.max(-cosine, 0.05)  # the way to where the ray begins
    begin = origin.position + (side * origin.gap) * origin.normal
    start = float(0.0)
    last = int(-1)
    last_t = float(-1.0)
    last_sign = float(0.0)
    near = float(origin.gap)
    for _k in range(MAX_CROSSINGS):
        reach = distance - start
        if inside != 0:
            reach = wp.min(reach, entered + limit - result.length - start)
        hit = wp.mesh_query_ray(geometry.mesh, begin + start * direction, direction, reach)
        if not hit.result:
            if inside != 0:
                result.clear = 0.0
            return result
        t = start + hit.t
        # A triangle is crossed once, and an edge that two of them share is one crossing.
        repeated = hit.face == last or (t - last_t < near and hit.sign == last_sign)
        if repeated:
            start = t + near
        else:
            last = hit.face
            last_t = t
            last_sign = hit.sign
            start = t
            is_own = geometry.prim[hit.face] == own
            if is_own:
                is_own = materials.kind[geometry.material[hit.face]] == 1
            if is_own:
                if limit > 0.0:
                    if geometry.sheet[own] != 0:
                        result.length += _thickness_at(geometry, materials, hit.face, hit.u, hit.v)
                    elif inside == 0:
                        inside = 1
                        entered = t
                    else:
                        result.length += t - entered
                        inside = 0
                    if result.length >= limit:
                        result.clear = 0.0
                        return result
            elif light < 0 or shades(links, geometry.prim[hit.face], light):
                opacity = _opacity_at(geometry, materials, hit.face, hit.u, hit.v)
                result.clear = result.clear * (1.0 - opacity)
                if result.clear < LEAST_CLEAR:
                    result.clear = 0.0
                    return result
            near = wp.max(origin.gap, 0.25 * gap_of(_size_of(geometry, hit.face)))
    result.clear = 0.0
    return result
