"""JSON written by a stranger, read with the place of every value at hand for the error."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from usdskin.errors import UsdSkinError

__all__ = ["Node", "ProofError"]


class ProofError(UsdSkinError):
    """A proof that cannot be reported on."""


@dataclass(frozen=True, slots=True)
class Node:
    """A value of a JSON file and where it is."""

    value: Any
    """The value, as ``json`` gives it."""

    where: str
    """``file: key.key[0]``."""

    def error(self, needed: str) -> ProofError:
        """Return the error that this value is not what it should be."""
        shown = repr(self.value)
        shown = shown if len(shown) <= 40 else f"{shown[:37]}..."
        return ProofError(f"{self.where}: is {shown}; {needed} is needed, prove again")

    def child(self, name: str) -> Node:
        """Return a member that must be there."""
        members = self.members()
        if name not in members:
            raise ProofError(f"{self.where}: has no {name!r}; prove again")
        return Node(members[name], f"{self.where}.{name}")

    def optional(self, name: str) -> Node | None:
        """Return a member, None where it is missing or null."""
        members = self.members()
        found = members.get(name)
        return None if found is None else Node(found, f"{self.where}.{name}")

    def members(self) -> dict[str, Any]:
        """Return the members of an object."""
        if not isinstance(self.value, dict):
            raise self.error("an object")
        return self.value

    def entries(self) -> Iterator[tuple[str, Node]]:
        """Return the members of an object by name, in order of name."""
        for name in sorted(self.members()):
            yield name, Node(self.value[name], f"{self.where}.{name}")

    def rows(self, name: str) -> list[Node]:
        """Return the items of a list member, none where it is missing."""
        found = self.optional(name)
        return [] if found is None else found.items()

    def items(self) -> list[Node]:
        """Return the items of a list."""
        if not isinstance(self.value, list):
            raise self.error("a list")
        return [Node(item, f"{self.where}[{index}]") for index, item in enumerate(self.value)]

    def text(self) -> str:
        """Return a text."""
        if not isinstance(self.value, str):
            raise self.error("a text")
        return self.value

    def number(self) -> float:
        """Return a finite number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.error("a number")
        try:
            number = float(self.value)
        except OverflowError:
            raise self.error("a finite number") from None
        if not math.isfinite(number):
            raise self.error("a finite number")
        return number

    def truth(self) -> bool:
        """Return true or false."""
        if not isinstance(self.value, bool):
            raise self.error("true or false")
        return self.value

    def texts(self, name: str) -> tuple[str, ...]:
        """Return a list member of texts, empty where it is missing."""
        return tuple(item.text() for item in self.rows(name))

    def maybe_text(self, name: str, otherwise: str = "") -> str:
        """Return a text member, or a default where it is missing."""
        found = self.optional(name)
        return otherwise if found is None else found.text()

    def maybe_number(self, name: str) -> float | None:
        """Return a number member, None where it is missing or null."""
        found = self.optional(name)
        return None if found is None else found.number()
