"""Take the surface's mirror image out of spectrophotometer readings of skin."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin import fresnel as fresnel_formulas
from usdskin.errors import LayerError

FloatArray = NDArray[np.float64]

SKIN_F0 = 0.028
"""Reflectance of skin's surface at normal incidence [1], that of the index 1.4."""

SPHERE_ANGLE_DEG = 8.0
"""Angle from the normal at which an integrating sphere is looked into, di:8 or 8:di [deg]."""


def fresnel(index: float, angle_deg: ArrayLike) -> FloatArray:
    """Return the share of unpolarised light that a smooth surface mirrors.

    Fresnel's formulas (M. Born and E. Wolf, "Principles of Optics", 7th ed., 1999, section 1.5.2).

    Args:
        index: Refractive index of the body over that of the air [1], at least 1.
        angle_deg: Angle of incidence from the normal [deg], 0 to 90.

    Returns:
        Reflectance [1], shape of ``angle_deg``.
    """
    return fresnel_formulas.reflectance(index, np.cos(np.radians(np.asarray(angle_deg, float))))


def specular_included(
    reflectance: ArrayLike,
    f0: float = SKIN_F0,
    angle_deg: float = SPHERE_ANGLE_DEG,
    where: str = "reflectance",
) -> FloatArray:
    """Return the diffuse reflectance within readings that include the mirror image.

    In a uniformly lit sphere (di:8, specular included) skin seen at 8 degrees mirrors the share
    F(8 degrees) of the sphere's light, whatever its roughness but for a few thousandths, and by
    reciprocity it does so lit at 8 degrees and seen from all sides (8:di). What remains is the
    light that has been in the skin, as seen from outside: S. It is the first of the two
    corrections of J. L. Saunderson, "Calculation of the color of pigmented plastics", JOSA 32(12),
    1942; the second, inner reflection, belongs to what S is.

    Args:
        reflectance: Reflectance over the perfect diffuser's [1], shape [..., n].
        f0: Reflectance of the surface at normal incidence [1], below 1.
        angle_deg: Angle between the normal and the one direction [deg].
        where: ``file:line`` or ``layer.usda </Prim/path>``, for errors.

    Returns:
        Diffuse reflectance [1], shape [..., n].

    Raises:
        LayerError: A reading is not above what the surface mirrors.
    """
    values = np.asarray(reflectance, dtype=np.float64)
    root = np.sqrt(f0)
    mirrored = float(fresnel((1.0 + root) / (1.0 - root), angle_deg))
    low = np.argwhere(~(values > mirrored))
    if low.size:
        at = tuple(int(index) for index in low[0])
        raise LayerError(
            f"{where}: value {list(at)} is {values[at]:.4g}, not above the {mirrored:.4g} that the "
            "surface alone mirrors; was the specular component excluded?"
        )
    return np.asarray(values - mirrored)
