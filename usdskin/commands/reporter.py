"""What a command says, for people or, with ``--json``, for programs.

For people, results go to stdout, everything else to stderr. With ``--json`` stdout carries one
object per line, each with an ``event``.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from usdskin.errors import FramesError, UsageError
from usdskin.progress import JsonProgress, PlainProgress, Progress, SilentProgress, TerminalProgress

if TYPE_CHECKING:
    from usdskin.notes import Note
    from usdskin.render.job import RenderReport


class StepResult(Protocol):
    """What every step that measures something returns."""

    @property
    def notes(self) -> list[Note]:
        """What could not be honoured or needs attention."""

    @property
    def seconds(self) -> dict[str, float]:
        """Time each part took [s]."""


class StepReport(Protocol):
    """What such a step found."""

    def lines(self) -> Iterable[str]:
        """Return it for people."""

    def as_dict(self) -> dict[str, Any]:
        """Return it for programs."""


@dataclass(slots=True)
class GlobalOptions:
    """The options every command takes, before or after its name."""

    verbose: bool = False
    quiet: bool = False
    json: bool = False
    threads: int | None = None
    device: str = "auto"


class Reporter:
    """Speaks for one command."""

    def __init__(self, options: GlobalOptions) -> None:
        """Choose how to speak.

        Raises:
            UsageError: Both -v and -q were given.
        """
        if options.verbose and options.quiet:
            raise UsageError("-v and -q exclude each other; give one of them.")
        self.json = options.json
        self.verbose = options.verbose
        self.quiet = options.quiet
        self._progress: Progress = SilentProgress()

    def event(self, name: str, /, **fields: Any) -> None:
        """Print one event; only with ``--json``."""
        if self.json:
            print_event(name, **fields)

    def wrote(self, paths: Iterable[Path]) -> None:
        """Tell which files were written."""
        for path in paths:
            if self.json:
                print_event("wrote", path=str(path))
            else:
                print(path, flush=True)

    def notes(self, notes: Iterable[Note]) -> None:
        """Tell what could not be honoured; never silenced, for a picture without it is wrong."""
        for note in notes:
            if self.json:
                print_event("note", code=note.code, path=note.path, message=note.message)
            else:
                print(f"usdskin: note: {note}", file=sys.stderr)

    def seconds(self, seconds: Mapping[str, float]) -> None:
        """Tell how long each part took [s]; for people only with -v."""
        if self.json:
            print_event("seconds", **seconds)
        elif self.verbose:
            for part, value in seconds.items():
                print(f"usdskin: {part}: {value:.3f} s", file=sys.stderr)

    def result(self, event: str, result: StepResult, report: StepReport) -> None:
        """Tell what a step noted, how long it took and what it found; ``wrote`` tells the files."""
        self.notes(result.notes)
        self.seconds(result.seconds)
        self.event(event, **report.as_dict())
        if not self.json and not self.quiet:
            for line in report.lines():
                print(line, file=sys.stderr)

    def progress(self) -> Progress:
        """Return the progress that suits the options and where stderr goes."""
        if self.json:
            self._progress = JsonProgress(lambda fields: print_event("progress", **fields))
        elif self.quiet:
            self._progress = SilentProgress()
        elif sys.stderr.isatty():
            self._progress = TerminalProgress(sys.stderr)
        else:
            self._progress = PlainProgress(sys.stderr)
        return self._progress

    def __enter__(self) -> Reporter:
        """Begin a step that shows progress."""
        return self

    def __exit__(self, *_error: object) -> None:
        """Take a bar that is still drawn off the terminal."""
        self._progress.done()

    def finish(self, report: RenderReport) -> None:
        """Tell what a render did.

        Raises:
            FramesError: Some frames failed.
        """
        self.notes(report.notes)
        self.seconds(report.seconds)
        self.wrote(report.paths)
        if report.failures:
            first, reason = next(iter(report.failures.items()))
            listed = ", ".join(report.failures)
            raise FramesError(f"{len(report.failures)} frames failed ({listed}); {first}: {reason}")


def print_event(name: str, /, **fields: Any) -> None:
    """Print one object on a line of its own; numbers that JSON has not are null."""
    print(json.dumps({"event": name, **_finite(fields)}, default=str), flush=True)


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return value
