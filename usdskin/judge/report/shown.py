"""Numbers as they are shown, and tables of them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

from usdskin.judge.report.markup import Child, Markup, element, fragment

__all__ = ["NONE", "figure", "note", "number", "number_cell", "percent", "section", "size", "table"]

NONE = "–"
"""What stands for a number there is not."""

_SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: float | None, digits: int = 2) -> str:
    """Return a number with fixed digits; a very large one with a power of ten."""
    if value is None or not math.isfinite(value):
        return NONE
    if abs(value) >= 1e6:
        mantissa, exponent = f"{value:.2e}".split("e")
        return f"{mantissa} × 10{str(int(exponent)).translate(_SUPERSCRIPTS)}".replace("-", "−", 1)
    rounded = round(value, digits) + 0.0  # no minus before zero
    return f"{rounded:.{digits}f}".replace("-", "−")


def percent(value: float | None, digits: int = 2) -> str:
    """Return a share as per cent."""
    return NONE if value is None else f"{100.0 * value:.{digits}f} %".replace("-", "−")


def size(count: int | None) -> str:
    """Return a number of bytes for people."""
    if count is None:
        return NONE
    for unit, factor in (("MB", 1e6), ("kB", 1e3)):
        if count >= factor:
            return f"{count / factor:.1f} {unit}"
    return f"{count} B"


def number_cell(text: str, **attributes: str | float | bool | None) -> Markup:
    """Return a cell whose text is a number."""
    return element("td", text, class_="n", **attributes)


def table(
    caption: Child, heads: Sequence[tuple[Child, bool]], rows: Iterable[Markup], class_: str = ""
) -> Markup:
    """Return a table that scrolls by itself where the page is narrow.

    Args:
        caption: What it shows.
        heads: Text of each column's head, and whether the column holds numbers.
        rows: ``tr`` elements.
        class_: Classes of the table.
    """
    head = element(
        "tr",
        *(element("th", text, scope="col", class_="n" if is_n else None) for text, is_n in heads),
    )
    body = element("tbody", fragment(*rows))
    inner = element(
        "table", element("caption", caption), element("thead", head), body, class_=class_ or None
    )
    return element("div", inner, class_="scroll")


def section(identifier: str, title: str, *children: Child) -> Markup:
    """Return a section of the report."""
    heading = element("h2", title, id=f"{identifier}-title")
    return element("section", heading, *children, id=identifier,
                   aria_labelledby=f"{identifier}-title")  # fmt: skip


def figure(caption: Child, *children: Child, class_: str | None = None) -> Markup:
    """Return a figure with its caption."""
    return element("figure", *children, element("figcaption", caption), class_=class_)


def note(*children: Child) -> Markup:
    """Return a paragraph in small type."""
    return element("p", *children, class_="note")
