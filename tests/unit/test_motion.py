"""Motion of one skeleton on another: same directions, same bends, whatever the two rest poses are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import skeletons
from skeletons import CONVENTIONS, human, rested, t_posed
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.anatomy import find_anatomy
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.motion import retarget
from wrinkle_synthesis.wrinkle_addon.rig import Pose, Rig, joint_angles, pose_of_angles

EXACT = 1e-6  # radians and metres: double precision through some twenty rotations


def dance(rig: Rig, frames: int = 10, seed: int = 0) -> list[Pose]:
    """Every joint at its own pace about rest, hips moving over the floor and turning."""
    joints = find_joints(rig).found
    rng = np.random.default_rng(seed)
    pace = {joint.name: (rng.uniform(-0.6, 0.6, joint.dof), rng.uniform(0, 6, joint.dof)) for joint in joints}
    size = np.linalg.norm(rig.heads[rig.index[joints[0].far]] - rig.heads[0])
    poses = []
    for t in np.linspace(0.0, 1.0, frames):
        # Hinges only flex, as in life.
        angles = {j.name: np.abs(pace[j.name][0]) * 2 * (j.dof == 1) + pace[j.name][0] * np.sin(6 * t + pace[j.name][1])
                  for j in joints}  # fmt: skip
        root = np.eye(4)
        root[:3, :3] = rotations.to_matrices(rotations.from_rotvec(-0.9 * t * rig.gravity))
        way = np.array([0.4 * t, 0.3 * t * t, 0.1 * np.sin(5 * t)]) * size
        root[:3, 3] = way - rig.gravity * (way @ rig.gravity) * 0.5
        poses.append(Pose(root @ pose_of_angles(rig, joints, angles).matrices))
    return poses


def played(source: Rig, poses: Sequence[Pose], target: Rig) -> list[Pose]:
    return retarget(source, find_joints(source).found, poses, target, find_joints(target).found)


def limb_directions(rig: Rig, poses: Sequence[Pose]) -> np.ndarray:
    """Unit vectors along upper arms, forearms, thighs and shins in the body's own axes, [frames, 8, 3]."""
    body = find_anatomy(rig)
    lines = []
    for key in ("arm_L", "arm_R", "leg_L", "leg_R"):
        limb = body.limbs[key]
        points = np.stack([pose.matrices[[limb.first, limb.middle, limb.end], :3, 3] for pose in poses])
        lines += [points[:, 1] - points[:, 0], points[:, 2] - points[:, 1]]
    stacked = np.stack(lines, axis=1)
    return stacked / np.linalg.norm(stacked, axis=2, keepdims=True) @ body.frame.matrix


def angles_of(rig: Rig, poses: Sequence[Pose]) -> dict[str, np.ndarray]:
    joints = find_joints(rig).found
    return {j.name: np.stack([joint_angles(rig, [j], pose)[j.name] for pose in poses]) for j in joints}


def in_own_rest(poses: Sequence[Pose], rig: Rig) -> Sequence[Pose]:
    """Poses of bones of another roll or tail, for the same deformation."""
    return [Pose(deformation @ rig.rest) for deformation in poses]  # type: ignore[operator]


TARGETS = {
    "same names, T-pose": t_posed(human()),
    "Unreal, larger": skeletons.scaled(human(CONVENTIONS["Unreal"]), 1.3),
    "Mixamo, y up": skeletons.turned(t_posed(human(CONVENTIONS["Mixamo"]), CONVENTIONS["Mixamo"].__getitem__),
                                     (-np.pi / 2, 0, 0)),
    "no names, any roll": skeletons.rolled(skeletons.nameless(human()), 4),
    "facing +y": skeletons.turned(human(), (0, 0, np.pi)),
    "tiny, lying": skeletons.scaled(skeletons.turned(human(CONVENTIONS["Daz"]), (0.5, 0.3, -0.9)), 0.02),
}  # fmt: skip


# --- directions and angles ------------------------------------------------------------------------------------------


def test_a_rig_repeats_its_own_motion() -> None:
    rig = human()
    poses = dance(rig)
    result = played(rig, poses, rig)
    for before, after in zip(poses, result, strict=True):
        np.testing.assert_allclose(after.turns(rig), before.turns(rig), atol=EXACT)
    ways = [np.array([p.matrices[0, :3, 3] for p in each]) for each in (poses, result)]
    np.testing.assert_allclose(np.diff(ways[1], axis=0), np.diff(ways[0], axis=0), atol=EXACT)


@pytest.mark.parametrize("target", TARGETS.values(), ids=TARGETS)
@pytest.mark.parametrize("source", [human(), t_posed(human())], ids=["from A-pose", "from T-pose"])
def test_limbs_point_where_they_point_in_the_clip(source: Rig, target: Rig) -> None:
    poses = dance(source)
    result = played(source, poses, target)
    np.testing.assert_allclose(limb_directions(target, result), limb_directions(source, poses), atol=EXACT)


@pytest.mark.parametrize("name", ["Unreal, larger", "no names, any roll", "facing +y", "tiny, lying"])
def test_joint_angles_are_the_clips_where_the_rest_poses_agree(name: str) -> None:
    source, target = human(), TARGETS[name]
    poses = dance(source)
    wanted, found = angles_of(source, poses), angles_of(target, played(source, poses, target))
    assert set(found) == set(wanted) and len(found) == 9
    for joint in wanted:
        np.testing.assert_allclose(found[joint], wanted[joint], atol=EXACT)


@pytest.mark.parametrize("name", ["same names, T-pose", "Mixamo, y up"])
def test_hinges_bend_as_far_as_in_the_clip_whatever_their_rest_bend(name: str) -> None:
    source, target = human(), TARGETS[name]
    poses = dance(source)
    result = played(source, poses, target)
    bends = [np.arccos((d[:, ::2] * d[:, 1::2]).sum(-1)) for d in (limb_directions(source, poses),
                                                                  limb_directions(target, result))]  # fmt: skip
    np.testing.assert_allclose(bends[1], bends[0], atol=1e-5)
    for joint in find_joints(target).found:
        if joint.is_hinge:
            turns = np.stack([pose.turns(target) for pose in result])
            near, far = (turns[:, target.index[bone]] for bone in (joint.near, joint.far))
            bend = rotations.to_rotvec(rotations.multiply(rotations.conjugate(near), far))
            # All of the bend is about the hinge's own axis, and none of it sideways.
            np.testing.assert_allclose(bend, (bend @ joint.axes[0])[:, None] * joint.axes[0], atol=1e-5)


def test_a_clip_of_a_t_pose_rig_and_of_an_a_pose_rig_come_out_alike() -> None:
    """The same movement, recorded once against a T-pose and once against the bent A-pose."""
    a_pose = human()
    poses = dance(a_pose)
    t_pose = t_posed(a_pose)
    for target in (a_pose, TARGETS["Unreal, larger"]):
        from_a, from_t = played(a_pose, poses, target), played(t_pose, poses, target)
        np.testing.assert_allclose(limb_directions(target, from_t), limb_directions(target, from_a), atol=EXACT)
        wanted, found = angles_of(target, from_a), angles_of(target, from_t)
        for name, angles in wanted.items():
            # A straight arm hides its elbow's axis; it is measured from the clip, whose hinges are pure.
            np.testing.assert_allclose(found[name], angles, atol=np.radians(0.1), err_msg=name)


# --- chains, missing and further bones ------------------------------------------------------------------------------


@pytest.mark.parametrize("drop", [("spine1",), ("spine1", "spine2"), ("neck",), ("clavicle_L", "clavicle_R"),
                                  ("toe_L", "toe_R"), ("thumb_L", "index_L", "ring_L", "hand_L")],
                         ids=lambda drop: drop[0])  # fmt: skip
def test_bones_that_one_side_lacks_do_no_harm(drop: tuple[str, ...]) -> None:
    full, lean = human(), human(drop=drop)
    for source, target in ((full, lean), (lean, full)):
        poses = dance(source)
        wanted, found = angles_of(source, poses), angles_of(target, played(source, poses, target))
        for name in set(wanted) & set(found):
            np.testing.assert_allclose(found[name], wanted[name], atol=EXACT, err_msg=name)


def test_a_spine_of_three_bones_bends_evenly_on_one_of_five() -> None:
    source = human()
    bones = {n: (source.names[p] if p >= 0 else "", h, t) for n, p, h, t in
             zip(source.names, source.parents, source.heads, source.tails, strict=True)}  # fmt: skip
    for i, (below, above) in enumerate((("spine1", "spine2"), ("spine2", "chest"))):
        half = 0.5 * (np.array(bones[below][1]) + np.array(bones[above][1]))
        bones[f"extra{i}"] = (below, half, bones[above][1])
        bones[above] = (f"extra{i}", *bones[above][1:])
    target = skeletons.rig_of(bones)
    spine = find_joints(target).joints["spine"]
    assert len(spine.bones) == 5
    joints = find_joints(source)
    poses = [pose_of_angles(source, joints.found, {"spine": [0.0, 0.9, 0.0]})]
    local = played(source, poses, target)[0].local_turns(target)
    bends = [np.linalg.norm(rotations.to_rotvec(local[target.index[bone]])) for bone in spine.bones]
    np.testing.assert_allclose(bends, 0.9 / 5, atol=EXACT)


def test_a_joint_the_user_corrected_is_followed() -> None:
    """A joint list that lacks the arms leaves the arms as they rest on the chest."""
    rig = human()
    joints = [joint for joint in find_joints(rig).found if joint.name.split("_")[0] not in ("shoulder", "elbow")]
    result = retarget(rig, find_joints(rig).found, dance(rig), rig, joints)
    rows = [rig.index[f"{part}_{side}"] for part in ("clavicle", "upperarm", "forearm", "hand") for side in "LR"]
    for pose in result:
        np.testing.assert_allclose(np.abs(pose.local_turns(rig)[rows, 0]), 1.0, atol=EXACT)


def test_bones_stay_together() -> None:
    """No bone leaves its place on its parent, fingers and decoys included."""
    target = skeletons.with_bones(human(), {"root": ("", (0, 0, 0), (0, 0.1, 0)),
                                            "pouch": ("thigh_L", (0.2, 0, 0.8), (0.25, 0, 0.8))})  # fmt: skip
    for pose in played(human(), dance(human()), target):
        deformations = pose.deformations(target)
        for bone, parent in enumerate(target.parents):
            if parent >= 0:
                head = deformations[parent] @ np.append(target.heads[bone], 1.0)
                np.testing.assert_allclose(pose.matrices[bone, :3, 3], head[:3], atol=EXACT)


# --- travel ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("factor", [0.01, 0.7, 2.0])
def test_the_way_travelled_scales_with_the_legs(factor: float) -> None:
    source = human()
    target = skeletons.scaled(human(CONVENTIONS["SMPL"]), factor)
    poses = dance(source)
    hips = [np.array([p.matrices[0, :3, 3] for p in each]) for each in (poses, played(source, poses, target))]
    np.testing.assert_allclose(np.diff(hips[1], axis=0), factor * np.diff(hips[0], axis=0), atol=EXACT)


def test_the_clip_starts_where_the_character_stands_with_its_feet_on_the_floor() -> None:
    source, target = human(), skeletons.turned(human(CONVENTIONS["Daz"]), (-np.pi / 2, 0, 0))
    poses = [Pose(skeletons_shift(p.matrices, [3.0, -2.0, 5.0])) for p in dance(source)]
    result = played(source, poses, target)
    up = -target.gravity
    start = result[0].matrices[0, :3, 3] - target.heads[0]
    assert np.linalg.norm(start - (start @ up) * up) < 0.1
    feet = [target.index[name] for name in ("lFoot", "rFoot", "lToe", "rToe")]
    lowest = min((pose.matrices[feet, :3, 3] @ up).min() for pose in result)
    assert lowest == pytest.approx((target.heads[feet] @ up).min(), abs=EXACT)


def skeletons_shift(matrices: np.ndarray, way: Sequence[float]) -> np.ndarray:
    moved = matrices.copy()
    moved[:, :3, 3] += way
    return moved


# --- bad input ------------------------------------------------------------------------------------------------------


def test_what_cannot_be_played_is_said() -> None:
    rig = human()
    joints = find_joints(rig).found
    with pytest.raises(ValueError, match="no frames"):
        retarget(rig, joints, [], rig, joints)
    legs = [j for j in joints if j.name.startswith(("hip", "knee"))]
    arms = [j for j in joints if j.name.startswith(("shoulder", "elbow"))]
    with pytest.raises(ValueError, match="no joint in common"):
        retarget(rig, legs, [Pose(rig.rest)], rig, arms)


def test_a_rest_pose_may_be_any_standing_pose() -> None:
    """A clip against a rest pose with raised arms gives the same as one against the A-pose."""
    source = human()
    poses = dance(source)
    raised = rested(source, pose_of_angles(source, find_joints(source).found,
                                           {"shoulder_L": [0, 0.9, 0.3], "shoulder_R": [0.2, 0.7, 0]}))  # fmt: skip
    target = replace(human(CONVENTIONS["Unreal"]))
    directions = [limb_directions(target, played(rig, poses, target)) for rig in (source, raised)]
    np.testing.assert_allclose(directions[1], directions[0], atol=EXACT)
