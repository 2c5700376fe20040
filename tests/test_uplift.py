import numpy as np
import pytest

from usdskin.colorimetry import cat16, illuminant, rgb_to_xyz, white_xyz, xyz_weights
from usdskin.errors import UsdSkinError
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM
from usdskin.uplift import deepest_dip, light_basis, reflectance_basis

LAMPS = ["D65", "A", "FL2", "FL11", "LED-B3"]
GRIDS = {
    "default": DEFAULT_WAVELENGTHS_NM,
    "10 nm": np.arange(380.0, 731.0, 10.0),
    "irregular": np.cumsum(np.random.default_rng(5).uniform(2.0, 9.0, 70)) + 378.0,
}


def colors(count=2000):
    """Return RGB of every kind: random, primaries, grey, dark, bright, out of gamut."""
    rng = np.random.default_rng(7)
    return np.concatenate(
        [
            np.eye(3),
            1.0 - np.eye(3),
            np.ones((1, 3)),
            1e-6 * rng.random((50, 3)),
            1e5 * rng.random((50, 3)),
            rng.normal(0.2, 1.0, (50, 3)),
            rng.random((count, 3)),
        ]
    )


def expected_xyz(rgb, lamp, grid, color_space, observer):
    white = lamp @ xyz_weights(grid, observer)
    adapt = cat16(white_xyz(color_space), white / white[1])
    return rgb @ (adapt @ rgb_to_xyz(color_space)).T


@pytest.mark.parametrize("lamp", LAMPS)
@pytest.mark.parametrize("observer", ["cie1931_2", "cie1964_10", "cie2015_2"])
@pytest.mark.parametrize("color_space", ["lin_rec709_scene", "lin_ap1_scene"])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_rgb_in_is_adapted_xyz_out(lamp, observer, color_space, grid):
    spd = illuminant(lamp, grid)
    rgb = colors()
    xyz = rgb @ light_basis(spd, grid, color_space, observer) @ xyz_weights(grid, observer)
    expected = expected_xyz(rgb, spd, grid, color_space, observer)
    size = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(xyz - expected) / size).max() < 1e-11


@pytest.mark.parametrize("lamp", LAMPS)
def test_lamp_by_file_is_the_lamp_by_name(tmp_path, lamp):
    nm = np.arange(380.0, 781.0, 5.0)
    path = tmp_path / "lamp.csv"
    rows = zip(nm, illuminant(lamp, nm), strict=True)
    path.write_text("".join(f"{a:g},{float(b)!r}\n" for a, b in rows))
    grid = DEFAULT_WAVELENGTHS_NM
    by_name = light_basis(illuminant(lamp, grid), grid)
    by_file = light_basis(illuminant(str(path), grid), grid)
    rgb = colors()
    expected = expected_xyz(rgb, illuminant(lamp, grid), grid, "lin_rec709_scene", "cie1931_2")
    size = np.abs(expected).max(axis=1, keepdims=True)
    for basis in (by_name, by_file):
        assert (np.abs(rgb @ basis @ xyz_weights(grid) - expected) / size).max() < 1e-6


def test_uplift_is_linear():
    basis = light_basis(illuminant("FL2", DEFAULT_WAVELENGTHS_NM), DEFAULT_WAVELENGTHS_NM)
    first, second = colors(20)[:20], colors(20)[-20:]
    together = (2.0 * first - 0.5 * second) @ basis
    apart = 2.0 * (first @ basis) - 0.5 * (second @ basis)
    np.testing.assert_allclose(together, apart, atol=1e-12 * np.abs(apart).max())


@pytest.mark.parametrize("lamp", LAMPS)
def test_white_is_the_lamp_with_luminance_one(lamp):
    grid = DEFAULT_WAVELENGTHS_NM
    spd = illuminant(lamp, grid)
    white = light_basis(spd, grid).sum(axis=0)
    assert (white @ xyz_weights(grid))[1] == pytest.approx(1.0, rel=1e-12)
    np.testing.assert_allclose(white, spd / (spd @ xyz_weights(grid))[1], rtol=2e-7)


def test_scale_of_the_lamp_does_not_matter():
    spd = illuminant("A", DEFAULT_WAVELENGTHS_NM)
    np.testing.assert_allclose(
        light_basis(1e3 * spd, DEFAULT_WAVELENGTHS_NM), light_basis(spd, DEFAULT_WAVELENGTHS_NM)
    )


@pytest.mark.parametrize("color_space", ["lin_rec709_scene", "lin_ap1_scene", "lin_rec2020_scene"])
@pytest.mark.parametrize("grid", GRIDS.values(), ids=GRIDS)
def test_reflectance_has_its_color_under_d65(color_space, grid):
    d65 = illuminant("D65", grid)
    rgb = colors()
    weights = xyz_weights(grid)
    xyz = (rgb @ reflectance_basis(grid, color_space) * (d65 / (d65 @ weights)[1])) @ weights
    expected = expected_xyz(rgb, d65, grid, color_space, "cie1931_2")
    size = np.abs(expected).max(axis=1, keepdims=True)
    assert (np.abs(xyz - expected) / size).max() < 1e-11


def test_reflectances_of_the_srgb_gamut_lie_between_0_and_1():
    basis = reflectance_basis(DEFAULT_WAVELENGTHS_NM)
    np.testing.assert_allclose(basis.sum(axis=0), 1.0, atol=1e-7)
    assert basis.min() > 0.0  # so every color of the unit cube reflects between 0 and 1


def test_same_reflectance_seen_by_light_basis_and_reflectance_basis_under_d65():
    grid = DEFAULT_WAVELENGTHS_NM
    light = light_basis(illuminant("D65", grid), grid)
    np.testing.assert_allclose(light, reflectance_basis(grid) * light.sum(axis=0), rtol=1e-6)


@pytest.mark.parametrize("lamp", LAMPS)
def test_dip_is_the_brute_force_minimum(lamp):
    rgb = np.random.default_rng(11).random((5000, 3)).astype(np.float32) ** 4
    basis = light_basis(illuminant(lamp, DEFAULT_WAVELENGTHS_NM), DEFAULT_WAVELENGTHS_NM)
    spectra = rgb.astype(np.float64) @ basis
    ratio = spectra.min(axis=1) / spectra.max(axis=1)
    depth, worst, count = deepest_dip(rgb, basis)
    assert depth == pytest.approx(min(ratio.min(), 0.0), abs=1e-6)
    assert abs(count - np.count_nonzero(ratio < -1e-6)) <= 2
    if lamp == "FL2":
        assert depth < -0.05 and worst == int(np.argmin(ratio))


def test_dip_passes_over_black_and_bad_rows():
    basis = np.array([[1.0, -0.5], [0.0, 1.0], [0.0, 0.0]])
    rows = [[0.0, 0.0, 0.0], [np.nan, 1.0, 1.0], [-1.0, 0.0, 0.0], [np.inf, 0.0, 0.0]]
    assert deepest_dip(rows, basis) == (0.0, -1, 0)
    assert deepest_dip([*rows, [2.0, 0.0, 0.0]], basis) == (-0.5, 4, 1)


def test_monochromatic_lamp_is_refused():
    line = np.where(DEFAULT_WAVELENGTHS_NM == 590.0, 1.0, 0.0)
    with pytest.raises(UsdSkinError, match="three independent"):
        light_basis(line, DEFAULT_WAVELENGTHS_NM)


def test_black_lamp_is_refused():
    with pytest.raises(UsdSkinError, match="no luminance"):
        light_basis(np.zeros(61), DEFAULT_WAVELENGTHS_NM)
