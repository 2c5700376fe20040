"""Schema prims as plain values: one table per schema, every opinion checked on reading.

Errors name the layer, the prim and the attribute, what is wrong with which value, and what to do.
"""

from __future__ import annotations

from usdskin.prims.applied import check_applied_schemas, check_stage_schemas
from usdskin.prims.brackets import ExposureBracket, read_bracket, write_bracket
from usdskin.prims.cameras import (
    Recovery,
    SpectralCamera,
    read_spectral_camera,
    write_spectral_camera,
)
from usdskin.prims.captures import Shoot, read_shoot
from usdskin.prims.charts import (
    ColorChart,
    read_color_chart,
    read_color_charts,
    write_color_chart,
)
from usdskin.prims.estimates import LightEstimate, read_light_estimate, write_light_estimate
from usdskin.prims.fits import SkinFitRecord, read_skin_fit, write_skin_fit
from usdskin.prims.lenses import FisheyeLens, read_lens, write_lens
from usdskin.prims.lights import SpectralLight, read_spectral_light, write_spectral_light
from usdskin.prims.panoramas import CapturedPanorama, read_captured_panorama
from usdskin.prims.samples import (
    SampleLight,
    SkinSamples,
    read_skin_samples,
    write_skin_samples,
)
from usdskin.prims.settings import SkinRenderSettings, read_render_settings_api
from usdskin.prims.skin import SkinParameters, read_skin, write_skin
from usdskin.prims.spectra import read_spectrum, write_spectrum
from usdskin.prims.transfers import SkinTransfer, read_transfer, write_transfer
from usdskin.prims.views import Shot, View, read_shot, read_view, write_rotation

__all__ = [
    "CapturedPanorama",
    "ColorChart",
    "ExposureBracket",
    "FisheyeLens",
    "LightEstimate",
    "Recovery",
    "SampleLight",
    "Shoot",
    "Shot",
    "SkinFitRecord",
    "SkinParameters",
    "SkinRenderSettings",
    "SkinSamples",
    "SkinTransfer",
    "SpectralCamera",
    "SpectralLight",
    "View",
    "check_applied_schemas",
    "check_stage_schemas",
    "read_bracket",
    "read_captured_panorama",
    "read_color_chart",
    "read_color_charts",
    "read_lens",
    "read_light_estimate",
    "read_render_settings_api",
    "read_shoot",
    "read_shot",
    "read_skin",
    "read_skin_fit",
    "read_skin_samples",
    "read_spectral_camera",
    "read_spectral_light",
    "read_spectrum",
    "read_transfer",
    "read_view",
    "write_bracket",
    "write_color_chart",
    "write_lens",
    "write_light_estimate",
    "write_rotation",
    "write_skin",
    "write_skin_fit",
    "write_skin_samples",
    "write_spectral_camera",
    "write_spectral_light",
    "write_spectrum",
    "write_transfer",
]
