"""Write EXR files a block of rows at a time, atomically, in the memory of one block.

Every write goes to a temporary file in the destination folder, is flushed to disk and then
renamed, so a reader sees the old file or the new one and nothing in between.

OpenImageIO writes the files, not the OpenEXR module: the latter needs whole pictures, one
contiguous array per channel (a strided view is written as if it were contiguous).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import OpenImageIO
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.replacing import replacing

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
class Raster:
    """One part of an EXR file, without its pixels."""

    width: int
    """Columns."""

    height: int
    """Rows."""

    channel_names: Sequence[str]
    """Shape [channel_count]."""

    sample_type: str = "float"
    """``half``, ``float`` or ``uint``; finite values beyond the range of half are clipped to it."""

    color_space: str = "data"
    """Color interop ID of the pixels."""

    attributes: Mapping[str, Any] = field(default_factory=dict)
    """Header attributes: text, numbers, a 4x4 matrix; anything else is written as text."""

    pixel_aspect_ratio: float = 1.0
    """Width over height of a pixel."""

    origin: tuple[int, int] = (0, 0)
    """Column and row of the first pixel in the display window."""

    display_size: tuple[int, int] | None = None
    """Width and height of the display window; the pixels' own where ``None``."""

    @property
    def rows_per_block(self) -> int:
        """Rows to be written at a time: whole chunks of zip, in little memory."""
        row_bytes = 4 * self.width * len(self.channel_names)
        many = row_bytes * _ROWS_PER_BLOCK <= _BLOCK_BYTES
        return _ROWS_PER_BLOCK if many else _ROWS_PER_CHUNK


class RowWriter:
    """Takes the rows of one part, from the top to the bottom."""

    def __init__(self, path: str | Path, temporary: str, output: Any, raster: Raster) -> None:
        """Set up the part; ``open_exr_parts`` opens it.

        Args:
            path: The file, for errors.
            temporary: Its name while it is written.
            output: OpenImageIO's writer.
            raster: The part.
        """
        self.raster = raster
        self._path, self._temporary, self._output = path, temporary, output
        self._next = 0

    @property
    def is_complete(self) -> bool:
        """Whether all rows were written."""
        return self._next == self.raster.height

    def write(self, begin: int, block: NDArray[Any]) -> None:
        """Write rows, those that follow the rows written before.

        Args:
            begin: The first of them.
            block: Shape [row_count, width, channel_count]; integers where the samples are ``uint``.

        Raises:
            ImageError: The disk is full, or the file cannot be written for another reason.
        """
        raster = self.raster
        end = begin + block.shape[0]
        shape = (end - begin, raster.width, len(raster.channel_names))
        if begin != self._next or end > raster.height or block.shape != shape:
            raise ValueError(f"rows {begin} to {end} of shape {block.shape}, not {self._next} on")
        is_uint = raster.sample_type == "uint"
        if is_uint and block.dtype.kind not in "ui":
            raise ValueError("uint samples need integer pixels")
        pixels = np.ascontiguousarray(block, np.uint32 if is_uint else np.float32)
        if raster.sample_type == "half":
            finite = np.isfinite(pixels)
            pixels = np.clip(pixels, -HALF_MAX, HALF_MAX, out=pixels.copy(), where=finite)
        top = raster.origin[1]
        if not self._output.write_scanlines(top + begin, top + end, 0, pixels):
            raise ImageError(
                f"{self._path}: cannot write; {_reason(self._output, self._temporary)}."
            )
        self._next = end


@contextmanager
def open_exr_writer(
    path: str | Path,
    width: int,
    height: int,
    channel_names: Sequence[str],
    *,
    sample_type: str = "float",
    attributes: Mapping[str, Any] | None = None,
    color_space: str = "data",
    compression: str = "zip",
) -> Iterator[RowWriter]:
    """Open a single-part EXR file to write its rows in order; the same rows give the same bytes.

    Args:
        path: File to write. It appears when the block ends well and all rows are there.
        width: Columns.
        height: Rows.
        channel_names: Names of the channels, in the order of the blocks' last axis.
        sample_type: ``half``, ``float`` or ``uint``.
        attributes: Header attributes.
        color_space: Color interop ID of the pixels.
        compression: ``none``, ``zips``, ``zip``, ``piz``, ``dwaa``, ..., with ``:level``.

    Raises:
        ImageError: The file cannot be written; nothing is left behind.
    """
    raster = Raster(width, height, channel_names, sample_type, color_space, attributes or {})
    with open_exr_parts(path, [raster], compression) as writers:
        yield next(writers)


@contextmanager
def open_exr_parts(
    path: str | Path, rasters: Sequence[Raster], compression: str = "zip"
) -> Iterator[Iterator[RowWriter]]:
    """Open an EXR file to write its parts one after another.

    Args:
        path: File to write.
        rasters: Its parts.
        compression: As for ``open_exr_writer``.

    Yields:
        A writer for each part, to be given all its rows before the next is taken.

    Raises:
        ImageError: The file cannot be written; nothing is left behind.
    """
    if Path(path).suffix.lower() != ".exr":
        # OpenImageIO would write a JPEG for a name that ends in .jpg.
        raise ImageError(f"{path}: cannot write; the name must end in .exr.")
    if compression.split(":")[0] not in _COMPRESSIONS:
        # OpenImageIO would take zip for a name it does not know.
        raise ImageError(f"{path}: no EXR compression {compression!r}; use none, zips, zip, piz.")
    specs = _specs(rasters, compression)
    with replacing(path) as temporary:
        output = OpenImageIO.ImageOutput.create(temporary)
        if output is None:
            raise ImageError(f"{path}: cannot write; {_reason(OpenImageIO, temporary)}.")
        writers = [RowWriter(path, temporary, output, raster) for raster in rasters]

        def in_order() -> Iterator[RowWriter]:
            for index, (spec, writer) in enumerate(zip(specs, writers, strict=True)):
                first = output.open(temporary, specs) if index == 0 else True
                more = output.open(temporary, spec, "AppendSubimage") if index else True
                if not (first and more):
                    raise ImageError(f"{path}: cannot write; {_reason(output, temporary)}.")
                yield writer

        try:
            yield in_order()
        finally:
            closed = output.close()
        if not all(writer.is_complete for writer in writers):
            raise ValueError(f"{path}: not all rows were written")
        if not (closed and _is_complete(temporary)):
            raise ImageError(f"{path}: cannot write; {_reason(output, temporary)}.")


def _specs(rasters: Sequence[Raster], compression: str) -> list[Any]:
    specs: list[Any] = []
    for raster in rasters:
        names = tuple(raster.channel_names)
        spec = OpenImageIO.ImageSpec(raster.width, raster.height, len(names), raster.sample_type)
        spec.channelnames = names
        spec.x, spec.y = raster.origin
        spec.full_width, spec.full_height = raster.display_size or (raster.width, raster.height)
        # Without a DateTime of ours OpenImageIO stamps the hour, and no file comes out twice alike.
        _set_attributes(spec, {"DateTime": "", **raster.attributes})
        spec.attribute("PixelAspectRatio", float(raster.pixel_aspect_ratio))
        spec.attribute("compression", compression)
        spec.attribute("colorInteropID", raster.color_space)
        # All parts share one set of chromaticities (OpenEXR's rule); the first part tells it.
        if not specs and raster.color_space in CHROMATICITIES:
            spec.attribute("chromaticities", "float[8]", CHROMATICITIES[raster.color_space])
        specs.append(spec)
    return specs


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
