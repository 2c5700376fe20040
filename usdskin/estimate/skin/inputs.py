"""From a sample layer to readings over those of a perfect diffuser, and what their columns are."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.estimate.skin.readings import Readings, readings_from_angles
from usdskin.estimate.skin.table import read_goniometer_table
from usdskin.prims import Recovery, SkinSamples, SpectralCamera

FloatArray = NDArray[np.float64]

_CHANNELS = ("R", "G", "B")


@dataclass(frozen=True, slots=True, eq=False)
class Columns:
    """What the columns of readings are: wavelengths, or the channels of a camera in a light."""

    wavelength_nm: FloatArray
    """Band centres [nm], shape [n]: of the columns, or of the camera's calibration."""

    camera: SpectralCamera | None = None
    """The camera, where columns are its channels."""

    illuminant: FloatArray | None = None
    """The light on the camera's grid, in any scale, shape [n]."""


def read_samples(samples: SkinSamples) -> tuple[Readings, Columns]:
    """Return the readings of a layer that has no photographs.

    Args:
        samples: What the layer says.

    Raises:
        LayerError: Directions, readings, their reference or what their columns are is missing or
            does not fit.
    """
    names: tuple[str, ...] | None = None
    if samples.values_file is not None:
        table = read_goniometer_table(samples.values_file)
        names = table.names
        samples = replace(
            samples,
            theta_i=table.theta_i,
            theta_r=table.theta_r,
            azimuth=table.azimuth,
            thickness=samples.thickness if table.thickness is None else table.thickness,
            values=table.values,
            wavelength_nm=table.wavelength_nm
            if samples.wavelength_nm is None
            else samples.wavelength_nm,
        )
    if samples.values is None:
        raise LayerError(
            f"{samples.where}: has no readings; set samples:values with samples:thetaI or "
            "samples:light, samples:values:file, or samples:images with their geometry"
        )
    columns = columns_of(samples, samples.values.shape[1])
    factors = _factors(samples, columns)
    labels = names or _names(samples, samples.values.shape[1])
    return _readings(samples, factors, labels), columns


def columns_of(samples: SkinSamples, count: int) -> Columns:
    """Return what the columns of readings are.

    Args:
        samples: What the layer says.
        count: How many columns there are.

    Raises:
        LayerError: They are neither wavelengths nor the channels of a calibrated camera.
    """
    if samples.wavelength_nm is not None:
        if len(samples.wavelength_nm) != count:
            raise LayerError(
                f"{samples.where}: samples:wavelengths has {len(samples.wavelength_nm)} values but "
                f"each reading {count}; give one per column"
            )
        first, last = samples.wavelength_nm[0], samples.wavelength_nm[-1]
        if last < 400.0 or first > 700.0:
            raise LayerError(
                f"{samples.where}: its wavelengths go from {first:g} to {last:g} nm, where nothing "
                "is seen; measure between 400 and 700 nm"
            )
        return Columns(samples.wavelength_nm)
    if samples.camera is None:
        raise LayerError(
            f"{samples.where}: what its {count} columns are is not known; set samples:wavelengths, "
            "or samples:camera to a Camera that `usdskin calibrate camera` wrote"
        )
    if count != 3:
        raise LayerError(
            f"{samples.where}: readings have {count} columns, but a camera has 3 channels; give R, "
            "G, B"
        )
    recovery = recovery_of(samples, samples.camera)
    return Columns(samples.camera.wavelength_nm, samples.camera, recovery.illuminant)


def recovery_of(samples: SkinSamples, camera: SpectralCamera) -> Recovery:
    """Return the recovery of the light that samples were taken in.

    Raises:
        LayerError: The camera was not calibrated for it, or there are several and none is named.
    """
    known = ", ".join(item.light_class for item in camera.recoveries)
    if samples.light_class:
        for recovery in camera.recoveries:
            if recovery.light_class == samples.light_class:
                return recovery
        raise LayerError(
            f'{samples.where}: samples:lightClass is "{samples.light_class}", but {camera.where} '
            f"was calibrated for {known}; name one of them"
        )
    if len(camera.recoveries) > 1:
        raise LayerError(
            f"{samples.where}: {camera.where} was calibrated for {known}; say in "
            "samples:lightClass which of them lit the skin"
        )
    return camera.recoveries[0]


def _factors(samples: SkinSamples, columns: Columns) -> FloatArray:
    """Return the readings over those of a perfect diffuser that faces the light, shape [q, c]."""
    assert samples.values is not None
    white = samples.white
    if white is not None:
        if len(white) != samples.values.shape[1]:
            raise LayerError(
                f"{samples.where}: samples:white has {len(white)} values but each reading "
                f"{samples.values.shape[1]}; give one per column"
            )
        return np.asarray(samples.values / white)
    if samples.quantity != "reflectanceFactor":
        raise LayerError(
            f'{samples.where}: samples:quantity is "{samples.quantity}" but samples:white has no '
            "value; give the reading of a white diffuser that faces the light, over its reflectance"
        )
    return samples.values


def _names(samples: SkinSamples, count: int) -> tuple[str, ...]:
    if samples.wavelength_nm is not None:
        return tuple(f"{nm:g}" for nm in samples.wavelength_nm)
    return _CHANNELS if count == 3 else tuple(str(index) for index in range(count))


def _readings(samples: SkinSamples, factors: FloatArray, names: tuple[str, ...]) -> Readings:
    assert samples.values is not None
    count = len(factors)
    mask = np.ones(count, bool)
    if samples.mask is not None:
        if len(samples.mask) != count:
            raise LayerError(
                f"{samples.where}: samples:mask has {len(samples.mask)} values for {count} "
                "readings; give one for each"
            )
        mask &= samples.mask
    if samples.saturation > 0.0:
        mask &= (samples.values < samples.saturation).all(axis=1)
    thickness = samples.thickness
    if thickness is not None:
        if len(thickness) not in (1, count):
            raise LayerError(
                f"{samples.where}: samples:thickness has {len(thickness)} values for {count} "
                "readings; give one, or one for each"
            )
        thickness = np.broadcast_to(thickness, (count,))
    if samples.theta_i is not None:
        if len(samples.theta_i) != count:
            raise LayerError(
                f"{samples.where}: samples:thetaI has {len(samples.theta_i)} values for {count} "
                "readings; give one for each"
            )
        return readings_from_angles(
            samples.theta_i,
            samples.theta_r,
            samples.azimuth,
            factors,
            thickness=thickness,
            mask=mask,
            where=samples.where,
            names=names,
        )
    assert samples.light is not None
    normal = samples.normal
    if normal is None:
        raise LayerError(
            f"{samples.where}: has samples:light but no samples:normal; give the normals, or one "
            "for all"
        )
    return Readings(
        light=samples.light,
        normal=normal[0] if len(normal) == 1 else normal,
        values=factors,
        view=samples.view,
        thickness=thickness,
        mask=mask,
        where=samples.where,
        names=names,
    )
