"""Find out how a table of text is laid out: what separates cells, and where wavelengths run."""

from __future__ import annotations

import csv
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from usdskin.spectrafiles.labels import number, wavelength

Delimiter = Literal["\t", ";", ",", " "]

_SAMPLE_ROWS, _SAMPLE_CHARACTERS = 400, 2**17
"""How much is looked at to find the layout."""

_HEADING_ROWS = 60
"""Rows among which the wavelengths may stand side by side."""

_WAYS: tuple[tuple[Delimiter, bool], ...] = (
    ("\t", False),
    ("\t", True),
    (";", False),
    (";", True),
    (",", False),
    (" ", False),
    (" ", True),
    (",", True),
)
"""What separates cells, and whether numbers have a comma for a point; the first that fits."""

_OTHER_UNITS = {"micrometres": 1e3, "metres": 1e9, "angstroms": 0.1}
"""Nanometres in other units of wavelength."""

_Reader = Callable[[str, bool], tuple[float, bool] | None]


@dataclass(frozen=True, slots=True)
class Layout:
    """How a table is laid out."""

    delimiter: Delimiter
    """What separates cells; a blank stands for any run of blanks and tabs."""

    decimal_comma: bool
    """Whether numbers have a comma for a point."""

    is_down: bool
    """Whether wavelengths run down a column, or else along a row."""

    row: int
    """First row with a wavelength, among those given."""

    column: int
    """First column with a wavelength, from 0."""

    count: int
    """Wavelengths found."""

    shift: int = 0
    """1 where rows of data have a cell more in front than the heading, else 0."""

    score: float = 0.0
    """Wavelengths found, less the more, the less they ascend and the fewer values are numbers."""


def split_row(text: str, delimiter: Delimiter) -> list[str]:
    """Return the cells of a row without blanks around them."""
    if '"' not in text:
        if delimiter == " ":
            return text.split()
        return [cell.strip() for cell in text.split(delimiter)]
    if delimiter == " ":
        text = text.replace("\t", " ")
    try:
        cells = next(csv.reader([text], delimiter=delimiter, skipinitialspace=True), [])
    except csv.Error:
        cells = text.split(delimiter)
    stripped = [cell.strip() for cell in cells]
    return [cell for cell in stripped if cell] if delimiter == " " else stripped


def trimmed(cells: list[str]) -> list[str]:
    """Return cells without the empty ones at the end, which spreadsheets add."""
    count = len(cells)
    while count and not cells[count - 1]:
        count -= 1
    return cells[:count]


def sample_rows(rows: Sequence[str]) -> Sequence[str]:
    """Return the first rows, enough to find the layout and not so many that it takes long."""
    count = size = 0
    while count < min(len(rows), _SAMPLE_ROWS) and (size < _SAMPLE_CHARACTERS or count < 3):
        size += len(rows[count])
        count += 1
    return rows[:count]


def find_layout(rows: Sequence[str]) -> Layout | None:
    """Return the layout that makes most of a table's rows wavelengths and numbers.

    Args:
        rows: Lines without comments and empty ones; the first few hundred are enough.

    Returns:
        The layout, None where nothing in the table looks like wavelengths in nanometres.
    """
    return max(_layouts(rows, wavelength), key=lambda layout: layout.score, default=None)


def other_unit(rows: Sequence[str], layout: Layout | None) -> tuple[str, str] | None:
    """Return the unit that a table's wavelengths seem to be in if not in nanometres.

    Args:
        rows: Lines without comments and empty ones.
        layout: What was found for nanometres.

    Returns:
        The unit's name and the first cell in it, None where there is no sign of it.
    """
    for name, factor in _OTHER_UNITS.items():

        def read(
            text: str, decimal_comma: bool, factor: float = factor
        ) -> tuple[float, bool] | None:
            value = number(text, decimal_comma)
            if value is None or not 300.0 <= factor * value <= 1200.0:
                return None
            return factor * value, False

        found = max(_layouts(rows, read), key=lambda layout: layout.score, default=None)
        if found is None or found.count < 5 or found.score < 0.99 * found.count:
            continue
        if layout is None or found.score > 2.0 * layout.score:
            return name, split_row(rows[found.row], found.delimiter)[found.column]
    return None


def _layouts(rows: Sequence[str], read: _Reader) -> Iterator[Layout]:
    for delimiter, decimal_comma in _WAYS:
        cells = [split_row(row, delimiter) for row in rows]
        if max((len(row) for row in cells), default=0) < 2:
            continue
        down = _down(cells, read, delimiter, decimal_comma)
        across = _across(cells, read, delimiter, decimal_comma)
        yield from (layout for layout in (down, across) if layout is not None)


def _down(
    cells: list[list[str]], read: _Reader, delimiter: Delimiter, decimal_comma: bool
) -> Layout | None:
    """Look for wavelengths in the first or, after an index, the second column."""
    best: Layout | None = None
    for column in (0, 1):
        found = [
            read(row[column], decimal_comma) if len(row) > column + 1 else None for row in cells
        ]
        start, stop = _longest_run([pair is not None for pair in found])
        values = [pair[0] for pair in found[start:stop] if pair is not None]
        data = [cell for row in cells[start:stop] for cell in trimmed(row)[column + 1 :]]
        score = _score(values, data, decimal_comma)
        if score > (best.score if best else 0.0):
            best = Layout(delimiter, decimal_comma, True, start, column, stop - start, score=score)
    return best


def _across(
    cells: list[list[str]], read: _Reader, delimiter: Delimiter, decimal_comma: bool
) -> Layout | None:
    """Look for a heading of wavelengths."""
    best: Layout | None = None
    for index, row in enumerate(cells[:_HEADING_ROWS]):
        found = [read(cell, decimal_comma) for cell in row]
        start, stop = _longest_run([pair is not None for pair in found])
        below = cells[index + 1 :]
        if stop - start < 2 or not below:
            continue
        # A heading may leave the corner above the names out.
        shift = int(min(len(trimmed(other)) for other in below) > len(trimmed(row)))
        values = [pair[0] for pair in found[start:stop] if pair is not None]
        data = [cell for other in below for cell in other[start + shift : stop + shift]]
        score = _score(values, data, decimal_comma)
        if score > (best.score if best else 0.0):
            best = Layout(delimiter, decimal_comma, False, index, start, stop - start, shift, score)
    return best


def _score(wavelength_nm: list[float], data: list[str], decimal_comma: bool) -> float:
    if len(wavelength_nm) < 2 or not data:
        return 0.0
    steps = np.diff(wavelength_nm)
    order = max(float(np.mean(steps > 0.0)), float(np.mean(steps < 0.0)))
    numbers = sum(number(cell, decimal_comma) is not None for cell in data) / len(data)
    return len(wavelength_nm) * order * numbers


def _longest_run(flags: list[bool]) -> tuple[int, int]:
    """Return start and stop of the longest run of true flags, the first of equals."""
    best, start = (0, 0), None
    for index, flag in enumerate([*flags, False]):
        if flag and start is None:
            start = index
        elif not flag and start is not None:
            if index - start > best[1] - best[0]:
                best = (start, index)
            start = None
    return best
