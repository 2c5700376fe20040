"""``SkinSampleAPI`` <-> ``SkinSamples``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, Vt

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.cameras import SpectralCamera, spectral_camera
from usdskin.prims.lights import SpectralLight, read_spectral_light
from usdskin.prims.spectra import read_spectrum, write_spectrum
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.views import Shot, read_shot
from usdskin.prims.writing import write_schema
from usdskin.spectrum import SpectralQuantity, Spectrum

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class SampleLight:
    """A distant light that skin was photographed in."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    direction: FloatArray
    """Unit vector towards it, in the world, shape [3]."""

    irradiance: float
    """Irradiance of a surface that faces it, or of its spectrum's unit: intensity 2^exposure."""

    spectral: SpectralLight | None
    """What it says about its spectrum."""

    prim: Usd.Prim | None = None
    """The prim, for readers of lights."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinSamples:
    """Readings or photographs of skin; None where the layer says nothing."""

    where: str = ""
    """``layer.usda </Prim/path>``, for errors."""

    light: FloatArray | None = None
    """Unit vectors towards the light, shape [q, 3]."""

    view: FloatArray | None = None
    """Unit vectors towards the camera, shape [q, 3]."""

    normal: FloatArray | None = None
    """Unit normals, shape [q, 3] or [1, 3]."""

    theta_i: FloatArray | None = None
    """Angles between normal and light [deg], shape [q]."""

    theta_r: FloatArray | None = None
    """Angles between normal and camera [deg], shape [q]."""

    azimuth: FloatArray | None = None
    """Angles between the planes of light and camera [deg], shape [q]."""

    values: FloatArray | None = None
    """Readings, shape [q, c]."""

    values_file: Path | None = None
    """Text file of angles and readings."""

    quantity: str = "reflectanceFactor"
    """``reflectanceFactor``, ``radiance`` or ``cameraValues``."""

    white: FloatArray | None = None
    """Reading of a perfect diffuser that faces the light, shape [c]."""

    wavelength_nm: FloatArray | None = None
    """Wavelengths of the columns [nm], shape [c]."""

    camera: SpectralCamera | None = None
    """The calibrated camera."""

    light_class: str = ""
    """Class of the light; empty: the camera's only one."""

    mask: NDArray[np.bool_] | None = None
    """Which readings to use, shape [q]."""

    thickness: FloatArray | None = None
    """Way of light from behind through the sample [m], shape [q] or [1]."""

    saturation: float = 0.0
    """Value from which a reading is saturated; 0: none is."""

    images: tuple[Path, ...] = ()
    """Photographs in camera values."""

    views: tuple[Shot, ...] = ()
    """Photographs as the camera wrote them, instead of images."""

    geometry_files: tuple[Path, ...] = ()
    """AOVs of each photograph."""

    mask_files: tuple[Path, ...] = ()
    """Where each photograph may be used; none: everywhere."""

    lights: tuple[SampleLight, ...] = ()
    """The light of each photograph, or one for all."""

    reflectance: Spectrum | None = None
    """S from a spectrophotometer [1]."""

    reflectance_file: Path | None = None
    """An instrument's file of it."""

    reflectance_geometry: str = "di8"
    """``di8`` or ``45to0``: how the instrument lights and looks."""

    specular_included: bool = False
    """Whether the instrument counted what the surface mirrors."""


_FIELDS = {
    "theta_i": "samples:thetaI",
    "theta_r": "samples:thetaR",
    "azimuth": "samples:azimuth",
    "values_file": "samples:values:file",
    "quantity": "samples:quantity",
    "white": "samples:white",
    "wavelength_nm": "samples:wavelengths",
    "light_class": "samples:lightClass",
    "thickness": "samples:thickness",
    "saturation": "samples:saturation",
    "reflectance_file": "samples:reflectance:file",
    "reflectance_geometry": "samples:reflectance:geometry",
    "specular_included": "samples:reflectance:specularIncluded",
}
_VECTORS = {"light": "samples:light", "view": "samples:view", "normal": "samples:normal"}
_FILES = {
    "images": "samples:images",
    "geometry_files": "samples:geometry:files",
    "mask_files": "samples:mask:files",
}


def read_skin_samples(stage: Usd.Stage) -> SkinSamples:
    """Return the samples of a stage.

    Args:
        stage: Stage with one prim that has ``SkinSampleAPI``: the default prim, or the only one.

    Raises:
        LayerError: There is no such prim or several, or an opinion cannot be used.
    """
    prim = _samples_prim(stage)
    check_applied_schemas(prim)
    values = read_schema(prim, "SkinSampleAPI", DEFAULT_TIME)
    fields: dict[str, Any] = {field: values[name] for field, name in _FIELDS.items()}
    for field in ("theta_i", "theta_r", "azimuth", "white", "wavelength_nm", "thickness"):
        if fields[field] is not None and not len(fields[field]):
            fields[field] = None
    for field, name in _VECTORS.items():
        fields[field] = _unit(values[name])
    readings = values["samples:values"]
    if readings is not None and len(readings):
        fields["values"] = readings.reshape(_reading_count(prim, fields, len(readings)), -1)
    mask = values["samples:mask"]
    fields["mask"] = None if mask is None or not len(mask) else mask
    for field, name in _FILES.items():
        fields[field] = tuple(_files(prim, name, values[name]))
    return SkinSamples(
        where=describe(prim),
        camera=_camera(prim),
        views=tuple(read_shot(camera) for camera in _targets(prim, "samples:views")),
        lights=tuple(_sample_light(light) for light in _targets(prim, "samples:lights")),
        reflectance=read_spectrum(
            prim, "reflectance", DEFAULT_TIME, (SpectralQuantity.REFLECTANCE,)
        ),
        **fields,
    )


def _samples_prim(stage: Usd.Stage) -> Usd.Prim:
    default = stage.GetDefaultPrim()
    if default and default.HasAPI("SkinSampleAPI"):
        return default
    found = [prim for prim in stage.Traverse() if prim.HasAPI("SkinSampleAPI")]
    name = stage.GetRootLayer().GetDisplayName()
    if not found:
        raise LayerError(
            f"{name}: no prim has SkinSampleAPI; author a Scope with it, as docs/skin.md says"
        )
    if len(found) > 1:
        listed = ", ".join(f"<{prim.GetPath()}>" for prim in found)
        raise LayerError(f"{name}: several prims have SkinSampleAPI ({listed}); set defaultPrim")
    return found[0]


def _unit(vectors: FloatArray | None) -> FloatArray | None:
    if vectors is None or not len(vectors):
        return None
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))


def _reading_count(prim: Usd.Prim, fields: dict[str, Any], total: int) -> int:
    """Return how many readings the values are, of the angles or vectors they go with."""
    beside = next(
        (len(fields[name]) for name in ("theta_i", "light") if fields[name] is not None), None
    )
    if beside is None:
        text = "has readings but no directions; set samples:thetaI or samples:light"
        raise PrimError(prim, Problem("missing-value", "samples:values", text))
    if total % beside:
        text = f"has {total} numbers, which are no whole rows for {beside} directions; give every "
        text += "reading one value per column"
        raise PrimError(prim, Problem("unequal-lengths", "samples:values", text))
    columns = total // beside
    for field, name in (("wavelength_nm", "samples:wavelengths"), ("white", "samples:white")):
        given = fields[field]
        if given is not None and len(given) != columns:
            text = f"has {len(given)} values but each reading has {columns}; give one per column"
            raise PrimError(prim, Problem("unequal-lengths", name, text))
    return beside


def _files(prim: Usd.Prim, name: str, files: list[Path | None] | None) -> list[Path]:
    found: list[Path] = []
    for index, file in enumerate(files or []):
        if file is None:
            text = f"names no file at index {index}; name one"
            raise PrimError(prim, Problem("missing-value", name, text))
        found.append(file)
    return found


def _targets(prim: Usd.Prim, name: str) -> list[Usd.Prim]:
    found = []
    for path in prim.GetRelationship(name).GetTargets():
        target = prim.GetStage().GetPrimAtPath(path)
        if not target:
            raise LayerError(f"{describe(prim)}: {name} names <{path}>, which is not there")
        found.append(target)
    return found


def _camera(prim: Usd.Prim) -> SpectralCamera | None:
    targets = _targets(prim, "samples:camera")
    if not targets:
        return None
    if len(targets) > 1 or not targets[0].HasAPI("SpectralCameraAPI"):
        raise LayerError(
            f"{describe(prim)}: samples:camera names <{targets[0].GetPath()}>; name one Camera "
            "with SpectralCameraAPI, as `usdskin calibrate camera` writes it"
        )
    return spectral_camera(targets[0])


def _sample_light(prim: Usd.Prim) -> SampleLight:
    if not prim.IsA(UsdLux.DistantLight):
        raise LayerError(
            f"{describe(prim)}: is a {prim.GetTypeName()}; skin is fitted in the light of "
            "DistantLights, so stand the lamp far away and describe it as one"
        )
    matrix = UsdGeom.XformCache(DEFAULT_TIME).GetLocalToWorldTransform(prim)
    toward = np.array(matrix.TransformDir(Gf.Vec3d(0.0, 0.0, 1.0)), dtype=np.float64)
    light = UsdLux.LightAPI(prim)
    intensity = float(light.GetIntensityAttr().Get()) * 2.0 ** float(light.GetExposureAttr().Get())
    return SampleLight(
        where=describe(prim),
        direction=toward / np.linalg.norm(toward),
        irradiance=intensity,
        spectral=read_spectral_light(prim),
        prim=prim,
    )


def write_skin_samples(
    prim: Usd.Prim,
    samples: SkinSamples,
    folder: str | Path | None = None,
    *,
    camera: Sdf.Path | None = None,
    lights: tuple[Sdf.Path, ...] = (),
    views: tuple[Sdf.Path, ...] = (),
) -> None:
    """Apply ``SkinSampleAPI`` to a Scope and author samples.

    Args:
        prim: Scope, written at the stage's edit target.
        samples: What to write; its camera, lights and views are written by the caller.
        folder: Folder the layer is going to be written to; see ``write_schema``.
        camera: Path of the calibrated camera.
        lights: Paths of the lights, in the order of the photographs.
        views: Paths of the cameras, instead of images.

    Raises:
        LayerError: The prim is no Scope, or a file cannot be named from the layer.
    """
    values: dict[str, Any] = {name: getattr(samples, field) for field, name in _FIELDS.items()}
    values["samples:values"] = samples.values
    for field, name in _VECTORS.items():
        vectors = getattr(samples, field)
        if vectors is not None:
            values[name] = Vt.Vec3fArray([Gf.Vec3f(*map(float, row)) for row in vectors])
    for field, name in _FILES.items():
        values[name] = list(getattr(samples, field)) or None
    if samples.mask is not None:
        values["samples:mask"] = Vt.BoolArray([bool(kept) for kept in samples.mask])
    write_schema(prim, "SkinSampleAPI", values, folder)
    for name, targets in (
        ("samples:camera", () if camera is None else (camera,)),
        ("samples:lights", lights),
        ("samples:views", views),
    ):
        if targets:
            prim.GetRelationship(name).SetTargets(list(targets))
    if samples.reflectance is not None:
        write_spectrum(prim, "reflectance", samples.reflectance)
