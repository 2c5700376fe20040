"""From the A and B of a calibrated camera's channels to spectra of S and Ss.

Channel c of a reading over that of a perfect diffuser is ``sum t_c E r / sum t_c E`` of the
spectral reflectance r. Three channels do not make a spectrum: the reflectance comes from a prior
on skin, and Ss is the smoothest spectrum that the channels allow.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.estimate.recovery.responsivity import second_difference
from usdskin.estimate.skin.convention import CONVENTION, LARGEST_RATIO

FloatArray = NDArray[np.float64]

ReflectanceOf = Callable[[FloatArray, FloatArray], tuple[FloatArray, FloatArray]]
"""Channel values over those of a perfect diffuser, shape [c], and their covariance, shape [c, c],
to a reflectance spectrum and its standard deviation [1], shapes [n]."""

_SLOPE_WEIGHT = 1e-3
"""Of the slope's square beside the curvature's, in grid steps: features beyond about 30 steps are
held flat rather than straight, so that ends the camera hardly sees do not run away."""

_EXACT = 1e4


@dataclass(frozen=True, slots=True, eq=False)
class SkinSpectra:
    """What ``SkinMaterialAPI`` stores, as spectra, with standard deviations."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""

    alpha: float
    """1/(1 + mean of Ss weighted by ybar) [1]."""

    alpha_stddev: float
    """Of alpha [1]."""

    reflectance: FloatArray
    """S [1], shape [n]."""

    reflectance_stddev: FloatArray
    """Of S, the prior's included [1], shape [n]."""

    scattering: FloatArray
    """Ss [1], shape [n]."""

    scattering_stddev: FloatArray
    """Of Ss, as far as it comes from the readings' noise [1], shape [n]."""

    convention: str = CONVENTION
    """Token of ``fit:convention``."""


def spectra_of_channels(
    lambert: ArrayLike,
    wrapped: ArrayLike,
    covariance: ArrayLike,
    *,
    wavelength_nm: ArrayLike,
    responsivity: ArrayLike,
    illuminant: ArrayLike,
    reflectance_of: ReflectanceOf,
) -> SkinSpectra:
    """Return S and Ss whose channel values are A and B.

    The prior gives the spectrum alpha S of A; Ss is the smoothest non-negative spectrum with
    ``t^T E alpha S Ss = B``. Errors go through the first derivatives of both.

    Args:
        lambert: A per channel [1], shape [c].
        wrapped: B per channel [1], shape [c].
        covariance: Of (l, A, B), or of A and B, shape [1 + 2c or more] or [2c], squared.
        wavelength_nm: Band centres [nm], strictly ascending, shape [n].
        responsivity: t of the camera, band widths included, shape [n, c].
        illuminant: E of the light the readings were taken in, in any scale, shape [n].
        reflectance_of: The prior: channel values and covariance to a spectrum and its error.

    Raises:
        ValueError: Shapes differ, a channel sees nothing of the light, or A + B is 0 in one.
    """
    grid = np.asarray(wavelength_nm, dtype=np.float64)
    a, b = np.asarray(lambert, dtype=np.float64), np.asarray(wrapped, dtype=np.float64)
    rows, channels = channel_rows(responsivity, illuminant), a.size
    if b.shape != a.shape or rows.shape != (channels, grid.size):
        raise ValueError(f"A {a.shape}, B {b.shape} and responsivity {rows.T.shape} do not fit")
    if (a < 0.0).any() or (b < 0.0).any() or (a + b <= 0.0).any():
        raise ValueError("A and B must not be negative, nor both 0 in a channel")
    both = _of_a_and_b(np.asarray(covariance, dtype=np.float64), channels)
    a = np.maximum(a, b / LARGEST_RATIO)
    lit, lit_stddev = reflectance_of(a, both[:channels, :channels])
    by_values = _derivative(reflectance_of, a, both[:channels, :channels])
    seen = rows * lit
    seen = seen / seen.sum(axis=1, keepdims=True)
    scattering, gain = smoothest(grid, seen, b / a, LARGEST_RATIO)
    weights = xyz_weights(grid)[:, 1]
    weights = weights / weights.sum()
    bright = 1.0 + float(weights @ scattering)
    ratio = np.hstack([np.diag(-b / a**2), np.diag(1.0 / a)])
    ss_by_ab = gain @ ratio
    s_by_ab = np.outer(lit, weights @ ss_by_ab)
    s_by_ab[:, :channels] += bright * by_values
    alpha_by_ab = -(weights @ ss_by_ab) / bright**2
    # What the prior leaves open beyond the noise of its input.
    unseen = np.maximum(lit_stddev**2 - _variances(by_values, both[:channels, :channels]), 0.0)
    return SkinSpectra(
        wavelength_nm=grid,
        alpha=1.0 / bright,
        alpha_stddev=float(np.sqrt(_variances(alpha_by_ab[None], both)[0])),
        reflectance=lit * bright,
        reflectance_stddev=np.sqrt(_variances(s_by_ab, both) + bright**2 * unseen),
        scattering=scattering,
        scattering_stddev=np.sqrt(_variances(ss_by_ab, both)),
    )


def _variances(gain: FloatArray, covariance: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(np.einsum("ij,jk,ik->i", gain, covariance, gain), 0.0))


def _derivative(
    reflectance_of: ReflectanceOf, values: FloatArray, covariance: FloatArray
) -> FloatArray:
    """Return the derivative of the prior's spectrum by the channel values, shape [n, c]."""
    columns = []
    for channel, value in enumerate(values):
        step = np.zeros(values.size)
        step[channel] = 1e-4 * value
        above, _ = reflectance_of(values + step, covariance)
        below, _ = reflectance_of(values - step, covariance)
        columns.append((above - below) / (2.0 * step[channel]))
    return np.stack(columns, axis=-1)


def _of_a_and_b(covariance: FloatArray, channels: int) -> FloatArray:
    """Return the covariance of A and B alone; what is not known at all cannot be propagated."""
    if covariance.shape[0] != 2 * channels:
        covariance = covariance[1 : 1 + 2 * channels, 1 : 1 + 2 * channels]
    if covariance.shape != (2 * channels, 2 * channels):
        raise ValueError(f"the covariance has no rows for {channels} A and B")
    if not np.isfinite(covariance).all():
        raise ValueError("the readings do not tell A and B of every channel")
    return covariance


def channel_rows(responsivity: ArrayLike, illuminant: ArrayLike) -> FloatArray:
    """Return K with ``K @ r`` the channel values of a reflectance r over a perfect diffuser's.

    Args:
        responsivity: t, band widths included, shape [n, c].
        illuminant: E in any scale, shape [n].

    Returns:
        Rows that sum to 1, shape [c, n].

    Raises:
        ValueError: A channel sees nothing of the light.
    """
    seen = np.asarray(responsivity, dtype=np.float64).T * np.asarray(illuminant, dtype=np.float64)
    sums = seen.sum(axis=1, keepdims=True)
    if not (sums > 0.0).all():
        raise ValueError("a channel of the camera sees nothing of the light")
    return np.asarray(seen / sums)


def smoothest(
    wavelength_nm: FloatArray, rows: FloatArray, values: FloatArray, largest: float = np.inf
) -> tuple[FloatArray, FloatArray]:
    """Return the smoothest non-negative spectrum with given channel values, and its gain.

    The least sum of squared second differences (and, a little, of first ones) under ``rows @ x =
    values`` (C. van Trigt, "Smoothest reflectance functions", JOSA A 7(10), 1990); where that
    leaves 0..largest, the least under these bounds as well. Equal values give a flat spectrum.

    Args:
        wavelength_nm: Band centres [nm], shape [n].
        rows: What the channels see, shape [c, n].
        values: Channel values, shape [c].
        largest: Upper bound [1].

    Returns:
        The spectrum, shape [n], and its derivative by the values (without bounds), shape [n, c].
    """
    count, channels = rows.shape[1], rows.shape[0]
    curve = second_difference(wavelength_nm)
    slope = np.sqrt(_SLOPE_WEIGHT) * np.diff(np.eye(count), axis=0)
    rough = np.concatenate([curve, slope])
    system = np.zeros((count + channels, count + channels))
    system[:count, :count] = rough.T @ rough
    system[:count, count:] = rows.T
    system[count:, :count] = rows
    right = np.concatenate([np.zeros((count, channels)), np.eye(channels)])
    gain = np.linalg.solve(system, right)[:count]
    spectrum = gain @ values
    if spectrum.min() >= 0.0 and spectrum.max() <= largest:
        return spectrum, gain
    from scipy.optimize import lsq_linear

    wanted = np.concatenate([_EXACT * values, np.zeros(len(rough))])
    design = np.concatenate([_EXACT * rows, rough])
    bounded = lsq_linear(design, wanted, bounds=(0.0, max(largest, 1e-9)), method="bvls")
    return np.asarray(bounded.x), gain
