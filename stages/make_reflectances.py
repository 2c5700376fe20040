"""Make the sets' reflectances: ``python stages/make_reflectances.py ASCIIdata_splib07a``.

The argument is the unpacked archive of that name of the USGS Spectral Library Version 7 (Kokaly et
al., 2017, USGS Data Series 1035, doi:10.5066/F7RR1WDJ), a work of the U.S. government in the public
domain: reflectances relative to the perfect diffuser, measured with an ASD spectrometer every
nanometre (the lawn with a Beckman, more coarsely). Written are means over 5 nm.

Writes: ``reflectances.csv``. It is committed; run this after a change.
"""

from __future__ import annotations

import argparse
import csv
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

FOLDER = Path(__file__).resolve().parent
WAVELENGTH_NM = np.arange(380.0, 781.0, 5.0)

ASD = "splib07a_Wavelengths_ASD_0.35-2.5_microns_2151_ch.txt"
BECKMAN = "splib07a_Wavelengths_BECK_Beckman_0.2-3.0_microns.txt"
ARTIFICIAL, VEGETATION = "ChapterA_ArtificialMaterials", "ChapterV_Vegetation"

SAMPLES = {
    "GDS91": (VEGETATION, "Lawn_Grass_GDS91_green_BECKa", BECKMAN),
    "GDS333": (ARTIFICIAL, "Painted_Aluminum_GDS333_LgGr_ASDFRa", ASD),
    "GDS335": (ARTIFICIAL, "Fiberglass_GDS335_Wh_Roofing_ASDFRa", ASD),
    "GDS338": (ARTIFICIAL, "Plastic_PVC_GDS338_White_ASDFRa", ASD),
    "GDS341": (ARTIFICIAL, "Plastic_ABS_GDS341_BlackPipe_ASDFRa", ASD),
    "GDS353": (ARTIFICIAL, "Brick_GDS353_Building_MedRed_ASDFRa", ASD),
    "GDS356": (ARTIFICIAL, "Cinder_Block_GDS356_Lg_Grey_ASDFRa", ASD),
    "GDS357": (ARTIFICIAL, "Cedar_Shake_GDS357_Fresh_ASDFRa", ASD),
    "GDS361": (ARTIFICIAL, "Cedar_Shake_GDS361_HiWeather_ASDFRa", ASD),
    "GDS363": (ARTIFICIAL, "Wood_Beam_GDS363_Nw_Pine_2X4_ASDFRa", ASD),
    "GDS365": (ARTIFICIAL, "Plywood_GDS365_Fresh_Pine_ASDFRa", ASD),
    "GDS371": (ARTIFICIAL, "Cardboard_GDS371_Brn_Corgted_ASDFRa", ASD),
    "GDS372": (ARTIFICIAL, "Plastic_Vinyl_GDS372_White_ASDFRa", ASD),
    "GDS375": (ARTIFICIAL, "Concrete_GDS375_Lt_Gry_Road_ASDFRa", ASD),
    "GDS431": (ARTIFICIAL, "Nylon_Fabric_GDS431_Red_RpSt_ASDFRa", ASD),
    "GDS433": (ARTIFICIAL, "Nylon_Fabric_GDS433_Blu_RpSt_ASDFRa", ASD),
    "GDS535": (ARTIFICIAL, "Nylon_Carpet_GDS535_LtBrown_ASDFRa", ASD),
    "GDS536": (ARTIFICIAL, "Nylon_Carpet_GDS536_Gry_Pile_ASDFRa", ASD),
    "GDS537": (ARTIFICIAL, "Terrycloth_Fabric_GDS537_Yel_ASDFRa", ASD),
    "GDS796": (ARTIFICIAL, "Lead_White_GDS796_ASDFRa", ASD),
}
"""Chapter, name and wavelengths of each sample, by its number in the library."""


def read_column(path: Path) -> NDArray[np.float64]:
    """Return the numbers of a file of the library, below its one line of heading."""
    return np.loadtxt(path, skiprows=1, encoding="latin1")


def band_means(wavelength_nm: NDArray[np.float64], values: NDArray[np.float64]) -> list[float]:
    """Return means over 5 nm of straight lines between what is measured, one per band."""
    measured = values > -1.0  # the library's mark of a deleted channel is -1.23e34
    offsets = np.arange(-2.5, 2.51, 0.1)
    points = WAVELENGTH_NM[:, None] + offsets
    return list(np.interp(points, wavelength_nm[measured], values[measured]).mean(axis=1))


def main() -> None:
    """Read the library and write the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("library", type=Path)
    library = parser.parse_args().library
    columns = []
    for chapter, name, wavelengths in SAMPLES.values():
        values = read_column(library / chapter / f"splib07a_{name}_AREF.txt")
        columns.append(band_means(1000.0 * read_column(library / wavelengths), values))
    with (FOLDER / "reflectances.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["wavelength_nm", *SAMPLES])
        for wavelength, *row in zip(WAVELENGTH_NM, *columns, strict=True):
            writer.writerow([f"{wavelength:g}", *(f"{value:.5f}" for value in row)])


if __name__ == "__main__":
    main()
