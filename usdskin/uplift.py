"""Lift RGB lights and reflectances to spectra, linearly and exactly in XYZ.

The basis M of Mallett and Yuksel ("Spectral Primary Decomposition for Rendering with sRGB
Reflectance", EGSR 2019) gives three smooth reflectances that sum to 1. A 3 x 3 matrix T in front
of it makes the tristimulus values come out right under any lamp and observer, and from any RGB
space; the sum of the lifted primaries stays the lamp itself. Saturated colours dip below zero
somewhere: that is the price of linearity.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import (
    DEFAULT_OBSERVER,
    Observer,
    cat16,
    illuminant,
    rgb_to_xyz,
    white_xyz,
    xyz_weights,
)
from usdskin.errors import UsdSkinError
from usdskin.illuminants import table
from usdskin.spectrum import resample

FloatArray = NDArray[np.float64]

_CHUNK_ROWS = 16384


def light_basis(
    illuminant_spd: ArrayLike,
    wavelength_nm: ArrayLike,
    color_space: str = "lin_rec709_scene",
    observer: Observer = DEFAULT_OBSERVER,
) -> FloatArray:
    """Return the spectra of an RGB light's primaries under an assigned lamp.

    ``B = diag(E) M T`` with ``T = (k CMF^T diag(E) M)^-1 CAT A_rgb``, where A_rgb takes RGB to
    XYZ, CAT is CAT16 from the space's white to the lamp's, and k makes the lamp's Y one. So the
    light has the adapted XYZ of its RGB value, and RGB (1, 1, 1) is the lamp E with Y = 1.

    Args:
        illuminant_spd: E, the lamp's power in any scale, shape [band_count].
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        color_space: USD's name of the linear RGB space.
        observer: Whose colour-matching functions the XYZ is exact for.

    Returns:
        B, such that ``radiance = rgb @ B`` in relative units (``xyz_weights`` with
        ``absolute=False``), shape [3, band_count].

    Raises:
        UsdSkinError: The lamp is black, or too narrow in wavelength to hold three colours.
    """
    reflectances, transform, lamp = _lifted(illuminant_spd, wavelength_nm, color_space, observer)
    basis: FloatArray = (reflectances @ transform).T * lamp
    return basis


def reflectance_basis(
    wavelength_nm: ArrayLike,
    color_space: str = "lin_rec709_scene",
    observer: Observer = DEFAULT_OBSERVER,
) -> FloatArray:
    """Return the reflectances of an RGB space's primaries.

    Under D65, the white of every space that USD names, a surface has the XYZ of its RGB value;
    RGB (1, 1, 1) reflects 1 at every wavelength.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        color_space: USD's name of the linear RGB space.
        observer: Whose colour-matching functions the XYZ is exact for.

    Returns:
        R, such that ``reflectance = rgb @ R`` [1], shape [3, band_count].
    """
    d65 = illuminant("D65", wavelength_nm)
    reflectances, transform, _ = _lifted(d65, wavelength_nm, color_space, observer)
    basis: FloatArray = (reflectances @ transform).T
    return basis


def _lifted(
    illuminant_spd: ArrayLike, wavelength_nm: ArrayLike, color_space: str, observer: Observer
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return M [band_count, 3], T [3, 3] and the lamp at Y = 1 [band_count]."""
    lamp = np.asarray(illuminant_spd, dtype=np.float64)
    weights = xyz_weights(wavelength_nm, observer)
    luminance = float(lamp @ weights[:, 1])
    if not (np.isfinite(lamp).all() and luminance > 0.0):
        raise UsdSkinError("the lamp assigned to an RGB light has no luminance; choose another")
    lamp = lamp / luminance
    reflectances = np.stack(
        [
            resample(nm, value, wavelength_nm, outside="hold")
            for nm, value in table("mallett2019").values()
        ],
        axis=-1,
    )
    under_lamp = weights.T @ (lamp[:, None] * reflectances)
    if np.linalg.cond(under_lamp) > 1e8:
        raise UsdSkinError(
            "the lamp assigned to an RGB light covers too few wavelengths to show three "
            "independent colors; choose a broader one"
        )
    adapted = cat16(white_xyz(color_space), weights.T @ lamp) @ rgb_to_xyz(color_space)
    transform = np.asarray(np.linalg.solve(under_lamp, adapted), dtype=np.float64)
    return reflectances, transform, lamp


def deepest_dip(coefficients: ArrayLike, basis: ArrayLike) -> tuple[float, int, int]:
    """Return how far below zero the spectra of non-negative coefficients reach.

    Args:
        coefficients: Colours or other weights, shape [count, rank]; rows that are not finite or
            hold a negative number are passed over.
        basis: Their spectra, shape [rank, band_count].

    Returns:
        The lowest value relative to its own spectrum's peak (0 or below), the row it is in (-1
        where there is none), and how many spectra fall below -1e-6 of their peak.
    """
    spectra = np.asarray(basis, dtype=np.float32)
    rows = np.asarray(coefficients, dtype=np.float32)
    candidates = _may_dip(rows, spectra)
    depth, worst, count = 0.0, -1, 0
    for start in range(0, candidates.size, _CHUNK_ROWS):
        chosen = candidates[start : start + _CHUNK_ROWS]
        values = rows[chosen] @ spectra
        peak = values.max(axis=1)
        ratio = values.min(axis=1) / np.where(peak > 0.0, peak, np.inf)
        count += int(np.count_nonzero(ratio < -1e-6))
        lowest = int(np.argmin(ratio))
        if ratio[lowest] < depth:
            depth, worst = float(ratio[lowest]), int(chosen[lowest])
    return depth, worst, count


def _may_dip(rows: NDArray[np.float32], spectra: NDArray[np.float32]) -> NDArray[np.intp]:
    """Return the rows whose spectra could be negative somewhere.

    With m the smallest and m + d the largest of a row, its spectrum is at least
    ``m sum_k B_k - d sum_k max(-B_k, 0)``: grey rows need no look.
    """
    total = spectra.sum(axis=0)
    below = np.maximum(-spectra, 0.0).sum(axis=0)
    lit = total > 0.0
    limit = float((below[lit] / total[lit]).max(initial=0.0)) if np.all(below[~lit] == 0) else 1e30
    smallest, largest = rows[:, 0].copy(), rows[:, 0].copy()
    for column in rows.T[1:]:
        np.minimum(smallest, column, out=smallest)
        np.maximum(largest, column, out=largest)
    with np.errstate(invalid="ignore", over="ignore"):
        valid = (smallest >= 0.0) & np.isfinite(largest) & (largest > 0.0)
        return np.flatnonzero(valid & (smallest < limit * (largest - smallest)))
