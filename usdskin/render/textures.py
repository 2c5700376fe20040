"""Read textures as mip pyramids and pack them for a kernel.

The rules are those of UsdUVTexture (UsdPreviewSurface specification, "Texture Reader"). Rows stay
in file order: row 0 is the top of the picture. USD's texture coordinates have their origin at the
bottom left, so a lookup at ``t`` reads row ``(1 - t) * height - 0.5``; columns are ``s * width -
0.5``. ``sample_texture`` is that lookup in plain NumPy, the reference for kernels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.colorimetry import (
    color_space_names,
    decode_srgb,
    linear_color_space,
    linearize,
    rgb_to_xyz,
    xyz_to_rgb,
)
from usdskin.errors import ImageError, LayerError
from usdskin.images import Image, read_image

FloatArray = NDArray[np.float32]
Vector4 = tuple[float, float, float, float]

WRAP_MODES = ("repeat", "clamp", "mirror", "black")
"""Wrap modes of a texture; a kernel knows them by their position here."""

_METADATA_WRAP_MODES = {"periodic": "repeat", **{mode: mode for mode in WRAP_MODES}}
_PYRAMID = 4.0 / 3.0  # all levels together against the first
_MIB = 2.0**20


@dataclass(frozen=True, slots=True, eq=False)
class Texture:
    """A picture at all its sizes, linear, with what surrounds it."""

    path: str
    """File it was read from."""

    levels: tuple[FloatArray, ...]
    """R, G, B, A with scale and bias applied, the first row at the top; each level has half the
    size of the one before, rounded down, the last one 1 x 1. Shape [height, width, 4] each."""

    wrap_s: str
    """One of ``WRAP_MODES``."""

    wrap_t: str
    """One of ``WRAP_MODES``."""

    border: Vector4 = (0.0, 0.0, 0.0, 0.0)
    """What wrap mode ``black`` reads outside: black with scale and bias applied."""


@dataclass(frozen=True, slots=True, eq=False)
class PackedTextures:
    """Textures side by side in flat arrays."""

    texels: FloatArray
    """Texels of all levels, row after row, shape [texel_count, 4]."""

    levels: NDArray[np.int32]
    """Offset of the first texel, width and height of each level; 0 beyond a texture's last. Shape
    [texture_count, most levels of a texture, 3]."""

    info: NDArray[np.int32]
    """Number of levels, ``WRAP_MODES`` index for s and for t, shape [texture_count, 3]."""

    borders: FloatArray
    """Value outside for wrap mode ``black``, shape [texture_count, 4]."""


def read_texture(
    path: str,
    source_color_space: str = "auto",
    scale: Vector4 = (1.0, 1.0, 1.0, 1.0),
    bias: Vector4 = (0.0, 0.0, 0.0, 0.0),
    wrap_s: str = "useMetadata",
    wrap_t: str = "useMetadata",
    *,
    rendering_space: str | None = None,
    channels: tuple[int, ...] | None = None,
    max_mb: int = 2048,
) -> Texture:
    """Return a texture with its mip pyramid.

    Args:
        path: Resolved path of the file, or ``package.usdz[member]``.
        source_color_space: ``raw``, ``sRGB``, ``auto`` (8-bit pictures of 3 or 4 channels are sRGB,
            others raw unless the file names its color space), or USD's name of a color space.
        scale: Factor for R, G, B, A [1].
        bias: Added to R, G, B, A after scaling [1].
        wrap_s: ``black``, ``clamp``, ``repeat``, ``mirror``, or ``useMetadata`` (what the file
            says, else black).
        wrap_t: The same for t.
        rendering_space: Color space to convert colors to; pictures read as raw are not converted.
        channels: Indices of up to four channels to read as R, G, B, A, for maps of parameters or
            weights. By default gray is spread over R, G, B, and alpha is 1 where there is none.
        max_mb: Refuse textures that need more memory than this [MiB].

    Raises:
        ImageError: The file is missing, broken, too large or not finite.
        LayerError: A setting that UsdUVTexture does not know.
    """
    _check_settings(path, source_color_space, {"wrapS": wrap_s, "wrapT": wrap_t})
    image = read_image(path, max_mb)
    need_mb = image.pixels.shape[0] * image.pixels.shape[1] * 16 * _PYRAMID / _MIB
    if need_mb > max_mb:
        raise ImageError(
            f"{path}: as a texture it needs {need_mb:.0f} MiB; the limit is {max_mb} MiB."
        )
    _check_finite(path, image.pixels)
    rgba = _rgba(path, image, channels)
    if channels is None:
        _to_linear(rgba, image, source_color_space, rendering_space)
    if tuple(scale) != (1.0,) * 4 or tuple(bias) != (0.0,) * 4:
        rgba *= np.asarray(scale, np.float32)
        rgba += np.asarray(bias, np.float32)
    return Texture(
        path=str(path),
        levels=mip_pyramid(rgba),
        wrap_s=_wrap_mode(image, wrap_s, 0),
        wrap_t=_wrap_mode(image, wrap_t, 1),
        border=(float(bias[0]), float(bias[1]), float(bias[2]), float(bias[3])),
    )


def mip_pyramid(pixels: FloatArray) -> tuple[FloatArray, ...]:
    """Return a picture and its reductions down to one pixel, by an exact area (box) filter.

    Each level has half the size of the one before, rounded down. A pixel of a reduced axis of odd
    length 2m + 1 covers 2 + 1/m source pixels: its three weights are (m - i), m and (i + 1) over
    2m + 1 (Guthe and Heckbert, "Non-Power-of-Two Mipmap Creation", NVIDIA 2005). Every level has
    the picture's mean.

    Args:
        pixels: Shape [height, width, channel_count].
    """
    levels = [np.ascontiguousarray(pixels, dtype=np.float32)]
    while max(levels[-1].shape[:2]) > 1:
        levels.append(np.ascontiguousarray(_halved(_halved(levels[-1], 0), 1)))
    return tuple(levels)


def pack_textures(textures: Sequence[Texture]) -> PackedTextures:
    """Return textures as flat arrays for a kernel.

    Raises:
        ImageError: There are more texels than 32-bit offsets reach.
    """
    count = sum(level.shape[0] * level.shape[1] for item in textures for level in item.levels)
    if count >= 2**31:
        raise ImageError(f"the {len(textures)} textures hold {count} texels; the limit is 2^31.")
    most = max((len(texture.levels) for texture in textures), default=1)
    packed = PackedTextures(
        texels=np.empty((count, 4), np.float32),
        levels=np.zeros((len(textures), most, 3), np.int32),
        info=np.zeros((len(textures), 3), np.int32),
        borders=np.zeros((len(textures), 4), np.float32),
    )
    offset = 0
    for index, texture in enumerate(textures):
        wraps = [WRAP_MODES.index(mode) for mode in (texture.wrap_s, texture.wrap_t)]
        packed.info[index] = (len(texture.levels), *wraps)
        packed.borders[index] = texture.border
        for row, level in enumerate(texture.levels):
            height, width = level.shape[:2]
            packed.levels[index, row] = (offset, width, height)
            packed.texels[offset : offset + width * height] = level.reshape(-1, 4)
            offset += width * height
    return packed


def sample_texture(texture: Texture, st: ArrayLike, level: int = 0) -> NDArray[np.float64]:
    """Return the bilinear lookup of a texture at one level.

    Args:
        texture: The texture.
        st: Texture coordinates, origin at the bottom left, shape [..., 2].
        level: Level of the pyramid.

    Returns:
        R, G, B, A, shape [..., 4].
    """
    texels = texture.levels[level]
    height, width = texels.shape[:2]
    coordinates = np.asarray(st, np.float64)
    x = coordinates[..., 0] * width - 0.5
    y = (1.0 - coordinates[..., 1]) * height - 0.5
    left, top = np.floor(x).astype(np.int64), np.floor(y).astype(np.int64)
    total = np.zeros((*coordinates.shape[:-1], 4))
    for column, along_x in ((left, left + 1 - x), (left + 1, x - left)):
        for row, along_y in ((top, top + 1 - y), (top + 1, y - top)):
            i, inside_s = _wrapped(column, width, texture.wrap_s)
            j, inside_t = _wrapped(row, height, texture.wrap_t)
            value = np.where((inside_s & inside_t)[..., None], texels[j, i], texture.border)
            total += (along_x * along_y)[..., None] * value
    return total


def _wrapped(
    index: NDArray[np.int64], size: int, mode: str
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return texel indices inside the picture, and where the picture is read at all."""
    everywhere = np.ones(index.shape, bool)
    if mode == "repeat":
        return index % size, everywhere
    if mode == "mirror":
        period = index % (2 * size)
        return np.minimum(period, 2 * size - 1 - period), everywhere
    clamped = np.clip(index, 0, size - 1)
    return clamped, everywhere if mode == "clamp" else clamped == index


def _halved(pixels: FloatArray, axis: int) -> FloatArray:
    length = pixels.shape[axis]
    if length == 1:
        return pixels
    moved = np.moveaxis(pixels, axis, 0)
    count = length // 2
    first, second = moved[0 : 2 * count : 2], moved[1 : 2 * count : 2]
    if length % 2 == 0:
        half: FloatArray = (first + second) * np.float32(0.5)
    else:
        shape = (count,) + (1,) * (moved.ndim - 1)
        i = np.arange(count, dtype=np.float32).reshape(shape)
        half = (first * (count - i) + second * np.float32(count) + moved[2::2] * (i + 1)) / length
    return np.moveaxis(half.astype(np.float32, copy=False), 0, axis)


def _check_settings(path: str, source_color_space: str, wraps: dict[str, str]) -> None:
    spaces = ("auto", "raw", "sRGB", *color_space_names())
    if source_color_space not in spaces:
        raise LayerError(
            f"{path}: sourceColorSpace is {source_color_space!r}; use {', '.join(spaces[:3])}."
        )
    for name, mode in wraps.items():
        if mode not in (*WRAP_MODES, "useMetadata"):
            choices = ", ".join((*WRAP_MODES, "useMetadata"))
            raise LayerError(f"{path}: {name} is {mode!r}; use {choices}.")


def _check_finite(path: str, pixels: FloatArray) -> None:
    if np.isfinite(pixels.min()) and np.isfinite(pixels.max()):  # NaN comes through both
        return
    bad = ~np.isfinite(pixels).all(axis=2)
    row, column = np.argwhere(bad)[0]
    raise ImageError(
        f"{path}: {int(bad.sum())} pixels are not finite, the first in column {column}, row "
        f"{row}; a texture must be finite, so export it again."
    )


def _rgba(path: str, image: Image, channels: tuple[int, ...] | None) -> FloatArray:
    height, width, count = image.pixels.shape
    rgba = np.zeros((height, width, 4), np.float32)
    if channels is not None:
        if len(channels) > 4 or not all(0 <= channel < count for channel in channels):
            raise ImageError(
                f"{path}: has {count} channels, but {max(channels) + 1} are needed, one for each "
                "weight; export it with all of them."
            )
        rgba[..., : len(channels)] = image.pixels[..., list(channels)]
        return rgba
    names = [name.rpartition(".")[2].upper() for name in image.channel_names]
    rgba[..., 3] = image.pixels[..., names.index("A")] if "A" in names else 1.0
    colors = [index for index, name in enumerate(names) if name != "A"] or [0]
    if len(colors) < 3:
        # One channel, or two of which UsdUVTexture gives no meaning to the second: gray.
        rgba[..., :3] = image.pixels[..., colors[0], np.newaxis]
    else:
        named = [names.index(name) for name in "RGB" if name in names]
        for target, source in enumerate(named if len(named) == 3 else colors[:3]):
            rgba[..., target] = image.pixels[..., source]
    return rgba


def _to_linear(
    rgba: FloatArray, image: Image, source_color_space: str, rendering_space: str | None
) -> None:
    """Decode and convert R, G, B in place."""
    source = _color_space_of(image, source_color_space)
    if source is None:
        return
    if source == "srgb_rec709_scene" and image.sample_type == "uint8":
        table = decode_srgb(np.arange(256, dtype=np.float32) / np.float32(255.0))
        for channel in range(3):
            codes = (rgba[..., channel] * np.float32(255.0) + np.float32(0.5)).astype(np.uint8)
            rgba[..., channel] = table[codes]
    elif linear_color_space(source) != source:
        rgba[..., :3] = linearize(rgba[..., :3], source)
    linear = linear_color_space(source)
    if rendering_space is not None and linear != rendering_space:
        matrix = xyz_to_rgb(rendering_space) @ rgb_to_xyz(linear)
        rgba[..., :3] = rgba[..., :3] @ matrix.T.astype(np.float32)


def _color_space_of(image: Image, source_color_space: str) -> str | None:
    """Return the color space of R, G, B; None where they are taken as they are."""
    if source_color_space == "raw":
        return None
    if source_color_space == "sRGB":
        return "srgb_rec709_scene"
    if source_color_space != "auto":
        return source_color_space
    if image.sample_type == "uint8":
        return "srgb_rec709_scene" if image.pixels.shape[2] in (3, 4) else None
    is_float = image.sample_type in ("half", "float", "double")
    return image.color_space if is_float and image.color_space in color_space_names() else None


def _wrap_mode(image: Image, mode: str, axis: int) -> str:
    if mode != "useMetadata":
        return mode
    stated = str(image.attributes.get("wrapmodes", "")).split(",")
    return _METADATA_WRAP_MODES.get(stated[min(axis, len(stated) - 1)].strip(), "black")
