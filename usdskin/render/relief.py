"""Normal and height maps made ready to be averaged: unit normals, and slopes with their squares.

What a kernel reads of a map far below its own resolution is a mean. The mean of unit normals is
shorter the more they differ (Toksvig, "Mipmapping normal maps", NVIDIA 2004); the mean of squared
slopes less the square of the mean is their variance (Olano and Baker, "LEAN mapping", I3D 2010).
Both widen reflections, so that rough relief stays dull when it is seen from afar.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from usdskin.render.textures import Texture, mip_pyramid

_PADDING = {"repeat": "wrap", "clamp": "edge", "mirror": "symmetric", "black": "constant"}


def unit_normals(texture: Texture) -> Texture:
    """Return a normal map whose normals have length 1, (0, 0, 1) where they have none.

    Wrap mode ``black`` shows no relief outside, where the bias would make a normal of black.
    """
    normals = texture.levels[0].copy()
    length = np.sqrt(np.einsum("...i,...i->...", normals[..., :3], normals[..., :3]))
    vanishes = length < 1e-6
    normals[..., :3] /= np.where(vanishes, 1.0, length)[..., None]
    normals[vanishes, :3] = (0.0, 0.0, 1.0)
    return dataclasses.replace(texture, levels=mip_pyramid(normals), border=(0.0, 0.0, 1.0, 0.0))


def slopes(texture: Texture, channel: int) -> Texture:
    """Return the slopes of a height map: along s, along t, and the squares of both.

    Args:
        texture: The height map.
        channel: Which of its channels is the height.

    Returns:
        Central differences per unit of s and of t (which runs upwards), by texel.
    """
    height = texture.levels[0][..., channel].astype(np.float64)
    rows, columns = height.shape
    wide = np.pad(height, ((0, 0), (1, 1)), mode=_PADDING[texture.wrap_s])  # type: ignore[call-overload]
    tall = np.pad(height, ((1, 1), (0, 0)), mode=_PADDING[texture.wrap_t])  # type: ignore[call-overload]
    along_s = 0.5 * columns * (wide[:, 2:] - wide[:, :-2])
    along_t = 0.5 * rows * (tall[:-2] - tall[2:])
    found = np.stack([along_s, along_t, along_s**2, along_t**2], axis=-1).astype(np.float32)
    return dataclasses.replace(texture, levels=mip_pyramid(found), border=(0.0, 0.0, 0.0, 0.0))
