"""``bake``: measure shadows once, for any light and camera."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from usdskin.commands.options import StepCommand, names
from usdskin.commands.reporter import GlobalOptions, Reporter

_PATH = click.Path(path_type=Path)


@click.command("bake", cls=StepCommand)
@click.argument("stage", type=_PATH)
@click.option(
    "-o", "--output", type=_PATH, required=True, metavar="TRANSFER.usda", help="Layer to write."
)
@click.option("-f", "--frame", type=float, help="Frame.  [default: the stage's start]")
@click.option(
    "--directions",
    type=int,
    metavar="N",
    help="Directions looked in from every vertex.  [default: 1024]",
)
@click.option(
    "--receivers",
    type=names,
    metavar="PRIM,...",
    help="Measure shadows on this geometry alone; all of it casts them.  [default: all]",
)
@click.option("--level", type=int, help="Subdivision level, the one to render at.")
@click.option("-rs", "--settings", metavar="PRIM", help="RenderSettings prim to use.")
@click.option(
    "--set",
    "attributes",
    multiple=True,
    metavar="/PRIM.ATTR=VALUE",
    help="Set an attribute for this bake; may be repeated.",
)
@click.option(
    "--variant",
    "variants",
    multiple=True,
    metavar="/PRIM{SET=V}",
    help="Select a variant for this bake; may be repeated.",
)
@click.option("--mask", type=names, metavar="PRIM,...", help="Take only this geometry.")
@click.option("--purposes", type=names, metavar="PURPOSE,...", help="As in render.")
@click.pass_obj
def bake(options: GlobalOptions, /, stage: Path, output: Path, **given: Any) -> None:
    r"""Measure the shadows of STAGE, for pictures under any light and from any camera.

    TRANSFER.usda is to be brought into the stage as a sublayer; then `usdskin render` with the
    map integrator, its default, shows shadows between and within bodies, and light through thin
    ones, at the speed of a map. The measurements, TRANSFER.npz, lie beside the layer. They hold
    for the geometry of one moment; where it has changed, a render says so and asks for a new
    bake. The paths written are printed.

    \b
    Example:
        usdskin bake shot.usda -o transfer.usda
    """
    reporter = Reporter(options)
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.transfer_bake import bake_transfer

    frame, directions = given.pop("frame"), given.pop("directions")
    receivers = given.pop("receivers")
    overrides = RenderOverrides(
        frames=None if frame is None else (frame,),
        subdivision_level=given.pop("level"),
        threads=options.threads,
        device=options.device,
        **given,
    )
    with reporter:
        report = bake_transfer(
            stage,
            output,
            overrides,
            reporter.progress(),
            directions=directions,
            receivers=receivers,
        )
    reporter.result("bake", report, report)
    reporter.wrote(report.paths)


COMMANDS = (bake,)
