"""Estimators that know the responsivity t and state a prior on spectra: wiener and smooth.

With a prior covariance C of spectra and a noise covariance S of camera values the most probable
spectrum is ``e = C t (t^T C t + S)^-1 rho``; without noise that is the generalised inverse G_C.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.recovery.candidate import (
    LAMP_WEIGHT,
    Candidate,
    Scene,
    generalized_inverse,
    predicted,
    solved,
    whole,
    without_each,
)
from usdskin.estimate.recovery.responsivity import Responsivity, second_difference
from usdskin.estimate.recovery.training import Training

FloatArray = NDArray[np.float64]

NOISE_FACTORS = (0.0, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0)
"""Factors tried on the variance of the camera values' noise."""

KERNEL_SHARES = (0.0, 0.001, 0.01, 0.03, 0.1, 0.3, 1.0)
"""Shares of the smooth reflectance kernel tried in the prior; the rest are the chart's patches."""

FLATNESS_WEIGHTS = np.logspace(-8.0, 2.0, 21)
"""Weights of small reflectance tried against those of smooth reflectance."""

_KERNEL_WIDTH_NM = 50.0
_KERNEL_CONTRAST = 0.5


def wiener(
    training: Training,
    responsivity: Responsivity,
    noise: FloatArray,
    ridge: float | None = None,
    lamp: float = LAMP_WEIGHT,
) -> Iterator[Candidate]:
    """Yield the Wiener estimate: the most probable spectrum, noise considered.

    ``G^T = C t (t^T C t + k S)^-1`` (W. K. Pratt and C. E. Mancill, "Spectral estimation
    techniques for the spectral calibration of a color image scanner", Appl. Opt. 15(1), 1976;
    N. Shimano, IEEE Trans. Image Process. 15(7), 2006, for the noise). The prior has zero mean,
    which keeps it linear in rho: ``C = (1 - b) mean(e e^T) + b diag(E) K diag(E) + lamp E E^T``,
    the second moment of the class's signals, that of smooth reflectances in its light, and the
    lamp itself, all in the brightness of the perfect diffuser, so that noise of relative size is
    noise of one size. K is 1 plus a Gaussian covariance (standard deviation 0.5, width 50 nm). b
    and the factor k on the noise are candidates; k is the candidate's ridge.

    Args:
        training: The chart.
        responsivity: t of the camera.
        noise: Relative standard deviation of camera values [1], shape [3].
        ridge: The only noise factor k to offer; several when None.
        lamp: How much the lamp counts in the prior, the surfaces being 1.
    """
    full, left = whole(training, responsivity), without_each(training, responsivity)
    kernel = _smooth_kernel(training)
    light, moment = training.illuminant, _moment(full)
    variance, left_variance = _noise_variance(full, noise), _noise_variance(left, noise)
    left_by_chart, left_by_kernel = _seen_by_chart(left), kernel @ left.t
    left_by_lamp = light[:, None] * left.white[:, None, :]
    for share in KERNEL_SHARES:
        prior = (1.0 - share) * moment + share * kernel + lamp * np.outer(light, light)
        seen = prior @ full.t
        left_seen = (1.0 - share) * left_by_chart + share * left_by_kernel
        left_seen = left_seen + lamp * left_by_lamp
        for factor in NOISE_FACTORS if ridge is None else (ridge,):
            refitted = _most_probable(left.t, left_seen, factor * left_variance)
            left_out = predicted(refitted, training.camera_values)
            matrix = _most_probable(full.t, seen, factor * variance)
            yield Candidate(matrix, left_out, float(factor), prior)


def _smooth_kernel(training: Training) -> FloatArray:
    """Return the second moment of smooth reflectances in the light, shape [n, n]."""
    steps = training.wavelength_nm[:, None] - training.wavelength_nm[None]
    likeness = np.exp(-0.5 * (steps / _KERNEL_WIDTH_NM) ** 2)
    light = training.illuminant
    return np.asarray((1.0 + _KERNEL_CONTRAST**2 * likeness) * light[:, None] * light[None])


def _moment(scene: Scene) -> FloatArray:
    """Return the second moment of the signals, each as bright as the diffuser, shape [n, n]."""
    weights = scene.counted / scene.sizes() ** 2 / scene.counted.sum()
    return np.asarray((scene.signals.T * weights) @ scene.signals)


def _seen_by_chart(scene: Scene) -> FloatArray:
    """Return ``C t`` of the patches' own second moment, shape [..., n, 3]."""
    weights = scene.counted / scene.sizes() ** 2
    weights = weights / scene.counted.sum(axis=-1, keepdims=True)
    return np.asarray(scene.signals.T @ (weights[..., None] * (scene.signals @ scene.t)))


def _noise_variance(scene: Scene, noise: FloatArray) -> FloatArray:
    """Return the variance of camera values as bright as the diffuser's, shape [..., 3]."""
    weights = scene.counted / scene.sizes() ** 2
    weights = weights / scene.counted.sum(axis=-1, keepdims=True)
    return np.asarray(noise**2 * (weights @ scene.camera_values**2))


def _most_probable(t: FloatArray, seen: FloatArray, variance: FloatArray) -> FloatArray:
    """Return ``C t (t^T C t + S)^-1`` given ``seen = C t``, shapes [..., n, 3]."""
    return solved(seen, np.swapaxes(t, -1, -2) @ seen + variance[..., None] * np.eye(3))


def smooth(
    training: Training, responsivity: Responsivity, ridge: float | None = None
) -> Iterator[Candidate]:
    """Yield the smoothest reflectance in the known light, ``G_C`` of the smooth prior.

    ``C = diag(E) (D^T D + w I)^-1 diag(E)`` with D the second difference (C. van Trigt, "Smoothest
    reflectance functions", JOSA A 7(10), 1990; its quadratic form): of all spectra with the same
    camera values, the light times the smoothest reflectance, a little drawn to zero by w, which
    is the candidate's ridge. It needs no chart but for t and w.

    Args:
        training: The chart.
        responsivity: t of the camera.
        ridge: The only weight w to offer [1]; several when None.
    """
    roughness = second_difference(training.wavelength_nm)
    sizes, vectors = np.linalg.eigh(roughness.T @ roughness)
    shaped = training.illuminant[:, None] * vectors
    full, left = whole(training, responsivity), without_each(training, responsivity)
    for weight in FLATNESS_WEIGHTS if ridge is None else (ridge,):
        prior = (shaped / (np.maximum(sizes, 0.0) + weight)) @ shaped.T
        prior /= prior.diagonal().max()
        refitted = generalized_inverse(left.t, prior)
        left_out = predicted(refitted, training.camera_values)
        yield Candidate(generalized_inverse(full.t, prior), left_out, float(weight))


# --- How sure ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """How wrong a spectrum as bright as the perfect diffuser may be, its camera values known."""

    covariance: FloatArray
    """Of the recovered spectrum's error, before it is sized, in the light's unit squared,
    shape [n, n]."""

    white: FloatArray
    """Camera values of the perfect diffuser, which make channels equal, shape [3]."""

    directions: FloatArray
    """Camera values of the patches over the diffuser's, of unit length, shape [m, 3]."""

    squared_errors: FloatArray
    """Squared error of every left-out patch over the one expected [1], shape [m]."""

    def size_at(self, camera_values: FloatArray) -> float:
        """Return the factor on the covariance for spectra of some color.

        The mean over the patches of squared error over expected, with Gaussian weights of the
        angle between camera values, as wide as the nearest quarter of the patches: greys are
        known better than saturated colors, which one Gaussian cannot say.

        Args:
            camera_values: rho in any brightness, shape [3].
        """
        direction = camera_values / self.white
        cosine = self.directions @ direction / np.linalg.norm(direction)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        width = max(float(np.quantile(angle, 0.25)), 1e-3)
        weight = np.exp(-0.5 * (angle / width) ** 2)
        return float(weight @ self.squared_errors / weight.sum())


def posterior(
    training: Training, responsivity: Responsivity, noise: FloatArray, candidate: Candidate
) -> Posterior:
    """Return how wrong a Wiener estimate may be, to be sized by left-out patches.

    The covariance of the error of ``e = M rho`` under prior C and the measured noise S is
    ``(I - M t^T) C (I - M t^T)^T + M S M^T``, the posterior covariance where M is the Wiener
    matrix of C and S themselves (P. D. Joseph's form; C. D. Rodgers, "Inverse Methods for
    Atmospheric Sounding", 2000). It stays right where leave-one-out chose more noise than was
    measured.

    Args:
        training: The chart.
        responsivity: t of the camera.
        noise: Relative standard deviation of camera values [1], shape [3].
        candidate: One of ``wiener``'s.
    """
    assert candidate.prior is not None
    scene = whole(training, responsivity)
    matrix = candidate.matrix
    missed = np.eye(matrix.shape[0]) - matrix @ scene.t.T
    variance = _noise_variance(scene, noise)
    covariance = missed @ candidate.prior @ missed.T + (matrix * variance) @ matrix.T
    error = (candidate.left_out - training.signals) / scene.sizes()[:, None]
    expected = max(float(np.trace(covariance)), np.finfo(float).tiny)
    relative = training.camera_values / scene.white
    return Posterior(
        covariance=covariance,
        white=scene.white,
        directions=relative / np.linalg.norm(relative, axis=1, keepdims=True),
        squared_errors=(error**2).sum(axis=1) / expected,
    )
