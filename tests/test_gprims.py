"""Implicit shapes against their closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom

import usdskin.schemas  # noqa: F401  (registers before the first stage)
from usdskin.errors import MeshError
from usdskin.render.gprims import is_gprim, read_gprim, unsupported_note
from usdskin.render.polygons import is_closed

NOW = Usd.TimeCode.Default()
SIDE = 5**0.5
_STAGES: list[Usd.Stage] = []

# Volume, area and bounds (of the axis, then across it) of each shape about its axis.
SHAPES = {
    "Sphere": ({"radius": 2.0}, 32 * np.pi / 3, 16 * np.pi, (-2, 2), 2),
    "Cube": ({"size": 3.0}, 27.0, 54.0, (-1.5, 1.5), 1.5),
    "Cylinder": ({"height": 4.0, "radius": 1.0}, 4 * np.pi, 10 * np.pi, (-2, 2), 1),
    "Cylinder_1": (
        {"height": 2.0, "radiusBottom": 2.0, "radiusTop": 1.0},
        14 * np.pi / 3, (5 + 3 * SIDE) * np.pi, (-1, 1), 2,
    ),
    "Cone": ({"height": 2.0, "radius": 1.0}, 2 * np.pi / 3, (1 + SIDE) * np.pi, (-1, 1), 1),
    "Capsule": ({"height": 3.0, "radius": 1.0}, 13 * np.pi / 3, 10 * np.pi, (-2.5, 2.5), 1),
    # Two balls of radii 2 and 1, 2 apart: the side leans by 30 degrees and touches them at z = 0
    # and z = 1.5, where its rings have the radii 3^0.5 and 3^0.5 / 2.
    "Capsule_1": (
        {"height": 2.0, "radiusBottom": 2.0, "radiusTop": 1.0},
        np.pi * (9 + 2.625 + 5 / 24), np.pi * (12 + 4.5 + 1), (-3, 2), 2,
    ),
}  # fmt: skip


@pytest.fixture(autouse=True)
def stages():
    """Keep the stages of a test alive: a prim does not."""
    yield
    _STAGES.clear()


def define(kind, axis=None, **attributes):
    stage = Usd.Stage.CreateInMemory()
    _STAGES.append(stage)
    prim = stage.DefinePrim("/World/Shape", kind)
    for name, value in attributes.items():
        prim.GetAttribute(name).Set(value)
    if axis is not None:
        prim.GetAttribute("axis").Set(axis)
    return prim


def read(prim, names=(), to_world=None, notes=None, materials=None):
    matrix = np.eye(4) if to_world is None else to_world
    bound = materials or (lambda prim: None)
    return read_gprim(prim, NOW, matrix, 0, names, bound, [] if notes is None else notes)


def measure(arrays):
    """Return volume, area, and the flat normals' agreement with the shading normals."""
    corner = arrays.points.astype(float)[arrays.triangles]
    cross = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    size = np.linalg.norm(cross, axis=1)
    agree = np.einsum("tj,tcj->tc", cross, arrays.normals) / size[:, None]
    volume = np.einsum("ij,ij->", corner[:, 0], np.cross(corner[:, 1], corner[:, 2])) / 6.0
    return volume, 0.5 * size.sum(), agree


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("axis", ["X", "Y", "Z"])
def test_shape_has_its_volume_area_and_extent_about_every_axis(kind, axis):
    attributes, volume, area, along, across = SHAPES[kind]
    prim = define(kind, axis if kind not in ("Sphere", "Cube") else None, **attributes)
    arrays = read(prim)
    found_volume, found_area, agree = measure(arrays)
    assert found_volume == pytest.approx(volume, rel=1e-3)
    assert found_area == pytest.approx(area, rel=1e-3)
    assert agree.min() > 0.998
    spine = "XYZ".index(axis)
    low, high = arrays.points.min(axis=0), arrays.points.max(axis=0)
    assert (low[spine], high[spine]) == pytest.approx(along, abs=1e-3)
    others = [i for i in range(3) if i != spine]
    np.testing.assert_allclose(high[others], across, rtol=1e-3)
    np.testing.assert_allclose(low[others], -across, rtol=1e-3)
    assert arrays.closed and not arrays.double_sided
    counts = np.full(len(arrays.triangles), 3)
    corners = arrays.triangles.ravel().astype(np.intp)
    assert is_closed(counts, corners, arrays.points.astype(float))


def test_sphere_normals_are_those_of_the_sphere():
    arrays = read(define("Sphere", radius=0.5))
    position = arrays.points[arrays.triangles] / 0.5
    radial = np.linalg.norm(arrays.normals - position, axis=-1)
    at_pole = np.abs(np.abs(position[..., 2]) - 1.0) < 1e-6
    assert radial[~at_pole].max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(arrays.normals, axis=-1), 1.0, atol=1e-6)
    assert radial[at_pole].max() < 1e-6


def test_sphere_is_round_to_three_parts_in_ten_thousand():
    arrays = read(define("Sphere"))
    corner = arrays.points[arrays.triangles]
    middle = 0.5 * (corner + np.roll(corner, 1, axis=1))
    assert np.linalg.norm(middle, axis=-1).min() > 1.0 - 2.8e-4


def test_capsule_of_two_radii_has_no_kink():
    prim = define("Capsule_1", "Z", height=2.0, radiusBottom=2.0, radiusTop=1.0)
    arrays = read(prim)
    position = arrays.points.astype(float)[arrays.triangles]
    # Where the bottom ball ends, its normal and that of the side are the same: 30 degrees up.
    ring = np.abs(position[..., 2]) < 1e-6
    assert ring.sum() > 1000
    np.testing.assert_allclose(arrays.normals[ring][:, 2], 0.5, atol=1e-6)


def test_capsule_whose_one_ball_holds_the_other_is_the_larger_ball():
    prim = define("Capsule_1", "Z", height=0.5, radiusBottom=0.2, radiusTop=1.0)
    volume, _, _ = measure(read(prim))
    assert volume == pytest.approx(4 * np.pi / 3, rel=1e-3)


def test_cylinder_closed_to_a_point_is_a_cone():
    cone = read(define("Cone", "Z"))
    cylinder = read(define("Cylinder_1", "Z", radiusTop=0.0))
    np.testing.assert_array_equal(cone.points, cylinder.points)
    np.testing.assert_array_equal(cone.triangles, cylinder.triangles)


@pytest.mark.parametrize(("axis", "size"), [("X", (0, 3, 2)), ("Y", (2, 0, 3)), ("Z", (2, 3, 0))])
def test_plane_faces_its_axis_with_width_and_length_as_usd_says(axis, size):
    # UsdGeomPlane: width is along x, or z about X; length along y, or z about Y.
    prim = define("Plane", axis, width=2.0, length=3.0)
    arrays = read(prim, ["st"])
    np.testing.assert_allclose(np.ptp(arrays.points, axis=0), size)
    normal = np.zeros(3)
    normal["XYZ".index(axis)] = 1.0
    np.testing.assert_array_equal(arrays.normals, np.broadcast_to(normal, (2, 3, 3)))
    assert measure(arrays)[2].min() == pytest.approx(1.0)
    assert arrays.double_sided and not arrays.closed
    position = arrays.points[arrays.triangles]
    for column, extent in ((0, 2.0), (1, 3.0)):
        along = position[..., size.index(extent)] / extent + 0.5
        np.testing.assert_allclose(arrays.primvars["st"][..., column], along, atol=1e-6)


@pytest.mark.parametrize("kind", [*SHAPES, "Plane"])
def test_shape_faces_outwards_under_shear_and_mirroring(kind):
    matrix = np.array([[-0.02, 0.005, 0, 4], [0, 0.01, 0.003, 5], [0, 0, 0.03, 6], [0, 0, 0, 1]])
    arrays = read(define(kind), ["st"], to_world=matrix)
    volume, _, agree = measure(arrays)
    assert agree.min() > 0.99
    if kind != "Plane":
        local = measure(read(define(kind)))[0]
        assert volume == pytest.approx(local * abs(np.linalg.det(matrix[:3, :3])), rel=1e-3)
    np.testing.assert_allclose(np.linalg.norm(arrays.normals, axis=-1), 1.0, atol=1e-6)


@pytest.mark.parametrize("kind", [*SHAPES, "Plane"])
def test_texture_coordinates_fill_the_unit_square(kind):
    st = read(define(kind), ["st"]).primvars["st"]
    assert st.min() >= 0.0 and st.max() <= 1.0
    assert np.ptp(st[..., 0]) > 0.99 and np.ptp(st[..., 1]) > 0.99
    assert np.ptp(st[..., 0], axis=1).max() < 0.05 or kind in ("Cube", "Plane", "Cylinder",
        "Cylinder_1", "Cone")  # fmt: skip


def test_constant_primvars_and_the_material_are_read():
    prim = define("Sphere")
    api = UsdGeom.PrimvarsAPI(prim)
    api.CreatePrimvar("displayColor", Sdf.ValueTypeNames.Color3fArray, "constant").Set(
        [Gf.Vec3f(0.25, 0.5, 1.0)]
    )
    UsdGeom.PrimvarsAPI(prim.GetParent()).CreatePrimvar(
        "roughness", Sdf.ValueTypeNames.Float, "constant"
    ).Set(0.5)
    arrays = read(prim, ["displayColor", "roughness"], materials=lambda prim: "/Looks/a")
    assert (arrays.primvars["displayColor"] == [0.25, 0.5, 1.0]).all()
    assert (arrays.primvars["roughness"] == 0.5).all()
    assert arrays.material_paths == ("/Looks/a",) and not arrays.material_slot.any()


def test_primvar_on_points_that_are_not_defined_is_noted():
    notes = []
    prim = define("Cube")
    UsdGeom.PrimvarsAPI(prim).CreatePrimvar("a", Sdf.ValueTypeNames.FloatArray, "vertex").Set(
        [0.0] * 8
    )
    assert "a" not in read(prim, ["a"], notes=notes).primvars
    assert [note.code for note in notes] == ["primvar-not-constant"]


@pytest.mark.parametrize(
    ("kind", "attributes", "message"),
    [
        ("Sphere", {"radius": -1.0}, "radius is -1; it must be 0 or more"),
        ("Cube", {"size": float("nan")}, "size is nan"),
        ("Cone", {"height": float("inf")}, "height is inf"),
        ("Cylinder", {"axis": "z"}, "axis is 'z'; use one of X, Y, Z"),
    ],
)
def test_broken_shape_is_refused(kind, attributes, message):
    with pytest.raises(MeshError, match=message) as caught:
        read(define(kind, **attributes))
    assert "</World/Shape>" in str(caught.value)


def test_singular_transform_is_refused():
    with pytest.raises(MeshError, match="singular"):
        read(define("Cube"), to_world=np.diag([0.0, 1.0, 1.0, 1.0]))


@pytest.mark.parametrize(
    ("kind", "attributes"),
    [("Sphere", {"radius": 0.0}), ("Cube", {"size": 0.0}), ("Plane", {"width": 0.0}),
     ("Cylinder", {"radius": 0.0})],
)  # fmt: skip
def test_shape_without_size_is_nothing_and_noted(kind, attributes):
    notes = []
    assert read(define(kind, **attributes), notes=notes) is None
    assert [note.code for note in notes] == ["gprim-empty"]


@pytest.mark.parametrize(
    "kind",
    ["BasisCurves", "NurbsCurves", "HermiteCurves", "Points", "NurbsPatch", "TetMesh", "Volume"],
)  # fmt: skip
def test_geometry_that_is_not_shown_is_named(kind):
    note = unsupported_note(define(kind))
    assert note.code == "geometry-not-supported" and note.path == "/World/Shape"
    assert note.message.startswith(f"{kind}: ")
    assert not is_gprim(define(kind))


@pytest.mark.parametrize("kind", ["Mesh", *SHAPES, "Plane"])
def test_geometry_that_is_shown_is_a_gprim(kind):
    assert is_gprim(define(kind)) and unsupported_note(define(kind)) is None


@pytest.mark.parametrize("kind", ["Xform", "Scope", "Camera", "DomeLight", "RectLight", "Material"])
def test_other_prims_are_neither(kind):
    assert not is_gprim(define(kind)) and unsupported_note(define(kind)) is None
