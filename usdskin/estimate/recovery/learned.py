"""Estimators learned from the chart's patches alone: regression, pca, and the paper's formula.

Camera values are P = Lambda t, shapes [m, 3] = [m, n] [n, 3]; a spectrum is recovered as
e^T = rho^T G. A left-out patch is left out of everything: each has its own fit.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.recovery.candidate import (
    LAMP_WEIGHT,
    Candidate,
    Scene,
    predicted,
    solved,
    whole,
    without_each,
)
from usdskin.estimate.recovery.responsivity import Responsivity
from usdskin.estimate.recovery.training import Training

FloatArray = NDArray[np.float64]

RIDGES = np.concatenate(([0.0], np.logspace(-7.0, -1.0, 13)))
"""Ridges tried: squared relative errors of camera values."""

EXPONENTS = (1.0, 0.5, 0.0)
"""Patch weightings tried, from equal relative to equal absolute errors."""

_MAX_TSVD_RANK = 15
_PCA_RANK = 3
_SUBSPACE = 12
_SUBSPACE_ROUNDS = 8


def regression(
    training: Training,
    responsivity: Responsivity,
    ridge: float | None = None,
    exponent: float | None = None,
    lamp: float = LAMP_WEIGHT,
) -> Iterator[Candidate]:
    """Yield the chart regression ``G = P^+ Lambda`` with ridges and patch weightings.

    ``G^T = Lambda^T W P (P^T W P + r diag(P^T W P))^-1``: ridge regression (A. E. Hoerl and R. W.
    Kennard, Technometrics 12(1), 1970) of spectra on camera values, as in V. Heikkinen et al.,
    "Evaluation and unification of some methods for estimating reflectance spectra from RGB
    images", JOSA A 25(10), 2008. The ridge r is a squared relative error of camera values. It is
    G_C with ``C = Lambda^T W Lambda``: the chart itself is the prior.

    One row more than the chart has stands for the lamp: the perfect diffuser's spectrum E and its
    camera values ``E t``. Most light that reaches anything in a room comes from its lamp or off
    walls without much color, so an error there is worse than one of a saturated patch.

    Args:
        training: The chart.
        responsivity: t of the camera, for the lamp's camera values.
        ridge: The only ridge to offer [1]; several when None.
        exponent: The only patch weighting to offer, 0 (absolute) to 1 (relative); several when
            None.
        lamp: How much the lamp counts, all patches together being 1; 0 leaves the plain formula.
    """
    full, left = whole(training, responsivity), without_each(training, responsivity)
    for power in EXPONENTS if exponent is None else (exponent,):
        sums, left_sums = (_regression_sums(scene, power, lamp) for scene in (full, left))
        for r in RIDGES if ridge is None else (ridge,):
            refitted = _ridge_matrix(*left_sums, r)
            left_out = predicted(refitted, training.camera_values)
            yield Candidate(_ridge_matrix(*sums, r), left_out, float(r))


def _regression_sums(
    scene: Scene, exponent: float, lamp: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return ``Lambda^T W P``, ``P^T W P`` and the latter's diagonal without the lamp's row."""
    weights, values = scene.weights(exponent), scene.camera_values
    gram = np.einsum("...m,mc,md->...cd", weights, values, values, optimize=True)
    pairs = (scene.signals[:, :, None] * values[:, None, :]).reshape(len(values), -1)
    cross = (weights @ pairs).reshape(*weights.shape[:-1], -1, 3)
    diagonal = np.diagonal(gram, axis1=-2, axis2=-1)
    weight = lamp * (weights * scene.sizes() ** 2).sum(axis=-1)[..., None, None]
    white = scene.white
    light = scene.training.illuminant
    gram = gram + weight * white[..., :, None] * white[..., None, :]
    return cross + weight * light[:, None] * white[..., None, :], gram, diagonal


def _ridge_matrix(
    cross: FloatArray, gram: FloatArray, diagonal: FloatArray, ridge: float
) -> FloatArray:
    return solved(cross, gram + ridge * diagonal[..., None] * np.eye(3))


def literal(training: Training) -> Iterator[Candidate]:
    """Yield the paper's formula as printed: ``t = Lambda^+ P``, then ``G = t^+``.

    Moore-Penrose inverses both (M. Iwasaki and N. Tanaka, section 2.2). Lambda is numerically of
    low rank, so noise explodes: it is here as the documented baseline, with nothing to choose.
    Every left-out patch is a fit anew.

    Args:
        training: The chart.
    """
    signals, values = training.signals, training.camera_values
    matrix = np.asarray(np.linalg.pinv(np.linalg.pinv(signals) @ values).T, dtype=np.float64)
    refits = []
    for i in range(len(values)):
        rest = np.delete(np.arange(len(values)), i)
        refits.append(np.linalg.pinv(np.linalg.pinv(signals[rest]) @ values[rest]).T)
    yield Candidate(matrix, predicted(np.array(refits), values), 0.0)


def tsvd(training: Training, ridge: float | None = None) -> Iterator[Candidate]:
    """Yield ``G = t^+`` with t from a truncated singular value decomposition of Lambda.

    Truncation is P. C. Hansen, "The truncated SVD as a method for regularization", BIT 27, 1987.
    The candidate's ridge is the cut: the relative size below which singular values are dropped,
    ``rcond`` of ``numpy.linalg.pinv``. Every left-out patch is a fit anew at the same rank.

    Args:
        training: The chart.
        ridge: The only cut to offer [1]; ranks from 3 to 15 when None.
    """
    signals, values = training.signals, training.camera_values
    left, sizes, right = np.linalg.svd(signals, full_matrices=False)
    usable = int(np.count_nonzero(sizes > 1e-12 * sizes[0]))
    if ridge is None:
        ranks = list(range(3, min(_MAX_TSVD_RANK, usable, len(values) - 1) + 1)) or [usable]
    else:
        ranks = [max(int(np.count_nonzero(sizes > ridge * sizes[0])), 1)]
    responses = _truncated_responses(left, sizes, right, values, ranks)
    refits = []
    for i in range(len(values)):
        rest = np.delete(np.arange(len(values)), i)
        parts = np.linalg.svd(signals[rest], full_matrices=False)
        refits.append(_truncated_responses(*parts, values[rest], ranks))
    for index, rank in enumerate(ranks):
        matrix = np.asarray(np.linalg.pinv(responses[index]).T, dtype=np.float64)
        refitted = np.linalg.pinv(np.array([refit[index] for refit in refits]))
        left_out = predicted(np.swapaxes(refitted, -1, -2), values)
        cut = np.sqrt(sizes[rank - 1] * sizes[rank]) / sizes[0] if rank < sizes.size else 0.0
        yield Candidate(matrix, left_out, float(cut))


def _truncated_responses(
    left: FloatArray, sizes: FloatArray, right: FloatArray, values: FloatArray, ranks: list[int]
) -> list[FloatArray]:
    scores = (left.T @ values) / np.maximum(sizes, 1e-300)[:, None]
    return [right[:rank].T @ scores[:rank] for rank in ranks]


def pca(
    training: Training,
    responsivity: Responsivity,
    ridge: float | None = None,
    exponent: float | None = None,
) -> Iterator[Candidate]:
    """Yield the linear model of three principal components, ``G = (U^T t)^-1 U^T``.

    U [n, 3] are the leading uncentred components of the signals, and ``U^T t`` is found by
    regressing camera values on the signals' scores ``Lambda U``, the less noisy of the two: the
    three-dimensional models of L. T. Maloney and B. A. Wandell, "Color constancy: a method for
    recovering surface spectral reflectance", JOSA A 3(1), 1986. It is G_C with ``C = U U^T``.
    Every left-out patch is a fit anew. Its ridge is 0.

    Args:
        training: The chart.
        responsivity: t of the camera, for the brightness of the patches.
        ridge: Must be 0 or None: three equations for three scores leave nothing to weigh.
        exponent: The only patch weighting to offer, 0 (absolute) to 1 (relative); several when
            None.

    Raises:
        ValueError: Another ridge.
    """
    if ridge not in (None, 0.0):
        raise ValueError(f"the estimator pca has no ridge, so it cannot be {ridge:g}")
    full, left = whole(training, responsivity), without_each(training, responsivity)
    for power in EXPONENTS if exponent is None else (exponent,):
        # numpy orders singular vectors from the largest, subspaces here end with it.
        weighted = np.sqrt(full.weights(power))[:, None] * training.signals
        start = np.linalg.svd(weighted, full_matrices=False)[2][:_SUBSPACE].T[:, ::-1]
        matrix, leading = _component_inverse(full, power, start)
        refitted, _ = _component_inverse(left, power, leading)
        yield Candidate(matrix, predicted(refitted, training.camera_values), 0.0)


def _component_inverse(
    scene: Scene, exponent: float, start: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return ``U (t^T U)^-1`` [..., n, 3] and the leading components [..., n, k]."""
    weights, signals = scene.weights(exponent), scene.signals
    both = np.concatenate((signals, scene.camera_values), axis=1)
    pairs = (signals[:, :, None] * both[:, None, :]).reshape(len(signals), -1)
    sums = (weights @ pairs).reshape(*weights.shape[:-1], signals.shape[1], -1)
    sizes, leading = _leading(sums[..., : signals.shape[1]], start)
    sizes, components = sizes[..., -_PCA_RANK:], leading[..., -_PCA_RANK:]
    known = sizes > 1e-14 * sizes[..., -1:]
    inverse_sizes = np.where(known, 1.0 / np.where(known, sizes, 1.0), 0.0)
    seen = np.swapaxes(components, -1, -2) @ sums[..., signals.shape[1] :]
    seen = inverse_sizes[..., :, None] * seen
    return np.asarray(components @ np.swapaxes(np.linalg.pinv(seen), -1, -2)), leading


def _leading(grams: FloatArray, start: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return leading eigenvalues and eigenvectors, ascending, by subspace iteration.

    A whole decomposition of every left-out patch's matrix would be most of a calibration's time.
    Of the k components carried the third settles by the ratio of eigenvalues k + 1 to 3 in every
    round, below 0.01 for reflectances.
    """
    basis = np.broadcast_to(start, (*grams.shape[:-2], *start.shape[-2:]))
    for _ in range(_SUBSPACE_ROUNDS):
        basis = np.linalg.qr(grams @ basis)[0]
    sizes, turns = np.linalg.eigh(np.swapaxes(basis, -1, -2) @ grams @ basis)
    return sizes, basis @ turns
