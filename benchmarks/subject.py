"""What both renderers render: a convex body under one small lamp in a room, the same arrays."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

ALBEDO = 0.5
"""Flat reflectance: both renderers then show the same RGB picture, whatever their uplift."""

DISTANCE, WINDOW = 0.32, 0.36
"""Camera distance [m] and half width of its picture at unit distance."""


@dataclass(frozen=True, slots=True, eq=False)
class Body:
    """A smooth convex triangle mesh; nothing on it shadows anything."""

    points: NDArray[np.float32]
    normals: NDArray[np.float32]
    triangles: NDArray[np.int32]


def body(triangle_count: int) -> Body:
    """Return an ellipsoid with about that many triangles."""
    rings = round(np.sqrt(triangle_count / 4.0))
    polar, angle = np.meshgrid(
        np.pi * np.arange(rings + 1) / rings, np.pi * np.arange(2 * rings) / rings, indexing="ij"
    )
    unit = np.stack(
        [np.sin(polar) * np.sin(angle), np.cos(polar), np.sin(polar) * np.cos(angle)], axis=-1
    ).reshape(-1, 3)
    radii = np.array([0.085, 0.1, 0.09])
    normals = unit / radii
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    i, j = np.meshgrid(np.arange(rings), np.arange(2 * rings), indexing="ij")
    here = (i * 2 * rings + j).ravel()
    beside = (i * 2 * rings + (j + 1) % (2 * rings)).ravel()
    below, across = here + 2 * rings, beside + 2 * rings
    triangles = np.concatenate(
        [np.stack([here, below, across], 1), np.stack([here, across, beside], 1)]
    )
    return Body(
        (unit * radii).astype(np.float32), normals.astype(np.float32), triangles.astype(np.int32)
    )


def room(rows: int = 512) -> NDArray[np.float32]:
    """Return a latlong map: a grey room, a window and a lamp 3 degrees wide, RGB."""
    polar = np.pi * (np.arange(rows) + 0.5) / rows
    angle = 2.0 * np.pi * (np.arange(2 * rows) + 0.5) / (2 * rows)
    v, u = np.meshgrid(polar, angle, indexing="ij")
    direction = np.stack([np.sin(v) * np.sin(u), np.cos(v), -np.sin(v) * np.cos(u)], axis=-1)
    light = np.zeros((rows, 2 * rows, 3)) + [0.32, 0.3, 0.28]
    light += np.maximum(direction[..., 1:2], 0.0) * [0.3, 0.32, 0.36]
    light[(np.abs(u - 5.4) < 0.25) & (np.abs(v - 1.4) < 0.3)] = [2.0, 2.4, 3.0]
    toward = np.array([-0.55, 0.6, 0.58]) / np.linalg.norm([-0.55, 0.6, 0.58])
    light[direction @ toward > np.cos(np.radians(1.5))] = [900.0, 850.0, 760.0]
    return light.astype(np.float32)


def write_stage(folder: Path, triangle_count: int) -> Path:
    """Write the subject as a stage, with its map beside it; return the layer."""
    import usdskin.schemas  # noqa: F401
    from usdskin.image_output import Part, write_exr

    from pxr import Gf, Usd, UsdGeom, UsdLux, UsdShade, Vt  # isort: skip

    shape = body(triangle_count)
    write_exr(folder / "room.exr", [Part("rgb", {"": room()}, color_space="lin_rec709_scene")])
    path = folder / f"subject_{triangle_count}.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/World").GetPrim())
    mesh = UsdGeom.Mesh.Define(stage, "/World/Body")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(shape.points))
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(shape.normals))
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    count = np.full(len(shape.triangles), 3, np.int32)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(count))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(shape.triangles.ravel()))
    material = UsdShade.Material.Define(stage, "/World/Skin")
    skin = material.GetPrim()
    skin.ApplyAPI("SkinMaterialAPI")
    skin.GetAttribute("inputs:skin:wrap").Set(0.3)
    skin.ApplyAPI("SpectralDistributionAPI", "reflectance")
    skin.GetAttribute("spectrum:reflectance:quantity").Set("reflectance")
    skin.GetAttribute("spectrum:reflectance:wavelengths").Set([380.0, 730.0])
    skin.GetAttribute("spectrum:reflectance:values").Set([ALBEDO, ALBEDO])
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    dome = UsdLux.DomeLight.Define(stage, "/World/Room")
    dome.CreateTextureFileAttr("./room.exr")
    camera = UsdGeom.Camera.Define(stage, "/World/Camera")
    camera.CreateFocalLengthAttr(0.5)
    camera.CreateHorizontalApertureAttr(WINDOW)
    camera.CreateVerticalApertureAttr(WINDOW)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.01, 10.0))
    UsdGeom.XformCommonAPI(camera).SetTranslate(Gf.Vec3d(0.0, 0.0, DISTANCE))
    stage.Save()
    return path
