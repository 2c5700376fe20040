"""Which way the camera looked in the views of a shoot, as people say it.

A direction is an azimuth, counted to the left (counterclockwise seen from above, as USD's
``rotateY``) from the stage's -Z, and an elevation above the horizon.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError

FloatArray = NDArray[np.float64]

_WORDS = {
    "up": (0.0, 90.0),
    "zenith": (0.0, 90.0),
    "down": (0.0, -90.0),
    "nadir": (0.0, -90.0),
    "front": (0.0, 0.0),
    "left": (90.0, 0.0),
    "back": (180.0, 0.0),
    "right": (270.0, 0.0),
}
_SET = re.compile(r"(?P<count>[1-9]|1[0-2])(?P<zenith>\+zenith)?(?P<nadir>\+nadir)?")
_LEAST_TURN_DEG = 20.0  # views 1, 2, 3 are numbered, not aimed
_FORMS = (
    "3, 3+zenith, back-to-back, or a list of azimuths such as 0,120,240,up or azimuth:elevation"
)


class Direction(NamedTuple):
    """Where a camera looks."""

    azimuth_deg: float
    """To the left from -Z [deg]."""

    elevation_deg: float = 0.0
    """Above the horizon [deg]."""

    def __str__(self) -> str:
        """Return the direction as ``parse_directions`` reads it."""
        if abs(self.elevation_deg) == 90.0 and self.azimuth_deg == 0.0:
            return "up" if self.elevation_deg > 0.0 else "down"
        tilt = f":{self.elevation_deg:g}" if self.elevation_deg else ""
        return f"{self.azimuth_deg:g}{tilt}"

    @property
    def is_level(self) -> bool:
        """Whether it is nearer to the horizon than to the poles."""
        return abs(self.elevation_deg) < 45.0

    @property
    def vector(self) -> FloatArray:
        """Unit vector in the stage's world, shape [3]."""
        return -self.rotation()[:, 2]

    def rotation(self, roll_deg: float = 0.0) -> FloatArray:
        """Return the rotation from the camera (looks along -Z, +Y up) to the world, shape [3, 3].

        Args:
            roll_deg: How far the camera is turned about its axis, its top to the left [deg].
        """
        azimuth, elevation, roll = np.radians((self.azimuth_deg, self.elevation_deg, roll_deg))
        return np.asarray(_about_y(azimuth) @ _about_x(elevation) @ _about_z(roll))


def parse_direction(text: str) -> Direction | None:
    """Return the direction that a text such as ``120``, ``45:30`` or ``up`` names, if any."""
    if text.lower() in _WORDS:
        return Direction(*_WORDS[text.lower()])
    try:
        numbers = [float(part) for part in text.split(":")]
    except ValueError:
        return None
    if len(numbers) > 2 or not all(map(math.isfinite, numbers)):
        return None
    direction = Direction(*numbers)
    return direction if abs(direction.elevation_deg) <= 90.0 else None


def parse_directions(text: str) -> tuple[Direction, ...]:
    """Return the directions of a shoot's views.

    Args:
        text: How many look evenly around, with a zenith and a nadir where named (``3``,
            ``3+zenith``, ``4+zenith+nadir``), ``back-to-back``, or a list such as
            ``0,120,240,up`` or ``45:30,225:30``.

    Raises:
        UsageError: The text is none of these.
    """
    if text == "back-to-back":
        return evenly_around(2)
    named = _SET.fullmatch(text)
    if named:
        level = evenly_around(int(named["count"]))
        poles = [name for name in ("zenith", "nadir") if named[name]]
        return (*level, *(Direction(*_WORDS[name]) for name in poles))
    directions = []
    for item in text.split(","):
        direction = parse_direction(item.strip())
        if direction is None:
            raise UsageError(f'--views {text}: "{item}" is no direction; give {_FORMS}')
        directions.append(direction)
    return tuple(directions)


def evenly_around(count: int) -> tuple[Direction, ...]:
    """Return directions evenly around the vertical."""
    return tuple(Direction(360.0 * index / count) for index in range(count))


def directions_of_names(names: Sequence[str]) -> tuple[Direction, ...] | None:
    """Return the directions that all names of views tell, such as 0, 120, 240 and up; else None."""
    found = [parse_direction(name) for name in names]
    directions = tuple(direction for direction in found if direction is not None)
    if len(directions) < len(names) or len(set(directions)) < len(names) or len(names) < 2:
        return None
    level = sorted(item.azimuth_deg for item in directions if item.is_level)
    is_aimed = all(b - a >= _LEAST_TURN_DEG for a, b in pairwise(level))
    return directions if is_aimed else None


def _about_x(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def _about_y(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def _about_z(angle: float) -> FloatArray:
    c, s = math.cos(angle), math.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
