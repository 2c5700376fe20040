"""Low-discrepancy samples keyed by pixel, and the maps from the unit square to directions.

Sobol' points (direction numbers of Joe and Kuo 2008), nested-uniformly scrambled by a hash (Laine
and Karras 2011, constants of Vegdahl 2021; Burley 2020). A point depends on its key and index
alone, so pictures do not depend on tiles, threads or order.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

wp.set_module_options({"enable_backward": False})

PI = wp.constant(3.14159265358979)
TWO_PI = wp.constant(6.28318530717959)

_GOLDEN = wp.constant(wp.uint32(0x9E3779B9))
_MIX_A = wp.constant(wp.uint32(0x7FEB352D))
_MIX_B = wp.constant(wp.uint32(0x846CA68B))

DIMENSIONS = 12
"""Dimensions of the table of direction numbers."""

_POLYNOMIALS = (
    (0, (1,)),
    (1, (1, 3)),
    (1, (1, 3, 1)),
    (2, (1, 1, 1)),
    (1, (1, 1, 3, 3)),
    (4, (1, 3, 5, 13)),
    (2, (1, 1, 5, 5, 17)),
    (4, (1, 1, 5, 5, 5)),
    (7, (1, 1, 7, 11, 19)),
    (11, (1, 1, 5, 1, 1)),
    (13, (1, 1, 1, 3, 11)),
)
"""Primitive polynomials and initial numbers of dimensions 2 to 12 (new-joe-kuo-6.21201)."""


def direction_numbers() -> NDArray[np.uint32]:
    """Return Sobol' direction numbers, most significant bit first, shape [DIMENSIONS, 32]."""
    table = np.zeros((DIMENSIONS, 32), np.uint32)
    table[0] = [1 << (31 - k) for k in range(32)]
    for dimension, (coefficients, initial) in enumerate(_POLYNOMIALS, start=1):
        degree = len(initial)
        numbers = [m << (31 - k) for k, m in enumerate(initial)]
        for k in range(degree, 32):
            value = numbers[k - degree] ^ (numbers[k - degree] >> degree)
            for j in range(1, degree):
                if (coefficients >> (degree - 1 - j)) & 1:
                    value ^= numbers[k - j]
            numbers.append(value)
        table[dimension] = numbers
    return table


@wp.func
def hash_pair(a: wp.uint32, b: wp.uint32) -> wp.uint32:
    """Mix two numbers to one whose bits look independent (C. Wellons's lowbias32, twice)."""
    x = a ^ (b * _GOLDEN)
    for _k in range(2):
        x = x ^ (x >> wp.uint32(16))
        x = x * _MIX_A
        x = x ^ (x >> wp.uint32(15))
        x = x * _MIX_B
        x = x ^ (x >> wp.uint32(16))
        x = x + b
    return x


@wp.func
def _swap(x: wp.uint32, mask: wp.uint32, step: wp.uint32) -> wp.uint32:
    return ((x >> step) & mask) | ((x & mask) << step)


@wp.func
def _reverse(x: wp.uint32) -> wp.uint32:
    x = (x >> wp.uint32(16)) | (x << wp.uint32(16))
    x = _swap(x, wp.uint32(0x00FF00FF), wp.uint32(8))
    x = _swap(x, wp.uint32(0x0F0F0F0F), wp.uint32(4))
    x = _swap(x, wp.uint32(0x33333333), wp.uint32(2))
    return _swap(x, wp.uint32(0x55555555), wp.uint32(1))


@wp.func
def _scramble(x: wp.uint32, key: wp.uint32) -> wp.uint32:
    """Permute the elementary intervals of a point: Owen's nested uniform scrambling."""
    y = _reverse(x)
    y = y ^ (y * wp.uint32(0x3D20ADEA))
    y = y + key
    y = y * ((key >> wp.uint32(16)) | wp.uint32(1))
    y = y ^ (y * wp.uint32(0x05526C56))
    y = y ^ (y * wp.uint32(0x53A22864))
    return _reverse(y)


@wp.func
def low_discrepancy(
    table: wp.array2d[wp.uint32], key: wp.uint32, index: wp.int32, dimension: wp.int32
) -> wp.float32:
    """Return coordinate ``dimension`` of point ``index`` of the sequence ``key``, in [0, 1)."""
    bits = wp.uint32(0)
    rest = wp.uint32(index)
    k = int(0)
    while rest != wp.uint32(0):
        if (rest & wp.uint32(1)) != wp.uint32(0):
            bits = bits ^ table[dimension, k]
        rest = rest >> wp.uint32(1)
        k = k + 1
    bits = _scramble(bits, hash_pair(key, wp.uint32(dimension + 1)))
    return wp.float32(bits >> wp.uint32(8)) * (1.0 / 16777216.0)


@wp.func
def disk_from_square(u: wp.vec2f) -> wp.vec2f:
    """Map the unit square to the unit disk, areas and neighbours kept (Shirley and Chiu 1997)."""
    x = 2.0 * u[0] - 1.0
    y = 2.0 * u[1] - 1.0
    if x == 0.0 and y == 0.0:
        return wp.vec2f(0.0, 0.0)
    if wp.abs(x) > wp.abs(y):
        angle = 0.25 * PI * y / x
        return wp.vec2f(x * wp.cos(angle), x * wp.sin(angle))
    angle = 0.5 * PI - 0.25 * PI * x / y
    return wp.vec2f(y * wp.cos(angle), y * wp.sin(angle))


@wp.func
def tangent_of(axis: wp.vec3f) -> wp.vec3f:
    """Return a unit vector across a unit axis, continuous but for one half plane (Duff 2017)."""
    sign = 1.0
    if axis[2] < 0.0:
        sign = -1.0
    a = -1.0 / (sign + axis[2])
    b = axis[0] * axis[1] * a
    return wp.vec3f(1.0 + sign * axis[0] * axis[0] * a, sign * b, -sign * axis[0])


@wp.func
def around(axis: wp.vec3f, local: wp.vec3f) -> wp.vec3f:
    """Turn a vector from a frame whose z is ``axis`` to that of the axis."""
    tangent = tangent_of(axis)
    return local[0] * tangent + local[1] * wp.cross(axis, tangent) + local[2] * axis
