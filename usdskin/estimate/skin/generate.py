"""Write the shipped skin prior: ``python -m usdskin.estimate.skin.generate ISSA.npz``.

Reads:  reflectances of the International Skin Spectra Archive (``usdskin/data/SOURCES.md``), an
        archive of NumPy arrays: ``R`` [record, band], ``wavelength`` [nm], ``origin`` and
        ``subject`` per record.
Writes: ``usdskin/data/skin_prior.csv``: mean, components and what they leave; no measurement.
"""

from __future__ import annotations

import csv
import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import illuminant
from usdskin.differences import lab_of_signals
from usdskin.estimate.skin.prior import SkinPrior, fit_prior
from usdskin.estimate.skin.surface import SKIN_F0, SPHERE_ANGLE_DEG, fresnel, specular_included
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

FloatArray = NDArray[np.float64]

TABLE = Path(__file__).resolve().parents[2] / "data" / "skin_prior.csv"

LEAST_DIFFUSE = 0.002
"""A record with less than this above its mirror image is a failed reading, not skin [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredSkin:
    """Measured skins on the default grid."""

    reflectance: FloatArray
    """Diffuse reflectance, without the surface's mirror image [1], shape [m, n]."""

    origin: NDArray[np.int64]
    """Which laboratory sent it, shape [m]."""

    tone_deg: FloatArray
    """Individual typology angle as measured, under D65 for the CIE 1931 observer [deg],
    shape [m]."""

    dropped: int
    """Records left out, since they reflect no more than a surface mirrors."""


def read_issa(path: str | Path) -> MeasuredSkin:
    """Read the archive's reflectances, and bring them to the default grid.

    Between the 10 nm of the instruments runs a cubic spline. The typology angle is
    ``atan((L* - 50) / b*)`` (A. Chardon, I. Cretois and C. Hourseau, "Skin colour typology and
    suntanning pathways", Int. J. Cosmet. Sci. 13(4), 1991).

    Args:
        path: Archive of NumPy arrays.
    """
    from scipy.interpolate import CubicSpline

    with np.load(path) as content:
        nm = content["wavelength"].astype(np.float64)
        measured = content["R"].astype(np.float64)
        origin = content["origin"].astype(np.int64)
    index = (1.0 + np.sqrt(SKIN_F0)) / (1.0 - np.sqrt(SKIN_F0))
    mirrored = float(fresnel(index, SPHERE_ANGLE_DEG))
    skin = (measured > mirrored + LEAST_DIFFUSE).all(axis=1)
    daylight = illuminant("D65", nm)
    lightness, _, yellow = lab_of_signals(measured[skin] * daylight, daylight, nm).T
    fine = CubicSpline(nm, measured[skin], axis=1)(DEFAULT_WAVELENGTHS_NM)
    return MeasuredSkin(
        reflectance=specular_included(fine, where=str(path)),
        origin=origin[skin],
        tone_deg=np.degrees(np.arctan2(lightness - 50.0, yellow)),
        dropped=int((~skin).sum()),
    )


def write_prior(prior: SkinPrior, path: str | Path) -> None:
    """Write a prior as a table, one row a wavelength.

    Args:
        prior: What to write.
        path: CSV file.
    """
    names = [f"c{index}" for index in range(1, len(prior.components) + 1)]
    columns = np.column_stack([prior.wavelength_nm, prior.mean, *prior.components, prior.rest])
    with Path(path).open("w", newline="", encoding="ascii") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["nm", "mean", *names, "rest"])
        for nm, *values in columns:
            writer.writerow([format(nm, "g"), *(f"{value:.7f}" for value in values)])


def main() -> None:
    """Write the table."""
    skin = read_issa(sys.argv[1])
    print(f"{len(skin.reflectance)} skins of {len(np.unique(skin.origin))} origins", end="; ")
    print(f"{skin.dropped} dark beyond skin were left out")
    write_prior(fit_prior(skin.reflectance, DEFAULT_WAVELENGTHS_NM, skin.origin), TABLE)


if __name__ == "__main__":
    main()
