"""What a meter would read of a panorama: irradiance, radiance of a spot, shares of the sphere.

Texels of a latlong map are patches of constant radiance (``usdskin.latlong``), so all integrals
here are sums of closed forms: a uniform map gives pi L in every direction at any resolution.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.latlong import latlong_coordinates, texel_solid_angles

FloatArray = NDArray[np.float64]

_BLOCK_TEXELS = 1 << 20
_NODES, _NODE_WEIGHTS = np.polynomial.legendre.leggauss(32)
_SPOT_RINGS = 64


def texel_vectors(height: int, width: int) -> tuple[FloatArray, FloatArray]:
    """Return the integral of the direction over each texel, as factors of rows and columns.

    Component k of texel (i, j) is ``row_factors[i, k] * column_factors[j, k]`` [sr]; its product
    with a direction n is the texel's projected solid angle where all of it is above n's horizon.

    Returns:
        Row factors, shape [height, 3], and column factors, shape [width, 3].
    """
    step = np.pi / height
    polar = (np.arange(height) + 0.5) * step
    turn = 2.0 * np.pi / width
    azimuth = (np.arange(width) + 0.5) * turn
    # Integrals of sin^2 and sin cos over the polar angle, free of cancellation at the poles.
    across = 0.5 * (step - np.sin(step) * np.cos(2.0 * polar))
    upward = 0.5 * np.sin(step) * np.sin(2.0 * polar)
    chord = 2.0 * np.sin(0.5 * turn)
    rows = np.stack([across, upward, -across], axis=-1)
    columns = np.stack(
        [chord * np.sin(azimuth), np.full(width, turn), chord * np.cos(azimuth)], axis=-1
    )
    return rows, columns


def cosine_weights(
    rows: NDArray[np.integer[Any]],
    columns: NDArray[np.integer[Any]],
    height: int,
    width: int,
    direction: ArrayLike,
) -> FloatArray:
    """Return the integral of max(n . omega, 0) over texels of a latlong map [sr].

    It is exact where a texel lies wholly on one side of n's horizon. Where the horizon cuts it,
    azimuth is integrated exactly and the polar angle by a 32-point Gauss-Legendre rule.

    Args:
        rows: Rows of the texels, any shape that broadcasts with ``columns``.
        columns: Their columns.
        height: Rows of the map.
        width: Columns of the map.
        direction: n, where a surface faces, in the map's frame, of any length, shape [3].
    """
    normal = np.asarray(direction, dtype=np.float64)
    normal = normal / np.linalg.norm(normal)
    row_factors, column_factors = texel_vectors(height, width)
    by_row = row_factors * normal
    weights = np.zeros(np.broadcast_shapes(rows.shape, columns.shape))
    for axis in range(3):
        weights += by_row[rows, axis] * column_factors[columns, axis]
    size = texel_solid_angles(height, width)[rows]
    # n . omega changes by no more than the angle from a texel's middle to its corner.
    cut = np.abs(weights) < 1.01 * size * np.hypot(np.pi / height, 2.0 * np.pi / width)
    np.maximum(weights, 0.0, out=weights)
    if cut.any():
        every_row, every_column = np.broadcast_arrays(rows, columns)
        weights[cut] = _cut_weights(every_row[cut], every_column[cut], height, width, normal)
    return weights


def _cut_weights(
    rows: NDArray[np.integer[Any]],
    columns: NDArray[np.integer[Any]],
    height: int,
    width: int,
    normal: FloatArray,
) -> FloatArray:
    """Return the integral of max(n . omega, 0) over texels that n's horizon may cut, shape [n]."""
    polar = (rows[:, None] + 0.5 + 0.5 * _NODES) * (np.pi / height)
    turn = 2.0 * np.pi / width
    # At one polar angle n . omega = lift + swing cos(azimuth - heading), above 0 within ``reach``.
    heading = np.arctan2(normal[0], -normal[2])
    lift = normal[1] * np.cos(polar)
    swing = np.hypot(normal[0], normal[2]) * np.sin(polar)
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.where(swing > 0.0, -lift / swing, -np.sign(lift))
    reach = np.arccos(np.clip(ratio, -1.0, 1.0))
    middle = ((columns[:, None] + 0.5) * turn - heading + np.pi) % (2.0 * np.pi) - np.pi
    total = np.zeros(polar.shape)
    for around in (-2.0 * np.pi, 0.0, 2.0 * np.pi):
        begin = np.maximum(middle - 0.5 * turn, around - reach)
        end = np.maximum(np.minimum(middle + 0.5 * turn, around + reach), begin)
        total += lift * (end - begin) + swing * (np.sin(end) - np.sin(begin))
    weights: FloatArray = (total * np.sin(polar)) @ _NODE_WEIGHTS * (0.5 * np.pi / height)
    return weights


def irradiance(values: NDArray[np.floating[Any]], direction: ArrayLike) -> FloatArray:
    """Return the irradiance of a surface, the integral of max(n . omega, 0) L over the sphere.

    Args:
        values: L, latlong map, shape [height, width, channels] or [height, width].
        direction: n, where the surface faces, in the map's frame, shape [3].

    Returns:
        Irradiance [unit of ``values`` times sr], shape [channels] or [].
    """
    height, width = values.shape[:2]
    columns = np.arange(width)[None, :]
    count = max(1, _BLOCK_TEXELS // width)
    total = np.zeros(values.shape[2:])
    for begin in range(0, height, count):
        rows = np.arange(begin, min(begin + count, height))[:, None]
        weights = cosine_weights(rows, columns, height, width, direction)
        total += np.tensordot(weights, values[begin : begin + count].astype(np.float64), 2)
    return total


def radiance_at(
    values: NDArray[np.floating[Any]], direction: ArrayLike, radius_deg: float
) -> FloatArray:
    """Return the mean of a map over a round spot, as a spot meter takes it.

    The spot is covered by rays of equal solid angle; each meets the texel it falls in.

    Args:
        values: Latlong map, shape [height, width, channels] or [height, width].
        direction: Middle of the spot in the map's frame, of any length, shape [3].
        radius_deg: Radius of the spot [deg].

    Returns:
        The mean, shape [channels] or [].
    """
    height, width = values.shape[:2]
    u, v = latlong_coordinates(_spot_rays(np.asarray(direction, dtype=np.float64), radius_deg))
    rows = np.minimum((v * height).astype(np.intp), height - 1)
    columns = np.minimum((u * width).astype(np.intp), width - 1)
    return np.asarray(values[rows, columns].astype(np.float64).mean(axis=0))


def _spot_rays(direction: FloatArray, radius_deg: float) -> FloatArray:
    """Return directions of equal solid angle that fill a spot, shape [count, 3]."""
    axis = direction / np.linalg.norm(direction)
    aside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    aside /= np.linalg.norm(aside)
    count = _SPOT_RINGS**2
    # Vogel's spiral: equal steps of area outwards, golden angle around.
    area = (np.arange(count) + 0.5) / count
    half = np.sin(0.5 * np.deg2rad(radius_deg)) ** 2 * area
    cosine, sine = 1.0 - 2.0 * half, 2.0 * np.sqrt(half * (1.0 - half))
    around = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    across = np.cos(around)[:, None] * aside + np.sin(around)[:, None] * np.cross(axis, aside)
    return np.asarray(cosine[:, None] * axis + sine[:, None] * across)


def flux(values: NDArray[np.floating[Any]]) -> FloatArray:
    """Return the integral of a latlong map over the sphere [unit of ``values`` times sr].

    Args:
        values: Latlong map, shape [height, width, channels] or [height, width].
    """
    by_row = values.sum(axis=1, dtype=np.float64)
    return np.asarray(texel_solid_angles(*values.shape[:2]) @ by_row)


def sphere_share(share: NDArray[Any]) -> float:
    """Return the share of the sphere that a map of shares, or a mask, covers [1].

    Args:
        share: Share of each texel, or whether it counts, shape [height, width].
    """
    return float(flux(share)) / (4.0 * np.pi)
