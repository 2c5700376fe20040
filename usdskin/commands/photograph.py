"""``photograph``: from a known light to photographs, for rehearsals and tests."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import UsageError

if TYPE_CHECKING:
    from usdskin.judge.shoot.charts import ChartSetup
    from usdskin.judge.shoot.sensor import Exposures, Sensor
    from usdskin.notes import Note
    from usdskin.prims import FisheyeLens

_PATH = click.Path(path_type=Path)

_OF_A_CAMERA = (
    *("lens", "projection", "fov", "size", "vignetting", "glare"),
    *("full_well", "read_noise", "middle", "sensor_constant"),
)
"""Options that --same-camera stands for."""


def _seconds(value: str) -> float:
    """Return a time in seconds, given as ``0.5`` or ``1/60``."""
    whole, _, part = value.partition("/")
    try:
        seconds = float(whole) / (float(part) if part else 1.0)
    except (ValueError, ZeroDivisionError):
        seconds = 0.0
    if not 0.0 < seconds < 1e6:
        raise click.BadParameter(f"{value!r} is no time in seconds, such as 0.5 or 1/60.")
    return seconds


def _numbers(value: str) -> tuple[float, ...]:
    """Return the numbers between commas."""
    try:
        return tuple(float(item) for item in value.split(",") if item.strip())
    except ValueError:
        raise click.BadParameter(f"{value!r} are no numbers between commas.") from None


@click.command("photograph", cls=StepCommand)
@click.argument("environment", metavar="ENV", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="DIR", help="Folder to make.")
@click.option("--camera", metavar="NAME|FILE", help="Measured camera.  [default: Nikon 5100 (NPL)]")
@click.option("--illuminant", metavar="NAME|FILE", help="Lamp that RGB light is taken to be.")
@click.option(
    "--bad-pixels",
    type=click.Choice(["error", "clamp"]),
    help="What to do with negative or non-finite light.  [default: error]",
)
@click.option(
    "--mean-luminance", type=float, metavar="CD/M2", help="Of light without units.  [default: 100]"
)
@click.option("--lens", type=_PATH, metavar="LENS.usda", help="Lens that `calibrate lens` wrote.")
@click.option(
    "--projection",
    type=click.Choice(["equidistant", "equisolid", "stereographic", "orthographic"]),
    default="equidistant",
    show_default=True,
    help="Projection of an ideal lens.",
)
@click.option(
    "--fov", type=float, default=180.0, show_default=True, help="Its angle of view in degrees."
)
@click.option(
    "--size", type=click.IntRange(8, 16384), default=1000, show_default=True, help="Its pixels."
)
@click.option(
    "--vignetting",
    type=_numbers,
    default="-0.04,-0.012",
    metavar="A2,A4,...",
    show_default=True,
    help="Of an ideal lens: V = 1 + A2 phi^2 + A4 phi^4 + ...",
)
@click.option("--glare", type=float, help="Share of light spread evenly.  [default: the lens's]")
@click.option(
    "--views", default="3", show_default=True, help="3, 3+zenith, back-to-back, or 0,120,240,up."
)
@click.option("--exposures", type=click.IntRange(1, 99), default=9, show_default=True)
@click.option("--stops", type=float, default=2.0, show_default=True, help="Between exposures.")
@click.option(
    "--time",
    "middle_s",
    type=_seconds,
    metavar="SECONDS",
    default="1/15",
    show_default=True,
    help="In the middle.",
)
@click.option("--iso", type=float, default=100.0, show_default=True)
@click.option("--f-number", type=float, default=8.0, show_default=True)
@click.option("--nd", type=float, default=1.0, show_default=True, help="Factor of the ND filter.")
@click.option("--middle", type=float, help="Mean green over white, mid-exposure.  [default: 0.18]")
@click.option("--sensor-constant", type=float, help="Of a camera used before; wins over --middle.")
@click.option("--bits", type=click.IntRange(8, 16), default=14, show_default=True)
@click.option("--black-level", type=int, metavar="DN", help="[default: 512 of 14 bits]")
@click.option("--full-well", type=float, default=60000.0, show_default=True, help="Electrons.")
@click.option("--read-noise", type=float, default=3.0, show_default=True, help="Electrons.")
@click.option("--no-noise", is_flag=True, help="Leave photon and read noise out.")
@click.option(
    "--format",
    "file_kind",
    type=click.Choice(["tif", "png", "exr", "jpg", "png8"]),
    help="Raw values as tif, png or exr; developed pictures as jpg or png8.  [default: tif]",
)
@click.option(
    "--curve",
    type=click.Choice(["srgb", "gamma22", "filmic"]),
    help="Tone curve of developed pictures.  [default: srgb]",
)
@click.option("--vignetting-error", type=float, help="Of the stated V at the edge, relative.")
@click.option("--rotation-error", "rotation_error_deg", type=float, help="Of each view, degrees.")
@click.option("--shutter-error", type=float, help="Of the exposures, relative.")
@click.option("--stated-glare", type=float, help="What the shoot says.  [default: the truth]")
@click.option(
    "--reading-error", type=float, help="Of all readings of meter and spectroradiometer, relative."
)
@click.option("--state-noise", "states_noise", is_flag=True, help="Author gain and read noise.")
@click.option(
    "--truth-height", type=int, help="Rows of truth.exr.  [default: the light's, least 256]"
)
@click.option(
    "--same-camera",
    type=_PATH,
    metavar="SHOOT_DIR",
    help="Go on with the lens and sensor of an earlier shoot.",
)
@click.option("--chart", metavar="classic24|FILE", help="Photograph and measure a color chart too.")
@click.option("--chart-only", is_flag=True, help="Photograph nothing but the chart.")
@click.option(
    "--chart-facing",
    type=_numbers,
    metavar="X,Y,Z",
    help="Where the chart faces, in the world.  [default: where it is brightest]",
)
@click.option("--light-class", metavar="NAME", help="Class of the chart's light.  [default: light]")
@click.option("--seed", type=click.IntRange(min=0), help="Of everything random.  [default: 0]")
@click.pass_obj
def photograph(options: GlobalOptions, /, environment: Path, output: Path, **given: Any) -> None:
    r"""Photograph ENV, a stage with lights or a latlong picture, with a virtual fisheye camera.

    DIR gets what a real shoot would give, shoot.usda and a folder of photographs per view, and
    truth/, what the camera was not told: the true panorama, lens and rotations. With --chart it
    also gets chart.usda, for `usdskin calibrate camera`: a color chart in the same light, its
    photographs and its spectra.

    \b
    Examples:
        usdskin photograph stages/capture_room/room.usda -o shoot
        usdskin photograph hall.hdr --illuminant FL2 -o shoot --views 3+zenith --glare 0.01
        usdskin photograph stages/capture_room/tubes.usda -o tubes --same-camera shoot \
            --chart classic24 --chart-only --light-class tubes
    """
    with Reporter(options) as reporter:
        from usdskin.capture.viewpoints import parse_directions
        from usdskin.judge.shoot.charts import photograph_chart, with_camera_of
        from usdskin.judge.shoot.photographer import photograph as take
        from usdskin.judge.shoot.setups import Setup

        same_camera, chart, chart_only = _same_camera(given), _chart(given), given.pop("chart_only")
        if chart_only and chart is None:
            raise UsageError("--chart-only: there is no chart; add --chart classic24 or a file")
        values = {
            "lens": _lens(given),
            "views": parse_directions(given.pop("views")),
            "exposures": _exposures(given),
            "sensor": _sensor(given),
            **{name: value for name, value in given.items() if value is not None},
        }
        setup = Setup(**values)
        if same_camera is not None:
            setup = with_camera_of(same_camera, setup)
        notes: list[Note] = []
        work: dict[str, Any] = {
            "threads": options.threads,
            "progress": reporter.progress(),
            "notes": notes,
        }
        if chart is None:
            written = [take(environment, output, setup, **work)]
        else:
            made = photograph_chart(
                environment, output, setup, chart, with_views=not chart_only, **work
            )
            written = [made] if chart_only else [made.with_name("shoot.usda"), made]
        reporter.notes(notes)
        reporter.wrote(written)


def _same_camera(given: dict[str, Any]) -> Path | None:
    """Return the folder of --same-camera, beside which no option may say otherwise."""
    folder: Path | None = given.pop("same_camera")
    context = click.get_current_context()
    for name in _OF_A_CAMERA if folder is not None else ():
        if context.get_parameter_source(name) is not click.core.ParameterSource.DEFAULT:
            option = "--" + name.replace("_", "-")
            raise UsageError(f"{option}: --same-camera says it already; leave one of them out")
    return folder


def _chart(given: dict[str, Any]) -> ChartSetup | None:
    from usdskin.judge.shoot.charts import ChartSetup

    names = {"chart": "chart", "chart_facing": "facing", "light_class": "light_class"}
    said = {field: given.pop(name) for name, field in names.items()}
    said = {field: value for field, value in said.items() if value is not None}
    if "chart" not in said:
        if said:
            raise UsageError("--chart-facing and --light-class belong to a chart; add --chart")
        return None
    if len(said.get("facing", (0, 0, 0))) != 3:
        raise UsageError("--chart-facing: not three numbers; give a direction such as 0,1,0")
    return ChartSetup(**said)


def _lens(given: dict[str, Any]) -> FisheyeLens:
    from dataclasses import replace

    from usdskin.judge.shoot.setups import fisheye, lens_of_layer

    layer, glare = given.pop("lens"), given.pop("glare")
    names = ("size", "projection", "fov", "vignetting")
    ideal = fisheye(*(given.pop(name) for name in names)) if layer is None else None
    for name in names if ideal is None else ():
        del given[name]
    lens = ideal or lens_of_layer(layer)
    return lens if glare is None else replace(lens, glare=glare)


def _exposures(given: dict[str, Any]) -> Exposures:
    from usdskin.judge.shoot.sensor import exposure_series

    names = ("exposures", "stops", "middle_s", "iso", "f_number", "nd")
    return exposure_series(*(given.pop(name) for name in names))


def _sensor(given: dict[str, Any]) -> Sensor:
    from usdskin.judge.shoot.sensor import Sensor

    bits, black = given.pop("bits"), given.pop("black_level")
    return Sensor(
        full_well=given.pop("full_well"),
        read_noise=given.pop("read_noise"),
        bits=bits,
        black_level=(1 << bits) // 32 if black is None else black,
        is_noisy=not given.pop("no_noise"),
    )


COMMANDS = (photograph,)
