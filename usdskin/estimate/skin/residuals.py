"""Is what a fit leaves noise, or does it have a shape that the model does not?"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_LEAST_READINGS = 8
_LARGEST_BINS = 12
_SIGNIFICANT = 4.0
_SHARE = 0.005
"""Of the peak; a shape smaller than this is not worth a word."""


@dataclass(frozen=True, slots=True)
class Structure:
    """How residuals run over the angle of the light."""

    autocorrelation: float
    """Of residuals next to each other in N.L, averaged over the channels [1]."""

    significance: float
    """The same in its standard deviations under pure noise [1]."""

    largest_share: float
    """Largest mean residual of a range of angles, as a share of the channel's peak [1]."""

    at_deg: float
    """Middle of that range [deg]."""

    @property
    def is_there(self) -> bool:
        """Whether the model misses a shape beyond doubt, and one of a size that matters."""
        return self.significance > _SIGNIFICANT and abs(self.largest_share) > _SHARE


def structure_of(residuals: FloatArray, sigma: FloatArray, theta_deg: FloatArray,
                 peak: FloatArray) -> Structure:  # fmt: skip
    """Return how the residuals of a fit run over the angle.

    The serial correlation of J. von Neumann (1941) in the order of the angle: under noise its
    standard deviation is 1/sqrt(n).

    Args:
        residuals: Readings minus model, shape [q, c].
        sigma: Standard deviations, shape [q, c].
        theta_deg: Angles between normal and light [deg], shape [q].
        peak: Largest value of each channel, shape [c].
    """
    order = np.argsort(theta_deg, kind="stable")
    count = len(order)
    if count < _LEAST_READINGS:
        return Structure(0.0, 0.0, 0.0, 0.0)
    whitened = (residuals / sigma)[order]
    power = (whitened**2).sum(axis=0)
    products = (whitened[1:] * whitened[:-1]).sum(axis=0)
    correlation = float((products / np.maximum(power, 1e-300)).mean())
    independent = np.sqrt(count * _independent_channels(whitened))
    shares = (residuals / peak)[order]
    pieces = np.array_split(np.arange(count), min(_LARGEST_BINS, max(count // 3, 1)))
    means = np.array([shares[piece].mean(axis=0) for piece in pieces])
    piece, channel = np.unravel_index(int(np.argmax(np.abs(means))), means.shape)
    angle = float(theta_deg[order][pieces[piece]].mean())
    return Structure(correlation, correlation * independent, float(means[piece, channel]), angle)


def _independent_channels(whitened: FloatArray) -> float:
    """Return how many channels' worth of independent noise there is: (sum v)^2 / sum v^2."""
    size = np.linalg.svd(whitened, compute_uv=False) ** 2
    return float(size.sum() ** 2 / max(float((size**2).sum()), 1e-300))
