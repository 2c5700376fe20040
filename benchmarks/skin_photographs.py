"""Skin from photographs: ``python -m benchmarks.skin_photographs [DATA]``.

A ball, and with the evaluation data a scanned head, photographed by the virtual photographer: one
lamp at 24 places, two views, brackets with photon and read noise, a camera that was calibrated by a
chart. Then ``usdskin estimate skin``: how far l, A + B and the colour of S are from the material.
"""

from __future__ import annotations

import argparse
import tempfile
from dataclasses import replace
from importlib import resources
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom, UsdShade

from benchmarks.measure import machine
from benchmarks.report import Row, Section, as_text
from usdskin.cli import main as usdskin
from usdskin.colorimetry import xyz_weights
from usdskin.differences import delta_e_of_signals
from usdskin.estimate.skin.step import SkinOptions, SkinResult, estimate_skin
from usdskin.illuminants import illuminant
from usdskin.judge.shoot.chart_layers import read_chart_truth
from usdskin.judge.shoot.charts import ChartSetup, photograph_chart
from usdskin.judge.shoot.sensor import Sensor, exposure_series
from usdskin.judge.shoot.setups import Setup, fisheye
from usdskin.judge.skin.photographs import SubjectSetup, photograph_subject
from usdskin.judge.skin.scenes import define_lamp, direction_of, facing, lamp_irradiance
from usdskin.prims.skin import SkinParameters, write_skin
from usdskin.spectrum import SpectralQuantity, Spectrum

FloatArray = NDArray[np.float64]

NM = np.arange(380.0, 781.0, 5.0)
COLUMNS = ("skin", "error of l", "error of A + B", "dE2000 of S, mean, max", "bar")
SETUP = Setup(sensor=Sensor(full_well=15000.0), states_noise=True)
LAMPS = ("D55", "A", "D65", "FL2", "FL11", "LED-B3")


def skin(wrap: float, specular: float) -> SkinParameters:
    text = resources.files("usdskin").joinpath("data", "skin_reference.csv").read_text("ascii")
    rows = [line.split(",") for line in text.splitlines() if not line.startswith("#")]
    nm, reflectance, _ = np.array(rows[1:], dtype=np.float64).T
    ratio = np.array([0.2, 0.28, 0.6])
    return SkinParameters(
        alpha=0.75,
        wrap=wrap,
        reflectance=Spectrum(SpectralQuantity.REFLECTANCE, nm, reflectance),
        scattering=Spectrum(SpectralQuantity.SCATTERING, np.array([400.0, 580.0, 700.0]), ratio),
        specular_weight=specular,
    )


def write_subject(path: Path, material: SkinParameters, mesh: Path | None) -> Path:
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    if mesh is None:
        prim = UsdGeom.Sphere.Define(stage, "/Subject").GetPrim()
    else:
        prim = UsdGeom.Xform.Define(stage, "/Subject").GetPrim()
        prim.GetReferences().AddReference(str(mesh))
    skin_prim = UsdShade.Material.Define(stage, "/Skin")
    write_skin(skin_prim.GetPrim(), material, path.parent)
    binding = UsdShade.MaterialBindingAPI.Apply(prim)
    binding.Bind(skin_prim, UsdShade.Tokens.strongerThanDescendants)
    stage.GetRootLayer().Save()
    return path


def calibrated(folder: Path) -> Setup:
    """Calibrate the camera by a chart in the lamp's light; return what photographs on."""
    weights = xyz_weights(NM, absolute=True)[:, 1]
    light = lamp_irradiance(NM, illuminant("D55", NM), weights, 2000.0)
    stage = Usd.Stage.CreateNew(str(folder / "lamp.usda"))
    UsdGeom.SetStageUpAxis(stage, "Y")
    define_lamp(stage, "/Lamp", light, [facing(direction_of((20.0, 30.0), "Y"), "Y")], 6.0)
    stage.GetRootLayer().Save()
    setup = replace(SETUP, lens=fisheye(400), exposures=exposure_series(4, 2.0, 1.0 / 30.0))
    chart = photograph_chart(
        folder / "lamp.usda", folder / "chart", setup, ChartSetup(light_class="lamp")
    )
    usdskin(["-q", "calibrate", "camera", str(chart), "-o", str(folder / "camera.usda")])
    constant = read_chart_truth(folder / "chart").constants["sensorConstant"]
    return replace(SETUP, sensor_constant=constant)


def row_of(name: str, found: SkinResult, truth: SkinParameters) -> Row:
    assert truth.reflectance is not None and truth.scattering is not None
    nm = found.spectra.wavelength_nm
    luminous = xyz_weights(nm)[:, 1] / xyz_weights(nm)[:, 1].sum()
    ratio = truth.scattering.resample(nm)
    lambert = truth.alpha * truth.reflectance.resample(nm)
    true = lambert * (1.0 + luminous @ ratio)
    lamps = [illuminant(lamp, nm) for lamp in LAMPS]
    seen = found.spectra.reflectance
    errors = np.array([float(delta_e_of_signals(seen * e, true * e, e, nm)) for e in lamps])
    facing_light = found.spectra.alpha * seen * (1.0 + found.spectra.scattering)
    total = float(luminous @ facing_light) / float(luminous @ (lambert * (1.0 + ratio))) - 1.0
    off = found.fit.wrap - truth.wrap
    return Row(
        name,
        f"{off:+.4f} (sd {found.fit.stddev[0]:.4f})",
        f"{total:+.2%}",
        f"{errors.mean():.2f}, {errors.max():.2f}",
        "l .03, dE 1.0",
        abs(off) <= 0.03 and errors.mean() <= 1.0,
    )


def section(name: str, mesh: Path | None, setup: Setup, folder: Path) -> Section:
    rows = []
    for index, (wrap, specular) in enumerate([(0.1, 0.0), (0.3, 0.0), (0.6, 0.0), (0.3, 0.5)]):
        place = folder / f"{name.replace(' ', '_')}{index}"
        place.mkdir()
        truth = skin(wrap, specular)
        stage = write_subject(place / "subject.usda", truth, mesh)
        shoot = SubjectSetup(
            size=96, material="/Skin", calibration=folder / "camera.usda", states_white=False
        )
        samples = photograph_subject(stage, place / "shoot", setup, shoot)
        for how in ("none", "fit") if specular else ("none",):
            found = estimate_skin(samples, place / f"{how}.usda", SkinOptions(specular=how))
            gloss = {"none": ", gloss masked", "fit": ", gloss fitted"}[how] if specular else ""
            rows.append(row_of(f"l = {wrap:g}{gloss}", found, truth))
    return Section(f"{name}, 24 lights, two views of 96 px", COLUMNS, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("data", type=Path, nargs="?", help="folder of the evaluation data")
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        setup = calibrated(folder)
        sections = [section("ball", None, setup, folder)]
        if chosen.data is not None:
            mesh = chosen.data / "heads" / "leeperrysmith" / "LeePerrySmith.obj"
            usdskin(["-q", "import", str(mesh), "-o", str(folder / "head.usda")])
            sections.append(section("scanned head", folder / "head.usda", setup, folder))
    print(as_text(machine(), sections))


if __name__ == "__main__":
    main()
