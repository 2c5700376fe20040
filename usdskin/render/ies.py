"""Luminous intensity distributions of lamps: IES LM-63 files with Type C photometry."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_STEPS_DEG = (90.0, 45.0, 30.0, 22.5, 15.0, 10.0, 7.5, 5.0, 2.5, 2.0, 1.0, 0.5, 0.25, 0.1)
"""Spacings tried for the even grid; the last one is used where none meets all angles."""


@dataclass(frozen=True, slots=True, eq=False)
class ProfileGrid:
    """A profile over evenly spaced angles, both ends included."""

    theta_step: float
    """[rad]."""

    phi_step: float
    """[rad]."""

    value: FloatArray
    """Rows over theta from 0 to pi, columns over phi from 0 to 2 pi, shape [rows, columns]."""


@dataclass(frozen=True, slots=True, eq=False)
class IntensityProfile:
    """Luminous intensity over direction, linear in both angles between its samples."""

    theta_deg: FloatArray
    """Angles from straight down [deg], ascending within 0 to 180; zero outside, shape [n]."""

    phi_deg: FloatArray
    """Angles about the vertical [deg], from 0 to 360, shape [m]."""

    intensity: FloatArray
    """[cd], shape [n, m]."""

    def grid(self) -> ProfileGrid:
        """Return the profile on the widest even grid that holds its samples."""
        theta_step = _common_step(np.append(self.theta_deg, 180.0))
        phi_step = _common_step(self.phi_deg)
        theta = np.linspace(0.0, 180.0, round(180.0 / theta_step) + 1)
        phi = np.linspace(0.0, 360.0, round(360.0 / phi_step) + 1)
        over_theta = np.stack(
            [
                np.interp(theta, self.theta_deg, column, left=0.0, right=0.0)
                for column in self.intensity.T
            ],
            axis=1,
        )
        value = np.stack([np.interp(phi, self.phi_deg, row) for row in over_theta])
        return ProfileGrid(np.radians(theta_step), np.radians(phi_step), value)


def _common_step(angle_deg: FloatArray) -> float:
    """Return the widest known spacing whose multiples hold all angles."""
    for step in _STEPS_DEG:
        if np.abs(angle_deg / step - np.round(angle_deg / step)).max() < 1e-6:
            return step
    return _STEPS_DEG[-1]
