"""Figures: their style, their size, and the files they become.

Matplotlib's ``Figure`` is used without pyplot, which keeps figures and looks for a display. The
style is whole: a user's ``matplotlibrc`` changes nothing, so the same input gives the same bytes.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

from usdskin.errors import UsageError
from usdskin.images import replacing

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PAGE_WIDTH_IN = 7.6
"""Width of a figure [in]: a page's text at the size it is set in."""

MARGIN = 0.008
"""Left of headlines, as a share of the width."""

INK, FAINT, RULE = "#1a1a1a", "#767676", "#d5d5d5"
ESTIMATE = "#0072b2"
CHANNELS = ("#d55e00", "#009e73", "#0072b2")
"""Red, green and blue of a camera, told apart by the color blind (Okabe and Ito, "Color Universal
Design", 2008); line styles tell them apart in grey."""

CHANNEL_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (5, 1.4, 1, 1.4)))
CLASSES = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
CLASS_DASHES: tuple[Any, ...] = ("-", (0, (5, 1.6)), (0, (5, 1.4, 1, 1.4)), (0, (1, 1)))
DASHED: Any = (0, (3.2, 1.6))

_CLIP_PATH = re.compile(r'<clipPath id="(p[0-9a-f]{10})"')

_METADATA: dict[str, dict[str, None]] = {
    "svg": {"Date": None, "Creator": None},
    "pdf": {"CreationDate": None, "Creator": None, "Producer": None},
    "png": {"Software": None},
}
_STYLE: dict[str, Any] = {
    "font.family": ["DejaVu Sans"],  # the one that comes with matplotlib
    "font.size": 7.5,
    "axes.titlesize": 8.0,
    "axes.titlelocation": "left",
    "axes.titleweight": "bold",
    "axes.labelsize": 7.5,
    "axes.labelcolor": INK,
    "axes.edgecolor": FAINT,
    "axes.linewidth": 0.6,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.axisbelow": True,
    "axes.formatter.useoffset": False,
    "grid.color": RULE,
    "grid.linewidth": 0.5,
    "lines.linewidth": 1.1,
    "lines.dash_capstyle": "butt",
    "legend.facecolor": "white",
    "legend.edgecolor": "none",
    "legend.framealpha": 0.8,
    "legend.fancybox": False,
    "legend.borderpad": 0.2,
    "legend.fontsize": 7.0,
    "legend.handlelength": 2.4,
    "patch.linewidth": 0.5,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "xtick.major.size": 2.5,
    "ytick.major.size": 2.5,
    "figure.dpi": 100.0,
    "figure.facecolor": "white",
    "figure.titlesize": 9.0,
    "figure.titleweight": "bold",
    "savefig.dpi": 180.0,
    "savefig.facecolor": "white",
    "pdf.fonttype": 42,
    "svg.fonttype": "path",  # looks the same wherever it is opened
    "svg.hashsalt": "usdskin",
}


@contextmanager
def styled() -> Iterator[None]:
    """Draw in our style, and leave matplotlib's settings as they were.

    Raises:
        UsageError: matplotlib is not installed.
    """
    try:
        import matplotlib
    except ImportError:
        raise UsageError("plots need matplotlib; pip install 'usdskin[plot]'") from None
    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        settings: Any = matplotlib.rcParams
        settings.update(_STYLE)
        yield


def new_figure(height_in: float, width_in: float = PAGE_WIDTH_IN) -> Figure:
    """Return an empty figure; call it, and draw, inside ``styled``.

    Args:
        height_in: Height [in].
        width_in: Width [in].
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width_in, height_in), layout="constrained")
    engine: Any = figure.get_layout_engine()
    engine.set(w_pad=0.05, h_pad=0.05, wspace=0.02, hspace=0.02)
    FigureCanvasAgg(figure)
    return figure


def figure_format(path: Path) -> str:
    """Return the kind of picture a file name asks for: ``svg``, ``png`` or ``pdf``.

    Raises:
        UsageError: It asks for another.
    """
    suffix = path.suffix.lower().lstrip(".")
    if suffix not in _METADATA:
        raise UsageError(f"{path}: figures are written as .svg, .png or .pdf; name it so")
    return suffix


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure; the same figure gives the same bytes.

    Args:
        figure: What to write.
        path: File to write, ``.svg``, ``.png`` or ``.pdf``.

    Returns:
        ``path``, once it is complete on disk.

    Raises:
        UsageError: Another kind of file, or matplotlib is not installed.
        ImageError: The file cannot be written; nothing is left behind.
    """
    suffix = figure_format(path)
    with styled(), replacing(path) as temporary:
        figure.savefig(temporary, format=suffix, metadata=dict(_METADATA[suffix]))
        if suffix == "svg":
            _number_clip_paths(Path(temporary))
    return path


def _number_clip_paths(path: Path) -> None:
    """Count the clip paths of an SVG instead of naming them by their last bits, which vary."""
    text = path.read_text("utf-8")
    names = {name: f"clip{k}" for k, name in enumerate(_CLIP_PATH.findall(text))}
    path.write_text(re.sub(r"\bp[0-9a-f]{10}\b", lambda m: names.get(m[0], m[0]), text), "utf-8")


def print_below_top(part: Any, left: float, down_in: float, text: str, **settings: Any) -> None:
    """Write text whose baseline is some way below the upper edge of a part of a figure.

    Args:
        part: Matplotlib's ``SubFigure``.
        left: Where it begins, as a share of the width.
        down_in: How far below the edge its first baseline is [in].
        text: What to write.
        settings: Of matplotlib's ``Text``.
    """
    from matplotlib.transforms import ScaledTranslation

    place = part.transSubfigure + ScaledTranslation(0.0, -down_in, part.figure.dpi_scale_trans)
    part.text(left, 1.0, text, transform=place, in_layout=False, **{"va": "baseline", **settings})


def section_title(part: Any, text: str, note: str = "") -> None:
    """Write a headline over a part of a figure, and a note in small print after it.

    Args:
        part: Matplotlib's ``SubFigure``.
        text: Headline.
        note: What is to be said about the part in a few words.
    """
    part.suptitle(" ", fontsize=8.5)  # keeps the line free
    print_below_top(part, MARGIN, 0.16, text, fontsize=8.5, fontweight="bold")
    print_below_top(part, 0.025 + 0.0092 * len(text), 0.16, note, fontsize=6.8, color=FAINT)


def name_axes(axes: Any, x_label: str, y_label: str) -> None:
    """Name the axes of a panel and lay a grid under it."""
    axes.set(xlabel=x_label, ylabel=y_label)
    axes.grid(True)


def legend_inside(axes: Any, **settings: Any) -> None:
    """Draw a small legend inside a panel; one line at the top where ``settings`` say no more."""
    axes.legend(**{"loc": "upper center", "ncols": 4, "columnspacing": 0.9, "handlelength": 1.9,
                   "fontsize": 6.0, "handletextpad": 0.4, "borderaxespad": 0.2,
                   "labelspacing": 0.3, **settings})  # fmt: skip


def halo() -> list[Any]:
    """Return the effect that keeps small print legible over lines."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=1.6, foreground="white")]
