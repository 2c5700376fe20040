"""How well camera values follow the spectra they are said to belong to.

Camera values are integrals P = Lambda t over a responsivity t that is smooth in wavelength. Each
patch is predicted from the others by the smoothest t that fits them; the error of that prediction
is small for a chart that is in order, whatever the camera and the light, and large where names,
order or values do not belong together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_WEIGHTS = np.logspace(-8.0, 2.0, 11)
"""Of the roughness against the residual, tried one after another."""

_DARK_SHARE = 0.03
"""Of the brightest patch: what darker patches are measured against, as noise has a floor."""

_LEAST_FREEDOM = 1e-3


@dataclass(frozen=True, slots=True, eq=False)
class SpectraFit:
    """Predicts the camera values of each patch from those of the others.

    Rows are divided by the brightness of the patch, so that residuals are relative to it.
    """

    scale: FloatArray
    """Brightness of each patch, shape [patch_count]."""

    predictors: FloatArray
    """Matrix of each weight that takes scaled camera values to their leave-one-out residuals, shape
    [weight_count, patch_count, patch_count]."""

    def residuals(self, camera_values: ArrayLike) -> FloatArray:
        """Return the relative leave-one-out residuals of camera values, shape [patch_count, 3].

        Args:
            camera_values: P, in the order of the spectra, shape [patch_count, 3].
        """
        scaled = self._scaled(np.asarray(camera_values, np.float64))
        found = self.predictors @ scaled
        best = np.median(np.square(found).sum(axis=2), axis=1).argmin()
        return np.asarray(found[best])

    def error(self, camera_values: ArrayLike) -> float:
        """Return the typical relative residual of camera values, the median over the patches."""
        return float(np.median(patch_errors(self.residuals(camera_values))))

    def quick_errors(self, camera_values: FloatArray) -> FloatArray:
        """Return typical residuals of many charts, by one weight for all, shape [count].

        Args:
            camera_values: Shape [count, patch_count, 3].
        """
        found = self.predictors[len(_WEIGHTS) // 2] @ self._scaled(camera_values)
        return np.asarray(np.sqrt(np.median(np.square(found).mean(axis=2), axis=1)))

    def _scaled(self, camera_values: FloatArray) -> FloatArray:
        """Return camera values over brightness, 1 in the median patch."""
        rows = camera_values / self.scale[:, None]
        # A mean would let one patch that is far too bright make all errors look small.
        level = np.median(np.abs(rows), axis=-2, keepdims=True)
        return np.asarray(rows / np.where(level > 0.0, level, 1.0))


def patch_errors(residuals: FloatArray) -> FloatArray:
    """Return the root mean square over the channels, shape [patch_count]."""
    return np.asarray(np.sqrt(np.square(residuals).mean(axis=1)))


def fit_spectra(spectra: ArrayLike) -> SpectraFit:
    """Prepare the prediction of camera values from spectra.

    For a weight w, t minimises |P - Lambda t|^2 + w |D t|^2 with D the second difference; the
    residual of a patch that took no part is that of the full fit over 1 - h, h being the patch's
    element of the hat matrix (Allen, "The relationship between variable selection and data
    augmentation and a method for prediction", Technometrics 16, 1974).

    Args:
        spectra: Lambda, the radiance of the patches in any unit, shape [patch_count, band_count].
    """
    spectra = np.asarray(spectra, np.float64)
    brightness = spectra.mean(axis=1)
    scale = brightness + _DARK_SHARE * brightness.max()
    rows = spectra / scale[:, None]
    count = rows.shape[1]
    rows = rows / np.sqrt(np.square(rows).mean() * count)
    difference = np.diff(np.eye(count), 2, axis=0)
    penalty = difference.T @ difference + 1e-6 * np.eye(count)
    # A generalised ridge regression in its dual form: the penalty's inverse is the kernel.
    kernel = rows @ np.linalg.solve(penalty, rows.T)
    values, vectors = np.linalg.eigh(0.5 * (kernel + kernel.T))
    values = np.maximum(values, 0.0)
    weights = _WEIGHTS * values.max()
    shrink = weights[:, None] / (values + weights[:, None])
    left = (vectors * shrink[:, None, :]) @ vectors.T
    freedom = np.maximum(np.diagonal(left, axis1=1, axis2=2), _LEAST_FREEDOM)
    return SpectraFit(scale, left / freedom[:, :, None])
