"""What a finished panorama tells: its lamps, its scale, and how right it is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.quality.lamps import Lamp, Replacement, find_lamps, replace_lamp
from usdskin.capture.quality.report import (
    CaptureReport,
    ViewReport,
    measure_panorama,
    report_lamp,
    report_view,
)
from usdskin.capture.quality.scale import MeasuredLamp, scale_of
from usdskin.capture.views.align import Alignment, AlignView
from usdskin.capture.views.panorama import Panorama
from usdskin.errors import UsageError
from usdskin.latlong import latlong_from_world
from usdskin.notes import Note
from usdskin.photographs.merge import MergeReport
from usdskin.prims import FisheyeLens, Shoot, View


@dataclass(frozen=True, slots=True, eq=False)
class PlacedView:
    """One view after its merge: what is kept of it."""

    view: View
    """As the shoot describes it."""

    lens: FisheyeLens
    """Its lens, at the size of its pictures."""

    merge: MergeReport
    """What its merge measured."""

    small: AlignView
    """It, reduced, for the alignment."""


@dataclass(frozen=True, slots=True, eq=False)
class Measured:
    """The panorama on its scale, and what is known about it."""

    values: NDArray[np.float32]
    """Camera values times the scale, shape [height, width, 3]."""

    stddev: NDArray[np.float32]
    """Their standard deviation, shape [height, width, 3]."""

    lamps: tuple[Lamp, ...]
    """Lamps that were saturated in every exposure, the largest flux first."""

    report: CaptureReport
    """What is to be told."""


def measure(
    shoot: Shoot,
    placed: Sequence[PlacedView],
    panorama: Panorama,
    alignment: Alignment,
    is_refined: bool,
    lamp_readings: Sequence[tuple[str, float]],
    notes: list[Note],
) -> Measured:
    """Bring a panorama to its scale, mend its lamps, and say how right it is.

    Args:
        shoot: The readings and weights.
        placed: Its views.
        panorama: Made of them.
        alignment: How they fit each other.
        is_refined: Whether the alignment's rotations were used.
        lamp_readings: Names of clipped lamps, ``lamp1`` having the largest flux or empty for the
            only one, and the illuminance of a surface facing each [lx].
        notes: Takes what makes the result uncertain.

    Raises:
        UsageError: A lamp reading does not fit what was photographed.
        LayerError: A reading of the shoot cannot be used.
    """
    weights, turn = shoot.luminance_weights, latlong_from_world(shoot.up_axis)
    lamps = find_lamps(panorama.values, panorama.clipped, panorama.seen, weights)
    read = _lamps_read(lamps, lamp_readings)
    scale = scale_of(
        shoot,
        panorama.values,
        panorama.clipped,
        panorama.seen,
        turn,
        notes,
        measured=[MeasuredLamp(lamps[index], lux) for index, lux in read.items()],
    )
    if read and scale.source == "none":
        raise UsageError(
            f"--lamp-illuminance: {shoot.where} has neither capture:luminance nor "
            "capture:illuminance, so nothing says how camera values become lux; author one of them"
        )
    values, stddev = panorama.values, panorama.stddev
    replaced: dict[int, Replacement] = {}
    for index, lux in read.items():
        replaced[index] = replace_lamp(
            values, stddev, panorama.clipped, lamps[index], lux / scale.factor, weights
        )
    before, after = alignment.residual_before_deg, alignment.residual_after_deg
    report = CaptureReport(
        name=shoot.name,
        width=values.shape[1],
        height=values.shape[0],
        views=_view_reports(placed, panorama, alignment, is_refined),
        figures=measure_panorama(values, stddev, panorama.seen, panorama.moved, weights),
        coverage=panorama.coverage,
        largest_hole_deg=max((hole.diameter_deg for hole in panorama.holes), default=0.0),
        negative_share=panorama.negative_share,
        overlap_difference=panorama.overlap_difference,
        rotation_residual_before_deg=before,
        rotation_residual_deg=after if is_refined else before,
        lamps=tuple(
            report_lamp(lamp, scale, weights, turn.T, replaced.get(index))
            for index, lamp in enumerate(lamps)
        ),
        scale=scale,
    )
    if scale.factor != 1.0:
        factor = np.float32(scale.factor)
        values, stddev = values * factor, stddev * factor
    return Measured(values, stddev, lamps, report)


def _view_reports(
    placed: Sequence[PlacedView], panorama: Panorama, alignment: Alignment, is_refined: bool
) -> tuple[ViewReport, ...]:
    return tuple(
        report_view(
            item.view,
            item.merge,
            flux_difference=composed.flux_error,
            found_glare=item.lens.glare if item.lens.glare != item.view.lens.glare else None,
            rotation_change_deg=float(alignment.change_deg[index]) if is_refined else None,
            is_constrained=bool(alignment.constrained[index]),
        )
        for index, (item, composed) in enumerate(zip(placed, panorama.views, strict=True))
    )


def _lamps_read(lamps: Sequence[Lamp], given: Sequence[tuple[str, float]]) -> dict[int, float]:
    """Return the illuminances [lx] by the index of their lamp."""
    names = [f"lamp{index + 1}" for index in range(len(lamps))]
    read: dict[int, float] = {}
    for name, lux in given:
        if not lamps:
            raise UsageError(
                "--lamp-illuminance: no lamp was saturated in every exposure; leave it out"
            )
        if not name and len(lamps) > 1:
            raise UsageError(
                f"--lamp-illuminance {lux:g}: {len(lamps)} lamps are saturated; say which, such as "
                f"{names[0]}={lux:g} (the quality picture numbers them)"
            )
        if name and name not in names:
            raise UsageError(
                f"--lamp-illuminance {name}={lux:g}: no such lamp; there is {', '.join(names)}"
            )
        index = names.index(name) if name else 0
        if index in read:
            raise UsageError(f"--lamp-illuminance: {names[index]} is given twice; give it once")
        read[index] = lux
    return read
