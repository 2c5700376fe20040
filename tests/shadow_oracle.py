"""Shadowed light in float64 by brute force: every texel of a dome, every triangle, no tree, no map.

The oracle knows DESIGN section 2 ("Visibility is E'") and shares no code with the product: towards
each direction the ways inside the own body add up to s, other bodies block, and a ray that enters
and never leaves is blocked. Triangles are met as Moeller and Trumbore (1997) do.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

CHUNK = 4_000_000
"""Pairs of rays and triangles at once."""


@dataclass(frozen=True, eq=False)
class Solid:
    """A body of the oracle."""

    corners: FloatArray
    """Shape [faces, 3, 3]."""

    normals: FloatArray | None
    """Shading normals of the corners, shape [faces, 3, 3]."""

    alpha: float = 1.0
    wrap: float = 0.3
    scattering: float = 0.0
    delta: FloatArray | float = 0.0
    """One per band, or of all [1/m]."""

    opacity: float = 1.0
    """What it blocks of the light of others."""


@dataclass(frozen=True, eq=False)
class Surface:
    """A point that a camera ray meets."""

    body: int
    position: FloatArray
    normal: FloatArray
    geometric: FloatArray
    """Both on the viewer's side."""


def crossings(
    origin: FloatArray, direction: FloatArray, corners: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return t (inf where there is none) and barycentrics of corners 1 and 2, [rays, faces]."""
    first = corners[:, 1] - corners[:, 0]
    second = corners[:, 2] - corners[:, 0]
    # With n = first x second: t = -(o - a).n / d.n, u = ((o - a) x d).second / d.n, and so on.
    normal = np.cross(first, second)
    with np.errstate(divide="ignore", invalid="ignore"):
        inverse = -1.0 / (direction @ normal.T)
        moment = np.cross(origin, direction)
        # (o - a) x d = o x d - a x d; (a x d).e = d.(e x a)
        u = moment @ second.T - direction @ np.cross(second, corners[:, 0]).T
        v = moment @ first.T - direction @ np.cross(first, corners[:, 0]).T
        u, v = u * inverse, -v * inverse
        t = (origin @ normal.T - (corners[:, 0] * normal).sum(-1)) * inverse
        is_hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (t > 0.0)
    return np.where(is_hit, t, np.inf), u, v


def first_surface(bodies: Sequence[Solid], origin: FloatArray, toward: FloatArray) -> Surface:
    """Return what one camera ray sees."""
    best, found = np.inf, None
    direction = toward / np.linalg.norm(toward)
    for k, body in enumerate(bodies):
        t, u, v = crossings(origin[None], direction[None], body.corners)
        face = int(t[0].argmin())
        if t[0, face] < best:
            best = float(t[0, face])
            a, b, c = body.corners[face]
            geometric = np.cross(b - a, c - a)
            geometric /= np.linalg.norm(geometric)
            side = -1.0 if geometric @ direction > 0.0 else 1.0
            weights = np.array([1.0 - u[0, face] - v[0, face], u[0, face], v[0, face]])
            normal = geometric if body.normals is None else weights @ body.normals[face]
            normal = normal / np.linalg.norm(normal)
            at = weights @ body.corners[face]
            found = Surface(k, at, side * normal, side * geometric)
    assert found is not None, "the camera ray misses every body"
    return found


def ways(
    bodies: Sequence[Solid], own: int, origin: FloatArray, direction: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the share that arrives past other bodies, and the length inside the own one."""
    share, length = np.ones(len(direction)), np.zeros(len(direction))
    step = max(1, CHUNK // sum(len(body.corners) for body in bodies))
    for begin in range(0, len(direction), step):
        here = slice(begin, begin + step)
        at = np.broadcast_to(origin, direction.shape)[here]
        for k, body in enumerate(bodies):
            t, _, _ = crossings(at, direction[here], body.corners)
            is_hit = np.isfinite(t)
            count = is_hit.sum(axis=1)
            if k != own:
                share[here] *= (1.0 - body.opacity) ** count
                continue
            if not np.max(body.delta) > 0.0:
                continue
            most = int(count.max(initial=0))
            ordered = np.sort(t, axis=1)[:, :most]
            ordered[~np.isfinite(ordered)] = 0.0
            length[here] += ordered[:, 1::2].sum(axis=1) - ordered[:, 0::2].sum(axis=1)
            share[here][count % 2 == 1] = 0.0
    return share, np.maximum(length, 0.0)


def dome_directions(
    height: int, width: int, parts: NDArray[np.int64], random: np.random.Generator
) -> tuple[FloatArray, NDArray[np.int64], FloatArray]:
    """Return directions, their texels and solid angles: a jittered one in each part of a texel.

    A texel is cut into ``parts`` x ``parts`` of equal solid angles, shape [height width].
    """
    edge = np.cos(np.pi * np.arange(height + 1) / height)
    texel = np.arange(height * width).repeat(parts**2)
    cut = parts[texel]
    first = np.cumsum(parts**2) - parts**2
    number = np.arange(len(texel)) - first[texel]
    i, j = texel // width, texel % width
    down, across = random.random((2, len(texel))) + np.stack([number // cut, number % cut])
    y = edge[i] + (edge[i + 1] - edge[i]) * down / cut
    turn = 2.0 * np.pi * (j + across / cut) / width
    sine = np.sqrt(1.0 - y * y)
    angle = (edge[i] - edge[i + 1]) * 2.0 * np.pi / width / cut**2
    return np.stack([sine * np.sin(turn), y, -sine * np.cos(turn)], -1), texel, angle


def shadowed(
    bodies: Sequence[Solid],
    surface: Surface,
    radiance: FloatArray,
    parts: int,
    seed: int = 0,
    to_world: FloatArray | None = None,
) -> FloatArray:
    """Return eq. (1) at a surface under a dome, shape [bands].

    Args:
        bodies: The scene.
        surface: What is lit.
        radiance: Texels of the dome, latlong, shape [height, width, bands].
        parts: Each texel is cut into parts x parts, and those with much of the light into more.
        seed: Of the jitter.
        to_world: The dome's rotation.
    """
    height, width, bands = radiance.shape
    body = bodies[surface.body]
    rows = np.arange(height + 1)
    flux = radiance.max(axis=2) * -np.diff(np.cos(np.pi * rows / height))[:, None]
    share = (flux / flux.sum()).ravel()
    cuts = np.maximum(parts, np.ceil(parts * np.sqrt(share * share.size)).astype(int))
    random = np.random.default_rng(seed)
    directions, texel, angle = dome_directions(height, width, np.minimum(cuts, 64), random)
    if to_world is not None:
        directions = directions @ to_world.T
    x = directions @ surface.normal
    wrapped = np.maximum((x + body.wrap) / (1.0 + body.wrap), 0.0)
    kernel = np.maximum(x, 0.0) + body.scattering * wrapped
    is_lit = (kernel > 0.0) & (radiance.reshape(-1, bands).max(axis=1) > 0.0)[texel]
    directions, texel, kernel = directions[is_lit], texel[is_lit], kernel[is_lit]
    angle = angle[is_lit]
    # Off the surface by what float64 needs, on the viewer's side.
    size = np.abs(surface.position).max() + np.abs(body.corners).max()
    lifted = surface.position + 1e-12 * size * surface.geometric
    share, length = ways(bodies, surface.body, lifted, directions)
    delta = np.broadcast_to(np.asarray(body.delta, float), (bands,))
    weight = (kernel * share * angle)[:, None] * np.exp(-length[:, None] * delta)
    return body.alpha / np.pi * (weight * radiance.reshape(-1, bands)[texel]).sum(axis=0)


def lustre(
    surface: Surface,
    view: FloatArray,
    radiance: FloatArray,
    roughness: float,
    f0: float,
    parts: int,
) -> FloatArray:
    """Return what one dielectric GGX lobe (alpha = roughness^2) reflects of a clear dome.

    Walter et al. 2007 with the height-correlated masking of Heitz 2014, by quadrature over the
    texels; shape [bands].
    """
    height, width, bands = radiance.shape
    parts_of = np.full(height * width, parts)
    directions, texel, angle = dome_directions(height, width, parts_of, np.random.default_rng(0))
    n, alpha = surface.normal, roughness**2
    is_above = directions @ n > 0.0
    directions, texel, angle = directions[is_above], texel[is_above], angle[is_above]
    half = directions + view
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    nl, nv, nh, vh = directions @ n, float(view @ n), half @ n, half @ view
    facets = alpha**2 / np.pi / (nh**2 * (alpha**2 - 1.0) + 1.0) ** 2

    def hidden(cosine: FloatArray | float) -> FloatArray:
        return (np.sqrt(1.0 + alpha**2 * (1.0 / np.square(cosine) - 1.0)) - 1.0) / 2.0

    masking = 1.0 / (1.0 + hidden(nl) + hidden(nv))
    index = (1.0 + f0**0.5) / (1.0 - f0**0.5)
    inside = np.sqrt(1.0 - (1.0 - vh**2) / index**2)
    across = (vh - index * inside) / (vh + index * inside)
    along = (index * vh - inside) / (index * vh + inside)
    fresnel = 0.5 * (across**2 + along**2)
    weight = facets * masking * fresnel / (4.0 * nv) * angle
    return weight @ radiance.reshape(-1, bands)[texel]
