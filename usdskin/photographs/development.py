"""Which photographs of a shoot were developed with a curve, and what that curve is."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Protocol

import numpy as np

from usdskin.errors import LayerError
from usdskin.notes import Note
from usdskin.photographs.frames import RAW_SUFFIXES, open_frame
from usdskin.photographs.response import (
    Response,
    read_response,
    recover_response,
    sample_pixels,
)
from usdskin.prims.views import Bracketed


class Photographed(Protocol):
    """A ``Shoot``, or whatever else holds brackets one camera took."""

    @property
    def views(self) -> Sequence[Bracketed]:
        """The brackets; their names differ."""


def find_responses(shoot: Photographed, scratch: Path, notes: list[Note]) -> dict[str, Response]:
    """Return the response of every view whose raw values do not follow exposure.

    A response file wins; else ``bracket:transfer`` says whether a curve is to be recovered, and
    ``auto`` asks for one where the photographs have 8 bits. One camera took all views, so a curve
    is recovered from all of those that share their exposures.

    Args:
        shoot: The shoot.
        scratch: Folder for decoded files; the caller removes it.
        notes: Takes which curves were recovered.

    Returns:
        Responses by the name of the view; linear views have none.

    Raises:
        LayerError: A response file cannot be used, or the pictures do not tell the curve.
        ImageError: A photograph cannot be read.
    """
    found: dict[str, Response] = {}
    developed: dict[tuple[float, ...], list[Bracketed]] = {}
    for view in shoot.views:
        if view.bracket.response_file is not None:
            found[view.name] = read_response(view.bracket.response_file)
        elif _is_developed(view, scratch):
            key = tuple(float(value) for value in view.bracket.exposure)
            developed.setdefault(key, []).append(view)
    for views in developed.values():
        response = _recover(views, scratch)
        found |= {view.name: response for view in views}
        names = ", ".join(view.name for view in views)
        notes.append(
            Note(
                "response-recovered",
                views[0].where,
                f"the photographs of {names} have 8 bits, so the curve they were developed with "
                "was recovered from their exposures; raw files are more exact",
            )
        )
    return found


def _is_developed(view: Bracketed, scratch: Path) -> bool:
    if view.bracket.transfer != "auto":
        return view.bracket.transfer == "recovered"
    first = view.bracket.images[0]
    if first.suffix.lower() in RAW_SUFFIXES:
        return False
    with open_frame(first, scratch) as frame:
        return bool(frame.sample_type == "uint8")


def _recover(views: list[Bracketed], scratch: Path) -> Response:
    samples = []
    full_scale = 0.0
    for view in views:
        frames = [open_frame(image, scratch) for image in view.bracket.images]
        try:
            sizes = {(frame.width, frame.height) for frame in frames}
            if len(sizes) > 1:
                listed = " and ".join(f"{width} x {height}" for width, height in sorted(sizes))
                raise LayerError(
                    f"{view.where}: its photographs have {listed} pixels; take one size"
                )
            full_scale = frames[0].full_scale
            given = view.bracket.white_level
            white = full_scale if given is None else float(np.mean(given))
            samples.append(sample_pixels(frames, float(np.mean(view.bracket.black_level)), white))
        finally:
            for frame in frames:
                frame.close()
    return recover_response(
        views[0], np.concatenate(samples, axis=1), views[0].bracket.exposure, full_scale
    )
