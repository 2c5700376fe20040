"""The patches of a chart, paired: camera values on one side, spectra on the other."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers
from usdskin.errors import LayerError, UsageError
from usdskin.estimate.camera.measurements import (
    Spectra,
    illuminant_of_patches,
    match_patches,
    read_camera_values,
    read_chart_spectra,
)
from usdskin.estimate.chart.check import check_patches
from usdskin.estimate.chart.detect import find_corners
from usdskin.estimate.chart.layouts import LAYOUTS, Layout
from usdskin.estimate.chart.photograph import develop
from usdskin.estimate.chart.sample import sample_patches
from usdskin.notes import Note
from usdskin.prims import ColorChart
from usdskin.progress import Progress

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class UsedPatches:
    """Patches that a calibration can be made from."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    light_class: str
    """Class of the light they stood in."""

    names: tuple[str, ...]
    """Their names."""

    camera_values: FloatArray
    """Camera values rho, shape [m, 3]."""

    camera_stddev: FloatArray | None
    """Their standard error, shape [m, 3]; None: not known."""

    signals: FloatArray
    """Their radiance, shape [m, n]."""

    illuminant: FloatArray
    """Radiance of a perfect diffuser among them, shape [n]."""

    left_out: tuple[str, ...]
    """Patches that were not used."""


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What a camera saw of a chart."""

    names: tuple[str, ...] | None
    values: FloatArray
    stddev: FloatArray | None = None
    clipped: FloatArray | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Darkroom:
    """Where photographs of charts are developed."""

    workers: Workers | None
    """Where kernels run; None: there are no photographs."""

    scratch: Path
    """Folder for decoded files; the caller removes it."""

    progress: Progress
    """Told how far photographs are."""


def read_patches(
    chart: ColorChart,
    wavelength_nm: FloatArray,
    darkroom: Darkroom,
    excluded: tuple[str, ...],
    notes: list[Note],
) -> UsedPatches:
    """Return the patches of a chart whose camera values and spectra a calibration can use.

    Args:
        chart: What its layer says.
        wavelength_nm: Band centres [nm], shape [n].
        darkroom: Where photographs are developed.
        excluded: Names of patches to leave out.
        notes: Takes which patches were left out, and why.

    Raises:
        LayerError: Values or spectra are missing, the chart is not found in its picture, names do
            not fit, the order is wrong, or too few patches are left.
        ImageError: A picture cannot be used.
        UsageError: A patch to leave out is not there.
        UsdSkinError: A file of spectra cannot be used.
    """
    layout = LAYOUTS.get(chart.layout)
    spectra = read_chart_spectra(chart, wavelength_nm, notes)
    seen = _seen(chart, layout, spectra, darkroom, notes)
    camera_rows, spectrum_rows, names = match_patches(
        chart, seen.names, len(seen.values), spectra, layout, notes
    )
    values, signals = seen.values[camera_rows], spectra.signals[spectrum_rows]
    stddev = None if seen.stddev is None else seen.stddev[camera_rows]
    clipped = None if seen.clipped is None else seen.clipped[camera_rows]
    lamp = spectra.illuminant
    if lamp is None:
        lamp = illuminant_of_patches(chart, names, signals, wavelength_nm, notes)
    asked = ~_excluded(names, excluded, layout, chart)
    rows = np.flatnonzero(asked)
    check = check_patches(
        chart.where,
        [names[row] for row in rows],
        values[rows],
        signals[rows],
        layout=layout,
        stddev=None if stddev is None else stddev[rows],
        clipped=None if clipped is None else clipped[rows],
        notes=notes,
    )
    kept = rows[check.keep]
    return UsedPatches(
        where=chart.where,
        light_class=chart.light_class,
        names=tuple(names[row] for row in kept),
        camera_values=values[kept],
        camera_stddev=None if stddev is None else stddev[kept],
        signals=signals[kept],
        illuminant=lamp,
        left_out=tuple(name for row, name in enumerate(names) if row not in set(kept)),
    )


def _seen(
    chart: ColorChart,
    layout: Layout | None,
    spectra: Spectra,
    darkroom: Darkroom,
    notes: list[Note],
) -> _Seen:
    """Return stated camera values, or those of a picture."""
    if chart.camera_values is not None:
        return _Seen(chart.patches, chart.camera_values)
    if chart.camera_values_file is not None:
        return _Seen(*read_camera_values(chart.camera_values_file))
    if chart.image_file is None and chart.view is None:
        raise LayerError(
            f"{chart.where}: has no camera values; set chart:cameraValues, "
            "chart:cameraValues:file, chart:view (photographs) or chart:image:file"
        )
    if layout is None:
        raise LayerError(
            f"{chart.where}: chart:layout is not set, so where the patches are in the picture is "
            f"not known; use one of {', '.join(LAYOUTS)}, or give chart:cameraValues"
        )
    # A picture in camera values needs no kernels.
    workers = darkroom.workers or Workers("cpu", 1)
    picture = develop(chart, workers, darkroom.scratch, darkroom.progress, notes)
    if chart.corners is None:
        found = find_corners(
            picture.values,
            layout,
            _in_layout(chart, layout, spectra),
            variance=picture.variance,
            status=picture.status,
            lens=picture.lens,
            where=chart.where,
        )
        place = ", ".join(f"{x:.1f},{y:.1f}" for x, y in found.corners)
        text = f"found in its picture, {found.orientation}, with the corners {place}"
        notes.append(Note("chart-found", chart.where, text))
        samples = found.samples
    else:
        samples = sample_patches(
            picture.values,
            picture.variance,
            picture.status,
            layout,
            chart.corners,
            picture.lens,
            where=chart.where,
        )
    return _Seen(samples.names, samples.values, samples.stddev, samples.clipped)


def _in_layout(chart: ColorChart, layout: Layout, spectra: Spectra) -> FloatArray:
    """Return the radiance of every patch of a layout, which finding a chart needs."""
    count = len(layout.names)
    if spectra.names is None and len(spectra.signals) == count:
        return spectra.signals
    rows: dict[int | None, int] = {}
    if spectra.names is not None:
        rows = {layout.index(name): row for row, name in enumerate(spectra.names)}
    if not all(index in rows for index in range(count)):
        raise LayerError(
            f"{chart.where}: to find the chart in its picture a spectrum of each of its {count} "
            "patches is needed, by name; give its corners by chart:corners or --corners"
        )
    return np.stack([spectra.signals[rows[index]] for index in range(count)])


def _excluded(
    names: tuple[str, ...], excluded: tuple[str, ...], layout: Layout | None, chart: ColorChart
) -> NDArray[np.bool_]:
    mask = np.zeros(len(names), bool)
    for name in excluded:
        meant = name
        if layout is not None and (index := layout.index(name)) is not None:
            meant = layout.names[index]
        if meant not in names:
            raise UsageError(
                f"--exclude {name}: {chart.where} has no such patch; it has {', '.join(names[:6])}"
                + (", ..." if len(names) > 6 else "")
            )
        mask[names.index(meant)] = True
    return mask
