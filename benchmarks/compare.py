"""Compare us with Mitsuba 3 and with ourselves: ``python -m benchmarks.compare [--quick]``.

Everything is measured in one run, each measurement in a process of its own, ours and Mitsuba's
in turn. README.md beside this file says what the rows mean.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks import accuracy, scene
from benchmarks.measure import Child, fastest, machine, middle, run, run_job
from benchmarks.report import Row, Section, as_markdown, as_text, write_json
from benchmarks.startup import first_pictures

SAMPLES = 64
"""Mitsuba's samples per pixel."""

SUBPIXELS = 4
"""Ours."""

COLUMNS = ("", "ours", "Mitsuba", "ratio", "bar")


@dataclass(slots=True)
class Bench:
    """One run's folder and what it has measured so far."""

    folder: Path
    is_quick: bool
    raw: dict[str, Any] = field(default_factory=dict)

    @property
    def repeats(self) -> int:
        """How often Mitsuba repeats a picture after the first; we, who are quick, do so thrice."""
        return 1 if self.is_quick else 3

    def ours(self, name: str, stage: Path, size: int, spectral: bool, **job: Any) -> Any:
        """Measure us; the picture goes to ``<name>.npy``."""
        given = {"samples": SUBPIXELS, "repeats": 3 * self.repeats}
        return self._keep(
            name,
            run_job(
                "render_ours",
                self.folder,
                what="render",
                stage=str(stage),
                out=str(self.folder / "picture.exr"),
                picture=str(self.folder / f"{name}.npy"),
                size=size,
                spectral=spectral,
                **{**given, **job},
            ),
        )

    def peer(self, name: str, mesh: str, size: int, variant: str, **job: Any) -> Any:
        """Measure Mitsuba; the middles of its pictures go to ``<name>.npy``."""
        given = {"integrator": "path", "bands": False, "samples": SAMPLES, "repeats": self.repeats}
        return self._keep(
            name,
            run_job(
                "render_mitsuba",
                self.folder,
                mesh=mesh,
                size=size,
                variant=variant,
                picture=str(self.folder / f"{name}.npy"),
                **{**given, **job},
            ),
        )

    def picture(self, name: str) -> NDArray[np.float32]:
        """Return a measured picture."""
        found: NDArray[np.float32] = np.load(self.folder / f"{name}.npy")
        return found

    def _keep(self, name: str, result: dict[str, Any]) -> dict[str, Any]:
        self.raw[name] = result
        print(f"  {name}: {middle(result, 'pixels'):.3f} s", file=sys.stderr, flush=True)
        return result


# --- Against Mitsuba ---------------------------------------------------------------------------


def pictures(bench: Bench, mesh: str, size: int) -> Section:
    """Compare one mesh at one size."""
    stage = scene.write_stage(bench.folder, mesh)
    name = f"{mesh} {size}"
    beauty = bench.ours(f"{name} ours", stage, size, False)
    bands = bench.ours(f"{name} ours 61", stage, size, True)
    spectral = bench.peer(f"{name} spectral", mesh, size, "llvm_ad_spectral")
    bare = bench.peer(
        f"{name} spectral bare", mesh, size, "llvm_ad_spectral", integrator="emitter only"
    )
    rgb = bench.peer(f"{name} rgb", mesh, size, "llvm_ad_rgb")
    film = bench.peer(f"{name} film", mesh, size, "llvm_ad_spectral", bands=True, repeats=1)
    rows = [
        _timed("XYZ; Mitsuba spectral, 64 spp", beauty, spectral, 10.0 if size == 512 else None),
        _timed("XYZ; the same without shadow rays", beauty, bare),
        _timed("XYZ; Mitsuba RGB, 64 spp", beauty, rgb),
        _timed("61 bands; Mitsuba specfilm, 64 spp", bands, film, 20.0 if size == 512 else None),
        _loaded("XYZ with the scene read or loaded", beauty, spectral),
        _sized("peak memory, XYZ", beauty, spectral),
        _sized("peak memory, 61 bands", bands, film),
        Row("writing the EXR, uncompressed", f"{middle(beauty, 'write'):.3f} s"),
        Row("writing the 61-band EXR too", f"{middle(bands, 'write'):.3f} s"),
    ]
    title = f"{scene.MESH_ROWS[mesh] ** 2 * 4:,} triangles, {size} x {size}, {SUBPIXELS} subpixels"
    return Section(title, COLUMNS, rows)


def _timed(what: str, ours: Any, theirs: Any, bar: float | None = None) -> Row:
    mine, other = middle(ours, "pixels"), middle(theirs, "pixels")
    ratio = other / mine
    return Row(
        what,
        f"{mine:.3f} s",
        f"{other:.3f} s",
        f"{ratio:.1f}x",
        f">= {bar:g}x" if bar else "",
        ratio >= bar if bar else None,
    )


def _loaded(what: str, ours: Any, theirs: Any) -> Row:
    mine = middle(ours, "open") + middle(ours, "read") + middle(ours, "pixels")
    other = theirs["load"] + middle(theirs, "pixels")
    return Row(what, f"{mine:.3f} s", f"{other:.3f} s", f"{other / mine:.1f}x")


def _sized(what: str, ours: Any, theirs: Any) -> Row:
    ratio = theirs["peak_mb"] / ours["peak_mb"]
    return Row(what, f"{ours['peak_mb']:.0f} MB", f"{theirs['peak_mb']:.0f} MB", f"{ratio:.2f}x")


def errors(bench: Bench) -> Section:
    """Compare what is left of error at 512 x 512, and what Mitsuba would take to have ours."""
    name, mesh, size = "50k 512", "50k", 512
    stage = scene.write_stage(bench.folder, mesh)
    run_job(
        "render_ours",
        bench.folder,
        what="normals",
        stage=str(stage),
        out=str(bench.folder / "normals.exr"),
        picture=str(bench.folder / "normals.npy"),
        size=size * accuracy.FINER,
    )
    ours = bench.picture(f"{name} ours")
    error, bias = accuracy.our_error(ours, bench.picture("normals"), 16 if bench.is_quick else 128)
    rows = [
        Row("us, relative RMSE to float64 quadrature", f"{error:.2e}"),
        Row("us, mean error", f"{bias:+.2e}"),
    ]
    bench.peer(f"{name} spectral 16", mesh, size, "llvm_ad_spectral", samples=16)
    for label, key in (
        ("Mitsuba spectral, 64 spp", "spectral"),
        ("the same, 16 spp", "spectral 16"),
        ("Mitsuba spectral without shadow rays, 64 spp", "spectral bare"),
        ("Mitsuba RGB, 64 spp", "rgb"),
    ):
        found = bench.picture(f"{name} {key}")
        noise = accuracy.noise(found)
        rows.append(Row(f"{label}, relative RMSE", f"{error:.2e}", f"{noise:.2e}",
                        f"{noise / error:.0f}x"))  # fmt: skip
        ratio = accuracy.mean_ratio(ours, found).mean()
        rows.append(Row("  our mean over its mean", f"{ratio:.4f}"))
    film = bench.picture(f"{name} film")
    mine = bench.picture(f"{name} ours 61.bands")
    ratio = accuracy.mean_ratio(mine, film)
    ratio /= ratio.mean()  # the film's unit is another
    rows.append(Row("specfilm, 64 spp, per-band relative RMSE", "", f"{accuracy.noise(film):.2e}"))
    rows.append(
        Row(
            "  bands' means, largest deviation (D65 tables, see README)",
            f"{np.abs(ratio - 1.0).max():.2e}",
        )
    )
    rows.append(_equal_error(bench, name, error))
    return Section("Errors, 50k triangles, 512 x 512, middle quarter", COLUMNS, rows)


def _equal_error(bench: Bench, name: str, error: float) -> Row:
    """Extrapolate Mitsuba's error over samples to ours."""
    few, many = (
        accuracy.noise(bench.picture(f"{name} {key}")) for key in ("spectral 16", "spectral")
    )
    slope = math.log(few / many) / math.log(SAMPLES / 16)
    samples = SAMPLES * (many / error) ** (1.0 / slope)
    mine = middle(bench.raw[f"{name} ours"], "pixels")
    other = middle(bench.raw[f"{name} spectral"], "pixels") * samples / SAMPLES
    return Row(
        f"at equal error: Mitsuba spectral at {samples:,.0f} spp (error ~ spp^-{slope:.2f})",
        f"{mine:.3f} s",
        f"{other:.0f} s",
        f"{other / mine:,.0f}x",
        "extrapolated",
    )


# --- Against ourselves -------------------------------------------------------------------------


def ourselves(bench: Bench) -> Section:
    """Measure starting up, spectra against RGB, memory and the use of the cores."""
    stage = scene.write_stage(bench.folder, "50k")
    skin = scene.write_stage(bench.folder, "50k", wrap=0.3, scattering=0.6)
    cases: dict[str, tuple[Path, dict[str, Any]]] = {
        "1024 ours 61 bands": (stage, {}),
        "1024 ours 3 bands": (stage, {"bands_nm": [450.0, 550.0, 650.0]}),
        "1024 ours skin": (skin, {}),
    }
    found: dict[str, Any] = {}
    for _ in range(3):  # in turn, so that a slow minute of the machine hits all three
        for name, (path, job) in cases.items():
            result = bench.ours(name, path, 1024, False, **job)
            found.setdefault(name, result)
            if found[name] is not result:
                found[name]["laps"] += result["laps"]
    bench.raw |= found
    spectral, three, wrapped = found.values()
    mine, other = fastest(spectral, "pixels"), fastest(three, "pixels")
    skinned = fastest(wrapped, "pixels")
    rows = [
        Row("XYZ from 61 bands; from 3", f"{mine:.3f} s", f"{other:.3f} s",
            f"{mine / other:.2f}x", "<= 1.1x", mine / other <= 1.1),
        Row("skin, l = 0.3, Ss = 0.6; Lambert", f"{skinned:.3f} s", f"{mine:.3f} s",
            f"{skinned / mine:.2f}x"),
    ]  # fmt: skip
    command = _large(bench, stage)
    cores = middle(spectral, "cpu") / middle(spectral, "wall")
    rows += [
        Row("peak memory of usdskin render --spectral", f"{command.peak_mb:.0f} MB",
            bar="<= 1200 MB", is_met=command.peak_mb <= 1200.0),
        Row("  its wall time, start to files", f"{command.wall:.2f} s"),
        Row("cores in use, reading and writing included", f"{cores:.2f}"),
    ]  # fmt: skip
    columns = ("", "this", "other", "ratio", "bar")
    return Section("Ourselves, 50k triangles, 1024 x 1024, fastest of each", columns, rows)


def _large(bench: Bench, stage: Path) -> Child:
    command = [sys.executable, "-m", "usdskin", "-q", "render", str(stage)]
    command += [str(bench.folder / "large.exr"), "--spectral", "-r", "1024", "1024", "-p", "4"]
    found = run(command)
    bench.raw["1024 command"] = {"wall": found.wall, "cpu": found.cpu, "peak_mb": found.peak_mb}
    return found


def starts(bench: Bench) -> Section:
    """Measure the time to the first picture."""
    found = first_pictures(bench.repeats)
    bench.raw["startup"] = found
    over = found["warm"] - found["imports"]
    rows = [
        Row("empty kernel cache", f"{found['cold']:.2f} s", "", "", "<= 15 s", found["cold"] <= 15),
        Row("full kernel cache", f"{found['warm']:.2f} s"),
        Row("importing warp, pxr and OpenEXR alone", f"{found['imports']:.2f} s"),
        Row("  what we add to that", f"{over:.2f} s", "", "", "<= 1.0 s", over <= 1.0),
    ]
    columns = ("", "seconds", "", "", "bar")
    return Section("First picture of stages/sphere, process start to files", columns, rows)


def main() -> int:
    """Run it all and print the tables; 1 where a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.compare", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one mesh, one size, no medians")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables")
    given = parser.parse_args()
    cases = [("50k", 512)]
    if not given.quick:
        cases += [("50k", 1024), ("500k", 512), ("500k", 1024)]
    about = machine()
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench(Path(folder), given.quick)
        sections = [pictures(bench, mesh, size) for mesh, size in cases]
        sections += [errors(bench), ourselves(bench), starts(bench)]
    print(as_text(about, sections))
    if given.markdown:
        given.markdown.write_text(as_markdown(about, sections))
    if given.json:
        write_json(given.json, about, sections, bench.raw)
    return 1 if any(row.is_met is False for section in sections for row in section.rows) else 0


if __name__ == "__main__":
    sys.exit(main())
