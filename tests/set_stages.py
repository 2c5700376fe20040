"""Small virtual sets for the tests of ``usdskin solve``."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from usdskin.prims import SpectralLight, write_spectral_light, write_spectrum
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdLux, UsdShade, Vt

NM = np.array([400.0, 500.0, 600.0, 700.0])
CORNERS = [(x, y, z) for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)]
INWARDS = ((2, 3, 1, 0), (5, 7, 6, 4), (1, 5, 4, 0), (6, 7, 3, 2), (4, 6, 2, 0), (3, 7, 5, 1))


def new_set(path: Path, up: str = "Y") -> Usd.Stage:
    """Return a set with nothing but its capture point, at the origin."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Set").GetPrim())
    for name in ("Surfaces", "Materials", "Lights"):
        UsdGeom.Scope.Define(stage, f"/Set/{name}")
    UsdGeom.Xform.Define(stage, "/Set/CapturePoint")
    return stage


def add_paint(stage: Usd.Stage, name: str, reflectance: float) -> None:
    material = UsdShade.Material.Define(stage, f"/Set/Materials/{name}")
    values = np.full(NM.size, reflectance)
    spectrum = Spectrum(SpectralQuantity.REFLECTANCE, NM, values)
    write_spectrum(material.GetPrim(), "reflectance", spectrum)


def add_surface(
    stage: Usd.Stage, name: str, paint: str, points: list, faces: tuple = ((0, 1, 2, 3),)
) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, f"/Set/Surfaces/{name}")
    mesh.CreatePointsAttr([Gf.Vec3f(*map(float, point)) for point in points])
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([len(face) for face in faces]))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray([i for face in faces for i in face]))
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(
        UsdShade.Material.Get(stage, f"/Set/Materials/{paint}")
    )
    return mesh


def add_room(stage: Usd.Stage, reflectance: float, size: tuple = (1.0, 1.0, 1.0)) -> None:
    """Add a room around the origin, half as large as ``size`` says twice."""
    add_paint(stage, "paint", reflectance)
    points = (np.array(CORNERS) * size).tolist()
    add_surface(stage, "room", "paint", points, INWARDS)


def add_lamp(stage: Usd.Stage, lamp: UsdLux.BoundableLightBase, radiance: float = 10.0) -> None:
    """Give a lamp an even spectrum."""
    values = np.full(NM.size, radiance)
    emission = Spectrum(SpectralQuantity.RADIANCE, NM, values)
    light = SpectralLight(source="tabulated", emission=emission, units="absolute")
    write_spectral_light(lamp.GetPrim(), light)


def add_bulb(
    stage: Usd.Stage, place: tuple = (0.3, 0.5, -0.2), radius: float = 0.05, kind: str = "bulbs"
) -> None:
    bulb = UsdLux.SphereLight.Define(stage, f"/Set/Lights/{kind}/bulb")
    bulb.CreateRadiusAttr(radius)
    bulb.AddTranslateOp().Set(Gf.Vec3d(*place))
    add_lamp(stage, bulb)
