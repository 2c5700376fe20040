"""Read CGATS.17 text and its relatives: i1Profiler's, ArgyllCMS's ``.ti3`` and ``.sp``.

Fields of spectra are told by their names, such as ``SPECTRAL_NM380``, ``nm380``, ``SPEC_380`` or
``R_380``, or are pairs ``SPECTRAL_NM`` and ``SPECTRAL_PCT`` or ``SPECTRAL_DEC`` (ANSI CGATS.17).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsdSkinError
from usdskin.spectrafiles.labels import (
    default_names,
    name_column,
    number,
    stray_heading,
    wavelength,
)
from usdskin.spectrafiles.spectrafile import RawSpectra, place
from usdskin.spectrafiles.units import stated_quantity
from usdskin.spectrum import SpectralQuantity

FloatArray = NDArray[np.float64]

_WORD = re.compile(r'"([^"]*)"|(\S+)')
_PART = re.compile(r'"[^"]*"?|#|[^"#]+')
_PAIR_VALUES = {"SPECTRAL_PCT": "%", "SPECTRAL_DEC": ""}
_ARGYLL_EMISSION = {"EMISSION": "mW m^-2 sr^-1 nm^-1", "AMBIENT": "mW m^-2 nm^-1"}
"""Units of ArgyllCMS's emissive measurements, by MEAS_TYPE (its ``xicc/xspect.h``)."""

_DEVICE_QUANTITIES = {
    "OUTPUT": SpectralQuantity.REFLECTANCE,
    "INPUT": SpectralQuantity.REFLECTANCE,
    "DISPLAY": SpectralQuantity.RADIANCE,
    "EMISINPUT": SpectralQuantity.RADIANCE,
}
"""What is measured in ArgyllCMS's ``.ti3``, by DEVICE_CLASS (its ``doc/ti3_format.html``)."""


@dataclass(slots=True)
class _Table:
    """One table of a file while it is read."""

    metadata: dict[str, str]
    fields: list[str] = field(default_factory=list)
    rows: list[tuple[int, str]] = field(default_factory=list)
    """Line number and text of each line of data."""

    line: int = 0
    """Line of BEGIN_DATA."""

    ended: bool = False


def is_cgats(text: str) -> bool:
    """Return whether a text has a table as CGATS.17 marks it."""
    return re.search(r"^[ \t]*BEGIN_DATA(_FORMAT)?[ \t]*$", text, re.MULTILINE) is not None


def read_cgats(path: Path, text: str) -> RawSpectra:
    """Read the one table of a CGATS file that holds spectra.

    Args:
        path: Names the file in errors.
        text: Its content.

    Raises:
        UsdSkinError: No table or more than one holds spectra, or it contradicts itself.
    """
    tables = _tables(path, text)
    spectral = [table for table in tables if _is_spectral(table)]
    if not spectral:
        listed = " ".join(tables[0].fields[:8]) if tables else "no table"
        raise UsdSkinError(
            f"{path}: no spectral fields such as SPECTRAL_NM380 ({listed} ...); "
            "export the spectra with the measurements"
        )
    if len(spectral) > 1:
        lines = " and ".join(str(table.line) for table in spectral)
        raise UsdSkinError(
            f"{path}: tables with spectra at lines {lines}; keep one, each in a file of its own"
        )
    return _spectra(path, spectral[0])


def _tables(path: Path, text: str) -> list[_Table]:
    tables: list[_Table] = []
    table = _Table({})
    section = ""
    for line_number, line in enumerate(text.split("\n"), start=1):
        plain = _without_comment(line)
        word = plain.strip()
        if not word:
            continue
        if word in ("BEGIN_DATA_FORMAT", "BEGIN_DATA"):
            section = word
            if word == "BEGIN_DATA":
                table.line = line_number
                tables.append(table)
        elif word in ("END_DATA_FORMAT", "END_DATA"):
            section = ""
            if word == "END_DATA":
                table.ended = True
                table = _Table(dict(table.metadata))
        elif section == "BEGIN_DATA_FORMAT":
            table.fields += _words(plain)
        elif section == "BEGIN_DATA":
            table.rows.append((line_number, plain))
        else:
            _note_keyword(table, _words(plain))
    if tables and not tables[-1].ended:
        raise UsdSkinError(f"{path}: ends before END_DATA; the file is cut short, copy it again")
    return tables


def _without_comment(line: str) -> str:
    """Return a line up to a ``#`` that is neither in quotes nor within a word."""
    for match in _PART.finditer(line) if "#" in line else ():
        if match[0] == "#" and not line[max(match.start() - 1, 0) : match.start()].strip():
            return line[: match.start()]
    return line


def _words(line: str) -> list[str]:
    return [match[2] if match[1] is None else match[1] for match in _WORD.finditer(line)]


def _note_keyword(table: _Table, words: list[str]) -> None:
    if words[0] != "KEYWORD":
        table.metadata[words[0].lower()] = " ".join(words[1:])


def _is_spectral(table: _Table) -> bool:
    return "SPECTRAL_NM" in table.fields or _spectral_fields(table).size > 1


def _spectral_fields(table: _Table) -> NDArray[np.int64]:
    found = [index for index, name in enumerate(table.fields) if wavelength(name) is not None]
    return np.array(found, dtype=np.int64)


def _spectra(path: Path, table: _Table) -> RawSpectra:
    cells, lines = _cells(path, table)
    units = ""
    if "SPECTRAL_NM" in table.fields:
        spectral, wavelength_nm, units = _pairs(path, table, cells, lines)
    else:
        spectral = _spectral_fields(table)
        wavelength_nm = _wavelengths(path, table, spectral)
    values = _numbers(path, cells, lines, spectral)
    norm = number(table.metadata.get("spectral_norm", "1"))
    if norm is None or not norm > 0.0:
        stated = table.metadata["spectral_norm"]
        raise UsdSkinError(f"{path}: SPECTRAL_NORM is {stated!r}; give a number above 0")
    measured = table.metadata.get("meas_type", "").upper()
    units = _ARGYLL_EMISSION.get(measured, units)
    return RawSpectra(
        path=path,
        names=_names(path, table, cells, set(spectral.tolist())),
        wavelength_nm=wavelength_nm,
        values=values / norm,
        lines=np.array(lines, dtype=np.int64)[:, None],
        columns=spectral[None, :] + 1,
        quantity=stated_quantity(table.metadata, units)
        or _DEVICE_QUANTITIES.get(table.metadata.get("device_class", "").upper()),
        units=units,
        metadata=table.metadata,
    )


def _cells(path: Path, table: _Table) -> tuple[list[list[str]], list[int]]:
    """Return the rows of a table and their lines."""
    width = len(table.fields)
    fields = number(table.metadata.get("number_of_fields", str(width)))
    if fields != width:
        raise UsdSkinError(
            f"{path}:{table.line}: NUMBER_OF_FIELDS is {table.metadata['number_of_fields']}, "
            f"but the format has {width}; export the file again"
        )
    sets = number(table.metadata.get("number_of_sets", "nan"))
    rows = [_row(text, width) for _, text in table.rows]
    lines = [line for line, _ in table.rows]
    wrong = next((index for index, row in enumerate(rows) if len(row) != width), None)
    if wrong is not None:
        # Some programs fold long rows; only the number of sets tells that from a damaged one.
        flat = [(line, word) for line, text in table.rows for word in _words(text)]
        if sets is None or len(flat) != width * sets:
            raise UsdSkinError(
                f"{place(path, lines[wrong])}: {len(rows[wrong])} values where the format has "
                f"{width} fields; export the file again"
            )
        starts = range(0, len(flat), width)
        rows = [[word for _, word in flat[start : start + width]] for start in starts]
        lines = [flat[start][0] for start in starts]
    if not rows or (sets is not None and sets == sets and sets != len(rows)):
        stated = table.metadata.get("number_of_sets", "some")
        raise UsdSkinError(
            f"{path}:{table.line}: {len(rows)} sets where NUMBER_OF_SETS is {stated}; "
            "the file is cut short or was edited, export it again"
        )
    return rows, lines


def _row(text: str, width: int) -> list[str]:
    """Split at blanks, or at tabs where names have blanks in them."""
    words = _words(text)
    if len(words) == width or "\t" not in text:
        return words
    cells = [cell.strip().strip('"') for cell in text.split("\t")]
    return cells if len(cells) == width else words


def _pairs(
    path: Path, table: _Table, cells: list[list[str]], lines: list[int]
) -> tuple[NDArray[np.int64], FloatArray, str]:
    """Return the fields with values, their wavelengths [nm] and unit where both are data."""
    at = [index for index, name in enumerate(table.fields) if name == "SPECTRAL_NM"]
    followers = {table.fields[index + 1] for index in at if index + 1 < len(table.fields)}
    if len(followers) != 1 or not followers <= set(_PAIR_VALUES) or at[-1] + 1 == len(table.fields):
        raise UsdSkinError(
            f"{path}:{table.line}: SPECTRAL_NM without SPECTRAL_PCT or SPECTRAL_DEC after it; "
            "export fields such as SPECTRAL_NM380"
        )
    wavelength_nm = _numbers(path, cells, lines, np.array(at))
    differ = np.flatnonzero((wavelength_nm != wavelength_nm[0]).any(axis=1))
    if differ.size:
        raise UsdSkinError(
            f"{place(path, lines[int(differ[0])])}: other wavelengths than the set before it; "
            "export all sets at the same ones"
        )
    return np.array(at) + 1, wavelength_nm[0], _PAIR_VALUES[followers.pop()]


def _wavelengths(path: Path, table: _Table, spectral: NDArray[np.int64]) -> FloatArray:
    """Return the wavelengths of fields, whose names may be rounded to whole numbers."""
    stray = stray_heading([wavelength(name) is not None for name in table.fields])
    if stray is not None:
        raise UsdSkinError(
            f"{path}:{table.line}: field {table.fields[stray][:40]!r} is no wavelength but stands "
            "among them; export the file again"
        )
    found = [wavelength(table.fields[index]) for index in spectral]
    named = np.array([pair[0] for pair in found if pair is not None])
    keys = ("spectral_bands", "spectral_start_nm", "spectral_end_nm")
    stated = [number(table.metadata.get(key, "")) for key in keys]
    bands, start, end = stated
    if bands is not None and bands != named.size:
        raise UsdSkinError(
            f"{path}:{table.line}: SPECTRAL_BANDS is {bands:g}, but {named.size} fields name a "
            "wavelength; export the file again"
        )
    if start is None or end is None:
        return named
    exact = np.linspace(start, end, named.size)
    if np.abs(exact - named).max() > 0.51:
        raise UsdSkinError(
            f"{path}:{table.line}: SPECTRAL_START_NM {start:g} and SPECTRAL_END_NM {end:g} "
            "contradict the names of the fields; export the file again"
        )
    return exact


def _numbers(
    path: Path, cells: list[list[str]], lines: list[int], columns: NDArray[np.int64]
) -> FloatArray:
    values = np.empty((len(cells), columns.size))
    for row, (words, line) in enumerate(zip(cells, lines, strict=True)):
        for place_in_row, column in enumerate(columns.tolist()):
            word = words[column]
            value = number(word)
            if value is None:
                value = number(word, decimal_comma=True)
            if value is None:
                raise UsdSkinError(
                    f"{place(path, line, column + 1)}: {word[:40]!r} is not a number"
                    if word
                    else f"{place(path, line, column + 1)}: the cell is empty; give a number"
                )
            values[row, place_in_row] = value
    return values


def _names(
    path: Path, table: _Table, cells: list[list[str]], spectral: set[int]
) -> tuple[str, ...]:
    others = [index for index in range(len(table.fields)) if index not in spectral]
    columns = [[row[index] for row in cells] for index in others]
    chosen = name_column([table.fields[index] for index in others], columns)
    if chosen is not None:
        return tuple(cell.strip() for cell in columns[chosen])
    return default_names(path, len(cells))
