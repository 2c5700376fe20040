"""The time a renderer takes to a given error: by running it near the answer, not by formulas.

Errors are relative RMSE to a converged picture, over the pixels that show nothing but skin. The
converged picture is the mean of many seeds; what its own noise adds is measured and taken off.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

NEAR = 0.06
"""How far from the target an error may be for the run to count as near."""

RUNS = 6
"""Most settings that are tried for one answer."""


@dataclass(frozen=True, slots=True)
class Reference:
    """A converged picture."""

    mean: NDArray[np.float64]
    """Over the skin's pixels, shape [pixels, channels]."""

    variance: float
    """Mean square of its noise that is left."""

    skin: NDArray[np.bool_]
    """Which pixels of a picture these are, shape [height, width]."""


@dataclass(frozen=True, slots=True)
class Found:
    """One setting that was run."""

    effort: float
    """Samples per pixel, or whatever the setting is; the error falls with it."""

    error: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Crossing:
    """Where the error is the target."""

    seconds: float
    effort: float
    runs: tuple[Found, ...]

    nearest: float
    """Error of the nearest run over the target."""

    @property
    def is_run(self) -> bool:
        """Whether a run came near, or the figure is extrapolated."""
        return abs(self.nearest - 1.0) <= 2.0 * NEAR


def skin_of(alpha: NDArray) -> NDArray[np.bool_]:
    """Return the pixels that skin fills, and all eight around them too, shape [height, width]."""
    full = np.pad(alpha >= 1.0 - 1e-6, 1)
    height, width = alpha.shape
    kept = np.ones((height, width), bool)
    for row in range(3):
        for column in range(3):
            kept &= full[row : row + height, column : column + width]
    return kept


def reference(pictures: NDArray, skin: NDArray[np.bool_]) -> Reference:
    """Return the mean of pictures that differ by their seed, shape [seeds, rows, columns, 3]."""
    seen = pictures[:, skin, :3].astype(np.float64)
    return Reference(seen.mean(axis=0), float(seen.var(axis=0, ddof=1).mean()) / len(seen), skin)


def error(pictures: NDArray, truth: Reference) -> float:
    """Return the relative RMSE of one of several pictures, shape [seeds, rows, columns, 3]."""
    seen = pictures[:, truth.skin, :3].astype(np.float64)
    square = float(((seen - truth.mean) ** 2).mean()) - truth.variance
    return math.sqrt(max(square, 0.0)) / float(truth.mean.mean())


def bias(pictures: NDArray, truth: Reference) -> tuple[float, float]:
    """Return the mean error, and the relative RMSE that no number of samples would take away."""
    seen = pictures[:, truth.skin, :3].astype(np.float64)
    apart = seen.mean(axis=0) - truth.mean
    noise = float(seen.var(axis=0, ddof=1).mean()) / len(seen) + truth.variance
    left = math.sqrt(max(float((apart**2).mean()) - noise, 0.0))
    return float(apart.mean() / truth.mean.mean()), left / float(truth.mean.mean())


def band_noise(spectra: NDArray) -> float:
    """Return the relative RMSE of one band by the scatter over seeds, the mean over bands.

    Args:
        spectra: Of skin alone, shape [seeds, rows, columns, bands].
    """
    variance = spectra.var(axis=0, ddof=1, dtype=np.float64).mean(axis=(0, 1))
    return float((np.sqrt(variance) / spectra.mean(axis=(0, 1, 2), dtype=np.float64)).mean())


def crossing(
    run: Callable[[float], Found],
    target: float,
    first: float,
    snap: Callable[[float], float],
) -> Crossing:
    """Find the time at which the error is ``target``.

    Args:
        run: Renders with an effort.
        target: Wanted error.
        first: Effort to begin with.
        snap: Returns the nearest effort there is.
    """
    runs: list[Found] = []
    effort = snap(first)
    for _ in range(RUNS):
        found = run(effort)
        runs.append(found)
        if abs(found.error / target - 1.0) <= NEAR:
            break
        power = _power(runs, target)
        near = _nearest(runs, target)[0]
        step = (near.error / target) ** (1.0 / power)
        effort = snap(near.effort * min(max(step, 1.0 / 32.0), 32.0))
        if any(abs(effort / other.effort - 1.0) < 0.02 for other in runs):
            break
    near = _nearest(runs, target)[0]
    step = (near.error / target) ** (1.0 / _power(runs, target))
    return Crossing(
        near.seconds * step ** _growth(runs, target),
        near.effort * step,
        tuple(runs),
        near.error / target,
    )


def _nearest(runs: list[Found], target: float) -> list[Found]:
    return sorted(runs, key=lambda found: abs(math.log(found.error / target)))[:2]


def _power(runs: list[Found], target: float) -> float:
    """Return p of error ~ effort^-p around the target; 0.6 until two runs tell."""
    pair = _nearest(runs, target)
    if len(pair) < 2 or pair[0].effort == pair[1].effort:
        return 0.6
    slope = -math.log(pair[0].error / pair[1].error) / math.log(pair[0].effort / pair[1].effort)
    return min(max(slope, 0.3), 1.5)


def _growth(runs: list[Found], target: float) -> float:
    """Return q of seconds ~ effort^q around the target; 1 until two runs tell."""
    pair = _nearest(runs, target)
    if len(pair) < 2 or abs(math.log(pair[0].effort / pair[1].effort)) < 0.05:
        return 1.0
    rise = math.log(pair[0].seconds / pair[1].seconds)
    return min(max(rise / math.log(pair[0].effort / pair[1].effort), 0.0), 1.2)
