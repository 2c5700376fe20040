"""Tangent frames against closed forms, and what MikkTSpace says they do not depend on."""

from __future__ import annotations

import numpy as np
import pytest

from usdskin.render.mesh_tangents import Corners, gradient_frames, names_of, tangent_frames

RNG_SEED = 5


def grid(columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
    """Return s, t at the vertices of a grid, shape [n, 2], and its triangles."""
    s, t = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    index = np.arange((columns + 1) * (rows + 1)).reshape(rows + 1, columns + 1)
    a, b, c, d = (part.ravel() for part in
                  (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))  # fmt: skip
    faces = np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])
    return np.stack([s.ravel(), t.ravel()], 1), faces


def corners_of(surface, columns: int, rows: int) -> Corners:
    """Return a surface (points, normals) over s, t as corners."""
    st, faces = grid(columns, rows)
    points, normals = surface(*st.T)
    return Corners(points[faces], normals[faces], st[faces])


def plane(s, t):
    points = np.stack([2.0 * s, 3.0 * t, np.zeros_like(s)], 1)
    return points, np.tile([0.0, 0.0, 1.0], (len(s), 1))


def cylinder(s, t):
    """Radius 0.5, once around +Z, 2 high."""
    turn = 2.0 * np.pi * s
    normal = np.stack([np.cos(turn), np.sin(turn), np.zeros_like(s)], 1)
    return 0.5 * normal + np.stack([0 * t, 0 * t, 2.0 * t], 1), normal


def sphere(s, t):
    """Radius 0.5, between the polar circles."""
    turn, up = 2.0 * np.pi * s, np.pi * (0.6 * t - 0.3)
    normal = np.stack([np.cos(up) * np.cos(turn), np.cos(up) * np.sin(turn), np.sin(up)], 1)
    return 0.5 * normal, normal


def bitangents(frames: np.ndarray, normals: np.ndarray) -> np.ndarray:
    return frames[..., 3:] * np.cross(normals, frames[..., :3])


# Tangents of the corners of saddle(), by generateTangents of the npm package mikktspace 1.1.1,
# which is Mikkelsen's algorithm in WebAssembly.
MIKKTSPACE = np.array([
    (-0.94614, 0.24166, -0.21544, -1),
    (-0.86229, 0.31043, 0.40010, -1),
    (-0.95248, 0.30307, -0.03031, -1),
    (0.85340, 0.25863, -0.45256, 1),
    (0.68602, 0.28752, -0.66836, 1),
    (0.85315, 0.31150, -0.41844, 1),
    (-0.79158, 0.20290, -0.57640, -1),
    (-0.95248, 0.30307, -0.03031, -1),
    (-0.85456, 0.25450, -0.45273, -1),
    (0.95459, 0.29643, -0.02964, 1),
    (0.85315, 0.31150, -0.41844, 1),
    (0.95558, 0.29466, -0.00716, 1),
    (-0.94614, 0.24166, -0.21544, -1),
    (-0.95248, 0.30307, -0.03031, -1),
    (-0.79158, 0.20290, -0.57640, -1),
    (0.85340, 0.25863, -0.45256, 1),
    (0.85315, 0.31150, -0.41844, 1),
    (0.95459, 0.29643, -0.02964, 1),
    (-0.79158, 0.20290, -0.57640, -1),
    (-0.85456, 0.25450, -0.45273, -1),
    (-0.61911, 0.17091, -0.76648, -1),
    (0.95459, 0.29643, -0.02964, 1),
    (0.95558, 0.29466, -0.00716, 1),
    (0.86229, 0.31043, 0.40010, 1),
])  # fmt: skip


def saddle() -> Corners:
    """Return eight triangles whose texture folds over at x = 0; their normals are made up."""

    def surface(s, t):
        x, y = 2.0 * s - 1.0, 2.0 * t - 1.0
        points = np.stack([x, y, 0.5 * x * y - 0.3 * x * x], 1)
        normals = np.stack([0.6 * x - 0.5 * y, -0.4 * x + 0.1, np.ones_like(x)], 1)
        return points, normals / np.linalg.norm(normals, axis=1, keepdims=True)

    corners = corners_of(surface, 2, 2)
    x, y = corners.points[..., 0], corners.points[..., 1]
    st = np.stack([np.abs(x) + 0.2 * y, y - 0.3 * x**2], -1)
    return Corners(corners.points, corners.normals, st)


def test_tangents_equal_those_of_mikktspace():
    found = tangent_frames(saddle()).reshape(-1, 4)
    np.testing.assert_allclose(found, MIKKTSPACE, atol=6e-6)


def test_frame_of_a_plane_is_its_axes():
    corners = corners_of(plane, 3, 2)
    frames = tangent_frames(corners)
    np.testing.assert_allclose(frames, np.broadcast_to([1, 0, 0, 1], frames.shape), atol=1e-6)
    along_s, along_t = gradient_frames(corners)
    np.testing.assert_allclose(
        along_s, np.broadcast_to([0.5, 0, 0, 0], frames.shape), rtol=1e-6, atol=1e-9
    )
    np.testing.assert_allclose(
        along_t, np.broadcast_to([0, 1 / 3, 0, 0], frames.shape), rtol=1e-6, atol=1e-9
    )


@pytest.mark.parametrize("surface", [cylinder, sphere])
def test_tangents_of_round_surfaces_run_along_the_parallels(surface):
    """T = e_turn and B = e_up. At the seam and the rims the triangles lie on one side only."""
    corners = corners_of(surface, 96, 48)
    frames = tangent_frames(corners)
    turn = 2.0 * np.pi * corners.st[..., 0]
    east = np.stack([-np.sin(turn), np.cos(turn), np.zeros_like(turn)], -1)
    inside = ((corners.st > 0.0) & (corners.st < 1.0)).all(axis=-1)
    np.testing.assert_allclose(frames[inside][:, :3], east[inside], atol=1e-3)
    np.testing.assert_allclose(frames[..., :3], east, atol=0.05)
    north = np.cross(corners.normals, east)
    found = bitangents(frames, corners.normals)
    np.testing.assert_allclose(found[inside], north[inside], atol=1e-3)


@pytest.mark.parametrize(("surface", "height"), [(cylinder, 2.0), (sphere, 0.5 * 0.6 * np.pi)])
def test_gradients_are_one_over_the_length_of_the_texture(surface, height):
    corners = corners_of(surface, 96, 48)
    along_s, along_t = gradient_frames(corners)
    radius = np.linalg.norm(corners.points[..., :2], axis=-1)
    inside = ((corners.st > 0.0) & (corners.st < 1.0)).all(axis=-1)
    lengths = np.linalg.norm(along_s, axis=-1) * 2.0 * np.pi * radius
    np.testing.assert_allclose(lengths[inside], 1.0, rtol=2e-3)
    np.testing.assert_allclose(np.linalg.norm(along_t, axis=-1)[inside] * height, 1.0, rtol=2e-3)


def test_tangents_lie_in_the_plane_of_the_shading_normal():
    corners = corners_of(sphere, 12, 6)
    frames = tangent_frames(corners)
    assert np.abs(np.einsum("...i,...i->...", frames[..., :3], corners.normals)).max() < 1e-6
    np.testing.assert_allclose(np.linalg.norm(frames[..., :3], axis=-1), 1.0, atol=1e-6)


@pytest.mark.parametrize("mirror", ["s", "t"])
def test_mirrored_coordinates_turn_the_sign_and_keep_both_axes_true(mirror):
    """The bitangent points to where t grows, also where the island is mirrored."""
    corners = corners_of(sphere, 24, 12)
    axis = "st".index(mirror)
    flip = np.array([1.0, 1.0])
    flip[axis] = -1.0
    plain = tangent_frames(corners)
    mirrored = tangent_frames(Corners(corners.points, corners.normals, corners.st * flip))
    assert (mirrored[..., 3] == -1.0).all() and (plain[..., 3] == 1.0).all()
    np.testing.assert_allclose(mirrored[..., :3], flip[0] * plain[..., :3], atol=1e-6)
    np.testing.assert_allclose(
        bitangents(mirrored, corners.normals),
        flip[1] * bitangents(plain, corners.normals),
        atol=1e-6,
    )


def test_islands_that_mirror_each_other_keep_tangents_of_their_own():
    """s = |x|: on the vertices in the middle, shared by both halves, neither gets the mean."""
    corners = corners_of(plane, 4, 2)
    st = corners.st.copy()
    st[..., 0] = np.abs(st[..., 0] - 0.5)
    frames = tangent_frames(Corners(corners.points, corners.normals, st))
    left = corners.points[..., 0].mean(axis=1) < 1.0
    np.testing.assert_allclose(frames[left, :, 0], -1.0, atol=1e-6)
    np.testing.assert_allclose(frames[~left, :, 0], 1.0, atol=1e-6)
    np.testing.assert_array_equal(frames[left, :, 3], -1.0)


def test_order_of_triangles_corners_and_vertices_does_not_count():
    """As MikkTSpace promises of itself."""
    corners = corners_of(sphere, 10, 8)
    rng = np.random.default_rng(RNG_SEED)
    order = rng.permutation(len(corners.points))
    turn = rng.integers(0, 3, len(order))
    pick = (np.arange(3) + turn[:, None]) % 3
    moved = Corners(*(
        part[order][np.arange(len(order))[:, None], pick]
        for part in (corners.points, corners.normals, corners.st)
    ))  # fmt: skip
    expected = tangent_frames(corners)[order][np.arange(len(order))[:, None], pick]
    np.testing.assert_allclose(tangent_frames(moved), expected, atol=1e-6)


def test_weights_are_angles_so_that_cutting_a_side_does_not_count():
    """A corner of a cube-like fan: cutting one face into many slivers leaves the tangent."""
    normal = np.array([0.3, 0.2, 1.0]) / np.linalg.norm([0.3, 0.2, 1.0])

    def fan(angles):
        rim = np.stack([np.cos(angles), np.sin(angles), -0.3 * np.cos(3 * angles)], 1)
        st = np.stack([np.cos(angles) + 0.4 * np.sin(2 * angles), np.sin(angles)], 1)
        # Both are linear within the first third, so that cuts there add nothing.
        third = (angles > 0.0) & (angles < 2.0)
        blend = np.zeros(third.sum())
        a, b = rim[0], rim[np.flatnonzero(angles == 2.0)[0]]
        direction = np.stack([np.cos(angles[third]), np.sin(angles[third])], 1)
        weights = np.linalg.solve(np.stack([a[:2], b[:2]], 1), direction.T).T
        blend = weights / weights.sum(axis=1, keepdims=True)
        rim[third] = blend @ np.stack([a, b])
        st[third] = blend @ np.stack([st[0], st[np.flatnonzero(angles == 2.0)[0]]])
        count = len(angles) - 1
        points = np.stack([np.zeros((count, 3)), rim[:-1], rim[1:]], 1)
        coordinates = np.stack([np.zeros((count, 2)), st[:-1], st[1:]], 1)
        return Corners(points, np.tile(normal, (count, 3, 1)), coordinates)

    coarse = tangent_frames(fan(np.array([0.0, 2.0, 3.5, 5.0])))[0, 0]
    fine = tangent_frames(fan(np.array([0.0, 0.2, 0.4, 1.5, 2.0, 3.5, 5.0])))[0, 0]
    np.testing.assert_allclose(fine, coarse, atol=2e-6)


def test_triangles_without_area_in_the_texture_take_their_neighbours_or_none():
    corners = corners_of(plane, 2, 1)
    st = corners.st.copy()
    st[0] = st[0, 0]
    frames = tangent_frames(Corners(corners.points, corners.normals, st))
    assert np.isfinite(frames).all()
    np.testing.assert_allclose(frames[1:, :, 0], 1.0, atol=1e-6)
    flat = tangent_frames(Corners(corners.points, corners.normals, np.zeros_like(st)))
    assert not flat[..., :3].any()
    assert not np.any(gradient_frames(Corners(corners.points, corners.normals, 0 * st)))


def test_names_tell_values_apart_and_nothing_else():
    rng = np.random.default_rng(RNG_SEED)
    rows = rng.integers(-2, 3, (500, 3, 3)).astype(float)
    names = names_of(rows[..., :2], rows[..., 2:])
    _, expected = np.unique(rows.reshape(-1, 3), axis=0, return_inverse=True)
    pairs = np.unique(np.stack([names.ravel(), expected.ravel()], 1), axis=0)
    assert len(pairs) == names.max() + 1 == expected.max() + 1
    zeros = names_of(np.array([[[0.0], [-0.0], [1.0]]]))
    assert zeros[0, 0] == zeros[0, 1] != zeros[0, 2]
