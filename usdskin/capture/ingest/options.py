"""What the ingest step is told beside the photographs."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from usdskin.capture.viewpoints import Direction


@dataclass(frozen=True, slots=True)
class IngestOptions:
    """What the step is told; photographs and ``exposures.csv`` tell the rest."""

    lens: Path | None = None
    """Layer with a calibrated lens; None: guessed from the image circle."""

    projection: str = "equidistant"
    """Projection of a guessed lens."""

    field_deg: float = 180.0
    """Field of a guessed lens, from rim to rim of the image circle [deg]."""

    views: str | None = None
    """Directions of the views; see ``viewpoints.parse_directions``."""

    only: str | None = None
    """Pattern of the file names to take, such as ``*.tif``."""

    iso: float | None = None
    """Sensitivity setting of photographs that do not tell it [1]."""

    f_number: float | None = None
    """F-number of photographs that do not tell it [1]."""

    nd_factor: float = 1.0
    """Attenuation of the filter in front of all photographs the table does not name [1]."""

    black_level: float | None = None
    """Raw value without light [DN]; None: 0, or what raw files say."""

    white_level: float | None = None
    """Raw value at saturation [DN]; None: what the files say."""

    transfer: str = "auto"
    """``auto``, ``linear`` or ``recovered``; see ``ExposureBracketAPI``."""

    dark: Path | None = None
    """Photograph with the lens covered."""

    flat: Path | None = None
    """Photograph of an even field."""

    illuminance: tuple[float, Direction] | None = None
    """Reading of an illuminance meter [lx], and where it faced."""

    luminance: tuple[float, Direction] | None = None
    """Reading of a luminance meter [cd m^-2], and where it looked."""

    session: str | None = None
    """Name of the session; None: that of the folder."""

    threads: int | None = None
    """Photographs read at once; as many as there are cores when None."""
