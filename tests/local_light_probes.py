"""Kernels that sample and meet one local light per thread, for the tests."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import LightLinks, reaches, shades
from usdskin.warp_kernels.local_lights import (
    LocalLights,
    intersect_local_light,
    local_light_pdf,
    sample_local_light,
)

wp.set_module_options({"enable_backward": False})


@wp.kernel
def probe_samples(
    lights: LocalLights,
    k: wp.int32,
    position: wp.array[wp.vec3f],
    u: wp.array[wp.vec2f],
    direction: wp.array2d[wp.vec3f],
    numbers: wp.array2d[wp.vec4f],
    radiance: wp.array2d[wp.vec4f],
    again: wp.array2d[wp.vec4f],
    met: wp.array2d[wp.vec4f],
):
    """Sample a light; numbers are (weight, pdf, distance, delta), again what rays find there."""
    i, j = wp.tid()
    sample = sample_local_light(lights, k, position[i], u[j])
    direction[i, j] = sample.direction
    numbers[i, j] = wp.vec4f(sample.weight, sample.pdf, sample.distance, float(sample.delta))
    radiance[i, j] = sample.radiance
    hit = intersect_local_light(lights, k, position[i], sample.direction)
    density = local_light_pdf(lights, k, position[i], sample.direction)
    again[i, j] = wp.vec4f(density, hit.distance, 0.0, 0.0)
    met[i, j] = hit.radiance


@wp.kernel
def probe_rays(
    lights: LocalLights,
    k: wp.int32,
    position: wp.vec3f,
    direction: wp.array[wp.vec3f],
    out: wp.array[wp.vec2f],
    radiance: wp.array[wp.vec4f],
):
    """Return (distance, density) and radiance along rays."""
    i = wp.tid()
    hit = intersect_local_light(lights, k, position, direction[i])
    out[i] = wp.vec2f(hit.distance, local_light_pdf(lights, k, position, direction[i]))
    radiance[i] = hit.radiance


@wp.kernel
def probe_links(links: LightLinks, out: wp.array2d[wp.vec2i]):
    """Return whether a light reaches a prim, and whether the prim shades it."""
    prim, light = wp.tid()
    lit = reaches(links, prim, light)
    shadow = shades(links, prim, light)
    out[prim, light] = wp.vec2i(int(lit), int(shadow))
