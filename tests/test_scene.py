"""A stage's parts in a picture: what is drawn, in what shape, with which material and light.

The camera looks along -Z at the square from (-1, -1) to (1, 1), without perspective, so that a
pixel's place in the picture is a place in the stage.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from test_render import lobed_map

from usdskin import cli
from usdskin.image_output import Part, write_exr, write_png
from usdskin.images import read_headers, read_image, read_spectral
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM
from usdskin.uplift import reflectance_basis

SIZE = 32
ALPHA, WRAP, SS, DELTA = 0.5, 0.3, 0.8, 200.0


def define(kind: str, name: str, body: str = "", *schemas: str) -> str:
    """Return a prim in usda."""
    applied = ", ".join(f'"{schema}"' for schema in schemas)
    metadata = f"(prepend apiSchemas = [{applied}])" if schemas else ""
    return f'def {kind} "{name}" {metadata}\n{{\n    {body}\n}}'


WHITE = define("DomeLight", "Sky")
DARK = define("DomeLight", "Sky", "float inputs:intensity = 0")
LOBES = define("DomeLight", "Sky", "asset inputs:texture:file = @./map.exr@")


def stage_text(*prims: str, metadata: str = "") -> str:
    return "\n".join(
        [
            f"#usda 1.0\n(\n    metersPerUnit = 1\n    {metadata}\n)",
            """def Camera "Camera"
{
    token projection = "orthographic"
    float horizontalAperture = 20
    float verticalAperture = 20
    float2 clippingRange = (1, 100)
    double3 xformOp:translate = (0, 0, 10)
    uniform token[] xformOpOrder = ["xformOp:translate"]
}""",
            *prims,
        ]
    )


def quad(name: str, body: str = "", z: float = 0.0, box=(-1, -1, 1, 1), kind: str = "") -> str:
    """Return a quad that faces the camera; ``body`` holds its primvars and binding."""
    left, bottom, right, top = box
    schemas = ["MaterialBindingAPI"] if "material:binding" in body else []
    text = f"""int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [({left}, {bottom}, {z}), ({right}, {bottom}, {z}), ({right}, {top}, {z}),
        ({left}, {top}, {z})]
    texCoord2f[] primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)] (interpolation = "vertex")
    uniform token subdivisionScheme = "none"
    {kind}
    {body}"""
    return define("Mesh", name, text, *schemas)


def colored(color, opacity: float = 1.0) -> str:
    return (
        f"color3f[] primvars:displayColor = [{tuple(color)}]\n"
        f"    float[] primvars:displayOpacity = [{opacity}]"
    )


def surface(name: str, body: str, nodes: str = "", *schemas: str, attributes: str = "") -> str:
    """Return a Material with a UsdPreviewSurface."""
    node = define(
        "Shader",
        "Surface",
        f"""uniform token info:id = "UsdPreviewSurface"
    {body}
    token outputs:surface""",
    )
    output = f"token outputs:surface.connect = </{name}/Surface.outputs:surface>"
    return define("Material", name, "\n".join((attributes, output, node, nodes)), *schemas)


def spectrum(name: str, quantity: str, values, wavelengths=(400.0, 700.0)) -> str:
    return f"""uniform token spectrum:{name}:quantity = "{quantity}"
    double[] spectrum:{name}:wavelengths = {[float(value) for value in wavelengths]}
    double[] spectrum:{name}:values = {[float(value) for value in values]}"""


def skin(body: str = "", *spectra: str, name: str = "Skin") -> str:
    """Return a skin material; ``spectra`` are the names of the spectra that ``body`` authors."""
    text = f"""float inputs:skin:alpha = {ALPHA}
    float inputs:skin:wrap = {WRAP}
    {spectrum("scattering", "scattering", (SS, SS))}
    {body}"""
    applied = [f"SpectralDistributionAPI:{item}" for item in ("scattering", *spectra)]
    return define("Material", name, text, "SkinMaterialAPI", *applied)


SPHERE = """def Sphere "Ball" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    double radius = 0.9
    rel material:binding = </Ball_>
}"""

SPECTRAL_WHITE = define(
    "DomeLight",
    "Sky",
    'uniform token inputs:spectral:source = "tabulated"\n    '
    + spectrum("emission", "relative", (1.0, 1.0), (380.0, 720.0)),
    "SpectralLightAPI",
    "SpectralDistributionAPI:emission",
)

TEXTURE = """def Shader "Picture"
    {{
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @{file}@
        token inputs:wrapS = "clamp"
        token inputs:wrapT = "clamp"
        float2 inputs:st.connect = </{material}/St.outputs:result>
        float3 outputs:rgb
    }}
    def Shader "St"
    {{
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "st"
        float2 outputs:result
    }}"""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """Go to an empty folder with the lobed map."""
    monkeypatch.chdir(tmp_path)
    write_exr(Path("map.exr"), [Part("", {"": lobed_map()}, color_space="lin_rec709_scene")])
    return tmp_path


def render(text: str, *arguments: str, name: str = "shot") -> np.ndarray:
    """Render a stage through the command; return the beauty, RGBA."""
    Path(f"{name}.usda").write_text(text)
    given = ["-r", str(SIZE), str(SIZE), "-p", "4", "--no-png", "--filter", "box", *arguments]
    assert cli.main(["-q", "render", f"{name}.usda", f"{name}.exr", *given]) == 0
    return read_image(f"{name}.exr").pixels


def spectra(text: str, *arguments: str, name: str = "shot") -> np.ndarray:
    render(text, "--spectral", *arguments, name=name)
    return read_spectral(f"{name}.spectral.exr")[1]


def corners(picture: np.ndarray) -> dict[str, list[float]]:
    """Return RGB in the middle of the picture's quarters."""
    near, far = SIZE // 4, 3 * SIZE // 4
    places = {
        "top left": (near, near),
        "top right": (near, far),
        "bottom left": (far, near),
        "bottom right": (far, far),
    }
    return {place: picture[at][:3].tolist() for place, at in places.items()}


# Of RGB under a white dome: on 400 to 700 nm D65 is not quite the white of the color space.
RGB_TOLERANCE = 4e-3


def assert_colors(picture: np.ndarray, expected: dict[str, tuple[float, float, float]]) -> None:
    found = corners(picture)
    for place, color in expected.items():
        atol = RGB_TOLERANCE * max(*color, 1.0)
        np.testing.assert_allclose(found[place], color, atol=atol, err_msg=place)


# --- What is drawn


def test_display_color_is_seen_under_white_light(here):
    picture = render(stage_text(WHITE, quad("Card", colored((0.2, 0.5, 0.8)))))
    expected = np.broadcast_to((0.2, 0.5, 0.8), (SIZE, SIZE, 3))
    np.testing.assert_allclose(picture[..., :3], expected, atol=RGB_TOLERANCE)
    assert (picture[..., 3] == 1.0).all()


def test_display_color_runs_between_the_vertices(here):
    body = (
        "color3f[] primvars:displayColor = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]"
        ' (interpolation = "vertex")'
    )
    picture = render(stage_text(WHITE, quad("Card", body)))
    x = np.broadcast_to((np.arange(SIZE) + 0.5) / SIZE, (SIZE, SIZE))
    np.testing.assert_allclose(picture[..., 0], x, atol=RGB_TOLERANCE)
    np.testing.assert_allclose(picture[..., 1], 1.0 - x.T, atol=RGB_TOLERANCE)


@pytest.mark.parametrize(
    "hidden",
    [
        'token visibility = "invisible"',
        'uniform token purpose = "guide"',
        'uniform token purpose = "proxy"',
        'token visibility.timeSamples = { 0: "invisible", 10: "inherited" }',
    ],
)
def test_what_is_invisible_or_of_another_purpose_is_not_drawn(hidden, here):
    card = quad("Card", colored((1, 0, 0)), kind=hidden)
    group = define("Xform", "Group", f"{hidden}\n{quad('Other', colored((1, 0, 0)))}")
    back = quad("Back", colored((0, 0, 1)), z=-1)
    picture = render(stage_text(WHITE, card, group, back, metadata="startTimeCode = 0"))
    assert_colors(picture, {"top left": (0, 0, 1)})


def test_purposes_and_mask_choose_what_is_drawn(here):
    proxy = quad("Proxy", colored((1, 0, 0)), kind='uniform token purpose = "proxy"')
    seen = quad("Seen", colored((0, 1, 0)), z=-1, kind='uniform token purpose = "render"')
    back = quad("Back", colored((0, 0, 1)), z=-2)
    text = stage_text(WHITE, proxy, seen, define("Scope", "Set", back))
    assert_colors(render(text), {"top left": (0, 1, 0)})
    assert_colors(render(text, "--purposes", "default,proxy"), {"top left": (1, 0, 0)})
    assert_colors(render(text, "--purposes", "default"), {"top left": (0, 0, 1)})
    assert_colors(render(text, "--mask", "/Set"), {"top left": (0, 0, 1)})
    assert_colors(render(text, "--mask", "/Set/Back,/Proxy"), {"top left": (0, 0, 1)})


def test_native_instances_are_drawn_like_copies(here):
    prototype = quad("Card", colored((0.8, 0.4, 0.1)), box=(-1, -1, 0, 0))
    library = f'class "Library"\n{{\n{prototype}\n}}'
    places = ((0.0, 0.0), (1.0, 0.9))
    instances, copies = [], []
    for k, (x, y) in enumerate(places):
        moved = f"""double3 xformOp:translate = ({x}, {y}, 0)
    double xformOp:rotateZ = 5
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateZ"]"""
        instance = define("Xform", f"I{k}", moved)
        arc = "(instanceable = true\n references = </Library>)\n{"
        instances.append(instance.replace("\n{", arc, 1))
        copies.append(define("Xform", f"C{k}", f"{moved}\n{prototype}"))
    instanced = render(stage_text(LOBES, library, *instances))
    copied = render(stage_text(LOBES, *copies))
    assert 0.3 < instanced[..., 3].mean() < 0.6
    np.testing.assert_array_equal(instanced, copied)


def test_subsets_show_their_own_materials(here):
    """The left half is bound by a subset, the right half by the mesh."""
    mesh = """def Mesh "Card" (prepend apiSchemas = ["MaterialBindingAPI"])
{
    int[] faceVertexCounts = [4, 4]
    int[] faceVertexIndices = [0, 1, 2, 3, 1, 4, 5, 2]
    point3f[] points = [(-1, -1, 0), (0, -1, 0), (0, 1, 0), (-1, 1, 0), (1, -1, 0), (1, 1, 0)]
    uniform token subdivisionScheme = "none"
    rel material:binding = </Blue>
    def GeomSubset "Left" (prepend apiSchemas = ["MaterialBindingAPI"])
    {
        uniform token elementType = "face"
        uniform token familyName = "materialBind"
        int[] indices = [0]
        rel material:binding = </Red>
    }
}"""
    glow = "int inputs:useSpecularWorkflow = 1\n color3f inputs:diffuseColor = (0, 0, 0)\n"
    red = surface("Red", f"{glow} color3f inputs:emissiveColor = (1, 0, 0)")
    blue = surface("Blue", f"{glow} color3f inputs:emissiveColor = (0, 0, 3)")
    picture = render(stage_text(DARK, mesh, red, blue))
    assert_colors(picture, {"top left": (1, 0, 0), "bottom left": (1, 0, 0)})
    assert_colors(picture, {"top right": (0, 0, 3), "bottom right": (0, 0, 3)})


WEDGE_POINTS = ((-0.8, -0.8, 0), (0.6, -0.7, 0.3), (0.7, 0.8, -0.2), (-0.5, 0.5, 0.4), (0, 0, 1))


def wedge(kind: str = "", mirrored: bool = False, turned: bool = False, scheme="none") -> str:
    """Return a lopsided pyramid of skin, its points mirrored in x, its faces wound backwards."""
    faces = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (3, 2, 1, 0)]
    if turned:
        faces = [face[::-1] for face in faces]
    points = [(-x if mirrored else x, y, z) for x, y, z in WEDGE_POINTS]
    return f"""def Mesh "Wedge" (prepend apiSchemas = ["MaterialBindingAPI"])
{{
    int[] faceVertexCounts = {[len(face) for face in faces]}
    int[] faceVertexIndices = {[corner for face in faces for corner in face]}
    point3f[] points = {points}
    uniform token subdivisionScheme = "{scheme}"
    rel material:binding = </Skin>
    {kind}
}}"""


@pytest.mark.parametrize("scheme", ["none", "catmullClark"])
@pytest.mark.parametrize(
    ("kind", "mirrored", "turned"),
    [
        ('uniform token orientation = "leftHanded"', False, True),
        (
            "double3 xformOp:scale = (-1, 1, 1)\n"
            '    uniform token[] xformOpOrder = ["xformOp:scale"]',
            True,
            True,
        ),
        (
            'uniform token orientation = "leftHanded"\n'
            "    double3 xformOp:scale = (-1, 1, 1)\n"
            '    uniform token[] xformOpOrder = ["xformOp:scale"]',
            True,
            False,
        ),
    ],
    ids=["left-handed", "mirrored", "left-handed and mirrored"],
)
def test_handedness_does_not_change_the_picture(kind, mirrored, turned, scheme, here):
    plain = render(stage_text(LOBES, skin(), wedge(scheme=scheme)), "--level", "2")
    other = render(stage_text(LOBES, skin(), wedge(kind, mirrored, turned, scheme)), "--level", "2")
    assert plain[..., 3].mean() > 0.08
    # A sample on an edge may go to either face.
    differs = np.abs(other - plain).max(axis=-1) > 2e-4 * plain.max()
    assert differs.sum() <= 2


def test_the_subdivision_level_comes_from_flag_or_settings(here):
    cube = """def Mesh "Cube"
{
    int[] faceVertexCounts = [4, 4, 4, 4, 4, 4]
    int[] faceVertexIndices = [0, 1, 3, 2, 2, 3, 5, 4, 4, 5, 7, 6,
        6, 7, 1, 0, 1, 7, 5, 3, 6, 0, 2, 4]
    point3f[] points = [(-1, -1, 1), (1, -1, 1), (-1, 1, 1), (1, 1, 1),
        (-1, 1, -1), (1, 1, -1), (-1, -1, -1), (1, -1, -1)]
}"""
    settings = """def RenderSettings "Render" (prepend apiSchemas = ["SkinRenderSettingsAPI"])
{
    int usdskin:subdivisionLevel = 3
}"""
    text = stage_text(WHITE, cube, settings)
    coverage = [render(text, "--level", level)[..., 3].mean() for level in "0123"]
    assert coverage[0] == 1.0
    # From level 1 on the points lie on the limit surface, which bulges between them.
    assert 0.4 < coverage[1] < coverage[2] < coverage[3] < 0.6
    assert coverage[3] - coverage[2] < 0.02
    authored = render(text, "-rs", "/Render")
    assert authored[..., 3].mean() == coverage[3]


def test_a_plane_that_passes_the_camera_is_seen_as_far_as_it_reaches(here):
    """Rays and rasterised triangles alike: depth is that of the plane, to the horizon."""
    camera = """def Camera "Eye"
{
    float focalLength = 10
    float horizontalAperture = 20
    float verticalAperture = 20
    float2 clippingRange = (0.01, 1000)
}"""
    floor = """def Mesh "Floor"
{
    int[] faceVertexCounts = [4]
    int[] faceVertexIndices = [0, 1, 2, 3]
    point3f[] points = [(-2000, -1, NEAR), (2000, -1, NEAR), (2000, -1, -2000), (-2000, -1, -2000)]
    uniform token subdivisionScheme = "none"
}"""
    slope = -((np.arange(SIZE) + 0.5) / SIZE * 2.0 - 1.0)  # tangent of the elevation, per row
    expected = np.where(slope < -1e-3, 1.0 / np.maximum(-slope, 1e-3), np.inf)
    for near in (500.0, -0.011, -0.5):
        text = stage_text(WHITE, camera, floor.replace("NEAR", str(near)))
        picture = render(text, "-cam", "/Eye", "--aov", "Z")
        depth = read_image("shot.exr", part="Z").pixels[..., 0]
        np.testing.assert_allclose(depth, np.tile(expected[:, None], (1, SIZE)), rtol=1e-3)
        np.testing.assert_array_equal(picture[..., 3] == 1.0, np.isfinite(depth))


@pytest.mark.parametrize("projection", ["perspective", "orthographic"])
def test_rays_see_what_rasterised_triangles_show(projection, here):
    """A triangle across the near plane, out of sight, has the picture traced by rays."""
    camera = f"""def Camera "Eye"
{{
    token projection = "{projection}"
    float focalLength = 30
    float horizontalAperture = 20
    float verticalAperture = 20
    float2 clippingRange = (1, 100)
    double3 xformOp:translate = (0.5, 1.5, 4)
    double3 xformOp:rotateXYZ = (-20, 10, 5)
    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]
}}"""
    crossing = """def Mesh "Crossing"
{
    int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(90, 0, 9), (90, 0.1, -20), (90.1, 0, 9)]
    uniform token subdivisionScheme = "none"
}"""
    veil = quad("Veil", colored((0.2, 0.9, 0.2), opacity=0.4), z=1.2, box=(-0.5, -0.5, 1, 1))
    prims = [LOBES, skin("float inputs:skin:specular:weight = 1"), camera, wedge(), veil,
             SPHERE.replace("Ball_", "Skin").replace("0.9", "0.5")]  # fmt: skip
    size = ("-r", "97", "61", "-cam", "/Eye", "--aov", "primId,Z")
    rasterised = render(stage_text(*prims), *size)
    traced = render(stage_text(*prims, crossing), *size)
    assert 0.1 < rasterised[..., 3].mean() < 0.9
    differs = np.abs(traced - rasterised).max(axis=-1) > 1e-4 * rasterised.max()
    assert differs.sum() <= 2  # a sample on an edge may go to either face


# --- Materials


@pytest.mark.parametrize("shown", ["preview", "skin"])
def test_each_corner_shows_its_own_texel(shown, here):
    """Row 0 of a file is t = 1: the first texel is in the top left corner."""
    texels = np.array([[[255, 0, 0], [0, 255, 0]], [[0, 0, 255], [255, 255, 255]]], np.uint8)
    write_png(Path("four.png"), texels.repeat(8, axis=0).repeat(8, axis=1))
    if shown == "preview":
        material = surface(
            "Card_",
            "color3f inputs:diffuseColor.connect = </Card_/Picture.outputs:rgb>\n"
            "        float inputs:ior = 1\n        float inputs:roughness = 0",
            TEXTURE.format(file="./four.png", material="Card_"),
        )
        scale = 1.0
    else:
        material = skin("asset inputs:skin:albedo:file = @./four.png@", name="Card_")
        scale = ALPHA * (1.0 + (1.0 + WRAP) * SS)
    picture = render(stage_text(WHITE, material, quad("Card", "rel material:binding = </Card_>")))
    expected = {
        "top left": (scale, 0, 0),
        "top right": (0, scale, 0),
        "bottom left": (0, 0, scale),
        "bottom right": (scale, scale, scale),
    }
    assert_colors(picture, expected)


def test_st_runs_from_the_bottom_left(here):
    render(stage_text(WHITE, quad("Card", colored((1, 1, 1)))), "--aov", "st")
    st = read_image("shot.exr", part="st").pixels
    at = (np.arange(SIZE) + 0.5) / SIZE
    np.testing.assert_allclose(st[..., 0], np.tile(at, (SIZE, 1)), atol=1e-5)
    np.testing.assert_allclose(st[..., 1], np.tile(1.0 - at[:, None], (1, SIZE)), atol=1e-5)


def test_half_of_a_grey_lies_over_white(here):
    white = quad("Back", colored((1, 1, 1)), z=-1)
    half = quad("Front", colored((0.5, 0.5, 0.5), opacity=0.5))
    plain = render(stage_text(WHITE, white))
    both = render(stage_text(WHITE, white, half))
    np.testing.assert_allclose(both[..., :3], 0.75 * plain[..., :3], rtol=1e-5)
    assert (both[..., 3] == 1.0).all()
    alone = render(stage_text(WHITE, half))
    np.testing.assert_allclose(alone[..., :3], 0.25 * plain[..., :3], rtol=1e-5)
    np.testing.assert_allclose(alone[..., 3], 0.5, rtol=1e-6)
    over_sky = render(stage_text(WHITE, half), "--dome", "show")
    sky = render(stage_text(WHITE, quad("Off", box=(5, 5, 6, 6))), "--dome", "show")
    np.testing.assert_allclose(over_sky, sky * 0.75 + [0, 0, 0, 0.25], rtol=1e-4)


def test_opacity_below_the_threshold_is_cut_out(here):
    cutout = surface(
        "Leaf",
        "float inputs:opacity.connect = </Leaf/Picture.outputs:a>\n"
        "        float inputs:opacityThreshold = 0.5\n"
        "        color3f inputs:diffuseColor = (0, 1, 0)\n        float inputs:ior = 1",
        TEXTURE.format(file="./mask.png", material="Leaf").replace(
            "float3 outputs:rgb", "float outputs:a"
        ),
    )
    texels = np.full((2, 2, 4), 255, np.uint8)
    texels[0, 0, 3] = 0
    write_png(Path("mask.png"), texels)
    picture = render(stage_text(WHITE, cutout, quad("Card", "rel material:binding = </Leaf>")))
    assert picture[SIZE // 8, SIZE // 8, 3] == 0.0
    assert picture[-SIZE // 8, SIZE // 8, 3] == 1.0
    assert set(np.unique(picture[..., 3]).tolist()) <= {0.0, 0.25, 0.5, 0.75, 1.0}


def test_emission_is_seen_as_authored_in_the_dark(here):
    glow = surface("Lamp", "color3f inputs:emissiveColor = (1, 2, 3)")
    picture = render(stage_text(DARK, glow, quad("Card", "rel material:binding = </Lamp>")))
    assert_colors(picture, {"top left": (1, 2, 3)})


@pytest.mark.parametrize("roughness", [0.0, 0.2, 0.5, 1.0])
@pytest.mark.parametrize(
    ("kind", "least"),
    [
        ("float inputs:metallic = 1", 0.3),
        ("float inputs:metallic = 0", 0.75),
        ("float inputs:metallic = 0.5", 0.6),
        ("float inputs:clearcoat = 1\n float inputs:clearcoatRoughness = 0.1", 0.75),
        ("int inputs:useSpecularWorkflow = 1\n color3f inputs:specularColor = (.5, .5, .5)", 0.6),
    ],
)
def test_white_surfaces_return_no_more_light_than_they_receive(kind, least, roughness, here):
    body = f"color3f inputs:diffuseColor = (1, 1, 1)\n float inputs:roughness = {roughness}\n{kind}"
    text = stage_text(SPECTRAL_WHITE, SPHERE, surface("Ball_", body))
    Path("shot.usda").write_text(text)
    found = spectra(text, "-p", "1")
    inside = read_image("shot.exr").pixels[..., 3] == 1.0
    assert found[inside].max() <= 1.0 + 2e-3
    assert found[inside].min() >= least


def test_a_mirror_shows_each_lobe_where_it_reflects_it(here):
    """Seen from +Z: blue (+Z) in the middle, red (+X) to the right, green (+Y) above."""
    mirror = "color3f inputs:diffuseColor = (1, 1, 1)\n float inputs:metallic = 1\n"
    text = stage_text(LOBES, SPHERE, surface("Ball_", f"{mirror} float inputs:roughness = 0.05"))
    picture = render(text)
    off = round(0.9 * np.sqrt(0.5) * SIZE / 2)
    for channel, (row, column) in enumerate(((0, off), (-off, 0), (0, 0))):
        seen = picture[SIZE // 2 + row, SIZE // 2 + column, :3]
        assert np.argmax(seen) == channel and seen[channel] > 2.0
    away = picture[SIZE // 2, SIZE // 2 - off, :3]  # -X, where there is no lobe
    np.testing.assert_allclose(away, 0.05, atol=0.02)


def test_data_parts_hold_what_the_middle_of_a_pixel_sees(here):
    back = quad("Back", colored((0.5, 0.25, 0.125)), z=-2, box=(-1, -1, 0, 1))
    front = quad("Front", colored((0.2, 0.4, 0.8)), z=1, box=(-1, -1, 0, 0))
    render(stage_text(WHITE, back, front), "--aov", "all")
    part = {header.name: header for header in read_headers("shot.exr")}
    data = {name: read_image("shot.exr", part=name).pixels for name in part}
    at = {"front": (SIZE - 4, 3), "back": (3, 3), "nothing": (3, SIZE - 4)}
    depth = {place: data["Z"][pixel][0] for place, pixel in at.items()}
    assert depth == {"front": 9.0, "back": 12.0, "nothing": np.inf}
    np.testing.assert_allclose(data["N"][at["front"]], (0, 0, 1), atol=1e-6)
    x, y = (3.5 / SIZE * 2 - 1), (3.5 / SIZE * 2 - 1)
    np.testing.assert_allclose(data["P"][at["front"]], (x, y, 1), atol=1e-6)
    np.testing.assert_allclose(data["P"][at["back"]], (x, -y, -2), atol=1e-6)
    np.testing.assert_allclose(data["albedo"][at["back"]], (0.5, 0.25, 0.125), atol=RGB_TOLERANCE)
    np.testing.assert_allclose(data["irradiance"][at["back"]], np.pi, rtol=RGB_TOLERANCE)
    ids = dict(
        line.split(" ", 1)[::-1]
        for line in part["primId"].attributes["usdskin/primIds"].splitlines()
    )
    assert data["primId"][at["front"]] == int(ids["/Front"])
    assert data["primId"][at["back"]] == int(ids["/Back"])
    assert data["primId"][at["nothing"]] == 0


def test_a_spectral_reflectance_takes_the_place_of_the_diffuse_color(here):
    values = 0.5 + 0.4 * np.sin(DEFAULT_WAVELENGTHS_NM / 20.0)
    material = surface(
        "Card_",
        "color3f inputs:diffuseColor = (1, 0, 0)\n        float inputs:ior = 1\n"
        "        float inputs:roughness = 0",
        "",
        "SpectralDistributionAPI:reflectance",
        attributes=spectrum("reflectance", "reflectance", values, DEFAULT_WAVELENGTHS_NM),
    )
    card = quad("Card", "rel material:binding = </Card_>")
    found = spectra(stage_text(SPECTRAL_WHITE, material, card))
    from usdskin.spectrum import resample

    expected = resample(DEFAULT_WAVELENGTHS_NM, values, DEFAULT_WAVELENGTHS_NM, outside="hold")
    np.testing.assert_allclose(found[8, 8], expected, atol=2e-4)


def test_an_albedo_texture_is_the_reflectance_of_its_color(here):
    color = np.array([0.7, 0.4, 0.3])
    texture = np.broadcast_to(color, (4, 4, 3)).astype(np.float32)
    write_exr(Path("face.exr"), [Part("", {"": texture}, color_space="lin_rec709_scene")])
    card = quad("Card", "rel material:binding = </Skin>")
    textured = spectra(
        stage_text(SPECTRAL_WHITE, skin("asset inputs:skin:albedo:file = @./face.exr@"), card)
    )
    values = color @ reflectance_basis(DEFAULT_WAVELENGTHS_NM)
    expected = ALPHA * values * (1.0 + (1.0 + WRAP) * SS)
    np.testing.assert_allclose(textured[8, 8], expected, atol=2e-4)


@pytest.mark.parametrize("count", [1, 3, 6])
def test_a_weights_texture_is_the_weighted_sum_of_its_spectra(count, here):
    weights = np.linspace(0.05, 0.2, count)
    channels = {f"w{k}": np.full((4, 4), weights[k], np.float32) for k in range(count)}
    write_exr(Path("weights.exr"), [Part("", channels)])
    basis = np.random.default_rng(count).uniform(0.1, 0.9, (count, 2))
    card = quad("Card", "rel material:binding = </Skin>")
    weighted = skin(
        f"""asset inputs:skin:weights:file = @./weights.exr@
    double[] inputs:skin:weights:basis = {basis.ravel().tolist()}
    double[] inputs:skin:weights:basis:wavelengths = [400, 700]"""
    )
    summed = skin(spectrum("reflectance", "reflectance", weights @ basis), "reflectance")
    found = spectra(stage_text(SPECTRAL_WHITE, weighted, card), name="weighted")
    expected = spectra(stage_text(SPECTRAL_WHITE, summed, card), name="summed")
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def slab(thickness: str) -> str:
    return quad("Card", f"rel material:binding = </Skin>\n    {thickness}")


def test_a_thickness_primvar_wins_over_the_attribute_and_means_the_same(here):
    opacity = spectrum("opacity", "absorption", (20.0, DELTA))
    by_attribute = skin(f"float inputs:skin:thickness = 0.004\n {opacity}", "opacity")
    by_primvar = skin(f"float inputs:skin:thickness = 9\n {opacity}", "opacity")
    constant = 'float primvars:skin:thickness = 0.004 (interpolation = "constant")'
    expected = spectra(stage_text(SPECTRAL_WHITE, by_attribute, slab("")), name="attribute")
    found = spectra(stage_text(SPECTRAL_WHITE, by_primvar, slab(constant)), name="primvar")
    np.testing.assert_allclose(found, expected, rtol=1e-5)


@pytest.mark.parametrize("depth", [1.0, 10.0, 100.0, 1000.0])
def test_light_from_behind_falls_off_with_the_thickness_at_every_point(depth, here):
    """Closed form under uniform light: the part from behind is l^2/(1 + l) exp(-s delta)."""
    opacity = spectrum("opacity", "absorption", (DELTA / 10.0, DELTA))
    most = depth / DELTA
    ramp = f'float[] primvars:skin:thickness = [0, {most}, {most}, 0] (interpolation = "vertex")'
    text = stage_text(SPECTRAL_WHITE, skin(opacity, "opacity"), slab(ramp))
    found = spectra(text, "-p", "1")[SIZE // 2]
    s = most * (np.arange(SIZE) + 0.5) / SIZE
    delta = np.interp(DEFAULT_WAVELENGTHS_NM, (400.0, 700.0), (DELTA / 10.0, DELTA))
    behind = WRAP**2 / (1.0 + WRAP) * np.exp(-s[:, None] * delta)
    front = (1.0 + WRAP) - WRAP**2 / (1.0 + WRAP)
    np.testing.assert_allclose(found, ALPHA * (1.0 + SS * (front + behind)), atol=2e-4)


# --- Lights


def test_lights_add_up(here):
    turned = "double xformOp:rotateY = 70\nuniform token[] xformOpOrder = ['xformOp:rotateY']"
    sky = define("DomeLight", "Sky", f"asset inputs:texture:file = @./map.exr@\n{turned}")
    room = define(
        "DomeLight",
        "Room",
        """uniform token inputs:spectral:source = "blackbody"
    float inputs:colorTemperature = 3000
    float inputs:intensity = 0.4""",
        "SpectralLightAPI",
    )
    sun = define(
        "DistantLight", "Sun", f"float inputs:angle = 2\nfloat inputs:intensity = 900\n{turned}"
    )
    body = skin("float inputs:skin:specular:weight = 0.5"), SPHERE.replace("Ball_", "Skin")
    alone = [render(stage_text(light, *body)) for light in (sky, room, sun)]
    together = render(stage_text(sky, room, sun, *body))
    total = sum(picture[..., :3] for picture in alone)
    assert all(picture[..., :3].max() > 0.05 * total.max() for picture in alone)
    np.testing.assert_allclose(together[..., :3], total, atol=1e-3 * total.max())
    np.testing.assert_array_equal(together[..., 3], alone[0][..., 3])


def test_the_cameras_exposure_scales_the_beauty_and_not_the_spectra(here):
    text = stage_text(WHITE, quad("Card", colored((0.5, 0.5, 0.5))))
    plain_spectra = spectra(text, name="plain")
    plain = read_image("plain.exr").pixels
    exposed = text.replace("float2 clipping", "float exposure = 2\n    float2 clipping", 1)
    found = spectra(exposed, name="exposed")
    np.testing.assert_array_equal(found, plain_spectra)
    bright = read_image("exposed.exr").pixels
    np.testing.assert_allclose(bright[..., :3], 4.0 * plain[..., :3], rtol=1e-6)
    np.testing.assert_array_equal(bright[..., 3], plain[..., 3])


# --- Frames and files

MOVING = quad(
    "Card",
    colored((1, 1, 1)),
    box=(-1, -1, 0, 1),
    kind="""double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (1, 0, 0) }
    uniform token[] xformOpOrder = ["xformOp:translate"]""",
)


def test_frames_show_their_own_moment_and_existing_ones_are_kept(here, capfd):
    Path("shot.usda").write_text(stage_text(WHITE, MOVING))
    command = ["-q", "render", "shot.usda", "out.####.exr", "-r", "32", "32", "-p", "4",
               "--filter", "box", "--no-png"]  # fmt: skip
    assert cli.main([*command, "-f", "1-3"]) == 0
    for frame, first in ((1, 0), (2, 8), (3, 16)):
        alpha = read_image(f"out.{frame:04}.exr").pixels[16, :, 3]
        np.testing.assert_array_equal(np.flatnonzero(alpha), np.arange(first, first + 16))
    mine = Path("out.0001.exr").read_bytes()
    Path("out.0002.exr").write_bytes(mine)
    Path("out.0003.exr").unlink()
    capfd.readouterr()
    assert cli.main([*command, "-f", "1-3", "--skip-existing"]) == 0
    told = capfd.readouterr().err
    assert told.count("frames-skipped <out.####.exr>: 2 frames were there already") == 1
    assert Path("out.0002.exr").read_bytes() == mine
    assert Path("out.0003.exr").exists()
    Path("out.0001.exr").write_bytes(b"")
    Path("out.0003.exr").write_bytes(b"no picture")
    assert cli.main([*command, "-f", "1-3", "--skip-existing"]) == 0
    assert "1 frame was there already" in capfd.readouterr().err
    assert Path("out.0001.exr").read_bytes() == mine
    assert read_image("out.0003.exr").pixels.shape[:2] == (32, 32)
    assert sorted(path.name for path in here.glob("out*")) == [f"out.000{k}.exr" for k in (1, 2, 3)]


def test_a_frame_that_fails_does_not_keep_the_others_from_being_rendered(here, capfd):
    points = MOVING[MOVING.index("[(-1, -1, 0.0)") : MOVING.index("texCoord2f")].strip()
    broken = MOVING.replace(
        f"points = {points}",
        f"points.timeSamples = {{ 1: {points}, 2: [(nan, 0, 0)], 3: {points} }}",
    )
    Path("shot.usda").write_text(stage_text(WHITE, broken))
    command = ["-q", "render", "shot.usda", "out.####.exr", "-r", "8", "8", "-f", "1-3"]
    assert cli.main(command) == 5
    assert sorted(path.name for path in here.glob("out*.exr")) == ["out.0001.exr", "out.0003.exr"]
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("usdskin: error: 1 frame") and "2" in line and "/Card" in line


def test_products_and_variables_name_the_files_and_their_parts(here, capfd):
    settings = """def RenderSettings "Render"
{
    uniform int2 resolution = (16, 8)
    rel camera = </Camera>
    rel products = [</Render/Main>, </Render/Bands>]
    def RenderProduct "Main"
    {
        token productName = "main.exr"
        rel orderedVars = [</Render/Color>, </Render/Depth>, </Render/Normals>]
    }
    def RenderProduct "Bands"
    {
        token productName = "bands.exr"
        uniform int2 resolution = (4, 4)
        rel orderedVars = </Render/Spectra>
    }
VARIABLES
}"""
    sources = {"Color": "Ci", "Depth": "Z", "Normals": "N", "Spectra": "spectral"}
    variables = [
        define("RenderVar", name, f'uniform string sourceName = "{source}"')
        for name, source in sources.items()
    ]
    settings = settings.replace("VARIABLES", "\n".join(variables))
    text = stage_text(WHITE, quad("Card"), settings, metadata='renderSettingsPrimPath = "/Render"')
    Path("shot.usda").write_text(text)
    assert cli.main(["-q", "render", "shot.usda"]) == 0
    assert capfd.readouterr().out.split() == ["main.exr", "main.png", "bands.exr"]
    headers = read_headers("main.exr")
    assert [(part.name, part.width, part.height) for part in headers] == [
        ("beauty", 16, 8),
        ("Depth", 16, 8),
        ("Normals", 16, 8),
    ]
    nm, pixels = read_spectral("bands.exr")
    assert pixels.shape == (4, 4, 61) and nm[0] == 400.0
    depth = read_image("main.exr", part="Depth").pixels
    np.testing.assert_allclose(depth[:, 4:12], 10.0, rtol=1e-6)
    assert np.isinf(depth[:, :4]).all()


def test_json_output_is_objects_that_name_the_files(here, capfd):
    Path("shot.usda").write_text(stage_text(WHITE, quad("Card"), define("SphereLight", "Lamp")))
    arguments = ["--json", "render", "shot.usda", "out.exr", "-r", "8", "8", "--spectral"]
    assert cli.main(arguments) == 0
    printed = capfd.readouterr()
    events = [json.loads(line) for line in printed.out.splitlines()]
    wrote = [event["path"] for event in events if event["event"] == "wrote"]
    assert wrote == ["out.exr", "out.spectral.exr", "out.png"]
    assert {event["event"] for event in events} >= {"progress", "note", "seconds", "wrote"}
    (note,) = [event for event in events if event["event"] == "note"]
    assert (note["code"], note["path"]) == ("light-needs-traced", "/Lamp")
    assert printed.err == ""


@pytest.mark.parametrize("observer", ["cie1931_2", "cie1964_10", "cie2015_2"])
@pytest.mark.parametrize("white", ["FL2", "scene"])
def test_grey_in_a_lamps_light_is_grey_beside_the_lamps_white_to_any_observer(
    here, observer, white
):
    text = stage_text(WHITE, quad("Card", colored((0.2, 0.2, 0.2))))
    given = ["--illuminant", "FL2", "--white", white, "--observer", observer, "--ev", "0", "--png"]
    render(text, *given)
    card = read_image("shot.png").pixels[SIZE // 2, SIZE // 2, :3]
    assert np.ptp(255 * card) <= 1.01


def notes_of(capfd, text: str, *arguments: str) -> dict[str, str]:
    """Render, and return the codes and messages of what is noted."""
    Path("shot.usda").write_text(text)
    given = ["--json", "render", "shot.usda", "out.exr", "-r", "8", "8", "--no-png", *arguments]
    assert cli.main(given) == 0
    events = [json.loads(line) for line in capfd.readouterr().out.splitlines()]
    return {event["code"]: event["message"] for event in events if event["event"] == "note"}


@pytest.mark.parametrize(
    ("prims", "flags"),
    [((), ()), ((quad("Card"),), ("--mask", "/Sky")), ((quad("Card", z=20.0),), ())],
)
def test_a_picture_of_nothing_says_so(here, capfd, prims, flags):
    assert notes_of(capfd, stage_text(WHITE, quad("Card"))) == {}
    found = notes_of(capfd, stage_text(WHITE, *prims), *flags)
    assert "nothing" in found["nothing-seen"]


def test_spectra_left_of_an_earlier_render_are_noted(here, capfd):
    text = stage_text(WHITE, quad("Card"))
    assert notes_of(capfd, text, "--spectral") == {}
    assert "earlier render" in notes_of(capfd, text)["spectra-left"]
    assert Path("out.spectral.exr").is_file()


@pytest.mark.parametrize("name", ["st", "UVMap"])
def test_a_mesh_without_the_coordinates_of_its_texture_is_named(here, capfd, name):
    write_png(Path("map.png"), np.full((2, 2, 3), 99, np.uint8))
    texture = define(
        "Shader",
        "Texture",
        """uniform token info:id = "UsdUVTexture"
    asset inputs:file = @./map.png@
    float2 inputs:st.connect = </Cloth/Reader.outputs:result>
    color3f outputs:rgb""",
    )
    reader = define(
        "Shader",
        "Reader",
        f"""uniform token info:id = "UsdPrimvarReader_float2"
    string inputs:varname = "{name}"
    float2 outputs:result""",
    )
    color = "color3f inputs:diffuseColor.connect = </Cloth/Texture.outputs:rgb>"
    cloth = surface("Cloth", color, f"{texture}\n{reader}")
    found = notes_of(
        capfd, stage_text(WHITE, cloth, quad("Card", "rel material:binding = </Cloth>"))
    )
    if name == "st":
        assert found == {}
    else:
        assert "no primvars:UVMap" in found["texture-coordinates-missing"]
