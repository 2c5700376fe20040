"""What a recovery does to each patch that is left out: bars of dE2000, GFC and RMSE."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.plots.figures import FAINT, INK, section_title

FloatArray = NDArray[np.float64]

_MOST_NAMED = 48
_WORST_NAMED = 4
_SMALLEST_LOSS = 1e-6


def draw_errors(
    part: Any,
    names: Sequence[str],
    errors: tuple[FloatArray, FloatArray, FloatArray],
    colors: FloatArray,
) -> None:
    """Draw the leave-one-out errors of every patch, with their mean and 95th percentile.

    Args:
        part: Matplotlib's ``SubFigure`` to fill.
        names: Patches in the chart's order.
        errors: dE2000, goodness of fit, and RMSE over the light's peak, shape [count] each.
        colors: What the patches look like, sRGB, shape [count, 3].
    """
    delta_e, fit, rmse = errors
    note = "each patch estimated from the others; solid line: mean, dashed: 95th percentile"
    section_title(part, "Leave-one-out errors", note)
    top, middle, bottom = part.subplots(3, 1, sharex=True)
    _draw_bars(top, delta_e, colors, "ΔE$_{00}$ [1]")
    _draw_losses(middle, np.maximum(1.0 - fit, _SMALLEST_LOSS), colors)
    _draw_bars(bottom, 100.0 * rmse, colors, "RMSE\n[% of peak]")
    order = np.arange(len(names))
    bottom.set_xlim(-0.7, len(names) - 0.3)
    if len(names) <= _MOST_NAMED:
        size = 6.5 if len(names) <= 30 else 5.0
        bottom.set_xticks(order, names, rotation=90, fontsize=size)
    else:
        shown = order[:: -(-len(names) // 35)]
        bottom.set_xticks(shown, [names[index] for index in shown], rotation=90, fontsize=6.0)
        for index in np.argsort(-delta_e, kind="stable")[:_WORST_NAMED]:
            top.annotate(names[index], (index, delta_e[index]), (0, 1.5), ha="center",
                         textcoords="offset points", fontsize=5.5)  # fmt: skip
    for axes in (top, middle, bottom):
        axes.tick_params(axis="x", length=0)


def _draw_bars(axes: Any, values: FloatArray, colors: FloatArray, label: str) -> None:
    width = 0.8 if len(values) <= _MOST_NAMED else 1.0
    line = 0.5 if len(values) <= _MOST_NAMED else 0.3
    axes.bar(np.arange(len(values)), values, width, color=colors, edgecolor=INK, linewidth=line)
    axes.set_ylim(0.0, 1.14 * max(float(values.max()), 1e-9))
    _finish(axes, values, label, f"mean {values.mean():.2f}, p95 {np.percentile(values, 95.0):.2f}")


def _draw_losses(axes: Any, losses: FloatArray, colors: FloatArray) -> None:
    """Draw 1 - GFC, which is what differs, on a logarithmic axis."""
    from matplotlib.ticker import NullFormatter

    width = 0.8 if len(losses) <= _MOST_NAMED else 1.0
    line = 0.5 if len(losses) <= _MOST_NAMED else 0.3
    floor = 10.0 ** np.floor(np.log10(losses.min()) - 0.05)
    axes.bar(np.arange(len(losses)), losses - floor, width, bottom=floor, color=colors,
             edgecolor=INK, linewidth=line)  # fmt: skip
    axes.set_yscale("log")
    axes.set_ylim(floor, 10.0 ** np.ceil(np.log10(losses.max())))
    axes.yaxis.set_minor_formatter(NullFormatter())
    mean, tail = losses.mean(), np.percentile(losses, 95.0)
    _finish(axes, losses, "1 - GFC [1]", f"mean {mean:.2g}, p95 {tail:.2g}")


def errors_height(names: Sequence[str]) -> float:
    """Return the height that the bars take, with the patches' names below them [in]."""
    longest = max(len(name) for name in names) if len(names) <= _MOST_NAMED else 3
    return 2.95 + 0.058 * longest


def _finish(axes: Any, values: FloatArray, label: str, figures: str) -> None:
    axes.axhline(values.mean(), color=INK, linewidth=0.7)
    axes.axhline(np.percentile(values, 95.0), color=INK, linewidth=0.7, linestyle=(0, (2, 2)))
    axes.set_ylabel(label)
    axes.grid(True, axis="y")
    axes.text(1.0, 1.0, figures, transform=axes.transAxes, ha="right", va="bottom", fontsize=6.0,
              color=FAINT)  # fmt: skip
