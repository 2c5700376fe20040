"""The lamps of a calibration as its camera sees them: where their light lies in chromaticity.

Chromaticity is (ln R/G, ln B/G): there a change of the lamp shifts all surfaces alike, as far as
a camera's channels are narrow (von Kries), and brightness drops out.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.errors import LayerError
from usdskin.notes import Note
from usdskin.prims import SpectralCamera

FloatArray = NDArray[np.float64]

_DARKEST = 1e-3  # a channel is taken for at least this share of the brightest one
_INSEPARABLE = 0.03  # chromaticity steps; the noise of a patch is about 0.015
_CLOSE = 0.10
_FEWEST_PATCHES = 12
_LEAST_SCATTER = 0.1

# Mean and covariance of the ColorChecker's 24 patches (colour-science, "ColorChecker N Ohta") under
# FL2 and D65 for the Nikon D5100, about the lamp; for calibrations that keep no chart.
_TYPICAL_MEAN = np.array([0.108, -0.120])
_TYPICAL_COVARIANCE = np.array([[0.28, -0.106], [-0.106, 0.348]])


@dataclass(frozen=True, slots=True, eq=False)
class Lamps:
    """The light classes of a calibration, in order."""

    names: tuple[str, ...]
    """Shape [K]."""

    camera_values: FloatArray
    """Camera values of a perfect diffuser of luminance 1 in each light, shape [K, 3]."""

    luminance_weights: FloatArray
    """Weights of R, G and B that come closest to the eye's luminosity function, shape [3]."""

    surface_mean: FloatArray
    """Mean chromaticity of surfaces less that of their light, shape [2]."""

    surface_covariance: FloatArray
    """Scatter of surfaces about that mean, shape [2, 2]."""

    @property
    def chromaticities(self) -> FloatArray:
        """Chromaticity of each light, shape [K, 2]."""
        return chromaticity(self.camera_values)

    def separations(self) -> dict[tuple[str, str], float]:
        """Return the distance of each pair in chromaticity [1], a relative change of ratios."""
        where = dict(zip(self.names, self.chromaticities, strict=True))
        return {
            (one, other): float(np.linalg.norm(where[one] - where[other]))
            for one, other in combinations(self.names, 2)
        }


def chromaticity(values: NDArray[Any]) -> NDArray[Any]:
    """Return (ln R/G, ln B/G).

    Args:
        values: Camera values, of which one channel at least is positive, shape [..., 3].

    Returns:
        Chromaticity, shape [..., 2].
    """
    floor = _DARKEST * values.max(axis=-1, keepdims=True)
    logarithm = np.log(np.maximum(values, floor))
    return np.asarray(logarithm[..., ::2] - logarithm[..., 1:2])


def read_lamps(camera: SpectralCamera) -> Lamps:
    """Return what a calibration says about its lamps.

    Args:
        camera: The calibration; where it holds its charts, they tell how surfaces scatter.

    Raises:
        LayerError: A class has no light.
    """
    names = tuple(recovery.light_class for recovery in camera.recoveries)
    illuminants = np.stack([recovery.illuminant for recovery in camera.recoveries])
    luminosity = xyz_weights(camera.wavelength_nm)[:, 1]
    seen, luminance = illuminants @ camera.responsivity, illuminants @ luminosity
    for name, values, light in zip(names, seen, luminance, strict=True):
        if not (np.isfinite(values).all() and (values > 0.0).all() and light > 0.0):
            raise LayerError(
                f"{camera.where}: recovery:{name}:illuminant gives camera values {values}; all "
                "three must be positive, so calibrate this class again"
            )
    weights = _luminance_weights(camera.responsivity, luminosity)
    mean, covariance = _surfaces(camera, seen)
    return Lamps(names, seen / luminance[:, None], weights, mean, covariance)


def _luminance_weights(responsivity: FloatArray, luminosity: FloatArray) -> FloatArray:
    """Return weights of the channels, none negative, for a sum close to luminance, shape [3].

    A negative weight would be a better fit, and make blue light dark.
    """
    from scipy.optimize import nnls

    weights, _ = nnls(responsivity, luminosity)
    return np.asarray(weights, dtype=np.float64)


def _surfaces(camera: SpectralCamera, seen: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return mean and covariance of the charts' patches about their lamps, by brightness.

    Averages over a panorama weigh surfaces by their light too, so whites count most.
    """
    offsets, brightness = [], []
    lamps = dict(zip((r.light_class for r in camera.recoveries), seen, strict=True))
    for chart in camera.charts:
        if chart.camera_values is not None and chart.light_class in lamps:
            patches = chart.camera_values[(chart.camera_values > 0.0).all(axis=1)]
            lamp = lamps[chart.light_class]
            offsets.append(chromaticity(patches) - chromaticity(lamp))
            brightness.append(patches[:, 1] / lamp[1])
    if sum(map(len, offsets)) < _FEWEST_PATCHES:
        return _TYPICAL_MEAN, _TYPICAL_COVARIANCE
    colors, weights = np.concatenate(offsets), np.concatenate(brightness)
    covariance = np.cov(colors.T, aweights=weights)
    # A chart of greys says nothing about the colors of a room.
    covariance = covariance + _LEAST_SCATTER**2 * np.eye(2)
    return np.average(colors, axis=0, weights=weights), np.asarray(covariance, dtype=np.float64)


def check_separations(camera: SpectralCamera, lamps: Lamps, notes: list[Note]) -> None:
    """Refuse lamps that cannot be told apart by their color.

    Args:
        camera: The calibration.
        lamps: Its lamps.
        notes: Gets ``light-classes-close`` for a pair whose mixtures can hardly be told.

    Raises:
        LayerError: Two lamps look alike to the camera.
    """
    for (one, other), distance in lamps.separations().items():
        alike = (
            f"light classes {one} and {other} differ by only {100.0 * distance:.1f} % in the "
            "camera's R/G and B/G"
        )
        if distance < _INSEPARABLE:
            raise LayerError(
                f"{camera.where}: {alike}, too little to tell them apart; calibrate them as one "
                "class, choose one, or paint a class map"
            )
        if distance < _CLOSE:
            text = f"{alike}; where both shine, their shares are mostly a guess"
            notes.append(Note("light-classes-close", camera.where, text))
