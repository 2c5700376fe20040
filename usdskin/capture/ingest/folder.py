"""The photographs in a folder, and which of them belong to which view as far as folders tell."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterable, Mapping
from fnmatch import fnmatch
from pathlib import Path

from usdskin.capture.ingest.exposure_table import TABLE_NAME
from usdskin.errors import UsageError
from usdskin.notes import Note
from usdskin.photographs.frames import RAW_SUFFIXES

PICTURE_SUFFIXES = frozenset((".tif", ".tiff", ".exr", ".png", ".jpg", ".jpeg"))
"""Endings of the names of photographs that are not raw, in lower case."""

_DUMP = re.compile(r"\d{3}[A-Z0-9_]{5}")
"""A camera's own folder, such as 100CANON (DCF, JEITA CP-3461, 3.2.2)."""


def natural(path: Path | str) -> list[tuple[int, str]]:
    """Return the key that sorts IMG_2 before IMG_10."""
    parts = re.split(r"(\d+)", str(path))
    return [(int(part), "") if part.isdecimal() else (-1, part.lower()) for part in parts]


def list_photos(
    directory: Path, only: str | None, unused: Iterable[Path], notes: list[Note]
) -> dict[str | None, list[Path]]:
    """Return the photographs of a folder by sub-folder, those of one folder in natural order.

    Args:
        directory: Folder with the photographs, or with a sub-folder for every view.
        only: Take files whose name fits this pattern, such as ``*.tif``.
        unused: Files that are no photographs of a view: dark frame and flat field.
        notes: Takes what is not used.

    Returns:
        Photographs by the name of their view, in natural order; under None alone where sub-folders
        do not tell views.

    Raises:
        UsageError: There is no such folder, it has no photographs, or they lie beside sub-folders.
    """
    if not directory.is_dir():
        what = "is a file" if directory.exists() else "does not exist"
        raise UsageError(f"{directory}: {what}; name the folder with the photographs")
    passed_over: Counter[str] = Counter()
    ignored = {path.resolve() for path in unused}
    folders = sorted(
        (item for item in directory.iterdir() if item.is_dir() and not item.name.startswith(".")),
        key=lambda item: natural(item.name),
    )
    found = {
        folder: _photos_in(folder, only, ignored, passed_over) for folder in (directory, *folders)
    }
    found = {folder: photos for folder, photos in found.items() if photos}
    if passed_over:
        listed = ", ".join(f"{count} {kind}" for kind, count in sorted(passed_over.items()))
        notes.append(Note("skipped-files", str(directory), f"not used: {listed}"))
    if not found:
        kinds = ".tif, .exr, .png, .jpg or a raw format"
        which = f"no photograph fits --only {only}" if only else f"has no photographs ({kinds})"
        raise UsageError(f"{directory}: {which}; name the folder with the photographs of a shoot")
    return _by_view(directory, found)


def _photos_in(
    folder: Path, only: str | None, ignored: set[Path], passed_over: Counter[str]
) -> list[Path]:
    photos = []
    for path in sorted(folder.iterdir(), key=lambda item: natural(item.name)):
        suffix = path.suffix.lower()
        if not path.is_file() or path.name == TABLE_NAME or path.resolve() in ignored:
            continue
        if path.name.startswith("."):
            passed_over["hidden"] += 1
        elif suffix not in PICTURE_SUFFIXES | RAW_SUFFIXES:
            passed_over[suffix or "without ending"] += 1
        elif only and not fnmatch(path.name.lower(), only.lower()):
            passed_over[f"that do not fit {only}"] += 1
        else:
            _check_name(path)
            photos.append(path)
    raw = {path.stem for path in photos if path.suffix.lower() in RAW_SUFFIXES}
    kept = [path for path in photos if path.stem not in raw or path.suffix.lower() in RAW_SUFFIXES]
    if len(kept) < len(photos):
        passed_over["beside a raw file of the same name"] += len(photos) - len(kept)
    return kept


def _check_name(path: Path) -> None:
    try:
        str(path).encode("utf-8")
    except UnicodeEncodeError:
        raise UsageError(
            f"{str(path)!a}: its name is not UTF-8, so no layer can hold it; rename it"
        ) from None


def _by_view(directory: Path, found: Mapping[Path, list[Path]]) -> dict[str | None, list[Path]]:
    folders = [folder for folder in found if folder != directory]
    if directory in found and folders:
        raise UsageError(
            f"{directory}: has {len(found[directory])} photographs itself and more in its folder "
            f"{folders[0].name}; keep the views in folders of their own, or all photographs in one"
        )
    is_dump = all(_DUMP.fullmatch(folder.name) for folder in folders)
    if directory in found or len(folders) == 1 or is_dump:
        return {None: [path for photos in found.values() for path in photos]}
    return {folder.name: found[folder] for folder in folders}
