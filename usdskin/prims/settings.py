"""``SkinRenderSettingsAPI`` -> ``SkinRenderSettings``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.values import DEFAULT_TIME, read_schema

_FIELDS = {
    "integrator": "usdskin:integrator",
    "samples_per_pixel": "usdskin:samplesPerPixel",
    "target_error": "usdskin:targetError",
    "seed": "usdskin:seed",
    "wavelength_nm": "usdskin:wavelengths",
    "bounces": "usdskin:bounces",
    "motion_samples": "usdskin:motionSamples",
    "observer": "usdskin:observer",
    "subdivision_level": "usdskin:subdivisionLevel",
    "spectral_output": "usdskin:spectralOutput",
    "pixel_filter": "usdskin:pixelFilter",
    "dome": "usdskin:dome",
}


@dataclass(frozen=True, slots=True, eq=False)
class SkinRenderSettings:
    """What a RenderSettings prim says with ``SkinRenderSettingsAPI``."""

    integrator: str
    """``map`` or ``traced``."""

    samples_per_pixel: int
    """Samples per pixel [1]."""

    target_error: float
    """Relative standard error at which sampling stops [1]; 0 is off."""

    bounces: int
    """How often reflected light falls on other surfaces, 0 or 1."""

    motion_samples: int
    """Moments of a picture with motion blur [1]; 0 chooses."""

    seed: int
    """Seed of the random numbers."""

    wavelength_nm: NDArray[np.float64]
    """Centres of the bands [nm], shape [band_count]."""

    observer: str
    """``cie1931_2``, ``cie1964_10`` or ``cie2015_2``."""

    subdivision_level: int
    """How many times subdivision surfaces are refined."""

    spectral_output: bool
    """Whether a spectral EXR is written beside every picture."""

    pixel_filter: str
    """``box``, ``triangle``, ``gaussian`` or ``blackmanHarris``."""

    dome: str
    """``auto``, ``show`` or ``hide``."""

    authored: frozenset[str]
    """Fields that have an opinion, the others being the schema's fallbacks."""


def read_render_settings_api(
    prim: Usd.Prim, time: Usd.TimeCode | float = DEFAULT_TIME
) -> SkinRenderSettings | None:
    """Return what a RenderSettings prim says with ``SkinRenderSettingsAPI``, or None without it.

    Raises:
        LayerError: An opinion cannot be used, or one of ours is misspelt.
    """
    check_applied_schemas(prim)
    if not prim.HasAPI("SkinRenderSettingsAPI"):
        return None
    values = read_schema(prim, "SkinRenderSettingsAPI", time)
    authored = frozenset(
        field for field, name in _FIELDS.items() if prim.GetAttribute(name).HasAuthoredValue()
    )
    fields = {field: values[name] for field, name in _FIELDS.items()}
    return SkinRenderSettings(authored=authored, **fields)
