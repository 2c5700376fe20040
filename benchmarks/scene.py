"""The scene both renderers are given: a convex body, a room with a key lamp, a camera.

Convex, so that Mitsuba's shadow rays and our unshadowed reflectance map mean the same picture.
The room is grey under D65: then Mitsuba's RGB variants, its spectral variants (whose ``envmap``
turns RGB into spectra of its own) and our uplift describe one and the same light.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks.head import head

FloatArray = NDArray[np.float64]

BANDS_NM = np.arange(400.0, 701.0, 5.0)
FOV_DEG = 32.0
CAMERA_DISTANCE = 3.6
MAP_ROWS = 512
KEY_DIAMETER_DEG = 3.0
KEY_RADIANCE = 900.0
MESH_ROWS = {"5k": 35, "15k": 61, "50k": 112, "150k": 194, "500k": 354}
"""Rows of the grid on a body: 4 rows^2 triangles, such as 50 176 and 501 264."""


OPAQUE = 1.0e6
"""delta [1/m] of a skin that lets nothing through."""


def shape(mesh: str) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """Return points, unit normals and triangles of a mesh by its name.

    ``50k`` is the convex body and ``head 50k`` the head; see ``MESH_ROWS`` for the sizes.
    """
    kind, _, size = mesh.rpartition(" ")
    return head(MESH_ROWS[size]) if kind == "head" else body(MESH_ROWS[size])


def body(rows: int) -> tuple[FloatArray, FloatArray, NDArray[np.int32]]:
    """Return points, unit normals and triangles of a convex superellipsoid.

    |x/a|^p + |y/b|^p + |z/c|^p = 1 with p = 2.5; its normals are the gradient.
    """
    power, size = 2.5, np.array([0.75, 1.0, 0.65])
    polar, azimuth = np.meshgrid(
        np.pi * np.arange(rows + 1) / rows,
        np.pi * np.arange(2 * rows + 1) / rows,
        indexing="ij",
    )
    toward = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.cos(polar), -np.sin(polar) * np.sin(azimuth)], -1
    ).reshape(-1, 3)
    reach = (np.abs(toward / size) ** power).sum(axis=1, keepdims=True) ** (-1.0 / power)
    points = toward * reach
    normals = np.sign(points) * np.abs(points) ** (power - 1.0) / size**power
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    i, j = (index.ravel() for index in np.indices((rows, 2 * rows)))
    a = i * (2 * rows + 1) + j
    b, c, d = a + 2 * rows + 1, a + 2 * rows + 2, a + 1
    faces = np.concatenate([np.stack([a, b, c], -1), np.stack([a, c, d], -1)])
    return points, normals, faces.astype(np.int32)


def environment() -> NDArray[np.float32]:
    """Return radiance over the latlong map, shape [512, 1024]; a quarter is from the lamp."""
    polar, azimuth = np.meshgrid(
        np.pi * (np.arange(MAP_ROWS) + 0.5) / MAP_ROWS,
        np.pi * (np.arange(2 * MAP_ROWS) + 0.5) / MAP_ROWS,
        indexing="ij",
    )
    toward = np.stack(
        [np.sin(polar) * np.sin(azimuth), np.cos(polar), -np.sin(polar) * np.cos(azimuth)], -1
    )
    wall = np.abs(toward).argmax(axis=-1)
    is_positive = np.take_along_axis(toward, wall[..., None], axis=-1)[..., 0] > 0.0
    room = np.array([0.35, 0.5, 0.9, 0.25, 0.6, 0.45])[2 * wall + ~is_positive]
    room = room * (1.0 + 0.3 * np.sin(7.0 * azimuth) * np.sin(polar))
    key = np.array([0.55, 0.5, 0.67])
    key /= np.linalg.norm(key)
    room[toward @ key > np.cos(np.radians(KEY_DIAMETER_DEG / 2.0))] = KEY_RADIANCE
    return room.astype(np.float32)


def reflectance() -> FloatArray:
    """Return a skin-like S on ``BANDS_NM``."""
    nm = BANDS_NM
    rise = 1.0 / (1.0 + np.exp(-(nm - 595.0) / 14.0))
    blood = [((nm - middle) / width) ** 2 for middle, width in ((542, 12), (577, 9), (430, 25))]
    return (
        0.22 + 0.0004 * (nm - 400.0) + 0.22 * rise
        - 0.05 * np.exp(-blood[0]) - 0.06 * np.exp(-blood[1]) - 0.08 * np.exp(-blood[2])
    )  # fmt: skip


def reflectance_rgb() -> FloatArray:
    """Return the linear Rec. 709 colour of S under D65, for RGB renderers, shape [3]."""
    color: FloatArray = lit_rgb(reflectance()) / lit_rgb(np.ones(len(BANDS_NM)))
    return color


def lit_rgb(albedo: FloatArray) -> FloatArray:
    """Return linear Rec. 709 of D65 of the map's 1 times a spectrum on our bands, shape [3]."""
    from usdskin.colorimetry import illuminant, xyz_to_rgb, xyz_weights
    from usdskin.uplift import light_basis

    white = light_basis(illuminant("D65", BANDS_NM), BANDS_NM).sum(axis=0)
    color: FloatArray = (white * albedo) @ xyz_weights(BANDS_NM) @ xyz_to_rgb("lin_rec709_scene").T
    return color


def crop(picture: NDArray) -> NDArray:
    """Return the middle quarter of a picture, where every pixel sees the body."""
    height, width = picture.shape[:2]
    return picture[height // 4 : -(height // 4), width // 4 : -(width // 4)]


def write_stage(
    folder: Path,
    mesh: str,
    wrap: float = 0.0,
    scattering: float = 0.0,
    opacity: float = 0.0,
) -> Path:
    """Write the scene as USD for us.

    Args:
        folder: Where to; the light map is shared by all stages in it.
        mesh: Name of a mesh (``shape``).
        wrap: l of the skin; the comparison with Mitsuba has 0.
        scattering: Ss of the skin; the comparison with Mitsuba has 0.
        opacity: delta of the skin [1/m]; ``OPAQUE`` throws the shadows Mitsuba's bodies throw.
    """
    import usdskin.schemas  # noqa: F401  (registers before the first stage)
    from usdskin.image_output import Part, write_exr

    # isort: split
    from pxr import Gf, Sdf, Usd, UsdGeom, UsdLux, UsdShade, Vt

    light = folder / "room.exr"
    if not light.exists():
        pixels = environment()[..., None].repeat(3, axis=-1)
        write_exr(light, [Part("rgb", {"": pixels}, color_space="lin_rec709_scene")])
    path = folder / f"body-{mesh.replace(' ', '-')}-{wrap:g}-{scattering:g}-{opacity:g}.usdc"
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdGeom.SetStageMetersPerUnit(stage, 1.0)
    points, normals, faces = shape(mesh)
    prim = UsdGeom.Mesh.Define(stage, "/Body")
    prim.CreatePointsAttr(Vt.Vec3fArray.FromNumpy(points.astype(np.float32)))
    prim.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals.astype(np.float32)))
    prim.SetNormalsInterpolation("vertex")
    prim.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(faces.ravel()))
    prim.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(np.full(len(faces), 3, np.int32)))
    prim.CreateSubdivisionSchemeAttr("none")
    skin = UsdShade.Material.Define(stage, "/Skin")
    UsdShade.MaterialBindingAPI.Apply(prim.GetPrim()).Bind(skin)
    skin.GetPrim().ApplyAPI("SkinMaterialAPI")
    skin.GetPrim().GetAttribute("inputs:skin:wrap").Set(wrap)
    skin.GetPrim().GetAttribute("inputs:skin:opacity").Set(opacity)
    for name, values in (
        ("reflectance", reflectance()),
        ("scattering", np.full(len(BANDS_NM), scattering)),
    ):
        skin.GetPrim().ApplyAPI("SpectralDistributionAPI", name)
        skin.GetPrim().GetAttribute(f"spectrum:{name}:quantity").Set(name)
        skin.GetPrim().GetAttribute(f"spectrum:{name}:wavelengths").Set(BANDS_NM.tolist())
        skin.GetPrim().GetAttribute(f"spectrum:{name}:values").Set(values.tolist())
    dome = UsdLux.DomeLight.Define(stage, "/Room")
    dome.CreateTextureFileAttr(Sdf.AssetPath(f"./{light.name}"))
    camera = UsdGeom.Camera.Define(stage, "/Camera")
    camera.AddTranslateOp().Set(Gf.Vec3d(0.0, 0.0, CAMERA_DISTANCE))
    aperture = 2.0 * 50.0 * float(np.tan(np.radians(FOV_DEG / 2.0)))
    camera.CreateFocalLengthAttr(50.0)
    camera.CreateHorizontalApertureAttr(aperture)
    camera.CreateVerticalApertureAttr(aperture)
    camera.CreateClippingRangeAttr(Gf.Vec2f(0.1, 100.0))
    stage.Save()
    return path
