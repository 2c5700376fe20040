"""``report``: a proof as one file that a person opens."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter

_PATH = click.Path(path_type=Path)


@click.command("report", cls=StepCommand)
@click.argument("folder", type=_PATH)
@click.option(
    "-o",
    "--output",
    type=_PATH,
    metavar="REPORT.html",
    help="File to write.  [default: report.html in FOLDER]",
)
@click.pass_obj
def report(options: GlobalOptions, /, folder: Path, output: Path | None) -> None:
    r"""Write the report of the proof in FOLDER: one HTML file that needs nothing else.

    It shows the verdict, the renders with a wipe between truth and reproduction, the differences
    with a read-out of every pixel, the light, spectra, skin, error budget, the capture's quality
    and where every file came from. The same numbers are written beside it as JSON and CSV.

    \b
    Examples:
        usdskin report out/
        usdskin report out/ -o room_fluorescent.html
    """
    reporter = Reporter(options)
    from usdskin.judge.report.step import write_report

    written = write_report(folder, output)
    reporter.notes(written.notes)
    reporter.event("report", verdict=written.verdict, missing=list(written.missing))
    if not reporter.json and not reporter.quiet:
        print(f"usdskin: {written.verdict}.", file=sys.stderr)
        if written.missing:
            left_out = ", ".join(written.missing)
            print(f"usdskin: the proof holds nothing for: {left_out}.", file=sys.stderr)
    reporter.wrote(written.paths)


COMMANDS = (report,)
