"""Shadowed pictures, against Mitsuba 3 and ourselves: ``python -m benchmarks.traced [--quick]``.

Everything is measured in one run, each measurement in a process of its own, ours and Mitsuba's
in turn. README.md beside this file says what the rows mean.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import device_rate, equal_error, scaling, scene, turntable
from benchmarks.compare import COLUMNS, Bench
from benchmarks.cycles import cycles_section
from benchmarks.equal_error import Crossing, Found, Reference
from benchmarks.measure import machine, middle
from benchmarks.report import Row, Section, as_markdown, as_text, write_json

BAR = 1.0
BAND_BAR = 10.0
BAND_ERROR = 0.10
MEAN_BAR = 0.003

REPEATS = 2
"""Pictures after the first, of which the time is the median; a picture is long enough for two."""

MOST_SAMPLES = 4096
"""Ours allow no more; we and Mitsuba are run up to it."""


def single(
    bench: Bench, mesh: str, size: int, targets: list[float], known: dict[tuple[str, float], float]
) -> tuple[Section, Reference]:
    """Compare the time to equal error of one shadowed picture.

    Args:
        bench: The run.
        mesh: Name of the head.
        size: Width and height [px].
        targets: Errors.
        known: Efforts that led to a target in a picture before this one, by renderer and target:
            where to begin. Only our faster way is then measured again, and Mitsuba's spectral one.
    """
    stage = scene.write_stage(bench.folder, mesh, opacity=scene.OPAQUE)
    name = f"{mesh} {size}"
    _shadowed(bench, f"{name} ours 16", stage, size, samples=16)
    first = bench.picture(f"{name} ours 16")
    skin = equal_error.skin_of(first[..., 3].min(axis=0))
    samples = 64 if bench.is_quick else 256
    bench.peer(f"{name} reference", mesh, size, "llvm_ad_spectral", samples=samples,
               repeats=3, whole=True)  # fmt: skip
    truth = equal_error.reference(bench.picture(f"{name} reference"), skin)
    rows = _agreement(bench, name, stage, size, mesh, truth)
    for target in targets:
        begin = {how: known.get((how, target)) for how in ("uniform", "adaptive")}
        ways = [how for how in begin if begin[how]] or list(begin)
        ours = {
            how: _cross(bench, f"{name} ours {how} {target:g}", truth, target, begin[how],
                        stage=stage, size=size, adaptive=how == "adaptive")
            for how in ways
        }  # fmt: skip
        fastest = min(ours, key=lambda how: ours[how].seconds)
        best = ours[fastest]
        spectral = _cross_peer(
            bench, mesh, size, "llvm_ad_spectral", truth, target, known.get(("Mitsuba", target))
        )
        rows.append(_versus(f"{target:.0%}: Mitsuba spectral", best, spectral, BAR))
        rows.append(_efforts(fastest, best, spectral))
        if len(ours) > 1:
            rows.append(_versus("  the same, our samples uniform", ours["uniform"], spectral))
            rows.append(_versus("  the same, ours with --target-error", ours["adaptive"], spectral))
            rgb = _cross_peer(bench, mesh, size, "llvm_ad_rgb", None, target, None, skin)
            rows.append(_versus(f"{target:.0%}: Mitsuba RGB", best, rgb))
        known[fastest, target] = best.effort
        known["Mitsuba", target] = spectral.effort
    triangles = 4 * scene.MESH_ROWS[mesh.split()[-1]] ** 2
    title = f"Shadowed head, {triangles:,} triangles, {size} x {size}: time to equal relative RMSE"
    return Section(title, COLUMNS, rows), truth


def _shadowed(bench: Bench, name: str, stage: Path, size: int, **job: Any) -> Any:
    given = {"integrator": "traced", "seeds": True, "repeats": REPEATS}
    return bench.ours(name, stage, size, job.pop("spectral", False), **{**given, **job})


def _agreement(
    bench: Bench, name: str, stage: Path, size: int, mesh: str, truth: Reference
) -> list[Row]:
    """Compare the converged means, and say what is left where the noise is taken off."""
    samples = 64 if bench.is_quick else 256
    _shadowed(bench, f"{name} ours {samples}", stage, size, samples=samples)
    mean, left = equal_error.bias(bench.picture(f"{name} ours {samples}"), truth)
    share = truth.skin.mean()
    return [
        Row("our mean over Mitsuba spectral's, less 1", f"{mean:+.3%}", "", "",
            f"<= {MEAN_BAR:.1%}", abs(mean) <= MEAN_BAR),
        Row("  relative RMSE between the two that is not noise", f"{left:.2%}"),
        Row("  pixels that show skin", f"{share:.0%}"),
    ]  # fmt: skip


def _cross(
    bench: Bench, name: str, truth: Reference, target: float, begin: float | None, *,
    stage: Path, size: int, adaptive: bool,
) -> Crossing:  # fmt: skip
    def run(effort: float) -> Found:
        if adaptive:  # effort is 1 / error^2, and the samples end by themselves
            job = {"samples": MOST_SAMPLES, "target_error": effort**-0.5}
        else:
            job = {"samples": int(effort)}
        label = f"{name} {effort:.0f}"
        result = _shadowed(bench, label, stage, size, **job)
        error = equal_error.error(bench.picture(label), truth)
        return _found(bench, label, effort, error, result)

    first = (1.3 * target) ** -2 if adaptive else (64 if target < 0.03 else 16)
    snap = (lambda effort: min(effort, 1e6)) if adaptive else _whole
    return equal_error.crossing(run, target, begin or first, snap)


def _cross_peer(
    bench: Bench,
    mesh: str,
    size: int,
    variant: str,
    truth: Reference | None,
    target: float,
    begin: float | None = None,
    skin: Any = None,
) -> Crossing:
    """Cross with Mitsuba; without a reference by the scatter over seeds, its RGB is its own."""

    def run(effort: float) -> Found:
        samples = int(effort)
        label = f"{mesh} {size} {variant} {samples}"
        if label in bench.raw:
            result = bench.raw[label]
        else:
            # Seeds that the reference has not seen.
            result = bench.peer(label, mesh, size, variant, samples=samples, whole=True,
                                repeats=REPEATS, first_seed=100)  # fmt: skip
        pictures = bench.picture(label)
        if truth is not None:
            error = equal_error.error(pictures, truth)
        else:
            seen = pictures[:, skin, :3].astype(np.float64)
            error = float(np.sqrt(seen.var(axis=0, ddof=1).mean()) / seen.mean())
        return _found(bench, label, samples, error, result)

    first = 128 if target < 0.03 else 32
    return equal_error.crossing(run, target, begin or first, _grid)


def _whole(effort: float) -> int:
    return min(max(round(effort), 1), MOST_SAMPLES)


def _grid(effort: float) -> int:
    """Return a sample count near the effort that multijitter takes as it is: a grid's."""
    columns = min(max(int(effort**0.5), 2), 64)
    return columns * min(max(round(effort / columns), columns), 64)


def _found(bench: Bench, label: str, effort: float, error: float, result: Any) -> Found:
    bench.raw[label] = {**result, "relative_rmse": error}
    print(f"    relative RMSE {error:.3%}", file=sys.stderr, flush=True)
    return Found(float(effort), error, middle(result, "pixels"))


def _versus(what: str, ours: Crossing, theirs: Crossing, bar: float | None = None) -> Row:
    ratio = theirs.seconds / ours.seconds
    tell = "" if ours.is_run and theirs.is_run else "extrapolated"
    if bar is None:
        return Row(what, _told(ours), _told(theirs), f"{ratio:.2f}x", tell)
    text = f">= {bar:g}x" + (f" ({tell})" if tell else "")
    return Row(what, _told(ours), _told(theirs), f"{ratio:.2f}x", text, ratio >= bar)


def _efforts(how: str, ours: Crossing, theirs: Crossing) -> Row:
    mine = f"{ours.effort:.0f} spp" if how == "uniform" else f"error {ours.effort**-0.5:.3f}"
    return Row("  what that takes: samples, or --target-error", mine, f"{theirs.effort:.0f} spp")


def _told(found: Crossing) -> str:
    return f"{found.seconds:.3f} s"


def bands(bench: Bench, mesh: str, size: int) -> Section:
    """Compare the time to 61 bands of equal error."""
    stage = scene.write_stage(bench.folder, mesh, opacity=scene.OPAQUE)

    def ours(effort: float) -> Found:
        samples = int(effort)
        label = f"{mesh} {size} bands ours {samples}"
        result = _shadowed(bench, label, stage, size, samples=samples, spectral=True)
        error = equal_error.band_noise(bench.picture(f"{label}.bands"))
        return _found(bench, label, samples, error, result)

    def theirs(effort: float) -> Found:
        samples = int(effort)
        label = f"{mesh} {size} bands Mitsuba {samples}"
        result = bench.peer(label, mesh, size, "llvm_ad_spectral", bands=True, samples=samples,
                            repeats=REPEATS)  # fmt: skip
        error = equal_error.band_noise(bench.picture(label))
        return _found(bench, label, samples, error, result)

    target = 0.3 if bench.is_quick else BAND_ERROR
    mine = equal_error.crossing(ours, target, 6, _whole)
    other = equal_error.crossing(theirs, target, 64 if bench.is_quick else 400, _grid)
    rows = [_versus(f"{target:.0%} in a band; Mitsuba specfilm", mine, other, BAND_BAR)]
    rows.append(Row("  samples per pixel that takes", f"{mine.effort:.0f}", f"{other.effort:.0f}"))
    return Section(f"61 bands, {size} x {size}: time to equal relative RMSE", COLUMNS, rows)


def main() -> int:
    """Run it all and print the tables; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.traced", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small pictures, loose targets")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables")
    parser.add_argument("--plot", type=Path, metavar="FILE", help="draw the scaling to a PNG")
    parser.add_argument("--device", metavar="NAME", help="measure frames per second there: cuda:0")
    given = parser.parse_args()
    about = machine()
    print("\n".join(f"{name}: {value}" for name, value in about.items()), flush=True)
    size, frames = (128, 4) if given.quick else (512, 24)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), given.quick)
        targets = [0.04] if given.quick else [0.02, 0.01]
        known: dict[tuple[str, float], float] = {}
        section, truth = single(bench, "head 50k", size, targets, known)
        parts = [section]
        if not given.quick:
            parts.append(single(bench, "head 50k", 1024, targets, known)[0])
            parts.append(single(bench, "head 500k", 512, [0.02], known)[0])
        parts.append(bands(bench, "head 50k", size))
        turns = turntable.rows(bench, "head 50k", size, frames, truth)
        parts.append(Section(f"Turntables, {size} x {size}, {frames} frames", COLUMNS, turns))
        parts.append(cycles_section(bench, size))
        tables, curves = scaling.sections(bench, 128 if given.quick else 256)
        parts += tables
        if given.device:
            parts.append(device_rate.section(bench, given.device))
    print(as_text({}, parts))
    if given.plot:
        scaling.plot(curves, given.plot)
    if given.markdown:
        given.markdown.write_text(as_markdown(about, parts))
    if given.json:
        write_json(given.json, about, parts, bench.raw)
    return 1 if any(row.is_met is False for part in parts for row in part.rows) else 0


if __name__ == "__main__":
    sys.exit(main())
