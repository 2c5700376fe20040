"""Meshes as a renderer gets them: laws of winding, counts, normals, primvars and subsets."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdShade, Vt

import usdskin.schemas  # noqa: F401  (registers before the first stage)
from usdskin.errors import DeviceError, MeshError
from usdskin.render.meshes import read_mesh
from usdskin.render.polygons import area_vectors, triangulate

NOW = Usd.TimeCode.Default()
IDENTITY = np.eye(4)
CUBE_POINTS = list(itertools.product((-1.0, 1.0), repeat=3))
CUBE_FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]


def define(points, faces, scheme="none", **attributes):
    """Return a mesh of a new stage; attributes are set by their USD names."""
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/World/Mesh")
    mesh.CreatePointsAttr([Gf.Vec3f(*map(float, point)) for point in points])
    mesh.CreateFaceVertexCountsAttr([len(face) for face in faces])
    mesh.CreateFaceVertexIndicesAttr([int(v) for face in faces for v in face])
    if scheme is not None:
        mesh.CreateSubdivisionSchemeAttr(scheme)
    for name, value in attributes.items():
        mesh.GetPrim().GetAttribute(name).Set(value)
    mesh.stage = stage
    return mesh


def primvar(mesh, name, kind, interpolation, values, indices=None):
    made = UsdGeom.PrimvarsAPI(mesh).CreatePrimvar(name, kind, interpolation)
    made.Set(values)
    if indices is not None:
        made.SetIndices(Vt.IntArray(indices))
    return made


def read(mesh, names=(), level=0, to_world=IDENTITY, notes=None, materials=None, time=NOW):
    notes = [] if notes is None else notes
    bound = materials or (lambda prim: None)
    return read_mesh(mesh.GetPrim(), time, to_world, level, names, bound, notes)


def crosses(arrays):
    corner = arrays.points.astype(float)[arrays.triangles]
    return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])


def area(arrays):
    return 0.5 * np.linalg.norm(crosses(arrays), axis=1).sum()


def volume(arrays):
    corner = arrays.points.astype(float)[arrays.triangles]
    return np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0


def codes(notes):
    return [note.code for note in notes]


# Winding and transforms


@pytest.mark.parametrize("scheme", ["none", "catmullClark", "loop", "bilinear"])
@pytest.mark.parametrize("level", [0, 2])
@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
def test_surface_faces_outwards_however_it_is_wound(scheme, level, left_handed, mirrored):
    faces = CUBE_FACES if scheme != "loop" else [f[:3] for f in CUBE_FACES] + [
        [f[0], f[2], f[3]] for f in CUBE_FACES
    ]  # fmt: skip
    if left_handed:
        faces = [face[::-1] for face in faces]
    mesh = define(
        CUBE_POINTS, faces, scheme, orientation="leftHanded" if left_handed else "rightHanded"
    )
    to_world = np.diag([-0.5, 0.5, 0.5, 1.0]) if mirrored else np.diag([0.5, 0.5, 0.5, 1.0])
    to_world[:3, 3] = (3.0, -2.0, 1.0)
    arrays = read(mesh, level=level, to_world=to_world)
    assert volume(arrays) > 0.0
    assert arrays.closed
    outward = np.einsum("tj,tcj->tc", crosses(arrays), arrays.normals)
    assert (outward > 0.0).all()
    np.testing.assert_allclose(np.linalg.norm(arrays.normals, axis=-1), 1.0, atol=1e-6)
    if scheme in ("none", "bilinear"):
        assert volume(arrays) == pytest.approx(1.0)


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("scheme", ["none", "catmullClark"])
def test_corner_data_stays_with_its_corner_when_the_winding_turns(left_handed, mirrored, scheme):
    # Texture coordinates equal to positions must still do so, whichever way the corners go.
    points = [(0, 0, 0), (2, 0, 0), (3, 2, 0), (1, 3, 0), (0, 2, 0), (4, 0, 0), (4, 3, 0)]
    faces = [[0, 1, 2, 3, 4], [1, 5, 6, 2]]
    mesh = define(points, faces, scheme, orientation="leftHanded" if left_handed else "rightHanded")
    flat = [Gf.Vec2f(*points[v][:2]) for face in faces for v in face]
    primvar(mesh, "st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying", flat)
    to_world = np.diag([-1.0 if mirrored else 1.0, 1.0, 1.0, 1.0])
    arrays = read(mesh, ["st"], to_world=to_world)
    position = arrays.points[arrays.triangles] @ np.linalg.inv(to_world[:3, :3])
    np.testing.assert_allclose(arrays.primvars["st"], position[..., :2], atol=1e-6)


def test_normals_go_with_the_inverse_transpose_under_shear():
    mesh = define([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [[0, 1, 2]])
    mesh.CreateNormalsAttr([(0, 0.6, 0.8)] * 3)
    mesh.SetNormalsInterpolation("vertex")
    shear = np.array([[1.0, 2.0, 0, 0], [0, 3.0, 0, 0], [0.5, 0, 1, 0], [0, 0, 0, 1]])
    arrays = read(mesh, to_world=shear)
    expected = np.linalg.inv(shear[:3, :3]).T @ (0, 0.6, 0.8)
    np.testing.assert_allclose(arrays.normals[0, 0], expected / np.linalg.norm(expected), atol=1e-6)
    faceted = read(define([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [[0, 1, 2]]), to_world=shear)
    cross = crosses(faceted)[0]
    np.testing.assert_allclose(faceted.normals[0, 1], cross / np.linalg.norm(cross), atol=1e-6)


def test_singular_transform_is_refused():
    mesh = define(CUBE_POINTS, CUBE_FACES)
    with pytest.raises(MeshError, match=r"</World/Mesh>: its transform is singular"):
        read(mesh, to_world=np.diag([1.0, 0.0, 1.0, 1.0]))


# Normals


def test_polygon_mesh_without_normals_is_faceted():
    arrays = read(define(CUBE_POINTS, CUBE_FACES))
    flat = crosses(arrays)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    np.testing.assert_allclose(arrays.normals, np.repeat(flat[:, None], 3, axis=1), atol=1e-6)


def test_unauthored_scheme_is_catmull_clark_and_ignores_normals():
    notes = []
    mesh = define(CUBE_POINTS, CUBE_FACES, None, normals=[(1, 0, 0)] * 8)
    arrays = read(mesh, level=2, notes=notes)
    assert codes(notes) == ["normals-ignored"]
    # The limit of the cube's corner is half the corner, its normal the diagonal.
    corner = np.flatnonzero(np.all(np.abs(arrays.points - 0.5) < 1e-6, axis=1))
    at = np.argwhere(arrays.triangles == corner[0])
    np.testing.assert_allclose(arrays.normals[tuple(at[0])], [3**-0.5] * 3, atol=1e-6)


def test_level_0_shows_the_control_mesh_with_smooth_normals():
    arrays = read(define(CUBE_POINTS, CUBE_FACES, "catmullClark"))
    assert volume(arrays) == pytest.approx(8.0)
    corner = arrays.points[arrays.triangles]
    np.testing.assert_allclose(arrays.normals, corner / 3**0.5, atol=1e-6)


@pytest.mark.parametrize("interpolation", ["constant", "uniform", "varying", "vertex"])
def test_authored_normals_of_any_interpolation_are_used(interpolation):
    points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)]
    faces = [[0, 1, 2, 3], [1, 4, 2]]
    counts = {"constant": 1, "uniform": 2, "varying": 5, "vertex": 5}
    tilt = np.linspace(-0.5, 0.5, 5)[: counts[interpolation]]
    authored = np.stack([np.sin(tilt), 0.0 * tilt, np.cos(tilt)], axis=1)
    mesh = define(points, faces, normals=[Gf.Vec3f(*map(float, 3.0 * n)) for n in authored])
    mesh.SetNormalsInterpolation(interpolation)
    arrays = read(mesh)
    index = {
        "constant": np.zeros((3, 3), dtype=int),
        "uniform": np.array([[0] * 3, [0] * 3, [1] * 3]),
    }.get(interpolation, arrays.triangles)
    np.testing.assert_allclose(arrays.normals, authored[index], atol=1e-6)


def test_indexed_primvar_normals_beat_the_attribute():
    mesh = define([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [[0, 1, 2]], normals=[(0, 0, 1)] * 3)
    mesh.SetNormalsInterpolation("vertex")
    primvar(
        mesh, "normals", Sdf.ValueTypeNames.Normal3fArray, "faceVarying", [(0, 1, 0), (1, 0, 0)],
        [1, 0, 1],
    )  # fmt: skip
    np.testing.assert_allclose(read(mesh).normals[0], [[1, 0, 0], [0, 1, 0], [1, 0, 0]])


def test_normal_without_length_is_noted_and_the_face_stands_in():
    notes = []
    mesh = define([(0, 0, 0), (1, 0, 0), (1, 1, 0)], [[0, 1, 2]], normals=[(0, 0, 0)] * 3)
    mesh.SetNormalsInterpolation("vertex")
    np.testing.assert_allclose(read(mesh, notes=notes).normals[0], [[0, 0, 1]] * 3)
    assert codes(notes) == ["normals-zero"]


# Polygons


def polygon(points):
    return np.array([(x, y, 0.0) for x, y in points])


SHAPES = {
    "L": polygon([(0, 0), (3, 0), (3, 1), (1, 1), (1, 3), (0, 3)]),
    "arrow": polygon([(0, 0), (2, 1), (0, 2), (0.5, 1)]),
    "comb": polygon(
        [(0, 0), (5, 0), (5, 2), (4, 2), (4, 1), (3, 1), (3, 2), (2, 2), (2, 1), (0, 1)]
    ),
    "keyhole": polygon(
        [(0, 0), (4, 0), (4, 4), (0, 4), (0, 0), (1, 1), (1, 3), (3, 3), (3, 1), (1, 1)]
    ),
    "collinear": polygon([(0, 0), (1, 0), (2, 0), (2, 1), (2, 2), (1, 2), (0, 2), (0, 1)]),
    "spiral": polygon(
        [(0, 0), (6, 0), (6, 6), (1, 6), (1, 2), (4, 2), (4, 4), (3, 4), (3, 3), (2, 3), (2, 5),
         (5, 5), (5, 1), (0, 1)]
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("turn", [0, 3])
def test_triangles_cover_a_concave_polygon_once(name, turn):
    corners = np.roll(SHAPES[name], turn, axis=0) @ np.linalg.qr(np.arange(9).reshape(3, 3) % 4)[0]
    count = np.array([len(corners)])
    vector = area_vectors(count, corners)[0]
    triangles, _ = triangulate(count, corners, np.arange(len(corners)), np.array([True]))
    assert len(triangles) == len(corners) - 2
    corner = corners[triangles]
    part = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    # All parts point the same way and add up to the whole: no overlap, no gap, none outside.
    assert (part @ vector[0] > 0.0).all()
    np.testing.assert_allclose(part.sum(axis=0), vector[0], atol=1e-12)


def test_quad_is_cut_along_its_shorter_diagonal():
    points = [(0, 0, 0), (1, -1, 0), (4, 0, 0), (1, 1, 0)]
    triangles = read(define(points, [[0, 1, 2, 3]])).triangles
    assert [sorted(t) for t in triangles.tolist()] == [[0, 1, 3], [1, 2, 3]]


def test_faces_of_all_sizes_keep_their_order():
    points = [(x, y, 0) for y in range(2) for x in range(5)]
    faces = [[0, 1, 6, 5], [1, 2, 7], [1, 7, 6], [2, 3, 4, 9, 8, 7]]
    mesh = define(points, faces)
    primvar(mesh, "id", Sdf.ValueTypeNames.FloatArray, "uniform", [0.0, 1.0, 2.0, 3.0])
    arrays = read(mesh, ["id"])
    assert arrays.primvars["id"][:, 0, 0].tolist() == [0, 0, 1, 2, 3, 3, 3, 3]
    assert area(arrays) == pytest.approx(4.0)
    assert not arrays.closed


def test_faces_without_area_are_left_out_with_a_note():
    notes = []
    points = [(0, 0, 0), (1, 0, 0), (2, 0, 0), (0, 1, 0)]
    faces = [[0, 1, 3], [0, 1, 2], [0, 1], [0, 0, 1, 3], [1, 1, 1]]
    arrays = read(define(points, faces), notes=notes)
    assert arrays.triangles.tolist() == [[0, 1, 3], [0, 1, 3]]
    assert codes(notes) == ["degenerate-faces", "degenerate-faces"]
    assert "2 faces" in notes[0].message and "face 2" in notes[0].message
    assert "face 1" in notes[1].message


def test_holes_are_not_shown_but_shape_the_surface():
    whole = read(define(CUBE_POINTS, CUBE_FACES, "catmullClark"), level=1)
    holed = read(define(CUBE_POINTS, CUBE_FACES, "catmullClark", holeIndices=[5]), level=1)
    assert len(whole.triangles) == 48 and len(holed.triangles) == 40
    np.testing.assert_array_equal(whole.points, holed.points)
    assert whole.closed and not holed.closed


def test_mesh_without_faces_is_nothing_and_noted():
    notes = []
    assert read(define([], []), notes=notes) is None
    assert read(define(CUBE_POINTS, [[0, 1]]), notes=notes) is None
    assert codes(notes) == ["mesh-empty", "degenerate-faces", "mesh-empty"]


# Refusals


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"faceVertexIndices": [0, 1, 999999]}, r"faceVertexIndices\[2\] names point 999999"),
        ({"faceVertexIndices": [0, -1, 2]}, r"faceVertexIndices\[1\] names point -1"),
        ({"faceVertexCounts": [3, 4, 2147483647]}, "add up to 2147483654 corners"),
        ({"faceVertexCounts": [4, -1]}, r"faceVertexCounts\[1\] is -1"),
        ({"points": [(0, 0, 0), (1, float("nan"), 0), (0, 1, 0)]}, r"point 1 is \(1, nan, 0\)"),
        ({"points": [(0, 0, 0), (1, 0, 0), (0, float("inf"), 0)]}, r"point 2 is \(0, inf, 0\)"),
        ({"points": [(0, 0, 0), (1, 0, 0), (0, 3e38, 0)]}, "too far for single precision"),
        ({"holeIndices": [1]}, r"holeIndices\[0\] names face 1"),
        ({"orientation": "lefthanded"}, "use one of rightHanded, leftHanded"),
        ({"subdivisionScheme": "catmull"}, "use one of catmullClark, loop, bilinear, none"),
        ({"normals": [(0, 0, 1)] * 2}, "has 2 values, but vertex interpolation needs 3"),
        ({"normals": [(0, 0, float("nan"))] * 3}, r"normals\[0\] is not finite"),
    ],
)  # fmt: skip
def test_broken_mesh_is_refused_with_where_and_what(change, message):
    mesh = define([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [[0, 1, 2]])
    for name, value in change.items():
        mesh.GetPrim().GetAttribute(name).Set(value)
    with pytest.raises(MeshError, match=message) as caught:
        read(mesh, to_world=np.diag([1.0, 100.0, 1.0, 1.0]))
    assert "</World/Mesh>" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"creaseLengths": [2], "creaseIndices": [0, 1, 2]}, "add up to the 3 creaseIndices"),
        ({"creaseLengths": [3], "creaseIndices": [0, 1, 9]}, "names point 9"),
        (
            {"creaseLengths": [2], "creaseIndices": [0, 1], "creaseSharpnesses": [1.0, 2.0]},
            "creaseSharpnesses has 2 values; it needs 1",
        ),
        ({"cornerIndices": [0], "cornerSharpnesses": [float("nan")]}, "is not a number"),
        ({"interpolateBoundary": "corner"}, "use one of none, edgeOnly, edgeAndCorner"),
        ({"subdivisionScheme": "loop"}, "loop needs triangles, but face 0 has 4 corners"),
    ],
)
def test_broken_subdivision_tags_are_refused(change, message):
    mesh = define(CUBE_POINTS, CUBE_FACES, "catmullClark", **change)
    with pytest.raises(MeshError, match=message):
        read(mesh, level=1)


@pytest.mark.parametrize(
    ("opinion", "message"),
    [
        ('string[] points = ["a", "b"]', "points does not hold rows of 3 numbers"),
        ("float[] points = [1, 2, 3]", "points does not hold rows of 3 numbers"),
        ('string points = "x"', "points does not hold rows of 3 numbers"),
        ("float[] faceVertexCounts = [3]", "faceVertexCounts does not hold whole numbers"),
        ("int faceVertexIndices = 3", "faceVertexIndices does not hold whole numbers"),
        ('string[] normals = ["a"]', "normals does not hold rows of 3 numbers"),
    ],
)
def test_opinion_of_another_type_is_refused(opinion, message):
    mesh = define([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [[0, 1, 2]])
    stronger = Sdf.Layer.CreateAnonymous(".usda")
    stronger.ImportFromString(f'#usda 1.0\nover "World" {{\n over "Mesh" {{\n {opinion}\n }}\n}}\n')
    mesh.stage.GetSessionLayer().TransferContent(stronger)
    with pytest.raises(MeshError, match=message):
        read(mesh)


def test_crease_off_the_mesh_is_noted():
    notes = []
    mesh = define(
        CUBE_POINTS, CUBE_FACES, "catmullClark", creaseLengths=[3], creaseIndices=[0, 1, 7],
        creaseSharpnesses=[10.0],
    )  # fmt: skip
    read(mesh, level=1, notes=notes)
    assert codes(notes) == ["crease-edge-missing"]
    assert "between points 1 and 7" in notes[0].message


def test_creased_cube_stays_a_cube():
    pairs = sorted({tuple(sorted((f[i], f[i - 1]))) for f in CUBE_FACES for i in range(4)})
    mesh = define(
        CUBE_POINTS, CUBE_FACES, "catmullClark", creaseLengths=[2] * 12,
        creaseIndices=[v for pair in pairs for v in pair], creaseSharpnesses=[10.0] * 12,
    )  # fmt: skip
    assert volume(read(mesh, level=2)) == pytest.approx(8.0)


def test_level_that_does_not_fit_is_refused_before_it_is_computed():
    with pytest.raises(DeviceError, match="lower the subdivision level"):
        read(define(CUBE_POINTS, CUBE_FACES, "catmullClark"), level=14)


# Primvars

SQUARE = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0), (2, 1, 0)]
TWO = [[0, 1, 2, 3], [1, 4, 5, 2]]


@pytest.mark.parametrize("scheme", ["none", "catmullClark"])
@pytest.mark.parametrize("level", [0, 2])
def test_primvars_of_every_interpolation_reach_the_corners(scheme, level):
    mesh = define(SQUARE, TWO, scheme)
    kinds = Sdf.ValueTypeNames
    primvar(mesh, "one", kinds.FloatArray, "constant", [5.0])
    primvar(mesh, "face", kinds.IntArray, "uniform", [3, 4])
    primvar(mesh, "smooth", kinds.Color3fArray, "vertex", [Gf.Vec3f(*p) for p in SQUARE])
    primvar(mesh, "straight", kinds.DoubleArray, "varying", [float(p[0]) for p in SQUARE])
    primvar(
        mesh, "st", kinds.TexCoord2hArray, "faceVarying",
        [Gf.Vec2h(0, 0), Gf.Vec2h(1, 0), Gf.Vec2h(1, 1), Gf.Vec2h(0, 1)],
        [0, 1, 2, 3, 0, 1, 2, 3],
    )  # fmt: skip
    names = ["one", "face", "smooth", "straight", "st", "missing"]
    found = read(mesh, names, level=level)
    values = found.primvars
    position = found.points[found.triangles]
    assert "missing" not in values
    assert all(array.dtype == np.float32 for array in values.values())
    np.testing.assert_array_equal(values["one"], np.full((*position.shape[:2], 1), 5.0))
    expected_face = 3.0 + (position[..., 0].mean(axis=1) > 1.0)
    np.testing.assert_array_equal(values["face"][:, 0, 0], expected_face)
    np.testing.assert_allclose(values["smooth"], position, atol=1e-6)
    if scheme == "none" or level == 0:
        np.testing.assert_allclose(values["straight"][..., 0], position[..., 0], atol=1e-6)
        chart = position[..., :2] - (expected_face - 3.0)[:, None, None] * [1.0, 0.0]
        np.testing.assert_allclose(values["st"], chart, atol=1e-6)


def test_varying_is_linear_and_vertex_is_smooth():
    points = [(x, 0, 0) for x in range(4)] + [(x, 1, 0) for x in range(4)]
    faces = [[x, x + 1, x + 5, x + 4] for x in range(3)]
    mesh = define(points, faces, "catmullClark")
    for name, interpolation in (("a", "varying"), ("b", "vertex")):
        primvar(mesh, name, Sdf.ValueTypeNames.FloatArray, interpolation, [0.0, 1, 0, 0] * 2)
    values = read(mesh, ["a", "b"], level=3).primvars
    assert values["a"].max() == 1.0
    assert values["b"].max() == pytest.approx(2.0 / 3.0)


def test_constant_primvars_are_inherited():
    mesh = define(SQUARE, TWO)
    parent = mesh.GetPrim().GetParent()
    UsdGeom.PrimvarsAPI(parent).CreatePrimvar(
        "roughness", Sdf.ValueTypeNames.Float, "constant"
    ).Set(0.25)
    assert (read(mesh, ["roughness"]).primvars["roughness"] == 0.25).all()


def test_primvars_and_points_are_read_at_the_time():
    mesh = define(SQUARE, TWO)
    mesh.GetPointsAttr().Set([Gf.Vec3f(*p) for p in SQUARE], 1.0)
    mesh.GetPointsAttr().Set([Gf.Vec3f(p[0], p[1], 4.0) for p in SQUARE], 3.0)
    made = primvar(mesh, "a", Sdf.ValueTypeNames.FloatArray, "uniform", [0.0, 0.0])
    made.Set([1.0, 2.0], 1.0)
    made.Set([3.0, 4.0], 3.0)
    arrays = read(mesh, ["a"], time=Usd.TimeCode(2.0))
    np.testing.assert_allclose(arrays.points[:, 2], 2.0)
    assert arrays.primvars["a"][:, 0, 0].tolist() == [2, 2, 3, 3]


def test_element_size_groups_values():
    mesh = define(SQUARE, TWO)
    made = primvar(mesh, "w", Sdf.ValueTypeNames.FloatArray, "uniform", [1.0, 2, 3, 4, 5, 6])
    made.SetElementSize(3)
    assert read(mesh, ["w"]).primvars["w"][::2, 0].tolist() == [[1, 2, 3], [4, 5, 6]]


@pytest.mark.parametrize(
    ("interpolation", "values", "indices", "message"),
    [
        ("vertex", [0.0] * 5, None, "has 5 values, but vertex interpolation needs 6"),
        ("faceVarying", [0.0] * 3, [0] * 7, "has 7 indices, but faceVarying .* needs 8"),
        ("faceVarying", [0.0] * 3, [0] * 7 + [3], r"indices\[7\] is 3, but there are 3 values"),
        ("uniform", [0.0] * 3, [-1, 0], r"indices\[0\] is -1"),
        ("uniform", [0.0, float("nan")], None, r"a\[1\] is not finite"),
        ("constant", [0.0, 1.0], None, "has 2 values, but constant interpolation needs 1"),
    ],
)
def test_broken_primvar_is_refused(interpolation, values, indices, message):
    mesh = define(SQUARE, TWO)
    primvar(mesh, "a", Sdf.ValueTypeNames.FloatArray, interpolation, values, indices)
    with pytest.raises(MeshError, match=message):
        read(mesh, ["a"])
    assert read(mesh, []) is not None


def test_primvar_of_words_is_noted():
    notes = []
    mesh = define(SQUARE, TWO)
    primvar(mesh, "a", Sdf.ValueTypeNames.StringArray, "uniform", ["x", "y"])
    assert "a" not in read(mesh, ["a"], notes=notes).primvars
    assert codes(notes) == ["primvar-not-numbers"]


def test_unindexed_face_varying_values_join_where_they_are_equal():
    # Otherwise every face would be a chart of its own, and the texture kink at each control edge.
    points = [(x, y, 0) for y in range(4) for x in range(4)]
    faces = [[a, a + 1, a + 5, a + 4] for a in (0, 1, 2, 4, 5, 6, 8, 9, 10)]
    mesh = define(points, faces, "catmullClark")
    bent = [Gf.Vec2f(points[v][0] ** 2, points[v][1]) for face in faces for v in face]
    primvar(mesh, "st", Sdf.ValueTypeNames.TexCoord2fArray, "faceVarying", bent)
    by_vertex = [Gf.Vec2f(p[0] ** 2, p[1]) for p in points]
    primvar(mesh, "same", Sdf.ValueTypeNames.Float2Array, "vertex", by_vertex)
    values = read(mesh, ["st", "same"], level=2).primvars
    np.testing.assert_allclose(values["st"], values["same"], atol=1e-5)


# Subsets


def subset(mesh, name, faces, family="materialBind", element="face"):
    made = UsdGeom.Subset.Define(mesh.stage, mesh.GetPath().AppendChild(name))
    made.CreateIndicesAttr(faces)
    made.CreateElementTypeAttr(element)
    made.CreateFamilyNameAttr(family)
    return made


def by_name(prim):
    return None if prim.GetName() == "plain" else f"/Looks/{prim.GetName()}"


@pytest.mark.parametrize("level", [0, 1])
def test_faces_outside_subsets_keep_the_material_of_the_mesh(level):
    mesh = define(CUBE_POINTS, CUBE_FACES, "catmullClark")
    subset(mesh, "lid", [5])
    subset(mesh, "plain", [0, 1])
    arrays = read(mesh, level=level, materials=by_name)
    per_face = 2 if level == 0 else 8
    names = [arrays.material_paths[slot] for slot in arrays.material_slot[::per_face]]
    assert names == [None, None] + ["/Looks/Mesh"] * 3 + ["/Looks/lid"]
    assert len(arrays.material_paths) == 3


def test_slots_hold_only_materials_that_a_face_has():
    mesh = define(SQUARE, TWO)
    subset(mesh, "a", [0, 1])
    subset(mesh, "b", [])
    assert read(mesh, materials=by_name).material_paths == ("/Looks/a",)


def test_subsets_follow_faces_past_degenerate_ones():
    mesh = define(SQUARE, [[0, 0, 1], *TWO])
    subset(mesh, "a", [2])
    arrays = read(mesh, materials=by_name)
    assert [arrays.material_paths[s] for s in arrays.material_slot] == ["/Looks/Mesh"] * 2 + [
        "/Looks/a"
    ] * 2


def test_overlapping_subsets_are_noted_and_the_first_counts():
    notes = []
    mesh = define(SQUARE, TWO)
    subset(mesh, "a", [0, 1])
    subset(mesh, "b", [1])
    arrays = read(mesh, materials=by_name, notes=notes)
    assert arrays.material_paths == ("/Looks/a",)
    assert codes(notes) == ["subset-overlap"] and "face 1 in a" in notes[0].message


def test_subset_of_a_face_that_is_not_there_is_refused():
    mesh = define(SQUARE, TWO)
    subset(mesh, "a", [0, 7, -3])
    with pytest.raises(MeshError, match=r"Mesh/a>: indices\[1\] names face 7, .* 2 \(0 to 1"):
        read(mesh)


def test_subsets_that_cannot_bind_are_noted():
    notes = []
    mesh = define(SQUARE, TWO)
    other = subset(mesh, "a", [0], family="")
    material = UsdShade.Material.Define(mesh.stage, "/Looks/a")
    UsdShade.MaterialBindingAPI.Apply(other.GetPrim()).Bind(material)
    subset(mesh, "b", [0], element="point")
    assert read(mesh, materials=by_name, notes=notes).material_paths == ("/Looks/Mesh",)
    assert codes(notes) == ["subset-family", "subset-element-type"]


def test_two_sides_are_told():
    assert not read(define(SQUARE, TWO)).double_sided
    assert read(define(SQUARE, TWO, doubleSided=True)).double_sided


@pytest.mark.realdata
def test_real_body_is_subdivided_without_a_flaw(realdata):
    points, faces = _read_group(realdata / "heads" / "makehuman" / "base.obj", "body")
    stage = Usd.Stage.CreateInMemory()
    mesh = UsdGeom.Mesh.Define(stage, "/Body")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 4, np.int32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    for level in (0, 1, 2):
        arrays = read(mesh, level=level, to_world=np.diag([0.1, 0.1, 0.1, 1.0]))
        assert len(arrays.triangles) == 2 * len(faces) * 4**level
        flat = crosses(arrays)
        size = np.linalg.norm(flat, axis=1)
        agree = np.einsum("tj,tcj->tc", flat, arrays.normals) / size[:, None]
        assert np.isfinite(arrays.normals).all()
        assert np.mean(agree > 0.5) > (0.99, 0.999, 0.9999)[level]
    assert 0.04 < volume(arrays) < 0.12  # [m^3]; a person has about 0.07


def _read_group(path, name):
    points, faces, inside = [], [], False
    with path.open() as lines:
        for line in lines:
            word, *rest = line.split() or [""]
            if word == "v":
                points.append([float(x) for x in rest[:3]])
            elif word == "g":
                inside = rest == [name]
            elif word == "f" and inside:
                faces.append([int(x.split("/")[0]) - 1 for x in rest])
    return np.array(points), np.array(faces)
