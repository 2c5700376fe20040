"""Local lights sampled and looked at through the kernels: for the tests of local lights."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import warp as wp
from local_light_probes import probe_rays, probe_samples
from scipy.stats import qmc

from usdskin.device import vec3
from usdskin.render.local_light_arrays import build_local_field
from usdskin.render.local_lights import LocalLight

U = np.minimum(qmc.Sobol(2, seed=1).random_base2(14), 1.0 - 2.0**-24).astype(np.float32)

SHAPES = {
    "rect": (0.5, 0.3),
    "disk": (0.4, 0.4),
    "sphere": (0.4, 0.4),
    "cylinder": (0.6, 0.05),
}


ON = SimpleNamespace(device="cpu")
"""Where a test's kernels run."""


def local_light(kind="rect", half=None, center=(0.0, 0.0, 0.0), axes=None, channels=1, **options):
    return LocalLight(
        "/Light",
        kind,
        np.array(center, dtype=np.float64),
        np.eye(3) if axes is None else axes,
        SHAPES.get(kind, (0.0, 0.0)) if half is None else half,
        np.ones((channels, 2)),
        False,
        **options,
    )


def draw(one: LocalLight, position, before: tuple[LocalLight, ...] = ()) -> SimpleNamespace:
    """Sample a light from one position, at all points of a Sobol sequence."""
    field = build_local_field((*before, one), one.radiance.shape[1], ON.device)
    numbers, radiance, again, met = (
        wp.zeros((1, len(U)), dtype=wp.vec4f, device=ON.device) for _ in range(4)
    )
    direction = wp.zeros((1, len(U)), dtype=wp.vec3f, device=ON.device)
    where = vec3(np.atleast_2d(position), ON.device)
    u = wp.array(U, dtype=wp.vec2f, device=ON.device)
    inputs = [field.device_lights, len(before), where, u, direction, numbers, radiance, again, met]
    wp.launch(probe_samples, (1, len(U)), inputs, device=ON.device)
    found = numbers.numpy()[0].astype(np.float64)
    back = again.numpy()[0].astype(np.float64)
    return SimpleNamespace(
        direction=direction.numpy()[0].astype(np.float64),
        weight=found[:, 0],
        pdf=found[:, 1],
        distance=found[:, 2],
        delta=found[:, 3],
        radiance=radiance.numpy()[0].astype(np.float64),
        pdf_again=back[:, 0],
        distance_again=back[:, 1],
        radiance_again=met.numpy()[0].astype(np.float64),
    )


def look(one: LocalLight, position, direction) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return distance, density and radiance along rays."""
    field = build_local_field((one,), one.radiance.shape[1], ON.device)
    out = wp.zeros(len(direction), dtype=wp.vec2f, device=ON.device)
    radiance = wp.zeros(len(direction), dtype=wp.vec4f, device=ON.device)
    wp.launch(
        probe_rays,
        len(direction),
        [field.device_lights, 0, wp.vec3f(*position), vec3(direction, ON.device), out, radiance],
        device=ON.device,
    )
    found = out.numpy().astype(np.float64)
    return found[:, 0], found[:, 1], radiance.numpy()


def irradiance(one: LocalLight, position, normal) -> float:
    drawn = draw(one, position)
    cosine = np.maximum(drawn.direction @ np.asarray(normal), 0.0)
    return float((drawn.radiance[:, 0] * drawn.weight * cosine).mean())
