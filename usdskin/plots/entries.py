"""Names and their values, in columns of small print."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from usdskin.plots.figures import FAINT, MARGIN, print_below_top

_COLUMNS = 3
_COLUMN = 0.335
_LINE_IN = 0.15
_MOST_DECIMALS = 6


def entries_height(count: int) -> float:
    """Return the height that a number of entries take, with a headline above [in]."""
    return 0.42 + _LINE_IN * _rows(count)


def draw_entries(part: Any, entries: Sequence[tuple[str, str]]) -> None:
    """Write names and values below a part's headline, in three columns.

    Args:
        part: Matplotlib's ``SubFigure``.
        entries: Name and value of each.
    """
    rows = _rows(len(entries))
    for index, (name, value) in enumerate(entries):
        column, row = divmod(index, rows)
        down = 0.34 + _LINE_IN * row
        left = MARGIN + _COLUMN * column
        print_below_top(part, left, down, name, fontsize=7.0, color=FAINT)
        print_below_top(part, left + 0.317, down, value, fontsize=7.0, ha="right")


def with_error(value: float, deviation: float | None, unit: str = "") -> str:
    """Return a value and its standard deviation, to two digits of the latter.

    Args:
        value: What was found.
        deviation: Its standard deviation, or None where it is not known.
        unit: What stands after both.
    """
    if deviation is None or not np.isfinite(deviation) or deviation <= 0.0:
        return f"{value:.4g} {unit}".strip()
    decimals = int(np.clip(1 - np.floor(np.log10(deviation)), 0, _MOST_DECIMALS))
    return f"{value:.{decimals}f} ± {deviation:.{decimals}f} {unit}".strip()


def _rows(count: int) -> int:
    return -(-count // _COLUMNS)
