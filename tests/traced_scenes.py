"""Small scenes for the tests of the traced integrator: bodies, light and a view, in memory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from usdskin.device import Workers, open_workers
from usdskin.progress import SilentProgress
from usdskin.render.cameras import read_camera
from usdskin.render.integrate import DeviceScene, Picture, integrate
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import ERROR_FLOOR
from usdskin.render.scene import Scene, mean_white, read_scene
from usdskin.render.settings import read_settings
from usdskin.render.traced import integrate_traced
from usdskin.render.traced_lights import trace_lights
from usdskin.render.traced_passes import Sampling, sampling_key
from usdskin.render.uploading import upload

# isort: split
# After ours, which register the schemas.
import OpenEXR
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

FloatArray = NDArray[np.float64]

NM = np.array([420.0, 480.0, 540.0, 600.0, 660.0])
"""Five bands are enough: nothing here depends on how many there are."""


@dataclass(frozen=True, kw_only=True)
class Body:
    """A mesh of skin, or of a UsdPreviewSurface where ``opacity`` is given."""

    points: FloatArray
    faces: NDArray[np.int64]
    normals: FloatArray | None = None
    """Shading normals of the points; None for flat triangles."""
    alpha: float = 1.0
    wrap: float = 0.3
    reflectance: float = 1.0
    scattering: float = 0.0
    delta: float | tuple[float, ...] = 0.0
    """Per metre, of all bands or one each."""
    specular: dict[str, float] | None = None
    opacity: float | None = None
    threshold: float = 0.0
    emission: float = 0.0
    preview: dict[str, Any] | None = None
    """More inputs of the UsdPreviewSurface."""


def new_stage(up: str = "Y", meters_per_unit: float = 1.0) -> Usd.Stage:
    stage = Usd.Stage.CreateInMemory()
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, meters_per_unit)
    return stage


def add_body(stage: Usd.Stage, body: Body, name: str = "Body", to_world: Any = None) -> None:
    mesh = UsdGeom.Mesh.Define(stage, f"/{name}")
    if to_world is not None:
        mesh.AddTransformOp().Set(Gf.Matrix4d(np.asarray(to_world, float).T))
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(body.points.astype(np.float32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(body.faces.astype(np.int32).ravel()))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(body.faces)))
    mesh.CreateSubdivisionSchemeAttr("none")
    if body.normals is None:
        corner = body.points[body.faces]
        normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        normals = normal.repeat(3, axis=0)
        mesh.SetNormalsInterpolation("faceVarying")
    else:
        normals = body.normals
        mesh.SetNormalsInterpolation("vertex")
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    material = UsdShade.Material.Define(stage, f"/{name}Look")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(material)
    if body.opacity is None:
        _author_skin(material.GetPrim(), body)
    else:
        _author_preview(stage, material, body)


def _author_skin(prim: Usd.Prim, body: Body) -> None:
    prim.ApplyAPI("SkinMaterialAPI")
    prim.GetAttribute("inputs:skin:alpha").Set(body.alpha)
    prim.GetAttribute("inputs:skin:wrap").Set(body.wrap)
    spectra: dict[str, Any] = {"reflectance": body.reflectance, "scattering": body.scattering}
    if np.ndim(body.delta):
        spectra["opacity"] = body.delta
    else:
        prim.GetAttribute("inputs:skin:opacity").Set(float(body.delta))  # type: ignore[arg-type]
    for name, value in spectra.items():
        prim.ApplyAPI("SpectralDistributionAPI", name)
        quantity = {"opacity": "absorption"}.get(name, name)
        prim.GetAttribute(f"spectrum:{name}:quantity").Set(quantity)
        values = np.broadcast_to(np.asarray(value, float), NM.shape)
        edges = np.concatenate([[NM[0] - 30.0], (NM[1:] + NM[:-1]) / 2, [NM[-1] + 30.0]])
        at = np.stack([edges[:-1] + 0.01, edges[1:] - 0.01], -1).ravel()  # flat over each band
        prim.GetAttribute(f"spectrum:{name}:wavelengths").Set(at.tolist())
        prim.GetAttribute(f"spectrum:{name}:values").Set(values.repeat(2).tolist())
    for name, number in (body.specular or {}).items():
        prim.GetAttribute(f"inputs:skin:specular:{name}").Set(number)


def _author_preview(stage: Usd.Stage, material: UsdShade.Material, body: Body) -> None:
    shader = UsdShade.Shader.Define(stage, material.GetPath().AppendChild("Surface"))
    shader.CreateIdAttr("UsdPreviewSurface")
    inputs: dict[str, Any] = {
        "opacity": body.opacity,
        "opacityThreshold": body.threshold,
        "useSpecularWorkflow": 1,
        "specularColor": (0.0, 0.0, 0.0),
        "diffuseColor": (body.alpha,) * 3,
        "emissiveColor": (body.emission,) * 3,
        "opacityMode": "presence",
    }
    kinds = {int: Sdf.ValueTypeNames.Int, str: Sdf.ValueTypeNames.Token}
    for name, value in (inputs | (body.preview or {})).items():
        kind = kinds.get(type(value), Sdf.ValueTypeNames.Float)
        kind = Sdf.ValueTypeNames.Color3f if isinstance(value, tuple) else kind
        value = Gf.Vec3f(*value) if isinstance(value, tuple) else value
        shader.CreateInput(name, kind).Set(value)
    shader.CreateOutput("surface", Sdf.ValueTypeNames.Token)
    material.CreateSurfaceOutput().ConnectToSource(shader.ConnectableAPI(), "surface")


def add_dome(
    stage: Usd.Stage,
    folder: Any,
    coefficients: FloatArray,
    basis: FloatArray | None = None,
    to_world: FloatArray | None = None,
    name: str = "Dome",
) -> None:
    """A dome of coefficient channels, shape [h, w, r], whose spectra are flat over each band."""
    rank = coefficients.shape[2]
    channels = {
        f"c{k}": np.ascontiguousarray(coefficients[..., k], np.float32) for k in range(rank)
    }
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(folder / f"{name}.exr"))
    dome = UsdLux.DomeLight.Define(stage, f"/{name}")
    if to_world is not None:
        transform = np.eye(4)
        transform[:3, :3] = to_world
        dome.AddTransformOp().Set(Gf.Matrix4d(transform.T))
    prim = dome.GetPrim()
    prim.ApplyAPI("SpectralLightAPI")
    prim.GetAttribute("inputs:spectral:source").Set("basis")
    prim.GetAttribute("inputs:spectral:units").Set("absolute")
    file = Sdf.AssetPath(str(folder / f"{name}.exr"))
    prim.GetAttribute("inputs:spectral:coefficients:file").Set(file)
    basis = np.ones((rank, len(NM))) if basis is None else basis
    edges = np.concatenate([[NM[0] - 30.0], (NM[1:] + NM[:-1]) / 2, [NM[-1] + 30.0]])
    at = np.stack([edges[:-1] + 0.01, edges[1:] - 0.01], -1).ravel()
    prim.GetAttribute("inputs:spectral:basis").Set(basis.repeat(2, axis=1).ravel().tolist())
    prim.GetAttribute("inputs:spectral:basis:wavelengths").Set(at.tolist())


def add_view(
    stage: Usd.Stage,
    origin: FloatArray,
    toward: FloatArray,
    width: float,
    orthographic: bool = True,
    far: float = 100.0,
) -> None:
    """A square camera; ``width`` [m] is what it sees of the plane through ``toward``."""
    origin, toward = np.asarray(origin, float), np.asarray(toward, float)
    distance = float(np.linalg.norm(origin - toward))
    back = (origin - toward) / distance
    up = np.array([0.0, 1.0, 0.0]) if abs(back[1]) < 0.9 else np.array([0.0, 0.0, 1.0])
    right = np.cross(up, back)
    right /= np.linalg.norm(right)
    matrix = np.eye(4)
    matrix[:3] = np.stack([right, np.cross(back, right), back, origin], axis=-1)
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    matrix[:3, 3] /= unit
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    camera.AddTransformOp().Set(Gf.Matrix4d(matrix.T))
    if orthographic:
        camera.CreateProjectionAttr("orthographic")
        aperture = 10.0 * width / unit  # tenths of scene units
    else:
        camera.CreateFocalLengthAttr(50.0)
        aperture = 50.0 * width / distance
    for attribute in (camera.CreateHorizontalApertureAttr(), camera.CreateVerticalApertureAttr()):
        attribute.Set(aperture)
    camera.CreateClippingRangeAttr(Gf.Vec2f(1e-4 * distance / unit, far / unit))


@dataclass(frozen=True)
class Ready:
    """A stage uploaded, to be pictured more than once."""

    scene: Scene
    device_scene: DeviceScene
    tree: Any
    camera: Any
    size: int
    workers: Workers

    def traced(
        self,
        samples: int,
        seed: int = 0,
        *,
        frame: float = 1.0,
        target_error: float = 0.0,
        pixel_filter: str = "box",
        show_dome: bool = False,
        parts: bool = True,
        spectral: bool = True,
        workers: Workers | None = None,
    ) -> Picture:
        white = mean_white(self.scene.lights, self.scene.frame)
        settings = Sampling(
            samples=samples,
            target_error=target_error,
            floor=ERROR_FLOOR * float(white[1]),
            pixel_filter=pixel_filter,
            key=sampling_key(seed, frame),
        )
        return integrate_traced(
            self.device_scene, self.tree, self.camera, (self.size, self.size), settings,
            workers or self.workers, SilentProgress(), spectral=spectral, show_dome=show_dome,
            parts=parts,
        )  # fmt: skip

    def spectra(self, samples: int, seed: int = 0, **options: Any) -> FloatArray:
        """Return [h, w, bands]."""
        found = self.traced(samples, seed, **options).spectrum
        assert found is not None
        return found.astype(np.float64)

    def probe(
        self, origin: FloatArray, toward: FloatArray, samples: int, seed: int = 0
    ) -> FloatArray:
        """Return what one ray sees, by ``size`` x ``size`` pixels as close as can be told apart."""
        back = (origin - toward) / np.linalg.norm(origin - toward)
        right = np.cross([0.31, 0.85, -0.42], back)
        right /= np.linalg.norm(right)
        to_world = np.eye(4)
        to_world[:3] = np.stack([right, np.cross(back, right), back, origin], axis=-1)
        width = 1e-7
        camera = replace(
            self.camera, to_world=to_world, orthographic=True,
            window=(-width, width, -width, width), clip_near=1e-6, clip_far=1e6,
        )  # fmt: skip
        return replace(self, camera=camera).spectra(samples, seed, parts=False).reshape(-1, len(NM))

    def mapped(self, samples: int) -> FloatArray:
        """Return what the integrator ``map`` gives, [h, w, bands]."""
        device_scene, _ = upload(self.scene, self.workers, show_dome=False)
        picture = integrate(
            device_scene, self.camera, (self.size, self.size), samples, "box", self.workers,
            SilentProgress(), spectral=True, show_dome=False,
        )  # fmt: skip
        assert picture.spectrum is not None
        return picture.spectrum.astype(np.float64)


def ready(stage: Usd.Stage, size: int, threads: int = 2) -> Ready:
    """Read and upload a stage as ``usdskin render --integrator traced`` does."""
    settings = read_settings(stage, RenderOverrides(integrator="traced", wavelength_nm=NM))
    workers = open_workers("cpu", threads)
    notes: list[Any] = []
    time = Usd.TimeCode.Default()
    scene = read_scene(stage, time, settings, notes)
    device_scene, light = upload(scene, workers, show_dome=True, traced=True)
    tree = trace_lights(scene.lights, light, scene.frame, workers.device)
    camera = read_camera(
        stage, Sdf.Path("/Camera"), time, (size, size), 1.0, "expandAperture", notes
    )
    return Ready(scene, device_scene, tree, camera, size, workers)


# --- Shapes --------------------------------------------------------------------------------------


def sphere(rows: int, columns: int, radius: float = 1.0, center: Any = (0.0, 0.0, 0.0)) -> Any:
    """Points, faces that turn outward, and normals of a sphere of triangles."""
    polar, azimuth = np.meshgrid(
        np.pi * np.arange(1, rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    ring = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.cos(polar), -np.sin(polar) * np.sin(azimuth)], -1
    ).reshape(-1, 3)
    points = np.concatenate([ring, [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    i, j = (index.ravel() for index in np.indices((rows - 2, columns)))
    a, b = i * columns + j, (i + 1) * columns + j
    c, d = (i + 1) * columns + (j + 1) % columns, i * columns + (j + 1) % columns
    j = np.arange(columns)
    top, bottom, last = len(points) - 2, len(points) - 1, (rows - 2) * columns
    faces = np.concatenate([
        np.stack([a, b, c], -1), np.stack([a, c, d], -1),
        np.stack([np.full(columns, top), j, (j + 1) % columns], -1),
        np.stack([np.full(columns, bottom), last + (j + 1) % columns, last + j], -1),
    ])  # fmt: skip
    return radius * points + np.asarray(center, float), faces, points


def torus(rings: int, sides: int, tube: float = 0.4) -> Any:
    """Points, faces that turn outward, and normals of a torus around y of radius 1."""
    i, j = (index.ravel() for index in np.indices((rings, sides)))
    turn, tilt = 2 * np.pi * i / rings, 2 * np.pi * j / sides
    out = np.stack([np.cos(turn), np.zeros_like(turn), -np.sin(turn)], -1)
    normals = np.cos(tilt)[:, None] * out + np.sin(tilt)[:, None] * [0.0, 1.0, 0.0]
    points = out + tube * normals
    a, b = i * sides + j, (i + 1) % rings * sides + j
    c, d = (i + 1) % rings * sides + (j + 1) % sides, i * sides + (j + 1) % sides
    return points, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]), normals


def box(low: Any, high: Any) -> Any:
    """Points and faces, turned outward, of a box."""
    low, high = np.asarray(low, float), np.asarray(high, float)
    corner = np.array([[i >> k & 1 for k in range(3)] for i in range(8)])
    quads = [(0, 4, 6, 2), (1, 3, 7, 5), (0, 1, 5, 4), (2, 6, 7, 3), (0, 2, 3, 1), (4, 5, 7, 6)]
    faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))])
    return low + corner * (high - low), faces


def sheet(size: float = 1.0, pieces: int = 1) -> Any:
    """Points and faces of a square in the plane y = 0, facing +y."""
    at = np.linspace(-size / 2, size / 2, pieces + 1)
    z, x = np.meshgrid(at, at, indexing="ij")
    points = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], -1)
    i, j = (index.ravel() for index in np.indices((pieces, pieces)))
    a = i * (pieces + 1) + j
    b, c, d = a + pieces + 1, a + pieces + 2, a + 1
    return points, np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])


def soft_room(height: int = 16) -> FloatArray:
    """Three channels of a room without small lamps, [h, 2h, 3]."""
    polar, turns = np.meshgrid(
        np.pi * (np.arange(height) + 0.5) / height,
        2 * np.pi * (np.arange(2 * height) + 0.5) / (2 * height),
        indexing="ij",
    )
    toward = np.stack(
        [np.sin(polar) * np.sin(turns), np.cos(polar), -np.sin(polar) * np.cos(turns)], -1
    )
    room = np.full((height, 2 * height, 3), 0.1)
    for k, axis in enumerate(([0.7, 0.5, 0.5], [-0.5, 0.8, 0.2], [0.1, -0.5, 0.9])):
        room[..., k] += np.maximum(toward @ axis / np.linalg.norm(axis), 0.0) ** 2
    return room


def lamp_room(height: int = 32, strength: float = 400.0) -> FloatArray:
    """A soft room with one lamp of a single texel that gives most of the light."""
    room = 0.2 * soft_room(height)
    room[height // 5, int(0.42 * 2 * height)] += strength * np.array([1.0, 0.8, 0.5])
    return room


BASIS = np.array([
    [1.0, 0.8, 0.5, 0.3, 0.2], [0.2, 0.6, 1.0, 0.6, 0.3], [0.1, 0.2, 0.5, 0.9, 1.0],
])  # fmt: skip


def cup(sides: int = 16, inner: float = 0.8, outer: float = 1.0, height: float = 1.2) -> Any:
    """Points and faces of a cup around y, open at the top; its walls and floor are solid."""
    ring = 2 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(ring), np.zeros(sides), -np.sin(ring)], -1)
    up = np.array([0.0, 1.0, 0.0])
    wall = outer - inner
    levels = [(outer, 0.0), (outer, height), (inner, height), (inner, wall)]
    points = np.concatenate([radius * circle + y * up for radius, y in levels])
    points = np.concatenate([points, [[0.0, 0.0, 0.0], [0.0, wall, 0.0]]])
    j = np.arange(sides)
    after = (j + 1) % sides
    faces = []
    for k in range(3):
        low, high = k * sides, (k + 1) * sides
        faces += [
            np.stack([low + j, low + after, high + after], -1),
            np.stack([low + j, high + after, high + j], -1),
        ]
    bottom, floor = len(points) - 2, len(points) - 1
    faces.append(np.stack([np.full(sides, bottom), after, j], -1))
    faces.append(np.stack([np.full(sides, floor), 3 * sides + j, 3 * sides + after], -1))
    return points, np.concatenate(faces)
