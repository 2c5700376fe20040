"""What a light map sums up to, in one pass over its rows and without spectra of texels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.estimate.light.light_map import LightMap
from usdskin.latlong import latlong_coordinates, texel_directions, texel_solid_angles
from usdskin.meters import cosine_weights, radiance_at, texel_vectors
from usdskin.notes import Note
from usdskin.progress import Progress
from usdskin.spectrum import band_widths

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

SPOT_RADIUS_DEG = 0.5
"""Of the usual spot meter, which accepts one degree [deg]."""

NOTED_NEGATIVE_SHARE = 0.05
"""Share of negative energy from which a note is made [1]."""

_UP = (0.0, 1.0, 0.0)
_SAMPLE_COUNT = 1 << 16
_BIN_ROWS = 48
_STEPS = 100


@dataclass(frozen=True, slots=True, eq=False)
class Readings:
    """Where meters were held, in the map's frame."""

    spot: FloatArray | None = None
    """Where a luminance meter looked, shape [3]."""

    facing: FloatArray | None = None
    """Where an illuminance meter faced, shape [3]."""


@dataclass(frozen=True, slots=True, eq=False)
class Totals:
    """Sums over a light map, in coefficients unless it is said otherwise."""

    mean: FloatArray
    """Mean over the sphere, shape [rank]."""

    up: FloatArray
    """Irradiance of a surface that faces the pole [sr], shape [rank]."""

    spot: FloatArray | None
    """Mean over the spot of the luminance meter, shape [rank]."""

    facing: FloatArray | None
    """Irradiance of the illuminance meter [sr], shape [rank]."""

    sphere_shares: FloatArray
    """Share of the sphere in which a class is the strongest, by luminance [1], shape [classes]."""

    peak_direction: FloatArray
    """Where a surface gets the largest illuminance, in the map's frame, shape [3]."""

    peak_luminous: float
    """That illuminance, in the unit of the map's Y times sr."""

    negative_share: float
    """Share of the energy of all bands that is negative [1]; see ``is_sampled``."""

    is_sampled: bool
    """Whether that was found from some of the texels."""


def check_totals(totals: Totals, light: LightMap, where: str, notes: list[Note]) -> None:
    """Refuse a map without light, and note one whose spectra are negative to a large part.

    Args:
        totals: What the map adds up to.
        light: The map.
        where: What it was read from, for errors and notes.
        notes: Takes the note.

    Raises:
        ImageError: There is no light in it.
    """
    if not float(totals.mean @ light.xyz[:, 1]) > 0.0:
        raise ImageError(f"{where}: is black, so there is no light to estimate; give another")
    if totals.negative_share > NOTED_NEGATIVE_SHARE:
        notes.append(
            Note(
                "negative-energy",
                where,
                f"{totals.negative_share:.1%} of the energy of its spectra is negative; the lamp, "
                "the white or the calibration does not fit its colors",
            )
        )


def add_up(light: LightMap, readings: Readings, progress: Progress) -> Totals:
    """Return the sums over a light map.

    Args:
        light: The map; its scale does not matter to the shares.
        readings: Where meters were held.
        progress: Told of every row.
    """
    sums = _Sums(light, readings)
    progress.start(light.height, "measure")
    for begin, block in light.blocks():
        sums.add(begin, block)
        progress.advance(block.shape[0])
    progress.done()
    return sums.finish()


class _Sums:
    def __init__(self, light: LightMap, readings: Readings) -> None:
        self._light, self._readings = light, readings
        self._widths_nm = band_widths(light.wavelength_nm)
        height, width, rank = light.height, light.width, light.rank
        class_count = len(light.classes)
        # Luminance of each class, of coefficients: shape [rank, classes].
        self._luminous = np.zeros((rank, class_count), np.float32)
        self._luminous[np.arange(rank), np.arange(rank) // 3] = light.xyz[:, 1]
        self._size = texel_solid_angles(height, width)
        every = np.arange(height)
        self._upward = cosine_weights(every, np.zeros_like(every), height, width, _UP)
        self._row_vectors, self._column_vectors = texel_vectors(height, width)
        self._mean, self._up, self._facing = (np.zeros(rank) for _ in range(3))
        self._bins = np.zeros((_BIN_ROWS, 2 * _BIN_ROWS, 3))
        self._areas = np.zeros(class_count)
        self._negative = self._energy = 0.0
        self._stride = max(height * width // _SAMPLE_COUNT, 1)
        self._spot_rows = _spot_rows(readings.spot, height)
        # Pages that nobody writes to take no memory.
        self._spot = None if readings.spot is None else np.zeros((height, width, rank), np.float32)

    def add(self, begin: int, block: FloatImage) -> None:
        """Add the coefficients of some rows, shape [row_count, width, rank]."""
        rows = np.arange(begin, begin + block.shape[0])
        by_row = block.sum(axis=1, dtype=np.float64)
        self._mean += self._size[rows] @ by_row
        self._up += self._upward[rows] @ by_row
        per_class = block @ self._luminous
        self._bin(rows, per_class.sum(axis=-1, dtype=np.float64))
        self._areas += self._size[rows] @ _strongest(per_class)
        self._sample(begin, block)
        facing = self._readings.facing
        if facing is not None:
            light = self._light
            columns = np.arange(light.width)[None, :]
            weights = cosine_weights(rows[:, None], columns, light.height, light.width, facing)
            self._facing += np.tensordot(weights, block, 2)
        if self._spot is not None:
            first, last = (min(max(row - begin, 0), rows.size) for row in self._spot_rows)
            self._spot[begin + first : begin + last] = block[first:last]

    def _bin(self, rows: NDArray[np.intp], luminance: FloatArray) -> None:
        """Add the luminous vectors of texels to those of larger areas."""
        light = self._light
        to_row = rows * _BIN_ROWS // light.height
        to_column = np.arange(light.width) * (2 * _BIN_ROWS) // light.width
        starts = np.flatnonzero(np.diff(to_column, prepend=-1))
        for axis in range(3):
            weighted = luminance * self._column_vectors[:, axis]
            narrow = np.add.reduceat(weighted, starts, axis=1)
            narrow *= self._row_vectors[rows, axis][:, None]
            np.add.at(self._bins[..., axis], (to_row[:, None], to_column[starts]), narrow)

    def _sample(self, begin: int, block: FloatImage) -> None:
        """Add the energies of texels at even steps through the map."""
        width, rank = block.shape[1:]
        first = -(begin * width) % self._stride
        flat = block.reshape(-1, rank)
        at = np.arange(first, flat.shape[0], self._stride)
        spectra = flat[at].astype(np.float64) @ self._light.basis
        size = self._size[begin + at // width]
        self._negative += float(size @ np.maximum(-spectra, 0.0) @ self._widths_nm)
        self._energy += float(size @ np.abs(spectra) @ self._widths_nm)

    def finish(self) -> Totals:
        """Return the sums."""
        direction, peak = _largest(self._bins.reshape(-1, 3))
        spot = None
        if self._spot is not None and self._readings.spot is not None:
            spot = radiance_at(self._spot, self._readings.spot, SPOT_RADIUS_DEG)
        return Totals(
            mean=self._mean / (4.0 * np.pi),
            up=self._up,
            spot=spot,
            facing=None if self._readings.facing is None else self._facing,
            sphere_shares=self._areas / (4.0 * np.pi),
            peak_direction=direction,
            peak_luminous=peak,
            negative_share=self._negative / self._energy if self._energy > 0.0 else 0.0,
            is_sampled=self._stride > 1,
        )


def _strongest(per_class: FloatImage) -> FloatArray:
    """Return how many texels of each row every class is the strongest in."""
    count = per_class.shape[-1]
    if count == 1:
        return np.full((per_class.shape[0], 1), float(per_class.shape[1]))
    strongest = per_class.argmax(axis=-1)
    return np.stack([(strongest == index).sum(axis=1) for index in range(count)], axis=1)


def _spot_rows(direction: FloatArray | None, height: int) -> tuple[int, int]:
    """Return the first row that a spot touches and the row after the last."""
    if direction is None:
        return 0, 0
    _, v = latlong_coordinates(direction)
    reach = SPOT_RADIUS_DEG / 180.0
    first, last = (v - reach) * height, (v + reach) * height
    return max(int(first) - 1, 0), min(int(last) + 2, height)


def _largest(vectors: FloatArray) -> tuple[FloatArray, float]:
    """Return the direction n with the largest ``sum_b max(n . V_b, 0)``, and that sum.

    V_b is the integral of L omega over an area b: n . V_b is what the area sends to a surface that
    faces n, exactly, where all of it is above n's horizon. The sum is a convex function of n, so
    n = gradient / |gradient| never lowers it; the best of many directions is where that begins.
    """
    candidates = texel_directions(16, 32).reshape(-1, 3)
    sums = np.maximum(candidates @ vectors.T, 0.0).sum(axis=1)
    direction = candidates[int(np.argmax(sums))]
    for _ in range(_STEPS):
        gradient = vectors[vectors @ direction > 0.0].sum(axis=0)
        length = float(np.linalg.norm(gradient))
        if length == 0.0 or np.array_equal(gradient / length, direction):
            break
        direction = gradient / length
    return direction, float(np.maximum(vectors @ direction, 0.0).sum())
