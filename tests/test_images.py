"""Pictures in, pictures out."""

from __future__ import annotations

import os
import resource
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import OpenEXR
import OpenImageIO
import pytest

from usdskin import images
from usdskin.errors import ImageError

HALF_RTOL = 2.0**-11  # rounding of binary16
RNG_SEED = 7


def _write(path: Path, pixels: np.ndarray, sample_type: str = "float", **attributes) -> Path:
    height, width, count = pixels.shape
    spec = OpenImageIO.ImageSpec(width, height, count, sample_type)
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), spec)
    assert output.write_image(pixels)
    output.close()
    return path


def _gradient(height: int = 5, width: int = 7, count: int = 3) -> np.ndarray:
    return np.random.default_rng(RNG_SEED).random((height, width, count), np.float32)


# Reading


def test_eight_and_sixteen_bit_pixels_are_scaled_to_one(tmp_path):
    bytes_ = np.array([[[0, 51, 255]]], np.uint8)
    shorts = np.array([[[0, 13107, 65535]]], np.uint16)
    for pixels in (bytes_, shorts):
        image = images.read_image(_write(tmp_path / "a.png", pixels, str(pixels.dtype)))
        np.testing.assert_allclose(image.pixels, [[[0.0, 0.2, 1.0]]], atol=1e-7)
        assert image.sample_type == str(pixels.dtype)


def test_nan_and_infinity_come_through(tmp_path):
    pixels = np.array([[[np.nan, np.inf, -1.0]]], np.float32)
    image = images.read_image(_write(tmp_path / "a.exr", pixels))
    np.testing.assert_array_equal(image.pixels, pixels)


@pytest.mark.parametrize("compression", ["none", "zip", "piz", "pxr24", "dwaa", "dwab"])
def test_every_compression_is_read_as_openexr_reads_it(tmp_path, compression):
    path = tmp_path / "a.exr"
    kind = getattr(OpenEXR, f"{'NO' if compression == 'none' else compression.upper()}_COMPRESSION")
    channels = {name: _gradient(40, 50)[..., i].copy() for i, name in enumerate("RGB")}
    OpenEXR.File({"compression": kind, "type": OpenEXR.scanlineimage}, channels).write(str(path))

    image = images.read_image(path)

    with OpenEXR.File(str(path), separate_channels=True) as file:
        for index, name in enumerate(image.channel_names):
            np.testing.assert_array_equal(image.pixels[..., index], file.channels()[name].pixels)


def test_tiled_files_are_read(tmp_path):
    path = tmp_path / "a.exr"
    pixels = _gradient(70, 90, 4)
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    OpenEXR.File(header, {"RGBA": pixels}).write(str(path))
    np.testing.assert_array_equal(images.read_image(path).pixels, pixels)


def test_pixels_outside_the_data_window_are_zero_and_overscan_is_cut(tmp_path):
    pixels = _gradient(4, 4, 1)
    part = images.Part("Z", {"Z": pixels[..., 0]})
    path = tmp_path / "crop.exr"
    images.write_exr(path, [part], origin=(2, -1), display_size=(5, 6))

    read = images.read_image(path).pixels

    expected = np.zeros((6, 5, 1), np.float32)
    expected[0:3, 2:5] = pixels[1:4, 0:3]
    np.testing.assert_array_equal(read, expected)


def test_channels_are_selected_in_the_order_asked(tmp_path):
    pixels = _gradient(70, 5)
    path = _write(tmp_path / "a.exr", pixels)
    image = images.read_image(path, channels=("B", "R"))
    np.testing.assert_array_equal(image.pixels, pixels[..., [2, 0]])
    with pytest.raises(ImageError, match=r"no channel 'q'; it has 'R', 'G', 'B'"):
        images.read_image(path, channels=("q",))


def test_radiance_exposure_is_divided_out_and_rows_are_turned(tmp_path):
    path = _write(tmp_path / "a.hdr", np.full((9, 8, 3), 0.5, np.float32))
    data = path.read_bytes()
    assert b"-Y 9 +X 8\n" in data
    pixels = np.arange(1, 10, dtype=np.float32)[:, None, None] * np.ones((9, 8, 3), np.float32)
    data = _write(tmp_path / "b.hdr", pixels).read_bytes()
    data = data.replace(b"-Y 9", b"EXPOSURE=2\n\n+Y 9").replace(b"\n\nEXPOSURE", b"\nEXPOSURE")
    (tmp_path / "b.hdr").write_bytes(data)

    read = images.read_image(tmp_path / "b.hdr").pixels

    np.testing.assert_array_equal(read, pixels[::-1] / 2)


@pytest.mark.parametrize("interop", sorted(images.CHROMATICITIES))
def test_color_space_is_told_by_interop_id_or_chromaticities(tmp_path, interop):
    path = tmp_path / "a.exr"
    chromaticities = OpenEXR.colorInteropIDToChromaticities(interop)
    np.testing.assert_allclose(images.CHROMATICITIES[interop], chromaticities, atol=1e-7)
    for header in ({"chromaticities": chromaticities}, {"colorInteropID": interop}):
        OpenEXR.File(header, {"RGB": _gradient()}).write(str(path))
        assert images.read_image(path).color_space == interop
    OpenEXR.File({}, {"RGB": _gradient()}).write(str(path))
    assert images.read_image(path).color_space is None


def test_images_inside_a_package_are_read(tmp_path):
    pixels = _gradient()
    _write(tmp_path / "a.exr", pixels)
    with zipfile.ZipFile(tmp_path / "a.usdz", "w") as archive:
        archive.write(tmp_path / "a.exr", "tex/a.exr")
    read = images.read_image(f"{tmp_path}/a.usdz[tex/a.exr]").pixels
    np.testing.assert_array_equal(read, pixels)
    with pytest.raises(ImageError, match=r"tex/b.exr\]: cannot read; no such file in the package"):
        images.read_image(f"{tmp_path}/a.usdz[tex/b.exr]")


def test_what_is_no_readable_image_is_refused_in_one_line(tmp_path):
    whole = _write(tmp_path / "whole.exr", _gradient(64, 64)).read_bytes()
    png = _write(tmp_path / "whole.png", _gradient(64, 64), "uint8").read_bytes()
    cases = {
        "missing.exr": (None, "no such file"),
        "empty.exr": (b"", "cannot read"),
        "text.exr": (b"hello", "cannot read"),
        "header.exr": (whole[:120], "cannot read"),
        "pixels.exr": (whole[: len(whole) // 2], "cannot read"),
        "name.exr": (png, "cannot read"),
        "pixels.png": (png[: len(png) // 2], "cannot read"),
        "text.py": (b"print()", "not an image of a known format"),
        "text.usdz[a]": (b"hello", "cannot read"),
        "huge.hdr": (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y 60000 +X 60000\n", "MB"),
        "negative.hdr": (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y -5 +X 6\n", "cannot read"),
    }
    for name, (data, message) in cases.items():
        if data is not None:
            (tmp_path / name.split("[")[0]).write_bytes(data)
        for reader in (images.read_image, images.read_spectral):
            with pytest.raises(ImageError, match=f"{message}|no spectral channels") as caught:
                reader(tmp_path / name)
            assert str(caught.value).startswith(str(tmp_path / name))
            assert "\n" not in str(caught.value)
    with pytest.raises(ImageError, match="it is a folder"):
        images.read_image(tmp_path)


def test_a_picture_over_the_limit_is_refused_before_it_is_allocated(tmp_path):
    path = tmp_path / "a.exr"
    # One pixel of data in a display window of 3 TiB.
    part = images.Part("Z", {"Z": np.ones((1, 1), np.float32)})
    images.write_exr(path, [part], display_size=(900_000, 900_000))
    with pytest.raises(ImageError, match=r"channels need \d+ MiB; the limit is 2048 MiB"):
        images.read_image(path)
    path = _write(tmp_path / "b.exr", np.zeros((1024, 1024, 3), np.float32))
    with pytest.raises(ImageError, match="limit"):
        images.read_image(path, max_mb=4)


def test_headers_are_listed_part_by_part(tmp_path):
    path = tmp_path / "a.exr"
    parts = [
        images.Part("beauty", {"": _gradient(count=4)}, {"usdskin/seed": 3}, "half"),
        images.Part("primId", {"primId": np.zeros((5, 7), np.int32)}, {}, "uint"),
    ]
    images.write_exr(path, parts)
    headers = images.read_headers(path)
    assert [header.name for header in headers] == ["beauty", "primId"]
    assert [header.channel_types[0] for header in headers] == ["half", "uint"]
    assert headers[0].attributes["usdskin/seed"] == 3
    assert (headers[0].width, headers[0].height) == (7, 5)


# Spectral


def test_spectral_channels_are_found_by_pattern_and_sorted_by_wavelength(tmp_path):
    names = {
        "S0.1000,0nm": 1000.0,
        "S0.374,688nm": 374.688,
        "S0.550,000000nm": 550.0,
        "S0.0,6um": 600.0,
        "S0.4E-7m": 400.0,
        "S0.500THz": 599.584916,  # c / 5e14 Hz
    }
    pixels = {name: np.full((2, 3), value, np.float32) for name, value in names.items()}
    extra = {"R": np.zeros((2, 3), np.float32), "S1.400,0nm": np.zeros((2, 3), np.float32)}
    path = tmp_path / "a.exr"
    OpenEXR.File({}, {**pixels, **extra}).write(str(path))

    wavelength_nm, read = images.read_spectral(path)

    np.testing.assert_allclose(wavelength_nm, sorted(names.values()), atol=1e-9)
    np.testing.assert_array_equal(read[1, 2], np.float32(sorted(names.values())))


def test_reflective_channels_of_a_later_part_are_found(tmp_path):
    plane = np.ones((2, 3), np.float32)
    path = tmp_path / "a.exr"
    images.write_exr(path, [images.Part("a", {"Z": plane}), images.Part("b", {"T.500,0nm": plane})])
    wavelength_nm, read = images.read_spectral(path)
    assert wavelength_nm.tolist() == [500.0]
    assert read.shape == (2, 3, 1)


def test_files_without_spectra_or_with_one_twice_are_refused(tmp_path):
    plane = np.ones((2, 3), np.float32)
    path = tmp_path / "a.exr"
    OpenEXR.File({}, {"S0.500,0nm": plane, "S0.0,5um": plane}).write(str(path))
    with pytest.raises(ImageError, match=r"S0\.0,5um and S0\.500,0nm have the same wavelength"):
        images.read_spectral(path)
    OpenEXR.File({}, {"R": plane}).write(str(path))
    with pytest.raises(ImageError, match="no spectral channels"):
        images.read_spectral(path)


def test_a_spectral_file_is_read_back_by_us_by_openexr_and_by_colour(tmp_path):
    colour = pytest.importorskip("colour")
    path = tmp_path / "a.exr"
    wavelength_nm = np.arange(400.0, 701.0, 5.0)
    pixels = _gradient(6, 4, wavelength_nm.size) * 1e-7
    rgb = _gradient(6, 4)
    images.write_spectral_exr(path, wavelength_nm, pixels, rgb, "W.m^-2.sr^-1.nm^-1", {"a": "b"})

    ours = images.read_spectral(path)
    np.testing.assert_array_equal(ours[0], wavelength_nm)
    np.testing.assert_array_equal(ours[1], pixels)

    with OpenEXR.File(str(path), separate_channels=True) as file:
        assert len(file.parts) == 1
        header, channels = file.header(), file.channels()
        assert header["spectralLayoutVersion"] == "1.0"
        assert header["emissiveUnits"] == "W.m^-2.sr^-1.nm^-1"
        assert header["a"] == "b"
        assert set(channels) >= {"R", "G", "B", "S0.400,000000nm", "S0.700,000000nm"}
        np.testing.assert_array_equal(channels["S0.405,000000nm"].pixels, pixels[..., 1])
        np.testing.assert_array_equal(channels["G"].pixels, rgb[..., 1])

    components = colour.read_spectral_image_Fichet2021(path)
    np.testing.assert_allclose(components["S0"][0], wavelength_nm)
    np.testing.assert_array_equal(components["S0"][1], pixels)


def test_a_spectral_file_of_colour_is_read(tmp_path):
    colour = pytest.importorskip("colour")
    path = tmp_path / "a.exr"
    wavelength_nm = np.arange(400.0, 701.0, 20.0)
    pixels = _gradient(3, 4, wavelength_nm.size)
    specification = colour.Specification_Fichet2021(is_emissive=True)
    colour.write_spectral_image_Fichet2021(
        {"S0": (wavelength_nm, pixels)}, path, "float32", specification
    )
    ours = images.read_spectral(path)
    np.testing.assert_allclose(ours[0], wavelength_nm)
    np.testing.assert_allclose(ours[1], pixels, rtol=1e-6)


def test_writing_a_spectral_file_holds_no_second_copy(tmp_path):
    """512 x 512 x 61 floats are 64 MB; the writer may add a quarter of that."""
    script = f"""
import numpy as np
from usdskin import images
pixels = np.ones((512, 512, 61), np.float32)
rgb = np.ones((512, 512, 3), np.float32)
small = (np.array([500.0]), pixels[:64, :64, :1], rgb[:64, :64])
images.write_spectral_exr({str(tmp_path / "s.exr")!r}, *small)
peak = lambda: int(open("/proc/self/status").read().partition("VmHWM:")[2].split()[0])
before = peak()
images.write_spectral_exr({str(tmp_path / "a.exr")!r}, np.arange(400.0, 701.0, 5.0), pixels, rgb)
print((peak() - before) / 1024)
"""
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert float(out.stdout) < 40.0  # [MiB]


# Writing EXR


def test_the_first_part_is_a_beauty_every_reader_understands(tmp_path):
    path = tmp_path / "a.exr"
    beauty, normals = _gradient(count=4), _gradient(count=3)
    ids = np.arange(35, dtype=np.int32).reshape(5, 7) + 2**24
    parts = [
        images.Part("beauty", {"": beauty}, {"usdskin/stage": "shot.usda"}, "half",
                    "lin_rec709_scene"),
        images.Part("N", {"N": normals}),
        images.Part("primId", {"primId": ids}, {}, "uint"),
    ]  # fmt: skip
    images.write_exr(path, parts)

    with OpenEXR.File(str(path), separate_channels=True) as file:
        first = file.parts[0]
        assert first.name() == "beauty"
        assert first.header["colorInteropID"] == "lin_rec709_scene"
        assert first.header["usdskin/stage"] == "shot.usda"
        expected = OpenEXR.colorInteropIDToChromaticities("lin_rec709_scene")
        assert first.header["chromaticities"] == expected
        for part in file.parts:
            warnings = OpenEXR.checkColorMetadata(part.header, first.header)
            assert warnings == 0, OpenEXR.colorMetadataWarningToString(warnings)
        for index, name in enumerate("RGBA"):
            stored = first.channels[name].pixels
            assert stored.dtype == np.float16
            np.testing.assert_allclose(stored, beauty[..., index], rtol=HALF_RTOL)
        assert set(file.parts[1].channels) == {"N.X", "N.Y", "N.Z"}
        np.testing.assert_array_equal(file.parts[1].channels["N.Y"].pixels, normals[..., 1])
        np.testing.assert_array_equal(file.parts[2].channels["primId"].pixels, ids)


def test_values_beyond_half_are_clipped_but_infinity_and_nan_are_kept(tmp_path):
    path = tmp_path / "a.exr"
    plane = np.array([[1e6, -1e6, np.inf, np.nan]], np.float32)
    images.write_exr(path, [images.Part("Z", {"Z": plane}, {}, "half")])
    read = images.read_image(path).pixels[..., 0]
    np.testing.assert_array_equal(read, [[images.HALF_MAX, -images.HALF_MAX, np.inf, np.nan]])
    assert plane[0, 0] == 1e6


def test_the_same_pixels_give_the_same_bytes(tmp_path):
    parts = [images.Part("beauty", {"": _gradient(count=4)}, {}, "half", "lin_rec709_scene")]
    images.write_exr(tmp_path / "a.exr", parts)
    images.write_exr(tmp_path / "b.exr", parts)
    assert (tmp_path / "a.exr").read_bytes() == (tmp_path / "b.exr").read_bytes()


def test_attributes_keep_their_type(tmp_path):
    path = tmp_path / "a.exr"
    matrix = np.arange(16.0).reshape(4, 4)
    attributes = {"t": "é", "i": -7, "f": 0.5, "m": matrix, "l": [1, 2], "big": 2**40}
    images.write_exr(path, [images.Part("Z", {"Z": np.zeros((2, 2))}, attributes)])
    header = OpenEXR.File(str(path)).header()
    assert (header["t"], header["i"], header["f"]) == ("é", -7, 0.5)
    assert (header["l"], header["big"]) == ("[1, 2]", "1099511627776")
    np.testing.assert_array_equal(header["m"], matrix)


def test_parts_of_different_size_and_float_ids_are_a_mistake_of_the_caller(tmp_path):
    parts = [images.Part(str(n), {"Z": np.zeros((n, 2), np.float32)}) for n in (2, 3)]
    with pytest.raises(ValueError, match="one size"):
        images.write_exr(tmp_path / "a.exr", parts)
    with pytest.raises(ValueError, match="integer pixels"):
        images.write_exr(
            tmp_path / "a.exr", [images.Part("i", {"i": np.zeros((2, 2))}, {}, "uint")]
        )


def test_unwritable_output_is_named_and_leaves_nothing_behind(tmp_path):
    part = images.Part("Z", {"Z": np.zeros((2, 2), np.float32)})
    (tmp_path / "folder.exr").mkdir()
    (tmp_path / "file").write_text("")
    before = sorted(tmp_path.rglob("*"))
    for name in ("folder.exr", "file/a.exr", "a.unknown"):
        with pytest.raises(ImageError, match="cannot write") as caught:
            images.write_exr(tmp_path / name, [part])
        assert str(tmp_path / name) in str(caught.value)
    with pytest.raises(ImageError, match="cannot write"):
        images.write_png("/proc/a.png", np.zeros((2, 2, 3), np.uint8))
    with pytest.raises(ImageError, match="no EXR compression 'lzw'"):
        images.write_exr(tmp_path / "a.exr", [part], "lzw")
    assert sorted(tmp_path.rglob("*")) == before


def test_a_full_disk_leaves_the_old_file(tmp_path):
    """The file size limit stands for a full disk: the write fails half-way."""
    path = tmp_path / "a.exr"
    path.write_text("old")
    script = f"""
import resource, signal, numpy as np
from usdskin import errors, images
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (20000, 20000))
noise = np.random.default_rng(0).random((256, 256)).astype(np.float32)
try:
    images.write_exr({str(path)!r}, [images.Part("Z", {{"Z": noise}})])
except errors.ImageError as error:
    print(error)
"""
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "cannot write" in out.stdout
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.exr"]


def test_a_disk_too_full_for_the_last_byte_leaves_the_old_file(tmp_path):
    """OpenImageIO says that all is well when closing a file fails."""
    path = tmp_path / "a.exr"
    script = f"""
import os, resource, numpy as np
from usdskin import errors, images
parts = [images.Part(name, {{name: np.ones((64, 64), np.float32)}}) for name in "ZW"]
images.write_exr({str(path)!r}, parts, "none")
limit = os.path.getsize({str(path)!r}) - 1
open({str(path)!r}, "w").write("old")
resource.setrlimit(resource.RLIMIT_FSIZE, (limit, limit))
try:
    images.write_exr({str(path)!r}, parts, "none")
except errors.ImageError as error:
    print(error)
"""
    out = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert "cannot write" in out.stdout
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["a.exr"]


def test_the_limit_of_an_earlier_read_does_not_keep_a_picture_from_being_written(tmp_path):
    noise = np.random.default_rng(RNG_SEED).random((600, 600), np.float32)
    part = images.Part("Z", {"Z": noise})
    images.write_exr(tmp_path / "a.exr", [part])
    with pytest.raises(ImageError, match="1 MB limit; make it smaller"):
        images.read_image(tmp_path / "a.exr", max_mb=1)
    images.write_exr(tmp_path / "b.exr", [part])
    np.testing.assert_array_equal(images.read_image(tmp_path / "b.exr").pixels[..., 0], noise)


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
@pytest.mark.parametrize("share", [0.3, 0.6, 0.99])
def test_a_picture_that_was_cut_short_is_refused_without_a_word_from_its_library(
    name, share, tmp_path, capfd
):
    pixels = np.random.default_rng(RNG_SEED).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    path = _write(tmp_path / name, pixels, "uint8")
    images.read_image(path)
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * share)])
    with pytest.raises(ImageError, match=f"{name}: cannot read; it is cut short"):
        images.read_image(path)
    assert capfd.readouterr().err == ""


def test_a_damaged_png_is_refused_without_a_word_from_its_library(tmp_path, capfd):
    pixels = np.random.default_rng(RNG_SEED).integers(0, 255, (64, 64, 3)).astype(np.uint8)
    path = _write(tmp_path / "a.png", pixels, "uint8")
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    with pytest.raises(ImageError, match="checksum"):
        images.read_image(path)
    assert capfd.readouterr().err == ""


def test_a_package_may_hold_any_name(tmp_path):
    """USD stores names as UTF-8 without the flag that says so; Python takes them for cp437."""
    from pxr import Sdf

    pixels = np.array([[[10, 20, 30]]], np.uint8)
    file = _write(tmp_path / "a.png", pixels, "uint8")
    writer = Sdf.ZipFileWriter.CreateNew(str(tmp_path / "a.usdz"))
    writer.AddFile(str(file), "häut.png")
    writer.Save()
    image = images.read_image(f"{tmp_path}/a.usdz[häut.png]")
    np.testing.assert_allclose(image.pixels * 255.0, pixels)


# PNG


@pytest.mark.parametrize("count", [3, 4])
def test_a_png_holds_pixels_text_and_the_srgb_mark(tmp_path, count):
    path = tmp_path / "a.png"
    pixels = np.random.default_rng(RNG_SEED).integers(0, 256, (9, 5, count), np.uint8)
    images.write_png(path, pixels, {"usdskin:ev": "1.5", "usdskin:note": "λ"})

    image = images.read_image(path)

    np.testing.assert_array_equal(np.rint(image.pixels * 255), pixels)
    assert image.attributes["usdskin:ev"] == "1.5"
    assert "λ".encode() in path.read_bytes()
    assert b"sRGB\x01" in path.read_bytes()
    assert image.color_space == "srgb_rec709_scene"


# Files of strangers


def _limits() -> None:
    resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30))


_CHILD = """
import sys
from usdskin import errors, images
for reader in (images.read_headers, images.read_image, images.read_spectral):
    try:
        reader(sys.argv[1])
        print("read")
    except errors.ImageError as error:
        assert chr(10) not in str(error)
        print("refused:", error)
"""


def _survives(path: Path) -> None:
    child = subprocess.run(
        [sys.executable, "-c", _CHILD, str(path)],
        capture_output=True, text=True, timeout=60, preexec_fn=_limits,
    )  # fmt: skip
    assert child.returncode == 0, f"{path.name}: {child.returncode} {child.stderr[-400:]}"
    assert child.stdout.count("\n") == 3


@pytest.mark.realdata
def test_openexr_regression_inputs_are_refused_or_read(realdata):
    paths = sorted((realdata / "malformed" / "openexr_src_test").glob("*.exr"))
    assert len(paths) == 11
    for path in paths:
        _survives(path)


@pytest.mark.parametrize("suffix", ["exr", "hdr", "png", "tif", "jpg"])
def test_damaged_files_are_refused_or_read(tmp_path, suffix):
    sample_type = "float" if suffix in ("exr", "hdr", "tif") else "uint8"
    whole = _write(tmp_path / f"whole.{suffix}", _gradient(40, 48), sample_type).read_bytes()
    rng = np.random.default_rng(RNG_SEED)
    script = _CHILD.replace("sys.argv[1]", "path").replace(
        "for reader", "for path in sys.argv[1:]:\n  for reader"
    )
    script = script.replace("\n    ", "\n      ")
    paths = []
    for trial in range(60):
        data = bytearray(whole)
        for position in rng.integers(0, min(len(data), 600), 1 + trial % 4):
            data[position] ^= 1 << int(rng.integers(8))
        if trial % 5 == 0:
            data = data[: int(rng.integers(len(data)))]
        paths.append(tmp_path / f"{trial}.{suffix}")
        paths[-1].write_bytes(data)
    child = subprocess.run(
        [sys.executable, "-c", script, *map(str, paths)],
        capture_output=True, text=True, timeout=300, preexec_fn=_limits,
    )  # fmt: skip
    assert child.returncode == 0, child.stderr[-600:]
    assert child.stdout.count("\n") == 3 * len(paths)


@pytest.mark.realdata
def test_the_five_captured_maps_are_read(realdata):
    paths = sorted((realdata / "hdri").iterdir())
    assert len(paths) == 5
    for path in paths:
        image = images.read_image(path)
        assert image.pixels.shape[1] == 2 * image.pixels.shape[0]
        assert image.channel_names == ("R", "G", "B")
        assert np.isfinite(image.pixels).all()
        assert image.pixels.max() > 1.0
