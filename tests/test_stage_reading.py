"""What a stage says at a frame reaches the scene: time, composition, bindings, handedness.

The rows of a renderer's checklist for USD. What one module reads by itself is tested beside it;
here whole stages are read, as a picture of them would be.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import (
    HEAD,
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
from test_scene import DARK, TEXTURE, WHITE, assert_colors, colored, quad, stage_text, surface
from test_scene import here as here
from test_scene import render as render_text

from usdskin import cli
from usdskin.errors import MeshError
from usdskin.image_output import Part, write_exr, write_png
from usdskin.images import read_image

# isort: split
# After ours, which register the schemas.
from pxr import Sdf, Usd, UsdGeom, UsdUtils

POINTS = "point3f[] points = [(0, 0, 0), (1, 0, 0), (0, 1, 0)]"
BINDS = 'apiSchemas = ["MaterialBindingAPI"]'


def animated(name: str, *parts: str, points: str = POINTS, metadata: str = "") -> str:
    """Return a triangle whose points are given."""
    return triangle(name, *parts, metadata=metadata).replace(POINTS, points)


def first_points(path: Path, number: float | None = None) -> np.ndarray:
    return read_stage(path, number)[0].meshes[0].points


# Time


def test_points_are_interpolated_between_samples(tmp_path):
    samples = """point3f[] points.timeSamples = {
        1: [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        3: [(0, 0, 8), (1, 0, 8), (0, 1, 8)]
    }"""
    path = write_stage(tmp_path, animated("A", points=samples))
    for number, z in ((0.0, 0.0), (1.0, 0.0), (1.5, 2.0), (2.0, 4.0), (3.0, 8.0), (9.0, 8.0)):
        np.testing.assert_allclose(first_points(path, number)[:, 2], z)


def test_points_whose_number_changes_are_held(tmp_path):
    samples = """point3f[] points.timeSamples = {
        1: [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        3: [(0, 0, 8), (1, 0, 8), (1, 1, 8), (0, 1, 8)]
    }
    int[] faceVertexCounts.timeSamples = {1: [3], 3: [4]}
    int[] faceVertexIndices.timeSamples = {1: [0, 1, 2], 3: [0, 1, 2, 3]}"""
    path = write_stage(tmp_path, animated("A", points=samples))
    assert len(read_stage(path, 2.9)[0].meshes[0].triangles) == 1
    assert len(read_stage(path, 3)[0].meshes[0].triangles) == 2
    np.testing.assert_allclose(first_points(path, 2.9)[:, 2], 0.0)


def test_topology_and_points_that_disagree_at_a_time_are_refused_there_only(tmp_path):
    samples = """point3f[] points.timeSamples = {
        1: [(0, 0, 0), (1, 0, 0), (0, 1, 0)],
        3: [(0, 0, 8)]
    }"""
    path = write_stage(tmp_path, animated("A", points=samples))
    assert len(read_stage(path, 1)[0].meshes) == 1
    with pytest.raises(MeshError, match=r"</A>: faceVertexIndices\[1\] names point 1"):
        read_stage(path, 3)


def test_primvars_their_indices_and_normals_are_those_of_the_frame(tmp_path):
    parts = """texCoord2f[] primvars:st (interpolation = "faceVarying")
    texCoord2f[] primvars:st.timeSamples = {1: [(0, 0), (1, 0)], 3: [(0.5, 0), (0, 1)]}
    int[] primvars:st:indices.timeSamples = {1: [0, 1, 1], 3: [1, 0, 0]}
    normal3f[] normals (interpolation = "vertex")
    normal3f[] normals.timeSamples = {1: [(0, 0, 1), (0, 0, 1), (0, 0, 1)],
        3: [(1, 0, 0), (1, 0, 0), (1, 0, 0)]}"""
    path = write_stage(tmp_path, triangle("A", parts))
    begin, end = (read_stage(path, number)[0].meshes[0] for number in (1, 3))
    np.testing.assert_allclose(begin.primvars["st"][0], [(0, 0), (1, 0), (1, 0)])
    np.testing.assert_allclose(end.primvars["st"][0], [(0, 1), (0.5, 0), (0.5, 0)])
    np.testing.assert_allclose(begin.normals[0], [(0, 0, 1)] * 3)
    np.testing.assert_allclose(end.normals[0], [(1, 0, 0)] * 3)


def test_transforms_and_visibility_change_with_time(tmp_path):
    parts = """double3 xformOp:translate.timeSamples = {1: (0, 0, 0), 3: (4, 0, 0)}
    uniform token[] xformOpOrder = ["xformOp:translate"]
    token visibility.timeSamples = {1: "inherited", 4: "invisible"}"""
    path = write_stage(tmp_path, prim("Xform", "Group", parts, triangle("A")))
    np.testing.assert_allclose(first_points(path, 2)[0], (2, 0, 0))
    assert read_stage(path, 5)[0].meshes == ()


def test_a_reset_of_the_transform_stack_leaves_the_parents_out(tmp_path):
    up = """double3 xformOp:translate = (9, 9, 9)
    uniform token[] xformOpOrder = [{}"xformOp:translate"]"""
    text = prim("Xform", "Up", up.format(""), triangle("A", up.format('"!resetXformStack!", ')))
    scene, _ = read_text(tmp_path, text)
    np.testing.assert_allclose(scene.meshes[0].points[0], (9, 9, 9))


def test_materials_and_lights_are_those_of_the_frame(tmp_path):
    paint = prim(
        "Material",
        "Paint",
        "token outputs:surface.connect = </Paint/Surface.outputs:surface>",
        prim(
            "Shader",
            "Surface",
            'uniform token info:id = "UsdPreviewSurface"',
            "color3f inputs:diffuseColor.timeSamples = {1: (0, 0, 0), 3: (1, 0.5, 0)}",
            "token outputs:surface",
        ),
    )
    lamp = prim(
        "DistantLight",
        "Lamp",
        "float inputs:intensity.timeSamples = {1: 1, 3: 3}",
        "float inputs:angle.timeSamples = {1: 0, 3: 2}",
        "bool inputs:normalize = 1",
        "float3 xformOp:rotateXYZ.timeSamples = {1: (0, 0, 0), 3: (-180, 0, 0)}",
        'uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]',
    )
    bound = triangle("A", "rel material:binding = </Paint>", metadata=BINDS)
    path = write_stage(tmp_path, bound, paint, lamp)
    begin, middle = (read_stage(path, number)[0] for number in (1, 2))
    colors = [scene.materials[scene.material_index["/Paint"]].diffuse_color
              for scene in (begin, middle)]  # fmt: skip
    np.testing.assert_allclose(colors, [(0, 0, 0), (0.5, 0.25, 0)], atol=1e-6)
    (dim,), (bright,) = begin.lights.distants, middle.lights.distants
    np.testing.assert_allclose(bright.irradiance.sum() / dim.irradiance.sum(), 2.0, rtol=1e-3)
    np.testing.assert_allclose(dim.direction, (0, 0, 1), atol=1e-6)
    np.testing.assert_allclose(bright.direction, (0, 1, 0), atol=1e-6)


def textured(*file: str) -> str:
    """Return an emitting material that shows a file as it is; ``file`` are its asset's opinions."""
    opinions = "\n    ".join(f"asset inputs:file{item}" for item in file)
    nodes = TEXTURE.format(file="", material="Paint").replace("asset inputs:file = @@", opinions)
    raw = 'token inputs:sourceColorSpace = "raw"\n    float3 outputs:rgb'
    body = """color3f inputs:emissiveColor.connect = </Paint/Picture.outputs:rgb>
    color3f inputs:diffuseColor = (0, 0, 0)
    float inputs:roughness = 1"""
    return surface("Paint", body, nodes.replace("float3 outputs:rgb", raw))


def test_textures_may_be_sequences(here):
    """Asset attributes have no values in between: the picture of the last sample is held."""
    for name, value in (("a", 255), ("b", 51)):
        write_png(Path(f"{name}.png"), np.full((2, 2, 3), value, np.uint8))
    paint = textured(".timeSamples = {1: @./a.png@, 3: @./b.png@}")
    text = stage_text(DARK, paint, quad("Board", "rel material:binding = </Paint>"))
    assert_colors(render_text(text, "-f", "2"), {"top left": (1, 1, 1)})
    assert_colors(render_text(text, "-f", "3"), {"top left": (0.2, 0.2, 0.2)})


# Composition


def sample_layer(folder: Path, name: str, samples: dict[float, float]) -> None:
    """Write a layer whose /A has points at height z by time."""
    rows = ", ".join(
        f"{time}: [(0, 0, {z}), (1, 0, {z}), (0, 1, {z})]" for time, z in samples.items()
    )
    text = animated("A", points=f"point3f[] points.timeSamples = {{{rows}}}")
    (folder / name).write_text(f'#usda 1.0\n(\n    defaultPrim = "A"\n)\n{text}')


MANIFEST = '#usda 1.0\nover "A"\n{\n    point3f[] points\n}\n'
TOPOLOGY = """int[] faceVertexCounts = [3]
    int[] faceVertexIndices = [0, 1, 2]
    uniform token subdivisionScheme = "none"
"""


def test_value_clips_give_the_points_of_the_frame(tmp_path):
    sample_layer(tmp_path, "one.usda", {1: 10.0, 2: 20.0})
    sample_layer(tmp_path, "two.usda", {1: 30.0, 2: 40.0})
    (tmp_path / "manifest.usda").write_text(MANIFEST)
    clips = """clips = {
        dictionary default = {
            asset[] assetPaths = [@./one.usda@, @./two.usda@]
            asset manifestAssetPath = @./manifest.usda@
            string primPath = "/A"
            double2[] active = [(1, 0), (3, 1)]
            double2[] times = [(1, 1), (2, 2), (3, 1), (4, 2)]
        }
    }"""
    path = write_stage(tmp_path, prim("Mesh", "Body", TOPOLOGY, metadata=clips))
    for number, z in ((1, 10.0), (1.5, 15.0), (2, 20.0), (3, 30.0), (4, 40.0)):
        np.testing.assert_allclose(first_points(path, number)[:, 2], z, err_msg=str(number))


def test_clips_named_by_a_template_are_found(tmp_path):
    for frame in (1, 2, 3):
        sample_layer(tmp_path, f"sim.{frame:03d}.usda", {frame: 10.0 * frame})
    (tmp_path / "manifest.usda").write_text(MANIFEST)
    clips = """clips = {
        dictionary default = {
            string templateAssetPath = "./sim.###.usda"
            double templateStartTime = 1
            double templateEndTime = 3
            double templateStride = 1
            asset manifestAssetPath = @./manifest.usda@
            string primPath = "/A"
        }
    }"""
    path = write_stage(tmp_path, prim("Mesh", "Body", TOPOLOGY, metadata=clips))
    for number in (1, 2, 3):
        np.testing.assert_allclose(first_points(path, number)[:, 2], 10.0 * number)


def test_layer_offsets_and_scales_move_time(tmp_path):
    sample_layer(tmp_path, "sim.usda", {1: 10.0, 2: 20.0})
    arc = "references = @./sim.usda@ (offset = 100; scale = 2)"
    path = write_stage(tmp_path, f'def "Body" ({arc})\n{{\n}}\n')
    np.testing.assert_allclose(first_points(path, 102)[:, 2], 10.0)
    np.testing.assert_allclose(first_points(path, 103)[:, 2], 15.0)


def test_payloads_are_loaded_inherits_and_specializes_compose(tmp_path):
    sample_layer(tmp_path, "heavy.usda", {1: 5.0})
    look = "color3f[] primvars:displayColor = [({})]"
    base = 'class "_{}"\n{{\n    {}\n}}\n'
    path = write_stage(
        tmp_path,
        base.format("General", look.format("0, 0, 1")),
        base.format("Special", look.format("1, 0, 0")),
        'def "Heavy" (payload = @./heavy.usda@\n    inherits = </_Special>)\n{\n}\n',
        triangle("Light", metadata="specializes = </_General>"),
    )
    scene, _ = read_stage(path, 1)
    assert paths(scene) == ["/Heavy", "/Light"]
    shown = [mesh.primvars["displayColor"][0, 0].tolist() for mesh in scene.meshes]
    assert shown == [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]


VARIANTS = f"""def Xform "Head" (variants = {{string shape = "one"}}
    prepend variantSets = "shape")
{{
    variantSet "shape" = {{
        "one" {{
            {triangle("A")}
        }}
        "two" {{
            {triangle("A")}
            {triangle("B")}
        }}
    }}
}}
"""


def test_variants_and_session_opinions_choose_what_is_read(tmp_path):
    path = write_stage(tmp_path, VARIANTS)
    assert paths(read_stage(path)[0]) == ["/Head/A"]
    assert paths(read_stage(path, variants=["/Head{shape=two}"])[0]) == ["/Head/A", "/Head/B"]
    hidden = read_stage(path, attributes=["/Head/A.visibility=invisible"])[0]
    assert hidden.meshes == ()


UNPREPARED = """
def Xform "Sitter" (
    variants = { string subject = "person" }
    prepend variantSets = "subject"
)
{
    variantSet "subject" = {
        "person" {
            def "Head" (references = @./not_there.usda@)
            {
            }
        }
        "bust" {
            def Sphere "Bust"
            {
            }
        }
    }
}
"""


def test_files_that_a_variant_does_not_need_are_not_missed(here, capsys):
    path = write_stage(Path(), UNPREPARED)
    chosen = ["--variant", "/Sitter{subject=bust}"]
    for flags, is_missed in (([], True), (chosen, False)):
        cli.main(["render", str(path), "x.exr", "-r", "4", "4", *flags])
        assert ("not_there.usda" in capsys.readouterr().err) == is_missed


def test_the_strongest_sublayer_counts_and_inactive_prims_do_not(tmp_path):
    (tmp_path / "weak.usda").write_text("#usda 1.0\n" + triangle("A") + triangle("B"))
    strong = 'over "A"\n{\n    point3f[] points = [(0, 0, 7), (1, 0, 7), (0, 1, 7)]\n}\n'
    path = write_stage(
        tmp_path,
        strong,
        'over "B" (active = false)\n{\n}\n',
        metadata="metersPerUnit = 1\n    subLayers = [@./weak.usda@]",
    )
    assert paths(read_stage(path)[0]) == ["/A"]
    np.testing.assert_allclose(first_points(path)[:, 2], 7.0)


# Files beside a layer


def test_a_texture_counts_from_the_layer_that_names_it(here):
    folder = Path("assets/tex")
    folder.mkdir(parents=True)
    write_png(folder / "p.png", np.full((2, 2, 3), (255, 51, 0), np.uint8))
    write_png(Path("p.png"), np.zeros((2, 2, 3), np.uint8))
    Path("assets/paint.usda").write_text("#usda 1.0\n" + textured(" = @./tex/p.png@"))
    reference = 'def "Paint" (references = @./assets/paint.usda@</Paint>)\n{\n}\n'
    text = stage_text(DARK, reference, quad("Board", "rel material:binding = </Paint>"))
    assert_colors(render_text(text), {"top left": (1.0, 0.2, 0.0)})


def test_a_package_shows_what_its_files_show(here):
    """Texture, sky and a referenced layer, all inside a .usdz."""
    Path("tex").mkdir()
    write_png(Path("tex/p.png"), np.full((2, 2, 3), (255, 51, 0), np.uint8))
    sky = np.full((8, 16, 3), (0.5, 0.25, 1.0), np.float32)
    write_exr(Path("tex/sky.exr"), [Part("", {"": sky}, color_space="lin_rec709_scene")])
    Path("paint.usda").write_text("#usda 1.0\n" + textured(" = @./tex/p.png@"))
    reference = 'def "Paint" (references = @./paint.usda@</Paint>)\n{\n}\n'
    light = prim("DomeLight", "Sky", "asset inputs:texture:file = @./tex/sky.exr@")
    board = quad("Board", "rel material:binding = </Paint>", box=(-1, -1, 0, 1))
    grey = quad("Grey", colored((0.5, 0.5, 0.5)), box=(0, -1, 1, 1))
    loose = render_text(stage_text(light, reference, board, grey), name="loose")
    assert UsdUtils.CreateNewUsdzPackage(Sdf.AssetPath("loose.usda"), "packed.usdz")
    given = ["-r", "32", "32", "-p", "4", "--no-png", "--filter", "box"]
    assert cli.main(["-q", "render", "packed.usdz", "packed.exr", *given]) == 0
    np.testing.assert_array_equal(read_image("packed.exr").pixels, loose)


# Bindings and subsets

TWO = """int[] faceVertexCounts = [3, 3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3, 0, 3, 4]
    point3f[] points = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (-1, 1, 0)]
    uniform token subdivisionScheme = "none"
"""
MATERIALS = "".join(prim("Material", name) for name in ("Red", "Blue", "Group"))


def subset(name: str, faces: list[int], *parts: str, kind: str = "") -> str:
    family = f'uniform token subsetFamily:materialBind:familyType = "{kind}"' if kind else ""
    body = prim(
        "GeomSubset",
        name,
        'uniform token elementType = "face"',
        'uniform token familyName = "materialBind"',
        f"int[] indices = {faces}",
        *parts,
        metadata=BINDS,
    )
    return f"{family}\n    {body}"


def slots(scene, path: str = "/M") -> list[str | None]:
    mesh = mesh_named(scene, path)
    return [mesh.material_paths[slot] for slot in mesh.material_slot]


def test_faces_in_no_subset_keep_the_material_of_the_mesh(tmp_path):
    mesh = prim(
        "Mesh",
        "M",
        TWO,
        "rel material:binding = </Red>",
        subset("S", [1], "rel material:binding = </Blue>"),
        metadata=BINDS,
    )
    assert slots(read_text(tmp_path, mesh, MATERIALS)[0]) == ["/Red", "/Blue", "/Red"]


def test_subset_indices_are_read_at_the_frame(tmp_path):
    moved = subset("S", [1], "rel material:binding = </Blue>").replace(
        "int[] indices = [1]", "int[] indices.timeSamples = {1: [0], 3: [2]}"
    )
    path = write_stage(tmp_path, prim("Mesh", "M", TWO, moved), MATERIALS)
    assert slots(read_stage(path, 2)[0]) == ["/Blue", None, None]
    assert slots(read_stage(path, 3)[0]) == [None, None, "/Blue"]


@pytest.mark.parametrize("kind", ["nonOverlapping", "partition"])
def test_overlap_in_a_family_that_promises_none_is_refused(tmp_path, kind):
    mesh = prim("Mesh", "M", TWO, subset("S", [0, 1], kind=kind), subset("T", [1]))
    with pytest.raises(MeshError, match=rf"</M/T>: face 1 is in S too, but .* {kind}"):
        read_text(tmp_path, mesh, MATERIALS)


@pytest.mark.parametrize("kind", ["unrestricted", ""])
def test_overlap_in_another_family_is_noted_and_the_first_subset_counts(tmp_path, kind):
    first = subset("S", [0, 1], "rel material:binding = </Red>", kind=kind)
    second = subset("T", [1, 2], "rel material:binding = </Blue>")
    scene, notes = read_text(tmp_path, prim("Mesh", "M", TWO, first, second), MATERIALS)
    assert slots(scene) == ["/Red", "/Red", "/Blue"]
    assert [code for code in codes(notes) if code.startswith("subset")] == ["subset-overlap"]


def test_a_partition_that_leaves_faces_out_is_noted(tmp_path):
    mesh = prim(
        "Mesh",
        "M",
        TWO,
        "rel material:binding = </Red>",
        subset("S", [0], "rel material:binding = </Blue>", kind="partition"),
        metadata=BINDS,
    )
    scene, notes = read_text(tmp_path, mesh, MATERIALS)
    assert slots(scene) == ["/Blue", "/Red", "/Red"]
    (note,) = [note for note in notes if note.code == "subset-partition"]
    assert "2 faces" in note.message and note.path == "/M"


STRONG = '(bindMaterialAs = "strongerThanDescendants")'


@pytest.mark.parametrize(
    ("group", "mesh", "shown"),
    [
        ("rel material:binding = </Group>", "", "/Group"),
        ("rel material:binding = </Group>", "rel material:binding = </Red>", "/Red"),
        (f"rel material:binding = </Group> {STRONG}", "rel material:binding = </Red>", "/Group"),
        ("rel material:binding:preview = </Group>", "rel material:binding = </Red>", "/Red"),
        ("rel material:binding = </Group>", "rel material:binding:full = </Red>", "/Red"),
        ("rel material:binding:full = </Group>", "rel material:binding = </Red>", "/Group"),
        ("rel material:binding:collection:some = [</G.collection:some>, </Blue>]\n"
         "rel collection:some:includes = </G/M>", "", "/Blue"),
        ("rel material:binding:collection:some = [</G.collection:some>, </Blue>]\n"
         "rel collection:some:includes = </G>\nrel collection:some:excludes = </G/M>\n"
         "rel material:binding = </Group>", "", "/Group"),
        ("rel material:binding:collection:some = [</G.collection:some>, </Blue>]\n"
         "rel collection:some:includes = </G>", "rel material:binding = </Red>", "/Red"),
        (f"rel material:binding:collection:some = [</G.collection:some>, </Blue>] {STRONG}\n"
         "rel collection:some:includes = </G>", "rel material:binding = </Red>", "/Blue"),
    ],
    ids=["inherited", "nearer", "stronger", "preview", "full", "full above", "collection",
         "excluded", "nearer than collection", "stronger collection"],
)  # fmt: skip
def test_the_binding_that_counts_is_the_one_usd_says(tmp_path, group, mesh, shown):
    applied = 'apiSchemas = ["MaterialBindingAPI", "CollectionAPI:some"]'
    text = prim("Xform", "G", group, triangle("M", mesh, metadata=BINDS), metadata=applied)
    scene, _ = read_text(tmp_path, text, MATERIALS)
    assert slots(scene, "/G/M") == [shown]


def test_a_stronger_binding_of_the_mesh_covers_its_subsets(tmp_path):
    mesh = prim(
        "Mesh",
        "M",
        TWO,
        f"rel material:binding = </Red> {STRONG}",
        subset("S", [1], "rel material:binding = </Blue>"),
        metadata=BINDS,
    )
    assert slots(read_text(tmp_path, mesh, MATERIALS)[0]) == ["/Red"] * 3


# Visibility and purpose


@pytest.mark.parametrize(
    ("purposes", "shown"),
    [(None, "DR"), (["proxy"], "DP"), (["render", "proxy", "guide"], "DGPR")],
)
def test_purposes_are_inherited_and_guides_are_asked_for(tmp_path, purposes, shown):
    prims = [
        prim("Xform", name, f'uniform token purpose = "{purpose}"', triangle("M"))
        for name, purpose in (("G", "guide"), ("P", "proxy"), ("R", "render"))
    ]
    path = write_stage(tmp_path, prim("Xform", "D", triangle("M")), *prims)
    flags = {} if purposes is None else {"purposes": purposes}
    scene, _ = read_stage(path, **flags)
    assert sorted(path[1] for path in paths(scene)) == list(shown)


def test_a_purpose_may_be_hidden_by_itself(tmp_path):
    text = prim(
        "Xform",
        "G",
        'token renderVisibility = "invisible"',
        triangle("A", 'uniform token purpose = "render"'),
        triangle("B"),
        metadata='apiSchemas = ["VisibilityAPI"]',
    )
    assert paths(read_text(tmp_path, text)[0]) == ["/G/B"]


# Winding


@pytest.mark.parametrize("left_handed", [False, True])
@pytest.mark.parametrize("mirrored", [False, True])
@pytest.mark.parametrize("indexed", [False, True])
def test_handedness_keeps_outside_and_the_corners_values(tmp_path, left_handed, mirrored, indexed):
    """A right-handed triangle faces +Z; left-handed or mirrored by -Z it faces -Z; both, +Z."""
    st = (
        'texCoord2f[] primvars:st = [(0, 1), (0, 0), (1, 0)] (interpolation = "faceVarying")\n'
        "    int[] primvars:st:indices = [1, 2, 0]"
        if indexed
        else 'texCoord2f[] primvars:st = [(0, 0), (1, 0), (0, 1)] (interpolation = "faceVarying")'
    )
    text = triangle(
        "M",
        st,
        f'uniform token orientation = "{"leftHanded" if left_handed else "rightHanded"}"',
        f"float3 xformOp:scale = (1, 1, {-1 if mirrored else 1})",
        'uniform token[] xformOpOrder = ["xformOp:scale"]',
    )
    scene, _ = read_text(tmp_path, text)
    (mesh,) = scene.meshes
    side = -1.0 if left_handed != mirrored else 1.0
    np.testing.assert_allclose(facing(mesh), (0, 0, side), atol=1e-7)
    np.testing.assert_allclose(mesh.normals[0], [(0, 0, side)] * 3, atol=1e-7)
    np.testing.assert_allclose(corner_points(mesh)[0][:, :2], mesh.primvars["st"][0])


@pytest.mark.parametrize("double_sided", [False, True])
def test_both_sides_of_a_surface_are_shown(here, double_sided):
    back = quad("Back", colored((0.5, 0.2, 0.1))).replace("[0, 1, 2, 3]", "[3, 2, 1, 0]")
    back = back.replace("uniform token sub", f"uniform bool doubleSided = {int(double_sided)}\n"
                        "uniform token sub")  # fmt: skip
    assert_colors(render_text(stage_text(WHITE, back)), {"top left": (0.5, 0.2, 0.1)})


# Units and axes


def test_units_scale_what_is_measured_and_not_what_is_seen(tmp_path):
    text = prim("Sphere", "Ball", "double radius = 2") + triangle("M")
    metres = read_stage(write_stage(tmp_path, text))[0]
    fallback = read_stage(write_stage(tmp_path, text, metadata=""))[0]
    for big, small in zip(metres.meshes, fallback.meshes, strict=True):
        np.testing.assert_allclose(small.points, 0.01 * big.points, atol=1e-7)
        np.testing.assert_allclose(small.normals, big.normals, atol=1e-6)


def test_units_of_a_referenced_layer_are_not_converted(tmp_path):
    """USD leaves that to the layer that references: only the root's metersPerUnit counts."""
    body = HEAD.format(metadata='metersPerUnit = 0.01\n    defaultPrim = "A"') + triangle("A")
    (tmp_path / "cm.usda").write_text(body)
    path = write_stage(tmp_path, 'def "A" (references = @./cm.usda@)\n{\n}\n')
    np.testing.assert_allclose(first_points(path)[1], (1, 0, 0))


def test_a_portal_is_noted_by_name_and_the_dome_shines_whole(tmp_path):
    sky = prim("DomeLight", "Dome", prim("PortalLight", "Window"))
    scene, notes = read_text(tmp_path, sky)
    assert len(scene.lights.domes) == 2  # the stage's own and this one
    (note,) = notes
    assert (note.code, note.path) == ("light-not-supported", "/Dome/Window")
    assert "portal" in note.message


def test_authored_stages_open_as_they_were_written(tmp_path):
    """A binary layer reads as the text it was exported from."""
    path = write_stage(tmp_path, VARIANTS, triangle("Plain"))
    Usd.Stage.Open(str(path)).Export(str(tmp_path / "shot.usdc"))
    text, binary = (read_stage(tmp_path / f"shot.{kind}")[0] for kind in ("usda", "usdc"))
    assert paths(text) == paths(binary)
    assert UsdGeom.GetStageUpAxis(Usd.Stage.Open(str(path))) == "Y"
