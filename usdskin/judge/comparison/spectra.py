"""Two spectral pictures on one grid: their colours, and how far their spectra lie apart.

Rows are read a block at a time: two pictures of 61 bands need not fit in memory.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import Observer, xyz_weights
from usdskin.differences import goodness_of_fit
from usdskin.errors import ImageError
from usdskin.judge.comparison.files import ComparedPicture, spectral_rows
from usdskin.spectrum import band_edges, resample

FloatArray = NDArray[np.float64]

_ROWS_PER_BLOCK = 32
_SAME_NM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class SpectralPair:
    """What is known of each pixel of two spectral pictures."""

    truth_xyz: FloatArray
    """XYZ [cd m^-2, or relative], shape [height, width, 3]."""

    picture_xyz: FloatArray
    """XYZ, shape [height, width, 3]."""

    squared_error: FloatArray
    """Mean over the bands of the squared difference, shape [height, width]."""

    peak: FloatArray
    """Largest value of the true spectrum, shape [height, width]."""

    fit: FloatArray
    """Goodness of fit, shape [height, width]."""

    grid: str
    """The grid both were brought to, in words."""

    resampled: bool
    """Whether their own grids differ."""


def common_grid(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return the coarser of two grids, within the range of both.

    Args:
        first: Band centres [nm], strictly ascending, shape [n].
        second: Band centres [nm], strictly ascending, shape [m].

    Raises:
        ImageError: They share less than two bands.
    """
    if _same(first, second):
        return first
    low = max(band_edges(grid)[0] for grid in (first, second))
    high = min(band_edges(grid)[-1] for grid in (first, second))
    coarse = max((first, second), key=lambda grid: float(np.diff(grid).mean()))
    edges = band_edges(coarse)
    inside = (edges[:-1] >= low - _SAME_NM) & (edges[1:] <= high + _SAME_NM)
    if inside.sum() < 2:
        raise ImageError(
            f"the spectra share no range: {first[0]:g} to {first[-1]:g} nm and {second[0]:g} to "
            f"{second[-1]:g} nm; render both over the same wavelengths."
        )
    return np.asarray(coarse[inside])


def compare_spectra(
    truth: ComparedPicture, picture: ComparedPicture, observer: Observer, absolute: bool
) -> SpectralPair:
    """Return colours and differences of two spectral pictures of one size.

    Args:
        truth: What is compared with.
        picture: What is judged.
        observer: Whose colour-matching functions.
        absolute: Whether radiance is in W m^-2 sr^-1 nm^-1.

    Raises:
        ImageError: A file is broken, or their grids share no range.
    """
    grids = [truth.wavelength_nm, picture.wavelength_nm]
    grid = common_grid(*grids)
    weights = xyz_weights(grid, observer, absolute)
    width, height = truth.size
    xyz = [np.empty((height, width, 3)) for _ in grids]
    squared, peak, fit = (np.empty((height, width)) for _ in range(3))
    with spectral_rows(truth) as one, spectral_rows(picture) as other:
        for begin in range(0, height, _ROWS_PER_BLOCK):
            rows = slice(begin, min(begin + _ROWS_PER_BLOCK, height))
            spectra = [
                _on(reader.rows(rows.start, rows.stop), own, grid)
                for reader, own in zip((one, other), grids, strict=True)
            ]
            for colors, values in zip(xyz, spectra, strict=True):
                colors[rows] = values @ weights
            with np.errstate(invalid="ignore", over="ignore"):
                squared[rows] = ((spectra[1] - spectra[0]) ** 2).mean(axis=-1)
                peak[rows] = spectra[0].max(axis=-1)
                found = goodness_of_fit(spectra[1], spectra[0])
                fit[rows] = np.where(squared[rows] == 0.0, 1.0, found)  # black on black too
    said = f"{grid.size} bands, {grid[0]:g} to {grid[-1]:g} nm"
    return SpectralPair(xyz[0], xyz[1], squared, peak, fit, said, not _same(*grids))


def _same(first: FloatArray, second: FloatArray) -> bool:
    same_size = first.size == second.size
    return same_size and bool(np.allclose(first, second, rtol=0.0, atol=_SAME_NM))


def _on(values: NDArray[np.float32], own: FloatArray, grid: FloatArray) -> FloatArray:
    spectra = np.asarray(values, dtype=np.float64)
    return spectra if _same(own, grid) else resample(own, spectra, grid)
