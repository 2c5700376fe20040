"""The renders read, developed alike, and packed for the read-out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import chromaticity_to_xyz
from usdskin.errors import ImageError, UsdSkinError
from usdskin.judge.report.pixels import (
    LAB_STEP,
    Maps,
    bounding_box,
    lab_of_beauty,
    labs_agree,
    pack,
    pack_spectra,
    quantized,
    quantized_delta,
    read_maps,
)
from usdskin.judge.report.proof import Proof
from usdskin.judge.report.rasters import Raster, beauty_pixels, embed, heat_colors
from usdskin.judge.report.records import Comparison
from usdskin.notes import Note

__all__ = ["RenderViews", "View", "read_views"]


@dataclass(slots=True)
class View:
    """One integrator's pictures and what is known of their pixels."""

    integrator: str
    rasters: dict[str, Raster] = field(default_factory=dict)
    """By name: truth, light, chain."""

    heats: dict[str, Raster] = field(default_factory=dict)
    """By name of the reproduction."""

    top: float = 1.0
    """Difference at which the colours of the heat maps end."""

    data: dict[str, Any] = field(default_factory=dict)
    """For the script."""


@dataclass(slots=True)
class RenderViews:
    """All renders, by integrator."""

    views: dict[str, View]

    @property
    def names(self) -> list[str]:
        """Names of the reproductions, in order."""
        found = {name for view in self.views.values() for name in view.rasters if name != "truth"}
        order = {"light": 0, "chain": 1}
        return sorted(found, key=lambda name: (order.get(name, 2), name))


def read_views(proof: Proof, scratch: Path, notes: list[Note]) -> RenderViews:
    """Read, develop and pack all renders of a proof.

    Args:
        proof: Names them.
        scratch: Folder for files of a moment.
        notes: Takes what cannot be shown.
    """
    maps = {item.key: read_maps(proof.file(item.maps)) for item in proof.comparisons if item.maps}
    views = {}
    integrators = dict.fromkeys(
        [item.integrator for item in proof.comparisons]
        + [picture.integrator for picture in proof.pictures]
    )
    for integrator in integrators:
        view = View(integrator)
        _develop(view, proof, scratch)
        chosen = [item for item in proof.comparisons if item.integrator == integrator]
        of_view = {item.name: maps[item.key] for item in chosen if item.key in maps}
        view.top = _heat_top(of_view)
        for name, found in of_view.items():
            view.heats[name] = embed(heat_colors(found.delta_e / view.top), scratch)
        if of_view:
            view.data = _pixel_data(proof, chosen, of_view, notes)
        views[integrator] = view
    return RenderViews(views)


def _heat_top(maps: Mapping[str, Maps]) -> float:
    """Return a round number that nearly all differences lie below."""
    found = [item.delta_e[np.isfinite(item.delta_e)] for item in maps.values()]
    found = [values for values in found if values.size]
    high = max((float(np.quantile(values, 0.99)) for values in found), default=1.0)
    return next((top for top in (0.5, 1.0, 2.0, 3.0, 5.0, 10.0, 20.0, 50.0) if high <= top), 100.0)


def _develop(view: View, proof: Proof, scratch: Path) -> None:
    """Develop the pictures of one integrator by the exposure and white of its truth."""
    from usdskin.render.preview import develop

    files = {
        picture.name: picture.beauty
        for picture in proof.pictures
        if picture.integrator == view.integrator
    }
    white = next(
        (
            chromaticity_to_xyz(item.white)
            for item in proof.comparisons
            if item.integrator == view.integrator and item.white is not None
        ),
        None,
    )
    stops: float | None = None
    for name in sorted(files, key=lambda name: (name != "truth", name)):
        rgba, space, _ = beauty_pixels(proof.file(files[name]))
        values, record = develop(
            rgba,
            color_space=space,
            ev="auto" if stops is None else stops,
            white="none" if white is None else "scene",
            scene_white_xyz=white,
        )
        stops = float(record["usdskin/ev"])
        view.rasters[name] = embed(values, scratch)


def _pixel_data(
    proof: Proof, comparisons: list[Comparison], maps: dict[str, Maps], notes: list[Note]
) -> dict[str, Any]:
    shapes = {item.delta_e.shape for item in maps.values()}
    if len(shapes) != 1:
        raise ImageError(
            f"{proof.folder}: the difference maps of {comparisons[0].integrator} differ in size; "
            "prove again."
        )
    inside: NDArray[np.bool_] = np.zeros(shapes.pop(), bool)
    for found in maps.values():
        inside |= np.isfinite(found.delta_e)
    box = bounding_box(inside)
    labs: dict[str, str] = {}
    rows = {}
    for item in comparisons:
        if item.name not in maps:
            continue
        delta = maps[item.name].delta_e
        row: dict[str, Any] = {"delta": pack(quantized_delta(delta[box.slices])[np.newaxis])}
        if np.isfinite(delta).any():
            worst = np.unravel_index(int(np.nanargmax(delta)), delta.shape)
            row["worst"] = [int(worst[1]), int(worst[0])]
        colors = _colors(proof, item, maps[item.name], notes)
        if colors is not None:
            for key, lab in zip(("truth", "lab"), colors, strict=True):
                cut = np.moveaxis(quantized(lab[box.slices], LAB_STEP), -1, 0)
                text = pack(cut * inside[box.slices])
                row[key] = labs.setdefault(text, f"p{len(labs)}")
        rows[item.name] = row
    spectra = _spectra(proof, comparisons[0].integrator, inside, notes)
    return {
        "width": inside.shape[1],
        "height": inside.shape[0],
        "box": box.as_json(),
        "planes": {name: text for text, name in labs.items()},
        "pictures": rows,
        "spectra": spectra,
    }


def _colors(
    proof: Proof, item: Comparison, maps: Maps, notes: list[Note]
) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
    truth = lab_of_beauty(proof.file(item.truth), item)
    picture = lab_of_beauty(proof.file(item.picture), item)
    if truth is None or picture is None:
        return None
    if truth.shape != picture.shape or truth.shape[:2] != maps.delta_e.shape:
        raise ImageError(
            f"{proof.folder / item.picture}: differs in size from its truth or its maps; "
            "prove again."
        )
    if not labs_agree(truth, picture, maps):
        message = "its colours are not those of the difference maps; the read-out leaves them out"
        notes.append(Note("colors-not-shown", item.picture, message))
        return None
    return truth, picture


def _spectra(
    proof: Proof, integrator: str, inside: NDArray[np.bool_], notes: list[Note]
) -> dict[str, Any] | None:
    files = {
        picture.name: proof.file(picture.spectral)
        for picture in proof.pictures
        if picture.integrator == integrator and picture.spectral is not None
    }
    if "truth" not in files:
        return None
    try:
        return pack_spectra(files, inside, bounding_box(inside))
    except UsdSkinError as error:
        notes.append(Note("spectra-not-shown", integrator, str(error)))
        return None
