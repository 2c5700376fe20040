"""Tiled (UDIM) textures: one picture for each unit square of texture coordinates.

Reads: files named ``<UDIM>``, where the tile of the square from (u, v) is 1001 + u + 10 v, u from 0
to 9. A lookup near the edge of a tile reads the tile beside it, so that no seam shows; where that
tile is missing, the edge itself. A square without a tile shows the fallback.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import DeviceError, LayerError
from usdskin.notes import Note
from usdskin.render.inputs import TextureInput
from usdskin.render.materials import SkinMaterial, SurfaceMaterial
from usdskin.render.memory import available_bytes
from usdskin.render.meshes import MeshArrays
from usdskin.render.textures import PackedTextures, Texture, Vector4, pack_textures

# isort: split
# After ours, which register the schemas.
from pxr import UsdShade

COLUMNS = 10
"""Tiles beside each other; the kernels' lookup counts on it."""

_FIRST = 1001
_LAST = 9999
_TEXEL_BYTES = 16
_INWARDS = 1e-3
_CUTS = 5


@dataclass(frozen=True, slots=True, eq=False)
class TiledTexture:
    """Pictures by tile."""

    path: str
    """File name that holds ``<UDIM>``."""

    tiles: Mapping[tuple[int, int], Texture]
    """Pictures by the corner (u, v) of their square."""

    fallback: Vector4 = (0.0, 0.0, 0.0, 1.0)
    """R, G, B, A where there is no tile."""


@dataclass(frozen=True, slots=True, eq=False)
class PackedTiles:
    """Textures, tiled ones among them, side by side in flat arrays."""

    textures: PackedTextures
    """The textures, then the tiles; ``info`` of a tiled texture is (minus the rows of its table,
    the table's first entry, 0), and its border is its fallback."""

    table: NDArray[np.int32]
    """Texture of each tile, row after row of ``COLUMNS``; -1 where there is none."""


def is_tiled(path: str) -> bool:
    """Return whether a file name stands for many tiles."""
    return "<UDIM>" in path


def tile_files(path: str) -> dict[tuple[int, int], str]:
    """Return the files of a tiled texture by the corner (u, v) of their square.

    Args:
        path: Resolved name that holds ``<UDIM>``, which may be inside a package.

    Raises:
        LayerError: There is no tile, or one is numbered beyond 9999.
    """
    found = {}
    for file, number in UsdShade.UdimUtils.ResolveUdimTilePaths(path, None):
        tile = int(number)
        if not _FIRST <= tile <= _LAST:
            raise LayerError(f"{file}: tile {number} is not in {_FIRST} to {_LAST}; rename it")
        found[(tile - _FIRST) % COLUMNS, (tile - _FIRST) // COLUMNS] = file
    if not found:
        raise LayerError(f"{path}: has no tile, such as 1001; restore the files or the path")
    return found


def pack_tiles(textures: Sequence[Texture | TiledTexture]) -> PackedTiles:
    """Return textures as flat arrays for a kernel; each keeps its index.

    Raises:
        DeviceError: They do not fit in memory.
        ImageError: There are more texels than 32-bit offsets reach.
    """
    flat: list[Texture] = []
    tiles: list[Texture] = []
    table: list[NDArray[np.int32]] = []
    info = {}
    entry = 0
    for index, texture in enumerate(textures):
        if isinstance(texture, Texture):
            flat.append(texture)
            continue
        rows = 1 + max(v for _, v in texture.tiles)
        part = np.full((rows, COLUMNS), -1, np.int32)
        for (u, v), picture in texture.tiles.items():
            part[v, u] = len(textures) + len(tiles)
            tiles.append(picture)
        flat.append(Texture(texture.path, (), "black", "black", texture.fallback))
        table.append(part.reshape(-1))
        info[index] = (-rows, entry, 0)
        entry += part.size
    _check_memory([*flat, *tiles])
    packed = pack_textures([*flat, *tiles])
    for index, values in info.items():
        packed.info[index] = values
    return PackedTiles(packed, np.concatenate(table) if table else np.zeros(0, np.int32))


def _check_memory(textures: Sequence[Texture]) -> None:
    """Refuse textures whose copies for the device do not fit beside them."""
    texels = sum(level.shape[0] * level.shape[1] for item in textures for level in item.levels)
    needed, there = texels * _TEXEL_BYTES, available_bytes()
    if there is not None and needed > there:
        raise DeviceError(
            f"the textures' {texels} texels need {needed / 2**30:.1f} GiB more and "
            f"{there / 2**30:.1f} GiB are free; make the textures smaller"
        )


def missing_tile_notes(
    meshes: Sequence[MeshArrays],
    materials: Sequence[SkinMaterial | SurfaceMaterial],
    index: Mapping[str | None, int],
) -> list[Note]:
    """Return a note for every tiled texture that lacks a tile which a mesh shows.

    Args:
        meshes: The meshes.
        materials: The materials.
        index: Index into ``materials`` by path.
    """
    notes = []
    for m, material in enumerate(materials):
        tiled = [
            value
            for value in material.inputs()
            if isinstance(value, TextureInput) and is_tiled(str(value.file))
        ]
        for texture in tiled:
            there = tile_files(str(texture.file)).keys()
            used = {tile: mesh.path for mesh in meshes for tile in _tiles(mesh, m, index, texture)}
            lost = sorted(used.keys() - there, key=lambda tile: (tile[1], tile[0]))
            if lost:
                u, v = lost[0]
                name = f"1001 {u:+d} {10 * v:+d}" if u < 0 or v < 0 else f"{_FIRST + u + 10 * v}"
                what = (
                    f"{texture.file}: {len(lost)} tiles that meshes show are missing, such as "
                    f"{name} on <{used[lost[0]]}>; the fallback is shown there"
                )
                notes.append(Note("udim-tile-missing", material.path, what))
    return list(dict.fromkeys(notes))


def _tiles(
    mesh: MeshArrays, material: int, index: Mapping[str | None, int], texture: TextureInput
) -> set[tuple[int, int]]:
    """Return the squares that the triangles of one material show."""
    slots = np.array([index[path] for path in mesh.material_paths]) == material
    st = mesh.primvars.get(texture.primvar)
    if st is None or st.shape[2] < 2 or not slots.any():
        return set()
    matrix = np.asarray(texture.st_matrix)
    corner = st[slots[mesh.material_slot], :, :2].astype(np.float64) @ matrix[:, :2].T
    corner = _halved(corner + matrix[:, 2])
    # A corner on the line between two squares belongs to that of its triangle.
    corner += _INWARDS * (corner.mean(axis=1, keepdims=True) - corner)
    cells = np.floor(corner.reshape(-1, 2))
    cells = cells[np.abs(cells).max(axis=1) < 1e6].astype(np.int64)
    return {(int(u), int(v)) for u, v in np.unique(cells, axis=0)}


def _halved(corner: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return triangles in the plane, the large ones cut until all fit into half a square."""
    for _ in range(_CUTS):
        wide = np.ptp(corner, axis=1).max(axis=1) > 0.5
        if not wide.any():
            break
        a, b, c = np.moveaxis(corner[wide], 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        cut = [np.stack(part, axis=1) for part in parts]
        corner = np.concatenate([corner[~wide], *cut])
    return corner
