"""The directions of light that a visible point takes, and what its block of pixels knows of it."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import reaches
from usdskin.warp_kernels.light_tree import TreeSample, light_number, sample_tree, tree_light
from usdskin.warp_kernels.reflection import Reflection
from usdskin.warp_kernels.sampling import low_discrepancy
from usdskin.warp_kernels.structs import Film, Geometry, Lights, Materials
from usdskin.warp_kernels.surface import Point
from usdskin.warp_kernels.trace_bounce import bounce
from usdskin.warp_kernels.trace_diffuse import (
    beam_share,
    shade_beam,
    shade_local_light,
    straight_y,
)
from usdskin.warp_kernels.trace_gloss import deposit_gloss, lobes_towards, shine
from usdskin.warp_kernels.trace_guide import is_guided, remember, sample_part
from usdskin.warp_kernels.trace_structs import (
    FAR,
    GLOSS_DIMENSION,
    LIGHT_DIMENSION,
    SKIN_MIX,
    Trace,
)
from usdskin.warp_kernels.visibility import cross_bodies, origin_on

wp.set_module_options({"enable_backward": False})


@wp.func
def _draw(trace: Trace, key: wp.uint32, index: wp.int32, first: wp.int32) -> wp.vec3f:
    """Return three coordinates of a sample's point."""
    return wp.vec3f(
        low_discrepancy(trace.sobol, key, index, first),
        low_discrepancy(trace.sobol, key, index, first + 1),
        low_discrepancy(trace.sobol, key, index, first + 2),
    )


@wp.func
def shade_directions(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, trace: Trace,
    pixel: wp.int32, key: wp.uint32, first: wp.int32, point: Point, r: Reflection,
    block: wp.int32, guided: wp.bool,
) -> wp.vec3f:  # fmt: skip
    """Deposit a point's directions from each kind of light.

    Returns Y, the Y of the first half of the directions without ``trace.weight``, and of all Y
    what was weakened. ``block`` is that of the pixel, -1 where nothing is learnt; ``guided``
    whether it answers here.
    """
    m = point.material
    own = int(-1)
    mix = float(0.0)
    if materials.kind[m] == 1:
        own = point.prim
        mix = SKIN_MIX
    glossy = r.shine > 0.0 or r.coat > 0.0
    wrap = lights.wrap[materials.wrap_set[m]]
    weakened = float(0.0)
    y = float(0.0)
    half = float(0.0)
    for index in range(first, first + trace.split):
        if index == first + trace.split / 2:
            half = y + weakened / trace.weight
        u = _draw(trace, key, index, LIGHT_DIMENSION)
        sample = TreeSample()
        given = float(1.0)
        if guided:
            sample = sample_part(trace.tree, trace.guide, block, point.normal, wrap, mix, u)
            given = trace.guide.known[block, trace.guide.leaf_part[sample.leaf]]
        else:
            sample = sample_tree(trace.tree, point.normal, wrap, mix, u)
            if block >= 0:
                given = trace.guide.given[block]
        if sample.scale > 0.0:
            number = light_number(trace.tree, sample)
            lobes = wp.vec3f(0.0, 0.0, 0.0)
            if glossy:
                lobes = lobes_towards(materials, point, r, sample.direction)
            reached = reaches(lights.links, point.prim, number)
            x = wp.dot(point.normal, sample.direction)
            lit = r.diffuse > 0.0 and x > wp.where(own >= 0, -wrap, 0.0)
            if reached and (lit or lobes[0] + lobes[1] > 0.0):
                crossing = cross_bodies(
                    geometry, materials, origin_on(materials, point),
                    sample.direction, FAR, own,
                    materials.passage_limit[m], lights.links, number,
                )  # fmt: skip
                share = beam_share(lights, materials, point, sample.direction, crossing, given)
                seen = float(0.0)
                groups = int(lights.group_count)
                if crossing.length <= 0.0:
                    seen = crossing.clear
                    if sample.dome >= 0:
                        seen = seen * sample.density / (sample.density + lobes[2])
                changed = share.change != 0.0 or share.through > 0.0
                if not changed and (seen <= 0.0 or lobes[0] + lobes[1] <= 0.0):
                    groups = 0  # spares reading the texel
                change = float(0.0)
                straight = float(0.0)
                for g in range(groups):
                    light = tree_light(trace.tree, sample, g)
                    change += shade_beam(
                        lights, materials, film, pixel, point, r, g, trace.weight * light, share
                    )
                    if share.through > 0.0:
                        straight += straight_y(lights, materials, point, r, g, light, share)
                    if lobes[0] + lobes[1] > 0.0 and seen > 0.0:
                        y += deposit_gloss(
                            lights, materials, film, pixel, m, r, g, seen * light, lobes
                        )
                weakened += change
                if block >= 0 and lit:
                    arrived = given + share.change
                    if share.through > 0.0 and straight != 0.0:
                        arrived = given + change / (trace.weight * straight)
                    if materials.passage_rank[m] > 0 and x <= 0.0:
                        arrived = given - (arrived - given)  # nothing is given of it
                    remember(trace.guide, block, sample.leaf, wp.clamp(arrived, 0.0, 1.0))
        for k in range(trace.local.count):
            y += shade_local_light(
                geometry, lights, materials, film, trace, pixel, key, index, point, r, own, k
            )
        if glossy:
            u = _draw(trace, key, index, GLOSS_DIMENSION)
            y += shine(
                geometry, lights, materials, film, trace, pixel, point, r, own, mix, u,
                wp.where(guided, block, -1),
            )  # fmt: skip
        if materials.sent_count > 0 and r.diffuse > 0.0:
            y += bounce(geometry, lights, materials, film, trace, pixel, key, index, point, r)
    return wp.vec3f(weakened + y, half, weakened)


@wp.func
def face_block(
    lights: Lights, materials: Materials, trace: Trace, pixel: wp.int32, block: wp.int32,
    point: Point, r: Reflection, layer: wp.int32,
) -> wp.bool:  # fmt: skip
    """Have a block know of a surface; return whether it answers there."""
    wrap = lights.wrap[materials.wrap_set[point.material]]
    mix = float(0.0)
    if materials.kind[point.material] == 1:
        mix = SKIN_MIX
    if layer == 0:
        facing = trace.guide.facing[pixel]
        n = point.normal
        trace.guide.facing[pixel] = wp.vec4f(
            facing[0] + n[0], facing[1] + n[1], facing[2] + n[2],
            wp.max(facing[3], wp.where(mix > 0.0, wrap, -1.0)),
        )  # fmt: skip
        if r.shine > 0.0 or r.coat > 0.0:
            trace.guide.glossy[pixel] = 1
    return is_guided(trace.guide, block, point.normal, wrap, mix)
