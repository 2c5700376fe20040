"""open3d, loaded where something needs it, and meshes to it and from it.

It is the extra ``mesh``: 0.9 GB installed, and it needs glibc 2.35 and some system libraries.
"""

from __future__ import annotations

import os
import platform
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from usdskin.colorimetry import decode_srgb
from usdskin.errors import MeshError, UsdSkinError
from usdskin.meshfiles.edit import unique_rows
from usdskin.meshfiles.meshfile import MeshFile

_GLIBC_NEEDED = (2, 35)
_SYSTEM_PACKAGES = "libegl1 libgl1 libgomp1 libidn2-0 libudev1 libusb-1.0-0 libx11-6"
"""Debian and Ubuntu packages of the libraries that open3d 0.20 is linked with."""


def load_open3d() -> Any:
    """Return the module open3d.

    Raises:
        UsdSkinError: It is not installed or cannot be loaded; the message names what to install.
    """
    try:
        import open3d
    except (ImportError, OSError) as error:
        raise UsdSkinError(_why_missing(error)) from None
    return open3d


def _why_missing(error: Exception) -> str:
    task = "PLY, glTF, STL and OFF files, --decimate and --repair need open3d"
    name, version = platform.libc_ver()
    numbers = tuple(int(part) for part in re.findall(r"\d+", version)[:2])
    if name == "glibc" and numbers < _GLIBC_NEEDED:
        return (
            f"{task}, which needs glibc 2.35 (Debian 12, Ubuntu 22.04) and finds {version}; "
            "convert the mesh to OBJ, which needs no open3d"
        )
    if isinstance(error, ModuleNotFoundError) and error.name == "open3d":
        return f"{task}: pip install 'usdskin[mesh]'"
    reason = " ".join(str(error).split())
    return (
        f"{task}, which cannot be loaded ({reason}): "
        f"apt-get install {_SYSTEM_PACKAGES}; pip install 'usdskin[mesh]'"
    )


@contextmanager
def quiet(open3d: Any) -> Iterator[None]:
    """Keep open3d and the C libraries inside it off stderr."""
    level = open3d.utility.get_verbosity_level()
    open3d.utility.set_verbosity_level(open3d.utility.VerbosityLevel.Error)
    sys.stderr.flush()
    kept = os.dup(2)
    with tempfile.TemporaryFile() as sink:
        os.dup2(sink.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)
            open3d.utility.set_verbosity_level(level)


def to_open3d(open3d: Any, mesh: MeshFile) -> Any:
    """Return a mesh of triangles as open3d's, without its attributes."""
    return open3d.geometry.TriangleMesh(
        open3d.utility.Vector3dVector(mesh.points.copy()),
        open3d.utility.Vector3iVector(mesh.face_indices.reshape(-1, 3).copy()),
    )


def from_open3d(path: Path, found: Any, *, with_normals: bool, linear: bool = False) -> MeshFile:
    """Return open3d's mesh as ours.

    Args:
        path: File it was read from.
        found: ``open3d.geometry.TriangleMesh``.
        with_normals: Whether its normals are the file's.
        linear: Whether its colors are linear; else they are sRGB.

    Raises:
        MeshError: It has no triangles, or indices or positions that are wrong.
    """
    triangles = np.asarray(found.triangles, dtype=np.int32)
    if not len(triangles):
        raise damaged(path, "it holds no faces that open3d can read")
    corners = triangles.ravel()
    arrays: dict[str, Any] = {}
    if found.has_triangle_uvs():
        uvs = np.asarray(found.triangle_uvs, dtype=np.float64)
        first, which = unique_rows(uvs)
        arrays.update(st=uvs[first], st_indices=which.astype(np.int32))
    if with_normals and found.has_vertex_normals():
        arrays.update(normals=np.asarray(found.vertex_normals), normal_indices=corners)
    if found.has_vertex_colors():
        colors = np.asarray(found.vertex_colors, dtype=np.float64)
        arrays["colors"] = colors if linear else decode_srgb(colors)
    return MeshFile(
        source=path,
        points=np.asarray(found.vertices, dtype=np.float64),
        face_counts=np.full(len(triangles), 3, dtype=np.int32),
        face_indices=corners,
        **arrays,
    )


def damaged(path: Path, reason: str) -> MeshError:
    """Return the error for a file that cannot be read."""
    reason = " ".join(reason.split()) or "open3d gave no reason"
    return MeshError(f"{path}: cannot be read: {reason}; export the mesh again")
