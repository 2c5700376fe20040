"""Which lights reach which prims, and whose shadows they see (UsdLux light linking)."""

from __future__ import annotations

import warp as wp


@wp.struct
class LightLinks:
    """Lights by number: domes, then distant lights, then local lights, each in their order."""

    active: wp.int32
    """0 where every light reaches everything and sees the shadow of everything."""

    prim_set: wp.array[wp.int32]
    """Row of the tables for each prim, shape [prim_count]; empty where not active."""

    lit: wp.array2d[wp.uint8]
    """Whether a light reaches the prims of a row, shape [row_count, light_count]."""

    shadows: wp.array2d[wp.uint8]
    """Whether the prims of a row cast shadows from a light, shape [row_count, light_count]."""


@wp.func
def reaches(links: LightLinks, prim: wp.int32, light: wp.int32):
    """Return whether a light illuminates a prim."""
    if links.active == 0:
        return True
    return links.lit[links.prim_set[prim], light] != wp.uint8(0)


@wp.func
def shades(links: LightLinks, prim: wp.int32, light: wp.int32):
    """Return whether a prim casts a shadow from a light."""
    if links.active == 0:
        return True
    return links.shadows[links.prim_set[prim], light] != wp.uint8(0)
