"""What skin looks like in two lights: the colour difference between a light and its estimate.

The skin is a convex Lambertian body: it sends E(n) S / pi where its normal is n, so that nothing
but light and reflectance enters. Colour differences are CIEDE2000 with the 1931 observer; Y and
white are those of a perfect diffuser that faces where the true light is brightest.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.colorimetry import xyz_weights
from usdskin.differences import delta_e_of_signals
from usdskin.layers import open_stage
from usdskin.meters import irradiance
from usdskin.render.lights import read_lights

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class RelitDifference:
    """Colour differences of skins at normals."""

    delta_e_2000: FloatArray
    """CIEDE2000, shape [skin_count, normal_count]."""

    y_n: float
    """Y of the perfect diffuser that is the white [cd m^-2, or relative]."""

    white: tuple[float, float]
    """Its chromaticity x, y."""

    @property
    def mean(self) -> float:
        """Mean over skins and normals."""
        return float(self.delta_e_2000.mean())

    @property
    def p95(self) -> float:
        """95th percentile."""
        return float(np.percentile(self.delta_e_2000, 95.0))

    @property
    def max(self) -> float:
        """Largest."""
        return float(self.delta_e_2000.max())


def spectral_irradiance(
    stage: str | Path, directions: FloatArray, wavelength_nm: FloatArray
) -> FloatArray:
    """Return the irradiance of surfaces in a stage's light.

    Args:
        stage: A stage with dome and distant lights.
        directions: Normals, unit vectors in the world, shape [normal_count, 3].
        wavelength_nm: Band centres [nm], shape [n].

    Returns:
        Irradiance [W m^-2 nm^-1, or relative], shape [normal_count, n].

    Raises:
        LayerError: The stage cannot be read.
        ImageError: A map cannot be read.
    """
    lights = read_lights(open_stage(stage), Usd.TimeCode.Default(), wavelength_nm)
    total = np.zeros((len(directions), len(wavelength_nm)))
    for dome in lights.domes:
        toward = directions @ dome.to_world
        found = np.stack([irradiance(dome.coefficients, direction) for direction in toward])
        total += found @ dome.basis
    for distant in lights.distants:
        facing = np.maximum(directions @ distant.direction, 0.0)
        total += facing[:, None] * distant.irradiance
    return total


def compare_lights(
    truth: str | Path,
    estimate: str | Path,
    skins: FloatArray,
    directions: FloatArray,
    wavelength_nm: FloatArray,
) -> RelitDifference:
    """Return how differently skins look in a light and in its estimate.

    Args:
        truth: Stage with the light as it is.
        estimate: Stage with the light as it was estimated, in the same units and world.
        skins: Reflectances, shape [skin_count, n].
        directions: Normals, unit vectors in the world, shape [normal_count, 3].
        wavelength_nm: Band centres [nm], shape [n].

    Raises:
        LayerError: A stage cannot be read.
        ImageError: A map cannot be read.
    """
    true = spectral_irradiance(truth, directions, wavelength_nm) / np.pi
    found = spectral_irradiance(estimate, directions, wavelength_nm) / np.pi
    weights = xyz_weights(wavelength_nm, absolute=True)
    diffuser = true[int(np.argmax(true @ weights[:, 1]))]
    xyz = diffuser @ weights
    shape = (len(skins), len(directions))
    expected = (skins[:, None] * true).reshape(-1, len(wavelength_nm))
    signals = (skins[:, None] * found).reshape(-1, len(wavelength_nm))
    difference = delta_e_of_signals(signals, expected, diffuser, wavelength_nm)
    return RelitDifference(
        delta_e_2000=np.reshape(difference, shape),
        y_n=float(xyz[1]),
        white=(float(xyz[0] / xyz.sum()), float(xyz[1] / xyz.sum())),
    )
