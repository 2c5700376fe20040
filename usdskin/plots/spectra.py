"""Curves over wavelength: sensitivities, the light of a class, patches and their estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.plots.figures import (
    CHANNEL_DASHES,
    CHANNELS,
    DASHED,
    ESTIMATE,
    FAINT,
    INK,
    legend_inside,
    name_axes,
    section_title,
)
from usdskin.spectrum import band_widths

FloatArray = NDArray[np.float64]

WAVELENGTH = "wavelength [nm]"
RADIANCE = "W m$^{-2}$ sr$^{-1}$ nm$^{-1}$"
_PREFIXES = ((1.0, ""), (1e-3, "m"), (1e-6, "µ"), (1e-9, "n"))
_COLUMNS = 4
_LARGEST = 2.5
_NAME_CHARACTERS = 21


def radiance_scale(peak: float, units: str) -> tuple[float, str]:
    """Return what to divide radiances by, and the label of their axis.

    Args:
        peak: Largest value in the panel.
        units: ``absolute`` or ``relative``.
    """
    if units != "absolute":
        return (peak if peak > 0.0 else 1.0), "relative radiance"
    for factor, prefix in _PREFIXES:
        if peak >= 0.5 * factor:
            return factor, f"radiance [{prefix}{RADIANCE}]"
    return _PREFIXES[-1][0], f"radiance [{_PREFIXES[-1][1]}{RADIANCE}]"


def curve_range(measured: FloatArray, estimated: FloatArray) -> tuple[float, float]:
    """Return the range of an axis on which a measured curve stays legible.

    An estimate that explodes leaves the panel, and is seen to.

    Args:
        measured: Shape [band_count].
        estimated: Shape [band_count].
    """
    peak = float(measured.max())
    peak = peak if peak > 0.0 else 1.0
    high = min(max(peak, float(estimated.max())), _LARGEST * peak)
    low = max(min(0.0, float(measured.min()), float(estimated.min())), -peak)
    return 1.08 * low, 1.08 * high


def draw_sensitivities(
    axes: Any, wavelength_nm: FloatArray, responsivity: FloatArray, noise: FloatArray | None
) -> None:
    """Draw the sensitivities of a camera, the highest peak being 1.

    Args:
        axes: Matplotlib's axes.
        wavelength_nm: Band centres [nm], shape [band_count].
        responsivity: Response to radiance, band widths included, shape [band_count, 3].
        noise: Relative noise of a camera value, shape [3].
    """
    curves = responsivity / band_widths(wavelength_nm)[:, None]
    curves = curves / (float(np.abs(curves).max()) or 1.0)
    for index, name in enumerate("RGB"):
        axes.plot(wavelength_nm, curves[:, index], color=CHANNELS[index], label=name,
                  linestyle=CHANNEL_DASHES[index])  # fmt: skip
    axes.set_title("Sensitivities")
    if noise is not None:
        listed = ", ".join(f"{100.0 * value:.2g}" for value in noise)
        axes.set_title(f"noise {listed} %", loc="right", fontsize=6.5, fontweight="normal")
    axes.set(xlim=(wavelength_nm[0], wavelength_nm[-1]), ylim=(min(0.0, curves.min()), 1.18))
    name_axes(axes, WAVELENGTH, "relative response [1]")
    legend_inside(axes)


def draw_class_light(
    axes: Any,
    wavelength_nm: FloatArray,
    spectra: tuple[FloatArray, FloatArray, FloatArray | None],
    units: str,
) -> None:
    """Draw the light of a class as it was measured and as the camera recovers it.

    Args:
        axes: Matplotlib's axes.
        wavelength_nm: Band centres [nm], shape [band_count].
        spectra: Radiance of the perfect diffuser as measured, as recovered from its camera values,
            and the posterior standard deviation of the latter or None, shape [band_count] each.
        units: ``absolute`` or ``relative``.
    """
    measured, recovered, deviation = spectra
    scale, label = radiance_scale(float(measured.max()), units)
    if deviation is not None:
        band = (recovered - 2.0 * deviation) / scale, (recovered + 2.0 * deviation) / scale
        axes.fill_between(wavelength_nm, *band, facecolor=ESTIMATE, alpha=0.22, linewidth=0.0,
                          label="± 2 σ")  # fmt: skip
    axes.plot(wavelength_nm, recovered / scale, color=ESTIMATE, label="recovered")
    axes.plot(wavelength_nm, measured / scale, color=INK, linestyle=DASHED, label="measured")
    axes.set(xlim=(wavelength_nm[0], wavelength_nm[-1]))
    reach = 0.0 if deviation is None else 2.0 * deviation
    low, high = curve_range(measured, np.concatenate([recovered - reach, recovered + reach]))
    axes.set_ylim(low / scale, 1.10 * high / scale)
    axes.set_title("Perfect diffuser")
    name_axes(axes, WAVELENGTH, label)
    legend_inside(axes)


def patch_rows(count: int) -> int:
    """Return how many rows of panels a number of patches takes."""
    return -(-count // _COLUMNS)


def draw_patches(
    part: Any,
    wavelength_nm: FloatArray,
    spectra: tuple[FloatArray, FloatArray],
    colors: FloatArray,
    captions: Sequence[tuple[str, str]],
    units: str,
) -> None:
    """Draw one panel per patch: its signal measured (dashed) and estimated (solid).

    Args:
        part: Matplotlib's ``SubFigure`` to fill.
        wavelength_nm: Band centres [nm], shape [band_count].
        spectra: Measured and estimated signals, shape [count, band_count] each.
        colors: What the patches look like, sRGB, shape [count, 3].
        captions: Name of each patch, and what is said about it below.
        units: ``absolute`` or ``relative``.
    """
    measured, estimated = spectra
    scale, label = radiance_scale(float(measured.max()), units)
    rows, columns = patch_rows(len(captions)), min(_COLUMNS, len(captions))
    grid = part.subplots(rows, columns, squeeze=False, sharex=True)
    for index, axes in enumerate(grid.flat):
        if index >= len(captions):
            axes.set_visible(False)
            continue
        low, high = curve_range(measured[index], estimated[index])
        axes.plot(wavelength_nm, estimated[index] / scale, color=ESTIMATE, label="estimated")
        axes.plot(wavelength_nm, measured[index] / scale, color=INK, linestyle=DASHED,
                  linewidth=1.0, label="measured")  # fmt: skip
        axes.set(xlim=(wavelength_nm[0], wavelength_nm[-1]), ylim=(low / scale, high / scale))
        axes.grid(True)
        axes.locator_params(axis="y", nbins=4)
        axes.locator_params(axis="x", nbins=4)
        if index + columns >= len(captions):
            axes.tick_params(labelbottom=True)
        _draw_caption(axes, captions[index], colors[index])
    part.supxlabel(WAVELENGTH, fontsize=7.5)
    part.supylabel(label.replace(" [", "\n[") if rows == 1 else label, fontsize=7.5)
    handles, names = grid.flat[0].get_legend_handles_labels()
    section_title(part, "Spectra of patches", "curves: fitted; figures: leave-one-out")
    part.legend(handles[::-1], names[::-1], loc="upper right", ncols=2, borderaxespad=0.2)


def _draw_caption(axes: Any, caption: tuple[str, str], color: FloatArray) -> None:
    from matplotlib.patches import Rectangle

    name, figures = caption
    name = name if len(name) <= _NAME_CHARACTERS else f"{name[: _NAME_CHARACTERS - 1]}…"
    axes.set_title(name, fontsize=7.0, pad=12.0)
    axes.text(0.0, 1.035, figures, transform=axes.transAxes, fontsize=6.0, color=FAINT)
    axes.add_patch(
        Rectangle((0.895, 1.05), 0.105, 0.15, transform=axes.transAxes, clip_on=False,
                  facecolor=tuple(color), edgecolor=FAINT)
    )  # fmt: skip
