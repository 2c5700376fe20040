"""Prefiltered reflections of the domes.

Reads: ``Lights`` and ``LightField``. Fills: the reflection arrays of the kernels' ``Lights``.
Lamps that are reflected by themselves are blackened first, so that nothing counts twice.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers
from usdskin.render.environment import group_count, refined
from usdskin.render.lights import DomeLight, Lights
from usdskin.render.lobe_albedo import schlick_response
from usdskin.warp_kernels import specular, structs

LADDER = (0.0, 0.0025, 0.01, 0.04, 0.09, 0.16, 0.25, 0.36, 0.49, 0.64, 1.0)
"""GGX alphas prefiltered where a roughness varies over a surface."""

_MIRROR_ROWS = 256


def add_reflections(
    field: structs.Lights,
    lights: Lights,
    reflected_blocks: tuple[NDArray[np.int64], ...],
    alphas: tuple[float, ...],
    workers: Workers,
) -> None:
    """Prefilter every dome for the given GGX alphas, ascending; none leaves reflections black.

    Reflections are in the frame of their dome.

    Args:
        field: Where the reflections go.
        lights: The domes.
        reflected_blocks: Texels of each dome that are reflected as lamps (``LightField``).
        alphas: GGX alphas, ascending.
        workers: Where to compute.
    """
    device = workers.device
    field.fresnel = wp.array(schlick_response(), dtype=wp.vec4f, device=device)
    groups = int(field.group_count)
    offsets = np.full((max(1, len(alphas)), groups), -1, np.int32)
    rows = np.zeros_like(offsets)
    parts: list[NDArray[np.float32]] = []
    used, first = 0, 0
    if alphas and lights.domes:
        compilation.load(specular, device)
    for dome, blocks in zip(lights.domes, reflected_blocks, strict=True):
        count = group_count(dome.coefficients.shape[2])
        for g in range(count if alphas else 0):
            texel, level = _pyramid(dome, blocks, g)
            for k, alpha in enumerate(alphas):
                size = _grid_rows(alpha, dome.coefficients.shape[0])
                offsets[k, first + g], rows[k, first + g] = used, size
                parts.append(_prefilter(texel, level, alpha, size, workers))
                used += len(parts[-1])
        first += count
    flat = np.concatenate(parts) if parts else np.zeros((0, 4), np.float32)
    field.gloss_value = wp.array(flat, dtype=wp.vec4f, device=device)
    field.gloss_offset = wp.array(offsets, dtype=wp.int32, device=device)
    field.gloss_rows = wp.array(rows, dtype=wp.int32, device=device)
    field.gloss_alpha = wp.array(
        np.array(alphas if parts else (), np.float32), dtype=wp.float32, device=device
    )


def show_domes(field: structs.Lights, lights: Lights, show: bool, device: str) -> None:
    """Hand the domes' own texels to the kernels where the camera sees them."""
    groups = int(field.group_count)
    offsets = np.full(groups, -1, np.int32)
    rows, columns = np.zeros(groups, np.int32), np.zeros(groups, np.int32)
    parts: list[NDArray[np.float32]] = []
    used, first = 0, 0
    for dome in lights.domes if show else ():
        for g in range(group_count(dome.coefficients.shape[2])):
            image = _group_image(dome.coefficients, g)
            offsets[first] = used
            rows[first], columns[first] = image.shape[:2]
            parts.append(image.reshape(-1, 4))
            used += len(parts[-1])
            first += 1
    flat = np.concatenate(parts) if parts else np.zeros((0, 4), np.float32)
    field.dome_value = wp.array(flat, dtype=wp.vec4f, device=device)
    field.dome_offset = wp.array(offsets, dtype=wp.int32, device=device)
    field.dome_rows = wp.array(rows, dtype=wp.int32, device=device)
    field.dome_columns = wp.array(columns, dtype=wp.int32, device=device)


def _grid_rows(alpha: float, map_rows: int) -> int:
    """Return H of a node grid fine enough for a lobe about 2 alpha wide, or for the map."""
    finest = int(np.clip(map_rows, 24, _MIRROR_ROWS))
    if alpha <= 0.0:
        return finest
    return int(np.clip(np.ceil(8.0 / alpha), 24, finest))


def _group_image(coefficients: NDArray[np.float32], group: int) -> NDArray[np.float32]:
    part = coefficients[:, :, 4 * group : 4 * group + 4]
    image = np.zeros((*part.shape[:2], 4), np.float32)
    image[:, :, : part.shape[2]] = part
    return image


def _pyramid(
    dome: DomeLight, blocks: NDArray[np.int64], group: int
) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Return the texels of all levels and (offset, width, height) of each."""
    image = _group_image(refined(dome.coefficients), group)
    for row, column, height, width in blocks:
        image[row : row + height, column : column + width] = 0.0
    images = [image]
    while min(images[-1].shape[:2]) > 4:
        image = images[-1]
        height, width = image.shape[0] // 2, image.shape[1] // 2
        image = image[: 2 * height, : 2 * width]
        images.append(image.reshape(height, 2, width, 2, 4).mean(axis=(1, 3)))
    level, used = [], 0
    for image in images:
        level.append((used, image.shape[1], image.shape[0]))
        used += image.shape[0] * image.shape[1]
    return np.concatenate([image.reshape(-1, 4) for image in images]), np.array(level, np.int32)


def _prefilter(
    texel: NDArray[np.float32],
    level: NDArray[np.int32],
    alpha: float,
    rows: int,
    workers: Workers,
) -> NDArray[np.float32]:
    device = workers.device
    if 2.0 * alpha < np.pi / level[0, 2]:
        alpha = 0.0  # the lobe is narrower than a texel
    count = (rows + 1) * (2 * rows + 1)
    texels = wp.array(texel, dtype=wp.vec4f, device=device)
    levels = wp.array(level, dtype=wp.vec3i, device=device)
    out = wp.empty(count, dtype=wp.vec4f, device=device)

    def work(begin: int, end: int) -> None:
        specular.prefilter(texels, levels, alpha, rows, out, begin, end)

    workers.run(count, 2048 if device == "cpu" else count, work)
    return np.asarray(out.numpy(), np.float32)
