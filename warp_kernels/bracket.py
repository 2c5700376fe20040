"""Exposure brackets: photographs of one view into its linear values, their variance and status.

The estimate of a pixel and channel is the fixed point of

    I = sum_k t_k w_k y_k / sum_k t_k w_k,   y_k = x_k / e_k,   w_k = e_k^2 / var(x_k | I),

in which x_k is the linear value of photograph k, e_k its exposure and var the variance expected of
x_k under the merged estimate I, not under x_k itself: a weight that followed the noise of its own
photograph would bias dark pixels low. At the fixed point the noise-weighted residuals add up to
nothing, which is an unbiased estimating equation (Wedderburn, "Quasi-likelihood functions",
Biometrika 61, 1974). The trust t_k falls to 0 where the photograph saturates.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

CLIPPED = wp.constant(1)
"""Bit of a status: saturated in every exposure, the value is a lower bound."""

DARK = wp.constant(2)
"""Bit of a status: no channel stands above the noise."""

MOVED = wp.constant(4)
"""Bit of a status: the exposures contradict one another beyond noise."""

SATURATION = wp.constant(0.97)
"""Share of the range from black to white at which a photograph counts as saturated."""

# Below saturation trust rises over this share of the range. A hard step would choose photographs
# by their own noise, and with it bias what is left: -0.4 sigma of a pixel at the step. On a ramp
# the bias is sigma^2 / width.
_RAMP = wp.constant(0.1)

_PASSES = wp.constant(2)  # from counts over exposure to within 0.2 % at 10 electrons

# Rose, "The sensitivity performance of the human eye on an absolute scale", JOSA 38, 1948: what is
# to be told from noise in a large picture stands 5 standard deviations above it.
_SIGMAS = wp.constant(5.0)
_CHANCE_SIGMAS = wp.constant(5.6)  # one pixel in 1e8


@wp.struct
class Bracket:
    """What the photographs of one view have in common, and their exposures from short to long."""

    exposure: wp.array[wp.float32]
    """Exposure relative to the longest [1], shape [image_count]."""

    photon: wp.array[wp.vec3f]
    """Variance of a linear value per unit of it [1], shape [image_count]."""

    read: wp.array[wp.vec3f]
    """Variance of a linear value without light [1], shape [image_count]."""

    black: wp.array[wp.vec3f]
    """Raw value without light [DN], shape [image_count]."""

    per_range: wp.vec3f
    """1 / (white - black) [DN^-1]."""

    curve: wp.array[wp.vec3f]
    """Linear value of every whole raw value [1], shape [level_count]; empty where raw values are
    linear."""

    tolerance: wp.float32
    """Relative spread between photographs that is no contradiction [1]."""

    rounding: wp.array[wp.vec3f]
    """Variance that rounding to whole raw values adds to linear values evenly spaced from 0 to 1,
    shape [step_count]; one where it is the same for all."""


@wp.func
def _fraction(bracket: Bracket, k: wp.int32, raw: wp.vec3f) -> wp.vec3f:
    """Return raw values as shares of the range from black to white."""
    return wp.cw_mul(raw - bracket.black[k], bracket.per_range)


@wp.func
def _linear(bracket: Bracket, k: wp.int32, raw: wp.vec3f) -> wp.vec3f:
    """Return linear values, 1 at the white level."""
    if bracket.curve.shape[0] == 0:
        return _fraction(bracket, k, raw)
    last = bracket.curve.shape[0] - 1
    r = wp.clamp(wp.int32(raw[0] + 0.5), 0, last)
    g = wp.clamp(wp.int32(raw[1] + 0.5), 0, last)
    b = wp.clamp(wp.int32(raw[2] + 0.5), 0, last)
    return wp.vec3f(bracket.curve[r][0], bracket.curve[g][1], bracket.curve[b][2])


@wp.func
def _variance(bracket: Bracket, k: wp.int32, expected: wp.vec3f) -> wp.vec3f:
    """Return the variance of linear values about what is expected of them."""
    lit = wp.vec3f(wp.max(expected[0], 0.0), wp.max(expected[1], 0.0), wp.max(expected[2], 0.0))
    variance = wp.cw_mul(bracket.photon[k], lit) + bracket.read[k]
    last = bracket.rounding.shape[0] - 1
    if last == 0:
        return variance + bracket.rounding[0]
    at = wp.min(lit, wp.vec3f(1.0)) * wp.float32(last)
    for c in range(3):
        variance[c] += bracket.rounding[wp.int32(at[c] + 0.5)][c]
    return variance


@wp.kernel(enable_backward=False)
def _measure_levels_kernel(
    # In:
    bracket: Bracket,
    raw: wp.array3d[wp.vec3f],
    first_row: wp.int32,
    # Out:
    level_out: wp.array3d[wp.float32],
):
    """Find the largest share of the range among a pixel, its left and its right neighbour.

    Launch dimension: [image_count, rows].

    Args:
        bracket: The photographs' levels.
        raw: Raw values [DN], shape [image_count, block_rows, width].
        first_row: First row of the block to measure.
        level_out: Largest share over the channels [1], shape [image_count, block_rows, width].
    """
    k, row = wp.tid()
    i = first_row + row
    width = raw.shape[2]
    here = wp.max(_fraction(bracket, k, raw[k, i, 0]))
    before = here
    for j in range(width):
        after = here
        if j + 1 < width:
            after = wp.max(_fraction(bracket, k, raw[k, i, j + 1]))
        level_out[k, i, j] = wp.max(wp.max(before, here), after)
        before = here
        here = after


@wp.kernel(enable_backward=False)
def _weigh_saturation_kernel(
    # In:
    bracket: Bracket,
    raw: wp.array3d[wp.vec3f],
    level: wp.array3d[wp.float32],
    row_count: wp.int32,
    first_row: wp.int32,
    # Out:
    trust_out: wp.array3d[wp.float32],
):
    """Find the trust in a pixel: 0 where it, or one of its 8 neighbours, is saturated.

    Of the shortest photograph only saturated pixels are lost: nothing could stand in for the
    pixels beside them.

    Launch dimension: [image_count, rows].

    Args:
        bracket: The photographs' levels.
        raw: Raw values [DN], shape [image_count, block_rows, width].
        level: What ``_measure_levels_kernel`` found, shape [image_count, block_rows, width].
        row_count: Rows of the block that hold picture.
        first_row: First row of the block to weigh.
        trust_out: Trust, 0 to 1, shape [image_count, block_rows, width].
    """
    k, row = wp.tid()
    i = first_row + row
    above = wp.max(i - 1, 0)
    below = wp.min(i + 1, row_count - 1)
    for j in range(raw.shape[2]):
        if k == 0:
            here = wp.max(_fraction(bracket, k, raw[k, i, j]))
            trust_out[k, i, j] = wp.where(here < SATURATION, 1.0, 0.0)
        else:
            highest = wp.max(wp.max(level[k, above, j], level[k, i, j]), level[k, below, j])
            trust_out[k, i, j] = wp.clamp((SATURATION - highest) / _RAMP, 0.0, 1.0)


@wp.func
def _largest_chi2(freedom: wp.float32) -> wp.float32:
    """Return the quantile of chi-square that chance leaves alone.

    Wilson and Hilferty, "The distribution of chi-square", PNAS 17, 1931.
    """
    f = 2.0 / (9.0 * freedom)
    root = 1.0 - f + _CHANCE_SIGMAS * wp.sqrt(f)
    return freedom * root * root * root


@wp.kernel(enable_backward=False)
def _merge_rows_kernel(
    # In:
    bracket: Bracket,
    raw: wp.array3d[wp.vec3f],
    trust: wp.array3d[wp.float32],
    dark: wp.array2d[wp.vec3f],
    first_row: wp.int32,
    # Out:
    values_out: wp.array2d[wp.vec3f],
    variance_out: wp.array2d[wp.vec3f],
    status_out: wp.array2d[wp.uint8],
):
    """Merge one pixel of all photographs.

    Launch dimension: [rows, width].

    Args:
        bracket: The photographs' exposures, noise and levels.
        raw: Raw values [DN], shape [image_count, block_rows, width].
        trust: What ``_weigh_saturation_kernel`` found, shape [image_count, block_rows, width].
        dark: Linear values of the dark frame [1], shape [block_rows, width]; no rows: none.
        first_row: Row of the block that is merged to the first row of the outputs.
        values_out: Merged value per relative exposure [1], shape [rows, width].
        variance_out: Its variance [1], shape [rows, width].
        status_out: Bits CLIPPED, DARK and MOVED, shape [rows, width].
    """
    row, j = wp.tid()
    i = first_row + row
    offset = wp.vec3f(0.0)
    if dark.shape[0] > 0:
        offset = dark[i, j]
    image_count = raw.shape[0]

    counts = wp.vec3f(0.0)
    exposed = float(0.0)
    for k in range(image_count):
        t = trust[k, i, j]
        if t > 0.0:
            counts += t * (_linear(bracket, k, raw[k, i, j]) - offset)
            exposed += t * bracket.exposure[k]
    if exposed == 0.0:
        shortest = bracket.exposure[0]
        bound = _linear(bracket, 0, raw[0, i, j]) - offset
        values_out[row, j] = bound / shortest
        variance_out[row, j] = _variance(bracket, 0, bound) / (shortest * shortest)
        status_out[row, j] = wp.uint8(CLIPPED)
        return

    value = counts / exposed
    variance = wp.vec3f(0.0)
    status = int(0)
    for _ in range(_PASSES):
        status = int(0)
        weight = wp.vec3f(0.0)  # sum t w
        weight_trust = wp.vec3f(0.0)  # sum t^2 w
        step = wp.vec3f(0.0)  # sum t w (y - value)
        chi2 = wp.vec3f(0.0)  # sum t w (y - value)^2
        used = float(0.0)
        saturating = float(0.0)  # least exposure that is saturated and should be far from it
        for k in range(image_count):
            e = bracket.exposure[k]
            t = trust[k, i, j]
            if t > 0.0:
                residual = _linear(bracket, k, raw[k, i, j]) - offset - e * value
                q = wp.cw_div(wp.vec3f(t), _variance(bracket, k, e * value))
                weight += (e * e) * q
                weight_trust += (t * e * e) * q
                step += e * wp.cw_mul(q, residual)
                chi2 += wp.cw_mul(q, wp.cw_mul(residual, residual))
                used += t
            elif saturating == 0.0 and e * wp.max(value) < 0.5 * SATURATION:
                if wp.max(_fraction(bracket, k, raw[k, i, j])) >= SATURATION:
                    saturating = e
        step = wp.cw_div(step, weight)
        chi2 -= wp.cw_mul(weight, wp.cw_mul(step, step))
        value += step
        variance = wp.cw_div(weight_trust, wp.cw_mul(weight, weight))
        faint = int(0)
        highest = float(0.0)
        for c in range(3):
            deviation = _SIGMAS * wp.sqrt(variance[c])
            if value[c] < deviation:
                faint += 1
            highest = wp.max(highest, value[c] + deviation)
            freedom = used - weight_trust[c] / weight[c]
            if freedom > 0.1:
                least = bracket.tolerance * value[c]
                if chi2[c] > _largest_chi2(freedom) and chi2[c] > weight[c] * least * least:
                    status |= MOVED
                    variance[c] *= chi2[c] / freedom
        if faint == 3:
            status |= DARK
        if saturating * highest < 0.5 * SATURATION and saturating > 0.0:
            status |= MOVED
    values_out[row, j] = value
    variance_out[row, j] = variance
    status_out[row, j] = wp.uint8(status)


def measure_levels(
    bracket: Bracket,
    raw: wp.array3d[wp.vec3f],
    first_row: int,
    rows: int,
    level: wp.array3d[wp.float32],
) -> None:
    """Measure how near saturation the pixels of some rows are; see ``_measure_levels_kernel``."""
    wp.launch(
        _measure_levels_kernel,
        dim=(raw.shape[0], rows),
        inputs=[bracket, raw, first_row],
        outputs=[level],
        device=raw.device,
    )


def weigh_saturation(
    bracket: Bracket,
    raw: wp.array3d[wp.vec3f],
    level: wp.array3d[wp.float32],
    row_count: int,
    first_row: int,
    rows: int,
    trust: wp.array3d[wp.float32],
) -> None:
    """Find the trust in the pixels of some rows; see ``_weigh_saturation_kernel``."""
    wp.launch(
        _weigh_saturation_kernel,
        dim=(raw.shape[0], rows),
        inputs=[bracket, raw, level, row_count, first_row],
        outputs=[trust],
        device=raw.device,
    )


def merge_rows(
    bracket: Bracket,
    raw: wp.array3d[wp.vec3f],
    trust: wp.array3d[wp.float32],
    dark: wp.array2d[wp.vec3f],
    first_row: int,
    values: wp.array2d[wp.vec3f],
    variance: wp.array2d[wp.vec3f],
    status: wp.array2d[wp.uint8],
) -> None:
    """Merge some rows of a block; see ``_merge_rows_kernel``."""
    wp.launch(
        _merge_rows_kernel,
        dim=values.shape,
        inputs=[bracket, raw, trust, dark, first_row],
        outputs=[values, variance, status],
        device=raw.device,
    )
