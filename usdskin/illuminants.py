"""Lamps by name, by temperature and by file, on any wavelength grid.

Tables are those of ``usdskin/data`` (see ``SOURCES.md`` there).
"""

from __future__ import annotations

import csv
import difflib
import re
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import UsdSkinError
from usdskin.spectrum import band_edges, check_grid, resample

FloatArray = NDArray[np.float64]

TABLE_STEP_NM = 5.0
"""Widest band at which a function's value at the band centre stands for its average [nm]: sums
over 5 nm are the coarsest that CIE 015:2018 admits without averaging."""

_PLANCK = 6.62607015e-34  # [J s], exact (SI 2019)
_SPEED_OF_LIGHT = 299792458.0  # [m s^-1], exact
_BOLTZMANN = 1.380649e-23  # [J K^-1], exact
_SECOND_RADIATION_CONSTANT = _PLANCK * _SPEED_OF_LIGHT / _BOLTZMANN  # [m K]
# The D names were given on the scale where this constant was 1.4380e-2 m K (CIE 015:2018).
_DAYLIGHT_NAME_SCALE = _SECOND_RADIATION_CONSTANT / 1.4380e-2

_FINE_STEP_NM = 0.5
_MAX_FILE_BYTES = 16 * 1024 * 1024
_INSTRUMENT_SUFFIXES = (".cgats", ".sp", ".spdx", ".ti3", ".xml")
_TEMPERATURE = re.compile(r"^(\d+(?:\.\d+)?)K$")
_DAYLIGHT = re.compile(r"^D(\d{2,3})$")
_OLD_FLUORESCENT = re.compile(r"^F(\d.*)$")


@cache
def table(name: str) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Read one of the shipped tables.

    Args:
        name: File name without its ending.

    Returns:
        For every column its wavelengths [nm] and values, read-only, shape [row_count] each.
    """
    text = resources.files("usdskin").joinpath("data", f"{name}.csv").read_text("ascii")
    columns, *rows = csv.reader(text.splitlines())
    cells = np.array([[float(cell) if cell else np.nan for cell in row] for row in rows])
    result = {}
    for index, column in enumerate(columns[1:], start=1):
        rows_known = np.isfinite(cells[:, index])
        pair = cells[rows_known, 0], cells[rows_known, index]
        for array in pair:
            array.setflags(write=False)
        result[column] = pair
    return result


def illuminant_names() -> tuple[str, ...]:
    """Return the names that have a table, and ``E``."""
    return (*table("illuminants"), "E")


def illuminant(name: str, wavelength_nm: ArrayLike) -> FloatArray:
    """Return the relative spectral power of a lamp.

    Args:
        name: A CIE illuminant (``A``, ``D65``, ``FL2`` or ``F2``, ``FL3.7``, ``HP1``, ``LED-B3``,
            ...), any daylight ``D40`` to ``D250``, a black body such as ``3200K``, or the path of
            a text file with two columns, wavelength [nm] and value, or of an SPDX, TM-27 or CGATS
            file.
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].

    Returns:
        Band averages in the scale of the table or file, shape [band_count]; zero outside it.

    Raises:
        UsdSkinError: No such name, or a file that cannot be read as a spectrum on this grid.
    """
    known = _named(name, wavelength_nm)
    if known is None:
        known = resample(*_read_file(name), wavelength_nm)
    if not known.any():
        raise UsdSkinError(
            f"illuminant {name} has no power on the grid's wavelengths; give one that covers them"
        )
    return known


def _named(name: str, wavelength_nm: ArrayLike) -> FloatArray | None:
    """Return the spectrum of a lamp that is not a file."""
    key = name.strip().upper().replace("_", "-")
    key = _OLD_FLUORESCENT.sub(r"FL\1", key)
    if key == "E":
        return np.full(np.shape(wavelength_nm), 100.0)
    if key in table("illuminants"):
        return resample(*table("illuminants")[key], wavelength_nm)
    if match := _TEMPERATURE.match(key):
        radiance = planck_radiance(float(match[1]), wavelength_nm)
        relative: FloatArray = radiance / radiance.max()
        return relative
    if match := _DAYLIGHT.match(key):
        return daylight(100.0 * float(match[1]) * _DAYLIGHT_NAME_SCALE, wavelength_nm)
    return None


def daylight(cct: float, wavelength_nm: ArrayLike) -> FloatArray:
    """Return a phase of daylight, 100 at 560 nm (CIE 015:2018, illuminant D at other CCTs).

    Args:
        cct: Correlated colour temperature [K], 4000 to 25000.
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].

    Returns:
        Band averages, shape [band_count].

    Raises:
        UsdSkinError: The temperature is outside the range that daylight is defined for.
    """
    if not 4000.0 <= cct <= 25000.0:
        raise UsdSkinError(
            f"daylight is defined from 4000 K to 25000 K, not at {cct:g} K; "
            "use a black body for a warmer lamp"
        )
    if cct <= 7000.0:
        x = -4.6070e9 / cct**3 + 2.9678e6 / cct**2 + 0.09911e3 / cct + 0.244063
    else:
        x = -2.0064e9 / cct**3 + 1.9018e6 / cct**2 + 0.24748e3 / cct + 0.237040
    y = -3.0 * x**2 + 2.870 * x - 0.275
    scale = 0.0241 + 0.2562 * x - 0.7341 * y
    first = (-1.3515 - 1.7703 * x + 5.9114 * y) / scale
    second = (0.0300 - 31.4424 * x + 30.0717 * y) / scale
    components = table("daylight")
    nm, mean = components["S0"]
    power = mean + first * components["S1"][1] + second * components["S2"][1]
    return resample(nm, power, wavelength_nm)


def planck_radiance(temperature: float, wavelength_nm: ArrayLike) -> FloatArray:
    """Return the spectral radiance of a black body (Planck's law, SI constants of 2019).

    Args:
        temperature: Temperature [K], positive.
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].

    Returns:
        Radiance [W m^-2 sr^-1 nm^-1], shape [band_count]: at the centre of bands up to 5 nm wide,
        as CIE tables give it; averages of wider ones.

    Raises:
        UsdSkinError: The temperature is not a positive number.
    """
    if not (np.isfinite(temperature) and temperature > 0.0):
        raise UsdSkinError(f"a black body needs a temperature above 0 K, not {temperature:g} K")
    centers = np.asarray(wavelength_nm, dtype=np.float64)
    edges = band_edges(centers)
    if np.diff(edges).max() <= TABLE_STEP_NM + 1e-9:
        return _planck(temperature, centers)
    count = int(np.ceil((edges[-1] - edges[0]) / _FINE_STEP_NM)) + 1
    fine = np.linspace(max(edges[0], 1.0), edges[-1], count)
    return resample(fine, _planck(temperature, fine), centers, outside="hold")


def _planck(temperature: float, wavelength_nm: FloatArray) -> FloatArray:
    wavelength = wavelength_nm * 1e-9
    exponent = np.minimum(_SECOND_RADIATION_CONSTANT / (wavelength * temperature), 700.0)
    per_metre = 2.0 * _PLANCK * _SPEED_OF_LIGHT**2 / wavelength**5 / np.expm1(exponent)
    result: FloatArray = per_metre * 1e-9
    return result


def _read_file(name: str) -> tuple[FloatArray, FloatArray]:
    """Read a spectrum from a text file of two columns."""
    path = Path(name)
    if not path.is_file():
        close = difflib.get_close_matches(name.upper(), illuminant_names(), n=3, cutoff=0.4)
        hint = f" (near: {', '.join(close)})" if close else ""
        raise UsdSkinError(
            f"illuminant {name!r} is neither a known name{hint} nor a file; name a CIE illuminant "
            "such as D65, A or FL2, a temperature such as 3200K, or a file of wavelength, value"
        )
    if path.suffix.lower() in _INSTRUMENT_SUFFIXES:
        from usdskin.spectrafiles import single_spectrum

        return single_spectrum(path)
    if path.stat().st_size > _MAX_FILE_BYTES:
        raise UsdSkinError(f"{path}: larger than 16 MiB, so not a spectrum; give two columns")
    try:
        lines = path.read_text("utf-8-sig").splitlines()
    except (UnicodeDecodeError, OSError) as error:
        raise UsdSkinError(
            f"{path}: cannot be read as text ({error}); give a text file of wavelength, value"
        ) from None
    pairs = _parse_pairs(path, lines)
    wavelength_nm, value = np.array(pairs, dtype=np.float64).reshape(-1, 2).T
    if wavelength_nm.size < 2:
        raise UsdSkinError(f"{path}: fewer than two rows of wavelength [nm], value; add rows")
    try:
        check_grid(wavelength_nm)
    except ValueError as error:
        raise UsdSkinError(f"{path}: {error}; sort the rows by wavelength [nm]") from None
    worst = int(np.argmin(value))
    if not np.isfinite(value).all() or value[worst] < 0.0:
        bad = worst if np.isfinite(value).all() else int(np.flatnonzero(~np.isfinite(value))[0])
        raise UsdSkinError(
            f"{path}: value {value[bad]:g} at {wavelength_nm[bad]:g} nm; "
            "a lamp's power is finite and not negative"
        )
    return wavelength_nm, value


def _parse_pairs(path: Path, lines: list[str]) -> list[tuple[float, float]]:
    """Split rows at commas, semicolons or blanks; comments and one heading may come first."""
    pairs: list[tuple[float, float]] = []
    headings = 0
    for number, line in enumerate(lines, start=1):
        text = line.split("#", 1)[0].strip()
        if not text:
            continue
        cells = [cell for cell in re.split(r"[,;\s]+", text) if cell]
        try:
            if len(cells) != 2:
                raise ValueError
            pairs.append((float(cells[0]), float(cells[1])))
        except ValueError:
            headings += 1
            if pairs or headings > 1:
                raise UsdSkinError(
                    f"{path}:{number}: {text[:40]!r} is not a row of wavelength [nm], value"
                ) from None
    return pairs
