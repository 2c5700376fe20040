"""The figure of a proof's error budget: what each fault costs on skin."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from usdskin.plots.figures import CLASSES, FAINT, INK, RULE, new_figure, save_figure, styled

_ROW_IN = 0.19
_LEAST = 0.01
"""Left end of the axis, dE2000: what is less is drawn there."""

_NOTICED = 1.0
"""About the least difference that is noticed, dE2000."""


def draw_budget(rows: Sequence[Mapping[str, Any]], path: Path) -> Path:
    """Draw a budget: a row for each fault, its mean and its 95th percentile.

    Args:
        rows: ``budget`` of ``proof.json``: cause, setting, deltaE2000.
        path: Figure to write, ``.svg``, ``.png`` or ``.pdf``.

    Returns:
        ``path``, once it is complete on disk.

    Raises:
        UsageError: matplotlib is not installed, or another kind of file.
    """
    causes = list(dict.fromkeys(str(row["cause"]) for row in rows))
    with styled():
        figure = new_figure(0.9 + _ROW_IN * len(rows))
        axes: Any = figure.subplots()
        for index, row in enumerate(rows):
            found = row["deltaE2000"]
            mean, p95 = (max(float(found[name]), _LEAST) for name in ("mean", "p95"))
            color = CLASSES[causes.index(str(row["cause"])) % len(CLASSES)]
            axes.plot([_LEAST, mean], [index, index], color=color, linewidth=4.0, zorder=2)
            axes.plot([mean, p95], [index, index], color=color, linewidth=1.0, zorder=2)
            axes.plot([p95], [index], "|", color=color, markersize=7.0, zorder=3)
            axes.text(p95 * 1.12, index, f"{found['mean']:.2f}", va="center", color=INK)
        axes.axvline(_NOTICED, color=FAINT, linewidth=0.8, linestyle=(0, (3, 2)), zorder=1)
        axes.set_xscale("log")
        largest = max((float(row["deltaE2000"]["p95"]) for row in rows), default=1.0)
        axes.set_xlim(_LEAST, max(2.0, 2.0 * largest))
        axes.set_yticks(range(len(rows)), [f"{row['cause']}, {row['setting']}" for row in rows])
        axes.set_ylim(len(rows) - 0.4, -0.6)
        axes.tick_params(axis="y", length=0)
        axes.grid(axis="x", color=RULE)
        axes.set_xlabel("ΔE$_{00}$ on skin: bar mean, line to the 95th percentile")
        axes.set_title("What each fault costs by itself")
        return save_figure(figure, path)
