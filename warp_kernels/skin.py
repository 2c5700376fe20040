"""Surfaces under a reflectance map: the skin model of DESIGN's eq. (1) and UsdPreviewSurface.

A surface never handles wavelengths. It weighs the light's coefficient channels (Lambert and wrap
integrals, prefiltered reflections) and deposits each product in one row of the pixel's scratch;
``Materials.band`` gives every row its spectrum when the pixel is finished.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import (
    PI,
    frame_coordinates,
    lookup_fresnel,
    lookup_gloss,
    lookup_map,
    sample_texture,
)
from usdskin.warp_kernels.reflectance_map import mean_ramp, mean_step
from usdskin.warp_kernels.structs import (
    INPUT_BASE,
    INPUT_BASE_HIGH,
    INPUT_CLEARCOAT,
    INPUT_CLEARCOAT_ROUGHNESS,
    INPUT_EMISSION,
    INPUT_LOBES,
    INPUT_LUSTRE,
    INPUT_LUSTRE_ROUGHNESS,
    INPUT_METALLIC,
    INPUT_ROUGHNESS,
    INPUT_SPECULAR,
    INPUT_THICKNESS,
    Film,
    Geometry,
    Lights,
    Materials,
)

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


@wp.func
def _first_lamp(lights: Lights, group: wp.int32) -> wp.int32:
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

    ``coordinates`` is where the group's maps are looked up (``frame_coordinates``).
    """
    total = DiffuseLight()
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
    wrap = lights.wrap[wrap_set]
    narrow = 1.0 / (1.0 + wrap)
    lambert = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    wrapped = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    front = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    for k in range(_first_lamp(lights, group), lights.lamp_end[group]):
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


@wp.func
def ggx(alpha: wp.float32, nh: wp.float32, nl: wp.float32, nv: wp.float32) -> wp.float32:
    """Return D G2 / (4 n.v) of the GGX microfacet lobe (Walter et al. 2007, Heitz 2014)."""
    a2 = alpha * alpha
    d = nh * nh * (a2 - 1.0) + 1.0
    density = a2 / (PI * d * d)
    mask = nv * wp.sqrt(a2 + (1.0 - a2) * nl * nl) + nl * wp.sqrt(a2 + (1.0 - a2) * nv * nv)
    return density * nl / (2.0 * wp.max(mask, 1.0e-7))


@wp.func
def _lobe(
    lights: Lights, group: wp.int32, alpha: wp.float32, point: Point, nv: wp.float32,
    coordinates: wp.vec2f, tint: wp.float32, white: wp.float32,
) -> wp.vec4f:  # fmt: skip
    """Return light reflected by one GGX lobe with Fresnel tint F0 + white (1 - F0) Schlick.

    ``tint`` and ``white`` select the two parts: F0 times x, and y, of the directional albedo.
    """
    response = lookup_fresnel(lights, alpha, nv)
    part = tint * response[0] + white * response[1]
    total = part * lookup_gloss(lights, group, alpha, coordinates)
    for k in range(_first_lamp(lights, group), lights.gloss_end[group]):
        toward = lights.lamp_center[k]
        nl = wp.dot(point.normal, toward)
        if nl > 0.0:
            half = wp.normalize(toward + point.view)
            size = wp.length(lights.lamp_azimuth[k])
            wide = wp.clamp(alpha + 0.5 * size, 1.0e-3, 1.0)
            rise = wp.pow(1.0 - wp.clamp(wp.dot(point.view, half), 0.0, 1.0), 5.0)
            lobe = ggx(wide, wp.dot(point.normal, half), nl, nv)
            total += (lobe * (tint * (1.0 - rise) + white * rise)) * lights.lamp_flux[k]
    return total


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
def base_weight(low: wp.vec4f, high: wp.vec4f, j: wp.int32) -> wp.float32:
    """Return the weight of base j, of eight."""
    if j < 4:
        return low[j]
    return high[j - 4]


@wp.struct
class Reflection:
    """What a surface makes of light, its textures read and its layers weighed."""

    weight: wp.float32
    """Share of the sample that sees this surface [1]."""

    diffuse: wp.float32
    """Weight of the diffuse rows: the share the layers above let pass [1]."""

    low: wp.vec4f
    high: wp.vec4f
    """Base weights: 1, RGB or basis weights [1]."""

    nv: wp.float32
    """Cosine of the view angle."""

    shine: wp.float32
    """Weight of the reflections; 0 where there are none [1]."""

    alpha: wp.float32
    second_alpha: wp.float32
    """GGX alpha of the lobes."""

    second: wp.float32
    """Share of the second lobe [1]."""

    f0: wp.float32
    """Reflectance at normal incidence of the untinted lobes [1]."""

    coat: wp.float32
    coat_alpha: wp.float32
    """Weight and GGX alpha of a clearcoat."""

    tint: wp.vec4f
    """Weights of the tinted reflection, one a base."""

    tints: wp.int32
    """How many of them are in use."""

    entry: wp.float32
    """Where the thickness lies in the table of exp(-s delta)."""


@wp.func
def deposit(
    materials: Materials, film: Film, pixel: wp.int32, material: wp.int32, row: wp.int32,
    value: wp.vec4f,
) -> wp.float32:  # fmt: skip
    """Add light to one row of a pixel's scratch; return its Y."""
    film.channel[pixel, row] += value
    return wp.dot(materials.xyz_y[materials.row[material] + row], value)


@wp.func
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
        r.f0 = materials.constant[m, INPUT_SPECULAR][0]
        r.alpha = widened(lobes[1], point.relief_variance)
        r.second_alpha = widened(lobes[2], point.relief_variance)
        r.second = lobes[3]
        first = lookup_fresnel(lights, r.alpha, r.nv)
        second = lookup_fresnel(lights, r.second_alpha, r.nv)
        albedo = (1.0 - r.second) * (r.f0 * first[0] + first[1])
        albedo += r.second * (r.f0 * second[0] + second[1])
        r.shine = weight * lobes[0]
        r.diffuse = weight * (1.0 - lobes[0] * albedo)
    if materials.passage_rank[m] > 0:
        thickness = read_input(geometry, materials, point, INPUT_THICKNESS)[0]
        r.entry = passage_entry(materials, m, thickness)
    return r


@wp.func
def widened(alpha: wp.float32, variance: wp.float32) -> wp.float32:
    """Return a GGX alpha with the relief below the footprint: alpha^2 is a variance of slopes."""
    if variance <= 0.0:
        return alpha
    return wp.min(wp.sqrt(alpha * alpha + variance), 1.0)


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


@wp.func
def first_glossy_row(lights: Lights, materials: Materials, material: wp.int32) -> wp.int32:
    """Return the row of a material's white reflections, which follow its diffuse rows."""
    passes = 1
    if materials.kind[material] == 1:
        passes = 2 + 2 * materials.passage_rank[material]
    return passes * materials.weight_count[material] * lights.group_count


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
def shade_gloss(
    lights: Lights, materials: Materials, film: Film, pixel: wp.int32, point: Point, r: Reflection
) -> wp.float32:
    """Deposit prefiltered reflections: the white lobes, the clearcoat and the tinted lobe."""
    if r.shine <= 0.0 and r.coat <= 0.0:
        return 0.0
    m = point.material
    groups = lights.group_count
    row = first_glossy_row(lights, materials, m)
    mirror = wp.normalize(2.0 * r.nv * point.normal - point.view)
    toward = wp.vec2f(0.0, 0.0)
    y = float(0.0)
    for g in range(groups):
        toward = frame_coordinates(lights, g, mirror, toward)
        light = (1.0 - r.second) * _lobe(lights, g, r.alpha, point, r.nv, toward, r.f0, 1.0)
        if r.second > 0.0:
            light += r.second * _lobe(lights, g, r.second_alpha, point, r.nv, toward, r.f0, 1.0)
        light = r.shine * light
        if r.coat > 0.0:
            light += r.coat * _lobe(lights, g, r.coat_alpha, point, r.nv, toward, 0.04, 1.0)
        y += deposit(materials, film, pixel, m, row + g, light)
        if r.tints > 0:
            light = r.shine * _lobe(lights, g, r.alpha, point, r.nv, toward, 1.0, 0.0)
            for j in range(r.tints):
                at = row + (1 + j) * groups + g
                y += deposit(materials, film, pixel, m, at, r.tint[wp.min(j, 3)] * light)
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
