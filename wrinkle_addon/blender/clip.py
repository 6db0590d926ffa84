"""The poses that a scene's animation uses, frame by frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import bpy
import numpy as np

from ..rig import FloatArray, Pose, Rig
from .armature import PoseReader, rig_scale


@dataclass(frozen=True, eq=False)
class ClipFrame:
    """One frame of an animation.

    Attributes:
        frame: Scene frame, with its fraction.
        pose: The rig's pose.
        rig_to_world: Rigid matrix from rig space to world axes, both in metres, shape [4, 4].
        rig_to_garment: Affine matrix from rig space [m] to the garment's object space, shape [4, 4].
    """

    frame: float
    pose: Pose
    rig_to_world: FloatArray
    rig_to_garment: FloatArray

    def in_world(self) -> Pose:
        """The pose with the armature object's own motion put into the bones [m]."""
        return Pose(self.rig_to_world @ self.pose.matrices)


def parse_frames(text: str) -> list[int]:
    """Frames of "A:B" or "A:B:STEP", both ends included.

    Raises:
        ValueError: If the text has another form or names no frame.
    """
    parts = text.split(":")
    try:
        numbers = [int(part) for part in parts]
        if len(numbers) not in (2, 3):
            raise ValueError
    except ValueError:
        raise ValueError(f"Frames are given as FIRST:LAST or FIRST:LAST:STEP, not '{text}'.") from None
    step = numbers[2] if len(numbers) == 3 else 1
    frames = list(range(numbers[0], numbers[1] + 1, step)) if step > 0 else []
    if not frames:
        raise ValueError(f"The frame range {text} is empty; give a first frame that is not after the last.")
    return frames


class ClipReader:
    """Reads the pose that a garment's armature has in the scene's frame.

    Args:
        garment: A garment that was set up.
        rig: The rig to read, of the garment's armature.
        scale: Metres of the rig per unit of the armature's own space; left out, those of the scene.
    """

    def __init__(self, garment: bpy.types.Object, rig: Rig, scale: float | None = None):
        self._garment = garment
        self._armature = garment.wrinkles.armature
        self._reader = PoseReader(self._armature, rig)
        self._in_scene = rig_scale(self._armature)
        self._scale = self._in_scene if scale is None else scale

    def read(self, frame: float) -> ClipFrame:
        """The frame that the scene is at."""
        depsgraph = bpy.context.evaluated_depsgraph_get()
        units = float(depsgraph.scene.unit_settings.scale_length)
        evaluated = self._armature.evaluated_get(depsgraph)
        world = np.array(evaluated.matrix_world, np.float64)
        # Rig space is the object's own axes in metres, so its scale comes out of the rotation.
        rigid = world.copy()
        rigid[:3, :3] *= units / self._scale
        rigid[:3, 3] *= units
        from_rig = world.copy()
        from_rig[:3, :3] /= self._scale
        worn = np.array(self._garment.evaluated_get(depsgraph).matrix_world, np.float64)
        pose = self._reader.read(evaluated)
        pose.matrices[:, :3, 3] *= self._scale / self._in_scene
        return ClipFrame(float(frame), pose, rigid, np.linalg.inv(worn) @ from_rig)


def step_frames(frames: Sequence[float]) -> Iterator[float]:
    """Step the scene through frames, fractions allowed; the frame that it was at comes back afterwards."""
    scene = bpy.context.scene
    before = scene.frame_current, scene.frame_subframe
    try:
        for frame in frames:
            whole = int(np.floor(frame))
            scene.frame_set(whole, subframe=float(frame - whole))
            yield frame
    finally:
        scene.frame_set(before[0], subframe=before[1])


def read_clip(
    garment: bpy.types.Object, rig: Rig, frames: Sequence[float], scale: float | None = None
) -> Iterator[ClipFrame]:
    """Step the scene through frames and read the garment's armature at each; arguments as of :class:`ClipReader`."""
    reader = ClipReader(garment, rig, scale)
    # A loop lets go of the stepping at an error; a generator expression would hold it until the traceback is gone.
    for frame in step_frames(frames):
        yield reader.read(frame)
