"""How far spectra lie apart: in shape, in size and in colour.

A goodness of fit hides colour errors and a colour difference hides spectra (two metamers differ by
none), so reports print both.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import (
    DEFAULT_OBSERVER,
    Observer,
    delta_e_2000,
    xyz_to_lab,
    xyz_weights,
)

FloatArray = NDArray[np.float64]


def goodness_of_fit(spectrum: ArrayLike, reference: ArrayLike) -> FloatArray:
    """Return the goodness-of-fit coefficient of spectra.

    ``|sum a b| / sqrt(sum a^2 sum b^2)`` (J. Romero, A. Garcia-Beltran and J. Hernandez-Andres,
    "Linear bases for representation of natural and artificial illuminants", JOSA A 14(5),
    1997): 1 where the shapes agree, whatever the sizes.

    Args:
        spectrum: Spectra, wavelength last, shape [..., band_count].
        reference: Spectra compared with, broadcastable to the same shape.

    Returns:
        Coefficients [1] in 0..1, 0 where either spectrum is black, shape [...].
    """
    a = np.asarray(spectrum, dtype=np.float64)
    b = np.asarray(reference, dtype=np.float64)
    size = np.sqrt((a**2).sum(axis=-1) * (b**2).sum(axis=-1))
    product = np.abs((a * b).sum(axis=-1))
    return np.asarray(np.minimum(product / np.where(size > 0.0, size, np.inf), 1.0))


def relative_rmse(spectrum: ArrayLike, reference: ArrayLike, peak: ArrayLike) -> FloatArray:
    """Return the root of the mean squared error over the bands, as a share of a peak.

    Args:
        spectrum: Spectra, wavelength last, shape [..., band_count].
        reference: Spectra compared with, broadcastable to the same shape.
        peak: What errors are a share of, such as the largest value of the light, in the unit of
            the spectra; broadcastable to shape [...].

    Returns:
        Errors [1], shape [...].
    """
    error = np.asarray(spectrum, dtype=np.float64) - np.asarray(reference, dtype=np.float64)
    return np.asarray(np.sqrt((error**2).mean(axis=-1)) / np.asarray(peak, dtype=np.float64))


def lab_of_signals(
    signals: ArrayLike,
    illuminant: ArrayLike,
    wavelength_nm: ArrayLike,
    observer: Observer = DEFAULT_OBSERVER,
) -> FloatArray:
    """Return L*a*b* of colour signals, seen against the perfect diffuser in the same light.

    Tristimulus values are divided by Y_n of the diffuser, whose own tristimulus values are the
    white: the adaptation is that of L*a*b* itself, to the light's chromaticity.

    Args:
        signals: Radiance of surfaces, wavelength last, shape [..., band_count].
        illuminant: Radiance of the perfect diffuser in the same unit, shape [band_count].
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        observer: Whose colour-matching functions.

    Returns:
        L*, a*, b*, shape [..., 3].

    Raises:
        ValueError: The light has no colour to adapt to: one of its tristimulus values is not
            above zero.
    """
    weights = xyz_weights(wavelength_nm, observer)
    white = np.asarray(illuminant, dtype=np.float64) @ weights
    if not (np.isfinite(white).all() and (white > 0.0).all()):
        raise ValueError(f"a light of X, Y, Z = {white[0]:g}, {white[1]:g}, {white[2]:g} is none")
    return xyz_to_lab(np.asarray(signals, dtype=np.float64) @ weights, white)


def delta_e_of_signals(
    signals: ArrayLike,
    reference: ArrayLike,
    illuminant: ArrayLike,
    wavelength_nm: ArrayLike,
    observer: Observer = DEFAULT_OBSERVER,
) -> FloatArray:
    """Return the CIEDE2000 differences of colour signals.

    Both are seen as ``lab_of_signals`` says: divided by Y_n of the perfect diffuser in the light,
    and against its white. A difference of scale counts.

    Args:
        signals: Radiance of surfaces, wavelength last, shape [..., band_count].
        reference: Radiance compared with, broadcastable to the same shape.
        illuminant: Radiance of the perfect diffuser in the same unit, shape [band_count].
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        observer: Whose colour-matching functions.

    Returns:
        Differences [1], shape [...].

    Raises:
        ValueError: The light has no colour to adapt to.
    """
    return delta_e_2000(
        lab_of_signals(signals, illuminant, wavelength_nm, observer),
        lab_of_signals(reference, illuminant, wavelength_nm, observer),
    )
