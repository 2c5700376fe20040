"""The charts that a virtual photographer can bring along: their patches and reflectances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.notes import Note

FloatArray = NDArray[np.float64]

CLASSIC_SET = "ColorChecker N Ohta"
"""The measurement of a classic chart that is used: N. Ohta's, 380 to 780 nm in steps of 5 nm, as
colour-science holds it."""

GAP = 0.1
"""Width of the gap between patches, as a share of a patch's side."""


@dataclass(frozen=True, slots=True)
class Grid:
    """How the patches of a chart lie."""

    layout: str
    """Name of the layout."""

    columns: int
    """Patches from left to right."""

    rows: int
    """Patches from top to bottom."""

    by_columns: bool
    """Whether the makers number them down the columns, not along the rows."""

    @property
    def places(self) -> NDArray[np.intp]:
        """Column and row of every patch, from the top left, shape [patch_count, 2]."""
        if self.by_columns:
            return np.array([(c, r) for c in range(self.columns) for r in range(self.rows)])
        return np.array([(c, r) for r in range(self.rows) for c in range(self.columns)])

    @property
    def size(self) -> FloatArray:
        """Width and height over the outermost patches, in sides of a patch, shape [2]."""
        count = np.array([self.columns, self.rows], dtype=np.float64)
        return np.asarray(count + (count - 1.0) * GAP)


CLASSIC = Grid("classic24", 6, 4, by_columns=False)
"""The 24 patches of McCamy, Marcus and Davidson, "A color-rendition chart", 1976."""

DIGITAL_SG = Grid("sg140", 14, 10, by_columns=True)
"""The 140 patches of the Digital SG: A1 .. A10 down the first column, then B1 .."""

_GRIDS = {24: CLASSIC, 140: DIGITAL_SG}


@dataclass(frozen=True, slots=True, eq=False)
class Chart:
    """A flat, matte chart."""

    name: str
    """Maker and type, or where its reflectances come from."""

    grid: Grid
    """How its patches lie."""

    patches: tuple[str, ...]
    """Names of the patches, in the makers' order, shape [patch_count]."""

    wavelength_nm: FloatArray
    """Wavelengths of the reflectances [nm], shape [n]."""

    reflectances: FloatArray
    """Reflectance of the patches [1], shape [patch_count, n]."""


def read_chart(source: str, notes: list[Note] | None = None) -> Chart:
    """Return a chart.

    Args:
        source: ``classic24``, or the path of a file with the reflectances of 24 or 140 patches in
            the makers' order, as ``usdskin.spectrafiles`` reads it.
        notes: Takes what was assumed of a file.

    Raises:
        UsageError: There is no such chart, or the file has another number of patches.
        UsdSkinError: The file cannot be read.
    """
    if source == CLASSIC.layout:
        return _classic()
    if source == DIGITAL_SG.layout:
        raise UsageError(
            f"--chart {source}: no reflectances of a Digital SG come with us; name a file with the "
            "140 spectra of yours"
        )
    if not Path(source).is_file():
        raise UsageError(
            f"--chart {source}: neither classic24 nor a file; name a file with the reflectances of "
            "24 or 140 patches"
        )
    from usdskin.spectrafiles import as_reflectances, read_spectra

    notes = [] if notes is None else notes
    found = read_spectra(Path(source), notes)
    values = as_reflectances(found, notes)
    if len(values) not in _GRIDS:
        raise UsageError(
            f"--chart {source}: has {len(values)} patches; give the 24 of a classic chart or the "
            "140 of a Digital SG"
        )
    return chart_of(Path(source).stem, found.names, found.wavelength_nm, values)


def _classic() -> Chart:
    from colour import SDS_COLOURCHECKERS

    spectra = SDS_COLOURCHECKERS[CLASSIC_SET]
    return chart_of(
        CLASSIC_SET,
        list(spectra),
        np.array(next(iter(spectra.values())).wavelengths, dtype=np.float64),
        np.array([spectrum.values for spectrum in spectra.values()], dtype=np.float64),
    )


def chart_of(
    name: str, patches: Sequence[str], wavelength_nm: FloatArray, reflectances: FloatArray
) -> Chart:
    """Return a chart of 24 or 140 patches from its spectra.

    Args:
        name: What it is called.
        patches: Names of the patches, in the makers' order.
        wavelength_nm: Wavelengths [nm], shape [n].
        reflectances: Reflectance [1], shape [patch_count, n].

    Raises:
        ValueError: The numbers do not fit.
    """
    grid = _GRIDS.get(len(patches))
    if grid is None or reflectances.shape != (len(patches), wavelength_nm.size):
        raise ValueError(f"{len(patches)} patches with spectra of shape {reflectances.shape}")
    return Chart(name, grid, tuple(patches), wavelength_nm, reflectances)
