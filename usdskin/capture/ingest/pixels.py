"""A first look at the pixels of a photograph: is it whole, how much is saturated, a thumbnail."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.ingest.exif import Photo, import_rawpy, raw_reason
from usdskin.errors import ImageError
from usdskin.photographs.frames import open_frame

SATURATED = 0.97
"""Share of the way from black to white at which the merge takes a pixel for saturated."""

_THUMBNAIL_PX = 512
_ROWS_AT_ONCE = 64


@dataclass(frozen=True, slots=True, eq=False)
class Look:
    """What the pixels of a photograph tell at first sight."""

    saturated: int
    """Pixels of which a channel is saturated."""

    pixels: int
    """All pixels."""

    largest: float
    """Largest raw value [DN]."""

    largest_share: float
    """Share of pixels that have it [1]."""

    full_scale: float
    """Raw value at saturation: what was given, or what the file says [DN]."""

    thumbnail: NDArray[np.float32]
    """Means of square cells, in shares of ``full_scale`` [1], shape [rows, columns]."""

    cell_px: int
    """Side of a cell [px]."""


def look_at(
    photo: Photo, scratch: Path, black: float | None = None, white: float | None = None
) -> Look:
    """Read all pixels of a photograph once, in the memory of a block of rows.

    Args:
        photo: The photograph. The mosaic of a raw file is looked at as it is.
        scratch: Folder for temporary files.
        black: Raw value without light [DN]; None: what the file says.
        white: Raw value at saturation [DN]; None: what the file says.

    Raises:
        ImageError: The file is damaged anywhere, or holds values that are no numbers.
    """
    if photo.sample_type == "raw":
        return _look_at_mosaic(photo, black, white)
    with open_frame(photo.path, scratch) as frame:
        top = frame.full_scale if white is None else white
        read = lambda begin, end: frame.rows(begin, end).max(axis=-1)  # noqa: E731
        return _look(read, (frame.width, frame.height), 0.0 if black is None else black, top)


def _look_at_mosaic(photo: Photo, black: float | None, white: float | None) -> Look:
    rawpy = import_rawpy(photo.path)
    try:
        with rawpy.imread(str(photo.path)) as raw:
            mosaic = raw.raw_image_visible
            levels = [raw.white_level, *(raw.camera_white_level_per_channel or ())]
            top = float(min(level for level in levels if level > 0)) if white is None else white
            least = float(np.mean(raw.black_level_per_channel)) if black is None else black
            if mosaic.ndim == 3:
                mosaic = mosaic[..., :3].max(axis=-1)
            size = (mosaic.shape[1], mosaic.shape[0])
            return _look(lambda a, b: mosaic[a:b].astype(np.float32), size, least, top)
    except rawpy.LibRawError as error:
        raise ImageError(f"{photo.path}: cannot read; {raw_reason(error)}") from None


def _look(
    read: Callable[[int, int], NDArray[np.float32]],
    size: tuple[int, int],
    black: float,
    white: float,
) -> Look:
    width, height = size
    cell = max(1, -(-max(size) // _THUMBNAIL_PX))
    step = cell * -(-_ROWS_AT_ONCE // cell)
    limit = black + SATURATED * (white - black)
    saturated, largest, largest_count = 0, -np.inf, 0
    strips = []
    for begin in range(0, height, step):
        rows = read(begin, min(begin + step, height))
        saturated += int(np.count_nonzero(rows >= limit))
        top = float(rows.max())
        if top > largest:
            largest, largest_count = top, 0
        largest_count += int(np.count_nonzero(rows == largest))
        whole = rows[: len(rows) // cell * cell, : width // cell * cell]
        cells = whole.reshape(len(whole) // cell, cell, width // cell, cell)
        strips.append(cells.mean(axis=(1, 3)) / np.float32(white))
    return Look(
        saturated=saturated,
        pixels=width * height,
        largest=largest,
        largest_share=largest_count / (width * height),
        full_scale=white,
        thumbnail=np.concatenate(strips),
        cell_px=cell,
    )
