"""Materials on the device: rows of spectra, constants, textures and primvars in flat arrays.

Reads: materials and what they weigh (``usdskin.render.surface_rows``). Makes: ``Surfaces``.
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin import fresnel
from usdskin.colorimetry import illuminant, xyz_to_rgb, xyz_weights
from usdskin.render.detail import check_normal_map, frames_of
from usdskin.render.inputs import PrimvarInput, TextureInput
from usdskin.render.lobe_albedo import TABLE_SIZE, dielectric_response
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.render.memory import available_bytes
from usdskin.render.relief import slopes, unit_normals
from usdskin.render.surface_rows import (
    GLOSSY,
    PLAIN,
    SKIN,
    MaterialRows,
    SpectralFrame,
    add_indirect_rows,
    dome_rows,
    preview_rows,
    row_parts,
    skin_rows,
)
from usdskin.render.textures import Texture, read_texture
from usdskin.render.udim import TiledTexture, is_tiled, pack_tiles, tile_files
from usdskin.warp_kernels import structs

FloatArray = NDArray[np.float64]

_TEXTURE_MB = 2048
"""Most memory for one texture or tile [MiB]."""

_CHANNELS = {"rgb": -1, "rgba": -1, "r": 0, "g": 1, "b": 2, "a": 3}


@dataclass(frozen=True, slots=True, eq=False)
class Surfaces:
    """The materials of a stage on the device, and what they ask of the light and the meshes."""

    device_materials: structs.Materials
    max_rows: int
    """Most rows of a material: the size of a pixel's scratch."""

    albedo: tuple[FloatArray, ...]
    """RGB under D65 of each material's base weights, shape [base_count, 3] each."""


def build_surfaces(
    materials: Sequence[SkinMaterial | SurfaceMaterial],
    light_spectra: FloatArray,
    frame: SpectralFrame,
    wraps: tuple[float, ...],
    primvars: dict[str, int],
    thickness_range: dict[str, float],
    device: str,
    bounces: int = 0,
) -> Surfaces:
    """Build the kernels' material tables.

    Args:
        materials: In the order the triangles' material indices count.
        light_spectra: Spectrum of every light channel, shape [groups, 4, bands].
        frame: Wavelengths, observer and units.
        wraps: Values of l that light maps exist for (``wraps_of``).
        primvars: Row of each primvar in the scene's corner values.
        thickness_range: Largest thickness [m] that a primvar gives to a material, by its path.
        device: Warp device.
        bounces: How often reflected light falls on other surfaces, 0 or 1.

    Raises:
        LayerError: A material cannot be evaluated; the message names it.
    """
    rows = [
        skin_rows(material, light_spectra, frame, thickness_range)
        if isinstance(material, SkinMaterial)
        else preview_rows(material, light_spectra, frame)
        for material in materials
    ]
    rows.append(dome_rows(light_spectra))
    first = frames_of(materials)
    for row in rows:
        for which, laid_along in row.frames.items():
            row.constant[which, 3] = 1 + first[laid_along]  # 0 is no map
    sent = add_indirect_rows(rows) if bounces else np.zeros(len(rows) + 1, np.int32)
    surfaces = _upload(rows, frame, wraps, primvars, device)
    target = surfaces.device_materials
    target.sent_row = wp.array(sent[:-1], dtype=wp.int32, device=device)
    target.sent_count = int(sent[-1])
    indirect = np.array([row.indirect_row for row in rows], np.int32)
    target.indirect_row = wp.array(indirect, dtype=wp.int32, device=device)
    return surfaces


def _texture_limit_mb() -> int:
    """Return how large the next texture may be [MiB]: it is copied once for the device."""
    there = available_bytes()
    return _TEXTURE_MB if there is None else min(_TEXTURE_MB, there // (2 * 2**20))


def band_groups(bands: int) -> int:
    """Return how many groups of four hold that many bands."""
    return -(-bands // 4)


@dataclass(slots=True, eq=False)
class _Slots:
    """Texture and primvar slots, and the textures they share."""

    primvars: dict[str, int]
    rendering_space: str
    textures: list[Texture | TiledTexture] = field(default_factory=list)
    known: dict[Hashable, int] = field(default_factory=dict)
    texture: list[int] = field(default_factory=list)
    primvar: list[int] = field(default_factory=list)
    channel: list[int] = field(default_factory=list)
    matrix: list[NDArray[np.float64]] = field(default_factory=list)

    def add(self, value: TextureInput | PrimvarInput, weight_count: int, which: int) -> int:
        """Return the slot of an input; ``weight_count`` channels are weights, not a color."""
        if isinstance(value, PrimvarInput):
            self._append(-1, self.primvars[value.name], -1, np.eye(2, 3))
        else:
            # Slopes are read all together, whatever channel the height is in.
            channel = -1 if which == structs.INPUT_BUMP else _CHANNELS[value.channel]
            texture = self._texture(value, weight_count, which)
            matrix = np.asarray(value.st_matrix)
            self._append(texture, self.primvars[value.primvar], channel, matrix)
        return len(self.texture) - 1

    def _append(self, texture: int, primvar: int, channel: int, matrix: FloatArray) -> None:
        self.texture.append(texture)
        self.primvar.append(primvar)
        self.channel.append(channel)
        self.matrix.append(matrix)

    def _texture(self, value: TextureInput, weight_count: int, which: int) -> int:
        relief = which if which in (structs.INPUT_NORMAL, structs.INPUT_BUMP) else None
        tiled = is_tiled(str(value.file))
        key = (
            value.texture_key(), weight_count, value.fallback if tiled else None, relief,
            relief is not None and value.channel,
        )  # fmt: skip
        if key not in self.known:
            first = value.first_channel
            channels = tuple(range(first, min(first + 4, weight_count))) if weight_count else None

            def read(file: str) -> Texture:
                texture = read_texture(
                    file,
                    value.source_color_space,
                    value.scale,
                    value.bias,
                    "clamp" if tiled else value.wrap_s,
                    "clamp" if tiled else value.wrap_t,
                    rendering_space=self.rendering_space,
                    channels=channels,
                    max_mb=_texture_limit_mb(),
                )
                if relief == structs.INPUT_NORMAL:
                    return unit_normals(texture)
                if relief == structs.INPUT_BUMP:
                    return slopes(texture, _CHANNELS[value.channel])
                return texture

            self.known[key] = len(self.textures)
            if tiled:
                fallback = (0.0, 0.0, 0.0, 0.0) if weight_count else value.fallback
                files = tile_files(str(value.file))
                tiles = {place: read(file) for place, file in sorted(files.items())}
                self.textures.append(TiledTexture(str(value.file), tiles, fallback))
            else:
                self.textures.append(read(str(value.file)))
        return self.known[key]


def _upload(
    rows: list[MaterialRows],
    frame: SpectralFrame,
    wraps: tuple[float, ...],
    primvars: dict[str, int],
    device: str,
) -> Surfaces:
    target = structs.Materials()
    slots = _Slots(primvars, frame.color_space)
    slot = np.full((len(rows), structs.INPUT_COUNT), -1, np.int32)
    for m, row in enumerate(rows):
        for which, value in row.inputs.items():
            weighed = row.weighs and which in (structs.INPUT_BASE, structs.INPUT_BASE_HIGH)
            slot[m, which] = slots.add(value, len(row.bases) if weighed else 0, which)
            if which == structs.INPUT_NORMAL and isinstance(value, TextureInput):
                check_normal_map(value)
    lustre = _lustre_tables(rows)
    counts = np.array([len(row.rows) for row in rows], np.int32)
    spectra = np.concatenate([np.stack(row.rows) for row in rows])
    weights = xyz_weights(frame.wavelength_nm, frame.observer, frame.absolute)
    xyz = np.einsum("rcb,bx->xrc", spectra, weights)
    passage, passage_scale = _passages(rows)

    def ints(values: object) -> wp.array:
        return wp.array(np.asarray(values, np.int32), dtype=wp.int32, device=device)

    def floats(values: NDArray[Any], dtype: type) -> wp.array:
        return wp.array(np.ascontiguousarray(values, np.float32), dtype=dtype, device=device)

    target.kind = ints([row.kind for row in rows])
    target.row = ints(np.cumsum(counts) - counts)
    target.row_count = ints(counts)
    target.weight_count = ints([len(row.bases) for row in rows])
    target.wrap_set = ints([wraps.index(row.wrap) if row.wrap in wraps else 0 for row in rows])
    ranks = [0 if row.passage is None else len(row.passage.spectra) for row in rows]
    target.passage_rank = ints(ranks)
    target.passage = floats(passage, wp.float32)
    target.passage_scale = floats(passage_scale, wp.vec2f)
    limits = [0.0 if row.passage is None else row.passage.limit for row in rows]
    target.passage_limit = floats(np.array(limits), wp.float32)
    target.row_part = ints(np.concatenate([row_parts(row) for row in rows]))
    target.flags = ints([row.flags | PLAIN * _is_plain(row) for row in rows])
    target.constant = floats(np.stack([row.constant for row in rows]), wp.vec4f)
    target.lustre = floats(lustre, wp.vec3f)
    target.slot = ints(slot)
    target.slot_texture, target.slot_primvar = ints(slots.texture), ints(slots.primvar)
    target.slot_channel = ints(slots.channel)
    matrices = np.array(slots.matrix).reshape(-1, 2, 3)
    target.slot_matrix_u = floats(matrices[:, 0], wp.vec3f)
    target.slot_matrix_v = floats(matrices[:, 1], wp.vec3f)
    tiles = pack_tiles(slots.textures)
    packed = tiles.textures
    target.texture_tile = ints(tiles.table)
    target.texel = floats(packed.texels, wp.vec4f)
    target.texture_border = floats(packed.borders, wp.vec4f)
    target.texture_level = wp.array(packed.levels, dtype=wp.vec3i, device=device)
    target.texture_info = wp.array(packed.info, dtype=wp.vec3i, device=device)
    bands = spectra.shape[2]
    padded = np.zeros((4 * len(spectra), 4 * band_groups(bands)))
    padded[:, :bands] = spectra.reshape(-1, bands)
    target.band = floats(padded.reshape(len(padded), -1, 4), wp.vec4f)
    target.xyz_x, target.xyz_y, target.xyz_z = (floats(part, wp.vec4f) for part in xyz)
    white = illuminant("D65", frame.wavelength_nm)
    to_rgb = (
        xyz_weights(frame.wavelength_nm, frame.observer, False) @ xyz_to_rgb(frame.color_space).T
    )
    to_rgb = white[:, None] * to_rgb / (white @ to_rgb).mean()
    return Surfaces(target, int(counts.max()), tuple(row.bases @ to_rgb for row in rows))


def _is_plain(row: MaterialRows) -> bool:
    """Return whether a material is opaque and has no textures: smooth all over a triangle."""
    textured = any(isinstance(value, TextureInput) for value in row.inputs.values())
    clear = structs.INPUT_OPACITY in row.inputs or row.constant[structs.INPUT_OPACITY, 0] < 1.0
    return not textured and not clear


def _lustre_tables(rows: list[MaterialRows]) -> FloatArray:
    """Return the tables of all skins' lobes, and tell each material which one is its own."""
    skins = [row for row in rows if row.kind == SKIN and row.flags & GLOSSY]
    found = sorted({float(row.constant[structs.INPUT_SPECULAR, 0]) for row in skins})
    for row in skins:
        f0 = float(row.constant[structs.INPUT_SPECULAR, 0])
        row.constant[structs.INPUT_SPECULAR, 1:3] = found.index(f0), fresnel.index_of(f0)
    if not found:
        return np.zeros((1, *TABLE_SIZE, 3))
    return np.stack([dielectric_response(f0) for f0 in found])


def _passages(rows: list[MaterialRows]) -> tuple[FloatArray, FloatArray]:
    """Return the tables of all materials, padded, [materials, entries, rank], and their scales."""
    found = [row.passage for row in rows if row.passage is not None]
    entries = max([len(passage.table) for passage in found], default=1)
    rank = max([len(passage.spectra) for passage in found], default=1)
    tables, scales = np.zeros((len(rows), entries, rank)), np.zeros((len(rows), 2))
    scales[:, 0] = 1.0
    for m, row in enumerate(rows):
        if row.passage is None:
            continue
        table = row.passage.table
        tables[m, : len(table), : table.shape[1]] = table
        if row.passage.last > 0.0:
            scales[m] = row.passage.scale, (len(table) - 1) / row.passage.last
    return tables, scales
