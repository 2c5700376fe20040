"""``photograph-skin``: a virtual camera before a lit subject, to rehearse a skin session."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter

_PATH = click.Path(path_type=Path)


@click.command("photograph-skin", cls=StepCommand)
@click.argument("stage", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="DIR", help="Folder to make.")
@click.option(
    "--calibration",
    type=_PATH,
    metavar="CAMERA.usda",
    help="The camera's calibration, which the samples then name.",
)
@click.option("--light-class", metavar="NAME", help="Class of the lamp, as CAMERA.usda names it.")
@click.option("--camera", metavar="NAME|FILE", help="Measured camera.  [default: Nikon 5100 (NPL)]")
@click.option("--illuminant", metavar="NAME|FILE", help="The lamp.  [default: D65]")
@click.option(
    "--subject", "prim_path", metavar="PRIM", help="What is photographed.  [default: everything]"
)
@click.option("--material", metavar="PRIM", help="Its skin.  [default: the stage's only one]")
@click.option(
    "--lights",
    "light_count",
    type=click.IntRange(3, 1000),
    default=24,
    show_default=True,
    help="Places of the lamp, around the subject and behind it.",
)
@click.option("--size", type=click.IntRange(8, 8192), default=96, show_default=True, help="Pixels.")
@click.option(
    "--images", "as_images", is_flag=True, help="Write EXR in camera values, not brackets."
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.pass_obj
def photograph_skin(
    options: GlobalOptions,
    /,
    stage: Path,
    output: Path,
    camera: str | None,
    illuminant: str | None,
    light_count: int,
    seed: int,
    **given: Any,
) -> None:
    r"""Photograph the subject of STAGE with a virtual camera, lit by a lamp from many places.

    DIR gets what a real session would give: photographs from two sides in every light, the geometry
    of their pixels and samples.usda for `usdskin estimate skin`; and truth/, the skin as it is.

    \b
    Example:
        usdskin photograph stages/capture_room/tubes.usda -o tubes --chart classic24 \
            --chart-only --light-class tubes
        usdskin calibrate camera tubes/chart.usda -o camera.usda
        usdskin photograph-skin stages/sphere/sphere.usda -o session --calibration camera.usda \
            --light-class tubes --illuminant FL2
        usdskin estimate skin session/samples.usda -o skin.usda
    """
    with Reporter(options) as reporter:
        from usdskin.judge.shoot.setups import Setup
        from usdskin.judge.skin.photographs import SubjectSetup, lamps, photograph_subject

        said: dict[str, Any] = {"camera": camera, "illuminant": illuminant, "seed": seed}
        setup = Setup(**{name: value for name, value in said.items() if value is not None})
        chosen = {name: value for name, value in given.items() if value is not None}
        written = photograph_subject(
            stage,
            output,
            setup,
            SubjectSetup(lights=lamps(light_count), **chosen),
            threads=options.threads,
            progress=reporter.progress(),
        )
        reporter.wrote([written])


COMMANDS = (photograph_skin,)
