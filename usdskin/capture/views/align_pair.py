"""How far one view is turned against another, measured where both see.

Gauss-Newton on the difference of the band-passed log-radiance, from coarse to fine. What the result
is worth is told by the coherence of the two views' derivatives: with f and g the change of either
view as it turns about an axis, sum(f g) / sum((f^2 + g^2) / 2) is 1 where both see the same and 0
where they see noise or different things, however strong that is.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.views.align_features import Level, Samples, sample, sample_band
from usdskin.capture.views.align_view import AlignView
from usdskin.capture.views.rotation_vectors import rotation_by, vector_of

FloatArray = NDArray[np.float64]

_JUDGED_DEG = 0.5
"""Pixels at which a pair is judged are this wide or up to twice [deg]: so fine that chance does not
align them."""

_COHERENT = 0.2
"""Least coherence of an axis. In thin overlaps that fit it was 0.36 and more, between 300 views of
different places 0.13 at most."""

_CERTAIN = 5.0
"""Least coherence of an axis, in deviations of what noise would show."""

_FAINT = 0.01
"""Root mean square of the band-passed logarithm below which a view shows nothing."""

_WHITE = 0.75
"""Contrast relative to that of pixels half as wide below which it is noise; white noise has 0.5,
what a scene shows about 1."""

_ONE_WAY = 0.02
"""Share of the strongest axis's power below which the views show nothing about another."""

_ALIKE = 0.5
"""Correlation of views that fit as far as they show anything."""

_FEWEST = 40
"""Independent details that two views must share."""

_FEWEST_TO_STEP = 10
"""The same while the views are being turned, on coarser levels."""

_SEARCH_DEG = 1.4
"""Pixels that a search is made with are this wide or up to twice [deg]."""

_SEARCH_STEP_PX = 2.0
"""Distance of the rotations tried [px]."""

_FOLLOWED = 20
"""How many of them are followed on the coarsest level."""

_STARTS = 5
"""How many of those are followed to finer ones."""

_PROMISING = 0.2
"""Correlation below which none is followed on."""

_GLANCES = 4000
"""Directions over the whole sphere by which rotations are tried."""

_DETAIL_PX = 12.0
"""Area over which a band-passed level varies together, about 4 pi sigma^2 [px]."""

_MOST_SAMPLES = 60_000
"""Directions over the whole sphere."""

_STEPS = 12
"""Gauss-Newton steps at one level, at most."""

_SMALL_STEP_PX = 0.005
"""Step that ends a level [px]."""

_SLACK = 0.01
"""How far the correlation may fall while the views are being turned."""

_LARGE_STEP_PX = 2.0
"""Longest step [px]; the band has lost its memory beyond."""

_HUBER = 1.345
"""Deviations beyond which a difference counts as an outlier: 95 % efficient if there are none."""


@dataclass(frozen=True, slots=True, eq=False)
class PairFit:
    """How two views fit."""

    state: str
    """``constrained``, ``apart`` (they hardly overlap), ``featureless`` (about some axis), or
    ``contradicting`` (both have features, but not the same)."""

    rotation: FloatArray
    """Rotation of the second view with which it fits the first as stated, shape [3, 3]."""

    information: FloatArray
    """Weight of that rotation about the axes of the panorama's frame, shape [3, 3]."""

    overlap: float
    """Share of the sphere that both see, as stated [1]."""

    correlation_before: float
    """Of the views' details, as stated [1]."""

    correlation: float
    """Of the views' details, when turned [1]."""

    gain: float
    """Median ratio of the second view's values to the first's."""


def fit_pair(
    first: AlignView,
    second: AlignView,
    first_levels: list[Level],
    second_levels: list[Level],
    search_deg: float,
) -> PairFit:
    """Measure how the second view must be turned to fit the first.

    Args:
        first: The view that stays.
        second: The view that turns.
        first_levels: Its pyramid, the finest level first.
        second_levels: The other's.
        search_deg: How far to look where the way down from the stated rotation leads nowhere [deg].
    """
    levels = [
        _PairLevel(first, second, one, other)
        for one, other in _matched(first_levels, second_levels)
    ]
    judge = next(
        (i for i, level in enumerate(levels) if np.degrees(level.spacing) >= _JUDGED_DEG),
        len(levels) - 1,
    )
    stated = second.rotation
    before = levels[judge].compare(stated)
    state, rotation = "apart", stated
    if before.details >= _FEWEST:
        state, rotation = _turned(levels, judge, stated, search_deg)
    after = levels[judge].compare(rotation)
    return PairFit(
        state=state,
        rotation=rotation,
        information=after.cross if state == "constrained" else np.zeros((3, 3)),
        overlap=before.share,
        correlation_before=before.correlation,
        correlation=after.correlation,
        gain=after.gain,
    )


def _turned(
    levels: list[_PairLevel], judge: int, stated: FloatArray, search_deg: float
) -> tuple[str, FloatArray]:
    """Return the state of a pair and the rotation that its second view is found to have."""
    tried: list[_Comparison] = []
    for rotation, reach in _starts(levels, stated, search_deg):
        for level in reversed(levels[judge:reach]):
            rotation, correlation = level.descend(rotation)
            if tried and correlation < _PROMISING:
                break
        tried.append(levels[judge].compare(rotation))
        if tried[-1].is_coherent:
            break
        if len(tried) == 1 and _is_noise(tried[0], levels[max(judge - 1, 0)].compare(rotation)):
            return "featureless", stated
        if tried[0].is_one_way and tried[0].correlation > _ALIKE:
            return "featureless", stated
    else:
        return "featureless" if tried[0].is_one_way else "contradicting", stated
    for level in reversed(levels[:judge]):
        finer, _ = level.descend(rotation)
        if not level.compare(finer).is_coherent:
            break  # so fine that it is noise
        rotation = finer
    return "constrained", rotation


def _matched(first: list[Level], second: list[Level]) -> list[tuple[Level, Level]]:
    """Return levels of about equal scale: for each of the coarser picture one of the other's."""

    def nearest(levels: list[Level], spacing: float) -> Level:
        return min(levels, key=lambda level: abs(np.log(level.spacing / spacing)))

    if first[0].spacing >= second[0].spacing:
        return [(level, nearest(second, level.spacing)) for level in first]
    return [(nearest(first, level.spacing), level) for level in second]


def _starts(
    levels: list[_PairLevel], stated: FloatArray, search_deg: float
) -> Iterator[tuple[FloatArray, int]]:
    """Yield rotations to begin at, and on how many of the levels to follow them.

    First as stated; then the most promising ones around, which are the best of a grid, followed
    uphill on a coarse level.
    """
    yield stated, len(levels)
    index = next(
        (i for i, level in enumerate(levels) if np.degrees(level.spacing) > _SEARCH_DEG),
        len(levels) - 1,
    )
    level = levels[index]
    pace = _SEARCH_STEP_PX * level.spacing
    steps = int(np.radians(search_deg) / pace)
    axis = np.arange(-steps, steps + 1.0)
    grid = np.stack(np.meshgrid(axis, axis, axis), axis=-1).reshape(-1, 3)
    grid = grid[np.linalg.norm(grid, axis=1) <= steps]
    rotations = [rotation_by(pace * node) @ stated for node in grid]
    peaks = _best(rotations, level.glance, _FOLLOWED, 1.5 * pace)
    summits = [level.descend(rotation)[0] for rotation in peaks]
    for summit in _best(summits, lambda found: level.compare(found).score, _STARTS, 0.5 * pace):
        yield summit, index


def _best(
    rotations: list[FloatArray],
    score: Callable[[FloatArray], float],
    count: int,
    apart: float,
) -> list[FloatArray]:
    """Return the rotations that score best and are an angle apart [rad], best first."""
    kept: list[FloatArray] = []
    for index in np.argsort([-score(rotation) for rotation in rotations], kind="stable"):
        rotation = rotations[index]
        if all(np.linalg.norm(vector_of(rotation @ other.T)) > apart for other in kept):
            kept.append(rotation)
        if len(kept) == count:
            break
    return kept


def _is_noise(found: _Comparison, finer: _Comparison) -> bool:
    return found.contrast < max(_FAINT, _WHITE * finer.contrast)


class _PairLevel:
    """Two views at one scale."""

    def __init__(self, first: AlignView, second: AlignView, one: Level, other: Level) -> None:
        self.spacing = max(one.spacing, other.spacing)
        self._views, self._levels = (first, second), (one, other)
        self._count = min(int(4.0 * np.pi / self.spacing**2), _MOST_SAMPLES)
        self._in_detail = max(_DETAIL_PX * self.spacing**2 * self._count / (4.0 * np.pi), 1.0)

    @cached_property
    def _fixed(self) -> tuple[FloatArray, Samples]:
        """The directions that the first view sees, and it there."""
        directions = _directions(self._count)
        view = self._views[0]
        seen, samples = sample(self._levels[0], view.lens, view.rotation, directions)
        return directions[seen], samples

    def compare(self, rotation: FloatArray) -> _Comparison:
        """Return both views where both see, the second one with a given rotation."""
        directions, fixed = self._fixed
        both, moving = sample(self._levels[1], self._views[1].lens, rotation, directions)
        return _Comparison(
            first=Samples(fixed.band[both], fixed.moment[both], fixed.log[both]),
            second=moving,
            share=float(both.sum()) / self._count,
            details=float(both.sum()) / self._in_detail,
            faint=_FAINT / self.spacing,
        )

    def glance(self, rotation: FloatArray) -> float:
        """Return about the score of a comparison, quickly."""
        directions, fixed = self._fixed
        every = slice(None, None, self._count // _GLANCES + 1)
        lens = self._views[1].lens
        both, moving = sample_band(self._levels[1], lens, rotation, directions[every])
        return _correlation(fixed.band[every][both], moving) * math.sqrt(int(both.sum()))

    def descend(self, rotation: FloatArray) -> tuple[FloatArray, float]:
        """Return the rotation of the second view that fits best near a given one, and how well."""
        best, best_correlation = rotation, -1.0
        for _ in range(_STEPS):
            found = self.compare(rotation)
            if found.details < _FEWEST_TO_STEP:
                break
            # Where outliers weigh less the correlation may fall a little; it must not be lost.
            if found.correlation > best_correlation - _SLACK:
                best, best_correlation = rotation, max(found.correlation, best_correlation)
            step = found.step()
            length = float(np.linalg.norm(step)) / self.spacing
            rotation = rotation_by(step * min(1.0, _LARGE_STEP_PX / max(length, 1e-12))) @ rotation
            if length < _SMALL_STEP_PX:
                break
        return best, best_correlation


@dataclass(frozen=True, slots=True, eq=False)
class _Comparison:
    """Two views at the directions that both see."""

    first: Samples
    second: Samples

    share: float
    """Share of the sphere [1]."""

    details: float
    """How many of them are independent."""

    faint: float
    """Derivative that counts as nothing [rad^-1]."""

    @property
    def correlation(self) -> float:
        return _correlation(self.first.band, self.second.band)

    @property
    def score(self) -> float:
        """Correlation in deviations of what chance would give."""
        return self.correlation * math.sqrt(self.details)

    @property
    def contrast(self) -> float:
        """Root mean square of the fainter view."""
        return min(_rms(self.first.band), _rms(self.second.band))

    @property
    def gain(self) -> float:
        if not self.first.log.size:
            return 1.0
        return float(np.exp(np.median(self.second.log - self.first.log)))

    @property
    def cross(self) -> FloatArray:
        """What both views show as they turn about the axes, shape [3, 3]."""
        product = np.einsum("ni,nj->ij", self.first.moment, self.second.moment)
        return np.asarray(0.5 * (product + product.T))

    @property
    def power(self) -> FloatArray:
        """What either shows, noise included, shape [3, 3]."""
        moments = (self.first.moment, self.second.moment)
        return np.asarray(0.5 * sum(np.einsum("ni,nj->ij", m, m) for m in moments))

    @property
    def is_one_way(self) -> bool:
        """Whether turning about some axis changes nothing, noise apart."""
        powers = np.linalg.eigvalsh(self.power)
        nothing = len(self.first.band) * self.faint**2
        return bool(powers[0] < max(_ONE_WAY * powers[2], nothing))

    @property
    def is_coherent(self) -> bool:
        """Whether the views are known to show the same, about every axis."""
        power = self.power + len(self.first.band) * self.faint**2 * np.eye(3)
        inverse = np.linalg.inv(np.linalg.cholesky(power))
        coherence = np.linalg.eigvalsh(inverse @ self.cross @ inverse.T)
        return bool(coherence[0] >= max(_COHERENT, _CERTAIN / np.sqrt(max(self.details, 1.0))))

    def step(self) -> FloatArray:
        """Return the Gauss-Newton step of the second view, a rotation vector [rad]."""
        difference = self.second.band - self.first.band
        size = np.abs(difference)
        bound = max(_HUBER * 1.4826 * float(np.median(size)), 1e-6)
        weight = bound / np.maximum(size, bound)
        slope = 0.5 * (self.first.moment + self.second.moment)
        normal = np.einsum("n,ni,nj->ij", weight, slope, slope)
        right = np.einsum("n,ni,n->i", weight, slope, difference)
        return np.asarray(np.linalg.pinv(normal, rcond=1e-9, hermitian=True) @ right)


def _correlation(one: FloatArray, other: FloatArray) -> float:
    power = float((one * one).sum() * (other * other).sum())
    return float((one * other).sum() / np.sqrt(power)) if power > 0.0 else 0.0


def _rms(values: FloatArray) -> float:
    return float(np.sqrt((values * values).mean())) if values.size else 0.0


@lru_cache(maxsize=8)
def _directions(count: int) -> FloatArray:
    """Return directions spread evenly over the sphere along a Fibonacci spiral."""
    index = np.arange(count) + 0.5
    y = 1.0 - 2.0 * index / count
    turn = np.pi * (1.0 + np.sqrt(5.0)) * index
    radius = np.sqrt(1.0 - y * y)
    return np.stack([radius * np.cos(turn), y, radius * np.sin(turn)], axis=1)
