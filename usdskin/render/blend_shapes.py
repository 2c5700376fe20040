"""Move points by blend shapes, inbetween shapes included.

Reads: ``UsdSkelBlendShape`` and the weights of a ``UsdSkelAnimation``, at one moment.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from usdskin.errors import MeshError
from usdskin.layers import describe
from usdskin.render.mesh_topology import FloatArray, IndexArray
from usdskin.render.mesh_values import read_numbers, read_points, read_whole_numbers

# isort: split
# After ours, which register the schemas.
from pxr import Usd, UsdGeom, UsdSkel, Vt

REMEDY = "export the character again, or remove its skel:skeleton"
"""What to do about a broken character."""


def shaped(
    prim: Usd.Prim,
    query: UsdSkel.SkinningQuery,
    skeleton: UsdSkel.SkeletonQuery,
    time: Usd.TimeCode,
) -> tuple[FloatArray, FloatArray | None] | None:
    """Return points, and normals of points, moved by blend shapes; None where there are none."""
    animation = skeleton.GetAnimQuery() if skeleton else None
    if not query.HasBlendShapes() or not animation:
        return None
    weights = animation.ComputeBlendShapeWeights(time)
    if weights is None:
        return None
    if len(weights) != len(animation.GetBlendShapeOrder()):
        raise MeshError(
            f"{describe(animation.GetPrim())}: blendShapeWeights has {len(weights)} values for "
            f"{len(animation.GetBlendShapeOrder())} blendShapes; export the animation again"
        )
    mapper = query.GetBlendShapeMapper()
    if mapper is not None and not mapper.IsIdentity():
        order = query.GetBlendShapeOrder()
        weights = mapper.Remap(weights, Vt.FloatArray(len(order)))
    where = describe(prim)
    shapes = UsdSkel.BlendShapeQuery(UsdSkel.BindingAPI(prim))
    if shapes.GetNumBlendShapes() != len(weights):
        raise MeshError(
            f"{where}: skel:blendShapes names {len(weights)} shapes, but skel:blendShapeTargets "
            f"{shapes.GetNumBlendShapes()}; {REMEDY}"
        )
    if not np.isfinite(np.array(weights)).all():
        raise MeshError(f"{where}: a blend shape's weight is not finite; correct the animation")
    points = read_points(UsdGeom.PointBased(prim).GetPointsAttr(), time)
    element, normals = authored_normals(prim, len(points), time)
    on_points = normals is not None and element is not None and len(normals) == len(points)
    shares, owners, parts = shapes.ComputeSubShapeWeights(weights)
    for share, owner, part in zip(shares, owners, parts, strict=True):
        shape = shapes.GetBlendShape(int(owner))
        if not shape:
            raise MeshError(
                f"{where}: skel:blendShapeTargets[{int(owner)}] names no BlendShape; {REMEDY}"
            )
        inbetween = shapes.GetInbetween(int(part))
        holder = inbetween if inbetween else shape
        rows = _shape_rows(shape, len(points), where)
        name = describe(shape.GetPrim())
        points = _added(points, share, _offsets(holder, "Offsets", shape, rows), rows, name)
        if on_points and normals is not None:
            offsets = _offsets(holder, "NormalOffsets", shape, rows)
            normals = _added(normals, share, offsets, rows, name)
    return points, normals if on_points else None


def _shape_rows(shape: UsdSkel.BlendShape, count: int, where: str) -> IndexArray | None:
    """Return the points that a blend shape moves; None for all."""
    attribute = shape.GetPointIndicesAttr()
    rows = read_whole_numbers(attribute, Usd.TimeCode.Default())
    if not len(rows):
        return None
    if (rows < 0).any() or (rows >= count).any():
        raise MeshError(
            f"{describe(shape.GetPrim())}: pointIndices reach to {rows.max()}, but {where} has "
            f"{count} points; {REMEDY}"
        )
    return rows


def _offsets(
    holder: UsdSkel.BlendShape | UsdSkel.InbetweenShape,
    kind: str,
    shape: UsdSkel.BlendShape,
    rows: IndexArray | None,
) -> FloatArray | None:
    if isinstance(holder, UsdSkel.InbetweenShape):
        value = holder.GetOffsets() if kind == "Offsets" else holder.GetNormalOffsets()
    else:
        attribute = holder.GetOffsetsAttr() if kind == "Offsets" else holder.GetNormalOffsetsAttr()
        value = attribute.Get()
    if value is None or not len(value):
        return None
    offsets = np.array(value, dtype=np.float64)
    if offsets.shape[1:] != (3,) or not np.isfinite(offsets).all():
        raise MeshError(
            f"{describe(shape.GetPrim())}: its offsets are not rows of three finite numbers; "
            f"{REMEDY}"
        )
    if rows is not None and len(offsets) != len(rows):
        raise MeshError(
            f"{describe(shape.GetPrim())}: has {len(offsets)} offsets for {len(rows)} "
            f"pointIndices; {REMEDY}"
        )
    return offsets


def _added(
    values: FloatArray,
    share: float,
    offsets: FloatArray | None,
    rows: IndexArray | None,
    where: str,
) -> FloatArray:
    if offsets is None:
        return values
    if rows is None and len(offsets) != len(values):
        raise MeshError(f"{where}: has {len(offsets)} offsets for {len(values)} points; {REMEDY}")
    result = values.copy()
    target: Sequence[int] | slice | IndexArray = slice(None) if rows is None else rows
    result[target] += float(share) * offsets
    return result


def authored_normals(
    prim: Usd.Prim, point_count: int, time: Usd.TimeCode
) -> tuple[IndexArray | None, FloatArray | None]:
    """Return the point that each authored normal goes with, and the normals.

    The points are None for normals that go with no point.
    """
    primvar = UsdGeom.PrimvarsAPI(prim).GetPrimvar("normals")
    if primvar and primvar.HasValue():
        values = np.array(primvar.ComputeFlattened(time) or (), dtype=np.float64).reshape(-1, 3)
        interpolation = primvar.GetInterpolation()
    else:
        based = UsdGeom.PointBased(prim)
        values = read_numbers(based.GetNormalsAttr(), time, 3)
        interpolation = based.GetNormalsInterpolation()
    if not len(values):
        return None, None
    element = np.arange(point_count)
    if interpolation == UsdGeom.Tokens.faceVarying and prim.IsA(UsdGeom.Mesh):
        element = read_whole_numbers(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr(), time)
    known = (UsdGeom.Tokens.vertex, UsdGeom.Tokens.varying, UsdGeom.Tokens.faceVarying)
    fits = interpolation in known and len(element) == len(values)
    fits = fits and bool((element >= 0).all() and (element < point_count).all())
    return (element if fits else None), values
