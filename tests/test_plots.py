"""Figures: what is drawn is what was measured, whole, legible, and the same every time."""

from __future__ import annotations

import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from dataclasses import replace
from pathlib import Path

import matplotlib
import numpy as np
import pytest
from click.testing import CliRunner
from figure_texts import texts_outside
from pxr import Usd, UsdGeom, UsdLux

from usdskin.colorimetry import xyz_weights
from usdskin.commands.plot import plot
from usdskin.commands.reporter import GlobalOptions
from usdskin.errors import LayerError, UsageError, UsdSkinError
from usdskin.illuminants import illuminant
from usdskin.images import Part, write_exr, write_png
from usdskin.latlong import texel_solid_angles
from usdskin.layers import write_layer
from usdskin.plots.appearance import (
    display_colors,
    planckian_chromaticity,
    signal_chromaticity,
    spectral_locus,
)
from usdskin.plots.camera import draw_camera
from usdskin.plots.chart import ChartSpectra, draw_chart
from usdskin.plots.figures import save_figure
from usdskin.plots.light import LightSpectra, draw_light
from usdskin.plots.lights import read_light_spectra
from usdskin.plots.patches import choose_patches
from usdskin.plots.spectra import radiance_scale
from usdskin.plots.step import PlotOptions, plot_file
from usdskin.prims import (
    ColorChart,
    LightEstimate,
    Recovery,
    SpectralCamera,
    SpectralLight,
    write_color_chart,
    write_light_estimate,
    write_spectral_camera,
    write_spectral_light,
)
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as GRID
from usdskin.spectrum import SpectralQuantity, Spectrum

CLASSIC = (
    "dark skin", "light skin", "blue sky", "foliage", "blue flower", "bluish green", "orange",
    "purplish blue", "moderate red", "purple", "yellow green", "orange yellow", "blue", "green",
    "red", "yellow", "magenta", "cyan", "white 9.5 (.05 D)", "neutral 8 (.23 D)",
    "neutral 6.5 (.44 D)", "neutral 5 (.70 D)", "neutral 3.5 (1.05 D)", "black 2 (1.5 D)",
)  # fmt: skip
SG = tuple(f"{column}{row}" for column in "ABCDEFGHIJKLMN" for row in range(1, 11))


# Made up by hand: smooth surfaces, bell-shaped sensitivities.


def _bell(center_nm: float, width_nm: float) -> np.ndarray:
    return np.exp(-0.5 * ((GRID - center_nm) / width_nm) ** 2)


def _training(light_class: str, lamp: str, names: tuple[str, ...], **changes):
    """Return a recovery and the chart it was made from."""
    random = np.random.default_rng(len(names))
    light = 3e-4 * illuminant(lamp, GRID)
    heights = random.uniform(0.03, 0.9, (len(names), 6))
    knots = np.linspace(GRID[0], GRID[-1], 6)
    signals = np.array([np.interp(GRID, knots, row) for row in heights]) * light
    values = signals @ RESPONSE * random.normal(1.0, 0.01, (len(names), 3))
    matrix = np.linalg.lstsq(values, signals, rcond=None)[0].T.copy()
    error = random.uniform(0.2, 3.0, len(names))
    recovery = Recovery(
        light_class, matrix, "regression", light, 12.0, 0.01, 0.99, 0.01, 1.2, 0.002,
        patches=names, patch_gfc=1.0 - 0.004 * error, patch_rmse=0.01 * error,
        patch_delta_e_2000=error,
    )  # fmt: skip
    chart = ColorChart(
        light_class=light_class, patches=names, camera_values=values, wavelength_nm=GRID,
        signals=signals, illuminant=Spectrum(SpectralQuantity.RADIANCE, GRID, light),
        units="absolute",
    )  # fmt: skip
    return replace(recovery, **changes), chart


RESPONSE = 5.0 * np.stack([_bell(600.0, 40.0), _bell(540.0, 40.0), _bell(455.0, 25.0)], axis=1)


def _camera(*classes: tuple, names: tuple[str, ...] = CLASSIC, **changes) -> SpectralCamera:
    classes = classes or (("tubes", "FL2"),)
    trained = [_training(*item, names, **changes) for item in classes]
    return SpectralCamera(
        "camera.usda </Camera>", GRID, RESPONSE, np.array([0.01, 0.009, 0.012]),
        tuple(recovery for recovery, _ in trained), "absolute", "Model X", "8 mm", "", None,
        tuple(chart for _, chart in trained),
    )  # fmt: skip


WIENER = {
    "estimator": "wiener",
    "posterior_stddev": 2e-4 * np.ones(len(GRID)),
    "grey_delta_e": 0.62,
    "skin_delta_e": 0.41,
}


def _axes(figure, title: str):
    """Return the axes that are titled so."""
    return next(axes for axes in figure.axes if axes.get_title(loc="left").strip() == title)


def _line(axes, label: str):
    return next(line for line in axes.get_lines() if line.get_label() == label)


def _light_layer(path, *, estimate: LightEstimate | None = None, rendition: bool = True):
    """Write a basis light of two classes; return its coefficients and basis."""
    random = np.random.default_rng(3)
    coefficients = random.uniform(0.0, 2.0, (32, 64, 6)).astype(np.float32)
    lamps = [1e-4 * illuminant(name, GRID) for name in ("FL2", "D65")]
    basis = np.concatenate([lamp * np.stack([_bell(c, 60.0) for c in (610, 540, 450)])
                            for lamp in lamps])  # fmt: skip
    channels = {f"c{index}": coefficients[..., index] for index in range(6)}
    write_exr(path.with_name("light.coefficients.exr"), [Part("", channels)])
    pixels = coefficients[..., :3]
    write_exr(path.with_name("light.rgb.exr"),
              [Part("", {"": pixels}, {}, "float", "lin_rec709_scene")])  # fmt: skip
    stage = Usd.Stage.CreateInMemory("light.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    dome = UsdLux.DomeLight.Define(stage, "/Light")
    stage.SetDefaultPrim(dome.GetPrim())
    if rendition:
        dome.CreateTextureFileAttr("./light.rgb.exr")
    light = SpectralLight(
        source="basis", coefficients_file=path.with_name("light.coefficients.exr"), basis=basis,
        basis_wavelength_nm=GRID, units="absolute",
    )  # fmt: skip
    write_spectral_light(dome.GetPrim(), light, path.parent)
    if estimate is not None:
        write_light_estimate(dome.GetPrim(), estimate)
    write_layer(stage, path)
    return coefficients, basis


def _open_light(path):
    stage = Usd.Stage.Open(str(path))
    return stage, stage.GetDefaultPrim()


# Outside values


def test_chromaticities_of_the_standard_illuminants_are_the_published_ones():
    """CIE 015:2018, table T.3: D65 (0.1978, 0.4683), A (0.2560, 0.5243)."""
    grid = np.arange(380.0, 781.0, 5.0)
    for name, published in (("D65", (0.1978, 0.4683)), ("A", (0.2560, 0.5243))):
        found = signal_chromaticity(illuminant(name, grid), grid)
        np.testing.assert_allclose(found, published, atol=1e-4)


def test_illuminant_a_lies_on_the_planckian_locus_at_2856_kelvin():
    grid = np.arange(380.0, 781.0, 5.0)
    body = planckian_chromaticity([2855.5])[0]
    np.testing.assert_allclose(body, signal_chromaticity(illuminant("A", grid), grid), atol=2e-5)


def test_the_spectral_locus_passes_through_the_published_chromaticity_of_520_nm():
    """CIE 015:2018: x = 0.0743, y = 0.8338, so u' = 4x / (-2x + 12y + 3)."""
    wavelength_nm, locus = spectral_locus()
    x, y = 0.0743, 0.8338
    expected = np.array([4.0 * x, 9.0 * y]) / (-2.0 * x + 12.0 * y + 3.0)
    np.testing.assert_allclose(locus[wavelength_nm == 520.0][0], expected, atol=1e-4)


@pytest.mark.parametrize("lamp", ["A", "FL2", "D65"])
def test_a_perfect_diffuser_is_shown_white_in_every_light_and_a_grey_neutral(lamp):
    light = illuminant(lamp, GRID)
    white, grey = display_colors(np.stack([light, 0.2 * light]), light, GRID)
    np.testing.assert_allclose(white, 1.0, atol=1e-6)
    np.testing.assert_allclose(grey, grey[0], atol=1e-6)
    np.testing.assert_allclose(grey[0], 1.055 * 0.2 ** (1 / 2.4) - 0.055, atol=1e-6)


def test_radiances_are_labelled_in_the_prefix_that_suits_them():
    assert radiance_scale(0.01, "absolute")[0] == 1e-3
    assert "mW m$^{-2}$ sr$^{-1}$ nm$^{-1}$" in radiance_scale(0.01, "absolute")[1]
    assert radiance_scale(2.0, "absolute")[0] == 1.0
    assert radiance_scale(8.0, "relative") == (8.0, "relative radiance")


# What is drawn


def test_measured_spectra_are_dashed_and_estimated_ones_solid_and_are_those_of_the_layer():
    camera = _camera()
    figure = draw_camera(camera, [], what=["spectra"], patches=["Light Skin", "red"])
    for name in ("light skin", "red"):
        axes, index = _axes(figure, name), CLASSIC.index(name)
        measured, estimated = _line(axes, "measured"), _line(axes, "estimated")
        assert estimated.get_linestyle() == "-"
        assert measured.get_linestyle() == "--"
        recovered = camera.recoveries[0].matrix @ camera.charts[0].camera_values[index]
        np.testing.assert_allclose(estimated.get_ydata(), recovered / 1e-3)  # mW
        np.testing.assert_allclose(measured.get_ydata(), camera.charts[0].signals[index] / 1e-3)


def test_each_class_of_light_is_drawn_with_its_own_chart():
    camera = _camera(("tubes", "FL2"), ("window", "D65"))
    shuffled = replace(camera, charts=camera.charts[::-1])
    figure = draw_camera(shuffled, [], what=["spectra"], patches=["red"], classes=["window"])
    measured = _line(_axes(figure, "red"), "measured").get_ydata()
    np.testing.assert_allclose(measured, camera.charts[1].signals[CLASSIC.index("red")] / 1e-3)


def test_sensitivities_are_those_per_nanometre_on_an_uneven_grid():
    """Twice as wide a band gives twice the response, but not twice the sensitivity."""
    grid = np.array([400.0, 410.0, 420.0, 440.0, 480.0])
    response = np.ones((5, 3)) * np.array([10.0, 10.0, 15.0, 30.0, 40.0])[:, None]
    light = np.ones(5)
    recovery = Recovery("lamp", np.ones((5, 3)), "regression", light, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    camera = SpectralCamera("c </C>", grid, response, np.zeros(3), (recovery,))
    figure = draw_camera(camera, [], what=["sensitivities"])
    np.testing.assert_allclose(_line(_axes(figure, "Sensitivities"), "R").get_ydata(), 1.0)


def test_the_band_of_a_wiener_estimate_is_two_posterior_deviations_to_each_side():
    camera = _camera(**WIENER)
    axes = _axes(draw_camera(camera, [], what=["diffuser"]), "Perfect diffuser")
    band = next(item for item in axes.collections if "σ" in item.get_label())
    recovered = _line(axes, "recovered").get_ydata()
    corners = band.get_paths()[0].vertices
    at = corners[np.isclose(corners[:, 0], 550.0), 1]
    middle = recovered[GRID == 550.0][0]
    np.testing.assert_allclose(sorted(set(np.round(at, 9))), [middle - 0.4, middle + 0.4])


def test_a_regression_has_no_band_for_it_knows_no_posterior():
    axes = _axes(draw_camera(_camera(), [], what=["diffuser"]), "Perfect diffuser")
    assert not axes.collections


def test_bars_are_the_leave_one_out_errors_of_the_layer():
    camera = _camera()
    figure = draw_camera(camera, [], what=["errors"])
    recovery = camera.recoveries[0]
    heights = [[bar.get_height() for bar in axes.patches] for axes in figure.axes]
    np.testing.assert_allclose(heights[0], recovery.patch_delta_e_2000)
    np.testing.assert_allclose(heights[2], 100.0 * recovery.patch_rmse)
    tops = [bar.get_y() + bar.get_height() for bar in figure.axes[1].patches]
    np.testing.assert_allclose(tops, 1.0 - recovery.patch_gfc)


def test_without_a_choice_the_patches_shown_are_skin_and_what_differs_most():
    lab = np.array([[50, 0, 0], [51, 0, 0], [60, 20, 20], [52, 1, 0], [90, 0, 0], [40, 0, -50.0]])
    names = ("a", "b", "light skin", "c", "white", "blue")
    assert choose_patches(names, lab, count=4) == [0, 2, 4, 5]
    assert choose_patches(names, lab, ("blue", "A")) == [5, 0]


def test_the_first_words_of_a_patch_are_enough_where_they_mean_one_patch():
    lab = np.zeros((24, 3))
    assert choose_patches(CLASSIC, lab, ("White", "neutral 5", "blue")) == [18, 21, 12]
    with pytest.raises(UsageError, match="--patches neutral: the chart has no such patch"):
        choose_patches(CLASSIC, lab, ("neutral",))


def test_the_mean_of_a_light_is_the_solid_angle_weighted_mean_of_its_map(tmp_path):
    coefficients, basis = _light_layer(tmp_path / "light.usda")
    _stage, prim = _open_light(tmp_path / "light.usda")
    light = read_light_spectra(prim)
    sizes = texel_solid_angles(32, 64)[:, None, None] / (4.0 * np.pi)
    expected = (sizes * coefficients).sum(axis=(0, 1)) @ basis
    np.testing.assert_allclose(light.mean, expected, rtol=1e-6)
    assert light.classes == {}  # nothing says how many there are


def test_what_the_classes_add_comes_to_the_mean_of_the_light(tmp_path):
    estimate = LightEstimate("measured", classes=("tubes", "window"), class_shares=(0.6, 0.4))
    _light_layer(tmp_path / "light.usda", estimate=estimate)
    _stage, prim = _open_light(tmp_path / "light.usda")
    light = read_light_spectra(prim)
    assert list(light.classes) == ["tubes", "window"]
    np.testing.assert_allclose(sum(light.classes.values()), light.mean, rtol=1e-9)
    axes = _axes(draw_light(light, []), "Mean radiance")
    np.testing.assert_allclose(_line(axes, "window").get_ydata(), light.classes["window"] / 1e-3)


def test_the_shares_of_the_classes_come_to_one_and_follow_their_coefficients(tmp_path):
    estimate = LightEstimate("measured", classes=("tubes", "window"), class_shares=(0.6, 0.4))
    coefficients, basis = _light_layer(tmp_path / "light.usda", estimate=estimate)
    _stage, prim = _open_light(tmp_path / "light.usda")
    shares = read_light_spectra(prim).class_shares
    luminance = coefficients * (basis @ xyz_weights(GRID)[:, 1])
    tubes, whole = luminance[..., :3].sum(axis=-1), luminance.sum(axis=-1)
    np.testing.assert_allclose(shares[0], tubes / whole, rtol=1e-5)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0, rtol=1e-6)


def test_an_estimate_that_explodes_does_not_hide_what_was_measured():
    camera = _camera()
    wild = replace(camera.recoveries[0], matrix=1e3 * camera.recoveries[0].matrix)
    figure = draw_camera(replace(camera, recoveries=(wild,)), [], what=["spectra"])
    for axes in figure.axes:
        measured = _line(axes, "measured").get_ydata()
        assert axes.get_ylim()[1] <= 3.0 * measured.max()


def test_a_patch_mixed_up_with_another_shows_in_the_figure_of_a_chart():
    """Inside each patch is what the camera saw; swapped, it is another color."""
    chart = _training("tubes", "FL2", CLASSIC)[1]
    values = chart.camera_values.copy()
    values[[3, 14]] = values[[14, 3]]
    order = np.arange(24)
    spectra = ChartSpectra(
        "chart.usda </Chart>", "Classic", CLASSIC, GRID, chart.signals, chart.illuminant.value,
        "absolute", values, np.stack([order % 6, order // 6], axis=1),
    )  # fmt: skip
    figure = draw_chart([spectra], [], what=["patches"])
    colors = np.array([patch.get_facecolor()[:3] for patch in figure.axes[0].patches])
    apart = np.abs(colors[0::2] - colors[1::2]).max(axis=1)
    assert set(np.argsort(-apart)[:2]) == {3, 14}


# Legible


@pytest.mark.parametrize(
    "camera",
    [
        _camera(("tubes", "FL2"), ("window", "D65"), names=CLASSIC[-5:], **WIENER),
        _camera(("a_class_with_a_rather_long_name", "A"), names=SG),
        replace(
            _camera(names=tuple(f"{name}, of the second chart we had" for name in CLASSIC[:3])),
            model="A camera of a rather long name, with the filter removed, number 12345678",
            lens="A zoom lens at its widest, with an adapter for another make's mount, " * 3,
        ),
    ],
    ids=["two classes", "140 patches", "long names"],
)
def test_no_text_of_a_camera_leaves_the_page(camera):
    assert texts_outside(draw_camera(camera, [])) == []


@pytest.mark.parametrize("what", ["sensitivities", "diffuser", "chromaticity", "spectra", "errors"])
def test_no_text_leaves_the_page_where_one_part_stands_alone(what):
    assert texts_outside(draw_camera(_camera(), [], what=[what])) == []


def test_every_axis_over_wavelength_says_nanometres_and_radiance_has_its_unit():
    figure = draw_camera(_camera(), [])
    assert _axes(figure, "Sensitivities").get_xlabel() == "wavelength [nm]"
    assert "W m$^{-2}$ sr$^{-1}$ nm$^{-1}$]" in _axes(figure, "Perfect diffuser").get_ylabel()
    texts = [text.get_text() for text in figure.findobj(matplotlib.text.Text)]
    assert texts.count("wavelength [nm]") == 3  # two panels, and the patches together


def test_curves_are_told_apart_without_color():
    figure = draw_camera(_camera(), [], what=["sensitivities"])
    lines = _axes(figure, "Sensitivities").get_lines()
    assert len({str(line._unscaled_dash_pattern) for line in lines}) == 3


# Files


@pytest.mark.parametrize("suffix", ["svg", "png", "pdf"])
def test_the_same_layer_gives_the_same_bytes_whatever_matplotlib_was_told(tmp_path, suffix):
    camera, what = _camera(), ["chromaticity"]
    first = save_figure(draw_camera(camera, [], what=what), tmp_path / f"a.{suffix}")
    with matplotlib.rc_context({"lines.linewidth": 9.0, "svg.fonttype": "none", "font.size": 20}):
        again = save_figure(draw_camera(camera, [], what=what), tmp_path / f"b.{suffix}")
    assert first.read_bytes() == again.read_bytes()


def test_drawing_leaves_matplotlibs_settings_as_they_were():
    with matplotlib.rc_context({"lines.linewidth": 9.0}):
        before = dict(matplotlib.rcParams)
        draw_camera(_camera(), [], what=["sensitivities"])
        assert dict(matplotlib.rcParams) == before


def test_an_svg_is_well_formed_and_tells_neither_date_nor_machine(tmp_path):
    path = save_figure(draw_camera(_camera(), [], what=["diffuser"]), tmp_path / "a.svg")
    assert ElementTree.parse(path).getroot().tag.endswith("svg")
    text = path.read_text()
    assert "date" not in text.lower().replace("update", "")
    assert str(tmp_path) not in text


def test_a_figure_that_cannot_be_finished_leaves_the_old_one(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    path.write_bytes(b"old")
    figure = draw_camera(_camera(), [], what=["sensitivities"])

    def fail(target, **_settings):
        Path(target).write_bytes(b"half")
        raise KeyboardInterrupt

    monkeypatch.setattr(figure, "savefig", fail)
    with pytest.raises(KeyboardInterrupt):
        save_figure(figure, path)
    assert path.read_bytes() == b"old"
    assert [item.name for item in tmp_path.iterdir()] == ["a.png"]


def test_pyplot_is_never_loaded():
    """It would keep every figure, and look for a display."""
    code = (
        "import sys; from usdskin.plots.figures import new_figure, styled\n"
        "with styled(): new_figure(2.0).subplots().plot([0, 1])\n"
        "assert 'matplotlib.pyplot' not in sys.modules"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


# Layers and the command


def _camera_layer(path, camera: SpectralCamera) -> None:
    stage = Usd.Stage.CreateInMemory("camera.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(write_spectral_camera(stage, "/Camera", camera))
    write_layer(stage, path)


def test_the_figure_drawn_from_a_layer_is_the_one_of_what_was_written(tmp_path):
    camera = _camera()
    _camera_layer(tmp_path / "camera.usda", camera)
    options = PlotOptions(what=("diffuser", "errors"))
    drawn = plot_file(tmp_path / "camera.usda", tmp_path / "a.png", options)
    expected = draw_camera(camera, [], what=options.what)
    assert drawn.read_bytes() == save_figure(expected, tmp_path / "b.png").read_bytes()


def test_charts_and_lights_are_drawn_from_their_layers(tmp_path):
    stage = Usd.Stage.CreateInMemory("chart.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    scope = UsdGeom.Scope.Define(stage, "/Chart").GetPrim()
    write_color_chart(scope, _training("tubes", "FL2", CLASSIC)[1])
    write_layer(stage, tmp_path / "chart.usda")
    _light_layer(tmp_path / "light.usda", estimate=LightEstimate("measured", cct=4200.0))
    notes: list = []
    for name in ("chart", "light"):
        plot_file(tmp_path / f"{name}.usda", tmp_path / f"{name}.png", notes=notes)
        assert (tmp_path / f"{name}.png").stat().st_size > 20_000
    assert notes == []


def test_the_command_draws_what_is_asked_for_and_prints_the_file(tmp_path):
    _camera_layer(tmp_path / "camera.usda", _camera())
    output = tmp_path / "skin.pdf"
    arguments = [str(tmp_path / "camera.usda"), "-o", str(output), "--what", "spectra"]
    arguments += ["--patches", "dark skin, light skin"]
    result = CliRunner().invoke(plot, arguments, obj=GlobalOptions(), catch_exceptions=False)
    assert result.exit_code == 0
    assert result.output.strip() == str(output)
    assert output.read_bytes().startswith(b"%PDF")


def test_a_camera_without_its_charts_is_drawn_as_far_as_it_goes_and_says_so():
    camera = replace(_camera(), charts=())
    notes: list = []
    draw_camera(camera, notes)
    assert {note.code for note in notes} == {"plot-left-out"}
    assert {note.message.split()[0] for note in notes} == {"chromaticity", "spectra"}
    with pytest.raises(LayerError, match=r"camera.usda </Camera>: has no chart of light class"):
        draw_camera(camera, [], what=["spectra"])


def test_a_light_without_a_picture_is_drawn_without_and_says_so(tmp_path):
    _light_layer(tmp_path / "light.usda", rendition=False)
    notes: list = []
    plot_file(tmp_path / "light.usda", tmp_path / "light.png", notes=notes)
    assert [note.message.split(":")[0] for note in notes] == [
        "picture not drawn",
        "summary not drawn",
    ]


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (PlotOptions(what=("skin",)), r"--what skin: the figure of a camera shows sensitivities"),
        (PlotOptions(patches=("light skim",)), r"no such patch; it has light skin"),
        (PlotOptions(classes=("sun",)), r"--class sun: .* was calibrated for tubes"),
    ],
)
def test_an_option_that_does_not_fit_is_refused_with_what_would(tmp_path, options, message):
    _camera_layer(tmp_path / "camera.usda", _camera())
    with pytest.raises(UsageError, match=message):
        plot_file(tmp_path / "camera.usda", tmp_path / "a.svg", options)
    assert not (tmp_path / "a.svg").exists()


def test_patches_of_a_light_are_refused(tmp_path):
    _light_layer(tmp_path / "light.usda")
    with pytest.raises(UsageError, match="--patches: chooses what the figure of a camera shows"):
        plot_file(tmp_path / "light.usda", tmp_path / "a.svg", PlotOptions(patches=("red",)))


@pytest.mark.parametrize(
    ("name", "error", "message"),
    [
        ("a.jpg", UsageError, r"figures are written as .svg, .png or .pdf"),
        ("a", UsageError, r"figures are written as .svg, .png or .pdf"),
        ("/proc/a.svg", UsdSkinError, r"cannot be written .*; choose another folder"),
    ],
)
def test_a_figure_that_cannot_be_written_is_refused_before_anything_is_read(
    tmp_path, name, error, message
):
    with pytest.raises(error, match=message):
        plot_file(tmp_path / "missing.usda", tmp_path / name)


def test_a_layer_with_nothing_to_draw_is_refused(tmp_path):
    stage = Usd.Stage.CreateInMemory("empty.usda")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    write_layer(stage, tmp_path / "empty.usda")
    with pytest.raises(LayerError, match="has no calibrated camera, no colour chart and no spect"):
        plot_file(tmp_path / "empty.usda", tmp_path / "a.svg")


def test_the_picture_a_figure_is_drawn_from_is_not_overwritten(tmp_path):
    _light_layer(tmp_path / "light.usda")
    stage, prim = _open_light(tmp_path / "light.usda")
    write_png(tmp_path / "rgb.png", np.full((32, 64, 3), 128, np.uint8))
    UsdLux.DomeLight(prim).GetTextureFileAttr().Set("./rgb.png")
    stage.GetRootLayer().Save()
    before = (tmp_path / "rgb.png").read_bytes()
    with pytest.raises(UsageError, match="is drawn in this figure"):
        plot_file(tmp_path / "light.usda", tmp_path / "rgb.png", notes=[])
    assert (tmp_path / "rgb.png").read_bytes() == before


def test_without_matplotlib_the_extra_is_named(tmp_path, monkeypatch):
    _camera_layer(tmp_path / "camera.usda", _camera())
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    with pytest.raises(UsageError, match=r"pip install 'usdskin\[plot\]'"):
        plot_file(tmp_path / "camera.usda", tmp_path / "a.svg")


def test_a_relative_light_says_so_and_its_illuminance_has_no_unit():
    estimate = LightEstimate("assigned", illuminant="FL2", illuminance=1.25)
    mean = illuminant("FL2", GRID)
    light = LightSpectra("light.usda </Light>", GRID, mean, {}, None, "relative", estimate, None)
    figure = draw_light(light, [])
    texts = [text.get_text() for text in figure.findobj(matplotlib.text.Text)]
    assert "1.25 relative" in texts
    assert "relative radiance" in texts
    assert "Light with an assigned spectrum: FL2" in texts
