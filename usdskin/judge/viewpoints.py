"""Which way the camera looks in the views of a shoot."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError

FloatArray = NDArray[np.float64]
Orientation = tuple[float, float]
"""Azimuth, counted to the left from the panorama's -Z, and elevation [deg]."""

NAMED_VIEWS: Mapping[str, tuple[Orientation, ...]] = {
    "3": ((0.0, 0.0), (120.0, 0.0), (240.0, 0.0)),
    "3+zenith": ((0.0, 0.0), (120.0, 0.0), (240.0, 0.0), (0.0, 90.0)),
    "back-to-back": ((0.0, 0.0), (180.0, 0.0)),
}
"""Sets of views that are in use."""


def parse_views(text: str) -> tuple[Orientation, ...]:
    """Return the orientations that a text names.

    Args:
        text: A name of ``NAMED_VIEWS``, or a list such as ``0,120,240,up`` or ``45:30,225:30``:
            azimuth, or azimuth and elevation [deg], or ``up`` or ``down``.

    Raises:
        UsageError: The text is neither.
    """
    if text in NAMED_VIEWS:
        return NAMED_VIEWS[text]
    special = {"up": (0.0, 90.0), "down": (0.0, -90.0)}
    views: list[Orientation] = []
    for item in text.split(","):
        try:
            numbers = [float(part) for part in item.split(":")] if item not in special else []
        except ValueError:
            numbers = [np.nan]
        if item in special:
            views.append(special[item])
        elif len(numbers) in (1, 2) and np.isfinite(numbers).all():
            views.append((numbers[0], numbers[1] if len(numbers) == 2 else 0.0))
        else:
            raise UsageError(
                f"--views {text}: {item!r} is no view; give {', '.join(NAMED_VIEWS)}, or a list of "
                "azimuths such as 0,120,240,up or azimuth:elevation"
            )
    return tuple(views)


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
