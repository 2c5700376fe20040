"""Pictures: camera rays into the scene, surfaces into channels, channels into spectra."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.detail import relieved
from usdskin.warp_kernels.gloss import shade_gloss
from usdskin.warp_kernels.lookup import lookup_dome
from usdskin.warp_kernels.preview_surface import (
    reflect_preview_surface,
    shade_emission,
    shade_preview_surface,
)
from usdskin.warp_kernels.seen import deposit_transfer, has_transfer, hide_reflections
from usdskin.warp_kernels.skin import reflect_skin, shade_skin
from usdskin.warp_kernels.structs import (
    INPUT_OPACITY,
    CameraRays,
    Film,
    Geometry,
    Lights,
    Materials,
)
from usdskin.warp_kernels.view import (
    MAX_LAYERS,
    UNKNOWN,
    beyond,
    lens_sample,
    meet,
    picture_ray,
    surface_point,
)
from usdskin.warp_kernels.visibility import surface_opacity

wp.set_module_options({"enable_backward": False, "max_unroll": 1})

TAKEN = wp.constant(-3)
"""Of a sample's triangle: shaded already, with another sample."""

_RUN = 64
"""Pixels of one index of a launch on a CPU."""


@wp.func
def finish_rows(
    materials: Materials, film: Film, pixel: wp.int32, material: wp.int32, share: wp.float32
):
    """Turn the scratch of one material into XYZ and spectrum, and clear it."""
    if material < 0:
        return
    first = materials.row[material]
    count = materials.row_count[material]
    xyza = film.xyza[pixel]
    x = float(0.0)
    y = float(0.0)
    z = float(0.0)
    for q in range(count):
        value = film.channel[pixel, q]
        x += wp.dot(materials.xyz_x[first + q], value)
        y += wp.dot(materials.xyz_y[first + q], value)
        z += wp.dot(materials.xyz_z[first + q], value)
    film.xyza[pixel] = xyza + share * wp.vec4f(x, y, z, 0.0)
    groups = film.spectrum.shape[1]
    for q in range(count):
        value = share * film.channel[pixel, q]
        at = 4 * (first + q)
        for g in range(groups):
            part = value[0] * materials.band[at, g] + value[1] * materials.band[at + 1, g]
            part += value[2] * materials.band[at + 2, g] + value[3] * materials.band[at + 3, g]
            film.spectrum[pixel, g] += part
        film.channel[pixel, q] = wp.vec4f(0.0, 0.0, 0.0, 0.0)


@wp.func
def deposit_dome(
    lights: Lights, film: Film, pixel: wp.int32, direction: wp.vec3f, weight: wp.float32
):
    """Deposit what the domes show towards a direction."""
    for g in range(lights.group_count):
        film.channel[pixel, g] += weight * lookup_dome(lights, g, direction)


@wp.func
def shines_when_clear(materials: Materials, material: wp.int32) -> bool:
    """Return whether a surface reflects at opacity 0: transparent, and not cut out."""
    flags = materials.flags[material]
    return (flags & 6) == 4 and materials.constant[material, INPUT_OPACITY][1] <= 0.0


@wp.func
def _gather(film: Film, pixel: wp.int32, s: wp.int32) -> wp.vec3f:
    """Return the mean offset [px] of a pixel's samples on the triangle of sample s, and how many
    they are; those that follow s are marked as taken.
    """
    face = film.face[pixel, s]
    total = film.sample[s]
    count = float(1.0)
    for other in range(s + 1, film.sample.shape[0]):
        if film.face[pixel, other] == face:
            film.face[pixel, other] = TAKEN
            total += film.sample[other]
            count += 1.0
    return wp.vec3f(total[0] / count, total[1] / count, count)


@wp.func(inline=True)
def _render_pixel(
    geometry: Geometry, camera: CameraRays, lights: Lights, materials: Materials, film: Film,
    pixel: wp.int32,
):  # fmt: skip
    """Render every sample's surfaces, front to back, then one spectrum per material.

    Samples that see the same triangle of a plain material are one, where their mean is: normals and
    primvars are so smooth over it that this changes the pixel by the square of its width.
    """
    index = film.first_pixel + pixel
    samples = film.sample.shape[0]
    share = 1.0 / wp.float32(samples)
    dome = materials.kind.shape[0] - 1
    current = int(-1)
    alpha = float(0.0)
    finest = wp.float32(wp.max(samples, film.sample_count))
    for s in range(samples):
        offset = film.sample[s]
        clear = float(1.0)
        known = int(UNKNOWN)
        if film.face.shape[0] > 0:
            known = film.face[pixel, s]
            if known == TAKEN:
                continue
            if known >= 0:
                if (materials.flags[geometry.material[known]] & 256) != 0:
                    gathered = _gather(film, pixel, s)
                    offset = wp.vec2f(gathered[0], gathered[1])
                    clear = gathered[2]
        sharpness = wp.sqrt(clear / finest)
        ray = picture_ray(
            camera, index, offset, lens_sample(index, film.first_sample + s), sharpness
        )
        start = float(0.0)
        seen_through = int(1)
        for _layer in range(MAX_LAYERS):
            met = meet(geometry, ray, start, known)
            known = int(UNKNOWN)
            if met.face < 0:
                if film.show_dome != 0:
                    if current != dome:
                        finish_rows(materials, film, pixel, current, share)
                        current = dome
                    deposit_dome(lights, film, pixel, ray.direction, clear)
                    alpha += clear
                seen_through = 0
                break
            point = surface_point(geometry, ray, met)
            if (materials.flags[point.material] & 64) != 0:
                point = relieved(geometry, materials, point)
            opacity = surface_opacity(geometry, materials, point)
            if point.material != current:
                finish_rows(materials, film, pixel, current, share)
                current = point.material
            if materials.kind[current] == 1:
                r = reflect_skin(geometry, lights, materials, point, clear)
                behind = float(1.0)
                if has_transfer(geometry, point):
                    behind = 0.0
                    deposit_transfer(geometry, lights, materials, film, pixel, point, r)
                shade_skin(geometry, lights, materials, film, pixel, point, r, behind)
                seen = hide_reflections(geometry, point, r)
                shade_gloss(lights, materials, film, pixel, point, seen)
            elif opacity > 0.0 or shines_when_clear(materials, current):
                r = reflect_preview_surface(geometry, lights, materials, point, clear, opacity)
                shade_preview_surface(lights, materials, film, pixel, point, r)
                if has_transfer(geometry, point):
                    deposit_transfer(geometry, lights, materials, film, pixel, point, r)
                seen = hide_reflections(geometry, point, r)
                shade_gloss(lights, materials, film, pixel, point, seen)
                shade_emission(geometry, lights, materials, film, pixel, point, r)
            alpha += clear * opacity
            clear = clear * (1.0 - opacity)
            start = beyond(met.distance)
            if clear < 1.0e-4 or start >= ray.length:
                seen_through = 0
                break
        if seen_through != 0 and film.show_dome != 0:  # more layers than are counted
            if current != dome:
                finish_rows(materials, film, pixel, current, share)
                current = dome
            deposit_dome(lights, film, pixel, ray.direction, clear)
            alpha += clear
    finish_rows(materials, film, pixel, current, share)
    total = film.xyza[pixel]
    film.xyza[pixel] = wp.vec4f(total[0], total[1], total[2], share * alpha)


@wp.kernel(enable_backward=False)
def _picture_kernel(
    # In:
    geometry: Geometry,
    camera: CameraRays,
    lights: Lights,
    materials: Materials,
    run: wp.int32,
    # Out:
    film: Film,
):
    """Render runs of pixels.

    Launch dimension: [run_count].

    Args:
        geometry: The surfaces.
        camera: Where from.
        lights: The lights.
        materials: Of the surfaces.
        run: Pixels of a run: what a launch costs on a CPU for each index is paid once for all.
        film: The tile.
    """
    first = run * wp.tid()
    for pixel in range(first, wp.min(first + run, film.xyza.shape[0])):
        _render_pixel(geometry, camera, lights, materials, film, pixel)


def render_tile(
    geometry: Geometry, camera: CameraRays, lights: Lights, materials: Materials, film: Film
) -> None:
    """Render the pixels of one tile into ``film.xyza`` and ``film.spectrum``."""
    pixels = film.xyza.shape[0]
    run = _RUN if film.xyza.device.is_cpu else 1
    wp.launch(
        _picture_kernel,
        dim=-(-pixels // run),
        inputs=[geometry, camera, lights, materials, run],
        outputs=[film],
        device=film.xyza.device,
    )
