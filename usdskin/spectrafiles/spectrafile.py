"""Named spectra of one file: as a reader found them, and as they are after all checks."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.spectrafiles.units import radiometric_unit
from usdskin.spectrum import SpectralQuantity

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class SpectraFile:
    """The spectra of one file, finite, not negative, wavelengths ascending."""

    path: Path
    """The file."""

    names: tuple[str, ...]
    """Names of the m patches or lamps, all different."""

    wavelength_nm: FloatArray
    """Sample positions [nm], strictly ascending, shape [n]."""

    values: FloatArray
    """Samples in the file's ``units``, shape [m, n]."""

    quantity: SpectralQuantity | None = None
    """What is measured, where the file says so."""

    units: str = ""
    """Unit of the values, as the file has it; empty where it says nothing."""

    metadata: Mapping[str, str] = field(default_factory=dict)
    """What else the file says, such as instrument, date, geometry; keys in lower case."""

    @property
    def is_absolute(self) -> bool:
        """Whether the file states a unit of radiance or irradiance."""
        return radiometric_unit(self.units) is not None


@dataclass(frozen=True, slots=True, eq=False)
class RawSpectra:
    """What a reader found, before any check, and where it stands in the file."""

    path: Path
    """The file."""

    names: tuple[str, ...]
    """Names of the m spectra as they are."""

    wavelength_nm: FloatArray
    """Sample positions [nm] in the file's order, shape [n]."""

    values: FloatArray
    """Samples, shape [m, n]."""

    lines: IntArray
    """Line of each sample, from 1, of a shape that broadcasts to [m, n]."""

    columns: IntArray
    """Column of each sample, from 1, 0 where the file has none, of a shape that broadcasts to
    [m, n]."""

    quantity: SpectralQuantity | None = None
    """What is measured, where the file says so."""

    units: str = ""
    """Unit of the values, as the file has it."""

    metadata: Mapping[str, str] = field(default_factory=dict)
    """What else the file says."""

    def where(self, spectrum: int, sample: int) -> str:
        """Return ``file:line, column``, for errors."""
        shape = self.values.shape
        line = int(np.broadcast_to(self.lines, shape)[spectrum, sample])
        column = int(np.broadcast_to(self.columns, shape)[spectrum, sample])
        return place(self.path, line, column)


def place(path: Path, line: int, column: int = 0) -> str:
    """Return ``file:line, column``, for errors; column 0 is not named."""
    return f"{path}:{line}, column {column}" if column else f"{path}:{line}"
