"""From the A and B of a camera's channels to spectra of S and Ss."""

from __future__ import annotations

import numpy as np
import pytest

from usdskin.colorimetry import xyz_weights
from usdskin.estimate.skin.spectra_of_channels import (
    channel_rows,
    smoothest,
    spectra_of_channels,
)
from usdskin.illuminants import illuminant
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

GRID = DEFAULT_WAVELENGTHS_NM
CAMERA = np.exp(-0.5 * ((GRID[:, None] - np.array([600.0, 540.0, 460.0])) / 35.0) ** 2)
SKIN = 0.2 + 0.35 / (1.0 + np.exp(-(GRID - 590.0) / 20.0))
RISING = 0.3 + 0.5 * (GRID - 400.0) / 300.0
LAMPS = ("D65", "A", "FL2")


def shapes():
    """Return spectra like skin's: three of them span what the prior of these tests knows."""
    return np.stack([SKIN, np.ones_like(GRID), GRID / 500.0])


def prior(rows):
    """Return the spectrum within ``shapes`` that has the channel values."""
    matrix = shapes().T @ np.linalg.inv(rows @ shapes().T)

    def reflectance_of(values, covariance):
        variance = np.einsum("ij,jk,ik->i", matrix, covariance, matrix)
        return matrix @ values, np.sqrt(np.maximum(variance, 0.0))

    return reflectance_of


def measured(lamp, scattering, alpha=0.6):
    """Return rows, A and B per channel and a covariance as goniometer fits have it."""
    rows = channel_rows(CAMERA, illuminant(lamp, GRID))
    a, b = rows @ (alpha * SKIN), rows @ (alpha * SKIN * scattering)
    errors = np.concatenate([0.014 * a, 0.02 * b])
    covariance = np.diag(errors**2)
    for channel in range(3):
        both = -0.95 * errors[channel] * errors[3 + channel]
        covariance[channel, 3 + channel] = covariance[3 + channel, channel] = both
    return rows, a, b, covariance


def recovered(lamp, a, b, covariance, rows):
    return spectra_of_channels(
        a,
        b,
        covariance,
        wavelength_nm=GRID,
        responsivity=CAMERA,
        illuminant=illuminant(lamp, GRID),
        reflectance_of=prior(rows),
    )


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("scattering", [np.full(61, 0.6), RISING], ids=["flat", "rising"])
def test_channels_see_a_and_b_in_the_spectra(lamp, scattering):
    rows, a, b, covariance = measured(lamp, scattering)
    found = recovered(lamp, a, b, covariance, rows)
    lit = found.alpha * found.reflectance
    np.testing.assert_allclose(rows @ lit, a, rtol=1e-6)
    np.testing.assert_allclose(rows @ (lit * found.scattering), b, rtol=1e-6)


def test_spectra_in_the_priors_span_come_back():
    rows, a, b, covariance = measured("D65", np.full(61, 0.6))
    found = recovered("D65", a, b, covariance, rows)
    np.testing.assert_allclose(found.scattering, 0.6, rtol=1e-6)
    np.testing.assert_allclose(found.reflectance, 0.6 * 1.6 * SKIN, rtol=1e-6)


def test_alpha_is_one_over_one_and_the_luminous_mean():
    rows, a, b, covariance = measured("D65", RISING)
    found = recovered("D65", a, b, covariance, rows)
    luminous = xyz_weights(GRID)[:, 1]
    mean = luminous @ found.scattering / luminous.sum()
    assert found.alpha == pytest.approx(1.0 / (1.0 + mean))
    assert np.abs(found.scattering - RISING)[6:50].max() < 0.05


def test_stated_errors_are_those_of_drawn_readings():
    rows, a, b, covariance = measured("A", RISING)
    stated = recovered("A", a, b, covariance, rows)
    drawn = np.random.default_rng(0).multivariate_normal(np.concatenate([a, b]), covariance, 600)
    spectra = [recovered("A", row[:3], row[3:], covariance, rows) for row in drawn]
    for name in ("reflectance", "scattering"):
        spread = np.std([getattr(each, name) for each in spectra], axis=0)
        expected = getattr(stated, f"{name}_stddev")
        np.testing.assert_allclose(spread, expected, rtol=0.15)
    spread = np.std([each.alpha for each in spectra])
    assert spread == pytest.approx(stated.alpha_stddev, rel=0.15)


def test_covariance_of_a_fit_may_have_wrap_in_front():
    rows, a, b, covariance = measured("D65", RISING)
    whole = np.zeros((9, 9))
    whole[1:7, 1:7] = covariance
    first, second = (recovered("D65", a, b, each, rows) for each in (covariance, whole))
    np.testing.assert_array_equal(first.scattering_stddev, second.scattering_stddev)


def test_smoothest_spectrum_is_never_negative():
    rows = channel_rows(CAMERA, np.ones(61))
    spectrum, _ = smoothest(GRID, rows, np.array([0.6, 0.1, 0.05]), 1.0)
    assert spectrum.min() >= 0.0 and spectrum.max() <= 1.0
    np.testing.assert_allclose(rows @ spectrum, [0.6, 0.1, 0.05], atol=2e-4)


def test_channel_that_sees_nothing_is_refused():
    blind = CAMERA * [1.0, 0.0, 1.0]
    with pytest.raises(ValueError, match="sees nothing of the light"):
        channel_rows(blind, np.ones(61))
