"""Our half of the comparison: ``python -m benchmarks.render_ours JOB.json`` prints JSON.

Through the public path, ``render_stage``: its ``bake`` (light maps, material tables, geometry to
the device) and ``render`` are the time to pixels in memory; opening, reading and writing are
reported apart.
"""

from __future__ import annotations

import json
import resource
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


def run(job: dict[str, Any]) -> dict[str, Any]:
    """Render ``repeats`` + 1 times; the first time, kernels are loaded."""
    from usdskin.images import read_image, read_spectral
    from usdskin.progress import SilentProgress
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.render import render_stage

    stage, out = Path(job["stage"]), Path(job["out"])
    bands = job.get("bands_nm")
    asked = RenderOverrides(
        resolution=(job["size"], job["size"]),
        samples=job["samples"],
        pixel_filter="box",
        spectral_output=job["spectral"],
        wavelength_nm=None if bands is None else np.array(bands, float),
        png=False,
        aovs=["none"],
        compression="none",
    )
    laps: list[dict[str, float]] = []
    for _ in range(job["repeats"] + 1):
        before, begun = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
        report = render_stage(stage, out, asked, SilentProgress())
        wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        seconds = report.seconds
        laps.append({**seconds, "pixels": seconds["bake"] + seconds["render"]})
        laps[-1] |= {"wall": wall, "cpu": cpu}
    np.save(job["picture"], read_image(out).pixels[..., :3])
    if job["spectral"]:
        spectral = out.with_name(out.stem + ".spectral.exr")
        np.save(job["picture"].replace(".npy", ".bands.npy"), read_spectral(spectral)[1])
    return {"first": laps[0], "laps": laps[1:] or laps}


def normals(job: dict[str, Any]) -> dict[str, Any]:
    """Save what the middle of every pixel sees: the shading normals, for the reference."""
    from usdskin.images import read_image
    from usdskin.progress import SilentProgress
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.render import render_stage

    out = Path(job["out"])
    asked = RenderOverrides(resolution=(job["size"], job["size"]), samples=1, png=False, aovs=["N"])
    render_stage(Path(job["stage"]), out, asked, SilentProgress())
    np.save(job["picture"], read_image(out, part="N").pixels)
    return {}


if __name__ == "__main__":
    given = json.loads(Path(sys.argv[1]).read_text())
    print(json.dumps({"normals": normals, "render": run}[given["what"]](given)))
