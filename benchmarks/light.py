"""Skin in an estimated light against skin in the true one: ``python -m benchmarks.light``.

A virtual camera photographs a room whose light is known, and a chart in the light of each of its
lamps; the product captures, calibrates and estimates the light from the files alone. Skin held out
of the chart (CIE 2017 test colors 15 and 18) is then lit by the estimate and by the truth.

Colour difference: CIEDE2000, CIE 1931 2 degrees; Y and white are those of a perfect diffuser at the
truth's brightest irradiance (printed); no mask: skins x 64 normals evenly over the sphere.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Sdf

from usdskin.capture.step import CaptureOptions, capture_shoot
from usdskin.estimate.camera.step import CalibrationOptions, calibrate_camera
from usdskin.estimate.light.step import LightOptions, estimate_light
from usdskin.judge.relit_skin import RelitDifference, compare_lights
from usdskin.judge.shoot.charts import ChartSetup, photograph_chart, with_camera_of
from usdskin.judge.shoot.photographer import photograph
from usdskin.judge.shoot.setups import Setup, fisheye
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, resample

ROOM = Path(__file__).resolve().parents[1] / "stages" / "capture_room"
LAMPS = {"tubes": ROOM / "tubes.usda", "window": ROOM / "window.usda"}
BOTH = ROOM / "room.usda"
NORMALS = 64


@dataclass(frozen=True)
class Faults:
    """What goes wrong in a capture."""

    glare: float = 0.0
    vignetting_error: float = 0.0
    rotation_error_deg: float = 0.0
    scale: float = 1.0


IDEAL = Faults()
REALISTIC = Faults(glare=0.01, vignetting_error=0.02, rotation_error_deg=1.0)


def even_normals(count: int) -> NDArray[np.float64]:
    """Return directions spread evenly over the sphere along a Fibonacci spiral."""
    index = np.arange(count) + 0.5
    y = 1.0 - 2.0 * index / count
    turn = index * np.pi * (3.0 - np.sqrt(5.0))
    radius = np.sqrt(1.0 - y * y)
    return np.stack([radius * np.cos(turn), y, radius * np.sin(turn)], axis=-1)


def skins() -> NDArray[np.float64]:
    """Return reflectances of the two skins of the CIE 2017 test colors, shape [2, 61]."""
    from colour import SpectralShape
    from colour.quality.cfi2017 import load_TCS_CIE2017

    colors = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    grid = DEFAULT_WAVELENGTHS_NM
    return np.stack([resample(colors.wavelengths, colors.values[:, i], grid) for i in (14, 17)])


class Studio:
    """One camera, its charts and what it captured, in a folder of its own."""

    def __init__(self, folder: Path, size: int, width: int, camera: str) -> None:
        """Photograph the chart in each lamp."""
        self.folder, self.width = folder, width
        self.setup = Setup(camera=camera, lens=fisheye(size))
        self.charts: dict[str, Path] = {}
        for name, lamp in LAMPS.items():
            setup = replace(self.setup, lens=fisheye(1600))
            if self.charts:
                setup = with_camera_of(next(iter(self.charts.values())).parent, setup)
            chart = ChartSetup(light_class=name)
            self.charts[name] = photograph_chart(lamp, folder / f"chart_{name}", setup, chart)

    def capture(self, name: str, room: Path, faults: Faults) -> Path:
        """Photograph and capture a room."""
        lens = fisheye(self.setup.lens.resolution[0], glare=faults.glare)
        setup = with_camera_of(next(iter(self.charts.values())).parent, self.setup)
        setup = replace(
            setup,
            lens=lens,
            stated_glare=0.0,
            vignetting_error=faults.vignetting_error,
            rotation_error_deg=faults.rotation_error_deg,
        )
        shoot = photograph(room, self.folder / name, setup)
        if faults.scale != 1.0:
            _misread(shoot, faults.scale)
        output = self.folder / name / "capture.usda"
        options = CaptureOptions(width=self.width)
        return capture_shoot(shoot, output, options).paths[0]

    def calibrate(self, names: tuple[str, ...], estimator: str) -> Path:
        """Calibrate the camera by the charts of some lamps."""
        output = self.folder / f"camera_{'_'.join(names)}_{estimator}.usda"
        if not output.exists():
            charts = [self.charts[name] for name in names]
            calibrate_camera(charts, output, CalibrationOptions(estimator=estimator))
        return output

    def light(self, capture: Path, camera: Path, options: LightOptions | None = None) -> Path:
        """Estimate the light."""
        output = capture.parent / f"light_{camera.stem}.usda"
        return estimate_light(capture, camera, output, options).paths[0]


def _misread(shoot: Path, factor: float) -> None:
    """Let the meters of a shoot be off."""
    layer = Sdf.Layer.FindOrOpen(str(shoot))
    for name in ("capture:luminance", "capture:illuminance"):
        attribute = layer.GetAttributeAtPath(f"/Shoot.{name}")
        attribute.default = factor * attribute.default
    layer.Save()


def main(arguments: list[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="smaller pictures")
    parser.add_argument("--camera", default="Nikon 5100 (NPL)", help="of colour-science, or a file")
    given = parser.parse_args(arguments)
    size, width = (500, 512) if given.quick else (1000, 1024)
    normals, surfaces = even_normals(NORMALS), skins()
    print(f"{given.camera}; 3 views of {size} px, panorama {width} x {width // 2}")
    print(f"{'scene and capture':44} {'estimator':11} {'mean':>6} {'p95':>6} {'max':>6}   bar")
    missed = 0
    with tempfile.TemporaryDirectory() as folder:
        studio = Studio(Path(folder), size, width, given.camera)

        def row(
            title: str, room: Path, capture: Path, names: tuple[str, ...], bar: tuple[str, float],
            estimator: str = "regression", options: LightOptions | None = None,
        ) -> None:  # fmt: skip
            nonlocal missed
            camera = studio.calibrate(names, estimator)
            light = studio.light(capture, camera, options)
            grid = DEFAULT_WAVELENGTHS_NM
            found = compare_lights(room, light, surfaces, normals, grid)
            missed += _print(title, estimator, found, bar)

        for name, room in LAMPS.items():
            capture = studio.capture(f"{name}_ideal", room, IDEAL)
            for estimator in ("regression", "wiener", "pca", "smooth", "literal"):
                bar = ("mean <= 0.3, max <= 0.6", 0.3) if estimator == "regression" else ("", 0.0)
                row(f"{name} alone", room, capture, (name,), bar, estimator)
        for title, faults, limit in (
            ("tubes, realistic, exact scale", REALISTIC, 0.4),
            ("tubes, realistic, scale off by 3 %", replace(REALISTIC, scale=1.03), 0.8),
        ):
            capture = studio.capture(title.replace(" ", "_"), LAMPS["tubes"], faults)
            row(title, LAMPS["tubes"], capture, ("tubes",), (f"mean <= {limit:g}", limit))
        capture = studio.capture("both_ideal", BOTH, IDEAL)
        both = ("tubes", "window")
        row("tubes and window, class map estimated", BOTH, capture, both, ("mean <= 0.5", 0.5))
        row("tubes and window, all taken for tubes", BOTH, capture, ("tubes",), ("", 0.0))
        capture = studio.capture("both_realistic", BOTH, REALISTIC)
        row("tubes and window, realistic", BOTH, capture, both, ("", 0.0))
    return 1 if missed else 0


def _print(title: str, estimator: str, found: RelitDifference, bar: tuple[str, float]) -> int:
    said, limit = bar
    verdict = ""
    if limit:
        verdict = f"{said}: {'met' if found.mean <= limit else 'MISSED'}"
    print(
        f"{title:44} {estimator:11} {found.mean:6.2f} {found.p95:6.2f} {found.max:6.2f}   {verdict}"
        f"  [Y_n {found.y_n:.1f}, white {found.white[0]:.4f} {found.white[1]:.4f}]"
    )
    sys.stdout.flush()
    return int(bool(limit) and found.mean > limit)


if __name__ == "__main__":
    sys.exit(main())
