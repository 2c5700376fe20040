"""The person's shape: MakeHuman's base mesh, shaped, cut and given texture coordinates of its own.

The base mesh is in decimetres (a body of 16.7 units) with Y up; here it comes out in metres, the
feet on the ground.
"""

from __future__ import annotations

import dataclasses
import gzip
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.meshfiles import MeshFile, keep_faces, keep_groups

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

METERS_PER_UNIT = 0.1

SHAPES = {
    "macrodetails/caucasian-male-young": 0.35,
    "macrodetails/asian-male-young": 0.25,
    "macrodetails/african-male-young": 0.40,
    "macrodetails/universal-male-young-averagemuscle-averageweight": 1.0,
}
"""Shapes of the base mesh and how much of each."""

TEXTURE_SIZE = (2048, 3072)
"""Width and height of the head's textures [px]."""

COLLAR_ROWS = 4
"""Rows of faces that are taken off the top of the helper ``tights`` to get a crew neck."""


@dataclass(frozen=True, slots=True, eq=False)
class Eye:
    """Where an eyeball sits: an ellipsoid."""

    center: FloatArray
    """Position [m], shape [3]."""

    radii: FloatArray
    """Half-axes along x, y and z [m], shape [3]."""


def shape_files() -> list[str]:
    """Return the assets that ``SHAPES`` names."""
    return [f"targets/{name}.target.gz" for name in SHAPES]


def shaped(base: MeshFile, folder: Path) -> MeshFile:
    """Return the base mesh with ``SHAPES`` applied, in metres, standing on y = 0."""
    points = base.points.copy()
    for name, amount in SHAPES.items():
        which, offsets = _read_target(folder / f"{Path(name).name}.target.gz")
        points[which] += amount * offsets
    points *= METERS_PER_UNIT
    body = points[_points_of(base, base.groups["body"])]
    points[:, 1] -= body[:, 1].min()
    return dataclasses.replace(base, points=points)


def joint(mesh: MeshFile, name: str) -> FloatArray:
    """Return the position of one of the base mesh's joints [m]."""
    return mesh.points[_points_of(mesh, mesh.groups[f"joint-{name}"])].mean(axis=0)


def eye(mesh: MeshFile, side: str) -> Eye:
    """Return the eyeball of a side, ``l`` or ``r``: the ellipsoid through the helper's back."""
    points = mesh.points[_points_of(mesh, mesh.groups[f"helper-{side}-eye"])]
    low, high = points.min(axis=0), points.max(axis=0)
    radii = 0.5 * (high - low)
    center = 0.5 * (high + low)
    # The cornea bulges in front: the depth is taken from the back and the sides.
    widest = points[np.argsort(-np.abs(points[:, 0] - center[0]))[:8], 2].mean()
    center[2], radii[2] = widest, widest - low[2]
    return Eye(center, radii)


def head(mesh: MeshFile, below: float) -> tuple[MeshFile, FloatArray]:
    """Return the skin above a height, with texture coordinates that fill the picture.

    Args:
        mesh: The shaped base mesh.
        below: Height of the cut [m].

    Returns:
        The mesh, and MakeHuman's own texture coordinates in the order of its ``st``.
    """
    body = keep_groups(mesh, ["body"])
    lowest = np.minimum.reduceat(body.points[body.face_indices, 1], body.face_starts)
    cut = keep_faces(body, lowest > below)
    assert cut.st is not None
    return dataclasses.replace(_repacked(cut), groups={}), cut.st


def top(mesh: MeshFile, below: float) -> MeshFile:
    """Return a shirt: the helper ``tights`` from a crew neck down to a height [m]."""
    tights = keep_groups(mesh, ["helper-tights"])
    faces = tights.face_indices.reshape(-1, 4)
    kept = np.ones(len(faces), bool)
    edge = _upper_boundary(tights)
    for _ in range(COLLAR_ROWS):
        row = np.isin(faces, edge).any(axis=1) & kept
        kept &= ~row
        edge = np.unique(faces[row])
    lowest = np.minimum.reduceat(tights.points[tights.face_indices, 1], tights.face_starts)
    return dataclasses.replace(keep_faces(tights, kept & (lowest > below)), groups={})


def _read_target(path: Path) -> tuple[IntArray, FloatArray]:
    """Return the points that a MakeHuman target moves, and how far [mesh units]."""
    with gzip.open(path, "rt", encoding="ascii") as file:
        rows = [line.split() for line in file if line.strip() and not line.startswith("#")]
    which = np.array([int(row[0]) for row in rows], np.int32)
    return which, np.array([row[1:4] for row in rows], float).reshape(-1, 3)


def _points_of(mesh: MeshFile, faces: IntArray) -> IntArray:
    corners = mesh.face_starts[faces][:, None] + np.arange(4)
    return np.unique(mesh.face_indices[corners])


def _upper_boundary(mesh: MeshFile) -> IntArray:
    """Return the points of the topmost open edge of a mesh of quads."""
    faces = mesh.face_indices.reshape(-1, 4)
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    kinds, counts = np.unique(edges, axis=0, return_counts=True)
    open_points = np.unique(kinds[counts == 1])
    neck = mesh.points[open_points, 1] > 0.8 * mesh.points[:, 1].max()
    return open_points[neck]


# --- Texture coordinates -----------------------------------------------------------------------


def _repacked(mesh: MeshFile) -> MeshFile:
    """Return the mesh with its texture islands laid out anew, the largest as large as can be."""
    assert mesh.st is not None and mesh.st_indices is not None
    size = np.array(TEXTURE_SIZE, float)
    island = _islands(mesh.st_indices.reshape(-1, 4), len(mesh.st))
    order = sorted(np.unique(island), key=lambda k: -float(np.prod(np.ptp(mesh.st[island == k], 0))))
    st = np.zeros_like(mesh.st)
    border = 12.0
    column, free = 0.0, border
    for rank, k in enumerate(order):
        members = mesh.st[island == k]
        low, extent = members.min(axis=0), np.ptp(members, axis=0)
        if rank == 0:
            scale = (size[1] - 2.0 * border) / extent[1]
            st[island == k] = border + (members - low) * scale
            column = border + extent[0] * scale + 2.0 * border
            continue
        placed = members - low
        if extent[0] > extent[1]:
            placed = np.stack([extent[1] - placed[:, 1], placed[:, 0]], axis=1)
            extent = extent[::-1]
        scale = min(2400.0, (size[0] - border - column) / extent[0])
        st[island == k] = np.array([column, free]) + placed * scale
        free += extent[1] * scale + 2.0 * border
    if free > size[1]:
        raise ValueError(f"the texture islands need {free:.0f} of {size[1]:.0f} rows")
    return dataclasses.replace(mesh, st=st / size)


def _islands(faces: IntArray, count: int) -> IntArray:
    """Return the connected part each texture coordinate is in, shape [count]."""
    label = np.arange(count, dtype=np.int32)
    while True:
        least = np.minimum.reduce(label[faces], axis=1)
        update = label.copy()
        np.minimum.at(update, faces, least[:, None])
        update = update[update]
        if np.array_equal(update, label):
            return label
        label = update
