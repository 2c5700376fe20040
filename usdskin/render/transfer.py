"""Baked shadows of a stage, refused where they were measured with anything but what is rendered.

Reads: ``SkinTransferAPI`` of a stage's prims. Makes: ``Transfers``, which hold for any light.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError
from usdskin.layers import describe
from usdskin.prims.transfers import SkinTransfer, read_transfer
from usdskin.render.job import RenderSettings
from usdskin.render.meshes import MeshArrays
from usdskin.render.scene import Scene
from usdskin.render.transfer_file import MeshTransfer, TransferFile, joined
from usdskin.render.transfer_identity import geometry_hashes, reaches, scene_hash
from usdskin.render.transfer_points import places_of, shaded_vertices
from usdskin.render.transfer_sphere import TransferSphere, transfer_sphere
from usdskin.warp_kernels import transfer

# isort: split
# After ours, which register the schemas.
from pxr import Usd

_REMEDY = "bake it again with `usdskin bake`"


@dataclass(frozen=True, slots=True, eq=False)
class Transfers:
    """The baked shadows of a scene, on the host; they hold for any light."""

    sphere: TransferSphere
    measured: MeshTransfer
    """Of all places, mesh after mesh."""

    position: NDArray[np.float32]
    """Places, lifted off the surface [m], shape [place_count, 3]."""

    prim: NDArray[np.int32]
    """Mesh of each place, shape [place_count]."""

    place: NDArray[np.int64]
    """Place of each vertex, shape [vertex_count]."""

    normal: NDArray[np.float32]
    """Unit normal of each vertex, shape [vertex_count, 3]."""

    material: NDArray[np.int32]
    """Material of each vertex, shape [vertex_count]."""

    corner_vertex: NDArray[np.int32]
    """Vertex of every corner of the scene, -1 where nothing was measured, shape
    [3 triangle_count]."""


def read_transfers(stage: Usd.Stage, scene: Scene, settings: RenderSettings) -> Transfers | None:
    """Return the baked shadows of a scene, or None where it has none.

    Args:
        stage: The stage.
        scene: What was read from it.
        settings: How.

    Raises:
        LayerError: They cannot be read, or were measured with other geometry, another level or
            clearer skin than is rendered; the message says which.
    """
    records = [read_transfer(stage.GetPrimAtPath(mesh.path)) for mesh in scene.meshes]
    if not any(records):
        return None
    hashes = geometry_hashes(scene)
    rings = {record.rings for record in records if record is not None}
    if len(rings) > 1:
        raise LayerError(
            f"{stage.GetRootLayer().GetDisplayName()}: its baked shadows have different "
            f"directions; bake them together with `usdskin bake`"
        )
    sphere = transfer_sphere(rings.pop())
    files: dict[str, TransferFile] = {}
    try:
        return _read(stage, scene, settings, records, hashes, sphere, files)
    finally:
        for file in files.values():
            file.close()


def _read(
    stage: Usd.Stage,
    scene: Scene,
    settings: RenderSettings,
    records: list[SkinTransfer | None],
    hashes: dict[str, str],
    sphere: TransferSphere,
    files: dict[str, TransferFile],
) -> Transfers:
    parts: list[MeshTransfer] = []
    position, prim, place, normal, material, corner = [], [], [], [], [], []
    place_count = vertex_count = 0
    for k, (mesh, record) in enumerate(zip(scene.meshes, records, strict=True)):
        if record is None:
            corner.append(np.full(3 * len(mesh.triangles), -1, np.int64))
            continue
        where = describe(stage.GetPrimAtPath(mesh.path))
        file = files.get(str(record.file))
        if file is None:
            file = files[str(record.file)] = TransferFile(record.file)
        _check(where, mesh, record, hashes, file, scene, settings)
        places = places_of(mesh)
        if record.row_count != len(places.point):
            raise _stale(where, "holds another number of vertices than the surface has")
        vertices = shaded_vertices(mesh, places)
        slots = np.array([scene.material_index[path] for path in mesh.material_paths], np.int32)
        parts.append(file.transfer(record.index, record.row_count, sphere.count))
        at = mesh.points[places.point]
        size = np.maximum(np.abs(at).max(axis=1, keepdims=True), np.float32(1e-3))
        position.append(at + np.float32(transfer.LIFT) * size * places.normal)
        prim.append(np.full(len(places.point), k, np.int32))
        place.append(vertices.place + place_count)
        normal.append(vertices.normal)
        material.append(slots[places.slot[vertices.place]])
        corner.append(vertices.corner_vertex + vertex_count)
        place_count += len(places.point)
        vertex_count += len(vertices.place)
    return Transfers(
        sphere,
        joined(parts),
        np.concatenate(position),
        np.concatenate(prim),
        np.concatenate(place),
        np.concatenate(normal),
        np.concatenate(material),
        np.concatenate(corner).astype(np.int32),
    )


def _stale(where: str, what: str) -> LayerError:
    return LayerError(f"{where}: its baked shadows do not hold: {what}; {_REMEDY}")


def _check(
    where: str,
    mesh: MeshArrays,
    record: SkinTransfer,
    hashes: dict[str, str],
    file: TransferFile,
    scene: Scene,
    settings: RenderSettings,
) -> None:
    """Refuse shadows of anything but what is rendered."""
    known = file.hashes()
    if scene_hash(known) != record.scene_hash:
        raise LayerError(f"{where}: {file.path} is of another bake than the layer; {_REMEDY}")
    if hashes[mesh.path] != record.geometry_hash:
        if settings.subdivision_level != record.subdivision_level:
            what = (
                f"they were measured at subdivision level {record.subdivision_level}, and it is "
                f"{settings.subdivision_level} now"
            )
        else:
            what = "its points, triangles, transform or opacity have changed"
        raise _stale(where, what)
    if scene_hash(hashes) != record.scene_hash:
        raise _stale(where, _surroundings(known, hashes, record, settings))
    reach = reaches(mesh, scene, settings)
    wrong = len(reach) != len(record.reach)
    if not wrong:
        wrong = bool(((reach > 0.0) != (record.reach > 0.0)).any())
        wrong |= bool((reach > 1.00001 * record.reach).any())
    if wrong:
        what = "its skin's opacity was higher, or its material another"
        if not (record.reach > 0.0).any() and (reach > 0.0).any():
            what = "its skin was clear, and now its opacity dims light"
        raise _stale(where, what)


def _surroundings(
    known: dict[str, str], hashes: dict[str, str], record: SkinTransfer, settings: RenderSettings
) -> str:
    """Return what has changed around a mesh."""
    if settings.subdivision_level != record.subdivision_level:
        return (
            f"other surfaces were at subdivision level {record.subdivision_level}, and are at "
            f"{settings.subdivision_level} now"
        )
    had, has = list(known.values()), list(hashes.values())
    added = [path for path, value in hashes.items() if value not in had]
    gone = [path for path, value in known.items() if value not in has]
    changed = [path for path in added if path in known]
    if changed:
        return f"<{changed[0]}> has moved or changed"
    if added:
        return f"<{added[0]}> was not there"
    if gone:
        return f"<{gone[0]}> is gone"
    return "the stage has another number of prims"
