"""Estimate the spectral light of a captured place.

Reads:  ``capture.usda`` (``CaptureAPI``) with its panorama, and ``camera.usda``
        (``SpectralCameraAPI`` with a ``SpectralRecoveryAPI`` for each class of light).
Writes: ``light.usda``, a DomeLight with ``SpectralLightAPI``, and its pictures beside it.

The basis form needs no spectrum of any texel: coefficients are the panorama's own channels.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from usdskin.errors import LayerError, UsageError
from usdskin.estimate.light.agreement import check_agreement
from usdskin.estimate.light.captured import Mixture, captured_map, find_mixture
from usdskin.estimate.light.layer import Background
from usdskin.estimate.light.light_map import LightMap
from usdskin.estimate.light.maps import Form, map_files
from usdskin.estimate.light.publish import Clock, LightResult, publish_light
from usdskin.estimate.light.scale import LightScale, find_scale, readings_of
from usdskin.estimate.light.totals import add_up, check_totals
from usdskin.layers import check_output, open_stage, used_files
from usdskin.notes import Note
from usdskin.prims import (
    CapturedPanorama,
    SpectralCamera,
    read_captured_panorama,
    read_spectral_camera,
)
from usdskin.progress import Progress, SilentProgress


@dataclass(frozen=True, slots=True)
class LightOptions:
    """What the step is told."""

    light_class: str | None = None
    """The only class of light in the place; None: all that the camera was calibrated for."""

    class_map: Path | None = None
    """Picture that says which class lights which direction; None: estimated."""

    class_captures: tuple[tuple[str, Path], ...] = ()
    """Captures of the same place, from the same tripod, with one class of light alone: names and
    layers. One class may have none: its light is what the others leave."""

    form: Form = "basis"
    """``basis``, or ``bands`` for a map with all spectra written out."""


def estimate_light(
    capture: str | Path,
    camera: str | Path,
    output: str | Path,
    options: LightOptions | None = None,
    progress: Progress | None = None,
) -> LightResult:
    """Write the spectral light of one capture.

    Args:
        capture: Layer written by the capture step. It is read, never changed.
        camera: Layer written by the calibration. It is read, never changed.
        output: Layer to write; its pictures are written beside it.
        options: What is asked for.
        progress: Told how far the work is.

    Returns:
        The files, complete on disk, the report and the notes.

    Raises:
        LayerError: A layer lacks something, or capture and calibration do not fit each other.
        ImageError: A picture cannot be read or written.
        UsageError: An option does not fit the calibration, or an output is an input.
    """
    options = options or LightOptions()
    progress = progress or SilentProgress()
    output, clock, notes = Path(output), Clock(), list[Note]()
    stages = open_stage(capture, notes), open_stage(camera, notes)
    captured, calibrated = read_captured_panorama(stages[0]), read_spectral_camera(stages[1])
    readings = readings_of(captured)
    is_read = readings.spot is not None or readings.facing is not None
    check_agreement(captured, calibrated, is_read, notes)
    alone, used = _read_alone(options, calibrated, notes)
    inputs = [*used_files(stages[0]), *used_files(stages[1]), captured.panorama_file, *used]
    inputs += [path for path in (captured.stddev_file, options.class_map) if path is not None]
    is_mixed = options.light_class is None and len(calibrated.recoveries) > 1
    files = map_files(output, options.form, is_mixed)
    check_output(output, inputs, files.paths(), step="estimate")
    with clock("classes"):
        mixture = find_mixture(
            captured, calibrated, options.light_class, options.class_map, alone, notes
        )
    is_absolute = is_read or calibrated.units == "absolute"
    darkened: dict[int, int] = {}
    unscaled = captured_map(captured, calibrated, mixture, is_absolute, darkened)
    with clock("measure"):
        totals = add_up(unscaled, readings, progress)
    check_totals(totals, unscaled, captured.where, notes)
    _note_darkened(captured.where, sum(darkened.values()), unscaled, notes)
    scale = find_scale(captured, totals, unscaled.xyz[:, 1], calibrated.units == "absolute", notes)
    background = Background(
        origin="measured",
        documentation=_documentation(calibrated, mixture, scale),
        inputs=inputs,
        settings=_settings(options),
        up_axis=captured.up_axis,
        recoveries=mixture.recoveries,
        weights=mixture.weights,
        scale=scale,
        clipped_share=captured.clipped_share,
    )
    light = replace(unscaled, basis=unscaled.basis * scale.factor)
    paths, report = publish_light(
        light, totals, background, options.form, files, output, progress, clock
    )
    return LightResult(paths, report, notes, clock.seconds)


def _read_alone(
    options: LightOptions, camera: SpectralCamera, notes: list[Note]
) -> tuple[dict[str, CapturedPanorama], list[Path]]:
    """Return the captures of single classes, and the files they are made of."""
    alone: dict[str, CapturedPanorama] = {}
    used: list[Path] = []
    for name, layer in options.class_captures:
        if name in alone:
            raise UsageError(f"--class-capture {name}: given twice; keep one of them")
        try:
            stage = open_stage(layer, notes)
            alone[name] = read_captured_panorama(stage)
            # Only its share of the whole counts, so a reading need not set its scale.
            check_agreement(alone[name], camera, True, notes)
        except LayerError as error:  # captures tend to have the same file name
            raise LayerError(f"--class-capture {name}: {error}") from error
        used += [*used_files(stage), alone[name].panorama_file]
    return alone, used


def _note_darkened(where: str, count: int, light: LightMap, notes: list[Note]) -> None:
    if count:
        notes.append(
            Note(
                "texels-darkened",
                where,
                f"the camera values of {count} of {light.height * light.width} texels are those of "
                "no light in this calibration; they were made black",
            )
        )


def _documentation(camera: SpectralCamera, mixture: Mixture, scale: LightScale) -> str:
    estimators = ", ".join(sorted({recovery.estimator for recovery in mixture.recoveries}))
    text = (
        f"Spectral light of a captured place, recovered ({estimators}) from camera values by a "
        f"calibration of {camera.model or 'the camera'}. Lamps: {', '.join(mixture.names)}."
    )
    if scale.source == "both":
        text += " Scaled to readings of luminance and illuminance."
    elif scale.source != "calibration":
        text += f" Scaled to a reading of {scale.source}."
    return text


def _settings(options: LightOptions) -> dict[str, Any]:
    given = {
        "class": options.light_class,
        "classMap": None if options.class_map is None else options.class_map.name,
        "classCaptures": " ".join(f"{name}={path.name}" for name, path in options.class_captures)
        or None,
        "as": options.form,
    }
    return {name: value for name, value in given.items() if value is not None}
