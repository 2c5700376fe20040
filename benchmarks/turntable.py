"""Many pictures of one head: visibility baked once by us, traced anew by Mitsuba each time."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from benchmarks import equal_error, scene, stages
from benchmarks.compare import SAMPLES, SUBPIXELS, Bench
from benchmarks.equal_error import Reference
from benchmarks.measure import middle, run
from benchmarks.report import Row

BAR = 20.0


def can_bake() -> bool:
    """Return whether this version has ``usdskin bake``."""
    try:
        run([sys.executable, "-m", "usdskin", "bake", "--help"])
    except RuntimeError:
        return False
    return True


def rows(bench: Bench, mesh: str, size: int, frames: int, truth: Reference) -> list[Row]:
    """Compare a turn of the light and one of the camera.

    Args:
        bench: The run.
        mesh: Name of the head.
        size: Width and height [px].
        frames: How many.
        truth: What the first frame of either should show.
    """
    from usdskin.images import read_image

    if not can_bake():
        return [Row("light and camera turntable", "", "", "", "not run: no `usdskin bake` here")]
    stage = scene.write_stage(bench.folder, mesh, opacity=scene.OPAQUE)
    transfer = bench.folder / "transfer.usda"
    made = run([sys.executable, "-m", "usdskin", "-q", "bake", str(stage), "-o", str(transfer)])
    bench.raw[f"bake {mesh}"] = {"wall": made.wall, "cpu": made.cpu, "peak_mb": made.peak_mb}
    found = [Row(f"baking {mesh}, start to files", f"{made.wall:.2f} s")]
    for what in ("light", "camera"):
        ours = _ours(bench, stages.turntable(bench.folder, stage, what, frames), transfer,
                     size, frames)  # fmt: skip
        bench.raw[f"turn {what} ours"] = ours
        theirs = bench.peer(
            f"turn {what} Mitsuba",
            mesh,
            size,
            "llvm_ad_spectral",
            repeats=frames,
            turn=what,
            whole=True,
        )
        other = theirs["load"] + sum(lap["pixels"] for lap in theirs["laps"])
        mine = made.wall + ours["wall"]
        ratio = other / mine
        found += [
            Row(f"{what} turns, {frames} frames, bake and all files written", f"{mine:.2f} s",
                f"{other:.2f} s", f"{ratio:.1f}x", f">= {BAR:g}x", ratio >= BAR),
            Row(f"  per frame, {SAMPLES} spp of Mitsuba's", f"{ours['wall'] / frames:.3f} s",
                f"{middle(theirs, 'pixels'):.3f} s",
                f"{middle(theirs, 'pixels') * frames / ours['wall']:.1f}x"),
        ]  # fmt: skip
        first = read_image(bench.folder / "turn.0001.exr").pixels[None, :, :, :3]
        mine = equal_error.error(first, truth)
        other = equal_error.error(bench.picture(f"turn {what} Mitsuba")[1:2], truth)
        found.append(
            Row("  relative RMSE of frame 1", f"{mine:.2%}", f"{other:.2%}", f"{other / mine:.2f}x")
        )
    return found


def _ours(bench: Bench, stage: Path, transfer: Path, size: int, frames: int) -> dict[str, Any]:
    whole = stages.joined(bench.folder, f"{stage.stem}-baked", [transfer, stage])
    command = [sys.executable, "-m", "usdskin", "-q", "render", str(whole)]
    command += [str(bench.folder / "turn.####.exr"), "-f", f"1-{frames}", "--integrator", "map"]
    command += ["-r", str(size), str(size), "-p", str(SUBPIXELS), "--filter", "box", "--no-png"]
    found = run(command)
    return {"wall": found.wall, "cpu": found.cpu, "peak_mb": found.peak_mb}
