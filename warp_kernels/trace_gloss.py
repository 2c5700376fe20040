"""Lustre and reflections: GGX lobes, sampled and weighed against the light tree (MIS)."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.gloss import first_glossy_row, ggx
from usdskin.warp_kernels.light_links import reaches
from usdskin.warp_kernels.light_tree import dome_texel_towards, tree_density
from usdskin.warp_kernels.local_lights import intersect_local_light, local_light_pdf
from usdskin.warp_kernels.reflection import Reflection, deposit, fresnel_rise
from usdskin.warp_kernels.sampling import TWO_PI, around
from usdskin.warp_kernels.structs import Film, Geometry, Lights, Materials
from usdskin.warp_kernels.surface import Point
from usdskin.warp_kernels.trace_guide import part_density
from usdskin.warp_kernels.trace_structs import FAR, Trace
from usdskin.warp_kernels.visibility import cross_bodies, origin_on

wp.set_module_options({"enable_backward": False})


@wp.func
def lobes_towards(materials: Materials, point: Point, r: Reflection, toward: wp.vec3f) -> wp.vec3f:
    """Return the lobes' values towards a direction, cosine included.

    The white reflections, the tinted one per unit of tint, and the density [1/sr] with which
    ``_sample_lobe`` chooses the direction.
    """
    nl = wp.dot(point.normal, toward)
    if nl <= 0.0:
        return wp.vec3f(0.0, 0.0, 0.0)
    half = wp.normalize(toward + point.view)
    nh = wp.clamp(wp.dot(point.normal, half), 0.0, 1.0)
    rise = fresnel_rise(r.index, r.f0, wp.dot(point.view, half))
    first = ggx(wp.max(r.alpha, 1.0e-3), nh, nl, r.nv)
    single = first
    density = (1.0 - r.second) * _half_density(r.alpha, nh, r.nv)
    if r.second > 0.0:
        single = (1.0 - r.second) * first
        single += r.second * ggx(wp.max(r.second_alpha, 1.0e-3), nh, nl, r.nv)
        density += r.second * _half_density(r.second_alpha, nh, r.nv)
    white = r.shine * single * (r.f0 * (1.0 - rise) + rise)
    if r.coat > 0.0:
        share = _coat_share(r)
        coat = ggx(wp.max(r.coat_alpha, 1.0e-3), nh, nl, r.nv)
        coat_rise = fresnel_rise(0.0, 0.04, wp.dot(point.view, half))
        white += r.coat * coat * (0.04 * (1.0 - coat_rise) + coat_rise)
        density = (1.0 - share) * density + share * _half_density(r.coat_alpha, nh, r.nv)
    return wp.vec3f(white, r.shine * first * (1.0 - rise), density)


@wp.func
def _coat_share(r: Reflection) -> wp.float32:
    return 0.5 * r.coat / wp.max(r.coat + r.shine, 1.0e-6)


@wp.func
def _half_density(alpha: wp.float32, nh: wp.float32, nv: wp.float32) -> wp.float32:
    """Return the density [1/sr] of directions mirrored at visible GGX normals (Heitz 2018)."""
    a = wp.max(alpha, 1.0e-3)
    a2 = a * a
    d = nh * nh * (a2 - 1.0) + 1.0
    masked = 2.0 * nv / (nv + wp.sqrt(a2 + (1.0 - a2) * nv * nv))
    return masked * a2 / (3.14159265 * d * d) / (4.0 * nv)


@wp.func
def _sample_lobe(point: Point, r: Reflection, u: wp.vec3f) -> wp.vec3f:
    """Choose a lobe and mirror the view at one of its visible normals (Dupuy and Benyoub 2023)."""
    alpha = r.alpha
    pick = float(u[0])
    share = float(0.0)
    if r.coat > 0.0:
        share = _coat_share(r)
    if pick < share:
        alpha = r.coat_alpha
    elif (pick - share) / (1.0 - share) < r.second:
        alpha = r.second_alpha
    alpha = wp.max(alpha, 1.0e-3)
    n = point.normal
    tangent = around(n, wp.vec3f(1.0, 0.0, 0.0))
    bitangent = wp.cross(n, tangent)
    view = wp.vec3f(wp.dot(point.view, tangent), wp.dot(point.view, bitangent), r.nv)
    stretched = wp.normalize(wp.vec3f(alpha * view[0], alpha * view[1], view[2]))
    angle = TWO_PI * u[1]
    z = (1.0 - u[2]) * (1.0 + stretched[2]) - stretched[2]
    sine = wp.sqrt(wp.clamp(1.0 - z * z, 0.0, 1.0))
    cap = wp.vec3f(sine * wp.cos(angle), sine * wp.sin(angle), z) + stretched
    half = wp.normalize(wp.vec3f(alpha * cap[0], alpha * cap[1], wp.max(cap[2], 0.0)))
    mirrored = 2.0 * wp.dot(view, half) * half - view
    return mirrored[0] * tangent + mirrored[1] * bitangent + mirrored[2] * n


@wp.func
def deposit_gloss(
    lights: Lights, materials: Materials, film: Film, pixel: wp.int32, material: wp.int32,
    r: Reflection, group: wp.int32, light: wp.vec4f, lobes: wp.vec3f,
) -> wp.float32:  # fmt: skip
    """Deposit light of one channel group that the lobes reflect; return its Y."""
    row = first_glossy_row(lights, materials, material) + group
    y = deposit(materials, film, pixel, material, row, lobes[0] * light)
    for j in range(r.tints):
        at = row + (1 + j) * lights.group_count
        share = lobes[1] * r.tint[wp.min(j, 3)]
        y += deposit(materials, film, pixel, material, at, share * light)
    return y


@wp.func
def shine(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, trace: Trace,
    pixel: wp.int32, point: Point, r: Reflection, own: wp.int32, mix: wp.float32, u: wp.vec3f,
    block: wp.int32,
) -> wp.float32:  # fmt: skip
    """Follow one reflected ray to the lights, weighed against their own samples; return its Y.

    ``block`` is the block that guides those, -1 where none does.
    """
    toward = _sample_lobe(point, r, u)
    lobes = lobes_towards(materials, point, r, toward)
    if lobes[2] <= 0.0:
        return 0.0
    m = point.material
    if materials.passage_limit[m] > 0.0:
        own = -1  # a body that dims the diffuse light blocks its reflections
    y = float(0.0)
    domes = trace.tree.dome_size.shape[0]
    wrap = lights.wrap[materials.wrap_set[m]]
    for dome in range(domes):
        if reaches(lights.links, point.prim, dome):
            crossing = cross_bodies(
                geometry,
                materials,
                origin_on(materials, point),
                toward,
                FAR,
                own,
                0.0,
                lights.links,
                dome,
            )
            if crossing.clear > 0.0:
                texel = dome_texel_towards(trace.tree, dome, toward)
                other = float(0.0)
                if block >= 0:
                    other = part_density(
                        trace.tree, trace.guide, block, dome, texel, point.normal, wrap, mix
                    )
                else:
                    other = tree_density(trace.tree, dome, texel, point.normal, wrap, mix)
                size = trace.tree.dome_size[dome]
                first = trace.tree.dome_first[dome]
                for g in range(first[3]):
                    light = trace.tree.dome_texel[first[0] + g * size[0] * size[1] + texel]
                    light = (crossing.clear / (lobes[2] + other)) * light
                    y += deposit_gloss(
                        lights, materials, film, pixel, m, r, first[2] + g, light, lobes
                    )
    for k in range(trace.local.count):
        number = trace.first_local + k
        if reaches(lights.links, point.prim, number):
            hit = intersect_local_light(trace.local, k, point.position, toward)
            if hit.distance > 0.0:
                crossing = cross_bodies(
                    geometry, materials, origin_on(materials, point),
                    toward, 0.99999 * hit.distance, own, 0.0,
                    lights.links, number,
                )  # fmt: skip
                other = local_light_pdf(trace.local, k, point.position, toward)
                light = (crossing.clear / (lobes[2] + other)) * hit.radiance
                group = trace.local.channel[k][0]
                y += deposit_gloss(lights, materials, film, pixel, m, r, group, light, lobes)
    return y
