"""Write EXR, spectral EXR and PNG files atomically.

Every write goes to a temporary file in the destination folder, is flushed to disk and then
renamed, so a reader sees the old file or the new one and nothing in between.

OpenImageIO writes the EXR files, not the OpenEXR module: the latter needs one contiguous array per
channel (a strided view is written as if it were contiguous), which costs a second copy of a
spectral picture. Rows are interleaved here a block at a time.
"""

from __future__ import annotations

import os
import secrets
import struct
import zlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.spectral_layout import channel_name

CHROMATICITIES = {
    "lin_rec709_scene": (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290),
    "lin_rec2020_scene": (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
    "lin_p3d65_scene": (0.680, 0.320, 0.265, 0.690, 0.150, 0.060, 0.3127, 0.3290),
    "lin_adobergb_scene": (0.64, 0.33, 0.21, 0.71, 0.15, 0.06, 0.3127, 0.3290),
    "lin_ap0_scene": (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767),
    "lin_ap1_scene": (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767),
}
"""Red, green, blue and white (x, y) of the color interop IDs that name linear RGB spaces, as in
``OpenEXR.colorInteropIDToChromaticities`` (OpenEXR 3.5)."""

HALF_MAX = 65504.0
"""Largest finite binary16 number (IEEE 754)."""

_ROWS_PER_BLOCK = 64  # several chunks, which are compressed side by side
_ROWS_PER_CHUNK = 16  # of zip
_BLOCK_BYTES = 64 * 2**20
_COMPRESSIONS = frozenset(
    ("none", "rle", "zips", "zip", "piz", "pxr24", "b44", "b44a", "dwaa", "dwab")
)


@dataclass(frozen=True, slots=True, eq=False)
class Part:
    """One part of an EXR file to be written."""

    name: str
    """Name of the part, unique in the file."""

    channels: Mapping[str, NDArray[Any]]
    """Layer name to pixels. Shape [height, width]: one channel of that name. [height, width, k]:
    channels ``<name>.X``, ``.Y``, ``.Z`` (``.R``, ``.G``, ``.B``, ``.A`` where ``color_space`` is
    not ``data``), without the prefix where the name is empty."""

    attributes: Mapping[str, Any] = field(default_factory=dict)
    """Header attributes: text, numbers, a 4x4 matrix; anything else is written as text."""

    sample_type: Literal["half", "float", "uint"] = "float"
    """How samples are stored. Finite values beyond the range of half are clipped to it."""

    color_space: str = "data"
    """Color interop ID of the pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class _Raster:
    """A part as it goes to the file: channel names, and layers [height, width, k] side by side."""

    names: list[str]
    layers: list[NDArray[Any]]
    attributes: dict[str, Any]
    sample_type: str
    color_space: str


def write_exr(
    path: str | Path,
    parts: Sequence[Part],
    compression: str = "zip",
    *,
    pixel_aspect_ratio: float = 1.0,
    origin: tuple[int, int] = (0, 0),
    display_size: tuple[int, int] | None = None,
) -> None:
    """Write an EXR file with one part after another; the same input gives the same bytes.

    Args:
        path: File to write.
        parts: All of the same width and height; the first is the one simple readers show.
        compression: ``none``, ``zips``, ``zip``, ``piz``, ``dwaa``, ..., with ``:level``.
        pixel_aspect_ratio: Width over height of a pixel.
        origin: Column and row of the first pixel in the display window.
        display_size: Width and height of the display window; the pixels' own where ``None``.

    Raises:
        ImageError: The file cannot be written; nothing is left behind.
    """
    rasters = [_raster(part) for part in parts]
    _write_rasters(path, rasters, compression, pixel_aspect_ratio, origin, display_size)


def write_spectral_exr(
    path: str | Path,
    wavelength_nm: NDArray[np.floating[Any]],
    pixels: NDArray[np.float32],
    rgb: NDArray[np.float32],
    units: str = "W.m^-2.sr^-1.nm^-1",
    attributes: Mapping[str, Any] | None = None,
    compression: str = "zip",
    *,
    layer: Literal["S0", "T"] = "S0",
    color_space: str = "lin_rec709_scene",
    pixel_aspect_ratio: float = 1.0,
) -> None:
    """Write a single-part spectral EXR with R, G, B preview.

    The layout is that of Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images",
    JCGT 10(3), 2021.

    Args:
        path: File to write.
        wavelength_nm: Strictly ascending [nm], shape [band_count].
        pixels: Spectra [``units``], shape [height, width, band_count]; stored as 32-bit floats.
        rgb: Preview, shape [height, width, 3], or [height, width, 4] with alpha.
        units: ``emissiveUnits`` of the header; for ``S0`` channels.
        attributes: Further header attributes.
        compression: As for ``write_exr``.
        layer: ``S0`` for radiance and other emissive quantities, ``T`` for reflectance.
        color_space: Color interop ID of the preview.
        pixel_aspect_ratio: Width over height of a pixel.

    Raises:
        ImageError: The file cannot be written; nothing is left behind.
    """
    bands = [channel_name(wavelength, layer) for wavelength in wavelength_nm]
    if pixels.shape[2] != len(bands) or not np.all(np.diff(wavelength_nm) > 0):
        raise ValueError("pixels need one strictly ascending wavelength per band")
    header: dict[str, Any] = {**(attributes or {}), "spectralLayoutVersion": "1.0"}
    if layer == "S0":
        header["emissiveUnits"] = units
    raster = _Raster([*"RGBA"[: rgb.shape[2]], *bands], [rgb, pixels], header, "float", color_space)
    _write_rasters(path, [raster], compression, pixel_aspect_ratio, (0, 0), None)


def write_png(
    path: str | Path, pixels: NDArray[np.uint8], metadata: Mapping[str, str] | None = None
) -> None:
    """Write an 8-bit sRGB picture as PNG (W3C, "Portable Network Graphics", third edition).

    Args:
        path: File to write.
        pixels: sRGB values, shape [height, width, 3], or [height, width, 4] with alpha that is not
            premultiplied.
        metadata: Text chunks, by keyword of 1 to 79 Latin-1 characters.

    Raises:
        ImageError: The file cannot be written; nothing is left behind.
    """
    height, width, count = pixels.shape
    if pixels.dtype != np.uint8 or count not in (3, 4):
        raise ValueError("a PNG takes uint8 pixels of shape [height, width, 3 or 4]")
    # Filter type 2 (up): each row as its difference from the row above, modulo 256.
    rows = pixels.reshape(height, width * count)
    filtered = np.empty((height, 1 + width * count), np.uint8)
    filtered[:, 0] = 2
    filtered[:1, 1:] = rows[:1]
    np.subtract(rows[1:], rows[:-1], out=filtered[1:, 1:])

    header = struct.pack(">IIBBBBB", width, height, 8, 2 if count == 3 else 6, 0, 0, 0)
    chunks = [_png_chunk(b"IHDR", header), _png_chunk(b"sRGB", b"\x01")]  # relative colorimetric
    for keyword, text in (metadata or {}).items():
        # iTXt holds UTF-8; tEXt, which every tool reads, holds Latin-1 only.
        if text.isascii():
            chunks.append(_png_chunk(b"tEXt", keyword.encode("latin-1") + b"\0" + text.encode()))
        else:
            start = keyword.encode("latin-1") + b"\0\0\0\0\0"
            chunks.append(_png_chunk(b"iTXt", start + text.encode("utf-8")))
    chunks += [_png_chunk(b"IDAT", zlib.compress(filtered.data, 6)), _png_chunk(b"IEND", b"")]
    with replacing(path) as temporary:
        Path(temporary).write_bytes(b"\x89PNG\r\n\x1a\n" + b"".join(chunks))


@contextmanager
def replacing(path: str | Path) -> Iterator[str]:
    """Give the name of a temporary file that becomes ``path`` when the block ends well.

    The file is flushed to disk before it is renamed, and removed when the block raises.

    Raises:
        ImageError: The folder is missing or not writable.
    """
    path = Path(path)
    temporary = path.with_name(f".{path.stem}.{os.getpid()}-{secrets.token_hex(4)}{path.suffix}")
    try:
        if path.is_dir():
            raise ImageError(f"{path}: cannot write; it is a folder, so choose another name.")
        if not path.parent.is_dir():
            raise ImageError(
                f"{path}: cannot write; the folder {path.parent} does not exist, so make it first."
            )
        yield str(temporary)
        with open(temporary, "rb") as file:
            os.fsync(file.fileno())
        os.replace(temporary, path)
    except OSError as error:
        raise ImageError(
            f"{path}: cannot write; {error.strerror or error}; check the folder's permissions and "
            "free space."
        ) from error
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _raster(part: Part) -> _Raster:
    names, layers = [], []
    for layer, pixels in part.channels.items():
        if pixels.ndim == 2:
            names.append(layer)
            layers.append(pixels[..., np.newaxis])
            continue
        suffixes = "XYZW" if part.color_space == "data" else "RGBA"
        prefix = f"{layer}." if layer else ""
        names += [prefix + suffixes[channel] for channel in range(pixels.shape[2])]
        layers.append(pixels)
    if part.sample_type == "uint" and any(layer.dtype.kind not in "ui" for layer in layers):
        raise ValueError(f"part {part.name!r}: uint samples need integer pixels")
    attributes = {**part.attributes, "oiio:subimagename": part.name}
    return _Raster(names, layers, attributes, part.sample_type, part.color_space)


def _write_rasters(
    path: str | Path,
    rasters: Sequence[_Raster],
    compression: str,
    pixel_aspect_ratio: float,
    origin: tuple[int, int],
    display_size: tuple[int, int] | None,
) -> None:
    if Path(path).suffix.lower() != ".exr":
        # OpenImageIO would write a JPEG for a name that ends in .jpg.
        raise ImageError(f"{path}: cannot write; the name must end in .exr.")
    if compression.split(":")[0] not in _COMPRESSIONS:
        # OpenImageIO would take zip for a name it does not know.
        raise ImageError(f"{path}: no EXR compression {compression!r}; use none, zips, zip, piz.")
    if len({layer.shape[:2] for raster in rasters for layer in raster.layers}) != 1:
        raise ValueError("all layers of an EXR file must have one size")
    specs: list[Any] = []
    for raster in rasters:
        height, width = raster.layers[0].shape[:2]
        spec = OpenImageIO.ImageSpec(width, height, len(raster.names), raster.sample_type)
        spec.channelnames = tuple(raster.names)
        spec.x, spec.y = origin
        spec.full_width, spec.full_height = display_size or (width, height)
        # Without a DateTime of ours OpenImageIO stamps the hour, and no file comes out twice alike.
        _set_attributes(spec, {"DateTime": "", **raster.attributes})
        spec.attribute("PixelAspectRatio", float(pixel_aspect_ratio))
        spec.attribute("compression", compression)
        spec.attribute("colorInteropID", raster.color_space)
        # All parts share one set of chromaticities (OpenEXR's rule); the first part tells it.
        if not specs and raster.color_space in CHROMATICITIES:
            spec.attribute("chromaticities", "float[8]", CHROMATICITIES[raster.color_space])
        specs.append(spec)

    with replacing(path) as temporary:
        output = OpenImageIO.ImageOutput.create(temporary)
        if output is None:
            raise ImageError(f"{path}: cannot write; {_reason(OpenImageIO, temporary)}.")
        try:
            for index, (spec, raster) in enumerate(zip(specs, rasters, strict=True)):
                first = output.open(temporary, specs) if index == 0 else True
                more = output.open(temporary, spec, "AppendSubimage") if index else True
                if not (first and more and _write_rows(output, spec, raster)):
                    raise ImageError(f"{path}: cannot write; {_reason(output, temporary)}.")
        finally:
            closed = output.close()
        if not (closed and _is_complete(temporary)):
            raise ImageError(f"{path}: cannot write; {_reason(output, temporary)}.")


def _write_rows(output: Any, spec: Any, raster: _Raster) -> bool:
    dtype = np.uint32 if raster.sample_type == "uint" else np.float32
    row_bytes = 4 * spec.width * spec.nchannels
    row_count = _ROWS_PER_BLOCK if row_bytes * _ROWS_PER_BLOCK <= _BLOCK_BYTES else _ROWS_PER_CHUNK
    for start in range(0, spec.height, row_count):
        stop = min(start + row_count, spec.height)
        block = np.empty((stop - start, spec.width, spec.nchannels), dtype)
        np.concatenate(
            [layer[start:stop] for layer in raster.layers], axis=2, out=block, casting="unsafe"
        )
        if raster.sample_type == "half":
            finite = np.isfinite(block)
            np.clip(block, -HALF_MAX, HALF_MAX, out=block, where=finite)
        if not output.write_scanlines(spec.y + start, spec.y + stop, 0, block):
            return False
    return True


def _is_complete(file: str) -> bool:
    """Return whether the last chunk of every part is there.

    OpenImageIO closes a file as if all were well when the disk is too full for its last buffer.
    """
    OpenImageIO.attribute("limits:imagesize_MB", 2**30)  # a read before may have set a lower one
    source = OpenImageIO.ImageInput.open(file)
    if source is None:
        OpenImageIO.geterror()  # else it is printed when the process ends
        return False
    try:
        index = 0
        while source.seek_subimage(index, 0):
            spec = source.spec()
            last = spec.y + spec.height
            if source.read_scanlines(index, 0, last - 1, last, 0, 0, 1, "float") is None:
                return False
            index += 1
        source.geterror()  # of the seek beyond the last part
        return index > 0
    finally:
        source.close()


def _set_attributes(spec: Any, attributes: Mapping[str, Any]) -> None:
    for name, value in attributes.items():
        if isinstance(value, np.ndarray) and value.shape == (4, 4):
            spec.attribute(name, "matrix", tuple(float(number) for number in value.flat))
        elif isinstance(value, (int, np.integer)) and abs(int(value)) < 2**31:
            spec.attribute(name, int(value))
        elif isinstance(value, (float, np.floating)):
            spec.attribute(name, float(value))
        else:
            spec.attribute(name, str(value))


def _reason(output: Any, temporary: str) -> str:
    try:
        lines = output.geterror().splitlines()
    except UnicodeDecodeError:
        lines = []
    if not lines:
        return "the file could not be completed; check the free space"
    reason = str(lines[0]).replace(f' "{temporary}"', "").rstrip(". ")
    return f"{reason}; check the free space"
