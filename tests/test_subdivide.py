"""Subdivision against closed forms, spline theory and OpenSubdiv."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from usdskin.render.mesh_channels import face_varying_channel
from usdskin.render.mesh_limit import cage_normals, limit_surface
from usdskin.render.mesh_net import boundary_faces, control_net, find_edges, sharpen
from usdskin.render.mesh_topology import build_topology, refine_to_quads, refine_to_triangles
from usdskin.render.polygons import is_closed
from usdskin.render.subdivide import refine, refine_values, subdivide

CUBE_POINTS = np.array(list(itertools.product((-1.0, 1.0), repeat=3)))
CUBE_FACES = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
NO_EDGES = np.empty((0, 2), dtype=int)
NOTHING = np.empty(0, dtype=int)


def grid(columns, rows, triangles=False):
    """Return points of a flat unit grid and its faces, counter-clockwise about +Z."""
    y, x = np.mgrid[: rows + 1, : columns + 1]
    points = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(float)
    first = (np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)).ravel()
    quads = first[:, None] + [0, 1, columns + 2, columns + 1]
    if triangles:
        return points, quads[:, [0, 1, 2, 0, 2, 3]].reshape(-1, 3)
    return points, quads


def net_of(faces, point_count, scheme="catmullClark", creases=NO_EDGES, sharpness=(), **options):
    counts = np.array([len(face) for face in faces])
    net = control_net(counts, np.concatenate(faces), point_count, scheme, **options)
    edges = find_edges(net.topology, np.asarray(creases)[:, 0], np.asarray(creases)[:, 1])
    assert (edges >= 0).all()
    return sharpen(net, edges, np.asarray(sharpness, float), NOTHING, np.empty(0))


def random_cage(seed, triangles=False):
    """Return a grid with rough points."""
    points, faces = grid(5, 4, triangles)
    return points + np.random.default_rng(seed).normal(0.0, 0.2, points.shape), faces


def refined_values(net, values, level):
    for _ in range(level):
        values = refine_values(net, values)
        net = refine(net)
    return net, values


def angle(first, second):
    """Return the angles between unit vectors [deg]."""
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", first, second), -1.0, 1.0)))


def mean_moments(values):
    return np.concatenate([values.mean(axis=0), (values**2).mean(axis=0)])


@pytest.mark.parametrize("level", [1, 2, 3])
def test_cube_corner_tends_to_half_of_itself(level):
    # (9 v + 4 sum e + sum d) / 24 with e and d the other corners of the three faces there.
    refined = subdivide(net_of(CUBE_FACES, 8), level, CUBE_POINTS)
    np.testing.assert_allclose(refined.vertex[:8], 0.5 * CUBE_POINTS, atol=1e-14)
    corner = np.flatnonzero(refined.topology.corner_vertex == 7)[0]
    normal = refined.normals.rows[refined.normals.index[corner]]
    np.testing.assert_allclose(normal, np.full(3, 3**-0.5), atol=1e-12)


def test_refining_without_the_limit_stencil_converges_to_it():
    _, values = refined_values(net_of(CUBE_FACES, 8), CUBE_POINTS, 7)
    np.testing.assert_allclose(values[:8], 0.5 * CUBE_POINTS, atol=1e-4)


@pytest.mark.parametrize("scheme", ["catmullClark", "loop"])
@pytest.mark.parametrize("boundary", ["edgeOnly", "edgeAndCorner"])
def test_every_level_lies_on_the_same_limit_surface(scheme, boundary):
    points, faces = random_cage(1, scheme == "loop")
    net = net_of(faces, len(points), scheme, boundary=boundary)
    coarse, fine = subdivide(net, 1, points), subdivide(net, 3, points)
    count = coarse.topology.vertex_count
    np.testing.assert_allclose(fine.vertex[:count], coarse.vertex, atol=1e-13)
    mesh = coarse.topology
    rim = mesh.edge_vertex[mesh.edge[mesh.twin < 0]]
    inner = np.setdiff1d(np.arange(count), rim)
    assert angle(fine.normals.rows[inner], coarse.normals.rows[inner]).max() < 1e-5


@pytest.mark.parametrize(("scheme", "spread"), [("catmullClark", 1 / 6), ("loop", 1 / 8)])
@pytest.mark.parametrize("level", [1, 2])
def test_regular_surface_is_the_spline_of_its_scheme(scheme, spread, level):
    # A box spline of order 4 turns the cubic p at its control points into p + c lap p, with c half
    # its variance along an axis: (1/3) / 2 for bicubic B-splines, (1/4) / 2 for M222 (de Boor,
    # Hollig, Riemenschneider 1993). Loop's lattice of equilateral triangles is sheared to fit.
    points, faces = grid(8, 8, scheme == "loop")
    if scheme == "loop":
        points[:, 0] -= 0.5 * points[:, 1]
        points[:, 1] *= 0.75**0.5

    def cubic(x, y):
        return 0.02 * x**3 - 0.05 * x * y**2 + 0.1 * x * y - 0.07 * y**2 + 0.3 * x

    points[:, 2] = cubic(points[:, 0], points[:, 1])
    refined = subdivide(net_of(faces, len(points), scheme), level, points)
    x, y, z = refined.vertex.T
    row = y / (points[-1, 1] / 8)
    column = x + 0.5 * row if scheme == "loop" else x
    inner = (row > 1.99) & (row < 6.01) & (column > 1.99) & (column < 6.01)
    assert inner.sum() > 80
    laplacian = 0.12 * x - 0.1 * x - 0.14
    np.testing.assert_allclose(z[inner], (cubic(x, y) + spread * laplacian)[inner], atol=1e-12)
    slope_x = 0.06 * x**2 - 0.05 * y**2 + 0.1 * y + 0.3 + spread * 0.02
    slope_y = -0.1 * x * y + 0.1 * x - 0.14 * y
    normal = np.stack([-slope_x, -slope_y, np.ones_like(x)], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    np.testing.assert_allclose(refined.normals.rows[: len(x)][inner], normal[inner], atol=1e-12)


def test_regular_quads_are_the_bicubic_b_spline():
    points, faces = grid(3, 3)
    points += np.random.default_rng(2).normal(0.0, 0.3, points.shape)
    refined = subdivide(net_of(faces, 16), 2, points)
    basis = np.array([[1, 4, 1, 0], [-3, 0, 3, 0], [3, -6, 3, 0], [-1, 3, -3, 1]]) / 6.0
    control = points.reshape(4, 4, 3)
    middle = np.flatnonzero(refined.control_face == 4)
    vertices = np.unique(refined.topology.corner_vertex.reshape(-1, 4)[middle])
    found = refined.vertex[vertices]
    for u, v in itertools.product(np.linspace(0, 1, 5), repeat=2):
        weights = np.power(u, range(4)) @ basis, np.power(v, range(4)) @ basis
        expected = np.einsum("j,i,jik->k", weights[1], weights[0], control)
        assert np.abs(found - expected).max(axis=1).min() < 1e-13
    assert len(found) == 25


@pytest.mark.parametrize("scheme", ["catmullClark", "loop", "bilinear"])
def test_subdivision_commutes_with_affine_maps_and_keeps_constants(scheme):
    points, faces = random_cage(3, scheme == "loop")
    crease = [[8, 9], [9, 15]]
    net = net_of(faces, len(points), scheme, crease, [1.5, 2.0])
    matrix = np.array([[1.0, 0.4, 0.0], [-0.3, 2.0, 0.1], [0.2, 0.0, 0.7]])
    plain = subdivide(net, 2, np.column_stack([points, np.full(len(points), 3.0)]))
    moved = subdivide(net, 2, points @ matrix.T + 5.0)
    np.testing.assert_allclose(moved.vertex, plain.vertex[:, :3] @ matrix.T + 5.0, atol=1e-12)
    np.testing.assert_allclose(plain.vertex[:, 3], 3.0, atol=1e-13)
    # Normals go with the inverse transpose.
    normals = plain.normals.rows[plain.normals.index] @ np.linalg.inv(matrix)
    normals *= np.sign(np.linalg.det(matrix)) / np.linalg.norm(normals, axis=1, keepdims=True)
    assert angle(normals, moved.normals.rows[moved.normals.index]).max() < 1e-5


@pytest.mark.parametrize("scheme", ["catmullClark", "loop", "bilinear"])
def test_plane_stays_plane(scheme):
    points, faces = grid(4, 3, scheme == "loop")
    refined = subdivide(net_of(faces, len(points), scheme), 2, points)
    np.testing.assert_allclose(refined.vertex[:, 2], 0.0, atol=1e-15)
    normals = refined.normals.rows[refined.normals.index]
    np.testing.assert_allclose(normals, np.broadcast_to([0, 0, 1], normals.shape), atol=1e-14)


def test_fully_creased_cube_stays_a_cube_with_flat_sides():
    edges = np.unique(
        np.sort([(f[i], f[i - 1]) for f in CUBE_FACES for i in range(4)], axis=1), axis=0
    )
    refined = subdivide(net_of(CUBE_FACES, 8, "catmullClark", edges, [10.0] * 12), 3, CUBE_POINTS)
    corners = refined.vertex[refined.topology.corner_vertex].reshape(-1, 4, 3)
    normals = refined.normals.rows[refined.normals.index].reshape(-1, 4, 3)
    for face, own in enumerate(CUBE_FACES):
        outward = CUBE_POINTS[own].mean(axis=0)
        mine = refined.control_face == face
        np.testing.assert_allclose(corners[mine] @ outward, 1.0, atol=1e-14)
        np.testing.assert_allclose(normals[mine] @ outward, 1.0, atol=1e-14)
    np.testing.assert_allclose(refined.vertex[:8], CUBE_POINTS)


def test_creased_square_keeps_its_edge_and_parts_the_normals():
    # A box lid: the rim of the top face is infinitely sharp, its curve the cubic B-spline.
    rim = [[1, 3], [3, 7], [7, 5], [5, 1]]
    refined = subdivide(net_of(CUBE_FACES, 8, "catmullClark", rim, [10.0] * 4), 3, CUBE_POINTS)
    np.testing.assert_allclose(refined.vertex[[1, 3, 5, 7], 2], 1.0)
    np.testing.assert_allclose(refined.vertex[7], (2 / 3 - 1 / 3 + 1 / 3, 2 / 3, 1.0), atol=1e-14)
    corners = np.flatnonzero(refined.topology.corner_vertex == 7)
    normals = refined.normals.rows[refined.normals.index[corners]]
    top = refined.control_face[refined.topology.corner_face[corners]] == 5
    np.testing.assert_allclose(normals[top], np.broadcast_to([0, 0, 1], (top.sum(), 3)), atol=1e-12)
    assert normals[~top][:, 2].max() < 0.5


def test_sharpness_changes_the_surface_without_a_jump():
    points, faces = random_cage(4)
    crease = [[8, 9], [9, 10], [10, 16]]

    def surface(sharpness):
        refined = subdivide(
            net_of(faces, len(points), "catmullClark", crease, [sharpness] * 3), 2, points
        )
        return refined.vertex, refined.normals.rows[refined.normals.index]

    for sharpness in (0.0, 1.0, 2.0, 3.0):
        before, after = surface(sharpness), surface(sharpness + 1e-6)
        np.testing.assert_allclose(after[0], before[0], atol=1e-5)
        np.testing.assert_allclose(after[1], before[1], atol=1e-4)


# Means and mean squares of the corners' values at level 2, by OpenSubdiv 3.5.0's
# Far::PrimvarRefinerReal<double> for the mesh of _opensubdiv_case.
OPENSUBDIV_POINTS = {
    ("catmullClark", "edgeOnly", False): [1.5, 1.5, 1.828952, 2.998362, 2.998362, 3.734237],
    ("catmullClark", "edgeOnly", True): [1.49566, 1.49566, 1.87251, 2.981373, 2.981373, 3.939913],
    ("catmullClark", "edgeAndCorner", True): [
        1.49566, 1.49566, 1.882886, 2.993427, 2.993427, 4.015954,
    ],
    ("loop", "edgeOnly", False): [1.5, 1.5, 1.780943, 2.998265, 2.998265, 3.675981],
    ("loop", "edgeOnly", True): [1.49566, 1.49566, 1.821798, 2.981313, 2.981313, 3.864379],
    ("loop", "edgeAndCorner", True): [1.49566, 1.49566, 1.825126, 2.985753, 2.985753, 3.88662],
}  # fmt: skip
OPENSUBDIV_FACE_VARYING = {
    ("catmullClark", "none"): [3.107397, 1.908477, 4.955222, 10.356191, 4.429169, 26.292726],
    ("catmullClark", "cornersOnly"): [3.090712, 1.916775, 4.970299, 10.333235, 4.472844, 26.79233],
    ("catmullClark", "cornersPlus1"): [3.075521, 1.916016, 4.968628, 10.243574, 4.472678, 26.7815],
    ("catmullClark", "cornersPlus2"): [
        3.120144, 1.900079, 5.038751, 10.650988, 4.442621, 27.699193,
    ],
    ("catmullClark", "boundaries"): [3.120144, 1.910929, 5.038751, 10.699483, 4.553385, 27.950577],
    ("catmullClark", "all"): [3.166667, 1.888889, 5.111111, 11.130859, 4.528212, 28.882595],
    ("loop", "none"): [3.034567, 1.892553, 4.792824, 10.013598, 4.561691, 24.547794],
    ("loop", "cornersOnly"): [3.039182, 1.894115, 4.811907, 10.047688, 4.564876, 24.821977],
    ("loop", "cornersPlus1"): [3.011882, 1.893862, 4.789406, 9.907821, 4.56865, 24.610888],
    ("loop", "cornersPlus2"): [3.014884, 1.901367, 4.79541, 9.948534, 4.617963, 24.832046],
    ("loop", "boundaries"): [3.033619, 1.890516, 4.857874, 10.374054, 4.708579, 26.127134],
    ("loop", "all"): [3.037037, 1.888889, 4.907407, 10.886574, 4.952546, 27.388889],
}  # fmt: skip


def _opensubdiv_case(scheme, boundary, creased):
    points, faces = grid(3, 3, scheme == "loop")
    x, y = points[:, 0], points[:, 1]
    points[:, 2] = (x * x + 2 * y * y + 3 * x * y) % 5
    crease, sharpness = [[5, 6], [6, 10], [9, 10]], [1.5, 2.5, 10.0]
    net = net_of(faces, 16, scheme, boundary=boundary)
    if creased:
        net = net_of(faces, 16, scheme, crease, sharpness, boundary=boundary)
        net = sharpen(net, NOTHING, np.empty(0), np.array([6]), np.array([1.3]))
    return net, points


@pytest.mark.parametrize("case", OPENSUBDIV_POINTS, ids=str)
def test_points_equal_those_of_opensubdiv(case):
    net, points = _opensubdiv_case(*case)
    fine, values = refined_values(net, points, 2)
    moments = mean_moments(values[fine.topology.corner_vertex])
    np.testing.assert_allclose(moments, OPENSUBDIV_POINTS[case], atol=6e-7)


@pytest.mark.parametrize("case", OPENSUBDIV_FACE_VARYING, ids=str)
def test_face_varying_rules_equal_those_of_opensubdiv(case):
    scheme, rule = case
    net, _ = _opensubdiv_case(scheme, "edgeAndCorner", True)
    islands = np.array([0, 0, 1, 0, 2, 1, 1, 1, 1])
    islands = np.repeat(islands, net.topology.face_count // 9)
    key = net.topology.corner_vertex * 4 + islands[net.topology.corner_face]
    names, indices = np.unique(key, return_inverse=True)
    values = np.stack([names % 7, names % 5, names % 11], axis=1).astype(float)
    channel = face_varying_channel(net, values, indices, rule)
    if channel.net is None:
        assert rule == "all"
        refined = subdivide(net, 2, np.zeros((16, 3)), face_varying=[channel]).face_varying[0]
        corners = refined.rows[refined.index]
    else:
        fine, rows = refined_values(channel.net, channel.values, 2)
        corners = rows[fine.topology.corner_vertex]
    np.testing.assert_allclose(mean_moments(corners), OPENSUBDIV_FACE_VARYING[case], atol=6e-7)


def test_smooth_triangle_rule_equals_that_of_opensubdiv():
    _, points = _opensubdiv_case("catmullClark", "edgeAndCorner", False)
    _, faces = grid(3, 3, triangles=True)
    net = net_of(faces, 16, smooth_triangles=True)
    fine, values = refined_values(net, points, 2)
    expected = [1.5, 1.5, 1.785204, 2.990734, 2.990734, 3.701665]
    moments = mean_moments(values[fine.topology.corner_vertex])
    np.testing.assert_allclose(moments, expected, atol=6e-7)


@pytest.mark.parametrize("rule", ["cornersPlus1", "cornersOnly", "boundaries", "all"])
def test_face_varying_seam_stays_a_seam(rule):
    points, faces = grid(4, 3)
    net = net_of(faces, len(points))
    # Each half of the grid has its own chart, 10 apart.
    right = (np.arange(len(faces)) % 4 >= 2)[net.topology.corner_face]
    names, indices = np.unique(net.topology.corner_vertex * 2 + right, return_inverse=True)
    values = points[names // 2, :2] + np.stack([10.0 * (names % 2), 0.0 * names], axis=1)
    channel = face_varying_channel(net, values, indices, rule)
    refined = subdivide(net, 2, points, face_varying=[channel])
    st = refined.face_varying[0].rows[refined.face_varying[0].index]
    face = refined.control_face[refined.topology.corner_face]
    offset = np.where(face % 4 >= 2, 10.0, 0.0)
    assert ((st[:, 0] - offset > -0.01) & (st[:, 0] - offset < 4.01)).all()
    on_seam = np.abs(refined.vertex[refined.topology.corner_vertex, 0] - 2.0) < 1e-9
    np.testing.assert_allclose((st[:, 0] - offset)[on_seam], 2.0, atol=1e-12)


def test_channel_without_seams_follows_the_vertices():
    points, faces = random_cage(5)
    net = net_of(faces, len(points), boundary="edgeOnly")
    channel = face_varying_channel(net, points[:, :2], net.topology.corner_vertex, "none")
    refined = subdivide(net, 2, points, face_varying=[channel])
    st = refined.face_varying[0].rows[refined.face_varying[0].index]
    np.testing.assert_allclose(st, refined.vertex[refined.topology.corner_vertex, :2], atol=1e-13)


def test_euler_characteristic_and_closure_are_kept():
    for faces, refiner in ((CUBE_FACES, refine_to_quads), (_octahedron(), refine_to_triangles)):
        counts = np.array([len(face) for face in faces])
        mesh = build_topology(counts, np.concatenate(faces), int(np.max(faces)) + 1)
        for _ in range(3):
            mesh = refiner(mesh)
            assert mesh.vertex_count - mesh.edge_count + mesh.face_count == 2
            assert (mesh.twin >= 0).all()


def _octahedron():
    ring = [1, 2, 3, 4]
    return [[0, ring[i - 1], ring[i]] for i in range(4)] + [
        [5, ring[i], ring[i - 1]] for i in range(4)
    ]


@pytest.mark.parametrize("quads", [True, False])
def test_refined_connectivity_is_what_its_faces_say(quads):
    faces = CUBE_FACES[:5] if quads else _octahedron()[:7]
    if quads:
        faces = [*faces[:4], [0, 2, 6], [0, 6, 4]]
    counts = np.array([len(face) for face in faces])
    mesh = build_topology(counts, np.concatenate(faces), 8)
    for _ in range(2):
        mesh = refine_to_quads(mesh) if quads else refine_to_triangles(mesh)
        again = build_topology(mesh.face_sizes, mesh.corner_vertex, mesh.vertex_count)
        np.testing.assert_array_equal(mesh.twin, again.twin)
        np.testing.assert_array_equal(mesh.forward, again.forward)
        np.testing.assert_array_equal(mesh.edge_vertex[mesh.edge], again.edge_vertex[again.edge])


def test_edge_and_corner_keeps_the_corners_of_a_sheet_and_edge_only_rounds_them():
    points, faces = grid(3, 3)
    sharp = subdivide(net_of(faces, 16), 2, points).vertex[0]
    round_ = subdivide(net_of(faces, 16, boundary="edgeOnly"), 2, points).vertex[0]
    np.testing.assert_allclose(sharp, 0.0)
    np.testing.assert_allclose(round_[:2], 1.0 / 6.0)


def test_boundary_none_leaves_out_the_faces_at_the_boundary():
    points, faces = grid(4, 4)
    left_out = boundary_faces(net_of(faces, len(points), boundary="none"))
    inner = np.zeros((4, 4), dtype=bool)
    inner[1:3, 1:3] = True
    np.testing.assert_array_equal(left_out, ~inner.ravel())


def test_n_gon_becomes_n_quads_and_has_one_normal_at_level_0():
    turn = 2.0 * np.pi * np.arange(5) / 5
    points = np.stack([np.cos(turn), np.sin(turn), 0.0 * turn], axis=1)
    net = net_of([np.arange(5)], 5)
    refined = subdivide(net, 1, points)
    assert refined.topology.face_count == 5
    assert (refined.control_face == 0).all()
    normals = cage_normals(net, points)
    np.testing.assert_allclose(normals.rows[normals.index], np.tile([0, 0, 1], (5, 1)), atol=1e-15)


@pytest.mark.parametrize(
    ("scheme", "size"),
    [("catmullClark", 2), ("catmullClark", 3), ("loop", 2), ("loop", 3), ("loop", 4), ("loop", 5)],
)
def test_normals_on_irregular_boundaries_are_those_of_the_limit(scheme, size):
    # Truth: the flat normal of ever smaller faces around the vertex, seven levels down.
    rng = np.random.default_rng(size)
    turn = np.linspace(0.0, 1.2 * np.pi, 2 * size + 1)
    reach = 1.0 + 0.4 * (np.arange(2 * size + 1) % 2)
    ring = np.stack([reach * np.cos(turn), reach * np.sin(turn), 0.0 * turn], axis=1)
    points = np.concatenate([np.zeros((1, 3)), ring]) + rng.normal(0, 0.1, (2 * size + 2, 3))
    if scheme == "loop":
        points = points[[0, *range(1, 2 * size + 2, 2)]]
        faces = [[0, 1 + i, 2 + i] for i in range(size)]
    else:
        faces = [[0, 1 + 2 * i, 2 + 2 * i, 3 + 2 * i] for i in range(size)]
    net = net_of(faces, len(points), scheme, boundary="edgeOnly")
    _, normals = limit_surface(net, points)
    fine, values = refined_values(net, points, 7)
    limit, _ = limit_surface(fine, values)
    mesh = fine.topology
    around = np.flatnonzero(mesh.corner_vertex == 0)
    own = limit[0]
    ahead = limit[mesh.corner_vertex[mesh.corner_next[around]]] - own
    behind = limit[mesh.corner_vertex[mesh.corner_previous[around]]] - own
    flat = np.cross(ahead, behind)
    flat = (flat / np.linalg.norm(flat, axis=1, keepdims=True)).mean(axis=0)
    found = normals.rows[normals.index[np.flatnonzero(net.topology.corner_vertex == 0)[0]]]
    assert angle(found[None], flat[None] / np.linalg.norm(flat))[0] < 1.0


def test_bilinear_normals_are_those_of_each_patch():
    points = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 1], [0, 1, 0]])
    refined = subdivide(net_of([[0, 1, 2, 3]], 4, "bilinear"), 2, points)
    corners = refined.vertex[refined.topology.corner_vertex]
    x, y, z = corners.T
    np.testing.assert_allclose(z, x * y, atol=1e-15)
    exact = np.stack([-y, -x, np.ones_like(x)], axis=1)
    exact /= np.linalg.norm(exact, axis=1, keepdims=True)
    np.testing.assert_allclose(refined.normals.rows[refined.normals.index], exact, atol=1e-14)


@pytest.mark.parametrize("level", [0, 1, 2])
def test_non_manifold_and_degenerate_meshes_give_finite_units(level):
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [-1, 0, 1]])
    points = np.concatenate([points, [[0.5, 0, 0], [9, 9, 9]]])
    # Three faces along edge 0 1, two fans at vertex 0, and a face without an area.
    faces = [[0, 1, 2], [1, 0, 3], [0, 1, 4], [0, 4, 5], [0, 6, 1]]
    net = net_of(faces, len(points))
    if level == 0:
        normals = cage_normals(net, points)
    else:
        refined = subdivide(net, level, points)
        normals = refined.normals
        assert np.isfinite(refined.vertex).all()
        np.testing.assert_array_equal(refined.vertex[7], points[7])
    np.testing.assert_allclose(np.linalg.norm(normals.rows[normals.index], axis=1), 1.0)


def test_closed_mesh_is_recognised_across_split_seams_only_when_wound_alike():
    counts, faces = np.full(6, 4), np.concatenate(CUBE_FACES)
    assert is_closed(counts, faces, CUBE_POINTS)
    split = np.arange(24)
    assert is_closed(counts, split, CUBE_POINTS[faces])
    assert not is_closed(counts[:5], faces[:20], CUBE_POINTS)
    turned = faces.copy()
    turned[:4] = turned[:4][::-1]
    assert not is_closed(counts, turned, CUBE_POINTS)
