"""What the middle of every pixel sees: the data parts of a picture that no light is in."""

from __future__ import annotations

from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers
from usdskin.render.cameras import Camera
from usdskin.render.integrate import TILE_PIXELS, DeviceScene, device_camera
from usdskin.warp_kernels import data


def collect_data(
    scene: DeviceScene,
    camera: Camera,
    resolution: tuple[int, int],
    workers: Workers,
    *,
    irradiance: bool = False,
) -> dict[str, NDArray[np.float32]]:
    """Return what the middle of every pixel sees.

    Returns:
        ``normal`` [h, w, 3], ``position`` [m] [h, w, 3], ``depth`` [m] [h, w], ``base`` [h, w, 4],
        ``st`` [h, w, 2], ``face`` [h, w], the triangle or -1, and where wanted ``irradiance``
        [h, w, 3], its XYZ.
    """
    width, height = resolution
    count = width * height
    device = workers.device
    compilation.load(data, device)
    rays = device_camera(camera, resolution)
    found: dict[str, NDArray[Any]] = {
        "normal": np.zeros((count, 3), np.float32),
        "position": np.zeros((count, 4), np.float32),
        "base": np.zeros((count, 4), np.float32),
        "st": np.zeros((count, 2), np.float32),
        "face": np.zeros(count, np.int32),
    }
    types = {"normal": wp.vec3f, "position": wp.vec4f, "base": wp.vec4f, "st": wp.vec2f,
             "face": wp.int32}  # fmt: skip
    if irradiance:
        found["irradiance"] = np.zeros((count, 3), np.float32)
        types["irradiance"] = wp.vec3f

    def work(begin: int, end: int) -> None:
        tile = data.DataTile()
        tile.first_pixel = begin
        tile.st_primvar = scene.st_primvar
        for name, dtype in types.items():
            setattr(tile, name, wp.zeros(end - begin, dtype=dtype, device=device))
        if not irradiance:
            tile.irradiance = wp.zeros(0, dtype=wp.vec3f, device=device)
        data.render_data(scene.geometry, rays, scene.lights, scene.materials, tile)
        for name, values in found.items():
            values[begin:end] = getattr(tile, name).numpy()

    workers.run(count, TILE_PIXELS if device == "cpu" else count, work)
    position = found.pop("position")
    found["position"], found["depth"] = position[:, :3], position[:, 3]
    return {
        name: values.reshape(height, width, *values.shape[1:]) for name, values in found.items()
    }
