"""Spectra and wavelength grids, and the one way to bring a spectrum onto a grid.

A grid is a list of band centres. A band reaches half way to its neighbours, the outermost bands
as far outwards as inwards, so that bands tile the range without gaps whatever the spacing.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

Interpolation = Literal["linear", "held"]
Outside = Literal["zero", "hold"]

_SAME_WAVELENGTH_NM = 1e-6


def _read_only(values: ArrayLike) -> NDArray[np.float64]:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


DEFAULT_WAVELENGTHS_NM: NDArray[np.float64] = _read_only(np.arange(400.0, 701.0, 5.0))
"""The default grid, 400 to 700 nm in steps of 5 nm [nm], shape [61]."""


class SpectralQuantity(Enum):
    """What the values of a spectrum measure; the member's value is its token in a layer."""

    REFLECTANCE = "reflectance"
    TRANSMITTANCE = "transmittance"
    RADIANCE = "radiance"
    IRRADIANCE = "irradiance"
    ABSORPTION = "absorption"
    RESPONSIVITY = "responsivity"
    SCATTERING = "scattering"
    RELATIVE = "relative"

    @property
    def unit(self) -> str:
        """Unit of the values; ``"1"`` where they have none."""
        return _UNITS.get(self, "1")

    @property
    def outside(self) -> Outside:
        """What lies beyond the sampled range: nothing is emitted or sensed, a material goes on."""
        return "hold" if self in _MATERIAL_QUANTITIES else "zero"


_UNITS = {
    SpectralQuantity.RADIANCE: "W m^-2 sr^-1 nm^-1",
    SpectralQuantity.IRRADIANCE: "W m^-2 nm^-1",
    SpectralQuantity.ABSORPTION: "m^-1",
}
_MATERIAL_QUANTITIES = {
    SpectralQuantity.REFLECTANCE,
    SpectralQuantity.TRANSMITTANCE,
    SpectralQuantity.ABSORPTION,
    SpectralQuantity.SCATTERING,
}


@dataclass(frozen=True, slots=True, eq=False)
class Spectrum:
    """A quantity sampled over wavelength.

    Raises:
        ValueError: The samples are empty, not finite, of unequal number or not ascending.
    """

    quantity: SpectralQuantity
    """What is measured, and so its unit."""

    wavelength_nm: NDArray[np.float64]
    """Sample positions [nm], strictly ascending, shape [sample_count]."""

    value: NDArray[np.float64]
    """Samples [``quantity.unit``], shape [sample_count]."""

    interpolation: Interpolation = "linear"
    """How the quantity runs between samples."""

    def __post_init__(self) -> None:
        """Copy both arrays to read-only float64 and check them together."""
        object.__setattr__(self, "wavelength_nm", _read_only(self.wavelength_nm))
        object.__setattr__(self, "value", _read_only(self.value))
        check_grid(self.wavelength_nm)
        if self.value.shape != self.wavelength_nm.shape:
            raise ValueError(
                f"{self.wavelength_nm.size} wavelengths but values of shape {self.value.shape}"
            )
        if not np.isfinite(self.value).all():
            raise ValueError("a spectrum's values must be finite")
        if self.interpolation not in ("linear", "held"):
            raise ValueError(f"unknown interpolation {self.interpolation!r}")

    def resample(self, to_nm: ArrayLike, outside: Outside | None = None) -> NDArray[np.float64]:
        """Return band averages on another grid.

        Args:
            to_nm: Band centres [nm], strictly ascending, shape [band_count].
            outside: What lies beyond the samples; by default what suits the quantity.

        Returns:
            Band averages [``quantity.unit``], shape [band_count].
        """
        return resample(
            self.wavelength_nm,
            self.value,
            to_nm,
            interpolation=self.interpolation,
            outside=self.quantity.outside if outside is None else outside,
        )


def check_grid(wavelength_nm: NDArray[np.float64]) -> None:
    """Refuse a wavelength grid that is not a strictly ascending list of positive numbers.

    Args:
        wavelength_nm: Wavelengths [nm], shape [count].

    Raises:
        ValueError: It is empty, not one-dimensional, not finite, not positive or not ascending.
    """
    if wavelength_nm.ndim != 1 or wavelength_nm.size == 0:
        raise ValueError(f"wavelengths must be a list, not an array of {wavelength_nm.shape}")
    if not np.isfinite(wavelength_nm).all() or wavelength_nm[0] <= 0.0:
        raise ValueError("wavelengths must be finite and positive")
    falls = np.flatnonzero(np.diff(wavelength_nm) <= 0.0)
    if falls.size:
        at = int(falls[0])
        raise ValueError(
            f"wavelengths must ascend, but {wavelength_nm[at + 1]:g} nm follows "
            f"{wavelength_nm[at]:g} nm"
        )


def band_edges(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return the edges of the bands around a grid's centres.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count], at least two.

    Returns:
        Edges [nm], half way between centres, shape [band_count + 1].

    Raises:
        ValueError: The grid is unusable, or has one band only and so no width.
    """
    centers = np.asarray(wavelength_nm, dtype=np.float64)
    check_grid(centers)
    if centers.size < 2:
        raise ValueError("a grid of one wavelength has no band width; give two or more")
    middles = 0.5 * (centers[1:] + centers[:-1])
    first = 2.0 * centers[0] - middles[0]
    last = 2.0 * centers[-1] - middles[-1]
    return np.concatenate(([first], middles, [last]))


def band_widths(wavelength_nm: ArrayLike) -> NDArray[np.float64]:
    """Return the widths of the bands around a grid's centres.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count], at least two.

    Returns:
        Widths [nm], shape [band_count].
    """
    return np.diff(band_edges(wavelength_nm))


def resample(
    wavelength_nm: ArrayLike,
    value: ArrayLike,
    to_nm: ArrayLike,
    interpolation: Interpolation = "linear",
    outside: Outside = "zero",
) -> NDArray[np.float64]:
    """Return the averages of a sampled function over the bands of another grid.

    The function is integrated exactly over every band: picking points of a fluorescent lamp at
    10 nm costs a colour difference above 1. Where the two grids have the same centres a sample
    already is the average of its band (that is how tables and spectrometers give it) and is
    passed on as it is.

    Args:
        wavelength_nm: Sample positions [nm], strictly ascending, shape [sample_count].
        value: Samples, wavelength last, shape [..., sample_count].
        to_nm: Band centres [nm], strictly ascending, shape [band_count].
        interpolation: ``linear`` between samples, or each sample ``held`` up to the next one (and
            the last for as long as the one before it).
        outside: Beyond the samples the function is ``zero``, but for the outermost samples'
            own half band; or it is ``hold``, the outermost sample for ever.

    Returns:
        Band averages, shape [..., band_count].

    Raises:
        ValueError: A grid is unusable or the shapes disagree.
    """
    source = np.asarray(wavelength_nm, dtype=np.float64)
    target = np.asarray(to_nm, dtype=np.float64)
    samples = np.asarray(value, dtype=np.float64)
    check_grid(source)
    check_grid(target)
    if samples.ndim == 0 or samples.shape[-1] != source.size:
        raise ValueError(f"{source.size} wavelengths but values of shape {samples.shape}")
    if interpolation not in ("linear", "held") or outside not in ("zero", "hold"):
        raise ValueError(f"unknown interpolation {interpolation!r} or outside {outside!r}")
    shared = _shared_samples(source, target)
    if shared is not None:
        inside, first = shared
        result = np.zeros((*samples.shape[:-1], target.size))
        count = inside.stop - inside.start
        result[..., inside] = samples[..., first : first + count]
        if outside == "hold":
            result[..., : inside.start] = samples[..., :1]
            result[..., inside.stop :] = samples[..., -1:]
        return result
    edges = band_edges(target)
    knots, heights = _extended(source, samples, edges, interpolation, outside)
    integral = _integral(knots, heights, edges, interpolation)
    averages: NDArray[np.float64] = np.diff(integral, axis=-1) / np.diff(edges)
    return averages


def _shared_samples(
    source: NDArray[np.float64], target: NDArray[np.float64]
) -> tuple[slice, int] | None:
    """Return the bands that are samples of ``source`` too, where the grids agree, else None."""
    low = int(np.searchsorted(target, source[0] - _SAME_WAVELENGTH_NM))
    high = int(np.searchsorted(target, source[-1] + _SAME_WAVELENGTH_NM))
    # A single shared sample says nothing about the spacing, unless it is all there is.
    if high - low < min(2, source.size) or high == low:
        return None
    first = int(np.searchsorted(source, target[low] - _SAME_WAVELENGTH_NM))
    count = high - low
    if first + count > source.size:
        return None
    if np.abs(source[first : first + count] - target[low:high]).max() > _SAME_WAVELENGTH_NM:
        return None
    return slice(low, high), first


def _extended(
    source: NDArray[np.float64],
    samples: NDArray[np.float64],
    edges: NDArray[np.float64],
    interpolation: Interpolation,
    outside: Outside,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return knots and heights with the function's reach beyond its outermost samples added."""
    left, right = source[0], source[-1]
    if interpolation == "held" and source.size > 1:
        right += source[-1] - source[-2]
    if outside == "hold":
        left, right = min(left, edges[0]), max(right, edges[-1])
    else:
        widths = np.diff(edges)
        at = np.clip(np.searchsorted(edges, source[[0, -1]]) - 1, 0, widths.size - 1)
        reach = 0.5 * widths[at]
        if source.size > 1:
            reach = np.minimum(reach, 0.5 * np.diff(source)[[0, -1]])
        left, right = source[0] - reach[0], max(right, source[-1] + reach[1])
    knots = np.concatenate(([left], source, [right]))
    heights = np.concatenate((samples[..., :1], samples, samples[..., -1:]), axis=-1)
    return knots, heights


def _integral(
    knots: NDArray[np.float64],
    heights: NDArray[np.float64],
    at: NDArray[np.float64],
    interpolation: Interpolation,
) -> NDArray[np.float64]:
    """Return the running integral of the function from its first knot to each position."""
    steps = np.diff(knots)
    if interpolation == "linear":
        pieces = 0.5 * (heights[..., 1:] + heights[..., :-1]) * steps
    else:
        pieces = heights[..., :-1] * steps
    totals = np.concatenate(
        (np.zeros((*heights.shape[:-1], 1)), np.cumsum(pieces, axis=-1)), axis=-1
    )
    position = np.clip(at, knots[0], knots[-1])
    piece = np.clip(np.searchsorted(knots, position, side="right") - 1, 0, steps.size - 1)
    along = position - knots[piece]
    inside = heights[..., piece] * along
    if interpolation == "linear":
        rise = heights[..., piece + 1] - heights[..., piece]
        step = np.where(steps[piece] > 0.0, steps[piece], 1.0)
        inside = inside + 0.5 * rise * along**2 / step
    result: NDArray[np.float64] = totals[..., piece] + inside
    return result
