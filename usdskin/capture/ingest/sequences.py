"""Split photographs taken one after another into the brackets of views."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from datetime import timedelta
from itertools import pairwise

from usdskin.capture.ingest.exif import Photo

_LONG_PAUSE_S = 2.0
_CLEAR_RATIO = 2.0
_ALIKE = 0.6

Setting = tuple[str, ...]
"""An exposure setting: photographs with equal ones are repeated, not bracketed."""


def setting_of(photo: Photo) -> Setting:
    """Return the exposure setting of a photograph."""
    values = (photo.exposure_time_s, photo.iso, photo.f_number, photo.nd_factor)
    return tuple(f"{value:.3g}" for value in values if value is not None)


def exposure_of(photo: Photo) -> float:
    """Return t (ISO / 100) / N^2 / ND of a photograph that tells all of them [s]."""
    time, iso, number = photo.exposure_time_s, photo.iso, photo.f_number
    return (time or 0.0) * (iso or 0.0) / 100.0 / (number or 1.0) ** 2 / photo.nd_factor


def in_order(photos: Sequence[Photo]) -> list[Photo]:
    """Return photographs in the order they were taken, that given where not all tell it."""
    moments = [photo.moment for photo in photos]
    if None in moments:
        return list(photos)
    # One camera has one clock; offsets from UTC may be told by some photographs only.
    return sorted(photos, key=lambda photo: photo.moment.replace(tzinfo=None))  # type: ignore[union-attr]


def split_brackets(photos: Sequence[Photo]) -> list[list[Photo]]:
    """Split the photographs of a shoot into brackets, one for each view.

    Where the pauses between photographs are clearly of two kinds and split them into brackets of
    about the same settings, they tell. Else a bracket ends where its settings begin anew, so one
    that lacks a photograph ends in the right place too.

    Args:
        photos: Photographs in the order they were taken.

    Returns:
        The brackets, in order; none is empty.
    """
    cuts = _cuts_at_pauses(photos)
    if cuts is None:
        cuts = _cuts_at_repetition([setting_of(photo) for photo in photos])
    bounds = [0, *cuts, len(photos)]
    return [list(photos[begin:end]) for begin, end in pairwise(bounds)]


def _cuts_at_pauses(photos: Sequence[Photo]) -> list[int] | None:
    pauses = _pauses(photos)
    if pauses is None:
        return None
    settings = [setting_of(photo) for photo in photos]
    longest = sorted(range(1, len(photos)), key=lambda index: -pauses[index - 1])
    for count in range(1, len(longest) + 1):
        least = pauses[longest[count - 1] - 1]
        following = pauses[longest[count] - 1] if count < len(longest) else 0.0
        if least < _LONG_PAUSE_S:
            return None
        cuts = sorted(longest[:count])
        if least >= _CLEAR_RATIO * following and _are_alike(settings, cuts):
            return cuts
    return None


def _pauses(photos: Sequence[Photo]) -> list[float] | None:
    """Return the time from the end of each photograph to the beginning of the next [s]."""
    pauses = []
    for photo, following in pairwise(photos):
        if photo.moment is None or following.moment is None:
            return None
        passed: timedelta = following.moment.replace(tzinfo=None) - photo.moment.replace(
            tzinfo=None
        )
        pauses.append(max(passed.total_seconds() - (photo.exposure_time_s or 0.0), 0.0))
    return pauses


def _are_alike(settings: Sequence[Setting], cuts: Sequence[int]) -> bool:
    """Tell whether all brackets have most of the settings, and none has much else."""
    brackets = [set(settings[a:b]) for a, b in pairwise([0, *cuts, len(settings)])]
    common = Counter(setting for bracket in brackets for setting in bracket)
    usual = {setting for setting, count in common.items() if 2 * count >= len(brackets)}
    return len(usual) > 1 and all(
        len(bracket & usual) >= _ALIKE * len(usual) for bracket in brackets
    )


def _cuts_at_repetition(settings: Sequence[Setting]) -> list[int]:
    seen: list[Setting] = []
    brackets = []
    for setting in settings:
        if setting in seen:
            brackets.append(seen)
            seen = []
        seen.append(setting)
    brackets.append(seen)
    place = {setting: index for index, setting in enumerate(_whole(brackets))}
    cuts = []
    last = -1
    for index, setting in enumerate(settings):
        at = place.get(setting, last + 1)
        if at <= last:
            cuts.append(index)
        last = at
    return cuts


def _whole(brackets: Sequence[list[Setting]]) -> list[Setting]:
    """Return the settings of a whole bracket in the order they were taken.

    That is the longest one; if it began in the middle, for the first photograph of the shoot is
    missing, it ascends or descends once it is turned around.
    """
    longest = max(brackets, key=len)
    for turn in range(len(longest)):
        turned = longest[turn:] + longest[:turn]
        times = [float(setting[0]) for setting in turned]
        if times in (sorted(times), sorted(times, reverse=True)):
            return turned
    return longest
