"""Cells of tables: numbers, wavelengths and names of patches."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

SHORTEST_NM, LONGEST_NM = 180.0, 3000.0
"""What may be a wavelength [nm]: percentages and numbers of patches are smaller."""

_DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(?:[eE][+-]?\d+)?")
_WAVELENGTH = re.compile(
    r"""(?P<label>(?:spectral[\s_]*data|spectral|spectrum|spec|reflectance|refl|radiance|rad
        |wavelength|lambda|wl|nm|[rsxwλ])(?:[\s_]*nm)?[\s_\-.:=]*)?
    (?P<number>\d{1,4}(?:[.,]\d+)?)
    (?P<unit>[\s_]*[\[(]?\s*nm\s*[\])]?)?""",
    re.IGNORECASE | re.VERBOSE,
)
_NAME_HEADINGS = (
    re.compile(r"(sample|patch|color|colour)?[\s_]*name", re.IGNORECASE),
    re.compile(r"(sample|patch)[\s_]*loc(ation)?|patch|sample|label|colou?r", re.IGNORECASE),
    re.compile(r"((sample|patch)[\s_]*)?(id|no|nr|number|index)\.?|string|#", re.IGNORECASE),
)


def number(text: str, decimal_comma: bool = False) -> float | None:
    """Return the number in a cell, None where there is none; NaN and infinity are numbers."""
    plain = text.strip()
    if decimal_comma and "." in plain:
        return None
    if decimal_comma and _DECIMAL_COMMA.fullmatch(plain):
        plain = plain.replace(",", ".")
    if "_" in plain:
        return None
    try:
        return float(plain)
    except ValueError:
        return None


def wavelength(text: str, decimal_comma: bool = False) -> tuple[float, bool] | None:
    """Return the wavelength in a cell.

    Args:
        text: Such as ``380``, ``380.5nm``, ``SPECTRAL_NM380``, ``nm380``, ``SPEC_380``, ``R_380``.
        decimal_comma: Whether numbers have a comma where others have a point.

    Returns:
        The wavelength [nm] and whether the cell says by more than its number that it is one; None
        where it is none or not between 180 and 3000 nm.
    """
    plain = text.strip()
    value, is_labelled = number(plain, decimal_comma), False
    if value is None:
        match = _WAVELENGTH.fullmatch(plain)
        if match is None or not (match["label"] or match["unit"]):
            return None
        value, is_labelled = float(match["number"].replace(",", ".")), True
    return (value, is_labelled) if SHORTEST_NM <= value <= LONGEST_NM else None


def name_column(headings: Sequence[str], columns: Sequence[Sequence[str]]) -> int | None:
    """Return which column names the patches.

    A column called a name, a location or an identifier, in this order, the first of them that has
    no two cells alike; else the first column that is not all numbers.

    Args:
        headings: Headings of the columns that hold no spectrum; empty where there are none.
        columns: Their cells.

    Returns:
        Its index, None where no column will do.
    """
    called = [
        index
        for pattern in _NAME_HEADINGS
        for index, heading in enumerate(headings)
        if pattern.fullmatch(heading.strip())
    ]
    for index in called:
        if len(set(columns[index])) == len(columns[index]):
            return index
    if called:
        return called[0]
    words = [
        index
        for index, cells in enumerate(columns)
        if any(number(cell) is None and cell.strip() for cell in cells)
    ]
    return words[0] if words else None


def stray_heading(is_wavelength: Sequence[bool]) -> int | None:
    """Return the first heading among those of wavelengths that is none, None where all are."""
    found = [index for index, flag in enumerate(is_wavelength) if flag]
    inside = range(found[0], found[-1] + 1) if found else range(0)
    return next((index for index in inside if not is_wavelength[index]), None)


def default_names(path: Path, count: int) -> tuple[str, ...]:
    """Return the names of spectra that have none: that of the file for one, else 1, 2, ..."""
    return (path.stem,) if count == 1 else tuple(str(1 + index) for index in range(count))
