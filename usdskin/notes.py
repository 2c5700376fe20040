"""Named notes: what a reader found in a stage and could not honour, without failing."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class Note:
    """One thing in a stage that the picture does not show."""

    code: str
    """Stable kebab-case name, such as ``displacement-ignored``."""

    path: str
    """Prim path, or file, it was found at."""

    message: str
    """What is there, and what the picture shows instead."""

    def __str__(self) -> str:
        """Return the note as one line."""
        return f"{self.code} <{self.path}>: {self.message}"
