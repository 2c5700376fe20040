"""Readings from photographs of skin of known shape under known lights.

    sample_photographs(samples, workers, scratch) -> PhotographReadings

Every pixel is a reading: its geometry tells normal and view, the layer the light. Pixels at edges,
saturated, glossy, masked and shadowed ones are left out, and those that stay are thinned so that
all angles between normal and light are there alike.

Reads:  photographs (brackets, or EXR in camera values), AOV EXR of ``usdskin render``, masks.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import LayerError
from usdskin.estimate.skin.geometry import Geometry, read_geometry
from usdskin.estimate.skin.picking import Gloss, Picked, pick_pixels
from usdskin.estimate.skin.pictures import (
    check_size,
    open_pictures,
    picture_names,
    read_mask,
)
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.scatter import find_odd, standard_deviations
from usdskin.estimate.skin.white import white_values
from usdskin.notes import Note
from usdskin.prims.samples import SkinSamples
from usdskin.progress import Progress, SilentProgress

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_READINGS = 4000
"""Readings that are picked at most: more tell little, as neighbours share their errors."""

_MOST_OF_ONE = 2000
_LEAST_CORRELATION = 0.5
_LEAST_SPREAD = 0.1  # of N.L, to tell anything about the light's direction
_MANY = 0.25
_ANGLE_DEG = 5.0

_Any = TypeVar("_Any")


@dataclass(frozen=True, slots=True)
class PhotographReport:
    """What became of the pixels of one photograph."""

    name: str
    """Name of the file or view."""

    inside: int
    """Pixels well inside the object, and within the mask."""

    lost: int
    """Of those, pixels saturated or moved."""

    glossy: int
    """Of the rest, pixels near the mirror direction."""

    shadowed: int
    """Of the readings picked, those in shadow."""

    highlights: int
    """Of the readings picked, those far brighter than elsewhere at that angle."""

    used: int
    """Readings that are left."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotographReadings:
    """Readings, and the pixels they are from."""

    readings: Readings
    """Camera values over those of a perfect diffuser that faces the light, channels R, G, B."""

    photograph: NDArray[np.intp]
    """Index of the photograph, shape [q]."""

    pixel: NDArray[np.intp]
    """Column and row [px], shape [q, 2]."""

    white: FloatArray
    """Camera values of that diffuser, for every photograph, shape [n, 3]."""

    shared: float
    """What the standard deviations of the readings are over what they scatter by [1]: pixels share
    the errors of their geometry, so that many tell less than as many readings of a goniometer."""

    reports: tuple[PhotographReport, ...]
    """What became of the pixels, for every photograph, shape [n]."""


def sample_photographs(
    samples: SkinSamples,
    workers: Workers,
    scratch: Path,
    progress: Progress | None = None,
    notes: list[Note] | None = None,
    *,
    gloss: Gloss = "mask",
    most: int = MOST_READINGS,
) -> PhotographReadings:
    """Return readings from the photographs of a sample layer.

    Args:
        samples: Names photographs, their geometry and lights.
        workers: Where kernels run.
        scratch: Folder for decoded raw files.
        progress: Told how far the work is.
        notes: Takes what does not stop it.
        gloss: Whether pixels near the mirror direction are left out, or kept: to fit a specular
            reflection, or where crossed polarisers leave none.
        most: Readings to pick at most.

    Raises:
        LayerError: The layer does not tell what is needed, or nothing is left.
        ImageError: A file cannot be read, or its size is not that of its geometry.
    """
    notes = [] if notes is None else notes
    progress = SilentProgress() if progress is None else progress
    names = picture_names(samples)
    lights = _one_each(samples, "samples:lights", samples.lights, len(names))
    files = _one_each(samples, "samples:geometry:files", samples.geometry_files, len(names))
    masks: Sequence[Path | None] = [None] * len(names)
    if samples.mask_files:
        masks = _one_each(samples, "samples:mask:files", samples.mask_files, len(names))
    white = white_values(samples, tuple(lights))
    share = min(_MOST_OF_ONE, max(most // len(names), 1))
    found: list[Note] = []
    pictures = open_pictures(samples, workers, scratch, found)
    progress.start(len(names), "photographs")
    picked = []
    for k, (picture, geometry) in enumerate(zip(pictures, _geometries(files), strict=True)):
        check_size(picture.where, picture.values.shape, geometry.size)
        mask_file = masks[k]
        mask = None if mask_file is None else read_mask(mask_file, geometry.size)
        picked.append(
            pick_pixels(picture, geometry, lights[k].direction, white[k], mask, gloss, share, k)
        )
        progress.advance(1)
    progress.done()
    notes += _gathered(found)
    return _assembled(samples, names, picked, white, files, notes)


def _gathered(found: Sequence[Note]) -> list[Note]:
    """Return one note of each kind: what one photograph has, many of a series have."""
    kinds: dict[str, list[Note]] = {}
    for note in found:
        kinds.setdefault(note.code, []).append(note)
    return [
        first
        if len(rest) == 1
        else replace(first, message=f"{first.message} (so with {len(rest)} photographs)")
        for first, rest in ((notes[0], notes) for notes in kinds.values())
    ]


def _one_each(samples: SkinSamples, name: str, given: Sequence[_Any], count: int) -> Sequence[_Any]:
    if not count:
        raise LayerError(
            f"{samples.where}: names no photographs; give samples:images or samples:views"
        )
    if len(given) == 1:
        return [given[0]] * count
    if len(given) != count:
        raise LayerError(
            f"{samples.where}: {name} has {len(given)} entries, but there are {count} "
            "photographs; give one for each, or one for all"
        )
    return given


def _geometries(files: Sequence[Path]) -> Iterator[Geometry]:
    """Read the geometry of every photograph; those that follow one another are read once."""
    known: Geometry | None = None
    for file in files:
        if known is None or known.path != file:
            known = read_geometry(file)
        yield known


def _assembled(
    samples: SkinSamples,
    names: Sequence[str],
    picked: Sequence[Picked],
    white: FloatArray,
    files: Sequence[Path],
    notes: list[Note],
) -> PhotographReadings:
    owner = np.repeat(np.arange(len(picked)), [len(part.pixels) for part in picked])
    if not owner.size:
        _refuse_nothing(samples, picked)
    _check_directions(samples, names, picked, notes)

    def joined(name: str) -> FloatArray:
        return np.concatenate([getattr(part, name) for part in picked])

    values, cosine = joined("values"), joined("cosine")
    is_matt = np.concatenate([part.is_matt for part in picked])
    odd = find_odd(cosine, values)
    highlight = odd.highlight & is_matt
    keep = ~(odd.shadowed | highlight)
    reports = tuple(
        PhotographReport(
            name=names[k],
            inside=part.inside,
            lost=part.lost,
            glossy=part.glossy,
            shadowed=int(np.count_nonzero(odd.shadowed & (owner == k))),
            highlights=int(np.count_nonzero(highlight & (owner == k))),
            used=int(np.count_nonzero(keep & (owner == k))),
        )
        for k, part in enumerate(picked)
    )
    _note_losses(samples, reports, notes)
    variance = _variance(picked)
    stddev = standard_deviations(
        cosine[keep],
        values[keep],
        joined("turn")[keep],
        None if variance is None else variance[keep],
        is_matt[keep],
    )
    shared = _shared(cosine[keep], owner[keep], files)
    pixels = np.concatenate([part.pixels for part in picked])[keep]
    width = np.array([part.width for part in picked])[owner[keep]]
    light = np.stack([part.light for part in picked])[owner[keep]]
    readings = Readings(
        light=light,
        normal=joined("normal")[keep],
        values=values[keep],
        view=joined("view")[keep],
        stddev=None if stddev is None else shared * stddev,
        thickness=_thickness(samples, cosine[keep]),
        where=samples.where,
        names=("R", "G", "B"),
    )
    pixel = np.stack([pixels % width, pixels // width], axis=-1)
    return PhotographReadings(readings, owner[keep], pixel, white, shared, reports)


def _shared(cosine: FloatArray, owner: NDArray[np.intp], files: Sequence[Path]) -> float:
    """Return by how much readings know less than their scatter says.

    Normals and placement come from one geometry for all photographs of a view, so that errors of
    readings of one view and angle do not average out: all of them count as one reading.
    """
    views = np.unique([str(file) for file in files], return_inverse=True)[1]
    angle = (np.degrees(np.arccos(cosine)) / _ANGLE_DEG).astype(np.intp)
    independent = len(np.unique(np.stack([views[owner], angle]), axis=1).T)
    return float(np.sqrt(len(cosine) / max(independent, 1)))


def _refuse_nothing(samples: SkinSamples, picked: Sequence[Picked]) -> None:
    lost = sum(part.lost for part in picked)
    glossy = sum(part.glossy for part in picked)
    inside = sum(part.inside for part in picked)
    raise LayerError(
        f"{samples.where}: no pixel of the {len(picked)} photographs is left: {inside} lie inside "
        f"the object and the masks, of which {lost} are saturated and {glossy} near the mirror "
        "direction; correct samples:mask:files, or photograph with shorter exposures"
    )


def _check_directions(
    samples: SkinSamples, names: Sequence[str], picked: Sequence[Picked], notes: list[Note]
) -> None:
    """Refuse photographs that are not brighter where their normals turn to the light."""
    found = {}
    for name, part in zip(names, picked, strict=True):
        lit, value = np.maximum(part.cosine, 0.0), part.values.mean(axis=1)
        if len(lit) > 2 and lit.std() > _LEAST_SPREAD and value.std() > 0.0:
            found[name] = float(np.corrcoef(lit, value)[0, 1])
    doubtful = [name for name, match in found.items() if match < _LEAST_CORRELATION]
    if not doubtful:
        return
    listed = ", ".join(doubtful[:4]) + ", ..." * (len(doubtful) > 4)
    text = f"{len(doubtful)} of {len(picked)} photographs ({listed}) are not brighter where the "
    text += "surface faces the light"
    if len(doubtful) > 0.5 * len(found):
        raise LayerError(
            f"{samples.where}: {text}; are samples:lights and samples:geometry:files in the order "
            "of the photographs, and in one world?"
        )
    text += ": check the direction of their lights, and their geometry"
    notes.append(Note("light-direction-doubtful", samples.where, text))


def _variance(picked: Sequence[Picked]) -> FloatArray | None:
    known = [part.variance for part in picked if part.variance is not None]
    return np.concatenate(known) if len(known) == len(picked) else None


def _thickness(samples: SkinSamples, cosine: FloatArray) -> FloatArray | None:
    """Return the way of light through the body: one for all that is lit from behind."""
    given = samples.thickness
    if given is None:
        return None
    if given.size != 1:
        raise LayerError(
            f"{samples.where}: samples:thickness has {given.size} values, but photographs take "
            "one for all: the way of light from behind"
        )
    return np.where(cosine <= 0.0, float(given.ravel()[0]), 0.0)


def _note_losses(
    samples: SkinSamples, reports: Sequence[PhotographReport], notes: list[Note]
) -> None:
    inside = sum(report.inside for report in reports)
    lost = sum(report.lost for report in reports)
    if lost > _MANY * inside:
        text = f"{lost / inside:.0%} of the pixels are saturated or moved; photograph with shorter "
        text += "exposures"
        notes.append(Note("photographs-saturated", samples.where, text))
    odd = sum(report.shadowed + report.highlights for report in reports)
    used = sum(report.used for report in reports)
    if odd:
        shadows = sum(report.shadowed for report in reports)
        text = f"{odd} of {odd + used} pixels differ from others at the same angle to the light "
        text += f"and are left out: {shadows} darker, in shadow; {odd - shadows} brighter"
        notes.append(Note("pixels-left-out", samples.where, text))
    empty = [report.name for report in reports if not report.used]
    if empty:
        text = f"{len(empty)} of {len(reports)} photographs give no readings, such as {empty[0]}"
        notes.append(Note("photograph-not-used", samples.where, text))
