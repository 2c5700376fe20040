"""How well the skin prior recovers skin of origins it has not seen.

Colour difference: CIEDE2000, CIE 1931 2 degrees, of the recovered diffuse reflectance from the
measured one under each light; Y and white are those of the perfect diffuser in that light; no mask.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import delta_e_2000, illuminant
from usdskin.differences import lab_of_signals
from usdskin.estimate.skin.generate import MeasuredSkin
from usdskin.estimate.skin.prior import fit_prior, skin_map
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as GRID

FloatArray = NDArray[np.float64]
IndexArray = NDArray[np.intp]

LIGHTS = ("D65", "A", "FL2", "FL11", "LED-B3")

TONES = (55.0, 41.0, 28.0, 10.0, -30.0)
"""Bounds of the six classes of the typology angle [deg]; class 1 is the lightest (S. Del Bino and
F. Bernerd, "Variations in skin colour and the biological consequences of ultraviolet radiation
exposure", Br. J. Dermatol. 169(s3), 2013)."""


@dataclass(frozen=True, slots=True, eq=False)
class Errors:
    """Colour differences of all skins, each judged by a prior that has not seen its origin."""

    delta_e: FloatArray
    """Shape [camera, taking light, light of the judgement, skin]."""

    inside: FloatArray
    """Share of bands within one stated standard deviation, shape [camera, taking light, skin]."""

    tone: IndexArray
    """Class of each skin, 0 the lightest, shape [skin]."""

    @property
    def own(self) -> FloatArray:
        """Under the taking light, mean over cameras and lights, shape [skin]."""
        same = np.arange(len(LIGHTS))
        return np.asarray(self.delta_e[:, same, same].mean(axis=(0, 1)))

    @property
    def other(self) -> FloatArray:
        """Under the four other lights, mean over cameras and lights, shape [skin]."""
        apart = ~np.eye(len(LIGHTS), dtype=bool)
        return np.asarray(self.delta_e[:, apart].mean(axis=(0, 1)))

    @property
    def pairs(self) -> FloatArray:
        """Means by taking light and light of the judgement, shape [5, 5]."""
        return np.asarray(self.delta_e.mean(axis=(0, 3)))

    def by_tone(self, values: FloatArray) -> FloatArray:
        """Means over the skins of each class, shape [6]."""
        return np.array([values[..., self.tone == tone].mean() for tone in range(6)])


def _origins_in_turn(
    skin: MeasuredSkin, step: int
) -> Iterator[tuple[NDArray[np.bool_], IndexArray]]:
    """Yield which skins to fit to, and every step-th of those to judge."""
    for origin in np.unique(skin.origin):
        yield skin.origin != origin, np.flatnonzero(skin.origin == origin)[::step]


def judge_origins(
    skin: MeasuredSkin, cameras: Sequence[FloatArray], noise: float, step: int = 1
) -> Errors:
    """Return the errors of held-out skins.

    Args:
        skin: Measured skins.
        cameras: Responsivities, shape [61, 3] each.
        noise: Standard deviation of a camera value over the value.
        step: Judge every step-th skin only.
    """
    lights = [illuminant(name, GRID) for name in LIGHTS]
    parts, inside, tones = [], [], []
    for fitted, judged in _origins_in_turn(skin, step):
        prior = fit_prior(skin.reflectance[fitted], GRID, skin.origin[fitted])
        truth = skin.reflectance[judged]
        expected = [lab_of_signals(truth * light, light, GRID) for light in lights]
        error = np.empty((len(cameras), len(lights), len(lights), len(judged)))
        covered = np.empty((len(cameras), len(lights), len(judged)))
        for camera, responsivity in enumerate(cameras):
            for taking, light in enumerate(lights):
                seen = light[:, None] * responsivity
                mapped = skin_map(prior, seen / seen.sum(axis=0), noise)
                rng = np.random.default_rng([int(judged[0]), camera, taking])
                values = truth @ mapped.seen
                values *= 1.0 + noise * rng.standard_normal(values.shape)
                found = mapped(values)
                covered[camera, taking] = (np.abs(found - truth) < mapped.stddev(values)).mean(1)
                for number, other in enumerate(lights):
                    lab = lab_of_signals(found * other, other, GRID)
                    error[camera, taking, number] = delta_e_2000(lab, expected[number])
        parts.append(error)
        inside.append(covered)
        tones.append(np.searchsorted(-np.array(TONES), -skin.tone_deg[judged]))
    return Errors(
        np.concatenate(parts, axis=3), np.concatenate(inside, axis=2), np.concatenate(tones)
    )
