"""A virtual set as arrays: planar surfaces with measured reflectances, lamps, the capture point.

Reads: ``set.usda``: ``/Set/Surfaces`` (UsdGeomMesh of parallelograms, Lambertian), materials with
``SpectralDistributionAPI:reflectance``, ``/Set/Lights/<class>/<name>`` (UsdLux with
``SpectralLightAPI``) and ``/Set/CapturePoint``. See docs/sets.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.layers import describe, open_stage
from usdskin.notes import Note
from usdskin.prims import read_spectral_light, read_spectrum
from usdskin.render.lights import DistantLight, DomeLight, LocalLight, read_lights
from usdskin.spectrum import SpectralQuantity

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdLux, UsdShade

FloatArray = NDArray[np.float64]

CAPTURE_POINT = "/Set/CapturePoint"
_SURFACES = "/Set/Surfaces"
_LIGHTS = "/Set/Lights"
_FLAT = 1e-5
"""Largest distance from a parallelogram, over its size."""

_KINDS = ("rect", "disk", "sphere", "cylinder")


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """Parallelograms that reflect on their front side and stop light on both."""

    corner: FloatArray
    """First corner in the world [m], shape [count, 3]."""

    along: FloatArray
    """Edge to the second corner [m], shape [count, 3]."""

    across: FloatArray
    """Edge to the last corner [m], shape [count, 3]; ``along x across`` points to the front."""

    reflectance: FloatArray
    """Diffuse reflectance [1], shape [count, band_count]."""

    names: tuple[str, ...]
    """Prim paths, shape [count]."""

    @property
    def normal(self) -> FloatArray:
        """Unit normals, shape [count, 3]."""
        cross = np.cross(self.along, self.across)
        return np.asarray(cross / np.linalg.norm(cross, axis=1, keepdims=True))


@dataclass(frozen=True, slots=True, eq=False)
class SetScene:
    """All that the light of a set depends on."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [band_count]."""

    surfaces: Surfaces
    """What reflects."""

    lamps: tuple[LocalLight, ...]
    """Lamps that have a place."""

    suns: tuple[DistantLight, ...]
    """Lamps that are far away."""

    skies: tuple[DomeLight, ...]
    """Light from everywhere else."""

    class_of: dict[str, str]
    """Class of every light, by prim path."""

    capture_point: FloatArray
    """Where the camera stands, in the world [m], shape [3]."""

    up_axis: str
    """``Y`` or ``Z``."""

    name: str
    """Of the layer, for messages."""

    @property
    def classes(self) -> tuple[str, ...]:
        """Names of the light classes, in the order of the stage."""
        return tuple(dict.fromkeys(self.class_of.values()))


def read_set(path: str | Path, wavelength_nm: FloatArray, notes: list[Note]) -> SetScene:
    """Return a set as arrays.

    Args:
        path: The set's layer.
        wavelength_nm: Band centres [nm], shape [band_count].
        notes: Takes what could not be honoured.

    Raises:
        LayerError: The layer is no set, or something in it cannot be used; the message names it.
        ImageError: The map of a dome cannot be read.
    """
    stage = open_stage(path, notes)
    name = stage.GetRootLayer().GetDisplayName()
    for part in (_SURFACES, _LIGHTS, CAPTURE_POINT):
        if not stage.GetPrimAtPath(part):
            raise LayerError(f"{name} <{part}>: is missing; a set has it (docs/sets.md)")
    surfaces = _read_surfaces(stage, wavelength_nm)
    class_of = _read_classes(stage)
    lights = read_lights(stage, Usd.TimeCode.Default(), wavelength_nm, notes=notes, places=True)
    if not lights.all:
        raise LayerError(f"{name} <{_LIGHTS}>: no light shines; add one")
    if not lights.absolute:
        first = lights.paths[0]
        raise LayerError(
            f"{name} <{first}>: inputs:spectral:units is relative; a set has absolute radiances"
        )
    for lamp in lights.locals:
        _check_lamp(name, lamp)
    return SetScene(
        wavelength_nm=np.asarray(wavelength_nm, np.float64),
        surfaces=surfaces,
        lamps=lights.locals,
        suns=lights.distants,
        skies=lights.domes,
        class_of={path: class_of[path] for path in lights.paths},
        capture_point=_capture_point(stage),
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        name=name,
    )


def _capture_point(stage: Usd.Stage) -> FloatArray:
    prim = stage.GetPrimAtPath(CAPTURE_POINT)
    world = UsdGeom.XformCache().GetLocalToWorldTransform(prim).ExtractTranslation()
    point = np.array(world, np.float64) * UsdGeom.GetStageMetersPerUnit(stage)
    if not np.isfinite(point).all():
        raise LayerError(f"{describe(prim)}: its place is not finite; mend its xformOps")
    return np.asarray(point)


# --- Lights ------------------------------------------------------------------------------------


def _read_classes(stage: Usd.Stage) -> dict[str, str]:
    """Return the class of every light, by path; refuse lights that no spectrum was given."""
    classes = {}
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if not prim.HasAPI(UsdLux.LightAPI):
            continue
        path = prim.GetPath()
        scope = path.GetParentPath()
        if str(scope.GetParentPath()) != _LIGHTS:
            raise LayerError(
                f"{describe(prim)}: lights of a set are called {_LIGHTS}/<class>/<name>; move it"
            )
        if UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible:
            continue
        spectral = read_spectral_light(prim)
        if spectral is None or spectral.source == "rgb":
            raise LayerError(
                f"{describe(prim)}: has no spectrum (inputs:spectral:source is rgb); apply "
                "SpectralLightAPI with tabulated, blackbody, illuminantD, basis or bands"
            )
        classes[str(path)] = scope.name
    return classes


def _check_lamp(name: str, lamp: LocalLight) -> None:
    if lamp.kind not in _KINDS:
        raise LayerError(f"{name} <{lamp.path}>: is a {lamp.kind} without a size; give it a radius")
    shaping = lamp.shaping
    is_shaped = shaping.cone_angle is not None or shaping.focus > 0.0 or shaping.profile is not None
    if len(lamp.radiance) != 1 or lamp.texture is not None or is_shaped:
        raise LayerError(
            f"{name} <{lamp.path}>: emits unevenly (ShapingAPI or a picture); lamps of a set are "
            "Lambertian"
        )


# --- Surfaces ----------------------------------------------------------------------------------


def _read_surfaces(stage: Usd.Stage, wavelength_nm: FloatArray) -> Surfaces:
    cache = UsdGeom.XformCache()
    meters = UsdGeom.GetStageMetersPerUnit(stage)
    quads: list[FloatArray] = []
    reflectances: list[FloatArray] = []
    names: list[str] = []
    for prim in Usd.PrimRange(stage.GetPrimAtPath(_SURFACES), Usd.TraverseInstanceProxies()):
        if not prim.IsA(UsdGeom.Gprim):
            continue
        if UsdGeom.Imageable(prim).ComputeVisibility() == UsdGeom.Tokens.invisible:
            continue
        if not prim.IsA(UsdGeom.Mesh):
            raise LayerError(
                f"{describe(prim)}: is a {prim.GetTypeName()}; surfaces of a set are meshes of "
                "planar quads"
            )
        to_world = np.array(cache.GetLocalToWorldTransform(prim))
        sides = _quads_of(prim, to_world, meters)
        reflectance = _reflectance(prim, wavelength_nm)
        quads += sides
        reflectances += [reflectance] * len(sides)
        names += [str(prim.GetPath())] * len(sides)
    if not quads:
        raise LayerError(
            f"{stage.GetRootLayer().GetDisplayName()} <{_SURFACES}>: holds no mesh; add the walls"
        )
    corners = np.array(quads)
    return Surfaces(
        corner=corners[:, 0],
        along=corners[:, 1] - corners[:, 0],
        across=corners[:, 3] - corners[:, 0],
        reflectance=np.array(reflectances),
        names=tuple(names),
    )


def _quads_of(prim: Usd.Prim, to_world: FloatArray, meters: float) -> list[FloatArray]:
    """Return the corners of a mesh's faces [m], counter-clockwise from the front, [4, 3] each."""
    mesh = UsdGeom.Mesh(prim)
    points = np.array(mesh.GetPointsAttr().Get() or [], np.float64).reshape(-1, 3)
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get() or [], np.int64)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get() or [], np.int64)
    if (counts != 4).any() or counts.sum() != indices.size or not counts.size:
        raise LayerError(
            f"{describe(prim)}: its faces are not all quads (faceVertexCounts); surfaces of a set "
            "are planar quads"
        )
    if indices.min() < 0 or indices.max() >= len(points) or not np.isfinite(points).all():
        raise LayerError(f"{describe(prim)}: points or faceVertexIndices cannot be used; mend them")
    world = (points @ to_world[:3, :3] + to_world[3, :3]) * meters
    is_flipped = str(mesh.GetOrientationAttr().Get()) == "leftHanded"
    is_flipped ^= bool(np.linalg.det(to_world[:3, :3]) < 0.0)
    both_sides = bool(mesh.GetDoubleSidedAttr().Get())
    result = []
    for face, quad in enumerate(world[indices.reshape(-1, 4)]):
        size = np.linalg.norm(np.ptp(quad, axis=0))
        area = np.linalg.norm(np.cross(quad[1] - quad[0], quad[3] - quad[0]))
        bend = quad[0] + quad[2] - quad[1] - quad[3]
        height = abs(float(bend @ np.cross(quad[1] - quad[0], quad[3] - quad[0]))) / max(
            float(area), 1e-30
        )
        if not area > 1e-9 * max(float(size) ** 2, 1e-30):
            raise LayerError(f"{describe(prim)}: face {face} has no area; remove it")
        if height > _FLAT * size:
            raise LayerError(
                f"{describe(prim)}: face {face} is not planar, by {1e3 * height:.3g} mm; surfaces "
                "of a set are planar quads"
            )
        if np.linalg.norm(bend) > _FLAT * size:
            raise LayerError(
                f"{describe(prim)}: face {face} is no parallelogram; cut it into rectangles"
            )
        front = quad[[0, 3, 2, 1]] if is_flipped else quad
        result.append(front)
        if both_sides:
            result.append(front[[0, 3, 2, 1]])
    return result


def _reflectance(prim: Usd.Prim, wavelength_nm: FloatArray) -> FloatArray:
    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    if not material:
        raise LayerError(f"{describe(prim)}: has no material; bind one with a reflectance")
    spectrum = read_spectrum(
        material.GetPrim(), "reflectance", quantities=(SpectralQuantity.REFLECTANCE,)
    )
    if spectrum is None:
        raise LayerError(
            f"{describe(material.GetPrim())}: has no reflectance; apply "
            "SpectralDistributionAPI:reflectance"
        )
    values = spectrum.resample(wavelength_nm)
    worst = int(np.argmax(values))
    if not (values.min() >= 0.0 and values[worst] < 1.0):
        raise LayerError(
            f"{describe(material.GetPrim())}: spectrum:reflectance:values is {values[worst]:g} at "
            f"{wavelength_nm[worst]:g} nm; a surface returns less than all light, so stay below 1"
        )
    return values
