"""``ingest``: from a folder of photographs to the layer of a shoot."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import UsageError

if TYPE_CHECKING:
    from usdskin.capture.viewpoints import Direction
    from usdskin.notes import Note

_PATH = click.Path(path_type=Path)
_ABOVE_ZERO = click.FloatRange(min=0.0, min_open=True)


@click.command("ingest", cls=StepCommand)
@click.argument("directory", metavar="DIR", type=_PATH)
@click.option("-o", "--output", type=_PATH, metavar="SHOOT.usda", help="Layer to write.")
@click.option("--dry-run", is_flag=True, help="Show what is understood and write nothing.")
@click.option(
    "--views",
    metavar="DIRECTIONS",
    help="Where the views look: 3, 3+zenith, back-to-back, or a list of azimuths such as "
    "0,120,240,up or azimuth:elevation [deg], counted to the left.  [default: what pictures or "
    "folder names tell, else evenly around]",
)
@click.option(
    "--lens",
    type=_PATH,
    metavar="LENS.usda",
    help="Calibrated lens to reference.  [default: guessed from the image circle]",
)
@click.option(
    "--projection",
    type=click.Choice(["equidistant", "equisolid", "stereographic", "orthographic"]),
    help="Projection of a lens that is not calibrated.  [default: equidistant]",
)
@click.option(
    "--fov",
    "field_deg",
    type=click.FloatRange(0.0, 360.0, min_open=True),
    metavar="DEG",
    help="Its field, from rim to rim of the image circle.  [default: 180]",
)
@click.option("--only", metavar="PATTERN", help="Take files of such names only, such as '*.tif'.")
@click.option("--f-number", type=_ABOVE_ZERO, metavar="N", help="Where pictures do not tell it.")
@click.option("--iso", type=_ABOVE_ZERO, metavar="ISO", help="Where pictures do not tell it.")
@click.option(
    "--nd",
    "nd_factor",
    type=click.FloatRange(min=1.0),
    metavar="FACTOR",
    default=1.0,
    help="Attenuation of a filter in front of all pictures, such as 64.",
)
@click.option("--black-level", type=float, metavar="DN", help="Raw value without light.")
@click.option("--white-level", type=_ABOVE_ZERO, metavar="DN", help="Raw value at saturation.")
@click.option(
    "--transfer",
    type=click.Choice(["auto", "linear", "recovered"]),
    default="auto",
    show_default=True,
    help="How raw values follow exposure; auto recovers the curve of 8-bit pictures.",
)
@click.option("--dark", type=_PATH, metavar="FILE", help="Photograph with the lens covered.")
@click.option("--flat", type=_PATH, metavar="FILE", help="Photograph of an even field.")
@click.option(
    "--illuminance",
    metavar="LUX@DIRECTION",
    help="Reading of an illuminance meter and where it faced, such as 350@up.",
)
@click.option(
    "--luminance",
    metavar="NITS@DIRECTION",
    help="Reading of a luminance meter and where it looked, such as 85@120:10.",
)
@click.option("--session", metavar="NAME", help="Name of the session.  [default: the folder's]")
@click.pass_obj
def ingest(options: GlobalOptions, /, directory: Path, output: Path | None, **given: Any) -> None:
    r"""Describe the photographs in DIR as a shoot, for usdskin capture.

    Each sub-folder is a view; in a flat folder views are told apart by pauses and repeated
    exposures. Exposures come from EXIF, or from DIR/exposures.csv (file,time,iso,fnumber,nd,view).
    RAW, TIFF, EXR, PNG and JPEG are read, every pixel of them, so that a broken or clipped picture
    shows before the set is struck.

    \b
    Examples:
        usdskin ingest photos/ --dry-run
        usdskin ingest photos/ -o shoot.usda --lens lens.usda --views 0,120,240,up
        usdskin ingest photos/ -o shoot.usda --projection equisolid --fov 185 --f-number 8
    """
    reporter = Reporter(options)
    dry_run = given.pop("dry_run")
    if output is None and not dry_run:
        raise UsageError("missing option -o SHOOT.usda; or give --dry-run to write nothing.")
    if given["lens"] and (given["projection"] or given["field_deg"]):
        raise UsageError("--lens tells the projection; leave --projection and --fov out.")
    from usdskin.capture.ingest.options import IngestOptions
    from usdskin.capture.ingest.step import check_survey_output, describe_survey, write_survey
    from usdskin.capture.ingest.survey import survey
    from usdskin.inspect import print_report

    for name in ("illuminance", "luminance"):
        given[name] = _reading(name, given[name])
    told = {name: value for name, value in given.items() if value is not None}
    wanted = IngestOptions(threads=options.threads, **told)
    if output is not None:
        check_survey_output(output, wanted)
    notes: list[Note] = []
    with reporter:
        found = survey(directory, wanted, notes, reporter.progress())
    report = describe_survey(found)
    if reporter.json:
        reporter.event("shoot", **report)
    elif dry_run:
        print_report(report)
    elif not reporter.quiet:
        print_report(report, sys.stderr)
    reporter.notes(notes)
    if output is not None and not dry_run:
        reporter.wrote([write_survey(found, output, wanted)])


def _reading(name: str, text: str | None) -> tuple[float, Direction] | None:
    if text is None:
        return None
    from usdskin.capture.viewpoints import parse_direction

    value, _, where = text.partition("@")
    direction = parse_direction(where)
    try:
        reading = float(value)
    except ValueError:
        reading = 0.0
    if direction is None or not 0.0 < reading < float("inf"):
        raise UsageError(
            f"--{name} {text}: give the reading and its direction, such as 350@up or 85@120:10."
        )
    return reading, direction


COMMANDS = (ingest,)
