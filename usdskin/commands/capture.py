"""``capture``: from photographs to light."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter

_PATH = click.Path(path_type=Path)


def _lamp_illuminance(value: str) -> tuple[str, float]:
    """Return a lamp's name, empty for the only one, and its illuminance [lx]."""
    lamp, _, number = value.rpartition("=")
    try:
        lux = float(number)
    except ValueError:
        lux = 0.0
    if not 0.0 < lux < float("inf"):
        raise click.BadParameter(f"{value!r} is neither LUX nor LAMP=LUX with a number above 0.")
    return lamp.strip(), lux


@click.command("capture", cls=StepCommand)
@click.argument("shoot", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="CAPTURE.usda", help="To write.")
@click.option(
    "-w",
    "--width",
    type=click.IntRange(min=16, max=16384),
    help="Width of the panorama; its height is half.  [default: what the lens resolves]",
)
@click.option(
    "--refine-rotations", is_flag=True, help="Turn the views so that they agree where they overlap."
)
@click.option(
    "--measured-exposures",
    is_flag=True,
    help="Use the ratios of exposures that the photographs show; nominal times are rounded.",
)
@click.option(
    "--glare",
    type=click.FloatRange(0.0, 0.5),
    metavar="SHARE",
    help="Share of the light that the lens spreads evenly.  [default: the lens's fisheye:glare, "
    "or what shows beyond the image circle]",
)
@click.option(
    "--lamp-illuminance",
    "lamps",
    type=_lamp_illuminance,
    multiple=True,
    metavar="[LAMP=]LUX",
    help="Illuminance of a clipped lamp on a surface facing it, measured with all else shaded; "
    "may be repeated.",
)
@click.pass_obj
def capture(options: GlobalOptions, /, shoot: Path, output: Path, **given: Any) -> None:
    r"""Make one calibrated panorama of the photographs in SHOOT.

    The exposures of each view are merged, the views placed on the sphere by lens and rotation.
    CAPTURE.usda gets what was measured on the way: coverage, clipped lamps, noise, rotations;
    beside it are panorama.exr, stddev.exr and the picture quality.png.

    \b
    Examples:
        usdskin capture shoot.usda -o capture.usda
        usdskin capture shoot.usda -o capture.usda --refine-rotations --lamp-illuminance 2300
    """
    with Reporter(options) as reporter:
        from usdskin.capture.step import CaptureOptions, capture_shoot

        result = capture_shoot(
            shoot,
            output,
            CaptureOptions(**given, device=options.device, threads=options.threads),
            reporter.progress(),
        )
        reporter.result("capture", result, result.report)
        reporter.wrote(result.paths)


COMMANDS = (capture,)
