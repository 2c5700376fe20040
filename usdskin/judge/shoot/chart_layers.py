"""The layers of a chart's photographs: what the photographer states, and what was true.

Writes: ``chart.usda``, as a person would author it; ``truth/chart.usda``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.judge.shoot.chart_patches import Chart
from usdskin.judge.shoot.chart_scenes import Pose
from usdskin.judge.shoot.setups import Setup
from usdskin.judge.shoot.shoot_layers import Shooting, new_stage, stated_bracket
from usdskin.layers import SettingValue, open_stage, record_provenance, write_layer
from usdskin.prims import (
    ColorChart,
    FisheyeLens,
    read_color_charts,
    read_lens,
    write_bracket,
    write_color_chart,
    write_lens,
    write_rotation,
)
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, UsdGeom

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class ChartLight:
    """A chart in the light, as it is."""

    chart: Chart
    """The chart."""

    pose: Pose
    """Where it is before the camera."""

    rotation: FloatArray
    """Rotation from the camera to the world, shape [3, 3]."""

    facing: FloatArray
    """Where its normal points, unit vector in the world, shape [3]."""

    camera_values: FloatArray
    """True rho of the patches, shape [patch_count, 3]."""

    wavelength_nm: FloatArray
    """Wavelengths of the spectra below [nm], shape [n]."""

    reflectances: FloatArray
    """Reflectance of the patches [1], shape [patch_count, n]."""

    illuminant: FloatArray
    """Radiance of a perfect diffuser in the chart's place [W m^-2 sr^-1 nm^-1], shape [n]."""

    illuminance_lx: float
    """Illuminance of the chart [lx]."""

    corners: FloatArray
    """Corners of the outermost patches in the picture [px], shape [4, 2]."""

    radiance_unit: float
    """Radiance of a unit of the environment's light [W m^-2 sr^-1 nm^-1]."""

    @property
    def signals(self) -> FloatArray:
        """Radiance of the patches [W m^-2 sr^-1 nm^-1], shape [patch_count, n]."""
        return self.reflectances * self.illuminant


@dataclass(frozen=True, slots=True, eq=False)
class ChartTruth:
    """What the photographer of a chart knows and the photographs do not tell."""

    chart: ColorChart
    """True camera values, reflectances, illuminant and corners."""

    lens: FisheyeLens
    """The true lens."""

    constants: dict[str, Any]
    """``sensorConstant``, ``radianceUnit``, ``facing``, ``illuminance``, ...; see
    ``write_chart_truth``."""

    @property
    def signals(self) -> FloatArray:
        """True radiance of the patches [W m^-2 sr^-1 nm^-1], shape [patch_count, n]."""
        if self.chart.reflectances is None or self.chart.illuminant is None:
            raise LayerError(f"{self.chart.where}: holds no spectra; photograph the chart again")
        return np.asarray(self.chart.reflectances * self.chart.illuminant.value)


def _stated(
    shooting: Shooting, setup: Setup, light: ChartLight, light_class: str
) -> dict[str, Any]:
    """Return what both layers say of the chart."""
    return {
        "name": light.chart.name,
        "layout": light.chart.grid.layout,
        "light_class": light_class,
        "patches": light.chart.patches,
        "units": "absolute",
        "model": shooting.camera,
        "lens": setup.lens_name,
        "white_balance": "",
        "iso": np.unique(setup.exposures_of(0).iso),
    }


def write_chart_layer(
    path: Path,
    shooting: Shooting,
    setup: Setup,
    light: ChartLight,
    *,
    light_class: str,
    corners: FloatArray,
    images: Sequence[Path],
    view: int,
    final: Path,
) -> None:
    """Write the layer that describes a chart as its photographer would.

    Beside it are ``chart/signals.csv`` and ``chart/illuminant.csv``.

    Args:
        path: Layer to write.
        shooting: Camera and environment.
        setup: How it was photographed.
        light: The chart.
        light_class: Class of the light.
        corners: Corners of the patches as they were found in the picture [px], shape [4, 2].
        images: The photographs.
        view: Index of the view, for its exposures.
        final: Where the layer's folder is going to lie in the end.

    Raises:
        LayerError: The layer cannot be written.
    """
    folder = path.parent
    stage = new_stage(shooting.light.up_axis)
    prim = UsdGeom.Scope.Define(stage, "/Chart").GetPrim()
    stage.SetDefaultPrim(prim)
    camera = UsdGeom.Camera.Define(stage, "/Chart/camera").GetPrim()
    write_lens(camera, setup.stated_lens)
    write_bracket(camera, stated_bracket(setup, images, view), folder)
    write_rotation(camera, light.rotation)
    chart = ColorChart(
        **_stated(shooting, setup, light, light_class),
        signals_file=folder / "chart" / "signals.csv",
        illuminant_file=folder / "chart" / "illuminant.csv",
        corners=corners,
    )
    write_color_chart(prim, chart, folder, camera.GetPath())
    settings: dict[str, SettingValue] = {
        "camera": setup.camera,
        "chart": light.chart.name,
        "seed": setup.seed,
    }
    record_provenance(stage, "photograph", [shooting.environment], settings, final)
    write_layer(stage, path)


def write_chart_truth(
    folder: Path,
    shooting: Shooting,
    setup: Setup,
    light: ChartLight,
    *,
    light_class: str,
    final: Path,
) -> None:
    """Write ``chart.usda`` with the true camera values, spectra, lens and corners of a chart.

    The rest is in ``customData["truth"]`` of its default prim: ``sensorConstant`` c of
    rho = c integral L s dlambda (L in the units of the environment), ``radianceUnit``
    [W m^-2 sr^-1 nm^-1] of those units, ``camera``, ``facing`` (unit vector in the world),
    ``illuminance`` [lx] of the chart, ``fullWell`` and ``readNoise`` [electrons] and ``seed``.

    Args:
        folder: Folder of the truth; it is made where it is missing.
        shooting: Camera and environment.
        setup: How it was photographed.
        light: The chart.
        light_class: Class of the light.
        final: Where the folder is going to lie in the end.
    """
    folder.mkdir(exist_ok=True)
    stage = new_stage(shooting.light.up_axis)
    prim = UsdGeom.Scope.Define(stage, "/Chart").GetPrim()
    stage.SetDefaultPrim(prim)
    prim.SetCustomDataByKey(
        "truth",
        {
            "sensorConstant": shooting.constant,
            "radianceUnit": light.radiance_unit,
            "camera": shooting.camera,
            "facing": Gf.Vec3d(*light.facing.tolist()),
            "illuminance": light.illuminance_lx,
            "fullWell": setup.sensor.full_well,
            "readNoise": setup.sensor.read_noise,
            "seed": setup.seed,
        },
    )
    quantity = SpectralQuantity.RADIANCE
    chart = ColorChart(
        **_stated(shooting, setup, light, light_class),
        camera_values=light.camera_values,
        wavelength_nm=light.wavelength_nm,
        reflectances=light.reflectances,
        illuminant=Spectrum(quantity, light.wavelength_nm, light.illuminant),
        corners=light.corners,
    )
    write_color_chart(prim, chart, folder)
    camera = UsdGeom.Camera.Define(stage, "/Chart/camera").GetPrim()
    write_lens(camera, setup.lens)
    write_rotation(camera, light.rotation)
    record_provenance(stage, "photograph", [shooting.environment], {"seed": setup.seed}, final)
    write_layer(stage, folder / "chart.usda")


def read_chart_truth(folder: str | Path) -> ChartTruth:
    """Return the truth about a virtual chart.

    Args:
        folder: What ``photograph_chart`` wrote.

    Raises:
        LayerError: There is no truth about a chart in the folder.
    """
    stage = open_stage(Path(folder) / "truth" / "chart.usda")
    return ChartTruth(
        chart=read_color_charts(stage)[0],
        lens=read_lens(stage.GetPrimAtPath("/Chart/camera")),
        constants=dict(stage.GetDefaultPrim().GetCustomDataByKey("truth")),
    )
