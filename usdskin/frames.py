"""Frame ranges as people type them, and frame numbers in file names."""

from __future__ import annotations

import re
from decimal import Decimal
from pathlib import Path

from usdskin.errors import UsageError

FRAME_LIMIT = 1_000_000
"""More frames than this in one range are taken for a typing mistake."""

_NUMBER = r"-?(?:\d+(?:\.\d*)?|\.\d+)"
_ITEM = re.compile(rf"({_NUMBER})(?:[-:]({_NUMBER})(?:[:x]({_NUMBER}))?)?")
_PLACEHOLDER = re.compile(r"(#{2,})(?:\.(#+))?")
_FOREIGN_PLACE = re.compile(r"%0?([1-9]?)d|\$F([1-9]?)")


def parse_frames(text: str) -> tuple[float, ...]:
    """Return the frames a range names, in the order given and each once.

    ``1-240``, ``1-240:2``, ``1:240x2``, ``1,5,9`` and mixtures such as ``13-19:3,30``; frames and
    steps may be negative or fractional. A range counts down when it ends before it starts.

    Raises:
        UsageError: The text is not a range of frames.
    """
    frames: dict[float, None] = {}
    for item in text.split(","):
        for frame in _parse_item(item.strip(), text):
            frames[frame] = None
    return tuple(frames)


def _parse_item(item: str, text: str) -> list[float]:
    match = _ITEM.fullmatch(item)
    if match is None:
        raise UsageError(
            f"-f/--frames {text!r}: {item!r} is not a frame or a range of frames; "
            "write 12, 1-240, 1-240:2, 1:240x2 or several with commas between."
        )
    first, last, step = (None if part is None else Decimal(part) for part in match.groups())
    assert first is not None
    if last is None:
        return [float(first)]
    if step is None:
        step = Decimal(1) if last >= first else Decimal(-1)
    if step == 0 or (last - first) * step < 0:
        raise UsageError(
            f"-f/--frames {text!r}: a step of {step} never gets from {first} to {last}; "
            "give a step towards the end of the range."
        )
    count = int((last - first) / step) + 1
    if count > FRAME_LIMIT:
        raise UsageError(
            f"-f/--frames {text!r}: {count} frames; at most {FRAME_LIMIT} are rendered at once."
        )
    return [float(first + step * index) for index in range(count)]


def has_placeholder(path: Path | str) -> bool:
    """Return whether a file's name has a place for the frame number (``####``)."""
    return _PLACEHOLDER.search(Path(path).name) is not None


def with_placeholder(path: Path) -> str:
    """Return a file name that has a place for the frame number, as a hint.

    ``%04d`` and ``$F4``, as other programs write the place, become ``####``.
    """
    foreign = _FOREIGN_PLACE.search(path.name)
    if foreign is None:
        return f"{path.stem}.####{path.suffix}"
    place = "#" * max(2, int(foreign[1] or foreign[2] or 4))
    return path.name[: foreign.start()] + place + path.name[foreign.end() :]


def frame_path(template: Path | str, frame: float | None) -> Path:
    """Return the file of one frame.

    ``####`` becomes the frame padded with zeros to at least as many characters, and ``###.###``
    keeps as many digits after the point. A name without a place stays as it is.

    Args:
        template: Path whose file name may hold one place for the frame number.
        frame: Frame number; None where the picture has none.

    Raises:
        UsageError: The name has two places, or the frame does not fit the one it has.
    """
    template = Path(template)
    places = list(_PLACEHOLDER.finditer(template.name))
    if not places:
        return template
    if len(places) > 1:
        raise UsageError(
            f"{template}: {len(places)} places for a frame number; the file name takes one, "
            "such as out.####.exr."
        )
    place = places[0]
    if frame is None:
        raise UsageError(
            f"{template}: the name asks for a frame number and the stage has no time range; "
            "give the frames with -f."
        )
    number = _format_frame(frame, len(place[1]), len(place[2] or ""), template)
    return template.with_name(
        template.name[: place.start()] + number + template.name[place.end() :]
    )


def _format_frame(frame: float, whole_digits: int, fraction_digits: int, template: Path) -> str:
    number = Decimal(repr(float(frame)))
    rounded = round(number, fraction_digits)
    if rounded != number:
        raise UsageError(
            f"{template}: frame {number.normalize():f} does not fit the place for its number; "
            "write ###.### with as many # after the point as the frames have digits."
        )
    width = whole_digits + (fraction_digits + 1 if fraction_digits else 0)
    return f"{rounded + 0:0{width}.{fraction_digits}f}"
