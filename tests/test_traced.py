"""Laws of the traced integrator: what shadowed pictures must be, by hand and by symmetry."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from traced_scenes import (
    BASIS,
    NM,
    Body,
    add_body,
    add_dome,
    add_view,
    box,
    cup,
    lamp_room,
    new_stage,
    ready,
    sheet,
    soft_room,
    sphere,
    torus,
)

from usdskin.device import Workers
from usdskin.render import traced
from usdskin.render import traced_passes as passes
from usdskin.render.render import ERROR_FLOOR
from usdskin.render.scene import mean_white

# isort: split
from pxr import Gf, UsdGeom, UsdLux

OFF = np.array([2.0, 1.0, -1.5])
UNIFORM = np.ones((8, 16, 1))


def view_of(folder, bodies, light, size=16, width=2.4, toward=OFF, origin=(0.4, 1.0, 4.0)):
    """A picture of bodies, the first of them around ``OFF``, under a dome."""
    stage = new_stage()
    for k, body in enumerate(bodies):
        add_body(stage, body, f"Body{k}")
    add_dome(stage, folder, light, BASIS[: light.shape[2]] if light.shape[2] > 1 else None)
    add_view(stage, toward + np.asarray(origin), toward, width)
    return ready(stage, size)


def skin_sphere(rows=16, columns=32, smooth=True, **looks):
    points, faces, normals = sphere(rows, columns)
    return Body(points=points + OFF, faces=faces, normals=normals if smooth else None, **looks)


def seen_by(view):
    """Where no sample sees the background, nor a neighbour's."""
    seen = view.traced(16).xyza[..., 3] > 0.99999
    around = np.pad(seen, 1)
    for shift in ((0, 1), (2, 1), (1, 0), (1, 2), (0, 0), (0, 2), (2, 0), (2, 2)):
        seen = seen & around[shift[0] :, shift[1] :][: len(seen), : len(seen)]
    return seen


# --- Furnaces ------------------------------------------------------------------------------------


def test_a_white_convex_body_vanishes_in_a_white_furnace(tmp_path):
    view = view_of(tmp_path, [skin_sphere(alpha=0.7)], UNIFORM)
    found = view.spectra(16)[seen_by(view)]
    np.testing.assert_allclose(found, 0.7, rtol=2e-5)


@pytest.mark.parametrize("wrap", [0.0, 0.3, 1.0])
def test_an_opaque_convex_body_loses_the_wrapped_light_from_behind(tmp_path, wrap):
    """alpha (1 + Ss h): h = (1/pi) Int_{N.L > 0} (N.L + l)/(1 + l) dL = (1 + 2 l)/(1 + l).

    Flat facets, for which no direction with N.L > 0 enters the body.
    """
    body = skin_sphere(smooth=False, alpha=0.6, wrap=wrap, scattering=0.5, delta=1e5)
    view = view_of(tmp_path, [body], UNIFORM)
    found = view.spectra(256)[seen_by(view)]
    exact = 0.6 * (1.0 + 0.5 * (1.0 + 2.0 * wrap) / (1.0 + wrap))
    assert abs(found.mean() / exact - 1.0) < 5e-4
    assert abs(np.median(found) / exact - 1.0) < 2e-5


@pytest.mark.parametrize("away", [0.0, 100.0])
@pytest.mark.parametrize("rows", [8, 32, 128, pytest.param(512, marks=pytest.mark.slow)])
def test_no_light_leaks_past_the_horizon_whatever_the_facets(tmp_path, rows, away):
    points, faces, _ = sphere(rows, 2 * rows)
    body = Body(points=points + away, faces=faces, wrap=0.3, scattering=1.0, delta=1e9)
    view = view_of(tmp_path, [body], UNIFORM, 16, 1.2, np.full(3, away))
    found = view.spectra(64)
    assert abs(found.mean() / (1.0 + 1.6 / 1.3) - 1.0) < 1e-3


def test_a_clear_body_in_a_furnace_has_the_whole_wrap_term(tmp_path):
    """alpha (1 + Ss (1 + l)), at any number of samples and also by smooth normals."""
    body = skin_sphere(4, 8, wrap=0.3, alpha=0.6, scattering=0.5)
    view = view_of(tmp_path, [body], UNIFORM)
    np.testing.assert_allclose(view.spectra(4)[seen_by(view)], 0.6 * 1.65, rtol=2e-5)


# --- Nothing in the way: the map -----------------------------------------------------------------


@pytest.mark.parametrize("smooth", [True, False])
@pytest.mark.parametrize("light", [soft_room(16), lamp_room(32)], ids=["soft", "lamp"])
def test_a_clear_convex_body_is_the_map_at_every_pixel(tmp_path, smooth, light):
    """Without noise, also where a coarse sphere's smooth normals disagree with its facets."""
    body = skin_sphere(5, 8, smooth=smooth, scattering=0.6)
    view = view_of(tmp_path, [body], light, width=1.1)
    same = seen_by(view)
    assert same.mean() > 0.7
    # Both put samples at the same places; the map shades those on one triangle together.
    for samples, bound in ((1, 1e-6), (16, 1e-3)):
        found, map_ = view.spectra(samples), view.mapped(samples)
        assert np.abs(found - map_)[same].max() < bound * map_.max()


def test_the_lustre_of_a_body_nobody_shades_is_not_dimmed_by_the_clear_body(tmp_path):
    looks = {"weight": 1.0, "roughness1": 0.5, "roughness2": 0.5}
    clear = view_of(tmp_path, [skin_sphere(specular=looks)], soft_room(16))
    thick = view_of(tmp_path, [skin_sphere(specular=looks, delta=1e5)], soft_room(16))
    inner = seen_by(clear)
    a = clear.traced(256).extra["specular"][inner].mean(axis=0)
    b = thick.traced(256).extra["specular"][inner].mean(axis=0)
    np.testing.assert_allclose(a, b, rtol=5e-3)


# --- The way through a body ----------------------------------------------------------------------


def below(polar_deg, height=128):
    """A dome with one small lamp, ``polar_deg`` from straight below, towards -z."""
    found = np.zeros((height, 2 * height, 1))
    i = min(int((180.0 - polar_deg) / 180.0 * height), height - 1)
    found[i, 2] = 1e3
    polar = np.pi * (i + 0.5) / height
    turn = 2.0 * np.pi * 2.5 / (2 * height)
    toward = [np.sin(polar) * np.sin(turn), np.cos(polar), -np.sin(polar) * np.cos(turn)]
    angle = np.pi / height * (np.cos(np.pi * i / height) - np.cos(np.pi * (i + 1) / height))
    return found, np.array(toward), 1e3 * angle


def slab(thickness, **looks):
    points, faces = box([-2.0, -thickness, -2.0], [2.0, 0.0, 2.0])
    return Body(points=points + OFF, faces=faces, wrap=1.0, scattering=1.0, **looks)


DELTA = (2.0, 20.0, 60.0, 150.0, 400.0)


@pytest.mark.parametrize("polar_deg", [25.0, 50.0, 75.0])
@pytest.mark.parametrize("delta", [30.0, DELTA], ids=["scalar", "spectral"])
def test_light_through_a_slab_is_weakened_by_its_thickness(tmp_path, polar_deg, delta):
    """alpha/pi Phi Ss (N.L + l)/(1 + l) exp(-d delta / |N.L|), to 1e-3 of the peak per band."""
    light, toward, flux = below(polar_deg)
    for thickness in (0.003, 0.03):
        view = view_of(tmp_path, [slab(thickness, delta=delta)], light, size=4, width=0.02)
        found = view.spectra(64).mean(axis=(0, 1))
        wrapped = (toward[1] + 1.0) / 2.0
        way = thickness / -toward[1]
        exact = flux / np.pi * wrapped * np.exp(-way * np.asarray(delta) * np.ones(len(NM)))
        assert np.abs(found - exact).max() < 1e-3 * flux / np.pi * wrapped + 2e-3 * exact.max()


def test_any_opacities_are_weakened_to_a_thousandth_of_the_peak(tmp_path):
    """Blood: a factor of a thousand between the bands."""
    delta = np.array([2000.0, 150.0, 15.0, 4.0, 1.5])
    light, toward, flux = below(40.0)
    scale = flux / np.pi * (toward[1] + 1.0) / 2.0
    for thickness in (4.5e-5, 5e-4, 3e-3, 0.02, 0.1, 0.5):
        body = slab(thickness, delta=tuple(delta))
        view = view_of(tmp_path, [body], light, size=4, width=0.02)
        found = view.spectra(64).mean(axis=(0, 1)) / scale
        assert np.abs(found - np.exp(-thickness * delta / -toward[1])).max() < 1e-3


def test_another_body_blocks_what_the_own_one_would_let_through(tmp_path):
    light, _, flux = below(40.0)
    other = replace(slab(0.01, delta=30.0), points=slab(0.01).points - [0.0, 0.05, 0.0])
    view = view_of(tmp_path, [slab(0.01, delta=30.0), other], light, size=4, width=0.02)
    assert np.abs(view.spectra(64)).max() < 1e-6 * flux


def test_ways_inside_one_body_add_up(tmp_path):
    """A slab with a hollow in it, and a second shell of the same body below: 3 x 0.01 m."""
    outer = box([-50.0, -0.05, -50.0], [50.0, 0.0, 50.0])
    hollow = box([-40.0, -0.04, -40.0], [40.0, -0.02, 40.0])
    lower = box([-50.0, -0.07, -50.0], [50.0, -0.06, 50.0])
    parts = [outer, (hollow[0], hollow[1][:, ::-1]), lower]
    points, faces, first = [], [], 0
    for corner, triangles in parts:
        points.append(corner)
        faces.append(triangles + first)
        first += len(corner)
    body = Body(
        points=np.concatenate(points) + OFF, faces=np.concatenate(faces), wrap=1.0,
        scattering=1.0, delta=DELTA,
    )  # fmt: skip
    light, toward, flux = below(40.0)
    found = view_of(tmp_path, [body], light, size=4, width=0.02).spectra(64).mean(axis=(0, 1))
    exact = flux / np.pi * (toward[1] + 1.0) / 2.0 * np.exp(0.04 / toward[1] * np.array(DELTA))
    assert np.abs(found - exact).max() < 2e-3 * flux / np.pi


def test_what_enters_an_open_mesh_and_never_leaves_is_blocked(tmp_path):
    """A sheet lit from behind is black whatever its opacity; a clear one has no inside."""
    light, toward, flux = below(40.0)
    points, faces = sheet(100.0)
    body = Body(points=points + OFF, faces=faces, wrap=1.0, scattering=1.0, delta=0.01)
    assert np.abs(view_of(tmp_path, [body], light, 4, 0.02).spectra(64)).max() == 0.0
    clear = view_of(tmp_path, [replace(body, delta=0.0)], light, 4, 0.02).spectra(64)
    np.testing.assert_allclose(clear, flux / np.pi * (toward[1] + 1.0) / 2.0, rtol=2e-3)


def test_shadow_does_not_jump_where_the_light_passes_behind_the_surface(tmp_path):
    """A ball behind a wall of the same body: the light sinks through N.L = 0 by steps of 0.18 deg.

    Above the horizon it crosses the wall alone; below, the ball too, by a chord that begins at 0.
    """
    ball = sphere(96, 192)
    wall = box([-20.0, -20.0, -3.02], [20.0, 20.0, -3.0])
    points = np.concatenate([ball[0], wall[0]]) + OFF
    faces = np.concatenate([ball[1], wall[1] + len(ball[0])])
    body = Body(points=points, faces=faces, wrap=0.5, scattering=1.0, delta=2.0)
    height = 1024
    view, values = None, []
    for i in range(height // 2 - 8, height // 2 + 8):
        light = np.zeros((height, 2 * height, 1))
        light[i, 0:2] = 1e4
        view = view_of(
            tmp_path, [body], light, 4, 0.01, OFF + np.array([0.0, 1.0, 0.0]), (0.2, 1.9, 1.6)
        )
        values.append(view.spectra(64).mean())
    steps = np.diff(values)
    assert min(values) > 0.0
    assert np.abs(steps).max() < 0.04 * max(values)


@pytest.mark.parametrize(
    "turn", [(45.0, 0.0, 0.0), (90.0, 0.0, 45.0), (45.0, 45.0, 0.0), (60.0, 0.0, 30.0)]
)
def test_rays_along_edges_and_through_vertices_cross_a_surface_once(tmp_path, turn):
    """A slab of small triangles, looked at where its vertices are, the sun below it.

    The way through is d / |N.L| everywhere; coordinates are powers of two, so that the rays meet
    edges and vertices of the far side.
    """
    top, pieces = sheet(4.0, 64), 64
    count = len(top[0])
    rim = np.concatenate([
        np.arange(pieces) * (pieces + 1), pieces * (pieces + 1) + np.arange(pieces),
        (pieces - np.arange(pieces)) * (pieces + 1) + pieces, pieces - np.arange(pieces),
    ])  # fmt: skip
    after = np.roll(rim, -1)
    sides = [
        np.stack([rim, rim + count, after + count], -1), np.stack([rim, after + count, after], -1)
    ]  # fmt: skip
    faces = np.concatenate([top[1], top[1][:, ::-1] + count, *sides])
    points = np.concatenate([top[0], top[0] - np.array([0.0, 0.125, 0.0])])
    stage = new_stage()
    body = Body(points=points, faces=faces, wrap=1.0, scattering=1.0, delta=4.0)
    add_body(stage, body)
    sun = UsdLux.DistantLight.Define(stage, "/Sun")
    sun.AddRotateXYZOp().Set(Gf.Vec3f(*turn))
    sun.CreateAngleAttr(0.0)
    toward = np.array(UsdGeom.Xformable(sun).GetLocalTransformation()).T[:3, 2]
    assert toward[1] < -0.5
    add_view(stage, [0.0, 2.0, 0.0], [0.0, 0.0, 0.0], 1.0)
    found = ready(stage, 8).spectra(1)
    way = 0.125 / -toward[1]
    exact = (toward[1] + 1.0) / 2.0 * np.exp(-4.0 * way)
    ratio = found / found[0, 0]
    np.testing.assert_allclose(ratio, np.broadcast_to(ratio[0, 0], ratio.shape), rtol=1e-4)
    clear = replace(body, delta=0.0)
    add_body(stage, clear, "Body")
    whole = ready(stage, 8).spectra(1)
    np.testing.assert_allclose(found / whole, exact / ((toward[1] + 1.0) / 2.0), rtol=1e-3)


# --- Scale and place -----------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_a_scene_of_another_size_looks_the_same(tmp_path, scale):
    """Lengths by a factor, delta by its inverse."""
    reference = _cup_picture(tmp_path, 1.0, 0.0)
    found = _cup_picture(tmp_path, scale, 0.0)
    assert np.abs(found - reference).mean() < 1e-3 * reference.mean()


def test_a_scene_far_from_the_origin_looks_the_same(tmp_path):
    reference = _cup_picture(tmp_path, 1.0, 0.0)
    found = _cup_picture(tmp_path, 1.0, 100.0)
    assert np.abs(found.mean() / reference.mean() - 1.0) < 1e-3
    assert np.abs(found - reference).mean() < 5e-3 * reference.mean()


def _cup_picture(folder, scale, away):
    points, faces = cup()
    body = Body(
        points=scale * (points + np.array([0.05, -0.6, 0.02])) + away, faces=faces, scattering=0.5,
        delta=3.0 / scale,
    )  # fmt: skip
    stage = new_stage()
    add_body(stage, body)
    add_dome(stage, folder, soft_room(16), BASIS)
    center = np.full(3, away)
    add_view(stage, center + scale * np.array([0.4, 3.0, 2.0]), center, 2.6 * scale,
             far=1e3 * scale)  # fmt: skip
    return ready(stage, 24).spectra(256)


def test_units_of_the_stage_do_not_matter(tmp_path):
    """The same cup in centimetres."""
    points, faces = cup()
    pictures = []
    for unit in (1.0, 0.01):
        stage = new_stage(meters_per_unit=unit)
        add_body(stage, Body(points=points / unit, faces=faces, scattering=0.5, delta=3.0))
        add_dome(stage, tmp_path, soft_room(16), BASIS)
        add_view(stage, [0.4, 3.0, 2.0], [0.0, 0.6, 0.0], 2.6)
        pictures.append(ready(stage, 24).spectra(64))
    # Float32 points in centimetres round otherwise: some rays pass an edge on its other side.
    assert np.abs(pictures[0] - pictures[1]).mean() < 2e-3 * pictures[0].mean()


@pytest.mark.parametrize("distance", [1.0, 10.0, 100.0])
def test_a_slope_at_the_worlds_origin_does_not_shade_itself(tmp_path, distance):
    """Coordinates are small there, and their errors are not."""
    points, faces = box([-0.5, -0.4, -0.5], [0.5, 0.0, 0.5])
    c, s = np.cos(0.3), np.sin(0.3)
    points = points @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]).T
    stage = new_stage()
    add_body(stage, Body(points=points, faces=faces, delta=1e4))
    add_dome(stage, tmp_path, UNIFORM)
    add_view(stage, distance * np.array([0.2, 0.9, 0.3]), [0.0, 0.0, 0.0], 0.2, False, 1e3)
    found = ready(stage, 16).spectra(64)
    np.testing.assert_allclose(found, 1.0, rtol=1e-3)


# --- Determinism ---------------------------------------------------------------------------------


def test_pixels_depend_on_seed_and_frame_and_not_on_tiles_or_threads(tmp_path, monkeypatch):
    points, faces = cup()
    body = Body(points=points + OFF, faces=faces, scattering=0.5, delta=3.0,
                specular={"weight": 1.0})  # fmt: skip
    view = view_of(
        tmp_path, [body], lamp_room(16), 24, 2.6, OFF + np.array([0.0, 0.6, 0.0]), (0.4, 3, 2)
    )
    for target in (0.0, 0.02):
        first = view.traced(64, target_error=target)
        for pixels, threads in ((96, 1), (96, 2), (250, 2), (1 << 20, 1)):
            monkeypatch.setattr(traced, "TILE_PIXELS", pixels)
            again = view.traced(64, target_error=target, workers=Workers("cpu", threads))
            np.testing.assert_array_equal(first.xyza, again.xyza)
            np.testing.assert_array_equal(first.spectrum, again.spectrum)
            for name, values in first.extra.items():
                np.testing.assert_array_equal(values, again.extra[name])
        monkeypatch.undo()
    inner = first.xyza[..., 3] > 0.5
    for options in ({"seed": 1}, {"frame": 2.0}):
        other = view.traced(64, target_error=0.02, **options)
        assert (first.xyza[inner] != other.xyza[inner]).any(axis=-1).mean() > 0.5


# --- Parts ---------------------------------------------------------------------------------------


def test_the_parts_of_the_light_add_up_to_the_picture(tmp_path):
    points, faces = cup()
    body = Body(points=points + OFF, faces=faces, scattering=0.5, delta=3.0,
                specular={"weight": 1.0})  # fmt: skip
    ball = sphere(8, 16, 0.3, OFF + np.array([0.0, 1.0, 0.0]))
    lamp = Body(points=ball[0], faces=ball[1], opacity=1.0, alpha=0.5, emission=2.0,
                preview={"specularColor": (0.04, 0.04, 0.04), "roughness": 0.4})  # fmt: skip
    view = view_of(
        tmp_path, [body, lamp], soft_room(16), 24, 2.6, OFF + np.array([0, 0.6, 0]), (0.4, 3, 2)
    )
    picture = view.traced(64)
    parts = [picture.extra[name] for name in ("diffuse", "specular", "emission", "indirect")]
    total = np.sum(np.float64(parts), axis=0)
    np.testing.assert_allclose(total, picture.xyza[..., :3], rtol=2e-5, atol=1e-6 * total.max())
    assert all(part.max() > 0.0 for part in parts[:3])
    visibility = picture.extra["visibility"]
    assert 0.0 <= visibility.min() and visibility.max() <= 1.0
    assert (picture.extra["sampleCount"] == 64).all()


def test_visibility_is_one_where_nothing_is_in_the_way(tmp_path):
    for delta in (0.0, 1e4):
        view = view_of(tmp_path, [skin_sphere(smooth=False, delta=delta)], soft_room(16))
        inner = seen_by(view)
        np.testing.assert_allclose(view.traced(16).extra["visibility"][inner], 1.0, atol=1e-6)


def test_visibility_below_a_lid_is_what_the_lid_leaves(tmp_path):
    """A disc of angular radius 60 degrees over a floor under a uniform dome leaves cos^2(60)."""
    ring = 2 * np.pi * np.arange(64) / 64
    radius = np.tan(np.radians(60.0)) * np.sqrt(np.pi / 64 / (0.5 * np.sin(2 * np.pi / 64)) / 1)
    rim = np.stack([radius * np.cos(ring), np.ones(64), -radius * np.sin(ring)], -1)
    points = np.concatenate([rim, [[0.0, 1.0, 0.0]]])
    j = np.arange(64)
    faces = np.stack([np.full(64, 64), j, (j + 1) % 64], -1)
    floor = sheet(0.2)
    lid = Body(points=points + OFF, faces=faces, opacity=1.0)
    body = Body(points=floor[0] + OFF, faces=floor[1], delta=0.0)
    view = view_of(tmp_path, [body, lid], UNIFORM, 8, 0.01, OFF, (0.1, 0.8, 0.1))
    found = view.traced(256)
    assert abs(found.extra["visibility"].mean() - 0.25) < 2e-3
    assert abs(found.spectrum.mean() - 0.25) < 2e-3


def test_what_blocks_learn_makes_no_bias_and_less_noise(tmp_path, monkeypatch):
    """Under half a lid, whose edge crosses the sky; the truth is by symmetry.

    A half plane at height 1 whose edge is over the point leaves half of the light; blocks without
    learning see more noise.
    """
    floor, lid = sheet(0.2), sheet(400.0)
    points = lid[0] * np.array([0.5, 1.0, 1.0]) + np.array([100.0, 1.0, 0.0])
    for delta in (0.0, 1e6):
        bodies = [
            Body(points=floor[0] + OFF, faces=floor[1], delta=delta),
            Body(points=points + OFF, faces=lid[1], opacity=1.0),
        ]
        view = view_of(tmp_path, bodies, UNIFORM, 16, 0.001, OFF, (-0.1, 0.8, 0.1))
        noise = {}
        for weight in (passes.LEARNING_WEIGHT, 1.0):
            monkeypatch.setattr(passes, "LEARNING_WEIGHT", weight)
            found = np.stack([view.spectra(32, seed)[..., 0] for seed in range(12)])
            spread = found.std() / np.sqrt(found.size)
            assert abs(found.mean() - 0.5) < 4.0 * spread + 1e-4
            noise[weight] = found.std()
        monkeypatch.undo()
        assert noise[passes.LEARNING_WEIGHT] < 0.7 * noise[1.0]


@pytest.mark.parametrize("light", [soft_room(16), lamp_room(32)], ids=["soft", "lamp"])
def test_what_blocks_learn_makes_no_bias_of_light_that_comes_through(tmp_path, monkeypatch, light):
    """A ring lets red through and stops blue; most of what it shows of lamps behind is dimmed."""
    points, faces, normals = torus(24, 12)
    ring = Body(
        points=points + OFF, faces=faces, normals=normals, wrap=0.3, scattering=0.6,
        delta=(8.0, 4.0, 2.0, 1.0, 0.5),
    )  # fmt: skip
    view = view_of(tmp_path, [ring], light, 16, 2.6)
    found = []
    for weight in (passes.LEARNING_WEIGHT, 1.0):
        monkeypatch.setattr(passes, "LEARNING_WEIGHT", weight)
        found.append(np.stack([view.spectra(64, seed) for seed in range(32)]))
    learned, plain = (draws.mean(axis=0) for draws in found)
    lit = plain.mean(axis=-1) > 0.05 * plain.max()
    assert lit.mean() > 0.3
    error = np.hypot(*(draws.std(axis=0, ddof=1) for draws in found)) / np.sqrt(32.0)
    sigmas = (learned - plain)[lit] / np.hypot(error[lit], 1e-4 * plain.max())
    assert np.sqrt((sigmas**2).mean()) < 1.2
    np.testing.assert_allclose(learned[lit].sum(axis=0), plain[lit].sum(axis=0), rtol=1e-3)


@pytest.mark.parametrize(
    ("opacity", "threshold", "left"),
    [(0.0, 0.0, 1.0), (0.5, 0.0, 0.5), (1.0, 0.0, 0.0), (0.5, 0.4, 0.0), (0.3, 0.4, 1.0)],
)
def test_a_pane_takes_its_opacity_from_the_light(tmp_path, opacity, threshold, left):
    """Two panes take it twice; a threshold makes it all or nothing."""
    floor, pane = sheet(0.2), sheet(200.0)
    body = Body(points=floor[0] + OFF, faces=floor[1])
    panes = [
        Body(points=pane[0] + OFF + np.array([0.0, height, 0.0]), faces=pane[1], opacity=opacity,
             threshold=threshold)
        for height in (1.0, 1.2)
    ]  # fmt: skip
    for count in (1, 2):
        view = view_of(tmp_path, [body, *panes[:count]], UNIFORM, 8, 0.01, OFF, (0.1, 0.8, 0.1))
        found = view.spectra(1024)
        assert abs(found.mean() - left**count) < 1.5e-3
        if left == 1.0:
            np.testing.assert_allclose(found, 1.0, rtol=2e-5)


@pytest.mark.slow
def test_variance_is_never_told_too_low(tmp_path):
    """Never less than true; up to 5 times where the halves of a net cancel each other's errors."""
    points, faces = cup()
    body = Body(points=points + OFF, faces=faces, scattering=0.5, delta=3.0)
    toward = OFF + np.array([0.0, 0.6, 0.0])
    for light, most in ((lamp_room(16), 5.0), (soft_room(16), 2.0)):
        view = view_of(tmp_path, [body], light, 16, 2.6, toward, (0.4, 3, 2))
        told, means = [], []
        for seed in range(24):
            picture = view.traced(32, seed, spectral=False)
            told.append(picture.extra["variance"])
            means.append(picture.xyza[..., 1].astype(np.float64))
        true = np.var(means, axis=0, ddof=1)
        assert 0.8 < np.mean(told, axis=0).sum() / true.sum() < most


@pytest.mark.slow
@pytest.mark.parametrize("target", [0.05, 0.02])
def test_sampling_stops_near_the_target_and_changes_no_mean(tmp_path, target):
    """True relative error, rms over the lit pixels, within a factor of two; fewer samples.

    Relative to the pixel, or to the floor that errors are judged by where it is darker.
    """
    points, faces = cup()
    body = Body(points=points + OFF, faces=faces, scattering=0.5, delta=3.0)
    toward = OFF + np.array([0.0, 0.6, 0.0])
    view = view_of(tmp_path, [body], lamp_room(16), 24, 2.6, toward, (0.4, 3, 2))
    exact = np.mean([view.traced(2048, 50 + k).xyza[..., 1] for k in range(3)], axis=0)
    found = [view.traced(1024, seed, target_error=target) for seed in range(8)]
    means = np.array([each.xyza[..., 1] for each in found], np.float64)
    lit = exact > 0.1 * exact.max()
    floor = ERROR_FLOOR * mean_white(view.scene.lights, view.scene.frame)[1]
    level = np.maximum(exact[lit], floor)
    error = np.sqrt((((means[:, lit] - exact[lit]) / level) ** 2).mean())
    assert 0.4 < error / target < 1.5
    assert abs(means.mean() / exact.mean() - 1.0) < 0.1 * target
    assert found[0].extra["sampleCount"].mean() < 256


# --- Lights that are not maps --------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.53, 10.0])
def test_a_shadowed_sun_leaves_nothing(tmp_path, angle):
    stage = new_stage()
    floor, lid = sheet(0.2), sheet(400.0)
    add_body(stage, Body(points=floor[0] + OFF, faces=floor[1]), "Floor")
    add_body(
        stage, Body(points=lid[0] + OFF + np.array([0, 1, 0]), faces=lid[1], opacity=1.0), "Lid"
    )
    sun = UsdLux.DistantLight.Define(stage, "/Sun")
    sun.AddRotateXYZOp().Set(Gf.Vec3f(-80.0, 10.0, 0.0))
    sun.CreateAngleAttr(angle)
    sun.CreateIntensityAttr(1.0)
    sun.CreateNormalizeAttr(True)
    add_view(stage, OFF + np.array([0.1, 0.8, 0.1]), OFF, 0.01)
    shadow = ready(stage, 8).spectra(256).mean()
    UsdGeom.Imageable(stage.GetPrimAtPath("/Lid")).MakeInvisible()
    lit = ready(stage, 8).spectra(256).mean()
    assert abs(shadow) < 1e-4 * lit


def test_a_black_dome_gives_a_black_picture(tmp_path):
    view = view_of(tmp_path, [skin_sphere()], np.zeros((8, 16, 1)))
    assert view.spectra(16).max() == 0.0
