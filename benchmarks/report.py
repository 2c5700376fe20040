"""Rows of the comparison as a plain table, as Markdown and as JSON."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass, field
from pathlib import Path


@dataclass(frozen=True, slots=True)
class Row:
    """One figure of ours, beside Mitsuba's or another of ours, and its bar."""

    what: str
    ours: str
    other: str = ""
    ratio: str = ""
    bar: str = ""
    is_met: bool | None = None
    """None where there is no bar."""

    @property
    def verdict(self) -> str:
        """The bar and whether it is met."""
        if self.is_met is None:
            return self.bar
        return f"{self.bar}: {'met' if self.is_met else 'MISSED'}"


@dataclass(slots=True)
class Section:
    """Rows that belong together."""

    title: str
    columns: tuple[str, str, str, str, str]
    rows: list[Row] = field(default_factory=list)


def as_text(machine: dict[str, str], sections: list[Section]) -> str:
    """Return the tables in aligned columns."""
    lines = [f"{name}: {value}" for name, value in machine.items()]
    for section in sections:
        cells = [section.columns, *(_cells(row) for row in section.rows)]
        widths = [max(len(row[k]) for row in cells) for k in range(5)]
        lines += ["", section.title]
        for k, row in enumerate(cells):
            padded = [row[0].ljust(widths[0])]
            padded += [cell.rjust(width) for cell, width in zip(row[1:4], widths[1:4], strict=True)]
            lines.append("  ".join([*padded, row[4]]).rstrip())
            if k == 0:
                lines.append("-" * (sum(widths) + 8))
    return "\n".join(lines)


def as_markdown(machine: dict[str, str], sections: list[Section]) -> str:
    """Return the tables in Markdown."""
    lines = [f"- {name}: {value}" for name, value in machine.items()]
    for section in sections:
        lines += ["", f"**{section.title}**", "", "| " + " | ".join(section.columns) + " |"]
        lines.append("|---|--:|--:|--:|---|")
        lines += ["| " + " | ".join(_cells(row)) + " |" for row in section.rows]
    return "\n".join(lines) + "\n"


def write_json(path: Path, machine: dict[str, str], sections: list[Section], raw: object) -> None:
    """Write the tables and every single measurement."""
    document = {
        "machine": machine,
        "sections": [
            {"title": section.title, "rows": [asdict(row) for row in section.rows]}
            for section in sections
        ],
        "measurements": raw,
    }
    path.write_text(json.dumps(document, indent=1) + "\n")


def _cells(row: Row) -> tuple[str, str, str, str, str]:
    return row.what, row.ours, row.other, row.ratio, row.verdict
