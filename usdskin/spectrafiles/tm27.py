"""Read XML of IES TM-27, which is also called SPDX (ANSI/IES TM-27-14 and TM-27-20).

The parser is Expat and takes no document type definition, hence no entities.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

import numpy as np

from usdskin.errors import UsdSkinError
from usdskin.spectrafiles.labels import number
from usdskin.spectrafiles.spectrafile import RawSpectra, place
from usdskin.spectrum import SpectralQuantity

_MAX_DEPTH = 16
_MAX_TEXT = 64 * 1024
"""Characters of one element: comments may be long, data are not."""

_ROOT = re.compile(r"IESTM27\d*", re.IGNORECASE)
_QUANTITIES = {
    "reflectance": (SpectralQuantity.REFLECTANCE, ""),
    "transmittance": (SpectralQuantity.TRANSMITTANCE, ""),
    "irradiance": (SpectralQuantity.IRRADIANCE, "W m^-2 nm^-1"),
    "radiance": (SpectralQuantity.RADIANCE, "W m^-2 sr^-1 nm^-1"),
    "exitance": (SpectralQuantity.RELATIVE, ""),
    "flux": (SpectralQuantity.RELATIVE, ""),
    "intensity": (SpectralQuantity.RELATIVE, ""),
    "relative": (SpectralQuantity.RELATIVE, ""),
    "other": (SpectralQuantity.RELATIVE, ""),
}
"""Values of SpectralQuantity (TM-27-14, section 4.3) that are powers or shares of power: what
they are to us, and the unit the standard prescribes."""


@dataclass(slots=True)
class _Distribution:
    """One SpectralDistribution while it is read."""

    line: int
    statements: dict[str, str] = field(default_factory=dict)
    samples: list[tuple[int, str, str]] = field(default_factory=list)
    """Line, wavelength and value of every SpectralData."""


class _Handler:
    """Collects what a document says."""

    def __init__(self, path: Path, parser: expat.XMLParserType) -> None:
        self.header: dict[str, str] = {}
        self.distributions: list[_Distribution] = []
        self._path = path
        self._parser = parser
        self._stack: list[str] = []
        self._wavelength = ""
        self._text: list[str] = []
        self._length = 0

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Enter an element."""
        name = tag.rpartition(" ")[2]
        line = self._parser.CurrentLineNumber
        if not self._stack and not _ROOT.fullmatch(name):
            raise UsdSkinError(
                f"{self._path}:{line}: XML of <{name[:40]}>, not of IES TM-27; "
                "export the spectra as SPDX, CGATS or CSV"
            )
        if len(self._stack) >= _MAX_DEPTH:
            raise UsdSkinError(f"{self._path}:{line}: elements nested too deeply for IES TM-27")
        self._stack.append(name)
        self._text, self._length = [], 0
        self._wavelength = attributes.get("wavelength", "")
        if name == "SpectralDistribution":
            self.distributions.append(_Distribution(line))

    def text(self, characters: str) -> None:
        """Take a part of an element's text."""
        self._length += len(characters)
        if self._length > _MAX_TEXT:
            line = self._parser.CurrentLineNumber
            raise UsdSkinError(f"{self._path}:{line}: an element with more than 64 KiB of text")
        self._text.append(characters)

    def end(self, tag: str) -> None:
        """Leave an element."""
        name = self._stack.pop()
        text = "".join(self._text).strip()
        self._text, self._length = [], 0
        if "Header" in self._stack and text:
            self.header[name.lower()] = text
        elif "SpectralDistribution" in self._stack and self.distributions:
            distribution = self.distributions[-1]
            if name == "SpectralData":
                line = self._parser.CurrentLineNumber
                distribution.samples.append((line, self._wavelength, text))
            elif text:
                distribution.statements[name.lower()] = text

    def refuse_doctype(self, *_: object) -> None:
        """Refuse a document type definition."""
        line = self._parser.CurrentLineNumber
        raise UsdSkinError(
            f"{self._path}:{line}: has a DOCTYPE, which IES TM-27 does not; remove it"
        )


def read_tm27(path: Path, data: bytes) -> RawSpectra:
    """Read the spectral distributions of a document.

    Args:
        path: Names the file in errors.
        data: Its content.

    Raises:
        UsdSkinError: It is no XML, not of IES TM-27, cut short, or its distributions have no
            samples, other wavelengths than one another or a quantity counted in photons.
    """
    parser = expat.ParserCreate(namespace_separator=" ")
    handler = _Handler(path, parser)
    parser.StartElementHandler = handler.start
    parser.EndElementHandler = handler.end
    parser.CharacterDataHandler = handler.text
    parser.StartDoctypeDeclHandler = handler.refuse_doctype
    try:
        parser.Parse(data, True)
    except expat.ExpatError as error:
        what = expat.errors.messages[error.code]
        raise UsdSkinError(
            f"{path}:{error.lineno}: XML that cannot be read ({what}); copy or export it again"
        ) from None
    except (LookupError, ValueError) as error:
        raise UsdSkinError(f"{path}:1: XML in an encoding that is not known ({error})") from None
    if not handler.distributions:
        raise UsdSkinError(f"{path}: no SpectralDistribution in it; export the file again")
    return _spectra(path, handler)


def _spectra(path: Path, handler: _Handler) -> RawSpectra:
    distributions = handler.distributions
    first = distributions[0]
    tables = [_samples(path, distribution) for distribution in distributions]
    for distribution, table in zip(distributions, tables, strict=True):
        if not np.array_equal(table[0], tables[0][0]):
            raise UsdSkinError(
                f"{place(path, distribution.line)}: other wavelengths than the distribution before "
                "it; keep each in a file of its own"
            )
    quantities = {item.statements.get("spectralquantity", "").lower() for item in distributions}
    if len(quantities) > 1:
        raise UsdSkinError(
            f"{path}: distributions of different quantities ({', '.join(sorted(quantities))}); "
            "keep each in a file of its own"
        )
    stated = quantities.pop()
    if stated and stated not in _QUANTITIES:
        raise UsdSkinError(
            f"{path}:{first.line}: SpectralQuantity {stated[:40]!r} is no power or share of it; "
            f"convert it to one of {', '.join(_QUANTITIES)}"
        )
    quantity, units = _QUANTITIES.get(stated, (None, ""))
    header = handler.header
    title = next(
        (header[key] for key in ("description", "catalognumber") if _says(header.get(key))),
        path.stem,
    )
    count = len(distributions)
    return RawSpectra(
        path=path,
        names=(title,) if count == 1 else tuple(f"{title} {1 + index}" for index in range(count)),
        wavelength_nm=tables[0][0],
        values=np.stack([table[1] for table in tables]),
        lines=np.array([[line for line, _, _ in item.samples] for item in distributions]),
        columns=np.zeros((1, 1), dtype=np.int64),
        quantity=quantity,
        units=units,
        metadata={**header, **first.statements},
    )


def _says(text: str | None) -> bool:
    return text is not None and text.casefold() not in ("", "n/a", "unknown")


def _samples(
    path: Path, distribution: _Distribution
) -> tuple[np.ndarray[tuple[int], np.dtype[np.float64]], ...]:
    """Return wavelengths [nm] and values of a distribution."""
    if not distribution.samples:
        raise UsdSkinError(
            f"{place(path, distribution.line)}: a SpectralDistribution without SpectralData"
        )
    table = []
    for line, wavelength, value in distribution.samples:
        pair = number(wavelength), number(value)
        if pair[0] is None or pair[1] is None or not 0.0 < pair[0] < 1e6:
            raise UsdSkinError(
                f"{place(path, line)}: SpectralData of wavelength {wavelength[:40]!r} and value "
                f"{value[:40]!r}; both are numbers, the wavelength in nanometres"
            )
        table.append(pair)
    wavelength_nm, values = np.array(table, dtype=np.float64).T
    return wavelength_nm, values
