"""Statements of an OBJ file as numpy arrays: millions of lines without a loop over them."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import MeshError

OTHER, VERTEX, TEXTURE, NORMAL, FACE, NAMING = range(6)
"""Kinds of statements; ``OTHER`` also holds empty lines."""

_WHOLE = re.compile(rb"[+-]?\d{1,18}")
_NUMBER = re.compile(rb"(?i)[+-]?(\d+\.?\d*(e[+-]?\d+)?|\.\d+(e[+-]?\d+)?|nan|inf(inity)?)")

_KEYWORDS = {b"v": VERTEX, b"vt": TEXTURE, b"vn": NORMAL, b"f": FACE}
_NAMING = (b"g", b"o", b"s", b"usemtl", b"mtllib")
_LINE_FEED, _RETURN, _SPACE, _HASH, _BACKSLASH, _SLASH = b"\n\r #\\/"


@dataclass(frozen=True, slots=True, eq=False)
class Statements:
    """The logical lines of a file: continued lines joined, comments blanked."""

    path: Path
    """The file."""

    text: NDArray[np.uint8]
    """The characters; keywords of the numeric statements are blanked, shape [size]."""

    start: NDArray[np.int64]
    """First character of each line, shape [line_count]."""

    stop: NDArray[np.int64]
    """One past the last character of each line, shape [line_count]."""

    number: NDArray[np.int64]
    """Line number in the file, from 1, shape [line_count]."""

    kind: NDArray[np.uint8]
    """Kind of each line, shape [line_count]."""

    tokens: NDArray[np.int64]
    """Words on each line, keywords of the numeric statements not counted, shape [line_count]."""

    def of(self, kind: int) -> NDArray[np.int64]:
        """Return the lines of one kind."""
        return np.flatnonzero(self.kind == kind)

    def line(self, index: int) -> bytes:
        """Return the text of a line."""
        return bytes(self.text[self.start[index] : self.stop[index]].data)

    def gather(self, lines: NDArray[np.int64]) -> bytes:
        """Return the text of some lines, one after another."""
        chosen = np.zeros(len(self.start), dtype=bool)
        chosen[lines] = True
        return bytes(self.text[np.repeat(chosen, self.stop - self.start)].data)

    def count(self, held: NDArray[np.bool_], lines: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return for how many characters of each of some lines a flag holds."""
        line = np.searchsorted(self.stop, np.flatnonzero(held), side="right")
        counted: NDArray[np.int64] = np.bincount(line, minlength=len(self.stop))[lines]
        return counted

    def numbers(
        self, lines: NDArray[np.int64], dtype: type, count: int, text: bytes = b""
    ) -> NDArray[Any]:
        """Return the numbers on some lines, one after another.

        Args:
            lines: Lines that hold nothing but numbers.
            dtype: float64 or int64.
            count: How many there must be.
            text: Their text where it is not ``gather(lines)``.

        Raises:
            MeshError: A word is no such number; the message names the line.
        """
        if not count:
            return np.zeros(0, dtype=dtype)
        try:
            with warnings.catch_warnings():
                # Older numpy warns of a word that is no number, where newer raises.
                warnings.simplefilter("error", DeprecationWarning)
                found: NDArray[Any] = np.fromstring(
                    text or self.gather(lines), dtype=dtype, sep=" "
                )
        except (ValueError, DeprecationWarning):
            raise self._bad_word(lines, dtype) from None
        # "1-2" is one word, and two numbers to numpy.
        if len(found) != count:
            raise self._bad_word(lines, dtype)
        return found

    def _bad_word(self, lines: NDArray[np.int64], dtype: type) -> MeshError:
        whole = dtype is np.int64
        pattern = _WHOLE if whole else _NUMBER
        for index in lines:
            line = self.line(int(index))
            for word in (line.replace(b"/", b" ") if whole else line).split():
                if not pattern.fullmatch(word):
                    shown = word[:20].decode("utf-8", "replace")
                    what = "a whole number" if whole else "a number"
                    return self.error(int(index), f"{shown!r} is not {what}")
        return self.error(int(lines[0]), "the numbers from here on cannot be read")

    def error(self, index: int, problem: str) -> MeshError:
        """Return an error that names the file and the line."""
        return MeshError(
            f"{self.path}:{int(self.number[index])}: {problem}; repair the file or export it again"
        )


def read_statements(path: Path) -> Statements:
    """Read a text file and find its statements.

    Raises:
        MeshError: The file is missing, empty or not a text.
    """
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise MeshError(f"{path}: cannot be read ({error.strerror}); check the name") from None
    if raw.startswith(b"\xef\xbb\xbf"):
        raw = raw[3:]
    if not raw.strip():
        raise MeshError(f"{path}: is empty; export the mesh again")
    if b"\0" in raw:
        raise MeshError(f"{path}: is not a text file, so no OBJ; export the mesh again")
    if b"\n" not in raw and b"\r" in raw:
        raw = raw.replace(b"\r", b"\n")
    text = np.frombuffer(raw + b"\n", dtype=np.uint8).copy()
    return _split(path, text)


def _split(path: Path, text: NDArray[np.uint8]) -> Statements:
    feeds = np.flatnonzero(text == _LINE_FEED)
    _blank_comments(text, feeds)
    text[text == _RETURN] = _SPACE
    text[text == ord("\t")] = _SPACE
    joined = _blank_continuations(text, feeds)
    number = np.concatenate([[1], 2 + np.flatnonzero(~joined)[:-1]])
    stop = feeds[~joined] + 1
    start = np.concatenate([[0], stop[:-1]])

    printed = (text != _SPACE) & (text != _LINE_FEED)
    begins = printed.copy()
    begins[1:] &= ~printed[:-1]
    word_starts = np.flatnonzero(begins)
    line_of_word = np.searchsorted(stop, word_starts, side="right")
    tokens = np.bincount(line_of_word, minlength=len(start)).astype(np.int64)
    first_word = np.searchsorted(word_starts, start)
    kind = _classify(text, start, tokens, word_starts, first_word)
    numeric = (kind >= VERTEX) & (kind <= FACE)
    for offset in (0, 1):
        wide = numeric & ((kind == TEXTURE) | (kind == NORMAL)) if offset else numeric
        text[word_starts[first_word[wide]] + offset] = _SPACE
    return Statements(path, text, start, stop, number, kind, tokens - numeric)


def _classify(
    text: NDArray[np.uint8],
    start: NDArray[np.int64],
    tokens: NDArray[np.int64],
    word_starts: NDArray[np.int64],
    first_word: NDArray[np.int64],
) -> NDArray[np.uint8]:
    kind = np.zeros(len(start), dtype=np.uint8)
    filled = np.flatnonzero(tokens)
    where = word_starts[first_word[filled]]
    last = len(text) - 1
    letters = np.stack([text[np.minimum(where + i, last)] for i in range(7)], axis=1)
    ends = (letters == _SPACE) | (letters == _LINE_FEED)
    for keyword, value in [*_KEYWORDS.items(), *((name, NAMING) for name in _NAMING)]:
        width = len(keyword)
        same = (letters[:, :width] == np.frombuffer(keyword, np.uint8)).all(axis=1)
        kind[filled[same & ends[:, width]]] = value
    return kind


def _blank_comments(text: NDArray[np.uint8], feeds: NDArray[np.int64]) -> None:
    hashes = np.flatnonzero(text == _HASH)
    line = np.searchsorted(feeds, hashes)
    first = np.ones(len(hashes), dtype=bool)
    first[1:] = line[1:] != line[:-1]
    for begin, end in zip(hashes[first], feeds[line[first]], strict=True):
        text[begin:end] = _SPACE


def _blank_continuations(text: NDArray[np.uint8], feeds: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Blank the ends of continued lines and return which line feeds they were."""
    joined = np.zeros(len(feeds), dtype=bool)
    for position in np.flatnonzero(text == _BACKSLASH):
        feed = int(np.searchsorted(feeds, position))
        end = feeds[feed]
        # The last line has nothing to go on with.
        if feed + 1 < len(feeds) and not (text[position + 1 : end] != _SPACE).any():
            text[position : end + 1] = _SPACE
            joined[feed] = True
    return joined
