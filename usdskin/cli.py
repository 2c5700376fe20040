"""The command line: ``usdskin COMMAND``, one thin command per step.

Nothing here or in ``usdskin.commands`` imports pxr, numpy or Warp before a command runs: a test
sees to it, and ``usdskin --help`` answers at once.
"""

from __future__ import annotations

import atexit
import errno
import gc
import os
import sys
import traceback
from collections.abc import Sequence
from contextlib import suppress
from typing import Any, NoReturn

import click

from usdskin import __version__
from usdskin.commands import (
    bake,
    calibrate,
    capture,
    compare,
    estimate,
    files,
    goniometer,
    ingest,
    photograph,
    photograph_skin,
    pictures,
    plot,
    prove,
    report,
    solve,
    system,
)
from usdskin.commands.options import StepCommand, global_options, with_paragraph_marks
from usdskin.commands.reporter import GlobalOptions, print_event
from usdskin.errors import EXIT_DEVICE, EXIT_INPUT, EXIT_INTERNAL, EXIT_OK, EXIT_USAGE, UsdSkinError
from usdskin.stops import Stops, TerminatedError

EXIT_INTERRUPTED = 130
EXIT_BROKEN_PIPE = 141
EXIT_TERMINATED = 143

_ENVIRONMENT_ERRORS = {
    errno.EACCES,
    errno.EPERM,
    errno.EROFS,
    errno.ENOSPC,
    errno.EDQUOT,
    errno.EISDIR,
    errno.ENOTDIR,
    errno.ENAMETOOLONG,
}
"""What a user can mend outside the program; any other OSError is a bug of ours."""


_FULL = {errno.ENOSPC, errno.EDQUOT}

_ALLOCATIONS = 10_000
"""Objects between two searches for cycles: imports make 300 000 that stay."""


class UsdSkinGroup(click.Group):
    """The commands, in the order data flows."""

    command_class = StepCommand

    def __init__(self, *args: Any, **settings: Any) -> None:
        """Add the global options."""
        super().__init__(*args, **settings)
        self.help = with_paragraph_marks(self.help)
        self.params.extend(global_options(hidden=False))

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names in the order they were added."""
        return list(self.commands)


@click.group(
    cls=UsdSkinGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
)
@click.version_option(__version__, prog_name="usdskin", message="%(prog)s %(version)s")
def cli() -> None:
    r"""Spectral pictures of human skin under measured light, through USD layers.

    \b
    Example:
        usdskin render stages/sphere/sphere.usda sphere.exr --spectral
    """


for _command in (
    *files.MAKING,
    *solve.COMMANDS,
    *photograph.COMMANDS,
    *photograph_skin.COMMANDS,
    *goniometer.COMMANDS,
    *ingest.COMMANDS,
    *capture.COMMANDS,
    *calibrate.COMMANDS,
    *estimate.COMMANDS,
    *bake.COMMANDS,
    *pictures.COMMANDS,
    *compare.COMMANDS,
    *plot.COMMANDS,
    *prove.COMMANDS,
    *report.COMMANDS,
    *files.READING,
    *system.COMMANDS,
):
    cli.add_command(_command)


def run(stops: Stops | None = None) -> NoReturn:
    """Run the command line and end the process with its exit code.

    What asked to be told of the end is told, but memory goes with the process: to free the objects
    of Warp and pxr one by one takes a third of a second.

    Args:
        stops: Heard a Ctrl-C that came before.
    """
    code: list[int] = []

    def end() -> None:
        if code:
            with suppress(OSError):  # the interpreter says what is wrong with an output
                sys.stdout.flush()
                sys.stderr.flush()
                os._exit(code[0])

    atexit.register(end)  # the first registered is the last called
    gc.set_threshold(_ALLOCATIONS)
    code.append(main(stops=stops))
    sys.exit(code[0])


def main(arguments: Sequence[str] | None = None, stops: Stops | None = None) -> int:
    """Run one command and return its exit code (see ``usdskin.errors``).

    Args:
        arguments: Command line without the program's name; ``sys.argv`` by default.
        stops: Hears Ctrl-C and SIGTERM since before the call, if anything does.
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    as_json = "--json" in given
    try:
        with stops or Stops():
            return _run(given)
    except KeyboardInterrupt as stop:
        return _fail(as_json, "Interrupted", _with_notes("interrupted.", stop), EXIT_INTERRUPTED)
    except TerminatedError as stop:
        return _fail(as_json, "Terminated", _with_notes("terminated.", stop), EXIT_TERMINATED)
    except UsdSkinError as error:
        return _fail(as_json, type(error).__name__, str(error), error.exit_code)
    except click.UsageError as error:
        return _fail(as_json, "UsageError", _usage_message(error), EXIT_USAGE)
    except click.ClickException as error:
        return _fail(as_json, type(error).__name__, error.format_message(), EXIT_INPUT)
    except MemoryError:
        message = "not enough memory; render fewer pixels, bands or samples."
        return _fail(as_json, "MemoryError", message, EXIT_DEVICE)
    except BrokenPipeError:
        # Whoever read our output has gone; the interpreter must not flush into the void at exit.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return EXIT_BROKEN_PIPE
    except OSError as error:
        if error.errno in _FULL and error.filename is None:  # as of standard output
            return _fail(as_json, "OSError", f"{error.strerror}; free some space.", EXIT_INPUT)
        if error.errno not in _ENVIRONMENT_ERRORS or error.filename is None:
            return _crash(as_json, error)
        return _fail(as_json, "OSError", f"{error.filename}: {error.strerror}.", EXIT_INPUT)
    except Exception as error:
        return _crash(as_json, error)


def _run(arguments: list[str]) -> int:
    # Not cli.main(): it turns an EOFError anywhere into "Aborted!".
    if not arguments:
        arguments = ["--help"]
    try:
        _complete_shell()
        with cli.make_context("usdskin", arguments, obj=GlobalOptions()) as context:
            result: Any = cli.invoke(context)
            sys.stdout.flush()
            return result if isinstance(result, int) else EXIT_OK
    except click.exceptions.Exit as request:
        return request.exit_code


def _complete_shell() -> None:
    instruction = os.environ.get("_USDSKIN_COMPLETE")
    if instruction:
        from click.shell_completion import shell_complete

        raise click.exceptions.Exit(
            shell_complete(cli, {}, "usdskin", "_USDSKIN_COMPLETE", instruction)
        )


def _with_notes(message: str, stop: BaseException) -> str:
    """Return a message with what was told on the way out, such as what was kept."""
    return " ".join([message, *getattr(stop, "__notes__", ())])


def _usage_message(error: click.UsageError) -> str:
    where = error.ctx.command_path if error.ctx is not None else "usdskin"
    return f"{error.format_message()} See '{where} --help'."


def _fail(as_json: bool, kind: str, message: str, code: int) -> int:
    line = " ".join(message.split())
    print(f"usdskin: error: {line}", file=sys.stderr)
    if as_json:
        print_event("error", kind=kind, message=line, exit_code=code)
    return code


def _crash(as_json: bool, error: Exception) -> int:
    traceback.print_exception(error)
    if as_json:
        message = " ".join(str(error).split())
        print_event("error", kind=type(error).__name__, message=message, exit_code=EXIT_INTERNAL)
    return EXIT_INTERNAL
