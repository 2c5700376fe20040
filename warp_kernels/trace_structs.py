"""What a pass of the traced integrator works with."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_tree import LightTree
from usdskin.warp_kernels.local_lights import LocalLights
from usdskin.warp_kernels.trace_guide import Guide

FAR = wp.constant(1.0e18)
"""Distance of domes and distant lights [m]."""

SKIN_MIX = wp.constant(0.4)
"""Weight of the wrap term beside Lambert's when directions for skin are chosen."""

# Dimensions of a sample's low-discrepancy point.
LENS_DIMENSION = wp.constant(0)
LIGHT_DIMENSION = wp.constant(2)
GLOSS_DIMENSION = wp.constant(5)
BOUNCE_DIMENSION = wp.constant(8)


@wp.struct
class Trace:
    """What a pass of samples adds to a tile."""

    tree: LightTree

    local: LocalLights
    """Lights that have a place."""

    first_local: wp.int32
    """Number of the first of them as ``LightLinks`` numbers lights."""

    sobol: wp.array2d[wp.uint32]
    """Direction numbers (``direction_numbers``)."""

    pixel: wp.array[wp.int32]
    """Pixels of the tile that take part, shape [pixel_count]."""

    key: wp.uint32
    """Seed and frame."""

    first_sample: wp.int32
    """Index of the pass's first sample in every pixel's sequence."""

    first_camera: wp.int32
    """Index of its first camera sample."""

    split: wp.int32
    """Directions of light for every camera sample."""

    guide: Guide
    """What blocks of pixels know of the light that arrives."""

    weight: wp.float32
    """Weight of what directions change, against the other passes' [1]."""

    part: wp.array2d[wp.vec3f]
    """Sums of XYZ: diffuse, specular, emission, indirect, shape [tile_pixels, 4], or [0, 0]."""

    tally: wp.array[wp.vec4f]
    """Sums over all passes: Y, unshadowed Y, Y that something weakened, samples, shape
    [tile_pixels]."""

    luminance: wp.array[wp.vec4f]
    """Of this pass, ``weight`` taken off: sums of the Y that directions add over its two halves,
    which share their camera samples where these take more than one; and of all Y its sum and that
    of its squares over camera samples. Shape [tile_pixels]."""
