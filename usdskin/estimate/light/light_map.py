"""A factorised spectral environment whose coefficients come a block of rows at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_to_rgb, xyz_weights

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

RENDITION_SPACE = "lin_rec709_scene"
"""Color space of the RGB rendition for other tools."""

_BLOCK_TEXELS = 1 << 18


@dataclass(frozen=True, slots=True, eq=False)
class LightMap:
    """Radiance ``sum_k c_k B_k`` of every texel of a latlong map (DESIGN, "Exact factorisation").

    Coefficients 3k, 3k + 1, 3k + 2 belong to class k of lamps.
    """

    height: int
    """Rows."""

    width: int
    """Columns."""

    basis: FloatArray
    """B [W m^-2 sr^-1 nm^-1 per coefficient, or relative], shape [rank, band_count]."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [band_count]."""

    is_absolute: bool
    """Whether radiance is in W m^-2 sr^-1 nm^-1."""

    classes: tuple[str, ...]
    """Names of the classes of lamps, one for every three rows of the basis."""

    blocks: Callable[[], Iterable[tuple[int, FloatImage]]]
    """Gives all blocks anew: first row, and coefficients c, shape [row_count, width, rank]."""

    @property
    def rank(self) -> int:
        """Number of coefficients."""
        return int(self.basis.shape[0])

    @property
    def xyz(self) -> FloatArray:
        """XYZ of the coefficients; Y in cd m^-2 where absolute, shape [rank, 3]."""
        return self.basis @ xyz_weights(self.wavelength_nm, absolute=self.is_absolute)

    @property
    def rgb(self) -> FloatArray:
        """Linear Rec. 709 values of the coefficients, without adaptation, shape [rank, 3]."""
        return self.xyz @ xyz_to_rgb(RENDITION_SPACE).T


def rows_per_block(width: int) -> int:
    """Return how many rows of a map are worked on at a time: whole chunks of 16."""
    return max(_BLOCK_TEXELS // width // 16, 1) * 16
