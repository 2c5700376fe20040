"""What a mesh file holds, whichever format it came in."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import MeshError

FLOAT32_LIMIT = float(np.finfo(np.float32).max)
"""Largest coordinate a ``point3f`` can hold."""


@dataclass(frozen=True, slots=True, eq=False)
class FileMaterial:
    """What a mesh file says of a material: the part a ``UsdPreviewSurface`` can hold."""

    diffuse_color: tuple[float, float, float] | None = None
    """Linear RGB [1]; None where the file does not say."""

    diffuse_texture: Path | None = None
    """Picture of the diffuse color; it replaces the color above."""

    diffuse_pixels: NDArray[np.uint8] | None = None
    """That picture where it is inside the mesh file, top row first, shape [height, width, 3|4]."""

    diffuse_scale: tuple[float, float, float] = (1.0, 1.0, 1.0)
    """What the picture is multiplied with, linear RGB [1]."""

    opacity: float = 1.0
    """1 is opaque [1]."""

    ior: float | None = None
    """Index of refraction [1]."""

    roughness: float | None = None
    """GGX roughness before squaring, 0..1 [1]."""

    metallic: float | None = None
    """0..1 [1]."""


@dataclass(frozen=True, slots=True, eq=False)
class MeshFile:
    """Polygons as a file holds them: one index per corner for each of points, st and normals.

    All faces' corners follow one another, ``corner_count = sum(face_counts)``.
    """

    source: Path
    """File the mesh was read from."""

    points: NDArray[np.float64]
    """Positions [the file's unit], shape [point_count, 3]."""

    face_counts: NDArray[np.int32]
    """Corners of each face, 3 or more, shape [face_count]."""

    face_indices: NDArray[np.int32]
    """Point of each corner, shape [corner_count]."""

    st: NDArray[np.float64] | None = None
    """Texture coordinates, the origin at the picture's bottom left [1], shape [st_count, 2]."""

    st_indices: NDArray[np.int32] | None = None
    """Texture coordinate of each corner, shape [corner_count]."""

    normals: NDArray[np.float64] | None = None
    """Normals, not all of unit length in every file [1], shape [normal_count, 3]."""

    normal_indices: NDArray[np.int32] | None = None
    """Normal of each corner, shape [corner_count]."""

    colors: NDArray[np.float32] | None = None
    """Linear RGB of each point [1], shape [point_count, 3]."""

    groups: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Faces of each group; a face may be in several."""

    objects: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Faces of each object; a face is in at most one."""

    materials: dict[str, NDArray[np.int32]] = field(default_factory=dict)
    """Faces of each material; a face has at most one."""

    definitions: dict[str, FileMaterial] = field(default_factory=dict)
    """What the file says of the materials it names."""

    companions: tuple[Path, ...] = ()
    """Other files that were read for the mesh: material files and the pictures they name."""

    meters_per_unit: float | None = None
    """Length of the file's unit [m], where the format says; else None."""

    up_axis: str | None = None
    """``Y`` or ``Z``, where the format says; else None."""

    def __post_init__(self) -> None:
        """Take the arrays as read-only and check that they fit together."""
        self._freeze("points", np.float64, 3)
        self._freeze("face_counts", np.int32)
        self._freeze("face_indices", np.int32)
        for name, width in (("st", 2), ("normals", 3)):
            if getattr(self, name) is not None:
                self._freeze(name, np.float64, width)
        for name in ("st_indices", "normal_indices"):
            if getattr(self, name) is not None:
                self._freeze(name, np.int32)
        if self.colors is not None:
            self._freeze("colors", np.float32, 3)
        self._check()

    @property
    def face_count(self) -> int:
        """Number of polygons."""
        return len(self.face_counts)

    @property
    def face_starts(self) -> NDArray[np.int64]:
        """First corner of each face, shape [face_count]."""
        counts = self.face_counts.astype(np.int64)
        return np.cumsum(counts) - counts

    def _freeze(self, name: str, dtype: type, width: int = 0) -> None:
        value: NDArray[Any] = np.ascontiguousarray(getattr(self, name), dtype=dtype)
        if width and (value.ndim != 2 or value.shape[1] != width):
            raise ValueError(f"{name} has the shape {value.shape}, not [n, {width}]")
        if not width and value.ndim != 1:
            raise ValueError(f"{name} has the shape {value.shape}, not [n]")
        value = value.view()
        value.flags.writeable = False
        object.__setattr__(self, name, value)

    def _check(self) -> None:
        if not len(self.face_counts):
            raise MeshError(f"{self.source}: holds no faces; export the mesh with its polygons")
        if self.face_counts.min() < 3:
            raise MeshError(f"{self.source}: has a face with fewer than 3 corners; repair the mesh")
        corner_count = int(self.face_counts.sum(dtype=np.int64))
        if corner_count != len(self.face_indices):
            raise ValueError(f"{len(self.face_indices)} corners for counts of {corner_count}")
        self._check_indices("vertex", self.face_indices, len(self.points))
        if not (np.abs(self.points) <= FLOAT32_LIMIT).all():
            bad = int(np.flatnonzero(~(np.abs(self.points) <= FLOAT32_LIMIT).all(axis=1))[0])
            raise MeshError(
                f"{self.source}: vertex {bad} is at {_shown(self.points[bad])}; repair the mesh "
                "where it comes from"
            )
        self._check_pair("st", "texture coordinate")
        self._check_pair("normals", "normal")
        if self.colors is not None and len(self.colors) != len(self.points):
            raise ValueError(f"{len(self.colors)} colors for {len(self.points)} points")
        for subsets in (self.groups, self.objects, self.materials):
            for faces in subsets.values():
                if len(faces) and not 0 <= faces.min() <= faces.max() < self.face_count:
                    raise ValueError("a subset names a face that does not exist")

    def _check_pair(self, name: str, what: str) -> None:
        values = getattr(self, name)
        indices = self.st_indices if name == "st" else self.normal_indices
        if (values is None) != (indices is None):
            raise ValueError(f"{name} without indices, or the other way round")
        if values is None or indices is None:
            return
        if len(indices) != len(self.face_indices):
            raise ValueError(f"{len(indices)} {name} indices for {len(self.face_indices)} corners")
        self._check_indices(what, indices, len(values))
        if not np.isfinite(values).all():
            bad = int(np.flatnonzero(~np.isfinite(values).all(axis=1))[0])
            raise MeshError(
                f"{self.source}: {what} {bad} is {_shown(values[bad])}; repair the mesh where it "
                "comes from"
            )

    def _check_indices(self, what: str, indices: NDArray[np.int32], count: int) -> None:
        wrong = (indices < 0) | (indices >= count)
        if wrong.any():
            corner = int(np.flatnonzero(wrong)[0])
            face = int(np.searchsorted(np.cumsum(self.face_counts), corner, side="right"))
            raise MeshError(
                f"{self.source}: face {face} refers to {what} {int(indices[corner])} of {count}; "
                "the file is damaged or cut short"
            )


def _shown(row: NDArray[np.float64]) -> str:
    return "(" + ", ".join(f"{value:g}" for value in row) + ")"
