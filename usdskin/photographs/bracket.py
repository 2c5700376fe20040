"""The photographs of one view, opened together, from the shortest exposure to the longest."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import ImageError, LayerError
from usdskin.photographs.frames import Frame, open_frame
from usdskin.prims.views import Bracketed

if TYPE_CHECKING:
    from usdskin.photographs.response import Response

FloatArray = NDArray[np.float64]

_SAMPLED_PIXELS = 2**18
_SAMPLED_BANDS = 16  # of adjacent rows: files decode rows in chunks

_STEPS = 1025

_PILE_SHARE = 1e-3  # of the samples at one raw value is no chance


@dataclass(frozen=True, slots=True, eq=False)
class OpenBracket:
    """Opened photographs; every array is in their order, which is that of exposure."""

    view: Bracketed
    """The view they show."""

    order: NDArray[np.intp]
    """Their places in the layer's bracket, shape [image_count]."""

    frames: tuple[Frame, ...]
    """The photographs."""

    exposure: FloatArray
    """Stated exposures, ascending [s], shape [image_count]."""

    iso: FloatArray
    """Sensitivity settings [1], shape [image_count]."""

    black: FloatArray
    """Raw values without light [DN], shape [image_count, 3]."""

    white: FloatArray
    """Raw value at saturation [DN], shape [3]."""

    curve: FloatArray | None
    """Linear value of every whole raw value, 0 at black and 1 at white [1],
    shape [level_count, 3]; None where raw values are linear."""

    rounding_steps: FloatArray
    """Variance that rounding to whole raw values adds to linear values evenly spaced from 0 to 1
    [1], shape [step_count, 3]."""

    dark: Frame | None
    """Photograph with the lens covered."""

    flat: Frame | None
    """Photograph of an even field."""

    @property
    def size(self) -> tuple[int, int]:
        """Height and width [px]."""
        return self.frames[0].height, self.frames[0].width

    @property
    def scale(self) -> FloatArray:
        """Raw values per linear value, white - black [DN], shape [3]."""
        return np.asarray(self.white - self.black[0])

    def fraction(self, k: int, raw: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return where raw values of photograph k lie from black (0) to white (1)."""
        return np.asarray((raw - np.float32(self.black[k])) * np.float32(1.0 / self.scale))

    def linear(self, k: int, raw: NDArray[np.float32]) -> NDArray[np.float32]:
        """Return linear values of photograph k, 0 without light and 1 at white."""
        if self.curve is None:
            return self.fraction(k, raw)
        level = np.clip((raw + 0.5).astype(np.intp), 0, len(self.curve) - 1)
        return np.asarray(
            np.take_along_axis(self.curve, level.reshape(-1, 3), axis=0).reshape(raw.shape),
            dtype=np.float32,
        )

    def rounding(self, linear: Any) -> Any:
        """Return the variance that rounding adds to linear values, mean over the channels."""
        at = np.linspace(0.0, 1.0, len(self.rounding_steps))
        return np.interp(linear, at, self.rounding_steps.mean(axis=1))

    def name(self, k: int) -> str:
        """Return the file name of photograph k, for messages."""
        return self.frames[k].path.name


@contextmanager
def open_bracket(
    view: Bracketed,
    scratch: Path,
    response: Response | None,
    max_mb: int,
    advance: Callable[[int], None] = lambda count: None,
) -> Iterator[OpenBracket]:
    """Open the photographs of a view, and its dark frame and flat field.

    Args:
        view: The view.
        scratch: Folder for decoded raw files.
        response: Response curve of the camera; None where raw values are linear.
        max_mb: Refuse photographs that need more memory than this as float32 [MiB].
        advance: Told the number of photographs opened; raw files take seconds.

    Raises:
        ImageError: A photograph is missing, broken, or of another size or kind than the others.
        LayerError: Black and white level, or the response, do not fit the photographs.
    """
    bracket = view.bracket
    order = np.argsort(bracket.exposure, kind="stable")
    with ExitStack() as stack:
        opened: dict[int, Frame] = {}

        def add(path: Path) -> Frame:
            frame = stack.enter_context(open_frame(path, scratch, max_mb))
            _refuse_odd_one(view, opened.get(0, frame), frame)
            return frame

        for index, path in enumerate(bracket.images):  # in the order a person would look
            opened[index] = add(path)
            advance(1)
        frames = tuple(opened[index] for index in order)
        dark = None if bracket.dark_file is None else add(bracket.dark_file)
        flat = None if bracket.flat_file is None else add(bracket.flat_file)
        black, white = _levels(view, frames)
        curve = None if response is None else _curve(view, frames[0], response, black[0], white)
        yield OpenBracket(
            view=view,
            order=order,
            frames=frames,
            exposure=bracket.exposure[order],
            iso=bracket.iso[order],
            black=black,
            white=white,
            curve=curve,
            rounding_steps=_rounding_steps(frames[0], curve, white - black[0]),
            dark=dark,
            flat=flat,
        )


def _refuse_odd_one(view: Bracketed, first: Frame, frame: Frame) -> None:
    if (first.width, first.height) != (frame.width, frame.height):
        raise ImageError(
            f"{view.where}: {first.path} has {first.width} x {first.height} pixels and "
            f"{frame.path} {frame.width} x {frame.height}; the photographs of a view are of one "
            "size: correct bracket:images"
        )
    if first.kind != frame.kind:
        raise ImageError(
            f"{view.where}: {first.path} holds {first.kind} values and {frame.path} "
            f"{frame.kind} ones, which have no common scale; export all of them alike"
        )


def _levels(view: Bracketed, frames: tuple[Frame, ...]) -> tuple[FloatArray, FloatArray]:
    """Return black [image_count, 3] and white [3]: what the layer says, else what the files say."""
    stated = view.bracket.black_level
    black = np.array(
        [
            np.broadcast_to(stated, 3)
            if stated.any() or frame.black_level is None
            else frame.black_level
            for frame in frames
        ],
        dtype=np.float64,
    )
    white = view.bracket.white_level
    if white is None:
        white = np.array([min(frame.full_scale for frame in frames)])
    white = np.broadcast_to(white, 3).astype(np.float64)
    if (white <= black).any():
        raise LayerError(
            f"{view.where}: the white level {white.min():g} is not above the black level "
            f"{black.max():g}; correct bracket:blackLevel or bracket:whiteLevel"
        )
    return black, white


def _curve(
    view: Bracketed, frame: Frame, response: Response, black: FloatArray, white: FloatArray
) -> FloatArray:
    top = float(response.level[-1])
    if not frame.is_integer or not 0.5 * frame.full_scale < top <= 1.01 * frame.full_scale:
        raise LayerError(
            f"{view.where}: the response curve is for raw values up to {top:g}, but {frame.path} "
            f"holds {frame.kind} values up to {frame.full_scale:g}; give the curve of these "
            'photographs, or author bracket:transfer = "linear"'
        )
    level = np.arange(frame.full_scale + 1.0)
    linear = response.apply(np.repeat(level[:, None], 3, axis=1)).astype(np.float64)
    dark, bright = response.apply(np.stack([black, white])).astype(np.float64)
    if (bright <= dark).any():
        raise LayerError(
            f"{view.where}: the response curve is flat between the black level {black.min():g} and "
            f"the white level {white.max():g}; correct the curve or the levels"
        )
    return np.asarray((linear - dark) / (bright - dark))


def _rounding_steps(frame: Frame, curve: FloatArray | None, scale: FloatArray) -> FloatArray:
    """Return 1/12 DN^2, as linear values: by the scale, or by the slope of the curve."""
    if not frame.is_integer:
        return np.zeros((1, 3))
    if curve is None:
        return (1.0 / 12.0 / scale**2)[None]
    at = np.linspace(0.0, 1.0, _STEPS)
    slope = np.gradient(curve, axis=0)
    columns = [np.interp(at, curve[:, c], slope[:, c] ** 2 / 12.0) for c in range(3)]
    return np.stack(columns, axis=1)


# --- Samples -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Some rows of all photographs of a bracket."""

    linear: NDArray[np.float32]
    """Linear values, dark frame subtracted [1], shape [image_count, row_count, width, 3]."""

    fraction: NDArray[np.float32]
    """Largest share of the range from black to white over the channels [1],
    shape [image_count, row_count, width]."""


def reading_workers(workers: Workers) -> Workers:
    """Return as many CPU threads as files may be decoded with at once."""
    threads = workers.threads if workers.device == "cpu" else os.cpu_count() or 1
    return Workers("cpu", threads)


def draw_samples(bracket: OpenBracket, workers: Workers) -> Samples:
    """Read bands of rows spread over the picture, a quarter of a million pixels at most.

    Raises:
        ImageError: A file is broken.
        LayerError: The sensor saturates below the white level.
    """
    height, width = bracket.size
    rows_per_band = max(_SAMPLED_PIXELS // (width * _SAMPLED_BANDS), 1)
    begins = [0]
    if height > _SAMPLED_BANDS * rows_per_band:
        centers = (np.arange(_SAMPLED_BANDS) + 0.5) * height / _SAMPLED_BANDS
        begins = [int(center) - rows_per_band // 2 for center in centers]
    else:
        rows_per_band = height

    def read(frame: Frame) -> NDArray[np.float32]:
        return np.concatenate([frame.rows(begin, begin + rows_per_band) for begin in begins])

    count = len(bracket.frames)
    shape = (count, len(begins) * rows_per_band, width)
    samples = Samples(np.empty((*shape, 3), np.float32), np.empty(shape, np.float32))
    piles = np.empty((count, 3))
    offset = 0.0 if bracket.dark is None else bracket.linear(0, read(bracket.dark))

    def work(begin: int, end: int) -> None:
        for k in range(begin, end):
            raw = read(bracket.frames[k])
            piles[k] = _pile(raw)
            samples.linear[k] = bracket.linear(k, raw) - offset
            samples.fraction[k] = bracket.fraction(k, raw).max(axis=-1)

    reading_workers(workers).run(count, 1, work)
    _refuse_early_saturation(bracket, piles)
    return samples


def _pile(raw: NDArray[np.float32]) -> FloatArray:
    """Return the largest raw value of each channel where many pixels share it, else NaN."""
    largest = raw.max(axis=(0, 1)).astype(np.float64)
    share = (raw == largest.astype(np.float32)).mean(axis=(0, 1))
    return np.where(share >= _PILE_SHARE, largest, np.nan)


def _refuse_early_saturation(bracket: OpenBracket, piles: FloatArray) -> None:
    """Refuse a bracket of which several exposures end at one raw value below the white level."""
    for k in range(1, len(piles)):
        same = (piles[k] == piles[k - 1]) & (bracket.exposure[k] > 1.5 * bracket.exposure[k - 1])
        fraction = (piles[k] - bracket.black[k]) / bracket.scale
        if (same & (fraction > 0.1) & (fraction < 0.97)).any():
            found = ", ".join(f"{level:g}" for level in np.unique(piles[k][same]))
            raise LayerError(
                f"{bracket.view.where}: {bracket.name(k - 1)} and {bracket.name(k)} both saturate "
                f"at the raw value {found}, below the white level {bracket.white.min():g}; author "
                "bracket:whiteLevel"
            )
