"""Least squares that a few wrong readings do not spoil."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.covariance import Noise
from usdskin.estimate.skin.model import SkinModel
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.solve import Solution

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

Solver = Callable[[FloatArray, Solution | None], Solution]
"""Solves for given weights, from where it was before."""

_HUBER = 1.345
_TUKEY = 4.685
_OUTLIER = 4.5
"""In robust standard deviations; 1 normal reading of 150000 lies beyond."""

_SUSPECT = 4.0
_REWEIGHTINGS = 12
_NEIGHBOURS = 2
_LEAST_SCALE = 0.02
"""Of what was stated or assumed; a model that fits even better is exact."""


@dataclass(frozen=True, slots=True, eq=False)
class RobustFit:
    """A solution, and the readings it is from."""

    solution: Solution
    """The least-squares solution of the readings kept."""

    keep: Mask
    """Which readings, shape [q]."""

    sigma: FloatArray
    """Standard deviations as stated or assumed, shape [q, c]."""

    scale: float
    """What they must be multiplied by to explain the residuals [1]."""

    residuals: FloatArray
    """Readings minus model, shape [q, c]."""

    freedom: int
    """Number of values kept less that of numbers found."""

    @property
    def chi2(self) -> float:
        """Sum of squared residuals over the variances as stated or assumed."""
        return float(((self.residuals / self.sigma)[self.keep] ** 2).sum())


def fit_robustly(
    readings: Readings, model: SkinModel, solver: Solver, noise: Noise, robust: bool
) -> RobustFit:
    """Fit, leave out what lies beyond 4.5 robust standard deviations, and fit again.

    Where the first fit has suspects, the outliers are found from iteratively reweighted fits,
    first with the weights of P. J. Huber (1964), then with J. W. Tukey's biweight; the result is
    the least-squares fit of the readings left. A deviation counts as far as it exceeds that of
    readings at nearby angles: what they share is the model's fault, and is not to be hidden.

    Args:
        readings: All of them are offered.
        model: At their geometry.
        solver: Solves for weights.
        noise: Standard deviations, where readings have none.
        robust: False to keep every reading.
    """
    count = len(readings.values)
    spare = max(readings.values.size - len(model.parameter_names), 1)
    judge = _Judge(readings.theta_deg, float(np.sqrt(readings.values.size / spare)))
    sigma = _sigma(readings, noise, readings.values)
    solution = solver(1.0 / sigma**2, None)
    residuals, sigma = _residuals(readings, model, solution, noise)
    keep = np.ones(count, bool)
    if robust and np.abs(judge.deviations(residuals / sigma)).max() > _SUSPECT:
        for step in range(_REWEIGHTINGS):
            alone = judge.deviations(residuals / sigma)
            solution = solver(
                _robust_weights(alone, step < _REWEIGHTINGS // 3) / sigma**2, solution
            )
            residuals, sigma = _residuals(readings, model, solution, noise)
    for _ in range(6):
        alone = np.abs(judge.deviations(residuals / sigma)).max(axis=1)
        kept = alone <= _OUTLIER if robust else keep
        weights = np.where(kept[:, None], 1.0 / sigma**2, 0.0)
        moved = solver(weights, solution)
        settled = np.array_equal(kept, keep) and moved.cost > solution.cost * (1.0 - 1e-9)
        keep, solution = kept, moved
        residuals, sigma = _residuals(readings, model, solution, noise)
        if settled:
            break
    free = max(int(np.count_nonzero(keep)) * residuals.shape[1] - len(model.parameter_names), 1)
    chi2 = float(((residuals / sigma)[keep] ** 2).sum())
    return RobustFit(solution, keep, sigma, float(np.sqrt(chi2 / free)), residuals, free)


class _Judge:
    """Tells how far a residual is from what its neighbours say."""

    def __init__(self, theta_deg: FloatArray, correction: float) -> None:
        order = np.argsort(theta_deg, kind="stable")
        reach = min(_NEIGHBOURS, len(order) - 1)
        padded = np.pad(order, reach, mode="reflect")
        self._around = np.empty((len(order), 2 * reach + 1), np.intp)
        self._around[order] = np.lib.stride_tricks.sliding_window_view(padded, 2 * reach + 1)
        self._correction = correction

    def deviations(self, whitened: FloatArray) -> FloatArray:
        """Return deviations in robust standard deviations, shape [q, c].

        A residual deviates by what it exceeds the median of its neighbourhood and zero both.
        """
        size = 1.4826 * float(np.median(np.abs(whitened))) * self._correction
        shared = np.median(whitened[self._around], axis=1)
        low, high = np.minimum(shared, 0.0), np.maximum(shared, 0.0)
        beyond = whitened - np.clip(whitened, low, high)
        return np.asarray(beyond / max(size, _LEAST_SCALE))


def _sigma(readings: Readings, noise: Noise, values: FloatArray) -> FloatArray:
    return noise.sigma(values) if readings.stddev is None else readings.stddev


def _residuals(
    readings: Readings, model: SkinModel, solution: Solution, noise: Noise
) -> tuple[FloatArray, FloatArray]:
    values = model.values(solution.coefficients)
    return readings.values - values, _sigma(readings, noise, values)


def _robust_weights(whitened: FloatArray, huber: bool) -> FloatArray:
    size = np.maximum(np.abs(whitened), 1e-12)
    if huber:
        return np.asarray(np.minimum(1.0, _HUBER / size))
    return np.asarray(np.maximum(1.0 - (size / _TUKEY) ** 2, 0.0) ** 2)
