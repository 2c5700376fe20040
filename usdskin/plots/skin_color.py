"""What a skin looks like: facing a lamp, and turned from it past the shadow line."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from usdskin.illuminants import illuminant
from usdskin.plots.appearance import display_colors, lab_values
from usdskin.plots.figures import FAINT, INK
from usdskin.prims import SkinParameters
from usdskin.spectrum import Spectrum

FloatArray = NDArray[np.float64]

LAMPS = ("D65", "A", "FL2")
"""Lamps that swatches are shown in."""

_TURNED_TO_DEG = 135.0
_STEPS = 271
_SWATCH = 0.62
"""Share of the height that the facing patch takes."""


def reflected(skin: SkinParameters, cosine: ArrayLike) -> FloatArray:
    """Return the reflectance factor of a skin's body in the light of one lamp, equation (1).

    Over a perfect diffuser that faces the lamp: ``alpha S [max(N.L, 0) + Ss max((N.L + l)/(1 + l),
    0)]``; light from behind is attenuated by ``exp(-s delta)``. What the surface mirrors is left
    out.

    Args:
        skin: A skin with a spectrum of S.
        cosine: N.L [1], shape [k].

    Returns:
        Reflectance factors [1] at the wavelengths of S, shape [k, n].

    Raises:
        ValueError: The skin has no spectrum of S.
    """
    if skin.reflectance is None:
        raise ValueError("a skin without a spectrum of S has no color of its own")
    nm = skin.reflectance.wavelength_nm
    toward = np.asarray(cosine, dtype=np.float64)[:, None]
    scattering = 0.0 if skin.scattering is None else skin.scattering.resample(nm)
    wrapped = np.maximum((toward + skin.wrap) / (1.0 + skin.wrap), 0.0)
    if skin.wrap_normalization == "energy":
        wrapped = wrapped / (1.0 + skin.wrap)
    factor = np.maximum(toward, 0.0) + scattering * wrapped
    opacity = skin.opacity
    delta = opacity.resample(nm) if isinstance(opacity, Spectrum) else opacity
    through = np.where(toward < 0.0, np.exp(-skin.thickness * delta), 1.0)
    return np.asarray(skin.alpha * skin.reflectance.value * factor * through)


def typology_angle(lab: ArrayLike) -> float:
    """Return the individual typology angle of skin [deg], arctan((L* - 50) / b*).

    A. Chardon, I. Cretois and C. Hourseau, "Skin colour typology and suntanning pathways", Int J
    Cosmet Sci 13 (1991).

    Args:
        lab: L*, a*, b* under D65, shape [3].
    """
    lightness, _, yellow = np.asarray(lab, dtype=np.float64)
    return float(np.degrees(np.arctan2(lightness - 50.0, yellow)))


def draw_swatches(part: Any, skin: SkinParameters, lamps: Sequence[str] = LAMPS) -> None:
    """Draw a patch that faces each lamp, and below it the same skin turned away from the lamp.

    Args:
        part: Matplotlib's ``SubFigure`` to fill, below its headline.
        skin: A skin with a spectrum of S.
        lamps: Names of illuminants.
    """
    grid = part.subplots(1, len(lamps), squeeze=False)
    for axes, lamp in zip(grid.flat, lamps, strict=True):
        _draw_swatch(axes, skin, lamp)


def _draw_swatch(axes: Any, skin: SkinParameters, lamp: str) -> None:
    from matplotlib.patches import Rectangle

    assert skin.reflectance is not None  # reflected
    nm = skin.reflectance.wavelength_nm
    light = illuminant(lamp, nm)
    theta_deg = np.linspace(0.0, _TURNED_TO_DEG, _STEPS)
    signals = light * reflected(skin, np.cos(np.radians(theta_deg)))
    colors = display_colors(signals, light, nm)
    lab = lab_values(signals[:1], light, nm)[0]
    axes.imshow(colors[None], extent=(0.0, _TURNED_TO_DEG, 0.0, 1.0 - _SWATCH), aspect="auto",
                interpolation="none")  # fmt: skip
    axes.add_patch(Rectangle((0.0, 1.0 - _SWATCH), _TURNED_TO_DEG, _SWATCH,
                             facecolor=tuple(colors[0]), edgecolor="none"))  # fmt: skip
    axes.plot([90.0, 90.0], [-0.04, 1.0 - _SWATCH], color=FAINT, linewidth=0.8)
    axes.set(xlim=(0.0, _TURNED_TO_DEG), ylim=(0.0, 1.0), yticks=[])
    axes.set_xticks([0, 30, 60, 90, 120], ["0°", "30°", "60°", "90°", "120°"])
    axes.spines[:].set_visible(False)
    axes.set_title(lamp)
    axes.set_xlabel("angle of the light")
    light_enough = float(colors[0] @ [0.2126, 0.7152, 0.0722]) > 0.5
    words = f"L* {lab[0]:.1f}   a* {lab[1]:.1f}   b* {lab[2]:.1f}"
    if lamp == "D65":  # what the classes are defined for
        words += f"\nITA {typology_angle(lab):.1f}°"
    axes.text(0.03, 0.96, words, transform=axes.transAxes, va="top", fontsize=6.5,
              color=INK if light_enough else "white", linespacing=1.4)  # fmt: skip
