"""The light layer of a solved set: a spectral dome, lamps that are far away, RGB for others.

Writes: ``NAME.usda`` with ``NAME.coefficients.exr`` (basis) or ``NAME.bands.exr`` and
        ``NAME.rgb.exr``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_to_rgb, xyz_weights
from usdskin.images import Part, write_exr, write_spectral_exr
from usdskin.layers import SettingValue, record_provenance, write_layer
from usdskin.prims import SpectralLight, write_spectral_light
from usdskin.render.lights import DistantLight
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdLux

FloatArray = NDArray[np.float64]

RESIDUAL = 1e-5
"""Largest error of a basis, over the peak of the light that surfaces return."""

_SPACE = "lin_rec709_scene"


@dataclass(frozen=True, slots=True, eq=False)
class SeenLight:
    """What is written."""

    radiance: FloatArray
    """[W m^-2 sr^-1 nm^-1], shape [height, width, band_count]."""

    reflected: NDArray[np.bool_]
    """Texels in which no lamp shines, shape [height, width]."""

    suns: Sequence[tuple[DistantLight, float]]
    """Lamps that are far away, and the share of them that is seen."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [band_count]."""

    up_axis: str
    """``Y`` or ``Z``."""


def light_files(output: Path, form: str) -> tuple[Path, Path]:
    """Return the names of the pictures beside a layer: spectra, and RGB."""
    begin = output.with_suffix("")
    kind = "coefficients" if form == "basis" else "bands"
    return begin.with_name(f"{begin.name}.{kind}.exr"), begin.with_name(f"{begin.name}.rgb.exr")


def write_light(
    light: SeenLight,
    output: Path,
    form: str,
    inputs: Sequence[Path],
    settings: Mapping[str, SettingValue],
    documentation: str,
) -> int:
    """Write a light layer and its pictures, and return the rank of its basis (0 for bands).

    Args:
        light: The light.
        output: Layer to write.
        form: ``basis`` or ``bands``.
        inputs: Files it was made from.
        settings: What the step was told.
        documentation: What a person who opens the layer should know.

    Raises:
        LayerError: The layer cannot be written.
        ImageError: A picture cannot be written.
    """
    spectra_file, rgb_file = light_files(output, form)
    to_rgb = xyz_weights(light.wavelength_nm, absolute=True) @ xyz_to_rgb(_SPACE).T
    rgb = (light.radiance @ to_rgb).astype(np.float32)
    spectral = SpectralLight(source="bands", bands_file=Path(spectra_file.name), units="absolute")
    if form == "basis":
        coefficients, basis = low_rank(light.radiance, light.reflected)
        channels = {f"c{index}": coefficients[..., index] for index in range(len(basis))}
        write_exr(spectra_file, [Part("", channels, {}, "float", "data")], "zip:6")
        spectral = SpectralLight(
            source="basis",
            coefficients_file=Path(spectra_file.name),
            basis=basis,
            basis_wavelength_nm=light.wavelength_nm,
            units="absolute",
        )
    else:
        radiance = light.radiance.astype(np.float32)
        write_spectral_exr(spectra_file, light.wavelength_nm, radiance, rgb)
    write_exr(rgb_file, [Part("", {"": np.maximum(rgb, 0.0)}, {}, "float", _SPACE)], "zip:6")

    stage = Usd.Stage.CreateInMemory("light.usda")
    UsdGeom.SetStageUpAxis(stage, light.up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/Light").GetPrim()
    stage.SetDefaultPrim(root)
    root.SetDocumentation(documentation)
    dome = UsdLux.DomeLight.Define(stage, "/Light/Dome")
    dome.CreateTextureFileAttr(f"./{rgb_file.name}")
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    if light.up_axis == "Z":
        # A latlong map's pole is the light's +Y.
        UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)
    write_spectral_light(dome.GetPrim(), spectral)
    for sun, share in light.suns:
        if share > 0.0:
            _add_sun(stage, sun, share, light.wavelength_nm)
    record_provenance(stage, "solve", inputs, settings, output.parent)
    write_layer(stage, output)
    return 0 if form == "bands" else len(spectral.basis if spectral.basis is not None else ())


def low_rank(
    radiance: FloatArray, reflected: NDArray[np.bool_]
) -> tuple[NDArray[np.float32], FloatArray]:
    """Return coefficients and basis of a picture.

    The rank is the least at which no value is off by more than ``RESIDUAL`` of the peak of the
    light that surfaces return, a tenth of that in the mean.

    Args:
        radiance: Shape [height, width, band_count].
        reflected: Texels that count for the peak, shape [height, width].

    Returns:
        Coefficients, shape [height, width, rank]; orthonormal basis, shape [rank, band_count].
    """
    rows = radiance.reshape(-1, radiance.shape[2])
    peaks = rows.max(axis=1)
    is_plain = reflected.ravel() & (peaks > 0.0)
    peak = float(peaks[is_plain].max() if is_plain.any() else peaks.max(initial=0.0))
    # Bright spectra may err by as much of themselves as dark ones do.
    bound = RESIDUAL * np.maximum(peak, peaks)
    scaled = rows / np.maximum(bound, 1e-300)[:, None]
    _, vectors = np.linalg.eigh(scaled.T @ scaled)
    vectors = vectors[:, ::-1]
    for rank in range(1, rows.shape[1] + 1):
        basis = vectors[:, :rank].T
        coefficients = (rows @ basis.T).astype(np.float32)
        error = np.abs(coefficients @ basis - rows).max(axis=1)
        if (error <= bound).all() and error.mean() <= 0.1 * RESIDUAL * peak:
            break
    # The first spectrum is light, not its negative.
    signs = np.where(basis.sum(axis=1) < 0.0, -1.0, 1.0)
    coefficients *= signs.astype(np.float32)
    return coefficients.reshape(*radiance.shape[:2], -1), basis * signs[:, None]


def _add_sun(stage: Usd.Stage, sun: DistantLight, share: float, wavelength_nm: FloatArray) -> None:
    name = sun.path.rpartition("/")[2]
    prim = UsdLux.DistantLight.Define(stage, f"/Light/{name}")
    prim.CreateAngleAttr(float(sun.angle_deg))
    prim.CreateIntensityAttr(1.0)  # UsdLux falls back to 50000
    # Its axis +Z points to the lamp.
    z = Gf.Vec3d(*sun.direction.tolist())
    prim.AddOrientOp(UsdGeom.XformOp.PrecisionDouble).Set(
        Gf.Quatd(Gf.Rotation(Gf.Vec3d(0, 0, 1), z).GetQuat())
    )
    values = share * sun.irradiance
    emission = Spectrum(SpectralQuantity.IRRADIANCE, wavelength_nm, values)
    write_spectral_light(
        prim.GetPrim(), SpectralLight(source="tabulated", emission=emission, units="absolute")
    )
    xyz = values @ xyz_weights(wavelength_nm, absolute=True)
    color = np.clip(xyz_to_rgb(_SPACE) @ (xyz / max(xyz[1], 1e-30)), 0.0, None)
    prim.CreateColorAttr(Gf.Vec3f(*color.tolist()))
