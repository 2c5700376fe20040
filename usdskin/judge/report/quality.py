"""How good the capture was: what ``CaptureAPI`` says, and what it means."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from usdskin.errors import UsdSkinError
from usdskin.judge.report.markup import Markup, element
from usdskin.judge.report.proof import Proof
from usdskin.judge.report.shown import NONE, figure, number, number_cell, percent, section, table
from usdskin.layers import open_stage
from usdskin.notes import Note
from usdskin.prims.captures import capture_prim
from usdskin.prims.values import DEFAULT_TIME, read_schema

__all__ = ["CaptureRow", "capture_section", "read_capture"]

_SHARES = (
    ("capture:coverage", "Coverage", "share of the sphere that a view covers"),
    ("capture:clippedShare", "Clipped light", "share of the flux that clips in every exposure"),
    ("capture:movedShare", "Moved", "share of the sphere where exposures contradict each other"),
    ("capture:fluxError", "Flux error", "estimated relative error of the panorama's total flux"),
    ("capture:exposureError", "Exposure error", "largest deviation of two exposures' ratio"),
    ("capture:noise", "Noise", "median relative standard deviation where there is light"),
)


@dataclass(frozen=True, slots=True)
class CaptureRow:
    """One figure of the capture's quality."""

    name: str
    value: float | None
    unit: str
    meaning: str

    @property
    def shown(self) -> str:
        """The value with its unit."""
        if self.value is None:
            return NONE
        if self.unit == "1":
            return percent(self.value)
        return f"{number(self.value, 0 if self.unit == 'lamps' else 2)} {self.unit}"


def read_capture(proof: Proof, notes: list[Note]) -> list[CaptureRow]:
    """Return the figures of the proof's capture, none where there is no capture.

    Args:
        proof: Names the layer.
        notes: Takes why it cannot be read.
    """
    if "capture" not in proof.layers:
        return []
    path = proof.file(proof.layers["capture"])
    try:
        stage = open_stage(path, notes)  # held: a prim does not keep its stage
        values = read_schema(capture_prim(stage), "CaptureAPI", DEFAULT_TIME)
    except UsdSkinError as error:
        notes.append(Note("capture-not-shown", str(path), str(error)))
        return []
    rows = [
        CaptureRow(title, _finite(values.get(name)), "1", meaning)
        for name, title, meaning in _SHARES
    ]
    rows.append(
        CaptureRow(
            "Rotation residual",
            _finite(values.get("capture:rotationResidual")),
            "°",
            "root mean square angle left between overlapping views",
        )
    )
    lamps = values.get("capture:lamps:shares")
    if lamps is not None and np.size(lamps):
        rows.append(
            CaptureRow(
                "Clipped lamps", float(np.size(lamps)), "lamps", "with clipped pixels, told apart"
            )
        )
    return [row for row in rows if row.value is not None]


def _finite(value: Any) -> float | None:
    if not isinstance(value, int | float):
        return None
    found = float(value)
    return found if np.isfinite(found) else None


def capture_section(rows: list[CaptureRow], picture: Markup | None) -> Markup | None:
    """Return the section of the capture's quality.

    Args:
        rows: Its figures.
        picture: The picture that the capture drew of itself.
    """
    if not rows and picture is None:
        return None
    lines = [
        element(
            "tr",
            element("th", row.name, scope="row"),
            number_cell(row.shown),
            element("td", row.meaning),
        )
        for row in rows
    ]
    heads = [("Figure", False), ("found", True), ("meaning", False)]
    drawn = None if picture is None else figure("What the capture says about itself.", picture)
    listed = table("Quality of the capture", heads, lines) if lines else None
    return section("capture", "Capture", listed, drawn)


def quality_picture(proof: Proof) -> Path | None:
    """Return the picture of the capture's quality that lies beside its layer."""
    if "capture" not in proof.layers:
        return None
    name = proof.layers["capture"]
    folder = name.rpartition("/")[0]
    begin = f"{folder}/" if folder else ""
    for candidate in (f"{begin}quality.png", f"{begin}capture.quality.png"):
        if candidate in proof.files and (proof.folder / candidate).is_file():
            return proof.file(candidate)
    return None
