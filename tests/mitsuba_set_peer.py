"""Mitsuba 3's light of a set, run as ``python mitsuba_set_peer.py job.npz out.npz``.

A process of its own, as ``mitsuba_peer.py``. Rays from the capture point are followed by Mitsuba's
path integrator, three bands at a time: in an RGB variant red, green and blue are three numbers.

job: ``corner``, ``along``, ``across`` [q, 3] and ``reflectance`` [q, bands] of one-sided
parallelograms; ``lamp_kind`` [k], ``lamp_center`` [k, 3], ``lamp_axes`` [k, 3, 3], ``lamp_half``
[k, 2] and ``lamp_radiance`` [k, bands]; ``sky`` [rows, 2 rows, bands], or absent;
``sun_direction`` and ``sun_irradiance`` [bands], or absent; ``origin`` [3], ``height``,
``samples`` (rays per texel), ``groups`` that they come in, ``depth``.
"""

from __future__ import annotations

import sys
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Job = dict[str, NDArray]


def matrix(x: NDArray, y: NDArray, z: NDArray, origin: NDArray) -> Any:
    """Columns as a transform."""
    columns = np.eye(4)
    columns[:3] = np.stack([x, y, z, origin], axis=1)
    return mi.ScalarTransform4f(columns)


def rgb(values: NDArray) -> dict[str, Any]:
    return {"type": "rgb", "value": [float(value) for value in values]}


def scene(job: Job, bands: slice) -> mi.Scene:
    """Return the set with three of its bands."""
    result: dict[str, Any] = {"type": "scene"}
    black = {"type": "diffuse", "reflectance": rgb(np.zeros(3))}
    rows = zip(job["corner"], job["along"], job["across"], job["reflectance"], strict=True)
    for index, (corner, along, across, reflectance) in enumerate(rows):
        normal = np.cross(along, across)
        result[f"surface{index}"] = {
            "type": "rectangle",
            "to_world": matrix(along / 2, across / 2, normal, corner + along / 2 + across / 2),
            "bsdf": {"type": "diffuse", "reflectance": rgb(reflectance[bands])},
        }
    for index, kind in enumerate(job["lamp_kind"]):
        center, axes = job["lamp_center"][index], job["lamp_axes"][index]
        a, b = (float(value) for value in job["lamp_half"][index])
        light = {"type": "area", "radiance": rgb(job["lamp_radiance"][index][bands])}
        if kind == "cylinder":
            ends = {f"p{k}": (center + s * a * axes[0]).tolist() for k, s in ((0, -1), (1, 1))}
            shape = {"type": "cylinder", "radius": b, **ends}
        elif kind == "sphere":
            shape = {"type": "sphere", "center": center.tolist(), "radius": a}
        else:
            name = "rectangle" if kind == "rect" else "disk"
            frame = matrix(a * axes[0], -b * axes[1], -axes[2], center - 1e-4 * axes[2])
            shape = {"type": name, "to_world": frame}
        result[f"lamp{index}"] = {**shape, "emitter": light, "bsdf": black}
    if "sky" in job:
        three = np.zeros((*job["sky"].shape[:2], 3), np.float32)
        three[..., : job["sky"][..., bands].shape[2]] = job["sky"][..., bands]
        result["sky"] = {"type": "envmap", "bitmap": mi.Bitmap(three)}
    if "sun_direction" in job:
        result["sun"] = {
            "type": "directional",
            "direction": (-job["sun_direction"]).tolist(),
            "irradiance": rgb(job["sun_irradiance"][bands]),
        }
    return mi.load_dict(result, optimize=False)  # which would join surfaces of the same paint


def directions(height: int, samples: int, random: NDArray) -> NDArray:
    """Return rays in every texel of a latlong map, evenly in solid angle, [h * 2h * s, 3]."""
    edge = np.cos(np.arange(height + 1) * np.pi / height)
    i, j = (part.ravel() for part in np.indices((height, 2 * height)))
    i, j = i.repeat(samples), j.repeat(samples)
    sine = edge[i] + (edge[i + 1] - edge[i]) * random[0]
    angle = 2 * np.pi * (j + random[1]) / (2 * height)
    across = np.sqrt(np.maximum(1 - sine**2, 0))
    return np.stack([across * np.sin(angle), sine, -across * np.cos(angle)])


def render(job: Job) -> NDArray:
    """Return panoramas, each with rays of its own, shape [groups, height, 2 height, bands]."""
    mi.set_variant("llvm_ad_rgb")
    height, samples = int(job["height"]), int(job["samples"])
    depth = int(job["depth"])
    path = mi.load_dict({"type": "path", "max_depth": depth, "rr_depth": depth})
    count = job["reflectance"].shape[1]
    groups = int(job["groups"])
    result = np.zeros((groups, height * 2 * height, count))
    for begin in range(0, count, 3):
        bands = slice(begin, min(begin + 3, count))
        built = scene(job, bands)
        generator = np.random.default_rng(begin)
        per = 64
        passes = max(1, samples // (per * groups))
        for number in range(passes * groups):
            random = generator.random((2, height * 2 * height * per))
            ways = directions(height, per, random).astype(np.float32)
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(10000 * begin + number, ways.shape[1])
            rays = mi.Ray3f(mi.Point3f(*job["origin"].tolist()), mi.Vector3f(*ways))
            value, _, _ = path.sample(built, sampler, mi.RayDifferential3f(rays))
            seen = np.array(value).T.reshape(-1, per, 3).mean(axis=1)
            result[number % groups, :, bands] += seen[:, : bands.stop - begin] / passes
    return result.reshape(groups, height, 2 * height, count)


if __name__ == "__main__":
    with np.load(sys.argv[1]) as job:
        picture = render(dict(job))
    np.savez(sys.argv[2], picture=picture)
