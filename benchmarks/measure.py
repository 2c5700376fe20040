"""Run one measurement in a process of its own: its wall and CPU time and its peak memory."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


@dataclass(frozen=True, slots=True)
class Child:
    """What a process took."""

    wall: float
    """Start to end [s]."""

    cpu: float
    """User and system time [s]."""

    peak_mb: float
    """Largest resident set (``ru_maxrss``) [MB]."""

    output: str


def run(command: list[str], **environment: str) -> Child:
    """Run a command to its end, with bytecode kept as an installed program has it.

    Raises:
        RuntimeError: It fails; the message holds the end of what it said.
    """
    with tempfile.TemporaryFile("w+") as out, tempfile.TemporaryFile("w+") as err:
        begun = time.perf_counter()
        given = {**os.environ, "PYTHONDONTWRITEBYTECODE": "", **environment}
        child = subprocess.Popen(command, stdout=out, stderr=err, cwd=ROOT, env=given)
        _, status, usage = os.wait4(child.pid, 0)
        wall = time.perf_counter() - begun
        child.returncode = os.waitstatus_to_exitcode(status)
        out.seek(0)
        err.seek(0)
        if child.returncode:
            said = err.read()[-2000:]
            raise RuntimeError(f"{' '.join(command)} exits with {child.returncode}:\n{said}")
        return Child(wall, usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1000.0, out.read())


def run_job(module: str, folder: Path, **job: Any) -> dict[str, Any]:
    """Run ``benchmarks.<module>`` on a job; return what it prints, with ``peak_mb``."""
    path = folder / "job.json"
    path.write_text(json.dumps(job))
    child = run([sys.executable, "-m", f"benchmarks.{module}", str(path)])
    result = [line for line in child.output.splitlines() if line.startswith("{")][-1]
    return {**json.loads(result), "peak_mb": child.peak_mb}


def middle(result: dict[str, Any], what: str) -> float:
    """Return the median over a result's laps."""
    return median(lap[what] for lap in result["laps"])


def fastest(result: dict[str, Any], what: str) -> float:
    """Return the smallest of a result's laps: for close ratios of ours, which noise would bury."""
    return float(min(lap[what] for lap in result["laps"]))


def machine() -> dict[str, str]:
    """Describe where and on what this runs."""
    from importlib.metadata import version

    model = platform.processor()
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        model = next(line.split(": ")[1] for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    names = ("usdskin", "warp-lang", "usd-core", "mitsuba", "drjit", "numpy")
    return {
        "processor": f"{model}, {os.cpu_count()} cores",
        "load before": " ".join(f"{load:.2f}" for load in os.getloadavg()),
        "python": platform.python_version(),
        "packages": ", ".join(f"{name} {version(name)}" for name in names),
    }
