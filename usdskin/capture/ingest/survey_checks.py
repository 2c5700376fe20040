"""What must hold of the photographs of a shoot, and what their taker should be told."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

from usdskin.capture.ingest.exif import Photo
from usdskin.capture.ingest.exposure_table import TABLE_COLUMNS, TABLE_NAME
from usdskin.capture.ingest.image_circle import corner_level
from usdskin.capture.ingest.options import IngestOptions
from usdskin.capture.ingest.pixels import SATURATED, Look
from usdskin.capture.ingest.sequences import Setting, exposure_of, setting_of
from usdskin.capture.viewpoints import Direction
from usdskin.errors import ImageError
from usdskin.notes import Note

Views = Mapping[str, Sequence[Photo]]

_KINDS = {"uint8": "8-bit", "uint16": "16-bit", "raw": "raw"}

_ROLLS_DEG = {1: 0.0, 3: 180.0, 6: -90.0, 8: 90.0}
"""How far the camera was turned, its top to the left, by the EXIF orientation [deg]."""

_PILE_SHARE = 1e-3
_BLACK = 0.01
_LEAST_WHITE = 0.1
_PEDESTAL = 2e-4  # of white


def kind_of(photo: Photo) -> str:
    """Return what kind of values a photograph holds, in words."""
    return _KINDS.get(photo.sample_type, "floating-point")


def shown_time(seconds: float) -> str:
    """Return an exposure time as a camera shows it: ``1/60 s``, ``2 s``."""
    if seconds < 0.3 and math.isclose(1.0 / seconds, round(1.0 / seconds), rel_tol=0.01):
        return f"1/{round(1.0 / seconds)} s"
    return f"{seconds:.3g} s"


def shown_share(count: int, total: int) -> str:
    """Return a share in per cent with two figures: ``0.0031 %``, ``60 %``, ``0``."""
    return f"{float(f'{100.0 * count / total:.2g}'):.6g} %" if count else "0"


def check_exposures(directory: Path, photos: Sequence[Photo]) -> None:
    """Refuse photographs without an exposure, or with one that cannot be.

    Raises:
        ImageError: The message names the first photographs, and what tells their exposure instead.
    """
    kinds = (
        ("exposure_time_s", "exposure time", "each "),
        ("iso", "ISO", "one for all with --iso, or each "),
        ("f_number", "f-number", "one for all with --f-number, or each "),
    )
    columns = f"(columns {','.join(TABLE_COLUMNS)})"
    for field, name, for_all in kinds:
        for photo in photos:
            value = getattr(photo, field)
            if value is not None and not (math.isfinite(value) and value > 0.0):
                raise ImageError(
                    f"{photo.path}: states the {name} {value:g}, which cannot be; state it in "
                    f"{directory / TABLE_NAME} {columns}"
                )
        untold = [photo.path for photo in photos if getattr(photo, field) is None]
        if untold:
            listed = ", ".join(str(path.relative_to(directory)) for path in untold[:3])
            more = f" and {len(untold) - 3} more" if len(untold) > 3 else ""
            raise ImageError(
                f"{directory}: {len(untold)} of {len(photos)} photographs do not tell their {name} "
                f"({listed}{more}); state {for_all}in {TABLE_NAME} {columns}"
            )


def check_one_camera(photos: Sequence[Photo]) -> None:
    """Refuse photographs of several cameras or lenses.

    Raises:
        ImageError: The message names a photograph of each.
    """
    for field, name in (("model", "camera"), ("lens", "lens")):
        counts = Counter(getattr(photo, field) for photo in photos if getattr(photo, field))
        if len(counts) > 1:
            (usual, many), (other, few) = counts.most_common(2)
            paths = [
                next(photo.path for photo in photos if getattr(photo, field) == value)
                for value in (other, usual)
            ]
            raise ImageError(
                f"{paths[0]}: was taken with the {name} {other} ({few} photographs), but "
                f"{paths[1]} with {usual} ({many}); a shoot has one {name}: keep each in a folder "
                "of its own"
            )


def check_view(name: str, photos: Sequence[Photo], notes: list[Note]) -> None:
    """Refuse a view whose photographs differ in size or kind.

    Args:
        name: Its name.
        photos: Its photographs.
        notes: Takes a bracket that is none, or that changes the aperture.

    Raises:
        ImageError: The message names two that differ.
    """
    first = photos[0]
    for photo in photos[1:]:
        if (photo.width, photo.height) != (first.width, first.height):
            raise ImageError(
                f"{photo.path}: has {photo.width} x {photo.height} pixels, but {first.path} of the "
                f"same view {first.width} x {first.height}; a view has one size: take one of them "
                "out"
            )
        if kind_of(photo) != kind_of(first):
            raise ImageError(
                f"{photo.path}: holds {kind_of(photo)} values, but {first.path} of the same view "
                f"{kind_of(first)} ones, which have no common scale; choose one kind with --only"
            )
    if len({setting_of(photo) for photo in photos}) == 1:
        text = "has a single exposure, which holds lamps and shadows only in an even light"
        notes.append(Note("no-bracket", name, text))
    apertures = sorted({photo.f_number for photo in photos if photo.f_number is not None})
    if len(apertures) > 1:
        text = (
            f"changes the aperture from f/{apertures[0]:g} to f/{apertures[-1]:g}, and vignetting "
            "with it; bracket the exposure time"
        )
        notes.append(Note("aperture-changes", name, text))


def note_missing(views: Views, notes: list[Note]) -> None:
    """Tell exposures that at least half of the views have and others lack."""
    settings = {name: {setting_of(photo) for photo in photos} for name, photos in views.items()}
    counts: Counter[Setting] = Counter()
    for found in settings.values():
        counts.update(found)
    shown = {setting_of(photo): photo for photos in views.values() for photo in photos}
    usual = [setting for setting in shown if counts[setting] * 2 >= len(views)]
    for name, found in settings.items():
        missing = [_shown_setting(shown[setting]) for setting in usual if setting not in found]
        if missing:
            text = f"lacks the exposure {', '.join(missing)} that other views have"
            notes.append(Note("exposure-missing", name, text))


def _shown_setting(photo: Photo) -> str:
    time = shown_time(photo.exposure_time_s or 0.0)
    nd = f" ND {photo.nd_factor:g}" if photo.nd_factor != 1.0 else ""
    return f"{time} f/{photo.f_number:g} ISO {photo.iso:g}{nd}"


def note_pictures(directory: Path, photos: Sequence[Photo], notes: list[Note]) -> None:
    """Tell signs that pictures are not as the camera's sensor made them."""
    if any(photo.white_balance == "auto" for photo in photos):
        text = (
            "white balance was automatic, so colors may differ from picture to picture; take raw "
            "photographs, or set it by hand"
        )
        notes.append(Note("auto-white-balance", str(directory), text))
    developed = [photo for photo in photos if photo.sample_type == "uint16" and photo.profile]
    if developed and "linear" not in developed[0].profile.lower():
        text = (
            f"has the color profile {developed[0].profile}, so it may be developed with a curve; "
            "16-bit pictures are taken to be linear unless --transfer says recovered"
        )
        notes.append(Note("developed-picture", str(developed[0].path), text))


def mount_roll(
    directory: Path, views: Views, directions: Sequence[Direction], notes: list[Note]
) -> float:
    """Return how far the camera was turned about its axis on its mount, its top to the left [deg].

    The pictures' orientation tells. Cameras that look up or down guess it, so they have no say.

    Args:
        directory: Folder of the photographs, for the note.
        views: The photographs by view.
        directions: Where the views look.
        notes: Takes an orientation that is not upright, or not the same in all pictures.

    Raises:
        ImageError: A picture is mirrored.
    """
    photos = [photo for group in views.values() for photo in group]
    for photo in photos:
        if photo.orientation not in _ROLLS_DEG:
            raise ImageError(
                f"{photo.path}: its EXIF orientation {photo.orientation} says it is stored "
                "mirrored; save it as the camera made it"
            )
    groups = list(zip(views.values(), directions, strict=True))
    level = [photo for group, where in groups if where.is_level for photo in group]
    counts = Counter(photo.orientation for photo in level or photos)
    usual, many = counts.most_common(1)[0]
    roll = _ROLLS_DEG[usual]
    if roll or len(counts) > 1:
        text = (
            f"EXIF orientation is {usual} in {many} of {counts.total()} pictures, so the camera is "
            f"taken to have been mounted {_MOUNTED[roll]} in all views; pixels stay as they are "
            "stored"
        )
        notes.append(Note("orientation", str(directory), text))
    return roll


_MOUNTED = {
    0.0: "upright",
    180.0: "upside down",
    -90.0: "on its side, its top to the right",
    90.0: "on its side, its top to the left",
}


def note_looks(
    views: Views, looks: Mapping[Path, Look], options: IngestOptions, notes: list[Note]
) -> None:
    """Tell what the pixels say about exposures and levels: too long, too short, or mislabelled."""
    if options.white_level is None:
        _note_early_saturation(views, looks, notes)
    if options.black_level is None:
        _note_pedestal(views, looks, notes)
    for name, photos in views.items():
        shortest = min(photos, key=lambda photo: looks[photo.path].saturated)
        look = looks[shortest.path]
        if look.saturated:
            text = (
                f"{shown_share(look.saturated, look.pixels)} of the pixels are saturated even in "
                f"{shortest.path.name}, {_shown_setting(shortest)}: light is missing there; add a "
                "darker photograph, or measure the lamp"
            )
            notes.append(Note("lamp-clipped", name, text))
        brightest = max(photos, key=lambda photo: looks[photo.path].largest)
        reached = looks[brightest.path].largest / looks[brightest.path].full_scale
        if reached < _BLACK:
            text = (
                f"is black: {brightest.path.name} reaches {reached:.2%} of the white level; was "
                "the lens covered?"
            )
            notes.append(Note("black-view", name, text))


def _note_early_saturation(views: Views, looks: Mapping[Path, Look], notes: list[Note]) -> None:
    """Tell a raw value below white at which different exposures end, as a sensor's white level."""
    for photos in views.values():
        ends: dict[float, set[Setting]] = {}
        for photo in photos:
            look = looks[photo.path]
            reached = look.largest / look.full_scale
            if look.largest_share > _PILE_SHARE and _LEAST_WHITE < reached < SATURATED:
                ends.setdefault(look.largest, set()).add(setting_of(photo))
        for level, settings in ends.items():
            if len(settings) > 1:
                look = looks[photos[0].path]
                text = (
                    f"{len(settings)} different exposures end at the raw "
                    f"value {level:g}, below the white level {look.full_scale:g}; if the sensor "
                    f"saturates there, state --white-level {level:g}"
                )
                notes.append(Note("white-level", str(photos[0].path.parent), text))
                return


def _note_pedestal(views: Views, looks: Mapping[Path, Look], notes: list[Note]) -> None:
    """Tell a raw value outside the image circle that does not grow with exposure."""
    photos = sorted(next(iter(views.values())), key=exposure_of)
    if len(photos) < 2 or photos[0].sample_type != "uint16":
        return
    dark, brighter = (
        corner_level(looks[photo.path].thumbnail) * looks[photo.path].full_scale
        for photo in photos[:2]
    )
    if dark > _PEDESTAL * looks[photos[0].path].full_scale and brighter < 1.1 * dark:
        text = (
            f"corners hold the raw value {dark:.0f} in the shortest exposures; if that is without "
            f"light, state --black-level {dark:.0f}"
        )
        notes.append(Note("black-level", str(photos[0].path), text))
