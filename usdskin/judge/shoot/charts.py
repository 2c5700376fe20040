"""A virtual photographer of color charts: what calibrates a camera, and the truth about it.

    photograph_chart(environment, output, setup=Setup(), chart=ChartSetup(), ...) -> chart.usda

A flat, matte chart is held in the middle of an environment, facing where it is brightest; the
camera of a shoot photographs it, and a spectroradiometer reads its patches.

Reads:  a stage with dome and distant lights, or a latlong picture.
Writes: ``chart.usda``, ``chart/`` with photographs, ``signals.csv`` and ``illuminant.csv``, and
        ``truth/chart.usda``: true camera values, spectra, lens and corners.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.device import Workers
from usdskin.errors import UsageError
from usdskin.judge.shoot.chart_layers import (
    ChartLight,
    ChartTruth,
    read_chart_truth,
    write_chart_layer,
    write_chart_truth,
)
from usdskin.judge.shoot.chart_patches import CLASSIC, Chart, chart_of, read_chart
from usdskin.judge.shoot.chart_scenes import (
    ChartScene,
    brightest_direction,
    chart_outline,
    chart_pose,
    check_picture,
    facing_rotation,
    project,
)
from usdskin.judge.shoot.environments import read_spectral_lights
from usdskin.judge.shoot.optics import Picture
from usdskin.judge.shoot.photo_files import KINDS
from usdskin.judge.shoot.photographer import add_glare, new_folder, plan, shoot, take_photograph
from usdskin.judge.shoot.sensitivity import read_sensitivity
from usdskin.judge.shoot.setups import Setup
from usdskin.judge.shoot.shoot_layers import Shooting, read_truth
from usdskin.judge.shoot.spectrophotometer import (
    READING_NM,
    Instrument,
    irradiance_towards,
    radiance_unit,
    write_readings,
)
from usdskin.notes import Note
from usdskin.progress import Progress, SilentProgress
from usdskin.spectrum import band_widths, resample

__all__ = [
    "Chart",
    "ChartSetup",
    "ChartTruth",
    "Instrument",
    "chart_of",
    "photograph_chart",
    "read_chart_truth",
    "with_camera_of",
]

FloatArray = NDArray[np.float64]

FRAME_REFLECTANCE = 0.035
"""Of the frame and the gaps, at all wavelengths [1]: black card."""


@dataclass(frozen=True, slots=True, eq=False)
class ChartSetup:
    """One way to hold, photograph and measure a chart; every value has a default that works."""

    chart: str | Chart = CLASSIC.layout
    """``classic24``, a file of reflectances, or a chart; see ``read_chart``."""

    light_class: str = "light"
    """Name of the light it is held in."""

    facing: tuple[float, float, float] | None = None
    """Where its normal points, in the world; None: where illuminance is largest."""

    width_deg: float = 40.0
    """Angle that its width fills [deg]."""

    off_axis_deg: tuple[float, float] = (2.0, -1.5)
    """How far its middle is to the right of the optical axis, and above it [deg]."""

    tilt_deg: float = 4.0
    """Angle between its normal and the way to the camera [deg]."""

    roll_deg: float = 3.0
    """Turn in its plane [deg]."""

    corner_error_px: float = 0.5
    """Standard deviation of the corners as they are found in the picture [px]."""

    instrument: Instrument = field(default_factory=Instrument)
    """The spectroradiometer."""

    def check(self) -> None:
        """Refuse what cannot be held or measured.

        Raises:
            UsageError: A value is out of range; the message names it.
        """
        ranges = {
            "angle that the chart fills": (self.width_deg, 1.0, 120.0),
            "tilt of the chart": (self.tilt_deg, 0.0, 45.0),
            "roll of the chart": (self.roll_deg, -180.0, 180.0),
            "chart's distance from the axis": (max(map(abs, self.off_axis_deg)), 0.0, 60.0),
            "error of the corners": (self.corner_error_px, 0.0, 100.0),
            "noise of the spectra": (self.instrument.noise, 0.0, 1.0),
            "offset of the spectra": (self.instrument.offset, 0.0, 1.0),
        }
        for name, (value, least, most) in ranges.items():
            if not least <= value <= most:
                raise UsageError(f"{name} is {value:g}; give {least:g} to {most:g}")
        if self.facing is not None and not (np.isfinite(self.facing).all() and any(self.facing)):
            raise UsageError(f"the chart faces {self.facing}; give a direction such as 0,0,1")
        if not self.light_class.isidentifier():
            raise UsageError(
                f"a class of light cannot be called {self.light_class!r}; use letters and digits"
            )


def with_camera_of(folder: str | Path, setup: Setup) -> Setup:
    """Return a set-up that goes on with the camera of an earlier shoot.

    That is its sensor constant, lens, full well and read noise; what else a set-up says stays.

    Args:
        folder: What ``photograph`` or ``photograph_chart`` wrote.
        setup: How else it is photographed.

    Raises:
        LayerError: There is no truth in the folder.
        UsageError: The set-up names another camera.
    """
    has_views = (Path(folder) / "truth" / "truth.usda").exists()
    truth = read_truth(folder) if has_views else read_chart_truth(folder)
    known, name = truth.constants, read_sensitivity(setup.camera).name
    if known["camera"] != name:
        raise UsageError(f"{folder}: was taken by {known['camera']}, not by {name}; name that one")
    sensor = replace(setup.sensor, full_well=known["fullWell"], read_noise=known["readNoise"])
    return replace(setup, sensor_constant=known["sensorConstant"], lens=truth.lens, sensor=sensor)


def photograph_chart(
    environment: str | Path,
    output: str | Path,
    setup: Setup | None = None,
    chart: ChartSetup | None = None,
    *,
    with_views: bool = False,
    threads: int | None = None,
    progress: Progress | None = None,
    notes: list[Note] | None = None,
) -> Path:
    """Photograph a color chart in an environment, and measure its patches.

    Args:
        environment: A stage with dome or distant lights, or a latlong picture.
        output: Folder to write, new or empty.
        setup: Camera, lens, sensor and exposures (those of the first view).
        chart: The chart and how it is held.
        with_views: Whether the environment is photographed too: ``shoot.usda`` and its views.
        threads: Threads to compute with; all cores where None. They change nothing but the time.
        progress: Told how far the work is.
        notes: Takes what could not be honoured.

    Returns:
        ``chart.usda`` in the folder. The folder is complete or not there.

    Raises:
        LayerError: The stage cannot be read, or the folder cannot be written.
        ImageError: A picture cannot be read or written.
        UsageError: The set-up makes no sense, or the folder holds something.
    """
    setup, chart = setup or Setup(), chart or ChartSetup()
    setup.check()
    chart.check()
    output, environment = Path(output), Path(environment)
    progress = progress or SilentProgress()
    notes = [] if notes is None else notes
    workers = Workers("cpu", threads or os.cpu_count() or 1)
    with new_folder(output) as folder:
        try:
            shooting = plan(environment, setup, notes)
            if with_views:
                shoot(shooting, setup, folder, output, workers, progress)
            _photograph(shooting, setup, chart, folder, output, workers, progress, notes)
        finally:
            progress.done()
    return output / "chart.usda"


def _photograph(
    shooting: Shooting,
    setup: Setup,
    chart: ChartSetup,
    folder: Path,
    final: Path,
    workers: Workers,
    progress: Progress,
    notes: list[Note],
) -> None:
    known = chart.chart if isinstance(chart.chart, Chart) else read_chart(chart.chart, notes)
    # One view more than the shoot's, so that its noise is its own.
    view = len(setup.views)
    setup = replace(setup, exposures=setup.exposures_of(0))
    light, scene = _light(shooting, setup, chart, known)
    (folder / "chart").mkdir()
    progress.start(setup.lens.resolution[1], "chart: light")
    image = Picture(scene, setup.lens, light.rotation).draw(workers, progress.advance)
    image *= np.float32(shooting.constant)
    add_glare(image, setup.lens)
    count = setup.exposures_of(view).time_s.size
    suffix = KINDS[setup.file_kind].suffix
    images = [folder / "chart" / f"{shot:02d}{suffix}" for shot in range(count)]

    def take(begin: int, end: int) -> None:
        for shot in range(begin, end):
            take_photograph(image, setup, images[shot], shooting.camera, view, shot)

    progress.start(count, "chart: photographs")
    workers.run(count, 1, take, progress.advance)
    peak = float(light.illuminant.max())
    for index, (name, names, values) in enumerate(
        [
            ("signals", known.patches, light.signals),
            ("illuminant", ("perfect diffuser",), light.illuminant[None]),
        ]
    ):
        read = chart.instrument.read(values, peak, [setup.seed, view, 0x5BEC, index])
        read *= 1.0 + setup.reading_error
        write_readings(folder / "chart" / f"{name}.csv", names, light.wavelength_nm, read)
    random = np.random.default_rng([setup.seed, view, 0xC0B])
    corners = light.corners + chart.corner_error_px * random.normal(size=(4, 2))
    classed = {"light_class": chart.light_class}
    write_chart_truth(folder / "truth", shooting, setup, light, **classed, final=final / "truth")
    write_chart_layer(
        folder / "chart.usda",
        shooting,
        setup,
        light,
        **classed,
        corners=corners,
        images=images,
        view=view,
        final=final,
    )


def _light(
    shooting: Shooting, setup: Setup, chart: ChartSetup, known: Chart
) -> tuple[ChartLight, ChartScene]:
    """Return the chart in its light, and what the camera has before it."""
    pose = chart_pose(
        known.grid, chart.width_deg, chart.off_axis_deg, chart.tilt_deg, chart.roll_deg
    )
    check_picture(known.grid, pose, setup.lens)
    given = brightest_direction(shooting.light) if chart.facing is None else np.array(chart.facing)
    facing = given / np.linalg.norm(given)
    camera = read_sensitivity(setup.camera)
    # The camera has bands of its own, an instrument those of its make.
    diffuser, in_watts = _diffuser(shooting, setup, facing, camera.wavelength_nm)
    weights = camera.value * band_widths(camera.wavelength_nm)[:, None]
    luminance = xyz_weights(camera.wavelength_nm, absolute=True)[:, 1] * in_watts
    weights = np.column_stack([weights, luminance])
    reflectances = np.vstack(
        [
            _on_grid(known, camera.wavelength_nm),
            np.full(camera.wavelength_nm.size, FRAME_REFLECTANCE),
        ]
    )
    responses = reflectances * diffuser @ weights
    rotation = facing_rotation(pose, facing, shooting.light.panorama_from_world)
    radiance, unit = _diffuser(shooting, setup, facing, READING_NM)
    light = ChartLight(
        chart=known,
        pose=pose,
        rotation=rotation,
        facing=facing,
        camera_values=shooting.constant * responses[:-1, :3],
        wavelength_nm=READING_NM,
        reflectances=_on_grid(known, READING_NM),
        illuminant=unit * radiance,
        illuminance_lx=float(shooting.light.irradiance(facing)[3]),
        corners=project(setup.lens, chart_outline(known.grid, pose)),
        radiance_unit=unit,
    )
    return light, ChartScene(shooting.light, known.grid, pose, responses[:-1], responses[-1])


def _diffuser(
    shooting: Shooting, setup: Setup, facing: FloatArray, nm: FloatArray
) -> tuple[FloatArray, float]:
    """Return the radiance of a perfect diffuser in the units of the light, and of such a unit."""
    lights, _ = read_spectral_lights(
        shooting.environment, nm, setup.illuminant, setup.bad_pixels, []
    )
    unit = radiance_unit(lights.absolute, shooting.light.luminance_unit, nm)
    return np.maximum(irradiance_towards(lights, facing), 0.0) / np.pi, unit


def _on_grid(chart: Chart, nm: FloatArray) -> FloatArray:
    return resample(chart.wavelength_nm, chart.reflectances, nm, outside="hold")
