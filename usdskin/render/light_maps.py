"""Domes and distant lights, made ready to be looked up at any normal.

Reads: ``Lights``. Makes: ``LightField``, the kernels' ``Lights`` struct with the spectra of its
channels: smooth maps of each dome, and the small bright lamps that are evaluated by themselves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.device import Workers, vec3, vec4
from usdskin.errors import UsageError
from usdskin.render.environment import (
    Environment,
    Patches,
    build_environment,
    group_count,
    pad_groups,
    texel_patches,
)
from usdskin.render.lights import DistantLight, DomeLight, Lights
from usdskin.render.zonal_maps import bake_maps, tangents
from usdskin.warp_kernels import structs

_DISC_TO_SQUARE = 0.5 * np.sqrt(3.0)
"""Half side of the square with a disc's second moment, per unit of its radius."""


@dataclass(frozen=True, slots=True, eq=False)
class LightField:
    """The light of a stage in coefficient channels, and what each channel's spectrum is."""

    device_lights: structs.Lights
    basis: NDArray[np.float64]
    """Spectrum of every channel, zero where a group is not full, shape [groups, 4, bands]."""

    reflected_blocks: tuple[NDArray[np.int64], ...]
    """Per dome, (row, column, height, width) of the texels whose lamps are reflected by themselves,
    shape [count, 4]."""

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


def build_light_field(
    lights: Lights,
    wraps: tuple[float, ...],
    workers: Workers,
    wavelength_count: int,
    split: bool = False,
) -> LightField:
    """Integrate the stage's lights over both kernels.

    Args:
        lights: Domes and distant lights.
        wraps: The values of l that materials use, one map set each.
        workers: Where to compute.
        wavelength_count: Bands of the lights' spectra.
        split: Whether light from before and from behind is told apart (materials with opacity).

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
    blocks: list[NDArray[np.int64]] = []
    sizes, errors = [], []
    begin, used = 0, 0
    for dome, count in zip(lights.domes, groups, strict=True):
        environment = dome_environment(dome, workers.threads)
        blocks.append(environment.lamp_blocks[: environment.gloss_lamp_count])
        _fill_basis(basis[begin : begin + count], dome.basis)
        if environment.tree.skip.size:
            maps, size, error = bake_maps(environment, wraps, _channel_scale(dome), workers, split)
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
    field.map_value = vec4(flat, device)
    field.map_offset = wp.array(offsets, dtype=wp.int32, device=device)
    field.map_rows = wp.array(rows, dtype=wp.int32, device=device)
    field.wrap = wp.array(np.array(wraps, np.float32), dtype=wp.float32, device=device)
    lamp_count = _upload_lamps(field, lamps, device)
    return LightField(field, basis, tuple(blocks), tuple(sizes), tuple(errors), lamp_count)


def build_brute_field(
    lights: Lights, wraps: tuple[float, ...], workers: Workers, wavelength_count: int
) -> LightField:
    """Return the oracle's light: every texel a lamp, every band a channel, and no maps.

    The texels' spectra are reconstructed first; neither the factorisation nor an interpolated map
    has a part in the picture, which takes time in proportion to texels times bands.

    Args:
        lights: Domes and distant lights.
        wraps: The values of l that materials use.
        workers: Where to compute.
        wavelength_count: Bands of the lights' spectra.
    """
    groups = group_count(wavelength_count)
    basis = np.zeros((groups, 4, wavelength_count))
    _fill_basis(basis, np.eye(wavelength_count))
    spectra = np.zeros((len(lights.distants), wavelength_count))
    for k, distant in enumerate(lights.distants):
        spectra[k] = distant.irradiance
    patches = [_distant_patches(lights.distants, spectra)]
    patches += [
        texel_patches(dome.coefficients, dome.basis, dome.to_world) for dome in lights.domes
    ]
    field = structs.Lights()
    field.group_count = groups
    field.map_value = vec4(np.zeros((0, 4)), workers.device)
    field.wrap = wp.array(np.array(wraps, np.float32), dtype=wp.float32, device=workers.device)
    field.map_offset = wp.full((len(wraps), 3, groups), -1, dtype=wp.int32, device=workers.device)
    field.map_rows = wp.zeros(groups, dtype=wp.int32, device=workers.device)
    lamps = [
        _Lamps(
            Patches(
                np.concatenate([part.center for part in patches]),
                np.concatenate([part.half_azimuth for part in patches]),
                np.concatenate([part.half_elevation for part in patches]),
                np.concatenate([part.flux[g : g + 1] for part in patches], axis=1),
            ),
            len(lights.distants),
        )
        for g in range(groups)
    ]
    count = _upload_lamps(field, lamps, workers.device)
    none = tuple(np.zeros((0, 4), np.int64) for _ in lights.domes)
    return LightField(field, basis, none, (), (), count)


def banded(lights: Lights) -> Lights:
    """Return the lights with the bands themselves as the dome's channels.

    For the oracle's reflections and background; what it integrates is in ``build_brute_field``.

    Raises:
        UsageError: There are several domes, whose maps cannot share the channels.
    """
    if len(lights.domes) > 1:
        names = ", ".join(dome.path for dome in lights.domes)
        raise UsageError(f"--spectral brute takes one dome, and this stage has {names}; hide one.")
    return Lights(
        tuple(
            replace(
                dome,
                coefficients=(dome.coefficients @ dome.basis.astype(np.float32)),
                basis=np.eye(dome.basis.shape[1]),
            )
            for dome in lights.domes
        ),
        lights.distants,
        lights.locals,
    )


def dome_environment(dome: DomeLight, threads: int = 1) -> Environment:
    """Return the patch tree of a dome, refined where its spectra are strong."""
    scale = _channel_scale(dome)
    return build_environment(dome.coefficients, scale, dome.to_world, threads=threads)


def _channel_scale(dome: DomeLight) -> NDArray[np.float64]:
    return np.asarray(np.abs(dome.basis).max(axis=1))


def _fill_basis(target: NDArray[np.float64], basis: NDArray[np.float64]) -> None:
    for k, spectrum in enumerate(basis):
        target[k // 4, k % 4] = spectrum


def _distant_lamps(distants: tuple[DistantLight, ...], basis: NDArray[np.float64]) -> list[_Lamps]:
    """Return the distant lights of each group of four, and fill their groups' spectra."""
    for k, distant in enumerate(distants):
        basis[k // 4, k % 4] = distant.irradiance
    found = _distant_patches(distants, np.tile(np.eye(4), (len(basis), 1))[: len(distants)])
    parts = [slice(k, k + 4) for k in range(0, len(distants), 4)]
    return [
        _Lamps(
            Patches(found.center[part], found.half_azimuth[part], found.half_elevation[part],
                    found.flux[:, part]),
            4,
        )
        for part in parts
    ]  # fmt: skip


def _distant_patches(distants: tuple[DistantLight, ...], channels: NDArray[np.float64]) -> Patches:
    """Return the discs of distant lights as squares with the same second moment.

    Args:
        distants: The lights.
        channels: Irradiance of each in the light's channels, shape [count, channel_count].
    """
    direction, azimuth, elevation = (np.zeros((len(distants), 3), np.float32) for _ in range(3))
    for k, distant in enumerate(distants):
        axis = distant.direction / np.linalg.norm(distant.direction)
        first, second = tangents(axis)
        half = _DISC_TO_SQUARE * np.radians(distant.angle_deg) / 2.0
        direction[k], azimuth[k], elevation[k] = axis, half * first, half * second
    return Patches(direction, azimuth, elevation, pad_groups(channels))


def _dome_lamps(environment: Environment, groups: int) -> list[_Lamps]:
    found = environment.lamps
    return [
        _Lamps(
            Patches(found.center, found.half_azimuth, found.half_elevation, found.flux[g : g + 1]),
            environment.gloss_lamp_count,
        )
        for g in range(groups)
    ]


def _upload_lamps(field: structs.Lights, lamps: list[_Lamps], device: str) -> int:
    """Hand the lamps of every group to the kernels; return the number of distinct ones."""

    def joined(name: str) -> NDArray[np.float32]:
        parts = [getattr(lamp.patches, name).reshape(-1, 3) for lamp in lamps]
        return np.concatenate([np.zeros((0, 3)), *parts])

    counts = np.array([len(lamp.patches.center) for lamp in lamps] or [0])
    gloss = np.array([min(lamp.gloss, len(lamp.patches.center)) for lamp in lamps] or [0])
    end = np.cumsum(counts)
    field.lamp_center = vec3(joined("center"), device)
    field.lamp_azimuth = vec3(joined("half_azimuth"), device)
    field.lamp_elevation = vec3(joined("half_elevation"), device)
    extents = [np.linalg.norm(joined(name), axis=1) for name in ("half_azimuth", "half_elevation")]
    reach = ((extents[0] + extents[1]) * 1.00001).astype(np.float32)
    field.lamp_reach = wp.array(reach, dtype=wp.float32, device=device)
    flux = [lamp.patches.flux[0] for lamp in lamps]
    field.lamp_flux = vec4(np.concatenate([np.zeros((0, 4)), *flux]), device)
    field.lamp_end = wp.array(end.astype(np.int32), dtype=wp.int32, device=device)
    field.gloss_end = wp.array(
        (end - counts + gloss).astype(np.int32), dtype=wp.int32, device=device
    )
    return int(counts.sum())
