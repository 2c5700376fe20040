"""The pictures of a capture, a block of rows at a time."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.estimate.light.light_map import rows_per_block
from usdskin.images import open_rows, read_headers, read_image
from usdskin.prims import CapturedPanorama

FloatImage = NDArray[np.float32]

_CHANNELS = ("R", "G", "B")


def panorama_size(capture: CapturedPanorama) -> tuple[int, int]:
    """Return height and width of a capture's panorama.

    Raises:
        ImageError: It cannot be read, or is no latlong map.
    """
    header = read_headers(capture.panorama_file)[0]
    if header.width != 2 * header.height:
        raise ImageError(
            f"{capture.panorama_file} ({capture.where}): {header.width} x {header.height} pixels "
            "are not twice as wide as high, so no latlong panorama; name the capture's own"
        )
    return header.height, header.width


def panorama_rows(
    capture: CapturedPanorama, height: int, width: int
) -> Iterator[tuple[int, FloatImage]]:
    """Give the panorama's pixels as stored, a block of rows at a time.

    Yields:
        The first row, and rho times the capture's scale, shape [rows, width, 3].
    """
    count = rows_per_block(width)
    with open_rows(capture.panorama_file, channels=_CHANNELS) as reader:
        for begin in range(0, height, count):
            block = reader.rows(begin, min(begin + count, height))
            if not np.isfinite(block).all():
                row, column = np.argwhere(~np.isfinite(block).all(axis=-1))[0]
                raise ImageError(
                    f"{capture.panorama_file} ({capture.where}): the pixel at x {column}, y "
                    f"{begin + row} is {_shown(block[row, column])}; capture the panorama anew"
                )
            yield begin, block


def clipped_share(capture: CapturedPanorama) -> FloatImage | None:
    """Return the share of each texel that was saturated, where the capture kept it."""
    if capture.stddev_file is None:
        return None
    image = read_image(capture.stddev_file, part="quality", channels=["clipped"])
    return image.pixels[..., 0]


def _shown(pixel: Sequence[float] | FloatImage) -> str:
    return ", ".join(f"{float(value):g}" for value in pixel)
