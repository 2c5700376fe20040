"""A flat chart before a virtual camera: what is seen of it, and where.

This is code of its own, so that it can judge how charts are found and sampled: both follow the
schema's text, neither calls the other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.judge.shoot.chart_patches import GAP, Grid
from usdskin.judge.shoot.environments import Environment, panorama
from usdskin.judge.shoot.optics import radius_at
from usdskin.judge.shoot.viewpoints import rotation_about, rotation_of
from usdskin.latlong import texel_directions, texel_solid_angles
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

FRAME_WIDTH = 0.4
"""Width of the frame around the patches, in sides of a patch."""

_LEAST_PATCH_PX = 5.0
_FACING_ROWS = 32  # of the maps of light and of directions, whose texels are 5.6 degrees


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """Where a chart is, seen by the camera (looks along -Z, +Y up); a patch's side is 1."""

    center: FloatArray
    """Middle of the patches, shape [3]."""

    axes: FloatArray
    """The chart's right, its up and its normal towards the camera, as columns, shape [3, 3]."""


def chart_pose(
    grid: Grid,
    width_deg: float,
    off_axis_deg: tuple[float, float],
    tilt_deg: float,
    roll_deg: float,
) -> Pose:
    """Return where a chart is that is held before the camera.

    Args:
        grid: How its patches lie.
        width_deg: Angle that it fills from its left to its right edge [deg].
        off_axis_deg: How far its middle is to the right of the optical axis, and above it [deg].
        tilt_deg: Angle between the chart's normal and the way to the camera [deg].
        roll_deg: Turn of the chart in its plane, counterclockwise [deg].
    """
    distance = 0.5 * grid.size[0] / np.tan(np.radians(0.5 * width_deg))
    right, up = np.tan(np.radians(off_axis_deg))
    towards = np.array([right, up, -1.0])
    towards /= np.linalg.norm(towards)
    # Tilted about an axis in its plane that is along neither of its edges.
    slanted = np.array([np.cos(0.7), np.sin(0.7), 0.0])
    turn = rotation_about(slanted, np.radians(tilt_deg))
    facing = _turn_between(np.array([0.0, 0.0, 1.0]), -towards)
    roll = rotation_about(np.array([0.0, 0.0, 1.0]), np.radians(roll_deg))
    return Pose(distance * towards, facing @ turn @ roll)


def _turn_between(start: FloatArray, end: FloatArray) -> FloatArray:
    """Return the shortest rotation from one unit vector to another, less than half a turn."""
    axis = np.cross(start, end)
    sine = float(np.linalg.norm(axis))
    if sine == 0.0:
        return np.eye(3)
    return rotation_about(axis / sine, float(np.arctan2(sine, start @ end)))


def chart_outline(grid: Grid, pose: Pose) -> FloatArray:
    """Return the corners of the outermost patches, seen by the camera, shape [4, 3].

    They are the top left, top right, bottom right and bottom left one of the chart as its makers
    show it.
    """
    half = 0.5 * grid.size
    signs = np.array([(-1.0, 1.0), (1.0, 1.0), (1.0, -1.0), (-1.0, -1.0)])
    return np.asarray(pose.center + (signs * half) @ pose.axes[:, :2].T)


def project(lens: FisheyeLens, points: FloatArray) -> FloatArray:
    """Return where a lens draws points [px], shape [..., 2].

    Args:
        lens: The lens.
        points: Seen by the camera, shape [..., 3].
    """
    x, y, z = np.moveaxis(points, -1, 0)
    across = np.hypot(x, y)
    radius = radius_at(lens, np.arctan2(across, -z))
    away = np.stack([x, -y], axis=-1) / np.maximum(across, 1e-300)[..., None]
    return np.asarray(lens.center_px + radius[..., None] * away)


def check_picture(grid: Grid, pose: Pose, lens: FisheyeLens) -> None:
    """Refuse a chart that the lens does not draw, or too small to be measured.

    Raises:
        UsageError: It is out of the picture, or its patches are smaller than five pixels.
    """
    outline = chart_outline(grid, pose)
    limit = np.radians(lens.max_angle_deg)
    angle = np.arctan2(np.hypot(outline[:, 0], outline[:, 1]), -outline[:, 2])
    corners = project(lens, outline)
    inside = (corners >= 0.0) & (corners <= np.array(lens.resolution))
    if angle.max() > limit or not inside.all():
        raise UsageError(
            "the chart is not wholly in the picture; make it fill a smaller angle, or hold it "
            "nearer to the optical axis"
        )
    sides = np.linalg.norm(np.diff(corners, axis=0, append=corners[:1]), axis=1)
    patch = float((sides / (grid.size[[0, 1, 0, 1]])).min())
    if patch < _LEAST_PATCH_PX:
        raise UsageError(
            f"a patch of the chart is {patch:.1f} px wide, less than {_LEAST_PATCH_PX:g}; take a "
            "larger picture, or hold the chart closer"
        )


@dataclass(frozen=True, slots=True, eq=False)
class ChartScene:
    """An environment with a chart before the camera.

    The chart receives the environment's light as if neither it nor the camera shaded any.
    """

    light: Environment
    """The environment."""

    grid: Grid
    """How the chart's patches lie."""

    pose: Pose
    """Where the chart is."""

    patches: FloatArray
    """Responses of R, G, B and luminance to the patches, shape [patch_count, 4]."""

    frame: FloatArray
    """Responses to what is between and around the patches, shape [4]."""

    @property
    def detail(self) -> float:
        """Size of the smallest thing to be seen: a texel, or half a gap [rad]."""
        return min(self.light.detail, 0.5 * GAP / float(np.linalg.norm(self.pose.center)))

    def mean(self) -> FloatArray:
        """Return the mean response over the sphere without the chart, shape [4]."""
        return self.light.mean()

    def look(self, directions: FloatArray, world_from: FloatArray) -> FloatArray:
        """Return what is seen in some directions of the camera.

        Args:
            directions: Unit vectors in the camera's frame, shape [3, ...].
            world_from: Rotation from the camera to the world, shape [3, 3].

        Returns:
            Responses of R, G, B and luminance, shape [..., 4].
        """
        seen = self.light.look(directions, world_from)
        right, up, normal = (np.tensordot(axis, directions, 1) for axis in self.pose.axes.T)
        place = self.pose.axes.T @ self.pose.center
        with np.errstate(divide="ignore", invalid="ignore"):
            distance = place[2] / normal
            x = distance * right - place[0] + 0.5 * self.grid.size[0]
            y = 0.5 * self.grid.size[1] - (distance * up - place[1])
        within = (normal < 0.0) & (x > -FRAME_WIDTH) & (x < self.grid.size[0] + FRAME_WIDTH)
        within &= (y > -FRAME_WIDTH) & (y < self.grid.size[1] + FRAME_WIDTH)
        seen[within] = self._chart(x[within], y[within])
        return seen

    def _chart(self, x: FloatArray, y: FloatArray) -> FloatArray:
        """Return what points of the chart look like, from the top left patch's corner."""
        pitch = 1.0 + GAP
        column, row = np.floor(x / pitch).astype(np.intp), np.floor(y / pitch).astype(np.intp)
        on_patch = (x - column * pitch < 1.0) & (y - row * pitch < 1.0)
        on_patch &= (column >= 0) & (column < self.grid.columns)
        on_patch &= (row >= 0) & (row < self.grid.rows)
        index = np.zeros((self.grid.columns, self.grid.rows), dtype=np.intp)
        places = self.grid.places
        index[places[:, 0], places[:, 1]] = np.arange(len(places))
        seen = np.broadcast_to(self.frame, (*x.shape, self.frame.size)).copy()
        seen[on_patch] = self.patches[index[column[on_patch], row[on_patch]]]
        return seen


def facing_rotation(pose: Pose, facing: FloatArray, panorama_from_world: FloatArray) -> FloatArray:
    """Return the rotation of a camera to the world that makes its chart face a direction.

    Args:
        pose: Where the chart is before the camera.
        facing: Where the chart's normal points, unit vector in the world, shape [3].
        panorama_from_world: Rotation that takes the world's up to +Y, shape [3, 3].

    Returns:
        Rotation from the camera to the world, shape [3, 3]; the chart stands as upright as it can.
    """
    x, y, z = panorama_from_world @ -facing
    level = bool(np.hypot(x, z) > 1e-9)
    azimuth = np.degrees(np.arctan2(-x, -z)) if level else 0.0
    upright = rotation_of(
        (azimuth, np.degrees(np.arcsin(np.clip(y, -1.0, 1.0)))), panorama_from_world
    )
    return np.asarray(upright @ pose.axes.T)


def brightest_direction(light: Environment) -> FloatArray:
    """Return where illuminance is largest, to a few degrees.

    Returns:
        Unit vector in the world, shape [3].
    """
    luminance = panorama(light, _FACING_ROWS)[..., 3]
    height, width = luminance.shape
    flux = luminance * texel_solid_angles(height, width)[:, None]
    directions = texel_directions(height, width).reshape(-1, 3)
    illuminance = np.zeros(len(directions))
    for towards, arriving in zip(directions, flux.ravel(), strict=True):
        illuminance += arriving * np.maximum(directions @ towards, 0.0)
    return np.asarray(light.panorama_from_world.T @ directions[int(np.argmax(illuminance))])
