"""RGB domes: uplift, brightness, colour spaces, orientation, files."""

import numpy as np
import OpenEXR
import OpenImageIO
import pytest
from light_stages import (
    RNG,
    WEIGHTS,
    adapted,
    codes,
    dome,
    new_stage,
    only_dome,
    radiance,
    read,
    rgb_map,
    spectral,
    write_exr,
    write_rgb,
    xyz,
)
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

from usdskin.colorimetry import illuminant, rgb_to_xyz, xyz_to_rgb
from usdskin.errors import ImageError, LayerError
from usdskin.render.lights import read_lights
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as NM


@pytest.mark.parametrize("lamp", ["D65", "A", "FL2", "FL11", "LED-B3"])
@pytest.mark.parametrize("way", ["option", "name", "file"])
def test_rgb_dome_has_the_adapted_xyz_of_its_pixels(tmp_path, lamp, way):
    pixels = rgb_map()
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "map.exr", pixels))
    if way == "name":
        spectral(light, "rgb", illuminant=lamp)
    if way == "file":
        table_nm = np.arange(380.0, 781.0, 5.0)
        rows = zip(table_nm, illuminant(lamp, table_nm), strict=True)
        file = tmp_path / "lamp.csv"
        file.write_text("".join(f"{a:g},{float(b)!r}\n" for a, b in rows))
        spectral(light, "rgb", illuminant_file=Sdf.AssetPath(str(file)))
    out = only_dome(stage, illuminant=lamp if way == "option" else None)
    assert out.coefficients.shape == (8, 16, 3) and out.coefficients.dtype == np.float32
    assert not out.absolute
    np.testing.assert_allclose(xyz(out), adapted(pixels, lamp), atol=1e-6)


def test_white_light_of_intensity_one_has_luminance_one():
    stage = new_stage()
    dome(stage)
    out = only_dome(stage)
    np.testing.assert_allclose(xyz(out)[..., 1], 1.0, rtol=1e-7)
    d65 = illuminant("D65", NM)
    np.testing.assert_allclose(radiance(out)[0, 0], d65 / (d65 @ WEIGHTS)[1], rtol=3e-7)


def test_intensity_and_exposure_multiply_and_normalize_does_not():
    stage = new_stage()
    light = dome(stage)
    light.CreateIntensityAttr(3.0)
    light.CreateExposureAttr(-2.0)
    light.CreateNormalizeAttr(True)
    np.testing.assert_allclose(xyz(only_dome(stage))[..., 1], 0.75, rtol=1e-6)


def test_option_wins_over_the_authored_lamp():
    stage = new_stage()
    spectral(dome(stage), "rgb", illuminant="FL2")
    authored, given = only_dome(stage), only_dome(stage, illuminant="A")
    np.testing.assert_allclose(xyz(authored)[0, 0], adapted(np.ones(3), "FL2"), rtol=1e-6)
    np.testing.assert_allclose(xyz(given)[0, 0], adapted(np.ones(3), "A"), rtol=1e-6)


def test_color_multiplies_the_map(tmp_path):
    pixels = rgb_map()
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "m.exr", pixels)).CreateColorAttr((0.5, 0.25, 2.0))
    np.testing.assert_allclose(
        xyz(only_dome(stage)), adapted(pixels * [0.5, 0.25, 2.0], "D65"), atol=2e-6
    )


def test_color_multiplies_in_its_own_space_when_the_map_is_in_another(tmp_path):
    pixels = rgb_map()
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", pixels))
    light.GetTextureFileAttr().SetColorSpace("lin_ap1_scene")
    light.CreateColorAttr((0.5, 0.25, 2.0))
    to_709 = xyz_to_rgb("lin_rec709_scene") @ rgb_to_xyz("lin_ap1_scene")
    tinted = (pixels @ to_709.T) * [0.5, 0.25, 2.0]
    np.testing.assert_allclose(xyz(only_dome(stage)), adapted(tinted, "D65"), atol=3e-6)


def test_color_temperature_counts_only_when_enabled():
    stage = new_stage()
    light = dome(stage)
    light.CreateColorTemperatureAttr(3000.0)
    np.testing.assert_allclose(xyz(only_dome(stage))[0, 0], adapted(np.ones(3), "D65"), rtol=1e-6)
    light.CreateEnableColorTemperatureAttr(True)
    warm = np.array(UsdLux.BlackbodyTemperatureAsRgb(3000.0))
    np.testing.assert_allclose(xyz(only_dome(stage))[0, 0], adapted(warm, "D65"), rtol=1e-6)


def test_absolute_rgb_light_is_in_candela_per_square_metre():
    stage = new_stage()
    light = dome(stage)
    light.CreateIntensityAttr(250.0)
    spectral(light, "rgb", units="absolute")
    out = only_dome(stage)
    assert out.absolute and read(stage).absolute
    np.testing.assert_allclose(xyz(out)[..., 1], 250.0, rtol=1e-6)


def test_time_samples_are_read_at_the_time():
    stage = new_stage()
    attribute = dome(stage).CreateIntensityAttr()
    attribute.Set(1.0, 1.0)
    attribute.Set(3.0, 3.0)
    (out,) = read_lights(stage, 2.0, NM).domes
    np.testing.assert_allclose(xyz(out)[..., 1], 2.0, rtol=1e-6)


def test_saturated_map_under_a_warm_lamp_gets_a_note_and_keeps_its_xyz(tmp_path):
    pixels = np.full((4, 8, 3), 0.5, np.float32)
    pixels[2, 5] = [1.0, 0.0, 0.0]
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "m.exr", pixels))
    notes = []
    out = only_dome(stage, notes, illuminant="FL2")
    assert codes(notes) == ["uplift-negative"]
    assert "1 of 32" in notes[0].message and "x 5, y 2" in notes[0].message
    lowest = (radiance(out)[2, 5] / radiance(out)[2, 5].max()).min()
    assert lowest < -0.01 and f"{-lowest:.1%}" in notes[0].message
    np.testing.assert_allclose(xyz(out), adapted(pixels, "FL2"), atol=1e-6)


# --- Colour spaces of maps ------------------------------------------------------------------------


def write_png(path, pixels):
    spec = OpenImageIO.ImageSpec(pixels.shape[1], pixels.shape[0], 3, "uint8")
    out = OpenImageIO.ImageOutput.create(str(path))
    assert out.open(str(path), spec) and out.write_image(pixels)
    out.close()
    return str(path)


def test_8_bit_map_is_srgb_encoded(tmp_path):
    pixels = np.full((4, 8, 3), 128, np.uint8)
    stage = new_stage()
    dome(stage, write_png(tmp_path / "m.png", pixels))
    linear = ((128 / 255 + 0.055) / 1.055) ** 2.4
    np.testing.assert_allclose(xyz(only_dome(stage))[..., 1], linear, rtol=1e-5)


@pytest.mark.parametrize("way", ["attribute", "inherited", "file"])
def test_map_is_read_in_the_space_it_says(tmp_path, way):
    pixels = rgb_map()
    header = {}
    if way == "file":
        header["chromaticities"] = (0.713, 0.293, 0.165, 0.830, 0.128, 0.044, 0.32168, 0.33767)
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", pixels, **header))
    if way == "attribute":
        light.GetTextureFileAttr().SetColorSpace("lin_ap1_scene")
    if way == "inherited":
        api = Usd.ColorSpaceAPI.Apply(light.GetPrim())
        api.CreateColorSpaceNameAttr("lin_ap1_scene")
    expected = adapted(pixels, "D65", "lin_ap1_scene")
    np.testing.assert_allclose(xyz(only_dome(stage)), expected, atol=2e-6)


def test_grey_map_is_grey_light(tmp_path):
    grey = RNG.random((4, 8)).astype(np.float32)
    stage = new_stage()
    dome(stage, write_exr(tmp_path / "m.exr", {"Y": grey}))
    np.testing.assert_allclose(xyz(only_dome(stage))[..., 1], grey, atol=1e-6)


def test_unknown_color_space_is_refused(tmp_path):
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", rgb_map()))
    light.GetTextureFileAttr().SetColorSpace("mystery")
    with pytest.raises(LayerError, match=r"</Dome>.*'mystery'"):
        read(stage)


# --- Orientation ----------------------------------------------------------------------------------

# Column of an 8-column map, row of a 4-row map, and the direction the light's own frame gives it:
# u = 0.5 is +Z, u = 0.25 is +X, the top row is +Y (OpenEXR latlong).
LOCAL = {"+X": [1, 0, 0], "-X": [-1, 0, 0], "+Z": [0, 0, 1], "-Z": [0, 0, -1], "+Y": [0, 1, 0]}


def sample(light, world):
    """Return the coefficients a world direction sees, by the definition of latlong."""
    x, y, z = light.to_world.T @ np.asarray(world, dtype=np.float64)
    height, width = light.coefficients.shape[:2]
    u = (0.5 - np.arctan2(x, z) / (2.0 * np.pi)) % 1.0
    v = np.arccos(np.clip(y, -1.0, 1.0)) / np.pi
    row, column = min(int(v * height), height - 1), min(int(u * width), width - 1)
    return light.coefficients[row, column]


def pointer_map():
    """Return a map whose pixels hold the direction they come from, over 0."""
    height, width = 64, 128
    polar = np.pi * (np.arange(height)[:, None] + 0.5) / height
    azimuth = np.pi * (1.0 - 2.0 * (np.arange(width)[None] + 0.5) / width)
    direction = np.stack(
        [
            np.sin(polar) * np.sin(azimuth),
            np.cos(polar) + 0.0 * azimuth,
            np.sin(polar) * np.cos(azimuth),
        ],
        axis=-1,
    )
    return (direction + 1.5).astype(np.float32)


def seen(light, world):
    return sample(light, world)[:3] - 1.5


def turned(stage, texture, matrix, kind=UsdLux.DomeLight):
    light = dome(stage, texture, kind=kind)
    transform = Gf.Matrix4d(
        *np.asarray(
            np.block([[matrix.T, np.zeros((3, 1))], [np.array([[5.0, 6.0, 7.0]]), np.eye(1)]])
        ).tolist()
    )
    UsdGeom.Xformable(light).AddTransformOp().Set(transform)
    return light


def random_rotation(seed):
    q, r = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    q = q * np.sign(np.diag(r))
    return q if np.linalg.det(q) > 0 else q @ np.diag([1.0, 1.0, -1.0])


DIRECTIONS = [*LOCAL.values(), [0.0, -1.0, 0.0], [0.6, 0.48, -0.64], [-0.48, -0.6, 0.64]]


@pytest.mark.parametrize("up", ["Y", "Z"])
def test_dome_pole_is_plus_y_whatever_the_up_axis(tmp_path, up):
    stage = new_stage(up)
    dome(stage, write_rgb(tmp_path / "m.exr", pointer_map()))
    out = only_dome(stage)
    np.testing.assert_allclose(out.to_world, np.eye(3), atol=1e-15)
    for direction in DIRECTIONS:
        np.testing.assert_allclose(seen(out, direction), direction, atol=0.06)


def test_corner_and_quarter_columns_are_where_openexr_says():
    pixels = pointer_map() - 1.5
    np.testing.assert_allclose(pixels[32, 64], [0, 0, 1], atol=0.06)
    np.testing.assert_allclose(pixels[32, 32], [1, 0, 0], atol=0.06)
    np.testing.assert_allclose(pixels[0, 0], [0, 1, 0], atol=0.06)


@pytest.mark.parametrize(
    ("up", "axis", "z_pole"),
    [("Y", "scene", False), ("Z", "scene", True), ("Y", "Z", True), ("Z", "Y", False)],
)
def test_dome_1_stands_on_its_pole_axis(tmp_path, up, axis, z_pole):
    stage = new_stage(up)
    light = dome(stage, write_rgb(tmp_path / "m.exr", pointer_map()), kind=UsdLux.DomeLight_1)
    light.CreatePoleAxisAttr(axis)
    out = only_dome(stage)
    assert np.linalg.det(out.to_world) == pytest.approx(1.0)
    # "latitude 0, longitude 0 will instead point into the negative Y direction" (UsdLux).
    world = (
        {"pole": [0, 0, 1], "front": [0, -1, 0]}
        if z_pole
        else {"pole": [0, 1, 0], "front": [0, 0, 1]}
    )
    np.testing.assert_allclose(seen(out, world["pole"]), LOCAL["+Y"], atol=0.06)
    np.testing.assert_allclose(seen(out, world["front"]), LOCAL["+Z"], atol=0.06)
    np.testing.assert_allclose(seen(out, [1, 0, 0]), LOCAL["+X"], atol=0.06)


@pytest.mark.parametrize("mirror", [[1, 1, 1], [-1, 1, 1], [1, -1, 1], [1, 1, -1], [-1, -1, -1]])
@pytest.mark.parametrize("size", [1.0, 0.01])
def test_turned_and_mirrored_domes_show_the_map_turned_and_mirrored(tmp_path, mirror, size):
    matrix = random_rotation(4) @ np.diag(np.float64(mirror))
    stage = new_stage()
    turned(stage, write_rgb(tmp_path / "m.exr", pointer_map()), size * matrix)
    notes = []
    out = only_dome(stage, notes)
    assert np.linalg.det(out.to_world) == pytest.approx(1.0)
    np.testing.assert_allclose(out.to_world @ out.to_world.T, np.eye(3), atol=1e-12)
    for direction in DIRECTIONS:
        np.testing.assert_allclose(seen(out, matrix @ direction), direction, atol=0.06)
    assert notes == []


def test_mirrored_dome_1_is_mirrored_after_its_pole_is_set(tmp_path):
    matrix = random_rotation(5) @ np.diag([1.0, 1.0, -1.0])
    stage = new_stage("Z")
    turned(stage, write_rgb(tmp_path / "m.exr", pointer_map()), matrix, UsdLux.DomeLight_1)
    out = only_dome(stage)
    np.testing.assert_allclose(seen(out, matrix @ [0, 0, 1]), LOCAL["+Y"], atol=0.06)
    np.testing.assert_allclose(seen(out, matrix @ [0, -1, 0]), LOCAL["+Z"], atol=0.06)
    np.testing.assert_allclose(seen(out, matrix @ [1, 0, 0]), LOCAL["+X"], atol=0.06)


def test_uneven_scale_of_a_dome_is_noted_and_flattened_dome_refused():
    stage = new_stage()
    light = dome(stage)
    operation = UsdGeom.Xformable(light).AddScaleOp()
    operation.Set((1.0, 2.0, 1.0))
    notes = []
    np.testing.assert_allclose(only_dome(stage, notes).to_world, np.eye(3), atol=1e-12)
    assert codes(notes) == ["dome-scale-ignored"]
    operation.Set((1.0, 0.0, 1.0))
    with pytest.raises(LayerError, match=r"</Dome>.*orientation"):
        read(stage)


def test_parents_turn_a_dome():
    stage = new_stage()
    UsdGeom.Xform.Define(stage, "/World").AddRotateYOp().Set(90.0)
    dome(stage, path="/World/Dome")
    np.testing.assert_allclose(only_dome(stage).to_world @ [0, 0, 1], [1, 0, 0], atol=1e-12)


# --- Files ----------------------------------------------------------------------------------------


def test_missing_map_is_an_image_error_naming_layer_prim_and_path(tmp_path):
    stage = Usd.Stage.CreateNew(str(tmp_path / "shot.usda"))
    dome(stage, "./nowhere.exr")
    with pytest.raises(ImageError, match=r"shot.usda </Dome>: .*@./nowhere.exr@"):
        read(stage)


def test_broken_map_is_an_image_error_naming_prim_and_path(tmp_path):
    path = tmp_path / "broken.exr"
    path.write_bytes(b"v/1\x01not an image")
    stage = new_stage()
    dome(stage, str(path))
    with pytest.raises(ImageError, match=r"broken.exr \(.*</Dome>\)"):
        read(stage)


def test_relative_map_counts_from_the_layer_that_names_it(tmp_path):
    (tmp_path / "lights").mkdir()
    write_rgb(tmp_path / "lights" / "m.exr", rgb_map())
    asset = Usd.Stage.CreateNew(str(tmp_path / "lights" / "light.usda"))
    asset.SetDefaultPrim(dome(asset, "./m.exr").GetPrim())
    asset.Save()
    stage = new_stage()
    stage.DefinePrim("/Key").GetReferences().AddReference(str(tmp_path / "lights" / "light.usda"))
    assert only_dome(stage).path == "/Key"


def test_map_of_one_pixel_is_that_color_all_around(tmp_path):
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "grey.exr", np.full((1, 1, 3), 0.5)))
    np.testing.assert_allclose(
        xyz(only_dome(stage)),
        np.broadcast_to(adapted(np.full(3, 0.5), "D65"), (2, 4, 3)),
        rtol=1e-5,
    )


@pytest.mark.parametrize(("name", "value"), [("intensity", 1e20), ("exposure", 66.0)])
def test_light_beyond_what_float32_can_square_is_refused(name, value, tmp_path):
    """Sums of squares of a map's strengths would overflow, and the light vanish."""
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", rgb_map()))
    light.GetPrim().GetAttribute(f"inputs:{name}").Set(value)
    with pytest.raises(LayerError, match="beyond"):
        only_dome(stage)


def test_map_that_is_no_latlong_is_refused_unless_it_says_so(tmp_path):
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", rgb_map(8, 8)))
    with pytest.raises(ImageError, match="8 x 8 pixels are not twice"):
        read(stage)
    light.CreateTextureFormatAttr("latlong")
    assert only_dome(stage).coefficients.shape == (8, 8, 3)


@pytest.mark.parametrize("reads", [True, False], ids=["latlong", "cube"])
def test_envmap_attribute_of_an_exr_says_what_it_is(tmp_path, reads):
    kind, height = (OpenEXR.ENVMAP_LATLONG, 8) if reads else (OpenEXR.ENVMAP_CUBE, 48)
    pixels = np.ones((height, 8, 3), np.float32)
    file = write_rgb(tmp_path / "m.exr", pixels, envmap=kind)
    stage = new_stage()
    dome(stage, file)
    if reads:
        assert only_dome(stage).coefficients.shape == (8, 8, 3)
    else:
        with pytest.raises(ImageError, match="convert"):
            read(stage)


def test_map_without_rgb_is_refused(tmp_path):
    stage = new_stage()
    ones = np.ones((4, 8))
    dome(stage, write_exr(tmp_path / "m.exr", {"c0": ones, "c1": ones}))
    with pytest.raises(ImageError, match="no channels R, G, B; it has c0, c1"):
        read(stage)


# --- Speed ----------------------------------------------------------------------------------------


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "size", "is_bad"),
    [
        ("empty_warehouse_01_1k.hdr", (512, 1024), False),
        ("st_fagans_interior_1k.hdr", (512, 1024), False),
        ("immenstadter_horn_1k.hdr", (512, 1024), False),
        ("hotel_interior_1k.exr", (512, 1024), True),
        ("royal_esplanade_512.exr", (256, 512), True),
    ],
)
def test_real_maps_load_or_say_what_is_wrong(realdata, name, size, is_bad):
    stage = new_stage()
    dome(stage, str(realdata / "hdri" / name))
    if is_bad:
        with pytest.raises(ImageError, match=rf"{name}.*pixels are no light: \d+ negative"):
            read(stage)
    notes = []
    out = only_dome(stage, notes, bad_pixels="clamp", illuminant="FL2")
    assert ("bad-pixels-clamped" in codes(notes)) == is_bad
    assert out.coefficients.shape == (*size, 3)
    assert np.isfinite(out.coefficients).all() and out.coefficients.min() >= 0.0
    mean = xyz(out).mean(axis=(0, 1))
    np.testing.assert_allclose(
        mean, adapted(out.coefficients.astype(np.float64), "FL2").mean(axis=(0, 1)), rtol=1e-6
    )
