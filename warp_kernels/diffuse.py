"""The light at a normal: the smooth maps and the lamps."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import lookup_map
from usdskin.warp_kernels.reflectance_map import mean_ramp, mean_step
from usdskin.warp_kernels.structs import Lights
from usdskin.warp_kernels.surface import Point

wp.set_module_options({"enable_backward": False})


@wp.func
def first_lamp(lights: Lights, group: wp.int32) -> wp.int32:
    """Return the first lamp of a channel group; ``lamp_end`` ends them."""
    if group == 0:
        return 0
    return lights.lamp_end[group - 1]


@wp.struct
class DiffuseLight:
    """The light of one channel group at a normal."""

    lambert: wp.vec4f
    """J1 [coefficient sr]."""

    wrap: wp.vec4f
    """J2 [coefficient sr]."""

    front: wp.vec4f
    """H [coefficient sr]."""


@wp.func
def diffuse_light(
    lights: Lights, wrap_set: wp.int32, kernels: wp.int32, group: wp.int32, normal: wp.vec3f,
    coordinates: wp.vec2f,
) -> DiffuseLight:  # fmt: skip
    """Return the first ``kernels`` of J1, J2 and H at a normal: the smooth maps and the lamps.

    H is only told where the wrap is not 0: nothing is made of it there.

    ``coordinates`` is where the group's maps are looked up (``frame_coordinates``).
    """
    total = DiffuseLight()
    wrap = lights.wrap[wrap_set]
    if wrap == 0.0:  # both kernels are one, and H is not asked for
        kernels = 1
    offset = lights.map_offset[wrap_set, 0, group]
    if offset >= 0:
        rows = lights.map_rows[group]
        total.lambert = lookup_map(lights.map_value, offset, rows, coordinates)
        if kernels > 1:
            offset = lights.map_offset[wrap_set, 1, group]
            total.wrap = lookup_map(lights.map_value, offset, rows, coordinates)
        if kernels > 2:
            offset = lights.map_offset[wrap_set, 2, group]
            total.front = lookup_map(lights.map_value, offset, rows, coordinates)
    narrow = 1.0 / (1.0 + wrap)
    lambert = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    wrapped = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    front = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    for k in range(first_lamp(lights, group), lights.lamp_end[group]):
        x = wp.dot(normal, lights.lamp_center[k])
        reach = lights.lamp_reach[k]
        if x + wrap > -reach:
            flux = lights.lamp_flux[k]
            if x > reach:  # no kink crosses the lamp
                lambert += x * flux
                wrapped += ((x + wrap) * narrow) * flux
                front += flux
            elif x < -reach and x + wrap > reach:
                wrapped += ((x + wrap) * narrow) * flux
            else:
                a = wp.dot(normal, lights.lamp_azimuth[k])
                b = wp.dot(normal, lights.lamp_elevation[k])
                lambert += mean_ramp(x, a, b) * flux
                wrapped += (mean_ramp(x + wrap, a, b) * narrow) * flux
                if kernels > 2:
                    front += mean_step(x, a, b) * flux
        if k % 256 == 255:  # sums over half a million texels, one by one, would lose 4e-4
            total.lambert += lambert
            total.wrap += wrapped
            total.front += front
            lambert = wp.vec4f(0.0, 0.0, 0.0, 0.0)
            wrapped = wp.vec4f(0.0, 0.0, 0.0, 0.0)
            front = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    total.lambert += lambert
    total.wrap += wrapped
    total.front += front
    if wrap == 0.0:
        total.wrap = total.lambert
    return total


@wp.func
def linked(lights: Lights, prim: wp.int32, group: wp.int32, light: wp.vec4f) -> wp.vec4f:
    """Return what of a channel group's light reaches a prim."""
    if lights.links.active == 0:
        return light
    return wp.cw_mul(light, lights.link_mask[lights.links.prim_set[prim], group])


@wp.func
def light_of(
    lights: Lights, wrap_set: wp.int32, kernels: wp.int32, group: wp.int32, point: Point,
    coordinates: wp.vec2f,
) -> DiffuseLight:  # fmt: skip
    """Return the light of one channel group that is meant for a point (``diffuse_light``)."""
    light = diffuse_light(lights, wrap_set, kernels, group, point.normal, coordinates)
    if lights.links.active != 0:
        light.lambert = linked(lights, point.prim, group, light.lambert)
        light.wrap = linked(lights, point.prim, group, light.wrap)
        light.front = linked(lights, point.prim, group, light.front)
    return light
