"""The plane of a chart, seen through a lens: chart coordinates <-> positions in the picture.

A flat chart maps to rays from the camera by a homography of rays, exactly and under any central
lens; only then the lens bends rays into the picture. Without a lens, as for a picture that somebody
else has made, the picture itself is taken for a flat one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import LayerError
from usdskin.fisheye import project, unproject
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

UNIT_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])
"""Chart coordinates of the corners, in their order, shape [4, 2]."""

CORNER_NAMES = ("top left", "top right", "bottom right", "bottom left")


@dataclass(frozen=True, slots=True, eq=False)
class ChartPlane:
    """Where the points of a flat chart are in a picture."""

    homography: FloatArray
    """From chart coordinates (x, y, 1) to rays, or to (u, v, 1) without a lens, up to a positive
    factor, shape [3, 3]."""

    lens: FisheyeLens | None
    """Lens of the picture, in its size."""

    def to_picture(self, points: ArrayLike) -> FloatArray:
        """Return the positions of chart points [px], shape [..., 2]; NaN where there is none.

        Args:
            points: Chart coordinates [1], shape [..., 2].
        """
        rays = _homogeneous(np.asarray(points, np.float64)) @ self.homography.T
        if self.lens is not None:
            return project(self.lens, rays)
        depth = np.where(rays[..., 2:] > 0.0, rays[..., 2:], np.nan)
        return np.asarray(rays[..., :2] / depth)

    def to_chart(self, positions: ArrayLike) -> FloatArray:
        """Return the chart coordinates of positions, shape [..., 2]; NaN where there are none.

        Args:
            positions: (u, v) from the corner of the first pixel [px], shape [..., 2].
        """
        points = _rays(np.asarray(positions, np.float64), self.lens)
        points = points @ np.linalg.inv(self.homography).T
        depth = np.where(points[..., 2:] > 0.0, points[..., 2:], np.nan)
        return np.asarray(points[..., :2] / depth)


def chart_plane(corners: ArrayLike, lens: FisheyeLens | None, where: str) -> ChartPlane:
    """Return the plane through four corners.

    Four rays fix it: with the corners p1 .. p4 of the unit square, p4 = p1 - p2 + p3, and
    r4 = a r1 + b r2 + c r3, the homography takes p1, p2, p3 to a r1, -b r2, c r3 (Hartley and
    Zisserman, "Multiple View Geometry in Computer Vision", 2nd edition, 2004, section 2.3).

    Args:
        corners: Positions [px] of the outer corners of the patches at the chart's top left, top
            right, bottom right and bottom left, shape [4, 2].
        lens: Lens of the picture, in its size; None for a picture without one.
        where: Layer and prim path, for the error.

    Raises:
        LayerError: The corners are no convex quadrilateral, run the wrong way round, or lie
            outside the lens's picture.
    """
    corners = np.asarray(corners, np.float64)
    rays = _rays(corners, lens)
    lost = ~np.isfinite(rays).all(axis=-1)
    if lost.any():
        u, v = corners[lost][0]
        raise LayerError(
            f"{where}: the chart's {CORNER_NAMES[int(lost.argmax())]} corner ({u:g}, {v:g}) lies "
            "outside the circle that holds picture; give the corners in pixels of the photograph, "
            "or correct fisheye:maxAngle"
        )
    columns = rays[:3].T
    shares = np.full(3, np.nan)
    if abs(np.linalg.det(columns)) > 1e-12 * np.prod(np.linalg.norm(columns, axis=0)):
        shares = np.linalg.solve(columns, rays[3]) * np.array([1.0, -1.0, 1.0])
    turn = _turn(corners)
    if not (shares > 1e-6).all() or turn == 0.0:
        raise LayerError(
            f"{where}: the chart's corners {_listed(corners)} are no convex quadrilateral; give "
            f"{', '.join(CORNER_NAMES)}, in this order"
        )
    if turn < 0.0:
        raise LayerError(
            f"{where}: the chart's corners {_listed(corners)} run counter-clockwise, as those of a "
            f"mirrored picture; give {', '.join(CORNER_NAMES)}, in this order"
        )
    square = _homogeneous(UNIT_CORNERS[:3]).T
    homography = (columns * shares) @ np.linalg.inv(square)
    return ChartPlane(homography / np.linalg.norm(homography), lens)


def _rays(positions: FloatArray, lens: FisheyeLens | None) -> FloatArray:
    return _homogeneous(positions) if lens is None else unproject(lens, positions)


def _homogeneous(points: FloatArray) -> FloatArray:
    return np.concatenate([points, np.ones((*points.shape[:-1], 1))], axis=-1)


def _turn(corners: FloatArray) -> float:
    """Return the area the corners go round [px^2], positive if clockwise as seen."""
    x, y = corners.T
    return float(0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum())


def _listed(corners: FloatArray) -> str:
    return ", ".join(f"({u:g}, {v:g})" for u, v in corners)
