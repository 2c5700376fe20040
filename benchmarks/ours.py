"""Time usdskin on the subject, in a process of its own; prints one line of JSON."""

from __future__ import annotations

import argparse
import json
import resource
import time
from pathlib import Path

import numpy as np


def main() -> None:
    """Render ``--repeat`` times to pixels in memory and report the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("stage", type=Path)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=4)
    parser.add_argument("--bands", type=int, default=61, help="61, or 3 for an RGB-like render")
    parser.add_argument("--spectral", action="store_true", help="keep every band of every pixel")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--threads", type=int)
    parser.add_argument("--device", default="cpu")
    parser.add_argument("--picture", type=Path, help="where to save the linear RGB as .npy")
    given = parser.parse_args()

    from usdskin.layers import open_stage
    from usdskin.progress import SilentProgress
    from usdskin.render.cameras import read_camera
    from usdskin.render.device import open_workers
    from usdskin.render.integrate import integrate
    from usdskin.render.outputs import exposed_rgb
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.scene import read_scene, upload
    from usdskin.render.settings import read_settings

    from pxr import Usd  # isort: skip

    grid = np.linspace(400.0, 700.0, given.bands) if given.bands != 61 else None
    size = (given.size, given.size)
    stage = open_stage(given.stage)
    settings = read_settings(stage, RenderOverrides(wavelength_nm=grid))
    workers = open_workers(given.device, given.threads)
    now = Usd.TimeCode.EarliestTime()
    begun = time.perf_counter()
    scene = read_scene(stage, now, settings, [])
    read = time.perf_counter() - begun
    camera = read_camera(stage, "/World/Camera", now, size)
    walls, cpus, bakes = [], [], []
    for _ in range(given.repeat + 1):  # the first loads the kernels
        begun, cpu = time.perf_counter(), time.process_time()
        device_scene, _ = upload(scene, workers, show_dome=False)
        bakes.append(time.perf_counter() - begun)
        picture = integrate(
            device_scene, camera, size, given.samples, settings.pixel_filter, workers,
            SilentProgress(), spectral=given.spectral, show_dome=False,
        )  # fmt: skip
        walls.append(time.perf_counter() - begun)
        cpus.append(time.process_time() - cpu)
    if given.picture is not None:
        np.save(given.picture, exposed_rgb(picture, camera, settings))
    print(
        json.dumps(
            {
                "wall_s": float(np.median(walls[1:])),
                "cpu_s": float(np.median(cpus[1:])),
                "bake_s": float(np.median(bakes[1:])),
                "read_s": read,
                "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            }
        )
    )


if __name__ == "__main__":
    main()
