"""The share of uniform light that a GGX lobe reflects towards the viewer: its directional albedo.

D of Walter et al. (EGSR 2007), masked by Smith's height-correlated function (Heitz, JCGT 3(2),
2014). Light that is reflected twice within the surface is lost, so that no lobe returns more than
it gets. Tables over roughness, the square root of alpha, along which the albedo is smooth.
"""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

from usdskin import fresnel

FloatArray = NDArray[np.float64]

TABLE_SIZE = (33, 32)
"""Rows over the roughness and columns over the cosine of the view angle, 0 to 1 each."""

_DIRECTIONS = 512


@functools.cache
def schlick_albedo() -> NDArray[np.float32]:
    """Return (x, y) such that a lobe's directional albedo is F0 x + y, by Schlick's Fresnel.

    F0 (1 - c) + c with c = (1 - v.h)^5 splits into both parts (Karis 2013, section 4).

    Returns:
        Table over roughness and cosine, shape [33, 32, 2].
    """
    weight, between = _masked()
    rise = (1.0 - between) ** 5
    parts = [(weight * (1.0 - rise)).mean(-1), (weight * rise).mean(-1)]
    return np.stack(parts, axis=-1).astype(np.float32)


@functools.lru_cache(maxsize=64)
def dielectric_albedo(f0: float) -> NDArray[np.float32]:
    """Return the directional albedo of a lobe of a dielectric.

    Args:
        f0: Reflectance at normal incidence [1], 0 to 1.

    Returns:
        Table over roughness and cosine, shape [33, 32].
    """
    weight, between = _masked()
    mirrored = f0 + (1.0 - f0) * fresnel.rise(f0, between)
    return (weight * mirrored).mean(-1).astype(np.float32)


@functools.cache
def _masked() -> tuple[FloatArray, FloatArray]:
    """Return G2 v.h / (n.h n.v) and v.h of half vectors drawn from D n.h, [33, 32, directions].

    The lobe is even in the azimuth: half a turn is enough.
    """
    rows, columns = TABLE_SIZE
    a2 = np.maximum(np.linspace(0.0, 1.0, rows) ** 2, 1e-3)[:, None, None] ** 2
    nv = np.maximum(np.linspace(0.0, 1.0, columns), 1e-3)[None, :, None]
    xi = (np.arange(_DIRECTIONS) + 0.5) / _DIRECTIONS
    angle = np.pi * ((np.arange(_DIRECTIONS) * 0.6180339887498949) % 1.0)
    nh = np.sqrt((1.0 - xi) / (1.0 + (a2 - 1.0) * xi))
    across = np.sqrt(np.maximum(1.0 - nh**2, 0.0)) * np.cos(angle)
    between = np.clip(np.sqrt(1.0 - nv**2) * across + nv * nh, 1e-6, 1.0)
    nl = 2.0 * between * nh - nv
    lit = nl > 0.0
    nl = np.where(lit, nl, 1.0)
    mask = nv * np.sqrt(a2 + (1.0 - a2) * nl**2) + nl * np.sqrt(a2 + (1.0 - a2) * nv**2)
    return np.where(lit, 2.0 * nl * between / (mask * nh), 0.0), between
