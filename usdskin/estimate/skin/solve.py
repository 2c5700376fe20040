"""Weighted least squares: a scan over l with a closed form inside, then descent in all numbers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.model import (
    Coefficients,
    Freedom,
    SkinModel,
    lambert_kernel,
    wrap_kernel,
)
from usdskin.estimate.skin.readings import Readings

FloatArray = NDArray[np.float64]

SCAN = np.linspace(0.0, 1.0, 60)
"""Values of l tried [1]."""

_DELTAS = (0.0, 30.0, 100.0, 300.0, 1000.0, 3000.0)
"""Opacities tried first [m^-1]: 1/delta from 3 cm to 0.3 mm."""

_STEPS = 80
_DONE = 1e-11
_EXACT = 1e-20


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """Where a descent ended."""

    coefficients: Coefficients
    """All numbers."""

    cost: float
    """Sum of weighted squared residuals [1]."""


def solve(
    readings: Readings, freedom: Freedom, fixed: Coefficients, weights: FloatArray
) -> Solution:
    """Return the least-squares solution without lobes, or with those of ``fixed``.

    Variable projection (G. H. Golub and V. Pereyra, SIAM J. Numer. Anal. 10(2), 1973): for each
    of 60 l the non-negative A and B in closed form; then Levenberg and Marquardt in everything.

    Args:
        readings: All of them are used.
        freedom: Which numbers are free; ``lobes`` must be 0.
        fixed: What is not free; its A and B do not matter.
        weights: Of the squared residuals, shape [q, c].
    """
    model = SkinModel(readings, freedom)
    wraps = SCAN if freedom.wrap else np.array([fixed.wrap])
    starts = []
    for delta in _DELTAS if freedom.delta else (None,):
        opacity = fixed.delta if delta is None else np.full(model.channels, delta)
        starts.append(scan(readings, replace(fixed, delta=opacity), freedom, weights, wraps))
    # Several opacities explain little data about as well; descend from the best two.
    starts.sort(key=lambda start: start.cost)
    ends = [descend(model, start.coefficients, readings.values, weights) for start in starts[:2]]
    return min(ends, key=lambda end: end.cost)


@dataclass(frozen=True, slots=True, eq=False)
class Conditional:
    """The best A and B for each of some l."""

    wraps: FloatArray
    """l [1], shape [s]."""

    lambert: FloatArray
    """A [1], shape [s, c]."""

    wrapped: FloatArray
    """B [1], shape [s, c]."""

    costs: FloatArray
    """Sum of weighted squared residuals [1], shape [s]."""

    normal: FloatArray
    """Normal equations of A and B, shape [s, c, 2, 2]."""


def conditional(
    readings: Readings,
    at: Coefficients,
    freedom: Freedom,
    weights: FloatArray,
    wraps: FloatArray,
) -> Conditional:
    """Return the non-negative A and B that are best for each l, in closed form.

    Args:
        readings: All of them are used.
        at: The other numbers: lobes and delta.
        freedom: Whether B is free.
        weights: Of the squared residuals, shape [q, c].
        wraps: l to try [1], shape [s].
    """
    model = SkinModel(readings, replace(freedom, lobes=0))
    values = readings.values - model.shine(at)[:, None]
    passed = np.broadcast_to(model.passed(at), values.shape)
    squared, crossed = weights * passed**2, weights * passed * values
    direct = lambert_kernel(readings.cosine)
    wrapped = wrap_kernel(readings.cosine, wraps[:, None])
    n12, n22 = (wrapped * direct) @ squared, (wrapped**2) @ squared
    n11 = np.broadcast_to((direct**2) @ squared, n12.shape)
    b1, b2 = np.broadcast_to(direct @ crossed, n12.shape), wrapped @ crossed
    if freedom.scattering is None:
        a, b = _two_non_negative(n11, n12, n22, b1, b2)
    else:
        known = freedom.scattering
        size = n11 + 2.0 * known * n12 + known**2 * n22
        a = np.maximum(b1 + known * b2, 0.0) / np.maximum(size, 1e-300)
        b = known * a
    costs = (weights * values**2).sum() - (a * b1 + b * b2).sum(axis=1)
    normal = np.stack([np.stack([n11, n12], -1), np.stack([n12, n22], -1)], -2)
    return Conditional(wraps, a, b, costs, normal)


def scan(
    readings: Readings,
    at: Coefficients,
    freedom: Freedom,
    weights: FloatArray,
    wraps: FloatArray,
) -> Solution:
    """Return the best of some l, with the A and B that are best for it; see ``conditional``."""
    tried = conditional(readings, at, freedom, weights, wraps)
    best = int(np.argmin(tried.costs))
    found = replace(
        at, wrap=float(wraps[best]), lambert=tried.lambert[best], wrapped=tried.wrapped[best]
    )
    return Solution(found, float(tried.costs[best]))


def _two_non_negative(
    n11: FloatArray, n12: FloatArray, n22: FloatArray, b1: FloatArray, b2: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the non-negative solutions of 2 x 2 normal equations, shapes [s, c] each."""
    determinant = n11 * n22 - n12**2
    regular = determinant > 1e-12 * n11 * n22
    safe = np.where(regular, determinant, 1.0)
    a = (n22 * b1 - n12 * b2) / safe
    b = (n11 * b2 - n12 * b1) / safe
    alone_a = np.maximum(b1, 0.0) / np.maximum(n11, 1e-300)
    alone_b = np.maximum(b2, 0.0) / np.maximum(n22, 1e-300)
    inside = regular & (a >= 0.0) & (b >= 0.0)
    prefers_a = alone_a * b1 >= alone_b * b2
    return (
        np.asarray(np.where(inside, a, np.where(prefers_a, alone_a, 0.0))),
        np.asarray(np.where(inside, b, np.where(prefers_a, 0.0, alone_b))),
    )


def descend(
    model: SkinModel, start: Coefficients, values: FloatArray, weights: FloatArray
) -> Solution:
    """Return where the descent of K. Levenberg (1944) and D. W. Marquardt (1963) ends.

    Steps are cut at the bounds; a number that is held there by the slope stays out of the step.

    Args:
        model: At the readings' geometry.
        start: Where to begin, and what is fixed.
        values: The readings, shape [q, c].
        weights: Of the squared residuals, shape [q, c].
    """
    low, high = model.bounds()
    x = np.clip(model.pack(start), low, high)
    at = model.unpack(x, start)
    residuals = values - model.values(at)
    cost, damping = float((weights * residuals**2).sum()), 1e-3
    exact = _EXACT * float((weights * values**2).sum())
    for _ in range(_STEPS):
        normal, slope = normal_equations(model, at, weights, residuals)
        free = ~(((x <= low) & (slope < 0.0)) | ((x >= high) & (slope > 0.0)))
        free &= normal.diagonal() > 0.0
        if not free.any():
            break
        gained = 0.0
        while damping < 1e9:
            step = _damped_step(normal, slope, free, damping)
            if float(step @ slope) <= _DONE * cost:
                break
            moved = np.clip(x + step, low, high)
            there = model.unpack(moved, start)
            left = values - model.values(there)
            reached = float((weights * left**2).sum())
            if reached < cost:
                gained, x, at, residuals, cost = cost - reached, moved, there, left, reached
                damping = max(0.1 * damping, 1e-12)
                break
            damping *= 10.0
        if gained <= _DONE * cost or cost <= exact:
            break
    return Solution(at, cost)


def _damped_step(
    normal: FloatArray, slope: FloatArray, free: NDArray[np.bool_], damping: float
) -> FloatArray:
    scale = 1.0 / np.sqrt(normal.diagonal()[free])
    part = normal[np.ix_(free, free)] * scale[:, None] * scale
    part[np.diag_indices_from(part)] += damping
    step = np.zeros(slope.size)
    step[free] = scale * np.linalg.solve(part, scale * slope[free])
    return step


def normal_equations(
    model: SkinModel,
    at: Coefficients,
    weights: FloatArray,
    residuals: FloatArray,
    wrap_step: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Return ``J^T W J`` and ``J^T W r`` over all free numbers, shapes [p, p] and [p].

    Channels share only l and the lobes, so the sums are taken channel by channel. ``wrap_step`` is
    that of ``SkinModel.jacobian``.
    """
    columns = np.moveaxis(model.jacobian(at, wrap_step), 1, 0)  # [c, q, m + k]
    weighted = columns * weights.T[:, :, None]
    blocks = np.swapaxes(weighted, 1, 2) @ columns
    slopes = (weighted * residuals.T[:, :, None]).sum(axis=1)
    index = model.index()
    count = len(model.parameter_names)
    normal, slope = np.zeros((count, count)), np.zeros(count)
    np.add.at(normal, (index[:, :, None], index[:, None, :]), blocks)
    np.add.at(slope, index, slopes)
    return normal, slope
