"""Motion blur: pictures of moving things against the closed form of a box shutter."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.errors import LayerError
from usdskin.images import read_image
from usdskin.progress import SilentProgress
from usdskin.render.job import RenderReport
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage

COLUMNS, ROWS = 40, 8
PIXEL = 0.05
"""Width of a pixel [m]: the orthographic camera sees x from -1 to 1."""

SQUARE = "[(-10, -10, 0), (0, -10, 0), (0, 10, 0), (-10, 10, 0)]"
MOVING = """double3 xformOp:translate.timeSamples = {0: (0, 0, 0), 2: (1, 0, 0)}
    uniform token[] xformOpOrder = ["xformOp:translate"]"""
PLANE = f"""int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = {SQUARE}"""


def stage(
    folder: Path,
    shape: str = f"{PLANE}\n{MOVING}",
    shutter: tuple[float, float] = (-0.5, 0.5),
    *,
    camera: str = "double3 xformOp:translate = (0, 0, 2)",
    settings: str = "",
    head: str = "startTimeCode = 1",
) -> Path:
    """Write a mesh seen by an orthographic camera from +Z; it moves by half a metre a frame."""
    path = folder / "shot.usda"
    path.write_text(f"""#usda 1.0
(
    metersPerUnit = 1
    {head}
)
def DomeLight "Sky"
{{
}}
def Mesh "Shape"
{{
    uniform token subdivisionScheme = "none"
    {shape}
}}
def Camera "Camera"
{{
    token projection = "orthographic"
    float horizontalAperture = {10 * COLUMNS * PIXEL}
    float verticalAperture = {10 * ROWS * PIXEL}
    double shutter:open = {shutter[0]}
    double shutter:close = {shutter[1]}
    {camera}
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
def RenderSettings "Settings" (prepend apiSchemas = ["SkinRenderSettingsAPI"])
{{
    token usdskin:pixelFilter = "box"
    token usdskin:dome = "hide"
    {settings}
}}
""")
    return path


def render(path: Path, **flags: object) -> tuple[np.ndarray, RenderReport]:
    """Return the picture of a stage, RGBA."""
    flags = {"samples": 64, "resolution": (COLUMNS, ROWS), "settings": "/Settings", **flags}
    output = path.with_name("out.exr")
    report = render_stage(path, output, RenderOverrides(**flags), SilentProgress())  # type: ignore[arg-type]
    return read_image(output).pixels, report


def ramp(opens: float, closes: float) -> np.ndarray:
    """Return how much of each pixel a plane left of an edge covers that goes from one x to another.

    Averaging over the pixel's x and over time are two boxes; their integral is known at any point
    of a fine grid.
    """
    x = (np.arange(400 * COLUMNS) + 0.5) / 400 * PIXEL - 0.5 * COLUMNS * PIXEL
    covered = np.clip((closes - x) / (closes - opens), 0.0, 1.0)
    return covered.reshape(COLUMNS, 400).mean(axis=1)


@pytest.mark.parametrize("integrator", ["map", "traced"])
def test_an_edge_that_moves_evenly_makes_an_even_ramp(tmp_path, integrator):
    picture, report = render(stage(tmp_path), integrator=integrator)
    # Eight moments: steps of 1/8, each spread over a pixel by its own samples.
    np.testing.assert_allclose(picture[4, :, 3], ramp(0.25, 0.75), atol=1 / 16 + 1e-6)
    assert picture[4, :, 3].sum() == pytest.approx(ramp(0.25, 0.75).sum(), abs=0.02)
    np.testing.assert_allclose(picture[4, :, 1], picture[4, 0, 1] * picture[4, :, 3], rtol=1e-4)
    assert not [note for note in report.notes if "motion" in note.code]


def test_more_moments_come_closer_to_the_ramp(tmp_path):
    errors = []
    for count in (2, 16):
        path = stage(tmp_path, settings=f"int usdskin:motionSamples = {count}")
        errors.append(np.abs(render(path)[0][4, :, 3] - ramp(0.25, 0.75)).max())
    assert errors[0] > 0.1 > 0.035 > errors[1]


def test_points_that_move_are_blurred(tmp_path):
    later = SQUARE.replace("(0,", "(1,")
    shape = PLANE.replace(f"points = {SQUARE}", f"points.timeSamples = {{0: {SQUARE}, 2: {later}}}")
    picture, _ = render(stage(tmp_path, shape))
    np.testing.assert_allclose(picture[4, :, 3], ramp(0.25, 0.75), atol=1 / 16 + 1e-6)


def test_a_camera_that_moves_blurs_what_holds_still(tmp_path):
    camera = "double3 xformOp:translate.timeSamples = {0: (0, 0, 2), 2: (1, 0, 2)}"
    picture, _ = render(stage(tmp_path, PLANE, camera=camera))
    np.testing.assert_allclose(picture[4, :, 3], ramp(-0.75, -0.25), atol=1 / 16 + 1e-6)


def test_a_wheel_turns_through_the_angle_of_the_shutter(tmp_path):
    """Half a plane turned evenly by 90 degrees covers each direction for its part of the time."""
    turning = """double xformOp:rotateZ.timeSamples = {0: -90, 2: 90}
    uniform token[] xformOpOrder = ["xformOp:rotateZ"]"""
    settings = "int usdskin:motionSamples = 32"
    path = stage(tmp_path, f"{PLANE}\n{turning}", settings=settings)
    picture, _ = render(path)
    x, y = np.meshgrid(
        (np.arange(COLUMNS) + 0.5 - COLUMNS / 2) * PIXEL, (ROWS / 2 - 0.5 - np.arange(ROWS)) * PIXEL
    )
    # The plane is x < 0, so at its angle a it covers the directions from a + 90 to a + 270.
    angle = np.degrees(np.arctan2(y, x)) % 360.0
    turned = np.linspace(-45.0, 45.0, 2001)
    covered = np.mean(np.abs(angle[..., None] - 180.0 - turned) < 90.0, axis=-1)
    far = np.hypot(x, y) > 0.5
    np.testing.assert_allclose(picture[..., 3][far], covered[far], atol=0.05)


@pytest.mark.parametrize(
    "still",
    [
        {"shutter": (0.0, 0.0)},
        {"shutter": (-0.5, 0.5), "shape": PLANE},
        {"shutter": (1.0, 2.0), "head": "startTimeCode = 2"},  # the motion has ended
        {"settings": "bool disableMotionBlur = 1"},
        {"settings": "bool instantaneousShutter = 1"},
    ],
)
@pytest.mark.parametrize("integrator", ["map", "traced"])
def test_what_does_not_move_has_the_pixels_of_a_closed_shutter(tmp_path, still, integrator):
    blurred, _ = render(stage(tmp_path, **still), integrator=integrator, samples=4)
    closed = {**still, "shutter": (0.0, 0.0), "settings": ""}
    sharp, _ = render(stage(tmp_path, **closed), integrator=integrator, samples=4)
    np.testing.assert_array_equal(blurred, sharp)


def test_a_still_part_of_a_blurred_picture_is_the_same_to_rounding(tmp_path):
    blurred, _ = render(stage(tmp_path), samples=16)
    sharp, _ = render(stage(tmp_path, shutter=(0.0, 0.0)), samples=16)
    np.testing.assert_allclose(blurred[:, :20], sharp[:, :20], rtol=1e-5)


def test_all_samples_are_taken_once(tmp_path):
    path = stage(tmp_path, settings="int usdskin:motionSamples = 6")
    render(path, integrator="traced", samples=20, aovs=["sampleCount", "variance"])
    part = read_image(path.with_name("out.exr"), part="sampleCount").pixels
    assert np.unique(part) == [20]


def test_data_parts_are_taken_when_the_shutter_is_half_open(tmp_path):
    path = stage(tmp_path, shutter=(0.0, 1.0))  # the edge goes from 0.5 m to 1 m
    render(path, aovs=["primId"])
    ids = read_image(path.with_name("out.exr"), part="primId").pixels[4].ravel()
    seen = ids == ids[0]
    assert np.count_nonzero(seen) == 35  # up to x = 0.75 m


def test_faces_that_change_are_held_and_noted(tmp_path):
    wide = "[(-10, -10, 0), (1, -10, 0), (1, 10, 0)]"
    shape = f"""int[] faceVertexCounts.timeSamples = {{0: [4], 1: [3]}}
    int[] faceVertexIndices.timeSamples = {{0: [0, 1, 2, 3], 1: [0, 1, 2]}}
    point3f[] points.timeSamples = {{0: {SQUARE}, 1: {wide}}}"""
    picture, report = render(stage(tmp_path, shape))
    assert [note.code for note in report.notes] == ["topology-changes"]
    # Left of x = 0 the plane of the first half, right of it half of the triangle's area.
    assert picture[4, 38, 3] == pytest.approx(0.5, abs=1e-6)


def test_a_shutter_that_closes_first_is_refused(tmp_path):
    with pytest.raises(LayerError, match=r"</Camera>.*shutter:open is 0.5, shutter:close 0,"):
        render(stage(tmp_path, shutter=(0.5, 0.0)))


def test_a_stage_without_frames_says_that_it_is_not_blurred(tmp_path):
    _, report = render(stage(tmp_path, head=""))
    assert [note.code for note in report.notes] == ["motion-blur-ignored"]


def test_blurred_pictures_are_equal_whatever_the_threads(tmp_path):
    path = stage(tmp_path)
    one, _ = render(path, threads=1, samples=16, integrator="traced")
    two, _ = render(path, threads=2, samples=16, integrator="traced")
    np.testing.assert_array_equal(one, two)


def test_the_command_line_blurs(tmp_path):
    path, output = stage(tmp_path), tmp_path / "out.exr"
    arguments = ["render", str(path), str(output), "-rs", "/Settings", "-p", "16", "-r"]
    assert cli.main([*arguments, str(COLUMNS), str(ROWS)]) == 0
    alpha = read_image(output).pixels[4, :, 3]
    assert np.count_nonzero((alpha > 0.05) & (alpha < 0.95)) > 6
