"""What the estimate of a light says about its own result: for people, programs and the layer."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from usdskin.estimate.light.maps import Form
from usdskin.estimate.light.quality import LightQuality
from usdskin.estimate.light.scale import LightScale
from usdskin.prims import LightEstimate
from usdskin.spectrum import Spectrum


@dataclass(frozen=True, slots=True)
class ClassReport:
    """One class of lamps."""

    name: str
    """Its name."""

    flux_share: float
    """Share of the luminous flux [1]."""

    sphere_share: float
    """Share of the sphere where it is the strongest [1]."""

    estimator: str = ""
    """How its spectra were recovered."""

    grey_delta_e: float | None = None
    """Expected CIEDE2000 of a perfect diffuser in it [1]; with ``wiener``."""

    skin_delta_e: float | None = None
    """Expected CIEDE2000 of skin in it [1]; with ``wiener``."""

    noise: float | None = None
    """Mean standard deviation of its spectrum relative to the mean of its lamp's [1]; with
    ``wiener``."""


@dataclass(frozen=True, slots=True, eq=False)
class LightReport:
    """Everything the step found."""

    origin: str
    """``measured`` or ``assigned``."""

    form: Form
    """``basis`` or ``bands``."""

    width: int
    """Columns of the maps."""

    height: int
    """Rows of the maps."""

    rank: int
    """Number of coefficients that hold the light."""

    is_absolute: bool
    """Whether radiance is in W m^-2 sr^-1 nm^-1."""

    mean: Spectrum
    """Mean radiance over the sphere."""

    quality: LightQuality
    """What its mean is like as a lamp."""

    illuminance: float
    """Of a surface that faces up [lx, or relative]."""

    peak_illuminance: float
    """Of the surface that gets most [lx, or relative]."""

    peak_elevation_deg: float
    """How far above the horizon that surface faces [deg]."""

    peak_column: float
    """Column of the map that it faces [px]."""

    classes: tuple[ClassReport, ...]
    """Classes of lamps."""

    negative_share: float
    """Share of the energy of all bands that is negative [1]."""

    is_sampled: bool
    """Whether that was found from some of the texels."""

    is_cut: bool
    """Whether negative bands were set to 0."""

    outside_rendition: float
    """Share of the sphere whose color the RGB rendition cannot hold [1]."""

    scale: LightScale = field(default_factory=LightScale)
    """Where the scale comes from."""

    clipped_share: float | None = None
    """Share of the luminous flux in saturated pixels [1]; None: the capture does not say."""

    illuminant: str = ""
    """The lamp that was assigned."""

    def estimate(self) -> LightEstimate:
        """Return what the layer says."""
        quality = self.quality
        classes = self.classes if self.origin == "measured" else ()
        return LightEstimate(
            origin=self.origin,
            mean=self.mean,
            illuminant=self.illuminant,
            classes=tuple(item.name for item in classes),
            class_shares=tuple(item.flux_share for item in classes),
            scale=None if self.scale.source == "calibration" else self.scale.factor,
            cct=quality.cct,
            duv=quality.duv,
            cri=quality.cri,
            fidelity=quality.fidelity,
            ssi=quality.ssi,
            ssi_reference=quality.ssi_reference,
            illuminance=max(self.illuminance, 0.0),
            peak_illuminance=max(self.peak_illuminance, 0.0),
            clipped_share=self.clipped_share,
            negative_share=self.negative_share,
            grey_delta_e=self.expected("grey_delta_e"),
            skin_delta_e=self.expected("skin_delta_e"),
        )

    def expected(self, name: str) -> float | None:
        """Return an expected colour difference of all classes together, by their flux."""
        values = [getattr(item, name) for item in self.classes]
        if not values or any(value is None for value in values):
            return None
        shares = [max(item.flux_share, 0.0) for item in self.classes]
        return float(np.dot(values, shares))

    def lines(self) -> list[str]:
        """Return the report as text to be read."""
        unit = "lx" if self.is_absolute else "relative"
        lines = [
            f"light: {self.origin}, {self.form} form of rank {self.rank}, {self.width} x "
            f"{self.height}, {'absolute' if self.is_absolute else 'relative'}",
            f"mean: {_quality(self.quality)}",
            f"illuminance: {self.illuminance:.4g} {unit} facing up; most, "
            f"{self.peak_illuminance:.4g} {unit}, facing {self.peak_elevation_deg:+.0f} deg above "
            f"the horizon at x {self.peak_column:.0f} of the map",
        ]
        if self.origin == "assigned":
            lines.append(f"lamp: {self.illuminant}, assigned; the map does not tell its own")
        else:
            lines.append(f"scale: {_scale(self.scale, self.is_absolute)}")
        if len(self.classes) > 1:
            lines += [
                f"class {item.name}: {item.flux_share:.1%} of the light, strongest in "
                f"{item.sphere_share:.1%} of the sphere"
                for item in self.classes
            ]
        lines += _uncertainty(self.classes)
        if self.clipped_share is not None:
            lines.append(f"clipped: {self.clipped_share:.2%} of the light or more")
        what = "set to 0" if self.is_cut else "kept"
        how = ", from samples" if self.is_sampled else ""
        lines.append(f"negative: {self.negative_share:.3%} of the energy, {what}{how}")
        if self.outside_rendition > 0.0:
            lines.append(
                f"rendition: {self.outside_rendition:.2%} of the sphere has colors outside Rec. "
                "709, shown without their negative part"
            )
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Return all figures as plain values, for JSON."""
        figures = asdict(self) | {
            "units": "absolute" if self.is_absolute else "relative",
            "mean": {
                "wavelength_nm": self.mean.wavelength_nm.tolist(),
                "radiance": self.mean.value.tolist(),
            },
            "grey_delta_e": self.expected("grey_delta_e"),
            "skin_delta_e": self.expected("skin_delta_e"),
        }
        quality: dict[str, Any] = figures.pop("quality")
        return figures | quality


def _quality(quality: LightQuality) -> str:
    if quality.duv is None:
        return "black, or no lamp's color"
    if quality.cct is None:
        return f"too far from white for a color temperature (Duv {quality.duv:+.4f})"
    parts = [f"CCT {quality.cct:.0f} K", f"Duv {quality.duv:+.4f}"]
    if quality.cri is not None:
        parts.append(f"Ra {quality.cri:.0f}")
    if quality.fidelity is not None:
        parts.append(f"Rf {quality.fidelity:.0f}")
    if quality.ssi is not None:
        parts.append(f"SSI {quality.ssi:.0f} against {quality.ssi_reference}")
    return ", ".join(parts)


def _scale(scale: LightScale, is_absolute: bool) -> str:
    if scale.source == "calibration":
        return "the calibration's own" if is_absolute else "relative; no reading gives it"
    if scale.source == "both":
        return f"readings of luminance and illuminance, {scale.factor:.4g} times what was recovered"
    unit = "cd/m^2" if scale.source == "luminance" else "lx"
    return (
        f"{scale.source} reading of {scale.reading:.4g} {unit}, {scale.factor:.4g} times what was "
        "recovered"
    )


def _uncertainty(classes: tuple[ClassReport, ...]) -> list[str]:
    lines = []
    for item in classes:
        parts = []
        if item.grey_delta_e is not None:
            parts.append(f"dE2000 {item.grey_delta_e:.2f} of a grey")
        if item.skin_delta_e is not None:
            parts.append(f"dE2000 {item.skin_delta_e:.2f} of skin")
        if item.noise is not None:
            parts.append(f"{item.noise:.1%} of the spectrum")
        if parts:
            lines.append(f"expected error in {item.name}: {', '.join(parts)}")
    return lines
