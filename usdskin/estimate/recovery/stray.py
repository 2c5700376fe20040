"""Find the light that a lens spread evenly over a chart, and take it away.

Glare adds a constant to the camera values of all patches: a fifth of a percent of white is a tenth
of what a black patch gives. Among spectra that the meter read without it, it is what a multiple of
them cannot explain.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.recovery.responsivity import estimate_responsivity
from usdskin.estimate.recovery.training import Training

FloatArray = NDArray[np.float64]

_ROUNDS = 6
_SURE = 3.0  # standard errors
_PARAMETERS = 10  # about what a responsivity has, and the offset
_MOST_OF_DARKEST = 0.5


def without_stray_light(
    trainings: Sequence[Training],
) -> tuple[tuple[Training, ...], tuple[FloatArray, ...]]:
    """Return charts without their stray light, and what it was.

    ``P = Lambda t + b`` by turns: t of all charts, then b of each chart and channel from the line
    through its camera values over ``Lambda t``. b may be negative, where a black level was set too
    high. What is within three standard errors of nothing is nothing.

    Args:
        trainings: Charts of one camera on one grid, their signals in one unit.

    Returns:
        The charts, and b of each in the unit of rho, shape [3].

    Raises:
        ValueError: As ``estimate_responsivity`` does.
    """
    charts = tuple(trainings)
    stray = [np.zeros(3) for _ in charts]
    for _ in range(_ROUNDS):
        t = estimate_responsivity(charts).values
        stray = [_offset(each, each.signals @ t) for each in trainings]
        charts = tuple(
            replace(each, camera_values=each.camera_values - offset)
            for each, offset in zip(trainings, stray, strict=True)
        )
        if not any(offset.any() for offset in stray):
            break
    return charts, tuple(stray)


def _offset(training: Training, expected: FloatArray) -> FloatArray:
    """Return where the line of camera values over expected ones meets nothing, shape [3]."""
    values = training.camera_values
    count = len(values)
    if count <= _PARAMETERS:
        return np.zeros(3)
    errors = training.errors(values.max(axis=0))
    found = np.zeros(3)
    for channel in range(3):
        weight = 1.0 / errors[:, channel]
        design = np.stack([expected[:, channel], np.ones(count)], axis=1) * weight[:, None]
        target = values[:, channel] * weight
        inverse = np.linalg.pinv(design.T @ design)
        slope, offset = inverse @ (design.T @ target)
        left = target - design @ (slope, offset)
        deviation = np.sqrt(inverse[1, 1] * (left @ left) / (count - _PARAMETERS))
        if abs(offset) > _SURE * deviation:
            found[channel] = min(offset, _MOST_OF_DARKEST * values[:, channel].min())
    return found
