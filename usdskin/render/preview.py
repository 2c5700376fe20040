"""A linear picture as a PNG for the eye: white, exposure and display view, all recorded in it.

The display transform is OpenColorIO's, from built-in configs pinned by name, so that a picture
looks the same on every machine. The default view, ``Un-tone-mapped``, is plain colorimetry: the
picture's XYZ as an sRGB display shows them (IEC 61966-2-1), which neither moves hue and
saturation nor bends contrast, so what is compared by eye is what was measured. The ACES renderings
do both, on purpose; they are there by name. What is too bright for the display is clipped, which
is why automatic exposure keeps 99 % of the picture below it.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import PyOpenColorIO
from numpy.typing import ArrayLike, NDArray

from usdskin import __version__
from usdskin.colorimetry import (
    DEFAULT_OBSERVER,
    Observer,
    cat16,
    color_matching_functions,
    illuminant,
    rgb_to_xyz,
    white_xyz,
    xyz_to_rgb,
)
from usdskin.errors import UsageError, UsdSkinError
from usdskin.images import HALF_MAX, write_png
from usdskin.notes import Note

DISPLAY = "sRGB - Display"
DEFAULT_VIEW = "Un-tone-mapped"
VIEWS = {
    DEFAULT_VIEW: "cg-config-v2.2.0_aces-v1.3_ocio-v2.4",
    "ACES 1.0 - SDR Video": "cg-config-v2.2.0_aces-v1.3_ocio-v2.4",
    "ACES 2.0 - SDR 100 nits (Rec.709)": "cg-config-v4.0.0_aces-v2.0_ocio-v2.5",
    "Raw": "cg-config-v2.2.0_aces-v1.3_ocio-v2.4",
}
"""Views and the built-in config each is pinned to."""

AUTO_QUANTILE = 0.99
"""Share of the picture, weighted by alpha, that automatic exposure keeps below ``AUTO_LEVEL``."""

AUTO_LEVEL = 0.9
"""Display-linear value of the brightest component at that quantile; 1 is the display's white."""

_WORKING_SPACE = "lin_rec709_scene"  # the name is an alias in the pinned configs
_WHITE_GRID_NM = np.arange(360.0, 831.0, 5.0)  # the range of the CIE observers

FloatImage = NDArray[np.float32]


def render_png(
    path: str | Path,
    rgba: FloatImage,
    *,
    color_space: str = _WORKING_SPACE,
    ev: float | Literal["auto"] = "auto",
    white: str = "scene",
    scene_white_xyz: ArrayLike | None = None,
    view: str | None = None,
    observer: Observer = DEFAULT_OBSERVER,
    metadata: Mapping[str, Any] | None = None,
    notes: list[Note] | None = None,
) -> float:
    """Write a picture as an 8-bit sRGB PNG, with alpha where any pixel is not opaque.

    Args:
        path: File to write.
        rgba: Linear scene values and alpha, premultiplied, shape [height, width, 4].
        color_space: USD's name of the linear space of ``rgba``, XYZ included.
        ev: Exposure [stops]; ``auto`` for ``auto_ev``.
        white: What becomes the display's white by CAT16: ``none``, ``scene`` or an illuminant.
        scene_white_xyz: White of the scene for ``scene``, any scale, shape [3].
        view: One of ``VIEWS``; ``DEFAULT_VIEW`` where ``None``.
        observer: Observer of ``rgba``, for an illuminant's white.
        metadata: Further text, by keyword.
        notes: Takes a note where the scene's light is too dark or colored to be a white.

    Returns:
        The exposure used [stops], so that a sequence can keep that of its first frame.

    Raises:
        UsageError: An unknown view or white.
        ImageError: The file cannot be written.
    """
    pixels, record = develop(
        rgba,
        color_space=color_space,
        ev=ev,
        white=white,
        scene_white_xyz=scene_white_xyz,
        view=view,
        observer=observer,
        notes=notes,
        path=str(path),
    )
    text = {"Software": f"usdskin {__version__}"}
    text |= {name: str(value) for name, value in (metadata or {}).items()}
    write_png(path, pixels, text | record)
    return float(record["usdskin/ev"])


def develop(
    rgba: FloatImage,
    *,
    color_space: str = _WORKING_SPACE,
    ev: float | Literal["auto"] = "auto",
    white: str = "scene",
    scene_white_xyz: ArrayLike | None = None,
    view: str | None = None,
    observer: Observer = DEFAULT_OBSERVER,
    notes: list[Note] | None = None,
    path: str = "",
) -> tuple[NDArray[np.uint8], dict[str, str]]:
    """Return a picture as display values, and how they were made.

    Args:
        rgba: As for ``render_png``, as are all the others.
        color_space: Linear space of ``rgba``.
        ev: Exposure [stops] or ``auto``.
        white: ``none``, ``scene`` or an illuminant.
        scene_white_xyz: White of the scene, shape [3].
        view: One of ``VIEWS``.
        observer: Observer of ``rgba``.
        notes: Takes what could not be done.
        path: File the notes speak of.

    Returns:
        Display values, alpha not premultiplied, shape [height, width, 3], or [..., 4] where a
        pixel is not opaque; and the record of white, exposure and view.
    """
    view = DEFAULT_VIEW if view is None else view
    source, said_white = _white(white, scene_white_xyz, observer, path, notes)
    matrix = rgb_to_xyz(color_space)
    if source is not None:
        matrix = cat16(source, white_xyz(_WORKING_SPACE)) @ matrix
    matrix = xyz_to_rgb(_WORKING_SPACE) @ matrix

    linear, alpha, stops = _exposed(rgba, matrix.T.astype(np.float32), ev)
    shown = linear.reshape(-1, 3)
    _processor(view).applyRGB(shown)
    values = np.rint(np.clip(shown, 0.0, 1.0) * 255.0).astype(np.uint8).reshape(linear.shape)
    if alpha.min(initial=1.0) < 1.0:
        opacity = np.rint(alpha * 255.0).astype(np.uint8)
        values[opacity == 0] = 0
        values = np.concatenate([values, opacity[..., np.newaxis]], axis=2)
    record = {
        "usdskin/ev": repr(stops),
        "usdskin/evMode": "auto" if ev == "auto" else "fixed",
        "usdskin/white": said_white,
        "usdskin/ocioConfig": VIEWS[view],
        "usdskin/ocioDisplay": DISPLAY,
        "usdskin/ocioView": view,
        "usdskin/colorSpace": color_space,
    }
    return values, record


def _exposed(
    rgba: FloatImage, to_working: FloatImage, ev: float | Literal["auto"]
) -> tuple[FloatImage, FloatImage, float]:
    """Return exposed values without premultiplication, alpha, and the exposure [stops].

    A pixel that is not finite becomes white where it is infinite, else black, and does not count
    for the exposure.
    """
    alpha = np.clip(np.nan_to_num(rgba[..., 3]), 0.0, 1.0)
    visible = alpha > 0.0
    straight = rgba[..., :3][visible] / alpha[visible, np.newaxis]
    wrong = ~np.isfinite(straight).all(axis=1)
    wrong_values = np.where(np.isposinf(straight[wrong]).any(axis=1), HALF_MAX, 0.0)
    straight[wrong] = 0.0
    linear = np.zeros((*alpha.shape, 3), np.float32)
    linear[visible] = straight @ to_working
    counted = alpha.copy()
    counted[visible] *= ~wrong
    stops = auto_ev(linear, counted) if ev == "auto" else float(ev)
    with np.errstate(over="ignore"):
        linear *= np.float32(2.0) ** np.float32(stops)
    np.clip(linear, -HALF_MAX, HALF_MAX, out=linear)
    rows, columns = np.nonzero(visible)
    linear[rows[wrong], columns[wrong]] = wrong_values[:, np.newaxis]
    return linear, alpha, stops


def check_display(white: str, view: str | None = None) -> None:
    """Check the choice of white and view, so that a render need not end before it is refused.

    Raises:
        UsageError: An unknown view or white.
    """
    _processor(DEFAULT_VIEW if view is None else view)
    if white != "scene":
        _white(white, None, DEFAULT_OBSERVER, "", None)


def auto_ev(linear: FloatImage, alpha: FloatImage) -> float:
    """Return the exposure that puts a picture's highlights just below the display's white.

    The brightest of R, G, B of each pixel is taken, so that no channel clips before the others and
    turns the hue; their quantile ``AUTO_QUANTILE``, each pixel counting by its alpha, becomes
    ``AUTO_LEVEL``. Glints and small lamps beyond it do not count.

    Args:
        linear: Display-linear R, G, B, not premultiplied, shape [height, width, 3].
        alpha: Coverage [1], shape [height, width].

    Returns:
        Exposure [stops]; 0 for a picture without light.
    """
    brightest = np.maximum(np.maximum(linear[..., 0], linear[..., 1]), linear[..., 2]).ravel()
    weight = np.where(np.isfinite(brightest), alpha.ravel(), np.float32(0.0))
    # Sixteenths of a stop first: only the values around the quantile need sorting.
    tiny = np.finfo(np.float32).tiny
    steps = np.log2(np.clip(np.nan_to_num(brightest), tiny, None)) - np.log2(tiny)
    steps = (16.0 * steps).astype(np.int32)
    counted = np.cumsum(np.bincount(steps, weight))
    if counted.size == 0 or counted[-1] <= 0.0:
        return 0.0
    target = AUTO_QUANTILE * counted[-1]
    step = int(np.searchsorted(counted, target))
    inside = np.flatnonzero(steps == step)
    order = inside[np.argsort(brightest[inside], kind="stable")]
    below = counted[step - 1] if step else 0.0
    reached = below + np.cumsum(weight[order], dtype=np.float64)
    level = float(brightest[order[min(np.searchsorted(reached, target), order.size - 1)]])
    if level <= 0.0:
        return 0.0
    # A thousandth of a stop is invisible, and a short number is easier to give back.
    return round(math.log2(AUTO_LEVEL / level), 3)


def _white(
    white: str,
    scene_white_xyz: ArrayLike | None,
    observer: Observer,
    path: str,
    notes: list[Note] | None,
) -> tuple[NDArray[np.float64] | None, str]:
    """Return the XYZ adapted from, None where nothing is adapted, and how to call it."""
    if white == "none":
        return None, "none"
    if white == "scene":
        xyz = np.zeros(3) if scene_white_xyz is None else np.asarray(scene_white_xyz, np.float64)
        try:
            xyz = xyz / max(float(xyz[1]), np.finfo(np.float64).tiny)
            cat16(xyz, white_xyz(_WORKING_SPACE))
        except UsdSkinError:
            if notes is not None:
                message = "the scene's light is too dark or colored to be a white; not adapted."
                notes.append(Note("white-not-adapted", path, message))
            return None, "none (the scene's light is no white)"
        return xyz, f"scene ({', '.join(f'{value:.6g}' for value in xyz)})"
    try:
        spectrum = illuminant(white, _WHITE_GRID_NM)
    except UsdSkinError as error:
        raise UsageError(f"--white {white}: {error}; or use none or scene.") from None
    xyz = spectrum @ color_matching_functions(_WHITE_GRID_NM, observer)
    return xyz / xyz[1], white


@functools.cache
def _processor(view: str) -> Any:
    if view not in VIEWS:
        raise UsageError(f"--view {view!r}: no such view; use {', '.join(map(repr, VIEWS))}.")
    try:
        config = PyOpenColorIO.Config.CreateFromBuiltinConfig(VIEWS[view])
        transform = PyOpenColorIO.DisplayViewTransform(
            src=_WORKING_SPACE, display=DISPLAY, view=view
        )
        return config.getProcessor(transform).getDefaultCPUProcessor()
    except PyOpenColorIO.Exception as error:
        reason = str(error).splitlines()[0]
        raise UsdSkinError(
            f"view {view!r} needs OpenColorIO's config {VIEWS[view]}: {reason} "
            "Update opencolorio, or choose another --view."
        ) from error
