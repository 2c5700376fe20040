"""The PNG beside a picture: white, exposure, view, alpha and what it says of itself."""

from __future__ import annotations

import math

import numpy as np
import pytest

from usdskin import images
from usdskin.colorimetry import cat16, encode_srgb, illuminant, rgb_to_xyz, white_xyz, xyz_to_rgb
from usdskin.colorimetry import color_matching_functions as cmfs
from usdskin.errors import ImageError, UsageError
from usdskin.render import preview
from usdskin.render.preview import (
    AUTO_LEVEL,
    VIEWS,
    auto_ev,
    check_display,
    develop,
    render_png,
)

GRID_NM = np.arange(360.0, 831.0, 5.0)
RNG_SEED = 11


def _opaque(rgb) -> np.ndarray:
    rgb = np.atleast_3d(np.asarray(rgb, np.float32))
    rgb = rgb.reshape(-1, 1, 3)
    return np.concatenate([rgb, np.ones((*rgb.shape[:2], 1), np.float32)], 2)


def _white_of(name: str) -> np.ndarray:
    xyz = illuminant(name, GRID_NM) @ cmfs(GRID_NM)
    return xyz / xyz[1]


# Views


def test_the_default_view_is_the_srgb_curve_of_the_standard():
    """OpenColorIO against IEC 61966-2-1, to half a code value."""
    rgb = np.linspace(0.0, 1.0, 301, dtype=np.float32).repeat(3).reshape(-1, 1, 3)
    values, record = develop(_opaque(rgb), ev=0.0, white="none")
    assert np.abs(values - 255.0 * encode_srgb(rgb.astype(np.float64))).max() <= 0.51
    assert record["usdskin/ocioView"] == "Un-tone-mapped"


def test_gray_through_the_aces_views_is_as_published():
    """18 % gray: 0.3560 (ACES 1) and 0.3492 (ACES 2), as measured with OpenColorIO 2.6."""
    gray = _opaque([[0.18, 0.18, 0.18]])
    for view, expected in (
        ("ACES 1.0 - SDR Video", 0.3560),
        ("ACES 2.0 - SDR 100 nits (Rec.709)", 0.3492),
        ("Raw", 0.18),
        ("Un-tone-mapped", 0.4614),
    ):
        values, record = develop(gray, ev=0.0, white="none", view=view)
        np.testing.assert_array_equal(values, round(255 * expected))
        assert record["usdskin/ocioConfig"] == VIEWS[view]


def test_the_environment_does_not_change_the_picture(monkeypatch):
    gray = _opaque([[0.3, 0.2, 0.1]])
    before = develop(gray, ev=0.0, white="none")[0]
    monkeypatch.setenv("OCIO", "/nowhere/config.ocio")
    np.testing.assert_array_equal(develop(gray, ev=0.0, white="none")[0], before)


def test_unknown_views_and_whites_are_refused_with_a_choice():
    with pytest.raises(UsageError, match=r"--view 'Filmic'.* use 'Un-tone-mapped'"):
        develop(_opaque([[1, 1, 1]]), view="Filmic")
    with pytest.raises(UsageError, match=r"--white Q.*or use none or scene"):
        develop(_opaque([[1, 1, 1]]), white="Q")


def test_white_and_view_can_be_checked_before_a_render():
    for white in ("scene", "none", "FL2", "3200K"):
        check_display(white)
    with pytest.raises(UsageError, match="--view"):
        check_display("scene", "Filmic")
    with pytest.raises(UsageError, match="--white"):
        check_display("Q")


# Colour and white


@pytest.mark.parametrize(
    "color_space", ["lin_ap1_scene", "lin_rec2020_scene", "lin_ciexyzd65_scene"]
)
def test_one_color_looks_the_same_from_every_rendering_space(color_space):
    rgb = np.array([0.5, 0.3, 0.2])
    same = xyz_to_rgb(color_space) @ rgb_to_xyz("lin_rec709_scene") @ rgb
    expected = develop(_opaque([rgb]), ev=0.0, white="none")[0]
    values, _ = develop(_opaque([same]), color_space=color_space, ev=0.0, white="none")
    np.testing.assert_allclose(values.astype(int), expected, atol=1)


@pytest.mark.parametrize("name", ["A", "FL2", "FL11", "LED-B3", "D50"])
def test_a_white_diffuser_under_any_lamp_becomes_neutral(name):
    diffuser = xyz_to_rgb("lin_rec709_scene") @ (0.5 * _white_of(name))
    pictures = {
        "scene": develop(
            _opaque([diffuser]), ev=0.0, white="scene", scene_white_xyz=7.0 * _white_of(name)
        )[0],
        "named": develop(_opaque([diffuser]), ev=0.0, white=name)[0],
    }
    for values in pictures.values():
        np.testing.assert_array_equal(values, round(255 * float(encode_srgb(np.float64(0.5)))))


def test_adaptation_is_cat16():
    color = np.array([0.3, 0.25, 0.1])
    adapted = cat16(_white_of("A"), white_xyz("lin_rec709_scene")) @ color
    expected = encode_srgb(xyz_to_rgb("lin_rec709_scene") @ adapted)
    values, record = develop(_opaque([color]), color_space="lin_ciexyzd65_scene", ev=0.0, white="A")
    np.testing.assert_allclose(values.ravel(), 255 * expected, atol=0.51)
    assert record["usdskin/white"] == "A"


def test_d65_is_no_adaptation():
    """The tables' D65 and the sRGB white differ in the fifth digit only."""
    rgba = _opaque(np.random.default_rng(RNG_SEED).random((50, 3)))
    none = develop(rgba, ev=0.0, white="none")[0].astype(int)
    np.testing.assert_allclose(develop(rgba, ev=0.0, white="D65")[0], none, atol=1)


@pytest.mark.parametrize("white", [None, (0.0, 0.0, 0.0), (0.0, 0.0, 1.0), (math.nan, 1.0, 1.0)])
def test_a_scene_without_a_usable_white_is_not_adapted_and_says_so(white):
    notes: list = []
    rgba = _opaque([[0.5, 0.3, 0.2]])
    values, record = develop(rgba, ev=0.0, scene_white_xyz=white, notes=notes)
    np.testing.assert_array_equal(values, develop(rgba, ev=0.0, white="none")[0])
    assert record["usdskin/white"].startswith("none (")
    assert [note.code for note in notes] == ["white-not-adapted"]


# Exposure


def test_one_stop_doubles():
    dark = develop(_opaque([[0.2, 0.1, 0.05]]), ev=1.0, white="none")[0]
    bright = develop(_opaque([[0.4, 0.2, 0.1]]), ev=0.0, white="none")[0]
    np.testing.assert_array_equal(dark, bright)


@pytest.mark.parametrize("level", [1e-6, 0.5, 1e5])
def test_auto_exposure_puts_an_even_picture_just_below_white(level):
    linear = np.full((20, 30, 3), level, np.float32)
    ev = auto_ev(linear, np.ones((20, 30), np.float32))
    assert math.isclose(level * 2.0**ev, AUTO_LEVEL, rel_tol=1e-3)


def test_auto_exposure_ignores_glints_the_surround_and_what_is_not_finite():
    linear = np.full((100, 100, 3), 0.2, np.float32)
    alpha = np.ones((100, 100), np.float32)
    expected = auto_ev(linear, alpha)
    linear[0, :50] = 1e4  # half a per cent of glints
    assert auto_ev(linear, alpha) == expected
    linear[50:] = 5.0  # hidden
    alpha[50:] = 0.0
    linear[1, :30] = np.nan
    linear[2, :9] = np.inf
    # 50 glints among 4961 pixels that count are above the quantile: one per cent of them less 0.4.
    linear[0, 40:] = 0.2
    assert auto_ev(linear, alpha) == expected


def test_auto_exposure_counts_pixels_by_their_alpha():
    linear = np.ones((1, 4, 3), np.float32)
    linear[0, 0] = 8.0
    full = np.ones((1, 4), np.float32)
    thin = np.array([[0.01, 1, 1, 1]], np.float32)
    assert math.isclose(auto_ev(linear, full), math.log2(AUTO_LEVEL / 8), abs_tol=1e-3)
    assert math.isclose(auto_ev(linear, thin), math.log2(AUTO_LEVEL), abs_tol=1e-3)


def test_auto_exposure_keeps_a_saturated_color_from_clipping():
    linear = np.full((10, 10, 3), (0.8, 0.1, 0.1), np.float32)
    ev = auto_ev(linear, np.ones((10, 10), np.float32))
    assert math.isclose(0.8 * 2**ev, AUTO_LEVEL, rel_tol=1e-3)


def test_a_black_or_empty_picture_is_not_exposed():
    rgba = np.zeros((4, 5, 4), np.float32)
    values, record = develop(rgba, white="none")
    assert record["usdskin/ev"] == "0.0"
    assert not values.any()
    rgba[..., 3] = 1.0
    assert develop(rgba, white="none")[1]["usdskin/ev"] == "0.0"


# Pixels


def test_nan_is_black_and_infinity_is_white():
    rgba = _opaque([[np.nan, 0.2, 0.2], [np.inf, np.inf, np.inf], [-np.inf, 0, 0]])
    values, _ = develop(rgba, ev=0.0, white="none")
    assert values[1].min() == 255
    assert values[0].max() <= 124 and values[2].max() == 0


def test_alpha_is_written_when_it_tells_something_and_color_is_not_premultiplied(tmp_path):
    rgba = np.zeros((2, 2, 4), np.float32)
    rgba[0] = (0.18, 0.18, 0.18, 1.0)
    rgba[1, 0] = (0.09, 0.09, 0.09, 0.5)
    path = tmp_path / "a.png"
    render_png(path, rgba, ev=0.0, white="none")
    read = np.rint(255 * images.read_image(path).pixels).astype(int)
    assert read.shape == (2, 2, 4)
    np.testing.assert_array_equal(read[1, 0], [118, 118, 118, 128])
    np.testing.assert_array_equal(read[0, 0], [118, 118, 118, 255])
    np.testing.assert_array_equal(read[1, 1], [0, 0, 0, 0])

    render_png(path, _opaque([[0.18, 0.18, 0.18]]), ev=0.0, white="none")
    assert images.read_image(path).channel_names == ("R", "G", "B")


def test_the_png_says_how_it_was_made(tmp_path):
    path = tmp_path / "a.png"
    ev = render_png(
        path, _opaque([[0.45, 0.2, 0.1]]), scene_white_xyz=(2.0, 2.0, 2.0),
        metadata={"usdskin/stage": "shot.usda", "usdskin/frame": 3},
    )  # fmt: skip
    attributes = images.read_image(path).attributes
    said = {name: value for name, value in attributes.items() if name.startswith("usdskin/")}
    assert float(said["usdskin/ev"]) == ev
    assert said == {
        "usdskin/ev": repr(ev),
        "usdskin/evMode": "auto",
        "usdskin/white": "scene (1, 1, 1)",
        "usdskin/ocioConfig": "cg-config-v2.2.0_aces-v1.3_ocio-v2.4",
        "usdskin/ocioDisplay": "sRGB - Display",
        "usdskin/ocioView": "Un-tone-mapped",
        "usdskin/colorSpace": "lin_rec709_scene",
        "usdskin/stage": "shot.usda",
        "usdskin/frame": "3",
    }


def test_the_same_picture_gives_the_same_bytes(tmp_path):
    rgba = np.random.default_rng(RNG_SEED).random((40, 30, 4)).astype(np.float32)
    before = rgba.copy()
    for name in ("a.png", "b.png"):
        render_png(tmp_path / name, rgba, white="A")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    np.testing.assert_array_equal(rgba, before)


def test_an_unwritable_png_is_named(tmp_path):
    (tmp_path / "file").touch()
    with pytest.raises(ImageError, match=r"file/a\.png: cannot write"):
        render_png(tmp_path / "file" / "a.png", _opaque([[1, 1, 1]]))


def test_every_view_is_pinned_to_a_config_that_has_it():
    for view in preview.VIEWS:
        assert develop(_opaque([[0.2, 0.2, 0.2]]), ev=0.0, view=view)[0].shape == (1, 1, 3)
