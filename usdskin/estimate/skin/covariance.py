"""How sure the numbers of a fit are, and how sure they can be: the Cramer-Rao bound."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.model import Coefficients, SkinModel
from usdskin.estimate.skin.solve import normal_equations

FloatArray = NDArray[np.float64]

_SINGULAR = 1e-9
"""Eigenvalue of the Fisher matrix, scaled to a unit diagonal, below which nothing is known."""

_LARGEST_STEP = 0.2
_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviation of a reading where none is given."""

    relative: float = 0.01
    """Of the reading itself [1]."""

    floor: float = 0.002
    """Of the channel's largest reading [1]."""

    def sigma(self, values: FloatArray) -> FloatArray:
        """Return standard deviations [1] of noise-free values, shape [q, c]."""
        peak = np.maximum(np.abs(values).max(axis=0), 1e-12)
        return np.asarray(np.hypot(self.relative * values, self.floor * peak))


def covariance_of_free(model: SkinModel, at: Coefficients, weights: FloatArray) -> FloatArray:
    """Return the covariance of the free numbers, the inverse Fisher matrix, shape [p, p].

    The derivative by l is averaged over one standard deviation to both sides, since the wrap term
    has a kink at acos(-l). Numbers that readings say nothing of have an infinite variance.

    Args:
        model: At the readings' geometry.
        at: The numbers.
        weights: Inverse variances of the values, 0 for those not used, shape [q, c].
    """
    if not model.freedom.wrap:
        return _inverse(_fisher(model, at, weights, 0.0))
    step = _LARGEST_STEP
    for _ in range(_ROUNDS):
        found = _inverse(_fisher(model, at, weights, step))
        step = min(float(np.sqrt(found[0, 0])), _LARGEST_STEP)
    return found


def cramer_rao(model: SkinModel, truth: Coefficients, sigma: FloatArray) -> FloatArray:
    """Return the Cramer-Rao bound of the free numbers' covariance at the truth, shape [p, p].

    The plain bound: its derivatives are those at the truth, on one side of the kink.

    Args:
        model: At the readings' geometry.
        truth: The numbers.
        sigma: Standard deviations of the readings, shape [q, c].
    """
    return _inverse(_fisher(model, truth, 1.0 / sigma**2, 0.0))


def _fisher(
    model: SkinModel, at: Coefficients, weights: FloatArray, wrap_step: float
) -> FloatArray:
    normal, _ = normal_equations(model, at, weights, np.zeros_like(weights), wrap_step)
    return normal


def _inverse(fisher: FloatArray) -> FloatArray:
    """Return the inverse, with infinite variances where the matrix is singular."""
    diagonal = fisher.diagonal()
    seen = diagonal > 0.0
    scale = np.where(seen, 1.0 / np.sqrt(np.where(seen, diagonal, 1.0)), 0.0)
    sizes, vectors = np.linalg.eigh(fisher * scale[:, None] * scale)
    known = sizes > _SINGULAR
    inverse = (vectors[:, known] / sizes[known]) @ vectors[:, known].T
    inverse = inverse * scale[:, None] * scale
    lost = ((vectors[:, ~known] ** 2).sum(axis=1) > 1e-6) | ~seen
    inverse[lost] = 0.0
    inverse[:, lost] = 0.0
    inverse[lost, lost] = np.inf
    return np.asarray(inverse)


# --- The same for all numbers, fixed ones among them --------------------------------------------


def full_names(model: SkinModel) -> tuple[str, ...]:
    """Return ``wrap``, ``A[..]``, ``B[..]``, then opacities and lobes where they were free."""
    kinds = ["A", "B"] + ["delta"] * model.freedom.delta
    lobes = [name for name in model.shared_names if name != "wrap"]
    return ("wrap", *(f"{kind}[{name}]" for kind in kinds for name in model.names), *lobes)


def full_covariance(model: SkinModel, free: FloatArray) -> FloatArray:
    """Return the covariance of the numbers of ``full_names``; fixed ones have none.

    Args:
        model: At the readings' geometry.
        free: Covariance of the free numbers, shape [p, p].
    """
    names, given = full_names(model), model.parameter_names
    gain = np.zeros((len(names), len(given)))
    place = {name: index for index, name in enumerate(given)}
    for row, name in enumerate(names):
        if name in place:
            gain[row, place[name]] = 1.0
        elif name.startswith("B[") and model.freedom.scattering is not None:
            channel = model.names.index(name[2:-1])
            gain[row, place[f"A[{name[2:-1]}]"]] = model.freedom.scattering[channel]
    unknown = ~np.isfinite(free.diagonal())
    finite = np.where(np.isfinite(free), free, 0.0)
    result = gain @ finite @ gain.T
    lost = (np.abs(gain[:, unknown]) > 0.0).any(axis=1)
    result[lost, lost] = np.inf
    return np.asarray(result)
