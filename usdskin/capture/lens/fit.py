"""Fit a lens to the boards found in photographs, leave out what disagrees, and judge the fit."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.lens.board import BoardView
from usdskin.capture.lens.models import MODELS
from usdskin.capture.lens.solve import Solution, solve
from usdskin.errors import ImageError
from usdskin.notes import Note

FloatArray = NDArray[np.float64]

LEAST_VIEWS = 4
_LEAST_CORNERS = 8

_VIEW_FACTOR, _VIEW_FLOOR_PX = 3.0, 0.5
"""A photograph is left out when its median residual is this many times that of all, and above."""

_CORNER_SIGMAS, _CORNER_FLOOR_PX = 6.0, 1.0
"""A corner is left out when it is this far off, in standard deviations and pixels."""

_SIGMA_FLOOR_PX = 0.05
"""No detector finds corners in photographs better than this; judges pictures made by a program."""

_UNSURE_DEG = (0.1, 0.5)
"""Standard deviation of a direction that is worth a word, and that is too large [deg]."""

_MISFIT_DEG = (0.05, 0.25)
"""The same of a corner, in its direction [deg]."""

_STRETCH_SIGMAS, _STRETCH_NOTED, _STRETCH_REFUSED = 5.0, 5e-4, 1e-2
"""How sure, and how large, fx/fy - 1 must be to be told, and to be refused."""


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """A lens as photographs of a board have shown it."""

    solution: Solution
    """The lens and the poses of the boards."""

    views: tuple[BoardView, ...]
    """Photographs that were used, with the corners that were."""

    rejected: tuple[BoardView, ...]
    """Photographs that were left out because they disagree with the others."""

    dropped_corners: int
    """Single corners that were left out."""

    @property
    def resolution(self) -> tuple[int, int]:
        """Width and height of the photographs [px]."""
        return self.views[0].resolution

    @property
    def rms_px(self) -> float:
        """Root mean square distance of projected from found corners [px], as OpenCV counts it."""
        return _rms(np.concatenate(self.solution.residuals_px))

    @property
    def view_rms_px(self) -> FloatArray:
        """The same of every photograph used [px], shape [view_count]."""
        return np.array([_rms(residual) for residual in self.solution.residuals_px])

    @property
    def corner_count(self) -> int:
        """Corners that were used."""
        return sum(len(view.pixel) for view in self.views)

    @property
    def covered_deg(self) -> float:
        """Largest angle from the axis at which a corner was seen [deg]."""
        return float(np.rad2deg(max(angle.max() for angle in self.solution.angles_rad)))

    def radius_sigma_px(self, angle_deg: float) -> float:
        """Return the standard deviation of the image height at an angle [px]."""
        return self.solution.radius_sigma_px(float(np.deg2rad(angle_deg)), self.corner_sigma_px)

    @property
    def center_sigma_px(self) -> float:
        """Standard deviation of one coordinate of the axis' place [px]."""
        count = self.solution.model.parameter_count
        variances = np.diag(self.solution.covariance)[count : count + 2]
        return float(np.sqrt(variances.mean())) * self.corner_sigma_px

    def direction_sigma_deg(self, angle_deg: float) -> float:
        """Return the standard deviation of a pixel's direction at an angle [deg].

        That of image height and of the axis' place together, over dr/dphi.
        """
        sigma_px = np.hypot(self.radius_sigma_px(angle_deg), self.center_sigma_px)
        slope = self.solution.model.evaluate(
            self.solution.parameters, np.array([np.deg2rad(angle_deg)])
        )[1][0]
        return float(np.rad2deg(sigma_px / max(abs(slope), 1e-12)))

    @property
    def corner_misfit_deg(self) -> float:
        """Standard deviation of a corner's coordinate as an angle on the axis [deg]."""
        slope = self.solution.model.evaluate(self.solution.parameters, np.array([1e-3]))[1][0]
        return float(np.rad2deg(self.solution.sigma_px / max(abs(slope), 1e-12)))

    @property
    def corner_sigma_px(self) -> float:
        """Standard deviation of one coordinate of a corner [px], at least 0.05."""
        return max(self.solution.sigma_px, _SIGMA_FLOOR_PX)


def fit_lens(views: Sequence[BoardView], model: str, notes: list[Note]) -> Calibration:
    """Fit a lens to boards.

    Args:
        views: Photographs of one size with the board in them, ``LEAST_VIEWS`` at least.
        model: ``fisheye`` or ``omnidir``.
        notes: Takes what was left out, and what may be wrong with the photographs.

    Raises:
        ImageError: The photographs disagree, do not determine the lens, or are stretched.
    """
    kept, rejected = list(views), []
    solution = _solve(kept, model, None)
    while True:
        offs = np.array([np.median(_lengths(residual)) for residual in solution.residuals_px])
        worst = int(np.argmax(offs))
        if offs[worst] <= max(_VIEW_FACTOR * float(np.median(offs)), _VIEW_FLOOR_PX):
            break
        view = kept.pop(worst)
        rejected.append(view)
        message = f"left out: its corners are {offs[worst]:.2g} px off where the others put them"
        notes.append(Note("image-rejected", str(view.path), message))
        if 3 * len(rejected) > len(views) or len(kept) < LEAST_VIEWS:
            listed = ", ".join(view.path.name for view in rejected)
            raise ImageError(
                f"{view.path}: {len(rejected)} of {len(views)} photographs disagree with the "
                f"others ({listed}); use one lens at one focus and zoom, a flat board, and no "
                "photographs that a program has turned, cropped or corrected"
            )
        solution = _solve(kept, model, _without(solution, worst))
    cleaned = [
        _trimmed(view, residual, solution.sigma_px)
        for view, residual in zip(kept, solution.residuals_px, strict=True)
    ]
    dropped = sum(len(view.pixel) for view in kept) - sum(len(view.pixel) for view in cleaned)
    if dropped:
        solution = _solve(cleaned, model, solution)
    calibration = Calibration(solution, tuple(cleaned), tuple(rejected), dropped)
    _check_directions(calibration, notes)
    _check_stretch(calibration, notes)
    return calibration


def _solve(views: Sequence[BoardView], model: str, start: Solution | None) -> Solution:
    boards, pixels = [view.board for view in views], [view.pixel for view in views]
    return solve(MODELS[model], boards, pixels, views[0].resolution, start=start)


def _without(solution: Solution, index: int) -> Solution:
    return replace(
        solution,
        rotations=np.delete(solution.rotations, index, axis=0),
        translations=np.delete(solution.translations, index, axis=0),
    )


def _trimmed(view: BoardView, residual: FloatArray, sigma_px: float) -> BoardView:
    """Return a view without corners that are far off, as long as enough are left."""
    good = _lengths(residual) <= max(_CORNER_SIGMAS * sigma_px, _CORNER_FLOOR_PX)
    if good.all() or good.sum() < _LEAST_CORNERS:
        return view
    return replace(view, board=view.board[good], pixel=view.pixel[good])


def _lengths(residual: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(residual, axis=1))


def _rms(residual: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(residual**2, axis=1))))


def _check_directions(calibration: Calibration, notes: list[Note]) -> None:
    """Refuse photographs that contradict one another, or leave lens and poses mixed up."""
    path = calibration.views[0].path
    covered = calibration.covered_deg
    angles = np.linspace(0.05, 1.0, 20) * covered
    unsure = max(calibration.direction_sigma_deg(float(angle)) for angle in angles)
    misfit = calibration.corner_misfit_deg
    what = {
        "corners-misfit": (
            misfit,
            _MISFIT_DEG,
            f"corners fit with an rms of {calibration.rms_px:.2g} px only; use one lens at one "
            "focus and zoom, a flat board, and sharp photographs that no program has corrected",
        ),
        "directions-uncertain": (
            unsure,
            _UNSURE_DEG,
            f"directions are uncertain by {unsure:.2g} deg within the {covered:.3g} deg the board "
            "was seen at; photograph it large, tilted by 30 deg and more, and up to the edge",
        ),
    }
    for code, (error_deg, (noted_deg, refused_deg), message) in what.items():
        if not error_deg <= refused_deg:
            raise ImageError(f"{path} and the others: {message}")
        if error_deg > noted_deg:
            notes.append(Note(code, str(path), message))


def _check_stretch(calibration: Calibration, notes: list[Note]) -> None:
    """Refuse photographs whose pixels are not square, which the schema cannot hold."""
    views, start = calibration.views, calibration.solution
    freed = solve(
        start.model,
        [view.board for view in views],
        [view.pixel for view in views],
        calibration.resolution,
        start=start,
        free_stretch=True,
    )
    stretch = 2.0 * freed.stretch
    sigma = 2.0 * float(np.sqrt(freed.covariance[-1, -1])) * max(freed.sigma_px, _SIGMA_FLOOR_PX)
    if abs(stretch) <= max(_STRETCH_SIGMAS * sigma, _STRETCH_NOTED):
        return
    path = views[0].path
    text = f"x and y have focal lengths {100.0 * stretch:+.2g} % apart (+-{100.0 * sigma:.1g} %); "
    remedy = "give photographs that no program has resized, and see that the board's squares are "
    remedy += "square"
    if abs(stretch) > _STRETCH_REFUSED:
        raise ImageError(f"{path} and the others: {text}{remedy}")
    notes.append(Note("pixels-not-square", str(path), f"{text}their mean is taken; {remedy}"))
