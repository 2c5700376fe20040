"""A virtual photographer of skin: one lamp moved around a subject, and the truth about it.

    photograph_subject(stage, output, setup=Setup(), shoot=SubjectSetup(), ...) -> samples.usda

Every picture is rendered band by band in the light of one distant lamp, and seen by a camera of
measured sensitivities with a sensor that has noise and saturates.

Reads:  a stage with a shape and a skin material; its own lights are off.
Writes: ``samples.usda``, ``photographs/`` with a bracket for every lamp and view (or ``images/``
        with a picture in camera values), ``geometry/`` with the AOVs of every view, and
        ``truth/truth.usda``: the material, the sensor and the white.
"""

from __future__ import annotations

import os
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import xyz_weights
from usdskin.errors import UsageError
from usdskin.illuminants import illuminant
from usdskin.images import Part, write_exr
from usdskin.judge.shoot.photo_files import KINDS
from usdskin.judge.shoot.photographer import new_folder, take_photograph
from usdskin.judge.shoot.sensitivity import CameraSensitivity, read_sensitivity
from usdskin.judge.shoot.sensor import Exposures, exposure_list
from usdskin.judge.shoot.setups import Setup
from usdskin.judge.shoot.viewpoints import Orientation
from usdskin.judge.skin.layers import (
    Shot,
    SubjectTruth,
    read_subject_truth,
    write_samples,
    write_subject_truth,
)
from usdskin.judge.skin.scenes import (
    Rendering,
    Subject,
    lamp_irradiance,
    read_subject,
    render_views,
    write_set,
)
from usdskin.layers import open_stage
from usdskin.prims.cameras import read_spectral_camera
from usdskin.prims.samples import SkinSamples
from usdskin.progress import Progress, SilentProgress
from usdskin.spectrum import Spectrum, band_widths

__all__ = ["SubjectSetup", "SubjectTruth", "lamps", "photograph_subject", "read_subject_truth"]

FloatArray = NDArray[np.float64]
FloatImage = NDArray[np.float32]

_BRIGHTEST = 0.85  # of white, in the shortest exposure
_SATURATED = 0.97
_STEP = 4.0  # between exposures


def lamps(count: int = 24) -> tuple[Orientation, ...]:
    """Return where a lamp is put, one place after another, evenly around a subject.

    Args:
        count: How many places.
    """
    elevation = (-30.0, 10.0, 50.0)
    return tuple(
        ((index + 0.5) * 360.0 / count, elevation[index % len(elevation)]) for index in range(count)
    )


@dataclass(frozen=True, slots=True, eq=False)
class SubjectSetup:
    """One way to light and photograph a subject; every value has a default that works."""

    prim_path: str | None = None
    """Prim that holds the subject; None: all of the stage."""

    material: str | None = None
    """Path of its skin; None: the stage's only one."""

    lights: tuple[Orientation, ...] = lamps()
    """Azimuth from the front and elevation of the lamp, for every picture of a view [deg]."""

    views: tuple[Orientation, ...] = ((0.0, 0.0), (45.0, 10.0))
    """Azimuth from the front and elevation of the camera [deg]."""

    illuminance_lx: float = 2000.0
    """On a surface that faces the lamp [lx]."""

    size: int = 96
    """Width and height of the photographs [px]."""

    samples_per_pixel: int = 16
    """Samples per pixel."""

    exposures: Exposures | None = None
    """The bracket of every photograph; None: two, so that the brightest pixel of all is well
    exposed in the shorter one."""

    as_images: bool = False
    """Whether pictures in camera values (EXR) are written, not brackets."""

    wavelength_nm: FloatArray | None = None
    """Bands that are rendered [nm]; None: the camera's."""

    states_white: bool = True
    """Whether the layer states the reading of a white target."""

    calibration: Path | None = None
    """Layer with the calibrated camera, which the samples then name."""

    light_class: str = ""
    """Class of the light, as the calibration names it."""

    def check(self) -> None:
        """Refuse what cannot be photographed.

        Raises:
            UsageError: A value is out of range; the message names it.
        """
        ranges = {
            "number of lights": (len(self.lights), 1, 10000),
            "number of views": (len(self.views), 1, 1000),
            "illuminance": (self.illuminance_lx, 1e-6, 1e9),
            "size": (self.size, 8, 1 << 13),
            "samples per pixel": (self.samples_per_pixel, 1, 1 << 14),
        }
        for name, (value, least, most) in ranges.items():
            if not least <= value <= most:
                raise UsageError(f"{name} is {value:g}; give {least:g} to {most:g}")
        if self.exposures is not None:
            self.exposures.check()


def _check_class(calibration: Path, light_class: str) -> None:
    """Refuse a calibration that does not tell which of its classes the lamp is of."""
    opened = open_stage(calibration)
    known = [recovery.light_class for recovery in read_spectral_camera(opened).recoveries]
    if light_class not in known and (light_class or len(known) > 1):
        said = f"has no class {light_class!r}" if light_class else "has several classes"
        raise UsageError(f"{calibration}: {said}; name one with --light-class: {', '.join(known)}")


def photograph_subject(
    stage: str | Path,
    output: str | Path,
    setup: Setup | None = None,
    shoot: SubjectSetup | None = None,
    *,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Path:
    """Photograph the subject of a stage in the light of one lamp at many places.

    Args:
        stage: Stage with shapes and one skin material.
        output: Folder to write, new or empty.
        setup: The camera: sensitivities, sensor, constant, kind of file, seed; and the lamp.
        shoot: How subject, lamp and camera stand.
        threads: Threads to compute with; all cores where None. They change nothing but the time.
        progress: Told how far the work is.

    Returns:
        ``samples.usda`` in the folder. The folder is complete or not there.

    Raises:
        LayerError: The stage cannot be read or has no subject, or the folder cannot be written.
        ImageError: A picture cannot be written.
        UsageError: The set-up makes no sense, or the folder holds something.
    """
    setup, shoot = setup or Setup(), shoot or SubjectSetup()
    setup.check()
    shoot.check()
    output, progress = Path(output), progress or SilentProgress()
    if shoot.calibration is not None:
        _check_class(shoot.calibration, shoot.light_class)
    subject = read_subject(Path(stage), shoot.prim_path, shoot.material)
    camera = read_sensitivity(setup.camera)
    with new_folder(output) as folder:
        try:
            session = _Session(
                subject, setup, shoot, camera, folder, output, threads or os.cpu_count() or 1
            )
            session.run(progress)
        finally:
            progress.done()
    return output / "samples.usda"


@dataclass(frozen=True, slots=True, eq=False)
class _Session:
    """One shoot on its way."""

    subject: Subject
    setup: Setup
    shoot: SubjectSetup
    camera: CameraSensitivity
    folder: Path
    final: Path
    threads: int

    def run(self, progress: Progress) -> None:
        """Render, photograph and describe."""
        shoot = self.shoot
        nm = self.camera.wavelength_nm if shoot.wavelength_nm is None else shoot.wavelength_nm
        weights = self._weights(nm)
        lamp = lamp_irradiance(
            nm,
            illuminant(self.setup.illuminant or "D55", nm),
            xyz_weights(nm, absolute=True)[:, 1],
            shoot.illuminance_lx,
        )
        white = lamp.resample(nm) @ weights / np.pi
        constant = self.setup.sensor_constant
        if constant is None:
            constant = self.setup.middle / (white[1] * _middle(self.setup))
        images = self._camera_values(nm, weights * constant, lamp, progress)
        setup = replace(self.setup, exposures=self._exposures(images), camera=self.setup.camera)
        shots = self._photograph(images, setup)
        saturation = _SATURATED / float(setup.exposures_of(0).exposure.min())
        stated = SkinSamples(
            white=constant * white if shoot.states_white else None,
            saturation=saturation,
            light_class=shoot.light_class,
        )
        write_samples(
            self.folder / "samples.usda",
            self.subject,
            setup,
            shots,
            lamp,
            stated,
            shoot.calibration,
            self.final,
        )
        facts = {
            "sensorConstant": float(constant),
            "camera": self.camera.name,
            "illuminanceLux": float(shoot.illuminance_lx),
            "fullWell": setup.sensor.full_well,
            "readNoise": setup.sensor.read_noise,
            "seed": setup.seed,
        }
        write_subject_truth(
            self.folder / "truth", self.subject, constant * white, facts, self.final / "truth"
        )

    def _weights(self, nm: FloatArray) -> FloatArray:
        """Return what makes camera values of spectra, but for the constant, shape [n, 3]."""
        known = self.camera.wavelength_nm
        value = np.stack([np.interp(nm, known, row, 0.0, 0.0) for row in self.camera.value.T], -1)
        return np.asarray(value * band_widths(nm)[:, None])

    def _camera_values(
        self, nm: FloatArray, weights: FloatArray, lamp: Spectrum, progress: Progress
    ) -> list[FloatImage]:
        """Return true camera values of every photograph, view by view."""
        shoot, subject = self.shoot, self.subject
        mask = None if subject.prim_path is None else (subject.prim_path,)
        how = Rendering(shoot.size, shoot.samples_per_pixel, self.threads, nm, mask)
        (self.folder / "geometry").mkdir()
        images = []
        with tempfile.TemporaryDirectory() as scratch:
            stage = Path(scratch) / "set.usda"
            write_set(stage, subject, lamp, shoot.lights, shoot.views)
            for view in range(len(shoot.views)):
                count = len(shoot.lights)
                geometry = self._geometry(view)
                for spectra in render_views(
                    stage, view, count, how, geometry, Path(scratch), progress
                ):
                    images.append((spectra.astype(np.float64) @ weights).astype(np.float32))
        return images

    def _geometry(self, view: int) -> Path:
        return self.folder / "geometry" / f"view{view}.exr"

    def _exposures(self, images: list[FloatImage]) -> Exposures:
        if self.shoot.exposures is not None:
            return self.shoot.exposures
        brightest = max(float(image.max()) for image in images)
        if brightest <= 0.0:
            raise UsageError("no lamp lights the subject; put lamps where the camera sees them")
        shortest = _BRIGHTEST / brightest  # at ISO 100 and f/8
        times = [_STEP * shortest * 64.0, shortest * 64.0]
        return exposure_list(times)

    def _photograph(self, images: list[FloatImage], setup: Setup) -> list[Shot]:
        shoot = self.shoot
        shots = []
        top = self.folder / ("images" if shoot.as_images else "photographs")
        top.mkdir()
        for index, image in enumerate(images):
            view, light = divmod(index, len(shoot.lights))
            name = f"view{view}_light{light:02d}"
            if shoot.as_images:
                files = [top / f"{name}.exr"]
                _write_values(files[0], image, setup, index)
            else:
                (top / name).mkdir()
                count = setup.exposures_of(0).time_s.size
                suffix = KINDS[setup.file_kind].suffix
                files = [top / name / f"{shot:02d}{suffix}" for shot in range(count)]
                for shot, file in enumerate(files):
                    take_photograph(image, setup, file, self.camera.name, index, shot)
            shots.append(Shot(name, view, shoot.lights[light], tuple(files), self._geometry(view)))
        return shots


def _middle(setup: Setup) -> float:
    exposure = setup.exposures_of(0).exposure
    return float(exposure[exposure.size // 2])


def _write_values(path: Path, image: FloatImage, setup: Setup, index: int) -> None:
    """Write the shortest exposure as a picture in camera values."""
    exposures = setup.exposures_of(0)
    shot = int(np.argmin(exposures.exposure))
    exposure, sensor = float(exposures.exposure[shot]), setup.sensor
    random = np.random.default_rng([setup.seed, index, shot])
    raw = sensor.expose(image * np.float32(exposure), float(exposures.iso[shot]), random)
    span = sensor.white_level - sensor.black_level
    values = (raw.astype(np.float32) - sensor.black_level) / np.float32(span * exposure)
    write_exr(path, [Part("", {name: values[..., k] for k, name in enumerate("RGB")})])
