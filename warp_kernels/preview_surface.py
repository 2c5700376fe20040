"""UsdPreviewSurface under a reflectance map."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.diffuse import light_of
from usdskin.warp_kernels.gloss import widened
from usdskin.warp_kernels.lookup import frame_coordinates, lookup_fresnel
from usdskin.warp_kernels.reflection import Reflection, base_weight, deposit
from usdskin.warp_kernels.structs import (
    INPUT_BASE,
    INPUT_CLEARCOAT,
    INPUT_CLEARCOAT_ROUGHNESS,
    INPUT_EMISSION,
    INPUT_METALLIC,
    INPUT_ROUGHNESS,
    INPUT_SPECULAR,
    Film,
    Geometry,
    Lights,
    Materials,
)
from usdskin.warp_kernels.surface import Point, read_input

wp.set_module_options({"enable_backward": False})


@wp.func
def reflect_preview_surface(
    geometry: Geometry, lights: Lights, materials: Materials, point: Point, weight: wp.float32,
    opacity: wp.float32,
) -> Reflection:  # fmt: skip
    """Read a UsdPreviewSurface: Lambert, GGX by either workflow, clearcoat.

    The specification's layering, made energy-aware: what a layer reflects, the next does not get.
    """
    r = Reflection()
    m = point.material
    flags = materials.flags[m]
    r.weight = weight
    r.low = read_input(geometry, materials, point, INPUT_BASE)
    bases = materials.weight_count[m]
    r.nv = wp.max(wp.dot(point.normal, point.view), 1.0e-4)
    metallic = float(0.0)
    if (flags & 1) == 0:
        metallic = read_input(geometry, materials, point, INPUT_METALLIC)[0]
    solid = weight * opacity
    shine = float(weight)  # opacityMode transparent leaves reflections at full strength
    if (flags & 2) != 0:
        shine = solid
    if (flags & 32) != 0:
        coat = read_input(geometry, materials, point, INPUT_CLEARCOAT)[0]
        rough = read_input(geometry, materials, point, INPUT_CLEARCOAT_ROUGHNESS)[0]
        r.coat = weight * coat
        r.coat_alpha = widened(rough * rough, point.relief_variance)
        response = lookup_fresnel(lights, r.coat_alpha, r.nv)
        solid = solid * (1.0 - coat * (0.04 * response[0] + response[1]))
        shine = shine * (1.0 - coat * (0.04 * response[0] + response[1]))
    rough = read_input(geometry, materials, point, INPUT_ROUGHNESS)[0]
    r.alpha = widened(rough * rough, point.relief_variance)
    r.second_alpha = r.alpha
    tint = read_input(geometry, materials, point, INPUT_SPECULAR)
    highest = wp.max(tint[0], wp.max(tint[1], tint[2]))
    if (flags & 1) == 0:
        r.f0 = tint[0] * (1.0 - metallic)
        highest = tint[0]
    r.diffuse = solid * (1.0 - metallic)
    if (flags & 4) != 0:
        r.shine = shine
        response = lookup_fresnel(lights, r.alpha, r.nv)
        r.diffuse = r.diffuse * wp.max(1.0 - highest * response[0] - response[1], 0.0)
    if (flags & 8) != 0:
        r.tints = 3
        r.tint = tint
        if (flags & 1) == 0:
            r.tints = bases
            r.tint = metallic * r.low
    return r


@wp.func
def shade_preview_surface(
    lights: Lights, materials: Materials, film: Film, pixel: wp.int32, point: Point, r: Reflection
) -> wp.float32:
    """Deposit the diffuse part of a UsdPreviewSurface under unshadowed light; return its Y."""
    m = point.material
    groups = lights.group_count
    coordinates = wp.vec2f(0.0, 0.0)
    wrap_set = materials.wrap_set[m]
    y = float(0.0)
    for g in range(groups):
        coordinates = frame_coordinates(lights, g, point.normal, coordinates)
        j1 = light_of(lights, wrap_set, 1, g, point, coordinates).lambert
        for j in range(materials.weight_count[m]):
            value = (r.diffuse * base_weight(r.low, r.high, j)) * j1
            y += deposit(materials, film, pixel, m, j * groups + g, value)
    return y


@wp.func
def shade_emission(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, pixel: wp.int32,
    point: Point, r: Reflection,
) -> wp.float32:  # fmt: skip
    """Deposit what a surface emits, in its last row."""
    m = point.material
    if (materials.flags[m] & 16) == 0:
        return 0.0
    row = materials.row_count[m] - 1
    emission = read_input(geometry, materials, point, INPUT_EMISSION)
    value = r.weight * wp.vec4f(emission[0], emission[1], emission[2], 0.0)
    return deposit(materials, film, pixel, m, row, value)
