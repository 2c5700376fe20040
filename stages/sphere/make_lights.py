"""Make the sphere's lights: ``python stages/sphere/make_lights.py``.

Writes: ``lamp.exr``, coefficients of a small bright lamp in a dim room, and ``lamp_rgb.exr``, the
        same as RGB. Both are committed; run this after a change.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from usdskin.colorimetry import illuminant, xyz_to_rgb, xyz_weights
from usdskin.images import Part, write_exr

FOLDER = Path(__file__).resolve().parent
HEIGHT = 64
WAVELENGTH_NM = np.arange(380.0, 731.0, 10.0)

LAMP = (14, 76)
"""First row and column of the lamp, which is 2 x 2 texels: 5.6 degrees wide."""

LAMP_RADIANCE, ROOM_RADIANCE = 240.0, 0.08


def basis() -> np.ndarray:
    """Return the spectra of the channels: FL11, a tube of three narrow bands, and FL2 for the room.

    Each has luminance 1. Shape [2, band_count].
    """
    rows = np.stack([illuminant(name, WAVELENGTH_NM) for name in ("FL11", "FL2")])
    return rows / (rows @ xyz_weights(WAVELENGTH_NM)[:, 1:2])


def coefficients() -> np.ndarray:
    """Return lamp and room over the sphere, shape [HEIGHT, 2 * HEIGHT, 2]."""
    maps = np.zeros((HEIGHT, 2 * HEIGHT, 2), np.float32)
    row, column = LAMP
    maps[row : row + 2, column : column + 2, 0] = LAMP_RADIANCE
    # A room whose floor is half as bright as its ceiling.
    maps[..., 1] = (ROOM_RADIANCE * np.linspace(1.0, 0.5, HEIGHT))[:, None]
    return maps


def main() -> None:
    """Write the maps and print the basis for sphere.usda."""
    maps, rows = coefficients(), basis()
    channels = {f"c{k}": maps[..., k] for k in range(2)}
    write_exr(FOLDER / "lamp.exr", [Part("light", channels)])
    rgb = maps @ (rows @ xyz_weights(WAVELENGTH_NM)) @ xyz_to_rgb("lin_rec709_scene").T
    part = Part("", {"": rgb.astype(np.float32)}, {}, "half", "lin_rec709_scene")
    write_exr(FOLDER / "lamp_rgb.exr", [part])
    print(", ".join(f"{value:.6g}" for value in rows.ravel()))


if __name__ == "__main__":
    main()
