"""A fisheye lens as a camera has it: which light falls on which pixel.

This is code of its own, so that it can judge the lens code of the capture step: both follow the
schema's text, neither calls the other.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import UsageError
from usdskin.judge.shoot.environments import pixel_shifts
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

FIELD_MARGIN_DEG = 1.0
"""How far a lens draws beyond the angle it is stated to hold [deg]."""

_LEAST_SAMPLES = 4  # per pixel, in each direction
# Contrast over the environment's mean, and how many times as many samples it calls for.
_EDGES = ((100.0, 16), (10.0, 8), (1.0, 4))
_PIXELS_PER_BLOCK = 1 << 15
_LEAST_ROWS = 16  # of a block, which computes two more
_TABLE_SIZE = 4096


def radius_at(lens: FisheyeLens, angle: FloatArray) -> FloatArray:
    """Return the image height of rays at some angles from the axis [px].

    Args:
        lens: The lens.
        angle: phi [rad], any shape.
    """
    focal = lens.focal_length_px
    if lens.projection == "equidistant":
        return focal * angle
    if lens.projection == "equisolid":
        return 2.0 * focal * np.sin(0.5 * angle)
    if lens.projection == "stereographic":
        return 2.0 * focal * np.tan(0.5 * angle)
    if lens.projection == "orthographic":
        return focal * np.sin(angle)
    if lens.projection == "opencv":
        square = angle * angle
        factor = np.ones_like(square)
        for index, k in enumerate(lens.distortion, start=1):
            factor = factor + k * square**index
        return focal * angle * factor
    raise UsageError(
        f"no fisheye projection {lens.projection!r}; use equidistant, equisolid, stereographic, "
        "orthographic or opencv"
    )


def field_angle(lens: FisheyeLens) -> float:
    """Return the angle up to which a lens draws [rad], a little beyond what it states.

    Raises:
        UsageError: Before the stated angle the image height falls again, so that two directions
            would share a pixel, or V is not above 0.
    """
    stated = math.radians(lens.max_angle_deg)
    angles = np.linspace(0.0, min(stated + math.radians(FIELD_MARGIN_DEG), math.pi), _TABLE_SIZE)
    rises = np.diff(radius_at(lens, angles), prepend=-1.0) > 0.0
    usable = rises & (vignetting(lens, angles * angles) > 0.0)
    reach = float(angles[-1 if usable.all() else max(int(np.argmin(usable)) - 1, 0)])
    if reach < stated - 2.0 * angles[1]:
        raise UsageError(
            f"a lens of projection {lens.projection} that turns back or grows dark at "
            f"{math.degrees(reach):.2f} degrees cannot hold {lens.max_angle_deg:g}; lower its "
            "largest angle or mend its coefficients"
        )
    return max(reach, stated)


def vignetting(lens: FisheyeLens, angle_squared: FloatArray) -> FloatArray:
    """Return V = 1 + a2 phi^2 + a4 phi^4 + ... at some angles, given as phi^2 [rad^2]."""
    value = np.zeros_like(angle_squared)
    for coefficient in lens.vignetting[::-1]:
        value = (value + coefficient) * angle_squared
    return 1.0 + value


def inverse_projection(lens: FisheyeLens) -> Callable[[FloatArray], FloatArray]:
    """Return the function from image height [px] to angle [rad]; beyond the field it is NaN."""
    focal, limit = lens.focal_length_px, field_angle(lens)
    edge = float(radius_at(lens, np.array([limit]))[0])

    if lens.projection == "opencv":
        angles = np.linspace(0.0, limit, _TABLE_SIZE)
        heights = radius_at(lens, angles)

    def angle_at(radius: FloatArray) -> FloatArray:
        height = np.where(radius <= edge, radius, np.nan)
        if lens.projection == "equidistant":
            return height / focal
        if lens.projection == "equisolid":
            return 2.0 * np.arcsin(np.minimum(height / (2.0 * focal), 1.0))
        if lens.projection == "stereographic":
            return 2.0 * np.arctan(height / (2.0 * focal))
        if lens.projection == "orthographic":
            return np.arcsin(np.minimum(height / focal, 1.0))
        # The table is right to 1e-7; a Newton step squares that.
        angle = np.interp(height, heights, angles)
        slope = np.full_like(angle, focal)
        for index, k in enumerate(lens.distortion, start=1):
            slope += focal * (2 * index + 1) * k * angle ** (2 * index)
        return angle - (radius_at(lens, angle) - height) / slope

    return angle_at


def pixel_angles(lens: FisheyeLens, begin: int, end: int) -> FloatArray:
    """Return the angle from the axis of the middles of some rows of pixels [rad].

    Args:
        lens: The lens.
        begin: First row.
        end: Row after the last.

    Returns:
        phi, NaN where the lens draws nothing, shape [end - begin, width].
    """
    x = np.arange(lens.resolution[0]) + 0.5 - lens.center_px[0]
    y = np.arange(begin, end) + 0.5 - lens.center_px[1]
    return inverse_projection(lens)(np.hypot(x[None, :], y[:, None]))


class Scene(Protocol):
    """What a lens can draw: an ``Environment``, or something before it."""

    @property
    def detail(self) -> float:
        """Size of the smallest thing to be seen [rad]."""
        ...

    def look(self, directions: FloatArray, world_from: FloatArray) -> FloatArray:
        """Return the responses seen in directions, R, G and B first, shape [..., channels]."""
        ...

    def mean(self) -> FloatArray:
        """Return the mean response over the sphere, shape [channels]."""
        ...


class Picture:
    """What a lens draws of an environment: its light on every pixel, averaged over the pixel.

    A pixel averages a grid of samples, four by four or as many as the environment's detail asks
    for; four to sixteen times as many each way where the edge of a lamp crosses it.
    """

    def __init__(self, environment: Scene, lens: FisheyeLens, rotation: FloatArray) -> None:
        """Take a lens at one orientation.

        Args:
            environment: What is seen.
            lens: The lens.
            rotation: From the camera (looks along -Z, +Y up) to the world, shape [3, 3].
        """
        self._environment = environment
        self._lens = lens
        self._rotation = rotation
        self._angle_at = inverse_projection(lens)
        pixel = field_angle(lens) / float(radius_at(lens, np.array([field_angle(lens)]))[0])
        self._count = max(_LEAST_SAMPLES, math.ceil(2.0 * pixel / environment.detail))
        self._mean = float(environment.mean()[:3].sum())

    def draw(self, workers: Workers, advance: Callable[[int], None]) -> NDArray[np.float32]:
        """Return the picture without glare.

        Args:
            workers: How many threads work on it.
            advance: Told how many rows are done.

        Returns:
            Responses of R, G and B times V, shape [height, width, 3]; 0 beyond the lens's field.
        """
        width, height = self._lens.resolution
        picture = np.empty((height, width, 3), np.float32)

        def rows(begin: int, end: int) -> None:
            picture[begin:end] = self._rows(begin, end)

        workers.run(height, max(_LEAST_ROWS, _PIXELS_PER_BLOCK // width), rows, advance)
        return picture

    def _rows(self, begin: int, end: int) -> FloatArray:
        # With a row more on either side: a pixel beside an edge may hold a sliver of the lamp.
        rows, columns = np.arange(begin - 1, end + 1), np.arange(self._lens.resolution[0])
        i, j = np.broadcast_arrays(rows[:, None], columns[None, :])
        mean, spread = self._average(i, j, self._count)
        is_done = np.zeros(i.shape, dtype=bool)
        for contrast, factor in _EDGES:
            edge = _with_neighbours(spread > contrast * self._mean) & ~is_done
            if edge.any():
                mean[edge], _ = self._average(i[edge], j[edge], factor * self._count)
                is_done |= edge
        return mean[1:-1]

    def _average(
        self, i: NDArray[np.int64], j: NDArray[np.int64], count: int
    ) -> tuple[FloatArray, FloatArray]:
        """Return the mean of count x count samples of pixels, and their spread."""
        shift_u, shift_v = pixel_shifts(i, j)
        total = np.zeros((*i.shape, 3))
        least, most = np.full(i.shape, np.inf), np.zeros(i.shape)
        across = np.arange(count).reshape(-1, *(1 for _ in i.shape))
        for down in range(count):
            seen = self._sample(j + (across + shift_u) / count, i + (down + shift_v) / count)
            total += seen.sum(axis=0)
            level = seen.sum(axis=-1)
            np.minimum(least, level.min(axis=0), out=least)
            np.maximum(most, level.max(axis=0), out=most)
        return total / count**2, most - least

    def _sample(self, u: FloatArray, v: FloatArray) -> FloatArray:
        x, y = u - self._lens.center_px[0], v - self._lens.center_px[1]
        radius = np.hypot(x, y)
        angle = self._angle_at(radius)
        outside = np.isnan(angle)
        angle[outside] = 0.0
        sideways = np.sin(angle) / np.maximum(radius, 1e-300)
        directions = np.stack([x * sideways, -y * sideways, -np.cos(angle)])
        seen = self._environment.look(directions, self._rotation)[..., :3]
        seen *= np.where(outside, 0.0, vignetting(self._lens, angle * angle))[..., None]
        return seen


def _with_neighbours(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a mask grown by one pixel, shape [height, width]."""
    grown = mask.copy()
    grown[1:] |= mask[:-1]
    grown[:-1] |= mask[1:]
    across = grown.copy()
    across[:, 1:] |= grown[:, :-1]
    across[:, :-1] |= grown[:, 1:]
    return across
