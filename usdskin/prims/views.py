"""Cameras with photographs <-> ``View`` and ``Shot``."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from pxr import Gf, Usd, UsdGeom

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.applied import check_applied_schemas
from usdskin.prims.brackets import ExposureBracket, read_bracket
from usdskin.prims.lenses import FisheyeLens, read_lens
from usdskin.prims.values import DEFAULT_TIME

FloatArray = NDArray[np.float64]

_ROTATION_TOLERANCE = 1e-4


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


def matrix_to_world(prim: Usd.Prim) -> FloatArray:
    """Return the rotation and scale from a prim to the world, column vectors, shape [3, 3]."""
    cache = UsdGeom.XformCache(DEFAULT_TIME)
    return np.array(cache.GetLocalToWorldTransform(prim), dtype=np.float64)[:3, :3].T


def _rotation(prim: Usd.Prim) -> FloatArray:
    matrix = matrix_to_world(prim)
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
