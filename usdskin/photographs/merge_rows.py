"""Stream the rows of a bracket through the merge kernels.

Photographs are read a block of rows at a time, so that memory holds the merged view and one block
of each. Neighbours decide on saturation, so a block keeps the last two rows of the one before it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.device import Workers, vec3
from usdskin.photographs.bracket import OpenBracket, reading_workers
from usdskin.photographs.noise import NoiseModel
from usdskin.warp_kernels import bracket as kernels

_BLOCK_BYTES = 48 * 2**20  # of raw values: small beside the merged view, large beside a chunk
_ROW_STEP = 32  # files store rows in chunks of powers of two
_LEAST_TOLERANCE = 0.02  # of a value: shutters and sensors are no better
_LEAST_VARIANCE = 1e-14  # of linear values: what has no noise at all still gets a finite weight


@dataclass(frozen=True, slots=True, eq=False)
class _Block:
    """Some rows of all photographs."""

    top: int
    """Row of the picture that is first in the block."""

    count: int
    """Rows of the block that hold picture."""

    begin: int
    """First row of the picture to merge, whose neighbours the block holds."""

    end: int
    """Row after the last one to merge."""

    raw: NDArray[np.float32]
    """Raw values [DN], shape [image_count, block_rows, width, 3]."""

    dark: NDArray[np.float32]
    """Linear values of the dark frame [1], shape [block_rows, width, 3]; no rows: none."""


def merge_all_rows(
    bracket: OpenBracket,
    exposure: NDArray[np.float64],
    doubt: float,
    noise: NoiseModel,
    workers: Workers,
    advance: Callable[[int], None],
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.uint8]]:
    """Merge every row of a bracket.

    Args:
        bracket: The photographs.
        exposure: Their exposures, in their order [s], shape [image_count].
        doubt: Relative error of the exposures; contradictions within it are no motion.
        noise: Their noise.
        workers: Where to compute.
        advance: Told the number of rows done.

    Returns:
        Values [1/s] and their variance [s^-2], shape [height, width, 3], and the status, shape
        [height, width].

    Raises:
        ImageError: A file is broken.
    """
    compilation.load(kernels, workers.device)
    height, width = bracket.size
    values = np.empty((height, width, 3), np.float32)
    variance = np.empty((height, width, 3), np.float32)
    status = np.empty((height, width), np.uint8)
    constants = _constants(bracket, exposure, noise, workers.device)
    constants.tolerance = max(_LEAST_TOLERANCE, doubt)
    for block in _blocks(bracket, reading_workers(workers)):
        rows = slice(block.begin, block.end)
        _merge_block(block, constants, workers, values[rows], variance[rows], status[rows])
        values[rows] /= np.float32(exposure[-1])
        variance[rows] /= np.float32(exposure[-1] ** 2)
        advance(block.end - block.begin)
    return values, variance, status


def _constants(
    bracket: OpenBracket, exposure: NDArray[np.float64], noise: NoiseModel, device: str
) -> kernels.Bracket:
    gain, read_noise = (part[bracket.order] for part in (noise.gain, noise.read_noise))
    constants = kernels.Bracket()
    constants.exposure = wp.array(exposure / exposure[-1], dtype=wp.float32, device=device)
    constants.photon = vec3(1.0 / (gain[:, None] * bracket.scale), device)
    constants.read = vec3((read_noise[:, None] / bracket.scale) ** 2 + _LEAST_VARIANCE, device)
    constants.black = vec3(bracket.black, device)
    constants.per_range = wp.vec3f(*(float(1.0 / scale) for scale in bracket.scale))
    constants.curve = vec3(np.empty((0, 3)) if bracket.curve is None else bracket.curve, device)
    constants.rounding = vec3(bracket.rounding_steps, device)
    return constants


def _blocks(bracket: OpenBracket, readers: Workers) -> Iterator[_Block]:
    """Read all rows in order, a block at a time; a block's arrays are used again by the next."""
    height, width = bracket.size
    frames = (*bracket.frames, *(() if bracket.dark is None else (bracket.dark,)))
    step = _BLOCK_BYTES // (len(frames) * width * 12)
    step = max(step // _ROW_STEP * _ROW_STEP, _ROW_STEP)
    raw = np.zeros((len(frames), min(step, height) + 2, width, 3), np.float32)
    held = count = merged = 0
    for begin in range(0, height, step):
        raw[:, :held] = raw[:, count - held : count]
        rows = min(begin + step, height) - begin
        count = held + rows

        def read(
            first: int, last: int, at: int = held, begin: int = begin, rows: int = rows
        ) -> None:
            for k in range(first, last):
                raw[k, at : at + rows] = frames[k].rows(begin, begin + rows)

        readers.run(len(frames), 1, read)
        end = height if begin + rows == height else begin + rows - 1
        photographs = raw[: len(bracket.frames)]
        dark = raw[:0, 0] if bracket.dark is None else bracket.linear(0, raw[-1])
        if end > merged:
            yield _Block(begin - held, count, merged, end, photographs, dark)
        merged, held = end, min(count, 2)


def _merge_block(
    block: _Block,
    constants: kernels.Bracket,
    workers: Workers,
    values: NDArray[np.float32],
    variance: NDArray[np.float32],
    status: NDArray[np.uint8],
) -> None:
    """Fill the rows of a block's merged arrays; on the host the kernels write right into them."""
    device = workers.device

    def on_device(array: NDArray[Any], kind: Any) -> wp.array:
        return wp.array(array, dtype=kind, device=device, copy=False)

    raw = on_device(block.raw, wp.vec3f)
    dark = on_device(block.dark, wp.vec3f)
    level, trust = (wp.empty(raw.shape, dtype=wp.float32, device=device) for _ in range(2))
    first_row, rows = block.begin - block.top, block.end - block.begin

    def measure(begin: int, end: int) -> None:
        kernels.measure_levels(constants, raw, begin, end - begin, level)

    def weigh(begin: int, end: int) -> None:
        first = first_row + begin
        kernels.weigh_saturation(constants, raw, level, block.count, first, end - begin, trust)

    def merge(begin: int, end: int) -> None:
        parts: list[NDArray[Any]] = [part[begin:end] for part in (values, variance, status)]
        out = [on_device(p, k) for p, k in zip(parts, (wp.vec3f, wp.vec3f, wp.uint8), strict=True)]
        kernels.merge_rows(constants, raw, trust, dark, first_row + begin, *out)
        if device != "cpu":
            for part, filled in zip(parts, out, strict=True):
                part[...] = filled.numpy()

    for count, work in ((block.count, measure), (rows, weigh), (rows, merge)):
        workers.run(count, -(-count // workers.threads), work)
