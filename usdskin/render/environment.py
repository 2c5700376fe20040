"""An omnidirectional light as a tree of patches, with its small bright lamps taken out.

Reads: the coefficients of a ``DomeLight``. Makes: ``Environment``, which the reflectance maps are
integrated from. The tree is refined where the light is strong, so that its size follows the
light's structure and not the picture's resolution.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.latlong import latlong_directions

MAX_PATCH_RADIUS = 0.3
"""Largest chord radius of a leaf."""

MAX_PATCH_CURVATURE = 1.2e-5
"""Largest share of the flux times squared radius of a leaf: bounds the cost of its flatness."""

MAX_PATCH_MOMENT = 1.0e-3
"""Largest share of the flux times radius of a leaf: bounds what treating it as uniform costs."""

LAMP_SHARE = 4.0e-3
"""A leaf with more of the total flux than this is a lamp, shaded by itself at every normal."""

MAX_LAMPS = 256

_LEAST_ROWS = 96

GLOSS_LAMP_SHARE = 0.02
"""A lamp with more of the flux than this is reflected by itself, not prefiltered."""


@dataclass(frozen=True, slots=True, eq=False)
class Patches:
    """Rectangular patches of the sphere with constant coefficients."""

    center: NDArray[np.float32]
    """Unit direction of the centroid, world space, shape [count, 3]."""

    half_azimuth: NDArray[np.float32]
    """Tangent vector, half the patch wide, shape [count, 3]."""

    half_elevation: NDArray[np.float32]
    """Tangent vector, half the patch high, shape [count, 3]."""

    flux: NDArray[np.float32]
    """Coefficients times solid angle [sr], channels padded to groups, shape [groups, count, 4]."""


@dataclass(frozen=True, slots=True, eq=False)
class Tree:
    """The patch tree in depth-first order (see ``usdskin.warp_kernels.reflectance_map``)."""

    patches: Patches
    radius: NDArray[np.float32]
    skip: NDArray[np.int32]
    first_moment: NDArray[np.float32]
    """Int c L dL [sr], shape [3, groups, count, 4]."""


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """One dome: the lamps taken out of it, and the tree of all the rest."""

    tree: Tree
    lamps: Patches
    """Strongest first."""

    lamp_blocks: NDArray[np.int64]
    """(row, column, height, width) of the ``refined`` texels each lamp was taken from, shape
    [count, 4]."""

    gloss_lamp_count: int
    """How many lamps, the first ones, are strong enough to be reflected by themselves."""


def group_count(channel_count: int) -> int:
    """Return how many groups of four hold that many channels."""
    return -(-channel_count // 4)


def build_environment(
    coefficients: NDArray[np.float32],
    channel_scale: NDArray[np.float64],
    to_world: NDArray[np.float64],
    *,
    max_lamps: int = MAX_LAMPS,
    threads: int = 1,
) -> Environment:
    """Build the patch tree of a latlong map whose texels are constant patches.

    Args:
        coefficients: c, shape [height, width, r].
        channel_scale: The peak of each channel's basis spectrum, which weighs the channels in
            deciding where the light is strong, shape [r].
        to_world: Rotation from the light's frame, shape [3, 3].
        max_lamps: The most lamps to take out.
        threads: Threads to sum with; the result does not depend on them.
    """
    coefficients = refined(coefficients)
    height, width, channels = coefficients.shape
    strength = np.sqrt(((coefficients * channel_scale.astype(np.float32)) ** 2).sum(axis=-1))
    levels = max(0, int(np.floor(np.log2(max(1, min(height // 4, width // 8))))))
    side = 1 << levels
    shape = (-(-height // side) * side, -(-width // side) * side)
    rows, columns = _texel_integrals(height, width)
    energy = _pad(strength * (rows[0][:, None] * columns[0][None, :]), shape)
    pyramid = _index_moments(energy, levels, threads)
    total = float(pyramid[-1][0].sum())
    nodes = _select_nodes(pyramid, total, height, width)
    geometry = _node_geometry(nodes, height, width, to_world)

    groups = group_count(channels)
    count = len(nodes.level)
    flux = np.zeros((groups, count, 4), np.float32)
    moment = np.zeros((3, groups, count, 4), np.float32)
    for group in range(groups):
        part = coefficients[:, :, 4 * group : 4 * group + 4]
        used = part.shape[2]
        local = _gather_moments(part, rows, columns, nodes, levels, shape, threads)
        flux[group, :, :used] = local[0]
        moment[:, group, :, :used] = np.einsum("ij,jnc->inc", to_world, local[1:])

    lamp = _choose_lamps(nodes, total, max_lamps)
    size = np.int64(1) << nodes.level[lamp].astype(np.int64)
    blocks = np.stack([nodes.row[lamp] * size, nodes.column[lamp] * size, size, size], axis=-1)
    glossy = int((nodes.energy[lamp] > GLOSS_LAMP_SHARE * total).sum())
    patches = Patches(geometry.center, geometry.half_azimuth, geometry.half_elevation, flux)
    lamps = Patches(
        patches.center[lamp], patches.half_azimuth[lamp], patches.half_elevation[lamp],
        flux[:, lamp].copy(),
    )  # fmt: skip
    for index in lamp:  # a lamp's flux leaves itself and every node above it
        above = (nodes.start <= nodes.start[index]) & (nodes.end >= nodes.end[index])
        leaf_flux, leaf_moment = flux[:, index].copy(), moment[:, :, index].copy()
        flux[:, above] -= leaf_flux[:, None]
        moment[:, :, above] -= leaf_moment[:, :, None]
        flux[:, index], moment[:, :, index] = 0.0, 0.0
    tree = Tree(patches, geometry.radius, nodes.skip, moment)
    return Environment(tree, lamps, blocks, glossy)


def texel_patches(
    coefficients: NDArray[np.float32], basis: NDArray[np.float64], to_world: NDArray[np.float64]
) -> Patches:
    """Return every texel as a patch of its own whose channels are its reconstructed spectrum.

    Args:
        coefficients: c, shape [height, width, r].
        basis: Spectra of the channels, shape [r, bands].
        to_world: Rotation from the light's frame, shape [3, 3].
    """
    coefficients = refined(coefficients)
    height, width, rank = coefficients.shape
    rows, columns = _texel_integrals(height, width)
    area, *moments = (np.outer(row, column) for row, column in zip(rows, columns, strict=True))
    center = np.stack(moments, axis=-1).reshape(-1, 3)
    polar = np.repeat(np.pi * (np.arange(height) + 0.5) / height, width)
    angle = np.tile(2.0 * np.pi * (np.arange(width) + 0.5) / width, height)
    center /= area.reshape(-1, 1)
    east = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    south = np.cross(latlong_directions(angle / (2.0 * np.pi), polar), east)
    spectra = coefficients.reshape(-1, rank).astype(np.float64) @ basis * area.reshape(-1, 1)
    return Patches(
        (center @ to_world.T).astype(np.float32),
        (east * (np.sin(polar) * np.pi / width)[:, None] @ to_world.T).astype(np.float32),
        (south * (0.5 * np.pi / height) @ to_world.T).astype(np.float32),
        pad_groups(spectra),
    )


def pad_groups(channels: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return channels [count, r] in groups of four, padded with zeros, [groups, count, 4]."""
    count, rank = channels.shape
    groups = max(1, group_count(rank))
    padded = np.zeros((count, groups * 4), np.float32)
    padded[:, :rank] = channels
    return np.ascontiguousarray(padded.reshape(count, groups, 4).transpose(1, 0, 2))


@dataclass(frozen=True, slots=True, eq=False)
class _Nodes:
    level: NDArray[np.int64]
    row: NDArray[np.int64]
    column: NDArray[np.int64]
    leaf: NDArray[np.bool_]
    energy: NDArray[np.float64]
    mean: NDArray[np.float64]
    """Energy-weighted mean (row, column) of the texels [texel], shape [count, 2]."""
    spread: NDArray[np.float64]
    """Half the sides of the rectangle with the same variance [texel], shape [count, 2]."""
    start: NDArray[np.int64]
    end: NDArray[np.int64]
    skip: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class _Geometry:
    center: NDArray[np.float32]
    radius: NDArray[np.float32]
    half_azimuth: NDArray[np.float32]
    half_elevation: NDArray[np.float32]


def refined(coefficients: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the same light on texels small enough to be flat: a constant patch divides exactly."""
    height, width = coefficients.shape[:2]
    rows, columns = -(-_LEAST_ROWS // height), -(-2 * _LEAST_ROWS // width)
    if rows > 1:
        coefficients = np.repeat(coefficients, rows, axis=0)
    return np.repeat(coefficients, columns, axis=1) if columns > 1 else coefficients


def _texel_integrals(height: int, width: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the row and column factors of Int dL, Int L_x dL, Int L_y dL, Int L_z dL.

    Exact for a texel; shapes [4, height] and [4, width].
    """
    polar = np.pi * np.arange(height + 1) / height
    top, bottom = polar[:-1], polar[1:]
    area = np.cos(top) - np.cos(bottom)
    sine = 0.5 * (bottom - top) - 0.25 * (np.sin(2 * bottom) - np.sin(2 * top))
    cosine = 0.5 * (np.sin(bottom) ** 2 - np.sin(top) ** 2)
    step = 2.0 * np.pi / width
    angle = step * (np.arange(width) + 0.5)
    chord = 2.0 * np.sin(0.5 * step)
    flat = np.full(width, step)
    return (
        np.stack([area, sine, cosine, sine]),
        np.stack([flat, chord * np.sin(angle), flat, -chord * np.cos(angle)]),
    )


def _pad(image: NDArray[Any], shape: tuple[int, int]) -> NDArray[Any]:
    rows, columns = shape[0] - image.shape[0], shape[1] - image.shape[1]
    if not rows and not columns:
        return image
    return np.pad(image, ((0, rows), (0, columns)) + ((0, 0),) * (image.ndim - 2))


def _halve(image: NDArray[Any]) -> NDArray[Any]:
    """Sum 2 x 2 blocks; tree-shaped, so float32 keeps its precision."""
    columns = image[:, 0::2] + image[:, 1::2]
    total: NDArray[Any] = columns[0::2] + columns[1::2]
    return total


def _index_moments(energy: NDArray[Any], levels: int, threads: int) -> list[NDArray[np.float64]]:
    """Return per level the sums of e, e i, e j, e i^2, e j^2, shape [5, rows, columns]."""
    energy = energy.astype(np.float64)
    i = np.arange(energy.shape[0])[:, None] + 0.5
    j = np.arange(energy.shape[1])[None, :] + 0.5
    weights = (None, i, j, i * i, j * j)

    def pyramid(which: int) -> list[NDArray[np.float64]]:
        weight = weights[which]
        planes = [energy if weight is None else energy * weight]
        for _ in range(levels):
            planes.append(_halve(planes[-1]))
        return planes

    with ThreadPoolExecutor(threads) as pool:
        planes = list(pool.map(pyramid, range(5)))
    return [np.stack([part[level] for part in planes]) for level in range(levels + 1)]


def _block_radius(
    level: int, row: NDArray[Any], column: NDArray[Any], height: int, width: int
) -> NDArray[Any]:
    """Return the largest chord from a block's middle to its corners and edge middles."""
    side = 1 << level
    rows = [np.clip((row + f) * side, 0, height) for f in (0.0, 0.5, 1.0)]
    columns = [np.clip((column + f) * side, 0, width) for f in (0.0, 0.5, 1.0)]
    middle = latlong_directions(columns[1] / width, np.pi * rows[1] / height)
    radius = np.zeros(len(row))
    for r in rows:
        for c in columns:
            edge = latlong_directions(c / width, np.pi * r / height)
            radius = np.maximum(radius, np.linalg.norm(edge - middle, axis=-1))
    return radius


def _select_nodes(
    pyramid: list[NDArray[np.float64]], total: float, height: int, width: int
) -> _Nodes:
    """Refine from the top until every leaf is small, or holds little."""
    top = len(pyramid) - 1
    row, column = (index.ravel() for index in np.indices(pyramid[top].shape[1:]))
    found = []
    for level in range(top, -1, -1):
        sums = pyramid[level][:, row, column]
        radius = _block_radius(level, row, column, height, width)
        keep = sums[0] > 0.0
        row, column, sums, radius = row[keep], column[keep], sums[:, keep], radius[keep]
        share = sums[0] / max(total, 1e-300)
        split = (radius > MAX_PATCH_RADIUS) | (share * radius > MAX_PATCH_MOMENT)
        split |= share * radius**2 > MAX_PATCH_CURVATURE
        if level == 0:
            split[:] = False
        found.append((np.full(len(row), level), row, column, ~split, sums))
        row = (2 * row[split, None] + np.array([0, 0, 1, 1])).ravel()
        column = (2 * column[split, None] + np.array([0, 1, 0, 1])).ravel()
    levels, row, column, leaf = (np.concatenate([part[k] for part in found]) for k in range(4))
    sums = np.concatenate([part[4] for part in found], axis=1)
    mean = sums[1:3] / sums[0]
    variance = np.maximum(sums[3:5] / sums[0] - mean**2, 0.0) + 1.0 / 12.0
    start = _interleave(row << levels, column << levels)
    end = start + (np.int64(1) << (2 * levels))
    order = np.lexsort((-levels, start))
    start, end = start[order], end[order]
    skip = np.searchsorted(start, end, side="left").astype(np.int32)
    return _Nodes(
        levels[order], row[order], column[order], leaf[order], sums[0][order],
        mean.T[order], np.sqrt(3.0 * variance).T[order], start, end, skip,
    )  # fmt: skip


def _interleave(row: NDArray[Any], column: NDArray[Any]) -> NDArray[np.int64]:
    """Return Morton codes, so that a block's texels are one interval."""
    code = np.zeros(len(row), np.int64)
    for bit in range(20):
        code |= ((column.astype(np.int64) >> bit) & 1) << (2 * bit)
        code |= ((row.astype(np.int64) >> bit) & 1) << (2 * bit + 1)
    return code


def _node_geometry(nodes: _Nodes, height: int, width: int, to_world: NDArray[Any]) -> _Geometry:
    polar = np.pi * nodes.mean[:, 0] / height
    turns = nodes.mean[:, 1] / width
    center = latlong_directions(turns, polar)
    angle = 2.0 * np.pi * turns
    east = np.stack([np.cos(angle), np.zeros_like(angle), np.sin(angle)], axis=-1)
    south = np.cross(center, east)
    half_elevation = south * (np.pi / height * nodes.spread[:, 0])[:, None]
    reach = np.sin(polar) * 2.0 * np.pi / width * nodes.spread[:, 1]
    half_azimuth = east * reach[:, None]
    radius = np.zeros(len(polar))
    for level in np.unique(nodes.level):
        at = nodes.level == level
        radius[at] = _block_radius(int(level), nodes.row[at], nodes.column[at], height, width)
        side = 1 << int(level)
        middle_row = np.minimum((nodes.row[at] + 0.5) * side, height)
        middle_column = np.minimum((nodes.column[at] + 0.5) * side, width)
        middle = latlong_directions(middle_column / width, np.pi * middle_row / height)
        radius[at] += np.linalg.norm(middle - center[at], axis=-1)
    turn = to_world.T
    return _Geometry(
        (center @ turn).astype(np.float32), (1.0001 * radius).astype(np.float32),
        (half_azimuth @ turn).astype(np.float32), (half_elevation @ turn).astype(np.float32),
    )  # fmt: skip


def _gather_moments(
    part: NDArray[np.float32],
    rows: NDArray[np.float64],
    columns: NDArray[np.float64],
    nodes: _Nodes,
    levels: int,
    shape: tuple[int, int],
    threads: int,
) -> NDArray[np.float64]:
    """Return Int c dL and Int c L dL of every node for up to four channels, [4, count, c]."""
    result = np.zeros((4, len(nodes.level), part.shape[2]))

    def gather(k: int) -> None:
        weight = (rows[k][:, None] * columns[k][None, :]).astype(np.float32)
        image = _pad(part * weight[:, :, None], shape)
        for level in range(levels + 1):
            if level:
                image = _halve(image)
            at = nodes.level == level
            result[k, at] = image[nodes.row[at], nodes.column[at]]

    with ThreadPoolExecutor(threads) as pool:
        list(pool.map(gather, range(4)))
    return result


def _choose_lamps(nodes: _Nodes, total: float, max_lamps: int) -> NDArray[np.int64]:
    """Return the strongest leaves above ``LAMP_SHARE``, at most ``max_lamps``."""
    candidates = np.flatnonzero(nodes.leaf & (nodes.energy > LAMP_SHARE * total))
    order = np.argsort(-nodes.energy[candidates], kind="stable")
    return candidates[order[:max_lamps]]
