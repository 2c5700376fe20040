"""What a surface makes of light, and where its light is kept.

A surface never handles wavelengths. It weighs the light's coefficient channels (Lambert and wrap
integrals, prefiltered reflections) and deposits each product in one row of the pixel's scratch;
``Materials.band`` gives every row its spectrum when the pixel is finished.
"""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.structs import Film, Materials

wp.set_module_options({"enable_backward": False})


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

    index: wp.float32
    """Refractive index of their surface; 0 where Schlick's Fresnel is used."""

    lustre: wp.int32
    """Which of ``Materials.lustre`` is theirs, where there is an index."""

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
def fresnel_rise(index: wp.float32, f0: wp.float32, cosine: wp.float32) -> wp.float32:
    """Return (F - F0) / (1 - F0) of a dielectric (Born and Wolf, 1.5.2), or Schlick's."""
    outside = wp.clamp(cosine, 0.0, 1.0)
    if index == 0.0:
        return wp.pow(1.0 - outside, 5.0)
    inside = wp.sqrt(wp.max(1.0 - (1.0 - outside * outside) / (index * index), 1.0e-12))
    across = (outside - index * inside) / (outside + index * inside)
    along = (index * outside - inside) / (index * outside + inside)
    mirrored = 0.5 * (across * across + along * along)
    return (mirrored - f0) / wp.max(1.0 - f0, 1.0e-4)


@wp.func
def base_weight(low: wp.vec4f, high: wp.vec4f, j: wp.int32) -> wp.float32:
    """Return the weight of base j, of eight."""
    if j < 4:
        return low[j]
    return high[j - 4]


@wp.func
def deposit(
    materials: Materials, film: Film, pixel: wp.int32, material: wp.int32, row: wp.int32,
    value: wp.vec4f,
) -> wp.float32:  # fmt: skip
    """Add light to one row of a pixel's scratch; return its Y."""
    film.channel[pixel, row] += value
    return wp.dot(materials.xyz_y[materials.row[material] + row], value)
