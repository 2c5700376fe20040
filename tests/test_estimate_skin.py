"""``usdskin estimate skin``: from a layer of readings to a material, through the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chart_layers import GRID, seen_chart, sensitivity, write_chart
from numpy.typing import NDArray

from usdskin.cli import main
from usdskin.colorimetry import (
    cat16,
    decode_srgb,
    encode_srgb,
    white_xyz,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.differences import delta_e_of_signals
from usdskin.estimate.skin.prior import shipped_prior
from usdskin.estimate.skin.publish import _azimuth
from usdskin.estimate.skin.readings import readings_from_angles
from usdskin.estimate.skin.spectra import MeasuredReflectance
from usdskin.estimate.skin.table import read_goniometer_table
from usdskin.illuminants import illuminant
from usdskin.images import Part, read_image, write_exr, write_png
from usdskin.layers import open_stage, write_layer
from usdskin.prims import (
    SkinParameters,
    SkinSamples,
    read_skin,
    read_skin_fit,
    read_skin_samples,
    write_skin_samples,
)
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
from pxr import Sdf, Usd, UsdGeom

FloatArray = NDArray[np.float64]

WRAP = 0.3
NM = np.arange(400.0, 701.0, 20.0)
RAMP = (NM - 400.0) / 300.0
S = 0.35 + 0.25 * RAMP
SS = 0.3 + 0.4 * RAMP
YBAR = xyz_weights(NM)[:, 1]
ALPHA = 1.0 / (1.0 + float(SS @ YBAR / YBAR.sum()))
THETA = np.linspace(0.0, 118.0, 24)


def brightness(
    theta_deg: FloatArray, a: FloatArray, b: FloatArray, wrap: float = WRAP
) -> FloatArray:
    """Eq. (1) over a perfect diffuser that faces the light, shape [q, c]."""
    cosine = np.cos(np.radians(theta_deg))[:, None]
    return np.asarray(
        np.maximum(cosine, 0.0) * a + np.maximum((cosine + wrap) / (1.0 + wrap), 0.0) * b
    )


def noisy(values: FloatArray, seed: int = 0) -> FloatArray:
    random = np.random.default_rng(seed)
    spread = 0.01 * values + 0.002 * values.max()
    return np.asarray(values + spread * random.normal(size=values.shape))


def spectral_samples(**fields: object) -> SkinSamples:
    values = noisy(brightness(THETA, ALPHA * S, ALPHA * S * SS))
    given = SkinSamples(theta_i=THETA, values=values, wavelength_nm=NM)
    return replace(given, **fields)


def write_samples(folder: Path, samples: SkinSamples, camera: str = "") -> Path:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = UsdGeom.Scope.Define(stage, "/Samples").GetPrim()
    stage.SetDefaultPrim(prim)
    path = None
    if camera:
        path = Sdf.Path("/Samples/Camera")
        stage.DefinePrim(path).GetReferences().AddReference(f"./{camera}")
    write_skin_samples(prim, samples, folder, camera=path)
    return write_layer(stage, folder / "samples.usda")


def estimate(samples: Path, *options: str) -> tuple[int, Path]:
    output = samples.parent / "skin.usda"
    return main(["-q", "estimate", "skin", str(samples), "-o", str(output), *options]), output


def skin_of(layer: Path) -> SkinParameters:
    stage = open_stage(layer)
    return read_skin(stage.GetDefaultPrim())


def refused(capsys: pytest.CaptureFixture[str], samples: Path, *options: str, code: int = 3) -> str:
    before = sorted(samples.parent.iterdir())
    capsys.readouterr()
    status, _ = estimate(samples, *options)
    said = capsys.readouterr().err
    lines = [line for line in said.splitlines() if line.startswith("usdskin: error")]
    assert status == code, said
    assert len(lines) == 1 and "Traceback" not in said, said
    assert sorted(samples.parent.iterdir()) == before
    return lines[0]


# --- What the layer holds ------------------------------------------------------------------------


def test_spectral_readings_give_the_material_back(tmp_path):
    status, output = estimate(write_samples(tmp_path, spectral_samples()))
    assert status == 0
    stage = open_stage(output)
    prim = stage.GetDefaultPrim()
    assert prim.GetTypeName() == "Material"
    skin, fit = read_skin(prim), read_skin_fit(prim)
    assert abs(skin.wrap - WRAP) <= 0.02
    assert abs(skin.wrap - WRAP) <= 4.0 * fit.wrap_stddev
    assert skin.alpha == pytest.approx(ALPHA, abs=0.02)
    np.testing.assert_allclose(skin.reflectance.resample(NM), S, rtol=0.06)
    np.testing.assert_allclose(skin.scattering.resample(NM), SS, atol=0.15)
    assert fit.convention == "luminousMean"
    assert fit.parameters[0] == "wrap" and len(fit.parameters) == 1 + 2 * NM.size
    assert fit.covariance.shape == (33, 33)
    assert fit.values[0] == pytest.approx(skin.wrap, abs=1e-6)
    bright = float(skin.scattering.resample(NM) @ YBAR / YBAR.sum())
    assert skin.alpha == pytest.approx(1.0 / (1.0 + bright), abs=1e-4)


def test_the_readings_stay_with_the_layer(tmp_path):
    samples = spectral_samples()
    _, output = estimate(write_samples(tmp_path, samples))
    kept = read_skin_samples(open_stage(output))
    np.testing.assert_allclose(kept.theta_i, THETA, atol=1e-6)
    np.testing.assert_allclose(kept.values, samples.values, rtol=1e-12)
    again = tmp_path / "again.usda"
    assert main(["-q", "estimate", "skin", str(output), "-o", str(again)]) == 0
    one, two = (open_stage(path) for path in (output, again))
    first, second = read_skin(one.GetDefaultPrim()), read_skin(two.GetDefaultPrim())
    assert second.wrap == pytest.approx(first.wrap, abs=1e-6)


def test_a_table_of_readings_is_read(tmp_path):
    samples = spectral_samples()
    rows = ["thetaI [deg];thetaR [deg];azimuth;" + ";".join(f"{nm:g} nm" for nm in NM)]
    for theta, row in zip(THETA, samples.values, strict=True):
        rows.append(
            f"{theta:.3f};0;0;" + ";".join(f"{value:.6f}".replace(".", ",") for value in row)
        )
    (tmp_path / "readings.csv").write_text("\n".join(rows))
    table = SkinSamples(values_file=tmp_path / "readings.csv")
    status, output = estimate(write_samples(tmp_path, table))
    assert status == 0
    assert skin_of(output).wrap == pytest.approx(WRAP, abs=0.02)


@pytest.mark.parametrize(
    ("heading", "unit"),
    [
        ("thickness", 1.0),
        ("thickness_m", 1.0),
        ("Thickness [mm]", 1e-3),
        ("thickness_mm", 1e-3),
        ("thickness (\u00b5m)", 1e-6),
    ],
)
def test_a_table_says_in_what_unit_its_thicknesses_are(tmp_path, heading, unit):
    rows = f"thetaI,{heading},550\n0,0,0.5\n0,{0.0004 / unit:g},0.4\n"
    (tmp_path / "readings.csv").write_text(rows)
    table = read_goniometer_table(tmp_path / "readings.csv")
    np.testing.assert_allclose(table.thickness, [0.0, 0.0004], rtol=1e-12)
    assert table.names == ("550",)


def test_readings_in_the_wrong_order_are_refused(tmp_path, capsys):
    samples = spectral_samples()
    mixed = np.random.default_rng(1).permutation(samples.values)
    line = refused(capsys, write_samples(tmp_path, replace(samples, values=mixed)))
    assert "of the peak" in line and "times the noise" in line


def test_radiance_is_divided_by_the_white(tmp_path):
    samples = spectral_samples()
    white = 3e-3 * (1.0 + RAMP)
    scaled = replace(samples, values=samples.values * white, white=white, quantity="radiance")
    found = []
    for name, given in (("factor", samples), ("radiance", scaled)):
        folder = tmp_path / name
        folder.mkdir()
        found.append(skin_of(estimate(write_samples(folder, given))[1]).reflectance.value)
    np.testing.assert_allclose(found[1], found[0], rtol=1e-6)


def test_channels_of_a_calibrated_camera_become_spectra_of_skin(tmp_path):
    chart = replace(seen_chart("FL2"), light_class="tubes")
    layer = write_chart(tmp_path / "chart.usda", chart)
    camera = tmp_path / "camera.usda"
    assert main(["-q", "calibrate", "camera", str(layer), "-o", str(camera)]) == 0
    prior = shipped_prior(GRID)
    surface = np.asarray(prior.mean + 0.5 * prior.components[0])
    spread = 0.2 + 0.4 * (GRID - 400.0) / 300.0
    ybar = xyz_weights(GRID)[:, 1]
    alpha = 1.0 / (1.0 + float(spread @ ybar / ybar.sum()))
    rows = sensitivity().T * illuminant("FL2", GRID)
    rows /= rows.sum(axis=1, keepdims=True)
    a, b = rows @ (alpha * surface), rows @ (alpha * surface * spread)
    samples = SkinSamples(theta_i=THETA, values=noisy(brightness(THETA, a, b)), light_class="tubes")
    status, output = estimate(write_samples(tmp_path, samples, "camera.usda"))
    assert status == 0
    skin = skin_of(output)
    assert skin.wrap == pytest.approx(WRAP, abs=0.03)
    for lamp in ("D65", "A", "FL2"):
        light = illuminant(lamp, GRID)
        lit = skin.alpha * skin.reflectance.resample(GRID) * (1.0 + skin.scattering.resample(GRID))
        true = alpha * surface * (1.0 + spread)
        assert delta_e_of_signals(lit * light, true * light, light, GRID) <= 1.5


def test_a_spectrophotometer_sets_the_reflectance(tmp_path):
    share = (1.0 + 2.0 * WRAP) / (1.0 + WRAP)
    read = ALPHA * S * (1.0 + share * SS)
    with_it = spectral_samples(reflectance=Spectrum(SpectralQuantity.REFLECTANCE, NM, read))
    _, output = estimate(write_samples(tmp_path, with_it))
    skin = skin_of(output)
    k = (1.0 + 2.0 * skin.wrap) / (1.0 + skin.wrap)
    lit = skin.alpha * skin.reflectance.resample(NM) * (1.0 + k * skin.scattering.resample(NM))
    np.testing.assert_allclose(lit, read, rtol=1e-4)


def test_what_an_instrument_reads_is_the_wrap_lobe_over_its_light():
    """Against eq. (1) integrated over the light of each geometry, over that of a white surface."""
    nodes, weights = np.polynomial.legendre.leggauss(64)
    cosine, weights = 0.5 * (nodes + 1.0), 0.5 * weights
    spectrum = Spectrum(SpectralQuantity.REFLECTANCE, NM, S)
    for wrap in (0.0, 0.35, 1.0):
        lobe = (cosine + wrap) / (1.0 + wrap)
        diffuse = (weights * lobe).sum() / (weights * cosine).sum()
        assert MeasuredReflectance(spectrum, "di8").share(wrap) == pytest.approx(diffuse)
        at_45 = ((np.cos(np.pi / 4) + wrap) / (1.0 + wrap)) / np.cos(np.pi / 4)
        assert MeasuredReflectance(spectrum, "45to0").share(wrap) == pytest.approx(at_45)


def test_azimuths_are_published_as_they_were_given():
    """With their sign: a left and a right turn of the camera are not one."""
    azimuth = [70.0, -110.0]
    readings = readings_from_angles([30.0, 50.0], [20.0, 40.0], azimuth, np.ones((2, 1)))
    np.testing.assert_allclose(_azimuth(readings), azimuth)


def test_lustre_is_refused_or_fitted_never_ignored_silently(tmp_path, capsys):
    """A sharp lobe on top of the diffuse readings, seen from 30 degrees."""
    values = brightness(THETA, ALPHA * S, ALPHA * S * SS)
    away = THETA - 30.0
    lobe = 0.4 * np.exp(-0.5 * (away / 8.0) ** 2)
    samples = spectral_samples(
        values=noisy(values + lobe[:, None]),
        theta_r=np.full(THETA.size, 30.0),
        azimuth=np.full(THETA.size, 180.0),
    )
    layer = write_samples(tmp_path, samples)
    assert "specular" in refused(capsys, layer)


def test_the_layer_is_a_sound_material_that_renders(tmp_path):
    _, output = estimate(write_samples(tmp_path, spectral_samples()))
    assert main(["-q", "validate", str(output)]) == 0
    shot = tmp_path / "shot.usda"
    shot.write_text(
        """#usda 1.0
(
    upAxis = "Y"
    metersPerUnit = 1
)
def "Skin" (references = @./skin.usda@) {}
def DomeLight "Sky" {}
def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    rel material:binding = </Skin>
}
def Camera "Camera"
{
    double3 xformOp:translate = (0, 0, 6)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}
"""
    )
    assert main(["-q", "render", str(shot), str(tmp_path / "shot.exr"), "-w", "32"]) == 0


def test_the_rendition_for_other_tools_has_the_skins_color(tmp_path):
    _, output = estimate(write_samples(tmp_path, spectral_samples()))
    stage = open_stage(output)
    color = stage.GetPrimAtPath("/Skin/surface").GetAttribute("inputs:diffuseColor").Get()
    weights = illuminant("D65", NM) * YBAR
    facing = float((ALPHA * S * (1.0 + SS)) @ weights / weights.sum())
    assert np.dot(color, [0.2126, 0.7152, 0.0722]) == pytest.approx(facing, rel=0.02)


def test_info_tells_the_skin_with_its_errors(tmp_path, capsys):
    _, output = estimate(write_samples(tmp_path, spectral_samples()))
    capsys.readouterr()
    assert main(["--json", "info", str(output)]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    report = next(event for event in events if "skins" in event)
    row = report["skins"][0]
    assert row["path"] == "/Skin" and row["l +-"] > 0.0
    assert report["problems"] == []


def test_the_same_readings_give_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    layer = write_samples(tmp_path, spectral_samples())
    first = estimate(layer)[1].read_bytes()
    assert estimate(layer)[1].read_bytes() == first


# --- What a laboratory gets wrong ---------------------------------------------------------------


def test_readings_that_stop_before_the_shadow_line_are_refused(tmp_path, capsys):
    theta = np.linspace(0.0, 85.0, 24)
    values = noisy(brightness(theta, ALPHA * S, ALPHA * S * SS))
    said = refused(capsys, write_samples(tmp_path, spectral_samples(theta_i=theta, values=values)))
    assert "92" in said and "/Samples" in said


def test_with_scattering_known_they_may_stop_there(tmp_path):
    theta = np.linspace(0.0, 85.0, 24)
    flat = np.full(NM.size, 0.5)
    values = noisy(brightness(theta, ALPHA * S, ALPHA * S * flat))
    layer = write_samples(tmp_path, spectral_samples(theta_i=theta, values=values))
    status, output = estimate(layer, "--scattering", "0.5")
    assert status == 0
    assert skin_of(output).wrap == pytest.approx(WRAP, abs=0.06)


def test_angles_in_radians_are_told(tmp_path, capsys):
    layer = write_samples(tmp_path, spectral_samples(theta_i=np.radians(THETA)))
    assert "radians" in refused(capsys, layer)


def test_percent_is_told(tmp_path, capsys):
    samples = spectral_samples()
    layer = write_samples(tmp_path, replace(samples, values=100.0 * samples.values))
    assert "percent" in refused(capsys, layer).lower() or "100" in refused(capsys, layer)


def test_a_mask_that_leaves_nothing_is_refused(tmp_path, capsys):
    layer = write_samples(tmp_path, spectral_samples(mask=np.zeros(THETA.size, bool)))
    assert "mask" in refused(capsys, layer)


def test_one_angle_only_is_refused(tmp_path, capsys):
    same = spectral_samples(theta_i=np.full(THETA.size, 30.0))
    refused(capsys, write_samples(tmp_path, same))


def test_saturated_readings_are_left_out(tmp_path):
    samples = spectral_samples()
    level = 0.9 * samples.values.max()
    clipped = replace(samples, values=np.minimum(samples.values, level), saturation=level)
    status, output = estimate(write_samples(tmp_path, clipped))
    assert status == 0
    assert skin_of(output).wrap == pytest.approx(WRAP, abs=0.03)


def test_radiance_without_a_white_is_refused(tmp_path, capsys):
    layer = write_samples(tmp_path, spectral_samples(quantity="radiance"))
    assert "samples:white" in refused(capsys, layer)


def test_columns_of_nobody_knows_what_are_refused(tmp_path, capsys):
    values = spectral_samples().values[:, :3]
    layer = write_samples(tmp_path, SkinSamples(theta_i=THETA, values=values))
    assert "samples:wavelengths" in refused(capsys, layer)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("theta,R\n1,2\n", "thetaI"),
        ("thetaI,550,560\n10,0.3\n", "readings.csv:2"),
        ("thetaI,550,560\n10,0.3,nan\n", "readings.csv:2"),
        ("thetaI,550,red\n10,0.3,0.4\n", "wavelengths"),
        ("thetaI\n10\n", "angles alone"),
        ("thetaI,thickness [in],550\n10,0.1,0.3\n", "thickness [in]"),
        ("", "empty"),
    ],
)
def test_a_broken_table_is_told_by_line(tmp_path, capsys, text, said):
    (tmp_path / "readings.csv").write_text(text)
    layer = write_samples(tmp_path, SkinSamples(values_file=tmp_path / "readings.csv"))
    assert said in refused(capsys, layer)


def test_a_layer_without_samples_says_so(tmp_path, capsys):
    layer = tmp_path / "samples.usda"
    layer.write_text('#usda 1.0\n(upAxis = "Y"\nmetersPerUnit = 1)\ndef Scope "A" {}\n')
    assert "SkinSampleAPI" in refused(capsys, layer)


# --- Textures ------------------------------------------------------------------------------------


def write_albedo(path: Path) -> FloatArray:
    """Write a small picture of skin colors; return their linear values."""
    random = np.random.default_rng(3)
    linear = np.array([0.5, 0.3, 0.22]) * random.uniform(0.3, 1.0, (6, 8, 1))
    linear = linear * random.uniform(0.92, 1.08, (6, 8, 3))
    encoded = np.round(255.0 * encode_srgb(linear)).astype(np.uint8)
    write_png(path, encoded)
    return np.asarray(decode_srgb(encoded / 255.0))


@pytest.mark.parametrize("like", [False, True])
def test_an_albedo_gets_the_spectra_of_skin_with_its_very_colors(tmp_path, like):
    linear = write_albedo(tmp_path / "albedo.png")
    options = []
    if like:
        assert estimate(write_samples(tmp_path, spectral_samples()))[0] == 0
        (tmp_path / "skin.usda").rename(tmp_path / "measured.usda")
        options = ["--like", str(tmp_path / "measured.usda")]
    status, output = estimate(tmp_path / "albedo.png", *options)
    assert status == 0
    skin = skin_of(output)
    weights = read_image(skin.weights_file).pixels.astype(np.float64)
    spread = skin.scattering.resample(GRID)
    even = skin.alpha * (1.0 + (1.0 + skin.wrap) * spread)
    spectra = weights @ skin.weights_basis * even
    assert spectra.min() >= -0.01
    light = illuminant("D65", GRID)[:, None] * xyz_weights(GRID)
    light /= light[:, 1].sum()
    space = "lin_rec709_scene"
    to_rgb = xyz_to_rgb(space) @ cat16(light.sum(axis=0), white_xyz(space))
    np.testing.assert_allclose(spectra @ light @ to_rgb.T, linear, atol=1e-3)
    if like:
        assert skin.wrap == pytest.approx(skin_of(tmp_path / "measured.usda").wrap)


def test_an_albedo_is_a_material_that_other_tools_see_too(tmp_path):
    write_albedo(tmp_path / "albedo.png")
    _, output = estimate(tmp_path / "albedo.png")
    assert main(["-q", "validate", str(output)]) == 0
    stage = open_stage(output)
    texture = stage.GetPrimAtPath("/Skin/albedo").GetAttribute("inputs:file").Get()
    assert texture.path == "./albedo.png"


def test_options_of_a_fit_do_not_go_with_a_texture(tmp_path, capsys):
    write_albedo(tmp_path / "albedo.png")
    assert "--wrap" in refused(capsys, tmp_path / "albedo.png", "--wrap", "0.3", code=2)


def test_a_texture_that_is_no_picture_is_refused(tmp_path, capsys):
    (tmp_path / "albedo.png").write_bytes(b"no picture")
    assert "albedo.png" in refused(capsys, tmp_path / "albedo.png")


def test_a_figure_never_replaces_an_input_or_the_layer(tmp_path, capsys):
    write_albedo(tmp_path / "albedo.png")
    layer = write_samples(tmp_path, spectral_samples())
    for figure in ("skin.usda", "samples.usda"):
        refused(capsys, layer, "--plot", str(tmp_path / figure), code=2)
    rows = ["thetaI," + ",".join(f"{nm:g}" for nm in NM)]
    (tmp_path / "readings.png").write_text("\n".join(rows))  # what the layer names is safe too
    table = write_samples(tmp_path, SkinSamples(values_file=tmp_path / "readings.png"))
    before = (tmp_path / "readings.png").read_bytes()
    refused(capsys, table, "--plot", str(tmp_path / "readings.png"), code=2)
    assert (tmp_path / "readings.png").read_bytes() == before


def test_a_negative_albedo_is_refused_where_it_is(tmp_path, capsys):
    pixels = np.full((4, 6, 3), 0.3, np.float32)
    pixels[2, 5] = -0.1
    part = Part("", {"": pixels}, {}, "float", "lin_rec709_scene")
    write_exr(tmp_path / "albedo.exr", [part])
    assert "x 5, y 2" in refused(capsys, tmp_path / "albedo.exr")


def test_wavelengths_nobody_sees_are_refused(tmp_path, capsys):
    layer = write_samples(tmp_path, spectral_samples(wavelength_nm=NM + 1000.0))
    assert "1400 to 1700 nm" in refused(capsys, layer)
