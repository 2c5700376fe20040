"""The skin prior: laws of the estimate, outside values, and measured skin of left-out origins."""

import json

import numpy as np
import pytest

from usdskin.colorimetry import (
    cat16,
    illuminant,
    linearize,
    rgb_to_xyz,
    white_xyz,
    xyz_weights,
)
from usdskin.differences import delta_e_of_signals
from usdskin.errors import ImageError, LayerError, UsdSkinError
from usdskin.estimate.skin.albedo import weights_of_albedo
from usdskin.estimate.skin.generate import read_issa, write_prior
from usdskin.estimate.skin.prior import SkinPrior, fit_prior, shipped_prior, skin_map
from usdskin.estimate.skin.recovered import rgb_weights, skin_from_camera, skin_from_rgb
from usdskin.estimate.skin.surface import fresnel, specular_included
from usdskin.judge.skin_prior import LIGHTS, judge_origins
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, resample

GRID = DEFAULT_WAVELENGTHS_NM
LAMPS = LIGHTS


def camera(grid=GRID):
    """Return a responsivity that is no linear map of an observer's, shape [n, 3]."""
    peaks, widths = np.array([600.0, 535.0, 460.0]), np.array([38.0, 42.0, 30.0])
    return np.exp(-0.5 * ((grid[:, None] - peaks) / widths) ** 2) + 0.01


def seen_by(lamp, t=None, grid=GRID):
    weights = illuminant(lamp, grid)[:, None] * (camera(grid) if t is None else t)
    return weights / weights.sum(axis=0)


def drawn(count=400, seed=3, prior=None):
    """Return skins drawn from the prior."""
    prior = shipped_prior() if prior is None else prior
    rng = np.random.default_rng(seed)
    scores = rng.standard_normal((count, len(prior.components)))
    return prior.mean + scores @ prior.components + rng.standard_normal((count, 61)) * prior.rest


def skins(count=200):
    """Return drawn skins that are nowhere black."""
    found = drawn(2 * count)
    return found[(found > 0.02).all(axis=1)][:count]


# --- The estimate ------------------------------------------------------------------------------


@pytest.mark.parametrize("lamp", LAMPS)
def test_without_noise_the_camera_values_are_met_exactly(lamp):
    values = skins() @ seen_by(lamp)
    found = skin_from_camera(values, camera(), illuminant(lamp, GRID)).reflectance
    np.testing.assert_allclose(found @ seen_by(lamp), values, rtol=1e-9)


def test_estimate_is_linear_and_so_blind_to_brightness():
    mapped = skin_map(shipped_prior(), seen_by("FL2"), 0.01)
    first, second = skins(2) @ mapped.seen
    np.testing.assert_allclose(
        mapped(2.0 * first + 0.5 * second), 2.0 * mapped(first) + 0.5 * mapped(second), rtol=1e-12
    )
    np.testing.assert_allclose(mapped.unlikeness(0.1 * first), mapped.unlikeness(first))


def test_skin_of_three_dimensions_is_found_exactly():
    full = shipped_prior()
    flat = SkinPrior(GRID, full.mean, full.components[:2], np.zeros(61))
    skin = drawn(50, prior=flat)
    for lamp in LAMPS:
        mapped = skin_map(flat, seen_by(lamp))
        np.testing.assert_allclose(mapped(skin @ mapped.seen), skin, atol=1e-9)
        assert mapped.stddev(skin @ mapped.seen).max() < 1e-6


def test_map_is_the_least_squares_map_of_many_noisy_skins():
    """The Wiener matrix is where regression on drawn skins with drawn noise goes."""
    skin = drawn(40000)
    mapped = skin_map(shipped_prior(), seen_by("D65"), 0.05)
    values = skin @ mapped.seen
    spread = 0.05 * np.sqrt((values**2).mean(axis=0))
    values = values + spread * np.random.default_rng(1).standard_normal(values.shape)
    regressed = np.linalg.lstsq(values, skin, rcond=None)[0].T
    mean = skin.mean(axis=0) @ mapped.seen
    np.testing.assert_allclose(regressed @ mean, mapped(mean), rtol=0.003)
    np.testing.assert_allclose(regressed, mapped.matrix, atol=0.02 * np.abs(mapped.matrix).max())


@pytest.mark.parametrize("noise", [0.0, 0.01, 0.05])
def test_errors_have_the_stated_standard_deviation(noise):
    skin = skins(1500)
    mapped = skin_map(shipped_prior(), seen_by("D65"), noise)
    values = skin @ mapped.seen
    values *= 1.0 + noise * np.random.default_rng(2).standard_normal(values.shape)
    error = (mapped(values) - skin) / mapped.stddev(values)
    assert 0.85 < np.sqrt((error**2).mean()) < 1.15


def test_more_noise_draws_further_to_skin():
    spread = [
        np.linalg.norm(skin_map(shipped_prior(), seen_by("A"), noise).matrix)
        for noise in (0.0, 0.01, 0.03, 0.1)
    ]
    assert spread == sorted(spread, reverse=True)


def test_scales_of_light_and_camera_do_not_matter():
    values = skins(5) @ seen_by("FL11")
    light = illuminant("FL11", GRID)
    first = skin_from_camera(values, camera(), light, 0.01)
    second = skin_from_camera(values, 1e-4 * camera() * [1.0, 3.0, 0.2], 50.0 * light, 0.01)
    np.testing.assert_allclose(first.reflectance, second.reflectance, rtol=1e-9)
    np.testing.assert_allclose(first.stddev, second.stddev, rtol=1e-9)


def test_grid_of_the_camera_is_the_grid_of_the_answer():
    grid = np.arange(380.0, 731.0, 10.0)
    skin = resample(GRID, skins(5), grid, outside="hold")
    light = illuminant("A", grid)
    found = skin_from_camera(
        skin @ seen_by("A", grid=grid), camera(grid), light, wavelength_nm=grid
    )
    assert found.reflectance.shape == (5, 36)
    np.testing.assert_array_equal(found.wavelength_nm, grid)
    assert delta_e_of_signals(found.reflectance * light, skin * light, light, grid).max() < 1.5


# --- The shipped table -------------------------------------------------------------------------


def test_shipped_skin_has_the_bands_of_haemoglobin():
    """Oxygenated blood absorbs most at 542 and 577 nm (R. R. Anderson, J. A. Parrish, 1981)."""
    absorbance = -np.log(shipped_prior().mean)
    slope = np.polyval(np.polyfit(GRID[20:44], absorbance[20:44], 2), GRID[20:44])
    bands = absorbance[20:44] - slope
    peaks = 1 + np.flatnonzero((bands[1:-1] > bands[:-2]) & (bands[1:-1] > bands[2:]))
    heights = sorted(peaks, key=lambda index: -bands[index])[:2]
    at = sorted(GRID[20:44][heights])
    assert abs(at[0] - 542.0) <= 6.0 and abs(at[1] - 577.0) <= 6.0


def test_shipped_covariance_is_that_of_a_reflectance():
    prior = shipped_prior()
    assert prior.components.shape == (8, 61)
    lengths = np.linalg.norm(prior.components, axis=1)
    assert list(lengths) == sorted(lengths, reverse=True)
    likeness = prior.components @ prior.components.T / np.outer(lengths, lengths)
    np.testing.assert_allclose(likeness, np.eye(8), atol=1e-3)  # to the digits of the table
    assert (prior.mean > 0.05).all() and (prior.mean < 0.6).all()
    assert (prior.rest**2).sum() < 1e-3 * (lengths**2).sum()


def test_skins_of_another_collection_are_found():
    """CIE 224:2017 has two measured skins among its 99 test colours, numbers 15 and 18."""
    from colour import SpectralShape
    from colour.quality.cfi2017 import load_TCS_CIE2017

    samples = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    nm = samples.wavelengths
    skin = resample(nm, samples.values[:, [14, 17]].T, GRID)
    for lamp in LAMPS:
        light = illuminant(lamp, GRID)
        found = skin_from_camera(skin @ seen_by(lamp), camera(), light, notes=(notes := []))
        assert not notes
        for other in LAMPS:
            light = illuminant(other, GRID)
            error = delta_e_of_signals(found.reflectance * light, skin * light, light, GRID)
            assert error.max() < 1.6


def test_fitted_prior_has_the_moments_of_its_skins(tmp_path):
    skin = drawn(500)
    prior = fit_prior(skin, GRID, component_count=20)
    moment = skin.T @ skin / len(skin)
    np.testing.assert_allclose(prior.moment.diagonal(), moment.diagonal(), rtol=1e-9)
    np.testing.assert_allclose(prior.moment, moment, atol=1e-4 * moment.max())
    write_prior(prior, tmp_path / "prior.csv")
    table = np.loadtxt(tmp_path / "prior.csv", delimiter=",", skiprows=1)
    np.testing.assert_allclose(table[:, 1], prior.mean, atol=1e-7)


def test_every_origin_counts_alike():
    dark, light = 0.5 * drawn(100), drawn(300, seed=4)
    both = fit_prior(np.concatenate([dark, light]), GRID, [1] * 100 + [2] * 300)
    np.testing.assert_allclose(both.mean, 0.5 * (dark.mean(axis=0) + light.mean(axis=0)))


def test_too_few_skins_settle_no_prior():
    with pytest.raises(ValueError, match="do not settle"):
        fit_prior(drawn(8), GRID)
    with pytest.raises(ValueError, match="61 wavelengths"):
        fit_prior(drawn(20)[:, :60], GRID)


# --- Readings that are no skin -----------------------------------------------------------------


def test_grey_and_blue_are_noted_as_unlike_skin():
    seen = seen_by("D65")
    bluish = np.linspace(0.35, 0.25, 61)
    values = np.stack([np.full(61, 0.5) @ seen, bluish @ seen, skins(1)[0] @ seen])
    notes = []
    found = skin_from_camera(
        values, camera(), illuminant("D65", GRID), where="a.usda </Skin>", notes=notes
    )
    assert [note.code for note in notes] == ["unlike-skin"] * 2
    assert notes[0].path == "a.usda </Skin>" and "reading [0]" in notes[0].message
    assert found.unlikeness[2] < 4.0


def test_green_is_refused():
    with pytest.raises(LayerError, match=r"x: cheek has .* over those of white, which no skin has"):
        skin_from_rgb([[0.1, 0.4, 0.1]], where="x", names=["cheek"])


@pytest.mark.parametrize("value", [np.nan, 0.0, -0.1, np.inf])
def test_values_that_are_no_light_are_refused(value):
    with pytest.raises(LayerError, match=r"reading \[1\] .* numbers above zero"):
        skin_from_rgb([[0.4, 0.3, 0.2], [0.4, value, 0.2]])


def test_lamp_of_one_line_is_refused():
    line = np.where(GRID == 590.0, 1.0, 0.0)
    with pytest.raises(LayerError, match="three colors apart"):
        skin_from_camera([[0.3, 0.3, 0.3]], camera(), line)


def test_shapes_that_disagree_are_refused():
    with pytest.raises(ValueError, match="bands"):
        skin_map(shipped_prior(), np.ones((60, 3)))
    with pytest.raises(ValueError, match="noise"):
        skin_map(shipped_prior(), seen_by("A"), -0.1)
    with pytest.raises(ValueError, match=r"\[k, 3\]"):
        skin_from_rgb([[0.3, 0.2]])


# --- Colours and textures ----------------------------------------------------------------------


def xyz_under_d65(reflectance, observer="cie1931_2"):
    weights = illuminant("D65", GRID)[:, None] * xyz_weights(GRID, observer)
    return reflectance @ weights / weights[:, 1].sum(), weights.sum(axis=0) / weights[:, 1].sum()


@pytest.mark.parametrize("space", ["lin_rec709_scene", "lin_ap1_scene", "lin_rec2020_scene"])
@pytest.mark.parametrize("observer", ["cie1931_2", "cie1964_10"])
def test_skin_of_a_color_has_that_color_under_d65(space, observer):
    rgb = np.array([[0.55, 0.36, 0.27], [0.12, 0.07, 0.05], [0.42, 0.22, 0.17]])
    found = skin_from_rgb(rgb, space, observer=observer).reflectance
    xyz, white = xyz_under_d65(found, observer)
    expected = rgb @ (cat16(white_xyz(space), white) @ rgb_to_xyz(space)).T
    np.testing.assert_allclose(xyz, expected, rtol=1e-9)


def test_white_is_white_to_the_rgb_weights():
    np.testing.assert_allclose(rgb_weights(GRID).sum(axis=0), 1.0, rtol=1e-12)


def picture(seed=5):
    """Return a skin albedo in linear Rec. 709, shape [6, 8, 3]."""
    found = skins(48) @ rgb_weights(GRID)
    return np.random.default_rng(seed).permutation(found).reshape(6, 8, 3)


def test_texture_of_weights_has_the_colors_of_the_albedo():
    image = picture().astype(np.float32)
    result = weights_of_albedo(image, notes=(notes := []))
    assert not notes and result.weights.dtype == np.float32
    spectra = result.weights.astype(np.float64) @ result.basis
    np.testing.assert_allclose(spectra @ rgb_weights(GRID), image, atol=2e-7)
    expected = skin_from_rgb(image.reshape(-1, 3)).reflectance.reshape(6, 8, 61)
    np.testing.assert_allclose(spectra, expected, atol=2e-7)


def test_basis_of_a_texture_is_three_reflectances():
    basis = weights_of_albedo(picture()).basis
    assert basis.shape == (3, 61) and basis.min() >= 0.0
    np.testing.assert_allclose(basis.max(axis=1), 1.0)
    assert np.linalg.cond(basis) < 1e3


def test_filtered_weights_are_the_weights_of_the_filtered_albedo():
    image = picture()
    half = image.reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
    filtered = weights_of_albedo(image).weights.reshape(3, 2, 4, 2, 3).mean(axis=(1, 3))
    np.testing.assert_allclose(weights_of_albedo(half).weights, filtered, atol=1e-7)


def test_encoded_albedo_is_decoded_first():
    encoded = np.clip(picture(), 0.0, 1.0) ** (1.0 / 2.2)
    expected = weights_of_albedo(linearize(encoded, "srgb_rec709_scene")).weights
    found = weights_of_albedo(encoded, "srgb_rec709_scene").weights
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_texels_that_are_no_skin_keep_their_color_and_are_told():
    image = picture()
    image[2, 3] = [0.1, 0.5, 0.1]
    result = weights_of_albedo(image, where="face.exr", notes=(notes := []))
    assert [note.code for note in notes] == ["albedo-not-skin"]
    assert notes[0].path == "face.exr" and "1 of 48 texels" in notes[0].message
    assert "x 3, y 2" in notes[0].message
    color = result.weights[2, 3].astype(np.float64) @ result.basis @ rgb_weights(GRID)
    np.testing.assert_allclose(color, image[2, 3], atol=1e-6)


def test_bad_textures_are_refused():
    image = picture()
    image[4, 1, 0] = np.nan
    with pytest.raises(ImageError, match=r"face.exr: the texel at x 1, y 4 is not finite"):
        weights_of_albedo(image, where="face.exr")
    with pytest.raises(ImageError, match="three channels"):
        weights_of_albedo(np.ones((4, 4)))
    with pytest.raises(UsdSkinError, match="did you mean"):
        weights_of_albedo(picture(), "lin_rec709_scen")


# --- The surface's mirror image ----------------------------------------------------------------


def test_fresnel_at_normal_incidence_brewster_and_grazing():
    assert fresnel(1.5, 0.0) == pytest.approx(0.04)
    assert fresnel(1.4, 90.0) == pytest.approx(1.0)
    brewster = np.degrees(np.arctan(1.4))  # one polarisation vanishes, the other has a closed form
    expected = 0.5 * ((1.0 - 1.4**2) / (1.0 + 1.4**2)) ** 2
    assert fresnel(1.4, brewster) == pytest.approx(expected)
    np.testing.assert_allclose(fresnel(1.0, [0.0, 30.0, 80.0]), 0.0, atol=1e-15)


def test_diffuse_mean_of_fresnel_is_the_published_one():
    """0.092 for an index of 1.5 (D. B. Judd, J. Res. Natl. Bur. Stand. 29, 1942)."""
    cosine = (np.arange(20000) + 0.5) / 20000
    mean = (2.0 * cosine * fresnel(1.5, np.degrees(np.arccos(cosine)))).mean()
    assert mean == pytest.approx(0.092, abs=5e-4)


def test_specular_included_subtracts_what_the_surface_mirrors():
    diffuse = skins(3)
    index = (1.0 + np.sqrt(0.028)) / (1.0 - np.sqrt(0.028))
    assert index == pytest.approx(1.4, abs=0.003)
    measured = diffuse + fresnel(index, 8.0)
    np.testing.assert_allclose(specular_included(measured), diffuse, atol=1e-12)
    assert specular_included(0.5) == pytest.approx(0.472, abs=1e-4)


def test_reading_below_the_mirror_image_is_refused():
    with pytest.raises(LayerError, match=r"a.csv:3: value \[2\] is 0.02, not above the 0.028"):
        specular_included([0.3, 0.2, 0.02], where="a.csv:3")


# --- Measured skin and cameras -----------------------------------------------------------------

ARCHIVE = "issa_subset_400_700_10.npz"


def measured_cameras(folder):
    found = []
    for path in sorted((folder / "cameras").glob("*.json")):
        rows = json.loads(path.read_text())["spectral_data"]["data"]["main"]
        nm = np.array([float(key) for key in rows])
        found.append(resample(nm, np.array(list(rows.values()), dtype=float).T, GRID).T)
    return found


@pytest.mark.realdata
def test_shipped_prior_is_the_fit_to_all_origins(realdata):
    skin = read_issa(realdata / "skin" / ARCHIVE)
    assert len(skin.reflectance) == 6185 and skin.dropped == 9
    prior, shipped = fit_prior(skin.reflectance, GRID, skin.origin), shipped_prior()
    np.testing.assert_allclose(shipped.mean, prior.mean, atol=1e-6)
    np.testing.assert_allclose(shipped.moment, prior.moment, atol=1e-6)


@pytest.mark.slow
@pytest.mark.realdata
@pytest.mark.parametrize(("noise", "own", "other"), [(0.0, 0.4, 0.8), (0.01, 1.1, 1.3)])
def test_skin_of_left_out_origins_meets_the_bars(realdata, noise, own, other):
    """In the mean, under each pair of lights, and in every class of tone.

    Few dark skins are measured: 66 of 6185 below -30 degrees, so all of them are judged. Of equal
    relative noise the same color difference is more in light skin than in dark: 1 % in X, Y and Z
    themselves makes 1.9 times as much in the lightest class as in the darkest.
    """
    skin = read_issa(realdata / "skin" / ARCHIVE)
    cameras = measured_cameras(realdata)
    assert len(cameras) == 17
    errors = judge_origins(skin, cameras, noise)
    assert errors.own.mean() <= own
    apart = ~np.eye(len(LAMPS), dtype=bool)
    assert errors.pairs[apart].max() <= other
    by_own, by_other = errors.by_tone(errors.own), errors.by_tone(errors.other)
    print(noise, by_own.round(3), by_other.round(3), errors.by_tone(errors.inside).round(2))
    assert by_own.max() <= own and by_other.max() <= other  # in the worst class too
    assert by_own[-1] < 1.15 * errors.own.mean() and by_other[-1] < 1.25 * errors.other.mean()
    assert by_own.max() < 1.9 * by_own.min() and by_other.max() < 1.65 * by_other.min()
    assert 0.6 < errors.inside.mean() < 0.78
