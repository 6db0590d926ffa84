"""Where a pose's error comes from: what the database does not know, joint by joint, and how its parts are put together.

The way from an equilibrium to what is shown for it goes through four shapes, each a step poorer: the equilibrium at the
whole pose; the one at the sampled joints' angles alone, upright; the equilibria of each joint alone, joined; and their
interpolations from samples, joined. What lies between two neighbours is one loss.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Protocol

import numpy as np
import warp as wp

from ..kernels.blend import join_all_offsets
from . import rotations
from .database import WrinkleDatabase, skin_frame
from .joint_wrinkles import JointWrinkles
from .rig import FloatArray, Pose, joint_angles, pose_of_angles


class Equilibrium(Protocol):
    """Whoever knows where the garment comes to rest: our solver, or a formula in tests."""

    def __call__(self, pose: Pose, gravity: FloatArray, through: Sequence[Pose] = ()) -> FloatArray:
        """The settled garment in rig space [m], shape [vertex_count, 3].

        Args:
            pose: The pose.
            gravity: Where things fall, a unit vector in rig space.
            through: Poses that the body passes on its way from rest; straight there if there are none.
        """
        ...


class LossFinder:
    """Tells the losses of single poses of one database.

    Args:
        database: The baked garment.
        equilibrium: Where the garment comes to rest.
    """

    def __init__(self, database: WrinkleDatabase, equilibrium: Equilibrium):
        self._database = database
        self._header = database.header
        self._equilibrium = equilibrium
        self._evaluator = JointWrinkles(database).bind()

    def losses(self, pose: Pose, gravity: FloatArray, whole: FloatArray) -> dict[str, float]:
        """Root mean square of every loss in one pose [mm].

        Args:
            pose: The pose.
            gravity: Where things fall in it, a unit vector in rig space.
            whole: The equilibrium at this pose [m], shape [vertex_count, 3].

        Returns:
            ``skinning``: what there is to lose; ``history``: what friction makes of another way to the same pose,
            joint after joint, which no function of the pose can know; ``other_bones``: bones that are no sampled
            joints, and a body that leans; ``independence``: joints that act on each other; ``interpolation``: between
            and beyond samples; ``all``: what is lost in the end. Losses may cancel: the last is not their sum.
        """
        rig, joints = self._header.rig, self._header.joints
        angles = joint_angles(rig, joints, pose)
        true = self._offsets(pose, whole)
        sampled = pose_of_angles(rig, joints, angles)
        together = self._offsets(sampled, self._equilibrium(sampled, rig.gravity))
        alone, interpolated = [], []
        for joint in joints:
            single = pose_of_angles(rig, joints, {joint.name: angles[joint.name]})
            alone.append(self._offsets(single, self._equilibrium(single, rig.gravity)))
            interpolated.append(self._offsets(single, self._evaluator.positions(single).astype(np.float64)))
        joined, shown = join(alone), join(interpolated)
        stages = [dict(list(angles.items())[:count]) for count in range(1, len(angles) + 1)]
        way = [pose_of_angles(rig, joints, stage) for stage in stages]
        again = self._offsets(pose, self._equilibrium(pose, gravity, way))
        return {
            "skinning": _rms_mm(true),
            "history": _rms_mm(true - again),
            "other_bones": _rms_mm(true - together),
            "independence": _rms_mm(together - joined),
            "interpolation": _rms_mm(joined - shown),
            "all": _rms_mm(true - shown),
        }

    def _offsets(self, pose: Pose, positions: FloatArray) -> FloatArray:
        """Offsets over skinning [m], in the frame of the rest pose, shape [vertex_count, 3]."""
        skinned, turns = skin_frame(self._header.rig, self._header.garment.weights, self._database.rest, pose)
        return rotations.rotate(rotations.conjugate(turns), positions - skinned)


def join(offsets: Sequence[FloatArray]) -> FloatArray:
    """The offsets of several joints [m] put together as in synthesis, shape [vertex_count, 3]."""
    given = wp.array(np.stack(offsets).astype(np.float32), dtype=wp.vec3, device="cpu")
    joined = wp.zeros(given.shape[1], dtype=wp.vec3, device="cpu")
    wp.launch(join_all_offsets, dim=given.shape[1], inputs=[given], outputs=[joined], device="cpu")
    return joined.numpy().astype(np.float64)


def mean_losses(frames: Sequence[Mapping[str, float]]) -> dict[str, float]:
    """Root mean square of every loss over frames [mm]."""
    return {name: float(np.sqrt(np.mean([frame[name] ** 2 for frame in frames]))) for name in frames[0]}


def _rms_mm(offsets: FloatArray) -> float:
    return float(np.sqrt((offsets**2).sum(1).mean()) * 1e3)
