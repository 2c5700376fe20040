"""Read a UsdGeomCamera into what a renderer needs: a frame, a window and a clipping range.

Reads: a Camera prim at a time, the stage's metersPerUnit, and the picture's size and aspect policy.

A camera looks along its own -Z with +Y up. Apertures and focal length are in tenths of a scene
unit, whatever the unit is (UsdGeomCamera, "Units of Measure").
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Sdf, Usd, UsdGeom

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.notes import Note

_TENTHS = 0.1
_SCALE_TOLERANCE = 1e-4
_LIST_LIMIT = 10
_EXPOSURE_LIMIT = 1e18  # of the linear factor: pictures hold float32
_EXPOSURE_FACTORS = ("exposure:time", "exposure:iso", "exposure:fStop", "exposure:responsivity")


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A camera as it sees one picture."""

    path: str
    """Prim path."""

    to_world: NDArray[np.float64]
    """Rigid camera-to-world transform of column vectors [m], shape [4, 4]."""

    orthographic: bool
    """Whether rays are parallel to -Z, instead of starting at the camera."""

    window: tuple[float, float, float, float]
    """Left, right, bottom, top edge of the picture on the camera's plane: tangents (lengths at unit
    distance) of a perspective camera, [m] of an orthographic one."""

    clip_near: float
    """Distance along -Z from which things are seen [m]."""

    clip_far: float
    """Distance along -Z up to which things are seen [m]."""

    lens_radius: float
    """Radius of the aperture [m]; 0 for a pinhole, from which everything is sharp."""

    focus_distance: float
    """Distance along -Z of the plane that is sharp [m]."""

    exposure_scale: float
    """Factor from scene radiance to pixel values [1]."""

    pixel_aspect_ratio: float
    """Width over height of a pixel, as the picture's header must say it [1]."""

    def rays(self) -> tuple[object, ...]:
        """Return what its rays depend on: cameras of equal ones see the same."""
        lens = self.lens_radius, self.focus_distance
        clip = self.clip_near, self.clip_far
        return self.to_world.tobytes(), self.orthographic, self.window, clip, lens


def find_camera(
    stage: Usd.Stage, requested: str | Sdf.Path | None = None, settings: Usd.Prim | None = None
) -> Usd.Prim:
    """Return the camera to render from.

    Args:
        stage: Stage to look in, instances included.
        requested: Path of the prim, or its name where only one camera has it.
        settings: RenderProduct or RenderSettings whose ``camera`` decides where none is requested.

    Returns:
        The camera requested, else the one of the settings, else the only one of the stage.

    Raises:
        LayerError: There is no such camera, or no one camera to choose.
    """
    name = stage.GetRootLayer().GetDisplayName()
    if requested:
        return _requested_camera(stage, str(requested))
    if settings:
        relationship = settings.GetRelationship("camera")
        targets = relationship.GetForwardedTargets() if relationship else []
        if targets:
            return _requested_camera(stage, str(targets[0]))
    # The views of a capture that lights the stage are no cameras to render from.
    cameras = [prim for prim in _cameras(stage) if not prim.HasAPI("FisheyeCameraAPI")]
    if len(cameras) == 1:
        return cameras[0]
    if not cameras:
        raise LayerError(
            f"{name}: the stage has no camera; add one, such as 'def Camera \"cam\"', or sublayer "
            "a layer that holds one."
        )
    raise LayerError(
        f"{name}: {len(cameras)} cameras ({_paths(cameras)}); choose one with -cam PATH."
    )


def read_camera(
    stage: Usd.Stage,
    path: str | Sdf.Path,
    time: Usd.TimeCode,
    resolution: tuple[int, int],
    pixel_aspect_ratio: float = 1.0,
    conform_policy: str = "expandAperture",
    notes: list[Note] | None = None,
    depth_of_field: bool = True,
) -> Camera:
    """Return a camera as it sees one picture.

    Args:
        stage: Stage of the camera.
        path: Prim path of the camera.
        time: Time to read it at.
        resolution: Columns and rows of the picture.
        pixel_aspect_ratio: Width over height of a pixel [1].
        conform_policy: What gives way where aperture and picture differ in aspect
            (``aspectRatioConformPolicy``).
        notes: Takes what the picture will not show: depth of field, clipping planes, scale.
        depth_of_field: Whether the lens has an opening; all is sharp otherwise.

    Raises:
        LayerError: No camera there, or a value of it that gives no picture.
    """
    prim = stage.GetPrimAtPath(path)
    if not prim or not prim.IsA(UsdGeom.Camera):
        raise LayerError(f"{stage.GetRootLayer().GetDisplayName()} <{path}>: no Camera prim.")
    notes = [] if notes is None else notes
    camera = UsdGeom.Camera(prim)
    meters_per_unit = UsdGeom.GetStageMetersPerUnit(stage)
    orthographic = camera.GetProjectionAttr().Get(time) == UsdGeom.Tokens.orthographic

    width, height, pixel_aspect_ratio = conform_aperture(
        _positive(camera.GetHorizontalApertureAttr(), time),
        _positive(camera.GetVerticalApertureAttr(), time),
        resolution,
        pixel_aspect_ratio,
        conform_policy,
    )
    # Tenths of a unit cancel in a perspective camera's tangents.
    focal_length = 1.0 if orthographic else _positive(camera.GetFocalLengthAttr(), time)
    scale = _TENTHS * meters_per_unit if orthographic else 1.0 / focal_length
    x = _finite(camera.GetHorizontalApertureOffsetAttr(), time)
    y = _finite(camera.GetVerticalApertureOffsetAttr(), time)
    edges = (x - 0.5 * width, x + 0.5 * width, y - 0.5 * height, y + 0.5 * height)
    near, far = _clipping_range(camera, time, orthographic)
    pinhole = orthographic or not depth_of_field
    lens_radius, focus = _thin_lens(camera, time, pinhole, meters_per_unit, notes)
    _note_what_is_ignored(camera, time, notes)
    return Camera(
        path=str(prim.GetPath()),
        to_world=_to_world(prim, time, meters_per_unit, notes),
        orthographic=orthographic,
        window=(edges[0] * scale, edges[1] * scale, edges[2] * scale, edges[3] * scale),
        clip_near=near * meters_per_unit,
        clip_far=far * meters_per_unit,
        lens_radius=lens_radius,
        focus_distance=focus,
        exposure_scale=_exposure_scale(camera, time),
        pixel_aspect_ratio=pixel_aspect_ratio,
    )


def _thin_lens(
    camera: UsdGeom.Camera,
    time: Usd.TimeCode,
    pinhole: bool,
    meters_per_unit: float,
    notes: list[Note],
) -> tuple[float, float]:
    """Return the radius of the aperture and the distance of focus [m]; (0, 1) for a pinhole.

    The aperture's diameter is the focal length over fStop; fStop 0 turns depth of field off.
    """
    f_stop = _finite(camera.GetFStopAttr(), time)
    if f_stop <= 0.0 or pinhole:
        return 0.0, 1.0
    focus = _finite(camera.GetFocusDistanceAttr(), time) * meters_per_unit
    if focus <= 0.0:
        message = f"fStop is {f_stop:g} without a focusDistance; the picture is sharp everywhere."
        notes.append(Note("depth-of-field-ignored", str(camera.GetPath()), message))
        return 0.0, 1.0
    focal_length = _positive(camera.GetFocalLengthAttr(), time) * _TENTHS * meters_per_unit
    return focal_length / (2.0 * f_stop), focus


def conform_aperture(
    width: float,
    height: float,
    resolution: tuple[int, int],
    pixel_aspect_ratio: float,
    policy: str,
) -> tuple[float, float, float]:
    """Return aperture width, height and pixel aspect ratio that fit a picture.

    The rules are those of UsdRenderSettingsBase's ``aspectRatioConformPolicy``; the aperture's
    centre stays.

    Args:
        width: Aperture width, any unit.
        height: Aperture height, the same unit.
        resolution: Columns and rows of the picture.
        pixel_aspect_ratio: Width over height of a pixel [1].
        policy: Name of the policy.

    Raises:
        ValueError: An unknown policy, or a picture without pixels.
    """
    columns, rows = resolution
    if columns < 1 or rows < 1 or not 0.0 < pixel_aspect_ratio < math.inf:
        raise ValueError(f"no picture: {columns} x {rows}, pixel aspect {pixel_aspect_ratio}")
    picture_aspect = pixel_aspect_ratio * columns / rows
    too_wide = width / height > picture_aspect
    if policy == "adjustPixelAspectRatio":
        return width, height, width / height * rows / columns
    width_gives_way = {
        "adjustApertureWidth": True,
        "adjustApertureHeight": False,
        "expandAperture": not too_wide,
        "cropAperture": too_wide,
    }
    if policy not in width_gives_way:
        raise ValueError(f"unknown aspect ratio conform policy {policy!r}")
    if width_gives_way[policy]:
        return height * picture_aspect, height, pixel_aspect_ratio
    return width, width / picture_aspect, pixel_aspect_ratio


def _cameras(stage: Usd.Stage) -> list[Usd.Prim]:
    prims = Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies())
    return [prim for prim in prims if prim.IsA(UsdGeom.Camera)]


def _requested_camera(stage: Usd.Stage, requested: str) -> Usd.Prim:
    name = stage.GetRootLayer().GetDisplayName()
    if requested.startswith("/"):
        valid = Sdf.Path.IsValidPathString(requested)
        prim = stage.GetPrimAtPath(requested) if valid else None
        if prim and prim.IsActive() and prim.IsA(UsdGeom.Camera):
            return prim
        if prim:
            kind = f"{'' if prim.IsActive() else 'inactive '}{prim.GetTypeName() or 'untyped'} prim"
            raise LayerError(
                f"{name} <{requested}>: this {kind} is no camera to render from; choose one with "
                "-cam."
            )
        matches = []
    else:
        matches = [prim for prim in _cameras(stage) if prim.GetName() == requested]
    if len(matches) == 1:
        return matches[0]
    if matches:
        raise LayerError(
            f"{name}: {len(matches)} cameras are called {requested!r}; name one by its path: "
            f"{_paths(matches)}."
        )
    cameras = _cameras(stage)
    there = f"the stage has {_paths(cameras)}" if cameras else "the stage has no camera"
    raise LayerError(f"{name}: no camera {requested!r}; {there}.")


def _paths(prims: Sequence[Usd.Prim]) -> str:
    shown = ", ".join(str(prim.GetPath()) for prim in prims[:_LIST_LIMIT])
    more = len(prims) - _LIST_LIMIT
    return f"{shown} and {more} more" if more > 0 else shown


def _finite(attribute: Usd.Attribute, time: Usd.TimeCode) -> float:
    value = attribute.Get(time)
    if value is None or not math.isfinite(value):
        raise LayerError(
            f"{describe(attribute)}: {attribute.GetName()} is {value}; it must be a number."
        )
    return float(value)


def _positive(attribute: Usd.Attribute, time: Usd.TimeCode) -> float:
    value = _finite(attribute, time)
    if value <= 0.0:
        raise LayerError(
            f"{describe(attribute)}: {attribute.GetName()} is {value:g}; it must be above 0 "
            "(tenths of a scene unit)."
        )
    return value


def _clipping_range(
    camera: UsdGeom.Camera, time: Usd.TimeCode, orthographic: bool
) -> tuple[float, float]:
    attribute = camera.GetClippingRangeAttr()
    near, far = (float(edge) for edge in attribute.Get(time))
    # A negative near distance of an orthographic camera shows what lies behind it, as in Gf.
    if not (near < far and math.isfinite(near) and (orthographic or near >= 0.0)):
        raise LayerError(
            f"{describe(attribute)}: clippingRange is ({near:g}, {far:g}); it must rise, from 0 or "
            "more."
        )
    return near, far


def _exposure_scale(camera: UsdGeom.Camera, time: Usd.TimeCode) -> float:
    scale = float(camera.ComputeLinearExposureScale(time))
    if 1.0 / _EXPOSURE_LIMIT <= scale <= _EXPOSURE_LIMIT:
        return scale
    prim = camera.GetPrim()
    values = {"exposure": camera.GetExposureAttr().Get(time)}
    values |= {name: prim.GetAttribute(name).Get(time) for name in _EXPOSURE_FACTORS}
    wrong = {name: value for name, value in values.items() if not _gives_exposure(name, value)}
    said = ", ".join(f"{name} is {value:g}" for name, value in (wrong or values).items())
    raise LayerError(
        f"{describe(prim)}: {said}; that is no exposure, whose factor lies within "
        f"{1.0 / _EXPOSURE_LIMIT:g} and {_EXPOSURE_LIMIT:g}, so correct it."
    )


def _gives_exposure(name: str, value: float) -> bool:
    return math.isfinite(value) and (name == "exposure" or value > 0.0)


def _to_world(
    prim: Usd.Prim, time: Usd.TimeCode, meters_per_unit: float, notes: list[Note]
) -> NDArray[np.float64]:
    """Return the rigid part of a camera's world transform, as GfFrustum takes it.

    GfFrustum mirrors the local x axis of a left-handed transform and orthonormalises the axes.
    """
    world = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
    rows = np.array(world)
    axes = rows[:3, :3] if np.isfinite(rows).all() else np.zeros((3, 3))
    lengths = np.linalg.norm(axes, axis=1)
    volume = np.linalg.det(axes)
    if not abs(volume) > 1e-12 * np.prod(lengths):
        raise LayerError(
            f"{describe(prim)}: the camera's world transform is singular or not finite; correct "
            "its xformOps and those of its parents."
        )
    _note_distortion(str(prim.GetPath()), axes, notes)
    frustum = Gf.Frustum()
    frustum.SetPositionAndRotationFromMatrix(world)
    rigid: NDArray[np.float64] = np.array(frustum.ComputeViewInverse(), dtype=np.float64).T
    rigid[:3, 3] *= meters_per_unit
    return rigid


def _note_distortion(path: str, axes: NDArray[np.float64], notes: list[Note]) -> None:
    """Note what of a camera's axes, one a row, is not rigid."""
    lengths = np.linalg.norm(axes, axis=1)
    unit = axes / lengths[:, np.newaxis]
    if np.linalg.det(axes) < 0.0:
        message = "the world transform mirrors the camera; the picture is not mirrored, as in Gf."
        notes.append(Note("camera-mirrored", path, message))
    if np.abs(lengths - 1.0).max() > _SCALE_TOLERANCE:
        message = (
            f"the world transform scales the camera by {', '.join(f'{x:g}' for x in lengths)}; "
            "aperture and clipping range stay in the stage's units, as in Gf."
        )
        notes.append(Note("camera-scale-ignored", path, message))
    if np.abs(unit @ unit.T - np.eye(3)).max() > _SCALE_TOLERANCE:
        message = "the world transform shears the camera; its axes are made perpendicular."
        notes.append(Note("camera-shear-ignored", path, message))


def _note_what_is_ignored(camera: UsdGeom.Camera, time: Usd.TimeCode, notes: list[Note]) -> None:
    def add(code: str, message: str) -> None:
        notes.append(Note(code, str(camera.GetPath()), message))

    def value(attribute: Usd.Attribute) -> Any:
        return attribute.Get(time)

    if value(camera.GetClippingPlanesAttr()):
        add("clipping-planes-ignored", "only clippingRange clips the picture.")
