"""What a shoot without a known truth can be judged by: the patches of its charts.

Two comparisons with the spectra that were measured: each patch recovered by a calibration that has
not seen it, and each patch relit by the estimated light of its class, where that light is
brightest and scaled to the measured illuminance, for where the chart faced is not known.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.colorimetry import xyz_weights
from usdskin.differences import delta_e_of_signals, goodness_of_fit
from usdskin.layers import open_stage
from usdskin.meters import irradiance
from usdskin.prims import SpectralCamera, read_spectral_camera
from usdskin.render.lights import read_lights
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as GRID

FloatArray = NDArray[np.float64]

_NORMALS = 128


def judge_patches(camera: Path, light: Path) -> list[dict[str, Any]]:
    """Return a row for each class of light: what its patches say.

    Args:
        camera: Layer of the calibration, with the patches it was made from.
        light: Layer of the estimated light.

    Raises:
        LayerError: A layer cannot be read.
        ImageError: A map cannot be read.
    """
    calibrated = read_spectral_camera(open_stage(camera))
    return [
        _row(calibrated, index, _class_irradiance(light, index, len(calibrated.recoveries)))
        for index in range(len(calibrated.recoveries))
    ]


def _row(camera: SpectralCamera, index: int, facing: FloatArray) -> dict[str, Any]:
    recovery = camera.recoveries[index]
    row: dict[str, Any] = {
        "class": recovery.light_class,
        "leaveOneOut": {
            "deltaE2000": _statistics(recovery.patch_delta_e_2000),
            "gfc": _mean(recovery.patch_gfc),
        },
        "relit": None,
        "patches": [],
    }
    chart = next((item for item in camera.charts if item.light_class == recovery.light_class), None)
    if chart is None or chart.signals is None:
        return row
    lamp = recovery.illuminant
    luminous = xyz_weights(GRID)[:, 1]
    scale = float(lamp @ luminous) / float(facing @ luminous)
    reflectance = chart.signals / np.where(lamp > 0.0, lamp, np.inf)
    relit = reflectance * facing * scale
    delta_e = delta_e_of_signals(relit, chart.signals, lamp, GRID)
    fit = goodness_of_fit(relit, chart.signals)
    row["relit"] = {
        "deltaE2000": _statistics(delta_e),
        "gfc": _mean(fit),
        "scale": scale,
        "lampGfc": float(goodness_of_fit(facing, lamp)),
    }
    loo = recovery.patch_delta_e_2000
    names = chart.patches or tuple(str(number) for number in range(len(delta_e)))
    row["patches"] = [
        {
            "name": name,
            "leaveOneOut": None if loo is None else float(loo[number]),
            "relit": float(delta_e[number]),
        }
        for number, name in enumerate(names)
    ]
    return row


def _class_irradiance(light: Path, index: int, count: int) -> FloatArray:
    """Return the radiance of a perfect diffuser in one class's light, where it is brightest."""
    lights = read_lights(open_stage(light), Usd.TimeCode.Default(), GRID)
    best, found = -np.inf, np.zeros(GRID.size)
    luminous = xyz_weights(GRID)[:, 1]
    for normal in _even_normals(_NORMALS):
        total = np.zeros(GRID.size)
        for dome in lights.domes:
            rank = dome.basis.shape[0] // count
            own = slice(index * rank, (index + 1) * rank)
            part = irradiance(dome.coefficients[..., own], dome.to_world.T @ normal)
            total += part @ dome.basis[own] / np.pi
        if float(total @ luminous) > best:
            best, found = float(total @ luminous), total
    return found


def _even_normals(count: int) -> FloatArray:
    index = np.arange(count) + 0.5
    y = 1.0 - 2.0 * index / count
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - y * y)
    return np.stack([radius * np.cos(turn), y, radius * np.sin(turn)], axis=-1)


def _statistics(values: FloatArray | None) -> dict[str, float] | None:
    if values is None or not len(values):
        return None
    return {
        "mean": float(values.mean()),
        "median": float(np.median(values)),
        "p95": float(np.percentile(values, 95.0)),
        "max": float(values.max()),
    }


def _mean(values: FloatArray | None) -> float | None:
    return None if values is None or not len(values) else float(values.mean())
