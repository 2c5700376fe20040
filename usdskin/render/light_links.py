"""Light linking: which lights reach a prim, and which see its shadow.

Reads: ``collection:lightLink``, ``collection:shadowLink`` and ``inputs:shadow:enable`` of lights.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray
from pxr import Usd

from usdskin.render.environment import group_count
from usdskin.render.light_collections import casts_shadows, is_linked
from usdskin.render.lights import Lights
from usdskin.warp_kernels import light_links as kernels
from usdskin.warp_kernels import structs

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class LinkTables:
    """Links of prims to lights, in rows that prims share."""

    prim_set: NDArray[np.int32]
    """Row of each prim, shape [prim_count]."""

    lit: BoolArray
    """Whether a light reaches the prims of a row, shape [row_count, light_count]."""

    shadows: BoolArray
    """Whether the prims of a row cast shadows from a light, shape [row_count, light_count]."""

    @property
    def active(self) -> bool:
        """Whether anything is left out."""
        return not (self.lit.all() and self.shadows.all())


def read_links(
    stage: Usd.Stage,
    light_paths: Sequence[str],
    prim_paths: Sequence[str],
    time: Usd.TimeCode,
) -> LinkTables:
    """Find out which lights reach which prims, and whose shadows they see.

    Args:
        stage: The stage.
        light_paths: Prim paths of the lights, domes and distant lights too, as they are numbered.
        prim_paths: Paths of what is drawn, those of instance proxies where it is instanced.
        time: Time to read at.
    """
    lit = np.ones((len(prim_paths), len(light_paths)), np.bool_)
    shadows = np.ones_like(lit)
    for k, path in enumerate(light_paths):
        light = stage.GetPrimAtPath(path)
        for name, table in (("lightLink", lit), ("shadowLink", shadows)):
            if is_linked(light, name):
                query = Usd.CollectionAPI(light, name).ComputeMembershipQuery()
                table[:, k] = [query.IsPathIncluded(prim) for prim in prim_paths]
        if not casts_shadows(light, time):
            shadows[:, k] = False
    both = np.concatenate([lit, shadows], axis=1)
    rows, prim_set = np.unique(both, axis=0, return_inverse=True)
    count = len(light_paths)
    return LinkTables(prim_set.reshape(-1).astype(np.int32), rows[:, :count], rows[:, count:])


def upload_links(tables: LinkTables, device: str) -> kernels.LightLinks:
    """Copy link tables to a device; nothing where every light reaches everything."""
    links = kernels.LightLinks()
    links.active = int(tables.active)
    empty = np.zeros((0, 0), np.uint8)
    lit = tables.lit.astype(np.uint8) if tables.active else empty
    shadows = tables.shadows.astype(np.uint8) if tables.active else empty
    prim_set = tables.prim_set if tables.active else np.zeros(0, np.int32)
    links.prim_set = wp.array(prim_set, dtype=wp.int32, device=device)
    links.lit = wp.array(lit, dtype=wp.uint8, ndim=2, device=device)
    links.shadows = wp.array(shadows, dtype=wp.uint8, ndim=2, device=device)
    return links


def link_lights(
    field: structs.Lights, lights: Lights, tables: LinkTables | None, device: str
) -> None:
    """Hand the links to the kernels: whom each light, and each channel of light, reaches.

    Args:
        field: Where they go.
        lights: The lights, whose channels are those of ``field``.
        tables: Their links; None where every light reaches everything.
        device: Where to.
    """
    if tables is None or not tables.active:
        none = np.zeros((0, 0), np.bool_)
        field.links = upload_links(LinkTables(np.zeros(0, np.int32), none, none), device)
        field.link_mask = wp.zeros((0, 0), dtype=wp.vec4f, device=device)
        return
    field.links = upload_links(tables, device)
    groups = int(field.group_count)
    mask = np.ones((len(tables.lit), groups * 4), np.float32)
    used = 0
    for k, dome in enumerate(lights.domes):
        count = 4 * group_count(dome.coefficients.shape[2])
        mask[:, used : used + count] = tables.lit[:, k : k + 1]
        used += count
    first = len(lights.domes)
    count = len(lights.distants)
    mask[:, used : used + count] = tables.lit[:, first : first + count]
    field.link_mask = wp.array(mask.reshape(-1, groups, 4), dtype=wp.vec4f, device=device)
