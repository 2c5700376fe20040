"""Bars that the figures of a comparison must not pass."""

from __future__ import annotations

from collections.abc import Mapping

from usdskin.errors import FindingsError, UsageError
from usdskin.judge.comparison import Comparison

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


def passed_bars(found: Comparison, bars: Mapping[str, float]) -> list[tuple[str, float, float]]:
    """Return the bars that do not hold: name, value and bar.

    Raises:
        UsageError: A bar is for spectra, and there are none.
    """
    known_bars(bars)
    figures = found.as_json()
    passed = []
    for name, bar in bars.items():
        section, key = _BARS[name]
        if figures[section] is None:
            raise UsageError(
                f"--threshold {name}: not both pictures have spectra; render them with --spectral."
            )
        value = figures[section][key]
        holds = value >= bar if name in _AT_LEAST else value <= bar
        if not holds:
            passed.append((name, float(value), bar))
    return passed


def check_bars(found: Comparison, bars: Mapping[str, float]) -> None:
    """Raise where a bar does not hold.

    Raises:
        FindingsError: Names every bar that was passed, and by what.
    """
    passed = passed_bars(found, bars)
    if passed:
        said = "; ".join(
            f"{_title(name)} {value:.4g} is {'under' if name in _AT_LEAST else 'over'} {bar:g}"
            for name, value, bar in passed
        )
        raise FindingsError(f"{found.picture} against {found.truth}: {said}.")


def _title(name: str) -> str:
    section, key = _BARS[name]
    return (
        f"dE2000 {key}" if section == "deltaE2000" else name.upper() if name != "flip" else "FLIP"
    )
