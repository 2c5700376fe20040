"""Figures of skin: what is drawn is what the layer says, whole and legible."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from click.testing import CliRunner
from figure_texts import texts, texts_outside
from pxr import Usd, UsdGeom, UsdLux, UsdShade

from usdskin.colorimetry import color_matching_functions
from usdskin.commands.plot import plot
from usdskin.commands.reporter import GlobalOptions
from usdskin.errors import LayerError, UsageError
from usdskin.estimate.skin.lobe import Lobe
from usdskin.estimate.skin.model import Coefficients, Freedom, SkinModel
from usdskin.estimate.skin.readings import readings_from_angles
from usdskin.estimate.skin.step import SkinOptions, estimate_skin
from usdskin.illuminants import illuminant
from usdskin.layers import write_layer
from usdskin.plots.entries import with_error
from usdskin.plots.figures import save_figure
from usdskin.plots.skin import DrawnSkin, draw_skin
from usdskin.plots.skin_color import reflected, typology_angle
from usdskin.plots.skin_fit import DrawnFit, fitted_curve, shown_columns
from usdskin.plots.skins import read_drawn_skin
from usdskin.plots.step import PlotOptions, plot_file
from usdskin.prims import (
    SkinFitRecord,
    SkinParameters,
    SkinSamples,
    SpectralLight,
    write_skin,
    write_skin_fit,
    write_skin_samples,
    write_spectral_light,
)
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as GRID
from usdskin.spectrum import SpectralQuantity, Spectrum

WRAP = 0.35


# Made up by hand: a smooth skin with a dip where blood absorbs, wrap light that reddens.


def _skin(**changes) -> SkinParameters:
    rise = 0.16 + 0.42 / (1.0 + np.exp(-(GRID - 590.0) / 22.0)) + 0.0006 * (GRID - 400.0)
    dips = sum(0.05 * np.exp(-0.5 * ((GRID - center) / 10.0) ** 2) for center in (542.0, 577.0))
    values = {
        "reflectance": Spectrum(SpectralQuantity.REFLECTANCE, GRID, rise - dips),
        "scattering": Spectrum(SpectralQuantity.SCATTERING, GRID, 0.1 + 0.0012 * (GRID - 400.0)),
        "wrap": WRAP,
    }
    skin = SkinParameters(**{**values, **changes})
    if skin.scattering is None or "alpha" in changes:
        return skin
    luminous = color_matching_functions(GRID)[:, 1]
    mean = float(luminous @ skin.scattering.resample(GRID) / luminous.sum())
    return replace(skin, alpha=1.0 / (1.0 + mean))


def _relative(value: float) -> Spectrum:
    return Spectrum(SpectralQuantity.RELATIVE, GRID, np.full(len(GRID), value))


def _fitted(skin: SkinParameters, columns: list[int], names: list[str], count: int = 24, **changes):
    """Return the record and the readings of a fit whose truth is the skin itself."""
    random = np.random.default_rng(5)
    lambert = skin.alpha * skin.reflectance.value[columns]
    wrapped = lambert * skin.scattering.value[columns]
    theta_i = np.linspace(0.0, 125.0, count)
    cosine = np.cos(np.radians(theta_i))[:, None]
    body = lambert * np.maximum(cosine, 0.0)
    body = body + wrapped * np.maximum((cosine + skin.wrap) / (1.0 + skin.wrap), 0.0)
    values = body * random.normal(1.0, 0.01, body.shape) + random.normal(0.0, 0.001, body.shape)
    mask = np.ones(count, bool)
    mask[[3, count // 2]] = False
    values[3] *= 1.25
    parameters = ("wrap", *(f"A[{name}]" for name in names), *(f"B[{name}]" for name in names))
    covariance = np.diag([0.006**2, *(0.004 * lambert) ** 2, *(0.02 * wrapped) ** 2])
    record = SkinFitRecord(
        "luminousMean", parameters, np.concatenate([[skin.wrap], lambert, wrapped]), covariance,
        wrap_stddev=0.006, alpha_stddev=0.0041, residual=0.0085, reach_deg=125.0,
        needed_reach_deg=120.5, reflectance_stddev=_relative(0.01),
        scattering_stddev=_relative(0.02),
    )  # fmt: skip
    wavelength_nm = GRID[columns] if names[0] != "R" else None
    samples = SkinSamples(theta_i=theta_i, values=values, wavelength_nm=wavelength_nm, mask=mask)
    return replace(record, **changes), samples


def _spectral(count: int = 24, **changes):
    skin = _skin()
    return skin, *_fitted(skin, list(range(61)), [f"{nm:g}" for nm in GRID], count, **changes)


def _rgb(count: int = 24, **changes):
    skin = _skin()
    return skin, *_fitted(skin, [42, 28, 10], ["R", "G", "B"], count, **changes)


def _layer(path: Path, skin, record=None, samples=None) -> Path:
    stage = Usd.Stage.CreateInMemory(path.name)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = UsdShade.Material.Define(stage, "/Skin").GetPrim()
    stage.SetDefaultPrim(prim)
    write_skin(prim, skin)
    if record is not None:
        write_skin_fit(prim, record)
    if samples is not None:
        write_skin_samples(UsdGeom.Scope.Define(stage, "/Fit").GetPrim(), samples)
    return write_layer(stage, path)


def _read(path: Path, notes=None) -> DrawnSkin:
    stage = Usd.Stage.Open(str(path))
    return read_drawn_skin(stage.GetDefaultPrim(), notes)


def _axes(figure, title: str):
    """Return the first axes that are titled so."""
    return next(axes for axes in figure.axes if axes.get_title(loc="left").strip() == title)


def _line(axes, label: str):
    return next(line for line in axes.get_lines() if line.get_label() == label)


def _glossy():
    """Return a skin, and readings that are exactly what its model says, seen from all around."""
    skin = _skin(specular_weight=0.7, roughness1=0.5, roughness2=0.25, mix=0.3)
    record, samples = _fitted(skin, [42, 28, 10], ["R", "G", "B"], 60)
    random = np.random.default_rng(7)
    theta_r, azimuth = random.uniform(0.0, 70.0, 60), random.uniform(-180.0, 180.0, 60)
    readings = readings_from_angles(samples.theta_i, theta_r, azimuth, samples.values)
    lobe = Lobe(0.7, 0.5, 0.25, 0.3)
    at = Coefficients(WRAP, record.values[1:4], record.values[4:7], lobe)
    values = SkinModel(readings, Freedom()).values(at)
    names = ("specular:weight", "specular:roughness1", "specular:roughness2", "specular:mix")
    covariance = np.zeros((11, 11))
    covariance[:7, :7] = record.covariance
    covariance[7:, 7:] = 1e-4 * np.eye(4)
    record = replace(
        record, parameters=(*record.parameters, *names), covariance=covariance,
        values=np.concatenate([record.values, [0.7, 0.5, 0.25, 0.3]]),
    )  # fmt: skip
    samples = replace(samples, theta_r=theta_r, azimuth=azimuth, values=values, mask=None)
    return skin, record, samples


# Closed forms


@pytest.mark.parametrize(
    ("lab", "angle_deg"), [((60.0, 7.0, 10.0), 45.0), ((50.0, 9.0, 15.0), 0.0),
                           ((40.0, 5.0, 10.0), -45.0)]
)  # fmt: skip
def test_the_typology_angle_is_that_of_lightness_above_50_over_yellowness(lab, angle_deg):
    assert typology_angle(lab) == pytest.approx(angle_deg)


def test_facing_the_light_a_skin_of_flat_scattering_reflects_its_s():
    """The convention makes alpha 1/(1 + Ss), so that A + B is S."""
    flat = Spectrum(SpectralQuantity.SCATTERING, GRID, np.full(61, 0.4))
    skin = _skin(scattering=flat)
    np.testing.assert_allclose(reflected(skin, [1.0])[0], skin.reflectance.value, rtol=1e-12)


def test_on_the_shadow_line_only_the_wrap_term_is_left_and_beyond_it_goes_nothing():
    skin = _skin()
    there, beyond = reflected(skin, [0.0, -WRAP - 1e-9])
    wrapped = skin.alpha * skin.reflectance.value * skin.scattering.value
    np.testing.assert_allclose(there, wrapped * WRAP / (1.0 + WRAP), rtol=1e-12)
    np.testing.assert_array_equal(beyond, 0.0)
    energy = reflected(replace(skin, wrap_normalization="energy"), [0.0])[0]
    np.testing.assert_allclose(energy, there / (1.0 + WRAP), rtol=1e-12)


def test_only_light_from_behind_is_attenuated_by_the_body():
    skin = _skin()
    thick = replace(skin, opacity=500.0, thickness=0.002)
    before, behind = reflected(thick, [0.2, -0.2]) / reflected(skin, [0.2, -0.2])
    np.testing.assert_allclose(before, 1.0)
    np.testing.assert_allclose(behind, np.exp(-1.0))


def test_the_error_of_the_curve_is_the_spread_of_curves_drawn_from_the_covariance():
    random = np.random.default_rng(11)
    root = 1e-3 * random.normal(size=(3, 3))
    covariance = root @ root.T
    fit = DrawnFit(
        ("R",), np.zeros(1), np.ones((1, 1)), np.ones((1, 1)), np.ones((1, 1)), np.ones(1, bool),
        WRAP, np.array([0.3]), np.array([0.1]), covariance,
    )  # fmt: skip
    theta_deg = np.array([0.0, 45.0, 80.0, 95.0, 105.0])
    draws = random.multivariate_normal([WRAP, 0.3, 0.1], covariance, 5_000)
    curves = [
        fitted_curve(replace(fit, wrap=wrap, lambert=np.array([a]), wrapped=np.array([b])),
                     0, theta_deg)[0]
        for wrap, a, b in draws
    ]  # fmt: skip
    deviation = fitted_curve(fit, 0, theta_deg)[1]
    np.testing.assert_allclose(deviation, np.std(curves, axis=0), rtol=0.05)


def test_a_value_is_written_to_the_digits_that_its_error_leaves():
    assert with_error(0.31234, 0.0061) == "0.3123 ± 0.0061"
    assert with_error(12.34, 1.26, "mm") == "12.3 ± 1.3 mm"
    assert with_error(0.25, None) == with_error(0.25, np.inf) == "0.25"


def test_of_many_bands_four_are_shown_and_of_channels_all():
    assert shown_columns(3) == [0, 1, 2]
    assert shown_columns(4) == [0, 1, 2, 3]
    assert shown_columns(61) == [8, 22, 38, 52]


# What is drawn


def test_spectra_are_those_of_the_layer_with_two_deviations_to_each_side(tmp_path):
    skin, record, samples = _spectral()
    drawn = _read(_layer(tmp_path / "skin.usda", skin, record, samples))
    figure = draw_skin(drawn, [], what=["spectra"])
    for title, spectrum, name, deviation in (
        ("Reflectance S", skin.reflectance, "S", 0.01),
        ("Scattering Ss", skin.scattering, "Ss", 0.02),
    ):
        axes = _axes(figure, title)
        np.testing.assert_allclose(_line(axes, name).get_ydata(), spectrum.value)
        corners = axes.collections[0].get_paths()[0].vertices
        at = corners[np.isclose(corners[:, 0], 550.0), 1]
        middle = spectrum.value[GRID == 550.0][0]
        ends = [middle - 2.0 * deviation, middle + 2.0 * deviation]
        np.testing.assert_allclose(sorted(set(np.round(at, 9))), ends, atol=1e-8)


def test_readings_are_drawn_where_they_are_and_those_left_out_as_crosses(tmp_path):
    skin, record, samples = _rgb()
    drawn = _read(_layer(tmp_path / "skin.usda", skin, record, samples))
    axes = _axes(draw_skin(drawn, [], what=["fit"]), "G")
    reading, left_out = _line(axes, "reading"), _line(axes, "left out")
    np.testing.assert_allclose(reading.get_xdata(), samples.theta_i[samples.mask], atol=1e-9)
    np.testing.assert_allclose(reading.get_ydata(), samples.values[samples.mask, 1])
    assert (reading.get_marker(), left_out.get_marker()) == ("o", "x")
    assert len(left_out.get_xdata()) == 1  # the other is beyond the panel, and shown at its edge
    assert any(line.get_marker() == "^" for line in axes.get_lines())


def test_the_curve_is_the_model_and_the_two_angles_are_marked(tmp_path):
    skin, record, samples = _rgb()
    drawn = _read(_layer(tmp_path / "skin.usda", skin, record, samples))
    axes = _axes(draw_skin(drawn, [], what=["fit"]), "R")
    theta_deg, curve = _line(axes, "fitted").get_data()
    at = np.interp([0.0, 90.0], theta_deg, curve)
    a, b = record.values[1], record.values[4]
    np.testing.assert_allclose(at, [a + b, b * WRAP / (1.0 + WRAP)], rtol=1e-6)
    dark_deg = np.degrees(np.arccos(-WRAP))
    assert _line(axes, "90°").get_xdata()[0] == 90.0
    assert _line(axes, f"acos(-l) {dark_deg:.1f}°").get_xdata()[0] == pytest.approx(dark_deg)


def test_readings_with_lustre_and_a_body_are_met_by_the_model_that_was_fitted(tmp_path):
    """The layer keeps angles and the numbers of the fit: they give back the model's readings."""
    skin, record, samples = _glossy()
    thickness = np.where(samples.theta_i > 90.0, 0.001, 0.0)
    delta = np.array([300.0, 900.0, 2000.0])
    samples = replace(samples, thickness=thickness,
                      values=samples.values * np.exp(-thickness[:, None] * delta))  # fmt: skip
    names = (*record.parameters[:7], "delta[R]", "delta[G]", "delta[B]", *record.parameters[7:])
    values = np.concatenate([record.values[:7], delta, record.values[7:]])
    record = replace(record, parameters=names, values=values, covariance=np.zeros((14, 14)))
    fit = _read(_layer(tmp_path / "skin.usda", skin, record, samples)).fit
    assert fit.beyond == "lustre and attenuation"
    np.testing.assert_allclose(fit.predicted, samples.values, atol=1e-6)


def test_deviations_are_such_that_the_residuals_used_have_one(tmp_path):
    skin, record, samples = _rgb(400)
    fit = _read(_layer(tmp_path / "skin.usda", skin, record, samples)).fit
    scaled = ((fit.values - fit.predicted) / fit.sigma)[fit.used]
    assert np.sqrt((scaled**2).mean()) == pytest.approx(1.0)


def test_what_readings_do_not_tell_has_no_band(tmp_path):
    skin, record, samples = _rgb()
    unknown = record.covariance.copy()
    unknown[0, 0] = np.finfo(float).max  # as the step writes it
    record = replace(record, covariance=unknown)
    drawn = _read(_layer(tmp_path / "skin.usda", skin, record, samples))
    assert not _axes(draw_skin(drawn, [], what=["fit"]), "R").collections


def test_swatches_say_the_color_of_the_patch_and_its_typology_angle(tmp_path):
    """A grey of Y = 18.42 % has L* = 50 in every light; so its angle is 0."""
    grey = Spectrum(SpectralQuantity.REFLECTANCE, GRID, np.full(61, 0.184187))
    figure = draw_skin(DrawnSkin("s.usda </S>", "", SkinParameters(reflectance=grey)), [],
                       what=["color"])  # fmt: skip
    written = [text for text in texts(figure) if text.startswith("L*")]
    assert len(written) == 3
    assert all(text.startswith("L* 50.0   a* ") for text in written)
    assert ["ITA" in text for text in written] == [True, False, False]
    facing = _axes(figure, "A").patches[0].get_facecolor()
    np.testing.assert_allclose(facing[:3], 0.466, atol=0.002)  # sRGB of 18.42 %


def test_the_summary_says_what_was_found_and_how_sure_it_is(tmp_path):
    drawn = _read(_layer(tmp_path / "skin.usda", *_glossy()))
    written = texts(draw_skin(drawn, [], what=["summary"]))
    for words in ("0.3500 ± 0.0060", "0.85 % of the peak", "125.0°; 120.5° needed", "60 of 60",
                  "0.700 ± 0.010"):  # fmt: skip
        assert words in written


# Skins that were not fitted, and layers that lack something


def test_a_skin_that_was_not_fitted_is_drawn_without_a_word_about_it(tmp_path):
    """As those of a library: split by the convention, and that is all."""
    notes: list = []
    drawn = _read(_layer(tmp_path / "skin.usda", _skin(), SkinFitRecord("luminousMean")))
    figure = draw_skin(drawn, notes)
    assert notes == []
    assert "Skin" in texts(figure)
    assert {"Reflectance S", "Scattering Ss", "D65"} <= set(texts(figure))
    with pytest.raises(LayerError, match=r"</Skin>: has no fit \(fit:parameters\)"):
        draw_skin(drawn, what=["fit"])


def test_a_fit_without_its_readings_is_drawn_as_far_as_it_goes_and_says_so(tmp_path):
    skin, record, _samples = _rgb()
    notes: list = []
    draw_skin(_read(_layer(tmp_path / "skin.usda", skin, record)), notes)
    assert [note.message.split(":")[0] for note in notes] == ["fit not drawn"]
    assert notes[0].code == "plot-left-out"


def test_a_skin_whose_reflectance_is_in_a_texture_has_no_color_of_its_own():
    notes: list = []
    skin = _skin(reflectance=None, albedo_file=Path("albedo.png"))
    figure = draw_skin(DrawnSkin("s.usda </S>", "", skin), notes)
    assert [note.message.split(":")[0] for note in notes] == ["color not drawn"]
    assert "S is in a texture, and not shown" in texts(figure)


def test_an_opacity_is_drawn_per_millimetre_and_a_constant_one_as_a_line():
    falling = Spectrum(SpectralQuantity.ABSORPTION, GRID, np.linspace(4000.0, 500.0, 61))
    for opacity, first in ((falling, 4.0), (250.0, 0.25)):
        drawn = DrawnSkin("s.usda </S>", "", _skin(opacity=opacity))
        axes = _axes(draw_skin(drawn, [], what=["spectra"]), "Opacity δ")
        assert _line(axes, "delta").get_ydata()[0] == pytest.approx(first)
        assert axes.get_ylabel() == "attenuation [mm$^{-1}$]"


def test_the_chosen_variants_are_drawn_and_named(tmp_path):
    stage = Usd.Stage.Open(str(_layer(tmp_path / "skin.usda", _skin())))
    prim = stage.GetDefaultPrim()
    tones = prim.GetVariantSets().AddVariantSet("tone")
    for name, wrap in (("light", 0.2), ("dark", 0.4)):
        tones.AddVariant(name)
        tones.SetVariantSelection(name)
        with tones.GetVariantEditContext():
            prim.GetAttribute("inputs:skin:wrap").Clear()
            prim.GetAttribute("inputs:skin:wrap").Set(wrap)
    stage.SetEditTarget(stage.GetRootLayer())
    prim.GetAttribute("inputs:skin:wrap").Clear()
    drawn = read_drawn_skin(prim)
    assert (drawn.name, drawn.skin.wrap) == ("/Skin, tone dark", pytest.approx(0.4))


def test_readings_that_are_not_those_of_the_fit_are_refused(tmp_path):
    skin, record, _samples = _rgb()
    other = _spectral()[2]
    path = _layer(tmp_path / "skin.usda", skin, record, other)
    with pytest.raises(LayerError, match="has 61 values per reading, but fit:parameters name 3 of"):
        _read(path)


# Legible


@pytest.mark.parametrize(
    "build",
    [
        _spectral,
        lambda: _rgb(2000),
        _glossy,
        lambda: (_skin(opacity=900.0, thickness=0.002, specular_weight=0.5, mix=0.0),),
        lambda: (_skin(wrap=1.0), *_fitted(_skin(wrap=1.0), [42, 28, 10], ["R", "G", "B"])),
        lambda: (_skin(), *_fitted(_skin(), [30], ["550"])),
    ],
    ids=["61 bands", "2000 readings", "lustre", "not fitted", "l is 1", "one band"],
)
def test_no_text_leaves_the_page(tmp_path, build):
    name = "a_skin_of_somebody_with_a_rather_long_name_measured_in_the_laboratory_twice.usda"
    drawn = _read(_layer(tmp_path / name, *build()))
    assert texts_outside(draw_skin(drawn, [])) == []


@pytest.mark.filterwarnings("error")
def test_the_panels_keep_their_size_where_all_that_is_left_out_lies_beyond_them(tmp_path):
    skin, record, samples = _rgb()
    mask = np.ones(len(samples.theta_i), bool)
    mask[3] = False  # far above the rest
    drawn = _read(_layer(tmp_path / "skin.usda", skin, record, replace(samples, mask=mask)))
    figure = draw_skin(drawn, [], what=["fit"])
    assert texts_outside(figure) == []
    assert _axes(figure, "G").get_position().width > 0.2


@pytest.mark.parametrize("what", ["spectra", "color", "fit", "summary"])
def test_no_text_leaves_the_page_where_one_part_stands_alone(tmp_path, what):
    drawn = _read(_layer(tmp_path / "skin.usda", *_rgb()))
    assert texts_outside(draw_skin(drawn, [], what=[what])) == []


def test_every_axis_says_what_it_is_and_in_which_unit(tmp_path):
    drawn = _read(_layer(tmp_path / "skin.usda", *_rgb()))
    written = texts(draw_skin(drawn, []))
    assert written.count("wavelength [nm]") == 2
    for label in ("reflectance [1]", "residual [σ]", "angle between normal and light [deg]"):
        assert label in written


# Layers and the command


def test_the_same_layer_gives_the_same_bytes_by_the_step_and_by_hand(tmp_path):
    path = _layer(tmp_path / "skin.usda", *_rgb())
    drawn = plot_file(path, tmp_path / "a.png", notes=[])
    expected = save_figure(draw_skin(_read(path), []), tmp_path / "b.png")
    assert drawn.read_bytes() == expected.read_bytes()


def test_the_command_draws_a_skin_and_prints_the_file(tmp_path):
    path, output = _layer(tmp_path / "skin.usda", *_rgb()), tmp_path / "skin.png"
    arguments = [str(path), "-o", str(output), "--what", "color,summary"]
    result = CliRunner().invoke(plot, arguments, obj=GlobalOptions(), catch_exceptions=False)
    assert result.exit_code == 0
    assert result.output.strip() == str(output)
    assert output.stat().st_size > 10_000


def test_the_figure_of_an_estimate_shows_the_fit_that_the_step_made(tmp_path):
    """Through the layer and back: the same model at the same readings, and the same sigmas."""
    _skin_of, _record, samples = _glossy()
    noisy = samples.values * np.random.default_rng(3).normal(1.0, 0.01, samples.values.shape)
    bands = np.array([450.0, 550.0, 650.0])
    stage = Usd.Stage.CreateInMemory("samples.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = UsdGeom.Scope.Define(stage, "/Samples").GetPrim()
    write_skin_samples(prim, replace(samples, values=noisy, wavelength_nm=bands))
    write_layer(stage, tmp_path / "samples.usda")
    options = SkinOptions(specular="fit")
    made = estimate_skin(tmp_path / "samples.usda", tmp_path / "skin.usda", options).fit
    drawn = _read(tmp_path / "skin.usda").fit
    assert drawn.names == ("450 nm", "550 nm", "650 nm")
    np.testing.assert_allclose(drawn.predicted, made.predicted, atol=1e-7)
    np.testing.assert_array_equal(drawn.used, made.used)
    np.testing.assert_allclose(drawn.sigma, made.sigma, rtol=0.1)
    notes: list = []
    plot_file(tmp_path / "skin.usda", tmp_path / "skin.png", notes=notes)
    assert notes == []


def _with_light(stage) -> None:
    dome = UsdLux.DomeLight.Define(stage, "/Light").GetPrim()
    emission = Spectrum(SpectralQuantity.RADIANCE, GRID, illuminant("D65", GRID))
    write_spectral_light(dome, SpectralLight(source="tabulated", emission=emission))


def test_the_default_prim_says_whether_a_layer_is_drawn_as_a_skin_or_as_a_light(tmp_path):
    stage = Usd.Stage.Open(str(_layer(tmp_path / "skin.usda", _skin())))
    _with_light(stage)
    stage.GetRootLayer().Save()
    plot_file(tmp_path / "skin.usda", tmp_path / "a.png", PlotOptions(what=("color",)))
    stage.ClearDefaultPrim()
    stage.GetRootLayer().Save()
    with pytest.raises(UsageError, match="--what color: the figure of a light shows"):
        plot_file(tmp_path / "skin.usda", tmp_path / "b.png", PlotOptions(what=("color",)))


def test_of_several_skins_none_is_drawn_by_chance(tmp_path):
    stage = Usd.Stage.Open(str(_layer(tmp_path / "skins.usda", _skin())))
    write_skin(UsdShade.Material.Define(stage, "/Other").GetPrim(), _skin())
    stage.ClearDefaultPrim()
    stage.GetRootLayer().Save()
    with pytest.raises(LayerError, match=r"several materials have SkinMaterialAPI \(</Skin>, </Ot"):
        plot_file(tmp_path / "skins.usda", tmp_path / "a.png")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (PlotOptions(what=("errors",)), "--what errors: the figure of a skin shows spectra, color"),
        (PlotOptions(patches=("red",)), "--patches: chooses what the figure of a camera shows"),
        (PlotOptions(classes=("sun",)), "--class: chooses what the figure of a camera shows"),
    ],
)
def test_an_option_that_does_not_fit_is_refused(tmp_path, options, message):
    path = _layer(tmp_path / "skin.usda", *_rgb())
    with pytest.raises(UsageError, match=message):
        plot_file(path, tmp_path / "a.svg", options)
    assert not (tmp_path / "a.svg").exists()


def test_drawing_leaves_matplotlibs_settings_as_they_were():
    with matplotlib.rc_context({"lines.linewidth": 9.0}):
        before = dict(matplotlib.rcParams)
        draw_skin(DrawnSkin("s.usda </S>", "", _skin()), [])
        assert dict(matplotlib.rcParams) == before
