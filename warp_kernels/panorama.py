"""Fisheye views into the sums of a panorama, and what each view holds on its own."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.area import Patch, Texel, angle_pair, average_texel, project_direction
from usdskin.warp_kernels.fisheye import CLIPPED, MOVED, Lens, View, radius_node

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

PI = wp.constant(3.14159265358979)
STRIP = wp.constant(64)
STRIDE = wp.constant(4)
CLEAR_SIGNAL = wp.constant(10.0)


@wp.struct
class Sums:
    """What the views so far have left in each texel, all of shape [height, width].

    L is image value over V, w the weight of a view there.
    """

    value: wp.array2d[wp.vec3f]
    """Sum of w L."""

    variance: wp.array2d[wp.vec3f]
    """Sum of w^2 var(L)."""

    weight: wp.array2d[wp.float32]
    """Sum of w."""

    clipped: wp.array2d[wp.float32]
    """Share of the texel that is a lower bound only; above 0 no view has it unclipped."""

    moved: wp.array2d[wp.float32]
    """Sum of w times the share that moved between exposures."""

    cells: wp.array2d[wp.uint16]
    """Bit 4 b + a: cell (a, b) of the texel's 4 x 4 is seen, a along the row, b down."""

    count: wp.array2d[wp.uint8]
    """Number of views in the sums."""


@wp.func
def _sum(v: wp.vec3f) -> wp.float32:
    return v[0] + v[1] + v[2]


@wp.func
def _difference(sums: Sums, i: wp.int32, j: wp.int32, texel: Texel) -> wp.float32:
    """Return the relative difference of a view from those before it, -1 where noise hides it."""
    weight = sums.weight[i, j]
    if weight <= 0.0 or sums.clipped[i, j] > 0.0 or texel.clipped > 0.0:
        return -1.0
    mine = _sum(texel.value)
    other = _sum(sums.value[i, j]) / weight
    my_noise = wp.sqrt(_sum(texel.variance))
    other_noise = wp.sqrt(_sum(sums.variance[i, j])) / weight
    if mine <= CLEAR_SIGNAL * my_noise or other <= CLEAR_SIGNAL * other_noise:
        return -1.0
    return 2.0 * wp.abs(mine - other) / (mine + other)


@wp.func
def _view_weight(view: View, patch: Patch, texel: Texel) -> wp.float32:
    """Return the weight of a view in a texel: by angle, noise, and what is seen and still."""
    # Photon noise: at equal L the variance goes as 1 / V.
    corners = patch.left_top + patch.left_bottom + patch.right_top + patch.right_bottom
    variance = 0.25 * corners[2] * view.noise
    return texel.weight * texel.seen * (1.0 - 0.99 * texel.moved) / variance


@wp.func
def _add_texel(sums: Sums, i: wp.int32, j: wp.int32, texel: Texel, weight: wp.float32):
    """Add a view's texel to the sums; one without clipping wins over any with it.

    Among clipped ones the greater is the better lower bound.
    """
    sums.cells[i, j] = wp.uint16(wp.int32(sums.cells[i, j]) | texel.cells)
    held = sums.weight[i, j]
    if held > 0.0:
        was_clipped = sums.clipped[i, j] > 0.0
        is_clipped = texel.clipped > 0.0
        if is_clipped and not was_clipped:
            return
        if is_clipped and _sum(texel.value) * held <= _sum(sums.value[i, j]):
            return
        if was_clipped:
            held = 0.0
    if held <= 0.0:
        sums.value[i, j] = weight * texel.value
        sums.variance[i, j] = (weight * weight) * texel.variance
        sums.weight[i, j] = weight
        sums.clipped[i, j] = texel.clipped
        sums.moved[i, j] = weight * texel.moved
        sums.count[i, j] = wp.uint8(1)
    else:
        sums.value[i, j] = sums.value[i, j] + weight * texel.value
        sums.variance[i, j] = sums.variance[i, j] + (weight * weight) * texel.variance
        sums.weight[i, j] = held + weight
        sums.moved[i, j] = sums.moved[i, j] + weight * texel.moved
        sums.count[i, j] = wp.uint8(wp.int32(sums.count[i, j]) + 1)


@wp.kernel(enable_backward=False)
def _add_view_kernel(
    # In:
    lens: Lens,
    view: View,
    first_row: wp.int32,
    # In and out:
    sums: Sums,
    # Out:
    flux_out: wp.array2d[wp.vec3d],
    difference_out: wp.array2d[wp.float32],
):
    """Add one view to a strip of texels; neighbours share the corners between them.

    Rows vary fastest, so that a CPU meets the same part of the picture again while it is cached.

    Launch dimension: [ceil(width / STRIP), row_count].

    Args:
        lens: The lens.
        view: The view.
        first_row: Row of the first thread.
        sums: Sums of all views.
        flux_out: Sum over each strip of mean value times the share of the texel that is seen,
            shape [row_count, strip_count].
        difference_out: Relative difference from the views before of every STRIDE-th texel each
            way, -1 where there is none to tell, shape [row_count / STRIDE, width / STRIDE].
    """
    strip, row = wp.tid()
    i = first_row + row
    width = sums.weight.shape[1]
    begin = strip * STRIP
    end = wp.min(begin + STRIP, width)
    step = PI / wp.float32(sums.weight.shape[0])
    polar = step * wp.float32(i)
    top = angle_pair(polar)
    bottom = angle_pair(step * wp.float32(i + 1))
    # Counted from the middle column, which is +Z: small angles keep more of their digits.
    right = angle_pair(step * wp.float32(begin - width / 2))
    patch = Patch()
    patch.rows = 1
    patch.columns = 1
    patch.sine_top = top[0]
    patch.sine_bottom = bottom[0]
    patch.right_top = project_direction(lens, view, top, right)
    patch.right_bottom = project_direction(lens, view, bottom, right)
    flux = wp.vec3d()
    for j in range(begin, end):
        right = angle_pair(step * wp.float32(j + 1 - width / 2))
        patch.left_top = patch.right_top
        patch.left_bottom = patch.right_bottom
        patch.right_top = project_direction(lens, view, top, right)
        patch.right_bottom = project_direction(lens, view, bottom, right)
        left_weight = wp.min(patch.left_top[3], patch.left_bottom[3])
        right_weight = wp.min(patch.right_top[3], patch.right_bottom[3])
        if wp.min(left_weight, right_weight) > 0.0:
            azimuth = step * wp.float32(j - width / 2)
            texel = average_texel(lens, view, patch, polar, azimuth, step)
            if texel.seen > 0.0:
                weight = _view_weight(view, patch, texel)
                part = texel.seen * texel.value
                flux += wp.vec3d(wp.float64(part[0]), wp.float64(part[1]), wp.float64(part[2]))
                if row % STRIDE == 0 and j % STRIDE == 0:
                    difference_out[row / STRIDE, j / STRIDE] = _difference(sums, i, j, texel)
                _add_texel(sums, i, j, texel, weight)
    flux_out[row, strip] = flux


def add_view(
    lens: Lens, view: View, sums: Sums, first_row: int, row_count: int
) -> tuple[wp.array2d[wp.vec3d], wp.array2d[wp.float32]]:
    """Add a view to some rows of the panorama; return ``flux_out`` and ``difference_out``."""
    width = sums.weight.shape[1]
    device = sums.weight.device
    strips = (width + STRIP - 1) // STRIP
    flux = wp.empty((row_count, strips), dtype=wp.vec3d, device=device)
    strided = ((row_count + STRIDE - 1) // STRIDE, (width + STRIDE - 1) // STRIDE)
    difference = wp.full(strided, -1.0, dtype=wp.float32, device=device)
    wp.launch(
        _add_view_kernel,
        dim=(strips, row_count),
        inputs=[lens, view, first_row, sums],
        outputs=[flux, difference],
        device=device,
    )
    return flux, difference


# --- Sums over a view --------------------------------------------------------------------------


@wp.kernel(enable_backward=False)
def _sum_rows_kernel(
    # In:
    lens: Lens,
    value: wp.array2d[wp.vec3f],
    first_row: wp.int32,
    # Out:
    sum_out: wp.array[wp.vec3d],
):
    """Integrate I / V over the solid angle that one row of a view holds.

    Launch dimension: [row_count].

    Args:
        lens: The lens.
        value: Image values, shape [height, width].
        first_row: Row of the first thread.
        sum_out: Sum of I dOmega / V, shape [height].
    """
    row = first_row + wp.tid()
    y = wp.float32(row) + 0.5 - lens.center[1]
    total = wp.vec3d()
    for column in range(lens.width):
        x = wp.float32(column) + 0.5 - lens.center[0]
        radius = wp.sqrt(x * x + y * y)
        if radius <= lens.max_radius:
            node = radius_node(lens, radius)
            part = (node[2] * node[3]) * value[row, column]
            total += wp.vec3d(wp.float64(part[0]), wp.float64(part[1]), wp.float64(part[2]))
    sum_out[row] = total


def sum_rows(
    lens: Lens,
    value: wp.array2d[wp.vec3f],
    sum_out: wp.array[wp.vec3d],
    first_row: int,
    row_count: int,
) -> None:
    """Sum some rows of a view into ``sum_out``."""
    wp.launch(
        _sum_rows_kernel,
        dim=row_count,
        inputs=[lens, value, first_row],
        outputs=[sum_out],
        device=value.device,
    )


@wp.kernel(enable_backward=False)
def _survey_blocks_kernel(
    # In:
    lens: Lens,
    view: View,
    first_row: wp.int32,
    # Out:
    noise_out: wp.array2d[wp.float32],
):
    """Measure the noise of a block of pixels, and tell whether any of them is flagged.

    Launch dimension: [block_row_count, block_columns].

    Args:
        lens: The lens.
        view: The view; ``flagged`` is written.
        first_row: Row of blocks of the first thread.
        noise_out: Variance over value, both summed over channels and the pixels of picture that
            are not clipped, -1 for a block without any, shape [block_rows, block_columns].
    """
    block_row, block_column = wp.tid()
    block_row = block_row + first_row
    top = block_row * view.block
    left = block_column * view.block
    flags = int(0)
    value = float(0.0)
    variance = float(0.0)
    count = int(0)
    for row in range(top, wp.min(top + view.block, lens.height)):
        for column in range(left, wp.min(left + view.block, lens.width)):
            x = wp.float32(column) + 0.5 - lens.center[0]
            y = wp.float32(row) + 0.5 - lens.center[1]
            bits = wp.int32(view.status[row, column])
            flags = flags | bits
            is_picture = x * x + y * y <= lens.max_radius * lens.max_radius
            if is_picture and (bits & CLIPPED) == 0:
                value += _sum(view.value[row, column])
                variance += _sum(view.variance[row, column])
                count += 1
    view.flagged[block_row, block_column] = wp.uint8(flags & (CLIPPED | MOVED))
    noise_out[block_row, block_column] = -1.0
    if variance > 0.0:
        # In the dark the value is its noise.
        noise_out[block_row, block_column] = variance / wp.max(value, wp.sqrt(variance))
    elif count > 0:
        noise_out[block_row, block_column] = 0.0


def survey_blocks(
    lens: Lens, view: View, noise_out: wp.array2d[wp.float32], first_row: int, row_count: int
) -> None:
    """Survey some rows of blocks of a view into ``view.flagged`` and ``noise_out``."""
    wp.launch(
        _survey_blocks_kernel,
        dim=(row_count, noise_out.shape[1]),
        inputs=[lens, view, first_row],
        outputs=[noise_out],
        device=noise_out.device,
    )
