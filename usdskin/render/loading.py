"""A stage at one time, ready to be drawn: read, lit and on the device.

Reads: the stage. Makes: ``Loaded``, from one moment to the next with all that cannot have changed
(``usdskin.render.frame_cache``).
"""

from __future__ import annotations

import math
import time as clock
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers
from usdskin.errors import UsageError
from usdskin.render.cameras import Camera
from usdskin.render.frame_cache import FrameCache
from usdskin.render.integrate import DeviceScene, FirstFaces, Share
from usdskin.render.job import RenderReport, RenderSettings
from usdskin.render.light_maps import LightField
from usdskin.render.lights import Lights
from usdskin.render.meshes import MeshArrays
from usdskin.render.products import Product
from usdskin.render.scene import Scene, read_scene, scene_white
from usdskin.render.transfer import read_transfers
from usdskin.render.transfer_light import (
    DeviceTransfers,
    LitTransfers,
    lit_transfers,
    upload_transfers,
)
from usdskin.render.uploading import upload

# isort: split
# After ours, which register the schemas.
from pxr import Usd

if TYPE_CHECKING:
    from usdskin.render.traced_lights import TracedLights

_SHADOW_FIELDS = (
    "transfer_vertex", "transfer", "seen_row", "seen_hidden", "seen_ring", "seen_order", "seen_axes"
)  # fmt: skip
"""Fields of ``Geometry`` that baked shadows fill."""


@dataclass(frozen=True, slots=True, eq=False)
class Loaded:
    """A scene at one time, on the host and on the device."""

    scene: Scene
    device_scene: DeviceScene
    white: NDArray[np.float64]
    """XYZ of a perfect diffuser in the mean light, shape [3]."""

    traced: TracedLights | None
    """What rays are sent to, where light is traced."""

    shadows: LitTransfers | None
    """Baked ones under the lights, where there are some; see ``Loader.light_shadows``."""


class Loader:
    """Reads scenes, and keeps what the next one may need."""

    def __init__(
        self,
        stage: Usd.Stage,
        settings: RenderSettings,
        workers: Workers,
        report: RenderReport,
        cache: FrameCache,
    ) -> None:
        self._stage, self._settings = stage, settings
        self._workers, self._report, self._cache = workers, report, cache
        self._last: tuple[tuple[Usd.TimeCode, Usd.TimeCode], Loaded] | None = None
        self._baked: tuple[tuple[MeshArrays, ...], DeviceTransfers | None] | None = None
        self._shadows: (
            tuple[tuple[MeshArrays, ...], Lights, dict[str, Any], LitTransfers] | None
        ) = None

    def forget(self) -> None:
        """Keep nothing: a frame failed, and its parts may not belong together."""
        self._cache.forget()
        self._last = self._baked = self._shadows = None

    def load(self, time: Usd.TimeCode, base: Usd.TimeCode, *, keep: bool = True) -> Loaded:
        """Return the scene at a time.

        Args:
            time: When, while the shutter is open.
            base: The frame, which says what there is to move.
            keep: Keep it for the products to come.
        """
        if self._last is not None and self._last[0] == (time, base):
            return self._last[1]
        self._last = None  # memory for one scene, not for two
        settings, cache, seconds = self._settings, self._cache, self._report.seconds
        begun = clock.perf_counter()
        scene = read_scene(self._stage, time, settings, self._report.notes, cache, base=base)
        begun = _lap(seconds, "read", begun)
        baked = self._transfers(scene)
        traced = settings.integrator == "traced"
        # Straight alpha needs the dome hidden, and every EXR has alpha.
        device_scene, light = upload(
            scene,
            self._workers,
            show_dome=settings.dome == "show",
            brute=settings.spectral_method == "brute",
            traced=traced,
            bounces=settings.bounces,
            measured=baked is not None,
            cache=cache,
        )
        device = self._workers.device
        white = cache.of_lights("white", scene, lambda: scene_white(scene))
        rays = None
        if traced:
            from usdskin.render.traced_lights import trace_lights, turn_traced_lights

            rays = cache.of_lights(
                "traced",
                scene,
                lambda: trace_lights(scene.lights, light, scene.frame, device),
                lambda found, lights: turn_traced_lights(found, lights, device),
            )
        begun = _lap(seconds, "bake", begun)
        shadows = None
        if baked is not None:
            shadows = self._lit(baked, scene, light, device_scene)
            begun = _lap(seconds, "shadows", begun)
        compilation.finish()
        _lap(seconds, "compile", begun)
        loaded = Loaded(scene, device_scene, white, rays, shadows)
        if keep:
            self._last = (time, base), loaded
        return loaded

    def first_faces(
        self, seen: Loaded, camera: Camera, product: Product, share: Share
    ) -> FirstFaces | None:
        """Return what keeps the first triangles of a picture, where one may see the same again."""
        if camera.lens_radius > 0.0:
            return None  # every sample looks from a place of its own
        samples = math.prod(product.resolution) * self._settings.samples_per_pixel
        picture = product.camera, product.resolution
        return self._cache.first_faces(seen.scene, picture, (*camera.rays(), share), samples)

    def _transfers(self, scene: Scene) -> DeviceTransfers | None:
        """Return the shadows that were baked for a scene, for the integrator that takes them."""
        settings = self._settings
        if settings.integrator == "traced":
            return None
        if self._baked is None or self._baked[0] is not scene.meshes:
            found = read_transfers(self._stage, scene, settings)
            if settings.spectral_method == "brute" and found is not None:
                raise UsageError(
                    "--spectral brute takes no baked shadows; leave the transfer layer out, or "
                    "render with --integrator traced."
                )
            there = None if found is None else upload_transfers(found, self._workers.device)
            self._baked = scene.meshes, there
        return self._baked[1]

    def light_shadows(self, seen: Loaded, faces: FirstFaces | None = None) -> None:
        """Have the baked shadows ready that a picture shows: all, or those of its first faces."""
        if seen.shadows is not None:
            begun = clock.perf_counter()
            count = len(seen.device_scene.faces.triangles)
            seen.shadows.light(None if faces is None else faces.triangles(count))
            _lap(self._report.seconds, "shadows", begun)

    def _lit(
        self, baked: DeviceTransfers, scene: Scene, light: LightField, device_scene: DeviceScene
    ) -> LitTransfers:
        """Return the shadows under the lights, or take them over where neither has changed."""
        geometry = device_scene.geometry
        known = self._shadows
        if known is not None and known[0] is scene.meshes and known[1] is scene.lights:
            for name, value in known[2].items():
                setattr(geometry, name, value)
            return known[3]
        lit = lit_transfers(baked, scene.lights, light, device_scene, self._workers)
        fields = {name: getattr(geometry, name) for name in _SHADOW_FIELDS}
        self._shadows = scene.meshes, scene.lights, fields, lit
        return lit


def _lap(seconds: dict[str, float], part: str, begun: float) -> float:
    now = clock.perf_counter()
    seconds[part] = seconds.get(part, 0.0) + now - begun
    return now
