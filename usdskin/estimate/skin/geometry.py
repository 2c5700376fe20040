"""What every pixel of a photograph shows: its normal and the way to the camera.

Reads: EXR files with the parts N and P that ``usdskin render --aov N --aov P`` wrote.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError
from usdskin.images import ImageHeader, read_headers, read_image

FloatImage = NDArray[np.float32]
Mask = NDArray[np.bool_]

LEAST_FACING = 0.2
"""Least N.V of a pixel: beyond, it is seen so flat that half a pixel changes its normal."""

_MOST_TURN_DEG = 25.0  # between the normals of neighbours on one smooth surface
_LARGEST_STEP = 3.0  # times what a pixel sees of a surface at that slant
_NEIGHBOURS = [(y, x) for y in (-1, 0, 1) for x in (-1, 0, 1) if (y, x) != (0, 0)]


@dataclass(frozen=True, slots=True, eq=False)
class Geometry:
    """The geometry of one photograph."""

    normal: FloatImage
    """Unit normals in the world, 0 where nothing is seen, shape [height, width, 3]."""

    view: FloatImage
    """Unit vectors towards the camera, in the world, shape [height, width, 3]."""

    inside: Mask
    """Pixels well inside a smooth surface that faces the camera, shape [height, width]."""

    turn: FloatImage
    """Sine of the angle between a pixel's normal and its neighbours', the largest per pixel [1],
    shape [height, width]."""

    path: Path
    """The file."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [px]."""
        return self.normal.shape[0], self.normal.shape[1]


def read_geometry(path: Path) -> Geometry:
    """Return the geometry of a photograph.

    Args:
        path: EXR file with the parts N and P in the world, and ``worldToCamera`` in its header.

    Raises:
        ImageError: The file is missing or broken, lacks a part or the camera, or shows nothing.
    """
    headers = read_headers(path)
    normal, _ = _part(path, headers, "N")
    position, header = _part(path, headers, "P")
    seen = np.isfinite(normal).all(axis=-1) & np.isfinite(position).all(axis=-1)
    seen &= np.abs(np.square(normal).sum(axis=-1) - 1.0) < 1e-2
    if not seen.any():
        raise ImageError(
            f"{path}: no pixel has a unit normal in part N, so the picture shows nothing; render "
            "the stage from the photograph's camera"
        )
    normal = np.where(seen[..., None], normal, np.float32(0.0))
    position = np.where(seen[..., None], position, np.float32(0.0))
    view = _towards_camera(path, header, position)
    facing = np.einsum("hwc,hwc->hw", normal, view)
    joined, turn = _continuity(normal, position, facing, seen)
    # A photograph lies half a pixel off at times: one pixel more keeps clear of edges.
    inside = _eroded(joined) & (facing > LEAST_FACING)
    if not inside.any():
        raise ImageError(
            f"{path}: no pixel lies well inside a smooth surface; render the geometry larger, "
            "and photograph the object so that it fills the picture"
        )
    return Geometry(normal, view, inside, turn, path)


def _part(
    path: Path, headers: tuple[ImageHeader, ...], name: str
) -> tuple[FloatImage, ImageHeader]:
    wanted = tuple(f"{name}.{axis}" for axis in "XYZ")
    for index, header in enumerate(headers):
        if set(wanted) <= set(header.channel_names):
            return read_image(path, part=index, channels=wanted).pixels, header
    found = ", ".join(header.name or "unnamed" for header in headers)
    raise ImageError(
        f"{path}: has no part {name} (it has {found}); write it by `usdskin render --aov N --aov P`"
    )


def _towards_camera(path: Path, header: ImageHeader, position: FloatImage) -> FloatImage:
    matrix = header.attributes.get("worldToCamera", header.attributes.get("worldtocamera"))
    if matrix is None:
        raise ImageError(
            f"{path}: its header has no worldToCamera, so it does not tell where the camera was; "
            "render it again"
        )
    # OpenEXR's matrices multiply row vectors from the right.
    to_camera = np.array(matrix, dtype=np.float64).reshape(4, 4).T
    rotation = to_camera[:3, :3]
    off = np.abs(rotation @ rotation.T - np.eye(3)).max()
    if not np.isfinite(to_camera).all() or off > 1e-3:
        raise ImageError(
            f"{path}: worldToCamera in its header is no rotation and translation, so the "
            "positions are no metres; render it again"
        )
    if header.attributes.get("usdskin/projection") == "orthographic":
        return np.broadcast_to(rotation[2].astype(np.float32), position.shape)
    way = (-rotation.T @ to_camera[:3, 3]).astype(np.float32) - position
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    return np.asarray(way / np.maximum(length, np.float32(1e-12)))


def _continuity(
    normal: FloatImage, position: FloatImage, facing: NDArray[np.floating], seen: Mask
) -> tuple[Mask, FloatImage]:
    """Return which pixels have all neighbours on one smooth surface, and how far normals turn."""
    steps, turns = [], []
    joined = seen.copy()
    for shift in _NEIGHBOURS:
        joined &= _shifted(seen, shift)
        away = _shifted(position, shift) - position
        cosine = np.einsum("hwc,hwc->hw", normal, _shifted(normal, shift))
        rise = np.abs(np.einsum("hwc,hwc->hw", normal, away))
        length = np.linalg.norm(away, axis=-1)
        limit = np.radians(_MOST_TURN_DEG)
        joined &= (cosine > np.cos(limit)) & (rise <= np.sin(limit) * length + 1e-9)
        steps.append(length)
        turns.append(np.sqrt(np.maximum(1.0 - cosine**2, 0.0)))
    slant = np.maximum(facing, 0.5 * LEAST_FACING)
    if joined.any():
        sharp = np.max(steps, axis=0) * slant
        joined &= sharp <= _LARGEST_STEP * np.median(sharp[joined])
    return joined, np.max(turns, axis=0).astype(np.float32)


def _shifted(array: NDArray[Any], shift: tuple[int, int]) -> NDArray[Any]:
    """Return what lies beside every pixel; 0 or False beyond the edge."""
    result = np.zeros_like(array)
    height, width = array.shape[:2]
    y, x = shift
    result[max(-y, 0) : height - max(y, 0), max(-x, 0) : width - max(x, 0)] = array[
        max(y, 0) : height - max(-y, 0), max(x, 0) : width - max(-x, 0)
    ]
    return result


def _eroded(mask: Mask) -> Mask:
    result = mask.copy()
    for shift in _NEIGHBOURS:
        result &= _shifted(mask, shift)
    return result


def dilated(mask: Mask) -> Mask:
    """Return a mask grown by one pixel.

    Args:
        mask: Shape [height, width].
    """
    result = mask.copy()
    for shift in _NEIGHBOURS:
        result |= _shifted(mask, shift)
    return result
