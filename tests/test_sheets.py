"""Skin on meshes that enclose nothing: a thickness makes them sheets that light crosses."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from usdskin.images import read_image
from usdskin.progress import SilentProgress
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage

DELTA, THICKNESS = 300.0, 0.002
"""Opacity [1/m] and thickness [m]."""

PASSED = np.exp(-DELTA * THICKNESS)

SHEET = """int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]"""

# Two millimetres below it, the same with sides.
SLAB = """int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0, 1, 2, 3, 7, 6, 5, 4, 4, 5, 1, 0, 5, 6, 2, 1, 6, 7, 3, 2,
        7, 4, 0, 3]
    point3f[] points = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0),
        (-1, -1, -0.002), (1, -1, -0.002), (1, 1, -0.002), (-1, 1, -0.002)]"""

# N.L = -1/2 for the light straight from behind: without a tilt the wrap term ends at N.L = -1.
TILTED = """normal3f[] normals = [(0.8660254, 0, 0.5)] (interpolation = "constant")"""


def render(
    folder: Path,
    shape: str,
    integrator: str,
    *,
    thickness: float = THICKNESS,
    opacity: float = DELTA,
    angle: float = 0.0,
    wrap: float = 1.0,
) -> float:
    """Return Y of skin that light reaches from behind, ``angle`` degrees off the axis."""
    path = folder / "shot.usda"
    path.write_text(f"""#usda 1.0
(
    metersPerUnit = 1
)
def DistantLight "Sun"
{{
    float inputs:intensity = 1000
    float inputs:angle = 0.5
    float xformOp:rotateY = {180 + angle}
    uniform token[] xformOpOrder = ["xformOp:rotateY"]
}}
def Mesh "Shape" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    uniform token subdivisionScheme = "none"
    rel material:binding = </Skin>
    {shape}
}}
def Material "Skin" (prepend apiSchemas = ["SkinMaterialAPI",
    "SpectralDistributionAPI:scattering"])
{{
    float inputs:skin:wrap = {wrap}
    float inputs:skin:opacity = {opacity}
    float inputs:skin:thickness = {thickness}
    uniform token spectrum:scattering:quantity = "scattering"
    double[] spectrum:scattering:wavelengths = [400, 700]
    double[] spectrum:scattering:values = [1, 1]
}}
def Camera "Camera"
{{
    token projection = "orthographic"
    float horizontalAperture = 2
    float verticalAperture = 2
    double3 xformOp:translate = (0, 0, 2)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
""")
    output = folder / "out.exr"
    given = RenderOverrides(integrator=integrator, samples=16, resolution=(4, 4))
    render_stage(path, output, given, SilentProgress())
    return float(read_image(output).pixels[..., 1].mean())


@pytest.mark.parametrize("angle", [0.0, 40.0])
def test_a_sheet_weakens_light_from_behind_by_its_thickness(tmp_path, angle):
    shape = f"{SHEET}\n{TILTED}"
    clear = render(tmp_path, shape, "traced", opacity=0.0, angle=angle)
    dimmed = render(tmp_path, shape, "traced", angle=angle)
    assert clear > 1e-4
    assert dimmed / clear == pytest.approx(PASSED, rel=1e-3)


def test_a_traced_sheet_is_as_bright_as_the_map_makes_it(tmp_path):
    shape = f"{SHEET}\n{TILTED}"
    traced, mapped = (render(tmp_path, shape, name, angle=30.0) for name in ("traced", "map"))
    assert traced == pytest.approx(mapped, rel=2e-3)


def test_a_slab_is_a_sheet_of_its_thickness(tmp_path):
    sheet = render(tmp_path, f"{SHEET}\n{TILTED}", "traced")
    slab = render(tmp_path, f"{SLAB}\n{TILTED}", "traced", thickness=0.0)
    assert slab == pytest.approx(sheet, rel=1e-3)


def test_the_thickness_of_a_primvar_counts_where_light_crosses(tmp_path):
    primvar = 'float[] primvars:skin:thickness = [0.001] (interpolation = "constant")'
    clear = render(tmp_path, f"{SHEET}\n{TILTED}", "traced", opacity=0.0)
    dimmed = render(tmp_path, f"{SHEET}\n{TILTED}\n{primvar}", "traced", thickness=0.0)
    assert dimmed / clear == pytest.approx(np.exp(-DELTA * 0.001), rel=1e-3)


def test_an_open_mesh_without_a_thickness_blocks_light_from_behind(tmp_path):
    assert render(tmp_path, f"{SHEET}\n{TILTED}", "traced", thickness=0.0) == 0.0


def test_light_from_in_front_does_not_cross_a_sheet(tmp_path):
    front = [render(tmp_path, SHEET, "traced", angle=180.0, opacity=d) for d in (0.0, DELTA)]
    assert front[0] == pytest.approx(front[1], rel=1e-4)
