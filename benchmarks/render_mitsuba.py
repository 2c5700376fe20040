"""Mitsuba's half of the comparison: ``python -m benchmarks.render_mitsuba JOB.json``.

Prints one line of JSON.

Tuned as a fair peer: multijitter samples, one bounce, and an envmap whose importance sampling
leaves to the surface what that samples better (``mis_compensation``). Loading the scene, with
Mitsuba's BVH and its sampling tables, is reported apart; its time to pixels begins where ours has
still to bake and to build.
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
    """Render ``repeats`` + 1 times, a seed each; the first time, kernels are compiled.

    Saves the middle quarters of the pictures, or where the job says ``whole`` all of them.
    ``turn`` in the job has the room (``light``) or the camera go once around in as many pictures.
    """
    import mitsuba as mi

    mi.set_variant(job["variant"])
    begun = time.perf_counter()
    loaded = mi.load_dict(_scene(job))
    load = time.perf_counter() - begun
    laps: list[dict[str, float]] = []
    pictures = []
    for seed in range(job["repeats"] + 1):
        if job.get("turn"):
            _turn(loaded, job["turn"], max(seed - 1, 0) / job["repeats"])
        before, begun = resource.getrusage(resource.RUSAGE_SELF), time.perf_counter()
        picture = np.array(mi.render(loaded, seed=job.get("first_seed", 0) + seed))
        wall, after = time.perf_counter() - begun, resource.getrusage(resource.RUSAGE_SELF)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        laps.append({"pixels": wall, "wall": wall, "cpu": cpu})
        pictures.append(picture if job.get("whole") else scene.crop(picture))
    if job["picture"] is not None:
        np.save(job["picture"], np.stack(pictures))
    return {"load": load, "first": laps[0], "laps": laps[1:] or laps}


def _turn(loaded: Any, what: str, share: float) -> None:
    """Turn the room or the camera about the body's upright axis by a share of a full turn."""
    import mitsuba as mi

    parameters = mi.traverse(loaded)
    turn = mi.ScalarTransform4f().rotate([0, 1, 0], 360.0 * share)
    if what == "camera":
        turn = turn @ mi.ScalarTransform4f().look_at(
            [0, 0, scene.CAMERA_DISTANCE], [0, 0, 0], [0, 1, 0]
        )
    name = {"light": "light.to_world", "camera": "sensor.to_world"}[what]
    parameters[name] = mi.Transform4f(turn.matrix)
    parameters.update()


def _scene(job: dict[str, Any]) -> dict[str, Any]:
    import mitsuba as mi

    is_spectral = job["variant"].endswith("spectral")
    if job["bands"]:
        film: dict[str, Any] = {"type": "specfilm"}
        for k, center in enumerate(scene.BANDS_NM):
            box = [(center - 2.501, 0.0), (center - 2.5, 1.0), (center + 2.5, 1.0)]
            film[f"band{k:03d}"] = {"type": "spectrum", "value": [*box, (center + 2.501, 0.0)]}
    else:
        film = {"type": "hdrfilm", "pixel_format": "rgb"}
    if job["integrator"] == "emitter only":
        mi.register_integrator("emitter_only", _emitter_only())
        integrator = {"type": "emitter_only"}
    else:
        integrator = {"type": "path", "max_depth": 2, "hide_emitters": True}
    room = scene.environment()[..., None].repeat(3, axis=-1)
    return {
        "type": "scene",
        "integrator": integrator,
        "sensor": {
            "type": "perspective",
            "fov": scene.FOV_DEG,
            "to_world": mi.ScalarTransform4f().look_at(
                [0, 0, scene.CAMERA_DISTANCE], [0, 0, 0], [0, 1, 0]
            ),
            "sampler": {"type": "multijitter", "sample_count": job["samples"]},
            "film": {
                "width": job["size"],
                "height": job["size"],
                "component_format": "float32",
                "rfilter": {"type": "box"},
                **film,
            },
        },
        "light": {
            "type": "envmap",
            "bitmap": mi.Bitmap(room),
            "mis_compensation": integrator["type"] == "path",  # alone it would lose light
        },
        "body": _body(job["mesh"], is_spectral),
    }


def _body(mesh: str, is_spectral: bool) -> Any:
    import mitsuba as mi

    if is_spectral:
        nm, value = scene.BANDS_NM, scene.reflectance()
        table = [(nm[0] - 2.501, 0.0), (nm[0] - 2.5, value[0])]  # dark beyond our bands
        table += list(zip(nm, value, strict=True))
        table += [(nm[-1] + 2.5, value[-1]), (nm[-1] + 2.501, 0.0)]
        color = {"type": "spectrum", "value": [(float(x), float(y)) for x, y in table]}
    else:
        color = {"type": "rgb", "value": scene.reflectance_rgb().tolist()}
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": color})
    points, normals, faces = scene.shape(mesh)
    shape = mi.Mesh("body", len(points), len(faces), props=properties, has_vertex_normals=True)
    parameters = mi.traverse(shape)
    parameters["vertex_positions"] = mi.Float(points.astype(np.float32).ravel())
    parameters["vertex_normals"] = mi.Float(normals.astype(np.float32).ravel())
    parameters["faces"] = mi.UInt32(faces.astype(np.uint32).ravel())
    parameters.update()
    return shape


def _emitter_only() -> type:
    """Return the cheapest integrator that makes the same picture: no shadow rays."""
    import drjit as dr
    import mitsuba as mi

    class EmitterOnly(mi.SamplingIntegrator):
        def sample(
            self,
            scene: mi.Scene,
            sampler: mi.Sampler,
            ray: mi.RayDifferential3f,
            medium: Any = None,
            active: mi.Bool = True,
        ) -> tuple[Any, Any, list[Any]]:
            si = scene.ray_intersect(ray, active)
            active = active & si.is_valid()
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(active), False, active)
            value = si.bsdf(ray).eval(mi.BSDFContext(), si, si.to_local(ds.d), active)
            return dr.select(active, value * weight, 0.0), active, []

    return EmitterOnly


if __name__ == "__main__":
    print(json.dumps(run(json.loads(Path(sys.argv[1]).read_text()))))
