"""Axes, signs and ranges of the joints, and joints of the user's choice."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import skeletons
from skeletons import human, nameless, rested, t_posed
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.joints import MOST_TWIST, find_joints, make_joint, ranges_from_poses, with_ranges
from wrinkle_synthesis.wrinkle_addon.rig import Joint, JointAngles, Pose, Rig, joint_angles, pose_of_angles

BODIES = {"A-pose": human(), "T-pose": t_posed(human())}
BIG = np.radians(40.0)


def moved(rig: Rig, joint: Joint, angles: list[float], bone: str) -> np.ndarray:
    """Where a bone's head goes when one joint takes these angles [m]."""
    row = rig.index[bone]
    return pose_of_angles(rig, [joint], {joint.name: angles}).matrices[row, :3, 3] - rig.heads[row]


@pytest.mark.parametrize("rig", BODIES.values(), ids=BODIES)
@pytest.mark.parametrize("side", ["L", "R"])
def test_positive_angles_mean_what_the_table_says(rig: Rig, side: str) -> None:
    """The body faces -y with z up and its left at +x."""
    joints = find_joints(rig).joints
    out = 1.0 if side == "L" else -1.0
    assert moved(rig, joints[f"elbow_{side}"], [BIG], f"hand_{side}")[1] < -0.05
    assert moved(rig, joints[f"knee_{side}"], [BIG], f"foot_{side}")[1] > 0.1
    shoulder, hip = joints[f"shoulder_{side}"], joints[f"hip_{side}"]
    assert moved(rig, shoulder, [0, BIG, 0], f"forearm_{side}")[2] > 0.1
    assert moved(rig, shoulder, [0, 0, BIG], f"forearm_{side}")[1] < -0.1
    assert moved(rig, hip, [0, BIG, 0], f"shin_{side}")[1] < -0.2
    assert moved(rig, hip, [0, 0, BIG], f"shin_{side}")[0] * out > 0.2
    # Internal rotation turns the toes of the straight leg inwards.
    assert moved(rig, hip, [BIG, 0, 0], f"toe_{side}")[0] * out < -0.02


@pytest.mark.parametrize("rig", BODIES.values(), ids=BODIES)
def test_the_spine_turns_and_bends_to_the_left_and_forward(rig: Rig) -> None:
    spine = find_joints(rig).joints["spine"]
    assert moved(rig, spine, [BIG, 0, 0], "upperarm_L")[1] > 0.05
    assert moved(rig, spine, [0, BIG, 0], "head")[1] < -0.1
    assert moved(rig, spine, [0, 0, BIG], "head")[0] > 0.1


@pytest.mark.parametrize("rig", BODIES.values(), ids=BODIES)
def test_a_mirrored_pose_has_the_same_angles_on_the_other_side(rig: Rig) -> None:
    joints = find_joints(rig).found
    angles = {joint.name: np.random.default_rng(3).uniform(-0.6, 0.6, joint.dof) for joint in joints}
    pose = pose_of_angles(rig, joints, angles)
    flip = np.diag([-1.0, 1.0, 1.0, 1.0])
    other = {"_L": "_R", "_R": "_L"}
    rows = [rig.index[name[:-2] + other.get(name[-2:], name[-2:])] for name in rig.names]
    mirrored = Pose((flip @ pose.deformations(rig) @ flip)[rows] @ rig.rest)
    before, after = joint_angles(rig, joints, pose), joint_angles(rig, joints, mirrored)
    for name in before:
        sign = np.array([-1.0, 1.0, -1.0]) if name == "spine" else 1.0
        np.testing.assert_allclose(after[name[:-2] + other.get(name[-2:], name[-2:])], sign * before[name], atol=1e-9)


def test_a_clear_rest_bend_gives_the_hinge_axis() -> None:
    rig = human()
    joint = find_joints(rig).joints["elbow_L"]
    upper = rig.heads[rig.index["forearm_L"]] - rig.heads[rig.index["upperarm_L"]]
    lower = rig.heads[rig.index["hand_L"]] - rig.heads[rig.index["forearm_L"]]
    axis = np.cross(upper, lower)
    np.testing.assert_allclose(joint.axes[0], axis / np.linalg.norm(axis), atol=1e-12)


def test_a_straight_limb_takes_its_hinge_axis_from_anatomy() -> None:
    joints = find_joints(t_posed(human())).joints
    np.testing.assert_allclose(joints["knee_L"].axes[0], [1, 0, 0], atol=1e-9)
    np.testing.assert_allclose(joints["elbow_L"].axes[0], [0, 0, -1], atol=1e-9)
    np.testing.assert_allclose(joints["elbow_R"].axes[0], [0, 0, 1], atol=1e-9)


def test_a_knee_that_rests_bent_backwards_still_folds_backwards() -> None:
    body = t_posed(human())
    pose = pose_of_angles(body, find_joints(body).found, {"knee_L": [-0.15], "knee_R": [-0.15]})
    rig = rested(body, pose)
    assert find_joints(rig).joints["knee_L"].axes[0] @ [1, 0, 0] > 0.99


def test_axes_follow_a_turned_rig() -> None:
    body, vector = human(), np.array([0.3, -1.2, 0.8])
    turn = rotations.to_matrices(rotations.from_rotvec(vector))
    turned = find_joints(nameless(skeletons.turned(body, vector))).joints
    for name, joint in find_joints(body).joints.items():
        np.testing.assert_allclose(turned[name].axes, joint.axes @ turn.T, atol=1e-9)
        np.testing.assert_allclose(turned[name].limits, joint.limits, atol=1e-9)


# --- ranges -------------------------------------------------------------------------------------------------------


def test_human_ranges_have_the_rest_angle_taken_off() -> None:
    straight, bent = (find_joints(BODIES[pose]).joints for pose in ("T-pose", "A-pose"))
    np.testing.assert_allclose(np.degrees(straight["elbow_L"].limits), [[0, 150]], atol=1e-6)
    np.testing.assert_allclose(np.degrees(straight["knee_R"].limits), [[0, 135]], atol=1e-6)
    rest = -bent["elbow_L"].limits[0, 0]
    assert np.degrees(rest) > 20
    np.testing.assert_allclose(bent["elbow_L"].limits[0, 1], np.radians(150) - rest)
    # A T-pose rests at 90 degrees of abduction; the arm hangs at -90.
    np.testing.assert_allclose(np.degrees(straight["shoulder_L"].limits[1]), [-90, 38], atol=1e-6)
    assert -60 < np.degrees(bent["shoulder_L"].limits[1, 0]) < -30


@pytest.mark.parametrize("rig", BODIES.values(), ids=BODIES)
def test_every_range_holds_rest(rig: Rig) -> None:
    for joint in find_joints(rig).found:
        assert (joint.limits[:, 0] <= 0).all() and (joint.limits[:, 1] >= 0).all()


def test_ranges_from_an_action_are_what_it_uses_and_a_margin() -> None:
    rig = human()
    joints = find_joints(rig).found
    poses = [pose_of_angles(rig, joints, {"elbow_L": [a], "hip_R": [0, a, 0]}) for a in (0.3, 0.9)]
    fitted = {joint.name: joint for joint in ranges_from_poses(rig, joints, poses, margin=0.05)}
    np.testing.assert_allclose(fitted["elbow_L"].limits, [[0.0, 0.95]], atol=1e-9)
    np.testing.assert_allclose(fitted["hip_R"].limits, [[-0.05, 0.05], [0.0, 0.95], [-0.05, 0.05]], atol=1e-9)
    np.testing.assert_allclose(fitted["knee_L"].limits, [[-0.05, 0.05]], atol=1e-9)


def test_a_limb_that_an_action_twists_around_is_sampled_as_far_as_skinning_bears() -> None:
    rig = human()
    joint = find_joints(rig).joints["shoulder_R"]
    poses = [pose_of_angles(rig, [joint], {"shoulder_R": [a, 0.8, 0.0]}) for a in np.radians([-170, -50, 60, 179])]
    (fitted,) = ranges_from_poses(rig, [joint], poses)
    np.testing.assert_allclose(fitted.limits[0], [-MOST_TWIST, MOST_TWIST])
    # The clavicle's share of the swing makes it a little more or less than what was given.
    np.testing.assert_allclose(fitted.limits[1], [0.0, 0.8 + np.radians(5.0)], atol=1e-6)


def test_the_clavicles_share_is_measured_where_an_action_moves_them() -> None:
    rig = human()
    joint = find_joints(rig).joints["shoulder_L"]
    assert joint.shares[0] == 0.25
    moving = replace(joint, shares=np.array([0.4, 0.6]))
    still = replace(joint, shares=np.array([0.0, 1.0]))
    angles = [[0.1, 0.5, -0.3], [0.0, -0.4, 0.6], [0.2, 0.8, 0.1]]
    for given, expected in ((moving, 0.4), (still, 0.25)):
        poses = [pose_of_angles(rig, [given], {"shoulder_L": a}) for a in angles]
        # Clavicle and arm turn one after the other; their parts of one swing are exact only to second order.
        assert ranges_from_poses(rig, [joint], poses)[0].shares[0] == pytest.approx(expected, abs=0.01)


def test_an_action_without_frames_gives_no_ranges() -> None:
    with pytest.raises(ValueError, match="without frames"):
        ranges_from_poses(human(), find_joints(human()).found, [])


def test_ranges_can_be_set_in_degrees() -> None:
    joint = find_joints(human()).joints["elbow_L"]
    np.testing.assert_allclose(with_ranges(joint, [-10, 90]).limits, np.radians([[-10, 90]]))
    for wrong in ([10, 90], [[0, 1], [0, 1]], [0, np.nan]):
        with pytest.raises(ValueError, match="elbow_L"):
            with_ranges(joint, wrong)


# --- further joints -------------------------------------------------------------------------------------------------


def test_wrists_ankles_and_neck_can_be_added() -> None:
    rig = human()
    wrist = make_joint(rig, "wrist_L", "hand_L")
    ankle = make_joint(rig, "ankle_R", "foot_R")
    neck = make_joint(rig, "neck", ["neck", "head"])
    assert (wrist.near, ankle.near, neck.near) == ("forearm_L", "shin_R", "chest")
    for joint in (wrist, ankle, neck):
        np.testing.assert_allclose(joint.axes @ joint.axes.T, np.eye(3), atol=1e-9)
        assert (joint.limits[:, 0] <= 0).all() and (joint.limits[:, 1] >= 0).all()
    assert moved(rig, ankle, [0, BIG, 0], "toe_R")[2] > 0.02
    assert moved(rig, neck, [0, BIG, 0], "head")[1] < -0.01


def test_any_bone_can_be_a_hinge() -> None:
    rig = human()
    toe = make_joint(rig, "toes_L", "toe_L", near="foot_L", dof=1)
    assert toe.is_hinge and abs(toe.axes[0] @ [1, 0, 0]) > 0.9


def test_a_joint_of_unknown_bones_is_refused() -> None:
    with pytest.raises(ValueError, match="the bone paw"):
        make_joint(human(), "wrist_L", "paw")


def test_angles_of_many_joints_at_once_are_those_that_made_the_pose() -> None:
    rig = human()
    joints = find_joints(rig).found
    assert {joint.dof for joint in joints} == {1, 3}
    rng = np.random.default_rng(4)
    wanted = {joint.name: rng.uniform(-0.6, 0.6, joint.dof) for joint in joints}
    found = JointAngles(rig, joints).read(pose_of_angles(rig, joints, wanted).turns(rig))
    for joint, angles in zip(joints, found, strict=True):
        # Rounding of float64, through two quaternion products and an arc tangent.
        np.testing.assert_allclose(angles, wanted[joint.name], atol=1e-12)


def test_a_joint_without_a_near_bone_turns_against_none() -> None:
    rig = human()
    for joint in find_joints(rig).found:
        angles = np.linspace(0.2, 0.4, joint.dof)
        turns = pose_of_angles(rig, [joint], {joint.name: angles}).turns(rig)
        # The near bone rests, so that it makes no difference.
        found = JointAngles(rig, [replace(joint, near="")]).read(turns)
        np.testing.assert_allclose(found[0], angles, atol=1e-12)
