"""Lookups on the sphere and in textures: small functions the picture kernels share."""

from __future__ import annotations

import warp as wp

from usdskin.warp_kernels.structs import Lights, Materials

wp.set_module_options({"enable_backward": False})

PI = wp.constant(3.14159265358979)


@wp.func
def latlong_coordinates(direction: wp.vec3f) -> wp.vec2f:
    """Return (polar angle / pi, azimuth in turns) of a direction, UsdLux's latlong layout."""
    polar = wp.acos(wp.clamp(direction[1], -1.0, 1.0)) / PI
    turns = wp.atan2(direction[0], -direction[2]) / (2.0 * PI)
    if turns < 0.0:
        turns = turns + 1.0
    return wp.vec2f(polar, turns)


@wp.func
def _cubic_weights(t: wp.float32) -> wp.vec4f:
    """Catmull-Rom weights at t in [0, 1] between the second and the third of four nodes."""
    t2 = t * t
    t3 = t2 * t
    return wp.vec4f(
        -0.5 * t + t2 - 0.5 * t3,
        1.0 - 2.5 * t2 + 1.5 * t3,
        0.5 * t + 2.0 * t2 - 1.5 * t3,
        -0.5 * t2 + 0.5 * t3,
    )


@wp.func
def lookup_map(
    value: wp.array[wp.vec4f], offset: wp.int32, rows: wp.int32, coordinates: wp.vec2f
) -> wp.vec4f:
    """Interpolate a padded node grid of H = ``rows`` and W = 2 H bicubically."""
    y = coordinates[0] * wp.float32(rows)
    x = coordinates[1] * wp.float32(2 * rows)
    i = wp.clamp(wp.int32(y), 0, rows - 1)
    j = wp.clamp(wp.int32(x), 0, 2 * rows - 1)
    wy = _cubic_weights(y - wp.float32(i))
    wx = _cubic_weights(x - wp.float32(j))
    stride = 2 * rows + 3
    total = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    for k in range(4):
        at = offset + (i + k) * stride + j
        row = wx[0] * value[at] + wx[1] * value[at + 1]
        row += wx[2] * value[at + 2] + wx[3] * value[at + 3]
        total += wy[k] * row
    return total


@wp.func
def _lookup_grid(
    value: wp.array[wp.vec4f], offset: wp.int32, rows: wp.int32, coordinates: wp.vec2f
) -> wp.vec4f:
    """Interpolate a node grid of (rows + 1) x (2 rows + 1) bilinearly."""
    y = coordinates[0] * wp.float32(rows)
    x = coordinates[1] * wp.float32(2 * rows)
    i = wp.clamp(wp.int32(y), 0, rows - 1)
    j = wp.clamp(wp.int32(x), 0, 2 * rows - 1)
    fy = y - wp.float32(i)
    fx = x - wp.float32(j)
    stride = 2 * rows + 1
    at = offset + i * stride + j
    top = (1.0 - fx) * value[at] + fx * value[at + 1]
    bottom = (1.0 - fx) * value[at + stride] + fx * value[at + stride + 1]
    return (1.0 - fy) * top + fy * bottom


@wp.func
def frame_coordinates(
    lights: Lights, group: wp.int32, direction: wp.vec3f, before: wp.vec2f
) -> wp.vec2f:
    """Return where a group's maps are looked up; ``before`` is where those of the last group are.

    Maps are in the frame of their dome, so that a dome that turns keeps them.
    """
    if lights.frame_begins[group] == 0:
        return before
    return latlong_coordinates(lights.dome_to_local[group] * direction)


@wp.func
def lookup_gloss(
    lights: Lights, group: wp.int32, alpha: wp.float32, coordinates: wp.vec2f
) -> wp.vec4f:
    """Return the light around a direction, prefiltered for GGX ``alpha``."""
    last = lights.gloss_alpha.shape[0] - 1
    if last < 0:
        return wp.vec4f(0.0, 0.0, 0.0, 0.0)
    if lights.gloss_offset[0, group] < 0:
        return wp.vec4f(0.0, 0.0, 0.0, 0.0)
    level = int(0)
    while level < last - 1 and lights.gloss_alpha[level + 1] < alpha:
        level = level + 1
    low = lights.gloss_alpha[level]
    high = lights.gloss_alpha[wp.min(level + 1, last)]
    blend = float(wp.clamp((alpha - low) / wp.max(high - low, 1.0e-6), 0.0, 1.0))
    if blend >= 1.0 and level < last:
        level = level + 1
        blend = 0.0
    result = _lookup_grid(
        lights.gloss_value,
        lights.gloss_offset[level, group],
        lights.gloss_rows[level, group],
        coordinates,
    )
    if blend > 0.0 and level < last:
        upper = _lookup_grid(
            lights.gloss_value,
            lights.gloss_offset[level + 1, group],
            lights.gloss_rows[level + 1, group],
            coordinates,
        )
        result = (1.0 - blend) * result + blend * upper
    return result


@wp.func
def _albedo_place(
    alpha: wp.float32, cosine: wp.float32, rows: wp.int32, columns: wp.int32
) -> wp.vec2f:
    """Return where a lobe lies in a table over roughness and cosine."""
    y = wp.sqrt(wp.clamp(alpha, 0.0, 1.0)) * wp.float32(rows - 1)
    x = wp.clamp(cosine, 0.0, 1.0) * wp.float32(columns - 1)
    return wp.vec2f(y, x)


@wp.func
def lookup_fresnel(lights: Lights, alpha: wp.float32, cosine: wp.float32) -> wp.vec4f:
    """Return (x, y, k, q): a GGX lobe's directional albedo is F0 x + y (Schlick's Fresnel)."""
    rows = lights.fresnel.shape[0]
    columns = lights.fresnel.shape[1]
    at = _albedo_place(alpha, cosine, rows, columns)
    i = wp.min(wp.int32(at[0]), rows - 2)
    j = wp.min(wp.int32(at[1]), columns - 2)
    fy = at[0] - wp.float32(i)
    fx = at[1] - wp.float32(j)
    top = (1.0 - fx) * lights.fresnel[i, j] + fx * lights.fresnel[i, j + 1]
    bottom = (1.0 - fx) * lights.fresnel[i + 1, j] + fx * lights.fresnel[i + 1, j + 1]
    return (1.0 - fy) * top + fy * bottom


@wp.func
def lookup_lustre(
    materials: Materials, k: wp.int32, alpha: wp.float32, cosine: wp.float32
) -> wp.vec3f:
    """Return the directional albedo of a GGX lobe of the k-th dielectric, its k and q."""
    rows = materials.lustre.shape[1]
    columns = materials.lustre.shape[2]
    at = _albedo_place(alpha, cosine, rows, columns)
    i = wp.min(wp.int32(at[0]), rows - 2)
    j = wp.min(wp.int32(at[1]), columns - 2)
    fy = at[0] - wp.float32(i)
    fx = at[1] - wp.float32(j)
    top = (1.0 - fx) * materials.lustre[k, i, j]
    top += fx * materials.lustre[k, i, j + 1]
    bottom = (1.0 - fx) * materials.lustre[k, i + 1, j]
    bottom += fx * materials.lustre[k, i + 1, j + 1]
    return (1.0 - fy) * top + fy * bottom


@wp.func
def lookup_dome(lights: Lights, group: wp.int32, direction: wp.vec3f) -> wp.vec4f:
    """Return a dome's own texels towards a world direction, bilinearly."""
    offset = lights.dome_offset[group]
    if offset < 0:
        return wp.vec4f(0.0, 0.0, 0.0, 0.0)
    rows = lights.dome_rows[group]
    columns = lights.dome_columns[group]
    coordinates = latlong_coordinates(lights.dome_to_local[group] * direction)
    y = wp.clamp(coordinates[0] * wp.float32(rows) - 0.5, 0.0, wp.float32(rows - 1))
    x = coordinates[1] * wp.float32(columns) - 0.5
    if x < 0.0:
        x = x + wp.float32(columns)
    i = wp.int32(y)
    j = wp.int32(x)
    fy = y - wp.float32(i)
    fx = x - wp.float32(j)
    below = wp.min(i + 1, rows - 1)
    beside = (j + 1) % columns
    j = j % columns
    top = (1.0 - fx) * lights.dome_value[offset + i * columns + j]
    top += fx * lights.dome_value[offset + i * columns + beside]
    bottom = (1.0 - fx) * lights.dome_value[offset + below * columns + j]
    bottom += fx * lights.dome_value[offset + below * columns + beside]
    return (1.0 - fy) * top + fy * bottom


@wp.func
def _wrap_index(i: wp.int32, size: wp.int32, mode: wp.int32) -> wp.int32:
    """Return the texel an index means, -1 outside: 0 repeat, 1 clamp, 2 mirror, 3 black."""
    if mode == 1:
        return wp.clamp(i, 0, size - 1)
    if mode == 3:
        if i < 0 or i >= size:
            return -1
        return i
    period = size
    if mode == 2:
        period = 2 * size
    wrapped = i % period
    if wrapped < 0:
        wrapped = wrapped + period
    if wrapped >= size:
        wrapped = period - 1 - wrapped
    return wrapped


@wp.func
def _tile_at(materials: Materials, tiled: wp.int32, u: wp.int32, v: wp.int32) -> wp.int32:
    """Return the texture of a tile, -1 where there is none."""
    info = materials.texture_info[tiled]
    if u < 0 or u >= 10 or v < 0 or v >= -info[0]:
        return -1
    return materials.texture_tile[info[1] + 10 * v + u]


@wp.func
def _texel_beside(
    materials: Materials,
    tiled: wp.int32,
    tile: wp.vec3i,
    lower: wp.int32,
    i: wp.int32,
    j: wp.int32,
) -> wp.vec4f:
    """Return a texel beyond the edge of a tile: the next tile's, or the edge's where none is."""
    level = materials.texture_level[tile[0], lower]
    right = int(0)
    up = int(0)
    if j < 0:
        right = -1
    if j >= level[1]:
        right = 1
    if i < 0:
        up = 1
    if i >= level[2]:
        up = -1
    column = wp.clamp(j, 0, level[1] - 1)
    row = wp.clamp(i, 0, level[2] - 1)
    beside = _tile_at(materials, tiled, tile[1] + right, tile[2] + up)
    if beside < 0 and right != 0 and up != 0:  # at a corner, where the outer edges stay
        beside = _tile_at(materials, tiled, tile[1] + right, tile[2])
        if beside >= 0:
            up = 0
        else:
            right = 0
            beside = _tile_at(materials, tiled, tile[1], tile[2] + up)
    if beside < 0:
        return materials.texel[level[0] + row * level[1] + column]
    last = materials.texture_info[beside][0] - 1
    other = materials.texture_level[beside, wp.min(lower, last)]
    # Tiles may differ in size: along the edge the same place, not the same texel.
    x = (wp.float32(column) + 0.5) / wp.float32(level[1]) * wp.float32(other[1])
    y = (wp.float32(row) + 0.5) / wp.float32(level[2]) * wp.float32(other[2])
    column = wp.clamp(wp.int32(x), 0, other[1] - 1)
    row = wp.clamp(wp.int32(y), 0, other[2] - 1)
    if right > 0:
        column = 0
    if right < 0:
        column = other[1] - 1
    if up > 0:
        row = other[2] - 1
    if up < 0:
        row = 0
    return materials.texel[other[0] + row * other[1] + column]


@wp.func
def _tile_texel(
    materials: Materials, tiled: wp.int32, tile: wp.vec3i, lower: wp.int32, i: wp.int32, j: wp.int32
) -> wp.vec4f:
    level = materials.texture_level[tile[0], lower]
    if i < 0 or j < 0 or i >= level[2] or j >= level[1]:
        return _texel_beside(materials, tiled, tile, lower, i, j)
    return materials.texel[level[0] + i * level[1] + j]


@wp.func
def _sample_tile(
    materials: Materials, tiled: wp.int32, tile: wp.vec3i, lower: wp.int32, at: wp.vec4f
) -> wp.vec4f:
    """Return a level of a tile, and of those beside it, at (fractions, x, y) [texel]."""
    j = wp.int32(wp.floor(at[2]))
    i = wp.int32(wp.floor(at[3]))
    total = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    for k in range(4):  # not unrolled, as below
        across = k % 2
        down = k / 2
        weight = wp.where(across == 1, at[0], 1.0 - at[0])
        weight = weight * wp.where(down == 1, at[1], 1.0 - at[1])
        total += weight * _tile_texel(materials, tiled, tile, lower, i + down, j + across)
    return total


@wp.func
def _texel(
    materials: Materials, texture: wp.int32, level: wp.vec3i, row: wp.int32, column: wp.int32
) -> wp.vec4f:
    """Return the texel of a wrapped row and column, the border where either is negative."""
    if column < 0 or row < 0:
        return materials.texture_border[texture]
    return materials.texel[level[0] + row * level[1] + column]


@wp.func
def _sample_level(
    materials: Materials, texture: wp.int32, tile: wp.vec3i, lower: wp.int32, st: wp.vec2f
) -> wp.vec4f:
    level = materials.texture_level[tile[0], lower]
    info = materials.texture_info[texture]
    x = st[0] * wp.float32(level[1]) - 0.5
    y = (1.0 - st[1]) * wp.float32(level[2]) - 0.5
    j = wp.int32(wp.floor(x))
    i = wp.int32(wp.floor(y))
    fx = x - wp.float32(j)
    fy = y - wp.float32(i)
    if tile[0] != texture:
        return _sample_tile(materials, texture, tile, lower, wp.vec4f(fx, fy, x, y))
    left = _wrap_index(j, level[1], info[1])
    right = _wrap_index(j + 1, level[1], info[1])
    upper = _wrap_index(i, level[2], info[2])
    under = _wrap_index(i + 1, level[2], info[2])
    top = (1.0 - fx) * _texel(materials, texture, level, upper, left)
    top += fx * _texel(materials, texture, level, upper, right)
    bottom = (1.0 - fx) * _texel(materials, texture, level, under, left)
    bottom += fx * _texel(materials, texture, level, under, right)
    return (1.0 - fy) * top + fy * bottom


@wp.func
def _find_tile(materials: Materials, tiled: wp.int32, st: wp.vec2f) -> wp.vec3i:
    """Return (texture, u, v) of the tile at ``st``; the texture is -1 where there is none."""
    u = wp.int32(wp.floor(st[0]))
    v = wp.int32(wp.floor(st[1]))
    tile = _tile_at(materials, tiled, u, v)
    if tile < 0:
        # A point on the far edge of the last tile is on that tile.
        u = wp.int32(wp.floor(st[0] - 1.0e-4))
        v = wp.int32(wp.floor(st[1] - 1.0e-4))
        tile = _tile_at(materials, tiled, u, v)
    return wp.vec3i(tile, u, v)


@wp.func
def sample_texture(
    materials: Materials, texture: wp.int32, st: wp.vec2f, width: wp.float32
) -> wp.vec4f:
    """Return a texture at ``st`` (origin bottom left), trilinear for a footprint ``width``."""
    tile = wp.vec3i(texture, 0, 0)
    if materials.texture_info[texture][0] < 0:
        tile = _find_tile(materials, texture, st)
        if tile[0] < 0:
            return materials.texture_border[texture]
    local = st - wp.vec2f(wp.float32(tile[1]), wp.float32(tile[2]))
    info = materials.texture_info[tile[0]]
    base = materials.texture_level[tile[0], 0]
    texels = width * wp.float32(wp.max(base[1], base[2]))
    level = wp.clamp(wp.log2(wp.max(texels, 1.0e-6)), 0.0, wp.float32(info[0] - 1))
    lower = wp.int32(level)
    blend = level - wp.float32(lower)
    levels = int(1)
    if blend > 0.0:
        levels = 2
    result = wp.vec4f(0.0, 0.0, 0.0, 0.0)
    share = 1.0 - blend
    for k in range(levels):  # not unrolled: every caller has a copy of this to compile
        result += share * _sample_level(materials, texture, tile, lower + k, local)
        share = blend
    return result
