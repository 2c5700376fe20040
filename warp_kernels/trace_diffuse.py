"""One direction of light on a diffuse surface: what it adds, or takes from what the map gave."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import reaches
from usdskin.warp_kernels.local_lights import sample_local_light
from usdskin.warp_kernels.reflection import Reflection, base_weight, deposit
from usdskin.warp_kernels.sampling import hash_pair, low_discrepancy
from usdskin.warp_kernels.skin import passage_entry, passage_weight
from usdskin.warp_kernels.structs import Film, Geometry, Lights, Materials
from usdskin.warp_kernels.surface import Point
from usdskin.warp_kernels.trace_gloss import deposit_gloss, lobes_towards
from usdskin.warp_kernels.trace_structs import Trace
from usdskin.warp_kernels.visibility import Crossing, cross_bodies, origin_on

wp.set_module_options({"enable_backward": False})


@wp.struct
class Beam:
    """How light of one direction counts on a surface."""

    change: wp.float32
    """Weight of the light that comes straight, less what the map has given [1]."""

    through: wp.float32
    """Weight of the light that comes through the body [1]."""

    entry: wp.float32
    """Where its way lies in the table of exp(-s delta)."""

    lambert: wp.float32
    wrap: wp.float32
    """The two kernels of eq. (1)."""


@wp.func
def beam_share(
    lights: Lights, materials: Materials, point: Point, direction: wp.vec3f, crossing: Crossing,
    mapped: wp.float32,
) -> Beam:  # fmt: skip
    """Weigh light of one direction.

    Args:
        lights: The wraps.
        materials: The surfaces.
        point: What is lit.
        direction: Unit vector towards the light.
        crossing: What became of it on its way.
        mapped: 1 where the maps hold this light, unshadowed, 0 for lights that have a place.
    """
    beam = Beam()
    m = point.material
    rank = materials.passage_rank[m]
    x = wp.dot(point.normal, direction)
    beam.lambert = wp.max(x, 0.0)
    if materials.kind[m] == 1:
        wrap = lights.wrap[materials.wrap_set[m]]
        beam.wrap = wp.max((x + wrap) / (1.0 + wrap), 0.0)
    # What the maps have given already: all of it, or all that comes from in front of the skin.
    given = float(mapped)
    if rank > 0 and x <= 0.0:
        given = 0.0
    if rank > 0 and crossing.length > 0.0:
        beam.through = crossing.clear
        beam.entry = passage_entry(materials, m, crossing.length)
        beam.change = -given
    else:
        beam.change = crossing.clear - given
    return beam


@wp.func
def shade_beam(
    lights: Lights, materials: Materials, film: Film, pixel: wp.int32, point: Point,
    r: Reflection, group: wp.int32, light: wp.vec4f, beam: Beam,
) -> wp.float32:  # fmt: skip
    """Deposit light of one direction and channel group in the diffuse rows; return its Y."""
    if beam.change == 0.0 and beam.through <= 0.0:
        return 0.0
    m = point.material
    bases = materials.weight_count[m]
    span = bases * lights.group_count
    rank = materials.passage_rank[m]
    y = float(0.0)
    for j in range(bases):
        row = j * lights.group_count + group
        value = (r.diffuse * base_weight(r.low, r.high, j)) * light
        if beam.change != 0.0:
            straight = (beam.change * beam.lambert) * value
            y += deposit(materials, film, pixel, m, row, straight)
            if beam.wrap > 0.0:
                straight = (beam.change * beam.wrap) * value
                y += deposit(materials, film, pixel, m, span + row, straight)
        if beam.through > 0.0:
            for k in range(rank):
                passed = (beam.through * passage_weight(materials, m, beam.entry, k)) * value
                at = (2 + k) * span + row
                y += deposit(materials, film, pixel, m, at, beam.wrap * passed)
                at = (2 + rank + k) * span + row
                y += deposit(materials, film, pixel, m, at, beam.lambert * passed)
    return y


@wp.func
def straight_y(
    lights: Lights, materials: Materials, point: Point, r: Reflection, group: wp.int32,
    light: wp.vec4f, beam: Beam,
) -> wp.float32:  # fmt: skip
    """Return the Y of light of one direction and channel group that comes straight, all of it."""
    m = point.material
    bases = materials.weight_count[m]
    first = materials.row[m] + group
    y = float(0.0)
    for j in range(bases):
        row = first + j * lights.group_count
        part = beam.lambert * wp.dot(materials.xyz_y[row], light)
        if beam.wrap > 0.0:
            part += beam.wrap * wp.dot(materials.xyz_y[row + bases * lights.group_count], light)
        y += r.diffuse * base_weight(r.low, r.high, j) * part
    return y


@wp.func
def shade_local_light(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, trace: Trace,
    pixel: wp.int32, key: wp.uint32, index: wp.int32, point: Point, r: Reflection, own: wp.int32,
    k: wp.int32,
) -> wp.float32:  # fmt: skip
    """Deposit one direction to a light that has a place, diffuse and reflected; return its Y."""
    number = trace.first_local + k
    if not reaches(lights.links, point.prim, number):
        return 0.0
    light_key = hash_pair(key, wp.uint32(1000 + k))
    u = wp.vec2f(
        low_discrepancy(trace.sobol, light_key, index, 0),
        low_discrepancy(trace.sobol, light_key, index, 1),
    )
    sample = sample_local_light(trace.local, k, point.position, u)
    if sample.weight <= 0.0:
        return 0.0
    m = point.material
    nearest = -1.0
    if materials.kind[m] == 1:
        nearest = -lights.wrap[materials.wrap_set[m]]
    else:
        nearest = 0.0
    if wp.dot(point.normal, sample.direction) <= nearest:
        return 0.0
    crossing = cross_bodies(
        geometry, materials, origin_on(materials, point),
        sample.direction, 0.99999 * sample.distance, own,
        materials.passage_limit[m], lights.links, number,
    )  # fmt: skip
    if crossing.clear <= 0.0:
        return 0.0
    group = trace.local.channel[k][0]
    light = sample.weight * sample.radiance
    beam = beam_share(lights, materials, point, sample.direction, crossing, 0.0)
    y = shade_beam(lights, materials, film, pixel, point, r, group, light, beam)
    if (r.shine > 0.0 or r.coat > 0.0) and crossing.length <= 0.0:
        lobes = lobes_towards(materials, point, r, sample.direction)
        share = float(crossing.clear)
        if sample.delta == 0:
            share = share * sample.pdf / (sample.pdf + lobes[2])
        if lobes[0] + lobes[1] > 0.0:
            y += deposit_gloss(lights, materials, film, pixel, m, r, group, share * light, lobes)
    return y
