"""Make the portrait's studio light: ``python stages/portrait/make_light.py``.

Writes: ``light.usda``, a DomeLight with ``SpectralLightAPI`` and a variant per lamp, its maps in
        ``light/``. Both are committed; run this after a change.

The room is dark but for a large softbox, to the left of the camera and above; a pale wall to the
right gives some of it back; a strip behind traces the edge. Each is a channel of its own, so that a
lamp, what a wall makes of it, and the strip can have spectra of their own.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import daylight, illuminant, xyz_to_rgb, xyz_weights
from usdskin.images import Part, write_exr
from usdskin.layers import write_layer
from usdskin.prims import SpectralLight, write_spectral_light

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdLux

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
HEIGHT = 128
"""Rows of the maps; twice as many columns."""

WAVELENGTH_NM = np.arange(380.0, 731.0, 5.0)

KEY = (-44.0, 34.0)
"""Azimuth from +Z towards +X and elevation of the softbox [deg]; the face looks along +Z."""

RIM = (142.0, 24.0)


@dataclass(frozen=True, slots=True)
class Lamp:
    """What shines in a variant."""

    key: str
    """Lamp in the softbox."""

    fill_kelvin: float | None
    """Daylight from a window instead of what the wall gives back [K]."""

    fill: float
    """Strength of the fill [1]."""


LAMPS = {
    "fluorescent": Lamp("FL2", None, 1.0),
    "incandescent": Lamp("A", None, 0.8),
    "daylight": Lamp("D55", 7500.0, 1.15),
}


def directions() -> FloatArray:
    """Return the unit vector of each texel of the map, as UsdLux lays it out, shape [h, w, 3]."""
    u = (np.arange(2 * HEIGHT) + 0.5) / (2 * HEIGHT)
    v = (np.arange(HEIGHT) + 0.5) / HEIGHT
    # u = 0.5 looks along +Z, u = 0.25 along +X, v = 0 up.
    azimuth = 2.0 * np.pi * (0.5 - u)[None, :]
    elevation = np.pi * (0.5 - v)[:, None]
    return np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ),
        axis=2,
    )


def coefficients() -> NDArray[np.float32]:
    """Return key, fill and rim over the sphere [relative], shape [h, w, 3]."""
    towards = directions()
    x, y, ahead = _around(towards, *KEY)
    box = _edge(0.27 - np.abs(x), 0.04) * _edge(0.35 - np.abs(y), 0.04) * (ahead > 0.0)
    key = 10.5 * box * (1.0 - 0.35 * np.clip((x**2 + y**2) / 0.20, 0.0, 1.0))

    height = towards[..., 1]
    wall = np.clip(towards @ _unit(78.0, 4.0), 0.0, 1.0)
    ceiling = np.clip(height, 0.0, 1.0)
    floor = np.clip(-height, 0.0, 1.0)
    fill = 0.030 + 0.32 * wall**2.5 + 0.06 * ceiling + 0.02 * floor

    x, y, ahead = _around(towards, *RIM)
    rim = 4.2 * _edge(0.10 - np.abs(x), 0.04) * _edge(0.60 - np.abs(y), 0.08) * (ahead > 0.0)
    return np.stack([key, fill, rim], axis=2).astype(np.float32)


def basis(lamp: Lamp) -> FloatArray:
    """Return the spectra of key, fill and rim, each of luminance 1, shape [3, band_count]."""
    key = illuminant(lamp.key, WAVELENGTH_NM)
    if lamp.fill_kelvin is None:
        # A cream wall paint: a smooth step from 0.45 in the blue to 0.75 in the red.
        paint = 0.45 + 0.30 / (1.0 + np.exp(-(WAVELENGTH_NM - 505.0) / 28.0))
        fill = key * paint
    else:
        fill = daylight(lamp.fill_kelvin, WAVELENGTH_NM)
    luminance = xyz_weights(WAVELENGTH_NM)[:, 1]
    rows = np.stack([key, lamp.fill * fill / (fill @ luminance) * (key @ luminance), key])
    return rows / (key @ luminance)


def main() -> None:
    """Write maps and layer."""
    folder = FOLDER / "light"
    folder.mkdir(exist_ok=True)
    shares = coefficients()
    channels = {f"c{k}": shares[..., k] for k in range(3)}
    write_exr(folder / "coefficients.exr", [Part("light", channels, sample_type="half")])
    stage = Usd.Stage.CreateNew(str(FOLDER / "light.usda.tmp.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = (
        "The portrait's studio under three lamps. Made by make_light.py; change it there."
    )
    dome = UsdLux.DomeLight.Define(stage, "/Light")
    stage.SetDefaultPrim(dome.GetPrim())
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    variants = dome.GetPrim().GetVariantSets().AddVariantSet("light")
    for name, lamp in LAMPS.items():
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        rows = basis(lamp)
        rgb = shares @ (rows @ xyz_weights(WAVELENGTH_NM)) @ xyz_to_rgb("lin_rec709_scene").T
        part = Part("", {"": rgb.astype(np.float32)}, {}, "half", "lin_rec709_scene")
        write_exr(folder / f"{name}.exr", [part])
        with variants.GetVariantEditContext():
            dome.CreateTextureFileAttr(Sdf.AssetPath(f"./light/{name}.exr"))
            light = SpectralLight(
                source="basis",
                coefficients_file=folder / "coefficients.exr",
                basis=rows,
                basis_wavelength_nm=WAVELENGTH_NM,
            )
            write_spectral_light(dome.GetPrim(), light, FOLDER)
    variants.SetVariantSelection("daylight")
    write_layer(stage, FOLDER / "light.usda")
    (FOLDER / "light.usda.tmp.usda").unlink(missing_ok=True)


def _unit(azimuth: float, elevation: float) -> FloatArray:
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])


def _around(
    towards: FloatArray, azimuth: float, elevation: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return gnomonic coordinates about a direction, and its cosine."""
    axis = _unit(azimuth, elevation)
    right = np.cross([0.0, 1.0, 0.0], axis)
    right /= np.linalg.norm(right)
    up = np.cross(axis, right)
    ahead = towards @ axis
    depth = np.maximum(ahead, 1e-3)
    return towards @ right / depth, towards @ up / depth, ahead


def _edge(inside: FloatArray, softness: float) -> FloatArray:
    t = np.clip(0.5 + 0.5 * inside / softness, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


if __name__ == "__main__":
    main()
