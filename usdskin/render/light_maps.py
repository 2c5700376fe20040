"""Domes and distant lights, made ready to be looked up at any normal.

Reads: ``Lights``. Makes: ``LightField``, the kernels' ``Lights`` struct with the spectra of its
channels: smooth maps of each dome, and the small bright lamps that are evaluated by themselves.
Maps and lamps of a dome are in its own frame; the kernels are told how it is turned.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.device import Workers, copied, vec3, vec4
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
from usdskin.render.local_light_arrays import LocalField
from usdskin.render.surface_rows import SpectralFrame
from usdskin.render.zonal_maps import bake_maps, tangents
from usdskin.warp_kernels import structs

_WIDEST_CELL = np.radians(6.0)
"""Half angle of a disc that is one square, and of the cells of a wider one [rad]."""

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

    lamps: tuple[Lamps, ...]
    """Those of the domes in their own frames, group after group."""

    local: LocalField | None = None
    """Lights that have a place, where light is traced."""


@dataclass(slots=True, eq=False)
class Lamps:
    """Lamps of one channel group."""

    patches: Patches
    """With the flux of this group alone, in the frame of their dome."""

    gloss: int
    """How many of them, the first ones, are reflected by themselves."""


def far_groups(lights: Lights) -> int:
    """Return how many channel groups domes and distant lights take."""
    domes = sum(group_count(dome.coefficients.shape[2]) for dome in lights.domes)
    return domes + group_count(len(lights.distants))


def build_light_field(
    lights: Lights,
    wraps: tuple[float, ...],
    workers: Workers,
    wavelength_count: int,
    split: bool = False,
    local: LocalField | None = None,
) -> LightField:
    """Integrate the stage's lights over both kernels.

    Args:
        lights: Domes and distant lights.
        wraps: The values of l that materials use, one map set each.
        workers: Where to compute.
        wavelength_count: Bands of the lights' spectra.
        split: Whether light from before and from behind is told apart (materials with opacity).
        local: Lights that have a place, which no map holds; their channels come last.

    Returns:
        The field; ``device_lights`` has no reflections and no visible dome yet.
    """
    device = workers.device
    groups = [group_count(dome.coefficients.shape[2]) for dome in lights.domes]
    distant_groups = group_count(len(lights.distants))
    extra = np.zeros((0, 4, wavelength_count)) if local is None else local.basis
    total = max(1, sum(groups) + distant_groups + len(extra))
    basis = np.zeros((total, 4, wavelength_count))
    offsets = np.full((len(wraps), 3, total), -1, np.int32)
    rows = np.zeros(total, np.int32)
    lamps: list[Lamps] = []
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
    for k, distant in enumerate(lights.distants):
        basis[begin + k // 4, k % 4] = distant.irradiance
    begin += distant_groups
    basis[begin : begin + len(extra)] = extra
    field = structs.Lights()
    field.group_count = total
    flat = np.concatenate(values) if values else np.zeros((0, 4), np.float32)
    field.map_value = vec4(flat, device)
    field.map_offset = wp.array(offsets, dtype=wp.int32, device=device)
    field.map_rows = wp.array(rows, dtype=wp.int32, device=device)
    field.wrap = wp.array(np.array(wraps, np.float32), dtype=wp.float32, device=device)
    light = LightField(
        field, basis, tuple(blocks), tuple(sizes), tuple(errors), tuple(lamps), local
    )
    _stand(light, lights, device)
    return light


def stand_domes(light: LightField, lights: Lights, device: str) -> LightField:
    """Return the light of domes and distant lights that have been turned; their maps stay.

    Args:
        light: Of these lights, however they were turned when it was built; it is not changed.
        lights: The lights as they are turned now.
        device: Where to.
    """
    turned = replace(light, device_lights=copied(light.device_lights, structs.Lights))
    _stand(turned, lights, device)
    return turned


def _stand(light: LightField, lights: Lights, device: str) -> None:
    """Tell the kernels how domes are turned and where distant lights are."""
    groups = int(light.device_lights.group_count)
    lamps: list[Lamps] = []
    for dome in lights.domes:
        for mine in light.lamps[len(lamps) : len(lamps) + group_count(dome.coefficients.shape[2])]:
            lamps.append(Lamps(_turned(mine.patches, dome.to_world), mine.gloss))
    lamps += _distant_lamps(lights.distants)
    lamps += [_no_lamps() for _ in range(groups - len(lamps))]
    _upload_lamps(light.device_lights, lamps, device)
    _set_frames(light.device_lights, lights.domes, device)


def _turned(patches: Patches, to_world: NDArray[np.float64]) -> Patches:
    turn = to_world.T
    return Patches(
        (patches.center @ turn).astype(np.float32),
        (patches.half_azimuth @ turn).astype(np.float32),
        (patches.half_elevation @ turn).astype(np.float32),
        patches.flux,
    )


def _set_frames(
    field: structs.Lights, domes: tuple[DomeLight, ...], device: str, only: int | None = None
) -> None:
    """Hand the frames of the domes, in which the maps are, to the kernels.

    Args:
        field: Where to.
        domes: In the order of their channel groups.
        device: Where to.
        only: Groups of each dome, if not those of its coefficients.
    """
    groups = int(field.group_count)
    to_local = np.tile(np.eye(3, dtype=np.float32), (groups, 1, 1))
    begins = np.zeros(groups, np.int32)
    first = 0
    for dome in domes:
        count = only or group_count(dome.coefficients.shape[2])
        to_local[first : first + count] = dome.to_world.T
        begins[first] = 1
        first += count
    field.dome_to_local = wp.array(to_local, dtype=wp.mat33f, device=device)
    field.frame_begins = wp.array(begins, dtype=wp.int32, device=device)


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
        Lamps(
            Patches(
                np.concatenate([part.center for part in patches]),
                np.concatenate([part.half_azimuth for part in patches]),
                np.concatenate([part.half_elevation for part in patches]),
                np.concatenate([part.flux[g : g + 1] for part in patches], axis=1),
            ),
            len(patches[0].center),
        )
        for g in range(groups)
    ]
    _upload_lamps(field, lamps, workers.device)
    _set_frames(field, lights.domes[:1], workers.device, groups)
    none = tuple(np.zeros((0, 4), np.int64) for _ in lights.domes)
    return LightField(field, basis, none, (), (), ())


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


def luminances(light: LightField, frame: SpectralFrame) -> NDArray[np.float64]:
    """Return Y of every channel's spectrum, shape [groups, 4]."""
    weights = xyz_weights(frame.wavelength_nm, frame.observer, frame.absolute)
    return np.asarray(light.basis @ weights[:, 1])


def dome_environment(dome: DomeLight, threads: int = 1) -> Environment:
    """Return the patch tree of a dome in its own frame, refined where its spectra are strong."""
    return build_environment(dome.coefficients, _channel_scale(dome), np.eye(3), threads=threads)


def _channel_scale(dome: DomeLight) -> NDArray[np.float64]:
    return np.asarray(np.abs(dome.basis).max(axis=1))


def _fill_basis(target: NDArray[np.float64], basis: NDArray[np.float64]) -> None:
    for k, spectrum in enumerate(basis):
        target[k // 4, k % 4] = spectrum


def _distant_lamps(distants: tuple[DistantLight, ...]) -> list[Lamps]:
    """Return the distant lights of each group of four."""
    found = []
    for k in range(0, len(distants), 4):
        some = distants[k : k + 4]
        patches = _distant_patches(some, np.eye(4)[: len(some)])
        found.append(Lamps(patches, len(patches.center)))
    return found


def _no_lamps() -> Lamps:
    none = np.zeros((0, 3), np.float32)
    return Lamps(Patches(none, none, none, np.zeros((1, 0, 4), np.float32)), 0)


def _distant_patches(distants: tuple[DistantLight, ...], channels: NDArray[np.float64]) -> Patches:
    """Return distant lights as squares with their discs' second moments, wide ones in cells.

    Args:
        distants: The lights.
        channels: Irradiance of each in the light's channels, shape [count, channel_count].
    """
    parts = [_disc_cells(distant) for distant in distants]
    owner = np.repeat(np.arange(len(parts)), [len(part) for part in parts])
    cells = np.concatenate([np.zeros((0, 10)), *parts])
    return Patches(
        cells[:, 0:3].astype(np.float32), cells[:, 3:6].astype(np.float32),
        cells[:, 6:9].astype(np.float32), pad_groups(channels[owner] * cells[:, 9:10]),
    )  # fmt: skip


def _disc_cells(distant: DistantLight) -> NDArray[np.float64]:
    """Return the direction, half extents and share of irradiance of a disc's cells, [count, 10].

    Cells of equal solid angle lie in rings around the middle; a narrow disc is one square.
    """
    axis = distant.direction / np.linalg.norm(distant.direction)
    first, second = tangents(axis)
    reach = np.radians(min(distant.angle_deg, 360.0)) / 2.0
    rings = int(np.ceil(reach / _WIDEST_CELL)) if reach > _WIDEST_CELL else 0
    if not rings:
        half = _DISC_TO_SQUARE * reach
        return np.concatenate([axis, half * first, half * second, [1.0]])[None]
    counts = np.array([max(1, 6 * ring) for ring in range(rings)])
    edge = np.concatenate([[0.0], np.cumsum(counts)]) / counts.sum() * (1.0 - np.cos(reach))
    inner, outer = np.arccos(1.0 - edge[:-1]), np.arccos(np.clip(1.0 - edge[1:], -1.0, 1.0))
    cells = []
    for ring, count in enumerate(counts):
        polar = np.arccos(1.0 - 0.5 * (edge[ring] + edge[ring + 1])) if ring else 0.0
        for turn in 2.0 * np.pi * (np.arange(count) + 0.5) / count:
            across = np.cos(turn) * first + np.sin(turn) * second
            toward = np.cos(polar) * axis + np.sin(polar) * across
            if ring:
                along = np.cross(axis, across) * np.sin(polar) * np.pi / count
                down = (
                    (np.cos(polar) * across - np.sin(polar) * axis)
                    * 0.5
                    * (outer[ring] - inner[ring])
                )
            else:
                along, down = (_DISC_TO_SQUARE * outer[0] * each for each in (first, second))
            cells.append(np.concatenate([toward, along, down, [1.0]]))
    table = np.array(cells)
    table[:, 9] = 1.0 / np.maximum(table[:, 0:3] @ axis, 0.0).sum()
    return table


def _dome_lamps(environment: Environment, groups: int) -> list[Lamps]:
    found = environment.lamps
    return [
        Lamps(
            Patches(found.center, found.half_azimuth, found.half_elevation, found.flux[g : g + 1]),
            environment.gloss_lamp_count,
        )
        for g in range(groups)
    ]


def _upload_lamps(field: structs.Lights, lamps: list[Lamps], device: str) -> None:
    """Hand the lamps of every group to the kernels."""

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
