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

from benchmarks import scene


def run(job: dict[str, Any]) -> dict[str, Any]:
    """Render ``repeats`` + 1 times; the first time, kernels are loaded.

    ``seeds`` in the job asks for a seed each, and for all pictures with their alpha, of spectra the
    middle quarter; else the last picture is saved.
    """
    from usdskin.images import read_image, read_spectral
    from usdskin.progress import SilentProgress
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.render import render_stage

    stage, out = Path(job["stage"]), Path(job["out"])
    bands = job.get("bands_nm")
    laps: list[dict[str, float]] = []
    pictures, spectra = [], []
    for seed in range(job["repeats"] + 1):
        asked = RenderOverrides(
            resolution=(job["size"], job["size"]),
            samples=job["samples"],
            integrator=job.get("integrator"),
            target_error=job.get("target_error"),
            seed=seed if job.get("seeds") else None,
            pixel_filter="box",
            spectral_output=job["spectral"],
            wavelength_nm=None if bands is None else np.array(bands, float),
            threads=job.get("threads"),
            png=False,
            aovs=["none"],
            compression="none",
        )
        before, begun = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
        report = render_stage(stage, out, asked, SilentProgress())
        wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        seconds = report.seconds
        laps.append({**seconds, "pixels": seconds["bake"] + seconds["render"]})
        laps[-1] |= {"wall": wall, "cpu": cpu}
        if job.get("seeds"):
            pictures.append(read_image(out).pixels[..., :4])
            if job["spectral"]:
                spectra.append(scene.crop(read_spectral(_spectral(out))[1]))
    if job.get("seeds"):
        np.save(job["picture"], np.stack(pictures))
        if spectra:
            np.save(job["picture"].replace(".npy", ".bands.npy"), np.stack(spectra))
    else:
        np.save(job["picture"], read_image(out).pixels[..., :3])
        if job["spectral"]:
            bands_file = job["picture"].replace(".npy", ".bands.npy")
            np.save(bands_file, read_spectral(_spectral(out))[1])
    return {"first": laps[0], "laps": laps[1:] or laps}


def _spectral(out: Path) -> Path:
    return out.with_name(out.stem + ".spectral.exr")


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
