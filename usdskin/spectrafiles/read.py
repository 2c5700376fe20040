"""Read a file of spectra, whatever its kind, or a folder of them."""

from __future__ import annotations

import re
from pathlib import Path

from usdskin.errors import UsdSkinError
from usdskin.notes import Note
from usdskin.spectrafiles.cgats import is_cgats, read_cgats
from usdskin.spectrafiles.checks import check_spectra
from usdskin.spectrafiles.folder import read_folder
from usdskin.spectrafiles.spectrafile import SpectraFile
from usdskin.spectrafiles.tables import read_table
from usdskin.spectrafiles.tm27 import read_tm27

MAX_BYTES = 64 * 1024 * 1024
"""Largest file that is read; a chart of 140 patches at 1 nm has 1 MiB."""

_MAX_LINE = 2**20
"""Characters of the longest line; 140 patches at 1 nm side by side have 10 000."""

_XML_START = re.compile(rb"(\xef\xbb\xbf)?\s*<|\xff\xfe<\x00|\xfe\xff\x00<")
_FOREIGN = {
    b"PK\x03\x04": "an Excel workbook or an archive; save the table as CSV",
    b"\xd0\xcf\x11\xe0": "an old Excel workbook; save the table as CSV",
    b"MATLAB": "a MATLAB file; write the table as CSV",
    b"\x89HDF": "an HDF5 or MATLAB file; write the table as CSV",
    b"\x1f\x8b": "compressed; unpack it",
}
_CONTROL = re.compile(r"[\x00-\x08\x0e-\x19\x1b-\x1f\x7f]")


def read_spectra(path: str | Path, notes: list[Note] | None = None) -> SpectraFile:
    """Read the spectra of an instrument's file.

    Its content tells the kind: XML of IES TM-27 (SPDX), CGATS.17 with i1Profiler's and ArgyllCMS's
    ways of writing it, or a table of text that commas, semicolons, tabs or blanks separate, with
    the wavelengths along its rows or its columns.

    Args:
        path: The file, at most 64 MiB, or a folder with a file of one spectrum for each patch,
            which is named as its file.
        notes: What was changed on reading is appended here.

    Returns:
        Its spectra, checked (``usdskin.spectrafiles.checks``), in the units of the file.

    Raises:
        UsdSkinError: It cannot be read or used; the message names line, column and remedy.
    """
    notes = [] if notes is None else notes
    path = Path(path)
    if path.is_dir():
        return read_folder(path, notes, _read_file)
    return _read_file(path, notes)


def _read_file(path: Path, notes: list[Note]) -> SpectraFile:
    data = _content(path)
    if _XML_START.match(data):
        raw = read_tm27(path, data)
    else:
        text = _text(path, data)
        if not text.strip():
            raise UsdSkinError(f"{path}: is empty; export the spectra again")
        raw = read_cgats(path, text) if is_cgats(text) else read_table(path, text, notes)
    return check_spectra(raw, notes)


def _content(path: Path) -> bytes:
    if not path.is_file():
        raise UsdSkinError(f"{path}: is not there; name a file of spectra")
    try:
        with path.open("rb") as file:
            data = file.read(MAX_BYTES + 1)
    except OSError as error:
        raise UsdSkinError(f"{path}: cannot be read ({error.strerror})") from None
    if len(data) > MAX_BYTES:
        raise UsdSkinError(
            f"{path}: larger than {MAX_BYTES // 2**20} MiB, so not an instrument's file of spectra"
        )
    return data


def _text(path: Path, data: bytes) -> str:
    """Return the text with lines that end in a line feed.

    It is UTF-8, UTF-16 with its mark, or else Windows-1252 or Latin-1, as old instruments have it.
    """
    for mark, what in _FOREIGN.items():
        if data.startswith(mark):
            raise UsdSkinError(f"{path}: is {what}")
    try:
        if data.startswith((b"\xff\xfe", b"\xfe\xff")):
            text = data.decode("utf-16")
        else:
            text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    text = text.removesuffix("\x1a").replace("\r\n", "\n").replace("\r", "\n")
    if found := _CONTROL.search(text):
        number = text.count("\n", 0, found.start()) + 1
        raise UsdSkinError(
            f"{path}:{number}: is not text; export the spectra as CSV, CGATS or SPDX"
        )
    for number, line in enumerate(text.split("\n"), start=1):
        if len(line) > _MAX_LINE:
            raise UsdSkinError(f"{path}:{number}: a line of more than 1 MiB is no spectra")
    return text
