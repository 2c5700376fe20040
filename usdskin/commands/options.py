"""Options that every command takes, and kinds of values that click lacks."""

from __future__ import annotations

import re
from typing import Any

import click

from usdskin.commands.reporter import GlobalOptions


def global_options(*, hidden: bool) -> list[click.Option]:
    """Return the global options, for the group (shown) or a command (accepted, not shown)."""
    shared: dict[str, Any] = {"expose_value": False, "callback": _store, "hidden": hidden}
    return [
        click.Option(["-v", "--verbose"], is_flag=True, help="Tell more: timings.", **shared),
        click.Option(
            ["-q", "--quiet"],
            is_flag=True,
            help="Show no progress and no summary of the result.",
            **shared,
        ),
        click.Option(
            ["--json"], is_flag=True, help="Print one JSON object per line on stdout.", **shared
        ),
        click.Option(
            ["--threads"],
            type=click.IntRange(min=1),
            metavar="N",
            help="CPU threads to use.  [default: all]",
            **shared,
        ),
        click.Option(
            ["--device"],
            type=device_name,
            metavar="auto|cpu|cuda:N",
            help="Where to compute.  [default: auto]",
            **shared,
        ),
    ]


def _store(context: click.Context, option: click.Parameter, value: Any) -> None:
    if value and option.name is not None:
        setattr(context.ensure_object(GlobalOptions), option.name, value)


def device_name(value: str) -> str:
    """Check a device's name; whether it exists is for the step to find out."""
    if not re.fullmatch(r"auto|cpu|cuda(:\d+)?", value):
        raise click.BadParameter(f"{value!r} is not auto, cpu or cuda:N.")
    return "cuda:0" if value == "cuda" else value


def exposure(value: str) -> float | str:
    """Return ``auto`` or a number of stops."""
    if value == "auto":
        return "auto"
    try:
        stops = float(value)
    except ValueError:
        stops = float("nan")
    if not abs(stops) <= 100.0:
        raise click.BadParameter(f"{value!r} is neither auto nor a number of stops.")
    return stops


def names(value: str) -> tuple[str, ...]:
    """Return the names between commas, without the spaces around them."""
    given = tuple(name.strip() for name in value.split(","))
    if not all(given):
        raise click.BadParameter(f"{value!r} has an empty name in it.")
    return given


def with_paragraph_marks(help_text: str | None) -> str | None:
    r"""Return the help with ``\b`` of a raw docstring as the control character click looks for."""
    return None if help_text is None else help_text.replace("\\b\n", "\b\n")


class StepCommand(click.Command):
    """A command that also takes the global options after its name."""

    def __init__(self, *args: Any, **settings: Any) -> None:
        """Add the options."""
        super().__init__(*args, **settings)
        self.help = with_paragraph_marks(self.help)
        self.params.extend(global_options(hidden=True))


class StepGroup(click.Group):
    """Commands that share a name; without one of them it shows its help, as ``usdskin`` does."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Ask for the help where nothing is asked for."""
        return super().parse_args(ctx, args or ["--help"])


class RenderCommand(StepCommand):
    """A command whose ``--spectral`` may stand alone before an argument."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Give a bare ``--spectral`` its value, lest click take the argument after it."""
        return super().parse_args(ctx, [*_with_spectral_value(args)])


def _with_spectral_value(args: list[str]) -> list[str]:
    given: list[str] = []
    for index, argument in enumerate(args):
        if argument == "--":
            return given + args[index:]
        following = args[index + 1] if index + 1 < len(args) else ""
        bare = argument == "--spectral" and following not in ("factorised", "brute")
        given.append("--spectral=factorised" if bare else argument)
    return given
