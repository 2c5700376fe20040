"""HTML and SVG that is escaped by construction: text is text unless it is ``Markup``."""

from __future__ import annotations

import html

__all__ = ["Child", "Markup", "attribute_name", "element", "fragment", "json_block"]

_VOID = frozenset({"br", "col", "hr", "img", "input", "link", "meta"})


class Markup(str):
    """Text that is markup already. Only ``element`` and ``fragment`` make it from data."""

    __slots__ = ()


Child = str | int | None
"""What an element may hold; None is nothing, and a ``str`` that is no ``Markup`` is escaped."""


def element(name: str, /, *children: Child, **attributes: str | float | bool | None) -> Markup:
    """Return an element.

    Args:
        name: Name of the element.
        children: What it holds, in order.
        attributes: By name, ``_`` standing for ``-`` (and one at the end, as in ``class_``, for
            nothing). True gives the bare name; None and False leave it out.
    """
    given = ""
    for key, value in attributes.items():
        if value is None or value is False:
            continue
        shown = attribute_name(key)
        given += f" {shown}" if value is True else f' {shown}="{html.escape(_text(value))}"'
    if name in _VOID:
        return Markup(f"<{name}{given}>")
    return Markup(f"<{name}{given}>{fragment(*children)}</{name}>")


def fragment(*children: Child) -> Markup:
    """Return children one after another."""
    return Markup("".join(_escaped(child) for child in children if child is not None))


def attribute_name(key: str) -> str:
    """Return the name in HTML or SVG of a keyword."""
    return key.rstrip("_").replace("_", "-")


def json_block(identifier: str, text: str) -> Markup:
    """Return a block of JSON that a script reads, which no text in it can end."""
    safe = text.replace("<", "\\u003c").replace(">", "\\u003e").replace("&", "\\u0026")
    return Markup(
        f'<script type="application/json" id="{html.escape(identifier)}">{safe}</script>\n'
    )


def _escaped(child: str | int) -> str:
    return child if isinstance(child, Markup) else html.escape(str(child))


def _text(value: str | float) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".") or "0"
    return str(value)
