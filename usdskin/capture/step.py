"""Make one panorama of a shoot.

Reads:  ``shoot.usda`` (``CaptureAPI`` over Cameras with ``FisheyeCameraAPI`` and
        ``ExposureBracketAPI``) and the photographs it names.
Writes: ``capture.usda`` (``CaptureAPI``, a DomeLight and the views as they were used), and beside
        it ``panorama.exr``, ``stddev.exr`` and the picture ``quality.png``.

Views are merged, placed and let go one after another, so that memory holds one of them.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin import compilation
from usdskin.capture.publish import Publication, output_files, publish
from usdskin.capture.quality.measure import PlacedView, measure
from usdskin.capture.quality.report import CaptureReport
from usdskin.capture.views.align import Alignment, align_views, reduce_view
from usdskin.capture.views.panorama import Compositor, Panorama
from usdskin.device import Workers, open_workers
from usdskin.errors import UsageError
from usdskin.fisheye import check_lens, scaled
from usdskin.latlong import latlong_from_world
from usdskin.layers import check_output, open_stage, used_files
from usdskin.notes import Note
from usdskin.photographs.development import find_responses
from usdskin.photographs.glare import find_glare, subtract_glare
from usdskin.photographs.merge import MergedView, MergeReport, merge_bracket
from usdskin.prims import FisheyeLens, Shoot, View, read_shoot
from usdskin.progress import Progress, SilentProgress
from usdskin.replacing import scratch_beside
from usdskin.warp_kernels import bracket as bracket_kernels
from usdskin.warp_kernels import panorama as panorama_kernels

FloatArray = NDArray[np.float64]

_SMALLEST, _LARGEST = 256, 8192
"""Width of a panorama that nobody asked for [px]."""


@dataclass(frozen=True, slots=True)
class CaptureOptions:
    """What the step is told."""

    width: int | None = None
    """Columns of the panorama; None: what the lens resolves."""

    refine_rotations: bool = False
    """Turn the views so that they agree where they overlap."""

    measured_exposures: bool = False
    """Use the ratios of exposures that the photographs show, not the stated ones."""

    glare: float | None = None
    """Share of the light spread evenly; None: what each lens says, or where it says 0 what shows
    beyond the image circle."""

    lamps: tuple[tuple[str, float], ...] = ()
    """Names of clipped lamps (``lamp1`` has the largest flux; empty: the only one) and the
    illuminance of a surface facing them [lx]."""

    device: str = "auto"
    """``auto``, ``cpu`` or ``cuda:N``."""

    threads: int | None = None
    """CPU threads; all cores when None."""


@dataclass(frozen=True, slots=True, eq=False)
class CaptureResult:
    """What the step did."""

    paths: tuple[Path, ...]
    """Files written, the layer first."""

    report: CaptureReport
    """What was measured."""

    notes: list[Note]
    """What could not be honoured or needs attention."""

    seconds: dict[str, float]
    """Time each part took [s]."""


def capture_shoot(
    shoot: str | Path,
    output: str | Path,
    options: CaptureOptions | None = None,
    progress: Progress | None = None,
) -> CaptureResult:
    """Make the panorama of one shoot, and say how right it is.

    Args:
        shoot: Layer with the views and their photographs. It is read, never changed.
        output: Layer to write; the panorama and the quality picture are written beside it.
        options: What is asked for.
        progress: Told how far the work is.

    Returns:
        The files, complete on disk, the report and the notes.

    Raises:
        LayerError: The shoot lacks something or contradicts its photographs, or the output cannot
            be written.
        ImageError: A photograph cannot be read.
        UsageError: An option does not fit what was photographed.
        DeviceError: There is no such device.
    """
    options = options or CaptureOptions()
    progress = progress or SilentProgress()
    shoot, output = Path(shoot), Path(output)
    notes: list[Note] = []
    clock = _Clock()
    stage = open_stage(shoot, notes)
    described = _with_glare(read_shoot(stage), options.glare)
    layers = used_files(stage)
    photographs = [image for view in described.views for image in view.bracket.images]
    check_output(output, [*layers, *photographs], output_files(output), step="capture")
    workers = open_workers(options.device, options.threads)
    compilation.prepare((panorama_kernels, bracket_kernels), workers.device, progress)
    with scratch_beside(output) as scratch:
        placed, panorama, alignment = _compose(
            described, options, workers, scratch, progress, notes, clock
        )
        if not options.refine_rotations:
            alignment = replace(alignment, rotations=_stated(described))
        with clock("measure"):
            measured = measure(
                described,
                placed,
                panorama,
                alignment,
                options.refine_rotations,
                options.lamps,
                notes,
            )
        with clock("write"):
            publication = Publication(
                shoot=described,
                placed=placed,
                rotations=alignment.rotations,
                panorama=panorama,
                measured=measured,
                inputs=layers,
                settings=_settings(options),
            )
            paths = publish(publication, output, scratch)
    return CaptureResult(paths, measured.report, notes, clock.seconds)


# --- Before ------------------------------------------------------------------------------------


def _with_glare(shoot: Shoot, glare: float | None) -> Shoot:
    if glare is None:
        return shoot
    return replace(
        shoot,
        views=tuple(replace(view, lens=replace(view.lens, glare=glare)) for view in shoot.views),
    )


class _Clock:
    """Adds up the time of named parts."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def __call__(self, part: str) -> Iterator[None]:
        began = time.perf_counter()
        try:
            yield
        finally:
            self.seconds[part] = self.seconds.get(part, 0.0) + time.perf_counter() - began


def _stated(shoot: Shoot) -> FloatArray:
    """Return the rotations from the cameras to the panorama, shape [views, 3, 3]."""
    turn = latlong_from_world(shoot.up_axis)
    return np.stack([turn @ view.rotation for view in shoot.views])


def _height(lenses: list[FisheyeLens], width: int | None) -> int:
    """Return the rows: those asked for, or the power of two just below what the lens resolves."""
    if width is not None:
        if width % 2:
            raise UsageError(
                f"--width {width}: a panorama is twice as wide as high; give an even one"
            )
        return width // 2
    turn = 2.0 * math.pi * max(lens.focal_length_px for lens in lenses)
    wide = 1 << max(math.floor(math.log2(turn)), 0)
    return min(max(wide, _SMALLEST), _LARGEST) // 2


# --- Views -------------------------------------------------------------------------------------


def _compose(
    shoot: Shoot,
    options: CaptureOptions,
    workers: Workers,
    scratch: Path,
    progress: Progress,
    notes: list[Note],
    clock: _Clock,
) -> tuple[list[PlacedView], Panorama, Alignment]:
    """Merge and place every view.

    Refined rotations are known only when all views are merged: until then they lie on disk.
    """
    with clock("response"):
        responses = find_responses(shoot, scratch, notes)
    height = _height([view.lens for view in shoot.views], options.width)
    compositor = Compositor(height, workers, progress)
    stated = _stated(shoot)
    placed = []
    for view, rotation in zip(shoot.views, stated, strict=True):
        with clock("merge"):
            merged = merge_bracket(
                view,
                workers,
                scratch,
                responses.get(view.name),
                progress,
                notes,
                measured_exposures=options.measured_exposures,
            )
            item = _place(view, rotation, merged, options.glare is None, notes)
        placed.append(item)
        if options.refine_rotations:
            _keep(merged, scratch / view.name)
        else:
            with clock("compose"):
                _add(compositor, item, rotation, merged)
        del merged
    with clock("align"):
        alignment = align_views([item.small for item in placed], notes)
    if options.refine_rotations:
        for item, rotation in zip(placed, alignment.rotations, strict=True):
            with clock("compose"):
                _add(compositor, item, rotation, _kept(scratch / item.view.name, item.merge))
    with clock("compose"):
        return placed, compositor.finish(), alignment


def _place(
    view: View, rotation: FloatArray, merged: MergedView, finds_glare: bool, notes: list[Note]
) -> PlacedView:
    """Subtract the glare, in place, and keep what the alignment needs."""
    height, width = merged.status.shape
    lens = scaled(view.lens, (width, height), view.where)
    check_lens(lens, view.where)
    if finds_glare and lens.glare == 0.0:
        glare = find_glare(merged.values, merged.variance, lens, view.where, notes)
        lens = replace(lens, glare=glare)
    subtract_glare(merged.values, merged.variance, lens)
    small = reduce_view(view.name, lens, rotation, merged.values, merged.status)
    return PlacedView(view, lens, merged.report, small)


def _add(
    compositor: Compositor, item: PlacedView, rotation: FloatArray, merged: MergedView
) -> None:
    compositor.add_view(
        item.lens, rotation, merged.values, merged.variance, merged.status, name=item.view.where
    )


_KEPT = ("values", "variance", "status")


def _keep(merged: MergedView, stem: Path) -> None:
    for name in _KEPT:
        np.save(f"{stem}.{name}.npy", getattr(merged, name))


def _kept(stem: Path, report: MergeReport) -> MergedView:
    files = [Path(f"{stem}.{name}.npy") for name in _KEPT]
    values, variance, status = (np.load(file) for file in files)
    for file in files:
        os.unlink(file)
    return MergedView(values, variance, status, report)


def _settings(options: CaptureOptions) -> dict[str, Any]:
    """Return what was asked for, as the provenance records it."""
    lamps = [f"{name or 'lamp1'}={lux:g}" for name, lux in options.lamps]
    given = {
        "width": options.width,
        "refineRotations": options.refine_rotations,
        "measuredExposures": options.measured_exposures,
        "glare": options.glare,
        "lampIlluminance": lamps or None,
    }
    return {name: value for name, value in given.items() if value is not None}
