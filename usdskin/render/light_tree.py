"""The light tree of a stage: blocks of the domes and discs of the distant lights.

Reads: ``Lights``. Makes: ``LightTree`` for the traced integrator, whose directions of light are
chosen from it (``usdskin.warp_kernels.light_tree``).
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.device import vec4
from usdskin.latlong import latlong_directions
from usdskin.render.environment import group_count
from usdskin.render.lights import DistantLight, DomeLight, Lights
from usdskin.warp_kernels import light_tree

LEAF_SHARE = 1.0 / 512.0
"""A block with more of its dome's flux than this is divided, down to single texels."""

LEAF_RADIUS = 0.3
"""Largest chord radius of a block."""


@dataclass(frozen=True, slots=True, eq=False)
class _Leaves:
    """Blocks of light, of one dome or of all lights."""

    center: NDArray[np.float64]
    """Unit directions of their middles, world space, shape [count, 3]."""

    radius: NDArray[np.float64]
    """Largest chord from the middle, shape [count]."""

    flux: NDArray[np.float64]
    """Strength times solid angle, shape [count]."""

    block: NDArray[np.int64]
    """First row and column, rows and columns, shape [count, 4]."""

    axis: NDArray[np.float64]
    """Direction and 1 - cosine of the disc of a distant light, shape [count, 4]."""

    angle: NDArray[np.float64]
    """Solid angle [sr], shape [count]."""

    owner: NDArray[np.int64]
    """Dome, or -1 - channel of a distant light, shape [count]."""


def build_light_tree(
    lights: Lights, channel_weight: NDArray[np.float64], device: str
) -> light_tree.LightTree:
    """Build the tree of all light from far away.

    Args:
        lights: Domes and distant lights.
        channel_weight: How much each channel counts for the picture, such as the luminance of its
            spectrum, in groups of four, shape [groups, 4].
        device: Where to.
    """
    tree = light_tree.LightTree()
    parts: list[_Leaves] = []
    texels, leaf_of, first, sizes, rotations = [], [], [], [], []
    group = used = listed = 0
    for index, dome in enumerate(lights.domes):
        height, width, channels = dome.coefficients.shape
        count = group_count(channels)
        weight = channel_weight[group : group + count].reshape(-1)[:channels]
        strength = _strength(dome, weight)
        leaves = _dome_leaves(strength, dome.to_world, index)
        mine = np.full((height, width), -1, np.int32)
        begin = sum(len(part.flux) for part in parts)
        for k, (row, column, rows, columns) in enumerate(leaves.block):
            mine[row : row + rows, column : column + columns] = begin + k
        parts.append(leaves)
        for g in range(count):
            image = np.zeros((height * width, 4), np.float32)
            part = dome.coefficients[:, :, 4 * g : 4 * g + 4]
            image[:, : part.shape[2]] = part.reshape(-1, part.shape[2])
            texels.append(image)
        first.append((used, listed, group, count))
        sizes.append((height, width))
        rotations.append(dome.to_world)
        leaf_of.append(mine.ravel())
        used += count * height * width
        listed += height * width
        group += count
    if lights.distants:
        parts.append(_distant_leaves(lights.distants, channel_weight[group:].reshape(-1)))
    leaves = _joined(parts) if parts else _no_leaves()
    _fill_nodes(tree, leaves, device)

    def ints(values: object, dtype: object = wp.int32) -> wp.array:
        return wp.array(np.asarray(values, np.int32), dtype=dtype, device=device)

    tree.leaf_dome = ints(leaves.owner)
    tree.leaf_block = ints(leaves.block, wp.vec4i)
    tree.leaf_axis = vec4(leaves.axis, device)
    tree.leaf_angle = wp.array(leaves.angle.astype(np.float32), dtype=wp.float32, device=device)
    tree.dome_texel = vec4(np.concatenate(texels) if texels else np.zeros((0, 4)), device)
    tree.dome_leaf = ints(np.concatenate(leaf_of) if leaf_of else np.zeros(0))
    tree.dome_first = ints(np.array(first, np.int32).reshape(-1, 4), wp.vec4i)
    tree.dome_size = ints(np.array(sizes, np.int32).reshape(-1, 2), wp.vec2i)
    turns = np.array(rotations, np.float32).reshape(-1, 3, 3)
    tree.dome_to_world = wp.array(turns, dtype=wp.mat33f, device=device)
    tree.distant_group = group
    return tree


def _strength(dome: DomeLight, weight: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how strong each texel is, never 0 where it shines in any channel, [rows, columns]."""
    scaled = dome.coefficients * weight.astype(np.float32)
    even = np.abs(dome.coefficients) * (np.abs(dome.basis).max(axis=1)).astype(np.float32)
    even *= max(float(np.abs(weight).max()), 1e-30) / max(float(np.abs(dome.basis).max()), 1e-30)
    total = np.abs(scaled.sum(axis=-1)) + 0.1 * even.sum(axis=-1)
    return np.asarray(total, np.float64)


def _dome_leaves(
    strength: NDArray[np.float64], to_world: NDArray[np.float64], index: int
) -> _Leaves:
    """Cut a dome into blocks: none too wide, none too bright, and none of black texels alone."""
    height, width = strength.shape
    edge = np.cos(np.pi * np.arange(height + 1) / height)
    area = (edge[:-1] - edge[1:]) * (2.0 * np.pi / width)
    energy = strength * area[:, None]
    sums = np.zeros((height + 1, width + 1))
    np.cumsum(np.cumsum(energy, axis=0), axis=1, out=sums[1:, 1:])
    total = max(float(sums[-1, -1]), 1e-300)
    block = np.array([[0, 0, height, width]])
    done = []
    while len(block):
        row, column, rows, columns = block.T
        flux = (
            sums[row + rows, column + columns] - sums[row, column + columns]
            - sums[row + rows, column] + sums[row, column]
        )  # fmt: skip
        keep = flux > 1e-12 * total
        block, flux = block[keep], flux[keep]
        row, column, rows, columns = block.T
        center, radius = _block_cone(block, height, width)
        split = (flux > LEAF_SHARE * total) | (radius > LEAF_RADIUS)
        split &= (rows > 1) | (columns > 1)
        done.append((block[~split], flux[~split], center[~split], radius[~split]))
        block = _halves(block[split], height, width)
    block, flux, center, radius = (np.concatenate([part[k] for part in done]) for k in range(4))
    solid = (edge[block[:, 0]] - edge[block[:, 0] + block[:, 2]]) * block[:, 3] * 2 * np.pi / width
    count = len(block)
    return _Leaves(
        center @ to_world.T, radius, flux, block, np.zeros((count, 4)), solid,
        np.full(count, index),
    )  # fmt: skip


def _halves(block: NDArray[np.int64], height: int, width: int) -> NDArray[np.int64]:
    """Cut blocks in two across their longer side on the sphere."""
    row, column, rows, columns = block.T
    middle = np.sin(np.pi * (row + 0.5 * rows) / height)
    tall = (columns == 1) | ((rows > 1) & (rows / height > 2.0 * middle * columns / width))
    upper = np.where(tall, rows // 2, rows)
    left = np.where(tall, columns, columns // 2)
    first = np.stack([row, column, upper, left], axis=-1)
    second = np.stack([
        np.where(tall, row + upper, row), np.where(tall, column, column + left),
        np.where(tall, rows - upper, rows), np.where(tall, columns, columns - left),
    ], axis=-1)  # fmt: skip
    return np.concatenate([first, second])


def _block_cone(
    block: NDArray[np.int64], height: int, width: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the middle of each block and the largest chord from it to its rim."""
    row, column, rows, columns = (part.astype(np.float64) for part in block.T)
    middle = latlong_directions(
        (column + 0.5 * columns) / width, np.pi * (row + 0.5 * rows) / height
    )
    radius = np.zeros(len(block))
    for down in (0.0, 0.5, 1.0):
        for across in (0.0, 0.25, 0.5, 0.75, 1.0):
            rim = latlong_directions(
                (column + across * columns) / width, np.pi * (row + down * rows) / height
            )
            radius = np.maximum(radius, np.linalg.norm(rim - middle, axis=-1))
    # Between the points looked at, a wide block bulges by less than this.
    return middle, radius * 1.08 + 1e-6


def _distant_leaves(distants: tuple[DistantLight, ...], weight: NDArray[np.float64]) -> _Leaves:
    count = len(distants)
    axis = np.zeros((count, 4))
    for k, distant in enumerate(distants):
        axis[k, :3] = distant.direction / np.linalg.norm(distant.direction)
        axis[k, 3] = 1.0 - np.cos(np.radians(distant.angle_deg) / 2.0)
    return _Leaves(
        axis[:, :3], np.sqrt(2.0 * axis[:, 3]), np.abs(weight[:count]) + 1e-30,
        np.zeros((count, 4), np.int64), axis, 2.0 * np.pi * axis[:, 3], -1 - np.arange(count),
    )  # fmt: skip


def _no_leaves() -> _Leaves:
    three, four, none = np.zeros((0, 3)), np.zeros((0, 4)), np.zeros(0)
    whole = np.zeros(0, np.int64)
    return _Leaves(three, none, none, four.astype(np.int64), four, none, whole)


def _joined(parts: list[_Leaves]) -> _Leaves:
    names = _Leaves.__slots__  # type: ignore[attr-defined]
    return _Leaves(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _fill_nodes(tree: light_tree.LightTree, leaves: _Leaves, device: str) -> None:
    """Divide the leaves in two of about equal flux, again and again, across their widest axis."""
    count = len(leaves.flux)
    nodes = max(0, 2 * count - 1)
    center, radius, flux = np.zeros((nodes, 3)), np.zeros(nodes), np.zeros(nodes)
    child, parent = np.zeros(nodes, np.int32), np.full(nodes, -1, np.int32)
    leaf_node = np.zeros(count, np.int32)
    queue: list[tuple[float, int, NDArray[np.int64]]] = []

    def add(node: int, members: NDArray[np.int64]) -> None:
        weight = leaves.flux[members]
        flux[node] = weight.sum()
        mean = weight @ leaves.center[members]
        length = float(np.linalg.norm(mean))
        middle = mean / length if length > 1e-9 * flux[node] else leaves.center[members[0]]
        center[node] = middle
        reach = np.linalg.norm(leaves.center[members] - middle, axis=1) + leaves.radius[members]
        radius[node] = min(float(reach.max()), 2.0)
        if len(members) == 1:
            child[node] = -1 - members[0]
            leaf_node[members[0]] = node
        else:
            heapq.heappush(queue, (-flux[node] * radius[node], node, members))

    if count:
        add(0, np.arange(count))
    used = 1
    while queue:  # nodes that send much light from a wide cone come first
        _, node, members = heapq.heappop(queue)
        spread = leaves.center[members]
        axis = int(np.argmax(spread.max(axis=0) - spread.min(axis=0)))
        order = members[np.argsort(spread[:, axis], kind="stable")]
        running = np.cumsum(leaves.flux[order])
        cut = int(np.searchsorted(running, 0.5 * running[-1])) + 1
        cut = min(max(cut, 1), len(order) - 1)
        child[node] = used
        parent[used] = parent[used + 1] = node
        add(used, order[:cut])
        add(used + 1, order[cut:])
        used += 2
    tree.node_cone = vec4(np.concatenate([center, 1.00001 * radius[:, None]], axis=1), device)
    tree.node_flux = wp.array(flux.astype(np.float32), dtype=wp.float32, device=device)
    tree.node_child = wp.array(child, dtype=wp.int32, device=device)
    tree.node_parent = wp.array(parent, dtype=wp.int32, device=device)
    tree.leaf_node = wp.array(leaf_node, dtype=wp.int32, device=device)
