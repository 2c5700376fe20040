"""A visible point of a surface, and what its material's inputs are there."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import sample_texture
from usdskin.warp_kernels.structs import Geometry, Materials

wp.set_module_options({"enable_backward": False})


@wp.struct
class Point:
    """A visible point of a surface."""

    material: wp.int32
    corner: wp.int32
    """First corner of its triangle."""
    barycentric: wp.vec3f
    position: wp.vec3f
    normal: wp.vec3f
    """Unit shading normal, maps included, turned to the viewer's side."""
    geometric: wp.vec3f
    """Unit normal of its triangle, turned to the viewer's side."""
    side: wp.float32
    """1 where the outside of the surface is seen, -1 where its inside is."""
    relief_variance: wp.float32
    """Variance of slopes of the maps' relief that the footprint holds, over both axes [1]."""
    prim: wp.int32
    """Index of its mesh."""
    view: wp.vec3f
    """Unit direction towards the viewer."""
    footprint: wp.float32
    """Width of what one sample sees of the surface [m]."""
    triangle_area: wp.float32
    """Area of its triangle [m^2]."""
    size: wp.float32
    """Largest coordinate of the triangle's corners [m]."""


@wp.func
def read_input(geometry: Geometry, materials: Materials, point: Point, which: wp.int32) -> wp.vec4f:
    """Return a material input at a point: its constant, primvar or texture."""
    slot = materials.slot[point.material, which]
    if slot < 0:
        return materials.constant[point.material, which]
    primvar = materials.slot_primvar[slot]
    corner = point.corner
    first = geometry.corner_value[primvar, corner]
    second = geometry.corner_value[primvar, corner + 1]
    third = geometry.corner_value[primvar, corner + 2]
    at = point.barycentric[0] * first + point.barycentric[1] * second + point.barycentric[2] * third
    value = at
    texture = materials.slot_texture[slot]
    if texture >= 0:
        u = materials.slot_matrix_u[slot]
        v = materials.slot_matrix_v[slot]
        st = wp.vec2f(
            u[0] * at[0] + u[1] * at[1] + u[2],
            v[0] * at[0] + v[1] * at[1] + v[2],
        )
        ab = second - first
        ac = third - first
        scale = wp.abs(u[0] * v[1] - u[1] * v[0])
        area = 0.5 * scale * wp.abs(ab[0] * ac[1] - ab[1] * ac[0])
        width = point.footprint * wp.sqrt(area / wp.max(point.triangle_area, 1.0e-20))
        value = sample_texture(materials, texture, st, width)
    channel = materials.slot_channel[slot]
    if channel >= 0:
        return wp.vec4f(value[channel], value[channel], value[channel], value[channel])
    return value
