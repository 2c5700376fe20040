"""``exposures.csv``: exposures of photographs that do not tell them, in the photographs' folder."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from usdskin.capture.ingest.exif import Photo
from usdskin.errors import LayerError
from usdskin.notes import Note

TABLE_NAME = "exposures.csv"
"""Name of the table."""

TABLE_COLUMNS = ("file", "time", "iso", "fnumber", "nd", "view")
"""Its columns; all but the first may be missing, and any cell empty."""

_FIELDS = {"time": "exposure_time_s", "iso": "iso", "fnumber": "f_number", "nd": "nd_factor"}


@dataclass(frozen=True, slots=True)
class TableRow:
    """What the table says about one photograph."""

    settings: Mapping[str, Any]
    """Numbers by the name of their field in ``Photo``."""

    view: str | None
    """Name of the view it belongs to; None: not told."""


def read_table(directory: Path) -> dict[Path, TableRow]:
    """Return the rows of a folder's table by the file they are about; none without a table.

    Cells are separated by commas or semicolons; times may be fractions such as 1/60.

    Raises:
        LayerError: The table cannot be read; the message names the line.
    """
    path = directory / TABLE_NAME
    if not path.is_file():
        return {}
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not UTF-8 text"
        raise LayerError(f"{path}: cannot be read ({reason}); save it as CSV in UTF-8") from None
    separator = ";" if ";" in text.partition("\n")[0] else ","
    lines = csv.reader(text.splitlines(), delimiter=separator)
    header = [name.strip().lower() for name in next(lines, [])]
    unknown = [name for name in header if name not in TABLE_COLUMNS]
    if "file" not in header or unknown:
        what = f'has a column "{unknown[0]}"' if unknown else 'has no column "file"'
        raise LayerError(f"{path}: {what}; name the columns {','.join(TABLE_COLUMNS)}")
    rows: dict[Path, TableRow] = {}
    for cells in lines:
        where = f"{path} line {lines.line_num}"
        named = dict(zip(header, (cell.strip() for cell in cells), strict=False))
        if not any(named.values()):
            continue
        file = directory / named["file"]
        if not file.is_file():
            raise LayerError(f"{where}: there is no {named['file']} in {directory}; correct it")
        if file in rows:
            raise LayerError(f"{where}: {named['file']} has a line already; remove one of them")
        settings = {
            field: _number(where, column, named[column], column == "nd")
            for column, field in _FIELDS.items()
            if named.get(column)
        }
        rows[file] = TableRow(settings, named.get("view") or None)
    return rows


def _number(where: str, column: str, text: str, at_least_one: bool) -> float:
    above, _, below = text.partition("/")
    try:
        value = float(above) / float(below or 1.0)
    except (ValueError, ZeroDivisionError):
        value = math.nan
    least = "1 or more" if at_least_one else "a number above 0, such as 1/60 or 0.5"
    if not math.isfinite(value) or value <= 0.0 or (at_least_one and value < 1.0):
        raise LayerError(f'{where}: {column} is "{text}"; give {least}')
    return value


def apply_row(photo: Photo, row: TableRow | None, notes: list[Note]) -> Photo:
    """Return a photograph with what the table says in place of what it says itself.

    Args:
        photo: The photograph.
        row: What the table says about it.
        notes: Takes settings of the photograph that the table contradicts.
    """
    if row is None:
        return photo
    for column, field in _FIELDS.items():
        told, stated = getattr(photo, field), row.settings.get(field)
        is_told = told is not None and column != "nd"
        if stated is not None and is_told and not math.isclose(told, stated, rel_tol=0.02):
            text = f"{TABLE_NAME} says {column} {stated:g} and EXIF {told:g}; the table is used"
            notes.append(Note("table-over-exif", str(photo.path), text))
    return replace(photo, **row.settings)
