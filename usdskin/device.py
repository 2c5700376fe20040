"""The device a step computes on, and its threads."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, ThreadPoolExecutor, wait
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.errors import DeviceError


@dataclass(frozen=True, slots=True)
class Workers:
    """Where kernels run, and how many launches run at once."""

    device: str
    """A Warp device, ``cpu`` or ``cuda:N``."""

    threads: int
    """Concurrent launches: one Warp launch on the CPU is serial and releases the GIL."""

    def run(
        self,
        count: int,
        chunk: int,
        work: Callable[[int, int], None],
        advance: Callable[[int], None] | None = None,
    ) -> None:
        """Call ``work(begin, end)`` over disjoint ranges that cover ``count`` items.

        What a range computes must not depend on the others, so that any thread count gives the
        same result. The first exception, or an interrupt, stops what has not begun.
        """
        ranges = [(begin, min(begin + chunk, count)) for begin in range(0, count, chunk)]

        def one(bounds: tuple[int, int]) -> None:
            work(*bounds)
            if advance is not None:
                advance(bounds[1] - bounds[0])

        if self.threads == 1 or len(ranges) == 1:
            for bounds in ranges:
                one(bounds)
            return
        with ThreadPoolExecutor(self.threads) as pool:
            tasks = [pool.submit(one, bounds) for bounds in ranges]
            try:
                finished, _ = wait(tasks, return_when=FIRST_EXCEPTION)
                for task in finished:
                    task.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise


@contextmanager
def _without_native_warnings() -> Iterator[None]:
    """Keep Warp's complaint about a missing CUDA driver, from native code, off stderr."""
    sys.stderr.flush()
    kept = os.dup(2)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 2)
    try:
        yield
    finally:
        os.dup2(kept, 2)
        os.close(kept)
        os.close(nowhere)


def open_workers(device: str = "auto", threads: int | None = None) -> Workers:
    """Start Warp on a device.

    Args:
        device: ``auto`` (a GPU where there is one), ``cpu`` or ``cuda:N``.
        threads: CPU threads; all cores when None.

    Raises:
        DeviceError: There is no such device, or no folder for compiled kernels.
    """
    # Warp greets on stdout, which belongs to the paths a command prints.
    wp.config.log_level = wp.LOG_ERROR
    # Concurrent launches on the CPU would share one static tile buffer: debug mode crashes.
    wp.config.enable_tiles_in_stack_memory = False
    try:
        with _without_native_warnings():
            wp.init()
    except OSError as error:
        raise DeviceError(
            f"{error.filename or 'WARP_CACHE_PATH'}: no place for compiled kernels "
            f"({error.strerror or error}); set WARP_CACHE_PATH to a folder that can be written."
        ) from None
    if device == "auto":
        device = "cuda:0" if wp.is_cuda_available() else "cpu"
    if device.startswith("cuda"):
        known = [str(cuda.alias) for cuda in wp.get_cuda_devices()]
        if device == "cuda":
            device = "cuda:0"
        if device not in known:
            raise DeviceError(
                f"--device {device}: Warp finds {', '.join(known) or 'no CUDA device'}; "
                "use --device cpu, or check the driver with `nvidia-smi`."
            )
        return Workers(device, 1)
    if device != "cpu":
        raise DeviceError(f"--device {device}: no such device; use auto, cpu or cuda:N.")
    return Workers("cpu", threads or os.cpu_count() or 1)


def copied(struct: Any, kind: Any) -> Any:
    """Return a copy of a Warp struct that shares its arrays.

    Args:
        struct: The struct.
        kind: The type it is an instance of.
    """
    result = kind()
    for name in kind.vars:
        setattr(result, name, getattr(struct, name))
    return result


def vec3(values: NDArray[Any], device: str) -> wp.array:
    """Copy values of shape [count, 3] to a device."""
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3f, device=device)


def vec4(values: NDArray[Any], device: str) -> wp.array:
    """Copy values of shape [..., 4] to a device."""
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec4f, device=device)
