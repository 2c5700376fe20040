"""Lights with a place: what the kernels draw from them, against closed forms and float64."""

from __future__ import annotations

import numpy as np
import pytest
from local_light_draws import ON, SHAPES, draw, irradiance, look
from local_light_draws import local_light as light
from numpy.testing import assert_allclose

from usdskin.device import open_workers
from usdskin.render.ies import IntensityProfile
from usdskin.render.local_light_arrays import build_local_field
from usdskin.render.local_lights import Shaping


@pytest.fixture(autouse=True)
def on_device(device, monkeypatch):
    monkeypatch.setattr(ON, "device", open_workers(device, 1).device)


def turned(seed: int) -> np.ndarray:
    """Return the rows of a rotation."""
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return q if np.linalg.det(q) > 0.0 else -q


def surface(kind: str, half, count: int = 400) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return points, outward normals and areas of a light's surface, in its frame, in float64."""
    s = (np.arange(count) + 0.5) / count
    a, b = (grid.ravel() for grid in np.meshgrid(s, s))
    turn = 2.0 * np.pi * b
    if kind == "rect":
        point = np.stack([(2 * a - 1) * half[0], (2 * b - 1) * half[1], 0 * a], axis=1)
        area = np.full(len(a), 4 * half[0] * half[1] / len(a))
    elif kind == "disk":
        r = half[0] * np.sqrt(a)
        point = np.stack([r * np.cos(turn), r * np.sin(turn), 0 * a], axis=1)
        area = np.full(len(a), np.pi * half[0] ** 2 / len(a))
    elif kind == "sphere":
        z = 2 * a - 1
        r = np.sqrt(1 - z * z)
        out = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
        return half[0] * out, out, np.full(len(a), 4 * np.pi * half[0] ** 2 / len(a))
    else:
        out = np.stack([0 * a, np.cos(turn), np.sin(turn)], axis=1)
        point = half[1] * out + np.stack([(2 * a - 1) * half[0], 0 * a, 0 * a], axis=1)
        return point, out, np.full(len(a), 4 * np.pi * half[0] * half[1] / len(a))
    return point, np.tile([0.0, 0.0, -1.0], (len(a), 1)), area


def patches(kind: str, half, position) -> tuple[np.ndarray, np.ndarray]:
    """Return directions to the patches of a light and the solid angles they cover."""
    point, out, area = surface(kind, half)
    gap = point - np.asarray(position)
    distance = np.linalg.norm(gap, axis=1)
    direction = gap / distance[:, None]
    facing = np.maximum(-(direction * out).sum(axis=1), 0.0)
    return direction, facing * area / distance**2


def polygon_irradiance(corners: np.ndarray, normal: np.ndarray) -> float:
    """Return Lambert's closed form for a polygon of radiance 1 that is wholly above the horizon."""
    unit = corners / np.linalg.norm(corners, axis=1, keepdims=True)
    total = 0.0
    for a, b in zip(unit, np.roll(unit, -1, axis=0), strict=True):
        across = np.cross(a, b)
        total += np.arccos(np.clip(a @ b, -1, 1)) * (across @ normal) / np.linalg.norm(across)
    return abs(total) / 2.0


def corners_of(half) -> np.ndarray:
    return np.array(
        [[x * half[0], y * half[1], 0.0] for x, y in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    )


# --- Irradiance --------------------------------------------------------------------------------


@pytest.mark.parametrize("position", [(0, 0, -1), (0.3, 0.2, -0.05), (2, 1, -0.7), (40, -30, -50)])
def test_irradiance_of_a_rectangle_is_that_of_lamberts_polygon(position):
    axes, center = turned(1), np.array([3.0, -1.0, 2.0])
    one = light("rect", center=center, axes=axes)
    corners = (corners_of(one.half) - position) @ axes
    normal = corners.mean(axis=0) / np.linalg.norm(corners.mean(axis=0))
    if (corners @ normal).min() < 0.0:
        normal = axes[2]
    where = center + np.array(position, float) @ axes
    expected = polygon_irradiance(corners, normal)
    assert irradiance(one, where, normal) == pytest.approx(expected, rel=3e-4)


@pytest.mark.parametrize("offset", [0.0, 0.2, 0.39, 0.41, 1.5])
@pytest.mark.parametrize("height", [0.02, 0.3, 2.0, 40.0])
def test_irradiance_of_a_disk_is_the_closed_form(height, offset):
    """pi L (1 - (h^2 + r^2 - R^2) / sqrt((h^2 + r^2 + R^2)^2 - 4 R^2 r^2)) / 2, facing it."""
    r = 0.4
    inside = (height**2 + offset**2 + r * r) ** 2 - 4 * r * r * offset**2
    expected = 0.5 * np.pi * (1.0 - (height**2 + offset**2 - r * r) / np.sqrt(inside))
    found = irradiance(light("disk"), (0.6 * offset, 0.8 * offset, -height), (0, 0, 1))
    assert found == pytest.approx(expected, rel=3e-4 if height > 0.1 else 5e-3)


@pytest.mark.parametrize("away", [0.41, 1.0, 400.0])
def test_irradiance_of_a_sphere_is_pi_r_squared_over_d_squared(away):
    one = light("sphere", center=(1.0, 2.0, 3.0))
    toward = np.array([2.0, -1.0, 2.0]) / 3.0
    expected = np.pi * (0.4 / away) ** 2
    assert irradiance(one, one.center - away * toward, toward) == pytest.approx(expected, rel=1e-4)
    # Tilted by less than what it is above the horizon.
    if away > 0.9:
        side = np.array([1.0, 2.0, 0.0]) / np.sqrt(5.0)
        tilted = np.cos(0.8) * toward + np.sin(0.8) * side
        found = irradiance(one, one.center - away * toward, tilted)
        assert found == pytest.approx(expected * np.cos(0.8), rel=1e-4)


@pytest.mark.parametrize("position", [(0, 0, -0.5), (0, 0, -0.06), (0.9, 0.1, -0.2), (20, 30, -9)])
def test_irradiance_of_a_cylinder_is_that_of_its_patches(position):
    direction, omega = patches("cylinder", SHAPES["cylinder"], position)
    normal = -np.array(position, float) / np.linalg.norm(position)
    expected = float((omega * np.maximum(direction @ normal, 0.0)).sum())
    found = irradiance(light("cylinder"), position, normal)
    assert found == pytest.approx(expected, rel=1e-3)


def test_irradiance_of_a_line_is_the_closed_form():
    """At the height h of a line's middle, facing it: (a / (h^2 + a^2) + atan(a / h) / h) per width.

    It is the integral of cos^2 over the line, divided by its distance squared.
    """
    a, h = 0.6, 0.25
    expected = a / (h * h + a * a) + np.arctan(a / h) / h
    found = irradiance(light("line", (a, 0.0)), (0.0, 0.0, -h), (0, 0, 1))
    assert found == pytest.approx(expected, rel=1e-5)


def test_a_thin_cylinder_is_a_line_as_wide():
    axes = turned(5)
    where = np.array([0.4, 0.3, -0.7]) @ axes
    thin = light("cylinder", (0.6, 1e-4), axes=axes)
    line = light("line", (0.6, 0.0), axes=axes)
    normal = -where / np.linalg.norm(where)
    found = irradiance(thin, where, normal)
    assert found == pytest.approx(2e-4 * irradiance(line, where, normal), rel=1e-3)


def test_a_point_has_the_inverse_square():
    drawn = draw(light("point", center=(0.0, 3.0, 4.0)), (0, 0, 0))
    assert_allclose(drawn.weight, 1.0 / 25.0, rtol=1e-6)
    assert (drawn.delta == 1.0).all() and (drawn.pdf == 0.0).all()
    assert drawn.direction[0] == pytest.approx([0.0, 0.6, 0.8])
    assert drawn.distance[0] == pytest.approx(5.0)


# --- Solid angles and densities ----------------------------------------------------------------


def rect_solid_angle(half, position) -> float:
    """Return the sum of both triangles (van Oosterom and Strackee 1983)."""
    corners = corners_of(half) - position
    total = 0.0
    for triangle in (corners[[0, 1, 2]], corners[[0, 2, 3]]):
        a, b, c = triangle
        x, y, z = np.linalg.norm(triangle, axis=1)
        below = x * y * z + (a @ b) * z + (b @ c) * x + (c @ a) * y
        total += 2.0 * np.arctan2(abs(a @ np.cross(b, c)), below)
    return total


@pytest.mark.parametrize(
    "position",
    [
        (0, 0, -0.01),
        (0.499, 0.299, -0.001),
        (0.6, 0, -0.01),
        (5, 4, -3),
        (0, 0, -500),
        (700, 1, -2),
    ],
)
def test_weights_of_a_rectangle_sum_to_its_solid_angle(position):
    expected = rect_solid_angle(SHAPES["rect"], np.array(position, float))
    assert draw(light("rect"), position).weight.mean() == pytest.approx(expected, rel=3e-4)


@pytest.mark.parametrize("away", [0.4001, 0.5, 4.0, 400.0, 4e5])
def test_weights_of_a_sphere_are_its_solid_angle(away):
    expected = 2.0 * np.pi * (0.4 / away) ** 2 / (1.0 + np.sqrt(1.0 - (0.4 / away) ** 2))
    weight = draw(light("sphere"), (0, away, 0)).weight
    assert_allclose(weight, expected, rtol=2e-3 if away < 0.41 else 1e-5)


@pytest.mark.parametrize("height", [1e-3, 0.4, 4.0, 4000.0])
def test_weights_of_a_disk_sum_to_its_solid_angle_on_its_axis(height):
    expected = 2.0 * np.pi * 0.16 / (np.hypot(height, 0.4) * (np.hypot(height, 0.4) + height))
    assert draw(light("disk"), (0, 0, -height)).weight.mean() == pytest.approx(expected, rel=1e-4)


POSITIONS = [(0.1, -0.2, -0.9), (0.3, 0.25, -0.15), (1.1, 0.4, -0.3), (-0.2, 0.7, -0.45)]


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("position", POSITIONS)
def test_densities_integrate_to_one(kind, position):
    direction, omega = patches(kind, SHAPES[kind], position)
    if np.linalg.norm(position) < 0.4 and kind == "sphere":
        pytest.skip("inside")
    seen = omega > 0.0
    _, density, _ = look(light(kind), position, direction[seen])
    assert float((density * omega[seen]).sum()) == pytest.approx(1.0, rel=3e-3)
    assert draw(light(kind), position).weight.mean() == pytest.approx(omega.sum(), rel=2e-3)


@pytest.mark.parametrize("kind", SHAPES)
@pytest.mark.parametrize("position", [*POSITIONS, (300, 500, -400), (0.5, 0.1, -0.41)])
def test_rays_meet_a_light_where_it_was_sampled(kind, position):
    drawn = draw(
        light(kind, axes=turned(2), center=(1, 0, -1)), np.array(position) @ turned(2) + (1, 0, -1)
    )
    if (drawn.weight == 0.0).all():
        assert kind in ("sphere",) and np.linalg.norm(position) < 0.4
        return
    met = drawn.distance_again >= 0.0
    assert met.mean() > 0.99  # those on the rim may miss
    assert np.isfinite(drawn.weight).all() and (drawn.weight > 0.0).all()
    assert_allclose(drawn.distance_again[met], drawn.distance[met], rtol=3e-4)
    assert_allclose(drawn.pdf_again[met] * drawn.weight[met], 1.0, rtol=1e-4)
    assert_allclose(drawn.pdf * drawn.weight, 1.0, rtol=1e-6)
    assert_allclose(np.linalg.norm(drawn.direction, axis=1), 1.0, atol=1e-6)
    assert (drawn.radiance_again[met] == drawn.radiance[met]).all()


@pytest.mark.parametrize("kind", ["rect", "disk"])
def test_flat_lights_shine_along_minus_z_only(kind):
    for axes in (np.eye(3), np.diag([-1.0, 1.0, 1.0])):  # a mirror keeps the side
        assert (draw(light(kind, axes=axes), (0, 0, -1)).weight > 0.0).all()
        assert (draw(light(kind, axes=axes), (0, 0, 1)).weight == 0.0).all()
        assert (draw(light(kind, axes=axes), (0, 0, 0)).weight == 0.0).all()
    toward = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    assert look(light(kind), (0, 0, -2), toward)[0].tolist() == [2.0, -1.0]
    assert look(light(kind), (0, 0, 2), toward)[0].tolist() == [-1.0, -1.0]


@pytest.mark.parametrize("kind", ["sphere", "cylinder"])
def test_nothing_is_seen_from_inside(kind):
    drawn = draw(light(kind), (0.01, 0.02, -0.01))
    assert (drawn.weight == 0.0).all() and np.isfinite(drawn.direction).all()
    assert look(light(kind), (0.01, 0.02, -0.01), np.array([[0.0, 0.0, 1.0]]))[0] == -1.0


def test_the_ends_of_a_cylinder_are_dark():
    assert (draw(light("cylinder"), (2.0, 0.0, 0.0)).weight == 0.0).all()
    along = look(light("cylinder"), (2.0, 0.0, 0.1), np.array([[-1.0, 0.0, 0.0]]))
    assert along[0] == -1.0


@pytest.mark.parametrize("kind", SHAPES)
def test_each_stratum_gets_a_sample(kind):
    """The mean of 256 samples that fill the strata is nearer than chance would have it."""
    drawn = draw(light(kind), (0.5, 0.4, -0.9))
    term = drawn.weight * drawn.direction[:, 2]
    parts = term.reshape(-1, 256).mean(axis=1)
    assert parts.std() < 0.2 * term.std() / 16.0 + 1e-6 * term.mean()


# --- Emission ----------------------------------------------------------------------------------


def shaped(angle_deg, kind="point", **options) -> np.ndarray:
    """Return what a light sends at an angle off its -z axis, towards +x."""
    a = np.radians(angle_deg)
    one = light(kind, shaping=Shaping(**options), channels=3 if "focus_tint" in options else 1)
    return draw(one, (5.0 * np.sin(a), 0.0, -5.0 * np.cos(a))).radiance[0]


@pytest.mark.parametrize(
    ("angle", "value"), [(0.0, 1.0), (20.0, 1.0), (25.0, 0.84375), (30.0, 0.5), (40.01, 0.0)]
)
def test_a_cone_fades_by_smoothstep(angle, value):
    """Softness 0.5 of 40 degrees: from 20 to 40; at 25, t = 1/4 and 1 - 3/16 + 2/64."""
    found = shaped(angle, cone_angle=np.radians(40.0), cone_softness=0.5)[0]
    assert found == pytest.approx(value, abs=1e-5)


def test_a_hard_cone_is_a_step():
    assert shaped(39.9, cone_angle=np.radians(40.0))[0] == 1.0
    assert shaped(40.1, cone_angle=np.radians(40.0))[0] == 0.0
    assert shaped(179.0, cone_angle=np.radians(100.0))[0] == 0.0


def test_focus_is_a_power_of_the_cosine_on_both_sides():
    assert shaped(60.0, focus=3.0)[0] == pytest.approx(0.125, rel=1e-5)
    assert shaped(120.0, focus=3.0)[0] == pytest.approx(0.125, rel=1e-5)


def test_focus_tint_colors_what_falls_off():
    """lerp(1/4, tint, white) with the cosine 1/2 squared."""
    found = shaped(60.0, focus=2.0, focus_tint=(1.0, 0.5, 0.0))
    assert found == pytest.approx([1.0, 0.625, 0.25, 0.0], rel=1e-5)


def profile() -> IntensityProfile:
    theta, phi = np.array([0.0, 45.0, 90.0]), np.array([0.0, 90.0, 180.0, 270.0, 360.0])
    table = np.array([[8.0] * 5, [4.0, 2.0, 4.0, 6.0, 4.0], [0.0] * 5])
    return IntensityProfile(theta, phi, table)


def test_a_profile_is_linear_between_its_angles():
    at = {"profile": profile()}
    assert shaped(0.0, **at)[0] == pytest.approx(8.0)
    assert shaped(45.0, **at)[0] == pytest.approx(4.0)
    assert shaped(22.5, **at)[0] == pytest.approx(6.0, rel=1e-5)
    assert shaped(120.0, **at)[0] == 0.0


def test_a_profile_turns_from_x_to_y():
    one = light("point", shaping=Shaping(profile=profile()))
    for place, value in (((1, 0), 4.0), ((0, 1), 2.0), ((-1, 0), 4.0), ((0, -1), 6.0)):
        assert draw(one, (*place, -1.0)).radiance[0, 0] == pytest.approx(value, rel=1e-5)
    half = np.sqrt(0.5)
    assert draw(one, (half, half, -1.0)).radiance[0, 0] == pytest.approx(3.0, rel=1e-5)


def test_angle_scale_stretches_a_profile_from_either_end():
    at = {"profile": profile()}
    assert shaped(22.5, angle_scale=0.5, **at)[0] == pytest.approx(4.0, rel=1e-5)
    assert shaped(90.0, angle_scale=2.0, **at)[0] == pytest.approx(4.0, rel=1e-5)
    # (150 - 180) / 0.25 + 180 = 60 degrees.
    assert shaped(150.0, angle_scale=-0.25, **at)[0] == pytest.approx(4.0 * 2.0 / 3.0, rel=1e-4)


def test_an_odd_spacing_keeps_a_profiles_shape():
    theta = np.array([0.0, 7.3, 33.1, 90.0])
    odd = IntensityProfile(
        theta, np.array([0.0, 360.0]), np.repeat([[5.0], [3.0], [2.0], [1.0]], 2, 1)
    )
    for angle in (3.0, 7.3, 20.0, 60.0):
        expected = np.interp(angle, theta, odd.intensity[:, 0])
        assert shaped(angle, profile=odd)[0] == pytest.approx(expected, rel=3e-3)


def test_a_picture_stands_upright_before_who_it_lights():
    """Its top left is at (+x, +y): left, above, of who looks along +z."""
    picture = np.arange(18, dtype=np.float32).reshape(2, 3, 3)
    one = light("rect", (1.5, 1.0), channels=3, texture=picture)
    rows = [0.5, -0.5]
    columns = [1.0, 0.0, -1.0]
    for i, y in enumerate(rows):
        for j, x in enumerate(columns):
            toward = np.array([[x, y, 3.0]]) / np.linalg.norm([x, y, 3.0])
            found = look(one, (0, 0, -3), toward)[2]
            assert found[0, :3].tolist() == picture[i, j].tolist()


def test_irradiance_of_a_picture_is_that_of_its_texels():
    picture = np.zeros((2, 2, 3), np.float32)
    picture[0, 0] = 2.0
    picture[1, 1] = 5.0
    position = np.array([0.2, -0.1, -0.8])
    expected = 0.0
    for x, y, value in ((0.25, 0.15, 2.0), (-0.25, -0.15, 5.0)):
        corners = corners_of((0.25, 0.15)) - (position - [x, y, 0.0])
        expected += value * polygon_irradiance(corners, np.array([0.0, 0.0, 1.0]))
    one = light("rect", channels=3, texture=picture)
    assert irradiance(one, position, (0, 0, 1)) == pytest.approx(expected, rel=2e-3)


@pytest.mark.parametrize("shape", [(2, 2), (8, 5), (90, 50)])
@pytest.mark.parametrize("position", [(0.1, -0.2, -0.9), (0.3, 0.25, -0.1), (1.1, 0.4, -0.3)])
def test_directions_drawn_by_a_picture_keep_their_density(shape, position):
    picture = np.random.default_rng(3).random((*shape, 3)).astype(np.float32) ** 8
    one = light("rect", channels=3, texture=picture)
    direction, omega = patches("rect", SHAPES["rect"], position)
    _, density, value = look(one, position, direction)
    assert float((density * omega).sum()) == pytest.approx(1.0, rel=5e-3)
    drawn = draw(one, position)
    expected = (value[:, :3] * (direction[:, 2] * omega)[:, None]).sum(axis=0)
    found = (drawn.radiance * (drawn.weight * drawn.direction[:, 2])[:, None]).mean(axis=0)
    assert found[:3] == pytest.approx(expected, rel=4e-2)  # of 4500 random texels
    met = drawn.distance_again >= 0.0
    # Points on an edge between cells may be met beyond it.
    same = np.abs(drawn.pdf_again[met] * drawn.weight[met] - 1.0) < 1e-3
    assert same.mean() > 0.995


def test_a_bright_spot_of_a_picture_is_found():
    """One texel of 64 is all the light: without the picture the spread would be eight times."""
    picture = np.zeros((8, 8, 3), np.float32)
    picture[2, 5] = 1.0
    term = {}
    for name, texture in (("spot", picture), ("even", np.ones_like(picture))):
        drawn = draw(light("rect", channels=3, texture=texture), (0.3, 0.2, -1.5))
        value = drawn.radiance[:, 0] * drawn.weight * drawn.direction[:, 2]
        term[name] = value.std() / value.mean()
    assert term["even"] < 0.2 and term["spot"] < 1.0


# --- Channels ----------------------------------------------------------------------------------


def test_channels_are_packed_four_to_a_group_and_none_is_torn():
    lights = tuple(light(channels=n) for n in (1, 3, 3, 1, 1, 3, 1))
    for k, one in enumerate(lights):
        one.radiance[:] = 10.0 * k + np.arange(len(one.radiance))[:, None]
    field = build_local_field(lights, 2, ON.device, first_group=5)
    assert field.places == ((0, 0), (0, 1), (1, 0), (1, 3), (2, 0), (2, 1), (3, 0))
    assert field.basis.shape == (4, 4, 2)
    for one, (group, lane) in zip(lights, field.places, strict=True):
        assert (field.basis[group, lane : lane + len(one.radiance)] == one.radiance).all()
    assert field.device_lights.channel.numpy()[:, 0].tolist() == [5, 5, 6, 6, 7, 7, 8]


def test_a_light_shines_in_its_own_lanes():
    before = (light(), light())
    assert draw(light("sphere"), (0, 0, -1), before).radiance[0].tolist() == [0, 0, 1, 0]
    tinted = light("sphere", channels=3)
    assert draw(tinted, (0, 0, -1), before[:1]).radiance[0].tolist() == [0, 1, 1, 1]


def test_no_lights_are_an_empty_field():
    field = build_local_field((), 2, ON.device)
    assert field.device_lights.count == 0 and field.basis.shape == (0, 4, 2)
