"""Read a goniometer's table: angles, and what came back at each.

A heading names the columns: ``thetaI`` and ``thetaR``, optionally ``azimuth`` [deg] and
``thickness`` [m], or as in ``thickness [mm]``; every other column is a channel (R, G, B) or a
wavelength (``550`` or ``550nm``).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError

FloatArray = NDArray[np.float64]

_MAX_BYTES = 64 * 1024 * 1024
_ANGLES = {
    "theta_i": ("thetai", "incidence", "incidentangle", "lightangle"),
    "theta_r": ("thetar", "reflection", "viewangle", "exitance", "observation"),
    "azimuth": ("azimuth", "phi", "relativeazimuth", "deltaphi"),
}
_THICKNESS = re.compile(r"^thickness[\s_]*[\[(]?\s*(\w*)\s*[\])]?$", re.IGNORECASE)
_METRES = {"": 1.0, "m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "\u00b5m": 1e-6, "\u03bcm": 1e-6}
_WAVELENGTH = re.compile(r"^[a-z_ ]*(\d{3,4}(?:\.\d+)?)\s*(nm)?$", re.IGNORECASE)


@dataclass(frozen=True, slots=True, eq=False)
class GoniometerTable:
    """A table of readings."""

    theta_i: FloatArray
    """Angles between normal and light [deg], shape [q]."""

    theta_r: FloatArray | None
    """Angles between normal and camera [deg], shape [q]; None: no such column."""

    azimuth: FloatArray | None
    """Angles between the planes of light and camera [deg], shape [q]; None: no such column."""

    thickness: FloatArray | None
    """Way through the sample [m], shape [q]; None: no such column."""

    values: FloatArray
    """Readings, shape [q, c]."""

    names: tuple[str, ...]
    """Names of their columns, shape [c]."""

    wavelength_nm: FloatArray | None
    """The columns' wavelengths [nm], ascending, shape [c]; None: they are channels."""


def read_goniometer_table(path: Path) -> GoniometerTable:
    """Return the readings of a text file.

    Raises:
        LayerError: The file cannot be read, has no such heading, or a cell is no number.
    """
    lines = _lines(path)
    number, heading = lines[0]
    names = [cell.strip().strip('"') for cell in _cells(heading)]
    columns = {key: _angle_column(names, spellings) for key, spellings in _ANGLES.items()}
    if columns["theta_i"] is None:
        raise LayerError(
            f"{path}:{number}: its heading names no column thetaI ({', '.join(names[:6])}); head "
            "the columns thetaI, thetaR, azimuth, and R, G, B or wavelengths"
        )
    rows = np.array([_row(path, number, line, names) for number, line in lines[1:]])
    if not len(rows):
        raise LayerError(f"{path}: has a heading but no readings; add rows")
    columns["thickness"], metres = _thickness_column(path, number, names)
    taken = {index for index in columns.values() if index is not None}
    rest = [index for index in range(len(names)) if index not in taken]
    if not rest:
        raise LayerError(f"{path}:{number}: its columns are angles alone; add those of readings")
    found = [_WAVELENGTH.match(names[index]) for index in rest]
    nm = None
    if all(match is not None for match in found):
        nm = np.array([float(match[1]) for match in found if match is not None])
        order = np.argsort(nm)
        rest, nm = [rest[index] for index in order], nm[order]
    elif any(match is not None for match in found):
        raise LayerError(
            f"{path}:{number}: some columns are wavelengths and some are not "
            f"({', '.join(names[index] for index in rest[:6])}); name all alike"
        )

    def column(key: str) -> FloatArray | None:
        index = columns[key]
        return None if index is None else rows[:, index]

    theta_i, thickness = column("theta_i"), column("thickness")
    assert theta_i is not None
    return GoniometerTable(
        theta_i=theta_i,
        theta_r=column("theta_r"),
        azimuth=column("azimuth"),
        thickness=None if thickness is None else thickness * metres,
        values=rows[:, rest],
        names=tuple(names[index] for index in rest),
        wavelength_nm=nm,
    )


def _lines(path: Path) -> list[tuple[int, str]]:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise LayerError(f"{path}: larger than 64 MiB, so no table of readings; give one")
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise LayerError(f"{path}: cannot be read ({reason}); give a table of readings") from None
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if line.strip() and not line.lstrip().startswith("#")
    ]
    if not numbered:
        raise LayerError(f"{path}: is empty; give a table of readings")
    return numbered


def _cells(line: str) -> list[str]:
    for separator in (";", "\t", ","):
        if separator in line:
            return line.split(separator)
    return line.split()


def _angle_column(names: list[str], spellings: tuple[str, ...]) -> int | None:
    for index, name in enumerate(names):
        plain = re.sub(r"\[.*?\]|\(.*?\)|[^a-z]", "", name.lower().replace("deg", ""))
        if plain in spellings:
            return index
    return None


def _thickness_column(path: Path, number: int, names: list[str]) -> tuple[int | None, float]:
    """Return the column of thicknesses and the unit of its heading [m]."""
    for index, name in enumerate(names):
        if match := _THICKNESS.match(name):
            unit = match[1].lower()
            if unit not in _METRES:
                raise LayerError(f'{path}:{number}: "{name}" is in no unit known; give m, mm or um')
            return index, _METRES[unit]
    return None, 1.0


def _row(path: Path, number: int, line: str, names: list[str]) -> list[float]:
    cells = _cells(line)
    if len(cells) != len(names):
        raise LayerError(
            f"{path}:{number}: has {len(cells)} cells but the heading {len(names)}; give every row "
            "one per column"
        )
    row = []
    for name, cell in zip(names, cells, strict=True):
        text = cell.strip().strip('"')
        try:
            # A decimal comma, where columns are not parted by commas.
            value = float(text.replace(",", "."))
        except ValueError:
            value = float("nan")
        if not np.isfinite(value):
            raise LayerError(
                f"{path}:{number}: {name} is {text!r}, which is no number; correct it or leave the "
                "row out"
            )
        row.append(value)
    return row
