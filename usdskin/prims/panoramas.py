"""What ``CaptureAPI`` says once the panorama is made -> ``CapturedPanorama``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from usdskin.layers import describe
from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.captures import capture_prim, reading_direction
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class CapturedPanorama:
    """One captured panorama, in camera values times a scale."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    panorama_file: Path
    """Latlong EXR with R, G, B: rho times ``scale``."""

    scale: float
    """Factor from rho to pixels."""

    stddev_file: Path | None = None
    """EXR with the parts ``stddev`` and ``quality`` (clipped, moved, seen)."""

    units: str = "relative"
    """``absolute`` where a reading gave the scale, else ``relative``."""

    up_axis: str = "Y"
    """``Y`` or ``Z``, the stage's; ``usdskin.latlong.latlong_from_world`` turns it to the pole."""

    model: str = ""
    """Model of the camera."""

    lens: str = ""
    """Model of the lens."""

    white_balance: str = ""
    """White balance and color matrix applied to the pictures; empty for raw values."""

    iso: FloatArray | None = None
    """ISO settings of the photographs, ascending; None: not stated."""

    illuminance_lx: float = 0.0
    """Reading of an illuminance meter [lx]; 0: not taken."""

    illuminance_direction: FloatArray | None = None
    """Where the meter faced, unit vector in the stage's world, shape [3]."""

    luminance: float = 0.0
    """Reading of a luminance meter [cd m^-2]; 0: not taken."""

    luminance_direction: FloatArray | None = None
    """Where the meter looked, unit vector in the stage's world, shape [3]."""

    coverage: float | None = None
    """Share of the sphere that was seen [1]."""

    clipped_share: float | None = None
    """Share of the light in pixels saturated in every exposure [1]."""


def read_captured_panorama(stage: Usd.Stage) -> CapturedPanorama:
    """Return the panorama of a capture.

    Args:
        stage: Stage with one prim that has ``CaptureAPI``: the default prim, or the only one.

    Raises:
        LayerError: There is no such prim or several, it has no panorama yet, or an opinion cannot
            be used.
    """
    prim = capture_prim(stage)
    check_applied_schemas(prim)
    values = read_schema(prim, "CaptureAPI", DEFAULT_TIME)
    for name in ("capture:panorama:file", "capture:scale"):
        if values[name] is None:
            text = "has no value, so there is no panorama yet; `usdskin capture` makes it"
            raise PrimError(prim, Problem("missing-value", name, text))
    if not values["capture:scale"] > 0.0:
        text = "is 0; it is the factor from camera values to pixels, so author one above 0"
        raise PrimError(prim, Problem("out-of-range", "capture:scale", text))
    iso = values["capture:settings:iso"]
    return CapturedPanorama(
        where=describe(prim),
        panorama_file=values["capture:panorama:file"],
        scale=values["capture:scale"],
        stddev_file=values["capture:stddev:file"],
        units=values["capture:units"],
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        model=values["capture:settings:model"],
        lens=values["capture:settings:lens"],
        white_balance=values["capture:settings:whiteBalance"],
        iso=None if iso is None or not len(iso) else iso,
        illuminance_lx=values["capture:illuminance"],
        illuminance_direction=reading_direction(prim, values["capture:illuminance:direction"]),
        luminance=values["capture:luminance"],
        luminance_direction=reading_direction(prim, values["capture:luminance:direction"]),
        coverage=values["capture:coverage"],
        clipped_share=values["capture:clippedShare"],
    )
