"""Spectra and numbers of a proof, as they are and as they were estimated."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.judge.relit_skin import spectral_irradiance
from usdskin.judge.skin.goniometer import find_skin, spectra_of
from usdskin.layers import open_stage
from usdskin.prims import read_spectral_camera
from usdskin.prims.fits import SkinFitRecord, read_skin_fit
from usdskin.prims.skin import SkinParameters, read_skin
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

FloatArray = NDArray[np.float64]
Item = dict[str, Any]

_FACINGS = {"up": (0.0, 1.0, 0.0), "front": (0.0, 0.0, 1.0)}
_SHOWN_NM = (450.0, 550.0, 650.0)


def light_spectra(truth: Path, estimate: Path) -> list[Item]:
    """Return the irradiance of the place, up and towards +Z [W m^-2 nm^-1].

    Args:
        truth: Stage with the light as it is.
        estimate: Stage with the light as it was estimated.
    """
    directions = np.array(list(_FACINGS.values()))
    true = spectral_irradiance(truth, directions, DEFAULT_WAVELENGTHS_NM)
    found = spectral_irradiance(estimate, directions, DEFAULT_WAVELENGTHS_NM)
    return [
        _item(f"irradiance {name}", "light", true[index], found[index])
        for index, name in enumerate(_FACINGS)
    ]


def patch_spectra(camera: Path) -> list[Item]:
    """Return the patches of every class as they were measured, and as camera values give them.

    Args:
        camera: Layer of the calibration, which holds the patches that it was made from.
    """
    calibrated = read_spectral_camera(open_stage(camera))
    matrices = {recovery.light_class: recovery for recovery in calibrated.recoveries}
    items = []
    for chart in calibrated.charts:
        recovery = matrices.get(chart.light_class)
        if recovery is None or chart.camera_values is None or chart.signals is None:
            continue
        found = chart.camera_values @ recovery.matrix.T
        names = chart.patches or tuple(str(index) for index in range(len(found)))
        for name, true, estimated in zip(names, chart.signals, found, strict=True):
            items.append(_item(f"{chart.light_class}: {name}", "patch", true, estimated))
    return items


def read_material(layer: Path) -> tuple[SkinParameters, SkinFitRecord | None]:
    """Return the skin of a layer, and the fit it came from."""
    stage = open_stage(layer)
    prim = find_skin(stage)
    return read_skin(prim), read_skin_fit(prim)


def skin_spectra(truth: Path, estimate: Path) -> list[Item]:
    """Return S, Ss and delta of the skin, as they are and as they were fitted."""
    nm = DEFAULT_WAVELENGTHS_NM
    true = spectra_of(read_material(truth)[0], nm)
    skin, fit = read_material(estimate)
    stddev: list[Any] = [None, None, None]
    if fit is not None:
        for index, spectrum in enumerate((fit.reflectance_stddev, fit.scattering_stddev)):
            stddev[index] = None if spectrum is None else spectrum.resample(nm)
    names = ("reflectance S", "scattering Ss", "opacity delta")
    return [
        _item(name, "skin", true[index], found, stddev[index])
        for index, (name, found) in enumerate(zip(names, spectra_of(skin, nm), strict=True))
    ]


def skin_numbers(truth: Path, estimate: Path) -> list[Item]:
    """Return l, alpha and some bands of S and Ss with their standard deviations."""
    true, _ = read_material(truth)
    found, fit = read_material(estimate)
    rows = [
        _row("wrap", true.wrap, found.wrap, None if fit is None else fit.wrap_stddev),
        _row("alpha", true.alpha, found.alpha, None if fit is None else fit.alpha_stddev),
    ]
    nm = np.array(_SHOWN_NM)
    grid = DEFAULT_WAVELENGTHS_NM
    places = [int(np.flatnonzero(grid == value)[0]) for value in nm]
    spectra = zip(("S", "Ss"), skin_spectra(truth, estimate), strict=False)
    for symbol, item in spectra:
        for value, place in zip(nm, places, strict=True):
            stddev = None if item["stddev"] is None else item["stddev"][place]
            name = f"{symbol}({value:g})"
            rows.append(_row(name, item["true"][place], item["estimated"][place], stddev))
    return rows


def _row(name: str, true: float, estimated: float, stddev: float | None) -> Item:
    found = None if stddev is None else float(stddev)
    return {"name": name, "true": float(true), "estimated": float(estimated), "stddev": found}


def _item(
    name: str, kind: str, true: FloatArray, estimated: FloatArray, stddev: Any = None
) -> Item:
    return {
        "name": name,
        "kind": kind,
        "true": _rounded(true),
        "estimated": _rounded(estimated),
        "stddev": None if stddev is None else _rounded(stddev),
    }


def _rounded(values: Any) -> list[float]:
    """Return numbers of seven digits: more are noise, and a file to be read has its length."""
    return [float(f"{value:.7g}") for value in np.asarray(values, dtype=np.float64)]
