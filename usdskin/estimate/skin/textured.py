"""Give an RGB albedo texture the spectra of skin.

Reads:  a picture of what the skin reflects, and optionally a material to be like.
Writes: ``skin.usda``, a Material whose weights texture multiplies three spectra of skin, and
        ``<name>.weights.exr`` beside it.

A texture tells colours only. Its spectra are the likeliest of measured skin with those colours;
wrap, scattering, opacity and lustre are those of the other material, or of the modelled skin that
is shipped. The layer says so.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from usdskin.colorimetry import color_space_names
from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.estimate.skin.albedo import AlbedoWeights, weights_of_albedo
from usdskin.images import Image, Part, read_image, write_exr
from usdskin.layers import (
    check_output,
    open_stage,
    record_provenance,
    reload_open_copy,
    write_layer,
)
from usdskin.meshfiles.materials import reference_spectra
from usdskin.notes import Note
from usdskin.prims import SkinParameters, read_skin, write_skin
from usdskin.replacing import replace_all, scratch_beside
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdShade

_MATERIAL_PATH = "/Skin"
_PREVIEW_ROUGHNESS = 0.5
_WHOLE_NUMBERS = ("uint8", "uint16")


@dataclass(frozen=True, slots=True, eq=False)
class TexturedSkin:
    """What the step did."""

    paths: tuple[Path, ...]
    """Files written, the layer first."""

    notes: list[Note]
    """What limits the trust in it."""

    seconds: dict[str, float]
    """Time the step took [s]."""


def estimate_textured_skin(
    albedo: str | Path,
    output: str | Path,
    like: str | Path | None = None,
    color_space: str | None = None,
) -> TexturedSkin:
    """Write a skin material of an RGB albedo texture.

    Evenly lit skin reflects the colours of the texture exactly: the spectra are divided by
    alpha (1 + (1 + l) Ss), which is what eq. (1) makes of them in even light.

    Args:
        albedo: Picture of the diffuse reflectance.
        output: Layer to write; the weights are written beside it.
        like: Layer with a skin material whose alpha, wrap, scattering, opacity and lustre to take;
            None: the modelled skin that is shipped.
        color_space: USD's name of the picture's colour space; None: what the file says, else
            ``srgb_rec709_scene`` for whole numbers and ``lin_rec709_scene`` for the others.

    Returns:
        The files, complete on disk.

    Raises:
        ImageError: The picture cannot be read, or a texel is not finite.
        LayerError: The other material cannot be read, or the output cannot be written.
        UsageError: An unknown colour space, or the output is an input.
    """
    began = time.perf_counter()
    albedo, output = Path(albedo), Path(output)
    notes: list[Note] = []
    weights_path = output.with_name(f"{output.stem}.weights.exr")
    inputs = [albedo, *([Path(like)] if like is not None else [])]
    check_output(output, inputs, [weights_path], step="estimate")
    if color_space is not None and color_space not in color_space_names():
        raise UsageError(
            f"--color-space {color_space}: no color space of USD; use one such as "
            "srgb_rec709_scene or lin_rec709_scene"
        )
    image = read_image(albedo)
    space = color_space or image.color_space or _usual_space(image)
    pixels = _rgb(image, albedo)
    _check_range(pixels, albedo, notes)
    found = weights_of_albedo(pixels, space, where=str(albedo), notes=notes)
    skin = _like(like, albedo, notes)
    stage = _layer(albedo, output, weights_path, found, skin)
    settings: dict[str, Any] = {"colorSpace": space}
    record_provenance(stage, "estimateSkin", inputs, settings, output.parent)
    with scratch_beside(output) as scratch:
        part = Part("weights", {"": found.weights}, sample_type="half", color_space="unknown")
        write_exr(scratch / weights_path.name, [part])
        write_layer(stage, scratch / output.name)
        replace_all(scratch, (output, weights_path))
    reload_open_copy(output)
    return TexturedSkin((output, weights_path), notes, {"skin": time.perf_counter() - began})


def _usual_space(image: Image) -> str:
    return "srgb_rec709_scene" if image.sample_type in _WHOLE_NUMBERS else "lin_rec709_scene"


def _check_range(pixels: Any, path: Path, notes: list[Note]) -> None:
    """Refuse negative reflectance, and note more than all the light."""
    below = np.argwhere((pixels < 0.0).any(axis=2))
    if len(below):
        y, x = below[0]
        raise ImageError(
            f"{path}: the texel at x {x}, y {y} is negative ({float(pixels[y, x].min()):g}); a "
            "reflectance is 0 or more, so mend it"
        )
    above = (pixels > 1.0).any(axis=2)
    if above.any():
        text = f"{int(above.sum())} of {above.size} texels reflect more than all the light, up to "
        text += f"{float(pixels.max()):.3g}; is it an albedo?"
        notes.append(Note("albedo-above-one", str(path), text))


def _rgb(image: Image, path: Path) -> Any:
    if {"R", "G", "B"} <= set(image.channel_names):
        return image.pixels[..., [image.channel_names.index(name) for name in "RGB"]]
    if image.pixels.shape[2] == 1:
        return np.repeat(image.pixels, 3, axis=2)
    raise LayerError(
        f"{path}: has the channels {', '.join(image.channel_names[:6])}; an albedo has R, G, B"
    )


def _like(layer: str | Path | None, albedo: Path, notes: list[Note]) -> SkinParameters:
    """Return what a texture does not tell."""
    if layer is None:
        spectra = reference_spectra()
        notes.append(
            Note(
                "scattering-assumed",
                str(albedo),
                "a texture does not tell wrap and scattering: those of the modelled skin that is "
                "shipped are taken; name a measured one with --like",
            )
        )
        return SkinParameters(scattering=spectra.get("scattering"))
    stage = open_stage(layer, notes)
    default = stage.GetDefaultPrim()
    found = [default, *stage.Traverse()] if default else list(stage.Traverse())
    skins = [prim for prim in found if prim.HasAPI("SkinMaterialAPI")]
    if not skins:
        raise LayerError(
            f"{layer}: no Material has SkinMaterialAPI; `usdskin estimate skin` writes such a layer"
        )
    return read_skin(skins[0])


def _layer(
    albedo: Path, output: Path, weights: Path, found: AlbedoWeights, skin: SkinParameters
) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory(output.name)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    material = UsdShade.Material.Define(stage, _MATERIAL_PATH)
    stage.SetDefaultPrim(material.GetPrim())
    material.GetPrim().SetDocumentation(
        "Skin spectra assigned to the colors of a texture by a prior on measured skin; wrap and "
        "scattering are not from the texture."
    )
    grid = DEFAULT_WAVELENGTHS_NM
    spread = 0.0 if skin.scattering is None else skin.scattering.resample(grid)
    gain = 1.0 if skin.wrap_normalization == "energy" else 1.0 + skin.wrap
    even = skin.alpha * (1.0 + gain * spread)
    textured = replace(
        skin,
        reflectance=None,
        albedo_file=None,
        weights_file=output.parent / weights.name,
        weights_basis=found.basis / even,
        weights_wavelength_nm=found.wavelength_nm,
    )
    write_skin(material.GetPrim(), textured, output.parent)
    _write_preview(material, albedo, output)
    return stage


def _write_preview(material: UsdShade.Material, albedo: Path, output: Path) -> None:
    from usdskin.meshfiles.materials import relative_asset

    stage = material.GetPrim().GetStage()
    surface = UsdShade.Shader.Define(stage, f"{_MATERIAL_PATH}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    reader = UsdShade.Shader.Define(stage, f"{_MATERIAL_PATH}/st")
    reader.CreateIdAttr("UsdPrimvarReader_float2")
    reader.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    reader.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    texture = UsdShade.Shader.Define(stage, f"{_MATERIAL_PATH}/albedo")
    texture.CreateIdAttr("UsdUVTexture")
    texture.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(relative_asset(albedo, output))
    texture.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("auto")
    for name in ("wrapS", "wrapT"):
        texture.CreateInput(name, Sdf.ValueTypeNames.Token).Set("repeat")
    texture.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
        reader.ConnectableAPI(), "result"
    )
    texture.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).ConnectToSource(
        texture.ConnectableAPI(), "rgb"
    )
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(_PREVIEW_ROUGHNESS)
    surface.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(1.4)
