"""What views are compared by: band-passed log-radiance and how it changes as the camera turns.

The logarithm makes a factor between views an offset, and the band-pass takes that offset away with
whatever else varies slowly: what is left of the vignetting, a veil of glare. A pyramid of it leads
from details of about 5 degrees, which errors of the stated rotations of that size do not tear
apart, to single pixels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.views.align_view import AlignView
from usdskin.fisheye import angle_to_radius, project, radius_slope
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]
Image = NDArray[np.float32]

_COARSEST_DEG = 2.0
"""The coarsest level's pixels are this wide or up to twice [deg]."""

_NARROWEST_PX = 16
"""Pictures narrower than this are not reduced further [px]."""

_DARK = 0.05
"""Share of the views' median at which the logarithm gives way to noise in the dark."""

_CONTRAST = 0.5
"""Band-passed logarithm beyond which contrast counts less and less, so that lamps do not rule."""

_FINE_DEG = 0.75
"""Pixels up to this wide are left out where the band-pass reaches far beyond the picture [deg]; on
coarser levels that would take all of a thin overlap."""

_COVERED = 0.85
"""Share of the band-pass that must lie in the picture: 2.3 pixels from a straight edge."""

_BINOMIAL = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 16.0


@dataclass(frozen=True, slots=True, eq=False)
class Level:
    """A view at one scale."""

    shrink: int
    """Pixels of the view's picture to one of this, along a side."""

    spacing: float
    """Angle between pixels on the axis [rad]."""

    channels: Image
    """Band-passed log-radiance, its derivatives along u and v [px^-1 of the view's picture] and
    the log-radiance itself, shape [height * width, 4]."""

    usable: NDArray[np.bool_]
    """Whether the pixel and its right, lower and lower right neighbours are valid, shape
    [height, width]."""


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """A view at directions it sees."""

    band: FloatArray
    """Band-passed log-radiance [1], shape [count]."""

    moment: FloatArray
    """Its decrease per small rotation of the camera, in the panorama's frame [rad^-1], shape
    [count, 3]."""

    log: FloatArray
    """Log-radiance [1], shape [count]."""


def build_levels(views: Sequence[AlignView]) -> list[list[Level]]:
    """Return the pyramid of every view, the finest level first."""
    light = [view.values.mean(axis=2, dtype=np.float64) for view in views]
    seen = [values[view.valid] for values, view in zip(light, views, strict=True)]
    positive = np.concatenate([values[values > 0.0] for values in seen] or [np.ones(1)])
    floor = _DARK * float(np.median(positive)) if positive.size else 1.0
    return [
        _pyramid(np.log(np.maximum(values, 0.0) + floor), view.valid, view.lens)
        for values, view in zip(light, views, strict=True)
    ]


def sample(
    level: Level, lens: FisheyeLens, rotation: FloatArray, directions: FloatArray
) -> tuple[NDArray[np.bool_], Samples]:
    """Look a view up.

    Args:
        level: The view.
        lens: Lens of its whole picture.
        rotation: From the camera to the panorama, shape [3, 3].
        directions: In the panorama's frame, shape [count, 3].

    Returns:
        Which directions the view sees, shape [count], and it at those.
    """
    rays = np.einsum("ij,nj->ni", rotation.T, directions)
    inside, found = _look_up(level, lens, rays, level.channels)
    moment = _moment(lens, rays[inside], found[:, 1], found[:, 2])
    return inside, Samples(found[:, 0], np.einsum("ij,nj->ni", rotation, moment), found[:, 3])


def sample_band(
    level: Level, lens: FisheyeLens, rotation: FloatArray, directions: FloatArray
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Look up the band-passed log-radiance alone; see ``sample``."""
    rays = np.einsum("ij,nj->ni", rotation.T, directions)
    inside, found = _look_up(level, lens, rays, level.channels[:, :1])
    return inside, found[:, 0]


def _look_up(
    level: Level, lens: FisheyeLens, rays: FloatArray, channels: Image
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return which rays of the camera meet usable pixels, and the pixels there, bilinearly."""
    positions = project(lens, rays) / level.shrink - 0.5
    height, width = level.usable.shape
    # Those that see nothing are NaN, and NaN is not above 0.
    u, v = positions.T
    inside = (u >= 0.0) & (u < width - 1) & (v >= 0.0) & (v < height - 1)
    corner = np.where(inside[:, None], positions, 0.0).astype(np.int64)
    inside &= level.usable[corner[:, 1], corner[:, 0]]
    corner = corner[inside]
    s, t = (positions[inside] - corner).T[..., None]
    first = corner[:, 1] * width + corner[:, 0]
    above = (1.0 - s) * channels[first] + s * channels[first + 1]
    below = (1.0 - s) * channels[first + width] + s * channels[first + width + 1]
    return inside, (1.0 - t) * above + t * below


def _moment(lens: FisheyeLens, rays: FloatArray, by_u: FloatArray, by_v: FloatArray) -> FloatArray:
    """Return x cross the gradient over the sphere, for rays x of the camera, shape [count, 3].

    A step dphi moves the image by r' dphi outwards, a step dpsi / sin(phi) around the axis by
    r dpsi / sin(phi).
    """
    x, y, z = rays.T
    sine = np.hypot(x, y)
    phi = np.arctan2(sine, -z)
    on_axis = sine < 1e-9
    safe = np.where(on_axis, 1.0, sine)
    c, s = np.where(on_axis, 1.0, x / safe), np.where(on_axis, 0.0, y / safe)
    around = np.where(on_axis, lens.focal_length_px, angle_to_radius(lens, phi) / safe)
    outward = radius_slope(lens, phi) * (by_u * c - by_v * s)
    across = around * (-by_u * s - by_v * c)
    along_phi = np.stack([-z * c, -z * s, sine], axis=1)
    along_psi = np.stack([-s, c, np.zeros_like(c)], axis=1)
    return np.asarray(along_phi * across[:, None] - along_psi * outward[:, None])


def _pyramid(log: FloatArray, valid: NDArray[np.bool_], lens: FisheyeLens) -> list[Level]:
    weight = valid.astype(np.float32)
    picture = (log * weight).astype(np.float32)
    levels: list[Level] = []
    shrink = 1
    while True:
        levels.append(_level(picture, weight, shrink, lens))
        if np.degrees(levels[-1].spacing) >= _COARSEST_DEG or min(picture.shape) < _NARROWEST_PX:
            return levels
        picture, weight = _halved(picture), _halved(weight)
        share = np.where(weight > 0.0, weight, 1.0)
        keep = weight >= 0.5
        picture, weight = np.where(keep, picture / share, 0.0), keep.astype(np.float32)
        shrink *= 2


def _level(picture: Image, weight: Image, shrink: int, lens: FisheyeLens) -> Level:
    near, near_weight = _blur(picture, 1), _blur(weight, 1)
    wide, wide_weight = _blur(near, 2), _blur(near_weight, 2)
    valid = weight > 0.0
    one = np.float32(1.0)
    near /= np.where(valid, near_weight, one)
    band = near - wide / np.where(valid, wide_weight, one)
    band = np.where(valid, _CONTRAST * np.tanh(band / _CONTRAST), np.float32(0.0))
    by_u = 0.5 * (np.roll(band, -1, axis=1) - np.roll(band, 1, axis=1))
    by_v = 0.5 * (np.roll(band, -1, axis=0) - np.roll(band, 1, axis=0))
    inner = ~_grown(~valid)  # derivatives reach one pixel farther
    if np.degrees(shrink / lens.focal_length_px) < _FINE_DEG:
        inner &= wide_weight >= _COVERED
    usable = np.zeros_like(valid)
    usable[:-1, :-1] = inner[:-1, :-1] & inner[1:, :-1] & inner[:-1, 1:] & inner[1:, 1:]
    channels = np.stack([band, by_u / shrink, by_v / shrink, near], axis=-1, dtype=np.float32)
    return Level(
        shrink=shrink,
        spacing=shrink / lens.focal_length_px,
        channels=channels.reshape(-1, 4),
        usable=usable,
    )


def _grown(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    padded = np.pad(mask, 1, constant_values=True)
    middle = padded[1:-1, 1:-1] | padded[:-2, 1:-1] | padded[2:, 1:-1]
    return np.asarray(middle | padded[1:-1, :-2] | padded[1:-1, 2:])


def _blur(picture: Image, step: int) -> Image:
    """Convolve with the binomial of 5 taps, ``step`` pixels apart: deviation ``step`` pixels."""
    for axis in (0, 1):
        margin = [(0, 0), (0, 0)]
        margin[axis] = (2 * step, 2 * step)
        padded = np.pad(picture, margin)
        length = picture.shape[axis]
        total = np.zeros_like(picture)
        for tap, share in enumerate(_BINOMIAL):
            window: list[Any] = [slice(None), slice(None)]
            window[axis] = slice(tap * step, tap * step + length)
            total += np.float32(share) * padded[tuple(window)]
        picture = total
    return picture


def _halved(picture: Image) -> Image:
    """Return means of 2 x 2 pixels; what is missing at the right and below counts as 0."""
    height, width = picture.shape
    padded = np.pad(picture, ((0, height % 2), (0, width % 2)))
    tall, wide = padded.shape
    return np.asarray(padded.reshape(tall // 2, 2, wide // 2, 2).mean(axis=(1, 3)))
