"""How pixels of one angle to the light scatter: which are no diffuse reflection, and how sure the
others are.

Diffuse reflection of one skin depends on N.L alone, so pixels of all photographs with the same N.L
agree but for noise, misplacement, and blemishes of the skin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

_BINS = 72  # of N.L from -1 to 1
_LEAST_OF_BIN = 12
_LIT_SHARE = 0.6  # quantile that stands for a lit, matt pixel: shadows outnumber highlights
_SHADOW = 0.6
_HIGHLIGHT = 1.7
_SLACK = 0.03  # of the peak: less is no shadow, but noise
_GROUPS = (10, 6)  # of misplacement, and of value
_LEAST_OF_GROUP = 20
_NORMAL = 1.4826  # standard deviation of normal noise over its median absolute deviation
_FLOOR = 2e-5  # of the peak


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """Values over N.L."""

    cosine: FloatArray
    """N.L, ascending, shape [n]; at least two."""

    value: FloatArray
    """A quantile of the values there, shape [n, c]."""

    def at(self, cosine: FloatArray) -> FloatArray:
        """Return the values at other N.L, shape [q, c]."""
        columns = [np.interp(cosine, self.cosine, column) for column in self.value.T]
        return np.stack(columns, axis=-1)

    def slope(self, cosine: FloatArray) -> FloatArray:
        """Return the derivatives by N.L, shape [q, c]."""
        return Curve(self.cosine, self._rise()).at(cosine)

    def bend(self, cosine: FloatArray) -> FloatArray:
        """Return the second derivatives by N.L, shape [q, c]."""
        return Curve(self.cosine, np.gradient(self._rise(), self.cosine, axis=0)).at(cosine)

    def _rise(self) -> FloatArray:
        return np.asarray(np.gradient(self.value, self.cosine, axis=0))


def curve_of(cosine: FloatArray, values: FloatArray, share: float) -> Curve | None:
    """Return a quantile of values over N.L; None: too few readings.

    Args:
        cosine: N.L, shape [q].
        values: Shape [q, c].
        share: Which quantile, 0 to 1.
    """
    row = np.minimum((0.5 * (cosine + 1.0) * _BINS).astype(np.intp), _BINS - 1)
    order = np.argsort(row, kind="stable")
    ends = np.cumsum(np.bincount(row, minlength=_BINS))
    middles, levels = [], []
    for begin, end in zip(np.concatenate([[0], ends[:-1]]), ends, strict=True):
        held = order[begin:end]
        if len(held) >= _LEAST_OF_BIN:
            middles.append(float(cosine[held].mean()))
            levels.append(np.quantile(values[held], share, axis=0))
    return Curve(np.array(middles), np.stack(levels)) if len(middles) >= 2 else None


@dataclass(frozen=True, slots=True, eq=False)
class Odd:
    """Readings that differ from those elsewhere at the same angle to the light."""

    shadowed: Mask
    """Far too dark: something is between light and skin, shape [q]."""

    highlight: Mask
    """Far too bright: a highlight, or something that is no skin, shape [q]."""


def find_odd(cosine: FloatArray, values: FloatArray) -> Odd:
    """Compare readings with all others at the same angle to the light.

    Args:
        cosine: N.L of readings of all photographs, shape [q].
        values: Radiance over that of a perfect diffuser which faces the light [1], shape [q, c].
    """
    total = values.mean(axis=1, keepdims=True)
    curve = curve_of(cosine, total, _LIT_SHARE)
    if curve is None:
        nothing = np.zeros(len(total), bool)
        return Odd(nothing, nothing)
    usual = np.maximum(curve.at(cosine)[:, 0], 0.0)
    slack = _SLACK * float(curve.value.max())
    return Odd(
        shadowed=total[:, 0] < _SHADOW * usual - slack,
        highlight=total[:, 0] > _HIGHLIGHT * usual + slack,
    )


def standard_deviations(
    cosine: FloatArray,
    values: FloatArray,
    turn: FloatArray,
    variance: FloatArray | None,
    is_matt: Mask,
) -> FloatArray | None:
    """Return how far readings scatter, as measured on themselves.

    ``sigma^2 = variance + a (turn dI/dcos)^2 + b I^2 + c (turn^2 d^2I/dcos^2)^2 + d``: noise of
    the sensor, misplacement by sqrt(a) pixels, blemishes of the skin, what a pixel averages where
    the curve bends, and stray light; a to d are those that tell best how far the readings are from
    the median at their N.L, none below 0.

    Args:
        cosine: N.L, shape [q].
        values: Radiance over that of a perfect diffuser which faces the light [1], shape [q, c].
        turn: How far N.L turns from pixel to pixel [1], shape [q].
        variance: Of the values by the sensor's noise, shape [q, c]; None: not known.
        is_matt: Which readings are free of gloss: the others scatter by it too, shape [q].

    Returns:
        Standard deviations, shape [q, c]; None: too few readings to tell.
    """
    curve = curve_of(cosine[is_matt], values[is_matt], 0.5)
    if curve is None:
        return None
    peak = np.maximum(curve.value.max(axis=0), 1e-9)
    model = np.maximum(curve.at(cosine), 0.0) / peak
    misplaced = turn[:, None] * np.abs(curve.slope(cosine)) / peak
    noise = np.zeros_like(values) if variance is None else np.maximum(variance, 0.0) / peak**2
    residual = (values - curve.at(cosine)) / peak
    bent = np.square(turn)[:, None] * np.abs(curve.bend(cosine)) / peak
    parts = [np.square(misplaced), np.square(model), np.square(bent), np.ones_like(model)]
    weights = _explained(residual[is_matt], noise[is_matt], [part[is_matt] for part in parts])
    found = noise + sum(weight * part for weight, part in zip(weights, parts, strict=True))
    return np.asarray(np.sqrt(found + _FLOOR**2) * peak)


def _explained(residual: FloatArray, noise: FloatArray, parts: list[FloatArray]) -> FloatArray:
    """Return the weights of the parts of a variance, by its size in groups of readings."""
    from scipy.optimize import nnls

    rows, wanted = [], []
    flat = [part.ravel() for part in parts]
    missed, known = residual.ravel(), noise.ravel()
    for outer in np.array_split(np.argsort(flat[0], kind="stable"), _GROUPS[0]):
        for group in np.array_split(outer[np.argsort(flat[1][outer])], _GROUPS[1]):
            if len(group) < _LEAST_OF_GROUP:
                continue
            off = missed[group] - np.median(missed[group])
            spread = (_NORMAL * float(np.median(np.abs(off)))) ** 2
            size = max(spread, _FLOOR**2)
            rows.append([float(np.mean(part[group])) / size for part in flat])
            wanted.append(max(spread - float(np.median(known[group])), 0.0) / size)
    if not rows:
        return np.zeros(len(parts))
    return np.asarray(nnls(np.array(rows), np.array(wanted))[0])
