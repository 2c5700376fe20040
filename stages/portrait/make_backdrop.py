"""Make the portrait's painted backdrop: ``python stages/portrait/make_backdrop.py``.

Writes: ``backdrop.exr``, a reflectance: grey canvas, brushed in clouds, brighter behind the head.
        It is committed; run this after a change.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from usdskin.images import Part, write_exr

FOLDER = Path(__file__).resolve().parent
SIZE = (128, 160)
"""Width and height [px]; the cloth is 2 m x 2.5 m."""


def main() -> None:
    """Write the texture."""
    width, height = SIZE
    random = np.random.default_rng(3)
    y, x = np.mgrid[0:height, 0:width]
    x, y = (x + 0.5) / width, 1.0 - (y + 0.5) / height
    clouds = np.zeros((height, width))
    for octave in range(5):
        across = 3 * 2**octave
        knots = random.normal(0.0, 0.6**octave, (across + 2, across + 2))
        clouds += _stretched(knots, x * across, y * across)
    glow = np.exp(-(((x - 0.40) / 0.17) ** 2 + ((y - 0.50) / 0.17) ** 2))
    level = (0.020 + 0.062 * glow) * np.exp(0.16 * clouds)
    color = level[..., None] * np.array([0.98, 1.0, 1.03])
    part = Part("", {"": color.astype(np.float32)}, {}, "half", "lin_rec709_scene")
    write_exr(FOLDER / "backdrop.exr", [part])


def _stretched(knots: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Return knots joined smoothly, at places counted in knots."""
    column, row = x.astype(int), y.astype(int)
    u, v = x - column, y - row
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    upper = knots[row, column] * (1.0 - u) + knots[row, column + 1] * u
    lower = knots[row + 1, column] * (1.0 - u) + knots[row + 1, column + 1] * u
    return upper * (1.0 - v) + lower * v


if __name__ == "__main__":
    main()
