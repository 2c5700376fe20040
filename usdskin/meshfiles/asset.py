"""A mesh as a USD asset: a component that stands alone, with its materials.

Writes: ``/<Name>`` (Xform, default prim), ``/<Name>/mesh`` with a GeomSubset for each group, and
        ``/<Name>/materials`` with a ``UsdPreviewSurface`` each, most of them skin too.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from usdskin.errors import UsageError
from usdskin.layers import SettingValue, record_provenance, write_layer
from usdskin.meshfiles.edit import angle_weighted_normals
from usdskin.meshfiles.materials import write_material
from usdskin.meshfiles.meshfile import FileMaterial, MeshFile
from usdskin.notes import Note

# isort: split
# After ours, which register the schemas.
from pxr import Kind, Sdf, Tf, Usd, UsdGeom, UsdShade, Vt

Scheme = Literal["catmullClark", "loop", "none"]
SCHEMES: tuple[Scheme, ...] = ("catmullClark", "loop", "none")

_FAMILIES = {"groups": "group", "objects": "object"}
"""Families of the GeomSubsets that bind nothing."""


@dataclass(frozen=True, slots=True)
class AssetOptions:
    """How a mesh becomes an asset."""

    meters_per_unit: float = 0.01
    """Length of the mesh's unit [m]."""

    up_axis: Literal["Y", "Z"] = "Y"
    """Axis of the mesh that points up."""

    scheme: Scheme | None = None
    """Subdivision; by default catmullClark where most faces have more than 3 corners, else none."""

    name: str | None = None
    """Name of the default prim; by default that of the file to write."""

    skin: tuple[str, ...] | None = None
    """Materials that are skin; by default all."""


def write_asset(
    mesh: MeshFile,
    output: str | Path,
    options: AssetOptions | None = None,
    *,
    notes: list[Note] | None = None,
    settings: Mapping[str, SettingValue] | None = None,
    inputs: Sequence[Path] | None = None,
    step: str = "importMesh",
) -> Path:
    """Write a mesh as a USD asset.

    Points are written as they are; ``metersPerUnit`` and ``upAxis`` say what they mean.

    Args:
        mesh: What to write.
        output: Layer to write.
        options: How.
        notes: Takes what was assumed.
        settings: What the step was told, for the layer's provenance.
        inputs: Files the mesh came from; by default its source and companions.
        step: Who writes it, for the provenance.

    Returns:
        ``output``, once it is complete on disk.

    Raises:
        UsageError: The scheme does not fit the faces, or no material has a name given as skin.
        LayerError: The layer cannot be written.
    """
    output = Path(output)
    options = options if options is not None else AssetOptions()
    notes = notes if notes is not None else []
    stage = Usd.Stage.CreateInMemory(output.name)
    UsdGeom.SetStageMetersPerUnit(stage, options.meters_per_unit)
    UsdGeom.SetStageUpAxis(stage, options.up_axis)
    name = Tf.MakeValidIdentifier(options.name or output.stem)
    root = UsdGeom.Xform.Define(stage, f"/{name}").GetPrim()
    stage.SetDefaultPrim(root)
    Usd.ModelAPI(root).SetKind(Kind.Tokens.component)
    Usd.ModelAPI(root).SetAssetName(name)
    scheme = options.scheme or default_scheme(mesh)
    usd_mesh = _write_mesh(stage, f"/{name}/mesh", mesh, scheme, notes)
    for kind, family in _FAMILIES.items():
        _write_subsets(usd_mesh, getattr(mesh, kind), family)
    _write_materials(stage, f"/{name}/materials", usd_mesh, mesh, output, options.skin, notes)
    record_provenance(
        stage,
        step,
        [mesh.source, *mesh.companions] if inputs is None else inputs,
        {"scheme": scheme, **(settings or {})},
        output.parent,
    )
    return write_layer(stage, output)


def default_scheme(mesh: MeshFile) -> Scheme:
    """Return catmullClark for a mesh of mostly quads and larger polygons, none for triangles."""
    return "catmullClark" if 2 * int((mesh.face_counts > 3).sum()) > mesh.face_count else "none"


def _write_mesh(
    stage: Usd.Stage, path: str, mesh: MeshFile, scheme: Scheme, notes: list[Note]
) -> UsdGeom.Mesh:
    if scheme == "loop" and int(mesh.face_counts.max()) > 3:
        raise UsageError(
            f"{mesh.source}: loop subdivision takes triangles only; choose catmullClark or none"
        )
    usd_mesh = UsdGeom.Mesh.Define(stage, path)
    points = Vt.Vec3fArray.FromNumpy(mesh.points.astype(np.float32))
    usd_mesh.CreatePointsAttr(points)
    usd_mesh.CreateExtentAttr(UsdGeom.PointBased.ComputeExtent(points))
    usd_mesh.CreateFaceVertexCountsAttr(Vt.IntArray.FromNumpy(mesh.face_counts))
    usd_mesh.CreateFaceVertexIndicesAttr(Vt.IntArray.FromNumpy(mesh.face_indices))
    usd_mesh.CreateSubdivisionSchemeAttr(scheme)
    primvars = UsdGeom.PrimvarsAPI(usd_mesh)
    if mesh.st is not None and mesh.st_indices is not None:
        st = primvars.CreatePrimvar(
            "st", Sdf.ValueTypeNames.TexCoord2fArray, UsdGeom.Tokens.faceVarying
        )
        st.Set(Vt.Vec2fArray.FromNumpy(mesh.st.astype(np.float32)))
        st.SetIndices(Vt.IntArray.FromNumpy(mesh.st_indices))
    if mesh.colors is not None:
        colors = primvars.CreatePrimvar(
            "displayColor", Sdf.ValueTypeNames.Color3fArray, UsdGeom.Tokens.vertex
        )
        colors.Set(Vt.Vec3fArray.FromNumpy(mesh.colors))
    if scheme == "none":
        normals, interpolation = _normals(mesh, notes)
        usd_mesh.CreateNormalsAttr(Vt.Vec3fArray.FromNumpy(normals))
        usd_mesh.SetNormalsInterpolation(interpolation)
    return usd_mesh


def _normals(mesh: MeshFile, notes: list[Note]) -> tuple[NDArray[np.float32], str]:
    """Return unit normals and their interpolation: the file's, or smooth ones."""
    if mesh.normals is not None and mesh.normal_indices is not None:
        length = np.linalg.norm(mesh.normals, axis=1, keepdims=True)
        if (length > 0.0).all():
            unit = (mesh.normals / length).astype(np.float32)
            if len(unit) == len(mesh.points) and np.array_equal(
                mesh.normal_indices, mesh.face_indices
            ):
                return unit, UsdGeom.Tokens.vertex
            return unit[mesh.normal_indices], UsdGeom.Tokens.faceVarying
        what = f"{int((length == 0.0).sum())} normals have no length; all are computed anew"
        notes.append(Note("normals-recomputed", str(mesh.source), what))
    return angle_weighted_normals(mesh).astype(np.float32), UsdGeom.Tokens.vertex


def _write_subsets(
    usd_mesh: UsdGeom.Mesh, subsets: Mapping[str, NDArray[np.int32]], family: str
) -> list[UsdGeom.Subset]:
    written = []
    for name, faces in subsets.items():
        subset = UsdGeom.Subset.CreateGeomSubset(
            usd_mesh,
            _free_name(usd_mesh.GetPrim(), name),
            UsdGeom.Tokens.face,
            Vt.IntArray.FromNumpy(faces),
            family,
        )
        _keep_name(subset.GetPrim(), name)
        written.append(subset)
    if written:
        total = np.concatenate(list(subsets.values()))
        once = len(np.unique(total)) == len(total)
        all_of_them = len(total) == len(usd_mesh.GetFaceVertexCountsAttr().Get())
        kind = UsdGeom.Tokens.unrestricted
        if once:
            kind = UsdGeom.Tokens.partition if all_of_them else UsdGeom.Tokens.nonOverlapping
        UsdGeom.Subset.SetFamilyType(usd_mesh, family, kind)
    return written


def _free_name(parent: Usd.Prim, wanted: str) -> str:
    base = name = str(Tf.MakeValidIdentifier(wanted))
    number = 2
    while parent.GetPrimAtPath(name):
        name = f"{base}_{number}"
        number += 1
    return name


def _keep_name(prim: Usd.Prim, name: str) -> None:
    """Keep the file's own name where a prim cannot have it."""
    if prim.GetName() != name:
        prim.SetDisplayName(name)


def _write_materials(
    stage: Usd.Stage,
    path: str,
    usd_mesh: UsdGeom.Mesh,
    mesh: MeshFile,
    output: Path,
    skin: tuple[str, ...] | None,
    notes: list[Note],
) -> None:
    names = list(mesh.materials) or ["skin"]
    unknown = [name for name in skin or () if name not in names]
    if unknown:
        raise UsageError(
            f"{mesh.source}: has no material named {unknown[0]!r}; it has {', '.join(names)}"
        )
    if skin is None and len(names) > 1:
        what = f"all {len(names)} materials are taken for skin: {', '.join(names)}"
        notes.append(Note("all-materials-skin", str(mesh.source), what))
    scope = UsdGeom.Scope.Define(stage, path).GetPrim()
    written: list[UsdShade.Material] = []
    bare = []
    for name in names:
        prim_path = scope.GetPath().AppendChild(_free_name(scope, name))
        material = UsdShade.Material.Define(stage, prim_path)
        _keep_name(material.GetPrim(), name)
        given = mesh.definitions.get(name, FileMaterial())
        is_skin = skin is None or name in skin
        if not write_material(material, given, output, is_skin=is_skin) and is_skin:
            bare.append(name)
        written.append(material)
    if bare:
        what = f"neither color nor texture; white skin: {', '.join(bare)}"
        notes.append(Note("skin-without-reflectance", str(mesh.source), what))
    covered = sum(len(faces) for faces in mesh.materials.values())
    if len(written) == 1 and covered in (0, mesh.face_count):
        _bind(usd_mesh.GetPrim(), written[0])
        return
    subsets = _write_subsets(usd_mesh, mesh.materials, UsdShade.Tokens.materialBind)
    for subset, material in zip(subsets, written, strict=True):
        _bind(subset.GetPrim(), material)
    if covered < mesh.face_count:
        what = f"{mesh.face_count - covered} faces have no material; they get {names[0]}"
        notes.append(Note("faces-without-material", str(mesh.source), what))
        _bind(usd_mesh.GetPrim(), written[0])


def _bind(prim: Usd.Prim, material: UsdShade.Material) -> None:
    UsdShade.MaterialBindingAPI.Apply(prim).Bind(material)
