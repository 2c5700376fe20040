"""``usdskin compare``: closed forms first, then published values, then pictures from end to end."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from usdskin.cli import main
from usdskin.colorimetry import (
    chromaticity_to_xyz,
    delta_e_2000,
    illuminant,
    rgb_to_xyz,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.errors import FindingsError, ImageError, UsageError
from usdskin.images import Part, read_headers, read_image, write_exr, write_png, write_spectral_exr
from usdskin.judge.comparison.bars import judge_bars, require
from usdskin.judge.comparison.compare import CompareOptions, compare_pictures, displayed
from usdskin.judge.comparison.flip import flip_differences
from usdskin.judge.comparison.maps import write_maps
from usdskin.judge.comparison.spectra import common_grid
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, resample

GRID = DEFAULT_WAVELENGTHS_NM
SPACE = "lin_rec709_scene"
HEIGHT, WIDTH = 24, 32

ARMS, FACE = "/World/Arms", "/World/Head/Face"

# Sharma, Wu and Dalal, "The CIEDE2000 Color-Difference Formula", Color Res. Appl. 30(1), 2005,
# table 1: pairs 1, 4, 7, 9, 13, 16, 17, 19, 25, 28, 31 and 34.
SHARMA = [
    ((50.0, 2.6772, -79.7751), (50.0, 0.0, -82.7485), 2.0425),
    ((50.0, -1.3802, -84.2814), (50.0, 0.0, -82.7485), 1.0000),
    ((50.0, 0.0, 0.0), (50.0, -1.0, 2.0), 2.3669),
    ((50.0, 2.4900, -0.0010), (50.0, -2.4900, 0.0009), 7.1792),
    ((50.0, -0.0010, 2.4900), (50.0, 0.0009, -2.4900), 4.8045),
    ((50.0, 2.5000, 0.0), (50.0, 0.0, -2.5000), 4.3065),
    ((50.0, 2.5000, 0.0), (73.0, 25.0, -18.0), 27.1492),
    ((50.0, 2.5000, 0.0), (56.0, -27.0, -3.0), 31.9030),
    ((60.2574, -34.0099, 36.2677), (60.4626, -34.1751, 39.4387), 1.2644),
    ((22.7233, 20.0904, -46.6940), (23.0331, 14.9730, -42.5619), 2.0373),
    ((90.8027, -2.0831, 1.4410), (91.1528, -1.6435, 0.0447), 1.4441),
    ((2.0776, 0.0795, -1.1350), (0.9033, -0.0636, -0.5514), 0.9082),
]


def surfaces(seed: int = 0) -> np.ndarray:
    """Return smooth reflectances, shape [HEIGHT, WIDTH, bands]."""
    rng = np.random.default_rng(seed)
    level = rng.uniform(0.1, 0.7, (HEIGHT, WIDTH, 1))
    slope = rng.normal(0.0, 0.15, (HEIGHT, WIDTH, 1)) * np.linspace(-1.0, 1.0, GRID.size)
    return np.clip(level + slope, 0.02, 0.95)


LIGHT = illuminant("FL2", GRID) / (illuminant("FL2", GRID) @ xyz_weights(GRID)[:, 1])
"""Radiance of the perfect diffuser: Y_n = 1."""
WHITE = LIGHT @ xyz_weights(GRID)

# What the test of that name says: pixels per degree, mean, and the pixels (15, 15) and (30, 28).
FLIP_REFERENCE = (
    (67.0, 0.165999, 0.973545, 0.437448),
    (30.0, 0.151415, 0.974332, 0.965705),
    (10.0, 0.137447, 0.970587, 0.992630),
)
BLACK_AND_WHITE = 0.967388


def header(
    units: str = "relative", observer: str = "cie1931_2", exposure: float = 1.0, **more: str
) -> dict:
    return {
        **more,
        "usdskin/observer": observer,
        "usdskin/units": units,
        "usdskin/exposureScale": repr(exposure),
    }


def prim_ids() -> np.ndarray:
    """Return background at the top, arms at the left, the face at the right."""
    ids = np.zeros((HEIGHT, WIDTH), np.uint32)
    ids[4:, : WIDTH // 2], ids[4:, WIDTH // 2 :] = 1, 3
    return ids


def write_picture(
    path: Path,
    xyz: np.ndarray,
    *,
    spectra: np.ndarray | None = None,
    wavelength_nm: np.ndarray = GRID,
    irradiance: np.ndarray | None = WHITE,
    ids: bool = True,
    alpha: np.ndarray | None = None,
    exposure: float = 1.0,
    sample_type: str = "float",
    space: str = SPACE,
    **of_header: str,
) -> Path:
    """Write what a render writes; ``irradiance`` is of the brightest pixel, over pi."""
    attributes = header(exposure=exposure, **of_header)
    cover = np.ones(xyz.shape[:2]) if alpha is None else alpha
    rgba = np.concatenate([exposure * xyz @ xyz_to_rgb(space).T, cover[..., None]], axis=-1)
    parts = [Part("beauty", {"": rgba.astype(np.float32)}, attributes, sample_type, space)]
    if irradiance is not None:
        share = np.linspace(0.2, 1.0, xyz.shape[0] * xyz.shape[1]).reshape(*xyz.shape[:2], 1)
        rgb = np.pi * share * (irradiance @ xyz_to_rgb(space).T)
        parts.append(Part("irradiance", {"irradiance": rgb.astype(np.float32)}, {}, "float", space))
    if ids:
        names = {"usdskin/primIds": f"1 {ARMS}\n2 /World/Unseen\n3 {FACE}"}
        parts.append(Part("primId", {"primId": prim_ids()}, names, "uint"))
    write_exr(path, parts)
    if spectra is not None:
        units = "W.m^-2.sr^-1.nm^-1" if of_header.get("units", "relative") != "relative" else ""
        write_spectral_exr(
            path.with_suffix(".spectral.exr"),
            wavelength_nm,
            spectra.astype(np.float32),
            rgba[..., :3].astype(np.float32),
            units or "relative",
            attributes,
        )
    return path


def pair(folder: Path, change=lambda spectra: spectra, **flags) -> tuple[Path, Path]:
    """Write a truth and a changed picture, with spectra."""
    true = surfaces() * LIGHT
    found = change(true)
    weights = xyz_weights(GRID)
    return (
        write_picture(folder / "truth.exr", true @ weights, spectra=true, **flags),
        write_picture(folder / "found.exr", found @ weights, spectra=found, **flags),
    )


def grey(folder: Path, factor: float, level: float = 0.3) -> tuple[Path, Path]:
    """Write grey pictures, the second brighter by a factor."""
    xyz = np.broadcast_to(level * WHITE, (HEIGHT, WIDTH, 3))
    return (
        write_picture(folder / "truth.exr", xyz),
        write_picture(folder / "found.exr", factor * xyz),
    )


# --- Laws ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(("first", "second", "expected"), SHARMA)
def test_ciede2000_is_that_of_the_published_pairs(first, second, expected):
    assert delta_e_2000(first, second) == pytest.approx(expected, abs=5e-5)


def test_a_picture_does_not_differ_from_itself(tmp_path):
    truth, found = pair(tmp_path)
    result = compare_pictures(truth, found)
    for name in ("dE2000", "dE76", "flip", "rmse", "dL", "da", "db"):
        assert np.abs(result.maps[name][result.mask]).max() == 0.0, name
    assert result.as_json()["spectral"]["mingfc"] == pytest.approx(1.0, abs=1e-12)


def test_a_known_scale_gives_the_difference_worked_out_by_hand(tmp_path):
    # Grey: L* = 116 cbrt(Y / Y_n) - 16; dE76 = dL*, dE2000 = dL* / S_L (Sharma et al., eq. 15).
    truth, found = grey(tmp_path, 1.03)
    low, high = (116.0 * np.cbrt(y) - 16.0 for y in (0.3, 0.309))
    middle = (0.5 * (low + high) - 50.0) ** 2
    s_l = 1.0 + 0.015 * middle / np.sqrt(20.0 + middle)
    found_json = compare_pictures(truth, found).as_json()
    assert found_json["deltaL"]["mean"] == pytest.approx(high - low, rel=1e-4)
    assert found_json["deltaE76"]["max"] == pytest.approx(high - low, rel=1e-3)
    assert found_json["deltaE2000"]["mean"] == pytest.approx((high - low) / s_l, rel=1e-4)
    assert abs(found_json["deltaA"]["mean"]) < 1e-4


def test_an_unmasked_dark_background_thins_a_difference_out(tmp_path):
    truth, found = grey(tmp_path, 1.03)
    for path in (truth, found):
        picture = read_image(path, part="beauty").pixels[..., :3] @ rgb_to_xyz(SPACE).T
        picture[:12] *= 1e-3
        write_picture(path, picture)
    whole = compare_pictures(truth, found).as_json()
    bright = compare_pictures(truth, found, CompareOptions(masks=("luminance:0.01",))).as_json()
    assert bright["mask"]["share"] == 0.5
    assert whole["deltaE2000"]["mean"] < 0.52 * bright["deltaE2000"]["mean"]


def test_scaling_the_light_of_both_changes_nothing(tmp_path):
    change = _redder
    figures = []
    for index, scale in enumerate((1.0, 1e-3)):
        folder = tmp_path / str(index)
        folder.mkdir()
        true = surfaces() * LIGHT * scale
        weights = xyz_weights(GRID)
        paths = [
            write_picture(folder / name, of @ weights, spectra=of, irradiance=scale * WHITE)
            for name, of in (("truth.exr", true), ("found.exr", change(true)))
        ]
        figures.append(compare_pictures(*paths).maps["dE2000"])
    np.testing.assert_allclose(figures[1], figures[0], rtol=2e-5, atol=1e-5)


def _redder(spectra: np.ndarray) -> np.ndarray:
    return spectra * np.linspace(0.97, 1.05, GRID.size)


def test_exposure_of_the_camera_is_divided_out(tmp_path):
    xyz = np.broadcast_to(0.4 * WHITE, (HEIGHT, WIDTH, 3))
    truth = write_picture(tmp_path / "truth.exr", xyz, exposure=0.125)
    found = write_picture(tmp_path / "found.exr", xyz, exposure=2.0)
    assert compare_pictures(truth, found).statistics("dE2000")["max"] < 1e-4


def test_differences_are_those_after_adaptation_by_the_same_von_kries_transform(tmp_path):
    # L*a*b* is seen against the diffuser: scaling X, Y and Z, white and all, changes nothing.
    truth, found = pair(tmp_path, _redder)
    expected = compare_pictures(truth, found).maps["dE2000"]
    gain = np.array([0.6, 1.0, 1.7])
    folder = tmp_path / "adapted"
    folder.mkdir()
    weights = xyz_weights(GRID)
    true = surfaces() * LIGHT
    for path, spectra in ((truth, true), (found, _redder(true))):
        write_picture(folder / path.name, gain * (spectra @ weights), irradiance=gain * WHITE)
    adapted = compare_pictures(folder / truth.name, folder / found.name).maps["dE2000"]
    np.testing.assert_allclose(adapted, expected, atol=2e-4)


def test_spectra_and_colors_of_one_render_give_the_same_difference(tmp_path):
    truth, found = pair(tmp_path, _redder)
    from_spectra = compare_pictures(truth, found)
    for path in (truth, found):
        path.with_suffix(".spectral.exr").unlink()
    from_colors = compare_pictures(truth, found)
    assert (from_spectra.spectral is None, from_colors.spectral is None) == (False, True)
    np.testing.assert_allclose(
        from_colors.maps["dE2000"], from_spectra.maps["dE2000"], rtol=1e-3, atol=1e-4
    )


@pytest.mark.parametrize("space", ["lin_ap1_scene", "lin_rec2020_scene"])
def test_color_space_of_the_file_does_not_matter(tmp_path, space):
    truth, found = grey(tmp_path, 1.03)
    expected = compare_pictures(truth, found).statistics("dE2000")
    write_picture(found, np.broadcast_to(1.03 * 0.3 * WHITE, (HEIGHT, WIDTH, 3)), space=space)
    assert compare_pictures(truth, found).statistics("dE2000") == pytest.approx(expected, rel=1e-3)


def test_half_floats_cost_less_than_a_hundredth(tmp_path):
    xyz = surfaces() @ (LIGHT[:, None] * xyz_weights(GRID))
    truth = write_picture(tmp_path / "truth.exr", xyz)
    half = write_picture(tmp_path / "half.exr", xyz, sample_type="half")
    assert 0.0 < compare_pictures(truth, half).statistics("dE2000")["max"] < 0.05


def test_regions_part_the_mask(tmp_path):
    truth, found = pair(tmp_path, _redder)
    result = compare_pictures(truth, found)
    regions = result.as_json()["regions"]
    assert {region["name"] for region in regions} == {"(none)", ARMS, FACE}
    assert sum(region["pixels"] for region in regions) == result.mask.sum()
    mean = sum(region["pixels"] * region["deltaE2000"]["mean"] for region in regions)
    assert mean / result.mask.sum() == pytest.approx(result.statistics("dE2000")["mean"])


def test_selection_of_a_prim_is_its_region(tmp_path):
    truth, found = pair(tmp_path, _redder)
    regions = {region["name"]: region for region in compare_pictures(truth, found).regions}
    for wanted in (FACE, "/World/Head", "*/Face"):
        result = compare_pictures(truth, found, CompareOptions(select=(wanted,)))
        assert int(result.mask.sum()) == regions[FACE]["pixels"]
        assert result.statistics("dE2000") == regions[FACE]["deltaE2000"]


def test_partly_covered_pixels_are_not_judged(tmp_path):
    alpha = np.ones((HEIGHT, WIDTH))
    alpha[:, 0], alpha[:, 1] = 0.0, 0.7
    xyz = np.broadcast_to(0.3 * WHITE, (HEIGHT, WIDTH, 3))
    truth = write_picture(tmp_path / "truth.exr", xyz)
    found = write_picture(tmp_path / "found.exr", xyz * alpha[..., None], alpha=alpha)
    result = compare_pictures(truth, found)
    assert result.mask.sum() == HEIGHT * (WIDTH - 2)
    assert result.statistics("dE2000")["max"] < 1e-4
    unmasked = compare_pictures(truth, found, CompareOptions(masks=("all",)))
    assert unmasked.statistics("dE2000")["max"] > 10.0


def test_white_is_the_diffuser_at_the_brightest_irradiance_within_the_mask(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    result = compare_pictures(truth, found)
    np.testing.assert_allclose(result.diffuser_xyz, WHITE, rtol=1e-6)
    assert f"column {WIDTH - 1}, row {HEIGHT - 1}" in result.white_from
    arms = compare_pictures(truth, found, CompareOptions(select=(ARMS,)))
    assert 0.97 < arms.diffuser_xyz[1] / WHITE[1] < 0.99
    np.testing.assert_allclose(arms.white, result.white, atol=1e-6)


def test_other_observers_need_spectra_and_their_own_white(tmp_path):
    truth, found = pair(tmp_path, _redder)
    white = LIGHT @ xyz_weights(GRID, "cie1964_10")
    with pytest.raises(UsageError, match="its irradiance is seen by cie1931_2, not by cie1964_10"):
        compare_pictures(truth, found, CompareOptions(observer="cie1964_10"))
    options = CompareOptions(observer="cie1964_10", diffuser=tuple(white))
    result = compare_pictures(truth, found, options)
    assert result.observer == "cie1964_10"
    true = surfaces() * LIGHT
    from usdskin.differences import delta_e_of_signals

    expected = delta_e_of_signals(_redder(true), true, LIGHT, GRID, "cie1964_10")
    np.testing.assert_allclose(result.maps["dE2000"], expected, atol=1e-4)
    found.with_suffix(".spectral.exr").unlink()
    with pytest.raises(UsageError, match="without spectra in both pictures"):
        compare_pictures(truth, found, options)


def test_spectral_figures_are_those_of_the_spectra(tmp_path):
    from usdskin.differences import goodness_of_fit

    truth, found = pair(tmp_path, _redder)
    true = surfaces() * LIGHT
    figures = compare_pictures(truth, found).as_json()["spectral"]
    error = _redder(true) - true
    assert figures["rmse"] == pytest.approx(np.sqrt((error**2).mean()) / true.max(), rel=1e-4)
    assert figures["gfc"] == pytest.approx(goodness_of_fit(_redder(true), true).mean(), abs=1e-6)
    assert figures["p05gfc"] <= figures["gfc"] <= 1.0


@pytest.mark.parametrize("sample_type", ["float", "half"])
def test_spectra_beside_another_render_are_refused(tmp_path, sample_type):
    weights, true = xyz_weights(GRID), surfaces() * LIGHT
    version = {"usdskin/version": "0.1"}
    given = {"spectra": true, "sample_type": sample_type, **version}
    truth = write_picture(tmp_path / "truth.exr", true @ weights, **given)
    found = write_picture(tmp_path / "found.exr", true @ weights, **given)
    assert compare_pictures(truth, found).as_json()["deltaE2000"]["max"] < 0.2
    write_picture(found, 1.02 * true @ weights, sample_type=sample_type, **version)
    message = r"found.spectral.exr: is of another render than found.exr beside it; render both"
    for name in ("found.exr", "found.spectral.exr"):
        with pytest.raises(ImageError, match=message):
            compare_pictures(truth, tmp_path / name)


def test_black_where_the_truth_is_black_fits(tmp_path):
    def dark(spectra):
        return np.where((prim_ids() == 1)[..., None], 0.0, spectra)

    weights = xyz_weights(GRID)
    true = dark(surfaces() * LIGHT)
    truth = write_picture(tmp_path / "truth.exr", true @ weights, spectra=true)
    assert compare_pictures(truth, truth).as_json()["spectral"]["mingfc"] == pytest.approx(1.0)


def test_spectra_named_directly_are_those_beside_the_beauty(tmp_path):
    truth, found = pair(tmp_path, _redder)
    named = compare_pictures(truth, found).as_json()
    direct = compare_pictures(
        truth.with_suffix(".spectral.exr"), found.with_suffix(".spectral.exr")
    ).as_json()
    assert {**direct, "truth": "", "picture": ""} == {**named, "truth": "", "picture": ""}


def test_coarser_spectra_are_compared_on_their_own_grid_by_integration(tmp_path):
    truth, _ = pair(tmp_path)
    coarse = np.arange(410.0, 691.0, 20.0)
    spectra = resample(GRID, surfaces() * LIGHT, coarse)
    found = write_picture(
        tmp_path / "coarse.exr",
        surfaces() @ (LIGHT[:, None] * xyz_weights(GRID)),
        spectra=spectra,
        wavelength_nm=coarse,
    )
    result = compare_pictures(truth, found)
    assert result.as_json()["spectral"]["rmse"] < 1e-6
    assert result.statistics("dE2000")["max"] < 1e-3
    assert [note.code for note in result.notes] == ["grids-differ"]


def test_common_grid_is_the_coarser_within_both_ranges():
    np.testing.assert_array_equal(common_grid(GRID, GRID.copy()), GRID)
    wide = np.arange(380.0, 781.0, 10.0)
    shared = common_grid(GRID, wide)
    np.testing.assert_array_equal(shared, np.arange(410.0, 691.0, 10.0))
    with pytest.raises(ImageError, match="share no range"):
        common_grid(GRID, np.arange(800.0, 900.0, 10.0))


# --- FLIP ----------------------------------------------------------------------------------------


def test_flip_is_zero_for_equal_pictures_and_symmetric():
    rng = np.random.default_rng(1)
    one, other = rng.random((2, 20, 30, 3))
    assert flip_differences(one, one).max() == 0.0
    np.testing.assert_allclose(flip_differences(one, other), flip_differences(other, one))


def test_flip_of_black_and_white_is_that_of_the_reference_program():
    # flip-evaluator 1.7: uniform pictures have no features, so this is the colour term alone.
    black, white = np.zeros((9, 9, 3)), np.ones((9, 9, 3))
    np.testing.assert_allclose(flip_differences(white, black), BLACK_AND_WHITE, atol=2e-5)


def flip_subject() -> tuple[np.ndarray, np.ndarray]:
    """Return two pictures that any program can make alike."""
    row, column = np.mgrid[0:40, 0:56].astype(np.float64)
    waves = [0.5 + 0.4 * np.sin(row / a + column / b) for a, b in ((5, 9), (7, 4), (3, 11))]
    truth = np.stack(waves, axis=-1)
    picture = 0.97 * truth
    picture[10:20, 10:20] = (0.0, 0.0, 1.0)
    picture[30, ::7] = 1.0
    return picture, truth


@pytest.mark.parametrize("row", range(3))
def test_flip_is_that_of_the_reference_program(row):
    # Made with flip_evaluator.evaluate(truth, picture, "LDR", inputsRGB=False, ppd) of PyPI's
    # flip-evaluator 1.7 (NVIDIA), in float32: mean and two pixels.
    pixels_per_degree, mean, square, dot = FLIP_REFERENCE[row]
    found = flip_differences(*flip_subject(), pixels_per_degree)
    assert found.mean() == pytest.approx(mean, abs=2e-5)
    assert found[15, 15] == pytest.approx(square, abs=5e-5)
    assert found[30, 28] == pytest.approx(dot, abs=5e-5)


def test_flip_sees_the_diffuser_as_display_white():
    shown = displayed(np.broadcast_to(3.0 * WHITE, (2, 2, 3)), 3.0 * WHITE, np.ones((2, 2), bool))
    np.testing.assert_allclose(shown, 1.0, atol=1e-12)
    sun = 5.0 * chromaticity_to_xyz((0.45, 0.41))
    half = displayed(np.broadcast_to(0.5 * sun, (1, 1, 3)), sun, np.ones((1, 1), bool))
    np.testing.assert_allclose(half, 0.5, atol=1e-12)


def test_what_is_not_judged_does_not_count_for_flip(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    xyz = np.broadcast_to(0.3 * WHITE, (HEIGHT, WIDTH, 3)).copy()
    xyz[:, :16] *= 3.0
    write_picture(found, xyz)
    result = compare_pictures(truth, found, CompareOptions(select=(FACE,)))
    assert result.statistics("flip")["max"] < 1e-3


# --- Bad input -----------------------------------------------------------------------------------


def _refused(error, match, *arguments):
    with pytest.raises(error, match=match):
        compare_pictures(*arguments)


def test_sizes_that_differ_are_refused(tmp_path):
    truth, _ = grey(tmp_path, 1.0)
    small = write_picture(tmp_path / "small.exr", np.ones((4, 5, 3)), ids=False)
    _refused(ImageError, "5 x 4 pixels, but .* has 32 x 24", truth, small)


def test_pictures_without_colors_are_refused(tmp_path):
    truth, _ = grey(tmp_path, 1.0)
    depth = tmp_path / "depth.exr"
    write_exr(depth, [Part("Z", {"Z": np.ones((HEIGHT, WIDTH), np.float32)})])
    _refused(ImageError, "nothing to compare; .* this one has Z", truth, depth)
    _refused(ImageError, "no such file", truth, tmp_path / "none.exr")


def test_spectra_that_are_no_radiances_are_refused(tmp_path):
    truth, _ = grey(tmp_path, 1.0)
    rgb = np.ones((HEIGHT, WIDTH, 3), np.float32)
    chart, laser = tmp_path / "chart.spectral.exr", tmp_path / "laser.spectral.exr"
    write_spectral_exr(chart, GRID, surfaces().astype(np.float32), rgb, layer="T")
    write_spectral_exr(laser, GRID[30:31], rgb[..., :1], rgb, "relative")
    _refused(ImageError, r"reflectances \(channels T\.\), not radiances", truth, chart)
    _refused(ImageError, "one band is no spectrum", truth, laser)
    png = tmp_path / "shown.png"
    write_png(png, np.full((HEIGHT, WIDTH, 3), 99, np.uint8))
    _refused(ImageError, "write it in a linear space", truth, png)


def test_pixels_that_are_not_finite_are_refused_within_the_mask_alone(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    xyz = np.broadcast_to(0.3 * WHITE, (HEIGHT, WIDTH, 3)).copy()
    xyz[10, 3] = np.nan
    write_picture(found, xyz)
    _refused(
        ImageError, "1 pixels within the mask are not finite, .* column 3, row 10", truth, found
    )
    options = CompareOptions(masks=("luminance:0.1",))
    _refused(ImageError, "not finite", found, truth, options)
    assert compare_pictures(truth, found, CompareOptions(select=(FACE,))).statistics("dE2000")


def test_an_empty_mask_is_refused(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    _refused(ImageError, "holds no pixel", truth, found, CompareOptions(masks=("luminance:2",)))


def test_no_white_is_guessed(tmp_path):
    xyz = np.broadcast_to(0.3 * WHITE, (HEIGHT, WIDTH, 3))
    truth = write_picture(tmp_path / "truth.exr", xyz, irradiance=None)
    _refused(
        UsageError, "no part irradiance, .* --aov irradiance, or give --diffuser", truth, truth
    )
    given = compare_pictures(truth, truth, CompareOptions(diffuser=tuple(WHITE)))
    assert given.white_from == "--diffuser"
    black = write_picture(tmp_path / "black.exr", xyz, irradiance=0.0 * WHITE)
    _refused(UsageError, "black within the mask", black, truth)


def test_a_truth_brighter_than_its_white_is_told(tmp_path):
    xyz = np.broadcast_to(2.0 * WHITE, (HEIGHT, WIDTH, 3))
    truth = write_picture(tmp_path / "truth.exr", xyz)
    notes = compare_pictures(truth, truth).notes
    assert [note.code for note in notes] == ["brighter-than-white"]


def test_units_that_differ_are_refused(tmp_path):
    xyz = np.broadcast_to(0.3 * WHITE, (HEIGHT, WIDTH, 3))
    truth = write_picture(tmp_path / "truth.exr", xyz, units="W.m^-2.sr^-1.nm^-1")
    found = write_picture(tmp_path / "found.exr", xyz)
    _refused(ImageError, "radiance in relative units, but in .* in absolute ones", truth, found)


def test_names_that_nothing_has_are_refused(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    options = CompareOptions(select=("/World/Nose",))
    _refused(
        UsageError, f"nothing of that name is seen; there are {ARMS}, {FACE}", truth, found, options
    )
    options = CompareOptions(regions="crypto_object")
    _refused(
        UsageError, "has no such part; render it with --aov cryptomatte", truth, found, options
    )


def test_masks_of_another_size_are_refused(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    matte = tmp_path / "matte.png"
    write_png(matte, np.full((3, 3, 3), 255, np.uint8))
    options = CompareOptions(masks=(str(matte),))
    _refused(ImageError, "the mask has 3 x 3 pixels, the pictures 32 x 24", truth, found, options)


def test_a_mask_from_a_file_is_where_it_is_white(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    matte = np.zeros((HEIGHT, WIDTH, 3), np.uint8)
    matte[5:9, 6:16] = 255
    write_png(tmp_path / "matte.png", matte)
    options = CompareOptions(masks=(str(tmp_path / "matte.png"), "luminance:0.1"))
    result = compare_pictures(truth, found, options)
    assert result.mask.sum() == 40
    assert result.mask_from == "matte.png and Y >= 0.1 Y_n in the truth"


# --- Maps, bars and the command line -------------------------------------------------------------


def test_maps_hold_every_difference_and_how_it_was_made(tmp_path):
    truth, found = pair(tmp_path, _redder)
    result = compare_pictures(truth, found, CompareOptions(select=(FACE,)))
    exr, png = write_maps(result, tmp_path / "maps")
    assert [path.name for path in (exr, png)] == ["found.difference.exr", "found.difference.png"]
    image = read_image(exr)
    names = dict(zip(image.channel_names, np.moveaxis(image.pixels, -1, 0), strict=True))
    assert set(names) == {"dE2000", "dE76", "dL", "da", "db", "flip", "gfc", "mask", "rmse"}
    np.testing.assert_array_equal(names["mask"], result.mask)
    for name, values in result.maps.items():
        np.testing.assert_allclose(names[name][result.mask], values[result.mask], rtol=1e-6)
        assert (names[name][~result.mask] == 0.0).all()
    assert json.loads(image.attributes["usdskin/comparison"]) == result.as_json()
    assert "usdskin/comparison" in read_headers(png)[0].attributes


def test_equal_comparisons_write_equal_bytes(tmp_path):
    truth, found = pair(tmp_path, _redder)
    first, second = (
        write_maps(compare_pictures(truth, found), tmp_path / name) for name in ("a", "b")
    )
    for one, other in zip(first, second, strict=True):
        assert one.read_bytes() == other.read_bytes()


def test_maps_never_take_the_place_of_a_picture(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    with pytest.raises(UsageError, match="one of the pictures compared"):
        write_maps(compare_pictures(truth, found), found)


def test_bars_are_met_up_to_their_value(tmp_path):
    truth, found = pair(tmp_path, _redder)
    result = compare_pictures(truth, found)
    figures = result.as_json()
    at = {"mean": figures["deltaE2000"]["mean"], "gfc": figures["spectral"]["gfc"]}
    assert all(bar.met for bar in judge_bars(result, at))
    require(result, judge_bars(result, at))
    passed = judge_bars(result, {"mean": 0.9 * at["mean"], "gfc": 0.5 + 0.5 * at["gfc"]})
    assert not any(bar.met for bar in passed)
    with pytest.raises(FindingsError, match=r"dE2000 mean .* is over .*; GFC .* is under "):
        require(result, passed)


def test_command_prints_figures_writes_maps_and_judges(tmp_path, capsys):
    truth, found = grey(tmp_path, 1.03)
    assert main(["compare", str(truth), str(found), "-o", str(tmp_path / "maps")]) == 0
    shown = capsys.readouterr().out
    for text in ("mask   alpha: 768 pixels", "Y_n    1", "white  x 0.37", "dE2000", FACE, "FLIP"):
        assert text in shown
    assert shown.endswith(f"{tmp_path / 'maps' / 'found.difference.png'}\n")
    bars = "mean=0.5,p95=2.5"
    assert main(["compare", str(truth), str(found), "--threshold", bars]) == 4
    said = capsys.readouterr().err
    assert "dE2000 mean 0.6576 is over 0.5" in said and "p95" not in said


def test_command_prints_one_object_for_programs(tmp_path, capsys):
    truth, found = grey(tmp_path, 1.03)
    arguments = ["--json", "compare", str(truth), str(found), "--threshold", "mean=0.5,max=9"]
    assert main(arguments) == 4
    first, error = map(json.loads, capsys.readouterr().out.splitlines())
    assert first["event"] == "comparison" and error["exit_code"] == 4
    assert [(bar["name"], bar["met"]) for bar in first["bars"]] == [("mean", False), ("max", True)]
    assert first["spectral"] is None and first["yN"] == pytest.approx(1.0, rel=1e-5)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--threshold", "mean"], 2, "is not NAME=NUMBER"),
        (["--threshold", "average=1"], 2, "no such figure; choose from mean"),
        (["--threshold", "gfc=0.9"], 2, "not both pictures have spectra"),
        (["--diffuser", "1,2"], 2, "not three numbers"),
        (["--diffuser", "1,2,-3"], 2, "positive numbers"),
        (["-o", "maps.jpg"], 2, "give a folder, or a name that ends in .exr or .png"),
        (["--mask", "nowhere.png"], 3, "nowhere.png: cannot read; no such file"),
        (["--mask", "luminance:many"], 2, "a number from 0 on"),
        (["--mask", "luminance:"], 2, "a number from 0 on"),
        (["--mask", ""], 2, "give alpha, all, luminance:SHARE or the name of a picture"),
        (["--ppd", "nan"], 2, "1 to 500 pixels per degree"),
    ],
)
def test_wrong_options_are_told_in_one_line(tmp_path, capsys, arguments, code, message):
    truth, found = grey(tmp_path, 1.0)
    assert main(["compare", str(truth), str(found), *arguments]) == code
    said = capsys.readouterr().err
    assert message in said and said.count("\n") == 1


def test_heat_map_shows_the_scale_beyond_it_and_what_is_not_judged(tmp_path):
    truth, found = grey(tmp_path, 1.0)
    xyz = np.broadcast_to(0.3 * WHITE, (HEIGHT, WIDTH, 3)).copy()
    xyz[4:, 16:] *= 1.02
    xyz[23, 31] *= 3.0
    write_picture(found, xyz)
    result = compare_pictures(truth, found, CompareOptions(select=(ARMS, FACE)))
    (png,) = write_maps(result, tmp_path / "map.png")
    page = (read_image(png).pixels[..., :3] * 255.0).round()
    colors = {tuple(color) for color in page.reshape(-1, 3).astype(int)}
    assert {(255, 0, 200), (205, 205, 205), (68, 1, 84)} <= colors  # over, outside, viridis' zero


# --- End to end ----------------------------------------------------------------------------------


@pytest.mark.slow
def test_renders_of_two_skins_differ_where_the_skin_does(tmp_path, capsys):
    stage = Path(__file__).resolve().parents[1] / "stages/skin_tones/skin_tones.usda"
    parts = "irradiance,primId,cryptomatte"
    changed = "/World/Materials/Tone1.inputs:skin:wrap=0.6"
    paths = [str(tmp_path / name) for name in ("truth.exr", "found.exr")]
    common = ["-q", "render", str(stage), "-w", "96", "--spectral"]
    assert main([*common[:3], paths[0], *common[3:], "--aov", parts]) == 0
    assert main([*common[:3], paths[1], *common[3:], "--set", changed]) == 0
    capsys.readouterr()
    assert main(["--json", "compare", *paths, "--regions", "crypto_material"]) == 0
    regions = json.loads(capsys.readouterr().out)["regions"]
    means = {region["name"].rpartition("/")[2]: region["deltaE2000"]["mean"] for region in regions}
    assert means.pop("Tone1") > 0.5
    assert max(means.values()) < 0.02
