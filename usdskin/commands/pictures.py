"""``render`` and ``map``: from a stage to pictures."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from usdskin.commands.options import RenderCommand, StepCommand, exposure, names
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import UsageError

_COMPLEXITY_LEVELS = {"low": 0, "medium": 1, "high": 2, "veryhigh": 3}
"""usdrecord's names for how finely subdivision surfaces are refined."""

_PATH = click.Path(path_type=Path)


@click.command("render", cls=RenderCommand)
@click.argument("stage", type=_PATH)
@click.argument("output", metavar="[OUT.####.exr]", type=_PATH, required=False)
@click.option(
    "-f",
    "--frames",
    metavar="FRAMES",
    help="Frames: 1-240, 1-240:2, 1:240x2 or 1,5,9.  [default: the stage's start]",
)
@click.option("-cam", "--camera", metavar="PRIM", help="Camera, by path or name.")
@click.option("-w", "--width", type=int, help="Width in pixels; the camera gives the height.")
@click.option(
    "-r", "--resolution", type=(int, int), metavar="W H", help="Width and height in pixels."
)
@click.option("-rs", "--settings", metavar="PRIM", help="RenderSettings prim to use.")
@click.option(
    "--spectral",
    is_flag=False,
    flag_value="factorised",
    type=click.Choice(["factorised", "brute"]),
    help="Write OUT.spectral.exr too; 'brute' shades every band by itself, slowly, as a check.",
)
@click.option("--no-spectral", is_flag=True, help="Write no spectral file though a setting asks.")
@click.option("--integrator", type=click.Choice(["map", "traced"]), help="How light is gathered.")
@click.option(
    "-p",
    "--samples",
    type=int,
    metavar="SPP",
    help="Samples per pixel, the most where --target-error stops earlier.  [default: 4; traced 64]",
)
@click.option(
    "--target-error",
    type=float,
    metavar="ERROR",
    help="Stop sampling a traced pixel at this relative error, such as 0.01.",
)
@click.option(
    "--bounces",
    type=int,
    metavar="0|1",
    help="How often reflected light falls on other surfaces; traced only.  [default: 0]",
)
@click.option(
    "--filter",
    "pixel_filter",
    type=click.Choice(["box", "triangle", "gaussian", "blackmanHarris"]),
    help="Pixel filter.",
)
@click.option("--seed", type=int, help="Seed of the sample positions.")
@click.option(
    "--illuminant",
    metavar="NAME|FILE",
    help="Lamp that RGB lights are taken to be: A, D50, FL2, 3200K or a table.  "
    "[default: what the light says, else D65]",
)
@click.option(
    "--bad-pixels",
    type=click.Choice(["error", "clamp"]),
    help="What to do with negative or non-finite light.  [default: error]",
)
@click.option(
    "--ev", type=exposure, metavar="auto|STOPS", help="Exposure of the PNG.  [default: auto]"
)
@click.option(
    "--white", metavar="none|scene|NAME", help="White the PNG is adapted from.  [default: scene]"
)
@click.option("--view", metavar="NAME", help="OCIO view of the PNG.")
@click.option("--png/--no-png", default=None, help="Write a PNG beside each EXR.  [default: yes]")
@click.option("--half", is_flag=True, help="Store beauty as half floats.")
@click.option(
    "--set",
    "attributes",
    multiple=True,
    metavar="/PRIM.ATTR=VALUE",
    help="Set an attribute for this render; may be repeated.",
)
@click.option(
    "--variant",
    "variants",
    multiple=True,
    metavar="/PRIM{SET=V}",
    help="Select a variant for this render; may be repeated.",
)
@click.option("--mask", type=names, metavar="PRIM,...", help="Render only this geometry.")
@click.option(
    "--purposes",
    type=names,
    metavar="PURPOSE,...",
    help="Purposes to render: default, render, proxy, guide.  [default: default,render]",
)
@click.option(
    "--dome",
    type=click.Choice(["auto", "show", "hide"]),
    help="Whether the camera sees the dome; auto hides it where the picture has alpha.",
)
@click.option(
    "--aov",
    "aovs",
    type=names,
    metavar="NAME,...",
    help="Extra parts: N, P, Z, albedo, st, primId, irradiance, cryptomatte; traced also diffuse, "
    "specular, emission, direct, indirect, visibility, variance, sampleCount; or all or none.",
)
@click.option(
    "--complexity",
    type=click.Choice(list(_COMPLEXITY_LEVELS)),
    help="Subdivision by usdrecord's names: levels 0 to 3.",
)
@click.option("--level", type=int, help="Subdivision level.")
@click.option("--wavelengths", metavar="FIRST:LAST:STEP", help="Bands in nm, such as 400:700:5.")
@click.option(
    "--observer",
    type=click.Choice(["cie1931_2", "cie1964_10", "cie2015_2"]),
    help="Color-matching functions.",
)
@click.option("--skip-existing", is_flag=True, help="Leave frames whose files are there and open.")
@click.option(
    "--resume", is_flag=True, help="Go on with a picture that was interrupted: same pixels."
)
@click.option(
    "--snapshot",
    "snapshot_s",
    type=click.FloatRange(min=0.1),
    metavar="SECONDS",
    help="Write <file>.snapshot.png of what is finished, this often.",
)
@click.option(
    "--compression",
    type=click.Choice(["none", "rle", "zips", "zip", "piz"]),
    help="Compression of the EXR.  [default: zip]",
)
@click.option(
    "--allow-outside", is_flag=True, help="Let RenderProducts write outside the current folder."
)
@click.pass_obj
def render(options: GlobalOptions, /, stage: Path, output: Path | None, **given: Any) -> None:
    r"""Render STAGE to EXR and PNG.

    Without OUT the stage's RenderProducts are written, or <stage>.exr where it has none. Options
    win over what the stage's RenderSettings say. The paths written are printed.

    \b
    Examples:
        usdskin render stages/sphere/sphere.usda sphere.exr --spectral
        usdskin render shot.usda out.####.exr -f 1-240:2 -cam /World/Cam -w 1920
        usdskin render head.usda --variant "/Light{lamp=incandescent}" --ev 0 --white D65
    """
    reporter = Reporter(options)
    from usdskin.frames import parse_frames
    from usdskin.render.opinions import parse_wavelengths
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.render import render_stage

    if given["no_spectral"] and given["spectral"]:
        raise UsageError("--spectral and --no-spectral exclude each other; give one of them.")
    if given["complexity"] is not None and given["level"] is not None:
        raise UsageError("--complexity and --level say the same; give one of them.")
    method = given.pop("spectral")
    without_spectral = given.pop("no_spectral")
    complexity, level = given.pop("complexity"), given.pop("level")
    frames, wavelengths = given.pop("frames"), given.pop("wavelengths")
    overrides = RenderOverrides(
        frames=None if frames is None else parse_frames(frames),
        spectral_output=True if method else (False if without_spectral else None),
        spectral_method=method,
        subdivision_level=level if complexity is None else _COMPLEXITY_LEVELS[complexity],
        wavelength_nm=None if wavelengths is None else parse_wavelengths(wavelengths),
        threads=options.threads,
        device=options.device,
        **given,
    )
    with reporter:
        report = render_stage(stage, output, overrides, reporter.progress())
    reporter.finish(report)


@click.command("map", cls=StepCommand)
@click.argument("light", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="MAP.exr", help="File to write.")
@click.option("-f", "--frame", type=float, help="Frame.  [default: the stage's start]")
@click.option(
    "--light", "light_prim", metavar="PRIM", help="Take this light alone.  [default: all]"
)
@click.option(
    "--material",
    metavar="PRIM",
    help="Skin material to light.  [default: the stage's only one, or a white surface]",
)
@click.option("--wrap", type=float, help="Wrap l of the white surface, 0 to 1.  [default: 0.3]")
@click.option("-w", "--width", type=int, help="Width in pixels, twice the height.  [default: 512]")
@click.option("--wavelengths", metavar="FIRST:LAST:STEP", help="Bands in nm, such as 400:700:5.")
@click.option(
    "--observer",
    type=click.Choice(["cie1931_2", "cie1964_10", "cie2015_2"]),
    help="Color-matching functions.",
)
@click.option("--illuminant", metavar="NAME|FILE", help="Lamp that RGB lights are taken to be.")
@click.option("--bad-pixels", type=click.Choice(["error", "clamp"]), help="As in render.")
@click.option(
    "--ev", type=exposure, metavar="auto|STOPS", help="Exposure of the PNG.  [default: auto]"
)
@click.option("--white", metavar="none|scene|NAME", help="White the PNG is adapted from.")
@click.option("--view", metavar="NAME", help="OCIO view of the PNG.")
@click.pass_obj
def map_(options: GlobalOptions, /, light: Path, output: Path, **given: Any) -> None:
    r"""Write the reflectance map of LIGHT as a picture and a spectral file.

    That is the radiance of a surface over the direction of its normal, band by band: a latlong
    picture with the pole up +Y, as UsdLux has it. MAP.exr is the spectral file; a PNG lies beside
    it. The paths written are printed.

    \b
    Example:
        usdskin map light.usda -o map.exr --wrap 0.3
    """
    reporter = Reporter(options)
    from usdskin.render.map import write_map
    from usdskin.render.opinions import parse_wavelengths
    from usdskin.render.overrides import MapOverrides

    wavelengths = given.pop("wavelengths")
    overrides = MapOverrides(
        wavelength_nm=None if wavelengths is None else parse_wavelengths(wavelengths),
        threads=options.threads,
        device=options.device,
        **given,
    )
    with reporter:
        report = write_map(light, output, overrides, reporter.progress())
    reporter.finish(report)


COMMANDS = (render, map_)
