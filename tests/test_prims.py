"""Schema prims as plain values, and what is refused on the way."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from pxr import Sdf, Usd

from usdskin import plugin_path
from usdskin.errors import LayerError
from usdskin.prims import (
    SkinParameters,
    SpectralLight,
    check_applied_schemas,
    check_stage_schemas,
    read_render_settings_api,
    read_skin,
    read_spectral_light,
    read_spectrum,
    write_skin,
    write_spectral_light,
    write_spectrum,
)
from usdskin.prims.rules import RULES
from usdskin.prims.values import declared_attributes, read_schema
from usdskin.schemas import SCHEMA_NAMES
from usdskin.spectrum import SpectralQuantity, Spectrum

REFLECTANCE = Spectrum(SpectralQuantity.REFLECTANCE, [400.0, 500.0, 700.0], [0.2, 0.4, 0.6])


@pytest.fixture
def stage() -> Usd.Stage:
    return Usd.Stage.CreateInMemory("shot.usda")


@pytest.fixture
def skin(stage: Usd.Stage) -> Usd.Prim:
    prim = stage.DefinePrim("/World/Skin", "Material")
    prim.ApplyAPI("SkinMaterialAPI")
    write_spectrum(prim, "reflectance", REFLECTANCE)
    return prim


@pytest.fixture
def light(stage: Usd.Stage) -> Usd.Prim:
    prim = stage.DefinePrim("/World/Light", "DomeLight")
    prim.ApplyAPI("SpectralLightAPI")
    return prim


def author(prim: Usd.Prim, name: str, value: object, kind: Sdf.ValueTypeName) -> None:
    """Author a value of any type, as a file may hold it."""
    prim.RemoveProperty(name)
    layer = prim.GetStage().GetEditTarget().GetLayer()
    spec = layer.GetPrimAtPath(prim.GetPath())
    Sdf.AttributeSpec(spec, name, kind).default = value


def refusal(function: object, *arguments: object) -> str:
    with pytest.raises(LayerError) as caught:
        function(*arguments)  # type: ignore[operator]
    message = str(caught.value)
    assert "\n" not in message
    return message


# Spectra


def test_a_spectrum_comes_back_as_it_was_written(skin: Usd.Prim) -> None:
    spectrum = read_spectrum(skin, "reflectance")
    assert spectrum is not None
    assert spectrum.quantity is SpectralQuantity.REFLECTANCE
    np.testing.assert_array_equal(spectrum.wavelength_nm, REFLECTANCE.wavelength_nm)
    np.testing.assert_array_equal(spectrum.value, REFLECTANCE.value)
    assert spectrum.interpolation == "linear"


def test_a_held_spectrum_stays_held(skin: Usd.Prim) -> None:
    held = Spectrum(SpectralQuantity.SCATTERING, [400.0, 500.0], [0.5, 0.7], "held")
    write_spectrum(skin, "scattering", held)
    spectrum = read_spectrum(skin, "scattering")
    assert spectrum is not None
    assert spectrum.interpolation == "held"


def test_a_prim_without_the_spectrum_has_none(skin: Usd.Prim) -> None:
    assert read_spectrum(skin, "scattering") is None


def test_values_are_read_at_their_time(skin: Usd.Prim) -> None:
    values = skin.GetAttribute("spectrum:reflectance:values")
    values.Set([0.0, 0.0, 0.0], 0.0)
    values.Set([1.0, 1.0, 1.0], 10.0)
    spectrum = read_spectrum(skin, "reflectance", 5.0)
    assert spectrum is not None
    np.testing.assert_array_equal(spectrum.value, [0.5, 0.5, 0.5])


def test_single_precision_samples_are_read(skin: Usd.Prim) -> None:
    author(skin, "spectrum:reflectance:values", [0.25, 0.5, 1.0], Sdf.ValueTypeNames.FloatArray)
    spectrum = read_spectrum(skin, "reflectance")
    assert spectrum is not None
    np.testing.assert_array_equal(spectrum.value, [0.25, 0.5, 1.0])


def test_a_descending_wavelength_is_named_with_layer_prim_index_and_values(skin: Usd.Prim) -> None:
    grid = [*range(400, 460, 10), 455.0, 450.0]
    skin.GetAttribute("spectrum:reflectance:wavelengths").Set(grid)
    skin.GetAttribute("spectrum:reflectance:values").Set([0.5] * len(grid))
    assert refusal(read_spectrum, skin, "reflectance") == (
        "shot.usda </World/Skin>: spectrum:reflectance:wavelengths is not ascending at index 7 "
        "(450.0 after 455.0); sort the samples"
    )


@pytest.mark.parametrize(
    ("wavelengths", "values", "expected"),
    [
        ([400, 400, 500], [0.1, 0.1, 0.1], "is not ascending at index 1 (400.0 after 400.0)"),
        ([400, 500], [0.1, 0.1, 0.1], "values has 3 values but wavelengths has 2"),
        ([400, 500, 600], [0.1, 0.1], "values has 2 values but wavelengths has 3"),
        ([400, float("nan"), 500], [0.1] * 3, "wavelengths is not finite at index 1 (nan)"),
        ([400, 500, float("inf")], [0.1] * 3, "wavelengths is not finite at index 2 (inf)"),
        ([400, 500, 600], [0.1, float("nan"), 0.1], "values is not finite at index 1 (nan)"),
        ([400, 500, 600], [0.1, -0.25, 0.1], "values is -0.25 at index 1, but reflectance is"),
        ([-1, 500, 600], [0.1] * 3, "wavelengths starts at -1.0"),
        ([0.4, 0.5, 0.6], [0.1] * 3, "looks like micrometres; multiply it by 1000"),
        ([], [], "values is empty"),
    ],
)
def test_samples_that_are_no_spectrum_are_refused(
    skin: Usd.Prim, wavelengths: list[float], values: list[float], expected: str
) -> None:
    skin.GetAttribute("spectrum:reflectance:wavelengths").Set(wavelengths)
    skin.GetAttribute("spectrum:reflectance:values").Set(values)
    message = refusal(read_spectrum, skin, "reflectance")
    assert message.startswith("shot.usda </World/Skin>: spectrum:reflectance:")
    assert expected in message


def test_a_spectrum_without_samples_is_refused(skin: Usd.Prim) -> None:
    skin.ApplyAPI("SpectralDistributionAPI", "scattering")
    assert "has no samples" in refusal(read_skin, skin)


@pytest.mark.parametrize(
    "quantity", ["reflectance", "transmittance", "radiance", "irradiance", "absorption"]
)
def test_what_cannot_be_negative_is_not(skin: Usd.Prim, quantity: str) -> None:
    skin.GetAttribute("spectrum:reflectance:values").Set([0.1, -0.1, 0.1])
    skin.GetAttribute("spectrum:reflectance:quantity").Set(quantity)
    assert f"but {quantity} is never negative" in refusal(read_spectrum, skin, "reflectance")


def test_a_reflectance_in_percent_is_refused(skin: Usd.Prim) -> None:
    values = skin.GetAttribute("spectrum:reflectance:values")
    values.Set([31.0, 38.0, 55.0])
    assert "is 55.0 at index 2" in refusal(read_skin, skin)
    values.Set([0.9, 1.4, 1.1])  # over a perfect diffuser, as fluorescent white paper
    assert read_spectrum(skin, "reflectance") is not None


@pytest.mark.parametrize("quantity", ["responsivity", "relative"])
def test_estimated_responsivities_and_relative_spectra_may_be_negative(
    skin: Usd.Prim, quantity: str
) -> None:
    skin.GetAttribute("spectrum:reflectance:values").Set([0.1, -0.1, 0.1])
    skin.GetAttribute("spectrum:reflectance:quantity").Set(quantity)
    assert read_spectrum(skin, "reflectance") is not None


def test_an_unsaid_quantity_is_the_one_asked_for(skin: Usd.Prim) -> None:
    skin.GetAttribute("spectrum:reflectance:quantity").Clear()
    spectrum = read_skin(skin).reflectance
    assert spectrum is not None
    assert spectrum.quantity is SpectralQuantity.REFLECTANCE
    skin.GetAttribute("spectrum:reflectance:values").Set([0.1, -0.1, 0.1])
    assert "never negative" in refusal(read_skin, skin)


def test_another_quantity_than_the_one_asked_for_is_refused(skin: Usd.Prim) -> None:
    skin.GetAttribute("spectrum:reflectance:quantity").Set("radiance")
    message = refusal(read_skin, skin)
    assert 'spectrum:reflectance:quantity is "radiance"; it must be reflectance here' in message


def test_a_name_no_instance_can_have_is_refused_on_writing(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/A", "Scope")
    assert "cannot be named" in refusal(write_spectrum, prim, "values", REFLECTANCE)


# Skin


def test_an_empty_skin_has_the_fallbacks_of_the_schema(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/Skin", "Material")
    prim.ApplyAPI("SkinMaterialAPI")
    skin, fallback = read_skin(prim), SkinParameters()
    for field in SkinParameters.__dataclass_fields__:
        assert getattr(skin, field) == getattr(fallback, field), field


MAPS = ("weights:file", "normal:file", "bump:file", "displacement:file", "specular:weight:file",
        "specular:roughness:file")  # fmt: skip
FILES = ("weights_file", "normal_file", "bump_file", "displacement_file", "specular_weight_file",
         "specular_roughness_file")  # fmt: skip


def test_a_skin_is_read_whole(skin: Usd.Prim, tmp_path: Path) -> None:
    (tmp_path / "weights.exr").write_bytes(b"")
    settings = {
        "alpha": 0.75,
        "wrap": 0.5,
        "wrapNormalization": "energy",
        "thickness": 0.002,
        "texcoord": "uv",
        "bump:depth": -0.002,
        "displacement:scale": 0.25,
        "displacement:midLevel": 0.0,
        "specular:weight": 1.0,
        "specular:roughness1": 0.4,
        "specular:roughness2": 0.2,
        "specular:mix": 0.1,
        "specular:f0": 0.04,
        **dict.fromkeys(MAPS, str(tmp_path / "weights.exr")),
        "weights:basis": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6],
        "weights:basis:wavelengths": [400.0, 550.0, 700.0],
    }
    for name, value in settings.items():
        skin.GetAttribute(f"inputs:skin:{name}").Set(value)
    write_spectrum(
        skin, "scattering", Spectrum(SpectralQuantity.SCATTERING, [400.0, 700.0], [0.5, 1.5])
    )
    write_spectrum(
        skin, "opacity", Spectrum(SpectralQuantity.ABSORPTION, [400.0, 700.0], [900.0, 300.0])
    )

    found = read_skin(skin)

    assert (found.alpha, found.wrap, found.wrap_normalization) == (0.75, 0.5, "energy")
    assert (found.thickness, found.texcoord) == (0.002, "uv")
    assert (found.specular_weight, found.roughness1, found.roughness2) == (1.0, 0.4, 0.2)
    assert (found.mix, found.f0) == (0.1, 0.04)
    assert (found.bump_depth, found.displacement_scale) == (-0.002, 0.25)
    assert found.displacement_mid_level == 0.0
    for field in FILES:
        assert getattr(found, field) == tmp_path / "weights.exr", field
    np.testing.assert_array_equal(found.weights_basis, [[0.1, 0.2, 0.3], [0.4, 0.5, 0.6]])
    np.testing.assert_array_equal(found.weights_wavelength_nm, [400.0, 550.0, 700.0])
    assert isinstance(found.opacity, Spectrum)
    np.testing.assert_array_equal(found.opacity.value, [900.0, 300.0])
    assert found.scattering is not None
    np.testing.assert_array_equal(found.scattering.value, [0.5, 1.5])


def test_a_single_precision_number_is_the_one_that_was_typed(skin: Usd.Prim) -> None:
    skin.GetAttribute("inputs:skin:wrap").Set(0.7)
    assert read_skin(skin).wrap == 0.7


def test_a_scalar_opacity_is_a_number(skin: Usd.Prim) -> None:
    skin.GetAttribute("inputs:skin:opacity").Set(250.0)
    assert read_skin(skin).opacity == 250.0


def test_animated_skin_is_read_at_its_time(skin: Usd.Prim) -> None:
    skin.GetAttribute("inputs:skin:alpha").Set(0.0, 0.0)
    skin.GetAttribute("inputs:skin:alpha").Set(1.0, 4.0)
    assert read_skin(skin, 1.0).alpha == 0.25


@pytest.mark.parametrize(
    ("name", "value", "kind", "expected"),
    [
        ("alpha", 1.5, "Float", "inputs:skin:alpha is 1.5; it must be from 0 to 1"),
        ("wrap", -0.1, "Float", "inputs:skin:wrap is -0.1; it must be from 0 to 1"),
        ("alpha", float("nan"), "Float", "inputs:skin:alpha is nan; set it to a finite number"),
        ("thickness", float("inf"), "Float", "inputs:skin:thickness is inf"),
        ("thickness", -1.0, "Float", "inputs:skin:thickness is -1; it must be at least 0"),
        ("opacity", -1.0, "Float", "inputs:skin:opacity is -1; it must be at least 0"),
        ("alpha", "much", "String", 'inputs:skin:alpha is "much", which is no float'),
        ("alpha", True, "Bool", "inputs:skin:alpha is True, which is no float"),
        ("wrapNormalization", "energie", "Token", 'did you mean "energy"? use one of'),
        ("wrapNormalization", "x", "Token", 'is "x"; use one of paper, energy'),
        ("albedo:file", "./nope.png", "Asset", "names @./nope.png@, which is not there"),
        ("albedo:file", "nope.<UDIM>.png", "Asset", "which is not there"),
        ("albedo:file", "nope.png", "String", "which is no asset; author it as asset"),
        ("weights:basis", [1.0, 2.0], "DoubleArray", "are no whole rows of 0"),
        ("weights:basis", "abc", "String", "which is no double[]"),
        ("weights:basis:wavelengths", [2.0, 1.0], "DoubleArray", "is not ascending at index 1"),
    ],
)
def test_values_a_skin_cannot_have_are_refused(
    skin: Usd.Prim, name: str, value: object, kind: str, expected: str
) -> None:
    author(skin, f"inputs:skin:{name}", value, getattr(Sdf.ValueTypeNames, kind))
    message = refusal(read_skin, skin)
    assert message.startswith("shot.usda </World/Skin>: ")
    assert expected in message


def test_weights_without_their_basis_are_refused(skin: Usd.Prim, tmp_path: Path) -> None:
    (tmp_path / "w.exr").write_bytes(b"")
    skin.GetAttribute("inputs:skin:weights:file").Set(str(tmp_path / "w.exr"))
    assert "inputs:skin:weights:basis has no value" in refusal(read_skin, skin)


def test_two_textures_of_reflectance_are_refused(skin: Usd.Prim, tmp_path: Path) -> None:
    (tmp_path / "w.exr").write_bytes(b"")
    for name in ("albedo", "weights"):
        skin.GetAttribute(f"inputs:skin:{name}:file").Set(str(tmp_path / "w.exr"))
    skin.GetAttribute("inputs:skin:weights:basis").Set([0.5, 0.5])
    skin.GetAttribute("inputs:skin:weights:basis:wavelengths").Set([400.0, 700.0])
    assert "is set beside inputs:skin:albedo:file" in refusal(read_skin, skin)


def test_the_tiles_of_a_udim_texture_are_kept_as_one_name(tmp_path: Path) -> None:
    (tmp_path / "skin.1001.png").write_bytes(b"")
    layer = tmp_path / "shot.usda"
    layer.write_text(
        '#usda 1.0\ndef Material "M" (\n  apiSchemas = ["SkinMaterialAPI"]\n) {\n'
        "  asset inputs:skin:albedo:file = @./skin.<UDIM>.png@\n}\n"
    )
    stage = Usd.Stage.Open(str(layer))
    assert read_skin(stage.GetPrimAtPath("/M")).albedo_file == tmp_path / "skin.<UDIM>.png"


def test_an_asset_counts_from_the_layer_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "asset").mkdir()
    (tmp_path / "asset" / "skin.png").write_bytes(b"")
    (tmp_path / "asset" / "asset.usda").write_text(
        '#usda 1.0\ndef Material "M" (\n  apiSchemas = ["SkinMaterialAPI"]\n) {\n'
        "  asset inputs:skin:albedo:file = @./skin.png@\n}\n"
    )
    (tmp_path / "shot.usda").write_text(
        '#usda 1.0\ndef "A" (\n  references = @./asset/asset.usda@</M>\n) {\n}\n'
    )
    stage = Usd.Stage.Open(str(tmp_path / "shot.usda"))
    found = read_skin(stage.GetPrimAtPath("/A"))
    assert found.albedo_file == tmp_path / "asset" / "skin.png"


def test_reading_skin_off_a_prim_without_it_is_a_mistake_of_the_caller(stage: Usd.Stage) -> None:
    with pytest.raises(ValueError, match="has no SkinMaterialAPI"):
        read_skin(stage.DefinePrim("/M", "Material"))


def same(first: object, second: object) -> bool:
    if isinstance(first, Spectrum) and isinstance(second, Spectrum):
        return (
            (first.quantity, first.interpolation) == (second.quantity, second.interpolation)
            and np.array_equal(first.wavelength_nm, second.wavelength_nm)
            and np.array_equal(first.value, second.value)
        )
    if isinstance(first, np.ndarray):
        return np.array_equal(first, second)  # type: ignore[arg-type]
    return first == second


def assert_same_fields(first: object, second: object) -> None:
    for field in dataclasses.fields(first):  # type: ignore[arg-type]
        assert same(getattr(first, field.name), getattr(second, field.name)), field.name


def test_a_skin_comes_back_as_it_was_written(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "w.exr").write_bytes(b"")
    stage = Usd.Stage.CreateNew(str(tmp_path / "skin.usda"))
    prim = stage.DefinePrim("/Skin", "Material")
    skin = SkinParameters(
        alpha=0.5,
        wrap=0.4,
        reflectance=REFLECTANCE,
        scattering=Spectrum(SpectralQuantity.SCATTERING, [400.0, 700.0], [0.5, 0.75], "held"),
        opacity=Spectrum(SpectralQuantity.ABSORPTION, [400.0, 700.0], [500.0, 200.0]),
        thickness=0.003,
        wrap_normalization="energy",
        weights_file=tmp_path / "maps" / "w.exr",
        weights_basis=np.array([[0.1, 0.2], [0.3, 0.4]]),
        weights_wavelength_nm=np.array([400.0, 700.0]),
        texcoord="uv",
        normal_file=tmp_path / "maps" / "w.exr",
        bump_file=tmp_path / "maps" / "w.exr",
        bump_depth=0.0003,
        displacement_file=tmp_path / "maps" / "w.exr",
        displacement_scale=0.02,
        displacement_mid_level=0.25,
        specular_weight_file=tmp_path / "maps" / "w.exr",
        specular_roughness_file=tmp_path / "maps" / "w.exr",
        specular_weight=1.0,
        roughness1=0.6,
        roughness2=0.25,
        mix=0.2,
        f0=0.03,
    )
    write_skin(prim, skin)
    assert_same_fields(read_skin(prim), skin)
    assert prim.GetAttribute("inputs:skin:weights:file").Get().path == "./maps/w.exr"


def test_a_skin_does_not_fit_a_mesh(stage: Usd.Stage) -> None:
    message = refusal(write_skin, stage.DefinePrim("/M", "Mesh"), SkinParameters())
    assert message == "shot.usda </M>: SkinMaterialAPI does not fit a Mesh"


def test_a_layer_in_memory_takes_no_absolute_path(stage: Usd.Stage, tmp_path: Path) -> None:
    prim = stage.DefinePrim("/M", "Material")
    skin = SkinParameters(albedo_file=tmp_path / "skin.png")
    assert "absolute path" in refusal(write_skin, prim, skin)
    write_skin(prim, skin, tmp_path / "out")
    assert prim.GetAttribute("inputs:skin:albedo:file").Get().path == "../skin.png"


# Lights


def test_a_light_comes_back_as_it_was_written(tmp_path: Path) -> None:
    (tmp_path / "c.exr").write_bytes(b"")
    stage = Usd.Stage.CreateNew(str(tmp_path / "light.usda"))
    prim = stage.DefinePrim("/Light", "DomeLight")
    light = SpectralLight(
        source="basis",
        illuminant="FL2",
        emission=Spectrum(SpectralQuantity.RADIANCE, [400.0, 700.0], [1.0, 2.0]),
        coefficients_file=tmp_path / "c.exr",
        basis=np.array([[1.0, 2.0, 3.0], [-1.0, 0.0, 1.0]]),
        basis_wavelength_nm=np.array([400.0, 550.0, 700.0]),
        scale=2.5,
        units="absolute",
    )
    write_spectral_light(prim, light)
    assert_same_fields(read_spectral_light(prim), light)


def test_a_plain_light_says_nothing_about_its_spectrum(stage: Usd.Stage) -> None:
    assert read_spectral_light(stage.DefinePrim("/L", "DomeLight")) is None


def test_a_spectral_light_is_rgb_under_d65_unless_it_says_more(light: Usd.Prim) -> None:
    found = read_spectral_light(light)
    assert found is not None
    assert (found.source, found.illuminant, found.units, found.scale) == (
        "rgb",
        "D65",
        "relative",
        1.0,
    )


def test_a_basis_has_one_row_per_coefficient(light: Usd.Prim, tmp_path: Path) -> None:
    (tmp_path / "c.exr").write_bytes(b"")
    light.GetAttribute("inputs:spectral:source").Set("basis")
    light.GetAttribute("inputs:spectral:basis").Set([1.0, 2.0, 3.0, -4.0, 5.0, 6.0])
    light.GetAttribute("inputs:spectral:basis:wavelengths").Set([400.0, 550.0, 700.0])
    light.GetAttribute("inputs:spectral:coefficients:file").Set(str(tmp_path / "c.exr"))
    light.GetAttribute("inputs:spectral:units").Set("absolute")
    found = read_spectral_light(light)
    assert found is not None
    np.testing.assert_array_equal(found.basis, [[1.0, 2.0, 3.0], [-4.0, 5.0, 6.0]])
    assert found.coefficients_file == tmp_path / "c.exr"
    assert found.units == "absolute"


@pytest.mark.parametrize(
    ("source", "missing"),
    [("basis", "inputs:spectral:basis"), ("bands", "inputs:spectral:bands:file")],
)
def test_a_source_without_its_data_is_refused(light: Usd.Prim, source: str, missing: str) -> None:
    light.GetAttribute("inputs:spectral:source").Set(source)
    message = refusal(read_spectral_light, light)
    assert f'{missing} has no value, but inputs:spectral:source is "{source}"' in message


def test_a_tabulated_light_needs_its_emission(light: Usd.Prim) -> None:
    light.GetAttribute("inputs:spectral:source").Set("tabulated")
    assert "SpectralDistributionAPI:emission is not applied" in refusal(read_spectral_light, light)
    emission = Spectrum(SpectralQuantity.RADIANCE, [400.0, 700.0], [1.0, 2.0])
    write_spectrum(light, "emission", emission)
    found = read_spectral_light(light)
    assert found is not None
    assert found.emission is not None
    np.testing.assert_array_equal(found.emission.value, [1.0, 2.0])


def test_a_broken_row_of_a_basis_is_refused(light: Usd.Prim) -> None:
    light.GetAttribute("inputs:spectral:basis").Set([1.0, 2.0, 3.0])
    light.GetAttribute("inputs:spectral:basis:wavelengths").Set([400.0, 700.0])
    assert "has 3 values, which are no whole rows of 2" in refusal(read_spectral_light, light)


@pytest.mark.parametrize(
    ("token", "source"),
    [("white", "rgb"), ("blackbody", "blackbody"), ("illuminant D", "illuminantD")],
)
def test_the_physical_lighting_proposal_is_read(stage: Usd.Stage, token: str, source: str) -> None:
    prim = stage.DefinePrim("/L", "RectLight")
    author(prim, "physical:illuminant", token, Sdf.ValueTypeNames.Token)
    found = read_spectral_light(prim)
    assert found is not None
    assert found.source == source


def test_a_custom_illuminant_of_the_proposal_is_pairs_of_wavelength_and_radiance(
    stage: Usd.Stage,
) -> None:
    prim = stage.DefinePrim("/L", "RectLight")
    author(prim, "physical:illuminant", "custom", Sdf.ValueTypeNames.Token)
    assert "give pairs of wavelength" in refusal(read_spectral_light, prim)
    pairs = [(400.0, 1.0), (500.0, 3.0)]
    author_pairs = prim.CreateAttribute("physical:customIlluminant", Sdf.ValueTypeNames.Float2Array)
    author_pairs.Set(pairs)
    found = read_spectral_light(prim)
    assert found is not None
    assert found.source == "tabulated"
    assert found.emission is not None
    np.testing.assert_array_equal(found.emission.wavelength_nm, [400.0, 500.0])
    np.testing.assert_array_equal(found.emission.value, [1.0, 3.0])


def test_an_unknown_illuminant_of_the_proposal_is_refused(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/L", "RectLight")
    author(prim, "physical:illuminant", "lava", Sdf.ValueTypeNames.Token)
    assert 'physical:illuminant is "lava"; use one of' in refusal(read_spectral_light, prim)


# Render settings


def test_settings_without_the_schema_are_none(stage: Usd.Stage) -> None:
    assert read_render_settings_api(stage.DefinePrim("/R", "RenderSettings")) is None


def test_settings_say_which_of_them_are_opinions(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/R", "RenderSettings")
    prim.ApplyAPI("SkinRenderSettingsAPI")
    prim.GetAttribute("usdskin:samplesPerPixel").Set(16)
    found = read_render_settings_api(prim)
    assert found is not None
    assert found.samples_per_pixel == 16
    assert found.integrator == "map"
    assert found.wavelength_nm.shape == (61,)
    assert found.authored == {"samples_per_pixel"}


@pytest.mark.parametrize(
    ("name", "value", "expected"),
    [
        ("samplesPerPixel", 0, "usdskin:samplesPerPixel is 0; it must be at least 1"),
        ("subdivisionLevel", 9, "usdskin:subdivisionLevel is 9; it must be from 0 to 8"),
        ("integrator", "path", 'usdskin:integrator is "path"; use one of map, traced'),
        ("wavelengths", [400.0], "usdskin:wavelengths has 1 entries; give at least 2"),
        ("wavelengths", [500.0, 400.0], "is not ascending at index 1 (400.0 after 500.0)"),
    ],
)
def test_settings_out_of_range_are_refused(
    stage: Usd.Stage, name: str, value: object, expected: str
) -> None:
    prim = stage.DefinePrim("/R", "RenderSettings")
    prim.ApplyAPI("SkinRenderSettingsAPI")
    prim.GetAttribute(f"usdskin:{name}").Set(value)
    assert expected in refusal(read_render_settings_api, prim)


# Every schema


@pytest.mark.parametrize("schema", SCHEMA_NAMES)
def test_rules_speak_of_declared_attributes_only(schema: str) -> None:
    """A rule that names no attribute would fail with a KeyError."""
    values: dict[str, object] = {item.name: None for item in declared_attributes(schema)}
    for rule in RULES.get(schema, ()):
        for complaint in rule(values):
            assert complaint.name in values


def camera(stage: Usd.Stage) -> Usd.Prim:
    return stage.DefinePrim("/Camera", "Camera")


def test_a_bracket_has_one_exposure_time_per_image(stage: Usd.Stage, tmp_path: Path) -> None:
    prim = camera(stage)
    prim.ApplyAPI("ExposureBracketAPI")
    for name in ("a.dng", "b.dng"):
        (tmp_path / name).write_bytes(b"")
    prim.GetAttribute("bracket:images").Set([str(tmp_path / "a.dng"), str(tmp_path / "b.dng")])
    prim.GetAttribute("bracket:exposureTimes").Set([0.1])
    assert "bracket:exposureTimes has 1 values but bracket:images has 2" in refusal(
        read_schema, prim, "ExposureBracketAPI", 0.0
    )
    prim.GetAttribute("bracket:exposureTimes").Set([0.1, 0.2])
    prim.GetAttribute("bracket:iso").Set([100.0])
    values = read_schema(prim, "ExposureBracketAPI", 0.0)
    assert values["bracket:images"] == [tmp_path / "a.dng", tmp_path / "b.dng"]
    prim.GetAttribute("bracket:whiteLevel").Set([0.0])
    assert "not above the black level" in refusal(read_schema, prim, "ExposureBracketAPI", 0.0)


def test_a_recovery_matrix_has_three_columns(stage: Usd.Stage) -> None:
    prim = camera(stage)
    prim.ApplyAPI("SpectralRecoveryAPI", "tube")
    prim.GetAttribute("recovery:tube:matrix").Set([1.0] * 4)
    message = refusal(read_schema, prim, "SpectralRecoveryAPI", 0.0, "tube")
    assert "recovery:tube:matrix has 4 values; give 3 for each wavelength" in message


def test_a_chart_has_one_row_of_values_per_patch(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/Chart", "Scope")
    prim.ApplyAPI("ColorChartAPI")
    prim.GetAttribute("chart:patches").Set(["a", "b"])
    prim.GetAttribute("chart:cameraValues").Set([0.1] * 5)
    assert "has 5 values but chart:patches has 2; give 3" in refusal(
        read_schema, prim, "ColorChartAPI", 0.0
    )


def test_directions_have_a_length(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/Samples", "Scope")
    prim.ApplyAPI("SkinSampleAPI")
    prim.GetAttribute("samples:light").Set([(0.0, 0.0, 1.0), (0.0, 0.0, 0.0)])
    message = refusal(read_schema, prim, "SkinSampleAPI", 0.0)
    assert "samples:light is a vector of length 0 at index 1" in message


def test_angles_stay_in_their_range(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/Samples", "Scope")
    prim.ApplyAPI("SkinSampleAPI")
    prim.GetAttribute("samples:thetaI").Set([0.0, 190.0])
    message = refusal(read_schema, prim, "SkinSampleAPI", 0.0)
    assert "samples:thetaI is 190.0 at index 1; it must be at least 0 and at most 180" in message


# Applied schemas


def test_the_example_of_the_readme_is_sound(tmp_path: Path) -> None:
    readme = Path(plugin_path(), "README.md")
    if not readme.is_file():
        pytest.skip("the wheel has no README")
    text = readme.read_text().split("```usda")[1].split("```")[0]
    (tmp_path / "readme.usda").write_text(f"#usda 1.0\n{text}")
    stage = Usd.Stage.Open(str(tmp_path / "readme.usda"))
    check_stage_schemas(stage)
    light = read_spectral_light(stage.GetPrimAtPath("/Light"))
    assert light is not None
    assert light.illuminant == "FL2"
    assert read_skin(stage.GetPrimAtPath("/Skin")).reflectance is not None


@pytest.mark.parametrize(
    ("name", "suggested"),
    [
        ("SpectralLigthAPI", "SpectralLightAPI"),
        ("SpectralLight", "SpectralLightAPI"),
        ("spectrallightapi", "SpectralLightAPI"),
        ("SpectralDistributonAPI:emission", "SpectralDistributionAPI:emission"),
    ],
)
def test_a_misspelt_schema_is_refused_with_a_suggestion(
    stage: Usd.Stage, name: str, suggested: str
) -> None:
    prim = stage.DefinePrim("/L", "DomeLight")
    prim.AddAppliedSchema(name)
    message = refusal(check_applied_schemas, prim)
    assert message.startswith(f"shot.usda </L>: {name} is no known schema")
    assert f'did you mean "{suggested}"?' in message


@pytest.mark.parametrize("name", ["KarmaLightAPI", "PhysicalLightIlluminantAPI", "SemanticsAPI:a"])
def test_schemas_of_others_are_left_alone(stage: Usd.Stage, name: str) -> None:
    prim = stage.DefinePrim("/L", "DomeLight")
    prim.AddAppliedSchema(name)
    check_applied_schemas(prim)


def test_a_schema_on_a_prim_it_does_not_fit_is_refused(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/M", "Mesh")
    prim.AddAppliedSchema("SkinMaterialAPI")
    message = refusal(check_applied_schemas, prim)
    assert "SkinMaterialAPI is applied to a Mesh; it fits Material only" in message


def test_a_missing_or_needless_instance_name_is_refused(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/M", "Material")
    prim.AddAppliedSchema("SkinMaterialAPI:face")
    assert 'write "SkinMaterialAPI"' in refusal(check_applied_schemas, prim)
    other = stage.DefinePrim("/N", "Material")
    other.AddAppliedSchema("SpectralDistributionAPI")
    assert "without an instance name" in refusal(check_applied_schemas, other)


def test_a_misspelt_spectrum_is_refused(skin: Usd.Prim) -> None:
    skin.ApplyAPI("SpectralDistributionAPI", "scatering")
    message = refusal(check_applied_schemas, skin)
    assert "SpectralDistributionAPI:scatering is read by nothing here; did you mean" in message


def test_a_spectrum_of_ones_own_is_left_alone(skin: Usd.Prim) -> None:
    skin.ApplyAPI("SpectralDistributionAPI", "bilirubin")
    check_applied_schemas(skin)


def test_a_misspelt_attribute_is_refused(skin: Usd.Prim) -> None:
    author(skin, "inputs:skin:warp", 0.5, Sdf.ValueTypeNames.Float)
    message = refusal(check_applied_schemas, skin)
    assert (
        'inputs:skin:warp is no attribute of SkinMaterialAPI; did you mean "inputs:skin' in message
    )


def test_attributes_without_their_schema_are_refused(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/L", "DomeLight")
    author(prim, "inputs:spectral:source", "blackbody", Sdf.ValueTypeNames.Token)
    message = refusal(read_spectral_light, prim)
    assert "SpectralLightAPI is not applied; add it to apiSchemas" in message


def test_samples_without_their_schema_are_refused(stage: Usd.Stage) -> None:
    prim = stage.DefinePrim("/M", "Material")
    author(prim, "spectrum:reflectance:values", [0.5], Sdf.ValueTypeNames.DoubleArray)
    message = refusal(check_applied_schemas, prim)
    assert "SpectralDistributionAPI:reflectance is not applied" in message


def test_a_stage_is_checked_down_to_the_prims_of_its_instances(stage: Usd.Stage) -> None:
    stage.DefinePrim("/Asset/Light", "DomeLight").AddAppliedSchema("SpectralLigthAPI")
    stage.GetPrimAtPath("/Asset").SetSpecifier(Sdf.SpecifierClass)
    check_stage_schemas(stage)
    instance = stage.DefinePrim("/Instance")
    instance.GetReferences().AddInternalReference("/Asset")
    instance.SetInstanceable(True)
    assert "/Instance/Light" in refusal(check_stage_schemas, stage)
