import subprocess
import sys
from functools import cache

import numpy as np
import pytest

from usdskin import colorimetry as c
from usdskin.errors import UsdSkinError
from usdskin.illuminants import table
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, resample

trapezoid = getattr(np, "trapezoid", None) or np.trapz  # NumPy 2 renamed it
FULL = np.arange(360.0, 831.0, 1.0)


@cache
def science():
    import colour

    return colour


# --- Tables against colour-science -------------------------------------------------------------


@pytest.mark.parametrize(
    ("observer", "name"),
    [
        ("cie1931_2", "CIE 1931 2 Degree Standard Observer"),
        ("cie1964_10", "CIE 1964 10 Degree Standard Observer"),
        ("cie2015_2", "CIE 2015 2 Degree Standard Observer"),
    ],
)
def test_color_matching_functions_are_colour_sciences(observer, name):
    functions = science().MSDS_CMFS[name]
    ours = c.color_matching_functions(functions.wavelengths, observer)
    np.testing.assert_allclose(ours, functions.values, rtol=0, atol=1e-11)


def test_every_illuminant_is_colour_sciences():
    for name in c.illuminant_names():
        source = science().SDS_ILLUMINANTS[name]
        ours = c.illuminant(name, source.wavelengths)
        np.testing.assert_allclose(ours, source.values, rtol=1e-11, err_msg=name)


def test_named_lamps_of_the_contract_are_there():
    names = ["A", "B", "C", "D50", "D55", "D65", "D75", "E", "FL1", "FL12", "FL3.15", "HP5"]
    names += ["LED-B1", "LED-B5", "LED-BH1", "LED-RGB1", "LED-V1", "LED-V2"]
    assert set(names) <= set(c.illuminant_names())


def test_reflectance_basis_is_colour_sciences_and_sums_to_one():
    from colour.recovery import MSDS_BASIS_FUNCTIONS_sRGB_MALLETT2019 as theirs

    ours = np.stack([table("mallett2019")[label][1] for label in theirs.labels], axis=-1)
    np.testing.assert_allclose(ours, theirs.values, atol=1e-11)
    np.testing.assert_allclose(ours.sum(axis=-1)[:65], 1.0, atol=1e-7)  # 380 to 700 nm
    np.testing.assert_allclose(ours.sum(axis=-1), 1.0, atol=1e-5)


def test_tables_cannot_be_changed_by_a_caller():
    with pytest.raises(ValueError):
        table("cie1931_2")["y"][1][0] = 1.0


# --- Sums --------------------------------------------------------------------------------------


def test_one_watt_at_555_nm_has_the_maximum_luminance():
    weights = c.xyz_weights(FULL, absolute=True)
    assert weights[FULL == 555.0][0, 1] == pytest.approx(683.002, rel=1e-9)


@pytest.mark.parametrize("observer", ["cie1931_2", "cie1964_10", "cie2015_2"])
@pytest.mark.parametrize("grid", [DEFAULT_WAVELENGTHS_NM, FULL[::10], FULL[30:350]])
def test_relative_unit_is_d65_scaled_to_one_at_560_nm(grid, observer):
    d65 = c.illuminant("D65", grid) / 100.0
    assert (d65 @ c.xyz_weights(grid, observer))[1] == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "white"),
    [
        # CIE 015:2018, table 3; ASTM E308 for D65's last digits.
        ("D65", (95.047, 100.0, 108.883)),
        ("A", (109.850, 100.0, 35.585)),
        ("D50", (96.422, 100.0, 82.521)),
    ],
)
def test_white_of_a_lamp_at_5_nm_is_the_published_one(name, white):
    grid = np.arange(380.0, 781.0, 5.0)
    xyz = c.illuminant(name, grid) @ c.xyz_weights(grid)
    np.testing.assert_allclose(100.0 * xyz / xyz[1], white, atol=0.02)


def test_wide_bands_average_the_color_matching_functions():
    grid = np.arange(400.0, 701.0, 20.0)
    average = c.color_matching_functions(grid)
    fine = np.arange(390.0, 711.0, 1.0)
    values = c.color_matching_functions(fine)
    for band, center in enumerate(grid):
        inside = np.abs(fine - center) <= 10.0
        weights = np.where(np.abs(fine[inside] - center) == 10.0, 0.5, 1.0)
        np.testing.assert_allclose(average[band], weights @ values[inside] / 20.0, rtol=1e-9)


def test_unknown_observer_is_refused_by_name():
    with pytest.raises(UsdSkinError, match="cie1931_2, cie1964_10"):
        c.color_matching_functions(FULL, "cie1931")


def test_grid_without_visible_light_has_no_relative_unit():
    with pytest.raises(UsdSkinError, match="visible"):
        c.xyz_weights([900.0, 950.0])


# --- Lamps -------------------------------------------------------------------------------------


def test_planck_is_colour_sciences():
    from colour.colorimetry import planck_law

    nm = np.arange(400.0, 701.0, 5.0)
    # With the radiation constants of the SI of 2019; its own default is c2 = 1.4388e-2 m K.
    theirs = planck_law(nm * 1e-9, 2856.0, c1=3.741771852e-16, c2=1.438776877e-2) * 1e-9
    np.testing.assert_allclose(c.planck_radiance(2856.0, nm), theirs, rtol=1e-8)


def test_planck_radiance_integrates_to_stefan_boltzmann():
    nm = np.geomspace(100.0, 2e5, 4000)
    total = trapezoid(c.planck_radiance(3000.0, nm), nm)
    assert total == pytest.approx(5.670374419e-8 * 3000.0**4 / np.pi, rel=2e-4)


def test_wide_planck_bands_are_averages():
    wide = c.planck_radiance(2000.0, [420.0, 460.0, 500.0])
    fine = np.arange(400.5, 440.0, 1.0)
    assert wide[0] == pytest.approx(c.planck_radiance(2000.0, fine).mean(), rel=1e-3)


def test_illuminant_a_is_a_black_body():
    # CIE 015:2018: A is Planck's law at 2848 K with c2 = 1.435e-2 m K.
    nm = np.arange(400.0, 701.0, 5.0)
    body = c.planck_radiance(2848.0 * 1.438776877 / 1.4350, nm)
    np.testing.assert_allclose(c.illuminant("A", nm), 100.0 * body / body[nm == 560.0], rtol=1e-5)


@pytest.mark.parametrize("name", ["D50", "D55", "D65", "D75"])
def test_daylight_formula_gives_the_tables(name):
    nm = np.arange(400.0, 701.0, 5.0)
    ours = c.daylight(float(name[1:]) * 100.0 * 1.438776877 / 1.4380, nm)
    np.testing.assert_allclose(ours, c.illuminant(name, nm), atol=0.1)
    assert ours[nm == 560.0] == pytest.approx(100.0)


def test_any_daylight_and_temperature_has_a_name():
    cct, duv = c.correlated_color_temperature(
        c.illuminant("D57", DEFAULT_WAVELENGTHS_NM) @ c.xyz_weights(DEFAULT_WAVELENGTHS_NM)
    )
    assert cct == pytest.approx(5703.0, abs=5.0) and abs(duv) < 0.005
    cct, duv = c.correlated_color_temperature(c.illuminant("3200K", FULL) @ c.xyz_weights(FULL))
    assert cct == pytest.approx(3200.0, abs=2.0) and abs(duv) < 1e-4


@pytest.mark.parametrize(("alias", "name"), [("f2", "FL2"), ("led_b3", "LED-B3"), ("d65", "D65")])
def test_common_spellings_are_understood(alias, name):
    np.testing.assert_array_equal(c.illuminant(alias, FULL), c.illuminant(name, FULL))


@pytest.mark.parametrize("temperature", [1000.0, 3999.0, 25001.0])
def test_daylight_outside_its_range_is_refused(temperature):
    with pytest.raises(UsdSkinError, match="4000 K to 25000 K"):
        c.daylight(temperature, FULL)


@pytest.mark.parametrize("temperature", [0.0, -5.0, np.nan, np.inf])
def test_black_body_needs_a_temperature(temperature):
    with pytest.raises(UsdSkinError, match="above 0 K"):
        c.planck_radiance(temperature, FULL)


@pytest.mark.parametrize(
    "text",
    [
        "nm,power\n{rows}",
        "# a lamp\n\nWavelength Power\n{rows}",
        "{rows}",
        "\ufeff{rows}",
    ],
)
@pytest.mark.parametrize("separator", [",", "; ", "\t", "  "])
def test_lamp_file_is_its_table(tmp_path, text, separator):
    nm = np.arange(380.0, 781.0, 5.0)
    power = c.illuminant("FL2", nm)
    rows = "\n".join(f"{a:g}{separator}{b:g}" for a, b in zip(nm, power, strict=True))
    path = tmp_path / "lamp.csv"
    path.write_text(text.format(rows=rows), encoding="utf-8")
    ours = c.illuminant(str(path), DEFAULT_WAVELENGTHS_NM)
    np.testing.assert_allclose(ours, c.illuminant("FL2", DEFAULT_WAVELENGTHS_NM), rtol=1e-5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "fewer than two rows"),
        ("400,1\n", "fewer than two rows"),
        ("500,1\n400,1\n", "400 nm follows 500 nm"),
        ("400,1\n500,nan\n", "nan at 500 nm"),
        ("400,1\n500,-3\n", "-3 at 500 nm"),
        ("400,1\n500,one\n", "lamp.csv:2: '500,one'"),
        ("400,1,5\n500,1,5\n", "not a row"),
        ("900,1\n950,1\n", "no power"),
    ],
)
def test_broken_lamp_file_is_refused_in_one_line(tmp_path, text, message):
    path = tmp_path / "lamp.csv"
    path.write_text(text)
    with pytest.raises(UsdSkinError, match=message) as refusal:
        c.illuminant(str(path), DEFAULT_WAVELENGTHS_NM)
    assert "\n" not in str(refusal.value)


def test_binary_lamp_file_is_refused(tmp_path):
    path = tmp_path / "lamp.csv"
    path.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(UsdSkinError, match="cannot be read as text"):
        c.illuminant(str(path), FULL)


def test_unknown_lamp_is_refused_with_a_suggestion():
    with pytest.raises(UsdSkinError, match="near: LED-B3"):
        c.illuminant("LED-B3x", FULL)


# --- Adaptation and RGB spaces -----------------------------------------------------------------


def test_cat16_is_colour_sciences():
    from colour.adaptation import matrix_chromatic_adaptation_VonKries

    source, target = np.array([0.95, 1.0, 1.09]), np.array([1.1, 1.0, 0.35])
    theirs = matrix_chromatic_adaptation_VonKries(source, target, transform="CAT16")
    np.testing.assert_allclose(c.cat16(source, target), theirs, atol=1e-6)
    np.testing.assert_allclose(c.cat16(source, target) @ source, target, atol=1e-14)


def test_white_that_is_no_white_is_refused():
    with pytest.raises(UsdSkinError, match="too saturated"):
        c.cat16([0.95, 1.0, 1.09], [0.0, 0.0, 0.0])


def test_rgb_spaces_are_those_of_usd():
    from pxr import Gf

    known = [name for name in c.color_space_names() if Gf.ColorSpace.IsValid(name)]
    assert len(known) == len(c.color_space_names()) - 1  # one is Blender's
    for name in known:
        theirs = np.array(Gf.ColorSpace(name).GetRGBToXYZ())
        np.testing.assert_allclose(c.rgb_to_xyz(name), theirs, atol=3e-7, err_msg=name)
        np.testing.assert_allclose(c.xyz_to_rgb(name) @ c.rgb_to_xyz(name), np.eye(3), atol=1e-12)


def test_every_usd_space_of_colors_is_known():
    from pxr import Gf

    tokens = [getattr(Gf.ColorSpaceNames, name) for name in dir(Gf.ColorSpaceNames)]
    tokens = {str(token) for token in tokens if isinstance(token, str)}
    colors = {token for token in tokens if token.endswith("_scene")}
    assert colors and colors <= set(c.color_space_names())


def test_white_rgb_is_d65_in_every_rgb_space():
    for name in c.color_space_names():
        if name != "lin_ciexyzd65_scene":
            white = c.rgb_to_xyz(name) @ np.ones(3)
            np.testing.assert_allclose(white, c.white_xyz(name), atol=1e-12)


def test_linearizing_is_usds():
    from pxr import Gf

    for name in c.color_space_names():
        if not Gf.ColorSpace.IsValid(name):
            continue
        linear = Gf.ColorSpace(c.linear_color_space(name))
        for value in (0.0, 0.02, 0.2, 0.7, 1.0):
            theirs = linear.Convert(Gf.ColorSpace(name), Gf.Vec3f(value)).GetRGB()
            np.testing.assert_allclose(c.linearize([value] * 3, name), theirs, atol=2e-5)


def test_srgb_decodes_and_encodes_mirrored_through_zero():
    value = np.linspace(-1.0, 2.0, 301)
    np.testing.assert_allclose(c.decode_srgb(c.encode_srgb(value)), value, atol=1e-7)
    assert c.decode_srgb(0.5) == pytest.approx(0.2140411, abs=1e-7)
    assert c.linearize(np.float32([0.5]), "srgb_rec709_scene").dtype == np.float32


def test_misspelt_color_space_gets_a_suggestion():
    with pytest.raises(UsdSkinError, match="lin_rec709_scene"):
        c.rgb_to_xyz("lin_rec709_scen")


# --- Judging -----------------------------------------------------------------------------------


def test_delta_e_2000_of_the_reference_pair():
    # Sharma, Wu and Dalal (2005), pair 1.
    first, second = [50.0, 2.6772, -79.7751], [50.0, 0.0, -82.7485]
    assert c.delta_e_2000(first, second) == pytest.approx(2.0425, abs=5e-5)


def test_lab_of_white_is_100_0_0_and_agrees_with_colour_science():
    white = np.array([0.9, 1.0, 0.8])
    np.testing.assert_allclose(c.xyz_to_lab(white, white), [100.0, 0.0, 0.0], atol=1e-12)
    xyz = np.random.default_rng(0).random((50, 3)) ** 3
    xy = white[:2] / white.sum()
    np.testing.assert_allclose(c.xyz_to_lab(xyz, white), science().XYZ_to_Lab(xyz, xy), atol=1e-4)


def test_illuminant_a_has_its_temperature():
    cct, duv = c.correlated_color_temperature(c.illuminant("A", FULL) @ c.xyz_weights(FULL))
    assert cct == pytest.approx(2855.5, abs=2.0) and abs(duv) < 2e-4


def test_a_render_never_imports_colour_science():
    code = (
        "import sys, usdskin.uplift, usdskin.render.lights, usdskin.colorimetry as c;"
        "c.xyz_weights(list(range(400, 701, 5))); c.illuminant('FL2', [400, 500]);"
        "sys.exit('colour' in sys.modules or 'scipy' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_fluorescent_table_sampled_at_10_nm_keeps_its_energy():
    grid = np.arange(400.0, 701.0, 10.0)
    fine = np.arange(395.0, 706.0, 5.0)
    power = resample(*table("illuminants")["FL11"], fine)
    total = c.illuminant("FL11", grid).sum() * 10.0
    assert total == pytest.approx(trapezoid(power, fine), rel=1e-12)
