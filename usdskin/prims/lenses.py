"""``FisheyeCameraAPI`` <-> ``FisheyeLens``."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.writing import write_schema

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class FisheyeLens:
    """A fisheye projection; image x runs right, y down, from the corner of the first pixel."""

    projection: str
    """``equidistant``, ``equisolid``, ``stereographic``, ``orthographic`` or ``opencv``."""

    focal_length_px: float
    """f [px]."""

    center_px: FloatArray
    """Where the optical axis meets the image [px], shape [2]."""

    resolution: tuple[int, int]
    """Width and height of the pictures these numbers refer to [px]."""

    distortion: FloatArray = field(default_factory=lambda: np.zeros(4))
    """k1 .. k4 of ``opencv`` [1], shape [4]."""

    max_angle_deg: float = 90.0
    """Largest angle from the axis that holds picture [deg]."""

    vignetting: FloatArray = field(default_factory=lambda: np.zeros(0))
    """a2, a4, ... of V(phi) = 1 + a2 phi^2 + a4 phi^4 + ..., phi in radians [1]."""

    glare: float = 0.0
    """Share of the light that is spread evenly over the picture [1]."""


def read_lens(prim: Usd.Prim) -> FisheyeLens:
    """Return the calibrated fisheye projection of a camera.

    Raises:
        LayerError: The camera has none, or an opinion cannot be used.
    """
    if not prim.HasAPI("FisheyeCameraAPI"):
        raise LayerError(
            f"{describe(prim)}: has no FisheyeCameraAPI; reference a lens that `usdskin calibrate "
            "lens` wrote, or author it"
        )
    values = read_schema(prim, "FisheyeCameraAPI", DEFAULT_TIME)
    for name in ("fisheye:focalLength", "fisheye:center", "fisheye:resolution"):
        if values[name] is None or not np.any(values[name]):
            text = "has no value; the lens is not calibrated: see `usdskin calibrate lens`"
            raise PrimError(prim, Problem("missing-value", name, text))
    width, height = (int(value) for value in values["fisheye:resolution"])
    vignetting = values["fisheye:vignetting"]
    return FisheyeLens(
        projection=values["fisheye:projection"],
        focal_length_px=values["fisheye:focalLength"],
        center_px=values["fisheye:center"],
        resolution=(width, height),
        distortion=values["fisheye:distortion"],
        max_angle_deg=values["fisheye:maxAngle"],
        vignetting=np.zeros(0) if vignetting is None else vignetting,
        glare=values["fisheye:glare"],
    )


def write_lens(prim: Usd.Prim, lens: FisheyeLens) -> None:
    """Apply ``FisheyeCameraAPI`` to a camera and author a lens.

    Raises:
        LayerError: The prim is no camera.
    """
    write_schema(
        prim,
        "FisheyeCameraAPI",
        {
            "fisheye:projection": lens.projection,
            "fisheye:focalLength": float(lens.focal_length_px),
            "fisheye:center": Gf.Vec2d(*(float(value) for value in lens.center_px)),
            "fisheye:resolution": Gf.Vec2i(*(int(value) for value in lens.resolution)),
            "fisheye:distortion": Gf.Vec4d(*(float(value) for value in lens.distortion)),
            "fisheye:maxAngle": float(lens.max_angle_deg),
            "fisheye:vignetting": lens.vignetting if len(lens.vignetting) else None,
            "fisheye:glare": float(lens.glare),
        },
    )
