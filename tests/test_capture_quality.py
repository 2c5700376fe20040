"""Lamps, scale, report and quality picture of a capture, on panoramas whose truth is known."""

from __future__ import annotations

import json
import math
import re
from pathlib import Path

import numpy as np
import pytest

from usdskin.capture.quality.lamps import find_lamps, replace_lamp
from usdskin.capture.quality.picture import HEIGHT, WIDTH, quality_picture
from usdskin.capture.quality.report import (
    CaptureReport,
    PanoramaFigures,
    ViewReport,
    measure_panorama,
    report_lamp,
    report_view,
)
from usdskin.capture.quality.scale import MeasuredLamp, Scale, scale_of
from usdskin.errors import LayerError, UsageError
from usdskin.latlong import latlong_coordinates, texel_directions, texel_solid_angles
from usdskin.meters import (
    cosine_weights,
    flux,
    irradiance,
    radiance_at,
    sphere_share,
    texel_vectors,
)
from usdskin.photographs.merge import ExposurePair, MergeReport
from usdskin.prims.brackets import ExposureBracket
from usdskin.prims.captures import Shoot
from usdskin.prims.lenses import FisheyeLens
from usdskin.prims.views import View

GREEN = np.array([0.0, 1.0, 0.0])
WEIGHTS = np.array([0.2, 0.7, 0.1])
H, W = 128, 256
PLACES = {
    "middle": (0.3, 0.4, 0.9),
    "seam": (0.001, 0.3, -1.0),
    "zenith": (0.02, 1.0, 0.01),
    "nadir": (0.0, -1.0, 0.0),
}


def unit(direction):
    return np.asarray(direction, float) / np.linalg.norm(direction)


def directions(count, seed=1):
    random = np.random.default_rng(seed).normal(size=(count, 3))
    return [*np.eye(3), *-np.eye(3), *(unit(row) for row in random)]


def disc(direction, radius_deg, height=H, width=W, samples=8):
    """Return the share of each texel's area within a round spot."""
    fine = texel_directions(height * samples, width * samples) @ unit(direction)
    inside = fine >= math.cos(math.radians(radius_deg))
    size = np.broadcast_to(texel_solid_angles(height * samples, width)[:, None], inside.shape)
    blocks = (height, samples, width, samples)
    part = (inside * size).reshape(blocks).sum(axis=(1, 3))
    return (part / size.reshape(blocks).sum(axis=(1, 3))).astype(np.float32)


def room(lamps, height=H, width=W, wall=(0.02, 0.03, 0.01)):
    """Return values and clipped shares of walls with (direction, radius, radiance) lamps."""
    values = np.broadcast_to(np.float32(wall), (height, width, 3)).copy()
    clipped = np.zeros((height, width), np.float32)
    for direction, radius_deg, radiance in lamps:
        share = disc(direction, radius_deg, height, width)
        values += share[..., None] * (np.float32(radiance) - values)
        clipped = np.maximum(clipped, share)
    return values, clipped


def seen_all(values):
    return np.ones(values.shape[:2], np.float32)


# --- What a meter reads ------------------------------------------------------------------------


@pytest.mark.parametrize("height", [32, 64, 257])
def test_uniform_sphere_gives_pi_in_every_direction(height):
    values = np.full((height, 2 * height, 3), 2.5, np.float32)
    for direction in directions(30):
        np.testing.assert_allclose(irradiance(values, direction), 2.5 * np.pi, rtol=1e-6)


def test_hemisphere_gives_its_view_factor():
    """A sky of radiance 1 down to the horizon lights a tilted plane by pi (1 + cos t) / 2."""
    sky = np.zeros((64, 128), np.float32)
    sky[:32] = 1.0
    for tilt in np.linspace(0.0, np.pi, 13):
        toward = [math.sin(tilt) * 0.6, math.cos(tilt), math.sin(tilt) * 0.8]
        expected = np.pi * (1.0 + math.cos(tilt)) / 2.0
        assert float(irradiance(sky, toward)) == pytest.approx(expected, abs=1e-6)


def test_irradiance_is_the_sum_over_finely_divided_texels():
    height, width, fine = 8, 16, 128
    values = np.random.default_rng(3).random((height, width, 2)).astype(np.float32)
    size = texel_solid_angles(height * fine, width * fine)[:, None]
    at = texel_directions(height * fine, width * fine)
    for direction in directions(3)[6:]:
        weights = (np.maximum(at @ direction, 0.0) * size).reshape(height, fine, width, fine)
        expected = np.einsum("ijk,ij->k", values.astype(float), weights.sum(axis=(1, 3)))
        np.testing.assert_allclose(irradiance(values, direction), expected, rtol=5e-6)


def test_weights_of_single_texels_are_those_of_the_map():
    direction = unit([0.3, -0.5, 0.2])
    every = cosine_weights(np.arange(16)[:, None], np.arange(32)[None, :], 16, 32, direction)
    rows, columns = np.array([0, 7, 8, 15]), np.array([31, 0, 16, 5])
    single = cosine_weights(rows, columns, 16, 32, direction)
    np.testing.assert_array_equal(single, every[rows, columns])


def test_texel_vectors_add_up_to_nothing_and_point_to_their_texels():
    rows, columns = texel_vectors(33, 66)
    vectors = rows[:, None] * columns
    np.testing.assert_allclose(vectors.sum(axis=(0, 1)), 0.0, atol=1e-12)
    length = np.linalg.norm(vectors, axis=-1)
    cosine = (vectors * texel_directions(33, 66)).sum(axis=-1) / length
    assert cosine.min() > 1.0 - 1e-3
    small = length / texel_solid_angles(33, 66)[:, None]
    assert small.max() <= 1.0 and small.min() > 0.998


def test_spot_meter_reads_the_mean_of_what_it_sees_at_seam_and_poles():
    for place in PLACES.values():
        target = disc(place, 3.0)
        assert float(radiance_at(target, place, 1.0)) == 1.0
        # A spot of twice the radius holds four times the area.
        assert float(radiance_at(target, place, 6.0)) == pytest.approx(0.25, abs=0.01)
    uniform = np.full((8, 16, 3), 0.7, np.float32)
    np.testing.assert_allclose(radiance_at(uniform, [0.0, 2.0, 0.0], 20.0), 0.7, rtol=1e-7)


def test_flux_and_shares_of_the_sphere():
    assert float(flux(np.ones((16, 32)))) == pytest.approx(4.0 * np.pi, rel=1e-14)
    mask = np.zeros((16, 32), bool)
    mask[:8] = True
    assert sphere_share(mask) == pytest.approx(0.5)


# --- Lamps -------------------------------------------------------------------------------------


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_lamp_is_found_whole_where_it_is_and_as_large_as_it_is(place):
    radius = 4.0
    values, clipped = room([(place, radius, (5.0, 5.0, 5.0))], wall=(0.0, 0.0, 0.0))
    (lamp,) = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    assert np.rad2deg(np.arccos(min(lamp.direction @ unit(place), 1.0))) < 0.05
    omega = float(flux(clipped))
    assert lamp.solid_angle_sr == pytest.approx(omega, rel=1e-6)
    assert lamp.diameter_deg == pytest.approx(2.0 * radius, rel=0.02)
    # A disc of radiance L and radius r gives pi L sin^2 r to a surface that faces it.
    cosine = 1.0 - omega / (2.0 * np.pi)
    np.testing.assert_allclose(lamp.irradiance, 5.0 * np.pi * (1.0 - cosine**2), rtol=2e-4)
    assert lamp.flux_share == pytest.approx(1.0, rel=1e-6)
    assert lamp.irradiance_share == pytest.approx(1.0, rel=1e-3)
    assert not lamp.reaches_unseen


def test_lamp_box_counts_on_across_the_seam():
    values, clipped = room([(PLACES["seam"], 4.0, (1, 1, 1)), (PLACES["middle"], 3.0, (1, 1, 1))])
    lamps = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    for lamp in lamps:
        top, left, height, width = lamp.box
        inside = (lamp.columns - left) % W
        assert 0 <= left < W and inside.min() == 0 and inside.max() == width - 1 < W // 4
        assert lamp.rows.min() == top and lamp.rows.max() == top + height - 1
    assert max(lamp.box[1] + lamp.box[3] for lamp in lamps) > W


def test_texels_touching_at_corners_and_over_the_pole_are_one_lamp():
    clipped = np.zeros((H, W), np.float32)
    clipped[[10, 11, 12], [W - 1, 0, 1]] = 1.0
    clipped[0, [3, 130]] = 1.0
    clipped[60, 60] = clipped[60, 62] = 1.0
    values = np.ones((H, W, 3), np.float32)
    lamps = find_lamps(values, clipped, seen_all(values), GREEN)
    counts = sorted(lamp.rows.size for lamp in lamps)
    assert counts == [1, 1, 2, 3]


def test_lamps_come_largest_first_with_shares_that_add_up():
    sizes = {"middle": 2.0, "seam": 5.0, "zenith": 3.0}
    values, clipped = room([(PLACES[name], size, (8, 8, 8)) for name, size in sizes.items()])
    lamps = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    found = [min(PLACES, key=lambda name: -lamp.direction @ unit(PLACES[name])) for lamp in lamps]
    assert found == ["seam", "zenith", "middle"]
    total = float(flux(values) @ WEIGHTS)
    light = float(flux(values * (clipped > 0.0)[..., None]) @ WEIGHTS)
    assert sum(lamp.flux_share for lamp in lamps) == pytest.approx(light / total, rel=0.01)
    for lamp in lamps:
        expected = float(lamp.irradiance @ WEIGHTS / (irradiance(values, lamp.direction) @ WEIGHTS))
        assert lamp.irradiance_share == pytest.approx(expected, rel=2e-3)
        np.testing.assert_allclose(lamp.irradiance_at(lamp.direction), lamp.irradiance)


def test_wall_behind_a_partly_clipped_texel_is_no_part_of_the_lamp():
    """A lamp smaller than the texels around it still has its own light only."""
    radius, radiance = 2.2, 50.0
    omega = 2.0 * np.pi * (1.0 - math.cos(math.radians(radius)))
    values, clipped = room([(PLACES["middle"], radius, (radiance,) * 3)], wall=(4.0, 4.0, 4.0))
    (lamp,) = find_lamps(values, clipped, seen_all(values), GREEN)
    assert lamp.flux_share * float(flux(values) @ GREEN) == pytest.approx(
        radiance * omega, rel=0.01
    )


def test_lamp_at_the_edge_of_a_hole_is_said_to_go_on():
    values, clipped = room([(PLACES["middle"], 4.0, (1, 1, 1)), (PLACES["nadir"], 4.0, (1, 1, 1))])
    seen = seen_all(values) - disc((0.0, -1.0, 0.0), 20.0) * (clipped == 0.0)
    lamps = find_lamps(values, clipped, seen.astype(np.float32), GREEN)
    assert {lamp.direction[1] < -0.9: lamp.reaches_unseen for lamp in lamps} == {
        True: True,
        False: False,
    }


def test_nothing_clipped_is_no_lamp_and_everything_clipped_is_one():
    values = np.ones((16, 32, 3), np.float32)
    assert find_lamps(values, np.zeros((16, 32), np.float32), seen_all(values), GREEN) == ()
    (lamp,) = find_lamps(values, np.ones((16, 32), np.float32), seen_all(values), GREEN)
    assert lamp.solid_angle_sr == pytest.approx(4.0 * np.pi)
    assert lamp.diameter_deg == pytest.approx(360.0)
    assert np.linalg.norm(lamp.direction) == pytest.approx(1.0)
    assert lamp.box == (0, 0, 16, 32)
    np.testing.assert_allclose(lamp.irradiance, np.pi, rtol=1e-4)


# --- Replacing a lamp --------------------------------------------------------------------------


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
@pytest.mark.parametrize("radius", [0.25, 4.0])
def test_replaced_lamp_gives_a_surface_facing_it_the_reading(place, radius):
    values, clipped = room([(place, radius, (9.0, 9.0, 9.0))])
    (lamp,) = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    before, stddev = values.copy(), 0.01 * values
    reading = 7.3 * float(lamp.irradiance @ WEIGHTS)
    result = replace_lamp(values, stddev, clipped, lamp, reading, WEIGHTS)
    rise = float(
        (irradiance(values, lamp.direction) - irradiance(before, lamp.direction)) @ WEIGHTS
    )
    assert rise == pytest.approx(reading - float(lamp.irradiance @ WEIGHTS), rel=1e-6)
    assert result.factor == pytest.approx(7.3)
    # The missing flux is the lamp's share times k - 1.
    total = float(flux(before) @ WEIGHTS)
    gain = float(flux(values) @ WEIGHTS) / total - 1.0
    assert gain == pytest.approx(6.3 * lamp.flux_share, rel=1e-5)
    untouched = clipped == 0.0
    np.testing.assert_array_equal(values[untouched], before[untouched])
    np.testing.assert_allclose(stddev, 0.01 * values, rtol=1e-5)


def test_replacement_restores_a_clipped_panorama():
    """Clip a true panorama, measure the lamp, and get the truth back, color and all."""
    color = np.array([1.6, 1.0, 0.4])
    truth, _ = room([(PLACES["seam"], 4.0, 40.0 * color)])
    penumbra = disc(PLACES["seam"], 6.5) * (1.0 - disc(PLACES["seam"], 5.0))
    truth += penumbra[..., None] * np.float32(8.0 * color)
    clipped = (truth.max(axis=2) > 14.0).astype(np.float32)
    values = np.minimum(truth, np.float32(14.0))
    (lamp,) = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    at = lamp.direction
    true_lamp = irradiance(truth * clipped[..., None], at)
    stddev = np.zeros_like(values)
    result = replace_lamp(values, stddev, clipped, lamp, float(true_lamp @ WEIGHTS), WEIGHTS)
    assert result.color_source == "ring"
    np.testing.assert_allclose(irradiance(values, at), irradiance(truth, at), rtol=0.01)


def test_no_channel_falls_below_what_the_clipped_pixels_show():
    values, clipped = room([(PLACES["middle"], 4.0, (10.0, 10.0, 10.0))])
    ring = (disc(PLACES["middle"], 7.0) > 0.0) & (clipped == 0.0)
    values[ring] = (9.0, 3.0, 0.5)
    (lamp,) = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    before = values.copy()
    reading = 1.1 * float(lamp.irradiance @ WEIGHTS)
    replace_lamp(values, np.zeros_like(values), clipped, lamp, reading, WEIGHTS)
    assert (values >= before - 1e-5).all()
    after = irradiance(values, lamp.direction) - irradiance(before, lamp.direction)
    assert float((lamp.irradiance + after) @ WEIGHTS) == pytest.approx(reading, rel=1e-6)
    assert after[0] > 0.0 and after[2] == pytest.approx(0.0, abs=1e-6)


def test_wall_beside_a_sharp_lamp_does_not_color_it():
    values, clipped = room([(PLACES["middle"], 4.0, (10.0, 10.0, 10.0))], wall=(0.5, 0.1, 0.02))
    (lamp,) = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    reading = 3.0 * float(lamp.irradiance @ WEIGHTS)
    result = replace_lamp(values, np.zeros_like(values), clipped, lamp, reading, WEIGHTS)
    assert result.color_source == "clipped"
    full = values[clipped == 1.0]
    np.testing.assert_allclose(full, 30.0, rtol=1e-5)


def test_reading_far_below_the_lower_bound_is_refused_with_both_figures():
    values, clipped = room([(PLACES["middle"], 4.0, (10.0, 10.0, 10.0))])
    (lamp,) = find_lamps(values, clipped, seen_all(values), WEIGHTS)
    least = float(lamp.irradiance @ WEIGHTS)
    before = values.copy()
    with pytest.raises(UsageError, match=r"0\.50 times .* column \d+, row \d+"):
        replace_lamp(values, np.zeros_like(values), clipped, lamp, 0.5 * least, WEIGHTS)
    np.testing.assert_array_equal(values, before)
    # Meters and cameras differ by some percent: then the reading holds.
    result = replace_lamp(values, np.zeros_like(values), clipped, lamp, 0.95 * least, WEIGHTS)
    assert result.factor == pytest.approx(0.95)


# --- Scale -------------------------------------------------------------------------------------


def shoot(**given):
    return Shoot(where="shoot.usda </Shoot>", name="Shoot", views=(), **given)


def scaled(values, clipped, seen=None, turn=None, measured=(), **given):
    notes = []
    seen = seen_all(values) if seen is None else seen
    turn = np.eye(3) if turn is None else turn
    found = scale_of(shoot(**given), values, clipped, seen, turn, notes, measured=measured)
    return found, notes


def test_both_readings_of_a_true_panorama_give_one_scale_and_miss_nothing():
    values, clipped = room([(PLACES["middle"], 4.0, (3.0, 2.0, 1.0))])
    clipped[:] = 0.0
    gray, up = unit([-1.0, -0.2, 0.1]), unit([0.1, 1.0, 0.3])
    given = {
        "luminance": 1234.0 * 0.026,
        "luminance_direction": gray,
        "illuminance_lx": 1234.0 * float(irradiance(values, up) @ WEIGHTS),
        "illuminance_direction": up,
        "luminance_weights": WEIGHTS,
    }
    both, notes = scaled(values, clipped, **given)
    assert (both.source, both.units, notes) == ("luminance", "absolute", [])
    assert both.factor == pytest.approx(1234.0, rel=1e-6)
    assert both.missing_lx == pytest.approx(0.0, abs=1e-3)
    by_lux, _ = scaled(values, clipped, **{**given, "luminance": 0.0})
    assert by_lux.source == "illuminance"
    assert by_lux.factor == pytest.approx(1234.0, rel=1e-6)


def test_readings_follow_the_stage_to_the_panorama():
    turn = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])  # a Z-up stage
    values = np.zeros((H, W, 3), np.float32)
    values[: H // 2] = 1.0
    found, _ = scaled(
        values,
        np.zeros((H, W), np.float32),
        turn=turn,
        luminance=50.0,
        luminance_direction=np.array([0.1, 0.2, 0.9]),
    )
    assert found.factor == pytest.approx(50.0)


def test_missing_illuminance_is_that_of_the_clipped_lamp():
    truth, clipped = room([((0.1, 1.0, 0.0), 3.0, (60.0, 60.0, 60.0))])
    values = np.minimum(truth, np.float32(20.0))
    up = np.array([0.0, 1.0, 0.0])
    given = {
        "luminance": 100.0 * 0.03,
        "luminance_direction": unit([1.0, -0.3, 0.0]),
        "illuminance_lx": 100.0 * float(irradiance(truth, up)[1]),
        "illuminance_direction": up,
    }
    found, _ = scaled(values, clipped, **given)
    expected = 100.0 * float((irradiance(truth, up) - irradiance(values, up))[1])
    assert found.missing_lx == pytest.approx(expected, rel=1e-5)
    assert found.clipped_share > 0.5
    # With the lamp measured nothing is missing any more ...
    (lamp,) = find_lamps(values, clipped, seen_all(values), GREEN)
    lost = irradiance(truth, lamp.direction) - irradiance(values, lamp.direction)
    lux = 100.0 * float((lamp.irradiance + lost)[1])
    measured = [MeasuredLamp(lamp, lux)]
    closed, _ = scaled(values, clipped, measured=measured, **given)
    assert closed.missing_lx == pytest.approx(0.0, abs=2e-3 * given["illuminance_lx"])
    assert closed.clipped_share == 0.0
    # ... and the illuminance alone gives the scale that the luminance gave.
    by_lux, notes = scaled(values, clipped, measured=measured, **{**given, "luminance": 0.0})
    assert by_lux.factor == pytest.approx(100.0, rel=5e-3)
    assert notes == []
    # Without it the clipped light is taken for less than it is.
    high, notes = scaled(values, clipped, **{**given, "luminance": 0.0})
    assert high.factor > 110.0
    assert [note.code for note in notes] == ["scale-from-clipped-light"]


def test_no_reading_is_a_relative_scale():
    values, clipped = room([])
    found, notes = scaled(values, clipped)
    assert found == Scale() and found.units == "relative" and found.missing_lx == 0.0
    assert notes == []


DOWN = np.array([0.0, -1.0, 0.0])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"luminance": 5.0}, r"capture:luminance:direction has no value; author"),
        ({"illuminance_lx": 5.0}, r"capture:illuminance:direction has no value; author"),
        (
            {"luminance": 5.0, "luminance_direction": unit(PLACES["middle"])},
            "saturated in every exposure; take the reading off an even",
        ),
        ({"luminance": 5.0, "luminance_direction": DOWN}, "no view saw the scene"),
        ({"luminance": 5.0, "luminance_direction": np.array([1.0, 0, 0])}, "panorama is black"),
    ],
)
def test_reading_that_cannot_be_used_is_refused_with_the_remedy(given, message):
    values, clipped = room([(PLACES["middle"], 4.0, (1.0, 1.0, 1.0))], wall=(0.0, 0.0, 0.0))
    seen = 1.0 - disc(DOWN, 20.0)
    with pytest.raises(LayerError, match=f"^shoot.usda </Shoot>: .*{message}"):
        scaled(values, clipped, seen=seen, **given)


def test_lamp_brighter_than_the_whole_is_refused():
    values, clipped = room([(PLACES["zenith"], 4.0, (1.0, 1.0, 1.0))])
    (lamp,) = find_lamps(values, clipped, seen_all(values), GREEN)
    with pytest.raises(LayerError, match="is 10 lx, but the measured lamp alone gives"):
        scaled(
            values,
            clipped,
            measured=[MeasuredLamp(lamp, 20.0)],
            illuminance_lx=10.0,
            illuminance_direction=np.array([0.0, 1.0, 0.0]),
        )


def test_illuminance_from_what_no_view_saw_is_noted():
    values, clipped = room([])
    seen = 1.0 - disc((0.0, 1.0, 0.0), 40.0)
    up = np.array([0.0, 1.0, 0.0])
    found, notes = scaled(values, clipped, seen=seen, illuminance_lx=9.0, illuminance_direction=up)
    assert found.unseen_share == pytest.approx(math.sin(math.radians(40.0)) ** 2, rel=5e-3)
    assert [note.code for note in notes] == ["scale-from-unseen-light"]


# --- Report ------------------------------------------------------------------------------------


def test_noise_is_the_relative_deviation_of_the_bright_half():
    values = np.full((32, 64, 3), 0.001, np.float32)
    values[:16] = 2.0
    stddev = np.full_like(values, 0.02)
    unseen = seen_all(values)
    unseen[:, :16] = 0.0
    figures = measure_panorama(values, stddev, unseen, 1.0 - unseen, GREEN)
    assert figures.noise == pytest.approx(0.01, rel=1e-5)
    assert figures.unseen_flux_share == pytest.approx(0.25)
    assert figures.moved_share == pytest.approx(0.25)
    # Independent errors of n equal patches fall with the root of n.
    size = texel_solid_angles(32, 64)
    expected = 0.02 * math.sqrt(64 * float((size**2).sum())) / float(flux(values)[1])
    assert figures.flux_noise == pytest.approx(expected, rel=1e-5)


def test_noise_of_a_luminance_adds_the_channels_in_squares():
    values = np.ones((8, 16, 3), np.float32)
    stddev = np.broadcast_to(np.float32([0.1, 0.2, 0.3]), values.shape)
    figures = measure_panorama(values, stddev, seen_all(values), 0.0 * values[..., 0], WEIGHTS)
    expected = math.sqrt(float((WEIGHTS * [0.1, 0.2, 0.3]) @ (WEIGHTS * [0.1, 0.2, 0.3])))
    assert figures.noise == pytest.approx(expected, rel=1e-5)


def clean(**given):
    views = tuple(
        ViewReport(name, 9, exposure_error=0.004, flux_difference=2e-4)
        for name in ("north", "east", "west", "up")
    )
    values = {
        "name": "Kitchen",
        "width": 4096,
        "height": 2048,
        "views": views,
        "figures": PanoramaFigures(0.006, 1e-5, 0.001, 0.0),
        "coverage": 0.997,
        "largest_hole_deg": 11.0,
        "negative_share": 0.0,
        "overlap_difference": 0.012,
        "rotation_residual_before_deg": 0.06,
        "rotation_residual_deg": 0.06,
        "lamps": (),
        "scale": Scale(1432.0, "luminance", luminance=250.0),
    }
    return CaptureReport(**{**values, **given})


def lamp_reports(scale, clipped_to=20.0):
    values, clipped = room(
        [((0.1, 0.8, 0.5), 3.0, (clipped_to,) * 3), (PLACES["seam"], 1.0, (clipped_to,) * 3)]
    )
    lamps = find_lamps(values, clipped, seen_all(values), GREEN)
    return tuple(report_lamp(lamp, scale, GREEN, np.eye(3)) for lamp in lamps)


def troubled():
    views = (
        ViewReport(
            "north",
            9,
            exposure_error=0.12,
            worst_pair=("3.tif", "4.tif"),
            gaps=("7.tif and 8.tif",),
            dark_share=0.04,
            rotation_change_deg=0.52,
            flux_difference=-0.004,
        ),
        ViewReport("east", 9, rotation_change_deg=0.1, is_constrained=False),
    )
    scale = Scale(100.0, "luminance", 25.0, 812.0, 640.0, clipped_share=0.3)
    return clean(
        views=views,
        figures=PanoramaFigures(0.06, 1e-4, 0.02, 0.03),
        coverage=0.93,
        negative_share=0.02,
        overlap_difference=0.2,
        rotation_residual_before_deg=1.1,
        rotation_residual_deg=0.4,
        lamps=lamp_reports(scale),
        scale=scale,
    )


def test_clean_capture_has_no_advice():
    report = clean()
    assert all(not statement.advice for statement in report.statements())
    text = "\n".join(report.lines())
    for fact in (
        "4 views, 36 photographs, panorama of 4096 x 2048 pixels",
        "none was saturated",
        "one camera value is 1432 cd/m2, from the luminance reading of 250 cd/m2",
        "99.70 % of the sphere",
        "agree with their settings to 0.4 %",
        "agree to 0.06 degrees",
    ):
        assert fact in text


def test_every_problem_is_told_with_its_figure_and_what_to_do():
    report = troubled()
    advice = {
        statement.topic: " ".join(statement.advice)
        for statement in report.statements()
        if statement.advice
    }
    expected = {
        "Light": "Check the lens",
        "Lamps": "Add shorter exposures or a neutral density filter",
        "Scale": "21 % is missing. Clipped lamps hold it",
        "Coverage": "Add a view that faces the hole",
        "Exposures": "View north: 3.tif and 4.tif differ by 12 %",
        "Rotations": "No overlap tells where east faces",
        "Noise": "Add longer exposures",
        "Motion": "yellow outlines",
        "Composition": "black level or the glare",
    }
    assert advice.keys() == expected.keys()
    for topic, words in expected.items():
        assert words in advice[topic], topic
    lamp = next(item for item in report.statements() if item.topic == "Lamp 1")
    assert "degrees above the horizon, at column" in lamp.text and " lx" in lamp.text


def test_text_is_ascii_sentences():
    for report in (clean(), troubled(), clean(scale=Scale(), rotation_residual_deg=None)):
        for line in report.lines():
            assert line.isascii() and line.endswith("."), line
            assert not re.search(r"\b(nan|inf|None)\b|\de[+-]\d|  +", line.lstrip()), line


def test_flux_error_adds_independent_parts_in_squares():
    assert clean().flux_error == pytest.approx(math.hypot(1e-5, 2e-4, 0.004, 0.001))
    report = troubled()
    share = sum(lamp.flux_share for lamp in report.lamps)
    contradiction = math.sqrt(0.2**2 - 0.12**2 - 0.05**2)  # noise of 6 % explains 12 %
    expected = math.hypot(1e-4, 0.004, 0.12, 0.02, share, contradiction)
    assert report.flux_error == pytest.approx(expected)
    assert report.clipped_share == pytest.approx(share)


@pytest.mark.parametrize(("difference", "told"), [(0.06, False), (0.09, True), (1.19, True)])
def test_views_that_contradict_each_other_count_in_the_flux_error(difference, told):
    report = clean(overlap_difference=difference)
    assert difference * 0.5 < report.contradiction < report.flux_error
    light = next(item for item in report.statements() if item.topic == "Light")
    assert ("contradict each other by" in light.text) == told
    assert any("Check the lens" in advice for advice in light.advice) == told
    if not told:
        assert "right to about 3.1 %" in light.text and "views that contradict" in light.text


def test_difference_that_noise_explains_is_no_contradiction():
    noisy = PanoramaFigures(0.06, 1e-5, 0.001, 0.0)
    report = clean(overlap_difference=0.1, figures=noisy)
    assert report.contradiction == 0.0
    assert report.flux_error == pytest.approx(clean().flux_error)
    assert "right to about" in " ".join(report.lines())


def test_measured_lamp_no_longer_counts_as_an_error():
    values, clipped = room([((0.1, 0.8, 0.5), 3.0, (20.0,) * 3)])
    (lamp,) = find_lamps(values, clipped, seen_all(values), GREEN)
    reading = 2.5 * float(lamp.irradiance[1])
    replaced = replace_lamp(values, 0.0 * values, clipped, lamp, reading, GREEN)
    told = report_lamp(lamp, Scale(10.0, "luminance", 1.0), GREEN, np.eye(3), replaced)
    report = clean(lamps=(told,))
    assert report.flux_error == pytest.approx(clean().flux_error)
    assert report.clipped_share == pytest.approx(lamp.flux_share)
    assert any("raised 2.5 times to its measured illuminance" in line for line in report.lines())
    assert told.illuminance == pytest.approx(10.0 * float(lamp.irradiance[1]))


def test_report_is_plain_json():
    data = json.loads(json.dumps(troubled().as_dict(), allow_nan=False))
    assert data["views"][0]["worst_pair"] == ["3.tif", "4.tif"]
    assert data["scale"]["factor"] == 100.0 and data["scale"]["missing_lx"] == 172.0
    assert data["flux_error"] > 0.1 and data["advice"][0]["topic"] == "Light"


def test_attributes_go_into_the_layer_and_validate():
    from usdskin.prims.writing import write_schema

    # isort: split
    from pxr import Gf, Usd, Vt

    stage = Usd.Stage.CreateInMemory()
    prim = stage.DefinePrim("/Capture", "Xform")
    report = troubled()
    attributes = report.attributes()
    directions_of = attributes.pop("capture:lamps:directions")
    assert directions_of.shape == (2, 3)
    rows = [Gf.Vec3d(*(float(part) for part in row)) for row in directions_of]
    write_schema(prim, "CaptureAPI", attributes | {"capture:lamps:directions": Vt.Vec3dArray(rows)})
    known = set(prim.GetPrimDefinition().GetPropertyNames())
    assert attributes.keys() <= known
    assert prim.GetAttribute("capture:units").Get() == "absolute"
    assert prim.GetAttribute("capture:rotationChanges").Get() == [0.52, 0.1]
    assert len(prim.GetAttribute("capture:lamps:shares").Get()) == 2
    assert clean().attributes()["capture:lamps:directions"].shape == (0, 3)


def test_unknown_figures_are_not_authored():
    views = (ViewReport("only", 1),)
    attributes = clean(views=views, rotation_residual_deg=None, scale=Scale()).attributes()
    for name in ("exposureError", "rotationResidual", "rotationChanges"):
        assert attributes[f"capture:{name}"] is None
    assert attributes["capture:units"] == "relative" and attributes["capture:scale"] == 1.0


def test_view_report_names_the_photographs_of_the_worst_pair_and_of_the_gaps():
    count = 3
    bracket = ExposureBracket(
        images=tuple(Path(f"north/{index}.tif") for index in range(count)),
        exposure_time_s=np.array([1.0, 0.1, 0.01]),
        iso=np.full(count, 100.0),
        f_number=np.ones(count),
        nd_factor=np.ones(count),
        black_level=np.zeros(1),
    )
    lens = FisheyeLens("equidistant", 100.0, np.array([50.0, 50.0]), (100, 100))
    view = View("north", "shoot.usda </Shoot/north>", lens, bracket, np.eye(3))
    pairs = (ExposurePair(2, 1, 10.0, 9.0, 0.5), ExposurePair(1, 0, 10.0, None, 40.0))
    merged = MergeReport(
        exposure=bracket.exposure,
        pairs=pairs,
        exposure_error=0.1,
        gaps=pairs[:1],
        noise=None,
        clipped_pixels=5,
        clipped_share=0.05,
        dark_share=0.01,
        moved_share=0.02,
        least=1.0,
        greatest=2.0,
    )
    report = report_view(view, merged, flux_difference=1e-4)
    assert report.exposure_error == pytest.approx(0.1)
    assert report.worst_pair == ("2.tif", "1.tif") and report.gaps == ("2.tif and 1.tif",)
    assert (report.image_count, report.clipped_share, report.moved_share) == (3, 0.05, 0.02)


# --- Quality picture ---------------------------------------------------------------------------


def pictured(values, clipped=None, seen=None, moved=None, footprints=None, **given):
    none = np.zeros(values.shape[:2], np.float32)
    clipped = none if clipped is None else clipped
    seen = 1.0 - none if seen is None else seen
    lamps = find_lamps(values, clipped, seen, GREEN)
    return quality_picture(
        values,
        clipped,
        seen,
        none if moved is None else moved,
        GREEN,
        footprints=footprints or {},
        lamps=lamps,
        title="Kitchen",
        **given,
    )


def texture(height=H, width=W):
    random = np.random.default_rng(5)
    return (0.2 * random.random((height, width, 3)) + 0.1).astype(np.float32)


def at(picture, direction):
    """Return the pixels within 3 px of a direction, shape [7, 7, 3]."""
    top, left = 72, 64
    u, v = latlong_coordinates(unit(direction))
    x, y = left + int(u * WIDTH), top + int(v * HEIGHT)
    return picture[y - 3 : y + 4, x - 3 : x + 4].astype(int)


@pytest.fixture(scope="module")
def plain():
    return pictured(texture())


SPOTS = (0.5, -0.3, 0.7), (-0.9, 0.2, 0.1), (0.2, 0.5, -0.6)


def test_clipped_is_red_unseen_magenta_and_moved_yellow(plain):
    clipped, unseen, moved = (disc(spot, 5.0) for spot in SPOTS)
    picture = pictured(texture(), clipped=clipped, seen=1.0 - unseen, moved=moved)
    red, magenta, yellow = (at(picture, spot).mean(axis=(0, 1)) for spot in SPOTS)
    assert red[0] > red[1] + 60 and red[0] > red[2] + 60
    assert min(magenta[0], magenta[2]) > magenta[1] + 20
    before = at(plain, SPOTS[2]).mean(axis=(0, 1))
    assert yellow[2] < before[2] - 5 and yellow[0] > before[0] + 5


def test_smallest_lamp_can_be_seen():
    values, clipped = texture(1024, 2048), np.zeros((1024, 2048), np.float32)
    values[500, 700], clipped[500, 700] = 50.0, 0.2
    marked = pictured(values, clipped).astype(int)
    x, y = 64 + 700, 72 + 500
    around = marked[y - 6 : y + 7, x - 6 : x + 7]
    red = (around[..., 0] > 180) & (around[..., 1] < 110) & (around[..., 2] < 110)
    assert red.sum() >= 20


def test_footprint_is_outlined_across_the_seam_without_a_line_at_it(plain):
    mask = disc((0.0, 0.0, -1.0), 40.0)
    drawn = pictured(texture(), footprints={"back": mask}).astype(int)
    changed = np.abs(drawn - plain.astype(int)).max(axis=2) > 20
    row = 72 + HEIGHT // 2 + 60  # clear of the view's name
    columns = np.flatnonzero(changed[row]) - 64
    edge = round(WIDTH * 40.0 / 360.0)
    assert columns.size and np.abs(np.minimum(columns, WIDTH - columns) - edge).max() < 12


def test_picture_has_one_size_and_the_same_bytes_every_time(plain):
    assert plain.dtype == np.uint8 and plain.shape == (1324, 2152, 3)
    np.testing.assert_array_equal(plain, pictured(texture()))
    assert pictured(texture(16, 32), up_axis="Z").shape == plain.shape


def test_camera_cast_and_scale_do_not_change_the_picture(plain):
    cast = texture() * np.float32([0.45, 1.0, 0.6]) * np.float32(3000.0)
    assert np.abs(plain.astype(int) - pictured(cast)).max() <= 2


@pytest.mark.parametrize("level", [0.0, 1e-12, 1e12])
def test_even_panorama_makes_an_even_picture(level):
    picture = pictured(np.full((H, W, 3), level, np.float32))
    field = picture[72 + 20 : 72 + 60, 64 + 20 : 64 + 60].astype(int)
    assert np.ptp(field) <= 1


def test_panorama_that_nobody_saw_still_makes_a_picture():
    values = texture()
    picture = pictured(values, seen=np.zeros(values.shape[:2], np.float32))
    assert np.isfinite(picture).all()


@pytest.mark.realdata
def test_real_panoramas_use_the_range_of_the_display(realdata):
    from usdskin.images import read_image

    for name in ("hotel_interior_1k.exr", "immenstadter_horn_1k.hdr"):
        image = read_image(realdata / "hdri" / name, channels=("R", "G", "B"))
        picture = pictured(np.maximum(image.pixels, 0.0).astype(np.float32))
        field = picture[72 : 72 + HEIGHT, 64 : 64 + WIDTH]
        low, middle, high = np.percentile(field, (2, 50, 98))
        assert low < 70 and 70 < middle < 180 and high > 190, name
