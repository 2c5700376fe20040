"""Exposures as the pictures show them, beside what is stated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.notes import Note
from usdskin.photographs.bracket import OpenBracket, Samples
from usdskin.photographs.noise import NoiseModel
from usdskin.warp_kernels.bracket import SATURATION

FloatArray = NDArray[np.float64]

NOTED_ERROR = 0.03
"""Relative error of a stated ratio of exposures that is told."""

REFUSED_ERROR = 0.25
"""Relative error of a stated ratio of exposures that cannot be a rounded shutter time."""

_WELL_EXPOSED = (0.01, 0.9)
"""Linear values that are far from the errors of a black level, and from saturation."""

_MOST_PIXELS = 200_000
_LEAST_PIXELS = 200
_LEAST_PRECISION = 0.01

_USABLE_SNR = 10.0
_HARDLY = 2.0


@dataclass(frozen=True, slots=True)
class ExposurePair:
    """Two photographs of a bracket that are neighbours in exposure."""

    shorter: int
    """Index of the image of less exposure, in the order of the bracket."""

    longer: int
    """Index of the image of more exposure."""

    stated: float
    """Ratio of their exposures, at least 1, by what the layer says [1]."""

    measured: float | None
    """The same by what the pictures say [1]; None: too few pixels are well exposed in both."""

    overlap: float
    """Image value at which the longer one saturates over the least one that the shorter one tells
    to 10 %: below 1 there is a gap, below 2 they hardly overlap [1]."""

    @property
    def error(self) -> float:
        """Relative difference of the measured ratio from the stated one; 0 if not measured [1]."""
        return 0.0 if self.measured is None else self.measured / self.stated - 1.0

    @property
    def is_gap(self) -> bool:
        """Whether the two leave a gap or hardly overlap."""
        return self.overlap < _HARDLY


def measure_ratios(bracket: OpenBracket, samples: Samples) -> list[float | None]:
    """Return how much more light each photograph shows than the one before it.

    Outliers such as moved objects have no say. A pair whose ratio is not known to 1 % by its own
    scatter gives None.
    """
    ratios: list[float | None] = []
    for k in range(1, len(bracket.frames)):
        stated = bracket.exposure[k] / bracket.exposure[k - 1]
        well = (samples.fraction[k - 1 : k + 1] < _WELL_EXPOSED[1]).all(axis=0)
        short, long = (samples.linear[index][well].astype(np.float64) for index in (k - 1, k))
        # Pixels are chosen by one photograph alone, and the noise of the other averages out. The
        # long one has less; it is no guide where it shows nothing.
        inverse = _quotient(short, long, 1.0 / stated)
        if inverse is not None:
            ratios.append(1.0 / inverse if inverse > 0.0 else np.inf)
        else:
            ratios.append(_quotient(long, short, stated))
    return ratios


def _quotient(other: FloatArray, chosen: FloatArray, stated: float) -> float | None:
    """Return the ratio of two exposures over the pixels that the second shows well.

    It is a ratio of sums: choosing the brightest pixels, or channels, would choose by noise.
    """
    other, chosen = other.ravel(), chosen.ravel()
    least, most = _WELL_EXPOSED
    well = np.flatnonzero(
        (np.minimum(1.0, stated) * chosen > least) & (np.maximum(1.0, stated) * chosen < most)
    )
    well = well[:: max(len(well) // _MOST_PIXELS, 1)]
    if len(well) < _LEAST_PIXELS:
        return None
    other, chosen = other[well], chosen[well]
    middle = float(np.median(other / chosen))
    off = (other - middle * chosen) / np.sqrt(chosen)  # the noise of photons is then even
    kept = np.abs(off) <= 4.0 * 1.4826 * np.median(np.abs(off)) + 1e-12
    total = chosen[kept].sum()
    found = max(float(other[kept].sum() / total), 0.0)
    uncertainty = np.sqrt(np.sum((other[kept] - found * chosen[kept]) ** 2)) / total
    return found if uncertainty < _LEAST_PRECISION * max(found, stated) else None


def least_values(bracket: OpenBracket, noise: NoiseModel) -> FloatArray:
    """Return the image value that each photograph tells to 10 % [1/s], shape [image_count]."""
    gain, read_noise = (part[bracket.order] for part in (noise.gain, noise.read_noise))
    # S / sqrt(S / gain + read_noise^2) = SNR, solved for S [DN].
    half = _USABLE_SNR**2 / gain / 2.0
    rounding = bracket.rounding(0.0) * bracket.scale.mean() ** 2
    least = half + np.sqrt(half**2 + _USABLE_SNR**2 * (read_noise**2 + rounding))
    return np.asarray(least / bracket.scale.mean() / bracket.exposure)


def compare_exposures(
    bracket: OpenBracket, ratios: Sequence[float | None], noise: NoiseModel
) -> tuple[ExposurePair, ...]:
    """Return the neighbours in exposure with what is stated, measured and usable."""
    least = least_values(bracket, noise)
    most = SATURATION / bracket.exposure
    return tuple(
        ExposurePair(
            shorter=int(bracket.order[k - 1]),
            longer=int(bracket.order[k]),
            stated=float(bracket.exposure[k] / bracket.exposure[k - 1]),
            measured=ratios[k - 1],
            overlap=float(most[k] / least[k - 1]),
        )
        for k in range(1, len(bracket.frames))
    )


def settle_exposures(
    bracket: OpenBracket,
    ratios: Sequence[float | None],
    use_measured: bool,
    notes: list[Note],
) -> tuple[FloatArray, float]:
    """Return the exposures to merge with [s], and by how much the pictures put them in doubt [1].

    Args:
        bracket: The photographs.
        ratios: What ``measure_ratios`` returned.
        use_measured: Take the measured ratios; the middle photograph keeps its stated exposure.
        notes: Takes stated ratios that are off by more than ``NOTED_ERROR``.

    Raises:
        LayerError: A stated ratio is off by more than ``REFUSED_ERROR``.
    """
    stated = bracket.exposure
    expected = stated[1:] / stated[:-1]
    measured = np.array(
        [e if ratio is None else ratio for ratio, e in zip(ratios, expected, strict=True)]
    )
    drift = np.cumsum([0.0, *np.log(np.clip(measured / expected, 1e-3, 1e3))])
    off = np.abs(measured / expected - 1.0)
    worst = int(off.argmax()) if len(off) else 0
    if len(off) and off[worst] > REFUSED_ERROR:
        raise LayerError(_contradiction(bracket, drift, worst, expected[worst], measured[worst]))
    if len(off) and off[worst] > NOTED_ERROR:
        done = "are used" if use_measured else "would mend it"
        notes.append(
            Note(
                "exposure-ratio",
                bracket.view.where,
                f"{bracket.name(worst + 1)} is stated to have {expected[worst]:.3g} times the "
                f"exposure of {bracket.name(worst)} and shows {measured[worst]:.3g} times, "
                f"{measured[worst] / expected[worst] - 1.0:+.1%} (shutter times in EXIF are "
                f"rounded); measured exposures {done}",
            )
        )
    if not use_measured:
        return stated, float(np.ptp(drift))
    return np.asarray(stated * np.exp(drift - np.sort(drift)[len(drift) // 2])), 0.0


def _contradiction(
    bracket: OpenBracket, drift: FloatArray, pair: int, expected: float, measured: float
) -> str:
    """Say which photograph's exposure is wrong: of a bad pair the one farther off the others."""
    middle = np.sort(drift)[(len(drift) - 1) // 2]
    away = np.abs(drift[pair : pair + 2] - middle)
    wrong, other = (pair, pair + 1) if away[0] > away[1] else (pair + 1, pair)
    if wrong == pair:
        expected, measured = 1.0 / expected, 1.0 / measured if measured else np.inf
    return (
        f"{bracket.view.where}: {bracket.frames[wrong].path} is stated to have {expected:.4g} "
        f"times the exposure of {bracket.name(other)}, but the pictures show {measured:.4g} times; "
        "correct its value in bracket:exposureTimes, :iso, :fNumbers or :ndFactors, or take the "
        "photograph out of bracket:images"
    )


def note_gaps(
    bracket: OpenBracket, pairs: Sequence[ExposurePair], notes: list[Note]
) -> tuple[ExposurePair, ...]:
    """Return the pairs that leave a gap or hardly overlap, and note them."""
    gaps = tuple(pair for pair in pairs if pair.is_gap)
    for pair in gaps:
        images = bracket.view.bracket.images
        what = "leave a gap" if pair.overlap < 1.0 else "hardly overlap"
        notes.append(
            Note(
                "exposure-gap",
                bracket.view.where,
                f"{images[pair.shorter].name} and {images[pair.longer].name}, {pair.stated:.3g} "
                f"times apart, {what}: between them light is known to worse than "
                f"{1.0 / _USABLE_SNR:.0%}; take smaller steps",
            )
        )
    return gaps
