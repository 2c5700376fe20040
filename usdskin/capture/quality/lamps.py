"""Lamps that were saturated in every exposure: where they are, how much they hold, their mending.

A clipped texel shows the least its radiance can be. What a lamp lacks cannot be known from the
pictures: one that is k times as bright as it shows leaves k - 1 times its share of the flux
missing. A reading of its illuminance closes that gap.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.latlong import latlong_coordinates, texel_directions, texel_solid_angles
from usdskin.meters import cosine_weights, flux, texel_vectors
from usdskin.regions import label_regions, region_texels

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_BLOCKS = 128
"""Rows and columns of the coarse map that total irradiances are taken from."""

_RING_TEXELS = 2
_RING_LEVEL = 0.1
"""Share of the clipped level above which an unclipped neighbour shows the lamp, not the wall."""

_TOLERANCE = 0.1
"""How far a reading may fall below what the clipped texels show; meters and cameras differ."""


@dataclass(frozen=True, slots=True, eq=False)
class Lamp:
    """A connected group of texels that were saturated in every exposure."""

    direction: FloatArray
    """Where its flux comes from, unit vector in the panorama's frame, shape [3]."""

    solid_angle_sr: float
    """Solid angle of the saturated area [sr]."""

    flux_share: float
    """Least share of the panorama's flux [1]."""

    irradiance_share: float
    """Least share of the irradiance of a surface that faces it [1]."""

    irradiance: FloatArray
    """Least irradiance of a surface that faces it, per channel [camera value sr], shape [3]."""

    box: tuple[int, int, int, int]
    """First row, first column, rows and columns; columns count on across the right edge."""

    reaches_unseen: bool
    """Whether it touches an area that no view saw, so that it may be larger."""

    shape: tuple[int, int]
    """Height and width of the panorama."""

    rows: NDArray[np.intp]
    """Rows of its texels, shape [texel_count]."""

    columns: NDArray[np.intp]
    """Columns of its texels, shape [texel_count]."""

    radiance: FloatArray
    """The saturated area's part in the values of its texels, shape [texel_count, 3]."""

    @property
    def diameter_deg(self) -> float:
        """Angular diameter of a disc of the same solid angle [deg]."""
        half = min(math.sqrt(self.solid_angle_sr / (4.0 * math.pi)), 1.0)
        return math.degrees(4.0 * math.asin(half))

    @property
    def texel(self) -> tuple[int, int]:
        """Row and column of the texel that its direction falls in."""
        height, width = self.shape
        u, v = latlong_coordinates(self.direction)
        return min(int(v * height), height - 1), min(int(u * width), width - 1)

    def irradiance_at(self, direction: FloatArray) -> FloatArray:
        """Return the least irradiance of a surface, per channel, shape [3].

        Args:
            direction: Where the surface faces, in the panorama's frame, shape [3].
        """
        weights = cosine_weights(self.rows, self.columns, *self.shape, direction)
        return np.asarray(weights @ self.radiance)


@dataclass(frozen=True, slots=True)
class Replacement:
    """How a lamp was raised to its measured irradiance."""

    factor: float
    """Measured irradiance over what the clipped texels showed [1]."""

    color_source: str
    """``ring`` where unclipped neighbours show the lamp's color, else ``clipped``."""


def find_lamps(
    values: FloatImage,
    clipped: FloatImage,
    seen: FloatImage,
    weights: FloatArray,
) -> tuple[Lamp, ...]:
    """Return the lamps that were saturated in every exposure, the largest flux first.

    Texels belong together when they touch, at a corner too, across the panorama's seam and at its
    poles, where all texels of the row meet. Of a texel that is clipped in part, the saturated
    area's part in its value is what that area has at the lamp's level, and no more than the value.

    Args:
        values: Camera values, 0 or above, latlong, shape [height, width, 3].
        clipped: Share of each texel that was saturated in every exposure, shape [height, width].
        seen: Share of each texel that any view saw, shape [height, width].
        weights: Weights of the channels that make a luminance, shape [3].
    """
    labels = label_regions(clipped > 0.0)
    if not labels.any():
        return ()
    total = float(flux(values) @ weights)
    moments = _block_moments(values @ weights.astype(np.float32))
    lamps = []
    for rows, columns in region_texels(labels):
        lamp = _lamp(values, clipped, seen, rows, columns, weights, total, moments)
        lamps.append(lamp)
    # Python's sort keeps the order of equal ones: that of their first texels.
    return tuple(sorted(lamps, key=lambda lamp: -lamp.flux_share))


def replace_lamp(
    values: FloatImage,
    stddev: FloatImage,
    clipped: FloatImage,
    lamp: Lamp,
    irradiance: float,
    weights: FloatArray,
) -> Replacement:
    """Raise the saturated area of a lamp so that its irradiance is the measured one.

    The color is that of unclipped texels around it that are bright enough to show the lamp, or
    else that of the clipped values. No channel falls below what the clipped texels show, since
    that much was there.

    Args:
        values: Camera values, changed in place, shape [height, width, 3].
        stddev: Their standard deviation, raised by the same factors, changed in place, of the same
            shape.
        clipped: Share of each texel that was saturated in every exposure, shape [height, width].
        lamp: Which lamp; found in ``values``.
        irradiance: Measured at a surface that faces it, the lamp alone [camera value sr]: an
            illuminance [lx] over the panorama's scale.
        weights: Weights of the channels that make a luminance, shape [3].

    Raises:
        UsageError: The reading is far below what the clipped texels already show.
    """
    least = float(lamp.irradiance @ weights)
    factor = irradiance / least if least > 0.0 else 0.0
    if factor < 1.0 - _TOLERANCE:
        row, column = lamp.texel
        raise UsageError(
            f"the measured illuminance is {factor:.2f} times what the clipped pixels of the lamp "
            f"at column {column}, row {row} of the panorama already show, and they show the least "
            "it can be; measure that lamp alone, facing it at the camera's place, or correct the "
            "scale"
        )
    color = _ring_color(values, clipped, lamp, weights)
    factors = np.full(3, factor)
    if color is not None and factor >= 1.0:
        goal = _at_least(lamp.irradiance, color, irradiance, weights)
        shown = lamp.irradiance > 0.0
        factors[shown] = goal[shown] / lamp.irradiance[shown]
    texels = lamp.rows, lamp.columns
    before = values[texels].astype(np.float64)
    after = before + lamp.radiance * (factors - 1.0)
    rise = np.divide(after, before, out=np.ones_like(before), where=before > 0.0)
    values[texels] = after
    stddev[texels] *= rise.astype(np.float32)
    return Replacement(factor, "clipped" if color is None else "ring")


# --- Figures of one lamp -----------------------------------------------------------------------


def _lamp(
    values: FloatImage,
    clipped: FloatImage,
    seen: FloatImage,
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    weights: FloatArray,
    total: float,
    moments: FloatArray,
) -> Lamp:
    height, width = values.shape[:2]
    share = clipped[rows, columns].astype(np.float64)
    level = values[rows, columns].astype(np.float64)
    fullest = share >= 0.999 * share.max()
    peak = (level[fullest] / share[fullest, None]).max(axis=0)
    radiance = np.minimum(level, share[:, None] * peak)

    size = texel_solid_angles(height, width)[rows]
    light = radiance @ weights
    direction = _centroid(rows, columns, height, width, light if light.any() else share)
    facing = cosine_weights(rows, columns, height, width, direction) @ radiance
    around = float(np.maximum(moments @ direction, 0.0).sum())
    lamp_irradiance = float(facing @ weights)
    box = _box(rows, columns, width)
    around_it = _neighbourhood(rows, columns, box, (height, width), 1)
    return Lamp(
        direction=direction,
        solid_angle_sr=float(share @ size),
        flux_share=float(light @ size) / total if total > 0.0 else 0.0,
        irradiance_share=min(lamp_irradiance / around, 1.0) if around > 0.0 else 0.0,
        irradiance=facing,
        box=box,
        reaches_unseen=bool((seen[around_it] < 0.5).any()),
        shape=(height, width),
        rows=rows,
        columns=columns,
        radiance=radiance,
    )


def _centroid(
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    height: int,
    width: int,
    light: FloatArray,
) -> FloatArray:
    row_factors, column_factors = texel_vectors(height, width)
    total = light @ (row_factors[rows] * column_factors[columns])
    size = float(np.linalg.norm(total))
    if size > 1e-9 * float(light @ texel_solid_angles(height, width)[rows]):
        return np.asarray(total / size)
    # Light from all around has no centroid.
    brightest = int(np.argmax(light))
    return np.asarray(texel_directions(height, width)[rows[brightest], columns[brightest]])


def _block_moments(luminance: FloatImage) -> FloatArray:
    """Return the integrals of luminance times direction over blocks of texels, shape [count, 3].

    Irradiance is the sum of their positive projections, to about 0.1 %: only blocks that the
    surface's horizon cuts are not exact.
    """
    height, width = luminance.shape
    row_factors, column_factors = texel_vectors(height, width)
    starts = [np.arange(0, size, max(1, size // _BLOCKS)) for size in (height, width)]
    moments = []
    for axis in range(3):
        along = np.add.reduceat(luminance * column_factors[:, axis], starts[1], axis=1)
        along *= row_factors[:, axis, None]
        moments.append(np.add.reduceat(along, starts[0], axis=0).ravel())
    return np.stack(moments, axis=-1)


def _box(
    rows: NDArray[np.intp], columns: NDArray[np.intp], width: int
) -> tuple[int, int, int, int]:
    """Return the box around texels, which may cross the seam."""
    used = np.unique(columns)
    gaps = np.diff(np.append(used, used[0] + width))
    widest = used.size - 1 - int(np.argmax(gaps[::-1]))
    first = int(used[(widest + 1) % used.size])
    top = int(rows.min())
    return top, first, int(rows.max()) - top + 1, int(width - gaps[widest] + 1)


# --- Color of one lamp -------------------------------------------------------------------------


def _neighbourhood(
    rows: NDArray[np.intp],
    columns: NDArray[np.intp],
    box: tuple[int, int, int, int],
    shape: tuple[int, int],
    reach: int,
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return rows and columns of the texels within ``reach`` of a group, the group included."""
    import cv2

    height, width = shape
    top, left = box[0] - reach, box[1] - reach
    span = min(box[3] + 2 * reach, width)
    window = np.zeros((box[2] + 2 * reach, span), dtype=np.uint8)
    window[rows - top, (columns - left) % width] = 1
    # Beyond the sides of a window as wide as the map its other side goes on.
    window = np.pad(window, ((0, 0), (reach, reach)), mode="wrap" if span == width else "constant")
    near = cv2.dilate(window, np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8))
    found_rows, found_columns = np.nonzero(near[:, reach:-reach])
    inside = (found_rows + top >= 0) & (found_rows + top < height)
    return found_rows[inside] + top, (found_columns[inside] + left) % width


def _ring_color(
    values: FloatImage, clipped: FloatImage, lamp: Lamp, weights: FloatArray
) -> FloatArray | None:
    """Return the color of the unclipped texels around a lamp that show it, of luminance 1."""
    near = _neighbourhood(lamp.rows, lamp.columns, lamp.box, lamp.shape, _RING_TEXELS)
    level = float((lamp.radiance @ weights).max())
    ring = values[near].astype(np.float64)
    shows_lamp = (clipped[near] == 0.0) & (ring @ weights > _RING_LEVEL * level)
    if not shows_lamp.any():
        return None
    size = texel_solid_angles(*lamp.shape)[near[0]]
    color = (size * shows_lamp) @ ring
    return np.asarray(color / (color @ weights))


def _at_least(
    least: FloatArray, color: FloatArray, luminance: float, weights: FloatArray
) -> FloatArray:
    """Return max(least, s color) with the one s that gives it a luminance, shape [3].

    Args:
        least: Lower bound of each channel, of no more luminance than ``luminance``.
        color: Color to reach.
        luminance: Weighted sum to reach.
        weights: Weights of the channels.
    """
    raised = np.ones(3, dtype=np.bool_)
    scale = luminance
    # Whoever falls below its bound takes light from the others: s only ever falls.
    for _ in range(3):
        rest = float((weights * color)[raised].sum())
        if rest > 0.0:
            scale = (luminance - float((weights * least)[~raised].sum())) / rest
        raised &= scale * color >= least
    return np.where(raised, scale * color, least)
