"""Fisheye projections on the host: directions in the camera <-> positions in the picture, float64.

The camera looks along -Z with +Y up; positions (u, v) are in pixels from the corner of the first
one, u to the right, v down. With phi the angle from the optical axis, r(phi) the image height [px]
and psi = atan2(-(v - cy), u - cx), a ray is (sin phi cos psi, sin phi sin psi, -cos phi).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import LayerError
from usdskin.prims.lenses import FisheyeLens

FloatArray = NDArray[np.float64]

_RIM = 1e-12
"""Relative slack at the rim of the picture, so that what lies on it stays in through rounding."""

_NEWTON_STEPS = 100


class _Projection(NamedTuple):
    """r / f, its inverse and its derivative over phi, and the angle at which it ends [rad]."""

    height: Callable[[FloatArray], FloatArray]
    angle: Callable[[FloatArray], FloatArray]
    slope: Callable[[FloatArray], FloatArray]
    end: float
    is_end_included: bool = True


_PROJECTIONS = {
    "equidistant": _Projection(lambda phi: phi, lambda y: y, np.ones_like, np.pi),
    "equisolid": _Projection(
        lambda phi: 2.0 * np.sin(0.5 * phi),
        lambda y: 2.0 * np.arcsin(0.5 * y),
        lambda phi: np.cos(0.5 * phi),
        np.pi,
    ),
    "stereographic": _Projection(
        lambda phi: 2.0 * np.tan(0.5 * phi),
        lambda y: 2.0 * np.arctan(0.5 * y),
        lambda phi: np.cos(0.5 * phi) ** -2,
        np.pi,
        is_end_included=False,
    ),
    "orthographic": _Projection(np.sin, np.arcsin, np.cos, 0.5 * np.pi),
}
"""All but ``opencv``, whose polynomial is the lens's own."""


def check_lens(lens: FisheyeLens, where: str) -> None:
    """Refuse a lens whose projection or vignetting fails before its largest angle.

    Args:
        lens: The lens.
        where: Layer and prim path, for the error.

    Raises:
        LayerError: The image height stops growing, or the vignetting reaches 0, before the largest
            angle, which the message names; or the axis misses the picture.
    """
    angle = lens.max_angle_deg
    if not 0.0 < angle <= 180.0:
        raise LayerError(
            f"{where}: fisheye:maxAngle is {angle:g} deg; give what the picture holds, above 0 and "
            "at most 180"
        )
    x, y = (float(value) for value in lens.center_px)
    if not (0.0 < x < lens.resolution[0] and 0.0 < y < lens.resolution[1]):
        raise LayerError(
            f"{where}: fisheye:center is ({x:g}, {y:g}), outside the picture of "
            f"{lens.resolution[0]} x {lens.resolution[1]} pixels; give pixels from the top left "
            "corner"
        )
    end, is_included = _end(lens)
    if np.radians(angle) > end + _RIM or (not is_included and np.radians(angle) > end - 1e-6):
        raise LayerError(
            f"{where}: fisheye:maxAngle is {angle:g} deg, but image height stops growing at "
            f"{np.degrees(end):.4g} deg with fisheye:projection {lens.projection}; lower maxAngle, "
            "or correct the projection"
        )
    zero = _first_root(np.concatenate([[1.0], lens.vignetting]))
    if zero <= np.radians(angle):
        raise LayerError(
            f"{where}: fisheye:vignetting falls to 0 at {np.degrees(zero):.4g} deg, within the "
            f"fisheye:maxAngle of {angle:g} deg; lower maxAngle, or measure the vignetting farther"
        )


def project(lens: FisheyeLens, rays: ArrayLike) -> FloatArray:
    """Return where rays meet the picture [px], shape [..., 2]; NaN beyond the largest angle.

    Args:
        lens: The lens.
        rays: Directions in the camera, of any length, shape [..., 3].
    """
    x, y, z = np.moveaxis(np.asarray(rays, np.float64), -1, 0)
    across = np.hypot(x, y)
    phi = np.arctan2(across, -z)
    is_seen = phi <= np.radians(lens.max_angle_deg) * (1.0 + _RIM)
    radius = angle_to_radius(lens, np.where(is_seen, phi, np.nan))
    per_length = np.divide(radius, across, out=np.zeros_like(radius), where=across > 0.0)
    per_length = np.where(is_seen, per_length, np.nan)
    return np.stack(
        [lens.center_px[0] + per_length * x, lens.center_px[1] - per_length * y], axis=-1
    )


def unproject(lens: FisheyeLens, positions: ArrayLike) -> FloatArray:
    """Return the unit rays of positions, shape [..., 3]; NaN beyond the largest angle.

    Args:
        lens: The lens.
        positions: (u, v) [px], shape [..., 2].
    """
    offset = np.asarray(positions, np.float64) - lens.center_px
    radius = np.hypot(offset[..., 0], offset[..., 1])
    phi = radius_to_angle(lens, radius)
    sine = np.sin(phi)
    per_px = np.divide(sine, radius, out=np.zeros_like(radius), where=radius > 0.0)
    return np.stack([per_px * offset[..., 0], -per_px * offset[..., 1], -np.cos(phi)], axis=-1)


def angle_to_radius(lens: FisheyeLens, phi: ArrayLike) -> FloatArray:
    """Return the image height r [px] at angles from the axis [rad], of the same shape."""
    phi = np.asarray(phi, np.float64)
    if lens.projection == "opencv":
        return np.asarray(lens.focal_length_px * phi * _even(_heights(lens), phi))
    return np.asarray(lens.focal_length_px * _PROJECTIONS[lens.projection].height(phi))


def radius_to_angle(lens: FisheyeLens, radius: ArrayLike) -> FloatArray:
    """Return the angles from the axis [rad] of image heights [px]; NaN beyond the largest angle."""
    radius = np.asarray(radius, np.float64)
    largest = np.radians(lens.max_angle_deg)
    inside = np.where(radius <= max_radius(lens) * (1.0 + _RIM), radius, np.nan)
    height = inside / lens.focal_length_px
    if lens.projection == "opencv":
        return _invert(_heights(lens), height, largest)
    known = _PROJECTIONS[lens.projection]
    ceiling = known.height(np.asarray(largest))  # rounding must not leave the domain of arcsin
    return known.angle(np.minimum(height, ceiling))


def radius_slope(lens: FisheyeLens, phi: ArrayLike) -> FloatArray:
    """Return dr / dphi [px rad^-1] at angles from the axis [rad], of the same shape."""
    phi = np.asarray(phi, np.float64)
    if lens.projection == "opencv":
        coefficients = _heights(lens)
        odd = 2.0 * np.arange(len(coefficients)) + 1.0
        return np.asarray(lens.focal_length_px * _even(odd * coefficients, phi))
    return np.asarray(lens.focal_length_px * _PROJECTIONS[lens.projection].slope(phi))


def max_radius(lens: FisheyeLens) -> float:
    """Return the radius of the circle that holds picture [px]."""
    return float(angle_to_radius(lens, np.radians(lens.max_angle_deg)))


def vignetting(lens: FisheyeLens, phi: ArrayLike) -> FloatArray:
    """Return V = 1 + a2 phi^2 + a4 phi^4 + ... at angles from the axis [rad], of the same shape."""
    return _even(np.concatenate([[1.0], lens.vignetting]), np.asarray(phi, np.float64))


def pixel_solid_angle(lens: FisheyeLens, positions: ArrayLike) -> FloatArray:
    """Return the solid angle of a pixel around positions [sr px^-2], shape [...].

    It is sin phi dphi / (r dr): for the equidistant projection sin(phi) / (phi f^2). NaN beyond
    the largest angle.

    Args:
        lens: The lens.
        positions: (u, v) [px], shape [..., 2].
    """
    offset = np.asarray(positions, np.float64) - lens.center_px
    radius = np.hypot(offset[..., 0], offset[..., 1])
    phi = radius_to_angle(lens, radius)
    # sin(phi) / r tends to 1 / f on the axis, whatever the projection.
    on_axis = np.full_like(radius, 1.0 / lens.focal_length_px)
    sine_per_px = np.divide(np.sin(phi), radius, out=on_axis, where=radius > 0.0)
    with np.errstate(divide="ignore"):  # orthographic at 90 deg: a rim without width
        return np.asarray(sine_per_px / radius_slope(lens, phi))


def scaled(lens: FisheyeLens, resolution: tuple[int, int], where: str) -> FisheyeLens:
    """Return the lens for pictures of another size, which show the same, enlarged or reduced.

    Args:
        lens: The lens.
        resolution: Width and height of the pictures [px].
        where: Layer and prim path, for the error.

    Raises:
        LayerError: The pictures have another aspect ratio, so are cropped in an unknown way.
    """
    if resolution == lens.resolution:
        return lens
    size, known = np.array(resolution, np.float64), np.array(lens.resolution, np.float64)
    factor = size / known
    if not (factor > 0.0).all() or abs(factor[0] * known[1] - size[1]) > 1.0:
        raise LayerError(
            f"{where}: the pictures have {resolution[0]} x {resolution[1]} pixels, but "
            f"fisheye:resolution is {lens.resolution[0]} x {lens.resolution[1]}, of another aspect "
            "ratio; use pictures that are not cropped, or calibrate the lens for these"
        )
    return replace(
        lens,
        focal_length_px=float(lens.focal_length_px * np.sqrt(factor.prod())),
        center_px=lens.center_px * factor,
        resolution=resolution,
    )


def _heights(lens: FisheyeLens) -> FloatArray:
    """Return the coefficients of ``opencv``'s r / (f phi) over phi^2: 1, k1, k2, ..."""
    return np.concatenate([[1.0], lens.distortion])


def _even(coefficients: FloatArray, phi: FloatArray) -> FloatArray:
    """Return the polynomial in phi^2 with ascending coefficients."""
    return np.asarray(np.polynomial.polynomial.polyval(phi * phi, coefficients))


def _end(lens: FisheyeLens) -> tuple[float, bool]:
    """Return the angle up to which image height grows [rad], and whether it may be used itself."""
    if lens.projection == "opencv":
        coefficients = _heights(lens)
        odd = 2.0 * np.arange(len(coefficients)) + 1.0
        return _first_root(odd * coefficients), False
    known = _PROJECTIONS[lens.projection]
    return known.end, known.is_end_included


def _first_root(coefficients: FloatArray) -> float:
    """Return the smallest phi > 0 at which a polynomial in phi^2 is 0; infinite without one."""
    roots: NDArray[Any] = np.polynomial.polynomial.polyroots(np.trim_zeros(coefficients, "b"))
    # Where the curve only touches 0 the double root comes out with a small imaginary part.
    real = roots.real[(np.abs(roots.imag) <= 1e-6 * np.abs(roots)) & (roots.real > 0.0)]
    return float(np.sqrt(real.min())) if real.size else np.inf


def _invert(coefficients: FloatArray, height: FloatArray, largest: float) -> FloatArray:
    """Solve phi (1 + k1 phi^2 + ...) = height in [0, largest], NaN where height is.

    Newton's method, kept inside a bracket that bisection shrinks.
    """
    odd = (2.0 * np.arange(len(coefficients)) + 1.0) * coefficients
    low, high = np.zeros_like(height), np.full_like(height, largest * (1.0 + _RIM))
    phi = np.clip(height, 0.0, largest)
    for _ in range(_NEWTON_STEPS):
        excess = phi * _even(coefficients, phi) - height
        low = np.where(excess < 0.0, phi, low)
        high = np.where(excess > 0.0, phi, high)
        better = phi - excess / _even(odd, phi)
        better = np.where((better >= low) & (better <= high), better, 0.5 * (low + high))
        step = np.abs(better - phi)
        phi = np.where(np.isnan(height), np.nan, better)
        if not (step > 1e-15 * largest).any():
            break
    return phi
