"""Mesh files in, USD assets out.

Reads:  OBJ with its MTL (``obj``, our own reader); PLY, glTF, STL and OFF (``others``, through
        open3d, the extra ``mesh``).
Writes: ``asset.usda``, a component with a mesh and its skin material (``asset``).

In between is ``MeshFile``: polygons as the file has them, in the file's own units.
"""

from __future__ import annotations

from usdskin.meshfiles.asset import AssetOptions, write_asset
from usdskin.meshfiles.edit import (
    angle_weighted_normals,
    faces_where,
    keep_faces,
    keep_groups,
    triangulated,
    weld_points,
)
from usdskin.meshfiles.meshfile import FileMaterial, MeshFile
from usdskin.meshfiles.obj import read_obj
from usdskin.meshfiles.step import UNITS, import_mesh, read_mesh_file

__all__ = [
    "UNITS",
    "AssetOptions",
    "FileMaterial",
    "MeshFile",
    "angle_weighted_normals",
    "faces_where",
    "import_mesh",
    "keep_faces",
    "keep_groups",
    "read_mesh_file",
    "read_obj",
    "triangulated",
    "weld_points",
    "write_asset",
]
