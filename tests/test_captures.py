"""Shoots, views and lenses in layers: what is written is read back, and what is wrong is named."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from usdskin.errors import LayerError
from usdskin.layers import open_stage, write_layer
from usdskin.prims import (
    ExposureBracket,
    FisheyeLens,
    read_lens,
    read_shoot,
    write_bracket,
    write_lens,
    write_rotation,
)

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom

LENS = FisheyeLens(
    projection="opencv",
    focal_length_px=161.5,
    center_px=np.array([256.25, 255.5]),
    resolution=(512, 511),
    distortion=np.array([0.01, -0.002, 0.0003, -0.00001]),
    max_angle_deg=92.5,
    vignetting=np.array([-0.05, 0.001]),
    glare=0.01,
)


def turned(axis: tuple[float, float, float], angle_deg: float) -> np.ndarray:
    """Return the matrix that turns column vectors about an axis (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    angle = np.radians(angle_deg)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def bracket(folder: Path, **changes: object) -> ExposureBracket:
    images = tuple(folder / f"{index}.tif" for index in range(3))
    for image in images:
        image.touch()
    given = {
        "images": images,
        "exposure_time_s": np.array([0.01, 0.1, 1.0]),
        "iso": np.array([100.0, 100.0, 400.0]),
        "f_number": np.full(3, 4.0),
        "nd_factor": np.array([8.0, 1.0, 1.0]),
        "black_level": np.array([512.0]),
        "white_level": np.array([16000.0, 16383.0, 16383.0]),
    }
    return ExposureBracket(**{**given, **changes})


@pytest.fixture
def stage(tmp_path: Path) -> Usd.Stage:
    stage = Usd.Stage.CreateNew(str(tmp_path / "shoot.usda"))
    prim = UsdGeom.Xform.Define(stage, "/Shoot").GetPrim()
    prim.ApplyAPI("CaptureAPI")
    stage.SetDefaultPrim(prim)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    return stage


def add_view(stage: Usd.Stage, folder: Path, name: str = "north", **changes: object) -> Usd.Prim:
    prim = UsdGeom.Camera.Define(stage, f"/Shoot/{name}").GetPrim()
    write_lens(prim, LENS)
    write_bracket(prim, bracket(folder, **changes))
    write_rotation(prim, turned((1, 2, 3), 50))
    return prim


def reread(stage: Usd.Stage) -> Usd.Stage:
    path = Path(stage.GetRootLayer().realPath)
    write_layer(stage, path)
    return open_stage(path)


def refusal(stage: Usd.Stage) -> str:
    with pytest.raises(LayerError) as caught:
        read_shoot(stage)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_shoot_is_read_as_it_was_written(stage: Usd.Stage, tmp_path: Path) -> None:
    add_view(stage, tmp_path)
    prim = stage.GetDefaultPrim()
    prim.GetAttribute("capture:illuminance").Set(812.0)
    prim.GetAttribute("capture:illuminance:direction").Set((0.0, 3.0, 0.0))
    shoot = read_shoot(reread(stage))
    (view,) = shoot.views
    assert (shoot.name, view.name, shoot.up_axis) == ("Shoot", "north", "Y")
    assert shoot.illuminance_lx == 812.0
    np.testing.assert_allclose(shoot.illuminance_direction, (0, 1, 0))
    np.testing.assert_allclose(view.rotation, turned((1, 2, 3), 50), atol=1e-15)
    for name in ("center_px", "distortion", "vignetting"):
        np.testing.assert_array_equal(getattr(view.lens, name), getattr(LENS, name))
    assert view.lens.resolution == LENS.resolution
    assert (view.lens.projection, view.lens.focal_length_px) == ("opencv", 161.5)
    assert (view.lens.max_angle_deg, view.lens.glare) == (92.5, 0.01)
    assert [image.name for image in view.bracket.images] == ["0.tif", "1.tif", "2.tif"]
    np.testing.assert_array_equal(view.bracket.white_level, (16000.0, 16383.0, 16383.0))


def test_exposure_is_time_times_iso_over_the_f_number_squared(tmp_path: Path) -> None:
    # 0.01 s at f/4 behind ND 8; 1 s at f/4 and ISO 400.
    exposure = bracket(tmp_path).exposure
    np.testing.assert_allclose(exposure, (0.01 / 16 / 8, 0.1 / 16, 4 / 16), rtol=1e-15)


def test_a_double_keeps_all_of_its_digits(stage: Usd.Stage, tmp_path: Path) -> None:
    add_view(stage, tmp_path).GetAttribute("fisheye:focalLength").Set(127.32395447351627)
    (view,) = read_shoot(stage).views
    assert view.lens.focal_length_px == 127.32395447351627


def test_a_view_is_placed_by_its_world_rotation(stage: Usd.Stage, tmp_path: Path) -> None:
    add_view(stage, tmp_path)
    UsdGeom.Xformable(stage.GetDefaultPrim()).AddRotateYOp().Set(90.0)
    (view,) = read_shoot(reread(stage)).views
    # Turning the tripod by 90 degrees about Y takes +Z to +X.
    np.testing.assert_allclose(
        view.rotation, turned((0, 1, 0), 90) @ turned((1, 2, 3), 50), atol=1e-7
    )


def test_a_lens_referenced_from_another_layer_is_read(stage: Usd.Stage, tmp_path: Path) -> None:
    lens = Usd.Stage.CreateNew(str(tmp_path / "lens.usda"))
    camera = UsdGeom.Camera.Define(lens, "/Lens").GetPrim()
    lens.SetDefaultPrim(camera)
    write_lens(camera, LENS)
    lens.Save()
    view = UsdGeom.Camera.Define(stage, "/Shoot/east").GetPrim()
    view.GetReferences().AddReference("./lens.usda")
    write_bracket(view, bracket(tmp_path))
    (read,) = read_shoot(reread(stage)).views
    assert read.lens.focal_length_px == 161.5


def test_capture_views_orders_the_views(stage: Usd.Stage, tmp_path: Path) -> None:
    for name in ("a", "b", "c"):
        add_view(stage, tmp_path, name)
    relationship = stage.GetDefaultPrim().GetRelationship("capture:views")
    relationship.SetTargets(["/Shoot/c", "/Shoot/a"])
    assert [view.name for view in read_shoot(stage).views] == ["c", "a"]
    relationship.SetTargets(["/Shoot/nobody"])
    assert "capture:views names </Shoot/nobody>" in refusal(stage)


def test_a_layer_without_a_shoot_says_how_to_get_one(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateInMemory("empty.usda")
    assert "usdskin ingest" in refusal(stage)


def test_a_shoot_without_views_is_refused(stage: Usd.Stage) -> None:
    assert "has no views" in refusal(stage)


def test_a_missing_photograph_is_named(stage: Usd.Stage, tmp_path: Path) -> None:
    add_view(stage, tmp_path)
    (tmp_path / "1.tif").unlink()
    message = refusal(reread(stage))
    assert "bracket:images" in message and "1.tif" in message and "</Shoot/north>" in message


@pytest.mark.parametrize(
    ("name", "value", "complaint"),
    [
        ("bracket:exposureTimes", [0.1, 1.0], "has 2 values but bracket:images has 3"),
        ("bracket:exposureTimes", [0.1, 0.0, 1.0], "is 0.0 at index 1"),
        ("bracket:exposureTimes", [], "has 0 values"),
        ("bracket:iso", [], "copy it from the photographs' EXIF"),
        ("bracket:fNumbers", [], "copy it from the photographs' EXIF"),
        ("bracket:ndFactors", [0.5, 1.0, 1.0], "is 0.5 at index 0"),
        ("bracket:gain", [1.0, 2.0], "has 2 values"),
        ("bracket:blackLevel", [1.0, 2.0], "one, or one per channel"),
        ("bracket:whiteLevel", [0.0], "not above the black level"),
        ("bracket:transfer", "log", "use one of auto, linear, recovered"),
        ("fisheye:focalLength", 0.0, "not calibrated"),
        ("fisheye:glare", 0.9, "it must be from 0 to 0.5"),
    ],
)
def test_an_opinion_that_cannot_be_used_is_named(
    stage: Usd.Stage, tmp_path: Path, name: str, value: object, complaint: str
) -> None:
    add_view(stage, tmp_path).GetAttribute(name).Set(value)
    message = refusal(stage)
    assert name in message and complaint in message


def test_a_mirrored_view_is_refused(stage: Usd.Stage, tmp_path: Path) -> None:
    prim = add_view(stage, tmp_path)
    UsdGeom.Xformable(prim).AddScaleOp().Set(Gf.Vec3f(-1, 1, 1))
    assert "is mirrored" in refusal(stage)


def test_a_camera_without_a_lens_says_how_to_calibrate_one(tmp_path: Path) -> None:
    stage = Usd.Stage.CreateInMemory()
    camera = UsdGeom.Camera.Define(stage, "/Camera").GetPrim()
    with pytest.raises(LayerError, match="usdskin calibrate lens"):
        read_lens(camera)


def test_a_misspelt_attribute_is_noticed(stage: Usd.Stage, tmp_path: Path) -> None:
    prim = add_view(stage, tmp_path)
    prim.CreateAttribute("bracket:whiteLevels", prim.GetAttribute("bracket:gain").GetTypeName())
    assert 'did you mean "bracket:whiteLevel"' in refusal(stage)
