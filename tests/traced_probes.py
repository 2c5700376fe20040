"""Kernels that call the traced integrator's own functions, for the tests."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_tree import (
    LightTree,
    dome_texel_towards,
    sample_tree,
    tree_density,
    tree_light,
)
from usdskin.warp_kernels.sampling import hash_pair, low_discrepancy

wp.set_module_options({"enable_backward": False})


@wp.kernel
def probe_sequence(
    table: wp.array2d[wp.uint32],
    key: wp.array[wp.uint32],
    dimension: wp.int32,
    out: wp.array2d[wp.float32],
):
    """Evaluate one dimension of the sequences of all keys."""
    k, i = wp.tid()
    out[k, i] = low_discrepancy(table, key[k], i, dimension)


@wp.kernel
def probe_hash(a: wp.array[wp.uint32], b: wp.array[wp.uint32], out: wp.array[wp.uint32]):
    """Mix two numbers."""
    i = wp.tid()
    out[i] = hash_pair(a[i], b[i])


@wp.kernel
def probe_tree(
    tree: LightTree,
    normal: wp.array[wp.vec3f],
    wrap: wp.float32,
    mix: wp.float32,
    group: wp.int32,
    u: wp.array[wp.vec3f],
    direction: wp.array2d[wp.vec3f],
    scale: wp.array2d[wp.float32],
    density: wp.array2d[wp.vec2f],
    texel: wp.array2d[wp.vec3i],
    light: wp.array2d[wp.vec4f],
):
    """Choose directions for normals; density as sampled and as looked up from the direction."""
    n, i = wp.tid()
    sample = sample_tree(tree, normal[n], wrap, mix, u[i])
    direction[n, i] = sample.direction
    scale[n, i] = sample.scale
    looked_up = float(0.0)  # noqa: UP018  (a variable of the kernel)
    found = int(-1)  # noqa: RUF046, UP018  (a variable of the kernel)
    if sample.scale > 0.0 and sample.dome >= 0:
        looked_up = tree_density(tree, sample.dome, sample.texel, normal[n], wrap, mix)
        found = dome_texel_towards(tree, sample.dome, sample.direction)
    density[n, i] = wp.vec2f(sample.density, looked_up)
    texel[n, i] = wp.vec3i(sample.dome, sample.texel, found)
    if sample.scale > 0.0:
        light[n, i] = tree_light(tree, sample, group)


@wp.kernel
def probe_density(
    tree: LightTree,
    dome: wp.int32,
    normal: wp.array[wp.vec3f],
    wrap: wp.float32,
    mix: wp.float32,
    out: wp.array2d[wp.float32],
):
    """Look up the density of every texel of a dome for normals."""
    n, i = wp.tid()
    out[n, i] = tree_density(tree, dome, i, normal[n], wrap, mix)
