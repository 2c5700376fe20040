"""Read tables of spectra as text: one row for each wavelength, or one for each patch."""

from __future__ import annotations

import re
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from usdskin.errors import UsdSkinError
from usdskin.notes import Note
from usdskin.spectrafiles.labels import (
    default_names,
    name_column,
    number,
    stray_heading,
    wavelength,
)
from usdskin.spectrafiles.spectrafile import RawSpectra, place
from usdskin.spectrafiles.table_layout import (
    Layout,
    find_layout,
    other_unit,
    sample_rows,
    split_row,
    trimmed,
)
from usdskin.spectrafiles.units import quantity_of, stated_quantity, unit_in_brackets

_COMMENT = re.compile(r"\s*(#|//|%|!|>>>)")
_FRACTION = re.compile(r"[+-]?\d*[.,]\d+([eE][+-]?\d+)?")
_STATEMENT = re.compile(r"[\s#/%!]*([^:=]{1,60}?)\s*[:=]\s*(.+)")
_WAVELENGTH_HEADING = re.compile(
    r"[\[(]?\s*(nm|(wave[\s_-]?lengths?|lambda|λ|wl)[\s_/,]*([\[(]?\s*nm)?)\s*[\])]?", re.IGNORECASE
)
_UNIT_HEADING = re.compile(r"[\[(]?\s*nm\s*[\])]?", re.IGNORECASE)


@dataclass(frozen=True, slots=True)
class _Text:
    """The lines of a table."""

    path: Path
    rows: list[str]
    """Lines that are neither empty nor comments."""

    lines: list[int]
    """Their numbers in the file, from 1."""

    comments: list[str]
    """Comments before the first row and after it."""

    def where(self, row: int, column: int = 0) -> str:
        """Return where a row is, for errors; the column is counted from 1."""
        return place(self.path, self.lines[row], column)


def read_table(path: Path, text: str, notes: list[Note]) -> RawSpectra:
    """Read a table of spectra.

    Cells are separated by tabs, semicolons, commas or blanks; numbers may have a decimal comma.
    Wavelengths run down the first column, with a heading of names above the others or none, or
    along a heading, with a row for each patch below; which of both, the wavelengths tell. Rows
    above them and comments (lines that begin with ``#``, ``//``, ``%``, ``!`` or ``>>>``) may state
    ``key: value``, of which ``quantity`` and ``units`` count.

    Args:
        path: Names the file in errors.
        text: Its content.
        notes: What was passed over is appended here.

    Raises:
        UsdSkinError: Nothing in it looks like wavelengths in nanometres, or a row or cell breaks
            the table.
    """
    table = _lines(path, text)
    sample = sample_rows(table.rows)
    layout = find_layout(sample)
    if unit := other_unit(sample, layout):
        raise UsdSkinError(
            f"{path}: wavelengths such as {unit[1]} seem to be in {unit[0]}; give nanometres"
        )
    if layout is None:
        raise UsdSkinError(
            f"{path}: no wavelengths in it; give a table with them [nm] in its first column or "
            "its heading"
        )
    return _read_down(table, layout, notes) if layout.is_down else _read_across(table, layout)


def _lines(path: Path, text: str) -> _Text:
    rows, lines, comments = [], [], []
    for line_number, line in enumerate(text.split("\n"), start=1):
        if _COMMENT.match(line):
            comments.append(line)
        elif line.strip(' \t,;"'):
            rows.append(_without_remark(line))
            lines.append(line_number)
    return _Text(path, rows, lines, comments)


def _without_remark(line: str) -> str:
    """Return a row of numbers without the remark behind it; names may have a ``#`` in them."""
    head, mark, _ = line.partition(" #")
    letters = {character for character in head if character.isalpha()}
    return head if mark and letters <= {"e", "E"} and any(map(str.isdigit, head)) else line


def _read_down(table: _Text, layout: Layout, notes: list[Note]) -> RawSpectra:
    """Read wavelengths in a column, a spectrum in each column after it."""
    chosen = _wavelength_rows(table, layout, notes)
    first = layout.column + 1
    cells = [split_row(table.rows[row], layout.delimiter) for row in chosen]
    width = Counter(len(trimmed(row)) for row in cells).most_common(1)[0][0]
    values = np.empty((len(chosen), width - first))
    for index, (row, found) in enumerate(zip(chosen, cells, strict=True)):
        values[index] = _numbers(table, row, found, (first, width), width, layout)
    wavelengths = [wavelength(row[layout.column], layout.decimal_comma) for row in cells]
    names, units, heading = _headings(table, layout, chosen[0], width)
    metadata = _metadata(table, layout, heading)
    units = units or _stated_units(metadata)
    quantity = stated_quantity(metadata, units)
    if len(names) == 1 and quantity is None and re.search("reflect|transmi|radian", names[0], re.I):
        quantity = quantity_of(names[0])
    return RawSpectra(
        path=table.path,
        names=names,
        wavelength_nm=np.array([pair[0] for pair in wavelengths if pair is not None]),
        values=values.T,
        lines=np.array([[table.lines[row] for row in chosen]], dtype=np.int64),
        columns=np.arange(first, width, dtype=np.int64)[:, None] + 1,
        quantity=quantity,
        units=units,
        metadata=metadata,
    )


def _wavelength_rows(table: _Text, layout: Layout, notes: list[Note]) -> list[int]:
    """Return the rows that begin with a wavelength.

    Instruments that label each (``Spectral Data 380[nm]``) list several sweeps among other
    results: the longest counts. Where wavelengths are bare numbers all rows from the first on must
    be such rows.
    """
    found = [_leading(text, layout) for text in table.rows]
    first = found[layout.row]
    is_labelled = first is not None and first[1]
    sweeps: list[list[int]] = []
    start = None
    for row, pair in enumerate(found):
        if pair is None:
            continue
        if start is None or (is_labelled and pair[0] == start and len(sweeps[-1]) > 1):
            sweeps.append([])
            start = pair[0]
        sweeps[-1].append(row)
    longest = max(sweeps, key=len)
    if len(sweeps) > 1:
        message = f"{len(sweeps)} sweeps in it; that of {len(longest)} wavelengths was read"
        notes.append(Note("longest-sweep-read", str(table.path), message))
    stop = longest[-1] + 1 if is_labelled else len(table.rows)
    stray = next((row for row in range(longest[0], stop) if found[row] is None), None)
    if stray is not None:
        raise _no_row(table, stray)
    return longest


def _no_row(table: _Text, row: int) -> UsdSkinError:
    return UsdSkinError(
        f"{table.where(row)}: {table.rows[row].strip()[:40]!r} is no row of wavelength [nm] and "
        "values; mend it, or begin it with # if it is a remark"
    )


def _leading(text: str, layout: Layout) -> tuple[float, bool] | None:
    """Return the wavelength at the beginning of a row of data."""
    cells = split_row(text, layout.delimiter)
    if len(cells) <= layout.column + 1:
        return None
    return wavelength(cells[layout.column], layout.decimal_comma)


def _headings(
    table: _Text, layout: Layout, first_row: int, width: int
) -> tuple[tuple[str, ...], str, int]:
    """Return the names above the columns, their unit, and the first row that belongs to them."""
    first = layout.column + 1
    heading = first_row - 1
    _check_no_data(table, layout, heading, width)
    cells = _heading_cells(table, layout, heading, width)
    units = ""
    if cells is not None and _UNIT_HEADING.fullmatch(cells[0]) and len(set(cells[first:])) == 1:
        above = _heading_cells(table, layout, heading - 1, width)
        if above is not None:
            units, cells, heading = cells[-1].strip("[] "), above, heading - 1
    if cells is None:
        heading = first_row
        cells = _comment_heading(table, layout, width)
    if cells is None:
        return default_names(table.path, width - first), "", heading
    pairs = [unit_in_brackets(cell) for cell in cells[first:]]
    if not units and pairs[0][1] and len({unit for _, unit in pairs}) == 1:
        return tuple(name for name, _ in pairs), pairs[0][1], heading
    return tuple(cells[first:]), units, heading


def _check_no_data(table: _Text, layout: Layout, row: int, width: int) -> None:
    """Refuse a row of values whose wavelength cannot be read above the first one that has one."""
    if row < 0 or _leading(table.rows[row], layout) is not None:
        return
    cells = split_row(table.rows[row], layout.delimiter)[layout.column + 1 :]
    if len(cells) == width - layout.column - 1 and all(map(_FRACTION.fullmatch, cells)):
        raise _no_row(table, row)


def _heading_cells(table: _Text, layout: Layout, row: int, width: int) -> list[str] | None:
    """Return a row's cells if it can be the heading of ``width`` columns."""
    if row < 0:
        return None
    cells = split_row(table.rows[row], layout.delimiter)
    is_heading = len(cells) > layout.column and _WAVELENGTH_HEADING.fullmatch(cells[layout.column])
    if len(cells) >= width and not any(cells[width:]):
        is_free = number(cells[0], layout.decimal_comma) is None and (width > 2 or not cells[0])
        return cells[:width] if is_heading or is_free else None
    if is_heading:
        raise UsdSkinError(
            f"{table.where(row)}: a heading of {len(cells)} cells above rows of {width}; "
            "give each column one name, those with blanks in quotes"
        )
    if len(cells) == width - 1 and width > 2:
        return ["", *cells]
    return None


def _comment_heading(table: _Text, layout: Layout, width: int) -> list[str] | None:
    """Return the heading that is written as a comment, as numpy.savetxt does."""
    for comment in reversed(table.comments):
        cells = split_row(comment.lstrip("#/%! \t"), layout.delimiter)
        if len(cells) == width and _WAVELENGTH_HEADING.fullmatch(cells[layout.column]):
            return cells
    return None


def _read_across(table: _Text, layout: Layout) -> RawSpectra:
    """Read a heading of wavelengths, a spectrum in each row below."""
    heading = [""] * layout.shift + trimmed(split_row(table.rows[layout.row], layout.delimiter))
    first = layout.column + layout.shift
    stop = first + layout.count
    found = [wavelength(cell, layout.decimal_comma) for cell in heading]
    stray = stray_heading([pair is not None for pair in found])
    if stray is not None:
        raise UsdSkinError(
            f"{table.where(layout.row, stray + 1)}: {heading[stray][:40]!r} is no wavelength but "
            "stands among them; mend the heading"
        )
    rows = range(layout.row + 1, len(table.rows))
    values = np.empty((len(rows), layout.count))
    others: list[list[str]] = []
    for index, row in enumerate(rows):
        cells = split_row(table.rows[row], layout.delimiter)
        values[index] = _numbers(table, row, cells, (first, stop), len(heading), layout)
        padded = cells + [""] * (len(heading) - len(cells))
        others.append(padded[:first] + padded[stop : len(heading)])
    columns = [list(column) for column in zip(*others, strict=True)]
    chosen = name_column(heading[:first] + heading[stop:], columns)
    if chosen is None and layout.shift:
        chosen = 0
    metadata = _metadata(table, layout, layout.row)
    units = _stated_units(metadata)
    return RawSpectra(
        path=table.path,
        names=default_names(table.path, len(rows)) if chosen is None else tuple(columns[chosen]),
        wavelength_nm=np.array([pair[0] for pair in found[first:stop] if pair is not None]),
        values=values,
        lines=np.array([table.lines[row] for row in rows], dtype=np.int64)[:, None],
        columns=np.arange(first, stop, dtype=np.int64)[None, :] + 1,
        quantity=stated_quantity(metadata, units),
        units=units,
        metadata=metadata,
    )


def _numbers(
    table: _Text,
    row: int,
    cells: list[str],
    span: tuple[int, int],
    width: int,
    layout: Layout,
) -> list[float]:
    """Return the numbers in the cells ``span`` of a row that has ``width`` cells at most."""
    first, stop = span
    if any(cells[width:]) or len(cells) < stop:
        raise UsdSkinError(
            f"{table.where(row)}: {len(trimmed(cells))} cells where the table has {width}; "
            "give every row as many, names with blanks in quotes"
        )
    values = []
    for column in range(first, stop):
        value = number(cells[column], layout.decimal_comma)
        if value is None:
            what = f"{cells[column][:40]!r} is not a number" if cells[column] else "an empty cell"
            raise UsdSkinError(
                f"{table.where(row, column + 1)}: {what}; give a value for every wavelength"
            )
        values.append(value)
    return values


def _metadata(table: _Text, layout: Layout, stop: int) -> dict[str, str]:
    """Return what comments, and the rows before ``stop``, state as ``key: value`` or in cells."""
    metadata: dict[str, str] = {}
    for text in [*table.comments, *table.rows[:stop]]:
        cells = trimmed(split_row(text, layout.delimiter)) if layout.delimiter != " " else [text]
        if len(cells) == 2 and not _COMMENT.match(text):
            metadata[cells[0].rstrip(" :=").lower()] = cells[1]
        elif match := _STATEMENT.fullmatch(text.strip().strip('"')):
            metadata[match[1].lower()] = match[2].strip()
    return metadata


def _stated_units(metadata: dict[str, str]) -> str:
    stated = next((metadata[key] for key in ("units", "unit") if key in metadata), "")
    return "" if stated.casefold() in ("nm", "nanometer", "nanometers") else stated
