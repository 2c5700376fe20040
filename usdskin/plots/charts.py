"""Read what the figure of a colour chart shows, from its layer and the files it names."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from usdskin.estimate.camera.measurements import (
    illuminant_of_patches,
    match_patches,
    read_camera_values,
    read_chart_spectra,
)
from usdskin.estimate.chart.layouts import LAYOUTS, Layout
from usdskin.notes import Note
from usdskin.plots.chart import ChartSpectra
from usdskin.prims import ColorChart
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

FloatArray = NDArray[np.float64]


def read_chart_figure(chart: ColorChart, notes: list[Note]) -> ChartSpectra:
    """Return what the figure of a chart shows, on the grid that calibrations use.

    Camera values that are still in photographs are left there.

    Args:
        chart: What its layer says.
        notes: Takes what was assumed.

    Raises:
        LayerError: Spectra are missing, or names do not fit.
        UsdSkinError: A file cannot be used.
    """
    wavelength_nm = DEFAULT_WAVELENGTHS_NM
    layout = LAYOUTS.get(chart.layout)
    spectra = read_chart_spectra(chart, wavelength_nm, notes)
    count = len(spectra.signals)
    seen = _stated_values(chart)
    if seen is None:
        names = spectra.names or chart.patches or _standing_names(layout, count)
        signals, values = spectra.signals, None
    else:
        camera_rows, spectrum_rows, names = match_patches(
            chart, seen[0], len(seen[1]), spectra, layout, notes
        )
        signals, values = spectra.signals[spectrum_rows], seen[1][camera_rows]
    lamp = spectra.illuminant
    if lamp is None:
        lamp = illuminant_of_patches(chart, names, signals, wavelength_nm, notes)
    light = f"light class {chart.light_class}" if chart.light_class else ""
    return ChartSpectra(
        where=chart.where,
        title=", ".join(filter(None, (chart.name or chart.layout or "Chart", light))),
        names=tuple(names),
        wavelength_nm=wavelength_nm,
        signals=signals,
        illuminant=lamp,
        units=spectra.units,
        camera_values=values,
        positions=_positions(layout, names),
    )


def _stated_values(chart: ColorChart) -> tuple[tuple[str, ...] | None, FloatArray] | None:
    if chart.camera_values is not None:
        return chart.patches, chart.camera_values
    if chart.camera_values_file is not None:
        return read_camera_values(chart.camera_values_file)
    return None


def _standing_names(layout: Layout | None, count: int) -> tuple[str, ...]:
    """Return the layout's names, or numbers."""
    if layout is not None and len(layout.names) == count:
        return layout.names
    return tuple(str(index + 1) for index in range(count))


def _positions(layout: Layout | None, names: tuple[str, ...]) -> NDArray[np.int64]:
    """Return columns and rows: the layout's where it knows every patch, else row by row."""
    if layout is not None:
        found = [layout.index(name) for name in names]
        known = [index for index in found if index is not None]
        if len(known) == len(names):
            return np.asarray(layout.positions[known])
    columns = max(int(np.ceil(np.sqrt(1.5 * len(names)))), 1)
    order = np.arange(len(names))
    return np.stack([order % columns, order // columns], axis=-1)
