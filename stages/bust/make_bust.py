"""Make the bust: ``python stages/bust/make_bust.py``.

A head, neck and shoulders by formula, from nobody's scan. Rings are drawn between a front and a
back profile, from the crown down to the chest, and closed at both ends; then nose, eyes, lips and
ears are pushed out of the surface. It is the cage of a Catmull-Clark surface, closed, in metres,
feet on y = 0, and a little uneven, so that a mirrored picture is another one.

Writes: ``bust.usda``. It is committed; run this after a change.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from usdskin.layers import write_layer

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, Vt

FloatArray = NDArray[np.float64]

FOLDER = Path(__file__).resolve().parent
AROUND = 80

PROFILE = np.array([
    # front y, front z, back y, back z, half width, squareness; the crown first, in centimetres
    (24.0, 0.5, 24.0, -0.5, 0.5, 2.0),
    (23.8, 3.0, 23.6, -3.0, 2.0, 2.0),
    (23.0, 5.6, 22.6, -6.0, 3.7, 2.0),
    (21.7, 7.6, 20.8, -8.2, 5.2, 2.0),
    (19.9, 8.9, 18.2, -9.6, 6.35, 2.1),
    (18.0, 9.5, 15.4, -10.1, 7.1, 2.2),
    (16.0, 9.8, 12.8, -10.0, 7.5, 2.3),
    (14.2, 9.9, 10.6, -9.4, 7.45, 2.3),
    (12.6, 9.3, 8.6, -8.5, 7.35, 2.25),
    (11.0, 9.5, 6.8, -7.6, 7.2, 2.2),
    (9.4, 9.7, 5.2, -6.8, 6.95, 2.15),
    (7.8, 9.7, 3.8, -6.3, 6.6, 2.1),
    (6.2, 9.7, 2.6, -6.0, 6.2, 2.05),
    (4.6, 9.8, 1.4, -5.9, 5.8, 1.9),
    (3.2, 9.5, 0.4, -5.9, 5.5, 1.75),
    (2.0, 9.6, -0.6, -6.0, 5.2, 1.65),
    (0.9, 9.2, -1.6, -6.2, 5.0, 1.6),
    (0.4, 7.6, -2.6, -6.5, 5.0, 1.7),
    (-0.2, 5.6, -3.6, -6.9, 5.2, 2.0),
    (-1.6, 4.4, -4.6, -7.4, 5.4, 2.0),
    (-3.6, 3.9, -5.6, -8.1, 5.7, 2.0),
    (-5.6, 3.9, -6.6, -8.9, 6.6, 2.0),
    (-7.4, 4.6, -7.8, -9.8, 9.2, 2.1),
    (-9.0, 5.6, -9.2, -10.4, 13.4, 2.2),
    (-11.0, 6.8, -11.2, -10.8, 16.6, 2.3),
    (-14.0, 7.8, -14.2, -11.0, 18.4, 2.4),
    (-17.5, 8.4, -17.6, -10.8, 18.8, 2.5),
    (-18.2, 7.6, -18.2, -10.0, 17.6, 2.5),
    (-18.3, 1.0, -18.3, -1.0, 2.0, 2.0),
])  # fmt: skip
ROWS = 50
CHIN_M, BEHIND_M = 1.498, 0.045
"""Height of y = 0 of the profile, and its z = 0, in the shot [m]."""

# Centre x, y; widths x, y; push along z; all in centimetres, on the front.
FEATURES = (
    (3.2, 12.3, 1.75, 1.25, -1.5),  # sockets
    (-3.2, 12.3, 1.75, 1.25, -1.5),
    (3.2, 12.0, 1.05, 0.70, 1.15),  # eyes, closed
    (-3.2, 12.05, 1.05, 0.70, 1.15),
    (3.3, 14.4, 2.3, 0.65, 0.45),  # brows
    (-3.3, 14.45, 2.3, 0.65, 0.45),
    (3.1, 11.25, 1.3, 0.3, -0.4),  # lid creases
    (-3.1, 11.3, 1.3, 0.3, -0.4),
    (0.0, 12.6, 0.75, 1.2, 0.55),  # bridge
    (0.0, 10.2, 0.80, 1.5, 1.30),
    (0.05, 8.35, 0.85, 0.95, 1.75),  # tip
    (1.15, 7.9, 0.60, 0.60, 0.85),  # wings
    (-1.15, 7.95, 0.60, 0.60, 0.85),
    (0.0, 6.4, 0.45, 0.6, -0.18),  # groove above the lip
    (0.0, 5.45, 2.0, 0.50, 0.62),  # lips
    (0.0, 4.15, 1.75, 0.55, 0.66),
    (0.0, 4.82, 2.2, 0.30, -0.80),
    (0.0, 2.9, 1.9, 0.45, -0.35),  # below the lip
    (0.0, 1.2, 1.7, 1.0, 0.45),  # chin
    (4.7, 9.3, 1.9, 1.6, 0.35),  # cheeks
    (-4.6, 9.3, 1.9, 1.6, 0.35),
)


def spline(values: FloatArray, count: int) -> FloatArray:
    """Return rows in between by a monotone-ish cubic (Catmull-Rom), shape [count, ...]."""
    place = np.linspace(0.0, len(values) - 1.0, count)
    padded = np.concatenate([2 * values[:1] - values[1:2], values, 2 * values[-1:] - values[-2:-1]])
    index = np.minimum(place.astype(int), len(values) - 2)
    t = (place - index)[:, None]
    a, b, c, d = (padded[index + k] for k in range(4))
    cubic = 2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2
    return np.asarray(0.5 * (cubic + (3 * (b - c) + d - a) * t**3))


def angles() -> FloatArray:
    """Return turns from the front towards +X, closer together on the face, shape [AROUND]."""
    even = 2.0 * np.pi * np.arange(AROUND) / AROUND
    return np.asarray(even - 0.45 * np.sin(even))


def rings() -> FloatArray:
    """Return the points of the cage [cm], shape [ROWS, AROUND, 3]."""
    rows = spline(PROFILE, ROWS)
    front_y, front_z, back_y, back_z, half, square = (rows[:, [k]] for k in range(6))
    turn = angles()[None]
    power = 2.0 / np.maximum(square, 1.5)
    across = np.sign(np.sin(turn)) * np.abs(np.sin(turn)) ** power
    ahead = np.sign(np.cos(turn)) * np.abs(np.cos(turn)) ** power
    share = 0.5 * (1.0 + ahead)
    x = half * across
    y = back_y + share * (front_y - back_y)
    z = back_z + share * (front_z - back_z)
    # Shoulders slope down and away; the ring stays where the neck meets them.
    y = y - 0.012 * np.maximum(np.abs(x) - 6.0, 0.0) ** 2 * (y < -6.0) * (y > -17.0)
    return np.stack([x, y, z], axis=-1)


def cage() -> FloatArray:
    """Return the points with the features of a face [cm], shape [ROWS, AROUND, 3]."""
    points = rings()
    x, y, z = (points[..., k].copy() for k in range(3))
    is_front = np.clip((z - 3.0) / 3.0, 0.0, 1.0) * (np.cos(angles())[None] > 0.0)
    for across, up, wide, high, push in FEATURES:
        bell = np.exp(-0.5 * (((x - across) / wide) ** 2 + ((y - up) / high) ** 2))
        points[..., 2] += push * bell * is_front
    # Ears: a flange with a rim and a hollow, behind the jaw at the height of nose and brow.
    u, v = (z + 1.6 + 0.22 * (y - 10.0)) / 1.5, (y - 10.2) / 3.2
    reach = u**2 + v**2
    flap = 1.0 / (1.0 + np.exp(np.minimum(6.0 * (reach - 1.0), 50.0)))
    hollow = np.exp(-3.0 * ((u - 0.25) ** 2 + 0.8 * (v - 0.05) ** 2))
    side = np.sign(x) * (np.abs(x) > 4.5) * (y > 5.0) * (y < 15.5)
    points[..., 0] += side * (1.9 * flap * np.clip(0.75 - 0.6 * u, 0.15, 1.3) - 0.75 * hollow)
    points[..., 2] -= np.abs(side) * 0.7 * flap
    points[..., 0] += 0.08 * np.sin(0.35 * y) * (y > 0.0)
    return points


def mesh() -> tuple[FloatArray, list[list[int]], FloatArray]:
    """Return points [m], faces and st per point: a tube of quads, closed by a fan at each end."""
    grid = cage()
    flat = grid.reshape(-1, 3)
    ends = np.stack([grid[0].mean(axis=0), grid[-1].mean(axis=0)])
    points = np.concatenate([flat, ends]) * 0.01 + (0.0, CHIN_M, BEHIND_M)
    faces = []
    for i in range(ROWS - 1):
        for j in range(AROUND):
            a, b = i * AROUND + j, i * AROUND + (j + 1) % AROUND
            faces.append([a, a + AROUND, b + AROUND, b])
    top, bottom = len(flat), len(flat) + 1
    last = (ROWS - 1) * AROUND
    faces += [[top, j, (j + 1) % AROUND] for j in range(AROUND)]
    faces += [[bottom, last + (j + 1) % AROUND, last + j] for j in range(AROUND)]
    return points, faces, grid


def st(faces: list[list[int]]) -> FloatArray:
    """Return st of every corner: once round is 0 to 1, from the bottom to the crown 0 to 1."""
    result = []
    for number, face in enumerate(faces):
        rows = [1.0 - (index // AROUND) / (ROWS - 1.0) for index in face]
        column = number % AROUND
        if len(face) == 4:
            columns = [column, column, column + 1, column + 1]
        else:
            rows[0] = float(face[0] == ROWS * AROUND)
            is_top = rows[0] == 1.0
            columns = (
                [column + 0.5, column, column + 1] if is_top else [column + 0.5, column + 1, column]
            )
        result += [(c / AROUND, r) for c, r in zip(columns, rows, strict=True)]
    return np.array(result)


def main() -> None:
    """Write ``bust.usda``."""
    points, faces, _ = mesh()
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, UsdGeom.Tokens.y)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    stage.SetMetadata("documentation", "A bust by formula. Made by make_bust.py; change it there.")
    stage.SetDefaultPrim(UsdGeom.Xform.Define(stage, "/Bust").GetPrim())
    prim = UsdGeom.Mesh.Define(stage, "/Bust/mesh")
    rounded = np.round(points, 5)
    prim.CreatePointsAttr([Gf.Vec3f(*point) for point in rounded.tolist()])
    prim.CreateFaceVertexCountsAttr(Vt.IntArray([len(face) for face in faces]))
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray([index for face in faces for index in face]))
    extent = rounded.min(axis=0).tolist(), rounded.max(axis=0).tolist()
    prim.CreateExtentAttr([Gf.Vec3f(*corner) for corner in extent])
    prim.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.catmullClark)
    corners, index = np.unique(np.round(st(faces), 4), axis=0, return_inverse=True)
    primvar = UsdGeom.PrimvarsAPI(prim).CreatePrimvar(
        "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    primvar.Set([Gf.Vec2f(*corner) for corner in corners.tolist()])
    primvar.SetIndices(Vt.IntArray(index.ravel().tolist()))
    write_layer(stage, FOLDER / "bust.usda")


if __name__ == "__main__":
    main()
