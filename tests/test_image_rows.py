"""Pictures read a block of rows at a time."""

from __future__ import annotations

import numpy as np
import OpenEXR
import pytest
from simulated_sensor import write_picture

from usdskin import images
from usdskin.errors import ImageError

FILES = {
    "rows.tif": ("uint16", {"compression": "zip", "tiff__RowsPerStrip": 1}),
    "strips.tif": ("uint16", {"compression": "lzw", "tiff__RowsPerStrip": 21}),
    "one strip.tif": ("uint16", {"compression": "zip", "tiff__RowsPerStrip": 1000}),
    "tiles.tif": ("uint8", {"compression": "zip", "tile": 32}),
    "a.png": ("uint16", {}),
    "a.jpg": ("uint8", {}),
    "zip.exr": ("half", {"compression": "zip"}),
    "dwab.exr": ("float", {"compression": "dwab"}),
    "tiles.exr": ("half", {"compression": "piz", "tile": 48}),
}


@pytest.fixture(params=FILES, ids=str)
def picture(request, tmp_path):
    """Return a file of every way to store rows, 700 x 50 pixels."""
    kind, given = FILES[request.param]
    pixels = np.random.default_rng(1).random((700, 50, 3))
    top = {"uint8": 255, "uint16": 65535}.get(kind, 1)
    return write_picture(tmp_path / request.param, pixels * top, kind, **given)


@pytest.mark.parametrize("step", [1, 7, 64, 300, 700])
def test_rows_in_order_are_the_picture(picture, step):
    with images.open_rows(picture) as reader:
        assert (reader.header.width, reader.header.height) == (50, 700)
        rows = [reader.rows(begin, min(begin + step, 700)) for begin in range(0, 700, step)]
    np.testing.assert_array_equal(np.concatenate(rows), images.read_image(picture).pixels)


def test_rows_may_be_left_out_and_read_again(picture):
    whole = images.read_image(picture).pixels
    with images.open_rows(picture) as reader:
        for begin, end in ((10, 12), (100, 180), (179, 181), (650, 700), (3, 40), (40, 41)):
            np.testing.assert_array_equal(reader.rows(begin, end), whole[begin:end])


def test_integers_may_keep_their_values(tmp_path):
    for kind, values in (("uint8", [0, 51, 255]), ("uint16", [0, 513, 65535])):
        path = write_picture(tmp_path / "a.tif", np.array([[values]]), kind)
        with images.open_rows(path, as_stored=True) as reader:
            rows = reader.rows(0, 1)
        assert rows.dtype == np.dtype(kind)
        np.testing.assert_array_equal(rows, [[values]])


def test_channels_are_given_in_the_order_asked(tmp_path):
    pixels = np.random.default_rng(2).integers(0, 65536, (9, 8, 4))
    path = write_picture(tmp_path / "a.tif", pixels)
    with images.open_rows(path, channels=("B", "R"), as_stored=True) as reader:
        np.testing.assert_array_equal(reader.rows(2, 5), pixels[2:5][..., [2, 0]])


def test_rows_are_those_of_the_display_window(tmp_path):
    pixels = np.random.default_rng(3).random((40, 30), np.float32)
    path = tmp_path / "crop.exr"
    for origin in ((5, 7), (-4, -9)):
        images.write_exr(
            path, [images.Part("Z", {"Z": pixels})], origin=origin, display_size=(33, 50)
        )
        whole = images.read_image(path).pixels
        assert whole.any()
        with images.open_rows(path) as reader:
            rows = [reader.rows(begin, begin + 10) for begin in range(0, 50, 10)]
        np.testing.assert_array_equal(np.concatenate(rows), whole)


def test_parts_are_told_apart(tmp_path):
    path = tmp_path / "a.exr"
    parts = [images.Part(name, {"Z": np.full((20, 10), value, np.float32)})
             for name, value in (("near", 1.0), ("far", 2.0))]  # fmt: skip
    images.write_exr(path, parts)
    with images.open_rows(path, part="far") as reader:
        np.testing.assert_array_equal(reader.rows(0, 20), np.full((20, 10, 1), 2.0))


def test_damage_is_told_when_its_rows_are_read(tmp_path):
    path = tmp_path / "a.exr"
    steps = np.random.default_rng(4).integers(0, 9, (256, 64, 3))  # it compresses
    channels = {"RGB": steps.astype(np.float32)}
    OpenEXR.File({"compression": OpenEXR.ZIP_COMPRESSION}, channels).write(str(path))
    data = bytearray(path.read_bytes())
    data[-3000:-2000] = bytes(1000)
    path.write_bytes(data)
    with pytest.raises(ImageError, match=r"a.exr: cannot read; "), images.open_rows(path) as reader:
        reader.rows(0, 16)
        reader.rows(16, 256)


def test_large_pictures_are_refused_before_they_are_read(tmp_path):
    path = write_picture(tmp_path / "a.tif", np.zeros((1024, 1024, 3)))
    refused = pytest.raises(ImageError, match=r"1024 x 1024 pixels of 3 channels need 12 MiB")
    with refused, images.open_rows(path, max_mb=11):
        pass
