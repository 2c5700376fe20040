"""Tiled textures: which tile is read where, at its edges, and where there is none."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import warp as wp
from kernel_probes import probe_texture
from scenes import codes, read_stage
from test_scene import (
    DARK,
    SPECTRAL_WHITE,
    TEXTURE,
    assert_colors,
    quad,
    render,
    skin,
    stage_text,
    surface,
)
from test_scene import here as here

from usdskin import cli
from usdskin.errors import DeviceError, LayerError
from usdskin.image_output import write_png
from usdskin.images import read_image
from usdskin.render import udim
from usdskin.render.textures import Texture, mip_pyramid, sample_texture
from usdskin.render.udim import TiledTexture, pack_tiles, tile_files
from usdskin.warp_kernels import structs

RED, GREEN, BLUE = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def on_device(textures, device) -> structs.Materials:
    tiles = pack_tiles(textures)
    packed = tiles.textures
    materials = structs.Materials()
    materials.texel = wp.array(packed.texels, dtype=wp.vec4f, device=device)
    materials.texture_level = wp.array(packed.levels, dtype=wp.vec3i, device=device)
    materials.texture_info = wp.array(packed.info, dtype=wp.vec3i, device=device)
    materials.texture_border = wp.array(packed.borders, dtype=wp.vec4f, device=device)
    materials.texture_tile = wp.array(tiles.table, dtype=wp.int32, device=device)
    return materials


def look_up(textures, index, st, device, width=0.0) -> np.ndarray:
    at = np.zeros((len(st), 3), np.float32)
    at[:, :2], at[:, 2] = st, width
    out = wp.zeros(len(st), dtype=wp.vec4f, device=device)
    materials = on_device(textures, device)
    inputs = [materials, index, wp.array(at, dtype=wp.vec3f, device=device)]
    wp.launch(probe_texture, len(st), inputs=inputs, outputs=[out], device=device)
    return out.numpy()


def picture(pixels) -> Texture:
    return Texture("t", mip_pyramid(np.asarray(pixels, np.float32)), "clamp", "clamp")


def flat(value, size=4) -> Texture:
    return picture(np.full((size, size, 4), value, np.float32))


def test_tiles_of_a_picture_are_the_picture(device):
    """Four tiles cut from one picture: 1001 is its bottom left, and no seam shows between them."""
    rng = np.random.default_rng(3)
    whole = rng.random((32, 32, 4)).astype(np.float32)
    cut = {(u, v): picture(whole[16 - 16 * v : 32 - 16 * v, 16 * u : 16 * u + 16])
           for u in (0, 1) for v in (0, 1)}  # fmt: skip
    textures = [flat(0.0), TiledTexture("a.<UDIM>.png", cut), picture(whole)]
    st = rng.uniform(0.0, 2.0, (500, 2)).astype(np.float32)
    st[:100, 0] = 1.0 + rng.uniform(-0.03, 0.03, 100)
    st[50:150, 1] = 1.0 + rng.uniform(-0.03, 0.03, 100)
    found = look_up(textures, 1, st, device)
    np.testing.assert_allclose(found, sample_texture(textures[2], st / 2.0), atol=2e-5)
    # At a footprint of two texels too, where each tile's next level is read.
    found = look_up(textures, 1, st, device, width=2.0 / 16.0)
    expected = sample_texture(textures[2], st / 2.0, level=1)
    np.testing.assert_allclose(found, expected, atol=2e-5)


def test_the_edge_stays_where_the_next_tile_is_missing_or_smaller(device):
    ramp = np.linspace(0.0, 1.0, 8, dtype=np.float32)
    left = picture(np.broadcast_to(ramp[None, :, None], (8, 8, 4)))
    st = [[0.999, 0.5], [1.001, 0.5]]
    alone = look_up([TiledTexture("t", {(0, 0): left})], 0, st[:1], device)
    np.testing.assert_allclose(alone, 1.0, atol=1e-6)
    pair = TiledTexture("t", {(0, 0): left, (1, 0): flat(3.0, size=2)})
    found = look_up([pair], 0, st, device)
    np.testing.assert_allclose(found, 2.0, atol=0.02)  # half the edge, half the next tile


def test_squares_without_a_tile_show_the_fallback(device):
    tiles = TiledTexture("t", {(0, 0): flat(1.0), (2, 1): flat(2.0)}, (0.1, 0.2, 0.3, 0.4))
    there = [[0.5, 0.5], [2.5, 1.5], [1.0, 0.5], [3.0, 2.0]]
    missing = [[1.5, 0.5], [-0.5, 0.5], [0.5, -0.5], [0.5, 9.5], [10.5, 0.5], [11.5, 0.2]]
    found = look_up([tiles], 0, there + missing, device)
    np.testing.assert_allclose(found[:4, 0], [1.0, 2.0, 1.0, 2.0])
    np.testing.assert_allclose(found[4:], [(0.1, 0.2, 0.3, 0.4)] * len(missing), atol=1e-7)


def test_tiles_are_found_by_their_numbers(tmp_path):
    for number in (1001, 1010, 1011, 1025):
        (tmp_path / f"a.{number}.png").touch()
    (tmp_path / "a.1001.bak").touch()
    found = tile_files(str(tmp_path / "a.<UDIM>.png"))
    assert {place: Path(file).name for place, file in found.items()} == {
        (0, 0): "a.1001.png",
        (9, 0): "a.1010.png",
        (0, 1): "a.1011.png",
        (4, 2): "a.1025.png",
    }


def test_no_tile_at_all_is_refused(tmp_path):
    with pytest.raises(LayerError, match=r"b\.<UDIM>\.png: has no tile, such as 1001"):
        tile_files(str(tmp_path / "b.<UDIM>.png"))


def test_tiles_larger_than_memory_are_refused_before_they_are_packed(monkeypatch):
    monkeypatch.setattr(udim, "available_bytes", lambda: 100)
    with pytest.raises(DeviceError, match="texels need"):
        pack_tiles([TiledTexture("t", {(0, 0): flat(1.0)})])


# In a picture


def write_tiles(*colors, name="tile") -> None:
    for number, color in colors:
        pixels = np.full((4, 4, 3), np.round(255.0 * np.array(color)), np.uint8)
        write_png(Path(f"{name}.{number}.png"), pixels)


def painted(fallback: str = "") -> tuple[str, str]:
    """Return a quad over tiles 1001, 1002, 1011 and 1012, and its material."""
    nodes = TEXTURE.format(file="tile.<UDIM>.png", material="Paint").replace(
        "float3 outputs:rgb", f"float3 outputs:rgb\n{fallback}"
    )
    body = "color3f inputs:emissiveColor.connect = </Paint/Picture.outputs:rgb>"
    base = "float inputs:roughness = 1\n color3f inputs:diffuseColor = (0, 0, 0)"
    board = quad("Board", "rel material:binding = </Paint>").replace(
        "[(0, 0), (1, 0), (1, 1), (0, 1)]", "[(0, 0), (2, 0), (2, 2), (0, 2)]"
    )
    return surface("Paint", f"{body}\n{base}", nodes), board


def test_each_square_of_a_board_shows_its_tile(here):
    write_tiles((1001, RED), (1002, GREEN), (1011, BLUE), (1012, (1, 1, 1)))
    shown = render(stage_text(DARK, *painted()))
    assert_colors(
        shown,
        {"bottom left": RED, "bottom right": GREEN, "top left": BLUE, "top right": (1, 1, 1)},
    )


def test_a_missing_tile_is_noted_and_shows_the_fallback(here, capfd):
    write_tiles((1001, RED), (1011, BLUE))
    parts = painted("float4 inputs:fallback = (0.5, 0.25, 0, 1)")
    shown = render(stage_text(DARK, *parts))
    assert_colors(shown, {"bottom left": RED, "bottom right": (0.5, 0.25, 0.0)})
    _, notes = read_stage(Path("shot.usda"))
    (note,) = [note for note in notes if note.code == "udim-tile-missing"]
    assert note.path == "/Paint"
    assert "2 tiles that meshes show are missing" in note.message


def test_a_board_within_its_tiles_gives_no_note(here):
    write_tiles((1001, RED), (1002, GREEN), (1011, BLUE), (1012, (1, 1, 1)))
    Path("shot.usda").write_text(stage_text(DARK, *painted()))
    assert codes(read_stage(Path("shot.usda"))[1]) == []


def test_one_large_face_shows_every_tile_under_it(here):
    """Two triangles over 10 x 2 squares, of which the middle one of the first row is missing."""
    write_tiles(*((1001 + u + 10 * v, RED) for u in range(10) for v in (0, 1) if (u, v) != (5, 0)))
    material, board = painted()
    wide = board.replace("[(0, 0), (2, 0), (2, 2), (0, 2)]", "[(0, 0), (10, 0), (10, 2), (0, 2)]")
    Path("shot.usda").write_text(stage_text(DARK, material, wide))
    (note,) = read_stage(Path("shot.usda"))[1]
    assert "1 tiles that meshes show are missing, such as 1006 on </Board>" in note.message


def test_a_pattern_without_tiles_is_one_line(here, capfd):
    Path("shot.usda").write_text(stage_text(DARK, *painted()))
    assert cli.main(["-q", "render", "shot.usda", "o.exr", "--no-png"]) == 3
    (line,) = capfd.readouterr().err.splitlines()
    assert "</Paint/Picture>: inputs:file names @tile.<UDIM>.png@, which is not there" in line


def test_albedo_of_skin_may_be_tiled(here):
    """The skin of one tile is that of its picture alone, but for the seam on the left."""
    write_tiles((1001, (0.8, 0.5, 0.4)), (1002, (0.2, 0.4, 0.6)))
    Path("one.png").write_bytes(Path("tile.1002.png").read_bytes())
    board = quad("Board", "rel material:binding = </Skin>")
    beside = board.replace("[(0, 0), (1, 0), (1, 1), (0, 1)]", "[(1, 0), (2, 0), (2, 1), (1, 1)]")
    tiled = stage_text(
        SPECTRAL_WHITE, beside, skin("asset inputs:skin:albedo:file = @./tile.<UDIM>.png@")
    )
    single = stage_text(SPECTRAL_WHITE, board, skin("asset inputs:skin:albedo:file = @./one.png@"))
    np.testing.assert_allclose(
        render(tiled, name="tiled")[:, 5:], render(single, name="one")[:, 5:], atol=1e-5
    )


def test_tiles_in_a_package_are_read(here):
    from pxr import Sdf, UsdUtils

    write_tiles((1001, RED), (1002, GREEN), (1011, BLUE), (1012, (1, 1, 1)))
    loose = render(stage_text(DARK, *painted()), name="loose")
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath("loose.usda"), "shot.usdz")
    given = ["-r", "32", "32", "-p", "4", "--no-png", "--filter", "box"]
    assert cli.main(["-q", "render", "shot.usdz", "packed.exr", *given]) == 0
    np.testing.assert_array_equal(read_image("packed.exr").pixels, loose)
