"""Read small stages into scenes: no pictures, so that a test takes milliseconds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from usdskin.notes import Note
from usdskin.render.meshes import MeshArrays
from usdskin.render.opening import opened
from usdskin.render.overrides import RenderOverrides
from usdskin.render.scene import Scene, read_scene
from usdskin.render.settings import resolve_settings

# isort: split
# After ours, which register the schemas.
from pxr import Usd

HEAD = """#usda 1.0
(
    {metadata}
)
def Camera "Camera"
{{
}}
def DomeLight "Sky"
{{
}}
"""

TRIANGLE = """int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]
    uniform token subdivisionScheme = "none"
"""


def prim(kind: str, name: str, *parts: str, metadata: str = "") -> str:
    """Return a prim in usda; ``parts`` are its properties and children."""
    body = "\n    ".join(parts)
    return f'def {kind} "{name}" ({metadata})\n{{\n    {body}\n}}\n'


def triangle(name: str, *parts: str, metadata: str = "") -> str:
    """Return a triangle in the plane z = 0, its normal along +Z, with area 1/2."""
    return prim("Mesh", name, TRIANGLE, *parts, metadata=metadata)


def write_stage(folder: Path, *prims: str, metadata: str = "metersPerUnit = 1") -> Path:
    """Write a stage with a camera and a sky."""
    path = folder / "shot.usda"
    path.write_text(HEAD.format(metadata=metadata) + "\n".join(prims))
    return path


def read_stage(
    path: Path, number: float | None = None, base: float | None = None, **flags: object
) -> tuple[Scene, list[Note]]:
    """Return a stage's scene at a frame, or while its shutter is open, and the notes of it."""
    notes: list[Note] = []
    overrides = RenderOverrides(frames=None if number is None else [number], **flags)  # type: ignore[arg-type]
    with opened(path, overrides, notes) as stage:
        job = resolve_settings(stage, overrides, Path("o.exr"), notes)
        frame = None if base is None else Usd.TimeCode(base)
        scene = read_scene(stage, job.frames[0].time, job.settings, notes, base=frame)
    return scene, notes


def read_text(folder: Path, *prims: str, **flags: object) -> tuple[Scene, list[Note]]:
    """Write a stage in metres and read it."""
    return read_stage(write_stage(folder, *prims), **flags)  # type: ignore[arg-type]


def mesh_named(scene: Scene, path: str) -> MeshArrays:
    """Return the mesh of a path."""
    (mesh,) = [mesh for mesh in scene.meshes if mesh.path == path]
    return mesh


def paths(scene: Scene) -> list[str]:
    """Return the paths of all meshes."""
    return [mesh.path for mesh in scene.meshes]


def codes(notes: list[Note]) -> list[str]:
    """Return the codes of notes."""
    return [note.code for note in notes]


def corner_points(mesh: MeshArrays) -> np.ndarray:
    """Return the corners of the triangles [m], shape [triangle_count, 3, 3]."""
    return mesh.points[mesh.triangles]


def facing(mesh: MeshArrays) -> np.ndarray:
    """Return the direction that the first triangle's winding faces, of length 1."""
    a, b, c = corner_points(mesh)[0]
    cross = np.cross(b - a, c - a)
    return cross / np.linalg.norm(cross)
