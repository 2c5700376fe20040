"""The shots of a proof: the same picture with the true and with the estimated light and skin.

Each sublayers the set's shot and overrides ``/Shot/Light`` and ``/Shot/Skin``; any tool opens it.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from usdskin.errors import LayerError
from usdskin.judge.proof_skin import SHOT_SKIN
from usdskin.layers import open_stage, quiet_diagnostics, record_provenance, write_layer

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom

SHOT_LIGHT = "/Shot/Light"
"""Where a proof's shot has its light."""

_OF_A_ROOT = ("startTimeCode", "endTimeCode", "timeCodesPerSecond", "framesPerSecond")


@dataclass(frozen=True, slots=True)
class ShotParts:
    """What a shot is made of."""

    light: Path
    """Layer whose default prim lights it."""

    skin: Path
    """Layer whose default prim is the skin."""

    thickness_m: float = 0.0
    """``inputs:skin:thickness`` [m]: of the subject, not of its skin, so no fit tells it."""

    subject: str | None = None
    """Variant of the subject; None: the shot's own."""


def write_shot(base: Path, parts: ShotParts, output: Path) -> Path:
    """Write a shot over another.

    Args:
        base: The set's shot.
        parts: What takes the place of its light and skin.
        output: Layer to write.

    Raises:
        LayerError: The base is no shot of a proof, or the layer cannot be written.
    """
    stage = open_stage(base)
    for path in (SHOT_LIGHT, SHOT_SKIN):
        if not stage.GetPrimAtPath(path):
            raise LayerError(f"{base}: has no <{path}>, which a proof replaces; see docs/proof.md")
    root = stage.GetRootLayer()
    layer = Sdf.Layer.CreateAnonymous("shot.usda")
    folder = output.parent.resolve()
    layer.subLayerPaths.append(_name(base, folder))
    # Metadata of a stage is that of its root layer alone.
    layer.defaultPrim = root.defaultPrim
    for name in _OF_A_ROOT:
        if root.pseudoRoot.HasInfo(name):
            layer.pseudoRoot.SetInfo(name, root.pseudoRoot.GetInfo(name))
    settings = stage.GetMetadata("renderSettingsPrimPath")
    if settings:
        layer.pseudoRoot.SetInfo("renderSettingsPrimPath", settings)
    layer.pseudoRoot.SetInfo("upAxis", UsdGeom.GetStageUpAxis(stage))
    layer.pseudoRoot.SetInfo("metersPerUnit", UsdGeom.GetStageMetersPerUnit(stage))
    for path, file in ((SHOT_LIGHT, parts.light), (SHOT_SKIN, parts.skin)):
        prim = Sdf.CreatePrimInLayer(layer, path)
        # Explicit, so that what the base refers to is replaced and not added to.
        prim.referenceList.explicitItems = [Sdf.Reference(_name(file, folder))]
    skin = layer.GetPrimAtPath(SHOT_SKIN)
    thickness = Sdf.AttributeSpec(skin, "inputs:skin:thickness", Sdf.ValueTypeNames.Float)
    thickness.default = parts.thickness_m
    if parts.subject is not None:
        prim = Sdf.CreatePrimInLayer(layer, "/Shot/Subject")
        prim.variantSelections["subject"] = parts.subject
    with quiet_diagnostics():  # in memory, a stage cannot find what lies beside its file
        written = Usd.Stage.Open(layer, Usd.Stage.LoadNone)
        record_provenance(written, "prove", [base, parts.light, parts.skin], {}, output.parent)
    output.parent.mkdir(parents=True, exist_ok=True)
    return write_layer(layer, output)


def _name(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file.resolve(), folder)).as_posix()
