"""Domes with spectra of their own, and what is done about pixels that are no light."""

import numpy as np
import pytest
from light_stages import (
    RNG,
    WEIGHTS,
    adapted,
    codes,
    dome,
    new_stage,
    only_dome,
    radiance,
    read,
    rgb_map,
    spectral,
    write_exr,
    write_rgb,
    xyz,
)
from pxr import Gf, Sdf, Usd, Vt

from usdskin.colorimetry import daylight, planck_radiance
from usdskin.errors import ImageError, LayerError
from usdskin.prims import write_spectrum
from usdskin.render.lights import read_lights
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as NM
from usdskin.spectrum import SpectralQuantity, Spectrum

# --- Bad pixels -----------------------------------------------------------------------------------


def bad_map():
    pixels = rgb_map(16, 32) + 0.1
    pixels[3, 7, 0] = -2.5
    pixels[9, 1, 2] = -0.5
    pixels[4, 6, 1] = np.nan
    pixels[5, 5, 1] = np.inf
    return pixels


def test_bad_pixels_are_counted_located_and_refused(tmp_path):
    stage = new_stage()
    file = write_rgb(tmp_path / "m.exr", bad_map())
    dome(stage, file)
    with pytest.raises(ImageError) as refusal:
        read(stage)
    text = str(refusal.value)
    assert "\n" not in text and file in text and "</Dome>" in text and "clamp" in text
    assert "4 of 512 pixels" in text
    assert "2 negative (lowest -2.5 at x 7, y 3)" in text
    assert "1 NaN (first at x 6, y 4)" in text
    assert "1 infinite (first at x 5, y 5)" in text


def test_clamped_pixels_are_zero_or_the_brightest_and_the_rest_untouched(tmp_path):
    pixels = bad_map()
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "m.exr", pixels))
    notes = []
    out = only_dome(stage, notes, bad_pixels="clamp").coefficients
    expected = np.where(np.isnan(pixels), 0.0, pixels)
    expected[5, 5, 1] = expected[np.isfinite(expected)].max()
    np.testing.assert_array_equal(out, np.maximum(expected, 0.0).astype(np.float32))
    assert "bad-pixels-clamped" in codes(notes)


def test_all_black_map_is_dark_and_legal(tmp_path):
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "m.exr", np.zeros((4, 8, 3), np.float32)))
    assert not only_dome(stage).coefficients.any()


# --- Spectra --------------------------------------------------------------------------------------


def test_tabulated_light_is_taken_as_authored():
    value = RNG.random(61)
    stage = new_stage()
    light = dome(stage)
    light.CreateIntensityAttr(2.0)
    light.CreateColorAttr((0.1, 0.9, 0.3))  # the rendition for others
    prim = spectral(light, "tabulated", units="absolute", scale=3.0)
    write_spectrum(prim, "emission", Spectrum(SpectralQuantity.RADIANCE, NM, value))
    out = only_dome(stage)
    assert out.absolute and out.basis.shape == (1, 61)
    np.testing.assert_allclose(radiance(out), np.broadcast_to(6.0 * value, (2, 4, 61)), rtol=1e-6)


def test_absolute_black_body_has_plancks_radiance():
    stage = new_stage()
    light = dome(stage)
    light.CreateColorTemperatureAttr(2856.0)
    spectral(light, "blackbody", units="absolute")
    np.testing.assert_allclose(radiance(only_dome(stage))[0, 0], planck_radiance(2856.0, NM))


@pytest.mark.parametrize(
    ("source", "shape"),
    [("blackbody", planck_radiance(5600.0, NM)), ("illuminantD", daylight(5600.0, NM))],
)
def test_relative_lamp_has_its_shape_and_luminance_one(source, shape):
    stage = new_stage()
    light = dome(stage)
    light.CreateColorTemperatureAttr(5600.0)
    spectral(light, source)
    spectrum = radiance(only_dome(stage))[0, 0]
    assert (spectrum @ WEIGHTS)[1] == pytest.approx(1.0)
    np.testing.assert_allclose(spectrum / spectrum.max(), shape / shape.max(), rtol=1e-9)


def test_absolute_daylight_has_its_intensity_in_candela_per_square_metre():
    stage = new_stage()
    light = dome(stage)
    light.CreateIntensityAttr(100.0)
    spectral(light, "illuminantD", units="absolute")
    np.testing.assert_allclose(xyz(only_dome(stage))[..., 1], 100.0, rtol=1e-6)


def basis_dome(stage, file, basis, nm=NM, **inputs):
    return spectral(
        dome(stage),
        "basis",
        coefficients_file=Sdf.AssetPath(file),
        basis=Vt.DoubleArray.FromNumpy(np.ascontiguousarray(basis, dtype=np.float64).ravel()),
        basis_wavelengths=Vt.DoubleArray.FromNumpy(np.float64(nm)),
        **inputs,
    )


def write_coefficients(path, coefficients):
    rank = coefficients.shape[-1]
    # Channel names sort as text in a file: c10 before c2.
    return write_exr(path, {f"c{k}": coefficients[..., k] for k in range(rank)})


@pytest.mark.parametrize("rank", [1, 3, 12])
def test_basis_light_is_coefficients_times_basis_in_numeric_order(tmp_path, rank):
    coefficients = RNG.random((4, 8, rank)).astype(np.float32)
    basis = RNG.random((rank, 61))
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis, units="absolute")
    out = only_dome(stage)
    assert out.absolute
    np.testing.assert_array_equal(out.coefficients, coefficients)
    np.testing.assert_array_equal(out.basis, basis)


def test_basis_is_band_averaged_onto_the_grid(tmp_path):
    fine = np.arange(390.0, 711.0, 1.0)
    basis = RNG.random((2, fine.size))
    stage = new_stage()
    file = write_coefficients(tmp_path / "c.exr", RNG.random((4, 8, 2)).astype(np.float32))
    basis_dome(stage, file, basis, fine)
    inside = np.abs(fine - 550.0) <= 2.0
    edges = 0.125 * basis[:, np.abs(fine - 550.0) == 3.0].sum(1)  # a quarter of half a step
    edges += 0.375 * basis[:, np.abs(fine - 550.0) == 2.0].sum(1)
    middle = basis[:, inside].sum(1) - 0.5 * basis[:, np.abs(fine - 550.0) == 2.0].sum(1)
    np.testing.assert_allclose(only_dome(stage).basis[:, 30], (middle + edges) / 5.0, rtol=1e-12)


def test_negative_coefficients_of_a_positive_light_are_fine(tmp_path):
    coefficients = np.stack([np.ones((4, 8)), RNG.uniform(-0.4, 0.4, (4, 8))], axis=-1).astype(
        np.float32
    )
    basis = np.stack([np.ones(61), np.linspace(-1.0, 1.0, 61)])
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis)
    np.testing.assert_array_equal(only_dome(stage).coefficients, coefficients)


def test_spectra_that_dip_below_zero_are_noted_and_used_as_they_are(tmp_path):
    coefficients = np.ones((4, 8, 2), np.float32)
    coefficients[1, 2] = [1.0, -2.0]
    basis = np.stack([np.ones(61), np.where(np.arange(61) == 30, 1.0, 0.0)])
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis)
    notes = []
    np.testing.assert_array_equal(only_dome(stage, notes).coefficients, coefficients)
    assert notes[0].code == "spectra-dip"
    assert "1 of 32 pixels" in notes[0].message and "x 2, y 1" in notes[0].message
    clamped = only_dome(stage, bad_pixels="clamp")
    assert radiance(clamped)[1, 2, 30] == pytest.approx(0.0, abs=1e-6)


UNEVEN = np.concatenate([np.arange(400.0, 500.0, 2.0), np.arange(500.0, 701.0, 10.0)])


@pytest.mark.parametrize("grid", [NM, UNEVEN, np.arange(560.0, 701.0, 10.0)])
@pytest.mark.parametrize("own", [NM, UNEVEN])
def test_energy_is_that_of_all_wavelengths_of_a_light_whatever_the_bands(tmp_path, grid, own):
    """0.5 below zero over a third of the wavelengths, 1 above over the rest; and upside down."""
    shape = np.where(own < 500.0, -0.5, 1.0)
    coefficients = np.ones((4, 8, 1), np.float32)
    stage = new_stage()
    file = write_coefficients(tmp_path / "c.exr", coefficients)
    prim = basis_dome(stage, file, shape[None], own)
    notes = []
    found = read_lights(stage, Usd.TimeCode.Default(), grid, notes=notes)
    np.testing.assert_array_equal(found.domes[0].coefficients, coefficients)
    if grid[0] == 400.0:
        assert [note.code for note in notes] == ["spectra-dip"]
        told = float(notes[0].message.partition("% of the energy")[0].rpartition(" ")[2])
        assert told / 100.0 == pytest.approx(0.5 * 100.0 / 200.0, rel=0.1)
    prim.GetAttribute("inputs:spectral:basis").Set(Vt.DoubleArray((-shape).tolist()))
    with pytest.raises(ImageError, match="32 of 32 pixels are no light: 32 negative"):
        read_lights(stage, Usd.TimeCode.Default(), grid)


def negative_basis_case(tmp_path):
    coefficients = RNG.random((8, 16, 3)).astype(np.float32)
    coefficients[5, 3] = [0.5, -2.0, 0.1]
    coefficients[2, 9] = [0.2, 0.1, -0.8]
    basis = RNG.random((3, 61)) + 0.05
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis)
    return stage, coefficients, basis


def test_negative_reconstructed_radiance_is_refused_with_place_and_size(tmp_path):
    stage, coefficients, basis = negative_basis_case(tmp_path)
    lowest = (coefficients[5, 3].astype(np.float64) @ basis).min()
    with pytest.raises(ImageError, match=rf"2 negative .lowest {lowest:.4g} at x 3, y 5"):
        read(stage)


def test_clamped_basis_light_is_exactly_cut_off_at_zero(tmp_path):
    stage, coefficients, basis = negative_basis_case(tmp_path)
    notes = []
    out = only_dome(stage, notes, bad_pixels="clamp")
    exact = np.maximum(coefficients.astype(np.float64) @ basis, 0.0)
    assert out.basis.shape[0] == 5
    np.testing.assert_allclose(radiance(out), exact, atol=2e-6 * exact.max())
    assert "rank 3 to 5" in notes[0].message


def test_clamping_many_different_texels_goes_to_full_rank_and_stays_exact(tmp_path):
    coefficients = RNG.normal(0.3, 1.0, (32, 64, 3)).astype(np.float32)
    basis = RNG.random((3, 61))
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis)
    out = only_dome(stage, bad_pixels="clamp")
    exact = np.maximum(coefficients.astype(np.float64) @ basis, 0.0)
    np.testing.assert_allclose(radiance(out), exact, atol=2e-6 * exact.max())


def test_coefficients_that_are_not_finite_are_refused_or_black(tmp_path):
    coefficients = RNG.random((4, 8, 2)).astype(np.float32)
    coefficients[1, 2, 0], coefficients[3, 4, 1] = np.nan, np.inf
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), RNG.random((2, 61)))
    with pytest.raises(ImageError, match=r"1 NaN .first at x 2, y 1.*1 infinite .first at x 4"):
        read(stage)
    out = only_dome(stage, bad_pixels="clamp")
    assert not out.coefficients[1, 2].any() and not out.coefficients[3, 4].any()
    np.testing.assert_array_equal(out.coefficients[0], coefficients[0])


@pytest.mark.parametrize(("held", "rank"), [(2, 3), (4, 3)])
def test_basis_and_channels_must_agree(tmp_path, held, rank):
    file = write_coefficients(tmp_path / "c.exr", np.ones((4, 8, held), np.float32))
    stage = new_stage()
    basis_dome(stage, file, np.ones((rank, 61)))
    with pytest.raises(ImageError, match=r"has 3 rows and needs the channels c0 to c2.*c1"):
        read(stage)


def test_basis_beside_the_rendered_wavelengths_is_refused(tmp_path):
    file = write_coefficients(tmp_path / "c.exr", np.ones((4, 8, 1), np.float32))
    stage = new_stage()
    basis_dome(stage, file, np.ones((1, 3)), [900.0, 950.0, 1000.0])
    with pytest.raises(LayerError, match="900 to 1000 nm"):
        read(stage)


def write_bands(path, nm, pixels):
    names = [f"S0.{int(w)},{round(w % 1 * 1e6):06d}nm" for w in nm]
    return write_exr(path, {name: pixels[..., k] for k, name in enumerate(names)})


@pytest.mark.parametrize("rank", [1, 3, 7, 61])
def test_bands_light_is_factorised_at_its_rank(tmp_path, rank):
    pixels = np.exp(RNG.normal(0.0, 3.0, (16, 32, rank))) @ (RNG.random((rank, 61)) ** 3)
    pixels = pixels.astype(np.float32)
    stage = new_stage()
    file = write_bands(tmp_path / "b.exr", NM, pixels)
    spectral(dome(stage), "bands", bands_file=Sdf.AssetPath(file), scale=2.0)
    out = only_dome(stage)
    assert out.coefficients.shape == (16, 32, rank)
    peak = 2.0 * pixels.max(axis=-1, keepdims=True)
    assert (np.abs(radiance(out) - 2.0 * pixels) / peak).max() < 1.5e-6


def test_one_texel_of_another_lamp_raises_the_rank(tmp_path):
    pixels = RNG.random((16, 32, 1)) * np.linspace(1.0, 2.0, 61)
    pixels[7, 3] = 1e-3 * np.linspace(2.0, 1.0, 61) ** 2
    stage = new_stage()
    file = write_bands(tmp_path / "b.exr", NM, pixels.astype(np.float32))
    spectral(dome(stage), "bands", bands_file=Sdf.AssetPath(file))
    out = only_dome(stage)
    assert out.basis.shape[0] == 2
    np.testing.assert_allclose(radiance(out)[7, 3], pixels[7, 3], rtol=1e-5)


def test_bands_are_averaged_onto_the_grid(tmp_path):
    nm = np.arange(380.0, 731.0, 10.0)
    pixels = np.broadcast_to(nm / 500.0, (4, 8, nm.size)).astype(np.float32)
    stage = new_stage()
    spectral(
        dome(stage), "bands", bands_file=Sdf.AssetPath(write_bands(tmp_path / "b.exr", nm, pixels))
    )
    np.testing.assert_allclose(radiance(only_dome(stage))[0, 0], NM / 500.0, rtol=1e-6)


def test_bad_bands_are_refused_or_clamped_exactly(tmp_path):
    pixels = RNG.random((4, 8, 61)).astype(np.float32)
    pixels[2, 6, 10] = -0.25
    stage = new_stage()
    file = write_bands(tmp_path / "b.exr", NM, pixels)
    spectral(dome(stage), "bands", bands_file=Sdf.AssetPath(file))
    with pytest.raises(ImageError, match=r"1 negative .lowest -0.25 at x 6, y 2"):
        read(stage)
    out = only_dome(stage, bad_pixels="clamp")
    np.testing.assert_allclose(radiance(out), np.maximum(pixels, 0.0), atol=1e-6)


# --- OpenUSD's physical-lighting proposal ------------------------------------------------------


def test_physical_black_body_colors_an_rgb_map(tmp_path):
    pixels = rgb_map()
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", pixels))
    light.CreateColorTemperatureAttr(2856.0)
    light.GetPrim().CreateAttribute("physical:illuminant", Sdf.ValueTypeNames.Token).Set(
        "blackbody"
    )
    np.testing.assert_allclose(xyz(only_dome(stage)), adapted(pixels, "2856K"), atol=1e-6)


def test_physical_custom_illuminant_is_radiance_as_authored():
    stage = new_stage()
    prim = dome(stage).GetPrim()
    value = RNG.random(61) + 0.2
    prim.CreateAttribute("physical:illuminant", Sdf.ValueTypeNames.Token).Set("custom")
    pairs = Vt.Vec2fArray([Gf.Vec2f(a, b) for a, b in zip(NM, value, strict=True)])
    prim.CreateAttribute("physical:customIlluminant", Sdf.ValueTypeNames.Float2Array).Set(pairs)
    np.testing.assert_allclose(radiance(only_dome(stage))[0, 0], value, rtol=1e-6)
