"""Progress of a long step: a bar on a terminal, plain lines elsewhere, events with ``--json``."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Protocol, TextIO


class Progress(Protocol):
    """What a step tells while it works. ``advance`` may be called from any thread."""

    def start(self, total: int, label: str) -> None:
        """Begin one piece of work of ``total`` units; ends the piece before it."""

    def advance(self, count: int = 1) -> None:
        """Count ``count`` more units as done."""

    def done(self) -> None:
        """End the piece of work; harmless when none is under way."""


class SilentProgress:
    """Says nothing."""

    def start(self, total: int, label: str) -> None:
        """Ignore the piece of work."""

    def advance(self, count: int = 1) -> None:
        """Ignore the units."""

    def done(self) -> None:
        """Ignore the end."""


class SteppedProgress:
    """Reports at most once every tenth of the work and interval, and at the end of the work."""

    def __init__(
        self,
        report: Callable[[str, int, int, float], None],
        clock: Callable[[], float] = time.monotonic,
        interval_s: float = 0.0,
    ) -> None:
        """Set up the progress.

        Args:
            report: Called with the label, the units done, the total and the time passed [s].
            clock: Gives the time [s].
            interval_s: Least time between reports [s].
        """
        self._report = report
        self._clock = clock
        self._interval_s = interval_s
        self._lock = threading.Lock()
        self._total = 0

    def start(self, total: int, label: str) -> None:
        """Begin one piece of work of ``total`` units; ends the piece before it."""
        self.done()
        with self._lock:
            self._total, self._label = max(total, 1), label
            self._count, self._told = 0, 0
            self._began = self._last = self._clock()

    def advance(self, count: int = 1) -> None:
        """Count ``count`` more units as done."""
        with self._lock:
            if not self._total:
                return
            self._count = min(self._count + count, self._total)
            tenth, now = 10 * self._count // self._total, self._clock()
            due = self._count == self._total or now - self._last >= self._interval_s
            if tenth > self._told and due:
                self._told, self._last = tenth, now
                self._report(self._label, self._count, self._total, now - self._began)

    def done(self) -> None:
        """End the piece of work; harmless when none is under way."""
        with self._lock:
            self._total = 0


class PlainProgress(SteppedProgress):
    """Lines of text, for logs and pipes."""

    def __init__(self, stream: TextIO, clock: Callable[[], float] = time.monotonic) -> None:
        """Write the lines to ``stream``."""
        super().__init__(self._print, clock, interval_s=1.0)
        self._stream = stream

    def _print(self, label: str, count: int, total: int, seconds: float) -> None:
        left = seconds * (total - count) / count
        ending = f"{left:.0f} s left" if count < total else "done"
        self._stream.write(f"{label}: {100 * count // total:3d} %  {seconds:.1f} s, {ending}\n")
        self._stream.flush()


class JsonProgress(SteppedProgress):
    """Events, for programs."""

    def __init__(
        self, emit: Callable[[dict[str, Any]], None], clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Hand the events to ``emit``."""
        super().__init__(self._emit_event, clock)
        self._emit = emit

    def _emit_event(self, label: str, count: int, total: int, seconds: float) -> None:
        self._emit(
            {
                "label": label,
                "done": count,
                "total": total,
                "seconds": round(seconds, 3),
            }
        )


class TerminalProgress:
    """A bar with rate and remaining time."""

    def __init__(self, stream: TextIO) -> None:
        """Draw the bar on ``stream``."""
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

        self._bar = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn("{task.percentage:3.0f} %"),
            TextColumn("{task.fields[rate]}"),
            TimeRemainingColumn(elapsed_when_finished=True),
            console=Console(file=stream),
            transient=True,
        )
        self._task: Any = None

    def start(self, total: int, label: str) -> None:
        """Begin one piece of work of ``total`` units; ends the piece before it."""
        self.done()
        self._bar.start()
        self._task = self._bar.add_task(label, total=total, rate="")

    def advance(self, count: int = 1) -> None:
        """Count ``count`` more units as done."""
        if self._task is None:
            return
        self._bar.advance(self._task, count)
        speed = self._bar.tasks[-1].speed
        if speed:
            self._bar.update(self._task, rate=format_rate(speed))

    def done(self) -> None:
        """End the piece of work; harmless when none is under way."""
        if self._task is not None:
            self._bar.stop()
            self._bar.remove_task(self._task)
            self._task = None


def format_rate(per_second: float) -> str:
    """Return a rate with the prefix that keeps it readable, such as ``3.2 M/s``."""
    for factor, prefix in ((1e9, "G"), (1e6, "M"), (1e3, "k")):
        if per_second >= factor:
            return f"{per_second / factor:.1f} {prefix}/s"
    return f"{per_second:.1f} /s"
