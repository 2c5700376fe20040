"""Merge the photographs of one view into linear image values with their noise.

How the weights are chosen is told in ``warp_kernels.bracket``.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers
from usdskin.errors import ImageError
from usdskin.notes import Note
from usdskin.photographs.bracket import OpenBracket, draw_samples, open_bracket
from usdskin.photographs.exposures import (
    ExposurePair,
    compare_exposures,
    least_values,
    measure_ratios,
    note_gaps,
    settle_exposures,
)
from usdskin.photographs.flat import divide_by_flat
from usdskin.photographs.merge_rows import merge_all_rows
from usdskin.photographs.noise import NoiseModel, find_noise
from usdskin.prims.views import Bracketed
from usdskin.progress import Progress, SilentProgress
from usdskin.warp_kernels import bracket as bracket_kernels
from usdskin.warp_kernels.bracket import CLIPPED, DARK, MOVED, SATURATION

if TYPE_CHECKING:
    from usdskin.photographs.response import Response

__all__ = [
    "CLIPPED",
    "DARK",
    "MOVED",
    "ExposurePair",
    "MergeReport",
    "MergedView",
    "NoiseModel",
    "merge_bracket",
]

_CELL_PX = 64  # moved objects are told by where most of their pixels are
_NOTED_SHARE = 1e-4
_LOST_SHARE = 0.99
_LIT_BY_CHANCE = 2.5e-6  # of the pixels; noise lifts 9e-7 of them to 5 standard deviations


@dataclass(frozen=True, slots=True, eq=False)
class MergeReport:
    """What a merge measured."""

    exposure: NDArray[np.float64]
    """Exposure of each image as it was used [s], shape [image_count]."""

    pairs: tuple[ExposurePair, ...]
    """Neighbours in exposure, from short to long."""

    exposure_error: float
    """Largest relative difference of a measured ratio from the stated one [1]."""

    gaps: tuple[ExposurePair, ...]
    """The pairs that leave a gap or hardly overlap."""

    noise: NoiseModel
    """The noise model used."""

    clipped_pixels: int
    """Pixels saturated in every exposure."""

    clipped_share: float
    """Their share of the picture [1]."""

    dark_share: float
    """Share of the pixels that no exposure lifts above the noise [1]."""

    moved_share: float
    """Share of the pixels whose exposures contradict one another [1]."""

    least: float
    """Least image value that is known to 10 % or better [1/s]."""

    greatest: float
    """Image value at which the shortest exposure saturates [1/s]."""


@dataclass(frozen=True, slots=True, eq=False)
class MergedView:
    """One view in linear image values, before vignetting and glare are undone."""

    values: NDArray[np.float32]
    """(DN - black) / (white - black) / exposure [1/s], signed, shape [height, width, 3]."""

    variance: NDArray[np.float32]
    """Variance of the values [s^-2], shape [height, width, 3]."""

    status: NDArray[np.uint8]
    """Bits ``CLIPPED``, ``DARK`` and ``MOVED``, shape [height, width]."""

    report: MergeReport
    """What was measured."""


def merge_bracket(
    view: Bracketed,
    workers: Workers,
    scratch: Path,
    response: Response | None = None,
    progress: Progress | None = None,
    notes: list[Note] | None = None,
    *,
    measured_exposures: bool = False,
    max_mb: int = 2048,
) -> MergedView:
    """Merge the photographs of one view.

    Args:
        view: The view; its bracket names the photographs.
        workers: Where kernels run.
        scratch: Folder for decoded raw files.
        response: Response curve of the camera; None where raw values are linear.
        progress: Told about the rows done.
        notes: Takes what does not stop the merge.
        measured_exposures: Use the ratios of exposures that the pictures show, not the stated ones.
        max_mb: Refuse photographs of which one needs more memory than this as float32 [MiB].

    Raises:
        ImageError: A photograph is missing, broken, or of another size or kind than the others; or
            all are black, or saturated.
        LayerError: Stated exposures or levels contradict the pictures.
    """
    progress = SilentProgress() if progress is None else progress
    notes = [] if notes is None else notes
    compilation.prepare((bracket_kernels,), workers.device, progress)
    progress.start(len(view.bracket.images), f"open {view.name}")
    with open_bracket(view, scratch, response, max_mb, progress.advance) as bracket:
        samples = draw_samples(bracket, workers)
        ratios = measure_ratios(bracket, samples)
        exposure, doubt = settle_exposures(bracket, ratios, measured_exposures, notes)
        noise = find_noise(bracket, samples, exposure, notes)
        del samples
        progress.start(bracket.size[0], f"merge {view.name}")
        values, variance, status = merge_all_rows(
            bracket, exposure, doubt, noise, workers, progress.advance
        )
        progress.done()
        _refuse_lost(bracket, status)
        if bracket.flat is not None:
            divide_by_flat(bracket, bracket.flat, values, variance, notes)
        report = _report(bracket, exposure, ratios, noise, status, notes)
    if report.moved_share > _NOTED_SHARE:
        notes.append(_moved_note(view, status, report.moved_share))
    return MergedView(values, variance, status, report)


def _report(
    bracket: OpenBracket,
    exposure: NDArray[np.float64],
    ratios: list[float | None],
    noise: NoiseModel,
    status: NDArray[np.uint8],
    notes: list[Note],
) -> MergeReport:
    pairs = compare_exposures(bracket, ratios, noise)
    used = np.empty_like(exposure)
    used[bracket.order] = exposure
    counts = {bit: int(np.count_nonzero(status & bit)) for bit in (CLIPPED, DARK, MOVED)}
    return MergeReport(
        exposure=used,
        pairs=pairs,
        exposure_error=max((abs(pair.error) for pair in pairs), default=0.0),
        gaps=note_gaps(bracket, pairs, notes),
        noise=noise,
        clipped_pixels=counts[CLIPPED],
        clipped_share=counts[CLIPPED] / status.size,
        dark_share=counts[DARK] / status.size,
        moved_share=counts[MOVED] / status.size,
        least=float(least_values(bracket, noise).min()),
        greatest=float(SATURATION / exposure[0]),
    )


def _refuse_lost(bracket: OpenBracket, status: NDArray[np.uint8]) -> None:
    """Refuse a bracket that shows nothing but black and saturation."""
    lit = int(np.count_nonzero((status & DARK) == 0))
    clipped = np.count_nonzero(status & CLIPPED)
    where, shortest = bracket.view.where, bracket.frames[0].path
    if lit <= _LIT_BY_CHANCE * status.size:
        raise ImageError(
            f"{where}: every photograph is black, no pixel stands above the noise; photograph the "
            "view again (was the lens covered?), or correct bracket:blackLevel, "
            f"{bracket.black.max():g}"
        )
    if clipped >= _LOST_SHARE * lit:
        raise ImageError(
            f"{where}: everything that is not black is saturated, even in the shortest exposure "
            f"{shortest}; photograph the view again with shorter exposures, or correct "
            f"bracket:whiteLevel, {bracket.white.min():g}"
        )


def _moved_note(view: Bracketed, status: NDArray[np.uint8], share: float) -> Note:
    """Tell how much moved, and where most of it is."""
    moved = (status & MOVED) != 0
    rows = np.add.reduceat(moved, np.arange(0, moved.shape[0], _CELL_PX), axis=0, dtype=np.int64)
    cells = np.add.reduceat(rows, np.arange(0, moved.shape[1], _CELL_PX), axis=1)
    i, j = (int(index) * _CELL_PX for index in np.unravel_index(cells.argmax(), cells.shape))
    inside = np.argwhere(moved[i : i + _CELL_PX, j : j + _CELL_PX])
    y, x = np.median(inside, axis=0).astype(int) + np.array([i, j])
    return Note(
        "moved-object",
        view.where,
        f"{share:.2%} of the pixels, most of them around x {x}, y {y}, contradict from exposure to "
        "exposure: something moved; they count less where another view sees the same",
    )
