"""An arm of two bones in a sleeve, built in Blender, with a database of known bumps: no cloth is simulated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
from synthesis_reference import joined
from wrinkle_synthesis.wrinkle_addon import rotations
from wrinkle_synthesis.wrinkle_addon.bake import BakeJob, SampleShape, bake
from wrinkle_synthesis.wrinkle_addon.blender.armature import apply_motion, read_rig
from wrinkle_synthesis.wrinkle_addon.blender.character import apply, read_garment, rig_from_world
from wrinkle_synthesis.wrinkle_addon.blender.setup import bind_to_armature
from wrinkle_synthesis.wrinkle_addon.database import skin_frame
from wrinkle_synthesis.wrinkle_addon.garment import Body, bind_to_surface
from wrinkle_synthesis.wrinkle_addon.plan import JointGrid, Sample, SamplePlan
from wrinkle_synthesis.wrinkle_addon.rig import FloatArray, Joint, Pose, Rig, joint_angles, pose_of_angles
from wrinkle_synthesis.wrinkle_addon.wearer import BakeSettings

LENGTH, RADIUS = 0.6, 0.05
TOLERANCE = 2.0e-4
"""What a database may lose [m]: offsets below 0.1 mm are left out, half precision costs 0.05 mm at most."""


def elbow() -> Joint:
    axis, limits = np.array([[0.0, -1.0, 0.0]]), np.array([[0.0, np.pi / 2]])
    return Joint("elbow_L", ("lower",), "upper", 1, axis, limits, np.ones(1))


def shoulder() -> Joint:
    limits = np.array([[-0.6, 0.6]] * 3)
    return Joint("shoulder_L", ("upper",), "", 3, np.eye(3), limits, np.ones(1))


def plan() -> SamplePlan:
    hinge = JointGrid(elbow(), ((0.0, np.pi / 4, np.pi / 2),))
    return SamplePlan((hinge, JointGrid(shoulder(), ((-0.6, 0.0, 0.6),) * 3)))


def tube(radius: float, around: int, along: int) -> tuple[FloatArray, list[tuple[int, ...]]]:
    """Vertices and quads of an open tube around the arm."""
    x, angle = np.meshgrid(np.linspace(0.0, LENGTH, along), np.arange(around) * 2 * np.pi / around, indexing="ij")
    vertices = np.stack([x, radius * np.cos(angle), radius * np.sin(angle)], -1).reshape(-1, 3)
    quads = []
    for ring in range(along - 1):
        for k in range(around):
            a, b = ring * around + k, ring * around + (k + 1) % around
            quads.append((a, b, b + around, a + around))
    return vertices, quads


def arm_weights(positions: FloatArray) -> FloatArray:
    """Weights of the upper and the lower bone, blended over 10 cm around the elbow, shape [vertex_count, 2]."""
    lower = np.clip((positions[:, 0] - LENGTH / 2) / 0.1 + 0.5, 0.0, 1.0)
    return np.stack([1.0 - lower, lower], 1)


@dataclass(frozen=True, eq=False)
class Bumps:
    """Samples that are the skinned sleeve with bumps that grow linearly with every angle, so that they are exact."""

    job: BakeJob

    def rest(self) -> SampleShape:
        # The settled sleeve is a little wider than the modelled one, so that a test can tell one from the other.
        return SampleShape(self.job.garment.positions * [1.0, 1.04, 1.04], {})

    def batches(self, wanted: Sequence[Sample]) -> Iterator[dict[Sample, SampleShape]]:
        return ({sample: self.sample(sample)} for sample in wanted)

    def sample(self, sample: Sample) -> SampleShape:
        return SampleShape(self.shape(self.pose({sample.joint: self.job.plan.angles(sample)})), {})

    def pose(self, angles: Mapping[str, FloatArray]) -> Pose:
        return pose_of_angles(self.job.rig, self.job.header.joints, angles)

    def shape(self, pose: Pose, strength: Mapping[str, float] | None = None) -> FloatArray:
        """What playing must give in any pose inside the plan, in rig space [m], shape [vertex_count, 3]."""
        garment, rig = self.job.garment, self.job.rig
        skinned, turns = skin_frame(rig, garment.weights, self.rest().positions, pose)
        angles = joint_angles(rig, self.job.header.joints, pose)
        offsets = []
        for joint in self.job.header.joints:
            amount = angles[joint.name] @ [1.0, 2.0, -1.0][: joint.dof]
            offsets.append((strength or {}).get(joint.name, 1.0) * amount * self._bump(joint))
        return skinned + rotations.rotate(turns, joined(np.stack(offsets)))

    def _bump(self, joint: Joint) -> FloatArray:
        """Offset per radian [m]: outwards around the elbow, along the arm and upwards around the shoulder."""
        positions = self.job.garment.positions
        outward = positions * [0.0, 1.0, 1.0] / RADIUS
        if joint.is_hinge:
            return 0.03 * np.exp(-(((positions[:, :1] - 0.3) / 0.1) ** 2)) * outward
        return 0.02 * np.exp(-((positions[:, :1] / 0.2) ** 2)) * np.array([0.5, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Arm:
    """One character of the scene; its sleeve is ready to be played once a database is set."""

    armature: bpy.types.Object
    sleeve: bpy.types.Object
    rig: Rig

    def job(self) -> BakeJob:
        garment = read_garment(self.sleeve, self.rig, rig_from_world(self.armature))
        vertices, quads = tube(RADIUS, 16, 24)
        faces = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
        body = Body(vertices, faces, arm_weights(vertices))
        return BakeJob(self.rig, garment, body, plan(), BakeSettings())

    def animate(self, angles: Sequence[Mapping[str, Sequence[float] | FloatArray]], start: int = 1) -> list[Pose]:
        """Key one pose a frame; returns them."""
        poses = [pose_of_angles(self.rig, (elbow(), shoulder()), each) for each in angles]
        apply_motion(self.armature, self.rig, poses, start=start)
        return poses

    def bend(self, angle: float) -> Pose:
        """Pose the elbow by hand, without a key; returns the pose."""
        bone = self.armature.pose.bones["lower"]
        bone.rotation_mode = "QUATERNION"
        rest = bone.bone.matrix_local.to_quaternion()
        about = rest.inverted() @ _quaternion(elbow().turn([angle])) @ rest
        bone.rotation_quaternion = about
        return pose_of_angles(self.rig, (elbow(), shoulder()), {"elbow_L": [angle]})

    def to_object_space(self, positions: FloatArray) -> FloatArray:
        """Positions in rig space [m] as the sleeve's own coordinates."""
        to_rig = rig_from_world(self.armature) @ np.array(self.sleeve.matrix_world, np.float64)
        return apply(np.linalg.inv(to_rig), positions)


def _quaternion(values: FloatArray):
    from mathutils import Quaternion

    return Quaternion(values)


def empty_scene() -> bpy.types.Scene:
    bpy.ops.wm.read_factory_settings(use_empty=True)
    return bpy.context.scene


def build_arm(
    name: str = "", database: Path | str = "", *, around: int = 12, along: int = 30, size: float = 1.0
) -> Arm:
    """Build an arm in a sleeve at the origin.

    Args:
        name: Put before the objects' names.
        database: Folder of its database; the sleeve is played if it is given.
        around, along: Resolution of the sleeve.
        size: Blender units a metre.
    """
    armature = _build_armature(f"{name}rig", size)
    sleeve = _build_mesh(f"{name}sleeve", armature, RADIUS * 1.2, around, along, size)
    settings = sleeve.wrinkles
    settings.armature = armature
    settings.body = _build_mesh(f"{name}body", armature, RADIUS, 16, 24, size)
    settings.body.hide_render = True
    # What its database says is compared to the bit; tests of the push switch it on.
    settings.clear_of_body = False
    settings.joints.clear()
    for joint in (elbow(), shoulder()):
        settings.joints.add().store(joint)
    bpy.context.view_layer.update()
    arm = Arm(armature, sleeve, read_rig(armature))
    settings.database = str(database)
    settings.enabled = bool(database)
    return arm


def _build_armature(name: str, size: float) -> bpy.types.Object:
    armature = bpy.data.objects.new(name, bpy.data.armatures.new(name))
    bpy.context.scene.collection.objects.link(armature)
    bpy.context.view_layer.objects.active = armature
    bpy.ops.object.mode_set(mode="EDIT")
    parent = None
    for bone_name, start in (("upper", 0.0), ("lower", LENGTH / 2)):
        bone = armature.data.edit_bones.new(bone_name)
        bone.head, bone.tail = (start * size, 0.0, 0.0), ((start + LENGTH / 2) * size, 0.0, 0.0)
        bone.roll, bone.parent = 0.3, parent
        parent = bone
    bpy.ops.object.mode_set(mode="OBJECT")
    return armature


def _build_mesh(
    name: str, armature: bpy.types.Object, radius: float, around: int, along: int, size: float
) -> bpy.types.Object:
    vertices, quads = tube(radius, around, along)
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata((vertices * size).tolist(), [], quads)
    ob = bpy.data.objects.new(name, mesh)
    bpy.context.scene.collection.objects.link(ob)
    for bone, weights in zip(("upper", "lower"), arm_weights(vertices).T, strict=True):
        group = ob.vertex_groups.new(name=bone)
        for vertex, weight in enumerate(weights):
            if weight > 0.0:
                group.add([vertex], float(weight), "REPLACE")
    bind_to_armature(ob, armature)
    return ob


def bake_bumps(arm: Arm, folder: Path) -> Bumps:
    """Make the database of an arm; returns what it must give."""
    bumps = Bumps(arm.job())
    for _ in bake(bumps.job, bumps, folder):
        pass
    return bumps


def evaluated_positions(ob: bpy.types.Object) -> FloatArray:
    """Vertices of an object as the viewport shows it, in object space."""
    mesh = ob.evaluated_get(bpy.context.evaluated_depsgraph_get()).data
    positions = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.attributes["position"].data.foreach_get("vector", positions)
    return positions.reshape(-1, 3)


def heights(arm: Arm) -> np.ndarray:
    """Height of the sleeve over the arm as both are shown, in their own space."""
    body = arm.sleeve.wrinkles.body
    mesh = body.data
    mesh.calc_loop_triangles()
    faces = np.array([triangle.vertices[:] for triangle in mesh.loop_triangles], np.int32)
    points = evaluated_positions(arm.sleeve).astype(np.float64)
    to_body = np.array(body.matrix_world.inverted() @ arm.sleeve.matrix_world)
    points = points @ to_body[:3, :3].T + to_body[:3, 3]
    return bind_to_surface(points, evaluated_positions(body).astype(np.float64), faces).distance
