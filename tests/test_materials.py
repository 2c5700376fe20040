"""Materials as USD's own shader definitions and UsdShade's rules say they are to be read."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest

from usdskin.errors import LayerError
from usdskin.layers import open_stage
from usdskin.notes import Note
from usdskin.render.materials import (
    DISPLAY_COLOR,
    THICKNESS_PRIMVAR,
    PrimvarInput,
    SkinMaterial,
    SurfaceMaterial,
    TextureInput,
    bound_material,
    display_material,
    read_materials,
    required_primvars,
)
from usdskin.render.networks import FALLBACKS

from pxr import Plug, Usd, UsdGeom, UsdShade  # isort: skip

NOW = Usd.TimeCode.Default()


@pytest.fixture
def folder(tmp_path):
    for name in ("skin.png", "rough.exr", "udim.1001.png", "udim.1002.png"):
        (tmp_path / name).write_bytes(b"not looked into")
    return tmp_path


def read(folder: Path, body: str, path: str = "/M", **options):
    """Read one material from usda text; returns it and the notes."""
    file = folder / "stage.usda"
    file.write_text(f'#usda 1.0\n(\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n{body}')
    notes: list[Note] = []
    stage = open_stage(file)
    return read_materials(stage, [path], NOW, notes, **options)[path], notes


def preview(inputs: str = "", nodes: str = "", outputs: str = "") -> str:
    """Return a Material with a UsdPreviewSurface."""
    return f"""
def Material "M"
{{
    token outputs:surface.connect = </M/Surface.outputs:surface>
    {outputs}
    def Shader "Surface"
    {{
        uniform token info:id = "UsdPreviewSurface"
        token outputs:surface
        token outputs:displacement
        {inputs}
    }}
    {nodes}
}}
"""


TEXTURE = """
    def Shader "Tex"
    {
        uniform token info:id = "UsdUVTexture"
        asset inputs:file = @./skin.png@
        float2 inputs:st.connect = </M/Place.outputs:result>
        token inputs:wrapS = "repeat"
        token inputs:wrapT = "mirror"
        float4 inputs:scale = (2, 3, 4, 5)
        float4 inputs:bias = (-1, 0, 0.5, 0)
        float4 inputs:fallback = (0.1, 0.2, 0.3, 0.4)
        token inputs:sourceColorSpace = "sRGB"
        float3 outputs:rgb
        float outputs:a
    }
    def Shader "Place"
    {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </M/Coords.outputs:result>
        float inputs:rotation = 90
        float2 inputs:scale = (2, 3)
        float2 inputs:translation = (0.25, 0.5)
        float2 outputs:result
    }
    def Shader "Coords"
    {
        uniform token info:id = "UsdPrimvarReader_float2"
        string inputs:varname = "map1"
        float2 outputs:result
    }
"""


def codes(notes):
    return [note.code for note in notes]


def test_fallbacks_are_those_of_usds_own_shader_definition():
    resources = Path(Plug.Registry().GetPluginWithName("usdShaders").resourcePath)
    stage = Usd.Stage.Open(str(resources / "shaders" / "shaderDefs.usda"))
    shader = UsdShade.Shader(stage.GetPrimAtPath("/UsdPreviewSurface"))
    for name, value in FALLBACKS.items():
        stated = shader.GetInput(name).Get()
        assert np.allclose(stated, value) if not isinstance(value, str) else stated == value
    assert {item.GetBaseName() for item in shader.GetInputs()} == set(FALLBACKS) | {
        "normal",
        "displacement",
        "occlusion",
    }


def test_surface_without_opinions_has_the_fallbacks(folder):
    material, notes = read(folder, preview())
    assert isinstance(material, SurfaceMaterial)
    assert material.diffuse_color == (0.18, 0.18, 0.18)
    assert material.roughness == 0.5
    assert material.ior == 1.5
    assert material.opacity_mode == "transparent"
    assert material.use_specular_workflow is False
    assert material.reflective
    assert notes == []
    assert required_primvars([material]) == frozenset()


def test_every_constant_is_read(folder):
    material, notes = read(
        folder,
        preview("""
        color3f inputs:diffuseColor = (0.3, 0.2, 0.1)
        color3f inputs:specularColor = (0.04, 0.05, 0.06)
        color3f inputs:emissiveColor = (7, 8, 9)
        int inputs:useSpecularWorkflow = 1
        float inputs:metallic = 0.25
        float inputs:roughness = 0.35
        float inputs:clearcoat = 0.45
        float inputs:clearcoatRoughness = 0.55
        float inputs:opacity = 0.65
        token inputs:opacityMode = "presence"
        float inputs:opacityThreshold = 0.75
        float inputs:ior = 1.33
        """),
    )
    assert notes == []
    assert material.diffuse_color == (0.3, 0.2, 0.1)
    assert material.specular_color == (0.04, 0.05, 0.06)
    assert material.emissive_color == (7.0, 8.0, 9.0)
    assert material.use_specular_workflow is True
    assert (material.metallic, material.roughness) == (0.25, 0.35)
    assert (material.clearcoat, material.clearcoat_roughness) == (0.45, 0.55)
    assert (material.opacity, material.opacity_mode) == (0.65, "presence")
    assert (material.opacity_threshold, material.ior) == (0.75, 1.33)


def test_texture_brings_file_encoding_scale_and_wraps(folder):
    material, notes = read(
        folder,
        preview(
            """
        color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>
        float inputs:opacity.connect = </M/Tex.outputs:a>""",
            TEXTURE,
        ),
    )
    assert notes == []
    color = material.diffuse_color
    assert isinstance(color, TextureInput)
    assert color.file == str(folder / "skin.png")
    assert color.channel == "rgb"
    assert color.source_color_space == "sRGB"
    assert (color.wrap_s, color.wrap_t) == ("repeat", "mirror")
    assert color.scale == (2.0, 3.0, 4.0, 5.0)
    assert color.bias == (-1.0, 0.0, 0.5, 0.0)
    assert color.fallback == (0.1, 0.2, 0.3, 0.4)
    assert material.opacity.channel == "a"
    assert material.opacity.texture_key() == color.texture_key()
    assert required_primvars([material]) == {"map1"}


def test_transform2d_scales_then_rotates_then_translates(folder):
    """(1, 1) scaled by (2, 3) is (2, 3), turned by 90 degrees (-3, 2), moved (-2.75, 2.5)."""
    material, _ = read(
        folder, preview("color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>", TEXTURE)
    )
    matrix = material.diffuse_color.st_matrix
    assert np.allclose(matrix @ (1.0, 1.0, 1.0), (-2.75, 2.5))
    assert np.allclose(matrix @ (0.0, 0.0, 1.0), (0.25, 0.5))


def test_chained_transforms_apply_from_the_reader_outwards(folder):
    nodes = TEXTURE.replace(
        "inputs:in.connect = </M/Coords.outputs:result>",
        "inputs:in.connect = </M/First.outputs:result>",
    ) + (
        """
    def Shader "First"
    {
        uniform token info:id = "UsdTransform2d"
        float2 inputs:in.connect = </M/Coords.outputs:result>
        float2 inputs:translation = (1, 0)
        float2 outputs:result
    }"""
    )
    material, _ = read(
        folder, preview("color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>", nodes)
    )
    # (0, 0) -> (1, 0) -> scaled (2, 0) -> turned (0, 2) -> moved (0.25, 2.5)
    assert np.allclose(material.diffuse_color.st_matrix @ (0.0, 0.0, 1.0), (0.25, 2.5))


def test_primvar_readers_bring_name_and_fallback(folder):
    material, notes = read(
        folder,
        preview(
            """
        color3f inputs:diffuseColor.connect = </M/Paint.outputs:result>
        float inputs:roughness.connect = </M/Wet.outputs:result>""",
            """
    def Shader "Paint"
    {
        uniform token info:id = "UsdPrimvarReader_float3"
        string inputs:varname = "displayColor"
        float3 inputs:fallback = (0.5, 0.25, 0.125)
        float3 outputs:result
    }
    def Shader "Wet"
    {
        uniform token info:id = "UsdPrimvarReader_float"
        string inputs:varname = "wetness"
        float outputs:result
    }""",
        ),
    )
    assert notes == []
    assert material.diffuse_color.name == "displayColor"
    assert material.diffuse_color.fallback == (0.5, 0.25, 0.125)
    assert material.roughness.name == "wetness"
    assert material.roughness.fallback == (0.0,)
    assert required_primvars([material]) == {"displayColor", "wetness"}


def test_connections_pass_through_node_graphs_and_the_materials_interface(folder):
    body = """
def Material "M"
{
    float inputs:gloss = 0.125
    token inputs:frame:stPrimvarName = "uvset"
    token outputs:surface.connect = </M/Graph.outputs:out>
    def NodeGraph "Graph"
    {
        float inputs:rough.connect = </M.inputs:gloss>
        token outputs:out.connect = </M/Graph/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:roughness.connect = </M/Graph.inputs:rough>
            color3f inputs:diffuseColor.connect = </M/Graph/Inner.outputs:color>
            token outputs:surface
        }
        def NodeGraph "Inner"
        {
            color3f outputs:color.connect = </M/Graph/Inner/Tex.outputs:rgb>
            def Shader "Tex"
            {
                uniform token info:id = "UsdUVTexture"
                asset inputs:file = @./skin.png@
                float2 inputs:st.connect = </M/Graph/Inner/Coords.outputs:result>
                float3 outputs:rgb
            }
            def Shader "Coords"
            {
                uniform token info:id = "UsdPrimvarReader_float2"
                string inputs:varname.connect = </M.inputs:frame:stPrimvarName>
                float2 outputs:result
            }
        }
    }
}
"""
    material, notes = read(folder, body)
    assert notes == []
    assert material.roughness == 0.125
    assert material.diffuse_color.primvar == "uvset"


def test_output_that_the_shader_does_not_declare_is_connected_all_the_same(folder):
    nodes = TEXTURE.replace("        float3 outputs:rgb\n", "")
    material, notes = read(
        folder, preview("color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>", nodes)
    )
    assert isinstance(material.diffuse_color, TextureInput)
    assert notes == []


@pytest.mark.parametrize(
    "body",
    [
        preview("color3f inputs:diffuseColor.connect = </M.inputs:a>").replace(
            "token outputs:surface.connect",
            "color3f inputs:a.connect = </M.inputs:b>\n"
            "    color3f inputs:b.connect = </M.inputs:a>\n"
            "    token outputs:surface.connect",
            1,
        ),
        preview(
            "color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>",
            TEXTURE.replace("</M/Coords.outputs:result>", "</M/Place.outputs:result>"),
        ),
    ],
    ids=["interface inputs", "nodes"],
)
def test_connection_loop_is_an_error_that_names_the_prim(folder, body):
    with pytest.raises(LayerError, match=r"stage\.usda </M.*loop"):
        read(folder, body)


def test_unknown_surface_shader_shows_display_color(folder):
    body = preview().replace("UsdPreviewSurface", "PxrSurface")
    material, notes = read(folder, body)
    assert codes(notes) == ["shader-not-supported"]
    assert "PxrSurface" in notes[0].message
    assert material.path == "/M"
    assert material.diffuse_color.name == "displayColor"
    assert material.opacity.name == "displayOpacity"
    assert not material.reflective


def test_material_for_another_renderer_only_names_it(folder):
    body = preview().replace("token outputs:surface.connect", "token outputs:mtlx:surface.connect")
    material, notes = read(folder, body)
    assert codes(notes) == ["shader-not-supported"]
    assert "mtlx" in notes[0].message
    assert not material.reflective


def test_material_without_a_surface_shows_display_color(folder):
    material, notes = read(folder, 'def Material "M"\n{\n}\n')
    assert codes(notes) == ["material-without-surface"]
    assert isinstance(material.diffuse_color, PrimvarInput)


def test_unknown_node_on_an_input_leaves_its_own_value(folder):
    material, notes = read(
        folder,
        preview(
            """
        color3f inputs:diffuseColor = (0.1, 0.2, 0.3)
        color3f inputs:diffuseColor.connect = </M/Noise.outputs:out>""",
            'def Shader "Noise"\n{\nuniform token info:id = "ND_noise3d"\nfloat3 outputs:out\n}',
        ),
    )
    assert codes(notes) == ["shader-not-supported"]
    assert "ND_noise3d" in notes[0].message
    assert material.diffuse_color == (0.1, 0.2, 0.3)


def test_what_is_not_shown_is_noted_once(folder):
    material, notes = read(
        folder,
        preview(
            """
        float inputs:occlusion.connect = </M/Tex.outputs:r>
        float inputs:displacement = 0.1""",
            TEXTURE,
        ),
    )
    assert sorted(codes(notes)) == ["displacement-ignored", "occlusion-ignored"]
    assert material.displacement is None
    assert material.diffuse_color == (0.18, 0.18, 0.18)


def test_displacement_by_another_shader_is_noted(folder):
    connected = "token outputs:displacement.connect = </M/Push.outputs:out>"
    push = """def Shader "Push"
    {
        uniform token info:id = "ND_displacement_float"
        token outputs:out
    }"""
    material, notes = read(folder, preview("", push, connected))
    assert codes(notes) == ["displacement-ignored"]
    assert "ND_displacement_float" in notes[0].message
    assert material.displacement is None


def test_displacement_is_read_where_the_material_connects_it(folder):
    connected = "token outputs:displacement.connect = </M/Surface.outputs:displacement>"
    material, notes = read(folder, preview("float inputs:displacement = -0.25", "", connected))
    assert notes == []
    assert (material.displacement.amount, material.displacement.unit) == (-0.25, 1.0)
    body = "float inputs:displacement.connect = </M/Tex.outputs:r>"
    material, _ = read(folder, preview(body, TEXTURE, connected))
    assert material.displacement.amount.channel == "r"
    assert required_primvars([material]) == {"map1"}


@pytest.mark.parametrize(("encoding", "noted"), [("raw", 0), ("auto", 1), ("sRGB", 1)])
def test_a_normal_map_is_raw_whatever_it_says(encoding, noted, folder):
    nodes = TEXTURE.replace('"sRGB"', f'"{encoding}"')
    body = "normal3f inputs:normal.connect = </M/Tex.outputs:rgb>"
    material, notes = read(folder, preview(body, nodes))
    assert codes(notes) == ["normal-map-not-raw"] * noted
    assert material.normal.source_color_space == "raw"
    assert material.normal.scale == (2.0, 3.0, 4.0, 5.0)


def test_a_constant_normal_counts_and_the_geometrys_own_is_none(folder):
    assert read(folder, preview("normal3f inputs:normal = (0, 0, 1)"))[0].normal is None
    material, _ = read(folder, preview("normal3f inputs:normal = (0.6, 0, 0.8)"))
    assert material.normal == (0.6, 0.0, 0.8)


def test_connected_displacement_of_zero_is_no_displacement(folder):
    connected = "token outputs:displacement.connect = </M/Surface.outputs:displacement>"
    _, notes = read(folder, preview(outputs=connected))
    assert notes == []


def test_dangling_connection_is_noted(folder):
    material, notes = read(folder, preview("float inputs:roughness.connect = </M/Gone.outputs:r>"))
    assert codes(notes) == ["connection-broken"]
    assert material.roughness == 0.5


def test_share_beyond_one_is_cut_off_with_a_note(folder):
    material, notes = read(folder, preview("float inputs:roughness = 1.5"))
    assert codes(notes) == ["value-out-of-range"]
    assert material.roughness == 1.0


@pytest.mark.parametrize(
    ("line", "said"),
    [
        ("color3f inputs:diffuseColor = (nan, 0, 0)", "finite"),
        ("float inputs:roughness = inf", "finite"),
        ('string inputs:diffuseColor = "red"', "not 3 numbers"),
        ("float inputs:diffuseColor = 0.5", "not 3 numbers"),
        ('token inputs:opacityMode = "glass"', "use one of transparent, presence"),
    ],
)
def test_value_that_cannot_be_used_is_an_error(folder, line, said):
    with pytest.raises(LayerError, match=rf"stage\.usda </M/Surface>: inputs:\w+ is .*{said}"):
        read(folder, preview(line))


def test_missing_texture_is_an_error_that_names_it(folder):
    nodes = TEXTURE.replace("skin.png", "lost.png")
    with pytest.raises(LayerError, match=r"</M/Tex>: inputs:file names @\./lost\.png@"):
        read(folder, preview("color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>", nodes))


def test_tiles_of_a_udim_texture_are_found(folder):
    nodes = TEXTURE.replace("skin.png", "udim.<UDIM>.png")
    material, _ = read(
        folder, preview("color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>", nodes)
    )
    assert material.diffuse_color.file == str(folder / "udim.<UDIM>.png")


def test_texture_without_a_file_shows_its_fallback(folder):
    nodes = TEXTURE.replace("asset inputs:file = @./skin.png@", "")
    inputs = """
        color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>
        color3f inputs:emissiveColor.connect = </M/Tex.outputs:g>
        float inputs:opacity.connect = </M/Tex.outputs:a>"""
    material, notes = read(folder, preview(inputs, nodes))
    assert codes(notes) == ["texture-without-file"]
    assert material.diffuse_color == (0.1, 0.2, 0.3)
    assert material.emissive_color == (0.2, 0.2, 0.2)
    assert material.opacity == 0.4


def test_texture_without_coordinates_shows_one_texel(folder):
    """UsdUVTexture's fallback for st is (0, 0)."""
    nodes = TEXTURE.replace("float2 inputs:st.connect = </M/Place.outputs:result>", "")
    material, notes = read(
        folder, preview("color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>", nodes)
    )
    assert codes(notes) == ["texture-without-st"]
    assert np.array_equal(material.diffuse_color.st_matrix, np.zeros((2, 3)))


def test_color_space_of_the_asset_stands_in_for_auto(folder):
    nodes = TEXTURE.replace(
        "@./skin.png@", '@./skin.png@ (\n            colorSpace = "lin_ap1_scene"\n        )'
    ).replace('token inputs:sourceColorSpace = "sRGB"', "")
    material, notes = read(
        folder, preview("color3f inputs:diffuseColor.connect = </M/Tex.outputs:rgb>", nodes)
    )
    assert notes == []
    assert material.diffuse_color.source_color_space == "lin_ap1_scene"


def test_constant_with_a_color_space_is_converted(folder):
    """sRGB 0.5 is 0.214 linear (IEC 61966-2-1), and white stays white in any rendering space."""
    spaced = 'color3f inputs:diffuseColor = (0.5, 0.5, 0.5) (colorSpace = "srgb_rec709_scene")'
    linear = ((0.5 + 0.055) / 1.055) ** 2.4
    for space in ("lin_rec709_scene", "lin_rec2020_scene"):
        material, _ = read(folder, preview(spaced), color_space=space)
        assert np.allclose(material.diffuse_color, linear, atol=1e-5)


def test_red_in_a_wider_rendering_space_is_less_saturated(folder):
    """Rec.709's red in Rec.2020 (ITU-R BT.2087, table 4)."""
    material, _ = read(
        folder,
        preview("color3f inputs:diffuseColor = (1, 0, 0)"),
        color_space="lin_rec2020_scene",
    )
    assert np.allclose(material.diffuse_color, (0.6274, 0.0691, 0.0164), atol=2e-4)


def test_reflectance_on_a_surface_is_read(folder):
    body = preview().replace(
        'def Material "M"',
        'def Material "M" (\n    prepend apiSchemas = ["SpectralDistributionAPI:reflectance"]\n)',
    )
    body = body.replace(
        "token outputs:surface.connect",
        """uniform double[] spectrum:reflectance:wavelengths = [400, 700]
    double[] spectrum:reflectance:values = [0.2, 0.6]
    uniform token spectrum:reflectance:quantity = "reflectance"
    token outputs:surface.connect""",
        1,
    )
    material, _ = read(folder, body)
    assert np.allclose(material.reflectance.value, (0.2, 0.6))


SKIN = """
def Material "M" (
    prepend apiSchemas = ["SkinMaterialAPI"]
)
{
    %s
    token outputs:surface.connect = </M/Surface.outputs:surface>
    def Shader "Surface"
    {
        uniform token info:id = "UsdPreviewSurface"
        token outputs:surface
    }
}
"""


def test_skin_wins_over_the_preview_surface_beside_it(folder):
    material, notes = read(folder, SKIN % "float inputs:skin:wrap = 0.7")
    assert isinstance(material, SkinMaterial)
    assert material.parameters.wrap == 0.7
    assert material.albedo is None and material.weights is None
    assert notes == []


def test_albedo_of_skin_is_a_texture_at_its_own_coordinates(folder):
    material, _ = read(
        folder,
        SKIN
        % """asset inputs:skin:albedo:file = @./skin.png@
    uniform token inputs:skin:albedo:sourceColorSpace = "sRGB"
    uniform token inputs:skin:texcoord = "face" """,
    )
    assert material.albedo.file == str(folder / "skin.png")
    assert material.albedo.source_color_space == "sRGB"
    assert material.albedo.wrap_s == "repeat"
    assert required_primvars([material]) == {"face"}


def test_six_weights_are_two_raw_textures(folder):
    rows = ", ".join(["0.1, 0.2"] * 6)
    material, _ = read(
        folder,
        SKIN
        % f"""asset inputs:skin:weights:file = @./rough.exr@
    double[] inputs:skin:weights:basis = [{rows}]
    uniform double[] inputs:skin:weights:basis:wavelengths = [400, 700]""",
    )
    assert (material.weights.first_channel, material.weights_high.first_channel) == (0, 4)
    assert material.weights.source_color_space == "raw"
    assert material.weights.texture_key() != material.weights_high.texture_key()


def test_thickness_is_asked_of_the_geometry_where_the_skin_is_opaque(folder):
    clear, _ = read(folder, SKIN % "float inputs:skin:thickness = 0.002")
    assert clear.thickness_primvar is None
    opaque, _ = read(
        folder, SKIN % "float inputs:skin:opacity = 300\n    float inputs:skin:thickness = 0.002"
    )
    assert opaque.thickness_primvar == THICKNESS_PRIMVAR
    assert required_primvars([opaque]) == {THICKNESS_PRIMVAR}
    assert [value.fallback for value in opaque.inputs()] == [(0.002,)]


def test_connected_skin_input_is_noted(folder):
    body = SKIN % (
        "float inputs:skin:wrap = 0.2\n"
        "    float inputs:other = 0.9\n"
        "    float inputs:skin:wrap.connect = </M.inputs:other>"
    )
    material, notes = read(folder, body)
    assert codes(notes) == ["connection-ignored"]
    assert material.parameters.wrap == 0.2


def test_path_that_is_no_material_is_an_error(folder):
    with pytest.raises(LayerError, match="is no Material"):
        read(folder, 'def Scope "M"\n{\n}\n')


def test_display_material_is_matte_grey_where_nothing_is_painted():
    material = display_material()
    assert material.diffuse_color.fallback == DISPLAY_COLOR
    assert not material.reflective
    assert required_primvars([material]) == {"displayColor", "displayOpacity"}


@pytest.fixture
def bindings():
    stage = Usd.Stage.CreateInMemory()
    for name in ("A", "B", "Full", "Preview", "Set"):
        UsdShade.Material.Define(stage, f"/{name}")
    group = UsdGeom.Xform.Define(stage, "/G").GetPrim()
    mesh = UsdGeom.Mesh.Define(stage, "/G/Mesh")
    return stage, group, mesh.GetPrim()


def bind(prim, path, *arguments):
    stage = prim.GetStage()
    api = UsdShade.MaterialBindingAPI.Apply(prim)
    api.Bind(UsdShade.Material.Get(stage, path), *arguments)


def test_unbound_prim_has_no_material(bindings):
    assert bound_material(bindings[2]) is None


def test_binding_of_a_child_wins_unless_the_parents_is_stronger(bindings):
    _, group, mesh = bindings
    bind(group, "/A")
    assert bound_material(mesh) == "/A"
    bind(mesh, "/B")
    assert bound_material(mesh) == "/B"
    bind(group, "/A", UsdShade.Tokens.strongerThanDescendants)
    assert bound_material(mesh) == "/A"


def test_purposes_count_in_the_order_asked_for(bindings):
    _, _, mesh = bindings
    bind(mesh, "/A")
    weak = UsdShade.Tokens.weakerThanDescendants
    bind(mesh, "/Preview", weak, UsdShade.Tokens.preview)
    assert bound_material(mesh, ("full", "")) == "/A"
    assert bound_material(mesh, ("full", "preview", "")) == "/Preview"
    bind(mesh, "/Full", weak, UsdShade.Tokens.full)
    assert bound_material(mesh, ("full", "")) == "/Full"
    assert bound_material(mesh, ("", "full")) == "/A"


def test_collection_binding_counts(bindings):
    stage, group, mesh = bindings
    collection = Usd.CollectionAPI.Apply(group, "heads")
    collection.CreateIncludesRel().AddTarget(mesh.GetPath())
    bind(mesh, "/A")
    api = UsdShade.MaterialBindingAPI.Apply(group)
    material = UsdShade.Material.Get(stage, "/Set")
    strength = UsdShade.Tokens.strongerThanDescendants
    api.Bind(collection, material, "heads", strength)
    assert bound_material(mesh) == "/Set"
    assert bound_material(mesh, ("full", "")) == "/Set"


def test_subset_without_a_binding_shows_the_meshs(bindings):
    stage, _, mesh = bindings
    subset = UsdGeom.Subset.Define(stage, "/G/Mesh/face").GetPrim()
    bind(mesh, "/A")
    assert bound_material(subset) == "/A"
    bind(subset, "/B")
    assert bound_material(subset) == "/B"


@pytest.mark.realdata
def test_tutorial_material_of_openusd_is_read(realdata):
    found = sorted(realdata.rglob("*.usda"))
    read_any = 0
    for file in found:
        try:
            stage = Usd.Stage.Open(str(file))
        except Exception:
            continue
        paths = [str(p.GetPath()) for p in stage.Traverse() if p.IsA(UsdShade.Material)]
        for path in paths:
            notes: list[Note] = []
            try:
                material = read_materials(stage, [path], NOW, notes)[path]
            except LayerError:
                continue
            read_any += isinstance(material, SurfaceMaterial) and material.reflective
            assert not math.isnan(float(np.sum(material.ior)))
    assert read_any > 5
