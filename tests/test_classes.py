from functools import cache
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest
from pxr import Usd

from usdskin.colorimetry import delta_e_2000, illuminant, xyz_to_lab, xyz_weights
from usdskin.errors import ImageError, LayerError
from usdskin.estimate.classes import (
    estimate_class_weights,
    read_class_map,
    report_classes,
    write_class_map,
)
from usdskin.estimate.classes.sphere import add_cells, smooth, spread
from usdskin.images import Part, read_image, write_exr
from usdskin.latlong import latlong_directions, texel_directions, texel_solid_angles
from usdskin.layers import open_stage, write_layer
from usdskin.meters import cosine_weights
from usdskin.prims import (
    ColorChart,
    Recovery,
    SpectralCamera,
    read_spectral_camera,
    write_spectral_camera,
)
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM, resample
from usdskin.uplift import reflectance_basis

GRID = DEFAULT_WAVELENGTHS_NM
ROOM = Path(__file__).resolve().parents[1] / "stages" / "capture_room" / "room.exr"
ROOM_WAVELENGTHS_NM = np.arange(380.0, 781.0, 5.0)
TO_XYZ = xyz_weights(GRID, absolute=True)
PRINTED = 1e-3  # half floats


# --- Calibrations ------------------------------------------------------------------------------


@cache
def responsivity(name="Nikon 5100 (NPL)"):
    """Return t [61, 3] of one of colour-science's cameras."""
    from colour import MSDS_CAMERA_SENSITIVITIES

    known = MSDS_CAMERA_SENSITIVITIES[name]
    return np.stack([resample(known.wavelengths, curve, GRID) for curve in known.values.T], axis=-1)


@cache
def chart():
    """Return the reflectances of the ColorChecker's 24 patches [24, 61]; 0 and 1 are skin."""
    from colour import SDS_COLOURCHECKERS

    patches = SDS_COLOURCHECKERS["ColorChecker N Ohta"].values()
    return np.array([resample(p.wavelengths, p.values, GRID, outside="hold") for p in patches])


@cache
def skins():
    """Return skin that no calibration saw, samples 15 and 18 of CIE 2017 [2, 61]."""
    from colour import SpectralShape
    from colour.quality.cfi2017 import load_TCS_CIE2017

    samples = load_TCS_CIE2017(SpectralShape(380, 780, 5))
    return np.array([resample(samples.wavelengths, samples.values[:, i], GRID) for i in (14, 17)])


def lamp(name, grid=GRID):
    """Return a lamp's radiance at luminance 1."""
    power = illuminant(name, grid)
    return power / (power @ xyz_weights(grid, absolute=True)[:, 1])


def calibration(**lamps):
    """Return a noise-free calibration with one class per lamp, by its name."""
    t = responsivity()
    recoveries, charts = [], []
    for light_class, power in lamps.items():
        light = lamp(power) if isinstance(power, str) else power
        signals = chart() * light
        values = signals @ t
        normal = values.T @ values
        ridge = 1e-6 * np.trace(normal) / 3.0 * np.eye(3)
        matrix = signals.T @ values @ np.linalg.inv(normal + ridge)
        quality = dict.fromkeys(
            ("condition", "identity_error", "loo_gfc", "loo_rmse", "loo_delta_e_2000"), 1.0
        )
        recoveries.append(
            Recovery(light_class, matrix, "regression", light, negative_share=0.0, **quality)
        )
        patches = tuple(f"patch{index}" for index in range(24))
        charts.append(ColorChart(light_class=light_class, patches=patches, camera_values=values))
    return SpectralCamera(
        "camera.usda </Camera>",
        GRID,
        t,
        np.full(3, 0.01),
        tuple(recoveries),
        charts=tuple(charts),
    )


TUBES = {"tubes": "FL2", "window": "D65"}


def white(camera, index):
    """Return the camera values of a perfect diffuser of luminance 1 in the light of a class."""
    return camera.recoveries[index].illuminant @ camera.responsivity


def mosaic(light, height=64, seed=3):
    """Return a panorama of chart colors in patches of some degrees, in one light [61]."""
    rng = np.random.default_rng(seed)
    which = rng.integers(0, 24, (height // 4, height // 2)).repeat(4, axis=0).repeat(4, axis=1)
    return ((chart() * light) @ responsivity())[which].astype(np.float32)


def with_disc(values, turns, polar, radius, color):
    """Return a panorama with a round lamp."""
    height, width, _ = values.shape
    axis = latlong_directions(np.float64(turns), np.float64(polar))
    values = values.copy()
    values[texel_directions(height, width) @ axis > np.cos(radius)] = color
    return values


def lit_mosaic(camera):
    """Return a mosaic in equal parts of both lamps, and both lamps 300 times as bright."""
    lights = [recovery.illuminant for recovery in camera.recoveries]
    values = mosaic(0.5 * (lights[0] + lights[1]))
    values = with_disc(values, 0.3, 0.8, 0.15, 300.0 * white(camera, 0))
    return with_disc(values, 0.9, 1.5, 0.15, 300.0 * white(camera, 1))


# --- Which lamp lights what --------------------------------------------------------------------


def test_one_class_lights_everything():
    camera = calibration(lamp="A")
    weights = estimate_class_weights(mosaic(lamp("A")), camera, [])
    np.testing.assert_array_equal(weights, np.ones((64, 128, 1), np.float32))


def test_weights_are_shares():
    weights = estimate_class_weights(lit_mosaic(calibration(**TUBES)), calibration(**TUBES), [])
    assert weights.dtype == np.float32 and weights.shape == (64, 128, 2)
    assert weights.min() >= 0.0
    np.testing.assert_allclose(weights.sum(axis=-1), 1.0, atol=1e-6)


def test_lamps_belong_to_their_class():
    weights = estimate_class_weights(lit_mosaic(calibration(**TUBES)), calibration(**TUBES), [])
    first, second = weights[int(64 * 0.8 / np.pi), 38], weights[int(64 * 1.5 / np.pi), 115]
    assert first[0] > 0.95
    assert second[1] > 0.95


def test_half_of_each_is_found_to_be_half():
    """The chart's own colors scatter as they are expected to, so their mean tells the light."""
    camera = calibration(**TUBES)
    values = lit_mosaic(camera)
    surfaces = estimate_class_weights(values, camera, [])[
        values.max(axis=-1) < values.max() / 100.0
    ]
    assert surfaces[:, 0].mean() == pytest.approx(0.5, abs=0.08)
    assert surfaces[:, 0].std() < 0.15


@pytest.mark.parametrize("index", [0, 1])
def test_a_lamp_that_is_not_there_gets_little(index):
    camera = calibration(**TUBES)
    light = camera.recoveries[index].illuminant
    values = with_disc(mosaic(light), 0.3, 0.8, 0.15, 300.0 * white(camera, index))
    weights = estimate_class_weights(values, camera, [])
    report = report_classes(weights, values, camera)
    assert report.flux_shares[index] > 0.93
    assert report.sphere_shares[index] > 0.75


def test_halves_of_the_sphere_in_different_light_are_told_apart():
    camera = calibration(warm="A", cool="D65")
    values = mosaic(lamp("A"))
    values[:, 64:] = mosaic(lamp("D65"))[:, 64:]
    weights = estimate_class_weights(values, camera, [])
    warm, cool = weights[20:44, 24:40, 0], weights[20:44, 88:104, 0]
    assert warm.min() > 0.7
    assert warm.min() > cool.max() + 0.25


def test_brightness_does_not_matter():
    camera = calibration(**TUBES)
    values = lit_mosaic(camera)
    weights = estimate_class_weights(values, camera, [])
    scaled = estimate_class_weights(values * np.float32(1e4), camera, [])
    np.testing.assert_allclose(scaled, weights, atol=1e-5)


def test_turned_panorama_gives_turned_weights():
    camera = calibration(**TUBES)
    values = lit_mosaic(camera)
    weights = estimate_class_weights(values, camera, [])
    turned = estimate_class_weights(np.roll(values, 40, axis=1), camera, [])
    np.testing.assert_allclose(turned, np.roll(weights, 40, axis=1), atol=2e-3)


def test_order_of_the_classes_does_not_matter():
    camera = calibration(**TUBES)
    values = lit_mosaic(camera)
    weights = estimate_class_weights(values, camera, [])
    other = estimate_class_weights(values, calibration(window="D65", tubes="FL2"), [])
    np.testing.assert_allclose(other[..., ::-1], weights, atol=1e-5)


def test_three_lamps_are_told_apart():
    camera = calibration(bulb="A", tubes="FL2", window="D65")
    values = mosaic(sum(recovery.illuminant for recovery in camera.recoveries) / 3.0)
    places = [(0.1, 0.8), (0.4, 1.2), (0.8, 1.8)]
    for index, (turns, polar) in enumerate(places):
        values = with_disc(values, turns, polar, 0.15, 300.0 * white(camera, index))
    weights = estimate_class_weights(values, camera, [])
    np.testing.assert_allclose(weights.sum(axis=-1), 1.0, atol=1e-6)
    for index, (turns, polar) in enumerate(places):
        assert weights[int(64 * polar / np.pi), int(128 * turns), index] > 0.9


def test_color_of_what_is_clipped_does_not_count():
    camera = calibration(**TUBES)
    values = with_disc(mosaic(lamp("FL2")), 0.3, 0.8, 0.3, 30.0 * white(camera, 0))
    values = with_disc(values, 0.3, 0.8, 0.1, 60.0 * white(camera, 1))
    clipped = with_disc(np.zeros((64, 128, 1), np.float32), 0.3, 0.8, 0.1, 1.0)[..., 0]
    middle = int(64 * 0.8 / np.pi), 38
    assert estimate_class_weights(values, camera, [], clipped=clipped)[middle][0] > 0.9
    assert estimate_class_weights(values, camera, [])[middle][0] < 0.1


def test_lamp_clipped_all_over_is_what_lights_its_surroundings():
    camera = calibration(**TUBES)
    light = camera.recoveries[0].illuminant
    values = with_disc(mosaic(light), 0.8, 2.0, 0.15, 100.0 * white(camera, 0))
    values = with_disc(values, 0.3, 0.8, 0.1, 60.0 * white(camera, 1))
    clipped = with_disc(np.zeros((64, 128, 1), np.float32), 0.3, 0.8, 0.1, 1.0)[..., 0]
    weights = estimate_class_weights(values, camera, [], clipped=clipped)
    assert weights[int(64 * 0.8 / np.pi), 38, 0] > 0.75


def test_texels_that_are_not_numbers_or_black_do_no_harm():
    camera = calibration(**TUBES)
    values = lit_mosaic(camera)
    weights = estimate_class_weights(values, camera, [])
    values[10, 20], values[11, 20], values[12, 20], values[13, 20] = np.nan, np.inf, 0.0, -1.0
    found = estimate_class_weights(values, camera, [])
    # Where nothing is known, the surroundings say what is likely.
    np.testing.assert_allclose(found[9:15, 19:22], weights[9:15, 19:22], atol=0.1)
    found[9:15, 19:22] = weights[9:15, 19:22]
    np.testing.assert_allclose(found, weights, atol=0.02)


def test_gray_walls_show_how_the_mixture_changes_along_them():
    """In a room whose other surfaces have the colors of a chart."""
    camera = calibration(**TUBES)
    lights = [recovery.illuminant for recovery in camera.recoveries]
    share = np.repeat(0.5 - 0.5 * np.cos(np.arange(128) * 2.0 * np.pi / 128)[None], 64, axis=0)
    luminous = np.stack([light / (light @ TO_XYZ[:, 1]) for light in lights])
    wall = (
        share[..., None] * luminous[0] + (1.0 - share[..., None]) * luminous[1]
    ) @ responsivity()
    values = np.concatenate([wall[:32], mosaic(luminous.mean(axis=0))[32:]]).astype(np.float32)
    values[44:48, 60:64] = 300.0 * wall[0, 64]
    values[44:48, 10:14] = 300.0 * wall[0, 0]
    found = estimate_class_weights(values, camera, [])[2:30, :, 0]
    # Walls may be a little yellow or blue, so part of the change counts as theirs.
    assert np.abs(found - share[2:30]).mean() < 0.2
    assert found.max() - found.min() > 0.5
    assert np.corrcoef(found.ravel(), share[2:30].ravel())[0, 1] > 0.98


def test_black_panorama_is_shared_evenly():
    weights = estimate_class_weights(np.zeros((16, 32, 3), np.float32), calibration(**TUBES), [])
    np.testing.assert_allclose(weights, 0.5)


def test_same_panorama_gives_the_same_bytes():
    camera = calibration(**TUBES)
    values = lit_mosaic(camera)
    first, second = (estimate_class_weights(values, camera, []) for _ in range(2))
    assert first.tobytes() == second.tobytes()


def test_calibration_from_a_layer_gives_the_same_weights(tmp_path):
    camera = calibration(**TUBES)
    stage = Usd.Stage.CreateInMemory()
    stage.SetDefaultPrim(write_spectral_camera(stage, "/Camera", camera))
    write_layer(stage, tmp_path / "camera.usda")
    read = read_spectral_camera(open_stage(tmp_path / "camera.usda"))
    values = lit_mosaic(camera)
    expected = estimate_class_weights(values, camera, [])
    np.testing.assert_allclose(estimate_class_weights(values, read, []), expected, atol=1e-6)


def test_lamps_that_look_alike_are_refused():
    camera = calibration(left="D65", right=lamp("D65") * (1.0 + 1e-5 * (GRID - 550.0)))
    with pytest.raises(LayerError, match=r"camera.usda </Camera>: light classes left and right"):
        estimate_class_weights(mosaic(lamp("D65")), camera, [])


def test_lamps_that_look_similar_are_noted():
    notes = []
    estimate_class_weights(mosaic(lamp("D65")), calibration(old="D65", new="D60"), notes)
    assert [note.code for note in notes] == ["light-classes-close"]


def test_lamp_that_nobody_calibrated_is_noted():
    notes = []
    camera = calibration(**TUBES)
    values = with_disc(
        lit_mosaic(camera), 0.6, 1.5, 0.3, 400.0 * white(camera, 0) * [4.0, 0.2, 0.1]
    )
    estimate_class_weights(values, camera, notes)
    assert [note.code for note in notes] == ["light-not-calibrated"]
    notes.clear()
    estimate_class_weights(lit_mosaic(camera), camera, notes)
    assert not notes


@pytest.mark.slow
def test_large_panoramas_take_little_memory():
    """4096 x 2048 and two classes: 64 MiB of weights, and blocks of rows."""
    import tracemalloc

    camera = calibration(**TUBES)
    values = lit_mosaic(camera).repeat(32, axis=0).repeat(32, axis=1)
    tracemalloc.start()
    weights = estimate_class_weights(values, camera, [])
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert weights.shape == (2048, 4096, 2)
    assert peak < 200 * 2**20


# --- A room with two lamps ---------------------------------------------------------------------


@cache
def room_coefficients():
    """Return the room's coefficients, three of each lamp, shape [512, 1024, 6]."""
    return read_image(ROOM).pixels.astype(np.float64)


@cache
def cosines():
    """Return projected solid angles of the cells of a 64 x 128 map at 64 normals [64, 8192]."""
    step = (np.arange(64) + 0.5) / 64
    normals = latlong_directions(np.arange(64) * 0.381966, np.arccos(1.0 - 2.0 * step))
    rows, columns = np.arange(64)[:, None], np.arange(128)[None, :]
    return np.array([cosine_weights(rows, columns, 64, 128, n).ravel() for n in normals])


def irradiance(values):
    """Return the irradiance at 64 normals, shape [64, channels]."""
    height, width, count = values.shape
    cells = np.zeros((64, 128, count))
    add_cells(
        cells, values * texel_solid_angles(height, width)[:, None, None], slice(0, height), height
    )
    return cosines() @ (cells / texel_solid_angles(64, 128)[:, None, None]).reshape(-1, count)


class Room:
    """The capture room under two lamps, the second so many times as strong as it is there."""

    def __init__(self, first, second, strength=1.0, colors=(0, 1, 2)):
        basis = [
            (reflectance_basis(ROOM_WAVELENGTHS_NM) * lamp(name, ROOM_WAVELENGTHS_NM))[:, 4:65]
            for name in (first, second)
        ]
        parts = room_coefficients().reshape(512, 1024, 2, 3)[..., list(colors)] * (
            (1.0,),
            (strength,),
        )
        self.camera = calibration(first=first, second=second)
        self.values = (parts.reshape(512, 1024, 6) @ np.concatenate(basis) @ responsivity()).astype(
            np.float32
        )
        luminance = [parts[..., k, :] @ (basis[k] @ TO_XYZ[:, 1]) for k in (0, 1)]
        total = np.maximum(luminance[0] + luminance[1], 1e-12)
        self.truth = np.stack([part / total for part in luminance], axis=-1).astype(np.float32)
        self.light = irradiance(parts.reshape(512, 1024, 6)) @ np.concatenate(basis)

    def recovered(self, weights):
        """Return the irradiance of the recovered environment, shape [64, 61]."""
        shared = (weights[..., None] * self.values[..., None, :]).reshape(512, 1024, 6)
        matrices = [recovery.matrix.T for recovery in self.camera.recoveries]
        return irradiance(shared) @ np.concatenate(matrices)

    def errors(self, weights):
        """Return dE2000 of skin under it, against the brightest perfect diffuser [3 * 64]."""
        recovered, whites = self.recovered(weights), self.light @ TO_XYZ
        diffuser = whites[whites[:, 1].argmax()]
        found = []
        for skin in (*skins(), chart()[1]):
            labs = [
                xyz_to_lab((light * skin) @ TO_XYZ, diffuser) for light in (recovered, self.light)
            ]
            found.append(delta_e_2000(*labs))
        return np.concatenate(found)


def only(index):
    """Return weights of a single class."""
    return np.broadcast_to(np.eye(2, dtype=np.float32)[index], (512, 1024, 2))


def described(errors):
    return f"mean {errors.mean():.3f}, p95 {np.percentile(errors, 95):.3f}"


def test_skin_in_a_room_of_tubes_and_window_has_its_color():
    """Issue 4's bar: mean <= 0.5, p95 <= 1.2; one lamp for all misses by far more."""
    room = Room("FL2", "D65")
    estimated = room.errors(estimate_class_weights(room.values, room.camera, []))
    print(f"\nestimated: {described(estimated)}")
    print(f"true shares: {described(room.errors(room.truth))}")
    for index, name in enumerate(("tubes", "window")):
        single = room.errors(only(index))
        print(f"{name} only: {described(single)}")
        assert single.mean() > 3.0 * estimated.mean()
    assert estimated.mean() <= 0.2
    assert np.percentile(estimated, 95) <= 0.5


@pytest.mark.parametrize(
    ("first", "second", "strength", "colors"),
    [
        ("FL2", "D65", 0.25, (0, 1, 2)),
        ("FL2", "D65", 4.0, (0, 1, 2)),
        ("FL2", "D65", 1.0, (2, 1, 0)),
        ("A", "D65", 0.3, (0, 1, 2)),
        ("FL11", "D65", 1.0, (0, 1, 2)),
        ("LED-B3", "D65", 1.0, (0, 1, 2)),
        ("A", "FL11", 1.0, (0, 1, 2)),
    ],
)
def test_other_lamps_strengths_and_paints_do_as_well(first, second, strength, colors):
    room = Room(first, second, strength, colors)
    errors = room.errors(estimate_class_weights(room.values, room.camera, []))
    print(f"\n{first}, {strength} x {second}: {described(errors)}")
    print(f"true shares: {described(room.errors(room.truth))}")
    assert errors.mean() <= 0.35
    assert np.percentile(errors, 95) <= 0.6


def noisy_calibration(**lamps):
    """Return what calibration makes of 1 % noise of patches and 0.3 % of spectra."""
    from usdskin.estimate.recovery import Training, estimate_responsivity, recover

    rng = np.random.default_rng(1)
    names = tuple(f"patch{index}" for index in range(24))
    trainings = []
    for light_class, power in lamps.items():
        signals = chart() * lamp(power)
        values = signals @ responsivity() * (1.0 + 0.01 * rng.normal(size=(24, 3)))
        signals = signals * (1.0 + 0.003 * rng.normal(size=signals.shape))
        trainings.append(
            Training(names, values, signals, GRID, lamp(power), light_class=light_class)
        )
    t = estimate_responsivity(trainings)
    return SpectralCamera(
        "camera.usda </Camera>",
        GRID,
        t.values,
        np.full(3, 0.01),
        tuple(recover(training, t) for training in trainings),
        charts=tuple(
            ColorChart(light_class=training.light_class, camera_values=training.camera_values)
            for training in trainings
        ),
    )


def test_noise_of_chart_and_panorama_leaves_skin_its_color():
    room = Room("FL2", "D65")
    room.camera = noisy_calibration(first="FL2", second="D65")
    noise = np.random.default_rng(13).normal(size=room.values.shape).astype(np.float32)
    weights = estimate_class_weights(room.values * (1.0 + 0.005 * noise), room.camera, [])
    errors = room.errors(weights)
    print(f"\nnoise of 1 %, 0.3 % and 0.5 %: {described(errors)}")
    print(f"true shares: {described(room.errors(room.truth))}")
    assert errors.mean() <= 0.5
    assert np.percentile(errors, 95) <= 1.2


def test_painted_map_serves_where_lamps_look_alike():
    camera = calibration(left="D65", right=lamp("D65") * (1.0 + 1e-5 * (GRID - 550.0)))
    weights = random_weights(2, 64)
    report = report_classes(weights, mosaic(lamp("D65")), camera)
    assert report.separations[("left", "right")] < 0.01


# --- Sums on the sphere ------------------------------------------------------------------------


def test_smoothing_an_even_sphere_gives_the_kernel_s_integral():
    """Of exp((cos - 1) / r^2) over the sphere: 2 pi r^2 (1 - exp(-2 / r^2))."""
    sizes = np.repeat(texel_solid_angles(64, 128)[:, None, None], 128, axis=1)
    expected = 2.0 * np.pi * 0.25 * (1.0 - np.exp(-2.0 / 0.25))
    np.testing.assert_allclose(smooth(sizes, 0.5), expected, rtol=1e-3)


def test_smoothing_reaches_over_poles_and_seam():
    """A point's image depends on the angle to it alone."""
    point = np.zeros((64, 128, 1))
    point[1, 0] = 1.0
    directions = texel_directions(64, 128)
    cosine = directions @ directions[1, 0]
    np.testing.assert_allclose(
        smooth(point, 0.3)[..., 0], np.exp((cosine - 1.0) / 0.09), atol=1e-12
    )


def test_sums_into_cells_keep_everything():
    values = np.random.default_rng(1).random((50, 90, 2))
    cells = np.zeros((7, 13, 2))
    for rows in (slice(0, 20), slice(20, 50)):
        add_cells(cells, values[rows], rows, 50)
    np.testing.assert_allclose(cells.sum(axis=(0, 1)), values.sum(axis=(0, 1)))


def test_spreading_keeps_lines_straight_and_meets_at_the_seam():
    cells = np.cos(2.0 * np.pi * (np.arange(64) + 0.5) / 64)[None, :, None] * np.ones((4, 1, 1))
    fine = spread(cells, slice(0, 32), 32, 512)
    expected = np.cos(2.0 * np.pi * (np.arange(512) + 0.5) / 512)
    np.testing.assert_allclose(fine[..., 0], np.broadcast_to(expected, (32, 512)), atol=2e-3)


# --- Maps --------------------------------------------------------------------------------------


def random_weights(count, height=32, seed=5):
    weights = np.random.default_rng(seed).random((height, 2 * height, count)) ** 3
    return (weights / weights.sum(axis=-1, keepdims=True)).astype(np.float32)


def write_picture(path, pixels, kind):
    """Write integers as a paint program would."""
    height, width, count = pixels.shape
    output = OpenImageIO.ImageOutput.create(str(path))
    assert output.open(str(path), OpenImageIO.ImageSpec(width, height, count, kind))
    assert output.write_image(pixels)
    output.close()


@pytest.mark.parametrize("count", [1, 2, 3, 5])
def test_class_map_round_trips(tmp_path, count):
    names = [f"lamp{index}" for index in range(count)]
    weights = random_weights(count)
    write_class_map(tmp_path / "map.exr", weights, names)
    read = read_class_map(tmp_path / "map.exr", names, 32, 64)
    np.testing.assert_allclose(read, weights, atol=PRINTED)
    np.testing.assert_allclose(read.sum(axis=-1), 1.0, atol=1e-6)


def test_up_to_three_classes_are_the_colors_of_a_picture(tmp_path):
    write_class_map(tmp_path / "map.exr", random_weights(2), ["tubes", "window"])
    image = read_image(tmp_path / "map.exr")
    assert image.channel_names == ("R", "G", "B")
    assert image.color_space == "data"
    assert image.sample_type == "half"
    assert not image.pixels[..., 2].any()


def test_more_classes_are_channels_of_their_names(tmp_path):
    names = ["tubes", "window", "bulb", "screen"]
    write_class_map(tmp_path / "map.exr", random_weights(4), names)
    assert set(read_image(tmp_path / "map.exr").channel_names) == set(names)


@pytest.mark.parametrize("names", [["A", "FL2", "D65", "Z"], ["FL2", "A"], ["A", "Z"]])
def test_classes_may_be_called_as_alpha_and_depth(tmp_path, names):
    """CIE's incandescent illuminant is A."""
    weights = random_weights(len(names))
    write_class_map(tmp_path / "map.exr", weights, names)
    read = read_class_map(tmp_path / "map.exr", names, 32, 64)
    np.testing.assert_allclose(read, weights, atol=PRINTED)
    channels = {name: weights[..., index] for index, name in enumerate(names)}
    write_exr(tmp_path / "named.exr", [Part("", channels, {}, "half")])
    read = read_class_map(tmp_path / "named.exr", names, 32, 64)
    np.testing.assert_allclose(read, weights, atol=PRINTED)


@pytest.mark.parametrize("ending", ["png", "tif"])
@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_painted_indices_are_classes(tmp_path, ending, kind):
    which = np.random.default_rng(2).integers(0, 4, (16, 32, 1))
    write_picture(tmp_path / f"map.{ending}", which.astype(kind), kind)
    read = read_class_map(tmp_path / f"map.{ending}", list("abcd"), 16, 32)
    np.testing.assert_array_equal(read, np.eye(4, dtype=np.float32)[which[..., 0]])


@pytest.mark.parametrize("kind", ["half", "float", "uint"])
def test_indices_in_an_exr_are_classes(tmp_path, kind):
    which = np.random.default_rng(2).integers(0, 2, (16, 32)).astype(np.uint32)
    pixels = which if kind == "uint" else which.astype(np.float32)
    write_exr(tmp_path / "map.exr", [Part("", {"Y": pixels}, {}, kind)])
    read = read_class_map(tmp_path / "map.exr", ["a", "b"], 16, 32)
    np.testing.assert_array_equal(read[..., 1], which)


@pytest.mark.parametrize("alpha", [False, True])
@pytest.mark.parametrize("kind", ["uint8", "uint16"])
def test_painted_colors_are_shares(tmp_path, kind, alpha):
    pixels = np.zeros((16, 32, 3 + alpha), kind)
    pixels[:, :16, 0], pixels[:, 16:, :2] = 200, 50
    if alpha:
        pixels[..., 3] = 100
    write_picture(tmp_path / "map.png", pixels, kind)
    read = read_class_map(tmp_path / "map.png", ["a", "b"], 16, 32)
    np.testing.assert_array_equal(read[:, :16], np.broadcast_to([1.0, 0.0], (16, 16, 2)))
    np.testing.assert_allclose(read[:, 16:], 0.5)


def test_larger_map_is_averaged_and_smaller_one_interpolated(tmp_path):
    weights = random_weights(2, 32)
    write_class_map(tmp_path / "map.exr", weights, ["a", "b"])
    smaller = read_class_map(tmp_path / "map.exr", ["a", "b"], 16, 32)
    means = weights.reshape(16, 2, 32, 2, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(smaller, means, atol=PRINTED)
    larger = read_class_map(tmp_path / "map.exr", ["a", "b"], 96, 192)
    np.testing.assert_allclose(larger[1::3, 1::3], weights, atol=PRINTED)
    np.testing.assert_allclose(larger.sum(axis=-1), 1.0, atol=1e-6)


def refused(path, names, *expected):
    with pytest.raises(ImageError) as error:
        read_class_map(path, names, 16, 32)
    message = str(error.value)
    assert "\n" not in message
    for part in (str(path), *expected):
        assert part in message


def test_unknown_index_is_refused_where_it_is(tmp_path):
    which = np.zeros((16, 32, 1), np.uint8)
    which[11, 7] = 3
    write_picture(tmp_path / "map.png", which, "uint8")
    refused(tmp_path / "map.png", ["a", "b"], "pixel (7, 11)", "class 3", "0 to 1 (a, b)")


def test_half_an_index_is_refused(tmp_path):
    """As where an index map was scaled by a program that interpolates."""
    pixels = np.zeros((16, 32), np.float32)
    pixels[2, 3] = 0.5
    write_exr(tmp_path / "map.exr", [Part("", {"Y": pixels})])
    refused(tmp_path / "map.exr", ["a", "b"], "pixel (3, 2)", "class 0.5")


@pytest.mark.parametrize(
    ("value", "expected"),
    [
        ([0.0, 0.0, 0.0], "no weight for any class"),
        ([-0.5, 1.0, 0.0], "a weight of -0.5"),
        ([np.nan, 1.0, 0.0], "a weight of nan"),
        ([0.5, 0.25, 0.25], "0.25 in B, but the classes are a, b"),
    ],
)
def test_impossible_weights_are_refused_where_they_are(tmp_path, value, expected):
    pixels = np.zeros((16, 32, 3), np.float32)
    pixels[..., 0] = 1.0
    pixels[9, 30] = value
    write_exr(tmp_path / "map.exr", [Part("", {"": pixels}, {}, "float", "lin_rec709_scene")])
    refused(tmp_path / "map.exr", ["a", "b"], "pixel (30, 9)", expected)


def test_map_of_another_shape_is_refused(tmp_path):
    write_picture(tmp_path / "map.png", np.zeros((16, 16, 1), np.uint8), "uint8")
    refused(tmp_path / "map.png", ["a", "b"], "16 x 16 pixels", "twice as wide as high")


def test_map_of_other_classes_is_refused(tmp_path):
    write_class_map(tmp_path / "map.exr", random_weights(2), ["a", "b"])
    refused(tmp_path / "map.exr", ["b", "a"], "made for the classes a, b, not b, a")


def test_map_with_too_few_channels_is_refused(tmp_path):
    pixels = np.ones((16, 32, 3), np.float32)
    write_exr(tmp_path / "map.exr", [Part("", {"": pixels}, {}, "float", "lin_rec709_scene")])
    refused(tmp_path / "map.exr", list("abcd"), "channels R, G, B", "named after each class")


def test_missing_map_is_refused(tmp_path):
    refused(tmp_path / "none.exr", ["a", "b"], "no such file")


# --- Report ------------------------------------------------------------------------------------


def test_report_tells_light_and_sphere_of_each_class():
    """The lower hemisphere in the second light is three times as bright."""
    camera = calibration(**TUBES)
    values = np.empty((32, 64, 3), np.float32)
    values[:16], values[16:] = white(camera, 0), 3.0 * white(camera, 1)
    weights = np.zeros((32, 64, 2), np.float32)
    weights[:16, :, 0] = weights[16:, :, 1] = 1.0
    report = report_classes(weights, values, camera)
    assert report.names == ("tubes", "window")
    np.testing.assert_allclose(report.sphere_shares, [0.5, 0.5], rtol=1e-6)
    np.testing.assert_allclose(report.flux_shares, [0.25, 0.75], atol=0.005)
    assert report.separations[("tubes", "window")] == pytest.approx(0.403, abs=0.01)
    assert report.lines()[0].startswith("tubes: 2")
