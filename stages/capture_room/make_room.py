"""Make the room that the virtual photographer visits: ``python stages/capture_room/make_room.py``.

A room of 7 x 7.5 x 2.8 m with four bare fluorescent tubes (FL2), a window onto a garden (D65), a
door ajar to a dark corridor, and furniture. Light is direct from tubes and window, with shadows,
plus one even bounce dimmed in corners: no exact radiosity, but a light field with the structure and
the range of a real one.

Writes: ``room.exr``, coefficients of six spectra (each lamp through the three reflectances of
        ``usdskin.uplift.reflectance_basis``), ``room_rgb.exr``, the same as RGB for other tools,
        and ``room.usda``; and the room in the light of one kind of lamp, ``tubes.usda`` and
        ``window.usda`` with ``tubes_rgb.exr`` and ``window_rgb.exr``. All are committed; run this
        after a change, or with --layers where ``room.exr`` is to stay.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from room_layers import (
    ALONE,
    WAVELENGTH_NM,
    alone,
    basis,
    rendition,
    rounded,
    write_rgb,
    write_stage,
    write_stage_alone,
)
from surfaces import (
    FELT_BLUE,
    FELT_OCHRE,
    Paint,
    cushions,
    door,
    foliage,
    noise,
    plain,
    planks,
    plaster,
    poster,
    rug,
    shelf,
    tiles,
)

from usdskin.images import Part, read_image, write_exr
from usdskin.latlong import latlong_directions

FloatArray = NDArray[np.float64]

__all__ = ["WAVELENGTH_NM", "coefficients", "main", "rounded"]

FOLDER = Path(__file__).resolve().parent

# The camera is at the origin, 1.4 m above the floor; metres, +Y up.
ROOM = np.array([(-3.2, -1.4, -4.3), (3.8, 1.4, 3.2)])
WINDOW = np.array([(-3.2, -0.45, -2.4), (-3.2, 1.0, 0.2)])
TUBE_WIDTH = 0.038  # T12
TUBE_LUMINANCE = 12000.0  # cd m^-2
SKY_LUMINANCE = 2500.0
TUBES = tuple(
    np.array([(x - 0.6, 1.27, z), (x + 0.6, 1.27, z)]) for x in (-1.3, 1.7) for z in (-2.3, 1.1)
)
CORRIDOR_LUMINANCE = 0.06
AMBIENT_REACH = 0.9  # how far something dims the even bounce [m]
AMBIENT_OCCLUDED = 0.3  # of the bounce, in a narrow gap


@dataclass(frozen=True)
class Box:
    """A block of furniture."""

    low: tuple[float, float, float]
    high: tuple[float, float, float]
    paint: Paint


WOOD, WHITE, BLACK = plain((0.38, 0.24, 0.13)), plain((0.75, 0.74, 0.71)), plain((0.03, 0.03, 0.03))
BOXES = (
    Box((-2.9, -1.4, -4.3), (-0.9, 0.75, -3.95), shelf),
    Box((0.1, -0.70, -3.3), (1.9, -0.65, -2.5), WOOD),  # desk
    Box((0.15, -1.4, -3.2), (0.22, -0.70, -2.6), WOOD),
    Box((1.78, -1.4, -3.2), (1.85, -0.70, -2.6), WOOD),
    Box((0.6, -0.60, -3.2), (1.3, -0.18, -3.15), BLACK),  # screen
    Box((0.85, -1.0, -2.2), (1.35, -0.92, -1.75), cushions(FELT_BLUE)),  # chair
    Box((0.85, -0.92, -1.80), (1.35, -0.45, -1.75), cushions(FELT_BLUE)),
    Box((1.05, -1.4, -2.02), (1.15, -1.0, -1.93), BLACK),
    Box((2.7, -1.4, -0.9), (3.7, -0.95, 1.5), cushions(FELT_OCHRE)),  # sofa
    Box((3.45, -0.95, -0.9), (3.75, -0.55, 1.5), cushions(FELT_OCHRE)),
    Box((-0.5, -1.02, 1.3), (0.7, -0.97, 2.0), WOOD),  # low table
    Box((-0.4, -1.4, 1.4), (0.6, -1.34, 1.9), WOOD),
    Box((0.02, -1.34, 1.6), (0.14, -1.02, 1.7), WOOD),
    Box((0.3, -0.97, 1.5), (0.55, -0.90, 1.75), plain((0.5, 0.14, 0.1))),
    Box((-2.6, -1.4, 1.9), (-2.1, -0.9, 2.4), plain((0.55, 0.25, 0.15))),  # pot and plant
    Box((-2.37, -0.9, 2.13), (-2.33, 0.1, 2.17), WOOD),
    Box((-2.75, -0.5, 1.8), (-2.05, -0.1, 2.45), foliage),
    Box((-2.6, -0.02, 1.9), (-2.15, 0.45, 2.4), foliage),
    *(Box((x - 0.62, 1.30, z - 0.06), (x + 0.62, 1.4, z + 0.06), WHITE)
      for x in (-1.3, 1.7) for z in (-2.3, 1.1)),
)  # fmt: skip
HANGINGS = (  # axis, side, low and high corner in the face, paint
    (0, 1, (-3.3, -0.3), (-2.02, 0.66), poster),
    (2, 1, (1.0, -0.5), (2.4, 0.62), poster),
    (2, 1, (-1.6, -1.4), (-0.7, 0.6), door),
    (0, 0, (0.9, -0.2), (1.7, 0.76), poster),
    (1, 0, (-0.9, 0.5), (1.1, 2.5), rug),
)
CORRIDOR = (2, 1, (-0.7, -1.4), (-0.45, 0.6))
"""The gap beside the door."""


def slabs(
    origin: FloatArray, direction: FloatArray, low: FloatArray, high: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return where rays enter and leave a box, shape [count] each; entry beyond exit misses."""
    with np.errstate(divide="ignore", invalid="ignore"):
        first, second = (low - origin) / direction, (high - origin) / direction
    return np.fmin(first, second).max(axis=-1), np.fmax(first, second).min(axis=-1)


def is_open(points: FloatArray, targets: FloatArray) -> NDArray[np.bool_]:
    """Return whether furniture leaves the way between points free, shape [..., 3] to [...]."""
    free = np.ones(np.broadcast_shapes(points.shape, targets.shape)[:-1], dtype=bool)
    away = targets - points
    for box in BOXES:
        enters, leaves = slabs(points, away, np.array(box.low), np.array(box.high))
        free &= ~((enters < leaves) & (leaves > 1e-6) & (enters < 1.0 - 1e-6))
    return free


def tube_light(points: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the irradiance of the tubes, a cylinder's: L d sin(gamma) cos(theta) dl / r^2."""
    total = np.zeros(len(points))
    count = 6
    for ends in TUBES:
        step = (ends[1] - ends[0]) / count
        axis = step / np.linalg.norm(step)
        for index in range(count):
            target = ends[0] + (index + 0.5) * step
            away = target - points
            square = (away**2).sum(axis=-1)
            towards = away / np.sqrt(square)[:, None]
            sine = np.sqrt(np.maximum(1.0 - (towards @ axis) ** 2, 0.0))
            cosine = np.maximum((towards * normals).sum(axis=-1), 0.0)
            lit = cosine > 0.0
            lit[lit] = is_open(points[lit] + 1e-4 * normals[lit], target)
            area = TUBE_WIDTH * np.linalg.norm(step)
            total += lit * TUBE_LUMINANCE * area * sine * cosine / np.maximum(square, 0.01)
    return total


def window_light(points: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the irradiance of the window: L cos(theta) cos(theta') dA / r^2."""
    total = np.zeros(len(points))
    low, high = WINDOW
    size = high - low
    rows, columns = 4, 6
    area = size[1] * size[2] / (rows * columns)
    for i in range(rows):
        for j in range(columns):
            target = low + size * np.array([0.0, (i + 0.5) / rows, (j + 0.5) / columns])
            away = target - points
            square = np.maximum((away**2).sum(axis=-1), 0.05)
            towards = away / np.sqrt(square)[:, None]
            cosine = np.maximum((towards * normals).sum(axis=-1), 0.0)
            lit = cosine > 0.0
            lit[lit] = is_open(points[lit] + 1e-4 * normals[lit], target)
            leaving = np.maximum(-towards[:, 0], 0.0)  # the window faces +X
            total += lit * SKY_LUMINANCE * (0.6 + 0.6 * i / rows) * area * cosine * leaving / square
    return total


def openness(points: FloatArray, normals: FloatArray) -> FloatArray:
    """Return how much of the even bounce reaches points: less where walls or boxes are near."""
    turns = np.arange(8) * np.pi / 4.0
    tilts = np.array([0.35, 0.75] * 4)
    across = np.where(np.abs(normals[:, :1]) > 0.5, (0.0, 1.0, 0.0), (1.0, 0.0, 0.0))
    other = np.cross(normals, across)
    free = np.zeros(len(points))
    for turn, tilt in zip(turns, tilts, strict=True):
        sideways = np.cos(turn) * across + np.sin(turn) * other
        towards = np.sqrt(tilt) * sideways + np.sqrt(1.0 - tilt) * normals
        free += np.minimum(clearance(points + 1e-3 * normals, towards) / AMBIENT_REACH, 1.0)
    return AMBIENT_OCCLUDED + (1.0 - AMBIENT_OCCLUDED) * free / len(turns)


def clearance(points: FloatArray, directions: FloatArray) -> FloatArray:
    """Return how far it is to the next wall or box [m], shape [count]."""
    _, distance = slabs(points, directions, ROOM[0], ROOM[1])
    for box in BOXES:
        enters, leaves = slabs(points, directions, np.array(box.low), np.array(box.high))
        hit = (enters < leaves) & (leaves > 0.0)
        distance = np.where(hit, np.minimum(distance, np.maximum(enters, 0.0)), distance)
    return distance


def garden(direction: FloatArray) -> FloatArray:
    """Return what the window shows [cd m^-2], as R, G, B reflectances of D65, shape [count, 3]."""
    up = direction[:, 1] / np.linalg.norm(direction[:, [0, 2]], axis=1)
    turn = np.arctan2(direction[:, 2], -direction[:, 0])
    leaves = 0.02 + 0.09 * noise(turn / 0.012, up / 0.012) + 0.05 * noise(turn / 0.07, up / 0.05)
    hedge = 0.12 + 0.1 * noise(turn / 0.15, np.zeros_like(turn)) - 0.15 * np.cos(3.0 * turn) ** 2
    sky = np.multiply.outer(0.7 + 0.5 * np.clip(up, 0.0, 1.0), (0.95, 1.0, 1.08))
    clouds = 1.0 + 0.4 * noise(turn / 0.2 + up * 3.0, up / 0.06)
    green = np.multiply.outer(leaves, (0.7, 1.2, 0.5))
    return SKY_LUMINANCE * np.where((up < hedge)[:, None], green, sky * clouds[:, None])


def is_within(face: FloatArray, low: tuple[float, float], high: tuple[float, float]) -> FloatArray:
    """Return whether points of a face are within a rectangle, shape [count]."""
    return np.asarray(((face >= low) & (face <= high)).all(axis=1))


WALL, ACCENT = plaster((0.72, 0.70, 0.65)), plaster((0.22, 0.40, 0.40))
ACROSS = {0: [2, 1], 1: [0, 2], 2: [0, 1]}
"""The two coordinates of a face, by the axis of its normal."""


def walls(points: FloatArray, axis: FloatArray, side: FloatArray) -> FloatArray:
    """Return the reflectance of the room's walls, floor and ceiling, shape [count, 3]."""
    color = np.zeros((len(points), 3))
    for a in range(3):
        for s in range(2):
            here = (axis == a) & (side == s)
            face = points[here][:, ACROSS[a]]
            if a == 1:
                paint = tiles if s else planks
            else:
                paint = ACCENT if (a, s) == (0, 1) else WALL
            shown = paint(face[:, 0], face[:, 1])
            if a != 1:
                shown[face[:, 1] < ROOM[0, 1] + 0.09] = (0.16, 0.12, 0.09)  # skirting
            for hung_axis, hung_side, low, high, picture in HANGINGS:
                if (hung_axis, hung_side) == (a, s):
                    inside = is_within(face, low, high)
                    shown[inside] = picture(*(face[inside] - low).T)
            color[here] = shown
    return color


def trace(direction: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what rays from the camera meet first.

    Returns:
        Points [m], shape [count, 3]; normals, shape [count, 3]; reflectances, shape [count, 3];
        and emitted light [cd m^-2] of both lamps through R, G and B, shape [count, 6].
    """
    count, rays = len(direction), np.arange(len(direction))
    origin = np.zeros(3)
    with np.errstate(divide="ignore"):
        exits = np.where(direction > 0.0, ROOM[1], ROOM[0]) / direction
    axis = np.abs(exits).argmin(axis=1)
    distance = exits[rays, axis]
    side = (direction[rays, axis] > 0.0).astype(int)
    points = distance[:, None] * direction
    normals = np.zeros((count, 3))
    normals[rays, axis] = 1.0 - 2.0 * side
    color = walls(points, axis, side)
    emitted = np.zeros((count, 6))
    through = (axis == 0) & (side == 0)
    through &= is_within(points[:, [1, 2]], tuple(WINDOW[0, 1:]), tuple(WINDOW[1, 1:]))
    frame = (np.mod(points[:, 2] - WINDOW[0, 2], 0.85) < 0.06) | (points[:, 1] < -0.40)
    through &= ~frame
    emitted[through, 3:] = garden(direction[through])
    gap = (axis == CORRIDOR[0]) & (side == CORRIDOR[1])
    gap &= is_within(points[:, ACROSS[CORRIDOR[0]]], *CORRIDOR[2:])
    emitted[gap, :3] = (CORRIDOR_LUMINANCE * (2.0 + points[gap, 1]))[:, None]
    color[through | gap] = 0.0

    for box in BOXES:
        low, high = np.array(box.low), np.array(box.high)
        enters, leaves = slabs(origin, direction, low, high)
        hit = (enters < leaves) & (enters > 0.0) & (enters < distance)
        distance[hit] = enters[hit]
        points[hit] = enters[hit, None] * direction[hit]
        with np.errstate(divide="ignore", invalid="ignore"):
            face = np.fmin(low / direction[hit], high / direction[hit]).argmax(axis=1)
        normals[hit] = -np.eye(3)[face] * np.sign(direction[hit, face])[:, None]
        places = np.stack([points[hit][:, ACROSS[a]] - low[ACROSS[a]] for a in range(3)])
        place = places[face, np.arange(hit.sum())]
        color[hit] = box.paint(place[:, 0], place[:, 1])
        emitted[hit] = 0.0
    for ends in TUBES:
        pad = np.array([0.0, 0.5 * TUBE_WIDTH, 0.5 * TUBE_WIDTH])
        enters, leaves = slabs(origin, direction, ends[0] - pad, ends[1] + pad)
        hit = (enters < leaves) & (enters > 0.0) & (enters < distance)
        emitted[hit] = [TUBE_LUMINANCE] * 3 + [0.0] * 3
        color[hit] = 0.0
    return points, normals, color, emitted


def direct(points: FloatArray, normals: FloatArray) -> FloatArray:
    """Return the irradiance straight from both lamps [lm m^-2], shape [count, 2]."""
    return np.stack([tube_light(points, normals), window_light(points, normals)], axis=-1)


def even_bounce() -> FloatArray:
    """Return the irradiance that the room's surfaces give one another, shape [2]."""
    turns, sines = np.meshgrid((np.arange(60) + 0.5) / 60, (np.arange(30) + 0.5) / 15 - 1.0)
    directions = latlong_directions(turns, np.arccos(sines)).reshape(-1, 3)
    points, normals, color, _ = trace(directions)
    grey = color.mean(axis=1)
    leaving = grey[:, None] * direct(points, normals)
    return np.asarray(leaving.mean(axis=0) / (1.0 - grey.mean()))


def look(direction: FloatArray, bounce: FloatArray) -> FloatArray:
    """Return the light from some directions, as coefficients, shape [count, 6]."""
    points, normals, color, light = trace(direction)
    lit = color.any(axis=1)
    arriving = direct(points[lit], normals[lit])
    arriving += openness(points[lit], normals[lit])[:, None] * bounce
    light[lit] += (arriving[:, :, None] * color[lit, None, :]).reshape(-1, 6) / np.pi
    return light


def coefficients(height: int, samples: int = 2, rows: Sequence[int] | None = None) -> FloatArray:
    """Return the room as seen from the camera, shape [row_count, 2 * height, 6].

    Args:
        height: Rows of the whole map.
        samples: Per texel, in each direction.
        rows: Which rows; all of them where None.
    """
    bounce = even_bounce()
    columns = (np.arange(2 * height * samples) + 0.5) / (2 * height * samples)

    def one(row: int) -> FloatArray:
        top, bottom = np.cos(np.pi * row / height), np.cos(np.pi * (row + 1) / height)
        seen = np.zeros((2 * height, 6))
        for sample in range(samples):
            polar = np.arccos(top + (bottom - top) * (sample + 0.5) / samples)
            directions = latlong_directions(columns, np.full(columns.shape, polar))
            light = look(directions, bounce).reshape(2 * height, samples, 6)
            seen += light.mean(axis=1) / samples
        return seen

    with ThreadPoolExecutor() as pool:
        return np.stack(list(pool.map(one, range(height) if rows is None else rows)))


def main() -> None:
    """Write the maps and the layers."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--height", type=int, default=512, help="rows of the map")
    parser.add_argument("--layers", action="store_true", help="keep room.exr as it is")
    parser.add_argument("-o", "--output", type=Path, default=FOLDER, help="folder to write to")
    given = parser.parse_args()
    names, spectra = [f"c{k}" for k in range(6)], basis()
    if given.layers:
        room = read_image(given.output / "room.exr", channels=names).pixels
    else:
        room = rounded(coefficients(given.height))
        channels = {name: room[..., k] for k, name in enumerate(names)}
        write_exr(given.output / "room.exr", [Part("light", channels, {}, "half")], "zip:9")
    write_rgb(given.output / "room_rgb.exr", rendition(room, spectra))
    write_stage(given.output / "room.usda", spectra)
    for name, lamp in ALONE.items():
        lit = alone(spectra, lamp)
        write_rgb(given.output / f"{name}_rgb.exr", rendition(room, lit, smaller=4))
        write_stage_alone(given.output / f"{name}.usda", spectra, lamp)


if __name__ == "__main__":
    main()
