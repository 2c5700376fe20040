"""Half-edge connectivity of polygon meshes and of their uniform refinements.

Corner ``c`` is one face-vertex; half-edge ``c`` runs from corner ``c`` to the next corner of its
face. Data of any kind that lives on corners (face-varying values, materials of faces) follows the
corner numbering, which depends on the faces alone: the refinement of a face-varying channel, which
has vertices of its own, therefore numbers its corners as the refinement of the mesh does.

Pure NumPy: no USD here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

IndexArray = NDArray[np.intp]
FloatArray = NDArray[np.float64]
BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class CornerRows:
    """Values on corners, many of which share one."""

    rows: FloatArray
    """Distinct values, shape [row_count, k]."""

    index: IndexArray
    """Row of each corner, shape [corner_count]."""

    def at(self, corners: IndexArray) -> NDArray[np.float32]:
        """Return the values of some corners, shape [*corners.shape, k]."""
        return self.rows.astype(np.float32)[self.index[corners]]


@dataclass(frozen=True, slots=True, eq=False)
class Topology:
    """Faces, and how they meet along edges."""

    vertex_count: int
    """Number of vertices, used by a face or not."""

    face_start: IndexArray
    """First corner of each face, and the number of corners at the end, shape [face_count + 1]."""

    corner_vertex: IndexArray
    """Vertex of each corner, shape [corner_count]."""

    corner_face: IndexArray
    """Face of each corner, shape [corner_count]."""

    corner_next: IndexArray
    """Next corner of the same face, shape [corner_count]."""

    corner_previous: IndexArray
    """Previous corner of the same face, shape [corner_count]."""

    twin: IndexArray
    """Half-edge of the neighboring face along the same edge, running the other way; -1 on a
    boundary and where the mesh is not an oriented manifold, shape [corner_count]."""

    edge: IndexArray
    """Edge of each half-edge, shape [corner_count]."""

    forward: BoolArray
    """Whether the half-edge starts at the edge's first vertex, shape [corner_count]."""

    edge_vertex: IndexArray
    """The two vertices of each edge, the smaller index first, shape [edge_count, 2]."""

    @property
    def face_count(self) -> int:
        """Number of faces."""
        return len(self.face_start) - 1

    @property
    def corner_count(self) -> int:
        """Number of corners, which is the number of half-edges."""
        return len(self.corner_vertex)

    @property
    def edge_count(self) -> int:
        """Number of edges."""
        return len(self.edge_vertex)

    @property
    def face_sizes(self) -> IndexArray:
        """Number of corners of each face, shape [face_count]."""
        return np.diff(self.face_start)


def build_topology(
    face_counts: NDArray[np.integer], face_vertices: NDArray[np.integer], vertex_count: int
) -> Topology:
    """Connect polygons that name their vertices.

    Args:
        face_counts: Corners per face, each at least 3, shape [face_count].
        face_vertices: Vertex of each corner, within ``vertex_count`` and never the same twice in
            succession around a face, shape [sum of face_counts].
        vertex_count: Number of vertices.

    Returns:
        The connectivity. An edge of more than two half-edges, or of two that run the same way, is
        an edge without twins, as a boundary is.
    """
    corner_vertex = np.asarray(face_vertices, dtype=np.intp)
    start, face, following, previous = corner_links(np.asarray(face_counts, dtype=np.intp))
    end_vertex = corner_vertex[following]
    low = np.minimum(corner_vertex, end_vertex)
    high = np.maximum(corner_vertex, end_vertex)
    key = low * np.intp(max(vertex_count, 1)) + high
    order = np.argsort(key)
    key = key[order]
    is_first = np.empty(len(key), dtype=np.bool_)
    is_first[:1] = True
    np.not_equal(key[1:], key[:-1], out=is_first[1:])
    first = np.flatnonzero(is_first)
    edge = np.empty(len(key), dtype=np.intp)
    edge[order] = np.cumsum(is_first) - 1
    forward = corner_vertex == low
    uses = np.diff(np.append(first, len(key)))
    pair = first[uses == 2]
    one, other = order[pair], order[pair + 1]
    opposed = forward[one] != forward[other]
    one, other = one[opposed], other[opposed]
    twin = np.full(len(key), -1, dtype=np.intp)
    twin[one] = other
    twin[other] = one
    edge_vertex = np.stack([low[order[first]], high[order[first]]], axis=1)
    return Topology(
        vertex_count, start, corner_vertex, face, following, previous, twin, edge, forward,
        edge_vertex,
    )  # fmt: skip


def corner_links(
    face_counts: IndexArray,
) -> tuple[IndexArray, IndexArray, IndexArray, IndexArray]:
    """Return each face's first corner (with the end) and each corner's face, next and previous."""
    start = np.zeros(len(face_counts) + 1, dtype=np.intp)
    np.cumsum(face_counts, out=start[1:])
    corner_count = int(start[-1])
    face = np.repeat(np.arange(len(face_counts), dtype=np.intp), face_counts)
    following = np.arange(1, corner_count + 1, dtype=np.intp)
    following[start[1:] - 1] = start[:-1]
    previous = np.arange(-1, corner_count - 1, dtype=np.intp)
    previous[start[:-1]] = start[1:] - 1
    return start, face, following, previous


def refine_to_quads(mesh: Topology) -> Topology:
    """Split every n-gon into n quads around its center (Catmull and Clark 1978).

    Corner ``c`` becomes face ``c``, whose corners ``4 c ..`` are the vertex of ``c``, the point of
    edge ``c``, the point of the face and the point of the edge before. Vertices keep their number;
    edge points follow, then face points. The halves of edge ``e`` are the edges ``2 e`` (at its
    first vertex) and ``2 e + 1``; the edge from the point of half-edge ``c`` into its face
    follows.
    """
    corners, edges = mesh.corner_count, mesh.edge_count
    edge_point = mesh.vertex_count + mesh.edge
    face_point = mesh.vertex_count + edges + mesh.corner_face
    previous, twin = mesh.corner_previous, mesh.twin
    vertex = np.empty((corners, 4), dtype=np.intp)
    vertex[:, 0] = mesh.corner_vertex
    vertex[:, 1] = edge_point
    vertex[:, 2] = face_point
    vertex[:, 3] = edge_point[previous]
    start_edge, end_edge = _half_edges(mesh)
    edge = np.empty((corners, 4), dtype=np.intp)
    edge[:, 0] = start_edge
    edge[:, 1] = 2 * edges + np.arange(corners)
    edge[:, 2] = 2 * edges + previous
    edge[:, 3] = end_edge[previous]
    child_twin = np.empty((corners, 4), dtype=np.intp)
    child_twin[:, 0] = np.where(twin < 0, -1, 4 * mesh.corner_next[twin] + 3)
    child_twin[:, 1] = 4 * mesh.corner_next + 2
    child_twin[:, 2] = 4 * previous + 1
    child_twin[:, 3] = np.where(twin[previous] < 0, -1, 4 * twin[previous])
    edge_vertex = np.empty((2 * edges + corners, 2), dtype=np.intp)
    _split_edges(mesh, edge_vertex)
    edge_vertex[2 * edges :, 0] = edge_point
    edge_vertex[2 * edges :, 1] = face_point
    vertex_count = mesh.vertex_count + edges + mesh.face_count
    forward = np.tile(np.array([True, True, False, False]), corners)
    return _regular_topology(vertex_count, vertex, child_twin, edge, forward, edge_vertex)


def refine_to_triangles(mesh: Topology) -> Topology:
    """Split every triangle into four (Loop 1987).

    Triangle ``f`` becomes the faces ``4 f ..``: one at each of its corners (the vertex, the point
    of its edge, the point of the edge before) and the middle one (the three edge points in order).
    Vertices keep their number; edge points follow. The halves of the edges come first, as in
    :func:`refine_to_quads`; the edge that cuts off corner ``c`` follows.
    """
    corners, edges = mesh.corner_count, mesh.edge_count
    edge_point = mesh.vertex_count + mesh.edge
    previous, following, twin = mesh.corner_previous, mesh.corner_next, mesh.twin
    tip = 12 * (np.arange(corners) // 3) + 3 * (np.arange(corners) % 3)
    middle = 12 * (np.arange(corners) // 3) + 9 + np.arange(corners) % 3
    start_edge, end_edge = _half_edges(mesh)
    cut_edge = 2 * edges + np.arange(corners)
    vertex = np.empty(4 * corners, dtype=np.intp)
    edge = np.empty(4 * corners, dtype=np.intp)
    child_twin = np.empty(4 * corners, dtype=np.intp)
    vertex[tip], vertex[tip + 1], vertex[tip + 2] = (
        mesh.corner_vertex,
        edge_point,
        edge_point[previous],
    )
    vertex[middle] = edge_point
    edge[tip], edge[tip + 1], edge[tip + 2] = start_edge, cut_edge, end_edge[previous]
    edge[middle] = cut_edge[following]
    child_twin[tip] = np.where(twin < 0, -1, tip[following[twin]] + 2)
    child_twin[tip + 1] = middle[previous]
    child_twin[tip + 2] = np.where(twin[previous] < 0, -1, tip[twin[previous]])
    child_twin[middle] = tip[following] + 1
    edge_vertex = np.empty((2 * edges + corners, 2), dtype=np.intp)
    _split_edges(mesh, edge_vertex)
    cut = np.sort(np.stack([edge_point, edge_point[previous]], axis=1), axis=1)
    edge_vertex[2 * edges :] = cut
    shape = (mesh.face_count * 4, 3)
    vertex = vertex.reshape(shape)
    forward = vertex < np.roll(vertex, -1, axis=1)
    return _regular_topology(
        mesh.vertex_count + edges, vertex, child_twin, edge, forward, edge_vertex
    )


def _half_edges(mesh: Topology) -> tuple[IndexArray, IndexArray]:
    """Return the child edge at the start and at the end of every half-edge."""
    start = 2 * mesh.edge + ~mesh.forward
    return start, start ^ 1


def _split_edges(mesh: Topology, edge_vertex: IndexArray) -> None:
    """Write the vertices of the halves of every edge."""
    edges = mesh.edge_count
    edge_vertex[: 2 * edges, 0] = mesh.edge_vertex.reshape(-1)
    edge_vertex[: 2 * edges, 1] = np.repeat(mesh.vertex_count + np.arange(edges), 2)


def _regular_topology(
    vertex_count: int,
    vertex: IndexArray,
    twin: IndexArray,
    edge: IndexArray,
    forward: BoolArray,
    edge_vertex: IndexArray,
) -> Topology:
    """Assemble a topology whose faces all have ``vertex.shape[1]`` corners."""
    faces, size = vertex.shape
    corner = np.arange(faces * size, dtype=np.intp).reshape(faces, size)
    return Topology(
        vertex_count,
        np.arange(faces + 1, dtype=np.intp) * size,
        vertex.reshape(-1),
        np.repeat(np.arange(faces, dtype=np.intp), size),
        np.roll(corner, -1, axis=1).reshape(-1),
        np.roll(corner, 1, axis=1).reshape(-1),
        twin.reshape(-1),
        edge.reshape(-1),
        forward.reshape(-1),
        edge_vertex,
    )
