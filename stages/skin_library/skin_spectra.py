"""Spectra of human skin from its pigments: an epidermis with melanin over a dermis with blood.

Both scatter; the dermis has no far side. Nothing is fitted to a data set: the figures are published
ones, named where they stand.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

WAVELENGTH_NM = np.arange(380.0, 731.0, 5.0)
"""Grid of the spectra that go into layers [nm]."""

# S. A. Prahl, "Tabulated molar extinction coefficient for hemoglobin in water", Oregon Medical
# Laser Center, 1998: wavelength [nm], oxygenated, deoxygenated [cm^-1 M^-1], to base 10. Every
# tenth nanometre of the table, and the turning points between.
_PRAHL = np.array(
    [
        (380, 109564.0, 145232.0), (390, 167748.0, 167780.0), (400, 266232.0, 223296.0),
        (410, 466840.0, 303956.0), (414, 524280.0, 342596.0), (420, 480360.0, 407560.0),
        (430, 246072.0, 528600.0), (434, 202632.0, 552160.0), (440, 102580.0, 413280.0),
        (450, 62816.0, 103292.0), (460, 44480.0, 23388.8), (470, 33209.2, 16156.4),
        (480, 26629.2, 14550.0), (490, 23684.4, 16684.0), (500, 20932.8, 20862.0),
        (510, 20035.2, 25773.6), (520, 24202.4, 31589.6), (530, 39956.8, 39036.4),
        (536, 49752.0, 43592.0), (542, 53292.0, 48148.0), (550, 43016.0, 53412.0),
        (556, 34476.8, 54540.0), (560, 32613.2, 53788.0), (566, 36495.2, 48828.0),
        (570, 44496.0, 45072.0), (576, 55540.0, 40092.0), (580, 50104.0, 37020.0),
        (590, 14400.8, 28324.4), (600, 3200.0, 14677.2), (610, 1506.0, 9443.6),
        (620, 942.0, 6509.6), (630, 610.0, 5148.8), (640, 442.0, 4345.2), (650, 368.0, 3750.12),
        (660, 319.6, 3226.56), (670, 294.0, 2795.12), (680, 277.6, 2407.92),
        (690, 276.0, 2051.96), (700, 290.0, 1794.28), (710, 314.0, 1540.48),
        (720, 348.0, 1325.88), (730, 390.0, 1102.2),
    ]
)  # fmt: skip

_HEMOGLOBIN_MOLAR = 150.0 / 64500.0
"""Haemoglobin in whole blood [mol/l]: 150 g/l of 64500 g/mol (Prahl, same page)."""

EPIDERMIS_M = 60e-6
"""Thickness of the epidermis [m]: Jacques, "Skin optics", 1998."""

SCATTERED, REACH_M = 0.62, 1.0e-3
"""Ss is ``SCATTERED`` where light goes far in skin, half of it where it fades over ``REACH_M``."""

_VESSEL_RADIUS_M = 15e-6
"""Radius of the vessels of the dermis [m]: between capillaries (4e-6) and venules (25e-6)."""


@dataclass(frozen=True, slots=True)
class Pigments:
    """What colors a patch of skin."""

    melanin: float
    """Volume fraction of melanosomes in the epidermis [1]."""

    blood: float
    """Volume fraction of blood in the dermis [1]."""

    oxygenation: float = 0.75
    """Share of the haemoglobin that carries oxygen [1]."""

    epidermis_scattering: float = 1.0
    """Scattering of the epidermis relative to the dermis' [1]; 0 makes it a mere filter."""


def blood_absorption(wavelength_nm: ArrayLike, oxygenation: float) -> FloatArray:
    """Return the absorption coefficient of whole blood [m^-1], shape [band_count]."""
    nm = np.asarray(wavelength_nm, float)
    with_oxygen = np.interp(nm, _PRAHL[:, 0], _PRAHL[:, 1])
    without = np.interp(nm, _PRAHL[:, 0], _PRAHL[:, 2])
    molar = oxygenation * with_oxygen + (1.0 - oxygenation) * without
    return np.log(10.0) * molar * _HEMOGLOBIN_MOLAR * 100.0


def tissue_absorption(wavelength_nm: ArrayLike) -> FloatArray:
    """Return the absorption coefficient of skin without blood and melanin [m^-1].

    I. S. Saidi's fit, as quoted by S. L. Jacques, "Skin optics", Oregon Medical Laser Center
    News, January 1998: 0.244 + 85.3 exp(-(nm - 154) / 66.2) [cm^-1].
    """
    nm = np.asarray(wavelength_nm, float)
    return 100.0 * (0.244 + 85.3 * np.exp(-(nm - 154.0) / 66.2))


def melanosome_absorption(wavelength_nm: ArrayLike) -> FloatArray:
    """Return the absorption coefficient of a melanosome's inside [m^-1].

    Jacques, "Skin optics", 1998: 6.6e11 nm^-3.33 [cm^-1].
    """
    return 100.0 * 6.6e11 * np.asarray(wavelength_nm, float) ** -3.33


def reduced_scattering(wavelength_nm: ArrayLike) -> FloatArray:
    """Return the reduced scattering coefficient of skin [m^-1].

    S. L. Jacques, "Optical properties of biological tissues: a review", Phys. Med. Biol. 58
    (2013), table 1, skin: 46.0 (nm / 500)^-1.421 [cm^-1].
    """
    return 100.0 * 46.0 * (np.asarray(wavelength_nm, float) / 500.0) ** -1.421


def dermis_absorption(wavelength_nm: ArrayLike, pigments: Pigments) -> FloatArray:
    """Return the absorption coefficient of the dermis [m^-1].

    Blood is in vessels, whose middle sees less light than their wall: its absorption a counts
    (1 - exp(-2 a r)) / (2 a r) times, r being the vessel's radius (R. L. P. van Veen, W.
    Verkruysse and H. J. C. M. Sterenborg, Optics Letters 27 (2002), 246-248).
    """
    blood = blood_absorption(wavelength_nm, pigments.oxygenation)
    across = 2.0 * blood * _VESSEL_RADIUS_M
    seen = pigments.blood * blood * -np.expm1(-across) / across
    return seen + (1.0 - pigments.blood) * tissue_absorption(wavelength_nm)


def effective_attenuation(wavelength_nm: ArrayLike, pigments: Pigments) -> FloatArray:
    """Return how fast diffuse light fades with depth: sqrt(3 a (a + s')) [m^-1].

    The diffusion approximation's decay, Jacques 2013, eq. 11.
    """
    absorption = dermis_absorption(wavelength_nm, pigments)
    scattering = reduced_scattering(wavelength_nm)
    return np.sqrt(3.0 * absorption * (absorption + scattering))


def dermis_reflectance(wavelength_nm: ArrayLike, pigments: Pigments) -> FloatArray:
    """Return the diffuse reflectance of a half-infinite dermis against air [1].

    R = exp(-A / sqrt(3 (1 + s'/a))), A = 6.3744 + 0.35688 (s'/a)^(1/3.4739), the Monte Carlo fit
    for an index of 1.37 in S. L. Jacques, "Diffuse reflectance from a semi-infinite medium",
    Oregon Medical Laser Center News, May 1999.
    """
    ratio = reduced_scattering(wavelength_nm) / dermis_absorption(wavelength_nm, pigments)
    path = 6.3744 + 0.35688 * ratio ** (1.0 / 3.4739)
    return np.exp(-path / np.sqrt(3.0 * (1.0 + ratio)))


def epidermis(wavelength_nm: ArrayLike, pigments: Pigments) -> tuple[FloatArray, FloatArray]:
    """Return what the epidermis turns back and what it lets pass [1].

    Two streams of diffuse light (P. Kubelka and F. Munk, Z. techn. Physik 12 (1931), 593-601),
    which lose K = 2 a and exchange S = 3/4 s' per metre (L. F. Gate, Applied Optics 13 (1974),
    236-238). The skin's surface counts once, in ``dermis_reflectance``.
    """
    absorption = (
        pigments.melanin * melanosome_absorption(wavelength_nm)
        + (1.0 - pigments.melanin) * tissue_absorption(wavelength_nm)
    )  # fmt: skip
    lost = 2.0 * absorption * EPIDERMIS_M
    turned = 0.75 * reduced_scattering(wavelength_nm) * EPIDERMIS_M
    turned *= pigments.epidermis_scattering
    depth = np.sqrt(lost * (lost + 2.0 * turned))
    steep = np.sinh(depth) / depth
    passed = 1.0 / ((lost + turned) * steep + np.cosh(depth))
    return turned * steep * passed, passed


def reflectance(wavelength_nm: ArrayLike, pigments: Pigments) -> FloatArray:
    """Return the diffuse reflectance of skin [1], shape [band_count]."""
    turned_back, _ = epidermis(wavelength_nm, pigments)
    return turned_back + _from_the_dermis(wavelength_nm, pigments)


def scattering(wavelength_nm: ArrayLike, pigments: Pigments) -> FloatArray:
    """Return Ss [1]: light that comes back further away, most of it red.

    It has been in the dermis, and goes as far there as light does before it fades; the form is
    ours. Light that the epidermis turns back comes out where it came in.
    """
    reach = 1.0 / effective_attenuation(wavelength_nm, pigments)
    deep = _from_the_dermis(wavelength_nm, pigments) / reflectance(wavelength_nm, pigments)
    return SCATTERED * reach / (reach + REACH_M) * deep


def _from_the_dermis(wavelength_nm: ArrayLike, pigments: Pigments) -> FloatArray:
    """Return the share of the light that comes back through the epidermis [1]."""
    turned_back, passed = epidermis(wavelength_nm, pigments)
    dermis = dermis_reflectance(wavelength_nm, pigments)
    return passed**2 * dermis / (1.0 - turned_back * dermis)
