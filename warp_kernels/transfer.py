"""Shadows that were measured before: what a vertex sees of each of a fixed set of directions.

``measure`` finds once per vertex what light of every direction arrives (``cross_bodies``);
``transfer_gather`` sums it under any light.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import LightLinks
from usdskin.warp_kernels.structs import Geometry, Materials
from usdskin.warp_kernels.transfer_structs import Places
from usdskin.warp_kernels.visibility import Crossing, Origin, cross_bodies, gap_of

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

FAR = wp.constant(1.0e18)

LIFT = wp.constant(1.0e-5)
"""Gap between a vertex and the start of its rays, per unit of its largest coordinate."""

THINNEST = wp.constant(8.0)
"""Way inside a body, in gaps, below which it blocks all light: thinner ones cannot be told from
opaque ones either."""


@wp.func
def off_surface(position: wp.vec3f) -> Origin:
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
def blocks_all(is_skin: bool, limit: wp.float32, gap: wp.float32) -> bool:
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
    origin = off_surface(lifted(places.position[at], places.normal[at]))
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
    origin = off_surface(lifted(places.position[at], normal))
    horizon = places.horizon[at]
    limit = materials.passage_limit[m]
    # Where anything at all blocks a ray, it ends at the first triangle found.
    blocks = places.solid != 0 and blocks_all(materials.kind[m] == 1, limit, origin.gap)
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
