"""A virtual spectroradiometer: the light on a chart, and the readings an instrument gives of it."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.images import replacing
from usdskin.meters import irradiance
from usdskin.render.lights import Lights

FloatArray = NDArray[np.float64]

READING_NM: FloatArray = np.arange(380.0, 781.0, 5.0)
"""Wavelengths of its readings [nm], those of common instruments, shape [81]."""


@dataclass(frozen=True, slots=True)
class Instrument:
    """How well it reads."""

    noise: float = 0.003
    """Standard deviation of a value, relative to it [1]."""

    offset: float = 1e-4
    """Standard deviation that is the same for all values, relative to the white's peak [1]."""

    def read(self, radiance: FloatArray, peak: float, seed: Sequence[int]) -> FloatArray:
        """Return readings of spectra; none is below 0.

        Args:
            radiance: True values, any shape.
            peak: Of the radiance of white.
            seed: Of the noise.
        """
        random = np.random.default_rng(list(seed))
        factor = 1.0 + self.noise * random.normal(size=radiance.shape)
        shift = self.offset * peak * random.normal(size=radiance.shape)
        return np.maximum(radiance * factor + shift, 0.0)


def irradiance_towards(lights: Lights, direction: FloatArray) -> FloatArray:
    """Return the spectral irradiance of a surface, the integral of max(n . omega, 0) L.

    Args:
        lights: The lights, on a grid of wavelengths.
        direction: n, where the surface faces, unit vector in the world, shape [3].

    Returns:
        Irradiance [unit of the lights' radiance times sr], shape [band_count].
    """
    total: FloatArray = np.zeros(0)
    for dome in lights.domes:
        part = irradiance(dome.coefficients, dome.to_world.T @ direction) @ dome.basis
        total = total + part if total.size else part
    for distant in lights.distants:
        part = distant.irradiance * max(float(distant.direction @ direction), 0.0)
        total = total + part if total.size else part
    return total


def radiance_unit(is_absolute: bool, luminance_unit: float, wavelength_nm: FloatArray) -> float:
    """Return the radiance of a unit of light [W m^-2 sr^-1 nm^-1].

    Args:
        is_absolute: Whether light is in that unit already.
        luminance_unit: Luminance of a unit of relative light [cd m^-2].
        wavelength_nm: A grid of wavelengths [nm].
    """
    if is_absolute:
        return 1.0
    relative = xyz_weights(wavelength_nm)[:, 1].sum()
    return float(luminance_unit * relative / xyz_weights(wavelength_nm, absolute=True)[:, 1].sum())


def write_readings(
    path: Path, names: Sequence[str], wavelength_nm: FloatArray, values: FloatArray
) -> None:
    """Write readings as a table, wavelengths down the rows, a column for every name.

    Args:
        path: File to write.
        names: Of the columns, shape [count].
        wavelength_nm: Wavelengths [nm], shape [n].
        values: Radiance [W m^-2 sr^-1 nm^-1], shape [count, n].
    """
    text = io.StringIO()
    text.write("# instrument: virtual spectroradiometer\n")
    text.write("# quantity: radiance\n# units: W m^-2 sr^-1 nm^-1\n")
    table = csv.writer(text, lineterminator="\n")
    table.writerow(["wavelength [nm]", *names])
    for nm, row in zip(wavelength_nm, values.T, strict=True):
        table.writerow([f"{nm:g}", *(f"{value:.7g}" for value in row)])
    with replacing(path) as temporary:
        Path(temporary).write_text(text.getvalue(), "utf-8")
