"""What a capture leaves: the panorama, its noise, a picture of its quality, and the layer.

Writes: ``capture.usda``, which stands alone beside its pictures. Its prims::

    /Capture              CaptureAPI: results, readings and the settings of the camera
    /Capture/environment  DomeLight of the panorama, for any tool
    /Capture/views/<name> Camera with FisheyeCameraAPI, turned as it was used
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin import __version__
from usdskin.capture.quality.measure import Measured, PlacedView
from usdskin.capture.quality.picture import quality_picture
from usdskin.capture.views.panorama import Panorama, footprint
from usdskin.images import Part, write_exr, write_png
from usdskin.latlong import latlong_from_world
from usdskin.layers import record_provenance, reload_open_copy, write_layer
from usdskin.prims import Shoot, write_lens, write_rotation
from usdskin.prims.writing import write_schema
from usdskin.replacing import replace_all

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdLux, Vt

_FOOTPRINT_ROWS = 1024


@dataclass(frozen=True, slots=True, eq=False)
class Publication:
    """What is to be written."""

    shoot: Shoot
    """The shoot it was made of."""

    placed: Sequence[PlacedView]
    """Its views."""

    rotations: NDArray[np.float64]
    """Rotations from the cameras to the panorama, as used, shape [views, 3, 3]."""

    panorama: Panorama
    """What was composed, in camera values."""

    measured: Measured
    """The same on its scale."""

    inputs: Sequence[Path]
    """Layers the capture was made from."""

    settings: Mapping[str, Any]
    """What the step was told."""


def output_files(output: Path) -> tuple[Path, Path, Path]:
    """Return the names of panorama, standard deviation and quality picture of a layer.

    ``capture.usda`` has ``panorama.exr`` beside it; the files of any other layer begin with its
    name, so that two captures can share a folder.
    """
    begin = "" if output.stem == "capture" else f"{output.stem}."
    folder = output.parent
    return (
        folder / f"{begin}panorama.exr",
        folder / f"{begin}stddev.exr",
        folder / f"{begin}quality.png",
    )


def publish(publication: Publication, output: Path, scratch: Path) -> tuple[Path, ...]:
    """Write the layer and its pictures; they appear together, when all are complete.

    Args:
        publication: What to write.
        output: The layer.
        scratch: Folder on the same file system, for what is not complete.

    Returns:
        The files, the layer first.

    Raises:
        LayerError: The layer cannot be written.
        ImageError: A picture cannot be written.
    """
    panorama, stddev, quality = output_files(output)
    _write_panorama(publication, scratch / panorama.name)
    _write_stddev(publication, scratch / stddev.name)
    write_png(scratch / quality.name, _picture(publication), {"Software": f"usdskin {__version__}"})
    stage = _layer(publication, output.parent, panorama.name, stddev.name)
    write_layer(stage, scratch / output.name)
    written = (output, panorama, stddev, quality)
    replace_all(scratch, written)
    reload_open_copy(output)
    return written


def _header(publication: Publication) -> dict[str, Any]:
    scale = publication.measured.report.scale
    return {
        "usdskin/version": __version__,
        "usdskin/units": scale.units,
        "usdskin/scale": scale.factor,
        "software": f"usdskin {__version__}",
    }


def _write_panorama(publication: Publication, path: Path) -> None:
    # A camera's primaries are no color space that has a name.
    part = Part("", {"": publication.measured.values}, _header(publication), "float", "unknown")
    write_exr(path, [part])


def _write_stddev(publication: Publication, path: Path) -> None:
    panorama = publication.panorama
    header = _header(publication)
    write_exr(
        path,
        [
            Part("stddev", {"": publication.measured.stddev}, header, "float", "unknown"),
            Part(
                "quality",
                {"seen": panorama.seen, "clipped": panorama.clipped, "moved": panorama.moved},
                header,
                "half",
            ),
        ],
    )


def _picture(publication: Publication) -> NDArray[np.uint8]:
    panorama, shoot = publication.panorama, publication.shoot
    report = publication.measured.report
    return quality_picture(
        publication.measured.values,
        panorama.clipped,
        panorama.seen,
        panorama.moved,
        shoot.luminance_weights,
        footprints={
            item.view.name: footprint(item.lens, rotation, _FOOTPRINT_ROWS)
            for item, rotation in zip(publication.placed, publication.rotations, strict=True)
        },
        lamps=publication.measured.lamps,
        title=shoot.session or shoot.name,
        subtitle=f"{report.image_count} photographs, {report.width} x {report.height}",
        up_axis=shoot.up_axis,
    )


# --- The layer ---------------------------------------------------------------------------------


def _layer(publication: Publication, folder: Path, panorama: str, stddev: str) -> Usd.Stage:
    shoot = publication.shoot
    stage = Usd.Stage.CreateInMemory("capture.usda")
    UsdGeom.SetStageUpAxis(stage, shoot.up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    root = UsdGeom.Xform.Define(stage, "/Capture").GetPrim()
    stage.SetDefaultPrim(root)
    results = {
        "capture:panorama:file": Path(panorama),
        "capture:stddev:file": Path(stddev),
        **publication.measured.report.attributes(),
    }
    directions = results.pop("capture:lamps:directions")
    results["capture:lamps:directions"] = Vt.Vec3dArray([_vector(row) for row in directions])
    write_schema(root, "CaptureAPI", _description(shoot) | results)
    _write_dome(stage, shoot.up_axis, panorama)
    UsdGeom.Xform.Define(stage, "/Capture/views")
    turn, paths = latlong_from_world(shoot.up_axis).T, []
    for item, rotation in zip(publication.placed, publication.rotations, strict=True):
        camera = UsdGeom.Camera.Define(stage, f"/Capture/views/{item.view.name}").GetPrim()
        write_lens(camera, item.lens)
        write_rotation(camera, turn @ rotation)
        paths.append(camera.GetPath())
    root.GetRelationship("capture:views").SetTargets(paths)
    record_provenance(stage, "capture", publication.inputs, publication.settings, folder)
    return stage


def _description(shoot: Shoot) -> dict[str, Any]:
    """Return what the shoot says about itself, its directions in the layer's world."""
    return {
        "capture:session": shoot.session or None,
        "capture:device": shoot.device or None,
        "capture:time": shoot.time or None,
        "capture:settings:model": shoot.model,
        "capture:settings:lens": shoot.lens,
        "capture:settings:whiteBalance": shoot.white_balance,
        "capture:settings:iso": shoot.iso,
        "capture:illuminance": shoot.illuminance_lx or None,
        "capture:illuminance:direction": _vector(shoot.illuminance_direction),
        "capture:luminance": shoot.luminance or None,
        "capture:luminance:direction": _vector(shoot.luminance_direction),
        "capture:luminanceWeights": _vector(shoot.luminance_weights),
    }


def _vector(direction: NDArray[np.float64] | None) -> Gf.Vec3d | None:
    return None if direction is None else Gf.Vec3d(*(float(number) for number in direction))


def _write_dome(stage: Usd.Stage, up_axis: str, panorama: str) -> None:
    dome = UsdLux.DomeLight.Define(stage, "/Capture/environment")
    dome.CreateTextureFileAttr(f"./{panorama}")
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    if up_axis == "Z":
        # A latlong map's pole is the light's +Y.
        UsdGeom.Xformable(dome).AddRotateXOp().Set(90.0)
