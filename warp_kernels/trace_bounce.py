"""Light that comes by way of one other surface."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.diffuse import light_of, linked
from usdskin.warp_kernels.light_tree import light_number, sample_tree, tree_light
from usdskin.warp_kernels.lookup import frame_coordinates
from usdskin.warp_kernels.preview_surface import reflect_preview_surface
from usdskin.warp_kernels.reflection import Reflection, base_weight, deposit
from usdskin.warp_kernels.sampling import TWO_PI, around, hash_pair, low_discrepancy
from usdskin.warp_kernels.skin import reflect_skin
from usdskin.warp_kernels.structs import INPUT_EMISSION, Film, Geometry, Lights, Materials
from usdskin.warp_kernels.surface import Point, read_input
from usdskin.warp_kernels.trace_structs import (
    BOUNCE_DIMENSION,
    FAR,
    LIGHT_DIMENSION,
    SKIN_MIX,
    Trace,
)
from usdskin.warp_kernels.view import UNKNOWN, Ray, meet, surface_point
from usdskin.warp_kernels.visibility import cross_bodies, gap_of, origin_on, surface_opacity

wp.set_module_options({"enable_backward": False})


@wp.func
def bounce(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, trace: Trace,
    pixel: wp.int32, key: wp.uint32, index: wp.int32, point: Point, r: Reflection,
) -> wp.float32:  # fmt: skip
    """Deposit the light that comes by way of one other surface; return its Y.

    What that surface sends out is its shadowed diffuse reflection and its emission.
    """
    m = point.material
    is_skin = materials.kind[m] == 1
    wrap = float(0.0)
    if is_skin:
        wrap = lights.wrap[materials.wrap_set[m]]
    u = low_discrepancy(trace.sobol, key, index, BOUNCE_DIMENSION)
    x = wp.sqrt(wrap * wrap + u * (1.0 + 2.0 * wrap)) - wrap  # density (x + l) / (pi (1 + 2 l))
    x = wp.max(x, 1.0e-4)
    angle = TWO_PI * low_discrepancy(trace.sobol, key, index, BOUNCE_DIMENSION + 1)
    sine = wp.sqrt(wp.max(1.0 - x * x, 0.0))
    toward = around(point.normal, wp.vec3f(sine * wp.cos(angle), sine * wp.sin(angle), x))
    if wp.dot(toward, point.geometric) <= 0.0:
        return 0.0
    ray = Ray()
    ray.origin = point.position + gap_of(point.size) * point.geometric
    ray.direction = toward
    ray.spread = 0.1
    ray.length = FAR
    met = meet(geometry, ray, 0.0, UNKNOWN)
    if met.face < 0:
        return 0.0
    other = surface_point(geometry, ray, met)
    opacity = surface_opacity(geometry, materials, other)
    h = other.material
    passes = int(1)
    back = Reflection()
    own = int(-1)
    mix = float(0.0)
    if materials.kind[h] == 1:
        back = reflect_skin(geometry, lights, materials, other, 1.0)
        passes = 2
        own = other.prim
        mix = SKIN_MIX
    else:
        back = reflect_preview_surface(geometry, lights, materials, other, 1.0, opacity)
    density = (x + wrap) / (3.14159265 * (1.0 + 2.0 * wrap))
    k1 = r.diffuse * x / density
    k2 = float(0.0)
    if is_skin:
        k2 = r.diffuse * (x + wrap) / (1.0 + wrap) / density
    other_wrap = lights.wrap[materials.wrap_set[h]]
    other_key = hash_pair(key, wp.uint32(77))
    v = wp.vec3f(
        low_discrepancy(trace.sobol, other_key, index, LIGHT_DIMENSION),
        low_discrepancy(trace.sobol, other_key, index, LIGHT_DIMENSION + 1),
        low_discrepancy(trace.sobol, other_key, index, LIGHT_DIMENSION + 2),
    )
    sample = sample_tree(trace.tree, other.normal, other_wrap, mix, v)
    lost = float(0.0)
    cosine = float(0.0)
    if sample.scale > 0.0:
        cosine = wp.dot(other.normal, sample.direction)
        crossing = cross_bodies(
            geometry, materials, origin_on(materials, other),
            sample.direction, FAR, own,
            materials.passage_limit[h], lights.links, light_number(trace.tree, sample),
        )  # fmt: skip
        lost = 1.0 - crossing.clear
        if crossing.length > 0.0:
            lost = 1.0
    rank = materials.passage_rank[h]
    kernels = wp.where(rank > 0, 3, passes)
    coordinates = wp.vec2f(0.0, 0.0)
    groups = lights.group_count
    y = float(0.0)
    for g in range(groups):
        coordinates = frame_coordinates(lights, g, other.normal, coordinates)
        light = light_of(lights, materials.wrap_set[h], kernels, g, other, coordinates)
        j1 = light.lambert
        j2 = light.wrap
        if rank > 0:
            j2 = (j1 + other_wrap * light.front) / (1.0 + other_wrap)
        if lost > 0.0:
            missing = lost * linked(lights, other.prim, g, tree_light(trace.tree, sample, g))
            j1 = j1 - wp.max(cosine, 0.0) * missing
            if rank == 0 or cosine > 0.0:
                j2 = j2 - wp.max((cosine + other_wrap) / (1.0 + other_wrap), 0.0) * missing
        for p in range(passes):
            for j in range(materials.weight_count[h]):
                sent = (back.diffuse * base_weight(back.low, back.high, j)) * j1
                if p == 1:
                    sent = (back.diffuse * base_weight(back.low, back.high, j)) * j2
                row = (p * materials.weight_count[h] + j) * groups + g
                y += _receive(materials, film, pixel, m, r, h, row, k1, k2, sent)
    if (materials.flags[h] & 16) != 0:
        emission = read_input(geometry, materials, other, INPUT_EMISSION)
        sent = wp.vec4f(emission[0], emission[1], emission[2], 0.0)
        row = materials.weight_count[h] * groups
        y += _receive(materials, film, pixel, m, r, h, row, k1, k2, sent)
    return y


@wp.func
def _receive(
    materials: Materials, film: Film, pixel: wp.int32, material: wp.int32, r: Reflection,
    sender: wp.int32, row: wp.int32, k1: wp.float32, k2: wp.float32, sent: wp.vec4f,
) -> wp.float32:  # fmt: skip
    """Deposit what one row of another surface sends here; return its Y."""
    bases = materials.weight_count[material]
    first = materials.indirect_row[material] + materials.sent_row[sender] + row
    y = float(0.0)
    for j in range(bases):
        weight = base_weight(r.low, r.high, j)
        at = first + j * materials.sent_count
        y += deposit(materials, film, pixel, material, at, (weight * k1) * sent)
        if k2 > 0.0:
            at = first + (bases + j) * materials.sent_count
            y += deposit(materials, film, pixel, material, at, (weight * k2) * sent)
    return y
