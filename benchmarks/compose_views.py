"""Both halves of the panorama benchmark: ``python -m benchmarks.compose_views JOB.json``.

The same views become the same panorama, by us or by OpenCV with as many samples per texel, in
OpenCV's quickest order: maps for some rows at 4 x 4 times their size, ``remap``, and ``resize`` by
area. What ``remap`` cannot give is left out of its half: variances, flags, weights by noise, the
check of the flux.
"""

from __future__ import annotations

import json
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PART = 4
"""Samples along a texel's side."""

ROWS = 32
LAMP = np.array([1000.0, 800.0, 500.0], np.float32)
LAMP_DEG = 0.5


def make_lens(width: int, height: int) -> Any:
    """Return an equidistant lens whose half sphere fills the height of the picture."""
    from usdskin.prims.lenses import FisheyeLens

    focal = (0.5 * height - 4.0) / (0.5 * np.pi)
    center = np.array([0.5 * width + 3.3, 0.5 * height - 1.7])
    return FisheyeLens("equidistant", focal, center, (width, height), max_angle_deg=90.0)


def rotations() -> list[NDArray[np.float64]]:
    """Return three horizontal views and one of the zenith."""
    found = []
    for azimuth in np.radians([0.0, 120.0, 240.0]):
        cosine, sine = np.cos(azimuth), np.sin(azimuth)
        found.append(np.array([[cosine, 0.0, -sine], [0.0, 1.0, 0.0], [sine, 0.0, cosine]]))
    return [*found, np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])]


def lamps() -> NDArray[np.float64]:
    """Return where the lamps are: on the seam, in the middle of views, near both poles."""
    places = [[0.1, 0.2, -1.0], [0.0, 0.3, -1.0], [0.8, 0.3, 0.4], [0.02, 1.0, 0.01]]
    places += [[-0.9, -0.3, 0.5], [-0.5, -2.0, -0.4], [0.3, 0.7, 0.6]]
    found = np.array(places)
    return np.asarray(found / np.linalg.norm(found, axis=1, keepdims=True))


def photograph(lens: Any, rotation: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return a view of even light with lamps, 16 x 16 samples in the pixels of lamps."""
    from usdskin.fisheye import project, unproject

    width, height = lens.resolution
    values = np.ones((height, width, 3), np.float32)
    for direction in lamps():
        at = project(lens, direction @ rotation)
        if np.isnan(at).any():
            continue
        left, top = (at - 24.0).astype(int)
        u = left + (np.arange(48 * 16) + 0.5) / 16.0
        v = top + (np.arange(48 * 16) + 0.5) / 16.0
        rays = unproject(lens, np.stack(np.meshgrid(u, v), axis=-1)) @ rotation.T
        lit = rays @ direction > np.cos(np.radians(0.5 * LAMP_DEG))
        share = lit.reshape(48, 16, 48, 16).mean(axis=(1, 3))
        values[top : top + 48, left : left + 48] += (share[..., None] * LAMP).astype(np.float32)
    return values


def ours(job: dict[str, Any]) -> dict[str, Any]:
    """Compose ``repeats`` times, kernels loaded."""
    from usdskin.capture.views.panorama import Compositor
    from usdskin.device import open_workers
    from usdskin.progress import SilentProgress

    workers = open_workers("cpu", job["threads"])
    lens = make_lens(*job["view"])
    Compositor(16, workers, SilentProgress())
    laps = []
    for _ in range(job["repeats"]):
        lap = {"views": 0.0, "cpu": 0.0}
        compositor = Compositor(job["height"], workers, SilentProgress())
        for rotation in rotations():
            values = photograph(lens, rotation)
            variance = 1e-4 * values
            status = np.zeros(values.shape[:2], np.uint8)
            begun, used = time.perf_counter(), time.process_time()
            compositor.add_view(lens, rotation, values, variance, status)
            lap["views"] += time.perf_counter() - begun
            lap["cpu"] += time.process_time() - used
            del values, variance, status
        begun, used = time.perf_counter(), time.process_time()
        panorama = compositor.finish()
        lap["finish"] = time.perf_counter() - begun
        lap["cpu"] += time.process_time() - used
        laps.append(lap)
    np.save(job["picture"], panorama.values)
    return {"laps": laps, "flux_errors": [view.flux_error for view in panorama.views]}


def opencv(job: dict[str, Any]) -> dict[str, Any]:
    """Compose with ``cv2.remap``; maps, remap and area mean are timed apart."""
    import cv2

    cv2.setNumThreads(job["threads"])
    lens = make_lens(*job["view"])
    height = job["height"]
    laps = []
    for _ in range(job["repeats"]):
        total = np.zeros((height, 2 * height, 3), np.float32)
        weights = np.zeros((height, 2 * height, 1), np.float32)
        lap = {"maps": 0.0, "remap": 0.0, "mean": 0.0, "cpu": 0.0, "cpu without maps": 0.0}
        for rotation in rotations():
            values = photograph(lens, rotation)
            for begin in range(0, height, ROWS):
                rows = slice(begin, begin + ROWS)
                used = [time.process_time()]
                clock = [time.perf_counter()]
                u, v, blend = _maps(lens, rotation, height, begin)
                clock.append(time.perf_counter())
                used.append(time.process_time())
                fine = cv2.remap(values, u, v, cv2.INTER_LINEAR)
                clock.append(time.perf_counter())
                size = (2 * height, ROWS)
                weight = cv2.resize(blend, size, interpolation=cv2.INTER_AREA)[..., None]
                total[rows] += weight * cv2.resize(fine, size, interpolation=cv2.INTER_AREA)
                weights[rows] += weight
                clock.append(time.perf_counter())
                for name, seconds in zip(("maps", "remap", "mean"), np.diff(clock), strict=True):
                    lap[name] += float(seconds)
                lap["cpu"] += time.process_time() - used[0]
                lap["cpu without maps"] += time.process_time() - used[1]
            del values
        laps.append(lap)
    np.save(job["picture"], total / np.maximum(weights, 1e-6))
    return {"laps": laps}


def _maps(
    lens: Any, rotation: NDArray[np.float64], height: int, begin: int
) -> tuple[NDArray[np.float32], ...]:
    """Return positions counted from the middle of the first pixel, and blending weights."""
    turn = (np.arange(2 * height * PART) + 0.5) * (np.pi / (height * PART))
    polar = (np.arange(begin * PART, (begin + ROWS) * PART) + 0.5) * (np.pi / (height * PART))
    sine, cosine = np.sin(turn).astype(np.float32), np.cos(turn).astype(np.float32)
    across = np.sin(polar).astype(np.float32)[:, None]
    upward = np.cos(polar).astype(np.float32)[:, None]
    x, y, z = (
        across * (sine * axis[0] - cosine * axis[2]) + upward * axis[1]
        for axis in rotation.T.astype(np.float32)
    )
    phi = np.arccos(np.clip(-z, -1.0, 1.0))
    scale = np.float32(lens.focal_length_px) * phi / np.maximum(np.hypot(x, y), np.float32(1e-9))
    u = np.float32(lens.center_px[0] - 0.5) + scale * x
    v = np.float32(lens.center_px[1] - 0.5) - scale * y
    largest = np.float32(np.radians(lens.max_angle_deg))
    seen = phi <= largest
    blend = np.where(seen, np.cos(np.float32(0.5 * np.pi) * phi / largest) ** 2, 0.0)
    return np.where(seen, u, -9.0), np.where(seen, v, -9.0), blend.astype(np.float32)


if __name__ == "__main__":
    given = json.loads(Path(sys.argv[1]).read_text())
    print(json.dumps({"ours": ours, "opencv": opencv}[given["what"]](given)))
