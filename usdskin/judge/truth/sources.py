"""What shines in a set, as numbers of geometry times spectra.

Irradiance is ``factors @ spectra``: the factor of a lamp is its projected solid angle [sr] times
the share of it that is seen, that of a sun is a cosine, those of a sky are its coefficients
integrated over what is open.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.truth import lamps as set_lamps
from usdskin.judge.truth.geometry import Blockers, candidates, is_open, is_open_towards
from usdskin.judge.truth.sets import SetScene
from usdskin.latlong import latlong_coordinates, texel_directions, texel_solid_angles
from usdskin.render.lights import DistantLight, DomeLight, LocalLight

FloatArray = NDArray[np.float64]

Part = Literal["wide", "sharp"]

_WIDE_FINENESS = 4
"""How finely a window is looked at: its reveal hides narrow strips of it."""
_CHUNK = 1 << 18
_SKY_ROWS = 32
"""Rows of directions in which a sky is looked for."""
_SKY_FINER = 4
_DISC = 24
"""Directions to a sun."""


@dataclass(frozen=True, slots=True, eq=False)
class Sources:
    """All that shines; columns of factors are lamps by spectrum, suns, and the skies' channels."""

    lamps: tuple[LocalLight, ...]
    column: tuple[int, ...]
    """Column of each lamp; lamps of a class with the same spectrum share one."""

    suns: tuple[DistantLight, ...]
    skies: tuple[DomeLight, ...]
    spectra: FloatArray
    """Of the columns, shape [count, band_count]."""

    classes: tuple[str, ...]
    """Of the columns, shape [count]."""

    ways: FloatArray
    """Directions to the sky, shape [way_count, 3]."""

    way_size: FloatArray
    """Solid angle of each [sr], shape [way_count]."""

    sky: FloatArray
    """The skies' coefficients there, all channels, shape [way_count, channel_count]."""

    @property
    def count(self) -> int:
        """Number of columns."""
        return len(self.classes)

    def spectra_of(self, name: str) -> FloatArray:
        """Return the spectra with those of other classes zero, shape [count, band_count]."""
        is_one = np.array([item == name for item in self.classes])
        return np.asarray(np.where(is_one[:, None], self.spectra, 0.0))

    def emitted(self, name: str, share: FloatArray | None = None) -> FloatArray:
        """Return the flux that lamps of a class emit [W nm^-1], shape [band_count].

        Args:
            name: The class.
            share: What of each lamp's flux is counted, shape [lamp_count]; all where None.
        """
        total = np.zeros(self.spectra.shape[1])
        for number, (lamp, column) in enumerate(zip(self.lamps, self.column, strict=True)):
            if self.classes[column] == name:
                part = 1.0 if share is None else float(share[number])
                total += part * np.pi * set_lamps.area(lamp) * self.spectra[column]
        return total

    def distance(self, points: FloatArray, normal: FloatArray) -> FloatArray:
        """Return how far the nearest lamp is that shines on a surface, about [m], shape [count].

        Args:
            points: On the surface [m], shape [count, 3].
            normal: Its normal, shape [3].
        """
        nearest = np.full(len(points), np.inf)
        for lamp in self.lamps:
            places, facing = set_lamps.targets(lamp)
            for index, spot in enumerate(places):
                away = spot - points
                length = np.linalg.norm(away, axis=1)
                shines = away @ normal > 0.02 * length
                if facing is not None:
                    shines &= away @ facing[index] < -0.02 * length
                np.minimum(nearest, np.where(shines, length, np.inf), out=nearest)
        return nearest

    def factors(self, blockers: Blockers, index: int, points: FloatArray, of: Part) -> FloatArray:
        """Return what points of a surface receive directly.

        Args:
            blockers: What stops light.
            index: Which of them the points are on.
            points: Where [m], shape [point_count, 3].
            of: ``wide`` for lamps that are (``lamps.is_wide``), ``sharp`` for all else.

        Returns:
            Factors, shape [point_count, count].
        """
        result = np.zeros((len(points), self.count))
        normal, planes = blockers.normal[index], blockers.planes()
        hull = blockers.corners[index]
        for lamp, column in zip(self.lamps, self.column, strict=True):
            wide = set_lamps.is_wide(lamp)
            if wide != (of == "wide"):
                continue
            places, facing = set_lamps.targets(lamp, _WIDE_FINENESS if wide else 1)
            which = candidates(blockers, hull, _extent(lamp))
            which = which[which != index]
            step = max(1, _CHUNK // len(places))
            for begin in range(0, len(points), step):
                rows = slice(begin, begin + step)
                result[rows, column] += _lamp_factor(
                    lamp, points[rows], normal, places, facing, planes[which], self.lamps
                )
        if of != "wide":
            self._add_far(result, blockers, index, points, planes, normal)
        return result

    def _add_far(
        self,
        result: FloatArray,
        blockers: Blockers,
        index: int,
        points: FloatArray,
        planes: FloatArray,
        normal: FloatArray,
    ) -> None:
        before = (blockers.corners - blockers.corner[index]) @ normal
        which = np.flatnonzero(before.max(axis=1) > 1e-7)
        which = which[which != index]
        base = max(self.column, default=-1) + 1
        for number, sun in enumerate(self.suns):
            ways = disc_directions(sun)
            cosine = np.maximum(ways @ normal, 0.0)
            step = max(1, _CHUNK // len(ways))
            for begin in range(0, len(points), step):
                rows = slice(begin, begin + step)
                free = is_open_towards(planes[which], points[rows], ways)
                result[rows, base + number] = free @ cosine / len(ways)
        base += len(self.suns)
        if not self.skies:
            return
        cosine = self.ways @ normal
        faces = cosine > 0.0
        weight = cosine[faces] * self.way_size[faces]
        # The coarse sum over directions of an even sky is pi.
        light = self.sky[faces] * (weight * (np.pi / weight.sum()))[:, None]
        step = max(1, _CHUNK // int(faces.sum()))
        for begin in range(0, len(points), step):
            rows = slice(begin, begin + step)
            free = is_open_towards(planes[which], points[rows], self.ways[faces])
            result[rows, base:] = free @ light

    def is_closed(
        self, surfaces: Blockers, middles: FloatArray, surface: NDArray[np.int64]
    ) -> bool:
        """Return whether no ray from the cells' middles leaves the set.

        Args:
            surfaces: What reflects.
            middles: Of the cells [m], shape [cell_count, 3].
            surface: Of each cell, shape [cell_count].
        """
        ways = texel_directions(10, 20).reshape(-1, 3)
        planes = surfaces.planes()
        for index, normal in enumerate(surfaces.normal):
            which = np.arange(len(planes)) != index
            up = ways[ways @ normal > 0.05]
            if is_open_towards(planes[which], middles[surface == index], up).any():
                return False
        return True


def _extent(lamp: LocalLight) -> FloatArray:
    """Return corners of a box, or of a rectangle, around a lamp [m], shape [count, 3]."""
    a, b = lamp.half
    thick = 0.0 if lamp.kind in ("rect", "disk") else b
    size = np.array([a, b if lamp.kind != "disk" else a, thick])
    signs = np.array([(i, j, k) for i in (-1, 1) for j in (-1, 1) for k in (-1, 1)], np.float64)
    if thick == 0.0:
        signs = signs[::2]
    return np.asarray(lamp.center + (signs * size) @ lamp.axes)


def _lamp_factor(
    lamp: LocalLight,
    points: FloatArray,
    normal: FloatArray,
    places: FloatArray,
    facing: FloatArray | None,
    planes: FloatArray,
    others: tuple[LocalLight, ...],
) -> FloatArray:
    """Return what a lamp gives, projected [sr]."""
    normals = np.broadcast_to(normal, points.shape)
    given = set_lamps.irradiance_factor(lamp, points, normals)
    shading = set_lamps.shading(lamp, points, normal, others)
    lit = np.zeros(len(points), bool)
    if len(planes):
        lit[:] = True
    for _, rows in shading:
        lit[rows] = True
    lit &= given > 0.0
    if not lit.any():
        return given
    free = is_open(planes, points, places)
    for other, rows in shading:
        ways = (places[None] - points[rows, None]).reshape(-1, 3)
        begin = np.repeat(points[rows], len(places), axis=0)
        free[rows] &= ~set_lamps.stops(other, begin, ways, 1.0).reshape(rows.size, -1)
    weight = set_lamps.target_weights(lamp, points, normal, places, facing)
    seen = (weight * free).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-300)
    return np.asarray(np.where(lit, given * seen, given))


def disc_directions(sun: DistantLight) -> FloatArray:
    """Return unit vectors to evenly spread places of a sun's disc, shape [count, 3]."""
    half = np.radians(0.5 * sun.angle_deg)
    if half <= 0.0:
        return sun.direction[None]
    k = np.arange(_DISC)
    turn = 2.0 * np.pi * 0.3819660112501051 * k
    cosine = 1.0 - (1.0 - np.cos(half)) * (k + 0.5) / _DISC
    sine = np.sqrt(1.0 - cosine**2)
    helper = np.array([0.0, 1.0, 0.0] if abs(sun.direction[0]) > 0.7 else [1.0, 0.0, 0.0])
    x = np.cross(sun.direction, helper)
    x /= np.linalg.norm(x)
    y = np.cross(sun.direction, x)
    return np.asarray(
        np.outer(sine * np.cos(turn), x)
        + np.outer(sine * np.sin(turn), y)
        + np.outer(cosine, sun.direction)
    )


def look_at_sky(sky: DomeLight, directions: FloatArray) -> FloatArray:
    """Return the coefficients of a dome in some directions, shape [count, rank]."""
    height, width = sky.coefficients.shape[:2]
    u, v = latlong_coordinates(directions @ sky.to_world)
    rows = np.minimum((v * height).astype(np.int64), height - 1)
    columns = np.minimum((u * width).astype(np.int64), width - 1)
    return np.asarray(sky.coefficients[rows, columns], np.float64)


def make_sources(scene: SetScene) -> Sources:
    """Return what shines in a set."""
    columns: dict[tuple[str, bytes], int] = {}
    spectra: list[FloatArray] = []
    classes: list[str] = []
    which = []
    for lamp in scene.lamps:
        name = scene.class_of[lamp.path]
        key = (name, lamp.radiance.tobytes())
        if key not in columns:
            columns[key] = len(spectra)
            spectra.append(lamp.radiance[0])
            classes.append(name)
        which.append(columns[key])
    for sun in scene.suns:
        spectra.append(sun.irradiance)
        classes.append(scene.class_of[sun.path])
    finer = _SKY_ROWS * _SKY_FINER
    fine = texel_directions(finer, 2 * finer)
    size = np.broadcast_to(texel_solid_angles(finer, 2 * finer)[:, None], (finer, 2 * finer))

    def coarser(values: FloatArray) -> FloatArray:
        shape = (_SKY_ROWS, _SKY_FINER, 2 * _SKY_ROWS, _SKY_FINER, -1)
        return np.asarray(values.reshape(shape).sum(axis=(1, 3)).reshape(2 * _SKY_ROWS**2, -1))

    way_size = coarser(size)[:, 0]
    ways = coarser(fine * size[..., None])
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    channels = []
    for sky in scene.skies:
        seen = look_at_sky(sky, fine.reshape(-1, 3)).reshape(*fine.shape[:2], -1)
        channels.append(coarser(seen * size[..., None]) / way_size[:, None])
        spectra += list(sky.basis)
        classes += [scene.class_of[sky.path]] * len(sky.basis)
    return Sources(
        lamps=scene.lamps,
        column=tuple(which),
        suns=scene.suns,
        skies=scene.skies,
        spectra=np.array(spectra),
        classes=tuple(classes),
        ways=ways,
        way_size=way_size,
        sky=np.concatenate(channels, axis=1) if channels else np.zeros((len(ways), 0)),
    )
