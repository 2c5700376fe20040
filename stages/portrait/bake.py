"""Geometry into textures: how thick the body is at a point, where a texel lies. Warp kernels."""

from __future__ import annotations

import functools
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.device import Workers, open_workers

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]

LIFT_M = 3e-4
"""How far above the surface a ray starts [m]."""

FAR_M = 2.0
"""How far it looks [m]."""


@dataclass(frozen=True, slots=True, eq=False)
class Triangles:
    """Triangles with normals at their corners."""

    points: Float32Array
    """Positions [m], shape [point_count, 3]."""

    indices: NDArray[np.int32]
    """Shape [triangle_count, 3]."""

    normals: Float32Array
    """Unit normals at the corners, shape [triangle_count, 3, 3]."""

    st: Float32Array | None = None
    """Texture coordinates at the corners, shape [triangle_count, 3, 2]."""

    other_st: Float32Array | None = None
    """Those of the mesh it was made from, shape [triangle_count, 3, 2]."""


@wp.kernel(enable_backward=False)
def _thickness_kernel(
    # In:
    mesh: wp.uint64,
    point: wp.array(dtype=wp.vec3f),
    normal: wp.array(dtype=wp.vec3f),
    largest: wp.float32,
    # Out:
    thickness: wp.array(dtype=wp.float32),
):
    """Return how far it is through the body, straight in, up to ``largest`` [m].

    Launch dimension: [point_count].

    Args:
        mesh: Id of the body's ``wp.Mesh``.
        point: Positions near the surface [m], shape [point_count].
        normal: Unit normals, shape [point_count].
        largest: Largest thickness told [m].
        thickness: Way to the first surface seen from inside [m], shape [point_count].
    """
    i = wp.tid()
    inward = -normal[i]
    start = point[i] + normal[i] * 0.002
    gone = wp.float32(0.0)
    entered = wp.float32(0.0)
    result = largest
    for _step in range(4):
        hit = wp.mesh_query_ray(mesh, start + inward * gone, inward, largest + 0.01)
        if not hit.result:
            break
        gone += hit.t + 1.0e-5
        if wp.dot(hit.normal, inward) > 0.0:
            result = wp.clamp(gone - entered, 0.0, largest)
            break
        entered = gone
    thickness[i] = result


@wp.kernel(enable_backward=False)
def _cast_kernel(
    # In:
    mesh: wp.uint64,
    start: wp.array(dtype=wp.vec3f),
    direction: wp.vec3f,
    # Out:
    point: wp.array(dtype=wp.vec3f),
    normal: wp.array(dtype=wp.vec3f),
    found: wp.array(dtype=wp.int32),
):
    """Project points along one direction.

    Launch dimension: [point_count].

    Args:
        mesh: Id of the ``wp.Mesh``.
        start: Where the rays begin [m], shape [point_count].
        direction: Unit vector they follow.
        point: Where they arrive [m], shape [point_count].
        normal: Normal there, shape [point_count].
        found: 1 where there is something, shape [point_count].
    """
    i = wp.tid()
    hit = wp.mesh_query_ray(mesh, start[i], direction, 1.0)
    if hit.result:
        point[i] = start[i] + direction * hit.t
        normal[i] = hit.normal
        found[i] = 1


@wp.kernel(enable_backward=False)
def _rasterize_kernel(
    # In:
    st: wp.array2d(dtype=wp.vec2f),
    value: wp.array3d(dtype=wp.float32),
    # Out:
    texel: wp.array3d(dtype=wp.float32),
    covered: wp.array2d(dtype=wp.int32),
):
    """Fill the texels whose centres lie in a triangle with what its corners say.

    Launch dimension: [triangle_count].

    Args:
        st: Texture coordinates of the corners [px], y down, shape [triangle_count, 3].
        value: Values at the corners, shape [triangle_count, 3, channel_count].
        texel: Values, shape [height, width, channel_count].
        covered: 1 in a triangle, shape [height, width].
    """
    t = wp.tid()
    a = st[t, 0]
    b = st[t, 1]
    c = st[t, 2]
    area = (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
    if area == 0.0:
        return
    slack = 1.0e-3
    first_row = wp.max(0, int(wp.floor(wp.min(a[1], wp.min(b[1], c[1])) - 0.5)))
    last_row = wp.min(covered.shape[0] - 1, int(wp.ceil(wp.max(a[1], wp.max(b[1], c[1])))))
    first = wp.max(0, int(wp.floor(wp.min(a[0], wp.min(b[0], c[0])) - 0.5)))
    last = wp.min(covered.shape[1] - 1, int(wp.ceil(wp.max(a[0], wp.max(b[0], c[0])))))
    for row in range(first_row, last_row + 1):
        for column in range(first, last + 1):
            x = float(column) + 0.5
            y = float(row) + 0.5
            v = ((x - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (y - a[1])) / area
            w = ((b[0] - a[0]) * (y - a[1]) - (x - a[0]) * (b[1] - a[1])) / area
            if v >= -slack and w >= -slack and v + w <= 1.0 + slack:
                covered[row, column] = 1
                for k in range(value.shape[2]):
                    texel[row, column, k] = (
                        value[t, 0, k] * (1.0 - v - w) + value[t, 1, k] * v + value[t, 2, k] * w
                    )


@functools.cache
def workers() -> Workers:
    """Return Warp on all cores, started quietly."""
    return open_workers("cpu")


def load(module: str) -> None:
    """Compile the kernels of a module, before threads ask for them together."""
    workers()
    wp.load_module(module, device="cpu")


def ray_mesh(parts: list[Triangles]) -> wp.Mesh:
    """Return the triangles of several objects as one mesh for rays."""
    counts = np.cumsum([0, *(len(part.points) for part in parts)])
    indices = [part.indices + first for part, first in zip(parts, counts[:-1], strict=True)]
    return wp.Mesh(
        points=_vectors(np.concatenate([part.points for part in parts])),
        indices=wp.array(np.concatenate(indices).ravel(), dtype=wp.int32, device="cpu"),
    )


def point_normals(part: Triangles) -> Float32Array:
    """Return the mean normal of each point's corners, shape [point_count, 3]."""
    total = np.zeros_like(part.points)
    np.add.at(total, part.indices.ravel(), part.normals.reshape(-1, 3))
    return total / np.maximum(np.linalg.norm(total, axis=1, keepdims=True), 1e-9)


def thickness(
    mesh: wp.Mesh, points: Float32Array, normals: Float32Array, largest: float
) -> Float32Array:
    """Return how thick the body is under points near its surface [m], at most ``largest``."""
    result = wp.zeros(len(points), dtype=wp.float32, device="cpu")
    wp.launch(
        _thickness_kernel,
        dim=len(points),
        inputs=[mesh.id, _vectors(points), _vectors(normals), largest, result],
        device="cpu",
    )
    return result.numpy()


def cast(
    mesh: wp.Mesh, starts: FloatArray, direction: FloatArray
) -> tuple[Float32Array, Float32Array, NDArray[np.bool_]]:
    """Return where rays arrive, the normals there, and which of them do."""
    count = len(starts)
    point, normal = (wp.zeros(count, dtype=wp.vec3f, device="cpu") for _ in range(2))
    found = wp.zeros(count, dtype=wp.int32, device="cpu")
    wp.launch(
        _cast_kernel,
        dim=count,
        inputs=[mesh.id, _vectors(starts), wp.vec3f(*direction.tolist()), point, normal, found],
        device="cpu",
    )
    return point.numpy(), normal.numpy(), found.numpy() > 0


def rasterize(
    part: Triangles, values: Float32Array, size: tuple[int, int]
) -> tuple[Float32Array, NDArray[np.bool_]]:
    """Return values of the corners as a picture in texture space, first row at the top.

    Args:
        part: Triangles with texture coordinates.
        values: Shape [triangle_count, 3, channel_count].
        size: Width and height [px].

    Returns:
        Pixels, shape [height, width, channel_count], and which of them are in a triangle.
    """
    assert part.st is not None
    width, height = size
    place = part.st * np.array([1.0, -1.0], np.float32) + np.array([0.0, 1.0], np.float32)
    st = wp.array(
        np.ascontiguousarray(place * np.array(size, np.float32)), dtype=wp.vec2f, device="cpu"
    )
    texel = wp.zeros((height, width, values.shape[2]), dtype=wp.float32, device="cpu")
    covered = wp.zeros((height, width), dtype=wp.int32, device="cpu")
    value = wp.array(np.ascontiguousarray(values, np.float32), device="cpu")
    wp.launch(_rasterize_kernel, dim=len(st), inputs=[st, value, texel, covered], device="cpu")
    return texel.numpy(), covered.numpy() > 0


def spread(pixels: Float32Array, covered: NDArray[np.bool_], steps: int) -> Float32Array:
    """Return pixels with those around the covered ones filled from their neighbours."""
    pixels, known = pixels.copy(), covered.copy()
    for _ in range(steps):
        total = np.zeros_like(pixels)
        count = np.zeros(known.shape, np.float32)
        for axis, shift in ((0, 1), (0, -1), (1, 1), (1, -1)):
            near = np.roll(known, shift, axis)
            total += np.roll(pixels, shift, axis) * near[..., None]
            count += near
        grown = ~known & (count > 0)
        pixels[grown] = total[grown] / count[grown][:, None]
        known |= grown
    return pixels


def _vectors(values: NDArray) -> wp.array:
    return wp.array(np.ascontiguousarray(values, np.float32), dtype=wp.vec3f, device="cpu")
