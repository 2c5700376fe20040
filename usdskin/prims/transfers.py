"""``SkinTransferAPI`` <-> ``SkinTransfer``."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.values import DEFAULT_TIME, PrimError, Problem, read_schema
from usdskin.prims.writing import write_schema

VERSION = 1
"""Layout of the measurements that this version writes and reads."""

LEAST_RINGS = 4


@dataclass(frozen=True, slots=True, eq=False)
class SkinTransfer:
    """Where a prim's measured shadows are, and what they were measured with."""

    file: Path
    """The measurements."""

    index: int
    """Number of the prim within the file."""

    row_count: int
    """Places measured."""

    rings: int
    """Rings of directions."""

    subdivision_level: int
    """Subdivision level of all surfaces."""

    geometry_hash: str
    """Of the prim's points, triangles and opacities."""

    scene_hash: str
    """Of all prims that were in the way."""

    reach: NDArray[np.float64]
    """Way through the body that was followed [m], per material of the prim; 0 where clear or no
    skin, shape [material_count]."""


def read_transfer(prim: Usd.Prim) -> SkinTransfer | None:
    """Return the measured shadows of a gprim, or None where it has none.

    Raises:
        LayerError: An opinion cannot be used, or the measurements are of another version.
    """
    if not prim or not prim.HasAPI("SkinTransferAPI"):
        return None
    values = read_schema(prim, "SkinTransferAPI", DEFAULT_TIME)
    remedy = "bake it again with `usdskin bake`"
    if values["transfer:version"] != VERSION:
        raise LayerError(
            f"{describe(prim)}: transfer:version is {values['transfer:version']}, this usdskin "
            f"reads {VERSION}; {remedy}"
        )
    for name in ("transfer:file", "transfer:geometryHash", "transfer:sceneHash", "transfer:rings"):
        if not values[name]:
            raise PrimError(prim, Problem("missing-value", name, f"has no value; {remedy}"))
    if values["transfer:rings"] < LEAST_RINGS:
        text = f"is {values['transfer:rings']}, and {LEAST_RINGS} are the least; {remedy}"
        raise PrimError(prim, Problem("out-of-range", "transfer:rings", text))
    reach = values["transfer:reach"]
    return SkinTransfer(
        file=values["transfer:file"],
        index=values["transfer:index"],
        row_count=values["transfer:rowCount"],
        rings=values["transfer:rings"],
        subdivision_level=values["transfer:subdivisionLevel"],
        geometry_hash=values["transfer:geometryHash"],
        scene_hash=values["transfer:sceneHash"],
        reach=np.zeros(0) if reach is None else reach,
    )


def write_transfer(prim: Usd.Prim, transfer: SkinTransfer, folder: Path) -> None:
    """Author ``SkinTransferAPI`` on an ``over``, whose type other layers say.

    Args:
        prim: Prim to write to, at the stage's edit target.
        transfer: What to say.
        folder: Folder the layer is going to be written to.
    """
    write_schema(
        prim,
        "SkinTransferAPI",
        {
            "transfer:file": transfer.file,
            "transfer:version": VERSION,
            "transfer:index": transfer.index,
            "transfer:rowCount": transfer.row_count,
            "transfer:rings": transfer.rings,
            "transfer:subdivisionLevel": transfer.subdivision_level,
            "transfer:geometryHash": transfer.geometry_hash,
            "transfer:sceneHash": transfer.scene_hash,
            "transfer:reach": np.asarray(transfer.reach, np.float64),
        },
        folder,
    )
