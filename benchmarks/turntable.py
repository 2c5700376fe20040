"""Many pictures of one head: visibility baked once by us, traced anew by Mitsuba each time."""

from __future__ import annotations

import sys
from dataclasses import asdict
from pathlib import Path

from benchmarks import equal_error, scene, stages
from benchmarks.compare import SAMPLES, SUBPIXELS, Bench
from benchmarks.equal_error import Reference
from benchmarks.measure import Child, middle, run
from benchmarks.report import Row

BAR = 20.0

FEW_DIRECTIONS = 512
"""Half of what a bake looks in where nobody says how many."""


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
    found = []
    turning = {
        what: stages.turntable(bench.folder, stage, what, frames) for what in ("light", "camera")
    }
    theirs = {
        what: bench.peer(
            f"turn {what} Mitsuba", mesh, size, "llvm_ad_spectral", repeats=frames, turn=what,
            whole=True,
        )
        for what in turning
    }  # fmt: skip
    for directions in (None, FEW_DIRECTIONS):
        label = "" if directions is None else f", {directions} directions"
        transfer = bench.folder / f"transfer{directions or ''}.usda"
        command = [sys.executable, "-m", "usdskin", "-q", "bake", str(stage), "-o", str(transfer)]
        command += [] if directions is None else ["--directions", str(directions)]
        made = run(command)
        bench.raw[f"bake {mesh}{label}"] = asdict(made)
        found.append(Row(f"baking {mesh}{label}, start to files", f"{made.wall:.2f} s"))
        for what, peer in theirs.items():
            drawn = _ours(bench, turning[what], transfer, size, frames)
            bench.raw[f"turn {what} ours{label}"] = asdict(drawn)
            mine = made.wall + drawn.wall
            other = peer["load"] + sum(lap["pixels"] for lap in peer["laps"])
            ratio = other / mine
            is_met = None if directions else ratio >= BAR
            each = middle(peer, "pixels")
            alone = each * frames / drawn.wall
            found += [
                Row(f"{what} turns, {frames} frames, bake and all files written{label}",
                    f"{mine:.2f} s", f"{other:.2f} s", f"{ratio:.1f}x",
                    "" if directions else f">= {BAR:g}x", is_met),
                Row(f"  per frame, {SAMPLES} spp of Mitsuba's, the bake not counted",
                    f"{drawn.wall / frames:.3f} s", f"{each:.3f} s",
                    f"{alone:.1f}x", "" if directions else f">= {BAR:g}x",
                    None if directions else alone >= BAR),
            ]  # fmt: skip
            first = read_image(bench.folder / "turn.0001.exr").pixels[None, :, :, :3]
            error = equal_error.error(first, truth)
            noise = equal_error.error(bench.picture(f"turn {what} Mitsuba")[1:2], truth)
            what_error = "  relative RMSE of frame 1"
            found.append(Row(what_error, f"{error:.2%}", f"{noise:.2%}", f"{noise / error:.2f}x"))
    return found


def _ours(bench: Bench, stage: Path, transfer: Path, size: int, frames: int) -> Child:
    whole = stages.joined(bench.folder, f"{stage.stem}-{transfer.stem}", [transfer, stage])
    command = [sys.executable, "-m", "usdskin", "-q", "render", str(whole)]
    command += [str(bench.folder / "turn.####.exr"), "-f", f"1-{frames}", "--integrator", "map"]
    command += ["-r", str(size), str(size), "-p", str(SUBPIXELS), "--filter", "box", "--no-png"]
    return run(command)
