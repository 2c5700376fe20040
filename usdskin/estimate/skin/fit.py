"""Fit equation (1) to readings: l, and A and B of every channel; lustre and delta if asked."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.errors import LayerError
from usdskin.estimate.skin.checks import (
    refuse_exchanged,
    refuse_misfit,
    refuse_percent,
    refuse_short,
    refuse_thickness,
    usable,
)
from usdskin.estimate.skin.covariance import (
    Noise,
    covariance_of_free,
    full_covariance,
    full_names,
)
from usdskin.estimate.skin.gloss import SeenGloss, fit_gloss, seen_gloss, thinned
from usdskin.estimate.skin.identifiability import Identifiability, identifiability, note_limits
from usdskin.estimate.skin.lobe import F0, Lobe
from usdskin.estimate.skin.model import Coefficients, Freedom, SkinModel
from usdskin.estimate.skin.posterior import middle_of_likelihood
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.residuals import Structure, structure_of
from usdskin.estimate.skin.robust import RobustFit, fit_robustly
from usdskin.estimate.skin.solve import SCAN, Solution, descend, scan, solve
from usdskin.notes import Note

FloatArray = NDArray[np.float64]
Mask = NDArray[np.bool_]

_MANY_OUTLIERS = 0.25


@dataclass(frozen=True, slots=True, eq=False)
class FitOptions:
    """What to find, and what is known."""

    specular: Literal["none", "fit", "ignore"] = "none"
    """``none``: readings with lustre are refused; ``fit``: it is found too; ``ignore``: the
    readings are known to have none (crossed polarisers), and what looks like it is only noted."""

    wrap: float | None = None
    """l where it is known [1]; None: it is found."""

    scattering: ArrayLike | None = None
    """Ss where it is known [1], shape [] or [c]; None: it is found."""

    delta: Literal["none", "fit"] = "none"
    """Whether delta is found, which needs thicknesses."""

    robust: bool = True
    """Whether outliers are left out."""

    noise: Noise = field(default_factory=Noise)
    """Standard deviations where readings have none; its size is estimated, its shape is not."""

    f0: float = F0
    """Reflectance of the surface at normal incidence [1], for the lustre."""

    is_relative: bool = False
    """Whether the readings' common scale is unknown, so that A and B of any size will do."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinFit:
    """What was found, how sure it is, and what is left."""

    wrap: float
    """l [1]."""

    lambert: FloatArray
    """A = alpha S [1], shape [c]."""

    wrapped: FloatArray
    """B = alpha S Ss [1], shape [c]."""

    lobe: Lobe | None
    """The lustre, rougher lobe first; None: not fitted."""

    delta: FloatArray | None
    """Opacity [m^-1], shape [c]; None: not fitted."""

    names: tuple[str, ...]
    """``wrap``, ``A[..]``, ``B[..]``, then ``delta[..]`` and ``specular:..`` where they were
    fitted: rows of the covariance, shape [n]."""

    covariance: FloatArray
    """Of those numbers; infinite variances where readings say nothing, shape [n, n]."""

    predicted: FloatArray
    """The fitted model at every reading [1], shape [q, c]."""

    residuals: FloatArray
    """Readings minus model [1], shape [q, c]."""

    sigma: FloatArray
    """Standard deviation of every reading, as estimated [1], shape [q, c]."""

    used: Mask
    """Which readings the fit is from: not masked, saturated or outliers, shape [q]."""

    noise: float
    """What sigma is over the stated or assumed standard deviation [1]."""

    residual_rms: float
    """Of the readings used, as a share of their channel's peak [1]."""

    chi2: float
    """Sum of squared residuals over stated or assumed variances [1]."""

    freedom: int
    """Number of values used less that of numbers found."""

    structure: Structure
    """How the residuals run over the angle."""

    identifiability: Identifiability
    """What the readings can and cannot tell."""

    seen_gloss: SeenGloss | None
    """What a lobe would explain; None: it was fitted, or no reading could show it."""

    @property
    def stddev(self) -> FloatArray:
        """Standard deviations of the numbers, shape [n]."""
        return np.asarray(np.sqrt(self.covariance.diagonal()))


def fit_skin(
    readings: Readings, options: FitOptions | None = None, notes: list[Note] | None = None
) -> SkinFit:
    """Fit eq. (1) to readings, all channels jointly with one l.

    Args:
        readings: What was measured.
        options: What to find; the defaults find l, A and B.
        notes: Takes what limits the trust in the result.

    Returns:
        The fit; ``split`` separates its A and B into alpha, S and Ss.

    Raises:
        LayerError: The readings cannot be what they are said to be (radians, percents, light and
            view exchanged), are too few, cannot tell what is asked, contain a lustre or a thickness
            that was not asked for, or are not what eq. (1) describes.
            The message begins with ``readings.where``.
        ValueError: The options do not fit the readings.
    """
    options, notes = options or FitOptions(), [] if notes is None else notes
    freedom, fixed = _plan(readings, options, notes)
    used = usable(readings, notes)
    kept = readings.part(used)
    if not options.is_relative:
        refuse_percent(kept)
    refuse_thickness(kept, freedom)
    refuse_exchanged(kept, fixed, options.noise)
    refuse_short(kept, freedom)
    gloss = None
    if options.specular == "fit":
        model, found = fit_gloss(kept, freedom, fixed, options.noise, options.robust, options.f0)
    else:
        gloss = _judge_gloss(kept, freedom, fixed, options, notes)
        model, found = _fit_diffuse(kept, freedom, fixed, options)
    _note_outliers(readings, used, found, notes)
    used[np.flatnonzero(used)[~found.keep]] = False
    refuse_short(readings.part(used), freedom)
    return _described(readings, used, model, found, gloss, options.noise, notes)


def _plan(
    readings: Readings, options: FitOptions, notes: list[Note]
) -> tuple[Freedom, Coefficients]:
    channels = readings.values.shape[1]
    wrap, scattering = options.wrap, options.scattering
    if wrap is not None and not 0.0 <= wrap <= 1.0:
        raise ValueError(f"l = {wrap:g} is not within 0..1")
    known = None
    if scattering is not None:
        known = np.broadcast_to(np.asarray(scattering, dtype=np.float64), (channels,))
        if not (np.isfinite(known).all() and (known >= 0.0).all()):
            raise ValueError("the known scattering is negative, or not finite")
    elif wrap == 0.0:
        known = np.zeros(channels)
        text = "with l = 0 both terms are the same, so all of the brightness is given to A: Ss = 0"
        notes.append(Note("scattering-not-told", readings.where, text))
    if options.specular == "fit" and readings.view is None:
        raise LayerError(
            f"{readings.where}: a specular reflection cannot be fitted without view directions; "
            "give the camera's angles or vectors"
        )
    freedom = Freedom(wrap is None, known, options.delta == "fit")
    zeros = np.zeros(channels)
    delta = zeros if freedom.delta else None
    return freedom, Coefficients(0.3 if wrap is None else wrap, zeros, zeros, None, delta)


def _fit_diffuse(
    readings: Readings, freedom: Freedom, fixed: Coefficients, options: FitOptions
) -> tuple[SkinModel, RobustFit]:
    model = SkinModel(readings, freedom)

    def run(weights: FloatArray, before: Solution | None) -> Solution:
        if before is None:
            return solve(readings, freedom, fixed, weights)
        start = before.coefficients
        if freedom.wrap and not freedom.delta:
            tried = scan(readings, fixed, freedom, weights, SCAN)
            left = readings.values - model.values(start)
            if tried.cost < float((weights * left**2).sum()):
                start = tried.coefficients
        return descend(model, start, readings.values, weights)

    return model, fit_robustly(readings, model, run, options.noise, options.robust)


def _judge_gloss(
    readings: Readings,
    freedom: Freedom,
    fixed: Coefficients,
    options: FitOptions,
    notes: list[Note],
) -> SeenGloss | None:
    """Refuse a lustre that was not asked for, or note it."""
    some = readings.part(thinned(readings))
    gloss = seen_gloss(some, freedom, fixed, options.noise, options.f0)
    if gloss is None:
        if readings.view is None and options.specular == "none":
            text = "without view directions it cannot be checked that the readings are free of "
            text += "specular reflection; give them, or measure with crossed polarisers"
            notes.append(Note("gloss-not-checked", readings.where, text))
        return None
    what = (
        f"the readings rise by up to {gloss.share:.0%} of the diffuse peak towards the mirror "
        f"direction, {gloss.mirror_deg:.3g} degrees away"
    )
    if gloss.is_there and options.specular == "none":
        raise LayerError(
            f"{readings.where}: {what}, as a specular reflection does, and wrap would come out "
            "wrong; fit the specular reflection too, mask readings near the mirror direction, or "
            "measure with crossed polarisers"
        )
    if gloss.is_there or gloss.is_suspected:
        text = f"{what}; with a specular lobe l would be {gloss.wrap:.3f}"
        notes.append(Note("gloss-suspected", readings.where, text))
    return gloss


def _note_outliers(readings: Readings, used: Mask, found: RobustFit, notes: list[Note]) -> None:
    left_out = np.flatnonzero(used)[~found.keep]
    if not left_out.size:
        return
    offered = int(np.count_nonzero(used))
    listed = ", ".join(f"[{index}]" for index in left_out[:8]) + ", ..." * (left_out.size > 8)
    text = f"{left_out.size} of {offered} readings are left out as outliers: {listed}"
    if left_out.size > _MANY_OUTLIERS * offered:
        text += "; so many mean that the model does not hold: see the residuals"
    notes.append(Note("readings-outlying", readings.where, text))


def _described(
    readings: Readings,
    used: Mask,
    model: SkinModel,
    found: RobustFit,
    gloss: SeenGloss | None,
    noise: Noise,
    notes: list[Note],
) -> SkinFit:
    scale = found.scale if readings.stddev is None else max(found.scale, 1.0)
    kept = readings.part(used)
    at, covariance = _with_errors(kept, model, found, scale)
    names = full_names(model)
    predicted = SkinModel(readings, model.freedom).values(at)
    stated = noise.sigma(np.nan_to_num(predicted)) if readings.stddev is None else readings.stddev
    sigma = scale * stated
    residuals = readings.values - predicted
    peak = np.maximum(predicted[used].max(axis=0), 1e-12)
    rms = float(np.sqrt(((residuals[used] / peak) ** 2).mean()))
    refuse_misfit(readings, rms, found.scale, notes)
    shape = structure_of(residuals[used], sigma[used], kept.theta_deg, peak)
    report = identifiability(kept, model.freedom, at, names, covariance)
    best_wrap = found.solution.coefficients.wrap
    error = float(np.sqrt(covariance[0, 0]))
    note_limits(kept, model.freedom, best_wrap, report, error, notes)
    _note_or_refuse(readings, at, shape, notes)
    return SkinFit(
        wrap=at.wrap,
        lambert=at.lambert,
        wrapped=at.wrapped,
        lobe=at.lobe,
        delta=at.delta if model.freedom.delta else None,
        names=names,
        covariance=covariance,
        predicted=predicted,
        residuals=residuals,
        sigma=sigma,
        used=used,
        noise=found.scale,
        residual_rms=rms,
        chi2=found.chi2,
        freedom=found.freedom,
        structure=shape,
        identifiability=report,
        seen_gloss=gloss,
    )


def _with_errors(
    kept: Readings, model: SkinModel, found: RobustFit, scale: float
) -> tuple[Coefficients, FloatArray]:
    """Return the numbers and their covariance; without lobes and delta from all l."""
    at, freedom = found.solution.coefficients, model.freedom
    weights = 1.0 / np.maximum(scale * found.sigma[found.keep], 1e-12) ** 2
    if freedom.wrap and not freedom.lobes and not freedom.delta:
        middle = middle_of_likelihood(kept, at, freedom, weights)
        if middle is not None:
            return middle
    here = SkinModel(kept, freedom)
    return at, full_covariance(here, covariance_of_free(here, at, weights))


def _note_or_refuse(
    readings: Readings, at: Coefficients, shape: Structure, notes: list[Note]
) -> None:
    if shape.is_there:
        text = f"the residuals are no noise: around {shape.at_deg:.3g} degrees the readings lie "
        text += f"{abs(shape.largest_share):.1%} of the peak "
        text += "above" if shape.largest_share > 0.0 else "below"
        text += " the model; the stated errors do not cover that"
        notes.append(Note("residual-structure", readings.where, text))
    if at.lobe is not None and at.lobe.weight >= 1.0:
        text = "the specular weight came out at its bound 1: are the readings over E/pi?"
        notes.append(Note("specular-at-bound", readings.where, text))
    black = at.lambert + at.wrapped <= 0.0
    if black.any():
        name = readings.names[int(np.flatnonzero(black)[0])]
        raise LayerError(
            f"{readings.where}: channel {name} has no light in any reading; leave it out, or "
            "correct its black level"
        )
