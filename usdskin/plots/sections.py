"""Parts of a page: which are asked for, and how they share its height."""

from __future__ import annotations

import textwrap
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from usdskin.errors import UsageError
from usdskin.plots.figures import MARGIN, RULE, new_figure, print_below_top

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_TITLE_IN = 0.46
_LINE_IN = 0.13
_TITLE_CHARACTERS, _LINE_CHARACTERS = 60, 125


@dataclass(frozen=True, slots=True)
class Section:
    """One band of a page, as wide as the page."""

    height_in: float
    """Height [in]."""

    draw: Callable[[Any], None]
    """Fills a matplotlib ``SubFigure``."""


def chosen_parts(what: Sequence[str], parts: Sequence[str], kind: str) -> tuple[str, ...]:
    """Return the parts of a figure that were asked for, in their own order; all where none was.

    Args:
        what: Names of parts.
        parts: Those that the figure has.
        kind: What the figure is of, for the error.

    Raises:
        UsageError: A part that this kind of figure lacks.
    """
    for name in what:
        if name not in parts:
            raise UsageError(f"--what {name}: the figure of {kind} shows {', '.join(parts)}")
    return tuple(name for name in parts if not what or name in what)


def draw_heading(part: Any, title: str, lines: Sequence[str]) -> None:
    """Write the headline of a group of sections, a rule above it and lines of small print below.

    Args:
        part: Matplotlib's ``SubFigure`` to fill.
        title: Headline.
        lines: What is said about it.
    """
    part.add_artist(_rule())
    print_below_top(part, MARGIN, 0.18, title, fontsize=8.5, fontweight="bold")
    for index, line in enumerate(lines):
        print_below_top(part, MARGIN, 0.34 + _LINE_IN * index, line, fontsize=6.8)


def _rule() -> Any:
    from matplotlib.lines import Line2D

    return Line2D([MARGIN, 1.0 - MARGIN], [0.99, 0.99], color=RULE, linewidth=0.8)


def page(title: str, subtitle: str, sections: Sequence[Section]) -> Figure:
    """Return a figure with sections one above the other; call it inside ``styled``.

    Args:
        title: Headline.
        subtitle: What it is of, in small print.
        sections: From the top down, at least one.
    """
    lines = textwrap.wrap(subtitle, _LINE_CHARACTERS) or [""]
    heights = [section.height_in for section in sections]
    heights.insert(0, _TITLE_IN + _LINE_IN * (len(lines) - 1))
    figure: Any = new_figure(sum(heights))
    head, *parts = figure.subfigures(len(heights), 1, height_ratios=heights)
    size = 10.5 * min(1.0, _TITLE_CHARACTERS / len(title))
    print_below_top(head, MARGIN, 0.20, title, fontsize=size, fontweight="bold")
    for index, line in enumerate(lines):
        print_below_top(head, MARGIN, 0.37 + _LINE_IN * index, line, fontsize=6.8)
    for section, part in zip(sections, parts, strict=True):
        section.draw(part)
    drawn: Figure = figure
    return drawn
