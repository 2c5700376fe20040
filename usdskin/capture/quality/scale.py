"""The factor from camera values to luminance, from a luminance or an illuminance reading.

With both readings the luminance gives the scale and the illuminance tells how much light the
panorama lacks: lamps that were saturated in every exposure hold it, and the spot that the
luminance meter saw does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.quality.lamps import Lamp
from usdskin.errors import LayerError
from usdskin.meters import irradiance, radiance_at
from usdskin.notes import Note
from usdskin.prims.captures import Shoot

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

SPOT_RADIUS_DEG = 0.5
"""Of the usual spot meter, which accepts one degree [deg]."""

_SHARE_LIMIT = 0.02
"""Share of an illuminance in clipped or unseen texels from which a note is made."""


@dataclass(frozen=True, slots=True)
class MeasuredLamp:
    """A saturated lamp whose illuminance was measured."""

    lamp: Lamp
    """Which one."""

    illuminance_lx: float
    """At a surface that faces it, of it alone [lx]."""


@dataclass(frozen=True, slots=True)
class Scale:
    """How camera values become luminance, and what the readings say about the panorama."""

    factor: float = 1.0
    """Luminance over the weighted sum of camera values [cd m^-2]; 1 where nothing was read."""

    source: str = "none"
    """``luminance``, ``illuminance`` or ``none``."""

    luminance: float = 0.0
    """The luminance reading [cd m^-2]; 0: not taken."""

    illuminance_lx: float = 0.0
    """The illuminance reading [lx]; 0: not taken."""

    panorama_illuminance_lx: float = 0.0
    """What the scaled panorama gives at the illuminance meter, measured lamps included [lx]; 0
    where the meter was not used."""

    clipped_share: float = 0.0
    """Share of that in texels that were saturated in every exposure and not measured [1]."""

    unseen_share: float = 0.0
    """Share of that in texels that no view saw [1]."""

    @property
    def units(self) -> str:
        """``absolute`` or ``relative``, as ``capture:units`` has it."""
        return "relative" if self.source == "none" else "absolute"

    @property
    def missing_lx(self) -> float:
        """Illuminance that the panorama lacks at the meter; below 0: it shows too much [lx]."""
        if self.source != "luminance" or not self.illuminance_lx:
            return 0.0
        return self.illuminance_lx - self.panorama_illuminance_lx


def scale_of(
    shoot: Shoot,
    values: FloatImage,
    clipped: FloatImage,
    seen: FloatImage,
    panorama_from_world: FloatArray,
    notes: list[Note],
    *,
    measured: Sequence[MeasuredLamp] = (),
) -> Scale:
    """Return the scale of a panorama from the readings of its shoot.

    With L_v and E_v read, weights w, panorama rho, E[rho] its irradiance where the meter faced and
    E_c[rho] the part of the saturated lamps whose illuminance was measured, which give E_m there:
    ``factor = L_v / (w . rho)`` at the spot, else ``factor = (E_v - E_m) / (w . (E - E_c))``.

    Args:
        shoot: The readings, their directions in the stage's world, and the weights.
        values: Camera values, shape [height, width, 3], lamps as the pictures show them.
        clipped: Share of each texel that was saturated in every exposure, shape [height, width].
        seen: Share of each texel that any view saw, shape [height, width].
        panorama_from_world: Rotation from the stage's world to the panorama, shape [3, 3].
        notes: Takes what makes the scale uncertain.
        measured: Lamps whose illuminance is known.

    Raises:
        LayerError: A reading has no direction, or the panorama has no sound value there.
    """
    factor, source = 1.0, "none"
    if shoot.luminance > 0.0:
        toward = _turned(shoot, "luminance", shoot.luminance_direction, panorama_from_world)
        spot = _spot(shoot, values, clipped, seen, toward)
        factor, source = shoot.luminance / spot, "luminance"
    if not shoot.illuminance_lx > 0.0:
        return Scale(factor, source, luminance=shoot.luminance)

    toward = _turned(shoot, "illuminance", shoot.illuminance_direction, panorama_from_world)
    weights = shoot.luminance_weights
    lamps_lx, lamps_shown, unmeasured = 0.0, 0.0, clipped
    if measured:
        unmeasured = clipped.copy()
    for item in measured:
        shown = float(item.lamp.irradiance_at(toward) @ weights)
        lamps_lx += item.illuminance_lx * shown / float(item.lamp.irradiance @ weights)
        lamps_shown += shown
        unmeasured[item.lamp.rows, item.lamp.columns] = 0.0
    shown = float(irradiance(values, toward) @ weights)
    rest = shown - lamps_shown
    if source == "none":
        factor, source = _from_illuminance(shoot, rest, lamps_lx), "illuminance"
    panorama_lx = factor * rest + lamps_lx
    luminance = values @ weights.astype(np.float32)

    def share(of: FloatImage) -> float:
        part = factor * float(irradiance(luminance * of, toward))
        return part / panorama_lx if panorama_lx > 0.0 else 0.0

    scale = Scale(
        factor=factor,
        source=source,
        luminance=shoot.luminance,
        illuminance_lx=shoot.illuminance_lx,
        panorama_illuminance_lx=panorama_lx,
        clipped_share=share(unmeasured),
        unseen_share=share(1.0 - seen),
    )
    if source == "illuminance":
        _note_doubts(shoot, scale, notes)
    return scale


def _turned(
    shoot: Shoot, name: str, direction: FloatArray | None, panorama_from_world: FloatArray
) -> FloatArray:
    if direction is None:
        faced = "looked" if name == "luminance" else "faced"
        raise LayerError(
            f"{shoot.where}: capture:{name} has a reading but capture:{name}:direction has no "
            f"value; author the direction the meter {faced}, in the prim's own frame"
        )
    return np.asarray(panorama_from_world @ direction)


def _spot(
    shoot: Shoot, values: FloatImage, clipped: FloatImage, seen: FloatImage, toward: FloatArray
) -> float:
    """Return the weighted camera value of the spot that the luminance meter saw."""

    def mean(of: NDArray[Any]) -> FloatArray:
        return radiance_at(of, toward, SPOT_RADIUS_DEG)

    def refuse(what: str) -> LayerError:
        return LayerError(
            f"{shoot.where}: capture:luminance was read where {what}; take the reading off an even "
            "and well lit surface, and check capture:luminance:direction"
        )

    if float(mean(clipped)) > 0.0:
        raise refuse("the panorama is saturated in every exposure")
    if float(mean(seen)) < 0.99:
        raise refuse("no view saw the scene")
    spot = float(mean(values) @ shoot.luminance_weights)
    if not spot > 0.0:
        raise refuse("the panorama is black")
    return spot


def _from_illuminance(shoot: Shoot, rest: float, lamps_lx: float) -> float:
    read = shoot.illuminance_lx
    if lamps_lx >= read:
        raise LayerError(
            f"{shoot.where}: capture:illuminance is {read:g} lx, but the measured lamp alone gives "
            f"{lamps_lx:.4g} lx where that meter faced; correct one of the readings"
        )
    if not rest > 0.0:
        raise LayerError(
            f"{shoot.where}: capture:illuminance is {read:g} lx, but the panorama is black in the "
            "hemisphere that the meter faced; check capture:illuminance:direction"
        )
    return (read - lamps_lx) / rest


def _note_doubts(shoot: Shoot, scale: Scale, notes: list[Note]) -> None:
    if scale.clipped_share > _SHARE_LIMIT:
        notes.append(
            Note(
                "scale-from-clipped-light",
                shoot.where,
                f"{100.0 * scale.clipped_share:.0f} % of the light that the illuminance meter "
                "faced is in pixels saturated in every exposure, so the scale is too high by an "
                "unknown factor; read a luminance too, or measure the lamp",
            )
        )
    if scale.unseen_share > _SHARE_LIMIT:
        notes.append(
            Note(
                "scale-from-unseen-light",
                shoot.where,
                f"{100.0 * scale.unseen_share:.0f} % of the light that the illuminance meter "
                "faced comes from where no view saw the scene, and is filled in; add a view, or "
                "read a luminance",
            )
        )
