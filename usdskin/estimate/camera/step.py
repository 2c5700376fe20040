"""Calibrate a camera against spectra.

Reads:  chart layers (``ColorChartAPI``): camera values or photographs of patches, and their
        spectra; one chart for each class of light.
Writes: ``camera.usda`` (``SpectralCameraAPI``, ``SpectralRecoveryAPI:<class>``), with the patches
        as they were used below it, so that it stands alone.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.device import open_workers
from usdskin.errors import LayerError, UsageError
from usdskin.estimate.camera.patches import Darkroom, UsedPatches, read_patches
from usdskin.estimate.chart.layouts import LAYOUTS
from usdskin.estimate.recovery import (
    Training,
    estimate_responsivity,
    in_one_unit,
    recover,
    without_stray_light,
)
from usdskin.layers import check_output, open_stage, record_provenance, used_files, write_layer
from usdskin.notes import Note
from usdskin.prims import (
    ColorChart,
    Recovery,
    SpectralCamera,
    read_color_charts,
    write_spectral_camera,
)
from usdskin.progress import Progress, SilentProgress
from usdskin.replacing import scratch_beside
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom

FloatArray = NDArray[np.float64]

CAMERA_PATH = "/Camera"


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationOptions:
    """What the step is told."""

    estimator: str = "regression"
    """One of ``usdskin.estimate.recovery.ESTIMATORS``."""

    corners: FloatArray | None = None
    """Corners of the chart in its picture [px], shape [4, 2]; None: those of the layer."""

    excluded: tuple[str, ...] = ()
    """Patches to leave out."""

    device: str = "auto"
    """Where photographs are merged: ``auto``, ``cpu`` or ``cuda:N``."""

    threads: int | None = None
    """CPU threads; all cores when None."""


@dataclass(frozen=True, slots=True, eq=False)
class CalibrationResult:
    """What the step did."""

    path: Path
    """The layer written."""

    camera: SpectralCamera
    """What is in it."""

    used: tuple[UsedPatches, ...]
    """The patches of each class of light, and what was left out."""

    notes: list[Note]
    """What was assumed or needs attention."""

    seconds: dict[str, float]
    """Time each part took [s]."""


def calibrate_camera(
    charts: Sequence[str | Path],
    output: str | Path,
    options: CalibrationOptions | None = None,
    progress: Progress | None = None,
) -> CalibrationResult:
    """Calibrate a camera from one chart, or from one for each class of light.

    Args:
        charts: Layers with ``ColorChartAPI``. They are read, never changed.
        output: Layer to write.
        options: What is asked for.
        progress: Told how far photographs are.

    Returns:
        The layer, complete on disk, and what is in it.

    Raises:
        LayerError: A chart lacks something or contradicts itself, too few patches can be used, or
            the output cannot be written.
        ImageError: A photograph cannot be read.
        UsageError: An option does not fit the charts.
        DeviceError: There is no such device.
    """
    options = options or CalibrationOptions()
    output = Path(output)
    notes: list[Note] = []
    began = time.perf_counter()
    described, layers = _read_charts(charts, notes)
    check_output(output, layers, step="calibration")
    _check_together(described, options)
    grid = DEFAULT_WAVELENGTHS_NM
    used = _used(described, grid, output, options, progress or SilentProgress(), notes)
    read = time.perf_counter()
    camera = _calibrate(described, used, grid, options.estimator, notes)
    done = time.perf_counter()
    _write(camera, output, layers, options)
    seconds = {"patches": read - began, "calibrate": done - read}
    seconds["write"] = time.perf_counter() - done
    return CalibrationResult(output, camera, used, notes, seconds)


# --- Before ------------------------------------------------------------------------------------


def _read_charts(
    paths: Sequence[str | Path], notes: list[Note]
) -> tuple[list[ColorChart], list[Path]]:
    charts: list[ColorChart] = []
    layers: list[Path] = []
    for path in paths:
        stage = open_stage(path, notes)
        charts += read_color_charts(stage)
        layers += used_files(stage)
    return charts, list(dict.fromkeys(layers))


_SETTINGS = {
    "model": "chart:settings:model",
    "lens": "chart:settings:lens",
    "white_balance": "chart:settings:whiteBalance",
    "units": "chart:units",
}


def _check_together(charts: list[ColorChart], options: CalibrationOptions) -> None:
    """Refuse charts that one calibration cannot hold."""
    first = charts[0]
    for chart in charts[1:]:
        for field, name in _SETTINGS.items():
            mine, other = getattr(chart, field), getattr(first, field)
            if mine != other:
                raise LayerError(
                    f'{chart.where}: {name} is "{mine}", but that of {first.where} is "{other}"; '
                    "one calibration is of one camera, as it was set"
                )
        if (chart.iso is None) != (first.iso is None):
            raise LayerError(
                f"{chart.where}: only one of it and {first.where} states chart:settings:iso; state "
                "it in both or in neither"
            )
    classes = [chart.light_class for chart in charts]
    twice = next((name for name in classes if classes.count(name) > 1), None)
    if twice:
        places = " and ".join(chart.where for chart in charts if chart.light_class == twice)
        raise LayerError(
            f'{places}: both are of the light class "{twice}"; give each its own chart:lightClass'
        )
    if options.corners is not None and len(charts) > 1:
        raise UsageError(
            f"--corners: there are {len(charts)} charts; author chart:corners in each layer instead"
        )


def _used(
    charts: list[ColorChart],
    grid: FloatArray,
    output: Path,
    options: CalibrationOptions,
    progress: Progress,
    notes: list[Note],
) -> tuple[UsedPatches, ...]:
    workers = None
    if any(chart.view is not None for chart in charts):
        workers = open_workers(options.device, options.threads)
    if options.corners is not None:
        charts = [replace(chart, corners=options.corners) for chart in charts]
    with scratch_beside(output) as folder:
        darkroom = Darkroom(workers, folder, progress)
        return tuple(
            read_patches(chart, grid, darkroom, options.excluded, notes) for chart in charts
        )


# --- The calibration -----------------------------------------------------------------------------


def _calibrate(
    charts: list[ColorChart],
    used: tuple[UsedPatches, ...],
    grid: FloatArray,
    estimator: str,
    notes: list[Note],
) -> SpectralCamera:
    trainings: Sequence[Training] = [_training(item, grid) for item in used]
    try:
        if charts[0].units == "relative":
            trainings = in_one_unit(trainings)
        trainings, stray = without_stray_light(trainings)
        responsivity = estimate_responsivity(trainings)
        recoveries = tuple(recover(item, responsivity, estimator) for item in trainings)
    except ValueError as error:
        where = " and ".join(chart.where for chart in charts)
        raise LayerError(f"{where}: cannot be calibrated from: {error}") from None
    for chart, recovery, training, offset in zip(charts, recoveries, trainings, stray, strict=True):
        _note_stray_light(chart, training, offset, notes)
        _note_doubts(chart, recovery, notes)
    settings = [chart.iso for chart in charts if chart.iso is not None]
    return SpectralCamera(
        where=CAMERA_PATH,
        wavelength_nm=grid,
        responsivity=responsivity.values,
        noise=responsivity.noise,
        recoveries=recoveries,
        units=charts[0].units,
        model=charts[0].model,
        lens=charts[0].lens,
        white_balance=charts[0].white_balance,
        iso=np.unique(np.concatenate(settings)) if settings else None,
        charts=tuple(
            _chart_as_used(chart, item, training.camera_values, grid)
            for chart, item, training in zip(charts, used, trainings, strict=True)
        ),
    )


def _training(used: UsedPatches, grid: FloatArray) -> Training:
    try:
        return Training(
            patches=used.names,
            camera_values=used.camera_values,
            signals=used.signals,
            wavelength_nm=grid,
            illuminant=used.illuminant,
            camera_stddev=used.camera_stddev,
            light_class=used.light_class,
        )
    except ValueError as error:
        raise LayerError(f"{used.where}: cannot be calibrated from: {error}") from None


_DOUBTFUL_GFC = 0.9


def _note_doubts(chart: ColorChart, recovery: Recovery, notes: list[Note]) -> None:
    if recovery.loo_gfc < _DOUBTFUL_GFC:
        notes.append(
            Note(
                "poor-recovery",
                chart.where,
                f"recovered spectra fit the measured ones with a GFC of {recovery.loo_gfc:.3f} "
                f"only and a dE2000 of {recovery.loo_delta_e_2000:.1f} (each patch left out); "
                + (
                    "the estimator literal is there for comparison: leave it out for the default"
                    if recovery.estimator == "literal"
                    else "check that camera values and spectra are of the same light and patches"
                ),
            )
        )


def _note_stray_light(
    chart: ColorChart, training: Training, offset: FloatArray, notes: list[Note]
) -> None:
    if offset.any():
        share = 100.0 * offset / training.camera_values.max(axis=0)
        notes.append(
            Note(
                "stray-light",
                chart.where,
                f"all patches have {share[0]:.2f}, {share[1]:.2f} and {share[2]:.2f} % of the "
                "lightest one's R, G and B too much for their spectra, as glare gives; it is "
                "subtracted",
            )
        )


def _chart_as_used(
    chart: ColorChart, used: UsedPatches, camera_values: FloatArray, grid: FloatArray
) -> ColorChart:
    """Return the patches that went into a calibration, in the layer itself."""
    return ColorChart(
        name=chart.name or (LAYOUTS[chart.layout].name if chart.layout else ""),
        layout=chart.layout,
        light_class=used.light_class,
        patches=used.names,
        camera_values=camera_values,
        wavelength_nm=grid,
        signals=np.maximum(used.signals, 0.0),
        illuminant=Spectrum(
            SpectralQuantity.RADIANCE if chart.units == "absolute" else SpectralQuantity.RELATIVE,
            grid,
            used.illuminant,
        ),
        units=chart.units,
        model=chart.model,
        lens=chart.lens,
        white_balance=chart.white_balance,
        iso=chart.iso,
    )


def _write(
    camera: SpectralCamera, output: Path, layers: list[Path], options: CalibrationOptions
) -> None:
    stage = Usd.Stage.CreateInMemory("camera.usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetDefaultPrim(write_spectral_camera(stage, CAMERA_PATH, camera))
    settings: dict[str, Any] = {"estimator": options.estimator}
    if options.corners is not None:
        settings["corners"] = [float(number) for number in np.ravel(options.corners)]
    if options.excluded:
        settings["excluded"] = list(options.excluded)
    record_provenance(stage, "calibrateCamera", layers, settings, output.parent)
    write_layer(stage, output)
