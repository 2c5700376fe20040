"""Write a lens that a file describes in its own way as one that ``FisheyeCameraAPI`` can hold.

What cannot be held as it is becomes the closest ``opencv`` polynomial, and the difference is told.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError, UsdSkinError
from usdskin.fisheye import check_lens
from usdskin.notes import Note
from usdskin.prims.lenses import FisheyeLens

FloatArray = NDArray[np.float64]
Curve = Callable[[FloatArray], FloatArray]

IDEAL: dict[str, Curve] = {
    "equidistant": lambda phi: phi,
    "equisolid": lambda phi: 2.0 * np.sin(0.5 * phi),
    "stereographic": lambda phi: 2.0 * np.tan(0.5 * phi),
    "orthographic": np.sin,
    "thoby": lambda phi: 1.47 * np.sin(0.713 * phi),
}
"""Image height over the angle [rad], as multiples of f. ``thoby`` is Hugin's and Lensfun's name for
an empirical fit of the AF DX Fisheye-Nikkor 10.5 mm."""

_COARSEST_FIT_DEG = 0.25
"""A lens that no polynomial comes closer to than this, seen from the axis, is refused [deg]."""

_LARGEST_ASSUMED_DEG = 90.0
_GRID = 3601
_FIT_POINTS = 400
_VIGNETTING_TERMS = 4


@dataclass(frozen=True, slots=True, eq=False)
class FileLens:
    """What a file says of a lens."""

    where: str
    """File, and the lens in it, for errors."""

    radius: Curve
    """Image height r [px] over the angle from the axis [rad]; not a number where there is none."""

    center_px: FloatArray
    """Where the axis meets the picture, from the corner of the first pixel [px], shape [2]."""

    resolution: tuple[int, int]
    """Width and height of the pictures [px]."""

    exact: tuple[str, float, FloatArray] | None = None
    """Projection, f [px] and distortion of the schema where ``radius`` is just that."""

    not_radial: Curve | None = None
    """Bound of what the file has beside ``radius`` (tangential terms, skew) [px] over the angle."""

    vignetting: Curve | None = None
    """V [1] over the image height [px]."""

    vignetting_off_px: float = 0.0
    """How far from ``center_px`` the file has the middle of its vignetting [px]."""

    circle_px: float | None = None
    """Radius around the center within which there is picture [px]; None: the whole picture."""


def represent(lens: FileLens, max_angle_deg: float | None, notes: list[Note]) -> FisheyeLens:
    """Return the lens as the schema holds it.

    Args:
        lens: What the file says.
        max_angle_deg: Largest angle from the axis that holds picture [deg]. By default that of the
            picture's circle or farthest corner; without a circle, no more than 90.
        notes: Takes what was assumed, and how far the result is from the file.

    Raises:
        UsageError: The image height stops growing before the largest angle.
        UsdSkinError: No polynomial comes close to the lens.
    """
    _check_plausible(lens)
    angle_deg = _max_angle(lens, max_angle_deg, notes)
    angle = float(np.deg2rad(angle_deg))
    bend = 0.0 if lens.not_radial is None else float(lens.not_radial(np.array([angle]))[0])
    if lens.exact is not None:
        (projection, f, distortion), residual = lens.exact, 0.0
    else:
        projection = "opencv"
        f, distortion, residual = fit_polynomial(lens.radius, angle)
    _tell_distance(lens, angle_deg, (f, residual, bend), notes)
    vignetting = np.zeros(0)
    if lens.vignetting is not None:
        vignetting = _fit_vignetting(lens, angle_deg, notes)
    made = FisheyeLens(
        projection=projection,
        focal_length_px=f,
        center_px=lens.center_px,
        resolution=lens.resolution,
        distortion=distortion,
        max_angle_deg=angle_deg,
        vignetting=vignetting,
    )
    check_lens(made, lens.where)
    return made


def named(projection: str, focal_length_px: float) -> tuple[str, float, FloatArray] | None:
    """Return an ideal projection for ``FileLens.exact`` where the schema has it."""
    return None if projection == "thoby" else (projection, focal_length_px, np.zeros(4))


def fit_polynomial(radius: Curve, max_angle_rad: float) -> tuple[float, FloatArray, float]:
    """Return f [px] and k1 .. k4 of ``opencv`` closest to a curve, and the largest difference [px].

    Least squares over angles that crowd at the ends, where a polynomial errs most.
    """
    angles = 0.5 * max_angle_rad * (1.0 - np.cos(np.linspace(0.0, np.pi, _FIT_POINTS)))
    unit = angles / max_angle_rad
    scaled = np.linalg.lstsq(unit[:, None] ** [1, 3, 5, 7, 9], radius(angles), rcond=None)[0]
    terms = scaled / max_angle_rad ** np.array([1, 3, 5, 7, 9])
    dense = np.linspace(0.0, max_angle_rad, _GRID)
    difference = dense[:, None] ** [1, 3, 5, 7, 9] @ terms - radius(dense)
    return float(terms[0]), terms[1:] / terms[0], float(np.abs(difference).max())


def rising_until(radius: Curve) -> float:
    """Return the angle up to which an image height grows [rad], at most pi."""
    angles = np.linspace(0.0, np.pi, _GRID)
    with np.errstate(all="ignore"):
        rises = np.diff(radius(angles)) > 0.0
    return float(angles[len(rises) if rises.all() else int(np.argmin(rises))])


def _check_plausible(lens: FileLens) -> None:
    """Refuse numbers that have gone wrong somewhere, before they overflow."""
    size = np.array(lens.resolution, dtype=np.float64)
    with np.errstate(all="ignore"):
        slope = float(lens.radius(np.array([1e-3]))[0]) * 1e3
    if not 1e-2 * float(size.min()) < slope < 1e2 * float(size.max()):
        raise UsdSkinError(
            f"{lens.where}: its focal length comes out as {slope:.3g} px for pictures of "
            f"{lens.resolution[0]} x {lens.resolution[1]} pixels; correct the file"
        )
    if not (np.abs(lens.center_px / size - 0.5) < 1.0).all():
        raise UsdSkinError(
            f"{lens.where}: its axis is at ({lens.center_px[0]:.4g}, {lens.center_px[1]:.4g}) px, "
            "far outside the picture; correct the file"
        )


def _max_angle(lens: FileLens, given_deg: float | None, notes: list[Note]) -> float:
    end = rising_until(lens.radius)
    if given_deg is not None:
        if given_deg > np.rad2deg(end) + 1e-6:
            raise UsageError(
                f"{lens.where}: --max-angle is {given_deg:g} deg, but the image height of this "
                f"lens stops growing at {np.rad2deg(end):.4g} deg; lower it"
            )
        return given_deg
    angles = np.linspace(0.0, end, _GRID)
    edge_px, what = lens.circle_px, "the picture's circle"
    if edge_px is None:
        corners = np.array(
            [(x, y) for x in (0, lens.resolution[0]) for y in (0, lens.resolution[1])]
        )
        edge_px = float(np.linalg.norm(corners - lens.center_px, axis=1).max())
        what = "the picture's farthest corner"
    with np.errstate(all="ignore"):
        inside = lens.radius(angles) <= edge_px
    if inside.all() and end < np.pi:
        what = "where its image height stops growing"
    reach = float(np.rad2deg(angles[inside][-1]))
    if lens.circle_px is None and reach > _LARGEST_ASSUMED_DEG:
        reach, what = _LARGEST_ASSUMED_DEG, "half of the 180 deg that a fisheye lens usually sees"
    reach = float(np.floor(reach * 100.0) / 100.0)
    message = f"fisheye:maxAngle is taken as {reach:g} deg, {what}; --max-angle states it"
    notes.append(Note("max-angle-assumed", lens.where, message))
    return reach


def _tell_distance(
    lens: FileLens, angle_deg: float, distances: tuple[float, float, float], notes: list[Note]
) -> None:
    """Refuse a poor likeness; note one that can be measured.

    Args:
        lens: What the file says.
        angle_deg: Largest angle [deg].
        distances: f, the polynomial's largest error and the bound of what is not radial [px].
        notes: Takes the note.
    """
    f, residual, bend = distances
    off_deg = float(np.rad2deg((residual + bend) / f))
    what = f"k1 .. k4 follow its image height to {residual:.2g} px"
    if bend > 0.0:
        what += f", and what is not radial in it moves points by up to {bend:.2g} px"
    what += f", up to {angle_deg:g} deg"
    if off_deg > _COARSEST_FIT_DEG:
        raise UsdSkinError(
            f"{lens.where}: cannot be held by fisheye:distortion: {what}; lower --max-angle, or "
            "calibrate from photographs of a board"
        )
    if residual + bend > 1e-6:
        notes.append(Note("lens-fitted", lens.where, f"{what} ({off_deg:.2g} deg)"))


def _fit_vignetting(lens: FileLens, angle_deg: float, notes: list[Note]) -> FloatArray:
    """Return a2, a4, ... of V over the angle; the file's V counts over the image height."""
    assert lens.vignetting is not None
    angles = np.linspace(0.0, np.deg2rad(angle_deg), _GRID)
    radius = lens.radius(angles)
    value = lens.vignetting(radius)
    value = value / value[0]
    if not (np.isfinite(value).all() and value.min() > 0.0):
        dark = float(np.rad2deg(angles[int(np.argmax(~(value > 0.0)))]))
        raise UsdSkinError(
            f"{lens.where}: its vignetting falls to 0 at {dark:.4g} deg, within the largest angle "
            f"of {angle_deg:g} deg; lower --max-angle, or leave --f-number out and measure the "
            "vignetting"
        )
    unit = angles / angles[-1]
    powers = 2 * np.arange(1, _VIGNETTING_TERMS + 1)
    scaled = np.linalg.lstsq(unit[:, None] ** powers, value - 1.0, rcond=None)[0]
    error = float(np.abs((1.0 + unit[:, None] ** powers @ scaled) / value - 1.0).max())
    error += lens.vignetting_off_px * float(np.abs(np.gradient(value, radius) / value).max())
    message = (
        f"a2 .. a8 follow the file's vignetting to {100.0 * error:.2g} % up to {angle_deg:g} deg"
    )
    notes.append(Note("vignetting-fitted", lens.where, message))
    return np.asarray(scaled / angles[-1] ** powers)
