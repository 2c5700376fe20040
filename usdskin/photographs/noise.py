"""Noise of a camera: given, or measured from the photographs themselves.

Where light makes S raw values above black, the variance is S / gain + read_noise^2 [DN^2], and
1/12 for rounding to whole numbers: photons are counted with a variance equal to their number
(European Machine Vision Association, "EMVA Standard 1288", release 4.0, section 2). Over
sensitivity settings the gain is proportional to 1 / ISO.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.notes import Note
from usdskin.photographs.bracket import OpenBracket, Samples

FloatArray = NDArray[np.float64]

_MOST_SAMPLES = 2**14  # pixels of a pair of photographs
_REFINEMENTS = 3
_LEAST_SAMPLES = 64  # of a bin
_LEAST_BINS = 8
_BIN_WIDTH = 1.0 / 1024.0  # of linear values, and
_BIN_RATIO = 0.2  # of the level
_MODEL_ERROR = 0.03  # of a bin's variance: the model is no better
_WELL_EXPOSED = 0.85
_NORMAL = 1.4826  # standard deviation of normal noise over its median absolute deviation
_CUT = 4.0  # standard deviations
_KEPT_VARIANCE = 0.99893  # of a normal distribution within 4 standard deviations
_ROUNDS = 12
_LEAST_VARIANCE = 1e-14  # of linear values, far below any camera's


@dataclass(frozen=True, slots=True, eq=False)
class NoiseModel:
    """Noise of the raw values of a bracket, in the order of the layer's images."""

    gain: FloatArray
    """Electrons per raw value [DN^-1], shape [image_count]."""

    read_noise: FloatArray
    """Standard deviation without light [DN], shape [image_count]."""

    gain_source: str
    """``given``, ``measured`` (from pairs of exposures) or ``texture`` (from neighbouring pixels of
    single photographs, which takes fine texture for noise)."""

    read_noise_source: str
    """As ``gain_source``."""


@dataclass(frozen=True, slots=True, eq=False)
class _Differences:
    """Differences of linear values that show the same light, and how their variance is made.

    Of the unknowns, which are the variance of photons per linear value at ISO 100, that of the read
    noise of each sensitivity, and the square of the contrast of motion or texture, it is
    ``rows(level) @ unknowns + rounding(level)``.
    """

    value: FloatArray
    level: FloatArray
    photon: float
    read: FloatArray
    rounding: Callable[[FloatArray], FloatArray]

    def rows(self, level: FloatArray) -> FloatArray:
        """Return the factors of the unknowns, shape [level_count, unknown_count]."""
        lit = np.maximum(level, 0.0)[:, None]
        read = np.broadcast_to(self.read, (len(level), len(self.read)))
        return np.concatenate([lit * self.photon, read, lit**2], axis=1)


@dataclass(frozen=True, slots=True, eq=False)
class _Bin:
    """The measured variance of some differences of about one level."""

    count: int
    variance: float
    rounding: float
    row: FloatArray


def find_noise(
    bracket: OpenBracket, samples: Samples, exposure: FloatArray, notes: list[Note]
) -> NoiseModel:
    """Return the noise model of a bracket, measured where the layer does not give it.

    Args:
        bracket: The photographs.
        samples: Some rows of all of them.
        exposure: Their exposures, in their order [s], shape [image_count].
        notes: Told where pairs of exposures could not tell the noise.
    """
    given = bracket.view.bracket
    if given.gain is not None and given.read_noise is not None:
        return NoiseModel(given.gain, given.read_noise, "given", "given")
    isos, group = np.unique(bracket.iso, return_inverse=True)
    groups = np.eye(len(isos))[group]
    source = "measured"
    found = _solve(lambda last: _pairs(bracket, samples, exposure, groups, last), _LEAST_BINS)
    if found is None:
        source = "texture"
        found = _solve(lambda last: _neighbours(bracket, samples, groups), 1)
        notes.append(
            Note(
                "noise-from-texture",
                bracket.view.where,
                "no two exposures overlap enough to measure the camera's noise, so fine texture "
                "counts as noise; author bracket:gain and bracket:readNoise",
            )
        )
    if found is None:  # all is saturated, which the merge is going to say
        found = np.zeros(len(isos) + 2)
    scale = bracket.scale.mean()
    back = np.argsort(bracket.order)
    gain = 1.0 / np.maximum(found[0] * bracket.iso / 100.0, _LEAST_VARIANCE) / scale
    read_noise = np.sqrt(groups @ found[1:-1]) * scale
    return NoiseModel(
        gain=gain[back] if given.gain is None else given.gain,
        read_noise=read_noise[back] if given.read_noise is None else given.read_noise,
        gain_source=source if given.gain is None else "given",
        read_noise_source=source if given.read_noise is None else "given",
    )


def _pairs(
    bracket: OpenBracket,
    samples: Samples,
    exposure: FloatArray,
    groups: FloatArray,
    last: FloatArray | None,
) -> Iterator[_Differences]:
    """Compare neighbours in exposure, as values of the shorter one.

    Merged by inverse variance, the level does not correlate with the difference: else bins of the
    one would narrow the other. Until the unknowns are found, the sum of counts does for photons.
    """
    for k in range(1, len(bracket.frames)):
        well = np.asarray((samples.fraction[k - 1 : k + 1] < _WELL_EXPOSED).all(axis=0))
        chosen = _thinned(well)
        short, long = (_taken(samples.linear[index], chosen) for index in (k - 1, k))
        step = exposure[k] / exposure[k - 1]
        iso = bracket.iso[k - 1 : k + 1] / 100.0
        weight: FloatArray | float = 1.0
        if last is not None:
            lit = last[0] * np.maximum((short + long) / (1.0 + step), 0.0)
            variance = lit * iso[0] + groups[k - 1] @ last[1:-1] + _LEAST_VARIANCE
            weight = (
                step * variance / (lit * step * iso[1] + groups[k] @ last[1:-1] + _LEAST_VARIANCE)
            )

        def rounding(level: FloatArray, step: float = step) -> FloatArray:
            return np.asarray(bracket.rounding(level) + bracket.rounding(level * step) / step**2)

        yield _Differences(
            value=short - long / step,
            level=(short + weight * long) / (1.0 + weight * step),
            photon=iso[0] + iso[1] / step,
            read=groups[k - 1] + groups[k] / step**2,
            rounding=rounding,
        )


def _neighbours(
    bracket: OpenBracket, samples: Samples, groups: FloatArray
) -> Iterator[_Differences]:
    """Compare pixels with the mean of their left and right neighbours."""
    for k in range(len(bracket.frames)):
        linear = samples.linear[k]
        well = samples.fraction[k] < _WELL_EXPOSED
        well = well[:, :-2] & well[:, 1:-1] & well[:, 2:]
        chosen = _thinned(well)
        parts = (linear[:, :-2], linear[:, 1:-1], linear[:, 2:])
        left, here, right = (_taken(part, chosen) for part in parts)
        yield _Differences(
            value=(left + right) / 2.0 - here,
            level=(left + here + right) / 3.0,
            photon=1.5 * bracket.iso[k] / 100.0,
            read=1.5 * groups[k],
            rounding=lambda level: np.asarray(1.5 * bracket.rounding(level)),
        )


def _thinned(well: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the rows and columns of an even choice of the pixels that are well exposed."""
    flat = np.flatnonzero(well)
    rows, columns = np.divmod(flat[:: max(flat.size // _MOST_SAMPLES, 1)], well.shape[1])
    return rows, columns


def _taken(
    linear: NDArray[np.float32], chosen: tuple[NDArray[np.intp], NDArray[np.intp]]
) -> FloatArray:
    """Return the linear values of every channel of chosen pixels, shape [3 pixel_count]."""
    return linear[chosen].ravel().astype(np.float64)


def _solve(
    compare: Callable[[FloatArray | None], Iterator[_Differences]], least_bins: int
) -> FloatArray | None:
    """Fit the unknowns, with better levels and weights each time; None if there is too little."""
    found: FloatArray | None = None
    for _ in range(_REFINEMENTS):
        bins = [part for differences in compare(found) for part in _binned(differences, found)]
        if len(bins) < least_bins:
            return None
        found = _fit(bins)
    return found


def _binned(differences: _Differences, last: FloatArray | None) -> Iterator[_Bin]:
    """Measure the variance of differences in bins of their level.

    Bins are wide beside the steps of raw values: level and difference of two whole numbers tell one
    another exactly. So differences are compared with what the last fit expects of each.
    """
    level = differences.level
    step = np.sqrt(12.0 * differences.rounding(np.array([_BIN_WIDTH])))[0]
    width = max(_BIN_WIDTH, 4.0 * step)
    knee = width / _BIN_RATIO  # from here on bins grow in proportion
    above = np.log(np.maximum(level, knee) / knee) / np.log1p(_BIN_RATIO)
    # What lies below 0 belongs to the first bin: darkness is one level.
    index = (np.clip(level, 0.0, knee) / width).astype(np.int64) + above.astype(np.int64)
    expected = np.ones(len(level))
    if last is not None:
        expected = differences.rows(level) @ last + differences.rounding(level)
        expected = np.maximum(expected, _LEAST_VARIANCE)
    order = np.argsort(index, kind="stable")
    begins = np.flatnonzero(np.diff(index[order], prepend=-1))
    for members in np.split(order, begins[1:]):
        if len(members) < _LEAST_SAMPLES:
            continue
        mean = np.array([max(float(level[members].mean()), 0.0)])
        rounding = differences.rounding(mean)[0]
        off = (differences.value[members] - np.median(differences.value[members])) / np.sqrt(
            expected[members]
        )
        typical = float(expected[members].mean())
        least = np.sqrt(12.0 * rounding / typical)  # one raw value: the median is no finer
        kept = np.abs(off) <= _CUT * max(_NORMAL * float(np.median(np.abs(off))), least)
        ratio = float(np.mean(off[kept] ** 2)) / _KEPT_VARIANCE
        yield _Bin(len(members), typical * ratio, float(rounding), differences.rows(mean)[0])


def _fit(bins: Sequence[_Bin]) -> FloatArray:
    """Return the non-negative unknowns that fit bins best by least squares of relative differences.

    Bins above the model, which motion and edges widen, lose their say (Cauchy's weights).
    """
    variance = np.array([part.variance for part in bins])
    rounding = np.array([part.rounding for part in bins])
    rows = np.stack([part.row for part in bins])
    scatter = np.sqrt(2.0 / np.array([part.count for part in bins]) + _MODEL_ERROR**2)
    model = np.maximum(variance, _LEAST_VARIANCE)
    found = np.zeros(rows.shape[1])
    for _ in range(_ROUNDS):
        excess = (variance - model) / model / scatter
        weight = 1.0 / (model * scatter * np.sqrt(1.0 + (excess / 3.0) ** 2))
        found = _non_negative(rows * weight[:, None], (variance - rounding) * weight)
        model = np.maximum(rows @ found + rounding, _LEAST_VARIANCE)
    return found


def _non_negative(matrix: FloatArray, target: FloatArray) -> FloatArray:
    """Solve least squares, taking out the most negative unknown until there is none."""
    found = np.zeros(matrix.shape[1])
    free = np.flatnonzero(matrix.any(axis=0))
    while len(free):
        size = np.linalg.norm(matrix[:, free], axis=0)
        solved = np.linalg.lstsq(matrix[:, free] / size, target, rcond=None)[0] / size
        if solved.min() >= 0.0:
            found[free] = solved
            break
        free = np.delete(free, int((solved * size).argmin()))
    return found
