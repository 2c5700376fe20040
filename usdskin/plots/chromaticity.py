"""The CIE 1976 u', v' diagram: where the points are, enlarged, and the whole of it beside."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.plots.appearance import planckian_chromaticity, spectral_locus
from usdskin.plots.figures import ESTIMATE, FAINT, INK, RULE, halo

FloatArray = NDArray[np.float64]

_LABELLED_NM = (450, 470, 480, 490, 500, 520, 540, 560, 580, 600, 620, 650)
_LABELLED_K = (2000, 2700, 4000, 6500, 15000)
_SMALLEST_SPAN = 0.05
_PADDING = 0.10
_INSET = 0.26
_EDGE = 0.015
_CORNERS = ((0, 1), (1, 0), (0, 0), (1, 1))
_MANY = 50
_LOWEST, _HIGHEST = -0.05, 0.70


def draw_diagram(axes: Any, points: FloatArray) -> str:
    """Draw the frame that chromaticities stand in.

    Args:
        axes: Matplotlib's axes, made square here.
        points: u', v' of everything that has to be in sight, shape [count, 2].

    Returns:
        The corner that has most room for a legend, such as ``upper left``.
    """
    # What no light can have is drawn where it is, but not waited for.
    known = points[((points > _LOWEST) & (points < _HIGHEST)).all(axis=-1)]
    low, span = _square(known)
    axes.set(xlim=(low[0], low[0] + span), ylim=(low[1], low[1] + span))
    axes.set_box_aspect(1.0)
    axes.set(xlabel="u'", ylabel="v'")
    axes.spines[["top", "right"]].set_visible(True)
    axes.locator_params(nbins=5)
    _draw_locus(axes, low, span)
    _draw_planckian(axes, low, span, known)
    first, second = _emptiest_corners((known - low) / span)
    if span < 0.5 and second is not None:
        _draw_inset(axes, (low, span), second)
    return " ".join((("lower", "upper")[first[1]], ("left", "right")[first[0]]))


def draw_pairs(axes: Any, measured: FloatArray, estimated: FloatArray) -> None:
    """Draw measured chromaticities as rings and estimated ones as dots at the end of a line.

    Args:
        axes: Matplotlib's axes.
        measured: u', v', shape [count, 2].
        estimated: u', v', shape [count, 2].
    """
    size = 1.0 if len(measured) <= _MANY else 0.6
    for start, end in zip(measured, estimated, strict=True):
        axes.plot(*zip(start, end, strict=True), color=ESTIMATE, linewidth=0.8, zorder=3)
    axes.plot(*measured.T, "o", markersize=5.2 * size, markerfacecolor="none", markeredgecolor=INK,
              markeredgewidth=0.7, zorder=4, label="measured")  # fmt: skip
    axes.plot(*estimated.T, "o", color=ESTIMATE, markersize=2.3 * size, zorder=5, label="estimated")


def _square(points: FloatArray) -> tuple[FloatArray, float]:
    """Return the lower left corner and the side of a square around points."""
    if not len(points):
        return np.array([0.0, 0.0]), 0.65
    low, high = points.min(axis=0), points.max(axis=0)
    span = max(float((high - low).max()), _SMALLEST_SPAN) * (1.0 + 2.0 * _PADDING)
    return 0.5 * (low + high) - 0.5 * span, span


def _inside(points: FloatArray, low: FloatArray, span: float, margin: float) -> NDArray[np.bool_]:
    place = (points - low) / span
    return np.asarray(((place > margin) & (place < 1.0 - margin)).all(axis=-1))


def _draw_locus(axes: Any, low: FloatArray, span: float) -> None:
    """Draw the spectral locus with the line of purples, and wavelengths that are in sight."""
    wavelength_nm, locus = spectral_locus()
    axes.plot(*np.vstack([locus, locus[:1]]).T, color=FAINT, linewidth=0.8, zorder=1)
    labelled = np.isin(wavelength_nm, _LABELLED_NM)
    middle = np.array([0.21, 0.42])
    for nm, point in zip(wavelength_nm[labelled], locus[labelled], strict=True):
        inward = (middle - point) / np.linalg.norm(middle - point)
        place = point + 0.035 * span * inward
        if _inside(place, low, span, 0.05) and _inside(point, low, span, 0.0):
            axes.plot(*point, ".", color=FAINT, markersize=3, zorder=1)
            axes.text(*place, f"{nm:.0f}", color=FAINT, fontsize=5.5, ha="center", va="center",
                      zorder=1.5, path_effects=halo())  # fmt: skip


def _draw_planckian(axes: Any, low: FloatArray, span: float, points: FloatArray) -> None:
    """Draw the chromaticities of black bodies, 1000 K to infinity, and name some in sight."""
    reciprocal = np.linspace(1e6 / 1000.0, 1e6 / 1e6, 120)
    axes.plot(*planckian_chromaticity(1e6 / reciprocal).T, color=INK, linewidth=0.6, zorder=2)
    marks = planckian_chromaticity(np.array(_LABELLED_K))
    for kelvin, point in zip(_LABELLED_K, marks, strict=True):
        # Beside the mark, on the side with more room; the middle of the text decides.
        sides = [(point + span * step * np.array([0.09, -0.025]), step) for step in (1.0, -1.0)]
        room = [np.linalg.norm(points - place, axis=-1).min(initial=span) for place, _ in sides]
        place, step = sides[int(np.argmax(room))]
        if _inside(point, low, span, 0.02) and _inside(place, low, span, 0.10):
            axes.plot(*point, "|", color=INK, markersize=4, markeredgewidth=0.6, zorder=2)
            start = point + span * step * np.array([0.018, -0.012])
            axes.text(*start, f"{kelvin} K", color=INK, fontsize=5.5, zorder=2.5,
                      ha="left" if step > 0 else "right", va="top" if step > 0 else "bottom",
                      path_effects=halo())  # fmt: skip


def _emptiest_corners(places: FloatArray) -> tuple[tuple[int, int], tuple[int, int] | None]:
    """Return the corner with the fewest points around it, and another that has none, if any."""
    reach = np.array([0.36, _INSET + _EDGE])  # a legend is wide
    taken = [
        np.count_nonzero((np.abs(places - np.array(corner)) < reach).all(axis=-1))
        for corner in _CORNERS
    ]
    first, second, *_ = np.argsort(taken, kind="stable")
    return _CORNERS[first], _CORNERS[second] if taken[second] == 0 else None


def _draw_inset(axes: Any, window: tuple[FloatArray, float], corner: tuple[int, int]) -> None:
    """Draw the whole diagram small in a corner, with the window that the panel shows in it."""
    low, span = window
    left, bottom = (_EDGE + side * (1.0 - _INSET - 2.0 * _EDGE) for side in corner)
    inset = axes.inset_axes((left, bottom, _INSET, _INSET), zorder=7)
    _, locus = spectral_locus()
    inset.fill(*locus.T, facecolor="white", edgecolor=FAINT, linewidth=0.6)
    inset.add_patch(_rectangle(low, span))
    inset.set(xlim=(-0.03, 0.66), ylim=(-0.03, 0.66), xticks=[], yticks=[])
    inset.spines[:].set_visible(True)
    inset.spines[:].set(color=RULE, linewidth=0.5)


def _rectangle(low: FloatArray, span: float) -> Any:
    from matplotlib.patches import Rectangle

    return Rectangle(tuple(low), span, span, facecolor="none", edgecolor=INK, linewidth=0.7)
