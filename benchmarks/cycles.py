"""Cycles on the same head: time and noise, where a Python with bpy is named.

bpy wants an environment of its own: ``USDSKIN_BPY_PYTHON`` names its interpreter.
"""

from __future__ import annotations

import json
import os

import numpy as np

from benchmarks import equal_error, scene
from benchmarks.compare import Bench
from benchmarks.measure import ROOT, middle, run
from benchmarks.report import Row, Section

VARIABLE = "USDSKIN_BPY_PYTHON"
SAMPLES = (16, 64)


def cycles_section(bench: Bench, size: int) -> Section:
    """Measure Cycles in RGB at two sample counts, or say why not."""
    columns = ("", "seconds", "relative RMSE", "peak memory", "")
    section = Section(f"Cycles, RGB, {size} x {size}", columns)
    python = os.environ.get(VARIABLE)
    if not python:
        section.rows.append(
            Row("Cycles", "", "", "", f"not run: {VARIABLE} names no Python with bpy")
        )
        return section
    points, normals, faces = scene.shape("head 50k")
    arrays = bench.folder / "cycles.npz"
    np.savez(arrays, points=points, normals=normals, faces=faces, room=scene.environment(),
             color=scene.reflectance_rgb())  # fmt: skip
    skin = equal_error.skin_of(bench.picture(f"head 50k {size} ours 16")[..., 3].min(axis=0))
    for samples in SAMPLES[:1] if bench.is_quick else SAMPLES:
        name = f"cycles {samples}"
        job = {"arrays": str(arrays), "size": size, "samples": samples,
               "repeats": max(bench.repeats, 2), "fov": scene.FOV_DEG,
               "distance": scene.CAMERA_DISTANCE, "out": str(bench.folder / "cycles.exr"),
               "picture": str(bench.folder / f"{name}.npy")}  # fmt: skip
        path = bench.folder / "cycles.json"
        path.write_text(json.dumps(job))
        # Without -P this folder, with a module of the same name as the addon, would come first.
        child = run([python, "-P", str(ROOT / "benchmarks" / "render_cycles.py"), str(path)])
        told = [line for line in child.output.splitlines() if line.startswith("{")][-1]
        result = {**json.loads(told), "peak_mb": child.peak_mb}
        bench.raw[name] = result
        seen = bench.picture(name)[:, skin, :3].astype(np.float64)
        noise = float(np.sqrt(seen.var(axis=0, ddof=1).mean()) / seen.mean())
        section.rows.append(Row(f"{samples} spp",
                         f"{middle(result, 'pixels'):.3f} s", f"{noise:.2%}",
                         f"{result['peak_mb']:.0f} MB"))  # fmt: skip
    return section
