"""What the benchmarks play and bake: the demo's character, dressed, moving, and a database made of formulas."""

# pyright: reportMissingImports=false
from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from wrinkle_synthesis.demo.character import load_character
from wrinkle_synthesis.demo.garment import make_garment
from wrinkle_synthesis.demo.motion import in_place, load_clip, resampled, to_rig
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.bake import BakeJob, SampleShape, bake
from wrinkle_synthesis.wrinkle_addon.database import WrinkleDatabase, skin_frame
from wrinkle_synthesis.wrinkle_addon.garment import Body, Garment, SkinWeights, skin_garment, vertex_normals
from wrinkle_synthesis.wrinkle_addon.joints import find_joints
from wrinkle_synthesis.wrinkle_addon.motion import retarget
from wrinkle_synthesis.wrinkle_addon.plan import Sample, SamplePlan, budget_plan, paper_plan
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray, Joint, Pose, Rig
from wrinkle_synthesis.wrinkle_addon.wearer import BakeSettings

CLIP = "spinkick"
QUICK_SAMPLES = 60
SHELL = "shell"
SHELL_EASE = 0.008
"""How far the shell is blown up to be worn as a garment [m]."""


@dataclass(frozen=True, eq=False)
class Outfit:
    """A dressed character in the rig's rest pose.

    Attributes:
        rig, body, garment: The character.
        joints: Those that move this garment.
    """

    rig: Rig
    body: Body
    garment: Garment
    joints: tuple[Joint, ...]

    def poses(self) -> list[Pose]:
        """The character's spin kick."""
        return spin_kick(self.rig)

    def on_rig(self, rig: Rig, weights: FloatArray, body_weights: FloatArray, joints: Sequence[Joint]) -> Outfit:
        """The same outfit on another reading of its rig, with dense weights for that one's bones."""
        garment = replace(self.garment, weights=SkinWeights.from_dense(weights))
        return Outfit(rig, replace(self.body, weights=body_weights), garment, tuple(joints))


@dataclass(frozen=True, eq=False)
class SkinnedBody:
    """The body of an outfit in any pose, by plain skinning: makes it a body source."""

    outfit: Outfit

    @cached_property
    def _weights(self) -> SkinWeights:
        return SkinWeights.from_dense(self.outfit.body.weights)

    def positions(self, pose: Pose) -> FloatArray:
        return self._weights.carry(pose.deformations(self.outfit.rig), self.outfit.body.positions)


def spin_kick(rig: Rig) -> list[Pose]:
    """One of the demo's clips on a rig, in place: shoulders, hips, elbows and knees all bend far."""
    clip_rig, poses = to_rig(resampled(in_place(load_clip(CLIP))))
    return retarget(clip_rig, find_joints(clip_rig).found, poses, rig, find_joints(rig).found)


def dress(garments: Sequence[str], vertex_count: int) -> Outfit:
    """The demo's character in one mesh of several of its garments, with about this many vertices in all.

    The garment "shell" is the body's own close-fitting shell, blown up, in its own resolution: quick to make.
    """
    character = load_character()
    rig, faces = character.rig, character.body.triangles.astype(np.int32)
    body = Body(character.body.vertices, faces, character.weights)
    if list(garments) == [SHELL]:
        triangles = character.shell.triangles.astype(np.int32)
        outward = vertex_normals(character.shell.vertices, triangles)
        parts = [(character.shell.vertices + SHELL_EASE * outward, triangles)]
    else:
        made = [make_garment(character, name, vertex_count // len(garments)) for name in garments]
        parts = [(one.vertices, one.triangles.astype(np.int32)) for one in made]
    first = np.cumsum([0] + [len(vertices) for vertices, _ in parts])
    positions = np.concatenate([vertices for vertices, _ in parts])
    triangles = np.concatenate([part + start for (_, part), start in zip(parts, first[:-1], strict=True)])
    weights = skin_garment(positions, triangles.astype(np.int32), body)
    garment = Garment(
        " and ".join(garments), positions, triangles.astype(np.int32), weights, np.zeros(len(positions), np.float32)
    )
    joints = [joint for joint in find_joints(rig).found if _moves(joint, rig, weights)]
    return Outfit(rig, body, garment, tuple(joints))


def _moves(joint: Joint, rig: Rig, weights: SkinWeights) -> bool:
    """Whether there is cloth on both sides of a joint."""
    far = rig.index[joint.far]
    beyond = np.array([bone == far or rig.is_ancestor(far, bone) for bone in range(rig.bone_count)])
    carried = weights.to_dense(rig.bone_count) @ beyond
    return bool((carried > 0.5).mean() > 0.02 and (carried < 0.5).mean() > 0.02)


class FoldedSamples:
    """A sample source made of formulas: folds around the joint that turns, and a slight drag on all of the garment.

    Simulated samples are like that: cloth hangs together, so nearly every vertex moves by more than 0.1 mm with every
    joint, and is stored.
    """

    FOLD, DRAG, REACH = 0.015, 0.002, 0.12
    """Depth of folds, drag of far cloth, and distance from the joint over which folds fade [m]."""

    def __init__(self, job: BakeJob):
        self._job = job

    def rest(self) -> SampleShape:
        return SampleShape(self._job.garment.positions, {"residual": 0.0})

    def batches(self, wanted: Sequence[Sample]) -> Iterator[dict[Sample, SampleShape]]:
        return ({sample: self.sample(sample)} for sample in wanted)

    def sample(self, sample: Sample) -> SampleShape:
        rig, garment = self._job.rig, self._job.garment
        joint = self._job.plan.grid[sample.joint].joint
        pose = self._job.pose(sample)
        skinned, turns = skin_frame(rig, garment.weights, garment.positions, pose)
        distance = np.linalg.norm(garment.positions - joint.pivot(rig), axis=1)
        amount = float(np.linalg.norm(self._job.plan.angles(sample)))
        depth = self.FOLD * np.exp(-((distance / self.REACH) ** 2)) * np.sin(60.0 * distance + 3.0 * amount)
        offsets = amount * (depth[:, None] * garment.normals + self.DRAG * np.sin(5.0 * garment.positions + amount))
        return SampleShape(skinned + rotations.rotate(turns, offsets), {"residual": 0.0})


def make_plan(joints: Sequence[Joint], *, quick: bool) -> SamplePlan:
    """The paper's plan, or a plan of a few samples."""
    return budget_plan(joints, QUICK_SAMPLES) if quick else paper_plan(joints)


def write_database(rig: Rig, garment: Garment, body: Body, plan: SamplePlan, folder: Path) -> WrinkleDatabase:
    """A database of formulas for this garment."""
    job = BakeJob(rig, garment, body, plan, BakeSettings())
    for _ in bake(job, FoldedSamples(job), folder):
        pass
    return WrinkleDatabase.open(folder)
