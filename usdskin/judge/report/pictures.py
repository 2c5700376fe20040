"""The renders: a wipe between truth and reproduction, the differences, and a read-out."""

from __future__ import annotations

import json

import numpy as np

from usdskin.judge.report.markup import Markup, element, fragment, json_block
from usdskin.judge.report.pixels import DELTA_STEP, LAB_STEP, NOTHING
from usdskin.judge.report.rasters import heat_colors
from usdskin.judge.report.shown import figure, note, section
from usdskin.judge.report.verdict import integrator_title, picture_title
from usdskin.judge.report.views import RenderViews, View

__all__ = ["pictures_section", "renders_section"]


def pictures_section(renders: RenderViews) -> tuple[Markup | None, Markup | None]:
    """Return the section with wipe, heat map and read-out, and the data that its script reads.

    Args:
        renders: The pictures.
    """
    views = {
        key: view
        for key, view in renders.views.items()
        if "truth" in view.rasters and len(view.rasters) > 1
    }
    if not views:
        return None, None
    first = next(iter(views.values()))
    name = next(name for name in renders.names if name in first.rasters)
    parts = (
        _choices(renders, views, name),
        element("div", _wipe(), _heat(views), class_="compare"),
        _readout(),
        element("noscript", note("Without scripts there is no wipe and no read-out; all renders "
                                 "are below.")),
    )  # fmt: skip
    return section("pictures", "Truth and reproduction", *parts), _data(views, renders, name)


def _wipe() -> Markup:
    return element(
        "figure",
        element(
            "div",
            element("div", class_="divider", aria_hidden="true"),
            element("div", class_="cross", aria_hidden="true"),
            class_="stage",
            id="wipe",
            tabindex=0,
            role="group",
            aria_label="Pictures; arrow keys move the read-out by a pixel, with Shift by ten",
        ),
        element(
            "div",
            element("span", "truth", class_="end-left"),
            element("input", type="range", id="wipe-at", min=0, max=1000, value=500,
                    aria_label="Wipe between truth (left) and reproduction (right)"),
            element("span", "reproduction", class_="end-right"),
            class_="wipe-bar",
        ),
        element("figcaption", "Truth left of the line, reproduction right of it: drag the picture "
                "or the slider. One exposure and one white for both."),
    )  # fmt: skip


def _heat(views: dict[str, View]) -> Markup | None:
    if not any(view.heats for view in views.values()):
        return None
    legends = [heat_legend(index, view, index == 0) for index, view in enumerate(views.values())]
    return element(
        "figure",
        element("div", element("div", class_="cross", aria_hidden="true"), class_="stage",
                id="heat"),
        *legends,
        element("figcaption", "ΔE₀₀ of every judged pixel; grey was not judged."),
    )  # fmt: skip


def _choices(renders: RenderViews, views: dict[str, View], name: str) -> Markup:
    return element(
        "div",
        _choice("reproduction", "Reproduction",
                [(item, picture_title(item)) for item in renders.names], name),
        _choice("integrator", "Integrator",
                [(key, integrator_title(key)) for key in views], next(iter(views))),
        class_="choices",
    )  # fmt: skip


def _choice(group: str, legend: str, options: list[tuple[str, str]], chosen: str) -> Markup:
    items = []
    for index, (value, text) in enumerate(options):
        identifier = f"{group}-{index}"
        button = element("input", type="radio", name=group, id=identifier, value=value,
                         checked=value == chosen)  # fmt: skip
        items.append(fragment(button, element("label", text, for_=identifier)))
    return element("fieldset", element("legend", legend), *items)


def heat_legend(index: int, view: View, is_shown: bool) -> Markup:
    """Return the scale of an integrator's heat maps; the script shows the one that holds."""
    top = view.top
    parts = {3.0: 3, 1.0: 4, 2.0: 4, 20.0: 4, 100.0: 4}.get(top, 5)
    stops = []
    for step, (red, green, blue, _) in enumerate(heat_colors(np.linspace(0.0, 1.0, 17))):
        color = f"#{red:02x}{green:02x}{blue:02x}"
        stops.append(element("stop", offset=f"{step / 16.0:g}", stop_color=color))
    name = f"heat-colors-{index}"
    texts = [
        element("text", ("≥ " if step == parts else "") + f"{top * step / parts:g}",
                x=4.0 + 300.0 * step / parts, y=26,
                class_="middle" if 0 < step < parts else ("end" if step else None))
        for step in range(parts + 1)
    ]  # fmt: skip
    bar = element("rect", x=4, y=2, width=300, height=10, fill=f"url(#{name})")
    gradient = element("defs", element("linearGradient", *stops, id=name))
    drawing = element("svg", gradient, bar, *texts, viewBox="0 0 308 30", role="img",
                      aria_label=f"Scale of the differences, 0 to {top:g}",
                      class_="plot scale")  # fmt: skip
    return element("div", drawing, class_="legend-of" if is_shown else "legend-of away",
                   data_legend=view.integrator)  # fmt: skip


def _readout() -> Markup:
    def cell(identifier: str, text: str = "–") -> Markup:
        return element("td", text, id=identifier, class_="n")

    swatch = element("svg", element("rect", width=30, height=18, id="swatch-truth", fill="none"),
                     element("rect", x=30, width=30, height=18, id="swatch-lab", fill="none"),
                     viewBox="0 0 60 18", class_="swatch", role="img",
                     aria_label="Colours of the truth and the reproduction")  # fmt: skip
    lab = [
        element("tr", element("th", title, scope="row"), *(cell(f"{key}-{axis}") for axis in "Lab"))
        for key, title in (("truth", "truth"), ("lab", "reproduction"), ("change", "difference"))
    ]
    heads = [element("th", text, scope="col", class_="n") for text in ("L*", "a*", "b*")]
    colors = element("table", element("thead", element("tr", element("td"), *heads)),
                     element("tbody", *lab))  # fmt: skip
    return element(
        "div",
        element(
            "div",
            element("p", "Point at a picture", id="where"),
            element("p", element("span", "ΔE₀₀ "), element("output", "–", id="delta"),
                    class_="delta"),
            swatch,
            element("button", "Largest difference", type="button", id="worst"),
        ),
        colors,
        element(
            "figure",
            element("svg", viewBox="0 0 300 142", class_="plot", id="pixel-spectra", role="img",
                    aria_label="Spectra at the pixel"),
            element("figcaption", "", id="spectra-said"),
        ),
        element("p", "", id="said", class_="visually-hidden", aria_live="polite"),
        class_="readout",
        id="readout",
    )  # fmt: skip


def _data(views: dict[str, View], renders: RenderViews, name: str) -> Markup:
    content = {
        "deltaStep": DELTA_STEP,
        "labStep": LAB_STEP,
        "nothing": NOTHING,
        "first": name,
        "views": {
            key: {
                "width": view.rasters["truth"].width,
                "height": view.rasters["truth"].height,
                **view.data,
                "pictures": view.data.get("pictures", {}),
                "titles": {item: picture_title(item) for item in view.rasters},
            }
            for key, view in views.items()
        },
    }
    return json_block("pixels", json.dumps(content, sort_keys=True, separators=(",", ":")))


def renders_section(renders: RenderViews) -> Markup | None:
    """Return the section that shows every render and every heat map; scripts copy them.

    Args:
        renders: The pictures.
    """
    rows = []
    for view in renders.views.values():
        how = integrator_title(view.integrator)
        order = [name for name in ("truth", *renders.names) if name in view.rasters]
        shown = [
            figure(
                picture_title(name).capitalize(),
                view.rasters[name].image(
                    f"Render: {picture_title(name)}, {how}",
                    data_render=name, data_integrator=view.integrator,
                ),
            )
            for name in order
        ]  # fmt: skip
        shown += [
            figure(
                f"ΔE₀₀, 0 to {view.top:g}: {picture_title(name)}",
                view.heats[name].image(
                    f"Colour difference: {picture_title(name)}, {how}",
                    data_heat=name, data_integrator=view.integrator, class_="heat",
                ),
            )
            for name in renders.names
            if name in view.heats
        ]  # fmt: skip
        rows.append(element("h3", how.capitalize()))
        rows.append(element("div", *shown, class_="renders"))
    return section("renders", "Renders", *rows) if rows else None
