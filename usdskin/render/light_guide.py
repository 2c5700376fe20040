"""The parts of a light tree that blocks of pixels learn what they see of, and their moments.

Reads: ``Lights`` and their ``LightTree``. Makes: ``LightParts`` for the traced integrator
(``usdskin.warp_kernels.trace_guide``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import vec3, vec4
from usdskin.render.lights import Lights
from usdskin.warp_kernels import light_tree, trace

PARTS = 512
"""Most parts that the light is cut into."""


@dataclass(frozen=True, slots=True, eq=False)
class LightParts:
    """The light cut into parts, none of them where there is no light."""

    tops: int
    """First nodes of the tree, of which those without children among them are the parts."""

    node: Any
    """Node of each part, shape [part_count], on the device."""

    leaf_part: Any
    """Part of each leaf, shape [leaf_count], on the device."""

    moments: NDArray[np.float64]
    """Integrals of each part's light times x, y, z and 1 [coefficient sr], shape [part_count,
    group_count, 4, 4]; channels come last."""

    moment: Any
    """The same on the device, shape [part_count, 4 group_count]."""


def light_parts(
    lights: Lights, tree: light_tree.LightTree, group_count: int, device: str
) -> LightParts:
    """Cut the light into parts.

    Args:
        lights: Domes and distant lights.
        tree: Their tree.
        group_count: Channel groups of all lights.
        device: Where to.
    """
    child, parent = tree.node_child.numpy(), tree.node_parent.numpy()
    tops = min(2 * PARTS - 1, len(child))
    order = _in_order(child, tops)
    part_of = np.full(tops, -1, np.int32)
    part_of[order] = np.arange(len(order))
    node = tree.leaf_node.numpy().copy()
    while (above := node >= tops).any():
        node[above] = parent[node[above]]
    leaf_part = part_of[node] if len(node) else np.zeros(0, np.int32)
    leaves = _leaf_moments(lights, tree, group_count, device)
    moments = np.zeros((len(order), *leaves.shape[1:]))
    np.add.at(moments, leaf_part, leaves)
    return LightParts(
        tops,
        wp.array(order, dtype=wp.int32, device=device),
        wp.array(leaf_part, dtype=wp.int32, device=device),
        moments,
        _uploaded(moments, device),
    )


def turned_parts(parts: LightParts, to_world: NDArray[np.float64], device: str) -> LightParts:
    """Return the parts of light that is turned as a whole; arrays are shared with ``parts``."""
    moments = parts.moments.copy()
    moments[:, :, :3] = np.einsum("ij,pgjc->pgic", to_world, parts.moments[:, :, :3])
    return LightParts(
        parts.tops, parts.node, parts.leaf_part, parts.moments, _uploaded(moments, device)
    )


def _uploaded(moments: NDArray[np.float64], device: str) -> Any:
    parts, groups = moments.shape[:2]
    flat = vec4(np.ascontiguousarray(moments.reshape(-1, 4)), device)
    return flat.reshape((parts, 4 * groups))


def _in_order(child: NDArray[np.int32], tops: int) -> NDArray[np.int32]:
    """Return the nodes of the parts, neighbours side by side."""
    found, stack = [], [0] if tops else []
    while stack:
        node = stack.pop()
        if 0 <= child[node] < tops:
            stack += [child[node] + 1, child[node]]
        else:
            found.append(node)
    return np.array(found, np.int32)


def _leaf_moments(
    lights: Lights, tree: light_tree.LightTree, group_count: int, device: str
) -> NDArray[np.float64]:
    """Return the integrals of each leaf's light, world space, [leaf_count, groups, 4, 4]."""
    owner = tree.leaf_dome.numpy()
    count = len(owner)
    total = wp.zeros((count, 4 * group_count), dtype=wp.vec4f, device=device)
    if count and lights.domes:
        compilation.load(trace, device)
    for index, dome in enumerate(lights.domes if count else ()):
        height, width = dome.coefficients.shape[:2]
        polar = np.pi * np.arange(height + 1) / height
        turn = 2.0 * np.pi * np.arange(width + 1) / width
        row = np.stack([
            np.diff(0.5 * polar - 0.25 * np.sin(2.0 * polar)), np.diff(0.5 * np.sin(polar) ** 2),
            -np.diff(np.cos(polar)),
        ], axis=-1)  # fmt: skip
        column = np.stack([-np.diff(np.cos(turn)), -np.diff(np.sin(turn)), np.diff(turn)], axis=-1)
        trace.dome_moments(tree, index, vec3(row, device), vec3(column, device), total)
    found: NDArray[np.float64] = np.zeros((count, group_count, 4, 4))
    found += total.numpy().reshape(found.shape)
    for index, dome in enumerate(lights.domes):
        mine = owner == index
        found[mine, :, :3] = np.einsum("ij,lgjc->lgic", dome.to_world, found[mine, :, :3])
    axis = tree.leaf_axis.numpy().astype(np.float64)
    for leaf in np.flatnonzero(owner < 0):  # a facing surface gets 1
        channel = -1 - int(owner[leaf])
        group, lane = tree.distant_group + channel // 4, channel % 4
        found[leaf, group, :3, lane] = axis[leaf, :3]
        found[leaf, group, 3, lane] = 1.0 / (1.0 - 0.5 * axis[leaf, 3])
    return found
