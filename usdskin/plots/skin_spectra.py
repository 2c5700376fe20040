"""Curves of a skin over wavelength: S, Ss and delta, with what is not known of them."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.plots.figures import ESTIMATE, FAINT, INK, legend_inside, name_axes
from usdskin.plots.spectra import WAVELENGTH
from usdskin.spectrum import Spectrum

FloatArray = NDArray[np.float64]

_PER_MILLIMETRE = 1e-3
_FEW = 12
_FACING_DASHES: Any = (0, (1, 1))
_LARGEST_BAND = 1.6
"""A band of errors is shown up to this many times the curve's peak."""


def draw_reflectance(
    axes: Any, spectrum: Spectrum, deviation: Spectrum | None, facing: FloatArray, fitted: bool
) -> None:
    """Draw S, and what a patch that faces the light reflects of it.

    Args:
        axes: Matplotlib's axes.
        spectrum: S [1].
        deviation: Its standard deviation [1]; None: not known.
        facing: Reflectance factor of the patch at the wavelengths of S [1], shape [n].
        fitted: Whether S was estimated.
    """
    nm = spectrum.wavelength_nm
    high = _draw_curve(axes, nm, spectrum.value, _on(deviation, nm), "S", fitted)
    axes.plot(nm, facing, color=FAINT, linestyle=_FACING_DASHES, label="facing the light")
    _finish(axes, nm, max(high, float(facing.max())), "Reflectance S", "reflectance [1]")
    legend_inside(axes)


def draw_scattering(
    axes: Any, spectrum: Spectrum, deviation: Spectrum | None, fitted: bool
) -> None:
    """Draw Ss.

    Args:
        axes: Matplotlib's axes.
        spectrum: Ss [1].
        deviation: Its standard deviation [1]; None: not known.
        fitted: Whether Ss was estimated.
    """
    nm = spectrum.wavelength_nm
    high = _draw_curve(axes, nm, spectrum.value, _on(deviation, nm), "Ss", fitted)
    _finish(axes, nm, high, "Scattering Ss", "share of the wrap term [1]")
    if deviation is not None:
        legend_inside(axes)


def draw_opacity(axes: Any, opacity: Spectrum | float, range_nm: tuple[float, float]) -> None:
    """Draw delta, per millimetre.

    Args:
        axes: Matplotlib's axes.
        opacity: delta [m^-1], for every wavelength or one for all.
        range_nm: First and last wavelength to show one for all at [nm].
    """
    if isinstance(opacity, Spectrum):
        nm, value = opacity.wavelength_nm, _PER_MILLIMETRE * opacity.value
    else:
        nm, value = np.array(range_nm), np.full(2, _PER_MILLIMETRE * opacity)
    _draw_curve(axes, nm, value, None, "delta", False, dots=isinstance(opacity, Spectrum))
    _finish(axes, nm, float(value.max()), "Opacity δ", "attenuation [mm$^{-1}$]")


def _on(deviation: Spectrum | None, nm: FloatArray) -> FloatArray | None:
    return None if deviation is None else deviation.resample(nm, "hold")


def _draw_curve(
    axes: Any, nm: FloatArray, value: FloatArray, deviation: FloatArray | None, name: str,
    fitted: bool, dots: bool = True,
) -> float:  # fmt: skip
    """Draw a curve and the band of its error; return the largest value to show."""
    color = ESTIMATE if fitted else INK
    high = float(value.max())
    if deviation is not None:
        low, top = np.maximum(value - 2.0 * deviation, 0.0), value + 2.0 * deviation
        axes.fill_between(nm, low, top, facecolor=color, alpha=0.22, linewidth=0.0, label="± 2 σ")
        high = min(max(high, float(top.max())), _LARGEST_BAND * high) if high > 0.0 else high
    marker = "o" if dots and len(nm) <= _FEW else None
    axes.plot(nm, value, color=color, label=name, marker=marker, markersize=3.0)
    return high


def _finish(axes: Any, nm: FloatArray, high: float, title: str, label: str) -> None:
    edges = (nm[0], nm[-1]) if len(nm) > 1 else (nm[0] - 5.0, nm[0] + 5.0)
    axes.set(xlim=edges, ylim=(0.0, 1.18 * high if high > 0.0 else 1.0))
    axes.locator_params(axis="x", nbins=5)
    axes.set_title(title)
    name_axes(axes, WAVELENGTH, label)
