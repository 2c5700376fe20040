"""One opinion among several: flags before authored values before fallbacks, each checked.

A check takes a value of any kind, as a layer may hold anything, and returns it clean or raises
``ValueError`` saying what is wrong with it; ``choose`` adds where the value came from.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd

from usdskin.errors import LayerError, UsageError
from usdskin.layers import describe

RESOLUTION_LIMIT = 16384
"""Most pixels along a side."""

WAVELENGTH_RANGE_NM = (300.0, 1100.0)
"""Where a band may lie [nm]: what silicon sees and daylight tables cover."""

_Value = TypeVar("_Value")


def choose(
    prims: Sequence[Usd.Prim],
    name: str,
    check: Callable[[Any], _Value],
    fallback: _Value,
    flag: str = "",
    given: Any = None,
) -> _Value:
    """Return the strongest opinion: the flag, else the first prim that authors the attribute.

    Args:
        prims: Prims that may hold the attribute, strongest first.
        name: Name of the attribute.
        check: Returns the value clean, or raises ValueError.
        fallback: Value where nobody has an opinion.
        flag: Option of the command line that overrides the attribute.
        given: What the option says; None when it was not given.

    Raises:
        UsageError: The flag's value is wrong.
        LayerError: The authored value is wrong.
    """
    if given is not None:
        try:
            return check(given)
        except ValueError as problem:
            raise UsageError(f"{flag} {_shown(given)}: {problem}") from None
    for prim in prims:
        attribute = prim.GetAttribute(name)
        if attribute and attribute.HasAuthoredValue():
            # The earliest time also finds what has time samples only.
            value = attribute.Get(Usd.TimeCode.EarliestTime())
            try:
                return check(value)
            except ValueError as problem:
                raise LayerError(f"{describe(prim)}: {name} = {_shown(value)}: {problem}") from None
    return fallback


def _shown(value: Any) -> str:
    if isinstance(value, tuple):
        return " ".join(map(str, value))
    text = str(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def one_of(names: Collection[str]) -> Callable[[Any], str]:
    """Return a check that a token is one of ``names``."""

    def check(value: Any) -> str:
        if isinstance(value, str) and value in names:
            return value
        close = difflib.get_close_matches(str(value), names, n=1)
        hint = f" Did you mean {close[0]}?" if close else ""
        raise ValueError(f"must be one of {', '.join(names)}.{hint}")

    return check


def several_of(names: Collection[str]) -> Callable[[Any], tuple[str, ...]]:
    """Return a check that each token of an array is one of ``names``."""

    def check(value: Any) -> tuple[str, ...]:
        if isinstance(value, str) or not hasattr(value, "__iter__"):
            raise ValueError("must be an array of tokens.")
        return tuple(one_of(names)(token) for token in value)

    return check


def whole_number(lowest: int, highest: int) -> Callable[[Any], int]:
    """Return a check that a value is an integer between the limits, both included."""

    def check(value: Any) -> int:
        if isinstance(value, int) and not isinstance(value, bool) and lowest <= value <= highest:
            return value
        raise ValueError(f"must be a whole number from {lowest} to {highest}.")

    return check


def real_number(lowest: float, highest: float) -> Callable[[Any], float]:
    """Return a check that a value is a finite number between the limits, both included."""

    def check(value: Any) -> float:
        if isinstance(value, int | float) and lowest <= value <= highest:
            return float(value)
        raise ValueError(f"must be a number from {lowest:g} to {highest:g}.")

    return check


def truth(value: Any) -> bool:
    """Check that a value is true or false."""
    if isinstance(value, bool):
        return value
    raise ValueError("must be true or false.")


def text(value: Any) -> str:
    """Check that a value is text."""
    if isinstance(value, str):
        return value
    raise ValueError("must be text.")


def resolution(value: Any) -> tuple[int, int]:
    """Check a width and height [px]."""
    if isinstance(value, Gf.Vec2i | tuple) and len(value) == 2:
        width, height = int(value[0]), int(value[1])
        if 1 <= width <= RESOLUTION_LIMIT and 1 <= height <= RESOLUTION_LIMIT:
            return width, height
    raise ValueError(f"a picture has 1 to {RESOLUTION_LIMIT} pixels along each side.")


def data_window(value: Any) -> tuple[float, float, float, float]:
    """Check a window in normalised picture coordinates: left, bottom, right, top."""
    if isinstance(value, Gf.Vec4f | Gf.Vec4d):
        left, bottom, right, top = (float(edge) for edge in value)
        finite = all(map(math.isfinite, (left, bottom, right, top)))
        if finite and left < right and bottom < top:
            return left, bottom, right, top
    raise ValueError("must be xmin, ymin, xmax, ymax with a positive width and height.")


def wavelengths(value: Any) -> NDArray[np.float64]:
    """Check band centres [nm] and return them read-only, shape [band_count]."""
    try:
        centers = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError("must be an array of numbers.") from None
    if centers.ndim != 1 or centers.size < 2:
        raise ValueError("must hold at least two wavelengths: their distance is the bands' width.")
    if not np.isfinite(centers).all():
        raise ValueError(f"wavelength {int(np.argmin(np.isfinite(centers)))} is not finite.")
    falls = np.flatnonzero(np.diff(centers) <= 0)
    if falls.size:
        first, second = centers[falls[0]], centers[falls[0] + 1]
        raise ValueError(f"must ascend strictly, but {second:g} follows {first:g} nm.")
    low, high = WAVELENGTH_RANGE_NM
    if centers[0] < low or centers[-1] > high:
        raise ValueError(f"bands lie between {low:g} and {high:g} nm.")
    centers.setflags(write=False)
    return centers


def parse_wavelengths(spelled: str) -> NDArray[np.float64]:
    """Return the band centres that ``FIRST:LAST:STEP`` names [nm], shape [band_count].

    Raises:
        UsageError: The text is no range, or names no usable bands.
    """
    try:
        first, last, step = (float(part) for part in spelled.split(":"))
        if not (math.isfinite(first + last) and 0 < step < math.inf and first <= last):
            raise ValueError
    except ValueError:
        raise UsageError(
            f"--wavelengths {spelled!r}: write FIRST:LAST:STEP in nm, such as 400:700:5."
        ) from None
    count = math.floor(min((last - first) / step, 1e5) + 1e-9) + 1
    if count > 10_000:
        raise UsageError(f"--wavelengths {spelled}: over 10000 bands; take a larger step.")
    try:
        return wavelengths(first + step * np.arange(count))
    except ValueError as problem:
        raise UsageError(f"--wavelengths {spelled}: {problem}") from None
