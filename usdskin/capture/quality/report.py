"""What the capture step measured about its own result: for people, programs and the layer."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from usdskin.capture.quality.lamps import Lamp, Replacement
from usdskin.capture.quality.report_text import Statement, state
from usdskin.capture.quality.scale import Scale
from usdskin.latlong import texel_solid_angles
from usdskin.meters import flux, sphere_share
from usdskin.prims import View

if TYPE_CHECKING:
    from usdskin.photographs.merge import ExposurePair, MergeReport

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_RESAMPLED = 0.05


@dataclass(frozen=True, slots=True)
class ViewReport:
    """One view: its bracket, its place and its way into the panorama."""

    name: str
    """Name of its prim."""

    image_count: int
    """Photographs of the bracket."""

    exposure_error: float | None = None
    """Largest deviation of a measured ratio of two exposures from the stated one [1]; None where
    no pixel could tell."""

    worst_pair: tuple[str, str] | None = None
    """The two photographs it was found between."""

    gaps: tuple[str, ...] = ()
    """Pairs of consecutive exposures that leave a gap of brightness, as ``"3.tif and 4.tif"``."""

    clipped_share: float = 0.0
    """Share of its pixels that were saturated in every exposure [1]."""

    dark_share: float = 0.0
    """Share of its pixels that no exposure lifted above the noise [1]."""

    moved_share: float = 0.0
    """Share of its pixels where the exposures contradict each other [1]."""

    flux_difference: float | None = None
    """Flux of its texels over that of its pixels, less 1 [1]."""

    found_glare: float | None = None
    """Share of the light spread evenly, found beyond the image circle [1]; None where it was stated
    or nothing was found."""

    rotation_change_deg: float | None = None
    """Angle by which the refinement turned it [deg]; None where it was not asked for."""

    is_constrained: bool = True
    """Whether its overlap with others told where it faces."""


@dataclass(frozen=True, slots=True)
class LampReport:
    """One lamp that was saturated in every exposure."""

    row: int
    """Row of its middle in the panorama."""

    column: int
    """Column of its middle in the panorama."""

    elevation_deg: float
    """Angle above the horizon [deg]."""

    direction: tuple[float, float, float]
    """Where it is, unit vector in the frame of the shoot's prim."""

    diameter_deg: float
    """Diameter of a disc of its solid angle [deg]."""

    solid_angle_sr: float
    """Solid angle of its saturated area [sr]."""

    flux_share: float
    """Least share of the panorama's flux [1]."""

    irradiance_share: float
    """Least share of the irradiance of a surface that faces it [1]."""

    illuminance: float
    """Least illuminance of a surface that faces it [lx, or camera value sr where relative]."""

    reaches_unseen: bool
    """Whether it touches an area that no view saw."""

    factor: float = 1.0
    """Factor by which a reading raised it [1]; 1 where there was none."""

    is_measured: bool = False
    """Whether a reading replaced its clipped values."""

    color_source: str = "clipped"
    """``ring`` where unclipped neighbours gave its color, else ``clipped``."""


@dataclass(frozen=True, slots=True)
class PanoramaFigures:
    """What the panorama's own texels tell."""

    noise: float
    """Median relative standard deviation of the luminance of texels above a tenth of the mean,
    by solid angle [1]."""

    flux_noise: float
    """Relative standard deviation of the flux, texels taken as independent [1]."""

    unseen_flux_share: float
    """Share of the flux in texels that no view saw [1]."""

    moved_share: float
    """Share of the sphere where the exposures of a view contradict each other [1]."""


@dataclass(frozen=True, slots=True)
class CaptureReport:
    """Everything the step measured."""

    name: str
    """Name of the shoot."""

    width: int
    """Columns of the panorama."""

    height: int
    """Rows of the panorama."""

    views: tuple[ViewReport, ...]
    """In the order of the shoot."""

    figures: PanoramaFigures
    """What the panorama's texels tell."""

    coverage: float
    """Share of the sphere that at least one view covers [1]."""

    largest_hole_deg: float
    """Diameter of the largest area that no view saw [deg]."""

    negative_share: float
    """Share of the sphere that came out below zero and was set to 0 [1]."""

    overlap_difference: float | None
    """Median relative difference of overlapping views [1]; None where none overlap."""

    rotation_residual_before_deg: float | None
    """Root mean square angle between overlapping views as they were placed [deg]."""

    rotation_residual_deg: float | None
    """The same as they were used [deg]; None where it was not measured."""

    lamps: tuple[LampReport, ...]
    """Lamps that were saturated in every exposure, the largest flux first."""

    scale: Scale
    """How camera values became luminance."""

    @property
    def image_count(self) -> int:
        """Photographs of all views."""
        return sum(view.image_count for view in self.views)

    @property
    def clipped_share(self) -> float:
        """Least share of the flux in pixels that were saturated in every exposure [1]."""
        return min(sum(lamp.flux_share for lamp in self.lamps), 1.0)

    @property
    def exposure_error(self) -> float | None:
        """Largest deviation of a measured ratio of exposures from the stated one [1]."""
        errors = [view.exposure_error for view in self.views if view.exposure_error is not None]
        return max(errors, default=None)

    @property
    def flux_difference(self) -> float:
        """Largest deviation of a view's flux in the panorama from that of its pixels [1]."""
        return max((abs(view.flux_difference or 0.0) for view in self.views), default=0.0)

    @property
    def contradiction(self) -> float:
        """Difference of overlapping views beyond what noise and resampling explain [1].

        ``sqrt(d^2 - (2 s)^2 - r^2)``: d the overlap difference, s the panorama's noise, r what
        views of one lens differ by where they are resampled. The median of ``|a - b|`` is 0.95 of
        the standard deviation of one view, which is up to ``sqrt(2) s``; the rest is left to pixels
        darker, and so noisier, than those that s is of.
        """
        noise = math.hypot(2.0 * self.figures.noise, _RESAMPLED)
        return math.sqrt(max((self.overlap_difference or 0.0) ** 2 - noise**2, 0.0))

    @property
    def flux_parts(self) -> dict[str, float]:
        """Return the parts of ``flux_error`` by what they come from [1]."""
        return {
            "noise": self.figures.flux_noise,
            "resampling": self.flux_difference,
            "exposure settings": self.exposure_error or 0.0,
            "areas that no view saw": self.figures.unseen_flux_share,
            "clipped lamps": sum(lamp.flux_share for lamp in self.lamps if not lamp.is_measured),
            "views that contradict each other": self.contradiction,
        }

    @property
    def flux_error(self) -> float:
        """Estimated relative error of the panorama's flux, before its scale [1].

        ``sqrt(n^2 + f^2 + x^2 + h^2 + c^2 + d^2)``: n the noise of the sum, f the largest flux
        difference of a view, x the largest error of an exposure ratio, h the share of the flux in
        areas no view saw (what was filled in may be wrong by as much as it is), c the share of
        the flux in clipped lamps that were not measured (one twice as bright as it shows leaves
        that much missing), d what overlapping views contradict each other by (a wrong lens or
        direction counts light twice or not at all). The parts come from different causes, so their
        squares add up.
        """
        return math.hypot(*self.flux_parts.values())

    def statements(self) -> tuple[Statement, ...]:
        """Return what is to be told, one topic after another."""
        return state(self)

    def lines(self) -> list[str]:
        """Return the report as text to be read; what to do stands indented below what is wrong."""
        lines = []
        for statement in self.statements():
            lines.append(f"{statement.topic}: {statement.text}")
            lines += [f"  {advice}" for advice in statement.advice]
        return lines

    def as_dict(self) -> dict[str, Any]:
        """Return all figures and the advice as plain values, for JSON."""
        scale = asdict(self.scale) | {
            "units": self.scale.units,
            "missing_lx": self.scale.missing_lx,
        }
        return asdict(self) | {
            "scale": scale,
            "images": self.image_count,
            "clipped_share": self.clipped_share,
            "exposure_error": self.exposure_error,
            "flux_difference": self.flux_difference,
            "flux_error": self.flux_error,
            "flux_parts": self.flux_parts,
            "advice": [
                {"topic": statement.topic, "text": advice}
                for statement in self.statements()
                for advice in statement.advice
            ],
        }

    def attributes(self) -> dict[str, Any]:
        """Return the result attributes of ``CaptureAPI``, None where there is no opinion."""
        changes = [view.rotation_change_deg for view in self.views]
        known = [change for change in changes if change is not None]
        directions = np.array([lamp.direction for lamp in self.lamps]).reshape(-1, 3)
        return {
            "capture:units": self.scale.units,
            "capture:scale": self.scale.factor,
            "capture:coverage": min(self.coverage, 1.0),
            "capture:clippedShare": self.clipped_share,
            "capture:rotationResidual": self.rotation_residual_deg,
            "capture:rotationChanges": np.array(known) if len(known) == len(changes) else None,
            "capture:fluxError": self.flux_error,
            "capture:noise": self.figures.noise,
            "capture:exposureError": self.exposure_error,
            "capture:movedShare": min(self.figures.moved_share, 1.0),
            "capture:lamps:directions": directions,
            "capture:lamps:solidAngles": np.array([lamp.solid_angle_sr for lamp in self.lamps]),
            "capture:lamps:shares": np.array([lamp.flux_share for lamp in self.lamps]),
            "capture:lamps:factors": np.array([lamp.factor for lamp in self.lamps]),
        }


def report_view(
    view: View,
    merge: MergeReport,
    *,
    flux_difference: float | None = None,
    found_glare: float | None = None,
    rotation_change_deg: float | None = None,
    is_constrained: bool = True,
) -> ViewReport:
    """Return what is to be told about a view.

    Args:
        view: Names it and its photographs.
        merge: What the merge of its bracket measured.
        flux_difference: Flux of its texels over that of its pixels, less 1 [1].
        found_glare: Share of the light spread evenly, found beyond the image circle [1].
        rotation_change_deg: Angle by which the refinement turned it [deg].
        is_constrained: Whether its overlap with others told where it faces.
    """

    def names(pair: ExposurePair) -> tuple[str, str]:
        images = view.bracket.images
        return images[pair.shorter].name, images[pair.longer].name

    errors = [
        (abs(pair.measured / pair.stated - 1.0), pair)
        for pair in merge.pairs
        if pair.measured is not None
    ]
    worst = max(errors, key=lambda found: found[0], default=None)
    return ViewReport(
        name=view.name,
        image_count=len(view.bracket.images),
        exposure_error=None if worst is None else worst[0],
        worst_pair=None if worst is None else names(worst[1]),
        gaps=tuple(" and ".join(names(pair)) for pair in merge.gaps),
        clipped_share=merge.clipped_share,
        dark_share=merge.dark_share,
        moved_share=merge.moved_share,
        flux_difference=flux_difference,
        found_glare=found_glare,
        rotation_change_deg=rotation_change_deg,
        is_constrained=is_constrained,
    )


def report_lamp(
    lamp: Lamp,
    scale: Scale,
    weights: FloatArray,
    prim_from_panorama: FloatArray,
    replacement: Replacement | None = None,
) -> LampReport:
    """Return what is to be told about a lamp.

    Args:
        lamp: As found in camera values.
        scale: Of the panorama.
        weights: Weights of the channels that make a luminance, shape [3].
        prim_from_panorama: Rotation to the frame of the shoot's prim, shape [3, 3].
        replacement: How a reading raised it, if one did.
    """
    row, column = lamp.texel
    x, y, z = (float(value) for value in prim_from_panorama @ lamp.direction)
    return LampReport(
        row=row,
        column=column,
        elevation_deg=math.degrees(math.asin(np.clip(lamp.direction[1], -1.0, 1.0))),
        direction=(x, y, z),
        diameter_deg=lamp.diameter_deg,
        solid_angle_sr=lamp.solid_angle_sr,
        flux_share=lamp.flux_share,
        irradiance_share=lamp.irradiance_share,
        illuminance=scale.factor * float(lamp.irradiance @ weights),
        reaches_unseen=lamp.reaches_unseen,
        factor=1.0 if replacement is None else replacement.factor,
        is_measured=replacement is not None,
        color_source="clipped" if replacement is None else replacement.color_source,
    )


def measure_panorama(
    values: FloatImage,
    stddev: FloatImage,
    seen: FloatImage,
    moved: FloatImage,
    weights: FloatArray,
) -> PanoramaFigures:
    """Return the figures that a panorama's texels give.

    Args:
        values: Camera values, shape [height, width, 3].
        stddev: Their standard deviation, shape [height, width, 3].
        seen: Share of each texel that any view saw, shape [height, width].
        moved: Share of each texel whose exposures contradict each other, shape [height, width].
        weights: Weights of the channels that make a luminance, shape [3].
    """
    luminance = values @ weights.astype(np.float32)
    variance = (stddev * weights.astype(np.float32)) ** 2 @ np.ones(3, np.float32)
    total = float(flux(luminance))
    size = texel_solid_angles(*luminance.shape)
    # A sum over texels of solid angle w has the variance sum w^2 sigma^2.
    error = math.sqrt(float(size**2 @ variance.sum(axis=1, dtype=np.float64)))
    bright = (seen > 0.5) & (luminance > 0.1 * total / (4.0 * np.pi))
    relative = np.sqrt(variance[bright]) / luminance[bright]
    return PanoramaFigures(
        noise=_weighted_median(relative, np.broadcast_to(size[:, None], bright.shape)[bright]),
        flux_noise=error / total if total > 0.0 else 0.0,
        unseen_flux_share=float(flux(luminance * (1.0 - seen))) / total if total > 0.0 else 0.0,
        moved_share=sphere_share(moved),
    )


def _weighted_median(values: NDArray[np.floating[Any]], weights: FloatArray) -> float:
    if not values.size:
        return 0.0
    order = np.argsort(values)
    sums = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(sums, 0.5 * sums[-1])]])
