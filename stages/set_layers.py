"""What the scripts of the sets share: parts of a set's layer, and measured reflectances.

A set is what docs/sets.md says: planar quads with Lambertian reflectances, lamps with spectra in
absolute units, and the capture point. Reflectances are measured ones: ``reflectances.csv`` has
materials of the USGS Spectral Library, colour-science has CIE's Munsell papers. No estimator, prior
or chart of usdskin has seen them.
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
Quad = tuple[Point, Point, Point, Point]

WAVELENGTH_NM = np.arange(380.0, 781.0, 5.0)

_CORNERS = {
    "-x": (0, 1, 3, 2),
    "+x": (4, 6, 7, 5),
    "-y": (0, 4, 5, 1),
    "+y": (2, 3, 7, 6),
    "-z": (0, 2, 6, 4),
    "+z": (1, 5, 7, 3),
}
"""Corners of a box's faces, counter-clockwise from outside; corner 4 i + 2 j + k is at x, y, z."""


# --- Reflectances ------------------------------------------------------------------------------


def measured(sample: str) -> FloatArray:
    """Return a sample of ``reflectances.csv`` by its number there, shape [band_count]."""
    table = np.genfromtxt(Path(__file__).with_name("reflectances.csv"), delimiter=",", names=True)
    return np.asarray(table[sample], dtype=np.float64)


def munsell(number: int) -> FloatArray:
    """Return a test-colour sample of CIE 13.3-1995, a painted paper, shape [band_count]."""
    paper = SDS_TCS["CIE 1995"][f"TCS{number:02}"]
    return np.interp(WAVELENGTH_NM, paper.wavelengths, paper.values)


# --- Lamps -------------------------------------------------------------------------------------


def luminance(radiance: FloatArray) -> float:
    """Return the luminance of a radiance [cd m^-2], or the illuminance of an irradiance [lx]."""
    return float(radiance @ xyz_weights(WAVELENGTH_NM, absolute=True)[:, 1])


def lamp_radiance(name: str, candela_per_m2: float) -> FloatArray:
    """Return an illuminant of a luminance [W m^-2 sr^-1 nm^-1], shape [band_count]."""
    power = illuminant(name, WAVELENGTH_NM)
    return candela_per_m2 / luminance(power) * power


def add_light(
    stage: Usd.Stage,
    kind: type[UsdLux.BoundableLightBase],
    path: str,
    emission: FloatArray,
    quantity: SpectralQuantity = SpectralQuantity.RADIANCE,
) -> UsdLux.BoundableLightBase:
    """Author a lamp with a tabulated spectrum in absolute units, and its color for other tools."""
    lamp = kind.Define(stage, f"/Set/Lights/{path}")
    values = np.array([float(f"{value:.6g}") for value in emission])
    light = SpectralLight(
        source="tabulated", emission=Spectrum(quantity, WAVELENGTH_NM, values), units="absolute"
    )
    write_spectral_light(lamp.GetPrim(), light)
    xyz = values @ xyz_weights(WAVELENGTH_NM, absolute=True)
    color = np.clip(xyz_to_rgb("lin_rec709_scene") @ (xyz / xyz[1]), 0.0, None)
    lamp.CreateColorAttr(Gf.Vec3f(*np.round(color, 4).tolist()))
    return lamp


# --- Surfaces ----------------------------------------------------------------------------------


def box(
    low: Point, high: Point, sides: str = "-x +x -y +y -z +z", inside: bool = False
) -> list[Quad]:
    """Return faces of a box, seen from outside or from inside."""
    points = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1])
              for z in (low[2], high[2])]  # fmt: skip
    faces = []
    for side in sides.split():
        order = _CORNERS[side][::-1] if inside else _CORNERS[side]
        a, b, c, d = (points[index] for index in order)
        faces.append((a, b, c, d))
    return faces


def new_set(text: str, light_classes: tuple[str, ...], place: Point) -> Usd.Stage:
    """Return a stage with the scopes of a set and its capture point."""
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetMetadata("documentation", text)
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Set").GetPrim())
    scopes = ["Surfaces", "Materials", "Lights", *(f"Lights/{name}" for name in light_classes)]
    for scope in scopes:
        UsdGeom.Scope.Define(stage, f"/Set/{scope}")
    point = UsdGeom.Xform.Define(stage, "/Set/CapturePoint")
    point.AddTranslateOp().Set(Gf.Vec3d(*place))
    return stage


def add_material(stage: Usd.Stage, name: str, reflectance: FloatArray) -> None:
    """Author a Lambertian material with its spectrum and a rendition."""
    material = UsdShade.Material.Define(stage, f"/Set/Materials/{name}")
    spectrum = Spectrum(SpectralQuantity.REFLECTANCE, WAVELENGTH_NM, np.round(reflectance, 5))
    write_spectrum(material.GetPrim(), "reflectance", spectrum)
    daylight = illuminant("D65", WAVELENGTH_NM)[:, None] * color_matching_functions(WAVELENGTH_NM)
    xyz = reflectance @ daylight / daylight[:, 1].sum()
    color = np.clip(xyz_to_rgb("lin_rec709_scene") @ xyz, 0.0, 1.0)
    shader = UsdShade.Shader.Define(stage, f"/Set/Materials/{name}/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set(
        Gf.Vec3f(*np.round(color, 4).tolist())
    )
    shader.CreateInput("roughness", Sdf.ValueTypeNames.Float).Set(1.0)
    shader.CreateInput("specularColor", Sdf.ValueTypeNames.Color3f).Set(Gf.Vec3f(0.0))
    shader.CreateInput("useSpecularWorkflow", Sdf.ValueTypeNames.Int).Set(1)
    output = shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(output)


def add_surface(stage: Usd.Stage, name: str, material: str, quads: list[Quad]) -> None:
    """Author planar quads, whose normals point to where they are seen from."""
    mesh = UsdGeom.Mesh.Define(stage, f"/Set/Surfaces/{name}")
    points = np.round(np.array(quads).reshape(-1, 3), 6)
    mesh.CreatePointsAttr([Gf.Vec3f(*point) for point in points.tolist()])
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([4] * len(quads)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray(list(range(4 * len(quads)))))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    extent = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    mesh.CreateExtentAttr([Gf.Vec3f(*corner) for corner in extent])
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(
        UsdShade.Material.Get(stage, f"/Set/Materials/{material}")
    )


def write_set(
    stage: Usd.Stage,
    folder: Path,
    reflectances: dict[str, FloatArray],
    surfaces: dict[str, tuple[str, list[Quad]]],
) -> None:
    """Author materials and surfaces, and write ``set.usda``."""
    for name, reflectance in reflectances.items():
        add_material(stage, name, reflectance)
    for name, (material, quads) in surfaces.items():
        add_surface(stage, name, material, quads)
    write_layer(stage, folder / "set.usda")
