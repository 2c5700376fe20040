"""What the picture kernels read: a scene's arrays, grouped by what they describe."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.light_links import LightLinks


@wp.struct
class Geometry:
    """All triangles of the stage, in world space [m]."""

    mesh: wp.uint64
    """Id of the ``wp.Mesh``."""

    corner_normal: wp.array[wp.vec3f]
    """Unit shading normals per triangle corner, shape [3 triangle_count]."""

    corner_value: wp.array2d[wp.vec4f]
    """Primvars per triangle corner, shape [primvar_count, 3 triangle_count]."""

    corner_frame: wp.array2d[wp.vec4f]
    """What turns the axes of normal and height maps into directions, per triangle corner: tangent
    and sign of the bitangent, or the gradients of s and of t [1/m] in two rows, shape [frame_count,
    3 triangle_count]."""

    material: wp.array[wp.int32]
    """Material index, shape [triangle_count]."""

    prim: wp.array[wp.int32]
    """Prim index, shape [triangle_count]."""

    transfer_vertex: wp.array[wp.int32]
    """Row of ``transfer`` of each corner, -1 where nothing was measured, shape
    [3 triangle_count], or [0]."""

    transfer: wp.array2d[wp.vec4f]
    """What shadows change of the diffuse rows (``usdskin.warp_kernels.transfer_gather``), shape
    [vertex_count, columns]."""

    sheet: wp.array[wp.int32]
    """1 where a prim's skin is a sheet with a thickness, which has no inside, else 0, shape
    [prim_count]."""

    seen_row: wp.array[wp.int32]
    """Row of ``seen_hidden`` of each row of ``transfer``, shape [vertex_count]."""

    seen_hidden: wp.array2d[wp.uint32]
    """A bit per direction from which less than half of a reflection comes, shape
    [row_count, word_count]."""

    seen_ring: wp.array[wp.int32]
    """First direction of each ring, and one past the last, shape [ring_count + 1]."""

    seen_order: wp.array[wp.int32]
    """Bit of each direction, ring after ring."""

    seen_axes: wp.mat33f
    """From the world to the frame of the rings."""


@wp.struct
class CameraRays:
    """A pinhole or orthographic camera."""

    origin: wp.vec3f
    """Position [m], world space."""

    right: wp.vec3f
    up: wp.vec3f
    back: wp.vec3f
    """The camera's axes in world space; it looks along -back."""

    window: wp.vec4f
    """left, right, bottom, top: tangents at unit distance, or metres where orthographic."""

    near: wp.float32
    far: wp.float32
    """Clipping distances along the view axis [m]."""

    lens_radius: wp.float32
    """Radius of the aperture [m]; 0 for a pinhole."""

    focus_distance: wp.float32
    """Distance of the plane of focus along the view axis [m]."""

    orthographic: wp.int32
    width: wp.int32
    height: wp.int32
    """Picture size [px]."""


@wp.struct
class Lights:
    """The light at every normal: smooth maps, lamps and prefiltered reflections, in channel groups.

    A group holds four coefficient channels; ``group_count`` groups cover all domes and lamps.
    """

    group_count: wp.int32

    map_value: wp.array[wp.vec4f]
    """Node values of all maps [coefficient sr], each node grid padded by two for bicubic lookup."""

    map_offset: wp.array3d[wp.int32]
    """First value of a map, -1 where the group has none, shape [wrap_count, 3, group_count]."""

    map_rows: wp.array[wp.int32]
    """H of a group's maps: nodes at polar angle pi i / H, shape [group_count]."""

    lamp_center: wp.array[wp.vec3f]
    lamp_azimuth: wp.array[wp.vec3f]
    lamp_elevation: wp.array[wp.vec3f]
    """Direction and half extents of each lamp, group after group, shape [lamp_count]."""

    lamp_reach: wp.array[wp.float32]
    """Sum of the half extents: N.L varies by no more over a lamp, shape [lamp_count]."""

    lamp_flux: wp.array[wp.vec4f]
    """Coefficients times solid angle [sr], shape [lamp_count]."""

    lamp_end: wp.array[wp.int32]
    """One past the last lamp of a group, shape [group_count]."""

    gloss_end: wp.array[wp.int32]
    """One past the last lamp of a group that is reflected by itself; the others are in
    ``gloss_value``. Shape [group_count]."""

    wrap: wp.array[wp.float32]
    """l of each map set, shape [wrap_count]."""

    gloss_value: wp.array[wp.vec4f]
    """Prefiltered reflections, latlong node grids, one per level and group."""

    gloss_offset: wp.array2d[wp.int32]
    gloss_rows: wp.array2d[wp.int32]
    """First value and H of a grid, -1 where there is none, shape [level_count, group_count]."""

    gloss_alpha: wp.array[wp.float32]
    """GGX alpha of each level, ascending, shape [level_count]."""

    fresnel: wp.array2d[wp.vec4f]
    """Directional albedo = F0 x + y by Schlick's Fresnel, (x, y, k, q): the lobe's mean
    direction is along mirror + k normal, its width that of q alpha seen from above; over
    (roughness, cosine), shape [roughness_count, cosine_count]."""

    dome_value: wp.array[wp.vec4f]
    """Texels of the domes as the camera sees them, one image per group."""

    dome_offset: wp.array[wp.int32]
    dome_rows: wp.array[wp.int32]
    dome_columns: wp.array[wp.int32]
    """Shape [group_count]; the offset is -1 where no dome is seen."""

    dome_to_local: wp.array[wp.mat33f]
    """World to light frame of each group's dome, in which its maps and reflections are, shape
    [group_count]."""

    frame_begins: wp.array[wp.int32]
    """1 where a group is the first of its dome, 0 where the frame is that of the group before or
    the group has no maps, shape [group_count]."""

    links: LightLinks

    link_mask: wp.array2d[wp.vec4f]
    """1 where a channel's light reaches the prims of a row of ``links``, else 0, shape
    [row_count, group_count]; empty where the links are not active."""


@wp.struct
class Materials:
    """How surfaces turn light into spectra.

    Outgoing radiance is a sum of scalar weights times channel groups; each such pair has a row of
    ``band`` and ``xyz``, so the spectrum appears only when a pixel is finished.
    """

    kind: wp.array[wp.int32]
    """0 UsdPreviewSurface, 1 skin, 2 the dome seen by the camera, shape [material_count]."""

    row: wp.array[wp.int32]
    """First row of the material, shape [material_count]."""

    row_count: wp.array[wp.int32]

    weight_count: wp.array[wp.int32]
    """Reflectance bases: 1 folded into the rows, 3 RGB, else basis weights."""

    wrap_set: wp.array[wp.int32]
    """Index into ``Lights.wrap``."""

    passage_rank: wp.array[wp.int32]
    """Terms of exp(-s delta) = sum_k f_k(s) g_k; 0 where light from behind is not weakened, shape
    [material_count]."""

    passage: wp.array3d[wp.float32]
    """f_k over log(1 + s / scale), in equal steps, shape [material_count, entry_count, rank]."""

    passage_scale: wp.array[wp.vec2f]
    """(scale [m], entries per unit of log(1 + s / scale)); (1, 0) where s is constant, shape
    [material_count]."""

    passage_limit: wp.array[wp.float32]
    """Way through a body beyond which no light is left [m]; 0 where it is clear, shape
    [material_count]."""

    sent_row: wp.array[wp.int32]
    """Where a material begins in the list of rows that surfaces send to others, shape
    [material_count]."""

    sent_count: wp.int32
    """Length of that list; 0 where light does not bounce."""

    indirect_row: wp.array[wp.int32]
    """First row of light from other surfaces: per pass and base, the whole list, shape
    [material_count]."""

    row_part: wp.array[wp.int32]
    """0 diffuse, 1 specular, 2 emission, 3 indirect, shape [row_count]."""

    flags: wp.array[wp.int32]
    """Bit 0 specular workflow, 1 presence opacity, 2 specular rows, 3 tinted specular rows,
    4 emission row, 5 clearcoat, 6 normal or height map, 7 maps of the lustre, 8 opaque and without
    textures."""

    constant: wp.array2d[wp.vec4f]
    """Values of the inputs that have no texture, shape [material_count, input_count]."""

    lustre: wp.array3d[wp.vec3f]
    """Directional albedo of a dielectric's lobe, k and q, over (F0, roughness, cosine), shape
    [f0_count, roughness_count, cosine_count]; INPUT_SPECULAR of skin is (F0, its index here,
    refractive index)."""

    slot: wp.array2d[wp.int32]
    """Texture slot of an input, -1 where constant, shape [material_count, input_count]."""

    slot_texture: wp.array[wp.int32]
    """Texture read by a slot, -1 where the primvar itself is the value, shape [slot_count]."""

    slot_primvar: wp.array[wp.int32]
    slot_channel: wp.array[wp.int32]
    """The primvar looked up, and the channel taken (-1 for all), shape [slot_count]."""

    slot_matrix_u: wp.array[wp.vec3f]
    slot_matrix_v: wp.array[wp.vec3f]
    """Rows of the st transform, shape [slot_count]."""

    texel: wp.array[wp.vec4f]
    texture_level: wp.array2d[wp.vec3i]
    """(offset, width, height) of each level, shape [texture_count, level_count]."""

    texture_border: wp.array[wp.vec4f]
    """What wrap mode black reads outside, shape [texture_count]."""

    texture_info: wp.array[wp.vec3i]
    """(levels, wrap s, wrap t), shape [texture_count]; of a tiled texture (minus the rows of its
    table of 10 columns, the table's first entry, 0)."""

    texture_tile: wp.array[wp.int32]
    """Tables of tiled textures: the texture of each tile, -1 where there is none, shape [n]."""

    band: wp.array2d[wp.vec4f]
    """Spectra of each row's four channels, one after the other, bands in groups of four [radiance
    per coefficient], shape [4 row_count, band_groups]."""

    xyz_x: wp.array[wp.vec4f]
    xyz_y: wp.array[wp.vec4f]
    xyz_z: wp.array[wp.vec4f]
    """Tristimulus values of each row's four channels, shape [row_count]."""


@wp.struct
class Film:
    """One tile of the picture under construction."""

    sample: wp.array[wp.vec2f]
    """Sample offsets from the pixel's middle [px], warped by the pixel filter, shape [samples]."""

    first_sample: wp.int32
    """Index of the first of these samples among all of the pixel's."""

    sample_count: wp.int32
    """Samples of the whole picture where these are part of them, else 0."""

    first_pixel: wp.int32
    """Pixel the tile starts at, row-major."""

    channel: wp.array2d[wp.vec4f]
    """Scratch of a material's rows per pixel, zero between uses, [tile_pixels, max_rows]."""

    xyza: wp.array[wp.vec4f]
    """Result: XYZ and alpha, shape [tile_pixels]."""

    spectrum: wp.array2d[wp.vec4f]
    """Result: spectral radiance, bands in groups of four, shape [tile_pixels, band_groups], or
    [tile_pixels, 0] when not wanted."""

    face: wp.array2d[wp.int32]
    """First triangle of every sample, -1 where there is none, shape [tile_pixels, samples], or
    [0, 0] where every sample has a ray of its own."""

    show_dome: wp.int32


# Material inputs: columns of ``Materials.constant`` and ``Materials.slot``.
INPUT_BASE = wp.constant(0)
INPUT_BASE_HIGH = wp.constant(1)
INPUT_METALLIC = wp.constant(2)
INPUT_ROUGHNESS = wp.constant(3)
INPUT_SPECULAR = wp.constant(4)
INPUT_CLEARCOAT = wp.constant(5)
INPUT_CLEARCOAT_ROUGHNESS = wp.constant(6)
INPUT_OPACITY = wp.constant(7)
INPUT_EMISSION = wp.constant(8)
INPUT_THICKNESS = wp.constant(9)
INPUT_LOBES = wp.constant(10)
INPUT_NORMAL = wp.constant(11)
INPUT_BUMP = wp.constant(12)
INPUT_LUSTRE = wp.constant(13)
INPUT_LUSTRE_ROUGHNESS = wp.constant(14)
INPUT_COUNT = 15
