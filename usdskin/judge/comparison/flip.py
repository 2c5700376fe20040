"""LDR-FLIP: how different two pictures look when one alternates with the other on a display.

P. Andersson, J. Nilsson, T. Akenine-Moller, M. Oskarsson, K. Astrom and M. D. Fairchild, "FLIP: A
Difference Evaluator for Alternating Images", Proc. ACM Comput. Graph. Interact. Tech. 3(2), 2020.
Section and equation names below are those of the paper.
"""

from __future__ import annotations

from functools import cache

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import rgb_to_xyz, xyz_to_lab, xyz_to_rgb

FloatArray = NDArray[np.float64]

PIXELS_PER_DEGREE = 67.0
"""The paper's viewing condition: a 4K display of 0.7 m seen from 0.7 m."""

_SPACE = "lin_rec709_scene"
_WHITE = rgb_to_xyz(_SPACE) @ np.ones(3)

# Contrast sensitivity as sums of Gaussians a sqrt(pi / b) exp(-pi^2 x^2 / b), x in degrees:
# (a, b) of the achromatic, the red-green and the blue-yellow channel (table 1).
_SENSITIVITY = (((1.0, 0.0047),), ((1.0, 0.0053),), ((34.1, 0.04), (13.5, 0.025)))
_WIDEST = 0.04
_COLOR_POWER = 0.7
_SHARE_OF_LARGEST, _ITS_VALUE = 0.4, 0.95
_FEATURE_WIDTH = 0.082  # degrees
_FEATURE_POWER = 0.5


def flip_differences(
    picture: ArrayLike, truth: ArrayLike, pixels_per_degree: float = PIXELS_PER_DEGREE
) -> FloatArray:
    """Return the LDR-FLIP difference of each pixel.

    Args:
        picture: Linear Rec. 709, display white at 1, shape [height, width, 3]; clipped to 0..1.
        truth: What it is compared with, the same shape.
        pixels_per_degree: Of visual angle, by size, resolution and distance of the display.

    Returns:
        Differences from 0 (none) to 1, shape [height, width].

    Raises:
        ValueError: The shapes differ or the viewing condition is not positive.
    """
    test, reference = (
        np.clip(np.asarray(image, np.float64), 0.0, 1.0) for image in (picture, truth)
    )
    if test.shape != reference.shape or test.ndim != 3 or test.shape[2] != 3:
        raise ValueError(f"pictures of shape {test.shape} and {reference.shape}")
    if not 0.0 < pixels_per_degree < np.inf:
        raise ValueError(f"{pixels_per_degree} pixels per degree")
    opponent = [_opponent(image) for image in (test, reference)]
    color = _color_difference(*(_seen(image, pixels_per_degree) for image in opponent))
    lightness = [(image[..., 0] + 16.0) / 116.0 for image in opponent]
    feature = _feature_difference(lightness[0], lightness[1], pixels_per_degree)
    return np.asarray(color ** (1.0 - feature))


def _opponent(rgb: FloatArray) -> FloatArray:
    """Return Y_y C_x C_z, the linearised L*a*b* in which contrast sensitivity was measured."""
    x, y, z = np.moveaxis(rgb @ rgb_to_xyz(_SPACE).T / _WHITE, -1, 0)
    return np.stack([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)], axis=-1)


def _from_opponent(opponent: FloatArray) -> FloatArray:
    y = (opponent[..., 0] + 16.0) / 116.0
    x = y + opponent[..., 1] / 500.0
    z = y - opponent[..., 2] / 200.0
    return np.asarray((np.stack([x, y, z], axis=-1) * _WHITE) @ xyz_to_rgb(_SPACE).T)


def _correlate(channel: FloatArray, rows: FloatArray, columns: FloatArray) -> FloatArray:
    from scipy.ndimage import correlate1d

    down = correlate1d(channel, rows, axis=0, mode="nearest")
    return np.asarray(correlate1d(down, columns, axis=1, mode="nearest"))


def _seen(opponent: FloatArray, pixels_per_degree: float) -> FloatArray:
    """Return the L*, a*, b* that remain after the eye's contrast sensitivity, Hunt-adjusted."""
    deviation = np.sqrt(_WIDEST / (2.0 * np.pi**2))
    radius = int(np.ceil(3.0 * deviation * pixels_per_degree))
    x = np.arange(-radius, radius + 1) / pixels_per_degree
    filtered = np.empty_like(opponent)
    for channel, terms in enumerate(_SENSITIVITY):
        parts = [(a * np.sqrt(np.pi / b), np.exp(-(np.pi**2) * x**2 / b)) for a, b in terms]
        total = sum(weight * gauss.sum() ** 2 for weight, gauss in parts)
        filtered[..., channel] = sum(
            weight / total * _correlate(opponent[..., channel], gauss, gauss)
            for weight, gauss in parts
        )
    return _hunt_adjusted(np.clip(_from_opponent(filtered), 0.0, 1.0))


def _hunt_adjusted(rgb: FloatArray) -> FloatArray:
    """Return L*a*b* with less chroma where it is dark."""
    lab = xyz_to_lab(rgb @ rgb_to_xyz(_SPACE).T, _WHITE)
    lab[..., 1:] *= 0.01 * lab[..., :1]
    return lab


def _hyab(first: FloatArray, second: FloatArray) -> FloatArray:
    difference = first - second
    return np.asarray(np.abs(difference[..., 0]) + np.hypot(difference[..., 1], difference[..., 2]))


@cache
def _largest() -> float:
    """Return the largest difference that is met: of green and blue."""
    green, blue = (_hunt_adjusted(np.array(rgb)) for rgb in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    return float(_hyab(green, blue) ** _COLOR_POWER)


def _color_difference(first: FloatArray, second: FloatArray) -> FloatArray:
    difference = _hyab(first, second) ** _COLOR_POWER
    largest = _largest()
    knee = _SHARE_OF_LARGEST * largest
    below = _ITS_VALUE / knee * difference
    above = _ITS_VALUE + (difference - knee) / (largest - knee) * (1.0 - _ITS_VALUE)
    return np.where(difference < knee, below, above)


def _feature_difference(
    first: FloatArray, second: FloatArray, pixels_per_degree: float
) -> FloatArray:
    """Return how edges and points differ."""
    deviation = 0.5 * _FEATURE_WIDTH * pixels_per_degree
    radius = int(np.ceil(3.0 * deviation))
    x = np.arange(-radius, radius + 1, dtype=np.float64)
    gauss = np.exp(-(x**2) / (2.0 * deviation**2))
    strongest = np.zeros(first.shape)
    for along in (-x * gauss, (x**2 / deviation**2 - 1.0) * gauss):
        # The positive weights of the two-dimensional filter add up to 1, the negative ones to -1.
        scaled = np.where(along > 0.0, along / along[along > 0.0].sum(), along)
        scaled = np.where(along < 0.0, along / -along[along < 0.0].sum(), scaled) / gauss.sum()
        sizes = [
            np.hypot(_correlate(image, gauss, scaled), _correlate(image, scaled, gauss))
            for image in (first, second)
        ]
        strongest = np.maximum(strongest, np.abs(sizes[0] - sizes[1]))
    return np.asarray((strongest / np.sqrt(2.0)) ** _FEATURE_POWER)
