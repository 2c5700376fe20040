"""Make the library of skins: ``python stages/skin_library/make_library.py``.

Writes: ``skin_library.usda``, a Material with ``SkinMaterialAPI`` and the variant sets ``tone`` and
        ``finish``. It is committed; run this after a change.

The spectra come out so that a uniform room of radiance 1 gives back the reflectance R of
``skin_spectra``: alpha S (1 + (1 + l) Ss) = R, the model's furnace value.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from skin_spectra import (
    EPIDERMIS_M,
    WAVELENGTH_NM,
    Pigments,
    effective_attenuation,
    reflectance,
    scattering,
)

from usdskin.colorimetry import (
    cat16,
    color_matching_functions,
    encode_srgb,
    illuminant,
    white_xyz,
    xyz_to_lab,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.layers import write_layer
from usdskin.prims import write_spectrum
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
WRAP = 0.3

F0 = 0.028
"""Reflectance of skin's surface at normal incidence: an index of 1.4."""

ITA_EDGES = (55.0, 41.0, 28.0, 10.0, -30.0)
"""Between the classes of the individual typology angle [deg]: A. Chardon, I. Cretois and C.
Hourseau, "Skin colour typology and suntanning pathways", Int. J. Cosmetic Science 13 (1991),
191-208."""

TONES = {
    "tone1": Pigments(0.0273, 0.010),
    "tone2": Pigments(0.0395, 0.014),
    "tone3": Pigments(0.0595, 0.014),
    "tone4": Pigments(0.0860, 0.015),
    "tone5": Pigments(0.1505, 0.014),
    "tone6": Pigments(0.2620, 0.014),
}
"""One for each class of ITA, from the lightest down. Melanin within what Jacques, "Skin optics",
1998, gives for light (1.3 to 6.3 %), tanned (11 to 16 %) and dark skin (18 to 43 %) or between."""


@dataclass(frozen=True, slots=True)
class Finish:
    """What lies on the skin: the specular term of ``SkinMaterialAPI``."""

    weight: float
    roughness1: float
    roughness2: float
    mix: float

    preview_roughness: float
    """The one lobe of ``UsdPreviewSurface`` that looks most like both."""


FINISHES = {
    "bare": Finish(0.55, 0.52, 0.30, 0.18, 0.50),
    "powdered": Finish(0.28, 0.68, 0.45, 0.10, 0.68),
    "oily": Finish(0.90, 0.46, 0.26, 0.40, 0.40),
}


def spectra(pigments: Pigments) -> tuple[float, FloatArray, FloatArray]:
    """Return alpha, S and Ss [1]: alpha = 1 / (1 + the luminous mean of Ss)."""
    spread = scattering(WAVELENGTH_NM, pigments)
    bright = color_matching_functions(WAVELENGTH_NM)[:, 1]
    alpha = 1.0 / (1.0 + float(spread @ bright / bright.sum()))
    whole = reflectance(WAVELENGTH_NM, pigments)
    return alpha, whole / (alpha * (1.0 + (1.0 + WRAP) * spread)), spread


def linear_rgb(values: FloatArray) -> FloatArray:
    """Return the linear Rec. 709 color of a reflectance under D65, shape [3]."""
    weights = illuminant("D65", WAVELENGTH_NM)[:, None] * xyz_weights(WAVELENGTH_NM)
    white = weights.sum(axis=0)
    space = "lin_rec709_scene"
    seen = values @ weights / white[1]
    return xyz_to_rgb(space) @ cat16(white / white[1], white_xyz(space)) @ seen


def lab(pigments: Pigments) -> FloatArray:
    """Return CIE L*a*b* under D65 as an instrument reads it, surface included, shape [3]."""
    weights = illuminant("D65", WAVELENGTH_NM)[:, None] * xyz_weights(WAVELENGTH_NM)
    read = reflectance(WAVELENGTH_NM, pigments) + F0
    return xyz_to_lab(read @ weights, weights.sum(axis=0))


def typology_angle(color: FloatArray) -> float:
    """Return ITA of L*a*b*, arctan((L* - 50) / b*) [deg] (Chardon 1991)."""
    return float(np.degrees(np.arctan2(color[0] - 50.0, color[2])))


def library() -> Usd.Stage:
    """Return the layer."""
    stage = Usd.Stage.CreateInMemory("skin_library.usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = (
        "Skins, modelled from their pigments and not measured: variant sets `tone` and `finish` of "
        "/Skin. Made by make_library.py; change it there."
    )
    material = UsdShade.Material.Define(stage, "/Skin")
    prim = material.GetPrim()
    stage.SetDefaultPrim(prim)
    prim.ApplyAPI("SkinMaterialAPI")
    prim.GetAttribute("fit:convention").Set("luminousMean")
    for name, value in (("wrap", WRAP), ("specular:f0", F0), ("epidermisThickness", EPIDERMIS_M)):
        prim.GetAttribute(f"inputs:skin:{name}").Set(value)
    surface = UsdShade.Shader.Define(stage, "/Skin/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    surface.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(1.4)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")

    tones = prim.GetVariantSets().AddVariantSet("tone")
    for name, pigments in TONES.items():
        tones.AddVariant(name)
        tones.SetVariantSelection(name)
        with tones.GetVariantEditContext():
            _write_tone(prim, surface, pigments)
    tones.SetVariantSelection("tone3")
    finishes = prim.GetVariantSets().AddVariantSet("finish")
    for name, finish in FINISHES.items():
        finishes.AddVariant(name)
        finishes.SetVariantSelection(name)
        with finishes.GetVariantEditContext():
            _write_finish(prim, surface, finish)
    finishes.SetVariantSelection("bare")
    return stage


def _write_tone(prim: Usd.Prim, surface: UsdShade.Shader, pigments: Pigments) -> None:
    alpha, shown, spread = spectra(pigments)
    fading = effective_attenuation(WAVELENGTH_NM, pigments)
    for name, quantity, values in (
        ("reflectance", SpectralQuantity.REFLECTANCE, np.round(shown, 5)),
        ("scattering", SpectralQuantity.SCATTERING, np.round(spread, 5)),
        ("opacity", SpectralQuantity.ABSORPTION, np.round(fading, 1)),
    ):
        write_spectrum(prim, name, Spectrum(quantity, WAVELENGTH_NM, values))
    for name, value in (
        ("alpha", round(alpha, 6)),
        ("melanin", pigments.melanin),
        ("haemoglobin", pigments.blood),
        ("oxygenation", pigments.oxygenation),
    ):
        prim.GetAttribute(f"inputs:skin:{name}").Set(value)
    color = linear_rgb(reflectance(WAVELENGTH_NM, pigments))
    shader_color = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    shader_color.Set(Gf.Vec3f(*(round(float(value), 4) for value in color)))


def _write_finish(prim: Usd.Prim, surface: UsdShade.Shader, finish: Finish) -> None:
    for name in ("weight", "roughness1", "roughness2", "mix"):
        prim.GetAttribute(f"inputs:skin:specular:{name}").Set(getattr(finish, name))
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(finish.preview_roughness)


def main() -> None:
    """Write the layer and print what the README's table says."""
    write_layer(library(), FOLDER / "skin_library.usda")
    for name, pigments in TONES.items():
        color = lab(pigments)
        shown = linear_rgb(reflectance(WAVELENGTH_NM, pigments))
        print(
            f"{name}  ITA {typology_angle(color):5.1f}  L*a*b* "
            + " ".join(f"{value:5.1f}" for value in color)
            + "  sRGB #"
            + "".join(f"{round(255 * float(v)):02x}" for v in encode_srgb(shown))
        )


if __name__ == "__main__":
    main()
