"""Flat fields: what the camera shows of an even field, divided out."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.notes import Note
from usdskin.photographs.bracket import OpenBracket
from usdskin.photographs.frames import Frame
from usdskin.warp_kernels.bracket import SATURATION

_ROWS_PER_BLOCK = 64
_LEAST = 0.01  # of the mean
_SATURATED_SHARE = 1e-4  # a few hot pixels are none of the light's


def divide_by_flat(
    bracket: OpenBracket,
    flat: Frame,
    values: NDArray[np.float32],
    variance: NDArray[np.float32],
    notes: list[Note],
) -> None:
    """Divide merged values by a flat field, normalised to mean 1 in each channel.

    Args:
        bracket: The photographs, whose levels the flat field shares.
        flat: The flat field.
        values: Merged values, changed in place, shape [height, width, 3].
        variance: Their variance, changed in place, shape [height, width, 3].
        notes: Told about parts of the flat field that are too dark to divide by.

    Raises:
        ImageError: The flat field is broken, saturated or black.
    """
    height, width = values.shape[:2]
    ends = [*range(_ROWS_PER_BLOCK, height, _ROWS_PER_BLOCK), height]
    blocks = list(zip([0, *ends], ends, strict=False))
    total, saturated = np.zeros(3), 0
    for begin, end in blocks:
        raw = flat.rows(begin, end)
        saturated += int(np.count_nonzero((bracket.fraction(0, raw) >= SATURATION).any(axis=-1)))
        total += bracket.linear(0, raw).sum(axis=(0, 1), dtype=np.float64)
    if saturated > _SATURATED_SHARE * height * width:
        raise ImageError(
            f"{flat.path}: the flat field is saturated in {saturated} pixels; photograph it with "
            "less exposure"
        )
    if (total <= 0.0).any():
        raise ImageError(f"{flat.path}: the flat field is black; photograph it with more exposure")
    mean = (total / (height * width)).astype(np.float32)
    dim = 0
    for begin, end in blocks:
        shape = bracket.linear(0, flat.rows(begin, end)) / mean
        dim += int(np.count_nonzero((shape < _LEAST).any(axis=-1)))
        shape = np.maximum(shape, np.float32(_LEAST))
        values[begin:end] /= shape
        variance[begin:end] /= shape**2
    if dim:
        notes.append(
            Note(
                "flat-dark",
                str(flat.path),
                f"{dim / (height * width):.2%} of the flat field is below {_LEAST:.0%} of its mean "
                "and is taken to be that",
            )
        )
