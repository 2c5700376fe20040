"""Describe a folder of photographs as a shoot.

Reads:  photographs of every common kind, ``exposures.csv`` beside them and a lens layer.
Writes: ``shoot.usda`` (``CaptureAPI`` over Cameras with ``FisheyeCameraAPI`` and
        ``ExposureBracketAPI``), to be looked over and corrected by hand.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from usdskin.capture.ingest.options import IngestOptions
from usdskin.capture.ingest.survey import Survey, survey
from usdskin.capture.ingest.survey_checks import shown_share, shown_time
from usdskin.layers import (
    SettingValue,
    check_output,
    quiet_diagnostics,
    record_provenance,
    write_layer,
)
from usdskin.notes import Note
from usdskin.prims import Shoot, View, write_bracket, write_lens, write_rotation
from usdskin.prims.writing import write_schema
from usdskin.progress import Progress

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom


def ingest(
    directory: str | Path,
    output: str | Path,
    options: IngestOptions | None = None,
    *,
    notes: list[Note] | None = None,
    progress: Progress | None = None,
) -> Path:
    """Write the shoot layer of a folder of photographs.

    Args:
        directory: Folder of photographs, with a sub-folder for each view or all in one. It is
            read, never changed.
        output: Layer to write; it names the photographs relative to its own folder.
        options: What the photographs do not tell.
        notes: Takes what was assumed, skipped, or needs attention.
        progress: Told how far the reading is.

    Returns:
        ``output``, once it is complete on disk.

    Raises:
        UsageError: The folder has no photographs, or the options do not fit them.
        ImageError: A photograph is broken, or contradicts the others.
        LayerError: The table or the lens layer cannot be used, or the output not be written.
    """
    options, output = options or IngestOptions(), Path(output)
    check_survey_output(output, options)
    found = survey(Path(directory), options, [] if notes is None else notes, progress)
    return write_survey(found, output, options)


def check_survey_output(output: Path, options: IngestOptions) -> None:
    """Refuse what would fail after the photographs are read, or destroy an input.

    Raises:
        UsageError: The output cannot have this name, or is the lens layer.
        UsdSkinError: The folder cannot be made or written to.
    """
    check_output(output, [] if options.lens is None else [options.lens], step="ingest")


def write_survey(found: Survey, output: Path, options: IngestOptions) -> Path:
    """Write a survey as a shoot layer.

    Args:
        found: What ``survey`` returned.
        output: Layer to write.
        options: What the survey was told, for the record.

    Raises:
        LayerError: The layer cannot be written.
    """
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    shoot = found.shoot
    prim = UsdGeom.Xform.Define(stage, f"/{shoot.name}").GetPrim()
    stage.SetDefaultPrim(prim)
    write_schema(prim, "CaptureAPI", _session(shoot))
    cameras = [_write_view(stage, prim, view, found.lens_layer, output) for view in shoot.views]
    prim.GetRelationship("capture:views").SetTargets([camera.GetPath() for camera in cameras])
    settings: dict[str, SettingValue] = {
        "directions": ",".join(map(str, found.directions)),
        "fov": options.field_deg,
        "only": options.only or "",
        "projection": options.projection,
        "views": options.views or "",
    }
    record_provenance(stage, "ingest", found.inputs, settings, output.parent)
    return write_layer(stage, output)


def _session(shoot: Shoot) -> dict[str, Any]:
    values: dict[str, Any] = {
        "capture:session": shoot.session,
        "capture:device": shoot.device,
        "capture:time": shoot.time,
        "capture:settings:model": shoot.model,
        "capture:settings:lens": shoot.lens,
        "capture:settings:whiteBalance": shoot.white_balance,
    }
    for name, reading, direction in (
        ("capture:illuminance", shoot.illuminance_lx, shoot.illuminance_direction),
        ("capture:luminance", shoot.luminance, shoot.luminance_direction),
    ):
        if direction is not None:
            values[name] = reading
            values[f"{name}:direction"] = Gf.Vec3d(*(float(part) for part in direction))
    return values


def _write_view(
    stage: Usd.Stage, parent: Usd.Prim, view: View, lens_layer: Path | None, output: Path
) -> Usd.Prim:
    camera = UsdGeom.Camera.Define(stage, parent.GetPath().AppendChild(view.name)).GetPrim()
    if lens_layer is None:
        write_lens(camera, view.lens)
    else:
        name = Path(os.path.relpath(lens_layer, output.parent)).as_posix()
        with quiet_diagnostics():  # a stage in memory has no folder to find the layer from
            camera.GetReferences().AddReference(name if name.startswith("..") else f"./{name}")
    write_bracket(camera, view.bracket, output.parent)
    write_rotation(camera, view.rotation)
    return camera


# --- For people --------------------------------------------------------------------------------


def describe_survey(found: Survey) -> dict[str, Any]:
    """Return what was understood, as ``usdskin.inspect.print_report`` prints it."""
    shoot = found.shoot
    lens = shoot.views[0].lens
    kind = "guessed" if found.lens_layer is None else str(found.lens_layer)
    summary: dict[str, Any] = {
        "camera": shoot.model or None,
        "lens": shoot.lens or None,
        "taken": shoot.time or None,
        "size": f"{lens.resolution[0]} x {lens.resolution[1]} px",
        "projection": f"{lens.projection}, f {lens.focal_length_px:.1f} px, up to "
        f"{lens.max_angle_deg:g} deg from the axis ({kind})",
    }
    rows = [
        _row(found, view, str(direction))
        for view, direction in zip(shoot.views, found.directions, strict=True)
    ]
    return {"file": str(found.directory), "summary": summary, "views": rows}


def _row(found: Survey, view: View, direction: str) -> dict[str, Any]:
    bracket = view.bracket
    order = np.argsort(bracket.exposure, kind="stable")
    looks = [found.looks[bracket.images[index]] for index in (order[0], order[-1])]
    times = bracket.exposure_time_s[order]
    row: dict[str, Any] = {
        "view": view.name,
        "direction": direction,
        "images": len(bracket.images),
        "exposure": " .. ".join(_distinct([shown_time(times[0]), shown_time(times[-1])])),
        "stops": round(float(np.log2(np.ptp(bracket.exposure) / bracket.exposure.min() + 1.0)), 1),
        "aperture": " ".join(_distinct([f"f/{value:g}" for value in bracket.f_number])),
        "iso": " ".join(_distinct([f"{value:g}" for value in bracket.iso])),
        "saturated": " .. ".join(shown_share(look.saturated, look.pixels) for look in looks),
    }
    if (bracket.nd_factor != 1.0).any():
        row["nd"] = " ".join(_distinct([f"{value:g}" for value in bracket.nd_factor]))
    return row


def _distinct(texts: Sequence[str]) -> list[str]:
    return list(dict.fromkeys(texts))
