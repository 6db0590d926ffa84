"""A garment synthesised and brought into line with its coarse layer, frame by frame (Wang et al. 2010, section 3.4).

Joints that are close to each other have no room to blend their meshes in (W86). They are put into different groups;
each group's mesh is synthesised alone and aligned alone, and only then they meet.
"""

from __future__ import annotations

from collections.abc import Mapping

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
        if not len(self._meshes):
            self._evaluator.evaluate(pose, out, strengths, placement)
            self._transfer.align(coarse, out, follow)
            return
        self._evaluator.evaluate_apart(pose, self.groups, self._meshes, strengths, placement)
        self._transfer.align_all(coarse, self._meshes, follow)
        self._transfer.join(self._meshes, out)
