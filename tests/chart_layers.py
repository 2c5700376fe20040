"""Charts with known camera values and spectra, and the layers that hold them."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import colour
import numpy as np
from numpy.typing import NDArray

from usdskin.illuminants import illuminant
from usdskin.judge.shoot.sensitivity import read_sensitivity
from usdskin.layers import write_layer
from usdskin.prims import ColorChart, write_color_chart
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, band_widths, resample

# isort: split
from pxr import Usd, UsdGeom

FloatArray = NDArray[np.float64]

GRID = DEFAULT_WAVELENGTHS_NM
CAMERA = "Nikon 5100 (NPL)"


def reflectances(name: str = "ColorChecker N Ohta") -> tuple[tuple[str, ...], FloatArray]:
    """Return names and reflectances of a chart of colour-science on the default grid."""
    chart = colour.SDS_COLOURCHECKERS[name]
    rows = [resample(one.wavelengths, one.values, GRID, outside="hold") for one in chart.values()]
    return tuple(str(patch) for patch in chart), np.stack(rows)


def sensitivity(name: str = CAMERA) -> FloatArray:
    """Return t of a camera, band widths included, shape [61, 3]."""
    camera = read_sensitivity(name)
    bands = resample(camera.wavelength_nm, camera.value.T, GRID).T
    return np.asarray(bands * band_widths(GRID)[:, None])


def seen_chart(lamp: str = "FL2", noise: float = 0.01, seed: int = 0) -> ColorChart:
    """Return the ColorChecker in a lamp, as camera and spectrophotometer see it."""
    names, surface = reflectances()
    light = illuminant(lamp, GRID) * 1e-4
    signals = surface * light
    random = np.random.default_rng(seed)
    values = signals @ sensitivity() * (1.0 + noise * random.normal(size=(len(names), 3)))
    return ColorChart(
        name="ColorChecker Classic",
        layout="classic24",
        light_class="lamp",
        patches=names,
        camera_values=values * 1e-3,
        wavelength_nm=GRID,
        signals=signals * (1.0 + 0.3 * noise * random.normal(size=signals.shape)),
        units="absolute",
        model="Nikon D5100",
        lens="equidistant fisheye 180 deg",
        iso=np.array([100.0]),
    )


def write_chart(path: Path, chart: ColorChart) -> Path:
    """Write a chart to a layer of its own."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    prim = UsdGeom.Scope.Define(stage, "/Chart").GetPrim()
    stage.SetDefaultPrim(prim)
    write_color_chart(prim, chart, path.parent)
    return write_layer(stage, path)


def with_rows(chart: ColorChart, rows: list[int] | NDArray[np.int64]) -> ColorChart:
    """Return some patches of a chart."""
    index = np.asarray(rows)
    assert chart.patches is not None and chart.camera_values is not None
    return replace(
        chart,
        patches=tuple(chart.patches[row] for row in index),
        camera_values=chart.camera_values[index],
        signals=None if chart.signals is None else chart.signals[index],
        reflectances=None if chart.reflectances is None else chart.reflectances[index],
    )


def write_table(path: Path, chart: ColorChart, *, transposed: bool = False) -> Path:
    """Write the signals of a chart as CSV: a column per patch, or a row."""
    assert chart.signals is not None and chart.patches is not None
    assert chart.wavelength_nm is not None
    if transposed:
        lines = ["patch," + ",".join(f"{nm:g}" for nm in chart.wavelength_nm)]
        for name, row in zip(chart.patches, chart.signals, strict=True):
            lines.append(f"{name}," + ",".join(f"{value:.8g}" for value in row))
    else:
        lines = ["wavelength," + ",".join(chart.patches)]
        for nm, row in zip(chart.wavelength_nm, chart.signals.T, strict=True):
            lines.append(f"{nm:g}," + ",".join(f"{value:.8g}" for value in row))
    path.write_text("\n".join(lines) + "\n")
    return path
