"""Mitsuba 3's half of the cross-renderer tests, run as ``python mitsuba_peer.py job.npz out.npz``.

It runs in a process of its own: an LLVM that is too old ends the process, not an exception.

Mitsuba's ``envmap`` cannot hold spectra: its bitmap takes three channels, which spectral variants
turn into sigmoid spectra times D65 (and 61 channels are refused). Therefore

- ``coefficients`` renders the map in an RGB variant, where a channel is just a number: red, green
  and blue are the pictures of c0, c1 and c2 with a white surface, to be combined with the basis;
- ``skin`` gives Mitsuba an emitter and a BSDF of its own, written here from the equations, in a
  spectral variant, so that it multiplies the spectra at single wavelengths.

Either may have a second, black body that takes light from the first (``occluder_points`` and
``occluder_faces``). For ``skin`` its shadow is tested alone, by a scene of its own: Mitsuba lifts
shadow rays by so much that light from below the horizon leaks past the first body, by 1 %.
``is_opaque`` says that the first body lets nothing through from behind.
"""

from __future__ import annotations

import itertools
import sys
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

Job = dict[str, NDArray]


def render(job: Job) -> NDArray:
    """Return the picture, shape [h, w, channels]."""
    kind = str(job["kind"])
    mi.set_variant(str(job["variant"]))
    scene = mi.load_dict(coefficient_scene(job) if kind == "coefficients" else skin_scene(job))
    total = 0.0
    passes = int(job["passes"])
    for seed in range(passes):
        total = total + np.array(mi.render(scene, seed=seed), np.float64)
    return total / passes


def sensor(job: Job, film: dict[str, Any]) -> dict[str, Any]:
    """A USD camera (right, up, back as columns) as Mitsuba's (left, up, forward)."""
    to_world = job["camera"] @ np.diag([-1.0, 1.0, -1.0, 1.0])
    size = int(job["size"])
    return {
        "type": "perspective",
        "fov": float(job["fov_deg"]),
        "fov_axis": "x",
        "to_world": mi.ScalarTransform4f(to_world),
        "sampler": {"type": "multijitter", "sample_count": int(job["samples"])},
        "film": {
            "width": size,
            "height": size,
            "component_format": "float32",
            "rfilter": {"type": "box"},
            **film,
        },
    }


def body(job: Job, bsdf: dict[str, Any], prefix: str = "") -> mi.Object:
    """The triangles, flat."""
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(bsdf)
    points, faces = job[prefix + "points"], job[prefix + "faces"]
    mesh = mi.Mesh(prefix + "body", len(points), len(faces), props=properties)
    parameters = mi.traverse(mesh)
    for name, values in (("vertex_positions", points), ("faces", faces)):
        buffer = type(parameters[name])  # differs between scalar and vectorised variants
        parameters[name] = buffer(values.ravel())
    parameters.update()
    return mesh


def occluders(job: Job) -> dict[str, mi.Object]:
    """The black body, if there is one."""
    if "occluder_points" not in job:
        return {}
    black = 0.0 if "spectral" in str(job["variant"]) else [0.0, 0.0, 0.0]
    kind = "uniform" if "spectral" in str(job["variant"]) else "rgb"
    bsdf = {"type": "diffuse", "reflectance": {"type": kind, "value": black}}
    return {"occluder": body(job, bsdf, "occluder_")}


def coefficient_scene(job: Job) -> dict[str, Any]:
    """Three coefficient channels as red, green and blue on a white Lambert body."""
    film = {"type": "hdrfilm", "pixel_format": "rgb"}
    rotation = np.eye(4)
    rotation[:3, :3] = job["dome_to_world"]
    finer = 16  # envmap interpolates between texel centres: blocks stand for constant patches
    texels = job["coefficients"].repeat(finer, axis=0).repeat(finer, axis=1)
    return {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 2, "hide_emitters": True},
        "sensor": sensor(job, film),
        "light": {
            "type": "envmap",
            "bitmap": mi.Bitmap(texels.astype(np.float32)),
            "to_world": mi.ScalarTransform4f(rotation),
        },
        "body": body(
            job, {"type": "diffuse", "reflectance": {"type": "rgb", "value": [1.0, 1.0, 1.0]}}
        ),
        **occluders(job),
    }


def skin_scene(job: Job) -> dict[str, Any]:
    """Eq. (1) under a spectral dome, one film channel per band."""
    plugins = define_plugins(job)
    for name, plugin in plugins.items():
        getattr(mi, f"register_{name}")(f"test_{name}", plugin)
    film: dict[str, Any] = {"type": "specfilm"}
    edges = job["band_edges_nm"]
    for k, (low, high) in enumerate(itertools.pairwise(edges)):
        box = [(low - 1e-3, 0.0), (low, 1.0), (high, 1.0), (high + 1e-3, 0.0)]
        film[f"band{k:03d}"] = {"type": "spectrum", "value": box}
    return {
        "type": "scene",
        "integrator": {"type": "test_integrator"},
        "sensor": sensor(job, film),
        "light": {"type": "test_emitter"},
        "body": body(job, {"type": "test_bsdf"}),
        **occluders(job),
    }


def define_plugins(job: Job) -> dict[str, type]:
    """Return an emitter, a BSDF and an integrator; defined late, when the variant is known."""
    import drjit as dr

    nm = job["wavelength_nm"]
    start, step = float(nm[0]), float(nm[1] - nm[0])
    tables = {
        name: mi.Float(np.ascontiguousarray(job[name], np.float32).ravel())
        for name in ("basis", "reflectance", "scattering", "coefficients")
    }
    height, width, rank = job["coefficients"].shape
    to_world = mi.Matrix3f(job["dome_to_world"])
    wrap, alpha = float(job["wrap"]), float(job["alpha"])
    edge = np.cos(np.pi * np.arange(height + 1) / height)
    area = (edge[:-1] - edge[1:])[:, None] * (2 * np.pi / width)
    chance = np.abs(job["coefficients"] @ job["basis"].mean(axis=1)) * area
    pick = mi.DiscreteDistribution(mi.Float(chance.astype(np.float32).ravel()))
    row_edge = mi.Float(edge.astype(np.float32))
    is_opaque = bool(job.get("is_opaque", False))
    occluder = None
    if "occluder_points" in job:
        occluder = mi.load_dict({"type": "scene", **occluders(job)})

    def tabulated(table: mi.Float, wavelengths: mi.Spectrum, row: int = 0) -> mi.Spectrum:
        x = dr.clip((wavelengths - start) / step, 0.0, len(nm) - 1.0001)
        i = mi.UInt32(0)
        result = mi.Spectrum(0.0)
        for k in range(len(wavelengths)):
            i = mi.UInt32(x[k])
            low = dr.gather(mi.Float, table, row * len(nm) + i)
            high = dr.gather(mi.Float, table, row * len(nm) + i + 1)
            result[k] = dr.lerp(low, high, x[k] - i)
        return result

    class Dome(mi.Emitter):
        """UsdLux: u = 0.5 is +Z, u = 0.25 is +X, v = 0 is +Y; texels are constant patches."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_flags = mi.EmitterFlags.Infinite | mi.EmitterFlags.SpatiallyVarying

        def set_scene(self, scene: mi.Scene) -> None:
            pass

        def texel(self, direction: mi.Vector3f) -> mi.UInt32:
            local = dr.transpose(to_world) @ direction
            u = dr.atan2(local.x, -local.z) / (2 * dr.pi)
            u = dr.select(u < 0, u + 1, u)
            v = dr.safe_acos(local.y) / dr.pi
            j = dr.minimum(mi.UInt32(u * width), width - 1)
            return dr.minimum(mi.UInt32(v * height), height - 1) * width + j

        def radiance(self, texel: mi.UInt32, wavelengths: mi.Spectrum) -> mi.Spectrum:
            total = mi.Spectrum(0.0)
            for k in range(rank):
                weight = dr.gather(mi.Float, tables["coefficients"], texel * rank + k)
                total += weight * tabulated(tables["basis"], wavelengths, k)
            return total

        def density(self, texel: mi.UInt32) -> mi.Float:
            i = texel // width
            size = dr.gather(mi.Float, row_edge, i) - dr.gather(mi.Float, row_edge, i + 1)
            return pick.eval_pmf_normalized(texel) / (size * (2 * dr.pi / width))

        def eval(self, si: mi.SurfaceInteraction3f, active: mi.Bool = True) -> mi.Spectrum:
            return mi.Spectrum(0.0)  # the dome itself stays unseen

        def sample_direction(self, it: Any, sample: mi.Point2f, active: mi.Bool = True) -> Any:
            texel, rest = pick.sample_reuse(sample.x, active)
            i, j = texel // width, texel % width
            top = dr.gather(mi.Float, row_edge, i)
            y = dr.lerp(top, dr.gather(mi.Float, row_edge, i + 1), sample.y)
            angle = (mi.Float(j) + rest) * (2 * dr.pi / width)
            sine = dr.safe_sqrt(1 - y * y)
            local = mi.Vector3f(sine * dr.sin(angle), y, -sine * dr.cos(angle))
            ds = dr.zeros(mi.DirectionSample3f)
            ds.d = to_world @ local
            ds.dist = 1e4
            ds.p = it.p + ds.d * ds.dist
            ds.n = -ds.d
            ds.time = it.time
            ds.pdf = self.density(texel)
            ds.emitter = mi.EmitterPtr(self)
            return ds, self.radiance(texel, it.wavelengths) / ds.pdf

        def pdf_direction(self, it: Any, ds: Any, active: mi.Bool = True) -> mi.Float:
            return self.density(self.texel(ds.d))

        def bbox(self) -> mi.ScalarBoundingBox3f:
            return mi.ScalarBoundingBox3f()

    class Skin(mi.BSDF):
        """alpha S / pi (max(N.L, 0) + Ss max((N.L + l)/(1 + l), 0)), both terms clamped."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.m_components = [mi.BSDFFlags.DiffuseReflection | mi.BSDFFlags.FrontSide]
            self.m_flags = self.m_components[0]

        def sample(self, ctx: Any, si: Any, s1: Any, s2: Any, active: Any = True) -> Any:
            return dr.zeros(mi.BSDFSample3f), mi.Spectrum(0.0)

        def eval(self, ctx: Any, si: Any, wo: mi.Vector3f, active: Any = True) -> mi.Spectrum:
            lambert = dr.maximum(wo.z, 0.0)
            wrapped = dr.maximum((wo.z + wrap) / (1.0 + wrap), 0.0)
            scattering = tabulated(tables["scattering"], si.wavelengths)
            albedo = tabulated(tables["reflectance"], si.wavelengths)
            value = (alpha / dr.pi) * albedo * (lambert + scattering * wrapped)
            return dr.select(active & (si.wi.z > 0.0), value, 0.0)

        def pdf(self, ctx: Any, si: Any, wo: mi.Vector3f, active: Any = True) -> mi.Float:
            return mi.Float(0.0)

    class EmitterOnly(mi.SamplingIntegrator):
        """One light sample per camera ray: the reflectance map, less what others block."""

        def sample(
            self,
            scene: mi.Scene,
            sampler: mi.Sampler,
            ray: mi.RayDifferential3f,
            medium: Any = None,
            active: mi.Bool = True,
        ) -> Any:
            si = scene.ray_intersect(ray, active)
            active = active & si.is_valid()
            ds, weight = scene.sample_emitter_direction(si, sampler.next_2d(active), False, active)
            value = si.bsdf(ray).eval(mi.BSDFContext(), si, si.to_local(ds.d), active)
            is_lit = active
            if is_opaque:
                is_lit = is_lit & (dr.dot(si.n, ds.d) > 0.0)
            if occluder is not None:
                is_lit = is_lit & ~occluder.ray_test(mi.Ray3f(si.p, ds.d), is_lit)
            return dr.select(is_lit, value * weight, 0.0), active, []

    return {"emitter": Dome, "bsdf": Skin, "integrator": EmitterOnly}


if __name__ == "__main__":
    with np.load(sys.argv[1]) as job:
        picture = render(dict(job))
    np.savez(sys.argv[2], picture=picture)
