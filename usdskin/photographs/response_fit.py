"""Fit the inverse response of one channel to the same pixels in several exposures.

g = ln(exposure) over the raw value and the light of every pixel are the most likely ones, given
that g is smooth. Where Debevec and Malik ("Recovering High Dynamic Range Radiance Maps from
Photographs", SIGGRAPH 1997) compare logarithms, here raw values are compared with those that g
predicts: their noise is even, while noise in a logarithm favours curves with steps. What is far
off, such as a moved object, has no say (Tukey's biweight).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_USABLE = (0.015, 0.99)
"""Share of the way from black to white between which a raw value is neither noise nor clipped."""

_TOE, _SHOULDER = 0.5 / 255.0, 0.1
_KNOT_COUNT = 96
_STIFFNESS = (0.003, 0.03, 0.1)
"""Typical third derivative of ln(exposure) over ``_place`` [1]: at first, while outliers are found,
and in the end. Larger ones let the curve ripple with the step of the exposures, which the pictures
do not tell from the truth."""

_ROUNDS, _WARM_UP = 80, 8
_CONVERGED = 5e-4
_HUBER, _TUKEY = 1.345, 4.685  # 95 % efficient where noise is normal (Holland and Welsch 1977)
_MAD = 1.4826  # standard deviation of normal noise over its median absolute deviation
_LEAST_NOISE = 0.1 / 255.0
_LEAST_STEP = 1e-6  # of g from knot to knot


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A fitted curve."""

    curve: FloatArray
    """g at the knots, ascending, 0 near the middle, shape [knot_count]."""

    noise: float
    """Standard deviation of the raw values from what is predicted, from black (0) to white (1)."""

    agreeing: float
    """Share of the raw values that are not far off [1]."""

    def log_exposure(self, share: FloatArray) -> FloatArray:
        """Return g at shares of the way from black to white."""
        return np.interp(_place(share), _KNOTS, self.curve)


def is_usable(share: NDArray[Any]) -> NDArray[np.bool_]:
    """Tell where raw values, from black (0) to white (1), are neither noise nor saturated."""
    return np.asarray((share > _USABLE[0]) & (share < _USABLE[1]))


def fit_curve(samples: FloatArray, log_exposure: FloatArray) -> Fit:
    """Fit g.

    Args:
        samples: Raw values from black (0) to white (1), each pixel usable in two pictures or more,
            shape [image_count, pixel_count].
        log_exposure: ln(exposure) of every picture, shape [image_count].
    """
    offset = np.broadcast_to(log_exposure[:, None], samples.shape)
    weight = np.where(is_usable(samples), samples * (1.0 - samples), 0.0)
    curve, light = _solve(_roughness(_STIFFNESS[0]), _place(samples), weight, offset)
    curve, noise, agreeing = _ascending(curve), np.inf, 0.0
    for turn in range(_ROUNDS):
        place = np.interp(light + offset, curve, _KNOTS)
        predicted = _share(place)
        is_seen = is_usable(predicted)
        if not is_seen.any():
            return Fit(curve, np.inf, 0.0)
        misfit = samples - predicted
        noise = max(_MAD * float(np.median(np.abs(misfit[is_seen]))), _LEAST_NOISE)
        is_warm = turn >= _WARM_UP
        trust = (_tukey if is_warm else _huber)(misfit / noise)
        agreeing = float(np.mean(trust[is_seen] > 0.0))
        slope = np.interp(place, _KNOTS, np.gradient(curve, _KNOTS)) * _place_slope(predicted)
        # Newton's step: what the curve had to be for the prediction to be right.
        weight = np.where(is_seen, trust / (noise * slope) ** 2, 0.0)
        penalty = _roughness(_STIFFNESS[1 + is_warm])
        before = curve
        curve, light = _solve(penalty, place, weight, offset - misfit * slope)
        curve = _ascending(curve)
        if is_warm and np.abs(curve - before)[_USABLE_KNOTS].max() < _CONVERGED:
            break
    return Fit(curve, noise, agreeing)


def _huber(deviation: FloatArray) -> FloatArray:
    return np.asarray(1.0 / np.maximum(np.abs(deviation) / _HUBER, 1.0))


def _tukey(deviation: FloatArray) -> FloatArray:
    return np.asarray(np.maximum(1.0 - (deviation / _TUKEY) ** 2, 0.0) ** 2)


def _ascending(curve: FloatArray) -> FloatArray:
    steps = _LEAST_STEP * np.arange(len(curve))
    return np.asarray(np.maximum.accumulate(curve - steps) + steps)


def _place(share: FloatArray) -> FloatArray:
    """Return the coordinate over which g is smooth, of a share of the way from black to white.

    The curves of cameras are nearly straight over its first term below middle gray, and bend with
    the second above it.
    """
    share = np.clip(share, 0.0, 1.0)
    return np.asarray(np.log(share + _TOE) - np.log(1.0 + _SHOULDER - share))


def _share(place: FloatArray) -> FloatArray:
    ratio = np.exp(place)
    return np.asarray(((1.0 + _SHOULDER) * ratio - _TOE) / (1.0 + ratio))


def _place_slope(share: FloatArray) -> FloatArray:
    return np.asarray(1.0 / (share + _TOE) + 1.0 / (1.0 + _SHOULDER - share))


_FIRST, _LAST = (float(end) for end in _place(np.array([0.0, 1.0])))
_KNOTS = np.linspace(_FIRST, _LAST, _KNOT_COUNT)
_USABLE_KNOTS = is_usable(_share(_KNOTS))


def _roughness(stiffness: float) -> FloatArray:
    """Return the penalty on the third derivative of g, shape [knot_count, knot_count]."""
    step = _KNOTS[1] - _KNOTS[0]
    rows = np.diff(np.eye(_KNOT_COUNT), n=3, axis=0) * step**-2.5 / stiffness
    return np.asarray(rows.T @ rows)


def _solve(
    penalty: FloatArray, place: FloatArray, weight: FloatArray, target: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Minimise ``sum weight (g(place) - light - target)^2`` plus the penalty on g.

    The light of the pixels is eliminated (Schur complement), and g is 0 in the middle.

    Args:
        penalty: Quadratic form in g, shape [knot_count, knot_count].
        place: Where g is read, shape [image_count, pixel_count].
        weight: Weights, shape [image_count, pixel_count].
        target: Targets, shape [image_count, pixel_count].

    Returns:
        g, shape [knot_count], and light, shape [pixel_count].
    """
    count = len(penalty)
    steps = (place - _KNOTS[0]) / (_KNOTS[1] - _KNOTS[0])
    low = np.clip(steps.astype(np.intp), 0, count - 2)
    # One row for each of the two knots around each place, so twice as many rows as images.
    knot = np.concatenate([low, low + 1])
    share = np.concatenate([low + 1.0 - steps, steps - low])
    part = np.concatenate([weight, weight]) * share
    total = np.maximum(weight.sum(axis=0), 1e-300)
    mean_target = (weight * target).sum(axis=0) / total
    right = _summed(knot, part * np.tile(target - mean_target, (2, 1)), count)
    sums = penalty.ravel().copy()
    half = len(low)
    for row in range(2 * half):
        sums -= _summed(knot[row] * count + knot, part[row] / total * part, count**2)
        for other in (row % half, row % half + half):
            sums += _summed(knot[row] * count + knot[other], part[row] * share[other], count**2)
    normal = sums.reshape(count, count)
    normal[count // 2, count // 2] += np.trace(normal)
    curve = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
    return curve, (part * curve[knot]).sum(axis=0) / total - mean_target


def _summed(index: NDArray[np.intp], values: FloatArray, count: int) -> FloatArray:
    return np.asarray(np.bincount(index.ravel(), values.ravel(), count), dtype=np.float64)
