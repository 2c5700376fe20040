"""Geometry of UsdLux's latlong maps: u = 0.5 is +Z, u = 0.25 is +X, v = 0 is +Y.

So it is in the light's own frame, whatever the stage's up axis. Texels are areas: the middle of
the one in row i and column j is at v = (i + 0.5) / height, u = (j + 0.5) / width.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray


def latlong_directions(
    azimuth_turns: NDArray[np.float64], polar: NDArray[np.float64]
) -> NDArray[Any]:
    """Return unit directions in the light's frame, shape [..., 3].

    Args:
        azimuth_turns: u, 0 to 1 from the left edge.
        polar: Angle from +Y [rad], v times pi.
    """
    angle = 2.0 * np.pi * azimuth_turns
    return np.stack(
        [np.sin(polar) * np.sin(angle), np.cos(polar), -np.sin(polar) * np.cos(angle)], axis=-1
    )


def latlong_coordinates(directions: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
    """Return u in [0, 1) and v in [0, 1] of directions of any length.

    Args:
        directions: In the light's frame, shape [..., 3].
    """
    x, y, z = (directions[..., axis] for axis in range(3))
    u = np.arctan2(x, -z) / (2.0 * np.pi)
    return u % 1.0, np.arctan2(np.hypot(x, z), y) / np.pi


def texel_directions(height: int, width: int) -> NDArray[np.float64]:
    """Return the directions of the texels' middles, shape [height, width, 3]."""
    turns = (np.arange(width) + 0.5) / width
    polar = (np.arange(height) + 0.5) * np.pi / height
    return np.asarray(latlong_directions(*np.meshgrid(turns, polar)))


def texel_solid_angles(height: int, width: int) -> NDArray[np.float64]:
    """Return the solid angle of one texel of each row [sr], shape [height].

    That is dAz (sin el_top - sin el_bottom), exactly; over the map they add up to 4 pi.
    """
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    return np.asarray((edges[:-1] - edges[1:]) * (2.0 * np.pi / width))


def latlong_from_world(up_axis: str) -> NDArray[np.float64]:
    """Return the rotation that brings a stage's up to the pole +Y, shape [3, 3].

    Args:
        up_axis: ``Y`` or ``Z``. With Z up, +Z becomes +Y and +Y becomes -Z.
    """
    if up_axis == "Y":
        return np.eye(3)
    return np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
