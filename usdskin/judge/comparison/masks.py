"""Which pixels of two pictures are judged, and into which regions they fall.

A mask is where every rule holds: covered by the subject (alpha), inside a matte from a file, bright
enough, or seen on prims and materials of given names (the parts primId and Cryptomatte).
"""

from __future__ import annotations

import fnmatch
import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import ImageError, UsageError
from usdskin.images import read_image
from usdskin.judge.comparison.files import ComparedPicture, read_alpha
from usdskin.notes import Note

Mask = NDArray[np.bool_]
FloatArray = NDArray[np.float64]

FULL_COVERAGE = 0.999
"""Coverage from which on a pixel shows the subject alone: float sums of equal samples reach it."""

ID_PARTS = ("primId", "crypto_object", "crypto_material")
"""Parts that tell what a pixel shows, in the order in which names are looked for."""

_LUMINANCE = "luminance:"

NO_ID = "(none)"
"""Region of the pixels that show nothing with a name."""


@dataclass(frozen=True, slots=True, eq=False)
class Labels:
    """What the pixels of a picture show."""

    index: NDArray[np.int64]
    """Index of the name, shape [height, width]."""

    names: tuple[str, ...]
    """``NO_ID`` first."""

    coverage: FloatArray | None = None
    """How much of the pixel is that, where the part tells, shape [height, width]."""


def read_labels(picture: ComparedPicture, part: str) -> Labels | None:
    """Return what pixels show by a part of the picture; None where it has no such part.

    A Cryptomatte's pixel shows what covers most of it.

    Args:
        picture: The picture.
        part: One of ``ID_PARTS``.

    Raises:
        ImageError: The part is there but does not tell its names.
    """
    if part == "primId":
        return _prim_labels(picture)
    return _matte_labels(picture, part)


def _prim_labels(picture: ComparedPicture) -> Labels | None:
    found = picture.data("primId")
    if found is None:
        return None
    file, part = found
    table = str(file.parts[part].attributes.get("usdskin/primIds", ""))
    names: dict[int, str] = {}
    for line in table.splitlines():
        number, _, name = line.partition(" ")
        if number.isdigit() and name:
            names[int(number)] = name
    ids = read_image(file.path, part=part, channels=("primId",)).pixels[..., 0].astype(np.int64)
    used = np.unique(ids[ids > 0])
    unnamed = [int(k) for k in used if int(k) not in names]
    if unnamed:
        raise ImageError(
            f"{file.path}: primId {unnamed[0]} has no name in the header (usdskin/primIds); "
            "render it with usdskin, or give a mask."
        )
    lookup = np.zeros(int(ids.max(initial=0)) + 1, np.int64)
    lookup[used] = np.arange(1, used.size + 1)
    return Labels(lookup[ids], (NO_ID, *(names[int(k)] for k in used)))


def _matte_labels(picture: ComparedPicture, matte: str) -> Labels | None:
    first = picture.data(f"{matte}00")
    if first is None:
        return None
    file, part = first
    names = _manifest(file.parts[part].attributes, matte)
    if names is None:
        raise ImageError(
            f"{file.path}: {matte} has no readable manifest in the header; render it with "
            "--aov cryptomatte, or give a mask."
        )
    channels = [f"{matte}00.{c}" for c in "RG"]
    pixels = read_image(file.path, part=part, channels=channels).pixels
    ids = np.ascontiguousarray(pixels[..., 0]).view(np.uint32)
    covered = pixels[..., 1] > 0.0
    used = np.unique(ids[covered])
    index = np.zeros(ids.shape, np.int64)
    if used.size:
        index = np.where(covered, np.searchsorted(used, ids).clip(0, used.size - 1) + 1, 0)
    shown = (names.get(int(k), f"{int(k):08x}") for k in used)
    return Labels(index, (NO_ID, *shown), pixels[..., 1].astype(np.float64))


def _manifest(attributes: dict[str, Any], matte: str) -> dict[int, str] | None:
    for key, value in attributes.items():
        if key.startswith("cryptomatte/") and key.endswith("/name") and str(value) == matte:
            text = attributes.get(key.removesuffix("name") + "manifest", "")
            try:
                return {int(code, 16): str(name) for name, code in json.loads(str(text)).items()}
            except (ValueError, AttributeError):
                return None
    return None


def _matches(name: str, wanted: str) -> bool:
    """Return whether a path is wanted, lies below a wanted one, or fits a pattern."""
    return (
        name == wanted
        or name.startswith(wanted.rstrip("/") + "/")
        or fnmatch.fnmatchcase(name, wanted)
    )


def selected(picture: ComparedPicture, wanted: Sequence[str]) -> Mask:
    """Return the pixels that show prims or materials of given names.

    Args:
        picture: Picture with the parts; a Cryptomatte's pixel counts where it shows nothing else.
        wanted: Paths, those above them, or patterns such as ``*/Head``.

    Raises:
        UsageError: A name fits nothing that the picture shows.
    """
    labels = [found for found in (read_labels(picture, part) for part in ID_PARTS) if found]
    if not labels:
        raise UsageError(
            f"--select: {picture.path} does not tell what its pixels show; render it with "
            "--aov primId or --aov cryptomatte."
        )
    mask = np.zeros(labels[0].index.shape, dtype=bool)
    for pattern in wanted:
        for part in labels:
            hits = [k for k, name in enumerate(part.names) if k and _matches(name, pattern)]
            if hits:
                of_part = np.isin(part.index, hits)
                if part.coverage is not None:
                    of_part &= part.coverage >= FULL_COVERAGE
                mask |= of_part
                break
        else:
            shown = dict.fromkeys(name for part in labels for name in part.names[1:])
            there = f"there are {', '.join(shown)}" if shown else "the picture shows no prim at all"
            raise UsageError(f"--select {pattern}: nothing of that name is seen; {there}.")
    return mask


def read_matte(path: Path, size: tuple[int, int]) -> Mask:
    """Return where a picture is white: its first channel is at least a half.

    Raises:
        ImageError: It cannot be read, or is of another size.
    """
    pixels = read_image(path).pixels[..., 0]
    height, width = pixels.shape
    if (width, height) != size:
        raise ImageError(
            f"{path}: the mask has {width} x {height} pixels, the pictures {size[0]} x {size[1]}; "
            "make it of their size."
        )
    return np.asarray(pixels >= 0.5)


def covered(truth: ComparedPicture, picture: ComparedPicture) -> Mask | None:
    """Return the pixels that the subject covers in both pictures; None where neither has alpha."""
    alphas = [alpha for alpha in (read_alpha(truth), read_alpha(picture)) if alpha is not None]
    if not alphas:
        return None
    # What is not finite stays, to be refused.
    return np.asarray(~np.any([alpha < FULL_COVERAGE for alpha in alphas], axis=0))


def judged_pixels(
    first: ComparedPicture,
    second: ComparedPicture,
    masks: Sequence[str],
    select: Sequence[str],
    notes: list[Note],
) -> tuple[Mask, str]:
    """Return the mask of all rules but those of luminance, and how it was chosen.

    Args:
        first: The truth.
        second: The picture that is judged, of the same size.
        masks: Rules (``CompareOptions.masks``).
        select: Prims and materials (``CompareOptions.select``).
        notes: Takes the note that nothing is masked.

    Raises:
        ImageError: A matte cannot be read or is of another size.
        UsageError: A rule cannot be followed.
    """
    width, height = first.size
    mask = np.ones((height, width), dtype=bool)
    said: list[str] = []
    rules = [rule for rule in masks if not rule.startswith(_LUMINANCE)]
    if "" in rules:
        raise UsageError("--mask: give alpha, all, luminance:SHARE or the name of a picture.")
    if not rules:
        rules = ["alpha"] if covered(first, second) is not None else ["all"]
        if rules == ["all"] and not (masks or select):
            notes.append(
                Note(
                    "no-mask",
                    str(first.path),
                    "the pictures have no alpha, so every pixel counts, dark background too.",
                )
            )
    for rule in rules:
        if rule == "all":
            said.append("all pixels")
        elif rule == "alpha":
            alpha = covered(first, second)
            if alpha is None:
                raise UsageError("--mask alpha: neither picture has an alpha channel.")
            mask &= alpha
            said.append("alpha")
        else:
            mask &= read_matte(Path(rule), first.size)
            said.append(Path(rule).name)
    if select:
        mask &= selected(first, select)
        named = " or ".join(select)
        said.append(f"({named})" if len(select) > 1 else named)
    return mask, " and ".join(said) or "all pixels"


def bright_pixels(
    mask: Mask, mask_from: str, luminance: FloatArray, masks: Sequence[str]
) -> tuple[Mask, str]:
    """Return the mask with its rules of luminance.

    Args:
        mask: What ``judged_pixels`` returned.
        mask_from: How it was chosen.
        luminance: Of the truth as a share of Y_n, shape [height, width].
        masks: Rules (``CompareOptions.masks``).

    Raises:
        UsageError: A share is no number.
    """
    for rule in masks:
        if not rule.startswith(_LUMINANCE):
            continue
        number = rule.removeprefix(_LUMINANCE)
        try:
            share = float(number)
        except ValueError:
            share = np.nan
        if not share >= 0.0:
            raise UsageError(f"--mask {rule}: the share of Y_n is a number from 0 on.")
        with np.errstate(invalid="ignore"):
            mask = mask & ~(luminance < share)  # what is not finite stays, to be refused
        mask_from += f" and Y >= {share:g} Y_n in the truth"
    return mask, mask_from


def check_mask(mask: Mask, mask_from: str, truth: ComparedPicture) -> None:
    """Refuse a mask without a pixel.

    Raises:
        ImageError: It is empty.
    """
    if not mask.any():
        raise ImageError(f"{truth.path}: the mask ({mask_from}) holds no pixel; choose another.")
