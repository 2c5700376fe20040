"""Skin under a reflectance map: DESIGN's eq. (1), with lustre above it."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.diffuse import light_of
from usdskin.warp_kernels.gloss import widened
from usdskin.warp_kernels.lookup import frame_coordinates, lookup_lustre
from usdskin.warp_kernels.reflection import Reflection, base_weight, deposit
from usdskin.warp_kernels.structs import (
    INPUT_BASE,
    INPUT_BASE_HIGH,
    INPUT_LOBES,
    INPUT_LUSTRE,
    INPUT_LUSTRE_ROUGHNESS,
    INPUT_SPECULAR,
    INPUT_THICKNESS,
    Film,
    Geometry,
    Lights,
    Materials,
)
from usdskin.warp_kernels.surface import Point, read_input

wp.set_module_options({"enable_backward": False})


@wp.func
def passage_entry(materials: Materials, material: wp.int32, thickness: wp.float32) -> wp.float32:
    """Return where a path length [m] lies in the material's table of exp(-s delta)."""
    scale = materials.passage_scale[material]
    s = wp.max(thickness, 0.0)
    return wp.min(wp.log(1.0 + s / scale[0]) * scale[1], wp.float32(materials.passage.shape[1] - 1))


@wp.func
def passage_weight(
    materials: Materials, material: wp.int32, entry: wp.float32, k: wp.int32
) -> wp.float32:
    """Return f_k(s), linear between the table's entries."""
    i = wp.int32(entry)
    above = wp.min(i + 1, materials.passage.shape[1] - 1)
    blend = entry - wp.float32(i)
    low = materials.passage[material, i, k]
    return low + blend * (materials.passage[material, above, k] - low)


@wp.func
def mapped_lobes(geometry: Geometry, materials: Materials, point: Point) -> wp.vec4f:
    """Return weight, GGX alpha of both lobes and share of the second, from the lustre's maps."""
    m = point.material
    lobes = materials.constant[m, INPUT_LOBES]
    if materials.slot[m, INPUT_LUSTRE] >= 0:
        lobes[0] = wp.clamp(read_input(geometry, materials, point, INPUT_LUSTRE)[0], 0.0, 1.0)
    if materials.slot[m, INPUT_LUSTRE_ROUGHNESS] >= 0:
        rough = read_input(geometry, materials, point, INPUT_LUSTRE_ROUGHNESS)[0]
        rough = wp.clamp(rough, 0.0, 1.0)
        ratio = materials.constant[m, INPUT_LUSTRE_ROUGHNESS][0]
        second = wp.min(rough * ratio, 1.0)
        lobes[1] = rough * rough
        lobes[2] = second * second
    return lobes


@wp.func(inline=True)
def reflect_skin(
    geometry: Geometry, lights: Lights, materials: Materials, point: Point, weight: wp.float32
) -> Reflection:
    """Read a skin's maps. Its two GGX lobes lie above and take their albedo from below."""
    r = Reflection()
    m = point.material
    r.weight = weight
    r.low = read_input(geometry, materials, point, INPUT_BASE)
    if materials.weight_count[m] > 4:
        r.high = read_input(geometry, materials, point, INPUT_BASE_HIGH)
    r.nv = wp.max(wp.dot(point.normal, point.view), 1.0e-4)
    r.diffuse = weight
    if (materials.flags[m] & 4) != 0:
        lobes = materials.constant[m, INPUT_LOBES]
        if (materials.flags[m] & 128) != 0:
            lobes = mapped_lobes(geometry, materials, point)
        surface = materials.constant[m, INPUT_SPECULAR]
        r.f0 = surface[0]
        r.lustre = wp.int32(surface[1])
        r.index = surface[2]
        r.alpha = widened(lobes[1], point.relief_variance)
        r.second_alpha = widened(lobes[2], point.relief_variance)
        r.second = lobes[3]
        albedo = (1.0 - r.second) * lookup_lustre(materials, r.lustre, r.alpha, r.nv)[0]
        albedo += r.second * lookup_lustre(materials, r.lustre, r.second_alpha, r.nv)[0]
        r.shine = weight * lobes[0]
        r.diffuse = weight * (1.0 - lobes[0] * albedo)
    if materials.passage_rank[m] > 0:
        thickness = read_input(geometry, materials, point, INPUT_THICKNESS)[0]
        r.entry = passage_entry(materials, m, thickness)
    return r


@wp.func
def shade_skin(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, pixel: wp.int32,
    point: Point, r: Reflection, behind: wp.float32,
) -> wp.float32:  # fmt: skip
    """Deposit the diffuse terms of skin under unshadowed light, and what crosses its thickness.

    C = (1/pi) alpha S [J1 + Ss (J2front + exp(-s delta) J2back)], DESIGN section 2; alpha, S, Ss,
    delta and 1/pi are in the rows. ``behind`` weighs J2back. Returns the Y deposited.
    """
    m = point.material
    groups = lights.group_count
    bases = materials.weight_count[m]
    wrap_set = materials.wrap_set[m]
    wrap = lights.wrap[wrap_set]
    rank = materials.passage_rank[m]
    coordinates = wp.vec2f(0.0, 0.0)
    kernels = wp.where(rank > 0, 3, 2)
    span = bases * groups
    y = float(0.0)
    for g in range(groups):
        coordinates = frame_coordinates(lights, g, point.normal, coordinates)
        light = light_of(lights, wrap_set, kernels, g, point, coordinates)
        j1 = light.lambert
        j2 = light.wrap
        back = wp.vec4f(0.0, 0.0, 0.0, 0.0)
        if rank > 0:
            front = (j1 + wrap * light.front) / (1.0 + wrap)
            back = (r.diffuse * behind) * (j2 - front)
            j2 = front
        for j in range(bases):
            a = r.diffuse * base_weight(r.low, r.high, j)
            row = j * groups + g
            y += deposit(materials, film, pixel, m, row, a * j1)
            y += deposit(materials, film, pixel, m, span + row, a * j2)
        if behind > 0.0:
            for k in range(rank):
                through = passage_weight(materials, m, r.entry, k) * back
                for j in range(bases):
                    row = (2 + k) * span + j * groups + g
                    value = base_weight(r.low, r.high, j) * through
                    y += deposit(materials, film, pixel, m, row, value)
    return y
