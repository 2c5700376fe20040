import numpy as np
import pytest

from usdskin.spectrum import (
    DEFAULT_WAVELENGTHS_NM,
    SpectralQuantity,
    Spectrum,
    band_edges,
    band_widths,
    resample,
)

trapezoid = getattr(np, "trapezoid", None) or np.trapz  # NumPy 2 renamed it
IRREGULAR = np.array([395.0, 402.0, 410.5, 430.0, 431.0, 500.0, 620.0, 700.0])


def test_default_grid_is_the_papers_61_bands():
    assert DEFAULT_WAVELENGTHS_NM.shape == (61,)
    assert DEFAULT_WAVELENGTHS_NM[[0, -1]].tolist() == [400.0, 700.0]


@pytest.mark.parametrize("grid", [DEFAULT_WAVELENGTHS_NM, IRREGULAR])
def test_bands_tile_their_range_without_gaps(grid):
    edges = band_edges(grid)
    assert np.all(edges[:-1] < grid) and np.all(grid < edges[1:])
    assert band_widths(grid).sum() == pytest.approx(edges[-1] - edges[0])


def test_uniform_bands_are_centered_and_one_step_wide():
    np.testing.assert_allclose(band_widths(DEFAULT_WAVELENGTHS_NM), 5.0)
    assert band_edges(DEFAULT_WAVELENGTHS_NM)[[0, -1]].tolist() == [397.5, 702.5]


def test_same_grid_returns_the_samples_themselves():
    value = np.random.default_rng(0).random(61)
    out = resample(DEFAULT_WAVELENGTHS_NM, value, DEFAULT_WAVELENGTHS_NM)
    np.testing.assert_array_equal(out, value)


def test_shared_stretch_of_a_longer_table_is_cut_out():
    table_nm = np.arange(380.0, 781.0, 5.0)
    value = np.random.default_rng(1).random(81)
    np.testing.assert_array_equal(resample(table_nm, value, DEFAULT_WAVELENGTHS_NM), value[4:65])


def test_longer_target_grid_is_zero_or_held_outside():
    value = np.random.default_rng(2).random(61) + 1.0
    wide = np.arange(390.0, 716.0, 5.0)
    zero = resample(DEFAULT_WAVELENGTHS_NM, value, wide)
    hold = resample(DEFAULT_WAVELENGTHS_NM, value, wide, outside="hold")
    assert zero[:2].tolist() == [0.0, 0.0] and zero[-3:].tolist() == [0.0, 0.0, 0.0]
    np.testing.assert_array_equal(hold[:3], value[0])
    np.testing.assert_array_equal(hold[-4:], value[-1])


@pytest.mark.parametrize("interpolation", ["linear", "held"])
@pytest.mark.parametrize("target", [DEFAULT_WAVELENGTHS_NM, IRREGULAR, np.arange(350, 800, 17.0)])
def test_constant_stays_constant_when_held_outside(interpolation, target):
    out = resample([450.0, 460.0, 600.0], [2.5] * 3, target, interpolation, "hold")
    np.testing.assert_allclose(out, 2.5, rtol=1e-13)


def test_straight_line_averages_to_its_value_at_the_center():
    out = resample([300.0, 333.0, 900.0], [3.0, 3.33, 9.0], DEFAULT_WAVELENGTHS_NM)
    np.testing.assert_allclose(out, DEFAULT_WAVELENGTHS_NM / 100.0, rtol=1e-13)


def test_coarser_bands_conserve_energy():
    fine = np.arange(380.0, 781.0, 1.0)
    value = np.random.default_rng(3).random(fine.size)
    coarse = np.arange(375.0, 786.0, 10.0)
    energy = resample(fine, value, coarse) @ band_widths(coarse)
    # The outermost samples reach half their own step outwards.
    expected = trapezoid(value, fine) + 0.5 * (value[0] + value[-1])
    assert energy == pytest.approx(expected, rel=1e-12)


def test_irregular_bands_conserve_energy():
    fine = np.arange(395.0, 700.0, 0.5)
    value = np.sin(fine / 7.0) + 1.1
    inside = (fine[0] - 0.25, fine[-1] + 0.25)
    grid = np.concatenate(([390.0], IRREGULAR, [760.0]))
    assert band_edges(grid)[0] < inside[0] and band_edges(grid)[-1] > inside[1]
    energy = resample(fine, value, grid) @ band_widths(grid)
    expected = trapezoid(value, fine) + 0.25 * (value[0] + value[-1])
    assert energy == pytest.approx(expected, rel=1e-12)


def test_narrow_line_between_band_centers_is_not_lost():
    nm = np.arange(540.0, 551.0, 1.0)
    line = np.where(nm == 546.0, 1.0, 0.0)
    out = resample(nm, line, [530.0, 540.0, 550.0, 560.0])
    np.testing.assert_allclose(out * 10.0, [0.0, 0.0, 1.0, 0.0], atol=1e-15)


def test_box_from_two_samples_fills_the_bands_centered_on_its_ends():
    out = resample([400.0, 700.0], [1.0, 1.0], np.arange(390.0, 711.0, 5.0))
    expected = np.where((np.arange(390.0, 711.0, 5.0) >= 400) & (out > 0), 1.0, 0.0)
    np.testing.assert_allclose(out, expected)
    assert out.sum() == pytest.approx(61)


def test_held_samples_make_a_staircase():
    out = resample([400.0, 410.0], [1.0, 3.0], np.arange(402.5, 420.0, 5.0), "held")
    np.testing.assert_allclose(out, [1.0, 1.0, 3.0, 3.0])


def test_one_sample_can_be_held_for_ever():
    np.testing.assert_allclose(resample([550.0], [0.4], [400.0, 500.0], outside="hold"), 0.4)


def test_stacked_spectra_resample_like_each_one():
    nm = np.arange(380.0, 781.0, 4.0)
    value = np.random.default_rng(4).random((2, 3, nm.size))
    out = resample(nm, value, DEFAULT_WAVELENGTHS_NM)
    np.testing.assert_allclose(out[1, 2], resample(nm, value[1, 2], DEFAULT_WAVELENGTHS_NM))


def test_material_goes_on_outside_its_samples_and_emission_does_not():
    nm, value = [500.0, 520.0], [0.3, 0.3]
    reflectance = Spectrum(SpectralQuantity.REFLECTANCE, nm, value)
    radiance = Spectrum(SpectralQuantity.RADIANCE, nm, value)
    np.testing.assert_allclose(reflectance.resample([400.0, 450.0]), 0.3)
    np.testing.assert_allclose(radiance.resample([400.0, 450.0]), 0.0)


def test_spectrum_keeps_its_own_read_only_copy():
    value = np.array([0.1, 0.2])
    spectrum = Spectrum(SpectralQuantity.REFLECTANCE, [400.0, 500.0], value)
    value[0] = 9.0
    assert spectrum.value[0] == 0.1
    with pytest.raises(ValueError):
        spectrum.value[0] = 1.0


def test_quantity_knows_its_unit_and_token():
    assert SpectralQuantity("radiance").unit == "W m^-2 sr^-1 nm^-1"
    assert SpectralQuantity("scattering").unit == "1"
    assert len(SpectralQuantity) == 8


@pytest.mark.parametrize(
    ("nm", "value", "message"),
    [
        ([400.0, 400.0], [1.0, 1.0], "ascend"),
        ([500.0, 400.0], [1.0, 1.0], "400 nm follows 500 nm"),
        ([400.0, np.nan], [1.0, 1.0], "finite"),
        ([400.0, 500.0], [1.0], "2 wavelengths"),
        ([400.0, 500.0], [1.0, np.inf], "finite"),
        ([], [], "list"),
        ([-1.0, 5.0], [1.0, 1.0], "positive"),
    ],
)
def test_unusable_samples_are_refused(nm, value, message):
    with pytest.raises(ValueError, match=message):
        Spectrum(SpectralQuantity.RELATIVE, nm, value)


def test_grid_of_one_band_is_refused_for_want_of_a_width():
    with pytest.raises(ValueError, match="no band width"):
        band_widths([550.0])
