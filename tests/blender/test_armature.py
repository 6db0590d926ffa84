"""Armatures in Blender: reading the deforming skeleton and its poses, and keying motion onto it."""

from __future__ import annotations

from collections.abc import Iterator
from math import radians

import numpy as np
import pytest
from skeletons import CONVENTIONS, human
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.rig import Pose, Rig, joint_angles, pose_of_angles

bpy = pytest.importorskip("bpy")

from armatures import armature_of, evaluated  # noqa: E402
from wrinkle_synthesis.wrinkle_addon.blender.armature import (  # noqa: E402
    PoseReader,
    apply_motion,
    read_pose,
    read_rig,
    rig_scale,
)

# Blender keeps bones in single precision, at about two metres from the origin.
SINGLE = 2e-6


@pytest.fixture(autouse=True)
def empty_file() -> Iterator[None]:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    yield
    bpy.ops.wm.read_factory_settings(use_empty=True)


def some_poses(rig: Rig, count: int = 5) -> list[Pose]:
    joints = find_joints(rig).found
    rng = np.random.default_rng(2)
    angles = [{joint.name: rng.uniform(-0.7, 0.7, joint.dof) for joint in joints} for _ in range(count)]
    poses = []
    for i, each in enumerate(angles):
        root = np.eye(4)
        root[:3, 3] = [0.1 * i, -0.2 * i, 0.05]
        poses.append(Pose(root @ pose_of_angles(rig, joints, each).matrices))
    return poses


# --- reading the rig ------------------------------------------------------------------------------------------------


def test_a_rig_is_read_as_it_was_built() -> None:
    body = human(CONVENTIONS["Unreal"])
    rig = read_rig(armature_of(body))
    rows = [rig.index[name] for name in body.names]
    np.testing.assert_allclose(rig.heads[rows], body.heads, atol=SINGLE)
    np.testing.assert_allclose(rig.tails[rows], body.tails, atol=SINGLE)
    parents = {name: rig.names[rig.parents[rig.index[name]]] for name in body.names[1:]}
    assert parents == {name: body.names[body.parents[body.index[name]]] for name in body.names[1:]}
    np.testing.assert_allclose(rig.gravity, [0, 0, -1], atol=SINGLE)


def test_object_scale_and_scene_units_are_folded_in() -> None:
    body = human()
    armature = armature_of(body)
    armature.scale = (0.1, 0.1, 0.1)
    bpy.context.scene.unit_settings.scale_length = 0.01
    bpy.context.view_layer.update()
    rig = read_rig(armature)
    assert rig_scale(armature) == pytest.approx(1e-3, rel=1e-6)
    np.testing.assert_allclose(rig.heads[rig.index["head"]], 1e-3 * body.heads[body.index["head"]], atol=1e-8)
    np.testing.assert_allclose(read_pose(evaluated(armature), rig).matrices, rig.rest, atol=1e-8)


def test_a_turned_object_turns_gravity_not_the_rig() -> None:
    body = human()
    armature = armature_of(body)
    armature.rotation_euler, armature.location = (radians(90), 0, 0), (1, 2, 3)
    bpy.context.view_layer.update()
    rig = read_rig(armature)
    np.testing.assert_allclose(rig.gravity, [0, -1, 0], atol=SINGLE)
    np.testing.assert_allclose(rig.heads[0], body.heads[0], atol=SINGLE)


@pytest.mark.parametrize("scale", [(1, 1, 2), (-1, 1, 1), (-1, -1, -1), (0, 0, 0)])
def test_uneven_or_mirrored_scale_is_refused(scale: tuple[float, float, float]) -> None:
    armature = armature_of(human())
    armature.scale = scale
    bpy.context.view_layer.update()
    with pytest.raises(ValueError, match=r"Figure is scaled unevenly or mirrored .* apply its scale\."):
        read_rig(armature)


def test_an_armature_without_deforming_bones_is_refused() -> None:
    armature = armature_of(human())
    for bone in armature.data.bones:
        bone.use_deform = False
    with pytest.raises(ValueError, match="has no deforming bones"):
        read_rig(armature)


def test_controls_between_deforming_bones_are_passed_over() -> None:
    armature = armature_of(human())
    for name in ("clavicle_L", "spine2"):
        armature.data.bones[name].use_deform = False
    rig = read_rig(armature)
    assert "clavicle_L" not in rig.index
    assert rig.names[rig.parents[rig.index["upperarm_L"]]] == "chest"
    assert rig.names[rig.parents[rig.index["chest"]]] == "spine1"


# --- Rigify ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def rigify() -> Iterator[bpy.types.Object]:
    """A generated Rigify rig."""
    import addon_utils

    handlers = list(bpy.app.handlers.load_post)
    if addon_utils.enable("rigify", default_set=True) is None:
        pytest.skip("Rigify does not come with this Blender.")
    bpy.ops.object.armature_human_metarig_add()
    metarig = bpy.context.object
    bpy.ops.pose.rigify_generate()
    yield next(ob for ob in bpy.data.objects if ob.type == "ARMATURE" and ob != metarig)
    addon_utils.disable("rigify", default_set=True)
    # Rigify of Blender 5.2 leaves one behind, which then complains of every file.
    bpy.app.handlers.load_post[:] = handlers


def test_a_generated_rigify_rig_gets_its_true_limbs(rigify: bpy.types.Object) -> None:
    rig = read_rig(rigify)
    assert all(name.startswith("DEF-") for name in rig.names)
    parent = {name: rig.names[above] if above >= 0 else "" for name, above in zip(rig.names, rig.parents, strict=True)}
    assert parent["DEF-thigh.L"] == "DEF-spine" and parent["DEF-upper_arm.R"] == "DEF-shoulder.R"
    assert parent["DEF-shoulder.L"] == "DEF-spine.003" and parent["DEF-forearm.L"] == "DEF-upper_arm.L.001"
    joints = find_joints(rig).joints
    assert joints["spine"].bones == ("DEF-spine.001", "DEF-spine.002", "DEF-spine.003")
    assert joints["spine"].near == "DEF-spine"
    assert joints["shoulder_L"].bones == ("DEF-shoulder.L", "DEF-upper_arm.L")
    assert joints["knee_R"].bones == ("DEF-shin.R",) and joints["knee_R"].near == "DEF-thigh.R.001"


def test_motion_plays_on_a_generated_rigify_rig(rigify: bpy.types.Object) -> None:
    rig = read_rig(rigify)
    poses = some_poses(rig, 2)
    notes = apply_motion(rigify, rig, poses)
    assert any("constraints" in note for note in notes)
    reader = PoseReader(rigify, rig)
    for frame, pose in enumerate(poses, start=1):
        bpy.context.scene.frame_set(frame)
        np.testing.assert_allclose(reader.read(evaluated(rigify)).matrices, pose.matrices, atol=2e-5)


# --- poses and motion -------------------------------------------------------------------------------------------------


def test_a_posed_joint_is_read_back() -> None:
    armature = armature_of(human())
    rig = read_rig(armature)
    bone = armature.pose.bones["shin_L"]
    bone.rotation_mode = "XYZ"
    bone.rotation_euler = (radians(30), 0, 0)
    bpy.context.view_layer.update()
    pose = read_pose(evaluated(armature), rig)
    expected = np.array(evaluated(armature).pose.bones["foot_L"].matrix)
    np.testing.assert_allclose(pose.matrices[rig.index["foot_L"]], expected, atol=1e-7)
    angle = joint_angles(rig, find_joints(rig).found, pose)["knee_L"][0]
    assert abs(abs(np.degrees(angle)) - 30) < 2


@pytest.mark.parametrize("connect", [False, True])
@pytest.mark.parametrize("euler", [False, True])
def test_keyed_motion_is_read_back(connect: bool, euler: bool) -> None:
    armature = armature_of(human(CONVENTIONS["Mixamo"]), connect)
    armature.scale = (0.5, 0.5, 0.5)
    armature.rotation_euler = (0.3, 0.2, 0.1)
    bpy.context.view_layer.update()
    if euler:
        for bone in armature.pose.bones:
            bone.rotation_mode = "ZXY"
    rig = read_rig(armature)
    poses = some_poses(rig)
    assert apply_motion(armature, rig, poses, name="Dance", start=11) == []
    assert armature.animation_data.action.name == "Dance"
    reader = PoseReader(armature, rig)
    for frame, pose in enumerate(poses, start=11):
        bpy.context.scene.frame_set(frame)
        np.testing.assert_allclose(reader.read(evaluated(armature)).matrices, pose.matrices, atol=2e-5)


def test_what_would_fight_the_keys_is_silenced_and_said() -> None:
    armature = armature_of(human())
    rig = read_rig(armature)
    ik = armature.pose.bones["shin_L"].constraints.new("IK")
    armature.pose.bones["head"].driver_add("rotation_quaternion", 1).driver.expression = "0.5"
    armature.animation_data.action = bpy.data.actions.new("Old")
    armature.animation_data.nla_tracks.new()
    armature.data.pose_position = "REST"
    poses = some_poses(rig, 1)
    notes = apply_motion(armature, rig, poses)
    assert ik.mute
    for word in ("1 constraints", "1 drivers", "1 NLA", "action Old", "rest position"):
        assert any(word in note for note in notes), word
    bpy.context.scene.frame_set(1)
    np.testing.assert_allclose(read_pose(evaluated(armature), rig).matrices, poses[0].matrices, atol=2e-5)


def test_unkeyed_leftovers_of_an_earlier_pose_are_cleared() -> None:
    armature = armature_of(human())
    rig = read_rig(armature)
    armature.pose.bones["head"].rotation_quaternion = (0.8, 0.6, 0, 0)
    armature.pose.bones["toe_R"].scale = (2, 2, 2)
    apply_motion(armature, rig, [Pose(rig.rest)])
    bpy.context.scene.frame_set(1)
    np.testing.assert_allclose(read_pose(evaluated(armature), rig).matrices, rig.rest, atol=SINGLE)


def test_bones_that_do_not_inherit_rotation_are_keyed_right() -> None:
    armature = armature_of(human())
    armature.data.bones["head"].use_inherit_rotation = False
    armature.data.bones["forearm_L"].use_local_location = False
    rig = read_rig(armature)
    poses = some_poses(rig, 3)
    apply_motion(armature, rig, poses)
    for frame, pose in enumerate(poses, start=1):
        bpy.context.scene.frame_set(frame)
        np.testing.assert_allclose(read_pose(evaluated(armature), rig).matrices, pose.matrices, atol=2e-5)


def test_a_reader_notices_a_changed_armature() -> None:
    armature = armature_of(human())
    rig = read_rig(armature)
    reader = PoseReader(armature, rig)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    armature.data.edit_bones.remove(armature.data.edit_bones["toe_L"])
    bpy.ops.object.mode_set(mode="OBJECT")
    with pytest.raises(ValueError, match="other bones than before"):
        reader.read(evaluated(armature))
    with pytest.raises(ValueError, match="has lost the bone toe_L"):
        PoseReader(armature, rig)


def test_no_pose_is_refused() -> None:
    armature = armature_of(human())
    with pytest.raises(ValueError, match="no pose"):
        apply_motion(armature, read_rig(armature), [])
