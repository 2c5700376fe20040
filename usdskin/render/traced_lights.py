"""The lights of a stage as rays are sent to them.

Makes: ``TracedLights`` for the traced integrator.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import warp as wp
from numpy.typing import NDArray

from usdskin.device import copied, vec4
from usdskin.render.light_guide import LightParts, light_parts, turned_parts
from usdskin.render.light_maps import LightField, luminances
from usdskin.render.light_tree import build_light_tree
from usdskin.render.lights import Lights
from usdskin.render.surface_rows import SpectralFrame
from usdskin.warp_kernels import light_tree, local_lights


@dataclass(frozen=True, slots=True, eq=False)
class TracedLights:
    """What rays are sent to."""

    tree: light_tree.LightTree
    """Domes and distant lights."""

    local: local_lights.LocalLights
    """Lights that have a place."""

    first_local: int
    """Number of the first of them in the light links."""

    parts: LightParts
    """What blocks of pixels learn of the tree's light."""

    upright: NDArray[np.float32] | None
    """Cones of the tree's nodes in the frame of the only dome, shape [node_count, 4]; None where
    there are other lights, or domes, which need not turn with it."""


def trace_lights(
    lights: Lights, field: LightField, frame: SpectralFrame, device: str
) -> TracedLights:
    """Prepare the lights of a scene for tracing.

    Args:
        lights: The lights.
        field: Their channels, local lights included.
        frame: Weighs the channels by how bright they look.
        device: Where to.
    """
    if field.local is None:
        raise ValueError("the light field was built without its local lights")
    first = len(lights.domes) + len(lights.distants)
    is_alone = first == len(lights.domes) == 1
    built = lights
    if is_alone:
        built = replace(lights, domes=(replace(lights.domes[0], to_world=np.eye(3)),))
    tree = build_light_tree(built, luminances(field, frame), device)
    upright = tree.node_cone.numpy() if is_alone else None
    parts = light_parts(built, tree, field.device_lights.group_count, device)
    found = TracedLights(tree, field.local.device_lights, first, parts, upright)
    return turn_traced_lights(found, lights, device) or found


def turn_traced_lights(found: TracedLights, lights: Lights, device: str) -> TracedLights | None:
    """Return lights whose only dome has been turned.

    Args:
        found: Prepared lights.
        lights: The lights as they are turned now.
        device: Where to.

    Returns:
        The lights, sharing arrays with ``found``; None where the tree has to be built anew.
    """
    if found.upright is None:
        return None
    to_world = lights.domes[0].to_world
    tree = copied(found.tree, light_tree.LightTree)
    cones = found.upright.copy()
    cones[:, :3] = found.upright[:, :3] @ to_world.T
    tree.node_cone = vec4(cones, device)
    turns = to_world.astype(np.float32)[None]
    tree.dome_to_world = wp.array(turns, dtype=wp.mat33f, device=device)
    return replace(found, tree=tree, parts=turned_parts(found.parts, to_world, device))
