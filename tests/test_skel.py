"""Skeletons: what joints, rigid parts and blend shapes make of a shape at one moment."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scenes import codes, mesh_named, paths, read_stage, read_text

from usdskin.errors import MeshError

# isort: split
# After ours, which register the schemas.
from pxr import Gf, Sdf, Usd, UsdGeom, UsdSkel, Vt

ARM = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (2.0, 0.0, 0.0), (2.0, 1.0, 0.0), (1.0, 1.0, 0.0),
       (0.0, 1.0, 0.0)]  # fmt: skip
JOINTS = [(0, 0), (0, 1), (1, 0), (1, 0), (0, 1), (0, 0)]
WEIGHTS = [(1, 0), (0.5, 0.5), (1, 0), (1, 0), (0.25, 0.75), (1, 0)]
ELBOW = (1.0, 0.0, 0.0)
"""Where the second joint is in the bind pose: at the middle of the arm."""


def turn_z(degrees: float) -> np.ndarray:
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


class Arm:
    """Two quads over two joints, of which the second bends about Z: 0 at frame 1, 90 at 3."""

    def __init__(self, folder: Path, method: str | None = None, angle: float = 90.0):
        self.path = folder / "arm.usda"
        self.stage = stage = Usd.Stage.CreateNew(str(self.path))
        UsdGeom.SetStageMetersPerUnit(stage, 1.0)
        UsdGeom.Camera.Define(stage, "/Camera")
        stage.DefinePrim("/Sky", "DomeLight")
        self.root = UsdSkel.Root.Define(stage, "/Body")
        self.skeleton = UsdSkel.Skeleton.Define(stage, "/Body/Bones")
        self.skeleton.CreateJointsAttr(["upper", "upper/lower"])
        at_elbow = Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(*ELBOW))
        self.skeleton.CreateBindTransformsAttr([Gf.Matrix4d(1.0), at_elbow])
        self.skeleton.CreateRestTransformsAttr([Gf.Matrix4d(1.0), at_elbow])
        self.motion = UsdSkel.Animation.Define(stage, "/Body/Motion")
        self.motion.CreateJointsAttr(["upper/lower"])
        self.motion.CreateTranslationsAttr([ELBOW])
        self.motion.CreateScalesAttr([Gf.Vec3h(1, 1, 1)])
        turns = self.motion.CreateRotationsAttr()
        for time, share in ((1, 0.0), (3, 1.0)):
            turn = Gf.Rotation(Gf.Vec3d(0, 0, 1), angle * share).GetQuat()
            turns.Set(Vt.QuatfArray([Gf.Quatf(turn)]), time)
        UsdSkel.BindingAPI.Apply(self.skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(
            ["/Body/Motion"]
        )
        self.mesh = UsdGeom.Mesh.Define(stage, "/Body/Arm")
        self.mesh.CreatePointsAttr(ARM)
        self.mesh.CreateFaceVertexCountsAttr([4, 4])
        self.mesh.CreateFaceVertexIndicesAttr([0, 1, 4, 5, 1, 2, 3, 4])
        self.mesh.CreateSubdivisionSchemeAttr("none")
        self.binding = UsdSkel.BindingAPI.Apply(self.mesh.GetPrim())
        self.binding.CreateSkeletonRel().SetTargets(["/Body/Bones"])
        self.binding.CreateJointIndicesPrimvar(False, 2).Set(np.ravel(JOINTS).tolist())
        self.binding.CreateJointWeightsPrimvar(False, 2).Set(np.ravel(WEIGHTS).tolist())
        if method:
            self.binding.GetPrim().CreateAttribute(
                "primvars:skel:skinningMethod", Sdf.ValueTypeNames.Token
            ).Set(method)

    def read(self, number=None):
        self.stage.GetRootLayer().Save()
        return read_stage(self.path, number)

    def points(self, number=None, path="/Body/Arm") -> np.ndarray:
        scene, notes = self.read(number)
        assert codes(notes) == []
        return mesh_named(scene, path).points


def blended(degrees: float) -> np.ndarray:
    """Return the arm's points by hand: shares of staying, and of turning about the elbow."""
    points, elbow = np.array(ARM), np.array(ELBOW)
    turned = (points - elbow) @ turn_z(degrees).T + elbow
    lower = np.array(
        [
            sum(w for j, w in zip(*pair, strict=True) if j)
            for pair in zip(JOINTS, WEIGHTS, strict=True)
        ]
    )
    return points * (1.0 - lower[:, None]) + turned * lower[:, None]


@pytest.mark.parametrize(("number", "degrees"), [(1, 0.0), (2, 45.0), (3, 90.0)])
def test_an_arm_of_two_joints_bends_as_by_hand(tmp_path, number, degrees):
    np.testing.assert_allclose(Arm(tmp_path).points(number), blended(degrees), atol=1e-6)


def test_dual_quaternions_keep_the_length_at_the_joint(tmp_path):
    """A point half on each joint turns half the angle about the elbow, at its own distance."""
    arm = Arm(tmp_path, "dualQuaternion")
    weights = list(WEIGHTS)
    weights[4] = (0.5, 0.5)
    arm.binding.GetJointWeightsPrimvar().Set(np.ravel(weights).tolist())
    points = arm.points(3)
    half = turn_z(45.0) @ (np.array(ARM[4]) - ELBOW) + ELBOW
    np.testing.assert_allclose(points[4], half, atol=1e-6)
    np.testing.assert_allclose(points[2], blended(90.0)[2], atol=1e-6)


def test_the_pose_is_that_of_usds_own_baking(tmp_path):
    """UsdSkel.BakeSkinning on a copy, with the mesh and the skeleton moved apart."""
    arm = Arm(tmp_path)
    UsdGeom.Xformable(arm.mesh).AddTranslateOp().Set(Gf.Vec3d(3, 1, 2))
    UsdGeom.Xformable(arm.skeleton).AddRotateYOp().Set(30.0)
    bind = Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(0, 0.5, 0))
    arm.binding.CreateGeomBindTransformAttr(bind)
    points = arm.points(3)
    copy = Usd.Stage.Open(arm.stage.Flatten())
    assert UsdSkel.BakeSkinning(Usd.PrimRange(copy.GetPseudoRoot()), Gf.Interval(3, 3))
    mesh = UsdGeom.Mesh(copy.GetPrimAtPath("/Body/Arm"))
    to_world = np.array(mesh.ComputeLocalToWorldTransform(3)).T
    baked = np.array(mesh.GetPointsAttr().Get(3)) @ to_world[:3, :3].T + to_world[:3, 3]
    np.testing.assert_allclose(points, baked, atol=1e-5)


def test_the_stage_is_not_changed(tmp_path):
    arm = Arm(tmp_path)
    arm.points(3)
    before = arm.path.read_bytes()
    arm.read(3)
    assert arm.path.read_bytes() == before


@pytest.mark.parametrize("interpolation", ["vertex", "faceVarying"])
def test_authored_normals_turn_with_the_joints(tmp_path, interpolation):
    arm = Arm(tmp_path)
    arm.binding.GetJointWeightsPrimvar().Set(np.ravel([(1, 0)] * 6).tolist())
    arm.binding.GetJointIndicesPrimvar().Set([1, 0] * 6)
    count = 6 if interpolation == "vertex" else 8
    arm.mesh.CreateNormalsAttr([(1, 0, 0)] * count)
    arm.mesh.SetNormalsInterpolation(interpolation)
    scene, notes = arm.read(3)
    assert codes(notes) == []
    normals = scene.meshes[0].normals.reshape(-1, 3)
    np.testing.assert_allclose(normals, [(0.0, 1.0, 0.0)] * len(normals), atol=1e-6)


def test_normals_that_go_with_no_point_give_way_to_the_faces_own(tmp_path):
    arm = Arm(tmp_path)
    arm.mesh.CreateNormalsAttr([(1, 0, 0)] * 2)
    arm.mesh.SetNormalsInterpolation("uniform")
    scene, notes = arm.read(3)
    assert codes(notes) == ["normals-ignored"]
    assert (scene.meshes[0].normals[..., 2] > 0.9).all()


@pytest.mark.parametrize("kind", ["Mesh", "Cube"])
def test_what_all_joints_move_alike_stays_rigid(tmp_path, kind):
    """Constant influences: the whole shape turns by 90 degrees about the elbow."""
    arm = Arm(tmp_path)
    if kind == "Mesh":
        shape, path = arm.mesh, "/Body/Arm"
        expected = (np.array(ARM) - ELBOW) @ turn_z(90.0).T + ELBOW
    else:
        shape, path = UsdGeom.Cube.Define(arm.stage, "/Body/Box"), "/Body/Box"
        shape.AddTranslateOp().Set(Gf.Vec3d(5, 0, 0))
    binding = UsdSkel.BindingAPI.Apply(shape.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/Body/Bones"])
    binding.GetPrim().RemoveProperty("primvars:skel:jointIndices")
    binding.GetPrim().RemoveProperty("primvars:skel:jointWeights")
    binding.CreateJointIndicesPrimvar(True, 1).Set([1])
    binding.CreateJointWeightsPrimvar(True, 1).Set([1.0])
    if kind == "Cube":
        # The bind transform brings the box to where it is in the skeleton's space.
        binding.CreateGeomBindTransformAttr(Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(5, 0, 0)))
        points = arm.points(3, path)
        np.testing.assert_allclose(points.mean(axis=0), (1.0, 4.0, 0.0), atol=1e-6)
        np.testing.assert_allclose(np.ptp(points, axis=0), (2.0, 2.0, 2.0), atol=1e-6)
    else:
        np.testing.assert_allclose(arm.points(3, path), expected, atol=1e-6)


def test_a_shape_may_count_the_joints_in_its_own_order(tmp_path):
    arm = Arm(tmp_path)
    arm.binding.CreateJointsAttr(["upper/lower", "upper"])
    arm.binding.GetJointIndicesPrimvar().Set((1 - np.ravel(JOINTS)).tolist())
    np.testing.assert_allclose(arm.points(3), blended(90.0), atol=1e-6)


def test_the_binding_may_be_inherited_from_the_root(tmp_path):
    arm = Arm(tmp_path)
    arm.mesh.GetPrim().RemoveProperty("skel:skeleton")
    binding = UsdSkel.BindingAPI.Apply(arm.root.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/Body/Bones"])
    np.testing.assert_allclose(arm.points(3), blended(90.0), atol=1e-6)


def test_a_skeleton_without_animation_stands_in_its_rest_pose(tmp_path):
    arm = Arm(tmp_path)
    arm.skeleton.GetPrim().RemoveProperty("skel:animationSource")
    arm.skeleton.CreateRestTransformsAttr(
        [Gf.Matrix4d(1.0).SetTranslate(Gf.Vec3d(0, 0, 4)), Gf.Matrix4d(1.0).SetTranslate(ELBOW)]
    )
    np.testing.assert_allclose(arm.points(1), np.add(ARM, (0, 0, 4)), atol=1e-6)


# Blend shapes


def add_shape(arm: Arm, weight_samples: dict[float, float], indices=None) -> UsdSkel.BlendShape:
    """Add a shape that lifts points by (0, 0, 2) when full."""
    shape = UsdSkel.BlendShape.Define(arm.stage, "/Body/Arm/Smile")
    rows = range(6) if indices is None else indices
    shape.CreateOffsetsAttr([(0, 0, 2)] * len(rows))
    if indices is not None:
        shape.CreatePointIndicesAttr(indices)
    arm.binding.CreateBlendShapesAttr(["smile"])
    arm.binding.CreateBlendShapeTargetsRel().SetTargets([shape.GetPath()])
    arm.motion.CreateBlendShapesAttr(["frown", "smile"])
    weights = arm.motion.CreateBlendShapeWeightsAttr()
    for time, weight in weight_samples.items():
        weights.Set(Vt.FloatArray([0.7, weight]), time)
    return shape


@pytest.mark.parametrize("indices", [None, [2, 3]], ids=["all points", "some points"])
def test_blend_shapes_lift_points_before_the_joints_turn_them(tmp_path, indices):
    arm = Arm(tmp_path)
    add_shape(arm, {1: 0.0, 3: 1.0}, indices)
    expected = blended(45.0)
    expected[slice(None) if indices is None else indices, 2] += 1.0
    np.testing.assert_allclose(arm.points(2), expected, atol=1e-6)


@pytest.mark.parametrize(
    ("weight", "x"), [(0.25, 1.5), (0.5, 3.0), (0.75, 1.5), (1.0, 0.0), (1.5, -3.0)]
)
def test_inbetween_shapes_are_passed_through(tmp_path, weight, x):
    """At weight 1/2 the inbetween is full: 3 along x; from there to the shape, which has none."""
    arm = Arm(tmp_path, angle=0.0)
    shape = add_shape(arm, {1: weight})
    half = shape.CreateInbetween("half")
    half.SetWeight(0.5)
    half.SetOffsets(Vt.Vec3fArray([(3, 0, 0)] * 6))
    np.testing.assert_allclose(arm.points(1)[:, 0] - np.array(ARM)[:, 0], [x] * 6, atol=1e-5)


def test_normal_offsets_turn_the_normals(tmp_path):
    arm = Arm(tmp_path, angle=0.0)
    shape = add_shape(arm, {1: 1.0})
    shape.CreateNormalOffsetsAttr([(1, 0, -1)] * 6)
    arm.mesh.CreateNormalsAttr([(0, 0, 1)] * 6)
    arm.mesh.SetNormalsInterpolation("vertex")
    scene, _ = arm.read(1)
    normals = scene.meshes[0].normals.reshape(-1, 3)
    np.testing.assert_allclose(normals, [(1, 0, 0)] * len(normals), atol=1e-6)


def test_shapes_alone_need_no_joint_influences(tmp_path):
    arm = Arm(tmp_path)
    add_shape(arm, {1: 0.5})
    arm.mesh.GetPrim().RemoveProperty("primvars:skel:jointIndices")
    arm.mesh.GetPrim().RemoveProperty("primvars:skel:jointWeights")
    np.testing.assert_allclose(arm.points(1), np.add(ARM, (0, 0, 1)), atol=1e-6)


# Instances


def test_characters_in_instances_and_prototypes_are_posed(tmp_path):
    arm = Arm(tmp_path)
    stage = arm.stage
    for name, y in (("A", 10.0), ("B", 20.0)):
        copy = stage.DefinePrim(f"/{name}", "SkelRoot")
        copy.GetReferences().AddInternalReference("/Body")
        copy.SetInstanceable(True)
        UsdGeom.Xformable(copy).AddTranslateOp().Set(Gf.Vec3d(0, y, 0))
    crowd = UsdGeom.PointInstancer.Define(stage, "/Crowd")
    crowd.CreatePrototypesRel().SetTargets(["/Body"])
    crowd.CreateProtoIndicesAttr([0])
    crowd.CreatePositionsAttr([(0, 30, 0)])
    scene, _ = arm.read(3)
    assert paths(scene) == ["/Body/Arm", "/A/Arm", "/B/Arm", "/Crowd[0]/Body/Arm"]
    for k, mesh in enumerate(scene.meshes):
        np.testing.assert_allclose(mesh.points, np.add(blended(90.0), (0, 10.0 * k, 0)), atol=1e-5)


# Refusals


def _no_skeleton(arm):
    arm.binding.GetSkeletonRel().SetTargets(["/Body/Nobody"])


def _far_joint(arm):
    arm.binding.GetJointIndicesPrimvar().Set([9] * 12)


def _few_weights(arm):
    arm.binding.GetJointWeightsPrimvar().Set([1.0] * 6)


def _few_both(arm):
    arm.binding.GetJointIndicesPrimvar().Set([0] * 6)
    arm.binding.GetJointWeightsPrimvar().Set([1.0] * 6)


def _nan_weights(arm):
    arm.binding.GetJointWeightsPrimvar().Set([float("nan")] * 12)


def _few_binds(arm):
    arm.skeleton.GetBindTransformsAttr().Set([Gf.Matrix4d(1.0)])


def _no_binds(arm):
    arm.skeleton.GetPrim().RemoveProperty("bindTransforms")


def _no_rest(arm):
    arm.skeleton.GetPrim().RemoveProperty("restTransforms")


def _no_api(arm):
    arm.mesh.GetPrim().RemoveAPI(UsdSkel.BindingAPI)


def _bad_shape_index(arm):
    add_shape(arm, {1: 0.5}, [2, 77])


def _few_offsets(arm):
    add_shape(arm, {1: 0.5}).GetOffsetsAttr().Set([(0, 0, 1)])


def _few_turns(arm):
    arm.motion.GetTranslationsAttr().Set([(0, 0, 0)] * 3)


def _few_shares(arm):
    add_shape(arm, {1: 0.5})
    arm.motion.GetBlendShapeWeightsAttr().Set(Vt.FloatArray([0.5]), 1)


def _no_shape(arm):
    add_shape(arm, {1: 0.5})
    arm.binding.GetBlendShapeTargetsRel().SetTargets(["/Body/Nothing"])


def _nan_offsets(arm):
    add_shape(arm, {1: 0.5}).GetOffsetsAttr().Set([(float("nan"), 0, 0)] * 6)


def _singular_bind(arm):
    arm.skeleton.CreateBindTransformsAttr([Gf.Matrix4d(0.0)] * 2)


def _unknown_method(arm):
    arm.mesh.GetPrim().CreateAttribute(
        "primvars:skel:skinningMethod", Sdf.ValueTypeNames.Token
    ).Set("wobbly")


def _far_face(arm):
    arm.mesh.GetFaceVertexIndicesAttr().Set([0, 1, 4, 5, 1, 2, 3, 99])
    arm.mesh.CreateNormalsAttr([(1, 0, 0)] * 8)
    arm.mesh.SetNormalsInterpolation("faceVarying")


def _nan_pose(arm):
    arm.motion.GetTranslationsAttr().Set([(float("nan"), 0, 0)])


def _same_joint(arm):
    arm.skeleton.GetJointsAttr().Set(["upper", "upper"])


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (_no_skeleton, "</Body/Arm>: is bound to joints, but skel:skeleton names no Skeleton"),
        (_far_joint, "skel:jointIndices[0] is 9, but there are 2 joints"),
        (_few_weights, "</Body/Arm>"),
        (_few_both, "skel:jointIndices has 6 values, but 6 x 2 are needed"),
        (_nan_weights, "skel:jointWeights are not all finite"),
        (_few_binds, "</Body/Bones>: bindTransforms must have a matrix for each of the 2 joints"),
        (_no_binds, "</Body/Bones>: bindTransforms must have a matrix"),
        (_no_rest, "</Body/Bones>: restTransforms must have a matrix"),
        (_no_api, "</Body/Arm>: has joints but not SkelBindingAPI"),
        (_bad_shape_index, "</Body/Arm/Smile>: pointIndices reach to 77"),
        (_few_offsets, "has 1 offsets for 6 points"),
        (_few_turns, "</Body/Motion>: translations, rotations and scales must each have 1 values"),
        (_few_shares, "</Body/Motion>: blendShapeWeights has 1 values for 2 blendShapes"),
        (_no_shape, "skel:blendShapeTargets[0] names no BlendShape"),
        (_nan_offsets, "</Body/Arm/Smile>: its offsets are not rows of three finite numbers"),
        (_singular_bind, "</Body/Arm>: posed points are not finite"),
        (_unknown_method, "skel:skinningMethod is 'wobbly'; use classicLinear or dualQuaternion"),
        (_far_face, "faceVertexIndices[7] names point 99"),
        (_nan_pose, "a joint's transform is not finite"),
        (_same_joint, "</Body/Bones>: joints must name every joint once"),
    ],
    ids=lambda value: value.__name__.strip("_") if callable(value) else "",
)
def test_a_broken_character_is_refused_in_one_line(tmp_path, change, says):
    arm = Arm(tmp_path)
    change(arm)
    with pytest.raises(MeshError) as caught:
        arm.read(1)
    assert says in str(caught.value) and "\n" not in str(caught.value)


def test_joints_outside_a_skel_root_are_noted_and_shown_as_authored(tmp_path):
    from scenes import triangle

    text = triangle(
        "Alone", "int[] primvars:skel:jointIndices = [0, 0, 0] (", 'interpolation = "vertex")'
    )
    scene, notes = read_text(tmp_path, text)
    assert codes(notes) == ["skinning-ignored"]
    np.testing.assert_allclose(scene.meshes[0].points[1], (1, 0, 0))
