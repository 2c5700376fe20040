"""Tell which mixture of lamps lights the surfaces of a panorama.

A surface's own color hides the light's, but surfaces average out to nearly grey (Buchsbaum, "A
spatial processor model for object colour perception", 1980), all the more when bright ones count
more (Finlayson and Trezzi, "Shades of gray and colour constancy", 2004). So averages over a
neighbourhood say what mixtures are to be expected there. Then each cell is looked at: many
surfaces, such as ceilings and walls, are nearly grey, and where the cell's chromaticity is that of
a mixture, such a surface in that mixture is the likeliest cause.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from math import comb

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.classes.lamps import Lamps, chromaticity
from usdskin.estimate.classes.sphere import add_cells, row_blocks, smooth, spread
from usdskin.latlong import texel_solid_angles

FloatArray = NDArray[np.float64]

_MEETING_ROWS = 32  # of the map on which neighbourhoods are looked at; they are smooth
_SURFACE_RADIUS = 0.25  # [rad], over which surfaces average out
_MOST_MIXTURES = 500

# How much the evidence weighs, in surfaces of independent color.
_WORLD_SURFACES = 8.0
_NEAR_SURFACES = 12.0
_PRIOR_SURFACES = 4.0
_PLAIN_SURFACES = 32.0  # lamps of a class scatter by a sixth of what surfaces do
_UNSEEN_FLUX = 0.05  # of all light: what lamps out of sight are granted beforehand

_GREY_SHARE = 0.5  # of surfaces
_GREY_SURFACES = 64.0  # they scatter by an eighth of what others do


def surface_shares(surfaces: FloatArray, lamps: Lamps, flux: FloatArray) -> FloatArray:
    """Return the mixture of lamps on the surfaces in each cell, shape [rows, columns, K].

    Args:
        surfaces: Chromaticity times luminance, and luminance, shape [rows, columns, 3].
        lamps: The classes.
        flux: What share of all light comes straight from each class, shape [K].
    """
    rows, columns, _ = surfaces.shape
    mixtures = _mixtures(len(lamps.names))
    if not surfaces[..., 2].max() > 0.0:
        return np.full((rows, columns, len(lamps.names)), 1.0 / len(lamps.names))
    odds = _neighbourhood_odds(surfaces, mixtures, lamps, flux)
    color = _mean_color(surfaces)
    shares = np.empty((rows, columns, len(lamps.names)))
    for block in row_blocks(rows):
        around = spread(odds, block, rows, columns)
        likely = _likelihood(color[block], mixtures, lamps) * around
        likely = np.where(surfaces[block][..., 2:] > 0.0, likely, around)
        shares[block] = likely @ mixtures / likely.sum(axis=-1, keepdims=True)
    return shares


def _likelihood(color: FloatArray, mixtures: FloatArray, lamps: Lamps) -> FloatArray:
    """Return how well mixtures explain the chromaticity of a surface, up to a factor.

    Args:
        color: Chromaticities, shape [..., 2].
        mixtures: Shape [count, K].
        lamps: The classes.

    Returns:
        Shape [..., count].
    """
    light = chromaticity(mixtures @ lamps.camera_values)
    grey = _GREY_SURFACES * squared_distance(color, light, lamps)
    colored = squared_distance(color, light + lamps.surface_mean, lamps)
    colored_share = (1.0 - _GREY_SHARE) * np.exp(-0.5 * colored)
    # A density in two dimensions is the higher the less it scatters.
    return np.asarray(_GREY_SHARE * _GREY_SURFACES * np.exp(-0.5 * grey) + colored_share + 1e-30)


def _neighbourhood_odds(
    surfaces: FloatArray, mixtures: FloatArray, lamps: Lamps, flux: FloatArray
) -> FloatArray:
    """Return the odds of mixtures around, shape [meeting_rows, meeting_columns, count]."""
    rows, columns, _ = surfaces.shape
    shape = min(_MEETING_ROWS, rows), min(2 * _MEETING_ROWS, columns)
    sums = np.zeros((*shape, 3))
    add_cells(sums, surfaces, slice(0, rows), rows)
    color = _mean_color(smooth(sums, _SURFACE_RADIUS))
    size = texel_solid_angles(*shape)[:, None, None]
    world = (color * size).sum(axis=(0, 1)) / (shape[1] * size.sum())

    expected = chromaticity(mixtures @ lamps.camera_values) + lamps.surface_mean
    prior = flux + (1.0 - flux.sum()) * _plain_shares(sums, lamps) + _UNSEEN_FLUX / len(flux)
    odds = _odds(world, _WORLD_SURFACES, prior / prior.sum(), mixtures, expected, lamps)
    return _odds(color, _NEAR_SURFACES, odds @ mixtures, mixtures, expected, lamps)


def _mean_color(sums: FloatArray) -> FloatArray:
    """Return the mean chromaticity of sums like those of ``_Sums.surfaces``."""
    known = sums[..., 2:]
    return np.asarray(sums[..., :2] / np.maximum(known, 1e-9 * known.max()))


def _plain_shares(sums: FloatArray, lamps: Lamps) -> FloatArray:
    """Return what share of surfaces' light has just the chromaticity of each lamp, shape [K]."""
    distance = _PLAIN_SURFACES * squared_distance(_mean_color(sums), lamps.chromaticities, lamps)
    likeness = np.exp(-0.5 * distance)
    of_class = likeness * normalized(-0.5 * distance)
    return np.asarray(np.einsum("ij,ijk->k", sums[..., 2], of_class) / sums[..., 2].sum())


def _mixtures(class_count: int) -> FloatArray:
    """Return shares of the classes, evenly over all mixtures, shape [count, K]."""
    steps = max(n for n in range(2, 41) if n == 2 or comb(n + class_count - 1, n) <= _MOST_MIXTURES)
    parts = combinations_with_replacement(range(class_count), steps)
    counts = [np.bincount(part, minlength=class_count) for part in parts]
    return np.asarray(counts, dtype=np.float64) / steps


def _odds(
    color: FloatArray,
    surface_count: float,
    prior: FloatArray,
    mixtures: FloatArray,
    expected: FloatArray,
    lamps: Lamps,
) -> FloatArray:
    """Return how likely mixtures explain a mean chromaticity of surfaces.

    The mean of n surfaces scatters by their covariance over n. Beforehand mixtures scatter about
    the prior by Pearson's chi-squared, so that a lamp that is not there stays away.

    Args:
        color: Mean chromaticities, shape [..., 2].
        surface_count: n, how many independent surfaces they are worth.
        prior: The mixture expected beforehand, shape [K].
        mixtures: All that are considered, shape [count, K].
        expected: Chromaticity of surfaces in their light, shape [count, 2].
        lamps: The classes.

    Returns:
        Probabilities, shape [..., count].
    """
    distance = surface_count * squared_distance(color, expected, lamps)
    distance += _PRIOR_SURFACES * ((mixtures - prior) ** 2 / prior).sum(axis=-1)
    return normalized(-0.5 * distance)


def squared_distance(color: FloatArray, expected: FloatArray, lamps: Lamps) -> FloatArray:
    """Return squared Mahalanobis distances in the scatter of surfaces, shape [..., count]."""
    whitening = np.linalg.cholesky(np.linalg.inv(lamps.surface_covariance))
    away = (color @ whitening)[..., None, :] - expected @ whitening
    return np.asarray((away**2).sum(axis=-1))


def normalized(logarithm: FloatArray) -> FloatArray:
    """Return probabilities along the last axis, of logarithms known up to a constant."""
    odds = np.exp(logarithm - logarithm.max(axis=-1, keepdims=True))
    return np.asarray(odds / odds.sum(axis=-1, keepdims=True))
