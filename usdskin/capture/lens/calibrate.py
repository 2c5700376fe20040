"""The lens step: photographs of a board, or a file of another program, become a lens.

Reads:  photographs, or a calibration of OpenCV's, Hugin's or Lensfun's.
Writes: ``lens.usda``, a Camera with ``FisheyeCameraAPI`` that stands alone, and a plot of what
        the fit left over.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, Vt

from usdskin.capture.lens.board import BoardView, find_board, parse_board
from usdskin.capture.lens.curve import fit_polynomial
from usdskin.capture.lens.files import ImportOptions, read_lens_file
from usdskin.capture.lens.fit import LEAST_VIEWS, Calibration, fit_lens
from usdskin.capture.lens.models import MODELS
from usdskin.capture.lens.plot import write_plot
from usdskin.errors import ImageError, UsageError
from usdskin.fisheye import check_lens
from usdskin.layers import SettingValue, check_output, record_provenance, write_layer
from usdskin.notes import Note
from usdskin.prims import FisheyeLens, write_lens
from usdskin.progress import Progress, SilentProgress
from usdskin.schemas import ensure_registered

_STEP = "calibrateLens"
_NAMES_SHOWN = 6


@dataclass(frozen=True, slots=True, eq=False)
class LensReport:
    """What a calibration from photographs found."""

    path: Path
    """The layer that was written."""

    lens: FisheyeLens
    """The lens in it."""

    calibration: Calibration
    """The fit it comes from."""

    def lines(self) -> list[str]:
        """Return it in words."""
        fit, lens = self.calibration, self.lens
        covered = fit.covered_deg
        first = (
            f"{fit.corner_count} corners in {len(fit.views)} photographs, rms {fit.rms_px:.3f} px"
        )
        if fit.dropped_corners:
            first += f"; corners left out: {fit.dropped_corners}"
        center = ", ".join(f"{value:.2f}" for value in lens.center_px)
        distortion = ", ".join(f"{value:.5f}" for value in lens.distortion)
        return [
            first,
            f"f {lens.focal_length_px:.2f} px, center ({center}) px, k {distortion}",
            f"the board was seen up to {covered:.2f} deg, where directions are known to "
            f"{fit.direction_sigma_deg(covered):.2g} deg",
            f"fisheye:maxAngle {lens.max_angle_deg:g} deg",
        ]

    def as_dict(self) -> dict[str, Any]:
        """Return it as plain values; lengths in px, angles in deg."""
        fit, covered = self.calibration, self.calibration.covered_deg
        return {
            "rms": fit.rms_px,
            "corners": fit.corner_count,
            "droppedCorners": fit.dropped_corners,
            "images": [view.path.name for view in fit.views],
            "imageRms": fit.view_rms_px.tolist(),
            "rejectedImages": [view.path.name for view in fit.rejected],
            "coveredAngle": covered,
            "centerSigma": fit.center_sigma_px,
            "radiusSigmaAtMaxAngle": fit.radius_sigma_px(self.lens.max_angle_deg),
            "directionSigmaAtCoveredAngle": fit.direction_sigma_deg(covered),
        }


def calibrate_lens(
    images: Sequence[str | Path],
    output: str | Path,
    *,
    board: str,
    model: str = "fisheye",
    max_angle_deg: float | None = None,
    plot: str | Path | None = None,
    progress: Progress | None = None,
    notes: list[Note] | None = None,
) -> LensReport:
    """Write the lens that photographs of a board show.

    Args:
        images: Photographs of one size, taken with one lens at one focus.
        output: Layer to write.
        board: What is in them, such as ``charuco:7x5``; see ``parse_board``.
        model: ``fisheye``, or ``omnidir``, to which k1 .. k4 are then fitted.
        max_angle_deg: Largest angle from the axis that holds picture [deg]; by default as far as
            the board was seen, for beyond it nothing is known.
        plot: PNG of the residuals to write.
        progress: Is told of every photograph.
        notes: Takes photographs without board, or left out, and what else the result suffers from.

    Returns:
        What was found, once ``output`` is complete on disk.

    Raises:
        UsageError: An option is wrong.
        ImageError: A photograph cannot be read, or together they do not determine a lens.
        LayerError: The lens does not hold up to its largest angle, or cannot be written.
        UsdSkinError: matplotlib is needed and not installed.
    """
    paths, output = [Path(image) for image in images], Path(output)
    notes = notes if notes is not None else []
    if model not in MODELS:
        raise UsageError(f"--model {model}: choose one of {', '.join(MODELS)}")
    _check_names(output, paths, plot, max_angle_deg)
    views = _find_boards(paths, board, progress or SilentProgress(), notes)
    calibration = fit_lens(views, model, notes)
    lens = _lens_of(calibration, max_angle_deg, str(output), notes)
    if plot is not None:
        write_plot(calibration, lens, Path(plot))
    settings: dict[str, SettingValue] = {"board": board, "model": model}
    if max_angle_deg is not None:
        settings["maxAngle"] = max_angle_deg
    report = LensReport(output, lens, calibration)
    _write(lens, output, paths, settings, report.as_dict())
    return report


def import_lens(
    source: str | Path,
    output: str | Path,
    options: ImportOptions | None = None,
    *,
    notes: list[Note] | None = None,
) -> Path:
    """Write the lens that a file of another program describes.

    Args:
        source: File of OpenCV's, Hugin's or Lensfun's. It is read, never changed.
        output: Layer to write.
        options: What the file leaves open.
        notes: Takes what was assumed or left out, and how far the result is from the file.

    Returns:
        ``output``, once it is complete on disk.

    Raises:
        UsageError: An option is missing, wrong or without effect.
        UsdSkinError: The file cannot be read, or its lens cannot be held.
        LayerError: The lens does not hold up to its largest angle, or cannot be written.
    """
    source, output = Path(source), Path(output)
    options = options if options is not None else ImportOptions()
    _check_names(output, [source], None, options.max_angle_deg)
    lens = read_lens_file(source, options, notes if notes is not None else [])
    choice = options.choice
    given = {
        "cropFactor": choice.crop_factor,
        "fNumber": choice.f_number,
        "focalLength": choice.focal_length_mm,
        "lens": choice.lens,
        "maxAngle": options.max_angle_deg,
        "model": options.model,
        "resolution": choice.resolution,
    }
    settings: dict[str, SettingValue] = {
        name: value for name, value in given.items() if value is not None
    }
    _write(lens, output, [source], settings, {})
    return output


def _check_names(
    output: Path, inputs: Sequence[Path], plot: str | Path | None, max_angle_deg: float | None
) -> None:
    """Refuse what can be refused before anything is read."""
    if plot is not None and Path(plot).suffix.lower() != ".png":
        raise UsageError(f"--plot {plot}: a plot is a PNG; end its name in .png")
    check_output(output, inputs, [] if plot is None else [Path(plot)], step="calibration")
    if max_angle_deg is not None and not 0.0 < max_angle_deg <= 180.0:
        raise UsageError(f"--max-angle {max_angle_deg:g}: give an angle above 0, at most 180 deg")


def _find_boards(
    paths: Sequence[Path], board: str, progress: Progress, notes: list[Note]
) -> list[BoardView]:
    pattern = parse_board(board)
    twice = next((path for index, path in enumerate(paths) if path in paths[:index]), None)
    if twice is not None:
        raise UsageError(f"{twice}: is given twice; leave one out")
    progress.start(len(paths), "boards")
    views = []
    for path in paths:
        views.append(find_board(path, pattern))
        progress.advance()
    progress.done()
    other = next((view for view in views if view.resolution != views[0].resolution), None)
    if other is not None:
        sizes = [f"{view.resolution[0]} x {view.resolution[1]}" for view in (views[0], other)]
        raise ImageError(
            f"{other.path}: has {sizes[1]} pixels and {views[0].path} {sizes[0]}; use photographs "
            "of one camera, uncropped and not turned"
        )
    usable = [view for view in views if view.is_usable]
    missing = [view.path for view in views if not view.is_usable]
    if len(usable) < LEAST_VIEWS:
        listed = ", ".join(path.name for path in missing[:_NAMES_SHOWN])
        listed += f" and {len(missing) - _NAMES_SHOWN} more" * (len(missing) > _NAMES_SHOWN)
        raise ImageError(
            f"{paths[0].parent}: the board {board} was found in {len(usable)} of {len(paths)} "
            f"photographs"
            + f" (not in {listed})"
            * bool(missing)
            + f", and {LEAST_VIEWS} at least "
            "are needed, better 20; check columns, rows and dictionary, focus and light"
        )
    for path in missing:
        notes.append(Note("board-not-found", str(path), "shows no board, or too little; not used"))
    return usable


def _lens_of(
    calibration: Calibration, max_angle_deg: float | None, where: str, notes: list[Note]
) -> FisheyeLens:
    solution, covered = calibration.solution, calibration.covered_deg
    angle_deg = math.floor(covered * 100.0) / 100.0 if max_angle_deg is None else max_angle_deg
    if angle_deg > covered:
        message = (
            f"fisheye:maxAngle is {angle_deg:g} deg and the board was seen up to {covered:.2f} "
            f"deg: there image heights are uncertain by "
            f"{calibration.radius_sigma_px(angle_deg):.2g} px; photograph the board nearer to the "
            "edge"
        )
        notes.append(Note("beyond-the-board", where, message))
    f, distortion = float(solution.parameters[0]), solution.parameters[1:]
    if solution.model.name != "fisheye":
        f, distortion, off = fit_polynomial(
            lambda angle: solution.model.radius(solution.parameters, angle),
            float(np.deg2rad(angle_deg)),
        )
        message = f"k1 .. k4 follow the {solution.model.name} model to {off:.2g} px"
        notes.append(Note("lens-fitted", where, message))
    lens = FisheyeLens(
        projection="opencv",
        focal_length_px=f,
        center_px=solution.center_px,
        resolution=calibration.resolution,
        distortion=distortion,
        max_angle_deg=angle_deg,
    )
    check_lens(lens, where)
    return lens


def _write(
    lens: FisheyeLens,
    output: Path,
    inputs: Sequence[Path],
    settings: dict[str, SettingValue],
    record: dict[str, Any],
) -> None:
    ensure_registered()
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = UsdGeom.Camera.Define(stage, "/Lens").GetPrim()
    stage.SetDefaultPrim(prim)
    write_lens(prim, lens)
    for name, value in record.items():
        if isinstance(value, list):
            is_text = all(isinstance(item, str) for item in value)
            value = Vt.StringArray(value) if is_text else Vt.DoubleArray(value)
        prim.SetCustomDataByKey(f"usdskin:calibration:{name}", value)
    record_provenance(stage, _STEP, inputs, settings, output.parent)
    write_layer(stage, output)
