"""Pictures for the report: developed alike, and embedded as data."""

from __future__ import annotations

import base64
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.image_output import write_png
from usdskin.images import read_headers, read_image
from usdskin.judge.report.markup import Markup, element

__all__ = ["Raster", "beauty_pixels", "embed", "heat_colors", "shrunk"]

LARGEST_PNG = 1_000_000
"""Larger pictures are embedded as JPEG of quality 95 [bytes]."""

GROUND = 0x73
"""Neutral grey that pictures lie on, L* = 48: the style's --ground."""

_MAGMA = (
    "000004 0a0822 1d1147 36106b 51127c 6a1c81 832681 9c2e7f b73779 d0416f e75263 f56b5c fc8961 "
    "fea772 fec488 fde2a3 fcfdbf"
)
"""Every sixteenth of the colour map "magma" by N. Smith and S. van der Walt (2015, CC0)."""


@dataclass(frozen=True, slots=True)
class Raster:
    """A picture as the report holds it."""

    uri: str
    width: int
    height: int

    def image(self, alt: str, **attributes: str | float | bool | None) -> Markup:
        """Return the picture as an element."""
        return element("img", src=self.uri, alt=alt, width=self.width, height=self.height,
                       **attributes)  # fmt: skip


def embed(pixels: NDArray[np.uint8], scratch: Path) -> Raster:
    """Return a picture as data: PNG, or JPEG where that is too large.

    Args:
        pixels: Display values, shape [height, width, 3 or 4].
        scratch: Folder for a moment's file.
    """
    path = scratch / "embedded.png"
    write_png(path, pixels)
    data, kind = path.read_bytes(), "png"
    if len(data) > LARGEST_PNG:
        data, kind = _jpeg(pixels), "jpeg"
    text = base64.b64encode(data).decode("ascii")
    return Raster(f"data:image/{kind};base64,{text}", pixels.shape[1], pixels.shape[0])


def _jpeg(pixels: NDArray[np.uint8]) -> bytes:
    import cv2

    rgb = pixels[..., :3].astype(np.float64)
    if pixels.shape[2] == 4:
        alpha = pixels[..., 3:] / 255.0
        rgb = rgb * alpha + GROUND * (1.0 - alpha)
    options = [cv2.IMWRITE_JPEG_QUALITY, 95]
    done, data = cv2.imencode(".jpg", np.rint(rgb[..., ::-1]).astype(np.uint8), options)
    if not done:
        raise ImageError("a picture cannot be packed as JPEG; make it smaller.")
    return bytes(data.tobytes())


def beauty_pixels(path: Path) -> tuple[NDArray[np.float32], str, dict[str, Any]]:
    """Return a render's linear values, their colour space and its header.

    Args:
        path: EXR whose first part is the beauty.

    Returns:
        R, G, B, A, premultiplied, shape [height, width, 4]; USD's name of the space; attributes.

    Raises:
        ImageError: It is missing, broken or has no R, G, B.
    """
    names = read_headers(path)[0].channel_names
    wanted = [name for name in ("R", "G", "B", "A") if name in names]
    if wanted[:3] != ["R", "G", "B"]:
        raise ImageError(f"{path}: has no channels R, G, B; name a render's beauty.")
    image = read_image(path, channels=wanted)
    pixels = image.pixels
    if pixels.shape[2] == 3:
        pixels = np.concatenate([pixels, np.ones((*pixels.shape[:2], 1), np.float32)], axis=2)
    return pixels, image.color_space or "lin_rec709_scene", image.attributes


def heat_colors(share: NDArray[np.floating[Any]]) -> NDArray[np.uint8]:
    """Return the colours of values from 0 to 1; transparent where they are not finite.

    Args:
        share: Values, clipped to 0..1, shape [...].

    Returns:
        sRGB and alpha, shape [..., 4].
    """
    anchors = np.array([[int(c[i : i + 2], 16) for i in (0, 2, 4)] for c in _MAGMA.split()])
    there = np.isfinite(share)
    at = np.clip(np.where(there, share, 0.0), 0.0, 1.0)
    steps = np.linspace(0.0, 1.0, len(anchors))
    result = np.empty((*share.shape, 4), np.uint8)
    for channel in range(3):
        result[..., channel] = np.rint(np.interp(at, steps, anchors[:, channel]))
    result[..., 3] = 255
    result[~there] = 0
    return result


def shrunk(pixels: NDArray[np.float32], largest_width: int) -> NDArray[np.float32]:
    """Return a picture no wider than a bound, whole blocks of pixels averaged.

    Args:
        pixels: Linear values, shape [height, width, channel_count].
        largest_width: Bound [px].
    """
    factor = -(-pixels.shape[1] // largest_width)
    height, width = (extent // factor for extent in pixels.shape[:2])
    if factor <= 1 or height == 0:
        return pixels
    cut = pixels[: height * factor, : width * factor]
    blocks = cut.reshape(height, factor, width, factor, -1)
    return np.asarray(blocks.mean(axis=(1, 3)), np.float32)
