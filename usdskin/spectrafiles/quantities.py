"""Bring the spectra of a file to the quantities and units of this project."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsdSkinError
from usdskin.notes import Note
from usdskin.spectrafiles.read import read_spectra
from usdskin.spectrafiles.spectrafile import SpectraFile
from usdskin.spectrafiles.units import PERCENT, RELATIVE, radiometric_unit
from usdskin.spectrum import SpectralQuantity

FloatArray = NDArray[np.float64]

MAX_REFLECTANCE = 1.2
"""Largest reflectance of a real patch [1]: fluorescent ones reach 1.1 at their peak."""

PERCENT_RANGE = (2.0, 150.0)
"""Where the largest value of a file of reflectances lies if it is in percent."""

_POWERS = (SpectralQuantity.RADIANCE, SpectralQuantity.IRRADIANCE, SpectralQuantity.RELATIVE)
_SHARES = (SpectralQuantity.REFLECTANCE, SpectralQuantity.TRANSMITTANCE)


def as_reflectances(file: SpectraFile, notes: list[Note]) -> FloatArray:
    """Return the spectra of a file as reflectances.

    Values are percent where the file says so, or where the largest lies in 2 to 150; a largest
    value up to 1.2 is a share, as fluorescent patches have it.

    Args:
        file: What ``read_spectra`` returned.
        notes: A division by 100 is appended here.

    Returns:
        Reflectances [1], shape [m, n].

    Raises:
        UsdSkinError: The file says that it holds something else, or its values are neither shares
            nor percent.
    """
    _refuse(file, (*_POWERS, SpectralQuantity.TRANSMITTANCE, SpectralQuantity.RESPONSIVITY))
    if radiometric_unit(file.units) is not None:
        raise UsdSkinError(f"{file.path}: is in {file.units}, no reflectance; name another file")
    peak = float(file.values.max())
    is_stated = file.units.casefold() in PERCENT
    values = file.values
    if is_stated or PERCENT_RANGE[0] <= peak <= PERCENT_RANGE[1]:
        why = "as the file says" if is_stated else f"since the largest is {peak:g}"
        message = f"values were taken as percent and divided by 100, {why}"
        notes.append(Note("percent-divided", str(file.path), message))
        values = 0.01 * file.values
    if (largest := float(values.max())) > MAX_REFLECTANCE:
        spectrum, sample = np.unravel_index(int(np.argmax(values)), values.shape)
        raise UsdSkinError(
            f"{file.path}: {file.names[spectrum]!r} reflects {largest:g} at "
            f"{file.wavelength_nm[sample]:g} nm, neither a share nor percent; give shares of 1"
        )
    return values


def as_radiances(file: SpectraFile, notes: list[Note]) -> FloatArray:
    """Return the spectra of a file as radiances.

    Args:
        file: What ``read_spectra`` returned.
        notes: A change of unit is appended here.

    Returns:
        Radiance [W m^-2 sr^-1 nm^-1] where ``file.is_absolute``, else in the file's own scale,
        shape [m, n].

    Raises:
        UsdSkinError: The file says that it holds something else, or its unit is not known.
    """
    _refuse(file, (*_SHARES, SpectralQuantity.IRRADIANCE, SpectralQuantity.RESPONSIVITY))
    return _powers(file, notes, "W m^-2 sr^-1 nm^-1")


def single_spectrum(
    path: str | Path, notes: list[Note] | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the one spectrum of a lamp's file.

    Args:
        path: A file that ``read_spectra`` can read.
        notes: What was changed is appended here.

    Returns:
        Wavelengths [nm], strictly ascending, shape [n], and power, in W, m, sr and nm where the
        file states a unit, shape [n].

    Raises:
        UsdSkinError: It cannot be read, holds more than one spectrum, or none of a lamp.
    """
    notes = [] if notes is None else notes
    file = read_spectra(path, notes)
    if len(file.names) > 1:
        listed = ", ".join(file.names[:4]) + (", ..." if len(file.names) > 4 else "")
        raise UsdSkinError(
            f"{file.path}: holds {len(file.names)} spectra ({listed}); keep the lamp's only"
        )
    _refuse(file, (*_SHARES, SpectralQuantity.RESPONSIVITY))
    return file.wavelength_nm, _powers(file, notes, "W, m, sr and nm")[0]


def _refuse(file: SpectraFile, quantities: tuple[SpectralQuantity, ...]) -> None:
    if file.quantity in quantities:
        raise UsdSkinError(
            f"{file.path}: holds {file.quantity.value}, which is not wanted here; "
            "name a file of the right quantity"
        )


def _powers(file: SpectraFile, notes: list[Note], ours: str) -> FloatArray:
    """Return values in W, m, sr and nm where the file has a unit."""
    unit = radiometric_unit(file.units)
    if unit is None:
        if file.units and file.units.casefold().strip("[]() ") not in RELATIVE:
            raise UsdSkinError(
                f"{file.path}: unit {file.units[:40]!r} is none of spectral power that is known; "
                "write it as W m^-2 sr^-1 nm^-1, or as relative"
            )
        return file.values
    if unit[0] == 1.0:
        return file.values
    message = f"values in {file.units} were multiplied by {unit[0]:g} to be in {ours}"
    notes.append(Note("unit-changed", str(file.path), message))
    return unit[0] * file.values
