"""Make the set of the strip: ``python stages/skin_tones/make_set.py``.

Writes: ``light.usda``, a DomeLight with ``SpectralLightAPI`` and a variant per lamp, its maps in
        ``light/``; ``ground.usda``, a sweep of grey paper, and ``ground.png``, its reflectance with
        the balls' shadows in it. All are committed; run this after a change.

The integrator ``map`` casts no shadows, so the ground's are computed here: the share of the light
that the balls leave over. A single lamp lights the room, so the shares are the same for every lamp.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.colorimetry import encode_srgb, illuminant, xyz_to_rgb, xyz_weights
from usdskin.image_output import write_png
from usdskin.images import Part, write_exr
from usdskin.layers import write_layer
from usdskin.prims import SpectralLight, write_spectral_light

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdLux

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
HEIGHT = 64
"""Rows of the maps; twice as many columns."""

WAVELENGTH_NM = np.arange(380.0, 731.0, 5.0)

LAMPS = {"daylight": "D55", "incandescent": "A", "fluorescent": "FL2"}
"""Illuminant of each variant."""

RADIUS_M, STEP_M, BALLS = 0.05, 0.112, 6
"""The balls of skin_tones.usda, side by side on y = 0."""

KEY, RIM = (-38.0, 42.0), (148.0, 30.0)
"""Azimuth from +Z towards +X and elevation of two softboxes [deg]; the camera is at +Z."""

PAPER = 0.13
"""Reflectance of the paper [1]."""

WIDTH_M, FRONT_M, BEND_M, BEND_RADIUS_M, TOP_M = 1.4, 0.30, -0.22, 0.30, 0.7
"""Its width, where it begins and begins to rise (in z), the radius of the rise, and its height."""

GROUND_PX = (512, 512)


def directions(height: int = HEIGHT) -> FloatArray:
    """Return the unit vector of each texel of a map, as UsdLux lays it out, shape [h, 2 h, 3]."""
    u = (np.arange(2 * height) + 0.5) / (2 * height)
    v = (np.arange(height) + 0.5) / height
    # u = 0.5 looks along +Z, u = 0.25 along +X, v = 0 up.
    azimuth = 2.0 * np.pi * (0.5 - u)[None, :]
    elevation = np.pi * (0.5 - v)[:, None]
    return np.stack(
        np.broadcast_arrays(
            np.cos(elevation) * np.sin(azimuth),
            np.sin(elevation),
            np.cos(elevation) * np.cos(azimuth),
        ),
        axis=2,
    )


def radiance(towards: FloatArray) -> FloatArray:
    """Return the room's radiance [relative], shape [h, w]: two softboxes, walls, the floor."""
    up = towards[..., 1]
    key = 9.0 * _softbox(towards, KEY, 0.30, 0.34)
    rim = 5.0 * _softbox(towards, RIM, 0.16, 0.42)
    wall = np.clip(towards @ _unit(82.0, 6.0), 0.0, 1.0) ** 2
    return key + rim + 0.04 + 0.14 * wall + 0.06 * np.clip(up, 0.0, 1.0)


def basis(lamp: str) -> FloatArray:
    """Return the lamp's spectrum with luminance 1, shape [1, band_count]."""
    row = illuminant(LAMPS[lamp], WAVELENGTH_NM)[None, :]
    return row / (row @ xyz_weights(WAVELENGTH_NM)[:, 1:2])


def centers() -> FloatArray:
    """Return where the balls are [m], shape [BALLS, 3]."""
    along = STEP_M * (np.arange(BALLS) - 0.5 * (BALLS - 1))
    return np.stack([along, np.full(BALLS, RADIUS_M), np.zeros(BALLS)], axis=1)


def profile(share: FloatArray | float) -> tuple[FloatArray, FloatArray]:
    """Return (y, z) of points and normals of the sweep by the share of its length, [..., 2]."""
    flat, turn = FRONT_M - BEND_M, 0.5 * np.pi * BEND_RADIUS_M
    length = flat + turn + TOP_M - BEND_RADIUS_M
    way = share * length
    angle = np.clip((way - flat) / BEND_RADIUS_M, 0.0, 0.5 * np.pi)
    z = FRONT_M - np.minimum(way, flat) - BEND_RADIUS_M * np.sin(angle)
    y = BEND_RADIUS_M * (1.0 - np.cos(angle)) + np.maximum(way - flat - turn, 0.0)
    return np.stack([y, z], axis=-1), np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def shade() -> FloatArray:
    """Return the share of the light that the balls leave to the ground, first row at the top."""
    columns, rows = GROUND_PX
    towards = directions(36)
    weight = radiance(towards) * np.sqrt(1.0 - towards[..., 1] ** 2)
    above = towards[..., 1] > 0.0
    towards, weight = towards[above].astype(np.float32), weight[above]
    x = WIDTH_M * ((np.arange(columns) + 0.5) / columns - 0.5)
    left = np.ones((rows, columns))
    for row, share in enumerate(1.0 - (np.arange(rows) + 0.5) / rows):
        (y, z), (up, ahead) = profile(share)
        light = np.maximum(towards @ np.float32([0.0, up, ahead]), 0.0) * weight
        point = np.stack(np.broadcast_arrays(x, y, z), axis=1).astype(np.float32)
        blocked = np.zeros((len(towards), columns), bool)
        for center in centers().astype(np.float32):
            to_center = center - point
            along = towards @ to_center.T
            blocked |= (along > 0.0) & ((to_center**2).sum(axis=1) - along**2 < RADIUS_M**2)
        left[row] -= light @ blocked / light.sum()
    return left


def light_stage() -> Usd.Stage:
    """Write the maps and return the layer of the light."""
    folder = FOLDER / "light"
    folder.mkdir(exist_ok=True)
    share = radiance(directions()).astype(np.float32)
    write_exr(folder / "coefficients.exr", [Part("light", {"c0": share}, sample_type="half")])
    stage = _stage("The strip's room under three lamps. Made by make_set.py; change it there.")
    dome = UsdLux.DomeLight.Define(stage, "/Light")
    stage.SetDefaultPrim(dome.GetPrim())
    dome.CreateTextureFormatAttr(UsdLux.Tokens.latlong)
    variants = dome.GetPrim().GetVariantSets().AddVariantSet("light")
    for name in LAMPS:
        variants.AddVariant(name)
        variants.SetVariantSelection(name)
        row = basis(name)
        color = (row @ xyz_weights(WAVELENGTH_NM)) @ xyz_to_rgb("lin_rec709_scene").T
        rgb = (share[..., None] * color).astype(np.float32)
        write_exr(folder / f"{name}.exr", [Part("", {"": rgb}, {}, "half", "lin_rec709_scene")])
        with variants.GetVariantEditContext():
            dome.CreateTextureFileAttr(Sdf.AssetPath(f"./light/{name}.exr"))
            light = SpectralLight(
                source="basis",
                coefficients_file=folder / "coefficients.exr",
                basis=row,
                basis_wavelength_nm=WAVELENGTH_NM,
            )
            write_spectral_light(dome.GetPrim(), light, FOLDER)
    variants.SetVariantSelection("daylight")
    return stage


def ground_stage() -> Usd.Stage:
    """Return the layer of the sweep, whose texture coordinates run along its profile."""
    stage = _stage("A sweep of grey paper. Made by make_set.py; change it there.")
    mesh = UsdGeom.Mesh.Define(stage, "/Ground")
    stage.SetDefaultPrim(mesh.GetPrim())
    share = np.linspace(0.0, 1.0, 49)
    line, normal = profile(share)
    sides = (-0.5 * WIDTH_M, 0.5 * WIDTH_M)
    points = [(x, float(y), float(z)) for y, z in np.round(line, 6) for x in sides]
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(mesh.GetPointsAttr().Get()))
    first = 2 * np.arange(len(share) - 1)
    mesh.CreateFaceVertexCountsAttr([4] * len(first))
    corners = np.stack([first, first + 1, first + 3, first + 2], axis=1)
    mesh.CreateFaceVertexIndicesAttr(corners.ravel().tolist())
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateNormalsAttr(
        [(0.0, float(y), float(z)) for y, z in np.round(normal, 6) for _side in sides]
    )
    mesh.SetNormalsInterpolation(UsdGeom.Tokens.vertex)
    st = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.vertex
    )
    st.Set([(u, float(v)) for v in np.round(share, 6) for u in (0.0, 1.0)])
    return stage


def main() -> None:
    """Write the layers and their textures."""
    write_layer(light_stage(), FOLDER / "light.usda")
    write_layer(ground_stage(), FOLDER / "ground.usda")
    encoded = np.round(255.0 * encode_srgb(PAPER * shade())).astype(np.uint8)
    write_png(FOLDER / "ground.png", np.repeat(encoded[..., None], 3, axis=2))


def _stage(documentation: str) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory("set.usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = documentation
    return stage


def _unit(azimuth: float, elevation: float) -> FloatArray:
    a, e = np.radians([azimuth, elevation])
    return np.array([np.cos(e) * np.sin(a), np.sin(e), np.cos(e) * np.cos(a)])


def _softbox(
    towards: FloatArray, place: tuple[float, float], half_width: float, half_height: float
) -> FloatArray:
    """Return 1 in a rectangle that faces the middle, with soft edges, shape [h, w]."""
    axis = _unit(*place)
    right = np.cross([0.0, 1.0, 0.0], axis)
    right /= np.linalg.norm(right)
    up = np.cross(axis, right)
    ahead = np.maximum(towards @ axis, 1e-3)
    across, along = towards @ right / ahead, towards @ up / ahead
    inside = _edge(half_width - np.abs(across)) * _edge(half_height - np.abs(along))
    return inside * (towards @ axis > 0.0)


def _edge(inside: FloatArray, softness: float = 0.08) -> FloatArray:
    t = np.clip(0.5 + 0.5 * inside / softness, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


if __name__ == "__main__":
    main()
