"""Shadows that were measured before: what a vertex sees of each of a fixed set of directions.

``measure`` finds once per vertex what light of every direction arrives (``cross_bodies``). Under
any light, ``gather_light`` then sums what does not arrive, or arrives through the body, into what
has to be added to the unshadowed rows of ``shade_skin`` and ``shade_preview_surface``; the few
lamps that are sharp get rays of their own (``gather_lamps``). A vertex that sees everything gets
zeros.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import LightLinks
from usdskin.warp_kernels.reflectance_map import mean_ramp, mean_step
from usdskin.warp_kernels.skin import passage_entry, passage_weight
from usdskin.warp_kernels.structs import Geometry, Lights, Materials
from usdskin.warp_kernels.transfer_structs import Directions, LampSets, Measured, Places, Vertices
from usdskin.warp_kernels.visibility import Crossing, Origin, cross_bodies, gap_of

wp.set_module_options({"enable_backward": False})

FAR = wp.constant(1.0e18)

LIFT = wp.constant(1.0e-5)
"""Gap between a vertex and the start of its rays, per unit of its largest coordinate."""

THINNEST = wp.constant(8.0)
"""Way inside a body, in gaps, below which it blocks all light: thinner ones cannot be told from
opaque ones either."""

LAMP_RAYS = wp.constant(4)
"""Rays towards a lamp: two by two over its area."""


@wp.func
def _off_surface(position: wp.vec3f) -> Origin:
    """Return a place that is lifted already, from which light comes from outside the body."""
    origin = Origin()
    origin.position = position
    largest = wp.abs(position)
    origin.gap = gap_of(wp.max(largest))
    return origin


@wp.func
def lifted(position: wp.vec3f, normal: wp.vec3f) -> wp.vec3f:
    """Return where the rays of a vertex start."""
    size = wp.max(wp.max(wp.abs(position[0]), wp.abs(position[1])), wp.abs(position[2]))
    return position + (LIFT * wp.max(size, 1.0e-3)) * normal


@wp.func
def _blocks_all(is_skin: bool, limit: wp.float32, gap: wp.float32) -> bool:
    """Return whether nothing passes the own body either."""
    return not is_skin or (limit > 0.0 and limit < THINNEST * gap)


@wp.func
def _passed(
    geometry: Geometry, materials: Materials, places: Places, at: wp.int32, toward: wp.vec3f
) -> Crossing:
    """Follow the light of one direction to a place; it is kept in steps of 1/255."""
    result = Crossing()
    if wp.dot(places.normal[at], toward) <= places.horizon[at]:
        return result
    m = places.material[at]
    origin = _off_surface(lifted(places.position[at], places.normal[at]))
    own = int(-1)
    if materials.kind[m] == 1:
        own = places.prim[at]
    result = cross_bodies(
        geometry, materials, origin, toward, FAR, own, materials.passage_limit[m], LightLinks(), -1
    )
    result.clear = wp.round(255.0 * result.clear)
    if result.clear <= 0.0:
        result.length = 0.0
    result.clear = result.clear / 255.0
    return result


@wp.kernel(enable_backward=False)
def _measure_kernel(
    # In:
    geometry: Geometry,
    materials: Materials,
    places: Places,
    direction: wp.array[wp.vec3f],
    beside: wp.array2d[wp.int32],
    near: wp.array2d[wp.int32],
    place: wp.array[wp.int32],
    around: wp.array2d[wp.int32],
    first: wp.int32,
    # Scratch:
    mixed: wp.array2d[wp.uint32],
    # Out:
    weakened: wp.array2d[wp.uint32],
    partial: wp.array2d[wp.uint32],
    rays: wp.array[wp.int32],
):
    """Find what some places see of every direction.

    Where all the places around one agree that a direction is clear, or blocked, and agree on the
    directions beside it, no ray is followed.

    Launch dimension: [row_count].

    Args:
        geometry: The scene.
        materials: Its surfaces.
        places: Where to look from.
        direction: Where to look, shape [direction_count].
        beside: Directions beside each, shape [direction_count, n].
        near: Words that hold the directions beside those of a word, shape [word_count, m].
        place: Place of every row of this level.
        around: Places around each that are measured already, shape [rows, n].
        first: The first row.
        mixed: Bits of the directions they do not agree on, shape [row_count, word_count].
        weakened: A bit per direction that is not clear, shape [place_count, word_count].
        partial: A bit per direction from which some of the light arrives, the same shape.
        rays: Directions that rays were followed in, shape [rows].
    """
    row = wp.tid()
    at = place[first + row]
    others = around.shape[1]
    some = wp.uint32(0)
    for word in range(weakened.shape[1]):
        any_ = wp.uint32(0)
        all_ = wp.uint32(0)
        unsure = wp.uint32(0)
        if others > 0:
            all_ = ~all_
        else:
            unsure = ~unsure
        for k in range(others):
            bits = weakened[around[first + row, k], word]
            any_ = any_ | bits
            all_ = all_ & bits
            unsure = unsure | partial[around[first + row, k], word]
        unsure = unsure | (any_ & (~all_))
        mixed[row, word] = unsure
        some = some | unsure
        weakened[at, word] = all_
        partial[at, word] = wp.uint32(0)
    if some == wp.uint32(0):
        return
    m = places.material[at]
    normal = places.normal[at]
    origin = _off_surface(lifted(places.position[at], normal))
    horizon = places.horizon[at]
    limit = materials.passage_limit[m]
    # Where anything at all blocks a ray, it ends at the first triangle found.
    blocks = places.solid != 0 and _blocks_all(materials.kind[m] == 1, limit, origin.gap)
    count = int(0)
    for word in range(weakened.shape[1]):
        some = mixed[row, word]
        for k in range(near.shape[1]):
            some = some | mixed[row, near[word, k]]
        if some != wp.uint32(0):
            bits = weakened[at, word]
            part = wp.uint32(0)
            for d in range(32 * word, wp.min(32 * word + 32, direction.shape[0])):
                bit = wp.uint32(1) << wp.uint32(d % 32)
                follow = mixed[row, word] & bit
                for k in range(beside.shape[1]):
                    other = beside[d, k]
                    shifted = mixed[row, other / 32] >> wp.uint32(other % 32)
                    follow = follow | (shifted & wp.uint32(1))
                if follow != wp.uint32(0):
                    found = Crossing()
                    if blocks:
                        if wp.dot(normal, direction[d]) > horizon:
                            count += 1
                            if not wp.mesh_query_ray_anyhit(
                                geometry.mesh, origin.position, direction[d], FAR
                            ):
                                found.clear = 1.0
                    else:
                        count += 1
                        found = _passed(geometry, materials, places, at, direction[d])
                    bits = bits & (~bit)
                    if found.clear < 1.0 or found.length > 0.0:
                        bits = bits | bit
                        if found.clear > 0.0:
                            part = part | bit
            weakened[at, word] = bits
            partial[at, word] = part
    rays[first + row] = count


@wp.kernel(enable_backward=False)
def _entries_kernel(
    # In:
    geometry: Geometry,
    materials: Materials,
    places: Places,
    direction: wp.array[wp.vec3f],
    partial: wp.array2d[wp.uint32],
    entry: wp.array[wp.int32],
    first: wp.int32,
    # Out:
    direction_out: wp.array[wp.int32],
    clear_out: wp.array[wp.float32],
    length_out: wp.array[wp.float32],
):
    """Say how much arrives of the light that arrives in part.

    Launch dimension: [row_count].

    Args:
        geometry: The scene.
        materials: Its surfaces.
        places: Where to look from.
        direction: Where to look, shape [direction_count].
        partial: As of ``_measure_kernel``.
        entry: First entry of each place.
        first: The first place.
        direction_out: Direction of each entry.
        clear_out: Share that other bodies let pass [1].
        length_out: Way inside the own body [m].
    """
    at = first + wp.tid()
    k = entry[at]
    for word in range(partial.shape[1]):
        bits = partial[at, word]
        if bits != wp.uint32(0):
            for b in range(32):
                if ((bits >> wp.uint32(b)) & wp.uint32(1)) != wp.uint32(0):
                    d = 32 * word + b
                    found = _passed(geometry, materials, places, at, direction[d])
                    direction_out[k] = d
                    clear_out[k] = found.clear
                    length_out[k] = found.length
                    k = k + 1


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
    first: wp.int32,
    # Out:
    change_out: wp.array2d[wp.vec4f],
):
    """Sum what smooth light lacks at a vertex.

    Columns of ``change_out`` are passes of ``group_count`` each: J1, J2, then the crossing light
    of J2 and of J1 per term of exp(-s delta).

    Launch dimension: [vertex_count].

    Args:
        lights: For its wraps.
        materials: For exp(-s delta).
        directions: The directions.
        measured: What is seen of them.
        vertices: What is lit.
        flux: Light of each direction [coefficient sr], shape [group_count, 32 word_count].
        moment: Sum of that over every eight directions, and of its products with x, y and z, shape
            [group_count, 16 word_count].
        first: The first vertex.
        change_out: To add to the unshadowed integrals [coefficient sr], shape
            [vertex_count, group_count * passes].
    """
    at = first + wp.tid()
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
    first: wp.int32,
    # Out:
    change_out: wp.array2d[wp.vec4f],
):
    """Add what lamps lack at a vertex, by rays towards them.

    Launch dimension: [vertex_count].

    Args:
        geometry: The scene.
        lights: The lamps.
        materials: Its surfaces.
        measured: Where the rays start.
        vertices: What is lit.
        sets: Which lamps.
        first: The first vertex.
        change_out: As of ``_gather_light_kernel``.
    """
    at = first + wp.tid()
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
    origin = _off_surface(measured.position[row])
    links = LightLinks()
    blocks = sets.solid != 0 and _blocks_all(is_skin, limit, origin.gap)
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


def measure(
    geometry: Geometry,
    materials: Materials,
    places: Places,
    direction: wp.array,
    beside: wp.array,
    near: wp.array,
    place: wp.array,
    around: wp.array,
    weakened: wp.array,
    partial: wp.array,
    rays: wp.array,
    begin: int,
    end: int,
) -> None:
    """Fill ``weakened`` and ``partial`` for rows ``begin`` to ``end`` of ``place``."""
    shape = (end - begin, weakened.shape[1])
    mixed = wp.empty(shape, dtype=wp.uint32, device=weakened.device)
    wp.launch(
        _measure_kernel,
        dim=end - begin,
        inputs=[
            geometry, materials, places, direction, beside, near, place, around, begin, mixed,
        ],
        outputs=[weakened, partial, rays],
        device=weakened.device,
    )  # fmt: skip


def measure_entries(
    geometry: Geometry,
    materials: Materials,
    places: Places,
    direction: wp.array,
    partial: wp.array,
    entry: wp.array,
    found: tuple[wp.array, wp.array, wp.array],
    begin: int,
    end: int,
) -> None:
    """Fill ``found`` (direction, clear, length) for places ``begin`` to ``end``."""
    wp.launch(
        _entries_kernel,
        dim=end - begin,
        inputs=[geometry, materials, places, direction, partial, entry, begin],
        outputs=list(found),
        device=partial.device,
    )


def gather_light(
    lights: Lights,
    materials: Materials,
    directions: Directions,
    measured: Measured,
    vertices: Vertices,
    flux: wp.array,
    moment: wp.array,
    change: wp.array,
    begin: int,
    end: int,
) -> None:
    """Add what smooth light lacks to vertices ``begin`` to ``end`` of ``change``."""
    wp.launch(
        _gather_light_kernel,
        dim=end - begin,
        inputs=[lights, materials, directions, measured, vertices, flux, moment, begin],
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
    change: wp.array,
    begin: int,
    end: int,
) -> None:
    """Add what lamps lack to vertices ``begin`` to ``end`` of ``change``."""
    wp.launch(
        _gather_lamps_kernel,
        dim=end - begin,
        inputs=[geometry, lights, materials, measured, vertices, sets, begin],
        outputs=[change],
        device=change.device,
    )
