"""Reflectance maps: J1, J2 and H of a patch tree on grids of normals.

Every map is doubled in size until it meets its error target, measured where it matters: at a
spiral of normals and along the kinks of the strongest patches.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers, vec3, vec4
from usdskin.latlong import latlong_directions
from usdskin.render.environment import Environment, Patches
from usdskin.warp_kernels import reflectance_map

MAP_ERROR_TARGET = 2.5e-4
"""Largest interpolation error of a map, relative to the peak of the light it is part of."""

MAP_ROWS = (32, 64, 128, 256, 512)
"""Sizes tried, in order: H rows of nodes, 2 H columns."""

SPLIT_ROWS = (128, 256, 512)
"""The same where H is looked up: its error is not measured, and 128 rows hold it to 1e-3."""


def to_device(environment: Environment, device: str) -> reflectance_map.PatchTree:
    """Copy an environment's tree to a device."""
    tree = environment.tree
    target = reflectance_map.PatchTree()
    target.center = vec3(tree.patches.center, device)
    target.half_azimuth = vec3(tree.patches.half_azimuth, device)
    target.half_elevation = vec3(tree.patches.half_elevation, device)
    target.radius = wp.array(tree.radius, dtype=wp.float32, device=device)
    target.skip = wp.array(tree.skip, dtype=wp.int32, device=device)
    target.flux = vec4(tree.patches.flux, device)
    target.flux_x, target.flux_y, target.flux_z = (vec4(m, device) for m in tree.first_moment)
    return target


def tangents(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return two unit vectors that complete a unit axis to an orthogonal frame."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def integrate_normals(
    tree: reflectance_map.PatchTree,
    normals: NDArray[np.float64],
    wrap: float,
    groups: int,
    workers: Workers,
) -> NDArray[np.float32]:
    """Return J1, J2 and H of the tree at normals, shape [3, groups, count, 4]."""
    count = len(normals)
    normal = vec3(normals, workers.device)
    out = tuple(wp.empty((groups, count), dtype=wp.vec4f, device=workers.device) for _ in range(3))

    def work(begin: int, end: int) -> None:
        reflectance_map.integrate_zonal(tree, normal, wrap, out, begin, end)

    workers.run(count, 1024 if workers.device == "cpu" else count, work)
    return np.stack([part.numpy() for part in out])


def node_normals(rows: int) -> NDArray[np.float64]:
    """Return the directions of a map's nodes, poles included, shape [(rows + 1) 2 rows, 3]."""
    polar, turns = np.meshgrid(
        np.pi * np.arange(rows + 1) / rows, np.arange(2 * rows) / (2 * rows), indexing="ij"
    )
    return latlong_directions(turns.ravel(), polar.ravel())


def bake_maps(
    environment: Environment,
    wraps: tuple[float, ...],
    channel_scale: NDArray[np.float64],
    workers: Workers,
    split: bool = False,
) -> tuple[list[list[list[NDArray[np.float32]]]], int, float]:
    """Integrate the maps of one environment for every wrap.

    Args:
        environment: The dome's tree.
        wraps: Values of l.
        channel_scale: The peak of each channel's basis spectrum, shape [r].
        workers: Where to compute.
        split: Whether H is looked up too; it has steps, and needs a finer grid.

    Returns:
        Padded node grids [wrap][kernel][group], of shape [(rows + 3) (2 rows + 3), 4] each, in
        which kernel 0 is J1, 1 is J2 and 2 is H; their rows; and the largest interpolation error
        of J1 and J2 found, relative to the peak.
    """
    compilation.load(reflectance_map, workers.device)
    tree = to_device(environment, workers.device)
    groups = environment.tree.patches.flux.shape[0]
    scale = np.zeros(groups * 4)
    scale[: len(channel_scale)] = channel_scale
    checks = [_check_normals(environment, wrap) for wrap in wraps]
    truth = [
        integrate_normals(tree, normals, wrap, groups, workers)
        for normals, wrap in zip(checks, wraps, strict=True)
    ]
    peaks = [
        max(_strength(part[1], scale).max(), 1e-30) + _lamp_peak(environment.lamps, scale)
        for part in truth
    ]
    for rows in SPLIT_ROWS if split else MAP_ROWS:
        grids = [
            integrate_normals(tree, node_normals(rows), wrap, groups, workers) for wrap in wraps
        ]
        padded = [[[_pad_nodes(grid[k, g], rows) for g in range(groups)] for k in range(3)]
                  for grid in grids]  # fmt: skip
        error = 0.0
        for normals, exact, maps, peak in zip(checks, truth, padded, peaks, strict=True):
            for kernel in range(2):
                found = np.stack([_interpolate(maps[kernel][g], rows, normals)
                                  for g in range(groups)])  # fmt: skip
                error = max(error, float(_strength(found - exact[kernel], scale).max() / peak))
        if error <= MAP_ERROR_TARGET:
            break
    return padded, rows, error


def _strength(values: NDArray[Any], scale: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the weighted size of coefficients [groups, count, 4] per normal."""
    weighted = values * scale.reshape(-1, 1, 4)
    return np.asarray(np.sqrt((weighted**2).sum(axis=(0, 2))))


def _lamp_peak(lamps: Patches, scale: NDArray[np.float64]) -> float:
    """Return a lower bound of what the lamps add at the brightest normal."""
    if not len(lamps.center):
        return 0.0
    strength = _strength(lamps.flux, scale)
    mean = (lamps.center * strength[:, None]).sum(axis=0)
    return float(np.linalg.norm(mean))


def _check_normals(environment: Environment, wrap: float) -> NDArray[np.float64]:
    """Return a spiral of normals and rings of them at the kinks of the strongest patches."""
    k = np.arange(512) + 0.5
    cosine = 1.0 - k / 256.0
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    sine = np.sqrt(1.0 - cosine**2)
    normals = [np.stack([sine * np.cos(angle), cosine, sine * np.sin(angle)], axis=-1)]
    patches = environment.tree.patches
    leaf = environment.tree.skip == np.arange(1, len(environment.tree.skip) + 1)
    strength = np.abs(patches.flux).sum(axis=(0, 2)) * leaf
    for index in np.argsort(-strength, kind="stable")[:16]:
        axis = patches.center[index].astype(np.float64)
        axis /= np.linalg.norm(axis)
        first, second = tangents(axis)
        turn = 2.0 * np.pi * (np.arange(24) + 0.37) / 24
        ring = np.cos(turn)[:, None] * first + np.sin(turn)[:, None] * second
        for kink in {0.0, -wrap}:
            normals.append(kink * axis + np.sqrt(max(0.0, 1.0 - kink**2)) * ring)
    return np.concatenate(normals)


def _pad_nodes(values: NDArray[np.float32], rows: int) -> NDArray[np.float32]:
    """Surround a node grid as the bicubic lookup needs it; over a pole the azimuth turns by half.

    From [(rows + 1) 2 rows, 4] to [(rows + 3) (2 rows + 3), 4].
    """
    grid = values.reshape(rows + 1, 2 * rows, 4)
    over_top = np.roll(grid[1], rows, axis=0)[None]
    over_bottom = np.roll(grid[-2], rows, axis=0)[None]
    grid = np.concatenate([over_top, grid, over_bottom])
    grid = np.concatenate([grid[:, -1:], grid, grid[:, :2]], axis=1)
    return np.ascontiguousarray(grid.reshape(-1, 4))


def _interpolate(
    padded: NDArray[np.float32], rows: int, normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Look a padded map up as the kernels do, shape [count, 4]."""
    y = np.arccos(np.clip(normals[:, 1], -1.0, 1.0)) / np.pi * rows
    x = (np.arctan2(normals[:, 0], -normals[:, 2]) / (2.0 * np.pi) % 1.0) * 2 * rows
    i = np.clip(y.astype(int), 0, rows - 1)
    j = np.clip(x.astype(int), 0, 2 * rows - 1)
    grid = padded.reshape(rows + 3, 2 * rows + 3, 4)
    weights_y, weights_x = _cubic_weights(y - i), _cubic_weights(x - j)
    total = np.zeros((len(normals), 4))
    for a in range(4):
        for b in range(4):
            total += (weights_y[a] * weights_x[b])[:, None] * grid[i + a, j + b]
    return total


def _cubic_weights(t: NDArray[np.float64]) -> tuple[NDArray[np.float64], ...]:
    return (
        -0.5 * t + t**2 - 0.5 * t**3,
        1.0 - 2.5 * t**2 + 1.5 * t**3,
        0.5 * t + 2.0 * t**2 - 1.5 * t**3,
        -0.5 * t**2 + 0.5 * t**3,
    )
