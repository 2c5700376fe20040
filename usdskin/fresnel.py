"""What a smooth dielectric mirrors of unpolarised light.

Fresnel's formulas (M. Born and E. Wolf, "Principles of Optics", 7th ed., 1999, section 1.5.2). Not
Schlick's approximation: at an index of 1.4 that is 20 % too low at 60 degrees and 8 % too high at
85 degrees.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

FloatArray = NDArray[np.float64]

_HIGHEST_F0 = 0.9999
"""A dielectric that mirrors all has no finite index."""


def index_of(f0: float) -> float:
    """Return the refractive index over that of the air [1] of a reflectance at normal incidence.

    Args:
        f0: Reflectance [1], 0 to 1; taken as 0.9999 above that.

    Returns:
        Index [1], 1 to 40 000.
    """
    root = float(np.sqrt(min(f0, _HIGHEST_F0)))
    return (1.0 + root) / (1.0 - root)


def reflectance(index: float, cosine: ArrayLike) -> FloatArray:
    """Return the share of light that is mirrored.

    Args:
        index: Refractive index of the body over that of the air [1], at least 1.
        cosine: Of the angle of incidence [1], 0 to 1.

    Returns:
        Reflectance [1], shape of ``cosine``.
    """
    outside = np.asarray(cosine, dtype=np.float64)
    # With index 1 nothing is mirrored, at cosine 0 neither: 1 / tiny keeps 0 / 0 away.
    inside = np.sqrt(np.maximum(1.0 - (1.0 - outside**2) / index**2, 1e-30))
    across = (outside - index * inside) / (outside + index * inside)
    along = (index * outside - inside) / (index * outside + inside)
    return np.asarray(0.5 * (across**2 + along**2))


def rise(f0: float, cosine: ArrayLike) -> FloatArray:
    """Return (F - F0) / (1 - F0): how far the reflectance has come from F0 to 1.

    Args:
        f0: Reflectance at normal incidence [1], 0 to 1.
        cosine: Of the angle of incidence [1], 0 to 1.

    Returns:
        Rise [1], shape of ``cosine``.
    """
    f0 = min(f0, _HIGHEST_F0)
    return np.asarray((reflectance(index_of(f0), cosine) - f0) / (1.0 - f0))
