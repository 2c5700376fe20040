"""The virtual photographer of charts against closed forms, and against our own chart sampling."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from usdskin import fisheye as lens_code
from usdskin.colorimetry import illuminant, xyz_weights
from usdskin.commands.photograph import photograph as command
from usdskin.commands.reporter import GlobalOptions
from usdskin.device import Workers
from usdskin.errors import LayerError, UsageError
from usdskin.estimate.chart.layouts import LAYOUTS
from usdskin.images import read_image
from usdskin.judge.shoot import charts
from usdskin.judge.shoot.chart_patches import CLASSIC, CLASSIC_SET, DIGITAL_SG, read_chart
from usdskin.judge.shoot.chart_scenes import (
    ChartScene,
    brightest_direction,
    chart_outline,
    chart_pose,
    facing_rotation,
    project,
)
from usdskin.judge.shoot.charts import (
    ChartSetup,
    Instrument,
    chart_of,
    photograph_chart,
    read_chart_truth,
    with_camera_of,
)
from usdskin.judge.shoot.environments import Environment, LightDisc, LightMap, read_environment
from usdskin.judge.shoot.optics import Picture
from usdskin.judge.shoot.photographer import Setup, fisheye, photograph
from usdskin.judge.shoot.sensitivity import read_sensitivity
from usdskin.judge.shoot.sensor import Sensor, exposure_list, exposure_series
from usdskin.judge.shoot.shoot_layers import read_truth
from usdskin.judge.shoot.spectrophotometer import READING_NM
from usdskin.layers import open_stage
from usdskin.prims import read_color_charts
from usdskin.render.lights import read_lights
from usdskin.spectrafiles import read_spectra, single_spectrum
from usdskin.spectrum import SpectralQuantity
from usdskin.validate import validate

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdLux

ROOM = Path(__file__).resolve().parents[1] / "stages" / "capture_room" / "room.usda"
ALONE = Workers("cpu", 1)
X, Y, Z = np.eye(3)
NM = np.arange(380.0, 781.0, 20.0)
EXACT = Instrument(noise=0.0, offset=0.0)
EVEN = Environment((LightMap(np.ones((4, 8, 4), np.float32), np.eye(3)),))


@pytest.fixture(scope="module")
def camera_file(tmp_path_factory):
    """Return a camera of three smooth curves; colour-science takes seconds to load."""
    nm = np.arange(400.0, 701.0, 10.0)
    curves = [np.exp(-0.5 * ((nm - middle) / 35.0) ** 2) for middle in (600.0, 540.0, 460.0)]
    path = tmp_path_factory.mktemp("camera") / "acme.csv"
    rows = zip(nm, *curves, strict=True)
    path.write_text(
        "nm,R,G,B\n" + "".join(f"{a:g},{r:.9e},{g:.9e},{b:.9e}\n" for a, r, g, b in rows)
    )
    return str(path)


def some_chart(count=24, seed=1):
    """Return a chart of smooth reflectances of its own."""
    random = np.random.default_rng(seed)
    middle, width = (
        random.uniform(420.0, 680.0, (count, 1)),
        random.uniform(30.0, 150.0, (count, 1)),
    )
    bump = np.exp(-0.5 * ((NM - middle) / width) ** 2)
    values = random.uniform(0.03, 0.3, (count, 1)) + random.uniform(0.1, 0.6, (count, 1)) * bump
    return chart_of("ours", [f"p{k}" for k in range(count)], NM, values)


def stage_of(path: Path, *, lamp=None, dome=True, up="Y", intensity=1.0, absolute=False) -> Path:
    """Write a stage with an even D65 dome, a round lamp of 6 degrees, or both."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    prims = []
    if dome:
        light = UsdLux.DomeLight.Define(stage, "/Dome")
        light.CreateIntensityAttr(intensity)
        prims.append(light.GetPrim())
    if lamp is not None:
        light = UsdLux.DistantLight.Define(stage, "/Lamp")
        light.CreateAngleAttr(6.0)
        light.CreateNormalizeAttr(False)
        light.CreateIntensityAttr(200.0)
        turn = Gf.Rotation(Gf.Vec3d(0, 0, 1), Gf.Vec3d(*map(float, lamp)))
        UsdGeom.Xformable(light).AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(turn.GetQuat())
        prims.append(light.GetPrim())
    for prim in prims if absolute else ():
        prim.ApplyAPI("SpectralLightAPI")
        prim.GetAttribute("inputs:spectral:units").Set("absolute")
    stage.GetRootLayer().Save()
    return path


def small(camera_file, **changes) -> Setup:
    given = {
        "camera": camera_file,
        "lens": fisheye(160),
        "exposures": exposure_series(5, 2.0),
        "sensor": Sensor(is_noisy=False),
        "truth_height": 16,
    }
    return Setup(**{**given, **changes})


def held(**changes) -> ChartSetup:
    given = {"chart": some_chart(), "width_deg": 80.0, "corner_error_px": 0.0, "instrument": EXACT}
    return ChartSetup(**{**given, **changes})


def developed(folder: Path, setup: Setup):
    """Return rho V of a chart's photographs, each pixel from its longest exposure within range."""
    black, white = setup.sensor.black_level, setup.sensor.white_level
    found = None
    for path, exposure in zip(
        sorted((folder / "chart").glob("*.tif")), setup.exposures.exposure, strict=True
    ):
        level = (np.rint(read_image(path).pixels * 65535.0) - black) / (white - black)
        good = (level < 0.97).all(axis=-1, keepdims=True)
        rho = level / exposure
        found = (
            np.where(good, rho, np.nan)
            if found is None
            else np.where(np.isnan(found) & good, rho, found)
        )
    return found


def patch_places(lens, corners, layout):
    """Return the middles of patches by the lens code of capture: a homography of rays, px."""
    rays = lens_code.unproject(lens, corners)
    flat = rays[:, :2] / -rays[:, 2:]
    square = np.array([(0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0)])
    rows = []
    for (x, y), (u, v) in zip(square, flat, strict=True):
        rows.append([x, y, 1, 0, 0, 0, -u * x, -u * y, -u])
        rows.append([0, 0, 0, x, y, 1, -v * x, -v * y, -v])
    to_flat = np.linalg.svd(np.array(rows))[2][-1].reshape(3, 3)
    points = np.column_stack([layout.centers, np.ones(len(layout.centers))]) @ to_flat.T
    points = points[:, :2] / points[:, 2:]
    return lens_code.project(lens, np.column_stack([points, -np.ones(len(points))]))


def shade(lens, columns, rows):
    """Return V at pixels of an equidistant lens with the usual vignetting."""
    x, y = columns + 0.5 - lens.center_px[0], rows + 0.5 - lens.center_px[1]
    square = (x**2 + y**2) / lens.focal_length_px**2
    return 1.0 - 0.04 * square - 0.012 * square**2


# --- Light on the chart ------------------------------------------------------------------------


def test_signals_are_reflectance_times_irradiance_over_pi(tmp_path, camera_file):
    # An even dome of luminance 1: on any surface E = pi L, so a perfect diffuser shows L.
    stage = stage_of(tmp_path / "even.usda", absolute=True)
    photograph_chart(stage, tmp_path / "out", small(camera_file), held())
    truth = read_chart_truth(tmp_path / "out")
    d65 = illuminant("D65", READING_NM)
    d65 = d65 / (d65 @ xyz_weights(READING_NM, absolute=True)[:, 1])
    assert truth.chart.illuminant.value == pytest.approx(d65, rel=1e-4)  # texels of 90 degrees
    on_grid = np.array([np.interp(READING_NM, NM, row) for row in some_chart().reflectances])
    # Band averages of straight lines: they differ at the knots alone.
    assert truth.signals == pytest.approx(on_grid * d65, rel=0.02)
    assert truth.constants["illuminance"] == pytest.approx(np.pi, rel=1e-4)


def test_chart_under_a_round_lamp_has_the_closed_form(tmp_path, camera_file):
    stage = stage_of(tmp_path / "lamp.usda", lamp=(0, 1, 1), dome=False, absolute=True)
    photograph_chart(stage, tmp_path / "out", small(camera_file), held(facing=(0.0, 0.0, 2.0)))
    truth = read_chart_truth(tmp_path / "out")
    expected = 200.0 * np.sin(np.radians(3.0)) ** 2 * np.cos(np.radians(45.0))
    luminance = truth.chart.illuminant.value @ xyz_weights(READING_NM, absolute=True)[:, 1]
    assert luminance == pytest.approx(expected, rel=1e-6)
    assert truth.constants["illuminance"] == pytest.approx(np.pi * expected, rel=1e-6)
    assert np.array(truth.constants["facing"]) == pytest.approx(Z)


def test_camera_values_are_the_integral_of_signal_and_sensitivity(tmp_path, camera_file):
    stage = stage_of(tmp_path / "lit.usda", lamp=(1, 2, 0), absolute=True)
    photograph_chart(stage, tmp_path / "out", small(camera_file), held())
    truth = read_chart_truth(tmp_path / "out")
    camera = read_sensitivity(camera_file)
    at = np.searchsorted(READING_NM, camera.wavelength_nm)
    # Signals at the camera's own band centres; its bands are twice as wide as an instrument's.
    values = truth.signals[:, at] @ camera.value * 10.0 * truth.constants["sensorConstant"]
    assert truth.chart.camera_values == pytest.approx(values, rel=0.02)


def test_relative_light_is_read_in_absolute_units(tmp_path, camera_file):
    stage = stage_of(tmp_path / "even.usda", intensity=7.0)
    setup = small(camera_file, mean_luminance=250.0)
    photograph_chart(stage, tmp_path / "out", setup, held())
    truth = read_chart_truth(tmp_path / "out")
    luminance = truth.chart.illuminant.value @ xyz_weights(READING_NM, absolute=True)[:, 1]
    assert luminance == pytest.approx(250.0, rel=1e-3)
    assert truth.constants["illuminance"] == pytest.approx(250.0 * np.pi, rel=1e-3)
    assert read_color_charts(open_stage(tmp_path / "out" / "chart.usda"))[0].units == "absolute"


def test_chart_faces_where_illuminance_is_largest():
    towards = np.array([0.3, 0.5, -0.8]) / np.linalg.norm([0.3, 0.5, -0.8])
    lamp = LightDisc(np.full(4, 500.0), towards, np.radians(5.0))
    for up in "YZ":
        light = Environment((), (lamp,), up)
        assert brightest_direction(light) @ towards > np.cos(np.radians(4.0))


# --- What the camera sees ----------------------------------------------------------------------


@pytest.mark.parametrize("projection", ["equidistant", "equisolid", "stereographic"])
@pytest.mark.parametrize("count", [24, 140])
def test_patches_are_where_capture_looks_for_them(projection, count):
    grid = {24: CLASSIC, 140: DIGITAL_SG}[count]
    lens = fisheye(240, projection, vignetting=())
    pose = chart_pose(grid, 90.0, (8.0, -5.0), 7.0, 12.0)
    values = np.random.default_rng(5).uniform(0.1, 1.0, (count, 4))
    scene = ChartScene(EVEN, grid, pose, values, np.zeros(4))
    picture = Picture(scene, lens, np.eye(3)).draw(ALONE, lambda rows: None)
    corners = project(lens, chart_outline(grid, pose))
    assert corners == pytest.approx(lens_code.project(lens, chart_outline(grid, pose)), abs=1e-8)
    places = patch_places(lens, corners, LAYOUTS[grid.layout])
    columns, rows = np.floor(places).astype(int).T
    assert picture[rows, columns] == pytest.approx(values[:, :3], rel=1e-6)


def test_corners_are_the_outer_edges_of_the_corner_patches():
    lens = fisheye(240, vignetting=())
    pose = chart_pose(CLASSIC, 80.0, (4.0, 3.0), 5.0, 8.0)
    scene = ChartScene(EVEN, CLASSIC, pose, np.ones((24, 4)), np.zeros(4))
    lit = Picture(scene, lens, np.eye(3)).draw(ALONE, lambda rows: None)[..., 1]
    outline = chart_outline(CLASSIC, pose)
    middle = outline.mean(axis=0)
    for corner in outline:
        inside, outside = (
            np.floor(project(lens, middle + share * (corner - middle))).astype(int)
            for share in (0.96, 1.04)
        )
        assert lit[inside[1], inside[0]] == 1.0
        assert lit[outside[1], outside[0]] == 0.0


def test_chart_is_upright_and_not_mirrored():
    pose = chart_pose(CLASSIC, 40.0, (0.0, 0.0), 0.0, 0.0)
    top_left, top_right, bottom_right, bottom_left = project(
        fisheye(400), chart_outline(CLASSIC, pose)
    )
    assert top_left[0] < top_right[0] and bottom_left[0] < bottom_right[0]
    assert top_left[1] < bottom_left[1] and top_right[1] < bottom_right[1]


@pytest.mark.parametrize("up", ["Y", "Z"])
@pytest.mark.parametrize("facing", [(0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-0.6, 0.3, -0.5)])
def test_camera_is_turned_so_that_the_chart_faces_the_light(up, facing):
    normal = np.array(facing) / np.linalg.norm(facing)
    pose = chart_pose(CLASSIC, 40.0, (3.0, 2.0), 6.0, 10.0)
    to_panorama = Environment((), (), up).panorama_from_world
    rotation = facing_rotation(pose, normal, to_panorama)
    assert rotation @ pose.axes[:, 2] == pytest.approx(normal)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    upward = Y if up == "Y" else Z
    if abs(normal @ upward) < 0.99:
        assert rotation @ pose.axes[:, 1] @ upward > 0.0
        assert rotation @ pose.axes[:, 0] @ upward == pytest.approx(0.0, abs=1e-12)
    tilt = np.degrees(np.arccos(-pose.axes[:, 2] @ pose.center / np.linalg.norm(pose.center)))
    assert tilt == pytest.approx(6.0)


def test_photographs_show_the_true_camera_values(tmp_path, camera_file):
    stage = stage_of(tmp_path / "lit.usda", lamp=(0, 1, 0.5))
    setup = small(camera_file, lens=fisheye(240, glare=0.02))
    photograph_chart(stage, tmp_path / "out", setup, held())
    truth = read_chart_truth(tmp_path / "out")
    chart = read_color_charts(open_stage(tmp_path / "out" / "chart.usda"))[0]
    assert chart.corners == pytest.approx(truth.chart.corners, abs=1e-4)  # one precision is single
    rho = developed(tmp_path / "out", setup)
    held_px = np.hypot(*(np.indices(rho.shape[:2]) + 0.5 - 120.0)) <= 120.0
    # (1 - g) I + g mean(I) has the mean of I, whose veil is taken off here.
    veil = 0.02 * rho[held_px].mean(axis=0)
    places = patch_places(truth.lens, truth.chart.corners, LAYOUTS["classic24"])
    columns, rows = np.floor(places).astype(int).T
    seen = (rho[rows, columns] - veil) / 0.98 / shade(truth.lens, columns, rows)[:, None]
    assert seen == pytest.approx(truth.chart.camera_values, rel=3e-3)


def test_noise_averages_out(tmp_path, camera_file):
    stage = stage_of(tmp_path / "even.usda")
    setup = small(camera_file, sensor=Sensor())
    photograph_chart(stage, tmp_path / "out", setup, held())
    truth = read_chart_truth(tmp_path / "out")
    rho = developed(tmp_path / "out", setup)
    places = patch_places(truth.lens, truth.chart.corners, LAYOUTS["classic24"])
    columns, rows = np.floor(places).astype(int).T
    blocks = np.stack([rho[rows + i, columns + j] for i in (-1, 0, 1) for j in (-1, 0, 1)])
    mean = blocks.mean(axis=0) / shade(truth.lens, columns, rows)[:, None]
    assert (blocks.std(axis=0) > 0.0).all()
    assert mean == pytest.approx(truth.chart.camera_values, rel=0.02)


# --- Files -------------------------------------------------------------------------------------


def test_layer_tells_what_a_photographer_of_charts_knows(tmp_path, camera_file):
    stage = stage_of(tmp_path / "lit.usda", lamp=(0, 1, 0.5), up="Z")
    setup = small(
        camera_file, lens=fisheye(160, glare=0.01), vignetting_error=0.03, stated_glare=0.0
    )
    path = photograph_chart(stage, tmp_path / "out", setup, held(light_class="lamp"))
    assert path == tmp_path / "out" / "chart.usda"
    assert [str(found) for found in validate(path)] == []
    assert [str(found) for found in validate(path.parent / "truth" / "chart.usda")] == []
    chart = read_color_charts(open_stage(path))[0]
    assert (chart.layout, chart.light_class, chart.model) == ("classic24", "lamp", "acme")
    assert chart.lens == "equidistant fisheye 180 deg"
    assert chart.patches == some_chart().patches
    assert chart.iso.tolist() == [100.0]
    assert len(chart.view.bracket.images) == 5
    assert chart.view.lens.glare == 0.0
    assert not np.allclose(chart.view.lens.vignetting[:2], setup.lens.vignetting)
    truth = read_chart_truth(path.parent)
    assert truth.lens.glare == 0.01
    assert truth.lens.vignetting == pytest.approx(setup.lens.vignetting)
    assert "truth" not in path.read_text()


def test_readings_are_what_a_spectra_file_holds(tmp_path, camera_file):
    stage = stage_of(tmp_path / "lit.usda", lamp=(0, 1, 0.5), absolute=True)
    path = photograph_chart(stage, tmp_path / "out", small(camera_file), held())
    chart, truth = read_color_charts(open_stage(path))[0], read_chart_truth(path.parent)
    notes = []
    read = read_spectra(chart.signals_file, notes)
    assert notes == []
    assert read.names == some_chart().patches
    assert read.quantity is SpectralQuantity.RADIANCE
    assert read.wavelength_nm == pytest.approx(READING_NM)
    assert read.values == pytest.approx(truth.signals, rel=1e-6)
    nm, lamp = single_spectrum(chart.illuminant_file)[:2]
    assert nm == pytest.approx(READING_NM)
    assert lamp == pytest.approx(truth.chart.illuminant.value, rel=1e-6)


def test_instrument_errs_as_it_says():
    true = np.linspace(1e-9, 1.0, 40001)
    read = Instrument(noise=0.003, offset=1e-4).read(true, 1.0, [7])
    assert read.min() == 0.0
    bright = true > 0.5
    assert (read / true)[bright].std() == pytest.approx(0.003, rel=0.02)
    assert (read - true)[true < 0.002].std() < 1.2e-4
    assert np.array_equal(read, Instrument(0.003, 1e-4).read(true, 1.0, [7]))
    assert not np.array_equal(read, Instrument(0.003, 1e-4).read(true, 1.0, [8]))
    assert np.array_equal(EXACT.read(true, 1.0, [7]), true)


def test_same_seed_gives_the_same_chart_whatever_the_threads(tmp_path, camera_file):
    stage = stage_of(tmp_path / "lit.usda", lamp=(0, 1, 0.5))
    setup = small(camera_file, sensor=Sensor(), exposures=exposure_series(2))
    chosen = held(instrument=Instrument(), corner_error_px=1.0)
    for name, threads in (("a", 1), ("b", 3)):
        photograph_chart(stage, tmp_path / name, setup, chosen, threads=threads)
    for file in ("chart/00.tif", "chart/01.tif", "chart/signals.csv", "chart/illuminant.csv"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()
    charts_of = [read_color_charts(open_stage(tmp_path / n / "chart.usda"))[0] for n in "ab"]
    assert np.array_equal(charts_of[0].corners, charts_of[1].corners)
    off = charts_of[0].corners - read_chart_truth(tmp_path / "a").chart.corners
    assert 0.2 < np.sqrt((off**2).mean()) < 2.0
    photograph_chart(stage, tmp_path / "c", replace(setup, seed=1), chosen)
    other = (tmp_path / "c" / "chart" / "signals.csv").read_bytes()
    assert other != (tmp_path / "a" / "chart" / "signals.csv").read_bytes()


def test_interrupted_chart_leaves_nothing(tmp_path, camera_file, monkeypatch):
    def interrupt(*_given, **_more):
        raise KeyboardInterrupt

    monkeypatch.setattr(charts, "write_chart_layer", interrupt)
    stage = stage_of(tmp_path / "even.usda")
    with pytest.raises(KeyboardInterrupt):
        photograph_chart(stage, tmp_path / "out", small(camera_file), held())
    assert [path.name for path in tmp_path.iterdir()] == ["even.usda"]


def test_views_and_chart_of_one_folder_share_the_camera(tmp_path, camera_file):
    stage = stage_of(tmp_path / "even.usda")
    setup = small(camera_file, exposures=exposure_list([0.1, 0.01]))
    path = photograph_chart(stage, tmp_path / "out", setup, held(), with_views=True)
    shoot, chart = read_truth(path.parent), read_chart_truth(path.parent)
    assert shoot.constants["sensorConstant"] == chart.constants["sensorConstant"]
    photograph(stage, tmp_path / "plain", setup)
    for file in ("view0/00.tif", "view2/01.tif"):
        same = (tmp_path / "plain" / file).read_bytes()
        assert (tmp_path / "out" / file).read_bytes() == same
    # The panorama shows the even dome, of which a perfect diffuser is as bright.
    rho = chart.chart.camera_values[0] / shoot.values.mean(axis=(0, 1))
    assert (rho > 0.03).all() and (rho < 0.9).all()


# --- One camera in several lights --------------------------------------------------------------


def test_camera_is_carried_on_from_a_shoot_or_a_chart(tmp_path, camera_file):
    dim, bright = (stage_of(tmp_path / f"{k}.usda", intensity=float(k)) for k in (1, 6))
    lens = fisheye(180, "equisolid", 170.0, glare=0.01)
    first = small(camera_file, lens=lens, sensor=Sensor(full_well=40000.0, is_noisy=False))
    photograph(dim, tmp_path / "shoot", first)
    photograph_chart(dim, tmp_path / "chart", first, held())
    for name in ("shoot", "chart"):
        setup = with_camera_of(tmp_path / name, small(camera_file))
        assert setup.sensor.full_well == 40000.0
        assert (setup.lens.projection, setup.lens.glare) == ("equisolid", 0.01)
        photograph_chart(bright, tmp_path / f"{name}2", setup, held())
        values = read_chart_truth(tmp_path / f"{name}2").chart.camera_values
        before = read_chart_truth(tmp_path / "chart").chart.camera_values
        assert values / before == pytest.approx(6.0, rel=1e-5)
    other = Path(camera_file).with_name("other.csv")
    other.write_text(Path(camera_file).read_text())
    with pytest.raises(UsageError, match="was taken by acme, not by other"):
        with_camera_of(tmp_path / "shoot", small(str(other)))
    with pytest.raises(LayerError, match="no such file"):
        with_camera_of(tmp_path, small(camera_file))


# --- Charts ------------------------------------------------------------------------------------


def write_reflectances(path: Path, count: int, scale=1.0) -> Path:
    chart_rows = np.random.default_rng(2).uniform(0.05, 0.9, (count, NM.size)) * scale
    lines = [",".join(["patch", *(f"{nm:g}" for nm in NM)])]
    lines += [
        ",".join([f"patch {k}", *(f"{value:.6f}" for value in row)])
        for k, row in enumerate(chart_rows)
    ]
    path.write_text("\n".join(lines) + "\n")
    return path


def test_chart_comes_from_a_file(tmp_path):
    for count, layout in ((24, "classic24"), (140, "sg140")):
        chart = read_chart(str(write_reflectances(tmp_path / f"c{count}.csv", count)))
        assert (chart.grid.layout, len(chart.patches)) == (layout, count)
        assert chart.reflectances.shape == (count, NM.size)
    with pytest.raises(UsageError, match="has 25 patches; give the 24"):
        read_chart(str(write_reflectances(tmp_path / "odd.csv", 25)))
    with pytest.raises(UsageError, match="neither classic24 nor a file"):
        read_chart("classic25")
    with pytest.raises(UsageError, match="name a file with the 140 spectra"):
        read_chart("sg140")


def test_classic_chart_is_the_one_of_colour_science():
    chart = read_chart("classic24")
    assert chart.name == CLASSIC_SET
    assert chart.patches == LAYOUTS["classic24"].names
    assert chart.reflectances.shape == (24, 81)
    green = chart.reflectances[:, chart.wavelength_nm == 550.0].ravel()
    assert 0.85 < green[18] < 0.95  # white
    assert 0.02 < green[23] < 0.05  # black
    assert (np.diff(green[18:]) < 0.0).all()


def test_layouts_agree_with_those_of_the_calibration():
    for grid in (CLASSIC, DIGITAL_SG):
        layout = LAYOUTS[grid.layout]
        assert grid.places.tolist() == layout.positions.tolist()
        assert 1.0 / grid.size == pytest.approx(2.0 * layout.half_size)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"width_deg": 0.0}, "angle that the chart fills is 0"),
        ({"facing": (0.0, 0.0, 0.0)}, "give a direction"),
        ({"light_class": "two words"}, "cannot be called 'two words'"),
        ({"tilt_deg": float("nan")}, "tilt of the chart is nan"),
        ({"off_axis_deg": (55.0, 0.0), "width_deg": 100.0}, "not wholly in the picture"),
        ({"width_deg": 9.0}, r"patch of the chart is \d\.\d px wide"),
    ],
)
def test_chart_that_cannot_be_photographed_is_refused(tmp_path, camera_file, changes, match):
    stage = stage_of(tmp_path / "even.usda")
    with pytest.raises(UsageError, match=match):
        photograph_chart(stage, tmp_path / "out", small(camera_file), held(**changes))
    assert not (tmp_path / "out").exists()


def test_command_photographs_a_chart(tmp_path, camera_file):
    stage = stage_of(tmp_path / "even.usda")
    file = write_reflectances(tmp_path / "chart.csv", 24)

    def refusal(result):
        assert isinstance(result.exception, UsageError)
        return str(result.exception)

    def run(given):
        return CliRunner().invoke(command, given.split(), obj=GlobalOptions())

    camera = f"--camera {camera_file} --exposures 2 -q"
    given = f"{stage} -o {tmp_path / 'a'} {camera} --size 160 --chart {file} --light-class day"
    result = run(given)
    assert result.exit_code == 0, result.output
    assert result.stdout.split() == [str(tmp_path / "a" / f"{n}.usda") for n in ("shoot", "chart")]
    assert read_color_charts(open_stage(tmp_path / "a" / "chart.usda"))[0].light_class == "day"
    given = f"{stage} -o {tmp_path / 'b'} {camera} --same-camera {tmp_path / 'a'} --chart {file}"
    result = run(f"{given} --chart-only --chart-facing 0,0,1")
    assert result.exit_code == 0, result.output
    assert not (tmp_path / "b" / "shoot.usda").exists()
    assert np.array(read_chart_truth(tmp_path / "b").constants["facing"]) == pytest.approx(Z)
    wrong = {"--size 90": "--size:", "--glare 0.1": "--glare:", "--chart-facing 0,1": "three"}
    for more, text in wrong.items():
        assert text in refusal(run(f"{given.replace('/b', '/c')} {more}"))
    plain = f"{stage} -o {tmp_path / 'c'} {camera}"
    assert "there is no chart" in refusal(run(f"{plain} --chart-only"))
    assert "add --chart" in refusal(run(f"{plain} --light-class day"))
    assert not (tmp_path / "c").exists()


# --- The shipped room in one lamp's light ------------------------------------------------------


@pytest.fixture(scope="module")
def room_layers():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(str(ROOM.parent))
        yield importlib.import_module("room_layers")


def test_tubes_and_window_add_up_to_the_room(room_layers):
    nm = room_layers.WAVELENGTH_NM
    domes = {
        name: read_lights(open_stage(ROOM.with_name(f"{name}.usda")), 0, nm).domes[0]
        for name in ("room", "tubes", "window")
    }
    assert all(dome.absolute for dome in domes.values())
    every = [slice(None, None, 16), slice(None, None, 16)]
    light = {
        name: dome.coefficients[tuple(every)] @ dome.basis.astype(np.float64)
        for name, dome in domes.items()
    }
    assert light["tubes"] + light["window"] == pytest.approx(light["room"], rel=1e-5)
    assert light["tubes"].max() > 0.0
    assert light["window"].max() > 0.0


@pytest.mark.parametrize("name", ["tubes", "window"])
def test_room_in_one_light_is_valid_and_what_its_script_makes(name, room_layers, tmp_path):
    path = ROOM.with_name(f"{name}.usda")
    assert [str(found) for found in validate(path)] == []
    spectra, lamp = room_layers.basis(), room_layers.ALONE[name]
    room_layers.write_stage_alone(tmp_path / f"{name}.usda", spectra, lamp)
    assert (tmp_path / f"{name}.usda").read_bytes() == path.read_bytes()
    room = read_image(ROOM.with_name("room.exr"), channels=[f"c{k}" for k in range(6)]).pixels
    made = room_layers.rendition(room, room_layers.alone(spectra, lamp), smaller=4)
    shown = read_image(ROOM.with_name(f"{name}_rgb.exr")).pixels
    assert np.abs(made - shown).max() <= 1e-3 * made.max()


def test_environment_of_the_tubes_is_one_lamps(camera_file):
    camera = read_sensitivity(camera_file)
    parts = [read_environment(ROOM.with_name(f"{n}.usda"), camera) for n in ("tubes", "window")]
    whole = read_environment(ROOM, camera)
    together = sum(part.irradiance(Y) for part in parts)
    assert together == pytest.approx(whole.irradiance(Y), rel=1e-4)
