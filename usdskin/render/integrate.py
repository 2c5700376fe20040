"""From a scene's arrays to a picture's arrays.

Tiles of whole rows are rendered by disjoint launches; a pixel depends on nothing but itself, so
the picture is the same whatever the tiles, threads or their order.
"""

from __future__ import annotations

from collections.abc import Callable, Collection
from dataclasses import dataclass, field
from types import ModuleType
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers
from usdskin.progress import Progress
from usdskin.render.aovs import TRACED_SOURCES
from usdskin.render.cameras import Camera
from usdskin.render.checkpoint import Checkpoint, keeping
from usdskin.render.film import sample_offsets
from usdskin.render.memory import pixel_zeros
from usdskin.render.projection import project
from usdskin.render.surfaces import band_groups
from usdskin.warp_kernels import film, first_faces, raster, structs

TILE_PIXELS = 16384
"""Pixels of one launch on the CPU."""

GPU_TILE_PIXELS = 1 << 20

GPU_TILE_SAMPLES = 1 << 24
"""Samples whose triangles are kept at once."""


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """The triangles of all meshes, on the host."""

    points: NDArray[np.float32]
    """Vertices [m], shape [vertex_count, 3]."""

    triangles: NDArray[np.int32]
    """Vertex indices, shape [triangle_count, 3]."""

    prim: NDArray[np.int32]
    """Index of each triangle's mesh, shape [triangle_count]."""

    material: NDArray[np.int32]
    """Index of each triangle's material, shape [triangle_count]."""


@dataclass(frozen=True, slots=True, eq=False)
class DeviceScene:
    """Everything a picture needs, on the device."""

    geometry: structs.Geometry
    lights: structs.Lights
    materials: structs.Materials
    max_rows: int
    band_count: int
    st_primvar: int
    """Row of st in the corner values, -1 where no mesh has it."""

    faces: Faces

    albedo: tuple[NDArray[np.float64], ...]
    """RGB under D65 of each material's base weights, shape [base_count, 3] each."""

    keep: tuple[object, ...]
    """Objects the structs point into, such as the ``wp.Mesh``."""


@dataclass(frozen=True, slots=True)
class Share:
    """Some of a pixel's samples: every ``count``-th, from number ``index`` on."""

    index: int
    count: int

    def of(self, samples: NDArray[Any]) -> NDArray[Any]:
        """Return these of all samples."""
        return np.ascontiguousarray(samples[self.index :: self.count])

    def size(self, samples: int) -> int:
        """Return how many of all samples these are."""
        return len(range(self.index, samples, self.count))

    def first(self, samples: int) -> int:
        """Return how many samples the shares before have."""
        return sum(Share(k, self.count).size(samples) for k in range(self.index))


WHOLE = Share(0, 1)


@dataclass(slots=True, eq=False)
class FirstFaces:
    """The first triangle of every sample of a picture, from one frame to the next."""

    tiles: dict[int, wp.array] = field(default_factory=dict)
    """By a tile's first pixel, -1 for none, shape [pixels, samples]; empty until they are known."""

    _triangles: NDArray[np.bool_] | None = None

    def triangles(self, count: int) -> NDArray[np.bool_] | None:
        """Return which of ``count`` triangles are among them, None before they are known."""
        if self._triangles is None and self.tiles:
            found = np.zeros(count + 1, np.bool_)  # the last for samples that meet none
            for face in self.tiles.values():
                found[face.numpy().ravel()] = True
            self._triangles = found[:-1]
        return self._triangles


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One rendered picture."""

    xyza: NDArray[np.float32]
    """XYZ of scene radiance, unexposed, and alpha, shape [height, width, 4]."""

    spectrum: NDArray[np.float32] | None
    """Spectral radiance, shape [height, width, bands]."""

    extra: dict[str, NDArray[np.float32]] = field(default_factory=dict)
    """What only tracing measures, by name: parts of the XYZ, shape [height, width, 3], and
    ``variance`` of Y, ``sampleCount`` and ``visibility``, shape [height, width]."""

    unshadowed: NDArray[np.float32] | None = None
    """Y of the diffuse light as if nothing stood in its way, where there is ``visibility``, shape
    [height, width]."""


def picture_kernels(device: str, sources: Collection[str], traced: bool) -> tuple[ModuleType, ...]:
    """Return the kernels that a picture is known to need, the costliest to compile first.

    Args:
        device: Where they run.
        sources: The data parts written beside the beauty.
        traced: Whether light is traced.
    """
    faces = ["raster"] if device == "cpu" else [] if traced else ["first_faces"]
    mattes = [source for source in sources if source.startswith("crypto")]
    sources = [source for source in sources if source not in TRACED_SOURCES]
    names = (
        "trace" if traced else "film",
        *faces,
        "reflectance_map",
        *(["matte"] if mattes else []),
        *(["data"] if len(sources) > len(mattes) else []),
    )
    return tuple(compilation.kernel_module(name) for name in names)


def device_camera(camera: Camera, resolution: tuple[int, int]) -> structs.CameraRays:
    """Return a camera as the kernels take it."""
    rays = structs.CameraRays()
    axes = camera.to_world.astype(np.float32)
    rays.right, rays.up, rays.back, rays.origin = (
        wp.vec3f(*axes[:3, column].tolist()) for column in range(4)
    )
    rays.window = wp.vec4f(*(float(edge) for edge in camera.window))
    rays.near, rays.far = camera.clip_near, min(camera.clip_far, 1.0e18)
    rays.lens_radius, rays.focus_distance = camera.lens_radius, camera.focus_distance
    rays.orthographic = int(camera.orthographic)
    rays.width, rays.height = resolution
    return rays


def _finder(
    scene: DeviceScene,
    camera: Camera,
    resolution: tuple[int, int],
    offsets: wp.array,
    rows: int,
    known: FirstFaces | None,
    device: str,
) -> Callable[[int, int], wp.array]:
    """Return what gives the first triangle of every sample of a tile, by its first and last pixel.

    On the CPU they are rasterised, unless a triangle crosses the near plane; else met by rays. With
    a lens every sample has a ray of its own, and they are not found beforehand.
    """
    if known is not None and known.tiles:
        return lambda begin, end: known.tiles[begin]
    if camera.lens_radius > 0.0:
        return lambda begin, end: wp.empty((0, 0), dtype=wp.int32, device=device)
    width, rays, faces = resolution[0], device_camera(camera, resolution), scene.faces
    projection = None
    if device == "cpu":
        compilation.load(raster, device)
        reach = float(np.abs(offsets.numpy()).max())
        projection = project(faces.points, faces.triangles, camera, resolution, rows, reach, device)
    if projection is None:
        compilation.load(first_faces, device)
        return lambda begin, end: first_faces.find_first_faces(
            scene.geometry, rays, offsets, begin, end - begin
        )
    return lambda begin, end: raster.rasterize_band(
        projection, offsets, begin // width // rows, width, begin // width, (end - begin) // width
    )


def integrate(
    scene: DeviceScene,
    camera: Camera,
    resolution: tuple[int, int],
    samples: int,
    pixel_filter: str,
    workers: Workers,
    progress: Progress,
    *,
    spectral: bool,
    show_dome: bool,
    checkpoint: Checkpoint | None = None,
    share: Share = WHOLE,
    faces: FirstFaces | None = None,
) -> Picture:
    """Render a picture.

    Args:
        scene: The scene on the workers' device.
        camera: Where from.
        resolution: Width and height [px].
        samples: Samples per pixel.
        pixel_filter: Name of the pixel filter.
        workers: Where to compute.
        progress: Advances by pixels.
        spectral: Whether to return spectra.
        show_dome: Whether the domes are seen behind the surfaces.
        checkpoint: Keeps what is finished; None keeps nothing.
        share: Which of the samples to take.
        faces: Of a picture of the same geometry from the same camera: taken where they are known,
            else put there. None keeps nothing.
    """
    width, height = resolution
    count = width * height
    device = workers.device
    rays = device_camera(camera, resolution)
    chosen = share.of(sample_offsets(samples, pixel_filter))
    offsets = wp.array(chosen, dtype=wp.vec2f, device=device)
    xyza = np.zeros((count, 4), np.float32)
    bands = scene.band_count if spectral else 0
    folder = checkpoint.file.parent if checkpoint is not None else None
    spectrum = pixel_zeros(resolution, (band_groups(bands), 4), folder)
    on_host = device == "cpu"
    chunk = TILE_PIXELS if on_host else min(GPU_TILE_PIXELS, GPU_TILE_SAMPLES // len(chosen))
    rows = min(max(1, chunk // width), height)
    found: dict[int, wp.array] = {}
    find = _finder(scene, camera, resolution, offsets, rows, faces, device)

    def work(begin: int, end: int) -> None:
        if tiles.restored(begin, end):
            return
        tile = structs.Film()
        tile.sample = offsets
        tile.first_sample, tile.sample_count = share.first(samples), samples
        tile.first_pixel = begin
        tile.face = find(begin, end)
        if faces is not None:  # the kernel marks what it has drawn
            found[begin], tile.face = tile.face, wp.clone(tile.face)
        tile.show_dome = int(show_dome)
        tile.channel = wp.zeros((end - begin, scene.max_rows), dtype=wp.vec4f, device=device)
        if on_host:  # the kernel writes into the picture itself
            tile.xyza = wp.array(xyza[begin:end], dtype=wp.vec4f, device=device, copy=False)
            tile.spectrum = wp.array(spectrum[begin:end], dtype=wp.vec4f, device=device, copy=False)
        else:
            tile.xyza = wp.zeros(end - begin, dtype=wp.vec4f, device=device)
            shape = (end - begin, band_groups(bands))
            tile.spectrum = wp.zeros(shape, dtype=wp.vec4f, device=device)
        film.render_tile(scene.geometry, rays, scene.lights, scene.materials, tile)
        if not on_host:
            xyza[begin:end] = tile.xyza.numpy()
            spectrum[begin:end] = tile.spectrum.numpy()
        tiles.finished(begin, end)

    compilation.load(film, device)  # once, before the threads ask for it together
    progress.start(count, "render")
    with keeping(checkpoint, {"xyza": xyza, "spectrum": spectrum}) as tiles:
        workers.run(count, rows * width, work, progress.advance)
    progress.done()
    if faces is not None and len(found) == -(-height // rows):  # of tiles restored, none are known
        faces.tiles = found
    return Picture(
        xyza.reshape(height, width, 4),
        spectrum.reshape(height, width, -1)[:, :, :bands] if spectral else None,
    )
