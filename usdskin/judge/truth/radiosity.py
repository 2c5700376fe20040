"""Radiosity of a set in float64: light between its surfaces, wavelength by wavelength.

With rho the reflectance, D the direct irradiance and F the form factors between cells,
``B = rho (D + F B)``. F holds no wavelength, so it is found once, by rays
(``form_factors``), and made reciprocal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.form_factors import cosine_directions, lattice, shares
from usdskin.judge.truth.cells import Cells, Cutting, Grids, cells_of, cut_grids, edge_lines
from usdskin.judge.truth.geometry import Blockers, coordinates, first_surfaces
from usdskin.judge.truth.lamp_rays import taken_by_lamps
from usdskin.judge.truth.sets import SetScene
from usdskin.judge.truth.sources import Part, Sources, make_sources
from usdskin.latlong import texel_directions

FloatArray = NDArray[np.float64]

_CELL_RAYS = (2584, 1597)
"""Rays from a cell, a Fibonacci number and the one before it."""
_NODE_RAYS = (1597, 987)
"""Rays from a corner that light is gathered at."""
_SHIFT = (0.8191725133961645, 0.6710436067037893, 0.5497004779019703, 0.4503599627370496)
"""What neither repeats nor falls into step (Roberts 2018, three dimensions; and one more)."""
_INSET = 0.01
"""How far a corner of a cell is moved off the edge of a surface, in cells."""
_NODES = 8
"""Corners that light is gathered at, over the count of cells."""
_EDGE = 0.2
"""Their distance at the edges of surfaces, where light changes fastest, over that elsewhere."""
_BESIDE = (2.0, 6.0)
"""Where corners are beside an edge of something before a surface, over its height: half a plane of
which hides 5 % and 0.7 % of the view there."""
_CELL_EDGE = 0.25
"""The same of cells."""
_WIDE_NODES = 3
"""Points of a cell, in each direction, that windows are looked at from."""
_TOLERANCE = 1e-9
_MOST_BOUNCES = 5000


@dataclass(frozen=True, slots=True, eq=False)
class Model:
    """A set made ready: what stops light, what shines, the cells."""

    scene: SetScene
    blockers: Blockers
    """The surfaces, then the rectangular lamps."""

    surface_count: int
    sources: Sources
    cells: Cells

    nodes: Grids
    """Whose corners light is gathered at; only what is in sight is cut finely."""

    polygons: FloatArray
    """Corners of the cells [m], shape [cell_count, 4, 3]."""

    area: FloatArray
    """Of the cells [m^2], shape [cell_count]."""

    @property
    def surfaces(self) -> Blockers:
        """What reflects."""
        return _first(self.blockers, self.surface_count)


@dataclass(frozen=True, slots=True, eq=False)
class Balance:
    """Where the light of a class goes, added up over wavelength [W m^-2 nm^-1 x m^2 x nm]."""

    emitted: FloatArray
    """Flux that lamps with a place emit, shape [band_count]."""

    absorbed: FloatArray
    """Flux that surfaces and lamps absorb, shape [band_count]."""


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """The light of one class."""

    radiosity: FloatArray
    """Of the cells [W m^-2 nm^-1], shape [cell_count, band_count]."""

    gathered: FloatArray
    """Irradiance by way of other surfaces and from wide lamps at the corners, in the order of
    ``corner_points`` [W m^-2 nm^-1], shape [corner_count, band_count]."""

    balance: Balance


def make_model(scene: SetScene, cell_count: int) -> Model:
    """Return a set made ready.

    Args:
        scene: The set.
        cell_count: How many cells its surfaces are cut into, at most (about).
    """
    surfaces = scene.surfaces
    lamps = tuple(
        # Light that is flush with a wall is before it.
        replace(lamp, center=lamp.center - 1e-4 * lamp.axes[2]) if lamp.kind == "rect" else lamp
        for lamp in scene.lamps
    )
    scene = replace(scene, lamps=lamps)
    rects = [lamp for lamp in lamps if lamp.kind == "rect"]
    corner = [lamp.center - lamp.half[0] * lamp.axes[0] - lamp.half[1] * lamp.axes[1]
              for lamp in rects]  # fmt: skip
    along = [2.0 * lamp.half[0] * lamp.axes[0] for lamp in rects]
    across = [2.0 * lamp.half[1] * lamp.axes[1] for lamp in rects]
    plain = Blockers(surfaces.corner, surfaces.along, surfaces.across)
    blockers = Blockers(
        np.concatenate([surfaces.corner, np.reshape(corner, (-1, 3))]),
        np.concatenate([surfaces.along, np.reshape(along, (-1, 3))]),
        np.concatenate([surfaces.across, np.reshape(across, (-1, 3))]),
    )
    count = len(plain.corner)
    everywhere = Cutting(scene.capture_point, np.ones(count, bool), _CELL_EDGE)
    sources = make_sources(scene)
    cells = cells_of(
        plain,
        cut_grids(plain, cell_count, everywhere),
        lambda index, points: sources.distance(points, plain.normal[index]),
    )
    in_sight = Cutting(scene.capture_point, _in_sight(plain, scene.capture_point), _EDGE, _BESIDE)
    nodes = _nodes(plain, cut_grids(plain, _NODES * cell_count, in_sight))
    polygons = np.concatenate([_polygons(plain, cells, k) for k in range(len(plain.corner))])
    edges = np.cross(polygons[:, 1] - polygons[:, 0], polygons[:, 3] - polygons[:, 0])
    return Model(
        scene=scene,
        blockers=blockers,
        surface_count=len(surfaces.corner),
        sources=sources,
        cells=cells,
        nodes=nodes,
        polygons=polygons,
        area=np.linalg.norm(edges, axis=1),
    )


def _in_sight(surfaces: Blockers, point: FloatArray) -> NDArray[np.bool_]:
    """Return which surfaces a point sees anything of, shape [count]."""
    rays = texel_directions(90, 180).reshape(-1, 3)
    met, _ = first_surfaces(surfaces.planes(), point, rays)
    return np.asarray(np.bincount(met[met >= 0], minlength=len(surfaces.corner)) > 0)


def _first(blockers: Blockers, count: int) -> Blockers:
    return Blockers(blockers.corner[:count], blockers.along[:count], blockers.across[:count])


def place(blockers: Blockers, index: int, u: FloatArray, v: FloatArray) -> FloatArray:
    """Return points of a surface [m], shape [count, 3]."""
    along, across = np.outer(u, blockers.along[index]), np.outer(v, blockers.across[index])
    return np.asarray(blockers.corner[index] + along + across)


def _polygons(blockers: Blockers, cells: Cells, index: int) -> FloatArray:
    u0, u1, v0, v1 = cells.spans[index].T
    ends = [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]
    return np.stack([place(blockers, index, u, v) for u, v in ends], axis=1)


def _samples(model: Model, index: int, at: FloatArray) -> FloatArray:
    """Return a grid of points of every cell of a surface [m], shape [cells * n * n, 3]."""
    u0, u1, v0, v1 = (part[:, None, None] for part in model.cells.spans[index].T)
    u, v = np.broadcast_arrays(u0 + (u1 - u0) * at[:, None], v0 + (v1 - v0) * at[None])
    return place(model.blockers, index, u.ravel(), v.ravel())


def gather(model: Model, index: int, points: FloatArray) -> FloatArray:
    """Return the form factors from points of a surface to all cells, shape [points, cells].

    Args:
        model: The set.
        index: The surface.
        points: On it [m], shape [point_count, 3].
    """
    square = lattice(*_NODE_RAYS)
    shift = np.arange(len(points))[:, None, None] * np.array(_SHIFT[:2])
    ways = cosine_directions((square[None] + shift) % 1.0, model.blockers.normal[index])
    return shares(model.blockers, model.cells, index, points[:, None], ways, model.sources.lamps)


def _exchange(model: Model, index: int) -> FloatArray:
    """Return the form factors from a surface's cells to all cells, shape [cells, all cells]."""
    spans = model.cells.spans[index]
    square = lattice(*_CELL_RAYS)
    number = np.arange(len(spans))[:, None] + model.cells.first[index]
    ways = (square[None] + number[:, :, None] * np.array(_SHIFT[:2])) % 1.0
    # Places run through the cell while directions run through the hemisphere.
    ray = np.arange(len(square))[None]
    u = (ray * _SHIFT[2] + number * _SHIFT[3]) % 1.0
    v = (ray * _SHIFT[3] + number * _SHIFT[2]) % 1.0
    u = spans[:, :1] + (spans[:, 1:2] - spans[:, :1]) * u
    v = spans[:, 2:3] + (spans[:, 3:] - spans[:, 2:3]) * v
    points = place(model.blockers, index, u.ravel(), v.ravel()).reshape(*u.shape, 3)
    ways = cosine_directions(ways, model.blockers.normal[index])
    return shares(model.blockers, model.cells, index, points, ways, model.sources.lamps)


def solve(
    model: Model, advance: Callable[[int], None] | None = None
) -> tuple[dict[str, Solution], bool]:
    """Return the light of every class, and whether the set is closed.

    Args:
        model: The set.
        advance: Told how many surfaces are done; twice as many as there are.
    """
    tell = advance or (lambda _count: None)
    cells, count = model.cells, model.cells.count
    factors = np.zeros((count, count))
    direct = np.zeros((count, model.sources.count))
    middles = model.polygons.mean(axis=1)
    is_covered = covered(model.surfaces, middles, cells.surface)
    is_closed = model.sources.is_closed(
        model.surfaces, middles[~is_covered], cells.surface[~is_covered]
    )
    for index in range(model.surface_count):
        part = slice(int(cells.first[index]), int(cells.first[index + 1]))
        direct[part] = _direct(model, index)
        factors[part] = _exchange(model, index)
        tell(1)
    factors[is_covered], direct[is_covered] = 0.0, 0.0
    factors = balanced(factors, model.area)
    at_corners, wide = _corner_factors(model, tell)
    taken = taken_by_lamps(model.sources.lamps, model.blockers, model.surface_count)
    result = {}
    for name in model.scene.classes:
        spectra = model.sources.spectra_of(name)
        reflectance = model.scene.surfaces.reflectance[cells.surface]
        radiosity = bounce(factors, reflectance, direct @ spectra)
        arriving = direct @ spectra + factors @ radiosity
        absorbed = model.area @ ((1.0 - reflectance) * arriving)
        absorbed += (model.area * (1.0 - factors.sum(axis=1))) @ radiosity
        absorbed += model.sources.emitted(name, taken)
        balance = Balance(model.sources.emitted(name), absorbed)
        result[name] = Solution(radiosity, at_corners @ radiosity + wide @ spectra, balance)
    return result, is_closed


def covered(
    surfaces: Blockers, middles: FloatArray, surface: NDArray[np.int64]
) -> NDArray[np.bool_]:
    """Return which cells another surface lies flat upon, face to face.

    Args:
        surfaces: What reflects.
        middles: Of the cells [m], shape [cell_count, 3].
        surface: Of each cell, shape [cell_count].
    """
    result = np.zeros(len(middles), bool)
    normal = surfaces.normal
    for index, plane in enumerate(surfaces.planes()):
        height, u, v = coordinates(plane, middles)
        within = (abs(height) < 1e-4) & (abs(u - 0.5) < 0.5) & (abs(v - 0.5) < 0.5)
        result |= within & (normal[surface] @ normal[index] < -0.999)
    return result


def balanced(factors: FloatArray, area: FloatArray) -> FloatArray:
    """Return form factors that are reciprocal, with the sums of their rows.

    Args:
        factors: F from row to column, shape [cells, cells].
        area: Of the cells [m^2], shape [cells].
    """
    target = area * factors.sum(axis=1)
    exchange = area[:, None] * factors
    exchange = 0.5 * (exchange + exchange.T)
    alone = target <= 1e-6 * area
    exchange[alone] = exchange[:, alone] = 0.0
    alone |= exchange.sum(axis=1) <= 0.0
    scale = np.ones(len(area))
    for _ in range(200):
        rows = scale * (exchange @ scale)
        wrong = np.where(alone, 1.0, target / np.where(alone, 1.0, rows))
        scale *= np.sqrt(wrong)
        if np.abs(wrong - 1.0).max() < 1e-12:
            break
    exchange *= scale[:, None] * scale[None]
    exchange /= area[:, None]
    return exchange


def bounce(factors: FloatArray, reflectance: FloatArray, direct: FloatArray) -> FloatArray:
    """Return the radiosity B = rho (D + F B) by following the light until it is gone.

    Args:
        factors: F, shape [cells, cells].
        reflectance: rho, shape [cells, band_count].
        direct: D, shape [cells, band_count].
    """
    part = reflectance * direct
    total = part.copy()
    for _ in range(_MOST_BOUNCES):
        part = reflectance * (factors @ part)
        total += part
        if np.abs(part).max() <= _TOLERANCE * np.abs(total).max():
            # What is left falls off evenly: add the rest of the series.
            return total
    return total


def _direct(model: Model, index: int) -> FloatArray:
    """Return direct light averaged over a surface's cells, shape [cells, source columns]."""
    size = np.sqrt(model.area[model.cells.first[index] : model.cells.first[index + 1]])
    middles = _samples(model, index, np.array([0.5]))
    near = model.sources.distance(middles, model.blockers.normal[index])
    count = int(np.clip(np.ceil(3.0 * (size / np.maximum(near, 1e-3)).max()), 5, 6))
    # Edges of shadows cross a cell abruptly; what a window gives changes slowly, but is hidden by
    # narrow strips.
    return _averaged(model, index, count, "sharp") + _averaged(model, index, _WIDE_NODES, "wide")


def _averaged(model: Model, index: int, node_count: int, of: Part) -> FloatArray:
    """Return the mean of factors over cells, at nodes in each direction (Gauss-Legendre)."""
    nodes, weights = np.polynomial.legendre.leggauss(node_count)
    points = _samples(model, index, 0.5 + 0.5 * nodes)
    factor = model.sources.factors(model.blockers, index, points, of)
    weight = (weights[:, None] * weights[None]).ravel() / 4.0
    return np.asarray(weight @ factor.reshape(-1, len(weight), factor.shape[1]))


# --- Corners -----------------------------------------------------------------------------------


def _nodes(blockers: Blockers, grids: Grids) -> Grids:
    """Return where light is gathered: at the cuts, but on both sides of what touches a surface.

    Light changes abruptly there: beside the foot of furniture, and below it. At the ends of a
    surface that is a little inside.
    """
    result = []
    for index, cuts in enumerate(grids.cuts):
        u, v = (_doubled(*pair) for pair in zip(cuts, edge_lines(blockers, index), strict=True))
        result.append((u, v))
    return Grids(tuple(result))


def _doubled(cuts: FloatArray, lines: FloatArray) -> FloatArray:
    is_line = np.abs(cuts[:, None] - lines[None]).min(axis=1) < 1e-8
    inset = np.where(is_line, _INSET, 0.0)
    width = np.diff(cuts)
    after, before = cuts[:-1] + inset[:-1] * width, cuts[1:] - inset[1:] * width
    return np.unique(np.concatenate([after, before]))


def corner_points(model: Model, index: int) -> FloatArray:
    """Return where light is gathered on a surface [m], shape [count, 3], rows of u."""
    both = np.meshgrid(*model.nodes.cuts[index], indexing="ij")
    return place(model.blockers, index, both[0].ravel(), both[1].ravel())


def _corner_factors(model: Model, tell: Callable[[int], None]) -> tuple[FloatArray, FloatArray]:
    """Return form factors from corners to cells, and what wide lamps give the corners."""
    blocks, wide = [], []
    for index in range(model.surface_count):
        points = corner_points(model, index)
        blocks.append(gather(model, index, points))
        wide.append(model.sources.factors(model.blockers, index, points, "wide"))
        tell(1)
    return np.concatenate(blocks), np.concatenate(wide)
