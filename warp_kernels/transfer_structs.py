"""What the kernels of baked shadows read (``usdskin.warp_kernels.transfer``)."""

from __future__ import annotations

import warp as wp


@wp.struct
class Directions:
    """The directions of a transfer, in words of 32 neighbours."""

    direction: wp.array[wp.vec3f]
    """Unit directions towards the light, zero where a word is not full, shape [32 word_count]."""

    word_center: wp.array[wp.vec3f]
    """Mean direction of a word, shape [word_count]."""

    word_reach: wp.array[wp.float32]
    """Largest distance of a direction from ``word_center``, shape [word_count]."""

    byte_center: wp.array[wp.vec3f]
    byte_reach: wp.array[wp.float32]
    """The same of every eight directions, shape [4 word_count]."""

    word_full: wp.array[wp.uint32]
    """The bits of a word that are in use, shape [word_count]."""


@wp.struct
class Vertices:
    """What is lit: vertices with one normal and one material each."""

    normal: wp.array[wp.vec3f]
    """Unit shading normals, shape [vertex_count]."""

    material: wp.array[wp.int32]
    """Index of the material, shape [vertex_count]."""

    row: wp.array[wp.int32]
    """Row of the transfer, shape [vertex_count]."""


@wp.struct
class Measured:
    """What was measured at places: a point of a mesh with one material."""

    position: wp.array[wp.vec3f]
    """Where rays start, off the surface [m], shape [row_count]."""

    prim: wp.array[wp.int32]
    """Index of the mesh, shape [row_count]."""

    weakened: wp.array2d[wp.uint32]
    """A bit per direction that is not clear, shape [row_count, word_count]."""

    first: wp.array[wp.int32]
    """First entry below of each row, and one past the last of all, shape [row_count + 1]."""

    entry_direction: wp.array[wp.int32]
    """Weakened directions from which some light arrives, shape [entry_count]."""

    entry_clear: wp.array[wp.float32]
    """Share that other bodies let pass [1], shape [entry_count]."""

    entry_length: wp.array[wp.float32]
    """Way inside the own body [m], shape [entry_count]."""


@wp.struct
class LampSets:
    """Lamps that are looked at one by one: a set has the same lamps in several channel groups."""

    first_group: wp.array[wp.int32]
    group_count: wp.array[wp.int32]
    lamp_count: wp.array[wp.int32]
    """Shape [set_count] each; the lamps are the first ones of each group."""

    solid: wp.int32
    """1 where no surface of the scene lets light pass."""


@wp.struct
class Places:
    """Where is measured."""

    position: wp.array[wp.vec3f]
    """[m], shape [place_count]."""

    normal: wp.array[wp.vec3f]
    """Mean unit normals, shape [place_count]."""

    material: wp.array[wp.int32]
    prim: wp.array[wp.int32]
    """Index of the material and of the mesh, shape [place_count]."""

    horizon: wp.array[wp.float32]
    """Cosine with the normal below which no light counts, shape [place_count]."""

    solid: wp.int32
    """1 where no surface of the scene lets light pass."""
