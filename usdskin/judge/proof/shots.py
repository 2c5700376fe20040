"""The shots of a proof: the same picture with the true and with the estimated light and skin.

Each sublayers the set's shot and overrides ``/Shot/Light`` and ``/Shot/Skin``; any tool opens it.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from usdskin.errors import LayerError
from usdskin.judge.proof.skin import SHOT_SKIN
from usdskin.layers import open_stage, quiet_diagnostics, record_provenance, write_layer
from usdskin.notes import Note

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd

SHOT_LIGHT = "/Shot/Light"
"""Where a proof's shot has its light."""

SHOT_SUBJECT = "/Shot/Subject"
"""Where it has who is lit."""

_OF_A_ROOT = (
    *("defaultPrim", "upAxis", "metersPerUnit", "renderSettingsPrimPath"),
    *("startTimeCode", "endTimeCode", "timeCodesPerSecond", "framesPerSecond"),
)


@dataclass(frozen=True, slots=True)
class ShotParts:
    """What a shot is made of."""

    light: Path
    """Layer whose default prim lights it."""

    skin: Path
    """Layer whose default prim is the skin."""

    thickness_m: float = 0.0
    """``inputs:skin:thickness`` [m]: of the subject, not of its skin, so no fit tells it."""


def subject_and_tone(subject: str | None, tone: str | None) -> dict[tuple[str, str], str | None]:
    """Return the variants of a proof's shot that can be asked for."""
    return {(SHOT_SUBJECT, "subject"): subject, (SHOT_SKIN, "tone"): tone}


def check_shot(shot: Path, variants: Mapping[tuple[str, str], str | None]) -> None:
    """Refuse a shot that could not be rendered, whatever its light.

    Args:
        shot: The set's shot; its light need not have been made yet.
        variants: As of ``write_base``.

    Raises:
        LayerError: It has no such variant, or layers are missing.
    """

    def prepare(stage: Usd.Stage) -> None:
        with Usd.EditContext(stage, stage.GetSessionLayer()):
            light = stage.GetPrimAtPath(SHOT_LIGHT)
            if light:
                light.GetReferences().SetReferences([])
            for (prim_path, variant_set), chosen in variants.items():
                known = _variants(stage, prim_path, variant_set)
                if chosen is not None and chosen not in known:
                    raise LayerError(
                        f"{shot}: <{prim_path}> has no variant {variant_set}={chosen}; it has "
                        f"{', '.join(known) or 'none'}"
                    )
                if chosen is not None:
                    owned = stage.GetPrimAtPath(prim_path).GetVariantSets()
                    owned.SetSelection(variant_set, chosen)

    missing: list[Note] = []
    stage = open_stage(shot, missing, prepare)
    if missing:
        subject = stage.GetPrimAtPath(SHOT_SUBJECT)
        others = set(_variants(stage, SHOT_SUBJECT, "subject"))
        if subject:
            others.discard(subject.GetVariantSet("subject").GetVariantSelection())
        choice = f", or choose --subject {'|'.join(sorted(others))}" if others else ""
        what = missing[0].message.rstrip(".")
        raise LayerError(f"{shot} <{missing[0].path}>: {what}; restore the missing layer{choice}")


def _variants(stage: Usd.Stage, prim_path: str, variant_set: str) -> list[str]:
    prim = stage.GetPrimAtPath(prim_path)
    return list(prim.GetVariantSets().GetVariantSet(variant_set).GetVariantNames()) if prim else []


def write_base(
    shot: Path, light: Path, variants: Mapping[tuple[str, str], str | None], output: Path
) -> Path:
    """Write the set's shot with variants chosen.

    Args:
        shot: The set's shot.
        light: Takes the place of its light, which need not have been made yet.
        variants: Prim and variant set -> variant; None leaves the shot's own.
        output: Layer to write.

    Raises:
        LayerError: The shot has no such variant, or is no shot of a proof.
    """
    check_shot(shot, variants)
    layer = _over(Sdf.Layer.FindOrOpen(str(shot)), shot, output)
    name = _name(light, output.parent.resolve())
    layer.GetPrimAtPath(SHOT_LIGHT).referenceList.explicitItems = [Sdf.Reference(name)]
    for (prim_path, variant_set), chosen in variants.items():
        if chosen is not None:
            Sdf.CreatePrimInLayer(layer, prim_path).variantSelections[variant_set] = chosen
    _write(layer, [shot, light], output)
    stage = open_stage(output)
    for path in (SHOT_LIGHT, SHOT_SKIN):
        if not stage.GetPrimAtPath(path).IsDefined():
            raise LayerError(f"{shot}: has no <{path}>, which a proof replaces; see docs/proof.md")
    return output


def write_shot(base: Path, parts: ShotParts, output: Path) -> Path:
    """Write a shot over another.

    Args:
        base: What ``write_base`` wrote.
        parts: What takes the place of its light and skin.
        output: Layer to write.

    Raises:
        LayerError: The layer cannot be written.
    """
    layer = _over(Sdf.Layer.FindOrOpen(str(base)), base, output)
    for path, file in ((SHOT_LIGHT, parts.light), (SHOT_SKIN, parts.skin)):
        prim = layer.GetPrimAtPath(path)
        # Explicit, so that what the base refers to is replaced and not added to.
        name = _name(file, output.parent.resolve())
        prim.referenceList.explicitItems = [Sdf.Reference(name)]
    skin = layer.GetPrimAtPath(SHOT_SKIN)
    thickness = Sdf.AttributeSpec(skin, "inputs:skin:thickness", Sdf.ValueTypeNames.Float)
    thickness.default = parts.thickness_m
    return _write(layer, [base, parts.light, parts.skin], output)


def _over(base: Sdf.Layer, path: Path, output: Path) -> Sdf.Layer:
    """Return an empty layer over another, with its metadata: a stage's are its root layer's."""
    layer = Sdf.Layer.CreateAnonymous("shot.usda")
    layer.subLayerPaths.append(_name(path, output.parent.resolve()))
    for name in _OF_A_ROOT:
        if base.pseudoRoot.HasInfo(name):
            layer.pseudoRoot.SetInfo(name, base.pseudoRoot.GetInfo(name))
    for prim_path in (SHOT_LIGHT, SHOT_SKIN):
        Sdf.CreatePrimInLayer(layer, prim_path)
    return layer


def _write(layer: Sdf.Layer, inputs: Sequence[Path], output: Path) -> Path:
    with quiet_diagnostics():  # in memory, a stage cannot find what lies beside its file
        stage = Usd.Stage.Open(layer, Usd.Stage.LoadNone)
        record_provenance(stage, "prove", inputs, {}, output.parent)
    return write_layer(layer, output)


def _name(file: Path, folder: Path) -> str:
    return Path(os.path.relpath(file.resolve(), folder)).as_posix()
