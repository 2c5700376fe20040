"""What a render is asked for: flags, authored settings, fallbacks, products and overrides."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from usdskin.errors import DeviceError, LayerError, UsageError, UsdSkinError
from usdskin.layers import open_stage
from usdskin.render import memory
from usdskin.render.opinions import parse_wavelengths
from usdskin.render.overrides import RenderOverrides, apply_overrides
from usdskin.render.products import Aov, prepare_folders
from usdskin.render.settings import resolve_settings

# isort: split
from pxr import Sdf

CAMERA = """
def Camera "Cam"
{
    float horizontalAperture = 36
    float verticalAperture = 24
}
"""


@pytest.fixture
def resolve(tmp_path):
    """Return a function from layer text and flags to (job, notes)."""

    def run(text="", output=None, *, metadata="", **flags):
        path = tmp_path / "shot.usda"
        path.write_text(f"#usda 1.0\n(\n{metadata}\n)\n{CAMERA}\n{text}\n")
        stage = open_stage(path)
        overrides = RenderOverrides(**flags)
        notes = []
        apply_overrides(stage, overrides)
        return resolve_settings(stage, overrides, output, notes), notes

    return run


def with_settings(settings="", products="", others=""):
    """Return layer text with /Render/Main, and the metadata that makes it the stage's."""
    text = f"""
def Scope "Render"
{{
    def RenderSettings "Main" (prepend apiSchemas = ["SkinRenderSettingsAPI"])
    {{
        {settings}
        {products}
    }}
    {others}
}}
"""
    return {"text": text, "metadata": 'renderSettingsPrimPath = "/Render/Main"'}


def product(name, body):
    return f'def RenderProduct "{name}"\n{{\n{body}\n}}\n'


def var(name, body=""):
    return f'def RenderVar "{name}"\n{{\n{body}\n}}\n'


def test_the_hint_of_a_sequence_reads_the_place_that_others_write(resolve):
    with pytest.raises(UsageError, match=r"such as x\.####\.exr\.$"):
        resolve(output=Path("x.%04d.exr"), frames=(1, 2))


# Flags that would be ignored


@pytest.mark.parametrize(
    ("flags", "said"),
    [
        ({"bounces": 1}, "--bounces 1: .*--integrator traced"),
        ({"target_error": 0.01}, "--target-error 0.01: .*--integrator traced"),
        ({"illuminant": "XX"}, "--illuminant XX: .*neither a known name"),
        ({"output": Path("a.png"), "aovs": ("N", "P")}, "a.png: --aov N,P: .*such as a.exr"),
        ({"output": Path("a.png"), "png": False}, "a.png: --no-png .*such as a.exr"),
    ],
)
def test_a_flag_that_would_mean_nothing_is_refused(resolve, flags, said):
    with pytest.raises(UsageError, match=said):
        resolve(**flags)


def test_flags_that_say_what_is_so_anyway_are_taken(resolve):
    resolve(bounces=0, target_error=0.0)
    resolve(bounces=1, target_error=0.01, integrator="traced")
    assert resolve(output=Path("a.png"), aovs=("none",), png=True)[0].products[0].exr is None


def test_authored_settings_of_the_other_integrator_wait_for_it(resolve):
    authored = with_settings("int usdskin:bounces = 1\nfloat usdskin:targetError = 0.03")
    job, _ = resolve(**authored)
    assert (job.settings.integrator, job.settings.bounces) == ("map", 1)


# Precedence


def test_without_settings_the_schema_says_everything(resolve):
    job, notes = resolve()
    settings = job.settings
    assert (settings.integrator, settings.samples_per_pixel, settings.seed) == ("map", 4, 0)
    assert (settings.pixel_filter, settings.dome) == ("blackmanHarris", "auto")
    assert (settings.observer, settings.subdivision_level) == ("cie1931_2", 2)
    np.testing.assert_array_equal(settings.wavelength_nm, np.arange(400, 701, 5))
    assert settings.purposes == {"default", "render"}
    assert settings.material_purposes == ("full", "")
    assert settings.color_space == "lin_rec709_scene"
    assert (settings.ev, settings.white, settings.illuminant) == ("auto", "scene", None)
    assert settings.prim_path is None
    assert not notes


def test_authored_settings_win_over_the_schema(resolve):
    job, _ = resolve(
        **with_settings(
            """uniform int usdskin:samplesPerPixel = 9
            uniform double[] usdskin:wavelengths = [450, 550, 650]
            uniform token usdskin:dome = "show"
            uniform token[] includedPurposes = ["proxy"]
            uniform token renderingColorSpace = "lin_ap1_scene" """
        )
    )
    assert job.settings.samples_per_pixel == 9
    assert job.settings.wavelength_nm.tolist() == [450, 550, 650]
    assert job.settings.dome == "show"
    assert job.settings.purposes == {"proxy"}
    assert job.settings.color_space == "lin_ap1_scene"
    assert job.settings.prim_path == "/Render/Main"


def test_flags_win_over_authored_settings(resolve):
    job, _ = resolve(
        **with_settings("uniform int usdskin:samplesPerPixel = 9"),
        samples=16,
        wavelength_nm=parse_wavelengths("400:700:10"),
        purposes=("default",),
        dome="hide",
    )
    assert job.settings.samples_per_pixel == 16
    assert job.settings.wavelength_nm.size == 31
    assert job.settings.purposes == {"default"}
    assert job.settings.dome == "hide"


def test_settings_prim_can_be_named_by_flag(resolve):
    both = """
def RenderSettings "A" (prepend apiSchemas = ["SkinRenderSettingsAPI"])
{
    uniform int usdskin:seed = 1
}
def RenderSettings "B" (prepend apiSchemas = ["SkinRenderSettingsAPI"])
{
    uniform int usdskin:seed = 2
}
"""
    metadata = 'renderSettingsPrimPath = "/A"'
    assert resolve(both, metadata=metadata)[0].settings.seed == 1
    assert resolve(both, metadata=metadata, settings="/B")[0].settings.seed == 2
    with pytest.raises(UsageError, match="/A, /B"):
        resolve(both, settings="/C")


def test_stage_that_names_missing_settings_is_refused(resolve):
    with pytest.raises(LayerError, match="renderSettingsPrimPath"):
        resolve(metadata='renderSettingsPrimPath = "/Cam"')


# Resolution


def test_picture_without_settings_is_1024_wide_with_the_cameras_aspect(resolve):
    job, _ = resolve()
    assert job.products[0].resolution == (1024, 683)


def test_fallback_of_usd_counts_where_there_are_settings(resolve):
    job, _ = resolve(**with_settings())
    assert job.products[0].resolution == (2048, 1080)


def test_product_overrides_the_settings_only_where_it_has_an_opinion(resolve):
    job, _ = resolve(
        **with_settings(
            "uniform int2 resolution = (640, 480)\nuniform float pixelAspectRatio = 2",
            "rel products = [</Render/A>, </Render/B>]",
            product("A", "uniform int2 resolution = (64, 48)") + product("B", ""),
        )
    )
    assert [item.resolution for item in job.products] == [(64, 48), (640, 480)]
    assert [item.pixel_aspect_ratio for item in job.products] == [2, 2]


def test_width_flag_keeps_the_cameras_aspect_and_the_pixels_shape(resolve):
    assert resolve(width=300)[0].products[0].resolution == (300, 200)
    squeezed = with_settings("uniform float pixelAspectRatio = 2")
    assert resolve(**squeezed, width=300)[0].products[0].resolution == (300, 400)


def test_resolution_flag_wins(resolve):
    authored = with_settings("uniform int2 resolution = (640, 480)")
    assert resolve(**authored, resolution=(32, 16))[0].products[0].resolution == (32, 16)


@pytest.mark.parametrize("size", [(0, 10), (10**9, 10**9), (-1, 5), (16385, 1)])
def test_impossible_resolution_is_refused_with_the_code_of_its_origin(resolve, size):
    with pytest.raises(UsageError, match="-r/--resolution"):
        resolve(resolution=size)
    with pytest.raises(LayerError, match=r"shot\.usda <.*resolution = ") as caught:
        resolve(**with_settings(f"uniform int2 resolution = {size}"))
    assert caught.value.exit_code == 3


@pytest.mark.parametrize("width", [0, -4, 10**9, 16385])
def test_impossible_width_is_a_usage_error(resolve, width):
    with pytest.raises(UsageError, match="-w/--width"):
        resolve(width=width)


def test_width_and_resolution_exclude_each_other(resolve):
    with pytest.raises(UsageError, match="exclude"):
        resolve(width=3, resolution=(3, 3))


def test_camera_without_an_aperture_is_refused_by_name(resolve):
    with pytest.raises(LayerError, match="aperture"):
        resolve(attributes=["/Cam.verticalAperture=0"])


def test_picture_larger_than_memory_is_refused_before_it_is_made(resolve, monkeypatch):
    monkeypatch.setattr(memory, "available_bytes", lambda: 2**20)
    with pytest.raises(DeviceError, match=r"1024 x 683 pixels need .* GiB") as caught:
        resolve()
    assert caught.value.exit_code == 6
    assert resolve(width=64)


def test_spectral_picture_counts_its_bands_as_memory(resolve):
    plain = resolve(width=300)[0].products[0]
    spectral = resolve(width=300, spectral_output=True)[0].products[0]
    more = memory.picture_bytes(spectral, 61) - memory.picture_bytes(plain, 61)
    assert more == 300 * 200 * 61 * 4


# Wrong values


@pytest.mark.parametrize(
    "opinion",
    [
        "uniform int usdskin:samplesPerPixel = 0",
        "uniform int usdskin:samplesPerPixel = 5000",
        "uniform int usdskin:seed = -1",
        'uniform token usdskin:pixelFilter = "blackmanHarriss"',
        'uniform token usdskin:integrator = "rays"',
        "uniform float usdskin:targetError = 2",
        'uniform token usdskin:observer = "cie1931"',
        "uniform double[] usdskin:wavelengths = []",
        "uniform double[] usdskin:wavelengths = [500, 400]",
        "uniform double[] usdskin:wavelengths = [500, 500]",
        "uniform double[] usdskin:wavelengths = [500, nan]",
        "uniform double[] usdskin:wavelengths = [200, 500]",
        "uniform double[] usdskin:wavelengths = [500, 1200]",
        'uniform token aspectRatioConformPolicy = "stretch"',
        "uniform float pixelAspectRatio = 0",
        "uniform float pixelAspectRatio = nan",
        'uniform token[] includedPurposes = ["rendr"]',
        'uniform token renderingColorSpace = "srgb_rec709_scene"',
        'uniform token renderingColorSpace = "rec709"',
        'uniform string resolution = "big"',
        "uniform float4 dataWindowNDC = (1, 0, 0, 1)",
        "rel camera = [</Cam>, </Render>]",
        "rel camera = </Nowhere>",
        "rel products = </Cam>",
    ],
)
def test_wrong_authored_value_is_an_error_of_the_layer(resolve, opinion):
    with pytest.raises(LayerError, match=r"shot\.usda"):
        resolve(**with_settings(opinion))


@pytest.mark.parametrize(
    ("flag", "value"),
    [
        ("samples", 0),
        ("samples", 4097),
        ("seed", -1),
        ("subdivision_level", 9),
        ("integrator", "rays"),
        ("target_error", -0.1),
        ("purposes", ("rendr",)),
        ("mask", ("World",)),
        ("mask", ("/Cam.focalLength",)),
        ("mask", ("/Nowhere",)),
        ("aovs", ("M",)),
        ("aovs", ("N", "all")),
        ("compression", "dwaa"),
        ("output", Path("picture.jpg")),
    ],
)
def test_wrong_flag_is_a_usage_error(resolve, flag, value):
    with pytest.raises(UsageError):
        resolve(**{flag: value})


def test_misspelt_token_is_answered_with_the_one_that_was_meant(resolve):
    with pytest.raises(LayerError, match="blackmanHarris"):
        resolve(**with_settings('uniform token usdskin:pixelFilter = "blackmanHariss"'))


def test_flag_for_the_map_wins_over_a_traced_stage(resolve):
    traced = with_settings('uniform token usdskin:integrator = "traced"')
    assert resolve(**traced, integrator="map")[0].settings.integrator == "map"


def test_traced_pictures_take_more_samples_where_nobody_says_how_many(resolve):
    assert resolve(integrator="map")[0].settings.samples_per_pixel == 4
    assert resolve(integrator="traced")[0].settings.samples_per_pixel == 64
    assert resolve(integrator="traced", samples=9)[0].settings.samples_per_pixel == 9
    authored = with_settings("uniform int usdskin:samplesPerPixel = 7")
    assert resolve(**authored, integrator="traced")[0].settings.samples_per_pixel == 7


@pytest.mark.parametrize(
    "text", ["400:700", "700:400:5", "400:700:0", "a:b:c", "400:1e9:1", "1:2:nan"]
)
def test_wavelengths_that_are_no_range_are_a_usage_error(text):
    with pytest.raises(UsageError, match="--wavelengths"):
        parse_wavelengths(text)


def test_last_wavelength_is_reached_in_spite_of_rounding():
    assert parse_wavelengths("400:401:0.1").size == 11


# Frames


def test_stage_without_times_has_one_frame_at_the_earliest(resolve):
    (frame,) = resolve()[0].frames
    assert frame.number is None
    assert frame.time.IsEarliestTime()


def test_stage_with_a_range_is_rendered_at_its_start(resolve):
    job, _ = resolve(metadata="startTimeCode = 101\nendTimeCode = 110")
    assert [frame.number for frame in job.frames] == [101]


def test_several_frames_need_a_place_for_the_number(resolve):
    with pytest.raises(UsageError, match="####"):
        resolve(output=Path("out.exr"), frames=(1, 2))
    job, _ = resolve(output=Path("out.####.exr"), frames=(1, 2))
    assert [frame.number for frame in job.frames] == [1, 2]
    with pytest.raises(UsageError, match=r"###\.###"):
        resolve(output=Path("out.####.exr"), frames=(1, 1.5))


def test_several_frames_without_a_name_get_a_place(resolve):
    assert resolve(frames=(1, 2))[0].products[0].exr == Path("shot.####.exr")


# Products and their files


def test_stage_without_products_is_written_under_its_own_name(resolve):
    (picture,) = resolve()[0].products
    assert picture.files == (Path("shot.exr"), Path("shot.png"))
    assert picture.camera == "/Cam"
    assert picture.beauty
    assert not picture.aovs


def test_spectral_and_preview_lie_beside_the_picture(resolve):
    (picture,) = resolve(output=Path("a/b.####.exr"), spectral_output=True, frames=(1,))[0].products
    assert picture.files == (
        Path("a/b.####.exr"),
        Path("a/b.####.png"),
        Path("a/b.####.spectral.exr"),
    )


def test_output_that_is_a_png_is_only_that(resolve):
    text = with_settings(
        "rel products = </Render/Beauty>",
        others=product("Beauty", "rel orderedVars = </Render/N>")
        + var("N", 'string sourceName = "N"'),
    )
    (picture,) = resolve(**text, output=Path("a.png"))[0].products
    assert picture.files == (Path("a.png"),)
    assert picture.aovs == ()


def test_preview_can_be_left_out(resolve):
    assert resolve(png=False)[0].products[0].files == (Path("shot.exr"),)


def test_all_aovs_can_be_asked_for_in_their_order(resolve):
    (picture,) = resolve(aovs=("all",))[0].products
    names = ["N", "P", "Z", "albedo", "st", "primId", "irradiance"]
    names += ["crypto_object", "crypto_material"]
    assert [aov.name for aov in picture.aovs] == names
    assert resolve(aovs=("primid", "n"))[0].products[0].aovs == (
        Aov("primId", "primId"),
        Aov("N", "N"),
    )


BEAUTY_AND_SPECTRAL = with_settings(
    "",
    "rel products = [</Render/Beauty>, </Render/Spectral>]",
    product(
        "Beauty",
        'token productName = "b.exr"\n'
        "rel orderedVars = [</Render/Ci>, </Render/normals>, </Render/uv>, </Render/odd>]",
    )
    + product(
        "Spectral", 'token productName = "b.spectral.exr"\nrel orderedVars = [</Render/spectrum>]'
    )
    + var("Ci", 'uniform token dataType = "half4"')
    + var("normals", 'uniform string sourceName = "N"')
    + var("uv", 'uniform string sourceName = "st"\nuniform token sourceType = "primvar"')
    + var("odd", 'uniform string sourceName = "ri:whatever"')
    + var("spectrum", 'uniform string sourceName = "spectralRadiance"'),
)


def test_render_vars_become_parts_under_their_own_names(resolve):
    job, notes = resolve(**BEAUTY_AND_SPECTRAL)
    beauty, spectral = job.products
    assert beauty.files == (Path("b.exr"), Path("b.png"))
    assert beauty.aovs == (Aov("normals", "N"), Aov("uv", "st"))
    assert beauty.half
    assert spectral.files == (Path("b.spectral.exr"),)
    assert spectral.spectral == Path("b.spectral.exr")
    assert not spectral.beauty
    assert [(note.code, note.path) for note in notes] == [("aov-not-written", "/Render/odd")]


def test_output_takes_the_place_of_all_products_of_its_view(resolve):
    job, _ = resolve(**BEAUTY_AND_SPECTRAL, output=Path("o.exr"))
    (picture,) = job.products
    assert picture.files == (Path("o.exr"), Path("o.png"), Path("o.spectral.exr"))
    assert [aov.name for aov in picture.aovs] == ["normals", "uv"]


def test_spectral_flag_adds_nothing_where_a_product_is_spectral(resolve):
    job, _ = resolve(**BEAUTY_AND_SPECTRAL, spectral_output=True)
    assert [item.spectral for item in job.products] == [None, Path("b.spectral.exr")]


def test_no_spectral_leaves_the_spectral_product_out(resolve):
    job, _ = resolve(**BEAUTY_AND_SPECTRAL, spectral_output=False)
    assert [item.prim_path for item in job.products] == ["/Render/Beauty"]


def test_authored_spectral_output_can_be_switched_off(resolve):
    authored = with_settings("uniform bool usdskin:spectralOutput = true")
    assert resolve(**authored)[0].products[0].spectral == Path("shot.spectral.exr")
    assert resolve(**authored, spectral_output=False)[0].products[0].spectral is None


def test_product_of_another_view_is_named_when_output_leaves_it_out(resolve):
    job, notes = resolve(
        **with_settings(
            "",
            "rel products = [</Render/A>, </Render/B>]",
            product("A", "") + product("B", "uniform int2 resolution = (8, 8)"),
        ),
        output=Path("o.exr"),
    )
    assert len(job.products) == 1
    assert [(note.code, note.path) for note in notes] == [("product-not-written", "/Render/B")]


def test_deep_product_is_named_and_left_out(resolve):
    job, notes = resolve(
        **with_settings(
            "",
            "rel products = [</Render/A>, </Render/D>]",
            product("A", "") + product("D", 'uniform token productType = "deepRaster"'),
        )
    )
    assert [item.files[0] for item in job.products] == [Path("A.exr")]
    assert [note.path for note in notes] == ["/Render/D"]


def test_crop_that_is_not_honoured_is_named(resolve):
    _, notes = resolve(**with_settings("uniform float4 dataWindowNDC = (0, 0, 0.5, 1)"))
    assert [note.code for note in notes] == ["data-window-ignored"]


@pytest.mark.parametrize(
    "name",
    ["/tmp/a.exr", "../a.exr", "a/../../b.exr", "C:/a.exr", "\\\\\\\\host\\\\a.exr", "~/a.exr"],
)
def test_product_may_not_leave_the_current_folder_unless_allowed(resolve, name):
    text = with_settings(
        "", "rel products = </Render/A>", product("A", f'token productName = "{name}"')
    )
    with pytest.raises(LayerError, match="outside"):
        resolve(**text)
    assert resolve(**text, allow_outside=True)
    assert resolve(**text, output=Path("o.exr"))


def test_two_products_of_one_name_are_refused(resolve):
    with pytest.raises(LayerError, match=r"both write same\.exr"):
        resolve(
            **with_settings(
                "",
                "rel products = [</Render/A>, </Render/B>]",
                product("A", 'token productName = "same.exr"')
                + product("B", 'token productName = "same.exr"'),
            )
        )


@pytest.mark.parametrize("body", ['token productName = "a.tif"', "rel orderedVars = </Nothing>"])
def test_product_that_cannot_be_written_is_refused(resolve, body):
    with pytest.raises(LayerError):
        resolve(**with_settings("", "rel products = </Render/A>", product("A", body)))


def test_folders_are_made_before_rendering(resolve, tmp_path):
    (picture,) = resolve(output=tmp_path / "new" / "o.exr")[0].products
    prepare_folders(picture.files, tmp_path / "shot.usda")
    assert (tmp_path / "new").is_dir()


def test_folder_that_cannot_be_made_is_refused(resolve, tmp_path):
    (tmp_path / "file").write_text("")
    (picture,) = resolve(output=tmp_path / "file" / "o.exr")[0].products
    with pytest.raises(UsdSkinError, match="file"):
        prepare_folders(picture.files, tmp_path / "shot.usda")


def test_output_that_is_a_folder_is_a_usage_error(resolve, tmp_path):
    (tmp_path / "d.exr").mkdir()
    (picture,) = resolve(output=tmp_path / "d.exr")[0].products
    with pytest.raises(UsageError, match="folder"):
        prepare_folders(picture.files, tmp_path / "shot.usda")


# Identity


def test_digest_follows_what_has_a_bearing_on_pixels_only(resolve):
    def digest(**flags):
        job, _ = resolve(**flags)
        return job.digest(job.products[0])

    assert digest() == digest(threads=1, compression="piz", ev=3.0, output=Path("x.exr"))
    others = [
        digest(samples=5),
        digest(width=10),
        digest(wavelength_nm=parse_wavelengths("400:700:10")),
        digest(mask=("/Cam",)),
        digest(attributes=("/Cam.focalLength=20",)),
    ]
    assert len({digest(), *others}) == 6


# Overrides in the session layer

LOOK = """
def Xform "Look" (
    variants = {
        string lamp = "tube"
    }
    prepend variantSets = "lamp"
)
{
    float gain.timeSamples = {1: 5}
    color3f tint = (1, 1, 1)
    asset file = @a.exr@
    double[] list = [1]
    bool on = false
    string label = "x"
    uniform token mode = "map" (allowedTokens = ["map", "traced"])
    rel target
    float linked = 1
    float linked.connect = </Look.gain>
    variantSet "lamp" = {
        "tube" {
        }
        "bulb" {
        }
    }
}
"""


@pytest.fixture
def applied(tmp_path):
    """Return a function from flags to the prim they were applied to."""
    stages = []

    def run(**flags):
        path = tmp_path / "look.usda"
        path.write_text(f"#usda 1.0\n{LOOK}")
        stage = open_stage(path)
        stages.append(stage)  # a prim does not keep its stage
        apply_overrides(stage, RenderOverrides(**flags))
        assert path.read_text() == f"#usda 1.0\n{LOOK}"
        return stage.GetPrimAtPath("/Look")

    return run


@pytest.mark.parametrize(
    ("assignment", "value"),
    [
        ("gain=2.5", 2.5),
        ("tint=1,0.5,0", (1, 0.5, 0)),
        ("tint=(0, 1, 0)", (0, 1, 0)),
        ("list=1,2,3", [1, 2, 3]),
        ("list=[]", []),
        ("on=True", True),
        ("label=two words = 'one'", "two words = 'one'"),
        ("mode=traced", "traced"),
    ],
)
def test_attribute_is_set_from_text_as_its_type(applied, assignment, value):
    prim = applied(attributes=[f"/Look.{assignment}"])
    found = prim.GetAttribute(assignment.partition("=")[0]).Get(1)
    assert (list(found) if isinstance(value, list) else found) == value


def test_asset_is_found_from_the_current_folder(applied, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "b.exr").write_text("")
    prim = applied(attributes=["/Look.file=b.exr"])
    assert prim.GetAttribute("file").Get().path == str(tmp_path / "b.exr")


def test_relationship_is_set_to_a_path(applied):
    prim = applied(attributes=["/Look.target=/Look"])
    assert prim.GetRelationship("target").GetTargets() == [Sdf.Path("/Look")]


def test_set_value_wins_over_a_connection(applied):
    prim = applied(attributes=["/Look.linked=3"])
    assert prim.GetAttribute("linked").GetConnections() == []
    assert prim.GetAttribute("linked").Get() == 3


def test_variant_is_selected(applied):
    prim = applied(variants=["/Look{lamp=bulb}"])
    assert prim.GetVariantSet("lamp").GetVariantSelection() == "bulb"


@pytest.mark.parametrize(
    ("flag", "value", "says"),
    [
        ("variants", "/Look(lamp=bulb)", "/prim{set=variant}"),
        ("variants", "/Luk{lamp=bulb}", "</Luk>"),
        ("variants", "/Look{lampe=bulb}", "it has lamp"),
        ("variants", "/Look{lamp=bulbs}", "tube, bulb|bulb, tube"),
        ("attributes", "Look.gain=1", "/prim.attribute=value"),
        ("attributes", "/Look.gain", "/prim.attribute=value"),
        ("attributes", "/Luk.gain=1", "</Luk>"),
        ("attributes", "/Look.gian=1", "Did you mean gain"),
        ("attributes", "/Look.gain=much", "no float"),
        ("attributes", "/Look.gain=1 custom float w = 2", "no float"),
        ("attributes", "/Look.tint=1,2", "no color3f"),
        ("attributes", "/Look.mode=tracd", "map, traced"),
        ("attributes", "/Look.target=a b", "no path"),
    ],
)
def test_wrong_override_is_a_usage_error_that_helps(applied, flag, value, says):
    with pytest.raises(UsageError, match=says):
        applied(**{flag: [value]})
