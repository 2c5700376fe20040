"""Hair as ribbons: lashes, brows and a head shorn to a few millimetres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.meshfiles import MeshFile, keep_groups

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Strands:
    """Hairs of one kind."""

    path: FloatArray
    """Points along each hair, root first [m], shape [hair_count, point_count, 3]."""

    normal: FloatArray
    """Unit normal that each hair is lit with, shape [hair_count, 3]."""

    width: FloatArray
    """Width at the root [m], shape [hair_count]; the tip is a point."""

    color: FloatArray
    """Linear Rec. 709 reflectance, shape [hair_count, 3]."""


def ribbons(kinds: list[Strands], facing: FloatArray, source: Path) -> MeshFile:
    """Return hairs as flat ribbons that turn their width towards a direction.

    Args:
        kinds: The hairs.
        facing: Unit vector towards the viewer.
        source: File the mesh is said to come from.
    """
    points, normals, colors, faces = [], [], [], []
    used = 0
    for kind in kinds:
        count, steps = kind.path.shape[:2]
        along = np.gradient(kind.path, axis=1)
        side = np.cross(along, facing)
        side /= np.maximum(np.linalg.norm(side, axis=2, keepdims=True), 1e-12)
        taper = 1.0 - (np.arange(steps) / (steps - 1.0)) ** 2
        half = 0.5 * kind.width[:, None, None] * np.maximum(taper, 0.06)[None, :, None] * side
        points.append(np.stack([kind.path - half, kind.path + half], axis=2).reshape(-1, 3))
        normals.append(np.repeat(kind.normal, 2 * steps, axis=0))
        colors.append(np.repeat(kind.color, 2 * steps, axis=0))
        start = used + (np.arange(count)[:, None] * steps + np.arange(steps - 1)).ravel() * 2
        faces.append(np.stack([start, start + 1, start + 3, start + 2], axis=1))
        used += 2 * steps * count
    indices = np.concatenate(faces).ravel().astype(np.int32)
    return MeshFile(
        source,
        np.concatenate(points),
        np.full(len(indices) // 4, 4, np.int32),
        indices,
        normals=np.concatenate(normals),
        normal_indices=indices.copy(),
        colors=np.concatenate(colors).astype(np.float32),
    )


def lashes(mesh: MeshFile, random: np.random.Generator) -> Strands:
    """Return hairs along the base mesh's four lash helpers, which reach from root to tip."""
    paths = []
    for side in ("l", "r"):
        for lid, count in (("1", 80), ("2", 170)):
            strip = keep_groups(mesh, [f"helper-{side}-eyelashes-{lid}"])
            paths.append(_along_strip(strip, count, lid == "2", random))
    path = np.concatenate(paths)
    count = len(path)
    normal = np.tile([0.0, 0.3, 0.954], (count, 1))
    color = np.tile([0.012, 0.009, 0.008], (count, 1))
    return Strands(path, normal, random.uniform(1.4e-4, 2.2e-4, count), color)


def _along_strip(
    strip: MeshFile, count: int, tip_is_up: bool, random: np.random.Generator
) -> FloatArray:
    """Return paths across a strip of quads: texture s runs along the lid, t from lid to tip."""
    assert strip.st is not None and strip.st_indices is not None
    corner = np.array([[0, 1, 2], [0, 2, 3]])
    place = strip.st[strip.st_indices.reshape(-1, 4)[:, corner].reshape(-1, 3)]
    point = strip.points[strip.face_indices.reshape(-1, 4)[:, corner].reshape(-1, 3)]
    low, high = strip.st[:, 0].min(), strip.st[:, 0].max()
    columns = low + (high - low) * np.sort(random.uniform(0.03, 0.90, count))
    paths = []
    for s in columns:
        lean = 0.08 * (s - 0.5 * (low + high)) + random.normal(0.0, 0.0008)
        reach = random.uniform(0.62, 1.0)
        t = np.linspace(strip.st[:, 1].min(), strip.st[:, 1].max(), 160)
        found = _at(place, point, np.stack([np.full_like(t, s), t], axis=1))
        if not tip_is_up:
            found = found[::-1]
        found = found[np.isfinite(found[:, 0])]
        if len(found) < 6:
            continue
        end = max(3, int(reach * (len(found) - 1)))
        path = found[np.linspace(0, end, 5).astype(int)]
        path[:, 0] += lean * np.linspace(0.0, 1.0, 5) ** 2 * 0.12
        paths.append(path)
    return np.array(paths)


def _at(place: FloatArray, point: FloatArray, st: FloatArray) -> FloatArray:
    """Return positions at texture coordinates, NaN where no triangle is, shape [n, 3]."""
    a, b, c = place[:, 0], place[:, 1], place[:, 2]
    area = _cross(b - a, c - a)
    area = np.where(area == 0.0, np.inf, area)
    q = st[:, None, :]
    v = _cross(q - a, (c - a)[None]) / area
    w = _cross((b - a)[None], q - a) / area
    inside = np.minimum(np.minimum(v, w), 1.0 - v - w)
    best = inside.argmax(axis=1)
    row = np.arange(len(st))
    v, w = v[row, best][:, None], w[row, best][:, None]
    chosen = point[best]
    found = chosen[:, 0] * (1.0 - v - w) + chosen[:, 1] * v + chosen[:, 2] * w
    found[inside[row, best] < -1e-6] = np.nan
    return found


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def grown(
    roots: FloatArray,
    normals: FloatArray,
    lie: FloatArray,
    lift: float,
    length: FloatArray,
    width: FloatArray,
    color: FloatArray,
    random: np.random.Generator,
) -> Strands:
    """Return hairs that leave the skin and bend along it.

    Args:
        roots: Positions [m], shape [hair_count, 3].
        normals: Unit normals of the skin, shape [hair_count, 3].
        lie: Direction the hair is combed in, shape [hair_count, 3].
        lift: How far it stands off: 0 lies flat, 1 stands up.
        length: Shape [hair_count], [m].
        width: Shape [hair_count], [m].
        color: Shape [hair_count, 3].
        random: For what no two hairs share.
    """
    flat = lie - normals * np.einsum("ij,ij->i", lie, normals)[:, None]
    flat /= np.maximum(np.linalg.norm(flat, axis=1, keepdims=True), 1e-9)
    flat += random.normal(0.0, 0.16, flat.shape)
    start = flat + normals * (0.35 + lift)
    start /= np.linalg.norm(start, axis=1, keepdims=True)
    t = np.linspace(0.0, 1.0, 4)[None, :, None]
    bend = (flat - start) * (1.0 - lift)
    path = roots[:, None] + length[:, None, None] * (start[:, None] * t + bend[:, None] * t**2 / 2)
    lit = normals + 0.35 * random.normal(0.0, 1.0, normals.shape)
    lit /= np.linalg.norm(lit, axis=1, keepdims=True)
    return Strands(path, lit, width, color)
