"""What signals look like: chromaticities, and the colors that stand for them in a figure."""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import (
    cat16,
    color_matching_functions,
    encode_srgb,
    white_xyz,
    xyz_to_lab,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.illuminants import planck_radiance

FloatArray = NDArray[np.float64]

_SPACE = "lin_rec709_scene"
_LOCUS_NM = (400.0, 700.0)
_DARKEST_ON_WHITE = 0.62


def uniform_chromaticity(xyz: ArrayLike) -> FloatArray:
    """Return u', v' of the CIE 1976 uniform chromaticity scale (CIE 015:2018).

    Args:
        xyz: Tristimulus values, shape [..., 3].

    Returns:
        u', v', shape [..., 2]; NaN where X + 15 Y + 3 Z is not positive.
    """
    x, y, z = np.moveaxis(np.asarray(xyz, dtype=np.float64), -1, 0)
    total = x + 15.0 * y + 3.0 * z
    total = np.where(total > 0.0, total, np.nan)
    return np.stack([4.0 * x / total, 9.0 * y / total], axis=-1)


def signal_chromaticity(signals: ArrayLike, wavelength_nm: ArrayLike) -> FloatArray:
    """Return u', v' of spectra for the CIE 1931 observer.

    Args:
        signals: Spectra in any unit, shape [..., band_count].
        wavelength_nm: Band centres [nm], shape [band_count].

    Returns:
        Chromaticities, shape [..., 2].
    """
    return uniform_chromaticity(np.asarray(signals) @ xyz_weights(wavelength_nm))


@cache
def spectral_locus() -> tuple[FloatArray, FloatArray]:
    """Return the wavelengths [nm] and u', v' of monochromatic light, shape [k] and [k, 2]."""
    wavelength_nm = np.arange(_LOCUS_NM[0] - 10.0, _LOCUS_NM[1] + 11.0, 5.0)
    inside = (wavelength_nm >= _LOCUS_NM[0]) & (wavelength_nm <= _LOCUS_NM[1])
    functions = color_matching_functions(wavelength_nm)[inside]
    return wavelength_nm[inside], uniform_chromaticity(functions)


def planckian_chromaticity(temperatures: ArrayLike) -> FloatArray:
    """Return u', v' of black bodies.

    Args:
        temperatures: Their temperatures [K], shape [count].

    Returns:
        Chromaticities, shape [count, 2].
    """
    wavelength_nm = np.arange(380.0, 781.0, 5.0)
    bodies = [planck_radiance(float(kelvin), wavelength_nm) for kelvin in np.ravel(temperatures)]
    return signal_chromaticity(np.array(bodies), wavelength_nm)


def lab_values(signals: ArrayLike, illuminant: ArrayLike, wavelength_nm: ArrayLike) -> FloatArray:
    """Return L*, a*, b* of signals against the light they were seen in, shape [count, 3].

    Args:
        signals: Spectra, shape [count, band_count].
        illuminant: Spectrum of the perfect diffuser in that light, shape [band_count].
        wavelength_nm: Band centres [nm], shape [band_count].
    """
    weights = xyz_weights(wavelength_nm)
    return xyz_to_lab(np.asarray(signals) @ weights, np.asarray(illuminant) @ weights)


def display_colors(
    signals: ArrayLike, illuminant: ArrayLike, wavelength_nm: ArrayLike
) -> FloatArray:
    """Return sRGB colors of surfaces, as seen by an eye adapted to their light (CAT16).

    Args:
        signals: Spectra, shape [count, band_count].
        illuminant: Spectrum of the perfect diffuser in that light, shape [band_count].
        wavelength_nm: Band centres [nm], shape [band_count].

    Returns:
        Encoded colors from 0 to 1, shape [count, 3].
    """
    weights = xyz_weights(wavelength_nm)
    white = np.asarray(illuminant) @ weights
    xyz = np.asarray(signals) @ weights / white[1]
    matrix = xyz_to_rgb(_SPACE) @ cat16(white / white[1], white_xyz(_SPACE))
    return np.asarray(encode_srgb(np.clip(xyz @ matrix.T, 0.0, 1.0)), dtype=np.float64)


def line_colors(colors: FloatArray) -> FloatArray:
    """Return colors dark enough for thin lines on white, shape as given."""
    grey = colors @ np.array([0.2126, 0.7152, 0.0722])
    darker = np.minimum(1.0, _DARKEST_ON_WHITE / np.maximum(grey, 1e-6))
    return np.asarray(colors * darker[..., None], dtype=np.float64)
