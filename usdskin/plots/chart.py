"""The figure of a colour chart: what the spectrophotometer saw, and what the camera saw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import encode_srgb, linearize
from usdskin.errors import LayerError
from usdskin.notes import Note
from usdskin.plots.appearance import display_colors, line_colors, signal_chromaticity
from usdskin.plots.chromaticity import draw_diagram
from usdskin.plots.figures import (
    CHANNELS,
    FAINT,
    INK,
    legend_inside,
    name_axes,
    section_title,
    styled,
)
from usdskin.plots.sections import Section, chosen_parts, page
from usdskin.plots.spectra import WAVELENGTH, radiance_scale

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FloatArray = NDArray[np.float64]

PARTS = ("signals", "chromaticity", "values", "patches")
"""What the figure shows, by the names that ``--what`` takes."""

_MOST_NAMED = 48


@dataclass(frozen=True, slots=True, eq=False)
class ChartSpectra:
    """A chart as its figure needs it, patch by patch."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    title: str
    """What the chart and its light are called."""

    names: tuple[str, ...]
    """Names of the patches, shape [m]."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""

    signals: FloatArray
    """Radiance of the patches [W m^-2 sr^-1 nm^-1, or relative], shape [m, n]."""

    illuminant: FloatArray
    """Radiance of a perfect diffuser among them, shape [n]."""

    units: str
    """``absolute`` or ``relative``."""

    camera_values: FloatArray | None
    """Camera values rho, shape [m, 3]; None: they are still in photographs."""

    positions: NDArray[np.int64]
    """Column and row of each patch as the makers show the chart, shape [m, 2]."""


def draw_chart(
    charts: Sequence[ChartSpectra], notes: list[Note] | None = None, *, what: Sequence[str] = ()
) -> Figure:
    """Return the figure of colour charts, one below the other.

    Args:
        charts: What to draw, at least one.
        notes: Takes what a layer lacks, where nothing in particular was asked for; without a
            list that is an error.
        what: Parts of the figure, out of ``PARTS``; all by default.

    Raises:
        UsageError: No such part; matplotlib is not installed.
        LayerError: A layer lacks what was asked for.
    """
    parts = chosen_parts(what, PARTS, "a chart")
    sections: list[Section] = []
    for chart in charts:
        known = _available(chart, parts, notes if not what else None)
        panels = [name for name in known if name in ("signals", "chromaticity")]
        if panels:
            draw = partial(_draw_panels, chart=chart, panels=panels)
            sections.append(Section(2.85, draw))
        if "patches" in known:
            shape = chart.positions.max(axis=0) + 1
            height = 0.3 + 7.2 * float(shape[1] / shape[0]) * (0.62 if shape[0] < 10 else 0.75)
            sections.append(Section(height, partial(_draw_patches, chart=chart)))
        if "values" in known:
            longest = max(map(len, chart.names)) if len(chart.names) <= _MOST_NAMED else 3
            height = 1.9 + 0.058 * longest
            sections.append(Section(height, partial(_draw_values, chart=chart)))
    with styled():
        return page("Colour chart", charts[0].where.partition(" ")[0], sections)


def _available(
    chart: ChartSpectra, parts: Sequence[str], notes: list[Note] | None
) -> tuple[str, ...]:
    if chart.camera_values is not None or "values" not in parts:
        return tuple(parts)
    reason = "camera values are still in photographs; `usdskin calibrate camera` reads them"
    if notes is None:
        raise LayerError(f"{chart.where}: {reason}, so leave --what values out")
    notes.append(Note("plot-left-out", chart.where, f"values not drawn: {reason}"))
    return tuple(name for name in parts if name != "values")


def _draw_panels(part: Any, *, chart: ChartSpectra, panels: Sequence[str]) -> None:
    section_title(part, chart.title)
    widths = [2.0 if name == "signals" else 1.0 for name in panels]
    grid = part.subplots(1, len(panels), squeeze=False, width_ratios=widths)
    for axes, name in zip(grid.flat, panels, strict=True):
        if name == "signals":
            _draw_signals(axes, chart)
        else:
            _draw_chromaticity(axes, chart)


def _draw_signals(axes: Any, chart: ChartSpectra) -> None:
    """Draw the radiance of every patch in its own color, and that of a perfect diffuser."""
    nm = chart.wavelength_nm
    peak = max(float(chart.signals.max()), float(chart.illuminant.max()))
    scale, label = radiance_scale(peak, chart.units)
    colors = line_colors(display_colors(chart.signals, chart.illuminant, nm))
    for signal, color in zip(chart.signals, colors, strict=True):
        axes.plot(nm, signal / scale, color=tuple(color), linewidth=0.8)
    axes.plot(nm, chart.illuminant / scale, color=INK, linestyle=(0, (3.2, 1.6)), linewidth=1.0,
              label="perfect diffuser")  # fmt: skip
    low = min(0.0, float(chart.signals.min()))
    axes.set(xlim=(nm[0], nm[-1]), ylim=(low / scale, 1.12 * peak / scale))
    axes.set_title("Signals")
    name_axes(axes, WAVELENGTH, label)
    legend_inside(axes)


def _draw_chromaticity(axes: Any, chart: ChartSpectra) -> None:
    nm = chart.wavelength_nm
    points = signal_chromaticity(chart.signals, nm)
    light = signal_chromaticity(chart.illuminant, nm)
    corner = draw_diagram(axes, np.vstack([points, light[None]]))
    colors = display_colors(chart.signals, chart.illuminant, nm)
    size = 18.0 if len(points) <= _MOST_NAMED else 7.0
    axes.scatter(*points.T, s=size, c=colors, edgecolors=INK, linewidths=0.5, zorder=4)
    axes.plot(*light, "+", color=INK, markersize=7, linestyle="none", label="light", zorder=5)
    axes.set_title("Chromaticity")
    legend_inside(axes, loc=corner, ncols=1, handlelength=1.0)


def _draw_values(part: Any, *, chart: ChartSpectra) -> None:
    """Draw the camera values of the patches on a logarithmic axis."""
    section_title(part, "Camera values")
    axes = part.subplots()
    order = np.arange(len(chart.names))
    assert chart.camera_values is not None  # _available
    for channel, name in enumerate("RGB"):
        values = chart.camera_values[:, channel]
        axes.plot(order, np.where(values > 0.0, values, np.nan), "o^s"[channel], markersize=3.6,
                  color=CHANNELS[channel], markerfacecolor="none" if channel == 1 else None,
                  linestyle="none", label=name)  # fmt: skip
    axes.set_yscale("log")
    axes.set_xlim(-0.7, len(order) - 0.3)
    axes.grid(True)
    step = 1 if len(order) <= _MOST_NAMED else -(-len(order) // 35)
    axes.set_xticks(order[::step], chart.names[::step], rotation=90, fontsize=6.0)
    axes.set_ylabel("camera value rho")
    legend_inside(axes, loc="lower left")


def _draw_patches(part: Any, *, chart: ChartSpectra) -> None:
    """Draw the chart as the instrument saw it, and as the camera did within each patch.

    The camera's values go to linear sRGB by the 3 x 3 matrix that fits best: a patch that was
    mixed up with another shows at once.
    """
    from matplotlib.patches import Rectangle

    measured = display_colors(chart.signals, chart.illuminant, chart.wavelength_nm)
    seen = None
    note = "as the signals say, seen by an eye adapted to the light"
    if chart.camera_values is not None:
        seen = _camera_colors(chart.camera_values, measured)
        note = "outside: as the signals say; inside: the camera's, by the best 3 x 3 matrix"
    section_title(part, "Patches", note)
    axes = part.subplots()
    for index, (column, row) in enumerate(chart.positions):
        axes.add_patch(Rectangle((column + 0.04, row + 0.04), 0.92, 0.92,
                                 facecolor=tuple(measured[index]), edgecolor=FAINT))  # fmt: skip
        if seen is not None:
            axes.add_patch(Rectangle((column + 0.27, row + 0.22), 0.46, 0.38,
                                     facecolor=tuple(seen[index]), edgecolor="none"))  # fmt: skip
        dark = float(measured[index] @ [0.2126, 0.7152, 0.0722]) < 0.5
        axes.text(column + 0.5, row + 0.9, chart.names[index], ha="center", va="bottom",
                  fontsize=5.5, color="white" if dark else INK)  # fmt: skip
    columns, rows = chart.positions.max(axis=0) + 1
    axes.set(xlim=(0, columns), ylim=(rows, 0), aspect=0.62 if columns < 10 else 0.75)
    axes.set_axis_off()


def _camera_colors(values: FloatArray, measured: FloatArray) -> FloatArray:
    linear = np.asarray(linearize(measured, "srgb_rec709_scene"), dtype=np.float64)
    matrix = np.linalg.lstsq(values, linear, rcond=None)[0]
    return np.asarray(encode_srgb(np.clip(values @ matrix, 0.0, 1.0)), dtype=np.float64)
