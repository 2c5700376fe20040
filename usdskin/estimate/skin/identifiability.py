"""Which numbers the readings tell, in words."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.skin.model import Coefficients, Freedom
from usdskin.estimate.skin.readings import Readings
from usdskin.notes import Note

FloatArray = NDArray[np.float64]

PAST_DARK_DEG = 10.0
"""How far beyond acos(-l), where the wrap term ends, readings should go [deg]."""

_SLACK_DEG = 2.0
_KNOWN = 0.05
_POOR = 0.25
_LEAST_NEAR_EDGE = 3


@dataclass(frozen=True, slots=True)
class Identifiability:
    """What readings can and cannot tell."""

    reach_deg: float
    """Largest angle between normal and light [deg]."""

    needed_deg: float
    """Angle they should reach: 10 degrees beyond acos(-l) [deg]."""

    told: tuple[str, ...]
    """What they tell, a phrase each."""

    untold: tuple[str, ...]
    """What they do not, or poorly, and why."""

    @property
    def text(self) -> str:
        """Both, in one line."""
        parts = [f"told: {'; '.join(self.told)}"] if self.told else []
        parts += [f"not told: {'; '.join(self.untold)}"] if self.untold else []
        return ". ".join(parts)


def identifiability(
    readings: Readings,
    freedom: Freedom,
    at: Coefficients,
    names: tuple[str, ...],
    covariance: FloatArray,
) -> Identifiability:
    """Return in words what the Fisher matrix says.

    Args:
        readings: Those that were used.
        freedom: What was free.
        at: What was found.
        names: Names of the rows of the covariance.
        covariance: Of wrap, A, B and the others, shape [n, n].
    """
    told: list[str] = []
    untold: list[str] = []
    row = {name: index for index, name in enumerate(names)}
    variance = covariance.diagonal()

    def say(what: str, error: float, size: str, known: float = _KNOWN, poor: float = _POOR) -> None:
        if not np.isfinite(error):
            untold.append(f"{what} not at all")
        elif error <= known:
            told.append(f"{what} to {size}")
        else:
            untold.append(f"{what} {'only' if error <= poor else 'hardly'} to {size}")

    if freedom.wrap:
        error = float(np.sqrt(variance[0]))
        say(f"l = {at.wrap:.3f}", error, f"{error:.2g}")
    ratio = ratio_errors(at, covariance)
    total = at.lambert + at.wrapped
    sums = np.sqrt(np.maximum(_sum_variance(covariance, total.size), 0.0))
    error = float(np.median(sums / np.maximum(total, 1e-12)))
    say("the brightness facing the light, A + B,", error, f"{error:.2%}")
    if freedom.scattering is None:
        error, worst = float(np.median(ratio)), int(np.argmax(ratio))
        say("Ss", error, f"{error:.2g} of itself")
        if ratio[worst] > _POOR:
            untold.append(f"Ss of {readings.names[worst]} least of all ({ratio[worst]:.2g})")
    for kind, values in (("opacity", at.delta if freedom.delta else None),):
        if values is None:
            continue
        errors = [
            float(np.sqrt(variance[row[f"delta[{name}]"]])) / max(float(value), 1e-12)
            for name, value in zip(readings.names, values, strict=True)
        ]
        error = float(np.median(errors))
        say(kind, error, f"{error:.2g} of itself")
    for name in names:
        if name.startswith("specular:"):
            error = float(np.sqrt(variance[row[name]]))
            say(name.removeprefix("specular:"), error, f"{error:.2g}")
    reach = float(readings.theta_deg.max())
    needed = float(np.degrees(np.arccos(-at.wrap))) + PAST_DARK_DEG
    return Identifiability(reach, needed, tuple(told), tuple(untold))


def _sum_variance(covariance: FloatArray, channels: int) -> FloatArray:
    index = 1 + np.arange(channels)
    other = index + channels
    parts = covariance[index, index] + covariance[other, other] + 2.0 * covariance[index, other]
    return np.asarray(parts)


def ratio_errors(at: Coefficients, covariance: FloatArray) -> FloatArray:
    """Return the relative standard deviation of Ss = B/A [1], shape [c]."""
    channels = at.lambert.size
    index = 1 + np.arange(channels)
    a, b = np.maximum(at.lambert, 1e-12), np.maximum(at.wrapped, 1e-12)
    variance = covariance[index, index] / a**2 + covariance[index + channels, index + channels] / (
        b**2
    )
    variance = variance - 2.0 * covariance[index, index + channels] / (a * b)
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


def note_limits(
    readings: Readings,
    freedom: Freedom,
    wrap: float,
    report: Identifiability,
    wrap_error: float,
    notes: list[Note],
) -> None:
    """Append what limits the trust in l: readings that stop short, few of them, or a bound.

    Args:
        readings: Those that were used.
        freedom: What was free.
        wrap: The best l [1].
        report: What the readings tell.
        wrap_error: Standard deviation of l [1].
        notes: Takes the notes.
    """
    if not freedom.wrap:
        return

    def note(code: str, message: str) -> None:
        notes.append(Note(code, readings.where, message))

    dark = report.needed_deg - PAST_DARK_DEG
    # What l leaves open is no reason to ask for more.
    slack = np.degrees(2.0 * wrap_error) if np.isfinite(wrap_error) else 0.0
    if report.reach_deg < report.needed_deg - min(float(slack), _SLACK_DEG):
        note(
            "readings-stop-short",
            f"the light's angles end at {report.reach_deg:.4g} degrees; with l = {wrap:.2f} the "
            f"skin is lit up to {dark:.4g}, and l is only sure with readings to "
            f"{report.needed_deg:.4g}",
        )
    edge = (readings.theta_deg > 85.0) & (readings.theta_deg < dark + PAST_DARK_DEG)
    if np.count_nonzero(edge) < _LEAST_NEAR_EDGE:
        note(
            "few-readings-at-the-edge",
            f"{np.count_nonzero(edge)} readings lie between 85 and {dark + PAST_DARK_DEG:.4g} "
            "degrees, where l shows; take more there",
        )
    if wrap <= 0.0 or wrap >= 1.0:
        note(
            "wrap-at-bound",
            f"l came out at its bound {wrap:g}: the skin scatters "
            + ("less" if wrap <= 0.0 else "farther")
            + " than the model can say; S and Ss are the best for this l",
        )
    elif not wrap_error <= 0.15:
        note(
            "wrap-uncertain",
            f"l = {wrap:.2f} is known to {wrap_error:.2g} only; take more readings between 85 "
            "and 120 degrees, or state l",
        )
