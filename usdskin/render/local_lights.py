"""Lights that have a place: what they are, in metres, once their prims have been read."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.render.ies import IntensityProfile

FloatArray = NDArray[np.float64]

Kind = Literal["rect", "disk", "sphere", "cylinder", "point", "line"]

KINDS: tuple[Kind, ...] = ("rect", "disk", "sphere", "cylinder", "point", "line")
"""In the order of the kernels' numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class Shaping:
    """How emission depends on direction (UsdLux ShapingAPI), about the light's -z axis.

    With a the angle off the axis, and c its cosine:

    - cone: 1 - smoothstep(a, lerp(softness, angle, 0), angle), and 0 beyond the angle;
    - focus: lerp(|c|^focus, tint, white);
    - profile: its intensity at (a, phi), a rescaled by ``angle_scale``.
    """

    cone_angle: float | None = None
    """[rad]; None where nothing is cut off."""

    cone_softness: float = 0.0
    """Part of the cone's angle over which it fades, 0 to 1."""

    focus: float = 0.0
    """Exponent, not negative."""

    focus_tint: tuple[float, float, float] = (0.0, 0.0, 0.0)

    profile: IntensityProfile | None = None

    angle_scale: float = 0.0
    """UsdLux's ``inputs:shaping:ies:angleScale``."""

    @property
    def has_color(self) -> bool:
        """Whether the tint makes the light's color depend on direction."""
        return self.focus > 0.0 and len(set(self.focus_tint)) > 1


@dataclass(frozen=True, slots=True, eq=False)
class LocalLight:
    """A light with a place, in world space [m], after its transform."""

    path: str
    """Prim path."""

    kind: Kind

    center: FloatArray
    """[m], shape [3]."""

    axes: FloatArray
    """Unit x, y and z axes as rows, at right angles, of either handedness, shape [3, 3]. Rectangles
    and disks shine along -z, cylinders and lines lie along x."""

    half: tuple[float, float]
    """Half width and half height of a rectangle, half length and radius of a cylinder or a line,
    else the radius twice [m]."""

    radiance: FloatArray
    """Spectra of its channels, one, or three that ``texture`` or a coloured focus weighs
    [W m^-2 sr^-1 nm^-1, or relative], shape [1 or 3, band_count]. Of a point it is radiant
    intensity [W sr^-1 nm^-1], of a line radiance times its width [W m^-1 sr^-1 nm^-1]."""

    absolute: bool
    """Whether radiance is in W m^-2 sr^-1 nm^-1."""

    shaping: Shaping = field(default_factory=Shaping)

    texture: NDArray[np.float32] | None = None
    """Weights of the three channels over a rectangle, top row at +y, first column at +x, each
    constant over its texel, shape [height, width, 3]."""


def facing_irradiance(light: LocalLight, position: FloatArray) -> FloatArray:
    """Return about what a surface facing a light receives, as if the light were far away.

    Shaping and pictures are left out; it sets exposures, not pixels.

    Args:
        light: The light.
        position: Where [m], shape [3].

    Returns:
        Irradiance [W m^-2 nm^-1, or relative], shape [band_count].
    """
    a, b = light.half
    size = {
        "rect": 4.0 * a * b, "disk": np.pi * a**2, "sphere": np.pi * a**2, "cylinder": 4.0 * a * b,
        "point": 1.0, "line": 2.0 * a,
    }[light.kind]  # fmt: skip
    away = max(float(((light.center - position) ** 2).sum()), a**2, b**2, 1e-12)
    return np.asarray(light.radiance.sum(axis=0) * size / away)
