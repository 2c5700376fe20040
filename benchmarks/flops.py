"""A kernel that multiplies and adds and does nothing else: what the device can do at its best."""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.kernel(enable_backward=False)
def multiply_add(steps: wp.int32, out: wp.array[wp.float32]):
    """Do 16 operations a step in eight chains that do not wait for one another.

    Launch dimension: [count].
    """
    i = wp.tid()
    scale = 0.999 + 1.0e-9 * wp.float32(i)
    more = wp.vec4f(0.1, 0.2, 0.3, 0.4)
    a = wp.vec4f(0.1, 0.2, 0.3, 0.4)
    b = wp.vec4f(0.5, 0.6, 0.7, 0.8)
    for _k in range(steps):
        a = scale * a + more
        b = scale * b + more
    out[i] = wp.dot(a, b)
