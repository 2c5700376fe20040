"""Rectangle, disk, sphere and cylinder lights, read from stages."""

from __future__ import annotations

import numpy as np
import pytest
from light_stages import ABSOLUTE, NM, WEIGHTS, codes, new_stage, read, spectral, write_rgb
from local_light_draws import irradiance
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux

import usdskin.cli as cli
from usdskin.colorimetry import daylight, illuminant
from usdskin.errors import ImageError, LayerError, UsdSkinError
from usdskin.prims import write_spectrum
from usdskin.spectrum import SpectralQuantity, Spectrum

KINDS = {
    "rect": UsdLux.RectLight,
    "disk": UsdLux.DiskLight,
    "sphere": UsdLux.SphereLight,
    "cylinder": UsdLux.CylinderLight,
}


def metres(up="Y"):
    stage = new_stage(up)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    return stage


def lamp(stage, kind="rect", path="/Lamp", **inputs):
    light = KINDS[kind].Define(stage, path)
    for name, value in inputs.items():
        light.GetPrim().GetAttribute(f"inputs:{name}").Set(value)
    return light


def shaped(stage, kind="rect", **shaping):
    light = lamp(stage, kind)
    api = UsdLux.ShapingAPI.Apply(light.GetPrim())
    for name, value in shaping.items():
        api.GetPrim().GetAttribute(f"inputs:shaping:{name.replace('_', ':')}").Set(value)
    return light


def one(stage, notes=None, **options):
    (light,) = read(stage, notes, places=True, **options).locals
    return light


def luminance(light):
    return light.radiance.sum(axis=0) @ WEIGHTS[:, 1]


# --- Geometry ----------------------------------------------------------------------------------


def test_sizes_are_scaled_once():
    stage = metres()
    light = lamp(stage, "rect", width=2.0, height=3.0)
    light.AddTranslateOp().Set(Gf.Vec3d(1, 2, 3))
    light.AddScaleOp().Set(Gf.Vec3f(4.0, 0.5, 7.0))
    found = one(stage)
    assert found.half == (4.0, 0.75)
    assert found.center.tolist() == [1, 2, 3]
    assert found.axes.tolist() == np.eye(3).tolist()


def test_scales_of_parents_count():
    stage = metres()
    UsdGeom.Xform.Define(stage, "/Group").AddScaleOp().Set(Gf.Vec3f(2.0))
    lamp(stage, "sphere", "/Group/Lamp", radius=0.25).AddTranslateOp().Set(Gf.Vec3d(0, 1, 0))
    found = one(stage)
    assert found.half == (0.5, 0.5) and found.center.tolist() == [0, 2, 0]


def test_a_light_shines_where_its_minus_z_points():
    stage = metres("Z")
    lamp(stage).AddRotateXOp().Set(90.0)  # -z to +y
    assert -one(stage).axes[2] == pytest.approx([0.0, 1.0, 0.0], abs=1e-7)


def test_a_mirror_keeps_the_side_that_shines():
    stage = metres()
    lamp(stage).AddScaleOp().Set(Gf.Vec3f(-1.0, 1.0, 1.0))
    found = one(stage)
    assert found.axes.tolist() == np.diag([-1.0, 1.0, 1.0]).tolist() and found.half == (0.5, 0.5)
    assert irradiance(found, (0, 0, -1), (0, 0, 1)) > 0.0
    turned = metres()
    lamp(turned).AddScaleOp().Set(Gf.Vec3f(1.0, 1.0, -1.0))
    assert one(turned).axes[2].tolist() == [0, 0, -1]


def test_a_flat_light_needs_no_depth():
    stage = metres()
    lamp(stage).AddScaleOp().Set(Gf.Vec3f(1.0, 1.0, 0.0))
    assert one(stage).axes.tolist() == np.eye(3).tolist()


def test_cylinders_lie_along_x_and_stretch_along_it():
    stage = metres()
    light = lamp(stage, "cylinder", length=2.0, radius=0.1)
    light.AddScaleOp().Set(Gf.Vec3f(3.0, 2.0, 2.0))
    assert one(stage).half == pytest.approx((3.0, 0.2))


@pytest.mark.parametrize("kind", ["disk", "sphere", "cylinder"])
def test_round_lights_refuse_uneven_scales(kind):
    stage = metres()
    lamp(stage, kind).AddScaleOp().Set(Gf.Vec3f(1.0, 2.0, 1.0))
    with pytest.raises(LayerError, match=r"/Lamp>.*unevenly.*stays round"):
        one(stage)


def test_shear_is_refused():
    stage = metres()
    UsdGeom.Xform.Define(stage, "/Group").AddScaleOp().Set(Gf.Vec3f(1.0, 3.0, 1.0))
    lamp(stage, "rect", "/Group/Lamp").AddRotateZOp().Set(30.0)
    with pytest.raises(LayerError, match=r"/Group/Lamp>.*shears"):
        one(stage)


@pytest.mark.parametrize(
    ("kind", "name"),
    [("rect", "width"), ("rect", "height"), ("disk", "radius"), ("cylinder", "length")],
)
def test_lights_without_area_are_refused(kind, name):
    stage = metres()
    lamp(stage, kind, **{name: 0.0})
    with pytest.raises(LayerError, match=rf"inputs:{name} is 0"):
        one(stage)


def test_negative_sizes_and_flattening_transforms_are_refused():
    stage = metres()
    lamp(stage, "sphere", radius=-1.0)
    with pytest.raises(LayerError, match="radius is -1"):
        one(stage)
    stage = metres()
    lamp(stage).AddScaleOp().Set(Gf.Vec3f(0.0, 1.0, 1.0))
    with pytest.raises(LayerError, match="flattens"):
        one(stage)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("normalize", [False, True])
def test_centimetres_and_metres_give_the_same_light(kind, normalize):
    found = []
    for unit in (1.0, 0.01):
        stage = new_stage()
        UsdGeom.SetStageMetersPerUnit(stage, unit)
        light = lamp(stage, kind, normalize=normalize)
        light.AddTranslateOp().Set(Gf.Vec3d(0.3, -0.2, 2.0) / unit)
        light.AddScaleOp().Set(Gf.Vec3f(1.0 / unit))
        found.append(one(stage))
    assert found[0].half == pytest.approx(found[1].half, rel=1e-6)
    values = [irradiance(light, (0, 0, 0), (0, 0, 1)) for light in found]
    assert values[1] == pytest.approx(values[0], rel=1e-5) and values[0] > 0.0
    assert found[1].radiance == pytest.approx(found[0].radiance, rel=1e-6)


# --- Brightness --------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", KINDS)
def test_intensity_and_exposure_are_luminance_whatever_the_size(kind):
    stage = metres()
    lamp(stage, kind, intensity=3.0, exposure=2.0).AddScaleOp().Set(Gf.Vec3f(5.0))
    assert luminance(one(stage)) == pytest.approx(12.0)


@pytest.mark.parametrize(
    ("kind", "sizes", "area"),
    [
        ("rect", {"width": 2.0, "height": 3.0}, 6.0),
        ("disk", {"radius": 2.0}, 4.0 * np.pi),
        ("sphere", {"radius": 2.0}, 16.0 * np.pi),
        ("cylinder", {"radius": 2.0, "length": 3.0}, 12.0 * np.pi),
    ],
)
def test_normalize_divides_by_the_area_in_the_world(kind, sizes, area):
    stage = metres()
    lamp(stage, kind, normalize=True, **sizes).AddScaleOp().Set(Gf.Vec3f(2.0))
    assert luminance(one(stage)) == pytest.approx(1.0 / (4.0 * area))


def test_a_distant_sphere_is_a_distant_light():
    stage = metres()
    lamp(stage, "sphere", radius=0.5).AddTranslateOp().Set(Gf.Vec3d(0, 0, 60.0))
    sun = UsdLux.DistantLight.Define(stage, "/Sun")
    sun.CreateAngleAttr(float(np.degrees(2.0 * np.arcsin(0.5 / 60.0))))
    sun.CreateIntensityAttr(1.0)
    lights = read(stage, places=True)
    (sphere,), (distant,) = lights.locals, lights.distants
    received = irradiance(sphere, (0, 0, 0), (0, 0, 1)) * sphere.radiance[0]
    assert received == pytest.approx(distant.irradiance, rel=1e-4)


@pytest.mark.parametrize("normalize", [False, True])
def test_a_sphere_treated_as_a_point_is_the_sphere_far_away(normalize):
    found = {}
    for name, treated in (("sphere", False), ("point", True)):
        stage = metres()
        light = lamp(stage, "sphere", radius=0.2, normalize=normalize)
        light.CreateTreatAsPointAttr(treated)
        found[name] = one(stage)
    assert found["point"].kind == "point" and found["sphere"].kind == "sphere"
    values = [
        irradiance(found[name], (9.0, 0, 0), (-1, 0, 0)) * found[name].radiance[0] for name in found
    ]
    assert values[1] == pytest.approx(values[0], rel=1e-3)


@pytest.mark.parametrize("normalize", [False, True])
def test_a_cylinder_treated_as_a_line_is_the_cylinder_far_away(normalize):
    found = {}
    for name, treated in (("cylinder", False), ("line", True)):
        stage = metres()
        light = lamp(stage, "cylinder", radius=0.02, length=2.0, normalize=normalize)
        light.CreateTreatAsLineAttr(treated)
        found[name] = one(stage)
    assert found["line"].kind == "line"
    values = [
        irradiance(found[name], (0.4, 0, -3.0), (0, 0, 1)) * found[name].radiance[0]
        for name in found
    ]
    assert values[1] == pytest.approx(values[0], rel=5e-3)


def test_no_radius_is_a_point_or_a_line_that_has_power_where_normalised():
    for kind, expected in (("sphere", 0.25), ("cylinder", 1.0 / (2.0 * np.pi))):
        stage = metres()
        sizes = {"length": 2.0} if kind == "cylinder" else {}
        lamp(stage, kind, radius=0.0, normalize=True, **sizes)
        found = one(stage)
        assert found.kind in ("point", "line") and luminance(found) == pytest.approx(expected)
        stage = metres()
        lamp(stage, kind, radius=0.0, **sizes)
        notes = []
        assert not one(stage, notes).radiance.any() and codes(notes) == ["light-without-area"]


# --- Spectra -----------------------------------------------------------------------------------


def test_colors_and_illuminants_are_those_of_other_lights():
    stage = metres()
    lamp(stage, "disk", color=Gf.Vec3f(1.0, 0.5, 0.25), intensity=2.0)
    sun = UsdLux.DistantLight.Define(stage, "/Sun")
    for attribute, value in (("angle", 0.0), ("intensity", 2.0), ("color", (1.0, 0.5, 0.25))):
        sun.GetPrim().GetAttribute(f"inputs:{attribute}").Set(value)
    for name in (None, "FL2"):
        lights = read(stage, places=True, illuminant=name)
        assert lights.locals[0].radiance[0] == pytest.approx(lights.distants[0].irradiance)
    stage = metres()
    lamp(stage)
    d65 = illuminant("D65", NM)
    assert one(stage).radiance[0] == pytest.approx(d65 / (d65 @ WEIGHTS[:, 1]), rel=1e-6)


def test_tabulated_radiance_is_as_authored():
    stage = metres()
    prim = spectral(lamp(stage, "cylinder", intensity=3.0), "tabulated", units="absolute")
    write_spectrum(prim, "emission", Spectrum(SpectralQuantity.RADIANCE, NM, np.linspace(0, 1, 61)))
    found = one(stage)
    assert found.radiance[0] == pytest.approx(3.0 * np.linspace(0, 1, 61), abs=1e-9)
    assert found.absolute and read(stage, places=True).absolute


def test_tabulated_irradiance_is_refused():
    stage = metres()
    prim = spectral(lamp(stage), "tabulated")
    write_spectrum(prim, "emission", Spectrum(SpectralQuantity.IRRADIANCE, NM, np.ones(61)))
    with pytest.raises(LayerError, match=r"/Lamp>.*is irradiance"):
        one(stage)


def test_daylight_and_black_bodies_have_luminance_one():
    stage = metres()
    spectral(lamp(stage, "sphere", colorTemperature=5000.0), "illuminantD")
    found = one(stage)
    assert luminance(found) == pytest.approx(1.0)
    shape = daylight(5000.0, NM)
    assert found.radiance[0] / found.radiance[0].max() == pytest.approx(shape / shape.max())
    stage = metres()
    prim = spectral(lamp(stage), "rgb", units="absolute")
    assert prim and one(stage).radiance[0] @ ABSOLUTE[:, 1] == pytest.approx(1.0)


@pytest.mark.parametrize("source", ["basis", "bands"])
def test_maps_of_directions_are_refused(source):
    stage = metres()
    spectral(lamp(stage), source)
    with pytest.raises(LayerError, match=rf"/Lamp>.*{source}"):
        one(stage)


def test_mixed_units_are_refused():
    stage = metres()
    UsdLux.DistantLight.Define(stage, "/Sun")
    spectral(lamp(stage), "rgb", units="absolute")
    with pytest.raises(LayerError, match="relative"):
        read(stage, places=True)


def test_a_picture_gives_three_channels_with_its_colors(tmp_path):
    pixels = np.random.default_rng(2).random((4, 6, 3)).astype(np.float32)
    stage = metres()
    light = lamp(stage, "rect", intensity=2.0)
    light.CreateTextureFileAttr(Sdf.AssetPath(write_rgb(tmp_path / "window.exr", pixels)))
    found = one(stage)
    assert found.radiance.shape == (3, 61) and (found.texture == pixels).all()
    white = found.radiance.sum(axis=0)
    stage = metres()
    lamp(stage, "rect", intensity=2.0)
    assert white == pytest.approx(one(stage).radiance[0])


def test_a_picture_that_is_missing_is_named(tmp_path):
    stage = metres()
    lamp(stage).CreateTextureFileAttr(Sdf.AssetPath(str(tmp_path / "no.exr")))
    with pytest.raises(ImageError, match=r"texture:file names .*no\.exr"):
        one(stage)


# --- Shaping -----------------------------------------------------------------------------------


def test_shaping_is_read_and_clamped():
    stage = metres()
    shaped(stage, cone_angle=30.0, cone_softness=1.5, focus=-2.0)
    found = one(stage).shaping
    assert found.cone_angle == pytest.approx(np.radians(30.0))
    assert (found.cone_softness, found.focus) == (1.0, 0.0)


def test_a_cone_of_90_degrees_halves_a_sphere_and_leaves_a_rectangle():
    stage = metres()
    shaped(stage, "sphere")
    assert one(stage).shaping.cone_angle == pytest.approx(np.pi / 2)
    stage = metres()
    shaped(stage, "rect")
    assert one(stage).shaping.cone_angle is None


def test_a_colored_tint_gives_three_channels_that_add_up_to_the_light():
    for source in ("rgb", "blackbody"):
        stage = metres()
        light = shaped(stage, "sphere", focus=2.0, focusTint=Gf.Vec3f(1.0, 0.2, 0.1))
        spectral(light, source)
        found = one(stage)
        assert found.radiance.shape == (3, 61)
        stage = metres()
        spectral(lamp(stage, "sphere"), source)
        assert found.radiance.sum(axis=0) == pytest.approx(one(stage).radiance[0], rel=1e-6)


LAMP = "IESNA:LM-63-2002\nTILT=NONE\n1 1 2 3 1 1 2 0 0 0\n1 1 9\n0 45 90\n0\n8 4 0\n"


def test_profiles_are_read_from_the_file_that_is_named(tmp_path):
    (tmp_path / "lamp.ies").write_text(LAMP)
    for normalize, power in ((False, 1.0), (True, None)):
        stage = metres()
        shaped(
            stage,
            "sphere",
            ies_file=Sdf.AssetPath(str(tmp_path / "lamp.ies")),
            ies_normalize=normalize,
            ies_angleScale=0.5,
        )
        found = one(stage).shaping
        assert found.angle_scale == 0.5
        if power is None:
            assert found.profile.mean() == pytest.approx(1.0)
        else:
            assert found.profile.intensity[:, 0].tolist() == [16, 8, 0]


@pytest.mark.parametrize(
    ("text", "said"), [(LAMP.replace("8 4 0", "8 4"), r"lamp\.ies:8"), (None, "not there")]
)
def test_a_profile_that_cannot_be_used_names_light_and_line(tmp_path, text, said):
    if text is not None:
        (tmp_path / "lamp.ies").write_text(text)
    stage = metres()
    shaped(stage, "sphere", ies_file=Sdf.AssetPath(str(tmp_path / "lamp.ies")))
    with pytest.raises(UsdSkinError, match=rf"/Lamp.*{said}"):
        one(stage)


def test_shaping_inputs_without_the_schema_are_noted():
    stage = metres()
    prim = lamp(stage).GetPrim()
    prim.CreateAttribute("inputs:shaping:cone:angle", Sdf.ValueTypeNames.Float).Set(20.0)
    notes = []
    assert one(stage, notes).shaping.cone_angle is None
    assert codes(notes) == ["light-shaping-ignored"]


def test_what_has_no_effect_is_noted():
    stage = metres()
    light = lamp(stage, "sphere")
    light.CreateDiffuseAttr(0.5)
    light.CreateFiltersRel().AddTarget("/Filter")
    api = UsdLux.ShadowAPI.Apply(light.GetPrim())
    api.CreateShadowColorAttr(Gf.Vec3f(1, 0, 0))
    api.CreateShadowEnableAttr(False)
    UsdLux.LightAPI(light).GetLightLinkCollectionAPI().CreateExcludesRel().AddTarget("/Head")
    notes = []
    one(stage, notes)
    assert codes(notes) == [
        "light-multiplier-ignored",
        "light-shadow-ignored",
        "light-filters-ignored",
    ]
    assert "inputs:shadow:enable" not in notes[1].message


# --- Command line ------------------------------------------------------------------------------


def test_a_stage_lit_from_places_alone_says_that_it_needs_the_traced_integrator(tmp_path, capfd):
    path = tmp_path / "shot.usda"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.Cube.Define(stage, "/Cube")
    UsdGeom.Camera.Define(stage, "/Camera")
    lamp(stage, "rect", "/Softbox")
    lamp(stage, "sphere", "/Bulb")
    stage.Save()
    assert cli.main(["render", str(path), str(tmp_path / "out.exr"), "-r", "8", "8"]) != 0
    said = capfd.readouterr().err
    assert "</Softbox> and 1 more" in said and "--integrator traced" in said
    assert "Traceback" not in said
