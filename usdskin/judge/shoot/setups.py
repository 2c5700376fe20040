"""What a virtual photographer brings along, and what goes wrong."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError, UsageError
from usdskin.judge.shoot.optics import field_angle
from usdskin.judge.shoot.photo_files import KINDS, Development
from usdskin.judge.shoot.sensitivity import DEFAULT_CAMERA
from usdskin.judge.shoot.sensor import Exposures, Sensor, exposure_series
from usdskin.judge.shoot.viewpoints import THREE_LEVEL, Orientation
from usdskin.layers import open_stage
from usdskin.prims import FisheyeLens, read_lens
from usdskin.render.texels import BadPixels

FloatArray = NDArray[np.float64]

BEGAN = datetime(2026, 3, 20, 12, 0, 0, tzinfo=UTC)
"""When a shoot begins: the hour of its EXIF, always the same."""


def fisheye(
    size: int = 1000,
    projection: str = "equidistant",
    field_of_view_deg: float = 180.0,
    vignetting: tuple[float, ...] = (-0.04, -0.012),
    glare: float = 0.0,
) -> FisheyeLens:
    """Return a lens whose image circle touches the edges of a square picture.

    Args:
        size: Width and height [px].
        projection: ``equidistant``, ``equisolid``, ``stereographic`` or ``orthographic``.
        field_of_view_deg: Whole angle of view [deg].
        vignetting: a2, a4, ... of V.
        glare: Share of light that is spread evenly over the picture.

    Raises:
        UsageError: The projection cannot hold that angle of view.
    """
    half = np.radians(0.5 * field_of_view_deg)
    heights = {
        "equidistant": half,
        "equisolid": 2.0 * np.sin(0.5 * half),
        "stereographic": 2.0 * np.tan(0.5 * half),
        "orthographic": np.sin(half),
    }
    reach = {"orthographic": 90.0, "stereographic": 179.0}.get(projection, 180.0)
    if projection not in heights or not 0.0 < 0.5 * field_of_view_deg <= reach:
        raise UsageError(
            f"no {projection} lens holds {field_of_view_deg:g} degrees; use equidistant, "
            "equisolid, stereographic or orthographic, the last up to 180 degrees"
        )
    return FisheyeLens(
        projection=projection,
        focal_length_px=0.5 * size / float(heights[projection]),
        center_px=np.array([0.5 * size, 0.5 * size]),
        resolution=(size, size),
        max_angle_deg=0.5 * field_of_view_deg,
        vignetting=np.array(vignetting),
        glare=glare,
    )


def lens_of_layer(path: str | Path) -> FisheyeLens:
    """Return the lens that a layer describes.

    Args:
        path: Layer with a Camera that has ``FisheyeCameraAPI``: its default prim, or the first.

    Raises:
        LayerError: The layer cannot be read or has no such Camera.
    """
    stage = open_stage(path)
    found = [stage.GetDefaultPrim(), *stage.Traverse()]
    cameras = [prim for prim in found if prim and prim.HasAPI("FisheyeCameraAPI")]
    if not cameras:
        raise LayerError(
            f"{path}: no Camera has FisheyeCameraAPI; `usdskin calibrate lens` writes such a layer"
        )
    return read_lens(cameras[0])


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """One way to photograph; every value has a default that works."""

    camera: str = DEFAULT_CAMERA
    """Measured camera: a name of colour-science, or a file; see ``read_sensitivity``."""

    illuminant: str | None = None
    """Lamp that RGB light is taken to be; None leaves it to the stage."""

    bad_pixels: BadPixels = "error"
    """Whether pixels of the environment that are no light are refused, or clamped with a note."""

    mean_luminance: float = 100.0
    """Of the sphere [cd m^-2], where the light has no absolute units."""

    lens: FisheyeLens = field(default_factory=fisheye)
    """The lens as it is, its resolution being the camera's."""

    views: tuple[Orientation, ...] = THREE_LEVEL
    """Azimuth and elevation of every view [deg]."""

    exposures: Exposures | tuple[Exposures, ...] = field(default_factory=exposure_series)
    """The bracket of all views, or one for each of them."""

    middle: float = 0.18
    """Mean green of the sphere relative to white, in the middle of the exposures."""

    sensor_constant: float | None = None
    """c of rho = c integral L s dlambda, to use one camera in several lights; None: as ``middle``
    says."""

    sensor: Sensor = field(default_factory=Sensor)
    """The sensor."""

    file_kind: str = "tif"
    """One of ``photo_files.KINDS``."""

    curve: str = "srgb"
    """Tone curve of pictures of 8 bits, one of ``photo_files.CURVES``."""

    vignetting_error: float = 0.0
    """Relative error of the stated V at the largest angle; it grows as phi^2."""

    rotation_error_deg: float = 0.0
    """Angle between true and stated rotation of every view [deg]."""

    shutter_error: float = 0.0
    """Standard deviation of the exposures about what is stated, relative [1]."""

    stated_glare: float | None = None
    """Glare that the shoot states; None: the true one."""

    reading_error: float = 0.0
    """Error that all readings of light share, of the meters and of the spectroradiometer, relative
    [1]: that of the standard they were adjusted to."""

    states_noise: bool = False
    """Whether the shoot states gain and read noise."""

    luminance_direction: tuple[float, float, float] | None = None
    """Where the luminance meter looks, in the world; None: at the most even surface."""

    illuminance_direction: tuple[float, float, float] | None = None
    """Where the illuminance meter faces, in the world; None: up."""

    truth_height: int | None = None
    """Rows of the true panorama; None: those of the light, 256 at least."""

    seed: int = 0
    """Of everything random."""

    def exposures_of(self, view: int) -> Exposures:
        """Return the bracket of a view."""
        return self.exposures if isinstance(self.exposures, Exposures) else self.exposures[view]

    def true_exposure(self, view: int) -> FloatArray:
        """Return the exposures as the shutter gives them [s], shape [count]."""
        stated = self.exposures_of(view).exposure
        random = np.random.default_rng([self.seed, view, 0x5B77])
        return np.asarray(stated * np.exp(self.shutter_error * random.normal(size=stated.size)))

    @property
    def lens_name(self) -> str:
        """Model of the lens, as the photographs name it."""
        return f"{self.lens.projection} fisheye {2.0 * self.lens.max_angle_deg:g} deg"

    @property
    def development(self) -> Development:
        """How raw values become the samples of a file."""
        sensor = self.sensor
        return Development(self.file_kind, self.curve, sensor.black_level, sensor.white_level)

    @property
    def stated_lens(self) -> FisheyeLens:
        """The lens as the shoot states it: V is off by ``vignetting_error`` at the largest angle.

        V_stated = V (1 + error (phi / phi_max)^2), a polynomial like V itself.
        """
        lens = self.lens
        per_square = self.vignetting_error / np.radians(lens.max_angle_deg) ** 2
        product = np.convolve([1.0, *lens.vignetting], [1.0, per_square])
        glare = lens.glare if self.stated_glare is None else self.stated_glare
        vignetting = product[1:] if self.vignetting_error else lens.vignetting
        return replace(lens, vignetting=vignetting, glare=glare)

    def check(self) -> None:
        """Refuse what cannot be photographed.

        Raises:
            UsageError: A value is out of range; the message names it.
        """
        sensor = self.sensor
        if not self.views:
            raise UsageError("a shoot needs at least one view")
        if not isinstance(self.exposures, Exposures) and len(self.exposures) != len(self.views):
            raise UsageError(
                f"{len(self.exposures)} brackets for {len(self.views)} views; give one for each"
            )
        for view in range(len(self.views)):
            self.exposures_of(view).check()
        if not 1 <= sensor.bits <= 16 or not 0 <= sensor.black_level < sensor.white_level:
            raise UsageError(
                f"a sensor of {sensor.bits} bits with a black level of {sensor.black_level} DN has "
                "no range; give 1 to 16 bits and a black level below white"
            )
        ranges = {
            "full well": (sensor.full_well, 1.0, np.inf),
            "read noise": (sensor.read_noise, 0.0, np.inf),
            "glare": (self.lens.glare, 0.0, 0.5),
            "stated glare": (self.stated_lens.glare, 0.0, 0.5),
            "vignetting error": (self.vignetting_error, -0.9, 10.0),
            "shutter error": (self.shutter_error, 0.0, 1.0),
            "rotation error": (self.rotation_error_deg, 0.0, 180.0),
            "mean luminance": (self.mean_luminance, 1e-9, np.inf),
            "error of the readings": (self.reading_error, -0.9, 10.0),
            "exposure of the middle": (self.middle, 1e-9, np.inf),
            "sensor constant": (self.sensor_constant or 1.0, 1e-300, np.inf),
            "height of the truth": (self.truth_height or 1, 1, 1 << 15),
            "width": (self.lens.resolution[0], 1, 1 << 15),
            "height": (self.lens.resolution[1], 1, 1 << 15),
            "largest angle": (self.lens.max_angle_deg, 1e-3, 180.0),
        }
        for name, (value, least, most) in ranges.items():
            if not (least <= value <= most) or not np.isfinite(value):
                raise UsageError(f"{name} is {value:g}; give {least:g} to {most:g}")
        field_angle(self.lens)
        _ = self.development


def view_name(view: int) -> str:
    """Return the name of a view's prim and folder."""
    return f"view{view}"


def photograph_name(setup: Setup, view: int, shot: int) -> Path:
    """Return where a photograph lies in the folder of the shoot."""
    return Path(view_name(view)) / f"{shot:02d}{KINDS[setup.file_kind].suffix}"


def exif(setup: Setup, camera: str, view: int, shot: int) -> dict[str, Any]:
    """Return what the camera writes into a photograph, by OpenImageIO's names.

    Args:
        setup: How it was taken.
        camera: Make and model.
        view: Index of the view; they are five minutes apart.
        shot: Index of the photograph in its bracket.
    """
    exposures = setup.exposures_of(view)
    passed = float(exposures.time_s[:shot].sum()) + 2.0 * shot
    moment = BEGAN + timedelta(minutes=5 * view, seconds=passed)
    return {
        "Make": camera.split()[0],
        "Model": camera,
        "Exif:LensModel": setup.lens_name,
        "DateTime": moment.strftime("%Y:%m:%d %H:%M:%S"),
        "Exif:DateTimeOriginal": moment.strftime("%Y:%m:%d %H:%M:%S"),
        "Exif:OffsetTimeOriginal": "+00:00",
        "Exif:SubsecTimeOriginal": f"{moment.microsecond // 1000:03d}",
        "ExposureTime": float(exposures.time_s[shot]),
        "FNumber": float(exposures.f_number[shot]),
        # OpenImageIO leaves the first of these out of TIFF files, so the second is there too.
        "Exif:PhotographicSensitivity": round(float(exposures.iso[shot])),
        "Exif:ISOSpeed": round(float(exposures.iso[shot])),
        "Exif:SensitivityType": 3,  # ISO speed
        "Orientation": 1,
    }
