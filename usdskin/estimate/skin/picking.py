"""Which pixels of a photograph become readings."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.geometry import Geometry, dilated
from usdskin.estimate.skin.lobe import Lobe, LobeGeometry
from usdskin.estimate.skin.pictures import Picture
from usdskin.estimate.skin.readings import Readings

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

Gloss = Literal["mask", "keep"]
"""Whether pixels near the mirror direction are left out or kept."""

SKIN_LOBE = Lobe(weight=1.0, roughness1=0.5, roughness2=0.3, mix=0.3)
"""What skin may mirror: the lobes of ``SkinMaterialAPI``'s fallbacks at full weight."""

LARGEST_GLOSS = 0.004
"""What may be mirrored at a matt pixel, over a perfect diffuser [1]: about 1 % of skin."""

BINS = 36
"""Bins of the angle between normal and light, of 5 degrees each."""

_DARK_BINS = slice(27, BINS)  # beyond 135 degrees: dark unless l is above 0.7
_DARK_SHARE = 0.3
_SEED = 0x5A3
_MOST_JUDGED = 200_000


@dataclass(frozen=True, slots=True, eq=False)
class Picked:
    """The pixels taken from one photograph."""

    pixels: NDArray[np.intp]
    """Their flat indices, shape [q]."""

    normal: FloatArray
    """Unit normals, shape [q, 3]."""

    view: FloatArray
    """Unit vectors towards the camera, shape [q, 3]."""

    light: FloatArray
    """Unit vector towards the light, shape [3]."""

    values: FloatArray
    """Over those of a perfect diffuser that faces the light [1], shape [q, 3]."""

    variance: FloatArray | None
    """Of the values by the sensor's noise, shape [q, 3]; None: not known."""

    turn: FloatArray
    """How far N.L turns from pixel to pixel [1], shape [q]."""

    is_matt: Mask
    """Which are far from the mirror direction, shape [q]."""

    inside: int
    """Pixels of the photograph well inside the object and the mask."""

    lost: int
    """Of those, pixels saturated or moved."""

    glossy: int
    """Of the rest, pixels left out as glossy."""

    width: int
    """Of the photograph [px]."""

    @property
    def cosine(self) -> FloatArray:
        """N.L [1], shape [q]."""
        return np.asarray(np.clip(self.normal @ self.light, -1.0, 1.0))


def candidates(allowed: Mask, index: int) -> NDArray[np.intp]:
    """Return the flat indices of the pixels to choose from: all, or a random part of very many.

    Args:
        allowed: Where pixels may be taken, shape [height, width].
        index: Of the photograph, for the seed.
    """
    found = np.flatnonzero(allowed)
    if len(found) > _MOST_JUDGED:
        random = np.random.default_rng([_SEED, index, 1])
        found = np.sort(random.choice(found, _MOST_JUDGED, replace=False))
    return found


def pick_evenly(cosine: FloatArray, most: int, index: int) -> NDArray[np.intp]:
    """Return pixels spread evenly over the angle to the light, fewer where all skin is dark.

    Args:
        cosine: N.L of the pixels, shape [q].
        most: How many to pick at most.
        index: Of the photograph, for the seed.

    Returns:
        Indices of those picked, ascending, shape [k].
    """
    angle = np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0)))
    row = np.minimum((angle * (BINS / 180.0)).astype(np.intp), BINS - 1)
    share = np.ones(BINS)
    share[_DARK_BINS] = _DARK_SHARE
    # Bins that hold few leave their share to the others.
    held = np.bincount(row, minlength=BINS).astype(np.float64)
    level = _fill_level(held, share, most)
    random = np.random.default_rng([_SEED, index])
    chosen = [np.zeros(0, np.intp)]
    for bin_ in np.flatnonzero(held):
        pixels = np.flatnonzero(row == bin_)
        quota = int(level * share[bin_])
        if len(pixels) > quota:
            pixels = random.choice(pixels, quota, replace=False)
        chosen.append(pixels)
    return np.sort(np.concatenate(chosen))


def _fill_level(held: FloatArray, share: FloatArray, most: int) -> float:
    """Return the level at which ``sum(min(held, level * share))`` is the number wanted."""
    if held.sum() <= most:
        return float((held / share).max(initial=0.0)) + 1.0
    low, high = 0.0, float((held / share).max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.minimum(held, middle * share).sum() > most:
            high = middle
        else:
            low = middle
    return low


def is_glossy(light: FloatArray, view: FloatArray, normal: FloatArray) -> Mask:
    """Return at which pixels skin may mirror the light.

    Args:
        light: Unit vector towards the light, shape [3].
        view: Unit vectors towards the camera, shape [q, 3].
        normal: Unit normals, shape [q, 3].

    Returns:
        Shape [q].
    """
    if not len(normal):
        return np.zeros(0, bool)
    seen = Readings(light=light, normal=normal, values=np.zeros(len(normal)), view=view)
    return np.asarray(LobeGeometry(seen).reflected(SKIN_LOBE) > LARGEST_GLOSS)


def pick_pixels(
    picture: Picture,
    geometry: Geometry,
    light: FloatArray,
    white: FloatArray,
    mask: Mask | None,
    gloss: Gloss,
    share: int,
    index: int,
) -> Picked:
    """Return the pixels of a photograph that become readings.

    Args:
        picture: The photograph.
        geometry: Its geometry, of the same size.
        light: Unit vector towards the light, shape [3].
        white: Camera values of a perfect diffuser that faces the light, shape [3].
        mask: Where it may be used, shape [height, width]; None: everywhere.
        gloss: Whether pixels near the mirror direction are left out.
        share: How many to pick at most.
        index: Of the photograph, for the seed.
    """
    allowed = geometry.inside if mask is None else geometry.inside & mask
    inside = int(np.count_nonzero(allowed))
    allowed = allowed & ~dilated(picture.lost)
    kept = int(np.count_nonzero(allowed))
    found = candidates(allowed, index)
    normal, view = _unit(geometry.normal, found), _unit(geometry.view, found)
    is_matt = ~is_glossy(light, view, normal)
    offered = np.flatnonzero(is_matt) if gloss == "mask" else np.arange(len(found))
    cosine = np.clip(normal @ light, -1.0, 1.0)
    chosen = offered[pick_evenly(cosine[offered], share, index)]
    pixels = found[chosen]
    variance = picture.variance
    # N.L changes least where the normal points at the light.
    across = np.sqrt(1.0 - cosine[chosen] ** 2)
    return Picked(
        pixels=pixels,
        normal=normal[chosen],
        view=view[chosen],
        light=light,
        values=picture.values.reshape(-1, 3)[pixels] / white,
        variance=None if variance is None else variance.reshape(-1, 3)[pixels] / white**2,
        turn=geometry.turn.ravel()[pixels].astype(np.float64) * across,
        is_matt=is_matt[chosen],
        inside=inside,
        lost=inside - kept,
        glossy=kept - round(kept * len(offered) / max(len(found), 1)),
        width=geometry.size[1],
    )


def _unit(image: NDArray[np.float32], pixels: NDArray[np.intp]) -> FloatArray:
    vectors = image.reshape(-1, 3)[pixels].astype(np.float64)
    return np.asarray(vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
