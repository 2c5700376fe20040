"""The materials of an imported mesh: a ``UsdPreviewSurface`` for everybody, and the skin."""

from __future__ import annotations

import os
import re
from importlib import resources
from pathlib import Path

import numpy as np

from usdskin.colorimetry import cat16, illuminant, white_xyz, xyz_to_rgb, xyz_weights
from usdskin.image_output import write_png
from usdskin.meshfiles.meshfile import FileMaterial
from usdskin.prims import write_spectrum
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, SpectralQuantity, Spectrum
from usdskin.uplift import reflectance_basis

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, UsdShade

Color = tuple[float, float, float]

_SPACE = "lin_rec709_scene"

_REFERENCE = "skin_reference.csv"
"""Modelled skin in ``usdskin/data``: wavelength_nm, reflectance and scattering."""

_QUANTITIES = {
    "reflectance": SpectralQuantity.REFLECTANCE,
    "scattering": SpectralQuantity.SCATTERING,
}


def write_material(
    material: UsdShade.Material, given: FileMaterial, output: Path, *, is_skin: bool
) -> bool:
    """Author a material on an empty Material prim.

    The reflectance of skin is that of its texture, else its color lifted to a spectrum, else the
    modelled one that ships with usdskin; only this comes with scattering, so that a texture or a
    color shows as it is in uniform light.

    Args:
        material: Prim to write to.
        given: What the mesh file says.
        output: Layer that will hold it; pictures from inside the mesh file go beside it.
        is_skin: Whether it is skin.

    Returns:
        Whether it has a color, a texture or a spectrum.
    """
    texture = _texture_file(material, given, output)
    spectra = reference_spectra() if is_skin else {}
    if texture is not None:
        spectra = {}
    elif given.diffuse_color is not None and is_skin:
        spectra = {"reflectance": lifted_spectrum(given.diffuse_color)}
    color = given.diffuse_color
    if color is None and "reflectance" in spectra:
        color = _rgb(spectra["reflectance"])
    _write_preview(material, given, color, texture)
    if is_skin:
        prim = material.GetPrim()
        prim.ApplyAPI("SkinMaterialAPI")
        if texture is not None:
            prim.GetAttribute("inputs:skin:albedo:file").Set(texture)
        for name, spectrum in spectra.items():
            write_spectrum(prim, name, spectrum)
    return color is not None or texture is not None


def _texture_file(
    material: UsdShade.Material, given: FileMaterial, output: Path
) -> Sdf.AssetPath | None:
    if given.diffuse_texture is not None:
        return relative_asset(given.diffuse_texture, output)
    if given.diffuse_pixels is not None:
        name = re.sub(r"[^\w.-]", "_", f"{output.stem}_{material.GetPrim().GetName()}.png")
        write_png(output.with_name(name), given.diffuse_pixels)
        return Sdf.AssetPath(f"./{name}")
    return None


def relative_asset(file: Path, output: Path) -> Sdf.AssetPath:
    """Return how a layer names a file: from its own folder, with ``./`` in front."""
    name = Path(os.path.relpath(file.resolve(), output.parent.resolve())).as_posix()
    return Sdf.AssetPath(name if name.startswith("../") else f"./{name}")


def reference_spectra() -> dict[str, Spectrum]:
    """Return the spectra of the modelled skin that ships with usdskin, by instance name."""
    file = resources.files("usdskin") / "data" / _REFERENCE
    if not file.is_file():
        return {}
    lines = [line for line in file.read_text("utf-8").splitlines() if not line.startswith("#")]
    names = [name.strip() for name in lines[0].split(",")]
    table = np.loadtxt(lines[1:], delimiter=",", ndmin=2)
    return {
        name: Spectrum(_QUANTITIES[name], table[:, 0], table[:, column])
        for column, name in enumerate(names)
        if name in _QUANTITIES
    }


def lifted_spectrum(
    color: Color, quantity: SpectralQuantity = SpectralQuantity.REFLECTANCE
) -> Spectrum:
    """Return the spectrum of a linear Rec.709 color, exact under D65 where it is from 0 to 1."""
    basis = reflectance_basis(DEFAULT_WAVELENGTHS_NM, _SPACE)
    values = np.clip(np.asarray(color) @ basis, 0.0, 1.0)
    return Spectrum(quantity, DEFAULT_WAVELENGTHS_NM, values)


def _rgb(reflectance: Spectrum) -> Color:
    """Return the linear Rec.709 color of a reflectance under D65, where a perfect white is 1."""
    grid = DEFAULT_WAVELENGTHS_NM
    weights = illuminant("D65", grid)[:, None] * xyz_weights(grid, "cie1931_2", False)
    weights /= weights[:, 1].sum()
    adapted = cat16(weights.sum(axis=0), white_xyz(_SPACE)) @ (reflectance.resample(grid) @ weights)
    red, green, blue = xyz_to_rgb(_SPACE) @ adapted
    return max(float(red), 0.0), max(float(green), 0.0), max(float(blue), 0.0)


def _write_preview(
    material: UsdShade.Material,
    given: FileMaterial,
    diffuse_color: Color | None,
    texture: Sdf.AssetPath | None,
) -> None:
    stage, path = material.GetPrim().GetStage(), material.GetPath()
    surface = UsdShade.Shader.Define(stage, path.AppendChild("surface"))
    surface.CreateIdAttr("UsdPreviewSurface")
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")
    color = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    if texture is not None:
        node = _write_texture(material, texture, given.diffuse_scale)
        color.ConnectToSource(node.ConnectableAPI(), "rgb")
    elif diffuse_color is not None:
        color.Set(Gf.Vec3f(*diffuse_color))
    for name, value in (
        ("opacity", given.opacity if given.opacity < 1.0 else None),
        ("ior", given.ior),
        ("roughness", given.roughness),
        ("metallic", given.metallic),
    ):
        if value is not None:
            surface.CreateInput(name, Sdf.ValueTypeNames.Float).Set(value)


def _write_texture(
    material: UsdShade.Material, texture: Sdf.AssetPath, scale: tuple[float, float, float]
) -> UsdShade.Shader:
    stage, path = material.GetPrim().GetStage(), material.GetPath()
    coordinates = UsdShade.Shader.Define(stage, path.AppendChild("st"))
    coordinates.CreateIdAttr("UsdPrimvarReader_float2")
    coordinates.CreateInput("varname", Sdf.ValueTypeNames.String).Set("st")
    coordinates.CreateOutput("result", Sdf.ValueTypeNames.Float2)
    node = UsdShade.Shader.Define(stage, path.AppendChild("diffuse"))
    node.CreateIdAttr("UsdUVTexture")
    node.CreateInput("file", Sdf.ValueTypeNames.Asset).Set(texture)
    node.CreateInput("sourceColorSpace", Sdf.ValueTypeNames.Token).Set("auto")
    node.CreateInput("wrapS", Sdf.ValueTypeNames.Token).Set("repeat")
    node.CreateInput("wrapT", Sdf.ValueTypeNames.Token).Set("repeat")
    if scale != (1.0, 1.0, 1.0):
        node.CreateInput("scale", Sdf.ValueTypeNames.Float4).Set(Gf.Vec4f(*scale, 1.0))
    node.CreateInput("st", Sdf.ValueTypeNames.Float2).ConnectToSource(
        coordinates.ConnectableAPI(), "result"
    )
    node.CreateOutput("rgb", Sdf.ValueTypeNames.Float3)
    return node
