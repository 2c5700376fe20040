"""``solve``: the true light of a virtual set."""

from __future__ import annotations

from pathlib import Path

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter

_PATH = click.Path(path_type=Path)


@click.command("solve", cls=StepCommand)
@click.argument("source", metavar="SET.usda", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="LIGHT.usda", help="To write.")
@click.option("--height", type=int, default=256, show_default=True, help="Rows of the panorama.")
@click.option(
    "--cells", type=int, default=1500, show_default=True, help="Cells of the surfaces, about."
)
@click.option(
    "--as",
    "form",
    type=click.Choice(["basis", "bands"]),
    default="basis",
    show_default=True,
    help="Few spectra and their coefficients, or an image of every band.",
)
@click.pass_obj
def solve(
    options: GlobalOptions, /, source: Path, output: Path, height: int, cells: int, form: str
) -> None:
    r"""Compute the true light of a virtual set as its capture point sees it.

    SET.usda holds lamps with spectra and surfaces with reflectances (docs/sets.md). Light between
    surfaces is followed by radiosity in float64, apart from the renderer. Beside LIGHT.usda come
    light_CLASS.usda where the set has several classes of lamps.

    \b
    Example:
        usdskin solve stages/room_fluorescent/set.usda -o truth/light.usda
    """
    with Reporter(options) as reporter:
        from usdskin.judge.truth.solve import solve_set

        solved = solve_set(
            source,
            output,
            height=height,
            cells=cells,
            form="bands" if form == "bands" else "basis",
            progress=reporter.progress(),
        )
        reporter.result("solved", solved, solved.report)
        reporter.wrote(solved.paths)


COMMANDS = (solve,)
