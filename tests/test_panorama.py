"""Views become a panorama: flux, lamps, seams, weights, clipping and holes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from usdskin.capture.views.fill import fill_holes, find_holes
from usdskin.capture.views.panorama import Compositor, Panorama, footprint
from usdskin.device import Workers, open_workers
from usdskin.errors import LayerError
from usdskin.fisheye import (
    pixel_solid_angle,
    project,
    unproject,
    vignetting,
)
from usdskin.latlong import (
    latlong_coordinates,
    latlong_directions,
    texel_directions,
    texel_solid_angles,
)
from usdskin.prims.lenses import FisheyeLens
from usdskin.progress import SilentProgress

FLUX_RTOL = 1e-3
LAMP_RTOL = 1e-2

LAMP = 1000.0 * np.array([1.0, 0.8, 0.5])


# --- A float64 world of its own ----------------------------------------------------------------


def make_lens(radius: float = 100.0, angle: float = 90.0, **changes: object) -> FisheyeLens:
    """Return a lens whose circle of ``radius`` [px] lies off the picture's middle."""
    size = int(2.0 * radius + 9.0)
    given: dict = {
        "projection": "equidistant",
        "focal_length_px": radius / np.radians(angle),
        "center_px": np.array([size / 2 + 1.3, size / 2 - 0.8]),
        "resolution": (size, size),
        "max_angle_deg": angle,
    }
    return FisheyeLens(**{**given, **changes})


def turned(azimuth_deg: float, elevation_deg: float = 0.0, roll_deg: float = 0.0) -> np.ndarray:
    """Return the rotation of a camera from -Z to an azimuth (to the right) and elevation."""

    def about(axis: int, angle_deg: float) -> np.ndarray:
        i, j = [(1, 2), (2, 0), (0, 1)][axis]
        matrix = np.eye(3)
        matrix[i, i] = matrix[j, j] = np.cos(np.radians(angle_deg))
        matrix[j, i] = np.sin(np.radians(angle_deg))
        matrix[i, j] = -matrix[j, i]
        return matrix

    return about(1, -azimuth_deg) @ about(0, elevation_deg) @ about(2, roll_deg)


def pixel_grid(lens: FisheyeLens, part: int = 1) -> np.ndarray:
    """Return the positions of pixels' middles, or of ``part`` x ``part`` points in each."""
    width, height = lens.resolution
    u = (np.arange(width * part) + 0.5) / part
    v = (np.arange(height * part) + 0.5) / part
    return np.stack(np.meshgrid(u, v), axis=-1)


def photograph(lens, rotation, world, part=1):
    """Return a view of ``world(directions) -> (..., 3)``: V times its mean over each pixel."""
    width, height = lens.resolution
    at = pixel_grid(lens, part)
    rays = unproject(lens, at)
    angle = np.arctan2(np.hypot(rays[..., 0], rays[..., 1]), -rays[..., 2])
    seen = np.isfinite(rays).all(axis=-1)
    image = np.zeros((*seen.shape, 3))
    image[seen] = world(rays[seen] @ rotation.T) * vignetting(lens, angle[seen])[:, None]
    image = image.reshape(height, part, width, part, 3)
    count = np.maximum(seen.reshape(height, part, width, part).sum(axis=(1, 3)), 1)
    return (image.sum(axis=(1, 3)) / count[..., None]).astype(np.float32)


def smooth_world(directions):
    """Return an asymmetric, smooth, bright world."""
    x, y, z = np.moveaxis(directions, -1, 0)
    red = 2.0 + x + 0.5 * y * z
    green = 1.5 + 0.6 * y - 0.7 * x * z
    blue = 1.0 + 0.4 * z + 0.3 * x * y
    return np.stack([red, green, blue], axis=-1)


def photograph_lamps(lens, rotation, directions, background=0.01, diameter_deg=0.5):
    """Return a view of round lamps in the dark, with 16 x 16 samples in the pixels around them."""
    values = np.full((lens.resolution[1], lens.resolution[0], 3), background, np.float32)
    beyond = replace(lens, max_angle_deg=lens.max_angle_deg + 2.0)
    cosine = np.cos(np.radians(0.5 * diameter_deg))
    part = 16
    for direction in directions:
        at = project(beyond, direction @ rotation)
        if not np.isfinite(at).all():
            continue
        left, top = np.maximum(np.floor(at).astype(int) - 8, 0)
        window = values[top : top + 17, left : left + 17]
        u = left + (np.arange(window.shape[1] * part) + 0.5) / part
        v = top + (np.arange(window.shape[0] * part) + 0.5) / part
        rays = unproject(lens, np.stack(np.meshgrid(u, v), axis=-1))
        shape = (window.shape[0], part, window.shape[1], part)
        lit = (rays @ rotation.T @ direction >= cosine).reshape(shape).sum(axis=(1, 3))
        seen = np.isfinite(rays).all(axis=-1).reshape(shape).sum(axis=(1, 3))
        window += (LAMP - background) * (lit / np.maximum(seen, 1))[..., None]
    return values


# --- Composing ---------------------------------------------------------------------------------


def compose(views, height=64, workers=None, device="cpu") -> Panorama:
    """Compose (lens, rotation, values[, variance[, status]]) with variance 1 and no flags."""
    compositor = Compositor(height, workers or open_workers(device, 2), SilentProgress())
    for number, (lens, rotation, values, *more) in enumerate(views):
        variance = more[0] if more else np.ones_like(values)
        status = more[1] if len(more) > 1 else np.zeros(values.shape[:2], np.uint8)
        compositor.add_view(lens, rotation, values, variance, status, name=f"view {number}")
    return compositor.finish()


def brute_force(lens, rotation, values, height, part=32):
    """Return means over texels and shares seen, float64: every sample its own projection.

    Samples are equal in azimuth and in the sine of elevation; bilinear between those pixels whose
    middle lies in the circle.
    """
    width = 2 * height
    inside = np.isfinite(unproject(lens, pixel_grid(lens))).all(axis=-1)
    edges = np.cos(np.arange(height + 1) * np.pi / height)
    fraction = (np.arange(part) + 0.5) / part
    total = np.zeros((height, width, 3))
    share = np.zeros((height, width))
    for i in range(height):
        polar = np.arccos(edges[i] + fraction * (edges[i + 1] - edges[i]))
        turns = (np.arange(width * part) + 0.5) / (width * part)
        directions = latlong_directions(*np.meshgrid(turns, polar))
        at = project(lens, directions @ rotation)
        angle = np.arccos(np.clip(-(directions @ rotation)[..., 2], -1.0, 1.0))
        size = np.array(lens.resolution)
        seen = np.isfinite(at).all(axis=-1) & (at >= 0.0).all(axis=-1) & (at < size).all(axis=-1)
        at = np.where(seen[..., None], at, 0.5) - 0.5
        corner = np.floor(at).astype(int)
        part_of = at - corner
        sums, weights = np.zeros((*seen.shape, 3)), np.zeros(seen.shape)
        for dy in (0, 1):
            for dx in (0, 1):
                weight = (part_of[..., 0] if dx else 1.0 - part_of[..., 0]) * (
                    part_of[..., 1] if dy else 1.0 - part_of[..., 1]
                )
                column = np.clip(corner[..., 0] + dx, 0, size[0] - 1)
                row = np.clip(corner[..., 1] + dy, 0, size[1] - 1)
                weight = weight * inside[row, column]
                sums += weight[..., None] * values[row, column]
                weights += weight
        seen &= weights > 0.0
        found = sums / np.where(seen, weights * vignetting(lens, angle), 1.0)[..., None]
        found = np.where(seen[..., None], found, 0.0)
        total[i] = found.reshape(part, width, part, 3).sum(axis=(0, 2))
        share[i] = seen.reshape(part, width, part).sum(axis=(0, 2))
    return total / np.maximum(share, 1.0)[..., None], share / part**2


# --- Against brute force -----------------------------------------------------------------------

PLACES = {
    "level": (turned(20.0, 5.0, 30.0), {}),
    "up": (turned(0.0, 90.0), {"projection": "equisolid", "focal_length_px": 35.0}),
    "down, wide": (turned(200.0, -80.0, 10.0), {"max_angle_deg": 105.0, "focal_length_px": 28.0}),
    "cropped": (turned(180.0, 3.0), {"resolution": (149, 90), "center_px": np.array([70.0, 50.0])}),
    "distorted": (
        turned(-70.0, 40.0),
        {"projection": "opencv", "distortion": np.array([0.03, 0.002, -0.004, 0.0006])},
    ),
}


@pytest.mark.parametrize("height", [12, 25])
@pytest.mark.parametrize("place", PLACES)
def test_texels_are_means_of_the_view_over_their_solid_angle(place, height, device):
    """White noise is the hardest picture there is: it has detail at every pixel."""
    rotation, changes = PLACES[place]
    lens = make_lens(42.0, **{"vignetting": np.array([-0.12, 0.01]), **changes})
    rng = np.random.default_rng(1)
    values = rng.random((lens.resolution[1], lens.resolution[0], 3), dtype=np.float32)
    expected, share = brute_force(lens, rotation, values, height)
    found = compose([(lens, rotation, values)], height, device=device)
    whole, partly = share > 0.999, (share > 0.2) & (share < 0.999)
    error = np.abs(found.values - expected)
    assert error[whole].max() < 0.04
    assert np.sqrt(np.mean(error[whole] ** 2)) < 0.005
    assert error[partly].max() < 0.1
    assert np.abs(found.seen - share)[whole].max() < 2e-3
    assert np.abs(found.seen - share).max() < 0.35
    solid_angle = texel_solid_angles(height, 2 * height)
    assert found.coverage == pytest.approx(solid_angle @ share.sum(axis=1) / 4 / np.pi, abs=0.02)


@pytest.mark.parametrize("place", PLACES)
def test_uniform_light_gives_a_uniform_panorama(place, device):
    """Rim, vignetting, poles and the filled hole included."""
    rotation, changes = PLACES[place]
    lens = make_lens(42.0, **{"vignetting": np.array([-0.12, 0.01]), **changes})
    values = photograph(lens, rotation, lambda rays: np.ones_like(rays) * [3.0, 2.0, 1.0])
    found = compose([(lens, rotation, values)], 40, device=device)
    np.testing.assert_allclose(found.values / [3.0, 2.0, 1.0], 1.0, rtol=1e-3)


# --- Flux and lamps ----------------------------------------------------------------------------

RING = [turned(azimuth) for azimuth in (0.0, 120.0, 240.0)]
RING_AND_ZENITH = [*RING, turned(0.0, 90.0)]
BACK_TO_BACK = [turned(0.0), turned(180.0)]


@pytest.mark.parametrize("place", PLACES)
def test_a_view_keeps_its_flux(place, device):
    """Sum of L dOmega over the pixels, by the host's projection, and over the texels."""
    rotation, changes = PLACES[place]
    scale = 5.0
    larger = {
        "focal_length_px": scale * changes.get("focal_length_px", 84.0 / np.pi),
        "resolution": tuple(5 * side for side in changes.get("resolution", (93, 93))),
        "center_px": scale * changes.get("center_px", np.array([47.1, 45.8])),
    }
    lens = make_lens(42.0, **{"vignetting": np.array([-0.12]), **changes, **larger})
    values = photograph(lens, rotation, smooth_world)
    found = compose([(lens, rotation, values)], 128, device=device)
    at = pixel_grid(lens)
    rays = unproject(lens, at)
    inside = np.isfinite(rays).all(axis=-1)
    share = pixel_solid_angle(lens, at) / vignetting(lens, np.arccos(-rays[..., 2]))
    expected = (share[..., None] * values).sum(axis=(0, 1), where=inside[..., None])
    view = found.views[0]
    np.testing.assert_allclose(view.flux, expected, rtol=1e-5)
    np.testing.assert_allclose(view.panorama_flux, expected, rtol=FLUX_RTOL)
    assert view.flux_error < FLUX_RTOL


def lamps_apart():
    """Return two sets of directions: named places, and any; 2 degrees apart or more in each."""
    named = [
        [0.0, 0.0, -1.0],  # on the seam, in the middle of a view
        [2e-3, 0.3, -1.0],  # beside the seam
        [0.0, 1.0, 0.0],  # on the pole
        [2e-3, -1.0, 1e-3],  # beside the pole
        [1.0, 0.2, 0.0],  # on the rim of a view
        [-np.sin(np.pi / 3), 0.0, -0.5],  # where two views meet
    ]
    any_place = np.random.default_rng(8).normal(size=(6, 3))
    any_place[0] = [0.01, 1.0, -0.008]
    return [unit(np.array(named)), unit(any_place)]


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


@pytest.mark.parametrize("directions", lamps_apart(), ids=["named", "any"])
def test_half_degree_lamps_keep_their_flux_and_their_place(directions, device):
    """Five views of 7 px per degree, so lamps are 3.5 px wide, or 1.4 texels."""
    lens = make_lens(630.0)
    rotations = [*RING_AND_ZENITH, turned(0.0, -90.0)]
    views = [(lens, turn, photograph_lamps(lens, turn, directions)) for turn in rotations]
    found = compose(views, 512, device=device)
    size = 2.0 * np.pi * (1.0 - np.cos(np.radians(0.25)))
    texels = texel_directions(512, 1024)
    excess = (found.values - 0.01) * texel_solid_angles(512, 1024)[:, None, None]
    for direction in directions:
        near = texels @ direction > np.cos(np.radians(1.0))
        total = excess[near].sum(axis=0)
        np.testing.assert_allclose(total, size * (LAMP - 0.01), rtol=LAMP_RTOL)
        middle = unit(excess[near, 0] @ texels[near])
        assert np.degrees(np.linalg.norm(middle - direction)) < 0.1


@pytest.mark.parametrize("error_deg", [0.15, 0.5])
def test_lamp_that_two_views_place_differently_keeps_its_flux(error_deg, device):
    """A weight by each pixel's own variance would prefer the view that is dark there."""
    lens = make_lens(630.0)
    lamp = unit(np.array([[np.sin(np.radians(20.0)), 0.1, -np.cos(np.radians(20.0))]]))
    views = []
    for turn, wrong in ((0.0, turned(error_deg)), (40.0, turned(0.0, error_deg))):
        values = photograph_lamps(lens, turned(turn), lamp @ wrong.T)
        views.append((lens, turned(turn), values, 1e-3 * values))  # photon noise
    found = compose(views, 512, device=device)
    near = texel_directions(512, 1024) @ lamp[0] > np.cos(np.radians(2.0))
    excess = (found.values - 0.01) * texel_solid_angles(512, 1024)[:, None, None]
    size = 2.0 * np.pi * (1.0 - np.cos(np.radians(0.25)))
    np.testing.assert_allclose(excess[near].sum(axis=0), size * (LAMP - 0.01), rtol=LAMP_RTOL)


def test_lamp_is_found_where_it_stands(device):
    """In the middle column for +Z, a quarter from the left for +X, at the top for +Y."""
    lens = make_lens(100.0, 120.0)
    directions = unit(np.array([[0.1, 0.2, 1.0], [1.0, -0.3, 0.2], [-0.2, 1.0, 0.3]]))
    for direction in directions:
        views = []
        for turn in (turned(0.0, 10.0, 25.0), turned(180.0)):
            views.append((lens, turn, photograph_lamps(lens, turn, [direction], diameter_deg=4.0)))
        found = compose(views, 90, device=device)
        row, column = np.unravel_index(np.argmax(found.values[..., 0]), (90, 180))
        u, v = latlong_coordinates(direction)
        assert abs(row + 0.5 - 90 * v) < 1.5
        assert abs(column + 0.5 - 180 * u) * np.sin(np.pi * v) < 1.5


# --- Blending ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "rotations",
    [RING_AND_ZENITH, BACK_TO_BACK, [turned(90.0, 30.0)] * 2],
    ids=["ring and zenith", "back to back", "one place twice"],
)
def test_views_of_a_smooth_world_join_without_seams(rotations, device):
    lens = make_lens(150.0, vignetting=np.array([-0.1]))
    views = []
    for turn in rotations:
        values = photograph(lens, turn, smooth_world)
        views.append((lens, turn, values, 1e-4 * values))
    found = compose(views, 64, device=device)
    expected = smooth_world(texel_directions(64, 128))
    seen = found.seen >= 1.0
    # Texels that are half seen hold the mean of that half.
    error = np.abs(found.values[seen] / expected[seen] - 1.0)
    assert np.quantile(error, 0.98) < 2e-3
    assert error.max() < 8e-3  # at rims that no other view covers, of half a pixel
    np.testing.assert_allclose(
        found.values[found.seen > 0], expected[found.seen > 0], rtol=0.03, atol=0.01
    )
    for view in found.views[1:]:
        assert view.overlap_difference is not None
        assert view.overlap_difference < 1e-2


def test_back_to_back_views_see_everything(device):
    lens = make_lens(150.0)
    views = [(lens, turn, photograph(lens, turn, smooth_world)) for turn in BACK_TO_BACK]
    found = compose(views, 64, device=device)
    assert found.coverage == pytest.approx(1.0, abs=1e-6)
    assert found.holes == ()
    assert np.isfinite(found.values).all()
    assert found.values.min() > 0.0


def test_views_fade_out_towards_their_rims(device):
    """Two views that disagree by a factor of two meet without a step."""
    lens = make_lens(150.0)
    values = photograph(lens, np.eye(3), np.ones_like)
    variance = 1e-4 * np.ones_like(values)
    views = [(lens, turned(0.0), values, variance), (lens, turned(120.0), 2.0 * values, variance)]
    found = compose(views, 90, device=device)
    row = found.values[45, :, 0]
    seen = np.flatnonzero(found.seen[45] >= 1.0)
    steps = np.abs(np.diff(row[seen[0] : seen[-1] + 1]))
    assert row.max() == pytest.approx(2.0, rel=1e-3)
    assert steps.max() < 0.08
    assert found.overlap_difference == pytest.approx(2.0 / 3.0, rel=1e-3)


def test_noisy_view_hardly_counts(device):
    """Weights are inverse variances at equal radiance: of 1 and 100, the mean has 100 / 101."""
    lens = make_lens(60.0)
    values = photograph(lens, np.eye(3), np.ones_like)
    views = [
        (lens, np.eye(3), values, 1.0 * values),
        (lens, np.eye(3), 1.5 * values, 150.0 * values),
    ]
    found = compose(views, 32, device=device)
    seen = found.seen >= 1.0
    np.testing.assert_allclose(found.values[seen], 1.0 + 0.5 / 101.0, rtol=1e-3)
    alone = compose(views[:1], 32, device=device)
    expected = alone.stddev[seen] * np.sqrt(100.0**2 + 150.0) / 101.0
    np.testing.assert_allclose(found.stddev[seen], expected, rtol=1e-3)


@pytest.mark.parametrize("height", [12, 40, 90])
def test_stated_noise_is_the_noise_there_is(height, device):
    """Over 16 seeds, with texels of 9, 2.6 and 1.2 px; vignetting raises it at the rim."""
    lens = make_lens(52.0, vignetting=np.array([-0.15]))
    rng = np.random.default_rng(5)
    values = photograph(lens, np.eye(3), np.ones_like)
    variance = (0.02 * values).astype(np.float32)
    found = []
    for _ in range(16):
        noisy = values + np.sqrt(variance) * rng.standard_normal(values.shape, np.float32)
        found.append(compose([(lens, np.eye(3), noisy, variance)], height, device=device))
    whole = found[0].seen >= 1.0
    actual = np.std([panorama.values[whole] for panorama in found], axis=0, ddof=1)
    stated = np.mean([panorama.stddev[whole] for panorama in found], axis=0)
    assert np.sqrt(np.mean(actual**2 / stated**2)) == pytest.approx(1.0, abs=0.06)


def test_photon_noise_does_not_darken_the_blend(device):
    """Noise of 30 % per pixel, stated by each pixel for itself, two views: the mean stays."""
    lens = make_lens(150.0)
    rng = np.random.default_rng(6)
    views = []
    for turn in (turned(0.0), turned(30.0)):
        counts = rng.poisson(11.0, (lens.resolution[1], lens.resolution[0], 3)).astype(np.float32)
        views.append((lens, turn, counts / 11.0, np.maximum(counts, 1.0) / 11.0**2))
    found = compose(views, 64, device=device)
    both = found.view_count == 2
    assert found.values[both].mean() == pytest.approx(1.0, abs=2e-3)


# --- Clipping and motion -----------------------------------------------------------------------


@pytest.mark.parametrize("order", [(0, 1), (1, 0)])
def test_clipped_view_yields_to_one_that_is_not(order, device):
    """A second, darker bracket mends a lamp, whatever the order; elsewhere the first is as good."""
    lens = make_lens(60.0)
    values = photograph(lens, np.eye(3), np.ones_like)
    lamp = np.zeros(values.shape[:2], bool)
    lamp[50:62, 70:80] = True
    clipped = np.where(lamp[..., None], np.float32(5.0), values)
    status = np.where(lamp, 1, 0).astype(np.uint8)
    whole = np.where(lamp[..., None], np.float32(80.0), values)
    views = [
        (lens, np.eye(3), clipped, np.full_like(values, 1e-4), status),
        (lens, np.eye(3), whole, np.full_like(values, 1e-2), np.zeros_like(status)),
    ]
    found = compose([views[k] for k in order], 64, device=device)
    alone = compose(views[1:], 64, device=device)
    assert (found.clipped == 0.0).all()
    np.testing.assert_allclose(found.values, alone.values, rtol=1e-5)
    first = compose(views[:1], 64, device=device)
    touched = first.clipped > 0.0
    assert (found.view_count[touched] == 1).all()
    assert (found.view_count[(found.seen >= 1.0) & ~touched] == 2).all()


def test_lamp_clipped_in_every_view_keeps_its_greatest_bound_and_a_flag(device):
    lens = make_lens(60.0)
    values = photograph(lens, np.eye(3), np.ones_like)
    lamp = np.zeros(values.shape[:2], bool)
    lamp[40:72, 60:92] = True
    status = np.where(lamp, 1, 0).astype(np.uint8)
    views = []
    for bound in (5.0, 40.0, 20.0):
        views.append(
            (
                lens,
                np.eye(3),
                np.where(lamp[..., None], np.float32(bound), values),
                np.ones_like(values),
                status,
            )
        )
    found = compose(views, 64, device=device)
    inside = found.clipped >= 1.0
    assert inside.any()
    np.testing.assert_allclose(found.values[inside], 40.0, rtol=1e-5)
    size = (found.clipped.sum(axis=1) * texel_solid_angles(64, 128)).sum()
    rays = unproject(lens, pixel_grid(lens))
    share = np.where(lamp & np.isfinite(rays[..., 0]), pixel_solid_angle(lens, pixel_grid(lens)), 0)
    assert size == pytest.approx(share.sum(), rel=0.02)


def test_view_that_moved_yields_to_one_that_did_not(device):
    lens = make_lens(60.0)
    values = photograph(lens, np.eye(3), np.ones_like)
    status = np.full(values.shape[:2], 4, np.uint8)
    quiet = (lens, np.eye(3), values, np.ones_like(values))
    moving = (lens, np.eye(3), 3.0 * values, 3.0 * np.ones_like(values), status)
    found = compose([quiet, moving], 32, device=device)
    seen = found.seen >= 1.0
    np.testing.assert_allclose(found.values[seen], 1.0 + 2.0 * 0.01 / 1.01, rtol=1e-3)
    np.testing.assert_allclose(found.moved[seen], 0.01 / 1.01, rtol=1e-3)
    alone = compose([moving], 32, device=device)
    np.testing.assert_allclose(alone.moved[alone.seen > 0], 1.0, rtol=1e-5)


def test_darkness_below_zero_is_counted_and_set_to_zero(device):
    lens = make_lens(60.0)
    values = photograph(lens, np.eye(3), np.ones_like)
    values[30:50, 60:80, 1] = -0.5
    found = compose([(lens, np.eye(3), values)], 64, device=device)
    assert found.values.min() == 0.0
    assert found.negative_count == (found.values == 0.0).any(axis=2).sum()
    zero = (found.values == 0.0).any(axis=2).sum(axis=1)
    expected = texel_solid_angles(64, 128) @ zero / (4 * np.pi)
    assert found.negative_share == pytest.approx(expected)


# --- Holes -------------------------------------------------------------------------------------


def test_nadir_that_no_view_sees_is_a_hole_filled_within_what_surrounds_it(device):
    """Three views of 160 degrees miss 10 to 20 degrees around the nadir."""
    lens = make_lens(150.0, 80.0)
    views = [(lens, turn, photograph(lens, turn, smooth_world)) for turn in RING_AND_ZENITH]
    found = compose(views, 90, device=device)
    hole = found.seen == 0.0
    nadir = max(found.holes, key=lambda each: -each.direction[1])
    assert nadir.direction[1] == pytest.approx(-1.0, abs=1e-3)
    expected = smooth_world(texel_directions(90, 180))
    low, high = expected[-16:].min(axis=(0, 1)), expected[-16:].max(axis=(0, 1))
    below = hole.copy()
    below[:80] = False
    assert (found.values[below] >= low).all() and (found.values[below] <= high).all()
    np.testing.assert_allclose(found.values[below], expected[below], rtol=0.1)
    assert (found.stddev[hole] == found.values[hole]).all()
    assert sum(each.solid_angle_sr for each in found.holes) == pytest.approx(
        4.0 * np.pi * (hole * texel_solid_angles(90, 180)[:, None]).sum() / (4 * np.pi)
    )


@pytest.mark.parametrize("height", [64, 81])
@pytest.mark.parametrize("middle", [[0.0, -1.0, 0.0], [0.1, 0.2, -1.0], [0.2, 1.0, 0.1]])
def test_fill_is_the_harmonic_continuation_of_the_rim(height, middle):
    """tan(polar / 2) cos(azimuth), about any axis, solves Laplace's equation on the sphere."""
    directions = texel_directions(height, 2 * height)
    axis = unit(np.array(middle))
    aside = unit(np.cross(axis, [0.3, 0.5, 0.8]))
    cosine = directions @ axis
    exact = (directions @ aside) / (1.0 + cosine)
    exact = np.stack([2.0 + exact, 5.0 + 0.0 * exact], axis=-1)
    hole = cosine > np.cos(np.radians(25.0))
    values = np.where(hole[..., None], np.nan, exact)
    fill_holes(values, hole)
    assert np.abs(values - exact).max() < 0.06 * np.tan(np.radians(12.5))  # the rim is coarse
    np.testing.assert_allclose(values[..., 1], 5.0, rtol=1e-12)


def test_hole_around_almost_everything_is_filled_within_what_is_seen():
    directions = texel_directions(40, 80)
    seen = directions @ unit(np.array([0.3, 0.5, -0.8])) > np.cos(np.radians(20.0))
    values = np.where(seen[..., None], smooth_world(directions), np.nan)
    low, high = values[seen].min(axis=0), values[seen].max(axis=0)
    fill_holes(values, ~seen)
    assert (values >= low - 1e-6).all() and (values <= high + 1e-6).all()
    with pytest.raises(ValueError, match="holes alone"):
        fill_holes(values, np.ones((40, 80), bool))


def test_hole_across_the_seam_or_over_a_pole_is_one_hole():
    directions = texel_directions(180, 360)
    axes = unit(np.array([[0.02, 0.0, -1.0], [0.1, 1.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]))
    radius = [8.0, 12.0, 5.0, 3.0]
    mask = np.zeros((180, 360), bool)
    for axis, angle in zip(axes, radius, strict=True):
        mask |= directions @ axis > np.cos(np.radians(angle))
    holes = find_holes(mask)
    assert len(holes) == 4
    for hole, k in zip(holes, [1, 0, 2, 3], strict=True):
        assert hole.diameter_deg == pytest.approx(2.0 * radius[k], rel=0.08)
        assert np.degrees(np.linalg.norm(hole.direction - axes[k])) < 0.5
    assert find_holes(np.zeros((9, 18), bool)) == ()


def test_lamp_on_the_rim_of_a_hole_does_not_fill_it(device):
    directions = texel_directions(90, 180)
    hole = directions[..., 1] < -np.cos(np.radians(20.0))
    values = np.where(hole, np.nan, 1.0)[..., None].repeat(3, axis=2)
    values[69:70, 30:33] = 1e4
    fill_holes(values, hole)
    assert values[hole].min() >= 1.0
    assert values[85:].max() < 200.0


# --- Contracts ---------------------------------------------------------------------------------


def test_threads_and_chunks_do_not_change_a_bit():
    lens = make_lens(90.0, vignetting=np.array([-0.1]))
    rng = np.random.default_rng(2)
    views = []
    for turn in RING_AND_ZENITH:
        shape = (lens.resolution[1], lens.resolution[0])
        values = rng.random((*shape, 3), dtype=np.float32)
        status = rng.choice(np.array([0, 1, 4], np.uint8), shape, p=[0.98, 0.01, 0.01])
        views.append((lens, turn, values, 0.1 * values, status))
    one = compose(views, 100, Workers("cpu", 1))
    many = compose(views, 100, Workers("cpu", 5))
    for name in ("values", "stddev", "seen", "clipped", "moved", "view_count"):
        assert (getattr(one, name) == getattr(many, name)).all(), name
    assert one.coverage == many.coverage
    for a, b in zip(one.views, many.views, strict=True):
        assert (a.flux == b.flux).all() and (a.panorama_flux == b.panorama_flux).all()
        assert a.overlap_difference == b.overlap_difference


def test_footprint_is_where_the_view_is_seen(device):
    rotation, changes = PLACES["cropped"]
    lens = make_lens(42.0, **changes)
    values = photograph(lens, rotation, np.ones_like)
    seen = compose([(lens, rotation, values)], 40, device=device).seen
    found = footprint(lens, rotation, 40)
    assert found[seen >= 1.0].all()
    assert not found[seen <= 0.0].any()


def test_lens_that_cannot_be_is_refused_by_name():
    lens = make_lens(60.0, projection="orthographic", max_angle_deg=100.0)
    values = np.ones((lens.resolution[1], lens.resolution[0], 3), np.float32)
    with pytest.raises(LayerError, match="view 0: fisheye:maxAngle is 100 deg"):
        compose([(lens, np.eye(3), values)])


def test_arrays_that_do_not_fit_are_a_programming_mistake():
    lens = make_lens(60.0)
    values = np.ones((lens.resolution[1], lens.resolution[0], 3), np.float32)
    with pytest.raises(ValueError, match="view 0"):
        compose([(lens, np.eye(3), values[:-1])])
    values[50, 60] = np.nan
    with pytest.raises(ValueError, match="not finite"):
        compose([(lens, np.eye(3), values)])
    with pytest.raises(ValueError, match="no views"):
        compose([])
