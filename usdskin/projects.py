"""New projects: a folder that renders as it is, to be changed piece by piece.

Writes: ``shot.usda``, which brings together ``subject.usda`` (the geometry), ``skin.usda`` (the
        material), ``light.usda`` (the light) and a camera, and a ``README.md`` that says how.
"""

from __future__ import annotations

import os
import shutil
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import LayerError, UsageError
from usdskin.layers import record_provenance, write_layer
from usdskin.meshfiles.asset import AssetOptions, write_asset
from usdskin.meshfiles.materials import write_material
from usdskin.meshfiles.meshfile import FileMaterial, MeshFile
from usdskin.replacing import check_place

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdShade

TEMPLATES = ("portrait", "sphere")
"""What the camera looks at: a stand-in for a head and shoulders, or a sphere."""

_SPECULAR = {"weight": 1.0, "roughness1": 0.45, "roughness2": 0.25, "mix": 0.35}

_QUADS_ACROSS = 20
"""Quads along an edge of the cube that the stand-in is bent from."""

_BUST_CM = np.array(
    [
        (0.0, 25.0), (4.5, 25.0), (7.7, 20.5), (7.7, 14.0), (6.6, 7.0), (5.0, 3.0), (5.3, -1.0),
        (7.5, -3.5), (14.0, -5.5), (19.0, -8.0), (19.0, -22.0), (0.0, -22.0),
    ]
)  # fmt: skip
"""Half width and height of a bust from the crown to the middle of its base [cm]."""


def new_project(directory: str | Path, template: str = "portrait") -> Path:
    """Write a project that renders as it is.

    Args:
        directory: Folder to make; it may exist if it is empty.
        template: One of ``TEMPLATES``.

    Returns:
        The stage to render, ``shot.usda`` in the folder. The folder is complete or not there.

    Raises:
        UsageError: The template is not known, or the folder holds something.
        UsdSkinError: The folder cannot be made or written to.
    """
    directory = Path(directory)
    if template not in TEMPLATES:
        raise UsageError(f"--template {template}: choose one of {', '.join(TEMPLATES)}")
    if directory.exists() and not directory.is_dir():
        raise UsageError(f"{directory}: is a file; name a folder that is new or empty")
    if directory.is_dir() and any(directory.iterdir()):
        raise UsageError(f"{directory}: is not empty; name a folder that is new or empty")
    check_place(directory)
    try:
        directory.parent.mkdir(parents=True, exist_ok=True)
        made = Path(tempfile.mkdtemp(prefix=f".{directory.name}.", dir=directory.parent))
    except OSError as error:
        raise LayerError(
            f"{directory}: cannot be made ({error.strerror}); choose another"
        ) from None
    try:
        _fill(made, template)
        made.chmod(0o755)
        # A folder takes the place of an empty one in a single step.
        os.replace(made, directory)
    except OSError as error:
        raise LayerError(
            f"{directory}: cannot be made ({error.strerror}); choose another"
        ) from None
    finally:
        shutil.rmtree(made, ignore_errors=True)
    return directory / "shot.usda"


def _fill(folder: Path, template: str) -> None:
    if template == "sphere":
        _write_sphere(folder / "subject.usda")
    else:
        _write_bust(folder / "subject.usda")
    _write_skin(folder / "skin.usda")
    height, distance = (0.0, 90.0) if template == "sphere" else (9.0, 115.0)
    shot = _SHOT.replace("HEIGHT", f"{height:g}").replace("DISTANCE", f"{distance:g}")
    for name, text in (("light.usda", _LIGHT), ("shot.usda", shot), ("README.md", _README)):
        with open(folder / name, "w", encoding="utf-8") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())


def _write_sphere(path: Path) -> None:
    stage = Usd.Stage.CreateInMemory(path.name)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    root = UsdGeom.Xform.Define(stage, "/Subject").GetPrim()
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind("component")
    sphere = UsdGeom.Sphere.Define(stage, "/Subject/sphere")
    sphere.CreateRadiusAttr(10.0)
    sphere.CreateExtentAttr([(-10.0, -10.0, -10.0), (10.0, 10.0, 10.0)])
    record_provenance(stage, "newProject", [], {"template": "sphere"}, path.parent)
    write_layer(stage, path)


def _write_bust(path: Path) -> None:
    points, faces = _cube_sphere(_QUADS_ACROSS)
    mesh = MeshFile(
        source=path,
        points=_bend(points),
        face_counts=np.full(len(faces), 4, dtype=np.int32),
        face_indices=faces.ravel(),
    )
    write_asset(
        mesh,
        path,
        AssetOptions(name="Subject", skin=()),
        settings={"template": "portrait"},
        inputs=(),
        step="newProject",
    )


def _cube_sphere(across: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
    """Return points on the surface of the cube [-1, 1]^3 and its quads, turned outwards."""
    quads = []
    row, column = np.meshgrid(np.arange(across), np.arange(across), indexing="ij")
    for axis in range(3):
        for side in (0, across):
            corners = np.zeros((across, across, 4, 3), dtype=np.int64)
            for k, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1))):
                corners[:, :, k, axis] = side
                corners[:, :, k, (axis + 1) % 3] = row + i
                corners[:, :, k, (axis + 2) % 3] = column + j
            quads.append(corners if side else corners[:, :, ::-1])
    lattice = np.concatenate([quad.reshape(-1, 3) for quad in quads])
    unique, which = np.unique(lattice, axis=0, return_inverse=True)
    return 2.0 * unique / across - 1.0, which.reshape(-1, 4).astype(np.int32)


def _bend(cube: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bend a cube's surface into a bust [cm], shape [point_count, 3].

    The angle from +Y runs along the profile by its length, the angle about +Y stays.
    """
    # Everitt's map of the cube on the sphere, which keeps the quads alike in size.
    x, y, z = (np.tan(cube * np.pi / 4.0)).T
    length = np.sqrt(x * x + y * y + z * z)
    profile = _rounded(_BUST_CM)
    steps = np.linalg.norm(np.diff(profile, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(steps)]) / steps.sum()
    place = np.arccos(np.clip(y / length, -1.0, 1.0)) / np.pi
    width = np.interp(place, along, profile[:, 0])
    height = np.interp(place, along, profile[:, 1])
    flat = np.hypot(x, z)
    # A head is deeper than wide, shoulders are wider than deep.
    shoulders = np.clip((2.0 - height) / 8.0, 0.0, 1.0)
    side = np.divide(x, flat, out=np.zeros_like(x), where=flat > 0.0)
    front = np.divide(z, flat, out=np.zeros_like(z), where=flat > 0.0)
    return np.stack(
        [side * width * (1.0 + 0.15 * shoulders), height, front * width * (1.2 - 0.65 * shoulders)],
        axis=1,
    )


def _rounded(line: NDArray[np.float64]) -> NDArray[np.float64]:
    """Cut the corners of a line until they are round, its ends staying (Chaikin 1974)."""
    for _ in range(5):
        near, far = 0.75 * line[:-1] + 0.25 * line[1:], 0.25 * line[:-1] + 0.75 * line[1:]
        cut = np.stack([near, far], axis=1).reshape(-1, line.shape[1])
        line = np.concatenate([line[:1], cut, line[-1:]])
    return line


def _write_skin(path: Path) -> None:
    stage = Usd.Stage.CreateInMemory(path.name)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    material = UsdShade.Material.Define(stage, "/Skin")
    prim = material.GetPrim()
    stage.SetDefaultPrim(prim)
    write_material(material, FileMaterial(), path, is_skin=True)
    for name, value in _SPECULAR.items():
        prim.GetAttribute(f"inputs:skin:specular:{name}").Set(value)
    record_provenance(stage, "newProject", [], {}, path.parent)
    write_layer(stage, path)


_LIGHT = """#usda 1.0
(
    defaultPrim = "Light"
    doc = "Two spectral lights. Any tool shows their color; usdskin renders their spectra."
    metersPerUnit = 0.01
    upAxis = "Y"
)

def Xform "Light"
{
    # Light from all around. Give it a map with inputs:spectral:source = "bands" or "basis", or
    # take the schema off and set inputs:texture:file to any latlong picture.
    def DomeLight "Fill" (
        prepend apiSchemas = ["SpectralLightAPI"]
    )
    {
        uniform token inputs:spectral:source = "blackbody"
        float inputs:colorTemperature = 6500
        bool inputs:enableColorTemperature = 1
        float inputs:intensity = 0.25
    }

    # A warm lamp, up on the left of the camera. Normalized: its intensity is its illuminance.
    def DistantLight "Key" (
        prepend apiSchemas = ["SpectralLightAPI"]
    )
    {
        uniform token inputs:spectral:source = "blackbody"
        float inputs:colorTemperature = 3200
        bool inputs:enableColorTemperature = 1
        float inputs:angle = 6
        float inputs:intensity = 2.5
        bool inputs:normalize = 1
        float3 xformOp:rotateXYZ = (-35, -40, 0)
        uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    }
}
"""

_SHOT = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 0.01
    renderSettingsPrimPath = "/Render/Main"
    upAxis = "Y"
)

def Xform "World"
{
    # The skin is bound to all of the subject. Take bindMaterialAs off, and the materials that the
    # mesh brings along are shown where it has some.
    def Xform "Subject" (
        prepend apiSchemas = ["MaterialBindingAPI"]
        prepend references = @./subject.usda@
    )
    {
        rel material:binding = </World/Skin> (
            bindMaterialAs = "strongerThanDescendants"
        )
    }

    def Material "Skin" (
        prepend references = @./skin.usda@
    )
    {
    }

    # Without a type of its own it is what light.usda holds: a DomeLight, or several lights.
    def "Light" (
        prepend references = @./light.usda@
    )
    {
    }

    # In a stage in centimetres, focal length and apertures are in millimetres.
    def Camera "Camera"
    {
        float focalLength = 85
        float horizontalAperture = 24
        float verticalAperture = 30
        float2 clippingRange = (1, 10000)
        double3 xformOp:translate = (0, HEIGHT, DISTANCE)
        uniform token[] xformOpOrder = ["xformOp:translate"]
    }
}

def Scope "Render"
{
    def RenderSettings "Main" (
        prepend apiSchemas = ["SkinRenderSettingsAPI"]
    )
    {
        rel camera = </World/Camera>
        uniform int2 resolution = (512, 640)
        uniform token renderingColorSpace = "lin_rec709_scene"
        uniform int usdskin:samplesPerPixel = 4
        uniform int usdskin:subdivisionLevel = 2
    }
}
"""

_README = """# A usdskin project

    usdskin render shot.usda            writes shot.exr and shot.png
    usdskin render shot.usda --spectral writes shot.spectral.exr too, 61 bands
    usdskin info shot.usda              shows what is in the stage
    usdskin validate shot.usda          checks it

| file | holds | replace it by |
|---|---|---|
| `subject.usda` | a stand-in shape | `usdskin import head.obj -o subject.usda --units cm` |
| `skin.usda` | the skin: spectra of reflectance and scattering, wrap, luster | your own material |
| `light.usda` | a dome and a lamp, both blackbodies | any layer with a DomeLight |
| `shot.usda` | the three together, a camera and render settings | |

The stage is in centimetres with Y up. Import meshes with the unit that they are in; USD does not
convert units, so a subject in metres needs `xformOp:scale = (100, 100, 100)` on `/World/Subject`.
"""
