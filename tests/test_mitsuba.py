"""Our pictures against Mitsuba 3's, of the same body under the same light.

Mitsuba knows nothing of USD: what agrees here is the light's orientation, the camera, the
geometry, the equation and the band averages. How Mitsuba is brought to it: ``mitsuba_peer.py``.
"""

from __future__ import annotations

import importlib.util
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from usdskin.colorimetry import illuminant
from usdskin.images import read_spectral
from usdskin.progress import SilentProgress
from usdskin.render.overrides import RenderOverrides
from usdskin.render.render import render_stage
from usdskin.spectrum import DEFAULT_WAVELENGTHS_NM as NM
from usdskin.spectrum import band_edges

# isort: split
# After ours, which register the schemas.
import OpenEXR
from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

FloatArray = NDArray[np.float64]

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("mitsuba") is None,
    reason="mitsuba is not installed; the extra `test` has it",
)

BOUND = 5.0e-3
"""Per band: DESIGN section 7."""

SIZE = 64
BLOCK = 16
FOV_DEG = 30.0
TABLE_NM = np.arange(380.0, 721.0, 1.0)
"""Both renderers read spectra as straight lines between these; fine, so that no sample is taken
for a band's average."""


# --- The scene ---------------------------------------------------------------------------------


def turn(axis: tuple[float, float, float], angle_deg: float) -> FloatArray:
    """A rotation matrix, column vectors."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    angle = np.radians(angle_deg)
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


def body() -> tuple[FloatArray, NDArray[np.int64]]:
    """A convex body without symmetry in the picture: an ellipsoid, oblique, of flat triangles."""
    rows, columns = 20, 40
    polar, azimuth = np.meshgrid(
        np.pi * np.arange(1, rows) / rows, 2 * np.pi * np.arange(columns) / columns, indexing="ij"
    )
    ring = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.cos(polar), -np.sin(polar) * np.sin(azimuth)], -1
    )
    points = np.concatenate([ring.reshape(-1, 3), [[0, 1, 0], [0, -1, 0]]])
    i, j = (index.ravel() for index in np.indices((rows - 2, columns)))
    a, b = i * columns + j, (i + 1) * columns + j
    c, d = (i + 1) * columns + (j + 1) % columns, i * columns + (j + 1) % columns
    j = np.arange(columns)
    top, bottom, last = len(points) - 2, len(points) - 1, (rows - 2) * columns
    faces = np.concatenate(
        [
            np.stack([a, b, c], -1),
            np.stack([a, c, d], -1),
            np.stack([np.full(columns, top), j, (j + 1) % columns], -1),
            np.stack([np.full(columns, bottom), last + (j + 1) % columns, last + j], -1),
        ]
    )
    shape = turn((1, 2, 3), 40.0) @ np.diag([0.7, 1.0, 0.5])
    return points @ shape.T, faces


def camera(up: str) -> FloatArray:
    """Local to world, column vectors: from a little above, the stage's up axis up."""
    world_up = np.array([0.0, 1.0, 0.0] if up == "Y" else [0.0, 0.0, 1.0])
    origin = np.array([1.2, 0.9, 3.4] if up == "Y" else [1.2, -3.4, 0.9])
    back = origin / np.linalg.norm(origin)
    right = np.cross(world_up, back)
    right /= np.linalg.norm(right)
    return np.block(
        [
            [np.stack([right, np.cross(back, right), back, origin], axis=-1)],
            [np.array([0.0, 0.0, 0.0, 1.0])],
        ]
    )


def light_map() -> FloatArray:
    """Three coefficient channels, none like another or like its mirror image."""
    height = 32
    polar, turns = np.meshgrid(
        np.pi * (np.arange(height) + 0.5) / height,
        (np.arange(2 * height) + 0.5) / (2 * height),
        indexing="ij",
    )
    azimuth = 2.0 * np.pi * turns
    toward = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], -1
    )
    map_ = np.full((height, 2 * height, 3), 0.08)
    for channel, axis in enumerate(([0.8, 0.3, 0.5], [-0.4, 0.8, 0.45], [0.1, -0.7, 0.7])):
        map_[..., channel] += 2.0 * np.maximum(toward @ axis / np.linalg.norm(axis), 0.0) ** 6
    map_[9:11, 12:15] += [30.0, 20.0, 5.0]  # a small lamp
    return map_


def spectra() -> dict[str, FloatArray]:
    """Measured lamps for the light's basis, and skin-like S and Ss."""
    nm = np.arange(380.0, 721.0, 5.0)
    lamps = np.stack(
        [np.interp(TABLE_NM, nm, illuminant(name, nm)) for name in ("FL2", "A", "D65")]
    )
    bumps = [((TABLE_NM - nm) / width) ** 2 for nm, width in ((542, 12), (577, 9), (430, 25))]
    blood = 0.05 * np.exp(-bumps[0]) + 0.06 * np.exp(-bumps[1]) + 0.08 * np.exp(-bumps[2])
    rise = 1.0 / (1.0 + np.exp(-(TABLE_NM - 595.0) / 14.0))
    return {
        "basis": lamps / lamps.max(axis=1, keepdims=True),
        "reflectance": 0.22 + 0.0004 * (TABLE_NM - 400.0) + 0.22 * rise - blood,
        "scattering": 0.25 + 0.6 * rise,
    }


# --- Our half ----------------------------------------------------------------------------------


def ours(
    folder: Path, up: str, dome_to_world: FloatArray, wrap: float, scattering: FloatArray
) -> FloatArray:
    """Write a stage, render it and return its spectra, shape [h, w, bands]."""
    stage = Usd.Stage.CreateNew(str(folder / "shot.usda"))
    UsdGeom.SetStageUpAxis(stage, up)
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    _author_mesh(stage)
    _author_skin(stage, wrap, scattering)
    _author_dome(stage, folder, dome_to_world)
    view = UsdGeom.Camera.Define(stage, "/Camera")
    view.AddTransformOp().Set(Gf.Matrix4d(camera(up).T))
    view.CreateFocalLengthAttr(50.0)
    for attribute in (view.CreateHorizontalApertureAttr(), view.CreateVerticalApertureAttr()):
        attribute.Set(2.0 * 50.0 * np.tan(np.radians(FOV_DEG / 2.0)))
    view.CreateClippingRangeAttr(Gf.Vec2f(0.1, 100.0))
    stage.Save()
    asked = RenderOverrides(
        resolution=(SIZE, SIZE), samples=64, pixel_filter="box", spectral_output=True, png=False
    )
    render_stage(folder / "shot.usda", folder / "shot.exr", asked, SilentProgress())
    return read_spectral(folder / "shot.spectral.exr")[1].astype(np.float64)


def _author_mesh(stage: Usd.Stage) -> None:
    points, faces = body()
    mesh = UsdGeom.Mesh.Define(stage, "/Body")
    mesh.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.astype(np.int32).ravel()))
    mesh.CreateFaceVertexCountsAttr(Vt.IntArray([3] * len(faces)))
    mesh.CreateSubdivisionSchemeAttr("none")
    corner = points[faces]
    normal = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    assert ((normal * corner.mean(axis=1)).sum(axis=1) > 0.0).all(), "the faces turn outward"
    mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normal.repeat(3, axis=0).astype(np.float32)))
    mesh.SetNormalsInterpolation("faceVarying")
    UsdShade.MaterialBindingAPI.Apply(mesh.GetPrim()).Bind(UsdShade.Material.Define(stage, "/Skin"))


def _author_skin(stage: Usd.Stage, wrap: float, scattering: FloatArray) -> None:
    prim = stage.GetPrimAtPath("/Skin")
    prim.ApplyAPI("SkinMaterialAPI")
    prim.GetAttribute("inputs:skin:alpha").Set(0.6)
    prim.GetAttribute("inputs:skin:wrap").Set(wrap)
    for name, values in (("reflectance", spectra()["reflectance"]), ("scattering", scattering)):
        prim.ApplyAPI("SpectralDistributionAPI", name)
        prim.GetAttribute(f"spectrum:{name}:quantity").Set(name)
        prim.GetAttribute(f"spectrum:{name}:wavelengths").Set(TABLE_NM.tolist())
        prim.GetAttribute(f"spectrum:{name}:values").Set(values.tolist())


def _author_dome(stage: Usd.Stage, folder: Path, to_world: FloatArray) -> None:
    channels = {f"c{k}": np.ascontiguousarray(light_map()[..., k], np.float32) for k in range(3)}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(folder / "light.exr"))
    dome = UsdLux.DomeLight.Define(stage, "/Dome")
    transform = np.eye(4)
    transform[:3, :3] = to_world
    dome.AddTransformOp().Set(Gf.Matrix4d(transform.T))
    prim = dome.GetPrim()
    prim.ApplyAPI("SpectralLightAPI")
    prim.GetAttribute("inputs:spectral:source").Set("basis")
    prim.GetAttribute("inputs:spectral:units").Set("absolute")
    prim.GetAttribute("inputs:spectral:coefficients:file").Set(Sdf.AssetPath("./light.exr"))
    prim.GetAttribute("inputs:spectral:basis").Set(spectra()["basis"].ravel().tolist())
    prim.GetAttribute("inputs:spectral:basis:wavelengths").Set(TABLE_NM.tolist())


# --- Mitsuba's half ----------------------------------------------------------------------------


def mitsuba(
    folder: Path,
    kind: str,
    up: str,
    dome_to_world: FloatArray,
    *,
    passes: int,
    samples: int,
    **job: object,
) -> FloatArray:
    """Return Mitsuba's picture, or skip where it has no LLVM that works."""
    points, faces = body()
    variants = ["llvm_ad_rgb", "scalar_rgb"] if kind == "coefficients" else ["llvm_ad_spectral"]
    script = Path(__file__).with_name("mitsuba_peer.py")
    said = ""
    for variant in variants:
        np.savez(
            folder / "job.npz",
            kind=kind,
            variant=variant,
            points=points,
            faces=faces,
            camera=camera(up),
            fov_deg=FOV_DEG,
            size=SIZE,
            passes=passes,
            samples=samples,
            coefficients=light_map(),
            dome_to_world=dome_to_world,
            **job,
        )
        done = subprocess.run(
            [sys.executable, str(script), str(folder / "job.npz"), str(folder / "peer.npz")],
            capture_output=True,
            text=True,
        )
        if done.returncode == 0:
            with np.load(folder / "peer.npz") as found:
                return found["picture"]
        said = done.stderr
        if "LLVM" not in said:
            break
    assert "LLVM" in said, said
    pytest.skip("Mitsuba finds no libLLVM of version 17 or later, which this picture needs")


# --- Comparisons -------------------------------------------------------------------------------


def blocks(picture: FloatArray) -> FloatArray:
    """Means of square blocks, shape [rows, columns, channels]."""
    count = SIZE // BLOCK
    return picture.reshape(count, BLOCK, count, BLOCK, -1).mean(axis=(1, 3))


TURNED = turn((1.0, -2.0, 0.5), 70.0)

STAGES = pytest.mark.parametrize(
    ("up", "dome_to_world"),
    [("Y", np.eye(3)), ("Y", TURNED), ("Z", np.eye(3)), ("Z", TURNED)],
    ids=["Y up", "Y up, turned dome", "Z up", "Z up, turned dome"],
)


@STAGES
def test_a_lambert_body_matches_mitsuba_in_every_block_and_band(
    tmp_path: Path, up: str, dome_to_world: FloatArray
):
    """Orientation, geometry and scale: Mitsuba's own envmap and path tracer, three channels."""
    nothing = np.zeros(len(TABLE_NM))
    found = ours(tmp_path, up, dome_to_world, wrap=0.0, scattering=nothing)
    peer = mitsuba(tmp_path, "coefficients", up, dome_to_world, passes=1, samples=1024)
    band = on_bands(spectra()["basis"])
    albedo = 0.6 * on_bands(spectra()["reflectance"][None])[0]
    expected = (peer @ band) * albedo
    ratio = found.mean(axis=(0, 1)) / expected.mean(axis=(0, 1))
    assert np.abs(ratio - 1.0).max() <= BOUND
    expected = blocks(expected)
    is_lit = expected.max(axis=-1) > 0.1 * expected.max()
    assert is_lit.sum() >= 8
    assert np.abs(blocks(found)[is_lit] / expected[is_lit] - 1.0).max() <= BOUND
    mirrored = blocks(found[:, ::-1])
    difference = np.abs(mirrored[is_lit] / expected[is_lit] - 1.0).max()
    assert difference > 20.0 * BOUND, "the scene could not tell left from right"


def on_bands(values: FloatArray) -> FloatArray:
    """Averages over our bands of curves that are straight between ``TABLE_NM``."""
    edges = band_edges(NM)
    fine = (np.arange(100) + 0.5) / 100
    at = edges[:-1, None] + np.diff(edges)[:, None] * fine
    return np.stack([np.interp(at, TABLE_NM, row).mean(axis=1) for row in values])


@pytest.mark.slow
@pytest.mark.parametrize("wrap", [0.0, 0.3])
def test_skin_matches_mitsuba_band_by_band(tmp_path: Path, wrap: float):
    """Mitsuba multiplies lamps and skin wavelength by wavelength; we multiply band averages."""
    table = spectra()
    scattering = table["scattering"] if wrap else np.zeros(len(TABLE_NM))
    found = ours(tmp_path, "Y", TURNED, wrap, scattering)
    peer = mitsuba(
        tmp_path,
        "skin",
        "Y",
        TURNED,
        passes=6,
        samples=1024,
        wavelength_nm=TABLE_NM,
        basis=table["basis"],
        reflectance=table["reflectance"],
        scattering=scattering,
        wrap=wrap,
        alpha=0.6,
        band_edges_nm=band_edges(NM),
    )
    peer = peer / np.diff(band_edges(NM))
    ratio = found.mean(axis=(0, 1)) / peer.mean(axis=(0, 1))
    assert np.abs(ratio - 1.0).max() <= BOUND
    assert np.abs(ratio.mean() - 1.0) <= 0.1 * BOUND
