"""Drawings as inline SVG: curves over wavelength, bars, intervals. Colours come from the style."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.report.markup import Markup, element, fragment

__all__ = ["Curve", "curves", "intervals", "nice_ticks", "spread_bar"]

FloatArray = NDArray[np.float64]

_CHARACTER = 6.3
"""Width of a character of the labels, about."""


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """One curve over wavelength."""

    values: FloatArray
    """Shape [band_count]."""

    style: str
    """Class of the line: ``estimate`` (solid) or ``truth`` (dashed)."""

    deviation: FloatArray | None = None
    """Standard deviation, drawn as a band, shape [band_count]."""


def nice_ticks(low: float, high: float, about: int = 4) -> list[float]:
    """Return round numbers from ``low`` to ``high``, both inside."""
    if not high > low:
        return [low]
    raw = (high - low) / about
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(k * power for k in (1.0, 2.0, 2.5, 5.0, 10.0) if k * power >= 0.999 * raw)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [index * step for index in range(first, last + 1)]


def tick_text(value: float, step: float) -> str:
    """Return the label of a tick."""
    if value == 0.0:
        return "0"
    digits = max(0, -math.floor(math.log10(step) + 1e-9)) if step > 0.0 else 0
    if f"{step:.{digits}f}" != f"{step:g}" and digits < 6:
        digits += 1
    return f"{value:.{min(digits, 6)}f}".replace("-", "−")


def curves(
    wavelength_nm: FloatArray,
    lines: Sequence[Curve],
    label: str,
    *,
    unit: str = "",
    size: tuple[int, int] = (300, 160),
) -> Markup:
    """Return curves over wavelength, the scale of the axis as a power of ten in its unit.

    Args:
        wavelength_nm: Band centres [nm], shape [band_count].
        lines: The curves, the first one lowest.
        label: What is shown, for those who do not see it.
        unit: Unit of the values.
        size: Width and height in units of the drawing.
    """
    low, high = _range(lines)
    exponent = _exponent(max(abs(low), abs(high)))
    factor = 10.0**-exponent
    span = float(wavelength_nm[0]), float(wavelength_nm[-1])
    panel = _Panel(*size, low * factor, high * factor, *span)
    parts = panel.axes()
    scale = "" if exponent == 0 else f"10{_super(exponent)} "
    if scale or unit:
        parts.append(element("text", f"{scale}{unit}".strip(), x=2, y=9, class_="unit"))
    x = panel.across(wavelength_nm)
    for line in lines:
        if line.deviation is not None:
            upper = panel.up((line.values + line.deviation) * factor)
            lower = panel.up((line.values - line.deviation) * factor)
            around = _points(np.concatenate([x, x[::-1]]), np.concatenate([upper, lower[::-1]]))
            parts.append(element("polygon", points=around, class_="deviation"))
    for line in lines:
        values = panel.up(line.values * factor)
        parts.append(element("polyline", points=_points(x, values), class_=line.style))
    return _drawing(*size, label, parts)


@dataclass(frozen=True, slots=True)
class _Panel:
    """Axes of curves: where values lie in a drawing."""

    width: int
    height: int
    low: float
    high: float
    first_nm: float
    last_nm: float

    LEFT: ClassVar[float] = 40.0
    RIGHT: ClassVar[float] = 8.0
    TOP: ClassVar[float] = 18.0
    BOTTOM: ClassVar[float] = 18.0

    def across(self, wavelength_nm: FloatArray | float) -> FloatArray:
        """Return where wavelengths lie; a single one lies left."""
        span = (self.last_nm - self.first_nm) or 1.0
        share = (np.asarray(wavelength_nm, np.float64) - self.first_nm) / span
        return np.asarray(self.LEFT + share * (self.width - self.LEFT - self.RIGHT))

    def up(self, values: FloatArray | float) -> FloatArray:
        """Return where values lie; what leaves the panel is seen to."""
        share = (np.asarray(values, np.float64) - self.low) / (self.high - self.low)
        y = self.height - self.BOTTOM - share * (self.height - self.TOP - self.BOTTOM)
        return np.asarray(np.clip(y, self.TOP - 6.0, self.height - self.BOTTOM + 6.0))

    def axes(self) -> list[Markup]:
        """Return the grid, the base line and the labels."""
        parts = []
        right, foot = self.width - self.RIGHT, self.height - self.BOTTOM
        ticks = nice_ticks(self.low, self.high)
        step = ticks[1] - ticks[0] if len(ticks) > 1 else 1.0
        for tick in ticks:
            y, text = float(self.up(tick)), tick_text(tick, step)
            parts.append(element("line", x1=self.LEFT, x2=right, y1=y, y2=y, class_="grid"))
            parts.append(element("text", text, x=self.LEFT - 5, y=y + 3.5, class_="end"))
        for tick in nice_ticks(self.first_nm, self.last_nm, 3):
            at = float(self.across(tick))
            is_last = at > right - 24.0
            text = f"{tick:g} nm" if is_last else f"{tick:g}"
            place = "end" if is_last else "middle"
            parts.append(element("line", x1=at, x2=at, y1=foot, y2=foot + 3, class_="axis"))
            parts.append(element("text", text, x=at, y=foot + 13, class_=place))
        base = float(self.up(max(self.low, 0.0)))
        parts.append(element("line", x1=self.LEFT, x2=right, y1=base, y2=base, class_="axis"))
        return parts


def _range(lines: Sequence[Curve]) -> tuple[float, float]:
    """Return a range on which a measured curve stays legible though an estimate explodes."""
    truth = [line.values for line in lines if line.style == "truth"]
    everything = [
        line.values + sign * (0.0 if line.deviation is None else line.deviation)
        for line in lines
        for sign in (-1.0, 1.0)
    ]
    high = max(float(values.max()) for values in everything)
    low = min(0.0, *(float(values.min()) for values in everything))
    if truth:
        peak = max(float(np.abs(values).max()) for values in truth) or high or 1.0
        high, low = min(high, 2.5 * peak), max(low, -peak)
    if not high > low:
        high = low + 1.0
    return low, low + 1.04 * (high - low)


def _exponent(peak: float) -> int:
    if peak <= 0.0 or 0.01 <= peak < 1000.0:
        return 0
    return 3 * math.floor(math.log10(peak) / 3.0)


def _super(exponent: int) -> str:
    return str(exponent).translate(str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹"))


def _points(x: FloatArray, y: FloatArray) -> str:
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


def spread_bar(mean: float | None, p95: float | None, top: float) -> Markup:
    """Return a bar of a mean with a line to the 95th percentile, as wide as where it stands.

    Args:
        mean: Length of the bar.
        p95: Where the line ends.
        top: Value at the right end, the same for all bars that stand together; longer ones are
            cut, and are seen to be.
    """
    reach = min(100.0 * (mean or 0.0) / top, 100.0)
    parts = [element("rect", x=0, y=0, width=max(reach, 0.3), height=10, class_="bar")]
    if p95 is not None:
        end = min(100.0 * p95 / top, 100.0)
        parts.append(element("line", x1=min(reach, end), x2=max(reach, end), y1=5, y2=5,
                             class_="reach"))  # fmt: skip
        if p95 <= top:
            parts.append(element("line", x1=end, x2=end, y1=1, y2=9, class_="reach"))
    if (mean or 0.0) > top:
        parts += [element("line", x1=at, x2=at + 1, y1=10, y2=0, class_="cut") for at in (93, 95)]
    return element("svg", *parts, viewBox="0 0 100 10", preserveAspectRatio="none",
                   aria_hidden="true", class_="plot spread")  # fmt: skip


def intervals(rows: Sequence[tuple[str, float, str]], label: str, *, width: int = 350) -> Markup:
    """Return how many standard deviations estimates lie off the truth, one row each.

    Args:
        rows: Name, deviation [standard deviations] and what to say of each.
        label: What is shown, for those who do not see it.
        width: Width in units of the drawing.
    """
    longest = max((len(name) for name, _, _ in rows), default=0)
    left = min(max(70.0, _CHARACTER * longest + 14.0), 0.4 * width)
    reach = 4.0
    pitch, top = 22.0, 6.0
    height = int(top + pitch * len(rows) + 22.0)
    scale = (width - left - 14.0) / (2.0 * reach)
    middle = left + reach * scale
    end = height - 18.0
    parts = [
        element("rect", x=middle - scale * sigma, y=top, width=2 * sigma * scale, height=end - top,
                class_=f"sigma{sigma}")
        for sigma in (2, 1)
    ]  # fmt: skip
    for tick in range(-4, 5, 1):
        at = middle + tick * scale
        if tick % 2 == 0:
            text = f"{tick}".replace("-", "−") + " σ"
            parts.append(element("text", text, x=at, y=height - 5, class_="middle"))
    parts.append(element("line", x1=middle, x2=middle, y1=top, y2=end, class_="axis"))
    for index, (name, deviation, said) in enumerate(rows):
        y = top + pitch * index + 11.0
        at = middle + float(np.clip(deviation, -reach, reach)) * scale
        parts.append(element("text", name, x=left - 8, y=y + 4, class_="end name"))
        dot = element("circle", element("title", said), cx=at, cy=y, r=4.5, class_="dot")
        parts.append(dot)
        if abs(deviation) > reach:
            arrow = "›" if deviation > 0 else "‹"
            parts.append(element("text", arrow, x=at + (7 if deviation > 0 else -11), y=y + 4))
    return _drawing(width, height, label, parts)


def _drawing(width: int, height: int, label: str, parts: Sequence[Markup]) -> Markup:
    return element("svg", fragment(*parts), viewBox=f"0 0 {width} {height}", role="img",
                   aria_label=label, class_="plot", width=width)  # fmt: skip
