"""Where the patches of the known charts are, and what they are called.

Positions are shares of the rectangle that encloses the outermost patches: its corners, in the order
top left, top right, bottom right, bottom left, are what ``chart:corners`` holds. The frame around
the patches is left out, because its width differs from edition to edition::

      frame
      +-----------------------------+
      |  1--+  +--+  +--+  +--2     |     1  (0, 0)   2  (1, 0)
      |  |  |  |  |  |  |  |  |     |     4  (0, 1)   3  (1, 1)
      |  +--+  +--+  +--+  +--+     |
      |                             |     corners are the outer edges of the corner patches,
      |  +--+  +--+  +--+  +--+     |     seen as the makers show the chart: dark skin (A1) is
      |  |  |  |  |  |  |  |  |     |     top left
      |  4--+  +--+  +--+  +--3     |
      +-----------------------------+
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """The patches of a chart, in the order in which the makers number them."""

    name: str
    """``classic24`` or ``sg140``, as ``chart:layout`` holds it."""

    columns: int
    """Patches from left to right."""

    rows: int
    """Patches from top to bottom."""

    names: tuple[str, ...]
    """Shape [patch_count]."""

    positions: NDArray[np.int64]
    """Column and row of each patch, from 0 at the top left, shape [patch_count, 2]."""

    gap: float
    """Width of the gap between patches, as a share of a patch's side."""

    aliases: tuple[tuple[str, ...], ...]
    """Other names of each patch, shape [patch_count]."""

    @property
    def half_size(self) -> FloatArray:
        """Half the width and half the height of a patch [1], shape [2]."""
        return 0.5 / self._sides()

    @property
    def centers(self) -> FloatArray:
        """Middles of the patches, x to the right, y down [1], shape [patch_count, 2]."""
        return (0.5 + self.positions * (1.0 + self.gap)) / self._sides()

    def _sides(self) -> FloatArray:
        """Return the width and height of the rectangle in sides of a patch, shape [2]."""
        count = np.array([self.columns, self.rows], np.float64)
        return np.asarray(count + (count - 1.0) * self.gap)

    def index(self, name: str) -> int | None:
        """Return which patch a name or another spelling of it means; None: none."""
        return _spellings(self).get(_plain(name))


def _spellings(layout: Layout) -> dict[str, int]:
    found: dict[str, int] = {}
    for k, (name, others) in enumerate(zip(layout.names, layout.aliases, strict=True)):
        for spelling in (name, *others):
            found.setdefault(_plain(spelling), k)
    return found


def _plain(name: str) -> str:
    """Return a name without case, blanks and punctuation, ``A01`` as ``a1``."""
    letters = re.sub(r"[^a-z0-9]", "", name.lower())
    return re.sub(r"^([a-n]?)0+(?=[0-9])", r"\1", letters)


_CLASSIC_NAMES = (
    ("dark skin",),
    ("light skin",),
    ("blue sky",),
    ("foliage",),
    ("blue flower",),
    ("bluish green",),
    ("orange",),
    ("purplish blue", "purple blue"),
    ("moderate red",),
    ("purple",),
    ("yellow green",),
    ("orange yellow",),
    ("blue",),
    ("green",),
    ("red",),
    ("yellow",),
    ("magenta",),
    ("cyan",),
    ("white 9.5 (.05 D)", "white", "white 9.5"),
    ("neutral 8 (.23 D)", "neutral 8"),
    ("neutral 6.5 (.44 D)", "neutral 6.5"),
    ("neutral 5 (.70 D)", "neutral 5"),
    ("neutral 3.5 (1.05 D)", "neutral 3.5"),
    ("black 2 (1.5 D)", "black", "black 2"),
)
"""McCamy, Marcus and Davidson, "A color-rendition chart", J. Appl. Photogr. Eng. 2, 1976; spelled
as the data of colour-science are, whose first spelling is the chart's name of the patch."""


def _classic24() -> Layout:
    columns, rows = 6, 4
    place = [(column, row) for row in range(rows) for column in range(columns)]
    cells = [f"{'ABCD'[row]}{column + 1}" for column, row in place]
    others = [
        (*names[1:], cell, str(k + 1))
        for k, (names, cell) in enumerate(zip(_CLASSIC_NAMES, cells, strict=True))
    ]
    return Layout(
        name="classic24",
        columns=columns,
        rows=rows,
        names=tuple(names[0] for names in _CLASSIC_NAMES),
        positions=np.array(place),
        gap=0.1,  # of both charts, as OpenCV's mcc models them: sides of 2.5 every 2.75
        aliases=tuple(others),
    )


def _sg140() -> Layout:
    columns, rows = 14, 10
    place = [(column, row) for column in range(columns) for row in range(rows)]
    cells = tuple(f"{'ABCDEFGHIJKLMN'[column]}{row + 1}" for column, row in place)
    return Layout(
        name="sg140",
        columns=columns,
        rows=rows,
        names=cells,
        positions=np.array(place),
        gap=0.1,
        aliases=tuple((str(k + 1),) for k in range(len(cells))),
    )


LAYOUTS = {layout.name: layout for layout in (_classic24(), _sg140())}
"""The known layouts by name. Classic 24 is listed row by row, A1 .. A6, B1 ..; the Digital SG
column by column, A1 .. A10, B1 .., as their makers' data files are."""
