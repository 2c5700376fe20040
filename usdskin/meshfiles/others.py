"""PLY, glTF, STL and OFF, through open3d."""

from __future__ import annotations

import re
from pathlib import Path

from usdskin.errors import MeshError
from usdskin.meshfiles.edit import weld_points
from usdskin.meshfiles.gltf import read_gltf
from usdskin.meshfiles.meshfile import MeshFile
from usdskin.meshfiles.through_open3d import damaged, from_open3d, load_open3d, quiet
from usdskin.notes import Note

SUFFIXES = (".ply", ".glb", ".gltf", ".stl", ".off")
"""File name endings this module reads."""

_MAGIC = {".ply": b"ply", ".glb": b"glTF"}


def read_with_open3d(path: Path, notes: list[Note]) -> MeshFile:
    """Read a PLY, glTF, STL or OFF file; polygons come as triangles.

    Points at one position are joined in glTF and STL files, which split them along seams.

    Raises:
        MeshError: The file is missing, damaged or without faces.
        UsdSkinError: open3d cannot be loaded.
    """
    suffix = path.suffix.lower()
    _check_file(path, suffix)
    open3d = load_open3d()
    with quiet(open3d):
        if suffix in (".glb", ".gltf"):
            mesh = read_gltf(open3d, path)
        else:
            try:
                found = open3d.io.read_triangle_mesh(str(path))
            except (MemoryError, RuntimeError) as error:
                raise damaged(path, str(error)) from None
            mesh = from_open3d(path, found, with_normals=suffix == ".ply")
    polygons = _ply_face_count(path) if suffix == ".ply" else mesh.face_count
    if polygons < mesh.face_count:
        what = f"its {polygons} polygons came as {mesh.face_count} triangles"
        notes.append(Note("polygons-cut", str(path), what))
    return mesh if suffix in (".ply", ".off") else weld_points(mesh)


def _check_file(path: Path, suffix: str) -> None:
    """Refuse what open3d would only grumble about on stderr."""
    try:
        with open(path, "rb") as file:
            head = file.read(4)
    except OSError as error:
        raise MeshError(f"{path}: cannot be read ({error.strerror}); check the name") from None
    if not head:
        raise MeshError(f"{path}: is empty; export the mesh again")
    if not head.startswith(_MAGIC.get(suffix, b"")):
        raise damaged(path, f"it does not begin like a {suffix[1:].upper()} file")


def _ply_face_count(path: Path) -> int:
    with open(path, "rb") as file:
        header = file.read(1 << 16).partition(b"end_header")[0]
    found = re.search(rb"^element\s+face\s+(\d{1,18})", header, re.MULTILINE)
    return int(found[1]) if found else 0
