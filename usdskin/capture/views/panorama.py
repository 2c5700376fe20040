"""Views, one after another, become one panorama: a latlong map in ``usdskin.latlong``'s layout.

Every texel is the mean of a view over the texel's solid angle, bilinear between pixels, on a grid
so fine that no pixel is stepped over; so flux is conserved, and no lamp falls between samples.
Views are then averaged. A view's weight is cos^2((pi / 2) phi / phi_max), which lets it fade out
towards its rim, over its variance at equal radiance, which is one number per view over V(phi). A
weight that followed each pixel's own variance would prefer the darker of two values, and lose flux
wherever noise, or the edge of a lamp that two views place a little differently, parts them. Memory
holds one view and the sums.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.capture.views.fill import Hole, fill_holes, find_holes
from usdskin.device import Workers
from usdskin.fisheye import (
    angle_to_radius,
    check_lens,
    max_radius,
    project,
    radius_slope,
    radius_to_angle,
    vignetting,
)
from usdskin.latlong import texel_directions, texel_solid_angles
from usdskin.prims.lenses import FisheyeLens
from usdskin.progress import Progress
from usdskin.warp_kernels import fisheye
from usdskin.warp_kernels import panorama as kernels

FloatArray = NDArray[np.float64]
PixelArray = NDArray[np.float32]

_NODES = 4096
_CHUNK_ROWS = 32
_BLEND_EXPONENT = 2.0
_LEAST_BLEND = 1e-4
"""Keeps rims that only just meet, as those of two back-to-back views do."""

_LEAST_NOISE = 1e-6
"""Least noise of a view over that of the first."""

_BLOCK_PX = 16
_CELLS = 4


@dataclass(frozen=True, slots=True, eq=False)
class ComposedView:
    """What became of one view."""

    name: str
    """Name given to ``add_view``."""

    flux: FloatArray
    """Integral of rho over the view's solid angle, summed over its pixels, shape [3]."""

    panorama_flux: FloatArray
    """The same, summed over the panorama's texels of this view alone, shape [3]."""

    overlap_difference: float | None
    """Median relative difference from the views before it, where noise is below a tenth; None
    where they share nothing like that."""

    @property
    def flux_error(self) -> float:
        """Largest relative difference of the two over the channels, relative to the brightest."""
        brightest = float(np.abs(self.flux).max())
        difference = float(np.abs(self.panorama_flux - self.flux).max())
        return difference / brightest if brightest > 0.0 else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """The light all around, in camera values."""

    values: PixelArray
    """rho, at least 0, shape [height, width, 3]; holes are filled smoothly."""

    stddev: PixelArray
    """Standard deviation of each texel; neighbours share pixels, so it falls slowly in their
    mean. In holes it is as large as the value. Shape [height, width, 3]."""

    seen: PixelArray
    """Share of the texel's area that any view sees, by 4 x 4 cells, 0 in holes, shape [height,
    width]."""

    clipped: PixelArray
    """Share of the texel whose value is a lower bound only, shape [height, width]."""

    moved: PixelArray
    """Share of the texel that moved between exposures, shape [height, width]."""

    view_count: NDArray[np.uint8]
    """Number of views each texel was averaged from, shape [height, width]."""

    coverage: float
    """Share of the sphere that any view sees [1]."""

    holes: tuple[Hole, ...]
    """Connected regions no view sees, largest first."""

    negative_count: int
    """Texels with a channel below 0, from noise in the dark, set to 0 there."""

    negative_share: float
    """Share of the sphere they take [1]."""

    overlap_difference: float | None
    """Median relative difference of overlapping views; see ``ComposedView``."""

    views: tuple[ComposedView, ...]
    """The views in the order they were added."""


class Compositor:
    """Averages views into a panorama; the result does not depend on threads."""

    def __init__(self, height: int, workers: Workers, progress: Progress) -> None:
        """Begin a panorama of ``height`` x 2 ``height`` texels.

        Args:
            height: Rows of the panorama.
            workers: Where the kernels run.
            progress: Told about the rows of each view.
        """
        if height < 2:
            raise ValueError(f"a panorama of {height} rows")
        self._workers = workers
        self._progress = progress
        self._chunk = _CHUNK_ROWS if workers.device == "cpu" else height
        self._sums: Any = kernels.Sums()
        shape = (height, 2 * height)
        for name, kind in (
            ("value", wp.vec3f),
            ("variance", wp.vec3f),
            ("weight", wp.float32),
            ("clipped", wp.float32),
            ("moved", wp.float32),
            ("cells", wp.uint16),
            ("count", wp.uint8),
        ):
            setattr(self._sums, name, wp.zeros(shape, dtype=kind, device=workers.device))
        self._reference = 0.0
        self._views: list[ComposedView] = []
        self._differences: list[PixelArray] = []
        compilation.load(kernels, workers.device)

    @property
    def height(self) -> int:
        """Rows of the panorama."""
        return int(self._sums.weight.shape[0])

    def add_view(
        self,
        lens: FisheyeLens,
        pano_from_camera: FloatArray,
        values: PixelArray,
        variance: PixelArray,
        status: NDArray[np.uint8],
        *,
        name: str = "view",
    ) -> ComposedView:
        """Add one view to the panorama.

        Where it is clipped it yields to views that are not, whatever their order.

        Args:
            lens: Its lens, at the size of the picture.
            pano_from_camera: Rotation from the camera to the panorama, shape [3, 3].
            values: Image values I, free of glare, before division by V, shape [height, width, 3].
            variance: Variance of ``values``, of the same shape.
            status: Bits 1 (clipped) and 4 (moved), shape [height, width].
            name: Name for the report and the progress; layer and prim path for errors.

        Raises:
            LayerError: The lens does not hold up to its largest angle.
        """
        check_lens(lens, name)
        shape = (lens.resolution[1], lens.resolution[0])
        for array, expected in ((values, (*shape, 3)), (variance, (*shape, 3)), (status, shape)):
            if array.shape != expected:
                raise ValueError(f"{name}: an array of {array.shape} for a lens of {expected}")
        device = self._workers.device
        tables = lens_tables(lens, device)
        view: Any = fisheye.View()
        view.value = _to_device(values, wp.vec3f, device)
        view.variance = _to_device(variance, wp.vec3f, device)
        view.status = _to_device(status, wp.uint8, device)
        view.camera_from_map = wp.mat33f(*np.ravel(pano_from_camera.T).tolist())
        flux = self._flux(tables, view.value)
        if not np.isfinite(flux).all():
            raise ValueError(f"{name}: values that are not finite")
        self._survey(tables, view)
        panorama_flux, difference = self._resample(tables, lens, view, name)
        report = ComposedView(name, flux, panorama_flux, difference)
        self._views.append(report)
        return report

    def finish(self) -> Panorama:
        """Return the panorama, with its holes filled; nothing can be added after that."""
        if not self._views:
            raise ValueError("a panorama of no views")
        sums, self._sums = self._sums, None
        height, width = sums.weight.shape
        values, stddev, weight = sums.value.numpy(), sums.variance.numpy(), sums.weight.numpy()
        moved, seen = sums.moved.numpy(), _seen_share(sums.cells.numpy())
        negative_count = np.zeros(height, np.int64)

        def divide(begin: int, end: int) -> None:
            rows = slice(begin, end)
            part = 1.0 / np.where(weight[rows] > 0.0, weight[rows], np.inf)
            values[rows] *= part[..., None]
            moved[rows] *= part
            stddev[rows] = np.sqrt(stddev[rows]) * part[..., None]
            negative_count[rows] = (values[rows] < 0.0).any(axis=2).sum(axis=1)
            np.maximum(values[rows], 0.0, out=values[rows])

        self._workers.run(height, _CHUNK_ROWS, divide)
        solid_angle = texel_solid_angles(height, width)
        is_hole = seen <= 0.0
        holes = find_holes(is_hole)
        if holes:
            fill_holes(values, is_hole)
            stddev[is_hole] = values[is_hole]
        told = np.concatenate(self._differences)
        return Panorama(
            values=values,
            stddev=stddev,
            seen=seen,
            clipped=sums.clipped.numpy(),
            moved=moved,
            view_count=sums.count.numpy(),
            coverage=float(solid_angle @ seen.sum(axis=1, dtype=np.float64) / (4.0 * np.pi)),
            holes=holes,
            negative_count=int(negative_count.sum()),
            negative_share=float(solid_angle @ negative_count / (4.0 * np.pi)),
            overlap_difference=float(np.median(told)) if told.size else None,
            views=tuple(self._views),
        )

    def _flux(self, tables: Any, value: Any) -> FloatArray:
        """Return the integral of a view over its solid angle, from its pixels, shape [3]."""
        sums = wp.empty(tables.height, dtype=wp.vec3d, device=self._workers.device)

        def run(begin: int, end: int) -> None:
            kernels.sum_rows(tables, value, sums, begin, end - begin)

        self._workers.run(tables.height, max(self._chunk, tables.height // 64), run)
        return np.asarray(sums.numpy().sum(axis=0))

    def _survey(self, tables: Any, view: Any) -> None:
        """Measure the noise of a view, and find where it is flagged."""
        device = self._workers.device
        view.block = _BLOCK_PX
        shape = (-(-tables.height // _BLOCK_PX), -(-tables.width // _BLOCK_PX))
        view.flagged = wp.empty(shape, dtype=wp.uint8, device=device)
        blocks = wp.empty(shape, dtype=wp.float32, device=device)

        def run(begin: int, end: int) -> None:
            kernels.survey_blocks(tables, view, blocks, begin, end - begin)

        self._workers.run(shape[0], 8 if device == "cpu" else shape[0], run)
        flagged = np.pad(view.flagged.numpy(), 1)
        beside = [np.roll(flagged, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
        around = np.bitwise_or.reduce(beside)[1:-1, 1:-1]
        view.flagged = _to_device(around, wp.uint8, device)
        found = blocks.numpy()
        known = found[found >= 0.0]
        noise = float(np.median(known)) if known.size else 0.0
        if self._reference == 0.0:
            self._reference = noise or 1.0
        view.noise = max(noise / self._reference, _LEAST_NOISE)

    def _resample(
        self, tables: Any, lens: FisheyeLens, view: Any, name: str
    ) -> tuple[FloatArray, float | None]:
        """Add a view to the sums; return its flux and its difference from the views before."""
        height, width = self._sums.weight.shape
        step = np.pi / height
        # A texel with a corner farther off than this lies beyond the rim.
        view.reach = float(np.cos(min(np.radians(lens.max_angle_deg) + 1.5 * step, np.pi)))
        row_flux = np.zeros((height, 3))
        stride = int(kernels.STRIDE)
        differences = np.full((-(-height // stride), -(-width // stride)), -1.0, np.float32)

        def run(begin: int, end: int) -> None:
            flux, difference = kernels.add_view(tables, view, self._sums, begin, end - begin)
            row_flux[begin:end] = flux.numpy().sum(axis=1)
            differences[begin // stride : -(-end // stride)] = difference.numpy()

        self._progress.start(height, f"compose {name}")
        self._workers.run(height, self._chunk, run, self._progress.advance)
        self._progress.done()
        told = differences[differences >= 0.0]
        self._differences.append(told)
        flux = texel_solid_angles(height, width) @ row_flux
        return np.asarray(flux), float(np.median(told)) if told.size else None


def _seen_share(cells: NDArray[np.uint16]) -> PixelArray:
    """Return the share of each texel's area in the cells that are seen, see ``kernels.Sums``."""
    height = cells.shape[0]
    edges = np.cos(np.arange(height * _CELLS + 1) * np.pi / (height * _CELLS))
    areas = (edges[:-1] - edges[1:]).reshape(height, _CELLS)
    areas /= areas.sum(axis=1, keepdims=True)
    counts = np.array([f"{row:b}".count("1") for row in range(1 << _CELLS)], np.float32) / _CELLS
    seen = np.zeros(cells.shape, np.float32)
    for line in range(_CELLS):
        row = (cells >> (_CELLS * line)) & ((1 << _CELLS) - 1)
        seen += areas[:, line, None].astype(np.float32) * counts[row]
    return np.minimum(seen, 1.0)


def _to_device(array: NDArray[Any], kind: Any, device: str) -> Any:
    """Return an array on the device, without a copy where that is the host."""
    return wp.array(np.ascontiguousarray(array), dtype=kind, device=device, copy=False)


def lens_tables(lens: FisheyeLens, device: str) -> Any:
    """Return a lens as the kernels know it."""
    largest = np.radians(lens.max_angle_deg)
    tables: Any = fisheye.Lens()
    tables.center = wp.vec2f(*(float(part) for part in lens.center_px))
    tables.width, tables.height = lens.resolution
    tables.max_radius = max_radius(lens)
    tables.min_cosine = float(np.cos(0.5 * largest))
    tables.by_cosine = _to_device(_by_cosine(lens), wp.vec3f, device)
    tables.by_radius = _to_device(_by_radius(lens), wp.vec4f, device)
    return tables


def _by_cosine(lens: FisheyeLens) -> PixelArray:
    """Return the table over cos(phi / 2), see ``fisheye.Lens``, shape [nodes, 3]."""
    largest = np.radians(lens.max_angle_deg)
    # 2 sin^2(phi / 4) is 1 - cos(phi / 2) without its cancellation.
    phi = 4.0 * np.arcsin(np.sin(0.25 * largest) * np.sqrt(np.linspace(0.0, 1.0, _NODES)))
    across = 2.0 * np.sin(0.5 * phi)
    height = np.empty_like(phi)
    height[1:] = angle_to_radius(lens, phi[1:]) / across[1:]
    height[0] = radius_slope(lens, 0.0)
    blend = np.cos(0.5 * np.pi * phi / largest) ** _BLEND_EXPONENT
    columns = (
        height,
        1.0 / vignetting(lens, phi),
        np.maximum(blend, _LEAST_BLEND),
    )
    return np.stack(columns, axis=-1).astype(np.float32)


def _by_radius(lens: FisheyeLens) -> PixelArray:
    """Return the table over image height, see ``fisheye.Lens``, shape [nodes, 4]."""
    radius = np.linspace(0.0, max_radius(lens), _NODES)
    phi = radius_to_angle(lens, radius)
    sine = np.full_like(phi, 1.0 / radius_slope(lens, 0.0))
    sine[1:] = np.sin(phi[1:]) / radius[1:]
    # Means over rings: at the rim of an orthographic view the solid angle itself has no bound.
    edge = np.concatenate([radius[:1], 0.5 * (radius[1:] + radius[:-1]), radius[-1:]])
    ring = -2.0 * np.diff(np.cos(radius_to_angle(lens, edge))) / np.diff(edge**2)
    columns = (sine, np.cos(phi), ring, 1.0 / vignetting(lens, phi))
    return np.stack(columns, axis=-1).astype(np.float32)


def footprint(lens: FisheyeLens, pano_from_camera: FloatArray, height: int) -> NDArray[np.bool_]:
    """Return which texels of a panorama a view sees at their middles, shape [height, 2 height]."""
    rays = texel_directions(height, 2 * height) @ pano_from_camera
    at = project(lens, rays)
    with np.errstate(invalid="ignore"):
        return np.asarray(((at >= 0.0) & (at < lens.resolution)).all(axis=-1))
