"""What the capture point of a solved set sees: a latlong picture of spectra per light class.

Direct light is found anew where every ray ends; light by way of other surfaces, and of wide
windows, lies between the corners that it is gathered at. Texels are averages: those that hold an
edge are looked at many times, and what a lamp covers is counted more finely still.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.judge.truth import lamps as set_lamps
from usdskin.judge.truth.finer import finer
from usdskin.judge.truth.geometry import coordinates, first_surfaces, is_open_towards
from usdskin.judge.truth.radiosity import Model, Solution
from usdskin.judge.truth.sources import disc_directions, look_at_sky
from usdskin.latlong import (
    latlong_coordinates,
    latlong_directions,
    latlong_from_world,
    texel_solid_angles,
)

FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

_FINER = (21, 13)
"""Rays in a texel that holds an edge, a Fibonacci number and the one before it."""
_FINEST = (4181, 2584)
"""Rays in one that holds the edge of a lamp, at 256 rows and more."""
_FINEST_COARSE = (28657, 17711)
"""The same, in coarser pictures."""
_PAST = (21, 13)
"""Rays in one that holds the edge of a lamp, to see what is beside it."""
_CONTRAST = 0.03
_RAYS = 1 << 16


@dataclass(frozen=True, slots=True, eq=False)
class Panorama:
    """What is seen."""

    classes: dict[str, FloatArray]
    """Radiance in the light of each class [W m^-2 sr^-1 nm^-1], shape [height, width, bands]."""

    sun_shares: tuple[float, ...]
    """Share of each sun that is seen from the capture point."""

    lamp_cover: tuple[FloatArray, ...]
    """Share of every texel in which each lamp shines, shape [height, width] each."""


@dataclass(frozen=True, slots=True)
class _Grid:
    """The texels, and rays in them."""

    height: int
    to_world: NDArray[np.float64]

    @property
    def width(self) -> int:
        return 2 * self.height

    def rays(self, texels: NDArray[np.int64], lattice: tuple[int, int] = (1, 1)) -> FloatArray:
        """Return rays in each texel, evenly in solid angle, shape [texels, rays, 3].

        They are a Fibonacci lattice, of which no two share a row or a column, shifted from texel
        to texel: straight edges do not fall between rays.
        """
        rows, columns = np.divmod(texels, self.width)
        edge = np.cos(np.arange(self.height + 1) * np.pi / self.height)
        count, turn = lattice
        x, y = (np.arange(count) + 0.5) / count, (np.arange(count) * turn / count + 0.5) % 1.0
        if count > 1:
            shift = 0.7548776662466927, 0.5698402909980532
            x = (x[None] + shift[0] * texels[:, None]) % 1.0
            y = (y[None] + shift[1] * texels[:, None]) % 1.0
        top, bottom = edge[rows][:, None], edge[rows + 1][:, None]
        sine = top + (bottom - top) * y
        turns = (columns[:, None] + x) / self.width
        local = latlong_directions(turns, np.arccos(np.clip(sine, -1.0, 1.0)))
        return np.asarray(local @ self.to_world.T)


def see(
    model: Model,
    solutions: dict[str, Solution],
    height: int,
    advance: Callable[[int], None] | None = None,
) -> Panorama:
    """Return what the capture point sees.

    Args:
        model: The set.
        solutions: Its light.
        height: Rows of the picture; there are twice as many columns.
        advance: Told how many texels are done.

    Raises:
        LayerError: The capture point is inside something, or sees a surface from behind.
    """
    tell = advance or (lambda _count: None)
    scene = model.scene
    grid = _Grid(height, latlong_from_world(scene.up_axis).T)
    everything = np.arange(height * grid.width)
    eye = _Eye(model, solutions)
    image = {name: np.zeros((everything.size, scene.wavelength_nm.size)) for name in solutions}
    met = np.empty(everything.size, np.int64)
    for part in _parts(everything, 1):
        rays = grid.rays(part)[:, 0]
        met[part] = eye.look(rays, {name: values for name, values in image.items()}, part)
    shape = (height, grid.width)
    fine = _edges(
        met.reshape(shape),
        np.sum([values.sum(axis=1) for values in image.values()], axis=0).reshape(shape),
    )
    if scene.skies:
        fine |= (met < 0).reshape(shape)
    again = np.flatnonzero(fine)
    tell(everything.size - again.size)
    for part in _parts(again, _FINER[0]):
        rays = grid.rays(part, _FINER).reshape(-1, 3)
        seen = {name: np.zeros((len(rays), values.shape[1])) for name, values in image.items()}
        eye.look(rays, seen, np.arange(len(rays)))
        for name, values in seen.items():
            image[name][part] = values.reshape(len(part), _FINER[0], -1).mean(axis=1)
        tell(len(part))
    covers = _add_lamps(model, grid, image, eye)
    shares = tuple(float(eye.sees(disc_directions(sun)).mean()) for sun in scene.suns)
    return Panorama(
        {name: values.reshape(*shape, -1) for name, values in image.items()}, shares, covers
    )


def _parts(texels: NDArray[np.int64], rays: int) -> Iterator[NDArray[np.int64]]:
    step = max(1, _RAYS // rays)
    for begin in range(0, texels.size, step):
        yield texels[begin : begin + step]


def _edges(met: NDArray[np.int64], light: FloatArray) -> BoolArray:
    """Return the texels beside which another surface is seen, or much other light."""
    result = np.zeros(met.shape, bool)
    level = np.log(np.maximum(light, 1e-9 * max(float(light.max()), 1e-300)))
    for axis in (0, 1):
        other, beside = np.roll(met, 1, axis=axis), np.roll(level, 1, axis=axis)
        differs = (other != met) | (np.abs(beside - level) > _CONTRAST)
        if axis == 0:
            differs[0] = False
        result |= differs | np.roll(differs, -1, axis=axis)
    return result


class _Eye:
    """Looks along rays from the capture point, past the lamps."""

    def __init__(self, model: Model, solutions: dict[str, Solution]) -> None:
        self._model = model
        self._planes = model.surfaces.planes()
        self._normals = model.surfaces.normal
        self._spectra = {name: model.sources.spectra_of(name) for name in solutions}
        self._corners, self._gathered = finer(
            model.blockers,
            model.nodes,
            {name: item.gathered for name, item in solutions.items()},
        )
        self._known = sum(item.sum(axis=1) for item in self._gathered.values()) > 0.0
        self._first = self._corners.first

    def sees(self, directions: FloatArray) -> BoolArray:
        """Return in which directions nothing stands, shape [count]."""
        origin = self._model.scene.capture_point[None]
        planes = self._model.blockers.planes()
        return np.asarray(is_open_towards(planes, origin, directions)[0])

    def look(
        self, rays: FloatArray, out: dict[str, FloatArray], to: NDArray[np.int64]
    ) -> NDArray[np.int64]:
        """Write what rays see to rows of arrays, and return what surface they meet, or -1."""
        model, scene = self._model, self._model.scene
        origin = scene.capture_point
        met, distance = first_surfaces(self._planes, origin, rays)
        self._refuse_backs(met, rays)
        for index in np.unique(met):
            which = np.flatnonzero(met == index)
            if index < 0:
                self._sky(rays[which], out, to[which])
                continue
            points = origin + distance[which, None] * rays[which]
            factors = model.sources.factors(model.blockers, int(index), points, "sharp")
            weights, corners = self._between(int(index), points)
            reflected = scene.surfaces.reflectance[index] / np.pi
            for name, values in out.items():
                arriving = factors @ self._spectra[name]
                gathered = self._gathered[name]
                for k in range(4):
                    arriving += weights[:, k, None] * gathered[corners[:, k]]
                values[to[which]] = reflected * arriving
        return met

    def _refuse_backs(self, met: NDArray[np.int64], rays: FloatArray) -> None:
        hit = np.flatnonzero(met >= 0)
        behind = np.einsum("ij,ij->i", rays[hit], self._normals[met[hit]]) > 0.0
        if behind.any():
            scene = self._model.scene
            name = scene.surfaces.names[met[hit[behind][0]]]
            raise LayerError(
                f"{scene.name} <{name}>: is seen from behind; the capture point is inside it, or "
                "outside the room, or its faces are wound clockwise (set doubleSided for a sheet)"
            )

    def _between(self, index: int, points: FloatArray) -> tuple[FloatArray, NDArray[np.int64]]:
        """Return the weights of four corners of a cell, and which they are, shape [count, 4]."""
        cuts = self._corners.cuts[index]
        _, u, v = coordinates(self._planes[index], points)
        at, low = [], []
        for coordinate, nodes in ((u, cuts[0]), (v, cuts[1])):
            first = np.clip(np.searchsorted(nodes, coordinate) - 1, 0, nodes.size - 2)
            low.append(first)
            share = (coordinate - nodes[first]) / (nodes[first + 1] - nodes[first])
            at.append(np.clip(share, -0.02, 1.02))
        weights, corners = [], []
        for i in (0, 1):
            for j in (0, 1):
                weights.append((at[0] if i else 1.0 - at[0]) * (at[1] if j else 1.0 - at[1]))
                corners.append(self._first[index] + (low[0] + i) * cuts[1].size + low[1] + j)
        weight, corner = np.stack(weights, axis=1), np.stack(corners, axis=1)
        # Corners below a cabinet know nothing.
        held = np.where(self._known[corner], weight, 0.0)
        total = held.sum(axis=1, keepdims=True)
        return np.where(total > 1e-3, held / np.where(total > 1e-3, total, 1.0), 0.0), corner

    def _sky(self, rays: FloatArray, out: dict[str, FloatArray], to: NDArray[np.int64]) -> None:
        scene = self._model.scene
        for name, values in out.items():
            total = np.zeros((len(rays), scene.wavelength_nm.size))
            for sky in scene.skies:
                if scene.class_of[sky.path] == name:
                    total += look_at_sky(sky, rays) @ sky.basis
            values[to] = total


# --- Lamps in sight ----------------------------------------------------------------------------


def _add_lamps(
    model: Model, grid: _Grid, image: dict[str, FloatArray], eye: _Eye
) -> tuple[FloatArray, ...]:
    """Put the lamps in front of what is behind them."""
    scene = model.scene
    size = grid.height * grid.width
    covers, behind = [np.zeros(size) for _ in scene.lamps], np.ones(size)
    if not scene.lamps:
        return ()
    origin = scene.capture_point
    marked = np.zeros((grid.height, grid.width), bool)
    centers = grid.rays(np.arange(size))[:, 0]
    for lamp in scene.lamps:
        distance, _ = set_lamps.first_hits(lamp, origin, centers)
        marked |= np.isfinite(distance).reshape(marked.shape)
        _mark(marked, grid, set_lamps.outline(lamp, origin[None])[0] - origin)
    marked = _grown(marked)
    finest = _FINEST if grid.height >= 256 else _FINEST_COARSE
    for part in _parts(np.flatnonzero(marked), finest[0]):
        rays = grid.rays(part, finest).reshape(-1, 3)
        which, shines = _lamp_met(model, rays)
        owner = which.reshape(len(part), -1)
        is_bright = shines.reshape(owner.shape)
        free = (owner < 0).mean(axis=1)
        behind[part] = free
        for number in range(len(scene.lamps)):
            covers[number][part] = ((owner == number) & is_bright).mean(axis=1)
    _look_past(model, grid, image, eye, np.flatnonzero((behind > 0.0) & (behind < 1.0)))
    areas = np.repeat(texel_solid_angles(grid.height, grid.width), grid.width)
    for cover, lamp in zip(covers, scene.lamps, strict=True):
        _settle(cover, areas, set_lamps.solid_angle(lamp, origin))
    for values in image.values():
        values *= behind[:, None]
    for cover, lamp in zip(covers, scene.lamps, strict=True):
        lit = np.flatnonzero(cover)
        image[scene.class_of[lamp.path]][lit] += cover[lit, None] * lamp.radiance[0]
    return tuple(cover.reshape(grid.height, grid.width) for cover in covers)


def _lamp_met(model: Model, rays: FloatArray) -> tuple[NDArray[np.int64], BoolArray]:
    """Return which lamp rays meet first, -1 where none, and whether it shines there."""
    origin = model.scene.capture_point
    nearest = np.full(len(rays), np.inf)
    which = np.full(len(rays), -1)
    shines = np.zeros(len(rays), bool)
    for number, lamp in enumerate(model.scene.lamps):
        distance, bright = set_lamps.first_hits(lamp, origin, rays)
        closer = distance < nearest
        nearest[closer], which[closer], shines[closer] = distance[closer], number, bright[closer]
    lit = np.flatnonzero(which >= 0)
    _, wall = first_surfaces(model.surfaces.planes(), origin, rays[lit])
    which[lit[wall < nearest[lit] * (1.0 - 1e-9)]] = -1
    return which, shines


def _look_past(
    model: Model, grid: _Grid, image: dict[str, FloatArray], eye: _Eye, texels: NDArray[np.int64]
) -> None:
    """Find what is seen beside lamps anew: what is behind a window is not what is around it."""
    for part in _parts(texels, _PAST[0]):
        rays = grid.rays(part, _PAST).reshape(-1, 3)
        which, _ = _lamp_met(model, rays)
        free = np.flatnonzero(which < 0)
        seen = {name: np.zeros((len(rays), values.shape[1])) for name, values in image.items()}
        eye.look(rays[free], seen, free)
        count = (which < 0).reshape(len(part), -1).sum(axis=1)
        some = count > 0
        for name, values in seen.items():
            total = values.reshape(len(part), _PAST[0], -1).sum(axis=1)
            image[name][part[some]] = total[some] / count[some, None]


def _settle(cover: FloatArray, areas: FloatArray, true: float) -> None:
    """Give a lamp in full sight the solid angle it has: counting rays errs by less than 0.5 %."""
    found = float(cover @ areas)
    edge = (cover > 0.0) & (cover < 1.0)
    at_edge = float(cover[edge] @ areas[edge])
    if at_edge > 0.0 and abs(found - true) < 5e-3 * true:
        cover[edge] *= 1.0 + (true - found) / at_edge


def _mark(marked: BoolArray, grid: _Grid, corners: FloatArray) -> None:
    """Mark the texels through which a polygon's edges run."""
    ends = np.roll(corners, -1, axis=0)
    share = (np.arange(4 * grid.height) + 0.5)[:, None, None] / (4 * grid.height)
    spots = (corners + share * (ends - corners)).reshape(-1, 3) @ grid.to_world
    u, v = latlong_coordinates(spots)
    rows = np.minimum((v * grid.height).astype(np.int64), grid.height - 1)
    columns = np.minimum((u * grid.width).astype(np.int64), grid.width - 1)
    marked[rows, columns] = True


def _grown(marked: BoolArray) -> BoolArray:
    result = marked.copy()
    for step in (-1, 1):
        result |= np.roll(marked, step, axis=1)
    wide = result.copy()
    wide[1:] |= result[:-1]
    wide[:-1] |= result[1:]
    return wide
