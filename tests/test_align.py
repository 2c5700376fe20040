"""Views are turned until they agree: accuracy, basin, and what must not be believed."""

from __future__ import annotations

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest
from fisheye_rooms import (
    REALISTIC,
    UP,
    Shot,
    angle_between,
    directions,
    horizontal,
    photograph,
    random_turn,
    room,
    turn,
)

from usdskin.capture.views.align import AlignView, align_views, reduce_view
from usdskin.capture.views.align_features import build_levels, sample
from usdskin.capture.views.rotation_vectors import rotation_by, vector_of
from usdskin.fisheye import unproject
from usdskin.images import read_image
from usdskin.prims import FisheyeLens

ACCURACY_DEG = 0.05
"""The contract's; 0.02 is usual."""

THREE = horizontal(0, 120, 240)
WITH_ZENITH = np.concatenate([THREE, [UP]])
BACK_TO_BACK = horizontal(0, 180)
SETS = {
    "three": (THREE, 90.0),
    "three and zenith": (WITH_ZENITH, 90.0),
    "back to back": (BACK_TO_BACK, 95.0),
}
PANORAMAS = [
    "empty_warehouse_01_1k.hdr",
    "hotel_interior_1k.exr",
    "immenstadter_horn_1k.hdr",
    "royal_esplanade_512.exr",
    "st_fagans_interior_1k.hdr",
]


def lens(size, max_angle=90.0):
    return FisheyeLens(
        "equidistant",
        0.5 * size / np.radians(max_angle),
        np.array([0.5 * size, 0.5 * size]),
        (size, size),
        max_angle_deg=max_angle,
    )


def views(environments, true, *, size=280, max_angle=90.0, shots=REALISTIC):
    """Return views at their true rotations; one environment and one shot may do for all."""
    environments = environments if isinstance(environments, list) else [environments] * len(true)
    shots = shots if isinstance(shots, list) else [shots] * len(true)
    found = []
    for index, (environment, rotation, shot) in enumerate(
        zip(environments, true, shots, strict=True)
    ):
        values, valid = photograph(
            environment, rotation, size=size, max_angle=max_angle, shot=shot, seed=index
        )
        found.append(AlignView(f"v{index}", lens(size, max_angle), rotation, values, valid))
    return found


def stated(photographed, rotations):
    return [
        replace(view, rotation=rotation)
        for view, rotation in zip(photographed, rotations, strict=True)
    ]


def shaken(rng, true, degrees):
    return np.array([random_turn(rng, degrees) @ rotation for rotation in true])


def largest_error(rotations, true):
    """Return the largest error of a rotation between two views [deg]; the whole may turn."""
    return max(
        angle_between(rotations[i].T @ rotations[j], true[i].T @ true[j])
        for i, j in combinations(range(len(true)), 2)
    )


def states(alignment):
    return {pair.state for pair in alignment.pairs}


@pytest.fixture(scope="module")
def environment():
    return room(3, 256)


@pytest.fixture(scope="module")
def photographed_sets(environment):
    return {name: views(environment, true, max_angle=angle) for name, (true, angle) in SETS.items()}


@pytest.fixture(scope="module")
def three(photographed_sets):
    return photographed_sets["three"]


@pytest.fixture(scope="module")
def four(photographed_sets):
    return photographed_sets["three and zenith"]


@pytest.fixture(scope="module")
def rooms():
    """Return three views of each of four rooms, each shoot turned its own way."""
    turns = [random_turn(np.random.default_rng(seed), 40.0) for seed in range(4)]
    return [views(room(seed, 256), turns[seed] @ THREE) for seed in range(4)]


# --- What must be found --------------------------------------------------------------------------


@pytest.mark.slow
def test_errors_of_half_a_degree_shrink_to_a_twentieth_over_20_seeds(rooms):
    """With noise, 2 % of vignetting and 1 % of glare left in the pictures."""
    errors = []
    for seed in range(20):
        photographed = rooms[seed % 4]
        true = np.array([view.rotation for view in photographed])
        given = shaken(np.random.default_rng(seed), true, 0.5)
        found = align_views(stated(photographed, given))
        errors.append(largest_error(found.rotations, true))
        assert found.constrained.all()
        assert found.residual_before_deg > 0.2
        assert found.residual_after_deg < ACCURACY_DEG
    assert max(errors) <= ACCURACY_DEG


@pytest.mark.parametrize("name", SETS)
@pytest.mark.parametrize("seed", range(3))
def test_errors_of_five_degrees_are_within_the_basin(photographed_sets, name, seed):
    """Five degrees for each view: up to ten between two, as wide as the ring of back to back."""
    true, photographed = SETS[name][0], photographed_sets[name]
    given = shaken(np.random.default_rng(seed), true, 5.0)
    found = align_views(stated(photographed, given))
    assert found.constrained.all()
    assert largest_error(found.rotations, true) <= ACCURACY_DEG


def test_moved_furniture_does_not_turn_views(environment, three):
    """Things of 24 degrees stand in the overlaps of one view that others do not see there."""
    moved = environment.copy()
    for middle in ([0.87, 0.0, 0.5], [0.0, -0.4, 0.9], [-0.8, 0.3, -0.4]):
        toward = directions(*moved.shape[:2]) @ (middle / np.linalg.norm(middle))
        moved[toward > np.cos(np.radians(12.0))] = [1.5, 0.3, 0.1]
    photographed = [three[0], *views(moved, THREE[1:2]), three[2]]
    given = shaken(np.random.default_rng(5), THREE, 0.5)
    found = align_views(stated(photographed, given))
    assert largest_error(found.rotations, THREE) <= ACCURACY_DEG


def test_gain_between_views_is_measured_and_does_not_turn_them(three):
    given = shaken(np.random.default_rng(5), THREE, 0.5)
    amplified = [
        replace(view, values=view.values * np.float32(gain))
        for view, gain in zip(stated(three, given), (1.0, 1.4, 0.7), strict=True)
    ]
    found = align_views(amplified)
    assert largest_error(found.rotations, THREE) <= ACCURACY_DEG
    # The median takes a share of the darkest pixels along, where the logarithm is bounded.
    np.testing.assert_allclose([pair.gain for pair in found.pairs], [1.4, 0.7, 0.5], rtol=0.06)


def test_a_second_noisier_bracket_of_a_view_fits_its_first(environment, three):
    true = THREE[[0, 0]]
    given = shaken(np.random.default_rng(1), true, 0.5)
    second = views(environment, THREE[:1], shots=Shot(noise=0.2))
    found = align_views(stated([three[0], *second], given))
    assert largest_error(found.rotations, true) <= ACCURACY_DEG


def test_pictures_of_two_sizes_fit(environment, three):
    photographed = views(environment, THREE[:1], size=500) + three[1:]
    given = shaken(np.random.default_rng(2), THREE, 0.5)
    found = align_views(stated(photographed, given))
    assert largest_error(found.rotations, THREE) <= ACCURACY_DEG


def test_true_rotations_stay(four):
    found = align_views(four)
    assert found.change_deg.max() <= ACCURACY_DEG
    assert found.residual_before_deg <= ACCURACY_DEG


def test_small_changes_have_no_mean(four):
    """Least squares to the stated rotations: turning all of them comes no closer."""
    given = shaken(np.random.default_rng(7), WITH_ZENITH, 0.5)
    found = align_views(stated(four, given))
    changes = [vector_of(new @ old.T) for new, old in zip(found.rotations, given, strict=True)]
    np.testing.assert_allclose(np.mean(changes, axis=0), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.degrees(np.linalg.norm(changes, axis=1)), found.change_deg)


def test_result_turns_with_the_frame(three):
    """Another frame of the panorama changes nothing but the frame."""
    given = shaken(np.random.default_rng(8), THREE, 0.5)
    frame = turn([1.0, 2.0, 3.0], 77.0)
    here = align_views(stated(three, given)).rotations
    there = align_views(stated(three, frame @ given)).rotations
    assert max(map(angle_between, frame @ here, there)) < 0.02  # the directions are others


def test_same_views_give_the_same_bytes(four):
    given = stated(four, shaken(np.random.default_rng(9), WITH_ZENITH, 2.0))
    first, second = align_views(given), align_views(given)
    assert first.rotations.tobytes() == second.rotations.tobytes()


# --- What must not be believed -------------------------------------------------------------------


def assert_nothing_moved(found, given):
    assert not found.constrained.any()
    np.testing.assert_array_equal(found.rotations, given)
    np.testing.assert_array_equal(found.change_deg, 0.0)
    assert found.residual_before_deg is None
    assert found.residual_after_deg is None


def test_views_that_do_not_overlap_stay(environment):
    given = shaken(np.random.default_rng(0), BACK_TO_BACK, 0.5)
    notes = []
    photographed = views(environment, BACK_TO_BACK, max_angle=80.0)
    found = align_views(stated(photographed, given), notes)
    assert_nothing_moved(found, given)
    assert states(found) == {"apart"}
    assert not notes


@pytest.mark.parametrize("noise", [0.0, 0.05])
@pytest.mark.parametrize("kind", ["even", "sky", "rings"])
def test_views_without_features_are_not_moved_by_noise(kind, noise):
    """``rings`` are alike all around: nothing tells how far a view is turned about the vertical."""
    up = directions(128, 256)[..., 1:2]
    shape = {"even": 0.0 * up + 0.4, "sky": 1.0 + 0.8 * up, "rings": np.exp(np.sin(25.0 * up))}
    given = shaken(np.random.default_rng(4), THREE, 0.5)
    photographed = views(shape[kind] * np.ones(3), THREE, size=160, shots=Shot(noise=noise))
    notes = []
    found = align_views(stated(photographed, given), notes)
    assert_nothing_moved(found, given)
    assert states(found) == {"featureless"}
    assert not notes


def test_only_the_view_without_features_stays(environment):
    right = directions(*environment.shape[:2])[..., :1] > 0.3
    half = np.where(right, environment, 0.4)
    given = shaken(np.random.default_rng(4), THREE, 0.5)
    found = align_views(stated(views(half, THREE), given))
    assert found.constrained.tolist() == [True, False, True]
    np.testing.assert_allclose(found.rotations[1], given[1], rtol=0.0, atol=1e-15)
    assert (
        angle_between(found.rotations[0].T @ found.rotations[2], THREE[0].T @ THREE[2])
        <= ACCURACY_DEG
    )


def test_view_stated_30_degrees_wrong_is_found_out_and_does_not_turn_the_others(four):
    given = shaken(np.random.default_rng(5), WITH_ZENITH, 0.2)
    given[1] = turn([1.0, 1.0, 0.0], 30.0) @ given[1]
    notes = []
    found = align_views(stated(four, given), notes, search_deg=0.0)
    against = [pair for pair in found.pairs if "v1" in (pair.first, pair.second)]
    assert {pair.state for pair in against} == {"contradicting"}
    assert max(abs(pair.correlation_before) for pair in against) < 0.2
    assert found.constrained.tolist() == [True, False, True, True]
    np.testing.assert_allclose(found.rotations[1], given[1], rtol=0.0, atol=1e-15)
    rest = [0, 2, 3]
    assert largest_error(found.rotations[rest], WITH_ZENITH[rest]) <= ACCURACY_DEG
    assert [(note.code, note.path) for note in notes] == [("rotation-contradicted", "v1")]


def test_wide_search_finds_a_view_stated_30_degrees_wrong(four):
    given = WITH_ZENITH.copy()
    given[1] = turn([1.0, 1.0, 0.0], 30.0) @ given[1]
    notes = []
    found = align_views(stated(four, given), notes, search_deg=36.0)
    assert found.constrained.all()
    assert largest_error(found.rotations, WITH_ZENITH) <= ACCURACY_DEG
    assert found.change_deg[[0, 2, 3]].max() < 0.2
    assert [(note.code, note.path) for note in notes] == [("rotation-far-off", "v1")]
    assert "30.0 deg" in notes[0].message


def test_exchanged_views_are_named(four):
    given = WITH_ZENITH[[0, 2, 1, 3]]
    notes = []
    found = align_views(stated(four, given), notes)
    assert found.constrained.tolist() == [True, False, False, True]
    assert {note.path for note in notes} == {"v1", "v2"}
    assert all("rotations of v1 and v2 are exchanged" in note.message for note in notes)


@pytest.mark.slow
def test_other_rooms_contradict_each_other_over_20_seeds(rooms):
    """Chance never aligns views of different places."""
    for seed in range(20):
        first, second = rooms[seed % 4], rooms[(seed + 1 + seed // 8) % 4]
        pair = [first[seed % 3], second[(seed + 1) % 3]]
        given = shaken(np.random.default_rng(seed), THREE[:2], 10.0)
        found = align_views(stated(pair, given), search_deg=15.0 if seed < 3 else 0.0)
        assert not found.constrained.any()
        np.testing.assert_array_equal(found.rotations, given)


def test_lens_that_moved_between_views_is_told(environment):
    """One centimetre from the axis: no rotations fit all overlaps."""
    places = [room(3, 256, eye=rotation @ [0.0, 0.0, -0.01]) for rotation in THREE]
    notes = []
    found = align_views(views(places, THREE), notes)
    assert found.residual_after_deg > 0.2
    assert [note.code for note in notes] == ["rotations-disagree"]


@pytest.mark.parametrize("valid", [True, False])
@pytest.mark.parametrize("size", [1, 5, 90])
def test_black_or_masked_or_tiny_views_are_survived(size, valid):
    black = np.zeros((size, size, 3), np.float32)
    mask = np.full((size, size), valid)
    given = [AlignView(name, lens(size), np.eye(3), black, mask) for name in "ab"]
    assert_nothing_moved(align_views(given), [np.eye(3)] * 2)


@pytest.mark.parametrize("count", [0, 1])
def test_fewer_than_two_views_are_left_alone(three, count):
    found = align_views(three[:count])
    assert found.pairs == ()
    assert not found.constrained.any()
    assert len(found.rotations) == count
    assert found.residual_after_deg is None


# --- Parts ---------------------------------------------------------------------------------------


def test_rotation_vectors_go_there_and_back():
    rng = np.random.default_rng(0)
    for degrees in (0.0, 1e-6, 0.5, 30.0, 120.0, 179.0):
        rotation = random_turn(rng, degrees)
        vector = vector_of(rotation)
        np.testing.assert_allclose(np.degrees(np.linalg.norm(vector)), degrees, atol=1e-8)
        np.testing.assert_allclose(rotation_by(vector), rotation, atol=1e-12)


@pytest.mark.parametrize("projection", ["equidistant", "equisolid", "opencv"])
def test_moment_is_the_change_as_the_camera_turns(projection):
    """Of a smooth picture, against differences; the picture is what the view's lens shows."""
    size = 500
    given = replace(
        lens(size, 80.0), projection=projection, distortion=np.array([-0.02, 0.003, 0.0, 0.0])
    )
    middles = np.stack(np.meshgrid(*2 * [np.arange(size) + 0.5]), axis=-1)
    rays = unproject(given, middles)
    valid = np.isfinite(rays[..., 0])
    smooth = np.exp(np.sin(14.0 * rays[..., 0]) + np.cos(11.0 * rays[..., 1] - 1.0))
    values = np.where(valid[..., None], smooth[..., None], 0.0).repeat(3, -1).astype(np.float32)
    rotation = random_turn(np.random.default_rng(1), 50.0)
    view = AlignView("v", given, rotation, values, valid)
    [levels] = build_levels([view])
    angle = np.linspace(0.0, 1.2, 300)
    camera = np.stack(
        [np.sin(angle) * np.cos(5 * angle), np.sin(angle) * np.sin(5 * angle), -np.cos(angle)],
        axis=1,
    )
    toward = camera @ rotation.T
    step = 0.004
    _, here = sample(levels[0], given, rotation, toward)
    for axis in range(3):
        bands = [
            sample(levels[0], given, rotation_by(sign * step * np.eye(3)[axis]) @ rotation, toward)
            for sign in (-1.0, 1.0)
        ]
        change = (bands[1][1].band - bands[0][1].band) / (2.0 * step)
        size_of = np.abs(here.moment).max()
        np.testing.assert_allclose(-here.moment[:, axis], change, atol=0.03 * size_of)


@pytest.mark.parametrize("shape", [(60, 80), (61, 83)])
def test_small_picture_is_the_mean_of_blocks_under_the_same_lens(shape):
    height, width = shape
    full = replace(
        lens(70),
        center_px=np.array([41.0, 29.5]),
        resolution=(width, height),
        vignetting=np.array([-0.2]),
        max_angle_deg=60.0,
    )
    rng = np.random.default_rng(0)
    values = rng.random((height, width, 3), np.float32)
    status = np.where(rng.random(shape) < 0.2, 4, 1).astype(np.uint8)
    status[8:12, 40:44] = 4
    rotation = random_turn(rng, 20.0)
    small = reduce_view("a", full, rotation, values, status, most_pixels=400)
    assert (small.name, small.rotation is rotation) == ("a", True)
    assert small.valid.size <= 400
    assert small.valid.shape == (-(-height // 4), -(-width // 4))
    assert not small.valid[2, 10]  # every pixel of it moved
    usable = status[20:24, 32:36] != 4
    mean = values[20:24, 32:36][usable].mean(axis=0, dtype=np.float64)
    # Pixel middles and lens say the same directions for both pictures.
    here, there = unproject(full, [34.0, 22.0]), unproject(small.lens, [8.5, 5.5])
    np.testing.assert_allclose(there, here, atol=1e-12)
    phi = np.arccos(-here[2])
    np.testing.assert_allclose(small.values[5, 8], mean / (1.0 - 0.2 * phi**2), rtol=1e-6)


def test_picture_that_is_small_enough_keeps_its_pixels():
    values = np.random.default_rng(0).random((50, 50, 3), np.float32)
    small = reduce_view("a", lens(50), np.eye(3), values, np.zeros((50, 50), np.uint8))
    np.testing.assert_array_equal(small.values[small.valid], values[small.valid])
    assert 0.75 < small.valid.mean() < 0.8  # the circle: pi / 4


# --- Real light ----------------------------------------------------------------------------------


@pytest.mark.realdata
@pytest.mark.slow
@pytest.mark.parametrize("name", PANORAMAS)
@pytest.mark.parametrize("of", ["three and zenith", "back to back"])
def test_real_places_align_to_a_twentieth_of_a_degree(realdata, name, of):
    panorama = read_image(realdata / "hdri" / name).pixels[..., :3].astype(np.float64)
    rng = np.random.default_rng(PANORAMAS.index(name))
    true, max_angle = SETS[of]
    true = random_turn(rng, 40.0) @ true
    photographed = views(np.maximum(panorama, 0.0), true, size=480, max_angle=max_angle)
    for degrees in (0.5, 5.0):
        found = align_views(stated(photographed, shaken(rng, true, degrees)))
        assert found.constrained.all()
        assert largest_error(found.rotations, true) <= ACCURACY_DEG
