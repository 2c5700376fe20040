"""``new``, ``import``, ``info`` and ``validate``: make files, and look at them."""

from __future__ import annotations

from pathlib import Path

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter

_PATH = click.Path(path_type=Path)


@click.command("info", cls=StepCommand)
@click.argument("file", type=_PATH)
@click.pass_obj
def info(options: GlobalOptions, /, file: Path) -> None:
    r"""Show what is in FILE, a stage or a picture.

    For a stage that is its units, time range, cameras, lights, materials and meshes, and whatever
    in it a render would not show; for a picture its parts, channels, bands and header.

    \b
    Examples:
        usdskin info shot.usda
        usdskin --json info render.spectral.exr
    """
    reporter = Reporter(options)
    from usdskin.inspect import inspect_file, print_report

    report = inspect_file(file)
    if reporter.json:
        reporter.event("info", **report)
    else:
        print_report(report)


MAKING = ()
READING = (info,)
