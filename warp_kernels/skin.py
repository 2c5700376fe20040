"""Surfaces under a reflectance map: the skin model of DESIGN's eq. (1) and UsdPreviewSurface.

A surface never handles wavelengths. It weighs the light's coefficient channels (Lambert and wrap
integrals, prefiltered reflections) and deposits each product in one row of the pixel's scratch;
``Materials.band`` gives every row its spectrum when the pixel is finished.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.lookup import (
    PI,
    latlong_coordinates,
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
    view: wp.vec3f
    """Unit direction towards the viewer."""
    footprint: wp.float32
    """Width of what one sample sees of the surface [m]."""
    triangle_area: wp.float32
    """Area of its triangle [m^2]."""


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
    """Return the first ``kernels`` of J1, J2 and H at a normal: the smooth maps and the lamps."""
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
def _ggx(alpha: wp.float32, nh: wp.float32, nl: wp.float32, nv: wp.float32) -> wp.float32:
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
            lobe = _ggx(wide, wp.dot(point.normal, half), nl, nv)
            total += (lobe * (tint * (1.0 - rise) + white * rise)) * lights.lamp_flux[k]
    return total


@wp.func
def _passage_entry(materials: Materials, material: wp.int32, thickness: wp.float32) -> wp.float32:
    """Return where a path length lies in the material's table of exp(-s delta)."""
    scale = materials.passage_scale[material]
    s = wp.max(thickness, 0.0)
    return wp.min(s / (s + scale[0]) * scale[1], wp.float32(materials.passage.shape[1] - 1))


@wp.func
def _passage_weight(
    materials: Materials, material: wp.int32, entry: wp.float32, k: wp.int32
) -> wp.float32:
    """Return f_k(s), linear between the table's entries."""
    i = wp.int32(entry)
    above = wp.min(i + 1, materials.passage.shape[1] - 1)
    blend = entry - wp.float32(i)
    low = materials.passage[material, i, k]
    return low + blend * (materials.passage[material, above, k] - low)


@wp.func
def _base_weight(low: wp.vec4f, high: wp.vec4f, j: wp.int32) -> wp.float32:
    if j < 4:
        return low[j]
    return high[j - 4]


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
    point: Point, weight: wp.float32,
):  # fmt: skip
    """Deposit skin: both diffuse terms, the part that crosses the body, and the lustre.

    C = (1/pi) alpha S [J1 + Ss (J2front + exp(-s delta) J2back)], DESIGN section 2; alpha, S, Ss,
    delta and 1/pi are in the rows. The two GGX lobes lie above and take their albedo from below.
    """
    m = point.material
    groups = lights.group_count
    low = read_input(geometry, materials, point, INPUT_BASE)
    high = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    bases = materials.weight_count[m]
    if bases > 4:
        high = read_input(geometry, materials, point, INPUT_BASE_HIGH)
    glossy = (materials.flags[m] & 4) != 0
    lobes = materials.constant[m, INPUT_LOBES]
    if (materials.flags[m] & 128) != 0:
        lobes = mapped_lobes(geometry, materials, point)
    lobes[1] = widened(lobes[1], point.relief_variance)
    lobes[2] = widened(lobes[2], point.relief_variance)
    f0 = materials.constant[m, INPUT_SPECULAR][0]
    nv = wp.max(wp.dot(point.normal, point.view), 1.0e-4)
    passed = float(weight)
    if glossy:
        first = lookup_fresnel(lights, lobes[1], nv)
        second = lookup_fresnel(lights, lobes[2], nv)
        albedo = (1.0 - lobes[3]) * (f0 * first[0] + first[1])
        albedo += lobes[3] * (f0 * second[0] + second[1])
        passed = weight * (1.0 - lobes[0] * albedo)
    wrap_set = materials.wrap_set[m]
    wrap = lights.wrap[wrap_set]
    rank = materials.passage_rank[m]
    entry = float(0.0)
    if rank > 0:
        thickness = read_input(geometry, materials, point, INPUT_THICKNESS)[0]
        entry = _passage_entry(materials, m, thickness)
    coordinates = latlong_coordinates(point.normal)
    kernels = wp.where(rank > 0, 3, 2)
    span = bases * groups
    for g in range(groups):
        light = diffuse_light(lights, wrap_set, kernels, g, point.normal, coordinates)
        j1 = light.lambert
        j2 = light.wrap
        back = wp.vec4f(0.0, 0.0, 0.0, 0.0)
        if rank > 0:
            front = (j1 + wrap * light.front) / (1.0 + wrap)
            back = passed * (j2 - front)
            j2 = front
        for j in range(bases):
            a = passed * _base_weight(low, high, j)
            row = j * groups + g
            film.channel[pixel, row] += a * j1
            film.channel[pixel, span + row] += a * j2
        for k in range(rank):
            through = _passage_weight(materials, m, entry, k) * back
            for j in range(bases):
                row = (2 + k) * span + j * groups + g
                film.channel[pixel, row] += _base_weight(low, high, j) * through
    if glossy:
        mirror = wp.normalize(2.0 * nv * point.normal - point.view)
        toward = latlong_coordinates(mirror)
        for g in range(groups):
            shine = (1.0 - lobes[3]) * _lobe(lights, g, lobes[1], point, nv, toward, f0, 1.0)
            shine += lobes[3] * _lobe(lights, g, lobes[2], point, nv, toward, f0, 1.0)
            film.channel[pixel, (2 + rank) * span + g] += (weight * lobes[0]) * shine


@wp.func
def shade_preview_surface(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, pixel: wp.int32,
    point: Point, weight: wp.float32, opacity: wp.float32,
):  # fmt: skip
    """Deposit a UsdPreviewSurface: Lambert, GGX by either workflow, clearcoat and emission.

    The specification's layering, made energy-aware: what a layer reflects, the next does not get.
    """
    m = point.material
    groups = lights.group_count
    flags = materials.flags[m]
    base = read_input(geometry, materials, point, INPUT_BASE)
    bases = materials.weight_count[m]
    nv = wp.max(wp.dot(point.normal, point.view), 1.0e-4)
    metallic = float(0.0)
    if (flags & 1) == 0:
        metallic = read_input(geometry, materials, point, INPUT_METALLIC)[0]
    solid = weight * opacity
    shine = float(weight)  # opacityMode transparent leaves reflections at full strength
    if (flags & 2) != 0:
        shine = solid
    coat = float(0.0)
    coat_alpha = float(0.0)
    if (flags & 32) != 0:
        coat = read_input(geometry, materials, point, INPUT_CLEARCOAT)[0]
        rough = read_input(geometry, materials, point, INPUT_CLEARCOAT_ROUGHNESS)[0]
        coat_alpha = widened(rough * rough, point.relief_variance)
        response = lookup_fresnel(lights, coat_alpha, nv)
        solid = solid * (1.0 - coat * (0.04 * response[0] + response[1]))
        shine = shine * (1.0 - coat * (0.04 * response[0] + response[1]))
    rough = read_input(geometry, materials, point, INPUT_ROUGHNESS)[0]
    alpha = widened(rough * rough, point.relief_variance)
    tint = read_input(geometry, materials, point, INPUT_SPECULAR)
    dielectric = float(0.0)  # F0 of the untinted part
    highest = wp.max(tint[0], wp.max(tint[1], tint[2]))
    if (flags & 1) == 0:
        dielectric = tint[0] * (1.0 - metallic)
        highest = tint[0]
    glossy = (flags & 4) != 0
    diffuse = solid * (1.0 - metallic)
    if glossy:
        response = lookup_fresnel(lights, alpha, nv)
        diffuse = diffuse * wp.max(1.0 - highest * response[0] - response[1], 0.0)
    coordinates = latlong_coordinates(point.normal)
    zero = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    wrap_set = materials.wrap_set[m]
    for g in range(groups):
        j1 = diffuse_light(lights, wrap_set, 1, g, point.normal, coordinates).lambert
        for j in range(bases):
            film.channel[pixel, j * groups + g] += (diffuse * _base_weight(base, zero, j)) * j1
    row = bases * groups
    if glossy:
        mirror = wp.normalize(2.0 * nv * point.normal - point.view)
        toward = latlong_coordinates(mirror)
        for g in range(groups):
            light = shine * _lobe(lights, g, alpha, point, nv, toward, dielectric, 1.0)
            if coat > 0.0:
                over = _lobe(lights, g, coat_alpha, point, nv, toward, 0.04, 1.0)
                light += (weight * coat) * over
            film.channel[pixel, row + g] += light
        row = row + groups
    if (flags & 8) != 0:
        mirror = wp.normalize(2.0 * nv * point.normal - point.view)
        toward = latlong_coordinates(mirror)
        tints = 3
        if (flags & 1) == 0:
            tints = bases
        for g in range(groups):
            light = _lobe(lights, g, alpha, point, nv, toward, 1.0, 0.0)
            for j in range(tints):
                share = tint[wp.min(j, 3)]
                if (flags & 1) == 0:
                    share = metallic * _base_weight(base, zero, j)
                film.channel[pixel, row + j * groups + g] += (shine * share) * light
        row = row + tints * groups
    if (flags & 16) != 0:
        emission = read_input(geometry, materials, point, INPUT_EMISSION)
        film.channel[pixel, row] += weight * wp.vec4f(emission[0], emission[1], emission[2], 0.0)
