"""``estimate``: what the light and the skin are."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from usdskin.commands.drawing import check_plot, draw_plot
from usdskin.commands.options import StepCommand, StepGroup, with_paragraph_marks
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import UsageError

_PATH = click.Path(path_type=Path)
_LAYER_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")

_HELP = r"""Estimate spectra from what was captured.

\b
Example:
    usdskin estimate light capture.usda --camera camera.usda -o light.usda
    usdskin estimate skin samples.usda -o skin.usda
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


def _named_path(value: str) -> tuple[str, Path]:
    """Read NAME=FILE."""
    name, equals, file = value.partition("=")
    if not (name and equals and file):
        raise click.BadParameter(f"{value!r} is not NAME=CAPTURE.usda, such as tubes=tubes.usda.")
    return name, Path(file)


@click.group("estimate", cls=StepGroup, help=with_paragraph_marks(_HELP))
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
    "--class-capture",
    "class_captures",
    type=_named_path,
    multiple=True,
    metavar="NAME=CAPTURE.usda",
    help="The same place with this class of lamps alone, for all classes or all but one.",
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
        usdskin estimate light all.usda --camera camera.usda -o light.usda \
            --class-capture tubes=tubes.usda --class-capture window=window.usda
        usdskin estimate light studio.hdr --illuminant FL2 -o light.usda
    """
    with Reporter(options) as reporter:
        captures = [path for _, path in given["class_captures"]]
        check_plot(plot, output, [source, given["camera"], given["class_map"], *captures])
        result = _estimate(reporter, source, output, given)
        reporter.result("light", result, result.report)
        reporter.wrote(result.paths)
        draw_plot(reporter, plot, output)


def _estimate(reporter: Reporter, source: Path, output: Path, given: dict[str, Any]) -> Any:
    assigned = ("illuminant", "white")
    measured = ("light_class", "class_map", "class_captures")
    if given["camera"] is None:
        if given["illuminant"] is None:
            raise UsageError(
                "give --camera CAMERA.usda for a capture, or --illuminant NAME for a picture whose "
                "camera is not known"
            )
        _refuse(given, measured, "--camera, which is not given")
        if source.suffix.lower() in _LAYER_SUFFIXES:
            raise UsageError(
                f"{source}: --illuminant is for pictures; a capture has camera values, so give "
                "--camera CAMERA.usda"
            )
        from usdskin.estimate.light.assigned import AssignOptions, assign_light

        names = ("illuminant", "white", "form", "bad_pixels")
        chosen = AssignOptions(**{name: given[name] for name in names})
        return assign_light(source, output, chosen, reporter.progress())
    _refuse(given, assigned, "pictures without --camera")
    if source.suffix.lower() not in _LAYER_SUFFIXES:
        raise UsageError(
            f"{source}: --camera is for captures; give the capture.usda that names this picture"
        )
    from usdskin.estimate.light.step import LightOptions, estimate_light

    picked = LightOptions(**{name: given[name] for name in (*measured, "form")})
    return estimate_light(source, given["camera"], output, picked, reporter.progress())


def _refuse(given: dict[str, Any], names: tuple[str, ...], belongs_to: str) -> None:
    for name in names:
        if given[name] not in (None, ()):
            known = {"light_class": "class", "class_captures": "class-capture"}
            flag = known.get(name, name.replace("_", "-"))
            raise UsageError(f"--{flag} belongs to {belongs_to}; leave it out")


@estimate.command("skin", cls=StepCommand)
@click.argument("source", metavar="SAMPLES.usda|ALBEDO.png", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="SKIN.usda", help="To write.")
@click.option(
    "--specular",
    type=click.Choice(["none", "fit", "ignore"]),
    default="none",
    show_default=True,
    help="Readings have no lustre (refused where they do), it is to be fitted, or it is known to "
    "be absent (crossed polarisers).",
)
@click.option(
    "--wrap",
    type=click.FloatRange(0.0, 1.0),
    metavar="L",
    help="Wrap l, where it is known.  [default: fitted]",
)
@click.option(
    "--scattering",
    type=click.FloatRange(0.0, 100.0),
    metavar="SS",
    help="Scattering Ss of all columns, where it is known.  [default: fitted]",
)
@click.option(
    "--opacity",
    type=click.Choice(["none", "fit"]),
    default="none",
    show_default=True,
    help="Fit the opacity delta, from readings through known thicknesses.",
)
@click.option(
    "--like",
    type=_PATH,
    metavar="SKIN.usda",
    help="Take wrap, scattering and lustre of a textured skin from this material.  [default: the "
    "modelled skin that is shipped]",
)
@click.option(
    "--color-space",
    metavar="NAME",
    help="Color space of ALBEDO.  [default: what the file says, or sRGB for 8 and 16 bits]",
)
@click.option(
    "--plot", type=_PATH, metavar="FIGURE", help="Draw the fit: SVG, PDF or PNG (matplotlib)."
)
@click.pass_obj
def skin(
    options: GlobalOptions,
    /,
    source: Path,
    output: Path,
    plot: Path | None,
    like: Path | None,
    color_space: str | None,
    **given: Any,
) -> None:
    r"""Fit a skin material to goniometric readings or photographs, or to an albedo texture.

    SAMPLES.usda says where light and camera stood and what came back (SkinSampleAPI): spectra, or
    the values of a calibrated camera. SKIN.usda holds a Material to be referenced: reflectance,
    wrap and scattering with their standard deviations, and the readings they came from. An ALBEDO
    picture tells colors only; it is given the likeliest spectra of measured skin.

    \b
    Examples:
        usdskin estimate skin samples.usda -o skin.usda --plot skin.svg
        usdskin estimate skin samples.usda -o skin.usda --specular fit
        usdskin estimate skin albedo.png -o skin.usda --like measured.usda
    """
    with Reporter(options) as reporter:
        if source.suffix.lower() not in _LAYER_SUFFIXES:
            _refuse_fit_options(given, plot)
            from usdskin.estimate.skin.textured import estimate_textured_skin

            textured = estimate_textured_skin(source, output, like, color_space)
            reporter.notes(textured.notes)
            reporter.seconds(textured.seconds)
            reporter.wrote(textured.paths)
            return
        if like is not None or color_space is not None:
            raise UsageError("--like and --color-space belong to an albedo picture; leave them out")
        check_plot(plot, output, [source])
        from usdskin.estimate.skin.step import SkinOptions, estimate_skin

        result = estimate_skin(
            source,
            output,
            SkinOptions(**given, device=options.device, threads=options.threads),
            reporter.progress(),
        )
        reporter.result("skin", result, result.report)
        reporter.wrote([result.path])
        draw_plot(reporter, plot, output)


def _refuse_fit_options(given: dict[str, Any], plot: Path | None) -> None:
    usual = {"specular": "none", "wrap": None, "scattering": None, "opacity": "none"}
    for name, value in (given | {"plot": plot}).items():
        if value != usual.get(name):
            raise UsageError(f"--{name} belongs to SAMPLES.usda, not to a picture; leave it out")


COMMANDS: tuple[click.Command, ...] = (estimate,)
