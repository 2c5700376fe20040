"""Time and memory of a whole ``usdskin capture``: ``python -m benchmarks.capture [--quick]``.

Four views of nine 16-bit TIFF files of 20 megapixels become a panorama of 4096 x 2048. All views
name the same nine files, which saves the disk and no work: each view reads, merges and composes
them anew. README.md beside this file says what the rows mean.
"""

from __future__ import annotations

import argparse
import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.measure import Child, machine, run
from benchmarks.merge import BLACK, QUICK_SIZE, SIZE, TIMES, WHITE, write_bracket
from benchmarks.report import Row, Section, as_markdown, as_text, write_json

MEMORY_BAR_MB = 2000.0


def write_shoot(folder: Path, size: tuple[int, int]) -> Path:
    """Write a shoot of three level views and one to the zenith, and its photographs."""
    from usdskin.prims import (
        ExposureBracket,
        FisheyeLens,
        write_bracket,
        write_lens,
        write_rotation,
    )

    # isort: split
    from pxr import Usd, UsdGeom

    height, width = size
    lens = FisheyeLens(
        projection="equidistant",
        focal_length_px=height / np.pi,
        center_px=np.array([0.5 * width, 0.5 * height]),
        resolution=(width, height),
        vignetting=np.array([-0.04, -0.012]),
        glare=0.01,
    )
    count = len(TIMES)
    bracket = ExposureBracket(
        images=tuple(folder / f"none{k}.tif" for k in range(count)),
        exposure_time_s=np.array(TIMES),
        iso=np.full(count, 100.0),
        f_number=np.ones(count),
        nd_factor=np.ones(count),
        black_level=np.array([BLACK]),
        white_level=np.array([WHITE]),
    )
    stage = Usd.Stage.CreateNew(str(folder / "shoot.usda"))
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    root = UsdGeom.Xform.Define(stage, "/Shoot").GetPrim()
    root.ApplyAPI("CaptureAPI")
    stage.SetDefaultPrim(root)
    up = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
    level = []
    for turn in (0.0, 2.0 * np.pi / 3.0, 4.0 * np.pi / 3.0):
        c, s = np.cos(turn), np.sin(turn)
        level.append(np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]))
    for index, rotation in enumerate([*level, up]):
        camera = UsdGeom.Camera.Define(stage, f"/Shoot/view{index}").GetPrim()
        write_lens(camera, lens)
        write_bracket(camera, bracket, folder)
        write_rotation(camera, rotation)
    stage.GetRootLayer().Save()
    return folder / "shoot.usda"


def measure(shoot: Path, *options: str) -> dict[str, Any]:
    """Run the command once; return its wall, CPU and part times [s] and its peak memory [MB]."""
    import sys

    output = shoot.parent / "capture.usda"
    command = [sys.executable, "-m", "usdskin", "--json", "capture", str(shoot), "-o", str(output)]
    child: Child = run([*command, *options])
    events = [json.loads(line) for line in child.output.splitlines()]
    seconds = next(event for event in events if event["event"] == "seconds")
    told = next(event for event in events if event["event"] == "capture")
    return {
        "wall": child.wall,
        "cpu": child.cpu,
        "peak_mb": child.peak_mb,
        "size": (told["width"], told["height"]),
        **{name: value for name, value in seconds.items() if name != "event"},
    }


def main() -> None:
    """Write the photographs, run, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a sixteenth of the pixels")
    parser.add_argument("--json", type=Path, help="write every figure to this file")
    parser.add_argument("--markdown", type=Path, help="write the table to this file")
    given = parser.parse_args()
    described, size = machine(), QUICK_SIZE if given.quick else SIZE
    with tempfile.TemporaryDirectory() as folder:
        write_bracket(Path(folder), size)
        shoot = write_shoot(Path(folder), size)
        results = {
            "rotations as stated": measure(shoot),
            "rotations refined": measure(shoot, "--refine-rotations"),
        }
    rows = []
    for name, result in results.items():
        parts = ", ".join(
            f"{part} {result[part]:.1f}"
            for part in ("merge", "compose", "align", "measure", "write")
        )
        rows.append(Row(f"{name}: whole command [s]", f"{result['wall']:.1f}", parts))
        peak = result["peak_mb"]
        rows.append(
            Row(
                f"{name}: peak memory [MB]",
                f"{peak:.0f}",
                bar=f"<= {MEMORY_BAR_MB:.0f}",
                is_met=peak <= MEMORY_BAR_MB,
            )
        )
    columns, lines = results["rotations as stated"]["size"]
    title = f"4 views x 9 exposures of {size[1]} x {size[0]}, panorama {columns} x {lines}"
    sections = [Section(title, ("what", "found", "of which", "", "bar"), rows)]
    print(as_text(described, sections))
    if given.json:
        write_json(given.json, described, sections, results)
    if given.markdown:
        given.markdown.write_text(as_markdown(described, sections))
    raise SystemExit(any(row.is_met is False for row in rows))


if __name__ == "__main__":
    main()
