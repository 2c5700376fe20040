"""The figure of a spectral light: its mean spectrum, chromaticity, maps and summary."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.notes import Note
from usdskin.plots.appearance import signal_chromaticity
from usdskin.plots.chromaticity import draw_diagram
from usdskin.plots.entries import draw_entries, entries_height
from usdskin.plots.figures import (
    CLASS_DASHES,
    CLASSES,
    FAINT,
    INK,
    legend_inside,
    name_axes,
    section_title,
    styled,
)
from usdskin.plots.sections import Section, chosen_parts, page
from usdskin.plots.spectra import WAVELENGTH, radiance_scale
from usdskin.prims.estimates import LightEstimate

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

PARTS = ("spectrum", "chromaticity", "picture", "classes", "summary")
"""What the figure shows, by the names that ``--what`` takes."""

_EXTENT = (0.0, 360.0, -90.0, 90.0)
_LEAST_PERCENT = 0.01


@dataclass(frozen=True, slots=True, eq=False)
class LightSpectra:
    """A light as its figure needs it."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""

    mean: FloatArray
    """Mean radiance over the sphere [W m^-2 sr^-1 nm^-1, or relative], shape [n]."""

    classes: dict[str, FloatArray]
    """What each class of lamps adds to it, shape [n] each; empty where there is one."""

    class_shares: NDArray[np.float32] | None
    """Share of each class in the luminance of the map [1], shape [class_count, height, width]; NaN
    where there is no light; None where there is one class."""

    units: str
    """``absolute`` or ``relative``."""

    estimate: LightEstimate | None
    """How it came about; None where the layer does not say."""

    picture: NDArray[np.float32] | None
    """Rendition for the eye, sRGB from 0 to 1, shape [height, width, 3]."""


def draw_light(
    light: LightSpectra, notes: list[Note] | None = None, *, what: Sequence[str] = ()
) -> Figure:
    """Return the figure of a spectral light.

    Args:
        light: What to draw.
        notes: Takes what the layer lacks, where nothing in particular was asked for; without a
            list that is an error.
        what: Parts of the figure, out of ``PARTS``; all by default.

    Raises:
        UsageError: No such part; matplotlib is not installed.
        LayerError: The layer lacks what was asked for.
    """
    parts = _available(light, what, notes)
    sections: list[Section] = []
    panels = [name for name in parts if name in ("spectrum", "chromaticity")]
    if panels:
        sections.append(Section(2.75, partial(_draw_panels, light=light, panels=panels)))
    if "picture" in parts:
        sections.append(Section(3.95, partial(_draw_picture, light=light)))
    if "classes" in parts:
        rows = -(-len(light.classes) // 2)
        sections.append(Section(0.4 + 1.95 * rows, partial(_draw_classes, light=light)))
    if "summary" in parts:
        height = entries_height(len(_entries(light)))
        sections.append(Section(height, partial(_draw_summary, light=light)))
    with styled():
        return page(_title(light), light.where.partition(" ")[0], sections)


def _available(
    light: LightSpectra, what: Sequence[str], notes: list[Note] | None
) -> tuple[str, ...]:
    """Return the parts to draw; what the layer lacks is a note, or an error if asked for."""
    parts = chosen_parts(what, PARTS, "a light")
    lacking = {}
    if light.class_shares is None:
        lacking["classes"] = "no coefficients of several classes"
    if light.picture is None:
        lacking["picture"] = "no RGB rendition (inputs:texture:file)"
    if light.estimate is None:
        lacking["summary"] = "no LightEstimateAPI"
    for name in [name for name in parts if name in lacking]:
        if what or (notes is None and name != "classes"):
            raise LayerError(
                f"{light.where}: has {lacking[name]}, which --what {name} draws; leave it out"
            )
        if notes is not None and name != "classes":  # most lights have one
            text = f"{name} not drawn: {lacking[name]}"
            notes.append(Note("plot-left-out", light.where, text))
    return tuple(name for name in parts if name not in lacking)


# --- Parts -------------------------------------------------------------------------------------


def _draw_panels(part: Any, *, light: LightSpectra, panels: Sequence[str]) -> None:
    widths = [2.0 if name == "spectrum" else 1.0 for name in panels]
    grid = part.subplots(1, len(panels), squeeze=False, width_ratios=widths)
    for axes, name in zip(grid.flat, panels, strict=True):
        if name == "spectrum":
            _draw_spectrum(axes, light)
        else:
            _draw_chromaticity(axes, light)


def _draw_spectrum(axes: Any, light: LightSpectra) -> None:
    """Draw the mean radiance over the sphere and what each class adds to it."""
    nm = light.wavelength_nm
    scale, label = radiance_scale(float(light.mean.max()), light.units)
    axes.plot(nm, light.mean / scale, color=INK, linewidth=1.3, label="mean over the sphere")
    for index, (name, spectrum) in enumerate(light.classes.items()):
        axes.plot(nm, spectrum / scale, color=CLASSES[index % len(CLASSES)], label=name,
                  linestyle=CLASS_DASHES[(1 + index) % len(CLASS_DASHES)])  # fmt: skip
    shown = np.stack([light.mean, *light.classes.values()]) / scale
    axes.set(xlim=(nm[0], nm[-1]), ylim=(min(0.0, shown.min()), 1.14 * shown.max()))
    axes.set_title("Mean radiance")
    name_axes(axes, WAVELENGTH, label)
    legend_inside(axes, fontsize=6.5)


def _draw_chromaticity(axes: Any, light: LightSpectra) -> None:
    nm = light.wavelength_nm
    mean = signal_chromaticity(light.mean, nm)
    others = [signal_chromaticity(spectrum, nm) for spectrum in light.classes.values()]
    corner = draw_diagram(axes, np.vstack([mean, *others]))
    for index, (name, point) in enumerate(zip(light.classes, others, strict=True)):
        axes.plot(*point, "s^vDPX"[index % 6], color=CLASSES[index % len(CLASSES)], markersize=4,
                  linestyle="none", label=name, zorder=4)  # fmt: skip
    axes.plot(*mean, "o", markerfacecolor="none", markeredgecolor=INK, markersize=6,
              linestyle="none", label="mean", zorder=5)  # fmt: skip
    axes.set_title("Chromaticity")
    legend_inside(axes, loc=corner, ncols=1, handlelength=1.0)


def _draw_picture(part: Any, *, light: LightSpectra) -> None:
    """Draw the map with the directions of the light's own frame around it."""
    section_title(
        part, "RGB rendition", "exposed, and adapted to the mean light; axes: the light's own frame"
    )
    axes = part.subplots()
    assert light.picture is not None  # _available
    axes.imshow(light.picture, extent=_EXTENT, interpolation="none")
    _name_directions(axes, 30)
    axes.set(ylabel="elevation [deg]")


def _draw_classes(part: Any, *, light: LightSpectra) -> None:
    """Draw where the light of each class comes from, in grey."""
    assert light.class_shares is not None  # _available
    section_title(part, "Classes of lamps", "share of the luminance; hatched: no light")
    rows = -(-len(light.classes) // 2)
    grid = part.subplots(rows, 2, squeeze=False)
    shown = None
    for index, axes in enumerate(grid.flat):
        if index >= len(light.classes):
            axes.set_visible(False)
            continue
        axes.set_facecolor("white")
        axes.patch.set(hatch="////", edgecolor=FAINT)
        shown = axes.imshow(light.class_shares[index], extent=_EXTENT, cmap="gray", vmin=0.0,
                            vmax=1.0, interpolation="none")  # fmt: skip
        axes.set_title(list(light.classes)[index])
        _name_directions(axes, 45)
    part.colorbar(shown, ax=grid, shrink=0.8, pad=0.01, aspect=25, label="share [1]")


def _name_directions(axes: Any, step_deg: int) -> None:
    """Name the directions of the light's own frame along a latlong map."""
    axes.set_xticks(range(0, 361, 90), ["-Z", "+X", "+Z", "-X", "-Z"])
    axes.set_xticks(range(0, 361, 30), minor=True)
    heights = range(-90, 91, step_deg)
    axes.set_yticks(heights, ["-Y", *map(str, heights[1:-1]), "+Y"])
    axes.spines[:].set_visible(False)


def _draw_summary(part: Any, *, light: LightSpectra) -> None:
    """Write names and values in three columns."""
    section_title(part, "Summary")
    draw_entries(part, _entries(light))


def _entries(light: LightSpectra) -> list[tuple[str, str]]:
    """Return what the layer says about the light, as names and values."""
    estimate = light.estimate
    assert estimate is not None  # _available
    lux, percent = "lx" if light.units == "absolute" else "relative", "%"
    reference = f" against {estimate.ssi_reference}" if estimate.ssi_reference else ""
    table: tuple[tuple[str, float | None, float, str, str], ...] = (
        ("correlated colour temperature", estimate.cct, 1.0, ".0f", "K"),
        ("Duv", estimate.duv, 1.0, "+.4f", ""),
        ("colour rendering index Ra", estimate.cri, 1.0, ".1f", ""),
        ("colour fidelity Rf (CIE 2017)", estimate.fidelity, 1.0, ".1f", ""),
        (f"SSI{reference}", estimate.ssi, 1.0, ".0f", ""),
        ("illuminance facing up", estimate.illuminance, 1.0, ".4g", lux),
        ("largest illuminance", estimate.peak_illuminance, 1.0, ".4g", lux),
        ("factor from a reading", estimate.scale, 1.0, ".4f", ""),
        ("light in clipped pixels", estimate.clipped_share, 100.0, ".2g", percent),
        ("negative energy", estimate.negative_share, 100.0, ".2g", percent),
        ("expected ΔE$_{00}$ of grey", estimate.grey_delta_e, 1.0, ".2f", ""),
        ("expected ΔE$_{00}$ of skin", estimate.skin_delta_e, 1.0, ".2f", ""),
    )
    entries = [("spectrum", " ".join(filter(None, (estimate.origin, estimate.illuminant))))]
    entries += [
        (name, _written(factor * value, style, unit))
        for name, value, factor, style, unit in table
        if value is not None
    ]
    shares = zip(estimate.classes, estimate.class_shares, strict=False)
    if len(estimate.classes) > 1:
        entries += [(f"luminous flux of {name}", f"{100.0 * s:.3g} %") for name, s in shares]
    return entries


def _written(value: float, style: str, unit: str) -> str:
    if unit == "%" and 0.0 < value < _LEAST_PERCENT:
        return f"< {_LEAST_PERCENT:g} %"
    return f"{value:{style}} {unit}".strip()


def _title(light: LightSpectra) -> str:
    if light.estimate is not None and light.estimate.origin == "assigned":
        return f"Light with an assigned spectrum: {light.estimate.illuminant or 'unnamed lamp'}"
    return "Spectral light"
