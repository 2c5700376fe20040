import subprocess
import sys
import time

import numpy as np
import OpenEXR
import OpenImageIO
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, Vt

import usdskin.schemas  # noqa: F401  (registers before the first stage)
from usdskin.colorimetry import (
    cat16,
    daylight,
    illuminant,
    planck_radiance,
    rgb_to_xyz,
    white_xyz,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.errors import ImageError, LayerError, UsageError
from usdskin.prims import write_spectrum
from usdskin.render.lights import read_lights
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as NM
from usdskin.spectrum import SpectralQuantity, Spectrum

WEIGHTS = xyz_weights(NM)
ABSOLUTE = xyz_weights(NM, absolute=True)
RNG = np.random.default_rng(3)


def new_stage(up="Y"):
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, up)
    return stage


def write_exr(path, channels, **header):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, **header}
    arrays = {name: np.ascontiguousarray(a, dtype=np.float32) for name, a in channels.items()}
    OpenEXR.File(header, arrays).write(str(path))
    return str(path)


def write_rgb(path, pixels, **header):
    return write_exr(path, {"RGB": pixels}, **header)


def rgb_map(height=8, width=16):
    return RNG.random((height, width, 3)).astype(np.float32)


def dome(stage, texture=None, path="/Dome", kind=UsdLux.DomeLight):
    light = kind.Define(stage, path)
    if texture is not None:
        light.CreateTextureFileAttr(Sdf.AssetPath(texture))
    return light


def spectral(light, source, **inputs):
    prim = light.GetPrim()
    prim.ApplyAPI("SpectralLightAPI")
    prim.GetAttribute("inputs:spectral:source").Set(source)
    for name, value in inputs.items():
        attribute = prim.GetAttribute(f"inputs:spectral:{name.replace('_', ':')}")
        attribute.Set(value)
    return prim


def read(stage, notes=None, **options):
    return read_lights(stage, Usd.TimeCode.Default(), NM, notes=notes, **options)


def only_dome(stage, notes=None, **options):
    (light,) = read(stage, notes, **options).domes
    return light


def radiance(light):
    return light.coefficients.astype(np.float64) @ light.basis


def xyz(light):
    return radiance(light) @ (ABSOLUTE if light.absolute else WEIGHTS)


def adapted(rgb, lamp, color_space="lin_rec709_scene"):
    white = illuminant(lamp, NM) @ WEIGHTS
    return rgb @ (cat16(white_xyz(color_space), white / white[1]) @ rgb_to_xyz(color_space)).T


def codes(notes):
    return [note.code for note in notes]


# --- RGB domes ---------------------------------------------------------------------------------


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


# --- Colour spaces of maps ---------------------------------------------------------------------


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


# --- Orientation -------------------------------------------------------------------------------

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


# --- Bad pixels --------------------------------------------------------------------------------


def bad_map():
    pixels = rgb_map(16, 32) + 0.1
    pixels[3, 7, 0] = -2.5
    pixels[9, 1, 2] = -0.5
    pixels[4, 6, 1] = np.nan
    pixels[5, 5, 1] = np.inf
    return pixels


def test_bad_pixels_are_counted_located_and_refused(tmp_path):
    stage = new_stage()
    file = write_rgb(tmp_path / "m.exr", bad_map())
    dome(stage, file)
    with pytest.raises(ImageError) as refusal:
        read(stage)
    text = str(refusal.value)
    assert "\n" not in text and file in text and "</Dome>" in text and "clamp" in text
    assert "4 of 512 pixels" in text
    assert "2 negative (lowest -2.5 at x 7, y 3)" in text
    assert "1 NaN (first at x 6, y 4)" in text
    assert "1 infinite (first at x 5, y 5)" in text


def test_clamped_pixels_are_zero_or_the_brightest_and_the_rest_untouched(tmp_path):
    pixels = bad_map()
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "m.exr", pixels))
    notes = []
    out = only_dome(stage, notes, bad_pixels="clamp").coefficients
    expected = np.where(np.isnan(pixels), 0.0, pixels)
    expected[5, 5, 1] = expected[np.isfinite(expected)].max()
    np.testing.assert_array_equal(out, np.maximum(expected, 0.0).astype(np.float32))
    assert "bad-pixels-clamped" in codes(notes)


def test_all_black_map_is_dark_and_legal(tmp_path):
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "m.exr", np.zeros((4, 8, 3), np.float32)))
    assert not only_dome(stage).coefficients.any()


# --- Spectral domes ----------------------------------------------------------------------------


def test_tabulated_light_is_taken_as_authored():
    value = RNG.random(61)
    stage = new_stage()
    light = dome(stage)
    light.CreateIntensityAttr(2.0)
    light.CreateColorAttr((0.1, 0.9, 0.3))  # the rendition for others
    prim = spectral(light, "tabulated", units="absolute", scale=3.0)
    write_spectrum(prim, "emission", Spectrum(SpectralQuantity.RADIANCE, NM, value))
    out = only_dome(stage)
    assert out.absolute and out.basis.shape == (1, 61)
    np.testing.assert_allclose(radiance(out), np.broadcast_to(6.0 * value, (2, 4, 61)), rtol=1e-6)


def test_absolute_black_body_has_plancks_radiance():
    stage = new_stage()
    light = dome(stage)
    light.CreateColorTemperatureAttr(2856.0)
    spectral(light, "blackbody", units="absolute")
    np.testing.assert_allclose(radiance(only_dome(stage))[0, 0], planck_radiance(2856.0, NM))


@pytest.mark.parametrize(
    ("source", "shape"),
    [("blackbody", planck_radiance(5600.0, NM)), ("illuminantD", daylight(5600.0, NM))],
)
def test_relative_lamp_has_its_shape_and_luminance_one(source, shape):
    stage = new_stage()
    light = dome(stage)
    light.CreateColorTemperatureAttr(5600.0)
    spectral(light, source)
    spectrum = radiance(only_dome(stage))[0, 0]
    assert (spectrum @ WEIGHTS)[1] == pytest.approx(1.0)
    np.testing.assert_allclose(spectrum / spectrum.max(), shape / shape.max(), rtol=1e-9)


def test_absolute_daylight_has_its_intensity_in_candela_per_square_metre():
    stage = new_stage()
    light = dome(stage)
    light.CreateIntensityAttr(100.0)
    spectral(light, "illuminantD", units="absolute")
    np.testing.assert_allclose(xyz(only_dome(stage))[..., 1], 100.0, rtol=1e-6)


def basis_dome(stage, file, basis, nm=NM, **inputs):
    return spectral(
        dome(stage),
        "basis",
        coefficients_file=Sdf.AssetPath(file),
        basis=Vt.DoubleArray.FromNumpy(np.ascontiguousarray(basis, dtype=np.float64).ravel()),
        basis_wavelengths=Vt.DoubleArray.FromNumpy(np.float64(nm)),
        **inputs,
    )


def write_coefficients(path, coefficients):
    rank = coefficients.shape[-1]
    # Channel names sort as text in a file: c10 before c2.
    return write_exr(path, {f"c{k}": coefficients[..., k] for k in range(rank)})


@pytest.mark.parametrize("rank", [1, 3, 12])
def test_basis_light_is_coefficients_times_basis_in_numeric_order(tmp_path, rank):
    coefficients = RNG.random((4, 8, rank)).astype(np.float32)
    basis = RNG.random((rank, 61))
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis, units="absolute")
    out = only_dome(stage)
    assert out.absolute
    np.testing.assert_array_equal(out.coefficients, coefficients)
    np.testing.assert_array_equal(out.basis, basis)


def test_basis_is_band_averaged_onto_the_grid(tmp_path):
    fine = np.arange(390.0, 711.0, 1.0)
    basis = RNG.random((2, fine.size))
    stage = new_stage()
    file = write_coefficients(tmp_path / "c.exr", RNG.random((4, 8, 2)).astype(np.float32))
    basis_dome(stage, file, basis, fine)
    inside = np.abs(fine - 550.0) <= 2.0
    edges = 0.125 * basis[:, np.abs(fine - 550.0) == 3.0].sum(1)  # a quarter of half a step
    edges += 0.375 * basis[:, np.abs(fine - 550.0) == 2.0].sum(1)
    middle = basis[:, inside].sum(1) - 0.5 * basis[:, np.abs(fine - 550.0) == 2.0].sum(1)
    np.testing.assert_allclose(only_dome(stage).basis[:, 30], (middle + edges) / 5.0, rtol=1e-12)


def test_negative_coefficients_of_a_positive_light_are_fine(tmp_path):
    coefficients = np.stack([np.ones((4, 8)), RNG.uniform(-0.4, 0.4, (4, 8))], axis=-1).astype(
        np.float32
    )
    basis = np.stack([np.ones(61), np.linspace(-1.0, 1.0, 61)])
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis)
    np.testing.assert_array_equal(only_dome(stage).coefficients, coefficients)


def negative_basis_case(tmp_path):
    coefficients = RNG.random((8, 16, 3)).astype(np.float32)
    coefficients[5, 3] = [0.5, -2.0, 0.1]
    coefficients[2, 9] = [0.2, 0.1, -0.8]
    basis = RNG.random((3, 61)) + 0.05
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis)
    return stage, coefficients, basis


def test_negative_reconstructed_radiance_is_refused_with_place_and_size(tmp_path):
    stage, coefficients, basis = negative_basis_case(tmp_path)
    lowest = (coefficients[5, 3].astype(np.float64) @ basis).min()
    with pytest.raises(ImageError, match=rf"2 negative .lowest {lowest:.4g} at x 3, y 5"):
        read(stage)


def test_clamped_basis_light_is_exactly_cut_off_at_zero(tmp_path):
    stage, coefficients, basis = negative_basis_case(tmp_path)
    notes = []
    out = only_dome(stage, notes, bad_pixels="clamp")
    exact = np.maximum(coefficients.astype(np.float64) @ basis, 0.0)
    assert out.basis.shape[0] == 5
    np.testing.assert_allclose(radiance(out), exact, atol=2e-6 * exact.max())
    assert "rank 3 to 5" in notes[0].message


def test_clamping_many_different_texels_goes_to_full_rank_and_stays_exact(tmp_path):
    coefficients = RNG.normal(0.3, 1.0, (32, 64, 3)).astype(np.float32)
    basis = RNG.random((3, 61))
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), basis)
    out = only_dome(stage, bad_pixels="clamp")
    exact = np.maximum(coefficients.astype(np.float64) @ basis, 0.0)
    np.testing.assert_allclose(radiance(out), exact, atol=2e-6 * exact.max())


def test_coefficients_that_are_not_finite_are_refused_or_black(tmp_path):
    coefficients = RNG.random((4, 8, 2)).astype(np.float32)
    coefficients[1, 2, 0], coefficients[3, 4, 1] = np.nan, np.inf
    stage = new_stage()
    basis_dome(stage, write_coefficients(tmp_path / "c.exr", coefficients), RNG.random((2, 61)))
    with pytest.raises(
        ImageError, match=r"1 NaN .first at x 2, y 1.*1 infinite .first at x 4"
    ):
        read(stage)
    out = only_dome(stage, bad_pixels="clamp")
    assert not out.coefficients[1, 2].any() and not out.coefficients[3, 4].any()
    np.testing.assert_array_equal(out.coefficients[0], coefficients[0])


@pytest.mark.parametrize(("held", "rank"), [(2, 3), (4, 3)])
def test_basis_and_channels_must_agree(tmp_path, held, rank):
    file = write_coefficients(tmp_path / "c.exr", np.ones((4, 8, held), np.float32))
    stage = new_stage()
    basis_dome(stage, file, np.ones((rank, 61)))
    with pytest.raises(ImageError, match=r"has 3 rows and needs the channels c0 to c2.*c1"):
        read(stage)


def test_basis_beside_the_rendered_wavelengths_is_refused(tmp_path):
    file = write_coefficients(tmp_path / "c.exr", np.ones((4, 8, 1), np.float32))
    stage = new_stage()
    basis_dome(stage, file, np.ones((1, 3)), [900.0, 950.0, 1000.0])
    with pytest.raises(LayerError, match="900 to 1000 nm"):
        read(stage)


def write_bands(path, nm, pixels):
    names = [f"S0.{int(w)},{round(w % 1 * 1e6):06d}nm" for w in nm]
    return write_exr(path, {name: pixels[..., k] for k, name in enumerate(names)})


@pytest.mark.parametrize("rank", [1, 3, 7, 61])
def test_bands_light_is_factorised_at_its_rank(tmp_path, rank):
    pixels = np.exp(RNG.normal(0.0, 3.0, (16, 32, rank))) @ (RNG.random((rank, 61)) ** 3)
    pixels = pixels.astype(np.float32)
    stage = new_stage()
    file = write_bands(tmp_path / "b.exr", NM, pixels)
    spectral(dome(stage), "bands", bands_file=Sdf.AssetPath(file), scale=2.0)
    out = only_dome(stage)
    assert out.coefficients.shape == (16, 32, rank)
    peak = 2.0 * pixels.max(axis=-1, keepdims=True)
    assert (np.abs(radiance(out) - 2.0 * pixels) / peak).max() < 1.5e-6


def test_one_texel_of_another_lamp_raises_the_rank(tmp_path):
    pixels = RNG.random((16, 32, 1)) * np.linspace(1.0, 2.0, 61)
    pixels[7, 3] = 1e-3 * np.linspace(2.0, 1.0, 61) ** 2
    stage = new_stage()
    file = write_bands(tmp_path / "b.exr", NM, pixels.astype(np.float32))
    spectral(dome(stage), "bands", bands_file=Sdf.AssetPath(file))
    out = only_dome(stage)
    assert out.basis.shape[0] == 2
    np.testing.assert_allclose(radiance(out)[7, 3], pixels[7, 3], rtol=1e-5)


def test_bands_are_averaged_onto_the_grid(tmp_path):
    nm = np.arange(380.0, 731.0, 10.0)
    pixels = np.broadcast_to(nm / 500.0, (4, 8, nm.size)).astype(np.float32)
    stage = new_stage()
    spectral(
        dome(stage), "bands", bands_file=Sdf.AssetPath(write_bands(tmp_path / "b.exr", nm, pixels))
    )
    np.testing.assert_allclose(radiance(only_dome(stage))[0, 0], NM / 500.0, rtol=1e-6)


def test_bad_bands_are_refused_or_clamped_exactly(tmp_path):
    pixels = RNG.random((4, 8, 61)).astype(np.float32)
    pixels[2, 6, 10] = -0.25
    stage = new_stage()
    file = write_bands(tmp_path / "b.exr", NM, pixels)
    spectral(dome(stage), "bands", bands_file=Sdf.AssetPath(file))
    with pytest.raises(ImageError, match=r"1 negative .lowest -0.25 at x 6, y 2"):
        read(stage)
    out = only_dome(stage, bad_pixels="clamp")
    np.testing.assert_allclose(radiance(out), np.maximum(pixels, 0.0), atol=1e-6)


# --- OpenUSD's physical-lighting proposal ------------------------------------------------------


def test_physical_black_body_colors_an_rgb_map(tmp_path):
    pixels = rgb_map()
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", pixels))
    light.CreateColorTemperatureAttr(2856.0)
    light.GetPrim().CreateAttribute("physical:illuminant", Sdf.ValueTypeNames.Token).Set(
        "blackbody"
    )
    np.testing.assert_allclose(xyz(only_dome(stage)), adapted(pixels, "2856K"), atol=1e-6)


def test_physical_custom_illuminant_is_radiance_as_authored():
    stage = new_stage()
    prim = dome(stage).GetPrim()
    value = RNG.random(61) + 0.2
    prim.CreateAttribute("physical:illuminant", Sdf.ValueTypeNames.Token).Set("custom")
    pairs = Vt.Vec2fArray([Gf.Vec2f(a, b) for a, b in zip(NM, value, strict=True)])
    prim.CreateAttribute("physical:customIlluminant", Sdf.ValueTypeNames.Float2Array).Set(pairs)
    np.testing.assert_allclose(radiance(only_dome(stage))[0, 0], value, rtol=1e-6)


# --- Distant lights ----------------------------------------------------------------------------


def distant(stage, **inputs):
    light = UsdLux.DistantLight.Define(stage, "/Sun")
    light.CreateIntensityAttr(1.0)
    for name, value in inputs.items():
        light.GetPrim().GetAttribute(f"inputs:{name}").Set(value)
    return light


def only_distant(stage, **options):
    (light,) = read(stage, **options).distants
    return light


def test_distant_light_comes_from_its_plus_z():
    stage = new_stage()
    light = distant(stage)
    assert only_distant(stage).direction.tolist() == [0.0, 0.0, 1.0]
    UsdGeom.Xformable(light).AddRotateXOp().Set(-90.0)
    np.testing.assert_allclose(only_distant(stage).direction, [0, 1, 0], atol=1e-12)
    UsdGeom.Xformable(light).AddScaleOp().Set((2.0, 3.0, -4.0))
    np.testing.assert_allclose(only_distant(stage).direction, [0, -1, 0], atol=1e-12)


@pytest.mark.parametrize("angle", [0.53, 5.0, 90.0, 180.0, 250.0])
def test_illuminance_of_a_distant_disc_is_its_projected_solid_angle(angle):
    stage = new_stage()
    distant(stage, angle=angle, exposure=1.0)
    theta = np.linspace(0.0, np.radians(min(angle, 180.0)) / 2.0, 20001)
    expected = 2.0 * np.trapezoid(2.0 * np.pi * np.sin(theta) * np.cos(theta), theta)
    out = only_distant(stage)
    assert out.angle_deg == pytest.approx(angle)
    assert (out.irradiance @ WEIGHTS)[1] == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("angle", [0.0, 0.53, 90.0, 180.0])
def test_normalized_intensity_is_illuminance(angle):
    stage = new_stage()
    distant(stage, angle=angle, normalize=True, intensity=7.0)
    assert (only_distant(stage).irradiance @ WEIGHTS)[1] == pytest.approx(7.0, rel=1e-6)


def test_parallel_light_takes_intensity_as_illuminance():
    stage = new_stage()
    distant(stage, angle=0.0, intensity=7.0)
    out = only_distant(stage)
    assert out.angle_deg == 0.0
    assert (out.irradiance @ WEIGHTS)[1] == pytest.approx(7.0, rel=1e-6)


def test_unauthored_distant_intensity_is_that_of_the_sun():
    stage = new_stage()
    UsdLux.DistantLight.Define(stage, "/Sun")
    expected = 50000.0 * np.pi * np.sin(np.radians(0.53) / 2.0) ** 2
    assert (only_distant(stage).irradiance @ WEIGHTS)[1] == pytest.approx(expected, rel=1e-6)


def test_rgb_distant_light_is_uplifted_under_its_lamp():
    stage = new_stage()
    color = np.array([0.9, 0.5, 0.3])
    light = distant(stage, angle=0.0)
    light.CreateColorAttr(tuple(color))
    spectral(light, "rgb", illuminant="FL11")
    out = only_distant(stage).irradiance @ WEIGHTS
    np.testing.assert_allclose(out, adapted(color, "FL11"), atol=1e-6)


@pytest.mark.parametrize("source", ["blackbody", "illuminantD"])
def test_distant_lamps_have_their_temperature(source):
    stage = new_stage()
    spectral(distant(stage, angle=0.0, colorTemperature=4500.0), source)
    spectrum = only_distant(stage).irradiance
    shape = {"blackbody": planck_radiance, "illuminantD": daylight}[source](4500.0, NM)
    np.testing.assert_allclose(spectrum / spectrum.max(), shape / shape.max(), rtol=1e-9)
    assert (spectrum @ WEIGHTS)[1] == pytest.approx(1.0)


@pytest.mark.parametrize("quantity", [SpectralQuantity.RADIANCE, SpectralQuantity.IRRADIANCE])
def test_tabulated_distant_light_is_radiance_or_irradiance(quantity):
    value = RNG.random(61)
    stage = new_stage()
    prim = spectral(distant(stage, angle=2.0), "tabulated", units="absolute")
    write_spectrum(prim, "emission", Spectrum(quantity, NM, value))
    factor = np.pi * np.sin(np.radians(1.0)) ** 2 if quantity.value == "radiance" else 1.0
    out = only_distant(stage)
    assert out.absolute
    np.testing.assert_allclose(out.irradiance, factor * value, rtol=1e-12)


@pytest.mark.parametrize("source", ["basis", "bands"])
def test_distant_light_has_no_map(tmp_path, source):
    stage = new_stage()
    file = Sdf.AssetPath(write_rgb(tmp_path / "m.exr", rgb_map()))
    light = distant(stage)
    if source == "bands":
        spectral(light, source, bands_file=file)
    else:
        ones, ends = Vt.DoubleArray([1.0, 1.0]), Vt.DoubleArray([400.0, 700.0])
        spectral(light, source, coefficients_file=file, basis=ones, basis_wavelengths=ends)
    with pytest.raises(LayerError, match=r"</Sun>.*distant light has not"):
        read(stage)


# --- Which prims shine -------------------------------------------------------------------------


def test_hidden_lights_do_not_shine():
    stage = new_stage()
    UsdGeom.Imageable(UsdGeom.Xform.Define(stage, "/Off")).MakeInvisible()
    dome(stage, path="/Off/Dome")
    lights = read(stage)
    assert lights.domes == () and lights.distants == () and not lights.absolute


def test_lights_in_instances_shine_once_an_instance():
    stage = new_stage()
    stage.CreateClassPrim("/Rig")
    UsdLux.DistantLight.Define(stage, "/Rig/Sun")
    for name in ("A", "B"):
        prim = stage.DefinePrim(f"/{name}", "Xform")
        prim.GetReferences().AddInternalReference("/Rig")
        prim.SetInstanceable(True)
    assert sorted(light.path for light in read(stage).distants) == ["/A/Sun", "/B/Sun"]


@pytest.mark.parametrize(
    "kind",
    [
        UsdLux.RectLight,
        UsdLux.DiskLight,
        UsdLux.SphereLight,
        UsdLux.CylinderLight,
        UsdLux.PortalLight,
    ],
)
def test_other_lights_are_noted(kind):
    stage = new_stage()
    kind.Define(stage, "/Other")
    notes = []
    assert read(stage, notes).domes == ()
    assert codes(notes) == ["light-not-supported"] and notes[0].path == "/Other"


def test_mesh_lights_and_lights_of_point_instancers_are_noted():
    stage = new_stage()
    UsdLux.MeshLightAPI.Apply(UsdGeom.Mesh.Define(stage, "/Glow").GetPrim())
    UsdGeom.PointInstancer.Define(stage, "/Many")
    UsdLux.DistantLight.Define(stage, "/Many/Prototypes/Sun")
    notes = []
    assert read(stage, notes).distants == ()
    assert [note.path for note in notes] == ["/Glow", "/Many/Prototypes/Sun"]


def test_what_has_no_effect_is_noted():
    stage = new_stage()
    light = dome(stage)
    light.CreateDiffuseAttr(0.5)
    UsdLux.ShapingAPI.Apply(light.GetPrim())
    light.CreateFiltersRel().AddTarget("/Filter")
    Usd.CollectionAPI.Apply(light.GetPrim(), "lightLink").CreateIncludesRel().AddTarget("/Head")
    light.CreateColorAttr().AddConnection("/Shader.outputs:rgb")
    notes = []
    read(stage, notes)
    assert sorted(codes(notes)) == [
        "light-connection-ignored",
        "light-filters-ignored",
        "light-linking-ignored",
        "light-multiplier-ignored",
        "light-shaping-ignored",
    ]


def test_ordinary_lights_give_no_notes(tmp_path):
    stage = new_stage()
    dome(stage, write_rgb(tmp_path / "m.exr", rgb_map()))
    distant(stage)
    notes = []
    read(stage, notes)
    assert notes == []


def test_inputs_without_their_prefix_are_read():
    stage = new_stage()
    prim = dome(stage).GetPrim()
    prim.CreateAttribute("intensity", Sdf.ValueTypeNames.Float).Set(4.0)
    np.testing.assert_allclose(xyz(only_dome(stage))[..., 1], 4.0, rtol=1e-6)


def test_misspelt_spectral_schema_is_refused():
    stage = new_stage()
    dome(stage).GetPrim().AddAppliedSchema("SpectralLigthAPI")
    with pytest.raises(LayerError, match="SpectralLightAPI"):
        read(stage)


def test_absolute_and_relative_lights_do_not_mix():
    stage = new_stage()
    dome(stage)
    spectral(distant(stage), "rgb", units="absolute")
    with pytest.raises(LayerError, match="</Dome>: is relative, but </Sun> has absolute"):
        read(stage)


# --- Errors ------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("intensity", -1.0, "inputs:intensity is -1.0.*at least 0"),
        ("intensity", float("nan"), "inputs:intensity is nan"),
        ("exposure", float("inf"), "inputs:exposure is inf"),
        ("exposure", 2000.0, "no brightness"),
        ("exposure", 200.0, "no brightness|more than float32 holds"),
        ("color", Gf.Vec3f(1, -1, 1), "not negative"),
        ("texture:format", "mirroredBall", "mirroredBall.*latlong"),
    ],
)
def test_unusable_inputs_are_refused_with_layer_and_prim(tmp_path, name, value, message):
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", rgb_map()))
    light.GetPrim().GetAttribute(f"inputs:{name}").Set(value)
    with pytest.raises(LayerError, match=message) as refusal:
        read(stage)
    assert "</Dome>" in str(refusal.value) and "\n" not in str(refusal.value)


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


def test_map_that_is_no_latlong_is_refused_unless_it_says_so(tmp_path):
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", rgb_map(8, 8)))
    with pytest.raises(ImageError, match="8 x 8 pixels are not twice"):
        read(stage)
    light.CreateTextureFormatAttr("latlong")
    assert only_dome(stage).coefficients.shape == (8, 8, 3)


def test_map_without_rgb_is_refused(tmp_path):
    stage = new_stage()
    dome(stage, write_coefficients(tmp_path / "m.exr", np.ones((4, 8, 2), np.float32)))
    with pytest.raises(ImageError, match="no channels R, G, B; it has c0, c1"):
        read(stage)


def test_unknown_lamp_is_a_usage_error_as_option_and_a_layer_error_when_authored():
    stage = new_stage()
    light = dome(stage)
    with pytest.raises(UsageError, match="--illuminant FL99"):
        read(stage, illuminant="FL99")
    spectral(light, "rgb", illuminant="FL99")
    with pytest.raises(LayerError, match=r"</Dome>.*FL99"):
        read(stage)


def test_relative_table_in_absolute_units_is_refused():
    stage = new_stage()
    prim = spectral(dome(stage), "tabulated", units="absolute")
    write_spectrum(prim, "emission", Spectrum(SpectralQuantity.RELATIVE, NM, np.ones(61)))
    with pytest.raises(LayerError, match="quantity is relative"):
        read(stage)


def test_irradiance_of_a_dome_is_refused():
    stage = new_stage()
    prim = spectral(dome(stage), "tabulated")
    write_spectrum(prim, "emission", Spectrum(SpectralQuantity.IRRADIANCE, NM, np.ones(61)))
    with pytest.raises(LayerError, match="irradiance, which a dome has not"):
        read(stage)


def test_daylight_below_its_range_is_refused():
    stage = new_stage()
    light = dome(stage)
    light.CreateColorTemperatureAttr(3000.0)
    spectral(light, "illuminantD")
    with pytest.raises(LayerError, match="</Dome>: daylight is defined from 4000 K"):
        read(stage)


# --- Speed and real maps -----------------------------------------------------------------------


def test_rgb_map_of_1024_x_512_costs_little_beyond_decoding(tmp_path):
    from usdskin.images import read_image

    file = write_rgb(tmp_path / "m.exr", rgb_map(512, 1024))
    stage = new_stage()
    dome(stage, file)
    read(stage, illuminant="FL2")

    def best(work):
        times = []
        for _ in range(5):
            start = time.perf_counter()
            work()
            times.append(time.perf_counter() - start)
        return min(times)

    beyond = best(lambda: read(stage, illuminant="FL2")) - best(lambda: read_image(file))
    assert beyond < 0.15  # 100 ms on an idle machine


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


@pytest.mark.realdata
@pytest.mark.parametrize("bad_pixels", ["error", "clamp"])
def test_real_stages_read_or_fail_in_one_line(realdata, bad_pixels):
    """Each stage in one child process: none may crash it."""
    stages = sorted((realdata / "stages").rglob("*.usd*"))
    code = f"""
import sys
import usdskin.schemas
from pxr import Usd
from usdskin.errors import UsdSkinError
from usdskin.layers import open_stage
from usdskin.render.lights import read_lights
for path in sys.argv[1:]:
    try:
        read_lights(open_stage(path, []), 1.0, list(range(400, 701, 5)), bad_pixels={bad_pixels!r})
    except UsdSkinError as error:
        assert "\\n" not in str(error), error
"""
    command = [sys.executable, "-c", code, *map(str, stages)]
    subprocess.run(command, check=True, timeout=300)
