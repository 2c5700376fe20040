"""Bars that the figures of a comparison must not pass."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from usdskin.errors import FindingsError, UsageError
from usdskin.judge.comparison.compare import Comparison

_BARS = {
    "mean": ("deltaE2000", "mean"),
    "median": ("deltaE2000", "median"),
    "p95": ("deltaE2000", "p95"),
    "max": ("deltaE2000", "max"),
    "flip": ("flip", "mean"),
    "rmse": ("spectral", "rmse"),
    "gfc": ("spectral", "gfc"),
}
"""Name of a bar to section and figure of ``Comparison.as_json``."""

_AT_LEAST = ("gfc",)


@dataclass(frozen=True, slots=True)
class Bar:
    """How a figure stands to its bar."""

    name: str
    value: float
    bar: float
    met: bool


def known_bars(bars: Mapping[str, float]) -> None:
    """Check the names of bars.

    Raises:
        UsageError: There is no such figure, or a bar is no number.
    """
    for name, bar in bars.items():
        if name not in _BARS:
            raise UsageError(f"--threshold {name}: no such figure; choose from {', '.join(_BARS)}.")
        if not bar >= 0.0:
            raise UsageError(f"--threshold {name}={bar:g}: a bar is a number from 0 on.")


def judge_bars(found: Comparison, bars: Mapping[str, float]) -> list[Bar]:
    """Return how figures stand to their bars.

    Args:
        found: The comparison.
        bars: Bar of each figure: the most, or of ``gfc`` the least.

    Raises:
        UsageError: There is no such figure, or it is one of spectra and there are none.
    """
    known_bars(bars)
    figures = found.as_json()
    judged = []
    for name, bar in bars.items():
        section, key = _BARS[name]
        if figures[section] is None:
            raise UsageError(
                f"--threshold {name}: not both pictures have spectra; render them with --spectral."
            )
        value = float(figures[section][key])
        judged.append(Bar(name, value, bar, value >= bar if name in _AT_LEAST else value <= bar))
    return judged


def require(found: Comparison, bars: Sequence[Bar]) -> None:
    """Raise where a bar is not met.

    Raises:
        FindingsError: Names every bar that was passed, and by what.
    """
    said = "; ".join(
        f"{_title(bar.name)} {bar.value:.4g} is {'under' if bar.name in _AT_LEAST else 'over'} "
        f"{bar.bar:g}"
        for bar in bars
        if not bar.met
    )
    if said:
        raise FindingsError(f"{found.picture} against {found.truth}: {said}.")


def _title(name: str) -> str:
    section, key = _BARS[name]
    return f"dE2000 {key}" if section == "deltaE2000" else name.upper()
