"""Open an image file as if a stranger wrote it, and say in one line why it cannot be read."""

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

from usdskin.errors import ImageError
from usdskin.image_damage import find_damage
from usdskin.image_output import CHROMATICITIES

_PACKAGE = re.compile(r"^(?P<package>.*\.usdz)\[(?P<member>[^\[\]]+)\]$", re.IGNORECASE)
_REMEDY = "; restore a good copy or export it again"
_TOO_LARGE = re.compile(r"exceeds the \d+ MB limit")
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


@contextmanager
def opened(path: str | Path, max_mb: int | None) -> Iterator[Any]:
    """Open an image, a package member through a temporary file; map every failure.

    Args:
        path: The file, or ``package.usdz[member]``.
        max_mb: Refuse pictures that need more memory than this [MiB].

    Yields:
        An ``OpenImageIO.ImageInput`` that keeps alpha as stored.

    Raises:
        ImageError: The file is missing, damaged, too large or no image.
    """
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
                raise ImageError(f"{path}: cannot read; {reason(OpenImageIO, file)}.")
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


def seek(path: str | Path, source: Any, part: int | str) -> tuple[int, ImageHeader]:
    """Go to a part of an opened image; return its index and header.

    Raises:
        ImageError: There is no such part, or it is deep or a volume.
    """
    names: list[str] = []
    while source.seek_subimage(len(names), 0):
        header = read_header(path, source)
        if part in (len(names), header.name):
            return len(names), header
        names.append(header.name or str(len(names)))
    raise ImageError(f"{path}: no part {part!r}; it has {listed(names)}.")


def read_header(path: str | Path, source: Any) -> ImageHeader:
    """Return the header of the part an opened image is at.

    Raises:
        ImageError: It is deep or a volume.
    """
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


def listed(names: Sequence[str], limit: int = 8) -> str:
    """Return names as they stand in a message, the first few of many."""
    shown = ", ".join(repr(name) for name in names[:limit]) or "none"
    return f"{shown} and {len(names) - limit} more" if len(names) > limit else shown


def reason(owner: Any, file: str) -> str:
    """Return why OpenImageIO failed, and what to do, without the noise.

    Args:
        owner: What failed: an ``ImageInput``, or the module itself where none was opened.
        file: Name of the file, which the messages need not repeat.
    """
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
    said = line.replace(f' "{file}"', "").replace(file, "file").rstrip(". ")
    return f"{said}; make it smaller" if _TOO_LARGE.search(said) else f"{said}{_REMEDY}"


def _first_line(error: BaseException) -> str:
    if isinstance(error, UnicodeDecodeError):
        return "the header holds text that is not UTF-8"
    if isinstance(error, MemoryError):
        return "not enough memory"
    text = getattr(error, "strerror", None) or str(error)
    return text.splitlines()[0] if text else type(error).__name__
