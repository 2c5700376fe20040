"""EXR files written a block of rows at a time."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from usdskin.errors import ImageError
from usdskin.exr_rows import HALF_MAX, Raster, open_exr_parts, open_exr_writer
from usdskin.images import Part, read_headers, read_image, write_exr
from usdskin.replacing import replace_all, scratch_beside

NAMES = ["c0", "c1", "c2", "c3"]


def pixels(height: int = 37, width: int = 22) -> np.ndarray:
    return np.random.default_rng(2).normal(size=(height, width, len(NAMES))).astype(np.float32)


@pytest.mark.parametrize("count", [1, 5, 16, 37])
@pytest.mark.parametrize("compression", ["none", "zips", "zip:1", "piz"])
def test_rows_come_back_whatever_the_blocks(tmp_path, count, compression):
    values = pixels()
    height, width = values.shape[:2]
    path = tmp_path / "rows.exr"
    with open_exr_writer(path, width, height, NAMES, compression=compression) as writer:
        for begin in range(0, height, count):
            writer.write(begin, values[begin : begin + count])
    assert np.array_equal(read_image(path, channels=NAMES).pixels, values)


def test_rows_give_the_bytes_of_the_whole_picture(tmp_path):
    values = pixels()
    height, width = values.shape[:2]
    layers = {name: values[..., index] for index, name in enumerate(NAMES)}
    write_exr(tmp_path / "whole.exr", [Part("", layers, {"usdskin/units": "relative"})])
    attributes = {"usdskin/units": "relative", "oiio:subimagename": ""}
    path = tmp_path / "rows.exr"
    with open_exr_writer(path, width, height, NAMES, attributes=attributes) as writer:
        for begin in range(0, height, 8):
            writer.write(begin, values[begin : begin + 8])
    assert path.read_bytes() == (tmp_path / "whole.exr").read_bytes()


def test_rows_that_do_not_follow_are_a_mistake(tmp_path):
    values = pixels()
    height, width = values.shape[:2]
    with (
        pytest.raises(ValueError, match="rows 4 to 8"),
        open_exr_writer(tmp_path / "rows.exr", width, height, NAMES) as writer,
    ):
        writer.write(4, values[4:8])
    assert not list(tmp_path.iterdir())


def test_a_file_that_lacks_rows_never_appears(tmp_path):
    values = pixels()
    height, width = values.shape[:2]
    with (
        pytest.raises(ValueError, match="not all rows"),
        open_exr_writer(tmp_path / "rows.exr", width, height, NAMES) as writer,
    ):
        writer.write(0, values[:-1])
    assert not list(tmp_path.iterdir())


def test_an_error_on_the_way_leaves_the_old_file(tmp_path):
    path = tmp_path / "rows.exr"
    path.write_bytes(b"old")
    with pytest.raises(KeyboardInterrupt), open_exr_writer(path, 4, 2, ["Y"]) as writer:
        writer.write(0, np.zeros((1, 4, 1), np.float32))
        raise KeyboardInterrupt
    assert [item.name for item in tmp_path.iterdir()] == ["rows.exr"]
    assert path.read_bytes() == b"old"


def test_half_samples_stay_finite(tmp_path):
    with open_exr_writer(tmp_path / "half.exr", 3, 1, ["Y"], sample_type="half") as writer:
        writer.write(0, np.array([[[1e6], [-1e6], [np.inf]]], np.float32))
    assert read_image(tmp_path / "half.exr").pixels[0, :, 0].tolist() == [
        HALF_MAX, -HALF_MAX, np.inf
    ]  # fmt: skip


def test_parts_are_written_one_after_another(tmp_path):
    values = pixels()
    height, width = values.shape[:2]
    names = {"oiio:subimagename": "first"}, {"oiio:subimagename": "second"}
    rasters = [Raster(width, height, NAMES, attributes=name) for name in names]
    with open_exr_parts(tmp_path / "parts.exr", rasters) as writers:
        for factor, writer in enumerate(writers, start=1):
            writer.write(0, values[:20] * factor)
            writer.write(20, values[20:] * factor)
    assert [header.name for header in read_headers(tmp_path / "parts.exr")] == ["first", "second"]
    second = read_image(tmp_path / "parts.exr", part="second", channels=NAMES).pixels
    assert np.array_equal(second, values * 2)


@pytest.mark.parametrize(
    ("name", "compression", "message"),
    [
        ("rows.jpg", "zip", "must end in .exr"),
        ("rows.exr", "zap", "no EXR compression 'zap'"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, name, compression, message):
    with (
        pytest.raises(ImageError, match=message),
        open_exr_writer(tmp_path / name, 4, 2, ["Y"], compression=compression),
    ):
        pass


def test_finished_files_are_moved_with_the_first_one_last(tmp_path, monkeypatch):
    moved = []
    monkeypatch.setattr("os.replace", lambda source, target: moved.append(Path(target).name))
    paths = [tmp_path / "light.usda", tmp_path / "a.exr", tmp_path / "b.exr"]
    with scratch_beside(paths[0]) as scratch:
        assert scratch.parent == tmp_path
        replace_all(scratch, paths)
    assert moved == ["b.exr", "a.exr", "light.usda"]
    assert not list(tmp_path.iterdir())


_MEASURE = """
import sys
import numpy as np
from usdskin.exr_rows import open_exr_writer
peak = lambda: int(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])
names = [f"S{index}" for index in range(64)]
with open_exr_writer(sys.argv[1], 1024, 1024, names, compression="none") as writer:
    block = np.zeros((16, 1024, 64), np.float32)
    writer.write(0, block)
    begin = peak()
    for row in range(16, 1024, 16):
        writer.write(row, block)
print(peak() - begin)
"""


def test_memory_does_not_grow_with_the_rows(tmp_path):
    command = [sys.executable, "-c", _MEASURE, str(tmp_path / "large.exr")]
    grown_kib = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    assert grown_kib < 32 * 1024  # of 256 MiB
