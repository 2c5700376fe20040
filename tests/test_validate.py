"""What ``validate`` finds, and that a sound stage has nothing to find."""

from __future__ import annotations

import resource
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade

from usdskin.errors import LayerError
from usdskin.findings import Finding
from usdskin.images import Part, write_exr, write_spectral_exr
from usdskin.layers import record_provenance
from usdskin.prims import write_spectrum
from usdskin.spectrum import SpectralQuantity, Spectrum
from usdskin.validate import validate

WAVELENGTHS = [400.0, 550.0, 700.0]
CUBE_COUNTS = [4] * 6
CUBE_INDICES = [0, 1, 3, 2, 4, 6, 7, 5, 0, 4, 5, 1, 2, 3, 7, 6, 0, 2, 6, 4, 1, 5, 7, 3]
CUBE_POINTS = [(x, y, z) for z in (0.0, 1.0) for y in (0.0, 1.0) for x in (0.0, 1.0)]


def spectrum(quantity: SpectralQuantity, value: float) -> Spectrum:
    return Spectrum(quantity, WAVELENGTHS, [value] * 3)


def define_skin(stage: Usd.Stage) -> Usd.Prim:
    material = UsdShade.Material.Define(stage, "/World/Skin")
    shader = UsdShade.Shader.Define(stage, "/World/Skin/Surface")
    shader.CreateIdAttr("UsdPreviewSurface")
    shader.CreateInput("diffuseColor", Sdf.ValueTypeNames.Color3f).Set((0.6, 0.4, 0.3))
    material.CreateSurfaceOutput().ConnectToSource(
        shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    )
    prim = material.GetPrim()
    prim.ApplyAPI("SkinMaterialAPI")
    write_spectrum(prim, "reflectance", spectrum(SpectralQuantity.REFLECTANCE, 0.5))
    write_spectrum(prim, "scattering", spectrum(SpectralQuantity.SCATTERING, 0.25))
    return prim


def define_light(stage: Usd.Stage, folder: Path) -> Usd.Prim:
    write_exr(
        folder / "light.exr",
        [Part("", {f"c{k}": np.full((4, 8), 0.5, np.float32) for k in range(2)})],
    )
    write_exr(
        folder / "rgb.exr",
        [Part("", {"": np.ones((4, 8, 3), np.float32)}, color_space="lin_rec709_scene")],
    )
    dome = UsdLux.DomeLight.Define(stage, "/World/Light")
    dome.CreateTextureFileAttr("./rgb.exr")
    prim = dome.GetPrim()
    prim.ApplyAPI("SpectralLightAPI")
    prim.GetAttribute("inputs:spectral:source").Set("basis")
    prim.GetAttribute("inputs:spectral:basis").Set([1.0, 2.0, 3.0, 0.5, 0.5, 0.5])
    prim.GetAttribute("inputs:spectral:basis:wavelengths").Set(WAVELENGTHS)
    prim.GetAttribute("inputs:spectral:coefficients:file").Set("./light.exr")
    return prim


def define_mesh(stage: Usd.Stage, material: Usd.Prim) -> UsdGeom.Mesh:
    mesh = UsdGeom.Mesh.Define(stage, "/World/Head")
    mesh.CreateFaceVertexCountsAttr(CUBE_COUNTS)
    mesh.CreateFaceVertexIndicesAttr(CUBE_INDICES)
    mesh.CreatePointsAttr([Gf.Vec3f(*point) for point in CUBE_POINTS])
    mesh.CreateExtentAttr([(0, 0, 0), (1, 1, 1)])
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(UsdShade.Material(material))
    return mesh


class Shot:
    """A sound stage on disk, to be spoilt."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / "shot.usda"
        self.folder = folder
        self.stage = Usd.Stage.CreateNew(str(self.path))
        UsdGeom.SetStageMetersPerUnit(self.stage, 1.0)
        UsdGeom.SetStageUpAxis(self.stage, UsdGeom.Tokens.y)
        self.stage.SetDefaultPrim(self.stage.DefinePrim("/World", "Xform"))
        self.skin = define_skin(self.stage)
        self.light = define_light(self.stage, folder)
        self.mesh = define_mesh(self.stage, self.skin)

    def findings(self) -> list[Finding]:
        self.stage.Save()
        return validate(self.path)

    def codes(self) -> list[tuple[str, str, str]]:
        return [(item.severity, item.code, item.path) for item in self.findings()]


@pytest.fixture
def shot(tmp_path: Path) -> Shot:
    return Shot(tmp_path)


def test_a_sound_stage_has_nothing_to_find(shot: Shot) -> None:
    assert shot.findings() == []


def test_a_record_of_origin_is_sound(shot: Shot) -> None:
    record_provenance(shot.stage, "estimateLight", [shot.folder / "rgb.exr"], {"ridge": 0.1})
    assert shot.findings() == []


def test_a_layer_that_cannot_be_opened_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(LayerError, match="no such file"):
        validate(tmp_path / "nope.usda")


def test_usds_own_validators_are_run(shot: Shot) -> None:
    shot.stage.ClearDefaultPrim()
    shot.stage.ClearMetadata("upAxis")
    codes = {code for _, code, _ in shot.codes()}
    assert codes == {
        "usd:StageMetadataChecker.MissingDefaultPrim",
        "usd:StageMetadataChecker.MissingUpAxisMetadata",
    }


def test_a_finding_says_where_and_what_in_one_line(shot: Shot) -> None:
    shot.skin.GetAttribute("inputs:skin:alpha").Set(1.5)
    (found,) = shot.findings()
    assert str(found) == (
        "error out-of-range shot.usda </World/Skin>: inputs:skin:alpha is 1.5; it must be from 0 "
        "to 1"
    )


def test_findings_name_the_layer_of_the_wrong_opinion(tmp_path: Path) -> None:
    shot = Shot(tmp_path)
    shot.skin.GetAttribute("inputs:skin:alpha").Set(1.5)
    shot.stage.Save()
    over = tmp_path / "over.usda"
    over.write_text('#usda 1.0\n(\n  defaultPrim = "World"\n  subLayers = [@./shot.usda@]\n)\n')
    found = [item for item in validate(over) if item.code == "out-of-range"]
    assert [item.layer for item in found] == ["shot.usda"]


Spoiler = Callable[[Shot], object]

SPOILERS: dict[str, tuple[Spoiler, tuple[str, str, str]]] = {
    "unknown token": (
        lambda shot: shot.light.GetAttribute("inputs:spectral:units").Set("absolut"),
        ("error", "unknown-token", "/World/Light"),
    ),
    "unequal lengths": (
        lambda shot: shot.skin.GetAttribute("spectrum:reflectance:values").Set([0.5, 0.5]),
        ("error", "unequal-lengths", "/World/Skin"),
    ),
    "descending wavelengths": (
        lambda shot: shot.skin.GetAttribute("spectrum:scattering:wavelengths").Set(
            [400.0, 390.0, 700.0]
        ),
        ("error", "not-ascending", "/World/Skin"),
    ),
    "wavelength that is not a number": (
        lambda shot: shot.light.GetAttribute("inputs:spectral:basis:wavelengths").Set(
            [400.0, float("nan"), 700.0]
        ),
        ("error", "not-finite", "/World/Light"),
    ),
    "negative reflectance": (
        lambda shot: shot.skin.GetAttribute("spectrum:reflectance:values").Set([0.5, -0.5, 0.5]),
        ("error", "negative-value", "/World/Skin"),
    ),
    "reflectance in percent": (
        lambda shot: shot.skin.GetAttribute("spectrum:reflectance:values").Set([31.0, 38.0, 55.0]),
        ("error", "looks-like-percent", "/World/Skin"),
    ),
    "wrong in one frame only": (
        lambda shot: (
            shot.skin.GetAttribute("inputs:skin:opacity").Set(1.0, 1.0),
            shot.skin.GetAttribute("inputs:skin:opacity").Set(-1.0, 2.0),
        ),
        ("error", "out-of-range", "/World/Skin"),
    ),
    "wrong quantity": (
        lambda shot: shot.skin.GetAttribute("spectrum:scattering:quantity").Set("radiance"),
        ("error", "wrong-quantity", "/World/Skin"),
    ),
    "misspelt schema": (
        lambda shot: shot.light.AddAppliedSchema("SpectralLigthAPI"),
        ("error", "unknown-schema", "/World/Light"),
    ),
    "misplaced schema": (
        lambda shot: shot.mesh.GetPrim().AddAppliedSchema("SkinMaterialAPI"),
        ("error", "misapplied-schema", "/World/Head"),
    ),
    "more light out than in": (
        lambda shot: write_spectrum(
            shot.skin, "reflectance", spectrum(SpectralQuantity.REFLECTANCE, 0.8)
        ),
        ("warning", "gains-energy", "/World/Skin"),
    ),
    "no surface for others": (
        lambda shot: shot.stage.RemovePrim("/World/Skin/Surface"),
        ("warning", "no-rgb-rendition", "/World/Skin"),
    ),
    "no map for others": (
        lambda shot: shot.light.RemoveProperty("inputs:texture:file"),
        ("warning", "no-rgb-rendition", "/World/Light"),
    ),
    "no such coefficients": (
        lambda shot: (shot.folder / "light.exr").unlink(),
        ("error", "file-not-found", "/World/Light"),
    ),
    "no such map": (
        lambda shot: (shot.folder / "rgb.exr").unlink(),
        ("error", "usd:MissingReferenceValidator.UnresolvableDependency", "/"),
    ),
    "coefficients that are no image": (
        lambda shot: (shot.folder / "light.exr").write_bytes(b"nothing"),
        ("error", "unreadable-file", "/World/Light"),
    ),
    "map that is no image": (
        lambda shot: (shot.folder / "rgb.exr").write_bytes(b"nothing"),
        ("error", "unreadable-file", "/World/Light"),
    ),
    "too few coefficient channels": (
        lambda shot: write_exr(
            shot.folder / "light.exr", [Part("", {"c0": np.ones((4, 8), np.float32)})]
        ),
        ("error", "unreadable-file", "/World/Light"),
    ),
    "broken mesh": (
        lambda shot: shot.mesh.GetFaceVertexIndicesAttr().Set([*CUBE_INDICES[:-1], 99]),
        ("error", "bad-topology", "/World/Head"),
    ),
    "point that is not a number": (
        lambda shot: shot.mesh.GetPointsAttr().Set(
            [Gf.Vec3f(float("nan")), *(Gf.Vec3f(*point) for point in CUBE_POINTS[1:])]
        ),
        ("error", "not-finite", "/World/Head"),
    ),
    "instancer of itself": (
        lambda shot: (
            UsdGeom.PointInstancer.Define(shot.stage, "/World/Many")
            .CreatePrototypesRel()
            .AddTarget("/World")
        ),
        ("error", "instancer-cycle", "/World/Many"),
    ),
}


@pytest.mark.parametrize("name", SPOILERS)
def test_what_is_wrong_is_found(shot: Shot, name: str) -> None:
    spoil, expected = SPOILERS[name]
    spoil(shot)
    assert expected in shot.codes()


@pytest.mark.parametrize("name", SPOILERS)
def test_nothing_else_is_found_but_the_consequences(shot: Shot, name: str) -> None:
    """One cause gives findings at its own prim, or USD's about the same file."""
    spoil, (_, _, path) = SPOILERS[name]
    spoil(shot)
    allowed = {path, "/", "/World/Light" if name == "no such map" else path}
    assert {found[2] for found in shot.codes()} <= allowed


def test_a_missing_file_of_ours_is_found_once(shot: Shot) -> None:
    (shot.folder / "light.exr").unlink()
    assert [item.code for item in shot.findings()] == ["file-not-found"]


@pytest.mark.parametrize(
    ("normalization", "bound"), [("paper", 1 / (0.5 * (1 + 1.5 * 0.8))), ("energy", 1 / 0.9)]
)
def test_the_furnace_bound_counts_the_wrap_as_it_is_normalized(
    shot: Shot, normalization: str, bound: float
) -> None:
    """With S = 0.5, l = 0.5, Ss = 0.8: 1.1 alpha as the paper prints it, 0.9 alpha normalised."""
    skin = shot.skin
    skin.GetAttribute("inputs:skin:wrap").Set(0.5)
    skin.GetAttribute("inputs:skin:wrapNormalization").Set(normalization)
    write_spectrum(skin, "scattering", spectrum(SpectralQuantity.SCATTERING, 0.8))
    for alpha in (min(1.0, bound) - 1e-4, 1.0):
        skin.GetAttribute("inputs:skin:alpha").Set(alpha)
        found = [item.code for item in shot.findings()]
        assert found == (["gains-energy"] if alpha > bound else [])


def test_negative_radiance_is_counted(shot: Shot) -> None:
    pixels = np.full((4, 8), 0.5, np.float32)
    pixels[1, 2:5] = -2.0
    other = np.full((4, 8), 0.5, np.float32)
    write_exr(shot.folder / "light.exr", [Part("", {"c0": pixels, "c1": other})])
    (found,) = shot.findings()
    assert (found.severity, found.code) == ("warning", "bad-pixels")
    assert "in 3 of 32 pixels" in found.message


def test_negative_coefficients_with_positive_radiance_are_sound(shot: Shot) -> None:
    """0.5 * (1, 2, 3) - 0.5 * (0.5, 0.5, 0.5) stays above 0."""
    first = np.full((4, 8), 0.5, np.float32)
    write_exr(shot.folder / "light.exr", [Part("", {"c0": first, "c1": -first})])
    assert shot.findings() == []


def test_a_spectral_map_is_looked_into(shot: Shot) -> None:
    light = shot.light
    light.GetAttribute("inputs:spectral:source").Set("bands")
    light.GetAttribute("inputs:spectral:bands:file").Set("./bands.exr")
    pixels = np.ones((4, 8, 3), np.float32)
    pixels[0, 0, 1] = np.nan
    write_spectral_exr(shot.folder / "bands.exr", np.array(WAVELENGTHS), pixels, pixels)
    (found,) = shot.findings()
    assert "inputs:spectral:bands:file has negative or non-finite radiance in 1 of 32" in str(found)
    (shot.folder / "bands.exr").write_bytes((shot.folder / "rgb.exr").read_bytes())
    (found,) = shot.findings()
    assert found.code == "unreadable-file"


@pytest.mark.parametrize(
    ("size", "token", "fault"),
    [
        ((8, 8), "automatic", "8 x 8 pixels are not twice as wide as high"),
        ((8, 8), "angular", "inputs:texture:format is angular"),
        ((8, 8), "latlong", ""),
        ((1, 1), "automatic", ""),
        ((8, 16), "automatic", ""),
    ],
)
def test_a_dome_whose_map_is_not_latlong_is_found(
    shot: Shot, size: tuple[int, int], token: str, fault: str
) -> None:
    light = shot.light
    light.GetAttribute("inputs:spectral:source").Set("rgb")
    UsdLux.DomeLight(light).CreateTextureFormatAttr(token)
    image = {name: np.ones(size, np.float32) for name in "RGB"}
    write_exr(shot.folder / "rgb.exr", [Part("", image)])
    found = shot.findings()
    assert [item.code for item in found] == ["not-latlong"] * bool(fault)
    assert not fault or fault in str(found[0])


def test_an_unknown_illuminant_is_found(shot: Shot) -> None:
    shot.light.GetAttribute("inputs:spectral:source").Set("rgb")
    shot.light.GetAttribute("inputs:spectral:illuminant").Set("D66x")
    (found,) = shot.findings()
    assert found.code == "unknown-illuminant"


def test_an_illuminant_file_that_is_no_spectrum_is_found(shot: Shot) -> None:
    (shot.folder / "lamp.csv").write_text("500,1\n400,1\n")
    shot.light.GetAttribute("inputs:spectral:source").Set("rgb")
    shot.light.GetAttribute("inputs:spectral:illuminant:file").Set("./lamp.csv")
    (found,) = shot.findings()
    assert found.code == "unknown-illuminant"
    assert found.message.startswith("inputs:spectral:illuminant:file ")


def open_the_mesh(shot: Shot) -> None:
    shot.mesh.GetFaceVertexCountsAttr().Set(CUBE_COUNTS[:-1])
    shot.mesh.GetFaceVertexIndicesAttr().Set(CUBE_INDICES[:-4])


def test_an_open_mesh_of_opaque_skin_needs_a_thickness(shot: Shot) -> None:
    open_the_mesh(shot)
    assert shot.findings() == []
    shot.skin.GetAttribute("inputs:skin:opacity").Set(300.0)
    (found,) = shot.findings()
    assert (found.severity, found.code, found.path) == ("warning", "open-mesh", "/World/Head")
    assert "(4 open edges)" in found.message
    shot.skin.GetAttribute("inputs:skin:thickness").Set(0.002)
    assert shot.findings() == []


def test_a_spectral_opacity_needs_a_thickness_too(shot: Shot) -> None:
    open_the_mesh(shot)
    write_spectrum(shot.skin, "opacity", spectrum(SpectralQuantity.ABSORPTION, 300.0))
    assert shot.codes() == [("warning", "open-mesh", "/World/Head")]


def test_a_thickness_primvar_will_do(shot: Shot) -> None:
    open_the_mesh(shot)
    shot.skin.GetAttribute("inputs:skin:opacity").Set(300.0)
    primvars = UsdGeom.PrimvarsAPI(shot.mesh)
    primvars.CreatePrimvar("skin:thickness", Sdf.ValueTypeNames.Float).Set(0.002)
    assert shot.findings() == []


def test_a_closed_mesh_needs_no_thickness(shot: Shot) -> None:
    shot.skin.GetAttribute("inputs:skin:opacity").Set(300.0)
    assert shot.findings() == []


def test_a_skin_on_part_of_an_open_mesh_is_found(shot: Shot) -> None:
    open_the_mesh(shot)
    shot.skin.GetAttribute("inputs:skin:opacity").Set(300.0)
    binding = UsdShade.MaterialBindingAPI(shot.mesh)
    binding.UnbindAllBindings()
    subset = binding.CreateMaterialBindSubset("part", [0, 1])
    UsdShade.MaterialBindingAPI.Apply(subset.GetPrim()).Bind(UsdShade.Material(shot.skin))
    assert ("warning", "open-mesh", "/World/Head") in shot.codes()


def test_a_recovery_has_the_wavelengths_of_its_camera(shot: Shot) -> None:
    camera = UsdGeom.Camera.Define(shot.stage, "/World/Camera").GetPrim()
    camera.ApplyAPI("SpectralCameraAPI")
    camera.ApplyAPI("SpectralRecoveryAPI", "tube")
    camera.GetAttribute("spectral:wavelengths").Set(WAVELENGTHS)
    camera.GetAttribute("recovery:tube:matrix").Set([1.0] * 9)
    assert shot.findings() == []
    camera.GetAttribute("recovery:tube:matrix").Set([1.0] * 6)
    (found,) = shot.findings()
    assert "recovery:tube:matrix has 6 values but spectral:wavelengths 3" in found.message


def test_what_instances_share_is_found_once(shot: Shot) -> None:
    asset = shot.folder / "asset.usda"
    asset.write_text(
        '#usda 1.0\n(\n  defaultPrim = "A"\n)\ndef Xform "A" {\n  def Material "M" (\n'
        '    apiSchemas = ["SkinMaterialAPI"]\n  ) {\n    float inputs:skin:alpha = 2\n  }\n}\n'
    )
    for index in range(3):
        prim = shot.stage.DefinePrim(f"/World/I{index}")
        prim.GetReferences().AddReference("./asset.usda")
        prim.SetInstanceable(True)
    assert shot.codes() == [("error", "out-of-range", "/World/I0/M")]


def test_validation_prints_nothing(shot: Shot, capfd: pytest.CaptureFixture[str]) -> None:
    shot.light.AddAppliedSchema("SpectralDistributionAPI")
    shot.light.GetAttribute("inputs:texture:file").Set("./nope.exr")
    shot.stage.Save()
    capfd.readouterr()
    assert validate(shot.path)
    assert capfd.readouterr() == ("", "")


VALIDATE_ALL = """
import sys
from usdskin.errors import LayerError
from usdskin.validate import validate
for path in sys.argv[1:]:
    print("begin", path, flush=True)
    try:
        print(len(validate(path)), "found", flush=True)
    except LayerError as error:
        print("refused", flush=True)
"""


@pytest.mark.realdata
def test_malformed_stages_are_validated_without_a_crash(realdata: Path) -> None:
    folders = [realdata / "malformed" / name for name in ("synthetic", "openusd_usdchecker_bad")]
    files = sorted(p for f in folders for p in f.iterdir() if p.suffix.startswith(".usd"))
    done = subprocess.run(
        [sys.executable, "-c", VALIDATE_ALL, *map(str, files)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (4 << 30, 4 << 30)),
    )
    assert done.returncode == 0, f"{done.stdout.splitlines()[-2:]}: {done.stderr}"
    assert done.stdout.count("found") + done.stdout.count("refused") == len(files)


def test_a_light_that_cannot_have_its_place_is_found(shot: Shot) -> None:
    lamp = UsdLux.DiskLight.Define(shot.stage, "/World/Lamp")
    lamp.CreateExtentAttr([(-0.5, -0.5, 0), (0.5, 0.5, 0)])
    assert shot.codes() == []
    lamp.AddScaleOp().Set(Gf.Vec3f(1.0, 2.0, 1.0))
    (found,) = shot.findings()
    assert (found.severity, found.path) == ("error", "/World/Lamp")
    assert "unevenly" in found.message


def test_a_light_without_power_is_found(shot: Shot) -> None:
    bulb = UsdLux.SphereLight.Define(shot.stage, "/World/Bulb")
    bulb.CreateExtentAttr([(0, 0, 0), (0, 0, 0)])
    bulb.CreateRadiusAttr(0.0)
    assert shot.codes() == [("warning", "light-without-area", "/World/Bulb")]
    bulb.CreateNormalizeAttr(True)
    assert shot.codes() == []


def test_a_lost_or_broken_profile_is_found(shot: Shot) -> None:
    bulb = UsdLux.SphereLight.Define(shot.stage, "/World/Bulb")
    bulb.CreateExtentAttr([(-0.5, -0.5, -0.5), (0.5, 0.5, 0.5)])
    UsdLux.ShapingAPI.Apply(bulb.GetPrim()).CreateShapingIesFileAttr("./lamp.ies")
    (found,) = shot.findings()
    assert found.severity == "error" and "lamp.ies" in found.message
    (shot.folder / "lamp.ies").write_text("IESNA:LM-63-2002\nTILT=NONE\n1 1 1 2 x\n")
    (found,) = shot.findings()
    assert found.severity == "error" and "lamp.ies:3" in found.message
