"""Strokes of the quality picture: lines, hatching, labels and text on sRGB pixels."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatImage = NDArray[np.float32]
Color = tuple[int, int, int]

_WRAP = 24


def blend(picture: FloatImage, alpha: NDArray[Any], color: Color) -> None:
    """Lay a color over a picture.

    Args:
        picture: sRGB values from 0 to 255, changed in place, shape [height, width, 3].
        alpha: Cover of each pixel, shape [height, width].
        color: sRGB.
    """
    picture += alpha[..., None].astype(np.float32) * (np.array(color, np.float32) - picture)


def resized(image: NDArray[Any], width: int, height: int) -> FloatImage:
    """Return an image of another size: area averages where it shrinks, else linear."""
    import cv2

    method = cv2.INTER_AREA if image.shape[1] > width else cv2.INTER_LINEAR
    pixels = np.ascontiguousarray(image, dtype=np.float32)
    return np.asarray(cv2.resize(pixels, (width, height), interpolation=method), dtype=np.float32)


def edge_distance(level: FloatImage, smoothness: float = 1.0) -> FloatImage:
    """Return the distance of each pixel to where a map passes 0.5, negative inside [px].

    Left and right side of the map meet; nothing lies beyond its top and bottom.

    Args:
        level: From 0 outside to 1 inside, shape [height, width].
        smoothness: Radius that the steps of pixels are smoothed over [px].
    """
    import cv2

    wrapped = np.pad(level, ((0, 0), (_WRAP, _WRAP)), mode="wrap")
    wrapped = np.pad(wrapped, ((_WRAP, _WRAP), (0, 0)), mode="edge")
    inside = (wrapped > 0.5).astype(np.uint8)
    far_in, far_out = (
        cv2.distanceTransform(side, cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
        for side in (inside, 1 - inside)
    )
    # Distances count from the middle of the pixel beyond the edge.
    signed = np.where(inside, 0.5 - far_in, far_out - 0.5).astype(np.float32)
    smooth = cv2.GaussianBlur(signed, (0, 0), smoothness)
    return np.asarray(smooth[_WRAP:-_WRAP, _WRAP:-_WRAP], dtype=np.float32)


def stroke(distance: FloatImage, width: float) -> FloatImage:
    """Return the cover of a line of a width along distance 0, shape [height, width]."""
    return np.asarray(np.clip(0.5 * width + 0.5 - np.abs(distance), 0.0, 1.0))


def hatching(height: int, width: int, period: float, line: float) -> FloatImage:
    """Return the cover of diagonal lines, shape [height, width].

    Args:
        height: Rows.
        width: Columns.
        period: Distance between lines [px].
        line: Their width [px].
    """
    along = (np.arange(height)[:, None] + np.arange(width)[None, :]) / np.sqrt(2.0)
    away = np.abs((along + 0.5 * period) % period - 0.5 * period)
    return np.asarray(np.clip(0.5 * line + 0.5 - away, 0.0, 1.0), dtype=np.float32)


def text_width(text: str, size: float, *, bold: bool = False) -> int:
    """Return the width of a line of text [px]."""
    import cv2

    (width, _), _ = cv2.getTextSize(text, _face(bold), _scale(size), 1)
    return int(width)


def write(
    picture: FloatImage,
    text: str,
    place: tuple[float, float],
    size: float,
    color: Color,
    *,
    bold: bool = False,
    align: float = 0.0,
    most: float = np.inf,
) -> None:
    """Write a line of text.

    Args:
        picture: sRGB values, changed in place, shape [height, width, 3].
        text: In ASCII, all that OpenCV's fonts know.
        place: Left end of the baseline [px], x and y.
        size: Height of a capital letter [px].
        color: sRGB.
        bold: Whether in the heavier face.
        align: Share of the width that lies left of ``place``: 0, 0.5 or 1.
        most: Greatest width [px]; wider text is written smaller. OpenCV 4 has wider letters.
    """
    import cv2

    width = text_width(text, size, bold=bold)
    if width > most:
        size *= most / width
        width = round(most)
    x, y = round(place[0] - align * width), round(place[1])
    cover = np.zeros(picture.shape[:2], dtype=np.uint8)
    cv2.putText(cover, text, (x, y), _face(bold), _scale(size), 255, 1, cv2.LINE_AA)
    top, bottom = max(0, y - round(2 * size)), y + round(size)
    blend(picture[top:bottom], cover[top:bottom] / np.float32(255.0), color)


def label(
    picture: FloatImage,
    text: str,
    place: tuple[float, float],
    size: float,
    color: Color,
    plate: Color = (0, 0, 0),
    cover: float = 0.62,
) -> None:
    """Write a line of text on a plate, centred on a place and kept within the picture.

    Args:
        picture: sRGB values, changed in place, shape [height, width, 3].
        text: In ASCII.
        place: Middle of the plate [px], x and y.
        size: Height of a capital letter [px].
        color: sRGB of the text.
        plate: sRGB of the plate.
        cover: How much of the picture the plate hides.
    """
    half = 0.5 * text_width(text, size, bold=True) + 0.6 * size
    height, width = picture.shape[:2]
    x = min(max(place[0], half), width - half)
    y = min(max(place[1], 1.1 * size), height - 1.1 * size)
    left, right, top, bottom = (
        round(edge) for edge in (x - half, x + half, y - 1.1 * size, y + 1.1 * size)
    )
    box = picture[top:bottom, left:right]
    blend(box, np.full(box.shape[:2], cover), plate)
    write(picture, text, (x, y + 0.5 * size), size, color, bold=True, align=0.5)


def _face(bold: bool) -> int:
    import cv2

    return int(cv2.FONT_HERSHEY_DUPLEX if bold else cv2.FONT_HERSHEY_SIMPLEX)


def _scale(size: float) -> float:
    return size / 22.0  # OpenCV's capitals are 22 px high at scale 1
