"""Face-varying channels of subdivided meshes.

A channel is a mesh of its own on the same faces: its vertices are the distinct values around each
vertex of the mesh, so that an edge along which the values differ is a boundary of the channel. It
inherits the sharpness of the mesh's edges and vertices, and where it parts from the mesh,
``faceVaryingLinearInterpolation`` says which of its values stay fixed (OpenSubdiv, "Face-varying
Interpolation Rules").

Pure NumPy: no USD here.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from usdskin.render.mesh_net import SHARPNESS_INFINITE, Net
from usdskin.render.mesh_topology import (
    BoolArray,
    FloatArray,
    IndexArray,
    Topology,
    build_topology,
)

LinearInterpolation = Literal[
    "none", "cornersOnly", "cornersPlus1", "cornersPlus2", "boundaries", "all"
]


@dataclass(frozen=True, slots=True, eq=False)
class Channel:
    """Face-varying values with the net they are refined on."""

    net: Net | None
    """Net of the channel; None when the values are linear within each face of the mesh."""

    values: FloatArray
    """One row per vertex of the channel's net, or per corner of the mesh, shape [n, k]."""


def face_varying_channel(
    net: Net, values: FloatArray, indices: IndexArray, rule: LinearInterpolation
) -> Channel:
    """Build the net of a face-varying channel.

    Args:
        net: Control mesh.
        values: Distinct values, shape [value_count, k].
        indices: Value of each corner, shape [corner_count]. Corners of one vertex share a value
            where they name the same one.
        rule: ``faceVaryingLinearInterpolation``.
    """
    if rule == "all" or net.scheme == "bilinear":
        return Channel(None, values[indices])
    mesh = net.topology
    key = mesh.corner_vertex * np.intp(max(len(values), 1)) + indices
    _, corner, name = np.unique(key, return_index=True, return_inverse=True)
    channel = build_topology(mesh.face_sizes, name.reshape(-1), len(corner))
    edge_sharpness = np.zeros(channel.edge_count)
    edge_sharpness[channel.edge] = net.edge_sharpness[mesh.edge]
    edge_sharpness[channel.edge[channel.twin < 0]] = SHARPNESS_INFINITE
    vertex = mesh.corner_vertex[corner]
    vertex_sharpness = net.vertex_sharpness[vertex]
    pinned = _pinned_values(mesh, channel, vertex, edge_sharpness, rule)
    vertex_sharpness[pinned] = SHARPNESS_INFINITE
    if rule in ("cornersPlus1", "cornersPlus2"):
        borrowed = _borrowed_sharpness(channel, vertex, edge_sharpness)
        np.maximum(vertex_sharpness, borrowed, out=vertex_sharpness)
    own_net = Net(channel, net.scheme, edge_sharpness, vertex_sharpness, net.smooth_triangles)
    return Channel(own_net, values[indices[corner]])


def _pinned_values(
    mesh: Topology,
    channel: Topology,
    vertex: IndexArray,
    edge_sharpness: FloatArray,
    rule: LinearInterpolation,
) -> BoolArray:
    """Return the values that the rule keeps, beyond those that sharp edges keep by themselves."""
    count = channel.vertex_count
    if rule == "none":
        return np.zeros(count, dtype=np.bool_)
    seam = (channel.twin < 0) & (mesh.twin >= 0)
    parted = np.zeros(mesh.vertex_count, dtype=np.bool_)
    parted[mesh.edge_vertex[mesh.edge[seam]]] = True
    on_boundary = np.zeros(mesh.vertex_count, dtype=np.bool_)
    on_boundary[mesh.edge_vertex[mesh.edge[mesh.twin < 0]]] = True
    parted_value, boundary_value = parted[vertex], on_boundary[vertex]
    pinned: BoolArray
    if rule == "boundaries":
        pinned = parted_value | boundary_value
        return pinned
    faces = np.bincount(channel.corner_vertex, minlength=count)
    alone = faces == 1
    pinned = alone & (parted_value | boundary_value)
    if rule == "cornersOnly":
        return pinned
    values = np.bincount(vertex, minlength=mesh.vertex_count)[vertex]
    pinned |= parted_value & (values > 2)
    infinite = channel.edge_vertex[edge_sharpness >= SHARPNESS_INFINITE]
    tied = np.bincount(infinite.reshape(-1), minlength=count) > 2
    if rule == "cornersPlus2":
        pinned |= parted_value & (values == 1) & ~boundary_value
        tied = tied | alone
    of_two = parted_value & (values == 2)
    either = np.zeros(mesh.vertex_count, dtype=np.bool_)
    either[vertex[tied & of_two]] = True
    pinned |= of_two & either[vertex]
    return pinned


def _borrowed_sharpness(
    channel: Topology, vertex: IndexArray, edge_sharpness: FloatArray
) -> FloatArray:
    """Return the semi-sharpness that one of two values takes over from the other's creases."""
    semi = (edge_sharpness > 0.0) & (edge_sharpness < SHARPNESS_INFINITE)
    borrowed = np.zeros(channel.vertex_count)
    if not semi.any():
        return borrowed
    own = np.zeros(channel.vertex_count)
    np.maximum.at(own, channel.edge_vertex[semi], edge_sharpness[semi][:, None])
    values = np.bincount(vertex)
    order = np.argsort(vertex, kind="stable")
    place = np.searchsorted(vertex[order], np.flatnonzero(values == 2))
    one, other = order[place], order[place + 1]
    borrowed[one] = np.where(own[one] > 0.0, 0.0, own[other])
    borrowed[other] = np.where(own[other] > 0.0, 0.0, own[one])
    return borrowed
