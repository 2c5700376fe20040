"""What a colour scientist asks of a lamp: CCT, Duv, colour rendering, spectral similarity."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import correlated_color_temperature, xyz_weights
from usdskin.illuminants import daylight, planck_radiance
from usdskin.spectrum import resample

FloatArray = NDArray[np.float64]

_FARTHEST = 0.05
"""Duv beyond which a correlated colour temperature is not given (CIE 015:2018)."""

_DAYLIGHT_FROM = 4000.0
_SAMPLES_NM = np.arange(380.0, 781.0, 5.0)


@dataclass(frozen=True, slots=True)
class LightQuality:
    """Figures of a lamp; None where they do not exist."""

    cct: float | None = None
    """Correlated colour temperature [K]."""

    duv: float | None = None
    """Distance from the Planckian locus, above it positive [1]."""

    cri: float | None = None
    """CIE colour rendering index Ra (CIE 013.3-1995) [1]."""

    fidelity: float | None = None
    """CIE 2017 colour fidelity index Rf (CIE 224:2017) [1]."""

    ssi: float | None = None
    """Spectral similarity index (SMPTE ST 2122:2020) [1]."""

    ssi_reference: str = ""
    """Its reference: ``P`` or ``D`` and the colour temperature [K]."""


def light_quality(spectrum: FloatArray, wavelength_nm: FloatArray) -> LightQuality:
    """Return the figures of a lamp, by colour-science.

    Beyond its grid the lamp is taken to go on as its outermost bands are, and so is the reference
    of the SSI: what was not measured is neither praised nor blamed.

    Args:
        spectrum: Power in any scale, shape [band_count].
        wavelength_nm: Band centres [nm], shape [band_count].

    Returns:
        Nothing but None for a black lamp, and CCT and what needs its reference None for one that
        is too far from white.
    """
    lamp = _extended(np.maximum(spectrum, 0.0), wavelength_nm)
    xyz = lamp @ xyz_weights(_SAMPLES_NM)
    if not xyz[1] > 0.0:
        return LightQuality()
    cct, duv = correlated_color_temperature(xyz)
    if not (np.isfinite(cct) and 1000.0 <= cct <= 100000.0 and abs(duv) <= _FARTHEST):
        return LightQuality(duv=duv if np.isfinite(duv) and abs(duv) <= 1.0 else None)
    from colour import SpectralDistribution
    from colour.quality import (
        colour_fidelity_index,
        colour_rendering_index,
        spectral_similarity_index,
    )
    from colour.utilities import suppress_warnings

    def sampled(values: FloatArray) -> SpectralDistribution:
        return SpectralDistribution(values / values.max(), _SAMPLES_NM)

    reference, name = _ssi_reference(cct, wavelength_nm)
    with suppress_warnings(colour_runtime_warnings=True, colour_usage_warnings=True):
        test = sampled(lamp)
        cri = _number(colour_rendering_index(test))
        fidelity = _number(colour_fidelity_index(test, method="CIE 2017"))
        similarity = None
        if reference is not None:
            similar = sampled(_extended(reference, wavelength_nm))
            similarity = _number(spectral_similarity_index(test, similar))
    return LightQuality(cct, duv, cri, float(np.clip(fidelity, 0.0, 100.0)), similarity, name)


def _extended(values: FloatArray, wavelength_nm: FloatArray) -> FloatArray:
    return resample(wavelength_nm, values, _SAMPLES_NM, outside="hold")


def _number(value: Any) -> float:
    return float(value)


def _ssi_reference(cct: float, wavelength_nm: FloatArray) -> tuple[FloatArray | None, str]:
    """Return what the SSI holds a lamp against: a black body below 4000 K, else daylight."""
    if cct < _DAYLIGHT_FROM:
        return planck_radiance(cct, wavelength_nm), f"P{cct:.0f}"
    if cct > 25000.0:
        return None, ""
    return daylight(cct, wavelength_nm), f"D{cct:.0f}"
