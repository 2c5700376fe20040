"""What reflectances measured skin has, and the likeliest one behind three numbers.

The shipped table is our fit to the International Skin Spectra Archive (``data/SOURCES.md``). The
estimate is linear in the camera values: a texture of colours becomes a texture of weights, and
twice the values are twice the reflectance. On held-out origins neither estimates in the logarithm,
affine ones, nor mixtures of Gaussians by tone were better by more than 2 %
(``benchmarks/skin_prior.py`` has the figures of this one).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.illuminants import table
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, check_grid, resample

FloatArray = NDArray[np.float64]

COMPONENT_COUNT = 8
"""Components of the shipped prior; they leave 0.03 % of the variance, and six would do."""

LARGEST_UNLIKENESS = 5.0
"""Above this the chromaticity of a reading is not one of skin; see ``SkinMap.unlikeness``."""


@dataclass(frozen=True, eq=False)
class SkinPrior:
    """Mean and covariance of skin's diffuse reflectance.

    The covariance is ``components.T @ components + diag(rest^2)``.
    """

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]."""

    mean: FloatArray
    """Mean reflectance [1], shape [n]."""

    components: FloatArray
    """Principal components, each as long as its standard deviation [1], shape [j, n]."""

    rest: FloatArray
    """Standard deviation that the components leave [1], shape [n]."""

    @cached_property
    def moment(self) -> FloatArray:
        """Second moment of the reflectances, ``mean mean^T + covariance``, shape [n, n]."""
        rows = np.vstack([self.mean, self.components])
        return np.asarray(rows.T @ rows + np.diag(self.rest**2))

    def on(self, wavelength_nm: ArrayLike) -> SkinPrior:
        """Return the prior on another grid; beyond its own it goes on as it ends.

        Args:
            wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
        """
        grid = np.array(wavelength_nm, dtype=np.float64)
        check_grid(grid)
        if np.array_equal(grid, self.wavelength_nm):
            return self

        def brought(values: FloatArray) -> FloatArray:
            return resample(self.wavelength_nm, values, grid, outside="hold")

        return SkinPrior(grid, brought(self.mean), brought(self.components), brought(self.rest))


def shipped_prior(wavelength_nm: ArrayLike = DEFAULT_WAVELENGTHS_NM) -> SkinPrior:
    """Return the prior that is shipped: skin of five origins, each of equal weight.

    Args:
        wavelength_nm: Band centres [nm], strictly ascending, shape [band_count].
    """
    columns = table("skin_prior")
    names = [name for name in columns if name.startswith("c")]
    prior = SkinPrior(
        wavelength_nm=columns["mean"][0],
        mean=columns["mean"][1],
        components=np.array([columns[name][1] for name in names]),
        rest=columns["rest"][1],
    )
    return prior.on(wavelength_nm)


def fit_prior(
    reflectance: ArrayLike,
    wavelength_nm: ArrayLike,
    origin: ArrayLike | None = None,
    component_count: int = COMPONENT_COUNT,
) -> SkinPrior:
    """Return the prior of measured reflectances, by principal components.

    Args:
        reflectance: Diffuse reflectances [1], shape [m, n]; for spectra with the surface's mirror
            image in them see ``specular_included``.
        wavelength_nm: Band centres [nm], shape [n].
        origin: Where each was measured, shape [m]: every origin counts alike, however many skins
            it sent. None: every skin counts alike.
        component_count: How many components to keep.

    Raises:
        ValueError: The shapes disagree, or there are not more reflectances than components.
    """
    values = np.asarray(reflectance, dtype=np.float64)
    grid = np.array(wavelength_nm, dtype=np.float64)
    if values.ndim != 2 or values.shape[1] != grid.size:
        raise ValueError(f"{grid.size} wavelengths but reflectances of shape {values.shape}")
    if not component_count < len(values):
        raise ValueError(f"{len(values)} reflectances do not settle {component_count} components")
    weights = np.ones(len(values))
    if origin is not None:
        _, index, counts = np.unique(origin, return_inverse=True, return_counts=True)
        weights = 1.0 / counts[index.ravel()]
    weights /= weights.sum()
    mean = weights @ values
    _, sizes, rows = np.linalg.svd(np.sqrt(weights)[:, None] * (values - mean), full_matrices=False)
    rows *= np.sign(rows.sum(axis=1, keepdims=True))  # the sign is arbitrary: brighter is positive
    scaled = sizes[:, None] * rows
    rest = np.sqrt((scaled[component_count:] ** 2).sum(axis=0))
    return SkinPrior(grid, mean, scaled[:component_count], rest)


# --- From camera values to reflectance -----------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class SkinMap:
    """The linear map from camera values to skin's reflectance, and how wrong it may be."""

    prior: SkinPrior
    """What skin may be."""

    seen: FloatArray
    """Weights of the camera values, ``values = reflectance @ seen``, shape [n, 3]."""

    noise: FloatArray
    """Standard deviation of a value over the value [1], shape [3]."""

    matrix: FloatArray
    """Such that ``reflectance = matrix @ values``, shape [n, 3]."""

    def __call__(self, values: ArrayLike) -> FloatArray:
        """Return the reflectances of camera values [..., 3], shape [..., n]."""
        return np.asarray(np.asarray(values, dtype=np.float64) @ self.matrix.T)

    def stddev(self, values: ArrayLike) -> FloatArray:
        """Return the standard deviation of the reflectances' errors [1].

        That of the linear estimate, ``(I - M t^T) C (I - M t^T)^T + M N M^T`` (C. D. Rodgers,
        "Inverse Methods for Atmospheric Sounding", 2000). C is the second moment of skin and grows
        with the reading's brightness, which held-out skins of all tones bear out: what three
        numbers cannot tell of dark skin is less. N is the noise of the reading itself.

        Args:
            values: Camera values, shape [..., 3].
        """
        rho = np.asarray(values, dtype=np.float64)
        missed = np.eye(len(self.matrix)) - self.matrix @ self.seen.T
        untold = np.einsum("nm,mk,nk->n", missed, self.prior.moment, missed, optimize=True)
        brightness = np.sqrt(((rho / (self.prior.mean @ self.seen)) ** 2).mean(axis=-1))
        noise = (self.noise * rho) ** 2 @ (self.matrix**2).T
        return np.asarray(np.sqrt(brightness[..., None] * np.maximum(untold, 0.0) + noise))

    def unlikeness(self, values: ArrayLike) -> FloatArray:
        """Return how far readings are from skin's chromaticities, in standard deviations [1].

        The Mahalanobis distance to the prior's camera values from the nearest point on the
        reading's ray: brightness does not count, which the light's scale may have set.

        Args:
            values: Camera values, shape [..., 3].
        """
        rho = np.asarray(values, dtype=np.float64)
        mean = self.prior.mean @ self.seen
        seen = self.prior.components @ self.seen
        spread = seen.T @ seen + self.seen.T @ (self.prior.rest[:, None] ** 2 * self.seen)
        inverse = np.linalg.inv(spread + np.diag((self.noise * mean) ** 2))
        along = np.maximum(rho @ inverse @ mean, 0.0)
        length = np.einsum("...c,cd,...d->...", rho, inverse, rho)
        nearest = along**2 / np.where(length > 0.0, length, np.inf)
        return np.asarray(np.sqrt(np.maximum(mean @ inverse @ mean - nearest, 0.0)))


def skin_map(prior: SkinPrior, seen: ArrayLike, noise: ArrayLike = 0.0) -> SkinMap:
    """Return the likeliest reflectance of skin as a linear map of camera values.

    ``M = C t (t^T C t + N)^-1`` with C the prior's second moment: the Wiener estimate (W. K.
    Pratt and C. E. Mancill, "Spectral estimation techniques for the spectral calibration of a
    color image scanner", Appl. Opt. 15(1), 1976). With zero mean it is linear, and a reading of
    half the brightness is the same skin at half the brightness. N is diagonal: the relative noise
    times the mean square of skin's values. Without noise the values are met exactly.

    Args:
        prior: Mean and covariance of skin.
        seen: t, such that ``values = reflectance @ t``, shape [n, 3].
        noise: Standard deviation of a value over the value [1], shape [] or [3].

    Raises:
        ValueError: The shapes disagree, or the noise is negative.
    """
    t = np.array(seen, dtype=np.float64)
    if t.shape != (prior.mean.size, 3):
        raise ValueError(f"t has shape {t.shape}, but the prior {prior.mean.size} bands")
    relative = np.broadcast_to(np.asarray(noise, dtype=np.float64), (3,)).copy()
    if not (relative >= 0.0).all():
        raise ValueError(f"relative noise {relative.tolist()} is not zero or above")
    told = prior.moment @ t
    square = t.T @ told
    noisy = square + np.diag(relative**2 * square.diagonal())
    matrix = np.asarray(np.linalg.solve(noisy, told.T).T, dtype=np.float64)
    return SkinMap(prior, t, relative, matrix)
