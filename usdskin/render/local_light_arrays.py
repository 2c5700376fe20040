"""Local lights, handed to the kernels.

Reads: ``LocalLight`` records. Makes: ``LocalField``, the kernels' ``LocalLights`` struct with the
spectra of its channels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.device import vec3, vec4
from usdskin.render.local_lights import KINDS, LocalLight
from usdskin.warp_kernels import local_lights as kernels
from usdskin.warp_kernels.light_pictures import Guides

FloatArray = NDArray[np.float64]

_LANES = 4

_MOST_CELLS = 32
_MOST_GUIDED = 0.8
"""Largest share of samples that follow a picture: the others reach what the cells call dark."""

_LEAST_CONTRAST = 0.05


@dataclass(frozen=True, slots=True, eq=False)
class LocalField:
    """Local lights on a device."""

    device_lights: kernels.LocalLights

    basis: FloatArray
    """Spectrum of every channel, zero where a group is not full, shape [groups, 4, bands]."""

    places: tuple[tuple[int, int], ...]
    """(group, first lane) of each light."""


def build_local_field(
    lights: tuple[LocalLight, ...], band_count: int, device: str, first_group: int = 0
) -> LocalField:
    """Copy local lights to a device, their channels four to a group.

    Args:
        lights: The lights; there may be none.
        band_count: Bands of their spectra.
        device: Where to.
        first_group: What the kernels are to add to the group numbers, where other lights come
            first; ``basis`` and ``places`` begin at 0.
    """
    places, group_count = _places(lights)
    basis = np.zeros((group_count, _LANES, band_count))
    for light, (group, lane) in zip(lights, places, strict=True):
        basis[group, lane : lane + len(light.radiance)] = light.radiance
    device_lights = kernels.LocalLights()
    device_lights.count = len(lights)
    count = len(lights)
    device_lights.kind = _ints([KINDS.index(light.kind) for light in lights], device)
    device_lights.center = vec3(_stack([light.center for light in lights], 3), device)
    for k, name in enumerate(("axis_x", "axis_y", "axis_z")):
        axis = _stack([light.axes[k] for light in lights], 3)
        setattr(device_lights, name, vec3(axis, device))
    half = _stack([light.half for light in lights], 2).astype(np.float32)
    device_lights.half = wp.array(half, dtype=wp.vec2f, device=device)
    channel = np.zeros((count, 3), np.int32)
    for k, (light, (group, lane)) in enumerate(zip(lights, places, strict=True)):
        channel[k] = first_group + group, lane, len(light.radiance)
    device_lights.channel = wp.array(channel, dtype=wp.vec3i, device=device)
    _upload_shaping(device_lights, lights, device)
    _upload_textures(device_lights, lights, device)
    return LocalField(device_lights, basis, places)


def _places(lights: tuple[LocalLight, ...]) -> tuple[tuple[tuple[int, int], ...], int]:
    """Return where each light's channels are, none across two groups, and the group count."""
    places = []
    group, lane = 0, 0
    for light in lights:
        if lane + len(light.radiance) > _LANES:
            group, lane = group + 1, 0
        places.append((group, lane))
        lane += len(light.radiance)
    return tuple(places), group + 1 if places else 0


def _upload_shaping(
    device_lights: kernels.LocalLights, lights: tuple[LocalLight, ...], device: str
) -> None:
    count = len(lights)
    flags = np.zeros(count, np.int32)
    cone = np.zeros((count, 2), np.float32)
    focus = np.zeros((count, 4), np.float32)
    profile = np.zeros((count, 3), np.int32)
    step = np.ones((count, 3), np.float32)
    values: list[NDArray[np.float64]] = []
    used = 0
    for k, light in enumerate(lights):
        shaping = light.shaping
        if shaping.cone_angle is not None:
            flags[k] |= int(kernels.SHAPE_CONE)
            cone[k] = (1.0 - shaping.cone_softness) * shaping.cone_angle, shaping.cone_angle
        if shaping.focus > 0.0:
            flags[k] |= int(kernels.SHAPE_FOCUS)
            focus[k] = (*shaping.focus_tint, shaping.focus)
        if shaping.profile is not None:
            flags[k] |= int(kernels.SHAPE_PROFILE)
            grid = shaping.profile.grid()
            profile[k] = used, *grid.value.shape
            step[k] = grid.theta_step, grid.phi_step, shaping.angle_scale
            values.append(grid.value.ravel())
            used += grid.value.size
    device_lights.shaping = _ints(flags, device)
    device_lights.cone = wp.array(cone, dtype=wp.vec2f, device=device)
    device_lights.focus = vec4(focus, device)
    device_lights.profile = wp.array(profile, dtype=wp.vec3i, device=device)
    device_lights.profile_step = vec3(step, device)
    flat = np.concatenate(values) if values else np.zeros(0)
    device_lights.profile_value = wp.array(flat.astype(np.float32), dtype=wp.float32, device=device)


def _upload_textures(
    device_lights: kernels.LocalLights, lights: tuple[LocalLight, ...], device: str
) -> None:
    place = np.zeros((len(lights), 3), np.int32)
    texels: list[NDArray[np.float32]] = []
    used = 0
    for k, light in enumerate(lights):
        if light.texture is not None:
            height, width = light.texture.shape[:2]
            place[k] = used, width, height
            texels.append(light.texture.reshape(-1, 3))
            used += width * height
    device_lights.texture = wp.array(place, dtype=wp.vec3i, device=device)
    flat = np.concatenate(texels) if texels else np.zeros((0, 3), np.float32)
    device_lights.texel = vec3(flat, device)
    device_lights.guides = _guides(lights, device)


def _guides(lights: tuple[LocalLight, ...], device: str) -> Guides:
    """Return where pictures are bright, in at most 32 by 32 cells each.

    The share of samples that follow a picture grows with its contrast 1 - mean^2 / mean square.
    """
    size = np.zeros((len(lights), 3), np.int32)
    share = np.zeros(len(lights), np.float32)
    sums: list[FloatArray] = []
    used = 0
    for k, light in enumerate(lights):
        if light.texture is None:
            continue
        cells = _coarse(np.abs(light.texture.astype(np.float64)).mean(axis=2))
        square = float((cells**2).mean())
        contrast = 1.0 - float(cells.mean()) ** 2 / square if square > 0.0 else 0.0
        if contrast < _LEAST_CONTRAST:
            continue
        share[k] = _MOST_GUIDED * contrast
        rows, columns = cells.shape
        size[k] = used, columns, rows
        values = np.concatenate([_sums(cells.sum(axis=1)), *(_sums(row) for row in cells)])
        sums.append(values)
        used += values.size
    guides = Guides()
    guides.size = wp.array(size, dtype=wp.vec3i, device=device)
    guides.share = wp.array(share, dtype=wp.float32, device=device)
    flat = np.concatenate(sums) if sums else np.zeros(0)
    guides.sum = wp.array(flat.astype(np.float32), dtype=wp.float32, device=device)
    return guides


def _coarse(values: FloatArray) -> FloatArray:
    """Return means over a grid of no more than 32 by 32 cells of equal size."""
    for axis in (0, 1):
        count = values.shape[axis]
        if count > _MOST_CELLS:
            below = np.insert(np.cumsum(values, axis=axis), 0, 0.0, axis=axis)
            edges = np.linspace(0.0, count, _MOST_CELLS + 1)
            at = np.apply_along_axis(
                lambda line, edges=edges: np.interp(edges, np.arange(line.size), line), axis, below
            )
            values = np.diff(at, axis=axis) * (_MOST_CELLS / count)
    return values


def _sums(values: FloatArray) -> FloatArray:
    """Return the sums up to each value as parts of the whole; even ones where all is dark."""
    total = float(values.sum())
    if total <= 0.0:
        values, total = np.ones_like(values), float(values.size)
    found = np.cumsum(values) / total
    found[-1] = 1.0
    return found


def _ints(values: object, device: str) -> wp.array:
    return wp.array(np.array(values, np.int32).reshape(-1), dtype=wp.int32, device=device)


def _stack(rows: list[object], columns: int) -> FloatArray:
    return np.array(rows, np.float64).reshape(-1, columns)
