"""What the proof found in numbers: spectra, skin, tones, causes of error."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from usdskin.differences import goodness_of_fit
from usdskin.judge.report.charts import Curve, curves, intervals, spread_bar
from usdskin.judge.report.markup import Child, Markup, element, fragment
from usdskin.judge.report.proof import Proof
from usdskin.judge.report.records import Parameter, Spectra, Spread
from usdskin.judge.report.shown import NONE, figure, note, number, number_cell, section, table
from usdskin.judge.report.verdict import integrator_title

__all__ = ["budget_section", "patches_section", "skin_section", "spectra_section", "tones_section"]

_KINDS = {"light": "Light", "patch": "Chart patches", "skin": "Skin"}
_UNITS = {"light": "W m⁻² nm⁻¹", "patch": "W m⁻² sr⁻¹ nm⁻¹"}
_SHOWN_PATCHES = 12
"""More patches are behind a fold."""


def spectra_section(proof: Proof) -> Markup | None:
    """Return the section of curves over wavelength."""
    if not proof.spectra or not proof.wavelengths:
        return None
    nm = np.array(proof.wavelengths)
    parts = [_legend(any(item.stddev for item in proof.spectra))]
    kinds = list(dict.fromkeys(item.kind for item in proof.spectra))
    for kind in sorted(kinds, key=lambda name: list(_KINDS).index(name) if name in _KINDS else 9):
        items = [item for item in proof.spectra if item.kind == kind]
        panels = [_panel(nm, item) for item in items]
        parts.append(element("h3", _KINDS.get(kind, kind or "Others")))
        parts.append(element("div", *panels[:_SHOWN_PATCHES], class_="panels"))
        if len(panels) > _SHOWN_PATCHES:
            rest = panels[_SHOWN_PATCHES:]
            summary = element("summary", f"{len(rest)} more")
            parts.append(element("details", summary, element("div", *rest, class_="panels")))
    return section("spectra", "Spectra", fragment(*parts))


def _legend(with_deviation: bool) -> Markup:
    def key(class_: str, text: str) -> Markup:
        line = element("line", x1=1, x2=29, y1=6, y2=6, class_=class_)
        if class_ == "deviation":
            line = element("rect", x=1, y=1, width=28, height=10, class_=class_)
        drawing = element("svg", line, viewBox="0 0 30 12", class_="plot key", aria_hidden="true")
        return element("span", drawing, text)

    return element(
        "p",
        key("estimate", "estimated"),
        key("truth", "measured"),
        key("deviation", "± 1 σ of the estimate") if with_deviation else None,
        class_="legend",
    )


def _panel(nm: NDArray[np.float64], item: Spectra) -> Markup:
    lines = []
    fit = None
    true = None if item.true is None else np.array(item.true)
    found = None if item.estimated is None else np.array(item.estimated)
    if found is not None:
        deviation = None if item.stddev is None else np.array(item.stddev)
        lines.append(Curve(found, "estimate", deviation))
    if true is not None:
        lines.append(Curve(true, "truth"))
    if true is not None and found is not None:
        fit = float(goodness_of_fit(found, true))
    if not lines:
        return element("figure", element("figcaption", item.name))
    label = f"{item.name}: " + " and ".join(
        name for name, there in (("estimated", found), ("measured", true)) if there is not None
    )
    unit = _UNITS.get(item.kind, "")
    if item.kind == "skin" and "opacity" in item.name:
        unit = "m⁻¹"
    drawing = curves(nm, lines, f"{label} spectrum", unit=unit)
    said = [element("b", item.name)]
    if fit is not None and np.any(true):
        said.append(element("span", f"GFC {fit:.5f}", class_="aside"))
    return element("figure", element("figcaption", *said), drawing)


def skin_section(proof: Proof) -> Markup | None:
    """Return the section of the skin's parameters."""
    if not proof.skin:
        return None
    heads = [("Parameter", False), ("true", True), ("estimated", True), ("± 1 σ", True)]
    heads += [("difference", True), ("in σ", True)]
    rows, marks = [], []
    for item in proof.skin:
        difference = _difference(item)
        sigmas = None
        if difference is not None and item.stddev:
            sigmas = difference / item.stddev
            marks.append((item.name, sigmas, f"{item.name}: {number(sigmas, 1)} σ"))
        digits = _digits(item)
        rows.append(
            element(
                "tr",
                element("th", item.name, scope="row"),
                number_cell(number(item.true, digits)),
                number_cell(number(item.estimated, digits)),
                number_cell(number(item.stddev, digits)),
                number_cell(number(difference, digits)),
                number_cell(number(sigmas, 1)),
            )
        )
    drawing = None
    if marks:
        inside = sum(abs(sigmas) <= 2.0 for _, sigmas, _ in marks)
        said = f"Estimate less truth in standard deviations; {inside} of {len(marks)} within 2 σ."
        label = "Deviation of each skin parameter from the truth in standard deviations"
        drawing = figure(said, intervals(marks, label))
    both = element("div", table("Estimate against truth", heads, rows), drawing, class_="beside")
    return section("skin", "Skin parameters", both)


def _difference(item: Parameter) -> float | None:
    if item.true is None or item.estimated is None:
        return None
    return item.estimated - item.true


def _digits(item: Parameter) -> int:
    """Return enough digits to see two of the standard deviation."""
    if not item.stddev or item.stddev <= 0.0:
        return 4
    return int(np.clip(1 - np.floor(np.log10(item.stddev)), 2, 6))


def tones_section(proof: Proof) -> Markup | None:
    """Return the section of differences by tone of skin."""
    if not proof.tones:
        return None
    heads: list[tuple[Child, bool]] = [("Tone", False), ("Integrator", False)]
    heads += [*_bar_heads([tone.delta_e for tone in proof.tones]), ("GFC", True)]
    with_chain = any(tone.chain for tone in proof.tones)
    if with_chain:
        heads += [("skin estimated too: mean", True), ("p95", True)]
    top = _top([tone.delta_e for tone in proof.tones])
    rows = [
        element(
            "tr",
            element("th", tone.tone, scope="row"),
            element("td", integrator_title(tone.integrator) if tone.integrator else NONE),
            *_bar_cells(tone.delta_e, top),
            number_cell(NONE if tone.gfc is None else f"{tone.gfc:.5f}"),
            *(
                number_cell(number(None if tone.chain is None else value))
                for value in (
                    (tone.chain or tone.delta_e).mean,
                    (tone.chain or tone.delta_e).p95,
                )
                if with_chain
            ),
        )
        for tone in proof.tones
    ]
    return section("tones", "Tones of skin", table("CIEDE2000 by tone", heads, rows, "spreads"))


def budget_section(proof: Proof) -> Markup | None:
    """Return the section of what each cause of error costs by itself."""
    if not proof.budget:
        return None
    spreads = [cause.delta_e for cause in proof.budget]
    heads: list[tuple[Child, bool]] = [("Cause", False), ("Setting", False), *_bar_heads(spreads)]
    rows = [
        element(
            "tr",
            element("th", cause.cause, scope="row"),
            element("td", cause.setting),
            *_bar_cells(cause.delta_e, _top(spreads)),
        )
        for cause in proof.budget
    ]
    return section(
        "budget",
        "Error budget",
        table("One fault at a time, all else exact", heads, rows, "spreads"),
    )


def patches_section(proof: Proof) -> Markup | None:
    """Return the section of what the chart's patches say, where no truth is known."""
    if not proof.patches:
        return None
    heads: list[tuple[Child, bool]] = [("Light", False), ("Judged", False)]
    spreads = [spread for item in proof.patches for spread in (item.left_out, item.relit) if spread]
    heads += [*_bar_heads(spreads), ("GFC", True)]
    top = _top(spreads)
    rows = [
        element(
            "tr",
            element("th", item.light_class, scope="row"),
            element("td", what),
            *_bar_cells(spread, top),
            number_cell(NONE if gfc is None else f"{gfc:.5f}"),
        )
        for item in proof.patches
        for what, spread, gfc in (
            ("recovered by a calibration without it", item.left_out, item.left_out_gfc),
            ("in the estimated light", item.relit, item.relit_gfc),
        )
        if spread is not None
    ]
    said = " ".join(
        f"GFC of the light of {item.light_class}, estimated against measured: {item.lamp_gfc:.5f}."
        for item in proof.patches
        if item.lamp_gfc is not None
    )
    listed = table("CIEDE2000 of the chart's patches", heads, rows, "spreads")
    return section("patches", "Chart patches", listed, note(said), _patch_list(proof))


def _patch_list(proof: Proof) -> Markup | None:
    rows = [
        element(
            "tr",
            element("th", name, scope="row"),
            element("td", item.light_class),
            number_cell(number(left_out)),
            number_cell(number(relit)),
        )
        for item in proof.patches
        for name, left_out, relit in item.patches
    ]
    if not rows:
        return None
    heads: list[tuple[Child, bool]] = [("Patch", False), ("Light", False)]
    heads += [("calibrated without it", True), ("in the estimated light", True)]
    inner = table("ΔE₀₀ of each patch", heads, rows)
    return element("details", element("summary", f"Every patch ({len(rows)})"), inner)


def _top(spreads: Sequence[Spread]) -> float:
    """Return where bars end: at the largest, unless a few would dwarf all the others."""
    values = [value for spread in spreads for value in (spread.mean, spread.p95) if value]
    if not values:
        return 1.0
    most = 4.0 * float(np.quantile(values, 0.75))
    return min(max(values), most) * 1.01


def _bar_heads(spreads: Sequence[Spread]) -> list[tuple[Child, bool]]:
    top = _top(spreads)
    scale = f"ΔE₀₀, 0 to {number(top / 1.01)}: mean, and line to p95"
    if any(value > top for spread in spreads for value in (spread.mean, spread.p95) if value):
        scale += "; longer ones are cut"
    return [(element("span", scale, class_="scale"), False), ("mean", True), ("p95", True)]


def _bar_cells(spread: Spread, top: float) -> tuple[Markup, ...]:
    return (
        element("td", spread_bar(spread.mean, spread.p95, top), class_="drawn"),
        number_cell(number(spread.mean)),
        number_cell(number(spread.p95)),
    )
