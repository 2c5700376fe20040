"""Read a picture a block of rows at a time, in order, in the memory of one block."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.image_files import ImageHeader, listed, opened, reason, seek

_TALLEST_CHUNK = 512  # rows; taller strips are decoded in order and never held whole


class RowReader:
    """One part of an opened image file; see ``open_rows``."""

    def __init__(
        self,
        path: str | Path,
        source: Any,
        place: tuple[int, ImageHeader],
        channels: Sequence[str] | None,
        max_mb: int,
        as_stored: bool = False,
    ) -> None:
        """Read a part of an image opened by ``image_files.opened``.

        Args:
            path: The file, for errors.
            source: The opened image.
            place: What ``image_files.seek`` returned.
            channels: See ``open_rows``.
            max_mb: See ``open_rows``.
            as_stored: See ``open_rows``.
        """
        self._path, self._source = path, source
        self.format_name = str(source.format_name())
        """OpenImageIO's name of the format: ``openexr``, ``tiff``, ...; ``hdr`` is Radiance."""
        self._index, self.header = place
        """Header of the part."""
        self.channel_names = self.header.channel_names if channels is None else tuple(channels)
        """The channels that are read, in the order of the columns."""
        for name in self.channel_names:
            if name not in self.header.channel_names:
                raise ImageError(
                    f"{path}: no channel {name!r}; it has {listed(self.header.channel_names)}."
                )
        self._spec = source.spec()
        self._order = [self.header.channel_names.index(name) for name in self.channel_names]
        types = [self.header.channel_types[channel] for channel in self._order]
        self.sample_type = types[0] if types else self.header.channel_types[0]
        """Type of the first of the channels in the file: ``uint8``, ``half``, ..."""
        is_exr = self.format_name == "openexr"
        unscaled = as_stored and self.sample_type in ("uint8", "uint16")
        # OpenImageIO scales integers to 0..1 when asked for floats; those of an EXR are ids.
        self._asked = [
            self.sample_type if unscaled else "uint" if is_exr and kind == "uint" else "float"
            for kind in types
        ]
        self.dtype = np.dtype(self.sample_type if unscaled else "float32")
        """Type of the rows."""
        spec = self._spec
        self._top = int(spec.y - spec.full_y) if is_exr else 0
        self._left = int(spec.x - spec.full_x) if is_exr else 0
        chunk = spec.tile_height or spec.get_int_attribute("oiio:RowsPerChunk", 1)
        self._chunk = chunk if spec.tile_height or chunk <= _TALLEST_CHUNK else 1
        self._kept_from, self._kept = 0, np.empty((0, spec.width, len(self._order)), self.dtype)
        self._refuse_large(max_mb)

    def _refuse_large(self, max_mb: int) -> None:
        width, height = self._spec.width, self._spec.height
        pixel_count = max(width * height, self.header.width * self.header.height)
        need_mb = pixel_count * len(self._order) * 4 / 2**20
        if need_mb > max_mb:
            raise ImageError(
                f"{self._path}: {width} x {height} pixels of {len(self._order)} channels need "
                f"{need_mb:.0f} MiB; the limit is {max_mb} MiB."
            )

    def rows(self, begin: int, end: int) -> NDArray[Any]:
        """Return rows of the display window, shape [end - begin, width, channel_count].

        Pixels outside the data window are 0. Reading goes on from the rows before without
        decoding anything twice; going back is allowed, and slow in files that can only be read in
        order.

        Raises:
            ImageError: The file is broken.
        """
        spec = self._spec
        first, last = (min(max(row - self._top, 0), spec.height) for row in (begin, end))
        whole = (self._top, self._left, spec.width) == (0, 0, self.header.width)
        if whole and last - first == end - begin:
            return self._data_rows(first, last)
        block = np.zeros((end - begin, self.header.width, len(self._order)), self.dtype)
        left, right = max(self._left, 0), min(self._left + spec.width, self.header.width)
        if first < last and left < right:
            start = first + self._top - begin
            block[start : start + last - first, left:right] = self._data_rows(first, last)[
                :, left - self._left : right - self._left
            ]
        return block

    def _data_rows(self, begin: int, end: int) -> NDArray[Any]:
        """Return rows of the data window; of the last chunk keep what was not asked for."""
        kept_end = self._kept_from + len(self._kept)
        parts = []
        if self._kept_from <= begin < kept_end:
            parts.append(self._kept[begin - self._kept_from : end - self._kept_from])
            start = kept_end
        else:
            start = begin // self._chunk * self._chunk
        stop = min(-(-end // self._chunk) * self._chunk, self._spec.height)
        if start < end:
            block = self._decode(start, stop)
            parts.append(block[max(begin - start, 0) : end - start])
            self._kept_from, self._kept = end, block[end - start :].copy()
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _decode(self, begin: int, end: int) -> NDArray[Any]:
        spec, order = self._spec, self._order
        pixels = np.empty((end - begin, spec.width, len(order)), self.dtype)
        for kind in dict.fromkeys(self._asked):
            columns = [column for column, wanted in enumerate(self._asked) if wanted == kind]
            wanted = [order[column] for column in columns]
            first, last = min(wanted), max(wanted) + 1
            window = (spec.y + begin, spec.y + end, 0)
            if spec.tile_width:
                across = (spec.x, spec.x + spec.width)
                block = self._source.read_tiles(
                    self._index, 0, *across, *window[:2], 0, 1, first, last, kind
                )
            else:
                block = self._source.read_scanlines(self._index, 0, *window, first, last, kind)
            if block is None:
                raise ImageError(
                    f"{self._path}: cannot read; {reason(self._source, str(self._path))}."
                )
            block = block.reshape(end - begin, spec.width, last - first)
            if order == list(range(first, last)):
                return np.asarray(block, self.dtype)
            pixels[..., columns] = block[..., [channel - first for channel in wanted]]
        return pixels


@contextmanager
def open_rows(
    path: str | Path,
    max_mb: int = 2048,
    *,
    part: int | str = 0,
    channels: Sequence[str] | None = None,
    as_stored: bool = False,
) -> Iterator[RowReader]:
    """Open an image file to read its rows in order.

    Rows are as the file stores them: neither a Radiance file's exposure nor an orientation tag is
    applied.

    Args:
        path: The file, or ``package.usdz[member]``.
        max_mb: Refuse pictures that would need more memory than this when whole [MiB].
        part: Index or name of the part of a multi-part EXR.
        channels: Read these channels only, in this order; all of them where ``None``.
        as_stored: Give integers of 8 and 16 bits as they are. All other rows are float32, integers
            scaled to 0..1, but the unsigned ones of an EXR (ids) keep their value.

    Raises:
        ImageError: The file is missing, broken, too large, no image, or lacks the part or channel.
    """
    with opened(path, max_mb) as source:
        yield RowReader(path, source, seek(path, source, part), channels, max_mb, as_stored)
