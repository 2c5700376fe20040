"""Displacement: closed forms, the stage's units, and no cracks."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from test_scene import (
    SPHERE,
    TEXTURE,
    WHITE,
    here,  # noqa: F401  (a fixture)
    quad,
    render,
    skin,
    stage_text,
    surface,
)

from usdskin.image_output import Part, write_exr
from usdskin.images import read_image
from usdskin.render.detail import add_detail
from usdskin.render.gprims import read_gprim
from usdskin.render.inputs import PrimvarInput, TextureInput
from usdskin.render.materials import Displacement, display_material
from usdskin.render.mesh_limit import unit
from usdskin.render.mesh_tangents import names_of
from usdskin.render.meshes import MeshArrays, read_mesh
from usdskin.render.polygons import is_closed

from pxr import Sdf, Usd, UsdGeom  # isort: skip

pytestmark = pytest.mark.usefixtures("here")

NOW = Usd.TimeCode.Default()
IDENTITY = np.eye(4)


def moved(mesh: MeshArrays, amount, unit_m: float = 1.0) -> MeshArrays:
    """Return a mesh displaced by a material of its own."""
    displacement = Displacement(amount, unit_m)
    material = dataclasses.replace(display_material(), displacement=displacement)
    return add_detail(mesh, dict.fromkeys(mesh.material_paths, material), IDENTITY, [])


def height_map(values: np.ndarray, **options) -> TextureInput:
    """Write a height map and return the input that reads it."""
    pixels = {"Y": np.ascontiguousarray(values, np.float32)}
    write_exr(Path("h.exr"), [Part("", pixels, color_space="data")])
    modes = {"wrap_s": "repeat", "wrap_t": "clamp", **options}
    return TextureInput("h.exr", "r", "raw", **modes)


def shape(kind: str, **attributes) -> MeshArrays:
    """Return a shape of UsdGeom with st."""
    stage = Usd.Stage.CreateInMemory()
    prim = stage.DefinePrim("/Shape", kind)
    for name, value in attributes.items():
        prim.GetAttribute(name).Set(value)
    found = read_gprim(prim, NOW, IDENTITY, 0, ["st"], lambda prim: None, [])
    assert found is not None
    return found


def grid(columns: int = 64, size: float = 2.0) -> MeshArrays:
    """Return a square in the plane z = 0 about the origin, st from 0 to 1."""
    line = np.linspace(0.0, 1.0, columns + 1)
    s, t = (part.ravel() for part in np.meshgrid(line, line))
    index = np.arange((columns + 1) ** 2).reshape(columns + 1, -1)
    faces = np.stack([index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]], -1)
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Grid")
    points = np.stack([(s - 0.5) * size, (t - 0.5) * size, 0 * s], 1)
    mesh.GetPointsAttr().Set(points.tolist())
    mesh.GetFaceVertexCountsAttr().Set([4] * columns**2)
    mesh.GetFaceVertexIndicesAttr().Set(faces.ravel().tolist())
    mesh.GetSubdivisionSchemeAttr().Set("none")
    kind = Sdf.ValueTypeNames.TexCoord2fArray
    primvar = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar("st", kind, UsdGeom.Tokens.vertex)
    primvar.Set(np.stack([s, t], 1).tolist())
    found = read_mesh(mesh.GetPrim(), NOW, IDENTITY, 0, ["st"], lambda prim: None, [])
    assert found is not None
    return found


def smooth(mesh: MeshArrays) -> MeshArrays:
    """Return a plane with the plane's normal at every corner."""
    normals = np.broadcast_to(np.float32([0, 0, 1]), mesh.normals.shape).copy()
    return dataclasses.replace(mesh, normals=normals)


# --- Closed forms


def test_a_constant_moves_a_sphere_to_another_radius_and_leaves_its_normals():
    ball = shape("Sphere", radius=0.5)
    out = moved(ball, 0.25, 0.1)
    np.testing.assert_allclose(np.linalg.norm(out.points, axis=1), 0.525, atol=2e-7)
    np.testing.assert_allclose(out.normals, ball.normals, atol=2e-4)
    assert out.closed


def test_no_displacement_is_the_same_mesh():
    ball = shape("Sphere", radius=0.5)
    assert moved(ball, 0.0) is ball
    assert moved(ball, height_map(np.zeros((4, 4)))) is ball


def test_a_sinusoid_lifts_a_plane_and_tilts_its_normals():
    """z = A sin(2 pi m s) where the texture holds it, and the normal of its slope."""
    waves, depth, columns = 2, 0.1, 1024
    s = (np.arange(columns) + 0.5) / columns
    values = depth * np.sin(2.0 * np.pi * waves * s)
    plane = smooth(grid(128))
    out = moved(plane, height_map(np.tile(values, (1024, 1))))
    at = out.points[:, 0] / 2.0 + 0.5
    np.testing.assert_allclose(
        out.points[:, 2], depth * np.sin(2.0 * np.pi * waves * at), atol=5e-3 * depth
    )
    corner = out.points[out.triangles][..., 0] / 2.0 + 0.5
    slope = np.pi * waves * depth * np.cos(2.0 * np.pi * waves * corner)
    expected = np.stack([-slope, 0 * slope, np.ones_like(slope)], -1)
    expected = unit(expected.reshape(-1, 3)).reshape(expected.shape)
    inside = (np.abs(out.points[out.triangles][..., :2]) < 0.99).all(axis=-1)
    np.testing.assert_allclose(out.normals[inside], expected[inside], atol=3e-3)


def test_what_is_faceted_stays_faceted():
    box = shape("Cube", size=1.0)
    out = moved(box, 0.1)
    faces = np.cross(*(out.points[out.triangles[:, k]] - out.points[out.triangles[:, 0]]
                       for k in (1, 2)))  # fmt: skip
    faces /= np.linalg.norm(faces, axis=1, keepdims=True)
    np.testing.assert_allclose(out.normals, np.broadcast_to(faces[:, None], (12, 3, 3)), atol=1e-6)
    # A corner goes along its diagonal.
    np.testing.assert_allclose(np.abs(out.points), 0.5 + 0.1 / np.sqrt(3.0), atol=1e-6)


def test_a_primvar_displaces_by_its_values():
    plane = smooth(grid(8))
    lift = plane.primvars["st"][..., :1] * np.float32(0.3)
    plane = dataclasses.replace(plane, primvars={**plane.primvars, "lift": lift})
    out = moved(plane, PrimvarInput("lift", (0.7,)))
    np.testing.assert_allclose(out.points[:, 2], 0.3 * (out.points[:, 0] / 2 + 0.5), atol=1e-6)
    missing = moved(smooth(grid(8)), PrimvarInput("gone", (0.7,)))
    np.testing.assert_allclose(missing.points[:, 2], 0.7, atol=1e-6)


def test_scale_bias_and_transform_of_the_texture_count():
    """A ramp along s, read along t by a turned transform, times 2 minus 0.5."""
    ramp = np.tile((np.arange(64) + 0.5) / 64, (64, 1))
    turned = height_map(
        ramp,
        wrap_s="clamp",
        scale=(2.0, 2.0, 2.0, 1.0),
        bias=(-0.5, -0.5, -0.5, 0.0),
        st_matrix=np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0]]),
    )
    out = moved(smooth(grid(16)), turned)
    inside = np.abs(out.points[:, 1]) < 0.9
    expected = 2.0 * (out.points[:, 1] / 2.0 + 0.5) - 0.5
    np.testing.assert_allclose(out.points[inside, 2], expected[inside], atol=1e-5)


# --- Cracks


def test_a_seam_where_the_map_disagrees_does_not_open():
    """A ramp once around: 0 on one side of the seam, 1 on the other, the mean on it."""
    ball = shape("Sphere", radius=0.5)
    ramp = np.tile(np.linspace(0.0, 0.1, 128), (64, 1))
    out = moved(ball, height_map(ramp, wrap_s="clamp"))
    assert np.ptp(np.linalg.norm(out.points, axis=1)) > 0.05
    before, after = (names_of(m.points.astype(float)[m.triangles]) for m in (ball, out))
    pairs = np.unique(np.stack([before.ravel(), after.ravel()], 1), axis=0)
    assert len(pairs) == before.max() + 1  # what was in one place still is
    counts = np.full(len(out.triangles), 3)
    assert is_closed(counts, out.triangles.ravel().astype(np.intp), out.points.astype(float))


def test_seams_of_normals_and_of_split_vertices_do_not_open():
    """A cube whose triangles share no vertex, each side with its own map and normal."""
    box = shape("Cube", size=1.0)
    split = dataclasses.replace(
        box,
        points=box.points[box.triangles].reshape(-1, 3),
        triangles=np.arange(36, dtype=np.int32).reshape(12, 3),
    )
    out = moved(split, height_map(np.random.default_rng(3).random((8, 8)), wrap_s="clamp"))
    together = names_of(split.points.astype(float)[split.triangles])
    apart = names_of(out.points.astype(float)[out.triangles])
    assert together.max() == 7 == apart.max()
    assert is_closed(
        np.full(12, 3), out.triangles.ravel().astype(np.intp), out.points.astype(float)
    )


def test_two_materials_on_one_mesh_do_not_part():
    plane = smooth(grid(8))
    right = plane.points[plane.triangles][..., 0].mean(axis=1) > 0.0
    halves = dataclasses.replace(
        plane, material_slot=right.astype(np.int32), material_paths=("/Flat", "/High")
    )
    high = dataclasses.replace(display_material(), displacement=Displacement(0.2, 1.0))
    out = add_detail(halves, {"/Flat": display_material(), "/High": high}, IDENTITY, [])
    x, z = out.points[:, 0], out.points[:, 2]
    np.testing.assert_allclose(z[x < -0.01], 0.0, atol=1e-7)
    np.testing.assert_allclose(z[x > 0.01], 0.2, atol=1e-7)
    np.testing.assert_allclose(z[np.abs(x) < 0.01], 0.1, atol=0.03)


# --- Through the command

CARD = "rel material:binding = </Card_>"


def depths(text: str, unit_m: float = 1.0) -> np.ndarray:
    """Return the depth of every pixel [m]."""
    render(text.replace("metersPerUnit = 1", f"metersPerUnit = {unit_m}"), "--aov", "Z", "-p", "1")
    return read_image("shot.exr", part="Z").pixels[..., 0]


PUSHED = "token outputs:displacement.connect = </Card_/Surface.outputs:displacement>"


@pytest.mark.parametrize("unit_m", [1.0, 0.01])
@pytest.mark.parametrize("scheme", ["none", "catmullClark"])
def test_a_previews_displacement_is_in_stage_units_and_a_skins_in_metres(unit_m, scheme):
    card = quad("Card", CARD).replace('Scheme = "none"', f'Scheme = "{scheme}"')
    card = card.replace("-1, -1, 0.0", "-9, -9, 0.0").replace("1, -1, 0.0", "9, -9, 0.0")
    body = "float inputs:displacement = 0.5\n token outputs:displacement"
    preview = surface("Card_", body, attributes=PUSHED)
    np.testing.assert_allclose(depths(stage_text(WHITE, preview, card), unit_m)[8, 16],
                               9.5 * unit_m, rtol=1e-6)  # fmt: skip
    pixels = {"Y": np.full((4, 4), 0.75, np.float32)}
    write_exr(Path("h.exr"), [Part("", pixels, color_space="data")])
    own = skin(
        "asset inputs:skin:displacement:file = @./h.exr@\n"
        "    float inputs:skin:displacement:scale = 0.004\n"
        "    float inputs:skin:displacement:midLevel = 0.25",
        name="Card_",
    )
    np.testing.assert_allclose(depths(stage_text(WHITE, own, card), unit_m)[8, 16],
                               10.0 * unit_m - 0.002, rtol=1e-6)  # fmt: skip


def test_a_sphere_displaced_by_a_texture_shows_a_larger_disc():
    pixels = {"Y": np.full((4, 4), 0.5, np.float32)}
    write_exr(Path("h.exr"), [Part("", pixels, color_space="data")])
    texture = TEXTURE.format(file="./h.exr", material="Card_")
    body = "float inputs:displacement.connect = </Card_/Picture.outputs:r>"
    texture = texture.replace("float3 outputs:rgb", "float outputs:r")
    ball = SPHERE.replace("Ball_", "Card_").replace("0.9", "0.3")
    found = render(stage_text(WHITE, surface("Card_", body, texture, attributes=PUSHED), ball))
    assert found[..., 3].mean() == pytest.approx(np.pi * 0.8**2 / 4.0, abs=0.01)
    flat = render(stage_text(WHITE, surface("Card_", body, texture), ball))
    assert flat[..., 3].mean() == pytest.approx(np.pi * 0.3**2 / 4.0, abs=0.01)


def test_a_displaced_normal_mapped_mesh_is_read_whole():
    """Frames are laid over the displaced surface."""
    plane = smooth(grid(32))
    ramp = height_map(np.tile((np.arange(64) + 0.5) / 64, (64, 1)), wrap_s="clamp")
    material = dataclasses.replace(
        display_material(), displacement=Displacement(ramp, 2.0), normal=(0.1, 0.0, 1.0)
    )
    out = add_detail(plane, {None: material}, IDENTITY, [])
    ((rows),) = out.frames.values()
    inside = (np.abs(out.points[out.triangles][..., 0]) < 0.9).all(axis=-1)
    expected = np.array([1.0, 0.0, 1.0]) / np.sqrt(2.0)
    np.testing.assert_allclose(rows[0][inside][..., :3].mean(axis=(0, 1)), expected, atol=1e-3)
