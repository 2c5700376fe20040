"""The virtual shoot of a proof: the photographs of the place, and a chart in every kind of light.

Photographs go through `usdskin ingest` as those of a real camera do. What the photographer states
of the place are the meters' readings, the lens as it was calibrated and the nominal directions of
the views; the faults are the difference between those and what was.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from usdskin.capture.ingest.options import IngestOptions
from usdskin.capture.ingest.step import ingest
from usdskin.capture.viewpoints import Direction, parse_directions
from usdskin.judge.proof.options import Faults, ProofOptions
from usdskin.judge.proof.place import Place
from usdskin.judge.proof.record import Doing
from usdskin.judge.shoot.charts import ChartSetup, photograph_chart, with_camera_of
from usdskin.judge.shoot.photographer import photograph, plan
from usdskin.judge.shoot.sensor import Sensor, exposure_series
from usdskin.judge.shoot.setups import Setup, fisheye
from usdskin.judge.shoot.shoot_layers import new_stage
from usdskin.layers import open_stage, record_provenance, write_layer
from usdskin.prims import FisheyeLens, read_shoot, write_lens
from usdskin.progress import Progress

# isort: split
# After ours, which register the schemas.
from pxr import UsdGeom

_BRIGHTEST = 0.8
"""What the brightest lamp is exposed to in the shortest exposure, relative to white."""

_CAMERA_PIXELS = 4000
"""Width of the fisheye's circle on a camera of 24 megapixels, for which the photographs stand."""

VIEWS = "3+zenith"
"""Where the photographer means to look: the views of `usdskin ingest --views`."""


@dataclass(frozen=True, slots=True, eq=False)
class Shooting:
    """How a place is photographed."""

    setup: Setup
    """Camera, lens, views and faults."""

    camera_options: tuple[str, ...]
    """Sensor and lens as options of `usdskin photograph`."""

    options: tuple[str, ...]
    """The rest, the seed aside."""


def shooting_of(options: ProofOptions, faults: Faults, light: Path | None = None) -> Shooting:
    """Return how a proof photographs.

    Args:
        options: What the proof is told.
        faults: What goes wrong.
        light: Light that is metered before it is photographed: the shortest exposure holds its
            brightest lamp, be it the sun. None: the mean is exposed as usual.

    Raises:
        UsdSkinError: The light cannot be read.
    """
    size = options.size
    # The shutter and the f-number stay; the sensor is exposed for the place by the neutral filter
    # of its sensitivity, as ``Setup.middle`` says.
    series = exposure_series(size.exposures, size.stops)
    # A pixel stands for several of the camera's: it holds their electrons, and their noise.
    binned = max(_CAMERA_PIXELS / size.fisheye, 1.0)
    sensor = Sensor(is_noisy=faults.noise)
    sensor = replace(
        sensor,
        full_well=float(f"{sensor.full_well * binned**2:g}"),
        read_noise=float(f"{sensor.read_noise * binned:g}"),
    )
    views = turned_views(faults.rotation_deg, options.seed)
    setup = Setup(
        camera=options.camera,
        lens=fisheye(size.fisheye, glare=faults.glare),
        views=views,
        exposures=series,
        sensor=sensor,
        vignetting_error=faults.vignetting,
        stated_glare=0.0,
        reading_error=options.scale_error,
        truth_height=size.solve_height,
        seed=options.seed,
    )
    if light is not None:
        setup = replace(setup, middle=_metered(light, setup))
    camera: list[Any] = ["--middle", setup.middle, "--size", size.fisheye, "--glare", faults.glare]
    camera += ["--full-well", sensor.full_well, "--read-noise", sensor.read_noise]
    words: list[Any] = ["--camera", options.camera]
    words += ["--exposures", size.exposures, "--stops", size.stops, "--stated-glare", 0.0]
    words += ["--vignetting-error", faults.vignetting, "--reading-error", options.scale_error]
    words += ["--views", ",".join(f"{azimuth:.4f}:{up:.4f}" for azimuth, up in views)]
    words += ["--truth-height", size.solve_height]
    words += [] if faults.noise else ["--no-noise"]
    return Shooting(setup, _as_words(camera), _as_words(words))


def _as_words(values: list[Any]) -> tuple[str, ...]:
    return tuple(f"{value:g}" if isinstance(value, float) else str(value) for value in values)


def _metered(light: Path, setup: Setup) -> float:
    """Return how bright the middle exposure is to be: darker than usual for the sun's sake."""
    seen = plan(light, setup, []).light
    shortest = setup.exposures_of(0).exposure
    range_down = float(shortest[shortest.size // 2] / shortest.min())
    holds = _BRIGHTEST * range_down * float(seen.mean()[1] / seen.peak()[:3].max())
    return float(f"{min(setup.middle, holds):.3g}")


def turned_views(error_deg: float, seed: int) -> tuple[tuple[float, float], ...]:
    """Return where the views really look: off the nominal directions by an angle each.

    Args:
        error_deg: That angle [deg].
        seed: Of which way.
    """
    found = []
    for index, nominal in enumerate(parse_directions(VIEWS)):
        if abs(nominal.elevation_deg) == 90.0:
            # Another azimuth would turn the whole picture.
            tilt = nominal.elevation_deg - np.sign(nominal.elevation_deg) * error_deg
            found.append((nominal.azimuth_deg, round(float(tilt), 4)))
            continue
        turn = np.random.default_rng([seed, index, 0x707]).uniform(0.0, 2.0 * np.pi)
        axis = nominal.vector
        aside = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        aside /= np.linalg.norm(aside)
        across = np.cos(turn) * aside + np.sin(turn) * np.cross(axis, aside)
        error = np.radians(error_deg)
        x, y, z = np.cos(error) * axis + np.sin(error) * across
        azimuth = float(np.degrees(np.arctan2(-x, -z)))
        elevation = float(np.degrees(np.arcsin(np.clip(y, -1.0, 1.0))))
        # As the command line says them, so that both do the same.
        found.append((round(azimuth, 4), round(elevation, 4)))
    return tuple(found)


def write_stated_lens(lens: FisheyeLens, path: Path) -> Path:
    """Write the lens as the photographer had it calibrated.

    Args:
        lens: The lens as it is stated.
        path: Layer to write.
    """
    stage = new_stage("Y")
    camera = UsdGeom.Camera.Define(stage, "/Lens").GetPrim()
    stage.SetDefaultPrim(camera)
    write_lens(camera, lens)
    record_provenance(stage, "prove", [], {}, path.parent)
    return write_layer(stage, path)


def take_photographs(
    light: Path,
    light_class: str,
    place: Place,
    shooting: Shooting,
    threads: int | None,
    progress: Progress,
    doing: Doing,
) -> None:
    """Photograph a light from its place.

    Args:
        light: The true light.
        light_class: Its class, which shines alone; empty for the whole light. Photographs of a
            class go on with the camera of the whole one's.
        place: Where to write.
        shooting: How.
        threads: CPU threads.
        progress: Told how far it is.
        doing: Takes files and notes.
    """
    setup, room = shooting.setup, place.room(light_class)
    if light_class:
        setup = with_camera_of(place.room(), setup)
        setup = replace(setup, seed=class_seed(setup.seed, light_class))
    photograph(light, room, setup, threads=threads, progress=progress, notes=doing.notes)
    doing.writes += files_below(room)
    if not light_class:
        write_stated_lens(setup.stated_lens, place["shoot/lens.usda"])
        doing.writes.append(place["shoot/lens.usda"])


def take_chart(
    light: Path,
    light_class: str,
    place: Place,
    shooting: Shooting,
    chart: str,
    threads: int | None,
    progress: Progress,
    doing: Doing,
) -> None:
    """Photograph and measure a chart in the light of one class.

    Args:
        light: The true light of the class.
        light_class: Its name.
        place: Where to write; holds the photographs of the place.
        shooting: How they were taken.
        chart: Which chart.
        threads: CPU threads.
        progress: Told how far it is.
        doing: Takes files and notes.
    """
    setup = with_camera_of(place.room(), shooting.setup)
    # A seed of its own, so that no two charts share their noise.
    setup = replace(setup, seed=chart_seed(setup.seed, light_class))
    output = place.chart(light_class).parent
    photograph_chart(
        light,
        output,
        setup,
        ChartSetup(chart=chart, light_class=light_class),
        threads=threads,
        progress=progress,
        notes=doing.notes,
    )
    doing.writes += files_below(output)


def chart_seed(seed: int, light_class: str) -> int:
    """Return the seed of a chart's noise."""
    return 1000 * seed + sum(light_class.encode()) % 997 + 1


def class_seed(seed: int, light_class: str) -> int:
    """Return the seed of the noise of photographs in the light of one class."""
    return chart_seed(seed, light_class) + 10_000_000


def ingest_options(
    place: Place, light_class: str, shooting: Shooting
) -> tuple[IngestOptions, list[str]]:
    """Return what the photographer tells `usdskin ingest`, and the same as its options.

    Args:
        place: Holds the photographs; their taker's notes are in ``room/shoot.usda``.
        light_class: Class that shone alone; empty for the whole light.
        shooting: How they were taken.
    """
    stated = read_shoot(open_stage(place.room(light_class) / "shoot.usda"))
    black, white = shooting.setup.development.levels
    facing = direction_of(stated.illuminance_direction)
    looking = direction_of(stated.luminance_direction)
    lux, nits = float(f"{stated.illuminance_lx:.6g}"), float(f"{stated.luminance:.6g}")
    lens = place["shoot/lens.usda"]
    options = IngestOptions(
        lens=lens,
        views=VIEWS,
        black_level=float(black),
        white_level=float(white),
        illuminance=(lux, facing),
        luminance=(nits, looking),
        session=place.folder.resolve().name,
    )
    words = ["--lens", place.name_of(lens), "--views", VIEWS]
    words += ["--black-level", f"{black:g}", "--white-level", f"{white:g}"]
    words += ["--illuminance", f"{lux:g}@{facing}", "--luminance", f"{nits:g}@{looking}"]
    words += ["--session", place.folder.resolve().name]
    return options, words


def direction_of(vector: Any) -> Direction:
    """Return a direction of the world as people say it, to a ten-thousandth of a degree."""
    x, y, z = (float(value) for value in vector)
    if np.hypot(x, z) < 1e-9:
        return Direction(0.0, 90.0 if y > 0.0 else -90.0)
    azimuth = round(float(np.degrees(np.arctan2(-x, -z))), 3)
    return Direction(azimuth, round(float(np.degrees(np.arctan2(y, np.hypot(x, z)))), 3))


def ingest_photographs(
    place: Place, light_class: str, options: IngestOptions, progress: Progress, doing: Doing
) -> None:
    """Describe the photographs as a shoot, by what they and their taker tell.

    Args:
        place: Holds the photographs.
        light_class: Class that shone alone; empty for the whole light.
        options: What the photographer tells.
        progress: Told how far it is.
        doing: Takes files and notes.
    """
    shoot = place.shoot(light_class)
    ingest(place.room(light_class), shoot, options, notes=doing.notes, progress=progress)
    doing.writes.append(shoot)


def files_below(folder: Path) -> list[Path]:
    """Return all files of a folder, in order."""
    return sorted(path for path in folder.rglob("*") if path.is_file())
