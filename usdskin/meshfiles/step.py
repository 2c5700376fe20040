"""The import step: a mesh file in, ``asset.usda`` out.

Reads:  OBJ, PLY, glTF, STL or OFF.
Writes: a component asset that stands alone (``usdskin.meshfiles.asset``).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from usdskin.errors import UsageError
from usdskin.layers import SettingValue, check_output
from usdskin.meshfiles.asset import SCHEMES, AssetOptions, write_asset
from usdskin.meshfiles.edit import angle_weighted_normals, keep_groups
from usdskin.meshfiles.meshfile import MeshFile
from usdskin.meshfiles.obj import read_obj
from usdskin.meshfiles.others import SUFFIXES, read_with_open3d
from usdskin.meshfiles.remesh import decimate, repair
from usdskin.notes import Note

UNITS = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}
"""Length of the units a mesh may be in [m]."""

_ASSUMED_UNIT = "cm"
"""As USD's own fallback for metersPerUnit."""

_HEAD_M, _BODY_M = 0.28, 1.7
"""About the longest side of a head with neck, and of a body [m]; only ``auto`` looks at them."""


def read_mesh_file(path: str | Path, notes: list[Note] | None = None) -> MeshFile:
    """Read a mesh file of any kind.

    Args:
        path: File to read; its ending says what it is.
        notes: Takes what the file holds and a mesh cannot.

    Raises:
        UsageError: The ending is none of those that can be read.
        MeshError: The file is missing or damaged.
        UsdSkinError: open3d is needed and cannot be loaded.
    """
    path = Path(path)
    notes = notes if notes is not None else []
    suffix = path.suffix.lower()
    if suffix == ".obj":
        return read_obj(path, notes)
    if suffix in SUFFIXES:
        return read_with_open3d(path, notes)
    raise UsageError(
        f"{path}: cannot read this kind of file; give one that ends in .obj, {', '.join(SUFFIXES)}"
    )


def import_mesh(
    source: str | Path,
    output: str | Path,
    *,
    units: str | None = None,
    up_axis: str | None = None,
    groups: Sequence[str] = (),
    scheme: str | None = None,
    normals: bool = False,
    flip_v: bool = False,
    decimate_to: int | None = None,
    repair_mesh: bool = False,
    skin: Sequence[str] | None = None,
    name: str | None = None,
    notes: list[Note] | None = None,
) -> Path:
    """Write a mesh file as a USD asset.

    Args:
        source: Mesh file. It is read, never changed.
        output: Layer to write.
        units: Unit of the file's numbers, one of ``UNITS``, or ``auto`` to guess it from the size,
            with a note. By default what the format says, else centimetres.
        up_axis: ``y`` or ``z``. By default what the format says, else y.
        groups: Keep only the faces in these groups, objects or materials.
        scheme: ``catmullClark``, ``loop`` or ``none``; see ``AssetOptions``.
        normals: Compute smooth normals in place of the file's.
        flip_v: Turn the texture coordinates over, for files that count t from the top.
        decimate_to: Most triangles to keep.
        repair_mesh: Join, drop and turn what is broken, and say what.
        skin: Materials that are skin; by default all.
        name: Name of the default prim; by default that of ``output``.
        notes: Takes what was assumed, dropped or done.

    Returns:
        ``output``, once it is complete on disk.

    Raises:
        UsageError: An option is wrong, or names what the file does not have.
        MeshError: The file is missing, damaged or without faces.
        LayerError: The layer cannot be written.
        UsdSkinError: open3d is needed and cannot be loaded.
    """
    source, output = Path(source), Path(output)
    notes = notes if notes is not None else []
    _check_options(source, output, units, up_axis, scheme, normals, decimate_to)
    mesh = read_mesh_file(source, notes)
    if groups:
        mesh = keep_groups(mesh, groups)
    if repair_mesh:
        mesh = repair(mesh, notes)
    if decimate_to is not None:
        mesh = decimate(mesh, decimate_to, notes)
    if flip_v:
        mesh = _with_flipped_v(mesh)
    if normals:
        mesh = _with_smooth_normals(mesh)
    options = AssetOptions(
        meters_per_unit=_meters_per_unit(mesh, units, notes),
        up_axis=_up_axis(mesh, up_axis),
        scheme="none" if normals and scheme is None else scheme,  # type: ignore[arg-type]
        name=name,
        skin=None if skin is None else tuple(skin),
    )
    settings: dict[str, SettingValue] = {
        "decimate": decimate_to or 0,
        "flipV": flip_v,
        "groups": list(groups),
        "normals": normals,
        "repair": repair_mesh,
        "skin": list(skin or ()),
        "units": units or "",
        "upAxis": up_axis or "",
    }
    return write_asset(mesh, output, options, notes=notes, settings=settings)


def _check_options(
    source: Path,
    output: Path,
    units: str | None,
    up_axis: str | None,
    scheme: str | None,
    normals: bool,
    decimate_to: int | None,
) -> None:
    """Refuse what can be refused before the file is read."""
    if units is not None and units not in (*UNITS, "auto"):
        raise UsageError(f"--units {units}: choose one of {', '.join(UNITS)} or auto")
    if up_axis is not None and up_axis.lower() not in ("y", "z"):
        raise UsageError(f"--up {up_axis}: choose y or z")
    if scheme is not None and scheme not in SCHEMES:
        raise UsageError(f"--subdivide {scheme}: choose one of {', '.join(SCHEMES)}")
    if normals and scheme not in (None, "none"):
        raise UsageError(f"--normals has no effect on a {scheme} surface; choose --subdivide none")
    if decimate_to is not None and decimate_to < 4:
        raise UsageError(f"--decimate {decimate_to}: keep 4 triangles or more")
    check_output(output, [source], step="import")


def _with_flipped_v(mesh: MeshFile) -> MeshFile:
    if mesh.st is None:
        return mesh
    s, t = mesh.st.T
    return dataclasses.replace(mesh, st=np.stack([s, 1.0 - t], axis=1))


def _with_smooth_normals(mesh: MeshFile) -> MeshFile:
    normals = angle_weighted_normals(mesh)
    return dataclasses.replace(mesh, normals=normals, normal_indices=mesh.face_indices)


def _meters_per_unit(mesh: MeshFile, units: str | None, notes: list[Note]) -> float:
    if units in UNITS:
        return UNITS[units]
    if mesh.meters_per_unit is not None:
        return mesh.meters_per_unit
    size = float(np.ptp(mesh.points, axis=0).max())
    kind = mesh.source.suffix.lstrip(".").upper()
    if units == "auto" and size > 0.0:
        name, typical = min(
            ((unit, length) for unit in ("m", "dm", "cm", "mm") for length in (_HEAD_M, _BODY_M)),
            key=lambda pair: abs(math.log(size * UNITS[pair[0]] / pair[1])),
        )
        shape = "head" if typical == _HEAD_M else "body"
        what = f"{kind} says no unit; guessed {name}, since {{}} is about the size of a {shape}"
        code = "units-guessed"
    else:
        name = _ASSUMED_UNIT
        what = f"{kind} says no unit; taken as {name}, which makes it {{}} at its longest"
        code = "units-assumed"
    what = what.format(f"{size * UNITS[name]:.3g} m")
    notes.append(Note(code, str(mesh.source), f"{what}; --units states it"))
    return UNITS[name]


def _up_axis(mesh: MeshFile, up_axis: str | None) -> Literal["Y", "Z"]:
    chosen = (up_axis or mesh.up_axis or "Y").upper()
    return "Z" if chosen == "Z" else "Y"
