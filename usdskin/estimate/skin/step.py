"""Estimate skin from readings or photographs.

Reads:  ``samples.usda`` (``SkinSampleAPI``): goniometric readings, or photographs with the geometry
        of their pixels; the camera's calibration; a spectrophotometer's reflectance.
Writes: ``skin.usda``, a Material with ``SkinMaterialAPI`` and the fit it came from.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from usdskin.device import open_workers
from usdskin.errors import LayerError, UsageError
from usdskin.estimate.skin.fit import FitOptions, SkinFit, fit_skin
from usdskin.estimate.skin.inputs import Columns, columns_of, read_samples, recovery_of
from usdskin.estimate.skin.photographs import sample_photographs
from usdskin.estimate.skin.publish import publish_skin
from usdskin.estimate.skin.readings import Readings
from usdskin.estimate.skin.report import SkinReport
from usdskin.estimate.skin.spectra import measured_reflectance, spectra_of_fit
from usdskin.estimate.skin.spectra_of_channels import SkinSpectra
from usdskin.layers import check_output, open_stage, used_files
from usdskin.notes import Note
from usdskin.prims import SkinSamples, read_skin_samples
from usdskin.progress import Progress, SilentProgress
from usdskin.replacing import scratch_beside


@dataclass(frozen=True, slots=True)
class SkinOptions:
    """What the step is told."""

    specular: Literal["none", "fit", "ignore"] = "none"
    """``none``: readings with lustre are refused; ``fit``: it is fitted; ``ignore``: it is known to
    be absent."""

    wrap: float | None = None
    """l where it is known [1]."""

    scattering: float | None = None
    """Ss where it is known [1]."""

    opacity: Literal["none", "fit"] = "none"
    """Whether delta is fitted, from readings through known thicknesses."""

    device: str = "auto"
    """Where photographs are merged: ``auto``, ``cpu`` or ``cuda:N``."""

    threads: int | None = None
    """CPU threads; all cores when None."""


@dataclass(frozen=True, slots=True, eq=False)
class SkinResult:
    """What the step did."""

    path: Path
    """The layer written."""

    fit: SkinFit
    """What was fitted."""

    spectra: SkinSpectra
    """What is in the layer."""

    report: SkinReport
    """The same, for people and programs."""

    notes: list[Note]
    """What limits the trust in it."""

    seconds: dict[str, float]
    """Time each part took [s]."""


def estimate_skin(
    source: str | Path,
    output: str | Path,
    options: SkinOptions | None = None,
    progress: Progress | None = None,
) -> SkinResult:
    """Fit a skin material to readings or photographs.

    Args:
        source: Layer with ``SkinSampleAPI``. It is read, never changed.
        output: Layer to write.
        options: What is asked for.
        progress: Told how far photographs are.

    Returns:
        The layer, complete on disk, and what is in it.

    Raises:
        LayerError: The samples lack something, contradict themselves or cannot tell what is asked.
        ImageError: A photograph or its geometry cannot be read.
        UsageError: An option does not fit the samples.
        DeviceError: There is no such device.
    """
    options = options or SkinOptions()
    source, output = Path(source), Path(output)
    notes: list[Note] = []
    began = time.perf_counter()
    stage = open_stage(source, notes)
    layers = used_files(stage)
    check_output(output, layers, step="estimate")
    samples = read_skin_samples(stage)
    measured = measured_reflectance(samples, notes)
    readings, columns, shared = _readings(
        samples, output, options, progress or SilentProgress(), notes
    )
    read = time.perf_counter()
    try:
        fit = fit_skin(readings, _fit_options(options), notes)
    except ValueError as error:
        raise UsageError(f"{samples.where}: {error}") from None
    spectra = spectra_of_fit(fit, columns, measured, samples.where, notes)
    done = time.perf_counter()
    settings: dict[str, Any] = {"specular": options.specular, "opacity": options.opacity}
    known = {"wrap": options.wrap, "scattering": options.scattering}
    settings |= {name: value for name, value in known.items() if value is not None}
    publish_skin(fit, spectra, readings, columns, output, layers, settings)
    seconds = {"readings": read - began, "fit": done - read, "write": time.perf_counter() - done}
    report = SkinReport(fit, spectra, readings.names, columns.camera is not None, shared)
    return SkinResult(output, fit, spectra, report, notes, seconds)


def _readings(
    samples: SkinSamples,
    output: Path,
    options: SkinOptions,
    progress: Progress,
    notes: list[Note],
) -> tuple[Readings, Columns, float]:
    """Return readings, their columns, and what their errors were widened by."""
    photographed = bool(samples.images or samples.views)
    if not photographed:
        return *read_samples(samples), 1.0
    if samples.values is not None or samples.values_file is not None:
        raise LayerError(f"{samples.where}: has readings and photographs; put them into two layers")
    columns = _photographed_columns(samples)
    with scratch_beside(output) as folder:
        found = sample_photographs(
            samples,
            open_workers(options.device, options.threads),
            folder,
            progress,
            notes,
            gloss="mask" if options.specular == "none" else "keep",
        )
    return found.readings, columns, found.shared


def _photographed_columns(samples: SkinSamples) -> Columns:
    """Return what the channels of photographs are: those of the camera, in the lights' spectrum."""
    if samples.camera is None:
        raise LayerError(
            f"{samples.where}: photographs need samples:camera, a Camera that `usdskin calibrate "
            "camera` wrote, to become spectra"
        )
    emission = None
    if samples.lights and samples.lights[0].spectral is not None:
        emission = samples.lights[0].spectral.emission
    if emission is None:
        return columns_of(samples, 3)
    grid = samples.camera.wavelength_nm
    # The lights tell their spectrum; a class that is named all the same has to be known.
    if samples.light_class:
        recovery_of(samples, samples.camera)
    return Columns(grid, samples.camera, emission.resample(grid))


def _fit_options(options: SkinOptions) -> FitOptions:
    return FitOptions(
        # Near the mirror direction photographs were masked already; what is left has no lustre.
        specular=options.specular,
        wrap=options.wrap,
        scattering=options.scattering,
        delta=options.opacity,
    )
