"""Compare the exposure merge with colour-hdri's: ``python -m benchmarks.merge [--quick]``.

Both read the same nine 16-bit TIFF files of 20 megapixels, whose light is known. Each measurement
is a process of its own. README.md beside this file says what the rows mean.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.measure import machine, run_job
from benchmarks.report import Row, Section, as_markdown, as_text, write_json

SIZE = (3648, 5472)
QUICK_SIZE = (912, 1368)
TIMES = tuple(4.0**-k for k in range(9))
BLACK, WHITE = 512.0, 16383.0
GAIN, READ_NOISE = 4.0, 0.75  # electrons per raw value, raw values
COMPRESSIONS = ("none", "zip")


def light(rows: NDArray[np.int64], width: int, height: int) -> NDArray[np.float32]:
    """Return image values [1/s] of some rows: 8 decades, fine detail, a lamp, dark corners."""
    y, x = rows[:, None] / height - 0.5, np.arange(width)[None] / width - 0.5
    radius = np.hypot(x * width, y * height) / height
    level = np.exp(7.0 * np.sin(9.0 * x) * np.cos(11.0 * y) + 0.3 * np.sin(400.0 * x * y))
    level += 4e5 * np.exp(-((((x - 0.1) ** 2 + (y + 0.2) ** 2) / 1e-4) ** 2))
    level = level * (radius < 0.5)
    return (level[..., None] * np.array([1.0, 0.8, 0.6])).astype(np.float32)


def write_bracket(folder: Path, size: tuple[int, int]) -> None:
    """Write the photographs, noise included, in both compressions."""
    import OpenImageIO

    height, width = size
    rng = np.random.default_rng(1)
    for k, time_s in enumerate(TIMES):
        outputs = []
        for compression in COMPRESSIONS:
            spec = OpenImageIO.ImageSpec(width, height, 3, "uint16")
            spec.attribute("compression", compression)
            path = str(folder / f"{compression}{k}.tif")
            outputs.append(OpenImageIO.ImageOutput.create(path))
            outputs[-1].open(path, spec)
        for begin in range(0, height, 64):
            end = min(begin + 64, height)
            electrons = light(np.arange(begin, end), width, height) * (
                time_s * (WHITE - BLACK) * GAIN
            )
            noise = np.sqrt(electrons + (READ_NOISE * GAIN) ** 2)
            electrons += noise * rng.standard_normal(electrons.shape, np.float32)
            raw = np.clip(np.round(BLACK + electrons / GAIN), 0, WHITE).astype(np.uint16)
            for output in outputs:
                output.write_scanlines(begin, end, 0, raw)
        for output in outputs:
            output.close()


_ERRORS = (
    ("bias", "mean"),
    ("p50", "median of its size"),
    ("p95", "95 % quantile"),
    ("p999", "99.9 % quantile"),
)

# --- One measurement ---------------------------------------------------------------------------


def measure_ours(job: dict[str, Any]) -> dict[str, Any]:
    """Merge with ``usdskin``, once to load kernels and files and then for the clock."""
    from usdskin.device import open_workers
    from usdskin.photographs import merge
    from usdskin.prims import ExposureBracket, FisheyeLens, View

    count = len(TIMES)
    bracket = ExposureBracket(
        images=tuple(_paths(job)),
        exposure_time_s=np.array(TIMES),
        iso=np.full(count, 100.0),
        f_number=np.ones(count),
        nd_factor=np.ones(count),
        black_level=np.array([BLACK]),
        white_level=np.array([WHITE]),
    )
    lens = FisheyeLens("equidistant", 1.0, np.zeros(2), (job["size"][1], job["size"][0]))
    view = View("view", "bracket", lens, bracket, np.eye(3))
    stages: dict[str, float] = {}
    for name in ("draw_samples", "measure_ratios", "find_noise", "merge_all_rows"):
        setattr(merge, name, _clocked(getattr(merge, name), name, stages))
    workers = open_workers("cpu")
    base_mb = _memory_mb()
    laps, merged = [], None
    for _ in range(1 + job["repeats"]):
        del merged  # one view in memory at a time
        stages.clear()
        begun, used = time.perf_counter(), time.process_time()
        merged = merge.merge_bracket(view, workers, Path(job["photographs"]))
        laps.append({"wall": time.perf_counter() - begun, "cpu": time.process_time() - used,
                     **stages})  # fmt: skip
    noise = merged.report.noise
    return {
        "laps": laps[1:],
        "base_mb": base_mb,
        "gain": float(noise.gain[0]),
        "read_noise": float(noise.read_noise[0]),
        **_errors(merged.values),
    }


def measure_theirs(job: dict[str, Any]) -> dict[str, Any]:
    """Merge with colour-hdri, with the weights its authors recommend for raw files."""
    from colour.utilities import suppress_warnings
    from colour_hdri import Image, ImageStack, Metadata, image_stack_to_HDRI
    from colour_hdri.generation import double_sigmoid_anchored_function

    class Photograph(Image):
        def read_data(self, cctf_decoding: Any = None) -> NDArray[Any]:
            raw = super().read_data(cctf_decoding) * 65535.0
            self.data = (raw - BLACK) / (WHITE - BLACK)
            return self.data

    laps = []
    for _ in range(min(job["repeats"], 1)):  # minutes each
        begun, used = time.perf_counter(), time.process_time()
        stack = ImageStack()
        # It takes the first image for the shortest exposure.
        for path, time_s in zip(_paths(job)[::-1], TIMES[::-1], strict=True):
            metadata = Metadata(f_number=1.0, exposure_time=time_s, iso=100.0)
            stack.append(Photograph(path=str(path), metadata=metadata))
        with suppress_warnings(colour_warnings=True, python_warnings=True):
            merged = image_stack_to_HDRI(stack, double_sigmoid_anchored_function)
        laps.append({"wall": time.perf_counter() - begun, "cpu": time.process_time() - used})
    # Their unit is that of average_luminance: 12.5 N^2 / (t ISO).
    return {"laps": laps, **_errors(merged / (12.5 / 100.0))}


def _paths(job: dict[str, Any]) -> list[Path]:
    return [Path(job["photographs"]) / f"{job['compression']}{k}.tif" for k in range(len(TIMES))]


def _clocked(function: Any, name: str, stages: dict[str, float]) -> Any:
    def timed(*given: Any, **named: Any) -> Any:
        begun = time.perf_counter()
        result = function(*given, **named)
        stages[name] = time.perf_counter() - begun
        return result

    return timed


def _memory_mb() -> float:
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1000.0


def _errors(values: NDArray[Any]) -> dict[str, float]:
    """Return mean and quantiles of the relative error where light is neither dark nor clipped."""
    height, width = values.shape[:2]
    rows = np.arange(0, height, max(height // 400, 1))
    truth = light(rows, width, height)
    shown = (truth.min(axis=-1) > 1e-3) & (truth.max(axis=-1) < 0.95 * 0.97 / TIMES[-1])
    error = np.asarray(values[rows], np.float64)[shown] / truth[shown] - 1.0
    quantiles = {"p50": 0.5, "p95": 0.95, "p999": 0.999}
    found = {name: float(np.quantile(np.abs(error), q)) for name, q in quantiles.items()}
    return {**found, "bias": abs(float(error.mean()))}


# --- The table ---------------------------------------------------------------------------------


def compare(folder: Path, size: tuple[int, int], repeats: int, raw: dict[str, Any]) -> Section:
    """Measure both on uncompressed and on compressed files."""
    rows: list[Row] = []
    for compression in COMPRESSIONS:
        job = {"photographs": str(folder), "size": size, "compression": compression,
               "repeats": repeats}  # fmt: skip
        ours, theirs = (run_job("merge", folder, who=who, **job) for who in ("ours", "theirs"))
        raw[compression] = {"ours": ours, "theirs": theirs}
        label = "uncompressed TIFF" if compression == "none" else "zip TIFF"
        rows += _rows(label, ours, theirs)
    title = f"Nine exposures of {size[1]} x {size[0]} pixels, 16 bits, {len(TIMES)} files"
    return Section(title, ("", "ours", "colour-hdri", "ratio", "bar"), rows)


def _rows(label: str, ours: dict[str, Any], theirs: dict[str, Any]) -> list[Row]:
    best = min(ours["laps"], key=lambda lap: lap["wall"])
    mine, other = best["wall"], min(lap["wall"] for lap in theirs["laps"])
    above = ours["peak_mb"] - ours["base_mb"]
    rows = [
        Row(f"{label}, files to merged values", f"{mine:.2f} s", f"{other:.2f} s",
            f"{other / mine:.1f}x", ">= 1x", other >= mine),
        Row("  processor time", f"{best['cpu']:.2f} s",
            f"{min(lap['cpu'] for lap in theirs['laps']):.2f} s"),
    ]  # fmt: skip
    stages = {
        "draw_samples": "reading samples",
        "measure_ratios": "exposure ratios",
        "find_noise": "noise model",
        "merge_all_rows": "reading and merging all rows",
    }
    rows += [Row(f"  of it {what}", f"{best[name]:.2f} s") for name, what in stages.items()]
    rows += [
        Row("  peak memory", f"{ours['peak_mb']:.0f} MB", f"{theirs['peak_mb']:.0f} MB",
            f"{theirs['peak_mb'] / ours['peak_mb']:.1f}x"),
        Row("  of it above the imports", f"{above:.0f} MB", "", "", "< 1000 MB", above < 1000.0),
    ]  # fmt: skip
    for key, what in _ERRORS:
        rows.append(
            Row(f"  relative error, {what}", f"{ours[key]:.2e}", f"{theirs[key]:.2e}",
                f"{theirs[key] / ours[key]:.2f}x")
        )  # fmt: skip
    rows.append(Row(f"  measured gain (truth {GAIN:g})", f"{ours['gain']:.3f}"))
    rows.append(Row(f"  measured read noise (truth {READ_NOISE:g})", f"{ours['read_noise']:.3f}"))
    return rows


def main() -> int:
    """Run it all and print the tables; 1 where a bar is missed."""
    if len(sys.argv) == 2 and sys.argv[1].endswith(".json"):
        job = json.loads(Path(sys.argv[1]).read_text())
        print(json.dumps((measure_ours if job["who"] == "ours" else measure_theirs)(job)))
        return 0
    parser = argparse.ArgumentParser(prog="python -m benchmarks.merge", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a sixteenth of the pixels")
    parser.add_argument("--json", type=Path, metavar="FILE", help="write every figure")
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables")
    given = parser.parse_args()
    about, raw = machine(), {}
    with tempfile.TemporaryDirectory() as folder:
        size = QUICK_SIZE if given.quick else SIZE
        write_bracket(Path(folder), size)
        sections = [compare(Path(folder), size, 1 if given.quick else 2, raw)]
    print(as_text(about, sections))
    if given.markdown:
        given.markdown.write_text(as_markdown(about, sections))
    if given.json:
        write_json(given.json, about, sections, raw)
    return 1 if any(row.is_met is False for section in sections for row in section.rows) else 0


if __name__ == "__main__":
    sys.exit(main())
