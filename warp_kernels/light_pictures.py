"""Where a rectangle's picture is bright: directions drawn by brightness and by solid angle."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_shapes import rect_weight, sample_rect


@wp.struct
class Guides:
    """Coarse brightness of the pictures on rectangles, in cells as the texels are laid out."""

    size: wp.array[wp.vec3i]
    """(first value, columns, rows), columns 0 where none is needed, shape [light_count]."""

    share: wp.array[wp.float32]
    """Part of the samples that follow the picture; the others follow the solid angle, shape
    [light_count]."""

    sum: wp.array[wp.float32]
    """Ascending sums up to 1: first over the rows, then over the columns within each row."""


@wp.func
def _pick(sums: wp.array[wp.float32], first: wp.int32, count: wp.int32, u: wp.float32):
    """Return the entry that u falls in, and where in it, as (entry, part, probability)."""
    low = int(0)
    high = count - 1
    while low < high:
        middle = (low + high) // 2
        if sums[first + middle] > u:
            high = middle
        else:
            low = middle + 1
    below = float(0.0)
    if low > 0:
        below = sums[first + low - 1]
    share = sums[first + low] - below
    part = float(0.5)
    if share > 0.0:
        part = wp.clamp((u - below) / share, 0.0, 0.9999999)
    return wp.vec3f(float(low), part, share)


@wp.func
def _cell(gap: wp.vec3f, half: wp.vec2f, size: wp.vec3i, column: wp.int32, row: wp.int32):
    """Return the centre of a cell relative to the position."""
    across = 2.0 * half[0] / float(size[1])
    down = 2.0 * half[1] / float(size[2])
    return wp.vec3f(
        gap[0] + half[0] - (float(column) + 0.5) * across,
        gap[1] + half[1] - (float(row) + 0.5) * down,
        gap[2],
    )


@wp.func
def _cell_half(half: wp.vec2f, size: wp.vec3i):
    return wp.vec2f(half[0] / float(size[1]), half[1] / float(size[2]))


@wp.func
def guided_weight(guides: Guides, k: wp.int32, gap: wp.vec3f, half: wp.vec2f, point: wp.vec3f):
    """Return the weight with which ``sample_guided`` draws a point relative to the position."""
    weight = rect_weight(gap, half, point)
    share = guides.share[k]
    if share <= 0.0 or weight <= 0.0:
        return weight
    size = guides.size[k]
    right = 0.5 - 0.5 * (point[0] - gap[0]) / half[0]
    under = 0.5 - 0.5 * (point[1] - gap[1]) / half[1]
    column = wp.clamp(int(right * float(size[1])), 0, size[1] - 1)
    row = wp.clamp(int(under * float(size[2])), 0, size[2] - 1)
    chance = guides.sum[size[0] + row]
    if row > 0:
        chance -= guides.sum[size[0] + row - 1]
    first = size[0] + size[2] + row * size[1]
    within = guides.sum[first + column]
    if column > 0:
        within -= guides.sum[first + column - 1]
    cell = rect_weight(_cell(gap, half, size, column, row), _cell_half(half, size), point)
    density = (1.0 - share) / weight
    if cell > 0.0:
        density += share * chance * within / cell
    return 1.0 / density


@wp.func
def sample_guided(guides: Guides, k: wp.int32, gap: wp.vec3f, half: wp.vec2f, u: wp.vec2f):
    """Return a point on a rectangle relative to the position, and its weight."""
    share = guides.share[k]
    if share <= 0.0 or gap[2] <= 0.0:
        return sample_rect(gap, half, u)
    drawn = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    if u[0] < share:
        size = guides.size[k]
        row = _pick(guides.sum, size[0], size[2], u[1])
        first = size[0] + size[2] + int(row[0]) * size[1]
        column = _pick(guides.sum, first, size[1], u[0] / share)
        cell = _cell(gap, half, size, int(column[0]), int(row[0]))
        drawn = sample_rect(cell, _cell_half(half, size), wp.vec2f(column[1], row[1]))
    else:
        drawn = sample_rect(gap, half, wp.vec2f((u[0] - share) / (1.0 - share), u[1]))
    point = wp.vec3f(drawn[0], drawn[1], drawn[2])
    drawn[3] = guided_weight(guides, k, gap, half, point)
    return drawn
