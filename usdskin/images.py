"""Read pictures and EXR data of any common kind; the writers of ``image_output`` are here too.

Reads: EXR (every compression, multi-part), Radiance HDR, PNG, JPEG, TIFF and what else OpenImageIO
knows, also inside a ``.usdz`` package (``pkg.usdz[tex/skin.png]``).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.image_files import ImageHeader, listed, opened, read_header, seek
from usdskin.image_output import (
    CHROMATICITIES,
    HALF_MAX,
    Part,
    replacing,
    write_exr,
    write_png,
    write_spectral_exr,
)
from usdskin.image_rows import RowReader, open_rows
from usdskin.spectral_layout import spectral_channels

__all__ = [
    "CHROMATICITIES",
    "HALF_MAX",
    "Image",
    "ImageHeader",
    "Part",
    "RowReader",
    "open_rows",
    "read_headers",
    "read_image",
    "read_spectral",
    "replacing",
    "spectral_channels",
    "write_exr",
    "write_png",
    "write_spectral_exr",
]

FloatArray = NDArray[np.float32]

_ROWS_PER_BLOCK = 64


@dataclass(frozen=True, slots=True, eq=False)
class Image:
    """The pixels of one part of an image file, first row at the top."""

    pixels: FloatArray
    """The display window, shape [height, width, channel_count]; 0 outside the data window. Integers
    are scaled to 0..1, but the unsigned integers of an EXR (ids) keep their value."""

    channel_names: tuple[str, ...]
    """Shape [channel_count]."""

    attributes: dict[str, Any]
    """Header attributes, by OpenImageIO's name."""

    color_space: str | None
    """Color interop ID where the file tells one, such as ``lin_rec709_scene``."""

    sample_type: str = "float"
    """Type of the first channel in the file: ``uint8``, ``uint16``, ``half``, ``float``, ..."""


def read_headers(path: str | Path) -> tuple[ImageHeader, ...]:
    """Return the header of every part of an image file, without its pixels.

    Raises:
        ImageError: The file is missing or no image.
    """
    headers: list[ImageHeader] = []
    with opened(path, None) as source:
        while source.seek_subimage(len(headers), 0):
            headers.append(read_header(path, source))
    return tuple(headers)


def read_image(
    path: str | Path,
    max_mb: int = 2048,
    *,
    part: int | str = 0,
    channels: Sequence[str] | None = None,
) -> Image:
    """Return the pixels of an image file; NaN and infinity come through.

    Alpha is as stored: associated in an EXR, not associated in a PNG or TIFF that says so.
    A Radiance file's EXPOSURE is divided out and its orientation applied, as its format says; the
    orientation tag of a photograph is left to the caller.

    Args:
        path: The file, or ``package.usdz[member]``.
        max_mb: Refuse pictures that need more memory than this [MiB], before allocating it.
        part: Index or name of the part of a multi-part EXR.
        channels: Read these channels only, in this order; all of them where ``None``.

    Raises:
        ImageError: The file is missing, broken, too large, no image, or lacks the part or channel.
    """
    with open_rows(path, max_mb, part=part, channels=channels) as reader:
        pixels = _all_rows(reader)
        header = reader.header
        if reader.format_name == "hdr":
            pixels = _as_radiance_says(path, pixels, header.attributes)
        return Image(
            pixels,
            reader.channel_names,
            header.attributes,
            header.color_space,
            reader.sample_type,
        )


def read_spectral(
    path: str | Path, max_mb: int = 2048, *, part: int | str | None = None
) -> tuple[NDArray[np.float64], FloatArray]:
    """Return the spectral channels of an EXR file.

    The layout is that of Fichet, Pacanowski and Wilkie, "An OpenEXR Layout for Spectral Images",
    JCGT 10(3), 2021. Emissive channels (``S0.<number><unit>``) are taken where there are any, else
    the reflective ones (``T.``).

    Args:
        path: The file.
        max_mb: Refuse pictures that need more memory than this [MiB].
        part: Index or name of the part; the first part with spectral channels where ``None``.

    Returns:
        Wavelengths [nm], ascending, shape [band_count], and pixels in the file's
        ``emissiveUnits`` (see ``read_headers``), shape [height, width, band_count].

    Raises:
        ImageError: The file is missing, broken, too large or holds no spectra.
    """
    if part is None:
        spectral = [bool(spectral_channels(h.channel_names)) for h in read_headers(path)]
        part = spectral.index(True) if any(spectral) else 0
    with opened(path, max_mb) as source:
        index, header = seek(path, source, part)
        bands = spectral_channels(header.channel_names)
        if not bands:
            raise ImageError(
                f"{path}: no spectral channels such as S0.550,000000nm; it has "
                f"{listed(header.channel_names)}."
            )
        wavelength_nm = np.array([wavelength for wavelength, _ in bands])
        same = np.flatnonzero(np.diff(wavelength_nm) <= 0)
        if same.size:
            first, second = (bands[same[0] + i][1] for i in (0, 1))
            raise ImageError(f"{path}: channels {first} and {second} have the same wavelength.")
        names = [name for _, name in bands]
        return wavelength_nm, _all_rows(RowReader(path, source, (index, header), names, max_mb))


def _all_rows(reader: RowReader) -> FloatArray:
    """Read a block of rows at a time, so that nothing is held twice."""
    height, width = reader.header.height, reader.header.width
    pixels = np.empty((height, width, len(reader.channel_names)), np.float32)
    for begin in range(0, height, _ROWS_PER_BLOCK):
        end = min(begin + _ROWS_PER_BLOCK, height)
        pixels[begin:end] = reader.rows(begin, end)
    return pixels


def _as_radiance_says(
    path: str | Path, pixels: FloatArray, attributes: dict[str, Any]
) -> FloatArray:
    """Apply a Radiance header: EXPOSURE is a factor the pixels already hold."""
    exposure = float(attributes.get("hdr:exposure", 1.0))
    if not 0.0 < exposure < np.inf:
        raise ImageError(f"{path}: EXPOSURE of {exposure:g} in the header; it must be positive.")
    flips = {1: (1, 1), 2: (1, -1), 3: (-1, -1), 4: (-1, 1)}
    orientation = int(attributes.get("Orientation", 1))
    if orientation not in flips:
        raise ImageError(f"{path}: columns are stored as rows; write it anew with -Y rows first.")
    vertical, horizontal = flips[orientation]
    flipped = np.ascontiguousarray(pixels[::vertical, ::horizontal])
    return flipped if exposure == 1.0 else flipped / np.float32(exposure)
