"""First surfaces by rays: what every sample of a tile sees, where nothing was rasterised."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.structs import CameraRays, Geometry
from usdskin.warp_kernels.view import UNKNOWN, meet, picture_ray

wp.set_module_options({"enable_backward": False})


@wp.kernel(enable_backward=False)
def _first_faces_kernel(
    # In:
    geometry: Geometry,
    camera: CameraRays,
    sample: wp.array[wp.vec2f],
    first_pixel: wp.int32,
    # Out:
    face_out: wp.array2d[wp.int32],
):
    """Find the first triangle of one sample of a pinhole camera.

    Launch dimension: [pixels, samples].

    Args:
        geometry: The surfaces.
        camera: Where from.
        sample: Sample offsets from a pixel's middle [px], shape [samples].
        first_pixel: Pixel the tile starts at.
        face_out: Triangle, -1 where there is none, shape [pixels, samples].
    """
    pixel, s = wp.tid()
    ray = picture_ray(camera, first_pixel + pixel, sample[s], wp.vec2f(0.5, 0.5), 1.0)
    face_out[pixel, s] = meet(geometry, ray, 0.0, UNKNOWN).face


def find_first_faces(
    geometry: Geometry, camera: CameraRays, sample: wp.array, first_pixel: int, pixels: int
) -> wp.array2d[wp.int32]:
    """Return the first triangle of every sample of a tile, -1 for none, [pixels, samples]."""
    face = wp.empty((pixels, sample.shape[0]), dtype=wp.int32, device=sample.device)
    wp.launch(
        _first_faces_kernel,
        dim=face.shape,
        inputs=[geometry, camera, sample, first_pixel],
        outputs=[face],
        device=sample.device,
    )
    return face
