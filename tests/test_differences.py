import numpy as np
import pytest

from usdskin.colorimetry import illuminant
from usdskin.differences import (
    delta_e_of_signals,
    goodness_of_fit,
    lab_of_signals,
    relative_rmse,
)
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

GRID = DEFAULT_WAVELENGTHS_NM


def surfaces(count=40):
    rng = np.random.default_rng(2)
    slopes = rng.normal(0.0, 0.3, (count, 1)) * np.linspace(-1.0, 1.0, GRID.size)
    return np.clip(rng.uniform(0.05, 0.8, (count, 1)) + slopes, 0.01, 1.0)


def test_fit_is_one_for_spectra_of_one_shape():
    spectra = surfaces()
    np.testing.assert_allclose(goodness_of_fit(3.0 * spectra, spectra), 1.0, atol=1e-14)


def test_fit_is_the_cosine_of_the_angle_between_spectra():
    angle = np.array([0.0, 0.1, 0.7, np.pi / 2])
    spectra = np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=-1)
    fit = goodness_of_fit(spectra, [1.0, 0.0, 0.0])
    np.testing.assert_allclose(fit, np.cos(angle), atol=1e-15)


def test_fit_with_black_is_zero():
    assert goodness_of_fit(np.zeros(5), np.ones(5)) == 0.0


def test_rmse_is_a_share_of_the_peak():
    reference = np.zeros((2, 4))
    spectra = np.array([[1.0, -1.0, 1.0, -1.0], [2.0, 0.0, 0.0, 0.0]])
    np.testing.assert_allclose(relative_rmse(spectra, reference, 4.0), [0.25, 0.25])


@pytest.mark.parametrize("lamp", ["A", "FL2", "FL11", "D55"])
def test_perfect_diffuser_is_white_in_its_own_light(lamp):
    light = 0.3 * illuminant(lamp, GRID)
    np.testing.assert_allclose(lab_of_signals(light, light, GRID), [100.0, 0.0, 0.0], atol=1e-10)


@pytest.mark.parametrize("observer", ["cie1931_2", "cie1964_10"])
@pytest.mark.parametrize("lamp", ["A", "FL2", "D55"])
def test_lab_is_that_of_colour_science(lamp, observer):
    colour = pytest.importorskip("colour")
    names = {
        "cie1931_2": "CIE 1931 2 Degree Standard Observer",
        "cie1964_10": "CIE 1964 10 Degree Standard Observer",
    }
    observer_functions = (
        colour.MSDS_CMFS[names[observer]].copy().align(colour.SpectralShape(400, 700, 5))
    )
    light = illuminant(lamp, GRID)
    reflectances = surfaces(6)
    lamp_colour = colour.SpectralDistribution(light, GRID)
    xyz = np.array(
        [
            colour.sd_to_XYZ(
                colour.SpectralDistribution(row, GRID),
                observer_functions,
                lamp_colour,
                method="Integration",
            )
            for row in (*reflectances, np.ones(GRID.size))
        ]
    )
    white = colour.XYZ_to_xy(xyz[-1])
    expected = colour.XYZ_to_Lab(xyz[:-1] / 100.0, white)
    found = lab_of_signals(reflectances * light, light, GRID, observer)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_unit_of_the_light_does_not_matter():
    light = illuminant("FL2", GRID)
    first, second = surfaces()[:20] * light, surfaces()[20:] * light
    expected = delta_e_of_signals(first, second, light, GRID)
    found = delta_e_of_signals(1e-4 * first, 1e-4 * second, 1e-4 * light, GRID)
    np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_error_of_scale_counts():
    # 3 % of scale at Y = 0.30 is a difference of 0.7, at 0.015 of 0.2 (lightness alone).
    light = illuminant("D55", GRID)
    found = delta_e_of_signals(
        np.outer([0.30 * 1.03, 0.015 * 1.03], light), np.outer([0.30, 0.015], light), light, GRID
    )
    np.testing.assert_allclose(found, [0.66, 0.18], atol=0.01)


def test_metamers_differ_in_spectrum_and_not_in_color():
    from usdskin.colorimetry import xyz_weights

    light = illuminant("D55", GRID)
    weights = xyz_weights(GRID)
    wave = np.sin(GRID / 9.0)
    black = wave - weights @ np.linalg.lstsq(weights, wave, rcond=None)[0]
    grey = 0.4 * light
    metamer = grey + 0.2 * grey.max() * black / np.abs(black).max()
    assert delta_e_of_signals(metamer, grey, light, GRID) < 1e-6
    assert goodness_of_fit(metamer, grey) < 0.999


def test_differences_of_all_pairs_by_broadcasting():
    light = illuminant("A", GRID)
    spectra = surfaces(5) * light
    table = delta_e_of_signals(spectra[:, None], spectra[None], light, GRID)
    assert table.shape == (5, 5)
    np.testing.assert_allclose(np.diag(table), 0.0, atol=1e-12)


def test_black_light_is_refused():
    with pytest.raises(ValueError, match="a light of X, Y, Z"):
        delta_e_of_signals(np.ones(3), np.ones(3), np.zeros(3), [450.0, 550.0, 650.0])
