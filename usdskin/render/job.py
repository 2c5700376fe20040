"""What a render was asked for, resolved and checked, and what it reports.

Made by ``usdskin.render.settings`` of a stage and flags.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import Observer
from usdskin.notes import Note
from usdskin.render.overrides import RenderOverrides
from usdskin.render.products import Product

# isort: split
# After ours, which register the schemas.
from pxr import Usd


@dataclass(frozen=True, slots=True, eq=False)
class RenderReport:
    """What a render did."""

    paths: list[Path]
    """Files written, in order."""

    notes: list[Note]
    """What the pictures do not show."""

    seconds: dict[str, float] = field(default_factory=dict)
    """Time each part took [s]."""

    failures: dict[str, str] = field(default_factory=dict)
    """Frames that failed, by number, and why."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One moment of the stage."""

    number: float | None
    """Frame number; None for the one picture of a stage without a time range."""

    @property
    def time(self) -> Usd.TimeCode:
        """Time to read the stage at."""
        return Usd.TimeCode.EarliestTime() if self.number is None else Usd.TimeCode(self.number)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RenderSettings:
    """What all products of a job share, resolved and checked."""

    prim_path: str | None
    """The RenderSettings prim the values come from, if any."""

    integrator: str
    samples_per_pixel: int
    target_error: float
    """Relative standard error at which the sampling of a traced pixel stops [1]; 0 never."""

    bounces: int
    """How often reflected light falls on other surfaces, 0 or 1; traced only."""

    motion_samples: int
    """Moments that a picture with motion blur is the mean of; 0 chooses."""

    pixel_filter: str
    seed: int
    wavelength_nm: NDArray[np.float64]
    """Band centres [nm], shape [band_count]."""

    observer: Observer
    subdivision_level: int
    spectral_method: Literal["factorised", "brute"]
    color_space: str
    """Rendering color space: USD's name of a linear RGB space."""

    purposes: frozenset[str]
    material_purposes: tuple[str, ...]
    """Material binding purposes, the preferred first; ``""`` is allPurpose."""

    dome: str
    """``auto``, ``show`` or ``hide``."""

    mask: tuple[str, ...] | None
    """Paths of the prims whose geometry is rendered, with all below them; None for everything."""

    illuminant: str | None
    bad_pixels: Literal["error", "clamp"]
    ev: float | Literal["auto"]
    white: str
    view: str | None
    compression: str
    skip_existing: bool
    threads: int | None
    device: str


@dataclass(frozen=True, slots=True, eq=False)
class RenderJob:
    """Everything to render, and how."""

    overrides: RenderOverrides
    settings: RenderSettings
    products: tuple[Product, ...]
    frames: tuple[Frame, ...]

    def digest(self, product: Product) -> str:
        """Return a hash of what has a bearing on a product's pixels, as hexadecimal digits.

        The stage itself is not in it, only what was asked of it.
        """
        asked = {entry.name: getattr(self.settings, entry.name) for entry in fields(RenderSettings)}
        for name in _WITHOUT_BEARING_ON_PIXELS:
            del asked[name]
        asked |= {name: getattr(self.overrides, name) for name in ("attributes", "variants")}
        asked |= {name: getattr(product, name) for name in _VIEW_FIELDS}
        seen = hashlib.sha256()
        for name, value in asked.items():
            plain = value.tolist() if isinstance(value, np.ndarray) else value
            plain = sorted(plain) if isinstance(plain, frozenset) else plain
            seen.update(f"{name}={plain!r}\n".encode())
        return seen.hexdigest()


_VIEW_FIELDS = (
    "camera",
    "resolution",
    "pixel_aspect_ratio",
    "conform_policy",
    "motion_blur",
    "depth_of_field",
)
_WITHOUT_BEARING_ON_PIXELS = (
    "prim_path",
    "ev",
    "white",
    "view",
    "compression",
    "skip_existing",
    "threads",
    "device",
)
