"""The light: panoramas and reflectance maps, true and estimated, developed alike."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import delta_e_2000, rgb_to_xyz, xyz_to_lab
from usdskin.errors import UsdSkinError
from usdskin.images import read_image
from usdskin.judge.report.markup import Markup, element, fragment
from usdskin.judge.report.proof import Proof
from usdskin.judge.report.rasters import embed, heat_colors, shrunk
from usdskin.judge.report.shown import figure, note, number, section
from usdskin.layers import open_stage
from usdskin.notes import Note
from usdskin.progress import SilentProgress

__all__ = ["LightPictures", "light_section", "read_light_pictures"]

FloatArray = NDArray[np.float32]

PANORAMA_WIDTH = 768
"""Panoramas are embedded no wider [px]."""

MAP_WIDTH = 192
"""Width of the reflectance maps [px]."""

_ROOM, _ROOM_LEVEL = 0.9, 0.6
"""Share of the sphere that is not lamps or sky, and how bright its brightest part is shown [1]."""

_LAYERS = (("truthLight", "true"), ("light", "estimated"))


@dataclass(frozen=True, slots=True, eq=False)
class LightPictures:
    """A light as it is shown."""

    which: str
    """``true`` or ``estimated``."""

    panorama: FloatArray | None
    """The dome's RGB rendition, shape [height, width, 3]."""

    panorama_space: str
    map: FloatArray | None
    """The reflectance map, shape [height, width, 3]."""

    map_space: str


def read_light_pictures(proof: Proof, scratch: Path, notes: list[Note]) -> list[LightPictures]:
    """Return what is to be shown of the true and the estimated light.

    Args:
        proof: Names the layers.
        scratch: Folder for files of a moment.
        notes: Takes what cannot be shown.
    """
    found = []
    for layer, which in _LAYERS:
        if layer not in proof.layers:
            continue
        path = proof.file(proof.layers[layer])
        panorama, space = _panorama(path, notes)
        shaded, map_space = _reflectance_map(path, scratch / f"{which}.exr", notes)
        found.append(LightPictures(which, panorama, space, shaded, map_space))
    return found


def _panorama(path: Path, notes: list[Note]) -> tuple[FloatArray | None, str]:
    from pxr import UsdLux

    stage = open_stage(path, notes)
    for prim in stage.Traverse():
        if not prim.IsA(UsdLux.DomeLight):
            continue
        asset = UsdLux.DomeLight(prim).GetTextureFileAttr().Get()
        if asset is None or not asset.resolvedPath:
            continue
        try:
            image = read_image(asset.resolvedPath, channels=("R", "G", "B"))
        except UsdSkinError as error:
            notes.append(Note("panorama-not-shown", str(path), str(error)))
            return None, ""
        pixels = np.nan_to_num(shrunk(image.pixels, PANORAMA_WIDTH))
        return np.maximum(pixels, 0.0), image.color_space or "lin_rec709_scene"
    return None, ""


def _reflectance_map(path: Path, output: Path, notes: list[Note]) -> tuple[FloatArray | None, str]:
    from usdskin.render.map import write_map
    from usdskin.render.overrides import MapOverrides

    try:
        write_map(path, output, MapOverrides(width=MAP_WIDTH), SilentProgress())
    except UsdSkinError as error:
        notes.append(Note("map-not-shown", str(path), str(error)))
        return None, ""
    image = read_image(output, channels=("R", "G", "B"))
    return image.pixels, image.color_space or "lin_rec709_scene"


def light_section(pictures: list[LightPictures], scratch: Path) -> Markup | None:
    """Return the section with the light's pictures.

    Args:
        pictures: Of the true light, the estimated, or both.
        scratch: Folder for files of a moment.
    """
    panoramas = [
        (item.which, item.panorama, item.panorama_space)
        for item in pictures
        if item.panorama is not None
    ]
    maps = [(item.which, item.map, item.map_space) for item in pictures if item.map is not None]
    if not panoramas and not maps:
        return None
    parts = []
    if panoramas:
        parts.append(element("h3", "Panorama"))
        stops = _stops(panoramas[0][1])
        alt = "Panorama of the {} light, all directions of the place"
        shown = _alike(panoramas, scratch, alt, stops)
        parts.append(element("div", *shown, class_="pair wide"))
        parts.append(
            note(
                "Latitude and longitude in the stage's axes: up is +Y, the middle is +Z. Both by "
                "one exposure, adapted to the true light's white; lamps clip."
                if len(panoramas) > 1
                else "Latitude and longitude in the stage's axes: up is +Y, the middle is +Z."
            )
        )
    if maps:
        parts.append(element("h3", "Reflectance map"))
        alt = "Reflectance map of the {} light by the surface's normal"
        shown = _alike(maps, scratch, alt, None)
        difference = _map_difference(maps, scratch)
        parts.append(element("div", *shown, difference, class_="pair"))
        parts.append(
            note(
                "The radiance of a white surface (wrap 0.3) over the direction of its normal: the "
                "paper's I(λ, θ, φ) without the skin."
            )
        )
    return section("light", "Light", fragment(*parts))


def _stops(panorama: FloatArray) -> float:
    """Return the exposure that shows a room rather than its lamps [stops]."""
    rows = np.cos(np.pi * ((np.arange(panorama.shape[0]) + 0.5) / panorama.shape[0] - 0.5))
    weight = np.repeat(rows, panorama.shape[1])
    brightest = panorama.max(axis=2).ravel().astype(np.float64)
    order = np.argsort(brightest, kind="stable")
    counted = np.cumsum(weight[order])
    place = min(int(np.searchsorted(counted, _ROOM * counted[-1])), order.size - 1)
    level = float(brightest[order[place]])
    return float(np.log2(_ROOM_LEVEL / level)) if level > 0.0 else 0.0


def _alike(
    pictures: list[tuple[str, FloatArray, str]], scratch: Path, alt: str, stops: float | None
) -> list[Markup]:
    """Develop pictures by one exposure, the first's own by default, and the white of the first."""
    from usdskin.render.preview import develop

    white = None
    shown = []
    for which, pixels, space in pictures:
        xyz = pixels.reshape(-1, 3).astype(np.float64) @ rgb_to_xyz(space).T
        white = xyz.mean(axis=0) if white is None else white
        opaque = np.ones((*pixels.shape[:2], 1), np.float32)
        values, record = develop(
            np.concatenate([pixels, opaque], axis=2),
            color_space=space,
            ev="auto" if stops is None else stops,
            white="scene",
            scene_white_xyz=white,
        )
        stops = float(record["usdskin/ev"])
        raster = embed(values, scratch)
        shown.append(figure(which.capitalize(), raster.image(alt.format(which))))
    return shown


def _map_difference(maps: list[tuple[str, FloatArray, str]], scratch: Path) -> Markup | None:
    if len(maps) < 2:
        return None
    (_, true, space), (_, found, other) = maps[:2]
    if true.shape != found.shape:
        return None
    first = true.astype(np.float64) @ rgb_to_xyz(space).T
    second = found.astype(np.float64) @ rgb_to_xyz(other).T
    white = first.reshape(-1, 3)[first[..., 1].argmax()]
    if not (white > 0.0).all():
        return None
    delta = delta_e_2000(xyz_to_lab(second, white), xyz_to_lab(first, white))
    rows = np.cos(np.pi * ((np.arange(delta.shape[0]) + 0.5) / delta.shape[0] - 0.5))
    mean = float((delta.mean(axis=1) * rows).sum() / rows.sum())
    top = max(float(delta.max()), 1e-9)
    raster = embed(heat_colors(delta / top), scratch)
    said = f"ΔE₀₀ of the two: mean {number(mean)}, max {number(top)} (palest colour)"
    return figure(said, raster.image("Colour difference of the two reflectance maps"))
