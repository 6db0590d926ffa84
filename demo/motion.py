"""The demo's motion: DeepMimic's motion-capture clips, as shipped with pybullet, turned into BVH files.

A frame of a clip has 44 numbers: its duration [s], the root's position (3) and rotation (4), then rotations of chest,
neck, right hip, knee, ankle, shoulder, elbow and the same of the left. Quaternions are (w, x, y, z); knees and elbows
are hinges about the body's side axis, a bent elbow positive and a bent knee negative. The clips face +x with y up and
their right along +z; the BVH files face +z with y up, as motion capture usually does. Lengths are metres.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..wrinkle_addon import rotations
from ..wrinkle_addon.bvh import write_bvh
from ..wrinkle_addon.rig import Pose, Rig, pose_from_local_turns
from . import packages
from .character import bone_axes

FloatArray = NDArray[np.float64]

CLIPS = (
    *("walk", "run", "jump", "kick", "spinkick", "punch", "dance_a", "dance_b", "spin", "cartwheel", "backflip"),
    *("roll", "crawl", "getup_facedown", "getup_faceup"),
)
UP = np.array([0.0, 1.0, 0.0])
SIDE = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Segment:
    """A joint of the clips' skeleton, whose limbs all hang straight down at rest.

    Attributes:
        name: Name in the BVH file.
        parent: Index of the joint before it, -1 for the root.
        offset: From the parent, in the clips' axes [m]: DeepMimic's humanoid.
        bone: From the joint to the end of its bone [m].
        columns: Where its rotation stands in a frame: four numbers of a quaternion, or one angle.
    """

    name: str
    parent: int
    offset: tuple[float, float, float]
    bone: tuple[float, float, float]
    columns: slice


SPINE, HEAD, FOOT = (0.0, 0.223894, 0.0), (0.0, 0.2775, 0.0), (0.1335, -0.05, 0.0)
THIGH, SHIN = (0.0, -0.421546, 0.0), (0.0, -0.40987, 0.0)
UPPER_ARM, FOREARM = (0.0, -0.274788, 0.0), (0.0, -0.258947, 0.0)
SKELETON = (
    Segment("Hips", -1, (0.0, 0.0, 0.0), (0.0, 0.236151, 0.0), slice(4, 8)),
    Segment("Spine", 0, (0.0, 0.236151, 0.0), SPINE, slice(8, 12)),
    Segment("Neck", 1, SPINE, HEAD, slice(12, 16)),
    Segment("RightUpLeg", 0, (0.0, 0.0, 0.084887), THIGH, slice(16, 20)),
    Segment("RightLeg", 3, THIGH, SHIN, slice(20, 21)),
    Segment("RightFoot", 4, SHIN, FOOT, slice(21, 25)),
    Segment("RightArm", 1, (-0.02405, 0.2435, 0.18311), UPPER_ARM, slice(25, 29)),
    Segment("RightForeArm", 6, UPPER_ARM, FOREARM, slice(29, 30)),
    Segment("LeftUpLeg", 0, (0.0, 0.0, -0.084887), THIGH, slice(30, 34)),
    Segment("LeftLeg", 8, THIGH, SHIN, slice(34, 35)),
    Segment("LeftFoot", 9, SHIN, FOOT, slice(35, 39)),
    Segment("LeftArm", 1, (-0.02405, 0.2435, -0.18311), UPPER_ARM, slice(39, 43)),
    Segment("LeftForeArm", 11, UPPER_ARM, FOREARM, slice(43, 44)),
)


@dataclass(frozen=True, eq=False)
class Clip:
    """A motion in the clips' own axes.

    Attributes:
        name: One of CLIPS, or of the authored ones of :mod:`.keyframes`.
        times: Time of each frame [s], shape [frame_count].
        positions: Root positions [m], shape [frame_count, 3].
        turns: Rotations of the skeleton's joints (w, x, y, z), shape [frame_count, joint_count, 4].
        loops: Whether its end joins its beginning.
    """

    name: str
    times: FloatArray
    positions: FloatArray
    turns: FloatArray
    loops: bool


def load_clip(name: str) -> Clip:
    """Read a clip from the cached package, downloading it on first use.

    Raises:
        ValueError: If there is no such clip.
        PackageError: If the package cannot be had.
    """
    if name not in CLIPS:
        raise ValueError(f"The demo has the clips {', '.join(CLIPS)}, not {name!r}.")
    path = packages.package_folder(packages.MOTION) / f"humanoid3d_{name}.txt"
    content = json.loads(path.read_text(encoding="utf-8"))
    frames = np.array(content["Frames"], np.float64)
    turns = [
        frames[:, segment.columns]
        if segment.columns.stop - segment.columns.start == 4
        else rotations.from_rotvec(frames[:, segment.columns] * SIDE)
        for segment in SKELETON
    ]
    quaternions = np.stack(turns, 1)
    quaternions /= np.linalg.norm(quaternions, axis=-1, keepdims=True)
    # A frame's duration is the time until the next one; the last one's means nothing.
    times = np.concatenate([[0.0], np.cumsum(frames[:-1, 0])])
    return Clip(name, times, frames[:, 1:4], quaternions, content["Loop"] == "wrap")


def resampled(clip: Clip, frames_per_second: float = 30.0) -> Clip:
    """The clip at an even frame rate: rotations along shortest arcs, positions linearly."""
    times = np.arange(int(np.floor(clip.times[-1] * frames_per_second + 1e-6)) + 1) / frames_per_second
    after = np.clip(np.searchsorted(clip.times, times, side="right"), 1, len(clip.times) - 1)
    before = after - 1
    share = (times - clip.times[before]) / (clip.times[after] - clip.times[before])
    positions = clip.positions[before] + share[:, None] * (clip.positions[after] - clip.positions[before])
    apart = rotations.to_rotvec(rotations.multiply(rotations.conjugate(clip.turns[before]), clip.turns[after]))
    turns = rotations.multiply(clip.turns[before], rotations.from_rotvec(share[:, None, None] * apart))
    return Clip(clip.name, times, positions, turns, clip.loops)


def repeated(clip: Clip, count: int) -> Clip:
    """The clip several times over, each going on where and whither the one before it arrived.

    Raises:
        ValueError: If the clip does not loop.
    """
    if count > 1 and not clip.loops:
        raise ValueError(f"The clip {clip.name} does not end as it begins and cannot be repeated.")
    parts = [clip]
    for _ in range(count - 1):
        last = parts[-1]
        heading = rotations.twist_angle(last.turns[-1, 0], UP) - rotations.twist_angle(clip.turns[0, 0], UP)
        turn = rotations.from_rotvec(heading * UP)
        positions = rotations.rotate(turn, clip.positions - clip.positions[0])
        positions += last.positions[-1] * [1.0, 0.0, 1.0] + clip.positions[0] * UP
        turns = clip.turns.copy()
        turns[:, 0] = rotations.multiply(turn, turns[:, 0])
        # The last frame is the next repetition's first.
        parts[-1] = Clip(last.name, last.times[:-1], last.positions[:-1], last.turns[:-1], last.loops)
        parts.append(Clip(clip.name, clip.times + last.times[-1], positions, turns, clip.loops))
    return Clip(
        clip.name,
        np.concatenate([part.times for part in parts]),
        np.concatenate([part.positions for part in parts]),
        np.concatenate([part.turns for part in parts]),
        clip.loops,
    )


def in_place(clip: Clip) -> Clip:
    """The clip without its travel over the floor, so that a fixed camera keeps it in view."""
    return Clip(clip.name, clip.times, clip.positions * UP, clip.turns, clip.loops)


def part(clip: Clip, first: int, last: int) -> Clip:
    """Frames of a clip, counted from 1, the last one with them; 0 is the clip's end."""
    kept = slice(first - 1, last or None)
    times = clip.times[kept]
    return Clip(clip.name, times - times[0], clip.positions[kept], clip.turns[kept], False)


def to_rig(clip: Clip) -> tuple[Rig, list[Pose]]:
    """The clip's skeleton and its pose in every frame, facing +z."""
    heads = np.zeros((len(SKELETON), 3))
    for joint, segment in enumerate(SKELETON):
        heads[joint] = _to_bvh_axes(segment.offset) + (heads[segment.parent] if segment.parent >= 0 else 0.0)
    bones = np.stack([_to_bvh_axes(segment.bone) for segment in SKELETON])
    rest = np.tile(np.eye(4), (len(SKELETON), 1, 1))
    rest[:, :3, :3] = [bone_axes(bone, roll=0.0) for bone in bones]
    rest[:, :3, 3] = heads
    rig = Rig(
        names=tuple(segment.name for segment in SKELETON),
        parents=np.array([segment.parent for segment in SKELETON], np.int32),
        rest=rest,
        lengths=np.linalg.norm(bones, axis=1),
        gravity=-UP,
    )
    turns = np.concatenate([clip.turns[..., :1], _to_bvh_axes(clip.turns[..., 1:])], -1)
    roots = np.tile(np.eye(4), (len(clip.times), 1, 1))
    roots[:, :3, 3] = _to_bvh_axes(clip.positions)
    return rig, [pose_from_local_turns(rig, turn, root) for turn, root in zip(turns, roots, strict=True)]


def write_clip(clip: Clip, path: Path, frames_per_second: float = 30.0) -> Path:
    """Write a clip as a BVH file, whose path is returned."""
    rig, poses = to_rig(resampled(clip, frames_per_second))
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bvh(path, rig, poses, frames_per_second)
    return path


def _to_bvh_axes(vectors: ArrayLike) -> FloatArray:
    """From facing +x, right along +z, to facing +z, left along +x; shape [..., 3]."""
    v = np.asarray(vectors, np.float64)
    return np.stack([-v[..., 2], v[..., 1], v[..., 0]], -1)
