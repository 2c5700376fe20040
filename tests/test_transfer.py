"""Baked transfer: closed forms of what is blocked, then the traced picture, then misuse."""

import json
import re
from itertools import pairwise
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from transfer_stages import (
    ball,
    box,
    disc,
    grid,
    mesh,
    window_dome,
    write_stage,
)

from usdskin.cli import main
from usdskin.device import open_workers
from usdskin.layers import open_stage
from usdskin.progress import SilentProgress
from usdskin.render import transfer_levels
from usdskin.render.domes import DomeLight
from usdskin.render.environment import build_environment
from usdskin.render.overrides import RenderOverrides
from usdskin.render.scene import read_scene
from usdskin.render.settings import read_settings
from usdskin.render.transfer import read_transfers
from usdskin.render.transfer_bake import bake_transfer
from usdskin.render.transfer_file import joined, kept
from usdskin.render.transfer_light import lit_transfers, project_dome, upload_transfers
from usdskin.render.transfer_sphere import ring_count, transfer_sphere
from usdskin.render.uploading import upload
from usdskin.warp_kernels import transfer_gather

# isort: split
from pxr import Usd

QUIET = SilentProgress()


def bake(stage, **options):
    output = stage.with_name("transfer.usda")
    return bake_transfer(stage, output, RenderOverrides(device="cpu"), QUIET, **options)


def changes(path):
    """Return the scene, its transfers, and what they change of a stage's diffuse light."""
    stage = open_stage(path)
    settings = read_settings(stage, RenderOverrides())
    scene = read_scene(stage, Usd.TimeCode.EarliestTime(), settings, [])
    workers = open_workers("cpu", 1)
    transfers = read_transfers(stage, scene, settings)
    device_scene, light = upload(scene, workers, show_dome=False, measured=True)
    shadows = upload_transfers(transfers, workers.device)
    lit_transfers(shadows, scene.lights, light, device_scene, workers).light()
    # A white dome has three equal channels: the first one tells it all.
    return scene, transfers, device_scene.geometry.transfer.numpy()[:, :, 0], device_scene, light


def at(transfers, point):
    """Return the vertices at a point."""
    return np.flatnonzero(
        np.linalg.norm(transfers.position[transfers.place] - np.asarray(point), axis=-1) < 1e-3
    )


def picture(path):
    pixels = OpenEXR.File(str(path)).parts[0].channels
    name = "RGBA" if "RGBA" in pixels else "RGB"
    return np.asarray(pixels[name].pixels)[..., :3].astype(np.float64)


def scale_of(scene):
    """Return the first channel of the white dome's radiance."""
    return float(scene.lights.domes[0].coefficients[0, 0, 0])


# What is blocked, in closed form.


def test_a_disc_overhead_blocks_its_form_factor_of_both_kernels(tmp_path):
    """Lambert: R^2/(R^2 + h^2); wrap: 2 pi/(1 + l) [(1 - c^2)/2 + l (1 - c)], c = cos(rim)."""
    wrap, radius, height = 0.4, 0.8, 0.6
    base = write_stage(
        tmp_path / "base.usda",
        mesh("Floor", *grid(0.2, 2)),
        mesh("Lid", *disc(radius, height), material=None),
        wrap=wrap,
    )
    bake(base, directions=4096)
    stage = write_stage(
        tmp_path / "stage.usda",
        mesh("Floor", *grid(0.2, 2)),
        mesh("Lid", *disc(radius, height), material=None),
        layers=["transfer.usda"],
        wrap=wrap,
    )
    scene, transfers, change, *_ = changes(stage)
    (vertex,) = at(transfers, (0, 0, 0))

    cosine = height / np.hypot(radius, height)
    lambert = np.pi * (1 - cosine**2)
    wrapped = 2 * np.pi / (1 + wrap) * ((1 - cosine**2) / 2 + wrap * (1 - cosine))
    radiance = scale_of(scene)
    assert change[vertex, 0] == pytest.approx(-radiance * lambert, rel=0.01)
    assert change[vertex, 1] == pytest.approx(-radiance * wrapped, rel=0.01)


def test_an_endless_wall_blocks_half_of_one_minus_the_cosine(tmp_path):
    """F = (1 - d / sqrt(d^2 + h^2)) / 2 at distance d from a wall of height h."""
    far, tall = 200.0, 1.0
    wall = ([(1, 0, -far), (1, 0, far), (1, tall, far), (1, tall, -far)], [(0, 1, 2, 3)])
    meshes = (mesh("Floor", *grid(0.5, 2)), mesh("Wall", *wall, material=None))
    bake(write_stage(tmp_path / "base.usda", *meshes), directions=4096)
    stage = write_stage(tmp_path / "stage.usda", *meshes, layers=["transfer.usda"])
    scene, transfers, change, *_ = changes(stage)

    for x in (-0.25, 0.0, 0.25):
        (vertex,) = at(transfers, (x, 0, 0))
        expected = np.pi * 0.5 * (1 - (1 - x) / np.hypot(1 - x, tall))
        assert change[vertex, 0] == pytest.approx(-scale_of(scene) * expected, rel=0.02)


def test_light_through_a_slab_is_weakened_by_its_length(tmp_path):
    """Int (x + l)/(1 + l) exp(-t delta/|x|) 2 pi dx over -l < x < 0, band by band."""
    wrap, opacity, thick = 0.5, 200.0, 0.004
    meshes = (mesh("Slab", *box((2.0, thick, 2.0))),)
    options = {"wrap": wrap, "opacity": opacity}
    bake(write_stage(tmp_path / "base.usda", *meshes, **options), directions=4096)
    stage = write_stage(tmp_path / "stage.usda", *meshes, layers=["transfer.usda"], **options)
    scene, transfers, change, device_scene, _ = changes(stage)
    assert scene.meshes[0].closed
    (vertex,) = at(transfers, (0, thick / 2, 0))

    rank = int(device_scene.materials.passage_rank.numpy()[transfers.material[vertex]])
    x = -(np.arange(100_000) + 0.5) / 100_000 * wrap
    weight = (x + wrap) / (1 + wrap) * 2 * np.pi * wrap / 100_000
    through = (weight * np.exp(-opacity * thick / -x)).sum() * scale_of(scene)
    # A grey opacity: all bands agree, so one term says it all.
    assert rank == 1
    spectra = device_scene.materials.passage.numpy()[transfers.material[vertex], 0, 0]
    assert change[vertex, 2] / spectra == pytest.approx(through, rel=0.02)
    assert change[vertex, :2] == pytest.approx([0.0, 0.0], abs=1e-3 * scale_of(scene))
    assert change[vertex, 3] == pytest.approx(0.0, abs=1e-6)


def test_a_convex_body_has_nothing_to_change(tmp_path):
    meshes = (mesh("Ball", *ball(0.5, (0, 0, 0), rings=12)),)
    bake(write_stage(tmp_path / "base.usda", *meshes, wrap=0.7), directions=256)
    stage = write_stage(tmp_path / "stage.usda", *meshes, layers=["transfer.usda"], wrap=0.7)
    _, transfers, change, *_ = changes(stage)
    assert not transfers.measured.weakened.any()
    assert not change.any()


# The directions, and light spread over them.


@pytest.mark.parametrize("count", [64, 1000, 4096])
def test_directions_are_about_as_many_as_asked_and_share_out_all_light(count):
    sphere = transfer_sphere(ring_count(count))
    assert sphere.count == pytest.approx(count, rel=0.1)
    assert sorted(sphere.order) == list(range(sphere.count))
    rng = np.random.default_rng(1)
    toward = rng.normal(size=(500, 3))
    toward /= np.linalg.norm(toward, axis=1)[:, None]
    index, share = sphere.shares(toward)
    assert share.min() >= 0.0
    np.testing.assert_allclose(share.sum(axis=1), 1.0, atol=1e-12)
    near = np.linalg.norm(sphere.direction[index] - toward[:, None], axis=-1) * (share > 1e-9)
    assert near.max() < 2.5 * np.pi / sphere.rings
    exact, _ = sphere.shares(sphere.direction[: sphere.count].astype(np.float64))
    assert (exact == np.arange(sphere.count)[:, None]).any(axis=1).all()


@pytest.mark.parametrize("shape", [(16, 32), (96, 192), (130, 260)])
def test_spread_light_keeps_its_flux_and_its_irradiance(shape):
    """The kernels' integrals over the directions are those over the sphere."""
    height, width = shape
    polar = np.pi * (np.arange(height) + 0.5) / height
    turn = 2 * np.pi * (np.arange(width) + 0.5) / width
    image = 1.0 + 0.8 * np.cos(polar)[:, None] * np.ones(width)
    image = image + 0.5 * np.sin(polar)[:, None] * np.sin(turn)
    rotation = np.array([[0.0, 0, 1], [0, 1, 0], [-1, 0, 0]])
    dome = DomeLight("/D", image[:, :, None].astype(np.float32), np.ones((1, 2)), rotation, False)
    sphere = transfer_sphere(40)
    flux = project_dome(dome, np.zeros((0, 4), np.int64), sphere)[0, :, 0].astype(np.float64)
    assert flux.sum() == pytest.approx(4 * np.pi, rel=1e-5)
    for normal in np.eye(3):
        # J1 of a + b.L is pi (a + 2/3 b.n); in the world the dome's +X is -Z.
        slope = {0: 0.0, 1: 0.8, 2: -0.5}[int(np.argmax(normal))]
        exact = np.pi * (1.0 + 2.0 / 3.0 * slope)
        found = flux @ np.maximum(sphere.direction @ normal, 0.0)
        assert found == pytest.approx(exact, rel=3e-3)


def test_strong_lamps_are_left_out_of_the_spread_light():
    image = np.full((64, 128, 1), 0.1, np.float32)
    image[20, 40] = 500.0
    dome = DomeLight("/D", image, np.ones((1, 2)), np.eye(3), False)
    environment = build_environment(image, np.ones(1), np.eye(3))
    strong = environment.lamp_blocks[: environment.gloss_lamp_count]
    assert len(strong) == 4  # the texel is refined
    flux = project_dome(dome, strong, transfer_sphere(20))
    assert flux.sum() == pytest.approx(0.1 * 4 * np.pi, rel=0.01)


def measurements(clear, length):
    """Return dense measurements as the bake hands them over."""
    weakened = (clear < 1) | (length > 0)
    row, direction = np.nonzero(weakened & (clear > 0))
    first = np.searchsorted(row, np.arange(len(clear) + 1))
    bits = np.packbits(weakened, axis=1, bitorder="little").view(np.uint32)
    return kept(bits, first, direction, clear[row, direction], length[row, direction])


def test_measurements_are_kept_and_joined_without_loss():
    rng = np.random.default_rng(2)
    clear = rng.choice([0.0, 1.0, 51 / 255], (5, 64)).astype(np.float32)
    length = (rng.choice([0.0, 0.004], (5, 64)) * (clear > 0)).astype(np.float32)
    both = joined([measurements(clear[:2], length[:2]), measurements(clear[2:], length[2:])])
    bits = np.unpackbits(both.weakened.view(np.uint8), axis=1, bitorder="little")
    np.testing.assert_array_equal(bits, (clear < 1) | (length > 0))
    row = np.repeat(np.arange(5), np.diff(both.first))
    np.testing.assert_allclose(both.clear / 255, clear[row, both.direction], atol=1e-6)
    np.testing.assert_allclose(both.length / 1e3, length[row, both.direction], rtol=1e-3)


# Which rays are followed.


@pytest.mark.parametrize("count", [1, 5, 580, 700, 5000])
def test_every_place_is_measured_once_and_after_those_around_it(count):
    rng = np.random.default_rng(count)
    points = rng.normal(size=(count, 3)).astype(np.float32)
    points[::7] = points[0]  # seams
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    known = np.zeros(count, bool)
    rim = np.arange(count) % 50 == 3
    levels = transfer_levels.levels_of(points, normals, rim)
    assert np.isin(np.flatnonzero(rim), levels[0].place).all()
    for level in levels:
        assert known[level.around].all()
        assert not known[level.place].any()
        known[level.place] = True
    assert known.all()
    assert sum(len(level.place) for level in levels) == count
    assert (levels[0].around.size == 0) and (len(levels) > 1) == (count >= 700)


def test_the_rim_is_where_a_triangle_has_no_neighbour():
    points, faces = grid(1.0, 4)
    triangles = np.array([(a, b, c) for a, b, c, d in faces] + [(a, c, d) for a, b, c, d in faces])
    points = np.array(points, np.float32)
    rim = transfer_levels.rim_of(points, triangles)
    np.testing.assert_array_equal(rim, np.abs(points[:, [0, 2]]).max(axis=1) > 0.49)
    soup = transfer_levels.rim_of(points[triangles.ravel()], np.arange(96).reshape(-1, 3))
    np.testing.assert_array_equal(soup, rim[triangles.ravel()])


def test_words_near_a_word_hold_the_directions_beside_its_own():
    sphere = transfer_sphere(20)
    others = transfer_levels.beside(sphere.direction[: sphere.count])
    near = transfer_levels.words_near(others, 32)
    for d, beside in enumerate(others):
        assert d not in beside
        assert set(beside // 32) <= set(near[d // 32])
        assert (sphere.direction[beside] @ sphere.direction[d] > np.cos(2.5 * np.pi / 20)).all()


@pytest.mark.parametrize("opacity", [0.0, 40.0, 1e6])
def test_few_rays_find_what_all_rays_find(tmp_path, monkeypatch, opacity):
    """A ball over a floor, every bit of every vertex."""
    base = write_stage(
        tmp_path / "base.usda", mesh("Floor", *grid(2.0, 40)),
        mesh("Ball", *ball(0.35, (0.1, 0.45, 0.0), rings=24)), opacity=opacity,
    )  # fmt: skip
    few = bake(base, directions=400)
    found = np.load(tmp_path / "transfer.npz")
    monkeypatch.setattr(transfer_levels, "FEWEST", 10**9)
    every = bake(base, directions=400)
    exact = np.load(tmp_path / "transfer.npz")
    assert few.rays < (0.6 if opacity else 0.8) * every.rays
    for k in range(2):
        one, other = (
            np.unpackbits(each[f"{k}/weakened"].view(np.uint8), axis=1) for each in (found, exact)
        )
        wrong = one != other
        assert wrong.mean() < 1e-3
        assert wrong.mean(axis=1).max() < 0.02
    if not opacity:
        return
    for name in ("clear", "length"):
        total, expected = (
            found[f"1/{name}"].astype(float).sum(),
            exact[f"1/{name}"].astype(float).sum(),
        )
        assert total == pytest.approx(expected, rel=2e-3, abs=1.0)


# Pictures.

SCENE = (
    mesh("Floor", *grid(2.0, 40)),
    mesh("Ball", *ball(0.35, (0.1, 0.45, 0.0), rings=16)),
)


@pytest.fixture(scope="module")
def room(tmp_path_factory):
    """A ball over a floor in a room with a window and a lamp, baked; its folder."""
    folder = tmp_path_factory.mktemp("room")
    dome = window_dome(folder / "room.exr")
    base = write_stage(folder / "base.usda", *SCENE, dome=dome, opacity=40.0)
    bake(base, directions=1024)
    write_stage(folder / "stage.usda", *SCENE, dome=dome, opacity=40.0, layers=["transfer.usda"])
    write_stage(
        folder / "turned.usda", *SCENE, dome=dome, turn=90.0, opacity=40.0,
        layers=["transfer.usda"],
    )  # fmt: skip
    return folder


def render(stage, name, *flags, size=64):
    output = stage.with_name(name)
    arguments = ["-q", "--device", "cpu", "render", str(stage), str(output)]
    assert main([*arguments, "-r", str(size), str(size), "--no-png", *flags]) == 0
    return picture(output)


@pytest.mark.parametrize("stage", ["stage.usda", "turned.usda"])
def test_a_picture_with_transfer_is_the_traced_one(room, stage):
    """Within 1 % of white's radiance, on the mean; the map alone is several times as far off."""
    traced = render(room / stage, "traced.exr", "--integrator", "traced", "-p", "256")
    baked = render(room / stage, "baked.exr", "-p", "16")
    plain = render(room / "base.usda", "plain.exr", "-p", "16") if stage == "stage.usda" else None
    peak = np.percentile(traced, 99)
    assert np.abs(baked - traced).mean() < 0.01 * peak
    assert abs((baked - traced).mean()) < 0.004 * peak
    if plain is not None:
        assert np.abs(baked - traced).mean() < 0.2 * np.abs(plain - traced).mean()


TURNTABLE = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    subLayers = [@./stage.usda@]
)
over "World"
{
    over "Camera"
    {
        float focalLength.timeSamples = {1: 2, 3: 1.4}
    }
    over "Dome"
    {
        float3 xformOp:rotateXYZ.timeSamples = {1: (0, 0, 0), 2: (0, 70, 0), 3: (0, 70, 0)}
    }
    over "Skin"
    {
        float inputs:skin:wrap.timeSamples = {1: 0.3, 2: 0.3, 3: 0.5}
    }
}
"""


def test_frames_with_transfer_are_those_rendered_alone(room):
    """Light, camera and wrap change; what was baked stays right, and is not mixed up."""
    stage = room / "turntable.usda"
    stage.write_text(TURNTABLE)
    arguments = ["-q", "--device", "cpu", "render", str(stage)]
    small = ["-r", "24", "24", "-p", "4", "--no-png"]
    assert main([*arguments, str(room / "together.####.exr"), "-f", "1-3", *small]) == 0
    pictures = [picture(room / f"together.{number:04d}.exr") for number in (1, 2, 3)]
    for number, found in enumerate(pictures, 1):
        alone = room / f"alone.{number:04d}.exr"
        assert main([*arguments, str(alone), "-f", str(number), *small]) == 0
        np.testing.assert_array_equal(found, picture(alone))
    assert all((one != other).any() for one, other in pairwise(pictures))


PANE = """
    def Material "Glass"
    {
        token outputs:surface.connect = </World/Glass/Surface.outputs:surface>
        def Shader "Surface"
        {
            uniform token info:id = "UsdPreviewSurface"
            float inputs:opacity = 0.4
            token outputs:surface
        }
    }
""" + mesh("Pane", [(-0.5, 0.9, 0), (0.1, 0.9, 0), (0.1, 0.9, 0.6), (-0.5, 0.9, 0.6)],
           [(3, 2, 1, 0)], material="Glass")  # fmt: skip

RELIT = """#usda 1.0
(
    metersPerUnit = 1
    upAxis = "Y"
    subLayers = [@./relit_stage.usda@]
)
over "World"
{
    over "Dome"
    {
        float3 xformOp:rotateXYZ.timeSamples = {1: (0, 0, 0), 4: (0, 150, 0)}
    }
}
"""


def parts(path):
    """Return every channel of every part of a file."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return [
            {name: channel.pixels.copy() for name, channel in part.channels.items()}
            for part in file.parts
        ]


@pytest.mark.parametrize("extra", ["", PANE], ids=["opaque", "behind glass"])
@pytest.mark.parametrize(
    "flags",
    [
        [],
        ["--aov", "irradiance"],
        ["--set", "/World/Camera.fStop=2", "--set", "/World/Camera.focusDistance=3"],
    ],
    ids=["picture", "irradiance", "lens"],
)
def test_a_camera_that_stands_lights_what_it_sees_and_it_is_all_there(
    tmp_path, monkeypatch, extra, flags
):
    """From the third frame on; what is seen through glass, or not seen, is lit where asked for."""
    dome = window_dome(tmp_path / "room.exr")
    scene = {"dome": dome, "opacity": 40.0, "extra": extra}
    bake(write_stage(tmp_path / "base.usda", *SCENE, **scene), directions=256)
    write_stage(tmp_path / "relit_stage.usda", *SCENE, **scene, layers=["transfer.usda"])
    stage = tmp_path / "relit.usda"
    stage.write_text(RELIT)
    lit = []
    gather = transfer_gather.gather_lamps

    def counting(*arguments):
        lit.append(arguments[-1] - arguments[-2])
        gather(*arguments)

    monkeypatch.setattr(transfer_gather, "gather_lamps", counting)
    arguments = ["-q", "--device", "cpu", "render", str(stage)]
    small = ["-r", "24", "24", "-p", "4", "--no-png", *flags]
    assert main([*arguments, str(tmp_path / "together.####.exr"), "-f", "1-4", *small]) == 0
    together = sum(lit)
    for number in (1, 2, 3, 4):
        alone = tmp_path / f"alone.{number:04d}.exr"
        assert main([*arguments, str(alone), "-f", str(number), *small]) == 0
        found = parts(tmp_path / f"together.{number:04d}.exr")
        for one, other in zip(found, parts(alone), strict=True):
            assert one.keys() == other.keys()
            for name in one:
                np.testing.assert_array_equal(one[name], other[name])
    alone_each = (sum(lit) - together) / 4
    if extra or flags:
        assert together == 4 * alone_each
    else:
        assert 2.2 * alone_each < together < 3.6 * alone_each


def test_a_wall_hides_what_would_be_mirrored(tmp_path):
    """The view of the floor's middle is mirrored towards the wall, so gloss adds nothing there."""
    wall = ([(-50, 0, -1.1), (50, 0, -1.1), (50, 60, -1.1), (-50, 60, -1.1)], [(0, 1, 2, 3)])
    floor, wall = mesh("Floor", *grid(0.5, 2)), mesh("Wall", *wall, material=None)

    def middle(name, *meshes, baked, gloss):
        stage = write_stage(
            tmp_path / name, *meshes, gloss=gloss, layers=["transfer.usda"] if baked else []
        )
        return render(stage, "x.exr", "-p", "1", size=7)[3, 3].mean()

    bake(write_stage(tmp_path / "base.usda", floor, wall), directions=1024)
    # In uniform light gloss gives back what it takes of the diffuse light, some 4 %, unless hidden.
    plain = middle("a.usda", floor, wall, baked=False, gloss=0.0)
    glossy = middle("b.usda", floor, wall, baked=False, gloss=1.0)
    assert glossy == pytest.approx(plain, rel=0.01)
    without = middle("c.usda", floor, wall, baked=True, gloss=0.0)
    hidden = middle("d.usda", floor, wall, baked=True, gloss=1.0)
    assert 0.93 * without < hidden < 0.98 * without


def test_the_same_picture_whatever_the_threads(room):
    first = render(room / "stage.usda", "one.exr", "--threads", "1")
    second = render(room / "stage.usda", "two.exr", "--threads", "2")
    np.testing.assert_array_equal(first, second)


# Misuse.


def refused(capsys, *arguments):
    code = main(["-q", "--device", "cpu", *map(str, arguments)])
    lines = [line for line in capsys.readouterr().err.splitlines() if "error" in line]
    assert len(lines) == 1
    return code, lines[0]


def changed(room, *meshes, name="changed.usda", opacity=40.0):
    return write_stage(
        room / name, *meshes, opacity=opacity, layers=["transfer.usda"],
        dome="uniform token inputs:spectral:source = \"rgb\"",
    )  # fmt: skip


@pytest.mark.parametrize(
    ("meshes", "opacity", "what"),
    [
        ((SCENE[0], mesh("Ball", *ball(0.35, (0.1, 0.46, 0.0), rings=16))), 40.0, "</World/Ball>"),
        ((SCENE[0],), 40.0, "</World/Ball> is gone"),
        ((*SCENE, mesh("Hat", *disc(0.2, 1.0))), 40.0, "</World/Hat> was not there"),
        (SCENE, 20.0, "its skin's opacity was higher"),
        (SCENE, 0.0, "its skin's opacity was higher"),
    ],
)
def test_shadows_of_another_scene_are_refused(room, capsys, meshes, opacity, what):
    stage = changed(room, *meshes, opacity=opacity)
    code, line = refused(capsys, "render", stage, room / "x.exr", "-r", 8, 8)
    assert code == 3
    assert "do not hold" in line
    assert what in line
    assert line.endswith("bake it again with `usdskin bake`")


def test_more_opaque_skin_needs_no_new_bake(room):
    render(changed(room, *SCENE, name="opaque.usda", opacity=80.0), "opaque.exr", size=8)


def test_another_subdivision_level_is_named(tmp_path, capsys):
    ball_mesh = mesh("Ball", *ball(0.5, (0, 0, 0), rings=4)).replace('"none"', '"catmullClark"')
    bake(write_stage(tmp_path / "base.usda", ball_mesh), directions=64)
    stage = write_stage(tmp_path / "stage.usda", ball_mesh, layers=["transfer.usda"])
    code, line = refused(capsys, "render", stage, tmp_path / "x.exr", "--level", 1)
    assert code == 3
    assert "measured at subdivision level 2, and it is 1 now" in line


def test_a_missing_or_damaged_file_is_refused(room, tmp_path, capsys):
    for name in ("stage.usda", "transfer.usda", "room.exr"):
        (tmp_path / name).write_bytes((room / name).read_bytes())
    stage = tmp_path / "stage.usda"
    code, line = refused(capsys, "render", stage, tmp_path / "x.exr")
    assert code == 3
    assert "transfer.npz" in line
    data = bytearray((room / "transfer.npz").read_bytes())
    for damaged in (b"", b"nonsense", bytes(data[: len(data) // 2])):
        (tmp_path / "transfer.npz").write_bytes(damaged)
        code, line = refused(capsys, "render", stage, tmp_path / "x.exr")
        assert code == 3
        assert "bake it again" in line
    data[len(data) // 2] ^= 0xFF
    (tmp_path / "transfer.npz").write_bytes(bytes(data))
    code, line = refused(capsys, "render", stage, tmp_path / "x.exr")
    assert code == 3


@pytest.mark.parametrize(
    ("attribute", "value"), [("version", 2), ("rings", 1), ("rings", 50), ("rowCount", 7)]
)
def test_a_layer_that_contradicts_its_file_is_refused(room, tmp_path, capsys, attribute, value):
    for name in ("stage.usda", "transfer.npz", "room.exr"):
        (tmp_path / name).write_bytes((room / name).read_bytes())
    text = (room / "transfer.usda").read_text()
    text = re.sub(f"int transfer:{attribute} = .*", f"int transfer:{attribute} = {value}", text)
    (tmp_path / "transfer.usda").write_text(text)
    code, line = refused(capsys, "render", tmp_path / "stage.usda", tmp_path / "x.exr")
    assert code == 3
    assert line.endswith("bake it again with `usdskin bake`")


def test_brute_shading_with_transfer_is_refused(room, capsys):
    arguments = ("render", room / "stage.usda", room / "x.exr", "--spectral", "brute")
    code, line = refused(capsys, *arguments)
    assert code == 2
    assert "baked shadows" in line


@pytest.mark.parametrize("count", [0, 10, 10**6])
def test_a_wrong_number_of_directions_is_refused(room, capsys, count):
    code, line = refused(
        capsys, "bake", room / "base.usda", "-o", room / "y.usda", "--directions", count
    )
    assert code == 2
    assert "--directions" in line


def test_a_layer_of_the_stage_is_not_overwritten_unless_it_is_a_bake(room, capsys):
    write_stage(room / "other.usda", layers=())
    stage = write_stage(room / "with.usda", *SCENE, layers=["other.usda"])
    code, line = refused(capsys, "bake", stage, "-o", room / "other.usda")
    assert code == 2
    assert "no earlier bake" in line


# The command line, end to end.


def test_bake_render_and_look_end_to_end(tmp_path, capsys):
    write_stage(
        tmp_path / "shot.usda", mesh("Floor", *grid(1.0, 4)), mesh("Lid", *disc(0.3, 0.3)),
        layers=["transfer.usda"],
    )  # fmt: skip
    shot, layer = tmp_path / "shot.usda", tmp_path / "transfer.usda"

    def run(*arguments):
        assert main(["--json", "--device", "cpu", *map(str, arguments)]) == 0
        return [json.loads(line) for line in capsys.readouterr().out.splitlines()]

    for _ in range(2):  # the second time the stage has the first one's layer
        events = run("bake", shot, "-o", layer, "--directions", 128)
        assert [event["path"] for event in events if event["event"] == "wrote"] == [
            str(layer), str(layer.with_suffix(".npz")),
        ]  # fmt: skip
    (told,) = [event for event in events if event["event"] == "bake"]
    assert told["prims"] == 2
    assert told["rays"] == told["places"] * transfer_sphere(ring_count(128)).count
    run("render", shot, tmp_path / "x.exr", "-r", 16, 16)
    (info,) = [event for event in run("info", shot) if event["event"] == "info"]
    assert [row["path"] for row in info["transfers"]] == ["/World/Floor", "/World/Lid"]
    main(["--json", "validate", str(shot)])
    found = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    assert not [line for line in found if "ransfer" in str(line.get("message"))]


def test_a_referenced_bake_and_receivers_alone(tmp_path):
    """By reference the paths differ; what is not measured is rendered as without a bake."""
    base = write_stage(tmp_path / "base.usda", *SCENE)
    arguments = ["-q", "--device", "cpu", "bake", str(base), "--directions", "64"]
    arguments += ["-o", str(tmp_path / "transfer.usda"), "--receivers", "/World/Floor"]
    assert main(arguments) == 0
    stage = tmp_path / "moved.usda"
    stage.write_text(
        base.read_text().replace(
            'def Xform "World"', 'def Xform "Set" (references = @./transfer.usda@)'
        ).replace("</World/", "</Set/").replace('defaultPrim = "World"', 'defaultPrim = "Set"')
    )  # fmt: skip
    scene, transfers, change, *_ = changes(stage)
    assert [mesh.path for mesh in scene.meshes] == ["/Set/Floor", "/Set/Ball"]
    assert set(transfers.prim) == {0}
    assert (transfers.corner_vertex[3 * len(scene.meshes[0].triangles) :] == -1).all()
    assert change[:, 0].min() < -0.1


@pytest.mark.slow
def test_a_stage_with_texture_gloss_and_opacity_is_the_traced_one(tmp_path):
    forearm = Path(__file__).resolve().parents[1] / "stages" / "forearm" / "forearm.usda"
    bake_transfer(forearm, tmp_path / "transfer.usda", RenderOverrides(device="cpu"), QUIET)
    stage = tmp_path / "shot.usda"
    stage.write_text(
        "#usda 1.0\n(\n    subLayers = [@./transfer.usda@, @"
        f'{forearm}@]\n    renderSettingsPrimPath = "/Render/Settings"\n    upAxis = "Y"\n'
        '    metersPerUnit = 1\n    defaultPrim = "World"\n)\n'
    )
    baked = render(stage, "baked.exr", "-p", "8", size=96)
    traced = render(stage, "traced.exr", "--integrator", "traced", "-p", "128", size=96)
    assert np.abs(baked - traced).mean() < 0.01 * np.percentile(traced, 99)
