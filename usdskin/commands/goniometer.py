"""``goniometer``: readings of a known skin, for rehearsals and proofs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter

_PATH = click.Path(path_type=Path)


@click.command("goniometer", cls=StepCommand)
@click.argument("stage", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="SAMPLES.usda", help="To write.")
@click.option(
    "--material", metavar="PRIM", help="Its skin.  [default: the default prim, or the only one]"
)
@click.option(
    "--readings",
    type=click.IntRange(min=6),
    help="Places of the lamp, from the normal to past the last light.  [default: 24]",
)
@click.option("--noise", type=float, help="Of a reading, relative to it.  [default: 0.01]")
@click.option("--floor", type=float, help="Of all, relative to the peak.  [default: 0.002]")
@click.option(
    "--polarisers",
    type=click.Choice(["crossed", "none"]),
    help="Crossed polarisers take the lustre away.  [default: crossed]",
)
@click.option("--seed", type=click.IntRange(min=0), help="Of the noise.  [default: 0]")
@click.pass_obj
def goniometer(
    options: GlobalOptions, /, stage: Path, output: Path, material: str | None, **given: Any
) -> None:
    r"""Measure a flat sample of the skin in STAGE with a virtual goniometer.

    One lamp goes from the normal to beyond the shadow line; where light passes the skin, some
    readings are taken with a sheet of it in the lamp's way. SAMPLES.usda gets 61 bands with the
    noise of a real instrument.

    \b
    Example:
        usdskin goniometer stages/skin_library/skin_library.usda -o samples.usda
        usdskin estimate skin samples.usda -o skin.usda --specular ignore --opacity fit
    """
    with Reporter(options) as reporter:
        from usdskin.judge.skin.goniometer import GoniometerSetup, read_goniometer

        setup = GoniometerSetup(**{name: item for name, item in given.items() if item is not None})
        reporter.wrote([read_goniometer(stage, output, setup, material=material)])


COMMANDS = (goniometer,)
