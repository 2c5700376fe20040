"""The quality picture: the panorama as an eye would have it, and everything wrong marked on it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.quality.drawing import (
    Color,
    blend,
    edge_distance,
    hatching,
    label,
    resized,
    stroke,
    write,
)
from usdskin.capture.quality.lamps import Lamp
from usdskin.colorimetry import encode_srgb
from usdskin.latlong import latlong_coordinates, texel_solid_angles
from usdskin.meters import sphere_share, texel_vectors

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

WIDTH, HEIGHT = 2048, 1024
"""Of the panorama in the picture [px]."""

_LEFT, _RIGHT, _TOP = 64, 40, 72
_AXIS, _LEGEND = 44, 184

_PAPER: Color = (21, 23, 26)
_INK: Color = (232, 234, 237)
_FAINT: Color = (150, 155, 162)
_CLIPPED: Color = (255, 48, 40)
_UNSEEN: Color = (255, 64, 220)
_MOVED: Color = (255, 214, 10)
_VIEWS: tuple[Color, ...] = (
    (86, 204, 255),
    (122, 228, 152),
    (140, 160, 255),
    (64, 224, 208),
    (190, 220, 255),
    (170, 240, 90),
)

_KEY = 0.2
_LISTED = 5


@dataclass(frozen=True, slots=True)
class _Masks:
    """What is marked, at the picture's size, from 0 to 1, shape [HEIGHT, WIDTH]."""

    clipped: FloatImage
    unseen: FloatImage
    moved: FloatImage


def quality_picture(
    values: FloatImage,
    clipped: FloatImage,
    seen: FloatImage,
    moved: FloatImage,
    weights: FloatArray,
    *,
    footprints: Mapping[str, NDArray[Any]],
    lamps: Sequence[Lamp] = (),
    title: str,
    subtitle: str = "",
    up_axis: str = "Y",
) -> NDArray[np.uint8]:
    """Return the picture that shows what a capture holds and what it lacks.

    Args:
        values: The panorama, linear, shape [height, width, 3].
        clipped: Share of each texel that was saturated in every exposure, shape [height, width].
        seen: Share of each texel that any view saw, shape [height, width].
        moved: Share of each texel whose exposures contradict each other, shape [height, width].
        weights: Weights of the channels that make a luminance, shape [3].
        footprints: Where each view looks, by its name: masks or shares in latlong of any size.
        lamps: Those that were saturated, the largest first; they are numbered.
        title: Headline, ASCII.
        subtitle: What stands at the right of it, ASCII.
        up_axis: ``Y`` or ``Z``, the stage's, whose axes are marked.

    Returns:
        sRGB pixels, shape [1324, 2152, 3].
    """
    masks = _Masks(
        clipped=resized(clipped, WIDTH, HEIGHT),
        unseen=1.0 - resized(seen, WIDTH, HEIGHT),
        moved=resized(moved, WIDTH, HEIGHT),
    )
    picture = _developed(resized(values, WIDTH, HEIGHT), masks, weights)
    _draw_graticule(picture)
    _draw_masks(picture, masks)
    _draw_footprints(picture, footprints)
    _draw_lamps(picture, lamps)

    sheet = np.empty((_TOP + HEIGHT + _AXIS + _LEGEND, _LEFT + WIDTH + _RIGHT, 3), np.float32)
    sheet[:] = _PAPER
    sheet[_TOP : _TOP + HEIGHT, _LEFT : _LEFT + WIDTH] = picture
    write(sheet, title, (_LEFT, _TOP - 26), 20, _INK, bold=True, most=900)
    write(sheet, subtitle, (_LEFT + WIDTH, _TOP - 26), 13, _FAINT, align=1.0, most=1100)
    _draw_axes(sheet, up_axis)
    _draw_legend(sheet, clipped, seen, moved, lamps)
    return np.rint(np.clip(sheet, 0.0, 255.0)).astype(np.uint8)


# --- The panorama ------------------------------------------------------------------------------


def _developed(values: FloatImage, masks: _Masks, weights: FloatArray) -> FloatImage:
    """Return the panorama as sRGB from 0 to 255: balanced, exposed and with a shoulder.

    White balance makes the mean of what is no lamp grey (grey world; Buchsbaum, "A spatial
    processor model for object colour perception", 1980). The logarithmic mean of luminance comes
    to a key, and luminance L is shown as L (1 + L / W^2) / (1 + L) with W the brightest that is
    to stay below white (Reinhard et al., "Photographic tone reproduction for digital images",
    2002, equation 4).
    """
    luminance = np.maximum(values @ weights.astype(np.float32), 0.0)
    size = np.broadcast_to(texel_solid_angles(*luminance.shape)[:, None], luminance.shape)
    lit = (masks.unseen < 0.5) & (luminance > 0.0)
    if not lit.any():
        return np.zeros_like(values)
    order = np.sort(luminance[lit])
    plain = lit & (luminance <= order[int(0.95 * (order.size - 1))])
    means = (size[plain] @ values[plain].astype(np.float64)) / size[plain].sum()
    gains = np.where(means > 0.0, (means @ weights) / weights.sum() / means, 1.0)
    balanced = np.maximum(values * gains.astype(np.float32), 0.0)

    floor = 1e-4 * order[order.size // 2]
    mean = float(np.exp(size[lit] @ np.log(luminance[lit] + floor) / size[lit].sum()))
    exposure = _KEY / mean
    white = max(exposure * float(order[int(0.999 * (order.size - 1))]), 2.0)
    exposed = balanced * np.float32(exposure)
    grey = exposed @ np.array([0.2126, 0.7152, 0.0722], np.float32)
    shown = grey * (1.0 + grey / white**2) / (1.0 + grey)
    display = exposed * (shown / np.maximum(grey, 1e-9))[..., None]
    # What is brighter than the display can color turns to white, as it does on film.
    over = np.clip(display.max(axis=2) - 1.0, 0.0, 1.0)[..., None]
    display += over * (shown[..., None] - display)
    return np.asarray(255.0 * encode_srgb(np.clip(display, 0.0, 1.0)), dtype=np.float32)


def _draw_graticule(picture: FloatImage) -> None:
    white = (255, 255, 255)
    for step in range(1, 12):
        column = WIDTH * step // 12
        alpha = 0.30 if step % 3 == 0 else 0.13
        blend(picture[:, column : column + 1], np.full((HEIGHT, 1), alpha), white)
    for step in range(1, 6):
        row = HEIGHT * step // 6
        alpha = 0.30 if step == 3 else 0.13
        blend(picture[row : row + 1], np.full((1, WIDTH), alpha), white)


def _draw_masks(picture: FloatImage, masks: _Masks) -> None:
    import cv2

    unseen = np.clip(masks.unseen, 0.0, 1.0)
    lines = hatching(HEIGHT, WIDTH, 11.0, 2.6)
    blend(picture, unseen * (0.14 + 0.6 * lines), _UNSEEN)
    blend(picture, stroke(edge_distance(masks.unseen), 1.6), _UNSEEN)

    # Single flickering pixels are noise to the eye; regions are what to look at.
    moved = np.asarray(cv2.GaussianBlur(masks.moved, (0, 0), 2.0), dtype=np.float32)
    distance = edge_distance(np.where(moved > 0.3, 1.0, 0.0).astype(np.float32))
    blend(picture, 0.16 * (distance < 0.0), _MOVED)
    blend(picture, stroke(distance, 2.4), _MOVED)

    clipped = (masks.clipped > 0.0).astype(np.float32)
    blend(picture, 0.55 * clipped, _CLIPPED)
    blend(picture, stroke(edge_distance(clipped) - 1.5, 2.2), _CLIPPED)


def _draw_footprints(picture: FloatImage, footprints: Mapping[str, NDArray[Any]]) -> None:
    for index, (name, mask) in enumerate(footprints.items()):
        color = _VIEWS[index % len(_VIEWS)]
        share = resized(mask, WIDTH, HEIGHT)
        blend(picture, 0.85 * stroke(edge_distance(share, 3.0), 1.8), color)
        x, y = _middle(share)
        label(picture, name, (x, y), 11, color)


def _middle(share: FloatImage) -> tuple[float, float]:
    """Return where the middle of a region is in the picture [px]."""
    rows, columns = texel_vectors(*share.shape)
    u, v = latlong_coordinates(np.einsum("ij,ik,jk->k", share, rows, columns, optimize=True))
    return float(u) * WIDTH, float(v) * HEIGHT


def _draw_lamps(picture: FloatImage, lamps: Sequence[Lamp]) -> None:
    """Number the largest lamps above their marks, or wherever is room nearby."""
    taken: list[tuple[float, float]] = []
    for number, lamp in enumerate(lamps[:_LISTED], 1):
        u, v = latlong_coordinates(lamp.direction)
        reach = 0.5 * lamp.box[2] * HEIGHT / lamp.shape[0] + 22.0
        x, y = float(u) * WIDTH, float(v) * HEIGHT
        places = [
            (x, y + sign * (reach + 28.0 * step)) for step in range(len(lamps)) for sign in (-1, 1)
        ]
        place = next(
            (x, y)
            for x, y in places
            if 16.0 < y < HEIGHT - 16.0
            and all(abs(x - a) > 30.0 or abs(y - b) > 28.0 for a, b in taken)
        )
        taken.append(place)
        label(picture, str(number), place, 11, (255, 255, 255), (196, 24, 20), 0.95)


# --- Around it ---------------------------------------------------------------------------------


def _draw_axes(sheet: FloatImage, up_axis: str) -> None:
    """Name directions below the panorama and elevations left of it."""
    around = ["-Z", "+X", "+Z", "-X", "-Z"] if up_axis == "Y" else ["+Y", "+X", "-Y", "-X", "+Y"]
    below = _TOP + HEIGHT
    for step, name in enumerate(around):
        x = _LEFT + step * WIDTH // 4
        align = {0: 0.0, 4: 1.0}.get(step, 0.5)
        write(sheet, name, (x, below + 26), 14, _INK, bold=True, align=align)
    for elevation in (60, 30, 0, -30, -60):
        y = _TOP + HEIGHT * (90 - elevation) // 180
        write(
            sheet,
            f"{elevation:+d}" if elevation else "0",
            (_LEFT - 12, y + 6),
            12,
            _FAINT,
            align=1.0,
        )
    for sign, y in (("+", _TOP + 14), ("-", below)):
        write(sheet, f"{sign}{up_axis}", (_LEFT - 12, y), 14, _INK, bold=True, align=1.0)


def _draw_legend(
    sheet: FloatImage,
    clipped: FloatImage,
    seen: FloatImage,
    moved: FloatImage,
    lamps: Sequence[Lamp],
) -> None:
    """Say in words what the marks mean and how much there is of each."""
    top = _TOP + HEIGHT + _AXIS + 10
    held = sum(lamp.flux_share for lamp in lamps)
    light = f"at least {_percent(held)} of the light" if lamps else "none"
    entries = (
        (_CLIPPED, 0.55, "Clipped", "brighter than the shortest exposure can show", light),
        (
            _UNSEEN,
            -1.0,
            "Not seen",
            "by any view, filled in from its surroundings",
            _of_sphere(sphere_share(1.0 - seen)),
        ),
        (_MOVED, 0.16, "Moved", "between the exposures of a view", _of_sphere(sphere_share(moved))),
        (_VIEWS[0], 0.0, "View", "edge of what one view covers", ""),
    )
    for index, (color, fill, name, meaning, amount) in enumerate(entries):
        _draw_entry(sheet, (_LEFT, top + 36 * index), color, fill, (name, meaning, amount))
    _draw_lamp_table(sheet, top, lamps)


def _draw_entry(
    sheet: FloatImage,
    corner: tuple[int, int],
    color: Color,
    fill: float,
    words: tuple[str, str, str],
) -> None:
    x, y = corner
    swatch = sheet[y : y + 22, x : x + 40]
    swatch[:] = (96, 98, 102)
    cover = fill * np.ones((22, 40)) if fill >= 0.0 else 0.14 + 0.6 * hatching(22, 40, 11.0, 2.6)
    blend(swatch, cover, color)
    for edge in (swatch[:2], swatch[-2:], swatch[:, :2], swatch[:, -2:]):
        edge[:] = color
    name, meaning, amount = words
    write(sheet, name, (x + 56, y + 17), 13, _INK, bold=True)
    write(sheet, meaning, (x + 160, y + 17), 13, _FAINT, most=425)
    write(sheet, amount, (x + 600, y + 17), 13, _INK)


def _draw_lamp_table(sheet: FloatImage, top: int, lamps: Sequence[Lamp]) -> None:
    x = _LEFT + WIDTH // 2 + 40
    if not lamps:
        write(sheet, "No lamp was saturated in every exposure.", (x, top + 17), 13, _INK)
    for index, lamp in enumerate(lamps[:_LISTED]):
        y = top + 17 + 30 * index
        elevation = np.rad2deg(np.arcsin(np.clip(lamp.direction[1], -1.0, 1.0)))
        side = "above" if elevation >= 0.0 else "below"
        height = f"{abs(elevation):.0f} deg {side} the horizon"
        place = f"a disc of {_digits(lamp.diameter_deg)} deg, {height}"
        share = f"at least {_percent(lamp.flux_share)} of the light"
        facing = f"{_percent(lamp.irradiance_share)} of what reaches a surface facing it"
        write(sheet, str(index + 1), (x, y), 13, _CLIPPED, bold=True)
        write(sheet, place, (x + 32, y), 13, _INK, most=350)
        write(sheet, f"{share}, {facing}", (x + 400, y), 13, _FAINT, most=WIDTH // 2 - 440)


def _of_sphere(share: float) -> str:
    return f"{_percent(share)} of the sphere" if share > 0.0 else "none"


def _percent(share: float) -> str:
    return "less than 0.01 %" if 0.0 < share < 1e-4 else f"{_digits(100.0 * share)} %"


def _digits(value: float) -> str:
    return f"{value:.2g}" if value < 10.0 else f"{value:.0f}"
