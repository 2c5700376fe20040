"""Fit the lustre jointly with the skin, and notice a lustre that was not asked for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.covariance import Noise
from usdskin.estimate.skin.lobe import Lobe
from usdskin.estimate.skin.model import Coefficients, Freedom, SkinModel
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.robust import RobustFit, Solver, fit_robustly
from usdskin.estimate.skin.solve import SCAN, Solution, descend, scan, solve

FloatArray = NDArray[np.float64]

_ROUGHNESSES = (0.15, 0.25, 0.4, 0.65)
_WEIGHTS = (0.1, 0.4, 1.0)
_WRAPS = SCAN[::3]
_PAIRS = ((1.4, 0.6, 0.3), (1.2, 0.5, 0.6), (1.0, 0.6, 0.1), (1.6, 1.0, 0.9))
"""Two lobes tried after one: roughnesses over its own, and the share of the second."""

_SECOND_LOBE_GAIN = 15.0
"""Fall of chi2, in units of its mean, that makes a second lobe worth its two numbers."""

_MOST_TRIED = 12000
_LEAST_TRIED = 200

_SEEN_GAIN = 30.0
_SEEN_RATIO = 1.5
_SEEN_SHARE = 0.02


def fit_gloss(
    readings: Readings,
    freedom: Freedom,
    fixed: Coefficients,
    noise: Noise,
    robust: bool,
    f0: float,
) -> tuple[SkinModel, RobustFit]:
    """Return the joint fit with one lobe, or with two where readings ask for them.

    Args:
        readings: All of them are offered; they have views.
        freedom: What of the skin is free.
        fixed: What is not.
        noise: Standard deviations, where readings have none.
        robust: Whether outliers are left out.
        f0: Reflectance of the surface at normal incidence [1].
    """
    single = SkinModel(readings, replace(freedom, lobes=1))
    one = fit_robustly(readings, single, _one_lobe(readings, freedom, fixed, f0), noise, robust)
    found = one.solution.coefficients.lobe
    assert found is not None
    if found.weight < 1e-4:
        return single, one
    double = SkinModel(readings, replace(freedom, lobes=2))
    two = fit_robustly(readings, double, _two_lobes(readings, double, one), noise, robust)
    shared = one.keep & two.keep
    gain = _cost(one, shared) - _cost(two, shared)
    return (double, two) if gain > _SECOND_LOBE_GAIN * two.scale**2 else (single, one)


def _cost(fit: RobustFit, keep: NDArray[np.bool_]) -> float:
    return float(((fit.residuals / fit.sigma)[keep] ** 2).sum())


def _one_lobe(readings: Readings, freedom: Freedom, fixed: Coefficients, f0: float) -> Solver:
    model = SkinModel(readings, replace(freedom, lobes=1))

    def run(weights: FloatArray, before: Solution | None) -> Solution:
        if before is not None:
            end = descend(model, before.coefficients, readings.values, weights)
            return replace(end, coefficients=_as_one(end.coefficients))
        some = thinned(readings)
        few, few_weights = readings.part(some), weights[some]
        base = fixed
        if freedom.delta:
            base = solve(few, replace(freedom, lobes=0), fixed, few_weights).coefficients
        wraps = _WRAPS if freedom.wrap else np.array([fixed.wrap])
        starts = []
        for roughness in _ROUGHNESSES:
            for weight in _WEIGHTS:
                at = replace(base, lobe=Lobe(weight, roughness, roughness, 0.0, f0))
                starts.append(scan(few, at, freedom, few_weights, wraps))
        starts.sort(key=lambda start: start.cost)
        best = _best_end(
            few, model.freedom, few_weights, [each.coefficients for each in starts[:4]]
        )
        end = descend(model, _as_one(best), readings.values, weights)
        return replace(end, coefficients=_as_one(end.coefficients))

    return run


def _best_end(
    readings: Readings, freedom: Freedom, weights: FloatArray, starts: list[Coefficients]
) -> Coefficients:
    model = SkinModel(readings, freedom)
    ends = [descend(model, start, readings.values, weights) for start in starts]
    return min(ends, key=lambda end: end.cost).coefficients


def thinned(readings: Readings) -> NDArray[np.intp]:
    """Return evenly chosen readings, few enough to try many starts on."""
    count, channels = readings.values.shape
    most = max(_LEAST_TRIED, _MOST_TRIED // channels)
    return np.arange(0, count, max(1, -(-count // most)))


def _as_one(at: Coefficients) -> Coefficients:
    assert at.lobe is not None
    return replace(at, lobe=replace(at.lobe, roughness2=at.lobe.roughness1, mix=0.0))


def _two_lobes(readings: Readings, model: SkinModel, one: RobustFit) -> Solver:
    def run(weights: FloatArray, before: Solution | None) -> Solution:
        if before is not None:
            end = descend(model, before.coefficients, readings.values, weights)
            return replace(end, coefficients=_ordered(end.coefficients))
        some = thinned(readings)
        few, few_weights = readings.part(some), weights[some]
        base = one.solution.coefficients
        assert base.lobe is not None
        starts = []
        for wide, narrow, mix in _PAIRS:
            first = min(wide * base.lobe.roughness1, 1.0)
            second = max(narrow * base.lobe.roughness1, 0.05)
            lobe = replace(base.lobe, roughness1=first, roughness2=second, mix=mix)
            starts.append(replace(base, lobe=lobe))
        best = _best_end(few, model.freedom, few_weights, starts)
        end = descend(model, best, readings.values, weights)
        return replace(end, coefficients=_ordered(end.coefficients))

    return run


def _ordered(at: Coefficients) -> Coefficients:
    """Return the same lobes, the rougher one first."""
    lobe = at.lobe
    assert lobe is not None
    if lobe.roughness1 >= lobe.roughness2:
        return at
    turned = Lobe(lobe.weight, lobe.roughness2, lobe.roughness1, 1.0 - lobe.mix, lobe.f0)
    return replace(at, lobe=turned)


# --- A lustre nobody asked for -------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class SeenGloss:
    """What a lobe would explain in readings that were fitted without one."""

    share: float
    """The largest it adds to a reading, as a share of the largest diffuse one [1]."""

    wrap: float
    """l with the lobe [1]."""

    gain: float
    """Fall of chi2, in units of its mean with the lobe [1]."""

    ratio: float
    """Mean square of the residuals without over that with the lobe [1]."""

    mirror_deg: float
    """Angle between the view and the mirrored light where it adds most [deg]."""

    @property
    def is_there(self) -> bool:
        """Whether readings rise towards the mirror direction beyond doubt."""
        seen = self.gain > _SEEN_GAIN and self.ratio > _SEEN_RATIO
        return seen and self.share > _SEEN_SHARE

    @property
    def is_suspected(self) -> bool:
        """Whether they seem to."""
        return self.gain > _SEEN_GAIN and self.share > 0.005


def seen_gloss(
    readings: Readings,
    freedom: Freedom,
    fixed: Coefficients,
    noise: Noise,
    f0: float,
) -> SeenGloss | None:
    """Return what one lobe would explain, or None where no reading could show any.

    Both models are fitted to the readings that the one with the lobe can explain: a fit without
    it would call them outliers.

    Args:
        readings: All of them are offered.
        freedom: What of the skin is free.
        fixed: What is not.
        noise: Standard deviations, where readings have none.
        f0: Reflectance of the surface at normal incidence [1].
    """
    if readings.view is None or not (readings.cosine > 0.0).any():
        return None
    model = SkinModel(readings, replace(freedom, lobes=1))
    with_lobe = fit_robustly(
        readings, model, _one_lobe(readings, freedom, fixed, f0), noise, robust=True
    )
    kept = readings.part(with_lobe.keep)
    weights = 1.0 / with_lobe.sigma[with_lobe.keep] ** 2
    without = solve(kept, replace(freedom, lobes=0), fixed, weights)
    least = max(with_lobe.chi2, 1e-300)
    at = with_lobe.solution.coefficients
    shine = model.shine(at)
    diffuse = model.values(at) - shine[:, None]
    most = int(np.argmax(shine))
    return SeenGloss(
        share=float(shine[most] / max(float(diffuse.max()), 1e-12)),
        wrap=at.wrap,
        gain=(without.cost - least) / max(least / with_lobe.freedom, 1e-300),
        ratio=without.cost / least,
        mirror_deg=float(readings.mirror_deg[most]),
    )
