"""A linear image sensor: from light to raw values, with the noise that real ones have."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError

FloatArray = NDArray[np.float64]

_SATURATED = 4.0  # times the full well: so much light saturates whatever the noise


@dataclass(frozen=True, slots=True, eq=False)
class Sensor:
    """A sensor whose three channels are complete at every pixel: no colour filter mosaic."""

    full_well: float = 60000.0
    """Electrons between black and white at ISO 100."""

    read_noise: float = 3.0
    """Standard deviation without light, in electrons."""

    bits: int = 14
    """Bits of a raw value: 12 or 14 in cameras, 16 at most."""

    black_level: int = 512
    """Raw value without light [DN]."""

    is_noisy: bool = True
    """Whether light comes in photons and reading adds noise. Raw values are always rounded."""

    @property
    def white_level(self) -> int:
        """Largest raw value [DN]."""
        return (1 << self.bits) - 1

    def gain(self, iso: float) -> float:
        """Return the electrons per raw value at a sensitivity setting [DN^-1]."""
        return self.full_well * (100.0 / iso) / (self.white_level - self.black_level)

    def read_noise_dn(self, iso: float) -> float:
        """Return the standard deviation without light, before rounding [DN]."""
        return self.read_noise / self.gain(iso)

    def expose(
        self, light: NDArray[np.floating], iso: float, random: np.random.Generator
    ) -> NDArray[np.uint16]:
        """Return the raw values of pixels.

        Photon arrivals are Poisson, reading adds a Gaussian, rounding is to the nearest raw value
        (EMVA Standard 1288, "The linear model").

        Args:
            light: Exposure relative to what gives white, shape [...].
            iso: Sensitivity setting.
            random: Where the noise comes from.

        Returns:
            Raw values [DN], shape [...].
        """
        well = self.full_well * (100.0 / iso)
        electrons = np.minimum(light.astype(np.float64), _SATURATED) * well
        if self.is_noisy:
            electrons = random.poisson(electrons).astype(np.float64)
            electrons += random.normal(0.0, self.read_noise, electrons.shape)
        values = np.rint(self.black_level + electrons / self.gain(iso))
        return np.clip(values, 0, self.white_level).astype(np.uint16)


@dataclass(frozen=True, slots=True, eq=False)
class Exposures:
    """The settings of the photographs of a view, all arrays of one value per photograph."""

    time_s: FloatArray
    """Exposure times [s], shape [count]."""

    iso: FloatArray
    """Sensitivity settings [1], shape [count]."""

    f_number: FloatArray
    """F-numbers [1], shape [count]."""

    nd_factor: FloatArray
    """Attenuation of neutral density filters [1], shape [count]."""

    @property
    def exposure(self) -> FloatArray:
        """Relative exposure, t (ISO / 100) / N^2 / ND [s], shape [count]."""
        return np.asarray(self.time_s * (self.iso / 100.0) / self.f_number**2 / self.nd_factor)

    def check(self) -> None:
        """Refuse settings that no camera has.

        Raises:
            UsageError: There are none, their numbers differ, or one is out of range.
        """
        least = {"time_s": 0.0, "iso": 0.0, "f_number": 0.0, "nd_factor": 1.0}
        count = self.time_s.size
        for name, bound in least.items():
            values = getattr(self, name)
            if values.shape != (count,) or not count:
                raise UsageError(f"{count} exposures have {values.size} {name}; give one for each")
            good = np.isfinite(values) & (values > 0.0) & (values >= bound)
            if not good.all():
                bad = values[~good][0]
                raise UsageError(f"{name} of an exposure is {bad:g}; give more than {bound:g}")


def exposure_series(
    count: int = 9,
    stops: float = 2.0,
    middle_s: float = 1.0 / 15.0,
    iso: float = 100.0,
    f_number: float = 8.0,
    nd_factor: float = 1.0,
) -> Exposures:
    """Return a bracket of exposure times, the longest first.

    Args:
        count: Photographs.
        stops: Between two of them; a stop is a factor of two.
        middle_s: Exposure time in the middle of the bracket [s].
        iso: Sensitivity setting of all.
        f_number: F-number of all.
        nd_factor: Attenuation of the filter on the lens, at least 1.
    """
    steps = 0.5 * (count - 1) - np.arange(count)
    times = np.asarray(middle_s * 2.0 ** (stops * steps), dtype=np.float64)
    return exposure_list(times, iso, f_number, nd_factor)


def exposure_list(
    time_s: Sequence[float] | FloatArray,
    iso: float | Sequence[float] = 100.0,
    f_number: float | Sequence[float] = 8.0,
    nd_factor: float | Sequence[float] = 1.0,
) -> Exposures:
    """Return settings from lists; a single value stands for all photographs.

    Args:
        time_s: Exposure times [s].
        iso: Sensitivity settings.
        f_number: F-numbers.
        nd_factor: Attenuations of neutral density filters, at least 1.
    """
    times = np.asarray(time_s, dtype=np.float64)
    others = (np.asarray(values, np.float64) for values in (iso, f_number, nd_factor))
    return Exposures(times, *(np.broadcast_to(values, times.shape) for values in others))
