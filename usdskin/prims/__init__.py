"""Schema prims as plain values: one table per schema, every opinion checked on reading.

Errors name the layer, the prim and the attribute, what is wrong with which value, and what to do.
"""

from __future__ import annotations

from usdskin.prims.applied import check_applied_schemas, check_stage_schemas
from usdskin.prims.captures import (
    ExposureBracket,
    FisheyeLens,
    Shoot,
    View,
    read_bracket,
    read_lens,
    read_shoot,
    read_view,
    write_bracket,
    write_lens,
    write_rotation,
)
from usdskin.prims.lights import SpectralLight, read_spectral_light, write_spectral_light
from usdskin.prims.settings import SkinRenderSettings, read_render_settings_api
from usdskin.prims.skin import SkinParameters, read_skin, write_skin
from usdskin.prims.spectra import read_spectrum, write_spectrum

__all__ = [
    "ExposureBracket",
    "FisheyeLens",
    "Shoot",
    "SkinParameters",
    "SkinRenderSettings",
    "SpectralLight",
    "View",
    "check_applied_schemas",
    "check_stage_schemas",
    "read_bracket",
    "read_lens",
    "read_render_settings_api",
    "read_shoot",
    "read_skin",
    "read_spectral_light",
    "read_spectrum",
    "read_view",
    "write_bracket",
    "write_lens",
    "write_rotation",
    "write_skin",
    "write_spectral_light",
    "write_spectrum",
]
