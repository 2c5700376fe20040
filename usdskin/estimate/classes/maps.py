"""Class maps as pictures: which light class each texel of a panorama belongs to, editable by hand.

Three forms are read. Weights in R, G and B, the classes in their order, as ``write_class_map``
writes up to three. Weights in channels named by class, as it writes more. One channel of whole
numbers: the index of the class, from 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.estimate.classes.sphere import add_cells, row_blocks, spread
from usdskin.images import Part, RowReader, open_rows, write_exr

FloatImage = NDArray[np.float32]

_COLORS = ("R", "G", "B")
_NOT_CLASSES = ("A", "Z")
"""Channels that pictures have beside their colors, where no class is called so."""


def write_class_map(path: str | Path, weights: FloatImage, names: Sequence[str]) -> None:
    """Write a class map as an EXR of half floats.

    Args:
        path: File to write.
        weights: Share of each class in every texel [1], shape [height, width, K].
        names: The K classes, in order.

    Raises:
        ImageError: The file cannot be written.
    """
    count = len(names)
    if weights.shape[2] != count:
        raise ValueError(f"{weights.shape[2]} weights for {count} classes")
    if count <= len(_COLORS):
        channels = {color: np.zeros(weights.shape[:2], np.float32) for color in _COLORS}
        channels |= {_COLORS[index]: weights[..., index] for index in range(count)}
    else:
        channels = {name: weights[..., index] for index, name in enumerate(names)}
    attributes = {"usdskin/classes": " ".join(names)}
    write_exr(path, [Part("", channels, attributes, "half")])


def read_class_map(path: str | Path, names: Sequence[str], height: int, width: int) -> FloatImage:
    """Return the weights of a class map at the size of a panorama.

    Args:
        path: EXR, PNG or TIFF, twice as wide as high. Weights need no particular sum.
        names: The K classes, in order.
        height: Rows of the panorama.
        width: Columns of the panorama.

    Returns:
        Weights from 0 to 1 with sum 1, shape [height, width, K].

    Raises:
        ImageError: It is no such map, or a texel has no class, an unknown one or a weight that is
            negative or not finite; the message names the texel.
    """
    with open_rows(path, as_stored=True) as reader:
        size = reader.header
        if size.width != 2 * size.height:
            raise ImageError(
                f"{path}: {size.width} x {size.height} pixels; a class map covers the sphere, so "
                "make it twice as wide as high"
            )
        stated = str(size.attributes.get("usdskin/classes", " ".join(names))).split()
        if tuple(stated) != tuple(names):
            raise ImageError(
                f"{path}: it was made for the classes {', '.join(stated)}, not "
                f"{', '.join(names)}; use the calibration it was made with, or make it anew"
            )
        wanted = _wanted(path, reader, names)
    with open_rows(path, channels=wanted, as_stored=True) as reader:
        if (size.height, size.width) == (height, width):
            weights = np.empty((height, width, len(names)), np.float32)
            for rows in row_blocks(height):
                weights[rows] = _weights(path, reader, rows, names)
            return weights
        return _resized(path, reader, names, height, width)


def _wanted(path: str | Path, reader: RowReader, names: Sequence[str]) -> tuple[str, ...]:
    """Return the channels that hold the map: a single one of indices, or one per class or color."""
    if set(names) <= set(reader.channel_names):
        return tuple(names)
    there = tuple(name for name in reader.channel_names if name not in _NOT_CLASSES)
    if len(there) == 1 and there[0] not in names:
        return there
    if len(names) <= len(_COLORS) and set(_COLORS) <= set(there):
        return _COLORS
    colors = "R, G, B, " if len(names) <= len(_COLORS) else ""
    raise ImageError(
        f"{path}: has the channels {', '.join(reader.channel_names)}; a class map of "
        f"{', '.join(names)} has {colors}a channel named after each class, or one channel of "
        "class indices from 0"
    )


def _weights(path: str | Path, reader: RowReader, rows: slice, names: Sequence[str]) -> FloatImage:
    """Return the weights of some rows of the file, in its own size."""
    values = reader.rows(rows.start, rows.stop)
    if len(reader.channel_names) == 1:
        return _of_indices(path, values[..., 0], rows, names)
    weights = values.astype(np.float32)
    _check(path, ~(np.isfinite(weights) & (weights >= 0.0)), weights, rows, "a weight of {:g}")
    beyond = weights[..., len(names) :]
    what = f"{{:g}} in {', '.join(_COLORS[len(names) :])}, but the classes are {', '.join(names)}"
    _check(path, beyond > 0.0, beyond, rows, what)
    weights = weights[..., : len(names)]
    total = weights.sum(axis=-1, keepdims=True)
    _check(path, total <= 0.0, total, rows, "no weight for any class")
    return np.asarray(weights / total, dtype=np.float32)


def _of_indices(
    path: str | Path, values: NDArray[Any], rows: slice, names: Sequence[str]
) -> FloatImage:
    known = f"class {{:g}}, but the classes are 0 to {len(names) - 1} ({', '.join(names)})"
    numbers = values.astype(np.float64)
    is_known = np.isin(numbers, np.arange(len(names)))
    _check(path, ~is_known, numbers, rows, known)
    return np.eye(len(names), dtype=np.float32)[numbers.astype(np.intp)]


def _check(
    path: str | Path,
    is_wrong: NDArray[np.bool_],
    values: NDArray[Any],
    rows: slice,
    what: str,
) -> None:
    """Refuse the first wrong texel."""
    if is_wrong.any():
        first = np.unravel_index(int(np.argmax(is_wrong)), is_wrong.shape)
        row, column = int(first[0]) + rows.start, int(first[1])
        raise ImageError(
            f"{path}: pixel ({column}, {row}) has {what.format(values[first])}; mend it there"
        )


def _resized(
    path: str | Path, reader: RowReader, names: Sequence[str], height: int, width: int
) -> FloatImage:
    """Return the map at another size: means where it shrinks, else linear."""
    high, wide = reader.header.height, reader.header.width
    cells = np.zeros((min(high, height), min(wide, width), len(names)))
    for rows in row_blocks(high):
        add_cells(cells, _weights(path, reader, rows, names), rows, high)
    cells /= cells.sum(axis=-1, keepdims=True)
    weights = np.empty((height, width, len(names)), np.float32)
    for rows in row_blocks(height):
        weights[rows] = spread(cells, rows, height, width)
    return weights
