"""What an input of a material may be: a constant, a texture or a primvar."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

Color: TypeAlias = tuple[float, float, float]
Four: TypeAlias = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class TextureInput:
    """A picture, or one channel of it, looked up by texture coordinates.

    Its value is ``texel * scale + bias`` at ``st_matrix @ (s, t, 1)``, channel by channel.
    """

    file: str
    """The picture; may hold ``<UDIM>``, and may be inside a package (``a.usdz[b.png]``)."""

    channel: str = "rgb"
    """``rgb``, ``rgba``, ``r``, ``g``, ``b`` or ``a``."""

    source_color_space: str = "auto"
    """``auto``, ``raw``, ``sRGB`` or USD's name of a color space."""

    scale: Four = (1.0, 1.0, 1.0, 1.0)
    """Factor of each channel [1]."""

    bias: Four = (0.0, 0.0, 0.0, 0.0)
    """Summand of each channel [1]."""

    fallback: Four = (0.0, 0.0, 0.0, 1.0)
    """What ``UsdUVTexture`` shows where there is no picture."""

    wrap_s: str = "useMetadata"
    """``black``, ``clamp``, ``repeat``, ``mirror`` or ``useMetadata``."""

    wrap_t: str = "useMetadata"
    """As ``wrap_s``, for t."""

    primvar: str = "st"
    """Name of the primvar with the texture coordinates, their origin at the bottom left."""

    st_matrix: NDArray[np.float64] = field(default_factory=lambda: np.eye(2, 3))
    """Map from the primvar to the picture's coordinates [1], shape [2, 3]."""

    first_channel: int = 0
    """Channel of the file that comes first, for files of more than four weights."""

    def texture_key(self) -> Hashable:
        """Return what two inputs share when they share the decoded picture."""
        return (
            self.file,
            self.source_color_space,
            self.scale,
            self.bias,
            self.wrap_s,
            self.wrap_t,
            self.first_channel,
        )


@dataclass(frozen=True, slots=True, eq=False)
class PrimvarInput:
    """A primvar of the geometry."""

    name: str
    """Name without ``primvars:``."""

    fallback: tuple[float, ...]
    """Value where the geometry has no such primvar [1]."""


Input: TypeAlias = float | Color | TextureInput | PrimvarInput
