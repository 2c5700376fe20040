"""Make the forearm's mesh, texture and room: ``python stages/forearm/make_forearm.py``.

Writes: ``mesh.usda``, ``albedo.png`` and ``room.exr``. All are committed; run this after a change.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.images import Part, write_exr, write_png
from usdskin.layers import write_layer

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, Vt

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
LENGTH_M = 0.24
AROUND, ALONG = 28, 26
"""Faces of the patch around and along the arm."""

TURN = np.radians(250.0)
"""How much of the way around the patch covers: the underside is left out."""

TEXTURE_SIZE = (320, 448)
ROOM_HEIGHT = 64


def surface(u: FloatArray, v: FloatArray) -> FloatArray:
    """Return positions [m] on the arm, which lies along X, the elbow at -X and the back up.

    Args:
        u: Around, 0..1 from the far side over the back to the near side.
        v: Along, 0..1 from elbow to wrist.
    """
    turn = TURN * (u - 0.5)
    # The muscle's belly lies in the elbow's half; the wrist is flatter than it is wide.
    swell = np.exp(-(((v - 0.22) / 0.30) ** 2))
    wide = 0.0275 + 0.0150 * swell + 0.0025 * (1.0 - v)
    high = 0.0195 + 0.0170 * swell + 0.0035 * (1.0 - v)
    # Radius and ulna: two low ridges towards the wrist.
    ridge = 0.0016 * v**2 * (np.cos(turn - 0.75) ** 24 + 0.8 * np.cos(turn + 0.95) ** 24)
    x = LENGTH_M * (v - 0.5)
    bend = -0.018 * (2.0 * v - 1.0) ** 2
    return np.stack(
        [x, (high + ridge) * np.cos(turn) + bend, (wide + ridge) * np.sin(turn)], axis=-1
    )


def thickness(u: FloatArray, v: FloatArray) -> FloatArray:
    """Return how thick the sheet of skin is [m]: thin at its long edges, so that they glow."""
    edge = np.minimum(u, 1.0 - u)
    return 0.0006 + 0.0074 * np.clip(edge / 0.16, 0.0, 1.0) ** 1.5 * np.ones_like(v)


def albedo() -> NDArray[np.uint8]:
    """Return the skin's color, sRGB, shape [height, width, 3]: mottled, with veins and freckles."""
    width, height = TEXTURE_SIZE
    random = np.random.default_rng(11)
    t, s = np.mgrid[0:height, 0:width].astype(float)
    s, t = (s + 0.5) / width, 1.0 - (t + 0.5) / height
    mottle = sum(_clouds(s * 6.0 * 2**k, t * 8.0 * 2**k, random) * 0.6**k for k in range(4))
    # Divided by what alpha (1 + (1 + l) Ss) makes of it, so that the room sees the color meant.
    color = np.array([0.47, 0.305, 0.225]) / np.array([1.17, 1.03, 0.96])
    color = color * np.exp(mottle[..., None] * np.array([0.035, 0.075, 0.08]))
    # The back of the arm has seen more sun than its sides.
    sun = np.exp(-(((s - 0.5) / 0.28) ** 2))[..., None]
    color *= 1.0 - sun * np.array([0.10, 0.17, 0.22])
    vein = np.zeros_like(s)
    for start, slope, wave in ((0.34, 0.10, 0.030), (0.47, -0.16, 0.022), (0.66, 0.05, 0.026)):
        path = start + slope * (t - 0.5) + wave * np.sin(9.0 * t + 20.0 * start)
        path += 0.010 * np.sin(31.0 * t + 7.0 * start)
        vein += 0.6 * np.exp(-(((s - path) / 0.015) ** 2)) * _ramp(0.15, 0.55, t)
    color *= 1.0 - np.clip(vein, 0.0, 1.0)[..., None] * np.array([0.20, 0.075, 0.03])
    spots = np.zeros_like(s)
    for _ in range(70):
        at = random.uniform(0.0, 1.0, 2)
        size = random.uniform(0.003, 0.008)
        reach = ((s - at[0]) / size) ** 2 + ((t - at[1]) * height / width / size) ** 2
        spots = np.maximum(spots, np.exp(-reach) * random.uniform(0.2, 0.9))
    color *= 1.0 - spots[..., None] * np.array([0.22, 0.34, 0.40])
    encoded = np.where(color <= 0.0031308, 12.92 * color, 1.055 * color ** (1.0 / 2.4) - 0.055)
    return np.rint(255.0 * np.clip(encoded, 0.0, 1.0)).astype(np.uint8)


def room() -> NDArray[np.float32]:
    """Return an office as linear RGB, latlong: ceiling panels, pale walls, a brown floor."""
    v, u = np.mgrid[0:ROOM_HEIGHT, 0 : 2 * ROOM_HEIGHT].astype(float)
    azimuth = 2.0 * np.pi * (0.5 - (u + 0.5) / (2 * ROOM_HEIGHT))
    elevation = np.pi * (0.5 - (v + 0.5) / ROOM_HEIGHT)
    wall = np.array([0.30, 0.28, 0.25]) * (0.8 + 0.3 * np.cos(azimuth - 0.6))[..., None]
    floor = np.array([0.10, 0.075, 0.055]) * np.ones_like(wall)
    ceiling = np.array([0.42, 0.41, 0.40]) * np.ones_like(wall)
    up = _ramp(0.42, 0.50, elevation)[..., None]
    down = _ramp(-0.20, -0.28, elevation)[..., None]
    color = wall * (1.0 - up) * (1.0 - down) + ceiling * up + floor * down
    # Where a ray meets the ceiling, 1.6 m above the arm: rows of panels 0.6 m x 1.2 m.
    reach = 1.6 / np.tan(np.maximum(elevation, 1e-3))
    x, z = reach * np.sin(azimuth), reach * np.cos(azimuth)
    panel = np.zeros_like(x)
    for middle_x, middle_z in ((-1.5, -1.4), (1.1, -1.4), (-1.5, 1.2)):
        inside = np.maximum(np.abs(x - middle_x) / 0.6, np.abs(z - middle_z) / 0.3)
        panel += _ramp(1.15, 0.85, inside)
    color += np.where(elevation > 0.1, panel, 0.0)[..., None] * np.array([13.0, 13.0, 12.6])
    return color.astype(np.float32)


def main() -> None:
    """Write all three."""
    write_png(FOLDER / "albedo.png", albedo())
    part = Part("", {"": room()}, {}, "half", "lin_rec709_scene")
    write_exr(FOLDER / "room.exr", [part])
    write_layer(mesh_stage(), FOLDER / "mesh.usda")


def mesh_stage() -> Usd.Stage:
    """Return a stage with the patch."""
    u, v = np.meshgrid(np.linspace(0.0, 1.0, AROUND + 1), np.linspace(0.0, 1.0, ALONG + 1))
    corner = np.arange((AROUND + 1) * (ALONG + 1)).reshape(ALONG + 1, AROUND + 1)
    faces = np.stack([corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]], axis=-1)
    st = np.stack([u, v], axis=-1).reshape(-1, 2)
    stage = Usd.Stage.CreateInMemory("mesh.usda")
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.GetRootLayer().documentation = "A forearm. Made by make_forearm.py; change it there."
    mesh = UsdGeom.Mesh.Define(stage, "/Forearm")
    stage.SetDefaultPrim(mesh.GetPrim())
    points = Vt.Vec3fArray.FromNumpy(_rounded(surface(u, v).reshape(-1, 3)))
    mesh.CreatePointsAttr(points)
    mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    mesh.CreateFaceVertexCountsAttr([4] * (AROUND * ALONG))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.catmullClark)
    mesh.CreateDoubleSidedAttr(True)
    primvars = UsdGeom.PrimvarsAPI(mesh)
    vertex = UsdGeom.Tokens.vertex
    primvars.CreatePrimvar("st", Sdf.ValueTypeNames.TexCoord2fArray, vertex).Set(
        Vt.Vec2fArray.FromNumpy(_rounded(st))
    )
    primvars.CreatePrimvar("skin:thickness", Sdf.ValueTypeNames.FloatArray, vertex).Set(
        Vt.FloatArray.FromNumpy(_rounded(thickness(u, v).ravel()))
    )
    return stage


def _rounded(values: FloatArray) -> NDArray[np.float32]:
    """Return float32 values that read well: a hundredth of a millimetre is enough."""
    return np.round(values, 5).astype(np.float32)


def _ramp(low: float, high: float, value: FloatArray) -> FloatArray:
    t = np.clip((value - low) / (high - low), 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)


def _clouds(x: FloatArray, y: FloatArray, random: np.random.Generator) -> FloatArray:
    """Return smooth noise with a knot at every whole number."""
    knots = random.normal(0.0, 1.0, (int(y.max()) + 2, int(x.max()) + 2))
    column, row = x.astype(int), y.astype(int)
    a, b = _ramp(0.0, 1.0, x - column), _ramp(0.0, 1.0, y - row)
    upper = knots[row, column] * (1.0 - a) + knots[row, column + 1] * a
    lower = knots[row + 1, column] * (1.0 - a) + knots[row + 1, column + 1] * a
    return upper * (1.0 - b) + lower * b


if __name__ == "__main__":
    main()
