"""The lustre that readings may contain: the renderer's two GGX lobes on the host.

Per unit of E/pi one light adds ``pi w [(1 - m) f(a1) + m f(a2)] max(N.L, 0)`` to every channel
alike, and what the lobes reflect, the skin below does not get: its part is times
``1 - w [(1 - m) R(a1) + m R(a2)]``, R being a lobe's directional albedo (docs/rendering.md).
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.readings import Readings
from usdskin.fresnel import rise

FloatArray = NDArray[np.float64]

F0 = 0.028
"""Reflectance at normal incidence [1] of a surface of index 1.4."""

_ROUGHNESS_ROWS, _COSINE_COLUMNS, _DIRECTIONS = 33, 32, 256
_LEAST_ALPHA = 1e-3


@dataclass(frozen=True, slots=True)
class Lobe:
    """How glossy skin is, in the terms of ``SkinMaterialAPI``."""

    weight: float
    """w, strength of the reflection [1]."""

    roughness1: float
    """Roughness of the first lobe [1]; its alpha is the square."""

    roughness2: float
    """Roughness of the second lobe [1]."""

    mix: float
    """m, share of the second lobe [1]."""

    f0: float = F0
    """Reflectance at normal incidence [1]."""


class LobeGeometry:
    """What of the readings' geometry the lobes need, computed once."""

    def __init__(self, readings: Readings) -> None:
        if readings.view is None:
            raise ValueError("a specular lobe needs view directions")
        between = readings.light + readings.view
        length = np.linalg.norm(between, axis=1)
        half = between / np.where(length > 1e-9, length, 1.0)[:, None]
        self.nl = readings.cosine
        self.nv = np.maximum(readings.view_cosine, 1e-4)
        self.nh = np.clip((half * readings.normal).sum(axis=1), 0.0, 1.0)
        self.vh = np.clip((half * readings.view).sum(axis=1), 0.0, 1.0)
        self.lit = (self.nl > 0.0) & (readings.view_cosine > 0.0) & (length > 1e-9)

    def reflected(self, lobe: Lobe) -> FloatArray:
        """Return what the lobes add to readings over E/pi [1], shape [q]."""
        first = self._lobe(lobe.roughness1, lobe.f0)
        if lobe.mix == 0.0:
            return np.asarray(lobe.weight * first)
        second = self._lobe(lobe.roughness2, lobe.f0)
        return np.asarray(lobe.weight * ((1.0 - lobe.mix) * first + lobe.mix * second))

    def passed(self, lobe: Lobe) -> FloatArray:
        """Return the share that the lobes leave to the skin below [1], shape [q]."""
        albedo = (1.0 - lobe.mix) * self._albedo(lobe.roughness1, lobe.f0)
        albedo += lobe.mix * self._albedo(lobe.roughness2, lobe.f0)
        return np.asarray(1.0 - lobe.weight * albedo)

    def _lobe(self, roughness: float, f0: float) -> FloatArray:
        """Return pi D G2 F / (4 n.v), shape [q].

        GGX (B. Walter et al., EGSR 2007) with Smith's height-correlated masking (E. Heitz, JCGT
        3(2), 2014) and Fresnel's formulas for a dielectric.
        """
        a2 = float(np.clip(roughness**2, _LEAST_ALPHA, 1.0)) ** 2
        nl, nv = np.where(self.lit, self.nl, 0.5), self.nv
        spread = self.nh**2 * (a2 - 1.0) + 1.0
        density = a2 / (np.pi * spread**2)
        mask = nv * np.sqrt(a2 + (1.0 - a2) * nl**2) + nl * np.sqrt(a2 + (1.0 - a2) * nv**2)
        mirrored = f0 + (1.0 - f0) * rise(f0, self.vh)
        return np.where(self.lit, np.pi * density * nl / (2.0 * mask) * mirrored, 0.0)

    def _albedo(self, roughness: float, f0: float) -> FloatArray:
        return directional_albedo(roughness, self.nv, f0)


def directional_albedo(roughness: float, cosine: FloatArray, f0: float = F0) -> FloatArray:
    """Return the share of uniform light that one lobe reflects towards a direction.

    From a table over roughness and cosine, as the renderer looks it up.

    Args:
        roughness: Roughness of the lobe [1]; its alpha is the square.
        cosine: N.V [1], shape [q].
        f0: Reflectance at normal incidence [1].

    Returns:
        Directional albedo [1], shape [q].
    """
    table = _albedo_table(f0)
    y = float(np.clip(roughness, 0.0, 1.0)) * (_ROUGHNESS_ROWS - 1)
    x = np.clip(cosine, 0.0, 1.0) * (_COSINE_COLUMNS - 1)
    i, j = min(int(y), _ROUGHNESS_ROWS - 2), np.minimum(x.astype(int), _COSINE_COLUMNS - 2)
    fy, fx = y - i, x - j
    top = (1.0 - fx) * table[i, j] + fx * table[i, j + 1]
    bottom = (1.0 - fx) * table[i + 1, j] + fx * table[i + 1, j + 1]
    return np.asarray((1.0 - fy) * top + fy * bottom)


@functools.lru_cache(maxsize=64)
def _albedo_table(f0: float) -> FloatArray:
    """Return the directional albedo over roughness and cosine, shape [33, 32].

    Averaged over GGX half vectors (B. Karis, "Real Shading in Unreal Engine 4", SIGGRAPH 2013
    course), half a turn of them, for the lobe is even in the azimuth.
    """
    roughness = np.linspace(0.0, 1.0, _ROUGHNESS_ROWS)[:, None, None]
    a2 = np.maximum(roughness**2, _LEAST_ALPHA) ** 2
    nv = np.maximum(np.linspace(0.0, 1.0, _COSINE_COLUMNS), _LEAST_ALPHA)[None, :, None]
    share = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    around = np.pi * (np.arange(_DIRECTIONS) * 0.6180339887498949 % 1.0)
    nh = np.sqrt((1.0 - share) / (1.0 + (a2 - 1.0) * share))
    across = np.sqrt(np.maximum(1.0 - nh**2, 0.0)) * np.cos(around)
    vh = np.clip(np.sqrt(1.0 - nv**2) * across + nv * nh, 1e-6, 1.0)
    nl = 2.0 * vh * nh - nv
    lit = nl > 0.0
    nl = np.where(lit, nl, 1.0)
    mask = nv * np.sqrt(a2 + (1.0 - a2) * nl**2) + nl * np.sqrt(a2 + (1.0 - a2) * nv**2)
    weight = np.where(lit, 2.0 * nl * vh / (mask * nh), 0.0)
    return np.asarray((weight * (f0 + (1.0 - f0) * rise(f0, vh))).mean(-1))
