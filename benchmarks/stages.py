"""Variants of the stage of ``scene.write_stage``: layers over it that turn it or light it anew."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import scene


def turntable(folder: Path, stage: Path, what: str, frames: int) -> Path:
    """Write a layer in which the room (``light``) or the camera goes around once.

    Args:
        folder: Where to.
        stage: Layer of ``scene.write_stage``.
        what: ``light`` or ``camera``.
        frames: How many pictures make a full turn, from 1 on.
    """
    from pxr import Gf, Usd, UsdGeom

    path, result = _over(folder, stage, f"turn-{what}")
    result.SetStartTimeCode(1)
    result.SetEndTimeCode(frames)
    prim = UsdGeom.Xformable(result.OverridePrim({"light": "/Room", "camera": "/Camera"}[what]))
    prim.ClearXformOpOrder()
    turn = prim.AddRotateYOp(opSuffix="turn")
    for frame in range(frames):
        turn.Set(360.0 * frame / frames, Usd.TimeCode(frame + 1))
    if what == "camera":
        prim.AddTranslateOp().Set(Gf.Vec3d(0.0, 0.0, scene.CAMERA_DISTANCE))
    result.Save()
    return path


def lamps(folder: Path, stage: Path, kind: str, count: int) -> Path:
    """Write a layer in which lamps take the place of the room.

    Args:
        folder: Where to.
        stage: Layer of ``scene.write_stage``.
        kind: ``distant`` or ``rect``.
        count: How many, evenly over the upper front.
    """
    from pxr import Gf, UsdGeom, UsdLux

    path, result = _over(folder, stage, f"{kind}-{count}")
    result.OverridePrim("/Room").SetActive(False)
    for k in range(count):
        # A Fibonacci lattice over the half sphere around a direction above the camera.
        height = 1.0 - (k + 0.5) / count
        azimuth = 2.399963229728653 * k
        across = np.sqrt(1.0 - height**2)
        toward = np.array([across * np.cos(azimuth), across * np.sin(azimuth), height])
        z = Gf.Vec3d(*(Gf.Rotation(Gf.Vec3d(1, 0, 0), -30.0).TransformDir(Gf.Vec3d(*toward))))
        to_world = Gf.Matrix4d(1.0)
        to_world.SetRotate(Gf.Rotation(Gf.Vec3d(0, 0, 1), z))  # lamps shine along their -Z
        to_world.SetTranslateOnly(3.0 * z)
        name = f"/Lamps/Lamp{k}"
        if kind == "distant":
            lamp = UsdLux.DistantLight.Define(result, name)
            lamp.CreateAngleAttr(3.0)
        else:
            lamp = UsdLux.RectLight.Define(result, name)
            lamp.CreateWidthAttr(0.3)
            lamp.CreateHeightAttr(0.3)
        lamp.CreateIntensityAttr(1.0 / count)
        UsdGeom.Xformable(lamp).AddTransformOp().Set(to_world)
    result.Save()
    return path


def joined(folder: Path, name: str, layers: list[Path]) -> Path:
    """Write a stage of nothing but sublayers, the strongest first."""
    from pxr import Sdf

    layer = Sdf.Layer.CreateNew(str(folder / f"{name}.usda"))
    layer.subLayerPaths = [str(path) for path in layers]
    below = Sdf.Layer.FindOrOpen(str(layers[-1]))
    for key in ("startTimeCode", "endTimeCode"):
        if below.pseudoRoot.HasInfo(key):
            layer.pseudoRoot.SetInfo(key, below.pseudoRoot.GetInfo(key))
    for key in ("upAxis", "metersPerUnit"):
        layer.pseudoRoot.SetInfo(key, {"upAxis": "Y", "metersPerUnit": 1.0}[key])
    layer.Save()
    return Path(layer.realPath)


def _over(folder: Path, stage: Path, name: str) -> tuple[Path, Any]:
    import usdskin.schemas  # noqa: F401  (registers before the first stage)

    # isort: split
    from pxr import Usd, UsdGeom

    path = folder / f"{stage.stem}-{name}.usda"
    result = Usd.Stage.CreateNew(str(path))
    result.GetRootLayer().subLayerPaths = [str(stage)]
    UsdGeom.SetStageUpAxis(result, "Y")
    UsdGeom.SetStageMetersPerUnit(result, 1.0)
    return path, result
