"""``estimate``: what the light and the skin are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from usdskin.commands.options import StepCommand, with_paragraph_marks
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import UsageError

_PATH = click.Path(path_type=Path)

_HELP = r"""Estimate spectra from what was captured.

\b
Example:
    usdskin estimate light capture.usda --camera camera.usda -o light.usda
"""


def _white(value: str) -> tuple[float, ...] | str:
    """Return an RGB color, or ``mean``."""
    if value == "mean":
        return value
    try:
        numbers = tuple(float(part) for part in value.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) != 3 or not all(0.0 < number < float("inf") for number in numbers):
        raise click.BadParameter(f"{value!r} is neither mean nor R,G,B with numbers above 0.")
    return numbers


@click.group("estimate", help=with_paragraph_marks(_HELP))
def estimate() -> None:
    """Hold the commands that estimate spectra."""


@estimate.command("light", cls=StepCommand)
@click.argument("source", metavar="CAPTURE.usda|ENV.hdr", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="LIGHT.usda", help="To write.")
@click.option("--camera", type=_PATH, metavar="CAMERA.usda", help="Calibration of the camera.")
@click.option(
    "--class",
    "light_class",
    metavar="NAME",
    help="Take all light for that of one class of CAMERA.  [default: the only one, or a class map]",
)
@click.option(
    "--class-map",
    type=_PATH,
    metavar="FILE",
    help="Which class of lamp lights what: an image.  [default: estimated]",
)
@click.option(
    "--as",
    "form",
    type=click.Choice(["basis", "bands"]),
    default="basis",
    show_default=True,
    help="Three coefficients per class and their spectra, or an image of every band.",
)
@click.option(
    "--illuminant",
    metavar="NAME|FILE",
    help="Assign a lamp to an ordinary picture: FL2, A, D55, 3200K or a file.",
)
@click.option(
    "--white",
    type=_white,
    metavar="R,G,B|mean",
    help="Color of the picture that is the assigned lamp's white.  [default: 1,1,1]",
)
@click.option(
    "--bad-pixels",
    type=click.Choice(["error", "clamp"]),
    default="error",
    show_default=True,
    help="Refuse or clamp pixels of a picture that are no light.",
)
@click.option(
    "--plot", type=_PATH, metavar="FIGURE", help="Draw the light: SVG, PDF or PNG (matplotlib)."
)
@click.pass_obj
def light(
    options: GlobalOptions, /, source: Path, output: Path, plot: Path | None, **given: Any
) -> None:
    r"""Make a spectral DomeLight of a capture, or of an ordinary panorama.

    With --camera the spectrum of every direction is recovered from camera values. Without, a lamp
    is assigned by --illuminant, and the layer says that it is an assumption. Beside LIGHT.usda are
    its coefficients and an RGB picture for other tools.

    \b
    Examples:
        usdskin estimate light capture.usda --camera camera.usda -o light.usda
        usdskin estimate light studio.hdr --illuminant FL2 -o light.usda
    """
    with Reporter(options) as reporter:
        result = _estimate(reporter, source, output, given)
        reporter.notes(result.notes)
        reporter.seconds(result.seconds)
        reporter.event("light", **result.report.as_dict())
        if not reporter.json and not reporter.quiet:
            for line in result.report.lines():
                click.echo(line, err=True)
        reporter.wrote(result.paths)
        if plot is not None:
            from usdskin.notes import Note
            from usdskin.plots.step import plot_file

            drawn: list[Note] = []
            written = plot_file(output, plot, notes=drawn)
            reporter.notes(drawn)
            reporter.wrote([written])


def _estimate(reporter: Reporter, source: Path, output: Path, given: dict[str, Any]) -> Any:
    assigned = ("illuminant", "white")
    measured = ("light_class", "class_map")
    if given["camera"] is None:
        if given["illuminant"] is None:
            raise UsageError(
                "give --camera CAMERA.usda for a capture, or --illuminant NAME for a picture whose "
                "camera is not known"
            )
        _refuse(given, measured, "--camera, which is not given")
        from usdskin.estimate.light.assigned import AssignOptions, assign_light

        names = ("illuminant", "white", "form", "bad_pixels")
        chosen = AssignOptions(**{name: given[name] for name in names})
        return assign_light(source, output, chosen, reporter.progress())
    _refuse(given, assigned, "pictures without --camera")
    from usdskin.estimate.light.step import LightOptions, estimate_light

    picked = LightOptions(**{name: given[name] for name in (*measured, "form")})
    return estimate_light(source, given["camera"], output, picked, reporter.progress())


def _refuse(given: dict[str, Any], names: tuple[str, ...], belongs_to: str) -> None:
    for name in names:
        if given[name] is not None:
            flag = {"light_class": "class"}.get(name, name.replace("_", "-"))
            raise UsageError(f"--{flag} belongs to {belongs_to}; leave it out")


COMMANDS: tuple[click.Command, ...] = (estimate,)
