"""Pose what is bound to a skeleton: joints, rigid parts and blend shapes.

Reads: ``UsdSkelRoot``, ``UsdSkelBindingAPI`` and ``UsdSkelAnimation``, at one moment. The sums over
joints are USD's own (``UsdSkel.SkinPoints``: linear blending and dual quaternions); nothing is
written to the stage, so that instances are posed like any other prim.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from usdskin.errors import MeshError
from usdskin.layers import describe
from usdskin.notes import Note
from usdskin.render.blend_shapes import REMEDY, authored_normals, shaped
from usdskin.render.mesh_topology import FloatArray, IndexArray
from usdskin.render.mesh_values import read_numbers, read_points, read_whole_numbers

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

_METHODS = ("classicLinear", "dualQuaternion")
_PREDICATE = Usd.TraverseInstanceProxies(Usd.PrimIsActive & Usd.PrimIsLoaded)


@dataclass(frozen=True, slots=True, eq=False)
class Pose:
    """What a skeleton makes of a shape, in the shape's own space."""

    points: FloatArray | None = None
    """Points in place of the authored ones, shape [point_count, 3]; None where they stay."""

    normals: FloatArray | None = None
    """Normals in place of the authored ones, in the same interpolation, shape [n, 3]."""

    transform: FloatArray | None = None
    """Moves the shape as a whole before its own transform, column vectors, shape [4, 4]."""

    drops_normals: bool = False
    """Whether the authored normals fit the shape no more."""


@dataclass(frozen=True, slots=True, eq=False)
class _Bones:
    """A skeleton as a shape is bound to it."""

    prim: Usd.Prim
    """The skeleton, in an instance its own and not the one that instances share."""

    query: UsdSkel.SkeletonQuery


@dataclass(frozen=True, slots=True, eq=False)
class _Influences:
    """Which joints move each element, and how much."""

    method: str
    bind: Gf.Matrix4d
    joints: Vt.Matrix4dArray
    """From the bind pose to the posed skeleton's space."""

    indices: IndexArray
    """Joints, shape [element_count, width]; one row where the shape moves as a whole."""

    weights: FloatArray
    """Share of each joint [1], shape [element_count, width]."""

    to_shape: FloatArray
    """From the skeleton's space to the shape's, column vectors, shape [4, 4]."""


@dataclass(frozen=True, slots=True)
class PoseReader:
    """Poses the shapes of a stage at one moment."""

    time: Usd.TimeCode
    cache: UsdGeom.XformCache
    notes: list[Note]
    _skeletons: UsdSkel.Cache = field(default_factory=UsdSkel.Cache)
    _bound: dict[str, _Bones] = field(default_factory=dict)
    _roots: set[str] = field(default_factory=set)

    def of(self, prim: Usd.Prim) -> Pose | None:
        """Return the pose of a mesh or shape; None where no skeleton moves it.

        Raises:
            MeshError: The binding, the skeleton, the animation or a blend shape cannot be used.
        """
        root = _skel_root(prim)
        if root is None:
            if prim.GetAttribute("primvars:skel:jointIndices").HasAuthoredValue():
                what = "it is bound to joints but is in no SkelRoot; shown as authored"
                self.notes.append(Note("skinning-ignored", str(prim.GetPath()), what))
            return None
        self._populate(root)
        bones = self._bound.get(str(prim.GetPath()))
        if bones is None:
            _refuse_half_bound(prim)
            return None
        query = self._skeletons.GetSkinningQuery(prim)
        points = normals = None
        if prim.IsA(UsdGeom.PointBased):
            found = shaped(prim, query, bones.query, self.time)
            if found is not None:
                points, normals = found
        influences = self._influences(prim, query, bones)
        if influences is None:
            return None if points is None else Pose(points, normals)
        if query.IsRigidlyDeformed() or not prim.IsA(UsdGeom.PointBased):
            return Pose(points, normals, _rigid(influences))
        return self._skinned(prim, influences, points, normals)

    def _populate(self, root: UsdSkel.Root) -> None:
        path = str(root.GetPath())
        if path in self._roots:
            return
        self._roots.add(path)
        self._skeletons.Populate(root, _PREDICATE)
        for binding in self._skeletons.ComputeSkelBindings(root, _PREDICATE):
            skeleton = binding.GetSkeleton()
            bones = _Bones(skeleton.GetPrim(), self._skeletons.GetSkelQuery(skeleton))
            for target in binding.GetSkinningTargets():
                self._bound[str(target.GetPrim().GetPath())] = bones

    def _influences(
        self, prim: Usd.Prim, query: UsdSkel.SkinningQuery, bones: _Bones
    ) -> _Influences | None:
        if not query.HasJointInfluences():
            _refuse_half_bound(prim)
            return None
        where = describe(prim)
        joints = _mapped(query, _joint_transforms(bones, self.time))
        if not np.isfinite(np.array(joints)).all():
            raise MeshError(f"{where}: a joint's transform is not finite; correct the animation")
        width = max(int(query.GetNumInfluencesPerComponent()), 1)
        indices = read_whole_numbers(query.GetJointIndicesPrimvar().GetAttr(), self.time)
        weights = read_numbers(query.GetJointWeightsPrimvar().GetAttr(), self.time, 1).reshape(-1)
        rigid = query.IsRigidlyDeformed()
        count = 1 if rigid or not prim.IsA(UsdGeom.PointBased) else self._point_count(prim)
        for name, found in (("jointIndices", len(indices)), ("jointWeights", len(weights))):
            if found != count * width:
                raise MeshError(
                    f"{where}: skel:{name} has {found} values, but {count} x {width} are needed; "
                    f"{REMEDY}"
                )
        wrong = (indices < 0) | (indices >= len(joints))
        if wrong.any():
            at = int(np.argmax(wrong))
            raise MeshError(
                f"{where}: skel:jointIndices[{at}] is {indices[at]}, but there are {len(joints)} "
                f"joints; {REMEDY}"
            )
        if not np.isfinite(weights).all():
            raise MeshError(f"{where}: skel:jointWeights are not all finite; {REMEDY}")
        to_world = self.cache.GetLocalToWorldTransform(prim)
        if abs(to_world.GetDeterminant()) == 0.0:
            raise MeshError(f"{where}: its transform is singular; give it a scale that is not 0")
        space = self.cache.GetLocalToWorldTransform(bones.prim) * to_world.GetInverse()
        method = str(query.GetSkinningMethod() or UsdSkel.Tokens.classicLinear)
        if method not in _METHODS:
            raise MeshError(
                f"{where}: skel:skinningMethod is '{method}'; use {' or '.join(_METHODS)}"
            )
        return _Influences(
            method,
            query.GetGeomBindTransform(self.time),
            joints,
            indices.reshape(count, width),
            weights.reshape(count, width),
            np.array(space).T,
        )

    def _point_count(self, prim: Usd.Prim) -> int:
        return len(read_points(UsdGeom.PointBased(prim).GetPointsAttr(), self.time))

    def _skinned(
        self,
        prim: Usd.Prim,
        influences: _Influences,
        points: FloatArray | None,
        normals: FloatArray | None,
    ) -> Pose:
        based = UsdGeom.PointBased(prim)
        if points is None:
            points = read_points(based.GetPointsAttr(), self.time)
        moved = Vt.Vec3fArray.FromNumpy(points.astype(np.float32))
        _require(
            UsdSkel.SkinPoints(
                influences.method,
                influences.bind,
                influences.joints,
                Vt.IntArray.FromNumpy(influences.indices.astype(np.int32).reshape(-1)),
                Vt.FloatArray.FromNumpy(influences.weights.astype(np.float32).reshape(-1)),
                influences.indices.shape[1],
                moved,
            ),
            prim,
        )
        if not np.isfinite(np.array(moved)).all():
            raise MeshError(
                f"{describe(prim)}: posed points are not finite; correct skel:geomBindTransform "
                "or the skeleton's bindTransforms, which must not be singular"
            )
        frame = influences.to_shape
        posed = np.array(moved, dtype=np.float64) @ frame[:3, :3].T + frame[:3, 3]
        element, authored = authored_normals(prim, len(points), self.time)
        if authored is None or element is None:
            return Pose(posed, drops_normals=authored is not None)
        if normals is not None and len(normals) == len(authored):
            authored = normals
        return Pose(posed, _turned(influences, element, authored, prim))


def _skel_root(prim: Usd.Prim) -> UsdSkel.Root | None:
    while prim and not prim.IsPseudoRoot():
        if prim.IsA(UsdSkel.Root):
            return UsdSkel.Root(prim)
        prim = prim.GetParent()
    return None


def _refuse_half_bound(prim: Usd.Prim) -> None:
    """Refuse a shape with joints that no skeleton can be found or used for."""
    if not prim.GetAttribute("primvars:skel:jointIndices").HasAuthoredValue():
        return
    binding = UsdSkel.BindingAPI(prim)
    where = describe(prim)
    if not prim.HasAPI(UsdSkel.BindingAPI):
        raise MeshError(f"{where}: has joints but not SkelBindingAPI; apply the API")
    skeleton = binding.GetInheritedSkeleton()
    if not skeleton:
        raise MeshError(
            f"{where}: is bound to joints, but skel:skeleton names no Skeleton; {REMEDY}"
        )
    raise MeshError(
        f"{where}: its joint indices, weights or skeleton <{skeleton.GetPath()}> cannot be used "
        f"together: both primvars need the same interpolation and elementSize; {REMEDY}"
    )


def _joint_transforms(bones: _Bones, time: Usd.TimeCode) -> Vt.Matrix4dArray:
    """Return what moves each joint from the bind pose, in the skeleton's space."""
    skeleton = bones.query
    where = describe(bones.prim)
    if not skeleton:
        raise MeshError(f"{where}: its joints form no tree; {REMEDY}")
    joints = [str(joint) for joint in skeleton.GetJointOrder()]
    if not joints or len(set(joints)) < len(joints):
        raise MeshError(f"{where}: joints must name every joint once; {REMEDY}")
    animation = skeleton.GetAnimQuery()
    moved = {str(joint) for joint in animation.GetJointOrder()} if animation else set()
    lacks = [] if skeleton.HasBindPose() else ["bindTransforms"]
    if not skeleton.HasRestPose() and not moved.issuperset(joints):
        lacks.append("restTransforms")
    if lacks:
        raise MeshError(
            f"{where}: {' and '.join(lacks)} must have a matrix for each of the {len(joints)} "
            f"joints; {REMEDY}"
        )
    if moved and len(animation.ComputeJointLocalTransforms(time) or ()) != len(moved):
        raise MeshError(
            f"{describe(animation.GetPrim())}: translations, rotations and scales must each have "
            f"{len(moved)} values, one for each of its joints; export the animation again"
        )
    transforms = skeleton.ComputeSkinningTransforms(time)
    if not transforms or len(transforms) != len(joints):
        raise MeshError(f"{where}: USD cannot pose it; {REMEDY}")
    return transforms


def _mapped(query: UsdSkel.SkinningQuery, transforms: Vt.Matrix4dArray) -> Vt.Matrix4dArray:
    """Return transforms in the order in which a shape counts the joints."""
    mapper = query.GetJointMapper()
    if mapper is None or mapper.IsNull() or mapper.IsIdentity():
        return transforms
    blank = Vt.Matrix4dArray(len(query.GetJointOrder()), Gf.Matrix4d(1.0))
    return mapper.RemapTransforms(transforms, blank)


def _rigid(influences: _Influences) -> FloatArray:
    """Return the transform of a shape that moves as a whole."""
    matrix = UsdSkel.SkinTransform(
        influences.method,
        influences.bind,
        influences.joints,
        Vt.IntArray.FromNumpy(influences.indices.astype(np.int32).reshape(-1)),
        Vt.FloatArray.FromNumpy(influences.weights.astype(np.float32).reshape(-1)),
    )
    return influences.to_shape @ np.array(matrix, dtype=np.float64).T


def _turned(
    influences: _Influences, element: IndexArray, normals: FloatArray, prim: Usd.Prim
) -> FloatArray:
    """Return normals that the joints turned, in the shape's space."""
    moved = Vt.Vec3fArray.FromNumpy(normals.astype(np.float32))
    _require(
        UsdSkel.SkinNormals(
            influences.method,
            _normal_matrix(influences.bind),
            Vt.Matrix3dArray([_normal_matrix(joint) for joint in influences.joints]),
            Vt.IntArray.FromNumpy(influences.indices[element].astype(np.int32).reshape(-1)),
            Vt.FloatArray.FromNumpy(influences.weights[element].astype(np.float32).reshape(-1)),
            influences.indices.shape[1],
            moved,
        ),
        prim,
    )
    return np.array(moved, dtype=np.float64) @ np.linalg.inv(influences.to_shape[:3, :3])


def _normal_matrix(matrix: Gf.Matrix4d) -> Gf.Matrix3d:
    """Return what turns normals: the inverse transpose; the identity for a flattened joint."""
    linear = Gf.Matrix3d(*(matrix[row][column] for row in range(3) for column in range(3)))
    if linear.GetDeterminant() == 0.0:
        return Gf.Matrix3d(1.0)
    return linear.GetInverse().GetTranspose()


def _require(worked: object, prim: Usd.Prim) -> None:
    if worked is False:
        raise MeshError(f"{describe(prim)}: USD cannot skin it; {REMEDY}")
