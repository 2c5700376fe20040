"""Tell which lamp lights what, from the colors of a panorama.

What shines is one lamp, and is recognised by its chromaticity. Surfaces mix lamps: see
``surfaces``, which starts from what the lamps in sight give. What has just the chromaticity of a
lamp counts as in sight too, however dark: it is the lamp (a clear sky), or grey and in its light
alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.classes.lamps import Lamps, check_separations, chromaticity, read_lamps
from usdskin.estimate.classes.sphere import add_cells, row_blocks, smooth, spread
from usdskin.estimate.classes.surfaces import normalized, squared_distance, surface_shares
from usdskin.latlong import latlong_directions, texel_directions, texel_solid_angles
from usdskin.notes import Note
from usdskin.prims import SpectralCamera

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_CELL_ROWS = 128
_SOURCE_RADIUS = 0.05  # [rad], within which what shines is one lamp
_NEAR = 1e-4  # of the brightest, blurred so: some 12 degrees from the edge of a lamp
_LIT, _LAMP = 2.0, 4.0  # times a white surface: a surface still, and surely a lamp
_DIRECTION_COUNT = 128

_SOURCE_SURFACES = 32.0  # the evidence of lamps: they scatter by a sixth of what surfaces do

_STRANGE = 3.0  # standard deviations of lamps, from every class
_STRANGE_FLUX = 0.05  # of all light


@dataclass(frozen=True, slots=True, eq=False)
class _Sums:
    """What a panorama holds, gathered into cells; the last channel of each is luminance."""

    sources: FloatArray
    """Camera values and luminance of what shines, shape [rows, columns, 4]."""

    surfaces: FloatArray
    """Chromaticity times luminance, and luminance, of the rest, shape [rows, columns, 3]."""


def estimate_class_weights(
    values: FloatImage,
    camera: SpectralCamera,
    notes: list[Note],
    *,
    clipped: FloatImage | None = None,
) -> FloatImage:
    """Return the share of each light class in every texel's luminance.

    What is several times brighter than a white surface that faces most of the light is a lamp, or
    lit by one close by; it belongs to the class whose chromaticity is nearest.

    Args:
        values: Latlong panorama of camera values in any scale, shape [height, width, 3].
        camera: The calibration, with one recovery per class.
        notes: Gets ``light-classes-close`` and ``light-not-calibrated``.
        clipped: Share of each texel whose color is not known, shape [height, width]; it counts as
            bright, but its color does not.

    Returns:
        Weights from 0 to 1 with sum 1, shape [height, width, K], classes in the order of
        ``camera.recoveries``.

    Raises:
        LayerError: Two classes look alike to the camera.
    """
    height, width, _ = values.shape
    if len(camera.recoveries) == 1:
        return np.ones((height, width, 1), np.float32)
    lamps = read_lamps(camera)
    check_separations(camera, lamps, notes)
    white = _white_luminance(values, lamps)
    sums = _gathered(values, lamps, white, clipped)
    near_sources, is_known, flux = _source_shares(sums, lamps, camera, notes)
    near_surfaces = surface_shares(sums.surfaces, lamps, flux)
    # A lamp whose color is clipped, and no other near: what it lights tells most.
    near_sources = np.where(is_known[..., None], near_sources, near_surfaces)
    weights = np.empty((height, width, len(lamps.names)), np.float32)
    for rows in row_blocks(height):
        shine = _shine(_luminance(values[rows], lamps), white)[..., None]
        weights[rows] = shine * spread(near_sources, rows, height, width)
        weights[rows] += (1.0 - shine) * spread(near_surfaces, rows, height, width)
    return weights


# --- What shines -------------------------------------------------------------------------------


def _luminance(values: NDArray[Any], lamps: Lamps) -> FloatImage:
    """Return luminance in the scale of the camera values, 0 where a value is not a number."""
    with np.errstate(invalid="ignore"):
        light = values @ lamps.luminance_weights.astype(np.float32)
    known = np.nan_to_num(light, nan=0.0, posinf=0.0, neginf=0.0)
    return np.asarray(np.maximum(known, 0.0), dtype=np.float32)


def _white_luminance(values: FloatImage, lamps: Lamps) -> float:
    """Return the luminance of a perfect diffuser that faces the largest irradiance."""
    height, width, _ = values.shape
    flux = np.zeros((min(64, height), min(128, width), 1))
    for rows in row_blocks(height):
        size = texel_solid_angles(height, width)[rows, None]
        add_cells(flux, (_luminance(values[rows], lamps) * size)[..., None], rows, height)
    # Directions of equal solid angle: the middles of rings, a golden angle apart.
    step = (np.arange(_DIRECTION_COUNT) + 0.5) / _DIRECTION_COUNT
    turns = np.arange(_DIRECTION_COUNT) * (0.5 * (3.0 - np.sqrt(5.0)))
    facing = latlong_directions(turns, np.arccos(1.0 - 2.0 * step))
    towards = np.maximum(texel_directions(*flux.shape[:2]) @ facing.T, 0.0)
    return float(np.tensordot(flux[..., 0], towards, 2).max()) / np.pi


def _shine(luminance: FloatImage, white: float) -> FloatImage:
    """Return how surely texels are lamps, from 0 to 1."""
    ratio = np.maximum(luminance, 1e-30) / max(_LIT * white, 1e-30)
    sure = np.log(ratio) / np.log(_LAMP / _LIT)
    return np.asarray(np.clip(sure, 0.0, 1.0), dtype=np.float32)


def _gathered(values: FloatImage, lamps: Lamps, white: float, clipped: FloatImage | None) -> _Sums:
    """Return the light of lamps and of surfaces in each cell."""
    height, width, _ = values.shape
    shape = min(_CELL_ROWS, height), min(2 * _CELL_ROWS, width)
    sums = _Sums(np.zeros((*shape, 4)), np.zeros((*shape, 3)))
    sizes = texel_solid_angles(height, width).astype(np.float32)
    for rows in row_blocks(height):
        light = _luminance(values[rows], lamps)
        shine = _shine(light, white)
        counts = (light > 0.0) * sizes[rows, None]
        if clipped is not None:
            counts = counts * (1.0 - np.clip(clipped[rows], 0.0, 1.0))
        known = np.where(light[..., None] > 0.0, values[rows], np.float32(1.0))
        amount = (counts * shine)[..., None]
        shining = np.concatenate([known, light[..., None]], axis=-1)
        add_cells(sums.sources, amount * shining, rows, height)
        amount = (counts * (1.0 - shine) * light)[..., None]
        colors = np.concatenate([chromaticity(known), np.ones_like(amount)], axis=-1)
        add_cells(sums.surfaces, amount * colors, rows, height)
    return sums


def _source_shares(
    sums: _Sums, lamps: Lamps, camera: SpectralCamera, notes: list[Note]
) -> tuple[FloatArray, NDArray[np.bool_], FloatArray]:
    """Return the classes of what shines near each cell, and what share of all light each gives.

    Returns:
        Shares, shape [rows, columns, K]; whether a lamp of known color is near, shape [rows,
        columns]; and parts of the panorama's flux, shape [K].
    """
    near = smooth(sums.sources, _SOURCE_RADIUS)
    is_known = near[..., 3] > _NEAR * near[..., 3].max()
    color = chromaticity(np.where(is_known[..., None], near[..., :3], 1.0))
    distance = _SOURCE_SURFACES * squared_distance(color, lamps.chromaticities, lamps)
    shares = normalized(-0.5 * distance)
    light = sums.sources[..., 3]
    total = light.sum() + sums.surfaces[..., 2].sum()
    strange = float(light[is_known & (distance.min(axis=-1) > _STRANGE**2)].sum())
    if strange > _STRANGE_FLUX * total:
        text = (
            f"{100.0 * strange / total:.0f} % of the panorama's light comes straight from lamps "
            f"of a color far from {', '.join(lamps.names)}; calibrate their class too"
        )
        notes.append(Note("light-not-calibrated", camera.where, text))
    return shares, is_known, np.einsum("ij,ijk->k", light, shares) / max(total, 1e-30)
