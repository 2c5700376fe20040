"""The middle of all l that readings allow, and the spread: an estimate that knows its error.

The readings' likelihood in l has kinks, where a reading crosses acos(-l), and often several
maxima; its median has fewer large errors than its maximum, and its spread, unlike a curvature, is
an honest error.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.model import Coefficients, Freedom
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.solve import Conditional, conditional

FloatArray = NDArray[np.float64]

_GRID = 401
_LEAST = 1e-9
"""Likelihood relative to the largest that still counts."""

_EXACT = 1e-6
"""Width of the likelihood [1] below which it is a point to the numbers' precision."""


def middle_of_likelihood(
    readings: Readings, at: Coefficients, freedom: Freedom, weights: FloatArray
) -> tuple[Coefficients, FloatArray] | None:
    """Return the median of l under its likelihood, A and B that are best for it, and their errors.

    With l equally probable in 0..1 and A, B best for each l, ``p(l) ~ exp(-chi2(l)/2)``. The
    covariance is the mean square of what all l differ by from the result, plus the mean of the
    covariances for each l.

    Args:
        readings: All of them are used.
        at: The fit; lobes and delta of it are kept.
        freedom: What is free; l must be.
        weights: Inverse variances of the values, shape [q, c].

    Returns:
        The numbers, and the covariance of wrap, A and B, shape [1 + 2c, 1 + 2c]; None where the
        readings are so exact that the likelihood is a point.
    """
    wraps = np.linspace(0.0, 1.0, _GRID)
    for _ in range(4):
        tried = conditional(readings, at, freedom, weights, wraps)
        probability = np.exp(-0.5 * (tried.costs - tried.costs.min()))
        there = np.flatnonzero(probability > _LEAST)
        first, last = max(there[0] - 1, 0), min(there[-1] + 1, _GRID - 1)
        if wraps[last] - wraps[first] < _EXACT:
            return None
        if last - first > _GRID // 2:
            break
        wraps = np.linspace(wraps[first], wraps[last], _GRID)
    probability /= probability.sum()
    middle = float(np.interp(0.5, np.cumsum(probability) - 0.5 * probability, wraps))
    best = conditional(readings, at, freedom, weights, np.array([middle]))
    found = replace(at, wrap=middle, lambert=best.lambert[0], wrapped=best.wrapped[0])
    rows = np.concatenate([wraps[:, None], tried.lambert, tried.wrapped], axis=1)
    away = rows - np.concatenate([[middle], found.lambert, found.wrapped])
    covariance = (away * probability[:, None]).T @ away + _within(tried, probability, freedom)
    return found, covariance


def _within(tried: Conditional, probability: FloatArray, freedom: Freedom) -> FloatArray:
    """Return the mean covariance of A and B for a given l, in the place of wrap, A, B."""
    channels = tried.lambert.shape[1]
    index = 1 + np.arange(channels)
    result = np.zeros((1 + 2 * channels, 1 + 2 * channels))
    if freedom.scattering is not None:
        gain = np.stack([np.ones(channels), freedom.scattering], axis=-1)  # (A, B) over A
        size = np.einsum("ci,scij,cj->sc", gain, tried.normal, gain)
        variance = probability @ (1.0 / np.maximum(size, 1e-300))
        blocks = variance[:, None, None] * gain[:, :, None] * gain[:, None, :]
    else:
        # At l = 0 both terms are one; that neither exceeds their sum bounds what is not known.
        total = np.maximum(tried.lambert + tried.wrapped, 1e-12)
        bound = (12.0 / total**2)[:, :, None, None] * np.eye(2)
        blocks = np.einsum("s,scij->cij", probability, np.linalg.inv(tried.normal + bound))
    for i, place in enumerate((index, index + channels)):
        for j, other in enumerate((index, index + channels)):
            result[place, other] = blocks[:, i, j]
    return result
