"""``compare``: how far a picture is from the true one."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from usdskin.commands.options import StepCommand, names
from usdskin.commands.reporter import GlobalOptions, Reporter

if TYPE_CHECKING:
    from usdskin.judge.comparison.bars import Bar
    from usdskin.judge.comparison.compare import Comparison

_PATH = click.Path(path_type=Path)


def _three_numbers(value: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(number) for number in value.split(","))
    except ValueError:
        raise click.BadParameter(f"{value!r} is not three numbers X,Y,Z.") from None
    return x, y, z


def _bars(value: str) -> dict[str, float]:
    found = {}
    for item in names(value):
        name, _, number = item.partition("=")
        try:
            found[name.strip()] = float(number)
        except ValueError:
            raise click.BadParameter(f"{item!r} is not NAME=NUMBER, such as mean=1.") from None
    return found


@click.command("compare", cls=StepCommand)
@click.argument("truth", type=_PATH)
@click.argument("picture", type=_PATH)
@click.option(
    "--mask",
    "masks",
    multiple=True,
    metavar="RULE",
    help="Pixels to judge: alpha (fully covered), all, luminance:SHARE (of Y_n, in the truth) or a "
    "picture that is white where they are; may be repeated, and then all must hold. alpha counts "
    "unless all or a picture is given.  [default: alpha]",
)
@click.option(
    "--select",
    type=names,
    metavar="PATH,...",
    help="Judge these prims or materials only (primId, Cryptomatte); patterns like */Head too.",
)
@click.option(
    "--regions",
    type=click.Choice(["primId", "crypto_object", "crypto_material", "none"]),
    help="Statistics by prim or by material.  [default: primId where the truth has it]",
)
@click.option(
    "--observer",
    type=click.Choice(["cie1931_2", "cie1964_10", "cie2015_2"]),
    help="Whose eyes; another than the pictures' own needs spectra.  [default: the truth's]",
)
@click.option(
    "--diffuser",
    type=_three_numbers,
    metavar="X,Y,Z",
    help="XYZ of the perfect diffuser at the brightest irradiance, in the pictures' unit.  "
    "[default: from the truth's part irradiance]",
)
@click.option(
    "--ppd",
    "pixels_per_degree",
    type=float,
    default=67.0,
    show_default=True,
    help="Pixels per degree of visual angle, for FLIP.",
)
@click.option(
    "--threshold",
    type=_bars,
    metavar="NAME=BAR,...",
    help="Exit with 4 where a figure passes its bar: mean, median, p95, max of dE2000, flip "
    "(mean), rmse, or gfc (mean, at least).",
)
@click.option(
    "-o",
    "--output",
    type=_PATH,
    metavar="FOLDER|MAPS.exr",
    help="Write the maps as EXR and, with a legend, as PNG; the latter alone for MAP.png.",
)
@click.pass_obj
def compare(
    options: GlobalOptions,
    /,
    truth: Path,
    picture: Path,
    masks: tuple[str, ...],
    select: tuple[str, ...] | None,
    regions: str | None,
    observer: str | None,
    diffuser: tuple[float, float, float] | None,
    pixels_per_degree: float,
    threshold: dict[str, float] | None,
    output: Path | None,
) -> None:
    r"""Measure the colour difference between PICTURE and TRUTH.

    Colours are divided by Y_n of a perfect diffuser at the truth's brightest irradiance and seen
    against that diffuser's white: CIEDE2000, dE76, dL*, da*, db*, spectra where both have them,
    and FLIP. Mask, Y_n and white are told with the figures.

    \b
    Examples:
        usdskin compare truth.exr picture.exr -o differences
        usdskin compare truth.exr picture.exr --mask face.png --threshold mean=1,p95=2.5
        usdskin --json compare truth.spectral.exr picture.spectral.exr --regions crypto_material
    """
    reporter = Reporter(options)
    from usdskin.judge.comparison.bars import judge_bars, known_bars, require
    from usdskin.judge.comparison.compare import CompareOptions, compare_pictures
    from usdskin.judge.comparison.maps import map_files, write_maps

    known_bars(threshold or {})
    if output is not None:
        map_files(output, picture.stem, (truth, picture))
    found = compare_pictures(
        truth,
        picture,
        CompareOptions(
            masks=masks,
            select=select or (),
            regions=regions,
            observer=observer,  # type: ignore[arg-type]
            diffuser=diffuser,
            pixels_per_degree=pixels_per_degree,
        ),
    )
    bars = judge_bars(found, threshold or {})
    reporter.notes(found.notes)
    _show(reporter, found, bars)
    if output is not None:
        reporter.wrote(write_maps(found, output))
    require(found, bars)


def _show(reporter: Reporter, found: Comparison, bars: Sequence[Bar]) -> None:
    if reporter.json:
        judged = [dataclasses.asdict(bar) for bar in bars]
        reporter.event("comparison", **found.as_json(), bars=judged)
    elif not reporter.quiet:
        from usdskin.judge.comparison.table import print_comparison

        print_comparison(found)


COMMANDS = (compare,)
