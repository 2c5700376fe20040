"""The capture report in words: what was measured, and what to do about each problem."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from usdskin.capture.quality.report import CaptureReport, LampReport

_LISTED = 5
"""Lamps told one by one."""

# From these on a figure is a problem, since it then costs more than the rest of the pipeline;
# DESIGN section 7 and the bars of the capture step have them.
_COVERAGE = 0.99
_SHARE = 0.005
_EXPOSURE_ERROR = 0.03
_FLUX_DIFFERENCE = 1e-3
_RESIDUAL_DEG = 0.2
_NOISE = 0.02
_OVERLAP = 0.05
_MISSING = 0.05


@dataclass(frozen=True, slots=True)
class Statement:
    """One topic of the report."""

    topic: str
    """What it is about, one word."""

    text: str
    """What was measured, in sentences."""

    advice: tuple[str, ...] = ()
    """What is wrong and what to do, a sentence or two each."""


def state(report: CaptureReport) -> tuple[Statement, ...]:
    """Return what a report has to tell, what matters most first."""
    return (
        _whole(report),
        _light(report),
        *_lamps(report),
        _scale(report),
        _coverage(report),
        _exposures(report),
        _rotations(report),
        _noise(report),
        _motion(report),
        _composition(report),
    )


# --- Topics ------------------------------------------------------------------------------------


def _whole(report: CaptureReport) -> Statement:
    views = _count(len(report.views), "view")
    images = _count(report.image_count, "photograph")
    size = f"{report.width} x {report.height} pixels"
    return Statement("Capture", f"{report.name}, {views}, {images}, panorama of {size}.")


def _light(report: CaptureReport) -> Statement:
    parts = report.flux_parts
    largest = max(parts, key=lambda name: parts[name])
    if report.contradiction > _OVERLAP:
        return _contradicted(report)
    text = f"the sum of all light is right to about {_percent(report.flux_error)}"
    if report.flux_error > _SHARE:
        text += f"; most of the doubt comes from {largest} ({_percent(parts[largest])})"
    return Statement("Light", f"{text}.")


def _contradicted(report: CaptureReport) -> Statement:
    text = (
        f"overlapping views contradict each other by {_percent(report.contradiction)}, so the sum "
        f"of all light may be wrong by {_percent(report.flux_error)}."
    )
    advice = (
        "Check the lens (projection, focal length, field, vignetting and glare) and the directions "
        "of the views before this light is used, and whether the light changed between the views."
    )
    if any(view.rotation_change_deg is None for view in report.views):
        advice += " Directions that are a few degrees off are mended by --refine-rotations."
    return Statement("Light", text, (advice,))


def _lamps(report: CaptureReport) -> list[Statement]:
    lamps = report.lamps
    if not lamps:
        return [Statement("Lamps", "none was saturated in every exposure.")]
    share = _percent(report.clipped_share)
    count = _count(len(lamps), "lamp")
    was = "was" if len(lamps) == 1 else "were"
    text = f"{count} {was} saturated in every exposure, with at least {share} of all light."
    unmeasured = [lamp for lamp in lamps if not lamp.is_measured]
    lost = sum(lamp.flux_share for lamp in unmeasured)
    advice = []
    if lost > _SHARE:
        advice.append(
            f"A lamp twice as bright as its pixels show leaves as much missing as they hold, here "
            f"{_percent(lost)}. Add shorter exposures or a neutral density filter, or measure the "
            "lamp alone with an illuminance meter and give --lamp-illuminance lamp1=LUX."
        )
    statements = [Statement("Lamps", text, tuple(advice))]
    unit = " lx" if report.scale.units == "absolute" else ""
    for number, lamp in enumerate(lamps[:_LISTED], 1):
        statements.append(Statement(f"Lamp {number}", *_lamp(lamp, unit)))
    rest = lamps[_LISTED:]
    if rest:
        share = _percent(sum(lamp.flux_share for lamp in rest))
        statements.append(
            Statement("Further", f"{_count(len(rest), 'lamp')}, {share} of all light.")
        )
    return statements


def _lamp(lamp: LampReport, unit: str) -> tuple[str, tuple[str, ...]]:
    side = "above" if lamp.elevation_deg >= 0.0 else "below"
    text = (
        f"{_degrees(abs(lamp.elevation_deg))} {side} the horizon, at column {lamp.column}, row "
        f"{lamp.row}; as large as a disc of {_degrees(lamp.diameter_deg)}"
    )
    text += (
        f"; at least {_percent(lamp.flux_share)} of all light, and "
        f"{_percent(lamp.irradiance_share)} of what reaches a surface facing it"
    )
    if unit:
        text += f", {_number(lamp.illuminance)}{unit}"
    if lamp.is_measured:
        text += f"; raised {lamp.factor:.3g} times to its measured illuminance"
    advice = []
    if lamp.is_measured and lamp.color_source == "clipped":
        advice.append(
            "Its color is that of clipped pixels and uncertain, for no unclipped rim shows it: "
            "only a shorter exposure tells."
        )
    if lamp.reaches_unseen:
        advice.append(
            "It touches an area that no view saw and may be larger: add a view that faces it."
        )
    return f"{text}.", tuple(advice)


def _scale(report: CaptureReport) -> Statement:
    scale = report.scale
    if scale.source == "none":
        return Statement(
            "Scale",
            "relative, in camera values; no reading was taken.",
            (
                "For absolute light read the luminance of an even surface, or the illuminance at "
                "the camera, and author capture:luminance or capture:illuminance with its "
                "direction.",
            ),
        )
    reading = (
        f"luminance reading of {_number(scale.luminance)} cd/m2"
        if scale.source == "luminance"
        else f"illuminance reading of {_number(scale.illuminance_lx)} lx"
    )
    text = f"one camera value is {_number(scale.factor)} cd/m2, from the {reading}."
    if scale.source == "illuminance":
        advice = []
        if scale.clipped_share > _SHARE:
            advice.append(
                f"{_percent(scale.clipped_share)} of what the meter faced is in clipped lamps, so "
                "the scale is too high. Read a luminance too, or measure the lamp and give "
                "--lamp-illuminance."
            )
        return Statement("Scale", text, tuple(advice))
    if not scale.illuminance_lx:
        return Statement("Scale", text)
    shown = f"{_number(scale.panorama_illuminance_lx)} of {_number(scale.illuminance_lx)} lx"
    text += f" At the illuminance meter the panorama gives {shown}."
    missing = scale.missing_lx / scale.illuminance_lx
    if missing > _MISSING:
        cause = (
            "Clipped lamps hold it: add shorter exposures, or measure the lamp and give "
            "--lamp-illuminance."
            if scale.clipped_share > 0.0
            else "No lamp before the meter is clipped: check both readings, their directions, and "
            "the vignetting of the lens."
        )
        return Statement("Scale", text, (f"{_percent(missing)} is missing. {cause}",))
    if missing < -_MISSING:
        advice_text = (
            f"That is {_percent(-missing)} too much: check both readings and their directions, "
            "the meter's shadow among them. Where the surface that was read is colored, some "
            "percent are the camera's: its values are no luminances until spectra are estimated."
        )
        return Statement("Scale", text, (advice_text,))
    return Statement("Scale", text)


def _coverage(report: CaptureReport) -> Statement:
    text = f"{_percent(report.coverage)} of the sphere was seen"
    hole = 1.0 - report.coverage
    if hole < 1e-6:
        return Statement("Coverage", f"{text}.")
    share = _percent(report.figures.unseen_flux_share)
    text += (
        f"; the rest is filled in from its surroundings and holds {share} of the light. The "
        f"largest hole is {_degrees(report.largest_hole_deg)} across."
    )
    if report.coverage >= _COVERAGE and report.figures.unseen_flux_share < _SHARE:
        return Statement("Coverage", text)
    return Statement(
        "Coverage", text, ("Add a view that faces the hole; the quality picture shows where.",)
    )


def _exposures(report: CaptureReport) -> Statement:
    error = report.exposure_error
    if error is None:
        text = "no two photographs share pixels that could check their settings."
    else:
        text = f"the photographs agree with their settings to {_percent(error)}."
    advice = []
    for view in report.views:
        if view.exposure_error is not None and view.exposure_error > _EXPOSURE_ERROR:
            pair = " and ".join(view.worst_pair) if view.worst_pair else "two photographs"
            advice.append(
                f"View {view.name}: {pair} differ by {_percent(view.exposure_error)} from the "
                "ratio of their settings. Correct the settings in the shoot layer, or lock "
                "aperture and shutter."
            )
        advice += [
            f"View {view.name}: {gap} leave brightnesses between them that neither shows well. "
            "Take a photograph between them."
            for gap in view.gaps
        ]
    return Statement("Exposures", text, tuple(advice))


def _rotations(report: CaptureReport) -> Statement:
    changes = [view for view in report.views if view.rotation_change_deg is not None]
    residual = report.rotation_residual_deg
    sentences = []
    if changes:
        most = max(changes, key=lambda view: view.rotation_change_deg or 0.0)
        turned = _degrees(most.rotation_change_deg or 0.0)
        sentences.append(f"refined by up to {turned} (view {most.name})")
    else:
        sentences.append("taken as stated")
    if residual is not None:
        before = report.rotation_residual_before_deg
        was = f", {_degrees(before)} before" if changes and before is not None else ""
        sentences.append(f"overlapping views agree to {_degrees(residual)}{was}")
    advice = []
    if residual is not None and residual > _RESIDUAL_DEG:
        remedy = (
            "Turn the camera about the entrance pupil of its lens, and check the lens calibration."
            if changes
            else "Refine the rotations with --refine-rotations."
        )
        advice.append(f"Overlapping views are {_degrees(residual)} apart. {remedy}")
    loose = [view.name for view in report.views if not view.is_constrained]
    if loose:
        advice.append(
            f"No overlap tells where {_listed(loose)} faces: check its rotation in the shoot layer."
        )
    return Statement("Rotations", f"{'; '.join(sentences)}.", tuple(advice))


def _noise(report: CaptureReport) -> Statement:
    noise = report.figures.noise
    text = f"{_percent(noise)} in the median of the pixels above a tenth of the mean."
    dark = [view for view in report.views if view.dark_share > _SHARE]
    advice = []
    if noise > _NOISE:
        advice.append("Add longer exposures, or use a lower ISO setting.")
    if dark:
        worst = max(dark, key=lambda view: view.dark_share)
        advice.append(
            f"View {worst.name}: {_percent(worst.dark_share)} of its pixels are darker than the "
            "noise in every exposure. Add a longer one if the dark parts matter."
        )
    return Statement("Noise", text, tuple(advice))


def _motion(report: CaptureReport) -> Statement:
    share = report.figures.moved_share
    if share == 0.0:
        return Statement("Motion", "none was found between the exposures.")
    text = f"the exposures contradict each other over {_percent(share)} of the sphere."
    if share <= _SHARE:
        return Statement("Motion", text)
    advice = (
        "Something moved or a lamp flickered: see the yellow outlines of the quality picture, and "
        "take that view again."
    )
    return Statement("Motion", text, (advice,))


def _composition(report: CaptureReport) -> Statement:
    text = f"the flux of each view is kept to {_percent(report.flux_difference)}"
    if report.overlap_difference is not None:
        text += f"; overlapping views differ by {_percent(report.overlap_difference)} in the median"
    glare = [view.found_glare for view in report.views if view.found_glare is not None]
    if glare:
        shares = _percent(min(glare))
        if max(glare) > 1.1 * min(glare):
            shares += f" to {_percent(max(glare))}"
        text += f"; {shares} of glare, found beyond the image circles, was subtracted"
    if report.negative_share > 0.0:
        text += f"; {_percent(report.negative_share)} of the sphere fell below zero and is black"
    advice = []
    if report.flux_difference > _FLUX_DIFFERENCE:
        advice.append("The panorama is too coarse for its lamps: give it more pixels with --width.")
    if report.negative_share > _SHARE:
        advice.append("The black level or the glare of the lens is set too high: check both.")
    return Statement("Composition", f"{text}.", tuple(advice))


# --- Numbers -----------------------------------------------------------------------------------


def _percent(share: float) -> str:
    """Return a share with two or three digits that mean something, such as ``0.42 %``."""
    value = 100.0 * share
    if value == 0.0:
        return "0 %"
    if abs(value) < 0.01:
        return "less than 0.01 %"
    if 99.99 <= value < 100.0:
        return "more than 99.99 %"
    if 99.0 <= value < 100.0:  # what is missing from the whole counts here
        return f"{math.floor(value * 100.0) / 100.0:.2f} %"
    return f"{value:.2g} %" if abs(value) < 10.0 else f"{value:.0f} %"


def _degrees(angle: float) -> str:
    value = f"{angle:.2g}" if angle < 10.0 else f"{angle:.0f}"
    return f"{value} degrees"


def _number(value: float) -> str:
    """Return three digits, without an exponent where the number is of a usual size."""
    if value == 0.0 or not 1e-3 <= abs(value) < 1e7:
        return f"{value:.3g}"
    digits = max(0, 2 - math.floor(math.log10(abs(value))))
    return f"{value:.{digits}f}"


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}{'' if number == 1 else 's'}"


def _listed(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
