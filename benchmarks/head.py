"""A head that throws shadows on itself, as arrays: made by formula, from nobody's scan.

A superellipsoid that is pushed out along its radii to a nose, brows, cheeks, a chin, ears, a neck
and curls, and in to eye sockets and a mouth. It is one closed surface around its centre.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

POWER = 2.3
HALF_AXES = (0.66, 0.86, 0.74)
"""Half width, height and depth of the skull [m]."""

BUMPS = (
    # direction, angular radius [degree] across and up, height over the radius there [1]
    ((0.0, -0.10, 1.0), 9.0, 15.0, 0.32),  # nose
    ((0.0, 0.34, 1.0), 30.0, 6.5, 0.09),  # brows
    ((0.34, 0.13, 1.0), 10.0, 8.0, -0.24),  # eye sockets
    ((-0.34, 0.13, 1.0), 10.0, 8.0, -0.24),
    ((0.52, -0.22, 1.0), 13.0, 11.0, 0.07),  # cheeks
    ((-0.52, -0.22, 1.0), 13.0, 11.0, 0.07),
    ((0.0, -0.46, 1.0), 15.0, 4.0, -0.13),  # mouth
    ((0.0, -0.80, 1.0), 17.0, 9.0, 0.18),  # chin
    ((1.0, 0.0, -0.05), 6.0, 17.0, 0.50),  # ears
    ((-1.0, 0.0, -0.05), 6.0, 17.0, 0.50),
    ((1.0, 0.0, 0.22), 8.0, 12.0, -0.12),  # the hollows before them
    ((-1.0, 0.0, 0.22), 8.0, 12.0, -0.12),
    ((0.0, -1.0, -0.12), 26.0, 26.0, 0.75),  # neck
)


def head(rows: int) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """Return points [m], unit normals and triangles of a head of 4 rows^2 triangles.

    It looks along +Z and stands along +Y. The normals are those of the formula.
    """
    polar, azimuth = np.meshgrid(
        np.pi * np.arange(rows + 1) / rows,
        np.pi * np.arange(2 * rows + 1) / rows,
        indexing="ij",
    )
    toward = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), np.sin(polar) * np.cos(azimuth)], -1
    ).reshape(-1, 3)
    points = toward * _radius(toward)[:, None]
    # The surface is where |p| = radius(p / |p|), so the gradient of the difference is its normal.
    normals = np.empty_like(points)
    step = 1.0e-5
    for axis in range(3):
        shift = np.zeros(3)
        shift[axis] = step
        normals[:, axis] = _outside(points + shift) - _outside(points - shift)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    i, j = (index.ravel() for index in np.indices((rows, 2 * rows)))
    a = i * (2 * rows + 1) + j
    b, c, d = a + 2 * rows + 1, a + 2 * rows + 2, a + 1
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return points, normals, faces.astype(np.int32)


def _outside(points: FloatArray) -> FloatArray:
    distance = np.linalg.norm(points, axis=1)
    result: FloatArray = distance - _radius(points / distance[:, None])
    return result


def _radius(toward: FloatArray) -> FloatArray:
    """Return the distance of the surface from the centre [m] along unit vectors."""
    skull = (np.abs(toward / np.array(HALF_AXES)) ** POWER).sum(axis=1) ** (-1.0 / POWER)
    push = np.zeros(len(toward))
    for direction, across_deg, up_deg, height in BUMPS:
        axis = np.array(direction) / np.linalg.norm(direction)
        side = np.cross([0.0, 1.0, 0.0] if abs(axis[1]) < 0.9 else [0.0, 0.0, 1.0], axis)
        side /= np.linalg.norm(side)
        up = np.cross(axis, side)
        ahead = np.maximum(toward @ axis, 1.0e-3)
        x = np.arctan2(toward @ side, ahead) / np.radians(across_deg)
        y = np.arctan2(toward @ up, ahead) / np.radians(up_deg)
        push += height * np.exp(-((x**2 + y**2) ** 1.5) / 2.0) * (toward @ axis > 0.0)
    # Curls over the top and the back.
    hair = 1.0 / (1.0 + np.exp(-(toward[:, 1] - 0.55 - 0.9 * toward[:, 2]) / 0.06))
    hair *= 1.0 / (1.0 + np.exp(-(toward[:, 1] + 0.35) / 0.06))
    curls = np.sin(26.0 * toward[:, 0]) * np.sin(26.0 * toward[:, 1] + 13.0 * toward[:, 2])
    push += hair * (0.05 + 0.055 * curls)
    result: FloatArray = skull * (1.0 + push)
    return result
