"""The response of a camera whose raw values do not follow exposure: recovered, read and written.

A picture that was developed, such as a JPEG, holds a curve of the exposure. The pictures of a
bracket show the same light through known exposures, which tells the curve but for its scale
(Debevec and Malik, "Recovering High Dynamic Range Radiance Maps from Photographs", SIGGRAPH 1997).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.images import replacing
from usdskin.photographs.response_fit import fit_curve, is_usable
from usdskin.prims.views import Bracketed

FloatArray = NDArray[np.float64]

_LEVELS = 256

_SATURATED = 0.997
_PATCH_PX = 3
_CANDIDATES = 40_000
_ROWS_AT_ONCE = 64
_BINS = 128

_LEAST_PIXELS = 50
_LEAST_SPAN = 0.5
_LEAST_AGREEING = 0.5
_MOST_NOISE = 0.1  # of the range from black to white

_REMEDY = (
    "name a curve in bracket:response:file, or set bracket:transfer to linear if raw values follow "
    "exposure"
)


@dataclass(frozen=True, slots=True, eq=False)
class Response:
    """The inverse response of a camera: which exposure made which raw value."""

    level: FloatArray
    """Raw values, strictly ascending [DN], shape [level_count]."""

    exposure: FloatArray
    """Relative exposure of each channel, nowhere falling, the largest 1 [1],
    shape [level_count, 3]."""

    def apply(self, dn: NDArray[Any]) -> NDArray[np.float32]:
        """Return the relative exposure of raw values; beyond the levels the ends are held.

        Args:
            dn: Raw values [DN], shape [..., 3].
        """
        exposure = np.empty(dn.shape, dtype=np.float32)
        for channel in range(3):
            exposure[..., channel] = np.interp(
                dn[..., channel], self.level, self.exposure[:, channel]
            )
        return exposure


# --- Samples -----------------------------------------------------------------------------------


class Rows(Protocol):
    """A picture that gives its rows in order, such as ``usdskin.photographs.frames.Frame``."""

    @property
    def width(self) -> int:
        """Columns [px]."""

    @property
    def height(self) -> int:
        """Rows [px]."""

    def rows(self, begin: int, end: int) -> NDArray[np.float32]:
        """Return rows [DN], shape [end - begin, width, 3]."""


def sample_pixels(
    frames: Sequence[Rows], black: float, white: float, count: int = 3000
) -> FloatArray:
    """Choose pixels that tell most about the response, and return what each frame has there.

    A sample is the mean of a small patch, for less noise. Patches lie on a grid; those are taken
    that spread evenly over brightness and are the flattest there, since edges and texture tell of
    the camera's motion and of compression.

    Args:
        frames: The pictures of a bracket, of one size.
        black: Raw value without light [DN].
        white: Raw value at saturation [DN].
        count: Most pixels to return.

    Returns:
        Raw values [DN]; ``white`` where a pixel of the patch is saturated,
        shape [image_count, pixel_count, 3].
    """
    width, height = frames[0].width, frames[0].height
    pitch = max(_PATCH_PX, int(np.ceil(np.sqrt(width * height / _CANDIDATES))))
    rows_at_once = pitch * -(-_ROWS_AT_ONCE // pitch)
    blocks = []
    for begin in range(0, height - pitch + 1, rows_at_once):
        end = min(begin + rows_at_once, height - (height - begin) % pitch)
        blocks.append(
            np.stack([_patches(frame.rows(begin, end), pitch, white) for frame in frames], axis=1)
        )
    mean, unevenness = np.concatenate(blocks, axis=2)
    usable = is_usable((mean - black) / (white - black))
    candidates = np.flatnonzero((usable.sum(axis=0) >= 2).any(axis=1))
    chosen = candidates[
        _evenly(
            mean.mean(axis=(0, 2))[candidates],
            np.where(usable, unevenness, 0.0).max(axis=(0, 2))[candidates],
            count,
        )
    ]
    return np.asarray(mean[:, np.sort(chosen)], dtype=np.float64)


def _patches(rows: NDArray[np.float32], pitch: int, white: float) -> NDArray[np.float32]:
    """Return mean and range of the patch in the corner of each cell, shape [2, cell_count, 3]."""
    columns = rows.shape[1] // pitch
    cells = rows[:, : columns * pitch].reshape(-1, pitch, columns, pitch, 3)
    patch = cells[:, :_PATCH_PX, :, :_PATCH_PX]
    largest = patch.max(axis=(1, 3))
    is_saturated = largest >= _SATURATED * white
    mean = np.where(is_saturated, np.float32(white), patch.mean(axis=(1, 3)))
    return np.stack([mean, largest - patch.min(axis=(1, 3))]).reshape(2, -1, 3)


def _evenly(brightness: NDArray[Any], unevenness: NDArray[Any], count: int) -> NDArray[np.intp]:
    """Return which ``count`` to take: the same number of every brightness, the least uneven."""
    if not brightness.size:
        return np.zeros(0, dtype=np.intp)
    edges = np.linspace(brightness.min(), brightness.max(), _BINS + 1)
    bins = np.digitize(brightness, edges[1:-1])
    order = np.lexsort((unevenness, bins))
    rank = np.arange(len(order)) - np.searchsorted(bins[order], bins[order])
    return np.asarray(order[np.lexsort((bins[order], rank))][:count])


# --- Recovery ----------------------------------------------------------------------------------


def recover_response(
    view: Bracketed, samples: FloatArray, exposure: FloatArray, full_scale: float = 255.0
) -> Response:
    """Recover the inverse response of a camera from the pictures of one bracket.

    How is told in ``response_fit``; noise, moved objects and blooming have little say.

    A bracket does not tell how the channels compare: they are taken to be equal at middle gray,
    as in a developed gray.

    Args:
        view: View the samples are from, for its black and white level and for errors.
        samples: Raw values of the same pixels in every picture [DN],
            shape [image_count, pixel_count, 3].
        exposure: Relative exposure of every picture [1], shape [image_count].
        full_scale: White level where the view gives none [DN].

    Raises:
        LayerError: The exposures are all the same, have too little in common, or contradict one
            another.
    """
    if len(exposure) < 2 or np.ptp(exposure) <= 1e-3 * np.max(exposure):
        raise LayerError(
            f"{view.where}: its photographs have a single exposure, which tells nothing of their "
            f"response; {_REMEDY}"
        )
    black = float(np.mean(view.bracket.black_level))
    given = view.bracket.white_level
    white = full_scale if given is None else float(np.mean(given))
    shares = (np.asarray(samples, dtype=np.float64) - black) / (white - black)
    curves = [
        _recover_channel(view, shares[..., channel], np.log(exposure), name)
        for channel, name in enumerate(("red", "green", "blue"))
    ]
    logs = np.stack([curve - curve[_LEVELS // 2] for curve in curves], axis=1)
    relative = np.exp(logs - logs.max())
    relative[0] = 0.0
    return Response(np.linspace(black, white, _LEVELS), relative)


def _recover_channel(
    view: Bracketed, samples: FloatArray, log_exposure: FloatArray, name: str
) -> FloatArray:
    """Return ln(exposure) of every level up to a constant, shape [level_count].

    Args:
        view: View, for errors.
        samples: Raw values from black (0) to white (1), shape [image_count, pixel_count].
        log_exposure: ln(exposure) of every picture, shape [image_count].
        name: Name of the channel, for errors.
    """
    usable = is_usable(samples)
    kept = usable.sum(axis=0) >= 2
    samples = samples[:, kept]
    if len(samples[0]) < _LEAST_PIXELS or np.ptp(samples[usable[:, kept]]) < _LEAST_SPAN:
        raise LayerError(
            f"{view.where}: too few places are neither black nor saturated in two of its "
            f"photographs, so the response of {name} cannot be recovered; {_REMEDY}"
        )
    fit = fit_curve(samples, log_exposure)
    if fit.agreeing < _LEAST_AGREEING or fit.noise > _MOST_NOISE:
        raise LayerError(
            f"{view.where}: its photographs contradict in {name} the exposures stated for them; "
            "correct bracket:exposureTimes, bracket:iso, bracket:fNumbers and bracket:ndFactors"
        )
    return fit.log_exposure(np.linspace(0.0, 1.0, _LEVELS))


# --- Files -------------------------------------------------------------------------------------


def read_response(path: str | Path) -> Response:
    """Read a curve: in each line a raw value and one exposure, or one for each of R, G and B.

    Numbers are separated by commas or spaces; what follows a ``#`` is a comment.

    Raises:
        LayerError: The file is missing or does not hold such a curve; the message names the line.
    """
    try:
        lines = Path(path).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is no text"
        raise LayerError(f"{path}: cannot be read as a response curve ({reason})") from None
    rows: list[list[float]] = []
    for number, line in enumerate(lines, start=1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        problem = _row_problem(row, rows[-1] if rows else None)
        if problem:
            raise LayerError(f'{path} line {number}: "{line.strip()}" {problem}')
        rows.append(row)
    table = np.array(rows)
    if len(rows) < 2 or not (table[-1, 1:] > 0.0).all():
        raise LayerError(
            f"{path}: is no response curve; give at least two lines, each with a raw value and its "
            "relative exposure, which ends above 0"
        )
    exposure = np.broadcast_to(table[:, 1:], (len(rows), 3))
    return Response(table[:, 0], np.asarray(exposure / exposure.max()))


def _row_problem(row: Sequence[float], before: Sequence[float] | None) -> str | None:
    if len(row) not in (2, 4) or not np.isfinite(row).all():
        return "is not a raw value and one or three exposures"
    if min(row[1:]) < 0.0:
        return "holds a negative exposure; correct it"
    if before is None:
        return None
    if len(row) != len(before):
        return "has another number of columns than the line before; give all lines the same"
    if row[0] <= before[0]:
        return f"does not ascend: the raw value before it is {before[0]:g}; sort the lines"
    if any(now < then for now, then in zip(row[1:], before[1:], strict=True)):
        return "has less exposure than the line before; more light makes a higher raw value"
    return None


def write_response(path: str | Path, response: Response) -> Path:
    """Write a curve as ``read_response`` reads it, all at once or not at all.

    Raises:
        ImageError: The file cannot be written.
    """
    lines = ["# Inverse response: raw value [DN], relative exposure of R, G and B\n"]
    for level, exposure in zip(response.level, response.exposure, strict=True):
        lines.append(" ".join(f"{value:.9g}" for value in (level, *exposure)) + "\n")
    with replacing(path) as temporary:
        Path(temporary).write_text("".join(lines), encoding="utf-8")
    return Path(path)
