"""Find the lens, and the pose of the board in every picture, that put the corners where they are.

One focal length for both axes, corners at any angle (OpenCV's ``fisheye.calibrate`` has two focal
lengths and takes no corner beyond 90 degrees), single wrong corners without influence, and the
covariance of what was found. Camera coordinates are OpenCV's: x right, y down, z forward.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.lens.models import RadialModel

FloatArray = NDArray[np.float64]

_START_ANGLES_DEG = (15.0, 25.0, 35.0, 45.0, 55.0, 65.0, 75.0, 85.0, 95.0, 105.0, 120.0)
"""Where the outermost corner may lie, to begin with [deg]."""

_ROUNDS = 4
_STEPS_PER_ROUND = 60
_HUBER_SIGMAS = 3.0
_LEAST_SIGMA_PX = 1e-2
_RAYLEIGH_MEDIAN = 1.1774100225154747  # of the length of an error with sigma 1 in x and in y


@dataclass(frozen=True, slots=True, eq=False)
class Solution:
    """A lens, and where the boards were."""

    model: RadialModel
    """What r(phi) looks like."""

    parameters: FloatArray
    """Those of the model, shape [parameter_count]."""

    center_px: FloatArray
    """Where the axis meets the picture [px], shape [2]."""

    stretch: float
    """Half of fx/fy - 1 [1]; 0 unless it was solved for."""

    rotations: FloatArray
    """From each board to the camera, shape [view_count, 3, 3]."""

    translations: FloatArray
    """Of each board's origin in the camera [units of the board], shape [view_count, 3]."""

    residuals_px: tuple[FloatArray, ...]
    """Projected minus found corners of each view [px], shape [corner_count, 2]."""

    angles_rad: tuple[FloatArray, ...]
    """Angles of each view's corners from the axis [rad], shape [corner_count]."""

    covariance: FloatArray
    """Of (parameters, center_px, stretch) were each coordinate of a corner wrong by 1 px; 0 for
    what was held fixed, shape [parameter_count + 3, parameter_count + 3]."""

    @property
    def sigma_px(self) -> float:
        """Standard deviation of one coordinate of a corner, from the median residual [px]."""
        return _sigma(np.concatenate(self.residuals_px))

    def radius_sigma_px(self, angle_rad: float, corner_sigma_px: float) -> float:
        """Return the standard deviation of r(phi) [px], given that of a corner's coordinate."""
        slopes = self.model.evaluate(self.parameters, np.array([angle_rad]))[2][0]
        count = self.model.parameter_count
        variance = slopes @ self.covariance[:count, :count] @ slopes
        return float(np.sqrt(max(variance, 0.0))) * corner_sigma_px


@dataclass(slots=True, eq=False)
class _State:
    lens: FloatArray  # parameters, center, stretch
    rotations: FloatArray
    translations: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class _Problem:
    model: RadialModel
    boards: FloatArray  # corners of all views one after another
    pixels: FloatArray
    view: NDArray[np.intp]  # of each corner
    first: NDArray[np.intp]  # corner of each view
    free: NDArray[np.bool_]  # which of the lens's numbers to solve for

    def split(self, values: FloatArray) -> tuple[FloatArray, ...]:
        """Return values per corner as one array per view."""
        return tuple(np.split(values, self.first[1:]))


@dataclass(frozen=True, slots=True, eq=False)
class _Normal:
    """Normal equations of all views, poses apart: the arrow's head, wings and shaft."""

    lens: FloatArray  # [q, q]
    wings: FloatArray  # [view_count, q, 6]
    poses: FloatArray  # [view_count, 6, 6]
    lens_gradient: FloatArray  # [q]
    pose_gradients: FloatArray  # [view_count, 6]
    loss: float


def solve(
    model: RadialModel,
    boards: Sequence[FloatArray],
    pixels: Sequence[FloatArray],
    resolution: tuple[int, int],
    *,
    start: Solution | None = None,
    free_stretch: bool = False,
) -> Solution:
    """Fit a lens and the poses of a planar board to its corners.

    Minimises Huber's loss by Levenberg and Marquardt's method with the poses eliminated (Triggs et
    al., "Bundle Adjustment - A Modern Synthesis", 2000); the loss's width follows the residuals.

    Args:
        model: What r(phi) looks like.
        boards: Corners on the board, per view [any unit], shape [corner_count, 2].
        pixels: The same corners in the picture, per view [px], shape [corner_count, 2].
        resolution: Width and height of the pictures [px].
        start: Where to begin, with the same views; a start is searched for where ``None``.
        free_stretch: Solve for ``stretch`` too.
    """
    free = np.ones(model.parameter_count + 3, dtype=bool)
    free[-1] = free_stretch
    counts = [len(board) for board in boards]
    problem = _Problem(
        model,
        np.concatenate(boards),
        np.concatenate(pixels),
        np.repeat(np.arange(len(counts)), counts),
        np.cumsum([0, *counts[:-1]]),
        free,
    )
    if start is None:
        state = _start(problem, resolution)
    else:
        lens = np.concatenate([start.parameters, start.center_px, [start.stretch]])
        state = _State(lens, start.rotations, start.translations)
    for _ in range(_ROUNDS):
        width = _HUBER_SIGMAS * max(_sigma(_residuals(problem, state)), _LEAST_SIGMA_PX)
        state = _minimise(problem, state, width)
    return _solution(problem, state)


def _solution(problem: _Problem, state: _State) -> Solution:
    count = problem.model.parameter_count
    residuals = _residuals(problem, state)
    normal = _normal_equations(problem, state, np.inf)
    covariance = np.zeros_like(normal.lens)
    free = np.ix_(problem.free, problem.free)
    # Pseudo-inverses: what the corners do not determine shows as a huge variance, not as an error.
    covariance[free] = np.linalg.pinv(_reduced(normal, 0.0)[0][free], rcond=1e-15, hermitian=True)
    x, y, z = _points(problem, state).T
    return Solution(
        model=problem.model,
        parameters=state.lens[:count],
        center_px=state.lens[count : count + 2],
        stretch=float(state.lens[-1]),
        rotations=state.rotations,
        translations=state.translations,
        residuals_px=problem.split(residuals),
        angles_rad=problem.split(np.arctan2(np.hypot(x, y), z)),
        covariance=covariance,
    )


def _sigma(residuals: FloatArray) -> float:
    return float(np.median(np.linalg.norm(residuals, axis=1))) / _RAYLEIGH_MEDIAN


def _start(problem: _Problem, resolution: tuple[int, int]) -> _State:
    """Return the best of several equidistant lenses with the axis in the picture's middle."""
    center = np.array(resolution, dtype=np.float64) / 2.0
    offsets = problem.pixels - center
    reach = float(np.linalg.norm(offsets, axis=1).max())
    boards = problem.split(problem.boards)
    states = []
    for angle_deg in _START_ANGLES_DEG:
        f = reach / np.deg2rad(angle_deg)
        rays = problem.split(_equidistant_rays(offsets, f))
        poses = [_pose_of(board, ray) for board, ray in zip(boards, rays, strict=True)]
        rotations, translations = (np.array(part) for part in zip(*poses, strict=True))
        lens = np.concatenate([problem.model.start(f), center, [0.0]])
        states.append(_State(lens, rotations, translations))
    return min(states, key=lambda state: _sigma(_residuals(problem, state)))


def _equidistant_rays(offset: FloatArray, f: float) -> FloatArray:
    radius = np.maximum(np.linalg.norm(offset, axis=1), 1e-12)
    angle = np.minimum(radius / f, np.pi)
    return np.column_stack([np.sin(angle)[:, None] * offset / radius[:, None], np.cos(angle)])


def _pose_of(board: FloatArray, rays: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return rotation and translation of a plane whose points lie on rays.

    The direct linear transform of ``ray x H (x, y, 1) = 0`` with H = s (r1, r2, t): unlike a
    homography of the picture it holds for rays in any direction, sideways and backwards too.
    """
    middle, size = board.mean(axis=0), float(np.ptp(board, axis=0).max())
    plane = np.column_stack([(board - middle) / size, np.ones(len(board))])
    cross = np.cross(np.eye(3), rays[:, None, :])  # the matrix of v -> ray x v
    system = (cross[:, :, :, None] * plane[:, None, None, :]).reshape(-1, 9)
    h = np.linalg.svd(system, full_matrices=len(system) < 9)[2][-1].reshape(3, 3)
    if np.sum(rays * (plane @ h.T)) < 0.0:
        h = -h
    scale = np.sqrt(np.linalg.norm(h[:, 0]) * np.linalg.norm(h[:, 1]))
    axes = np.column_stack([h[:, :2] / scale, np.cross(h[:, 0], h[:, 1]) / scale**2])
    left, _, right = np.linalg.svd(axes)
    rotation = left @ right
    return rotation, h[:, 2] * size / scale - rotation[:, :2] @ middle


def _points(problem: _Problem, state: _State) -> FloatArray:
    """Return the corners in camera coordinates, shape [corner_count, 3]."""
    rotations = state.rotations[problem.view, :, :2]
    turned = np.einsum("nij,nj->ni", rotations, problem.boards)
    return np.asarray(turned + state.translations[problem.view])


def _residuals(problem: _Problem, state: _State) -> FloatArray:
    projected = _project(problem.model, state.lens, _points(problem, state))[0]
    return projected - problem.pixels


def _project(
    model: RadialModel, lens: FloatArray, points: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return pixels [n, 2] and their derivatives by the points [n, 2, 3] and the lens [n, 2, q]."""
    x, y, z = points.T
    across = np.maximum(np.hypot(x, y), 1e-12)
    outward = points[:, :2] / across[:, None]
    sideways = np.column_stack([-outward[:, 1], outward[:, 0]])
    radius, slope, by_parameters = model.evaluate(
        lens[: model.parameter_count], np.arctan2(across, z)
    )
    stretch = np.array([1.0 + lens[-1], 1.0 - lens[-1]])
    pixels = lens[-3:-1] + stretch * radius[:, None] * outward

    by_angle = np.column_stack([outward * z[:, None], -across]) / (across**2 + z**2)[:, None]
    by_points = outward[:, :, None] * (slope[:, None] * by_angle)[:, None, :]
    turned = sideways[:, :, None] * sideways[:, None, :]
    by_points[:, :, :2] += (radius / across)[:, None, None] * turned
    by_points *= stretch[:, None]

    by_lens = np.zeros((len(points), 2, len(lens)))
    by_lens[:, :, :-3] = (stretch * outward)[:, :, None] * by_parameters[:, None, :]
    by_lens[:, 0, -3] = by_lens[:, 1, -2] = 1.0
    by_lens[:, :, -1] = radius[:, None] * outward * [1.0, -1.0]
    return pixels, by_points, by_lens


def _normal_equations(problem: _Problem, state: _State, width: float) -> _Normal:
    """Return the normal equations of Huber's loss of a width [px], as reweighted least squares."""
    points = _points(problem, state)
    pixels, by_points, by_lens = _project(problem.model, state.lens, points)
    residual = pixels - problem.pixels
    length = np.linalg.norm(residual, axis=1)
    weight = np.minimum(1.0, width / np.maximum(length, 1e-300))
    loss = float(np.sum(weight * length**2 * (1.0 - 0.5 * weight)))
    # A small turn w moves a point by w x (R X).
    arms = points - state.translations[problem.view]
    turned = np.cross(np.eye(3), arms[:, None, :]).swapaxes(1, 2)
    jacobian = np.concatenate([by_lens, by_points @ turned, by_points], axis=2)
    weighted = (weight[:, None, None] * jacobian).swapaxes(1, 2)
    squares = np.add.reduceat(weighted @ jacobian, problem.first)
    gradients = np.add.reduceat((weighted @ residual[:, :, None])[:, :, 0], problem.first)
    size = len(state.lens)
    return _Normal(
        lens=squares[:, :size, :size].sum(axis=0),
        wings=squares[:, :size, size:],
        poses=squares[:, size:, size:],
        lens_gradient=gradients[:, :size].sum(axis=0),
        pose_gradients=gradients[:, size:],
        loss=loss,
    )


def _reduced(normal: _Normal, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the lens's matrix and gradient without the poses, and the poses' damped inverses."""
    diagonal = np.einsum("...ii->...i", normal.poses)
    inverses = np.linalg.pinv(
        normal.poses + damping * diagonal[:, :, None] * np.eye(6), rcond=1e-15, hermitian=True
    )
    wings = normal.wings @ inverses
    matrix = normal.lens + damping * np.diag(np.diag(normal.lens))
    matrix = matrix - np.einsum("vai,vbi->ab", wings, normal.wings)
    gradient = normal.lens_gradient - np.einsum("vai,vi->a", wings, normal.pose_gradients)
    return matrix, gradient, inverses


def _minimise(problem: _Problem, state: _State, width: float) -> _State:
    damping = 1e-3
    normal = _normal_equations(problem, state, width)
    free = np.ix_(problem.free, problem.free)
    for _ in range(_STEPS_PER_ROUND):
        matrix, gradient, inverses = _reduced(normal, damping)
        lens_step = np.zeros_like(state.lens)
        lens_step[problem.free] = -np.linalg.lstsq(
            matrix[free], gradient[problem.free], rcond=1e-15
        )[0]
        right = normal.pose_gradients + np.einsum("vai,a->vi", normal.wings, lens_step)
        pose_steps = -np.einsum("vij,vj->vi", inverses, right)
        trial = _State(
            state.lens + lens_step,
            _turns(pose_steps[:, :3]) @ state.rotations,
            state.translations + pose_steps[:, 3:],
        )
        following = _normal_equations(problem, trial, width)
        if not following.loss < normal.loss:  # also where it is not a number
            damping *= 8.0
            if damping > 1e10:
                break
            continue
        settled = normal.loss - following.loss <= 1e-14 * normal.loss
        state, normal, damping = trial, following, max(damping / 5.0, 1e-12)
        if settled:
            break
    return state


def _turns(vectors: FloatArray) -> FloatArray:
    """Return rotations by vectors [rad] (Rodrigues' formula), shape [view_count, 3, 3]."""
    angle = np.linalg.norm(vectors, axis=1)[:, None, None]
    cross = np.cross(np.eye(3), vectors[:, None, :] / np.maximum(angle, 1e-300))
    return np.asarray(np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross)
