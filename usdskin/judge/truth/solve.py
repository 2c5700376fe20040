"""The true light of a virtual set, by radiosity and quadrature in float64.

    solve_set(path, output, height=256, ...) -> SolvedSet

It shares nothing with the renderer but the reading of prims: no Warp, no kernels.

Reads:  ``set.usda`` (docs/sets.md).
Writes: ``light.usda``, what the capture point sees, and for a set with several light classes
        ``light_<class>.usda``, the same in the light of one of them.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.judge.truth import lamps as set_lamps
from usdskin.judge.truth.geometry import is_open
from usdskin.judge.truth.layers import SeenLight, light_files, write_light
from usdskin.judge.truth.panorama import Panorama, see
from usdskin.judge.truth.radiosity import Model, Solution, make_model, solve
from usdskin.judge.truth.sets import read_set
from usdskin.latlong import texel_solid_angles
from usdskin.layers import check_output, named_files
from usdskin.notes import Note
from usdskin.progress import Progress, SilentProgress
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

FloatArray = NDArray[np.float64]
Form = Literal["basis", "bands"]

DEFAULT_CELLS = 1500
_LEAST_ROWS, _MOST_ROWS = 8, 4096


@dataclass(frozen=True, slots=True, eq=False)
class SolveReport:
    """What was found."""

    cells: int
    """How many cells the surfaces were cut into."""

    is_closed: bool
    """Whether no ray leaves the set."""

    balance: dict[str, float]
    """Of a closed set, for each class: flux absorbed over flux emitted, less 1."""

    lamp_error: float
    """Largest error of a lamp's solid angle in the picture, relative, of lamps in full sight."""

    ranks: dict[str, int]
    """Rank of every layer's basis, by file name; 0 for bands."""

    def as_dict(self) -> dict[str, Any]:
        """Return the values by name, for JSON."""
        return {
            "cells": self.cells,
            "closed": self.is_closed,
            "balance": self.balance,
            "lampError": self.lamp_error,
            "ranks": self.ranks,
        }

    def lines(self) -> list[str]:
        """Return the values as lines for people."""
        kind = "closed" if self.is_closed else "open"
        lines = [f"{self.cells} cells, {kind}; lamps' flux within {100 * self.lamp_error:.2g} %"]
        for name, value in self.balance.items():
            lines.append(f"{name}: flux absorbed is {100 * value:+.2g} % off the flux emitted")
        lines += [f"{name}: {rank} spectra" for name, rank in self.ranks.items() if rank]
        return lines


@dataclass(frozen=True, slots=True, eq=False)
class SolvedSet:
    """What was written."""

    light: Path
    """The light of all classes."""

    classes: dict[str, Path]
    """A layer for each class; of a set with one class that is ``light``."""

    report: SolveReport
    paths: list[Path]
    """All files."""

    notes: list[Note] = field(default_factory=list)
    seconds: dict[str, float] = field(default_factory=dict)


def solve_set(
    path: str | Path,
    output: str | Path,
    *,
    height: int = 256,
    cells: int = DEFAULT_CELLS,
    form: Form = "basis",
    wavelength_nm: FloatArray | None = None,
    progress: Progress | None = None,
    notes: list[Note] | None = None,
) -> SolvedSet:
    """Write the true light of a set at its capture point.

    Args:
        path: The set's layer.
        output: Layer to write; its folder is made. Pictures and the layers of single classes are
            written beside it.
        height: Rows of the pictures; there are twice as many columns.
        cells: Cells that the surfaces are cut into, about.
        form: ``basis``, or ``bands`` for all spectra written out.
        wavelength_nm: Band centres [nm], shape [band_count]; the default grid where None.
        progress: Told how far the work is.
        notes: Takes what could not be honoured.

    Raises:
        LayerError: The set cannot be read or used, or a layer not be written.
        ImageError: A picture cannot be read or written.
        UsageError: A number is out of range, or the output is an input.
    """
    path, output = Path(path), Path(output)
    progress, notes = progress or SilentProgress(), [] if notes is None else notes
    _check(height, cells)
    nm = DEFAULT_WAVELENGTHS_NM if wavelength_nm is None else np.asarray(wavelength_nm, np.float64)
    began = time.perf_counter()
    scene = read_set(path, nm, notes)
    layers = _layers(output, scene.classes)
    inputs = sorted(named_files(path))
    for layer in {output, *layers.values()}:
        check_output(layer, inputs, light_files(layer, form), step="solution")
    seconds = {"read": time.perf_counter() - began}
    try:
        began = time.perf_counter()
        model = make_model(scene, cells)
        progress.start(2 * model.surface_count, "radiosity")
        solutions, is_closed = solve(model, progress.advance)
        seconds["radiosity"] = time.perf_counter() - began
        began = time.perf_counter()
        progress.start(2 * height * height, "panorama")
        seen = see(model, solutions, height, progress.advance)
        seconds["panorama"] = time.perf_counter() - began
    finally:
        progress.done()
    began = time.perf_counter()
    settings = {"height": height, "cells": cells, "as": form}
    ranks, paths = {}, []
    everything = {output: tuple(scene.classes), **{layers[name]: (name,) for name in layers}}
    for layer, classes in everything.items():
        light = _light(model, seen, classes)
        text = f"Solved, not measured: the light of {path.name} at its capture point"
        text += f", of the class {classes[0]} alone." if len(classes) < len(scene.classes) else "."
        rank = write_light(light, layer, form, [path], {**settings, "classes": classes}, text)
        ranks[layer.name] = rank
        paths += [layer, *light_files(layer, form)]
    seconds["write"] = time.perf_counter() - began
    report = SolveReport(
        cells=model.cells.count,
        is_closed=is_closed,
        balance=_balance(solutions) if is_closed else {},
        lamp_error=_lamp_error(model, seen, height),
        ranks=ranks,
    )
    by_class = layers or {scene.classes[0]: output}
    return SolvedSet(output, by_class, report, paths, notes, seconds)


def _check(height: int, cells: int) -> None:
    if not _LEAST_ROWS <= height <= _MOST_ROWS:
        raise UsageError(f"height is {height}; give {_LEAST_ROWS} to {_MOST_ROWS} rows")
    if not 50 <= cells <= 8000:
        raise UsageError(f"cells are {cells}; give 50 to 8000")


def _layers(output: Path, classes: tuple[str, ...]) -> dict[str, Path]:
    """Return the layers of single classes; none where there is one class only."""
    if len(classes) < 2:
        return {}
    return {name: output.with_name(f"{output.stem}_{name}{output.suffix}") for name in classes}


def _light(model: Model, seen: Panorama, classes: tuple[str, ...]) -> SeenLight:
    scene = model.scene
    covered = sum(seen.lamp_cover, np.zeros(next(iter(seen.classes.values())).shape[:2]))
    suns = [
        (replace(sun), share)
        for sun, share in zip(scene.suns, seen.sun_shares, strict=True)
        if scene.class_of[sun.path] in classes
    ]
    return SeenLight(
        radiance=np.sum([seen.classes[name] for name in classes], axis=0),
        reflected=np.asarray(covered == 0.0),
        suns=suns,
        wavelength_nm=scene.wavelength_nm,
        up_axis=scene.up_axis,
    )


def _balance(solutions: dict[str, Solution]) -> dict[str, float]:
    result = {}
    for name, solution in solutions.items():
        emitted = float(solution.balance.emitted.sum())
        if emitted > 0.0:
            result[name] = float(solution.balance.absorbed.sum()) / emitted - 1.0
    return result


def _lamp_error(model: Model, seen: Panorama, height: int) -> float:
    """Return the largest relative error of lamps' solid angles, of those in full sight."""
    size = texel_solid_angles(height, 2 * height)[:, None]
    worst = 0.0
    for lamp, cover in zip(model.scene.lamps, seen.lamp_cover, strict=True):
        true = set_lamps.solid_angle(lamp, model.scene.capture_point)
        places, _ = set_lamps.targets(lamp)
        planes = model.surfaces.planes()
        if true > 0.0 and is_open(planes, model.scene.capture_point[None], places).all():
            worst = max(worst, abs(float((cover * size).sum()) / true - 1.0))
    return worst
