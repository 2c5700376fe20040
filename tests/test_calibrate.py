"""``usdskin calibrate camera``: from a chart layer to a camera layer, through the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from chart_layers import (
    GRID,
    reflectances,
    seen_chart,
    sensitivity,
    with_rows,
    write_chart,
    write_table,
)

from usdskin.cli import main
from usdskin.illuminants import illuminant
from usdskin.layers import open_stage
from usdskin.prims import read_color_charts, read_spectral_camera
from usdskin.spectrum import SpectralQuantity, Spectrum


def calibrate(chart: Path, *options: str) -> tuple[int, Path]:
    output = chart.parent / "camera.usda"
    return main(["-q", "calibrate", "camera", str(chart), "-o", str(output), *options]), output


def refused(capsys: pytest.CaptureFixture[str], chart: Path, *options: str, code: int = 3) -> str:
    """Return the one line with which a calibration is refused; nothing is left."""
    before = sorted(chart.parent.iterdir())
    capsys.readouterr()
    status, _ = calibrate(chart, *options)
    said = capsys.readouterr().err
    lines = [line for line in said.splitlines() if line.startswith("usdskin: error")]
    assert status == code, said
    assert len(lines) == 1, said
    assert "Traceback" not in said
    assert sorted(chart.parent.iterdir()) == before
    return lines[0]


# --- What a calibration holds ------------------------------------------------------------------


def test_the_layer_holds_what_recovers_the_spectra(tmp_path):
    chart = seen_chart()
    status, output = calibrate(write_chart(tmp_path / "chart.usda", chart))
    assert status == 0
    camera = read_spectral_camera(open_stage(output))
    recovery = camera.recoveries[0]
    _, surface = reflectances("babel_average")
    light = illuminant("FL2", GRID) * 1e-4
    spectra = (surface * light) @ sensitivity() * 1e-3 @ recovery.matrix.T
    product = (spectra * surface * light).sum(axis=1)
    gfc = product / np.linalg.norm(spectra, axis=1) / np.linalg.norm(surface * light, axis=1)
    assert gfc.mean() >= 0.98
    assert recovery.light_class == "lamp"
    assert recovery.patches == chart.patches
    assert camera.units == "absolute"
    assert camera.model == "Nikon D5100"
    assert camera.iso is not None and camera.iso.tolist() == [100.0]
    # The chart in the layer is what went in: the calibration can be made again from it.
    again = read_color_charts(open_stage(output))[0]
    np.testing.assert_allclose(again.camera_values, chart.camera_values, rtol=1e-12)
    np.testing.assert_allclose(again.signals, chart.signals, rtol=1e-12)


def test_a_camera_layer_calibrates_again_to_itself(tmp_path):
    _, first = calibrate(write_chart(tmp_path / "chart.usda", seen_chart()))
    again = tmp_path / "again.usda"
    assert main(["-q", "calibrate", "camera", str(first), "-o", str(again)]) == 0
    one, two = (read_spectral_camera(open_stage(path)) for path in (first, again))
    np.testing.assert_allclose(two.recoveries[0].matrix, one.recoveries[0].matrix, rtol=1e-9)


@pytest.mark.parametrize("estimator", ["regression", "literal", "tsvd", "pca", "wiener", "smooth"])
def test_every_estimator_is_there_and_the_printed_formula_is_the_worst(tmp_path, estimator):
    status, output = calibrate(
        write_chart(tmp_path / "chart.usda", seen_chart()), "--estimator", estimator
    )
    assert status == 0
    recovery = read_spectral_camera(open_stage(output)).recoveries[0]
    assert recovery.estimator == estimator
    assert (recovery.posterior_stddev is not None) == (estimator == "wiener")
    if estimator == "literal":
        assert recovery.loo_gfc < 0.5
    elif estimator != "tsvd":
        assert recovery.loo_gfc > 0.95


def test_reflectances_and_a_lamp_are_as_good_as_signals(tmp_path):
    chart = seen_chart(noise=0.0)
    _, surface = reflectances()
    light = Spectrum(SpectralQuantity.RADIANCE, GRID, illuminant("FL2", GRID) * 1e-4)
    other = replace(chart, signals=None, reflectances=surface, illuminant=light)
    matrices = []
    for name, given in (("signals", chart), ("reflectances", other)):
        folder = tmp_path / name
        folder.mkdir()
        status, output = calibrate(write_chart(folder / "chart.usda", given))
        assert status == 0
        matrices.append(read_spectral_camera(open_stage(output)).recoveries[0].matrix)
    np.testing.assert_allclose(matrices[1], matrices[0], rtol=1e-6, atol=1e-6 * matrices[0].max())


@pytest.mark.parametrize("transposed", [False, True])
def test_an_instruments_file_is_read_whichever_way_it_lies(tmp_path, transposed):
    chart = seen_chart()
    table = write_table(tmp_path / "signals.csv", chart, transposed=transposed)
    layer = replace(chart, signals=None, wavelength_nm=None, signals_file=table)
    status, output = calibrate(write_chart(tmp_path / "chart.usda", layer))
    assert status == 0
    again = read_color_charts(open_stage(output))[0]
    np.testing.assert_allclose(again.signals, chart.signals, rtol=1e-6)


def test_patches_are_matched_by_name_in_any_order(tmp_path):
    chart = seen_chart()
    order = np.random.default_rng(1).permutation(24)
    table = write_table(tmp_path / "signals.csv", with_rows(chart, order))
    layer = replace(chart, signals=None, wavelength_nm=None, signals_file=table)
    status, output = calibrate(write_chart(tmp_path / "chart.usda", layer))
    assert status == 0
    again = read_color_charts(open_stage(output))[0]
    np.testing.assert_allclose(again.signals, chart.signals, rtol=1e-6)


def test_two_charts_make_two_classes_of_light(tmp_path):
    tubes = write_chart(tmp_path / "a.usda", replace(seen_chart("FL2"), light_class="tubes"))
    window = write_chart(tmp_path / "b.usda", replace(seen_chart("D65"), light_class="window"))
    output = tmp_path / "camera.usda"
    assert main(["-q", "calibrate", "camera", str(tubes), str(window), "-o", str(output)]) == 0
    camera = read_spectral_camera(open_stage(output))
    assert [recovery.light_class for recovery in camera.recoveries] == ["tubes", "window"]
    assert len(camera.charts) == 2


def test_left_out_patches_are_left_out(tmp_path):
    status, output = calibrate(
        write_chart(tmp_path / "chart.usda", seen_chart()), "--exclude", "dark skin,A2"
    )
    assert status == 0
    patches = read_spectral_camera(open_stage(output)).recoveries[0].patches
    assert len(patches) == 22
    assert not {"dark skin", "light skin"} & set(patches)


def test_the_same_chart_gives_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    chart = write_chart(tmp_path / "chart.usda", seen_chart())
    _, output = calibrate(chart, "--estimator", "wiener")
    first = output.read_bytes()
    calibrate(chart, "--estimator", "wiener")
    assert output.read_bytes() == first


def test_json_tells_the_figures(tmp_path, capsys):
    chart = write_chart(tmp_path / "chart.usda", seen_chart())
    output = tmp_path / "camera.usda"
    assert main(["--json", "calibrate", "camera", str(chart), "-o", str(output)]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    found = next(event for event in events if event["event"] == "calibration")
    assert found["classes"][0]["gfc"] > 0.98
    assert events[-1] == {"event": "wrote", "path": str(output)}


def test_info_tells_what_a_calibration_is_like(tmp_path, capsys):
    _, output = calibrate(
        write_chart(tmp_path / "chart.usda", seen_chart()), "--estimator", "wiener"
    )
    capsys.readouterr()
    assert main(["--json", "info", str(output)]) == 0
    report = next(
        event
        for event in map(json.loads, capsys.readouterr().out.splitlines())
        if "recoveries" in event
    )
    row = report["recoveries"][0]
    assert row["class"] == "lamp"
    assert row["dE skin"] > 0.0
    assert report["calibrations"][0]["model"] == "Nikon D5100"
    assert report["problems"] == []


# --- What is refused ---------------------------------------------------------------------------


def test_percent_reflectances_are_seen_for_what_they_are(tmp_path):
    chart = seen_chart(noise=0.0)
    names, surface = reflectances()
    percent = replace(chart, wavelength_nm=GRID, signals=100.0 * surface)
    table = write_table(tmp_path / "percent.csv", percent)
    layer = replace(
        chart, signals=None, wavelength_nm=None, reflectances_file=table, illuminant_name="FL2",
        units="relative",
    )  # fmt: skip
    status, output = calibrate(write_chart(tmp_path / "chart.usda", layer))
    assert status == 0
    camera = read_spectral_camera(open_stage(output))
    white = camera.charts[0].signals[names.index("white 9.5 (.05 D)")]
    assert 0.8 < (white / camera.recoveries[0].illuminant).mean() < 1.0


def test_patches_in_the_wrong_order_are_told(tmp_path, capsys):
    chart = seen_chart()
    turned = replace(chart, camera_values=chart.camera_values[::-1])
    said = refused(capsys, write_chart(tmp_path / "chart.usda", turned))
    assert "chart.usda </Chart>" in said
    assert "180" in said or "upside" in said or "revers" in said


def test_greys_alone_cannot_calibrate(tmp_path, capsys):
    said = refused(
        capsys, write_chart(tmp_path / "chart.usda", with_rows(seen_chart(), range(18, 24)))
    )
    assert "</Chart>" in said


def test_two_patches_cannot_calibrate(tmp_path, capsys):
    said = refused(capsys, write_chart(tmp_path / "chart.usda", with_rows(seen_chart(), [0, 1])))
    assert "3" in said


def test_wavelengths_that_miss_the_grid_are_refused(tmp_path, capsys):
    chart = replace(seen_chart(), wavelength_nm=GRID + 400.0)
    said = refused(capsys, write_chart(tmp_path / "chart.usda", chart))
    assert "800 to 1100 nm" in said and "400 to 700 nm" in said


def test_reflectances_need_a_lamp(tmp_path, capsys):
    _, surface = reflectances()
    chart = replace(seen_chart(), signals=None, reflectances=surface)
    assert "lamp" in refused(capsys, write_chart(tmp_path / "chart.usda", chart))


def test_negative_signals_are_refused_where_they_are(tmp_path, capsys):
    chart = seen_chart()
    signals = chart.signals.copy()
    signals[3, 7] = -1.0
    table = write_table(tmp_path / "signals.csv", replace(chart, signals=signals))
    layer = replace(chart, signals=None, wavelength_nm=None, signals_file=table)
    said = refused(capsys, write_chart(tmp_path / "chart.usda", layer))
    assert "signals.csv" in said and "foliage" in said and "435" in said


def test_two_charts_of_one_class_are_refused(tmp_path, capsys):
    for name in ("a", "b"):
        write_chart(tmp_path / f"{name}.usda", seen_chart())
    said = refused(capsys, tmp_path / "a.usda", str(tmp_path / "b.usda"))
    assert "chart:lightClass" in said


def test_charts_of_two_cameras_are_refused(tmp_path, capsys):
    write_chart(tmp_path / "a.usda", seen_chart())
    other = replace(seen_chart(), light_class="other", model="Canon 5D")
    write_chart(tmp_path / "b.usda", other)
    said = refused(capsys, tmp_path / "a.usda", str(tmp_path / "b.usda"))
    assert "Canon 5D" in said and "Nikon D5100" in said


def test_a_class_needs_a_name_that_usd_can_use(tmp_path, capsys):
    chart = replace(seen_chart(), light_class="tube light")
    assert "tube light" in refused(capsys, write_chart(tmp_path / "chart.usda", chart))


def test_a_chart_is_never_overwritten(tmp_path, capsys):
    chart = write_chart(tmp_path / "chart.usda", seen_chart())
    before = chart.read_bytes()
    assert main(["-q", "calibrate", "camera", str(chart), "-o", str(chart)]) == 2
    assert chart.read_bytes() == before


def test_an_unknown_patch_cannot_be_left_out(tmp_path, capsys):
    chart = write_chart(tmp_path / "chart.usda", seen_chart())
    assert "chartreuse" in refused(capsys, chart, "--exclude", "chartreuse", code=2)


def test_a_chart_layer_without_a_chart_says_so(tmp_path, capsys):
    layer = tmp_path / "empty.usda"
    layer.write_text('#usda 1.0\n(upAxis = "Y"\nmetersPerUnit = 1)\ndef Xform "A" {}\n')
    assert "ColorChartAPI" in refused(capsys, layer)


def test_a_figure_is_checked_before_the_work(tmp_path, capsys):
    chart = write_chart(tmp_path / "chart.usda", seen_chart())
    refused(capsys, chart, "--plot", str(tmp_path / "figure.gif"), code=2)
    refused(capsys, chart, "--plot", str(chart), code=2)
    assert not (tmp_path / "camera.usda").exists()
