"""The library of skins and the strip that shows it: what the layers say, and what is rendered."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.colorimetry import (
    cat16,
    color_matching_functions,
    illuminant,
    white_xyz,
    xyz_to_lab,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.images import read_image, read_spectral
from usdskin.layers import open_stage, write_layer
from usdskin.prims import read_skin, read_spectral_light

# isort: split
# After ours, which register the schemas.
from pxr import UsdLux, UsdShade

STAGES = Path(__file__).resolve().parents[1] / "stages"
LIBRARY = STAGES / "skin_library" / "skin_library.usda"
STRIP = STAGES / "skin_tones" / "skin_tones.usda"
TONES = tuple(f"tone{k}" for k in range(1, 7))
FINISHES = ("powdered", "bare", "oily")
ITA_RANGES = dict(
    zip(TONES, [(55, 90), (41, 55), (28, 41), (10, 28), (-30, 10), (-90, -30)], strict=True)
)
"""Classes of Chardon 1991 [deg]."""

SURFACE = 0.028
"""What the surface adds where an instrument includes it: F0 of the library."""


@pytest.fixture
def script(monkeypatch):
    """Import a script of a stage."""

    def load(stage: str, name: str):
        monkeypatch.syspath_prepend(str(STAGES / stage))
        return importlib.import_module(name)

    return load


def material(tone="tone3", finish="bare"):
    """Return the library's prim with variants selected."""
    stage = open_stage(LIBRARY)
    prim = stage.GetDefaultPrim()
    prim.GetVariantSet("tone").SetVariantSelection(tone)
    prim.GetVariantSet("finish").SetVariantSelection(finish)
    return stage, prim


def skin_of(tone):
    _stage, prim = material(tone)
    return read_skin(prim)


def whole_reflectance(skin):
    """Return what a uniform room of radiance 1 gets back: alpha S (1 + (1 + l) Ss)."""
    return skin.alpha * skin.reflectance.value * (1.0 + (1.0 + skin.wrap) * skin.scattering.value)


def lab(wavelength_nm, reflectance):
    weights = illuminant("D65", wavelength_nm)[:, None] * color_matching_functions(wavelength_nm)
    return xyz_to_lab(reflectance @ weights, weights.sum(axis=0))


def typology_angle(color):
    return np.degrees(np.arctan2(color[..., 0] - 50.0, color[..., 2]))


def preview(prim, name):
    shader = UsdShade.Shader(prim.GetChild("surface"))
    return shader.GetInput(name).Get()


# --- Library -----------------------------------------------------------------------------------


@pytest.mark.parametrize("tone", TONES)
def test_no_skin_gives_back_more_than_it_gets(tone):
    whole = whole_reflectance(skin_of(tone))
    assert whole.min() > 0.0
    assert whole.max() <= 1.0 - SURFACE


@pytest.mark.parametrize("tone", TONES)
def test_alpha_is_split_from_s_by_the_luminous_mean_of_the_scattering(tone):
    _stage, prim = material(tone)
    skin = read_skin(prim)
    assert prim.GetAttribute("fit:convention").Get() == "luminousMean"
    bright = color_matching_functions(skin.scattering.wavelength_nm)[:, 1]
    mean = np.average(skin.scattering.value, weights=bright)
    assert skin.alpha == pytest.approx(1.0 / (1.0 + mean), abs=2e-5)


@pytest.mark.parametrize("tone", TONES)
def test_the_rendition_has_the_skin_s_own_color_under_d65(tone):
    _stage, prim = material(tone)
    skin = read_skin(prim)
    weights = xyz_weights(skin.reflectance.wavelength_nm)
    weights = illuminant("D65", skin.reflectance.wavelength_nm)[:, None] * weights
    white = weights.sum(axis=0) / weights[:, 1].sum()
    xyz = whole_reflectance(skin) @ weights / weights[:, 1].sum()
    expected = xyz_to_rgb("lin_rec709_scene") @ cat16(white, white_xyz("lin_rec709_scene")) @ xyz
    np.testing.assert_allclose(preview(prim, "diffuseColor"), expected, atol=1e-4)
    assert expected.max() > 0.1
    assert preview(prim, "ior") == pytest.approx(1.4)


@pytest.mark.parametrize("tone", TONES)
def test_each_tone_is_in_the_middle_of_its_class(tone):
    """ITA = arctan((L* - 50) / b*) of the reflectance as an instrument reads it (di:8)."""
    skin = skin_of(tone)
    color = lab(skin.reflectance.wavelength_nm, whole_reflectance(skin) + SURFACE)
    low, high = ITA_RANGES[tone]
    angle = typology_angle(color)
    assert low < angle < high
    if tone in TONES[1:-1]:
        assert abs(angle - 0.5 * (low + high)) < 0.1 * (high - low)


def test_darker_skins_scatter_less_around_the_shadow_s_edge():
    """More of what comes back from them has been in the epidermis only."""
    skins = [skin_of(tone) for tone in TONES]
    whole = np.array([whole_reflectance(skin) for skin in skins])
    assert (np.diff(whole, axis=0) < 0.0).all()
    means = [skin.scattering.value.mean() for skin in skins]
    assert means[1:] == sorted(means[1:], reverse=True)
    for skin in skins:
        assert skin.scattering.value[-1] > 4.0 * skin.scattering.value[0]  # red goes furthest


@pytest.mark.parametrize("tone", ["tone1", "tone6"])
def test_a_finish_changes_the_luster_only(tone):
    found = {}
    for finish in FINISHES:
        _stage, prim = material(tone, finish)
        found[finish] = (read_skin(prim), preview(prim, "roughness"))
    bare = found["bare"][0]
    for skin, _roughness in found.values():
        np.testing.assert_array_equal(skin.reflectance.value, bare.reflectance.value)
        assert (skin.alpha, skin.wrap, skin.f0) == (bare.alpha, bare.wrap, bare.f0)
    weights = [found[finish][0].specular_weight for finish in FINISHES]
    assert weights == sorted(weights) and weights[0] < weights[-1] <= 1.0
    for roughness in (
        [found[finish][0].roughness1 for finish in FINISHES],
        [found[finish][0].roughness2 for finish in FINISHES],
        [found[finish][1] for finish in FINISHES],
    ):
        assert roughness == sorted(roughness, reverse=True)


def test_the_committed_library_is_what_its_script_makes(script, tmp_path):
    make = script("skin_library", "make_library")
    first, second = (write_layer(make.library(), tmp_path / name) for name in ("a.usda", "b.usda"))
    assert first.read_bytes() == second.read_bytes()
    for tone, pigments in make.TONES.items():
        alpha, shown, spread = make.spectra(pigments)
        skin = skin_of(tone)
        assert skin.alpha == pytest.approx(alpha, abs=1e-6)
        np.testing.assert_allclose(skin.reflectance.value, shown, atol=1e-5)
        np.testing.assert_allclose(skin.scattering.value, spread, atol=1e-5)


@pytest.mark.realdata
@pytest.mark.parametrize("tone", TONES)
def test_each_tone_lies_among_measured_skins_of_its_class(realdata, tone):
    """ISSA (Lu et al. 2025), di:8 with the surface: 6194 spectra of five origins, of which only 75
    are in the darkest class."""
    with np.load(realdata / "skin" / "issa_subset_400_700_10.npz") as data:
        nm, measured = data["wavelength"].astype(float), data["R"].astype(float)
    colors = lab(nm, measured)
    low, high = ITA_RANGES[tone]
    own = (typology_angle(colors) > low) & (typology_angle(colors) <= high)
    skin = skin_of(tone)
    at = np.searchsorted(skin.reflectance.wavelength_nm, nm)
    found = whole_reflectance(skin)[at] + SURFACE
    nearest, farthest = np.percentile(colors[own], [2.5, 97.5], axis=0)
    assert (nearest < lab(nm, found)).all() and (lab(nm, found) < farthest).all()
    off = np.sqrt(((measured[own] - found) ** 2).mean(axis=1))
    assert off.min() < 0.013
    median = np.median(measured[own], axis=0)
    assert np.sqrt(((median - found) ** 2).mean()) < 0.03


# --- The model ---------------------------------------------------------------------------------


def test_an_epidermis_that_does_not_scatter_is_a_filter_passed_twice(script):
    """exp(-2 a d) for diffuse light each way: Beer's law, on a path twice as long (Kubelka)."""
    spectra = script("skin_library", "skin_spectra")
    nm = np.arange(400.0, 701.0, 20.0)
    skin = spectra.Pigments(0.05, 0.014, epidermis_scattering=0.0)
    absorption = 0.05 * spectra.melanosome_absorption(nm) + 0.95 * spectra.tissue_absorption(nm)
    expected = np.exp(-4.0 * absorption * spectra.EPIDERMIS_M)
    expected *= spectra.dermis_reflectance(nm, skin)
    np.testing.assert_allclose(spectra.reflectance(nm, skin), expected, rtol=1e-12)


def test_a_thick_epidermis_hides_the_dermis(script, monkeypatch):
    """Kubelka and Munk's paint without end: 1 + K/S - sqrt((K/S)^2 + 2 K/S)."""
    spectra = script("skin_library", "skin_spectra")
    monkeypatch.setattr(spectra, "EPIDERMIS_M", 0.004)
    nm = np.array([450.0, 550.0, 650.0])
    skin = spectra.Pigments(0.3, 0.014)
    absorption = 0.3 * spectra.melanosome_absorption(nm) + 0.7 * spectra.tissue_absorption(nm)
    ratio = 2.0 * absorption / (0.75 * spectra.reduced_scattering(nm))
    expected = 1.0 + ratio - np.sqrt(ratio**2 + 2.0 * ratio)
    np.testing.assert_allclose(spectra.reflectance(nm, skin), expected, rtol=1e-6)
    assert spectra.scattering(nm, skin).max() < 1e-6


# --- The strip ---------------------------------------------------------------------------------


MATTE = [
    word
    for k in range(1, 7)
    for word in ("--set", f"/World/Materials/Tone{k}.inputs:skin:specular:weight=0")
]


def balls(output, *options):
    """Render the strip and return where the six balls are: masks in a picture of 192 x 58."""
    arguments = ["-q", "render", str(STRIP), str(output), "-p", "1", "-r", "192", "58"]
    assert cli.main([*arguments, "--aov", "P", "--no-png", *options]) == 0
    place = read_image(output, part="P").pixels
    centers = 0.112 * (np.arange(6) - 2.5)
    offset = np.stack([place - [x, 0.05, 0.0] for x in centers])
    return np.linalg.norm(offset, axis=3) < 0.0501


def test_a_uniform_room_of_d65_shows_each_ball_as_its_rendition(tmp_path):
    layer = tmp_path / "room.usda"
    layer.write_text(
        f"#usda 1.0\n(\n    subLayers = [@{STRIP.as_posix()}@]\n    metersPerUnit = 1\n"
        '    upAxis = "Y"\n    renderSettingsPrimPath = "/Render/Settings"\n)\n'
        'over "World"\n{\n    over "Light" (\n        active = false\n    )\n    {\n    }\n'
        '    def DomeLight "Room"\n    {\n    }\n}\n',
        encoding="utf-8",
    )
    output = tmp_path / "room.exr"
    masks = balls(tmp_path / "places.exr")
    arguments = ["-q", "render", str(layer), str(output), "-p", "1", "-r", "192", "58", "--no-png"]
    assert cli.main([*arguments, *MATTE]) == 0
    picture = read_image(output).pixels[..., :3]
    for tone, mask in zip(TONES, masks, strict=True):
        assert mask.sum() > 300
        _stage, prim = material(tone)
        found = np.median(picture[mask], axis=0)
        # The render ends at 700 nm, the rendition's color at 730 nm.
        np.testing.assert_allclose(found, preview(prim, "diffuseColor"), rtol=4e-3, atol=2e-4)


@pytest.mark.parametrize("lamp", ["daylight", "incandescent", "fluorescent"])
def test_the_strip_goes_from_light_to_dark_under_each_lamp(tmp_path, lamp):
    output = tmp_path / "out.exr"
    masks = balls(output, "--variant", f"/World/Light{{light={lamp}}}")
    picture = read_image(output).pixels
    assert np.isfinite(picture).all()
    np.testing.assert_allclose(picture[..., 3], 1.0, atol=1e-6)  # the paper fills the picture
    means = np.array([picture[mask][:, :3].mean(axis=0) for mask in masks])
    assert (np.diff(means, axis=0) < 0.0).all()
    assert (means[:, 0] > means[:, 1]).all() and (means[:, 1] > means[:, 2]).all()


def test_the_balls_have_the_spectra_of_their_tones(tmp_path):
    """The ratio of two balls without luster is that of their reflectances, but for a factor, since
    the camera sees them from two sides, and for their wraps, which differ by little."""
    output = tmp_path / "out.exr"
    masks = balls(output, "--spectral", *MATTE)
    nm, spectra = read_spectral(output.with_suffix(".spectral.exr"))
    light, dark = (spectra[masks[k]].mean(axis=0) for k in (1, 4))
    expected = [
        np.interp(nm, skin.reflectance.wavelength_nm, whole_reflectance(skin))
        for skin in (skin_of("tone2"), skin_of("tone5"))
    ]
    ratio = dark / light * expected[0] / expected[1]
    np.testing.assert_allclose(ratio, ratio.mean(), rtol=0.02)
    assert ratio.mean() == pytest.approx(1.0, abs=0.1)


def test_the_strip_s_light_is_one_lamp_in_every_direction():
    stage = open_stage(STRIP.parent / "light.usda")
    prim = stage.GetDefaultPrim()
    for lamp, name in (("daylight", "D55"), ("incandescent", "A"), ("fluorescent", "FL2")):
        prim.GetVariantSet("light").SetVariantSelection(lamp)
        light = read_spectral_light(prim)
        nm = light.basis_wavelength_nm
        expected = illuminant(name, nm) / (illuminant(name, nm) @ xyz_weights(nm)[:, 1])
        np.testing.assert_allclose(light.basis, expected[None, :], rtol=1e-9)
        share = read_image(light.coefficients_file).pixels
        rgb = read_image(UsdLux.DomeLight(prim).GetTextureFileAttr().Get().resolvedPath).pixels
        color = (light.basis @ xyz_weights(nm)) @ xyz_to_rgb("lin_rec709_scene").T
        np.testing.assert_allclose(rgb, share * color, atol=3e-3 * share.max())


def test_the_committed_set_is_what_its_script_makes(script, monkeypatch):
    make = script("skin_tones", "make_set")
    found = read_image(STRIP.parent / "light" / "coefficients.exr").pixels
    expected = make.radiance(make.directions())[..., None]
    np.testing.assert_allclose(found, expected, rtol=1e-3, atol=1e-6)
    stage = open_stage(STRIP)
    for k, center in enumerate(make.centers()):
        place = stage.GetPrimAtPath(f"/World/Tone{k + 1}").GetAttribute("xformOp:translate").Get()
        np.testing.assert_allclose(place, center, atol=1e-9)
    ground = read_image(STRIP.parent / "ground.png").pixels[..., 0]
    monkeypatch.setattr(make, "GROUND_PX", (32, 32))
    coarse = make.PAPER * make.shade()
    # A coarse texel's centre is the corner where four fine ones meet.
    fine = np.mean([ground[7 + i :: 16, 7 + j :: 16] for i in (0, 1) for j in (0, 1)], axis=0)
    encoded = make.encode_srgb(coarse)
    np.testing.assert_allclose(fine, encoded, atol=0.02)
    assert ground.max() == pytest.approx(float(make.encode_srgb(make.PAPER)), abs=0.005)
