"""Choose an estimator's solution by leaving patches out, and say how good it is."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import delta_e_2000, xyz_to_lab, xyz_weights
from usdskin.differences import delta_e_of_signals, goodness_of_fit, relative_rmse
from usdskin.estimate.recovery.bayes import Posterior, posterior, smooth, wiener
from usdskin.estimate.recovery.candidate import LAMP_WEIGHT, Candidate, best
from usdskin.estimate.recovery.learned import literal, pca, regression, tsvd
from usdskin.estimate.recovery.responsivity import Responsivity
from usdskin.estimate.recovery.training import Training, channel_scale, check_independent
from usdskin.prims.cameras import Recovery
from usdskin.spectrum import resample

FloatArray = NDArray[np.float64]

ESTIMATORS = ("regression", "literal", "tsvd", "pca", "wiener", "smooth")
"""Names of the estimators, the default first."""

_SKIN_PATCHES = ("dark skin", "light skin")
_SAMPLES = 1024


def recover(
    training: Training,
    responsivity: Responsivity,
    estimator: str = "regression",
    *,
    noise: FloatArray | None = None,
    ridge: float | None = None,
    exponent: float | None = None,
    lamp: float = LAMP_WEIGHT,
) -> Recovery:
    """Return the matrix that turns camera values into spectra, and its quality.

    The estimator's weights are those that predict left-out patches best, in spectrum and color
    (``candidate.best``). Quality is stated for the same left-out patches; the choice among a few
    candidates makes it look better by little.

    Args:
        training: The chart in the light of the class.
        responsivity: t of the camera, from ``estimate_responsivity``.
        estimator: One of ``ESTIMATORS``.
        noise: Relative standard deviation of camera values [1], shape [3]; the responsivity's by
            default.
        ridge: The weight that stabilises the estimator, instead of the chosen one; 0 for none.
            What it is, the estimator's function says; ``literal`` has none.
        exponent: The patch weighting of ``regression`` and ``pca``, 0 (equal absolute errors) to
            1 (equal relative ones), instead of the chosen one.
        lamp: How much the lamp itself counts in ``regression`` and in the prior of ``wiener``, all
            patches together being 1; 0 leaves the plain formulas.

    Returns:
        The recovery, its quality from left-out patches.

    Raises:
        ValueError: Fewer than three patches, camera values that do not tell three colours, a
            responsivity that vanishes, grids that differ, or an unknown estimator.
    """
    spread = responsivity.noise if noise is None else np.asarray(noise, dtype=np.float64)
    condition = _check(training, responsivity, estimator, spread)
    offered: Iterable[Candidate]
    if estimator == "regression":
        offered = regression(training, responsivity, ridge, exponent, lamp)
    elif estimator == "literal":
        offered = literal(training)
    elif estimator == "tsvd":
        offered = tsvd(training, ridge)
    elif estimator == "pca":
        offered = pca(training, responsivity, ridge, exponent)
    elif estimator == "wiener":
        offered = wiener(training, responsivity, spread, ridge, lamp)
    else:
        offered = smooth(training, responsivity, ridge)
    chosen = best(training, offered)
    belief = None
    if estimator == "wiener":
        belief = posterior(training, responsivity, spread, chosen)
    return _described(training, responsivity, estimator, chosen, condition, belief)


def _check(
    training: Training, responsivity: Responsivity, estimator: str, noise: FloatArray
) -> float:
    """Refuse what cannot be solved, and return the condition number of the camera values."""
    if estimator not in ESTIMATORS:
        raise ValueError(f"unknown estimator {estimator!r}; choose one of {', '.join(ESTIMATORS)}")
    if not np.array_equal(training.wavelength_nm, responsivity.wavelength_nm):
        raise ValueError("chart and responsivity must share one wavelength grid")
    if not ((training.illuminant @ responsivity.values) > 0.0).all():
        raise ValueError("the responsivity vanishes in a channel, where the light is")
    condition = check_independent(training.camera_values)
    # Of grey patches alone noise makes the product 3^(1/2), colors make it 0.1 at 1 % noise.
    if condition * float(noise.max()) > 1.5:
        raise ValueError(
            f"the camera values differ so little in color that their noise of {noise.max():.1%} "
            "hides the third; use a chart with more colors, or better photographs"
        )
    return condition


def _described(
    training: Training,
    responsivity: Responsivity,
    estimator: str,
    chosen: Candidate,
    condition: float,
    belief: Posterior | None,
) -> Recovery:
    """Return the recovery with the quality of its left-out patches."""
    light, grid = training.illuminant, training.wavelength_nm
    spectra, signals = chosen.left_out, training.signals
    gfc = goodness_of_fit(spectra, signals)
    rmse = relative_rmse(spectra, signals, light.max())
    delta_e = delta_e_of_signals(spectra, signals, light, grid)
    stddev, grey, skin = None, None, None
    if belief is not None:
        stddev, grey, skin = _uncertainty(training, responsivity.values, belief)
    return Recovery(
        light_class=training.light_class,
        matrix=chosen.matrix,
        estimator=estimator,
        illuminant=light,
        prior_covariance=chosen.prior,
        posterior_stddev=stddev,
        grey_delta_e=grey,
        skin_delta_e=skin,
        condition=condition,
        identity_error=identity_error(chosen.matrix, responsivity.values),
        loo_gfc=float(gfc.mean()),
        loo_rmse=float(rmse.mean()),
        loo_delta_e_2000=float(delta_e.mean()),
        negative_share=negative_share(spectra),
        ridge=chosen.ridge,
        patches=training.patches,
        patch_gfc=gfc,
        patch_rmse=rmse,
        patch_delta_e_2000=delta_e,
    )


def identity_error(matrix: FloatArray, responsivity: FloatArray) -> float:
    """Return the largest entry of ``|G t - I|``, channels made equally large.

    How far the camera values of a recovered spectrum are from those it was recovered from.

    Args:
        matrix: G^T, shape [n, 3].
        responsivity: t, shape [n, 3].
    """
    scale = channel_scale(responsivity)
    product = matrix.T @ responsivity * scale[:, None] / scale[None]
    return float(np.abs(product - np.eye(3)).max())


def negative_share(spectra: FloatArray) -> float:
    """Return the negative energy of spectra as a share of the positive [1]."""
    negative = float(np.maximum(-spectra, 0.0).sum())
    positive = float(np.maximum(spectra, 0.0).sum())
    return negative / positive if positive > 0.0 else float("inf")


def _uncertainty(
    training: Training, responsivity: FloatArray, belief: Posterior
) -> tuple[FloatArray, float, float]:
    """Return the deviation of a recovered diffuser's spectrum, and two mean CIEDE2000.

    The differences are those that the posterior lets expect of a perfect diffuser, and of skin in
    its own brightness: the dark and light skin of the ColorChecker (N. Ohta's measurement,
    through colour-science).
    """
    from colour import SDS_COLOURCHECKERS

    light, grid = training.illuminant, training.wavelength_nm
    chart = SDS_COLOURCHECKERS["ColorChecker N Ohta"]
    skins = [
        resample(chart[name].wavelengths, chart[name].values, grid, outside="hold") * light
        for name in _SKIN_PATCHES
    ]
    size = belief.size_at(light @ responsivity)
    stddev = np.sqrt(size * np.maximum(belief.covariance.diagonal(), 0.0))
    grey, *of_skin = (
        _expected_delta_e(signal, training, responsivity, belief) for signal in (light, *skins)
    )
    return stddev, grey, float(np.mean(of_skin))


def _expected_delta_e(
    signal: FloatArray, training: Training, responsivity: FloatArray, belief: Posterior
) -> float:
    """Return the mean CIEDE2000 of a signal to what the posterior draws around it."""
    weights = xyz_weights(training.wavelength_nm)
    white = training.illuminant @ weights
    seen = signal @ responsivity
    brightness = np.sqrt(((seen / belief.white) ** 2).mean())
    sizes, vectors = np.linalg.eigh(weights.T @ belief.covariance @ weights)
    sizes = np.maximum(sizes, 0.0) * belief.size_at(seen)
    normal = np.random.default_rng(0).standard_normal((_SAMPLES, 3))
    drawn = signal @ weights + brightness * (normal * np.sqrt(sizes)) @ vectors.T
    lab, true_lab = xyz_to_lab(drawn, white), xyz_to_lab(signal @ weights, white)
    return float(delta_e_2000(lab, np.broadcast_to(true_lab, lab.shape)).mean())
