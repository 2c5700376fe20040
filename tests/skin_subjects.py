"""Subjects for the virtual photographer of skin: a ball, and a head of bumps and hollows."""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import numpy as np
from pxr import Gf, Usd, UsdGeom, UsdShade, Vt

from usdskin.colorimetry import xyz_weights
from usdskin.illuminants import illuminant
from usdskin.judge.skin.scenes import define_lamp, direction_of, facing, lamp_irradiance
from usdskin.prims.skin import SkinParameters, write_skin
from usdskin.spectrum import SpectralQuantity, Spectrum

NM = np.arange(380.0, 781.0, 5.0)


def skin(*, wrap: float = 0.3, specular: float = 0.0) -> SkinParameters:
    """Return a skin: the shipped model's reflectance, and scattering that rises towards red."""
    text = resources.files("usdskin").joinpath("data", "skin_reference.csv").read_text("ascii")
    rows = [line for line in text.splitlines() if not line.startswith("#")]
    nm, reflectance, _ = np.array([row.split(",") for row in rows[1:]], dtype=np.float64).T
    return SkinParameters(
        alpha=0.75,
        wrap=wrap,
        reflectance=Spectrum(SpectralQuantity.REFLECTANCE, nm, reflectance),
        scattering=Spectrum(
            SpectralQuantity.SCATTERING, np.array([400.0, 580.0, 700.0]), np.array([0.2, 0.28, 0.6])
        ),
        specular_weight=specular,
    )


def write_subject(
    path: Path,
    material: SkinParameters,
    *,
    head: bool = False,
    mesh: Path | None = None,
    up: str = "Y",
) -> Path:
    """Write a stage with a subject of skin: a ball of 9 cm, our head, or an imported mesh."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, 0.01)
    if mesh is not None:
        shape = UsdGeom.Xform.Define(stage, "/Subject")
        shape.GetPrim().GetReferences().AddReference(str(mesh))
    elif head:
        shape = _head(stage)
    else:
        shape = UsdGeom.Sphere.Define(stage, "/Subject")
        shape.CreateRadiusAttr(9.0)
        shape.CreateExtentAttr([(-9.0, -9.0, -9.0), (9.0, 9.0, 9.0)])
        UsdGeom.Xformable(shape).AddTranslateOp().Set(Gf.Vec3d(3.0, -4.0, 5.0))
    prim = UsdShade.Material.Define(stage, "/Skin")
    write_skin(prim.GetPrim(), material, path.parent)
    binding = UsdShade.MaterialBindingAPI.Apply(shape.GetPrim())
    binding.Bind(prim, UsdShade.Tokens.strongerThanDescendants)
    stage.GetRootLayer().Save()
    return path


def _head(stage: Usd.Stage) -> UsdGeom.Mesh:
    """Define an egg with a nose, brows, eye sockets and a neck, 24 cm high."""
    rows, columns = 48, 64
    polar = np.linspace(0.0, np.pi, rows + 1)[1:-1]
    turn = np.arange(columns) * (2.0 * np.pi / columns)
    theta, phi = (part.ravel() for part in np.meshgrid(polar, turn, indexing="ij"))
    ring = np.stack([np.sin(theta) * np.sin(phi), np.cos(theta), np.sin(theta) * np.cos(phi)], -1)
    out = np.vstack([[0.0, 1.0, 0.0], ring, [0.0, -1.0, 0.0]])

    def bump(height: float, width: float, *toward: float) -> np.ndarray:
        middle = np.array(toward) / np.linalg.norm(toward)
        return height * np.exp((out @ middle - 1.0) / width**2)

    radius = 10.0 + bump(3.0, 0.18, 0.0, -0.1, 1.0) + bump(2.0, 0.4, 0.0, -0.7, 0.7)
    radius -= bump(1.2, 0.2, 0.4, 0.2, 1.0) + bump(1.2, 0.2, -0.4, 0.2, 1.0)
    radius += bump(1.0, 0.35, 0.0, 0.6, 0.8) - bump(1.5, 0.4, 0.0, -0.9, 0.1)
    points = out * radius[:, None] * np.array([0.85, 1.2, 1.0])
    mesh = UsdGeom.Mesh.Define(stage, "/Subject")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    counts, indices = _faces(rows - 1, columns)
    mesh.CreateFaceVertexCountsAttr(counts)
    mesh.CreateFaceVertexIndicesAttr(indices)
    mesh.CreateSubdivisionSchemeAttr("catmullClark")
    mesh.CreateExtentAttr([tuple(map(float, points.min(0))), tuple(map(float, points.max(0)))])
    return mesh


def _faces(rings: int, columns: int) -> tuple[list[int], list[int]]:
    counts, indices = [], []
    last = rings * columns + 1
    for k in range(columns):
        after = (k + 1) % columns
        counts.append(3)
        indices += [0, 1 + k, 1 + after]
        for row in range(rings - 1):
            above, below = 1 + row * columns, 1 + (row + 1) * columns
            counts.append(4)
            indices += [above + k, below + k, below + after, above + after]
        counts.append(3)
        bottom = 1 + (rings - 1) * columns
        indices += [last, bottom + after, bottom + k]
    return counts, indices


def write_lamp(path: Path, illuminance_lx: float = 2000.0) -> Path:
    """Write a stage with one lamp of illuminant D55, for a chart."""
    weights = xyz_weights(NM, absolute=True)[:, 1]
    light = lamp_irradiance(NM, illuminant("D55", NM), weights, illuminance_lx)
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    define_lamp(stage, "/Lamp", light, [facing(direction_of((20.0, 30.0), "Y"), "Y")], 6.0)
    stage.GetRootLayer().Save()
    return path
