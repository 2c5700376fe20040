"""Compare our panorama with OpenCV's remap: ``python -m benchmarks.panorama [--quick]``.

Four views of 20 megapixels become one panorama of 4096 x 2048, by us and by OpenCV, with 16
samples per texel and the same threads, each in a process of its own, in turn. OpenCV's maps, 1 GB
per view, hold for one view only, so making them is part of its job; rows without that are there to
compare the sampling alone.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.compose_views import LAMP, LAMP_DEG, lamps
from benchmarks.measure import machine, run_job
from benchmarks.report import Row, Section, as_markdown, as_text, write_json

COLUMNS = ("", "ours", "OpenCV", "ratio", "bar")
VIEW = (5472, 3648)
HEIGHT = 2048
MEMORY_MB = 1500.0


def lamp_errors(values: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the relative errors of the lamps' fluxes, shape [lamps]."""
    from usdskin.latlong import texel_directions, texel_solid_angles

    height, width = values.shape[:2]
    solid_angle = texel_solid_angles(height, width)[:, None]
    directions = texel_directions(height, width).astype(np.float32)
    expected = float(LAMP[1]) * 2.0 * np.pi * (1.0 - np.cos(np.radians(0.5 * LAMP_DEG)))
    found = []
    for lamp in lamps():
        near = directions @ lamp.astype(np.float32) > np.cos(np.radians(2.0 * LAMP_DEG))
        excess = np.where(near, values[..., 1].astype(np.float64) - 1.0, 0.0)
        found.append((excess * solid_angle).sum() / expected - 1.0)
    return np.array(found)


def timing(ours: dict[str, Any], theirs: dict[str, Any]) -> list[Row]:
    """Compare the seconds; medians over the laps."""
    mine = median(lap["views"] + lap["finish"] for lap in ours["laps"])
    whole = median(lap["maps"] + lap["remap"] + lap["mean"] for lap in theirs["laps"])
    given = median(lap["remap"] + lap["mean"] for lap in theirs["laps"])
    cpu = [median(lap["cpu"] for lap in each["laps"]) for each in (ours, theirs)]
    cpu.append(median(lap["cpu without maps"] for lap in theirs["laps"]))
    finish = median(lap["finish"] for lap in ours["laps"])
    return [
        _row("four views to a panorama", mine, whole, " s", ">= 1x"),
        _row("  OpenCV, were its maps given", mine, given, " s"),
        _row("processor time of that", cpu[0], cpu[1], " s"),
        _row("  OpenCV, were its maps given", cpu[0], cpu[2], " s"),
        Row("of ours: dividing by the weights", f"{finish:.2f} s"),
        Row("peak memory, one view held", f"{ours['peak_mb']:.0f} MB",
            f"{theirs['peak_mb']:.0f} MB", f"{theirs['peak_mb'] / ours['peak_mb']:.2f}x",
            f"<= {MEMORY_MB:.0f} MB", ours["peak_mb"] <= MEMORY_MB),
    ]  # fmt: skip


def _row(what: str, mine: float, other: float, unit: str, bar: str = "") -> Row:
    ratio = other / mine
    met = ratio >= 1.0 if bar else None
    return Row(what, f"{mine:.2f}{unit}", f"{other:.2f}{unit}", f"{ratio:.2f}x", bar, met)


def errors(folder: Path, ours: dict[str, Any]) -> list[Row]:
    """Compare what became of the light."""
    mine, other = (lamp_errors(np.load(folder / f"{name}.npy")) for name in ("ours", "opencv"))
    worst = [float(np.abs(each).max()) for each in (mine, other)]
    flux = max(ours["flux_errors"])
    return [
        Row("lamps of 0.5 degrees, largest error of flux", f"{worst[0]:.2e}", f"{worst[1]:.2e}",
            f"{worst[1] / worst[0]:.1f}x", "<= 1e-2", worst[0] <= 1e-2),
        Row("flux of a view, largest error", f"{flux:.2e}", "", "", "<= 1e-3", flux <= 1e-3),
    ]  # fmt: skip


def main() -> int:
    """Run it and print the table; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.panorama", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="no medians")
    parser.add_argument("--threads", type=int, default=2, help="threads of each")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the table")
    given = parser.parse_args()
    about = machine()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        measured: dict[str, Any] = {}
        for _ in range(1 if given.quick else 3):  # in turn: a slow minute hits both
            for what in ("ours", "opencv"):
                picture = str(folder / f"{what}.npy")
                job = {"what": what, "view": VIEW, "height": HEIGHT, "picture": picture}
                found = run_job("compose_views", folder, **job, threads=given.threads, repeats=1)
                print(f"  {what}: {found['laps'][0]}", file=sys.stderr, flush=True)
                kept = measured.setdefault(what, found)
                if kept is not found:
                    kept["laps"] += found["laps"]
        rows = timing(measured["ours"], measured["opencv"])
        rows += errors(folder, measured["ours"])
    title = f"4 views of {VIEW[0]} x {VIEW[1]}, panorama {2 * HEIGHT} x {HEIGHT}, "
    sections = [Section(f"{title}{given.threads} threads", COLUMNS, rows)]
    print(as_text(about, sections))
    if given.markdown:
        given.markdown.write_text(as_markdown(about, sections))
    if given.json:
        write_json(given.json, about, sections, measured)
    return 1 if any(row.is_met is False for row in rows) else 0


if __name__ == "__main__":
    sys.exit(main())
