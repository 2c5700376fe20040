"""The layer that a light is published in.

Writes: ``light.usda``, which stands alone beside its pictures. Its one prim::

    /Light    DomeLight: SpectralLightAPI, LightEstimateAPI, SpectralDistributionAPI:mean
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.light.light_map import LightMap
from usdskin.estimate.light.maps import MapFiles
from usdskin.estimate.light.scale import LightScale
from usdskin.layers import record_provenance, write_layer
from usdskin.prims import (
    LightEstimate,
    Recovery,
    SpectralLight,
    write_light_estimate,
    write_spectral_light,
)

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdLux


@dataclass(frozen=True, slots=True, eq=False)
class Background:
    """Where a light comes from."""

    origin: str
    """``measured`` or ``assigned``."""

    documentation: str
    """What a person who opens the layer should know."""

    inputs: Sequence[Path]
    """Files it was made from."""

    settings: Mapping[str, Any]
    """What the step was told."""

    up_axis: str = "Y"
    """``Y`` or ``Z``."""

    recoveries: tuple[Recovery, ...] = ()
    """How each class of lamps was recovered."""

    weights: NDArray[np.float32] | None = None
    """Share of each class, shape [height, width, classes]; None: one class."""

    scale: LightScale | None = None
    """What a reading said."""

    clipped_share: float | None = None
    """Share of the luminous flux in saturated pixels [1]."""

    illuminant: str = ""
    """The lamp that was assigned."""


def write_light_layer(
    light: LightMap,
    files: MapFiles,
    estimate: LightEstimate,
    background: Background,
    output: Path,
    scratch: Path,
) -> None:
    """Write the layer of a light to a scratch folder.

    Args:
        light: The light, as its pictures hold it.
        files: Those pictures.
        estimate: What the light is like.
        background: Where it comes from.
        output: Where the layer will be brought.
        scratch: Where it is written, under the same name.

    Raises:
        LayerError: It cannot be written.
    """
    stage = Usd.Stage.CreateInMemory("light.usda")
    UsdGeom.SetStageUpAxis(stage, background.up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    dome = UsdLux.DomeLight.Define(stage, "/Light")
    prim = dome.GetPrim()
    stage.SetDefaultPrim(prim)
    prim.SetDocumentation(background.documentation)
    dome.CreateTextureFileAttr(f"./{files.rendition.name}")
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    if background.up_axis == "Z":
        # A latlong map's pole is the light's +Y.
        UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)
    write_spectral_light(prim, _spectral_light(light, files))
    write_light_estimate(prim, estimate)
    record_provenance(stage, "estimateLight", background.inputs, background.settings, output.parent)
    write_layer(stage, scratch / output.name)


def _spectral_light(light: LightMap, files: MapFiles) -> SpectralLight:
    units = "absolute" if light.is_absolute else "relative"
    classes = _beside(files.classes)
    if files.bands is not None:
        return SpectralLight(
            source="bands", bands_file=_beside(files.bands), units=units, class_map_file=classes
        )
    return SpectralLight(
        source="basis",
        coefficients_file=_beside(files.coefficients),
        basis=light.basis,
        basis_wavelength_nm=light.wavelength_nm,
        units=units,
        class_map_file=classes,
    )


def _beside(path: Path | None) -> Path | None:
    return None if path is None else Path(path.name)
