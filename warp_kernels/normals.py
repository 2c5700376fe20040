"""Skin at given normals: the reflectance map as a picture."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.film import finish_rows
from usdskin.warp_kernels.skin import reflect_skin, shade_skin
from usdskin.warp_kernels.structs import Film, Geometry, Lights, Materials
from usdskin.warp_kernels.surface import Point

wp.set_module_options({"enable_backward": False})


@wp.kernel(enable_backward=False)
def _shade_normals_kernel(
    # In:
    normal: wp.array[wp.vec3f],
    lights: Lights,
    materials: Materials,
    # Out:
    film: Film,
):
    """Shade the first material, skin without textures and lustre, at one normal per pixel.

    Launch dimension: [tile_pixels].
    """
    pixel = wp.tid()
    geometry = Geometry()
    point = Point()
    point.normal = normal[film.first_pixel + pixel]
    point.view = point.normal
    reflection = reflect_skin(geometry, lights, materials, point, 1.0)
    shade_skin(geometry, lights, materials, film, pixel, point, reflection, 1.0)
    finish_rows(materials, film, pixel, 0, 1.0)


def shade_normals(
    normal: wp.array[wp.vec3f], lights: Lights, materials: Materials, film: Film
) -> None:
    """Shade the first material at the normals of one tile."""
    wp.launch(
        _shade_normals_kernel,
        dim=film.xyza.shape[0],
        inputs=[normal, lights, materials],
        outputs=[film],
        device=normal.device,
    )
