"""How far pictures are from what they should be, over the middle quarter of the picture.

Errors are relative RMSE: sqrt(mean((p - r)^2)) / mean(r), the mean over channels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks import scene

FINER = 4
"""Normals per pixel and axis of our reference."""


def quadrature(normals: NDArray) -> NDArray[np.float64]:
    """Return the irradiance of the room in float64: every texel at its middle, its exact area.

    Args:
        normals: Unit normals, shape [count, 3].
    """
    room = scene.environment().astype(np.float64)
    height, width = room.shape
    polar, azimuth = np.meshgrid(
        np.pi * (np.arange(height) + 0.5) / height,
        2 * np.pi * (np.arange(width) + 0.5) / width,
        indexing="ij",
    )
    toward = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], -1
    ).reshape(-1, 3)
    edge = np.cos(np.pi * np.arange(height + 1) / height)
    flux = (room * ((edge[:-1] - edge[1:]) * 2 * np.pi / width)[:, None]).ravel()
    found = np.zeros(len(normals))
    for begin in range(0, len(normals), 32):
        cosine = toward @ normals[begin : begin + 32].T
        found[begin : begin + 32] = flux @ np.maximum(cosine, 0.0, out=cosine)
    return found


def our_error(picture: NDArray, fine_normals: NDArray, pixels: int) -> tuple[float, float]:
    """Return our relative RMSE and mean error against float64 quadrature at random pixels.

    The body is Lambert in grey light: its picture is irradiance / pi times one colour.

    Args:
        picture: Linear Rec. 709, shape [size, size, 3].
        fine_normals: What a picture ``FINER`` times as large sees, shape [..., ..., 3].
        pixels: How many to compare.
    """
    size = picture.shape[0]
    random = np.random.default_rng(1)
    rows, columns = random.integers(size // 4, size - size // 4, (2, pixels))
    step = np.arange(FINER)
    normals = fine_normals[
        (FINER * rows[:, None] + step)[:, :, None], (FINER * columns[:, None] + step)[:, None, :]
    ].astype(np.float64)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    irradiance = quadrature(normals.reshape(-1, 3)).reshape(pixels, -1).mean(axis=1)
    truth = irradiance[:, None] / np.pi * scene.lit_rgb(scene.reflectance())
    found = picture[rows, columns]
    error = np.sqrt(((found - truth) ** 2).mean(axis=0)) / truth.mean(axis=0)
    return float(error.mean()), float((found.mean(axis=0) / truth.mean(axis=0) - 1.0).mean())


def noise(pictures: NDArray) -> float:
    """Return the relative RMSE of one picture of several that differ by their seed alone.

    A Monte Carlo estimate has no error but its variance, which the scatter over seeds measures
    without a bias: the reference is the mean of the other seeds, its own noise taken into account.

    Args:
        pictures: Shape [seeds, rows, columns, channels], two seeds at least.
    """
    pictures = pictures.astype(np.float64)
    variance = pictures.var(axis=0, ddof=1).mean(axis=(0, 1))
    return float((np.sqrt(variance) / pictures.mean(axis=(0, 1, 2))).mean())


def mean_ratio(ours: NDArray, theirs: NDArray) -> NDArray[np.float64]:
    """Return our mean over the mean of all their seeds, per channel."""
    ratio: NDArray[np.float64] = scene.crop(ours).astype(np.float64).mean(
        axis=(0, 1)
    ) / theirs.astype(np.float64).mean(axis=(0, 1, 2))
    return ratio
