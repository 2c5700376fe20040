"""The small pictures that views are aligned with."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.fisheye import unproject, vignetting
from usdskin.prims import FisheyeLens

FloatArray = NDArray[np.float64]

MOVED = 4
"""Bit of a pixel's status: its exposures contradict each other."""


@dataclass(frozen=True, slots=True, eq=False)
class AlignView:
    """A view, reduced, as the alignment takes it."""

    name: str
    """Name of the view."""

    lens: FisheyeLens
    """Its lens, for the reduced picture."""

    rotation: FloatArray
    """Stated rotation from the camera to the panorama, shape [3, 3]."""

    values: NDArray[np.float32]
    """rho: free of glare and vignetting [1/s], shape [height, width, 3]."""

    valid: NDArray[np.bool_]
    """Where they can be used, shape [height, width]."""


def reduce_view(
    name: str,
    lens: FisheyeLens,
    rotation: FloatArray,
    values: NDArray[np.float32],
    status: NDArray[np.uint8],
    most_pixels: int = 1_000_000,
) -> AlignView:
    """Return the small picture of a merged view: means of square blocks of pixels.

    Pixels that moved or that lie beyond the largest angle are left out; a block is valid when at
    least half of it is left.

    Args:
        name: Name of the view.
        lens: Its lens, for the full picture.
        rotation: From the camera to the panorama, shape [3, 3].
        values: Image values I, free of glare but not divided by the vignetting [1/s], shape
            [height, width, 3].
        status: Bits of the pixels, shape [height, width].
        most_pixels: Pixels the small picture may have.
    """
    height, width = status.shape
    block = max(int(np.ceil(np.sqrt(height * width / most_pixels))), 1)
    rows, columns = -(-height // block), -(-width // block)
    small_lens = replace(
        lens,
        focal_length_px=lens.focal_length_px / block,
        center_px=np.asarray(lens.center_px, np.float64) / block,
        resolution=(columns, rows),
    )
    total = np.zeros((rows, columns, 3))
    count = np.zeros((rows, columns))
    firsts = np.arange(columns) * block
    for row in range(rows):
        strip = slice(row * block, (row + 1) * block)
        usable = ((status[strip] & MOVED) == 0) & np.isfinite(values[strip]).all(axis=2)
        light = np.where(usable[..., None], values[strip], 0.0).sum(axis=0, dtype=np.float64)
        total[row] = np.add.reduceat(light, firsts, axis=0)
        count[row] = np.add.reduceat(usable.sum(axis=0), firsts)
    middles = np.stack(np.meshgrid(np.arange(columns) + 0.5, np.arange(rows) + 0.5), axis=-1)
    phi = np.arccos(-unproject(small_lens, middles)[..., 2])
    valid = (count >= 0.5 * block * block) & np.isfinite(phi)
    divisor = np.where(valid, count * vignetting(lens, np.where(valid, phi, 0.0)), 1.0)
    small = np.where(valid[..., None], total / divisor[..., None], 0.0)
    return AlignView(name, small_lens, rotation, small.astype(np.float32), valid)
