"""Read an ordinary latlong environment map: linear RGB, its color space, and no bad pixels."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import color_space_names, linear_color_space, linearize
from usdskin.errors import ImageError
from usdskin.images import read_headers, read_image
from usdskin.notes import Note

FloatImage = NDArray[np.float32]

BadPixels = Literal["error", "clamp"]

_ASPECT_TOLERANCE = 0.01  # a map of odd height is still a latlong one
_INTEGER_SAMPLES = ("uint8", "uint16", "int8", "int16")


@dataclass(frozen=True, slots=True, eq=False)
class Environment:
    """A latlong map in linear RGB."""

    pixels: FloatImage
    """Linear values, finite and not negative, shape [height, width, 3]."""

    color_space: str
    """USD's name of their linear color space."""


def read_environment(
    path: Path, color_space: str | None, bad_pixels: BadPixels, notes: list[Note]
) -> Environment:
    """Read an environment map.

    Args:
        path: Radiance HDR, EXR or any other picture, twice as wide as high.
        color_space: USD's name of its color space; None: what the file says, else sRGB for
            integers and linear Rec. 709 for the rest.
        bad_pixels: Whether pixels that are no light are refused, or clamped: negative ones and NaN
            to 0, infinite ones to the largest finite value.
        notes: Takes what was clamped.

    Raises:
        ImageError: It cannot be read, is no latlong map, or holds bad pixels.
        UsdSkinError: An unknown color space.
    """
    names = read_headers(path)[0].channel_names
    image = read_image(path, channels=_rgb_channels(path, names))
    height, width = image.pixels.shape[:2]
    said = str(image.attributes.get("textureformat", ""))  # OpenImageIO's name of EXR's envmap
    if "Environment" in said and not said.startswith("LatLong"):
        raise ImageError(f"{path}: a {said}, which cannot be read yet; convert it to latlong")
    if abs(width / height / 2.0 - 1.0) > _ASPECT_TOLERANCE:
        raise ImageError(
            f"{path}: {width} x {height} pixels are not twice as wide as high, so no latlong map; "
            "convert it"
        )
    if color_space is None:
        known = image.color_space in color_space_names()
        fallback = "srgb_rec709_scene" if image.sample_type in _INTEGER_SAMPLES else None
        color_space = (image.color_space if known else fallback) or "lin_rec709_scene"
    linear = linear_color_space(color_space)
    pixels = _mended(path, linearize(image.pixels, color_space), bad_pixels, notes)
    if pixels.shape[2] == 1:
        pixels = np.repeat(pixels, 3, axis=2)
    return Environment(pixels, linear)


def _rgb_channels(path: Path, names: tuple[str, ...]) -> tuple[str, ...]:
    if {"R", "G", "B"} <= set(names):
        return ("R", "G", "B")
    grey = [name for name in names if name != "A"]
    if len(grey) == 1:
        return (grey[0],)
    shown = ", ".join(names[:8])
    raise ImageError(f"{path}: no channels R, G, B; it has {shown}; give an RGB picture")


def _mended(path: Path, pixels: FloatImage, bad_pixels: BadPixels, notes: list[Note]) -> FloatImage:
    if float(pixels.min()) >= 0.0 and np.isfinite(float(pixels.max())):
        return pixels
    with np.errstate(invalid="ignore"):
        bad = ~(np.isfinite(pixels) & (pixels >= 0.0))
    texels = bad.any(axis=-1)
    row, column = np.argwhere(texels)[0]
    values = ", ".join(f"{float(value):g}" for value in pixels[row, column])
    found = f"{int(texels.sum())} of {texels.size} pixels are no light, first {values} at x "
    found += f"{column}, y {row}"
    if bad_pixels == "error":
        raise ImageError(f"{path}: {found}; mend the map, or let --bad-pixels clamp do it")
    finite = pixels[np.isfinite(pixels)]
    largest = max(float(finite.max()), 0.0) if finite.size else 0.0
    mended = np.nan_to_num(pixels, nan=0.0, posinf=largest, neginf=0.0)
    said = f"{found}; set to 0"
    if np.isinf(pixels).any():
        said += f", infinite ones to the largest finite value {largest:g}"
    notes.append(Note("bad-pixels-clamped", str(path), said))
    return np.maximum(mended, np.float32(0.0))
