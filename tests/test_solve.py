"""The truth about a virtual set: closed forms, energy, lamps, errors, the command."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from set_stages import (
    NM,
    add_bulb,
    add_lamp,
    add_paint,
    add_room,
    add_surface,
    new_set,
)

from usdskin.cli import main
from usdskin.errors import LayerError
from usdskin.judge.truth import lamps as set_lamps
from usdskin.judge.truth.panorama import see
from usdskin.judge.truth.polygons import projected_solid_angle
from usdskin.judge.truth.radiosity import bounce, make_model, place, solve
from usdskin.judge.truth.sets import read_set
from usdskin.judge.truth.solve import solve_set
from usdskin.latlong import texel_directions, texel_solid_angles
from usdskin.render.lights import read_lights

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdLux

STAGES = Path(__file__).resolve().parents[1] / "stages"


def scene_of(stage: Usd.Stage, path: Path):
    stage.Save()
    return read_set(path, NM, [])


# --- Closed forms ------------------------------------------------------------------------------


def test_square_above_a_point_has_the_form_factor_of_the_textbook():
    """Howell, catalogue of configuration factors, B-3: a corner of a rectangle above the point."""
    a, b, c = 0.7, 1.3, 0.9
    corners = np.array([[0, 0, c], [a, 0, c], [a, b, c], [0, b, c]], float)
    found = projected_solid_angle(corners[None], np.array([[0.0, 0.0, 1.0]]))[0] / np.pi
    x, y = a / c, b / c
    expected = x / np.sqrt(1 + x**2) * np.arctan(y / np.sqrt(1 + x**2))
    expected += y / np.sqrt(1 + y**2) * np.arctan(x / np.sqrt(1 + y**2))
    assert found == pytest.approx(expected / (2 * np.pi), rel=1e-12)


def test_polygon_that_crosses_the_horizon_counts_above_it_only():
    """Half a square below the horizon changes nothing."""
    upper = np.array([[1, -1, 0], [1, 1, 0], [1, 1, 2], [1, -1, 2]], float)
    whole = upper.copy()
    whole[:2, 2] = -3.0
    normal = np.array([0.0, 0.0, 1.0])
    assert projected_solid_angle(whole, normal) == pytest.approx(
        projected_solid_angle(upper, normal), rel=1e-12
    )


def test_small_lamp_over_a_floor_gives_intensity_times_cos_cubed_over_h_squared(tmp_path: Path):
    stage = new_set(tmp_path / "set.usda")
    add_paint(stage, "paint", 0.5)
    floor = [(-9, 0, 9), (9, 0, 9), (9, 0, -9), (-9, 0, -9)]
    add_surface(stage, "floor", "paint", floor)
    add_bulb(stage, (0.0, 2.0, 0.0), radius=0.002)
    scene = scene_of(stage, tmp_path / "set.usda")
    model = make_model(scene, 60)
    points = np.array([[0.0, 0, 0], [1.5, 0, 0], [3.0, 0, -2.0]])
    factors = model.sources.factors(model.blockers, 0, points, "sharp")
    cosine = 2.0 / np.linalg.norm(points - [0, 2, 0], axis=1)
    expected = np.pi * 0.002**2 * cosine**3 / 4.0
    np.testing.assert_allclose(factors[:, 0], expected, rtol=1e-5)


def test_lamps_of_every_kind_match_quadrature_over_their_surface(tmp_path: Path):
    """Irradiance by outline and by summing cos cos' dA / r^2 over what shines; also behind."""
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.5, (4.0, 4.0, 4.0))
    lamps = {
        "tube": UsdLux.CylinderLight.Define(stage, "/Set/Lights/a/tube"),
        "panel": UsdLux.RectLight.Define(stage, "/Set/Lights/a/panel"),
        "disk": UsdLux.DiskLight.Define(stage, "/Set/Lights/a/disk"),
    }
    lamps["tube"].CreateLengthAttr(1.1)
    lamps["tube"].CreateRadiusAttr(0.15)
    lamps["panel"].CreateWidthAttr(0.8)
    lamps["panel"].CreateHeightAttr(0.3)
    lamps["disk"].CreateRadiusAttr(0.4)
    for lamp in lamps.values():
        lamp.AddRotateXYZOp().Set(Gf.Vec3f(20, 35, -50))
        add_lamp(stage, lamp)
    stage.Save()
    lights = read_lights(stage, Usd.TimeCode.Default(), NM, places=True)
    read = {lamp.path.rpartition("/")[2]: lamp for lamp in lights.locals}
    points = np.array([[0.9, -0.8, -1.1], [-1.2, 0.3, -0.9], [0.2, 1.5, 0.4]])
    normals = -points / np.linalg.norm(points, axis=1, keepdims=True)
    for name, lamp in read.items():
        spots, facing, area = dense(lamp)
        away = spots[None] - points[:, None]
        square = (away**2).sum(axis=-1)
        given = np.maximum(np.einsum("pts,ps->pt", away, normals), 0.0)
        given *= np.maximum(-np.einsum("pts,ts->pt", away, facing), 0.0) / square**2
        found = set_lamps.irradiance_factor(lamp, points, normals)
        np.testing.assert_allclose(found, (given * area).sum(axis=1), rtol=3e-3, atol=1e-9)
        assert found.max() > 0.0, name


def dense(lamp) -> tuple[np.ndarray, np.ndarray, float]:
    """Points all over what shines, their normals, and the area of each."""
    a, b = lamp.half
    n = 400
    s, t = (part.ravel() for part in np.meshgrid(*[(np.arange(n) + 0.5) / n] * 2))
    x, y, z = lamp.axes
    if lamp.kind == "cylinder":
        out = np.outer(np.cos(2 * np.pi * t), y) + np.outer(np.sin(2 * np.pi * t), z)
        spots = lamp.center + np.outer(a * (2 * s - 1), x) + b * out
        return spots, out, 4 * np.pi * a * b / s.size
    if lamp.kind == "rect":
        spots = lamp.center + np.outer(a * (2 * s - 1), x) + np.outer(b * (2 * t - 1), y)
        return spots, np.broadcast_to(-z, spots.shape), 4 * a * b / s.size
    r = a * np.sqrt(s)
    spots = lamp.center + np.outer(r * np.cos(2 * np.pi * t), x)
    spots = spots + np.outer(r * np.sin(2 * np.pi * t), y)
    return spots, np.broadcast_to(-z, spots.shape), np.pi * a * a / s.size


def factors_of(scene, cells: int):
    from usdskin.judge.truth import radiosity

    model = make_model(scene, cells)
    # Lamps stop light between surfaces.
    model = replace(model, sources=replace(model.sources, lamps=()))
    blocks = [radiosity._exchange(model, index) for index in range(model.surface_count)]
    return model, radiosity.balanced(np.concatenate(blocks), model.area)


@pytest.mark.parametrize("reflectance", [0.2, 0.9])
def test_white_furnace_has_emission_over_absorptance(tmp_path: Path, reflectance: float):
    """Walls of emission e and reflectance rho everywhere: radiance e / (1 - rho)."""
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, reflectance, (1.0, 2.0, 0.7))
    add_bulb(stage)
    model, factors = factors_of(scene_of(stage, tmp_path / "set.usda"), 100)
    rho = np.full((model.cells.count, 1), reflectance)
    radiosity = bounce(factors, rho, np.ones_like(rho) / rho)
    np.testing.assert_allclose(radiosity, 1.0 / (1.0 - reflectance), rtol=1e-7)


def test_form_factors_between_walls_of_a_cube_are_a_fifth(tmp_path: Path):
    """Opposite faces 0.19982 (Howell, C-11), adjacent ones the rest; exchange is mutual."""
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.5)
    add_bulb(stage)
    model, factors = factors_of(scene_of(stage, tmp_path / "set.usda"), 150)
    exchange = model.area[:, None] * factors
    np.testing.assert_allclose(exchange, exchange.T, atol=1e-15)
    faces = np.zeros((6, 6))
    surface = model.cells.surface
    np.add.at(faces, (surface[:, None], surface[None]), exchange)
    faces /= 4.0
    opposite = [faces[0, 1], faces[2, 3], faces[4, 5]]
    np.testing.assert_allclose(opposite, 0.199825, rtol=3e-3)
    np.testing.assert_allclose(faces.sum(axis=1), 1.0, rtol=1e-12)


def test_cube_with_a_bulb_has_the_mean_irradiance_of_its_energy(tmp_path: Path):
    """Flux Phi in a closed room of reflectance rho: E A (1 - rho) = Phi."""
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.6)
    add_bulb(stage, radius=0.001)
    scene = scene_of(stage, tmp_path / "set.usda")
    model = make_model(scene, 160)
    solutions, is_closed = solve(model)
    solution = solutions["bulbs"]
    assert is_closed
    flux = 4 * np.pi**2 * 0.001**2 * 10.0
    np.testing.assert_allclose(solution.balance.emitted, flux, rtol=1e-6)
    np.testing.assert_allclose(solution.balance.absorbed, flux, rtol=1e-3)
    mean = model.area @ solution.radiosity / (0.6 * model.area.sum())
    np.testing.assert_allclose(mean, flux / (24.0 * 0.4), rtol=2e-3)


# --- What is seen ------------------------------------------------------------------------------


def test_even_sky_lights_a_floor_by_pi(tmp_path: Path):
    """Irradiance pi L; radiance rho L; above the horizon L itself."""
    stage = new_set(tmp_path / "set.usda")
    add_paint(stage, "paint", 0.4)
    floor = [(-90, -1, 90), (90, -1, 90), (90, -1, -90), (-90, -1, -90)]
    add_surface(stage, "floor", "paint", floor)
    add_lamp(stage, UsdLux.DomeLight.Define(stage, "/Set/Lights/sky/dome"), 3.0)
    scene = scene_of(stage, tmp_path / "set.usda")
    model = make_model(scene, 100)
    solutions, is_closed = solve(model)
    picture = see(model, solutions, 16).classes["sky"]
    assert not is_closed
    np.testing.assert_allclose(picture[:7], 3.0, rtol=1e-6)
    np.testing.assert_allclose(picture[9:], 1.2, rtol=1e-6)


def test_lamps_in_the_picture_have_their_solid_angles(tmp_path: Path):
    """Within 0.1 %, however thin; and what the panorama holds is in the right place."""
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.3, (2.0, 1.5, 2.0))
    tube = UsdLux.CylinderLight.Define(stage, "/Set/Lights/tubes/tube")
    tube.CreateLengthAttr(1.2)
    tube.CreateRadiusAttr(0.013)
    tube.AddTranslateOp().Set(Gf.Vec3d(0.5, 1.2, 0.9))
    add_lamp(stage, tube)
    add_bulb(stage, (-1.1, 0.2, 0.4))
    scene = scene_of(stage, tmp_path / "set.usda")
    model = make_model(scene, 60)
    seen = see(model, solve(model)[0], 64)
    size = texel_solid_angles(64, 128)[:, None]
    for lamp, cover in zip(model.scene.lamps, seen.lamp_cover, strict=True):
        true = set_lamps.solid_angle(lamp, np.zeros(3))
        assert (cover * size).sum() == pytest.approx(true, rel=1e-3)
        middle = (cover * size)[..., None] * texel_directions(64, 128)
        middle = middle.sum(axis=(0, 1)) / np.linalg.norm(middle.sum(axis=(0, 1)))
        towards = lamp.center / np.linalg.norm(lamp.center)
        assert middle @ towards > 0.99


def test_corners_of_cells_and_rays_tell_the_same_irradiance(tmp_path: Path):
    """In an empty room, finer cells change what is seen by less than 0.5 % in the mean."""
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.6, (1.5, 1.2, 2.0))
    add_bulb(stage, radius=0.1)
    scene = scene_of(stage, tmp_path / "set.usda")
    pictures = []
    for cells in (120, 360):
        model = make_model(scene, cells)
        pictures.append(see(model, solve(model)[0], 12).classes["bulbs"][..., 0])
    ratio = pictures[0] / pictures[1]
    assert abs(ratio.mean() - 1.0) < 5e-3
    assert np.abs(ratio - 1.0).max() < 5e-2


def test_place_runs_along_the_edges(tmp_path: Path):
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.6)
    add_bulb(stage)
    model = make_model(scene_of(stage, tmp_path / "set.usda"), 60)
    middle = place(model.blockers, 3, np.array([0.5]), np.array([0.5]))
    np.testing.assert_allclose(middle, [[0.0, 1.0, 0.0]], atol=1e-12)
    np.testing.assert_allclose(model.blockers.normal[3], [0.0, -1.0, 0.0], atol=1e-12)


# --- The step and its errors -------------------------------------------------------------------


@pytest.fixture
def room(tmp_path: Path) -> Path:
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.5)
    add_bulb(stage)
    add_bulb(stage, (-0.5, 0.1, 0.6), kind="lanterns")
    stage.Save()
    return tmp_path / "set.usda"


def test_classes_add_up_to_the_light(room: Path, tmp_path: Path):
    solved = solve_set(
        room, tmp_path / "truth" / "light.usda", height=16, cells=60, wavelength_nm=NM
    )
    assert sorted(solved.classes) == ["bulbs", "lanterns"]
    total = radiance_of(solved.light)
    parts = sum(radiance_of(path) for path in solved.classes.values())
    np.testing.assert_allclose(parts, total, atol=2e-4 * total.max(), rtol=1e-3)
    assert max(abs(value) for value in solved.report.balance.values()) < 2e-3


def radiance_of(path: Path) -> np.ndarray:
    from usdskin.layers import open_stage

    (dome,) = read_lights(open_stage(path), Usd.TimeCode.Default(), NM).domes
    return dome.coefficients @ dome.basis


def test_solving_twice_gives_the_same_files(room: Path, tmp_path: Path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "0")
    written = []
    for name in ("a", "b"):
        solved = solve_set(
            room, tmp_path / name / "light.usda", height=8, cells=60, wavelength_nm=NM
        )
        written.append([path.read_bytes() for path in solved.paths])
    assert written[0] == written[1]


def test_command_writes_a_light_that_validates(room: Path, tmp_path: Path, capsys):
    output = tmp_path / "truth" / "light.usda"
    assert (
        main(["-q", "solve", str(room), "-o", str(output), "--height", "8", "--cells", "60"]) == 0
    )
    printed = capsys.readouterr().out.split()
    assert [Path(line).name for line in printed[:3]] == [
        "light.usda", "light.coefficients.exr", "light.rgb.exr",
    ]  # fmt: skip
    assert main(["validate", str(output)]) == 0


def test_sun_becomes_a_distant_light_with_its_irradiance(tmp_path: Path):
    stage = new_set(tmp_path / "set.usda")
    add_paint(stage, "paint", 0.4)
    add_surface(stage, "floor", "paint", [(-9, -1, 9), (9, -1, 9), (9, -1, -9), (-9, -1, -9)])
    sun = UsdLux.DistantLight.Define(stage, "/Set/Lights/sun/disc")
    sun.CreateAngleAttr(0.53)
    sun.AddRotateXOp().Set(-50.0)
    add_lamp(stage, sun, 1e5)
    stage.Save()
    solved = solve_set(
        tmp_path / "set.usda", tmp_path / "light.usda", height=16, cells=60, wavelength_nm=NM
    )
    given = read_lights(stage, Usd.TimeCode.Default(), NM).distants[0]
    found = read_lights(Usd.Stage.Open(str(solved.light)), Usd.TimeCode.Default(), NM)
    np.testing.assert_allclose(found.distants[0].irradiance, given.irradiance, rtol=1e-9)
    np.testing.assert_allclose(found.distants[0].direction, given.direction, atol=1e-9)
    floor = radiance_of(solved.light)[-1, :, 0]
    expected = 0.4 / np.pi * given.irradiance[0] * np.sin(np.radians(50.0))
    np.testing.assert_allclose(floor, expected, rtol=1e-4)


@pytest.mark.parametrize(
    ("spoil", "says"),
    [
        (lambda s: s.RemovePrim("/Set/CapturePoint"), "CapturePoint>: is missing"),
        (lambda s: add_paint(s, "paint", 1.0), "stay below 1"),
        (lambda s: bend(s), "is not planar, by"),
        (lambda s: move(s, (5.0, 0.0, 0.0)), "is seen from behind"),
        (lambda s: UsdLux.DiskLight.Define(s, "/Set/Lights/bulbs/plain"), "has no spectrum"),
        (lambda s: UsdLux.DiskLight.Define(s, "/Set/Lights/plain"), "/Set/Lights/<class>/<name>"),
        (lambda s: s.RemovePrim("/Set/Lights/bulbs"), "no light shines"),
        (lambda s: s.RemovePrim("/Set/Materials/paint"), "has no material"),
    ],
)
def test_set_that_cannot_be_solved_says_why(tmp_path: Path, spoil, says: str):
    stage = new_set(tmp_path / "set.usda")
    add_room(stage, 0.5)
    add_bulb(stage)
    spoil(stage)
    stage.Save()
    with pytest.raises(LayerError, match=r"set\.usda") as caught:
        solve_set(
            tmp_path / "set.usda", tmp_path / "light.usda", height=8, cells=60, wavelength_nm=NM
        )
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def bend(stage: Usd.Stage) -> None:
    points = UsdGeom.Mesh.Get(stage, "/Set/Surfaces/room").GetPointsAttr()
    values = list(points.Get())
    values[0] += Gf.Vec3f(0.05, 0.0, 0.0)
    points.Set(values)


def move(stage: Usd.Stage, place: tuple[float, float, float]) -> None:
    UsdGeom.Xform.Get(stage, "/Set/CapturePoint").AddTranslateOp().Set(Gf.Vec3d(*place))
