"""What a recording has beyond skinning (F03): residuals, a stretch of vertices at a time."""

from __future__ import annotations

import enum
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import warp as wp
from numpy.typing import NDArray

from ..kernels.flow import take_residuals
from . import rotations
from .garment import SkinWeights
from .joint_wrinkles import upload_skin
from .recordings import Recording
from .rig import FloatArray, Pose, Rig

STRETCH_VALUES = 400_000
"""Vertices times frames that are held at a time."""


class Skinning(enum.Enum):
    """How bones carry the garment."""

    LINEAR = "linear"
    DUAL_QUATERNION = "dual_quaternion"


class ResidualSpace(enum.Enum):
    """Where residuals are seen from: the posed garment, as the paper has it, or the bones that turn it (X14)."""

    POSED = "posed"
    BONES = "bones"


@dataclass(frozen=True, eq=False)
class BoneFrames:
    """Bones of many frames as kernels read them.

    Attributes:
        matrices: Deformations as three rows each, shape [frame_count, 3 * bone_count, 4].
        turns: Rotations (x, y, z, w), shape [frame_count, bone_count, 4].
        duals: Dual parts of their dual quaternions, same shape.
    """

    matrices: NDArray[np.float32]
    turns: NDArray[np.float32]
    duals: NDArray[np.float32]

    @staticmethod
    def of(rig: Rig, poses: Sequence[Pose]) -> BoneFrames:
        deformations = np.stack([pose.deformations(rig) for pose in poses])
        turns = rotations.from_matrices(deformations[..., :3, :3])
        shifts = np.concatenate([np.zeros((*turns.shape[:-1], 1)), deformations[..., :3, 3]], -1)
        duals = 0.5 * rotations.multiply(shifts, turns)
        return BoneFrames(
            deformations[:, :, :3].reshape(len(poses), -1, 4).astype(np.float32),
            turns[..., [1, 2, 3, 0]].astype(np.float32),
            duals[..., [1, 2, 3, 0]].astype(np.float32),
        )


class Residuals:
    """The residuals of a recording; computed anew whenever they are asked for, so that no copy of it is held.

    Args:
        recording: The recording.
        rig: The rig, of the bones that carry the garment.
        poses: Its pose in every frame.
        to_rig: Matrix from the recorded object's space to rig space [m] in every frame, shape [frame_count, 4, 4].
        rest: The garment at rest [m], shape [vertex_count, 3].
        weights: What carries it.
        skinning: By which skinning.
        space: Where residuals are seen from.

    Raises:
        ValueError: If the numbers of frames or vertices do not belong together.
    """

    def __init__(
        self,
        recording: Recording,
        rig: Rig,
        poses: Sequence[Pose],
        to_rig: FloatArray,
        rest: FloatArray,
        weights: SkinWeights,
        skinning: Skinning = Skinning.LINEAR,
        space: ResidualSpace = ResidualSpace.BONES,
    ):
        if recording.vertex_count != len(rest):
            raise ValueError(
                f"The recording '{recording.name}' has {recording.vertex_count} vertices a frame, the garment "
                f"{len(rest)}; record the garment itself."
            )
        if not len(poses) == len(to_rig) == recording.frame_count:
            raise ValueError(f"'{recording.name}' has {recording.frame_count} frames, but poses of {len(poses)}.")
        self.recording = recording
        self._matrices = to_rig @ recording.to_object
        bones = BoneFrames.of(rig, poses)
        device = wp.get_device("cpu")
        self._inputs = [
            upload_skin(rest, weights, device),
            wp.array(bones.matrices, dtype=wp.vec4, device=device),
            wp.array(bones.turns, dtype=wp.quat, device=device),
            wp.array(bones.duals, dtype=wp.quat, device=device),
            skinning is Skinning.DUAL_QUATERNION,
            space is ResidualSpace.BONES,
            wp.array(self._matrices[:, :3].astype(np.float32), dtype=wp.vec4, device=device),
        ]

    @property
    def frame_count(self) -> int:
        return self.recording.frame_count

    @property
    def vertex_count(self) -> int:
        return self.recording.vertex_count

    def stretches(self) -> Iterator[tuple[slice, NDArray[np.float32]]]:
        """Vertices and their residuals in all frames [m], shape [frame_count, count, 3].

        Raises:
            ValueError: If positions are not numbers.
        """
        size = max(1, STRETCH_VALUES // self.frame_count)
        for first in range(0, self.vertex_count, size):
            part = slice(first, min(first + size, self.vertex_count))
            recorded = np.ascontiguousarray(self.recording.frames[:, part], np.float32)
            finite = np.isfinite(recorded).all((1, 2))
            if not finite.all():
                bad = int(np.flatnonzero(~finite)[0])
                raise ValueError(
                    f"Frame {self.recording.start + bad:g} of '{self.recording.name}' has positions that are not "
                    "numbers; record it again, or leave it out."
                )
            given = wp.array(recorded, dtype=wp.vec3, device="cpu", copy=False)
            residuals = wp.empty(recorded.shape[:2], dtype=wp.vec3, device="cpu")
            wp.launch(take_residuals, recorded.shape[:2], [*self._inputs, part.start, given], [residuals], device="cpu")
            yield part, residuals.numpy()

    def frame_positions(self, frame: int) -> FloatArray:
        """The recorded garment in rig space [m], shape [vertex_count, 3]."""
        matrix = self._matrices[frame]
        return np.asarray(self.recording.frames[frame], np.float64) @ matrix[:3, :3].T + matrix[:3, 3]
