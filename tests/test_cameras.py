"""Cameras: closed forms first, then Gf's own frustum as the outside check."""

from __future__ import annotations

import math

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

from usdskin.errors import LayerError
from usdskin.render.cameras import Camera, conform_aperture, find_camera, read_camera

TIME = Usd.TimeCode.Default()
FLOAT_RTOL = 1e-6  # apertures and focal lengths are stored as 32-bit floats


def _stage(meters_per_unit: float = 0.01) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory("shot.usda")
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    return stage


def _camera(stage: Usd.Stage, path: str = "/Cam", **attributes) -> UsdGeom.Camera:
    camera = UsdGeom.Camera.Define(stage, path)
    for name, value in attributes.items():
        camera.GetPrim().GetAttribute(name.replace("__", ":")).Set(value)
    return camera


def _read(stage: Usd.Stage, path: str = "/Cam", size=(200, 100), **options) -> Camera:
    return read_camera(stage, path, TIME, size, **options)


def _ray(camera: Camera, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
    """Return origin [m] and direction through a point of the picture, (0, 0) at the lower left."""
    left, right, bottom, top = camera.window
    plane = np.array([left + x * (right - left), bottom + y * (top - bottom)])
    if camera.orthographic:
        origin, direction = np.array([*plane, 0.0, 1.0]), np.array([0.0, 0.0, -1.0])
    else:
        origin, direction = np.array([0.0, 0.0, 0.0, 1.0]), np.array([*plane, -1.0])
    direction = camera.to_world[:3, :3] @ direction
    return (camera.to_world @ origin)[:3], direction / np.linalg.norm(direction)


def _notes(stage: Usd.Stage) -> dict[str, str]:
    notes: list = []
    _read(stage, notes=notes)
    return {note.code: note.message for note in notes}


# Closed forms


@pytest.mark.parametrize("meters_per_unit", [1.0, 0.01, 0.0254])
def test_a_full_frame_50_mm_lens_sees_39_6_degrees_whatever_the_unit(meters_per_unit):
    """2 atan(18 / 50) = 39.5978 degrees: tenths of a unit cancel."""
    stage = _stage(meters_per_unit)
    _camera(stage, focalLength=50.0, horizontalAperture=36.0, verticalAperture=18.0)
    left, right, bottom, top = _read(stage).window
    np.testing.assert_allclose([left, right, bottom, top], [-0.36, 0.36, -0.18, 0.18], 1e-7)
    angle = math.degrees(math.atan(right) - math.atan(left))
    assert math.isclose(angle, 39.597752, rel_tol=1e-6)


def test_an_orthographic_window_is_tenths_of_a_unit_in_metres():
    stage = _stage(0.01)
    _camera(
        stage, projection="orthographic", horizontalAperture=200.0, verticalAperture=100.0,
        horizontalApertureOffset=10.0,
    )  # fmt: skip
    camera = _read(stage)
    assert camera.orthographic
    # 200 tenths of a centimetre are 0.2 m.
    np.testing.assert_allclose(camera.window, (-0.09, 0.11, -0.05, 0.05), FLOAT_RTOL)


def test_aperture_offsets_move_the_window():
    stage = _stage()
    _camera(
        stage, focalLength=10.0, horizontalAperture=20.0, verticalAperture=10.0,
        horizontalApertureOffset=4.0, verticalApertureOffset=-1.0,
    )  # fmt: skip
    np.testing.assert_allclose(_read(stage).window, (-0.6, 1.4, -0.6, 0.4), FLOAT_RTOL)


def test_position_and_clipping_range_are_in_metres():
    stage = _stage(0.01)
    camera = _camera(stage, clippingRange=Gf.Vec2f(10, 500))
    camera.AddTranslateOp().Set(Gf.Vec3d(100, 200, -300))
    read = _read(stage)
    np.testing.assert_allclose(read.to_world[:3, 3], [1, 2, -3])
    np.testing.assert_allclose([read.clip_near, read.clip_far], [0.1, 5.0], FLOAT_RTOL)
    assert read.path == "/Cam"


def test_a_camera_looks_along_minus_z_with_y_up():
    stage = _stage()
    _camera(stage)
    np.testing.assert_array_equal(_read(stage).to_world, np.eye(4))
    _, direction = _ray(_read(stage), 0.5, 0.5)
    np.testing.assert_allclose(direction, [0, 0, -1], atol=1e-12)
    _, direction = _ray(_read(stage), 0.9, 0.9)
    assert direction[0] > 0 and direction[1] > 0


def test_a_quarter_turn_about_y_looks_along_minus_x():
    stage = _stage()
    _camera(stage).AddRotateYOp().Set(90.0)
    _, direction = _ray(_read(stage), 0.5, 0.5)
    np.testing.assert_allclose(direction, [-1, 0, 0], atol=1e-12)


def test_an_unauthored_camera_does_not_expose_and_an_authored_one_does():
    stage = _stage()
    camera = _camera(stage)
    assert _read(stage).exposure_scale == 1.0
    prim = camera.GetPrim()
    for name, value in (("time", 0.02), ("iso", 400.0), ("fStop", 2.0), ("responsivity", 1.5)):
        prim.GetAttribute(f"exposure:{name}").Set(value)
    camera.GetExposureAttr().Set(3.0)
    # responsivity * t * ISO / 100 * 2^EV / N^2
    assert math.isclose(_read(stage).exposure_scale, 1.5 * 0.02 * 4 * 8 / 4, rel_tol=FLOAT_RTOL)


def test_a_camera_is_read_at_its_time():
    stage = _stage()
    camera = _camera(stage)
    camera.GetFocalLengthAttr().Set(10.0, 1.0)
    camera.GetFocalLengthAttr().Set(20.0, 2.0)
    camera.AddTranslateOp().Set(Gf.Vec3d(0, 0, 100), 1.0)
    widths = [read_camera(stage, "/Cam", Usd.TimeCode(t), (1, 1)).window[1] for t in (1.0, 2.0)]
    assert math.isclose(widths[0], 2 * widths[1], rel_tol=FLOAT_RTOL)


# Gf's frustum


def _awkward_matrices() -> dict[str, Gf.Matrix4d]:
    rotation = Gf.Matrix4d().SetRotate(Gf.Rotation(Gf.Vec3d(1, 2, 3), 50.0))
    move = Gf.Matrix4d().SetTranslate(Gf.Vec3d(3, -20, 7))
    return {
        "rigid": rotation * move,
        "uniform scale": Gf.Matrix4d().SetScale(0.01) * rotation * move,
        "scale before the turn": Gf.Matrix4d().SetScale(Gf.Vec3d(2, 3, 0.5)) * rotation * move,
        "shear": rotation * Gf.Matrix4d().SetScale(Gf.Vec3d(2, 1, 1)) * move,
        "mirror x": Gf.Matrix4d().SetScale(Gf.Vec3d(-1, 1, 1)) * rotation * move,
        "mirror z": rotation * Gf.Matrix4d().SetScale(Gf.Vec3d(1, 1, -1)) * move,
    }


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
@pytest.mark.parametrize("name", list(_awkward_matrices()))
def test_rays_are_those_of_gf_frustum(name, projection):
    meters_per_unit = 0.01
    stage = _stage(meters_per_unit)
    camera = _camera(
        stage, "/World/Cam", projection=projection, focalLength=35.0, horizontalAperture=40.0,
        verticalAperture=20.0, horizontalApertureOffset=3.0, verticalApertureOffset=-2.0,
        clippingRange=Gf.Vec2f(1, 100),
    )  # fmt: skip
    UsdGeom.Xform.Define(stage, "/World").AddTransformOp().Set(_awkward_matrices()[name])
    camera.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    read = _read(stage, "/World/Cam", (200, 100))
    frustum = camera.GetCamera(TIME).frustum

    assert math.isclose(np.linalg.det(read.to_world[:3, :3]), 1.0, rel_tol=1e-9)
    for x, y in ((0.5, 0.5), (0.0, 1.0), (0.9, 0.2)):
        # Gf.Camera lies in scene units; rays meet its near plane at distance 1.
        expected = frustum.ComputePickRay(Gf.Vec2d(2 * x - 1, 2 * y - 1))
        origin, direction = _ray(read, x, y)
        np.testing.assert_allclose(direction, expected.direction.GetNormalized(), atol=1e-6)
        toward = np.array(expected.startPoint) * meters_per_unit - origin
        np.testing.assert_allclose(np.cross(toward, direction), 0.0, atol=1e-6)


def test_scale_shear_and_mirroring_are_noted_and_a_clean_camera_is_not():
    expected = {
        "rigid": set(),
        "uniform scale": {"camera-scale-ignored"},
        "scale before the turn": {"camera-scale-ignored"},
        "shear": {"camera-scale-ignored", "camera-shear-ignored"},
        "mirror x": {"camera-mirrored"},
        "mirror z": {"camera-mirrored"},
    }
    for name, matrix in _awkward_matrices().items():
        stage = _stage()
        _camera(stage).AddTransformOp().Set(matrix)
        assert set(_notes(stage)) == expected[name], name


# Aspect policies


@pytest.mark.parametrize(
    ("policy", "wide_picture", "tall_picture"),
    [
        # Aperture 2 x 1; pictures 4:1 and 1:1.
        ("expandAperture", (4.0, 1.0), (2.0, 2.0)),
        ("cropAperture", (2.0, 0.5), (1.0, 1.0)),
        ("adjustApertureWidth", (4.0, 1.0), (1.0, 1.0)),
        ("adjustApertureHeight", (2.0, 0.5), (2.0, 2.0)),
    ],
)
def test_apertures_give_way_as_the_policy_says(policy, wide_picture, tall_picture):
    assert conform_aperture(2.0, 1.0, (400, 100), 1.0, policy) == (*wide_picture, 1.0)
    assert conform_aperture(2.0, 1.0, (100, 100), 1.0, policy) == (*tall_picture, 1.0)
    # Anamorphic pixels of aspect 2 make the square picture 2:1, as the aperture is.
    assert conform_aperture(2.0, 1.0, (100, 100), 2.0, policy) == (2.0, 1.0, 2.0)


def test_pixels_give_way_where_the_policy_says_so():
    assert conform_aperture(2.0, 1.0, (100, 100), 1.0, "adjustPixelAspectRatio") == (2.0, 1.0, 2.0)
    stage = _stage()
    _camera(stage, focalLength=1.0, horizontalAperture=2.0, verticalAperture=1.0)
    camera = _read(stage, size=(100, 100), conform_policy="adjustPixelAspectRatio")
    assert camera.window == (-1.0, 1.0, -0.5, 0.5)
    assert camera.pixel_aspect_ratio == 2.0


def test_the_offset_of_the_aperture_stays_when_it_gives_way():
    stage = _stage()
    _camera(
        stage, focalLength=1.0, horizontalAperture=2.0, verticalAperture=1.0,
        horizontalApertureOffset=0.5,
    )  # fmt: skip
    assert _read(stage, size=(400, 100)).window == (-1.5, 2.5, -0.5, 0.5)


def test_unknown_policies_and_empty_pictures_are_a_mistake_of_the_caller():
    with pytest.raises(ValueError, match="policy"):
        conform_aperture(2.0, 1.0, (4, 1), 1.0, "fit")
    with pytest.raises(ValueError, match="no picture"):
        conform_aperture(2.0, 1.0, (0, 1), 1.0, "expandAperture")


# What gives no picture


@pytest.mark.parametrize(
    ("attribute", "value"),
    [
        ("focalLength", 0.0),
        ("focalLength", math.nan),
        ("horizontalAperture", -1.0),
        ("verticalAperture", math.inf),
        ("horizontalApertureOffset", math.nan),
        ("clippingRange", Gf.Vec2f(10, 1)),
        ("clippingRange", Gf.Vec2f(-1, 10)),
        ("clippingRange", Gf.Vec2f(math.nan, 10)),
        ("exposure", math.nan),
        ("exposure:fStop", 0.0),
        ("exposure:time", -1.0),
    ],
)
def test_degenerate_values_are_refused_with_prim_attribute_and_value(attribute, value):
    stage = _stage()
    _camera(stage, **{attribute.replace(":", "__"): value})
    with pytest.raises(LayerError, match=rf"</Cam>: {attribute} is ") as caught:
        _read(stage)
    assert "\n" not in str(caught.value)


def test_an_orthographic_camera_needs_no_focal_length_and_may_see_behind_itself():
    stage = _stage(1.0)
    _camera(stage, projection="orthographic", focalLength=0.0, clippingRange=Gf.Vec2f(-5, 5))
    assert _read(stage).clip_near == -5.0


@pytest.mark.parametrize("scale", [(0, 1, 1), (0, 0, 0), (math.nan, 1, 1)])
def test_a_singular_transform_is_refused(scale):
    stage = _stage()
    _camera(stage).AddScaleOp().Set(Gf.Vec3f(*scale))
    with pytest.raises(LayerError, match="singular or not finite"):
        _read(stage)


def test_what_is_not_a_camera_is_refused():
    stage = _stage()
    UsdGeom.Xform.Define(stage, "/World")
    for path in ("/World", "/Nothing"):
        with pytest.raises(LayerError, match=f"<{path}>: no Camera prim"):
            _read(stage, path)


def test_lens_effects_we_do_not_show_are_noted():
    stage = _stage()
    camera = _camera(stage, fStop=2.8)
    camera.GetClippingPlanesAttr().Set([Gf.Vec4f(1, 0, 0, 0)])
    assert set(_notes(stage)) == {"depth-of-field-ignored", "clipping-planes-ignored"}


@pytest.mark.realdata
def test_the_degenerate_camera_of_the_malformed_set_is_refused(realdata):
    stage = Usd.Stage.Open(str(realdata / "malformed" / "synthetic" / "camera_degenerate.usda"))
    with pytest.raises(LayerError, match="</C>: horizontalAperture is -1"):
        _read(stage, "/C")


# Choosing


def test_the_only_camera_is_taken():
    stage = _stage()
    _camera(stage, "/World/Cam")
    assert find_camera(stage).GetPath() == "/World/Cam"


def test_a_camera_is_found_by_path_or_by_name():
    stage = _stage()
    for path in ("/World/Front", "/World/Side", "/A/Twin", "/B/Twin"):
        _camera(stage, path)
    assert find_camera(stage, "/World/Side").GetPath() == "/World/Side"
    assert find_camera(stage, "Front").GetPath() == "/World/Front"
    assert find_camera(stage, Sdf.Path("/A/Twin")).GetPath() == "/A/Twin"
    with pytest.raises(LayerError, match=r"2 cameras are called 'Twin'.* /A/Twin, /B/Twin"):
        find_camera(stage, "Twin")


def test_settings_choose_among_several_cameras_and_a_request_goes_before_them():
    stage = _stage()
    for path in ("/Front", "/Side"):
        _camera(stage, path)
    settings = stage.DefinePrim("/Render", "RenderSettings")
    settings.CreateRelationship("camera").SetTargets(["/Side"])
    assert find_camera(stage, None, settings).GetPath() == "/Side"
    assert find_camera(stage, "/Front", settings).GetPath() == "/Front"
    settings.GetRelationship("camera").SetTargets(["/Gone"])
    with pytest.raises(LayerError, match="no camera '/Gone'; the stage has /Front, /Side"):
        find_camera(stage, None, settings)


def test_several_cameras_without_a_choice_are_listed():
    stage = _stage()
    for number in range(12):
        _camera(stage, f"/Cam{number:02}")
    with pytest.raises(LayerError, match=r"12 cameras \(/Cam00, .*/Cam09 and 2 more\); choose"):
        find_camera(stage)


def test_a_stage_without_cameras_says_what_to_do():
    with pytest.raises(LayerError, match="has no camera; add one"):
        find_camera(_stage())
    with pytest.raises(LayerError, match="no camera 'x'; the stage has no camera"):
        find_camera(_stage(), "x")


def test_a_request_for_something_else_is_refused():
    stage = _stage()
    UsdGeom.Cube.Define(stage, "/Cube")
    _camera(stage).GetPrim().SetActive(False)
    with pytest.raises(LayerError, match="</Cube>: this Cube prim is no camera"):
        find_camera(stage, "/Cube")
    with pytest.raises(LayerError, match="</Cam>: this inactive Camera prim is no camera"):
        find_camera(stage, "/Cam")


def test_cameras_inside_instances_are_found():
    stage = _stage()
    _camera(stage, "/Rig/Cam")
    stage.OverridePrim("/Rig").SetSpecifier(Sdf.SpecifierClass)
    instance = UsdGeom.Xform.Define(stage, "/Shot/Rig").GetPrim()
    instance.GetReferences().AddInternalReference("/Rig")
    instance.SetInstanceable(True)
    assert find_camera(stage).GetPath() == "/Shot/Rig/Cam"
    assert read_camera(stage, "/Shot/Rig/Cam", TIME, (2, 1)).path == "/Shot/Rig/Cam"


def test_the_views_of_a_capture_are_not_rendered_from_unless_named():
    stage = _stage()
    _camera(stage)
    view = _camera(stage, "/Capture/view").GetPrim()
    view.ApplyAPI("FisheyeCameraAPI")
    assert find_camera(stage).GetPath() == Sdf.Path("/Cam")
    assert find_camera(stage, "/Capture/view") == view
