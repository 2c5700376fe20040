"""What is written in a figure, and whether it stays on the page."""

from __future__ import annotations

from typing import Any

import matplotlib.text


def texts(figure: Any) -> list[str]:
    """Return everything that is written in a figure."""
    return [text.get_text() for text in figure.findobj(matplotlib.text.Text)]


def texts_outside(figure: Any) -> list[str]:
    """Return the texts that reach beyond the page."""
    figure.draw_without_rendering()
    page, renderer = figure.bbox, figure.canvas.get_renderer()
    hidden = {
        tick.label1
        for axes in figure.axes
        for axis in (axes.xaxis, axes.yaxis)
        for tick in axis.get_major_ticks()
        if not min(axis.get_view_interval()) <= tick.get_loc() <= max(axis.get_view_interval())
    }
    found = []
    for text in figure.findobj(matplotlib.text.Text):
        if text.get_visible() and text.get_text().strip() and text not in hidden:
            box = text.get_window_extent(renderer)
            if box.x0 < -1 or box.y0 < -1 or box.x1 > page.x1 + 1 or box.y1 > page.y1 + 1:
                found.append(text.get_text())
    return found
