"""Samples of a pixel: which triangle each sees, and that one shading stands for all on it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import warp as wp

from usdskin.image_output import Part, write_exr
from usdskin.images import read_image
from usdskin.progress import SilentProgress
from usdskin.render.cameras import Camera
from usdskin.render.overrides import RenderOverrides
from usdskin.render.projection import project
from usdskin.render.render import render_stage
from usdskin.warp_kernels import raster

SIZE = 12

CORNER_SAMPLES = np.array([[-0.5, -0.5], [0.0, 0.0], [0.5, -0.5], [-0.25, 0.25]], np.float32)
"""Two on a corner of the pixel, one in its middle."""


def rasterized(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Return the triangles that samples see of a picture of SIZE x SIZE, a pixel a unit wide."""
    half = 0.5 * SIZE
    camera = Camera(
        "/Camera", np.eye(4), True, (-half, half, -half, half), 0.1, 100.0, 0.0, 1.0, 1.0, 1.0
    )
    samples = wp.array(CORNER_SAMPLES, dtype=wp.vec2f, device="cpu")
    ahead = np.concatenate([points, np.full((len(points), 1), -3.0)], axis=1)
    projection = project(
        ahead.astype(np.float32), triangles.astype(np.int32), camera, (SIZE, SIZE), SIZE, 0.5,
        "cpu",
    )  # fmt: skip
    assert projection is not None
    return raster.rasterize_band(projection, samples, 0, SIZE, 0, SIZE).numpy()


def net(turned: np.random.Generator | None = None) -> tuple[np.ndarray, np.ndarray]:
    """Return triangles whose vertices lie on samples, wound at random where asked to."""
    at = np.arange(-8, 9, 1.0)
    points = np.stack(np.meshgrid(at, at), axis=-1).reshape(-1, 2)
    index = np.arange(len(points)).reshape(len(at), len(at))
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:],
                                             index[1:, :-1]))  # fmt: skip
    triangles = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    if turned is not None:
        for row in triangles:
            turned.shuffle(row)
    return points, triangles


def test_samples_on_edges_and_vertices_belong_to_one_triangle_however_it_is_wound():
    points, triangles = net()
    seen = rasterized(points, triangles)
    assert (seen >= 0).all()
    for seed in range(3):
        rng = np.random.default_rng(seed)
        np.testing.assert_array_equal(rasterized(*net(rng)), seen)
        order = rng.permutation(len(triangles))
        np.testing.assert_array_equal(order[rasterized(points, triangles[order])], seen)


def test_samples_of_the_edge_of_a_surface_belong_to_the_triangle_left_of_or_above_them():
    """A square from (-2, -2) to (2, 2), y up, has its left and upper edge, not the other two."""
    points = np.array([[-2.0, -2.0], [2.0, -2.0], [2.0, 2.0], [-2.0, 2.0]])
    seen = rasterized(points, np.array([[0, 1, 2], [0, 2, 3]]))
    corner = (seen[:, 0] >= 0).reshape(SIZE, SIZE)  # the upper left corner of each pixel
    expected = np.zeros((SIZE, SIZE), bool)
    expected[4:8, 4:8] = True
    np.testing.assert_array_equal(corner, expected)


def test_the_first_of_two_surfaces_in_one_place_is_seen():
    """Not now one, now the other, as rounding has it."""
    points, triangles = net()
    seen = rasterized(points, np.concatenate([triangles, triangles[:, ::-1]]))
    assert (seen < len(triangles)).all()


def stage(folder: Path, look: str, lens: bool) -> Path:
    """Write a saddle before a panel, seen through a pinhole or next to one."""
    ramp = np.linspace(0.1, 0.9, 64, dtype=np.float32)[:, None] * np.linspace(0.2, 1.0, 128)
    picture = np.stack([ramp, ramp[::-1], ramp[:, ::-1]], axis=-1)
    part = Part("", {"": np.float32(picture)}, color_space="lin_rec709_scene")
    for name in ("ramp.exr", "sky.exr"):
        write_exr(folder / name, [part])
    at = np.linspace(-1.0, 1.0, 9)
    x, y = np.meshgrid(at, at)
    points = [
        (float(u), float(v), float(0.3 * (u * u - v * v)))
        for u, v in zip(x.flat, y.flat, strict=True)
    ]
    normals = [(-0.6 * u, 0.6 * v, 1.0) for u, v, _ in points]
    quads = [[9 * i + j, 9 * i + j + 1, 9 * i + j + 10, 9 * i + j + 9]
             for i in range(8) for j in range(8)]  # fmt: skip
    color = (
        ".connect = </Cloth/Picture.outputs:rgb>" if look == "textured" else " = (0.5, 0.4, 0.3)"
    )
    path = folder / "shot.usda"
    path.write_text(f"""#usda 1.0
(
    metersPerUnit = 1
)
def DomeLight "Sky"
{{
    asset inputs:texture:file = @sky.exr@
}}
def Camera "Camera"
{{
    float focusDistance = 7
    float fStop = {1e6 if lens else 0}
    float2 clippingRange = (0.1, 100)
    double3 xformOp:translate = (0, 0, 7)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}}
def Material "Cloth"
{{
    token outputs:surface.connect = </Cloth/Surface.outputs:surface>
    def Shader "Surface"
    {{
        uniform token info:id = "UsdPreviewSurface"
        color3f inputs:diffuseColor{color}
        float inputs:opacity = {0.5 if look == "clear" else 1}
        float inputs:roughness = 0.4
        token outputs:surface
    }}
    def Shader "Picture"
    {{
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @ramp.exr@
        token inputs:wrapS = "clamp"
        token inputs:wrapT = "clamp"
        float2 inputs:st.connect = </Cloth/St.outputs:result>
        float3 outputs:rgb
    }}
    def Shader "St"
    {{
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }}
}}
def Mesh "Saddle" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = {[4] * 64}
    int[] faceVertexIndices = {[corner for quad in quads for corner in quad]}
    point3f[] points = {points}
    normal3f[] normals = {normals} (interpolation = "vertex")
    texCoord2f[] primvars:st = {[(0.5 + 0.5 * u, 0.5 + 0.5 * v) for u, v, _ in points]} (
        interpolation = "vertex")
    rel material:binding = </Cloth>
}}
def Mesh "Panel"
{{
    uniform token subdivisionScheme = "none"
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-0.6, -3, -1), (0.07, -3, -1), (0.07, 3, -1), (-0.6, 3, -1)]
}}
""")
    return path


def render(folder: Path, look: str, lens: bool, samples: int) -> np.ndarray:
    flags = RenderOverrides(resolution=(40, 40), samples=samples, pixel_filter="box", png=False)
    output = folder / "shot.exr"
    render_stage(stage(folder, look, lens), output, flags, SilentProgress())
    return read_image(output).pixels


@pytest.mark.parametrize("samples", [4, 16])
@pytest.mark.parametrize("look", ["plain", "textured", "clear"])
def test_one_shading_stands_for_all_samples_of_a_triangle(tmp_path, look, samples):
    """Through a lens of no width every sample is shaded by itself: the same picture.

    Where a surface has a texture or is looked through, that is so through a pinhole too.
    """
    alone = render(tmp_path, look, True, samples)
    together = render(tmp_path, look, False, samples)
    assert 0.1 < alone[..., 3].mean() < 0.9
    np.testing.assert_array_equal(together[..., 3], alone[..., 3])
    tolerance = 1e-3 if look == "plain" else 1e-5
    np.testing.assert_allclose(together, alone, atol=tolerance * alone[..., :3].max())
