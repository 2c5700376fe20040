"""Where in a pixel the samples lie: a lattice, warped so that its mean is the pixel filter."""

from __future__ import annotations

import functools

import numpy as np
from numpy.typing import NDArray

_RADIUS = {"box": 0.5, "triangle": 1.0, "gaussian": 1.25, "blackmanHarris": 1.0}
"""Where a filter ends [px]."""


@functools.cache
def sample_offsets(
    count: int, pixel_filter: str, shift: tuple[float, float] = (0.0, 0.0)
) -> NDArray[np.float32]:
    """Return sample positions relative to the pixel's middle, the same for every pixel.

    A rank-1 lattice, chosen for its largest minimum distance, is mapped through the filter's
    inverse cumulative distribution (filter importance sampling, Ernst et al. 2006): equal weights,
    no noise, and a pixel never needs its neighbours.

    Args:
        count: Samples per pixel.
        pixel_filter: ``box``, ``triangle``, ``gaussian`` or ``blackmanHarris``.
        shift: Moves the lattice, around the unit square.

    Returns:
        (x, y) offsets [px], shape [count, 2].
    """
    if pixel_filter not in _RADIUS:
        raise ValueError(f"unknown pixel filter {pixel_filter!r}")
    index = np.arange(count)
    step = _best_generator(count)
    unit = np.stack([(index + 0.5) / count, (index * step % count + 0.5) / count], axis=-1)
    unit = (unit + np.array(shift)) % 1.0
    radius = _RADIUS[pixel_filter]
    x = np.linspace(-radius, radius, 4097)
    density = _density(pixel_filter, x / radius)
    cumulative = np.concatenate([[0.0], np.cumsum(0.5 * (density[1:] + density[:-1]))])
    return np.asarray(np.interp(unit, cumulative / cumulative[-1], x), np.float32)


def _density(pixel_filter: str, x: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return a filter's shape over [-1, 1]."""
    if pixel_filter == "box":
        return np.ones_like(x)
    if pixel_filter == "triangle":
        return np.asarray(1.0 - np.abs(x))
    if pixel_filter == "gaussian":
        return np.asarray(np.exp(-4.5 * x**2) - np.exp(-4.5))
    turn = np.pi * (x + 1.0)
    window: NDArray[np.float64] = (
        0.35875 - 0.48829 * np.cos(turn) + 0.14128 * np.cos(2 * turn) - 0.01168 * np.cos(3 * turn)
    )
    return window


def _best_generator(count: int) -> int:
    """Return the step of the rank-1 lattice whose points keep the farthest apart on the torus."""
    if count < 3:
        return 1
    if count > 256:  # the golden ratio is good enough, and the search below is quadratic
        step = round(count * 0.6180339887498949)
        while np.gcd(step, count) != 1:
            step += 1
        return step
    index = np.arange(1, count)
    best, widest = 1, -1.0
    for step in range(1, count):
        if np.gcd(step, count) != 1:
            continue
        dx = index / count
        dy = (index * step % count) / count
        dx, dy = np.minimum(dx, 1 - dx), np.minimum(dy, 1 - dy)
        distance = float((dx**2 + dy**2).min())
        if distance > widest + 1e-12:
            best, widest = step, distance
    return best
