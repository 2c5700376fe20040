"""Uniform subdivision: Catmull-Clark, Loop and bilinear, with the surface's limit.

Pure NumPy: no USD here. The rules of sharpness are in :mod:`usdskin.render.mesh_net`, the limit
stencils in :mod:`usdskin.render.mesh_limit`, face-varying channels in
:mod:`usdskin.render.mesh_channels`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from usdskin.render.mesh_channels import Channel
from usdskin.render.mesh_limit import limit_surface, limit_values
from usdskin.render.mesh_net import (
    Net,
    crease_sums,
    decay,
    loop_weights,
    sum_rows,
    vertex_rules,
)
from usdskin.render.mesh_topology import (
    CornerRows,
    FloatArray,
    IndexArray,
    Topology,
    refine_to_quads,
    refine_to_triangles,
)

_TRIANGLE_FACE_WEIGHT = 0.470
"""Weight of a triangle's center in a smooth edge point under ``triangleSubdivisionRule`` smooth
(OpenSubdiv, "Triangle Subdivision Rule")."""


@dataclass(frozen=True, slots=True, eq=False)
class Refined:
    """A subdivided mesh, its vertices on the limit surface."""

    topology: Topology
    """Quads (triangles for Loop)."""

    control_face: IndexArray
    """Face of the control mesh that each face comes from, shape [face_count]."""

    vertex: FloatArray
    """Vertex data, positions in the first three columns, shape [vertex_count, k]."""

    normals: CornerRows
    """Unit normals of the limit surface at the corners."""

    varying: FloatArray
    """Linearly interpolated vertex data, shape [vertex_count, m]."""

    face_varying: tuple[CornerRows, ...]
    """Corner data of each channel."""


def subdivide(
    net: Net,
    level: int,
    vertex: FloatArray,
    varying: FloatArray | None = None,
    face_varying: Sequence[Channel] = (),
) -> Refined:
    """Subdivide a control mesh and push its vertices, and smooth data, to the limit surface.

    Args:
        net: Control mesh.
        level: Times to subdivide, at least 1.
        vertex: Smooth vertex data, positions in the first three columns, shape [vertex_count, k].
        varying: Vertex data that is interpolated linearly, shape [vertex_count, m].
        face_varying: Face-varying channels.
    """
    if level < 1:
        raise ValueError(f"subdivision level {level} is below 1")
    quads = net.scheme != "loop"
    control_face = np.arange(net.topology.face_count)
    if varying is None:
        varying = np.empty((net.topology.vertex_count, 0))
    current, values = net, vertex
    for _ in range(level):
        sizes = current.topology.face_sizes
        values = refine_values(current, values)
        varying = refine_linearly(current.topology, varying, quads)
        control_face = np.repeat(control_face, sizes if quads else 4)
        current = refine(current)
    values, normals = limit_surface(current, values)
    channels = tuple(_subdivide_channel(net, channel, level) for channel in face_varying)
    return Refined(current.topology, control_face, values, normals, varying, channels)


def _subdivide_channel(net: Net, channel: Channel, level: int) -> CornerRows:
    """Return a face-varying channel's values at the corners of the refined mesh."""
    if channel.net is None:
        topology, values, quads = net.topology, channel.values, net.scheme != "loop"
        for _ in range(level):
            values = refine_corners_linearly(topology, values, quads)
            topology = refine_to_quads(topology) if quads else refine_to_triangles(topology)
        return CornerRows(values, np.arange(len(values)))
    current, values = channel.net, channel.values
    for _ in range(level):
        values = refine_values(current, values)
        current = refine(current)
    return CornerRows(limit_values(current, values), current.topology.corner_vertex)


def refine(net: Net) -> Net:
    """Return the net one level down."""
    mesh = net.topology
    child = refine_to_triangles(mesh) if net.scheme == "loop" else refine_to_quads(mesh)
    edge = np.zeros(child.edge_count)
    edge[: 2 * mesh.edge_count] = np.repeat(decay(net.edge_sharpness), 2)
    vertex = np.zeros(child.vertex_count)
    vertex[: mesh.vertex_count] = decay(net.vertex_sharpness)
    return Net(child, net.scheme, edge, vertex)


def refine_values(net: Net, values: FloatArray) -> FloatArray:
    """Return the values at the vertices of ``refine(net)`` by the scheme's own rules.

    Catmull and Clark 1978; Loop 1987, with the crease rules of Hoppe et al. 1994.

    Args:
        net: Net the values belong to.
        values: One row per vertex, shape [vertex_count, k].

    Returns:
        One row per vertex of the child, shape [child vertex_count, k].
    """
    if net.scheme == "bilinear":
        return refine_linearly(net.topology, values, quads=True)
    mesh = net.topology
    rules = vertex_rules(net)
    valence = np.maximum(rules.valence, 1)[:, None]
    across = values[mesh.corner_vertex[mesh.corner_next]]
    edge_middle = 0.5 * (values[mesh.edge_vertex[:, 0]] + values[mesh.edge_vertex[:, 1]])
    if net.scheme == "catmullClark":
        center = face_means(mesh, values)
        beside = center[mesh.corner_face]
        edge_point = _edge_points(net, edge_middle, beside, 0.5)
        ring = sum_rows(mesh.corner_vertex, across + beside, mesh.vertex_count)
        vertex_point = ((valence - 2.0) * values + ring / valence) / valence
    else:
        center = np.empty((0, values.shape[1]))
        beside = values[mesh.corner_vertex[mesh.corner_previous]]
        edge_point = _edge_points(net, edge_middle, beside, 0.25)
        ring = sum_rows(mesh.corner_vertex, across, mesh.vertex_count)
        weight = loop_weights(valence)
        vertex_point = (1.0 - valence * weight) * values + weight * ring
    if len(rules.special):
        now, later = crease_sums(rules, values)
        own = values[rules.special]
        vertex_point[rules.special] = (
            rules.smooth[:, None] * vertex_point[rules.special]
            + rules.crease[:, None] * (0.75 * own + 0.125 * now)
            + rules.crease_next[:, None] * (0.75 * own + 0.125 * later)
            + rules.corner[:, None] * own
        )
    return np.concatenate([vertex_point, edge_point, center])


def _edge_points(
    net: Net, middle: FloatArray, beside: FloatArray, side_weight: float
) -> FloatArray:
    """Pull the middles of the edges that are not fully sharp towards the values beside them."""
    mesh = net.topology
    half = np.flatnonzero(mesh.forward & (mesh.twin >= 0))
    edge = mesh.edge[half]
    weight = side_weight * (1.0 - np.minimum(net.edge_sharpness[edge], 1.0))
    if net.smooth_triangles and net.scheme == "catmullClark":
        triangle = (mesh.face_sizes == 3)[mesh.corner_face]
        rule = np.where(triangle, _TRIANGLE_FACE_WEIGHT, 0.25)
        weight *= 2.0 * (rule[half] + rule[mesh.twin[half]])
    sides = 0.5 * (beside[half] + beside[mesh.twin[half]])
    point = middle.copy()
    point[edge] += weight[:, None] * (sides - middle[edge])
    return point


def face_means(mesh: Topology, values: FloatArray) -> FloatArray:
    """Return the mean of the values at the corners of each face, shape [face_count, k]."""
    return corner_means(mesh, values[mesh.corner_vertex])


def corner_means(mesh: Topology, corner_values: FloatArray) -> FloatArray:
    """Return the mean of the corner values of each face, shape [face_count, k]."""
    sizes = mesh.face_sizes
    if len(sizes) and (sizes == sizes[0]).all():
        columns = corner_values.reshape(len(sizes), int(sizes[0]), -1)
        means: FloatArray = columns.mean(axis=1)
        return means
    sums: FloatArray = np.add.reduceat(corner_values, mesh.face_start[:-1], axis=0)
    return sums / sizes[:, None]


def refine_linearly(mesh: Topology, values: FloatArray, quads: bool) -> FloatArray:
    """Return vertex values one level down: kept, at edge middles and (quads) at face means."""
    middle = 0.5 * (values[mesh.edge_vertex[:, 0]] + values[mesh.edge_vertex[:, 1]])
    center = face_means(mesh, values) if quads else values[:0]
    return np.concatenate([values, middle, center])


def refine_corners_linearly(mesh: Topology, values: FloatArray, quads: bool) -> FloatArray:
    """Return corner values one level down, linear within each face, shape [child corners, k]."""
    middle = 0.5 * (values + values[mesh.corner_next])
    before = middle[mesh.corner_previous]
    if quads:
        center = corner_means(mesh, values)[mesh.corner_face]
        return np.stack([values, middle, center, before], axis=1).reshape(-1, values.shape[1])
    width = values.shape[1]
    child = np.empty((mesh.face_count, 4, 3, width))
    child[:, :3] = np.stack([values, middle, before], axis=1).reshape(-1, 3, 3, width)
    child[:, 3] = middle.reshape(-1, 3, width)
    return child.reshape(-1, width)
