"""A garment synthesised and brought into line with its coarse layer, frame by frame (Wang et al. 2010, section 3.4).

Joints that are close to each other have no room to blend their meshes in (W86). They are put into different groups;
each group's mesh is synthesised alone and aligned alone, and only then they meet.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import warp as wp

from .cloth_model import FloatArray, IntArray
from .correspondence import Correspondence
from .database import WrinkleDatabase
from .detail_transfer import DetailTransfer, close_joints, transfer_groups
from .joint_wrinkles import JointEvaluator
from .rig import Pose


class AlignedWrinkles:
    """A garment's wrinkles and its garment's coarse layer on one device. Evaluating allocates nothing.

    Args:
        database: The garment's.
        evaluator: What it is synthesised by.
        match: Which coarse triangle each vertex of the garment rides on.
        positions, faces: The garment at the instant of the correspondence, [fine_count, 3] in the unit of the space
            that it is evaluated in, and its triangles.
    """

    def __init__(
        self,
        database: WrinkleDatabase,
        evaluator: JointEvaluator,
        match: Correspondence,
        positions: FloatArray,
        faces: IntArray,
    ):
        header = database.header
        names = [joint.name for joint in header.joints]
        close = close_joints(header.regions, database.rest, header.garment.faces)
        self.groups = transfer_groups(names, close)
        self._evaluator = evaluator
        self._transfer = DetailTransfer(match, positions, faces, device=str(evaluator.device))
        count = 1 + len(self.groups) if len(self.groups) > 1 else 0
        self._meshes = wp.zeros((count, len(positions)), dtype=wp.vec3, device=evaluator.device)
        self._synthesised: _Synthesised | None = None

    def synthesise(
        self,
        pose: Pose,
        out: wp.array,
        strengths: Mapping[str, float],
        placement: FloatArray | None = None,
        follow: float = 1.0,
    ) -> None:
        """What :meth:`evaluate` begins with, which needs no coarse layer; with the same arguments it goes on from here.

        On a CPU this may run on another thread while the coarse layer is found.
        """
        if len(self._meshes):
            self._evaluator.evaluate_apart(pose, self.groups, self._meshes, strengths, placement)
            self._transfer.join(self._meshes, out, follow)
        else:
            self._evaluator.evaluate(pose, out, strengths, placement)
            self._transfer.measure(out)
        self._synthesised = _Synthesised(pose, out, dict(strengths), _bytes_of(placement), follow)

    def evaluate(
        self,
        pose: Pose,
        coarse: wp.array,
        out: wp.array,
        strengths: Mapping[str, float],
        placement: FloatArray | None = None,
        follow: float = 1.0,
    ) -> None:
        """Write the garment's positions.

        Args:
            pose: Bone matrices of the database's rig.
            coarse: Where the coarse layer lies in the space asked for, array of vec3, shape [coarse_count].
            out: Array of vec3 on the evaluator's device, shape [fine_count].
            strengths: Of the wrinkles by joint.
            placement: Affine matrix from rig space [m] to the space asked for, shape [4, 4]; rig space if left out.
            follow: How much of the coarse layer's motion the garment takes on, from 0 to 1.
        """
        if self._synthesised is None or not self._synthesised.is_of(pose, out, strengths, placement, follow):
            self.synthesise(pose, out, strengths, placement, follow)
        self._synthesised = None
        self._transfer.attach(coarse, out, follow)


@dataclass(frozen=True, eq=False)
class _Synthesised:
    """What a garment that lies synthesised, and not aligned yet, was made of."""

    pose: Pose
    out: wp.array
    strengths: dict[str, float]
    placement: bytes
    follow: float

    def is_of(
        self, pose: Pose, out: wp.array, strengths: Mapping[str, float], placement: FloatArray | None, follow: float
    ) -> bool:
        return (
            self.pose is pose
            and self.out is out
            and self.strengths == dict(strengths)
            and self.placement == _bytes_of(placement)
            and self.follow == follow
        )


def _bytes_of(placement: FloatArray | None) -> bytes:
    return b"" if placement is None else placement.tobytes()
