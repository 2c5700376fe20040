"""Domes and distant lights, made ready to be looked up at any normal.

Reads: ``Lights``. Makes: ``LightField``, the kernels' ``Lights`` struct with the spectra of its
channels. Every smooth map is doubled in size until it meets its error target, measured where it
matters: at random normals and along the kinks of the strongest patches left in it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.render.device import Workers
from usdskin.render.environment import (
    Environment,
    Patches,
    build_environment,
    group_count,
    latlong_directions,
)
from usdskin.render.lights import DistantLight, DomeLight, Lights
from usdskin.warp_kernels import reflectance_map, structs

MAP_ERROR_TARGET = 2.5e-4
"""Largest interpolation error of a map, relative to the peak of the light it is part of."""

MAP_ROWS = (32, 64, 128, 256, 512)
"""Sizes tried, in order: H rows of nodes, 2 H columns."""

_DISC_TO_SQUARE = 0.5 * np.sqrt(3.0)
"""Half side of the square with a disc's second moment, per unit of its radius."""


@dataclass(frozen=True, slots=True, eq=False)
class LightField:
    """The light of a stage in coefficient channels, and what each channel's spectrum is."""

    device_lights: structs.Lights
    basis: NDArray[np.float64]
    """Spectrum of every channel, zero where a group is not full, shape [groups, 4, bands]."""

    environments: tuple[Environment, ...]
    map_rows: tuple[int, ...]
    """H of each dome's maps."""

    map_errors: tuple[float, ...]
    """Measured interpolation error of each dome's maps, relative to the peak."""

    lamp_count: int


@dataclass(slots=True, eq=False)
class _Lamps:
    """Lamps of one channel group."""

    patches: Patches
    """With the flux of this group alone."""

    gloss: int
    """How many of them, the first ones, are reflected by themselves."""


def to_device(tree_or_patches: Environment, device: str) -> reflectance_map.PatchTree:
    """Copy an environment's tree to a device."""
    tree = tree_or_patches.tree
    target = reflectance_map.PatchTree()
    target.center = _vec3(tree.patches.center, device)
    target.half_azimuth = _vec3(tree.patches.half_azimuth, device)
    target.half_elevation = _vec3(tree.patches.half_elevation, device)
    target.radius = wp.array(tree.radius, dtype=wp.float32, device=device)
    target.skip = wp.array(tree.skip, dtype=wp.int32, device=device)
    target.flux = _vec4(tree.patches.flux, device)
    target.flux_x, target.flux_y, target.flux_z = (_vec4(m, device) for m in tree.first_moment)
    return target


def build_light_field(
    lights: Lights, wraps: tuple[float, ...], workers: Workers, wavelength_count: int
) -> LightField:
    """Integrate the stage's lights over both kernels.

    Args:
        lights: Domes and distant lights.
        wraps: The values of l that materials use, one map set each.
        workers: Where to compute.
        wavelength_count: Bands of the lights' spectra.

    Returns:
        The field; ``device_lights`` has no reflections and no visible dome yet.
    """
    device = workers.device
    groups = [group_count(dome.coefficients.shape[2]) for dome in lights.domes]
    distant_groups = group_count(len(lights.distants))
    total = max(1, sum(groups) + distant_groups)
    basis = np.zeros((total, 4, wavelength_count))
    offsets = np.full((len(wraps), 3, total), -1, np.int32)
    rows = np.zeros(total, np.int32)
    lamps: list[_Lamps] = []
    values: list[NDArray[np.float32]] = []
    environments, sizes, errors = [], [], []
    begin, used = 0, 0
    for dome, count in zip(lights.domes, groups, strict=True):
        environment = dome_environment(dome)
        environments.append(environment)
        _fill_basis(basis[begin : begin + count], dome.basis)
        if environment.tree.skip.size:
            maps, size, error = _bake_dome(environment, wraps, dome, workers)
            for w in range(len(wraps)):
                for kernel in range(3):
                    for g in range(count):
                        offsets[w, kernel, begin + g] = used
                        values.append(maps[w][kernel][g])
                        used += len(values[-1])
            rows[begin : begin + count] = size
            sizes.append(size)
            errors.append(error)
        lamps += _dome_lamps(environment, count)
        begin += count
    lamps += _distant_lamps(lights.distants, basis[begin:])
    field = structs.Lights()
    field.group_count = total
    flat = np.concatenate(values) if values else np.zeros((0, 4), np.float32)
    field.map_value = _vec4(flat, device)
    field.map_offset = wp.array(offsets, dtype=wp.int32, device=device)
    field.map_rows = wp.array(rows, dtype=wp.int32, device=device)
    field.wrap = wp.array(np.array(wraps, np.float32), dtype=wp.float32, device=device)
    lamp_count = _upload_lamps(field, lamps, device)
    return LightField(
        field, basis, tuple(environments), tuple(sizes), tuple(errors), lamp_count
    )  # fmt: skip


def dome_environment(dome: DomeLight) -> Environment:
    """Return the patch tree of a dome, refined where its spectra are strong."""
    scale = np.abs(dome.basis).max(axis=1)
    return build_environment(dome.coefficients, scale, dome.to_world)


def _fill_basis(target: NDArray[np.float64], basis: NDArray[np.float64]) -> None:
    for k, spectrum in enumerate(basis):
        target[k // 4, k % 4] = spectrum


def _distant_lamps(
    distants: tuple[DistantLight, ...], basis: NDArray[np.float64]
) -> list[_Lamps]:
    """Return the distant lights of each group of four, and fill their groups' spectra."""
    count = len(distants)
    direction, azimuth, elevation = (np.zeros((count, 3)) for _ in range(3))
    flux = np.zeros((count, 4), np.float32)
    for k, distant in enumerate(distants):
        basis[k // 4, k % 4] = distant.irradiance
        flux[k, k % 4] = 1.0
        direction[k] = distant.direction / np.linalg.norm(distant.direction)
        first, second = _tangents(direction[k])
        half = _DISC_TO_SQUARE * np.radians(distant.angle_deg) / 2.0
        azimuth[k], elevation[k] = half * first, half * second
    parts = [slice(k, k + 4) for k in range(0, count, 4)]
    return [
        _Lamps(Patches(direction[part], azimuth[part], elevation[part], flux[None, part]), 4)
        for part in parts
    ]


def _dome_lamps(environment: Environment, groups: int) -> list[_Lamps]:
    found = environment.lamps
    return [
        _Lamps(
            Patches(found.center, found.half_azimuth, found.half_elevation, found.flux[g : g + 1]),
            environment.gloss_lamp_count,
        )
        for g in range(groups)
    ]


def _tangents(axis: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first)
    return first, np.cross(axis, first)


def _upload_lamps(field: structs.Lights, lamps: list[_Lamps], device: str) -> int:
    """Hand the lamps of every group to the kernels; return the number of distinct ones."""

    def joined(name: str) -> NDArray[np.float32]:
        parts = [getattr(lamp.patches, name).reshape(-1, 3) for lamp in lamps]
        return np.concatenate([np.zeros((0, 3)), *parts])

    counts = np.array([len(lamp.patches.center) for lamp in lamps] or [0])
    gloss = np.array([min(lamp.gloss, len(lamp.patches.center)) for lamp in lamps] or [0])
    end = np.cumsum(counts)
    field.lamp_center = _vec3(joined("center"), device)
    field.lamp_azimuth = _vec3(joined("half_azimuth"), device)
    field.lamp_elevation = _vec3(joined("half_elevation"), device)
    flux = [lamp.patches.flux[0] for lamp in lamps]
    field.lamp_flux = _vec4(np.concatenate([np.zeros((0, 4)), *flux]), device)
    field.lamp_end = wp.array(end.astype(np.int32), dtype=wp.int32, device=device)
    field.gloss_end = wp.array((end - counts + gloss).astype(np.int32), dtype=wp.int32, device=device)
    return int(counts.sum())


def integrate_normals(
    tree: reflectance_map.PatchTree,
    normals: NDArray[np.float64],
    wrap: float,
    groups: int,
    workers: Workers,
) -> NDArray[np.float32]:
    """Return J1, J2 and H of the tree at normals, shape [3, groups, count, 4]."""
    count = len(normals)
    normal = _vec3(normals, workers.device)
    out = tuple(
        wp.empty((groups, count), dtype=wp.vec4f, device=workers.device) for _ in range(3)
    )

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


def _bake_dome(
    environment: Environment, wraps: tuple[float, ...], dome: DomeLight, workers: Workers
) -> tuple[list[list[list[NDArray[np.float32]]]], int, float]:
    """Return padded maps [wrap][kernel][group], their rows and their measured error."""
    tree = to_device(environment, workers.device)
    groups = environment.tree.patches.flux.shape[0]
    scale = np.zeros(groups * 4)
    scale[: len(dome.basis)] = np.abs(dome.basis).max(axis=1)
    checks = [_check_normals(environment, wrap) for wrap in wraps]
    truth = [
        integrate_normals(tree, normals, wrap, groups, workers)
        for normals, wrap in zip(checks, wraps, strict=True)
    ]
    peaks = [
        max(_strength(part[1], scale).max(), 1e-30) + _lamp_peak(environment.lamps, scale)
        for part in truth
    ]
    for rows in MAP_ROWS:
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


def _strength(values: NDArray, scale: NDArray[np.float64]) -> NDArray[np.float64]:
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
        first, second = _tangents(axis)
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


def _vec3(values: NDArray, device: str) -> wp.array:
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3f, device=device)


def _vec4(values: NDArray, device: str) -> wp.array:
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec4f, device=device)
