"""``plot``: figures of what the steps have written."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from usdskin.commands.options import StepCommand, names
from usdskin.commands.reporter import GlobalOptions, Reporter

if TYPE_CHECKING:
    from usdskin.notes import Note

_PATH = click.Path(path_type=Path)


@click.command("plot", cls=StepCommand)
@click.argument("file", type=_PATH)
@click.option(
    "-o",
    "--output",
    type=_PATH,
    required=True,
    metavar="FIGURE",
    help="To write: .svg, .png or .pdf.",
)
@click.option(
    "--what",
    type=names,
    metavar="PART,...",
    help="Parts to show: sensitivities, diffuser, chromaticity, spectra, errors of a camera; "
    "signals, chromaticity, patches, values of a chart; spectrum, chromaticity, picture, classes, "
    "summary of a light; spectra, color, fit, summary of a skin.  [default: all]",
)
@click.option(
    "--patches",
    type=names,
    metavar="NAME,...",
    help="Patches of a camera's chart whose spectra are drawn.  [default: a varied dozen]",
)
@click.option(
    "--class",
    "classes",
    type=names,
    metavar="NAME,...",
    help="Light classes of a camera to show.  [default: all]",
)
@click.pass_obj
def plot(
    options: GlobalOptions,
    /,
    file: Path,
    output: Path,
    what: tuple[str, ...] | None,
    patches: tuple[str, ...] | None,
    classes: tuple[str, ...] | None,
) -> None:
    r"""Draw what is in FILE: a calibrated camera, a colour chart, a spectral light or a skin.

    Estimated spectra are solid, measured ones dashed. Needs matplotlib: the extra "plot".

    \b
    Examples:
        usdskin plot camera.usda -o camera.svg
        usdskin plot camera.usda -o skin.pdf --what spectra --patches "dark skin,light skin"
        usdskin plot light.usda -o light.png
        usdskin plot skin.usda -o skin.svg
    """
    reporter = Reporter(options)
    from usdskin.plots.step import PlotOptions, plot_file

    notes: list[Note] = []
    given = PlotOptions(what=what or (), patches=patches or (), classes=classes or ())
    written = plot_file(file, output, given, notes)
    reporter.notes(notes)
    reporter.wrote([written])


COMMANDS = (plot,)
