"""How much of the light each class has: for people and for programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.estimate.classes.lamps import read_lamps
from usdskin.estimate.classes.sphere import row_blocks
from usdskin.latlong import texel_solid_angles
from usdskin.prims import SpectralCamera

FloatImage = NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class ClassReport:
    """The light classes of one panorama."""

    names: tuple[str, ...]
    """Shape [K]."""

    flux_shares: tuple[float, ...]
    """Share of each in the luminous flux from all around [1], shape [K]."""

    sphere_shares: tuple[float, ...]
    """Share of each in the sphere [1], shape [K]."""

    separations: Mapping[tuple[str, str], float]
    """Distance of each pair in the camera's (ln R/G, ln B/G) [1]."""

    def lines(self) -> list[str]:
        """Return one line for each class and one for the closest pair."""
        shares = zip(self.names, self.flux_shares, self.sphere_shares, strict=True)
        lines = [
            f"{name}: {100.0 * flux:.1f} % of the light, {100.0 * sphere:.1f} % of the sphere"
            for name, flux, sphere in shares
        ]
        if self.separations:
            (one, other), least = min(self.separations.items(), key=lambda item: item[1])
            lines.append(f"{one} and {other} differ by {100.0 * least:.0f} % in R/G and B/G")
        return lines


def report_classes(weights: FloatImage, values: FloatImage, camera: SpectralCamera) -> ClassReport:
    """Return how much of a panorama's light each class has.

    Args:
        weights: Share of each class in every texel, shape [height, width, K].
        values: Camera values in any scale, shape [height, width, 3].
        camera: The calibration.
    """
    luminosity = xyz_weights(camera.wavelength_nm)[:, 1]
    # Row k: what the spectra that class k recovers give the eye, per camera value.
    eye = np.stack([luminosity @ recovery.matrix for recovery in camera.recoveries])
    height, width, count = weights.shape
    flux, sphere = np.zeros(count), np.zeros(count)
    sizes = texel_solid_angles(height, width)
    for rows in row_blocks(height):
        part = weights[rows].astype(np.float64)
        light = np.maximum(np.nan_to_num(values[rows] @ eye.T, posinf=0.0), 0.0)
        flux += np.einsum("i,ijk->k", sizes[rows], light * part)
        sphere += np.einsum("i,ijk->k", sizes[rows], part)
    total = flux.sum()
    shares = flux / total if total > 0.0 else sphere / sphere.sum()
    names = tuple(recovery.light_class for recovery in camera.recoveries)
    return ClassReport(
        names,
        tuple(shares.tolist()),
        tuple((sphere / (4.0 * np.pi)).tolist()),
        read_lamps(camera).separations() if count > 1 else {},
    )
