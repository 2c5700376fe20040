"""``usdskin capture`` from photographs to light, against the truth the virtual camera kept."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from capture_truth import camera_values, error_of, irradiance, lamp_room, reduced, results

from usdskin import cli
from usdskin.capture.step import CaptureOptions, capture_shoot
from usdskin.images import Part, read_image, write_exr
from usdskin.judge.shoot.photographer import Setup, photograph
from usdskin.judge.shoot.sensor import exposure_list, exposure_series
from usdskin.judge.shoot.setups import fisheye
from usdskin.latlong import texel_directions
from usdskin.layers import open_stage
from usdskin.prims import SkinParameters, read_lens, write_skin
from usdskin.spectrum import SpectralQuantity, Spectrum
from usdskin.validate import validate

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

SIZE = 480
"""Pixels of a view where accuracy counts: the panorama has 512 x 256 texels."""

SMALL = 220
"""Pixels of a view elsewhere: the panorama has 256 x 128 texels."""

CAMERA_NM = np.arange(400.0, 701.0, 10.0)
Shooting = Callable[..., Path]


@pytest.fixture(scope="session")
def camera_file(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Return a camera of three broad Gaussians, so that nothing waits for colour-science."""
    path = tmp_path_factory.mktemp("camera") / "camera.csv"
    peaks = (600.0, 540.0, 450.0)
    rows = ["wavelength,R,G,B"]
    for nm in CAMERA_NM:
        values = (f"{np.exp(-(((nm - peak) / 40.0) ** 2)):.6f}" for peak in peaks)
        rows.append(",".join((f"{nm:g}", *values)))
    path.write_text("\n".join(rows) + "\n")
    return str(path)


@pytest.fixture(scope="session")
def room_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the picture of a room with lamps five decades above its corners."""
    path = tmp_path_factory.mktemp("room") / "room.exr"
    pixels = lamp_room(512).astype(np.float32)
    write_exr(path, [Part("", {"": pixels}, {}, "float", "lin_rec709_scene")])
    return path


@pytest.fixture(scope="session")
def shooting(
    tmp_path_factory: pytest.TempPathFactory, camera_file: str, room_map: Path
) -> Shooting:
    """Return a function that photographs the room once per set-up; the folder is not to change."""
    done: dict[str, Path] = {}

    def take(name: str, light: Path | None = None, **changes: object) -> Path:
        if name not in done:
            given = {"camera": camera_file, "lens": fisheye(SMALL), **changes}
            folder = tmp_path_factory.mktemp("shoots") / name
            done[name] = photograph(light or room_map, folder, Setup(**given))
        return done[name]

    return take


def copied(shoot: Path, folder: Path) -> Path:
    shutil.copytree(shoot.parent, folder)
    return folder / shoot.name


def edited(shoot: Path, change: Callable[[Usd.Stage], None]) -> Path:
    stage = Usd.Stage.Open(str(shoot))
    change(stage)
    stage.GetRootLayer().Save()
    return shoot


def files(folder: Path) -> set[str]:
    return {str(path.relative_to(folder)) for path in folder.rglob("*")}


# --- How right it is ---------------------------------------------------------------------------


def test_a_faithful_shoot_is_right_to_one_percent(shooting: Shooting, tmp_path: Path) -> None:
    shoot = shooting("large", lens=fisheye(SIZE))
    result = capture_shoot(shoot, tmp_path / "capture.usda")
    error = error_of(tmp_path / "capture.usda", shoot)
    assert error.median <= 0.01
    assert error.irradiance <= 0.01
    assert error.flux <= 0.005
    assert result.report.flux_difference <= 1e-3
    assert result.report.coverage > 0.999
    assert not result.report.lamps
    assert result.report.contradiction == 0.0


@pytest.mark.slow
def test_a_realistic_shoot_is_right_to_two_percent(shooting: Shooting, tmp_path: Path) -> None:
    """V stated 2 % off, 1 % glare, views 0.5 degrees off, 14 bits, 3 views of 9 exposures."""
    shoot = shooting(
        "realistic",
        lens=fisheye(SIZE, glare=0.01),
        vignetting_error=0.02,
        rotation_error_deg=0.5,
        seed=1,
    )
    options = CaptureOptions(refine_rotations=True)
    result = capture_shoot(shoot, tmp_path / "capture.usda", options)
    error = error_of(tmp_path / "capture.usda", shoot)
    assert error.irradiance <= 0.02
    assert error.median <= 0.02
    assert result.report.rotation_residual_deg < 0.1
    assert result.report.rotation_residual_before_deg > 0.2


@pytest.mark.slow
def test_glare_that_is_not_subtracted_shows(shooting: Shooting, tmp_path: Path) -> None:
    shoot = shooting("veiled", lens=fisheye(SMALL, glare=0.02))
    capture_shoot(shoot, tmp_path / "with.usda")
    capture_shoot(shoot, tmp_path / "without.usda", CaptureOptions(glare=0.0))
    found = [camera_values(tmp_path / name) for name in ("with.usda", "without.usda")]
    truth = reduced_truth(shoot, len(found[0]))
    dark = (truth < 0.1 * truth.mean()).all(axis=2)
    errors = [float(np.median(np.abs(values / truth - 1.0)[dark])) for values in found]
    assert errors[0] < 0.03
    assert errors[1] > 2.0 * errors[0]


@pytest.mark.slow
def test_glare_that_nobody_stated_is_found_beyond_the_image_circle(
    shooting: Shooting, tmp_path: Path
) -> None:
    shoot = shooting("unstated", lens=fisheye(SMALL, glare=0.02), stated_glare=0.0)
    result = capture_shoot(shoot, tmp_path / "found.usda")
    for view in result.report.views:
        assert view.found_glare == pytest.approx(0.02, rel=0.01)
    told = " ".join(statement.text for statement in result.report.statements())
    assert "2 % of glare, found beyond the image circles" in told
    stage = open_stage(tmp_path / "found.usda")
    cameras = [prim for prim in stage.Traverse() if prim.HasAPI("FisheyeCameraAPI")]
    lenses = [read_lens(prim) for prim in cameras]
    assert [lens.glare for lens in lenses] == [view.found_glare for view in result.report.views]
    stated = shooting("stated", lens=fisheye(SMALL, glare=0.02))
    capture_shoot(stated, tmp_path / "stated.usda")
    values, known = (camera_values(tmp_path / name) for name in ("found.usda", "stated.usda"))
    np.testing.assert_allclose(values.mean(), known.mean(), rtol=1e-4)


def reduced_truth(shoot: Path, height: int) -> np.ndarray:
    truth = read_image(shoot.parent / "truth" / "truth.exr").pixels.astype(np.float64)
    return reduced(truth, height)


def test_flux_error_of_a_wrong_lens_is_told(shooting: Shooting, tmp_path: Path) -> None:
    shoot = copied(shooting("small"), tmp_path / "shoot")

    def lengthen(stage: Usd.Stage) -> None:
        for prim in stage.Traverse():
            if prim.HasAPI("FisheyeCameraAPI"):
                focal = prim.GetAttribute("fisheye:focalLength")
                focal.Set(1.41 * focal.Get())

    edited(shoot, lengthen)
    result = capture_shoot(shoot, tmp_path / "capture.usda", CaptureOptions(refine_rotations=True))
    error = error_of(tmp_path / "capture.usda", shoot)
    assert error.flux > 0.03
    assert result.report.flux_error > error.flux
    light = next(item for item in result.report.statements() if item.topic == "Light")
    assert "contradict each other" in light.text and "Check the lens" in light.advice[0]


@pytest.mark.slow
def test_two_views_back_to_back_are_right_too(shooting: Shooting, tmp_path: Path) -> None:
    shoot = shooting(
        "back", lens=fisheye(SMALL, field_of_view_deg=190.0), views=((0.0, 0.0), (180.0, 0.0))
    )
    capture_shoot(shoot, tmp_path / "capture.usda")
    error = error_of(tmp_path / "capture.usda", shoot)
    assert error.median <= 0.02 and error.irradiance <= 0.015


@pytest.mark.slow
def test_developed_pictures_come_within_a_few_percent(shooting: Shooting, tmp_path: Path) -> None:
    shoot = shooting("jpeg", file_kind="jpg", curve="srgb", exposures=exposure_series(11, 1.5))
    result = capture_shoot(shoot, tmp_path / "capture.usda")
    # A developed picture does not tell how its channels compare: each is taken by itself.
    found = camera_values(tmp_path / "capture.usda")
    truth = reduced_truth(shoot, len(found))
    bright = (truth > 0.1 * truth.mean(axis=(0, 1))).all(axis=2)
    ratio = (found / truth)[bright]
    relative = np.abs(ratio / np.median(ratio, axis=0) - 1.0)
    assert np.median(relative) < 0.02
    assert any(note.code == "response-recovered" for note in result.notes)


# --- Where things are --------------------------------------------------------------------------


def lamp_stage(path: Path, direction: np.ndarray, up_axis: str) -> Path:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    dome = UsdLux.DomeLight.Define(stage, "/Sky")
    dome.CreateIntensityAttr(0.05)
    sun = UsdLux.DistantLight.Define(stage, "/Sun")
    sun.CreateAngleAttr(3.0)
    sun.CreateIntensityAttr(200.0)
    # A distant light shines along its -Z, so its +Z points to where it stands.
    z = direction / np.linalg.norm(direction)
    x = np.cross([0.3, 0.5, -0.8], z)
    x /= np.linalg.norm(x)
    rows = np.eye(4)
    rows[:3, :3] = [x, np.cross(z, x), z]
    UsdGeom.Xformable(sun).AddTransformOp().Set(matrix(rows))
    stage.GetRootLayer().Save()
    return path


def matte(stage: Usd.Stage, prim: Usd.Prim) -> None:
    """Give a prim skin that reflects half of the light diffusely and has no luster."""
    material = UsdShade.Material.Define(stage, "/Matte")
    half = Spectrum(SpectralQuantity.REFLECTANCE, [400.0, 700.0], [0.5, 0.5])
    write_skin(material.GetPrim(), SkinParameters(reflectance=half, wrap=0.0))
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)


def matrix(rows: np.ndarray) -> Gf.Matrix4d:
    return Gf.Matrix4d(*(float(value) for value in rows.ravel()))


@pytest.mark.slow
@pytest.mark.parametrize("up_axis", ["Y", "Z"])
def test_a_lamp_is_found_where_it_stood_after_a_render(
    tmp_path: Path, camera_file: str, up_axis: str
) -> None:
    """Photographed, captured and rendered: the brightest normal of a ball faces the lamp."""
    toward = np.array([0.6, 0.35, 0.45]) / np.linalg.norm([0.6, 0.35, 0.45])
    light = lamp_stage(tmp_path / "light.usda", toward, up_axis)
    setup = Setup(
        camera=camera_file, lens=fisheye(200), views=((10.0, 0.0), (130.0, 0.0), (250.0, 0.0))
    )
    shoot = photograph(light, tmp_path / "shoot", setup)
    assert cli.main(["-q", "capture", str(shoot), "-o", str(tmp_path / "capture.usda")]) == 0
    for side in np.eye(3):
        shot = tmp_path / f"shot{np.argmax(side)}.usda"
        stage = Usd.Stage.CreateNew(str(shot))
        UsdGeom.SetStageUpAxis(stage, up_axis)
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        stage.DefinePrim("/Light").GetReferences().AddReference("./capture.usda")
        matte(stage, UsdGeom.Sphere.Define(stage, "/Ball").GetPrim())
        camera = UsdGeom.Camera.Define(stage, "/Cam")
        rows = np.eye(4)
        x = np.roll(side, 1)
        rows[:3, :3] = [x, np.cross(side, x), side]
        rows[3, :3] = 10.0 * side
        UsdGeom.Xformable(camera).AddTransformOp().Set(matrix(rows))
        camera.CreateFocalLengthAttr(80.0)
        stage.GetRootLayer().Save()
        out = tmp_path / "out.exr"
        arguments = [
            "-q",
            "render",
            str(shot),
            str(out),
            "-w",
            "96",
            "--aov",
            "N",
            "--camera",
            "/Cam",
        ]
        assert cli.main(arguments) == 0
        beauty = read_image(out).pixels
        normal = read_image(out, part="N").pixels
        full = beauty[..., 3] > 0.99
        # Of a Lambert ball under one lamp in even light the brightness is a + b n.L: fit it.
        least, most = np.percentile(beauty[full][:, 1], (0.0, 100.0))
        bright = full & (beauty[..., 1] > least + 0.2 * (most - least))
        terms = np.concatenate([normal[bright], np.ones((bright.sum(), 1))], axis=1)
        fitted = np.linalg.lstsq(terms, beauty[bright][:, 1], rcond=None)[0][:3]
        angle = np.degrees(np.arccos(np.clip(fitted @ toward / np.linalg.norm(fitted), -1, 1)))
        assert angle < 0.5, (up_axis, side)


# --- Lamps and readings ------------------------------------------------------------------------


def clipping() -> dict[str, object]:
    """Return exposures of which the shortest still saturates the lamps."""
    return {"exposures": exposure_series(5, 2.0, middle_s=1.0 / 4.0), "middle": 0.7}


@pytest.mark.slow
def test_a_clipped_lamp_is_reported_and_mended_by_a_reading(
    shooting: Shooting, tmp_path: Path
) -> None:
    shoot = shooting("clipped", **clipping())
    plain = capture_shoot(shoot, tmp_path / "plain.usda").report
    assert plain.lamps and plain.clipped_share > 0.02
    stored = results(tmp_path / "plain.usda")
    assert len(stored["capture:lamps:shares"]) == len(plain.lamps)
    # What a meter facing each lamp, all else shaded, would have read.
    truth = read_image(shoot.parent / "truth" / "truth.exr").pixels.astype(np.float64)
    weights = stored["capture:luminanceWeights"]
    scale = stored["capture:luminance"] / spot(truth, stored, weights)
    toward = texel_directions(*truth.shape[:2])
    lamps = truth[..., 1] > 0.3 * truth[..., 1].max()
    readings = []
    for index, lamp in enumerate(plain.lamps):
        same_side = toward[..., 0] * lamp.direction[0] > 0.0
        alone = np.where((lamps & same_side)[..., None], truth, 0.0)
        facing = irradiance(alone, np.array([lamp.direction]))[0] @ weights
        readings.append((f"lamp{index + 1}", float(scale * facing)))
    options = CaptureOptions(lamps=tuple(readings))
    mended = capture_shoot(shoot, tmp_path / "mended.usda", options).report
    assert all(lamp.is_measured and lamp.factor > 1.5 for lamp in mended.lamps)
    before, after = (error_of(tmp_path / f"{name}.usda", shoot) for name in ("plain", "mended"))
    assert before.irradiance > 0.1
    assert after.irradiance < 0.05


def spot(truth: np.ndarray, stored: dict[str, object], weights: np.ndarray) -> float:
    toward = texel_directions(*truth.shape[:2])
    near = toward @ stored["capture:luminance:direction"] > np.cos(np.radians(1.0))
    return float(truth[near].mean(axis=0) @ weights)


@pytest.mark.slow
def test_a_darker_second_bracket_mends_a_clipped_lamp(shooting: Shooting, tmp_path: Path) -> None:
    views = ((0.0, 0.0), (120.0, 0.0), (240.0, 0.0))
    bright, dark = exposure_series(5, 2.0), exposure_list([1 / 250, 1 / 1000], nd_factor=64.0)
    shoot = shooting("darker", views=views * 2, exposures=(bright,) * 3 + (dark,) * 3)
    report = capture_shoot(shoot, tmp_path / "capture.usda").report
    assert not report.lamps
    error = error_of(tmp_path / "capture.usda", shoot)
    assert error.irradiance <= 0.015 and error.flux <= 0.01


@pytest.mark.slow
def test_a_reading_gives_the_scale(shooting: Shooting, tmp_path: Path) -> None:
    shoot = shooting("plain")
    capture_shoot(shoot, tmp_path / "capture.usda")
    stored = results(tmp_path / "capture.usda")
    assert stored["capture:units"] == "absolute"
    pixels = read_image(tmp_path / "panorama.exr").pixels.astype(np.float64)
    weights = stored["capture:luminanceWeights"]
    up = irradiance(pixels, np.array([[0.0, 1.0, 0.0]]))[0] @ weights
    assert up == pytest.approx(stored["capture:illuminance"], rel=0.02)


def test_without_readings_camera_values_stay(shooting: Shooting, tmp_path: Path) -> None:
    def forget(stage: Usd.Stage) -> None:
        prim = stage.GetDefaultPrim()
        for name in ("capture:illuminance", "capture:luminance"):
            prim.RemoveProperty(name)

    shoot = edited(copied(shooting("plain"), tmp_path / "shoot"), forget)
    capture_shoot(shoot, tmp_path / "capture.usda")
    stored = results(tmp_path / "capture.usda")
    assert (stored["capture:units"], stored["capture:scale"]) == ("relative", 1.0)
    assert error_of(tmp_path / "capture.usda", shoot).flux < 0.005


# --- The command -------------------------------------------------------------------------------


def test_the_layer_stands_alone_and_is_valid(shooting: Shooting, tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    capture = tmp_path / "out" / "capture.usda"
    capture_shoot(shooting("plain"), capture)
    moved = tmp_path / "elsewhere"
    shutil.move(tmp_path / "out", moved)
    errors = [item for item in validate(moved / "capture.usda") if item.severity == "error"]
    assert not errors, errors
    stage = open_stage(moved / "capture.usda")
    assert stage.GetDefaultPrim().GetPath() == Sdf.Path("/Capture")
    assert files(moved) == {"capture.usda", "panorama.exr", "stddev.exr", "quality.png"}
    assert read_image(moved / "quality.png").pixels.shape[2] == 3
    assert read_image(moved / "stddev.exr", part="quality").channel_names == (
        "clipped",
        "moved",
        "seen",
    )


@pytest.mark.slow
def test_same_shoot_same_bytes_whatever_the_threads(shooting: Shooting, tmp_path: Path) -> None:
    shoot = shooting("plain")
    written = []
    for threads in (1, 2):
        folder = tmp_path / str(threads)
        folder.mkdir()
        capture_shoot(shoot, folder / "capture.usda", CaptureOptions(threads=threads))
        written.append(
            (folder / "panorama.exr").read_bytes() + (folder / "stddev.exr").read_bytes()
        )
    assert written[0] == written[1]


def test_the_command_tells_programs_what_it_measured(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = tmp_path / "hall.usda"
    assert cli.main(["--json", "capture", str(shooting("plain")), "-o", str(output)]) == 0
    events = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    (told,) = (event for event in events if event["event"] == "capture")
    assert told["width"] == 256 and told["coverage"] > 0.999
    paths = [Path(event["path"]).name for event in events if event["event"] == "wrote"]
    assert paths == ["hall.usda", "hall.panorama.exr", "hall.stddev.exr", "hall.quality.png"]


def refused(
    capsys: pytest.CaptureFixture[str], shoot: Path, output: Path, *options: str
) -> tuple[int, str]:
    """Run the command; whatever it says is one line, and nothing is left behind."""
    before = files(output.parent) if output.parent.is_dir() else set()
    capsys.readouterr()
    code = cli.main(["-q", "capture", str(shoot), "-o", str(output), *options])
    said = capsys.readouterr().err.strip().splitlines()
    errors = [line for line in said if line.startswith("usdskin: error: ")]
    assert len(errors) == 1 and said[-1] == errors[0], said
    assert (files(output.parent) if output.parent.is_dir() else set()) == before
    return code, errors[0].removeprefix("usdskin: error: ")


def test_a_missing_exposure_is_named(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shoot = copied(shooting("plain"), tmp_path / "shoot")
    (shoot.parent / "view1" / "04.tif").unlink()
    code, line = refused(capsys, shoot, tmp_path / "capture.usda")
    assert code == 3 and "04.tif" in line and "</Shoot/view1>" in line


@pytest.mark.parametrize("kind", ["tif", "exr", "jpg"])
def test_a_truncated_photograph_is_named(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str], kind: str
) -> None:
    shoot = copied(shooting(f"small {kind}", file_kind=kind, lens=fisheye(96)), tmp_path / "shoot")
    broken = sorted((shoot.parent / "view2").iterdir())[3]
    broken.write_bytes(broken.read_bytes()[: broken.stat().st_size // 2])
    code, line = refused(capsys, shoot, tmp_path / "capture.usda")
    assert code == 3 and broken.name in line


def test_a_lying_exposure_time_is_named(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    def lie(stage: Usd.Stage) -> None:
        attribute = stage.GetPrimAtPath("/Shoot/view0").GetAttribute("bracket:exposureTimes")
        times = list(attribute.Get())
        times[4] *= 2.0
        attribute.Set(times)

    shoot = edited(copied(shooting("plain"), tmp_path / "shoot"), lie)
    code, line = refused(capsys, shoot, tmp_path / "capture.usda")
    assert code == 3 and "04.tif" in line and "</Shoot/view0>" in line


def test_pictures_of_two_sizes_or_kinds_in_a_view_are_refused(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    small = shooting("small tif", file_kind="tif", lens=fisheye(96))
    float_kind = shooting("small exr", file_kind="exr", lens=fisheye(96))
    shoot = copied(small, tmp_path / "sizes")
    shutil.copy(shooting("plain").parent / "view0" / "02.tif", shoot.parent / "view0" / "02.tif")
    code, line = refused(capsys, shoot, tmp_path / "capture.usda")
    assert code == 3 and "96 x 96" in line and f"{SMALL} x {SMALL}" in line
    shoot = copied(small, tmp_path / "kinds")
    shutil.copy(float_kind.parent / "view0" / "02.exr", shoot.parent / "view0" / "02.exr")

    def mix(stage: Usd.Stage) -> None:
        attribute = stage.GetPrimAtPath("/Shoot/view0").GetAttribute("bracket:images")
        names = list(attribute.Get())
        names[2] = Sdf.AssetPath("./view0/02.exr")
        attribute.Set(names)

    code, line = refused(capsys, edited(shoot, mix), tmp_path / "capture.usda")
    assert code == 3 and "02.exr" in line


@pytest.mark.slow
def test_views_of_two_sizes_are_fine(shooting: Shooting, tmp_path: Path) -> None:
    """A phone beside a camera: each view has its own lens, scaled to its own pictures."""
    large, small = shooting("plain"), shooting("half", lens=fisheye(SMALL // 2))
    shoot = copied(large, tmp_path / "shoot")
    shutil.rmtree(shoot.parent / "view1")
    shutil.copytree(small.parent / "view1", shoot.parent / "view1")
    capture_shoot(shoot, tmp_path / "capture.usda")
    assert error_of(tmp_path / "capture.usda", large).irradiance < 0.02


@pytest.mark.slow
def test_black_and_saturated_views_are_refused(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = shooting("small tif", file_kind="tif", lens=fisheye(96))
    for exposure_s, word in ((1e-9, "black"), (1e5, "saturated")):
        one = exposure_list([exposure_s, exposure_s / 2])
        name = f"all {word}"
        shoot = shooting(name, lens=fisheye(96), exposures=one, sensor_constant=constant_of(plain))
        code, line = refused(capsys, shoot, tmp_path / "capture.usda")
        assert code == 3 and word in line and "</Shoot/view0>" in line


def constant_of(shoot: Path) -> float:
    from usdskin.judge.shoot.shoot_layers import read_truth

    return read_truth(shoot.parent).constants["sensorConstant"]


@pytest.mark.slow
def test_a_wrong_rotation_is_told(shooting: Shooting, tmp_path: Path) -> None:
    def swap(stage: Usd.Stage) -> None:
        one, two = (
            stage.GetPrimAtPath(f"/Shoot/view{index}").GetAttribute("xformOp:orient")
            for index in (1, 2)
        )
        first, second = one.Get(), two.Get()
        one.Set(second)
        two.Set(first)

    shoot = edited(copied(shooting("plain"), tmp_path / "shoot"), swap)
    result = capture_shoot(shoot, tmp_path / "capture.usda")
    assert any("rotation" in note.code for note in result.notes), result.notes


@pytest.mark.parametrize(
    ("options", "complaint"),
    [
        (("--width", "513"), "give an even one"),
        (("--lamp-illuminance", "100"), "no lamp was saturated"),
    ],
)
def test_options_that_do_not_fit_are_refused(
    shooting: Shooting,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    options: tuple[str, ...],
    complaint: str,
) -> None:
    shoot = shooting("small tif", file_kind="tif", lens=fisheye(96))
    code, line = refused(capsys, shoot, tmp_path / "capture.usda", *options)
    assert code == 2 and complaint in line


def test_an_input_is_never_overwritten(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shoot = copied(shooting("small tif", file_kind="tif", lens=fisheye(96)), tmp_path / "shoot")
    before = shoot.read_bytes()
    code, line = refused(capsys, shoot, shoot)
    assert code == 2 and "is an input" in line
    assert shoot.read_bytes() == before


def test_a_folder_that_cannot_be_made_is_named_before_the_work(
    shooting: Shooting,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("usdskin.capture.step._compose", lambda *_: pytest.fail("it was begun"))
    (tmp_path / "no").touch()
    code, line = refused(capsys, shooting("plain"), tmp_path / "no" / "capture.usda")
    assert code == 3 and "capture.usda: cannot be written" in line


def test_a_failure_keeps_the_capture_before_it(
    shooting: Shooting, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    shoot = copied(shooting("small tif", file_kind="tif", lens=fisheye(96)), tmp_path / "shoot")
    output = tmp_path / "capture.usda"
    capture_shoot(shoot, output)
    before = {name: (tmp_path / name).read_bytes() for name in ("capture.usda", "panorama.exr")}
    (shoot.parent / "view2" / "00.tif").write_bytes(b"not a picture")
    assert refused(capsys, shoot, output)[0] == 3
    assert before == {name: (tmp_path / name).read_bytes() for name in before}
