"""Other orders in which a chart's patches are listed by mistake."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.chart.layouts import Layout

IndexArray = NDArray[np.int64]


def listed_otherwise(count: int) -> Iterator[tuple[str, IndexArray]]:
    """Yield mistakes in a list of patches, in words, and the order that would mend them.

    Args:
        count: Number of patches.

    Yields:
        What the camera values look like, and which of them belongs to each spectrum, shape [count].
    """
    index = np.arange(count)
    yield "listed from the last to the first", index[::-1].copy()
    yield "shifted by one patch towards the end of the list", np.roll(index, -1)
    yield "shifted by one patch towards the start of the list", np.roll(index, 1)


def laid_out_otherwise(layout: Layout) -> Iterator[tuple[str, IndexArray]]:
    """Yield mistakes in how a chart was turned or read, as ``listed_otherwise`` does.

    Args:
        layout: The chart; orders are those of all its patches.
    """
    column, row = layout.positions.T
    grid = np.empty((layout.rows, layout.columns), np.int64)
    grid[row, column] = np.arange(len(column))
    by_columns = _lists_columns(layout)

    def listed(turned: IndexArray, as_columns: bool) -> IndexArray:
        return (turned.T if as_columns else turned).ravel().copy()

    yield "rotated by 180 degrees", listed(grid[::-1, ::-1], by_columns)
    yield "mirrored left to right", listed(grid[:, ::-1], by_columns)
    yield "mirrored top to bottom", listed(grid[::-1], by_columns)
    right, wrong = ("column", "row") if by_columns else ("row", "column")
    other = listed(grid, not by_columns)
    # Camera values in the wrong order are mended by its inverse, spectra by the order itself.
    say = f"listed {wrong} by {wrong} where the spectra are listed {right} by {right}"
    yield say, _inverse(other)
    say = f"listed {right} by {right} where the spectra are listed {wrong} by {wrong}"
    yield say, other
    for say, turned in (("left", np.rot90(grid)), ("right", np.rot90(grid, -1))):
        yield (
            f"listed from a chart turned to the {say} by 90 degrees",
            _inverse(listed(turned, by_columns)),
        )


def _lists_columns(layout: Layout) -> bool:
    """Return whether the second patch is below the first, not to its right."""
    return bool(layout.positions[1, 1] > layout.positions[0, 1])


def _inverse(order: IndexArray) -> IndexArray:
    inverse = np.empty_like(order)
    inverse[order] = np.arange(len(order))
    return inverse
