"""Frame ranges and frame numbers in file names."""

from __future__ import annotations

from pathlib import Path

import pytest

from usdskin.errors import UsageError
from usdskin.frames import frame_path, has_placeholder, parse_frames, with_placeholder


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("12", [12]),
        ("1-4", [1, 2, 3, 4]),
        ("1:4", [1, 2, 3, 4]),
        ("1-9:4", [1, 5, 9]),
        ("1:9x4", [1, 5, 9]),
        ("1-10:4", [1, 5, 9]),
        ("1,5,9", [1, 5, 9]),
        ("13-19:3, 30", [13, 16, 19, 30]),
        ("-5-10:5", [-5, 0, 5, 10]),
        ("-5--3", [-5, -4, -3]),
        ("5-3", [5, 4, 3]),
        ("5-1:-2", [5, 3, 1]),
        ("1-2:0.25", [1, 1.25, 1.5, 1.75, 2]),
        ("-.5-.5:.5", [-0.5, 0, 0.5]),
        ("7-7", [7]),
        ("5:1x-2", [5, 3, 1]),
        ("-10:-4x3", [-10, -7, -4]),
        ("1:2x0.5", [1, 1.5, 2]),
        ("2.5:0.5", [2.5, 1.5, 0.5]),
    ],
)
def test_range_names_its_frames(text, frames):
    assert list(parse_frames(text)) == frames


def test_step_of_a_tenth_does_not_drift():
    assert parse_frames("1-101:0.1")[-1] == 101.0


def test_frame_named_twice_is_rendered_once_and_order_is_kept():
    assert parse_frames("3,1-4") == (3, 1, 2, 4)


@pytest.mark.parametrize(
    "text", ["", "a", "1-", "1,,2", "1-5:0", "1-5:-1", "5-1:1", "1..3", "nan", "1e3", "1-9999999"]
)
def test_what_is_no_range_is_a_usage_error_that_shows_it(text):
    with pytest.raises(UsageError) as caught:
        parse_frames(text)
    assert repr(text) in str(caught.value)


@pytest.mark.parametrize(
    ("template", "frame", "name"),
    [
        ("out.####.exr", 7, "out.0007.exr"),
        ("out.####.exr", 12345, "out.12345.exr"),
        ("out.####.exr", -5, "out.-005.exr"),
        ("out.####.exr", -0.0, "out.0000.exr"),
        ("out.###.###.exr", 1.5, "out.001.500.exr"),
        ("out_##.spectral.exr", 3, "out_03.spectral.exr"),
        ("out.exr", 3, "out.exr"),
        ("take#2.exr", 3, "take#2.exr"),
        ("a/####/out.####.exr", 3, "a/####/out.0003.exr"),
    ],
)
def test_placeholder_becomes_the_padded_frame(template, frame, name):
    assert frame_path(template, frame) == Path(name)


@pytest.mark.parametrize(
    ("name", "hint"),
    [
        ("x.exr", "x.####.exr"),
        ("x.%04d.exr", "x.####.exr"),
        ("x.%d.exr", "x.####.exr"),
        ("x_%6d.exr", "x_######.exr"),
        ("x.$F4.exr", "x.####.exr"),
        ("x.$F.exr", "x.####.exr"),
        ("x.v2.exr", "x.v2.####.exr"),
    ],
)
def test_a_hint_has_the_place_where_the_name_meant_it(name, hint):
    assert with_placeholder(Path("folder", name)) == hint
    assert has_placeholder(hint)


def test_only_two_signs_or_more_in_the_file_name_are_a_placeholder():
    assert has_placeholder("out.##.exr")
    assert not has_placeholder("out.#.exr")
    assert not has_placeholder("####/out.exr")


@pytest.mark.parametrize(
    ("template", "frame"), [("o.####.exr", 1.5), ("####.####.##.exr", 1), ("o.####.exr", None)]
)
def test_frame_that_has_no_place_is_a_usage_error(template, frame):
    with pytest.raises(UsageError):
        frame_path(template, frame)
