"""What ``proof.json`` holds, one class per kind of row."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

__all__ = [
    "Bar",
    "Cause",
    "Comparison",
    "Parameter",
    "PatchClass",
    "Picture",
    "RecordedFile",
    "Region",
    "Spectra",
    "Spread",
    "Step",
    "Tone",
]


@dataclass(frozen=True, slots=True)
class Spread:
    """A quantity over pixels or samples."""

    mean: float | None = None
    median: float | None = None
    p95: float | None = None
    max: float | None = None
    rms: float | None = None


@dataclass(frozen=True, slots=True)
class Region:
    """A part of a picture."""

    name: str
    pixels: int
    delta_e: Spread


@dataclass(frozen=True, slots=True)
class Comparison:
    """One picture against the truth."""

    name: str
    """``light`` or ``chain``."""

    integrator: str
    truth: str
    picture: str
    maps: str | None
    observer: str
    y_n: float | None
    white: tuple[float, float] | None
    white_from: str
    mask_from: str
    mask_pixels: int | None
    mask_share: float | None
    spreads: Mapping[str, Spread]
    """By name: deltaE2000, deltaE76, deltaL, deltaA, deltaB, flip."""

    spectral: Mapping[str, float]
    """rmse, gfc, p05gfc; empty where no spectra were compared."""

    regions: tuple[Region, ...]
    noise: Spread | None = None
    """What the truth differs by from itself, sampled anew."""

    @property
    def key(self) -> str:
        """Name and integrator in one."""
        return f"{self.name}-{self.integrator}"

    @property
    def delta_e(self) -> Spread:
        """The CIEDE2000 differences."""
        return self.spreads["deltaE2000"]


@dataclass(frozen=True, slots=True)
class Picture:
    """One render."""

    name: str
    integrator: str
    beauty: str
    spectral: str | None


@dataclass(frozen=True, slots=True)
class Spectra:
    """A spectrum measured and estimated."""

    name: str
    kind: str
    true: tuple[float, ...] | None
    estimated: tuple[float, ...] | None
    stddev: tuple[float, ...] | None


@dataclass(frozen=True, slots=True)
class Parameter:
    """A number of the skin model."""

    name: str
    true: float | None
    estimated: float | None
    stddev: float | None


@dataclass(frozen=True, slots=True)
class Tone:
    """The differences of one tone of skin."""

    tone: str
    integrator: str
    delta_e: Spread
    gfc: float | None
    chain: Spread | None = None
    """The same with the skin estimated too."""


@dataclass(frozen=True, slots=True)
class Cause:
    """What one degradation by itself costs."""

    cause: str
    setting: str
    delta_e: Spread


@dataclass(frozen=True, slots=True)
class PatchClass:
    """What the chart's patches say of one class of light, where no truth is known."""

    light_class: str
    left_out: Spread | None
    """Each patch recovered by a calibration that has not seen it."""

    left_out_gfc: float | None
    relit: Spread | None
    """Each patch under the estimated light."""

    relit_gfc: float | None
    lamp_gfc: float | None
    """Shape of the estimated light against the measured one."""

    patches: tuple[tuple[str, float | None, float | None], ...]
    """Name, difference left out, and relit."""


@dataclass(frozen=True, slots=True)
class Bar:
    """A bound and what was found."""

    name: str
    value: float | None
    bar: float
    met: bool


@dataclass(frozen=True, slots=True)
class Step:
    """One step of the proof."""

    name: str
    title: str
    command: str
    seconds: float | None
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    notes: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class RecordedFile:
    """A file of the proof as it was when the proof ended."""

    sha256: str
    bytes: int | None
