"""UsdPreviewSurface 2.6 input by input: its closed forms, and one value from wherever it may come.

A card faces the camera under uniform light of radiance 1: at normal incidence a smooth surface
shows its F0, a matt one its albedo.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_scene import (
    LOBES,
    RGB_TOLERANCE,
    WHITE,
    here,  # noqa: F401  (a fixture)
    quad,
    render,
    stage_text,
    surface,
)

from usdskin.image_output import Part, write_exr, write_png

pytestmark = pytest.mark.usefixtures("here")

CARD = "rel material:binding = </Card_>"
BLACK = "color3f inputs:diffuseColor = (0, 0, 0)"
SMOOTH = "float inputs:roughness = 0"
SMALL = ("-r", "8", "8", "-p", "1")


def shown(
    body: str, nodes: str = "", attributes: str = "", primvars: str = "", light: str = WHITE
) -> np.ndarray:
    """Return the picture of a card with a UsdPreviewSurface, RGBA."""
    material = surface("Card_", body, nodes, attributes=attributes)
    return render(stage_text(light, material, quad("Card", f"{CARD}\n    {primvars}")), *SMALL)


def middle(*arguments: str, **options: str) -> np.ndarray:
    return shown(*arguments, **options)[4, 4]


# --- Closed forms

GOLD = np.array([0.8, 0.5, 0.2])


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ((BLACK, SMOOTH, "float inputs:ior = 2"), (1 / 9, 1 / 9, 1 / 9)),
        ((BLACK, SMOOTH), (0.04, 0.04, 0.04)),
        ((BLACK, SMOOTH, "float inputs:ior = 1", "float inputs:clearcoat = 1",
          "float inputs:clearcoatRoughness = 0"), (0.04, 0.04, 0.04)),
        ((BLACK, SMOOTH, "float inputs:ior = 1", "float inputs:clearcoat = 0.5",
          "float inputs:clearcoatRoughness = 0"), (0.02, 0.02, 0.02)),
        ((BLACK, SMOOTH, "int inputs:useSpecularWorkflow = 1",
          "color3f inputs:specularColor = (0.2, 0.4, 0.6)"), (0.2, 0.4, 0.6)),
        ((SMOOTH, "color3f inputs:diffuseColor = (0.8, 0.5, 0.2)", "float inputs:metallic = 1"),
         GOLD),
        ((SMOOTH, "color3f inputs:diffuseColor = (0.8, 0.5, 0.2)", "float inputs:metallic = 0.5"),
         0.5 * 0.04 + 0.5 * GOLD + 0.5 * (1.0 - 0.04) * GOLD),
        ((SMOOTH, "color3f inputs:diffuseColor = (0.8, 0.5, 0.2)", "float inputs:ior = 1"), GOLD),
        # The specular workflow knows no metal.
        ((SMOOTH, "color3f inputs:diffuseColor = (0.8, 0.5, 0.2)", "float inputs:metallic = 1",
          "int inputs:useSpecularWorkflow = 1"), GOLD),
        ((BLACK, SMOOTH, "float inputs:ior = 1", "color3f inputs:emissiveColor = (0.1, 2, 0.5)"),
         (0.1, 2.0, 0.5)),
    ],
)  # fmt: skip
def test_a_surface_at_normal_incidence_shows_what_the_specification_says(body, expected):
    found = middle("\n        ".join(body))
    np.testing.assert_allclose(found[:3], expected, atol=RGB_TOLERANCE * max(1.0, *expected))
    assert found[3] == 1.0


@pytest.mark.parametrize(
    ("body", "expected", "alpha"),
    [
        # Transparent: opacity scales the diffuse part; glass keeps its reflection.
        (("float inputs:opacity = 0", "float inputs:ior = 2"), 1 / 9, 0.0),
        (("float inputs:opacity = 0.25", "float inputs:ior = 1"), 0.25, 0.25),
        (("float inputs:opacity = 0.5", "float inputs:metallic = 1"), 1.0, 0.5),
        # Presence: it scales everything.
        (("float inputs:opacity = 0", "float inputs:ior = 2",
          'token inputs:opacityMode = "presence"'), 0.0, 0.0),
        (("float inputs:opacity = 0.5", "float inputs:metallic = 1",
          'token inputs:opacityMode = "presence"'), 0.5, 0.5),
        # A threshold cuts out, and what it leaves is opaque.
        (("float inputs:opacity = 0.4", "float inputs:opacityThreshold = 0.5",
          "float inputs:ior = 2"), 0.0, 0.0),
        (("float inputs:opacity = 0.6", "float inputs:opacityThreshold = 0.5",
          "float inputs:ior = 1"), 1.0, 1.0),
        (("float inputs:opacity = 0.5", "float inputs:opacityThreshold = 0.5",
          "float inputs:ior = 1"), 1.0, 1.0),
    ],
)  # fmt: skip
def test_opacity_scales_what_its_mode_says(body, expected, alpha):
    white = ("color3f inputs:diffuseColor = (1, 1, 1)", SMOOTH)
    found = middle("\n        ".join((*white, *body)))
    np.testing.assert_allclose(found[:3], expected, atol=RGB_TOLERANCE)
    assert found[3] == pytest.approx(alpha, abs=1e-6)


def test_roughness_keeps_the_energy_of_a_metal():
    """White and rough, it still returns most of the light (one bounce of GGX loses some)."""
    white = "color3f inputs:diffuseColor = (1, 1, 1)\n float inputs:metallic = 1\n"
    values = [middle(f"{white} float inputs:roughness = {r}")[0] for r in (0.0, 0.5, 1.0)]
    assert 1.0 + RGB_TOLERANCE > values[0] > values[1] > values[2] > 0.3


# --- One value, from wherever it may come

BASE = {
    "diffuseColor": "color3f inputs:diffuseColor = (0.6, 0.5, 0.4)",
    "clearcoat": "float inputs:clearcoat = 0.5",
    "metallic": "float inputs:metallic = 0.5",
    "opacity": "float inputs:opacity = 0.8",
    "roughness": "float inputs:roughness = 0.5",
    "clearcoatRoughness": "float inputs:clearcoatRoughness = 0.2",
}
"""Values of which each is seen, and the roughness is one that is prefiltered in any case."""

INPUTS = [
    ("diffuseColor", "color3f", (0.3, 0.2, 0.7)),
    ("emissiveColor", "color3f", (0.3, 0.2, 0.7)),
    ("specularColor", "color3f", (0.3, 0.2, 0.7)),
    ("metallic", "float", 0.75),
    ("roughness", "float", 0.3),
    ("clearcoat", "float", 1.0),
    ("clearcoatRoughness", "float", 0.5),
    ("opacity", "float", 0.25),
]


def others(name: str) -> str:
    body = [text for key, text in BASE.items() if key != name]
    if name == "specularColor":
        body.append("int inputs:useSpecularWorkflow = 1")
    return "\n        ".join(body)


def picture_node(file: str, extra: str = "", st: str = "St") -> str:
    return f"""def Shader "Picture"
    {{
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @{file}@
        float2 inputs:st.connect = </Card_/{st}.outputs:result>
        {extra}
        float3 outputs:rgb
        float outputs:r
        float outputs:g
        float outputs:a
    }}
    def Shader "St"
    {{
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }}"""


REPEAT = 'token inputs:wrapS = "repeat"\n        token inputs:wrapT = "repeat"'


def fill(file: str, value) -> None:
    pixels = np.broadcast_to(np.float32(value), (4, 4, 3)).copy()
    write_exr(Path(file), [Part("", {"": pixels}, color_space="lin_rec709_scene")])


@pytest.mark.parametrize(("name", "kind", "value"), INPUTS, ids=[item[0] for item in INPUTS])
def test_every_input_shows_a_texture_a_primvar_and_a_connection_alike(name, kind, value):
    plain = others(name)
    expected = shown(f"{plain}\n        {kind} inputs:{name} = {value}", light=LOBES)
    without = shown(plain, light=LOBES)
    assert np.abs(expected - without).max() > 0.02
    fill("value.exr", value)
    output = "rgb" if kind == "color3f" else "g"
    textured = f"{plain}\n        {kind} inputs:{name}.connect = </Card_/Picture.outputs:{output}>"
    found = shown(textured, picture_node("./value.exr", REPEAT), light=LOBES)
    np.testing.assert_allclose(found, expected, atol=4e-3, err_msg="texture")
    width = "float3" if kind == "color3f" else "float"
    reader = f"""def Shader "Reader"
    {{
        uniform token info:id = "UsdPrimvarReader_{width}"
        string inputs:varname = "painted"
        {width} outputs:result
    }}"""
    connected = f"{plain}\n        {kind} inputs:{name}.connect = </Card_/Reader.outputs:result>"
    painted = f"{kind}[] primvars:painted = {[value] * 4} (interpolation = 'vertex')"
    found = shown(connected, reader, primvars=painted, light=LOBES)
    np.testing.assert_allclose(found, expected, atol=4e-3, err_msg="primvar")
    interface = f"{plain}\n        {kind} inputs:{name}.connect = </Card_.inputs:knob>"
    found = shown(interface, attributes=f"{kind} inputs:knob = {value}", light=LOBES)
    np.testing.assert_array_equal(found, expected, err_msg="interface of the Material")


@pytest.mark.parametrize("interpolation", ["constant", "uniform", "vertex", "faceVarying"])
def test_colors_painted_on_the_mesh_are_linear_whatever_their_interpolation(interpolation):
    reader = """def Shader "Reader"
    {
        uniform token info:id = "UsdPrimvarReader_float3"
        string inputs:varname = "displayColor"
        float3 outputs:result
    }"""
    body = (
        "color3f inputs:diffuseColor.connect = </Card_/Reader.outputs:result>\n"
        "        float inputs:ior = 1\n        float inputs:roughness = 0"
    )
    count = {"constant": 1, "uniform": 1}.get(interpolation, 4)
    painted = (
        f"color3f[] primvars:displayColor = {[(0.25, 0.5, 0.75)] * count}"
        f" (interpolation = '{interpolation}')"
    )
    found = middle(body, reader, primvars=painted)
    np.testing.assert_allclose(found[:3], (0.25, 0.5, 0.75), atol=RGB_TOLERANCE)


@pytest.mark.parametrize(("kind", "value"), [("int", 1), ("float", 1.0)])
def test_whole_numbers_painted_on_the_mesh_are_read(kind, value):
    reader = f"""def Shader "Reader"
    {{
        uniform token info:id = "UsdPrimvarReader_{kind}"
        string inputs:varname = "metal"
        {kind} inputs:fallback = 0
        {kind} outputs:result
    }}"""
    body = (
        "color3f inputs:diffuseColor = (0.8, 0.5, 0.2)\n        float inputs:roughness = 0\n"
        "        float inputs:metallic.connect = </Card_/Reader.outputs:result>"
    )
    painted = f"{kind}[] primvars:metal = [{value}] (interpolation = 'uniform')"
    np.testing.assert_allclose(middle(body, reader, primvars=painted)[:3], GOLD, atol=RGB_TOLERANCE)
    fallen_back = 0.04 + (1.0 - 0.04) * GOLD
    np.testing.assert_allclose(middle(body, reader)[:3], fallen_back, atol=RGB_TOLERANCE)


# --- The texture reader

MATT = (
    "color3f inputs:diffuseColor.connect = </Card_/Picture.outputs:rgb>\n"
    "        float inputs:ior = 1\n        float inputs:roughness = 0"
)


@pytest.mark.parametrize(
    ("encoding", "expected"), [("sRGB", 0.215861), ("auto", 0.215861), ("raw", 128 / 255)]
)
def test_the_source_color_space_decides_what_a_code_value_means(encoding, expected):
    """Code 128: 0.215861 by the sRGB curve (IEC 61966-2-1)."""
    write_png(Path("grey.png"), np.full((4, 4, 3), 128, np.uint8))
    token = f'{REPEAT}\n        token inputs:sourceColorSpace = "{encoding}"'
    found = middle(MATT, picture_node("./grey.png", token))
    np.testing.assert_allclose(found[:3], expected, atol=RGB_TOLERANCE)


def test_scale_and_bias_act_on_the_decoded_color():
    fill("value.exr", (0.2, 0.4, 0.6))
    token = (
        f"{REPEAT}\n        float4 inputs:scale = (2, 1, 0.5, 1)\n"
        "        float4 inputs:bias = (0.1, 0.2, 0.3, 0)"
    )
    found = middle(MATT, picture_node("./value.exr", token))
    np.testing.assert_allclose(found[:3], (0.5, 0.6, 0.6), atol=RGB_TOLERANCE)


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        ("repeat", (0.9, 0.1, 0.9, 0.1)),
        ("clamp", (0.9, 0.1, 0.1, 0.1)),
        ("mirror", (0.9, 0.1, 0.1, 0.9)),
        ("black", (0.9, 0.1, 0.0, 0.0)),
        ("useMetadata", (0.9, 0.1, 0.0, 0.0)),
    ],
)
def test_wrap_modes_fill_what_lies_beyond_the_picture(mode, expected):
    """Two texels over s = 0 to 1, seen over s = 0 to 2; the middle of each quarter."""
    pixels = np.zeros((4, 64, 3), np.float32)
    pixels[:, :32], pixels[:, 32:] = 0.9, 0.1
    write_exr(Path("two.exr"), [Part("", {"": pixels}, color_space="lin_rec709_scene")])
    place = """
    def Shader "Place"
    {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </Card_/St.outputs:result>
        float2 inputs:scale = (2, 1)
        float2 outputs:result
    }"""
    token = f'token inputs:wrapS = "{mode}"\n        token inputs:wrapT = "repeat"'
    found = shown(MATT, picture_node("./two.exr", token, st="Place") + place)
    np.testing.assert_allclose(found[4, [1, 3, 5, 7], 0], expected, atol=0.03)


def test_a_chain_of_transforms_moves_the_picture_as_its_nodes_say():
    """Turned by 90 degrees, then moved by 1 along s: (s, t) reads (1 - t, s)."""
    ramp = np.zeros((64, 64, 3), np.float32)
    ramp[..., 0] = (np.arange(64) + 0.5) / 64  # s
    ramp[..., 1] = 1.0 - (np.arange(64)[:, None] + 0.5) / 64  # t
    write_exr(Path("ramp.exr"), [Part("", {"": ramp}, color_space="lin_rec709_scene")])
    chain = """
    def Shader "Turn"
    {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </Card_/St.outputs:result>
        float inputs:rotation = 90
        float2 outputs:result
    }
    def Shader "Move"
    {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </Card_/Turn.outputs:result>
        float2 inputs:translation = (1, 0)
        float2 outputs:result
    }"""
    token = 'token inputs:wrapS = "clamp"\n        token inputs:wrapT = "clamp"'
    found = shown(MATT, picture_node("./ramp.exr", token, st="Move") + chain)
    at = (np.arange(8) + 0.5) / 8
    s, t = np.meshgrid(at, at[::-1])
    np.testing.assert_allclose(found[..., 0], 1.0 - t, atol=0.01)
    np.testing.assert_allclose(found[..., 1], s, atol=0.01)


def test_alpha_of_a_picture_is_an_output_of_its_own():
    pixels = np.full((4, 4, 4), 255, np.uint8)
    pixels[..., 3] = 51
    write_png(Path("veil.png"), pixels)
    body = (
        "float inputs:opacity.connect = </Card_/Picture.outputs:a>\n"
        "        color3f inputs:diffuseColor = (1, 1, 1)\n        float inputs:ior = 1"
    )
    found = middle(body, picture_node("./veil.png", REPEAT))
    np.testing.assert_allclose(found, 0.2, atol=RGB_TOLERANCE)


def test_a_texture_without_a_file_shows_its_fallback():
    node = picture_node("x", "float4 inputs:fallback = (0.5, 0.25, 0.125, 1)")
    node = node.replace("        asset inputs:file = @x@\n", "")
    found = middle(MATT, node)
    np.testing.assert_allclose(found[:3], (0.5, 0.25, 0.125), atol=RGB_TOLERANCE)


def test_a_network_inside_node_graphs_shows_what_it_does_outside():
    fill("value.exr", (0.2, 0.4, 0.6))
    inside = f"""def NodeGraph "Graph"
    {{
        float3 outputs:color.connect = </Card_/Graph/Picture.outputs:rgb>
        {picture_node("./value.exr", REPEAT).replace("/Card_/", "/Card_/Graph/")}
    }}"""
    body = MATT.replace("/Picture.outputs:rgb", "/Graph.outputs:color")
    found = middle(body, inside)
    np.testing.assert_allclose(found[:3], (0.2, 0.4, 0.6), atol=RGB_TOLERANCE)
