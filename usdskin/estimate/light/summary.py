"""From the sums over a light map to the report on it."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.estimate.light.light_map import LightMap
from usdskin.estimate.light.maps import Form, WrittenMaps
from usdskin.estimate.light.quality import light_quality
from usdskin.estimate.light.report import ClassReport, LightReport
from usdskin.estimate.light.scale import LightScale
from usdskin.estimate.light.totals import Totals
from usdskin.prims import Recovery
from usdskin.spectrum import SpectralQuantity, Spectrum

FloatArray = NDArray[np.float64]


def report_light(
    light: LightMap,
    totals: Totals,
    written: WrittenMaps,
    form: Form,
    *,
    origin: str,
    recoveries: tuple[Recovery, ...] = (),
    scale: LightScale | None = None,
    clipped_share: float | None = None,
    illuminant: str = "",
) -> LightReport:
    """Return the report on a light.

    Args:
        light: The light as it was written.
        totals: Its sums, in coefficients.
        written: What was found while it was written.
        form: ``basis`` or ``bands``.
        origin: ``measured`` or ``assigned``.
        recoveries: How each class was recovered.
        scale: Where the scale comes from; its factor is in ``light`` but not in ``totals``.
        clipped_share: Share of the luminous flux in saturated pixels [1].
        illuminant: The lamp that was assigned.
    """
    scale = scale or LightScale()
    luminous = light.xyz[:, 1]
    mean = totals.mean @ light.basis
    quantity = SpectralQuantity.RELATIVE
    if light.is_absolute:
        # The schema holds a radiance to be none below zero; what dips there is noise.
        quantity, mean = SpectralQuantity.RADIANCE, np.maximum(mean, 0.0)
    x, y, z = totals.peak_direction
    turns = (math.atan2(x, -z) / (2.0 * math.pi)) % 1.0
    is_cut = written.clipped_energy is not None
    negative = totals.negative_share if written.clipped_energy is None else written.clipped_energy
    return LightReport(
        origin=origin,
        form=form,
        width=light.width,
        height=light.height,
        rank=light.rank,
        is_absolute=light.is_absolute,
        mean=Spectrum(quantity, light.wavelength_nm, mean),
        quality=light_quality(mean, light.wavelength_nm),
        illuminance=float(totals.up @ luminous),
        peak_illuminance=totals.peak_luminous * scale.factor,
        peak_elevation_deg=math.degrees(math.asin(min(max(y, -1.0), 1.0))),
        peak_column=turns * light.width,
        classes=_classes(light, totals, recoveries),
        negative_share=min(max(negative, 0.0), 1.0),
        is_sampled=totals.is_sampled and not is_cut,
        is_cut=is_cut,
        outside_rendition=written.outside_rendition,
        scale=scale,
        clipped_share=clipped_share,
        illuminant=illuminant,
    )


def _classes(
    light: LightMap, totals: Totals, recoveries: tuple[Recovery, ...]
) -> tuple[ClassReport, ...]:
    by_class = (totals.mean * light.xyz[:, 1]).reshape(-1, 3).sum(axis=1)
    total = float(by_class.sum())
    shares = by_class / total if total > 0.0 else np.zeros(len(by_class))
    found = []
    for index, name in enumerate(light.classes):
        of = recoveries[index] if recoveries else None
        found.append(
            ClassReport(
                name=name,
                flux_share=float(shares[index]),
                sphere_share=float(totals.sphere_shares[index]),
                estimator="" if of is None else of.estimator,
                grey_delta_e=None if of is None else of.grey_delta_e,
                skin_delta_e=None if of is None else of.skin_delta_e,
                noise=None if of is None else _relative_noise(of, light.wavelength_nm),
            )
        )
    return tuple(found)


def _relative_noise(recovery: Recovery, wavelength_nm: FloatArray) -> float | None:
    """Return the luminous mean of the posterior deviation over that of the lamp."""
    if recovery.posterior_stddev is None:
        return None
    weights = xyz_weights(wavelength_nm)[:, 1]
    return float(recovery.posterior_stddev @ weights / (recovery.illuminant @ weights))
