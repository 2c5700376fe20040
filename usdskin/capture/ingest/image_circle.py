"""Find the image circle of a fisheye lens, and guess the lens from it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from usdskin.fisheye import angle_to_radius, check_lens
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

_SPOKES = 720
_CORNER = 0.04  # of the picture's width and height
_DARK_CORNERS = 0.25  # of what is bright in the middle
_THRESHOLD = 0.1
_STEEP, _STAYS = 3.0, 0.02  # times the threshold, and of the radius
_LEAST_ROUND = 0.3
_NEAR = 0.01  # of the radius
_REACHES, _STRIDE = (1 / 3, 1 / 5, 1 / 8), 8
_ROUNDS = 5


class Circle(NamedTuple):
    """A circle in a picture [px]; (0, 0) is the corner of the first pixel."""

    x: float
    """Column of the middle."""

    y: float
    """Row of the middle."""

    radius: float
    """Radius."""


def find_circle_of_brackets(
    brackets: Sequence[Sequence[NDArray[np.float32]]],
) -> Circle | None:
    """Return the circle in the longest exposures in which it shows.

    The longest of all show the darkest scene, but a veil of glare, which lies evenly over the whole
    picture, lifts what is outside the circle there too, up to saturation.

    Args:
        brackets: Pictures of one size, each view's from the longest exposure to the shortest, shape
            [rows, columns].

    Returns:
        The circle in pixels of the thumbnails; None where no exposures show one.
    """
    for rank in range(max(map(len, brackets))):
        circle = find_circle([bracket[min(rank, len(bracket) - 1)] for bracket in brackets])
        if circle is not None:
            return circle
    return None


def find_circle(thumbnails: Sequence[NDArray[np.float32]]) -> Circle | None:
    """Return the circle that bright pictures fill, and outside of which they are dark.

    Its rim is taken where spokes from the middle of the picture last meet light. A circle is fitted
    to the rim, less the spokes on which the scene is dark or a flare shines outside. A rim is steep
    and stays where it is at a higher threshold, unlike the fall of light to the corners of a lens
    that fills the frame.

    Args:
        thumbnails: Pictures of one size, like exposures of several views, shape [rows, columns].

    Returns:
        The circle in pixels of the thumbnails; None where there is none, as with a lens that fills
        the frame.
    """
    light = np.max(np.stack(thumbnails), axis=0)
    rows, columns = light.shape
    outside = corner_level(light)
    middle = light[rows // 4 : -(rows // 4), columns // 4 : -(columns // 4)]
    inside = float(np.percentile(middle, 75))
    if outside >= _DARK_CORNERS * inside:
        return None
    rise = _THRESHOLD * (inside - outside)
    circle = _circle_above(light, outside + rise)
    steep = None if circle is None else _circle_above(light, outside + _STEEP * rise)
    if circle is None or steep is None:
        return None
    return circle if abs(steep.radius - circle.radius) <= _STAYS * circle.radius else None


def _circle_above(light: NDArray[np.float32], threshold: float) -> Circle | None:
    rim = _rim(light > threshold)
    return None if len(rim) < _LEAST_ROUND * _SPOKES else _fit(rim)


def corner_level(thumbnail: NDArray[np.float32]) -> float:
    """Return what a picture holds in its corners, where no light of a fisheye's circle falls."""
    high, wide = (max(1, int(_CORNER * size)) for size in thumbnail.shape)
    corners = [np.median(thumbnail[i, j]) for i in _ends(high) for j in _ends(wide)]
    return float(np.median(corners))


def _ends(size: int) -> tuple[slice, slice]:
    return slice(None, size), slice(-size, None)


def _rim(is_lit: NDArray[np.bool_]) -> FloatArray:
    """Return where spokes from the middle last meet light within the picture, shape [count, 2]."""
    rows, columns = is_lit.shape
    angle = (np.arange(_SPOKES) + 0.5) * (2.0 * np.pi / _SPOKES)
    along = np.arange(0.0, np.hypot(rows, columns) / 2.0, 0.25)
    x = columns / 2.0 + np.multiply.outer(np.cos(angle), along)
    y = rows / 2.0 + np.multiply.outer(np.sin(angle), along)
    within = (x >= 0) & (x < columns) & (y >= 0) & (y < rows)
    lit = (
        within & is_lit[np.clip(y, 0, rows - 1).astype(int), np.clip(x, 0, columns - 1).astype(int)]
    )
    last = lit.shape[1] - 1 - np.argmax(lit[:, ::-1], axis=1)
    edge = within.sum(axis=1) - 1
    # A spoke that leaves the picture in the light does not meet the rim.
    told = np.flatnonzero(lit.any(axis=1) & (last < edge - 8))
    return np.stack([x[told, last[told]], y[told, last[told]]], axis=1)


def _fit(points: FloatArray) -> Circle | None:
    """Fit a circle to most of the points.

    A first one goes through three of them and near as many as possible of the others: where the
    scene is dark, points lie far inside the rim. It is then fitted to those by least squares.
    """
    best, most = None, 0
    widest = float(np.ptp(points, axis=0).max())
    for reach in _REACHES:
        step = round(reach * len(points))
        for index in range(0, len(points), _STRIDE):
            chosen = [(index + step * corner) % len(points) for corner in range(3)]
            circle = _least_squares(points[chosen])
            if circle is None or circle.radius > widest:
                continue
            count = int(np.count_nonzero(_near(points, circle)))
            if count > most:
                best, most = circle, count
    for _ in range(_ROUNDS):
        if best is None or most < _LEAST_ROUND * _SPOKES:
            return None
        near = _near(points, best)
        best, most = _least_squares(points[near]), int(np.count_nonzero(near))
    return best


def _near(points: FloatArray, circle: Circle) -> NDArray[np.bool_]:
    off = np.hypot(points[:, 0] - circle.x, points[:, 1] - circle.y) - circle.radius
    return np.asarray(np.abs(off) < max(1.0, _NEAR * circle.radius))


def _least_squares(points: FloatArray) -> Circle | None:
    """Return the circle of Kasa (1976): x^2 + y^2 = 2 a x + 2 b y + c; None for a straight line."""
    design = np.column_stack([2.0 * points, np.ones(len(points))])
    (x, y, rest), _, rank, _ = np.linalg.lstsq(design, (points**2).sum(axis=1), rcond=None)
    square = rest + x * x + y * y
    return Circle(float(x), float(y), float(np.sqrt(square))) if rank == 3 and square > 0 else None


def guess_lens(
    circle: Circle | None, size: tuple[int, int], projection: str, field_deg: float
) -> FisheyeLens:
    """Return the lens whose field just fills the circle, or the picture's diagonal without one.

    Args:
        circle: The image circle [px].
        size: Width and height of the pictures [px].
        projection: As in ``FisheyeLens``, but not ``opencv``.
        field_deg: Angle from rim to rim [deg].

    Raises:
        LayerError: The projection does not reach that far.
    """
    if circle is None:
        circle = Circle(size[0] / 2.0, size[1] / 2.0, float(np.hypot(*size)) / 2.0)
    unit = FisheyeLens(
        projection=projection,
        focal_length_px=1.0,
        center_px=np.array([circle.x, circle.y]),
        resolution=size,
        max_angle_deg=0.5 * field_deg,
    )
    check_lens(unit, f"--projection {projection} --fov {field_deg:g}")
    height = float(angle_to_radius(unit, np.radians(0.5 * field_deg)))
    return FisheyeLens(
        projection=projection,
        focal_length_px=circle.radius / height,
        center_px=unit.center_px,
        resolution=size,
        max_angle_deg=0.5 * field_deg,
    )
