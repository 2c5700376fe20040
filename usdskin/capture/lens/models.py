"""Radial lens models: image height over the angle from the axis, and its derivatives.

Both are OpenCV's. ``fisheye`` (Kannala and Brandt, "A Generic Camera Model and Calibration Method
for Conventional, Wide-Angle, and Fish-Eye Lenses", PAMI 28(8), 2006) is the one that
``FisheyeCameraAPI`` calls ``opencv``; ``omnidir`` is the unified model of Mei and Rives ("Single
View Point Omnidirectional Camera Calibration from Planar Grids", ICRA 2007) without its tangential
terms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class RadialModel:
    """A family of curves r(phi; p); p[0] scales them."""

    name: str
    """``fisheye`` or ``omnidir``."""

    parameter_count: int
    """Length of p."""

    start: Callable[[float], FloatArray]
    """p of about r = f phi, given f [px]."""

    evaluate: Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray, FloatArray]]
    """Given p and phi [rad], shape [n]: r [px], shape [n]; dr/dphi, shape [n]; dr/dp, shape
    [n, parameter_count]."""

    def radius(self, parameters: FloatArray, angle_rad: FloatArray) -> FloatArray:
        """Return r [px] at phi [rad]."""
        return self.evaluate(parameters, angle_rad)[0]


def _fisheye(
    parameters: FloatArray, angle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate r = f (phi + k1 phi^3 + k2 phi^5 + k3 phi^7 + k4 phi^9), p = (f, k1 .. k4)."""
    f, k = parameters[0], parameters[1:]
    powers = angle[:, None] ** np.array([3, 5, 7, 9])
    shape = angle + powers @ k
    slope = 1.0 + (angle[:, None] ** np.array([2, 4, 6, 8]) * [3, 5, 7, 9]) @ k
    return f * shape, f * slope, np.column_stack([shape, f * powers])


def _omnidir(
    parameters: FloatArray, angle: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Evaluate r = g m (1 + k1 m^2 + k2 m^4), m = sin phi / (cos phi + xi), p = (g, xi, k1, k2)."""
    g, xi, k1, k2 = parameters
    below = np.cos(angle) + xi
    m = np.sin(angle) / below
    shape = m * (1.0 + k1 * m**2 + k2 * m**4)
    d_shape = 1.0 + 3.0 * k1 * m**2 + 5.0 * k2 * m**4
    slope = d_shape * (1.0 + xi * np.cos(angle)) / below**2
    columns = [shape, -g * d_shape * m / below, g * m**3, g * m**5]
    return g * shape, g * slope, np.column_stack(columns)


MODELS = {
    "fisheye": RadialModel("fisheye", 5, lambda f: np.array([f, 0.0, 0.0, 0.0, 0.0]), _fisheye),
    # xi = 1 is the stereographic projection.
    "omnidir": RadialModel("omnidir", 4, lambda f: np.array([2.0 * f, 1.0, 0.0, 0.0]), _omnidir),
}
