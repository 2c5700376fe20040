"""From photographs to a spectral light, through the command line, against the room's own light."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pxr import Usd

from usdskin.cli import main
from usdskin.judge.relit_skin import compare_lights, spectral_irradiance
from usdskin.judge.shoot.charts import ChartSetup, photograph_chart, with_camera_of
from usdskin.judge.shoot.photographer import photograph
from usdskin.judge.shoot.setups import Setup, fisheye
from usdskin.layers import open_stage
from usdskin.prims import read_light_estimate, read_spectral_light
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as GRID
from usdskin.spectrum import resample

pytestmark = pytest.mark.slow

ROOM = Path(__file__).resolve().parents[1] / "stages" / "capture_room"
LAMPS = {"tubes": ROOM / "tubes.usda", "window": ROOM / "window.usda"}


def run(*arguments: str | Path) -> None:
    assert main(["-q", *map(str, arguments)]) == 0


def normals(count: int) -> np.ndarray:
    index = np.arange(count) + 0.5
    y = 1.0 - 2.0 * index / count
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - y * y)
    return np.stack([radius * np.cos(turn), y, radius * np.sin(turn)], axis=-1)


@pytest.fixture(scope="module")
def skins() -> np.ndarray:
    """Skins that are on no chart: test colors 15 and 18 of CIE 224:2017."""
    from colour import SpectralShape
    from colour.quality.cfi2017 import load_TCS_CIE2017

    colors = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    return np.stack([resample(colors.wavelengths, colors.values[:, i], GRID) for i in (14, 17)])


@pytest.fixture(scope="module")
def studio(tmp_path_factory) -> Path:
    """A chart photographed in each lamp, both rooms captured, one calibration of both."""
    folder = tmp_path_factory.mktemp("studio")
    setup = Setup(lens=fisheye(900))
    for name, lamp in LAMPS.items():
        photograph_chart(lamp, folder / name, setup, ChartSetup(light_class=name))
        setup = with_camera_of(folder / "tubes", setup)
    for name, room in (("lit", LAMPS["tubes"]), ("both", ROOM / "room.usda")):
        photograph(room, folder / name, replace(setup, lens=fisheye(500)))
        shoot, capture = folder / name / "shoot.usda", folder / name / "capture.usda"
        run("capture", shoot, "-o", capture, "-w", "512")
    charts = [folder / name / "chart.usda" for name in LAMPS]
    run("calibrate", "camera", *charts, "-o", folder / "camera.usda")
    run("calibrate", "camera", charts[0], "-o", folder / "tubes.usda")
    return folder


@pytest.fixture(scope="module")
def light(studio) -> Path:
    output = studio / "lit" / "light.usda"
    run("estimate", "light", studio / "lit" / "capture.usda", "--camera", studio / "tubes.usda",
        "-o", output)  # fmt: skip
    return output


@pytest.fixture(scope="module")
def mixed(studio) -> Path:
    output = studio / "both" / "light.usda"
    run("estimate", "light", studio / "both" / "capture.usda", "--camera", studio / "camera.usda",
        "-o", output)  # fmt: skip
    return output


def test_skin_in_the_estimated_light_of_one_lamp_looks_as_in_the_true_one(light, skins):
    found = compare_lights(LAMPS["tubes"], light, skins, normals(32), GRID)
    assert found.mean <= 0.3
    assert found.max <= 0.6


def test_skin_in_mixed_light_looks_as_in_the_true_one(mixed, skins):
    found = compare_lights(ROOM / "room.usda", mixed, skins, normals(32), GRID)
    assert found.mean <= 0.5
    assert found.p95 <= 1.2


def test_the_spectra_are_those_of_the_lamp_lines_and_all(light):
    true = spectral_irradiance(LAMPS["tubes"], normals(8), GRID)
    found = spectral_irradiance(light, normals(8), GRID)
    product = (true * found).sum(axis=1)
    gfc = product / np.linalg.norm(true, axis=1) / np.linalg.norm(found, axis=1)
    assert gfc.min() >= 0.99


def test_the_layer_says_how_the_light_came_about(light, mixed):
    stage = open_stage(light)
    prim = stage.GetDefaultPrim()
    assert prim.GetTypeName() == "DomeLight"
    spectral = read_spectral_light(prim)
    assert spectral.source == "basis" and spectral.units == "absolute"
    assert spectral.basis.shape == (3, 61)
    found = read_light_estimate(prim)
    assert found.origin == "measured"
    assert found.mean is not None and found.mean.value.shape == (61,)
    assert 3500.0 < found.cct < 5000.0  # FL2 is 4230 K
    assert prim.GetAttribute("inputs:texture:file").Get()
    other = open_stage(mixed)
    both = read_light_estimate(other.GetDefaultPrim())
    assert both.classes == ("tubes", "window")
    assert sum(both.class_shares) == pytest.approx(1.0, abs=1e-6)


def test_another_machine_gets_the_same_light(studio, light, tmp_path):
    """Only the camera's layer and the capture travel."""
    shutil.copy(studio / "tubes.usda", tmp_path / "camera.usda")
    for name in ("capture.usda", "panorama.exr", "stddev.exr"):
        shutil.copy(studio / "lit" / name, tmp_path / name)
    run("estimate", "light", tmp_path / "capture.usda", "--camera", tmp_path / "camera.usda",
        "-o", tmp_path / "light.usda")  # fmt: skip
    stages = [open_stage(path) for path in (light, tmp_path / "light.usda")]
    ours, theirs = (read_spectral_light(stage.GetDefaultPrim()) for stage in stages)
    np.testing.assert_array_equal(ours.basis, theirs.basis)
    assert ours.coefficients_file.read_bytes() == theirs.coefficients_file.read_bytes()


def test_a_stage_renders_in_the_estimated_light(light, tmp_path):
    shot = tmp_path / "shot.usda"
    shot.write_text(
        f"""#usda 1.0
(
    upAxis = "Y"
    metersPerUnit = 1
)
def "Light" (references = @{light}@) {{}}
def Sphere "Ball" {{}}
def Camera "Camera"
{{
    double3 xformOp:translate = (0, 0, 6)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
"""
    )
    run("render", shot, tmp_path / "shot.exr", "-w", "48", "--spectral")
    assert (tmp_path / "shot.spectral.exr").exists()
    assert main(["-q", "validate", str(light)]) == 0


def test_info_tells_what_a_light_is_like(mixed, capsys):
    capsys.readouterr()
    assert main(["--json", "info", str(mixed)]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    report = next(event for event in events if "estimates" in event)
    row = report["estimates"][0]
    assert row["origin"] == "measured"
    assert set(row["classes"]) == {"tubes", "window"}


@pytest.mark.parametrize(
    ("prim", "attribute", "value", "said"),
    [
        ("/Capture", "capture:settings:lens", "another lens", "another lens"),
        ("/Capture", "capture:settings:whiteBalance", "5600 K", "5600 K"),
        ("/Capture", "capture:settings:model", "Canon 5D", "Canon 5D"),
        ("/Capture", "capture:settings:iso", None, "ISO"),
    ],
)
def test_a_calibration_of_other_settings_is_refused(
    studio, tmp_path, capsys, prim, attribute, value, said
):
    for name in ("capture.usda", "panorama.exr", "stddev.exr"):
        shutil.copy(studio / "lit" / name, tmp_path / name)
    stage = Usd.Stage.Open(str(tmp_path / "capture.usda"))
    other = stage.GetPrimAtPath(prim).GetAttribute(attribute)
    if value is None:
        stage.GetPrimAtPath(prim).RemoveProperty(attribute)
    else:
        other.Set(value)
    stage.Save()
    before = sorted(path.name for path in tmp_path.iterdir())
    capsys.readouterr()
    status = main(
        ["-q", "estimate", "light", str(tmp_path / "capture.usda"), "--camera",
         str(studio / "tubes.usda"), "-o", str(tmp_path / "light.usda")]
    )  # fmt: skip
    error = capsys.readouterr().err
    assert status == 3
    assert said in error and "Traceback" not in error
    assert sorted(path.name for path in tmp_path.iterdir()) == before


def test_a_capture_without_a_camera_says_what_is_missing(studio, tmp_path, capsys):
    status = main(
        ["estimate", "light", str(studio / "lit" / "capture.usda"), "-o", str(tmp_path / "l.usda")]
    )
    assert status == 2
    assert "--camera" in capsys.readouterr().err
