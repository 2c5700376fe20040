"""Where the views of a shoot look and through which lens, as far as photographs tell."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from usdskin.capture.ingest.exif import Photo
from usdskin.capture.ingest.image_circle import Circle, find_circle_of_brackets, guess_lens
from usdskin.capture.ingest.options import IngestOptions
from usdskin.capture.ingest.pixels import Look
from usdskin.capture.viewpoints import (
    Direction,
    directions_of_names,
    evenly_around,
    parse_directions,
)
from usdskin.errors import LayerError, UsageError
from usdskin.layers import open_stage
from usdskin.notes import Note
from usdskin.prims import FisheyeLens, read_lens


def aim_views(
    directory: Path,
    views: Mapping[str, Sequence[Photo]],
    options: IngestOptions,
    notes: list[Note],
) -> tuple[Direction, ...]:
    """Return where the views look: as told, by compass, by the folders' names, or evenly around.

    Raises:
        UsageError: The directions told are not as many as the views.
    """
    if options.views is not None:
        directions = parse_directions(options.views)
        if len(directions) != len(views):
            found = ", ".join(f"{name} with {len(group)}" for name, group in views.items())
            raise UsageError(
                f"--views {options.views}: names {len(directions)} views, but {directory} holds "
                f"{len(views)}: {found} photographs; name as many, or keep each view in a folder"
            )
        return directions
    firsts = [group[0] for group in views.values()]
    if all(photo.heading_deg is not None for photo in firsts):
        source = "read from the compass in the pictures"
        directions = tuple(
            Direction(-(photo.heading_deg or 0.0) % 360.0, photo.pitch_deg or 0.0)
            for photo in firsts
        )
    elif (told := directions_of_names(list(views))) is not None:
        source, directions = "read from the names of the folders", told
    else:
        source = "taken to be evenly around, for pictures do not tell"
        directions = evenly_around(len(views))
    listed = ", ".join(map(str, directions))
    text = (
        f"directions of the views are {source}: {listed} deg, counted to the left; --views states "
        "them"
    )
    notes.append(Note("directions-assumed", str(directory), text))
    return directions


def read_lens_layer(path: Path) -> FisheyeLens:
    """Return the lens that a layer is about, that of its default prim.

    Raises:
        LayerError: The layer cannot be used.
    """
    stage = open_stage(path)
    prim = stage.GetDefaultPrim()
    if not prim or not prim.HasAPI("FisheyeCameraAPI"):
        raise LayerError(
            f"{path}: its default prim is no Camera with FisheyeCameraAPI; give a layer that "
            "`usdskin calibrate lens` wrote, or set defaultPrim"
        )
    return read_lens(prim)


def find_lens(
    directory: Path,
    views: Mapping[str, Sequence[Photo]],
    looks: Mapping[Path, Look],
    options: IngestOptions,
    notes: list[Note],
) -> FisheyeLens:
    """Return a lens guessed from the image circle.

    Raises:
        LayerError: The projection does not reach the field.
    """
    first = next(iter(views.values()))[0]
    size = (first.width, first.height)
    alike = [
        sorted(
            (looks[photo.path] for photo in group),
            key=lambda look: float(look.thumbnail.mean()),
            reverse=True,
        )
        for group in views.values()
        if (group[0].width, group[0].height) == size
    ]
    found = find_circle_of_brackets([[look.thumbnail for look in group] for group in alike])
    circle = None if found is None else Circle(*(alike[0][0].cell_px * value for value in found))
    lens = guess_lens(circle, size, options.projection, options.field_deg)
    if circle is None:
        what = "no image circle shows, so the field was taken to span the diagonal"
    else:
        what = f"the image circle is at {circle.x:.0f}, {circle.y:.0f} with a radius of "
        what += f"{circle.radius:.0f} px"
    text = (
        f"the lens is guessed to be {options.projection} with a field of {options.field_deg:g} "
        f"deg: {what}; calibrate it and give --lens, or state --projection and --fov"
    )
    notes.append(Note("lens-guessed", str(directory), text))
    return lens
