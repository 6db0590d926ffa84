"""A sleeve on an arm of two bones that bends, wrinkles and swings: clips to compress."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.flow_compress import FlowSource
from wrinkle_synthesis.wrinkle_addon.garment import SkinWeights
from wrinkle_synthesis.wrinkle_addon.recordings import Recording
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray, Pose, Rig, pose_from_local_turns

LENGTH, RADIUS = 0.6, 0.05


def arm_rig() -> Rig:
    """Two bones along x, and one beside them that carries no cloth."""
    rest = np.tile(np.eye(4), (3, 1, 1))
    # A bone points along its own y.
    rest[:, :3, :3] = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    rest[1, 0, 3] = LENGTH / 2
    rest[2, 1, 3] = 1.0
    return Rig(
        ("upper", "lower", "tail"),
        np.array([-1, 0, 0], np.int32),
        rest,
        np.full(3, LENGTH / 2),
        np.array([0.0, 0.0, -1.0]),
    )


def sleeve(along: int = 40, around: int = 24) -> FloatArray:
    """Vertices of a tube around the arm [m], shape [along * around, 3]."""
    x, angle = np.meshgrid(np.linspace(0.02, LENGTH, along), np.arange(around) * 2 * np.pi / around, indexing="ij")
    return np.stack([x, RADIUS * np.cos(angle), RADIUS * np.sin(angle)], -1).reshape(-1, 3)


def sleeve_weights(rest: FloatArray) -> SkinWeights:
    lower = np.clip((rest[:, 0] - LENGTH / 2) / 0.1 + 0.5, 0.0, 1.0)
    return SkinWeights.from_dense(np.stack([1.0 - lower, lower, np.zeros(len(rest))], 1))


def arm_poses(rig: Rig, frame_count: int) -> list[Pose]:
    """The elbow bends, the shoulder sways, and the whole arm goes somewhere."""
    poses = []
    for t in np.linspace(0.0, 1.0, frame_count):
        turns = np.tile([1.0, 0.0, 0.0, 0.0], (3, 1))
        turns[0] = rotations.from_rotvec([0.3 * np.sin(5 * t), 0.0, 0.8 * t])
        turns[1] = rotations.from_rotvec([0.0, -1.6 * t, 0.0])
        root = np.eye(4)
        root[:3, 3] = 0.5 * t, 0.1 * np.sin(9 * t), 0.0
        poses.append(pose_from_local_turns(rig, turns, root))
    return poses


def wrinkles(rest: FloatArray, t: float) -> FloatArray:
    """Folds that run along the sleeve as time passes [m], up to 8 mm."""
    outwards = rest * [0.0, 1.0, 1.0] / RADIUS
    angle = np.arctan2(rest[:, 2], rest[:, 1])
    waves = np.sin(60 * rest[:, 0] + 6 * t) * np.cos(3 * angle + 4 * t) + 0.6 * np.sin(25 * rest[:, 0] - 11 * t)
    return 5.0e-3 * t * waves[:, None] * outwards


def clip(frame_count: int = 40, start: float = 5.0, along: int = 40, around: int = 24) -> FlowSource:
    """A wrinkling sleeve, recorded in the space of an object that is turned, scaled and moving."""
    rig, rest = arm_rig(), sleeve(along, around)
    weights, poses = sleeve_weights(rest), arm_poses(rig, frame_count)
    to_rig, frames = np.tile(np.eye(4), (frame_count, 1, 1)), np.zeros((frame_count, len(rest), 3), np.float32)
    for number, pose in enumerate(poses):
        t = number / max(frame_count - 1, 1)
        turn = rotations.from_rotvec([0.2, 0.4 * t, 1.0])
        to_rig[number, :3, :3] = 2.0 * rotations.to_matrices(turn)
        to_rig[number, :3, 3] = 0.3, t, -0.2
        skinned = weights.carry(pose.deformations(rig), rest)
        positions = skinned + rotations.rotate(weights.turn(pose.turns(rig)), wrinkles(rest, t))
        frames[number] = (positions - to_rig[number, :3, 3]) @ np.linalg.inv(to_rig[number, :3, :3]).T
    return FlowSource(
        Recording("sleeve", frames, start, np.eye(4)), rig, poses, to_rig, "sleeve", "topology", rest, weights
    )


def recorded(source: FlowSource, frame: int) -> FloatArray:
    """A recorded frame in rig space [m]."""
    matrix = source.to_rig[frame]
    return source.recording.frames[frame].astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]


def write_mdd(path: Path, frames: NDArray[np.float32]) -> None:
    header = np.array(frames.shape[:2], ">i4").tobytes()
    path.write_bytes(header + np.arange(len(frames), dtype=">f4").tobytes() + frames.astype(">f4").tobytes())
