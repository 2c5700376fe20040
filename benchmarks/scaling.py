"""How time and memory of the traced integrator grow, as tables and as a picture."""

from __future__ import annotations

import os
from pathlib import Path

from benchmarks import scene, stages
from benchmarks.compare import Bench
from benchmarks.measure import middle
from benchmarks.report import Row, Section

COLUMNS = ("", "seconds", "peak memory", "times the first", "")

SAMPLES = 16


Curves = dict[str, list[tuple[float, float, float]]]
"""Amount, seconds and peak memory [MB] of every picture, by what grows."""


def sections(bench: Bench, size: int) -> tuple[list[Section], Curves]:
    """Measure pictures of a size; return the tables, and the points of each curve."""
    title = f"{size} x {size}, {SAMPLES} spp"
    curves: Curves = {}
    found = []

    def table(name: str, what: str, cases: list[tuple[str, float, Path, dict]]) -> None:
        rows: list[Row] = []
        points = []
        for label, amount, stage, job in cases:
            try:
                result = bench.ours(
                    f"scaling {name} {label}", stage, size, job.pop("spectral", False),
                    integrator="traced", samples=SAMPLES, repeats=bench.repeats, **job,
                )  # fmt: skip
            except RuntimeError as error:
                if "no light shines" not in str(error):
                    raise
                rows.append(Row(label, "", "", "", "not run: this kind of lamp is not lit here"))
                continue
            seconds = middle(result, "pixels")
            points.append((amount, seconds, result["peak_mb"]))
            times = f"{seconds / points[0][1]:.2f}x"
            rows.append(Row(label, f"{seconds:.3f} s", f"{result['peak_mb']:.0f} MB", times))
        if points:
            curves[name] = points
        found.append(Section(f"{what}, {title}", COLUMNS, rows))

    def head(mesh: str) -> Path:
        return scene.write_stage(bench.folder, mesh, opacity=scene.OPAQUE)

    sizes = ["5k", "50k"] if bench.is_quick else list(scene.MESH_ROWS)
    table("triangles", "Triangles", [
        (f"{4 * scene.MESH_ROWS[key] ** 2:,}", 4.0 * scene.MESH_ROWS[key] ** 2, head(f"head {key}"),
         {}) for key in sizes
    ])  # fmt: skip
    plain = head("head 50k")
    counts = [1, 4] if bench.is_quick else [1, 4, 16, 64]
    for kind in ("distant", "rect"):
        table(f"{kind} lamps", f"Lamps ({kind})", [
            (f"{count} {kind}", float(count), stages.lamps(bench.folder, plain, kind, count), {})
            for count in counts
        ])  # fmt: skip
    bands = [3, 61] if bench.is_quick else [3, 16, 31, 61, 121]
    grids = {count: _grid(count) for count in bands}
    table("bands", "Bands, picture alone", [
        (f"{count}", float(count), plain, {"bands_nm": grids[count]}) for count in bands
    ])  # fmt: skip
    table("bands, all of them written", "Bands, with the spectral picture", [
        (f"{count}", float(count), plain, {"bands_nm": grids[count], "spectral": True})
        for count in bands
    ])  # fmt: skip
    cores = sorted({1, 2, *(1 << k for k in range(8))} & set(range(1, (os.cpu_count() or 1) + 1)))
    table("threads", "Threads", [
        (f"{count}", float(count), plain, {"threads": count}) for count in cores
    ])  # fmt: skip
    return found, curves


def _grid(count: int) -> list[float]:
    """Return bands from 400 to 700 nm; three are those of an RGB renderer."""
    if count == 3:
        return [450.0, 550.0, 650.0]
    return [400.0 + 300.0 * k / (count - 1) for k in range(count)]


def plot(curves: Curves, path: Path) -> None:
    """Draw seconds and memory over triangles, lamps, bands and threads to a PNG."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    figure, grid = pyplot.subplots(2, 4, figsize=(13.0, 5.6), sharex="col", layout="constrained")
    panels = (("triangles",), ("distant lamps", "rect lamps"),
              ("bands", "bands, all of them written"), ("threads",))  # fmt: skip
    for row, label in enumerate(("seconds to pixels", "peak memory [MB]"), start=1):
        for axis, names in zip(grid[row - 1], panels, strict=True):
            for name in names:
                if name in curves:
                    points = list(zip(*curves[name], strict=True))
                    axis.plot(points[0], points[row], "o-", label=name)
            axis.set_ylim(0.0, 1.1 * axis.get_ylim()[1])
            axis.grid(alpha=0.3)
            if row == 1 and len(names) > 1:
                axis.legend(fontsize=8)
        grid[row - 1][0].set_ylabel(label)
    for axis, names in zip(grid[1], panels, strict=True):
        amounts = sorted({point[0] for name in names for point in curves.get(name, [])})
        axis.set_xscale("log")
        axis.set_xticks(amounts, [f"{amount:,.0f}" for amount in amounts], fontsize=8)
        axis.minorticks_off()
        axis.set_xlabel(names[0].split()[-1])
    figure.savefig(path, dpi=110)
    pyplot.close(figure)
