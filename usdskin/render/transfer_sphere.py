"""A fixed set of directions that shadows are measured in, and light spread over it.

The directions lie on rings, about as far apart along a ring as the rings are. Light between them
is shared by the four around it, so the sum over the directions is linear interpolation of what was
measured, moves smoothly with the light, and keeps its flux.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.latlong import latlong_coordinates, latlong_directions

_AXES = np.linalg.qr(np.array([[0.83, 0.31, -0.46], [-0.27, 0.91, 0.32], [0.52, -0.14, 0.84]]))[0]
"""Frame of the rings: their axis is none that buildings and floors have, or whole rings would be
hidden at once."""

WORD = 32
"""Directions that share a word of bits."""

BYTE = 8
"""Directions of a word that are closest together."""


@dataclass(frozen=True, slots=True, eq=False)
class TransferSphere:
    """Directions on rings around an oblique axis, ordered in words of neighbours."""

    rings: int
    """Number of rings."""

    counts: NDArray[np.int64]
    """Directions on each ring, shape [rings]."""

    order: NDArray[np.int64]
    """Place of each direction, ring after ring, in the words, shape [count]."""

    direction: NDArray[np.float32]
    """Unit directions in the order of the words, zero where the last is not full, shape
    [word_count * 32, 3]."""

    @property
    def axes(self) -> NDArray[np.float64]:
        """Rotation from the world to the frame of the rings, around its +Y, shape [3, 3]."""
        return _AXES.T

    @property
    def count(self) -> int:
        """Number of directions."""
        return len(self.order)

    def shares(
        self, directions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
        """Return the four directions around each one given, and the share of each.

        Args:
            directions: Of any length, shape [n, 3].

        Returns:
            Places in the words and weights that add up to 1, shapes [n, 4].
        """
        u, v = latlong_coordinates(directions @ _AXES)
        at = np.clip(v * self.rings - 0.5, 0.0, self.rings - 1.0)
        upper = np.minimum(at.astype(np.int64), max(self.rings - 2, 0))
        lower_share = at - upper
        start = np.cumsum(self.counts) - self.counts
        index, weight = [], []
        for ring, share in ((upper, 1.0 - lower_share), (upper + 1, lower_share)):
            length = self.counts[ring]
            along = u * length - 0.5
            left = np.floor(along)
            right_share = along - left
            left = left.astype(np.int64) % length
            index += [start[ring] + left, start[ring] + (left + 1) % length]
            weight += [share * (1.0 - right_share), share * right_share]
        return self.order[np.stack(index, axis=-1)], np.stack(weight, axis=-1)


def ring_count(directions: int) -> int:
    """Return how many rings hold about so many directions."""
    return max(4, round(float(np.sqrt(np.pi * directions / 4.0))))


def transfer_sphere(rings: int) -> TransferSphere:
    """Return the directions of so many rings.

    Args:
        rings: 4 or more; there are about 4 rings^2 / pi directions.
    """
    polar = np.pi * (np.arange(rings) + 0.5) / rings
    counts = np.round(2.0 * rings * np.sin(polar)).astype(np.int64)
    ring = np.repeat(np.arange(rings), counts)
    along = np.arange(len(ring)) - np.repeat(np.cumsum(counts) - counts, counts)
    found = latlong_directions((along + 0.5) / counts[ring], polar[ring])
    sequence = np.concatenate(_words(np.arange(len(found)), found))
    order = np.empty(len(found), np.int64)
    order[sequence] = np.arange(len(found))
    direction = np.zeros((-(-len(found) // WORD) * WORD, 3), np.float32)
    direction[order] = found @ _AXES.T
    return TransferSphere(rings, counts, order, direction)


def _words(index: NDArray[np.int64], found: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Halve the directions along their longest extent until words, and bytes, hold them."""
    if len(index) <= BYTE:
        return [index]
    size = WORD if len(index) > WORD else BYTE
    axis = int(np.argmax(np.ptp(found[index], axis=0)))
    index = index[np.argsort(found[index, axis], kind="stable")]
    half = -(-len(index) // (2 * size)) * size
    return _words(index[:half], found) + _words(index[half:], found)
