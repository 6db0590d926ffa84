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


def read_clip(
    garment: bpy.types.Object, rig: Rig, frames: Sequence[float], scale: float | None = None
) -> Iterator[ClipFrame]:
    """Step the scene through frames, fractions allowed, and read the garment's armature at each; frame kept afterwards.

    Args:
        garment: A garment that was set up.
        rig: The rig to read, of the garment's armature.
        scale: Metres of the rig per unit of the armature's own space; left out, those of the scene.
    """
    scene = bpy.context.scene
    before = scene.frame_current, scene.frame_subframe
    armature = garment.wrinkles.armature
    reader = PoseReader(armature, rig)
    in_scene = rig_scale(armature)
    scale = in_scene if scale is None else scale
    units = float(scene.unit_settings.scale_length)
    try:
        for frame in frames:
            whole = int(np.floor(frame))
            scene.frame_set(whole, subframe=float(frame - whole))
            depsgraph = bpy.context.evaluated_depsgraph_get()
            evaluated = armature.evaluated_get(depsgraph)
            world = np.array(evaluated.matrix_world, np.float64)
            # Rig space is the object's own axes in metres, so its scale comes out of the rotation.
            rigid = world.copy()
            rigid[:3, :3] *= units / scale
            rigid[:3, 3] *= units
            from_rig = world.copy()
            from_rig[:3, :3] /= scale
            to_garment = np.linalg.inv(np.array(garment.evaluated_get(depsgraph).matrix_world, np.float64)) @ from_rig
            pose = reader.read(evaluated)
            pose.matrices[:, :3, 3] *= scale / in_scene
            yield ClipFrame(float(frame), pose, rigid, to_garment)
    finally:
        scene.frame_set(before[0], subframe=before[1])
