"""Time Mitsuba 3 on the subject, in a process of its own; prints one line of JSON.

Tuned: the multijitter sampler, an envmap with MIS compensation, and no more bounces than the direct
light that our map integrator shows. The body is convex, so its shadow rays never hit.
"""

from __future__ import annotations

import argparse
import json
import resource
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.subject import ALBEDO, DISTANCE, WINDOW, body, room


def scene_of(
    mi: Any, triangle_count: int, size: int, samples: int, bands: int, emitter_only: bool
) -> Any:
    """Return the subject as a Mitsuba scene."""
    shape = body(triangle_count)
    mesh = mi.Mesh("body", len(shape.points), len(shape.triangles), has_vertex_normals=True)
    values = mi.traverse(mesh)
    values["vertex_positions"] = shape.points.ravel()
    values["vertex_normals"] = shape.normals.ravel()
    values["faces"] = shape.triangles.ravel().astype(np.uint32)
    values.update()
    folder = Path(tempfile.mkdtemp())
    mesh.write_ply(str(folder / "body.ply"))
    film: dict[str, Any] = {
        "type": "hdrfilm", "width": size, "height": size, "rfilter": {"type": "box"},
        "pixel_format": "rgb", "component_format": "float32",
    }  # fmt: skip
    if bands:
        film = {"type": "specfilm", "width": size, "height": size, "rfilter": {"type": "box"},
                "component_format": "float32"}  # fmt: skip
        for k, nm in enumerate(np.linspace(400.0, 700.0, bands)):
            film[f"band{k:03d}"] = {
                "type": "spectrum", "value": [(nm - 5.0, 0.0), (nm, 0.2), (nm + 5.0, 0.0)],
            }  # fmt: skip
    integrator: dict[str, Any] = {"type": "path", "max_depth": 2, "hide_emitters": True}
    if emitter_only:
        integrator = {"type": "direct", "emitter_samples": 1, "bsdf_samples": 0,
                      "hide_emitters": True}  # fmt: skip
    # Mitsuba's latlong map and UsdLux's agree: the middle at +Z, the top at +Y.
    return mi.load_dict(
        {
            "type": "scene",
            "integrator": integrator,
            "sensor": {
                "type": "perspective",
                "fov": float(np.degrees(2.0 * np.arctan(WINDOW / 0.5 / 2.0))),
                "to_world": mi.ScalarTransform4f().look_at(
                    origin=[0, 0, DISTANCE], target=[0, 0, 0], up=[0, 1, 0]
                ),
                "film": film,
                "sampler": {"type": "multijitter", "sample_count": samples},
            },
            "light": {
                "type": "envmap",
                "bitmap": mi.Bitmap(room()),
                "mis_compensation": True,
            },
            "body": {
                "type": "ply",
                "filename": str(folder / "body.ply"),
                "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": ALBEDO}},
            },
        }
    )


def main() -> None:
    """Render ``--repeat`` times to pixels in memory and report the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--variant", default="llvm_ad_spectral")
    parser.add_argument("--triangles", type=int, default=50_000)
    parser.add_argument("--size", type=int, default=512)
    parser.add_argument("--samples", type=int, default=64)
    parser.add_argument("--bands", type=int, default=0, help="61 for specfilm")
    parser.add_argument("--emitter-only", action="store_true")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--picture", type=Path, help="where to save the mean as .npy")
    given = parser.parse_args()

    import mitsuba as mi

    mi.set_variant(given.variant)
    mi.set_log_level(mi.LogLevel.Error)
    begun = time.perf_counter()
    scene = scene_of(
        mi, given.triangles, given.size, given.samples, given.bands, given.emitter_only
    )
    read = time.perf_counter() - begun
    walls, cpus, pictures = [], [], []
    for seed in range(given.repeat + 1):  # the first compiles the kernels
        begun, cpu = time.perf_counter(), time.process_time()
        pixels = np.array(mi.render(scene, seed=seed))
        walls.append(time.perf_counter() - begun)
        cpus.append(time.process_time() - cpu)
        if given.picture is not None:
            pictures.append(pixels)
    if given.picture is not None:
        np.save(given.picture, np.stack(pictures))
    print(
        json.dumps(
            {
                "wall_s": float(np.median(walls[1:])),
                "cpu_s": float(np.median(cpus[1:])),
                "first_s": walls[0],
                "read_s": read,
                "peak_mb": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0,
            }
        )
    )


if __name__ == "__main__":
    main()
