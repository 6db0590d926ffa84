"""The demo's motion clips and the BVH files made of them."""

from pathlib import Path

import numpy as np
import pytest
from wrinkle_synthesis.demo import motion, packages
from wrinkle_synthesis.demo.motion import (
    SIDE,
    SKELETON,
    UP,
    Clip,
    in_place,
    load_clip,
    repeated,
    resampled,
    to_rig,
    write_clip,
)
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.bvh import read_bvh

JOINTS = [segment.name for segment in SKELETON]


@pytest.fixture(scope="module")
def cached() -> None:
    try:
        packages.package_folder(packages.MOTION)
    except packages.PackageError as error:
        pytest.skip(str(error))


def still_clip(frames: int = 4) -> Clip:
    """A figure that stands with all limbs straight down."""
    turns = np.tile([1.0, 0.0, 0.0, 0.0], (frames, len(SKELETON), 1))
    return Clip("still", np.arange(frames) / 30.0, np.tile([0.0, 0.85, 0.0], (frames, 1)), turns, loops=True)


def walking_clip() -> Clip:
    """Two steps that turn the figure by 30 degrees and move it by 1 m."""
    clip = still_clip(11)
    progress = np.linspace(0.0, 1.0, 11)
    turns = clip.turns.copy()
    turns[:, 0] = rotations.from_rotvec(np.deg2rad(30.0) * progress[:, None] * UP)
    return Clip("walking", clip.times, clip.positions + progress[:, None] * [1.0, 0.0, 0.2], turns, loops=True)


def tips(clip: Clip) -> dict[str, np.ndarray]:
    """Ends of all bones in the first frame [m], facing +z with y up."""
    rig, poses = to_rig(clip)
    matrices = poses[0].matrices
    ends = matrices[:, :3, 3] + matrices[:, :3, 1] * rig.lengths[:, None]
    return {name: ends[rig.index[name]] for name in JOINTS}


def test_at_rest_the_limbs_hang_down_and_left_is_left() -> None:
    ends = tips(still_clip())
    # Facing +z with y up, the left side is +x.
    assert ends["LeftForeArm"][0] > 0.15 and ends["RightForeArm"][0] < -0.15
    assert ends["LeftForeArm"][1] < ends["LeftArm"][1] < ends["Spine"][1]
    assert ends["LeftFoot"][2] > 0.1


@pytest.mark.parametrize("side", ["Left", "Right"])
def test_a_bent_elbow_brings_the_hand_forward_and_a_bent_knee_the_foot_back(side: str) -> None:
    clip = still_clip()
    turns = clip.turns.copy()
    turns[:, JOINTS.index(f"{side}ForeArm")] = rotations.from_rotvec(1.0 * SIDE)
    turns[:, JOINTS.index(f"{side}Leg")] = rotations.from_rotvec(-1.0 * SIDE)
    straight, bent = tips(clip), tips(Clip("bent", clip.times, clip.positions, turns, False))
    assert bent[f"{side}ForeArm"][2] > straight[f"{side}ForeArm"][2] + 0.15
    assert bent[f"{side}Leg"][2] < straight[f"{side}Leg"][2] - 0.15


def test_resampling_keeps_ends_and_halves_turns() -> None:
    clip = walking_clip()
    fine = resampled(clip, 60.0)
    assert len(fine.times) == 21
    np.testing.assert_allclose(fine.positions[[0, -1]], clip.positions[[0, -1]], atol=1e-12)
    angle = rotations.twist_angle(fine.turns[1, 0], UP)
    assert angle == pytest.approx(np.deg2rad(1.5), abs=1e-9)


def test_repeating_goes_on_where_the_clip_arrived() -> None:
    clip = walking_clip()
    twice = repeated(clip, 2)
    assert len(twice.times) == 21
    steps = np.linalg.norm(np.diff(twice.positions, axis=0), axis=1)
    np.testing.assert_allclose(steps, steps[0], rtol=1e-9)
    headings = rotations.twist_angle(twice.turns[:, 0], UP)
    np.testing.assert_allclose(np.diff(headings), np.deg2rad(3.0), atol=1e-9)


def test_a_clip_that_does_not_loop_cannot_be_repeated() -> None:
    clip = still_clip()
    with pytest.raises(ValueError, match="cannot be repeated"):
        repeated(Clip("once", clip.times, clip.positions, clip.turns, loops=False), 2)


def test_in_place_only_the_height_changes() -> None:
    positions = in_place(walking_clip()).positions
    assert (positions[:, [0, 2]] == 0.0).all() and (positions[:, 1] == 0.85).all()


def test_an_unknown_clip_is_named() -> None:
    with pytest.raises(ValueError, match="'moonwalk'"):
        load_clip("moonwalk")


@pytest.mark.usefixtures("cached")
@pytest.mark.parametrize("name", motion.CLIPS)
def test_every_clip_is_a_human_motion(name: str) -> None:
    clip = load_clip(name)
    assert 0.5 < clip.times[-1] < 5.0 and (np.diff(clip.times) > 0.0).all()
    elbows = [rotations.twist_angle(clip.turns[:, JOINTS.index(f"{side}ForeArm")], SIDE) for side in ("Left", "Right")]
    knees = [rotations.twist_angle(clip.turns[:, JOINTS.index(f"{side}Leg")], SIDE) for side in ("Left", "Right")]
    # Elbows and knees overstretch by some degrees at most, and bend up to 160.
    assert np.min(elbows) > -0.1 and np.max(elbows) < 2.8
    assert np.max(knees) < 0.3 and np.min(knees) > -2.8


@pytest.mark.usefixtures("cached")
def test_a_written_clip_reads_back(tmp_path: Path) -> None:
    path = write_clip(load_clip("punch"), tmp_path / "clips" / "punch.bvh")
    written = resampled(load_clip("punch"))
    clip = read_bvh(path)
    assert clip.fps == pytest.approx(30.0)
    assert len(clip.poses) == len(written.times) and clip.rig.bone_count >= len(SKELETON)
    hand = np.array([pose.matrices[clip.rig.index["LeftForeArm"], :3, 3] for pose in clip.poses])
    rig, poses = to_rig(written)
    expected = np.array([pose.matrices[rig.index["LeftForeArm"], :3, 3] for pose in poses])
    # Reading may choose other axes and units: distances travelled between frames stay, to the file's six decimals.
    np.testing.assert_allclose(
        np.linalg.norm(np.diff(hand, axis=0), axis=1), np.linalg.norm(np.diff(expected, axis=0), axis=1), atol=1e-4
    )
