"""What is in a file: ``usdskin info``.

Reads: a stage, a layer, or a picture's headers; never its pixels.
Makes: a report of plain values, the same for people and programs.
"""

from __future__ import annotations

import math
import os
import sys
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TextIO

from usdskin.errors import UsdSkinError
from usdskin.inspect_estimates import (
    chart_row,
    light_estimate_row,
    recovery_rows,
    skin_row,
    spectral_camera_row,
    transfer_row,
)
from usdskin.notes import Note

LAYER_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")

ROW_LIMIT = 40
"""Rows of a table shown to people; ``--json`` has them all."""

Row = dict[str, Any]
Report = dict[str, Any]

_NO_PICTURES = ("captures", "calibrations", "charts", "estimates", "skins")
"""What layers hold that are no stages to render: what a render would miss is no problem."""


def inspect_file(path: Path) -> Report:
    """Return what is in a stage, layer or picture.

    Args:
        path: File to look into.

    Returns:
        ``file``, ``kind`` (``stage`` or ``image``), ``summary`` (name to value) and tables, each a
        list of rows. A stage's ``problems`` are what would stop a render.

    Raises:
        LayerError: The layer cannot be opened.
        ImageError: The file is no picture.
    """
    if path.suffix.lower() in LAYER_SUFFIXES:
        return _inspect_stage(path)
    return _inspect_image(path)


def _inspect_stage(path: Path) -> Report:
    from usdskin.layers import corruption_as_errors, open_stage, quiet_diagnostics

    notes: list[Note] = []
    with corruption_as_errors(path), quiet_diagnostics():
        return _stage_report(path, open_stage(path, notes), notes)


def _stage_report(path: Path, stage: Any, notes: list[Note]) -> Report:
    from pxr import Usd, UsdGeom, UsdLux, UsdRender, UsdShade

    problems: list[str] = []
    report: Report = {"file": str(path), "kind": "stage", "summary": _stage_summary(stage)}
    kinds: Sequence[tuple[str, Callable[[Any], bool], Callable[[Any], Row | list[Row]]]] = (
        ("cameras", _is_render_camera, _camera_row),
        ("lights", lambda prim: prim.HasAPI(UsdLux.LightAPI), _light_row),
        ("materials", lambda prim: prim.IsA(UsdShade.Material), _material_row),
        ("skins", lambda prim: prim.HasAPI("SkinMaterialAPI"), skin_row),
        ("meshes", lambda prim: prim.IsA(UsdGeom.Gprim), _gprim_row),
        ("captures", lambda prim: prim.HasAPI("CaptureAPI"), _capture_row),
        ("views", lambda prim: prim.HasAPI("FisheyeCameraAPI"), _view_row),
        ("charts", lambda prim: prim.HasAPI("ColorChartAPI"), chart_row),
        ("calibrations", _is_calibrated, spectral_camera_row),
        ("recoveries", _is_calibrated, recovery_rows),
        ("estimates", lambda prim: prim.HasAPI("LightEstimateAPI"), light_estimate_row),
        ("transfers", lambda prim: prim.HasAPI("SkinTransferAPI"), transfer_row),
        ("renderSettings", lambda prim: prim.IsA(UsdRender.Settings), _settings_row),
        ("variants", lambda prim: prim.HasVariantSets(), _variant_row),
    )
    for name, _, _ in kinds:
        report[name] = []
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        for name, belongs, row in kinds:
            if belongs(prim):
                try:
                    rows = row(prim)
                    rows = rows if isinstance(rows, list) else [rows]
                    report[name] += [{"path": str(prim.GetPath()), **item} for item in rows]
                except UsdSkinError as error:
                    problems.append(str(error))
    if report["meshes"] or not any(report[name] for name in _NO_PICTURES):
        _try_reading(stage, notes, problems)
    report["notes"] = [
        {"code": note.code, "path": note.path, "message": note.message} for note in notes
    ]
    report["problems"] = list(dict.fromkeys(problems))
    return report


def _is_render_camera(prim: Any) -> bool:
    from pxr import UsdGeom

    instruments = ("FisheyeCameraAPI", "SpectralCameraAPI")
    return prim.IsA(UsdGeom.Camera) and not any(prim.HasAPI(name) for name in instruments)


def _is_calibrated(prim: Any) -> bool:
    return bool(prim.HasAPI("SpectralCameraAPI"))


def _try_reading(stage: Any, notes: list[Note], problems: list[str]) -> None:
    """Read the stage as a render would, for what it would say; surfaces stay coarse."""
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.scene import read_scene
    from usdskin.render.settings import read_settings, resolve_settings

    overrides = RenderOverrides(subdivision_level=0)
    try:
        resolve_settings(stage, overrides, None, notes)
    except UsdSkinError as error:
        problems.append(str(error))
    try:
        read_scene(stage, _start(stage), read_settings(stage, overrides), notes)
    except UsdSkinError as error:
        problems.append(str(error))


def _start(stage: Any) -> Any:
    from pxr import Usd

    if stage.HasAuthoredMetadata("startTimeCode"):
        return Usd.TimeCode(stage.GetStartTimeCode())
    return Usd.TimeCode.EarliestTime()


def _stage_summary(stage: Any) -> Row:
    from pxr import UsdGeom

    timed = stage.HasAuthoredTimeCodeRange()
    return {
        "layers": _layer_names(stage),
        "defaultPrim": str(stage.GetDefaultPrim().GetPath()) if stage.GetDefaultPrim() else None,
        "upAxis": str(UsdGeom.GetStageUpAxis(stage)),
        "metersPerUnit": float(UsdGeom.GetStageMetersPerUnit(stage)),
        "startTimeCode": float(stage.GetStartTimeCode()) if timed else None,
        "endTimeCode": float(stage.GetEndTimeCode()) if timed else None,
        "timeCodesPerSecond": float(stage.GetTimeCodesPerSecond()),
        "renderSettings": str(stage.GetMetadata("renderSettingsPrimPath") or "") or None,
    }


def _layer_names(stage: Any) -> list[str]:
    """Return the root's layer stack, strongest first, then the layers of arcs by their paths.

    A layer goes by its file name, or by its path from the root layer's folder where two files have
    that name.
    """
    stack = [layer for layer in stage.GetLayerStack(False) if not layer.anonymous]
    others = {layer for layer in stage.GetUsedLayers() if not layer.anonymous} - set(stack)
    layers = stack + sorted(others, key=lambda layer: str(layer.identifier))
    names = [str(layer.GetDisplayName() or layer.identifier) for layer in layers]
    folder = os.path.dirname(stage.GetRootLayer().identifier) or "."
    return [
        Path(os.path.relpath(layer.identifier, folder)).as_posix()
        if names.count(name) > 1
        else name
        for layer, name in zip(layers, names, strict=True)
    ]


def _value(prim: Any, name: str) -> Any:
    from pxr import Usd

    attribute = prim.GetAttribute(name)
    return attribute.Get(Usd.TimeCode.EarliestTime()) if attribute else None


def _camera_row(prim: Any) -> Row:
    row: Row = {name: _value(prim, name) for name in ("projection", "focalLength")}
    horizontal, vertical = _value(prim, "horizontalAperture"), _value(prim, "verticalAperture")
    return {**row, "aperture": f"{_shown(horizontal)} x {_shown(vertical)}"}


def _capture_row(prim: Any) -> Row:
    from usdskin.prims.values import DEFAULT_TIME, read_schema

    values = read_schema(prim, "CaptureAPI", DEFAULT_TIME)
    panorama = values["capture:panorama:file"]
    row: Row = {
        "session": values["capture:session"] or None,
        "time": values["capture:time"] or None,
    }
    row |= {f"{name} [{unit}]": values[f"capture:{name}"] or None
            for name, unit in (("illuminance", "lx"), ("luminance", "cd/m2"))}  # fmt: skip
    if panorama is None:
        return row | {"panorama": None}
    lamps = values["capture:lamps:shares"]
    shares = ("coverage", "clippedShare", "movedShare", "noise", "fluxError")
    return {
        **row,
        "panorama": panorama.name,
        "units": values["capture:units"],
        **{name: values[f"capture:{name}"] for name in shares},
        "rotationResidual [deg]": values["capture:rotationResidual"],
        "clippedLamps": _length(lamps),
    }


def _view_row(prim: Any) -> Row:
    from usdskin.prims import read_bracket, read_lens

    lens = read_lens(prim)
    row: Row = {
        "projection": lens.projection,
        "focal [px]": lens.focal_length_px,
        "maxAngle [deg]": lens.max_angle_deg,
        "size": f"{lens.resolution[0]} x {lens.resolution[1]}",
        "glare": lens.glare,
    }
    if not prim.HasAPI("ExposureBracketAPI"):
        return row
    bracket = read_bracket(prim)
    times = bracket.exposure_time_s
    stops = math.log2(bracket.exposure.max() / bracket.exposure.min())
    return {
        **row,
        "images": len(bracket.images),
        "times [s]": f"{times.min():g} to {times.max():g}",
        "range [stops]": round(stops, 1),
    }


def _light_row(prim: Any) -> Row:
    from usdskin.prims import read_spectral_light

    # isort: split
    from pxr import Usd

    light = read_spectral_light(prim, Usd.TimeCode.EarliestTime())
    source = "rgb" if light is None else light.source
    row: Row = {"type": prim.GetTypeName(), "source": source, "spectrum": None}
    if source == "rgb":
        row["spectrum"] = "D65" if light is None else str(light.illuminant_file or light.illuminant)
    elif light is not None and light.basis is not None:
        row["spectrum"] = f"rank {light.basis.shape[0]}"
    elif source in ("blackbody", "illuminantD"):
        row["spectrum"] = f"{_shown(_value(prim, 'inputs:colorTemperature'))} K"
    elif light is not None and light.emission is not None:
        wavelength_nm = light.emission.wavelength_nm
        row["spectrum"] = f"{wavelength_nm[0]:g}-{wavelength_nm[-1]:g} nm"
    row["units"] = "relative" if light is None else light.units
    row["intensity"] = _value(prim, "inputs:intensity")
    row["exposure"] = _value(prim, "inputs:exposure")
    file = _value(prim, "inputs:texture:file")
    row["texture"] = file.path if file is not None and hasattr(file, "path") else None
    return row


def _material_row(prim: Any) -> Row:

    # isort: split
    from pxr import UsdShade

    surface = UsdShade.Material(prim).ComputeSurfaceSource("")[0]
    return {
        "surface": surface.GetShaderId() if surface else None,
        "skin": prim.HasAPI("SkinMaterialAPI"),
    }


def _gprim_row(prim: Any) -> Row:
    from pxr import UsdGeom, UsdShade

    material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
    row: Row = {
        "type": prim.GetTypeName(),
        "material": str(material.GetPath()) if material else None,
    }
    if not prim.IsA(UsdGeom.Mesh):
        return row
    counts, points = _value(prim, "faceVertexCounts"), _value(prim, "points")
    return {
        **row,
        "points": _length(points),
        "faces": _length(counts),
        "subdivision": _value(prim, "subdivisionScheme"),
        "subsets": len(UsdGeom.Subset.GetAllGeomSubsets(UsdGeom.Imageable(prim))),
        "primvars": sorted(
            str(primvar.GetPrimvarName())
            for primvar in UsdGeom.PrimvarsAPI(prim).GetPrimvarsWithAuthoredValues()
        ),
    }


def _length(array: Any) -> int:
    return len(array) if hasattr(array, "__len__") else 0


def _settings_row(prim: Any) -> Row:
    size = _value(prim, "resolution")
    names = (("integrator", "usdskin:integrator"), ("samples", "usdskin:samplesPerPixel"))
    return {
        "resolution": " x ".join(map(str, size)) if _length(size) == 2 else None,
        **{short: _value(prim, name) for short, name in names},
        "products": [str(path) for path in prim.GetRelationship("products").GetTargets()],
    }


def _variant_row(prim: Any) -> Row:
    sets = prim.GetVariantSets()
    return {
        "sets": {
            name: {
                "selected": sets.GetVariantSet(name).GetVariantSelection(),
                "variants": list(sets.GetVariantSet(name).GetVariantNames()),
            }
            for name in sets.GetNames()
        }
    }


def _inspect_image(path: Path) -> Report:
    from usdskin.images import read_headers
    from usdskin.spectral_layout import spectral_channels

    parts = []
    headers: list[Row] = []
    for index, header in enumerate(read_headers(path)):
        bands = spectral_channels(header.channel_names)
        spectral = {name for _, name in bands}
        row: Row = {
            "part": header.name or str(index),
            "size": f"{header.width} x {header.height}",
            "channels": [name for name in header.channel_names if name not in spectral],
            "types": sorted(set(header.channel_types)),
            "bands": len(bands),
            "wavelengths": f"{bands[0][0]:g}-{bands[-1][0]:g} nm" if bands else None,
            "colorSpace": header.color_space,
        }
        parts.append(row)
        headers += [
            {"part": row["part"], "name": name, "value": _plain(value)}
            for name, value in sorted(header.attributes.items())
        ]
    summary = {"parts": len(parts), "bytes": path.stat().st_size}
    return {
        "file": str(path),
        "kind": "image",
        "summary": summary,
        "parts": parts,
        "headers": headers,
    }


def _plain(value: Any) -> Any:
    if isinstance(value, bool | int | float | str):
        return value
    if isinstance(value, Iterable):
        return [_plain(item) for item in value]
    return str(value)


def print_report(report: Report, stream: TextIO | None = None) -> None:
    """Print a report for people: ruled tables on a terminal, plain columns elsewhere."""
    stream = stream or sys.stdout
    print(report["file"], file=stream)
    for name, value in report["summary"].items():
        print(f"  {name}: {_shown(value)}", file=stream)
    for title, rows in report.items():
        if not isinstance(rows, list) or not rows:
            continue
        print(f"\n{title} ({len(rows)})", file=stream)
        if isinstance(rows[0], Mapping):
            _print_table(rows[:ROW_LIMIT], stream)
        else:
            print(*(f"  {row}" for row in rows), sep="\n", file=stream)
        if len(rows) > ROW_LIMIT and isinstance(rows[0], Mapping):
            print(f"  ... and {len(rows) - ROW_LIMIT} more; --json lists all", file=stream)


def _print_table(rows: Sequence[Row], stream: TextIO) -> None:
    columns = list(dict.fromkeys(column for row in rows for column in row))
    cells = [[_shown(row.get(column)) for column in columns] for row in rows]
    if stream.isatty():
        from rich import box
        from rich.console import Console
        from rich.table import Table
        from rich.text import Text

        table = Table(*columns, box=box.SIMPLE_HEAD)
        for line in cells:
            table.add_row(*(Text(cell) for cell in line))
        Console(file=stream).print(table)
        return
    widths = [max(map(len, column)) for column in zip(columns, *cells, strict=True)]
    for line in (columns, *cells):
        padded = (cell.ljust(width) for cell, width in zip(line, widths, strict=True))
        print("  " + "  ".join(padded).rstrip(), file=stream)


def _shown(value: Any) -> str:
    if value is None or value == []:
        return "-"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, float):
        return f"{value:g}"
    if isinstance(value, Mapping):
        return "; ".join(f"{name} {_shown(item)}" for name, item in value.items())
    if isinstance(value, list | tuple):
        return " ".join(map(_shown, value))
    return " ".join(str(value).split())
