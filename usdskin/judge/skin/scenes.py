"""A subject between lamp and camera: the stage that is rendered, and its pictures as spectra."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_to_rgb, xyz_weights
from usdskin.errors import LayerError
from usdskin.images import read_spectral
from usdskin.judge.shoot.viewpoints import Orientation
from usdskin.layers import describe, open_stage
from usdskin.prims import SpectralLight, write_spectral_light
from usdskin.prims.skin import SkinParameters, read_skin
from usdskin.progress import Progress
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

FloatArray = NDArray[np.float64]

_ROOT = "/SkinShoot"
_DISTANCE = 6.0  # of the camera, in radii of the subject
_FILLED = 0.92  # of the picture's width, by the subject


@dataclass(frozen=True, slots=True, eq=False)
class Subject:
    """What is photographed."""

    stage: Path
    """The stage it is from."""

    center: FloatArray
    """Middle of its bounds, in the stage's units, shape [3]."""

    radius: float
    """Half the longest edge of its bounds, in the stage's units."""

    up_axis: str
    """``Y`` or ``Z``."""

    skin: SkinParameters
    """Its material: the truth."""

    lights: tuple[str, ...]
    """Paths of the stage's own lights, which are off during the shoot."""

    prim_path: str | None
    """Prim that holds it, without which nothing is rendered; None: all."""


def read_subject(path: Path, prim_path: str | None = None, material: str | None = None) -> Subject:
    """Return what a stage has to be photographed.

    Args:
        path: The stage.
        prim_path: Prim that holds the subject; None: all that can be seen.
        material: Path of its skin; None: the stage's only one.

    Raises:
        LayerError: The stage cannot be read, has no such prim or no shapes, or not one skin.
    """
    stage = open_stage(path)
    root = stage.GetPrimAtPath(prim_path) if prim_path else stage.GetPseudoRoot()
    if not root:
        raise LayerError(f"{path}: has no prim <{prim_path}>; name the one that has the shapes")
    cache = UsdGeom.BBoxCache(Usd.TimeCode.Default(), ["default", "render"])
    bounds = Gf.Range3d()
    for prim in Usd.PrimRange(root):
        if prim.IsA(UsdGeom.Gprim):
            bounds.UnionWith(cache.ComputeWorldBound(prim).ComputeAlignedRange())
    if bounds.IsEmpty():
        raise LayerError(f"{path}: nothing below {root.GetPath()} has a shape; name another prim")
    skins = [prim for prim in stage.Traverse() if prim.HasAPI("SkinMaterialAPI")]
    if material is not None:
        skins = [prim for prim in skins if str(prim.GetPath()) == material]
    if len(skins) != 1:
        raise LayerError(
            f"{path}: has {len(skins)} such materials with SkinMaterialAPI; name the one that is "
            "photographed"
        )
    return Subject(
        stage=path,
        center=np.array(bounds.GetMidpoint()),
        radius=0.5 * max(bounds.GetSize()),
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        skin=read_skin(skins[0]),
        lights=tuple(
            str(prim.GetPath()) for prim in stage.Traverse() if prim.HasAPI(UsdLux.LightAPI)
        ),
        prim_path=prim_path,
    )


def direction_of(orientation: Orientation, up_axis: str) -> FloatArray:
    """Return the unit vector from a subject to what stands around it, shape [3].

    Args:
        orientation: Azimuth from the subject's front (+Z, or -Y where Z is up) counted to its
            left (+X), and elevation [deg].
        up_axis: ``Y`` or ``Z``.
    """
    azimuth, elevation = np.radians(orientation)
    right, front = np.sin(azimuth) * np.cos(elevation), np.cos(azimuth) * np.cos(elevation)
    up = np.sin(elevation)
    return np.array([right, -front, up] if up_axis == "Z" else [right, up, front])


def facing(direction: FloatArray, up_axis: str) -> FloatArray:
    """Return the rotation of what looks along its -Z from a direction at the subject.

    Args:
        direction: Unit vector from the subject, shape [3].
        up_axis: ``Y`` or ``Z``.

    Returns:
        Columns are its own axes in the world, shape [3, 3].
    """
    up = np.array([0.0, 0.0, 1.0] if up_axis == "Z" else [0.0, 1.0, 0.0])
    if abs(direction @ up) > 0.999:
        up = np.array([1.0, 0.0, 0.0])
    right = np.cross(up, direction)
    right /= np.linalg.norm(right)
    return np.stack([right, np.cross(direction, right), direction], axis=-1)


def define_lamp(
    stage: Usd.Stage,
    path: str,
    irradiance: Spectrum,
    rotations: Sequence[FloatArray],
    angle_deg: float = 0.0,
) -> UsdLux.DistantLight:
    """Define a distant light of a known irradiance spectrum.

    Args:
        stage: Stage to write to.
        path: Of the light.
        irradiance: Of a surface that faces it [W m^-2 nm^-1].
        rotations: From the light to the world, one, or one for each frame from 1.
        angle_deg: Angular diameter [deg]; 0: parallel light.
    """
    lamp = UsdLux.DistantLight.Define(stage, path)
    lamp.CreateAngleAttr(angle_deg)
    lamp.CreateIntensityAttr(1.0)
    nm = irradiance.wavelength_nm
    xyz = irradiance.resample(nm) @ xyz_weights(nm)
    color = np.maximum(xyz_to_rgb("lin_rec709_scene") @ xyz, 0.0)
    lamp.CreateColorAttr(Gf.Vec3f(*(color / color.max()).tolist()))
    write_spectral_light(
        lamp.GetPrim(), SpectralLight(source="tabulated", emission=irradiance, units="absolute")
    )
    turn = UsdGeom.Xformable(lamp).AddTransformOp(UsdGeom.XformOp.PrecisionDouble)
    for frame, rotation in enumerate(rotations, start=1):
        time = Usd.TimeCode(frame) if len(rotations) > 1 else Usd.TimeCode.Default()
        turn.Set(_matrix(rotation), time)
    return lamp


def _matrix(rotation: FloatArray, translation: FloatArray | None = None) -> Gf.Matrix4d:
    matrix = np.eye(4)
    matrix[:3, :3] = rotation.T  # of row vectors
    if translation is not None:
        matrix[3, :3] = translation
    return Gf.Matrix4d(matrix.tolist())


def write_set(
    path: Path,
    subject: Subject,
    irradiance: Spectrum,
    lights: Sequence[Orientation],
    views: Sequence[Orientation],
) -> None:
    """Write the stage that is rendered: the subject, a lamp that moves by frames, the cameras.

    Args:
        path: Layer to write.
        subject: What is photographed.
        irradiance: Of a surface that faces the lamp [W m^-2 nm^-1].
        lights: Where the lamp stands, in frame 1, 2, ...
        views: Where the cameras stand.

    Raises:
        LayerError: A light of the subject's stage cannot be turned off.
    """
    layer = Sdf.Layer.CreateNew(str(path))
    layer.subLayerPaths.append(str(subject.stage.resolve()))
    stage = Usd.Stage.Open(layer)
    source = open_stage(subject.stage)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.GetStageUpAxis(source))
    UsdGeom.SetStageMetersPerUnit(stage, UsdGeom.GetStageMetersPerUnit(source))
    stage.SetStartTimeCode(1)
    stage.SetEndTimeCode(len(lights))
    for light in subject.lights:
        prim = stage.GetPrimAtPath(light)
        if prim and not prim.SetActive(False):
            raise LayerError(f"{describe(prim)}: cannot be turned off; take it out of the stage")
    UsdGeom.Xform.Define(stage, _ROOT)
    rotations = [facing(direction_of(light, subject.up_axis), subject.up_axis) for light in lights]
    define_lamp(stage, f"{_ROOT}/lamp", irradiance, rotations)
    for index, view in enumerate(views):
        _define_camera(stage, index, subject, view)
    layer.Save()


def _define_camera(stage: Usd.Stage, index: int, subject: Subject, view: Orientation) -> None:
    toward = direction_of(view, subject.up_axis)
    camera = UsdGeom.Camera.Define(stage, f"{_ROOT}/view{index}")
    distance = _DISTANCE * subject.radius
    half = np.tan(np.arcsin(1.0 / _DISTANCE)) / _FILLED
    camera.CreateFocalLengthAttr(50.0)
    camera.CreateHorizontalApertureAttr(float(100.0 * half))
    camera.CreateVerticalApertureAttr(float(100.0 * half))
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1 * distance, 10.0 * distance))
    place = UsdGeom.Xformable(camera).AddTransformOp(UsdGeom.XformOp.PrecisionDouble)
    rotation = facing(toward, subject.up_axis)
    place.Set(_matrix(rotation, subject.center + distance * toward))


@dataclass(frozen=True, slots=True)
class Rendering:
    """How the pictures are rendered."""

    size: int
    """Width and height [px]."""

    samples_per_pixel: int
    """Samples per pixel."""

    threads: int
    """CPU threads."""

    wavelength_nm: FloatArray
    """Bands that are rendered [nm], shape [band_count]."""

    mask: tuple[str, ...] | None = None
    """Paths of what is rendered; None: everything."""


def render_views(
    stage: Path,
    view: int,
    count: int,
    how: Rendering,
    geometry: Path,
    scratch: Path,
    progress: Progress,
) -> Iterator[NDArray[np.float32]]:
    """Render a view in every light, each band by itself, and keep its geometry.

    Args:
        stage: What ``write_set`` wrote.
        view: Index of the camera.
        count: How many lights there are.
        how: Size and quality.
        geometry: File to write with the parts N and P.
        scratch: Folder for files in between.
        progress: Told how far the work is.

    Yields:
        Spectral radiance [W m^-2 sr^-1 nm^-1], shape [size, size, band_count].
    """
    overrides = RenderOverrides(
        frames=tuple(range(1, count + 1)),
        camera=f"{_ROOT}/view{view}",
        resolution=(how.size, how.size),
        spectral_output=True,
        spectral_method="brute",
        integrator="map",
        samples=how.samples_per_pixel,
        mask=how.mask,
        png=False,
        aovs=("N", "P"),
        wavelength_nm=how.wavelength_nm,
        threads=how.threads,
        device="cpu",
        compression="none",
        allow_outside=True,
    )
    render_stage(stage, scratch / f"view{view}.####.exr", overrides, progress)
    shutil.copyfile(scratch / f"view{view}.0001.exr", geometry)
    for frame in range(1, count + 1):
        _, pixels = read_spectral(scratch / f"view{view}.{frame:04d}.spectral.exr")
        yield pixels


def lamp_irradiance(
    wavelength_nm: FloatArray, power: FloatArray, photometric: FloatArray, illuminance_lx: float
) -> Spectrum:
    """Return the irradiance of a lamp that gives an illuminance.

    Args:
        wavelength_nm: Band centres [nm], shape [n].
        power: Its relative spectral power, shape [n].
        photometric: Weights that make an illuminance of irradiance [lm W^-1 nm], shape [n].
        illuminance_lx: On a surface that faces it [lx].
    """
    scale = illuminance_lx / float(photometric @ power)
    return Spectrum(SpectralQuantity.IRRADIANCE, wavelength_nm, scale * power)
