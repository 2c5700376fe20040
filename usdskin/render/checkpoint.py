"""What a picture has finished so far, kept beside it so that an interrupted render can go on.

A tile's pixels depend on nothing but the tile, so tiles read back and tiles rendered make the same
picture. They lie in ``<file>.partial``: a line of JSON, then one record after another, each with a
checksum; a record that an interruption cut short is dropped. The line holds a hash of everything
the picture is made from, and a file with another one is never used.
"""

from __future__ import annotations

import hashlib
import json
import struct
import threading
import time
import zlib
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, fields, is_dataclass
from enum import Enum
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import __version__
from usdskin.notes import Note

KEEP_EVERY_S = 30.0
"""Time between writes [s], and how long a picture must have taken before any is kept."""

_FORMAT = "usdskin partial picture 1"
_HEADER_LIMIT = 65536
_RECORD = struct.Struct("<4sQQQI")
"""Magic, first pixel, one past the last, payload's size [B], its CRC-32."""
_MAGIC = b"TILE"

Arrays = Mapping[str, NDArray[Any]]
"""Arrays of a whole picture by name; the first axis runs over its pixels, row after row."""


def partial_path(file: Path) -> Path:
    """Return where the finished part of a picture is kept."""
    return file.with_name(f"{file.name}.partial")


def fingerprint(*inputs: object) -> str:
    """Return a hash of values: numbers, text, arrays, and dataclasses and collections of them.

    The versions of usdskin and Warp are part of it.
    """
    seen = hashlib.blake2b(f"{__version__} {wp.config.version}".encode(), digest_size=32)
    _feed(seen, inputs)
    return seen.hexdigest()


def _feed(seen: Any, value: object) -> None:
    if isinstance(value, np.ndarray):
        seen.update(f"{value.dtype.str}{value.shape}".encode())
        seen.update(np.ascontiguousarray(value).view(np.uint8).data)
    elif is_dataclass(value) and not isinstance(value, type):
        seen.update(f"{type(value).__name__}(".encode())
        for entry in fields(value):
            seen.update(f"{entry.name}=".encode())
            _feed(seen, getattr(value, entry.name))
    elif isinstance(value, Mapping):
        seen.update(f"map{len(value)}".encode())
        for key in sorted(value, key=repr):
            _feed(seen, key)
            _feed(seen, value[key])
    elif isinstance(value, list | tuple):
        seen.update(f"row{len(value)}".encode())
        for item in value:
            _feed(seen, item)
    elif isinstance(value, set | frozenset):
        _feed(seen, sorted(value, key=repr))
    elif value is None or isinstance(value, str | int | float | Enum | Path | np.generic):
        seen.update(f"{value!r};".encode())
    else:
        raise TypeError(f"no fingerprint of a {type(value).__name__}")


@dataclass(slots=True)
class Checkpoint:
    """Keeps the tiles of one picture while it is rendered, and shows them."""

    file: Path
    """The picture."""

    key: Callable[[], str]
    """Gives the hash of what the picture is made from; asked once, when it is needed."""

    notes: list[Note]
    """Takes what was not resumed or could not be kept."""

    resume: bool = False
    """Go on where a partial file ends, and leave one whenever the render is interrupted."""

    interval_s: float = KEEP_EVERY_S
    preview: Callable[[Path, Arrays], None] | None = None
    """Writes a picture of what is finished, every ``interval_s``."""

    clock: Callable[[], float] = time.monotonic

    @property
    def path(self) -> Path:
        """The partial file."""
        return partial_path(self.file)

    @property
    def snapshot(self) -> Path:
        """The preview of the unfinished picture."""
        return self.file.with_name(f"{self.file.name}.snapshot.png")

    @contextmanager
    def tiles(self, arrays: Arrays) -> Iterator[Tiles]:
        """Give the tiles of a picture; what an interruption leaves of them is kept.

        Args:
            arrays: All that the tiles compute; those finished earlier are read into them.
        """
        tiles = Tiles(self, arrays)
        try:
            tiles.read()
            yield tiles
        except BaseException as error:
            if tiles.keep_rest():
                error.add_note(f"What is finished is kept in {self.path}; go on with --resume.")
            raise
        finally:
            tiles.close()

    def remove(self) -> None:
        """Remove what was kept and shown: the picture is there."""
        for path in (self.path, self.snapshot):
            with suppress(OSError):
                path.unlink(missing_ok=True)


class _NoTiles:
    """The tiles of a picture that is not kept."""

    def restored(self, _begin: int, _end: int) -> bool:
        """Return that they are still to be rendered."""
        return False

    def finished(self, _begin: int, _end: int) -> None:
        """Ignore them."""


@contextmanager
def keeping(checkpoint: Checkpoint | None, arrays: Arrays) -> Iterator[Tiles | _NoTiles]:
    """Give the tiles of a picture; without a checkpoint nothing is kept.

    Args:
        checkpoint: Where to keep them.
        arrays: All that the tiles compute; those finished earlier are read into them.
    """
    if checkpoint is None:
        yield _NoTiles()
    else:
        with checkpoint.tiles(arrays) as tiles:
            yield tiles


class Tiles:
    """The tiles of one picture. Any thread may ask and tell."""

    def __init__(self, checkpoint: Checkpoint, arrays: Arrays) -> None:
        """Begin a picture none of whose tiles is finished."""
        self._checkpoint = checkpoint
        self._arrays = dict(sorted(arrays.items()))
        self._count = len(next(iter(arrays.values())))
        self._kept: list[tuple[int, int]] = []
        self._fresh: list[tuple[int, int]] = []
        self._telling, self._writing = threading.Lock(), threading.Lock()
        self._begun = self._last = checkpoint.clock()
        self._file: BinaryIO | None = None
        self._failed = False

    def restored(self, begin: int, end: int) -> bool:
        """Return whether pixels ``begin`` to ``end`` were finished before."""
        return any(first <= begin and end <= last for first, last in self._kept)

    def finished(self, begin: int, end: int) -> None:
        """Tell that pixels ``begin`` to ``end`` are in the arrays."""
        with self._telling:
            self._fresh.append((begin, end))
        due = self._checkpoint.clock() - self._last >= self._checkpoint.interval_s
        if due and self._writing.acquire(blocking=False):
            try:
                self._write_fresh()
                if self._checkpoint.preview is not None:
                    self._checkpoint.preview(self._checkpoint.snapshot, self._arrays)
                self._last = self._checkpoint.clock()
            finally:
                self._writing.release()

    def keep_rest(self) -> bool:
        """Keep what an interrupted render finished; return whether there is something to resume."""
        long = self._checkpoint.clock() - self._begun >= self._checkpoint.interval_s
        if self._checkpoint.resume or self._file is not None or long:
            with self._writing:
                self._write_fresh()
        return self._file is not None

    def close(self) -> None:
        """Close the file."""
        if self._file is not None:
            self._file.close()

    def read(self) -> None:
        """Read what an earlier render finished, where it is of this picture."""
        path = self._checkpoint.path
        if not self._checkpoint.resume or not path.exists():
            return
        try:
            file = open(path, "r+b")
        except OSError as error:
            self._note("partial-not-used", f"cannot be read ({error.strerror}); rendering anew.")
            return
        if file.readline(_HEADER_LIMIT) != self._header():
            file.close()
            self._note(
                "partial-not-used",
                "is of other settings, another stage or another version; rendering anew.",
            )
            return
        end = file.tell()
        while (tile := self._read_record(file)) is not None:
            self._kept.append(tile)
            end = file.tell()
        file.seek(end)
        file.truncate()
        self._file = file

    def _read_record(self, file: BinaryIO) -> tuple[int, int] | None:
        """Read the next tile into the arrays; None at the end, or where the file is broken."""
        head = file.read(_RECORD.size)
        if len(head) < _RECORD.size:
            return None
        magic, begin, end, size, checksum = _RECORD.unpack(head)
        if magic != _MAGIC or not begin < end <= self._count or size != self._size(begin, end):
            return None
        payload = file.read(size)
        if len(payload) < size or zlib.crc32(payload) != checksum:
            return None
        at = 0
        for values in self._arrays.values():
            part = values[begin:end]
            part[...] = np.frombuffer(payload, values.dtype, part.size, at).reshape(part.shape)
            at += part.nbytes
        return begin, end

    def _write_fresh(self) -> None:
        with self._telling:
            fresh, self._fresh = self._fresh, []
        if self._failed or not fresh:
            return
        try:
            if self._file is None:
                self._file = open(self._checkpoint.path, "wb")
                self._file.write(self._header())
            for begin, end in fresh:
                parts = [values[begin:end].tobytes() for values in self._arrays.values()]
                payload = b"".join(parts)
                head = (_MAGIC, begin, end, len(payload), zlib.crc32(payload))
                self._file.write(_RECORD.pack(*head))
                self._file.write(payload)
            self._file.flush()
        except OSError as error:
            self._failed = True
            self._note(
                "partial-not-kept",
                f"cannot be written ({error.strerror}); the render goes on and cannot be resumed.",
            )

    def _header(self) -> bytes:
        kinds = {name: f"{values.dtype.str}{values.shape}" for name, values in self._arrays.items()}
        line = {"format": _FORMAT, "made from": self._checkpoint.key(), "arrays": kinds}
        return json.dumps(line).encode() + b"\n"

    def _size(self, begin: int, end: int) -> int:
        return sum(values[begin:end].nbytes for values in self._arrays.values())

    def _note(self, code: str, message: str) -> None:
        self._checkpoint.notes.append(Note(code, str(self._checkpoint.path), message))
