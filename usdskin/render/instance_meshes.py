"""Meshes of point instances: one mesh read once, then moved to every place.

Reads: the primvars of ``UsdGeomPointInstancer``, of which prototypes inherit one value each.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import DeviceError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.gprims import ROWS
from usdskin.render.instancers import Link, Placed
from usdskin.render.memory import available_bytes
from usdskin.render.mesh_cage import check_transform, to_meters
from usdskin.render.mesh_limit import unit
from usdskin.render.mesh_primvars import ElementCounts, read_primvar
from usdskin.render.mesh_topology import FloatArray
from usdskin.render.meshes import Frame, MeshArrays

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom

_BYTES_PER_TRIANGLE = 600
"""Memory that an instance's triangle takes until it is on the device [B]: 470 measured, with three
primvars."""

_CHUNK = 4_000_000
"""Most numbers that are moved at once."""

_SHAPE_TRIANGLES = 4_000_000
"""Triangles of spheres in all instances above which they are divided less finely."""

_FEWEST_ROWS = 12
"""Fewest segments from pole to pole: the chord is 0.9 % of the radius off."""

_TURNED = [0, 2, 1]


def instance_meshes(
    placed: Sequence[Placed],
    read: Callable[[Placed, int], MeshArrays | None],
    to_world: Callable[[Usd.Prim], FloatArray],
    scale: float,
    names: Iterable[str],
    time: Usd.TimeCode,
    notes: list[Note],
) -> Iterator[MeshArrays]:
    """Yield the meshes of point instances, every one's triangles in world space.

    Args:
        placed: What the instancers place.
        read: Reads a shape [m] in the space around its prototype, round ones with so many segments
            from pole to pole.
        to_world: Local to world [m] of an instancer.
        scale: ``metersPerUnit``.
        names: Primvars wanted, without ``primvars:``.
        time: When.
        notes: What is not shown as authored is appended.

    Raises:
        MeshError: A primvar of an instancer cannot be used, or an instance is too far away.
        DeviceError: All instances together do not fit in memory.
    """
    fineness = _shape_rows(placed, notes)
    meshes = [read(item, fineness) for item in placed]
    _check_memory(placed, meshes)
    for item, mesh in zip(placed, meshes, strict=True):
        if mesh is None or not len(mesh.triangles):
            continue
        values = [(name, _inherited(item, name, time, notes)) for name in sorted(set(names))]
        given = {name: found for name, found in values if found is not None}
        outermost = item.links[0].instancer
        where = describe(outermost)
        outer = to_world(outermost)
        check_transform(outer, where)
        for link in item.links[:-1]:
            check_transform(link.to_root, describe(link.prim))
        matrices, paths, rows = item.expand(outer)
        # The innermost space is in stage units; the mesh is in metres.
        matrices[:, :3, :3] /= scale
        step = max(1, _CHUNK // (9 * len(mesh.triangles) + 3 * len(mesh.points)))
        for begin in range(0, len(paths), step):
            part = slice(begin, begin + step)
            own = {name: data[rows[level][part]] for name, (level, data) in given.items()}
            yield from _moved(mesh, matrices[part], paths[part], own, where)


def _shape_rows(placed: Sequence[Placed], notes: list[Note]) -> int:
    """Return how finely round shapes are divided: less, with a note, where they are many."""
    round_ones = [item for item in placed if not item.prim.IsA(UsdGeom.Mesh)]
    count = sum(item.count for item in round_ones)
    rows = ROWS
    while rows > _FEWEST_ROWS and count * 4 * rows**2 > _SHAPE_TRIANGLES:
        rows //= 2
    if rows < ROWS:
        first = round_ones[0].links[0].instancer.GetPath()
        what = f"{count} instances of shapes are shown, round ones with {2 * rows} segments around"
        notes.append(Note("instances-coarse", str(first), what))
    return rows


def _check_memory(placed: Sequence[Placed], meshes: Sequence[MeshArrays | None]) -> None:
    sizes = [0 if mesh is None else len(mesh.triangles) for mesh in meshes]
    triangles = sum(item.count * size for item, size in zip(placed, sizes, strict=True))
    needed, there = triangles * _BYTES_PER_TRIANGLE, available_bytes()
    if triangles <= np.iinfo(np.int32).max // 3 and (there is None or needed <= there):
        return
    most = max(range(len(placed)), key=lambda k: placed[k].count * sizes[k])
    raise DeviceError(
        f"{describe(placed[most].links[0].instancer)}: {sum(item.count for item in placed)} "
        f"instances have {triangles} triangles, which need about {needed / 2**30:.0f} GiB; hide "
        "some, use a lighter prototype or lower the subdivision level"
    )


def _moved(
    mesh: MeshArrays,
    matrices: FloatArray,
    names: Sequence[str],
    primvars: dict[str, FloatArray],
    where: str,
) -> Iterator[MeshArrays]:
    """Yield a mesh moved by affine matrices, shape [n, 4, 4], with some primvars one value each."""
    linear = matrices[:, :3, :3]
    points = np.matmul(mesh.points.astype(np.float64), linear.transpose(0, 2, 1))
    points += matrices[:, None, :3, 3]
    to_meters(points.reshape(-1, 3), np.eye(4), where)
    flat = np.matmul(mesh.normals.reshape(-1, 3).astype(np.float64), np.linalg.inv(linear))
    normals = unit(flat.reshape(-1, 3)).reshape(len(matrices), *mesh.normals.shape)
    mirrored = np.linalg.det(linear) < 0.0
    points32, normals32 = points.astype(np.float32), normals.astype(np.float32)
    turned_triangles = mesh.triangles[:, _TURNED]
    turned_values = {name: value[:, _TURNED] for name, value in mesh.primvars.items()}
    for k, name in enumerate(names):
        turned = bool(mirrored[k])
        values = dict(turned_values if turned else mesh.primvars)
        for primvar, rows in primvars.items():
            row: NDArray[np.float32] = rows[k].astype(np.float32)
            values[primvar] = np.broadcast_to(row, (len(mesh.triangles), 3, len(row)))
        frames = {
            frame: _moved_frame(frame, value, linear[k], turned)
            for frame, value in mesh.frames.items()
        }
        yield dataclasses.replace(
            mesh,
            path=name,
            frames=frames,
            points=points32[k],
            triangles=turned_triangles if turned else mesh.triangles,
            normals=normals32[k][:, _TURNED] if turned else normals32[k],
            primvars=values,
        )


def _moved_frame(
    frame: Frame, value: NDArray[np.float32], linear: FloatArray, turned: bool
) -> NDArray[np.float32]:
    """Return the rows of a frame moved by a matrix: tangents as directions, gradients inversely."""
    matrix = linear.T if frame.kind == "tangent" else np.linalg.inv(linear)
    moved = value.astype(np.float64)
    moved[..., :3] = moved[..., :3] @ matrix
    if turned:
        moved = moved[:, :, _TURNED]
        if frame.kind == "tangent":
            moved[..., 3] *= -1.0
    return moved.astype(np.float32)


def _inherited(
    placed: Placed, name: str, time: Usd.TimeCode, notes: list[Note]
) -> tuple[int, FloatArray] | None:
    """Return which instancer gives a primvar, the innermost first, and its value by instance.

    What a prototype says itself counts before that.
    """
    last = len(placed.links) - 1
    if _says(placed.prim, placed.links[last].root.GetPath(), name):
        return None
    for level in range(last, -1, -1):
        link = placed.links[level]
        bounds = placed.links[level - 1].root.GetPath() if level else Sdf.Path.absoluteRootPath
        if not _says(link.instancer, bounds, name):
            continue
        found = read_primvar(link.instancer, name, time, _counts(link), notes)
        if found is None:
            return None
        values = found.of_elements()
        if len(values) == link.count:
            return level, values
        return level, np.broadcast_to(values[:1], (link.count, values.shape[1]))
    return None


def _counts(link: Link) -> ElementCounts:
    return ElementCounts(link.count, link.count, link.count)


def _says(prim: Usd.Prim, bounds: Sdf.Path, name: str) -> bool:
    """Return whether a prim has a primvar from itself or from an ancestor inside ``bounds``."""
    primvar = UsdGeom.PrimvarsAPI(prim).FindPrimvarWithInheritance(name)
    if not primvar or not primvar.HasValue():
        return False
    return bool(primvar.GetAttr().GetPrim().GetPath().HasPrefix(bounds))
