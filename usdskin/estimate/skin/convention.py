"""Separate A and B into alpha, S and Ss by the convention ``luminousMean``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.notes import Note

FloatArray = NDArray[np.float64]

CONVENTION = "luminousMean"
"""Token of ``fit:convention``."""

LARGEST_RATIO = 100.0
"""Ss where A vanishes: what remains is the wrap term alone."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinCoefficients:
    """What ``SkinMaterialAPI`` stores, with errors."""

    alpha: float
    """1/(1 + mean of Ss) [1]."""

    reflectance: FloatArray
    """S = A/alpha [1], shape [c]."""

    scattering: FloatArray
    """Ss = B/A [1], shape [c]."""

    wrap: float
    """l [1]."""

    names: tuple[str, ...]
    """``wrap``, ``alpha``, ``S[..]``, ``Ss[..]``: rows of the covariance."""

    covariance: FloatArray
    """Of those numbers, infinite variances where nothing is known, shape [2 + 2c, 2 + 2c]."""

    convention: str = CONVENTION
    """Token of ``fit:convention``."""

    @property
    def stddev(self) -> FloatArray:
        """Standard deviations of the rows, shape [2 + 2c]."""
        return np.asarray(np.sqrt(np.maximum(self.covariance.diagonal(), 0.0)))

    @property
    def wrap_stddev(self) -> float:
        """Standard deviation of l [1]."""
        return float(self.stddev[0])

    @property
    def alpha_stddev(self) -> float:
        """Standard deviation of alpha [1]."""
        return float(self.stddev[1])

    @property
    def reflectance_stddev(self) -> FloatArray:
        """Standard deviations of S [1], shape [c]."""
        return self.stddev[2 : 2 + self.reflectance.size]

    @property
    def scattering_stddev(self) -> FloatArray:
        """Standard deviations of Ss [1], shape [c]."""
        return self.stddev[2 + self.reflectance.size :]


def split(
    lambert: ArrayLike,
    wrapped: ArrayLike,
    luminous_weights: ArrayLike,
    *,
    wrap: float = 0.0,
    covariance: ArrayLike | None = None,
    channel_names: tuple[str, ...] = (),
    where: str = "fit",
    notes: list[Note] | None = None,
) -> SkinCoefficients:
    """Return alpha, S and Ss, such that alpha S = A and alpha S Ss = B.

    ``alpha = 1/(1 + sum_c w_c Ss_c)``; with flat Ss this makes S the brightness A + B of skin that
    faces the light. Errors go through the first derivatives.

    Args:
        lambert: A [1], shape [c].
        wrapped: B [1], shape [c].
        luminous_weights: Weights w of the mean in any scale, shape [c]: ybar per band.
        wrap: l [1], passed on.
        covariance: Of (l, A, B) in this order, shape [n, n] with n at least 1 + 2c.
        channel_names: Names of the channels.
        where: Place, for notes.
        notes: Takes that A vanishes in a channel, or that S exceeds 1.

    Raises:
        ValueError: Shapes differ, a weight is negative or all are 0, or A + B is 0 in a channel.
    """
    notes = [] if notes is None else notes
    a, b = np.array(lambert, dtype=np.float64), np.array(wrapped, dtype=np.float64)
    weights = np.asarray(luminous_weights, dtype=np.float64)
    if a.shape != b.shape or a.ndim != 1 or weights.shape != a.shape:
        raise ValueError(f"A, B and weights have shapes {a.shape}, {b.shape}, {weights.shape}")
    if (weights < 0.0).any() or weights.sum() <= 0.0:
        raise ValueError("the luminous weights are negative, or all 0")
    if (a < 0.0).any() or (b < 0.0).any() or (a + b <= 0.0).any():
        raise ValueError("A and B must not be negative, nor both 0 in a channel")
    names = channel_names or tuple(str(index) for index in range(a.size))
    total = a + b
    gone = a * LARGEST_RATIO < b
    if gone.any():
        listed = ", ".join(name for name, is_gone in zip(names, gone, strict=True) if is_gone)
        text = f"A vanishes in {listed}; Ss is set to {LARGEST_RATIO:g} there and A + B kept"
        notes.append(Note("lambert-term-vanishes", where, text))
        a = np.where(gone, total / (1.0 + LARGEST_RATIO), a)
        b = np.where(gone, total - a, b)
    w = weights / weights.sum()
    scattering = b / a
    alpha = 1.0 / (1.0 + float(w @ scattering))
    reflectance = a / alpha
    if reflectance.max() > 1.0:
        text = f"S reaches {reflectance.max():.3f} in {names[int(np.argmax(reflectance))]}, "
        text += "more than all the light; are the readings over that of a perfect diffuser?"
        notes.append(Note("reflectance-above-one", where, text))
    propagated = _propagated(a, b, w, alpha, covariance)
    rows = ("wrap", "alpha", *(f"S[{name}]" for name in names), *(f"Ss[{name}]" for name in names))
    return SkinCoefficients(alpha, reflectance, scattering, wrap, rows, propagated)


def _propagated(
    a: FloatArray, b: FloatArray, w: FloatArray, alpha: float, covariance: ArrayLike | None
) -> FloatArray:
    count = a.size
    size = 1 + 2 * count
    if covariance is None:
        return np.zeros((size + 1, size + 1))
    given = np.asarray(covariance, dtype=np.float64)[:size, :size]
    if given.shape != (size, size):
        raise ValueError(f"the covariance has shape {given.shape}, but needs {(size, size)}")
    identity = np.eye(count)
    by_a, by_b = np.diag(-b / a**2), np.diag(1.0 / a)  # of Ss
    alpha_by_a, alpha_by_b = -(alpha**2) * (w @ by_a), -(alpha**2) * (w @ by_b)
    gain = np.zeros((size + 1, size))
    gain[0, 0] = 1.0
    gain[1, 1:] = np.concatenate([alpha_by_a, alpha_by_b])
    part = slice(2, 2 + count)
    gain[part, 1 : 1 + count] = identity / alpha - np.outer(a, alpha_by_a) / alpha**2
    gain[part, 1 + count :] = -np.outer(a, alpha_by_b) / alpha**2
    gain[2 + count :, 1 : 1 + count] = by_a
    gain[2 + count :, 1 + count :] = by_b
    unknown = ~np.isfinite(given.diagonal())
    result = gain @ np.where(np.isfinite(given), given, 0.0) @ gain.T
    lost = (np.abs(gain[:, unknown]) > 0.0).any(axis=1)
    result[lost, lost] = np.inf
    return np.asarray(result)
