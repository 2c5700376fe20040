"""Estimate the camera's responsivity: never negative, and as smooth as the chart lets it be."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.recovery.training import DARKNESS, Training, channel_scale

FloatArray = NDArray[np.float64]

SMOOTHNESS_WEIGHTS = np.logspace(-7.0, 3.0, 11)
"""Weights of the second difference tried, in units that the chart's own weight makes 1."""

_UNIT_ROUNDS = 3


@dataclass(frozen=True, slots=True, eq=False)
class Responsivity:
    """How a camera answers to every wavelength, so that ``P = Lambda @ values``."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""

    values: FloatArray
    """t, camera value per radiance, the band width absorbed in it, shape [n, 3]."""

    residual: FloatArray
    """Root mean square of ``(P - Lambda t) / P`` over all patches, dark and poor ones counting
    less [1], shape [3]."""

    noise: FloatArray
    """Relative standard deviation of a camera value [1], shape [3]: about ``Lambda t``, freed
    of the fit's degrees of freedom, or as the charts state it where that is more."""

    smoothness: FloatArray
    """Weight of the second difference that leave-one-out chose, per channel, shape [3]."""

    gain: FloatArray
    """How far t moves per relative error of a patch, for leaving patches out: the inverse of the
    normal equations on the bands above zero, per channel, shape [3, n, n]. Zeros where t is known
    rather than fitted."""

    @classmethod
    def known(cls, wavelength_nm: FloatArray, values: FloatArray) -> Responsivity:
        """Return a responsivity measured elsewhere, which leaving patches out does not change.

        Args:
            wavelength_nm: Band centres [nm], shape [n].
            values: t, camera value per radiance in a band, shape [n, 3].
        """
        wavelengths = np.asarray(wavelength_nm, dtype=np.float64)
        zeros = np.zeros(3)
        gain = np.zeros((3, wavelengths.size, wavelengths.size))
        return cls(wavelengths, np.asarray(values, dtype=np.float64), zeros, zeros, zeros, gain)

    def without_each(self, training: Training) -> FloatArray:
        """Return t as it were without each of the patches it was fitted to.

        Exact for a fit whose bands at zero stay there: the normal equations minus one row
        (Sherman and Morrison, 1950).

        Args:
            training: One of the trainings that t was fitted to.

        Returns:
            One t per patch, shape [m, n, 3].
        """
        relative, targets = relative_rows(training)
        result = np.repeat(self.values[None], len(training.patches), axis=0)
        for channel in range(3):
            rows = relative[channel]
            moved = rows @ self.gain[channel]
            leverage = np.minimum((moved * rows).sum(axis=1), 1.0 - 1e-9)
            error = targets[channel] - rows @ self.values[:, channel]
            result[:, :, channel] -= moved * (error / (1.0 - leverage))[:, None]
        return result


def relative_rows(training: Training) -> tuple[FloatArray, FloatArray]:
    """Return signals and camera values divided by the camera value's error, per channel.

    Args:
        training: One chart.

    Returns:
        Rows, shape [3, m, n], and targets, shape [3, m], in units in which every camera value has
        the same error.
    """
    values = training.camera_values
    error = training.errors(values.max(axis=0)).T
    return training.signals[None] / error[:, :, None], values.T / error


def second_difference(wavelength_nm: FloatArray) -> FloatArray:
    """Return the second derivative's operator on a grid, its mean spacing as the unit.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, at least three, shape [n].

    Returns:
        D, such that ``D @ values`` is the second divided difference, shape [n - 2, n].
    """
    steps = np.diff(wavelength_nm) / np.diff(wavelength_nm).mean()
    count = wavelength_nm.size
    operator = np.zeros((count - 2, count))
    rows = np.arange(count - 2)
    before, after = steps[:-1], steps[1:]
    operator[rows, rows] = 2.0 / (before * (before + after))
    operator[rows, rows + 1] = -2.0 / (before * after)
    operator[rows, rows + 2] = 2.0 / (after * (before + after))
    return operator


def estimate_responsivity(trainings: Sequence[Training]) -> Responsivity:
    """Estimate t from one chart, or jointly from the same camera's charts in several lights.

    Minimises ``|(P - Lambda t) / sigma|^2 + w |D t|^2`` subject to ``t >= 0`` for every channel,
    D the second difference: non-negative least squares (C. L. Lawson and R. J. Hanson, "Solving
    Least Squares Problems", 1974) with the smoothness prior customary since K. Barnard and B.
    Funt, "Camera characterization for color research", Color Res. Appl. 27(3), 2002. sigma is
    proportional to the camera value, or the patch's own where that is larger. w is the one with
    the least leave-one-out error.

    Args:
        trainings: Charts on one grid, their signals in one unit.

    Returns:
        The estimate, with its residual.

    Raises:
        ValueError: There is no chart, the grids differ, or a channel comes out zero: the signals
            do not explain it.
    """
    grid = _shared_grid(trainings)
    pairs = [relative_rows(each) for each in trainings]
    rows = np.concatenate([pair[0] for pair in pairs], axis=1)
    targets = np.concatenate([pair[1] for pair in pairs], axis=1)
    roughness = second_difference(grid)
    fits = _fit_channels(rows, targets, roughness)
    values = np.stack([fit.values for fit in fits], axis=-1)
    for channel, name in enumerate("RGB"):
        if not values[:, channel].any():
            raise ValueError(
                f"the signals do not explain the camera's channel {name}: its responsivity "
                "vanishes; do camera values and signals belong to the same patches?"
            )
    residual, stddev = _relative_errors(trainings, values)
    count = targets.shape[1]
    spare = np.maximum(count - np.array([fit.freedom for fit in fits]), 1.0)
    return Responsivity(
        wavelength_nm=grid,
        values=values,
        residual=residual,
        noise=np.maximum(residual * np.sqrt(count / spare), stddev),
        smoothness=np.array([fit.weight for fit in fits]),
        gain=np.stack([fit.gain for fit in fits]),
    )


def in_one_unit(trainings: Sequence[Training]) -> tuple[Training, ...]:
    """Return charts whose relative signals are brought to the unit of the first one's.

    A camera answers to all lights alike, which settles by how much each chart's signals must be
    multiplied: until ``P = Lambda t`` holds on the mean of its patches, t being estimated from
    all of them.

    Args:
        trainings: Charts of one camera, each with signals and light in a unit of its own.

    Returns:
        The charts, signals and light scaled.

    Raises:
        ValueError: As ``estimate_responsivity`` does.
    """
    scaled = list(trainings)
    fitted = 1
    for _ in range(_UNIT_ROUNDS if len(scaled) > 1 else 0):
        t = estimate_responsivity(scaled[:fitted]).values
        for index, each in enumerate(trainings[1:], start=1):
            expected = np.maximum(each.signals @ t, 1e-300)
            ratio = np.median(each.camera_values / expected)
            scaled[index] = replace(
                each, signals=ratio * each.signals, illuminant=ratio * each.illuminant
            )
        fitted = len(scaled)
    return tuple(scaled)


def _shared_grid(trainings: Sequence[Training]) -> FloatArray:
    if not trainings:
        raise ValueError("no chart was given")
    grid = trainings[0].wavelength_nm
    if any(not np.array_equal(each.wavelength_nm, grid) for each in trainings):
        raise ValueError("the charts must share one wavelength grid")
    for each in trainings:
        channel_scale(each.camera_values)
    return grid


def _relative_errors(
    trainings: Sequence[Training], responsivity: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the rms of ``(P - Lambda t) / error``, and the median of the deviations over P.

    Patches known to be poor count less in the first, and not at all in the second while they are
    few.
    """
    residuals, deviations = [], []
    for each in trainings:
        values = each.camera_values
        residuals.append((values - each.signals @ responsivity) / each.errors(values.max(axis=0)))
        stated = np.zeros_like(values) if each.camera_stddev is None else each.camera_stddev
        deviations.append(stated / np.maximum(values, DARKNESS * values.max(axis=0)))
    root_mean = np.sqrt((np.concatenate(residuals) ** 2).mean(axis=0))
    return root_mean, np.median(np.concatenate(deviations), axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class _ChannelFit:
    values: FloatArray
    gain: FloatArray
    weight: float
    freedom: float
    losses: FloatArray
    """Squared leave-one-out error of every patch."""


def _fit_channels(
    rows: FloatArray, targets: FloatArray, roughness: FloatArray
) -> list[_ChannelFit]:
    """Return the three fits with the weight that predicts left-out patches.

    One weight serves the three channels, and it is the largest whose error lies within one
    standard error of the least (L. Breiman et al., "Classification and Regression Trees", 1984):
    the curve is flat, and a chart of 24 patches alone would often choose a jagged t.
    """
    channels = [_Channel.of(rows[c], targets[c], roughness) for c in range(3)]
    candidates = [[each.fit(float(weight)) for each in channels] for weight in SMOOTHNESS_WEIGHTS]
    losses = np.array([np.concatenate([fit.losses for fit in fits]) for fits in candidates])
    means = losses.mean(axis=1)
    least = int(means.argmin())
    spread = losses[least].std() / np.sqrt(losses.shape[1])
    return candidates[int(np.flatnonzero(means <= means[least] + spread)[-1])]


@dataclass(frozen=True, slots=True, eq=False)
class _Channel:
    """The least-squares problem of one channel, brought to triangular form once."""

    rows: FloatArray
    targets: FloatArray
    triangle: FloatArray
    turned: FloatArray
    penalty: FloatArray

    @classmethod
    def of(cls, rows: FloatArray, targets: FloatArray, roughness: FloatArray) -> _Channel:
        orthogonal, triangle = np.linalg.qr(rows)
        scale = np.sqrt((rows**2).sum() / (roughness**2).sum())
        return cls(rows, targets, triangle, orthogonal.T @ targets, scale * roughness)

    def fit(self, weight: float) -> _ChannelFit:
        """Return the non-negative solution and how it predicts left-out patches."""
        from scipy.optimize import nnls

        design = np.concatenate((self.triangle, np.sqrt(weight) * self.penalty))
        orthogonal, triangle = np.linalg.qr(design)
        turned = orthogonal[: self.turned.size].T @ self.turned
        unit = np.abs(triangle).max()
        values, _ = nnls(triangle / unit, turned / unit, maxiter=30 * triangle.shape[1])
        free = np.flatnonzero(values > 0.0)
        gain = np.zeros((design.shape[1], design.shape[1]))
        if free.size:
            part = _triangular_inverse(np.linalg.qr(triangle[:, free])[1])
            gain[np.ix_(free, free)] = part @ part.T
        leverage = np.einsum("mi,ij,mj->m", self.rows, gain, self.rows)
        error = (self.targets - self.rows @ values) / np.maximum(1.0 - leverage, 1e-9)
        return _ChannelFit(values, gain, weight, float(leverage.sum()), error**2)


def _triangular_inverse(triangle: FloatArray) -> FloatArray:
    diagonal = np.abs(np.diagonal(triangle))
    if diagonal.min() > 1e-12 * diagonal.max():
        return np.asarray(np.linalg.inv(triangle), dtype=np.float64)
    return np.asarray(np.linalg.pinv(triangle), dtype=np.float64)
