"""The same numbers for programs: ``report.json`` and ``report.csv``."""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterator, Sequence
from dataclasses import asdict
from typing import Any

from usdskin import __version__
from usdskin.judge.proof.record import finite
from usdskin.judge.report.proof import Proof
from usdskin.judge.report.quality import CaptureRow
from usdskin.judge.report.records import Spread

__all__ = ["as_csv", "as_json", "content_of"]

_UNITS = {"rmse": "of the peak", "flip": "1"}


def content_of(
    proof: Proof, capture: Sequence[CaptureRow], missing: Sequence[str]
) -> dict[str, Any]:
    """Return all numbers of a report.

    Args:
        proof: What was found.
        capture: Figures of the capture's quality.
        missing: Sections that were left out.
    """
    return {
        "version": __version__,
        "proofVersion": proof.version,
        "proofSha256": proof.digest,
        "set": proof.set_name,
        "title": proof.title,
        "settings": dict(proof.settings),
        "bars": [asdict(bar) for bar in proof.bars],
        "comparisons": [
            {
                "name": item.name,
                "integrator": item.integrator,
                "observer": item.observer,
                "yN": item.y_n,
                "white": None if item.white is None else list(item.white),
                "whiteFrom": item.white_from,
                "mask": {
                    "from": item.mask_from,
                    "pixels": item.mask_pixels,
                    "share": item.mask_share,
                },
                **{name: _spread(spread) for name, spread in item.spreads.items()},
                "spectral": dict(item.spectral) or None,
                "regions": [
                    {
                        "name": region.name,
                        "pixels": region.pixels,
                        "deltaE2000": _spread(region.delta_e),
                    }
                    for region in item.regions
                ],
                "noise": None if item.noise is None else {"deltaE2000": _spread(item.noise)},
            }
            for item in proof.comparisons
        ],
        "skin": [asdict(item) for item in proof.skin],
        "tones": [
            {
                "tone": tone.tone,
                "integrator": tone.integrator,
                "deltaE2000": _spread(tone.delta_e),
                "gfc": tone.gfc,
                "chain": None if tone.chain is None else {"deltaE2000": _spread(tone.chain)},
            }
            for tone in proof.tones
        ],
        "budget": [
            {"cause": row.cause, "setting": row.setting, "deltaE2000": _spread(row.delta_e)}
            for row in proof.budget
        ],
        "patches": [
            {
                "class": item.light_class,
                "leaveOneOut": {
                    "deltaE2000": _spread(item.left_out or Spread()),
                    "gfc": item.left_out_gfc,
                },
                "relit": {
                    "deltaE2000": _spread(item.relit or Spread()),
                    "gfc": item.relit_gfc,
                    "lampGfc": item.lamp_gfc,
                },
                "patches": [
                    {"name": name, "leaveOneOut": left_out, "relit": relit}
                    for name, left_out, relit in item.patches
                ],
            }
            for item in proof.patches
        ],
        "capture": [
            {"name": row.name, "value": row.value, "unit": row.unit, "meaning": row.meaning}
            for row in capture
        ],
        "spectra": {
            "wavelengths": list(proof.wavelengths),
            "items": [asdict(item) for item in proof.spectra],
        },
        "seconds": {step.name: step.seconds for step in proof.steps},
        "missing": list(missing),
    }


def _spread(spread: Spread) -> dict[str, float]:
    return {name: value for name, value in asdict(spread).items() if value is not None}


def as_json(content: dict[str, Any]) -> str:
    """Return the numbers as JSON, keys sorted."""
    return (
        json.dumps(finite(content), indent=1, sort_keys=True, ensure_ascii=False, allow_nan=False)
        + "\n"
    )


def as_csv(content: dict[str, Any]) -> str:
    """Return the numbers as rows of section, item, quantity, value and unit.

    A text that a spreadsheet would take for a formula gets a quote in front.
    """
    sheet = io.StringIO()
    writer = csv.writer(sheet, lineterminator="\n")
    writer.writerow(["section", "item", "quantity", "value", "unit"])
    for section, item, quantity, value, unit in _rows(content):
        number = repr(value) if isinstance(value, float) else str(value)
        writer.writerow([section, _cell(item), _cell(quantity), number, unit])
    return sheet.getvalue()


def _cell(text: str) -> str:
    return f"'{text}" if text[:1] in "=+-@\t\r" and text[:1] else text


def _rows(content: dict[str, Any]) -> Iterator[tuple[str, str, str, float | int, str]]:
    for bar in content["bars"]:
        for quantity in ("value", "bar", "met"):
            if bar[quantity] is not None:
                yield "bars", bar["name"], quantity, _plain(bar[quantity]), ""
    for item in content["comparisons"]:
        name = f"{item['name']} {item['integrator']}"
        if item["yN"] is not None:
            yield "comparisons", name, "yN", item["yN"], ""
        for quantity in ("deltaE2000", "deltaE76", "deltaL", "deltaA", "deltaB", "flip"):
            for statistic, value in item[quantity].items():
                yield "comparisons", name, f"{quantity} {statistic}", value, "1"
        for statistic, value in (item["noise"] or {"deltaE2000": {}})["deltaE2000"].items():
            yield "comparisons", name, f"noise deltaE2000 {statistic}", value, "1"
        for quantity, value in (item["spectral"] or {}).items():
            yield "comparisons", name, f"spectral {quantity}", value, _UNITS.get(quantity, "1")
        for region in item["regions"]:
            for statistic, value in region["deltaE2000"].items():
                where = f"{name} {region['name']}"
                yield "regions", where, f"deltaE2000 {statistic}", value, "1"
    for row in content["skin"]:
        for quantity in ("true", "estimated", "stddev"):
            if row[quantity] is not None:
                yield "skin", row["name"], quantity, row[quantity], ""
    for section, key in (("tones", "tone"), ("budget", "cause")):
        for row in content[section]:
            more = row.get("integrator") or row.get("setting") or ""
            for statistic, value in row["deltaE2000"].items():
                yield section, f"{row[key]} {more}".strip(), f"deltaE2000 {statistic}", value, "1"
            for statistic, value in (row.get("chain") or {"deltaE2000": {}})["deltaE2000"].items():
                where = f"{row[key]} {more}".strip()
                yield section, where, f"chain deltaE2000 {statistic}", value, "1"
            if row.get("gfc") is not None:
                yield section, f"{row[key]} {more}".strip(), "gfc", row["gfc"], "1"
    for row in content["patches"]:
        for what in ("leaveOneOut", "relit"):
            for statistic, value in row[what]["deltaE2000"].items():
                yield "patches", row["class"], f"{what} deltaE2000 {statistic}", value, "1"
            if row[what]["gfc"] is not None:
                yield "patches", row["class"], f"{what} gfc", row[what]["gfc"], "1"
    for row in content["capture"]:
        yield "capture", row["name"], "value", row["value"], row["unit"]
    for name, value in content["seconds"].items():
        if value is not None:
            yield "steps", name, "time", value, "s"


def _plain(value: bool | float) -> int | float:
    return int(value) if isinstance(value, bool) else value
