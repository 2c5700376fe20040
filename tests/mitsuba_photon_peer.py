"""Light of a set by photons, run as ``python mitsuba_photon_peer.py job.npz out.npz``.

Mitsuba's shapes and rays, and a loop written here: photons leave the lamps, and wherever one is
reflected, what the capture point would see of it goes to a texel. Paths from the capture point, as
Mitsuba's path integrator follows them, find the bright places beside the lamps by chance alone;
photons are everywhere in proportion to the light, so that the same time gives a tenth of the noise,
for all bands at once. ``mitsuba_set_peer`` is the check of both.

job: as of ``mitsuba_set_peer``, with ``photons`` (per pass), ``groups`` (passes), ``bounces`` (at
most) and ``grid``. Lamps must have a place.

out: ``picture`` [groups, height, 2 height, bands], the mean radiance of every texel, and ``flux``
[groups, surfaces + 1, grid * grid, bands] that arrives at the front of every surface, whose two
edges are cut in ``grid`` parts; the last surface is the lamps.
"""

from __future__ import annotations

import sys

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

mi.set_variant("llvm_ad_rgb")

from mitsuba_set_peer import Job, scene  # noqa: E402

GAP_M = 1e-5
"""Between a surface and the rays that leave it."""


def table(values: NDArray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(values, np.float32).ravel())


@dr.syntax
def follow(
    built: mi.Scene,
    job: Job,
    tables: dict[str, mi.Float],
    sampler: mi.Sampler,
    at: mi.Point3f,
    normal: mi.Normal3f,
    power: list[mi.Float],
    image: mi.Float,
    flux: mi.Float,
) -> None:
    """Send photons on their way; what they show of surfaces is added to the image."""
    height, bands, grid = int(job["height"]), len(power), int(job["grid"])
    eye = mi.Point3f(*job["origin"].tolist())
    active = mi.Bool(True)
    bounces = mi.UInt32(0)
    while active:
        # What the capture point sees of it.
        away = eye - at
        far = dr.norm(away)
        way = away / far
        cosine = dr.dot(way, normal)
        begin = at + GAP_M * normal
        ray = mi.Ray3f(begin, way, 0.0, mi.Color0f())
        ray.maxt = far * (1.0 - 1e-5)
        seen = active & (cosine > 0.0)
        seen &= ~built.ray_test(ray, seen)
        polar = dr.safe_acos(-way.y) / dr.pi
        turn = dr.atan2(-way.x, way.z) / (2.0 * dr.pi)
        turn = dr.select(turn < 0.0, turn + 1.0, turn)
        i = dr.minimum(mi.UInt32(polar * height), height - 1)
        j = dr.minimum(mi.UInt32(turn * (2 * height)), 2 * height - 1)
        texel = (i * (2 * height) + j) * bands
        share = cosine / (dr.pi * far * far)
        for k in range(bands):
            dr.scatter_add(image, power[k] * share, texel + k, seen)
        # Where it goes next.
        local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d(active))
        direction = mi.Frame3f(normal).to_world(local)
        si = built.ray_intersect(mi.Ray3f(begin, direction), active)
        active &= si.is_valid() & (dr.dot(si.n, direction) < 0.0)
        kind = dr.gather(
            mi.UInt32, tables["kind"], dr.reinterpret_array(mi.UInt32, si.shape), active
        )
        most = dr.gather(mi.Float, tables["most"], kind, active)
        cell = mi.Point2u(dr.clip(si.uv * grid, 0.0, grid - 0.5))
        part = (kind * grid + cell.x) * grid + cell.y
        for k in range(bands):
            dr.scatter_add(flux, power[k], part * bands + k, active)
        active &= sampler.next_1d(active) < most
        for k in range(bands):
            rho = dr.gather(mi.Float, tables["reflectance"], kind * bands + k, active)
            power[k] *= rho / most
        at = mi.Point3f(si.p)
        normal = mi.Normal3f(si.n)
        bounces += 1
        active &= bounces <= int(job["bounces"])


def render(job: Job) -> dict[str, NDArray]:
    """Return what is written."""
    built = scene(job, slice(0, 3))
    bands, height = job["reflectance"].shape[1], int(job["height"])
    surface_count, count = len(job["reflectance"]), int(job["photons"])
    grid = int(job["grid"])
    shapes = built.shapes_dr()
    numbers = np.array(dr.reinterpret_array(mi.UInt32, shapes))
    kind = np.full(numbers.max() + 1, surface_count, np.uint32)
    lamps = {}
    for number, shape in zip(numbers, built.shapes(), strict=True):
        name = shape.id()
        if name.startswith("surface"):
            kind[number] = int(name.removeprefix("surface"))
        else:
            lamps[int(name.removeprefix("lamp"))] = number
    reflectance = np.vstack([job["reflectance"], np.zeros(bands)])
    tables = {
        "kind": mi.UInt32(kind),
        "most": table(reflectance.max(axis=1)),
        "reflectance": table(reflectance),
    }
    area = {
        index: shape.surface_area() for index, shape in zip(numbers, built.shapes(), strict=True)
    }
    order = [lamps[k] for k in range(len(lamps))]
    flux = np.array([np.pi * float(np.array(area[number]).ravel()[0]) for number in order])
    flux = flux[:, None] * job["lamp_radiance"]
    chance = flux.mean(axis=1) / flux.mean(axis=1).sum()
    pick = mi.DiscreteDistribution(table(chance))
    born = table(flux / chance[:, None] / count)
    which = mi.UInt32(np.array(order, np.uint32))
    edge = np.cos(np.arange(height + 1) * np.pi / height)
    size = (edge[:-1] - edge[1:])[:, None, None] * np.pi / height
    result, arriving = [], []
    for group in range(int(job["groups"])):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(group, count)
        index = pick.sample(sampler.next_1d())
        lamp = dr.reinterpret_array(mi.ShapePtr, dr.gather(mi.UInt32, which, index))
        place = lamp.sample_position(0.0, sampler.next_2d())
        power = [dr.gather(mi.Float, born, index * bands + k) for k in range(bands)]
        image = dr.zeros(mi.Float, height * 2 * height * bands)
        flux = dr.zeros(mi.Float, (surface_count + 1) * grid * grid * bands)
        follow(built, job, tables, sampler, place.p, mi.Normal3f(place.n), power, image, flux)
        arriving.append(np.array(flux, np.float64).reshape(-1, grid * grid, bands))
        result.append(np.array(image, np.float64).reshape(height, 2 * height, bands) / size)
    return {"picture": np.stack(result), "flux": np.stack(arriving)}


if __name__ == "__main__":
    with np.load(sys.argv[1]) as job:
        found = render(dict(job))
    np.savez(sys.argv[2], **found)
