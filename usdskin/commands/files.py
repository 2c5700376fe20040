"""``new``, ``import``, ``info`` and ``validate``: make files, and look at them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import EXIT_FINDINGS, EXIT_OK

if TYPE_CHECKING:
    from usdskin.notes import Note

_PATH = click.Path(path_type=Path)


@click.command("new", cls=StepCommand)
@click.argument("directory", metavar="DIR", type=_PATH)
@click.option(
    "--template",
    type=click.Choice(["portrait", "sphere"]),
    default="portrait",
    show_default=True,
    help="What there is to light.",
)
@click.pass_obj
def new(options: GlobalOptions, /, directory: Path, template: str) -> None:
    r"""Make a project in DIR that renders as it is.

    Light, skin, subject and shot are layers of their own, to be replaced one by one. The path of
    the stage to render is printed.

    \b
    Example:
        usdskin new first && usdskin render first/shot.usda first.exr
    """
    reporter = Reporter(options)
    from usdskin.projects import new_project

    reporter.wrote([new_project(directory, template)])


@click.command("import", cls=StepCommand)
@click.argument("mesh", type=_PATH)
@click.option("-o", "--output", type=_PATH, required=True, metavar="ASSET.usda", help="To write.")
@click.option(
    "--units",
    type=click.Choice(["m", "dm", "cm", "mm", "in", "ft", "auto"]),
    help="Unit of the numbers; auto guesses it from the size.  [default: the file's, else cm]",
)
@click.option(
    "--up",
    "up_axis",
    type=click.Choice(["y", "z"]),
    help="Axis that points up.  [default: the file's, else y]",
)
@click.option(
    "--group", "groups", multiple=True, metavar="NAME", help="Keep this group; may be repeated."
)
@click.option(
    "--subdivide",
    "scheme",
    type=click.Choice(["catmullClark", "loop", "none"]),
    help="Subdivision scheme.  [default: what suits the faces]",
)
@click.option("--normals", is_flag=True, help="Compute smooth normals in place of the file's.")
@click.option("--flip-v", is_flag=True, help="Turn texture coordinates counted from the top.")
@click.option(
    "--decimate", "decimate_to", type=int, metavar="N", help="Keep at most N triangles (open3d)."
)
@click.option("--repair", "repair_mesh", is_flag=True, help="Mend what is broken (open3d).")
@click.option(
    "--skin",
    multiple=True,
    metavar="MATERIAL",
    help="This material is skin; may be repeated.  [default: all are]",
)
@click.option("--name", help="Name of the asset's prim.  [default: the file's]")
@click.pass_obj
def import_(options: GlobalOptions, /, mesh: Path, output: Path, **given: Any) -> None:
    r"""Make a USD asset of MESH: OBJ, PLY, glTF, STL or OFF.

    Polygons, texture coordinates with their indices, normals and groups (as GeomSubsets) are
    kept, and a skin material is bound. OBJ is read by usdskin itself, the others by open3d.

    \b
    Examples:
        usdskin import head.obj -o head.usda --units cm --skin face
        usdskin import scan.ply -o scan.usda --repair --decimate 50000
    """
    reporter = Reporter(options)
    from usdskin.meshfiles.step import import_mesh

    notes: list[Note] = []
    given["skin"] = given["skin"] or None
    written = import_mesh(mesh, output, **given, notes=notes)
    reporter.notes(notes)
    reporter.wrote([written])


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


@click.command("validate", cls=StepCommand)
@click.argument("files", metavar="FILE...", type=_PATH, nargs=-1, required=True)
@click.option("--strict", is_flag=True, help="Exit with 4 for warnings too.")
@click.pass_obj
def validate(options: GlobalOptions, /, files: tuple[Path, ...], strict: bool) -> int:
    r"""Check each FILE: USD's own validators and the rules of usdSkin.

    Findings are printed one a line, errors first; the exit code is 4 where there are errors.

    \b
    Example:
        usdskin validate light.usda skin.usda shot.usda
    """
    reporter = Reporter(options)
    from usdskin.validate import validate as check

    failed = False
    for file in files:
        found = check(file)
        failed |= any(item.severity == "error" for item in found)
        failed |= strict and any(item.severity == "warning" for item in found)
        for item in found:
            if reporter.json:
                reporter.event("finding", file=str(file), **dataclasses.asdict(item))
            elif item.severity != "info" or reporter.verbose:
                click.echo(str(item))
        if not found and not reporter.json and not reporter.quiet:
            click.echo(f"{file}: nothing found", err=True)
    return EXIT_FINDINGS if failed else EXIT_OK


MAKING: tuple[click.Command, ...] = (new, import_)
READING = (info, validate)
