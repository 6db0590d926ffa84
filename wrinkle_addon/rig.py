"""The deforming skeleton as arrays, its poses, and the joints that make wrinkles.

All matrices live in *rig space*: the armature object's own axes, in metres. A bone's *turn* is its rotation away from
the rest pose, seen in rig space; a joint's angles are read from the turn of its far bone relative to its near bone, so
bone rolls, local axes and rest matrices of the artist's rig never matter.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import rotations

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int32]


@dataclass(frozen=True, eq=False)
class Rig:
    """The deforming bones of an armature, parents before children.

    Attributes:
        names: Bone names.
        parents: Index of each bone's parent, -1 for a root, shape [bone_count].
        rest: Rest matrices in rig space, rotation and translation [m] only, shape [bone_count, 4, 4]. A bone points
            along its own +y, as in Blender.
        lengths: Bone lengths [m], shape [bone_count].
        gravity: Direction in which things fall, unit vector in rig space, shape [3].
    """

    names: tuple[str, ...]
    parents: IntArray
    rest: FloatArray
    lengths: FloatArray
    gravity: FloatArray

    def __post_init__(self) -> None:
        count = len(self.names)
        if len(set(self.names)) != count:
            raise ValueError("Two bones of the rig have the same name.")
        if self.rest.shape != (count, 4, 4) or self.parents.shape != (count,) or self.lengths.shape != (count,):
            raise ValueError(f"The rig has {count} bone names, but arrays for another number of bones.")
        if not np.isfinite(self.rest).all():
            raise ValueError("A rest matrix of the rig holds a value that is not a number.")
        if (self.parents >= np.arange(count)).any():
            raise ValueError("Bones of the rig must come after their parents.")

    @property
    def bone_count(self) -> int:
        return len(self.names)

    @cached_property
    def index(self) -> Mapping[str, int]:
        """Bone name to bone index."""
        return {name: i for i, name in enumerate(self.names)}

    @cached_property
    def heads(self) -> FloatArray:
        """Bone heads in the rest pose [m], shape [bone_count, 3]."""
        return self.rest[:, :3, 3]

    @cached_property
    def tails(self) -> FloatArray:
        """Bone tails in the rest pose [m], shape [bone_count, 3]."""
        return self.heads + self.rest[:, :3, 1] * self.lengths[:, None]

    @cached_property
    def rest_inverse(self) -> FloatArray:
        return np.linalg.inv(self.rest)

    def ancestors(self, bone: int) -> list[int]:
        """The bone's parent, its parent, and so on up to a root."""
        chain: list[int] = []
        while (bone := int(self.parents[bone])) >= 0:
            chain.append(bone)
        return chain

    def children(self, bone: int) -> list[int]:
        return [int(i) for i in np.flatnonzero(self.parents == bone)]

    def is_ancestor(self, ancestor: int, bone: int) -> bool:
        return ancestor in self.ancestors(bone)

    def fingerprint(self) -> str:
        """Hash of names, parents and rest matrices (rounded to 10 micrometres), the part a bake depends on."""
        digest = hashlib.sha256("\n".join(self.names).encode())
        digest.update(self.parents.astype("<i4").tobytes())
        digest.update(np.round(self.rest * 1e5).astype("<i8").tobytes())
        return digest.hexdigest()


@dataclass(frozen=True, eq=False)
class Pose:
    """Bone matrices at one instant.

    Attributes:
        matrices: Posed bone matrices in rig space, translation in metres, shape [bone_count, 4, 4].
    """

    matrices: FloatArray

    @staticmethod
    def at_rest(rig: Rig) -> Pose:
        return Pose(rig.rest.copy())

    def deformations(self, rig: Rig) -> FloatArray:
        """Matrices that carry rest positions into the pose, shape [bone_count, 4, 4]."""
        return self.matrices @ rig.rest_inverse

    def turns(self, rig: Rig) -> FloatArray:
        """Each bone's rotation away from rest as a quaternion (w, x, y, z) in rig space, shape [bone_count, 4]."""
        return rotations.from_matrices(self.deformations(rig)[:, :3, :3])

    def local_turns(self, rig: Rig) -> FloatArray:
        """Each bone's turn relative to its parent's turn (w, x, y, z), shape [bone_count, 4]."""
        turns = self.turns(rig)
        local = turns.copy()
        has_parent = rig.parents >= 0
        parents = turns[rig.parents[has_parent]]
        local[has_parent] = rotations.multiply(rotations.conjugate(parents), turns[has_parent])
        return local

    def with_root_at_rest(self, rig: Rig) -> tuple[Pose, FloatArray]:
        """The pose seen from the first bone's own frame, and the rigid matrix that was taken off, shape [4, 4]."""
        root = self.matrices[0] @ rig.rest_inverse[0]
        return Pose(np.linalg.inv(root) @ self.matrices), root


def pose_from_local_turns(rig: Rig, turns: ArrayLike, root: FloatArray | None = None) -> Pose:
    """Pose the rig by turning each bone about its own head, relative to its parent.

    Args:
        rig: The rig.
        turns: Local turns (w, x, y, z), shape [bone_count, 4]; see :meth:`Pose.local_turns`.
        root: Extra rigid matrix applied to the whole character, shape [4, 4].
    """
    matrices = rotations.to_matrices(np.asarray(turns, np.float64))
    deformations = np.zeros((rig.bone_count, 4, 4))
    for bone in range(rig.bone_count):
        about_head = np.eye(4)
        about_head[:3, :3] = matrices[bone]
        about_head[:3, 3] = rig.heads[bone] - matrices[bone] @ rig.heads[bone]
        parent = rig.parents[bone]
        carrier = deformations[parent] if parent >= 0 else (np.eye(4) if root is None else root)
        deformations[bone] = carrier @ about_head
    return Pose(deformations @ rig.rest)


def pose_between(rig: Rig, start: Pose, end: Pose, t: float) -> Pose:
    """The pose at fraction t of the way from start to end: every local turn along its shortest arc, heads linearly.

    Exact at both ends, also for poses whose bones are displaced from their parents.
    """
    first, last = start.local_turns(rig), end.local_turns(rig)
    local = rotations.to_matrices(rotations.slerp(first, last, t))
    offsets = (1.0 - t) * _head_offsets(rig, start) + t * _head_offsets(rig, end)
    deformations = np.zeros((rig.bone_count, 4, 4))
    for bone in range(rig.bone_count):
        about_head = np.eye(4)
        about_head[:3, :3] = local[bone]
        about_head[:3, 3] = rig.heads[bone] + offsets[bone] - local[bone] @ rig.heads[bone]
        parent = rig.parents[bone]
        deformations[bone] = about_head if parent < 0 else deformations[parent] @ about_head
    return Pose(deformations @ rig.rest)


def _head_offsets(rig: Rig, pose: Pose) -> FloatArray:
    """How far each bone's head left its place on its parent, seen in the parent's rest frame [m], shape [bones, 3]."""
    deformations = pose.deformations(rig)
    heads = pose.matrices[:, :3, 3]
    offsets = heads - rig.heads
    for bone, parent in enumerate(rig.parents):
        if parent >= 0:
            offsets[bone] = (np.linalg.inv(deformations[parent]) @ np.append(heads[bone], 1.0))[:3] - rig.heads[bone]
    return offsets


@dataclass(frozen=True, eq=False)
class Joint:
    """One articulation that makes wrinkles (W10-W14).

    Attributes:
        name: "elbow_L", "spine", ...; a symmetric pair differs only in its last letter.
        bones: Names of the bones that turn, from the trunk outwards; the last one is the far bone. A hinge has one, a
            shoulder may start with the clavicle, the spine is a chain.
        near: Name of the bone that the angles are measured against (the upper arm for an elbow, the pelvis for the
            spine), or "" for the rig itself.
        dof: 1 for a hinge, 3 for a ball.
        axes: Rotation axes at rest, unit vectors in rig space, shape [dof, 3]. A hinge has its own axis, positive
            when it flexes; a ball has its twist axis (along the bone) and two swing axes, all orthogonal.
        limits: Lowest and highest angle, relative to the rest pose [rad], shape [dof, 2]; every range holds 0.
        shares: How much of the joint's swing each of ``bones`` takes, adding up to 1, shape [len(bones)]. Twist goes
            to the far bone, but for a chain of even shares (a spine), which shares it too.
    """

    name: str
    bones: tuple[str, ...]
    near: str
    dof: int
    axes: FloatArray
    limits: FloatArray
    shares: FloatArray

    def __post_init__(self) -> None:
        if self.dof not in (1, 3):
            raise ValueError(f"Joint {self.name} must have 1 or 3 degrees of freedom, not {self.dof}.")
        if not self.bones or self.axes.shape != (self.dof, 3) or self.limits.shape != (self.dof, 2):
            raise ValueError(f"Joint {self.name} needs bones, {self.dof} axes and {self.dof} ranges.")
        if (self.limits[:, 0] > 0).any() or (self.limits[:, 1] < 0).any():
            raise ValueError(f"The range of joint {self.name} must hold the rest angle 0.")
        if self.shares.shape != (len(self.bones),) or abs(self.shares.sum() - 1.0) > 1e-6:
            raise ValueError(f"Joint {self.name} needs one share a bone, and all shares must add up to 1.")

    @property
    def far(self) -> str:
        return self.bones[-1]

    @property
    def is_hinge(self) -> bool:
        return self.dof == 1

    def pivot(self, rig: Rig) -> FloatArray:
        """Rest position of the joint's centre c0 of Wang eq 1: the far bone's head; a chain's first head [m]."""
        return rig.heads[rig.index[self.bones[0] if self.is_chain else self.far]]

    @property
    def is_chain(self) -> bool:
        return len(self.bones) > 1 and bool(np.ptp(self.shares) < 1e-6)

    def turn(self, angles: ArrayLike) -> FloatArray:
        """The far bone's turn relative to the near bone (w, x, y, z) at these angles [rad], shape [4]."""
        values = np.asarray(angles, np.float64)
        if self.is_hinge:
            return rotations.from_rotvec(values[0] * self.axes[0])
        swing = rotations.from_rotvec(values[1] * self.axes[1] + values[2] * self.axes[2])
        twist = rotations.from_rotvec(values[0] * self.axes[0])
        return rotations.multiply(swing, twist)

    def angles_of_turn(self, turns: ArrayLike) -> FloatArray:
        """Inverse of :meth:`turn`, shape [..., 4] to [..., dof]."""
        axes = np.concatenate([self.axes, np.zeros((3 - self.dof, 3))])
        return swing_twist_angles(np.asarray(turns, np.float64), axes)[..., : self.dof]

    def bone_turns(self, angles: ArrayLike) -> FloatArray:
        """Local turn of each of the joint's bones at these angles (w, x, y, z), shape [len(bones), 4].

        Composed from the trunk outwards they give :meth:`turn`. An even chain takes equal parts of the whole turn;
        otherwise the bones before the far one take their share of the swing and the far bone takes the rest.
        """
        values = np.asarray(angles, np.float64)
        total = self.turn(values)
        if len(self.bones) == 1:
            return total[None]
        if self.is_chain:
            part = rotations.from_rotvec(rotations.to_rotvec(total) / len(self.bones))
            return np.tile(part, (len(self.bones), 1))
        swing = values[1] * self.axes[1] + values[2] * self.axes[2] if self.dof == 3 else values[0] * self.axes[0]
        turns = [rotations.from_rotvec(share * swing) for share in self.shares[:-1]]
        carried = np.array([1.0, 0.0, 0.0, 0.0])
        for turn in turns:
            carried = rotations.multiply(carried, turn)
        turns.append(rotations.multiply(rotations.conjugate(carried), total))
        return np.stack(turns)


def swing_twist_angles(turns: FloatArray, axes: FloatArray) -> FloatArray:
    """Angles [rad] of twist and two swings about axes [..., 3, 3] that turns [..., 4] consist of, shape [..., 3].

    A swing-twist split and a log map, free of Euler gimbals (X16).
    """
    about = axes[..., 0, :]
    twist = rotations.twist_angle(turns, about)
    untwisted = rotations.conjugate(rotations.from_rotvec(twist[..., None] * about))
    swing = rotations.to_rotvec(rotations.multiply(turns, untwisted))
    return np.concatenate([twist[..., None], (axes[..., 1:, :] * swing[..., None, :]).sum(-1)], axis=-1)


class JointAngles:
    """The angles of many joints of one rig, read at once: in a fraction of the time that one by one takes.

    Args:
        rig: The rig.
        joints: Joints of it.
    """

    def __init__(self, rig: Rig, joints: Sequence[Joint]):
        self._dof = [joint.dof for joint in joints]
        # A joint without a near bone is turned against a bone that never turns, past the last one.
        self._near = [rig.index[joint.near] if joint.near else rig.bone_count for joint in joints]
        self._far = [rig.index[joint.far] for joint in joints]
        self._axes = np.zeros((len(joints), 3, 3))
        for number, joint in enumerate(joints):
            self._axes[number, : joint.dof] = joint.axes

    def read(self, turns: FloatArray) -> list[FloatArray]:
        """Angles of every joint [rad], shape [dof] each, when bones have these turns, shape [bone_count, 4]."""
        known = np.concatenate([turns, [[1.0, 0.0, 0.0, 0.0]]])
        relative = rotations.multiply(rotations.conjugate(known[self._near]), known[self._far])
        angles = swing_twist_angles(relative, self._axes)
        return [of_joint[:dof] for of_joint, dof in zip(angles, self._dof, strict=True)]


def pose_of_angles(rig: Rig, joints: Sequence[Joint], angles: Mapping[str, ArrayLike]) -> Pose:
    """The pose in which the named joints have these angles [rad] and everything else rests.

    Raises:
        KeyError: If a name in ``angles`` is no joint.
    """
    by_name = {joint.name: joint for joint in joints}
    local = np.tile([1.0, 0.0, 0.0, 0.0], (rig.bone_count, 1))
    for name, values in angles.items():
        joint = by_name[name]
        for bone, turn in zip(joint.bones, joint.bone_turns(values), strict=True):
            local[rig.index[bone]] = rotations.multiply(turn, local[rig.index[bone]])
    return pose_from_local_turns(rig, local)


def joint_angles(rig: Rig, joints: Sequence[Joint], pose: Pose) -> dict[str, FloatArray]:
    """Angles of every joint in a pose [rad]."""
    angles = JointAngles(rig, joints).read(pose.turns(rig))
    return {joint.name: values for joint, values in zip(joints, angles, strict=True)}
