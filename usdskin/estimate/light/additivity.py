"""Whether captures with single classes of lamps add up to the one with all of them.

They do where they were taken from one place, by a camera that nobody moved, of lamps that did not
change. Another place, a turned tripod or a lamp that was not switched shows in some direction.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.estimate.classes.sphere import add_cells, smooth
from usdskin.estimate.light.pictures import panorama_rows, panorama_size
from usdskin.latlong import texel_solid_angles
from usdskin.notes import Note
from usdskin.prims import CapturedPanorama

FloatArray = NDArray[np.float64]

_ROWS = 192
"""Rows of cells at most: fine, so that a lamp on the border of two hardly moves when it moves."""

_RADIUS = np.radians(5.0)
"""What directions are averaged over [rad]: single texels have noise and edges."""

_FLOOR = 0.1
"""Of the mean light of all directions, added everywhere: what is darker hardly counts."""

# Measured with `usdskin prove --class-captures`, as the factor between sum and whole in the worst
# direction: realistic shoots 1.001 (mixed_window) and 1.02 (outdoor_sun), from a tripod that stood
# still. Lamps that drift by 10 % give 1.11 at most and change a share by 0.025 at most. A capture
# turned by 1 degree gives 1.07 (a sky) to 1.6 (the sun), by 5 degrees 1.4 to 5, by 20 degrees 2.1
# and more, one of another set 27 and more; with a class missing these are less, 1.6 by 20 degrees.
# A cloud may dim a window by a third between two captures, which is worth telling, but no error.
_NOTED = 1.15
_REFUSED = 1.5


def check_additivity(
    whole: CapturedPanorama,
    alone: Mapping[str, CapturedPanorama],
    missing: str | None,
    notes: list[Note],
) -> dict[str, FloatArray]:
    """Refuse captures of single classes that cannot be parts of the whole one.

    Args:
        whole: With all lamps on.
        alone: With one class alone, by its name; panoramas of the same size.
        missing: The class without a capture, if any: the others may add up to less.
        notes: Takes what does not quite add up.

    Returns:
        What each class gives around every cell, that without a capture what the others leave, as
        camera values on one scale, shape [rows, 2 rows, 3].

    Raises:
        LayerError: In some direction they give far more light than the whole, or, if complete,
            far less.
    """
    seen, parts = _around(whole), {name: _around(capture) for name, capture in alone.items()}
    floor = _floor(seen)
    together = (sum(parts.values()) + floor) / (seen + floor)
    off = together if missing else np.maximum(together, 1.0 / together)
    if missing and together.min() > 1.0 / _NOTED:
        text = f"give all the light of {whole.where}: no light is left for the class without one"
        notes.append(Note("captures-leave-nothing", ", ".join(parts), text))
    given = dict(parts)
    if missing:
        given[missing] = np.maximum(seen - sum(parts.values()), 0.0)
    disagreement = float(off.max())
    if disagreement <= _NOTED:
        return given
    # One that outshines all lamps is wrong by itself; else it may be any of them.
    by_itself = {name: (part + floor) / (seen + floor) for name, part in parts.items()}
    brightest = max(by_itself, key=lambda name: float(by_itself[name].max()))
    if len(parts) == 1 or by_itself[brightest].max() > _NOTED:
        factor = off = by_itself[brightest]
        who, gives, one = f"{brightest} ({alone[brightest].where})", "gives", "it"
    else:
        factor = together
        who, gives, one = ", ".join(parts), "together give", "one of them"
    worst = np.unravel_index(np.argmax(off), off.shape)
    text = (
        f"{gives} {factor[worst]:.2f} times the light of the whole capture, {whole.where}, around "
        f"{_direction(worst, seen.shape, whole)}"
    )
    if disagreement > _REFUSED:
        raise LayerError(
            f"--class-capture {who}: {text}, so {one} does not belong to it; name the right layer, "
            "or capture again from the same tripod, not turned, with only those lamps on"
        )
    text += "; did a lamp change or the camera move? Light there may go to the wrong class"
    notes.append(Note("captures-disagree", who, text))
    return given


def _floor(values: FloatArray) -> FloatArray:
    """Return ``_FLOOR`` of the mean of all directions, and more than nothing, shape [3]."""
    sizes = texel_solid_angles(*values.shape[:2])[:, None, None]
    mean = (values * sizes).sum(axis=(0, 1)) / (4.0 * np.pi)
    return np.asarray(np.maximum(_FLOOR * mean, np.finfo(float).tiny))


def _around(capture: CapturedPanorama) -> FloatArray:
    """Return what a capture shows around every cell, camera values, shape [rows, 2 rows, 3]."""
    height, width = panorama_size(capture)
    rows = min(_ROWS, height)
    sums = np.zeros((rows, 2 * rows, 3))
    sizes = texel_solid_angles(height, width)[:, None, None] / capture.scale
    for begin, block in panorama_rows(capture, height, width):
        part = slice(begin, begin + len(block))
        add_cells(sums, block * sizes[part], part, height)
    # The integral of the kernel of ``smooth`` over the sphere is 2 pi radius^2.
    return np.asarray(np.maximum(smooth(sums, _RADIUS), 0.0) / (2.0 * np.pi * _RADIUS**2))


def _direction(cell: Sequence[Any], shape: tuple[int, ...], capture: CapturedPanorama) -> str:
    """Return where a cell lies, in degrees as views are aimed and as a pixel."""
    rows, columns = shape[:2]
    down, across = (cell[0] + 0.5) / rows, (cell[1] + 0.5) / columns
    height, width = panorama_size(capture)
    return (
        f"azimuth {round(-360.0 * across % 360.0)}, elevation {round(90.0 - 180.0 * down)} deg (x "
        f"{int(across * width)}, y {int(down * height)} of {capture.panorama_file.name})"
    )
