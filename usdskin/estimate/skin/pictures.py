"""The photographs of skin in camera values: merged from brackets, or as somebody made them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import ImageError, LayerError
from usdskin.images import read_headers, read_image
from usdskin.notes import Note
from usdskin.photographs.development import find_responses
from usdskin.photographs.frames import RAW_SUFFIXES
from usdskin.photographs.merge import CLIPPED, MOVED, merge_bracket
from usdskin.prims.samples import SkinSamples
from usdskin.prims.views import Shot

FloatImage = NDArray[np.float32]
Mask = NDArray[np.bool_]

_FLOATING = {"half", "float", "double"}


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One photograph in camera values."""

    values: FloatImage
    """rho [1/s, or the unit of the file], shape [height, width, 3]."""

    variance: FloatImage | None
    """Variance of the values; None: the picture does not tell. Shape [height, width, 3]."""

    lost: Mask
    """Pixels that are saturated, or moved between the exposures, shape [height, width]."""

    where: str
    """What it was made from, for errors."""


@dataclass(frozen=True, slots=True)
class _Views:
    """The brackets of a sample layer, as ``find_responses`` takes them."""

    views: tuple[Shot, ...]


def picture_names(samples: SkinSamples) -> list[str]:
    """Return the names of the photographs, in order; empty: there are none.

    Raises:
        LayerError: There are images and views too.
    """
    if samples.images and samples.views:
        raise LayerError(
            f"{samples.where}: has both samples:images and samples:views; keep the ones to be "
            "measured"
        )
    return [image.name for image in samples.images] or [view.name for view in samples.views]


def open_pictures(
    samples: SkinSamples, workers: Workers, scratch: Path, notes: list[Note]
) -> Iterator[Picture]:
    """Give the photographs one after another.

    Args:
        samples: What names them: images that hold camera values, or views with brackets.
        workers: Where kernels run.
        scratch: Folder for decoded raw files.
        notes: Takes what does not stop it.

    Raises:
        LayerError: Exposures or levels contradict the pictures.
        ImageError: A photograph cannot be read, or holds no camera values.
    """
    for image in samples.images:
        values = _read(image)
        lost: Mask = np.zeros(values.shape[:2], bool)
        if samples.saturation > 0.0:
            lost = np.asarray((values >= np.float32(samples.saturation)).any(axis=-1))
        yield Picture(values, None, lost, str(image))
    if not samples.views:
        return
    names = [view.name for view in samples.views]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise LayerError(f'{samples.where}: two views are called "{twice}"; rename one')
    fisheye = next((view for view in samples.views if view.lens is not None), None)
    if fisheye is not None:
        raise LayerError(
            f"{fisheye.where}: has FisheyeCameraAPI, but its geometry is rendered without "
            "distortion; undistort the photographs and take the schema off"
        )
    responses = find_responses(_Views(samples.views), scratch, notes)
    for view in samples.views:
        merged = merge_bracket(view, workers, scratch, responses.get(view.name), None, notes)
        moved = (merged.status & (CLIPPED | MOVED)) != 0
        yield Picture(merged.values, merged.variance, moved, view.where)


def _read(path: Path) -> FloatImage:
    """Read a picture that holds camera values already."""
    hint = "name a Camera with ExposureBracketAPI by samples:views, or give a floating-point EXR"
    what = ""
    if path.suffix.lower() in RAW_SUFFIXES:
        what = "is a raw photograph"
    else:
        kinds = set(read_headers(path)[0].channel_types)
        what = "" if kinds <= _FLOATING else f"holds {' and '.join(sorted(kinds))}"
    if what:
        raise ImageError(
            f"{path}: {what}, so its values depend on an exposure it does not tell; {hint}"
        )
    pixels = read_image(path, channels=("R", "G", "B")).pixels
    finite = np.isfinite(pixels).all(axis=-1)
    if not finite.all():
        y, x = (int(index) for index in np.argwhere(~finite)[0])
        raise ImageError(
            f"{path}: the pixel at x {x}, y {y} is {pixels[y, x].tolist()}; write the picture "
            "again with finite values"
        )
    return pixels


def read_mask(path: Path, size: tuple[int, int]) -> Mask:
    """Return where a photograph may be used.

    Args:
        path: Image that is above 0.5 there, in any of its channels but alpha.
        size: Height and width it must have [px].

    Raises:
        ImageError: The file is missing or broken, has another size, or leaves nothing.
    """
    image = read_image(path)
    colors = [k for k, name in enumerate(image.channel_names) if name != "A"] or [0]
    mask = np.asarray((image.pixels[..., colors] > 0.5).any(axis=-1))
    check_size(path, mask.shape, size)
    if not mask.any():
        raise ImageError(
            f"{path}: is nowhere above 0.5, so the mask leaves nothing; paint white where the "
            "photograph may be used"
        )
    return mask


def check_size(where: str | Path, found: tuple[int, ...], size: tuple[int, int]) -> None:
    """Refuse a picture of another size than its geometry.

    Args:
        where: The picture, for errors.
        found: Its height and width [px].
        size: Height and width of the geometry [px].

    Raises:
        ImageError: They differ.
    """
    if tuple(found[:2]) != size:
        raise ImageError(
            f"{where}: has {found[1]} x {found[0]} pixels, but its geometry {size[1]} x "
            f"{size[0]}; render the geometry in the size of the photograph"
        )
