"""Write whole pictures as EXR, spectral EXR and PNG files, atomically (``usdskin.replacing``)."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.exr_rows import CHROMATICITIES, HALF_MAX, Raster, RowWriter, open_exr_parts
from usdskin.replacing import replacing
from usdskin.spectral_layout import channel_name

__all__ = [
    "CHROMATICITIES",
    "HALF_MAX",
    "Part",
    "replacing",
    "write_exr",
    "write_png",
    "write_spectral_exr",
]


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
    names, layers = zip(*(_channels(part) for part in parts), strict=True)
    rasters = [
        Raster(
            *_size(layers),
            channel_names,
            part.sample_type,
            part.color_space,
            {**part.attributes, "oiio:subimagename": part.name},
            pixel_aspect_ratio,
            origin,
            display_size,
        )
        for part, channel_names in zip(parts, names, strict=True)
    ]
    _write_layers(path, rasters, layers, compression)


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
    names = [*"RGBA"[: rgb.shape[2]], *bands]
    layers = [[rgb, pixels]]
    raster = Raster(
        *_size(layers), names, "float", color_space, header, pixel_aspect_ratio=pixel_aspect_ratio
    )
    _write_layers(path, [raster], layers, compression)


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


def _png_chunk(kind: bytes, data: bytes) -> bytes:
    return struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))


def _channels(part: Part) -> tuple[list[str], list[NDArray[Any]]]:
    """Return the names of a part's channels, and layers [height, width, k] to put side by side."""
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
    return names, layers


def _size(layers: Sequence[Sequence[NDArray[Any]]]) -> tuple[int, int]:
    """Return width and height of the layers of all parts."""
    sizes = {layer.shape[:2] for part in layers for layer in part}
    if len(sizes) != 1:
        raise ValueError("all layers of an EXR file must have one size")
    height, width = sizes.pop()
    return width, height


def _write_layers(
    path: str | Path,
    rasters: Sequence[Raster],
    layers: Sequence[Sequence[NDArray[Any]]],
    compression: str,
) -> None:
    with open_exr_parts(path, rasters, compression) as writers:
        for writer, of_part in zip(writers, layers, strict=True):
            _write_part(writer, of_part)


def _write_part(writer: RowWriter, layers: Sequence[NDArray[Any]]) -> None:
    """Interleave the layers a block of rows at a time, so that nothing is held twice."""
    raster = writer.raster
    dtype = np.uint32 if raster.sample_type == "uint" else np.float32
    for begin in range(0, raster.height, raster.rows_per_block):
        end = min(begin + raster.rows_per_block, raster.height)
        block = np.empty((end - begin, raster.width, len(raster.channel_names)), dtype)
        np.concatenate([layer[begin:end] for layer in layers], axis=2, out=block, casting="unsafe")
        writer.write(begin, block)
