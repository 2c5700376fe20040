"""Make the office that the proof is shot in: ``python stages/room_fluorescent/make_set.py``.

A room of 6.4 x 6.6 x 2.8 m with four bare fluorescent tubes (CIE FL2) hung below a white ceiling, a
desk, a cabinet and a sofa. Reflectances of fabrics and wood paint are CIE test-colour samples
(CIE 13.3-1995, measured Munsell papers, through colour-science), which no chart of ours contains;
those of paint, concrete and wood are formulas in here.

Writes: ``set.usda``. It is committed; run this after a change.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from colour.quality.datasets import SDS_TCS
from numpy.typing import NDArray

from usdskin.colorimetry import color_matching_functions, illuminant, xyz_to_rgb, xyz_weights
from usdskin.layers import write_layer
from usdskin.prims import SpectralLight, write_spectral_light, write_spectrum
from usdskin.spectrum import SpectralQuantity, Spectrum

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

FloatArray = NDArray[np.float64]
Point = tuple[float, float, float]

FOLDER = Path(__file__).resolve().parent
WAVELENGTH_NM = np.arange(380.0, 781.0, 5.0)

LOW, HIGH = (-3.2, 0.0, -3.6), (3.2, 2.8, 3.0)
"""Corners of the room [m], +Y up; the floor is at 0."""

CAPTURE_POINT = (0.2, 1.45, 0.1)
TUBE_LUMINANCE = 9000.0  # cd m^-2, a T8 tube
TUBE_RADIUS, TUBE_LENGTH = 0.013, 1.2
TUBES = tuple((x, 2.45, z) for x in (-1.5, 1.6) for z in (-1.9, 1.3))

BOXES: dict[str, tuple[str, tuple[tuple[Point, Point], ...]]] = {
    "desk": (
        "oak",
        (
            ((0.6, 0.70, -3.2), (2.4, 0.74, -2.3)),
            ((0.66, 0.0, -3.1), (0.72, 0.70, -2.4)),
            ((2.28, 0.0, -3.1), (2.34, 0.70, -2.4)),
        ),
    ),
    "screen": ("black", (((1.2, 0.78, -3.0), (1.9, 1.2, -2.95)),)),
    "cabinet": ("cabinet", (((-3.0, 0.0, -3.5), (-1.4, 1.9, -3.05)),)),
    "sofa": (
        "fabric",
        (
            ((2.2, 0.05, -0.6), (3.0, 0.42, 1.6)),
            ((2.8, 0.42, -0.6), (3.05, 0.85, 1.6)),
        ),
    ),
    "crate": ("cardboard", (((-2.6, 0.0, 1.5), (-2.0, 0.55, 2.1)),)),
    "poster": ("poster", (((-3.195, 1.0, -0.6), (-3.18, 1.9, 0.7)),)),
}
"""Furniture: material, and boxes by their low and high corners [m]."""


def sigmoid(edge_nm: float, width_nm: float) -> FloatArray:
    """Return a step up at a wavelength, shape [band_count]."""
    return np.asarray(1.0 / (1.0 + np.exp((edge_nm - WAVELENGTH_NM) / width_nm)))


def test_colour(name: str) -> FloatArray:
    """Return the reflectance of a CIE test-colour sample, shape [band_count]."""
    measured = SDS_TCS["CIE 1995"][name]
    return np.interp(WAVELENGTH_NM, measured.wavelengths, measured.values)


REFLECTANCES: dict[str, FloatArray] = {
    # Rutile absorbs below 410 nm; what is above is flat.
    "ceiling": 0.05 + 0.79 * sigmoid(400.0, 7.0),
    "wall": 0.05 + 0.50 * sigmoid(405.0, 9.0) + 0.14 * sigmoid(500.0, 35.0),
    "accent": test_colour("TCS05"),
    "floor": 0.10 + 0.12 * sigmoid(520.0, 60.0) + 0.06 * sigmoid(640.0, 40.0),
    "oak": 0.09 + 0.24 * sigmoid(560.0, 45.0) + 0.16 * sigmoid(640.0, 40.0),
    "black": np.full(WAVELENGTH_NM.size, 0.035),
    "cabinet": 0.05 + 0.57 * sigmoid(402.0, 8.0),
    "fabric": test_colour("TCS06"),
    "cardboard": test_colour("TCS02"),
    "poster": test_colour("TCS10"),
}


def rgb(spectrum: FloatArray) -> Gf.Vec3f:
    """Return a reflectance in daylight as linear Rec. 709, for tools that read no spectra."""
    light = illuminant("D65", WAVELENGTH_NM)
    weights = light[:, None] * color_matching_functions(WAVELENGTH_NM)
    xyz = spectrum @ weights / weights[:, 1].sum()
    return Gf.Vec3f(*np.clip(xyz_to_rgb("lin_rec709_scene") @ xyz, 0.0, 1.0).tolist())


def add_material(stage: Usd.Stage, name: str, reflectance: FloatArray) -> None:
    """Author a Lambertian material with its measured spectrum and a rendition."""
    material = UsdShade.Material.Define(stage, f"/Set/Materials/{name}")
    write_spectrum(
        material.GetPrim(),
        "reflectance",
        Spectrum(SpectralQuantity.REFLECTANCE, WAVELENGTH_NM, np.round(reflectance, 5)),
    )
    shader = UsdShade.Shader.Define(stage, f"/Set/Materials/{name}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(rgb(reflectance))
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    shader.CreateInput("specularColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0.0))
    shader.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
    output = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)


def add_mesh(
    stage: Usd.Stage, name: str, material: str, points: list[Point], faces: list[list[int]]
) -> None:
    """Author planar quads, whose normals point to where they are seen from."""
    mesh = UsdGeom.Mesh.Define(stage, f"/Set/Surfaces/{name}")
    mesh.CreatePointsAttr([Gf.Vec3f(*point) for point in points])
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([len(face) for face in faces]))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray([index for face in faces for index in face]))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    corners = np.array(points)
    mesh.CreateExtentAttr(
        [Gf.Vec3f(*corners.min(axis=0).tolist()), Gf.Vec3f(*corners.max(axis=0).tolist())]
    )
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(
        UsdShade.Material.Get(stage, f"/Set/Materials/{material}")
    )


BOX_FACES = {
    "-x": [0, 1, 3, 2],
    "+x": [4, 6, 7, 5],
    "-y": [0, 4, 5, 1],
    "+y": [2, 3, 7, 6],
    "-z": [0, 2, 6, 4],
    "+z": [1, 5, 7, 3],
}
"""Corners of a box's faces, counter-clockwise from outside; corner 4 i + 2 j + k is at x, y, z."""


def corners(low: Point, high: Point) -> list[Point]:
    """Return the corners of a box, numbered as ``BOX_FACES`` has them."""
    return [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1])
            for z in (low[2], high[2])]  # fmt: skip


def add_tube(stage: Usd.Stage, name: str, place: Point) -> None:
    """Author a tube along X: a Lambertian cylinder without caps."""
    lamp = UsdLux.CylinderLight.Define(stage, f"/Set/Lights/tubes/{name}")
    lamp.CreateRadiusAttr(TUBE_RADIUS)
    lamp.CreateLengthAttr(TUBE_LENGTH)
    lamp.AddTranslateOp().Set(Gf.Vec3d(*place))
    power = illuminant("FL2", WAVELENGTH_NM)
    power = power / (power @ xyz_weights(WAVELENGTH_NM, absolute=True)[:, 1])
    radiance = np.array([float(f"{value:.6g}") for value in TUBE_LUMINANCE * power])
    emission = Spectrum(SpectralQuantity.RADIANCE, WAVELENGTH_NM, radiance)
    light = SpectralLight(source="tabulated", emission=emission, units="absolute")
    write_spectral_light(lamp.GetPrim(), light)
    xyz = radiance @ xyz_weights(WAVELENGTH_NM, absolute=True)
    color = np.clip(xyz_to_rgb("lin_rec709_scene") @ (xyz / xyz[1]), 0.0, None)
    lamp.CreateColorAttr(Gf.Vec3f(*color.tolist()))


def main() -> None:
    """Write ``set.usda``."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetMetadata("documentation", "An office lit by four fluorescent tubes. See README.")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Set").GetPrim())
    for scope in ("Surfaces", "Materials", "Lights", "Lights/tubes"):
        UsdGeom.Scope.Define(stage, f"/Set/{scope}")
    for name, reflectance in REFLECTANCES.items():
        add_material(stage, name, reflectance)
    shell = {"floor": "-y", "ceiling": "+y", "wallLeft": "-x", "wallRight": "+x",
             "wallBack": "-z", "wallFront": "+z"}  # fmt: skip
    inks = {"floor": "floor", "ceiling": "ceiling", "wallRight": "accent"}
    points = corners(LOW, HIGH)
    for name, side in shell.items():
        face = BOX_FACES[side][::-1]  # seen from inside
        add_mesh(stage, name, inks.get(name, "wall"), [points[i] for i in face], [[0, 1, 2, 3]])
    for name, (material, boxes) in BOXES.items():
        all_points = [point for box in boxes for point in corners(*box)]
        faces = [[8 * index + i for i in face] for index in range(len(boxes))
                 for face in BOX_FACES.values()]  # fmt: skip
        add_mesh(stage, name, material, all_points, faces)
    for index, place in enumerate(TUBES):
        add_tube(stage, f"tube{index + 1}", place)
    point = UsdGeom.Xform.Define(stage, "/Set/CapturePoint")
    point.AddTranslateOp().Set(Gf.Vec3d(*CAPTURE_POINT))
    write_layer(stage, FOLDER / "set.usda")


if __name__ == "__main__":
    main()
