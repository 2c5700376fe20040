"""Writes a frame's files while the next frame is rendered."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType

from usdskin.errors import UsdSkinError

OVERLAP_BYTES = 512 * 2**20
"""A larger picture is written before the next begins: both would be in memory."""


class FrameWriter:
    """One thread that writes, at most one picture behind.

    Pictures are written in the order in which they are given. When the block ends, by an interrupt
    too, what was given has been written.
    """

    def __init__(self, failed: Callable[[float | None, str], None] | None) -> None:
        """Set the writer up.

        Args:
            failed: Told of a frame whose files could not be written, and why; without it, the
                error is raised.
        """
        self._failed = failed
        self._pool = ThreadPoolExecutor(1)
        self._pending: tuple[float | None, Future[None]] | None = None

    def __enter__(self) -> FrameWriter:
        """Begin."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        """Wait for what is being written; its error counts where there is no other."""
        self._pool.shutdown(wait=True)
        if error is None:
            self.settle()

    def put(self, frame: float | None, size: int, write: Callable[[], None]) -> None:
        """Write a picture beside what comes next; wait for the one before.

        Args:
            frame: Its frame.
            size: Bytes of its arrays.
            write: Writes it.
        """
        self.settle()
        self._pending = frame, self._pool.submit(write)
        if size > OVERLAP_BYTES:
            self.settle()

    def settle(self) -> None:
        """Wait for what is being written, and tell of its error."""
        if self._pending is None:
            return
        (frame, written), self._pending = self._pending, None
        try:
            written.result()
        except UsdSkinError as error:
            if self._failed is None:
                raise
            self._failed(frame, str(error))
