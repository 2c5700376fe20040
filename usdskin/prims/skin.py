"""``SkinMaterialAPI`` <-> ``SkinParameters``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.spectra import read_spectrum, write_spectrum
from usdskin.prims.values import DEFAULT_TIME, read_schema
from usdskin.prims.writing import write_schema
from usdskin.spectrum import SpectralQuantity, Spectrum


@dataclass(frozen=True, slots=True, eq=False)
class SkinParameters:
    """What a skin material says, as plain values; the defaults are the schema's fallbacks."""

    alpha: float = 1.0
    """Share of the light that is reflected diffusely [1]."""

    wrap: float = 0.3
    """l, how far scattered light reaches beyond the shadow line [1]."""

    reflectance: Spectrum | None = None
    """S [1]."""

    scattering: Spectrum | None = None
    """Ss [1]; None is 0."""

    opacity: Spectrum | float = 0.0
    """delta, attenuation inside the body [m^-1]."""

    thickness: float = 0.0
    """Way through the body that light from behind takes [m]."""

    wrap_normalization: str = "paper"
    """``paper``, or ``energy``: the wrap term divided by 1 + l."""

    albedo_file: Path | None = None
    """RGB texture of S; may hold ``<UDIM>``."""

    albedo_color_space: str = "auto"
    """Encoding of the texture: ``auto``, ``raw`` or ``sRGB``."""

    weights_file: Path | None = None
    """Texture of the weights of the basis; may hold ``<UDIM>``."""

    weights_basis: NDArray[np.float64] | None = None
    """Spectra of reflectance the weights multiply [1], shape [basis_count, band_count]."""

    weights_wavelength_nm: NDArray[np.float64] | None = None
    """Wavelengths of the columns of the basis [nm], shape [band_count]."""

    texcoord: str = "st"
    """Primvar with the texture coordinates."""

    normal_file: Path | None = None
    """Tangent-space normal map, (n + 1) / 2."""

    bump_file: Path | None = None
    """Height map in R."""

    bump_depth: float = 0.0001
    """Height of a value of 1 in it [m]."""

    displacement_file: Path | None = None
    """Displacement map in R."""

    displacement_scale: float = 0.001
    """Way of a value of 1 above the mid level [m]."""

    displacement_mid_level: float = 0.5
    """Value of no displacement [1]."""

    specular_weight: float = 0.0
    """Strength of the specular reflection [1]."""

    roughness1: float = 0.5
    """Roughness of the first GGX lobe [1]."""

    roughness2: float = 0.3
    """Roughness of the second GGX lobe [1]."""

    mix: float = 0.3
    """Share of the second lobe [1]."""

    specular_weight_file: Path | None = None
    """Texture that takes the place of ``specular_weight``."""

    specular_roughness_file: Path | None = None
    """Texture that takes the place of ``roughness1``; ``roughness2`` keeps its ratio to it."""

    f0: float = 0.028
    """Reflectance of the surface at normal incidence [1]."""


# Field <-> attribute, where the value is taken as it is.
_FIELDS = {
    "alpha": "inputs:skin:alpha",
    "wrap": "inputs:skin:wrap",
    "opacity": "inputs:skin:opacity",
    "thickness": "inputs:skin:thickness",
    "wrap_normalization": "inputs:skin:wrapNormalization",
    "albedo_file": "inputs:skin:albedo:file",
    "albedo_color_space": "inputs:skin:albedo:sourceColorSpace",
    "weights_file": "inputs:skin:weights:file",
    "weights_wavelength_nm": "inputs:skin:weights:basis:wavelengths",
    "texcoord": "inputs:skin:texcoord",
    "normal_file": "inputs:skin:normal:file",
    "bump_file": "inputs:skin:bump:file",
    "bump_depth": "inputs:skin:bump:depth",
    "displacement_file": "inputs:skin:displacement:file",
    "displacement_scale": "inputs:skin:displacement:scale",
    "displacement_mid_level": "inputs:skin:displacement:midLevel",
    "specular_weight_file": "inputs:skin:specular:weight:file",
    "specular_roughness_file": "inputs:skin:specular:roughness:file",
    "specular_weight": "inputs:skin:specular:weight",
    "roughness1": "inputs:skin:specular:roughness1",
    "roughness2": "inputs:skin:specular:roughness2",
    "mix": "inputs:skin:specular:mix",
    "f0": "inputs:skin:specular:f0",
}


def read_skin(prim: Usd.Prim, time: Usd.TimeCode | float = DEFAULT_TIME) -> SkinParameters:
    """Return what a Material with ``SkinMaterialAPI`` says.

    Args:
        prim: Material prim.
        time: Time to read at.

    Raises:
        LayerError: An opinion cannot be used, or one of ours is misspelt.
        ValueError: The schema is not applied to the prim.
    """
    check_applied_schemas(prim)
    if not prim.HasAPI("SkinMaterialAPI"):
        raise ValueError(f"<{prim.GetPath()}> has no SkinMaterialAPI")
    values = read_schema(prim, "SkinMaterialAPI", time)
    fields = {field: values[name] for field, name in _FIELDS.items()}
    basis = values["inputs:skin:weights:basis"]
    if basis is not None:
        fields["weights_basis"] = basis.reshape(-1, len(fields["weights_wavelength_nm"]))
    opacity = read_spectrum(prim, "opacity", time, (SpectralQuantity.ABSORPTION,))
    if opacity is not None:
        fields["opacity"] = opacity
    return SkinParameters(
        reflectance=read_spectrum(prim, "reflectance", time, (SpectralQuantity.REFLECTANCE,)),
        scattering=read_spectrum(prim, "scattering", time, (SpectralQuantity.SCATTERING,)),
        **fields,
    )


def write_skin(prim: Usd.Prim, skin: SkinParameters, folder: str | Path | None = None) -> None:
    """Apply ``SkinMaterialAPI`` to a Material and author what a skin is.

    The rendition for other tools, a ``UsdPreviewSurface``, is up to the caller.

    Args:
        prim: Material prim, written at the stage's edit target.
        skin: What to write.
        folder: Folder the layer is going to be written to; see ``write_schema``.

    Raises:
        LayerError: The prim is no Material, or a file cannot be named from the layer.
    """
    values = {name: getattr(skin, field) for field, name in _FIELDS.items()}
    values["inputs:skin:weights:basis"] = skin.weights_basis
    if isinstance(skin.opacity, Spectrum):
        values["inputs:skin:opacity"] = None
    write_schema(prim, "SkinMaterialAPI", values, folder)
    for name in ("reflectance", "scattering", "opacity"):
        spectrum = getattr(skin, name)
        if isinstance(spectrum, Spectrum):
            write_spectrum(prim, name, spectrum)
