"""Which way the camera looks in the views of a shoot."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Orientation = tuple[float, float]
"""Azimuth, counted to the left from the panorama's -Z, and elevation [deg]."""

THREE_LEVEL: tuple[Orientation, ...] = ((0.0, 0.0), (120.0, 0.0), (240.0, 0.0))
"""Three views a third of a turn apart."""


def rotation_of(orientation: Orientation, panorama_from_world: FloatArray) -> FloatArray:
    """Return the rotation from a camera (looks along -Z, +Y up) to the world, shape [3, 3].

    Args:
        orientation: Azimuth and elevation [deg].
        panorama_from_world: Rotation that takes the world's up to +Y, shape [3, 3].
    """
    azimuth, elevation = np.radians(orientation)
    turn = rotation_about(np.array([0.0, 1.0, 0.0]), azimuth)
    tilt = rotation_about(np.array([1.0, 0.0, 0.0]), elevation)
    return np.asarray(panorama_from_world.T @ turn @ tilt)


def rotation_about(axis: FloatArray, angle: float) -> FloatArray:
    """Return the rotation of column vectors about a unit axis (Rodrigues), shape [3, 3].

    Args:
        axis: Unit vector, shape [3].
        angle: Counterclockwise seen against the axis [rad].
    """
    x, y, z = axis
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)


def misread(rotations: Sequence[FloatArray], error_deg: float, seed: int) -> tuple[FloatArray, ...]:
    """Return rotations as a rig that is read wrongly states them.

    Args:
        rotations: True rotations, shape [3, 3] each.
        error_deg: Angle of every error [deg]; its axis is random.
        seed: Of the axes.
    """
    stated = []
    for index, rotation in enumerate(rotations):
        axis = np.random.default_rng([seed, index, 0xA715]).normal(size=3)
        turn = rotation_about(axis / np.linalg.norm(axis), np.radians(error_deg))
        stated.append(turn @ rotation)
    return tuple(stated)
