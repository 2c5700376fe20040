"""What a folder of photographs holds: the views of a shoot, their brackets, lens and directions.

Reads: the photographs' headers and pixels, ``exposures.csv`` beside them and a lens layer.
"""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.ingest.exif import Photo, read_photo
from usdskin.capture.ingest.exposure_table import TABLE_NAME, TableRow, apply_row, read_table
from usdskin.capture.ingest.folder import list_photos, natural
from usdskin.capture.ingest.options import IngestOptions
from usdskin.capture.ingest.pixels import Look, look_at
from usdskin.capture.ingest.sequences import in_order, split_brackets
from usdskin.capture.ingest.survey_checks import (
    check_exposures,
    check_one_camera,
    check_view,
    mount_roll,
    note_looks,
    note_missing,
    note_pictures,
)
from usdskin.capture.ingest.survey_guesses import aim_views, find_lens, read_lens_layer
from usdskin.capture.viewpoints import Direction
from usdskin.errors import LayerError, UsageError
from usdskin.fisheye import scaled
from usdskin.notes import Note
from usdskin.prims import ExposureBracket, FisheyeLens, Shoot, View
from usdskin.progress import Progress, SilentProgress

# isort: split
# After ours, which register the schemas.
from pxr import Tf

_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


@dataclass(frozen=True, slots=True, eq=False)
class Survey:
    """What a folder was understood to hold."""

    directory: Path
    """The folder."""

    shoot: Shoot
    """The shoot, as its layer is going to say."""

    directions: tuple[Direction, ...]
    """Where each view looks."""

    looks: Mapping[Path, Look]
    """What the pixels tell, by file."""

    lens_layer: Path | None
    """Layer that the lens is referenced from; None: the lens is the views' own."""

    inputs: tuple[Path, ...]
    """Every file the survey was made from."""


def survey(
    directory: Path,
    options: IngestOptions,
    notes: list[Note],
    progress: Progress | None = None,
) -> Survey:
    """Find out what a folder of photographs holds.

    Sub-folders are views. In a flat folder brackets are told apart by pauses and by the repetition
    of exposure settings.

    Args:
        directory: The folder.
        options: What it does not tell.
        notes: Takes what was assumed, skipped, or needs attention.
        progress: Told how far the reading is.

    Raises:
        UsageError: The folder has no photographs, or the options do not fit them.
        ImageError: A photograph is broken or contradicts the others.
        LayerError: The table or the lens layer cannot be used.
    """
    progress = progress or SilentProgress()
    unused = [path for path in (options.dark, options.flat) if path is not None]
    files = list_photos(directory, options.only, unused, notes)
    table = read_table(directory)
    progress.start(sum(map(len, files.values())), "read headers")
    photos = {
        folder: [_told(path, table.get(path), options, notes, progress) for path in paths]
        for folder, paths in files.items()
    }
    photos = _with_settings(directory, photos, table, notes)
    every = [photo for group in photos.values() for photo in group]
    check_exposures(directory, every)
    check_one_camera(every)
    views = _grouped(directory, photos, table)
    for name, bracket in views.items():
        check_view(name, bracket, notes)
    note_missing(views, notes)
    note_pictures(directory, every, notes)
    names = _prim_names(directory, views)
    directions = aim_views(directory, views, options, notes)
    roll = mount_roll(directory, views, directions, notes)
    lens = None if options.lens is None else read_lens_layer(options.lens)
    looks = _looks(every, options, progress)
    note_looks(views, looks, options, notes)
    if lens is None:
        lens = find_lens(directory, views, looks, options, notes)
    built = [
        _view(directory, prim_name, name, bracket, direction.rotation(roll), lens, options)
        for prim_name, (name, bracket), direction in zip(
            names, views.items(), directions, strict=True
        )
    ]
    shoot = replace(_shoot(directory, every, options), views=tuple(built))
    given = [directory / TABLE_NAME] if table else []
    given += [path for path in (options.lens, *unused) if path is not None]
    inputs = (*(photo.path for photo in every), *given)
    return Survey(directory, shoot, directions, looks, options.lens, inputs)


# --- Photographs and views ---------------------------------------------------------------------


def _told(
    path: Path,
    row: TableRow | None,
    options: IngestOptions,
    notes: list[Note],
    progress: Progress,
) -> Photo:
    photo = replace(read_photo(path), nd_factor=options.nd_factor)
    progress.advance()
    photo = apply_row(photo, row, notes)
    return replace(photo, iso=photo.iso or options.iso, f_number=photo.f_number or options.f_number)


def _with_settings(
    directory: Path,
    photos: Mapping[str | None, list[Photo]],
    table: Mapping[Path, TableRow],
    notes: list[Note],
) -> dict[str | None, list[Photo]]:
    """Leave out folders of pictures that no camera made, beside those of photographs."""
    kept = {
        folder: group
        for folder, group in photos.items()
        if any(photo.exposure_time_s is not None or photo.path in table for photo in group)
    }
    if not kept:
        return dict(photos)
    for folder in photos.keys() - kept.keys():
        text = (
            f"not used: none of its {len(photos[folder])} pictures tells an exposure time; list "
            f"them in {TABLE_NAME} if they are a view"
        )
        notes.append(Note("skipped-folder", str(directory / str(folder)), text))
    return kept


def _grouped(
    directory: Path,
    photos: Mapping[str | None, list[Photo]],
    table: Mapping[Path, TableRow],
) -> dict[str, list[Photo]]:
    """Return the photographs of each view in the order they were taken, by the view's name."""
    every = [photo for group in photos.values() for photo in group]
    named = {photo.path: table[photo.path].view for photo in every if photo.path in table}
    if any(named.values()):
        views: dict[str, list[Photo]] = {}
        for photo in in_order(every):
            view = named.get(photo.path)
            if view is None:
                raise LayerError(
                    f"{directory / TABLE_NAME}: names the views of some photographs but not of "
                    f"{photo.path.relative_to(directory)}; fill in its column view"
                )
            views.setdefault(view, []).append(photo)
        return dict(sorted(views.items(), key=lambda item: natural(item[0])))
    if None in photos:
        brackets = split_brackets(in_order(photos[None]))
        return {f"view{index}": bracket for index, bracket in enumerate(brackets, start=1)}
    return {str(folder): in_order(group) for folder, group in photos.items()}


def _prim_names(directory: Path, views: Iterable[str]) -> list[str]:
    names: dict[str, str] = {}
    for view in views:
        name = str(Tf.MakeValidIdentifier(f"view{view}" if view[:1].isdigit() else view))
        if name in names:
            raise UsageError(
                f'{directory}: the views "{names[name]}" and "{view}" would both be called {name}; '
                "rename one"
            )
        names[name] = view
    return list(names)


def _view(
    directory: Path,
    prim_name: str,
    name: str,
    photos: Sequence[Photo],
    rotation: NDArray[np.float64],
    lens: FisheyeLens,
    options: IngestOptions,
) -> View:
    size = (photos[0].width, photos[0].height)
    return View(
        name=prim_name,
        where=f"{directory} ({name})",
        lens=scaled(lens, size, str(options.lens or f"{directory} ({name})")),
        bracket=_bracket(photos, options),
        rotation=rotation,
    )


def _bracket(photos: Sequence[Photo], options: IngestOptions) -> ExposureBracket:
    return ExposureBracket(
        images=tuple(photo.path for photo in photos),
        exposure_time_s=_values(photos, lambda photo: photo.exposure_time_s),
        iso=_values(photos, lambda photo: photo.iso),
        f_number=_values(photos, lambda photo: photo.f_number),
        nd_factor=_values(photos, lambda photo: photo.nd_factor),
        black_level=np.array([options.black_level or 0.0]),
        white_level=None if options.white_level is None else np.array([options.white_level]),
        transfer=options.transfer,
        dark_file=options.dark,
        flat_file=options.flat,
    )


def _values(photos: Sequence[Photo], value: Callable[[Photo], float | None]) -> NDArray[np.float64]:
    return np.array([value(photo) for photo in photos], dtype=np.float64)


def _shoot(directory: Path, photos: Sequence[Photo], options: IngestOptions) -> Shoot:
    first = next((photo for photo in in_order(photos) if photo.moment is not None), None)
    model = next((photo.model for photo in photos if photo.model), "")
    lens = next((photo.lens for photo in photos if photo.lens), "")
    lux, facing = options.illuminance or (0.0, None)
    nits, looking = options.luminance or (0.0, None)
    return Shoot(
        where=str(directory),
        name="Shoot",
        views=(),
        session=directory.resolve().name if options.session is None else options.session,
        device=", ".join(part for part in (model, lens) if part),
        time=""
        if first is None or first.moment is None
        else first.moment.isoformat("T", "seconds"),
        model=model,
        lens=lens,
        white_balance=next((photo.white_balance for photo in photos if photo.white_balance), ""),
        illuminance_lx=lux,
        illuminance_direction=None if facing is None else facing.vector,
        luminance=nits,
        luminance_direction=None if looking is None else looking.vector,
    )


# --- Pixels ------------------------------------------------------------------------------------


def _looks(photos: Sequence[Photo], options: IngestOptions, progress: Progress) -> dict[Path, Look]:
    scratch = Path(tempfile.gettempdir())

    def look(photo: Photo) -> Look:
        return look_at(photo, scratch, options.black_level, options.white_level)

    progress.start(len(photos), "look at pixels")
    looks = _in_threads(look, photos, options.threads, progress)
    progress.done()
    return {photo.path: found for photo, found in zip(photos, looks, strict=True)}


def _in_threads(
    work: Callable[[_Item], _Result],
    items: Sequence[_Item],
    threads: int | None,
    progress: Progress,
) -> list[_Result]:
    """Return the results in order; the first failure, or an interrupt, stops the rest."""
    with ThreadPoolExecutor(threads or os.cpu_count() or 1) as pool:
        tasks = [pool.submit(work, item) for item in items]
        results = []
        try:
            for task in tasks:
                results.append(task.result())
                progress.advance()
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return results
