"""Choosing directions of light in proportion to what they give a surface.

All light from far away (domes, distant lights) is cut into blocks of about equal flux, the leaves
of a binary tree. A walk from the root takes either child in proportion to its flux times the
surface's kernel; within a block directions are uniform (Estevez and Kulla 2018 for the tree).
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import latlong_coordinates
from usdskin.warp_kernels.sampling import PI, TWO_PI, around, disk_from_square

wp.set_module_options({"enable_backward": False})


@wp.struct
class LightTree:
    """A binary tree over the blocks of all domes, and over the discs of distant lights."""

    node_cone: wp.array[wp.vec4f]
    """Mean direction of a node's light, world space, and the largest chord from it to a direction
    of the node, shape [node_count]; the root is node 0."""

    node_flux: wp.array[wp.float32]
    """Strength of the node's light [coefficient sr], shape [node_count]."""

    node_child: wp.array[wp.int32]
    """First child, the second follows it; -1 - leaf for a leaf, shape [node_count]."""

    node_parent: wp.array[wp.int32]
    """-1 for the root, shape [node_count]."""

    leaf_node: wp.array[wp.int32]
    """Node of a leaf, shape [leaf_count]."""

    leaf_dome: wp.array[wp.int32]
    """Dome of a leaf; -1 - channel for a distant light, shape [leaf_count]."""

    leaf_block: wp.array[wp.vec4i]
    """First row and column, rows and columns of a dome's texels, shape [leaf_count]."""

    leaf_axis: wp.array[wp.vec4f]
    """Direction of a distant light and 1 - cosine of its disc's angular radius, [leaf_count]."""

    leaf_angle: wp.array[wp.float32]
    """Solid angle [sr]; 0 for parallel light, shape [leaf_count]."""

    dome_texel: wp.array[wp.vec4f]
    """Coefficients of all domes, row by row, group after group."""

    dome_leaf: wp.array[wp.int32]
    """Leaf of every texel, -1 where it is black, dome after dome."""

    dome_first: wp.array[wp.vec4i]
    """First texel, first entry of ``dome_leaf``, first channel group and groups of a dome."""

    dome_size: wp.array[wp.vec2i]
    """Rows and columns, shape [dome_count]."""

    dome_to_world: wp.array[wp.mat33f]
    """Shape [dome_count]."""

    distant_group: wp.int32
    """Channel group of the first distant light; four share a group."""


@wp.struct
class TreeSample:
    """One direction of light."""

    direction: wp.vec3f
    """Unit vector towards the light, world space."""

    scale: wp.float32
    """1 / density [sr], or 1 / probability for a distant light; 0 where there is no light."""

    density: wp.float32
    """Density over solid angle [1/sr]; 0 for parallel light, which nothing else can find."""

    dome: wp.int32
    """Dome, or -1 - channel of a distant light."""

    texel: wp.int32
    """Which texel of the dome."""

    leaf: wp.int32
    """Which leaf of the tree."""


@wp.func
def ramp(x: wp.float32, wrap: wp.float32, share: wp.float32) -> wp.float32:
    """Return the kernel light is chosen by: Lambert's plus ``share`` times max(x + l, 0)."""
    return wp.max(x, 0.0) + share * wp.max(x + wrap, 0.0)


@wp.func
def _importance(
    tree: LightTree, node: wp.int32, normal: wp.vec3f, wrap: wp.float32, share: wp.float32
) -> wp.float32:
    """Return flux times a mean of the kernel: positive wherever it is for any of the node."""
    cone = tree.node_cone[node]
    x = normal[0] * cone[0] + normal[1] * cone[1] + normal[2] * cone[2]
    high = wp.min(x + cone[3], 1.0)
    return tree.node_flux[node] * (ramp(x, wrap, share) + 0.5 * ramp(high, wrap, share))


@wp.func
def sample_tree(
    tree: LightTree, normal: wp.vec3f, wrap: wp.float32, mix: wp.float32, u: wp.vec3f
) -> TreeSample:
    """Choose a direction for a surface.

    Args:
        tree: The light.
        normal: Shading normal.
        wrap: l of the surface.
        mix: Weight of its wrap term beside Lambert's.
        u: Uniform numbers in [0, 1); the first one walks the tree.
    """
    if tree.leaf_node.shape[0] == 0:
        return TreeSample()
    return sample_below(tree, 0, 1.0, normal, wrap, mix, u)


@wp.func
def sample_below(
    tree: LightTree, begin: wp.int32, chosen: wp.float32, normal: wp.vec3f, wrap: wp.float32,
    mix: wp.float32, u: wp.vec3f,
) -> TreeSample:  # fmt: skip
    """Choose a direction of one node's light for a surface (``sample_tree``).

    Args:
        tree: The light.
        begin: The node.
        chosen: Probability with which it was chosen.
        normal: Shading normal.
        wrap: l of the surface.
        mix: Weight of its wrap term beside Lambert's.
        u: Uniform numbers in [0, 1); the first one walks the tree.
    """
    sample = TreeSample()
    narrow = mix / (1.0 + wrap)
    node = int(begin)
    rest = float(u[0])
    chance = float(chosen)
    child = tree.node_child[node]
    while child >= 0:
        first = _importance(tree, child, normal, wrap, narrow)
        second = _importance(tree, child + 1, normal, wrap, narrow)
        total = first + second
        if total <= 0.0:
            return sample
        share = first / total
        if rest < share:
            rest = rest / share
            node = child
        else:
            share = 1.0 - share
            rest = (rest - (1.0 - share)) / share
            node = child + 1
        rest = wp.clamp(rest, 0.0, 0.99999994)
        chance = chance * share
        child = tree.node_child[node]
    leaf = -1 - child
    dome = tree.leaf_dome[leaf]
    sample.dome = dome
    sample.leaf = leaf
    angle = tree.leaf_angle[leaf]
    if dome < 0:
        axis = tree.leaf_axis[leaf]
        toward = wp.vec3f(axis[0], axis[1], axis[2])
        disk = disk_from_square(wp.vec2f(u[1], u[2]))
        r2 = disk[0] * disk[0] + disk[1] * disk[1]
        rise = axis[3] * r2  # 1 - cosine, uniform over the cap
        across = wp.sqrt(wp.max(rise * (2.0 - rise), 0.0) / wp.max(r2, 1.0e-20))
        sample.direction = wp.normalize(
            around(toward, wp.vec3f(across * disk[0], across * disk[1], 1.0 - rise))
        )
        # Irradiance is that of a facing surface, pi sin^2 t of the disc's radiance.
        sample.scale = 1.0 / (chance * (1.0 - 0.5 * axis[3]))
        if angle > 0.0:
            sample.density = chance / angle
        return sample
    block = tree.leaf_block[leaf]
    size = tree.dome_size[dome]
    # Uniform over the block's solid angle: the cosine of the polar angle, and the azimuth.
    top = wp.cos(PI * wp.float32(block[0]) / wp.float32(size[0]))
    bottom = wp.cos(PI * wp.float32(block[0] + block[2]) / wp.float32(size[0]))
    height = top + (bottom - top) * u[1]
    polar = wp.acos(wp.clamp(height, -1.0, 1.0))
    column = wp.float32(block[1]) + u[2] * wp.float32(block[3])
    turn = TWO_PI * column / wp.float32(size[1])
    sine = wp.sqrt(wp.max(1.0 - height * height, 0.0))
    local = wp.vec3f(sine * wp.sin(turn), height, -sine * wp.cos(turn))
    sample.direction = tree.dome_to_world[dome] * local
    row = wp.clamp(wp.int32(polar / PI * wp.float32(size[0])), block[0], block[0] + block[2] - 1)
    sample.texel = row * size[1] + wp.min(wp.int32(column), block[1] + block[3] - 1)
    sample.scale = angle / chance
    sample.density = chance / angle
    return sample


@wp.func
def light_number(tree: LightTree, sample: TreeSample) -> wp.int32:
    """Return a sample's light as ``LightLinks`` numbers them: domes, then distant lights."""
    if sample.dome < 0:
        return tree.dome_size.shape[0] - 1 - sample.dome
    return sample.dome


@wp.func
def tree_light(tree: LightTree, sample: TreeSample, group: wp.int32) -> wp.vec4f:
    """Return the coefficients of one channel group towards a sample, divided by its density."""
    none = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    if sample.dome < 0:
        channel = -1 - sample.dome
        if group != tree.distant_group + channel / 4:
            return none
        lane = channel % 4
        none[lane] = sample.scale
        return none
    first = tree.dome_first[sample.dome]
    g = group - first[2]
    if g < 0 or g >= first[3]:
        return none
    size = tree.dome_size[sample.dome]
    return sample.scale * tree.dome_texel[first[0] + g * size[0] * size[1] + sample.texel]


@wp.func
def dome_texel_towards(tree: LightTree, dome: wp.int32, direction: wp.vec3f) -> wp.int32:
    """Return the texel of a dome that a world direction lies in."""
    size = tree.dome_size[dome]
    at = latlong_coordinates(wp.transpose(tree.dome_to_world[dome]) * direction)
    row = wp.min(wp.int32(at[0] * wp.float32(size[0])), size[0] - 1)
    column = wp.min(wp.int32(at[1] * wp.float32(size[1])), size[1] - 1)
    return row * size[1] + column


@wp.func
def tree_density(
    tree: LightTree, dome: wp.int32, texel: wp.int32, normal: wp.vec3f, wrap: wp.float32,
    mix: wp.float32,
) -> wp.float32:  # fmt: skip
    """Return the density [1/sr] with which ``sample_tree`` chooses directions in a texel."""
    leaf = tree.dome_leaf[tree.dome_first[dome][1] + texel]
    if leaf < 0:
        return 0.0
    return chance_below(tree, leaf, 1, normal, wrap, mix) / tree.leaf_angle[leaf]


@wp.func
def chance_below(
    tree: LightTree, leaf: wp.int32, tops: wp.int32, normal: wp.vec3f, wrap: wp.float32,
    mix: wp.float32,
) -> wp.float32:  # fmt: skip
    """Return the probability of a leaf for a walk from the last of the first ``tops`` nodes."""
    narrow = mix / (1.0 + wrap)
    node = tree.leaf_node[leaf]
    chance = float(1.0)
    while node >= tops:
        parent = tree.node_parent[node]
        child = tree.node_child[parent]
        first = _importance(tree, child, normal, wrap, narrow)
        second = _importance(tree, child + 1, normal, wrap, narrow)
        total = first + second
        if total <= 0.0:
            return 0.0
        if node == child:
            chance = chance * first / total
        else:
            chance = chance * second / total
        node = parent
    return chance
