"""Depth of field against the thin lens: the circle of confusion of an edge out of focus."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from usdskin.images import read_image
from usdskin.progress import SilentProgress
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage

COLUMNS, ROWS = 40, 16
PIXEL = 0.0025
"""Width of a pixel, as a tangent."""

APERTURE, FOCUS = 0.05, 1.0
"""Diameter of the lens and distance of focus [m]."""


def stage(
    folder: Path,
    distance: float,
    *,
    f_stop: float = 1.0,
    unit: float = 1.0,
    settings: str = "",
    product: str = "",
) -> Path:
    """Write a plane that ends at x = 0, ``distance`` from a lens of 50 mm, in units of ``unit``."""
    path = folder / "shot.usda"
    side, length = 10.0 / unit, 1.0 / unit
    path.write_text(f"""#usda 1.0
(
    metersPerUnit = {unit}
)
def DomeLight "Sky"
{{
}}
def Mesh "Plane"
{{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [({-side}, {-side}, 0), (0, {-side}, 0), (0, {side}, 0),
        ({-side}, {side}, 0)]
    double3 xformOp:translate = (0, 0, {-distance * length})
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
def Camera "Camera"
{{
    float focalLength = {0.5 * length}
    float horizontalAperture = {0.5 * length * COLUMNS * PIXEL}
    float verticalAperture = {0.5 * length * ROWS * PIXEL}
    float2 clippingRange = ({0.01 * length}, {100 * length})
    float focusDistance = {FOCUS * length}
    float fStop = {f_stop}
}}
def RenderSettings "Settings" (prepend apiSchemas = ["SkinRenderSettingsAPI"])
{{
    token usdskin:pixelFilter = "box"
    token usdskin:dome = "hide"
    rel products = </Product>
    {settings}
}}
def RenderProduct "Product"
{{
    token productName = "out.exr"
    {product}
}}
""")
    return path


def render(path: Path, **flags: object) -> np.ndarray:
    """Return the picture of a stage, RGBA."""
    flags = {"samples": 64, "resolution": (COLUMNS, ROWS), "settings": "/Settings", **flags}
    output = path.with_name("out.exr")
    render_stage(path, output, RenderOverrides(**flags), SilentProgress())  # type: ignore[arg-type]
    return read_image(output).pixels


def covered(distance: float) -> np.ndarray:
    """Return the share of the lens from which each column sees the plane.

    A ray through the tangent u and the point a of the lens meets the plane at u d + a (1 - d / F).
    """
    u = (np.arange(200 * COLUMNS) + 0.5) / 200 * PIXEL - 0.5 * COLUMNS * PIXEL
    confusion = APERTURE * abs(distance - FOCUS) / (distance * FOCUS)
    x = np.clip(-2.0 * u / confusion, -1.0, 1.0)
    share = 0.5 + (x * np.sqrt(1.0 - x * x) + np.arcsin(x)) / np.pi
    return share.reshape(COLUMNS, 200).mean(axis=1)


def confusion_of(alpha: np.ndarray) -> float:
    """Return the diameter of the circle of confusion of an edge, as a tangent.

    The edge's slope is the disk seen from the side, whose variance is a sixteenth of the diameter's
    square; the pixels' own width adds 1/12, and taking differences of them as much.
    """
    slope = -np.diff(alpha)
    at = np.arange(1, COLUMNS) - 0.5 * COLUMNS
    mean = (slope * at).sum() / slope.sum()
    variance = (slope * (at - mean) ** 2).sum() / slope.sum() - 1.0 / 12.0
    return float(4.0 * np.sqrt(variance) * PIXEL)


@pytest.mark.parametrize("distance", [2.0, 0.6])
@pytest.mark.parametrize("integrator", ["map", "traced"])
def test_an_edge_out_of_focus_has_the_circle_of_confusion_of_a_thin_lens(
    tmp_path, integrator, distance
):
    picture = render(stage(tmp_path, distance), integrator=integrator, samples=256)
    alpha = picture[..., 3].astype(np.float64).mean(axis=0)
    np.testing.assert_allclose(alpha, covered(distance), atol=5e-3)
    expected = APERTURE * abs(distance - FOCUS) / (distance * FOCUS)
    assert confusion_of(alpha) == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize("integrator", ["map", "traced"])
def test_what_is_in_focus_is_as_sharp_as_through_a_pinhole(tmp_path, integrator):
    sharp = render(stage(tmp_path, FOCUS, f_stop=0.0), integrator=integrator)
    focused = render(stage(tmp_path, FOCUS), integrator=integrator)
    # The edge lies on the border of two pixels, where rounding decides.
    np.testing.assert_allclose(focused, sharp, atol=2e-3)


@pytest.mark.parametrize("integrator", ["map", "traced"])
@pytest.mark.parametrize("where", ["settings", "product"])
def test_depth_of_field_turned_off_gives_the_pixels_of_a_pinhole(tmp_path, integrator, where):
    pinhole = render(stage(tmp_path, 2.0, f_stop=0.0), integrator=integrator, samples=8)
    off = {where: "bool disableDepthOfField = 1"}
    disabled = render(stage(tmp_path, 2.0, **off), integrator=integrator, samples=8)
    np.testing.assert_array_equal(disabled, pinhole)
    on = {"settings": "bool disableDepthOfField = 1", "product": "bool disableDepthOfField = 0"}
    blurred = render(stage(tmp_path, 2.0, **on), integrator=integrator, samples=8)
    assert np.abs(blurred - pinhole).max() > 0.3


def test_centimetres_and_metres_are_blurred_alike(tmp_path):
    metres = render(stage(tmp_path, 2.0))
    centimetres = render(stage(tmp_path, 2.0, unit=0.01))
    np.testing.assert_allclose(centimetres, metres, atol=0.02)
    assert np.abs(centimetres - metres).mean() < 1e-4


def test_data_parts_are_seen_from_the_middle_of_the_lens(tmp_path):
    found = []
    for f_stop in (0.0, 1.0):
        path = stage(tmp_path, 2.0, f_stop=f_stop)
        render(path, aovs=["P", "Z", "primId"], samples=4)
        parts = [read_image(path.with_name("out.exr"), part=name) for name in ("P", "Z", "primId")]
        found.append([part.pixels for part in parts])
    for pinhole, lens in zip(*found, strict=True):
        np.testing.assert_array_equal(lens, pinhole)
