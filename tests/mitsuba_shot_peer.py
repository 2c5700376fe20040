"""Mitsuba 3's half of the comparison of shots: ``python mitsuba_shot_peer.py job.npz out.npz``.

A process of its own, as ``mitsuba_peer.py``. In a spectral variant Mitsuba's camera, rays and
triangles meet a light and a skin written here from the equations: an emitter that is a table of
texels by bands, with a sun; a BSDF that is eq. (1); and an integrator that finds the way of light
inside the body hit by hit. Wavelengths are drawn at random, four to a ray, over all bands. The
light is even within a band, for the file gives averages; so are the skin's spectra, or, where
``straight`` says so, they are straight between their samples.

job: ``points`` [m, 3], ``faces`` [n, 3] and ``normals`` [m, 3] of a closed body; ``camera`` [4, 4],
``fov_deg`` (along x), ``size`` [2]; ``radiance`` [h, w, bands] of a dome in UsdLux's layout and
``dome_to_world``; ``sun_direction``, ``sun_angle_deg``, ``sun_irradiance`` [bands], or absent;
``edges_nm`` [bands + 1]; ``wavelength_nm``, ``reflectance``, ``scattering``, ``opacity``;
``alpha``, ``wrap``; ``shadowed``, ``straight``; ``samples`` (per pixel and pass), ``passes``.

out: ``pictures`` [passes, height, width, bands].
"""

from __future__ import annotations

import sys
from typing import Any, ClassVar

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

mi.set_variant("llvm_ad_spectral")

Job = dict[str, NDArray]

GAP_M = 2e-6
"""Between a surface and the rays that leave it; the body stands at the origin, where floats are
fine. Mitsuba's own gap is a hundred times as large: light from below the horizon leaks through."""


def table(values: NDArray) -> mi.Float:
    return mi.Float(np.ascontiguousarray(values, np.float32).ravel())


class Tabulated:
    """A spectrum of bands that are even, or of samples with straight lines between them."""

    def __init__(self, nm: NDArray, values: NDArray, straight: bool) -> None:
        self.straight = straight
        self.start, self.step, self.count = float(nm[0]), float(nm[1] - nm[0]), len(nm)
        self.values = table(values)

    def __call__(self, wavelengths: mi.Spectrum) -> mi.Spectrum:
        x = dr.clip((wavelengths - self.start) / self.step, 0.0, self.count - 1.0001)
        result = mi.Spectrum(0.0)
        for k in range(len(wavelengths)):
            if not self.straight:
                result[k] = dr.gather(mi.Float, self.values, mi.UInt32(x[k] + 0.5))
                continue
            i = mi.UInt32(x[k])
            low = dr.gather(mi.Float, self.values, i)
            result[k] = dr.lerp(low, dr.gather(mi.Float, self.values, i + 1), x[k] - i)
        return result


class Environment(mi.Emitter):
    """Texels of even light (u = 0.5 is +Z, u = 0.25 is +X, v = 0 is +Y), and a sun's disc."""

    job: ClassVar[Job] = {}

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying
        job = self.job
        self.height, self.width, self.bands = job["radiance"].shape
        self.edges = np.cos(np.pi * np.arange(self.height + 1) / self.height)
        size = (self.edges[:-1] - self.edges[1:])[:, None] * (2.0 * np.pi / self.width)
        mean = job["radiance"].mean(axis=-1)
        chance = (0.9 * mean / (mean * size).sum() + 0.1 / (4.0 * np.pi)) * size
        self.pick = mi.DiscreteDistribution(table(chance))
        self.row_edge, self.radiance = table(self.edges), table(job["radiance"])
        self.to_world = mi.Matrix3f(job["dome_to_world"])
        self.low = float(job["edges_nm"][0])
        self.step = float(job["edges_nm"][1] - job["edges_nm"][0])
        self.sun_share = 0.5 if "sun_direction" in job else 0.0
        if self.sun_share:
            half = np.radians(0.5 * float(job["sun_angle_deg"]))
            self.sun_floor = float(np.cos(half))
            self.sun_cap = float(2.0 * np.sin(0.5 * half) ** 2)
            self.sun_frame = mi.Frame3f(mi.Vector3f(*job["sun_direction"].tolist()))
            # A surface that faces the disc receives L pi sin^2(half).
            self.sun = table(job["sun_irradiance"] / (np.pi * np.sin(half) ** 2))

    def set_scene(self, scene: mi.Scene) -> None:
        pass

    def banded(self, values: mi.Float, first: mi.UInt32, wavelengths: mi.Spectrum) -> mi.Spectrum:
        result = mi.Spectrum(0.0)
        for k in range(len(wavelengths)):
            band = dr.clip((wavelengths[k] - self.low) / self.step, 0.0, self.bands - 0.5)
            result[k] = dr.gather(mi.Float, values, first + mi.UInt32(band))
        return result

    def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Spectrum:
        return mi.Spectrum(0.0)  # the dome itself stays unseen

    def sample_direction(self, it: Any, sample: mi.Point2f, active: mi.Bool = True) -> Any:
        to_sun = mi.Bool(False)
        x = sample.x
        if self.sun_share:
            to_sun = x < self.sun_share
            x = dr.select(to_sun, x / self.sun_share, (x - self.sun_share) / (1 - self.sun_share))
        texel, rest = self.pick.sample_reuse(x, active)
        i, j = texel // self.width, texel % self.width
        top = dr.gather(mi.Float, self.row_edge, i)
        bottom = dr.gather(mi.Float, self.row_edge, i + 1)
        y = dr.lerp(top, bottom, sample.y)
        angle = (mi.Float(j) + rest) * (2.0 * dr.pi / self.width)
        sine = dr.safe_sqrt(1 - y * y)
        local = mi.Vector3f(sine * dr.sin(angle), y, -sine * dr.cos(angle))
        direction = self.to_world @ local
        size = (top - bottom) * (2.0 * dr.pi / self.width)
        density = self.pick.eval_pmf_normalized(texel) / size * (1.0 - self.sun_share)
        weight = self.banded(self.radiance, texel * self.bands, it.wavelengths) / density
        if self.sun_share:
            drop = x * self.sun_cap  # 1 less the cosine from the disc's middle
            across = dr.safe_sqrt(drop * (2.0 - drop))
            turn = 2.0 * dr.pi * sample.y
            spot = mi.Vector3f(across * dr.cos(turn), across * dr.sin(turn), 1.0 - drop)
            direction = dr.select(to_sun, self.sun_frame.to_world(spot), direction)
            disc = 2.0 * dr.pi * self.sun_cap / self.sun_share
            sun = self.banded(self.sun, mi.UInt32(0), it.wavelengths) * disc
            weight = dr.select(to_sun, sun, weight)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = direction
        ds.dist = 1e4
        ds.p = it.p + ds.d * ds.dist
        ds.n = -ds.d
        ds.time = it.time
        ds.pdf = 1.0
        ds.emitter = mi.EmitterPtr(self)
        return ds, weight

    def pdf_direction(self, it: Any, ds: Any, active: mi.Bool = True) -> mi.Float:
        return mi.Float(1.0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        return mi.ScalarBoundingBox3f()


class Skin(mi.BSDF):
    """alpha S / pi (max(N.L, 0) + Ss max((N.L + l) / (1 + l), 0)), both terms clamped."""

    job: ClassVar[Job] = {}

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
        self.m_flags = self.m_components[0]
        nm, straight = self.job["wavelength_nm"], bool(self.job["straight"])
        self.albedo = Tabulated(nm, self.job["reflectance"], straight)
        self.scattering = Tabulated(nm, self.job["scattering"], straight)
        self.alpha, self.wrap = float(self.job["alpha"]), float(self.job["wrap"])

    def sample(self, ctx: Any, si: Any, s1: Any, s2: Any, active: Any = True) -> Any:
        return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0.0)

    def eval(self, ctx: Any, si: Any, wo: mi.Vector3f, active: Any = True) -> mi.Spectrum:
        lambert = dr.maximum(wo.z, 0.0)
        wrapped = dr.maximum((wo.z + self.wrap) / (1.0 + self.wrap), 0.0)
        value = self.albedo(si.wavelengths) * (lambert + self.scattering(si.wavelengths) * wrapped)
        return dr.select(active, (self.alpha / dr.pi) * value, 0.0)

    def pdf(self, ctx: Any, si: Any, wo: mi.Vector3f, active: Any = True) -> mi.Float:
        return mi.Float(0.0)


@dr.syntax
def way_inside(
    scene: mi.Scene, si: mi.SurfaceInteraction3f, direction: mi.Vector3f, most: float, lit: mi.Bool
) -> tuple[mi.Float, mi.Bool]:
    """Return how long light from a direction is inside the body [m], and whether it gets out."""
    cosine = dr.dot(si.n, direction)
    below = cosine < 0.0
    begin = si.p + dr.select(below, -GAP_M, GAP_M) * si.n
    inside = mi.Bool(below)
    # What the gap cuts off is inside too.
    length = dr.select(below, GAP_M / dr.maximum(-cosine, 0.01), 0.0)
    start = mi.Float(0.0)
    last = mi.UInt32(si.prim_index)
    active = mi.Bool(lit)
    while active:
        ray = mi.Ray3f(begin + start * direction, direction)
        hit = scene.ray_intersect_preliminary(ray, False, active)
        found = hit.is_valid() & active
        again = found & (hit.prim_index == last)
        step = dr.select(found, hit.t, 0.0)
        length = dr.select(found & inside, length + step, length)
        inside = dr.select(found & ~again, ~inside, inside)
        last = dr.select(found, hit.prim_index, last)
        length = dr.select(found & inside, length + GAP_M, length)
        start = start + step + GAP_M
        active = found & (length < most)
    return length, ~inside & (length < most)


def passes(job: Job) -> NDArray:
    """Return pictures, shape [passes, height, width, bands]."""
    Environment.job = Skin.job = job
    mi.register_emitter("environment", Environment)
    mi.register_bsdf("skin", Skin)
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict({"type": "skin"})
    middle = 0.5 * (job["points"].min(axis=0) + job["points"].max(axis=0))
    points, faces = job["points"] - middle, job["faces"]
    mesh = mi.Mesh("body", len(points), len(faces), has_vertex_normals=True, props=properties)
    parameters = mi.traverse(mesh)
    parameters["vertex_positions"] = table(points)
    parameters["vertex_normals"] = table(job["normals"])
    parameters["faces"] = mi.UInt32(np.ascontiguousarray(faces, np.uint32).ravel())
    parameters.update()
    width, height = (int(value) for value in job["size"])
    to_world = job["camera"] @ np.diag([-1.0, 1.0, -1.0, 1.0])
    to_world[:3, 3] -= middle
    camera = mi.load_dict({
        "type": "perspective", "fov": float(job["fov_deg"]), "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(to_world), "near_clip": 0.01,
        "film": {"type": "hdrfilm", "width": width, "height": height},
    })  # fmt: skip
    scene = mi.load_dict({"type": "scene", "light": {"type": "environment"}, "body": mesh})
    edges = job["edges_nm"]
    bands, low, reach = len(edges) - 1, float(edges[0]), float(edges[-1] - edges[0])
    opacity = Tabulated(job["wavelength_nm"], job["opacity"], bool(job["straight"]))
    most = float(25.0 / job["opacity"].min())
    samples = int(job["samples"])
    result = []
    for number in range(int(job["passes"])):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(number, width * height * samples)
        index = dr.arange(mi.UInt32, width * height * samples)
        pixel = index // samples
        # Strata within the pixel: edges are alike in all passes.
        side = round(samples**0.5)
        i = index % samples
        jitter = mi.Point2f(i % side, i // side) + sampler.next_2d()
        film = mi.Point2f(pixel % width, pixel // width) + jitter / side
        ray, _ = camera.sample_ray(0.0, 0.5, film / mi.Point2f(width, height), mi.Point2f(0.5))
        ray.wavelengths = low + reach * mi.sample_shifted(sampler.next_1d())
        si = scene.ray_intersect(ray)
        si.wavelengths = ray.wavelengths
        active = si.is_valid()
        ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(), False, active)
        value = si.bsdf().eval(mi.BSDFContext(), si, si.to_local(ds.d), active) * weight
        if bool(job["shadowed"]):
            lit = active & (dr.max(value) > 0.0)
            length, is_out = way_inside(scene, si, ds.d, most, lit)
            weaker = dr.exp(-length * opacity(ray.wavelengths))
            value = dr.select(is_out, value * weaker, 0.0)
        value = dr.select(active, value, 0.0)
        total = dr.zeros(mi.Float, width * height * bands)
        for k in range(4):
            band = (ray.wavelengths[k] - low) * (bands / reach)
            at = pixel * bands + mi.UInt32(dr.clip(band, 0.0, bands - 0.5))
            dr.scatter_add(total, value[k] * (bands / (4.0 * samples)), at, active)
        result.append(np.array(total, np.float32).reshape(height, width, bands))
    return np.stack(result)


if __name__ == "__main__":
    with np.load(sys.argv[1]) as job:
        pictures = passes(dict(job))
    np.savez(sys.argv[2], pictures=pictures)
