"""The sets of the proof and their shots: they validate, render, and are as bright as they say."""

from __future__ import annotations

import importlib
from pathlib import Path

import numpy as np
import pytest

from usdskin import cli
from usdskin.colorimetry import illuminant, xyz_weights
from usdskin.images import read_image
from usdskin.latlong import texel_directions, texel_solid_angles
from usdskin.layers import open_stage
from usdskin.prims import read_spectral_light
from usdskin.validate import validate

# isort: split
# After ours, which register the schemas.
from pxr import UsdGeom

STAGES = Path(__file__).resolve().parents[1] / "stages"
SETS = ("room_fluorescent", "hall_incandescent", "outdoor_sun", "mixed_window")
BUST = "/Shot/Subject{subject=bust}"


def xyz_of(emission) -> np.ndarray:
    weights = xyz_weights(emission.wavelength_nm, absolute=True)
    return np.asarray(emission.value @ weights)


def dome_xyz(name: str) -> tuple[np.ndarray, np.ndarray]:
    """Return the light of a shot's dome as XYZ, and directions times solid angles."""
    stage = open_stage(STAGES / name / "light.usda")
    light = read_spectral_light(stage.GetPrimAtPath("/Light/Dome"))
    image = read_image(light.coefficients_file)
    order = [image.channel_names.index(f"c{k}") for k in range(len(light.basis))]
    spectra = light.basis @ xyz_weights(light.basis_wavelength_nm, absolute=True)
    rows, columns = image.pixels.shape[:2]
    weight = texel_directions(rows, columns) * texel_solid_angles(rows, columns)[:, None, None]
    return image.pixels[..., order] @ spectra, weight


def facing(name: str, normal: tuple[float, float, float]) -> np.ndarray:
    """Return the tristimulus irradiance of a shot's dome on a surface [lm m^-2 for Y]."""
    values, weight = dome_xyz(name)
    return np.einsum("hwc,hw->c", values, np.maximum(weight @ np.array(normal), 0.0))


@pytest.fixture
def outdoor(monkeypatch):
    monkeypatch.syspath_prepend(str(STAGES / "outdoor_sun"))
    return importlib.import_module("make_outdoor")


@pytest.mark.parametrize("name", SETS)
def test_a_set_has_nothing_to_be_found_in_and_is_small(name):
    assert [str(found) for found in validate(STAGES / name / "set.usda")] == []
    assert (STAGES / name / "set.usda").stat().st_size < 300_000
    assert max(file.stat().st_size for file in (STAGES / name).glob("*.exr")) < 450_000
    assert (STAGES / name / "README.md").is_file()


@pytest.mark.parametrize("name", SETS)
def test_a_shot_of_the_bust_validates_and_renders(name, tmp_path):
    layer = tmp_path / "shot.usda"
    layer.write_text(
        f"#usda 1.0\n(\n    subLayers = [@{(STAGES / name / 'shot.usda').as_posix()}@]\n"
        '    defaultPrim = "Shot"\n    metersPerUnit = 1\n    upAxis = "Y"\n'
        '    renderSettingsPrimPath = "/Render/Map"\n)\n'
        'over "Shot"\n{\n    over "Subject" (\n        variants = {\n'
        '            string subject = "bust"\n        }\n    )\n    {\n    }\n}\n',
        encoding="utf-8",
    )
    found = [str(each) for each in validate(layer)]
    # The other variant's person is there only when it was prepared.
    assert [each for each in found if "portrait/assets/" not in each] == []
    output = tmp_path / "out.exr"
    assert cli.main(["-q", "render", str(layer), str(output), "-p", "1", "-w", "48"]) == 0
    pixels = read_image(output).pixels
    skin = pixels[pixels[..., 3] == 1.0][:, :3]
    assert 0.2 < (pixels[..., 3] == 1.0).mean() < 0.9
    red, green, blue = np.median(skin, axis=0)
    assert red > green > blue > 0.0


def test_the_bust_is_closed_and_small():
    path = STAGES / "bust" / "bust.usda"
    assert path.stat().st_size <= 400_000
    assert [str(found) for found in validate(path)] == []
    stage = open_stage(path)
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/Bust/mesh"))
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get())
    faces = np.split(np.array(mesh.GetFaceVertexIndicesAttr().Get()), np.cumsum(counts)[:-1])
    edges = {(a, b) for face in faces for a, b in zip(face, np.roll(face, -1), strict=True)}
    assert len(edges) == counts.sum()
    assert all((b, a) in edges for a, b in edges)


@pytest.mark.parametrize(
    ("name", "lamp", "path"),
    [("mixed_window", "FL2", "tubes/tube1"), ("mixed_window", "D75", "window/sky"),
     ("hall_incandescent", "A", "bulbs/globe1")],
)  # fmt: skip
def test_a_lamp_has_the_chromaticity_of_its_illuminant(name, lamp, path):
    stage = open_stage(STAGES / name / "set.usda")
    prim = stage.GetPrimAtPath(f"/Set/Lights/{path}")
    emission = read_spectral_light(prim).emission
    found = xyz_of(emission)
    nm = emission.wavelength_nm
    expected = illuminant(lamp, nm) @ xyz_weights(nm)
    np.testing.assert_allclose(found / found.sum(), expected / expected.sum(), atol=1e-5)


def test_the_sun_is_as_bright_as_published_clear_skies(outdoor):
    """IES: 127.5 exp(-0.21 / sin h) klx facing the sun; diffuse 0.8 + 15.5 sqrt(sin h)."""
    rise = np.sin(np.radians(outdoor.ELEVATION_DEG))
    beam = outdoor.luminance(outdoor.sun_irradiance())
    assert beam == pytest.approx(127_500.0 * np.exp(-0.21 / rise), rel=0.06)
    values, spectra = outdoor.sky()
    level = texel_directions(96, 192)[..., 1] * texel_solid_angles(96, 192)[:, None]
    radiance = values[..., :3] @ (spectra[:3] @ xyz_weights(outdoor.WAVELENGTH_NM, absolute=True))
    found = (radiance[..., 1] * np.maximum(level, 0.0)).sum()
    assert found == pytest.approx(outdoor.diffuse_illuminance(), rel=1e-6)


def test_the_sun_shines_from_the_left_and_front(outdoor):
    from usdskin.render.lights import read_lights

    for layer in ("set.usda", "light.usda"):
        stage = open_stage(STAGES / "outdoor_sun" / layer)
        nm = np.arange(400.0, 701.0, 5.0)
        (sun,) = read_lights(stage, 0.0, nm, notes=[], places=True).distants
        np.testing.assert_allclose(sun.direction, outdoor.sun_direction(), atol=1e-6)
        assert sun.direction[0] < 0.0 < sun.direction[2]
        lux = sun.irradiance @ xyz_weights(nm, absolute=True)[:, 1]
        assert lux == pytest.approx(91_000.0, rel=0.01)


def test_the_shots_are_as_bright_as_such_places_are():
    up = (0.0, 1.0, 0.0)
    assert 150.0 < facing("room_fluorescent", up)[1] < 600.0
    assert 150.0 < facing("hall_incandescent", up)[1] < 600.0
    assert 200.0 < facing("mixed_window", up)[1] < 1500.0
    assert 12_000.0 < facing("outdoor_sun", up)[1] < 30_000.0


def test_both_kinds_of_light_matter_in_the_mixed_room():
    left, right = (facing("mixed_window", (x, 0.0, 0.0)) for x in (-1.0, 1.0))
    assert 1.2 < left[1] / right[1] < 4.0
    assert right[0] / right.sum() > left[0] / left.sum() + 0.03  # the tubes are yellower
