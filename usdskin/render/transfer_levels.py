"""The order in which the places of a mesh are measured: few first, then those between them.

Neighbours see nearly the same. Where all measured places around one agree on a direction, and on
those beside it, that direction is taken as they have it; rays are followed where they do not. The
rim of an open mesh sees past it, unlike what is beside it, and is measured first.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

RATIO = 3
"""Places of a level, over those of all levels before it."""

FEWEST = 200
"""Places of the first level."""

NEIGHBOURS = 12
"""Measured places around one that have to agree."""

BESIDE = 4
"""Directions around one that have to agree."""

_NORMAL_WEIGHT = 3.0
"""Spacings of the measured places that normals at a right angle are apart, over sqrt(2)."""

_MORTON_BITS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """Places that are measured together."""

    place: NDArray[np.int32]
    """Shape [count]."""

    around: NDArray[np.int32]
    """Measured places around each, shape [count, 12], or [count, 0] where all rays are followed."""


def levels_of(
    points: NDArray[np.float32], normals: NDArray[np.float32], rim: NDArray[np.bool_]
) -> list[Level]:
    """Return the places of a mesh in the order in which they are measured.

    Args:
        points: Positions [m], shape [count, 3].
        normals: Unit normals, shape [count, 3].
        rim: What belongs to the first level, shape [count].
    """
    from scipy.spatial import cKDTree  # takes a quarter of a second to import

    along = _along_a_curve(points)
    first, order = along[rim[along]], along[~rim[along]]
    count = len(order)
    stride = 1
    while count // (stride * RATIO) >= FEWEST:
        stride *= RATIO
    known = np.arange(0, count, stride)
    place = np.concatenate([first, order[known]]).astype(np.int32)
    levels = [Level(place, np.zeros((len(place), 0), np.int32))]
    while stride > 1:
        stride //= RATIO
        every = np.arange(0, count, stride)
        new = every[every % (stride * RATIO) != 0]
        measured, wanted = order[known], order[new]
        nearest = cKDTree(points[measured]).query(points[measured], k=2)[0][:, 1]
        used = nearest[nearest > 0.0]
        spacing = float(np.median(used)) if len(used) else 1.0

        def features(places: NDArray[np.int64], spacing: float = spacing) -> NDArray[np.float64]:
            at = points[places].astype(np.float64) / spacing
            return np.concatenate([at, _NORMAL_WEIGHT * normals[places]], axis=1)

        found = cKDTree(features(measured)).query(features(wanted), k=NEIGHBOURS)[1]
        levels.append(Level(wanted.astype(np.int32), measured[found].astype(np.int32)))
        known = every
    return levels


def beside(directions: NDArray[np.float32]) -> NDArray[np.int32]:
    """Return the four directions nearest to each, shape [count, 4]."""
    from scipy.spatial import cKDTree

    found = cKDTree(directions).query(directions, k=BESIDE + 1)[1]
    return np.asarray(found[:, 1:], np.int32)


def words_near(others: NDArray[np.int32], size: int) -> NDArray[np.int32]:
    """Return the words that hold the directions beside those of each word.

    Args:
        others: Directions beside each (``beside``).
        size: Directions in a word.

    Returns:
        Words, the word itself where there are fewer, shape [word_count, most].
    """
    count = -(-len(others) // size)
    word = np.arange(len(others)) // size
    found = [np.unique(others[word == k] // size) for k in range(count)]
    table = np.repeat(np.arange(count)[:, None], max(len(each) for each in found), axis=1)
    for k, each in enumerate(found):
        table[k, : len(each)] = each
    return table.astype(np.int32)


def rim_of(points: NDArray[np.float32], triangles: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Return which points lie on an edge of a single triangle; equal points are one, shape [count].

    Args:
        points: Positions [m], shape [count, 3].
        triangles: Point indices, shape [triangle_count, 3].
    """
    place = np.unique(points, axis=0, return_inverse=True)[1].reshape(-1)
    corner = place[triangles].astype(np.int64)
    edges = np.stack([corner, np.roll(corner, -1, axis=1)], axis=-1).reshape(-1, 2)
    edges = np.sort(edges, axis=1)
    key, times = np.unique(edges[:, 0] * (len(points) + 1) + edges[:, 1], return_counts=True)
    single = key[times == 1]
    found = np.zeros(len(points) + 1, np.bool_)
    found[single // (len(points) + 1)] = True
    found[single % (len(points) + 1)] = True
    return np.asarray(found[place])


def _along_a_curve(points: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the points in the order of their Morton codes, so that each n-th is evenly spread."""
    low = points.min(axis=0).astype(np.float64)
    size = max(float((points - low).max()), 1e-30)
    steps = ((points - low) / size * ((1 << _MORTON_BITS) - 1)).astype(np.int64)
    code = np.zeros(len(points), np.int64)
    for bit in range(_MORTON_BITS):
        for axis in range(3):
            code |= ((steps[:, axis] >> bit) & 1) << (3 * bit + axis)
    return np.argsort(code, kind="stable")
