"""The layers of a shoot of skin: what the photographer states, and what was true.

Writes: ``samples.usda``, and ``truth/truth.usda``.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.shoot.setups import Setup
from usdskin.judge.shoot.shoot_layers import new_stage, stated_bracket
from usdskin.judge.shoot.viewpoints import Orientation
from usdskin.judge.skin.scenes import Subject, define_lamp, direction_of, facing
from usdskin.layers import SettingValue, open_stage, record_provenance, write_layer
from usdskin.prims import write_bracket
from usdskin.prims.samples import SkinSamples, write_skin_samples
from usdskin.prims.skin import SkinParameters, read_skin, write_skin
from usdskin.spectrum import Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdShade, Vt

FloatArray = NDArray[np.float64]

_TRUTH_SKIN = "/Truth/skin"


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """One photograph, as it was taken."""

    name: str
    """Of its prim and file."""

    view: int
    """Index of the view."""

    light: Orientation
    """Where the lamp stood [deg]."""

    files: tuple[Path, ...]
    """Its bracket, or the one picture in camera values."""

    geometry: Path
    """The AOVs of its view."""


@dataclass(frozen=True, slots=True, eq=False)
class SubjectTruth:
    """What the photographs do not tell."""

    skin: SkinParameters
    """The material."""

    white: FloatArray
    """Camera values of a perfect diffuser that faces the lamp, shape [3]."""

    constants: dict[str, Any]
    """``sensorConstant``, ``camera``, ``illuminanceLux``, ``fullWell``, ``readNoise``, ``seed``."""


def write_samples(
    path: Path,
    subject: Subject,
    setup: Setup,
    shots: Sequence[Shot],
    irradiance: Spectrum,
    stated: SkinSamples,
    calibration: Path | None,
    final: Path,
) -> None:
    """Write the layer that describes the photographs as their taker would.

    Args:
        path: Layer to write, beside the folders of photographs and geometry.
        subject: What was photographed.
        setup: How; its bracket is that of every photograph.
        shots: The photographs.
        irradiance: Of a surface that faces the lamp [W m^-2 nm^-1].
        stated: White, saturation and class of the light; files are filled in here.
        calibration: Layer whose default prim is the calibrated camera.
        final: Where the layer's folder is going to lie in the end.

    Raises:
        LayerError: The layer cannot be written.
    """
    stage = new_stage(subject.up_axis)
    prim = UsdGeom.Scope.Define(stage, "/Samples").GetPrim()
    stage.SetDefaultPrim(prim)
    are_images = len(shots[0].files) == 1 and shots[0].files[0].parent.name == "images"
    lights = _define_lights(stage, subject, irradiance, shots)
    views = () if are_images else _define_views(stage, setup, shots, path.parent)
    camera_path: Sdf.Path | None = None
    if calibration is not None:
        camera = UsdGeom.Camera.Define(stage, "/Samples/camera")
        camera_path = camera.GetPath()
    write_skin_samples(
        prim,
        SkinSamples(
            quantity="cameraValues",
            white=stated.white,
            light_class=stated.light_class,
            saturation=stated.saturation if are_images else 0.0,
            images=tuple(shot.files[0] for shot in shots) if are_images else (),
            geometry_files=tuple(shot.geometry for shot in shots),
        ),
        path.parent,
        camera=camera_path,
        lights=lights,
        views=views,
    )
    settings: dict[str, SettingValue] = {
        "camera": setup.camera,
        "seed": setup.seed,
        "photographs": len(shots),
    }
    record_provenance(stage, "photograph", [subject.stage], settings, final)
    write_layer(stage, path)
    if calibration is not None:
        _refer(path, "/Samples/camera", _relative(calibration, final))


def _define_lights(
    stage: Usd.Stage, subject: Subject, irradiance: Spectrum, shots: Sequence[Shot]
) -> tuple[Sdf.Path, ...]:
    UsdGeom.Scope.Define(stage, "/Samples/lights")
    paths = []
    for shot in shots:
        rotation = facing(direction_of(shot.light, subject.up_axis), subject.up_axis)
        lamp = define_lamp(stage, f"/Samples/lights/{shot.name}", irradiance, [rotation])
        paths.append(lamp.GetPath())
    return tuple(paths)


def _define_views(
    stage: Usd.Stage, setup: Setup, shots: Sequence[Shot], folder: Path
) -> tuple[Sdf.Path, ...]:
    UsdGeom.Scope.Define(stage, "/Samples/photographs")
    paths = []
    for index, shot in enumerate(shots):
        camera = UsdGeom.Camera.Define(stage, f"/Samples/photographs/{shot.name}").GetPrim()
        write_bracket(camera, stated_bracket(setup, shot.files, index), folder)
        paths.append(camera.GetPath())
    return tuple(paths)


def _refer(path: Path, prim_path: str, file: str) -> None:
    """Add a reference to a layer; a stage in memory cannot find what lies beside its file."""
    layer = Sdf.Layer.FindOrOpen(str(path))
    layer.GetPrimAtPath(prim_path).referenceList.prependedItems.append(Sdf.Reference(file))
    layer.Save()


def _relative(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file.resolve(), folder.resolve())).as_posix()


def write_subject_truth(
    folder: Path,
    subject: Subject,
    white: FloatArray,
    constants: Mapping[str, Any],
    final: Path,
) -> None:
    """Write ``truth.usda``: the material, and what else the photographer knows.

    Args:
        folder: To be made.
        subject: What was photographed.
        white: Camera values of a perfect diffuser that faces the lamp, shape [3].
        constants: Goes into ``customData["truth"]`` of the default prim.
        final: Where the folder is going to lie in the end.
    """
    folder.mkdir()
    stage = new_stage(subject.up_axis)
    prim = UsdGeom.Scope.Define(stage, "/Truth").GetPrim()
    stage.SetDefaultPrim(prim)
    facts = {**constants, "white": Vt.DoubleArray(white.tolist())}
    prim.SetCustomDataByKey("truth", facts)
    material = UsdShade.Material.Define(stage, _TRUTH_SKIN)
    write_skin(material.GetPrim(), subject.skin, folder)
    record_provenance(stage, "photograph", [subject.stage], {}, final)
    write_layer(stage, folder / "truth.usda")


def read_subject_truth(folder: str | Path) -> SubjectTruth:
    """Return the truth about a shoot of skin.

    Args:
        folder: What ``photograph_subject`` wrote.

    Raises:
        LayerError: There is no truth in the folder.
    """
    stage = open_stage(Path(folder) / "truth" / "truth.usda")
    constants = dict(stage.GetDefaultPrim().GetCustomDataByKey("truth"))
    white = np.array(constants.pop("white"), dtype=np.float64)
    return SubjectTruth(read_skin(stage.GetPrimAtPath(_TRUTH_SKIN)), white, constants)
