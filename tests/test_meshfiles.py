"""Mesh files: what is read is what the formats say, and what is written is what was read."""

from __future__ import annotations

import dataclasses
import importlib.util
import struct
from pathlib import Path

import numpy as np
import pytest

from usdskin.errors import MeshError, UsageError, UsdSkinError
from usdskin.layers import open_stage
from usdskin.meshfiles import (
    AssetOptions,
    FileMaterial,
    MeshFile,
    angle_weighted_normals,
    faces_where,
    import_mesh,
    keep_faces,
    keep_groups,
    read_mesh_file,
    read_obj,
    through_open3d,
    triangulated,
    weld_points,
    write_asset,
)
from usdskin.meshfiles import materials as asset_materials
from usdskin.meshfiles.edit import drop_degenerate_faces, flip_faces
from usdskin.notes import Note

from pxr import Usd, UsdGeom, UsdShade, UsdValidation  # isort: skip

CUBE_POINTS = np.array(
    [[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)], dtype=np.float64
)
CUBE_FACES = np.array(
    [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
)

needs_open3d = pytest.mark.skipif(
    importlib.util.find_spec("open3d") is None, reason="open3d is not installed (extra 'mesh')"
)


def cube(**changes) -> MeshFile:
    values = {
        "source": Path("cube.obj"),
        "points": CUBE_POINTS,
        "face_counts": np.full(6, 4),
        "face_indices": CUBE_FACES.ravel(),
    }
    return MeshFile(**{**values, **changes})


@pytest.fixture
def obj(tmp_path):
    """Return a function that reads OBJ text, and the notes."""

    def read(text, name="mesh.obj", encoding="utf-8"):
        file = tmp_path / name
        file.write_bytes(text if isinstance(text, bytes) else text.encode(encoding))
        notes: list[Note] = []
        return read_obj(file, notes), notes

    return read


TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\n"


def codes(notes):
    return [note.code for note in notes]


# --- OBJ ---------------------------------------------------------------------------------------


def test_polygons_keep_their_corners_and_every_index_its_own(obj):
    mesh, notes = obj(
        TRIANGLE
        + "v 1 1 0.5\nvt 0 0\nvt 1 0\nvt 0.5 1\nvn 0 0 1\nvn 0 1 0\n"
        + "f 1/1/1 2/2/1 4/3/2 3/1/2\nf 1/3/2 2/2/2 3/1/1\n"
    )
    assert notes == []
    assert mesh.face_counts.tolist() == [4, 3]
    assert mesh.face_indices.tolist() == [0, 1, 3, 2, 0, 1, 2]
    assert mesh.st_indices.tolist() == [0, 1, 2, 0, 2, 1, 0]
    assert mesh.normal_indices.tolist() == [0, 0, 1, 1, 1, 1, 0]
    assert mesh.points[3].tolist() == [1.0, 1.0, 0.5]
    assert mesh.st.tolist() == [[0, 0], [1, 0], [0.5, 1]]


@pytest.mark.parametrize(
    ("faces", "st", "normals"),
    [
        ("f 1 2 3", False, False),
        ("f 1/1 2/1 3/1", True, False),
        ("f 1//1 2//1 3//1", False, True),
        ("f 1/1/1 2/1/1 3/1/1", True, True),
    ],
)
def test_all_four_forms_of_corners_are_read(obj, faces, st, normals):
    mesh, _ = obj(TRIANGLE + "vt 0.5 0.5\nvn 0 0 1\n" + faces)
    assert mesh.face_indices.tolist() == [0, 1, 2]
    assert (mesh.st is not None, mesh.normals is not None) == (st, normals)


def test_forms_may_differ_from_face_to_face(obj):
    mesh, notes = obj(TRIANGLE + "vt 0.5 0.5\nvn 0 0 1\nf 1 2 3\nf 1//1 3//1 2//1\nf 2/1 3/1 1/1\n")
    assert mesh.face_indices.tolist() == [0, 1, 2, 0, 2, 1, 1, 2, 0]
    assert mesh.st.tolist() == [[0.5, 0.5], [0, 0]]
    assert mesh.st_indices.tolist() == [1] * 6 + [0] * 3
    assert mesh.normals is None
    assert codes(notes) == ["st-incomplete", "normals-incomplete"]


def test_negative_indices_count_back_from_their_own_line(obj):
    mesh, _ = obj(
        TRIANGLE + "vt 0.1 0.1\nf -3/-1 -2/-1 -1/-1\nv 5 5 5\nvt 0.9 0.9\nf -4/-2 -2/-1 -1/-1\n"
    )
    assert mesh.face_indices.tolist() == [0, 1, 2, 0, 2, 3]
    assert mesh.st_indices.tolist() == [0, 0, 0, 0, 1, 1]


def test_groups_objects_and_materials_are_sets_of_faces(obj):
    mesh, _ = obj(
        TRIANGLE
        + "o head\ng skin face\nusemtl Face\nf 1 2 3\nusemtl Lips of mine\nf 1 2 3\n"
        + "g skin\nusemtl Face\nf 1 2 3\no eye\ng\nf 1 2 3\n"
    )
    plain = {name: faces.tolist() for name, faces in mesh.groups.items()}
    assert plain == {"skin": [0, 1, 2], "face": [0, 1]}
    assert {k: v.tolist() for k, v in mesh.objects.items()} == {"head": [0, 1, 2], "eye": [3]}
    assert {k: v.tolist() for k, v in mesh.materials.items()} == {
        "Face": [0, 2, 3],
        "Lips of mine": [1],
    }


@pytest.mark.parametrize("feed", ["\n", "\r\n", "\r"])
def test_continued_lines_comments_tabs_and_any_line_ends_are_read(obj, feed):
    text = (
        "\ufeff# head\nv 0 0 0 # here\n  v\t1 0 \\\n   0\nv 0 1 0\n\n#f 9 9 9\nf 1 \\\n 2 \\\n3\n"
    )
    mesh, notes = obj(text.replace("\n", feed))
    assert mesh.points.tolist() == [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
    assert mesh.face_indices.tolist() == [0, 1, 2]
    assert notes == []


def test_last_line_needs_no_line_end(obj):
    mesh, _ = obj(TRIANGLE + "f 1 2 3")
    assert mesh.face_count == 1


def test_vertex_colors_are_srgb_and_read_as_linear(obj):
    """IEC 61966-2-1: 0.5 is 0.2140 linear."""
    mesh, _ = obj("v 0 0 0 1 0.5 0\nv 1 0 0 0 0 0\nv 0 1 0 1 1 1\nf 1 2 3\n")
    assert np.allclose(mesh.colors, [[1, 0.21404, 0], [0, 0, 0], [1, 1, 1]], atol=1e-5)


def test_weight_of_a_vertex_is_no_color(obj):
    mesh, _ = obj("v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n")
    assert mesh.colors is None


def test_what_a_mesh_cannot_hold_is_noted(obj):
    _, notes = obj(TRIANGLE + "l 1 2\ncurv 0 1 1 2\ncurv 0 1 1 2\ns 1\nf 1 2 3\ns 2\nf 1 2\n")
    assert codes(notes) == [
        "short-faces-dropped",
        "smoothing-groups-dropped",
        "obj-statements-ignored",
    ]
    assert "line 10" in notes[0].message
    assert "2 x 'curv'" in notes[2].message


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (TRIANGLE + "f 1 2 4\n", r":4: a face refers to vertex 4, but there are 3"),
        (TRIANGLE + "f 1 2 -4\n", r":4: a face refers to vertex -4"),
        (TRIANGLE + "f 1 2 0\n", r":4: a face refers to vertex 0"),
        (TRIANGLE + "f 1/1 2/1 3/1\n", r":4: a face refers to texture coordinate 1"),
        (TRIANGLE + "vt 0 0\n\nf 1/1 2/1 3\n", r":6: the corners of a face differ in form"),
        (TRIANGLE + "f 1/ 2/ 3/\n", r":4: '1/' is not v, v/vt"),
        (TRIANGLE + "f 1/1/1/1 2/1/1/1 3/1/1/1\n", r":4: '1/1/1/1' is not v"),
        (TRIANGLE + "f 1 2 three\n", r":4: 'three' is not a whole number"),
        (TRIANGLE + "f 1 2 3.5\n", r":4: '3.5' is not a whole number"),
        (TRIANGLE + "v 0 0\nf 1 2 3\n", r":4: a vertex has 2 numbers, not 3"),
        (TRIANGLE + "v 0 zero 0\nf 1 2 3\n", r":4: 'zero' is not a number"),
        (TRIANGLE + "v 0 nan 0\nf 1 2 3\n", r":4: vertex is 0 nan 0, not finite"),
        (TRIANGLE + "v 0 1e999 0\nf 1 2 3\n", r":4: vertex is 0 inf 0, not finite"),
        (TRIANGLE + "v 0 1e39 0\nf 1 2 3\n", r":4: vertex is 0 1e\+39 0, not finite"),
        (TRIANGLE + "vn 0 1\nf 1 2 3\n", r":4: normal: 2 numbers, not 3"),
        (TRIANGLE, r": holds no faces"),
        (TRIANGLE + "f 1 2\n", r": holds no faces"),
        ("hello world\n", r": holds no vertices"),
        ("", r": is empty"),
        ("  \n \n", r": is empty"),
        (bytes(range(256)) * 8, r": is not a text file"),
        (bytes(range(1, 256)) * 8, r": holds no vertices"),
    ],
)
def test_malformed_obj_is_one_line_that_says_where(obj, text, said):
    with pytest.raises(MeshError, match=rf"mesh\.obj{said}") as caught:
        obj(text)
    assert "\n" not in str(caught.value)


def test_missing_file_is_named(tmp_path):
    with pytest.raises(MeshError, match=r"lost\.obj: cannot be read \(No such file"):
        read_obj(tmp_path / "lost.obj")
    with pytest.raises(MeshError, match="cannot be read"):
        read_obj(tmp_path)


def test_kind_that_cannot_be_read_is_refused(tmp_path):
    with pytest.raises(UsageError, match=r"\.fbx: cannot read this kind of file; .*\.obj, \.ply"):
        read_mesh_file(tmp_path / "head.fbx")


def grid_text(side: int) -> str:
    points = "".join(f"v {i % side} {i // side} {i * 0.125:.6f}\n" for i in range(side * side))
    coordinates = "".join(f"vt {i % side} {i // side}\n" for i in range(side * side))
    faces = []
    for row in range(side - 1):
        for column in range(1, side):
            a = row * side + column
            faces.append("f " + " ".join(f"{i}/{i}" for i in (a, a + 1, a + 1 + side, a + side)))
    return points + coordinates + "\n".join(faces) + "\n"


def test_grid_of_26_thousand_quads_is_read_whole(obj):
    text = grid_text(162)
    mesh, _ = obj(text)
    assert mesh.face_count == 161 * 161
    first = mesh.face_indices[:4].tolist()
    assert first == [0, 1, 163, 162]
    assert mesh.points[-1, 2] == (162 * 162 - 1) * 0.125


def test_reader_agrees_with_tinyobjloader(obj, tmp_path):
    tinyobjloader = pytest.importorskip("tinyobjloader")
    text = grid_text(12).replace("f ", "g some\nf ", 1) + "f -1/-1 -2/-2 -3/-3 -4/-4 -5/-5\n"
    mesh, _ = obj(text, "grid.obj")
    reader = tinyobjloader.ObjReader()
    config = tinyobjloader.ObjReaderConfig()
    config.triangulate = False
    assert reader.ParseFromFile(str(tmp_path / "grid.obj"), config)
    points = np.array(reader.GetAttrib().vertices).reshape(-1, 3)
    shapes = reader.GetShapes()
    counts = np.concatenate([shape.mesh.num_face_vertices for shape in shapes])
    corners = [corner for shape in shapes for corner in shape.mesh.indices]
    assert np.allclose(points, mesh.points)
    assert counts.tolist() == mesh.face_counts.tolist()
    assert [corner.vertex_index for corner in corners] == mesh.face_indices.tolist()
    assert [corner.texcoord_index for corner in corners] == mesh.st_indices.tolist()


# --- MTL ---------------------------------------------------------------------------------------

MTL = """newmtl Face
Kd 0.5 0.25 0.125
map_Kd -s 2 2 1 -clamp on my skin.png
d 0.75
Ni 1.4
Pr 0.3
Pm 0.1
map_Bump bump.png
newmtl Lips
Kd 0.6
Tr 0.25
"""


def test_material_file_gives_color_texture_and_surface(obj, tmp_path):
    (tmp_path / "head one.mtl").write_text(MTL)
    (tmp_path / "my skin.png").write_bytes(b"")
    text = "mtllib head one.mtl\n" + TRIANGLE + "usemtl Face\nf 1 2 3\nusemtl Lips\nf 1 2 3\n"
    mesh, notes = obj(text)
    face, lips = mesh.definitions["Face"], mesh.definitions["Lips"]
    assert face.diffuse_color == (0.5, 0.25, 0.125)
    assert face.diffuse_texture == tmp_path / "my skin.png"
    assert (face.opacity, face.ior, face.roughness, face.metallic) == (0.75, 1.4, 0.3, 0.1)
    assert lips.diffuse_color == (0.6, 0.6, 0.6)
    assert lips.opacity == 0.75
    assert mesh.companions == (tmp_path / "head one.mtl", tmp_path / "my skin.png")
    assert codes(notes) == ["texture-options-ignored", "mtl-statements-ignored"]


def test_missing_material_file_and_texture_are_noted(obj, tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl A\nmap_Kd lost.png\n")
    _, notes = obj("mtllib a.mtl b.mtl\n" + TRIANGLE + "usemtl A\nf 1 2 3\n")
    assert codes(notes) == ["material-file-missing", "texture-missing"]


@pytest.mark.parametrize("line", ["Kd 1 2", "Kd red", "d 2", "Ni none", "Kd nan 0 0"])
def test_wrong_number_in_a_material_file_is_an_error_with_its_line(obj, tmp_path, line):
    (tmp_path / "a.mtl").write_text(f"newmtl A\n{line}\n")
    with pytest.raises(MeshError, match=r"a\.mtl:2: "):
        obj("mtllib a.mtl\n" + TRIANGLE + "usemtl A\nf 1 2 3\n")


# --- Editing -----------------------------------------------------------------------------------


def test_crop_above_a_height_keeps_faces_that_lie_there_whole(obj):
    mesh = cube(
        groups={"top": np.array([3]), "sides": np.array([0, 1, 4, 5]), "bottom": np.array([2])},
        st=np.arange(12.0).reshape(6, 2),
        st_indices=np.repeat(np.arange(6), 4),
    )
    kept = keep_faces(mesh, faces_where(mesh, lambda points: points[:, 1] > 0.5))
    assert kept.face_count == 1
    assert len(kept.points) == 4
    assert (kept.points[:, 1] == 1.0).all()
    assert {name: faces.tolist() for name, faces in kept.groups.items()} == {"top": [0]}
    assert kept.st.tolist() == [[6.0, 7.0]]
    assert np.array_equal(kept.points[kept.face_indices], mesh.points[CUBE_FACES[3]])


def test_groups_are_kept_by_name_and_a_wrong_name_tells_the_near_ones():
    mesh = cube(groups={"body": np.array([0, 2]), "joint": np.array([1])})
    kept = keep_groups(mesh, ["body"])
    assert kept.face_count == 2
    assert list(kept.groups) == ["body"]
    with pytest.raises(UsageError, match="no group named 'bodi'; it has body"):
        keep_groups(mesh, ["bodi"])


def test_nothing_left_is_an_error():
    with pytest.raises(MeshError, match="no face is left"):
        keep_faces(cube(), np.zeros(6, dtype=bool))


def test_welding_joins_positions_and_keeps_corner_values():
    split = cube(
        points=CUBE_POINTS[CUBE_FACES.ravel()],
        face_indices=np.arange(24),
        st=np.arange(48.0).reshape(24, 2),
        st_indices=np.arange(24),
    )
    welded = weld_points(split)
    assert len(welded.points) == 8
    assert np.array_equal(welded.points[welded.face_indices], split.points)
    assert np.array_equal(welded.st_indices, split.st_indices)


def test_fans_cover_each_polygon_and_remember_it():
    mesh = MeshFile(
        source=Path("pentagon.obj"),
        points=np.array([[0, 0, 0], [2, 0, 0], [3, 1, 0], [1, 2, 0], [0, 1, 0]], dtype=float),
        face_counts=np.array([5, 3]),
        face_indices=np.array([0, 1, 2, 3, 4, 0, 1, 2]),
        groups={"b": np.array([1])},
    )
    triangles, parents = triangulated(mesh)
    assert parents.tolist() == [0, 0, 0, 1]
    assert triangles.face_indices.reshape(-1, 3).tolist() == [
        [0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 1, 2],
    ]  # fmt: skip
    assert triangles.groups["b"].tolist() == [3]


def test_normals_of_a_cube_point_along_its_diagonals():
    normals = angle_weighted_normals(cube())
    expected = (2.0 * CUBE_POINTS - 1.0) / np.sqrt(3.0)
    assert np.allclose(normals, expected)


def test_normals_do_not_depend_on_how_polygons_are_cut():
    """The law that angle weights are for (Thuermer and Wuethrich 1998)."""
    assert np.allclose(
        angle_weighted_normals(cube()), angle_weighted_normals(triangulated(cube())[0])
    )


def test_normal_of_a_concave_polygon_is_that_of_its_plane():
    arrow = MeshFile(
        source=Path("arrow.obj"),
        points=np.array([[0, 0, 0], [2, 1, 0], [0, 2, 0], [0.5, 1, 0]]),
        face_counts=np.array([4]),
        face_indices=np.array([0, 1, 2, 3]),
    )
    assert np.allclose(angle_weighted_normals(arrow), (0, 0, 1))


def test_flipping_twice_changes_nothing_and_once_turns_the_normals():
    mesh = cube(st=np.zeros((24, 2)), st_indices=np.arange(24))
    every = np.ones(6, dtype=bool)
    turned = flip_faces(mesh, every)
    assert np.allclose(angle_weighted_normals(turned), -angle_weighted_normals(mesh))
    back = flip_faces(turned, every)
    assert np.array_equal(back.face_indices, mesh.face_indices)
    assert np.array_equal(back.st_indices, mesh.st_indices)


def test_repeated_and_degenerate_faces_are_dropped():
    faces = np.concatenate([CUBE_FACES, [[1, 0, 2, 3], [4, 4, 6, 7]]])
    mesh = cube(face_counts=np.full(8, 4), face_indices=faces.ravel())
    sound = drop_degenerate_faces(mesh)
    assert np.array_equal(sound.face_indices, CUBE_FACES.ravel())


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"face_indices": np.where(CUBE_FACES.ravel() == 7, 8, CUBE_FACES.ravel())}, "vertex 8"),
        ({"points": np.where(CUBE_POINTS == 1.0, np.nan, CUBE_POINTS)}, "nan"),
        ({"face_counts": np.full(12, 2)}, "fewer than 3"),
        ({"face_counts": np.zeros(0), "face_indices": np.zeros(0)}, "no faces"),
    ],
)
def test_broken_arrays_from_any_reader_are_refused(changes, said):
    with pytest.raises(MeshError, match=f"cube.obj: .*{said}"):
        cube(**changes)


# --- The asset ---------------------------------------------------------------------------------


OPEN_STAGES: list[Usd.Stage] = []
"""A prim is good for as long as somebody holds its stage."""


@pytest.fixture(autouse=True)
def close_stages():
    yield
    OPEN_STAGES.clear()


def written(path: Path):
    stage = open_stage(path)
    OPEN_STAGES.append(stage)
    root = stage.GetDefaultPrim()
    mesh = UsdGeom.Mesh(root.GetChild("mesh"))
    assert mesh
    return stage, root, mesh


def test_asset_holds_the_polygons_as_they_were(tmp_path):
    mesh = cube(
        source=_source(tmp_path),
        st=np.array([[0, 0], [1, 0], [1, 1], [0, 1]], dtype=float),
        st_indices=np.tile(np.arange(4), 6),
        colors=np.full((8, 3), 0.25, dtype=np.float32),
    )
    path = write_asset(mesh, tmp_path / "cube.usda", AssetOptions(meters_per_unit=1.0, up_axis="Z"))
    stage, root, usd_mesh = written(path)
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert Usd.ModelAPI(root).GetKind() == "component"
    assert np.allclose(usd_mesh.GetPointsAttr().Get(), CUBE_POINTS)
    assert list(usd_mesh.GetFaceVertexIndicesAttr().Get()) == CUBE_FACES.ravel().tolist()
    assert np.allclose(usd_mesh.GetExtentAttr().Get(), [[0, 0, 0], [1, 1, 1]])
    assert usd_mesh.GetSubdivisionSchemeAttr().Get() == "catmullClark"
    assert not usd_mesh.GetNormalsAttr().HasAuthoredValue()
    st = UsdGeom.PrimvarsAPI(usd_mesh).GetPrimvar("st")
    assert st.GetInterpolation() == "faceVarying"
    assert list(st.GetIndices()) == [0, 1, 2, 3] * 6
    color = UsdGeom.PrimvarsAPI(usd_mesh).GetPrimvar("displayColor")
    assert color.GetInterpolation() == "vertex"


def _source(folder: Path) -> Path:
    source = folder / "cube.obj"
    source.write_text("v 0 0 0\n")
    return source


def test_asset_passes_usds_own_validators(tmp_path):
    mesh = cube(
        source=_source(tmp_path),
        groups={"front": np.array([0]), "all": np.arange(6)},
        objects={"lower half": np.array([0, 1, 2])},
        materials={"A": np.array([0, 1]), "B.001": np.array([2, 3, 4, 5])},
        definitions={"A": FileMaterial(diffuse_color=(0.5, 0.3, 0.2))},
    )
    path = write_asset(mesh, tmp_path / "cube.usda")
    stage = open_stage(path)
    registry = UsdValidation.ValidationRegistry()
    context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
    found = [f"{error.GetName()}: {error.GetMessage()}" for error in context.Validate(stage)]
    assert found == []


def test_groups_become_subsets_and_materials_bind(tmp_path):
    mesh = cube(
        source=_source(tmp_path),
        groups={"front": np.array([0]), "both": np.array([0, 1])},
        objects={"front": np.array([2])},
        materials={"Face.001": np.array([0, 1]), "Teeth": np.array([2, 3, 4, 5])},
    )
    path = write_asset(mesh, tmp_path / "cube.usda", AssetOptions(skin=("Face.001",)))
    stage, root, usd_mesh = written(path)
    subsets = {s.GetPrim().GetName(): s for s in UsdGeom.Subset.GetAllGeomSubsets(usd_mesh)}
    assert set(subsets) == {"front", "both", "front_2", "Face_001", "Teeth"}
    assert subsets["front"].GetFamilyNameAttr().Get() == "group"
    assert subsets["front_2"].GetFamilyNameAttr().Get() == "object"
    assert subsets["front_2"].GetPrim().GetDisplayName() == "front"
    assert list(subsets["Teeth"].GetIndicesAttr().Get()) == [2, 3, 4, 5]
    family = UsdGeom.Subset.GetFamilyType
    assert family(usd_mesh, "group") == "unrestricted"
    assert family(usd_mesh, "object") == "nonOverlapping"
    assert family(usd_mesh, "materialBind") == "partition"
    bound = UsdShade.MaterialBindingAPI(subsets["Face_001"].GetPrim()).ComputeBoundMaterial()[0]
    assert bound.GetPath() == root.GetPath().AppendPath("materials/Face_001")
    assert bound.GetPrim().HasAPI("SkinMaterialAPI")
    assert not stage.GetPrimAtPath(root.GetPath().AppendPath("materials/Teeth")).HasAPI(
        "SkinMaterialAPI"
    )


def test_faces_without_a_material_get_the_first(tmp_path):
    mesh = cube(source=_source(tmp_path), materials={"A": np.array([0]), "B": np.array([1])})
    notes: list[Note] = []
    _, _, usd_mesh = written(write_asset(mesh, tmp_path / "cube.usda", notes=notes))
    assert "faces-without-material" in codes(notes)
    bound = UsdShade.MaterialBindingAPI(usd_mesh.GetPrim()).ComputeBoundMaterial()[0]
    assert bound.GetPrim().GetName() == "A"


def test_color_of_the_file_is_lifted_to_the_skins_reflectance(tmp_path):
    color = (0.5, 0.3, 0.2)
    mesh = cube(
        source=_source(tmp_path),
        materials={"A": np.arange(6)},
        definitions={"A": FileMaterial(diffuse_color=color)},
    )
    _, root, _ = written(write_asset(mesh, tmp_path / "cube.usda"))
    material = root.GetChild("materials").GetChild("A")
    from usdskin.prims import read_skin

    reflectance = read_skin(material).reflectance
    assert np.allclose(asset_materials._rgb(reflectance), color, atol=1e-6)
    surface = UsdShade.Shader(material.GetChild("surface"))
    assert np.allclose(surface.GetInput("diffuseColor").Get(), color)


def test_measured_skin_stands_in_where_the_file_has_no_color(tmp_path, monkeypatch):
    data = tmp_path / "usdskin" / "data"
    data.mkdir(parents=True)
    (data / "skin_reference.csv").write_text(
        "# measured\nwavelength_nm,reflectance,scattering\n400,0.2,0.1\n700,0.6,0.5\n"
    )
    monkeypatch.setattr(asset_materials.resources, "files", lambda _: tmp_path / "usdskin")
    notes: list[Note] = []
    path = write_asset(cube(source=_source(tmp_path)), tmp_path / "cube.usda", notes=notes)
    _, root, _ = written(path)
    from usdskin.prims import read_skin

    skin = read_skin(root.GetChild("materials").GetChild("skin"))
    assert skin.reflectance.value.tolist() == [0.2, 0.6]
    assert skin.scattering.value.tolist() == [0.1, 0.5]
    assert notes == []


def test_texture_is_named_from_the_assets_folder_and_is_the_skins_albedo(obj, tmp_path):
    (tmp_path / "a.mtl").write_text("newmtl A\nKd 1 1 1\nmap_Kd skin.png\n")
    (tmp_path / "skin.png").write_bytes(b"")
    text = "mtllib a.mtl\n" + TRIANGLE + "vt 0 0\nusemtl A\nf 1/1 2/1 3/1\n"
    mesh, _ = obj(text)
    (tmp_path / "out").mkdir()
    _, root, _ = written(write_asset(mesh, tmp_path / "out" / "head.usda"))
    material = root.GetChild("materials").GetChild("A")
    asset = material.GetAttribute("inputs:skin:albedo:file").Get()
    assert asset.path == "../skin.png"
    assert Path(asset.resolvedPath) == tmp_path / "skin.png"
    assert UsdShade.Shader(material.GetChild("diffuse")).GetInput("file").Get().path == asset.path


def test_read_back_material_is_skin(tmp_path):
    from usdskin.render.materials import SkinMaterial, bound_material, read_materials

    stage, _, usd_mesh = written(
        write_asset(cube(source=_source(tmp_path)), tmp_path / "cube.usda")
    )
    path = bound_material(usd_mesh.GetPrim())
    found = read_materials(stage, [path], Usd.TimeCode.Default(), [])
    assert isinstance(found[path], SkinMaterial)


def test_triangles_get_normals_and_no_subdivision(tmp_path):
    triangles = dataclasses.replace(triangulated(cube())[0], source=_source(tmp_path))
    _, _, usd_mesh = written(write_asset(triangles, tmp_path / "cube.usda"))
    assert usd_mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert usd_mesh.GetNormalsInterpolation() == "vertex"
    assert np.allclose(usd_mesh.GetNormalsAttr().Get(), angle_weighted_normals(cube()), atol=1e-6)


def test_normals_of_the_file_stay_at_its_corners_as_unit_vectors(tmp_path):
    triangles = dataclasses.replace(
        triangulated(cube())[0],
        source=_source(tmp_path),
        normals=np.array([[0, 0, 2.0], [3.0, 0, 0]]),
        normal_indices=np.arange(36) % 2,
    )
    _, _, usd_mesh = written(write_asset(triangles, tmp_path / "cube.usda"))
    normals = np.asarray(usd_mesh.GetNormalsAttr().Get())
    assert usd_mesh.GetNormalsInterpolation() == "faceVarying"
    assert normals[:2].tolist() == [[0, 0, 1], [1, 0, 0]]


def test_loop_is_refused_for_quads(tmp_path):
    with pytest.raises(UsageError, match="triangles only"):
        write_asset(cube(), tmp_path / "cube.usda", AssetOptions(scheme="loop"))


# --- The step ----------------------------------------------------------------------------------


@pytest.fixture
def quad(tmp_path):
    file = tmp_path / "quad.obj"
    file.write_text(
        "v 0 0 0\nv 20 0 0\nv 20 30 0\nv 0 30 0\nvt 0 0.25\ng one\nf 1/1 2/1 3/1 4/1\n"
        "g two\nf 4/1 3/1 2/1 1/1\n"
    )
    return file


def test_import_writes_an_asset_with_its_origin(quad, tmp_path):
    notes: list[Note] = []
    path = import_mesh(quad, tmp_path / "head.usda", units="mm", up_axis="z", notes=notes)
    stage, root, _ = written(path)
    assert root.GetName() == "head"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.001
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    record = stage.GetRootLayer().customLayerData["usdskin"]["importMesh"]
    assert list(record["inputs"]) == ["./quad.obj"]
    assert record["settings"]["units"] == "mm"
    assert "units-assumed" not in codes(notes)
    assert not list(tmp_path.glob(".*"))


def test_unit_that_nobody_states_is_noted_with_the_size_it_gives(quad, tmp_path):
    notes: list[Note] = []
    stage, _, _ = written(import_mesh(quad, tmp_path / "head.usda", notes=notes))
    assert UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert "0.3 m" in next(note.message for note in notes if note.code == "units-assumed")


@pytest.mark.parametrize(("size", "meters"), [(0.28, 1.0), (280.0, 0.001), (17.0, 0.1)])
def test_guessed_unit_makes_a_head_or_a_body_and_says_so(tmp_path, size, meters):
    file = tmp_path / "a.obj"
    file.write_text(f"v 0 0 0\nv {size} 0 0\nv 0 {size / 2} 0\nf 1 2 3\n")
    notes: list[Note] = []
    path = import_mesh(file, tmp_path / "a.usda", units="auto", notes=notes)
    assert UsdGeom.GetStageMetersPerUnit(open_stage(path)) == meters
    assert "units-guessed" in codes(notes)


def test_groups_options_crop_and_v_is_turned_over(quad, tmp_path):
    path = import_mesh(quad, tmp_path / "head.usda", groups=["two"], flip_v=True)
    _, _, usd_mesh = written(path)
    assert list(usd_mesh.GetFaceVertexCountsAttr().Get()) == [4]
    assert np.allclose(UsdGeom.PrimvarsAPI(usd_mesh).GetPrimvar("st").Get(), [[0, 0.75]])


def test_normals_option_makes_a_polygon_mesh_with_normals(quad, tmp_path):
    _, _, usd_mesh = written(
        import_mesh(quad, tmp_path / "head.usda", groups=["one"], normals=True)
    )
    assert usd_mesh.GetSubdivisionSchemeAttr().Get() == "none"
    assert np.allclose(usd_mesh.GetNormalsAttr().Get(), (0, 0, 1))


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"units": "parsec"}, "--units parsec"),
        ({"up_axis": "x"}, "--up x"),
        ({"scheme": "doosabin"}, "--subdivide doosabin"),
        ({"normals": True, "scheme": "catmullClark"}, "--normals has no effect"),
        ({"decimate_to": 2}, "--decimate 2"),
        ({"groups": ["three"]}, "no group named 'three'"),
        ({"skin": ["Face"]}, "no material named 'Face'"),
        ({"output": "quad.obj"}, "end its name in .usda"),
    ],
)
def test_wrong_option_is_refused_and_nothing_is_written(quad, tmp_path, options, said):
    output = tmp_path / options.pop("output", "head.usda")
    before = sorted(tmp_path.iterdir())
    with pytest.raises(UsageError, match=said):
        import_mesh(quad, output, **options)
    assert sorted(tmp_path.iterdir()) == before


def test_missing_open3d_names_the_extra(monkeypatch, tmp_path):
    (tmp_path / "a.ply").write_text("ply\n")
    monkeypatch.setitem(__import__("sys").modules, "open3d", None)
    monkeypatch.setattr(through_open3d.platform, "libc_ver", lambda: ("glibc", "2.36"))
    with pytest.raises(UsdSkinError, match=r"need open3d.*pip install 'usdskin\[mesh\]'"):
        import_mesh(tmp_path / "a.ply", tmp_path / "a.usda")


def test_missing_system_library_names_the_packages(monkeypatch):
    monkeypatch.setattr(through_open3d.platform, "libc_ver", lambda: ("glibc", "2.36"))
    error = OSError("libusb-1.0.so.0: cannot open shared object file: No such file or directory")
    said = through_open3d._why_missing(error)
    assert "libusb-1.0.so.0" in said
    assert "apt-get install" in said and "libusb-1.0-0" in said


def test_old_glibc_is_what_the_message_says(monkeypatch):
    monkeypatch.setattr(through_open3d.platform, "libc_ver", lambda: ("glibc", "2.34"))
    said = through_open3d._why_missing(ModuleNotFoundError(name="open3d"))
    assert "needs glibc 2.35" in said and "finds 2.34" in said and "OBJ" in said


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.ply", b"", "is empty"),
        ("a.ply", b"\x93\x01\x02\x03" * 50, "does not begin like a PLY"),
        ("a.glb", b"\x93\x01\x02\x03" * 50, "does not begin like a GLB"),
    ],
)
def test_junk_is_refused_before_open3d_is_needed(tmp_path, name, content, said):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=rf"{name}: .*{said}"):
        import_mesh(tmp_path / name, tmp_path / "a.usda")


# --- Through open3d ----------------------------------------------------------------------------

PLY = """ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 1
property list uchar int vertex_indices
end_header
0 0 0 255 0 0
1 0 0 255 0 0
1 1 0 255 0 0
0 1 0 255 0 0
4 0 1 2 3
"""


@needs_open3d
def test_ply_comes_as_triangles_with_linear_colors(tmp_path):
    (tmp_path / "a.ply").write_text(PLY)
    notes: list[Note] = []
    mesh = read_mesh_file(tmp_path / "a.ply", notes)
    assert mesh.face_counts.tolist() == [3, 3]
    assert np.allclose(mesh.colors, (1, 0, 0))
    assert codes(notes) == ["polygons-cut"]


@needs_open3d
def test_stl_is_welded(tmp_path):
    facets = b""
    for face in ((0, 1, 3), (0, 3, 2)):
        corners = CUBE_POINTS[list(face)].astype("<f4").tobytes()
        facets += struct.pack("<3f", 0, 0, 0) + corners + b"\0\0"
    (tmp_path / "a.stl").write_bytes(b"\0" * 80 + struct.pack("<I", 2) + facets)
    mesh = read_mesh_file(tmp_path / "a.stl")
    assert len(mesh.points) == 4
    assert mesh.face_count == 2
    assert mesh.normals is None


@needs_open3d
@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", PLY.replace("4 0 1 2 3", "4 0 1 2 9").encode()),
        ("a.ply", PLY.replace("0 1 0 255", "nan 1 0 255").encode()),
        ("a.ply", b"ply\nnonsense\n"),
        ("a.ply", PLY[: PLY.index("0 0 0 255")].encode()),
        ("a.off", b"OFF\n1 1 0\n0 0 0\n3 0 5 9\n"),
        ("a.off", b"hello\n"),
        ("a.stl", b"hello\n"),
        ("a.glb", b"glTF\x02\0\0\0\x14\0\0\0"),
        ("a.glb", b"glTF\x02\0\0\0\x30\0\0\0\x10\0\0\0JSON{broken json   "),
        ("a.gltf", b"{}"),
        ("a.gltf", b"[1, 2]"),
    ],
)
def test_malformed_file_through_open3d_is_one_line(tmp_path, capfd, name, content):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(MeshError, match=name) as caught:
        import_mesh(tmp_path / name, tmp_path / "out.usda")
    assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")
    assert not (tmp_path / "out.usda").exists()


@needs_open3d
def test_decimation_keeps_shape_groups_and_says_what_it_lost(tmp_path):
    side = 30
    text = grid_text(side).replace("f ", "g left\nf ", 1)
    (tmp_path / "a.obj").write_text(text)
    notes: list[Note] = []
    path = import_mesh(tmp_path / "a.obj", tmp_path / "a.usda", decimate_to=200, notes=notes)
    _, _, usd_mesh = written(path)
    assert len(usd_mesh.GetFaceVertexCountsAttr().Get()) <= 200
    assert "decimation-drops-attributes" in codes(notes)
    before = read_obj(tmp_path / "a.obj").points
    extent = np.asarray(usd_mesh.GetExtentAttr().Get())
    assert np.allclose(extent, [before.min(0), before.max(0)], atol=1.0)
    subset = UsdGeom.Subset.GetAllGeomSubsets(usd_mesh)[0]
    assert len(subset.GetIndicesAttr().Get()) == len(usd_mesh.GetFaceVertexCountsAttr().Get())


@needs_open3d
def test_repair_turns_drops_and_joins_but_keeps_quads():
    from usdskin.meshfiles.remesh import repair

    faces = CUBE_FACES.copy()
    faces[2] = faces[2][::-1]
    broken = cube(
        points=np.concatenate([CUBE_POINTS, CUBE_POINTS[:1], [[0.5, 0.5, 3.0]]]),
        face_counts=np.array([4] * 7 + [3]),
        face_indices=np.concatenate([faces.ravel(), [8, 1, 3, 2], [0, 1, 9]]),
    )
    notes: list[Note] = []
    mended = repair(broken, notes)
    assert mended.face_counts.tolist() == [4] * 6
    assert len(mended.points) == 8
    # Every point of a closed cube, turned outwards, has the normal of its diagonal.
    outwards = (2.0 * mended.points - 1.0) / np.sqrt(3.0)
    assert np.allclose(angle_weighted_normals(mended), outwards)
    assert codes(notes) == ["mesh-repaired"]


@needs_open3d
def test_scene_of_a_gltf_comes_in_place_with_materials_and_texture(tmp_path):
    _write_gltf(tmp_path)
    mesh = read_mesh_file(tmp_path / "a.gltf")
    assert (mesh.meters_per_unit, mesh.up_axis) == (1.0, "Y")
    assert np.allclose(mesh.points.min(axis=0), (10, 0, 0))
    assert np.allclose(mesh.points.max(axis=0), (11, 1, 0))
    # glTF counts v from the top: the corner at (0, 0) of the mesh is at the bottom left.
    corner = int(np.flatnonzero((mesh.points == (10, 0, 0)).all(axis=1))[0])
    at = int(np.flatnonzero(mesh.face_indices == corner)[0])
    assert np.allclose(mesh.st[mesh.st_indices[at]], (0.0, 0.0))
    assert list(mesh.materials) == ["Cheek"]
    given = mesh.definitions["Cheek"]
    assert given.diffuse_texture == tmp_path / "skin.png"
    assert np.allclose(given.diffuse_scale, (1.0, 0.5, 0.25))
    _, root, _ = written(write_asset(mesh, tmp_path / "a.usda"))
    material = root.GetChild("materials").GetChild("Cheek")
    node = UsdShade.Shader(material.GetChild("diffuse"))
    assert node.GetInput("file").Get().path == "./skin.png"
    assert np.allclose(node.GetInput("scale").Get(), (1.0, 0.5, 0.25, 1.0))


def _write_gltf(folder: Path) -> None:
    import json

    from usdskin.image_output import write_png

    write_png(folder / "skin.png", np.full((4, 4, 3), 128, dtype=np.uint8))
    points = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], dtype="<f4")
    uvs = np.array([[0, 1], [1, 1], [1, 0], [0, 0]], dtype="<f4")
    indices = np.array([0, 1, 2, 0, 2, 3], dtype="<u2")
    blob = points.tobytes() + uvs.tobytes() + indices.tobytes()
    (folder / "a.bin").write_bytes(blob)
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "translation": [10, 0, 0], "name": "plate"}],
        "meshes": [
            {
                "primitives": [
                    {
                        "attributes": {"POSITION": 0, "TEXCOORD_0": 1},
                        "indices": 2,
                        "material": 0,
                    }
                ]
            }
        ],
        "materials": [
            {
                "name": "Cheek",
                "pbrMetallicRoughness": {
                    "baseColorTexture": {"index": 0},
                    "baseColorFactor": [1.0, 0.5, 0.25, 1.0],
                },
            }
        ],
        "textures": [{"source": 0}],
        "images": [{"uri": "skin.png"}],
        "buffers": [{"uri": "a.bin", "byteLength": len(blob)}],
        "bufferViews": [
            {"buffer": 0, "byteOffset": 0, "byteLength": 48},
            {"buffer": 0, "byteOffset": 48, "byteLength": 32},
            {"buffer": 0, "byteOffset": 80, "byteLength": 12},
        ],
        "accessors": [
            {
                "bufferView": 0,
                "componentType": 5126,
                "count": 4,
                "type": "VEC3",
                "min": [0, 0, 0],
                "max": [1, 1, 0],
            },
            {"bufferView": 1, "componentType": 5126, "count": 4, "type": "VEC2"},
            {"bufferView": 2, "componentType": 5123, "count": 6, "type": "SCALAR"},
        ],
    }
    (folder / "a.gltf").write_text(json.dumps(document))


# --- Real heads --------------------------------------------------------------------------------


@pytest.mark.realdata
def test_ict_head_keeps_its_quads_and_materials(realdata, tmp_path):
    source = realdata / "heads" / "ict_facekit" / "generic_neutral_mesh.obj"
    mesh = read_obj(source)
    assert (len(mesh.points), mesh.face_count) == (26719, 26384)
    assert len(mesh.materials) == 12
    assert sum(map(len, mesh.materials.values())) == mesh.face_count
    path = import_mesh(source, tmp_path / "ict.usda", units="cm", groups=["M_Face", "M_BackHead"])
    stage, _, usd_mesh = written(path)
    assert usd_mesh.GetSubdivisionSchemeAttr().Get() == "catmullClark"
    size = np.ptp(np.asarray(usd_mesh.GetExtentAttr().Get()), axis=0)
    assert 0.2 < size[1] * UsdGeom.GetStageMetersPerUnit(stage) < 0.45


@pytest.mark.realdata
def test_makehuman_body_loses_its_helpers(realdata, tmp_path):
    source = realdata / "heads" / "makehuman" / "base.obj"
    path = import_mesh(source, tmp_path / "body.usda", units="dm", groups=["body"])
    stage, _, usd_mesh = written(path)
    counts = np.asarray(usd_mesh.GetFaceVertexCountsAttr().Get())
    assert (counts == 4).all() and 12000 < len(counts) < 18486
    size = np.ptp(np.asarray(usd_mesh.GetExtentAttr().Get()), axis=0)
    assert 1.5 < size[1] * UsdGeom.GetStageMetersPerUnit(stage) < 1.9


@pytest.mark.realdata
def test_perry_smith_scan_keeps_its_normals(realdata, tmp_path):
    source = realdata / "heads" / "leeperrysmith" / "LeePerrySmith.obj"
    _, _, usd_mesh = written(import_mesh(source, tmp_path / "lps.usda"))
    assert usd_mesh.GetSubdivisionSchemeAttr().Get() == "none"
    # The file has a normal for each vertex, at the same index.
    assert usd_mesh.GetNormalsInterpolation() == "vertex"
    assert len(usd_mesh.GetNormalsAttr().Get()) == 9223


@needs_open3d
@pytest.mark.realdata
def test_perry_smith_is_the_same_from_obj_and_glb(realdata):
    folder = realdata / "heads" / "leeperrysmith"
    obj = weld_points(read_mesh_file(folder / "LeePerrySmith.obj"))
    glb = read_mesh_file(folder / "LeePerrySmith.glb")
    assert glb.meters_per_unit == 1.0
    assert len(glb.points) == len(obj.points)
    assert np.allclose(glb.points[glb.face_indices], obj.points[obj.face_indices], atol=1e-6)
    assert np.allclose(glb.st[glb.st_indices], obj.st[obj.st_indices], atol=1e-6)
