"""``warmup``, ``schema-path`` and ``doctor``: what a machine and its other programs need."""

from __future__ import annotations

import os
import platform
import sys
from typing import Any

import click

from usdskin.commands.options import StepCommand
from usdskin.commands.reporter import GlobalOptions, Reporter
from usdskin.errors import EXIT_FINDINGS

_REQUIRED = (
    ("click", "click"),
    ("numpy", "numpy"),
    ("usd-core", "pxr.Usd"),
    ("warp-lang", "warp"),
    ("OpenEXR", "OpenEXR"),
    ("OpenImageIO", "OpenImageIO"),
    ("opencolorio", "PyOpenColorIO"),
)
"""Distribution and the module that shows whether it loads."""

_OPTIONAL = (("open3d", "open3d"),)


@click.command("schema-path", cls=StepCommand)
@click.pass_obj
def schema_path(options: GlobalOptions, /) -> None:
    r"""Print the schema's folder, for other USD programs.

    \b
    Example:
        PXR_PLUGINPATH_NAME=$(usdskin schema-path) usdview shot.usda
    """
    from usdskin import plugin_path

    reporter = Reporter(options)
    if reporter.json:
        reporter.event("schema-path", path=plugin_path())
    else:
        click.echo(plugin_path())


@click.command("doctor", cls=StepCommand)
@click.pass_obj
def doctor(options: GlobalOptions, /) -> int:
    r"""Show versions and devices, and whether everything loads.

    The exit code is 4 where something that is needed does not load.

    \b
    Example:
        usdskin doctor
    """
    from usdskin import __version__

    reporter = Reporter(options)
    failed = False

    def tell(what: str, value: str) -> None:
        if reporter.json:
            reporter.event("doctor", what=what, value=value)
        else:
            click.echo(f"{what + ':':14} {value}")

    tell("usdskin", __version__)
    tell("python", f"{platform.python_version()} ({sys.executable})")
    tell("system", f"{platform.platform()}, {os.cpu_count()} CPUs")
    for needed, packages in ((True, _REQUIRED), (False, _OPTIONAL)):
        for distribution, module in packages:
            state, loads = _state(distribution, module, needed)
            failed |= needed and not loads
            tell(distribution, state)
    for what, value in _warp_facts():
        tell(what, value)
    return EXIT_FINDINGS if failed else 0


@click.command("warmup", cls=StepCommand)
@click.pass_obj
def warmup(options: GlobalOptions, /) -> None:
    r"""Compile every kernel for this machine, so that the first picture need not wait for it.

    Prints the time each module of kernels took and the folder they are kept in. Once is enough
    for a version of usdskin and of Warp on one kind of processor.

    \b
    Examples:
        usdskin warmup
        WARP_CACHE_PATH=/shared/kernels usdskin warmup --device cpu
    """
    reporter = Reporter(options)
    import time

    from usdskin.compilation import cache_folder, warm_up
    from usdskin.device import open_workers

    begun = time.perf_counter()
    compiled, lines = 0, []
    with reporter:
        device = open_workers(options.device).device
        for kernels in warm_up(device, options.threads, reporter.progress()):
            compiled += kernels.compiled
            reporter.event(
                "kernels",
                module=kernels.name,
                compiled=kernels.compiled,
                seconds=round(kernels.seconds, 3),
            )
            done = f"compiled in {kernels.seconds:.1f} s" if kernels.compiled else "ready"
            lines.append(f"{kernels.name + ':':18} {done}")
    seconds = time.perf_counter() - begun
    if reporter.json:
        reporter.event(
            "warmup",
            device=device,
            compiled=compiled,
            seconds=round(seconds, 3),
            cache=str(cache_folder()),
        )
    else:
        click.echo("\n".join(lines))
        what = f"{compiled} modules compiled" if compiled else "all was ready"
        click.echo(f"{what} for {device} ({seconds:.1f} s); kept in {cache_folder()}")


def _state(distribution: str, module: str, needed: bool) -> tuple[str, bool]:
    from importlib import import_module, metadata  # 30 ms that --help does not need

    try:
        version = metadata.version(distribution)
    except metadata.PackageNotFoundError:
        return ("missing" if needed else "not installed (optional)"), False
    if not needed:
        return version, True  # a second's import; the command that uses it says what is missing
    try:
        import_module(module)
    except Exception as error:
        reason = " ".join(str(error).split())
        return f"{version}, does not load: {reason}", False
    return version, True


def _warp_facts() -> list[tuple[str, str]]:
    from importlib import import_module

    try:
        from usdskin.device import open_workers

        warp: Any = import_module("warp")
    except ImportError:
        return []
    open_workers("cpu")  # starts Warp without its greeting
    facts = [("device", f"{device.alias} ({device.name})") for device in warp.get_devices()]
    return [*facts, ("kernel cache", str(warp.config.kernel_cache_dir))]


COMMANDS = (warmup, schema_path, doctor)
