"""Read pictures and EXR data of any common kind; the writers of ``image_output`` are here too.

Reads: EXR (every compression, multi-part), Radiance HDR, PNG, JPEG, TIFF and what else OpenImageIO
knows, also inside a ``.usdz`` package (``pkg.usdz[tex/skin.png]``).
"""

from __future__ import annotations

import os
import re
import tempfile
import zipfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.image_damage import find_damage
from usdskin.image_output import (
    CHROMATICITIES,
    HALF_MAX,
    Part,
    replacing,
    write_exr,
    write_png,
    write_spectral_exr,
)
from usdskin.spectral_layout import spectral_channels

__all__ = [
    "CHROMATICITIES",
    "HALF_MAX",
    "Image",
    "ImageHeader",
    "Part",
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

_PACKAGE = re.compile(r"^(?P<package>.*\.usdz)\[(?P<member>[^\[\]]+)\]$", re.IGNORECASE)
_REMEDY = "; restore a good copy or export it again"
_TOO_LARGE = re.compile(r"exceeds the \d+ MB limit")
_ROWS_PER_BLOCK = 64
_CHROMATICITY_TOLERANCE = 1e-3  # as OpenEXR's chromaticitiesToColorInteropID


@dataclass(frozen=True, slots=True, eq=False)
class ImageHeader:
    """What one part of an image file says about itself."""

    name: str
    """Name of the part; empty in a single-part file that gives none."""

    width: int
    """Columns of the display window."""

    height: int
    """Rows of the display window."""

    channel_names: tuple[str, ...]
    """R, G, B, A first where present, the others in file order."""

    channel_types: tuple[str, ...]
    """``uint8``, ``uint16``, ``half``, ``float``, ``uint``, ... per channel."""

    attributes: dict[str, Any]
    """Every other header attribute, by OpenImageIO's name."""

    color_space: str | None
    """Color interop ID where the file tells one, such as ``lin_rec709_scene``."""


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
    with _opened(path, None) as source:
        while source.seek_subimage(len(headers), 0):
            headers.append(_header(path, source))
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
    with _opened(path, max_mb) as source:
        index, header = _seek(path, source, part)
        names = header.channel_names if channels is None else tuple(channels)
        for name in names:
            if name not in header.channel_names:
                raise ImageError(
                    f"{path}: no channel {name!r}; it has {_listed(header.channel_names)}."
                )
        order = [header.channel_names.index(name) for name in names]
        pixels = _read_channels(path, source, index, order, header.channel_types, max_mb)
        if source.format_name() == "hdr":
            pixels = _as_radiance_says(path, pixels, header.attributes)
    sample_type = header.channel_types[order[0] if order else 0]
    return Image(pixels, names, header.attributes, header.color_space, sample_type)


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
    with _opened(path, max_mb) as source:
        index, header = _seek(path, source, part)
        names = header.channel_names
        bands = spectral_channels(names)
        if not bands:
            raise ImageError(
                f"{path}: no spectral channels such as S0.550,000000nm; it has {_listed(names)}."
            )
        wavelength_nm = np.array([wavelength for wavelength, _ in bands])
        same = np.flatnonzero(np.diff(wavelength_nm) <= 0)
        if same.size:
            first, second = (bands[same[0] + i][1] for i in (0, 1))
            raise ImageError(f"{path}: channels {first} and {second} have the same wavelength.")
        order = [names.index(name) for _, name in bands]
        return wavelength_nm, _read_channels(
            path, source, index, order, header.channel_types, max_mb
        )


@contextmanager
def _opened(path: str | Path, max_mb: int | None) -> Iterator[Any]:
    """Open an image, a package member through a temporary file; map every failure."""
    package = _PACKAGE.match(str(path))
    with tempfile.TemporaryDirectory() if package else _no_folder() as folder:
        try:
            file = _extracted(package, folder, max_mb) if package else os.fspath(path)
            if not os.path.isfile(file):
                what = "it is a folder" if os.path.isdir(file) else "no such file"
                raise ImageError(f"{path}: cannot read; {what}.")
            damage = find_damage(file)
            if damage is not None:
                raise ImageError(f"{path}: cannot read; {damage}{_REMEDY}.")
            OpenImageIO.attribute("try_all_readers", 0)
            OpenImageIO.attribute("limits:imagesize_MB", max_mb or 2**30)
            as_stored = OpenImageIO.ImageSpec()
            as_stored.attribute("oiio:UnassociatedAlpha", 1)
            source = OpenImageIO.ImageInput.open(file, as_stored)
            if source is None:
                raise ImageError(f"{path}: cannot read; {_reason(OpenImageIO, file)}.")
            try:
                yield source
            finally:
                source.close()
        except (OSError, UnicodeDecodeError, MemoryError, zipfile.BadZipFile) as error:
            raise ImageError(f"{path}: cannot read; {_first_line(error)}.") from error


@contextmanager
def _no_folder() -> Iterator[str]:
    yield ""


def _extracted(package: re.Match[str], folder: str, max_mb: int | None) -> str:
    member = package["member"]
    target = os.path.join(folder, "member" + Path(member).suffix)
    # USD writes names in UTF-8 without saying so.
    with zipfile.ZipFile(package["package"], metadata_encoding="utf-8") as archive:
        try:
            info = archive.getinfo(member)
        except KeyError:
            raise ImageError(f"{package[0]}: cannot read; no such file in the package.") from None
        if max_mb is not None and info.file_size > max_mb * 2**20:
            raise ImageError(f"{package[0]}: larger than the limit of {max_mb} MiB.")
        Path(target).write_bytes(archive.read(info))
    return target


def _seek(path: str | Path, source: Any, part: int | str) -> tuple[int, ImageHeader]:
    names: list[str] = []
    while source.seek_subimage(len(names), 0):
        header = _header(path, source)
        if part in (len(names), header.name):
            return len(names), header
        names.append(header.name or str(len(names)))
    raise ImageError(f"{path}: no part {part!r}; it has {_listed(names)}.")


def _header(path: str | Path, source: Any) -> ImageHeader:
    spec = source.spec()
    if spec.deep:
        raise ImageError(f"{path}: deep images are not supported; flatten it.")
    if spec.depth > 1:
        raise ImageError(f"{path}: volume images are not supported.")
    attributes = {attribute.name: attribute.value for attribute in spec.extra_attribs}
    formats = spec.channelformats or (spec.format,) * spec.nchannels
    is_exr = source.format_name() == "openexr"
    return ImageHeader(
        name=str(attributes.get("oiio:subimagename", "")),
        width=spec.full_width if is_exr else spec.width,
        height=spec.full_height if is_exr else spec.height,
        channel_names=tuple(spec.channelnames),
        channel_types=tuple(str(kind) for kind in formats),
        attributes=attributes,
        color_space=_color_space(attributes, is_exr),
    )


def _color_space(attributes: dict[str, Any], is_exr: bool) -> str | None:
    if not is_exr:
        name = attributes.get("oiio:ColorSpace")
        return str(name) if name else None
    # OpenImageIO calls every EXR lin_rec709_scene; only what the file itself tells counts.
    if attributes.get("colorInteropID"):
        return str(attributes["colorInteropID"])
    stated = attributes.get("chromaticities")
    if stated is not None and len(stated) == 8:
        for name, known in CHROMATICITIES.items():
            if np.allclose(stated, known, rtol=0.0, atol=_CHROMATICITY_TOLERANCE):
                return name
    return None


def _read_channels(
    path: str | Path,
    source: Any,
    index: int,
    order: Sequence[int],
    types: Sequence[str],
    max_mb: int,
) -> FloatArray:
    """Read channels by position, a block of rows at a time, so that nothing is held twice."""
    spec = source.spec()
    is_exr = source.format_name() == "openexr"
    pixel_count = max(spec.width * spec.height, is_exr * spec.full_width * spec.full_height)
    need_mb = pixel_count * len(order) * 4 / 2**20
    if need_mb > max_mb:
        raise ImageError(
            f"{path}: {spec.width} x {spec.height} pixels of {len(order)} channels need "
            f"{need_mb:.0f} MiB; the limit is {max_mb} MiB."
        )
    pixels = np.empty((spec.height, spec.width, len(order)), np.float32)
    # OpenImageIO scales integers to 0..1 when asked for floats; the integers of an EXR are ids.
    asked = ["uint" if is_exr and types[channel] == "uint" else "float" for channel in order]
    chunk = spec.height if spec.tile_width else spec.get_int_attribute("oiio:RowsPerChunk", 1)
    row_count = chunk * -(-_ROWS_PER_BLOCK // chunk)
    for start in range(0, spec.height, row_count):
        rows = slice(start, min(start + row_count, spec.height))
        for kind in dict.fromkeys(asked):
            columns = [column for column, wanted in enumerate(asked) if wanted == kind]
            wanted = [order[column] for column in columns]
            first, last = min(wanted), max(wanted) + 1
            if spec.tile_width:
                block = source.read_image(index, 0, first, last, kind)
            else:
                window = (spec.y + rows.start, spec.y + rows.stop, 0)
                block = source.read_scanlines(index, 0, *window, first, last, kind)
            if block is None:
                raise ImageError(f"{path}: cannot read; {_reason(source, str(path))}.")
            block = block.reshape(rows.stop - rows.start, spec.width, last - first)
            if list(order) == list(range(first, last)):
                pixels[rows] = block
            else:
                pixels[rows, :, columns] = block[..., [channel - first for channel in wanted]]
    return _in_display_window(pixels, spec) if is_exr else pixels


def _in_display_window(pixels: FloatArray, spec: Any) -> FloatArray:
    left, top = spec.x - spec.full_x, spec.y - spec.full_y
    size = (spec.full_height, spec.full_width)
    if (left, top) == (0, 0) and size == pixels.shape[:2]:
        return pixels
    window = np.zeros((*size, pixels.shape[2]), np.float32)
    rows = slice(max(top, 0), min(top + spec.height, size[0]))
    columns = slice(max(left, 0), min(left + spec.width, size[1]))
    if rows.start < rows.stop and columns.start < columns.stop:
        window[rows, columns] = pixels[
            rows.start - top : rows.stop - top, columns.start - left : columns.stop - left
        ]
    return window


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


def _listed(names: Sequence[str], limit: int = 8) -> str:
    shown = ", ".join(repr(name) for name in names[:limit]) or "none"
    return f"{shown} and {len(names) - limit} more" if len(names) > limit else shown


def _reason(owner: Any, file: str) -> str:
    try:
        lines = owner.geterror().splitlines()
    except UnicodeDecodeError:
        lines = []
    if not lines:
        return f"it is broken or not an image{_REMEDY}"
    line = re.sub(r"^EXR Error \([^)]*\): (EXR_ERR\w* )?", "", lines[0])
    if "format reader" in line or "not the name of an image format" in line:
        return "not an image of a known format; convert it to EXR, TIFF or PNG"
    # OpenEXR tells the magic number and flags, libraries the file's name: neither helps.
    line = re.sub(r": magic 0x.*", "", line)
    reason = line.replace(f' "{file}"', "").replace(file, "file").rstrip(". ")
    return f"{reason}; make it smaller" if _TOO_LARGE.search(reason) else f"{reason}{_REMEDY}"


def _first_line(error: BaseException) -> str:
    if isinstance(error, UnicodeDecodeError):
        return "the header holds text that is not UTF-8"
    if isinstance(error, MemoryError):
        return "not enough memory"
    text = getattr(error, "strerror", None) or str(error)
    return text.splitlines()[0] if text else type(error).__name__
