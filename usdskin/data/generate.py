"""Write the colorimetric tables of this folder out of colour-science.

Run by hand when a table is added, from the root of the repository::

    python usdskin/data/generate.py

The tables are committed, since importing colour-science takes seconds and a render takes less.
"""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import colour
from colour.colorimetry import SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019

FOLDER = Path(__file__).parent

OBSERVERS = {
    "cie1931_2": "CIE 1931 2 Degree Standard Observer",
    "cie1964_10": "CIE 1964 10 Degree Standard Observer",
    "cie2015_2": "CIE 2015 2 Degree Standard Observer",
}

ILLUMINANTS = [
    *("A", "B", "C", "D50", "D55", "D60", "D65", "D75", "ID50", "ID65"),
    *(f"FL{number}" for number in range(1, 13)),
    *(f"FL3.{number}" for number in range(1, 16)),
    *(f"HP{number}" for number in range(1, 6)),
    *(f"LED-B{number}" for number in range(1, 6)),
    *("LED-BH1", "LED-RGB1", "LED-V1", "LED-V2"),
]


def write_table(name: str, columns: Sequence[str], rows: Iterable[Sequence[float | None]]) -> None:
    """Write one table; a cell that its source does not tabulate stays empty.

    Args:
        name: File name without its ending.
        columns: Column names; the first is the wavelength [nm].
        rows: One row a wavelength.
    """
    with (FOLDER / f"{name}.csv").open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        for row in rows:
            writer.writerow(["" if cell is None else format(cell, ".12g") for cell in row])


def multi_rows(functions: Any) -> Iterable[Sequence[float]]:
    """Yield wavelength and values of a colour-science multi-spectral distribution."""
    for wavelength, values in zip(functions.wavelengths, functions.values, strict=True):
        yield (float(wavelength), *(float(value) for value in values))


def column_rows(columns: Sequence[Any]) -> Iterable[Sequence[float | None]]:
    """Yield wavelength and values of colour-science distributions that differ in range."""
    tables = [
        dict(zip(map(float, column.wavelengths), map(float, column.values), strict=True))
        for column in columns
    ]
    for wavelength in sorted(set().union(*tables)):
        yield (wavelength, *(table.get(wavelength) for table in tables))


def main() -> None:
    """Write every table."""
    for name, source in OBSERVERS.items():
        write_table(name, ("nm", "x", "y", "z"), multi_rows(colour.MSDS_CMFS[source]))
    write_table(
        "illuminants",
        ("nm", *ILLUMINANTS),
        column_rows([colour.SDS_ILLUMINANTS[name] for name in ILLUMINANTS]),
    )
    components = SDS_BASIS_FUNCTIONS_CIE_ILLUMINANT_D_SERIES
    write_table("daylight", ("nm", *components), column_rows(list(components.values())))
    basis = MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019
    write_table("mallett2019", ("nm", *basis.labels), multi_rows(basis))


if __name__ == "__main__":
    main()
