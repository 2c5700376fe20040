"""What a vertex gets under some light, of what was measured that it sees.

``gather_light`` sums what does not arrive, or arrives through the body, into what has to be added
to the unshadowed rows of ``shade_skin`` and ``shade_preview_surface``; the few lamps that are sharp
get rays of their own (``gather_lamps``). A vertex that sees everything gets zeros.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import LightLinks
from usdskin.warp_kernels.reflectance_map import mean_ramp, mean_step
from usdskin.warp_kernels.skin import passage_entry, passage_weight
from usdskin.warp_kernels.structs import Geometry, Lights, Materials
from usdskin.warp_kernels.transfer import FAR, blocks_all, off_surface
from usdskin.warp_kernels.transfer_structs import Directions, LampSets, Measured, Vertices
from usdskin.warp_kernels.visibility import Crossing, cross_bodies

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

LAMP_RAYS = wp.constant(4)
"""Rays towards a lamp: two by two over its area."""


@wp.func
def _given(rank: wp.int32, x: wp.float32) -> wp.float32:
    """Return what the maps have given already: all, or all from in front of dimmed skin."""
    if rank > 0 and x <= 0.0:
        return 0.0
    return 1.0


@wp.func
def _matters(
    bits: wp.uint32, full: wp.uint32, middle: wp.float32, reach: wp.float32, rank: wp.int32,
    wrap: wp.float32,
) -> bool:  # fmt: skip
    """Return whether any of some directions may change what the maps have given.

    Their cosines lie within ``reach`` of ``middle``; ``bits`` says which are weakened.
    """
    if middle + reach <= -wrap:
        return False
    if rank > 0 and middle - reach <= 0.0:
        return bits != full or middle + reach > 0.0
    return bits != wp.uint32(0)


@wp.kernel(enable_backward=False)
def _gather_light_kernel(
    # In:
    lights: Lights,
    materials: Materials,
    directions: Directions,
    measured: Measured,
    vertices: Vertices,
    flux: wp.array2d[wp.vec4f],
    moment: wp.array2d[wp.vec4f],
    wanted: wp.array[wp.int32],
    first: wp.int32,
    # Out:
    change_out: wp.array2d[wp.vec4f],
):
    """Sum what smooth light lacks at a vertex.

    Columns of ``change_out`` are passes of ``group_count`` each: J1, J2, then the crossing light
    of J2 and of J1 per term of exp(-s delta).

    Launch dimension: [wanted_count].

    Args:
        lights: For its wraps.
        materials: For exp(-s delta).
        directions: The directions.
        measured: What is seen of them.
        vertices: What is lit.
        flux: Light of each direction [coefficient sr], shape [group_count, 32 word_count].
        moment: Sum of that over every eight directions, and of its products with x, y and z, shape
            [group_count, 16 word_count].
        wanted: The vertices to light, each once.
        first: The first of them.
        change_out: To add to the unshadowed integrals [coefficient sr], shape
            [vertex_count, group_count * passes].
    """
    at = wanted[first + wp.tid()]
    m = vertices.material[at]
    row = vertices.row[at]
    normal = vertices.normal[at]
    is_skin = materials.kind[m] == 1
    rank = materials.passage_rank[m]
    wrap = float(0.0)
    if is_skin:
        wrap = lights.wrap[materials.wrap_set[m]]
    narrow = 1.0 / (1.0 + wrap)
    groups = lights.group_count
    begin = measured.first[row]
    end = measured.first[row + 1]
    for g in range(groups):
        lambert = wp.vec4f(0.0, 0.0, 0.0, 0.0)
        wrapped = wp.vec4f(0.0, 0.0, 0.0, 0.0)
        for word in range(measured.weakened.shape[1]):
            bits = measured.weakened[row, word]
            middle = wp.dot(normal, directions.word_center[word])
            reach = directions.word_reach[word]
            if _matters(bits, directions.word_full[word], middle, reach, rank, wrap):
                full = directions.word_full[word]
                for q in range(4):
                    part = (bits >> wp.uint32(8 * q)) & wp.uint32(255)
                    middle = wp.dot(normal, directions.byte_center[4 * word + q])
                    reach = directions.byte_reach[4 * word + q]
                    used = (full >> wp.uint32(8 * q)) & wp.uint32(255)
                    if part == used and middle > reach:
                        at_byte = 4 * (4 * word + q)
                        total = normal[0] * moment[g, at_byte + 1]
                        total += normal[1] * moment[g, at_byte + 2]
                        total += normal[2] * moment[g, at_byte + 3]
                        lambert -= total
                        wrapped -= narrow * (total + wrap * moment[g, at_byte])
                    elif _matters(part, used, middle, reach, rank, wrap):
                        for b in range(8):
                            d = 32 * word + 8 * q + b
                            x = wp.dot(normal, directions.direction[d])
                            given = _given(rank, x)
                            change = 1.0 - given
                            if ((part >> wp.uint32(b)) & wp.uint32(1)) != wp.uint32(0):
                                change = -given
                            if change != 0.0 and x > -wrap:
                                light = change * flux[g, d]
                                lambert += wp.max(x, 0.0) * light
                                wrapped += ((x + wrap) * narrow) * light
        for e in range(begin, end):
            d = measured.entry_direction[e]
            x = wp.dot(normal, directions.direction[d])
            if x > -wrap:
                light = measured.entry_clear[e] * flux[g, d]
                k1 = wp.max(x, 0.0)
                k2 = (x + wrap) * narrow
                length = measured.entry_length[e]
                if rank > 0 and length > 0.0:
                    entry = passage_entry(materials, m, length)
                    for k in range(rank):
                        through = passage_weight(materials, m, entry, k) * light
                        change_out[at, (2 + k) * groups + g] += k2 * through
                        change_out[at, (2 + rank + k) * groups + g] += k1 * through
                else:
                    lambert += k1 * light
                    wrapped += k2 * light
        change_out[at, g] += lambert
        if is_skin:
            change_out[at, groups + g] += wrapped


@wp.kernel(enable_backward=False)
def _gather_lamps_kernel(
    # In:
    geometry: Geometry,
    lights: Lights,
    materials: Materials,
    measured: Measured,
    vertices: Vertices,
    sets: LampSets,
    wanted: wp.array[wp.int32],
    first: wp.int32,
    # Out:
    change_out: wp.array2d[wp.vec4f],
):
    """Add what lamps lack at a vertex, by rays towards them.

    Launch dimension: [wanted_count].

    Args:
        geometry: The scene.
        lights: The lamps.
        materials: Its surfaces.
        measured: Where the rays start.
        vertices: What is lit.
        sets: Which lamps.
        wanted: The vertices to light, each once.
        first: The first of them.
        change_out: As of ``_gather_light_kernel``.
    """
    at = wanted[first + wp.tid()]
    m = vertices.material[at]
    row = vertices.row[at]
    normal = vertices.normal[at]
    is_skin = materials.kind[m] == 1
    rank = materials.passage_rank[m]
    limit = materials.passage_limit[m]
    own = int(-1)
    wrap = float(0.0)
    if is_skin:
        own = measured.prim[row]
        wrap = lights.wrap[materials.wrap_set[m]]
    narrow = 1.0 / (1.0 + wrap)
    groups = lights.group_count
    origin = off_surface(measured.position[row])
    links = LightLinks()
    blocks = sets.solid != 0 and blocks_all(is_skin, limit, origin.gap)
    for s in range(sets.first_group.shape[0]):
        group = sets.first_group[s]
        begin = int(0)
        if group > 0:
            begin = lights.lamp_end[group - 1]
        for j in range(sets.lamp_count[s]):
            lamp = begin + j
            center = lights.lamp_center[lamp]
            azimuth = lights.lamp_azimuth[lamp]
            elevation = lights.lamp_elevation[lamp]
            x = wp.dot(normal, center)
            reach = lights.lamp_reach[lamp]
            if x + wrap > -reach:
                a = wp.dot(normal, azimuth)
                b = wp.dot(normal, elevation)
                k1 = mean_ramp(x, a, b)
                k2 = mean_ramp(x + wrap, a, b) * narrow
                front = k2
                if rank > 0:
                    front = (k1 + wrap * mean_step(x, a, b)) * narrow
                clear = float(0.0)
                crosses = int(0)
                for ray in range(LAMP_RAYS):
                    u = wp.float32(ray % 2) - 0.5
                    v = wp.float32(ray / 2) - 0.5
                    toward = wp.normalize(center + u * azimuth + v * elevation)
                    crossing = Crossing()
                    if blocks:
                        if not wp.mesh_query_ray_anyhit(
                            geometry.mesh, origin.position, toward, FAR
                        ):
                            crossing.clear = 1.0
                    else:
                        crossing = cross_bodies(
                            geometry, materials, origin, toward, FAR, own, limit, links, -1
                        )
                    share = crossing.clear / wp.float32(LAMP_RAYS)
                    if rank > 0 and crossing.length > 0.0:
                        crosses += 1
                        if share > 0.0:
                            entry = passage_entry(materials, m, crossing.length)
                            for k in range(rank):
                                weight = share * passage_weight(materials, m, entry, k)
                                for g in range(sets.group_count[s]):
                                    lit = lights.lamp_flux[lamp + g * _stride(lights, group)]
                                    through = weight * lit
                                    column = (2 + k) * groups + group + g
                                    change_out[at, column] += k2 * through
                                    column = (2 + rank + k) * groups + group + g
                                    change_out[at, column] += k1 * through
                    else:
                        clear += share
                if not (clear == 1.0 and (rank == 0 or x > reach)):
                    for g in range(sets.group_count[s]):
                        lit = lights.lamp_flux[lamp + g * _stride(lights, group)]
                        change_out[at, group + g] += ((clear - 1.0) * k1) * lit
                        if is_skin:
                            change = clear * k2 - front
                            change_out[at, groups + group + g] += change * lit


@wp.func
def _stride(lights: Lights, group: wp.int32) -> wp.int32:
    """Return how many lamps a group has: its dome's other groups have the same ones."""
    if group > 0:
        return lights.lamp_end[group] - lights.lamp_end[group - 1]
    return lights.lamp_end[0]


def gather_light(
    lights: Lights,
    materials: Materials,
    directions: Directions,
    measured: Measured,
    vertices: Vertices,
    flux: wp.array,
    moment: wp.array,
    wanted: wp.array,
    change: wp.array,
    begin: int,
    end: int,
) -> None:
    """Add what smooth light lacks to vertices ``begin`` to ``end`` of ``wanted``."""
    wp.launch(
        _gather_light_kernel,
        dim=end - begin,
        inputs=[lights, materials, directions, measured, vertices, flux, moment, wanted, begin],
        outputs=[change],
        device=change.device,
    )


def gather_lamps(
    geometry: Geometry,
    lights: Lights,
    materials: Materials,
    measured: Measured,
    vertices: Vertices,
    sets: LampSets,
    wanted: wp.array,
    change: wp.array,
    begin: int,
    end: int,
) -> None:
    """Add what lamps lack to vertices ``begin`` to ``end`` of ``wanted``."""
    wp.launch(
        _gather_lamps_kernel,
        dim=end - begin,
        inputs=[geometry, lights, materials, measured, vertices, sets, wanted, begin],
        outputs=[change],
        device=change.device,
    )
