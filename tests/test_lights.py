"""Distant lights, which prims shine, and what is refused."""

import subprocess
import sys

import numpy as np
import pytest
from light_stages import (
    RNG,
    WEIGHTS,
    adapted,
    codes,
    dome,
    new_stage,
    only_dome,
    read,
    rgb_map,
    spectral,
    write_rgb,
    xyz,
)
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, Vt

from usdskin.colorimetry import daylight, planck_radiance
from usdskin.errors import LayerError, UsageError, UsdSkinError
from usdskin.prims import write_spectrum
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as NM
from usdskin.spectrum import SpectralQuantity, Spectrum

trapezoid = getattr(np, "trapezoid", None) or np.trapz  # NumPy 2 renamed it


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
    expected = 2.0 * trapezoid(2.0 * np.pi * np.sin(theta) * np.cos(theta), theta)
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


# --- Which prims shine ----------------------------------------------------------------------------


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


def test_portals_are_noted():
    stage = new_stage()
    UsdLux.PortalLight.Define(stage, "/Other")
    notes = []
    assert read(stage, notes).domes == ()
    assert codes(notes) == ["light-not-supported"] and notes[0].path == "/Other"


@pytest.mark.parametrize(
    "kind", [UsdLux.RectLight, UsdLux.DiskLight, UsdLux.SphereLight, UsdLux.CylinderLight]
)
def test_lights_with_a_place_are_noted_where_places_are_unknown(kind):
    stage = new_stage()
    kind.Define(stage, "/Other")
    notes = []
    assert read(stage, notes).locals == ()
    assert codes(notes) == ["light-needs-traced"] and notes[0].path == "/Other"
    notes = []
    (light,) = read(stage, notes, places=True).locals
    assert light.path == "/Other" and notes == []


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


# --- Errors ---------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("intensity", -1.0, "inputs:intensity is -1.0.*at least 0"),
        ("intensity", float("nan"), "inputs:intensity is nan"),
        ("exposure", float("inf"), "inputs:exposure is inf"),
        ("exposure", 2000.0, "no brightness"),
        ("exposure", 200.0, "no brightness|beyond"),
        ("color", Gf.Vec3f(1, -1, 1), "not negative"),
        ("texture:format", "mirroredBall", "mirroredBall.*latlong"),
    ],
)
def test_unusable_inputs_are_refused_with_layer_and_prim(tmp_path, name, value, message):
    stage = new_stage()
    light = dome(stage, write_rgb(tmp_path / "m.exr", rgb_map()))
    light.GetPrim().GetAttribute(f"inputs:{name}").Set(value)
    with pytest.raises(UsdSkinError, match=message) as refusal:
        read(stage)
    assert "</Dome>" in str(refusal.value) and "\n" not in str(refusal.value)


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
