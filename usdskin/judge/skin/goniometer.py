"""A virtual goniometer: what a flat sample of a known skin sends back, lamp by lamp.

    measure_skin(skin, output, GoniometerSetup()) -> samples.usda

The sample lies flat, the camera looks at it from one side, and one lamp of parallel light goes
from the normal to beyond the shadow line. Equation (1) for one lamp is evaluated in float64, per
wavelength, and the instrument's noise is added. Where light passes the skin, some readings are
taken with a sheet of it, of known thickness, between lamp and sample, which is what tells delta.

Reads:  a stage with a Material that has ``SkinMaterialAPI``.
Writes: ``samples.usda`` (``SkinSampleAPI``) for `usdskin estimate skin`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError, UsageError
from usdskin.estimate.skin.lobe import Lobe, LobeGeometry
from usdskin.estimate.skin.readings import Readings
from usdskin.layers import SettingValue, check_output, open_stage, record_provenance, write_layer
from usdskin.prims.samples import SkinSamples, write_skin_samples
from usdskin.prims.skin import SkinParameters, read_skin
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom

FloatArray = NDArray[np.float64]

LEAST_REACH_DEG = 105.0
"""Angle of the last reading at least [deg]."""

PAST_DARK_DEG = 10.0
"""How far readings go on past acos(-l), where the sample has gone dark [deg]."""

VIEW_DEG = 30.0
"""Angle between the normal and the camera, which stands across from the lamp [deg]."""

SHEET_ANGLES_DEG = (0.0, 20.0, 40.0)
"""Where the lamp stands when it shines through a sheet [deg]: high, where most comes back."""

SHEETS_M = (0.0001, 0.0002, 0.0004, 0.0008, 0.0016)
"""Thicknesses of the sheets [m]."""

_LEAST_READINGS = 6


@dataclass(frozen=True, slots=True)
class GoniometerSetup:
    """How a sample is measured; the defaults are those of DESIGN's bound on the fit."""

    readings: int = 24
    """Places of the lamp, evenly from the normal to past the last light."""

    noise: float = 0.01
    """Standard deviation of a reading, relative to it [1]."""

    floor: float = 0.002
    """Standard deviation that all readings of a band share, relative to the band's peak [1]."""

    polarisers: Literal["crossed", "none"] = "crossed"
    """Crossed polarisers take the lustre away; without, readings hold it."""

    sheets_m: tuple[float, ...] = SHEETS_M
    """Thicknesses of the sheets [m], where light passes the skin; empty: none are used."""

    seed: int = 0
    """Of the noise."""

    def check(self) -> None:
        """Refuse what cannot be measured.

        Raises:
            UsageError: A value is out of range; the message names it.
        """
        if self.readings < _LEAST_READINGS:
            raise UsageError(f"{self.readings} readings; give {_LEAST_READINGS} at least")
        for name, value in (("noise", self.noise), ("floor", self.floor)):
            if not 0.0 <= value <= 1.0:
                raise UsageError(f"the readings' {name} is {value:g}; give 0 to 1")
        if not all(0.0 < sheet < 1.0 for sheet in self.sheets_m):
            raise UsageError(f"sheets of {self.sheets_m} m; give thicknesses of 0 to 1 m")


def find_skin(stage: Usd.Stage, material: str | None = None) -> Usd.Prim:
    """Return the Material of a stage's skin.

    Args:
        stage: The stage.
        material: Path of the Material; None: the default prim, or the stage's only one.

    Raises:
        LayerError: There is no such Material, or several.
    """
    name = stage.GetRootLayer().GetDisplayName()
    if material is not None:
        prim = stage.GetPrimAtPath(material)
        if not prim or not prim.HasAPI("SkinMaterialAPI"):
            raise LayerError(f"{name}: <{material}> is no Material with SkinMaterialAPI; name one")
        return prim
    default = stage.GetDefaultPrim()
    if default and default.HasAPI("SkinMaterialAPI"):
        return default
    skins = [prim for prim in stage.Traverse() if prim.HasAPI("SkinMaterialAPI")]
    if not skins:
        raise LayerError(f"{name}: has no Material with SkinMaterialAPI; give a layer with a skin")
    if len(skins) > 1:
        raise LayerError(
            f"{name}: has {len(skins)} Materials with SkinMaterialAPI; name one by --material"
        )
    return skins[0]


def read_goniometer(
    source: str | Path,
    output: str | Path,
    setup: GoniometerSetup | None = None,
    *,
    material: str | None = None,
) -> Path:
    """Measure a flat sample of a stage's skin.

    Args:
        source: Stage with a Material that has ``SkinMaterialAPI``.
        output: Layer to write.
        setup: How it is measured.
        material: Path of the Material; None: the stage's only one.

    Returns:
        ``output``, once it is complete on disk.

    Raises:
        LayerError: The stage or its skin cannot be read, or the output cannot be written.
        UsageError: The set-up makes no sense.
    """
    setup = setup or GoniometerSetup()
    setup.check()
    source, output = Path(source), Path(output)
    stage = open_stage(source)
    check_output(output, [source], step="goniometer")
    skin = read_skin(find_skin(stage, material))
    samples = measure(skin, setup)
    written = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(written, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(written, 1.0)
    prim = UsdGeom.Scope.Define(written, "/Samples").GetPrim()
    written.SetDefaultPrim(prim)
    write_skin_samples(prim, samples, output.parent)
    settings: dict[str, SettingValue] = {
        "readings": setup.readings,
        "noise": setup.noise,
        "floor": setup.floor,
        "polarisers": setup.polarisers,
        "sheets": list(setup.sheets_m),
        "seed": setup.seed,
    }
    record_provenance(written, "goniometer", [source], settings, output.parent)
    return write_layer(written, output)


def measure(skin: SkinParameters, setup: GoniometerSetup) -> SkinSamples:
    """Return the readings of a skin.

    Args:
        skin: The skin as it is; its textures are not looked at, its ``reflectance`` is.
        setup: How it is measured.
    """
    nm = DEFAULT_WAVELENGTHS_NM
    angles, thickness = _places(skin, setup)
    true = reflected(skin, angles, thickness, nm, setup.polarisers == "none")
    random = np.random.default_rng([setup.seed, 0x60])
    noisy = true * (1.0 + setup.noise * random.normal(size=true.shape))
    noisy += setup.floor * true.max(axis=0) * random.normal(size=true.shape)
    through_sheets = bool(thickness.any())
    return SkinSamples(
        theta_i=angles,
        theta_r=np.full(angles.size, VIEW_DEG),
        azimuth=np.full(angles.size, 180.0),
        values=noisy,
        wavelength_nm=nm,
        thickness=thickness if through_sheets else None,
    )


def _places(skin: SkinParameters, setup: GoniometerSetup) -> tuple[FloatArray, FloatArray]:
    """Return where the lamp stands [deg] and what it shines through [m], shapes [q]."""
    dark = float(np.degrees(np.arccos(-min(max(skin.wrap, 0.0), 1.0))))
    reach = min(max(LEAST_REACH_DEG, dark + PAST_DARK_DEG), 180.0)
    angles = np.linspace(0.0, reach, setup.readings)
    thickness = np.zeros(angles.size)
    if not has_opacity(skin) or not setup.sheets_m:
        return angles, thickness
    through, sheets = np.meshgrid(SHEET_ANGLES_DEG, setup.sheets_m)
    return np.append(angles, through.ravel()), np.append(thickness, sheets.ravel())


def has_opacity(skin: SkinParameters) -> bool:
    """Return whether a skin has a delta that sheets could tell."""
    if isinstance(skin.opacity, Spectrum):
        return bool(np.any(skin.opacity.value))
    return skin.opacity != 0.0


def reflected(
    skin: SkinParameters,
    theta_deg: FloatArray,
    thickness_m: FloatArray,
    wavelength_nm: FloatArray,
    with_lustre: bool = False,
) -> FloatArray:
    """Return equation (1) for one lamp, over a perfect diffuser that faces it, shape [q, n].

    ``exp(-s delta) alpha S [max(cos, 0) + Ss max((cos + l)/(1 + l), 0)]``, and the lobes of the
    surface where they are asked for.

    Args:
        skin: The skin.
        theta_deg: Angles between normal and lamp [deg], shape [q].
        thickness_m: Way of the light through the sample [m], shape [q].
        wavelength_nm: Band centres [nm], shape [n].
        with_lustre: Whether the lobes count.
    """
    nm = np.asarray(wavelength_nm, dtype=np.float64)
    reflectance, scattering, opacity = spectra_of(skin, nm)
    cosine = np.cos(np.radians(np.asarray(theta_deg, dtype=np.float64)))
    wrapped = np.maximum((cosine + skin.wrap) / (1.0 + skin.wrap), 0.0)
    if skin.wrap_normalization == "energy":
        wrapped = wrapped / (1.0 + skin.wrap)
    light = np.maximum(cosine, 0.0)[:, None] + wrapped[:, None] * scattering
    through = np.exp(-np.asarray(thickness_m)[:, None] * opacity)
    diffuse = skin.alpha * reflectance * light * through
    if not with_lustre or skin.specular_weight == 0.0:
        return np.asarray(diffuse)
    lobe = Lobe(skin.specular_weight, skin.roughness1, skin.roughness2, skin.mix, skin.f0)
    geometry = LobeGeometry(_readings(theta_deg))
    passed, shine = geometry.passed(lobe), geometry.reflected(lobe)
    return np.asarray(diffuse * passed[:, None] + shine[:, None])


def spectra_of(skin: SkinParameters, nm: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return S [1], Ss [1] and delta [m^-1] of a skin, shape [n] each."""
    ones = np.ones(nm.size)
    reflectance = ones if skin.reflectance is None else skin.reflectance.resample(nm)
    scattering = 0.0 * ones if skin.scattering is None else skin.scattering.resample(nm)
    if isinstance(skin.opacity, Spectrum):
        return reflectance, scattering, skin.opacity.resample(nm)
    return reflectance, scattering, ones * skin.opacity


def _readings(theta_deg: FloatArray) -> Readings:
    """Return the geometry of readings: lamp on one side of the normal, camera on the other."""
    lamp, camera = np.radians(theta_deg), np.radians(VIEW_DEG)
    zero = np.zeros(lamp.size)
    return Readings(
        light=np.column_stack([np.sin(lamp), zero, np.cos(lamp)]),
        normal=np.array([0.0, 0.0, 1.0]),
        values=zero[:, None],
        view=np.array([-np.sin(camera), 0.0, np.cos(camera)]),
    )
