"""A small character for tests: the human skeleton, a body of tubes around arms and trunk, a sleeve over both arms."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any

import numpy as np
from skeletons import human
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.bake import BakeJob, SampleShape
from wrinkle_synthesis.wrinkle_addon.database import skin_frame
from wrinkle_synthesis.wrinkle_addon.garment import Body, Garment, SkinWeights, skin_garment
from wrinkle_synthesis.wrinkle_addon.joints import find_joints, with_ranges
from wrinkle_synthesis.wrinkle_addon.plan import JointGrid, Sample, SamplePlan
from wrinkle_synthesis.wrinkle_addon.rig import Joint, Pose, Rig, pose_of_angles
from wrinkle_synthesis.wrinkle_addon.wearer import BakeSettings

Array = np.ndarray
DEGREES = {
    "elbow_L": [[-30, 90]],
    "elbow_R": [[-30, 90]],
    "shoulder_L": [[-40, 40], [-30, 60], [-30, 60]],
    "shoulder_R": [[-40, 40], [-30, 60], [-30, 60]],
}


def tube_along(path: Sequence[Array], radius: float, rings: int, around: int) -> tuple[Array, Array]:
    """An open tube around a polyline, outward by its winding: vertices [m] and triangles; an odd number of rings."""
    points = np.asarray(path, float)
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    places = np.linspace(0.0, lengths[-1], rings)
    centres = np.stack([np.interp(places, lengths, points[:, k]) for k in range(3)], 1)
    # Corners of the polyline are rounded, so that neighbouring rings do not cross.
    for _ in range(max(2, rings // 12)):
        centres[1:-1] = 0.5 * centres[1:-1] + 0.25 * (centres[:-2] + centres[2:])
    along = np.gradient(centres, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    up = np.array([0.0, -1.0, 0.0])
    side = np.cross(along, up)
    side /= np.linalg.norm(side, axis=1)[:, None]
    up = np.cross(side, along)
    angles = 2.0 * np.pi * np.arange(around) / around
    vertices = centres[:, None] + radius * (
        np.cos(angles)[:, None] * up[:, None] + np.sin(angles)[:, None] * side[:, None]
    )
    faces = []
    for ring in range(rings - 1):
        for k in range(around):
            a, b = ring * around + k, ring * around + (k + 1) % around
            # Diagonals change over in the middle, so that a symmetric path gives a symmetric mesh.
            c, d = a + around, b + around
            faces += [[a, b, c], [b, d, c]] if 2 * ring < rings - 1 else [[a, b, d], [a, d, c]]
    vertices, faces = vertices.reshape(-1, 3), np.array(faces, np.int32)
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    outward = corners.mean(1) - np.repeat(centres[:-1], 2 * around, axis=0)
    return vertices, faces if (normals * outward).sum() > 0 else faces[:, ::-1].copy()


def arms_path(rig: Rig, reach: float = 1.0) -> list[Array]:
    """From the left wrist over the chest to the right wrist; ``reach`` is the share of the forearms covered."""
    heads, index = rig.heads, rig.index
    left = [heads[index[name]] for name in ("hand_L", "forearm_L", "upperarm_L")]
    right = [heads[index[name]] for name in ("upperarm_R", "forearm_R", "hand_R")]
    left[0] = left[1] + reach * (left[0] - left[1])
    right[2] = right[1] + reach * (right[2] - right[1])
    return [*left, 0.5 * (left[2] + right[0]), *right]


def weights_by_distance(rig: Rig, positions: Array, width: float = 0.05) -> Array:
    """Smooth bone weights from distances to the bones, rows adding up to 1, shape [vertex_count, bone_count]."""
    heads, lines = rig.heads, rig.tails - rig.heads
    relative = positions[:, None] - heads
    t = np.clip((relative * lines).sum(2) / (lines * lines).sum(1), 0.0, 1.0)
    distance = np.linalg.norm(relative - t[..., None] * lines, axis=2)
    weights = np.exp(-((distance / width) ** 2) + (distance.min(1, keepdims=True) / width) ** 2)
    weights[weights < 0.02] = 0.0
    return weights / weights.sum(1, keepdims=True)


@dataclass(frozen=True, eq=False)
class Doll:
    """Rig, body, garment and joints, and a body source that is plain skinning."""

    rig: Rig
    body: Body
    garment: Garment
    joints: tuple[Joint, ...]

    def positions(self, pose: Pose) -> Array:
        """The body in a pose [m]: makes the doll a body source."""
        weights = SkinWeights.from_dense(self.body.weights)
        return weights.carry(pose.deformations(self.rig), self.body.positions)

    def joint(self, name: str) -> Joint:
        return next(joint for joint in self.joints if joint.name == name)

    def random_pose(self, rng: np.random.Generator) -> Pose:
        """Every joint somewhere in its range."""
        angles = {
            joint.name: joint.limits[:, 0] + rng.random(joint.dof) * np.ptp(joint.limits, axis=1)
            for joint in self.joints
        }
        return pose_of_angles(self.rig, self.joints, angles)

    def job(self, plan: SamplePlan, **settings: Any) -> BakeJob:
        return BakeJob(self.rig, self.garment, self.body, plan, BakeSettings(**settings))


@cache
def doll(rings: int = 61, around: int = 16, names: tuple[str, ...] = tuple(DEGREES)) -> Doll:
    """The character, with these joints."""
    rig = human()
    body_positions, body_faces = tube_along(arms_path(rig, 1.2), 0.04, 91, 20)
    body = Body(body_positions, body_faces, weights_by_distance(rig, body_positions))
    positions, faces = tube_along(arms_path(rig), 0.055, rings, around)
    garment = Garment(
        "sleeve", positions, faces, skin_garment(positions, faces, body), np.zeros(len(positions), np.float32)
    )
    found = find_joints(rig).joints
    joints = []
    for name in names:
        joint = found[name]
        assert joint is not None
        joints.append(with_ranges(joint, DEGREES[name]))
    return Doll(rig, body, garment, tuple(joints))


def grid_of(joint: Joint, *degrees: Sequence[float]) -> JointGrid:
    """A joint's grid from degrees."""
    return JointGrid(joint, tuple(tuple(float(a) for a in np.radians(values)) for values in degrees))


class ShapedSamples:
    """A sample source made of formulas: skinning, plus an offset in the skinned frame that depends on the angles.

    Args:
        character: The doll.
        plan: What is sampled.
        bumps: For each joint a function of its angles [rad] to offsets, shape [vertex_count, 3] [m]; none for skinning.
    """

    def __init__(self, character: Doll, plan: SamplePlan, bumps: Mapping[str, Any] | None = None):
        self._doll, self._plan, self._bumps = character, plan, bumps or {}

    def rest(self) -> SampleShape:
        return SampleShape(self._doll.garment.positions, {"residual": 0.0})

    def batches(self, wanted: Sequence[Sample]) -> Iterator[dict[Sample, SampleShape]]:
        return ({sample: self.sample(sample)} for sample in wanted)

    def sample(self, sample: Sample) -> SampleShape:
        angles = self._plan.angles(sample)
        pose = pose_of_angles(self._doll.rig, self._doll.joints, {sample.joint: angles})
        garment = self._doll.garment
        skinned, turns = skin_frame(self._doll.rig, garment.weights, garment.positions, pose)
        bump = self._bumps.get(sample.joint)
        offsets = np.zeros_like(skinned) if bump is None else bump(angles)
        return SampleShape(skinned + rotations.rotate(turns, offsets), {"residual": 0.0})
