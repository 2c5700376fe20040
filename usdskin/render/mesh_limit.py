"""Limit positions and normals of subdivision surfaces, by stencils on the control net.

Smooth vertices: the limit stencils of Halstead, Kass and DeRose 1993, "Efficient, fair
interpolation using Catmull-Clark surfaces" (quads), and of Loop 1987 (triangles). Boundaries and
creases: the cubic B-spline curve, and tangents by the eigenvectors of the crease rules. A vertex on
a sharp edge has one normal on each side of it.

Two things are not exact. At the end of a crease inside the surface (a dart) the smooth stencil
stands in, as in OpenSubdiv. Sharpness that is left over at the last level counts by its share
between 0 and 1, so that the surface does not jump as it is animated.

Pure NumPy: no USD here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from usdskin.render.mesh_net import (
    Net,
    VertexRules,
    crease_sums,
    loop_weights,
    sum_rows,
    vertex_rules,
)
from usdskin.render.mesh_topology import (
    BoolArray,
    CornerRows,
    FloatArray,
    IndexArray,
    Topology,
)
from usdskin.render.polygons import area_vectors, cross


@dataclass(frozen=True, slots=True, eq=False)
class Sectors:
    """Runs of faces around vertices, from one sharp edge to the next, counter-clockwise."""

    corner: IndexArray
    """Corners of all sectors, shape [n]."""

    sector: IndexArray
    """Sector of each of those corners, shape [n]."""

    rank: IndexArray
    """Place of each of those corners in its sector, shape [n]."""

    size: IndexArray
    """Corners of each sector, shape [sector_count]."""

    vertex: IndexArray
    """Vertex of each sector, shape [sector_count]."""

    closed: BoolArray
    """Whether the sector goes all the way around, shape [sector_count]."""


def limit_values(net: Net, values: FloatArray) -> FloatArray:
    """Return the values that the vertices tend to under endless refinement.

    Args:
        net: Net whose faces are all quads (Catmull-Clark) or triangles (Loop).
        values: One row per vertex, shape [vertex_count, k].

    Returns:
        Limit values, shape [vertex_count, k].
    """
    return _limit(net, values, vertex_rules(net), None)


def limit_surface(net: Net, values: FloatArray) -> tuple[FloatArray, CornerRows]:
    """Return the limit values and the unit normals of the limit surface.

    Args:
        net: Net whose faces are all quads (Catmull-Clark, bilinear) or triangles (Loop).
        values: One row per vertex, whose first three columns are the position, shape
            [vertex_count, k].

    Returns:
        Limit values, shape [vertex_count, k], and the normals of the corners. Normals of a
        bilinear surface are those of each patch.
    """
    mesh = net.topology
    if net.scheme == "bilinear":
        return values, _patch_normals(mesh, values[:, :3])
    rules = vertex_rules(net)
    smooth_normal = np.zeros((mesh.vertex_count, 3))
    limit = _limit(net, values, rules, smooth_normal)
    points = values[:, :3]
    sectors = find_sectors(mesh, net.edge_sharpness > 0.0, rules.special)
    crosses = corner_crosses(mesh, points, sectors.corner)
    summed = sum_rows(sectors.sector, crosses, len(sectors.size))
    share = np.zeros(mesh.vertex_count)
    share[rules.special] = rules.crease
    share_of_sector = share[sectors.vertex]
    creased = (share_of_sector > 0.0) & ~sectors.closed & (sectors.size > 1)
    along = np.where(creased[:, None], _crease_normals(net, points, sectors), 0.0)
    along, summed = unit(along), unit(summed)
    mixed = share_of_sector[:, None] * along + (1.0 - share_of_sector[:, None]) * summed
    sector_normal = np.where(creased[:, None], mixed, summed)
    return limit, _assemble(net, rules, unit(smooth_normal), sectors, sector_normal, points)


def cage_normals(net: Net, points: FloatArray) -> CornerRows:
    """Return smooth normals of the control mesh itself, split along its sharp edges.

    The normals of the corners around a vertex are averaged by the angle of the corner.

    Args:
        net: Net of any faces.
        points: Positions, shape [vertex_count, 3].
    """
    mesh = net.topology
    if net.scheme == "bilinear":
        return _patch_normals(mesh, points)
    rules = vertex_rules(net)
    own = points[mesh.corner_vertex]
    ahead = own[mesh.corner_next] - own
    behind = own[mesh.corner_previous] - own
    normal = cross(ahead, behind)
    length = np.linalg.norm(normal, axis=1)
    angle = np.arctan2(length, np.einsum("ij,ij->i", ahead, behind))
    weighted = normal * (angle / np.maximum(length, np.finfo(float).tiny))[:, None]
    smooth_normal = unit(sum_rows(mesh.corner_vertex, weighted, mesh.vertex_count))
    sectors = find_sectors(mesh, net.edge_sharpness > 0.0, rules.special)
    sector_normal = unit(sum_rows(sectors.sector, weighted[sectors.corner], len(sectors.size)))
    return _assemble(net, rules, smooth_normal, sectors, sector_normal, points)


def _patch_normals(mesh: Topology, points: FloatArray) -> CornerRows:
    """Return the normals of bilinear patches at their corners, of larger faces their own.

    At a corner that turns inwards the patch folds over; the normal of its face stands in.
    """
    crosses = corner_crosses(mesh, points)
    area = area_vectors(mesh.face_sizes, points[mesh.corner_vertex])[0][mesh.corner_face]
    flat = (mesh.face_sizes > 4)[mesh.corner_face] | (np.einsum("ij,ij->i", crosses, area) <= 0.0)
    normal = unit(np.where(flat[:, None], area, crosses))
    return CornerRows(normal, np.arange(mesh.corner_count))


def corner_crosses(
    mesh: Topology, points: FloatArray, corners: IndexArray | None = None
) -> FloatArray:
    """Return the cross product of the edges that leave each corner, shape [n, 3]."""
    chosen = np.arange(mesh.corner_count) if corners is None else corners
    own = points[mesh.corner_vertex[chosen]]
    ahead = points[mesh.corner_vertex[mesh.corner_next[chosen]]] - own
    behind = points[mesh.corner_vertex[mesh.corner_previous[chosen]]] - own
    return cross(ahead, behind)


def find_sectors(mesh: Topology, sharp: BoolArray, vertices: IndexArray) -> Sectors:
    """Return the sectors around some vertices.

    Args:
        mesh: Connectivity.
        sharp: Edges that end a sector, as edges without twins do, shape [edge_count].
        vertices: Vertices whose sectors are wanted.
    """
    wanted = np.zeros(mesh.vertex_count, dtype=np.bool_)
    wanted[vertices] = True
    pending = np.flatnonzero(wanted[mesh.corner_vertex])
    stop = sharp[mesh.edge] | (mesh.twin < 0)
    visited = np.zeros(mesh.corner_count, dtype=np.bool_)
    corners: list[IndexArray] = []
    names: list[IndexArray] = []
    ranks: list[IndexArray] = []
    firsts: list[IndexArray] = []
    start = pending[stop[pending]]
    count = 0
    open_count = len(start)
    while len(pending):
        firsts.append(start)
        name = np.arange(count, count + len(start))
        count += len(start)
        current, rank = start, 0
        while len(current):
            visited[current] = True
            corners.append(current)
            names.append(name)
            ranks.append(np.full(len(current), rank))
            rank += 1
            back = mesh.corner_previous[current]
            going = ~stop[back]
            current, name = mesh.twin[back[going]], name[going]
            fresh = ~visited[current]
            current, name = current[fresh], name[fresh]
        pending = pending[~visited[pending]]
        start = pending[np.unique(mesh.corner_vertex[pending], return_index=True)[1]]
    empty = np.empty(0, dtype=np.intp)
    sector = np.concatenate([empty, *names])
    return Sectors(
        corner=np.concatenate([empty, *corners]),
        sector=sector,
        rank=np.concatenate([empty, *ranks]),
        size=np.bincount(sector, minlength=count),
        vertex=mesh.corner_vertex[np.concatenate([empty, *firsts])],
        closed=np.arange(count) >= open_count,
    )


def _limit(
    net: Net, values: FloatArray, rules: VertexRules, normal_out: FloatArray | None
) -> FloatArray:
    """Apply the limit stencils; write the smooth normals, not yet of unit length."""
    limit = values.copy()
    smooth = np.ones(len(values), dtype=np.bool_)
    smooth[rules.special] = rules.smooth > 0.0
    start = np.empty(len(values), dtype=np.intp)
    start[net.topology.corner_vertex] = np.arange(net.topology.corner_count)
    for valence in np.unique(rules.valence[smooth]):
        vertices = np.flatnonzero(smooth & (rules.valence == valence))
        _limit_smooth(net, values, int(valence), vertices, start[vertices], limit, normal_out)
    if len(rules.special):
        now, later = crease_sums(rules, values)
        own = values[rules.special]
        limit[rules.special] = (
            rules.smooth[:, None] * limit[rules.special]
            + rules.crease[:, None] * (2.0 / 3.0 * own + now / 6.0)
            + rules.crease_next[:, None] * (2.0 / 3.0 * own + later / 6.0)
            + rules.corner[:, None] * own
        )
    return limit


def _limit_smooth(
    net: Net,
    values: FloatArray,
    valence: int,
    vertices: IndexArray,
    start: IndexArray,
    limit: FloatArray,
    normal_out: FloatArray | None,
) -> None:
    """Apply the smooth stencils to vertices of one valence, walking around all of them at once."""
    mesh = net.topology
    quads = net.scheme == "catmullClark"
    theta = 2.0 * np.pi / valence
    eigenvalue = float(_quad_eigenvalue(np.array(theta)))
    across_weight = 4.0 * (4.0 * eigenvalue - 1.0) if quads else 1.0
    across_sum = np.zeros((len(vertices), values.shape[1]))
    diagonal_sum = np.zeros_like(across_sum)
    tangents = np.zeros((2, len(vertices), 3))
    corner = start
    for step in range(valence):
        following = mesh.corner_next[corner]
        across = values[mesh.corner_vertex[following]]
        across_sum += across
        back = mesh.corner_previous[corner]
        if quads:
            diagonal = values[mesh.corner_vertex[mesh.corner_next[following]]]
            diagonal_sum += diagonal
        if normal_out is not None:
            here, there = step * theta, (step + 1) * theta
            for tangent, wave in zip(tangents, (np.cos, np.sin), strict=True):
                _add(tangent, across_weight * wave(here), across)
                if quads:
                    _add(tangent, wave(here) + wave(there), diagonal)
        corner = mesh.twin[back]
    own = values[vertices]
    if quads:
        total = valence * valence * own + 4.0 * across_sum + diagonal_sum
        limit[vertices] = total / (valence * (valence + 5.0))
    else:
        weight = 1.0 / (valence + 3.0 / (8.0 * loop_weights(np.array(valence))))
        limit[vertices] = (1.0 - valence * weight) * own + weight * across_sum
    if normal_out is not None:
        normal_out[vertices] = cross(tangents[0], tangents[1])


def _add(tangent: FloatArray, weight: float, values: FloatArray) -> None:
    """Add weighted positions in place, where the weight is not 0 up to rounding."""
    if abs(weight) > 1e-12:
        tangent += weight * values[:, :3]


def _crease_normals(net: Net, points: FloatArray, sectors: Sectors) -> FloatArray:
    """Return the normal of each open sector between two crease edges, not of unit length.

    One tangent follows the crease; the other is :func:`_inward_stencil` across the sector.
    """
    mesh = net.topology
    count = len(sectors.size)
    quads = net.scheme == "catmullClark"
    own_weight, end_weight, edge_weight, diagonal_weight = _inward_stencil(sectors.size, quads)
    first = sectors.rank == 0
    last = sectors.rank == sectors.size[sectors.sector] - 1
    ahead = points[mesh.corner_vertex[mesh.corner_next[sectors.corner]]]
    behind = points[mesh.corner_vertex[mesh.corner_previous[sectors.corner]]]
    ends = np.zeros((2, count, 3))
    ends[0, sectors.sector[first]] = ahead[first]
    ends[1, sectors.sector[last]] = behind[last]
    step = np.pi / sectors.size[sectors.sector]
    here, there = np.sin(sectors.rank * step), np.sin((sectors.rank + 1) * step)
    # The edge ahead of a sector's first corner is the crease itself: its sine is 0.
    terms = (edge_weight[sectors.sector] * here)[:, None] * ahead
    if quads:
        diagonal = mesh.corner_next[mesh.corner_next[sectors.corner]]
        weight = diagonal_weight[sectors.sector] * (here + there)
        terms += weight[:, None] * points[mesh.corner_vertex[diagonal]]
    inward = sum_rows(sectors.sector, terms, count)
    inward += own_weight[:, None] * points[sectors.vertex]
    inward += end_weight[:, None] * (ends[0] + ends[1])
    return cross(ends[0] - ends[1], inward)


def _inward_stencil(
    size: IndexArray, quads: bool
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return the weights of the tangent across sectors of some sizes, from crease to crease.

    They are the left eigenvector of the subdivision matrix of a crease vertex for its first
    mode: sin(i theta), theta = pi / size, on the inner edges and sin(i theta) + sin((i + 1)
    theta) on the diagonals, with the eigenvalue that an interior vertex of twice as many faces
    has. The weights of the vertex and of the crease ends follow from their two columns of the
    matrix. Two quads and three triangles give the cross tangents of the B-spline and of the box
    spline; the published general stencils (Biermann et al. 2000) hold for rules that are modified
    next to the crease, which those of OpenSubdiv and so of USD are not.

    Returns:
        Weights of the vertex, of each crease end, of inner edges and of diagonals, times the
        sines, each of shape [n].
    """
    theta = np.pi / np.maximum(size, 2)
    cosine, sine = np.cos(theta), np.sin(theta)
    total = 1.0 / np.tan(0.5 * theta)
    if quads:
        eigenvalue = _quad_eigenvalue(theta)
        edge = np.full(len(theta), 4.0)
        diagonal = 1.0 / (4.0 * eigenvalue - 1.0)
        at_end = sine * (edge / 16.0 + diagonal / 4.0)
        at_own = total * (3.0 * edge / 8.0 + diagonal / 2.0)
    else:
        eigenvalue = 0.375 + 0.25 * cosine
        edge, diagonal = np.ones(len(theta)), np.zeros(len(theta))
        at_end = sine / 8.0
        at_own = 0.375 * total
    # end (eigenvalue - 1/2) - own / 8 = at_end;  own (eigenvalue - 3/4) - end = at_own
    determinant = (eigenvalue - 0.5) * (eigenvalue - 0.75) - 0.125
    own = ((eigenvalue - 0.5) * at_own + at_end) / determinant
    end = own * (eigenvalue - 0.75) - at_own
    return own, end, edge, diagonal


def _quad_eigenvalue(theta: FloatArray) -> FloatArray:
    """Return the subdominant eigenvalue of Catmull-Clark subdivision (Halstead et al. 1993)."""
    root = np.sqrt(2.0 * (9.0 + np.cos(theta)))
    value: FloatArray = (5.0 + np.cos(theta) + np.cos(0.5 * theta) * root) / 16.0
    return value


def _assemble(
    net: Net,
    rules: VertexRules,
    smooth_normal: FloatArray,
    sectors: Sectors,
    sector_normal: FloatArray,
    points: FloatArray,
) -> CornerRows:
    """Put vertex and sector normals in one table, with a stand-in where a stencil vanishes."""
    mesh = net.topology
    share = np.zeros(mesh.vertex_count)
    share[rules.special] = rules.smooth
    share_of_sector = share[sectors.vertex][:, None]
    split = share_of_sector * smooth_normal[sectors.vertex]
    split += (1.0 - share_of_sector) * sector_normal
    normal = np.concatenate([smooth_normal, unit(split)])
    corner_normal = mesh.corner_vertex.copy()
    corner_normal[sectors.corner] = mesh.vertex_count + sectors.sector
    used = np.zeros(len(normal), dtype=np.bool_)
    used[corner_normal] = True
    missing = used & ~np.any(normal, axis=1)
    if missing.any():
        at = np.flatnonzero(missing[corner_normal])
        area = area_vectors(mesh.face_sizes, points[mesh.corner_vertex])[0]
        mean = unit(sum_rows(corner_normal[at], area[mesh.corner_face[at]], len(normal)))
        normal[missing] = mean[missing]
        normal[missing & ~np.any(normal, axis=1)] = (0.0, 0.0, 1.0)
    return CornerRows(normal, corner_normal)


def unit(vectors: FloatArray) -> FloatArray:
    """Return vectors of length 1, and of length 0 where they vanish."""
    length = np.sqrt(np.einsum("ij,ij->i", vectors, vectors))[:, None]
    units: FloatArray = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0.0)
    return units
