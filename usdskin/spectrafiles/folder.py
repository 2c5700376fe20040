"""Read a folder of files with one spectrum each, as spectroradiometers and TM-27 write them."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import numpy as np

from usdskin.errors import UsdSkinError
from usdskin.notes import Note
from usdskin.spectrafiles.spectrafile import SpectraFile

_MAX_FILES = 2000


def read_folder(
    path: Path, notes: list[Note], read: Callable[[Path, list[Note]], SpectraFile]
) -> SpectraFile:
    """Read the files of a folder as the spectra of one chart, each named as its file.

    Args:
        path: Folder; hidden files and folders in it are passed over.
        notes: What was changed on reading is appended here.
        read: Reads one file.

    Returns:
        Their spectra in the order of the files' names, numbers in them by value.

    Raises:
        UsdSkinError: There is no file, one has several spectra, or they differ in wavelengths,
            quantity or unit.
    """
    files = sorted(
        (entry for entry in path.iterdir() if entry.is_file() and not entry.name.startswith(".")),
        key=_by_number,
    )
    if not 0 < len(files) <= _MAX_FILES:
        raise UsdSkinError(
            f"{path}: a folder of {len(files)} files; name a file of spectra, or a folder with a "
            "file for each patch"
        )
    spectra = [read(file, notes) for file in files]
    first = spectra[0]
    stems: dict[str, Path] = {}
    for spectrum in spectra:
        before = stems.setdefault(spectrum.path.stem, spectrum.path)
        if before is not spectrum.path:
            raise UsdSkinError(
                f"{spectrum.path}: named as {before.name} is; keep one file for each patch"
            )
        if len(spectrum.names) != 1:
            raise UsdSkinError(
                f"{spectrum.path}: holds {len(spectrum.names)} spectra; name this file alone, or "
                "keep files with one each"
            )
        if not np.array_equal(spectrum.wavelength_nm, first.wavelength_nm):
            what = "wavelengths"
        elif (spectrum.quantity, spectrum.units) != (first.quantity, first.units):
            what = "quantity or unit"
        else:
            continue
        raise UsdSkinError(
            f"{spectrum.path}: other {what} than {first.path.name}; export all patches alike"
        )
    return SpectraFile(
        path=path,
        names=tuple(stems),
        wavelength_nm=first.wavelength_nm,
        values=np.concatenate([spectrum.values for spectrum in spectra]),
        quantity=first.quantity,
        units=first.units,
        metadata=first.metadata,
    )


def _by_number(path: Path) -> list[tuple[int, int, str]]:
    """Order ``patch2`` before ``patch10``."""
    parts = re.findall(r"[0-9]+|[^0-9]+", path.name)
    return [(0, int(part), part) if part.isdigit() else (1, 0, part) for part in parts]
