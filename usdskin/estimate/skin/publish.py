"""The layer of an estimated skin: a Material that any stage can reference.

Writes: ``skin.usda``. Its prims::

    /Skin          Material: SkinMaterialAPI, spectra with their standard deviations, the fit
    /Skin/surface  UsdPreviewSurface, for tools that know no spectra
    /Fit           Scope: SkinSampleAPI, the readings as used (a Material holds shaders only)
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import cat16, illuminant, white_xyz, xyz_to_rgb, xyz_weights
from usdskin.estimate.skin.convention import CONVENTION
from usdskin.estimate.skin.fit import SkinFit
from usdskin.estimate.skin.inputs import Columns
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.spectra_of_channels import SkinSpectra
from usdskin.layers import record_provenance, write_layer
from usdskin.prims import (
    SkinFitRecord,
    SkinParameters,
    SkinSamples,
    write_skin,
    write_skin_fit,
    write_skin_samples,
)
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade

FloatArray = NDArray[np.float64]

MATERIAL_PATH = "/Skin"
FIT_PATH = "/Fit"

_MOST_READINGS = 2000
_SPACE = "lin_rec709_scene"
_PREVIEW_ROUGHNESS = 0.5


def publish_skin(
    fit: SkinFit,
    spectra: SkinSpectra,
    readings: Readings,
    columns: Columns,
    output: Path,
    inputs: Sequence[Path],
    settings: Mapping[str, Any],
) -> Path:
    """Write the layer of a skin.

    Args:
        fit: What was fitted.
        spectra: What it means.
        readings: What it was fitted to.
        columns: What their columns are.
        output: Layer to write.
        inputs: Files it was made from.
        settings: What the step was told.

    Raises:
        LayerError: The layer cannot be written.
    """
    stage = Usd.Stage.CreateInMemory("skin.usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    material = UsdShade.Material.Define(stage, MATERIAL_PATH)
    prim = material.GetPrim()
    stage.SetDefaultPrim(prim)
    write_skin(prim, _parameters(fit, spectra))
    write_skin_fit(prim, _record(fit, spectra))
    _write_preview(material, preview_color(spectra))
    scope = UsdGeom.Scope.Define(stage, FIT_PATH).GetPrim()
    write_skin_samples(scope, _used(fit, readings, columns))
    record_provenance(stage, "estimateSkin", inputs, settings, output.parent)
    return write_layer(stage, output)


def _parameters(fit: SkinFit, spectra: SkinSpectra) -> SkinParameters:
    grid = spectra.wavelength_nm
    lobe, delta = fit.lobe, fit.delta
    fields: dict[str, Any] = {}
    if lobe is not None:
        fields = {
            "specular_weight": lobe.weight,
            "roughness1": lobe.roughness1,
            "roughness2": lobe.roughness2,
            "mix": lobe.mix,
            "f0": lobe.f0,
        }
    if delta is not None:
        if len(delta) == len(grid):
            fields["opacity"] = Spectrum(SpectralQuantity.ABSORPTION, grid, delta)
        else:
            fields["opacity"] = float(np.mean(delta))
    return SkinParameters(
        alpha=spectra.alpha,
        wrap=fit.wrap,
        reflectance=Spectrum(SpectralQuantity.REFLECTANCE, grid, spectra.reflectance),
        scattering=Spectrum(SpectralQuantity.SCATTERING, grid, spectra.scattering),
        **fields,
    )


def _record(fit: SkinFit, spectra: SkinSpectra) -> SkinFitRecord:
    grid = spectra.wavelength_nm

    def stddev(values: FloatArray) -> Spectrum:
        # What readings do not tell has no number; 1 is as unsure as a reflectance can be.
        finite = np.nan_to_num(values, nan=1.0, posinf=1.0)
        return Spectrum(SpectralQuantity.RELATIVE, grid, finite)

    return SkinFitRecord(
        convention=CONVENTION,
        parameters=fit.names,
        values=fitted_numbers(fit),
        covariance=np.where(np.isfinite(fit.covariance), fit.covariance, np.finfo(float).max),
        wrap_stddev=float(fit.stddev[0]),
        alpha_stddev=spectra.alpha_stddev,
        residual=fit.residual_rms,
        reach_deg=fit.identifiability.reach_deg,
        needed_reach_deg=fit.identifiability.needed_deg,
        reflectance_stddev=stddev(spectra.reflectance_stddev),
        scattering_stddev=stddev(spectra.scattering_stddev),
    )


def fitted_numbers(fit: SkinFit) -> FloatArray:
    """Return the fitted numbers in the order of ``fit.names``, shape [n]."""
    numbers = [np.array([fit.wrap]), fit.lambert, fit.wrapped]
    if fit.delta is not None:
        numbers.append(fit.delta)
    if fit.lobe is not None:
        lobe = fit.lobe
        known = {
            "weight": lobe.weight,
            "roughness1": lobe.roughness1,
            "roughness2": lobe.roughness2,
            "mix": lobe.mix,
        }
        names = [name.partition(":")[2] for name in fit.names if name.startswith("specular:")]
        numbers.append(np.array([known[name] for name in names]))
    return np.concatenate(numbers)


def preview_color(spectra: SkinSpectra) -> FloatArray:
    """Return the linear Rec. 709 colour of the skin facing the light, under D65, shape [3]."""
    grid = spectra.wavelength_nm
    if grid.size < 3:
        level = spectra.alpha * float(np.mean(spectra.reflectance * (1.0 + spectra.scattering)))
        return np.full(3, level)
    weights = illuminant("D65", grid)[:, None] * xyz_weights(grid)
    weights = weights / weights[:, 1].sum()
    facing = spectra.alpha * spectra.reflectance * (1.0 + spectra.scattering)
    adapted = cat16(weights.sum(axis=0), white_xyz(_SPACE)) @ (facing @ weights)
    return np.asarray(np.clip(xyz_to_rgb(_SPACE) @ adapted, 0.0, 1.0))


def _write_preview(material: UsdShade.Material, color: FloatArray) -> None:
    stage = material.GetPrim().GetStage()
    surface = UsdShade.Shader.Define(stage, f"{MATERIAL_PATH}/surface")
    surface.CreateIdAttr("UsdPreviewSurface")
    diffuse = surface.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f)
    diffuse.Set(Gf.Vec3f(*(float(value) for value in color)))
    surface.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(_PREVIEW_ROUGHNESS)
    surface.CreateInput("ior", Sdf.ValueTypeNames.Float).Set(1.4)
    material.CreateSurfaceOutput().ConnectToSource(surface.ConnectableAPI(), "surface")


def _used(fit: SkinFit, readings: Readings, columns: Columns) -> SkinSamples:
    """Return the readings as the layer keeps them: angles, and at most some thousand of them."""
    step = -(-len(readings.values) // _MOST_READINGS)
    theta_i = readings.theta_deg[::step]
    theta_r = azimuth = None
    if readings.view is not None:
        theta_r = np.degrees(np.arccos(readings.view_cosine))[::step]
        azimuth = _azimuth(readings)[::step]
        if (theta_r > 90.0).any():
            theta_r = azimuth = None
    return SkinSamples(
        theta_i=theta_i,
        theta_r=theta_r,
        azimuth=azimuth,
        values=readings.values[::step],
        wavelength_nm=None if columns.camera is not None else columns.wavelength_nm,
        thickness=None if readings.thickness is None else readings.thickness[::step],
        mask=fit.used[::step],
    )


def _azimuth(readings: Readings) -> FloatArray:
    """Return the angles between the planes of light and view [deg], shape [q]."""
    assert readings.view is not None
    normal = readings.normal

    def flat(vectors: FloatArray) -> FloatArray:
        across = vectors - (vectors * normal).sum(axis=1, keepdims=True) * normal
        return np.asarray(across)

    light, view = flat(readings.light), flat(readings.view)
    sine = (np.cross(light, view) * normal).sum(axis=1)
    return np.asarray(np.degrees(np.arctan2(sine, (light * view).sum(axis=1))))
