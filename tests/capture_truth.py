"""How far a captured panorama is from the truth that the virtual photographer kept."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.images import read_image
from usdskin.latlong import texel_directions, texel_solid_angles
from usdskin.layers import open_stage
from usdskin.prims.values import DEFAULT_TIME, read_schema

FloatArray = NDArray[np.float64]

DIRECTIONS = texel_directions(8, 16).reshape(-1, 3)


def lamp_room(height: int) -> FloatArray:
    """Return a latlong of a room of 5 x 3 x 7 m with two tubes, pictures and soft shading.

    The lamps stand five decades above the darkest place. Shape [height, 2 height, 3].
    """
    rays = texel_directions(height, 2 * height)
    low, high = np.array([-2.2, -1.3, -3.0]), np.array([2.8, 1.7, 4.0])
    with np.errstate(divide="ignore"):
        reach = np.where(rays > 0.0, high / rays, low / rays)
    side = reach.argmin(axis=2)
    point = rays * reach.min(axis=2)[..., None]
    index = 2 * side + (np.take_along_axis(rays, side[..., None], 2)[..., 0] > 0.0)
    walls = np.array(
        [
            [0.5, 0.3, 0.2],
            [0.2, 0.4, 0.3],
            [0.25, 0.2, 0.15],
            [0.7, 0.7, 0.65],
            [0.3, 0.35, 0.5],
            [0.6, 0.55, 0.4],
        ]
    )
    pattern = 1.0 + 0.4 * np.sin(3.0 * point[..., 0] + point[..., 2]) * np.cos(2.5 * point[..., 1])
    value = walls[index] * pattern[..., None] / (0.5 + 0.15 * (point**2).sum(2))[..., None]
    frames = (np.abs(np.sin(2.2 * point[..., 0]) * np.sin(1.9 * point[..., 2] + 0.5)) > 0.6) & (
        np.abs(point[..., 1]) < 0.5
    )
    value[frames & (side != 1)] *= (0.3, 0.5, 0.7)
    corner = (np.abs(point - (low + 0.3)) < 0.3).all(axis=2)
    value[corner] *= 0.02
    for x in (-0.8, 1.4):
        tube = (np.abs(point[..., 0] - x) < 0.09) & (np.abs(point[..., 2] - 0.5) < 0.9)
        value[tube & (index == 3)] = (310.0, 300.0, 260.0)
    return value


@dataclass(frozen=True)
class Error:
    """Panorama against truth."""

    median: float
    """Median relative error over pixels above a tenth of the mean, by solid angle [1]."""

    irradiance: float
    """Largest error of the irradiance over all directions, relative to the largest [1]."""

    flux: float
    """Relative error of the flux [1]."""


def results(capture: Path) -> dict[str, object]:
    """Return the attributes of CaptureAPI in a layer."""
    stage = open_stage(capture)
    return read_schema(stage.GetDefaultPrim(), "CaptureAPI", DEFAULT_TIME)


def camera_values(capture: Path) -> FloatArray:
    """Return the panorama of a layer in camera values rho."""
    values = results(capture)
    pixels = read_image(values["capture:panorama:file"]).pixels.astype(np.float64)
    return pixels / values["capture:scale"]


def reduced(pixels: FloatArray, height: int) -> FloatArray:
    """Average blocks of texels by their solid angle, to a height that divides theirs."""
    factor = pixels.shape[0] // height
    assert pixels.shape[0] == factor * height
    weight = texel_solid_angles(*pixels.shape[:2])
    rows = (pixels * weight[:, None, None]).reshape(height, factor, -1, 3).sum(1)
    rows /= weight.reshape(height, factor).sum(1)[:, None, None]
    return rows.reshape(height, -1, factor, 3).mean(2)


def irradiance(pixels: FloatArray, directions: FloatArray) -> FloatArray:
    """Return the irradiance of surfaces, texels taken as points, shape [count, channels]."""
    toward = texel_directions(*pixels.shape[:2]).reshape(-1, 3)
    light = (pixels * texel_solid_angles(*pixels.shape[:2])[:, None, None]).reshape(-1, 3)
    return np.stack([np.maximum(toward @ n, 0.0) @ light for n in directions])


def error_of(capture: Path, shoot: Path, where: NDArray[np.bool_] | None = None) -> Error:
    """Compare a captured panorama with the truth of its shoot.

    Args:
        capture: The layer of the capture.
        shoot: The layer of the virtual shoot, with ``truth/`` beside it.
        where: Texels of the panorama to compare in the median; all where None.
    """
    found = camera_values(capture)
    truth = read_image(shoot.parent / "truth" / "truth.exr").pixels.astype(np.float64)
    height = min(len(found), len(truth))
    found, truth = reduced(found, height), reduced(truth, height)
    size = np.broadcast_to(texel_solid_angles(*truth.shape[:2])[:, None], truth.shape[:2])
    mean = np.average(truth, axis=(0, 1), weights=size)
    bright = (truth > 0.1 * mean).all(axis=2)
    if where is not None:
        bright &= where
    relative = np.abs(found / np.where(truth > 0.0, truth, 1.0) - 1.0).mean(axis=2)[bright]
    order = np.argsort(relative)
    sums = np.cumsum(size[bright][order])
    expected, got = irradiance(truth, DIRECTIONS), irradiance(found, DIRECTIONS)
    flux = (size[..., None] * truth).sum((0, 1))
    return Error(
        median=float(relative[order][np.searchsorted(sums, 0.5 * sums[-1])]),
        irradiance=float((np.abs(got - expected) / expected.max(axis=0)).max()),
        flux=float(np.abs((size[..., None] * found).sum((0, 1)) / flux - 1.0).max()),
    )
