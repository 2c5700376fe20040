"""Make the yard in the sun: ``python stages/outdoor_sun/make_outdoor.py``.

Grass, a strip of concrete and the walls of a house under a clear sky.

Sun: the extraterrestrial spectrum of ASTM G-173 (through colour-science), times transmittances of
air, ozone and aerosol by Bird and Riordan (1984, SERI/TR-215-2436, eqs. 2-4 to 2-10, ozone from
their table) with Kasten's (1966) air mass and Angstrom's turbidity, in a disc of 0.53 degrees.

Sky: luminances of CIE standard general sky type 12 (CIE S 011), scaled to the diffuse horizontal
illuminance of a clear sky (IES Lighting Handbook: 0.8 + 15.5 sqrt(sin h) klx); in every direction
CIE daylight, whose color temperature follows luminance as Chain, Dumortier and Fontoynont (1999,
Solar Energy 65) measured under that sky. Below the horizon it shows far grass.

Reflectances are measured: materials of the USGS Spectral Library.

Writes: ``set.usda``, ``sky.exr`` (coefficients) and ``sky_rgb.exr``. All are committed; run this
        after a change.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from colour.plotting.datasets import SD_ASTMG173_ETR
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_to_rgb, xyz_weights
from usdskin.illuminants import table
from usdskin.images import Part, write_exr
from usdskin.latlong import texel_directions, texel_solid_angles
from usdskin.prims import SpectralLight, write_spectral_light
from usdskin.spectrum import SpectralQuantity, resample

FOLDER = Path(__file__).resolve().parent
sys.path.append(str(FOLDER.parent))

from set_layers import (  # noqa: E402
    WAVELENGTH_NM,
    add_light,
    box,
    luminance,
    measured,
    new_set,
    write_set,
)  # fmt: skip

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, UsdLux  # noqa: E402

FloatArray = NDArray[np.float64]

CAPTURE_POINT = (0.0, 1.5, 0.0)
ELEVATION_DEG, TURN_DEG = 42.0, -38.0
"""Of the sun: above the horizon, and from +Z towards +X."""
SUN_DEG = 0.533
BETA, OZONE_CM = 0.06, 0.33
"""Angstrom's turbidity at 1 micrometre with the exponent 1.3; ozone [atm cm]."""

CHAPPUIS = (
    (380, 0.0), (440, 0.0), (450, 0.003), (460, 0.006), (470, 0.009), (480, 0.014), (490, 0.021),
    (500, 0.030), (510, 0.040), (520, 0.048), (530, 0.063), (540, 0.075), (550, 0.085),
    (570, 0.120), (593, 0.119), (610, 0.120), (630, 0.090), (656, 0.065), (667.6, 0.051),
    (690, 0.028), (710, 0.018), (718, 0.015), (724.4, 0.012), (740, 0.010), (752.5, 0.008),
    (780, 0.0),
)  # fmt: skip
"""Ozone's absorption by wavelength [nm], [cm^-1] (Bird and Riordan, table 2-1)."""

HEIGHT = 96
"""Rows of the sky's map; twice as many columns."""

REFLECTANCES = {
    "grass": measured("GDS91"),  # a lawn
    "concrete": measured("GDS375"),  # light gray
    "block": measured("GDS356"),  # cinder block, light gray
    "brick": measured("GDS353"),  # red
    "cedar": measured("GDS361"),  # weathered
}


def sun_direction() -> FloatArray:
    """Return the unit vector towards the sun, shape [3]."""
    up, turn = np.radians([ELEVATION_DEG, TURN_DEG])
    return np.array([np.cos(up) * np.sin(turn), np.sin(up), np.cos(up) * np.cos(turn)])


def sun_irradiance() -> FloatArray:
    """Return the sun's beam on a surface that faces it [W m^-2 nm^-1], shape [band_count]."""
    outside = resample(SD_ASTMG173_ETR.wavelengths, SD_ASTMG173_ETR.values, WAVELENGTH_NM)
    zenith = 90.0 - ELEVATION_DEG
    cosine = np.cos(np.radians(zenith))
    air = 1.0 / (cosine + 0.15 * (93.885 - zenith) ** -1.253)  # Kasten 1966
    ozone = (1.0 + 22.0 / 6370.0) / np.sqrt(cosine**2 + 44.0 / 6370.0)
    micron = WAVELENGTH_NM / 1000.0
    depth = air / (micron**4 * (115.6406 - 1.335 / micron**2)) + BETA * micron**-1.3 * air
    depth += np.interp(WAVELENGTH_NM, *np.array(CHAPPUIS, float).T) * OZONE_CM * ozone
    return np.asarray(outside * np.exp(-depth))


def sky_luminance(directions: FloatArray) -> FloatArray:
    """Return CIE type 12, 1 at the zenith, 0 below the horizon, shape [...]."""
    up = directions[..., 1]
    sun = sun_direction()

    def gradation(cosine: FloatArray) -> FloatArray:
        return np.asarray(1.0 - np.exp(-0.32 / np.maximum(cosine, 1e-3)))

    def indicatrix(angle: FloatArray) -> FloatArray:
        ring = np.exp(-3.0 * angle) - np.exp(-1.5 * np.pi)
        return np.asarray(1.0 + 10.0 * ring + 0.45 * np.cos(angle) ** 2)

    around = np.arccos(np.clip(directions @ sun, -1.0, 1.0))
    zenith = indicatrix(np.arccos(sun[1])) * gradation(np.array(1.0))
    return np.asarray(np.where(up > 0.0, indicatrix(around) * gradation(up) / zenith, 0.0))


def diffuse_illuminance() -> float:
    """Return what the sky gives a level surface [lx]."""
    return 1000.0 * (0.8 + 15.5 * float(np.sqrt(np.sin(np.radians(ELEVATION_DEG)))))


def daylight_weights(kelvin: FloatArray) -> FloatArray:
    """Return the weights M1 and M2 of the components S1 and S2 of daylight, shape [..., 2]."""
    t = np.clip(kelvin, 4000.0, 25000.0)
    cool = t > 7000.0
    cubic = np.where(cool, -2.0064e9, -4.6070e9) / t**3
    square = np.where(cool, 1.9018e6, 2.9678e6) / t**2
    x = cubic + square + np.where(cool, 247.48, 99.11) / t + np.where(cool, 0.237040, 0.244063)
    y = -3.0 * x**2 + 2.870 * x - 0.275
    scale = 0.0241 + 0.2562 * x - 0.7341 * y
    first = (-1.3515 - 1.7703 * x + 5.9114 * y) / scale
    second = (0.0300 - 31.4424 * x + 30.0717 * y) / scale
    return np.stack([first, second], axis=-1)


def sky() -> tuple[FloatArray, FloatArray]:
    """Return coefficients, shape [rows, columns, 4], and spectra, shape [4, band_count].

    The spectra are S0, S1 and S2 of daylight, and far grass in sun and sky.
    """
    directions = texel_directions(HEIGHT, 2 * HEIGHT)
    relative = sky_luminance(directions)
    level = texel_solid_angles(HEIGHT, 2 * HEIGHT)[:, None] * np.maximum(directions[..., 1], 0.0)
    candela = relative * (diffuse_illuminance() / (relative * level).sum())
    with np.errstate(divide="ignore"):
        slope = -132.1 + 59.77 * np.log10(np.maximum(candela, 1.0))
    kelvin = 1e6 / np.clip(slope, 40.0, 250.0)
    columns = table("daylight")
    parts = np.stack([resample(*columns[name], WAVELENGTH_NM) for name in ("S0", "S1", "S2")])
    mixed = np.concatenate([np.ones_like(kelvin)[..., None], daylight_weights(kelvin)], axis=-1)
    lumens = mixed @ (parts @ xyz_weights(WAVELENGTH_NM, absolute=True)[:, 1])
    shares = mixed * (candela / lumens)[..., None]
    scale = float(np.abs(shares).max())
    shares, parts = shares / scale, parts * scale
    from_sky = np.einsum("hwk,hw->k", shares, level) @ parts
    beam = sun_irradiance() * np.sin(np.radians(ELEVATION_DEG))
    grass = REFLECTANCES["grass"] * (from_sky + beam) / np.pi
    is_ground = (directions[..., 1] <= 0.0).astype(float)[..., None]
    coefficients = np.concatenate([shares, is_ground], axis=-1)
    return coefficients, np.concatenate([parts, grass[None]])


def surfaces() -> dict:
    """Return the ground, tiled without overlap, and the house."""
    return {
        "lawn": ("grass", [quad for low, high in (
            ((-40.0, -0.1, -40.0), (-1.6, 0.0, 40.0)), ((-1.6, -0.1, 1.8), (40.0, 0.0, 40.0)),
            ((-1.6, -0.1, -40.0), (40.0, 0.0, -9.0)),
        ) for quad in box(low, high, "+y")]),
        "terrace": ("concrete", box((-1.6, -0.1, -9.0), (40.0, 0.0, 1.8), "+y")),
        "house": ("block", box((2.2, 0.0, -8.0), (9.0, 5.5, 1.5), "-x +x +y -z +z")),
        "shed": ("brick", box((-4.5, 0.0, -7.0), (0.2, 2.6, -5.0), "-x +x +y -z +z")),
        "door": ("cedar", box((2.17, 0.0, -3.0), (2.19, 2.1, -2.0), "-x +y -z +z")),
    }  # fmt: skip


def main() -> None:
    """Write the set and its sky."""
    stage = new_set("A yard in the sun. See README.", ("sun", "sky"), CAPTURE_POINT)
    sun = add_light(
        stage, UsdLux.DistantLight, "sun/disc", sun_irradiance(), SpectralQuantity.IRRADIANCE
    )
    sun.CreateAngleAttr(SUN_DEG)
    sun.CreateIntensityAttr(1.0)
    sun.AddRotateXYZOp().Set(Gf.Vec3f(-ELEVATION_DEG, TURN_DEG, 0.0))  # its +Z points to the sun
    coefficients, spectra = sky()
    dome = UsdLux.DomeLight.Define(stage, "/Set/Lights/sky/dome")
    dome.CreateTextureFileAttr(Sdf.AssetPath("./sky_rgb.exr"))
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    values = np.array([float(f"{value:.6g}") for value in spectra.ravel()]).reshape(spectra.shape)
    light = SpectralLight(
        source="basis", units="absolute", coefficients_file=FOLDER / "sky.exr",
        basis=values, basis_wavelength_nm=WAVELENGTH_NM,
    )  # fmt: skip
    channels = {f"c{k}": coefficients[..., k].astype(np.float32) for k in range(4)}
    write_exr(FOLDER / "sky.exr", [Part("light", channels, sample_type="half")], "zip:9")
    weights = values @ xyz_weights(WAVELENGTH_NM, absolute=True) @ xyz_to_rgb("lin_rec709_scene").T
    rgb = np.maximum(coefficients @ weights, 0.0).astype(np.float32)
    write_exr(
        FOLDER / "sky_rgb.exr", [Part("", {"": rgb}, {}, "half", "lin_rec709_scene")], "zip:9"
    )
    write_spectral_light(dome.GetPrim(), light, FOLDER)
    write_set(stage, FOLDER, REFLECTANCES, surfaces())
    print(f"sun {luminance(sun_irradiance()):.0f} lx, sky {diffuse_illuminance():.0f} lx")


if __name__ == "__main__":
    main()
