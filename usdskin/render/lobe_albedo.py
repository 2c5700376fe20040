"""What a GGX lobe reflects of uniform light towards the viewer, and around which direction.

D of Walter et al. (EGSR 2007), masked by Smith's height-correlated function (Heitz, JCGT 3(2),
2014). Light that is reflected twice within the surface is lost, so that no lobe returns more than
it gets. Tables over roughness, the square root of alpha, along which both are smooth.

A lobe seen at a slant does not lie around the mirrored view, and is narrower than one seen from
above: masking, and the horizon, leave what is near the normal. Its mean direction is along
``mirror + k normal``, and a lobe seen from above that is as concentrated has the alpha ``q alpha``;
k and q are tabulated too.
"""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin import fresnel

FloatArray = NDArray[np.float64]

TABLE_SIZE = (33, 32)
"""Rows over the roughness and columns over the cosine of the view angle, 0 to 1 each."""

_DIRECTIONS = 256

_NARROWEST = 0.5
"""Least q: as narrow as what ``gloss_alphas`` has prefiltered."""

_SCHLICK_F0 = 0.04
"""For k and q, which hardly depend on it."""


@functools.cache
def schlick_response() -> NDArray[np.float32]:
    """Return (x, y) such that a lobe's directional albedo is F0 x + y, by Schlick's Fresnel.

    F0 (1 - c) + c with c = (1 - v.h)^5 splits into both parts (Karis 2013, section 4).

    Returns:
        x, y, k and q over roughness and cosine, shape [33, 32, 4].
    """
    lobe = _masked()
    rise = (1.0 - lobe.between) ** 5
    low = lobe.weight * (1.0 - rise)
    high = lobe.weight * rise
    shape = lobe.shape(_SCHLICK_F0 * low + high)
    return np.stack([low.mean(-1), high.mean(-1), *shape], axis=-1).astype(np.float32)


@functools.lru_cache(maxsize=64)
def dielectric_response(f0: float) -> NDArray[np.float32]:
    """Return the directional albedo of a lobe of a dielectric, its k and q.

    Args:
        f0: Reflectance at normal incidence [1], 0 to 1.

    Returns:
        Albedo, k and q over roughness and cosine, shape [33, 32, 3].
    """
    lobe = _masked()
    weight = lobe.weight * (f0 + (1.0 - f0) * fresnel.rise(f0, lobe.between))
    return np.stack([weight.mean(-1), *lobe.shape(weight)], axis=-1).astype(np.float32)


@dataclass(frozen=True, slots=True, eq=False)
class _Lobe:
    """Half vectors drawn from D n.h for every roughness and view, [33, 32, directions] each.

    The lobe is even in the azimuth: half a turn is enough.
    """

    weight: FloatArray
    """G2 v.h / (n.h n.v), 0 where the light comes from below."""

    between: FloatArray
    """v.h."""

    up: FloatArray
    along: FloatArray
    """n.l, and that of l with the mirrored view's horizontal part."""

    view: FloatArray
    """n.v, shape [1, 32]."""

    def shape(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return k and q, shape [33, 32] each."""
        up, along = self._moments(weight)
        sine = np.sqrt(1.0 - self.view**2)
        shift = np.where(along > 0.0, up * sine / np.maximum(along, 1e-9), 0.0) - self.view
        # By how far the mean of the unit directions falls short of 1: about alpha^2.
        short = np.log(np.maximum(1.0 - np.hypot(up, along), 1e-9))
        up, along = self._moments(self.weight)
        known = np.log(np.maximum(1.0 - np.hypot(up, along)[:, -1], 1e-9))
        alpha = np.log(_alphas())
        found = np.interp(short, np.maximum.accumulate(known), alpha)
        return np.asarray(shift), np.exp(np.clip(found - alpha[:, None], np.log(_NARROWEST), 0.0))

    def _moments(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        total = np.maximum(weight.mean(-1), 1e-12)
        up, along = (weight * self.up).mean(-1), (weight * self.along).mean(-1)
        return up / total, along / total


def _alphas() -> FloatArray:
    return np.maximum(np.linspace(0.0, 1.0, TABLE_SIZE[0]) ** 2, 1e-3)


@functools.cache
def _masked() -> _Lobe:
    columns = TABLE_SIZE[1]
    a2 = _alphas()[:, None, None] ** 2
    nv = np.clip(np.linspace(0.0, 1.0, columns), 1e-3, 1.0 - 1e-4)[None, :, None]
    sine = np.sqrt(1.0 - nv**2)
    xi = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    angle = np.pi * ((np.arange(_DIRECTIONS) * 0.6180339887498949) % 1.0)
    nh = np.sqrt((1.0 - xi) / (1.0 + (a2 - 1.0) * xi))
    across = np.sqrt(np.maximum(1.0 - nh**2, 0.0)) * np.cos(angle)
    between = np.clip(sine * across + nv * nh, 1e-6, 1.0)
    nl = 2.0 * between * nh - nv
    lit = nl > 0.0
    nl = np.where(lit, nl, 1.0)
    mask = nv * np.sqrt(a2 + (1.0 - a2) * nl**2) + nl * np.sqrt(a2 + (1.0 - a2) * nv**2)
    weight = np.where(lit, 2.0 * nl * between / (mask * nh), 0.0)
    return _Lobe(weight, between, nl, sine - 2.0 * between * across, nv[..., 0])
