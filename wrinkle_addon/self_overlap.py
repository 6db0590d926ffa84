"""Poses in which a body passes through itself so far that no place is left for cloth; such samples are left out.

    plan = leave_out_overlaps(plan, rig, garment, body)

Where the thighs of crossed legs pass through each other, or a raised one through the belly, cloth that is worn on
either would have to be inside the body. What it comes to rest in there is no wrinkle of any garment, and interpolation
would spread it over the poses around. So such a sample takes the wrinkles of the nearest one that has a place for them.

In any skinned body skin is buried where a joint bends, in the crook of an elbow, behind a knee, between a sitting thigh
and the belly. Cloth slides out of such a crease and bulges, unless the crease is huge. Away from the joint it cannot:
there a sleeve or a trouser leg would have to go around both limbs. So what counts is the area of skin near the garment
that is buried deep, and was not at rest; less of it is borne away from the joint that is turned.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .garment import Body, Garment, distances_to_surface, vertex_normals
from .plan import Sample, SamplePlan
from .rig import FloatArray, IntArray, Joint, Rig, pose_of_angles
from .surface import BodyVolume

REACH = 0.1
"""Skin within this distance of the garment at rest counts [m]."""

ABOVE = 0.001
"""Skin is buried if the body is met again this far above it [m]."""

DEPTH = 0.02
"""Buried skin is deep if it is farther than this from all skin that is free [m]."""

CREASE = 0.15
"""Skin so near to the joint's pivot lies in the crease where it bends [m]."""

MOST_BURIED, MOST_AWAY = 0.03, 0.01
"""With more deeply buried skin than this in all, or away from the crease, a body leaves no place for cloth [m^2]."""


class SelfOverlap:
    """How far a body passes through itself near a garment.

    It is posed by plain skinning, which is what tells one limb's place from another's whatever refines it afterwards.
    """

    def __init__(self, rig: Rig, garment: Garment, body: Body):
        self._rig, self._body = rig, body
        distance = distances_to_surface(body.positions, garment.positions, garment.faces)
        self._near = np.flatnonzero(distance < REACH)
        self._area = vertex_areas(body.positions, body.faces)
        # Mouths, eyes and clothes that a body holds inside it are no limbs that meet.
        at_rest = self._buried(body.positions)
        self._near, self._buried_at_rest = self._near[~at_rest], self._near[at_rest]

    def leaves_place(self, joint: Joint, angles: ArrayLike) -> bool:
        """Whether there is a place for cloth when a joint is turned to some angles [rad], shape [dof]."""
        in_all, away = self.areas(joint, angles)
        return in_all <= MOST_BURIED and away <= MOST_AWAY

    def areas(self, joint: Joint, angles: ArrayLike) -> tuple[float, float]:
        """Areas of the skin that is buried deep by turning a joint, in all, and away from its crease [m^2].

        Args:
            angles: Of the joint [rad], shape [dof]; all others are at rest.
        """
        pose = pose_of_angles(self._rig, [joint], {joint.name: angles})
        positions = self._body.carry(pose.deformations(self._rig))
        buried = self._near[self._buried(positions)]
        if self._area[buried].sum() <= MOST_AWAY:
            # No more than this can be deep.
            return 0.0, 0.0
        inside = np.zeros(len(positions), bool)
        inside[buried] = inside[self._buried_at_rest] = True
        faces = self._body.faces
        depth = distances_to_surface(positions[buried], positions, faces[~inside[faces].any(1)])
        deep = buried[depth > DEPTH]
        away = np.linalg.norm(positions[deep] - joint.pivot(self._rig), axis=1) > CREASE
        return float(self._area[deep].sum()), float(self._area[deep[away]].sum())

    def _buried(self, positions: FloatArray) -> NDArray[np.bool_]:
        """Which skin near the garment is inside the body, of another limb or a fold, in order of ``_near``."""
        above = positions + ABOVE * vertex_normals(positions, self._body.faces)
        return BodyVolume(positions, self._body.faces).depth(above[self._near])[0] > 0.0


def leave_out_overlaps(plan: SamplePlan, rig: Rig, garment: Garment, body: Body) -> SamplePlan:
    """The plan without those samples in whose poses the body leaves no place for cloth."""
    overlap = SelfOverlap(rig, garment, body)

    def leaves_place(sample: Sample) -> bool:
        return overlap.leaves_place(plan.grid[sample.joint].joint, plan.angles(sample))

    crowded = {sample for sample in plan.originals if not leaves_place(sample)}
    images = {sample for sample in plan.samples if plan.image(sample) in crowded}
    return replace(plan, left_out=frozenset(crowded | images))


def describe_left_out(plan: SamplePlan) -> str:
    """One sentence on the samples that are left out; empty if there are none."""
    if not plan.left_out:
        return ""
    return (
        f"In {len(plan.left_out)} of {len(plan.samples) + 1} samples limbs pass through each other so far that cloth "
        "has no place; they take the wrinkles of the nearest sample where it has one."
    )


def vertex_areas(positions: FloatArray, faces: IntArray) -> FloatArray:
    """A third of the area of the triangles around each vertex [m^2], shape [vertex_count]."""
    corners = positions[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.asarray(np.bincount(faces.ravel(), np.repeat(area / 3.0, 3), len(positions)), np.float64)
