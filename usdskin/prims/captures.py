"""``CaptureAPI``, ``FisheyeCameraAPI`` and ``ExposureBracketAPI`` <-> ``Shoot`` and its views."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.writing import write_schema

FloatArray = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class FisheyeLens:
    """A fisheye projection; image x runs right, y down, from the corner of the first pixel."""

    projection: str
    """``equidistant``, ``equisolid``, ``stereographic``, ``orthographic`` or ``opencv``."""

    focal_length_px: float
    """f [px]."""

    center_px: FloatArray
    """Where the optical axis meets the image [px], shape [2]."""

    resolution: tuple[int, int]
    """Width and height of the pictures these numbers refer to [px]."""

    distortion: FloatArray = field(default_factory=lambda: np.zeros(4))
    """k1 .. k4 of ``opencv`` [1], shape [4]."""

    max_angle_deg: float = 90.0
    """Largest angle from the axis that holds picture [deg]."""

    vignetting: FloatArray = field(default_factory=lambda: np.zeros(0))
    """a2, a4, ... of V(phi) = 1 + a2 phi^2 + a4 phi^4 + ..., phi in radians [1]."""

    glare: float = 0.0
    """Share of the light that is spread evenly over the picture [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class ExposureBracket:
    """The photographs of one view; every array has one value per image unless it says otherwise."""

    images: tuple[Path, ...]
    """The photographs."""

    exposure_time_s: FloatArray
    """Exposure times [s], shape [image_count]."""

    iso: FloatArray
    """Sensitivity settings [1], shape [image_count]."""

    f_number: FloatArray
    """F-numbers [1], shape [image_count]."""

    nd_factor: FloatArray
    """Attenuation of neutral density filters, at least 1 [1], shape [image_count]."""

    black_level: FloatArray
    """Raw value without light [DN], shape [1] or [3]."""

    white_level: FloatArray | None = None
    """Raw value at saturation [DN], shape [1] or [3]; None: what the files say."""

    gain: FloatArray | None = None
    """Electrons per raw value [DN^-1], shape [image_count]; None: to be measured."""

    read_noise: FloatArray | None = None
    """Standard deviation without light [DN], shape [image_count]; None: to be measured."""

    transfer: str = "auto"
    """``auto``, ``linear`` or ``recovered``."""

    response_file: Path | None = None
    """Text file of the inverse response, which wins over ``transfer``."""

    dark_file: Path | None = None
    """Photograph with the lens covered."""

    flat_file: Path | None = None
    """Photograph of an even field."""

    @property
    def exposure(self) -> FloatArray:
        """Exposure of each image, t (ISO / 100) / N^2 / ND [s], shape [image_count].

        Camera values rho are (DN - black) / (white - black) divided by it.
        """
        return np.asarray(
            self.exposure_time_s * (self.iso / 100.0) / self.f_number**2 / self.nd_factor
        )


@dataclass(frozen=True, slots=True, eq=False)
class Shot:
    """Photographs by a camera whose projection does not matter."""

    name: str
    """Name of the prim."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    bracket: ExposureBracket
    """The photographs."""

    lens: FisheyeLens | None = None
    """Its projection, where it is a calibrated fisheye."""


@dataclass(frozen=True, slots=True, eq=False)
class View:
    """A camera of a shoot, at one orientation."""

    name: str
    """Name of the prim."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    lens: FisheyeLens
    """Its projection."""

    bracket: ExposureBracket
    """Its photographs."""

    rotation: FloatArray
    """Rotation from the camera (looks along -Z, +Y up) to the world of the stage: world = R @ ray,
    shape [3, 3]."""


class Bracketed(Protocol):
    """What was photographed with an exposure bracket: a ``View`` or a ``Shot``."""

    @property
    def name(self) -> str:
        """Name of the prim."""

    @property
    def where(self) -> str:
        """``layer.usda </Prim/path>``, for errors."""

    @property
    def bracket(self) -> ExposureBracket:
        """Its photographs."""


@dataclass(frozen=True, slots=True, eq=False)
class Shoot:
    """One session of photographs of one place."""

    where: str
    """``layer.usda </Prim/path>``, for errors."""

    name: str
    """Name of the prim."""

    views: tuple[View, ...]
    """The views, in the order of ``capture:views`` or of the stage."""

    up_axis: str = "Y"
    """``Y`` or ``Z``, the stage's."""

    session: str = ""
    """Name of the session."""

    device: str = ""
    """Camera and lens, and what they stood on."""

    time: str = ""
    """When the session began, ISO 8601."""

    model: str = ""
    """Model of the camera."""

    lens: str = ""
    """Model of the lens."""

    white_balance: str = ""
    """White balance and color matrix applied to the pictures; empty for raw values."""

    illuminance_lx: float = 0.0
    """Reading of an illuminance meter [lx]; 0: not taken."""

    illuminance_direction: FloatArray | None = None
    """Where the meter faced, unit vector in the stage's world, shape [3]."""

    luminance: float = 0.0
    """Reading of a luminance meter [cd m^-2]; 0: not taken."""

    luminance_direction: FloatArray | None = None
    """Where the meter looked, unit vector in the stage's world, shape [3]."""

    luminance_weights: FloatArray = field(default_factory=lambda: np.array([0.0, 1.0, 0.0]))
    """Weights of R, G, B that make a luminance of camera values [1], shape [3]."""

    iso: FloatArray | None = None
    """ISO settings of the photographs, ascending; None: at least one view does not state it."""


def read_shoot(stage: Usd.Stage) -> Shoot:
    """Return the shoot a stage describes.

    Args:
        stage: Stage with one prim that has ``CaptureAPI``: the default prim, or the only one.

    Raises:
        LayerError: There is no such prim or several, it has no views, or an opinion cannot be used.
    """
    prim = capture_prim(stage)
    check_applied_schemas(prim)
    values = read_schema(prim, "CaptureAPI", DEFAULT_TIME)
    cameras = _view_prims(prim)
    views = tuple(read_view(camera) for camera in cameras)
    if not views:
        raise LayerError(
            f"{describe(prim)}: has no views; put Cameras with ExposureBracketAPI below it, or "
            "name them in capture:views"
        )
    names = [view.name for view in views]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice:
        raise LayerError(f'{describe(prim)}: two views are called "{twice}"; rename one')
    return Shoot(
        where=describe(prim),
        name=prim.GetName(),
        views=views,
        up_axis=str(UsdGeom.GetStageUpAxis(stage)),
        session=values["capture:session"],
        device=values["capture:device"],
        time=values["capture:time"],
        model=values["capture:settings:model"],
        lens=values["capture:settings:lens"],
        white_balance=values["capture:settings:whiteBalance"],
        illuminance_lx=values["capture:illuminance"],
        illuminance_direction=reading_direction(prim, values["capture:illuminance:direction"]),
        luminance=values["capture:luminance"],
        luminance_direction=reading_direction(prim, values["capture:luminance:direction"]),
        luminance_weights=_weights(prim, values["capture:luminanceWeights"]),
        iso=_stated_iso(cameras, views),
    )


def _stated_iso(cameras: list[Usd.Prim], views: tuple[View, ...]) -> FloatArray | None:
    if not all(camera.GetAttribute("bracket:iso").HasAuthoredValue() for camera in cameras):
        return None
    return np.unique(np.concatenate([view.bracket.iso for view in views]))


def capture_prim(stage: Usd.Stage) -> Usd.Prim:
    """Return the prim of a stage's capture: the default prim, or the only one with ``CaptureAPI``.

    Raises:
        LayerError: There is no such prim, or several.
    """
    default = stage.GetDefaultPrim()
    if default and default.HasAPI("CaptureAPI"):
        return default
    found = [prim for prim in stage.Traverse() if prim.HasAPI("CaptureAPI")]
    name = stage.GetRootLayer().GetDisplayName()
    if not found:
        raise LayerError(
            f"{name}: no prim has CaptureAPI; `usdskin ingest` writes a shoot from a folder of "
            "photographs"
        )
    if len(found) > 1:
        listed = ", ".join(f"<{prim.GetPath()}>" for prim in found)
        raise LayerError(f"{name}: several prims have CaptureAPI ({listed}); set defaultPrim")
    return found[0]


def _view_prims(prim: Usd.Prim) -> list[Usd.Prim]:
    targets = prim.GetRelationship("capture:views").GetTargets()
    if not targets:
        return [below for below in Usd.PrimRange(prim) if below.HasAPI("ExposureBracketAPI")]
    cameras = [prim.GetStage().GetPrimAtPath(path) for path in targets]
    for path, camera in zip(targets, cameras, strict=True):
        if not camera or not camera.HasAPI("ExposureBracketAPI"):
            raise LayerError(
                f"{describe(prim)}: capture:views names <{path}>, which is no Camera with "
                "ExposureBracketAPI; correct the path"
            )
    return cameras


def read_view(prim: Usd.Prim) -> View:
    """Return one view.

    Args:
        prim: Camera with ``FisheyeCameraAPI`` and ``ExposureBracketAPI``.

    Raises:
        LayerError: An opinion is missing or cannot be used.
    """
    check_applied_schemas(prim)
    return View(
        name=prim.GetName(),
        where=describe(prim),
        lens=read_lens(prim),
        bracket=read_bracket(prim),
        rotation=_rotation(prim),
    )


def read_shot(prim: Usd.Prim) -> Shot:
    """Return the photographs of a camera.

    Raises:
        LayerError: An opinion is missing or cannot be used.
    """
    check_applied_schemas(prim)
    lens = read_lens(prim) if prim.HasAPI("FisheyeCameraAPI") else None
    return Shot(prim.GetName(), describe(prim), read_bracket(prim), lens)


def read_lens(prim: Usd.Prim) -> FisheyeLens:
    """Return the calibrated fisheye projection of a camera.

    Raises:
        LayerError: The camera has none, or an opinion cannot be used.
    """
    if not prim.HasAPI("FisheyeCameraAPI"):
        raise LayerError(
            f"{describe(prim)}: has no FisheyeCameraAPI; reference a lens that `usdskin calibrate "
            "lens` wrote, or author it"
        )
    values = read_schema(prim, "FisheyeCameraAPI", DEFAULT_TIME)
    for name in ("fisheye:focalLength", "fisheye:center", "fisheye:resolution"):
        if values[name] is None or not np.any(values[name]):
            text = "has no value; the lens is not calibrated: see `usdskin calibrate lens`"
            raise PrimError(prim, Problem("missing-value", name, text))
    width, height = (int(value) for value in values["fisheye:resolution"])
    vignetting = values["fisheye:vignetting"]
    return FisheyeLens(
        projection=values["fisheye:projection"],
        focal_length_px=values["fisheye:focalLength"],
        center_px=values["fisheye:center"],
        resolution=(width, height),
        distortion=values["fisheye:distortion"],
        max_angle_deg=values["fisheye:maxAngle"],
        vignetting=np.zeros(0) if vignetting is None else vignetting,
        glare=values["fisheye:glare"],
    )


def read_bracket(prim: Usd.Prim) -> ExposureBracket:
    """Return the exposure bracket of a camera.

    Raises:
        LayerError: The camera has none, or an opinion is missing or cannot be used.
    """
    values = read_schema(prim, "ExposureBracketAPI", DEFAULT_TIME)
    images = values["bracket:images"]
    if not images or None in images:
        text = "names no photographs; list those of the view"
        raise PrimError(prim, Problem("missing-value", "bracket:images", text))
    for name in ("bracket:exposureTimes", "bracket:iso", "bracket:fNumbers"):
        if values[name] is None or len(values[name]) == 0:
            text = "has no value; copy it from the photographs' EXIF, or from the shooting notes"
            raise PrimError(prim, Problem("missing-value", name, text))

    def per_image(name: str, fallback: float) -> FloatArray:
        given = optional(name)
        return np.full(len(images), fallback) if given is None else given

    def optional(name: str) -> FloatArray | None:
        given = values[name]
        if given is None or len(given) == 0:
            return None
        return np.broadcast_to(given, len(images)).astype(np.float64)

    black = _levels(values["bracket:blackLevel"])
    return ExposureBracket(
        images=tuple(images),
        exposure_time_s=values["bracket:exposureTimes"],
        iso=per_image("bracket:iso", 100.0),
        f_number=per_image("bracket:fNumbers", 1.0),
        nd_factor=per_image("bracket:ndFactors", 1.0),
        black_level=np.zeros(1) if black is None else black,
        white_level=_levels(values["bracket:whiteLevel"]),
        gain=optional("bracket:gain"),
        read_noise=optional("bracket:readNoise"),
        transfer=values["bracket:transfer"],
        response_file=values["bracket:response:file"],
        dark_file=values["bracket:dark:file"],
        flat_file=values["bracket:flat:file"],
    )


def _levels(given: FloatArray | None) -> FloatArray | None:
    return None if given is None or len(given) == 0 else given


def _matrix(prim: Usd.Prim) -> FloatArray:
    """Return the rotation and scale from a prim to the world, column vectors, shape [3, 3]."""
    cache = UsdGeom.XformCache(DEFAULT_TIME)
    return np.array(cache.GetLocalToWorldTransform(prim), dtype=np.float64)[:3, :3].T


def _rotation(prim: Usd.Prim) -> FloatArray:
    matrix = _matrix(prim)
    lengths = np.linalg.norm(matrix, axis=0)
    if not np.isfinite(lengths).all() or lengths.min() <= 0.0:
        raise LayerError(f"{describe(prim)}: its transform is singular; give it a rotation")
    rotation = matrix / lengths
    off = np.abs(rotation.T @ rotation - np.eye(3)).max()
    if off > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0.0:
        what = "is mirrored" if np.linalg.det(rotation) < 0.0 else "is sheared"
        raise LayerError(
            f"{describe(prim)}: its transform {what}; a view is placed by a rotation alone"
        )
    # Transforms in single precision are a rotation to 1e-7 only.
    left, _, right = np.linalg.svd(rotation)
    return np.asarray(left @ right)


def reading_direction(prim: Usd.Prim, given: FloatArray | None) -> FloatArray | None:
    """Return the direction of a meter in the world.

    Args:
        prim: Prim with ``CaptureAPI``.
        given: Direction in the prim's own frame, shape [3], or None.

    Returns:
        Unit vector, shape [3], or None.
    """
    if given is None:
        return None
    to_world = _matrix(prim)
    # A normal to a plane turns as the plane does; a meter's direction is one.
    world = np.linalg.inv(to_world).T @ given
    return np.asarray(world / np.linalg.norm(world))


def _weights(prim: Usd.Prim, given: FloatArray) -> FloatArray:
    if (given < 0.0).any() or not given.any():
        text = f"is {tuple(float(value) for value in given)}; give three weights of which none is "
        text += "negative and one is above 0"
        raise PrimError(prim, Problem("out-of-range", "capture:luminanceWeights", text))
    return given


def write_lens(prim: Usd.Prim, lens: FisheyeLens) -> None:
    """Apply ``FisheyeCameraAPI`` to a camera and author a lens.

    Raises:
        LayerError: The prim is no camera.
    """
    write_schema(
        prim,
        "FisheyeCameraAPI",
        {
            "fisheye:projection": lens.projection,
            "fisheye:focalLength": float(lens.focal_length_px),
            "fisheye:center": Gf.Vec2d(*(float(value) for value in lens.center_px)),
            "fisheye:resolution": Gf.Vec2i(*(int(value) for value in lens.resolution)),
            "fisheye:distortion": Gf.Vec4d(*(float(value) for value in lens.distortion)),
            "fisheye:maxAngle": float(lens.max_angle_deg),
            "fisheye:vignetting": lens.vignetting if len(lens.vignetting) else None,
            "fisheye:glare": float(lens.glare),
        },
    )


def write_bracket(
    prim: Usd.Prim, bracket: ExposureBracket, folder: str | Path | None = None
) -> None:
    """Apply ``ExposureBracketAPI`` to a camera and author its photographs and their settings.

    Args:
        prim: Camera, written at the stage's edit target.
        bracket: What to write.
        folder: Folder the layer is going to be written to; see ``write_schema``.

    Raises:
        LayerError: The prim is no camera, or a file cannot be named from the layer.
    """
    write_schema(
        prim,
        "ExposureBracketAPI",
        {
            "bracket:images": list(bracket.images),
            "bracket:exposureTimes": bracket.exposure_time_s,
            "bracket:iso": bracket.iso,
            "bracket:fNumbers": bracket.f_number,
            "bracket:ndFactors": bracket.nd_factor,
            "bracket:blackLevel": bracket.black_level,
            "bracket:whiteLevel": bracket.white_level,
            "bracket:gain": bracket.gain,
            "bracket:readNoise": bracket.read_noise,
            "bracket:transfer": bracket.transfer,
            "bracket:response:file": bracket.response_file,
            "bracket:dark:file": bracket.dark_file,
            "bracket:flat:file": bracket.flat_file,
        },
        folder,
    )


def write_rotation(prim: Usd.Prim, rotation: FloatArray) -> None:
    """Give a camera its rotation, as one ``xformOp:orient`` in double precision.

    Args:
        prim: Camera whose parents do not turn it.
        rotation: From the camera to its parent: parent = R @ ray, shape [3, 3].
    """
    transform = Gf.Matrix4d(1.0)
    transform.SetRotateOnly(Gf.Matrix3d(*(float(value) for value in np.ravel(rotation.T))))
    camera = UsdGeom.Xformable(prim)
    camera.ClearXformOpOrder()
    orient = camera.AddOrientOp(UsdGeom.XformOp.PrecisionDouble)
    orient.Set(transform.ExtractRotationQuat().GetNormalized())
