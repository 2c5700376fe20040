"""Ctrl-C and SIGTERM at any time: one exception, which nothing on its way swallows.

Loads nothing heavy: a process listens before it loads its commands.
"""

from __future__ import annotations

import signal
import sys

TYPE_CHECKING = False  # as typing has it, which takes long to load
if TYPE_CHECKING:
    from types import FrameType, TracebackType
    from typing import Any

_RETRY_S = 0.01
"""Time between two looks whether a stop that waits may be raised [s]."""

_CAN_WAIT = hasattr(signal, "setitimer")  # Windows has no timers of signals


class TerminatedError(BaseException):
    """SIGTERM arrived; unwinds so that temporary files are removed."""


class Stops:
    """Raises ``KeyboardInterrupt`` or ``TerminatedError`` in the block it surrounds.

    What is raised while an extension is imported is swallowed or kills the process, and what is
    raised in ``__del__`` is lost: there a stop waits. One that was lost elsewhere, or turned into
    another error, is raised when the block ends.
    """

    def __init__(self) -> None:
        """Set up; nothing is heard yet."""
        self._asked: type[BaseException] | None = None
        self._before: dict[int, Any] = {}
        self._outside: FrameType | None = None

    def hear(self, *, last: bool = False) -> None:
        """Remember a stop from now on; the block raises it when it begins.

        A SIGINT that is ignored or somebody else's stays so, as all does outside the main thread.

        Args:
            last: Whether the process ends after the block: another Ctrl-C then kills it.
        """
        interrupt = signal.getsignal(signal.SIGINT)
        try:
            self._before[signal.SIGTERM] = signal.signal(signal.SIGTERM, self._stop)
        except ValueError:  # not the main thread: whoever owns it decides
            return
        if interrupt is signal.default_int_handler:
            signal.signal(signal.SIGINT, self._stop)
            self._before[signal.SIGINT] = signal.SIG_DFL if last else interrupt

    def __enter__(self) -> Stops:
        """Raise stops from now on, and at once what was asked for before."""
        if not self._before:
            self.hear()
        self._outside = sys._getframe(1).f_back
        if self._asked is not None:
            self._forget()
            raise self._asked
        return self

    def __exit__(
        self,
        _kind: type[BaseException] | None,
        error: BaseException | None,
        _traceback: TracebackType | None,
    ) -> None:
        """Give the signals back, and raise a stop that was lost."""
        self._forget()
        if self._asked is not None and not isinstance(error, KeyboardInterrupt | TerminatedError):
            raise self._asked from error

    def _forget(self) -> None:
        self._outside = None
        if _CAN_WAIT and signal.SIGALRM in self._before:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        for number, handler in self._before.items():
            signal.signal(number, handler)
        self._before.clear()

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._asked = KeyboardInterrupt if number == signal.SIGINT else TerminatedError
        self._raise(number, frame)

    def _raise(self, _number: int, frame: FrameType | None) -> None:
        if self._asked is None or self._outside is None:
            return
        if not (_CAN_WAIT and self._would_be_lost(frame)):
            raise self._asked
        if signal.SIGALRM not in self._before:
            self._before[signal.SIGALRM] = signal.signal(signal.SIGALRM, self._raise)
        signal.setitimer(signal.ITIMER_REAL, _RETRY_S)

    def _would_be_lost(self, frame: FrameType | None) -> bool:
        while frame is not None and frame is not self._outside:
            code = frame.f_code
            if code.co_filename.startswith("<frozen importlib") or code.co_name == "__del__":
                return True
            frame = frame.f_back
        return False
