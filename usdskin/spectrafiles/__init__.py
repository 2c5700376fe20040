"""Spectra from the files of instruments.

Reads:  tables as text (``tables``), CGATS.17 and what ArgyllCMS makes of it (``cgats``), XML of
        IES TM-27, which is SPDX (``tm27``), and folders of these (``folder``). Content tells the
        kind, not the name of the file.
Gives:  ``SpectraFile``: named spectra on one wavelength grid, checked, in the file's own units;
        ``as_reflectances`` and ``as_radiances`` bring them to ours.
"""

from __future__ import annotations

from usdskin.spectrafiles.quantities import as_radiances, as_reflectances, single_spectrum
from usdskin.spectrafiles.read import read_spectra
from usdskin.spectrafiles.spectrafile import SpectraFile

__all__ = [
    "SpectraFile",
    "as_radiances",
    "as_reflectances",
    "read_spectra",
    "single_spectrum",
]
