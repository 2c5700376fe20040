"""A fit over the angle of the light: readings, the fitted curve, and what is left."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.plots.figures import CHANNELS, DASHED, ESTIMATE, FAINT, INK, section_title

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

FIT_HEIGHT_IN = 4.4
"""Height of the panels with their headline [in]."""

_MOST_COLUMNS = 4
_LEFT_OUT = CHANNELS[0]
_LEAST_DEVIATIONS, _MOST_DEVIATIONS = 3.0, 6.0
_CURVE_STEPS = 361
_MARGIN_DEG = 4.0
_TAIL_FROM_DEG, _TAIL_TO_DEG, _TAIL_BEYOND_DEG = 82.0, 100.0, 12.0
_MANY = 400
_LARGEST_VARIANCE = 1e12


@dataclass(frozen=True, slots=True, eq=False)
class DrawnFit:
    """Readings of skin and the model fitted to them, per channel or band."""

    names: tuple[str, ...]
    """What the columns are called, shape [c]."""

    theta_deg: FloatArray
    """Angles between normal and light [deg], shape [q]."""

    values: FloatArray
    """Readings over that of a perfect diffuser which faces the light [1], shape [q, c]."""

    predicted: FloatArray
    """The model at every reading, with lustre and attenuation [1], shape [q, c]."""

    sigma: FloatArray
    """Standard deviations of the readings [1], shape [q, c]."""

    used: Mask
    """Which readings the fit is from, shape [q]."""

    wrap: float
    """l [1]."""

    lambert: FloatArray
    """A [1], shape [c]."""

    wrapped: FloatArray
    """B [1], shape [c]."""

    covariance: FloatArray | None
    """Of l, A and B in this order, shape [1 + 2c, 1 + 2c]; None: not known."""

    beyond: str = ""
    """What the model has beside A and B, in a word or two; empty: nothing."""


def shown_columns(count: int) -> list[int]:
    """Return the columns to show: all, or the middles of four equal ranges of many bands."""
    if count <= _MOST_COLUMNS:
        return list(range(count))
    middles = (np.arange(_MOST_COLUMNS) + 0.5) / _MOST_COLUMNS
    return [round(middle * (count - 1)) for middle in middles]


def fitted_curve(
    fit: DrawnFit, column: int, theta_deg: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Return the fitted body of one column, and its standard deviation where it is known.

    ``A max(cos, 0) + B max((cos + l)/(1 + l), 0)``; errors go through its first derivatives.

    Args:
        fit: The fit.
        column: Which channel or band.
        theta_deg: Angles of the light [deg], shape [k].

    Returns:
        Reflectance factors [1], shape [k], and standard deviations, shape [k], or None.
    """
    cosine, wrap = np.cos(np.radians(theta_deg)), fit.wrap
    direct = np.maximum(cosine, 0.0)
    wrapped = np.maximum((cosine + wrap) / (1.0 + wrap), 0.0)
    a, b = float(fit.lambert[column]), float(fit.wrapped[column])
    curve = np.asarray(a * direct + b * wrapped)
    if fit.covariance is None:
        return curve, None
    rows = [0, 1 + column, 1 + len(fit.lambert) + column]
    block = fit.covariance[np.ix_(rows, rows)]
    if not (np.isfinite(block).all() and block.diagonal().max() < _LARGEST_VARIANCE):
        return curve, None
    by_wrap = np.where(wrapped > 0.0, b * (1.0 - cosine) / (1.0 + wrap) ** 2, 0.0)
    slopes = np.stack([by_wrap, direct, wrapped], axis=-1)
    variance = np.einsum("ki,ij,kj->k", slopes, block, slopes)
    return curve, np.sqrt(np.maximum(variance, 0.0))


def draw_fit(part: Any, fit: DrawnFit) -> None:
    """Draw readings with the fitted curve over the angle of the light, and what is left of them.

    Below, the ends of the curves are shown enlarged: they tell l from Ss.

    Args:
        part: Matplotlib's ``SubFigure`` to fill.
        fit: What to draw; a few of many bands are shown.
    """
    chosen = shown_columns(len(fit.names))
    section_title(part, "Fit", "σ is sized by the residuals")
    grid = part.subplots(3, len(chosen), squeeze=False, height_ratios=[2.2, 1.0, 1.4])
    end, deviations = _reach(fit), _deviations(fit, chosen)
    for place, column in enumerate(chosen):
        top, middle, bottom = grid[:, place]
        _draw_readings(top, fit, column, end)
        _draw_residuals(middle, fit, column, deviations)
        _draw_tail(bottom, fit, column, end)
        for axes in (top, middle, bottom):
            _mark_angles(axes, fit)
            axes.grid(True)
        for axes in (top, middle):
            axes.set_xlim(-_MARGIN_DEG, end)
            axes.set_xticks(np.arange(0.0, end, 30.0))
        top.tick_params(labelbottom=False)
        middle.tick_params(labelleft=place == 0)
    labels = ("over white facing\nthe light [1]", "residual [σ]", "near the\nshadow line")
    for axes, label in zip(grid[:, 0], labels, strict=True):
        axes.set_ylabel(label)
    part.align_ylabels(grid[:, 0])
    part.supxlabel("angle between normal and light [deg]", fontsize=7.5)
    _draw_legend(part, grid[0, 0])


def _draw_legend(part: Any, axes: Any) -> None:
    handles, names = axes.get_legend_handles_labels()
    legend = part.legend(handles, names, loc="upper right", ncols=len(names), borderaxespad=0.2,
                         fontsize=6.5, columnspacing=1.0, handlelength=1.8,
                         handletextpad=0.5)  # fmt: skip
    for handle in legend.legend_handles:
        if handle.get_label() == "reading" and handle.get_marker() == ".":
            handle.set(markersize=5.0, alpha=1.0)


def _reach(fit: DrawnFit) -> float:
    """Return the largest angle to show [deg]."""
    ends = (float(fit.theta_deg.max()), _dark_deg(fit), 95.0)
    return min(max(ends) + 5.0, 180.0)


def _draw_readings(axes: Any, fit: DrawnFit, column: int, end: float) -> None:
    values, used = fit.values[:, column], fit.used
    curve = _draw_curve(axes, fit, column, (0.0, end))
    kept = values[used] if used.any() else values
    high = 1.1 * max(float(curve.max()), float(kept.max()))
    low = 1.1 * min(-0.02 * high, float(kept.min()))
    if fit.beyond:
        axes.plot(fit.theta_deg, fit.predicted[:, column], "_", color=ESTIMATE, markersize=5.0,
                  markeredgewidth=0.9, label=f"with {fit.beyond}")  # fmt: skip
    _draw_points(axes, fit, np.ones(len(values), bool), values, (low, high))
    axes.set_ylim(low, high)
    axes.locator_params(axis="y", nbins=5)
    axes.set_title(fit.names[column], fontsize=7.0, pad=12.0)
    caption = f"A {fit.lambert[column]:.3f}, B {fit.wrapped[column]:.3f}"
    left = (values - fit.predicted[:, column])[used]
    if left.size:
        share = 100.0 * float(np.sqrt((left**2).mean())) / max(float(np.abs(kept).max()), 1e-12)
        caption += f", rms {share:.2g} %"
    axes.text(0.0, 1.035, caption, transform=axes.transAxes, fontsize=6.0, color=FAINT,
              in_layout=False)  # fmt: skip


def _draw_tail(axes: Any, fit: DrawnFit, column: int, end: float) -> None:
    """Draw what lies around the shadow line, enlarged."""
    range_deg = (_TAIL_FROM_DEG, max(min(_dark_deg(fit) + _TAIL_BEYOND_DEG, end), _TAIL_TO_DEG))
    curve = _draw_curve(axes, fit, column, range_deg)
    limits = (-0.14 * float(curve.max()), 1.1 * float(curve.max()))
    near = (fit.theta_deg >= range_deg[0]) & (fit.theta_deg <= range_deg[1])
    _draw_points(axes, fit, near, fit.values[:, column], limits)
    axes.set(xlim=range_deg, ylim=limits)
    axes.set_xticks(np.arange(90.0, range_deg[1], 10.0 if range_deg[1] < 125.0 else 20.0))
    axes.locator_params(axis="y", nbins=4)


def _draw_curve(
    axes: Any, fit: DrawnFit, column: int, range_deg: tuple[float, float]
) -> FloatArray:
    """Draw the fitted body and its error; return the body."""
    bends_deg = np.clip([90.0, _dark_deg(fit)], *range_deg)
    theta_deg = np.union1d(np.linspace(*range_deg, _CURVE_STEPS), bends_deg)
    curve, deviation = fitted_curve(fit, column, theta_deg)
    if deviation is not None:
        axes.fill_between(theta_deg, curve - 2.0 * deviation, curve + 2.0 * deviation,
                          facecolor=ESTIMATE, alpha=0.22, linewidth=0.0, label="± 2 σ")  # fmt: skip
    axes.plot(theta_deg, curve, color=ESTIMATE, zorder=3,
              label="fitted body" if fit.beyond else "fitted")  # fmt: skip
    return curve


def _deviations(fit: DrawnFit, columns: list[int]) -> float:
    """Return how many standard deviations the axis of residuals reaches to either side."""
    kept = ((fit.values - fit.predicted) / fit.sigma)[fit.used][:, columns]
    largest = float(np.abs(kept).max()) if kept.size else 0.0
    return float(np.clip(1.15 * largest, _LEAST_DEVIATIONS, _MOST_DEVIATIONS))


def _draw_residuals(axes: Any, fit: DrawnFit, column: int, high: float) -> None:
    scaled = ((fit.values - fit.predicted) / fit.sigma)[:, column]
    for level in (-2.0, 0.0, 2.0):
        axes.axhline(
            level, color=INK, linewidth=0.6, linestyle="-" if level == 0.0 else (0, (2, 2))
        )
    _draw_points(axes, fit, np.ones(len(scaled), bool), scaled, (-high, high))
    axes.set_ylim(-high, high)
    axes.set_yticks([-4, -2, 0, 2, 4] if high >= 4.0 else [-2, 0, 2])


def _draw_points(
    axes: Any, fit: DrawnFit, among: Mask, values: FloatArray, limits: tuple[float, float]
) -> None:
    """Draw readings as rings and those left out as crosses; what lies beyond is at the edge."""
    low, high = limits
    size = 3.2 if len(values) <= 80 else 2.2
    dots: dict[bool, dict[str, Any]] = {
        True: {"marker": "o", "markersize": size, "markerfacecolor": "none"},
        False: {"marker": "x", "markersize": size},
    }
    if len(values) > _MANY:
        dots[True] = {"marker": ".", "markersize": 1.8, "markeredgecolor": "none", "alpha": 0.4}
    edge = 0.04 * (high - low)
    shown = np.clip(values, low + edge, high - edge)
    inside = (values >= low) & (values <= high)
    for kept, color, label in ((True, INK, "reading"), (False, _LEFT_OUT, "left out")):
        rows = among & (fit.used == kept)
        here = rows & inside
        if rows.any():
            drawn = axes.plot(fit.theta_deg[here], values[here], color=color, linestyle="none",
                              markeredgewidth=0.6, label=label, zorder=2.5, clip_on=False,
                              **dots[kept])  # fmt: skip
            drawn[0].set_in_layout(False)  # unclipped and empty it would claim the whole page
        for marker, beyond in (("^", rows & (values > high)), ("v", rows & (values < low))):
            if beyond.any():
                axes.plot(fit.theta_deg[beyond], shown[beyond], marker, color=color, markersize=3.0,
                          markeredgewidth=0.0, linestyle="none", zorder=2.5)  # fmt: skip


def _mark_angles(axes: Any, fit: DrawnFit) -> None:
    """Mark where a matt surface turns dark, and where this one does."""
    dark_deg = _dark_deg(fit)
    axes.axvline(90.0, color=FAINT, linewidth=0.8, label="90°", zorder=1.5)
    axes.axvline(dark_deg, color=FAINT, linewidth=0.9, linestyle=DASHED, zorder=1.5,
                 label=f"acos(-l) {dark_deg:.1f}°")  # fmt: skip


def _dark_deg(fit: DrawnFit) -> float:
    """Return the angle beyond which no light is scattered through, acos(-l) [deg]."""
    return float(np.degrees(np.arccos(-fit.wrap)))
