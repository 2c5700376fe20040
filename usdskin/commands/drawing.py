"""``--plot``: draw what a step has written, having made sure before it that this will work."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from usdskin.commands.reporter import Reporter

if TYPE_CHECKING:
    from usdskin.notes import Note


def check_plot(plot: Path | None, layer: Path, inputs: Iterable[Path | None]) -> None:
    """Refuse a figure that could not be drawn in the end, or that would destroy a file.

    Args:
        plot: Figure that is asked for, if any.
        layer: Layer that the step is going to write.
        inputs: Files it reads.

    Raises:
        UsageError: The name is no figure's, matplotlib is not installed, or it is one of the files.
        UsdSkinError: The folder cannot be made or written to.
    """
    if plot is not None:
        from usdskin.plots.step import check_figure

        check_figure(plot, layer, inputs)


def draw_plot(reporter: Reporter, plot: Path | None, layer: Path) -> None:
    """Draw a layer, if a figure is asked for, and tell what could not be drawn."""
    if plot is not None:
        from usdskin.plots.step import plot_file

        notes: list[Note] = []
        written = plot_file(layer, plot, notes=notes)
        reporter.notes(notes)
        reporter.wrote([written])
