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
    a = float(0.1)
    b = float(0.2)
    c = float(0.3)
    d = float(0.4)
    e = float(0.5)
    f = float(0.6)
    g = float(0.7)
    h = float(0.8)
    for _k in range(steps):
        a = a * scale + 0.1
        b = b * scale + 0.2
        c = c * scale + 0.3
        d = d * scale + 0.4
        e = e * scale + 0.5
        f = f * scale + 0.6
        g = g * scale + 0.7
        h = h * scale + 0.8
    out[i] = a + b + c + d + e + f + g + h
