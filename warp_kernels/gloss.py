"""Reflections of prefiltered light by GGX lobes."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.diffuse import first_lamp
from usdskin.warp_kernels.lookup import (
    PI,
    frame_coordinates,
    lookup_fresnel,
    lookup_gloss,
    lookup_lustre,
)
from usdskin.warp_kernels.reflection import Reflection, deposit, fresnel_rise
from usdskin.warp_kernels.structs import Film, Lights, Materials
from usdskin.warp_kernels.surface import Point

wp.set_module_options({"enable_backward": False})


@wp.func
def widened(alpha: wp.float32, variance: wp.float32) -> wp.float32:
    """Return a GGX alpha with the relief below the footprint: alpha^2 is a variance of slopes."""
    if variance <= 0.0:
        return alpha
    return wp.min(wp.sqrt(alpha * alpha + variance), 1.0)


@wp.func
def ggx(alpha: wp.float32, nh: wp.float32, nl: wp.float32, nv: wp.float32) -> wp.float32:
    """Return D G2 / (4 n.v) of the GGX microfacet lobe (Walter et al. 2007, Heitz 2014)."""
    a2 = alpha * alpha
    d = nh * nh * (a2 - 1.0) + 1.0
    density = a2 / (PI * d * d)
    mask = nv * wp.sqrt(a2 + (1.0 - a2) * nl * nl) + nl * wp.sqrt(a2 + (1.0 - a2) * nv * nv)
    return density * nl / (2.0 * wp.max(mask, 1.0e-7))


@wp.func
def _lobe(
    lights: Lights, group: wp.int32, alpha: wp.float32, point: Point, r: Reflection,
    coordinates: wp.vec2f, width: wp.float32, part: wp.float32, index: wp.float32,
    tint: wp.float32, white: wp.float32,
) -> wp.vec4f:  # fmt: skip
    """Return light reflected by one GGX lobe with Fresnel tint F0 + white (1 - F0) rise.

    ``tint`` and ``white`` select the two parts; ``part`` is their directional albedo,
    ``width`` q of what is prefiltered.
    """
    total = part * lookup_gloss(lights, group, width * alpha, coordinates)
    for k in range(first_lamp(lights, group), lights.gloss_end[group]):
        azimuth = lights.lamp_azimuth[k]
        elevation = lights.lamp_elevation[k]
        # As wide as a lobe that shows a lamp much larger than itself at the lamp's radiance.
        spread = wp.length(azimuth) * wp.length(elevation) / PI
        parts = wp.where(spread > 0.1 * alpha * alpha, 2, 1)
        split = 0.5 * wp.float32(parts - 1)
        spread = spread / wp.float32(parts * parts)
        reflected = float(0.0)
        for q in range(parts * parts):
            u = split * (2.0 * wp.float32(q % parts) - wp.float32(parts - 1))
            v = split * (2.0 * wp.float32(q / parts) - wp.float32(parts - 1))
            toward = wp.normalize(lights.lamp_center[k] + u * azimuth + v * elevation)
            nl = wp.dot(point.normal, toward)
            if nl > 0.0:
                half = wp.normalize(toward + point.view)
                between = wp.max(wp.dot(point.view, half), 1.0e-3)
                wide = wp.clamp(wp.sqrt(alpha * alpha + spread / between), 1.0e-3, 1.0)
                rise = fresnel_rise(index, r.f0, between)
                lobe = ggx(wide, wp.dot(point.normal, half), nl, r.nv)
                reflected += lobe * (tint * (1.0 - rise) + white * rise)
        total += (reflected / wp.float32(parts * parts)) * lights.lamp_flux[k]
    return total


@wp.func
def _response(lights: Lights, materials: Materials, alpha: wp.float32, r: Reflection) -> wp.vec3f:
    """Return an untinted lobe's directional albedo, k and q."""
    if r.index > 0.0:
        return lookup_lustre(materials, r.lustre, alpha, r.nv)
    response = lookup_fresnel(lights, alpha, r.nv)
    return wp.vec3f(r.f0 * response[0] + response[1], response[2], response[3])


@wp.func
def _around(point: Point, nv: wp.float32, k: wp.float32) -> wp.vec3f:
    """Return the mean direction of a lobe."""
    return wp.normalize((2.0 * nv + k) * point.normal - point.view)


@wp.func
def first_glossy_row(lights: Lights, materials: Materials, material: wp.int32) -> wp.int32:
    """Return the row of a material's white reflections, which follow its diffuse rows."""
    passes = 1
    if materials.kind[material] == 1:
        passes = 2 + 2 * materials.passage_rank[material]
    return passes * materials.weight_count[material] * lights.group_count


@wp.func
def shade_gloss(
    lights: Lights, materials: Materials, film: Film, pixel: wp.int32, point: Point, r: Reflection
) -> wp.float32:
    """Deposit prefiltered reflections: the white lobes, the clearcoat and the tinted lobe."""
    if r.shine <= 0.0 and r.coat <= 0.0:
        return 0.0
    m = point.material
    groups = lights.group_count
    row = first_glossy_row(lights, materials, m)
    one = _response(lights, materials, r.alpha, r)
    two = _response(lights, materials, r.second_alpha, r)
    coat = lookup_fresnel(lights, r.coat_alpha, r.nv)
    plain = lookup_fresnel(lights, r.alpha, r.nv)
    first = wp.vec2f(0.0, 0.0)
    second = wp.vec2f(0.0, 0.0)
    third = wp.vec2f(0.0, 0.0)
    y = float(0.0)
    for g in range(groups):
        first = frame_coordinates(lights, g, _around(point, r.nv, one[1]), first)
        light = (1.0 - r.second) * _lobe(
            lights, g, r.alpha, point, r, first, one[2], one[0], r.index, r.f0, 1.0
        )
        if r.second > 0.0:
            second = frame_coordinates(lights, g, _around(point, r.nv, two[1]), second)
            light += r.second * _lobe(
                lights, g, r.second_alpha, point, r, second, two[2], two[0], r.index, r.f0, 1.0
            )
        light = r.shine * light
        if r.coat > 0.0:
            second = frame_coordinates(lights, g, _around(point, r.nv, coat[2]), second)
            part = 0.04 * coat[0] + coat[1]
            light += r.coat * _lobe(
                lights, g, r.coat_alpha, point, r, second, coat[3], part, 0.0, 0.04, 1.0
            )
        y += deposit(materials, film, pixel, m, row + g, light)
        if r.tints > 0:
            third = frame_coordinates(lights, g, _around(point, r.nv, plain[2]), third)
            light = r.shine * _lobe(
                lights, g, r.alpha, point, r, third, plain[3], plain[0], 0.0, 1.0, 0.0
            )
            for j in range(r.tints):
                at = row + (1 + j) * groups + g
                y += deposit(materials, film, pixel, m, at, r.tint[wp.min(j, 3)] * light)
    return y
