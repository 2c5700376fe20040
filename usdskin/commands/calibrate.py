"""``calibrate``: what the instruments do to the light."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from usdskin.commands.drawing import check_plot, draw_plot
from usdskin.commands.options import StepCommand, StepGroup, names, with_paragraph_marks
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import UsageError

_PATH = click.Path(path_type=Path)

_HELP = r"""Measure camera and lens.

\b
Example:
    usdskin calibrate lens board/*.png --board charuco:7x5 -o lens.usda
    usdskin calibrate camera chart.usda -o camera.usda
"""


def _size(value: str) -> tuple[int, int]:
    """Return width and height [px] of ``WIDTHxHEIGHT``."""
    match = re.fullmatch(r"([1-9]\d{0,5})x([1-9]\d{0,5})", value)
    if match is None:
        raise click.BadParameter(f"{value!r} is no size such as 6000x4000.")
    return int(match[1]), int(match[2])


@click.group("calibrate", cls=StepGroup, help=with_paragraph_marks(_HELP))
def calibrate() -> None:
    """Hold the commands that measure instruments."""


@calibrate.command("lens", cls=StepCommand)
@click.argument("images", metavar="[IMG]...", type=_PATH, nargs=-1)
@click.option("-o", "--output", type=_PATH, required=True, metavar="LENS.usda", help="To write.")
@click.option(
    "--board",
    metavar="BOARD",
    help="What is in the photographs: charuco:7x5[,SQUARE,MARKER][,DICTIONARY] counts squares, "
    "chessboard:9x6 inner corners.",
)
@click.option(
    "--model",
    type=click.Choice(["fisheye", "omnidir"]),
    help="OpenCV's model to fit, or that of FILE.  [default: fisheye, or what FILE says]",
)
@click.option(
    "--max-angle",
    "max_angle_deg",
    type=float,
    metavar="DEG",
    help="Largest angle from the axis that holds picture.  [default: as far as the board was seen]",
)
@click.option("--plot", type=_PATH, metavar="PNG", help="Draw what the fit left over (matplotlib).")
@click.option(
    "--from",
    "source",
    type=_PATH,
    metavar="FILE",
    help="Take the lens from a file instead: OpenCV's, Hugin's .pto or Lensfun's .xml.",
)
@click.option("--lens", metavar="NAME", help="Lens in FILE: part of its name, or a .pto's image.")
@click.option(
    "--resolution", type=_size, metavar="WxH", help="Size of the pictures where FILE says none."
)
@click.option(
    "--crop-factor",
    type=click.FloatRange(0.1, 100.0),
    metavar="C",
    help="The camera's, for Lensfun.  [default: that of the calibration]",
)
@click.option(
    "--focal-length",
    "focal_length_mm",
    type=click.FloatRange(0.1, 10000.0),
    metavar="MM",
    help="As engraved, for a zoom of Lensfun's.",
)
@click.option(
    "--f-number",
    type=click.FloatRange(0.1, 1000.0),
    metavar="N",
    help="Take Lensfun's vignetting at this f-number too.",
)
@click.pass_obj
def lens(
    options: GlobalOptions,
    /,
    images: tuple[Path, ...],
    output: Path,
    source: Path | None,
    **given: Any,
) -> None:
    r"""Measure a fisheye lens from photographs of a board, or take it over from a file.

    LENS.usda holds one Camera to be referenced by the views of a shoot. Beyond the largest angle
    at which the board was seen nothing is known of the lens; photograph it up to the edge.

    \b
    Examples:
        usdskin calibrate lens board/*.jpg --board charuco:7x5 -o lens.usda --plot lens.png
        usdskin calibrate lens --from project.pto -o lens.usda
    """
    with Reporter(options) as reporter:
        if source is not None:
            _import(reporter, images, output, source, given)
        else:
            _calibrate(reporter, images, output, given)


def _calibrate(
    reporter: Reporter, images: tuple[Path, ...], output: Path, given: dict[str, Any]
) -> None:
    for name in ("lens", "resolution", "crop_factor", "focal_length_mm", "f_number"):
        if given[name] is not None:
            flag = name.removesuffix("_mm").replace("_", "-")
            raise UsageError(f"--{flag} belongs to --from FILE; leave it out")
    if not images or given["board"] is None:
        raise UsageError("give photographs and their --board, or a file with --from")
    from usdskin.capture.lens.calibrate import calibrate_lens
    from usdskin.notes import Note

    notes: list[Note] = []
    report = calibrate_lens(
        images,
        output,
        board=given["board"],
        model=given["model"] or "fisheye",
        max_angle_deg=given["max_angle_deg"],
        plot=given["plot"],
        progress=reporter.progress(),
        notes=notes,
    )
    reporter.notes(notes)
    reporter.event("calibration", **report.as_dict())
    if not reporter.json and not reporter.quiet:
        for line in report.lines():
            click.echo(line, err=True)
    reporter.wrote([report.path, *([given["plot"]] if given["plot"] else [])])


def _import(
    reporter: Reporter,
    images: tuple[Path, ...],
    output: Path,
    source: Path,
    given: dict[str, Any],
) -> None:
    for name, value in (
        ("photographs", images),
        ("--board", given["board"]),
        ("--plot", given["plot"]),
    ):
        if value:
            raise UsageError(f"{name}: no use together with --from; leave one of them out")
    from usdskin.capture.lens.calibrate import import_lens
    from usdskin.capture.lens.files import ImportOptions
    from usdskin.capture.lens.lensfun import LensfunChoice
    from usdskin.notes import Note

    choice = LensfunChoice(
        lens=given["lens"],
        resolution=given["resolution"],
        crop_factor=given["crop_factor"],
        focal_length_mm=given["focal_length_mm"],
        f_number=given["f_number"],
    )
    notes: list[Note] = []
    written = import_lens(
        source, output, ImportOptions(given["max_angle_deg"], given["model"], choice), notes=notes
    )
    reporter.notes(notes)
    reporter.wrote([written])


def _corners(value: str) -> tuple[float, ...]:
    """Return the eight numbers of four corners [px]."""
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 8 or not all(abs(number) < 1e6 for number in numbers):
        raise click.BadParameter(f"{value!r} is not x,y of four corners, such as 10,10,90,10,...")
    return numbers


@calibrate.command("camera", cls=StepCommand)
@click.argument("charts", metavar="CHART.usda...", type=_PATH, nargs=-1, required=True)
@click.option("-o", "--output", type=_PATH, required=True, metavar="CAMERA.usda", help="To write.")
@click.option(
    "--estimator",
    type=click.Choice(["regression", "literal", "tsvd", "pca", "wiener", "smooth"]),
    default="regression",
    show_default=True,
    help="How camera values become spectra; literal is the paper's formula as printed.",
)
@click.option(
    "--corners",
    type=_corners,
    metavar="X,Y,X,Y,X,Y,X,Y",
    help="Corners of the patches in the picture [px]: top left, top right, bottom right, bottom "
    "left.  [default: chart:corners, or found in the picture]",
)
@click.option(
    "--exclude",
    "excluded",
    type=names,
    metavar="PATCH,...",
    help="Patches to leave out.",
)
@click.option(
    "--plot",
    type=_PATH,
    metavar="FIGURE",
    help="Draw the calibration: SVG, PDF or PNG (matplotlib).",
)
@click.pass_obj
def camera(
    options: GlobalOptions,
    /,
    charts: tuple[Path, ...],
    output: Path,
    plot: Path | None,
    corners: tuple[float, ...] | None,
    excluded: tuple[str, ...] | None,
    estimator: str,
) -> None:
    r"""Calibrate a camera against the spectra of a color chart.

    CHART.usda holds camera values or a photograph of the patches (ColorChartAPI), and their
    radiance from a spectrophotometer, or reflectances and the lamp. Give one chart for each kind of
    lamp the scene has. CAMERA.usda stands alone: it is all that `usdskin estimate light` needs.

    \b
    Examples:
        usdskin calibrate camera chart.usda -o camera.usda --plot camera.svg
        usdskin calibrate camera tubes.usda window.usda -o camera.usda
    """
    with Reporter(options) as reporter:
        import numpy as np

        check_plot(plot, output, [*charts])

        from usdskin.estimate.camera.report import report_of
        from usdskin.estimate.camera.step import CalibrationOptions, calibrate_camera

        result = calibrate_camera(
            charts,
            output,
            CalibrationOptions(
                estimator=estimator,
                excluded=excluded or (),
                corners=None if corners is None else np.reshape(corners, (4, 2)),
                device=options.device,
                threads=options.threads,
            ),
            reporter.progress(),
        )
        reporter.result("calibration", result, report_of(result))
        reporter.wrote([result.path])
        draw_plot(reporter, plot, result.path)


COMMANDS: tuple[click.Command, ...] = (calibrate,)
