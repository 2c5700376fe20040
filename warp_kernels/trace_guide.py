"""Knowing what is hidden: blocks of pixels learn what they see of each part of the light.

The tree's first nodes cut the light into parts. A block counts what arrives from each of them. In
later passes, what it expects to arrive is summed exactly, by the parts' moments, and directions
measure what differs from that; they are drawn where it differs most (control variate and optimal
density; Mueller et al. 2017 for guiding by trees). A share of the plain density is kept, and what
a pass knows comes from passes before it, so no count makes a bias.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_tree import (
    LightTree,
    TreeSample,
    chance_below,
    ramp,
    sample_below,
)
from usdskin.warp_kernels.reflection import Reflection, base_weight, deposit
from usdskin.warp_kernels.structs import Film, Lights, Materials
from usdskin.warp_kernels.surface import Point

wp.set_module_options({"enable_backward": False})

SIDE = wp.constant(8)
"""Side of a block [px]."""

EVEN = wp.constant(0.35)
"""Share of the plain density that is kept."""

GLOSSY_EVEN = wp.constant(0.6)
"""More of it, where light that arrives is reflected."""

PRIOR = wp.constant(4.0)
"""Directions that what is known of a node's parent counts for."""

LEAST_GIVEN = wp.constant(0.25)
"""Least share of the light that is taken from the maps, of parts that have no moments here."""

WIDEST = wp.constant(0.5)
"""Largest chord between a block's normals that is answered for."""


@wp.struct
class Guide:
    """The parts of the light, and what the blocks of a tile know of them."""

    tops: wp.int32
    """First nodes of the light tree, of which those without children among them are the parts; 0
    where nothing is learnt."""

    part_node: wp.array[wp.int32]
    """Node of each part, neighbours side by side, shape [part_count]."""

    leaf_part: wp.array[wp.int32]
    """Part of each leaf, shape [leaf_count]."""

    moment: wp.array2d[wp.vec4f]
    """Integrals of a part's light times x, y, z (world space) and 1, each channel group's one after
    the other [coefficient sr], shape [part_count, 4 group_count]."""

    width: wp.int32
    """Pixels of the tile side by side."""

    across: wp.int32
    """Blocks of the tile side by side."""

    facing: wp.array[wp.vec4f]
    """Sum of the first surfaces' normals, and the largest l where they are skin, else -1, shape
    [tile_pixels]."""

    glossy: wp.array[wp.int32]
    """1 where one of them reflects, shape [tile_pixels]."""

    seen: wp.array3d[wp.int32]
    """Directions taken, sum and sum of squares in 1 / 256 of what arrived, shape [block_count,
    part_count, 3]."""

    sums: wp.array3d[wp.float32]
    """The same over nodes and all below them, then means, shape [block_count, tops, 3]."""

    cone: wp.array[wp.vec4f]
    """Mean normal and the largest chord from it to a normal that the block answers for; -1 where it
    knows nothing, shape [block_count]."""

    kernel: wp.array[wp.vec2f]
    """l and the weight of the wrap term that directions are drawn for, shape [block_count]."""

    cumulative: wp.array2d[wp.float32]
    """Probability of the parts up to each, shape [block_count, part_count]."""

    known: wp.array2d[wp.float32]
    """What arrives of each part by what is known [1], shape [block_count, part_count]."""

    given: wp.array[wp.float32]
    """The same for parts that cross the horizon, and for normals outside of the cone, shape
    [block_count]."""

    change: wp.array2d[wp.vec4f]
    """Moments of all parts times ``known - given``, shape [block_count, 4 group_count]."""

    changes: wp.array[wp.int32]
    """1 where any of them is not 0, shape [block_count]."""


@wp.func
def guide_block(guide: Guide, pixel: wp.int32) -> wp.int32:
    """Return the block of a pixel of the tile."""
    row = pixel / guide.width
    return (row / SIDE) * guide.across + (pixel - row * guide.width) / SIDE


@wp.func
def is_guided(
    guide: Guide, block: wp.int32, normal: wp.vec3f, wrap: wp.float32, mix: wp.float32
) -> wp.bool:
    """Return whether a block answers for a normal."""
    cone = guide.cone[block]
    kernel = guide.kernel[block]
    apart = normal - wp.vec3f(cone[0], cone[1], cone[2])
    return (
        cone[3] >= 0.0
        and wp.dot(apart, apart) <= cone[3] * cone[3]
        and wrap <= kernel[0]
        and mix <= kernel[1]
    )


@wp.func
def sample_part(
    tree: LightTree, guide: Guide, block: wp.int32, normal: wp.vec3f, wrap: wp.float32,
    mix: wp.float32, u: wp.vec3f,
) -> TreeSample:  # fmt: skip
    """Choose a part by what a block knows, and a direction of it for a surface."""
    low = int(0)
    high = guide.part_node.shape[0] - 1
    while low < high:
        middle = (low + high) / 2
        if u[0] < guide.cumulative[block, middle]:
            high = middle
        else:
            low = middle + 1
    before = float(0.0)
    if low > 0:
        before = guide.cumulative[block, low - 1]
    chance = guide.cumulative[block, low] - before
    if chance <= 0.0:
        return TreeSample()
    rest = wp.clamp((u[0] - before) / chance, 0.0, 0.99999994)
    return sample_below(
        tree, guide.part_node[low], chance, normal, wrap, mix, wp.vec3f(rest, u[1], u[2])
    )


@wp.func
def part_density(
    tree: LightTree, guide: Guide, block: wp.int32, dome: wp.int32, texel: wp.int32,
    normal: wp.vec3f, wrap: wp.float32, mix: wp.float32,
) -> wp.float32:  # fmt: skip
    """Return the density [1/sr] with which ``sample_part`` chooses directions in a texel."""
    leaf = tree.dome_leaf[tree.dome_first[dome][1] + texel]
    if leaf < 0:
        return 0.0
    part = guide.leaf_part[leaf]
    chance = guide.cumulative[block, part]
    if part > 0:
        chance = chance - guide.cumulative[block, part - 1]
    below = chance_below(tree, leaf, guide.tops, normal, wrap, mix)
    return chance * below / tree.leaf_angle[leaf]


@wp.func
def deposit_known(
    lights: Lights, materials: Materials, film: Film, pixel: wp.int32, point: Point,
    r: Reflection, guide: Guide, block: wp.int32,
) -> wp.float32:  # fmt: skip
    """Deposit the changes that a block knows of in the diffuse rows; return their Y."""
    m = point.material
    bases = materials.weight_count[m]
    span = bases * lights.group_count
    wrap = lights.wrap[materials.wrap_set[m]]
    n = point.normal
    y = float(0.0)
    for g in range(lights.group_count):
        lambert = n[0] * guide.change[block, 4 * g] + n[1] * guide.change[block, 4 * g + 1]
        lambert += n[2] * guide.change[block, 4 * g + 2]
        wrapped = (lambert + wrap * guide.change[block, 4 * g + 3]) / (1.0 + wrap)
        for j in range(bases):
            weight = r.diffuse * base_weight(r.low, r.high, j)
            row = j * lights.group_count + g
            y += deposit(materials, film, pixel, m, row, weight * lambert)
            if materials.kind[m] == 1:
                y += deposit(materials, film, pixel, m, span + row, weight * wrapped)
    return y


@wp.func
def remember(guide: Guide, block: wp.int32, leaf: wp.int32, arrived: wp.float32):
    """Count a direction."""
    part = guide.leaf_part[leaf]
    wp.atomic_add(guide.seen, block, part, 0, 1)
    wp.atomic_add(guide.seen, block, part, 1, wp.int32(256.0 * arrived))
    wp.atomic_add(guide.seen, block, part, 2, wp.int32(256.0 * arrived * arrived))


@wp.func
def _look_around(guide: Guide, block: wp.int32) -> wp.int32:
    """Find a block's normals and surfaces; return whether one of them reflects."""
    first_row = (block / guide.across) * SIDE
    first = (block % guide.across) * SIDE
    rows = wp.min(guide.facing.shape[0] / guide.width - first_row, SIDE)
    columns = wp.min(guide.width - first, SIDE)
    total = wp.vec3f(0.0, 0.0, 0.0)
    wrap = float(-1.0)
    glossy = int(0)
    for i in range(rows):
        for j in range(columns):
            pixel = (first_row + i) * guide.width + first + j
            normal = guide.facing[pixel]
            total += wp.vec3f(normal[0], normal[1], normal[2])
            wrap = wp.max(wrap, normal[3])
            glossy = wp.max(glossy, guide.glossy[pixel])
    length = wp.length(total)
    guide.cone[block] = wp.vec4f(0.0, 0.0, 0.0, -1.0)
    if length <= 0.0:
        return glossy
    axis = total / length
    widest = float(0.0)
    for i in range(rows):
        for j in range(columns):
            normal = guide.facing[(first_row + i) * guide.width + first + j]
            toward = wp.vec3f(normal[0], normal[1], normal[2])
            size = wp.length(toward)
            if size > 0.0:
                widest = wp.max(widest, wp.length(toward / size - axis))
    widest = wp.min(1.25 * widest + 0.01, WIDEST)
    guide.cone[block] = wp.vec4f(axis[0], axis[1], axis[2], widest)
    guide.kernel[block] = wp.vec2f(wp.max(wrap, 0.0), wp.where(wrap >= 0.0, 1.0, 0.0))
    return glossy


@wp.func
def _smooth(tree: LightTree, guide: Guide, block: wp.int32):
    """Estimate means and mean squares of what arrives from nodes, of few by their parents'."""
    parts = guide.part_node.shape[0]
    for k in range(parts):
        for j in range(3):
            guide.sums[block, guide.part_node[k], j] = wp.float32(guide.seen[block, k, j])
    for i in range(guide.tops):
        node = guide.tops - 1 - i  # children come after their parents
        child = tree.node_child[node]
        if child >= 0 and child < guide.tops:
            for j in range(3):
                guide.sums[block, node, j] = (
                    guide.sums[block, child, j] + guide.sums[block, child + 1, j]
                )
    for node in range(guide.tops):
        mean = float(1.0)
        square = float(1.0)
        if node > 0:
            parent = tree.node_parent[node]
            mean = guide.sums[block, parent, 1]
            square = guide.sums[block, parent, 2]
        taken = guide.sums[block, node, 0] + PRIOR
        guide.sums[block, node, 1] = (guide.sums[block, node, 1] / 256.0 + PRIOR * mean) / taken
        guide.sums[block, node, 2] = (guide.sums[block, node, 2] / 256.0 + PRIOR * square) / taken


@wp.func
def update_guide(tree: LightTree, guide: Guide, block: wp.int32, mix: wp.float32):
    """Have a block know what it has counted.

    Args:
        tree: The light.
        guide: What is known.
        block: Which block.
        mix: Weight of skin's wrap term when directions are chosen.
    """
    glossy = _look_around(guide, block)
    cone = guide.cone[block]
    if cone[3] < 0.0:
        return
    kernel = guide.kernel[block]
    kernel[1] = kernel[1] * mix
    guide.kernel[block] = kernel
    narrow = kernel[1] / (1.0 + kernel[0])
    _smooth(tree, guide, block)
    parts = guide.part_node.shape[0]
    total = float(0.0)
    crossing = float(0.0)
    arrived = float(0.0)
    for k in range(parts):
        node = guide.part_node[k]
        at = tree.node_cone[node]
        x = cone[0] * at[0] + cone[1] * at[1] + cone[2] * at[2]
        reach = at[3] + cone[3]
        plain = ramp(x, kernel[0], narrow) + 0.5 * ramp(wp.min(x + reach, 1.0), kernel[0], narrow)
        plain = plain * tree.node_flux[node]
        guide.cumulative[block, k] = plain
        guide.known[block, k] = guide.sums[block, node, 1]
        total += plain
        if x <= reach:
            guide.known[block, k] = -1.0
            crossing += plain
            arrived += plain * guide.sums[block, node, 1]
    if total <= 0.0:
        guide.cone[block] = wp.vec4f(0.0, 0.0, 0.0, -1.0)
        return
    given = float(1.0)
    if crossing > 0.0:
        given = wp.clamp(arrived / crossing, LEAST_GIVEN, 1.0)
    guide.given[block] = given
    groups = guide.change.shape[1]
    for g in range(groups):
        guide.change[block, g] = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    noise = float(0.0)
    changes = int(0)
    for k in range(parts):
        node = guide.part_node[k]
        known = guide.known[block, k]
        if known < 0.0:
            known = given
            guide.known[block, k] = given
        elif known != given:
            changes = 1
            for g in range(groups):
                guide.change[block, g] += (known - given) * guide.moment[k, g]
        mean = guide.sums[block, node, 1]
        square = guide.sums[block, node, 2] - 2.0 * known * mean + known * known
        noise += guide.cumulative[block, k] * wp.sqrt(wp.max(square, 0.0))
    guide.changes[block] = changes
    even = wp.where(glossy != 0, GLOSSY_EVEN, EVEN)
    if noise <= 1.0e-6 * total:
        even = 1.0
        noise = 1.0
    running = float(0.0)
    for k in range(parts):
        plain = guide.cumulative[block, k]
        node = guide.part_node[k]
        known = guide.known[block, k]
        mean = guide.sums[block, node, 1]
        square = guide.sums[block, node, 2] - 2.0 * known * mean + known * known
        weight = even / total + (1.0 - even) * wp.sqrt(wp.max(square, 0.0)) / noise
        running += plain * weight
        guide.cumulative[block, k] = running
    for k in range(parts):
        guide.cumulative[block, k] = guide.cumulative[block, k] / running
