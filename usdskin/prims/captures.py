"""``CaptureAPI`` <-> ``Shoot``: one session of photographs of one place."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from pxr import Usd, UsdGeom

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.views import View, matrix_to_world, read_view

FloatArray = NDArray[np.float64]


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
            f"{name}: no prim has CaptureAPI, so it is no capture; `usdskin ingest` writes a shoot "
            "from a folder of photographs, `usdskin capture` its panorama"
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
    to_world = matrix_to_world(prim)
    # A normal to a plane turns as the plane does; a meter's direction is one.
    world = np.linalg.inv(to_world).T @ given
    return np.asarray(world / np.linalg.norm(world))


def _weights(prim: Usd.Prim, given: FloatArray) -> FloatArray:
    if (given < 0.0).any() or not given.any():
        text = f"is {tuple(float(value) for value in given)}; give three weights of which none is "
        text += "negative and one is above 0"
        raise PrimError(prim, Problem("out-of-range", "capture:luminanceWeights", text))
    return given
