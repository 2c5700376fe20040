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

from usdskin.meshfiles import MeshFile, angle_weighted_normals, keep_faces, keep_groups

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]

METERS_PER_UNIT = 0.1

_OLD = 0.16
"""Share of the old in the person's age; the rest is young, about 25 years."""

SHAPES = {
    **{
        f"macrodetails/{origin}-male-{age}": origin_share * age_share
        for origin, origin_share in (("caucasian", 0.4), ("asian", 0.25), ("african", 0.35))
        for age, age_share in (("young", 1.0 - _OLD), ("old", _OLD))
    },
    "macrodetails/universal-male-young-averagemuscle-averageweight": 1.0 - _OLD,
    "macrodetails/universal-male-old-averagemuscle-averageweight": _OLD,
    # No face is the same on both sides.
    "asym/asym-jaw-1-l": 0.30,
    "asym/asym-brown-1-l": 0.35,
    "asym/asym-nose-1-r": 0.30,
    "asym/asym-ear-1-l": 0.40,
    "mouth/mouth-angles-up": 0.12,
    "expression/units/caucasian/eye-left-opened-up": 0.25,
    "expression/units/caucasian/eye-right-opened-up": 0.25,
}
"""Shapes of the base mesh and how much of each."""

TEXTURE_SIZE = (2048, 3072)
"""Width and height of the head's textures [px]."""

_SKIN_HALF_WIDTH_M = 0.15
"""Beyond this the shirt covers the skin, which is left out there [m]."""

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
    beside = np.abs(body.points[body.face_indices, 0])
    widest = np.maximum.reduceat(beside, body.face_starts)
    cut = keep_faces(body, (lowest > below) & (widest < _SKIN_HALF_WIDTH_M))
    assert cut.st is not None
    return dataclasses.replace(_repacked(cut), groups={}), cut.st


def hidden_faces(st: FloatArray, st_indices: IntArray) -> IntArray:
    """Return the faces inside the mouth and behind the eyeballs.

    Args:
        st: MakeHuman's own texture coordinates, shape [st_count, 2].
        st_indices: Those of the corners, shape [4 * face_count].
    """
    corner = st[st_indices.reshape(-1, 4)]
    mouth = (corner[..., 0] > 0.74) & (corner[..., 1] < 0.14)
    sockets = (corner[..., 0] < 0.16) & (corner[..., 1] < 0.64)
    return np.flatnonzero((mouth | sockets).all(axis=1)).astype(np.int32)


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
    cut = keep_faces(tights, kept & (lowest > below))
    return _hemmed(dataclasses.replace(cut, groups={}, st=None, st_indices=None))


def _hemmed(mesh: MeshFile) -> MeshFile:
    """Return a shirt whose collar is turned in, so that its edge is round."""
    faces = mesh.face_indices.reshape(-1, 4)
    edge = _upper_boundary(mesh)
    sides = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    both = np.isin(sides, edge).all(axis=1)
    sides = sides[both]
    _kinds, first, counts = np.unique(
        np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
    )
    sides = sides[first[counts == 1]]
    inward = -angle_weighted_normals(mesh)[edge]
    up = np.array([0.0, 1.0, 0.0])
    rings = [0.0025 * inward + 0.0015 * up, 0.0040 * inward, 0.0042 * inward - 0.012 * up]
    points = [mesh.points]
    added = []
    below = np.arange(len(mesh.points))
    for k, offset in enumerate(rings):
        above = below.copy()
        above[edge] = len(mesh.points) + k * len(edge) + np.arange(len(edge))
        points.append(mesh.points[edge] + offset)
        added.append(
            np.stack(
                [below[sides[:, 1]], below[sides[:, 0]], above[sides[:, 0]], above[sides[:, 1]]], 1
            )
        )
        below = above
    indices = np.concatenate([faces, *added]).astype(np.int32)
    return dataclasses.replace(
        mesh,
        points=np.concatenate(points),
        face_counts=np.full(len(indices), 4, np.int32),
        face_indices=indices.ravel(),
    )


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
    order = sorted(
        np.unique(island), key=lambda k: -float(np.prod(np.ptp(mesh.st[island == k], 0)))
    )
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
