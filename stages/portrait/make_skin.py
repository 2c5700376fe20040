"""Make the portrait's skin: ``python stages/portrait/make_skin.py``.

Reads:  ``../skin_library/skin_library.usda``, for the tone of ``complexion``.
Writes: ``skin.usda``, that tone with the spectra that the face is mixed of. It is committed; run
        this after a change. The weights over the face are ``assets/weights.exr``.

The spectra come out so that a uniform room of radiance 1 gives back the reflectance R of
``skin_spectra``: alpha S (1 + (1 + l) Ss) = R, the model's furnace value.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from complexion import TONE, basis
from library import LIBRARY, WAVELENGTH_NM
from numpy.typing import NDArray

from usdskin.layers import open_stage, write_layer
from usdskin.prims import read_skin

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdShade, Vt

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
SKINS = "../skin_library/skin_library.usda"

THICKNESS_M = 0.006
"""Through the ears and the wings of the nose, where the head's primvar says nothing [m]."""


def weights_basis() -> FloatArray:
    """Return the spectra that the weights multiply [1], shape [4, band_count]."""
    stage = open_stage(LIBRARY / "skin_library.usda")
    prim = stage.GetDefaultPrim()
    prim.GetVariantSet("tone").SetVariantSelection(TONE)
    skin = read_skin(prim)
    assert skin.scattering is not None
    spread = skin.scattering.resample(WAVELENGTH_NM)
    return np.round(basis() / (skin.alpha * (1.0 + (1.0 + skin.wrap) * spread)), 6)


def main() -> None:
    """Write the layer."""
    temporary = FOLDER / "skin.usda.tmp.usda"
    stage = Usd.Stage.CreateNew(str(temporary))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = (
        "A skin of the library, mixed over the face. Made by make_skin.py; change it there."
    )
    prim = UsdShade.Material.Define(stage, "/Skin").GetPrim()
    stage.SetDefaultPrim(prim)
    prim.GetReferences().AddReference(SKINS)
    prim.GetVariantSet("tone").SetVariantSelection(TONE)
    for name, value in (
        ("thickness", THICKNESS_M),
        ("weights:file", Sdf.AssetPath("./assets/weights.exr")),
        ("weights:basis", Vt.DoubleArray.FromNumpy(weights_basis().ravel())),
        ("weights:basis:wavelengths", Vt.DoubleArray.FromNumpy(WAVELENGTH_NM)),
    ):
        prim.GetAttribute(f"inputs:skin:{name}").Set(value)
    write_layer(stage, FOLDER / "skin.usda")
    temporary.unlink(missing_ok=True)


if __name__ == "__main__":
    main()
