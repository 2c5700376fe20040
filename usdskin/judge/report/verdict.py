"""The head of the report: what was proved, the differences, the bars."""

from __future__ import annotations

from usdskin.judge.report.markup import Markup, element, fragment
from usdskin.judge.report.proof import Proof
from usdskin.judge.report.records import Bar, Comparison
from usdskin.judge.report.shown import NONE, note, number, number_cell, percent, section, table

__all__ = ["comparison_title", "headline", "verdict_section"]

_NAMES = {
    "truth": "true light, true skin",
    "light": "estimated light, true skin",
    "chain": "estimated light, estimated skin",
}
_INTEGRATORS = {"map": "reflectance map", "traced": "traced, with shadows"}


def picture_title(name: str) -> str:
    """Return what a picture shows."""
    return _NAMES.get(name, name)


def integrator_title(name: str) -> str:
    """Return how light was gathered."""
    return _INTEGRATORS.get(name, name)


def comparison_title(comparison: Comparison) -> str:
    """Return what was compared."""
    return f"{picture_title(comparison.name)} · {integrator_title(comparison.integrator)}"


def headline(proof: Proof) -> tuple[str, str]:
    """Return the verdict in words, and its class: ``met``, ``missed`` or ``open``."""
    if not proof.bars and proof.patches and not proof.comparisons:
        return "Judged by the chart's patches; the truth is not known", "open"
    if not proof.bars:
        return "No bars were set for this proof", "open"
    missed = sum(not bar.met for bar in proof.bars)
    count = len(proof.bars)
    if missed == 0:
        return ("The bar is met" if count == 1 else f"All {count} bars met"), "met"
    if missed == count:
        return ("The bar is missed" if count == 1 else f"All {count} bars missed"), "missed"
    return f"{count - missed} of {count} bars met, {missed} missed", "missed"


def verdict_section(proof: Proof) -> Markup:
    """Return the section with the verdict."""
    return section(
        "verdict",
        "What was proved",
        _claim(proof),
        _tiles(proof),
        _bars(proof),
        _differences(proof),
    )


def _claim(proof: Proof) -> Markup:
    names = {item.name for item in proof.comparisons}
    if not names and proof.patches:
        said = "No picture was compared with a truth: that of a real shoot is not known. What was "
        said += "measured are the patches of its charts, and this is how far off they come out."
        return element("p", said, class_="claim")
    if not names:
        return element("p", "No picture was compared with a truth.", class_="claim")
    said = "The same picture was rendered from the true light and skin, the truth, and again "
    ways = {
        "light": "from the light as it was estimated from photographs",
        "chain": "from light and skin both estimated",
    }
    said += " and ".join(text for name, text in ways.items() if name in names)
    return element("p", f"{said}. This is how far the colours are apart.", class_="claim")


def _tiles(proof: Proof) -> Markup | None:
    """Return the mean differences in large figures."""
    rows = [
        (item.delta_e, picture_title(item.name), integrator_title(item.integrator))
        for item in proof.comparisons
    ]
    if not rows:
        for item in proof.patches:
            where = f"in the light of {item.light_class}"
            if item.left_out is not None:
                rows.append((item.left_out, "patches not calibrated with", where))
            if item.relit is not None:
                rows.append((item.relit, "patches in the estimated light", where))
    tiles = [
        element(
            "div",
            element("p", number(delta_e.mean), class_="large"),
            element("p", "mean ΔE₀₀, p95 ", number(delta_e.p95)),
            element("p", element("b", title)),
            element("p", how),
            class_="tile",
        )
        for delta_e, title, how in rows
    ]
    return element("div", *tiles, class_="tiles") if tiles else None


def _differences(proof: Proof) -> Markup | None:
    if not proof.comparisons:
        return None
    heads = [
        ("Picture", False),
        ("Integrator", False),
        ("mean", True),
        ("median", True),
        ("p95", True),
        ("max", True),
        ("ΔE*ab mean", True),
        ("ΔL* mean", True),
        ("Δa* mean", True),
        ("Δb* mean", True),
        ("FLIP mean", True),
        ("GFC mean", True),
        ("RMSE", True),
    ]
    if any(item.noise for item in proof.comparisons):
        heads.append(("noise alone", True))
    rows = [_difference_row(item, len(heads) > 13) for item in proof.comparisons]
    first = proof.comparisons[0]
    return fragment(
        table("CIEDE2000 against the truth, and more", heads, rows),
        _regions(proof),
        note(*_conditions(first, proof)),
    )


def _difference_row(item: Comparison, with_noise: bool) -> Markup:
    spreads, delta = item.spreads, item.delta_e
    gfc, rmse = item.spectral.get("gfc"), item.spectral.get("rmse")
    return element(
        "tr",
        element("th", picture_title(item.name), scope="row"),
        element("td", integrator_title(item.integrator)),
        number_cell(number(delta.mean), data_value=_exact(delta.mean)),
        number_cell(number(delta.median)),
        number_cell(number(delta.p95), data_value=_exact(delta.p95)),
        number_cell(number(delta.max)),
        number_cell(number(spreads["deltaE76"].mean)),
        *(number_cell(number(spreads[name].mean)) for name in ("deltaL", "deltaA", "deltaB")),
        number_cell(number(spreads["flip"].mean, 4)),
        number_cell(NONE if gfc is None else f"{gfc:.5f}"),
        number_cell(percent(rmse)),
        number_cell(number(None if item.noise is None else item.noise.mean))
        if with_noise
        else None,
    )


def _exact(value: float | None) -> str | None:
    return None if value is None else repr(value)


def _conditions(first: Comparison, proof: Proof) -> list[str]:
    said = []
    if first.observer:
        said.append(f"Observer {first.observer}. ")
    if first.y_n is not None:
        said.append(f"Yₙ = {first.y_n:.5g}")
        if first.white is not None:
            said.append(f", white x, y = {first.white[0]:.4f}, {first.white[1]:.4f}")
        said.append(f" ({first.white_from}). " if first.white_from else ". ")
    if first.mask_from:
        pixels = NONE if first.mask_pixels is None else f"{first.mask_pixels:,}"
        pixels = pixels.replace(",", "\u202f")
        share = percent(first.mask_share, 1)
        said.append(f"Mask: {first.mask_from}, {pixels} pixels, {share} of the picture. ")
    alike = {(item.y_n, item.white, item.mask_from, item.mask_pixels) for item in proof.comparisons}
    if len(alike) > 1:
        said.append("This is the first comparison's; report.json has those of the others. ")
    said.append("p95: 95 % of the judged pixels differ by less. ")
    if any(item.noise for item in proof.comparisons):
        said.append("Noise alone: the mean ΔE₀₀ of the truth and itself, sampled anew.")
    return said


def _regions(proof: Proof) -> Markup | None:
    rows = [
        element(
            "tr",
            element("th", region.name, scope="row", class_="path"),
            element("td", comparison_title(item)),
            number_cell(f"{region.pixels:,}".replace(",", "\u202f")),
            *(
                number_cell(number(value))
                for value in (
                    region.delta_e.mean,
                    region.delta_e.median,
                    region.delta_e.p95,
                    region.delta_e.max,
                )
            ),
        )
        for item in proof.comparisons
        for region in item.regions
    ]
    if not rows:
        return None
    heads = [("Region", False), ("Picture", False), ("pixels", True)]
    heads += [(name, True) for name in ("mean", "median", "p95", "max")]
    inner = table("CIEDE2000 by region", heads, rows)
    return element("details", element("summary", f"By region ({len(rows)})"), inner)


def _bars(proof: Proof) -> Markup | None:
    if not proof.bars:
        return None
    heads = [("Bar", False), ("found", True), ("at most", True), ("", False)]
    rows = [
        element(
            "tr",
            element("th", bar_title(bar), scope="row"),
            number_cell(number(bar.value, 3)),
            number_cell(number(bar.bar)),
            element("td", badge(bar.met)),
        )
        for bar in proof.bars
    ]
    return table("Bars", heads, rows, "bars")


def bar_title(bar: Bar) -> str:
    """Return a bar's name as it is shown: ``light, map: dE2000 mean`` in words."""
    text = bar.name.replace("dE2000", "ΔE₀₀")
    name, comma, rest = text.partition(", ")
    integrator, colon, what = rest.partition(": ")
    if comma and colon and name in _NAMES and integrator in _INTEGRATORS:
        return f"{what}: {_NAMES[name]} · {_INTEGRATORS[integrator]}"
    return text


def badge(met: bool) -> Markup:
    """Return whether a bar is met, told by word, sign and colour."""
    return element("span", "✓ met" if met else "✗ missed", class_="met" if met else "missed")
