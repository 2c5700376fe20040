"""Make the portrait's skin: ``python stages/portrait/make_skin.py``.

Writes: ``skin.usda``, a Material with ``SkinMaterialAPI``. It is committed; run this after a change
        of the pigments. The weights of its spectra over the face are ``assets/weights.exr``.

The spectra come out so that a uniform room of radiance 1 gives back the reflectance R of
``skin_spectra``: alpha S (1 + (1 + l) Ss) = R, the model's furnace value.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from complexion import BLOOD, MELANIN, basis
from numpy.typing import NDArray
from skin_spectra import WAVELENGTH_NM, Pigments, effective_attenuation, reflectance

from usdskin.colorimetry import (
    cat16,
    color_matching_functions,
    illuminant,
    white_xyz,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.layers import write_layer
from usdskin.prims import SkinParameters, write_skin
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
WRAP = 0.3

SCATTERED, REACH_M = 0.62, 1.0e-3
"""Ss is ``SCATTERED`` where light goes far in skin, half of it where it fades over ``REACH_M``."""

MEAN = Pigments(MELANIN, BLOOD)


def scattering() -> FloatArray:
    """Return Ss [1]: light that comes back further away, most of it red."""
    reach = 1.0 / effective_attenuation(WAVELENGTH_NM, MEAN)
    return SCATTERED * reach / (reach + REACH_M)


def main() -> None:
    """Write the layer."""
    spread = scattering()
    bright = color_matching_functions(WAVELENGTH_NM)[:, 1]
    alpha = 1.0 / (1.0 + float(spread @ bright / bright.sum()))
    diffuse = alpha * (1.0 + (1.0 + WRAP) * spread)
    mean = reflectance(WAVELENGTH_NM, MEAN)

    def spectrum(quantity: SpectralQuantity, values: FloatArray) -> Spectrum:
        return Spectrum(quantity, WAVELENGTH_NM, np.round(values, 6))

    skin = SkinParameters(
        alpha=round(alpha, 6),
        wrap=WRAP,
        reflectance=spectrum(SpectralQuantity.REFLECTANCE, mean / diffuse),
        scattering=spectrum(SpectralQuantity.SCATTERING, spread),
        opacity=spectrum(SpectralQuantity.ABSORPTION, effective_attenuation(WAVELENGTH_NM, MEAN)),
        thickness=0.006,
        weights_file=FOLDER / "assets" / "weights.exr",
        weights_basis=np.round(basis() / diffuse, 6),
        weights_wavelength_nm=WAVELENGTH_NM,
        specular_weight=0.55,
        roughness1=0.52,
        roughness2=0.30,
        mix=0.18,
    )
    stage = Usd.Stage.CreateInMemory("skin.usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = "Skin. Made by make_skin.py; change it there."
    material = UsdShade.Material.Define(stage, "/Skin")
    stage.SetDefaultPrim(material.GetPrim())
    write_skin(material.GetPrim(), skin, FOLDER)
    for name, value in (("melanin", MEAN.melanin), ("haemoglobin", MEAN.blood)):
        material.GetPrim().GetAttribute(f"inputs:skin:{name}").Set(value)
    material.GetPrim().GetAttribute("inputs:skin:oxygenation").Set(MEAN.oxygenation)
    material.GetPrim().GetAttribute("inputs:skin:epidermisThickness").Set(60e-6)

    surface = UsdShade.Shader.Define(stage, "/Skin/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    color = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    color.Set(Gf.Vec3f(*(round(float(value), 4) for value in _rgb(mean))))
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(0.5)
    surface.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(1.4)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    write_layer(stage, FOLDER / "skin.usda")


def _rgb(values: FloatArray) -> FloatArray:
    """Return the linear Rec. 709 color of a reflectance under D65."""
    weights = illuminant("D65", WAVELENGTH_NM)[:, None] * xyz_weights(WAVELENGTH_NM)
    white = weights.sum(axis=0)
    space = "lin_rec709_scene"
    return xyz_to_rgb(space) @ cat16(white, white_xyz(space)) @ (values @ weights) / white[1]


if __name__ == "__main__":
    main()
