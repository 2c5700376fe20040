"""What every estimator offers: its solutions, and how each predicts patches it has not seen."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.differences import delta_e_of_signals
from usdskin.estimate.recovery.responsivity import Responsivity
from usdskin.estimate.recovery.training import Training

FloatArray = NDArray[np.float64]

LAMP_WEIGHT = 2.0
"""How much the lamp itself counts, all patches together being 1. The more, the better skin comes
out in light of little colour, and the more the noise of the chart counts: under the lamps of the
four shipped sets (24 patches, 0.2 % noise) its mean CIEDE2000 is 0.14, 0.11, 0.09 and 0.08 at
weights of 0.5, 1, 2 and 5 for six common cameras, and 0.28, 0.26, 0.27 and 0.29 for one whose
channels are very alike."""


@dataclass(frozen=True, slots=True, eq=False)
class Candidate:
    """One solution of an estimator, for one choice of its weights."""

    matrix: FloatArray
    """G^T, such that ``spectrum = matrix @ rho``, shape [n, 3]."""

    left_out: FloatArray
    """Spectrum of every patch as recovered without that patch, shape [m, n]."""

    ridge: float
    """The weight that stabilises it; what it is, the estimator's function says."""

    prior: FloatArray | None = None
    """Covariance of spectra believed in, shape [n, n]."""


def best(training: Training, candidates: Iterable[Candidate]) -> Candidate:
    """Return the candidate that predicts left-out patches best, the first of equals.

    The least product of two errors: of the root mean square of spectral errors, each relative to
    its patch's own size, and of the mean CIEDE2000. The first alone lets long wavelengths rule
    under an incandescent lamp, the second is blind to metamers, and a product needs no rate of
    exchange. Patches whose camera values are known to be poor count less.

    Args:
        training: The chart.
        candidates: At least one.
    """
    offered = list(candidates)
    if len(offered) == 1:
        return offered[0]
    spectra = np.array([candidate.left_out for candidate in offered])
    weight = 1.0 / training.poorness(training.camera_values.max(axis=0))
    weight /= weight.sum()
    error = ((spectra - training.signals) ** 2).sum(axis=2) / (training.signals**2).sum(axis=1)
    color = delta_e_of_signals(
        spectra, training.signals, training.illuminant, training.wavelength_nm
    )
    return offered[int(np.argmin(np.sqrt(error @ weight) * (color @ weight)))]


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """A chart with what the camera makes of its light, whole and without each of its patches.

    Every estimator works on it twice: once with ``t``, ``white`` and ``counted`` as they are, and
    once with those of the left-out fits, whose leading axis is the patch that is missing. So what
    is said of left-out patches is exact, but for the weights of the regularisations themselves
    and the bands where t is zero.
    """

    training: Training
    """The chart."""

    t: FloatArray
    """Responsivity, shape [n, 3], or [m, n, 3] without each patch."""

    white: FloatArray
    """Camera values of the perfect diffuser, ``E t``, shape [3] or [m, 3]."""

    counted: FloatArray
    """1 for the patches that are there, 0 for those left out, shape [m] or [m, m]."""

    @property
    def signals(self) -> FloatArray:
        """Colour signals of all patches, shape [m, n]."""
        return self.training.signals

    @property
    def camera_values(self) -> FloatArray:
        """Camera values of all patches, shape [m, 3]."""
        return self.training.camera_values

    def sizes(self) -> FloatArray:
        """Return the patches' brightness to the camera, the diffuser's being 1, shape [..., m]."""
        relative = self.camera_values / self.white[..., None, :]
        return np.asarray(np.sqrt((relative**2).mean(axis=-1)))

    def weights(self, exponent: float) -> FloatArray:
        """Return how much each patch counts, ``size^(-2 exponent) / poorness``, shape [..., m].

        Args:
            exponent: 0 for equal absolute errors, 1 for equal relative ones.
        """
        poorness = self.training.poorness(self.white)
        return np.asarray(self.counted * self.sizes() ** (-2.0 * exponent) / poorness)


def whole(training: Training, responsivity: Responsivity) -> Scene:
    """Return the chart with all its patches."""
    t = responsivity.values
    return Scene(training, t, training.illuminant @ t, np.ones(len(training.patches)))


def without_each(training: Training, responsivity: Responsivity) -> Scene:
    """Return the chart without each of its patches in turn."""
    t = responsivity.without_each(training)
    white = np.einsum("n,mnc->mc", training.illuminant, t)
    return Scene(training, t, white, 1.0 - np.eye(len(training.patches)))


def predicted(matrices: FloatArray, camera_values: FloatArray) -> FloatArray:
    """Return the spectrum of each patch by the matrix that has not seen it.

    Args:
        matrices: One G^T per patch, shape [m, n, 3].
        camera_values: P, shape [m, 3].

    Returns:
        Spectra, shape [m, n].
    """
    return np.asarray(np.einsum("mnc,mc->mn", matrices, camera_values))


def generalized_inverse(responsivity: FloatArray, prior: FloatArray) -> FloatArray:
    """Return ``G_C^T = C t (t^T C t)^-1``, the inverse of t within a prior on spectra.

    Every G with ``G t = I`` has this form (A. Ben-Israel and T. N. E. Greville, "Generalized
    Inverses", 2003); C says which of the spectra of equal camera values is meant.

    Args:
        responsivity: t, shape [..., n, 3].
        prior: C, positive semi-definite, shape [..., n, n].

    Returns:
        G^T, shape [..., n, 3].
    """
    seen = prior @ responsivity
    return solved(seen, np.swapaxes(responsivity, -1, -2) @ seen)


def solved(cross: FloatArray, gram: FloatArray) -> FloatArray:
    """Return ``cross gram^-1`` for symmetric 3 x 3 systems.

    Channels may differ widely in size; directions that nothing was learned about give nothing.

    Args:
        cross: Right sides, shape [..., n, 3].
        gram: Positive semi-definite, shape [..., 3, 3].

    Returns:
        Solutions, shape [..., n, 3].
    """
    size = np.diagonal(gram, axis1=-2, axis2=-1)
    scale = 1.0 / np.sqrt(np.where(size > 0.0, size, 1.0))
    balanced = gram * scale[..., :, None] * scale[..., None, :]
    inverse = np.linalg.pinv(balanced, rcond=1e-13, hermitian=True)
    return np.asarray((cross * scale[..., None, :]) @ inverse * scale[..., None, :])
