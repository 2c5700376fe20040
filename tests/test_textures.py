"""Textures: UsdUVTexture's rules, the mip pyramid and the packed form."""

from __future__ import annotations

import math

import numpy as np
import OpenImageIO
import pytest

from usdskin import images
from usdskin.colorimetry import rgb_to_xyz
from usdskin.errors import ImageError, LayerError
from usdskin.render.textures import (
    WRAP_MODES,
    Texture,
    mip_pyramid,
    pack_textures,
    read_texture,
    sample_texture,
)

FLOAT32_ATOL = 1e-6
RNG_SEED = 3


def _png(path, pixels, sample_type="uint8"):
    pixels = np.asarray(pixels, np.uint8 if sample_type == "uint8" else np.uint16)
    height, width, count = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, count, sample_type)
    spec.attribute("oiio:UnassociatedAlpha", 1)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()
    return str(path)


def _exr(path, color_space="data", **channels):
    images.write_exr(path, [images.Part("", channels, {}, "float", color_space)])
    return str(path)


def _texture(pixels, wrap="clamp", **options) -> Texture:
    return Texture("t", mip_pyramid(np.asarray(pixels, np.float32)), wrap, wrap, **options)


def _rgba(height: int, width: int) -> np.ndarray:
    return np.random.default_rng(RNG_SEED).random((height, width, 4)).astype(np.float32)


# Colour


def test_8_bit_color_is_decoded_as_srgb_and_alpha_is_not(tmp_path):
    """sRGB 188 of 255 is 0.502886 linear (IEC 61966-2-1)."""
    path = _png(tmp_path / "a.png", [[[188, 0, 255, 188]]])
    expected = ((188 / 255 + 0.055) / 1.055) ** 2.4
    assert math.isclose(expected, 0.502886, abs_tol=1e-6)
    np.testing.assert_allclose(
        read_texture(path).levels[0], [[[expected, 0, 1, 188 / 255]]], atol=FLOAT32_ATOL
    )
    np.testing.assert_allclose(
        read_texture(path, "raw").levels[0], [[[188 / 255, 0, 1, 188 / 255]]], atol=FLOAT32_ATOL
    )


def test_color_below_a_low_alpha_is_not_premultiplied(tmp_path):
    path = _png(tmp_path / "a.png", [[[255, 255, 255, 3]]])
    np.testing.assert_allclose(
        read_texture(path).levels[0], [[[1, 1, 1, 3 / 255]]], atol=FLOAT32_ATOL
    )


def test_gray_8_bit_and_16_bit_pictures_are_raw_unless_told(tmp_path):
    gray = _png(tmp_path / "gray.png", [[[51]]])
    deep = _png(tmp_path / "deep.png", [[[13107, 13107, 13107]]], "uint16")
    for path in (gray, deep):
        np.testing.assert_allclose(
            read_texture(path).levels[0], [[[0.2, 0.2, 0.2, 1.0]]], atol=FLOAT32_ATOL
        )
        decoded = ((0.2 + 0.055) / 1.055) ** 2.4
        np.testing.assert_allclose(
            read_texture(path, "sRGB").levels[0][0, 0, :3], decoded, atol=FLOAT32_ATOL
        )


def test_float_pictures_are_linear_and_ap1_is_converted_when_the_file_says_so(tmp_path):
    color = np.full((1, 1, 3), (0.2, 0.5, 0.3), np.float32)
    path = _exr(tmp_path / "a.exr", "lin_ap1_scene", **{"": color})
    np.testing.assert_array_equal(read_texture(path).levels[0][..., :3], color)
    converted = read_texture(path, rendering_space="lin_rec709_scene").levels[0][0, 0, :3]
    np.testing.assert_allclose(
        rgb_to_xyz("lin_rec709_scene") @ converted,
        rgb_to_xyz("lin_ap1_scene") @ color[0, 0],
        atol=FLOAT32_ATOL,
    )
    raw = read_texture(path, "raw", rendering_space="lin_rec709_scene").levels[0]
    np.testing.assert_array_equal(raw[..., :3], color)


def test_scale_and_bias_act_on_linear_values(tmp_path):
    path = _png(tmp_path / "a.png", [[[188, 188, 188]]])
    linear = ((188 / 255 + 0.055) / 1.055) ** 2.4
    texture = read_texture(path, scale=(2, 2, 2, 0.5), bias=(-1, 0, 0.25, 0.5), wrap_s="black")
    np.testing.assert_allclose(
        texture.levels[0], [[[2 * linear - 1, 2 * linear, 2 * linear + 0.25, 1.0]]],
        atol=FLOAT32_ATOL,
    )  # fmt: skip
    np.testing.assert_allclose(sample_texture(texture, (1.7, 0.5)), (-1, 0, 0.25, 0.5))


# Channels


def test_gray_is_spread_and_alpha_is_one_where_there_is_none(tmp_path):
    plane = np.full((1, 1), 0.25, np.float32)
    path = _exr(tmp_path / "a.exr", Y=plane)
    np.testing.assert_array_equal(read_texture(path).levels[0], [[[0.25, 0.25, 0.25, 1]]])
    path = _exr(tmp_path / "b.exr", Y=plane, A=2 * plane)
    np.testing.assert_array_equal(read_texture(path).levels[0], [[[0.25, 0.25, 0.25, 0.5]]])


def test_layers_are_read_by_the_last_part_of_their_names(tmp_path):
    planes = {f"diffuse.{name}": np.full((1, 1), i, np.float32) for i, name in enumerate("ABGR")}
    path = _exr(tmp_path / "a.exr", **planes)
    np.testing.assert_array_equal(read_texture(path).levels[0], [[[3, 2, 1, 0]]])


def test_weights_are_read_channel_by_channel(tmp_path):
    planes = {f"c{index}": np.full((1, 1), index, np.float32) for index in range(6)}
    path = _exr(tmp_path / "a.exr", **planes)
    first = read_texture(path, "raw", channels=(0, 1, 2, 3)).levels[0]
    second = read_texture(path, "raw", channels=(4, 5)).levels[0]
    np.testing.assert_array_equal(first, [[[0, 1, 2, 3]]])
    np.testing.assert_array_equal(second, [[[4, 5, 0, 0]]])
    with pytest.raises(ImageError, match="has 6 channels"):
        read_texture(path, "raw", channels=(6,))


# Mip pyramid


@pytest.mark.parametrize("size", [(1, 1), (8, 8), (5, 3), (7, 16), (1, 9), (31, 33)])
def test_every_level_keeps_the_mean(size):
    pixels = _rgba(*size)
    levels = mip_pyramid(pixels)
    assert levels[-1].shape == (1, 1, 4)
    for level in levels:
        np.testing.assert_allclose(
            level.mean((0, 1), np.float64), pixels.mean((0, 1), np.float64), atol=1e-6
        )


def test_levels_halve_rounding_down():
    shapes = [level.shape[:2] for level in mip_pyramid(_rgba(13, 6))]
    assert shapes == [(13, 6), (6, 3), (3, 1), (1, 1)]


def test_odd_sizes_are_filtered_by_area():
    """Five pixels over two: each covers 2.5, so the middle one counts half in both."""
    pixels = np.array([0, 10, 20, 30, 40], np.float32).reshape(5, 1, 1)
    expected = [(0 + 10 + 0.5 * 20) / 2.5, (0.5 * 20 + 30 + 40) / 2.5]
    np.testing.assert_allclose(mip_pyramid(pixels)[1].ravel(), expected, rtol=1e-6)


def test_mips_are_averages_of_linear_color(tmp_path):
    """Black and white average to 0.5 in linear light, not to sRGB 128 = 0.216."""
    path = _png(tmp_path / "a.png", [[[0, 0, 0], [255, 255, 255]]])
    np.testing.assert_allclose(read_texture(path).levels[1], [[[0.5, 0.5, 0.5, 1]]])


# Wrap modes and lookup


def test_the_origin_of_st_is_the_bottom_left():
    pixels = np.zeros((2, 2, 4))
    pixels[1, 0] = 1.0  # the file's last row, first column
    texture = _texture(pixels)
    np.testing.assert_array_equal(sample_texture(texture, (0.25, 0.25)), np.ones(4))
    np.testing.assert_array_equal(sample_texture(texture, (0.25, 0.75)), np.zeros(4))


@pytest.mark.parametrize(
    ("mode", "expected"),
    [
        # Texels 1, 2, 3 at s = 1/6, 1/2, 5/6; lookups at texel centres -2, -1, 0 .. 4.
        ("repeat", [2, 3, 1, 2, 3, 1, 2]),
        ("clamp", [1, 1, 1, 2, 3, 3, 3]),
        ("mirror", [2, 1, 1, 2, 3, 3, 2]),
        ("black", [0, 0, 1, 2, 3, 0, 0]),
    ],
)
def test_wrap_modes(mode, expected):
    texture = _texture(np.array([1, 2, 3]).reshape(1, 3, 1) * np.ones(4), mode)
    s = (np.arange(-2, 5) + 0.5) / 3
    values = sample_texture(texture, np.stack([s, np.full(7, 0.5)], -1))[:, 0]
    np.testing.assert_allclose(values, expected, atol=1e-12)


def test_lookups_between_texels_are_bilinear():
    texture = _texture(np.array([[0.0, 1.0], [2.0, 3.0]])[..., None] * np.ones(4))
    # A quarter of a texel from the centre of the picture's upper left texel, towards the middle.
    st = (0.25 + 0.25 / 2, 0.75 - 0.25 / 2)
    np.testing.assert_allclose(sample_texture(texture, st), np.full(4, 0.25 * 1 + 0.25 * 2))


def test_a_file_may_say_how_it_wraps_and_black_is_the_rule(tmp_path):
    path = str(tmp_path / "a.exr")
    attributes = {"wrapmodes": "periodic,clamp"}
    images.write_exr(path, [images.Part("", {"Y": np.ones((1, 1))}, attributes)])
    texture = read_texture(path)
    assert (texture.wrap_s, texture.wrap_t) == ("repeat", "clamp")
    texture = read_texture(path, wrap_s="mirror")
    assert (texture.wrap_s, texture.wrap_t) == ("mirror", "clamp")
    texture = read_texture(_exr(tmp_path / "b.exr", Y=np.ones((1, 1))))
    assert (texture.wrap_s, texture.wrap_t) == ("black", "black")


# What cannot be read


def test_unknown_settings_are_refused(tmp_path):
    path = _png(tmp_path / "a.png", [[[1]]])
    with pytest.raises(LayerError, match="sourceColorSpace is 'srgb'; use auto, raw, sRGB"):
        read_texture(path, "srgb")
    with pytest.raises(LayerError, match="wrapT is 'tile'; use repeat, clamp, mirror, black"):
        read_texture(path, wrap_t="tile")


def test_missing_infinite_and_oversized_textures_are_refused(tmp_path):
    with pytest.raises(ImageError, match="no such file"):
        read_texture(str(tmp_path / "a.png"))
    plane = np.zeros((3, 4), np.float32)
    plane[1, 2] = np.nan
    plane[2, 0] = np.inf
    with pytest.raises(ImageError, match="2 pixels are not finite, the first in column 2, row 1"):
        read_texture(_exr(tmp_path / "b.exr", Y=plane))
    # 512 x 512 bytes become 512 x 512 x 16 x 4/3 bytes.
    path = _png(tmp_path / "c.png", np.zeros((512, 512, 1)))
    with pytest.raises(ImageError, match="as a texture it needs 5 MiB; the limit is 4 MiB"):
        read_texture(path, max_mb=4)


# Packing


def test_packed_textures_give_back_every_texel():
    textures = [
        _texture(_rgba(5, 3), "mirror"),
        _texture(_rgba(1, 1), "black", border=(1, 2, 3, 4)),
    ]
    packed = pack_textures(textures)
    assert packed.levels.shape == (2, 3, 3)
    assert packed.texels.shape == (5 * 3 + 2 * 1 + 1 + 1, 4)
    for index, texture in enumerate(textures):
        count, wrap_s, wrap_t = packed.info[index]
        assert count == len(texture.levels)
        assert (WRAP_MODES[wrap_s], WRAP_MODES[wrap_t]) == (texture.wrap_s, texture.wrap_t)
        np.testing.assert_array_equal(packed.borders[index], texture.border)
        for row, level in enumerate(texture.levels):
            offset, width, height = packed.levels[index, row]
            texels = packed.texels[offset : offset + width * height]
            np.testing.assert_array_equal(texels.reshape(height, width, 4), level)
        assert not packed.levels[index, count:].any()


def test_no_textures_pack_into_empty_arrays():
    packed = pack_textures([])
    assert packed.texels.shape == (0, 4)
    assert packed.levels.shape == (0, 1, 3)
    assert packed.info.shape == (0, 3)
    assert packed.texels.dtype == np.float32 and packed.levels.dtype == np.int32
