"""Kernels that call one function of the product per thread, for the tests."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import (
    latlong_coordinates,
    lookup_fresnel,
    lookup_gloss,
    sample_texture,
)
from usdskin.warp_kernels.reflectance_map import mean_ramp, mean_step
from usdskin.warp_kernels.structs import Lights, Materials

wp.set_module_options({"enable_backward": False})


@wp.kernel
def probe_means(x: wp.array[wp.vec3f], out: wp.array[wp.vec2f]):
    """Evaluate the closed forms at (x, a, b)."""
    i = wp.tid()
    out[i] = wp.vec2f(mean_ramp(x[i][0], x[i][1], x[i][2]), mean_step(x[i][0], x[i][1], x[i][2]))


@wp.kernel
def probe_texture(
    materials: Materials, texture: wp.int32, at: wp.array[wp.vec3f], out: wp.array[wp.vec4f]
):
    """Sample a texture at (s, t, footprint)."""
    i = wp.tid()
    out[i] = sample_texture(materials, texture, wp.vec2f(at[i][0], at[i][1]), at[i][2])


@wp.kernel
def probe_gloss(
    lights: Lights, alpha: wp.float32, direction: wp.array[wp.vec3f], out: wp.array[wp.vec4f]
):
    """Look the prefiltered light up around a direction."""
    i = wp.tid()
    out[i] = lookup_gloss(lights, 0, alpha, latlong_coordinates(direction[i]))


@wp.kernel
def probe_fresnel(lights: Lights, at: wp.array[wp.vec2f], out: wp.array[wp.vec2f]):
    """Look the directional albedo up at (alpha, cosine)."""
    i = wp.tid()
    found = lookup_fresnel(lights, at[i][0], at[i][1])
    out[i] = wp.vec2f(found[0], found[1])
