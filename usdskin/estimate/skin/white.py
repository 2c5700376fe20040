"""What a perfect diffuser that faces the light would read, for every photograph."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.prims.cameras import SpectralCamera
from usdskin.prims.samples import SampleLight, SkinSamples
from usdskin.spectrum import SpectralQuantity

FloatArray = NDArray[np.float64]


def white_values(samples: SkinSamples, lights: tuple[SampleLight, ...]) -> FloatArray:
    """Return the camera values of a perfect diffuser that faces the light of each photograph.

    ``samples:white`` is its reading in the first light, the others being as much brighter as their
    intensity says. Without it, the reading is t^T E / pi, with E the irradiance spectrum of the
    light in the unit that the camera was calibrated in.

    Args:
        samples: Says the white, or the camera.
        lights: The light of every photograph, n of them.

    Returns:
        Camera values, above 0, shape [n, 3].

    Raises:
        LayerError: The layer tells neither, or the white has no light.
    """
    if samples.white is not None:
        given = np.asarray(samples.white, dtype=np.float64)
        if given.shape != (3,):
            raise LayerError(
                f"{samples.where}: samples:white has {given.size} values, but photographs have 3; "
                "give the camera values of a white target that faces the light"
            )
        for light in lights:
            _check_intensity(light)
        white = np.stack([given * (light.irradiance / lights[0].irradiance) for light in lights])
    elif samples.camera is not None:
        white = np.stack([_computed(samples, samples.camera, light) for light in lights])
    else:
        raise LayerError(
            f"{samples.where}: has neither samples:white nor samples:camera, so camera values are "
            "no reflectance; give the reading of a white target that faces the light"
        )
    if not (np.isfinite(white).all() and (white > 0.0).all()):
        raise LayerError(
            f"{samples.where}: the white reads {white[0].tolist()}, which is not above 0 in every "
            "channel; correct samples:white"
        )
    return white


def _check_intensity(light: SampleLight) -> None:
    if not (np.isfinite(light.irradiance) and light.irradiance > 0.0):
        raise LayerError(
            f"{light.where}: its intensity is {light.irradiance:g}; give one above 0, or leave "
            "the photograph out"
        )


def _computed(samples: SkinSamples, camera: SpectralCamera, light: SampleLight) -> FloatArray:
    _check_intensity(light)
    spectral = light.spectral
    emission = None if spectral is None else spectral.emission
    if (
        spectral is None
        or emission is None
        or spectral.source != "tabulated"
        or emission.quantity is not SpectralQuantity.IRRADIANCE
    ):
        raise LayerError(
            f"{light.where}: does not tell its irradiance as a spectrum, and {samples.where} has "
            "no samples:white; give that, or tabulate SpectralDistributionAPI:emission with the "
            "quantity irradiance"
        )
    if spectral.units != camera.units:
        raise LayerError(
            f"{light.where}: its spectrum is {spectral.units}, but {camera.where} was calibrated "
            f"in {camera.units} units; give samples:white, or a light in the same units"
        )
    irradiance = emission.resample(camera.wavelength_nm) * light.irradiance * spectral.scale
    return np.asarray(irradiance @ camera.responsivity / np.pi)
