"""BVH files: any channel order, unit, axes and zero pose; malformed ones with one sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import skeletons
from skeletons import CONVENTIONS, human
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.bvh import read_bvh, write_bvh
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.rig import Pose, Rig, joint_angles, pose_from_local_turns, pose_of_angles

STICK = """HIERARCHY
ROOT Hips
{{
    OFFSET 0 0 0
    CHANNELS 6 Xposition Yposition Zposition {order}
    JOINT Upper Leg
    {{
        OFFSET 0 -1 0
        CHANNELS 3 {order}
        End Site
        {{
            OFFSET 0 -1 0
        }}
    }}
}}
MOTION
Frames: {frames}
Frame Time: {time}
{rows}
"""


def stick(tmp_path: Path, rows: str, order: str = "Zrotation Xrotation Yrotation", frames: int = 1, **changes) -> Path:
    """A file of two bones with these motion rows."""
    path = tmp_path / "stick.bvh"
    text = STICK.format(order=order, frames=frames, time=changes.pop("time", "0.033333"), rows=rows)
    for old, new in changes.pop("replace", {}).items():
        assert old in text
        text = text.replace(old, new)
    path.write_text(text)
    return path


def dance(rig: Rig, frames: int = 12) -> list[Pose]:
    """A standing dance: every joint at its own pace, the hips moving and turning about the vertical."""
    joints = find_joints(rig).found
    rng = np.random.default_rng(5)
    pace = {joint.name: (rng.uniform(-0.5, 0.5, joint.dof), rng.uniform(0, 6, joint.dof)) for joint in joints}
    poses = []
    for t in np.linspace(0.0, 1.0, frames):
        angles = {name: size * np.sin(6.0 * t + phase) for name, (size, phase) in pace.items()}
        root = np.eye(4)
        root[:3, :3] = rotations.to_matrices(rotations.from_rotvec(-0.8 * t * rig.gravity))
        root[:3, 3] = [0.3 * t, -0.5 * t, 0.05 * np.sin(9 * t)]
        poses.append(Pose(root @ pose_of_angles(rig, joints, angles).matrices))
    return poses


# --- reading --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("order", ["Zrotation Xrotation Yrotation", "Xrotation Yrotation Zrotation",
                                   "Yrotation Zrotation Xrotation"])  # fmt: skip
def test_rotations_apply_in_the_order_of_the_channels(tmp_path: Path, order: str) -> None:
    angles = np.radians([20.0, -50.0, 70.0])
    clip = read_bvh(stick(tmp_path, "1 2 3 20 -50 70 0 0 0", order), unit_m=1.0)
    expected = np.eye(3)
    for word, angle in zip(order.split(), angles, strict=True):
        expected = expected @ rotations.to_matrices(rotations.from_rotvec(angle * np.eye(3)["XYZ".index(word[0])]))
    deformation = clip.poses[0].deformations(clip.rig)
    np.testing.assert_allclose(deformation[0, :3, :3], expected, atol=1e-12)
    np.testing.assert_allclose(clip.poses[0].matrices[0, :3, 3], [1, 2, 3], atol=1e-12)
    np.testing.assert_allclose(clip.poses[0].matrices[1, :3, 3], [1, 2, 3] + expected @ [0, -1, 0], atol=1e-12)


def test_names_may_hold_spaces_and_case_does_not_matter(tmp_path: Path) -> None:
    clip = read_bvh(stick(tmp_path, "0 0 0 0 0 0 0 0 0", replace={"ROOT": "Root", "CHANNELS 3": "Channels 3"}))
    assert clip.rig.names == ("Hips", "Upper Leg")


def test_joints_of_one_name_are_told_apart(tmp_path: Path) -> None:
    clip = read_bvh(stick(tmp_path, "0 0 0 0 0 0 0 0 0", replace={"Upper Leg": "Hips"}))
    assert clip.rig.names == ("Hips", "Hips.001")


@pytest.mark.parametrize(("given", "expected"), [("0 -1 0", -1.0), ("0 0.25 0", -0.75)])
def test_position_channels_stand_for_the_offset_or_on_top_of_it(tmp_path: Path, given: str, expected: float) -> None:
    order = {"CHANNELS 3": "CHANNELS 6 Xposition Yposition Zposition"}
    clip = read_bvh(stick(tmp_path, f"0 0 0 0 0 0 {given} 0 0 0", replace=order), unit_m=1.0)
    assert clip.poses[0].matrices[1, 1, 3] == pytest.approx(expected)


@pytest.mark.parametrize("factor", [100.0, 1.0, 1000.0, 39.37])
def test_the_unit_is_guessed_from_human_size(tmp_path: Path, factor: float) -> None:
    body = human(CONVENTIONS["Mixamo"])
    big = skeletons.scaled(body, factor)
    write_bvh(tmp_path / "big.bvh", big, [Pose(big.rest)], 30.0)
    clip = read_bvh(tmp_path / "big.bvh")
    np.testing.assert_allclose(np.ptp(clip.rig.heads[:, 2]), np.ptp(body.heads[:, 2]), rtol=1e-3)


@pytest.mark.parametrize(
    "time, fps", [("0.033333", 30.0), ("0.0083333", 120.0), ("0.0333667", 30000 / 1001), ("0.07", 1 / 0.07)]
)
def test_rounded_frame_times_mean_the_usual_rates(tmp_path: Path, time: str, fps: float) -> None:
    assert read_bvh(stick(tmp_path, "0 0 0 0 0 0 0 0 0", time=time)).fps == pytest.approx(fps, rel=1e-9)


def test_wrapped_rows_are_joined(tmp_path: Path) -> None:
    assert len(read_bvh(stick(tmp_path, "0 0 0 0 0\n0 0 0 0\n1 1 1 0 0 0\n0 0 0", frames=2)).poses) == 2


# --- axes and rest --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turn", [(0, 0, 0), (-np.pi / 2, 0, 0), (0, np.pi / 2, 0)], ids=["z up", "y up", "x up"])
def test_up_is_where_the_figure_stands(tmp_path: Path, turn: tuple[float, float, float]) -> None:
    rig = skeletons.turned(human(CONVENTIONS["CMU BVH"]), turn)
    write_bvh(tmp_path / "clip.bvh", rig, dance(rig), 30.0)
    clip = read_bvh(tmp_path / "clip.bvh", unit_m=1.0)
    np.testing.assert_allclose(clip.rig.gravity, rig.gravity, atol=1e-9)


def angles_of(clip_path: Path) -> list[dict[str, np.ndarray]]:
    clip = read_bvh(clip_path, unit_m=1.0)
    joints = find_joints(clip.rig).found
    assert len(joints) == 9
    return [joint_angles(clip.rig, joints, pose) for pose in clip.poses]


def test_a_turn_of_axes_in_the_root_is_taken_off(tmp_path: Path) -> None:
    """Some exporters keep a z-up rest pose and turn the root of every frame into a y-up world."""
    rig = human(CONVENTIONS["CMU BVH"])
    turn = np.eye(4)
    turn[:3, :3] = rotations.to_matrices(rotations.from_rotvec([-np.pi / 2, 0, 0]))
    write_bvh(tmp_path / "clip.bvh", rig, [Pose(turn @ pose.matrices) for pose in dance(rig)], 30.0)
    clip = read_bvh(tmp_path / "clip.bvh", unit_m=1.0)
    head, foot = (clip.poses[0].matrices[clip.rig.index[name], :3, 3] for name in ("Head", "LeftFoot"))
    assert (head - foot) @ clip.rig.gravity < -1.0


@pytest.mark.parametrize("axis", [0, 1])
def test_a_figure_that_lies_down_is_left_lying(tmp_path: Path, axis: int) -> None:
    rig = human(CONVENTIONS["CMU BVH"])
    joints = find_joints(rig).found
    turn = np.eye(4)
    turn[:3, :3] = rotations.to_matrices(rotations.from_rotvec(-np.pi / 2 * np.eye(3)[axis]))
    crawl = pose_of_angles(rig, joints, {f"hip_{side}": [0.0, 1.4, 0.0] for side in "LR"})
    write_bvh(tmp_path / "crawl.bvh", rig, [Pose(turn @ crawl.matrices)] * 20, 30.0)
    clip = read_bvh(tmp_path / "crawl.bvh", unit_m=1.0)
    trunk = np.subtract(*(clip.poses[0].matrices[clip.rig.index[name], :3, 3] for name in ("Neck", "Hips")))
    assert abs(trunk @ clip.rig.gravity) < 0.05


def test_a_zero_pose_that_does_not_stand_is_replaced_by_a_frame_that_does(tmp_path: Path) -> None:
    """Some exporters lay every bone along one axis."""
    rig = human(CONVENTIONS["CMU BVH"])
    poses = [Pose(rig.rest), *dance(rig)]
    local = np.tile([1.0, 0.0, 0.0, 0.0], (rig.bone_count, 1))
    for bone, parent in enumerate(rig.parents):
        line = rig.rest[bone, :3, 1]
        above = rig.rest[parent, :3, 1] if parent >= 0 else np.array([1.0, 0.0, 0.0])
        to_x, from_x = rotations.between(line, [1, 0, 0]), rotations.between(above, [1, 0, 0])
        local[bone] = rotations.multiply(rotations.conjugate(from_x), to_x) if parent >= 0 else to_x
    laid_out = replace(rig, rest=pose_from_local_turns(rig, local).matrices)
    write_bvh(tmp_path / "laid.bvh", laid_out, poses, 30.0)
    write_bvh(tmp_path / "standing.bvh", rig, poses, 30.0)
    assert np.ptp(laid_out.heads[:, 0]) > 3 * np.ptp(laid_out.heads[:, 2])
    for laid, standing in zip(angles_of(tmp_path / "laid.bvh"), angles_of(tmp_path / "standing.bvh"), strict=True):
        for name in standing:
            # The file holds six decimals.
            np.testing.assert_allclose(laid[name], standing[name], atol=1e-4)


# --- writing --------------------------------------------------------------------------------------------------------


def test_written_poses_are_read_back(tmp_path: Path) -> None:
    rig = human(CONVENTIONS["Rigify metarig"])
    poses = dance(rig)
    poses[3].matrices[rig.index["spine.005"], :3, 3] += [0.0, 0.0, 0.02]
    write_bvh(tmp_path / "dance.bvh", rig, poses, 24.0)
    clip = read_bvh(tmp_path / "dance.bvh", unit_m=1.0)
    assert clip.fps == 24.0 and set(clip.rig.names) == set(rig.names)
    rows = [clip.rig.index[name] for name in rig.names]
    for before, after in zip(poses, clip.poses, strict=True):
        # Six decimals of metres and degrees, gathered along twelve bones.
        np.testing.assert_allclose(after.deformations(clip.rig)[rows], before.deformations(rig), atol=1e-5)


def test_nothing_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no pose"):
        write_bvh(tmp_path / "x.bvh", human(), [], 30.0)
    with pytest.raises(ValueError, match="frame rate"):
        write_bvh(tmp_path / "x.bvh", human(), [Pose(human().rest)], 0.0)


# --- malformed files ------------------------------------------------------------------------------------------------

ROW = "0 0 0 0 0 0 0 0 0"


@pytest.mark.parametrize(
    ("rows", "changes", "sentence"),
    [
        (ROW, {"replace": {"HIERARCHY": "SKELETON"}}, "does not begin with HIERARCHY"),
        (ROW, {"replace": {"MOTION": "MOVES"}}, "no MOTION section"),
        (ROW, {"replace": {"OFFSET 0 -1 0": "OFFSET 0 minus 0"}}, "3 numbers after OFFSET of joint Upper Leg"),
        (ROW, {"replace": {"CHANNELS 3 Zrotation": "CHANNELS 3 Wrotation"}}, "joint Upper Leg has channels"),
        (ROW, {"replace": {"JOINT Upper Leg": "LIMB Upper Leg"}}, "word LIMB"),
        (ROW, {"replace": {"    }\n}\nMOTION": "    }\nMOTION"}}, "hierarchy is cut off"),
        (ROW, {"replace": {"}\nMOTION": "}\n}\nMOTION"}}, "closes more braces"),
        (ROW, {"replace": {"Frame Time: 0.033333": ""}}, "no Frame Time"),
        (ROW, {"time": "0"}, "no Frame Time above zero"),
        (ROW, {"time": "soon"}, "Frame Time is followed by no number"),
        ("", {"frames": 0}, "motion is empty"),
        ("", {}, "motion is empty"),
        (ROW, {"frames": 5}, "announces 5 frames and holds 1"),
        ("0 0 0", {}, "3 motion values do not fill frames of 9 channels"),
        (ROW.replace("0", "x", 1), {}, "no number"),
        (ROW.replace("0", "nan", 1), {}, "not a number"),
    ],
)
def test_malformed_files_are_refused_in_one_sentence(tmp_path: Path, rows: str, changes: dict, sentence: str) -> None:
    with pytest.raises(ValueError) as error:
        read_bvh(stick(tmp_path, rows, **changes))
    assert sentence in str(error.value) and "stick.bvh" in str(error.value)
    assert str(error.value).count("\n") == 0 and str(error.value).endswith(".")


def test_a_missing_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no motion file"):
        read_bvh(tmp_path / "none.bvh")
    (tmp_path / "noise.bvh").write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match=r"noise\.bvh"):
        read_bvh(tmp_path / "noise.bvh")
