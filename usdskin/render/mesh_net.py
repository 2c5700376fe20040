"""Control nets: a mesh's connectivity with the sharpness of its edges and vertices.

The rules are those of OpenSubdiv, which USD's Mesh schema refers to: semi-sharp creases and corners
that lose 1 of their sharpness at every level (DeRose, Kass and Truong 1998, "Subdivision surfaces
in character animation"), boundaries and non-manifold edges as infinitely sharp creases.

Pure NumPy: no USD here.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.render.mesh_topology import (
    BoolArray,
    FloatArray,
    IndexArray,
    Topology,
    build_topology,
)

Scheme = Literal["catmullClark", "loop", "bilinear"]
Boundary = Literal["none", "edgeOnly", "edgeAndCorner"]

SHARPNESS_INFINITE = 10.0
"""Sharpness that never decays (``UsdGeomMesh`` and OpenSubdiv)."""


@dataclass(frozen=True, slots=True, eq=False)
class Net:
    """A control mesh with the rules it is refined by."""

    topology: Topology
    """Faces and edges."""

    scheme: Scheme
    """How faces split and values blend."""

    edge_sharpness: FloatArray
    """Sharpness of every edge, infinite on boundaries, shape [edge_count]."""

    vertex_sharpness: FloatArray
    """Sharpness of every vertex, infinite at kept corners, shape [vertex_count]."""

    smooth_triangles: bool = False
    """Whether edge points beside triangles follow the ``smooth`` triangle rule (level 0 only)."""


@dataclass(frozen=True, slots=True, eq=False)
class VertexRules:
    """Shares of the smooth, crease and corner rules at the vertices where one is sharp.

    The shares of a vertex sum to 1. A crease share uses the neighbors along the vertex's two sharp
    edges: those sharp now, or those still sharp at the next level.
    """

    valence: IndexArray
    """Faces around each vertex, shape [vertex_count]."""

    special: IndexArray
    """Vertices that are not plainly smooth, shape [special_count]."""

    smooth: FloatArray
    """Share of the smooth rule, shape [special_count]."""

    crease: FloatArray
    """Share of the crease rule along the edges that are sharp now, shape [special_count]."""

    crease_next: FloatArray
    """Share of the crease rule along the edges sharp at the next level, shape [special_count]."""

    corner: FloatArray
    """Share of the corner rule, shape [special_count]."""

    sharp_ends: IndexArray
    """Vertices of the edges that are sharp now, shape [sharp_count, 2]."""

    stays_sharp: BoolArray
    """Which of those are sharp at the next level, shape [sharp_count]."""


def control_net(
    face_counts: NDArray[np.integer],
    face_vertices: NDArray[np.integer],
    vertex_count: int,
    scheme: Scheme = "catmullClark",
    boundary: Boundary = "edgeAndCorner",
    smooth_triangles: bool = False,
) -> Net:
    """Connect a control mesh, with sharp boundaries and no other crease.

    ``none`` as the boundary rule sharpens like ``edgeOnly``: the faces it removes are those of
    :func:`boundary_faces`, and what remains does not depend on the boundary.

    Args:
        face_counts: Corners per face (all 3 for ``loop``), shape [face_count].
        face_vertices: Vertex of each corner, shape [sum of face_counts].
        vertex_count: Number of vertices.
        scheme: Subdivision scheme.
        boundary: ``edgeAndCorner`` also keeps the vertices that belong to one face only.
        smooth_triangles: The ``smooth`` triangle rule of Catmull-Clark.

    Raises:
        ValueError: Loop was asked for on faces that are not triangles.
    """
    topology = build_topology(face_counts, face_vertices, vertex_count)
    if scheme == "loop" and (topology.face_sizes != 3).any():
        raise ValueError("Loop subdivision needs triangles")
    open_edge = np.zeros(topology.edge_count, dtype=np.bool_)
    open_edge[topology.edge[topology.twin < 0]] = True
    edge_sharpness = np.where(open_edge, SHARPNESS_INFINITE, 0.0)
    vertex_sharpness = np.where(_non_manifold_vertices(topology), SHARPNESS_INFINITE, 0.0)
    if boundary == "edgeAndCorner":
        valence = np.bincount(topology.corner_vertex, minlength=vertex_count)
        on_boundary = np.zeros(vertex_count, dtype=np.bool_)
        on_boundary[topology.edge_vertex[open_edge]] = True
        vertex_sharpness[(valence == 1) & on_boundary] = SHARPNESS_INFINITE
    return Net(topology, scheme, edge_sharpness, vertex_sharpness, smooth_triangles)


def _non_manifold_vertices(mesh: Topology) -> BoolArray:
    """Return the vertices where several fans of faces touch, or an edge is not manifold."""
    bad = np.zeros(mesh.vertex_count, dtype=np.bool_)
    uses = np.bincount(mesh.edge, minlength=mesh.edge_count)
    open_use = np.bincount(mesh.edge[mesh.twin < 0], minlength=mesh.edge_count)
    bad[mesh.edge_vertex[(uses > 1) & (open_use > 0)]] = True
    # Every open fan has one corner with no face before it; of a closed one, the smallest corner
    # is found by pointer doubling around the fan.
    corner = np.arange(mesh.corner_count)
    jump = np.where(mesh.twin < 0, corner, mesh.corner_next[mesh.twin])
    label = corner
    longest = int(np.bincount(mesh.corner_vertex, minlength=1).max(initial=1))
    for _ in range(max(longest - 1, 1).bit_length()):
        label = np.minimum(label, label[jump])
        jump = jump[jump]
    is_head = np.where(mesh.twin[jump] < 0, mesh.twin < 0, label == corner)
    fans = np.bincount(mesh.corner_vertex[is_head], minlength=mesh.vertex_count)
    return bad | (fans > 1)


def boundary_faces(net: Net) -> BoolArray:
    """Return the faces that ``interpolateBoundary`` none leaves out, shape [face_count].

    They are the faces at a vertex of an open edge.
    """
    mesh = net.topology
    at_boundary = np.zeros(mesh.vertex_count, dtype=np.bool_)
    at_boundary[mesh.edge_vertex[mesh.edge[mesh.twin < 0]]] = True
    left_out = np.zeros(mesh.face_count, dtype=np.bool_)
    left_out[mesh.corner_face[at_boundary[mesh.corner_vertex]]] = True
    return left_out


def sharpen(
    net: Net,
    edges: IndexArray,
    edge_sharpness: FloatArray,
    vertices: IndexArray,
    vertex_sharpness: FloatArray,
) -> Net:
    """Return the net with creases and corners; the sharper opinion holds where two meet.

    Args:
        net: Net to sharpen.
        edges: Edges of the net, shape [m].
        edge_sharpness: Their sharpness, at least 0, shape [m].
        vertices: Vertices of the net, shape [n].
        vertex_sharpness: Their sharpness, at least 0, shape [n].
    """
    edge = net.edge_sharpness.copy()
    vertex = net.vertex_sharpness.copy()
    np.maximum.at(edge, edges, edge_sharpness)
    np.maximum.at(vertex, vertices, vertex_sharpness)
    return replace(net, edge_sharpness=edge, vertex_sharpness=vertex)


def find_edges(mesh: Topology, first: IndexArray, second: IndexArray) -> IndexArray:
    """Return the edge between each pair of vertices, -1 where there is none, shape [m]."""
    if mesh.edge_count == 0:
        return np.full(len(first), -1, dtype=np.intp)
    size = np.intp(max(mesh.vertex_count, 1))
    key = mesh.edge_vertex[:, 0] * size + mesh.edge_vertex[:, 1]
    order = np.argsort(key)
    wanted = np.minimum(first, second) * size + np.maximum(first, second)
    place = np.minimum(np.searchsorted(key, wanted, sorter=order), len(key) - 1)
    edge = order[place]
    return np.where(key[edge] == wanted, edge, -1)


def decay(sharpness: FloatArray) -> FloatArray:
    """Return the sharpness one level down: 1 less, infinite stays (uniform creasing)."""
    return np.where(sharpness >= SHARPNESS_INFINITE, sharpness, np.maximum(sharpness - 1.0, 0.0))


def vertex_rules(net: Net) -> VertexRules:
    """Weigh the rules at every vertex, with the blend of a sharpness that decays to 0.

    A vertex is a corner when it or more than two of its edges are sharp, on a crease when two
    are, smooth otherwise; where the rule changes at the next level, the two blend by the mean of
    the sharpnesses that vanish (OpenSubdiv, "Semi-Sharp Creases").
    """
    mesh = net.topology
    count = mesh.vertex_count
    valence = np.bincount(mesh.corner_vertex, minlength=count)
    sharp = np.flatnonzero(net.edge_sharpness > 0.0)
    ends = mesh.edge_vertex[sharp]
    value = net.edge_sharpness[sharp]
    stays = decay(value) > 0.0
    now = np.bincount(ends.reshape(-1), minlength=count)
    special = np.flatnonzero((now >= 2) | (net.vertex_sharpness > 0.0) | (valence == 0))
    later = np.bincount(ends[stays].reshape(-1), minlength=count)[special]
    now = now[special]
    own = net.vertex_sharpness[special]
    own_later = decay(own)
    corner_now = (own > 0.0) | (now > 2) | (valence[special] == 0)
    corner_later = (own_later > 0.0) | (later > 2) | (valence[special] == 0)
    crease_now = ~corner_now & (now == 2)
    crease_later = ~corner_later & (later == 2)
    vanishing = ends[~stays].reshape(-1)
    total = np.bincount(vanishing, np.repeat(value[~stays], 2), count)[special]
    terms = np.bincount(vanishing, minlength=count)[special]
    own_vanishes = (own > 0.0) & (own_later <= 0.0)
    total = total + np.where(own_vanishes, own, 0.0)
    terms = terms + own_vanishes
    share = np.where(terms > 0, np.minimum(total / np.maximum(terms, 1), 1.0), 0.0)
    same = (corner_now & corner_later) | (crease_now & crease_later)
    share = np.where(same, 1.0, share)
    smooth_later = ~corner_later & ~crease_later
    return VertexRules(
        valence=valence,
        special=special,
        smooth=(1.0 - share) * smooth_later,
        crease=share * crease_now,
        crease_next=(1.0 - share) * crease_later,
        corner=share * corner_now + (1.0 - share) * corner_later,
        sharp_ends=ends,
        stays_sharp=stays,
    )


def crease_sums(rules: VertexRules, values: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Sum the values across the sharp edges of the special vertices.

    Args:
        rules: Rules of the net.
        values: One row per vertex, shape [vertex_count, k].

    Returns:
        The sums over the edges sharp now and over those sharp at the next level, both of shape
        [special_count, k].
    """
    count = len(rules.valence)
    ends, kept = rules.sharp_ends, rules.sharp_ends[rules.stays_sharp]
    now = sum_rows(ends.reshape(-1), values[ends[:, ::-1].reshape(-1)], count)[rules.special]
    if len(kept) == len(ends):
        return now, now
    later = sum_rows(kept.reshape(-1), values[kept[:, ::-1].reshape(-1)], count)[rules.special]
    return now, later


def sum_rows(index: IndexArray, rows: FloatArray, count: int) -> FloatArray:
    """Return, for each of ``count`` bins, the sum of the rows that name it, shape [count, k]."""
    total = np.empty((count, rows.shape[1]))
    for column in range(rows.shape[1]):
        total[:, column] = np.bincount(index, rows[:, column], count)
    return total


def loop_weights(valence: NDArray[np.integer]) -> FloatArray:
    """Return the weight of each neighbor in Loop's smooth vertex rule."""
    beta = 0.375 + 0.25 * np.cos(2.0 * np.pi / valence)
    weights: FloatArray = (0.625 - beta * beta) / valence
    return weights
