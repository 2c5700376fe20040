"""First surfaces by rasterisation: what every sample of a band of rows sees.

On a CPU this finds what camera rays would find at a fraction of the cost: samples are coherent,
and a triangle meets only the few it may cover. The kernel is serial over a band's triangles, so a
GPU traces rays instead.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from numpy.typing import NDArray

wp.set_module_options({"enable_backward": False})


@wp.struct
class Projection:
    """Triangles as the camera sees them, and which may touch which band of rows."""

    screen: wp.array[wp.vec3f]
    """Picture position [px] and nearness of each vertex, shape [vertex_count]. Nearness is affine
    over the picture and grows towards the camera: 1 / depth, or -depth where orthographic."""

    triangle: wp.array2d[wp.int32]
    """Vertices of each triangle, shape [triangle_count, 3]."""

    listed: wp.array[wp.int32]
    """Triangles of all bands, band after band, ascending in each."""

    first: wp.array[wp.int32]
    """First entry of each band in ``listed``, shape [band_count + 1]."""

    least: wp.float32
    """Nearness of the far clipping plane."""

    reach: wp.float32
    """How far samples lie from their pixel's middle at most [px]."""


TINY = wp.constant(1.0e-37)

TIE = wp.constant(1.0e-6)
"""How much nearer than an earlier triangle a later one must be: more than rounding."""


@wp.struct
class Edge:
    """An edge of a triangle, from its vertex of the lower index to the other one.

    So two triangles leave no gap along the edge they share: for both it is the same number.
    """

    x: wp.float32
    y: wp.float32
    """Where it begins [px]."""

    along: wp.float32
    down: wp.float32
    """To where it ends [px]."""

    turn: wp.float32
    """1 where the triangle lies on its positive side, else -1."""

    least: wp.float32
    """What a sample inside has at least. Samples on the edge itself belong to the triangle to its
    right, or below it, so to one of the two and to one of those around a vertex."""

    margin: wp.float32
    """What its function changes by within a pixel's samples, at most [px^2]."""


@wp.func
def _edge(
    a: wp.vec3f, b: wp.vec3f, ia: wp.int32, ib: wp.int32, turn: wp.float32, reach: wp.float32
) -> Edge:
    edge = Edge()
    first = a
    last = b
    edge.turn = turn
    if ia > ib:
        first = b
        last = a
        edge.turn = -turn
    edge.x = first[0]
    edge.y = first[1]
    edge.along = last[0] - first[0]
    edge.down = last[1] - first[1]
    to_right = -edge.turn * edge.down
    if to_right < 0.0 or (to_right == 0.0 and edge.turn * edge.along < 0.0):
        edge.least = TINY
    # A little more, for rounding.
    edge.margin = 1.001 * reach * (wp.abs(edge.along) + wp.abs(edge.down))
    return edge


@wp.func
def _side(edge: Edge, x: wp.float32, y: wp.float32) -> wp.float32:
    """Return twice the signed area of the edge and a point."""
    return edge.along * (y - edge.y) - edge.down * (x - edge.x)


@wp.func
def _beside(edge: Edge, at_middle: wp.float32, offset: wp.vec2f) -> wp.float32:
    """Return how far a sample lies inside, from ``_side`` of its pixel's middle."""
    return edge.turn * (at_middle + (edge.along * offset[1] - edge.down * offset[0]))


@wp.kernel(enable_backward=False)
def _rasterize_kernel(
    # In:
    projection: Projection,
    sample: wp.array[wp.vec2f],
    band: wp.int32,
    width: wp.int32,
    first_row: wp.int32,
    row_count: wp.int32,
    wanted: wp.array[wp.int32],
    # Scratch:
    nearness: wp.array2d[wp.float32],
    # Out:
    face_out: wp.array2d[wp.int32],
):
    """Find the nearest triangle of every sample of one band.

    Launch dimension: [1].

    Args:
        projection: The triangles.
        sample: Sample offsets from a pixel's middle [px], shape [samples].
        band: Which band.
        width: Columns of the picture [px].
        first_row: First row of the band.
        row_count: Rows of the band.
        wanted: Not 0 for pixels that are asked for, shape [pixels].
        nearness: Nearness found so far, zeroed by this kernel, shape [pixels, samples].
        face_out: Triangle, -1 where there is none, shape [pixels, samples].
    """
    samples = sample.shape[0]
    for pixel in range(width * row_count):
        if wanted[pixel] != 0:
            for s in range(samples):
                nearness[pixel, s] = projection.least
                face_out[pixel, s] = -1
    for entry in range(projection.first[band], projection.first[band + 1]):
        face = projection.listed[entry]
        ia = projection.triangle[face, 0]
        ib = projection.triangle[face, 1]
        ic = projection.triangle[face, 2]
        a = projection.screen[ia]
        b = projection.screen[ib]
        c = projection.screen[ic]
        area = (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
        if area != 0.0:
            low_x = wp.min(a[0], wp.min(b[0], c[0])) - projection.reach
            high_x = wp.max(a[0], wp.max(b[0], c[0])) + projection.reach
            low_y = wp.min(a[1], wp.min(b[1], c[1])) - projection.reach
            high_y = wp.max(a[1], wp.max(b[1], c[1])) + projection.reach
            j0 = wp.int32(wp.clamp(low_x, 0.0, wp.float32(width)))
            j1 = wp.int32(wp.clamp(high_x + 1.0, 0.0, wp.float32(width)))
            top = wp.float32(first_row)
            i0 = wp.int32(wp.clamp(low_y - top, 0.0, wp.float32(row_count)))
            i1 = wp.int32(wp.clamp(high_y - top + 1.0, 0.0, wp.float32(row_count)))
            turn = wp.sign(area)
            weight = 1.0 / wp.abs(area)
            ab = _edge(a, b, ia, ib, turn, projection.reach)
            bc = _edge(b, c, ib, ic, turn, projection.reach)
            ca = _edge(c, a, ic, ia, turn, projection.reach)
            for i in range(i0, i1):
                y = top + wp.float32(i) + 0.5
                for j in range(j0, j1):
                    pixel = i * width + j
                    x = wp.float32(j) + 0.5
                    side_c = _side(ab, x, y)
                    side_a = _side(bc, x, y)
                    side_b = _side(ca, x, y)
                    inside = ab.turn * side_c >= -ab.margin
                    inside = inside and bc.turn * side_a >= -bc.margin
                    inside = inside and ca.turn * side_b >= -ca.margin
                    if inside and wanted[pixel] != 0:
                        for s in range(samples):
                            wc = _beside(ab, side_c, sample[s])
                            wa = _beside(bc, side_a, sample[s])
                            wb = _beside(ca, side_b, sample[s])
                            if wa >= bc.least and wb >= ca.least and wc >= ab.least:
                                near = (wa * a[2] + wb * b[2] + wc * c[2]) * weight
                                if near - nearness[pixel, s] > TIE * wp.abs(near):
                                    nearness[pixel, s] = near
                                    face_out[pixel, s] = face


def rasterize_band(
    projection: Projection,
    sample: wp.array[wp.vec2f],
    band: int,
    width: int,
    first_row: int,
    row_count: int,
    pixels: NDArray[np.int32] | None = None,
) -> wp.array2d[wp.int32]:
    """Return the first triangle of every sample of a band, -1 for none, [pixels, samples].

    Where only some ``pixels`` are asked for, the rest is not set.
    """
    wanted = np.zeros(width * row_count, np.int32)
    wanted[slice(None) if pixels is None else pixels] = 1
    asked = wp.array(wanted, device=sample.device)
    shape = (width * row_count, sample.shape[0])
    face = wp.empty(shape, dtype=wp.int32, device=sample.device)
    nearness = wp.empty(shape, dtype=wp.float32, device=sample.device)
    wp.launch(
        _rasterize_kernel,
        dim=1,
        inputs=[projection, sample, band, width, first_row, row_count, asked, nearness],
        outputs=[face],
        device=sample.device,
    )
    return face
