"""Find a chart in its picture, and believe it only where its colors say so.

OpenCV's mcc proposes places; its own cost tells nothing about whether they are right, and a Digital
SG it mostly takes for turned or mirrored. What counts is that the patches found there follow their
spectra (see ``fit``), are even, and do so in one orientation alone.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import ImageError, LayerError
from usdskin.estimate.chart.check import LARGEST_ERROR
from usdskin.estimate.chart.fit import SpectraFit, fit_spectra
from usdskin.estimate.chart.lattice import find_in_lattice
from usdskin.estimate.chart.layouts import Layout
from usdskin.estimate.chart.plane import UNIT_CORNERS, chart_plane
from usdskin.estimate.chart.refine import refine_corners
from usdskin.estimate.chart.sample import PatchSamples, sample_patches
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

_LARGEST_SIDE = 1600  # [px]; larger pictures are searched at this size
_WHITE_PERCENTILES = (99.0, 90.0, 99.9, 60.0)
"""Percentiles of the picture's brightness that are shown as white, tried one after another: lamps
in the picture are brighter than the chart, what surrounds it may be darker."""

_CANDIDATES = 4
_UNEVEN = 0.05  # spread within a patch of the chart, as light falls off over it
_AMBIGUOUS = 0.5  # of the error in any other place or turn
_MCC_KINDS = {"classic24": "MCC24", "sg140": "SG140"}
_MCC_MARGIN = 0.1
"""Around the patches in the box of mcc's models, in sides of a patch."""

_TURNS = ("upright", "turned right by 90 degrees", "upside down", "turned left by 90 degrees")


@dataclass(frozen=True, slots=True, eq=False)
class FoundChart:
    """Where a chart was found."""

    corners: FloatArray
    """Top left, top right, bottom right and bottom left of its patches [px], shape [4, 2]."""

    orientation: str
    """How it lies in the picture, in words."""

    error: float
    """How far its patches are from following their spectra, the median [1]."""

    samples: PatchSamples
    """Its camera values."""


def find_corners(
    values: NDArray[np.float32],
    layout: Layout,
    signals: ArrayLike,
    *,
    variance: NDArray[np.float32] | None = None,
    status: NDArray[np.uint8] | None = None,
    lens: FisheyeLens | None = None,
    where: str = "chart",
) -> FoundChart:
    """Find a chart in a picture.

    Args:
        values: Linear picture, shape [height, width, 3].
        layout: Which chart to look for.
        signals: Radiance of its patches in any unit, or reflectance times the lamp, in the order
            of the layout, shape [patch_count, band_count].
        variance: Variance of the values; None: unknown. Shape [height, width, 3].
        status: Bits of ``usdskin.photographs.merge``, shape [height, width].
        lens: Lens of the picture, in its size.
        where: Layer and prim path, for errors.

    Raises:
        LayerError: The chart is not found, or what is found cannot be trusted.
    """
    fit = fit_spectra(signals)
    best: FoundChart | None = None
    for corners in _proposals(values, layout):
        found = _recognised(values, variance, status, layout, corners, lens, fit)
        if found is not None and (best is None or found.error < best.error):
            best = found
        if best is not None and best.error <= 0.5 * LARGEST_ERROR:
            break
    if best is None or best.error > LARGEST_ERROR:
        nearest = "" if best is None else f" (the nearest place is off by {best.error:.0%})"
        raise LayerError(
            f"{where}: the chart is not found in its picture, as no place shows its colors"
            f"{nearest}; give its corners by chart:corners or --corners"
        )
    return best


def _proposals(values: NDArray[np.float32], layout: Layout) -> Iterator[FloatArray]:
    """Yield the corners of what mcc takes for charts [px], shape [4, 2]."""
    import cv2

    height, width = values.shape[:2]
    factor = min(_LARGEST_SIDE / max(height, width), 1.0)
    size = (max(round(width * factor), 1), max(round(height * factor), 1))
    grow = np.array([width / size[0], height / size[1]])
    small = cv2.resize(np.maximum(values, 0.0), size, interpolation=cv2.INTER_AREA)
    small = small / np.maximum(small.reshape(-1, 3).mean(axis=0), np.float32(1e-30))
    brightness = small.mean(axis=2)
    lit = brightness[brightness > 0.0]
    if not lit.size:
        return
    margin = 2.0 * _MCC_MARGIN * layout.half_size
    field = (UNIT_CORNERS + margin) / (1.0 + 2.0 * margin)
    for percentile in _WHITE_PERCENTILES:
        encoded = np.clip(small / np.percentile(lit, percentile), 0.0, 1.0) ** (1.0 / 2.2)
        mcc: Any = cv2.mcc
        detector = mcc.CCheckerDetector_create()
        kind: tuple[int, ...] = (getattr(mcc, _MCC_KINDS[layout.name]),)
        if hasattr(detector, "setColorChartType"):  # of OpenCV 5
            detector.setColorChartType(*kind)
            kind = ()
        picture = np.ascontiguousarray((255.0 * encoded[..., ::-1] + 0.5).astype(np.uint8))
        if not detector.process(picture, *kind, _CANDIDATES):
            continue
        for checker in detector.getListColorChecker():
            box = np.asarray(checker.getBox(), np.float64).reshape(4, 2)
            box = box[[1, 0, 3, 2]] if _is_mirrored(box) else box
            try:
                plane = chart_plane(box * grow, None, "mcc")
            except LayerError:
                continue
            yield plane.to_picture(field)


def _recognised(
    values: NDArray[np.float32],
    variance: NDArray[np.float32] | None,
    status: NDArray[np.uint8] | None,
    layout: Layout,
    corners: FloatArray,
    lens: FisheyeLens | None,
    fit: SpectraFit,
) -> FoundChart | None:
    """Return the chart at or beside a proposal; None: its colors fit nowhere, or in two places."""
    try:
        grid = refine_corners(values, layout, corners, lens, "proposal")
        found = find_in_lattice(values, layout, chart_plane(grid, lens, "proposal"), fit)
        if found is None:
            return None
        refined = refine_corners(values, layout, found[0], lens, "proposal")
        samples = sample_patches(values, variance, status, layout, refined, lens)
    except (LayerError, ImageError):
        return None
    error = fit.error(samples.values)
    if float(np.median(samples.evenness)) > _UNEVEN or error > _AMBIGUOUS * found[1]:
        return None
    return FoundChart(refined, _orientation(refined), error, samples)


def _orientation(corners: FloatArray) -> str:
    """Return how a chart lies in the picture, from where its upper edge runs."""
    x, y = corners[1] - corners[0]
    return _TURNS[round(float(np.arctan2(y, x)) / (0.5 * np.pi)) % 4]


def _is_mirrored(corners: FloatArray) -> bool:
    x, y = corners.T
    return bool((x * np.roll(y, -1) - y * np.roll(x, -1)).sum() < 0.0)
