"""A new project is complete, correct and renders as it is."""

from __future__ import annotations

import numpy as np
import pytest

from usdskin.errors import UsageError, UsdSkinError
from usdskin.layers import open_stage
from usdskin.meshfiles import MeshFile, angle_weighted_normals
from usdskin.notes import Note
from usdskin.prims import read_skin
from usdskin.projects import TEMPLATES, _bend, _cube_sphere, new_project
from usdskin.render.lights import read_lights
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM

from pxr import Usd, UsdGeom, UsdRender, UsdValidation  # isort: skip


@pytest.fixture(params=TEMPLATES)
def project(request, tmp_path):
    return new_project(tmp_path / "shots" / "my head", request.param)


def test_project_has_a_stage_its_layers_and_a_readme(project):
    names = sorted(path.name for path in project.parent.iterdir())
    assert names == ["README.md", "light.usda", "shot.usda", "skin.usda", "subject.usda"]
    assert [path.name for path in project.parent.parent.iterdir()] == ["my head"]


def test_every_layer_stands_alone_and_passes_usds_validators(project):
    registry = UsdValidation.ValidationRegistry()
    for layer in sorted(project.parent.glob("*.usda")):
        stage = open_stage(layer)
        assert stage.GetDefaultPrim()
        context = UsdValidation.ValidationContext(registry.GetOrLoadAllValidators())
        found = [f"{layer.name}: {error.GetMessage()}" for error in context.Validate(stage)]
        assert found == []


def test_everything_in_the_shot_is_read_without_a_note(project):
    from usdskin.render.lights import read_lights
    from usdskin.render.materials import SkinMaterial, bound_material, read_materials

    stage = open_stage(project)
    notes: list[Note] = []
    time = Usd.TimeCode.Default()
    lights = read_lights(stage, time, DEFAULT_WAVELENGTHS_NM, notes=notes)
    assert len(lights.domes) == len(lights.distants) == 1
    # The lamp shines from up on the left, and from the camera's side.
    x, y, z = lights.distants[0].direction
    assert x < -0.3 and y > 0.3 and z > 0.3
    shapes = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Gprim)]
    assert len(shapes) == 1
    path = bound_material(shapes[0])
    assert path == "/World/Skin"
    assert isinstance(read_materials(stage, [path], time, notes)[path], SkinMaterial)
    settings = UsdRender.Settings.GetStageRenderSettings(stage)
    assert settings.GetCameraRel().GetTargets() == ["/World/Camera"]
    assert notes == []


def test_skin_reflects_no_more_than_it_receives(project):
    """alpha S (1 + (1 + l) Ss) <= 1 in every band: the furnace value of the paper's equation."""
    stage = open_stage(project)
    skin = read_skin(stage.GetPrimAtPath("/World/Skin"))
    reflected = skin.alpha * skin.reflectance.value
    reflected = reflected * (1.0 + (1.0 + skin.wrap) * skin.scattering.value)
    assert (reflected > 0.02).all() and (reflected <= 1.0).all()
    red = skin.reflectance.value[skin.reflectance.wavelength_nm == 650.0]
    assert red > 1.5 * skin.reflectance.value[skin.reflectance.wavelength_nm == 450.0]


def test_stand_in_bust_is_closed_and_turned_outwards():
    points, faces = _cube_sphere(8)
    assert len(points) - 2 * len(faces) + len(faces) == 2  # Euler: V - E + F, 2 edges a quad
    bust = _bend(points)
    assert np.ptp(bust, axis=0)[1] == pytest.approx(47.0, abs=0.5)
    mesh = MeshFile("bust", bust, np.full(len(faces), 4), faces.ravel())
    crown = int(np.argmax(bust[:, 1]))
    assert angle_weighted_normals(mesh)[crown][1] > 0.99
    corners = bust[faces]
    one, other = corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]
    volume = sum(
        np.einsum("ij,ij->", t[:, 0], np.cross(t[:, 1], t[:, 2])) / 6.0 for t in (one, other)
    )
    assert volume > 0.0


def test_empty_folder_is_filled(tmp_path):
    (tmp_path / "there").mkdir()
    assert new_project(tmp_path / "there", "sphere").is_file()


def test_folder_that_holds_something_is_refused_and_left_alone(tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(UsageError, match="is not empty"):
        new_project(tmp_path)
    with pytest.raises(UsageError, match="is a file"):
        new_project(tmp_path / "mine.txt")
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_unknown_template_is_refused(tmp_path):
    with pytest.raises(UsageError, match="choose one of portrait, sphere"):
        new_project(tmp_path / "a", "face")


def test_folder_that_cannot_be_made_is_an_error(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(UsdSkinError, match=r"cannot be written \(Not a directory\)"):
        new_project(tmp_path / "file" / "a")


@pytest.mark.slow
def test_project_renders_as_it_is(project, tmp_path, monkeypatch):
    from usdskin.cli import main
    from usdskin.images import read_image

    monkeypatch.chdir(tmp_path)
    assert main(["-q", "render", str(project), "-r", "32", "40"]) == 0
    pixels = read_image(tmp_path / "shot.exr").pixels
    assert (tmp_path / "shot.png").is_file()
    assert np.isfinite(pixels).all()
    subject = pixels[..., 3] == 1.0
    assert 0.1 < subject.mean() < 0.9
    red, _, blue = pixels[subject][:, :3].mean(axis=0)
    assert red > 1.5 * blue


def test_a_light_of_any_kind_takes_the_place_of_the_projects_own(tmp_path):
    """What `usdskin estimate light` writes is a DomeLight by itself."""
    shot = new_project(tmp_path / "head")
    (shot.parent / "light.usda").write_text(
        '#usda 1.0\n(\n    defaultPrim = "Sky"\n    metersPerUnit = 1\n    upAxis = "Y"\n)\n'
        'def DomeLight "Sky" (prepend apiSchemas = ["SpectralLightAPI"])\n'
        '{\n    uniform token inputs:spectral:source = "blackbody"\n}\n'
    )
    lights = read_lights(open_stage(shot), Usd.TimeCode.Default(), DEFAULT_WAVELENGTHS_NM)
    assert [light.path for light in lights.domes] == ["/World/Light"]
    assert not lights.distants
