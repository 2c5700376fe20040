"""Normal maps, height maps, maps of the lustre: against closed forms, through the command."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from test_scene import (
    LOBES,
    SIZE,
    SPHERE,
    TEXTURE,
    WHITE,
    define,
    here,  # noqa: F401  (a fixture)
    quad,
    render,
    skin,
    stage_text,
    surface,
)

from usdskin import cli
from usdskin.image_output import Part, write_exr, write_png
from usdskin.images import read_image

pytestmark = pytest.mark.usefixtures("here")

CARD = "rel material:binding = </Card_>"
BALL = SPHERE.replace("Ball_", "Card_")
UNPACK = (
    "float4 inputs:scale = (2, 2, 2, 1)\n        float4 inputs:bias = (-1, -1, -1, 0)\n"
    '        token inputs:sourceColorSpace = "raw"'
)


def encoded(name: str, normals: np.ndarray) -> None:
    """Write a normal map as floats, (n + 1) / 2."""
    pixels = (0.5 * np.asarray(normals, np.float32) + 0.5).astype(np.float32)
    write_exr(Path(name), [Part("", {"": pixels}, color_space="data")])


def even(normal, size: int = 4) -> np.ndarray:
    return np.broadcast_to(np.asarray(normal, np.float32), (size, size, 3))


def heights(name: str, values: np.ndarray) -> None:
    """Write a height map as floats."""
    pixels = {"Y": np.ascontiguousarray(values, np.float32)}
    write_exr(Path(name), [Part("", pixels, color_space="data")])


def normals_of(*prims: str, arguments: tuple[str, ...] = (), metadata: str = "") -> np.ndarray:
    """Return the shading normals at the pixels' middles, NaN where nothing is seen."""
    render(stage_text(WHITE, *prims, metadata=metadata), "--aov", "N,primId", "-p", "1", *arguments)
    found = read_image("shot.exr", part="N").pixels
    seen = read_image("shot.exr", part="primId").pixels[..., 0] > 0
    return np.where(seen[..., None], found, np.nan)


def preview_map(file: str, body: str = "", settings: str = UNPACK, nodes: str = "") -> str:
    """Return a UsdPreviewSurface with a normal map."""
    texture = TEXTURE.format(file=file, material="Card_")
    texture = texture.replace("float3 outputs:rgb", f"{settings}\n        float3 outputs:rgb")
    inputs = f"normal3f inputs:normal.connect = </Card_/Picture.outputs:rgb>\n        {body}"
    return surface("Card_", inputs, texture + nodes)


def skin_map(body: str) -> str:
    return skin(body, name="Card_")


NORMAL_FILE = "asset inputs:skin:normal:file = @./n.exr@"
BUMP_FILE = "asset inputs:skin:bump:file = @./h.exr@"


# --- Normal maps


@pytest.mark.parametrize("kind", ["preview", "skin"])
def test_a_flat_normal_map_leaves_the_picture_as_it_is(kind):
    """Bit for bit; of several samples, those on one triangle without maps are shaded together."""
    encoded("n.exr", even((0, 0, 1)))
    gloss = "float inputs:skin:specular:weight = 0.5"
    if kind == "skin":
        with_map, without = skin_map(f"{gloss}\n{NORMAL_FILE}"), skin_map(gloss)
    else:
        with_map, without = preview_map("./n.exr"), surface("Card_", "")
    with_map, without = stage_text(LOBES, with_map, BALL), stage_text(LOBES, without, BALL)
    plain = render(without, "-p", "1")
    assert plain[..., 3].mean() > 0.5
    np.testing.assert_array_equal(render(with_map, "-p", "1"), plain)
    np.testing.assert_allclose(render(with_map), render(without), rtol=5e-4)


@pytest.mark.parametrize(
    ("mapped", "expected"),
    [
        ((0.6, 0.0, 0.8), (0.6, 0.0, 0.8)),  # R leans to +s, which is +x here
        ((0.0, 0.6, 0.8), (0.0, 0.6, 0.8)),  # G leans to +t, up: OpenGL's y
    ],
)
@pytest.mark.parametrize("kind", ["preview", "skin"])
def test_a_normal_map_leans_to_where_its_colors_say(kind, mapped, expected):
    encoded("n.exr", even(mapped))
    material = preview_map("./n.exr") if kind == "preview" else skin_map(NORMAL_FILE)
    found = normals_of(material, quad("Card", CARD))
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-6)


@pytest.mark.parametrize("angle", [5.0, 20.0])
def test_a_tilt_everywhere_shows_what_turned_normals_show(angle):
    """The diffuse picture of a card is that of a card whose authored normals are turned."""
    sine, cosine = np.sin(np.radians(angle)), np.cos(np.radians(angle))
    encoded("n.exr", even((sine, 0, cosine)))
    card = quad("Card", CARD)
    mapped = render(stage_text(LOBES, skin_map(NORMAL_FILE), card))
    authored = f"normal3f[] normals = [({sine}, 0, {cosine})] (interpolation = 'constant')"
    turned = render(stage_text(LOBES, skin_map(""), quad("Card", f"{CARD}\n    {authored}")))
    flat = render(stage_text(LOBES, skin_map(""), card))
    np.testing.assert_allclose(mapped, turned, rtol=1e-4)
    assert np.abs(mapped - flat).max() > 10.0 * np.abs(mapped - turned).max()


def test_on_a_sphere_the_tilt_follows_the_parallels():
    """N cos a + e_turn sin a, to 1e-3, where the reflected view stays above the surface."""
    angle = np.radians(15.0)
    encoded("n.exr", even((np.sin(angle), 0, np.cos(angle))))
    tilted = normals_of(skin_map(NORMAL_FILE), BALL, arguments=("-r", "64", "64"))
    normal = normals_of(skin_map(""), BALL, arguments=("-r", "64", "64"))
    # The sphere's axis is +Z, towards the camera.
    east = np.stack([-normal[..., 1], normal[..., 0], 0 * normal[..., 0]], -1)
    east /= np.linalg.norm(east, axis=-1, keepdims=True)
    expected = np.cos(angle) * normal + np.sin(angle) * east
    inside = (normal[..., 2] > 0.5) & (normal[..., 2] < 0.98)  # the pole has no parallels
    assert inside.sum() > 500
    np.testing.assert_allclose(tilted[inside], expected[inside], atol=2e-3)


@pytest.mark.parametrize("mirror", ["s", "t"])
def test_a_mirrored_island_shows_the_mirrored_relief(mirror):
    encoded("n.exr", even((0.36, 0.48, 0.8)))
    plain = "primvars:st = [(0, 0), (1, 0), (1, 1), (0, 1)]"
    other = {"s": "primvars:st = [(1, 0), (0, 0), (0, 1), (1, 1)]",
             "t": "primvars:st = [(0, 1), (1, 1), (1, 0), (0, 0)]"}[mirror]  # fmt: skip
    found = normals_of(skin_map(NORMAL_FILE), quad("Card", CARD).replace(plain, other))
    expected = (-0.36, 0.48, 0.8) if mirror == "s" else (0.36, -0.48, 0.8)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-6)


@pytest.mark.parametrize(
    "turn",
    ["double3 xformOp:scale = (-1, 1, 1)", "double3 xformOp:scale = (1, -1, 1)"],
)
def test_a_mirrored_mesh_mirrors_its_relief(turn):
    name = turn.split()[1]
    kind = f'{turn}\n    uniform token[] xformOpOrder = ["{name}"]'
    encoded("n.exr", even((0.36, 0.48, 0.8)))
    found = normals_of(skin_map(NORMAL_FILE), quad("Card", CARD, kind=kind))
    expected = (-0.36, 0.48, 0.8) if "(-1" in turn else (0.36, -0.48, 0.8)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-6)


def test_a_hill_is_a_pit_from_behind():
    """Turned by 180 degrees about y: the normal is minus that of the outside."""
    kind = 'double xformOp:rotateY = 180\n    uniform token[] xformOpOrder = ["xformOp:rotateY"]'
    encoded("n.exr", even((0.6, 0.0, 0.8)))
    found = normals_of(skin_map(NORMAL_FILE), quad("Card", CARD, kind=kind))
    # The outside's normal is (0.6, 0, 0.8) turned: (-0.6, 0, -0.8).
    np.testing.assert_allclose(found, np.broadcast_to((0.6, 0, 0.8), found.shape), atol=1e-6)


@pytest.mark.parametrize(
    ("scale", "rotation", "expected"),
    [((3, 3), 0, (0.6, 0, 0.8)), ((1, 1), 90, (0, -0.6, 0.8)), ((-1, 1), 0, (-0.6, 0, 0.8))],
)
def test_a_turned_picture_turns_its_relief(scale, rotation, expected):
    """With st turned by +90 degrees the picture lies turned by -90: its +x is the card's -y."""
    encoded("n.exr", even((0.6, 0, 0.8)))
    place = f"""
    def Shader "Place"
    {{
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </Card_/St.outputs:result>
        float2 inputs:scale = {scale}
        float inputs:rotation = {rotation}
        float2 outputs:result
    }}"""
    material = preview_map("./n.exr", nodes=place)
    material = material.replace("st.connect = </Card_/St.", "st.connect = </Card_/Place.")
    material = material.replace('"clamp"', '"repeat"')
    found = normals_of(material, quad("Card", CARD))
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-6)


@pytest.mark.parametrize("sign", ["w", "bitangents", "st"])
def test_authored_tangents_count(sign):
    """T = +y; B = -x where it is right-handed, +x where a sign says otherwise."""
    encoded("n.exr", even((0, 0.6, 0.8)))
    if sign == "w":
        authored = "float4[] primvars:tangents = [(0, 1, 0, -1)]"
    elif sign == "bitangents":
        authored = (
            "float3[] primvars:tangents = [(0, 1, 0)] (interpolation = 'constant')\n"
            "    float3[] primvars:bitangents = [(1, 0, 0)]"
        )
    else:
        authored = "float3[] primvars:tangents = [(0, 1, 0)]"
    body = f"{CARD}\n    {authored} (interpolation = 'constant')"
    found = normals_of(skin_map(NORMAL_FILE), quad("Card", body))
    expected = (-0.6, 0, 0.8) if sign == "st" else (0.6, 0, 0.8)
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-6)


def test_a_constant_normal_and_a_primvar_tilt_too():
    constant = surface("Card_", "normal3f inputs:normal = (0.6, 0, 0.8)")
    found = normals_of(constant, quad("Card", CARD))
    np.testing.assert_allclose(found, np.broadcast_to((0.6, 0, 0.8), found.shape), atol=1e-6)
    reader = """def Shader "Lean"
    {
        uniform token info:id = "UsdPrimvarReader_normal"
        string inputs:varname = "lean"
        normal3f outputs:result
    }"""
    read = surface("Card_", "normal3f inputs:normal.connect = </Card_/Lean.outputs:result>", reader)
    lean = f"{CARD}\n    normal3f[] primvars:lean = [(0, 0.6, 0.8)] (interpolation = 'constant')"
    found = normals_of(read, quad("Card", lean))
    np.testing.assert_allclose(found, np.broadcast_to((0, 0.6, 0.8), found.shape), atol=1e-6)


def test_the_previews_normal_map_counts_for_skin_that_has_none():
    encoded("n.exr", even((0.6, 0, 0.8)))
    encoded("m.exr", even((0, 0.6, 0.8)))
    plain = 'def Material "Card_" '
    applied = f'{plain}(prepend apiSchemas = ["SkinMaterialAPI"])'
    both = preview_map("./n.exr").replace(plain, applied, 1)
    found = normals_of(both, quad("Card", CARD))
    np.testing.assert_allclose(found, np.broadcast_to((0.6, 0, 0.8), found.shape), atol=1e-6)
    own = both.replace("\n{", "\n{\n    asset inputs:skin:normal:file = @./m.exr@", 1)
    found = normals_of(own, quad("Card", CARD))
    np.testing.assert_allclose(found, np.broadcast_to((0, 0.6, 0.8), found.shape), atol=1e-6)


def test_a_packed_normal_map_without_scale_and_bias_is_refused(capfd):
    write_png(Path("n.png"), np.full((4, 4, 3), (128, 128, 255), np.uint8))
    raw = 'token inputs:sourceColorSpace = "raw"'
    Path("shot.usda").write_text(
        stage_text(WHITE, preview_map("./n.png", settings=raw), quad("Card", CARD))
    )
    assert cli.main(["-q", "render", "shot.usda", "shot.exr", "-r", "8", "8"]) == 3
    (line,) = capfd.readouterr().err.splitlines()
    assert "n.png" in line and "uint8" in line and "inputs:bias = (-1, -1, -1, 0)" in line
    render(stage_text(WHITE, preview_map("./n.png"), quad("Card", CARD)))


def test_a_map_without_texture_coordinates_is_noted_and_not_shown(capfd):
    encoded("n.exr", even((0.6, 0, 0.8)))
    card = quad("Card", CARD).replace("primvars:st", "primvars:other")
    text = stage_text(WHITE, skin_map(f"{NORMAL_FILE}\n{BUMP_FILE}"), card)
    heights("h.exr", np.eye(4))
    Path("shot.usda").write_text(text)
    arguments = ["render", "shot.usda", "shot.exr", "-r", "8", "8", "--aov", "N", "--no-png"]
    assert cli.main(arguments) == 0
    assert "detail-without-st" in capfd.readouterr().err
    found = read_image("shot.exr", part="N").pixels
    np.testing.assert_allclose(found, np.broadcast_to((0, 0, 1), found.shape), atol=1e-6)


@pytest.mark.parametrize("tilt", [60.0, 120.0])
def test_normals_that_would_turn_away_are_bent_to_face_the_viewer(tilt):
    """Neither black nor negative nor NaN, and the reflected view stays above the surface."""
    angle = np.radians(tilt)
    encoded("n.exr", even((np.sin(angle), 0, np.cos(angle))))
    material = skin_map(f"{NORMAL_FILE}\n float inputs:skin:specular:weight = 1")
    found = normals_of(material, BALL)
    seen = np.isfinite(found).all(axis=-1)
    smooth = normals_of(skin_map(""), BALL)
    view = np.array([0.0, 0.0, 1.0])
    mirrored = 2.0 * found[..., 2:] * found - view
    above = np.einsum("...i,...i->...", mirrored, smooth)
    assert above[seen].min() > 0.0
    np.testing.assert_allclose(np.linalg.norm(found[seen], axis=-1), 1.0, atol=1e-5)
    picture = render(stage_text(WHITE, material, BALL))
    assert np.isfinite(picture).all()
    inside = picture[..., 3] == 1.0
    assert picture[inside][:, :3].min() > 0.3 * picture[inside][:, :3].max()


# --- Height maps


@pytest.mark.parametrize(("unit", "half"), [(1.0, 1.0), (0.01, 100.0)])
def test_a_sinusoid_of_height_has_the_normals_of_its_slope(unit, half):
    """h = A sin(2 pi m s): the slope is 2 pi m A / width cos, in metres in any stage's units."""
    waves, depth, columns = 2, 0.05, 512
    s = (np.arange(columns) + 0.5) / columns
    heights("h.exr", np.tile(np.sin(2.0 * np.pi * waves * s), (columns, 1)))
    material = skin_map(f"{BUMP_FILE}\n float inputs:skin:bump:depth = {depth}")
    card = quad("Card", CARD, box=(-half, -half, half, half))
    text = stage_text(WHITE, material, card)
    text = text.replace("metersPerUnit = 1", f"metersPerUnit = {unit}")
    text = text.replace("horizontalAperture = 20", f"horizontalAperture = {20 * half}")
    text = text.replace("verticalAperture = 20", f"verticalAperture = {20 * half}")
    render(text, "--aov", "N", "-p", "1", "-r", "128", "128")
    found = read_image("shot.exr", part="N").pixels
    at = (np.arange(128) + 0.5) / 128
    slope = 2.0 * np.pi * waves * depth / 2.0 * np.cos(2.0 * np.pi * waves * at)
    expected = np.stack([-slope, 0 * slope, np.ones(128)], 1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert np.abs(expected[:, 0]).max() > 0.29
    np.testing.assert_allclose(found, np.broadcast_to(expected, found.shape), atol=1e-3)


def test_height_on_a_sphere_is_in_metres_where_the_map_is_squeezed_too():
    """h = d sin(2 pi m s): the slope is 2 pi m d / (2 pi r cos(latitude)), wider at the equator."""
    waves, depth, columns = 3, 0.02, 1024
    s = (np.arange(columns) + 0.5) / columns
    heights("h.exr", np.tile(np.sin(2.0 * np.pi * waves * s), (4, 1)))
    material = skin_map(f"{BUMP_FILE}\n float inputs:skin:bump:depth = {depth}")
    size = ("-r", "96", "96")
    found = normals_of(material, BALL, arguments=size)
    normal = normals_of(skin_map(""), BALL, arguments=size)
    turn = np.arctan2(normal[..., 1], normal[..., 0])
    radius = np.hypot(normal[..., 0], normal[..., 1])
    slope = waves * depth * np.cos(waves * turn) / (0.9 * radius)
    east = np.stack([-np.sin(turn), np.cos(turn), 0 * turn], -1)
    expected = normal - slope[..., None] * east
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    inside = (normal[..., 2] > 0.4) & (normal[..., 2] < 0.95)
    assert inside.sum() > 2000
    assert np.abs(found - normal)[inside].max() > 0.1
    np.testing.assert_allclose(found[inside], expected[inside], atol=4e-3)


def test_a_height_map_acts_on_top_of_a_normal_map():
    """A ramp along t on a card that already leans along s."""
    encoded("n.exr", even((0.6, 0, 0.8)))
    heights("h.exr", np.tile(np.linspace(1.0, 0.0, 256)[:, None], (1, 4)))
    body = f"{NORMAL_FILE}\n {BUMP_FILE}\n float inputs:skin:bump:depth = 1"
    found = normals_of(skin_map(body), quad("Card", CARD))[SIZE // 2, SIZE // 2]
    slope = 0.5 * 256 / 255  # a rise of 1 m over the card's 2 m
    expected = np.array([0.6, -slope, 0.8]) / np.sqrt(1.0 + slope**2)
    np.testing.assert_allclose(found, expected, atol=1e-3)


def test_fine_relief_fades_with_the_distance():
    """Ridges far below a pixel leave the mean normal, and no aliasing."""
    s = np.arange(2048)
    heights("h.exr", np.tile((s // 2 % 2).astype(float), (8, 1)))
    material = skin_map(f"{BUMP_FILE}\n float inputs:skin:bump:depth = 0.01")
    found = normals_of(material, quad("Card", CARD))
    np.testing.assert_allclose(found, np.broadcast_to((0, 0, 1), found.shape), atol=1e-3)


ROUGH = (
    "float inputs:skin:specular:weight = 1\n float inputs:skin:specular:roughness1 = {0}\n"
    " float inputs:skin:specular:roughness2 = {0}\n"
)


@pytest.mark.parametrize("kind", ["normal", "bump"])
def test_relief_too_fine_to_be_seen_reflects_as_roughness_does(kind):
    """Slopes +-0.3 along both axes, by texel: alpha^2 grows by their variance, 0.18."""
    slope, half = 0.3, 1.0  # the card is 2 m wide
    sign = np.where(np.arange(512) // 2 % 2, 1.0, -1.0)
    along_s, along_t = np.meshgrid(slope * sign, slope * sign)
    if kind == "normal":
        normal = np.stack([-along_s, -along_t, np.ones_like(along_s)], -1)
        encoded("n.exr", normal / np.linalg.norm(normal, axis=-1, keepdims=True))
        body, variance = NORMAL_FILE, 2.0 * (np.sqrt(1.0 + 2.0 * slope**2) - 1.0)
    else:
        # Triangles of 4 texels: central differences are +-slope on one half of the texels and
        # 0 at the turns, which halves the variance.
        wave = np.array([0.0, 1.0, 2.0, 1.0]) * slope * 2.0 * half / 512
        row = np.tile(wave, 128)
        heights("h.exr", row[None, :] + row[:, None])
        body = f"{BUMP_FILE}\n float inputs:skin:bump:depth = 1"
        variance = slope**2
    fine = render(stage_text(LOBES, skin_map(ROUGH.format(0.3) + body), quad("Card", CARD)))
    rough = float((0.3**4 + variance) ** 0.25)
    expected = render(stage_text(LOBES, skin_map(ROUGH.format(rough)), quad("Card", CARD)))
    sharp = render(stage_text(LOBES, skin_map(ROUGH.format(0.3)), quad("Card", CARD)))
    inside = slice(4, -4)
    error = np.abs(fine - expected)[inside, inside].max()
    change = np.abs(sharp - expected)[inside, inside].max()
    assert change > 0.02 and error < 0.1 * change


# --- Maps of the lustre

GLOSS = "float inputs:skin:specular:weight = {}\n float inputs:skin:specular:roughness1 = {}\n"


@pytest.mark.parametrize(("weight", "first", "second"), [(0.7, 0.5, 0.3), (1.0, 0.4, 0.2)])
def test_maps_of_one_value_are_the_numbers_they_stand_for(weight, first, second):
    heights("w.exr", np.full((4, 4), weight))
    heights("r.exr", np.full((4, 4), first))
    numbers = GLOSS.format(weight, first) + f"float inputs:skin:specular:roughness2 = {second}"
    # The map stands in for roughness1, of which roughness2 keeps its share.
    maps = (
        GLOSS.format(0.1, 0.8)
        + f"float inputs:skin:specular:roughness2 = {0.8 * second / first}\n"
        + "asset inputs:skin:specular:weight:file = @./w.exr@\n"
        + "asset inputs:skin:specular:roughness:file = @./r.exr@"
    )
    plain = render(stage_text(LOBES, skin_map(numbers), BALL))
    dull = render(stage_text(LOBES, skin_map(""), BALL))
    found = render(stage_text(LOBES, skin_map(maps), BALL))
    np.testing.assert_allclose(found, plain, atol=2e-3 * plain.max())
    assert np.abs(plain - dull).max() > 0.02 * plain.max()


def test_a_map_of_the_weight_turns_the_lustre_on_where_it_is():
    values = np.zeros((8, 8))
    values[:, 4:] = 1.0
    heights("w.exr", values)
    material = skin_map("asset inputs:skin:specular:weight:file = @./w.exr@")
    card = quad("Card", CARD)
    found = render(stage_text(LOBES, material, card))
    dull = render(stage_text(LOBES, skin_map(""), card))
    full = render(stage_text(LOBES, skin_map("float inputs:skin:specular:weight = 1"), card))
    for half, expected in ((slice(4, SIZE // 2 - 4), dull), (slice(SIZE // 2 + 4, -4), full)):
        np.testing.assert_allclose(found[:, half], expected[:, half], rtol=1e-5)
    assert np.abs(full - dull).max() > 1e-3


def test_a_roughness_map_runs_between_its_values():
    """A mirror to the left, matt to the right: each half as a material of its own."""
    values = np.full((8, 8), 0.1)
    values[:, 4:] = 0.7
    heights("r.exr", values)
    body = GLOSS.format(1, 0.5) + "float inputs:skin:specular:roughness2 = 0.5\n"
    found = render(
        stage_text(
            LOBES,
            skin_map(body + "asset inputs:skin:specular:roughness:file = @./r.exr@"),
            quad("Card", CARD),
        )
    )
    for value, columns in ((0.1, slice(4, SIZE // 2 - 4)), (0.7, slice(SIZE // 2 + 4, -4))):
        number = GLOSS.format(1, value) + f"float inputs:skin:specular:roughness2 = {value}"
        expected = render(stage_text(LOBES, skin_map(number), quad("Card", CARD)))
        atol = 5e-3 * expected.max()
        np.testing.assert_allclose(found[:, columns], expected[:, columns], atol=atol)


def test_detail_is_defined_for_meshes_and_shapes_alike():
    """A cube's side has a frame of its own, as a quad has."""
    encoded("n.exr", even((0.6, 0, 0.8)))
    cube = define("Cube", "Box", f"double size = 1.5\n    {CARD}", "MaterialBindingAPI")
    found = normals_of(skin_map(NORMAL_FILE), cube)
    middle = found[SIZE // 2, SIZE // 2]
    np.testing.assert_allclose(middle, (0.6, 0, 0.8), atol=1e-5)


@pytest.mark.parametrize(
    ("body", "primvar", "said"),
    [
        ("asset inputs:skin:bump:file = @./broken.exr@", "", "broken.exr"),
        ("asset inputs:skin:normal:file = @./gone.exr@", "", "gone.exr"),
        ("asset inputs:skin:displacement:file = @./nan.exr@", "", "nan.exr: 1 pixels"),
        ("asset inputs:skin:displacement:file = @./one.exr@\n"
         "float inputs:skin:displacement:scale = 1e38", "", "lower it"),
        (NORMAL_FILE, "float2[] primvars:tangents = [(1, 0)] (interpolation = 'constant')",
         "rows of 2 numbers"),
    ],
)  # fmt: skip
def test_maps_that_cannot_be_used_are_refused_in_one_line(body, primvar, said, capfd):
    encoded("n.exr", even((0.6, 0, 0.8)))
    encoded("t.1001.exr", even((0.6, 0, 0.8)))
    Path("broken.exr").write_bytes(b"no picture")
    values = np.full((4, 4), 40.0)
    heights("one.exr", values)
    values[1, 2] = np.nan
    heights("nan.exr", values)
    card = quad("Card", f"{CARD}\n    {primvar}")
    Path("shot.usda").write_text(stage_text(WHITE, skin_map(body), card))
    assert cli.main(["-q", "render", "shot.usda", "shot.exr", "-r", "8", "8"]) == 3
    (line,) = capfd.readouterr().err.splitlines()
    assert line.startswith("usdskin: error: ") and said in line
