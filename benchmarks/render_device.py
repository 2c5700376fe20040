"""Frames per second of the map on a device: ``python -m benchmarks.render_device JOB.json``.

Prints one line of JSON. All buffers stay on the device, the pictures too: what is timed is what a
viewer would do for every frame, from a new camera or a new light to XYZ that is exact for 61 bands.
"""

from __future__ import annotations

import dataclasses
import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np


def run(job: dict[str, Any]) -> dict[str, Any]:
    """Render the job's frames with the camera going around, and then with the light."""
    import warp as wp

    import usdskin.schemas  # noqa: F401  (registers before the first stage)
    from usdskin import compilation
    from usdskin.device import open_workers
    from usdskin.render.cameras import Camera, read_camera
    from usdskin.render.film import sample_offsets
    from usdskin.render.integrate import device_camera
    from usdskin.render.overrides import RenderOverrides
    from usdskin.render.scene import read_scene
    from usdskin.render.settings import read_settings
    from usdskin.render.uploading import upload
    from usdskin.warp_kernels import film, first_faces, structs

    # isort: split
    from pxr import Usd

    workers = open_workers(job["device"])
    device, resolution = workers.device, (job["width"], job["height"])
    stage = Usd.Stage.Open(job["stage"])
    notes: list[Any] = []
    asked = RenderOverrides(resolution=resolution, integrator="map")
    moment = Usd.TimeCode.EarliestTime()
    scene = read_scene(stage, moment, read_settings(stage, asked), notes)
    uploaded, _ = upload(scene, workers, show_dome=False)
    camera = read_camera(stage, "/Camera", moment, resolution, 1.0, "expandAperture", notes)
    count = resolution[0] * resolution[1]
    for kernels in (film, first_faces):
        compilation.load(kernels, device)
    picture = structs.Film()
    picture.sample = wp.array(sample_offsets(job["samples"], "box"), dtype=wp.vec2f, device=device)
    picture.channel = wp.zeros((count, uploaded.max_rows), dtype=wp.vec4f, device=device)
    picture.xyza = wp.zeros(count, dtype=wp.vec4f, device=device)
    picture.spectrum = wp.zeros((count, 0), dtype=wp.vec4f, device=device)

    def turned(share: float) -> Camera:
        cosine, sine = np.cos(2.0 * np.pi * share), np.sin(2.0 * np.pi * share)
        turn = np.array([[cosine, 0, sine, 0], [0, 1, 0, 0], [-sine, 0, cosine, 0], [0, 0, 0, 1]])
        return dataclasses.replace(camera, to_world=turn @ camera.to_world)

    def draw(seen: Camera, lit: Any) -> None:
        picture.xyza.zero_()
        rays = device_camera(seen, resolution)
        picture.face = first_faces.find_first_faces(lit.geometry, rays, picture.sample, 0, count)
        film.render_tile(lit.geometry, rays, lit.lights, lit.materials, picture)

    def relit(share: float) -> Any:
        turn = turned(share).to_world[:3, :3] @ camera.to_world[:3, :3].T
        domes = tuple(
            dataclasses.replace(dome, to_world=turn @ dome.to_world) for dome in scene.lights.domes
        )
        lights = dataclasses.replace(scene.lights, domes=domes)
        return upload(dataclasses.replace(scene, lights=lights), workers, show_dome=False)[0]

    def timed(frame: Any, frames: int) -> list[float]:
        found = []
        for k in range(frames + 1):
            begun = time.perf_counter()
            frame(k / max(frames, 1))
            wp.synchronize_device(device)
            found.append(time.perf_counter() - begun)
        return found[1:]

    by_camera = timed(lambda share: draw(turned(share), uploaded), job["frames"])
    covered = float((picture.xyza.numpy()[:, 3] > 0.0).mean())
    by_light = timed(lambda share: draw(camera, relit(share)), min(job["frames"], 8))
    return {
        "camera": by_camera,
        "light": by_light,
        "covered": covered,
        "bandwidth": _bandwidth(device),
        "flops": _flops(device, job["flop_steps"]),
        "groups": int(uploaded.lights.group_count),
        "rows": int(uploaded.max_rows),
    }


def _bandwidth(device: str) -> float:
    """Return bytes per second of copying half a gigabyte, read and written."""
    import warp as wp

    source = wp.zeros(1 << (27 if device != "cpu" else 24), dtype=wp.float32, device=device)
    target = wp.empty_like(source)
    best = np.inf
    for _ in range(5):
        begun = time.perf_counter()
        wp.copy(target, source)
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - begun)
    return 2.0 * source.capacity / best


def _flops(device: str, steps: int) -> float:
    """Return float operations per second of a kernel that does nothing else."""
    import warp as wp

    from benchmarks.flops import multiply_add

    count = (1 << 22) if device != "cpu" else (1 << 12)
    values = wp.zeros(count, dtype=wp.float32, device=device)
    best = np.inf
    for _ in range(4):
        begun = time.perf_counter()
        wp.launch(multiply_add, dim=count, inputs=[steps], outputs=[values], device=device)
        wp.synchronize_device(device)
        best = min(best, time.perf_counter() - begun)
    return 16.0 * steps * count / best


if __name__ == "__main__":
    print(json.dumps(run(json.loads(Path(sys.argv[1]).read_text()))))
