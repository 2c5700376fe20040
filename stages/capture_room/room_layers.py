"""The layers of the room and its renditions for tools that read no spectra."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import illuminant, xyz_to_rgb, xyz_weights
from usdskin.images import Part, write_exr
from usdskin.layers import quiet_diagnostics, write_layer
from usdskin.uplift import reflectance_basis

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdLux, Vt

FloatArray = NDArray[np.float64]

WAVELENGTH_NM = np.arange(380.0, 781.0, 5.0)
LAMPS = ("FL2", "D65")
ALONE = {"tubes": 0, "window": 1}
"""The layers with one kind of lamp, and which of the lamps it is."""


def rounded(values: FloatArray, bits: int = 6) -> NDArray[np.float32]:
    """Return values with few binary digits, so that the file is small; they are the truth then."""
    mantissa, exponent = np.frexp(values)
    return np.ldexp(np.rint(mantissa * 2.0**bits) / 2.0**bits, exponent).astype(np.float32)


def basis() -> FloatArray:
    """Return the spectra of the coefficients [W m^-2 sr^-1 nm^-1 per cd m^-2], shape [6, bands]."""
    rows = []
    for lamp in LAMPS:
        power = illuminant(lamp, WAVELENGTH_NM)
        power = power / (power @ xyz_weights(WAVELENGTH_NM, absolute=True)[:, 1])
        rows.append(reflectance_basis(WAVELENGTH_NM) * power)
    return np.concatenate(rows)


def write_stage(path: Path, spectra: FloatArray) -> None:
    """Write the room as a layer that stands alone."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetMetadata(
        "documentation", "A room in absolute units, seen from its middle. See README."
    )
    room = UsdGeom.Xform.Define(stage, "/Room")
    stage.SetDefaultPrim(room.GetPrim())
    dome = UsdLux.DomeLight.Define(stage, "/Room/Light")
    dome.CreateTextureFileAttr(Sdf.AssetPath("./room_rgb.exr"))
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    prim = dome.GetPrim()
    prim.ApplyAPI("SpectralLightAPI")
    values = {
        "source": "basis",
        "units": "absolute",
        "coefficients:file": Sdf.AssetPath("./room.exr"),
        "basis": Vt.DoubleArray([float(f"{value:.6g}") for value in spectra.ravel()]),
        "basis:wavelengths": Vt.DoubleArray(WAVELENGTH_NM.tolist()),
    }
    for name, value in values.items():
        prim.GetAttribute(f"inputs:spectral:{name}").Set(value)
    write_layer(stage, path)


def write_stage_alone(path: Path, spectra: FloatArray, lamp: int) -> None:
    """Write the room in the light of one kind of lamp: the other one's spectra are zero.

    It is an override of ``room.usda`` beside it, with an RGB rendition of its own.
    """
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    text = f"The room of room.usda in the light of its {path.stem} alone. See README."
    stage.SetMetadata("documentation", text)
    room = stage.DefinePrim("/Room", "Xform")
    stage.SetDefaultPrim(room)
    light = stage.OverridePrim("/Room/Light")
    values = [float(f"{value:.6g}") for value in alone(spectra, lamp).ravel()]
    doubles, asset = Sdf.ValueTypeNames.DoubleArray, Sdf.ValueTypeNames.Asset
    light.CreateAttribute("inputs:spectral:basis", doubles, custom=False).Set(
        Vt.DoubleArray(values)
    )
    shown = Sdf.AssetPath(f"./{path.stem}_rgb.exr")
    light.CreateAttribute("inputs:texture:file", asset, custom=False).Set(shown)
    with quiet_diagnostics():  # a layer in memory does not find its neighbours
        room.GetReferences().AddReference("./room.usda")
    write_layer(stage, path)


def alone(spectra: FloatArray, lamp: int) -> FloatArray:
    """Return the spectra with those of the other lamps zero, shape [6, bands]."""
    is_lit = np.arange(len(spectra)) // 3 == lamp
    return np.where(is_lit[:, None], spectra, 0.0)


def rendition(room: NDArray[np.float32], spectra: FloatArray, smaller: int = 2) -> FloatArray:
    """Return the light as RGB, a texel for ``smaller`` by ``smaller`` of the room's."""
    to_rgb = spectra @ xyz_weights(WAVELENGTH_NM, absolute=True) @ xyz_to_rgb("lin_rec709_scene").T
    height, width = room.shape[0] // smaller, room.shape[1] // smaller
    coarse = room.reshape(height, smaller, width, smaller, 6).mean(axis=(1, 3))
    return rounded(np.maximum(coarse @ to_rgb, 0.0))


def write_rgb(path: Path, pixels: FloatArray) -> None:
    """Write a rendition for tools that read no spectra."""
    write_exr(path, [Part("", {"": pixels}, {}, "half", "lin_rec709_scene")], "zip:9")
