"""Shadowed pictures: what the map gives, less what does not arrive.

The unshadowed integrals J1 and J2 of a point are exact and cost a lookup. So only the light that
something weakens is estimated, by directions chosen from the light tree: where nothing stands in
the way there is no noise at all. A sample's light carries coefficient channels, so there is no
spectral noise either (DESIGN section 2).
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.detail import relieved
from usdskin.warp_kernels.film import deposit_dome, shines_when_clear
from usdskin.warp_kernels.light_tree import LightTree
from usdskin.warp_kernels.preview_surface import (
    reflect_preview_surface,
    shade_emission,
    shade_preview_surface,
)
from usdskin.warp_kernels.reflection import Reflection
from usdskin.warp_kernels.sampling import hash_pair, low_discrepancy
from usdskin.warp_kernels.skin import reflect_skin, shade_skin
from usdskin.warp_kernels.structs import CameraRays, Film, Geometry, Lights, Materials
from usdskin.warp_kernels.surface import Point
from usdskin.warp_kernels.trace_directions import face_block, shade_directions
from usdskin.warp_kernels.trace_guide import Guide, deposit_known, guide_block, update_guide
from usdskin.warp_kernels.trace_structs import LENS_DIMENSION, SKIN_MIX, Trace
from usdskin.warp_kernels.view import (
    MAX_LAYERS,
    UNKNOWN,
    beyond,
    meet,
    picture_ray,
    surface_point,
)
from usdskin.warp_kernels.visibility import surface_opacity

wp.set_module_options({"enable_backward": False, "max_unroll": 1})


@wp.func
def _finish(materials: Materials, film: Film, trace: Trace, pixel: wp.int32, material: wp.int32):
    """Add the scratch of one material to XYZ, its parts and the spectrum, and clear it."""
    if material < 0:
        return
    first = materials.row[material]
    xyza = film.xyza[pixel]
    total = wp.vec3f(0.0, 0.0, 0.0)
    bands = film.spectrum.shape[1]
    with_parts = trace.part.shape[0] > 0
    for q in range(materials.row_count[material]):
        value = film.channel[pixel, q]
        xyz = wp.vec3f(
            wp.dot(materials.xyz_x[first + q], value),
            wp.dot(materials.xyz_y[first + q], value),
            wp.dot(materials.xyz_z[first + q], value),
        )
        total += xyz
        if with_parts:
            trace.part[pixel, materials.row_part[first + q]] += xyz
        at = 4 * (first + q)
        for b in range(bands):
            part = value[0] * materials.band[at, b] + value[1] * materials.band[at + 1, b]
            part += value[2] * materials.band[at + 2, b] + value[3] * materials.band[at + 3, b]
            film.spectrum[pixel, b] += part
        film.channel[pixel, q] = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    film.xyza[pixel] = xyza + wp.vec4f(total[0], total[1], total[2], 0.0)


@wp.func
def _shade_unshadowed(
    geometry: Geometry, lights: Lights, materials: Materials, film: Film, pixel: wp.int32,
    point: Point, r: Reflection, times: wp.float32, given: wp.float32,
) -> wp.vec3f:  # fmt: skip
    """Deposit so many times what the maps give a point, and its emission; return Y, and of it the
    diffuse part.
    """
    scaled = r
    scaled.diffuse = times * given * r.diffuse
    scaled.weight = times * r.weight
    base = float(0.0)
    emitted = float(0.0)
    if materials.kind[point.material] == 1:
        base = shade_skin(geometry, lights, materials, film, pixel, point, scaled, 0.0)
    else:
        base = shade_preview_surface(lights, materials, film, pixel, point, scaled)
        emitted = shade_emission(geometry, lights, materials, film, pixel, point, scaled)
    whole = base / given
    return wp.vec3f(base + emitted, whole, base - whole)


@wp.kernel(enable_backward=False)
def _trace_kernel(
    # In:
    geometry: Geometry,
    camera: CameraRays,
    lights: Lights,
    materials: Materials,
    trace: Trace,
    # Out:
    film: Film,
):
    """Add a pass of samples to some pixels of a tile.

    Every camera sample takes ``trace.split`` directions of each kind of light. All results are sums
    over these; ``trace.tally`` counts them.

    Launch dimension: [pixel_count].
    """
    pixel = trace.pixel[wp.tid()]
    index = film.first_pixel + pixel
    key = hash_pair(trace.key, wp.uint32(index))
    samples = film.sample.shape[0]
    dome = materials.kind.shape[0] - 1
    current = int(-1)
    alpha = float(0.0)
    sums = wp.vec3f(0.0, 0.0, 0.0)
    rasterized = film.face.shape[0] > 0
    sharpness = 0.25
    times = wp.float32(trace.split)
    noise = wp.vec2f(0.0, 0.0)
    squares = float(0.0)
    again = 1.0 / trace.weight - 1.0
    for s in range(samples):
        late = 2 * s / samples
        found = wp.vec3f(0.0, 0.0, 0.0)
        number = trace.first_sample + s * trace.split
        lens = wp.vec2f(0.0, 0.0)
        if camera.lens_radius > 0.0:
            lens = wp.vec2f(
                low_discrepancy(trace.sobol, key, trace.first_camera + s, LENS_DIMENSION),
                low_discrepancy(trace.sobol, key, trace.first_camera + s, LENS_DIMENSION + 1),
            )
        ray = picture_ray(camera, index, film.sample[s], lens, sharpness)
        clear = float(1.0)
        start = float(0.0)
        seen_through = int(1)
        for layer in range(MAX_LAYERS):
            known = int(UNKNOWN)
            if layer == 0 and rasterized:
                known = film.face[pixel, s]
            met = meet(geometry, ray, start, known)
            if met.face < 0:
                break
            point = surface_point(geometry, ray, met)
            if (materials.flags[point.material] & 64) != 0:
                point = relieved(geometry, materials, point)
            opacity = surface_opacity(geometry, materials, point)
            if point.material != current:
                _finish(materials, film, trace, pixel, current)
                current = point.material
            layer_key = hash_pair(key, wp.uint32(layer))
            r = Reflection()
            shown = True
            if materials.kind[current] == 1:
                r = reflect_skin(geometry, lights, materials, point, clear)
            else:
                shown = opacity > 0.0 or shines_when_clear(materials, current)
                r = reflect_preview_surface(geometry, lights, materials, point, clear, opacity)
            if shown:
                block = int(-1)
                guided = bool(False)
                given = float(1.0)
                if trace.guide.tops > 0:
                    block = guide_block(trace.guide, pixel)
                    guided = face_block(lights, materials, trace, pixel, block, point, r, layer)
                    given = 1.0 + trace.weight * (trace.guide.given[block] - 1.0)
                found += _shade_unshadowed(
                    geometry, lights, materials, film, pixel, point, r, times, given
                )
                if guided and trace.guide.changes[block] != 0:
                    scaled = r
                    scaled.diffuse = times * trace.weight * r.diffuse
                    changed = deposit_known(
                        lights, materials, film, pixel, point, scaled, trace.guide, block
                    )
                    found += wp.vec3f(changed, 0.0, changed)
                added = shade_directions(
                    geometry, lights, materials, film, trace, pixel, layer_key, number, point,
                    r, block, guided,
                )  # fmt: skip
                found += wp.vec3f(added[0], 0.0, added[2])
                light = added[0] + again * added[2]
                if trace.split > 1:
                    noise[0] += added[1]
                    noise[1] += light - added[1]
                else:
                    noise[late] += light
            alpha += clear * opacity
            clear = clear * (1.0 - opacity)
            start = beyond(met.distance)
            if clear < 1.0e-4 or start >= ray.length:
                seen_through = 0
                break
        if seen_through != 0 and film.show_dome != 0:
            if current != dome:
                _finish(materials, film, trace, pixel, current)
                current = dome
            deposit_dome(lights, film, pixel, ray.direction, times * clear)
            alpha += clear
        sums += found
        y = found[0] + again * found[2]
        squares += y * y
    _finish(materials, film, trace, pixel, current)
    total = film.xyza[pixel]
    film.xyza[pixel] = wp.vec4f(total[0], total[1], total[2], total[3] + times * alpha)
    whole = sums[0] + again * sums[2]
    trace.luminance[pixel] = wp.vec4f(noise[0], noise[1], whole, squares)
    trace.tally[pixel] += wp.vec4f(sums[0], sums[1], sums[2], times * wp.float32(samples))


def trace_pass(
    geometry: Geometry,
    camera: CameraRays,
    lights: Lights,
    materials: Materials,
    trace: Trace,
    film: Film,
) -> None:
    """Add a pass of samples to ``trace.pixel`` of one tile."""
    wp.launch(
        _trace_kernel,
        dim=trace.pixel.shape[0],
        inputs=[geometry, camera, lights, materials, trace],
        outputs=[film],
        device=film.xyza.device,
    )


@wp.kernel(enable_backward=False)
def _learn_kernel(
    # In:
    tree: LightTree,
    block: wp.array[wp.int32],
    # Out:
    guide: Guide,
):
    """Have blocks know what they have counted.

    Launch dimension: [block_count].
    """
    update_guide(tree, guide, block[wp.tid()], SKIN_MIX)


def learn(tree: LightTree, block: wp.array, guide: Guide) -> None:
    """Have some blocks of a tile know what they have counted."""
    wp.launch(
        _learn_kernel,
        dim=block.shape[0],
        inputs=[tree, block],
        outputs=[guide],
        device=block.device,
    )


@wp.kernel(enable_backward=False)
def _moments_kernel(
    # In:
    tree: LightTree,
    dome: wp.int32,
    row: wp.array[wp.vec3f],
    column: wp.array[wp.vec3f],
    # Out:
    moment: wp.array2d[wp.vec4f],
):
    """Integrate the light of a dome's leaves times x, y, z (the dome's frame) and 1.

    Launch dimension: [leaf_count].

    Args:
        tree: The light.
        dome: Which dome.
        row: Integrals of sin^2, of sin cos and of sin of the polar angle, shape [rows].
        column: Integrals of sin and of -cos of the azimuth, and of 1, shape [columns].
        moment: Result, shape [leaf_count, 4 group_count].
    """
    leaf = wp.tid()
    if tree.leaf_dome[leaf] != dome:
        return
    block = tree.leaf_block[leaf]
    size = tree.dome_size[dome]
    first = tree.dome_first[dome]
    for g in range(first[3]):
        at = 4 * (first[2] + g)
        texel = first[0] + g * size[0] * size[1]
        for i in range(block[0], block[0] + block[2]):
            x = wp.vec4f(0.0, 0.0, 0.0, 0.0)
            z = wp.vec4f(0.0, 0.0, 0.0, 0.0)
            flux = wp.vec4f(0.0, 0.0, 0.0, 0.0)
            for j in range(block[1], block[1] + block[3]):
                light = tree.dome_texel[texel + i * size[1] + j]
                x += column[j][0] * light
                z += column[j][1] * light
                flux += column[j][2] * light
            moment[leaf, at] += row[i][0] * x
            moment[leaf, at + 1] += row[i][1] * flux
            moment[leaf, at + 2] += row[i][0] * z
            moment[leaf, at + 3] += row[i][2] * flux


def dome_moments(
    tree: LightTree, dome: int, row: wp.array, column: wp.array, moment: wp.array
) -> None:
    """Integrate the light of a dome's leaves (``_moments_kernel``)."""
    wp.launch(
        _moments_kernel,
        dim=tree.leaf_node.shape[0],
        inputs=[tree, dome, row, column],
        outputs=[moment],
        device=moment.device,
    )
