"""The true skin of a proof: that of the shot, the same everywhere."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import cat16, white_xyz, xyz_to_rgb, xyz_weights
from usdskin.errors import LayerError
from usdskin.illuminants import illuminant
from usdskin.judge.skin.goniometer import spectra_of
from usdskin.layers import open_stage, record_provenance, write_layer
from usdskin.prims.skin import SkinParameters, read_skin, write_skin
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

FloatArray = NDArray[np.float64]

SHOT_SKIN = "/Shot/Skin"
"""The Material that a proof's shot binds to its subject."""

_SPACE = "lin_rec709_scene"


def tones_of(shot: Path) -> list[str]:
    """Return the tones that a shot's skin can have."""
    stage = open_stage(shot)
    prim = stage.GetPrimAtPath(SHOT_SKIN)
    if not prim:
        return []
    return list(prim.GetVariantSets().GetVariantSet("tone").GetVariantNames())


def even_skin(shot: Path, lustre: bool) -> SkinParameters:
    """Return the skin of a shot without its textures.

    Args:
        shot: The shot.
        lustre: Whether it keeps what its surface mirrors.

    Raises:
        LayerError: The shot has no skin, or one that is nothing but textures.
    """
    stage = open_stage(shot)
    prim = stage.GetPrimAtPath(SHOT_SKIN)
    if not prim or not prim.HasAPI("SkinMaterialAPI"):
        raise LayerError(
            f"{shot}: <{SHOT_SKIN}> is no Material with SkinMaterialAPI; a proof's shot has its "
            "subject's skin there"
        )
    skin = read_skin(prim)
    if skin.reflectance is None:
        raise LayerError(
            f"{shot}: <{SHOT_SKIN}> has no spectrum of reflectance; give it one of skin_library"
        )
    return replace(
        skin,
        albedo_file=None,
        weights_file=None,
        weights_basis=None,
        weights_wavelength_nm=None,
        normal_file=None,
        bump_file=None,
        displacement_file=None,
        specular_weight_file=None,
        specular_roughness_file=None,
        specular_weight=skin.specular_weight if lustre else 0.0,
    )


def write_true_skin(skin: SkinParameters, shot: Path, output: Path) -> Path:
    """Write a skin as a Material of its own.

    Args:
        skin: The skin.
        shot: Where it is from.
        output: Layer to write.
    """
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    material = UsdShade.Material.Define(stage, "/Skin")
    stage.SetDefaultPrim(material.GetPrim())
    write_skin(material.GetPrim(), skin, output.parent)
    surface = UsdShade.Shader.Define(stage, "/Skin/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    color = Gf.Vec3f(*(float(value) for value in _preview_color(skin)))
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(color)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    record_provenance(stage, "prove", [shot], {}, output.parent)
    return write_layer(stage, output)


def _preview_color(skin: SkinParameters) -> FloatArray:
    """Return the linear Rec. 709 colour of the skin facing the light, under D65, shape [3]."""
    grid = DEFAULT_WAVELENGTHS_NM
    reflectance, scattering, _ = spectra_of(skin, grid)
    weights = illuminant("D65", grid)[:, None] * xyz_weights(grid)
    weights = weights / weights[:, 1].sum()
    facing = skin.alpha * reflectance * (1.0 + scattering)
    adapted = cat16(weights.sum(axis=0), white_xyz(_SPACE)) @ (facing @ weights)
    return np.asarray(np.clip(xyz_to_rgb(_SPACE) @ adapted, 0.0, 1.0))
