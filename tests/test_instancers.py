"""Point instancers: which instances are shown, where, and with which values."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import (
    codes,
    corner_points,
    facing,
    mesh_named,
    paths,
    prim,
    read_stage,
    read_text,
    triangle,
    write_stage,
)
from test_scene import WHITE, colored, quad, stage_text
from test_scene import here as here
from test_scene import render as render_text

from usdskin.errors import DeviceError, UsdSkinError

THREE = """rel prototypes = </Many/Leaf>
    int[] protoIndices = [0, 0, 0]
    point3f[] positions = [(0, 0, 0), (10, 0, 0), (20, 0, 0)]"""


def many(*parts: str, name: str = "Many", metadata: str = "") -> str:
    return prim("PointInstancer", name, *parts, metadata=metadata)


def origins(scene) -> np.ndarray:
    """Return the first corner of every mesh [m], shape [mesh_count, 3]."""
    return np.array([mesh.points[0] for mesh in scene.meshes])


def test_every_instance_is_named_after_its_place_and_prototype(tmp_path):
    scene, notes = read_text(tmp_path, many(THREE, triangle("Leaf")))
    assert paths(scene) == ["/Many[0]/Leaf", "/Many[1]/Leaf", "/Many[2]/Leaf"]
    np.testing.assert_allclose(origins(scene)[:, 0], [0.0, 10.0, 20.0])
    assert notes == []


def test_a_picture_of_instances_is_a_picture_of_copies(here):
    leaf = quad("Leaf", colored((0.5, 0.2, 0.1)), box=(-0.4, -0.4, 0.4, 0.4))
    crowd = many(
        """rel prototypes = </Many/Leaf>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(-0.5, 0.5, 0), (0.5, -0.5, 0)]""",
        leaf,
    )
    copies = [
        quad("A", colored((0.5, 0.2, 0.1)), box=(-0.9, 0.1, -0.1, 0.9)),
        quad("B", colored((0.5, 0.2, 0.1)), box=(0.1, -0.9, 0.9, -0.1)),
    ]
    ours = render_text(stage_text(WHITE, crowd), name="ours")
    theirs = render_text(stage_text(WHITE, *copies), name="theirs")
    np.testing.assert_allclose(ours, theirs, atol=1e-6)


def test_transforms_are_the_instancers_times_the_instances_times_the_prototypes(tmp_path):
    """A quarter turn about Z by the instance, a prototype moved by x = 1, the crowd by y = 5."""
    text = many(
        """rel prototypes = </Many/Leaf>
    int[] protoIndices = [0]
    point3f[] positions = [(0, 0, 7)]
    quath[] orientations = [(0.70710678, 0, 0, 0.70710678)]
    float3[] scales = [(2, 2, 2)]
    double3 xformOp:translate = (0, 5, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]""",
        prim(
            "Xform",
            "Leaf",
            "double3 xformOp:translate = (1, 0, 0)",
            'uniform token[] xformOpOrder = ["xformOp:translate"]',
            triangle("Part"),
        ),
    )
    path = write_stage(tmp_path, text, metadata="metersPerUnit = 0.01")
    scene, _ = read_stage(path)
    assert paths(scene) == ["/Many[0]/Leaf/Part"]
    expected = [(0.0, 0.07, 0.07), (0.0, 0.09, 0.07), (-0.02, 0.07, 0.07)]
    np.testing.assert_allclose(corner_points(scene.meshes[0])[0], expected, atol=1e-4)
    np.testing.assert_allclose(scene.meshes[0].normals[0], [(0.0, 0.0, 1.0)] * 3, atol=1e-6)


def test_a_mirrored_instance_still_faces_outwards(tmp_path):
    text = many(
        """rel prototypes = </Many/Leaf>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(0, 0, 0), (0, 0, 0)]
    float3[] scales = [(-1, 1, 1), (1, 1, -1)]""",
        triangle("Leaf", "texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1)] (",
                 'interpolation = "faceVarying")'),
    )  # fmt: skip
    scene, _ = read_text(tmp_path, text)
    for mesh, side in zip(scene.meshes, (1.0, -1.0), strict=True):
        np.testing.assert_allclose(facing(mesh), (0.0, 0.0, side))
        np.testing.assert_allclose(mesh.normals[0], [(0.0, 0.0, side)] * 3, atol=1e-7)
        st = {
            tuple(point): tuple(value)
            for point, value in zip(
                np.abs(corner_points(mesh)[0])[:, :2], mesh.primvars["st"][0], strict=True
            )
        }
        assert all(point == value for point, value in st.items())  # fmt: skip


@pytest.mark.parametrize(
    ("opinions", "shown"),
    [
        (["int64[] invisibleIds = [1]"], [0, 2]),
        (["int64[] ids = [10, 20, 1]", "int64[] invisibleIds = [1]"], [0, 1]),
        (["int64[] ids = [10, 20, 30]", "int64[] invisibleIds = [30, 99]"], [0, 1]),
        (['token visibility = "invisible"'], []),
        (['uniform token purpose = "guide"'], []),
    ],
    ids=["places", "ids", "unknown id", "instancer", "purpose"],
)
def test_hidden_instances_are_not_drawn(tmp_path, opinions, shown):
    scene, _ = read_text(tmp_path, many(THREE, *opinions, triangle("Leaf")))
    assert paths(scene) == [f"/Many[{at}]/Leaf" for at in shown]


@pytest.mark.parametrize("name", ["ids", "invisibleIds"])
def test_ids_of_a_type_that_usd_does_not_read_are_noted(tmp_path, name):
    scene, notes = read_text(tmp_path, many(THREE, f"int[] {name} = [1]", triangle("Leaf")))
    assert len(scene.meshes) == 3
    assert codes(notes) == ["instancer-ids-ignored"] and name in notes[0].message


def test_inactive_ids_are_not_drawn(tmp_path):
    text = many(THREE, triangle("Leaf"), metadata="inactiveIds = [0, 2]")
    assert paths(read_text(tmp_path, text)[0]) == ["/Many[1]/Leaf"]


def test_invisible_ids_may_change_with_time(tmp_path):
    path = write_stage(
        tmp_path,
        many(THREE, "int64[] invisibleIds.timeSamples = {1: [0], 2: []}", triangle("Leaf")),
    )
    assert len(read_stage(path, 1)[0].meshes) == 2
    assert len(read_stage(path, 2)[0].meshes) == 3


def test_an_instance_scaled_to_nothing_is_noted_and_not_drawn(tmp_path):
    scales = "float3[] scales = [(1, 1, 1), (0, 0, 0), (1, 1, 1)]"
    scene, notes = read_text(tmp_path, many(THREE, scales, triangle("Leaf")))
    assert paths(scene) == ["/Many[0]/Leaf", "/Many[2]/Leaf"]
    assert codes(notes) == ["instances-without-size"]


def test_velocities_move_instances_between_samples(tmp_path):
    """From frame 1 at 24 frames a second, 24 units a second are one unit a frame."""
    path = write_stage(
        tmp_path,
        many(
            """rel prototypes = </Many/Leaf>
    int[] protoIndices = [0]
    point3f[] positions.timeSamples = {1: [(0, 0, 0)], 5: [(100, 0, 0)]}
    vector3f[] velocities.timeSamples = {1: [(24, 0, 0)], 5: [(0, 0, 0)]}
    quath[] orientations.timeSamples = {1: [(1, 0, 0, 0)]}
    vector3f[] angularVelocities.timeSamples = {1: [(0, 0, 2160)]}""",
            triangle("Leaf"),
        ),
    )
    mesh = read_stage(path, 2)[0].meshes[0]
    # 2160 degrees a second are 90 degrees a frame.
    np.testing.assert_allclose(mesh.points, [(1, 0, 0), (1, 1, 0), (0, 0, 0)], atol=1e-3)


def test_a_stage_without_frames_shows_moving_instances_where_they_start(tmp_path):
    path = write_stage(
        tmp_path,
        many(
            """rel prototypes = </Many/Leaf>
    int[] protoIndices = [0]
    point3f[] positions.timeSamples = {1: [(3, 0, 0)], 5: [(100, 0, 0)]}
    vector3f[] velocities.timeSamples = {1: [(24, 0, 0)], 5: [(0, 0, 0)]}""",
            triangle("Leaf"),
        ),
    )
    np.testing.assert_allclose(read_stage(path)[0].meshes[0].points[0], (3, 0, 0))


def test_positions_without_velocities_are_interpolated(tmp_path):
    samples = "point3f[] positions.timeSamples = {1: [(0, 0, 0)], 3: [(8, 0, 0)]}"
    base = "rel prototypes = </Many/Leaf>\n    int[] protoIndices = [0]"
    path = write_stage(tmp_path, many(base, samples, triangle("Leaf")))
    np.testing.assert_allclose(read_stage(path, 2)[0].meshes[0].points[0], (4, 0, 0))


def test_single_precision_orientations_are_read(tmp_path):
    turn = "quatf[] orientationsf = [(0, 0, 0, 1), (1, 0, 0, 0), (1, 0, 0, 0)]"
    scene, _ = read_text(tmp_path, many(THREE, turn, triangle("Leaf")))
    np.testing.assert_allclose(scene.meshes[0].points[1], (-1, 0, 0), atol=1e-6)


# Prototypes


def test_prototypes_anywhere_are_placed_and_drawn_by_themselves_only_outside(tmp_path):
    crowd = many(
        """rel prototypes = [</Library/Out>, </Many/In>]
    int[] protoIndices = [1, 0]
    point3f[] positions = [(10, 0, 0), (20, 0, 0)]""",
        triangle("In"),
    )
    scene, _ = read_text(tmp_path, crowd, prim("Scope", "Library", triangle("Out")))
    assert sorted(paths(scene)) == ["/Library/Out", "/Many[0]/In", "/Many[1]/Out"]


@pytest.mark.parametrize(
    "library",
    [
        'over "Library"\n{\n    ' + triangle("Leaf") + "}",
        'class "Library"\n{\n    ' + triangle("Leaf") + "}",
        prim("Scope", "Library", 'token visibility = "invisible"', triangle("Leaf")),
    ],
    ids=["over", "class", "invisible parent"],
)
def test_a_hidden_library_of_prototypes_is_not_drawn_by_itself(tmp_path, library):
    crowd = many(THREE.replace("/Many/Leaf", "/Library/Leaf"))
    assert paths(read_text(tmp_path, crowd, library)[0]) == [f"/Many[{k}]/Leaf" for k in range(3)]


def test_parts_of_a_prototype_may_be_invisible_or_of_another_purpose(tmp_path):
    leaf = prim(
        "Xform",
        "Leaf",
        triangle("Seen"),
        triangle("Hidden", 'token visibility = "invisible"'),
        triangle("Proxy", 'uniform token purpose = "proxy"'),
        triangle("Render", 'uniform token purpose = "render"'),
    )
    scene, _ = read_text(tmp_path, many(THREE, leaf))
    assert paths(scene)[0::3] == ["/Many[0]/Leaf/Seen", "/Many[0]/Leaf/Render"]


def test_a_prototype_inherits_the_purpose_of_its_instancer(tmp_path):
    path = write_stage(tmp_path, many(THREE, 'uniform token purpose = "proxy"', triangle("Leaf")))
    assert read_stage(path)[0].meshes == ()
    assert len(read_stage(path, purposes=["proxy"])[0].meshes) == 3


def test_native_instances_are_prototypes_and_hold_instancers(tmp_path):
    tree = prim("Xform", "Tree", triangle("Leaf"))
    crowd = many(
        THREE.replace("</Many/Leaf>", "</Many/Tree>"),
        'def "Tree" (instanceable = true\n references = </Tree>)\n{\n}',
    )
    scene, _ = read_text(tmp_path, crowd, tree)
    assert [path for path in paths(scene) if path.startswith("/Many")] == [
        f"/Many[{k}]/Tree/Leaf" for k in range(3)
    ]
    copies = [
        f'def Xform "{name}" (instanceable = true\n references = </Field>)\n{{\n'
        f"double3 xformOp:translate = (0, {y}, 0)\n"
        'uniform token[] xformOpOrder = ["xformOp:translate"]\n}'
        for name, y in (("A", 100), ("B", 200))
    ]
    inner = THREE.replace("/Many", "/Field/Many")
    field = 'class "Field"\n{\n' + many(inner, triangle("Leaf")) + "}"
    scene, _ = read_text(tmp_path, field, *copies)
    assert paths(scene) == [f"/{n}/Many[{k}]/Leaf" for n in "AB" for k in range(3)]
    np.testing.assert_allclose(origins(scene)[:, 1], [100.0] * 3 + [200.0] * 3)


NESTED = many(
    """rel prototypes = </Outer/Inner>
    int[] protoIndices = [0, 0]
    point3f[] positions = [(0, 100, 0), (0, 200, 0)]""",
    many(
        """rel prototypes = </Outer/Inner/Leaf>
    int[] protoIndices = [0, 0, 0]
    int64[] invisibleIds = [1]
    point3f[] positions = [(1, 0, 0), (2, 0, 0), (3, 0, 0)]
    double3 xformOp:translate = (0, 0, 5)
    uniform token[] xformOpOrder = ["xformOp:translate"]""",
        triangle("Leaf"),
        name="Inner",
    ),
    name="Outer",
)


def test_instancers_in_prototypes_multiply(tmp_path):
    scene, _ = read_text(tmp_path, NESTED)
    assert paths(scene) == [f"/Outer[{a}]/Inner[{b}]/Leaf" for a in (0, 1) for b in (0, 2)]
    expected = [(1, 100, 5), (3, 100, 5), (1, 200, 5), (3, 200, 5)]
    np.testing.assert_allclose(origins(scene), expected)


def test_a_prototype_is_subdivided_once(tmp_path, monkeypatch):
    from usdskin.render import meshes

    calls = []
    subdivide = meshes.subdivide
    monkeypatch.setattr(meshes, "subdivide", lambda *a: calls.append(1) or subdivide(*a))
    leaf = triangle("Leaf").replace('subdivisionScheme = "none"', 'subdivisionScheme = "loop"')
    scene, _ = read_text(tmp_path, many(THREE, leaf), subdivision_level=2)
    assert len(calls) == 1
    assert [len(mesh.triangles) for mesh in scene.meshes] == [16] * 3


def test_shapes_are_coarser_where_they_are_many(tmp_path):
    """500 spheres of 96 rows are 18 million triangles; of 48 rows 4.6, of 24 rows 1.1."""
    crowd = many(
        f"""rel prototypes = </Many/Ball>
    int[] protoIndices = {[0] * 500}
    point3f[] positions = {[(float(k), 0.0, 0.0) for k in range(500)]}""",
        prim("Sphere", "Ball", "double radius = 1"),
    )
    scene, notes = read_text(tmp_path, crowd)
    assert codes(notes) == ["instances-coarse"]
    assert {len(mesh.triangles) for mesh in scene.meshes} == {2 * 48 * (24 - 1)}
    assert "500 instances of shapes are shown, round ones with 48 segments" in notes[0].message


def test_materials_of_prototypes_are_shown(tmp_path):
    leaf = triangle(
        "Leaf", "rel material:binding = </Paint>", metadata='apiSchemas = ["MaterialBindingAPI"]'
    )
    paint = prim("Material", "Paint")
    scene, _ = read_text(tmp_path, many(THREE, leaf), paint)
    assert {mesh.material_paths for mesh in scene.meshes} == {("/Paint",)}


def test_subsets_of_prototypes_in_an_over_show_their_materials(tmp_path):
    """Below an over nothing is defined; instances show it nevertheless."""
    part = prim(
        "GeomSubset",
        "Part",
        'uniform token elementType = "face"',
        'uniform token familyName = "materialBind"',
        "int[] indices = [0]",
        "rel material:binding = </Paint>",
        metadata='apiSchemas = ["MaterialBindingAPI"]',
    )
    crowd = many(THREE.replace("/Many/Leaf", "/Library/Leaf"))
    library = 'over "Library"\n{\n' + triangle("Leaf", part) + "}"
    scene, _ = read_text(tmp_path, crowd, library, prim("Material", "Paint"))
    assert scene.meshes[0].material_paths == ("/Paint",)
    assert "/Paint" in scene.material_index


def test_the_mask_counts_for_the_instancer(tmp_path):
    path = write_stage(tmp_path, many(THREE, triangle("Leaf")))
    assert len(read_stage(path, mask=["/Many"])[0].meshes) == 3
    assert read_stage(path, mask=["/Sky"])[0].meshes == ()


# Primvars


def color(scene, path) -> list[float]:
    return mesh_named(scene, path).primvars["displayColor"][0, 0].tolist()


def test_prototypes_inherit_one_color_each_or_one_for_all(tmp_path):
    colors = "color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1)] ("
    scene, _ = read_text(
        tmp_path, many(THREE, colors, 'interpolation = "vertex")', triangle("Leaf"))
    )
    assert [color(scene, path) for path in paths(scene)] == np.eye(3).tolist()
    constant = "color3f[] primvars:displayColor = [(0.5, 0, 0)]"
    crowd = many(THREE.replace("/Many/Leaf", "/Library/Leaf"), constant)
    scene, _ = read_text(tmp_path, crowd, 'over "Library"\n{\n' + triangle("Leaf") + "}")
    assert color(scene, "/Many[2]/Leaf") == [0.5, 0.0, 0.0]


def test_a_prototypes_own_color_counts_before_its_instancers(tmp_path):
    crowd = many(
        THREE,
        "color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0), (0, 0, 1)] (",
        'interpolation = "uniform")',
        triangle("Leaf", "color3f[] primvars:displayColor = [(0.1, 0.2, 0.3)]"),
    )
    scene, _ = read_text(tmp_path, crowd)
    np.testing.assert_allclose(color(scene, "/Many[1]/Leaf"), (0.1, 0.2, 0.3), atol=1e-7)


# Refusals

CYCLE = many(
    THREE.replace("/Many/Leaf", "/Many/In"),
    many(THREE.replace("/Many/Leaf", "/Many"), name="In"),
)
OTHER_CYCLE = [
    many(THREE.replace("/Many/Leaf", "/B"), name="A"),
    many(THREE.replace("/Many/Leaf", "/A"), name="B"),
]


@pytest.mark.parametrize(
    ("prims", "says"),
    [
        ([CYCLE], "</Many/In>: its prototypes hold the instancer itself"),
        (OTHER_CYCLE, "its prototypes hold the instancer itself"),
        ([prim("Xform", "Up", many(THREE.replace("/Many/Leaf", "/Up")))],
         "</Up/Many>: its prototypes hold the instancer itself"),
        ([many(THREE.replace("[0, 0, 0]", "[0, 0, 7]"), triangle("Leaf"))],
         "protoIndices[2] names prototype 7, but there are 1 (0 to 0)"),
        ([many(THREE.replace("[0, 0, 0]", "[0, -1, 0]"), triangle("Leaf"))],
         "protoIndices[1] names prototype -1"),
        ([many(THREE.replace("[0, 0, 0]", "[0, 0]"), triangle("Leaf"))],
         "positions has 3 values, but protoIndices has 2"),
        ([many(THREE, "float3[] scales = [(1, 1, 1)]", triangle("Leaf"))],
         "scales has 1 values, but protoIndices has 3"),
        ([many(THREE, "int64[] ids = [1, 2]", triangle("Leaf"))], "ids has 2 values"),
        ([many(THREE.replace("(10, 0, 0)", "(nan, 0, 0)"), triangle("Leaf"))],
         "instance 1 has a transform that is not finite"),
        ([many(THREE, "float3 xformOp:scale = (0, 1, 1)",
               'uniform token[] xformOpOrder = ["xformOp:scale"]', triangle("Leaf"))],
         "</Many>: its transform is singular"),
        ([many(THREE.replace("point3f[] positions", "double3[] positions"), triangle("Leaf"))],
         "positions does not hold what its type point3f[] asks for"),
        ([many(THREE)], "prototypes name </Many/Leaf>, which is not there"),
        ([many("int[] protoIndices = [0]")], "but there is none"),
        ([many(THREE, "color3f[] primvars:displayColor = [(1, 0, 0), (0, 1, 0)] (",
               'interpolation = "vertex")', triangle("Leaf"))],
         "primvars:displayColor has 2 values, but vertex interpolation needs 3"),
    ],
    ids=["cycle", "two in a ring", "ancestor", "index", "negative", "positions", "scales", "ids",
         "nan", "flat", "type", "missing", "none", "primvar"],
)  # fmt: skip
def test_what_cannot_be_placed_is_refused_with_where_and_what(tmp_path, prims, says):
    with pytest.raises(UsdSkinError) as caught:
        read_text(tmp_path, *prims)
    assert says in str(caught.value)
    assert "shot.usda </" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_more_instances_than_memory_are_refused_before_they_are_made(tmp_path, monkeypatch):
    from usdskin.render import instance_meshes

    monkeypatch.setattr(instance_meshes, "available_bytes", lambda: 1000)
    with pytest.raises(DeviceError, match="</Many>: 3 instances have 3 triangles, which need"):
        read_text(tmp_path, many(THREE, triangle("Leaf")))


def test_nested_instances_beyond_all_memory_are_refused_at_once(tmp_path):
    """Six levels of a thousand instances are 10^18 triangles."""
    thousand = f"""int[] protoIndices = {[0] * 1000}
    point3f[] positions = {[(0, 0, 0)] * 1000}"""
    text, path = triangle("Leaf"), "Leaf"
    for level in range(6):
        above = "".join(f"/L{k}" for k in range(5, level - 1, -1))
        text = many(f"rel prototypes = <{above}/{path}>", thousand, text, name=f"L{level}")
        path = f"L{level}"
    with pytest.raises(DeviceError, match="1000000000000000000 triangles"):
        read_text(tmp_path, text)


def test_instancers_of_what_is_not_shown_say_so(tmp_path):
    crowd = many(THREE, 'def Points "Leaf"\n{\n}', prim("SphereLight", "Lamp"))
    scene, notes = read_text(tmp_path, crowd)
    assert scene.meshes == ()
    assert sorted(codes(notes)) == ["geometry-not-supported", "light-not-supported"]


@pytest.mark.realdata
@pytest.mark.parametrize(
    "name",
    ["ni_pi", "ni_pi_variant", "ni_pi_xform", "pi", "pi_masking", "pi_ni", "pi_ni2", "pi_ni_pi",
     "pi_ni_pi_ref", "pi_pi", "pi_pi2", "pi_pi_time", "pi_pi_which_rot", "pi_pi_xform",
     "pi_root_prototype", "pi_sibling_pi", "pi_sibling_prototype"],
)  # fmt: skip
def test_openusds_own_instancers_have_the_bounds_that_usd_computes(realdata, tmp_path, name):
    from pxr import Usd, UsdGeom

    tests = realdata / "stages/OpenUSD/pxr/usdImaging/usdImagingGL/testenv"
    file = tests / "testUsdImagingGLPointInstancer" / f"{name}.usda"
    path = write_stage(tmp_path, metadata=f"metersPerUnit = 1\n    subLayers = [@{file}@]")
    stage = Usd.Stage.Open(str(path))
    with Usd.EditContext(stage, stage.GetSessionLayer()):  # authored extents are no measure
        for shape in Usd.PrimRange(stage.GetPseudoRoot(), Usd.PrimAllPrimsPredicate):
            if not shape.IsInPrototype() and shape.GetAttribute("extent").HasAuthoredValue():
                shape.GetAttribute("extent").Block()
    for number in (0.0, 1.0, 2.0, 13.5):
        bounds = UsdGeom.BBoxCache(number, ["default", "render"])
        box = bounds.ComputeWorldBound(stage.GetPseudoRoot()).ComputeAlignedRange()
        points = np.concatenate([mesh.points for mesh in read_stage(path, number)[0].meshes])
        np.testing.assert_allclose(points.min(axis=0), box.GetMin(), atol=2e-3)
        np.testing.assert_allclose(points.max(axis=0), box.GetMax(), atol=2e-3)


def test_velocities_count_from_the_frame_while_the_shutter_is_open(tmp_path):
    """One sample per frame, each of another particle at 24 m/s: half a frame before and after."""
    particles = """rel prototypes = </Many/Leaf>
    int[] protoIndices = [0]
    point3f[] positions.timeSamples = {0: [(-3, 0, 0)], 1: [(2, 0, 0)], 2: [(7, 0, 0)]}
    vector3f[] velocities.timeSamples = {0: [(24, 0, 0)], 1: [(24, 0, 0)], 2: [(24, 0, 0)]}"""
    codes_per_second = "metersPerUnit = 1\n    timeCodesPerSecond = 24"
    stage = write_stage(tmp_path, many(particles, triangle("Leaf")), metadata=codes_per_second)
    for time in (0.75, 1.0, 1.25):
        scene, _ = read_stage(stage, time, base=1.0)
        assert origins(scene)[:, 0] == pytest.approx([2.0 + (time - 1.0)])


def test_instances_that_come_and_go_are_those_of_the_frame(tmp_path):
    """The sample before the frame holds two, and no velocity says where the third came from."""
    particles = """rel prototypes = </Many/Leaf>
    int[] protoIndices.timeSamples = {0: [0, 0], 1: [0, 0, 0]}
    point3f[] positions.timeSamples = {0: [(0, 0, 0), (1, 0, 0)],
        1: [(1, 0, 0), (2, 0, 0), (3, 0, 0)]}"""
    stage = write_stage(tmp_path, many(particles, triangle("Leaf")))
    scene, _ = read_stage(stage, 0.75, base=1.0)
    np.testing.assert_allclose(origins(scene)[:, 0], [1.0, 2.0, 3.0])
