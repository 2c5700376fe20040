"""Reflectance of human skin from its pigments: an absorbing epidermis over a scattering dermis.

The epidermis holds melanin and only absorbs; the dermis holds blood, scatters, and has no far side.
Nothing is fitted to a data set: the figures are published ones, named where they stand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

WAVELENGTH_NM = np.arange(380.0, 731.0, 10.0)
"""Grid of the spectra that go into layers [nm]."""

# S. A. Prahl, "Tabulated molar extinction coefficient for hemoglobin in water", Oregon Medical
# Laser Center, 1998; base 10 [cm^-1 M^-1]: oxygenated, deoxygenated. The 2 nm table was read at
# the bands and turning points that follow.
_PRAHL = np.array(
    [
        (380, 109564.0, 239440.0), (390, 167748.0, 223296.0), (400, 266232.0, 223296.0),
        (410, 466840.0, 303956.0), (420, 480360.0, 407560.0), (430, 246072.0, 528600.0),
        (440, 102580.0, 413280.0), (450, 62816.0, 103292.0), (460, 44480.0, 23388.8),
        (470, 33209.2, 16156.4), (480, 26629.2, 14550.0), (490, 23684.4, 16684.0),
        (500, 20932.8, 20862.0), (510, 20035.2, 25773.6), (520, 24202.4, 31589.6),
        (530, 39956.8, 39036.4), (540, 53236.0, 46592.0), (550, 43016.0, 53412.0),
        (560, 32613.2, 53788.0), (570, 44496.0, 45072.0), (580, 50104.0, 37020.0),
        (590, 14400.8, 28324.4), (600, 3200.0, 14677.2), (610, 1506.0, 9443.6),
        (620, 942.0, 6509.6), (630, 610.0, 5148.8), (640, 442.0, 4345.2), (650, 368.0, 3750.12),
        (660, 319.6, 3226.56), (670, 294.0, 2795.12), (680, 277.6, 2407.92),
        (690, 276.0, 2051.96), (700, 290.0, 1794.28), (710, 314.0, 1540.48),
        (720, 348.0, 1325.88), (730, 390.0, 1102.2),
    ]
)  # fmt: skip
