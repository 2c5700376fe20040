"""How a camera's three channels respond to light: measured spectral sensitivities.

Reads: a name of colour-science's data set, a JSON file in the layout of rawtoaces, or a text file
of four columns, wavelength [nm], R, G, B.
"""

from __future__ import annotations

import csv
import difflib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.spectrum import check_grid

DEFAULT_CAMERA = "Nikon 5100 (NPL)"

_MAX_FILE_BYTES = 4 * 1024 * 1024


@dataclass(frozen=True, slots=True, eq=False)
class CameraSensitivity:
    """Relative response of a camera to equal radiance in every band."""

    name: str
    """Make and model of the camera."""

    wavelength_nm: NDArray[np.float64]
    """Band centres [nm], strictly ascending, shape [band_count], at least two."""

    value: NDArray[np.float64]
    """Sensitivity of R, G and B, in any common scale [1], shape [band_count, 3]."""


def read_sensitivity(name: str) -> CameraSensitivity:
    """Return a measured camera.

    Args:
        name: A key of ``colour.MSDS_CAMERA_SENSITIVITIES``, or the path of a file.

    Raises:
        UsageError: No such camera or file, or what the file holds are no sensitivities.
    """
    if Path(name).suffix.lower() in (".json", ".csv", ".txt") or Path(name).is_file():
        return _read_file(Path(name))
    from colour import MSDS_CAMERA_SENSITIVITIES

    known = {str(key): value for key, value in MSDS_CAMERA_SENSITIVITIES.items()}
    if name not in known:
        close = difflib.get_close_matches(name, known, n=1, cutoff=0.3) or list(known)
        raise UsageError(
            f"--camera {name}: neither a file nor a camera of colour-science; did you mean "
            f'"{close[0]}"?'
        )
    measured = known[name]
    nm = np.array(measured.wavelengths, dtype=np.float64)
    return _checked(name, name, nm, np.array(measured.values, dtype=np.float64))


def _read_file(path: Path) -> CameraSensitivity:
    try:
        if path.stat().st_size > _MAX_FILE_BYTES:
            raise UsageError(f"{path}: larger than 4 MiB, so no camera; give three curves")
        text = path.read_text("utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise UsageError(
            f"{path}: cannot be read ({reason}); give a rawtoaces JSON file or columns of "
            "wavelength, R, G, B"
        ) from None
    if path.suffix.lower() == ".json":
        name, rows = _json_rows(path, text)
    else:
        name, rows = path.stem, _text_rows(path, text)
    table = np.array(sorted(rows), dtype=np.float64).reshape(-1, 4)
    return _checked(str(path), name, table[:, 0], table[:, 1:])


def _json_rows(path: Path, text: str) -> tuple[str, list[list[float]]]:
    """Return name and rows of the layout of https://github.com/AcademySoftwareFoundation/rawtoaces."""
    try:
        content: Any = json.loads(text)
        header, spectral = content["header"], content["spectral_data"]
        if spectral["index"]["main"] != ["R", "G", "B"]:
            raise ValueError("its channels are not R, G, B")
        rows = [
            [float(nm), *(float(value) for value in values)]
            for nm, values in spectral["data"]["main"].items()
        ]
        if any(len(row) != 4 for row in rows):
            raise ValueError("a wavelength has not three values")
        return f"{header['manufacturer']} {header['model']}", rows
    except (KeyError, TypeError, ValueError, AttributeError, RecursionError) as error:
        raise UsageError(
            f"{path}: no camera in the layout of rawtoaces ({type(error).__name__}: {error}); see "
            "its camera data for examples"
        ) from None


def _text_rows(path: Path, text: str) -> list[list[float]]:
    rows: list[list[float]] = []
    for number, cells in enumerate(csv.reader(text.splitlines()), start=1):
        given = [cell.strip() for cell in cells]
        if len(given) == 1:
            given = given[0].split()
        if not given or given[0].startswith("#"):
            continue
        try:
            if len(given) != 4:
                raise ValueError
            rows.append([float(cell) for cell in given])
        except ValueError:
            if rows or number > 1:  # one heading may come first
                raise UsageError(
                    f"{path}:{number}: not a row of wavelength [nm], R, G, B"
                ) from None
    return rows


def _checked(
    where: str, name: str, nm: NDArray[np.float64], value: NDArray[np.float64]
) -> CameraSensitivity:
    try:
        check_grid(nm)
    except ValueError as error:
        raise UsageError(f"{where}: {error}; give rows of wavelength [nm], R, G, B") from None
    if nm.size < 2 or value.shape != (nm.size, 3) or not np.isfinite(value).all():
        raise UsageError(f"{where}: not three finite curves over two or more wavelengths")
    if value.min() < 0.0 or not (value.max(axis=0) > 0.0).all():
        raise UsageError(f"{where}: a sensitivity is negative, or zero throughout; mend the curve")
    return CameraSensitivity(name.strip() or "camera", nm, value)
