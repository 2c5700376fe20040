"""Prefiltered reflections: an environment convolved with a GGX lobe around every direction."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import PI

wp.set_module_options({"enable_backward": False})

SAMPLE_COUNT = wp.constant(128)


@wp.func
def _node_direction(row: wp.int32, column: wp.int32, rows: wp.int32) -> wp.vec3f:
    polar = PI * wp.float32(row) / wp.float32(rows)
    angle = PI * wp.float32(column) / wp.float32(rows)
    return wp.vec3f(wp.sin(polar) * wp.sin(angle), wp.cos(polar), -wp.sin(polar) * wp.cos(angle))


@wp.func
def _sample_pyramid(
    texel: wp.array[wp.vec4f], level: wp.array[wp.vec3i], direction: wp.vec3f, detail: wp.float32
) -> wp.vec4f:
    """Return a latlong pyramid's value, trilinear; columns wrap, rows clamp."""
    last = level.shape[0] - 1
    detail = wp.clamp(detail, 0.0, wp.float32(last))
    lower = wp.int32(detail)
    blend = detail - wp.float32(lower)
    polar = wp.acos(wp.clamp(direction[1], -1.0, 1.0)) / PI
    turns = wp.atan2(direction[0], -direction[2]) / (2.0 * PI)
    if turns < 0.0:
        turns = turns + 1.0
    total = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    for k in range(2):
        size = level[wp.min(lower + k, last)]
        share = blend
        if k == 0:
            share = 1.0 - blend
        x = turns * wp.float32(size[1]) - 0.5
        y = wp.clamp(polar * wp.float32(size[2]) - 0.5, 0.0, wp.float32(size[2] - 1))
        j = wp.int32(wp.floor(x))
        i = wp.int32(y)
        fx = x - wp.float32(j)
        fy = y - wp.float32(i)
        left = (j + size[1]) % size[1]
        right = (j + 1) % size[1]
        below = wp.min(i + 1, size[2] - 1)
        top = (1.0 - fx) * texel[size[0] + i * size[1] + left]
        top += fx * texel[size[0] + i * size[1] + right]
        bottom = (1.0 - fx) * texel[size[0] + below * size[1] + left]
        bottom += fx * texel[size[0] + below * size[1] + right]
        total += share * ((1.0 - fy) * top + fy * bottom)
    return total


@wp.kernel(enable_backward=False)
def _prefilter_kernel(
    # In:
    texel: wp.array[wp.vec4f],
    level: wp.array[wp.vec3i],
    alpha: wp.float32,
    rows: wp.int32,
    offset: wp.int32,
    # Out:
    value_out: wp.array[wp.vec4f],
):
    """Average the environment over a GGX lobe seen from above (N = V = R).

    The split-sum approximation with filtered importance sampling (Karis 2013; Krivanek and Colbert
    2008): each of a fixed set of directions reads the level whose texels match its solid angle.

    Launch dimension: [(rows + 1) (2 rows + 1)], from ``offset``.

    Args:
        texel: Latlong texels of all levels [coefficient].
        level: (offset, width, height) of each level.
        alpha: GGX alpha; 0 copies the environment.
        rows: H of the node grid.
        offset: First node of this launch.
        value_out: Prefiltered coefficients, shape [(rows + 1) (2 rows + 1)].
    """
    node = offset + wp.tid()
    stride = 2 * rows + 1
    axis = _node_direction(node / stride, node % stride, rows)
    base = level[0]
    texel_angle = 2.0 * PI * PI / wp.float32(base[1] * base[2])
    if alpha < 1.0e-3:
        detail = wp.log2(wp.max(wp.float32(base[2]) / wp.float32(rows), 1.0))
        value_out[node] = _sample_pyramid(texel, level, axis, detail)
        return
    helper = wp.vec3f(1.0, 0.0, 0.0)
    if wp.abs(axis[0]) > 0.9:
        helper = wp.vec3f(0.0, 1.0, 0.0)
    tangent = wp.normalize(wp.cross(helper, axis))
    bitangent = wp.cross(axis, tangent)
    total = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    weight = float(0.0)
    a2 = alpha * alpha
    for s in range(SAMPLE_COUNT):
        xi = (wp.float32(s) + 0.5) / wp.float32(SAMPLE_COUNT)
        turn = wp.float32(s) * 0.6180339887498949
        angle = 2.0 * PI * (turn - wp.floor(turn))
        cosine2 = (1.0 - xi) / (1.0 + (a2 - 1.0) * xi)
        cosine = wp.sqrt(cosine2)
        sine = wp.sqrt(wp.max(1.0 - cosine2, 0.0))
        half = (sine * wp.cos(angle)) * tangent + (sine * wp.sin(angle)) * bitangent + cosine * axis
        toward = 2.0 * cosine * half - axis
        nl = 2.0 * cosine2 - 1.0
        if nl > 0.0:
            d = cosine2 * (a2 - 1.0) + 1.0
            density = a2 / (PI * d * d) / 4.0
            covered = 1.0 / (wp.float32(SAMPLE_COUNT) * density)
            sine_polar = wp.sqrt(wp.max(1.0 - toward[1] * toward[1], 1.0e-4))
            detail = 0.5 * wp.log2(covered / (texel_angle * sine_polar)) + 1.0
            # Smith's height-correlated masking with n.v = 1 (Heitz 2014).
            shown = 2.0 * nl / (nl + wp.sqrt(a2 + (1.0 - a2) * nl * nl))
            total += shown * _sample_pyramid(texel, level, toward, detail)
            weight += shown
    value_out[node] = total / wp.max(weight, 1.0e-6)


def prefilter(
    texel: wp.array[wp.vec4f],
    level: wp.array[wp.vec3i],
    alpha: float,
    rows: int,
    value_out: wp.array[wp.vec4f],
    begin: int,
    end: int,
) -> None:
    """Prefilter nodes ``begin`` to ``end`` of one level's grid."""
    wp.launch(
        _prefilter_kernel,
        dim=end - begin,
        inputs=[texel, level, alpha, rows, begin],
        outputs=[value_out],
        device=value_out.device,
    )
