"""Means of a fisheye view over the solid angle of a latlong texel.

Rays are projected at the corners of patches of at most 3 px; between them each patch is sampled
4 x 4 times, so at most 0.75 px apart: no pixel of the view is stepped over.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.fisheye import (
    Lens,
    View,
    is_flagged,
    is_inner,
    lookup_inner,
    lookup_view,
    project,
)

# Unrolled, 16 lookups in a row compile slowly and run no faster.
wp.set_module_options({"enable_backward": False, "max_unroll": 1})

GRID = wp.constant(4)
PATCH_PX = wp.constant(3.0)
MAX_PATCHES = wp.constant(512)


@wp.struct
class Patch:
    """A piece of a texel; its corners are (u, v) [px], 1 / V and the blending weight."""

    left_top: wp.vec4f
    right_top: wp.vec4f
    left_bottom: wp.vec4f
    right_bottom: wp.vec4f

    sine_top: wp.float32
    sine_bottom: wp.float32
    """Sines of the polar angle."""

    row: wp.int32
    column: wp.int32
    """Its place in the texel."""

    rows: wp.int32
    columns: wp.int32
    """Patches in the texel."""


@wp.struct
class Texel:
    """Sums over the samples of a texel, and then means over those that a view sees."""

    value: wp.vec3f
    variance: wp.vec3f
    variance_share: wp.float32
    """Weight of the samples in ``variance``."""

    clipped: wp.float32
    moved: wp.float32
    weight: wp.float32
    """Blending weight by angle."""

    seen: wp.float32
    """Weight of the samples that are seen; then their share of the texel."""

    total: wp.float32
    """Weight of all samples."""

    cells: wp.int32
    """As in ``Sums``."""


@wp.func
def angle_pair(angle: wp.float32) -> wp.vec2f:
    """Return the sine and the cosine of an angle [rad]."""
    return wp.vec2f(wp.sin(angle), wp.cos(angle))


@wp.func
def project_direction(lens: Lens, view: View, polar: wp.vec2f, azimuth: wp.vec2f) -> wp.vec4f:
    """Project a direction of the panorama; its blending weight is -1 beyond the view's reach.

    Args:
        lens: The lens.
        view: The view.
        polar: Sine and cosine of the polar angle.
        azimuth: Sine and cosine of the azimuth from +Z, growing with the column.
    """
    ray = view.camera_from_map * wp.vec3f(-polar[0] * azimuth[0], polar[1], polar[0] * azimuth[1])
    if -ray[2] < view.reach:
        return wp.vec4f(0.0, 0.0, 0.0, -1.0)
    return project(lens, ray)


@wp.func
def _row_of_samples(patch: Patch, y: wp.float32) -> wp.vec4f:
    """Return (u, v) of the first sample of the row at y, 0 to 1 down, and the step to the next."""
    left = (1.0 - y) * patch.left_top + y * patch.left_bottom
    right = (1.0 - y) * patch.right_top + y * patch.right_bottom
    du = (right[0] - left[0]) / wp.float32(GRID)
    dv = (right[1] - left[1]) / wp.float32(GRID)
    return wp.vec4f(left[0] + 0.5 * du, left[1] + 0.5 * dv, du, dv)


@wp.func
def _mean_of_row(patch: Patch, y: wp.float32) -> wp.vec2f:
    """Return the mean 1 / V and blending weight of a row, at y from top to bottom."""
    top = patch.left_top + patch.right_top
    bottom = patch.left_bottom + patch.right_bottom
    both = (0.5 * (1.0 - y)) * top + (0.5 * y) * bottom
    return wp.vec2f(both[2], both[3])


@wp.func
def _add_rim(lens: Lens, view: View, patch: Patch, texel: Texel) -> Texel:
    """Add the samples of a patch that may lie outside the picture, or have flags, one by one."""
    for b in range(GRID):
        y = (wp.float32(b) + 0.5) / wp.float32(GRID)
        share = (1.0 - y) * patch.sine_top + y * patch.sine_bottom
        start = _row_of_samples(patch, y)
        mean = _mean_of_row(patch, y)
        line = 4 * ((GRID * patch.row + b) / patch.rows)
        for a in range(GRID):
            u = start[0] + wp.float32(a) * start[2]
            v = start[1] + wp.float32(a) * start[3]
            sample = lookup_view(lens, view, u, v)
            texel.total += share
            if sample.weight > 0.0:
                texel.value += share * sample.value
                texel.variance += share * sample.variance
                texel.variance_share += share
                texel.clipped += share * sample.clipped
                texel.moved += share * sample.moved
                texel.weight += share * mean[1]
                texel.seen += share
                cell = line + (GRID * patch.column + a) / patch.columns
                texel.cells = texel.cells | (1 << cell)
    return texel


@wp.func
def _quarters(first: wp.int32, size: wp.int32) -> wp.int32:
    """Return a bit for each quarter of ``size`` groups of GRID that group ``first`` touches."""
    quarters = int(0)
    for k in range(GRID):
        quarters = quarters | (1 << ((GRID * first + k) / size))
    return quarters


@wp.func
def _add_inner(view: View, patch: Patch, texel: Texel) -> Texel:
    """Add the samples of a patch that are picture without flags."""
    for b in range(GRID):
        y = (wp.float32(b) + 0.5) / wp.float32(GRID)
        share = (1.0 - y) * patch.sine_top + y * patch.sine_bottom
        start = _row_of_samples(patch, y)
        mean = _mean_of_row(patch, y)
        row = wp.vec3f(0.0, 0.0, 0.0)
        u = float(start[0])
        v = float(start[1])
        for _a in range(GRID):
            row += lookup_inner(view, u, v)
            u += start[2]
            v += start[3]
        texel.value += (share * mean[0]) * row
        # One pixel of each row, along the diagonal, tells the variance well enough.
        u = start[0] + wp.float32(b) * start[2]
        v = start[1] + wp.float32(b) * start[3]
        held = view.variance[wp.int32(v), wp.int32(u)]
        texel.variance += (share * mean[0] * mean[0]) * held
        texel.variance_share += share
        texel.weight += (wp.float32(GRID) * share) * mean[1]
        texel.seen += wp.float32(GRID) * share
        texel.total += wp.float32(GRID) * share
    across = _quarters(patch.column, patch.columns)
    down = _quarters(patch.row, patch.rows)
    for b in range(4):
        if (down & (1 << b)) != 0:
            texel.cells = texel.cells | (across << (4 * b))
    return texel


@wp.func
def _add_patch(lens: Lens, view: View, patch: Patch, texel: Texel) -> Texel:
    """Add the samples of a patch to its texel."""
    top = wp.min(patch.left_top[3], patch.right_top[3])
    if wp.min(top, wp.min(patch.left_bottom[3], patch.right_bottom[3])) < 0.0:
        rows = 0.5 * wp.float32(GRID) * (patch.sine_top + patch.sine_bottom)
        texel.total += wp.float32(GRID) * rows
        return texel
    middle = 0.25 * (patch.left_top + patch.right_top + patch.left_bottom + patch.right_bottom)
    is_plain = not is_flagged(view, middle[0], middle[1])
    is_plain = is_plain and wp.max(patch.rows, patch.columns) < MAX_PATCHES
    is_plain = is_plain and is_inner(lens, patch.left_top[0], patch.left_top[1])
    is_plain = is_plain and is_inner(lens, patch.right_top[0], patch.right_top[1])
    is_plain = is_plain and is_inner(lens, patch.left_bottom[0], patch.left_bottom[1])
    is_plain = is_plain and is_inner(lens, patch.right_bottom[0], patch.right_bottom[1])
    if is_plain:
        return _add_inner(view, patch, texel)
    return _add_rim(lens, view, patch, texel)


@wp.func
def _patch_count(size: wp.float32) -> wp.int32:
    """Return how many patches a texel of ``size`` [px] is cut into."""
    count = wp.ceil(wp.min(size / PATCH_PX, wp.float32(MAX_PATCHES)))
    return wp.max(wp.int32(count), 1)


@wp.func
def _distance(a: wp.vec4f, b: wp.vec4f) -> wp.float32:
    return wp.length(wp.vec2f(a[0] - b[0], a[1] - b[1]))


@wp.func
def _averaging(width: wp.float32, height: wp.float32) -> wp.float32:
    """Return the variance of a mean over a footprint [px] of bilinear lookups, for unit variance.

    Exactly, a box of width a over tents gives the integral of its autocorrelation times a cubic
    B-spline per axis; 1 / sqrt(a^2 + 9/4) has its limits, 2/3 at 0 and 1 / a, and is within 5 %
    of it between.
    """
    return 1.0 / wp.sqrt((width * width + 2.25) * (height * height + 2.25))


@wp.func
def average_texel(
    lens: Lens, view: View, whole: Patch, polar: wp.float32, azimuth: wp.float32, step: wp.float32
) -> Texel:
    """Average a view over a texel, on a grid that steps over no pixel of the view.

    Samples weigh by the sine of their polar angle, which makes solid angles of them.

    Args:
        lens: The lens.
        view: The view.
        whole: The texel as one patch.
        polar: Polar angle of its top edge [rad].
        azimuth: Azimuth of its left edge from +Z [rad], growing with the column.
        step: Its side [rad].
    """
    top = _distance(whole.left_top, whole.right_top)
    bottom = _distance(whole.left_bottom, whole.right_bottom)
    left = _distance(whole.left_top, whole.left_bottom)
    right = _distance(whole.right_top, whole.right_bottom)
    texel = Texel()
    patch = whole
    patch.rows = _patch_count(wp.max(left, right))
    patch.columns = _patch_count(wp.max(top, bottom))
    if patch.rows == 1 and patch.columns == 1:
        texel = _add_patch(lens, view, whole, texel)
    else:
        for pb in range(patch.rows):
            upper = angle_pair(polar + step * (wp.float32(pb) / wp.float32(patch.rows)))
            lower = angle_pair(polar + step * (wp.float32(pb + 1) / wp.float32(patch.rows)))
            patch.row = pb
            patch.sine_top = upper[0]
            patch.sine_bottom = lower[0]
            edge = angle_pair(azimuth)
            patch.right_top = project_direction(lens, view, upper, edge)
            patch.right_bottom = project_direction(lens, view, lower, edge)
            for pa in range(patch.columns):
                edge = angle_pair(azimuth + step * (wp.float32(pa + 1) / wp.float32(patch.columns)))
                patch.column = pa
                patch.left_top = patch.right_top
                patch.left_bottom = patch.right_bottom
                patch.right_top = project_direction(lens, view, upper, edge)
                patch.right_bottom = project_direction(lens, view, lower, edge)
                texel = _add_patch(lens, view, patch, texel)
    if texel.seen > 0.0:
        part = 1.0 / texel.seen
        averaged = _averaging(0.5 * (top + bottom), 0.5 * (left + right)) / texel.variance_share
        texel.value = part * texel.value
        texel.variance = averaged * texel.variance
        texel.clipped = part * texel.clipped
        texel.moved = part * texel.moved
        texel.weight = part * texel.weight
        texel.seen = texel.seen / texel.total
    return texel
