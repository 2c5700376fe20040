"""From a captured panorama and a calibration to a spectral light."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from usdskin.colorimetry import (
    chromaticity_to_xyz,
    illuminant,
    rgb_to_xyz,
    xyz_to_rgb,
    xyz_weights,
)
from usdskin.errors import ImageError, LayerError, UsageError, UsdSkinError
from usdskin.estimate.light.assigned import AssignOptions, assign_light
from usdskin.estimate.light.captured import _parted
from usdskin.estimate.light.light_map import LightMap
from usdskin.estimate.light.quality import light_quality
from usdskin.estimate.light.step import LightOptions, estimate_light
from usdskin.estimate.light.totals import Readings, add_up
from usdskin.exr_rows import open_exr_writer
from usdskin.images import Part, read_image, read_spectral, write_exr
from usdskin.latlong import latlong_from_world, texel_directions, texel_solid_angles
from usdskin.layers import open_stage
from usdskin.meters import irradiance, radiance_at, texel_vectors
from usdskin.prims import (
    Recovery,
    SpectralCamera,
    read_light_estimate,
    read_spectral_light,
    write_spectral_camera,
)
from usdskin.prims.writing import write_schema
from usdskin.progress import SilentProgress
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM
from usdskin.uplift import reflectance_basis

from pxr import Gf, Usd, UsdGeom  # isort: skip

NM = DEFAULT_WAVELENGTHS_NM
HEIGHT, WIDTH = 24, 48
SCALE = 4.0
SETTINGS = {"model": "Maker 5100", "lens": "Fisheye 8", "white_balance": "raw"}


def responsivity() -> np.ndarray:
    """Return three broad sensitivities, shape [61, 3]."""
    centers, widths = np.array([600.0, 540.0, 460.0]), np.array([40.0, 45.0, 30.0])
    return 30.0 * np.exp(-0.5 * ((NM[:, None] - centers) / widths) ** 2)


def surfaces() -> np.ndarray:
    """Return three reflectances, shape [3, 61]."""
    return reflectance_basis(NM)


def lamp(name: str) -> np.ndarray:
    """Return a lamp's radiance [W m^-2 sr^-1 nm^-1], shape [61]."""
    spectrum = illuminant(name, NM)
    return 1e-3 * spectrum / spectrum.mean()


def recovery(name: str, of: np.ndarray, **more) -> Recovery:
    """Return the recovery that is exact for the three surfaces in a lamp's light."""
    signals = surfaces() * of
    matrix = np.linalg.solve(signals @ responsivity(), signals).T
    figures = dict.fromkeys(
        ("condition", "identity_error", "loo_gfc", "loo_rmse", "loo_delta_e_2000"), 1.0
    )
    return Recovery(name, matrix, "regression", of, negative_share=0.0, **(figures | more))


@dataclass
class Place:
    """A place whose light is known, captured without a flaw."""

    folder: Path
    radiance: np.ndarray
    capture: Path
    camera: Path

    def light(self, **options) -> Path:
        output = self.folder / "light.usda"
        self.result = estimate_light(self.capture, self.camera, output, LightOptions(**options))
        return output


def make_place(
    folder: Path,
    lamps: tuple[str, ...] = ("FL2",),
    *,
    where: np.ndarray | None = None,
    up_axis: str = "Y",
    units: str = "absolute",
    capture: dict | None = None,
    camera: dict | None = None,
    more: dict | None = None,
) -> Place:
    """Write capture and calibration; texels see surfaces in the lamp that ``where`` names."""
    colors = np.random.default_rng(5).uniform(0.05, 1.0, (HEIGHT, WIDTH, 3))
    colors[3:5, 30:33] *= 40.0
    where = np.zeros((HEIGHT, WIDTH), int) if where is None else where
    spectra = np.stack([lamp(name) for name in lamps])
    radiance = (colors @ surfaces()) * spectra[where]
    rho = radiance @ responsivity()
    write_exr(
        folder / "panorama.exr",
        [Part("", {"": (SCALE * rho).astype(np.float32)}, color_space="unknown")],
    )
    stage = Usd.Stage.CreateNew(str(folder / "capture.usda"))
    UsdGeom.SetStageUpAxis(stage, up_axis)
    prim = UsdGeom.Xform.Define(stage, "/Capture").GetPrim()
    stage.SetDefaultPrim(prim)
    values = {
        "capture:panorama:file": folder / "panorama.exr",
        "capture:scale": SCALE,
        "capture:settings:model": SETTINGS["model"],
        "capture:settings:lens": SETTINGS["lens"],
        "capture:settings:whiteBalance": SETTINGS["white_balance"],
        "capture:clippedShare": 0.25,
    }
    write_schema(prim, "CaptureAPI", values | (capture or {}), folder)
    stage.Save()
    stage = Usd.Stage.CreateNew(str(folder / "camera.usda"))
    calibration = SpectralCamera(
        where="",
        wavelength_nm=NM,
        responsivity=responsivity(),
        noise=np.zeros(3),
        recoveries=tuple(
            recovery(f"lamp{index}", spectra[index], **(more or {})) for index in range(len(lamps))
        ),
        units=units,
        **SETTINGS,
    )
    stage.SetDefaultPrim(
        write_spectral_camera(stage, "/Camera", replace(calibration, **(camera or {})))
    )
    stage.Save()
    return Place(folder, radiance, folder / "capture.usda", folder / "camera.usda")


def vector(direction: np.ndarray) -> Gf.Vec3d:
    return Gf.Vec3d(*(float(value) for value in direction))


def recovered(path: Path) -> tuple[np.ndarray, Usd.Prim]:
    """Return the radiance that a light's layer describes, shape [height, width, bands]."""
    stage = open_stage(path)
    prim = stage.GetDefaultPrim()
    light = read_spectral_light(prim)
    if light.source == "bands":
        return read_spectral(light.bands_file)[1], stage
    channels = [f"c{index}" for index in range(len(light.basis))]
    return read_image(light.coefficients_file, channels=channels).pixels @ light.basis, stage


def relative(values: np.ndarray, truth: np.ndarray) -> float:
    return float(np.abs(values - truth).max() / np.abs(truth).max())


# --- One lamp ------------------------------------------------------------------------------------


def test_the_light_of_every_direction_comes_back(tmp_path):
    place = make_place(tmp_path)
    spectra, stage = recovered(place.light())
    error = np.abs(spectra - place.radiance).max(axis=-1) / place.radiance.max(axis=-1)
    assert error.max() < 3e-6
    light = read_spectral_light(stage.GetDefaultPrim())
    assert (light.source, light.units, len(light.basis)) == ("basis", "absolute", 3)
    assert light.class_map_file is None


def test_the_coefficients_are_the_panorama_itself(tmp_path):
    place = make_place(tmp_path)
    place.light()
    coefficients = read_image(tmp_path / "light.coefficients.exr", channels=["c0", "c1", "c2"])
    panorama = read_image(tmp_path / "panorama.exr")
    assert np.array_equal(coefficients.pixels, panorama.pixels)


def test_the_rendition_has_the_color_of_the_spectra_in_nit(tmp_path):
    place = make_place(tmp_path)
    place.light()
    xyz = place.radiance @ xyz_weights(NM, absolute=True)
    expected = np.maximum(xyz @ xyz_to_rgb("lin_rec709_scene").T, 0.0)
    image = read_image(tmp_path / "light.rgb.exr")
    assert image.color_space == "lin_rec709_scene"
    assert relative(image.pixels, expected) < 1e-6
    assert (
        open_stage(tmp_path / "light.usda")
        .GetDefaultPrim()
        .GetAttribute("inputs:texture:file")
        .Get()
        .path
        == "./light.rgb.exr"
    )


@pytest.mark.parametrize("up_axis", ["Y", "Z"])
@pytest.mark.parametrize("name", ["luminance", "illuminance"])
def test_a_reading_sets_the_scale(tmp_path, name, up_axis):
    texel = texel_directions(HEIGHT, WIDTH)[6, 31]
    toward = latlong_from_world(up_axis).T @ texel
    capture = {f"capture:{name}": 321.0, f"capture:{name}:direction": vector(toward)}
    place = make_place(tmp_path, up_axis=up_axis, units="relative", capture=capture)
    spectra, stage = recovered(place.light())
    luminance = spectra @ xyz_weights(NM, absolute=True)[:, 1]
    read = (
        radiance_at(luminance, texel, 0.5) if name == "luminance" else irradiance(luminance, texel)
    )
    assert float(read) == pytest.approx(321.0, rel=1e-6)
    assert read_spectral_light(stage.GetDefaultPrim()).units == "absolute"
    ratio = spectra / place.radiance
    assert ratio.max() / ratio.min() < 1.0 + 1e-4
    scale = place.result.report.scale
    assert (scale.source, scale.reading) == (name, 321.0)
    estimate = read_light_estimate(stage.GetDefaultPrim())
    assert estimate.scale == pytest.approx(float(np.median(ratio)), rel=1e-5)


@pytest.mark.parametrize(
    ("clipped", "source"), [(0.0, "both"), (0.02, "luminance"), (None, "luminance")]
)
def test_two_readings_are_averaged_unless_light_is_missing(tmp_path, clipped, source):
    texel = texel_directions(HEIGHT, WIDTH)[6, 31]
    place = make_place(tmp_path)
    luminance = place.radiance @ xyz_weights(NM, absolute=True)[:, 1]
    read = {"luminance": 1.02, "illuminance": 0.98}
    exact = {
        "luminance": float(radiance_at(luminance, texel, 0.5)),
        "illuminance": float(irradiance(luminance, texel)),
    }
    capture = {}
    for name, factor in read.items():
        capture |= {f"capture:{name}": factor * exact[name]}
        capture |= {f"capture:{name}:direction": vector(texel)}
    if clipped is not None:
        capture |= {"capture:clippedShare": clipped, "capture:coverage": 1.0}
    folder = tmp_path / "read"
    folder.mkdir()
    place = make_place(folder, capture=capture)
    place.light()
    scale = place.result.report.scale
    assert scale.source == source
    expected = 1.02 if source == "luminance" else np.sqrt(1.02 * 0.98)
    assert scale.factor == pytest.approx(expected, rel=1e-5)


def test_a_dome_of_a_stage_with_z_up_is_turned_upright(tmp_path):
    stage = open_stage(make_place(tmp_path, up_axis="Z").light())
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    to_world = UsdGeom.Xformable(stage.GetDefaultPrim()).ComputeLocalToWorldTransform(0.0)
    assert np.allclose(to_world.TransformDir(Gf.Vec3d(0, 1, 0)), [0, 0, 1])


def test_without_reading_a_relative_calibration_gives_relative_light(tmp_path):
    place = make_place(tmp_path, units="relative")
    _, stage = recovered(place.light())
    assert read_spectral_light(stage.GetDefaultPrim()).units == "relative"
    assert read_light_estimate(stage.GetDefaultPrim()).scale is None


def test_a_reading_far_from_an_absolute_calibration_is_noted(tmp_path):
    toward = texel_directions(HEIGHT, WIDTH)[6, 31]
    capture = {"capture:luminance": 1e5, "capture:luminance:direction": vector(toward)}
    place = make_place(tmp_path, capture=capture)
    place.light()
    assert [note.code for note in place.result.notes] == ["scale-differs"]


# --- What belongs together -----------------------------------------------------------------------


@pytest.mark.parametrize("field", list(SETTINGS))
@pytest.mark.parametrize("value", ["another", ""])
def test_a_capture_with_other_settings_is_refused(tmp_path, field, value):
    place = make_place(tmp_path, camera={field: value})
    with pytest.raises(LayerError) as error:
        place.light()
    shown = "another" if value else "not stated"
    assert SETTINGS[field] in str(error.value) and shown in str(error.value)
    assert "\n" not in str(error.value)


def test_settings_that_neither_side_states_are_no_difference(tmp_path):
    nothing = dict.fromkeys(SETTINGS, "")
    unsaid = dict.fromkeys(
        ["capture:settings:model", "capture:settings:lens", "capture:settings:whiteBalance"], ""
    )
    make_place(tmp_path, camera=nothing, capture=unsaid).light()


def iso(*values: float) -> np.ndarray:
    return np.array(values)


def test_iso_settings_that_one_side_alone_states_are_refused(tmp_path):
    place = make_place(tmp_path, camera={"iso": iso(100.0)})
    with pytest.raises(LayerError, match="capture:settings:iso has no value"):
        place.light()


def test_other_iso_settings_are_noted_unless_a_reading_sets_the_scale(tmp_path):
    other = {"capture:settings:iso": iso(100.0, 800.0)}
    place = make_place(tmp_path, capture=other, camera={"iso": iso(100.0)})
    place.light()
    assert [note.code for note in place.result.notes] == ["iso-differs"]
    (tmp_path / "read").mkdir()
    toward = texel_directions(HEIGHT, WIDTH)[6, 31]
    other |= {"capture:luminance": 5.0, "capture:luminance:direction": vector(toward)}
    place = make_place(
        tmp_path / "read", capture=other, camera={"iso": iso(100.0)}, units="relative"
    )
    place.light()
    assert not place.result.notes


def test_iso_settings_among_the_calibrated_ones_are_not_noted(tmp_path):
    same = {"capture:settings:iso": iso(100.0)}
    place = make_place(tmp_path, capture=same, camera={"iso": iso(100.0, 200.0)})
    place.light()
    assert not place.result.notes


def test_an_unknown_class_is_refused_by_name(tmp_path):
    with pytest.raises(UsageError, match=r"--class daylight: .* it has lamp0"):
        make_place(tmp_path).light(light_class="daylight")


def test_a_class_map_for_a_single_class_is_refused(tmp_path):
    with pytest.raises(UsageError, match="knows one class of light, lamp0"):
        make_place(tmp_path).light(class_map=tmp_path / "panorama.exr")


def test_a_panorama_with_a_bad_pixel_is_refused_with_its_place(tmp_path):
    place = make_place(tmp_path)
    pixels = read_image(tmp_path / "panorama.exr").pixels.copy()
    pixels[7, 11, 1] = np.nan
    write_exr(tmp_path / "panorama.exr", [Part("", {"": pixels}, color_space="unknown")])
    with pytest.raises(ImageError, match="x 11, y 7"):
        place.light()
    assert {path.name for path in tmp_path.iterdir()} == {
        "panorama.exr", "capture.usda", "camera.usda"
    }  # fmt: skip


def test_an_input_is_never_overwritten(tmp_path):
    place = make_place(tmp_path)
    with pytest.raises(UsageError, match="is an input"):
        estimate_light(place.capture, place.camera, tmp_path / "capture.usda")
    (tmp_path / "panorama.exr").rename(tmp_path / "light.rgb.exr")
    stage = Usd.Stage.Open(str(place.capture))
    stage.GetDefaultPrim().GetAttribute("capture:panorama:file").Set("./light.rgb.exr")
    stage.Save()
    with pytest.raises(UsageError, match=r"light\.rgb\.exr: is an input"):
        place.light()


def test_the_same_input_gives_the_same_bytes(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    place = make_place(tmp_path)
    found = [
        {path.name: path.read_bytes() for path in (place.light(), *place.result.paths)}
        for _ in range(2)
    ]
    assert found[0] == found[1] and len(found[0]) == 3


def test_another_machine_with_the_same_files_gets_the_same_light(tmp_path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    place = make_place(tmp_path)
    place.light()
    there = tmp_path / "there"
    there.mkdir()
    for name in ("capture.usda", "panorama.exr", "camera.usda"):
        shutil.copy(tmp_path / name, there)
    result = estimate_light(there / "capture.usda", there / "camera.usda", there / "light.usda")
    for path in result.paths:
        assert path.read_bytes() == (tmp_path / path.name).read_bytes()


@pytest.mark.parametrize("label", ["measure", "write"])
def test_an_interruption_leaves_what_was_there(tmp_path, label):
    place = make_place(tmp_path)
    (tmp_path / "light.usda").write_text("#usda 1.0\n")
    before = sorted(path.name for path in tmp_path.iterdir())

    class Interrupted(SilentProgress):
        def start(self, total: int, name: str) -> None:
            self.label = name

        def advance(self, count: int = 1) -> None:
            if self.label == label:
                raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        estimate_light(place.capture, place.camera, tmp_path / "light.usda", progress=Interrupted())
    assert sorted(path.name for path in tmp_path.iterdir()) == before
    assert (tmp_path / "light.usda").read_text() == "#usda 1.0\n"


def test_any_ascending_grid_works(tmp_path, monkeypatch):
    uneven = np.concatenate((np.arange(380.0, 600.0, 4.0), np.arange(600.0, 781.0, 10.0)))
    monkeypatch.setitem(globals(), "NM", uneven)
    place = make_place(tmp_path, ("A",))
    spectra, stage = recovered(place.light())
    assert relative(spectra, place.radiance) < 1e-6
    assert np.array_equal(read_spectral_light(stage.GetDefaultPrim()).basis_wavelength_nm, uneven)
    spectra, _ = recovered(place.light(form="bands"))
    assert relative(spectra, place.radiance) < 1e-6


# --- Bands ---------------------------------------------------------------------------------------


def test_the_bands_form_writes_every_spectrum(tmp_path):
    place = make_place(tmp_path)
    spectra, stage = recovered(place.light(form="bands"))
    light = read_spectral_light(stage.GetDefaultPrim())
    assert light.source == "bands" and light.basis is None
    assert relative(spectra, place.radiance) < 1e-6
    assert spectra.min() >= 0.0
    assert {path.name for path in place.result.paths} == {
        "light.usda", "light.bands.exr", "light.rgb.exr"
    }  # fmt: skip


def test_colour_science_reads_the_bands(tmp_path):
    from colour import read_spectral_image_Fichet2021

    place = make_place(tmp_path)
    place.light(form="bands")
    components = read_spectral_image_Fichet2021(str(tmp_path / "light.bands.exr"))
    nm, pixels = components["S0"]
    assert np.array_equal(nm, NM) and relative(pixels, place.radiance) < 1e-6


def test_negative_bands_are_set_to_0_and_their_share_of_the_energy_is_told(tmp_path):
    place = make_place(tmp_path)
    panorama = read_image(tmp_path / "panorama.exr").pixels.copy()
    panorama[:, ::2, 0] *= 0.2  # colors that no surface has
    write_exr(tmp_path / "panorama.exr", [Part("", {"": panorama}, color_space="unknown")])
    basis = (recovery("", lamp("FL2")).matrix / SCALE).T
    spectra = panorama.astype(np.float64) @ basis
    size = texel_solid_angles(HEIGHT, WIDTH)[:, None, None]
    share = (size * np.maximum(-spectra, 0.0)).sum() / (size * np.abs(spectra)).sum()
    assert share > 1e-3
    cut, _ = recovered(place.light(form="bands"))
    assert relative(cut, np.maximum(spectra, 0.0)) < 1e-6
    assert place.result.report.negative_share == pytest.approx(share, rel=1e-4)
    kept, _ = recovered(place.light(form="basis"))
    assert relative(kept, spectra) < 1e-6
    assert place.result.report.negative_share == pytest.approx(share, rel=1e-9)


# --- Mixed light ---------------------------------------------------------------------------------


def halves() -> np.ndarray:
    """Return which lamp lights which texel: the first the left half, the second the right."""
    return np.repeat(np.arange(WIDTH)[None] >= WIDTH // 2, HEIGHT, axis=0).astype(int)


def write_indices(path: Path, classes: np.ndarray) -> Path:
    write_exr(path, [Part("", {"Y": classes.astype(np.uint32)}, sample_type="uint")])
    return path


def test_with_a_class_map_every_lamp_has_its_own_recovery(tmp_path):
    place = make_place(tmp_path, ("FL2", "D65"), where=halves())
    given = write_indices(tmp_path / "map.exr", halves())
    spectra, stage = recovered(place.light(class_map=given))
    assert relative(spectra, place.radiance) < 1e-6
    light = read_spectral_light(stage.GetDefaultPrim())
    assert len(light.basis) == 6 and light.class_map_file.name == "light.classes.exr"
    names = [item.name for item in place.result.report.classes]
    luminous = place.radiance @ xyz_weights(NM)[:, 1] * texel_solid_angles(HEIGHT, WIDTH)[:, None]
    shares = [luminous[halves() == index].sum() / luminous.sum() for index in (0, 1)]
    estimate = read_light_estimate(stage.GetDefaultPrim())
    assert names == ["lamp0", "lamp1"] == list(estimate.classes)
    assert estimate.class_shares == pytest.approx(shares, rel=1e-5)
    assert [item.sphere_share for item in place.result.report.classes] == pytest.approx([0.5, 0.5])


def test_the_class_map_that_was_written_gives_the_same_light_again(tmp_path):
    place = make_place(tmp_path, ("FL2", "D65"), where=halves())
    first, _ = recovered(place.light(class_map=write_indices(tmp_path / "map.exr", halves())))
    again = tmp_path / "again.usda"
    options = LightOptions(class_map=tmp_path / "light.classes.exr")
    estimate_light(place.capture, place.camera, again, options)
    assert np.array_equal(recovered(again)[0], first)


def test_one_class_of_several_can_be_named(tmp_path):
    place = make_place(tmp_path, ("FL2", "D65"), where=np.ones((HEIGHT, WIDTH), int))
    spectra, stage = recovered(place.light(light_class="lamp1"))
    assert relative(spectra, place.radiance) < 1e-6
    assert len(read_spectral_light(stage.GetDefaultPrim()).basis) == 3


def test_a_class_and_a_class_map_exclude_each_other(tmp_path):
    place = make_place(tmp_path, ("FL2", "D65"))
    with pytest.raises(UsageError, match="exclude each other"):
        place.light(light_class="lamp1", class_map=tmp_path / "map.exr")


def test_without_a_map_the_classes_are_estimated_and_written(tmp_path):
    clipped = np.zeros((HEIGHT, WIDTH))
    parts = [
        Part("stddev", {"": np.zeros((HEIGHT, WIDTH, 3))}),
        Part("quality", {"seen": clipped + 1.0, "clipped": clipped, "moved": clipped}),
    ]
    write_exr(tmp_path / "stddev.exr", parts)
    capture = {"capture:stddev:file": tmp_path / "stddev.exr"}
    place = make_place(tmp_path, ("A", "D65"), where=halves(), capture=capture)
    place.light()
    weights = read_image(tmp_path / "light.classes.exr").pixels[..., :2]
    assert np.allclose(weights.sum(axis=-1), 1.0, atol=2e-3)
    channels = [f"c{index}" for index in range(6)]
    coefficients = read_image(tmp_path / "light.coefficients.exr", channels=channels).pixels
    panorama = read_image(tmp_path / "panorama.exr").pixels
    assert relative(coefficients.reshape(HEIGHT, WIDTH, 2, 3).sum(axis=2), panorama) < 1e-3


def test_what_is_grey_in_mixed_light_is_parted_into_the_lamps_own_camera_values():
    lamps = np.array([lamp("A"), lamp("D65")]) @ responsivity()
    luminance = np.array([lamp("A"), lamp("D65")]) @ xyz_weights(NM)[:, 1]
    lamps /= luminance[:, None]
    shares = np.random.default_rng(4).random((3, 5, 1))
    shares = np.concatenate([shares, 1.0 - shares], axis=-1)
    reflected = np.array([0.4, 0.4, 0.4])
    seen = (shares @ lamps) * reflected
    parts = _parted(seen, shares, lamps).reshape(3, 5, 2, 3)
    assert np.allclose(parts, shares[..., None] * lamps * 0.4, rtol=1e-6)


def test_parting_keeps_the_camera_values_of_any_color():
    rng = np.random.default_rng(5)
    block, lamps = rng.random((4, 6, 3)), rng.random((3, 3)) + 0.1
    shares = rng.dirichlet(np.ones(3), (4, 6))
    assert np.allclose(_parted(block, shares, lamps).reshape(4, 6, 3, 3).sum(2), block, rtol=1e-6)


# --- The sums ------------------------------------------------------------------------------------


def light_map(coefficients: np.ndarray, basis: np.ndarray, rows: int = 5) -> LightMap:
    height, width, rank = coefficients.shape

    def blocks():
        for begin in range(0, height, rows):
            yield begin, coefficients[begin : begin + rows].astype(np.float32)

    names = tuple(f"lamp{index}" for index in range(rank // 3))
    return LightMap(height, width, basis, NM, True, names, blocks)


def test_the_sums_of_a_uniform_light_are_those_of_the_closed_form():
    basis = surfaces() * lamp("A")
    totals = add_up(light_map(np.ones((30, 60, 3)), basis), Readings(), SilentProgress())
    assert np.allclose(totals.mean, 1.0, rtol=1e-6)
    assert np.allclose(totals.up, np.pi, rtol=1e-6)
    luminance = basis.sum(axis=0) @ xyz_weights(NM, absolute=True)[:, 1]
    assert totals.peak_luminous == pytest.approx(np.pi * luminance, rel=3e-3)
    assert totals.negative_share == 0.0 and not totals.is_sampled


@pytest.mark.parametrize("texel", [(2, 11), (17, 40), (29, 0)])
def test_the_largest_illuminance_is_that_of_the_surface_that_faces_the_lamp(texel):
    coefficients = np.zeros((30, 60, 3))
    coefficients[texel] = 1e4
    light = light_map(coefficients, surfaces() * lamp("A"))
    totals = add_up(light, Readings(), SilentProgress())
    rows, columns = texel_vectors(30, 60)
    toward = rows[texel[0]] * columns[texel[1]]
    assert totals.peak_direction @ toward / np.linalg.norm(toward) > 1.0 - 1e-9
    exact = irradiance(coefficients @ light.xyz[:, 1], totals.peak_direction)
    assert totals.peak_luminous == pytest.approx(float(exact), rel=1e-5)


def test_the_largest_illuminance_is_that_of_the_best_of_many_directions():
    rng = np.random.default_rng(3)
    coefficients = rng.random((32, 64, 3)) ** 8
    coefficients[5, 12] = 60.0
    coefficients[9, 50] = 50.0
    light = light_map(coefficients, surfaces() * lamp("FL2"), rows=7)
    totals = add_up(light, Readings(), SilentProgress())
    luminance = coefficients @ light.xyz[:, 1]
    every = [float(irradiance(luminance, way)) for way in texel_directions(8, 16).reshape(-1, 3)]
    assert totals.peak_luminous > 0.998 * max(every)
    exact = irradiance(luminance, totals.peak_direction)
    assert totals.peak_luminous == pytest.approx(float(exact), rel=2e-3)


def test_the_layer_tells_mean_illuminance_and_what_was_clipped(tmp_path):
    place = make_place(tmp_path, ("A",))
    stage = open_stage(place.light())
    estimate = read_light_estimate(stage.GetDefaultPrim())
    size = texel_solid_angles(HEIGHT, WIDTH)[:, None, None]
    mean = (place.radiance * size).sum(axis=(0, 1)) / (4.0 * np.pi)
    assert relative(estimate.mean.value, mean) < 1e-6
    assert estimate.mean.quantity.value == "radiance"
    luminance = place.radiance @ xyz_weights(NM, absolute=True)[:, 1]
    assert estimate.illuminance == pytest.approx(float(irradiance(luminance, [0, 1, 0])), rel=1e-6)
    assert estimate.peak_illuminance > estimate.illuminance
    assert (estimate.origin, estimate.clipped_share) == ("measured", 0.25)
    text = "\n".join(place.result.report.lines())
    assert "clipped: 25.00 %" in text.replace("%", " %") and "CCT" in text


def test_expected_differences_are_those_of_the_classes_by_their_light(tmp_path):
    place = make_place(tmp_path, more={"grey_delta_e": 0.5, "skin_delta_e": 0.75})
    stage = open_stage(place.light())
    estimate = read_light_estimate(stage.GetDefaultPrim())
    assert (estimate.grey_delta_e, estimate.skin_delta_e) == pytest.approx((0.5, 0.75))


# --- As a lamp -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "cct", "cri", "fidelity", "reference"),
    # CIE 015:2018 gives the CCT of A, D65, FL2 and FL11; Ra of FL2 is 64, of FL11 83 (CIE 13.3).
    [
        ("A", 2856, 100, 100, "P"),
        ("D65", 6504, 100, 100, "D"),
        ("FL2", 4230, 64, 70, "D"),
        ("FL11", 4000, 83, 80, "P"),
    ],
)
def test_published_figures_of_lamps(name, cct, cri, fidelity, reference):
    quality = light_quality(illuminant(name, NM), NM)
    assert quality.cct == pytest.approx(cct, abs=6)
    assert quality.cri == pytest.approx(cri, abs=0.5)
    assert quality.fidelity == pytest.approx(fidelity, abs=0.5)
    assert (quality.ssi >= 99.0) == (name in ("A", "D65"))
    assert quality.ssi_reference[0] == reference


def test_a_lamp_too_far_from_white_has_no_color_temperature():
    green = np.exp(-0.5 * ((NM - 530.0) / 10.0) ** 2)
    quality = light_quality(green, NM)
    assert quality.cct is quality.cri is quality.ssi is None


def test_a_black_light_has_no_figures():
    assert light_quality(np.zeros(61), NM).duv is None


# --- An assigned lamp ----------------------------------------------------------------------------


def write_environment(path: Path, pixels: np.ndarray, space: str = "lin_rec709_scene") -> Path:
    write_exr(path, [Part("", {"": pixels.astype(np.float32)}, color_space=space)])
    return path


def adapted(xyz: np.ndarray, white: np.ndarray, name: str) -> np.ndarray:
    """Return CAT16-adapted XYZ by colour-science, from a white to a lamp's."""
    from colour.adaptation import chromatic_adaptation_VonKries

    lamp_xyz = illuminant(name, NM) @ xyz_weights(NM)
    return chromatic_adaptation_VonKries(xyz, white, lamp_xyz / lamp_xyz[1], transform="CAT16")


@pytest.mark.parametrize("space", ["lin_rec709_scene", "lin_ap1_scene"])
def test_an_assigned_light_has_the_colors_of_the_map_adapted_to_the_lamp(tmp_path, space):
    rgb = np.random.default_rng(8).uniform(0.1, 1.0, (8, 16, 3))
    given = write_environment(tmp_path / "env.exr", rgb, space)
    assign_light(given, tmp_path / "light.usda", AssignOptions("FL2"))
    spectra, stage = recovered(tmp_path / "light.usda")
    expected = adapted(rgb @ rgb_to_xyz(space).T, chromaticity_to_xyz((0.3127, 0.3290)), "FL2")
    assert relative(spectra @ xyz_weights(NM), expected) < 1e-6
    image = read_image(tmp_path / "light.rgb.exr")
    shown = np.maximum(expected @ xyz_to_rgb("lin_rec709_scene").T, 0.0)
    assert relative(image.pixels, shown) < 1e-6
    assert read_spectral_light(stage.GetDefaultPrim()).units == "relative"


def test_the_white_of_the_map_is_the_lamp(tmp_path):
    white = np.array([1.4, 1.0, 0.5])
    rgb = np.random.default_rng(8).uniform(0.1, 1.0, (8, 16, 3))
    rgb[2, 3] = white
    given = write_environment(tmp_path / "env.exr", rgb)
    assign_light(given, tmp_path / "light.usda", AssignOptions("FL11", white=tuple(white)))
    spectra, _ = recovered(tmp_path / "light.usda")
    lamp_spectrum = illuminant("FL11", NM)
    xyz = rgb @ rgb_to_xyz("lin_rec709_scene").T
    luminance = float(xyz[2, 3, 1])
    weights = xyz_weights(NM)
    expected = lamp_spectrum * luminance / (lamp_spectrum @ weights[:, 1])
    assert relative(spectra[2, 3], expected) < 1e-6
    assert relative(spectra @ weights, adapted(xyz, xyz[2, 3] / luminance, "FL11")) < 1e-6


def test_the_mean_of_the_map_can_be_the_white(tmp_path):
    rgb = np.random.default_rng(8).uniform(0.1, 1.0, (8, 16, 3)) * [1.4, 1.0, 0.5]
    given = write_environment(tmp_path / "env.exr", rgb)
    result = assign_light(given, tmp_path / "light.usda", AssignOptions("A", white="mean"))
    mean = result.report.mean.value
    assert relative(mean / mean.max(), illuminant("A", NM) / illuminant("A", NM).max()) < 1e-6
    assert result.report.quality.cct == pytest.approx(2856, abs=3)


def test_an_assigned_light_says_that_it_is(tmp_path):
    given = write_environment(tmp_path / "env.exr", np.ones((8, 16, 3)))
    result = assign_light(given, tmp_path / "light.usda", AssignOptions("FL2", form="bands"))
    stage = open_stage(tmp_path / "light.usda")
    prim = stage.GetDefaultPrim()
    estimate = read_light_estimate(prim)
    assert (estimate.origin, estimate.illuminant) == ("assigned", "FL2")
    assert "Assigned, not measured" in prim.GetDocumentation()
    assert "assigned" in "\n".join(result.report.lines())
    spectra, _ = recovered(tmp_path / "light.usda")
    lamp_spectrum = illuminant("FL2", NM)
    assert relative(spectra[0, 0] / spectra[0, 0].max(), lamp_spectrum / lamp_spectrum.max()) < 1e-6


def test_a_lamp_can_come_from_a_file(tmp_path):
    given = write_environment(tmp_path / "env.exr", np.ones((8, 16, 3)))
    file = tmp_path / "tube.csv"
    pairs = zip(NM, illuminant("FL7", NM), strict=True)
    file.write_text("\n".join(["nm,power", *(f"{nm:g},{value:.6f}" for nm, value in pairs)]))
    assign_light(given, tmp_path / "light.usda", AssignOptions(str(file)))
    spectra, stage = recovered(tmp_path / "light.usda")
    lamp_spectrum = illuminant("FL7", NM)
    assert relative(spectra[0, 0] / spectra[0, 0].max(), lamp_spectrum / lamp_spectrum.max()) < 1e-5
    assert read_light_estimate(stage.GetDefaultPrim()).illuminant == "tube.csv"
    assert str(tmp_path) not in (tmp_path / "light.usda").read_text()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (AssignOptions("FL222"), "--illuminant FL222"),
        (AssignOptions(white=(0.0, 0.0, 0.0)), "no white"),
        (AssignOptions(white=(1.0, -1.0, 1.0)), "no white"),
        (AssignOptions(color_space="rec709"), "unknown color space"),
    ],
)
def test_what_cannot_be_assigned_is_refused_in_one_line(tmp_path, options, message):
    given = write_environment(tmp_path / "env.exr", np.ones((8, 16, 3)))
    with pytest.raises(UsdSkinError, match=message) as error:
        assign_light(given, tmp_path / "light.usda", options)
    assert "\n" not in str(error.value)
    assert [path.name for path in tmp_path.iterdir()] == ["env.exr"]


def test_bad_pixels_of_a_map_are_refused_or_clamped_by_request(tmp_path):
    rgb = np.ones((8, 16, 3))
    rgb[3, 5] = [np.nan, -2.0, np.inf]
    given = write_environment(tmp_path / "env.exr", rgb)
    with pytest.raises(ImageError, match="x 5, y 3"):
        assign_light(given, tmp_path / "light.usda")
    result = assign_light(given, tmp_path / "light.usda", AssignOptions(bad_pixels="clamp"))
    assert [note.code for note in result.notes] == ["bad-pixels-clamped"]
    names = ["c0", "c1", "c2"]
    coefficients = read_image(tmp_path / "light.coefficients.exr", channels=names).pixels
    assert coefficients[3, 5].tolist() == [0.0, 0.0, 1.0]


def test_a_picture_that_is_no_latlong_map_is_refused(tmp_path):
    given = write_environment(tmp_path / "env.exr", np.ones((8, 12, 3)))
    with pytest.raises(ImageError, match="12 x 8 pixels are not twice as wide"):
        assign_light(given, tmp_path / "light.usda")


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["FL2", "A"])
def test_the_mean_of_ordinary_maps_becomes_the_lamp(tmp_path, realdata, name):
    for path in sorted((realdata / "hdri").iterdir()):
        options = AssignOptions(name, white="mean", bad_pixels="clamp")
        report = assign_light(path, tmp_path / "light.usda", options).report
        mean = report.mean.value / report.mean.value.max()
        assert relative(mean, illuminant(name, NM) / illuminant(name, NM).max()) < 1e-6, path.name
        assert report.negative_share < 1e-3, path.name


# --- Memory --------------------------------------------------------------------------------------

_MEASURE = """
import sys
from usdskin.estimate.light.step import LightOptions, estimate_light
folder = sys.argv[1]
estimate_light(
    f"{folder}/capture.usda",
    f"{folder}/camera.usda",
    f"{folder}/light.usda",
    LightOptions(form="bands"),
)
# ru_maxrss would hold what the process that started this one needed.
status = open("/proc/self/status").read()
print(status.partition("VmHWM:")[2].split()[0])
"""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="needs Linux to measure memory")
def test_all_bands_of_a_large_panorama_need_less_than_512_mb(tmp_path):
    make_place(tmp_path, ("FL2", "D65"))
    small = read_image(tmp_path / "panorama.exr").pixels
    rng = np.random.default_rng(1)
    with open_exr_writer(tmp_path / "panorama.exr", 4096, 2048, ["R", "G", "B"]) as writer:
        for begin in range(0, 2048, 64):
            rows = small[np.arange(begin, begin + 64) * HEIGHT // 2048]
            block = rows[:, np.arange(4096) * WIDTH // 4096]
            writer.write(begin, block * (1.0 + 0.01 * rng.standard_normal(block.shape)))
    command = [sys.executable, "-c", _MEASURE, str(tmp_path)]
    peak_kib = int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)
    os.unlink(tmp_path / "light.bands.exr")
    assert peak_kib * 1024 < 512e6
