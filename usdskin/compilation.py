"""Compiled kernels: found, compiled ahead and side by side, waited for where they are used.

Warp compiles a module of kernels at its first use on a machine and keeps it in a cache, under a
hash of its source. That takes seconds, in native code without the GIL: several modules compile at
once in threads, beside the reading of a stage (docs/decisions.md has the figures).
"""

from __future__ import annotations

import importlib
import inspect
import os
import pkgutil
import sys
import threading
import time
from collections.abc import Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, as_completed
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import warp as wp

from usdskin.errors import DeviceError
from usdskin.progress import Progress

PACKAGE = "usdskin.warp_kernels"

COMPILING = "compile kernels (once)"
"""What progress calls the wait."""

_MOST_COMPILERS = 4
"""A compiler takes up to 300 MB, and the longest module bounds the whole."""


@dataclass(frozen=True, slots=True)
class LoadedKernels:
    """One module of kernels, ready on a device."""

    name: str
    """The module's name in its package."""

    compiled: bool
    """Whether the cache did not have it."""

    seconds: float
    """Time to compile or load it [s]."""


class _Wait:
    """The progress of several modules; says nothing once it is over."""

    def __init__(self, progress: Progress, count: int) -> None:
        self._progress, self._lock, self._open = progress, threading.Lock(), count > 0
        if count:
            progress.start(count, COMPILING)

    def advance(self) -> None:
        """Count one module as compiled."""
        with self._lock:
            if self._open:
                self._progress.advance()

    def end(self) -> None:
        """End the piece of work, so that another may begin."""
        with self._lock:
            if self._open:
                self._open = False
                self._progress.done()


_pending: dict[tuple[str, str], Future[LoadedKernels]] = {}
_waits: list[_Wait] = []


def kernel_modules() -> tuple[ModuleType, ...]:
    """Return every module of the package that defines kernels, the costliest to compile first."""
    package = importlib.import_module(PACKAGE)
    names = [entry.name for entry in pkgutil.walk_packages(package.__path__, f"{PACKAGE}.")]
    modules = [importlib.import_module(name) for name in sorted(names)]
    return _costliest_first(m for m in modules if wp.get_module(m.__name__).kernels)


def kernel_module(name: str) -> ModuleType:
    """Return a module of the package, imported only now: Warp parses each function as it is."""
    return importlib.import_module(f"{PACKAGE}.{name}")


def is_compiled(module: ModuleType, device: str) -> bool:
    """Return whether the cache has a module for a device; False where Warp does not tell."""
    target = wp.get_device(device)
    try:  # not of Warp's public interface: a version without it only costs the forecast
        kernels = wp.get_module(module.__name__)
        block = 1 if target.is_cpu else kernels.options["block_dim"]
        folder = Path(wp.config.kernel_cache_dir) / kernels.get_module_identifier(block)
        return bool((folder / kernels._get_compile_output_name(target, block_dim=block)).is_file())
    except (AttributeError, KeyError, TypeError):
        return False


def begin(modules: Sequence[ModuleType], device: str, progress: Progress) -> None:
    """Start to compile modules that the cache lacks, beside whatever the caller does next.

    Args:
        modules: Modules of kernels that will be needed, in the order of need.
        device: Where they will run.
        progress: Shows the wait, until ``finish``; silent where nothing is to be compiled.
    """
    missing = [
        module
        for module in modules
        if (module.__name__, device) not in _pending and not is_compiled(module, device)
    ]
    if not missing or not _compiles_in_threads():
        return
    wait = _Wait(progress, len(missing))
    _waits.append(wait)
    pool = ThreadPoolExecutor(_compilers(len(missing)), "compile")
    for module in missing:
        task = pool.submit(_load, module, device)
        task.add_done_callback(lambda _task: wait.advance())
        _pending[module.__name__, device] = task
    pool.shutdown(wait=False)


def load(module: ModuleType, device: str) -> None:
    """Have a module ready on a device: once, before threads ask for it together.

    Raises:
        DeviceError: It cannot be compiled, or the cache cannot be written.
    """
    task = _pending.get((module.__name__, device))
    if task is None:
        _load(module, device)
    else:
        task.result()


def prepare(modules: Sequence[ModuleType], device: str, progress: Progress) -> None:
    """Compile modules that the cache lacks, side by side, and return when they are ready.

    Raises:
        DeviceError: A module cannot be compiled, or the cache cannot be written.
    """
    begin(modules, device, progress)
    finish()


def finish() -> None:
    """Wait for what ``begin`` started, and end its progress.

    Raises:
        DeviceError: A module cannot be compiled, or the cache cannot be written.
    """
    tasks = list(_pending.values())
    try:
        for task in tasks:
            task.result()
    finally:
        abandon()


def abandon() -> None:
    """Compile no more of what ``begin`` started than is under way, and end its progress."""
    for wait in _waits:
        wait.end()
    _waits.clear()
    for task in _pending.values():
        task.cancel()
    _pending.clear()


def warm_up(device: str, threads: int | None, progress: Progress) -> Iterator[LoadedKernels]:
    """Compile or load every module for a device, and give each as it is ready.

    Args:
        device: Where the kernels will run.
        threads: How many to compile at once; as many as there are cores, up to 4, when None.
        progress: Told about the modules that are compiled.

    Raises:
        DeviceError: A module cannot be compiled, or the cache cannot be written.
    """
    modules = kernel_modules()
    missing = [module for module in modules if not is_compiled(module, device)]
    wait = _Wait(progress, len(missing))
    with ThreadPoolExecutor(threads or _compilers(len(missing)), "compile") as pool:
        tasks = [pool.submit(_load, module, device) for module in modules]
        try:
            for task in as_completed(tasks):
                loaded = task.result()
                if loaded.compiled:
                    wait.advance()
                yield loaded
        finally:
            wait.end()
            pool.shutdown(wait=False, cancel_futures=True)


def cache_folder() -> Path:
    """Return the folder of the compiled kernels."""
    return Path(wp.config.kernel_cache_dir)


def _load(module: ModuleType, device: str) -> LoadedKernels:
    begun = time.perf_counter()
    compiled = not is_compiled(module, device)
    name = module.__name__.removeprefix(f"{PACKAGE}.")
    try:
        wp.load_module(module.__name__, device)
    except OSError as error:
        raise DeviceError(
            f"{cache_folder()}: kernel module {name} cannot be kept there "
            f"({error.strerror or error}); free space, or set WARP_CACHE_PATH to a folder that "
            "can be written."
        ) from None
    except Exception as error:  # Warp raises a bare Exception where its compiler fails
        if "build failed" not in str(error):
            raise
        raise DeviceError(
            f"kernel module {name} cannot be compiled for {device} ({error}); `usdskin doctor` "
            "shows what Warp finds here."
        ) from error
    return LoadedKernels(name, compiled, time.perf_counter() - begun)


def _compilers(count: int) -> int:
    if not _compiles_in_threads():
        return 1
    return max(1, min(count, os.cpu_count() or 1, _MOST_COMPILERS))


def _compiles_in_threads() -> bool:
    """Return whether this Warp compiles several modules at once."""
    return "max_workers" in inspect.signature(wp.load_module).parameters


def _costliest_first(modules: Iterable[ModuleType]) -> tuple[ModuleType, ...]:
    """Sort by the source each module and those it takes functions from have: all is compiled."""

    def cost(module: ModuleType) -> int:
        return sum(len(inspect.getsource(part)) for part in _with_parts(module, {}).values())

    return tuple(sorted(modules, key=lambda module: (-cost(module), module.__name__)))


def _with_parts(module: ModuleType, found: dict[str, ModuleType]) -> dict[str, ModuleType]:
    found[module.__name__] = module
    for value in vars(module).values():
        name = value.func.__module__ if isinstance(value, wp.Function) else ""
        if name.startswith(PACKAGE) and name not in found:
            _with_parts(sys.modules[name], found)
    return found
